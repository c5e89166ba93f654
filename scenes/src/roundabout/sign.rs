//! Road signs: a gray plate, a colored front 4 mm in front of it, and each glyph 4 mm in front of its background.
//!
//! Outlines are drawn as the reader sees them, x to the right, z up, counterclockwise. A sign faces -y.

use crate::mgf_writer::{MgfWriter, Point, sin_cos_degrees};

type Outline = Vec<[f64; 2]>;

fn disc(radius: f64) -> Outline {
    (0..16)
        .map(|k| {
            let (s, c) = sin_cos_degrees(22.5 * f64::from(k));
            [radius * c, radius * s]
        })
        .collect()
}

fn rectangle(half_width: f64, half_height: f64) -> Outline {
    vec![[-half_width, -half_height], [half_width, -half_height], [half_width, half_height], [-half_width, half_height]]
}

fn triangle(size: f64) -> Outline {
    // A triangle on its tip: give way.
    vec![[0.0, -size], [0.866 * size, 0.5 * size], [-0.866 * size, 0.5 * size]]
}

fn translated(outline: &[[f64; 2]], x: f64, z: f64) -> Outline {
    outline.iter().map(|p| [p[0] + x, p[1] + z]).collect()
}

fn rotated(outline: &[[f64; 2]], degrees: f64) -> Outline {
    let (s, c) = sin_cos_degrees(degrees);
    outline.iter().map(|p| [c * p[0] - s * p[1], s * p[0] + c * p[1]]).collect()
}

fn upright_points(outline: &[[f64; 2]], y: f64, z: f64) -> Vec<Point> {
    outline.iter().map(|p| [p[0], y, p[1] + z]).collect()
}

