//! Checks for lights that light nothing.

use super::{Faults, Scope, WHOLE_SCENE, coplanar::Plane, materials::title, overlap::tolerance};
use crate::{
    FaultKind::LightsNothing,
    Severity::{Note, Warning},
    description::{Location, Luminaire, Material, Sides},
    world::PlacedTriangle,
};
use std::{collections::BTreeMap, ops::ControlFlow};

/// Distance, relative to a lamp's size, within which a surface in front of the lamp covers it.
const GAP: f64 = 1e-3;
/// Share of a lamp that must be covered for the lamp to be reported.
const MIN_COVERED_SHARE: f64 = 0.999;

pub(super) fn check(scope: &Scope<'_>, faults: &mut Faults) {
    let used = scope.scene.materials.iter().zip(&scope.used).filter(|(_, used)| **used);
    used.for_each(|(material, _)| check_material(scope, material, faults));
    for group in &scope.scene.groups {
        group.luminaires.iter().for_each(|luminaire| check_luminaire(scope, luminaire, faults));
    }
    covered_lamps(scope, faults);
    if scope.scene.is_dark() {
        let message = "nothing in the scene emits light: every image of it is black";
        faults.add(
            Warning,
            LightsNothing,
            WHOLE_SCENE,
            message,
            "add a surface with `ed`, an `ies` luminaire or a `glow`",
        );
    }
}

/// Returns the maximum emittance over the clip, lm/m2.
fn emittance(scope: &Scope<'_>, material: &Material) -> f64 {
    scope.scene.max_over_time(&format!("material.{}", material.name), "ed", material.ed.amount)
}

fn is_black(material: &Material) -> bool {
    material.ed.color.iter().all(|channel| *channel <= 0.0)
}

fn check_material(scope: &Scope<'_>, material: &Material, faults: &mut Faults) {
    let (location, title) = (material.location, title(material));
    if emittance(scope, material) > 0.0 {
        if is_black(material) {
            let message = format!("{title} emits light with a black color");
            faults.add(Warning, LightsNothing, location, message, "give `ed` another color");
        }
        return;
    }
    if material.map_ed.is_some() {
        let message = format!("{title} has a `map_ed`, which multiplies an emittance of 0");
        faults.add(Warning, LightsNothing, location, message, "give it an `ed`");
    }
    if material.lobe.is_some() {
        let message = format!("{title} has an emission lobe, but emits nothing");
        faults.add(Note, LightsNothing, location, message, "give it an `ed`");
    }
}

fn peak_intensity(scope: &Scope<'_>, luminaire: &Luminaire) -> f64 {
    let photometry = scope.scene.photometry.get(luminaire.photometry.index());
    let brightest = photometry.map_or(0.0, |photometry| photometry.candela.iter().fold(0.0_f64, |a, b| a.max(*b)));
    brightest * luminaire.multiplier
}

/// Returns whether a `vary` sets the multiplier of any luminaire.
fn multipliers_vary(scope: &Scope<'_>) -> bool {
    scope.scene.varies.iter().any(|vary| vary.selector.ends_with(".multiplier"))
}

fn check_luminaire(scope: &Scope<'_>, luminaire: &Luminaire, faults: &mut Faults) {
    if peak_intensity(scope, luminaire) <= 0.0 && !multipliers_vary(scope) {
        let message = "the luminaire has an intensity of 0 in all directions";
        faults.add(Warning, LightsNothing, luminaire.location, message, "check its file and its `-m`");
    }
}

/// Reports one-sided lamps whose front another surface covers.
pub(super) fn covered_lamps(scope: &Scope<'_>, faults: &mut Faults) {
    let materials = &scope.scene.materials;
    let emits: Vec<bool> = materials.iter().map(|m| m.sides == Sides::One && emittance(scope, m) > 0.0).collect();
    // Placed face -> its area, its covered area, its location.
    let mut lamps: BTreeMap<u32, (f64, f64, Location)> = BTreeMap::new();
    for lamp in scope.triangles.iter().filter(|triangle| emits.get(triangle.material.index()) == Some(&true)) {
        let Some(plane) = Plane::from_triangle(lamp) else { continue };
        let entry = lamps.entry(lamp.face).or_insert((0.0, 0.0, lamp.location));
        entry.0 += plane.area;
        entry.1 += covered_area(scope, lamp, &plane);
    }
    for (area, covered, location) in lamps.into_values() {
        if covered > MIN_COVERED_SHARE * area {
            let message = "the one-sided lamp emits directly into a surface in front of it";
            faults.add(
                Warning,
                LightsNothing,
                location,
                message,
                "turn it around, or move it to the other side of the surface",
            );
        }
    }
}

/// Returns the area of a lamp that is covered by opaque surfaces close in front of it.
fn covered_area(scope: &Scope<'_>, lamp: &PlacedTriangle, plane: &Plane) -> f64 {
    let (least, gap) = (tolerance(scope), GAP * plane.area.sqrt());
    let mut covered = 0.0;
    let _never_stops = scope.tree.visit_overlapping(&lamp.bounds().grown(gap), |other| {
        let other = &scope.triangles[other];
        if let (true, Some(cover)) = (other.face != lamp.face, Plane::from_triangle(other)) {
            let (low, high) = plane.distances(&cover);
            if plane.is_parallel(&cover) && low > least && high <= gap && stops_light(scope, other, plane, &cover) {
                covered += plane.overlap(&cover);
            }
        }
        ControlFlow::Continue(())
    });
    covered
}

fn stops_light(scope: &Scope<'_>, other: &PlacedTriangle, lamp: &Plane, cover: &Plane) -> bool {
    scope.scene.materials.get(other.material.index()).is_some_and(|material| {
        let lets_through = scope.lets_through[other.material.index()];
        !lets_through && (material.sides == Sides::Two || lamp.normal.dot(cover.normal) < 0.0)
    })
}
