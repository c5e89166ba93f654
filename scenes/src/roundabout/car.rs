//! A small car, 4.1 m long.
//!
//! Local frame: x forward, y left, z up, the origin on the ground under the car's center. The cabin is open for the driver's
//! camera. Lights are discs and plates 1 cm in front of the solid body.

use crate::mgf_writer::{MgfWriter, Point, sin_cos_degrees};

const HALF_WIDTH: f64 = 0.86;

/// Extrudes an outline in (x, z) over y = -half ..= half.
fn extrude(writer: &mut MgfWriter, outline: &[[f64; 2]], half: f64) {
    slab(writer, outline, -half, half);
}

/// Extrudes an outline in (x, z), counterclockwise seen from -y, from `right` to `left`.
fn slab(writer: &mut MgfWriter, outline: &[[f64; 2]], right: f64, left: f64) {
    let corners: Vec<Point> = outline.iter().map(|p| [p[0], right, p[1]]).collect();
    writer.prism(&corners, left - right);
}

/// Body, pillars, roof, seats, wheel and wheels, without glass and lights.
pub fn body() -> String {
    let mut writer = MgfWriter::new("c");
    writer.write_lines("# A small car: x forward, y left, the origin on the ground.");
    writer.material("lacquer");
    let side = [
        [-2.05, 0.32],
        [-1.95, 0.24],
        [1.95, 0.22],
        [2.05, 0.32],
        [2.05, 0.6],
        [1.98, 0.72],
        [1.5, 0.81],
        [0.98, 0.88],
        [-1.6, 0.9],
        [-2.0, 0.88],
        [-2.05, 0.7],
    ];
    extrude(&mut writer, &side, HALF_WIDTH);
    // Roof and its six pillars.
    let roof = [[-1.25, 1.4], [0.2, 1.41], [0.28, 1.39], [0.2, 1.44], [-0.4, 1.47], [-1.25, 1.43]];
    extrude(&mut writer, &roof, 0.66);
    for s in [-1.0, 1.0] {
        writer.rod([0.93, s * 0.79, 0.84], [0.24, s * 0.64, 1.42], 0.03, 6);
        writer.rod([-0.45, s * 0.8, 0.85], [-0.5, s * 0.64, 1.42], 0.05, 6);
        writer.rod([-1.75, s * 0.79, 0.86], [-1.22, s * 0.64, 1.41], 0.06, 6);
        let (right, left) = if s < 0.0 { (-1.0, -0.87) } else { (0.87, 1.0) };
        slab(&mut writer, &[[0.62, 0.9], [0.7, 0.9], [0.72, 1.0], [0.6, 1.0]], right, left);
    }
    writer.material("fabric");
    // Trim on the belt line, dashboard, backs and head rests of the seats, and the steering wheel.
    extrude(&mut writer, &[[-1.55, 0.88], [0.85, 0.86], [0.85, 0.91], [-1.55, 0.93]], 0.76);
    extrude(&mut writer, &[[0.52, 0.84], [0.88, 0.84], [0.88, 0.905], [0.6, 0.985], [0.5, 0.96]], 0.74);
    slab(&mut writer, &[[0.54, 0.93], [0.72, 0.93], [0.64, 1.005], [0.56, 1.005]], 0.2, 0.52);
    for y in [-0.36, 0.36] {
        slab(&mut writer, &[[-0.62, 0.9], [-0.5, 0.9], [-0.62, 1.15], [-0.7, 1.15]], y - 0.22, y + 0.22);
        slab(&mut writer, &[[-0.7, 1.16], [-0.62, 1.16], [-0.64, 1.31], [-0.7, 1.31]], y - 0.11, y + 0.11);
    }
    writer.write_lines("v cw =\n\tp 0.4 0.36 0.905\n\tn -0.9 0 0.43\ntorus cw 0.155 0.18");
    writer.material("rubber");
    for (x, s) in [(-1.27, -1.0), (-1.27, 1.0), (1.27, -1.0), (1.27, 1.0)] {
        let wheel = circle(x, 0.312, 0.31, 16);
        let (right, left) = if s < 0.0 { (-0.88, -0.7) } else { (0.7, 0.88) };
        slab(&mut writer, &wheel, right, left);
    }
    writer.material("steel");
    for (x, s) in [(-1.27, -1.0), (-1.27, 1.0), (1.27, -1.0), (1.27, 1.0)] {
        let rim = circle(x, 0.312, 0.19, 8);
        let (right, left) = if s < 0.0 { (-0.885, -0.84) } else { (0.84, 0.885) };
        slab(&mut writer, &rim, right, left);
    }
    writer.material("white");
    for x in [-2.07, 2.02] {
        slab(&mut writer, &[[x, 0.4], [x + 0.05, 0.4], [x + 0.05, 0.51], [x, 0.51]], -0.26, 0.26);
    }
    writer.finish()
}

