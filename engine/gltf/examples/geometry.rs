//! Writes the surfaces of a frame as binary glTF: `geometry SCENE FILE.glb [FRAME] [TRIANGLES]`.

use femc_gltf::{GeometryOptions, scene_geometry};
use femc_prepared::{FrameSpec, SceneSource, prepare_frame};
use std::error::Error;
use std::path::Path;

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [scene, file, more @ ..] = &arguments[..] else {
        return Err("usage: geometry SCENE FILE.glb [FRAME] [TRIANGLES]".into());
    };
    let loaded = femc_import::load_scene_file(Path::new(scene))?;
    let source = SceneSource::new(loaded.scene.into());
    let frame = more.first().map_or(Ok(1), |frame| frame.parse())?;
    let mut options = GeometryOptions::default();
    options.max_triangles = more.get(1).map_or(Ok(options.max_triangles), |limit| limit.parse())?;
    let spec = FrameSpec { camera: None, size: None, frame, filter_radius: 1.0 };
    let prepared = prepare_frame(&source, &spec, None)?;
    std::fs::write(file, scene_geometry(&prepared, &options)?)?;
    Ok(())
}
