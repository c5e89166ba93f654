//! Checks cameras and the size of the scene.

use super::{Faults, Scope, WHOLE_SCENE};
use crate::{
    FaultKind::{Camera as CameraFault, Scale},
    Severity::{Error, Warning},
    description::Camera,
};

/// Largest and smallest scene size that raises no warning, m.
const MAX_SCENE_SIZE: f64 = 1e5;
const MIN_SCENE_SIZE: f64 = 1e-2;
/// Distance, in scene diagonals, from which a camera sees the scene as a dot.
const FAR: f64 = 100.0;

pub(super) fn check(scope: &Scope<'_>, faults: &mut Faults) {
    let size = scope.bounds.diagonal();
    if scope.bounds.is_empty() {
        faults.add(
            Warning,
            Scale,
            WHOLE_SCENE,
            "the scene has no surface and no luminaire",
            "add a surface or a luminaire",
        );
    } else if size > MAX_SCENE_SIZE {
        let message = format!("the scene is {} across", format_length(size));
        faults.add(Warning, Scale, WHOLE_SCENE, message, "give lengths in meters (`xf -s` scales)");
    } else if size < MIN_SCENE_SIZE {
        let message = format!("the scene is only {} across", format_length(size));
        faults.add(Warning, Scale, WHOLE_SCENE, message, "give lengths in meters (`xf -s` scales)");
    }
    if scope.scene.cameras.is_empty() {
        faults.add(Warning, CameraFault, WHOLE_SCENE, "the scene has no camera", "add one: `camera NAME =`");
    }
    scope.scene.cameras.iter().for_each(|camera| check_camera(scope, camera, faults));
}

fn check_camera(scope: &Scope<'_>, camera: &Camera, faults: &mut Faults) {
    let (name, location) = (&camera.name, camera.location);
    let view = camera.target - camera.origin;
    if view.cross(camera.up).length() <= 1e-12 * view.length() * camera.up.length() {
        let message = format!("camera `{name}` has its target at its origin, or its up direction parallel to the view");
        faults.add(Error, CameraFault, location, message, "move the target or turn `up`");
        return;
    }
    if let Some(frame) = blind_frame(scope, camera) {
        let message = format!("camera `{name}` looks along its up direction or at its own origin in frame {frame}");
        faults.add(Error, CameraFault, location, message, "change its path, or turn `up`");
    }
    if camera.shutter_open > camera.shutter_close {
        let message = format!("the shutter of camera `{name}` closes before it opens");
        faults.add(Error, CameraFault, location, message, "give the earlier fraction first");
    } else if camera.shutter_open < camera.shutter_close && scope.scene.clip.is_none() {
        let message = format!("the shutter of camera `{name}` has no effect, because the scene has no frame interval");
        faults.add(Warning, CameraFault, location, message, "add `time t0 t1 fps`, or remove `shutter`");
    }
    if !scope.bounds.is_empty() {
        let eye = camera.at(&scope.scene.paths, scope.time).origin;
        let nearest = eye.clamp(scope.bounds.min, scope.bounds.max);
        let (away, size) = (eye.distance(nearest), scope.bounds.diagonal());
        if away > FAR * size {
            let message = format!(
                "camera `{name}` is {} away from a scene that is {} across",
                format_length(away),
                format_length(size)
            );
            faults.add(Warning, Scale, location, message, "check the units of its origin");
        }
    }
}

/// Maximum number of frames whose views are checked.
const MAX_CHECKED_FRAMES: u32 = 100_000;

/// Returns the first frame in which a camera on a path has no valid view.
fn blind_frame(scope: &Scope<'_>, camera: &Camera) -> Option<u32> {
    let (scene, clip) = (scope.scene, scope.scene.clip?);
    if !camera.is_animated(&scene.paths) {
        return None;
    }
    (1..=scene.frame_count().min(MAX_CHECKED_FRAMES)).find(|frame| {
        let at = camera.at(&scene.paths, clip.start + f64::from(frame - 1) / clip.fps);
        let view = at.target - at.origin;
        view.cross(at.up).length() <= 1e-12 * view.length() * at.up.length()
    })
}

/// Formats a length for messages.
fn format_length(meters: f64) -> String {
    match meters {
        m if m >= 1e4 => format!("{:.4} km", m / 1e3),
        m if m >= 1.0 => format!("{m:.1} m"),
        m if m >= 1e-3 => format!("{:.1} mm", m * 1e3),
        m => format!("{m:.1e} m"),
    }
}
