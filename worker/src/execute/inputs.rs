//! The union of tiles, keyed by (tile, sample range). Any order and grouping gives the same sums, bit for bit.

use std::collections::BTreeMap;
use std::fmt::Display;
use std::ops::Range;
use std::sync::atomic::Ordering;

use bytes::Bytes;
use femc_fault::{Point, pass_point};
use femc_film::tile::HalfEnds;
use femc_film::{FilmError, Frame, SampleRange, SamplingState, Tile, Tiling, sums};
use femc_model::{Artifact, Digest, Failure, Reach, Role, StageTemplate};
use rayon::prelude::*;

use super::{Tools, settings_failure};
use crate::task_table::Task;

/// Number of tiles downloaded and added in parallel; limits the memory beside the frame.
const BATCH: usize = 16;
/// Number of groups of tiles downloaded and added in parallel.
const GROUPS: usize = 4;

/// Returns the tiling of the job's film.
pub(super) fn tiling(task: &Task) -> Result<Tiling, Failure> {
    let grid = task.spec.grid;
    let tiling = Tiling::new(grid.film[0], grid.film[1], grid.tile);
    tiling.map_err(settings_failure)
}

/// Returns the tiles that the task combines. They follow from the stage's inputs of `role`, one or more per tile.
pub(super) fn tile_span(task: &Task, stage: &StageTemplate, role: Role) -> Result<Range<u32>, Failure> {
    let (item, tiles) = (task.assignment.spec.item, task.spec.grid.tiles());
    match stage.needs.iter().find(|need| need.role == role).map(|need| need.reach) {
        Some(Reach::All) => Ok(0..tiles),
        Some(Reach::Fan(fan)) => Ok(item.saturating_mul(fan).min(tiles)..(item + 1).saturating_mul(fan).min(tiles)),
        Some(Reach::Same | Reach::Previous) | None => {
            Err(settings_failure("invalid job graph: a stage that combines tiles has no tiles as inputs"))
        }
    }
}

/// Returns the number of samples that a tile has been given in all rounds so far.
/// - `place`: position of the tile among the tiles that the task reads, directly or through other tasks.
fn sample_count(task: &Task, place: usize) -> u32 {
    task.assignment.spec.steps_taken.get(place).unwrap_or(0)
}

/// Returns the task's inputs of one role, in order.
pub(super) fn artifacts(task: &Task, role: Role) -> Vec<Artifact> {
    task.assignment.spec.inputs_of_role(role).map(|input| input.output.artifact).collect()
}

/// Returns the output of the previous round's decision; `None` in the first round.
pub(super) fn previous_stops(task: &Task, tools: &Tools) -> Result<Option<SamplingState>, Failure> {
    let (tiles, mut lost, mut found) = (tiling(task)?.count(), LostInputs::default(), None);
    for (artifact, bytes) in lost.fetch(task, &artifacts(task, Role::Stops), tools)? {
        lost.check(artifact, SamplingState::decode(&bytes, tiles).map(|stops| found = Some(stops)));
    }
    lost.finish()?;
    Ok(found)
}

/// Returns the sample range of a tile when the round is complete, including the pilot's samples.
pub(super) fn expected_samples(task: &Task, place: usize) -> SampleRange {
    (0..sample_count(task, place)).into()
}

/// Adds the tiles of this round to the sums of the earlier rounds, for the tiles in `span`. Checks that each of these tiles holds
/// exactly the samples of these rounds, no matter in which parts they came. The error names every lost input, so that all are
/// computed again at once.
pub(super) fn reduce_tiles(task: &Task, span: Range<u32>, tools: &Tools) -> Result<Frame, Failure> {
    let mut frame = Frame::new(tiling(task)?);
    let mut lost = LostInputs::default();
    // Inputs of each tile of this round.
    let mut made_of: BTreeMap<Option<usize>, Vec<Digest>> = BTreeMap::new();
    let stops = previous_stops(task, tools)?;
    let begin = stops.as_ref().map_or(0, |stops| stops.progress.first_sample);
    for (previous, bytes) in lost.fetch(task, &artifacts(task, Role::Sums), tools)? {
        let counts = |tile: &Tile| tile.ranges().last().is_some_and(|range| range.end > begin);
        let insert =
            |tiles: Vec<Tile>| tiles.into_iter().filter(counts).try_for_each(|tile| frame.insert(tile).map(drop));
        lost.check(previous, tools.install(task, || sums::decode(&bytes)).and_then(insert));
    }
    if let Some(stops) = stops {
        // Sums with samples on both sides of an end are damaged or come from another build. They are computed again.
        let hold = |(index, ends): (usize, &HalfEnds)| frame.hold(index, *ends);
        let held = stops.ends.iter().enumerate().try_for_each(hold);
        if let (Err(error), [sums, ..]) = (held, &artifacts(task, Role::Sums)[..]) {
            lost.check(*sums, Err(error));
        }
    }
    for batch in artifacts(task, Role::Tile).chunks(BATCH) {
        if task.is_cancelled() {
            return Err(Failure::Cancelled);
        }
        let here = lost.fetch(task, batch, tools)?;
        let decoded: Vec<Result<Tile, FilmError>> =
            tools.install(task, || here.par_iter().map(|(_, bytes)| Tile::decode(bytes)).collect());
        for ((artifact, _), tile) in here.iter().zip(decoded) {
            pass_point(Point::WorkerMidReduce);
            let place = tile.as_ref().ok().and_then(|tile| frame.tiling().index_of(tile.rect()));
            made_of.entry(place).or_default().push(artifact.digest);
            lost.check(*artifact, tile.and_then(|tile| frame.insert(tile).map(drop)));
        }
    }
    lost.finish()?;
    for (place, index) in (span.start as usize..span.end as usize).enumerate() {
        let (found, expected) = (frame.ranges(index), (begin..sample_count(task, place)).into());
        if SampleRange::join(found) != Some(expected) {
            let message = format!("tile {index} has samples {found:?}, expected {expected:?}");
            let Some(digests) = made_of.remove(&Some(index)) else { return Err(Failure::Panicked { message }) };
            lost.digests.extend(digests);
            lost.message = message;
        }
    }
    lost.finish()?;
    Ok(frame)
}

