//! Measures the gain from a first pass. Traces equal samples with several methods, and prints the variance of their means, the
//! processor seconds, and the seconds of the first pass.
//!
//! `cargo run --release -p femc-tests --example two_passes -- SCENE.mgf.. [--methods M,..] [--spp N] [--size N] [--turns N]`
//!
//! Methods: `pt`, `femc`; parts of `femc`: `directions` (no weight window), `roulette` (no splitting), `splitting` (no roulette by
//! the window), `window` (no guided directions); and `LOWER:UPPER` (`femc` with these bounds of the window). The first method is the
//! baseline.
//!
//! One line for each scene and method:
//! - `first s`: processor seconds of the first pass; `s`: of the samples;
//! - `rays`: rays and shadow rays of a sample;
//! - `variance`: variance of the mean of all samples of a pixel, times their number, over the pixel's squared mean + 0.01, averaged
//!   over all pixels and channels, as in relmse. Evenly spread samples have less variance than independent ones; the column `independent` ignores their spread;
//! - `±`: standard error of the variance, %, from the spread over rows of pixels;
//! - `gain`: variance times seconds of the baseline over that of the method; `with first`: with the seconds of the first pass;
//! - `z`: difference of the mean from the baseline's, in standard errors.

use femc_film::Filter;
use femc_math::glam::DVec3;
use femc_math::sampler::{REPLICATES, replicate_of};
use femc_montecarlo::{Guidance, PathSettings, PixelFilter, Tracer, WeightWindow};
use femc_pipeline::radiosity::{self, SolveOptions};
use femc_pipeline::{Field, SceneSource, Settings, prepare_frame};
use femc_prepared::Prepared;
use femc_tests::clock::processor_seconds;
use rayon::prelude::*;
use std::error::Error;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

#[derive(Clone, Copy)]
struct FilterAdapter(Filter);

impl PixelFilter for FilterAdapter {
    fn sample(self, u: [f32; 2]) -> [f32; 2] {
        self.0.sample(u)
    }

    fn density(self, offset: [f32; 2]) -> f32 {
        self.0.density(offset)
    }
}

/// Guidance of the paths of a method. `None`: path tracing alone.
fn guidance<'a>(method: &str, prepared: &Prepared, field: &'a Field) -> Result<Option<Guidance<'a>>, String> {
    let all = Guidance::new(prepared, field);
    let open = WeightWindow { lower: 0.0, upper: f32::INFINITY };
    let window = WeightWindow::default();
    Ok(Some(match method {
        "pt" => return Ok(None),
        "femc" => all,
        "directions" => Guidance { window: open, ..all },
        "roulette" => Guidance { window: WeightWindow { upper: f32::INFINITY, ..window }, ..all },
        "splitting" => Guidance { window: WeightWindow { lower: 0.0, ..window }, ..all },
        "window" => Guidance { samples_directions: false, ..all },
        bounds => {
            let bounds: Vec<f32> = bounds.split(':').filter_map(|bound| bound.parse().ok()).collect();
            let &[lower, upper] = &bounds[..] else { return Err(format!("unknown method {method}")) };
            Guidance { window: WeightWindow { lower, upper }, ..all }
        }
    }))
}

fn main() -> Result<(), Box<dyn Error>> {
    let (mut scenes, mut spp, mut size, mut turns) = (Vec::new(), 128u32, 64u32, 2u32);
    let mut methods = vec!["pt".to_owned(), "femc".to_owned()];
    let mut args = std::env::args().skip(1);
    while let Some(arg) = args.next() {
        let mut value = || args.next().ok_or(format!("{arg} needs a value"));
        match arg.as_str() {
            "--spp" => spp = value()?.parse()?,
            "--size" => size = value()?.parse()?,
            "--methods" => methods = value()?.split(',').map(str::to_owned).collect(),
            "--turns" => turns = value()?.parse()?,
            scene => scenes.push(scene.to_owned()),
        }
    }
    if scenes.is_empty() || spp < 2 * REPLICATES as u32 {
        return Err(
            "usage: two_passes SCENE.mgf.. [--methods M,..] [--spp N] [--size N] [--turns N]; at least 8 samples"
                .into(),
        );
    }
    println!("scene\tmethod\tfirst s\ts\trays\tvariance\t±\tindependent\tgain\twith first\tz");
    for path in scenes {
        let scene = Arc::new(femc_import::load_scene_file(path.as_ref())?.scene);
        let settings = Settings { size: Some([size; 2]), ..Settings::default() };
        let prepared = prepare_frame(&SceneSource::new(scene), &settings, 1, None)?;
        let name = std::path::Path::new(&path).file_stem().unwrap_or_default().to_string_lossy().into_owned();
        let start = processor_seconds().unwrap_or(0.0);
        let options = SolveOptions { error: 1.0, guides: true, ..SolveOptions::default() };
        let solution = radiosity::solve(&prepared, &options, &AtomicBool::new(false)).map_err(|_| "cancelled")?;
        let first = processor_seconds().unwrap_or(0.0) - start;
        let guidances: Result<Vec<_>, _> =
            methods.iter().map(|method| guidance(method, &prepared, &solution.field)).collect();
        let guidances = guidances?;
        let measured = measure(&guidances, &prepared, size, spp, turns);
        let base = &measured[0];
        for (method, of) in methods.iter().zip(&measured) {
            let first = if method == "pt" { 0.0 } else { first };
            let work = |of: &Statistics| of.variance * of.seconds;
            println!(
                "{name}\t{method}\t{first:.2}\t{:.2}\t{:.2}\t{:.5}\t{:.0}\t{:.5}\t{:.2}\t{:.2}\t{:+.2}",
                of.seconds,
                of.rays,
                of.variance,
                100.0 * of.variance_error / of.variance,
                of.independent,
                work(base) / work(of),
                work(base) / (of.variance * (of.seconds + first)),
                (of.mean - base.mean) / (of.error2 + base.error2).sqrt().max(1e-30),
            );
        }
    }
    Ok(())
}

