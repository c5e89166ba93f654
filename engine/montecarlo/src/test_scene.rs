//! Scenes for tests.

use crate::path_state::{PathState, SegmentOrigin};
use femc_geometry::Ray;
use femc_import::{Bundle, load_scene};
use femc_math::SampleStream;
use femc_prepared::{FrameSpec, Prepared, SceneSource, prepare_frame};
use std::sync::Arc;

/// Camera at (0, -2.5, 0) that looks along y.
const CAMERA: &str = "camera main =\n origin 0 -2.5 0\n target 0 0 0\n up 0 0 1\n fov 20\n film 1 1\n";

/// Prepares a scene. It gets a camera at (0, -2.5, 0) that looks along y.
pub(crate) fn prepare(text: &str) -> Prepared {
    prepare_with_camera(CAMERA, text)
}

/// Prepares a scene.
/// - `camera`: lines of its camera.
pub(crate) fn prepare_with_camera(camera: &str, text: &str) -> Prepared {
    let files = [("test.mgf".to_owned(), format!("{camera}{text}").into_bytes())];
    let scene = load_scene(&Bundle(files.into()), "test.mgf").unwrap_or_else(|error| panic!("{error}")).scene;
    let spec = FrameSpec { camera: None, size: None, frame: 1, filter_radius: 0.5 };
    prepare_frame(&SceneSource::new(Arc::new(scene)), &spec, None).unwrap_or_else(|error| panic!("{error}"))
}

/// Returns the first ray of a path through the center of the film, with the random numbers of a seed.
pub(crate) fn center_path(scene: &Prepared, seed: u64) -> PathState {
    let ray = scene.camera.view([0.5; 2], 0.5).ray(scene.camera.center(0));
    path_along(scene, ray, seed)
}

/// Returns the first ray of a path along `ray`, with the random numbers of a seed.
pub(crate) fn path_along(scene: &Prepared, ray: Ray, seed: u64) -> PathState {
    let stream = SampleStream::new(seed, 1, 0, 0);
    let mut path = PathState::new(ray, SegmentOrigin::Delta, scene.camera_medium_stack, stream);
    path.begin_ray();
    path
}
