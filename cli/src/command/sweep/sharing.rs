//! Sharing among the variants of a sweep, counted before anything runs.

use super::folder::SweepFolder;
use super::resolved::ResolvedSweep;
use crate::output::{Printer, human};
use femc_pipeline::StopCondition;
use serde::Serialize;
use std::collections::BTreeSet;

/// Counts of shared work.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct SharingCounts {
    /// Number of variants.
    pub variants: usize,
    /// Frames of all variants.
    pub frames: usize,
    /// Frames finished before.
    pub there: usize,
    /// Frames equal to another frame of the sweep: linked, not rendered.
    pub linked: usize,
    /// Frames to render.
    pub render: usize,
    /// Number of different worlds among the frames to render. Each world is prepared once, apart from cameras.
    pub worlds: usize,
    /// Number of different first passes among the frames to render. Worlds that differ only in a common brightness factor of all
    /// lamps share one. 0 without a first pass.
    pub first_passes: usize,
    /// Camera samples saved, if their number is known in advance.
    pub samples_saved: u64,
}

impl SharingCounts {
    /// Counts the sharing. `folder`: existing frames.
    pub fn count(sweep: &ResolvedSweep, folder: Option<&SweepFolder>) -> Self {
        let mut counts = Self { variants: sweep.variants.len(), ..Self::default() };
        let (mut keys, mut worlds, mut first_passes) = (BTreeSet::new(), BTreeSet::new(), BTreeSet::new());
        for variant in &sweep.variants {
            let [width, height] = variant.spec.grid.film;
            let samples = match variant.stop {
                StopCondition::Spp(spp) => u64::from(width) * u64::from(height) * u64::from(spp),
                StopCondition::Error(_) | StopCondition::Time(_) => 0,
            };
            for (place, planning) in (0..).zip(&variant.frames) {
                counts.frames += 1;
                if folder.is_some_and(|folder| folder.has(&variant.file(planning.frame), &planning.key)) {
                    counts.there += 1;
                } else if folder.is_some_and(|folder| folder.has_key(&planning.key)) || !keys.insert(&planning.key) {
                    counts.linked += 1;
                    counts.samples_saved += samples;
                } else {
                    counts.render += 1;
                    worlds.insert(planning.world);
                    first_passes.extend(variant.spec.content_key(place));
                }
            }
        }
        (counts.worlds, counts.first_passes) = (worlds.len(), first_passes.len());
        counts
    }

    /// Returns the counts as lines for people.
    pub fn lines(&self) -> Vec<String> {
        let Self { variants, frames, there, linked, render, worlds, first_passes, samples_saved } = *self;
        let count = |n: usize, what: &str| human::counted_noun(n as u64, what);
        let mut lines = vec![format!(
            "{}, {}: {render} to render, {linked} equal to others and linked, {there} already finished",
            count(variants, "variant"),
            count(frames, "frame")
        )];
        if render > 0 {
            let prepared = match worlds {
                _ if worlds == render => "every frame has its own world".to_owned(),
                1 => format!("{} share one world and differ only in the camera", count(render, "frame")),
                _ => format!("{} have {worlds} worlds; the others differ only in the camera", count(render, "frame")),
            };
            let variants = count(variants, "variant");
            lines.push(format!("the scene is read once for {variants}, static parts are built once; {prepared}"));
        }
        if first_passes > 0 {
            let [solved, frames] = [(first_passes, "time"), (render, "frame")].map(|(n, what)| count(n, what));
            lines.push(format!("the first pass is solved {solved} for {frames}"));
        }
        if samples_saved > 0 {
            lines.push(format!("linking saves {} samples", human::quantity(samples_saved as f64)));
        }
        lines
    }

    /// Prints the counts on stderr.
    pub fn note(&self, printer: Printer) {
        self.lines().iter().for_each(|line| printer.note(line));
    }
}
