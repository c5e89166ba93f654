//! Finds lamps whose light no rendering method finds: points in solid glass, lamps in solids, in walls and above ceilings.
//!
//! The check traces rays of a lamp's light, distributed by the directions in which it emits, to the points that they light. A lamp
//! counts as found as soon as a point on a camera's path sees one of these points. A warning states the reason that all rays of a
//! lamp have in common.

use super::{Faults, Scope, WHOLE_SCENE, light_paths::camera_ray, materials::title};
use crate::{
    FaultKind::{Camera as CameraFault, Incomplete, LightsNothing},
    Severity::{Note, Warning},
    description::{Location, MaterialId},
    world::{
        EmissionSampler, LightPathEnd, LightSource, LitPoint, SplitMix64, WalkEnd, light_sources, random_walk,
        scattered_ray, trace_light,
    },
};
use femc_math::glam::DVec3;
use std::collections::BTreeMap;

/// Number of rays per lamp.
const RAYS: u32 = 256;
/// Maximum number of lit points from which light is traced further, and maximum number of reflections from each.
const MAX_FOLLOWED: usize = 64;
const REFLECTIONS: u32 = 16;
/// Number of points on the cameras' paths that are tested against each lit point, in addition to one eye.
const TRIES: u32 = 2;
/// Number of random walks of all cameras together.
const WALKS: usize = 1024;
/// Maximum number of cameras. If there are more, points that no camera sees are not reported.
const MAX_CAMERAS: usize = 64;
/// Share of a point lamp's light that glass and mirrors must take to be reported.
const MIN_LOST_SHARE: f64 = 0.5;
/// Greatest distance at which surfaces count as around a lamp: a share of the scene's diagonal, and an upper limit, m.
const AROUND: (f64, f64) = (0.02, 0.2);
/// Maximum number of rays and visibility tests for all lamps together.
const MAX_RAYS: u64 = 4_000_000;

/// End of the message for a camera that no light reaches. When it is present, lamps are not reported for the same reason.
pub(super) const BLACK: &str = "its image is black";

pub(super) fn check(scope: &Scope<'_>, faults: &mut Faults) {
    let mut search = Search::new(scope);
    let all = light_sources(scope);
    let is_dark = faults.0.iter().any(|fault| fault.kind == CameraFault && fault.message.ends_with(BLACK));
    // First location and count of equal findings.
    let mut found: BTreeMap<(Location, HiddenReason), u32> = BTreeMap::new();
    let mut checked_count = 0;
    for source in &all {
        if search.ray_count > MAX_RAYS {
            break;
        }
        checked_count += 1;
        if let Some(reason) = search.hidden_reason(source)
            && !(is_dark && matches!(reason, HiddenReason::Unseen | HiddenReason::Near(_)))
        {
            *found.entry((source.location, reason)).or_default() += 1;
        }
    }
    let is_reported = |location: Location| faults.0.iter().any(|f| f.kind == LightsNothing && f.location == location);
    found.retain(|(location, _), _| !is_reported(*location));
    for ((location, reason), count) in found {
        let (message, advice) = search.describe(reason);
        let copies = if count == 1 { String::new() } else { format!(" ({count} copies of the lamp)") };
        faults.add(Warning, LightsNothing, location, format!("{message}{copies}"), advice);
    }
    if checked_count < all.len() {
        let message = format!("only {checked_count} of {} lamps were checked for light that is blocked", all.len());
        faults.add(
            Note,
            Incomplete,
            WHOLE_SCENE,
            message,
            "if lamps seem to be missing, check parts of the scene separately",
        );
    }
}

/// Reason why a lamp's light is not found.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum HiddenReason {
    /// A point lamp. This percentage of its light hits solids that refract it.
    Glass(MaterialId, u32),
    /// A point lamp. This percentage of its light hits perfect mirrors.
    Mirror(MaterialId, u32),
    /// Surfaces of this material stop all light.
    Stopped(MaterialId),
    /// The light reaches only surfaces up to this many millimeters away, and no camera sees them.
    Near(u32),
    /// No camera sees a point that the light reaches.
    Unseen,
}

/// State of the search: the cameras' views and the work done so far.
struct Search<'a, 'b> {
    scope: &'b Scope<'a>,
    /// Emission directions of the photometric files.
    samplers: Vec<Option<EmissionSampler>>,
    eyes: Vec<DVec3>,
    /// Points on the cameras' paths, each with the normal of the side that the path hit.
    path_points: Vec<(DVec3, DVec3)>,
    /// Whether some path of a camera leaves the scene.
    escapes: bool,
    rng: SplitMix64,
    /// Number of rays and visibility tests so far.
    ray_count: u64,
}

