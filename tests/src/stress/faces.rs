//! Needles, degenerate faces, duplicate faces and coplanar faces in rooms of uniform radiance: they must be invisible.

use super::ResultLine;
use super::measure::{Case, Effort, measure_all};
use super::room::{camera_inside, furnace, uniform_material, walls};
use crate::text::{horizontal_square, material};
use std::fmt::Write;

pub fn run(effort: &Effort, report: &mut dyn FnMut(ResultLine)) {
    let thing = |rd: f64| material("thing", &[&uniform_material(1.0, rd)]);
    let mut cases = Vec::new();
    // Black lamps are found mostly by light sampling. Bright lamps also scatter light.
    for rd in [0.0, 0.4] {
        let mut add = |name: &str, faces: &str| {
            let text = furnace(1.0, 1.0, 0.5) + &thing(rd) + faces;
            cases.push(Case::new(format!("{name} of reflectance {rd}"), text, 1.0));
        };
        add("needles of 1e-6 by 1 m", &needles(1e-6));
        add("needles of 1e-12 by 1 m", &needles(1e-12));
        add("strips that share their edges", &strips(1000));
        add("faces without area", &degenerate_faces());
        add(
            "a face among faces without area",
            &(degenerate_faces() + &horizontal_square("thing", [0.0, 0.0, 0.5], 0.4)),
        );
        add("faces twice", &horizontal_square("thing", [0.0, 0.0, 0.5], 0.4).repeat(2));
        add("faces five times", &horizontal_square("thing", [0.0, 0.0, 0.5], 0.4).repeat(5));
        add("triangles twice", &TRIANGLE.repeat(2));
        add("balls twice", &"v o =\n p .5 .2 0\nm thing\nsph o .3\n".repeat(2));
        // A shadow ray stops short of its lamp by a rounding margin of some 2e-6 of its length. Of two lamps closer together than
        // this, both are found: with a gap of one micrometer the room is 0.7 % too bright.
        add(
            "faces ten micrometers apart",
            &(horizontal_square("thing", [0.0, 0.0, 0.5], 0.4) + &horizontal_square("thing", [0.0, 0.0, 0.50001], 0.4)),
        );
    }
    for rd in [0.0, 0.4] {
        let room =
            camera_inside(1.0) + &walls(1.0, &uniform_material(1.0, rd)) + &walls(1.0, &uniform_material(1.0, rd));
        cases.push(Case::new(format!("walls twice of reflectance {rd}"), room, 1.0));
    }
    measure_all("faces", &cases, effort, report);
}

const TRIANGLE: &str = "v a =\n p .5 0 -.3\nv b =\n p .6 .5 .4\nv c =\n p .4 -.4 .5\nm thing\nf a b c\n";

/// Returns a hundred triangles of this width.
fn needles(width: f64) -> String {
    let mut text = "m thing\n".to_owned();
    for k in 0..100 {
        let y = f64::from(k) / 100.0 - 0.5;
        let _ = write!(text, "v a =\n p .6 {y} -.5\nv b =\n p .6 {} -.5\nv c =\n p .6 {y} .5\nf a b c\n", y + width);
    }
    text
}

/// Returns a square of 1 m, cut into `count` strips.
fn strips(count: u32) -> String {
    let mut text = "m thing\n".to_owned();
    for k in 0..count {
        let [y, next] = [k, k + 1].map(|k| f64::from(k) / f64::from(count) - 0.5);
        let corners = [(y, -0.5), (next, -0.5), (next, 0.5), (y, 0.5)];
        for (name, (y, z)) in ["a", "b", "c", "d"].iter().zip(corners) {
            let _ = writeln!(text, "v {name} =\n p .6 {y} {z}");
        }
        text += "f a b c d\n";
    }
    text
}

/// Returns points, lines and folded faces, and balls, rings and cylinders with zero or tiny radius or height.
fn degenerate_faces() -> String {
    let vertices = "v a =\n p .5 0 0\n n 1 0 0\nv b =\n p .5 .3 0\nv c =\n p .5 .6 0\nv d =\n p .5 .3 1e-30\n";
    let faces = "f a a a\nf a b b\nf a b c\nf a c b\nf a b c b\nf a b d\nf a b a b\n";
    format!("{vertices}m thing\n{faces}ring a .1 .1000000000000001\nsph a 1e-30\ncyl a 1e-20 b\nring a 0 1e-25\n")
}
