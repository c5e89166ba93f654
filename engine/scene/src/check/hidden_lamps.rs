//! Finds lamps whose light no rendering method finds: points in solid glass, lamps in solids, in walls and above ceilings.
//!
//! The check traces rays of a lamp's light, distributed by the directions in which it emits, to the points that they light. A lamp
//! counts as found as soon as a point on a camera's path sees one of these points. A warning states the reason that all rays of a
//! lamp have in common.

use super::{Faults, Scope, WHOLE, light_paths::view, materials::title};
use crate::{
    FaultKind::{Camera as CameraFault, Incomplete, LightsNothing},
    Severity::{Note, Warning},
    description::{Location, MaterialId},
    world::{Beams, Dice, Ending, LitPlace, Shone, Source, scattered, shine, sources, walk},
};
use femc_math::glam::DVec3;
use std::collections::BTreeMap;

/// Number of rays per lamp.
const RAYS: u32 = 256;
/// Maximum number of lit points from which light is traced further, and maximum number of reflections from each.
const FOLLOWED: usize = 64;
const REFLECTIONS: u32 = 16;
/// Number of points on the cameras' paths that are tested against each lit point, in addition to one eye.
const TRIES: u32 = 2;
/// Number of random walks of all cameras together.
const WALKS: usize = 1024;
/// Maximum number of cameras. If there are more, points that no camera sees are not reported.
const CAMERAS: usize = 64;
/// Share of a point lamp's light that glass and mirrors must take to be reported.
const LOST: f64 = 0.5;
/// Greatest distance at which surfaces count as around a lamp: a share of the scene's diagonal, and an upper limit, m.
const AROUND: (f64, f64) = (0.02, 0.2);
/// Maximum number of rays and visibility tests for all lamps together.
const BUDGET: u64 = 4_000_000;

/// End of the message for a camera that no light reaches. When it is present, lamps are not reported for the same reason.
pub(super) const BLACK: &str = "its image is black";

pub(super) fn check(scope: &Scope<'_>, faults: &mut Faults) {
    let mut search = Search::new(scope);
    let all = sources(scope);
    let is_dark = faults.0.iter().any(|fault| fault.kind == CameraFault && fault.message.ends_with(BLACK));
    // First location and count of equal findings.
    let mut found: BTreeMap<(Location, Hidden), u32> = BTreeMap::new();
    let mut looked_at = 0;
    for source in &all {
        if search.ways > BUDGET {
            break;
        }
        looked_at += 1;
        if let Some(hidden) = search.hidden(source)
            && !(is_dark && matches!(hidden, Hidden::Apart | Hidden::Near(_)))
        {
            *found.entry((source.location, hidden)).or_default() += 1;
        }
    }
    let said = |location: Location| faults.0.iter().any(|f| f.kind == LightsNothing && f.location == location);
    found.retain(|(location, _), _| !said(*location));
    for ((location, hidden), count) in found {
        let (message, advice) = search.words(hidden);
        let copies = if count == 1 { String::new() } else { format!(" ({count} copies of the lamp)") };
        faults.add(Warning, LightsNothing, location, format!("{message}{copies}"), advice);
    }
    if looked_at < all.len() {
        let message = format!("only {looked_at} of {} lamps were checked for light that is blocked", all.len());
        faults.add(
            Note,
            Incomplete,
            WHOLE,
            message,
            "if lamps seem to be missing, check parts of the scene separately",
        );
    }
}

/// Reason why a lamp's light is not found.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Hidden {
    /// A point lamp. This percentage of its light hits solids that refract it.
    Glass(MaterialId, u32),
    /// A point lamp. This percentage of its light hits perfect mirrors.
    Mirror(MaterialId, u32),
    /// Surfaces of this material stop all light.
    Stopped(MaterialId),
    /// The light reaches only surfaces up to this many millimeters away, and no camera sees them.
    Near(u32),
    /// No camera sees a point that the light reaches.
    Apart,
}

