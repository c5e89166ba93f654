//! Irradiance at points of a scene's surfaces without direct light of light sources, from paths and from the first pass.

use femc_film::Filter;
use femc_geometry::{Ray, offset_origin};
use femc_math::color::luminance;
use femc_math::glam::{DVec3, Vec3A};
use femc_math::warp;
use femc_montecarlo::record::LightTechnique;
use femc_montecarlo::{PathSettings, Recording, Tracer};
use femc_pipeline::radiosity::{Solution, SolveOptions, solve};
use femc_pipeline::{FilterAdapter, SceneSource, Settings, Side, prepare_frame};
use femc_prepared::Prepared;
use femc_prepared::camera::{CameraPose, KernelCamera};
use femc_scene::Scene;
use rayon::prelude::*;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use crate::rng::Rng;

/// A point of a surface and its irradiance.
#[derive(Clone, Copy, Debug)]
pub struct IrradiancePoint {
    /// Position, prepared frame, m.
    pub position: Vec3A,
    /// Unit normal.
    pub normal: Vec3A,
    /// Luminance-weighted irradiance, lx, and its standard error.
    pub irradiance: [f64; 2],
}

/// Height above the surface from which a point is searched again, as a fraction of the scene's size.
const SEARCH_HEIGHT: f32 = 1e-4;

fn prepare_scene(scene: &Arc<Scene>) -> Result<Prepared, femc_pipeline::PrepareError> {
    prepare_frame(&SceneSource::new(scene.clone()), &Settings::default(), 1, None)
}

/// Draws points spread over all surfaces by area, and estimates their irradiance with paths in `samples` directions each.
/// - errors: the scene cannot be prepared.
pub fn sample_points(
    scene: &Arc<Scene>,
    count: usize,
    samples: u32,
) -> Result<Vec<IrradiancePoint>, femc_pipeline::PrepareError> {
    let world = prepare_scene(scene)?;
    let coarse = SolveOptions { error: 10.0, ..SolveOptions::default() };
    let Ok(Solution { field, .. }) = solve(&world, &coarse, &AtomicBool::new(false)) else { return Ok(Vec::new()) };
    let sums: Vec<f64> = field
        .surfaces
        .iter()
        .scan(0.0, |sum, surface| {
            *sum += f64::from(surface.area());
            Some(*sum)
        })
        .collect();
    if sums.is_empty() {
        return Ok(Vec::new());
    }
    let mut rng = Rng::new(1);
    let mut number = || rng.bits() as f64 / u64::MAX as f64;
    let mut spots = Vec::new();
    while spots.len() < count {
        let at = number() * sums[sums.len() - 1];
        let surface = &field.surfaces[sums.partition_point(|&sum| sum < at).min(sums.len() - 1)];
        let mut place = [number() as f32, number() as f32];
        if matches!(surface.form, femc_pipeline::Form::Triangle(_)) && place[0] + place[1] > 1.0 {
            place = place.map(|x| 1.0 - x);
        }
        let spot = surface.point_at(place.into());
        if find_surface(&world, spot.position, spot.normal).is_some() {
            spots.push(spot);
        }
    }
    let seeds: Vec<u64> = spots.iter().map(|_| (number() * 1e9) as u64).collect();
    let chunks: Vec<_> = spots.chunks(64).zip(seeds.chunks(64)).collect();
    let found: Result<Vec<Vec<IrradiancePoint>>, femc_pipeline::PrepareError> = chunks
        .into_par_iter()
        .map(|(spots, seeds)| {
            let mut world = prepare_scene(scene)?;
            Ok(spots
                .iter()
                .zip(seeds)
                .map(|(spot, &seed)| {
                    let (position, normal) = (spot.position, spot.normal);
                    let irradiance = estimate_irradiance(&mut world, position, spot.error, normal, seed, samples);
                    IrradiancePoint { position, normal, irradiance }
                })
                .collect())
        })
        .collect();
    Ok(found?.into_iter().flatten().collect())
}

