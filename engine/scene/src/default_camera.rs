//! Default camera of a scene without cameras.
//!
//! The camera looks at the middle of everything that is not a lamp. If little light leaves the scene (a closed room, possibly with
//! a window), the camera is inside; otherwise it is outside on a diagonal. It takes the diagonal that sees most of the lit points.
//! Among nearly equal diagonals it prefers the one from the front left, above.

use crate::description::{Camera, Location, RegionBounds, Scene};
use crate::world::{Bounds, Hit, Ray, Scope, SplitMix64, WalkEnd, lamp_points, random_walk};
use femc_math::glam::DVec3;

/// Number of random walks that test whether the scene is closed.
const WALKS: usize = 512;
/// Share of walks that may leave a closed room: enough for one wall with a window. An open side lets most walks out.
const LEAK: f64 = 0.2;
/// Vertical field of view, degrees.
const FOV: f64 = 60.0;
/// Film size, pixels.
const FILM: [u32; 2] = [640, 480];
/// Radius assumed for a scene that is a single point, m.
const POINT: f64 = 1.0;
/// Distance of the eye from the middle of a room, relative to the distance of the corner.
const TO_CORNER: f64 = 0.8;
/// Directions to the corners in order of preference: x right, y away, z up.
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

/// Position of the default camera.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Standpoint {
    /// In a closed room.
    Inside,
    /// Outside, on a diagonal of the bounding box.
    Outside,
}

/// Returns the camera `default` of a scene at the start of its clip. Returns `None` if the scene is empty, or too large for a valid
/// view.
pub fn default_camera(scene: &Scene) -> Option<(Camera, Standpoint)> {
    let scope = Scope::new(scene);
    let bounds = subject(&scope)?;
    let reach = trace_lamp_walks(&scope, &bounds);
    let target = bounds.center();
    let (origin, standpoint) = match reach {
        LampReach { closed: true, lit_points } => (eye_inside(&scope, &bounds, &lit_points), Standpoint::Inside),
        LampReach { closed: false, lit_points } => (eye_outside(&scope, &bounds, &lit_points), Standpoint::Outside),
    };
    // With extremely large coordinates there is no valid view.
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

/// Returns the bounds of everything that is not a lamp, or of the whole scene if there are only lamps.
fn subject(scope: &Scope<'_>) -> Option<Bounds> {
    let emits: Vec<bool> = scope.scene.materials.iter().map(|material| material.ed.amount > 0.0).collect();
    let is_lamp = |material: crate::MaterialId| emits.get(material.index()) == Some(&true);
    let triangles = scope.triangles.iter().filter(|t| !is_lamp(t.material)).map(|t| t.bounds());
    let quadrics = scope.quadrics.iter().filter(|q| !is_lamp(q.material)).map(|q| q.bounds());
    let solid = triangles.chain(quadrics).fold(Bounds::EMPTY, Bounds::union);
    let media = scope.scene.regions.iter().filter_map(|region| match region.bounds {
        RegionBounds::Everywhere => None,
        RegionBounds::Box { min, max, to_world } => Some(Bounds { min, max }.transformed(&to_world)),
    });
    let found = [solid, scope.bounds, media.fold(Bounds::EMPTY, Bounds::union)];
    found.into_iter().find(|bounds| !bounds.is_empty() && bounds.diagonal().is_finite())
}

/// Result of the walks of light.
struct LampReach {
    /// Whether light stays in the scene.
    closed: bool,
    /// Points just before the surfaces that light reaches.
    lit_points: Vec<DVec3>,
}

/// Traces walks from the lamps. Without lamps, they start in the middle, and walls seen from behind count as open.
fn trace_lamp_walks(scope: &Scope<'_>, bounds: &Bounds) -> LampReach {
    let lamps = lamp_points(scope);
    let (mut rng, mut lit_points, mut escaped, mut averted) = (SplitMix64(1), Vec::new(), 0, 0);
    for n in 0..WALKS {
        let lamp = lamps.get(n % lamps.len().max(1));
        let any = rng.direction();
        let (origin, dir) = match lamp {
            Some(lamp) => match lamp.normal {
                Some(normal) => {
                    (lamp.position + 2.0 * scope.offset() * normal, (normal + 0.999 * any).normalize_or(normal))
                }
                None => (lamp.position, any),
            },
            None => (bounds.center(), any),
        };
        let ray = Ray { origin, dir, far: f64::INFINITY };
        let mut first = true;
        let mut visit = |hit: &Hit, place: DVec3, _: DVec3| {
            averted += usize::from(first && lamp.is_none() && !hit.is_front(&ray));
            first = false;
            lit_points.push(place);
        };
        escaped += usize::from(random_walk(scope, ray, &mut rng, &mut visit) == WalkEnd::Escaped);
    }
    let most = (LEAK * WALKS as f64) as usize;
    LampReach { closed: escaped <= most && averted <= most, lit_points }
}

/// Returns the point near a corner of a room that sees most of the lit points.
fn eye_inside(scope: &Scope<'_>, bounds: &Bounds, lit_points: &[DVec3]) -> DVec3 {
    let (middle, half) = (bounds.center(), 0.5 * (bounds.max - bounds.min));
    // Above the middle, but below the lamps.
    let corners = CORNERS.map(|[x, y, z]| middle + TO_CORNER * half * DVec3::new(x, y, 0.5 * z));
    best_eye(scope, middle, &corners, lit_points)
}

/// Returns the point on a diagonal that sees most of the lit points, far enough away to show the whole box.
fn eye_outside(scope: &Scope<'_>, bounds: &Bounds, lit_points: &[DVec3]) -> DVec3 {
    let (middle, half) = (bounds.center(), 0.5 * (bounds.max - bounds.min));
    // At a distance of twice its radius, the bounding sphere fits into a cone of 60 degrees.
    let radius = half.length();
    let radius = if radius > 1e-9 * middle.length() { radius } else { POINT };
    // A flat box has too little height for a view from above.
    let flat = half.max(DVec3::splat(0.3 * radius));
    let corners = CORNERS.map(|sign| middle + 2.0 * radius * (flat * DVec3::from_array(sign)).normalize());
    best_eye(scope, middle, &corners, lit_points)
}

/// Returns the best eye; among nearly equal ones, the first.
fn best_eye(scope: &Scope<'_>, middle: DVec3, eyes: &[DVec3; 8], lit_points: &[DVec3]) -> DVec3 {
    let step = lit_points.len().div_ceil(256).max(1);
    let views = eyes.map(|eye| {
        let clear = |place: &&DVec3| scope.invisible_backs_between(eye, **place).is_some();
        let seen = lit_points.iter().step_by(step).filter(clear).count();
        // A view from below is chosen only if little can be seen from above.
        if eye.z < middle.z { seen / 4 } else { seen }
    });
    let most = views.iter().max().copied().unwrap_or(0);
    // A slightly better view does not change the order of preference.
    let good = views.iter().position(|&seen| seen as f64 >= 0.8 * most as f64);
    eyes[good.unwrap_or(0)]
}
