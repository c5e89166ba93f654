//! The camera of a scene that has none.
//!
//! It looks at the middle of what is not a lamp: from inside where light hardly leaves the scene (a closed room, maybe with
//! a window), else from outside along a diagonal. Of the diagonals it takes the one that sees most of what light reaches;
//! where they are equal, the one from the front left, above.

use crate::description::{Camera, Location, RegionBounds, Scene};
use crate::world::{Bounds, Dice, Ending, Hit, Ray, Scope, lamp_points, walk};
use femc_math::glam::DVec3;

/// Walks of light that tell whether the scene is closed.
const WALKS: usize = 512;
/// Share of them that may leave a closed room within their reflections: one wall with a window. An open side lets most out.
const LEAK: f64 = 0.2;
/// Field of view, degrees, vertical.
const FOV: f64 = 60.0;
/// Film, pixels.
const FILM: [u32; 2] = [640, 480];
/// Radius of a scene that is one point, m.
const POINT: f64 = 1.0;
/// How far from the middle of a room to its corner the eye is.
const TO_CORNER: f64 = 0.8;
/// Directions to corners in the order of preference, x right, y away, z up.
const CORNERS: [[f64; 3]; 8] = [
    [-1.0, -1.0, 1.0],
    [1.0, -1.0, 1.0],
    [-1.0, 1.0, 1.0],
    [1.0, 1.0, 1.0],
    [-1.0, -1.0, -1.0],
    [1.0, -1.0, -1.0],
    [-1.0, 1.0, -1.0],
    [1.0, 1.0, -1.0],
];

/// Where the default camera stands.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Standpoint {
    /// In a closed room.
    Inside,
    /// Outside, on a diagonal of the bounding box.
    Outside,
}

/// The camera `default` of a scene at the start of its clip; `None` for a scene with nothing in it to look at, or too
/// large to be looked at.
pub fn default_camera(scene: &Scene) -> Option<(Camera, Standpoint)> {
    let scope = Scope::new(scene);
    let bounds = subject(&scope)?;
    let reached = reached(&scope, &bounds);
    let target = bounds.middle();
    let (origin, standpoint) = match reached {
        Reached { closed: true, places } => (inside(&scope, &bounds, &places), Standpoint::Inside),
        Reached { closed: false, places } => (outside(&scope, &bounds, &places), Standpoint::Outside),
    };
    // Coordinates beyond all measure leave no room for a view.
    if !origin.is_finite() || (target - origin).try_normalize().is_none() {
        return None;
    }
    let camera = Camera {
        name: "default".to_owned(),
        location: Location::default(),
        origin,
        target,
        up: if (target - origin).cross(DVec3::Z).length() > 1e-6 * target.distance(origin) {
            DVec3::Z
        } else {
            DVec3::Y
        },
        fov: FOV,
        film: FILM,
        lens_radius: 0.0,
        focus: 1.0,
        shutter_open: 0.0,
        shutter_close: 0.0,
        along: None,
    };
    Some((camera, standpoint))
}

/// The box of what is not a lamp; of everything, where there is nothing else.
fn subject(scope: &Scope<'_>) -> Option<Bounds> {
    let emits: Vec<bool> = scope.scene.materials.iter().map(|material| material.ed.amount > 0.0).collect();
    let is_lamp = |material: crate::MaterialId| emits.get(material.index()) == Some(&true);
    let triangles = scope.triangles.iter().filter(|t| !is_lamp(t.material)).map(|t| t.bounds());
    let quadrics = scope.quadrics.iter().filter(|q| !is_lamp(q.material)).map(|q| q.bounds());
    let solid = triangles.chain(quadrics).fold(Bounds::EMPTY, Bounds::union);
    let media = scope.scene.regions.iter().filter_map(|region| match region.bounds {
        RegionBounds::Everywhere => None,
        RegionBounds::Box { min, max, to_world } => Some(Bounds { min, max }.placed(&to_world)),
    });
    let found = [solid, scope.bounds, media.fold(Bounds::EMPTY, Bounds::union)];
    found.into_iter().find(|bounds| !bounds.is_empty() && bounds.diagonal().is_finite())
}

/// What light reaches.
struct Reached {
    /// Whether it does not leave the scene.
    closed: bool,
    /// Places just before surfaces.
    places: Vec<DVec3>,
}

/// From the lamps; without any, from the middle, where only walls that face it make a room.
fn reached(scope: &Scope<'_>, bounds: &Bounds) -> Reached {
    let lamps = lamp_points(scope);
    let (mut dice, mut places, mut escaped, mut averted) = (Dice(1), Vec::new(), 0, 0);
    for n in 0..WALKS {
        let lamp = lamps.get(n % lamps.len().max(1));
        let any = dice.direction();
        let (origin, dir) = match lamp {
            Some(lamp) => match lamp.normal {
                Some(normal) => {
                    (lamp.place + 2.0 * scope.offset() * normal, (normal + 0.999 * any).normalize_or(normal))
                }
                None => (lamp.place, any),
            },
            None => (bounds.middle(), any),
        };
        let ray = Ray { origin, dir, far: f64::INFINITY };
        let mut first = true;
        let mut visit = |hit: &Hit, place: DVec3, _: DVec3| {
            averted += usize::from(first && lamp.is_none() && !hit.is_front(&ray));
            first = false;
            places.push(place);
        };
        escaped += usize::from(walk(scope, ray, &mut dice, &mut visit) == Ending::Escaped);
    }
    let most = (LEAK * WALKS as f64) as usize;
    Reached { closed: escaped <= most && averted <= most, places }
}

/// Near the corner of a room from which most of what light reaches can be seen.
fn inside(scope: &Scope<'_>, bounds: &Bounds, places: &[DVec3]) -> DVec3 {
    let (middle, half) = (bounds.middle(), 0.5 * (bounds.max - bounds.min));
    // Above the middle, but below the lamps.
    let corners = CORNERS.map(|[x, y, z]| middle + TO_CORNER * half * DVec3::new(x, y, 0.5 * z));
    best(scope, middle, &corners, places)
}

/// On the diagonal from which most of what light reaches can be seen, as far away as shows the whole box.
fn outside(scope: &Scope<'_>, bounds: &Bounds, places: &[DVec3]) -> DVec3 {
    let (middle, half) = (bounds.middle(), 0.5 * (bounds.max - bounds.min));
    // The box's sphere fits into a cone of 60 degrees at twice its radius.
    let radius = half.length();
    let radius = if radius > 1e-9 * middle.length() { radius } else { POINT };
    // A flat box has no height to look down from.
    let flat = half.max(DVec3::splat(0.3 * radius));
    let corners = CORNERS.map(|sign| middle + 2.0 * radius * (flat * DVec3::from_array(sign)).normalize());
    best(scope, middle, &corners, places)
}

/// Of equally good eyes the first.
fn best(scope: &Scope<'_>, middle: DVec3, eyes: &[DVec3; 8], places: &[DVec3]) -> DVec3 {
    let step = places.len().div_ceil(256).max(1);
    let views = eyes.map(|eye| {
        let clear = |place: &&DVec3| scope.passages(eye, **place).is_some();
        let seen = places.iter().step_by(step).filter(clear).count();
        // From below only where little can be seen from above.
        if eye.z < middle.z { seen / 4 } else { seen }
    });
    let most = views.iter().max().copied().unwrap_or(0);
    // A little more is no reason to leave the order of preference.
    let good = views.iter().position(|&seen| seen as f64 >= 0.8 * most as f64);
    eyes[good.unwrap_or(0)]
}
