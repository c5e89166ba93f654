//! Relative variance and work of samples by method, for measurements.

use crate::clock::processor_seconds;
use femc_film::Filter;
use femc_math::glam::DVec3;
use femc_math::sampler::{REPLICATES, replicate_of};
use femc_montecarlo::{Guidance, Packet, PathSettings, Tracer};
use femc_pipeline::FilterAdapter;
use femc_prepared::Prepared;
use rayon::prelude::*;

/// Results of one method.
#[derive(Debug, Default)]
pub struct MethodStatistics {
    /// Mean over all pixels and channels, cd/m2.
    pub mean: f64,
    /// Square of the mean's standard error.
    pub error2: f64,
    /// Relative variance of a sample of an evenly spread set.
    pub variance: f64,
    /// Standard error of the variance.
    pub variance_error: f64,
    /// Relative variance of independent samples.
    pub independent: f64,
    /// Processor seconds.
    pub seconds: f64,
    /// Rays and shadow rays of a sample.
    pub rays: f64,
    /// Vertices of a sample at which lobes sample a share of the directions.
    pub guided: f64,
}

/// Sums of the samples of a pixel: by replicate, and their squares.
#[derive(Clone, Copy, Default)]
struct PixelSums {
    replicates: [DVec3; REPLICATES],
    squares: DVec3,
}

/// Traces samples with several methods, in alternation.
/// - `guidances`: the guidance of each method; `None`: path tracing alone;
/// - `size`: edge of the square film of `prepared`, pixels;
/// - `spp`: samples of each pixel, in `turns` parts.
pub fn measure(
    guidances: &[Option<Guidance<'_>>],
    prepared: &Prepared,
    size: u32,
    spp: u32,
    turns: u32,
) -> Vec<MethodStatistics> {
    let mut sums = vec![vec![PixelSums::default(); (size * size) as usize]; guidances.len()];
    let mut out: Vec<MethodStatistics> = guidances.iter().map(|_| MethodStatistics::default()).collect();
    for turn in 0..turns {
        for (method, (sums, out)) in sums.iter_mut().zip(&mut out).enumerate() {
            let samples = turn * spp / turns..(turn + 1) * spp / turns;
            let start = processor_seconds().unwrap_or(0.0);
            let work: Vec<[u64; 2]> = sums
                .par_chunks_mut(size as usize)
                .enumerate()
                .map(|(row, sums)| {
                    // Each method has its own seed, so that their errors are independent.
                    let path = PathSettings { seed: 1 + method as u64, max_depth: 0, single_technique: None };
                    let tracer = || match guidances[method] {
                        Some(guidance) => Tracer::new(prepared, path).with_guidance(guidance),
                        None => Tracer::new(prepared, path).with_first_branches(prepared.first_branches),
                    };
                    let mut packet = Packet::new(tracer);
                    let first = row as u32 * size;
                    let numbers =
                        (first..first + size).flat_map(|pixel| samples.clone().map(move |sample| (pixel, sample)));
                    packet.trace(numbers, FilterAdapter(Filter::Box), |(pixel, sample), drawn| {
                        let sums = &mut sums[(pixel - first) as usize];
                        let value = drawn.color.as_dvec3();
                        sums.replicates[replicate_of(sample)] += value;
                        sums.squares += value * value;
                    });
                    let counters = packet.counters();
                    [counters.rays + counters.shadow_rays, counters.guided]
                })
                .collect();
            out.seconds += processor_seconds().unwrap_or(0.0) - start;
            let sum = |at: usize| work.iter().map(|row| row[at]).sum::<u64>() as f64 / f64::from(spp * size * size);
            out.rays += sum(0);
            out.guided += sum(1);
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
