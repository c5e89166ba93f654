//! Brute-force search for the nearest source patch of every target patch.

use crate::{PatchField, Patches};
use rayon::prelude::*;

/// Number of target patches between two progress reports.
const PROGRESS_INTERVAL: usize = 1024;

/// Finds the source patch of the least energy for each target patch; ties go to the first one.
/// - `report`: receives the finished fraction, 0 to 1.
pub fn nearest(source: &Patches, target: &Patches, report: impl Fn(f64)) -> PatchField {
    let (sources, count) = (source.grid().count() as u32, target.grid().count());
    let best = |q: u32| {
        (0..sources).fold((u32::MAX, 0), |best, p| {
            let energy = source.energy(p, target, q, best.0);
            if energy < best.0 { (energy, p) } else { best }
        })
    };
    let mut patches = Vec::with_capacity(count);
    while patches.len() < count {
        report(patches.len() as f64 / count as f64);
        let block = patches.len()..count.min(patches.len() + PROGRESS_INTERVAL);
        patches.par_extend(block.into_par_iter().map(|q| best(q as u32).1));
    }
    PatchField { target: target.grid(), source: source.grid(), patches }
}
