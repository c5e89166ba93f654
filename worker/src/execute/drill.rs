//! The drill task: exact arithmetic on numbers. It exercises the farm with results that anybody can check, in stages that iterate
//! and that jobs share.
//!
//! A block is a list of numbers modulo 2^64; the settings give its length. A task without inputs derives its block from the seed
//! and its own number. A task with inputs adds up the blocks that it reads, each multiplied by an odd number of its own, and mixes
//! in its own number. Additions wrap around, so any order gives the same bits. A task whose hints are all available skips its
//! artificial delay.

use std::sync::atomic::Ordering;
use std::time::Duration;

use femc_film::FilmError;
use femc_model::{Artifact, Decision, Digest, Failure, JobSpec, NextRound, Phase, Scope, StageTemplate};
use serde::Deserialize;

use super::inputs::LostInputs;
use super::{Product, Tools, settings_failure};
use crate::clock::Stopwatch;
use crate::task_table::Task;

/// Settings of a drill job.
#[derive(Debug, Clone, Copy, Deserialize)]
struct Settings {
    drill: Drill,
}

#[derive(Debug, Clone, Copy, Deserialize)]
struct Drill {
    /// Seed of the numbers.
    seed: u64,
    /// Length of a block.
    numbers: u32,
    /// Minimum duration of a task.
    #[serde(default)]
    milliseconds: u64,
}

impl Drill {
    /// Largest length of a block.
    const MAX_NUMBERS: u32 = 1 << 20;
    /// Largest allowed value of the minimum duration, milliseconds.
    const MAX_MILLISECONDS: u64 = 60_000;

    fn from_spec(spec: &JobSpec) -> Result<Self, Failure> {
        let Settings { drill } = serde_json::from_str(&spec.settings).map_err(settings_failure)?;
        if drill.numbers == 0 || drill.numbers > Self::MAX_NUMBERS || drill.milliseconds > Self::MAX_MILLISECONDS {
            return Err(settings_failure(format!(
                "a drill must have 1 to {} numbers and take at most {} ms",
                Self::MAX_NUMBERS,
                Self::MAX_MILLISECONDS
            )));
        }
        Ok(drill)
    }

    /// Returns the key of the shared content: a digest of all that the numbers depend on.
    fn key(&self, spec: &JobSpec) -> Digest {
        let stages = spec.graph.stages_of(Scope::Content).map(|(_, template)| template.clone()).collect();
        let mut bytes = femc_model::encode_graph(&femc_model::Graph { stages });
        bytes.extend([self.seed, u64::from(self.numbers)].into_iter().flat_map(u64::to_le_bytes));
        Digest::compute(&bytes)
    }
}

/// Returns the key of the content that drill jobs with these settings and stages share; `None` if the job is not a drill.
pub fn drill_key(spec: &JobSpec) -> Option<Digest> {
    Drill::from_spec(spec).ok().map(|drill| drill.key(spec))
}

pub(super) fn drill(task: &Task, stage: &StageTemplate, tools: &Tools) -> Result<Product, Failure> {
    let (spec, work) = (&task.spec, &task.assignment.spec);
    let drill = Drill::from_spec(spec)?;
    if stage.scope == Scope::Content && spec.content_key(0) != Some(drill.key(spec)) {
        return Err(settings_failure("the content of the job does not match its key"));
    }
    task.set_phase(Phase::Preparing);
    let watch = Stopwatch::start();
    let mut lost = LostInputs::default();
    let inputs: Vec<_> = work.artifacts().collect();
    let here = lost.fetch(task, &inputs, tools)?;
    task.set_phase(Phase::Working);
    let mut sums = vec![0u64; drill.numbers as usize];
    for ((artifact, bytes), input) in here.iter().zip(&work.inputs) {
        lost.check(*artifact, add(&mut sums, bytes, odd(input.item)));
    }
    lost.finish()?;
    if here.is_empty() {
        (0..).zip(&mut sums).for_each(|(place, sum)| *sum = mixed(drill.seed ^ mixed(place)));
    }
    let own = mixed(u64::from(work.item) << 32 | u64::from(task.assignment.task.stage.frame));
    sums.iter_mut().for_each(|sum| *sum = mixed(sum.wrapping_add(own)));
    let is_warm = !stage.hints.is_empty() && has_all_hints(task, tools);
    while !is_warm && watch.elapsed() < Duration::from_millis(drill.milliseconds) {
        if task.cancel.load(Ordering::Relaxed) {
            return Err(Failure::Cancelled);
        }
        std::thread::sleep(Duration::from_millis(5));
    }
    let bytes: Vec<u8> = sums.iter().flat_map(|sum| sum.to_le_bytes()).collect();
    let mut product = Product::default();
    for &role in &stage.outputs {
        product.put(stage, role, || bytes.clone());
    }
    let decision = if work.next_round == NextRound::Possible { Decision::Continue } else { Decision::Done };
    product.result.decision = stage.closes.map(|_| decision);
    product.result.seconds = watch.seconds();
    Ok(product)
}

/// Checks that all hints from the previous frame are available. A task without them still works.
fn has_all_hints(task: &Task, tools: &Tools) -> bool {
    let hints: Vec<Artifact> = task.assignment.spec.hint_artifacts().collect();
    !hints.is_empty() && tools.fetch.fetch_all(&task.client, &hints).iter().all(Result::is_ok)
}

fn add(sums: &mut [u64], bytes: &[u8], times: u64) -> Result<(), FilmError> {
    let (numbers, rest) = bytes.as_chunks::<8>();
    if numbers.len() != sums.len() || !rest.is_empty() {
        return Err(FilmError::Corrupt("the numbers belong to another drill"));
    }
    for (sum, number) in sums.iter_mut().zip(numbers) {
        *sum = sum.wrapping_add(u64::from_le_bytes(*number).wrapping_mul(times));
    }
    Ok(())
}

/// Returns the odd factor for the numbers of a block.
fn odd(item: u32) -> u64 {
    2 * u64::from(item) + 1
}

/// A bijection whose values look random (SplitMix64).
fn mixed(value: u64) -> u64 {
    let value = value.wrapping_add(0x9e37_79b9_7f4a_7c15);
    let value = (value ^ (value >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    let value = (value ^ (value >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    value ^ (value >> 31)
}