/// State of the search: the cameras' views and the work done so far.
struct Search<'a, 'b> {
    scope: &'b Scope<'a>,
    /// Emission directions of the photometric files.
    beams: Vec<Option<Beams>>,
    eyes: Vec<DVec3>,
    /// Points on the cameras' paths, each with the normal of the side that the path hit.
    places: Vec<(DVec3, DVec3)>,
    /// Whether some path of a camera leaves the scene.
    escapes: bool,
    dice: Dice,
    /// Number of rays and visibility tests so far.
    ways: u64,
}

impl<'a, 'b> Search<'a, 'b> {
    fn new(scope: &'b Scope<'a>) -> Self {
        let beams = scope.scene.photometry.iter().map(Beams::new).collect();
        let cameras = &scope.scene.cameras;
        let (mut eyes, mut places, mut escapes, mut dice) = (Vec::new(), Vec::new(), false, Dice(5));
        for camera in cameras.iter().filter(|_| cameras.len() <= CAMERAS) {
            eyes.push(camera.at(&scope.scene.paths, scope.time).origin);
            for _ in 0..WALKS / cameras.len() {
                let Some(ray) = view(scope, camera, &mut dice) else { break };
                let mut visit = |_: &_, place, normal| places.push((place, normal));
                escapes |= walk(scope, ray, &mut dice, &mut visit) == Ending::Escaped;
            }
        }
        Self { scope, beams, eyes, places, escapes, dice: Dice(13), ways: 0 }
    }

    /// Returns the reason why no light of a source is found. `None` means that some light is found, or that this cannot be
    /// excluded.
    fn hidden(&mut self, source: &Source<'_>) -> Option<Hidden> {
        let mut tally = Tally::default();
        let mut lit: Vec<LitPlace> = Vec::new();
        for number in 0..RAYS {
            let at = (f64::from(number) + 0.5) / f64::from(RAYS);
            let Some(emitted) = source.emit(self.scope, &self.beams, at, &mut self.dice) else { continue };
            let origin = emitted.ray.origin;
            tally.rays += 1;
            if emitted.normal.is_some() && self.sees(&LitPlace { place: origin, normal: emitted.normal }) {
                return None;
            }
            self.ways += 1;
            match shine(self.scope, emitted.ray, source.is_point(), &mut self.dice) {
                Shone::Escaped => tally.escaped = true,
                Shone::Bent(material) => tally.bend(material),
                Shone::Mirrored(material) => tally.mirror(material),
                Shone::Stopped(material) => tally.stopped = Some(material),
                Shone::Lit(place) if self.sees(&place) => return None,
                Shone::Lit(place) => {
                    tally.reach = tally.reach.max(place.place.distance(origin));
                    lit.push(place);
                }
            }
        }
        if let Some(lost) = tally.lost() {
            return Some(lost);
        }
        match tally.stopped.filter(|_| lit.is_empty() && !tally.escaped) {
            Some(material) => Some(Hidden::Stopped(material)),
            None => self.apart(&lit, tally),
        }
    }

    /// Traces the light of lit points further, until a camera sees what it lights.
    fn apart(&mut self, lit: &[LitPlace], mut tally: Tally) -> Option<Hidden> {
        if self.eyes.is_empty() || tally.rays == 0 {
            return None;
        }
        let around = (AROUND.0 * self.scope.bounds.diagonal()).min(AROUND.1);
        let step = lit.len().div_ceil(FOLLOWED).max(1);
        for first in lit.iter().step_by(step) {
            let mut place = *first;
            for _ in 0..REFLECTIONS {
                if tally.escaped && self.escapes && (lit.is_empty() || tally.reach > around) {
                    return None;
                }
                let ray = scattered(self.scope, &place, &mut self.dice);
                self.ways += 1;
                match shine(self.scope, ray, false, &mut self.dice) {
                    Shone::Lit(next) if self.sees(&next) => return None,
                    Shone::Lit(next) => {
                        tally.reach = tally.reach.max(next.place.distance(first.place));
                        place = next;
                    }
                    Shone::Escaped => {
                        tally.escaped = true;
                        break;
                    }
                    Shone::Bent(_) | Shone::Mirrored(_) | Shone::Stopped(_) => break,
                }
            }
        }
        match tally.escaped && self.escapes {
            false => Some(Hidden::Apart),
            true if lit.is_empty() || tally.reach > around || self.is_foggy() => None,
            true => Some(Hidden::Near((1e3 * tally.reach).ceil() as u32)),
        }
    }

