//! Light sources, each as one lamp, and rays of their emitted light.

use super::{Bounds, BoxTree, EmissionSampler, Ray, Scope, SplitMix64, emits};
use crate::description::{Facing, Location, Opening, Shape, Sides};
use femc_math::Transform;
use femc_math::elementary::double::{cos, pow, sin_cos};
use femc_math::glam::DVec3;
use std::f64::consts::{PI, TAU};
use std::ops::ControlFlow;

/// Maximum number of samples on an opening until one faces the direction of the light.
const DRAWS: u32 = 32;

/// A light source.
pub(crate) struct LightSource<'a> {
    /// Location of its first part in the order of the scene.
    pub location: Location,
    kind: SourceKind<'a>,
}

enum SourceKind<'a> {
    /// A placed luminaire.
    Luminaire { to_world: Transform, photometry: usize, opening: &'a Opening, multiplier: f64 },
    /// Touching surfaces of one material, with the cumulative sum of their areas.
    Surfaces { parts: Vec<(f64, Part)>, material: usize },
}

/// A part of an emitting surface, by index.
#[derive(Clone, Copy)]
enum Part {
    Triangle(usize),
    Quadric(usize),
}

/// Light that leaves a source.
#[derive(Clone, Copy, Debug)]
pub(crate) struct EmittedRay {
    pub ray: Ray,
    /// Normal of the emitting side; `None` if the source is a point.
    pub normal: Option<DVec3>,
}

/// Groups touching items. Members of a group are in ascending order, and groups are in the order of their first members.
/// - `gap`: distance up to which bounds touch.
pub(crate) fn group_touching(bounds: &[Bounds], gap: f64, is_alike: impl Fn(usize, usize) -> bool) -> Vec<Vec<usize>> {
    let tree = BoxTree::new(bounds);
    let mut is_taken = vec![false; bounds.len()];
    let mut groups = Vec::new();
    for first in 0..bounds.len() {
        if is_taken[first] {
            continue;
        }
        let (mut group, mut next) = (vec![first], 0);
        is_taken[first] = true;
        while let Some(&index) = group.get(next) {
            next += 1;
            let _never_stops = tree.visit_overlapping(&bounds[index].grown(gap), |other| {
                if !is_taken[other] && is_alike(other, index) {
                    is_taken[other] = true;
                    group.push(other);
                }
                ControlFlow::Continue(())
            });
        }
        group.sort_unstable();
        groups.push(group);
    }
    groups
}

/// Returns all light sources that emit at some time: luminaires first, then surfaces, each in the order of the scene.
pub(crate) fn light_sources<'a>(scope: &Scope<'a>) -> Vec<LightSource<'a>> {
    let scene = scope.scene;
    let luminaires = scope.luminaires.iter().filter_map(|placed| {
        let photometry = placed.luminaire.photometry.index();
        let opening = &scene.photometry.get(photometry)?.opening;
        let multiplier = placed.luminaire.multiplier;
        let kind = SourceKind::Luminaire { to_world: placed.to_world, photometry, opening, multiplier };
        Some(LightSource { location: placed.luminaire.location, kind })
    });
    let emits: Vec<bool> = scene.materials.iter().map(|material| emits(scope, material)).collect();
    let is_lamp = |material: usize| emits.get(material) == Some(&true);
    let triangles = scope.triangles.iter().enumerate().filter(|(_, triangle)| is_lamp(triangle.material.index()));
    let triangles = triangles.map(|(index, triangle)| {
        let area = 0.5 * triangle.cross().length();
        (Part::Triangle(index), area, triangle.bounds(), triangle.material.index(), triangle.location)
    });
    let quadrics = scope.quadrics.iter().enumerate().filter(|(_, quadric)| is_lamp(quadric.material.index()));
    let quadrics = quadrics.map(|(index, quadric)| {
        let area = shape_area(&quadric.shape);
        (Part::Quadric(index), area, quadric.bounds(), quadric.material.index(), quadric.location)
    });
    let parts: Vec<_> = triangles.chain(quadrics).collect();
    let bounds: Vec<Bounds> = parts.iter().map(|part| part.2).collect();
    let groups = group_touching(&bounds, 1e-6 * scope.bounds.diagonal(), |a, b| parts[a].3 == parts[b].3);
    let surfaces = groups.into_iter().map(|group| {
        let (mut sum, first) = (0.0, &parts[group[0]]);
        let with_sum = group.iter().map(|&index| {
            sum += parts[index].1;
            (sum, parts[index].0)
        });
        let kind = SourceKind::Surfaces { parts: with_sum.collect(), material: first.3 };
        LightSource { location: first.4, kind }
    });
    luminaires.chain(surfaces).collect()
}

