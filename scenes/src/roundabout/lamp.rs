//! Street lamps: pole, arm, head. The emitter hangs 5 mm below the head's closed housing.
//!
//! Local frame: the pole at the origin, the arm toward +x (over the road), the luminous face at z = 8.

use crate::mgf_writer::{MgfWriter, polar};

/// Luminous face: 0.5 m (x) by 0.22 m (y), at this height.
const HEIGHT: f64 = 8.0;
const FACE: [f64; 4] = [1.35, 1.85, -0.11, 0.11];

fn octagon(radius: f64, z: f64) -> Vec<[f64; 3]> {
    (0..8).map(|k| polar(radius, 45.0 * f64::from(k), z)).collect()
}

/// Pole, arm and housing: 41 polygons.
pub fn body() -> String {
    let mut writer = MgfWriter::new("l");
    writer.write_lines("# A lamp without its light.");
    writer.material("steel");
    writer.prism(&octagon(0.1, 1.3), 1.6);
    writer.prism(&octagon(0.065, HEIGHT - 0.05), HEIGHT - 1.25);
    writer.rod([0.0, 0.0, HEIGHT - 0.12], [0.6, 0.0, HEIGHT + 0.06], 0.045, 4);
    writer.rod([0.57, 0.0, HEIGHT + 0.057], [1.3, 0.0, HEIGHT + 0.09], 0.04, 4);
    writer.material("black");
    // Counterclockwise seen from above. Its underside is 5 mm above the luminous face.
    let z = HEIGHT + 0.135;
    let plan = [
        [1.2, -0.08, z],
        [1.33, -0.15, z],
        [1.88, -0.13, z],
        [1.95, 0.0, z],
        [1.88, 0.13, z],
        [1.33, 0.15, z],
        [1.2, 0.08, z],
    ];
    writer.prism(&plan, 0.13);
    writer.finish()
}

/// A lamp with a Lambertian panel of 0.11 m2: 5000 lm.
pub fn panel_lamp() -> String {
    let [x0, x1, y0, y1] = FACE;
    let mut writer = MgfWriter::new("e");
    writer.write_lines("# A street lamp of 5000 lm: 0.11 m2, one-sided, facing down.\ni lamp-body.mgf");
    writer.material("lamp");
    writer.face(&[[x0, y0, HEIGHT], [x0, y1, HEIGHT], [x1, y1, HEIGHT], [x1, y0, HEIGHT]]);
    writer.finish()
}

/// A lamp whose light is an LM-63 file; C90 (over the road) is the arm's direction.
pub fn measured_lamp() -> String {
    "# A street lamp with measured-style photometry: C90 points along the arm.\n\
     i lamp-body.mgf\n\
     c\n\
     \tcct 3000\n\
     ies road.ies -rz -90 -t 1.6 0 8\n"
        .to_owned()
}

/// The ten lamps of a quarter: pairs along the south approach, two at its mouth, one at the corner, one on the island.
pub fn placements(lamp: &str) -> String {
    let mut writer = MgfWriter::new("p");
    writer.write_lines("# Ten lamps: pairs along the south approach, two at its mouth, one at the south-east corner, one on the island.");
    writer.include(lamp, "-rz 180 -t 4.8 -46 0.12 -a 3 -t 0 -22 0");
    writer.include(lamp, "-t -4.8 -35 0.12 -a 3 -t 0 -22 0");
    writer.include(lamp, "-rz 163 -t 7.2 -22.8 0.12");
    writer.include(lamp, "-rz 17 -t -7.2 -22.8 0.12");
    writer.include(lamp, "-rz 180 -t 19.4 0 0.12 -rz -45");
    writer.include(lamp, "-t 8.6 0 0.35 -rz -68");
    writer.finish()
}