/// Estimates the irradiance at a point with paths, without lamps visible from there. Returns it with its standard error.
fn estimate_irradiance(
    world: &mut Prepared,
    position: Vec3A,
    error: Vec3A,
    normal: Vec3A,
    seed: u64,
    samples: u32,
) -> [f64; 2] {
    let mut rng = Rng::new(seed);
    let mut number = || (rng.bits() >> 40) as f32 / (1u64 << 24) as f32;
    let (mut sum, mut squares) = (0.0, 0.0);
    for sample in 0..samples {
        // Uniform on a sphere that touches the point, which gives cosine-weighted directions.
        let dir = (warp::direction(1.0 - 2.0 * number(), number()) + normal).normalize_or(normal);
        let origin = offset_origin(position, error, normal, dir).as_dvec3();
        let up = if dir.z.abs() > 0.9 { DVec3::X } else { DVec3::Z };
        let Some(pose) = CameraPose::new(origin, origin + dir.as_dvec3(), up, 1e-4, [1, 1]) else { continue };
        world.camera = KernelCamera::new(vec![pose], [1, 1], 0.0, 1.0);
        let path = PathSettings { seed, max_depth: 0, single_technique: None };
        let mut tracer = Tracer::with_recorder(world, path, Recording::default());
        tracer.sample(0, sample, FilterAdapter(Filter::default()));
        let straight = |found: &LightTechnique| !matches!(found, LightTechnique::NextEvent | LightTechnique::Airlight);
        let parts = tracer.recorder.contributions.iter().map(|(part, _)| part);
        let value: f32 =
            parts.filter(|part| part.bounce > 0 || !straight(&part.technique)).map(|part| luminance(part.color)).sum();
        let value = f64::from(value) * std::f64::consts::PI;
        (sum, squares) = (sum + value, squares + value * value);
    }
    let n = f64::from(samples);
    let mean = sum / n;
    [mean, ((squares / n - mean * mean).max(0.0) / (n - 1.0)).sqrt()]
}

/// Finds the surface at a point with a ray from above.
fn find_surface(world: &Prepared, position: Vec3A, normal: Vec3A) -> Option<(femc_geometry::Hit, Side)> {
    let above = SEARCH_HEIGHT * world.world.bounds().size().length();
    let ray = Ray { origin: position + normal * above, dir: -normal, t_max: 2.0 * above, time: 0.5 };
    let hit = world.world.intersect(&ray)?;
    let point = world.shading_point(&ray, &hit);
    let side = if point.normal.dot(normal) > 0.0 { Side::Front } else { Side::Back };
    Some((hit, side))
}

/// Comparison of the first pass with paths at the points.
#[derive(Clone, Copy, Debug)]
pub struct IrradianceComparison {
    /// Mean relative squared error over the points, minus the variance of the paths. The denominator is the squared irradiance plus
    /// the square of a tenth of the mean.
    pub relmse: f64,
    /// Like `relmse`, over the points with at least a tenth of the mean. Partly hidden leaves do not dominate there.
    pub lit_relmse: f64,
    /// Ratio of the means.
    pub mean_ratio: f64,
    /// Number of points that were found on a surface.
    pub points: usize,
}

/// Compares a solution of a scene with points.
/// - errors: the scene cannot be prepared.
pub fn compare(
    scene: &Arc<Scene>,
    solution: &Solution,
    points: &[IrradiancePoint],
) -> Result<IrradianceComparison, femc_pipeline::PrepareError> {
    let world = prepare_scene(scene)?;
    let mean = points.iter().map(|point| point.irradiance[0]).sum::<f64>() / points.len() as f64;
    let (mut squares, mut sums, mut count) = ([0.0; 2], [0.0; 2], [0; 2]);
    for IrradiancePoint { position, normal, irradiance: [want, error] } in points {
        let Some((hit, side)) = find_surface(&world, *position, *normal) else { continue };
        let have = f64::from(luminance(solution.field.irradiance(&hit, side, *position, *normal)));
        let square = ((have - want).powi(2) - error * error) / (want * want + 0.01 * mean * mean);
        sums = [sums[0] + have, sums[1] + want];
        for kind in 0..if *want >= 0.1 * mean { 2 } else { 1 } {
            squares[kind] += square;
            count[kind] += 1;
        }
    }
    let [relmse, lit] = [0, 1].map(|kind| squares[kind] / f64::from(count[kind]));
    Ok(IrradianceComparison { relmse, lit_relmse: lit, mean_ratio: sums[0] / sums[1], points: count[0] as usize })
}

/// Reads points from lines of eight numbers: position, normal, irradiance, its standard error. Returns `None` if a line differs.
pub fn parse_points(text: &str) -> Option<Vec<IrradiancePoint>> {
    let lines = text.lines().filter(|line| !line.starts_with('#'));
    lines
        .map(|line| {
            let numbers: Vec<f64> = line.split('\t').map(str::parse).collect::<Result<_, _>>().ok()?;
            let [x, y, z, a, b, c, irradiance, error] = numbers[..] else { return None };
            let vector = |v: [f64; 3]| DVec3::from(v).as_vec3a();
            Some(IrradiancePoint {
                position: vector([x, y, z]),
                normal: vector([a, b, c]),
                irradiance: [irradiance, error],
            })
        })
        .collect()
}
