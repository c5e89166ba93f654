//! A two-story house with glowing windows.
//!
//! Local frame: 10 m along x, 8 m along y, the front faces -y. Emitters lie 2 cm in front of the wall, on a white panel.

use crate::mgf_writer::{MgfWriter, Point};

/// A window: center on the wall (x along it, z up), and the material of its pane.
type Window = (f64, f64, &'static str);

const FRONT: [Window; 5] = [
    (-3.2, 1.6, "window_warm"),
    (3.2, 1.6, "window_warm"),
    (-3.2, 4.2, "darkglass"),
    (0.0, 4.2, "window_cool"),
    (3.2, 4.2, "darkglass"),
];
const SIDE: [Window; 3] = [(-2.0, 1.6, "window_warm"), (2.0, 4.2, "window_cool"), (-2.0, 4.2, "darkglass")];
const BACK: [Window; 3] = [(-2.5, 1.6, "window_cool"), (2.5, 1.6, "darkglass"), (1.0, 4.2, "window_warm")];

/// The house: seven polygons and its parts.
pub fn house() -> String {
    let mut writer = MgfWriter::new("h");
    writer.write_lines("# A house, 10 m by 8 m, 8.2 m high; the front faces -y.");
    writer.material("wall");
    let gable = [[-4.0, -0.2], [4.0, -0.2], [4.0, 5.2], [0.0, 8.0], [-4.0, 5.2]];
    let outline: Vec<Point> = gable.iter().map(|p| [5.0, p[0], p[1]]).collect();
    writer.prism(&outline, 10.0);
    writer.material("roof");
    for side in [-1.0, 1.0] {
        // 2 cm above the walls. The two slabs stay 6 mm apart at the ridge.
        let mut slab: Vec<Point> =
            [[0.003, 8.03], [4.5, 4.88], [4.58, 4.99], [0.003, 8.2]].map(|p| [5.4, side * p[0], p[1]]).to_vec();
        if side < 0.0 {
            slab.reverse(); // counterclockwise seen from +x again
        }
        writer.prism(&slab, 10.8);
    }
    writer.material("wall");
    writer.block([2.6, 1.0, 6.2], [3.3, 1.7, 9.1]);
    writer.material("bark");
    writer.block([-0.55, -4.06, -0.1], [0.55, -3.9, 2.15]);
    writer.material("paving");
    writer.block([-0.9, -5.0, -0.25], [0.9, -3.85, 0.08]);
    let walls: [(&str, &[Window]); 4] = [
        ("-t 0 -4 0", &FRONT),
        ("-t 0 -4 0 -rz 180", &BACK),
        ("-t 0 -5 0 -rz 90", &SIDE),
        ("-t 0 -5 0 -rz -90", &SIDE),
    ];
    for (place, windows) in walls {
        for (x, z, material) in windows {
            writer.push_transform(&format!("-t {x} 0 {z} {place}"));
            writer.include("window.mgf", "");
            writer.material(material);
            writer.face(&[[-0.55, -0.02, -0.65], [0.55, -0.02, -0.65], [0.55, -0.02, 0.65], [-0.55, -0.02, 0.65]]);
            writer.pop_transform();
        }
    }
    writer.finish()
}

/// A window's frame and bar, without its pane: 13 polygons.
pub fn window() -> String {
    let mut writer = MgfWriter::new("w");
    writer.write_lines("# A window's frame, bar and sill; the pane is the house's business.");
    writer.material("white");
    writer.face(&[[-0.65, -0.01, -0.75], [0.65, -0.01, -0.75], [0.65, -0.01, 0.75], [-0.65, -0.01, 0.75]]);
    writer.block([-0.025, -0.06, -0.7], [0.025, -0.03, 0.7]);
    writer.block([-0.75, -0.12, -0.82], [0.75, 0.05, -0.76]);
    writer.finish()
}