    /// Returns whether an eye or a random point on a camera's path sees a lit point.
    fn sees(&mut self, lit: &LitPlace) -> bool {
        let is_lit_from = |from: DVec3| lit.normal.is_none_or(|normal| normal.dot(from - lit.place) > 0.0);
        let mut pick = |count: usize| (self.dice.roll() * count as f64) as usize;
        if let Some(&eye) = self.eyes.get(pick(self.eyes.len())) {
            self.ways += 1;
            if is_lit_from(eye) && self.scope.passages(eye, lit.place).is_some() {
                return true;
            }
        }
        (0..TRIES).any(|_| {
            let Some(&(place, normal)) = self.places.get(pick(self.places.len())) else { return false };
            self.ways += 1;
            let is_before = normal.dot(lit.place - place) > 0.0;
            is_before && is_lit_from(place) && self.scope.passages(place, lit.place).is_some()
        })
    }

    /// Returns whether a medium of a region scatters.
    fn is_foggy(&self) -> bool {
        let scene = self.scope.scene;
        let media = scene.regions.iter().filter_map(|region| scene.media.get(region.medium.index()));
        media.into_iter().any(|m| scene.largest(&format!("medium.{}", m.name), "sigma_s", m.sigma_s) > 0.0)
    }

    /// Returns message and advice.
    fn words(&self, hidden: Hidden) -> (String, &'static str) {
        let named =
            |material: MaterialId| self.scope.scene.materials.get(material.index()).map_or(String::new(), title);
        let share = |hundredths: u32| match hundredths {
            100 => "the light".to_owned(),
            part => format!("{part} % of the light"),
        };
        match hidden {
            Hidden::Glass(material, part) => (
                format!(
                    "{} of this lamp cannot get through the solid glass around it ({}): the lamp is a point, and \
                     refracted paths never hit a point",
                    share(part),
                    named(material)
                ),
                "give the lamp a size (in its photometric file, or a small sphere with `ed` instead), or make the glass a \
                 thin sheet (`sides 2`, no `ir`)",
            ),
            Hidden::Mirror(material, part) => (
                format!(
                    "{} of this lamp hits perfect mirrors ({}): the lamp is a point, and paths that a mirror \
                     reflects never hit a point",
                    share(part),
                    named(material)
                ),
                "give the lamp a size (in its photometric file, or a small sphere with `ed` instead), or give the mirror a \
                 roughness (`rs .9 .05`)",
            ),
            Hidden::Stopped(material) => (
                format!(
                    "surfaces block all light of this lamp ({}): the lamp is inside a solid, or behind a one-sided surface",
                    named(material)
                ),
                "move the lamp in front of the surface",
            ),
            Hidden::Near(millimeters) => (
                format!(
                    "the light of this lamp hits only surfaces within {:.1} cm of it, and no camera sees them",
                    f64::from(millimeters) / 10.0
                ),
                "move the lamp out of the wall, or below the ceiling",
            ),
            Hidden::Apart => (
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
    bent: u32,
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
    fn bend(&mut self, material: MaterialId) {
        self.bent += 1;
        self.glass.get_or_insert(material);
    }

    fn mirror(&mut self, material: MaterialId) {
        self.mirrored += 1;
        self.mirror.get_or_insert(material);
    }

    /// Returns the reason if glass and mirrors take most of a point lamp's light.
    fn lost(&self) -> Option<Hidden> {
        let part = |count: u32| (100.0 * f64::from(count) / f64::from(self.rays.max(1))).round() as u32;
        if f64::from(self.bent + self.mirrored) <= LOST * f64::from(self.rays) {
            return None;
        }
        if self.bent >= self.mirrored {
            Some(Hidden::Glass(self.glass?, part(self.bent)))
        } else {
            Some(Hidden::Mirror(self.mirror?, part(self.mirrored)))
        }
    }
}
