//! Existing frames of an earlier run, recognized by the metadata of their files.

use super::report::{BadSamplesReport, FrameReport, SamplePosition};
use super::sidecars::SidecarKinds;
use crate::command::readings;
use crate::exit::{Failure, failed};
use crate::request::ResolvedRequest;
use crate::request::picture;
use crate::values::Exposure;
use femc_film::convergence::BLOCK_EDGE;
use femc_pipeline::measure::{MeasureRequest, MeasureSettings, MeasurementId};
use std::path::Path;

/// Metadata that the file of a finished frame must have.
#[derive(Debug)]
pub struct ExpectedMetadata {
    settings: serde_json::Value,
    /// Sample allocation of a replayed frame.
    allocation: Option<serde_json::Value>,
    scene: String,
    exposure: Exposure,
    sidecars: SidecarKinds,
    /// Measurement of the frames, and the settings of its readings.
    measurement: Option<(MeasureRequest, MeasureSettings)>,
    /// Number of blocks per frame.
    blocks: u32,
}

impl ExpectedMetadata {
    /// Creates the expected metadata for a request; `exposure`: exposure of pictures.
    pub fn new(resolved: &ResolvedRequest, exposure: Exposure) -> Result<Self, Failure> {
        let settings = serde_json::to_value(resolved.settings.of_image()).map_err(failed)?;
        let allocation = resolved.settings.allocation.as_ref().map(serde_json::to_value).transpose().map_err(failed)?;
        let (scene, sidecars) =
            (resolved.scene().digest().to_string(), SidecarKinds::from_settings(&resolved.settings));
        let of_request = |request: &MeasureRequest| {
            (request.clone(), request.settings(resolved.settings.max_depth, resolved.settings.seed))
        };
        let measurement = resolved.settings.measure.as_ref().map(of_request);
        let blocks = resolved.film().map(|pixels| pixels.div_ceil(BLOCK_EDGE)).iter().product();
        Ok(Self { settings, allocation, scene, exposure, sidecars, measurement, blocks })
    }

    /// Checks whether the readings beside a frame belong to the requested measurement. Without a measurement, none are needed.
    fn has_readings(&self, frame: u32, path: &Path) -> bool {
        self.measurement.as_ref().is_none_or(|(request, settings)| {
            let id = MeasurementId::new(request, settings, (femc_worker::engine(), self.scene.clone()), frame);
            readings::read(path).is_ok_and(|document| document.id == id)
        })
    }

    /// Returns the frame in `path`, if the file is whole and matches this build of the engine, the scene and the settings.
    pub fn existing_frame(&self, frame: u32, path: &Path) -> Option<FrameReport> {
        let attributes = picture::attributes(path)?;
        let says = |name: &str| attributes.get(&format!("femc:{name}")).map(String::as_str);
        let is_shown = attributes.get(picture::EXPOSURE).is_none_or(|shown| *shown == self.exposure.to_string());
        let settings: serde_json::Value = serde_json::from_str(says("settings")?).ok()?;
        let allocation = || serde_json::from_str::<serde_json::Value>(says("allocation")?).ok();
        let same = says("engine") == Some(femc_worker::engine())
            && says("scene") == Some(&self.scene)
            && says("frame")?.parse() == Ok(frame)
            && settings == self.settings
            && (self.allocation.is_none() || self.allocation == allocation())
            && is_shown;
        if !same || !self.sidecars.all_exist(path) || !self.has_readings(frame, path) {
            return None;
        }
        let number = |name| says(name)?.parse::<f64>().ok();
        let unlit_blocks = says("unlit_blocks").and_then(|unlit| unlit.parse().ok());
        let is_dark = unlit_blocks == Some(self.blocks);
        Some(FrameReport {
            frame,
            file: path.display().to_string(),
            // The mean over the film lacks the samples that were left out, so it is rounded up.
            spp: number("spp")?.ceil() as u32,
            relative_error: number("relative_error").filter(|error| error.is_finite() && !is_dark),
            blocks: Some(self.blocks),
            unlit_blocks,
            seconds: number("seconds")?,
            bad_samples: says("bad_samples")
                .and_then(|text| parse_bad_samples(frame, text))
                .map_or(0, |bad| bad.total()),
        })
    }
}

/// Reads the bad samples of all frames that have some from their files.
pub fn bad_samples(frames: &[FrameReport]) -> Vec<BadSamplesReport> {
    let account_of = |frame: &FrameReport| {
        let attributes = picture::attributes(Path::new(&frame.file))?;
        parse_bad_samples(frame.frame, attributes.get("femc:bad_samples")?)
    };
    frames.iter().filter(|frame| frame.bad_samples > 0).filter_map(account_of).collect()
}

/// Parses `nan=2 infinite=0 negative=0 out-of-range=0 first=3,4,9`.
fn parse_bad_samples(frame: u32, text: &str) -> Option<BadSamplesReport> {
    let field = |name: &str| text.split(' ').find_map(|word| word.strip_prefix(name)?.strip_prefix('='));
    let count = |name| field(name)?.parse().ok();
    let first = field("first").map(|place| {
        let mut numbers = place.split(',').map(|number| number.parse().unwrap_or(0));
        let mut next = || numbers.next().unwrap_or(0);
        SamplePosition { x: next(), y: next(), sample: next() }
    });
    Some(BadSamplesReport {
        frame,
        nan: count("nan")?,
        infinite: count("infinite")?,
        negative: count("negative")?,
        out_of_range: count("out-of-range")?,
        first,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_account_of_bad_samples_is_read_back() {
        let bad = parse_bad_samples(7, "nan=2 infinite=0 negative=1 out-of-range=0 first=3,4,9").expect("an account");
        assert_eq!((bad.total(), bad.nan, bad.negative), (3, 2, 1));
        assert_eq!(bad.first, Some(SamplePosition { x: 3, y: 4, sample: 9 }));
        assert_eq!(parse_bad_samples(7, "none"), None);
    }
}