/// Results of one method.
#[derive(Default)]
struct Statistics {
    /// Mean over all pixels, cd/m2, and the square of its standard error.
    mean: f64,
    error2: f64,
    /// Relative variance of a sample of an evenly spread set, its standard error, and that of independent samples.
    variance: f64,
    variance_error: f64,
    independent: f64,
    /// Processor seconds.
    seconds: f64,
    /// Rays and shadow rays of a sample.
    rays: f64,
}

/// Sums of the samples of a pixel: by replicate, and their squares.
#[derive(Clone, Copy, Default)]
struct PixelSums {
    replicates: [DVec3; REPLICATES],
    squares: DVec3,
}

/// Traces the samples of all methods, in alternation.
fn measure(
    guidances: &[Option<Guidance<'_>>],
    prepared: &Prepared,
    size: u32,
    spp: u32,
    turns: u32,
) -> Vec<Statistics> {
    let mut sums = vec![vec![PixelSums::default(); (size * size) as usize]; guidances.len()];
    let mut out: Vec<Statistics> = guidances.iter().map(|_| Statistics::default()).collect();
    for turn in 0..turns {
        for (method, (sums, out)) in sums.iter_mut().zip(&mut out).enumerate() {
            let samples = turn * spp / turns..(turn + 1) * spp / turns;
            let start = processor_seconds().unwrap_or(0.0);
            let rays: u64 = sums
                .par_chunks_mut(size as usize)
                .enumerate()
                .map(|(row, sums)| {
                    // Each method has its own seed, so that their errors are independent.
                    let path = PathSettings { seed: 1 + method as u64, max_depth: 0, single_technique: None };
                    let mut tracer = Tracer::new(prepared, path);
                    if let Some(guidance) = guidances[method] {
                        tracer = tracer.with_guidance(guidance);
                    }
                    for (column, sums) in sums.iter_mut().enumerate() {
                        for sample in samples.clone() {
                            let pixel = row as u32 * size + column as u32;
                            let drawn = tracer.sample(pixel, sample, FilterAdapter(Filter::Box));
                            let value = drawn.color.as_dvec3();
                            sums.replicates[replicate_of(sample)] += value;
                            sums.squares += value * value;
                        }
                    }
                    tracer.counters.rays + tracer.counters.shadow_rays
                })
                .sum();
            out.seconds += processor_seconds().unwrap_or(0.0) - start;
            out.rays += rays as f64 / f64::from(spp) / f64::from(size * size);
        }
    }
    let n = f64::from(spp);
    let mean = |pixel: &PixelSums| pixel.replicates.iter().sum::<DVec3>() / n;
    // All variances are divided by the same mean, because the mean of few samples of a pixel is uncertain.
    let means: Vec<DVec3> = (0..sums[0].len())
        .map(|at| sums.iter().map(|pixels| mean(&pixels[at])).sum::<DVec3>() / sums.len() as f64)
        .collect();
    let area = f64::from(size * size);
    for (pixels, out) in sums.iter().zip(&mut out) {
        let mut rows = vec![0.0; size as usize];
        for (at, (pixel, likely)) in pixels.iter().zip(&means).enumerate() {
            let (mean, count) = (mean(pixel), REPLICATES as f64);
            let square = |difference: DVec3| difference * difference;
            let spread = pixel.replicates.iter().map(|sum| square(*sum * count / n - mean)).sum::<DVec3>();
            let of_mean = spread / (count - 1.0) / count;
            let weight = DVec3::ONE / (likely * likely + 1e-2) / 3.0;
            out.mean += mean.element_sum() / 3.0 / area;
            // At most, because the channels of a sample depend on each other.
            out.error2 += of_mean.element_sum() / 3.0 / (area * area);
            rows[at / size as usize] += of_mean.dot(weight) * n / f64::from(size);
            out.independent += (pixel.squares / n - mean * mean).dot(weight) * n / (n - 1.0) / area;
        }
        out.variance = rows.iter().sum::<f64>() / rows.len() as f64;
        let squares = rows.iter().map(|row| (row - out.variance).powi(2)).sum::<f64>();
        out.variance_error = (squares / (rows.len() as f64 - 1.0) / rows.len() as f64).sqrt();
    }
    out
}
