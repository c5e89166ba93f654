//! Computes light in fog along camera rays and around points, with paths and with the first pass. Excludes light that fog scatters
//! directly from light sources.

use crate::rng::Rng;
use femc_field::{FogLine, FogTree};
use femc_math::color::luminance;
use femc_math::glam::{DVec3, Vec3A};
use femc_math::warp;
use femc_montecarlo::record::{LightTechnique, Recording, VertexLocation};
use femc_montecarlo::{PathSettings, PixelFilter, Tracer};
use femc_prepared::Prepared;
use femc_prepared::camera::{CameraPose, KernelCamera};
use femc_prepared::media::{MediaRay, MediumStack};
use rayon::prelude::*;

/// Mean over paths, and its standard error.
#[derive(Clone, Copy, Debug, Default)]
pub struct Estimate {
    /// Mean value.
    pub mean: f64,
    /// Standard error of the mean.
    pub error: f64,
}

impl Estimate {
    fn from_values(values: impl Iterator<Item = f64>) -> Self {
        let (n, sum, squares) =
            values.fold((0.0, 0.0, 0.0), |(n, sum, squares), x| (n + 1.0, sum + x, squares + x * x));
        let mean: f64 = sum / n;
        Self { mean, error: ((squares / n - mean * mean).max(0.0) / (n - 1.0f64).max(1.0)).sqrt() }
    }
}

/// A camera ray, and the luminance that fog on it scatters toward the camera, cd/m2.
#[derive(Clone, Copy, Debug)]
pub struct FogRay {
    /// Origin, prepared frame, m.
    pub origin: Vec3A,
    /// Unit direction.
    pub dir: Vec3A,
    /// Distance of the surface that it hits, m.
    pub length: f32,
    /// Result of the paths.
    pub estimate: Estimate,
}

/// A point in fog, and the mean luminance over all directions, cd/m2.
#[derive(Clone, Copy, Debug)]
pub struct FogPoint {
    /// Position, prepared frame, m.
    pub point: Vec3A,
    /// Result of the paths.
    pub estimate: Estimate,
}

/// Pixel filter that puts all samples at the center of a pixel.
#[derive(Clone, Copy)]
struct PixelCenter;

impl PixelFilter for PixelCenter {
    fn sample(self, _: [f32; 2]) -> [f32; 2] {
        [0.0; 2]
    }

    fn density(self, _: [f32; 2]) -> f32 {
        1.0
    }
}

fn settings(seed: u64) -> PathSettings {
    PathSettings { seed, max_depth: 0, single_technique: None }
}

/// Traces `samples` paths through each of `count` pixel centers, spread over the film.
pub fn trace_rays(prepared: &Prepared, count: u32, samples: u32) -> Vec<FogRay> {
    let [width, height] = prepared.camera.film;
    let trace_ray = |k: u32| {
        // This lattice fills the film evenly.
        let [x, y] = [0.754_877_666_246_692_7, 0.569_840_290_998_053_3].map(|a| (0.5 + a * f64::from(k)).fract());
        let pixel = (y * f64::from(height)) as u32 * width + (x * f64::from(width)) as u32;
        let ray = prepared.camera.view([0.5; 2], 0.5).ray(prepared.camera.center(pixel));
        let length = prepared.world.intersect(&ray).map_or(f32::INFINITY, |hit| hit.t);
        let mut tracer = Tracer::with_recorder(prepared, settings(1), Recording::default());
        let values = (0..samples).map(|sample| {
            tracer.sample(pixel, sample, PixelCenter);
            multiply_scattered(&tracer.recorder)
        });
        FogRay { origin: ray.origin, dir: ray.dir, length, estimate: Estimate::from_values(values) }
    };
    (0..count).into_par_iter().map(trace_ray).collect()
}

/// Returns the light of a path that fog scatters on the camera's segment after at least one other scattering event.
fn multiply_scattered(path: &Recording) -> f64 {
    let Some(first) = path.steps.nodes().first().map(|node| node.step) else { return 0.0 };
    if !matches!(first.vertex.location, VertexLocation::Medium(_)) {
        return 0.0;
    }
    let counts = |(part, vertices): &&(femc_montecarlo::record::Contribution, u32)| {
        let is_straight = part.technique == LightTechnique::EmitterHit
            && path.last_scattering(*vertices).is_some_and(|step| *step == first);
        part.bounce > 0 && !is_straight
    };
    path.contributions.iter().filter(counts).map(|(part, _)| f64::from(luminance(part.color))).sum()
}

