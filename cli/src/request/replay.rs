//! A frame that is to be rendered once more, from what its file says of itself.

use crate::command::render::picture::attributes;
use crate::exit::{Failure, usage};
use femc_pipeline::Settings;
use std::path::Path;

/// What the file of a frame says.
pub struct Replay {
    /// Its settings, with the division of its samples if it had a time.
    pub settings: Settings,
    /// Number of the frame.
    pub frame: u32,
    /// Digest of the scene.
    pub scene: String,
    /// Build of the engine.
    pub engine: String,
}

impl Replay {
    /// Of the frame in `file`, EXR or PNG.
    pub fn of(file: &Path) -> Result<Self, Failure> {
        let shown = file.display();
        let Some(attributes) = attributes(file) else {
            return Err(usage(format!(
                "--replay: {shown} is no frame that can be read; give an EXR or PNG file by femc"
            )));
        };
        let says = |name: &str| {
            let text = attributes.get(&format!("femc:{name}"));
            text.ok_or_else(|| usage(format!("--replay: {shown} does not say `femc:{name}`; give a frame by femc")))
        };
        let unfit = |name: &str| usage(format!("--replay: what {shown} says as `femc:{name}` cannot be read"));
        let mut settings: Settings = serde_json::from_str(says("settings")?).map_err(|_| unfit("settings"))?;
        if let Some(text) = attributes.get("femc:allocation") {
            settings.allocation = Some(serde_json::from_str(text).map_err(|_| unfit("allocation"))?);
        } else if matches!(settings.stop, femc_pipeline::Stop::Time(_)) {
            says("allocation")?;
        }
        Ok(Self {
            settings,
            frame: says("frame")?.parse().map_err(|_| unfit("frame"))?,
            scene: says("scene")?.clone(),
            engine: says("engine")?.clone(),
        })
    }
}
