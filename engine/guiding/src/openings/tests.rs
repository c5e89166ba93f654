//! Openings of walls, sheets, grids and rooms in closed form.

use super::*;
use femc_import::{Bundle, load_scene};
use femc_math::hash::{mix64, unit_f32};
use femc_prepared::{FrameSpec, Prepared, SceneSource, prepare_frame};
use std::fmt::Write;
use std::sync::Arc;

/// Text of a scene.
#[derive(Default)]
struct Text {
    text: String,
    vertices: u32,
}

impl Text {
    fn face(&mut self, corners: &[[f32; 3]]) {
        let first = self.vertices;
        for [x, y, z] in corners {
            writeln!(self.text, "v v{} =\n p {x} {y} {z}", self.vertices).expect("text");
            self.vertices += 1;
        }
        let names: Vec<String> = (first..self.vertices).map(|number| format!("v{number}")).collect();
        writeln!(self.text, "f {}", names.join(" ")).expect("text");
    }

    /// Adds a box between two corners.
    fn block(&mut self, [low, high]: [[f32; 3]; 2]) {
        for axis in 0..3 {
            let [u, v] = [(axis + 1) % 3, (axis + 2) % 3];
            for side in [low[axis], high[axis]] {
                let corner = |[a, b]: [f32; 2]| {
                    let mut point = [side; 3];
                    (point[u], point[v]) = (a, b);
                    point
                };
                self.face(&[[low[u], low[v]], [high[u], low[v]], [high[u], high[v]], [low[u], high[v]]].map(corner));
            }
        }
    }

    /// Adds a room of 8 m x 4 m x 2.6 m.
    fn room(&mut self) {
        self.block([[-4.0, -2.0, 0.0], [4.0, 2.0, 2.6]]);
    }

    /// Adds a wall in x from `x[0]` to `x[1]` with a rectangular hole in y and z.
    fn wall(&mut self, x: [f32; 2], [y, z]: [[f32; 2]; 2]) {
        self.block([[x[0], -2.0, 0.0], [x[1], y[0], 2.6]]);
        self.block([[x[0], y[1], 0.0], [x[1], 2.0, 2.6]]);
        if z[0] > 0.0 {
            self.block([[x[0], y[0], 0.0], [x[1], y[1], z[0]]]);
        }
        if z[1] < 2.6 {
            self.block([[x[0], y[0], z[1]], [x[1], y[1], 2.6]]);
        }
    }

    fn prepare(&self) -> Prepared {
        let head =
            "camera main =\n origin 0 0 0\n target 1 0 0\n fov 20\n film 1 1\nm gray =\n sides 2\n c\n rd .5\nm gray\n";
        let files = [("test.mgf".to_owned(), format!("{head}{}", self.text).into_bytes())];
        let scene = load_scene(&Bundle(files.into()), "test.mgf").unwrap_or_else(|error| panic!("{error}")).scene;
        let spec = FrameSpec { camera: None, size: None, frame: 1, filter_radius: 0.5 };
        prepare_frame(&SceneSource::new(Arc::new(scene)), &spec, None).unwrap_or_else(|error| panic!("{error}"))
    }
}

/// Returns number `k` of item `at` in [0, 1).
fn number(at: u64, k: u64) -> f32 {
    unit_f32((mix64(16 * at + k) >> 32) as u32)
}

/// Returns lines between points on the surfaces of two boxes that see each other.
fn lines(scene: &Prepared, boxes: [[[f32; 3]; 2]; 2], count: usize, seed: u64) -> Vec<Line> {
    let shift = scene.origin.as_vec3a();
    let point = |at: u64, side: usize| {
        let place = [0, 1, 2].map(|axis| {
            let [low, high] = [boxes[side][0][axis], boxes[side][1][axis]];
            low + (high - low) * number(at, (3 * side + axis) as u64)
        });
        Vec3A::from(place) - shift
    };
    let all = (seed * 100_000_000..).map(|at| [point(at, 0), point(at, 1)]);
    let sees = |ends: &[Vec3A; 2]| {
        let way = ends[1] - ends[0];
        scene.distance(ends[0], way.normalize(), way.length()).is_none()
    };
    all.take(4_000_000).filter(sees).map(|ends| Line { ends, weight: 1.0 }).take(count).collect()
}

/// Ends of lines near the surfaces of the room's two halves.
const HALVES: [[[f32; 3]; 2]; 2] = [[[-3.9, -1.9, 0.1], [-1.5, 1.9, 2.5]], [[1.5, -1.9, 0.1], [3.9, 1.9, 2.5]]];