impl<'a, 'b> Search<'a, 'b> {
    fn new(scope: &'b Scope<'a>) -> Self {
        let samplers = scope.scene.photometry.iter().map(EmissionSampler::new).collect();
        let cameras = &scope.scene.cameras;
        let (mut eyes, mut path_points, mut escapes, mut rng) = (Vec::new(), Vec::new(), false, SplitMix64(5));
        for camera in cameras.iter().filter(|_| cameras.len() <= MAX_CAMERAS) {
            eyes.push(camera.at(&scope.scene.paths, scope.time).origin);
            for _ in 0..WALKS / cameras.len() {
                let Some(ray) = camera_ray(scope, camera, &mut rng) else { break };
                let mut visit = |_: &_, place, normal| path_points.push((place, normal));
                escapes |= random_walk(scope, ray, &mut rng, &mut visit) == WalkEnd::Escaped;
            }
        }
        Self { scope, samplers, eyes, path_points, escapes, rng: SplitMix64(13), ray_count: 0 }
    }

    /// Returns the reason why no light of a source is found. `None` means that some light is found, or that this cannot be
    /// excluded.
    fn hidden_reason(&mut self, source: &LightSource<'_>) -> Option<HiddenReason> {
        let mut tally = Tally::default();
        let mut lit: Vec<LitPoint> = Vec::new();
        for number in 0..RAYS {
            let at = (f64::from(number) + 0.5) / f64::from(RAYS);
            let Some(emitted) = source.emit(self.scope, &self.samplers, at, &mut self.rng) else { continue };
            let origin = emitted.ray.origin;
            tally.rays += 1;
            if emitted.normal.is_some() && self.sees(&LitPoint { position: origin, normal: emitted.normal }) {
                return None;
            }
            self.ray_count += 1;
            match trace_light(self.scope, emitted.ray, source.is_point(), &mut self.rng) {
                LightPathEnd::Escaped => tally.escaped = true,
                LightPathEnd::Refracted(material) => tally.add_refraction(material),
                LightPathEnd::Mirrored(material) => tally.add_reflection(material),
                LightPathEnd::Stopped(material) => tally.stopped = Some(material),
                LightPathEnd::Lit(point) if self.sees(&point) => return None,
                LightPathEnd::Lit(point) => {
                    tally.reach = tally.reach.max(point.position.distance(origin));
                    lit.push(point);
                }
            }
        }
        if let Some(lost) = tally.lost_reason() {
            return Some(lost);
        }
        match tally.stopped.filter(|_| lit.is_empty() && !tally.escaped) {
            Some(material) => Some(HiddenReason::Stopped(material)),
            None => self.unseen_reason(&lit, tally),
        }
    }

    /// Traces the light of lit points further, until a camera sees what it lights.
    fn unseen_reason(&mut self, lit: &[LitPoint], mut tally: Tally) -> Option<HiddenReason> {
        if self.eyes.is_empty() || tally.rays == 0 {
            return None;
        }
        let around = (AROUND.0 * self.scope.bounds.diagonal()).min(AROUND.1);
        let step = lit.len().div_ceil(MAX_FOLLOWED).max(1);
        for first in lit.iter().step_by(step) {
            let mut point = *first;
            for _ in 0..REFLECTIONS {
                if tally.escaped && self.escapes && (lit.is_empty() || tally.reach > around) {
                    return None;
                }
                let ray = scattered_ray(self.scope, &point, &mut self.rng);
                self.ray_count += 1;
                match trace_light(self.scope, ray, false, &mut self.rng) {
                    LightPathEnd::Lit(next) if self.sees(&next) => return None,
                    LightPathEnd::Lit(next) => {
                        tally.reach = tally.reach.max(next.position.distance(first.position));
                        point = next;
                    }
                    LightPathEnd::Escaped => {
                        tally.escaped = true;
                        break;
                    }
                    LightPathEnd::Refracted(_) | LightPathEnd::Mirrored(_) | LightPathEnd::Stopped(_) => break,
                }
            }
        }
        match tally.escaped && self.escapes {
            false => Some(HiddenReason::Unseen),
            true if lit.is_empty() || tally.reach > around || self.is_foggy() => None,
            true => Some(HiddenReason::Near((1e3 * tally.reach).ceil() as u32)),
        }
    }

