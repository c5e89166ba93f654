//! Metadata in a frame's file about its rendering, sufficient to draw its samples again.

use crate::exit::{Failure, failed};
use femc_film::exr::ATTRIBUTE_PREFIX;
use femc_pipeline::{Settings, StopCondition};
use std::collections::BTreeMap;
use std::path::Path;

/// The metadata of a frame.
pub struct FrameMetadata {
    /// Settings, with the allocation of samples if the frame had a time budget.
    pub settings: Settings,
    /// Frame number.
    pub frame: u32,
    /// Digest of the scene.
    pub scene: String,
    /// Build of the engine.
    pub engine: String,
}

impl FrameMetadata {
    /// Parses the attributes of a file.
    pub fn parse(file: &Path, attributes: &BTreeMap<String, String>) -> Result<Self, Failure> {
        let fault = |name: &str, what: &str| {
            failed(format!(
                "{}: {what} attribute {ATTRIBUTE_PREFIX}{name}, so its samples cannot be drawn again; give a frame that this femc \
                 has rendered",
                file.display()
            ))
        };
        let says = |name: &str| {
            let text = attributes.get(&format!("{ATTRIBUTE_PREFIX}{name}"));
            text.ok_or_else(|| fault(name, "no"))
        };
        let unfit = |name: &str| fault(name, "this femc cannot read its");
        let mut settings: Settings = serde_json::from_str(says("settings")?).map_err(|_| unfit("settings"))?;
        if matches!(settings.stop, StopCondition::Time(_)) {
            settings.allocation = Some(serde_json::from_str(says("allocation")?).map_err(|_| unfit("allocation"))?);
        }
        Ok(Self {
            settings,
            frame: says("frame")?.parse().map_err(|_| unfit("frame"))?,
            scene: says("scene")?.clone(),
            engine: says("engine")?.clone(),
        })
    }
}