fn circle(x: f64, z: f64, radius: f64, sides: u32) -> Vec<[f64; 2]> {
    (0..sides)
        .map(|k| {
            let (s, c) = sin_cos_degrees(360.0 * f64::from(k) / f64::from(sides));
            [x + radius * c, z + radius * s]
        })
        .collect()
}

/// Dark panes, for a car without a camera inside.
pub fn glass() -> String {
    let mut writer = MgfWriter::new("g");
    writer.write_lines("# Panes of a parked car.");
    writer.material("darkglass");
    writer.face(&[[0.95, -0.78, 0.87], [0.95, 0.78, 0.87], [0.26, 0.63, 1.4], [0.26, -0.63, 1.4]]);
    writer.face(&[[-1.76, 0.78, 0.89], [-1.76, -0.78, 0.89], [-1.24, -0.63, 1.4], [-1.24, 0.63, 1.4]]);
    for s in [-1.0, 1.0] {
        writer.face(&[[-1.76, s * 0.78, 0.89], [0.95, s * 0.78, 0.89], [0.26, s * 0.63, 1.4], [-1.24, s * 0.63, 1.4]]);
    }
    writer.finish()
}

/// A plate of light at x, facing along `sign` x, between two corners in (y, z).
fn plate(writer: &mut MgfWriter, x: f64, low: [f64; 2], high: [f64; 2]) {
    let mut corners = [[x, low[0], low[1]], [x, high[0], low[1]], [x, high[0], high[1]], [x, low[0], high[1]]];
    if x < 0.0 {
        corners.reverse();
    }
    writer.face(&corners);
}

/// Head lights (two of 800 lm, dipped by 1.2 degrees), tail lights, and the right indicators.
pub fn lights() -> String {
    let mut writer = MgfWriter::new("k");
    writer.write_lines("# Head lights: discs of 0.0113 m2, 800 lm each, peak 9000 cd, dipped by 1.2 degrees.");
    writer.material("headlight");
    for (name, y) in [("kl", 0.62), ("kr", -0.62)] {
        writer.write_lines(&format!("v {name} =\n\tp 2.062 {y} 0.56\n\tn 1 0 -0.021\nring {name} 0 0.06"));
    }
    writer.material("taillight");
    plate(&mut writer, -2.06, [0.6, 0.7], [0.8, 0.8]);
    plate(&mut writer, -2.06, [-0.8, 0.7], [-0.6, 0.8]);
    writer.material("indicator");
    plate(&mut writer, -2.06, [-0.84, 0.6], [-0.7, 0.67]);
    plate(&mut writer, 2.06, [-0.84, 0.5], [-0.74, 0.58]);
    writer.finish()
}

/// Hazard lights at the four corners.
pub fn hazard() -> String {
    let mut writer = MgfWriter::new("z");
    writer.write_lines("# Hazard lights.");
    writer.material("hazard");
    for x in [-2.06, 2.06] {
        for s in [-1.0, 1.0] {
            let (low, high) = if s < 0.0 { (-0.84, -0.7) } else { (0.7, 0.84) };
            plate(&mut writer, x, [low, 0.5], [high, 0.58]);
        }
    }
    writer.finish()
}
