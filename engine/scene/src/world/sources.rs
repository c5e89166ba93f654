//! Light sources, each as one lamp, and rays of their emitted light.

use super::{Beams, Bounds, BoxTree, Dice, Ray, Scope, emits};
use crate::description::{Facing, Location, Opening, Shape, Sides};
use femc_math::Transform;
use femc_math::elementary::double::{cos, pow, sin_cos};
use femc_math::glam::DVec3;
use std::f64::consts::{PI, TAU};
use std::ops::ControlFlow;

/// Maximum number of samples on an opening until one faces the direction of the light.
const DRAWS: u32 = 32;

/// A light source.
pub(crate) struct Source<'a> {
    /// Location of its first part in the order of the scene.
    pub location: Location,
    form: Form<'a>,
}

enum Form<'a> {
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
pub(crate) struct Emitted {
    pub ray: Ray,
    /// Normal of the emitting side; `None` if the source is a point.
    pub normal: Option<DVec3>,
}

/// Groups touching items. Members of a group are in ascending order, and groups are in the order of their first members.
/// - `gap`: distance up to which bounds touch.
pub(crate) fn touching(bounds: &[Bounds], gap: f64, is_alike: impl Fn(usize, usize) -> bool) -> Vec<Vec<usize>> {
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
            let _never_stops = tree.find(&bounds[index].grown(gap), |other| {
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
pub(crate) fn sources<'a>(scope: &Scope<'a>) -> Vec<Source<'a>> {
    let scene = scope.scene;
    let luminaires = scope.luminaires.iter().filter_map(|placed| {
        let photometry = placed.luminaire.photometry.index();
        let opening = &scene.photometry.get(photometry)?.opening;
        let multiplier = placed.luminaire.multiplier;
        let form = Form::Luminaire { to_world: placed.to_world, photometry, opening, multiplier };
        Some(Source { location: placed.luminaire.location, form })
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
        let area = area(&quadric.shape);
        (Part::Quadric(index), area, quadric.bounds(), quadric.material.index(), quadric.location)
    });
    let parts: Vec<_> = triangles.chain(quadrics).collect();
    let bounds: Vec<Bounds> = parts.iter().map(|part| part.2).collect();
    let groups = touching(&bounds, 1e-6 * scope.bounds.diagonal(), |a, b| parts[a].3 == parts[b].3);
    let surfaces = groups.into_iter().map(|group| {
        let (mut sum, first) = (0.0, &parts[group[0]]);
        let with_sum = group.iter().map(|&index| {
            sum += parts[index].1;
            (sum, parts[index].0)
        });
        let form = Form::Surfaces { parts: with_sum.collect(), material: first.3 };
        Source { location: first.4, form }
    });
    luminaires.chain(surfaces).collect()
}

impl Source<'_> {
    /// Returns whether the source has no size, so that no path can hit it.
    pub fn is_point(&self) -> bool {
        matches!(self.form, Form::Luminaire { opening: Opening::Point, .. })
    }

    /// Returns the luminous flux, lm, at the start of the clip.
    /// - `fluxes`: luminous flux of each photometric file.
    pub fn lumens(&self, scope: &Scope<'_>, fluxes: &[f64]) -> f64 {
        match &self.form {
            Form::Luminaire { photometry, multiplier, .. } => fluxes.get(*photometry).map_or(0.0, |lm| lm * multiplier),
            Form::Surfaces { parts, material } => {
                let (area, material) = (parts.last().map_or(0.0, |part| part.0), &scope.scene.materials[*material]);
                let sides = if material.sides == Sides::Two { 2.0 } else { 1.0 };
                material.ed.luminous() * area * sides
            }
        }
    }

    /// Samples a ray of the emitted light; `None` if the sample emits nothing.
    /// - `beams`: emission directions of each photometric file.
    /// - `at`: position in the cumulative emission, in [0, 1).
    pub fn emit(&self, scope: &Scope<'_>, beams: &[Option<Beams>], at: f64, dice: &mut Dice) -> Option<Emitted> {
        match &self.form {
            Form::Luminaire { to_world, photometry, opening, .. } => {
                let local = beams.get(*photometry)?.as_ref()?.direction(at, dice);
                let dir = to_world.transform_vector3(local).try_normalize()?;
                let ray = |origin| Ray { origin, dir, far: f64::INFINITY };
                let (point, normal) = on_opening(opening, local, dice)?;
                let Some(normal) = normal else {
                    return Some(Emitted { ray: ray(to_world.translation), normal: None });
                };
                let normal = to_world.transform_vector3(normal).try_normalize()?;
                let origin = to_world.transform_point3(point) + 2.0 * scope.offset() * normal;
                Some(Emitted { ray: ray(origin), normal: Some(normal) })
            }
            Form::Surfaces { parts, material } => {
                let sum = parts.last().map_or(0.0, |part| part.0);
                let index = parts.partition_point(|part| part.0 <= at * sum).min(parts.len() - 1);
                let (place, front) = on_part(scope, parts[index].1, dice);
                let material = scope.scene.materials.get(*material)?;
                let is_back = material.sides == Sides::Two && dice.roll() < 0.5;
                let normal = if is_back { -front } else { front };
                let dir = match material.lobe {
                    None => (normal + 0.999 * dice.direction()).try_normalize()?,
                    Some(exponent) => about(normal, pow(1.0 - dice.roll(), 1.0 / (exponent.max(0.0) + 2.0)), dice),
                };
                let origin = place + 2.0 * scope.offset() * normal;
                Some(Emitted { ray: Ray { origin, dir, far: f64::INFINITY }, normal: Some(normal) })
            }
        }
    }
}

