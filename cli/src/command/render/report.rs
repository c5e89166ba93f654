//! Report of a render.

use crate::output::{Printer, error, human};
use femc_model::BlockCounts;
use serde::Serialize;
use std::fmt;

/// Summary of a render, printed whole by `--json`.
#[derive(Debug, Default, Serialize)]
pub struct RenderReport {
    /// Scene file.
    pub scene: String,
    /// Output, as given with `--out`.
    pub out: String,
    /// The frames' files, in order of frames.
    pub files: Vec<String>,
    /// The frames.
    pub frames: Vec<FrameReport>,
    /// Frames that this run finished; the others existed before.
    pub rendered: usize,
    /// Film size, pixels.
    pub size: [u32; 2],
    /// Wall-clock time of this run, s.
    pub seconds: f64,
    /// Mean samples per pixel over all frames.
    pub spp: f64,
    /// Worst relative error of a frame, if known; none if no sample met light.
    pub relative_error: Option<f64>,
    /// Number of 16x16 blocks in all frames, if known. `unlit_blocks` counts those in which no sample met light.
    pub blocks: Option<u32>,
    pub unlit_blocks: Option<u32>,
    /// Camera samples in all frames.
    pub samples: u64,
    /// Samples left out because they were not finite, negative or out of range.
    pub bad_samples: u64,
    /// Bad samples by frame.
    pub bad: Vec<BadSamplesReport>,
    /// Exposure value of the pictures, if some were made.
    pub exposure_ev: Option<f64>,
    /// Files of the frames' layers, if they have some.
    pub layers: Vec<String>,
    /// Documents with the frames' readings of light, if they were measured.
    pub readings: Vec<String>,
    /// Painted pictures of the frames.
    pub painted: Vec<String>,
    /// PNG files beside the frames.
    pub previews: Vec<String>,
    /// The clip.
    pub video: Option<String>,
    /// The sheet.
    pub contact_sheet: Option<String>,
    /// File with the usage of the tasks.
    pub report: Option<String>,
}

/// A frame.
#[derive(Clone, Debug, Serialize)]
pub struct FrameReport {
    /// Frame number.
    pub frame: u32,
    /// File of the frame.
    pub file: String,
    /// Samples per pixel.
    pub spp: u32,
    /// Worst relative error of a block at 95 % confidence, if known; none if no sample met light.
    pub relative_error: Option<f64>,
    /// Number of 16x16 blocks, if known. `unlit_blocks` counts those in which no sample met light.
    pub blocks: Option<u32>,
    pub unlit_blocks: Option<u32>,
    /// Total seconds that workers spent on the frame.
    pub seconds: f64,
    /// Number of samples left out.
    pub bad_samples: u64,
}

/// Bad samples of a frame.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct BadSamplesReport {
    /// The frame.
    pub frame: u32,
    /// Samples with a NaN.
    pub nan: u64,
    /// Samples with an infinity.
    pub infinite: u64,
    /// Samples with a negative component.
    pub negative: u64,
    /// Samples above the largest accepted radiance.
    pub out_of_range: u64,
    /// First bad sample by row, column and sample.
    pub first: Option<SamplePosition>,
}

/// A sample by its pixel and number.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub struct SamplePosition {
    /// Column.
    pub x: u32,
    /// Row.
    pub y: u32,
    /// Number of the sample in its pixel.
    pub sample: u32,
}

impl BadSamplesReport {
    /// Returns the number of bad samples of all kinds.
    pub fn total(&self) -> u64 {
        self.nan + self.infinite + self.negative + self.out_of_range
    }
}

impl fmt::Display for BadSamplesReport {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "frame {}: {} NaN, {} infinite, {} negative, {} out of range",
            self.frame, self.nan, self.infinite, self.negative, self.out_of_range
        )?;
        match self.first {
            Some(SamplePosition { x, y, sample }) => write!(f, "; the first: pixel {x},{y}, sample {sample}"),
            None => Ok(()),
        }
    }
}

