//! Plants of the roundabout, made of few faces: arrays repeat a branch or a skirt while they turn, shrink and climb.

use crate::mgf_writer::{MgfWriter, Point, add, polar, scale};
use femc_math::hash::{mix32, unit_f32};

/// Uniform number in [-1, 1] by index, equal on every machine.
fn jitter(seed: u32, index: u32) -> f64 {
    2.0 * f64::from(unit_f32(mix32(mix32(seed) ^ index))) - 1.0
}

/// A broad-leaved tree, 6 m high: 13 branches at the golden angle, each a rod with 10 leaf clusters. 215 polygons.
pub fn tree() -> String {
    let mut writer = MgfWriter::new("t");
    writer.write_lines("# A broad-leaved tree, 6 m: 13 branches of 10 leaf clusters at the golden angle.");
    writer.material("bark");
    writer.rod([0.0, 0.0, -0.1], [0.0, 0.0, 2.7], 0.16, 8);
    writer.rod([0.0, 0.0, 2.6], [0.0, 0.0, 4.4], 0.09, 8);
    writer.push_transform("-t 0 0 2.3 -a 13 -rz 137.5 -s 0.965 -t 0 0 0.27");
    writer.rod([0.05, 0.0, 0.0], [2.2, 0.0, 0.95], 0.04, 3);
    writer.material("leaf");
    for k in 0..10 {
        let j = |n: u32| jitter(7, 16 * k + n);
        let along = 0.5 + 1.9 * f64::from(k) / 9.0;
        let center = [along + 0.15 * j(0), 0.6 * j(1), 0.43 * along + 0.1 + 0.45 * j(2)];
        writer.face(&kite(center, 0.5 + 0.1 * j(3), [j(4), j(5), j(6)]));
    }
    writer.pop_transform();
    writer.finish()
}

/// Returns a planar kite of about `size`, turned at random.
fn kite(center: Point, size: f64, random: Point) -> [Point; 4] {
    // Two orthogonal directions from a yaw and a pitch.
    let (sy, cy) = crate::mgf_writer::sin_cos_degrees(180.0 * random[0]);
    let (sp, cp) = crate::mgf_writer::sin_cos_degrees(60.0 * random[1]);
    let long = [cy * cp, sy * cp, sp];
    let wide = [-sy, cy, 0.0];
    let at = |a: f64, b: f64| add(center, add(scale(long, size * a), scale(wide, size * b * (1.0 + 0.3 * random[2]))));
    [at(-1.0, 0.0), at(0.1, -0.7), at(1.0, 0.0), at(0.1, 0.7)]
}

/// A conifer, 5 m high: six jagged skirts. 104 polygons.
pub fn conifer() -> String {
    let mut writer = MgfWriter::new("n");
    writer.write_lines("# A conifer, 5 m: six jagged skirts, each smaller and higher.");
    writer.material("bark");
    writer.rod([0.0, 0.0, -0.1], [0.0, 0.0, 2.0], 0.12, 6);
    writer.material("needle");
    writer.push_transform("-t 0 0 0.5 -a 6 -rz 17 -s 0.82 -t 0 0 0.98");
    let apex = [0.0, 0.0, 1.45];
    let rim = |k: u32| {
        let k = k % 16;
        let (radius, z) = if k.is_multiple_of(2) { (1.7, -0.1) } else { (1.05, 0.22) };
        polar(radius + 0.12 * jitter(3, k), 22.5 * f64::from(k), z + 0.1 * jitter(5, k))
    };
    for k in 0..16 {
        writer.face(&[rim(k), rim(k + 1), apex]);
    }
    writer.pop_transform();
    writer.finish()
}

/// A shrub, 0.9 m wide: a dented icosahedron. 20 polygons.
pub fn shrub() -> String {
    let mut writer = MgfWriter::new("s");
    writer.write_lines("# A shrub: a dented icosahedron.");
    writer.material("leaf");
    let r = |k: u32| 0.45 * (1.0 + 0.18 * jitter(11, k));
    let ring = |k: u32, upper: bool| {
        let (z, offset) = if upper { (0.22, 36.0) } else { (-0.16, 0.0) };
        polar(r(k + 10 * u32::from(upper)), 72.0 * f64::from(k % 5) + offset, z)
    };
    let (top, bottom) = ([0.03, -0.02, 0.47], [0.0, 0.0, -0.42]);
    for k in 0..5 {
        let n = (k + 1) % 5;
        writer.face(&[ring(k, true), ring(n, true), top]);
        writer.face(&[ring(n, false), ring(k, false), bottom]);
        writer.face(&[ring(k, false), ring(n, false), ring(k, true)]);
        writer.face(&[ring(n, false), ring(n, true), ring(k, true)]);
    }
    writer.finish()
}
