//! Equivalent scenes: scaled, moved, with triangles in another order, rendered with another number of threads (algorithm brief,
//! T16, T17). Random numbers do not depend on any of these, so the samples are equal up to rounding.

use super::ResultLine;
use super::line::Verdict;
use super::measure::Effort;
use crate::rng::Rng;
use crate::text::{block, horizontal_square, material};
use crate::{parse_scene, render_frame};
use femc_film::{Filter, FrameImage};
use femc_math::color::luminance;
use femc_montecarlo::{PathSettings, Tracer};
use femc_pipeline::{FilterAdapter, SceneSource, Settings, StopCondition, prepare_frame};
use rayon::prelude::*;
use std::fmt::Write;
use std::time::Instant;

pub fn run(effort: &Effort, report: &mut dyn FnMut(ResultLine)) {
    let spp = if effort.is_quick() { 4 } else { 64 };
    for scale in [1e-3, 1e-2, 0.1, 10.0, 1e2, 1e3, 1e4] {
        report(compare_means(&format!("scaled by {scale:e}"), &room(1.0, [0.0; 3]), &room(scale, [0.0; 3]), spp));
    }
    for shift in [[1e5, 0.0, 0.0], [-1e5, 1e5, 3e4], [1e6, 1e6, 0.0]] {
        let name = format!("moved by {} m, {} m, {} m", shift[0], shift[1], shift[2]);
        report(compare_bits(&name, &image(&room(1.0, [0.0; 3])), &image(&room(1.0, shift))));
    }
    let begun = terrain(None);
    for seed in 1..=2 {
        report(compare_bits(&format!("triangles in order {seed}"), &image(&begun), &image(&terrain(Some(seed)))));
    }
    report(compare_means("lamps in another order", &lamps(None), &lamps(Some(1)), spp));
    let of = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("threads");
        pool.install(|| image(&room(1.0, [0.0; 3])))
    };
    let one = of(1);
    for threads in [2, 7] {
        report(compare_bits(&format!("with {threads} threads"), &one, &of(threads)));
    }
}

fn image(text: &str) -> FrameImage {
    render_frame(&parse_scene(text), &Settings { stop: StopCondition::Spp(16), seed: 5, ..Settings::default() }, 1)
}

/// Returns a room with a little of everything, scaled by `scale` and moved by `shift`. All coordinates are multiples of 1/64, so
/// that they stay exact when the room moves by whole meters.
fn room(scale: f64, shift: [f64; 3]) -> String {
    let at = |p: [f64; 3]| [0, 1, 2].map(|i| p[i] * scale + shift[i]);
    let words = |p: [f64; 3]| at(p).map(|x| x.to_string()).join(" ");
    let cuboid = |name: &str, low: [f64; 3], high: [f64; 3]| block(name, at(low), at(high));
    let mut text = format!(
        "camera main =\n origin {}\n target {}\n up 0 0 1\n fov 60\n film 16 16\n",
        words([-1.75, -1.5, 1.25]),
        words([0.25, 0.5, 0.5])
    );
    text += &material("wall", &["sides 2", "rd .5"]);
    text += &cuboid("wall", [-2.0, -2.0, 0.0], [2.0, 2.0, 2.5]);
    text += &material("shiny", &["sides 2", "rd .2", "rs .5 .2"]);
    text += &cuboid("shiny", [0.25, 0.5, 0.0], [1.0, 1.25, 0.75]);
    text += &material("lamp", &["sides 1", "ed 300"]);
    let lamp = horizontal_square("lamp", at([0.5, -0.5, 2.375]), 0.25 * scale);
    text += &lamp.replace("f qa qb qc qd", "f qd qc qb qa");
    let bulb = material("bulb", &["sides 1", "ed 3e4"]);
    let _ = write!(text, "{bulb}v o =\n p {}\nm bulb\nsph o {}\n", words([-0.5, 1.0, 1.5]), scale / 64.0);
    let _ = write!(
        text,
        "{}v g =\n p {}\nm glass\nsph g {}\n",
        material("glass", &["sides 1", "ir 1.5 0", "ts 1 0"]),
        words([-0.5, 0.0, 0.375]),
        0.375 * scale
    );
    let _ = writeln!(text, "medium fog =\n sigma_s {}\n sigma_a {}\n phase hg .5", 0.3 / scale, 0.05 / scale);
    let _ = writeln!(text, "mbox fog {} {}", words([-1.5, -1.5, 0.25]), words([1.5, 1.5, 1.5]));
    text
}

/// Draws a number in 0..1.
fn unit(rng: &mut Rng) -> f64 {
    (rng.bits() >> 40) as f64 / (1u64 << 24) as f64
}

/// Shuffles items with a seed (Fisher and Yates). Without a seed, keeps their order.
fn shuffled<T>(mut items: Vec<T>, seed: Option<u64>) -> Vec<T> {
    let Some(seed) = seed else { return items };
    let mut rng = Rng::new(seed);
    for last in (1..items.len()).rev() {
        items.swap(last, (unit(&mut rng) * (last + 1) as f64) as usize);
    }
    items
}

const VIEW: &str = "camera main =\n origin -2.5 -2 2\n target 0 0 .2\n up 0 0 1\n fov 50\n film 16 16\n";