/// Reads all inputs of a role whose outputs are groups of tiles. Checks that every tile of the frame occurs once and has exactly
/// the samples that it was given. The error names every lost input.
/// - `account`: returns a group's tiling, its tiles, and the samples of each tile.
/// - `take`: receives the groups in order of their tiles.
pub(super) fn read_groups<T: Send>(
    task: &Task,
    role: Role,
    tools: &Tools,
    decode: fn(&[u8]) -> Result<T, FilmError>,
    account: impl Fn(&T) -> (Tiling, Range<usize>, Vec<SampleRange>),
    mut take: impl FnMut(T) -> Result<(), FilmError>,
) -> Result<(), Failure> {
    let (tiling, mut lost, mut past, mut covered) = (tiling(task)?, LostInputs::default(), 0, 0);
    // All tiles begin at the same sample.
    let mut begin = None;
    for batch in artifacts(task, role).chunks(GROUPS) {
        if task.is_cancelled() {
            return Err(Failure::Cancelled);
        }
        let here = lost.fetch(task, batch, tools)?;
        let decoded: Vec<Result<T, FilmError>> =
            tools.install(task, || here.par_iter().map(|(_, bytes)| decode(bytes)).collect());
        for ((artifact, _), group) in here.iter().zip(decoded) {
            pass_point(Point::WorkerMidReduce);
            let taken = group.and_then(|group| {
                let (group_tiling, tiles, samples) = account(&group);
                let mut is_own = |it: &SampleRange, tile| {
                    it.end == sample_count(task, tile) && *begin.get_or_insert(it.start) == it.start
                };
                let is_whole = tiles.clone().zip(samples).all(|(tile, samples)| is_own(&samples, tile));
                if group_tiling != tiling || tiles.start < past || !is_whole {
                    return Err(FilmError::Corrupt("tiles of another frame, round or position"));
                }
                (covered, past) = (covered + tiles.len(), tiles.end);
                take(group)
            });
            lost.check(*artifact, taken);
        }
    }
    lost.finish()?;
    let wanted = tiling.count();
    if covered == wanted {
        Ok(())
    } else {
        Err(settings_failure(format!("found {covered} tiles, but the frame has {wanted}")))
    }
}

/// Passes all inputs of one role to `take`, in order and in batches. The error names the inputs that are lost or do not fit.
pub(super) fn for_each_input<E: Display>(
    task: &Task,
    role: Role,
    tools: &Tools,
    mut take: impl FnMut(&[u8]) -> Result<(), E> + Send,
) -> Result<(), Failure> {
    let mut lost = LostInputs::default();
    for batch in artifacts(task, role).chunks(BATCH) {
        if task.is_cancelled() {
            return Err(Failure::Cancelled);
        }
        let here = lost.fetch(task, batch, tools)?;
        tools.install(task, || here.iter().for_each(|(artifact, bytes)| lost.check(*artifact, take(bytes))));
    }
    lost.finish()
}

/// Inputs that are missing or damaged.
#[derive(Debug, Default)]
pub(super) struct LostInputs {
    digests: Vec<Digest>,
    message: String,
}

impl LostInputs {
    /// Downloads `artifacts` and counts them as progress. Lost ones are noted and left out; any other failure ends the task.
    pub(super) fn fetch(
        &mut self,
        task: &Task,
        artifacts: &[Artifact],
        tools: &Tools,
    ) -> Result<Vec<(Artifact, Bytes)>, Failure> {
        let mut here = Vec::with_capacity(artifacts.len());
        for (artifact, bytes) in artifacts.iter().zip(tools.fetch.fetch_all(&task.client, artifacts)) {
            match bytes {
                Ok(bytes) => here.push((*artifact, bytes)),
                Err(Failure::LostInputs { digests, message }) => {
                    self.digests.extend(digests);
                    self.message = message;
                }
                Err(failure) => return Err(failure),
            }
        }
        task.units.fetch_add(here.len() as u64, Ordering::Relaxed);
        Ok(here)
    }

    /// Notes an input that does not fit.
    pub(super) fn check(&mut self, artifact: Artifact, outcome: Result<(), impl Display>) {
        if let Err(error) = outcome {
            self.digests.push(artifact.digest);
            self.message = error.to_string();
        }
    }

    /// Fails if any input is lost.
    pub(super) fn finish(&mut self) -> Result<(), Failure> {
        if self.digests.is_empty() {
            return Ok(());
        }
        let Self { digests, message } = std::mem::take(self);
        Err(Failure::LostInputs { digests, message })
    }
}
