//! Two rooms connected by an opening, with a lamp in one of them.

use crate::closed_forms::CAMERA;
use std::fmt::Write as _;

/// Position of the wall between the rooms, m along x. The lamp is in front of it.
pub const WALL: f64 = 4.0;

/// Returns rooms of 4 x 4 x 3 m. The opening of 0.5 x 0.5 m, 2 m from the center of the far room, fills 1 % of the hemisphere
/// there.
pub fn two_rooms() -> String {
    let mut text = String::from(CAMERA);
    text.push_str("m wall =\n  rd 0.6\n");
    let mut number = 0;
    let mut face = |text: &mut String, corners: [[f64; 3]; 4]| {
        for (k, [x, y, z]) in corners.into_iter().enumerate() {
            let _ = writeln!(text, "v q{number}_{k} =\n  p {x} {y} {z}");
        }
        let _ = writeln!(text, "f q{number}_0 q{number}_1 q{number}_2 q{number}_3");
        number += 1;
    };
    let across =
        |x: f64, y: [f64; 2], z: [f64; 2]| [[x, y[0], z[0]], [x, y[1], z[0]], [x, y[1], z[1]], [x, y[0], z[1]]];
    for x in [0.0, WALL] {
        let end = x + WALL;
        for z in [0.0, 3.0] {
            face(&mut text, [[x, 0.0, z], [end, 0.0, z], [end, 4.0, z], [x, 4.0, z]]);
        }
        for y in [0.0, 4.0] {
            face(&mut text, [[x, y, 0.0], [end, y, 0.0], [end, y, 3.0], [x, y, 3.0]]);
        }
    }
    face(&mut text, across(0.0, [0.0, 4.0], [0.0, 3.0]));
    face(&mut text, across(2.0 * WALL, [0.0, 4.0], [0.0, 3.0]));
    let (y, z) = ([1.75, 2.25], [1.25, 1.75]);
    face(&mut text, across(WALL, [0.0, 4.0], [0.0, z[0]]));
    face(&mut text, across(WALL, [0.0, 4.0], [z[1], 3.0]));
    face(&mut text, across(WALL, [0.0, y[0]], z));
    face(&mut text, across(WALL, [y[1], 4.0], z));
    text.push_str("m lamp =\n  sides 1\n  ed 1000\n");
    // The lamp shines down beside the opening.
    face(&mut text, [[0.7, 0.7, 2.98], [0.7, 1.3, 2.98], [1.3, 1.3, 2.98], [1.3, 0.7, 2.98]]);
    text
}
