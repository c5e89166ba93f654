//! Closed rooms of uniform radiance: the mean is that radiance, whatever the room.

use super::ResultLine;
use super::measure::{Case, Effort, measure_all};
use super::room::{camera_inside, furnace, uniform_material, walls};
use crate::text::{camera, horizontal_square, material};
use std::f64::consts::PI;

/// Returns the target standard error at this albedo.
pub fn sigma(albedo: f64) -> f64 {
    if albedo <= 0.5 { 1e-4 } else { 1e-3 }
}

pub fn run(effort: &Effort, report: &mut dyn FnMut(ResultLine)) {
    let mut cases = albedos();
    cases.extend(luminances());
    cases.extend(sizes());
    cases.extend(objects());
    cases.extend(views());
    measure_all("furnace", &cases, effort, report);
}

fn albedos() -> Vec<Case> {
    let mut cases: Vec<_> = [0.0, 0.5, 0.9, 0.99]
        .map(|rd| Case::new(format!("albedo {rd}"), furnace(1.0, 1.0, rd), 1.0).with_sigma(sigma(rd)))
        .into();
    // A path has a thousand reflections. Russian roulette ends most paths and raises the weights of the others. A standard error of
    // 1e-3 would take ten minutes.
    cases.push(Case::new("albedo 0.999", furnace(1.0, 1.0, 0.999), 1.0).with_sigma(2e-3).as_long());
    // Only a black lamp absorbs, or a mirror of reflectance below 1. Paths end there.
    let lamp = |rd| material("lamp", &[&uniform_material(1.0, rd)]) + &horizontal_square("lamp", [0.0, 0.0, 0.7], 0.3);
    for rd in [0.999, 1.0] {
        let room = camera_inside(1.0) + &walls(1.0, &uniform_material(1.0, rd));
        cases.push(Case::new(format!("albedo {rd} and a black lamp"), room + &lamp(0.0), 1.0));
    }
    let mirrors = |rs: f64, rd: f64| format!("sides 2\n rs {rs} 0\n rd {rd}\n ed {}", PI * (1.0 - rs - rd));
    for (rs, rd) in [(0.5, 0.0), (0.2, 0.3), (0.5, 0.49)] {
        let room = camera_inside(1.0) + &walls(1.0, &mirrors(rs, rd));
        cases.push(Case::new(format!("mirrors {rs}, diffuse {rd}"), room, 1.0).with_sigma(sigma(rs + rd)));
    }
    cases
}

fn luminances() -> Vec<Case> {
    let of = |l: f64| Case::new(format!("luminance {l:e}"), furnace(1.0, l, 0.5), l).with_sigma(1e-3);
    [1e-10, 1e-5, 1e5, 1e10].map(of).into()
}

fn sizes() -> Vec<Case> {
    let of = |half: f64| Case::new(format!("room of {half:e} m"), furnace(half, 1.0, 0.5), 1.0).with_sigma(1e-3);
    [1e-4, 1e-3, 1e-2, 1e2, 1e4, 1e6].map(of).into()
}

/// Objects as bright as the room are invisible in it, whatever their size, lamp or not.
fn objects() -> Vec<Case> {
    let mut cases = Vec::new();
    for size in [1e-4, 1e-2, 1.0, 1e3] {
        for half in [2.0, 3e3].into_iter().filter(|&half| half > size * 1.5) {
            let ball = material("ball", &[&uniform_material(1.0, 0.3)])
                + &format!("v o =\n p {} {} 0\nm ball\nsph o {size}\n", 0.45 * half, -0.3 * half);
            let name = format!("lamp of {size:e} m in a room of {half:e} m");
            cases.push(Case::new(name, furnace(half, 1.0, 0.5) + &ball, 1.0));
        }
    }
    let glass = "m glass =\n c\n sides 1\n ir 1.5 0\n ts 1 0\nm glass\nv o =\n p .6 .3 0\nsph o .3\n";
    cases.push(Case::new("ball of glass", furnace(1.0, 1.0, 0.5) + glass, 1.0));
    cases
}

/// Fraction of the film that a lamp covers, for very narrow and very wide fields of view.
fn views() -> Vec<Case> {
    let mut cases = Vec::new();
    for fov in [1e-3f64, 1.0, 90.0, 170.0, 179.0] {
        // A square at distance 1 with half the width of the image covers a quarter of the film.
        let half = 0.5 * (0.5 * fov).to_radians().tan();
        let view = camera("0 0 -1", "0 0 0", fov).replace("up .1 .2 .9", "up 0 1 0").replace("film 8 8", "film 6 6");
        let text =
            view + &material("lamp", &[&uniform_material(1.0, 0.0)]) + &horizontal_square("lamp", [0.0; 3], half);
        // Directions are rounded to 1e-7, so the borders of the square are uncertain by this relative to the image.
        let slack = 1e-5 + 2e-7 / half;
        cases.push(Case::new(format!("lamp in a field of view of {fov} degrees"), text, 0.25).with_slack(slack));
        let room = furnace(1.0, 1.0, 0.5).replace("fov 60", &format!("fov {fov}"));
        cases.push(Case::new(format!("room in a field of view of {fov} degrees"), room, 1.0));
    }
    cases
}
