//! Very many lamps (algorithm brief, T15), compared with their brute-force sum.

use super::ResultLine;
use super::measure::{Case, Effort, measure_all};
use crate::rng::Rng;
use crate::text::{camera, horizontal_square, material};
use std::f64::consts::PI;
use std::fmt::Write;

const RHO: f64 = 0.5;

pub fn run(effort: &Effort, report: &mut dyn FnMut(ResultLine)) {
    let cases = vec![random(100), random(10_000), random(100_000), lattice(100), lattice(316).as_long()];
    measure_all("lights", &cases, effort, report);
}

fn scene(lamps: &str) -> String {
    let view = camera("0 -1e-4 .01", "0 0 0", 0.01);
    let floor = material("floor", &["sides 2", &format!("rd {RHO}")]) + &horizontal_square("floor", [0.0; 3], 30.0);
    view + &floor + lamps
}

/// Returns the irradiance over pi of a ball of 1 cd/m2 at the origin: (r/d)^2 cos.
fn share(at: [f64; 3], r: f64) -> f64 {
    let square = at.iter().map(|x| x * x).sum::<f64>();
    r * r / square * at[2] / square.sqrt()
}

/// Balls of four brightnesses and random radii, at random positions in a block of 20 by 20 by 10 m. They hide each other from the
/// point with a probability of 1e-5.
fn random(count: u32) -> Case {
    let mut rng = Rng::new(u64::from(count));
    let mut unit = || (rng.bits() >> 40) as f64 / (1u64 << 24) as f64;
    let (mut text, mut sum) = (String::new(), 0.0);
    for k in 0..4 {
        text += &material(&format!("lamp{k}"), &["sides 1", &format!("ed {}", PI * 10f64.powi(k))]);
    }
    for _ in 0..count {
        let at = [20.0 * unit() - 10.0, 20.0 * unit() - 10.0, 1.0 + 10.0 * unit()].map(|x| (x * 1e4).round() / 1e4);
        let k = (4.0 * unit()) as i32;
        let r = 1e-4 * (1.0 + (4.0 * unit()).floor());
        sum += 10f64.powi(k) * share(at, r);
        let _ = write!(text, "v o =\n p {} {} {}\nm lamp{k}\nsph o {r}\n", at[0], at[1], at[2]);
    }
    Case::new(format!("{count} lamps at random"), scene(&text), RHO * sum).with_slack(1e-4)
}

/// n x n x 10 balls from nested arrays.
fn lattice(n: u32) -> Case {
    let step = 20.0 / f64::from(n);
    let lamp = material("lamp", &["sides 1", &format!("ed {}", PI * 1e4)]);
    let text = format!(
        "{lamp}xf -t -9.913 -9.871 1.037 -a {n} -t {step} 0 0 -i 1 -a {n} -t 0 {step} 0 -i 1 -a 10 -t 0 0 1\nv o =\n p 0 0 0\nm lamp\nsph o 1e-4\nxf\n"
    );
    // Seen from the origin, no lamp hides another. In a lattice centered at the origin, each lamp would hide the one at three times
    // its position.
    let at = |start: f64, k: u32| start + step * f64::from(k);
    let mut sum = 0.0;
    for z in 0..10 {
        for y in 0..n {
            sum += (0..n).map(|x| share([at(-9.913, x), at(-9.871, y), 1.037 + f64::from(z)], 1e-4)).sum::<f64>();
        }
    }
    Case::new(format!("{} lamps in a lattice", 10 * n * n), scene(&text), RHO * 1e4 * sum).with_slack(1e-4)
}