/// Returns the bounds of an opening in coordinates of the scene.
fn bounds(scene: &Prepared, opening: &Opening) -> [[f32; 3]; 2] {
    let corners = [[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [1.0, 1.0]].map(|at| opening.target.point_at(at));
    let shift = scene.origin.as_vec3a();
    let [low, high] = corners
        .iter()
        .fold([Vec3A::INFINITY, Vec3A::NEG_INFINITY], |[low, high], point| [low.min(*point), high.max(*point)]);
    [low + shift, high + shift].map(Into::into)
}

/// Checks that an opening has bounds up to an error, m; in x, up to three times that.
fn assert_bounds(scene: &Prepared, opening: &Opening, wanted: [[f32; 3]; 2], error: f32) {
    let found = bounds(scene, opening);
    // A plane may be turned slightly.
    let errors = [3.0 * error, error, error];
    let is_near = (0..2).all(|side| (0..3).all(|axis| (found[side][axis] - wanted[side][axis]).abs() <= errors[axis]));
    assert!(is_near, "{found:?} in place of {wanted:?}");
}

#[test]
fn a_slit_of_one_centimeter_is_found() {
    for seed in 0..20 {
        let mut text = Text::default();
        text.room();
        text.wall([0.0, 0.08], [[0.4, 0.41], [0.0, 2.0]]);
        let scene = text.prepare();
        let found = find_openings(&scene, &lines(&scene, HALVES, 40, seed), &[], 8);
        assert_eq!(found.len(), 1, "{found:?}");
        let [low, high] = bounds(&scene, &found[0]);
        assert!((low[1] - 0.4).abs() < 1e-3 && (high[1] - 0.41).abs() < 1e-3, "{low:?} {high:?}");
        assert!(low[2] < 0.01 && high[2] > 1.99 && high[2] < 2.01, "{low:?} {high:?}");
        assert!(low[0] > -0.005 && high[0] < 0.085, "{low:?} {high:?}");
        assert!(found[0].share > 0.9, "{found:?}");
    }
}

#[test]
fn an_empty_room_has_no_openings() {
    for seed in 0..20 {
        let mut text = Text::default();
        text.room();
        let scene = text.prepare();
        let whole = [[[-3.99, -1.99, 0.01], [3.99, 1.99, 2.59]]; 2];
        let found = find_openings(&scene, &lines(&scene, whole, 96, seed), &[], 8);
        assert_eq!(found, []);
    }
}

#[test]
fn a_deep_window_is_found() {
    let mut text = Text::default();
    text.room();
    text.wall([0.0, 0.25], [[-0.3, 0.4], [0.9, 1.5]]);
    let scene = text.prepare();
    let found = find_openings(&scene, &lines(&scene, HALVES, 60, 1), &[], 8);
    assert!(!found.is_empty() && found[0].share > 0.8, "{found:?}");
    let [low, high] = bounds(&scene, &found[0]);
    assert!((low[1] + 0.3).abs() < 0.01 && (high[1] - 0.4).abs() < 0.01, "{low:?} {high:?}");
    assert!((low[2] - 0.9).abs() < 0.01 && (high[2] - 1.5).abs() < 0.01, "{low:?} {high:?}");
}

#[test]
fn holes_of_thin_sheets_are_found() {
    // A polygon of 24 corners, and a rectangle, each in a square of a sheet.
    let square = 0.3;
    let sheet = |hole: &[[f32; 2]], text: &mut Text| {
        // Corners of the square belong to corners of the hole.
        let outer = |[y, z]: [f32; 2]| {
            let [y, z] = if hole.len() == 4 { [y.signum(), (z - 1.3).signum()] } else { [y, z - 1.3] };
            let scale = square / y.abs().max(z.abs());
            [y * scale, 1.3 + z * scale]
        };
        let mut face = |corners: [[f32; 2]; 4]| text.face(&corners.map(|[y, z]| [0.1, y, z]));
        for k in 0..hole.len() {
            let [a, b] = [hole[k], hole[(k + 1) % hole.len()]];
            face([a, b, outer(b), outer(a)]);
        }
        let [low, high] = [1.3 - square, 1.3 + square];
        face([[-2.0, 0.0], [2.0, 0.0], [2.0, low], [-2.0, low]]);
        face([[-2.0, high], [2.0, high], [2.0, 2.6], [-2.0, 2.6]]);
        face([[-2.0, low], [-square, low], [-square, high], [-2.0, high]]);
        face([[square, low], [2.0, low], [2.0, high], [square, high]]);
    };
    let round: Vec<[f32; 2]> = (0..24)
        .map(|k| femc_math::elementary::sin_cos(TAU * k as f32 / 24.0))
        .map(|(sin, cos)| [0.15 * cos, 1.3 + 0.15 * sin])
        .collect();
    let tilted = [[-0.2, 1.2], [0.2, 1.1], [0.2, 1.4], [-0.2, 1.5]];
    for (hole, [y, z]) in [(&round[..], [0.15, 0.15]), (&tilted[..], [0.2, 0.2])] {
        let mut text = Text::default();
        text.room();
        sheet(hole, &mut text);
        let scene = text.prepare();
        let found = find_openings(&scene, &lines(&scene, HALVES, 60, 2), &[], 8);
        assert_eq!(found.len(), 1, "{found:?}");
        // A parallelogram around a circle may be turned.
        let (error, area) = if hole.len() == 4 { (0.01, 0.12) } else { (0.07, 0.09) };
        assert_bounds(&scene, &found[0], [[0.1, -y, 1.3 - z], [0.1, y, 1.3 + z]], error);
        assert!((found[0].target.area() / area - 1.0).abs() < 0.06, "{found:?}");
    }
}

#[test]
fn gaps_of_a_grid_are_found() {
    // A window with four bars of 2 cm: five gaps of 10 cm.
    let mut text = Text::default();
    text.room();
    text.wall([0.0, 0.05], [[-0.29, 0.29], [0.8, 1.8]]);
    for bar in 0..4 {
        let y = -0.19 + 0.12 * bar as f32;
        text.block([[0.01, y, 0.8], [0.03, y + 0.02, 1.8]]);
    }
    let scene = text.prepare();
    let found = find_openings(&scene, &lines(&scene, HALVES, 96, 3), &[], 8);
    let share: f32 = found.iter().map(|it| it.share).sum();
    println!("bars: {:?}", found.iter().map(|it| (bounds(&scene, it), it.share)).collect::<Vec<_>>());
    // One opening may contain a bar.
    let area: f32 = found.iter().map(|it| it.target.area()).sum();
    assert!(share > 0.9 && area < 0.9, "{share} {area}");
    // A louver: seven slats that are tilted by 45 degrees.
    let mut text = Text::default();
    text.room();
    text.wall([0.0, 0.05], [[-0.4, 0.4], [1.0, 1.4]]);
    for slat in 0..7 {
        let z = 1.0 + 0.05 * slat as f32;
        text.face(&[[0.0, -0.4, z], [0.0, 0.4, z], [0.05, 0.4, z + 0.05], [0.05, -0.4, z + 0.05]]);
    }
    let scene = text.prepare();
    let found = find_openings(&scene, &lines(&scene, HALVES, 96, 4), &[], 8);
    let share: f32 = found.iter().map(|it| it.share).sum();
    println!("louver: {:?}", found.iter().map(|it| (bounds(&scene, it), it.share)).collect::<Vec<_>>());
    let area: f32 = found.iter().map(|it| it.target.area()).sum();
    assert!(share > 0.8 && area < 0.6, "{share} {area}");
}

#[test]
fn two_doors_in_a_row_are_found_one_after_the_other() {
    let mut text = Text::default();
    text.room();
    text.wall([-0.8, -0.75], [[0.4, 0.46], [0.0, 2.0]]);
    text.wall([0.75, 0.8], [[-0.5, -0.45], [0.0, 2.1]]);
    let scene = text.prepare();
    let between = [[-0.7, -1.9, 0.1], [0.7, 1.9, 2.5]];
    let near = lines(&scene, [HALVES[0], between], 48, 5);
    let far = lines(&scene, [between, HALVES[1]], 48, 6);
    let first = find_openings(&scene, &near, &[], 8);
    assert_eq!(first.len(), 1, "{first:?}");
    let known = [first[0].target];
    let both: Vec<Line> = near.into_iter().chain(far).collect();
    let second = find_openings(&scene, &both, &known, 8);
    assert_eq!(second.len(), 1, "{second:?}");
    for (opening, y) in [(&first[0], [0.4, 0.46]), (&second[0], [-0.5, -0.45])] {
        let [low, high] = bounds(&scene, opening);
        assert!((low[1] - y[0]).abs() < 0.01 && (high[1] - y[1]).abs() < 0.01, "{low:?} {high:?}");
    }
}

#[test]
fn a_gap_between_curved_jambs_is_found() {
    let mut text = Text::default();
    text.room();
    // Two columns of radius 0.2 m, 4 cm apart, between walls.
    text.block([[-0.02, -2.0, 0.0], [0.02, -0.2, 2.6]]);
    text.block([[-0.02, 0.24, 0.0], [0.02, 2.0, 2.6]]);
    writeln!(
        text.text,
        "v a =\n p 0 -.2 0\nv b =\n p 0 -.2 2.6\ncyl a .2 b\nv c =\n p 0 .24 0\nv d =\n p 0 .24 2.6\ncyl c .2 d"
    )
    .expect("text");
    let scene = text.prepare();
    let found = find_openings(&scene, &lines(&scene, HALVES, 60, 7), &[], 8);
    assert_eq!(found.len(), 1, "{found:?}");
    assert_bounds(&scene, &found[0], [[0.0, 0.0, 0.0], [0.0, 0.04, 2.6]], 0.01);
}

#[test]
fn a_door_that_is_placed_turned_is_found() {
    let mut text = Text::default();
    text.room();
    // The door swings on an edge at y = -0.4 and is open by 7 degrees.
    text.wall([0.0, 0.1], [[-0.4, 0.4], [0.0, 2.06]]);
    writeln!(text.text, "xf -rz 7 -t 0.1 -0.4 0").expect("text");
    text.block([[-0.04, 0.0, 0.0], [0.0, 0.8, 2.04]]);
    writeln!(text.text, "xf").expect("text");
    let scene = text.prepare();
    let found = find_openings(&scene, &lines(&scene, HALVES, 60, 8), &[], 8);
    println!("door: {:?}", found.iter().map(|it| (bounds(&scene, it), it.share)).collect::<Vec<_>>());
    assert!(found.len() <= 3 && found.iter().map(|it| it.share).sum::<f32>() > 0.8, "{found:?}");
}