impl RenderReport {
    /// Adds the frames and their sums to the report.
    pub fn add_frames(&mut self, frames: Vec<FrameReport>) {
        let pixels = u64::from(self.size[0]) * u64::from(self.size[1]);
        self.files = frames.iter().map(|frame| frame.file.clone()).collect();
        let spp: u64 = frames.iter().map(|frame| u64::from(frame.spp)).sum();
        self.spp = spp as f64 / frames.len().max(1) as f64;
        self.samples = spp * pixels;
        self.relative_error = frames.iter().filter_map(|frame| frame.relative_error).reduce(f64::max);
        let sum = |count: fn(&FrameReport) -> Option<u32>| frames.iter().filter_map(count).reduce(u32::saturating_add);
        (self.blocks, self.unlit_blocks) = (sum(|frame| frame.blocks), sum(|frame| frame.unlit_blocks));
        self.bad_samples = frames.iter().map(|frame| frame.bad_samples).sum();
        self.frames = frames;
    }

    /// Prints warnings on stderr about important problems.
    pub fn warn(&self, printer: Printer) {
        if let [first, others @ ..] = self.dark_frames().as_slice() {
            let frames = match others.len() {
                0 => format!("frame {first}"),
                more => format!("frame {first} and {}", human::counted_noun(more as u64, "more frame")),
            };
            let scene = &self.scene;
            printer.warning(format!(
                "no sample of {frames} met light; `femc check {scene}` lists lamps that light nothing"
            ));
        }
        if self.bad_samples > 0 {
            let all = human::counted_noun(self.bad_samples, "bad sample");
            printer.warning(format!(
                "{all} of {} left out of the image; please report the scene",
                human::quantity(self.samples as f64)
            ));
            for bad in &self.bad {
                printer.warning(bad);
            }
        }
    }

    /// Returns the frames in which no sample met light.
    fn dark_frames(&self) -> Vec<u32> {
        let is_dark =
            |frame: &&FrameReport| block_counts(frame.blocks, frame.unlit_blocks).is_some_and(BlockCounts::is_dark);
        self.frames.iter().filter(is_dark).map(|frame| frame.frame).collect()
    }

    /// Prints the report on stdout for people.
    pub fn print(&self, printer: Printer) {
        let [width, height] = self.size;
        let what = match self.frames.as_slice() {
            [one] => one.file.clone(),
            frames => format!("{}: {} frames", self.out, frames.len()),
        };
        let mut line = format!("{what}, {width}x{height} pixels, {} samples a pixel", trimmed(self.spp));
        if let Some(error) = error::error_text(self.relative_error, block_counts(self.blocks, self.unlit_blocks)) {
            line += &format!(", {error}");
        }
        if let Some(ev) = self.exposure_ev {
            line += &format!(", exposure EV {ev:.1}");
        }
        line += &format!(", {}", human::seconds(self.seconds));
        let kept = self.frames.len() - self.rendered.min(self.frames.len());
        if kept > 0 {
            line += &format!(" ({} already finished)", human::counted_noun(kept as u64, "frame"));
        }
        printer.result(line);
        for made in [&self.video, &self.contact_sheet, &self.report].into_iter().flatten() {
            printer.result(made);
        }
    }
}

/// Combines two block counts, if both are known.
fn block_counts(all: Option<u32>, unlit: Option<u32>) -> Option<BlockCounts> {
    Some(BlockCounts { all: all?, unlit: unlit? })
}

/// Formats a number without meaningless decimals.
fn trimmed(n: f64) -> String {
    if n.fract() == 0.0 { format!("{n:.0}") } else { format!("{n:.1}") }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_sum_counts_all_frames_and_keeps_the_worst_error() {
        let frame = |frame, spp, relative_error| FrameReport {
            frame,
            file: format!("{frame}.exr"),
            spp,
            relative_error,
            blocks: Some(4),
            unlit_blocks: Some(if relative_error.is_some() { 1 } else { 4 }),
            seconds: 1.0,
            bad_samples: 2,
        };
        let mut report = RenderReport { size: [4, 2], ..RenderReport::default() };
        report.add_frames(vec![frame(1, 16, Some(0.1)), frame(2, 32, Some(0.2)), frame(3, 16, None)]);
        assert_eq!((report.samples, report.bad_samples, report.relative_error), (512, 6, Some(0.2)));
        assert_eq!(report.files, ["1.exr", "2.exr", "3.exr"]);
        assert_eq!((report.blocks, report.unlit_blocks, report.dark_frames()), (Some(12), Some(6), vec![3]));
    }
}