/// A sign in its own frame: the foot of the posts at the origin, layers from back to front.
struct Sign {
    /// Height of the plate's center, m.
    height: f64,
    /// x of the posts, m.
    posts: &'static [f64],
    /// Plate, followed by (material, outline) of each layer. Outlines of one layer do not overlap.
    plate: Outline,
    layers: Vec<(&'static str, Vec<Outline>)>,
}

impl Sign {
    fn write(&self, writer: &mut MgfWriter) {
        writer.material("steel");
        for &x in self.posts {
            writer.rod([x, 0.06, -0.1], [x, 0.06, self.height], 0.03, 6);
        }
        writer.material("black");
        writer.prism(&upright_points(&self.plate, 0.0, self.height), 0.02);
        for (k, (material, outlines)) in self.layers.iter().enumerate() {
            writer.material(material);
            for outline in outlines {
                writer.face(&upright_points(outline, -0.004 * (k as f64 + 1.0), self.height));
            }
        }
    }
}

fn arrow() -> Outline {
    vec![[-0.04, -0.22], [0.04, -0.22], [0.04, 0.05], [0.14, 0.05], [0.0, 0.24], [-0.14, 0.05], [-0.04, 0.05]]
}

fn give_way() -> Sign {
    Sign {
        height: 2.1,
        posts: &[0.0],
        plate: triangle(0.5),
        layers: vec![("red", vec![triangle(0.5)]), ("white", vec![triangle(0.32)])],
    }
}

/// A sign that hangs below another sign, on its post.
fn roundabout() -> Sign {
    // Three arrows that follow each other.
    let one = [[0.05, 0.21], [-0.1, 0.21], [-0.1, 0.27], [-0.2, 0.17], [-0.1, 0.07], [-0.1, 0.13], [0.05, 0.13]];
    let arrows = [0.0, 120.0, 240.0].map(|a| rotated(&one, a)).to_vec();
    Sign { height: 1.2, posts: &[], plate: disc(0.32), layers: vec![("blue", vec![disc(0.32)]), ("white", arrows)] }
}

fn keep_right() -> Sign {
    Sign {
        height: 1.15,
        posts: &[0.0],
        plate: disc(0.3),
        layers: vec![("blue", vec![disc(0.3)]), ("white", vec![rotated(&arrow(), -135.0)])],
    }
}

fn speed_limit() -> Sign {
    let stroke = |x: f64, z: f64, w: f64, h: f64| translated(&rectangle(w, h), x, z);
    let three = vec![
        [-0.16, -0.14],
        [-0.02, -0.14],
        [-0.02, 0.14],
        [-0.16, 0.14],
        [-0.16, 0.09],
        [-0.07, 0.09],
        [-0.07, 0.025],
        [-0.14, 0.025],
        [-0.14, -0.025],
        [-0.07, -0.025],
        [-0.07, -0.09],
        [-0.16, -0.09],
    ];
    let zero = [
        stroke(0.04, 0.0, 0.022, 0.14),
        stroke(0.14, 0.0, 0.022, 0.14),
        stroke(0.09, 0.115, 0.026, 0.025),
        stroke(0.09, -0.115, 0.026, 0.025),
    ];
    Sign {
        height: 2.0,
        posts: &[0.0],
        plate: disc(0.36),
        layers: vec![
            ("red", vec![disc(0.36)]),
            ("white", vec![disc(0.27)]),
            ("black", std::iter::once(three).chain(zero).collect()),
        ],
    }
}

/// The advance direction board: the roundabout as a ring with three exits.
fn directions() -> Sign {
    let ring: Vec<Outline> = (0..12)
        .filter(|k| ![2, 5, 8, 11].contains(k))
        .map(|k| {
            let at = |r: f64, a: f64| {
                let (s, c) = sin_cos_degrees(a);
                [r * c, r * s]
            };
            let (a, b) = (30.0 * f64::from(k), 30.0 * f64::from(k) + 30.0);
            vec![at(0.22, a), at(0.32, a), at(0.32, b), at(0.22, b)]
        })
        .collect();
    let way = vec![[-0.05, 0.36], [0.05, 0.36], [0.05, 0.5], [0.13, 0.5], [0.0, 0.66], [-0.13, 0.5], [-0.05, 0.5]];
    let mut white: Vec<Outline> = ring;
    white.extend([0.0, 90.0, -90.0].map(|a| rotated(&way, a)));
    white.push(translated(&rectangle(0.05, 0.15), 0.0, -0.5));
    // Lines of lettering, too small to read.
    white.extend([(0.62, 0.55), (-0.75, -0.35), (0.75, -0.35)].map(|(x, z)| translated(&rectangle(0.28, 0.06), x, z)));
    Sign {
        height: 2.2,
        posts: &[-0.8, 0.8],
        plate: rectangle(1.2, 0.8),
        layers: vec![("white", vec![rectangle(1.2, 0.8)]), ("blue", vec![rectangle(1.16, 0.76)]), ("white", white)],
    }
}

/// The signs of the south approach.
pub fn approach(writer: &mut MgfWriter) {
    let placements: [(Sign, &str); 7] = [
        (keep_right(), "-t 0 -37.3 0.14"),
        (keep_right(), "-t 0 -23.4 0.14"),
        (give_way(), "-rz -6 -t 5.7 -23.6 0.12"),
        (roundabout(), "-rz -6 -t 5.7 -23.6 0.12"),
        (give_way(), "-rz 8 -t -1.0 -20.6 0.14"),
        (speed_limit(), "-t 5.0 -52 0.12"),
        (directions(), "-rz -8 -t 7.6 -41 0.12"),
    ];
    for (sign, place) in placements {
        writer.push_transform(place);
        sign.write(writer);
        writer.pop_transform();
    }
}

/// A board of chevrons to the right, on the island in front of each approach.
pub fn chevrons(writer: &mut MgfWriter) {
    let chevron = |x: f64| -> [Outline; 2] {
        let (w, h) = (0.2, 0.24);
        [vec![[x, 0.0], [x + w, 0.0], [x, h], [x - w, h]], vec![[x - w, -h], [x, -h], [x + w, 0.0], [x, 0.0]]]
    };
    let board = Sign {
        height: 0.75,
        posts: &[-0.7, 0.7],
        plate: rectangle(1.0, 0.28),
        layers: vec![
            ("blue", vec![rectangle(1.0, 0.28)]),
            ("white", [-0.7, -0.23, 0.24, 0.71].into_iter().flat_map(chevron).collect()),
        ],
    };
    writer.push_transform("-t 1.6 -9.3 0.25 -a 4 -rz 90");
    board.write(writer);
    writer.pop_transform();
}