/// Returns a random direction at this cosine to an axis.
fn about(axis: DVec3, cosine: f64, dice: &mut Dice) -> DVec3 {
    let (sin, cos) = sin_cos(TAU * dice.roll());
    let u = axis.any_orthonormal_vector();
    let across = cos * u + sin * axis.cross(u);
    (cosine * axis + (1.0 - cosine * cosine).max(0.0).sqrt() * across).normalize_or(axis)
}

/// Samples a point of an opening that faces a direction, in the luminaire's frame, with its normal. A point opening has no normal.
fn on_opening(opening: &Opening, dir: DVec3, dice: &mut Dice) -> Option<(DVec3, Option<DVec3>)> {
    if *opening == Opening::Point {
        return Some((DVec3::ZERO, None));
    }
    for _ in 0..DRAWS {
        let (point, normal) = match *opening {
            Opening::Point => (DVec3::ZERO, dir),
            Opening::Box { width, length, height } => {
                let half = 0.5 * DVec3::new(length, width, height);
                let axis = (3.0 * dice.roll()) as usize;
                let side = if dice.roll() < 0.5 { -1.0 } else { 1.0 };
                let mut place = 2.0 * DVec3::new(dice.roll(), dice.roll(), dice.roll()) - 1.0;
                place[axis] = side;
                (half * place, side * DVec3::AXES[axis])
            }
            Opening::Cylinder { diameter, height } => {
                let (sin, cos) = sin_cos(TAU * dice.roll());
                let (across, radius, z) = (DVec3::new(cos, sin, 0.0), 0.5 * diameter, 0.5 * height);
                if dice.roll() < 0.5 {
                    (radius * across + z * (2.0 * dice.roll() - 1.0) * DVec3::Z, across)
                } else {
                    let side = if dice.roll() < 0.5 { -1.0 } else { 1.0 };
                    (radius * dice.roll().sqrt() * across + side * z * DVec3::Z, side * DVec3::Z)
                }
            }
            Opening::Sphere { diameter } => {
                let normal = dice.direction();
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
fn on_part(scope: &Scope<'_>, part: Part, dice: &mut Dice) -> (DVec3, DVec3) {
    match part {
        Part::Triangle(index) => {
            let triangle = &scope.triangles[index];
            let [a, b, c] = triangle.corners;
            let (mut u, mut v) = (dice.roll(), dice.roll());
            if u + v > 1.0 {
                (u, v) = (1.0 - u, 1.0 - v);
            }
            (a + u * (b - a) + v * (c - a), triangle.cross().normalize_or_zero())
        }
        Part::Quadric(index) => on_shape(&scope.quadrics[index].shape, dice),
    }
}

fn on_shape(shape: &Shape, dice: &mut Dice) -> (DVec3, DVec3) {
    let sign = |facing: Facing| if facing == Facing::Inward { -1.0 } else { 1.0 };
    let mix = |a: f64, b: f64, t: f64| a + (b - a) * t;
    let mut around = |axis: DVec3| about(axis, 0.0, dice);
    match *shape {
        Shape::Sphere { center, radius, facing } => {
            let normal = dice.direction();
            (center + radius * normal, sign(facing) * normal)
        }
        Shape::Ring { center, normal, inner, outer } => {
            let across = around(normal);
            (center + mix(inner * inner, outer * outer, dice.roll()).sqrt() * across, normal)
        }
        Shape::Cone { start, end, start_radius, end_radius, facing } => {
            let axis = (end - start).normalize_or_zero();
            let across = around(axis);
            let slope = (end_radius - start_radius) / start.distance(end);
            let radius = mix(start_radius * start_radius, end_radius * end_radius, dice.roll()).sqrt();
            let step = end_radius - start_radius;
            let along = if step.abs() > 1e-9 * radius { (radius - start_radius) / step } else { dice.roll() };
            let normal = (across - slope * axis).normalize_or_zero();
            (start + along * (end - start) + radius * across, sign(facing) * normal)
        }
        Shape::Torus { center, axis, major, minor, facing } => {
            let across = around(axis);
            let turn = TAU * dice.roll();
            let normal = cos(turn) * across + sin_cos(turn).0 * axis;
            (center + major * across + minor * normal, sign(facing) * normal)
        }
    }
}

/// Returns the area of one side, m2.
pub(crate) fn area(shape: &Shape) -> f64 {
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
