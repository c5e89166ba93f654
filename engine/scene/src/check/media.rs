//! Checks that media are placed, have a volume and have a sensible optical thickness.

use super::{Faults, Scope, materials::title};
use crate::{
    FaultKind::{MediumWithoutBounds, OpenBoundary, OpticalDepth},
    Severity::{Note, Warning},
    description::{Camera, Density, Medium, MediumId, RegionBounds, Sides},
};
use femc_math::{elementary::double::exp, glam::DVec3};
use std::collections::BTreeSet;

/// Optical depth through which only 1e-13 of the light passes.
const OPAQUE: f64 = 30.0;
/// Optical depth below which no measurable light is lost.
const CLEAR: f64 = 1e-6;
/// Number of points between a camera and its target.
const STEPS: u32 = 256;

pub(super) fn check(scope: &Scope<'_>, faults: &mut Faults) {
    check_placement(scope, faults);
    check_insides(scope, faults);
    for region in &scope.scene.regions {
        if let RegionBounds::Box { min, max, to_world } = region.bounds
            && (!min.cmplt(max).all() || to_world.matrix3.determinant() == 0.0)
        {
            let name = scope.scene.media.get(region.medium.index()).map_or("", |medium| &medium.name);
            let message = format!("the box of medium `{name}` has no volume");
            faults.add(Warning, MediumWithoutBounds, region.location, message, "give the lower corner first");
        }
    }
    scope.scene.media.iter().for_each(|medium| check_too_thin(scope, medium, faults));
    scope.scene.cameras.iter().for_each(|camera| check_too_thick(scope, camera, faults));
}

fn check_placement(scope: &Scope<'_>, faults: &mut Faults) {
    let scene = scope.scene;
    let materials = scene.materials.iter().zip(&scope.used).filter(|(_, used)| **used);
    let inside = materials.filter_map(|(material, _)| material.inside);
    let placed: BTreeSet<MediumId> = scene.regions.iter().map(|region| region.medium).chain(inside).collect();
    for (medium, _) in scene.media.iter().zip(0..).filter(|(_, id)| !placed.contains(&MediumId(*id))) {
        let message = format!("medium `{}` has no bounds: it fills nothing", medium.name);
        let advice = "place it with `mbox`, `mglobal` or `inside` of a material in use";
        faults.add(Warning, MediumWithoutBounds, medium.location, message, advice);
    }
}

fn check_insides(scope: &Scope<'_>, faults: &mut Faults) {
    for (material, _) in scope.scene.materials.iter().zip(&scope.used).filter(|(_, used)| **used) {
        if material.inside.is_some() && material.sides == Sides::Two {
            let message = format!("{} has a medium inside, but it is two-sided and has no inside", title(material));
            faults.add(Warning, OpenBoundary, material.location, message, "give it `sides 1`");
        }
    }
}

/// Reports a medium that has no visible effect on any ray across the scene.
fn check_too_thin(scope: &Scope<'_>, medium: &Medium, faults: &mut Faults) {
    let prefix = format!("medium.{}.", medium.name);
    let varies = scope.scene.varies.iter().any(|vary| vary.selector.starts_with(&prefix));
    let depth = extinction(medium) * scope.bounds.diagonal();
    if !varies && medium.glow == 0.0 && depth < CLEAR && !scope.bounds.is_empty() {
        let message = format!("medium `{}` has an optical depth of {depth:.0e} across the scene", medium.name);
        faults.add(
            Note,
            OpticalDepth,
            medium.location,
            message,
            "raise `sigma_s` or `sigma_a` (1/m) if it should be visible",
        );
    }
}

/// Reports a camera that cannot see its target through the media.
fn check_too_thick(scope: &Scope<'_>, camera: &Camera, faults: &mut Faults) {
    let scene = scope.scene;
    let camera = camera.at(&scene.paths, scope.time);
    let (eye, target) = (camera.origin, camera.target);
    let mut depth = 0.0;
    for region in &scene.regions {
        let Some(medium) = scene.media.get(region.medium.index()) else { continue };
        let density = (0..STEPS).map(|i| eye.lerp(target, (f64::from(i) + 0.5) / f64::from(STEPS)));
        let mean = density.map(|p| density_at(medium, &region.bounds, p)).sum::<f64>() / f64::from(STEPS);
        depth += mean * extinction(medium) * eye.distance(target);
    }
    if depth > OPAQUE {
        let message = format!(
            "camera `{}` looks at its target through media of optical depth {depth:.0}: the target is not visible",
            camera.name
        );
        let advice = "lower `sigma_s` and `sigma_a` (1/m), or move the camera";
        faults.add(Warning, OpticalDepth, camera.location, message, advice);
    }
}

/// Returns the extinction coefficient of the densest channel at density 1, 1/m.
fn extinction(medium: &Medium) -> f64 {
    medium.extinction().into_iter().fold(0.0, f64::max)
}

fn density_at(medium: &Medium, bounds: &RegionBounds, p: DVec3) -> f64 {
    let is_inside = match bounds {
        RegionBounds::Everywhere => true,
        RegionBounds::Box { min, max, to_world } => {
            let local = to_world.inverse().transform_point3(p);
            local.cmpge(*min).all() && local.cmple(*max).all()
        }
    };
    match medium.density {
        _ if !is_inside => 0.0,
        Density::Uniform => 1.0,
        Density::Height { z0, scale } => exp(-((p.z - z0) / scale).max(0.0)),
    }
}
