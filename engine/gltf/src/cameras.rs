//! Cameras of a scene.

use femc_math::glam::DVec3;
use femc_prepared::Prepared;
use femc_scene::Camera;
use serde_json::{Value, json};

/// A camera, and the node that places it.
pub(crate) struct CameraNode {
    pub camera: Value,
    pub node: Value,
}

/// Returns the cameras of the scene in the middle of the frame's shutter, in their order. Cameras without a valid view direction are
/// left out.
/// - `rendered`: name of the frame's camera; `None`: the first.
pub(crate) fn cameras(prepared: &Prepared, rendered: Option<&str>) -> Vec<CameraNode> {
    let scene = &prepared.scene;
    // The frame was prepared from these values, so they can be set.
    let Ok(scalars) = scene.scalars_at(scene.frame_time(prepared.frame)) else { return Vec::new() };
    let rendered = rendered.or(scalars.cameras.first().map(|camera| &*camera.name));
    let mut nodes = Vec::new();
    for camera in &scalars.cameras {
        let [open, close] = scene.shutter(camera, prepared.frame);
        let is_rendered = Some(&*camera.name) == rendered;
        let film = if is_rendered { prepared.camera.film } else { camera.film };
        nodes.extend(camera_node(prepared, &camera.at(&scalars.paths, 0.5 * (open + close)), film, is_rendered));
    }
    nodes
}

fn camera_node(prepared: &Prepared, camera: &Camera, film: [u32; 2], is_rendered: bool) -> Option<CameraNode> {
    let forward = (camera.target - camera.origin).try_normalize()?;
    let right = forward.cross(camera.up).try_normalize()?;
    let up = right.cross(forward);
    let eye = camera.origin - prepared.origin;
    let column = |v: DVec3, w: f64| [v.x, v.y, v.z, w];
    // A camera of glTF looks along -z, with y up.
    let matrix = [column(right, 0.0), column(up, 0.0), column(-forward, 0.0), column(eye, 1.0)].concat();
    let extent = f64::from(prepared.world.bounds().size().length());
    let near = if extent.is_finite() && extent > 0.0 { extent * 1e-4 } else { 1e-3 };
    Some(CameraNode {
        camera: json!({
            "name": camera.name,
            "type": "perspective",
            "perspective": {
                "yfov": camera.fov.to_radians(),
                "aspectRatio": f64::from(film[0]) / f64::from(film[1].max(1)),
                "znear": near,
            },
        }),
        node: json!({
            "name": camera.name,
            "matrix": matrix,
            "extras": {
                "rendered": is_rendered,
                "film": film,
                "lens_radius": camera.lens_radius,
                "focus": camera.focus,
            },
        }),
    })
}