/// Draws points where camera rays are scattered, and traces paths in `samples` directions from each.
pub fn trace_points(prepared: &mut Prepared, rays: &[FogRay], samples: u32) -> Vec<FogPoint> {
    let mut media = MediaRay::default();
    let mut rng = Rng::new(3);
    let mut number = move || (rng.bits() >> 40) as f32 / (1u64 << 24) as f32;
    let points: Vec<Vec3A> = rays
        .iter()
        .filter_map(|ray| {
            // The position is uniform in the fraction of the ray's light that the fog removes.
            let scene = &prepared.media;
            scene.find_intervals(ray.origin, ray.dir, ray.length, &MediumStack::default(), &mut media).then_some(())?;
            let (first, last) = scene.scattering_range(&media)?;
            let through = |t: f32, media: &mut MediaRay| {
                scene.find_intervals(ray.origin, ray.dir, t, &MediumStack::default(), media);
                luminance(scene.transmittance(media))
            };
            let end = last.min(first + 1e4);
            let share = number();
            let wanted = 1.0 - share * (1.0 - through(end, &mut media));
            let (mut low, mut high) = (first, end);
            for _ in 0..40 {
                let middle = 0.5 * (low + high);
                if through(middle, &mut media) > wanted { low = middle } else { high = middle }
            }
            Some(ray.origin + ray.dir * low)
        })
        .collect();
    let camera = prepared.camera.clone();
    let camera_emitters = std::mem::take(&mut prepared.camera_emitters);
    let found = points
        .iter()
        .map(|&point| FogPoint { point, estimate: mean_over_directions(prepared, point, samples) })
        .collect();
    (prepared.camera, prepared.camera_emitters) = (camera, camera_emitters);
    found
}

/// Estimates the mean with cameras at the point, one per direction.
fn mean_over_directions(prepared: &mut Prepared, point: Vec3A, samples: u32) -> Estimate {
    const FILM: u32 = 64;
    let mut rng = Rng::new(u64::from(point.x.to_bits()) << 32 | u64::from(point.y.to_bits()));
    let mut number = move || (rng.bits() >> 40) as f32 / (1u64 << 24) as f32;
    let mut values = Vec::new();
    for sample in 0..samples {
        let u = [sample % FILM, sample / FILM].map(|k| (k as f32 + number()) / FILM as f32);
        let dir = warp::direction(1.0 - 2.0 * u[0], (u[1] * FILM as f32 * FILM as f32 / samples as f32).fract());
        let (origin, up) = (point.as_dvec3(), if dir.z.abs() > 0.9 { DVec3::X } else { DVec3::Z });
        let Some(pose) = CameraPose::new(origin, origin + dir.as_dvec3(), up, 1e-4, [1, 1]) else { continue };
        prepared.camera = KernelCamera::new(vec![pose], [1, 1], 0.0, 1.0);
        let mut tracer = Tracer::with_recorder(prepared, settings(u64::from(sample) + 1), Recording::default());
        tracer.sample(0, 0, PixelCenter);
        let path = &tracer.recorder;
        let counts = |(part, _): &&(femc_montecarlo::record::Contribution, u32)| {
            part.bounce > 0 || !matches!(part.technique, LightTechnique::EmitterHit | LightTechnique::CameraNextEvent)
        };
        values.push(path.contributions.iter().filter(counts).map(|(part, _)| f64::from(luminance(part.color))).sum());
    }
    Estimate::from_values(values.into_iter())
}

/// Comparison of a fog tree with paths.
#[derive(Clone, Copy, Debug)]
pub struct FogComparison {
    /// Mean of the tree over the mean of the paths.
    pub ratio: f64,
    /// Root mean square of the differences, minus the variance of the paths, relative to the mean.
    pub rms: f64,
    /// Root mean square of the relative differences, minus the variance of the paths. A tenth of the mean is added to each
    /// denominator.
    pub relative: f64,
    /// Standard error of the ratio.
    pub error: f64,
}

fn compare_pairs(pairs: &[(f64, Estimate)]) -> FogComparison {
    let n = pairs.len() as f64;
    let [have, want] =
        [pairs.iter().map(|pair| pair.0).sum::<f64>() / n, pairs.iter().map(|pair| pair.1.mean).sum::<f64>() / n];
    let square = |(have, Estimate { mean, error }): &(f64, Estimate)| (have - mean).powi(2) - error * error;
    let squares = pairs.iter().map(square).sum::<f64>() / n;
    let relative = pairs.iter().map(|pair| square(pair) / (pair.1.mean + 0.1 * want).powi(2)).sum::<f64>() / n;
    let error = pairs.iter().map(|pair| pair.1.error.powi(2)).sum::<f64>().sqrt() / n / want;
    FogComparison { ratio: have / want, rms: squares.max(0.0).sqrt() / want, relative: relative.max(0.0).sqrt(), error }
}

/// Compares the light along rays.
pub fn compare_rays(fog: &FogTree, rays: &[FogRay]) -> FogComparison {
    let mut line = FogLine::default();
    let mut have = |ray: &FogRay| {
        fog.radiance_along(ray.origin, ray.dir, 0.0, ray.length, &mut line);
        f64::from(line.luminance())
    };
    compare_pairs(&rays.iter().map(|ray| (have(ray), ray.estimate)).collect::<Vec<_>>())
}

/// Compares the mean light over all directions at points.
pub fn compare_points(fog: &FogTree, points: &[FogPoint]) -> FogComparison {
    let have = |at: &FogPoint| f64::from(luminance(fog.mean_radiance(at.point)));
    compare_pairs(&points.iter().map(|at| (have(at), at.estimate)).collect::<Vec<_>>())
}
