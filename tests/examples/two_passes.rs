//! What a first pass gains the second one: for each scene the variance of paths that a field guides beside that of paths that nothing
//! guides, at as many samples, and the processor seconds of both and of the first pass.
//!
//! `cargo run --release -p femc-tests --example two_passes -- SCENE.mgf.. [--spp N] [--error E,E..] [--size N] [--image PREFIX]`

use femc_film::Filter;
use femc_math::color::luminance;
use femc_montecarlo::{PathSettings, PixelFilter, Tracer};
use femc_pipeline::radiosity::{self, Options};
use femc_pipeline::{Field, Settings, Source, prepare};
use femc_prepared::Prepared;
use femc_tests::clock::processor_seconds;
use rayon::prelude::*;
use std::error::Error;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

#[derive(Clone, Copy)]
struct Places(Filter);

impl PixelFilter for Places {
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
        let scene = Arc::new(femc_import::load_path(path.as_ref())?.scene);
        let settings = Settings { size: Some([size; 2]), ..Settings::default() };
        let prepared = prepare(&Source::new(scene), &settings, 1, None)?;
        let name = std::path::Path::new(&path).file_stem().unwrap_or_default().to_string_lossy().into_owned();
        for &error in &errors {
            let start = processor_seconds().unwrap_or(0.0);
            let options = Options { error, guides: true, ..Options::default() };
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

/// What samples of one kind gave.
#[derive(Default)]
struct Measured {
    /// By pixel the mean, cd/m2, and the variance of one sample.
    pixels: Vec<[f64; 2]>,
    /// Mean over all pixels, and the square of its standard error.
    mean: f64,
    error2: f64,
    /// Variance of one sample over the squared mean and 0.01, mean over all pixels.
    variance: f64,
    /// Of the processor.
    seconds: f64,
}

/// Of the first against the mean of the other two, without what chance adds.
fn relmse(field: &Measured, others: [&Measured; 2], spp: u32) -> f64 {
    let of = |k: usize| {
        let [a, b, c] = [field.pixels[k], others[0].pixels[k], others[1].pixels[k]];
        let mean = 0.5 * (b[0] + c[0]);
        let chance = (a[1] + 0.25 * (b[1] + c[1])) / f64::from(spp);
        ((a[0] - mean).powi(2) - chance) / (mean * mean + 1e-2)
    };
    (0..field.pixels.len()).map(of).sum::<f64>() / field.pixels.len() as f64
}

/// The same number of samples of paths, of guided ones, and of those that end with the field, by turns.
fn compare(prepared: &Prepared, field: &Field, number: u32, spp: u32) -> [Measured; 3] {
    const TURNS: u32 = 4;
    let mut sums = [(); 3].map(|()| vec![[0.0f64; 2]; number as usize]);
    let mut out = [(); 3].map(|()| Measured::default());
    for turn in 0..TURNS {
        for (which, (sums, out)) in sums.iter_mut().zip(&mut out).enumerate() {
            let samples = turn * spp / TURNS..(turn + 1) * spp / TURNS;
            let start = processor_seconds().unwrap_or(0.0);
            sums.par_chunks_mut(64).enumerate().for_each(|(chunk, sums)| {
                // Other numbers each, so that their differences are chance.
                let path = PathSettings { seed: 1 + which as u64, max_depth: 0, only: None };
                let mut tracer = Tracer::new(prepared, path);
                tracer = match which {
                    0 => tracer,
                    1 => tracer.guided_by(field),
                    _ => tracer.with_field(field),
                };
                for (k, [sum, squares]) in sums.iter_mut().enumerate() {
                    for sample in samples.clone() {
                        let drawn = tracer.sample((chunk * 64 + k) as u32, sample, Places(Filter::Box));
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
    // Both over the same mean: that of few samples of a pixel says little of it.
    let means: Vec<f64> = out[0].pixels.iter().zip(&out[1].pixels).map(|(a, b)| 0.5 * (a[0] + b[0])).collect();
    for out in &mut out {
        let of = |(pixel, mean): (&[f64; 2], &f64)| pixel[1] / (mean * mean + 1e-2);
        out.variance = out.pixels.iter().zip(&means).map(of).sum::<f64>() / f64::from(number);
    }
    out
}