impl LightSource<'_> {
    /// Returns whether the source has no size, so that no path can hit it.
    pub fn is_point(&self) -> bool {
        matches!(self.kind, SourceKind::Luminaire { opening: Opening::Point, .. })
    }

    /// Returns the luminous flux, lm, at the start of the clip.
    /// - `fluxes`: luminous flux of each photometric file.
    pub fn lumens(&self, scope: &Scope<'_>, fluxes: &[f64]) -> f64 {
        match &self.kind {
            SourceKind::Luminaire { photometry, multiplier, .. } => {
                fluxes.get(*photometry).map_or(0.0, |lm| lm * multiplier)
            }
            SourceKind::Surfaces { parts, material } => {
                let (area, material) = (parts.last().map_or(0.0, |part| part.0), &scope.scene.materials[*material]);
                let sides = if material.sides == Sides::Two { 2.0 } else { 1.0 };
                material.ed.photometric_amount() * area * sides
            }
        }
    }

    /// Samples a ray of the emitted light; `None` if the sample emits nothing.
    /// - `samplers`: emission directions of each photometric file.
    /// - `at`: position in the cumulative emission, in [0, 1).
    pub fn emit(
        &self,
        scope: &Scope<'_>,
        samplers: &[Option<EmissionSampler>],
        at: f64,
        rng: &mut SplitMix64,
    ) -> Option<EmittedRay> {
        match &self.kind {
            SourceKind::Luminaire { to_world, photometry, opening, .. } => {
                let local = samplers.get(*photometry)?.as_ref()?.sample_direction(at, rng);
                let dir = to_world.transform_vector3(local).try_normalize()?;
                let ray = |origin| Ray { origin, dir, far: f64::INFINITY };
                let (point, normal) = sample_opening(opening, local, rng)?;
                let Some(normal) = normal else {
                    return Some(EmittedRay { ray: ray(to_world.translation), normal: None });
                };
                let normal = to_world.transform_vector3(normal).try_normalize()?;
                let origin = to_world.transform_point3(point) + 2.0 * scope.offset() * normal;
                Some(EmittedRay { ray: ray(origin), normal: Some(normal) })
            }
            SourceKind::Surfaces { parts, material } => {
                let sum = parts.last().map_or(0.0, |part| part.0);
                let index = parts.partition_point(|part| part.0 <= at * sum).min(parts.len() - 1);
                let (place, front) = sample_part(scope, parts[index].1, rng);
                let material = scope.scene.materials.get(*material)?;
                let is_back = material.sides == Sides::Two && rng.next_f64() < 0.5;
                let normal = if is_back { -front } else { front };
                let dir = match material.lobe {
                    None => (normal + 0.999 * rng.direction()).try_normalize()?,
                    Some(exponent) => {
                        direction_at_cosine(normal, pow(1.0 - rng.next_f64(), 1.0 / (exponent.max(0.0) + 2.0)), rng)
                    }
                };
                let origin = place + 2.0 * scope.offset() * normal;
                Some(EmittedRay { ray: Ray { origin, dir, far: f64::INFINITY }, normal: Some(normal) })
            }
        }
    }
}

/// Returns a random direction at this cosine to an axis.
fn direction_at_cosine(axis: DVec3, cosine: f64, rng: &mut SplitMix64) -> DVec3 {
    let (sin, cos) = sin_cos(TAU * rng.next_f64());
    let u = axis.any_orthonormal_vector();
    let across = cos * u + sin * axis.cross(u);
    (cosine * axis + (1.0 - cosine * cosine).max(0.0).sqrt() * across).normalize_or(axis)
}

