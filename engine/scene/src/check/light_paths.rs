//! Checks the paths of light: walls that let light in through their backs, cameras that no light reaches, scenes that light never
//! leaves.
//!
//! The check uses a few hundred random walks from each camera. A fault that they find is real. They may miss faults.

use super::{Faults, Scope, WHOLE_SCENE, hidden_lamps::BLACK, materials::title};
use crate::{
    FaultKind::{Camera as CameraFault, EnergyTrap, OneSidedWall},
    Severity::Warning,
    description::{Camera, Location, MaterialId, Scene},
    world::{Hit, LampPoint, Ray, SplitMix64, WalkEnd, lamp_points, random_walk},
};
use femc_math::{elementary::double::tan, glam::DVec3};
use std::collections::BTreeMap;

/// Number of walks from each camera.
const WALKS: u64 = 256;
/// Number of lamps that are tested from each point.
const LAMPS: usize = 4;
/// Maximum number of cameras that are checked.
const MAX_CAMERAS: usize = 8;
/// Share of the light that must come through the backs of a wall for the wall to be reported.
const THROUGH_BACKS: f64 = 0.25;
/// Reflectance sum below which a material absorbs.
const WHITE: f64 = 1.0 - 1e-6;

pub(super) fn check(scope: &Scope<'_>, faults: &mut Faults) {
    let lamps = lamp_points(scope);
    let glows = scope
        .scene
        .media
        .iter()
        .any(|m| scope.scene.max_over_time(&format!("medium.{}", m.name), "glow", m.glow) > 0.0);
    let (mut backs, mut lit, mut closed) = (BTreeMap::new(), 0, !scope.scene.cameras.is_empty());
    for camera in scope.scene.cameras.iter().take(MAX_CAMERAS) {
        let counts = trace_camera_walks(scope, camera, &lamps, &mut backs);
        lit += counts.lit;
        let is_enclosed = counts.walks > 0 && counts.escaped == 0;
        closed &= is_enclosed;
        if is_enclosed && counts.lit == 0 && !glows && !lamps.is_empty() {
            let message = format!("camera `{}` is enclosed by surfaces that block all light: {BLACK}", camera.name);
            faults.add(
                Warning,
                CameraFault,
                camera.location,
                message,
                "move it out of the solid, or put a lamp inside",
            );
        }
    }
    // A free-standing mirror or screen has a back, too, but lets little light through it.
    let much = |(_, (_, count)): &(MaterialId, (Location, u32))| f64::from(*count) >= THROUGH_BACKS * f64::from(lit);
    for (material, (location, _)) in backs.into_iter().filter(much) {
        let Some(material) = scope.scene.materials.get(material.index()) else { continue };
        let message = format!("light enters through the back of this wall: {} is one-sided", title(material));
        let advice = "turn its front toward the room, or use `sides 2` if the wall should block light from behind";
        faults.add(Warning, OneSidedWall, location, message, advice);
    }
    if closed && nothing_absorbs(scope) {
        let message =
            "the scene is closed, and no surface or medium in it absorbs: light never leaves it, and paths never end";
        faults.add(Warning, EnergyTrap, WHOLE_SCENE, message, "make a surface absorb some light, or set `--max-depth`");
    }
}

/// Results of a camera's walks.
#[derive(Default)]
struct WalkCounts {
    /// Number of walks.
    walks: u32,
    /// Number of walks that left the scene.
    escaped: u32,
    /// Number of pairs of a point and a lamp that lights it; a walk that hits a lamp also counts.
    lit: u32,
}

/// First location of a wall whose back let light in, and the number of such hits, by material.
type BackHits = BTreeMap<MaterialId, (Location, u32)>;

fn trace_camera_walks(scope: &Scope<'_>, camera: &Camera, lamps: &[LampPoint], backs: &mut BackHits) -> WalkCounts {
    let mut counts = WalkCounts::default();
    let (mut rng, mut lamp_rng) = (SplitMix64(7), SplitMix64(11));
    for _ in 0..WALKS {
        let Some(ray) = camera_ray(scope, camera, &mut rng) else { break };
        counts.walks += 1;
        let mut visit = |hit: &Hit, position: DVec3, normal: DVec3| {
            counts.lit += u32::from(is_lamp(scope, hit, normal));
            for _ in 0..LAMPS.min(lamps.len()) {
                let lamp = &lamps[(lamp_rng.next_f64() * lamps.len() as f64) as usize];
                let Some(passed) = invisible_backs_to_lamp(scope, lamp, position, normal) else { continue };
                counts.lit += 1;
                for back in passed {
                    let entry = backs.entry(back.material).or_insert((back.location, 0));
                    *entry = (entry.0.min(back.location), entry.1 + 1);
                }
            }
        };
        counts.escaped += u32::from(random_walk(scope, ray, &mut rng, &mut visit) == WalkEnd::Escaped);
    }
    counts
}

/// Returns a random ray through the camera's film.
pub(super) fn camera_ray(scope: &Scope<'_>, camera: &Camera, rng: &mut SplitMix64) -> Option<Ray> {
    let camera = camera.at(&scope.scene.paths, scope.time);
    let forward = (camera.target - camera.origin).try_normalize()?;
    let right = forward.cross(camera.up).try_normalize()?;
    let half = tan(0.5 * camera.fov.to_radians());
    let aspect = f64::from(camera.film[0]) / f64::from(camera.film[1]).max(1.0);
    let (x, y) = (half * aspect * (2.0 * rng.next_f64() - 1.0), half * (2.0 * rng.next_f64() - 1.0));
    let dir = (forward + x * right + y * right.cross(forward)).try_normalize()?;
    Some(Ray { origin: camera.origin, dir, far: f64::INFINITY })
}

/// Returns whether the side of a surface that was hit emits.
fn is_lamp(scope: &Scope<'_>, hit: &Hit, normal: DVec3) -> bool {
    let faces = hit.normal.dot(normal) > 0.0;
    hit.material(scope)
        .is_some_and(|material| (faces || material.sides == crate::Sides::Two) && crate::world::emits(scope, material))
}

/// Returns the invisible backs of surfaces that a lamp's light crosses on its way to a point; `None` if it does not arrive.
fn invisible_backs_to_lamp(scope: &Scope<'_>, lamp: &LampPoint, position: DVec3, normal: DVec3) -> Option<Vec<Hit>> {
    let way = lamp.position - position;
    let is_before = lamp.normal.is_none_or(|facing| facing.dot(way) < 0.0);
    if way.dot(normal) <= 0.0 || !is_before {
        return None;
    }
    scope.invisible_backs_between(position, lamp.position)
}

fn nothing_absorbs(scope: &Scope<'_>) -> bool {
    let Scene { materials, media, .. } = scope.scene;
    let mut shown = materials.iter().zip(&scope.visible).filter(|(_, visible)| **visible).map(|(material, _)| material);
    let absorbs = media.iter().any(|medium| medium.sigma_a > 0.0);
    !absorbs
        && shown.all(|material| material.ior.is_none_or(|ior| ior.im == 0.0) && material.reflectance_sum() >= WHITE)
}
