//! Generates scenes with any number of faces. Equal arguments give equal scenes.

use crate::closed_forms::CAMERA;
use crate::rng::Rng;
use std::fmt::Write as _;

/// Kind of scene.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// A closed room with boxes on the floor and four lamps at the ceiling.
    Room,
    /// Hilly ground under four lamps.
    Terrain,
}

fn vertex(text: &mut String, name: &str, [x, y, z]: [f64; 3]) {
    let _ = writeln!(text, "v {name} =\n  p {x:.6} {y:.6} {z:.6}");
}

/// Generates a scene of about `faces` faces. Returns its text and the exact number.
pub fn generate_scene(kind: Kind, faces: usize) -> (String, usize) {
    let mut text = String::from(CAMERA);
    let mut rng = Rng::new(faces as u64);
    let mut number = || rng.bits() as f64 / u64::MAX as f64;
    let (size, height) = (10.0, 3.0);
    let mut count = 0;
    text.push_str("m lamp =\n  sides 1\n  ed 1000\n");
    for k in 0..4 {
        let [x, y] = [k % 2, k / 2].map(|k| size * (0.25 + 0.5 * f64::from(k)));
        for (corner, [a, b]) in [[-0.3, -0.3], [-0.3, 0.3], [0.3, 0.3], [0.3, -0.3]].into_iter().enumerate() {
            vertex(&mut text, &format!("l{k}{corner}"), [x + a, y + b, height - 0.02]);
        }
        let _ = writeln!(text, "f l{k}0 l{k}1 l{k}2 l{k}3");
    }
    if kind == Kind::Terrain {
        text.push_str("m ground =\n  rd 0.4\n");
        let n = (faces as f64).sqrt().round() as usize;
        for k in 0..(n + 1) * (n + 1) {
            let at = [k % (n + 1), k / (n + 1)].map(|k| size * k as f64 / n as f64);
            let hills = (at[0] * 1.3).sin() * (at[1] * 1.1).cos() + 0.2 * (at[0] * 5.0).sin() * (at[1] * 6.0).sin();
            vertex(&mut text, &format!("g{k}"), [at[0], at[1], 0.5 + 0.4 * hills]);
        }
        for k in 0..n * n {
            let a = k / n * (n + 1) + k % n;
            let [b, c, d] = [a + 1, a + n + 2, a + n + 1];
            // A quadrilateral on a hill is not planar, so it becomes two triangles.
            let _ = writeln!(text, "f g{a} g{b} g{c}\nf g{a} g{c} g{d}");
            count += 2;
        }
        return (text, count);
    }
    text.push_str("m wall =\n  sides 1\n  rd 0.6\n");
    for (k, at) in
        [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0, 0, 1], [1, 0, 1], [1, 1, 1], [0, 1, 1]].iter().enumerate()
    {
        let scale = [size, size, height];
        vertex(&mut text, &format!("p{k}"), [0, 1, 2].map(|axis| f64::from(at[axis]) * scale[axis]));
    }
    for face in ["p0 p1 p2 p3", "p7 p6 p5 p4", "p0 p4 p5 p1", "p1 p5 p6 p2", "p2 p6 p7 p3", "p3 p7 p4 p0"] {
        let _ = writeln!(text, "f {face}");
        count += 1;
    }
    let n = ((faces as f64 / 5.0).sqrt().round() as usize).max(1);
    let cell = size / n as f64;
    for k in 0..n * n {
        let _ = writeln!(text, "m box{} =\n  sides 1\n  rd {:.3}", k % 5, 0.2 + 0.12 * (k % 5) as f64);
        let wide = cell * (0.3 + 0.4 * number());
        let [x, y] = [k % n, k / n].map(|k| (k as f64 + 0.1 + 0.2 * number()) * cell);
        let top = cell * (0.2 + 1.3 * number());
        let corners = [[0.0, 0.0], [wide, 0.0], [wide, wide], [0.0, wide]];
        for (corner, [a, b]) in corners.into_iter().enumerate() {
            vertex(&mut text, &format!("a{corner}"), [x + a, y + b, 0.0]);
            vertex(&mut text, &format!("b{corner}"), [x + a, y + b, top]);
        }
        let _ = writeln!(text, "f b0 b1 b2 b3");
        for side in 0..4 {
            let next = (side + 1) % 4;
            let _ = writeln!(text, "f a{side} a{next} b{next} b{side}");
        }
        count += 5;
    }
    (text, count)
}