    /// Returns whether an eye or a random point on a camera's path sees a lit point.
    fn sees(&mut self, lit: &LitPoint) -> bool {
        let is_lit_from = |from: DVec3| lit.normal.is_none_or(|normal| normal.dot(from - lit.position) > 0.0);
        let mut pick = |count: usize| (self.rng.next_f64() * count as f64) as usize;
        if let Some(&eye) = self.eyes.get(pick(self.eyes.len())) {
            self.ray_count += 1;
            if is_lit_from(eye) && self.scope.invisible_backs_between(eye, lit.position).is_some() {
                return true;
            }
        }
        (0..TRIES).any(|_| {
            let Some(&(place, normal)) = self.path_points.get(pick(self.path_points.len())) else { return false };
            self.ray_count += 1;
            let is_before = normal.dot(lit.position - place) > 0.0;
            is_before && is_lit_from(place) && self.scope.invisible_backs_between(place, lit.position).is_some()
        })
    }

    /// Returns whether a medium of a region scatters.
    fn is_foggy(&self) -> bool {
        let scene = self.scope.scene;
        let media = scene.regions.iter().filter_map(|region| scene.media.get(region.medium.index()));
        media.into_iter().any(|m| scene.max_over_time(&format!("medium.{}", m.name), "sigma_s", m.sigma_s) > 0.0)
    }

    /// Returns message and advice.
    fn describe(&self, reason: HiddenReason) -> (String, &'static str) {
        let named =
            |material: MaterialId| self.scope.scene.materials.get(material.index()).map_or(String::new(), title);
        let share = |hundredths: u32| match hundredths {
            100 => "the light".to_owned(),
            part => format!("{part} % of the light"),
        };
        match reason {
            HiddenReason::Glass(material, part) => (
                format!(
                    "{} of this lamp cannot get through the solid glass around it ({}): the lamp is a point, and \
                     refracted paths never hit a point",
                    share(part),
                    named(material)
                ),
                "give the lamp a size (in its photometric file, or a small sphere with `ed` instead), or make the glass a \
                 thin sheet (`sides 2`, no `ir`); only `--method fem` finds this light",
            ),
            HiddenReason::Mirror(material, part) => (
                format!(
                    "{} of this lamp hits perfect mirrors ({}): the lamp is a point, and paths that a mirror \
                     reflects never hit a point",
                    share(part),
                    named(material)
                ),
                "give the lamp a size (in its photometric file, or a small sphere with `ed` instead), or give the mirror a \
                 roughness (`rs .9 .05`); only `--method fem` finds this light",
            ),
            HiddenReason::Stopped(material) => (
                format!(
                    "surfaces block all light of this lamp ({}): the lamp is inside a solid, or behind a one-sided surface",
                    named(material)
                ),
                "move the lamp in front of the surface",
            ),
            HiddenReason::Near(millimeters) => (
                format!(
                    "the light of this lamp hits only surfaces within {:.1} cm of it, and no camera sees them",
                    f64::from(millimeters) / 10.0
                ),
                "move the lamp out of the wall, or below the ceiling",
            ),
            HiddenReason::Unseen => (
                "the light of this lamp does not reach any place that a camera sees: opaque surfaces block it"
                    .to_owned(),
                "move the lamp into the space that the camera sees, for example below the ceiling",
            ),
        }
    }
}

/// Counts of the ways in which a lamp's rays end.
#[derive(Default)]
struct Tally {
    rays: u32,
    refracted: u32,
    mirrored: u32,
    /// First solid that refracts, and first mirror.
    glass: Option<MaterialId>,
    mirror: Option<MaterialId>,
    stopped: Option<MaterialId>,
    escaped: bool,
    /// Greatest distance to a lit point, m.
    reach: f64,
}

impl Tally {
    fn add_refraction(&mut self, material: MaterialId) {
        self.refracted += 1;
        self.glass.get_or_insert(material);
    }

    fn add_reflection(&mut self, material: MaterialId) {
        self.mirrored += 1;
        self.mirror.get_or_insert(material);
    }

    /// Returns the reason if glass and mirrors take most of a point lamp's light.
    fn lost_reason(&self) -> Option<HiddenReason> {
        let part = |count: u32| (100.0 * f64::from(count) / f64::from(self.rays.max(1))).round() as u32;
        if f64::from(self.refracted + self.mirrored) <= MIN_LOST_SHARE * f64::from(self.rays) {
            return None;
        }
        if self.refracted >= self.mirrored {
            Some(HiddenReason::Glass(self.glass?, part(self.refracted)))
        } else {
            Some(HiddenReason::Mirror(self.mirror?, part(self.mirrored)))
        }
    }
}
