//! Helpers for tests that need the whole engine: scenes from text, images, statistics.

pub mod agreement;
pub mod brute;
pub mod clock;
pub mod closed_forms;
pub mod flux;
pub mod fog_light;
pub mod fuzz;
pub mod generated_scenes;
pub mod honesty;
pub mod irradiance;
pub mod laws;
pub mod picture_comparison;
pub mod random_rooms;
pub mod reference;
pub mod relative_variance;
pub mod rng;
pub mod stress;
pub mod text;
pub mod two_rooms;

use femc_film::{Frame, FrameImage};
use femc_import::{Bundle, load_scene};
use femc_pipeline::{Outputs, RenderTask, SceneSource, Settings, StopCondition, plan_job, prepare_frame};
use femc_scene::Scene;
use std::sync::Arc;

/// Creates a scene from the text of one file.
pub fn parse_scene(text: &str) -> Arc<Scene> {
    parse_scene_files(&[("test.mgf", text)])
}

/// Creates a scene from several files. The first file is the scene itself.
///
/// # Panics
/// If the text is not a scene; this is for tests only.
pub fn parse_scene_files(files: &[(&str, &str)]) -> Arc<Scene> {
    let contents = files.iter().map(|(name, text)| (name.to_string(), text.as_bytes().to_vec())).collect();
    let loaded = load_scene(&Bundle(contents), files[0].0).unwrap_or_else(|error| panic!("{error}"));
    Arc::new(loaded.scene)
}

/// Renders one frame in this process, tile by tile.
///
/// # Panics
/// If the plan or the preparation fails; this is for tests only.
pub fn render_frame(scene: &Arc<Scene>, settings: &Settings, frame: u32) -> FrameImage {
    let plan = plan_job(scene, settings, Some(&[frame])).unwrap_or_else(|error| panic!("{error}"));
    let prepared = prepare_frame(&SceneSource::new(scene.clone()), settings, frame, None)
        .unwrap_or_else(|error| panic!("{error}"));
    let mut film = Frame::new(plan.tiling);
    let StopCondition::Spp(spp) = settings.stop else { panic!("tests render a fixed number of samples") };
    for rect in plan.tiling.rects() {
        let done = RenderTask::new(&prepared, settings, rect, 0..spp).render(Outputs::default());
        let tile = done.unwrap_or_else(|error| panic!("{error}")).tile;
        film.insert(tile).unwrap_or_else(|error| panic!("{error}"));
    }
    film.resolve()
}
