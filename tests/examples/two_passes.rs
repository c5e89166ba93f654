//! Measures the gain from a first pass. For each scene, compares the variance of guided paths with that of unguided paths at equal
//! samples, and prints the processor seconds of both and of the first pass.
//!
//! `cargo run --release -p femc-tests --example two_passes -- SCENE.mgf.. [--spp N] [--error E,E..] [--size N] [--image PREFIX]`

use femc_film::Filter;
use femc_math::color::luminance;
use femc_montecarlo::{PathSettings, PixelFilter, Tracer};
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

fn main() -> Result<(), Box<dyn Error>> {
    let (mut scenes, mut spp, mut errors, mut size, mut image) = (Vec::new(), 64u32, vec![1.0f32], 128u32, None);
    let mut args = std::env::args().skip(1);
    while let Some(arg) = args.next() {
        let mut value = || args.next().ok_or(format!("{arg} needs a value"));
        match arg.as_str() {
            "--spp" => spp = value()?.parse()?,
            "--size" => size = value()?.parse()?,
            "--error" => errors = value()?.split(',').map(str::parse).collect::<Result<_, _>>()?,
            "--image" => image = Some(value()?),
            scene => scenes.push(scene.to_owned()),
        }
    }
    if scenes.is_empty() || spp < 2 {
        return Err("usage: two_passes SCENE.mgf.. [--spp N] [--error E,E..] [--size N] [--image PREFIX]".into());
    }
    println!(
        "scene\terror\tfirst pass s\tMB\tpaths s\tguided s\tvariance of paths\tof guided\tratio\tefficiency\tz of the mean\tfield over paths\trelmse of the field"
    );
    for path in scenes {
        let scene = Arc::new(femc_import::load_scene_file(path.as_ref())?.scene);
        let settings = Settings { size: Some([size; 2]), ..Settings::default() };
        let prepared = prepare_frame(&SceneSource::new(scene), &settings, 1, None)?;
        let name = std::path::Path::new(&path).file_stem().unwrap_or_default().to_string_lossy().into_owned();
        for &error in &errors {
            let start = processor_seconds().unwrap_or(0.0);
            let options = SolveOptions { error, guides: true, ..SolveOptions::default() };
            let solution = radiosity::solve(&prepared, &options, &AtomicBool::new(false)).map_err(|_| "cancelled")?;
            let first = processor_seconds().unwrap_or(0.0) - start;
            let [plain, guided, field] = compare(&prepared, &solution.field, size * size, spp);
            let ratio = plain.variance / guided.variance;
            println!(
                "{name}\t{error}\t{first:.2}\t{:.1}\t{:.2}\t{:.2}\t{:.5}\t{:.5}\t{ratio:.2}\t{:.2}\t{:+.2}\t{:.3}\t{:.4}",
                solution.report.bytes as f64 / 1e6,
                plain.seconds,
                guided.seconds,
                plain.variance,
                guided.variance,
                ratio * plain.seconds / guided.seconds,
                (guided.mean - plain.mean) / (plain.error2 + guided.error2).sqrt(),
                2.0 * field.mean / (plain.mean + guided.mean),
                relmse(&field, [&plain, &guided], spp),
            );
            if let Some(prefix) = &image {
                for (picture, of) in [("paths", &plain), ("guided", &guided), ("field", &field)] {
                    let scale = 0.25 / plain.mean.max(1e-30);
                    let value = |x: f64| (255.0 * (x * scale).min(1.0).powf(1.0 / 2.2)) as u8;
                    let mut out = format!("P5 {size} {size} 255\n").into_bytes();
                    out.extend(of.pixels.iter().map(|&[mean, _]| value(mean)));
                    std::fs::write(format!("{prefix}-{name}-{error}-{picture}.pgm"), out)?;
                }
            }
        }
    }
    Ok(())
}

/// Results of one kind of samples.
#[derive(Default)]
struct SampleStatistics {
    /// Mean (cd/m2) and variance of one sample, for each pixel.
    pixels: Vec<[f64; 2]>,
    /// Mean over all pixels, and the square of its standard error.
    mean: f64,
    error2: f64,
    /// Variance of one sample, divided by the squared mean plus 0.01 and averaged over all pixels.
    variance: f64,
    /// Processor seconds.
    seconds: f64,
}

/// Computes the relmse of `field` against the mean of the other two, minus their noise.
fn relmse(field: &SampleStatistics, others: [&SampleStatistics; 2], spp: u32) -> f64 {
    let of = |k: usize| {
        let [a, b, c] = [field.pixels[k], others[0].pixels[k], others[1].pixels[k]];
        let mean = 0.5 * (b[0] + c[0]);
        let chance = (a[1] + 0.25 * (b[1] + c[1])) / f64::from(spp);
        ((a[0] - mean).powi(2) - chance) / (mean * mean + 1e-2)
    };
    (0..field.pixels.len()).map(of).sum::<f64>() / field.pixels.len() as f64
}

/// Takes equal numbers of samples from unguided paths, guided paths, and paths that end with the field, in alternation.
fn compare(prepared: &Prepared, field: &Field, number: u32, spp: u32) -> [SampleStatistics; 3] {
    const TURNS: u32 = 4;
    let mut sums = [(); 3].map(|()| vec![[0.0f64; 2]; number as usize]);
    let mut out = [(); 3].map(|()| SampleStatistics::default());
    for turn in 0..TURNS {
        for (which, (sums, out)) in sums.iter_mut().zip(&mut out).enumerate() {
            let samples = turn * spp / TURNS..(turn + 1) * spp / TURNS;
            let start = processor_seconds().unwrap_or(0.0);
            sums.par_chunks_mut(64).enumerate().for_each(|(chunk, sums)| {
                // Each kind has its own seed, so that their errors are independent.
                let path = PathSettings { seed: 1 + which as u64, max_depth: 0, single_technique: None };
                let mut tracer = Tracer::new(prepared, path);
                tracer = match which {
                    0 => tracer,
                    1 => tracer.with_guide(field),
                    _ => tracer.with_field(field),
                };
                for (k, [sum, squares]) in sums.iter_mut().enumerate() {
                    for sample in samples.clone() {
                        let drawn = tracer.sample((chunk * 64 + k) as u32, sample, FilterAdapter(Filter::Box));
                        let value = f64::from(luminance(drawn.color));
                        (*sum, *squares) = (*sum + value, *squares + value * value);
                    }
                }
            });
            out.seconds += processor_seconds().unwrap_or(0.0) - start;
        }
    }
    let n = f64::from(spp);
    for (sums, out) in sums.into_iter().zip(&mut out) {
        out.pixels = sums
            .into_iter()
            .map(|[sum, squares]| [sum / n, (squares / n - (sum / n).powi(2)).max(0.0) * n / (n - 1.0)])
            .collect();
        for &[mean, variance] in &out.pixels {
            out.mean += mean / f64::from(number);
            out.error2 += variance / n / f64::from(number).powi(2);
        }
    }
    // All variances are divided by the same mean, because the mean of few samples of a pixel is uncertain.
    let means: Vec<f64> = out[0].pixels.iter().zip(&out[1].pixels).map(|(a, b)| 0.5 * (a[0] + b[0])).collect();
    for out in &mut out {
        let of = |(pixel, mean): (&[f64; 2], &f64)| pixel[1] / (mean * mean + 1e-2);
        out.variance = out.pixels.iter().zip(&means).map(of).sum::<f64>() / f64::from(number);
    }
    out
}
