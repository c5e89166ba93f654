//! Frames that a run before this one finished: known by what their files say of themselves.

use super::beside::Beside;
use super::report::{BadReport, First, FrameReport};
use crate::exit::{Failure, failed};
use crate::request::Asked;
use crate::request::picture;
use crate::values::Exposure;
use femc_film::convergence::BLOCK;
use std::path::Path;

/// What the file of a finished frame says.
#[derive(Debug)]
pub struct Wanted {
    settings: serde_json::Value,
    /// Of a frame that is rendered once more: the division of its samples.
    allocation: Option<serde_json::Value>,
    scene: String,
    exposure: Exposure,
    beside: Beside,
    /// Blocks of pixels of a frame.
    blocks: u32,
}

impl Wanted {
    /// Of what was asked for; pictures have this exposure.
    pub fn new(asked: &Asked, exposure: Exposure) -> Result<Self, Failure> {
        let settings = serde_json::to_value(asked.settings.stated()).map_err(failed)?;
        let allocation = asked.settings.allocation.as_ref().map(serde_json::to_value).transpose().map_err(failed)?;
        let (scene, beside) = (asked.scene().digest().to_string(), Beside::of(&asked.settings));
        let blocks = asked.film().map(|pixels| pixels.div_ceil(BLOCK)).iter().product();
        Ok(Self { settings, allocation, scene, exposure, beside, blocks })
    }

    /// The frame in `path`, if it is there, whole, and of this build of the engine, scene and settings.
    pub fn there(&self, frame: u32, path: &Path) -> Option<FrameReport> {
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
        if !same || !self.beside.are_there(path) {
            return None;
        }
        let number = |name| says(name)?.parse::<f64>().ok();
        let unlit_blocks = says("unlit_blocks").and_then(|unlit| unlit.parse().ok());
        let is_dark = unlit_blocks == Some(self.blocks);
        Some(FrameReport {
            frame,
            file: path.display().to_string(),
            // The mean over the film, from which samples that were left out are missing.
            spp: number("spp")?.ceil() as u32,
            relative_error: number("relative_error").filter(|error| error.is_finite() && !is_dark),
            blocks: Some(self.blocks),
            unlit_blocks,
            seconds: number("seconds")?,
            bad_samples: says("bad_samples").and_then(|text| account(frame, text)).map_or(0, |bad| bad.total()),
        })
    }
}

/// The accounts of all frames that have bad samples, from their files.
pub fn bad_samples(frames: &[FrameReport]) -> Vec<BadReport> {
    let account_of = |frame: &FrameReport| {
        let attributes = picture::attributes(Path::new(&frame.file))?;
        account(frame.frame, attributes.get("femc:bad_samples")?)
    };
    frames.iter().filter(|frame| frame.bad_samples > 0).filter_map(account_of).collect()
}

/// Reads `nan=2 infinite=0 negative=0 out-of-range=0 first=3,4,9`.
fn account(frame: u32, text: &str) -> Option<BadReport> {
    let field = |name: &str| text.split(' ').find_map(|word| word.strip_prefix(name)?.strip_prefix('='));
    let count = |name| field(name)?.parse().ok();
    let first = field("first").map(|place| {
        let mut numbers = place.split(',').map(|number| number.parse().unwrap_or(0));
        let mut next = || numbers.next().unwrap_or(0);
        First { x: next(), y: next(), sample: next() }
    });
    Some(BadReport {
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
        let bad = account(7, "nan=2 infinite=0 negative=1 out-of-range=0 first=3,4,9").expect("an account");
        assert_eq!((bad.total(), bad.nan, bad.negative), (3, 2, 1));
        assert_eq!(bad.first, Some(First { x: 3, y: 4, sample: 9 }));
        assert_eq!(account(7, "none"), None);
    }
}