/// Returns 800 triangles under a lamp, in any order.
fn terrain(order: Option<u64>) -> String {
    let mut rng = Rng::new(7);
    let n = 20;
    let heights: Vec<f64> = (0..=n * n + 2 * n).map(|_| 0.3 * unit(&mut rng)).collect();
    let vertex = |i: usize, j: usize| {
        format!("v v{i}x{j} =\n p {} {} {}\n", 0.2 * i as f64 - 2.0, 0.2 * j as f64 - 2.0, heights[i * (n + 1) + j])
    };
    let vertices: String = (0..=n).flat_map(|i| (0..=n).map(move |j| (i, j))).map(|(i, j)| vertex(i, j)).collect();
    let cells = (0..n).flat_map(|i| (0..n).map(move |j| (i, j)));
    let faces = cells.flat_map(|(i, j)| {
        let (a, b) = (i + 1, j + 1);
        [format!("f v{i}x{j} v{a}x{j} v{a}x{b}\n"), format!("f v{i}x{j} v{a}x{b} v{i}x{b}\n")]
    });
    let faces: String = shuffled(faces.collect(), order).concat();
    let lamp = material("lamp", &["sides 2", "ed 100"]) + &horizontal_square("lamp", [0.3, 0.2, 2.5], 0.5);
    format!("{VIEW}{lamp}{}{vertices}m ground\n{faces}", material("ground", &["sides 2", "rd .6"]))
}

/// Returns 50 lamps of different brightness over a floor, in any order.
fn lamps(order: Option<u64>) -> String {
    let mut rng = Rng::new(9);
    let lamp = |k: u32| {
        let at = [0; 3].map(|_| 2.0 * unit(&mut rng) - 1.0);
        let ed = 10.0 * f64::from(k);
        format!("m lamp =\n c\n sides 2\n ed {ed}\n{}", horizontal_square("lamp", [at[0], at[1], 1.5 + at[2]], 0.1))
    };
    let lamps: Vec<String> = (1..=50).map(lamp).collect();
    let floor = material("floor", &["sides 2", "rd .6"]) + &horizontal_square("floor", [0.0; 3], 3.0);
    format!("{VIEW}{floor}{}", shuffled(lamps, order).concat())
}

/// Counts the pixels whose bits differ.
fn compare_bits(name: &str, a: &FrameImage, b: &FrameImage) -> ResultLine {
    let begun = Instant::now();
    let bits = |image: &FrameImage| image.color.pixels.iter().map(|p| p.map(f32::to_bits)).collect::<Vec<_>>();
    let differ = bits(a).iter().zip(bits(b)).filter(|(a, b)| **a != *b).count() as u64;
    let pixels = a.color.pixels.len() as u64;
    ResultLine::faults(
        format!("same: {name}: differing pixels"),
        differ,
        pixels,
        begun.elapsed().as_secs_f64(),
        "pixels differ",
    )
}

/// Compares the means of `b` and `a`, from pairs of renderings with equal seeds.
fn compare_means(name: &str, a: &str, b: &str, spp: u32) -> ResultLine {
    const PAIRS: u64 = 64;
    let begun = Instant::now();
    let [a, b] = [a, b].map(|text| {
        prepare_frame(&SceneSource::new(parse_scene(text)), &Settings::default(), 1, None).expect("a frame")
    });
    let [width, height] = a.camera.film;
    let pair = |seed: u64| {
        let mut tracers =
            [&a, &b].map(|it| Tracer::new(it, PathSettings { seed, max_depth: 0, single_technique: None }));
        let (mut sums, mut bad) = ([0.0; 2], 0u64);
        for pixel in 0..width * height {
            for index in 0..spp {
                for (sum, tracer) in sums.iter_mut().zip(&mut tracers) {
                    let color = tracer.sample(pixel, index, FilterAdapter(Filter::Box)).color;
                    let is_good = color.is_finite() && color.min_element() >= 0.0;
                    bad += u64::from(!is_good);
                    *sum += if is_good { f64::from(luminance(color)) } else { 0.0 };
                }
            }
        }
        (sums.map(|sum| sum / f64::from(width * height * spp)), bad)
    };
    let pairs: Vec<_> = (1..=PAIRS).into_par_iter().map(pair).collect();
    let n = PAIRS as f64;
    let [mean_a, mean_b] = [0, 1].map(|k| pairs.iter().map(|(means, _)| means[k]).sum::<f64>() / n);
    let spread = pairs.iter().map(|(means, _)| (means[1] - means[0] - (mean_b - mean_a)).powi(2)).sum::<f64>();
    let error = (spread / (n - 1.0) / n).sqrt() / mean_a;
    let bad = pairs.iter().map(|it| it.1).sum();
    let value = mean_b / mean_a;
    let is_near = (value - 1.0).abs() <= 4.0 * error + 1e-5 && bad == 0;
    let verdict = if is_near { Verdict::Holds } else { Verdict::Fails("the means differ".into()) };
    let samples = PAIRS * u64::from(width * height * spp);
    let seconds = begun.elapsed().as_secs_f64();
    ResultLine {
        name: format!("same: {name}: ratio of the means"),
        value,
        error,
        truth: 1.0,
        samples,
        bad,
        seconds,
        verdict,
    }
}