/// Samples a point of an opening that faces a direction, in the luminaire's frame, with its normal. A point opening has no normal.
fn sample_opening(opening: &Opening, dir: DVec3, rng: &mut SplitMix64) -> Option<(DVec3, Option<DVec3>)> {
    if *opening == Opening::Point {
        return Some((DVec3::ZERO, None));
    }
    for _ in 0..DRAWS {
        let (point, normal) = match *opening {
            Opening::Point => (DVec3::ZERO, dir),
            Opening::Box { width, length, height } => {
                let half = 0.5 * DVec3::new(length, width, height);
                let axis = (3.0 * rng.next_f64()) as usize;
                let side = if rng.next_f64() < 0.5 { -1.0 } else { 1.0 };
                let mut place = 2.0 * DVec3::new(rng.next_f64(), rng.next_f64(), rng.next_f64()) - 1.0;
                place[axis] = side;
                (half * place, side * DVec3::AXES[axis])
            }
            Opening::Cylinder { diameter, height } => {
                let (sin, cos) = sin_cos(TAU * rng.next_f64());
                let (across, radius, z) = (DVec3::new(cos, sin, 0.0), 0.5 * diameter, 0.5 * height);
                if rng.next_f64() < 0.5 {
                    (radius * across + z * (2.0 * rng.next_f64() - 1.0) * DVec3::Z, across)
                } else {
                    let side = if rng.next_f64() < 0.5 { -1.0 } else { 1.0 };
                    (radius * rng.next_f64().sqrt() * across + side * z * DVec3::Z, side * DVec3::Z)
                }
            }
            Opening::Sphere { diameter } => {
                let normal = rng.direction();
                (0.5 * diameter * normal, normal)
            }
        };
        if normal.dot(dir) > 0.0 {
            return Some((point, Some(normal)));
        }
    }
    None
}

/// Samples a point of a part, with the normal of its front.
fn sample_part(scope: &Scope<'_>, part: Part, rng: &mut SplitMix64) -> (DVec3, DVec3) {
    match part {
        Part::Triangle(index) => {
            let triangle = &scope.triangles[index];
            let [a, b, c] = triangle.corners;
            let (mut u, mut v) = (rng.next_f64(), rng.next_f64());
            if u + v > 1.0 {
                (u, v) = (1.0 - u, 1.0 - v);
            }
            (a + u * (b - a) + v * (c - a), triangle.cross().normalize_or_zero())
        }
        Part::Quadric(index) => sample_shape(&scope.quadrics[index].shape, rng),
    }
}

fn sample_shape(shape: &Shape, rng: &mut SplitMix64) -> (DVec3, DVec3) {
    let sign = |facing: Facing| if facing == Facing::Inward { -1.0 } else { 1.0 };
    let mix = |a: f64, b: f64, t: f64| a + (b - a) * t;
    let mut around = |axis: DVec3| direction_at_cosine(axis, 0.0, rng);
    match *shape {
        Shape::Sphere { center, radius, facing } => {
            let normal = rng.direction();
            (center + radius * normal, sign(facing) * normal)
        }
        Shape::Ring { center, normal, inner, outer } => {
            let across = around(normal);
            (center + mix(inner * inner, outer * outer, rng.next_f64()).sqrt() * across, normal)
        }
        Shape::Cone { start, end, start_radius, end_radius, facing } => {
            let axis = (end - start).normalize_or_zero();
            let across = around(axis);
            let slope = (end_radius - start_radius) / start.distance(end);
            let radius = mix(start_radius * start_radius, end_radius * end_radius, rng.next_f64()).sqrt();
            let step = end_radius - start_radius;
            let along = if step.abs() > 1e-9 * radius { (radius - start_radius) / step } else { rng.next_f64() };
            let normal = (across - slope * axis).normalize_or_zero();
            (start + along * (end - start) + radius * across, sign(facing) * normal)
        }
        Shape::Torus { center, axis, major, minor, facing } => {
            let across = around(axis);
            let turn = TAU * rng.next_f64();
            let normal = cos(turn) * across + sin_cos(turn).0 * axis;
            (center + major * across + minor * normal, sign(facing) * normal)
        }
    }
}

/// Returns the area of one side, m2.
pub(crate) fn shape_area(shape: &Shape) -> f64 {
    match *shape {
        Shape::Sphere { radius, .. } => 4.0 * PI * radius * radius,
        Shape::Cone { start, end, start_radius, end_radius, .. } => {
            let (length, step) = (start.distance(end), end_radius - start_radius);
            PI * (start_radius + end_radius) * (length * length + step * step).sqrt()
        }
        Shape::Ring { inner, outer, .. } => PI * (outer * outer - inner * inner),
        Shape::Torus { major, minor, .. } => 4.0 * PI * PI * major * minor,
    }
}
