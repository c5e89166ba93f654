//! Plants of the greenhouse. The house itself, `greenhouse.mgf`, is written by hand.
//!
//! Leaves are bent ribbons of triangles, so that all faces are planar. A plant repeats one leaf with an array at the golden angle.

use crate::{
    SceneFile,
    mgf_writer::{MgfWriter, Point, polar, sin_cos_degrees},
};

/// Returns the generated files.
pub fn files() -> Vec<SceneFile> {
    [
        ("greenhouse/tomato.mgf", tomato()),
        ("greenhouse/palm.mgf", palm()),
        ("greenhouse/seedling.mgf", seedling()),
        ("greenhouse/pot.mgf", pot()),
    ]
    .into_iter()
    .map(|(path, text)| SceneFile::text(path, text))
    .collect()
}

/// A leaf that starts at `base` along +x, climbs at `rise` degrees and bends down to `fall` degrees at its tip.
struct Leaf {
    base: Point,
    length: f64,
    width: f64,
    rise: f64,
    fall: f64,
    segments: u32,
}

impl Leaf {
    fn write(&self, writer: &mut MgfWriter) {
        let n = f64::from(self.segments);
        let step = self.length / n;
        let (mut x, mut z) = (self.base[0], self.base[2]);
        // Midrib and two edges, slightly above it: a leaf is a shallow gutter.
        let mut ribs: Vec<[Point; 3]> = Vec::new();
        for k in 0..=self.segments {
            let u = f64::from(k) / n;
            let half = 0.5 * self.width * 4.0 * u * (1.0 - u) * (1.25 - 0.5 * u);
            let edge = |side: f64| [x, self.base[1] + side * half, z + 0.25 * half];
            ribs.push([edge(-1.0), [x, self.base[1], z], edge(1.0)]);
            let (s, c) = sin_cos_degrees(self.rise + (self.fall - self.rise) * (u + 0.5 / n));
            x += step * c;
            z += step * s;
        }
        for (k, pair) in ribs.windows(2).enumerate() {
            let ([r0, m0, l0], [r1, m1, l1]) = (pair[0], pair[1]);
            let (first, last) = (k == 0, k + 1 == self.segments as usize);
            if !first {
                writer.face(&[r0, if last { m1 } else { r1 }, m0]);
                writer.face(&[m0, if last { m1 } else { l1 }, l0]);
            }
            if !last {
                writer.face(&[m0, r1, m1]);
                writer.face(&[m0, m1, l1]);
            }
        }
    }
}

/// A tomato plant on a cane, 1.9 m: eleven leaves with leaflets, and fruit.
fn tomato() -> String {
    let mut writer = MgfWriter::new("t");
    writer.write_lines("# A tomato plant on a cane, 1.9 m. Foot at the origin.");
    writer.material("cane");
    writer.write_lines("v ta =\n\tp 0.03 0 0.2\nv tb =\n\tp 0.03 0 2.05\ncyl ta 0.008 tb");
    writer.material("stem");
    writer.write_lines("v tc =\n\tp 0 0 0.2\nv td =\n\tp 0 0 1.85\ncone tc 0.012 td 0.004");
    writer.push_transform("-t 0 0 0.4 -a 11 -rz 137.5 -s 0.965 -t 0 0 0.14");
    writer.write_lines("v te =\n\tp 0 0 0\nv tf =\n\tp 0.18 0 0.08\ncone te 0.006 tf 0.003");
    writer.material("leaf");
    for (angle, start, length) in
        [(0.0, 0.17, 0.2), (58.0, 0.12, 0.16), (-58.0, 0.12, 0.16), (74.0, 0.05, 0.11), (-74.0, 0.05, 0.11)]
    {
        writer.push_transform(&format!("-rz {angle} -t {start} 0 {:.3}", 0.45 * start));
        Leaf { base: [0.0; 3], length, width: 0.45 * length, rise: 22.0, fall: -50.0, segments: 4 }.write(&mut writer);
        writer.pop_transform();
    }
    writer.pop_transform();
    writer.material("tomato");
    for (k, (z, radius)) in [(0.55, 0.036), (0.58, 0.033), (0.84, 0.034), (0.87, 0.03), (1.12, 0.028), (1.15, 0.024)]
        .into_iter()
        .enumerate()
    {
        let [x, y, z] = polar(0.055, 200.0 + 75.0 * k as f64, z);
        writer.write_lines(&format!("v tg =\n\tp {x:.4} {y:.4} {z}\nsph tg {radius}"));
    }
    writer.finish()
}

/// A palm-like plant, 1.6 m high and wide: fourteen arching leaves.
fn palm() -> String {
    let mut writer = MgfWriter::new("p");
    writer.write_lines("# A palm-like plant: 14 arching leaves. Foot at the origin.");
    writer.material("stem");
    writer.write_lines("v pa =\n\tp 0 0 0.25\nv pb =\n\tp 0 0 0.7\ncone pa 0.05 pb 0.03");
    writer.material("leaf");
    writer.push_transform("-t 0 0 0.45 -a 14 -rz 137.5 -s 0.975 -t 0 0 0.03");
    Leaf { base: [0.02, 0.0, 0.0], length: 1.15, width: 0.2, rise: 76.0, fall: -38.0, segments: 9 }.write(&mut writer);
    writer.pop_transform();
    writer.finish()
}

/// A seedling, 8 cm: four leaves on a stem.
fn seedling() -> String {
    let mut writer = MgfWriter::new("s");
    writer.write_lines("# A seedling: four leaves. Foot at the origin.");
    writer.material("stem");
    writer.write_lines("v sa =\n\tp 0 0 0\nv sb =\n\tp 0 0 0.06\ncyl sa 0.002 sb");
    writer.material("leaf");
    writer.push_transform("-t 0 0 0.055 -a 4 -rz 92 -s 0.9 -t 0 0 0.006");
    Leaf { base: [0.0; 3], length: 0.07, width: 0.04, rise: 35.0, fall: -20.0, segments: 3 }.write(&mut writer);
    writer.pop_transform();
    writer.finish()
}

/// A clay pot, 28 cm high, with soil.
fn pot() -> String {
    "# A clay pot: wall, rim, soil. Foot at the origin.\n\
     m clay\n\
     v a =\n\tp 0 0 0.001\n\
     v b =\n\tp 0 0 0.28\n\
     cone a 0.11 b 0.16\n\
     v b =\n\tp 0 0 0.28\n\tn 0 0 1\n\
     torus b 0.155 0.175\n\
     m soil\n\
     v c =\n\tp 0 0 0.25\n\tn 0 0 1\n\
     ring c 0 0.154\n"
        .to_owned()
}
