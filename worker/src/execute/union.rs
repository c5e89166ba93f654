//! The union of tiles, keyed by (tile, sample range): in any order and grouping the same sums to the bit.

use std::collections::BTreeMap;
use std::fmt::Display;
use std::ops::Range;
use std::sync::atomic::Ordering;

use bytes::Bytes;
use femc_fault::{Point, pass};
use femc_film::tile::Ends;
use femc_film::{FilmError, Frame, SampleRange, Stops, Tile, Tiling};
use femc_model::{Artifact, Digest, Failure, Reach, Role, Template};
use rayon::prelude::*;

use super::{Tools, unfit};
use crate::sums;
use crate::table::Task;

/// Tiles that are downloaded and taken in side by side: bounds what is in memory beside the frame.
const BATCH: usize = 16;
/// The same of groups of tiles.
const GROUPS: usize = 4;

/// How the job's film is cut.
pub(super) fn tiling(task: &Task) -> Result<Tiling, Failure> {
    let grid = task.spec.grid;
    let tiling = Tiling::new(grid.film[0], grid.film[1], grid.tile);
    tiling.map_err(unfit)
}

/// The tiles that the task unites, by what its stage reads of them: outputs of `role`, one or more for each tile.
pub(super) fn tiles(task: &Task, stage: &Template, role: Role) -> Result<Range<u32>, Failure> {
    let (item, tiles) = (task.assignment.work.item, task.spec.grid.tiles());
    match stage.needs.iter().find(|need| need.role == role).map(|need| need.reach) {
        Some(Reach::All) => Ok(0..tiles),
        Some(Reach::Fan(fan)) => Ok(item.saturating_mul(fan).min(tiles)..(item + 1).saturating_mul(fan).min(tiles)),
        Some(Reach::Same | Reach::Previous) | None => Err(unfit("the job's graph has a stage that unites no tiles")),
    }
}

/// Samples that a tile has been given in all rounds until now.
/// - `place`: of the tile among those that the task reads, at first or at second hand.
fn given(task: &Task, place: usize) -> u32 {
    task.assignment.work.taken.of(place).unwrap_or(0)
}

/// What the task reads of one role, in order.
pub(super) fn artifacts(task: &Task, role: Role) -> Vec<Artifact> {
    task.assignment.work.of_role(role).map(|input| input.output.artifact).collect()
}

/// What the decision of the round before has left; `None` in the first round.
pub(super) fn stops(task: &Task, tools: &Tools) -> Result<Option<Stops>, Failure> {
    let (tiles, mut lost, mut found) = (tiling(task)?.count(), Lost::default(), None);
    for (artifact, bytes) in lost.fetch(task, &artifacts(task, Role::Stops), tools)? {
        lost.check(artifact, Stops::decode(&bytes, tiles).map(|stops| found = Some(stops)));
    }
    lost.verdict()?;
    Ok(found)
}

/// The samples of a tile when the round is whole, those of a pilot among them.
pub(super) fn expected(task: &Task, place: usize) -> SampleRange {
    (0..given(task, place)).into()
}

/// The sums of the rounds before and the tiles of this one, of the tiles `span`. Whole: each of them holds just the samples
/// of these rounds, in whatever parts they came. Names every input that is lost, so that all are made again at once.
pub(super) fn union(task: &Task, span: Range<u32>, tools: &Tools) -> Result<Frame, Failure> {
    let mut frame = Frame::new(tiling(task)?);
    let mut lost = Lost::default();
    // What each tile of this round is made of.
    let mut made_of: BTreeMap<Option<usize>, Vec<Digest>> = BTreeMap::new();
    let stops = stops(task, tools)?;
    let begin = stops.as_ref().map_or(0, |stops| stops.pace.begin);
    for (previous, bytes) in lost.fetch(task, &artifacts(task, Role::Sums), tools)? {
        let counts = |tile: &Tile| tile.ranges().last().is_some_and(|range| range.end > begin);
        let insert =
            |tiles: Vec<Tile>| tiles.into_iter().filter(counts).try_for_each(|tile| frame.insert(tile).map(drop));
        lost.check(previous, tools.install(task, || sums::decode(&bytes)).and_then(insert));
    }
    if let Some(stops) = stops {
        // Sums of samples on both sides of an end were made by another build or are damaged: they are made again.
        let hold = |(index, ends): (usize, &Ends)| frame.hold(index, *ends);
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
            pass(Point::WorkerMidReduce);
            let place = tile.as_ref().ok().and_then(|tile| frame.tiling().index_of(tile.rect()));
            made_of.entry(place).or_default().push(artifact.digest);
            lost.check(*artifact, tile.and_then(|tile| frame.insert(tile).map(drop)));
        }
    }
    lost.verdict()?;
    for (place, index) in (span.start as usize..span.end as usize).enumerate() {
        let (found, expected) = (frame.ranges(index), (begin..given(task, place)).into());
        if SampleRange::joined(found) != Some(expected) {
            let message = format!("tile {index} holds the samples {found:?}, not {expected:?}");
            let Some(digests) = made_of.remove(&Some(index)) else { return Err(Failure::Panicked { message }) };
            lost.digests.extend(digests);
            lost.message = message;
        }
    }
    lost.verdict()?;
    Ok(frame)
}

/// What the task reads of one role, which is made of groups of tiles: every tile of the frame once, each with just the samples that
/// it was given. Names every input that is lost.
/// - `account`: how the film of a group is cut, its tiles, the samples of each.
/// - `take`: takes a group in, in order of its tiles.
pub(super) fn groups<T: Send>(
    task: &Task,
    role: Role,
    tools: &Tools,
    decode: fn(&[u8]) -> Result<T, FilmError>,
    account: impl Fn(&T) -> (Tiling, Range<usize>, Vec<SampleRange>),
    mut take: impl FnMut(T) -> Result<(), FilmError>,
) -> Result<(), Failure> {
    let (tiling, mut lost, mut past, mut covered) = (tiling(task)?, Lost::default(), 0, 0);
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
            pass(Point::WorkerMidReduce);
            let taken = group.and_then(|group| {
                let (of, tiles, samples) = account(&group);
                let mut is_own =
                    |it: &SampleRange, tile| it.end == given(task, tile) && *begin.get_or_insert(it.start) == it.start;
                let is_whole = tiles.clone().zip(samples).all(|(tile, samples)| is_own(&samples, tile));
                if of != tiling || tiles.start < past || !is_whole {
                    return Err(FilmError::Corrupt("tiles of another frame, round or place"));
                }
                (covered, past) = (covered + tiles.len(), tiles.end);
                take(group)
            });
            lost.check(*artifact, taken);
        }
    }
    lost.verdict()?;
    let wanted = tiling.count();
    if covered == wanted { Ok(()) } else { Err(unfit(format!("{covered} tiles are there, the frame has {wanted}"))) }
}

/// Takes in all inputs of one role in order, a batch at a time; names those that are lost or do not fit.
pub(super) fn each<E: Display>(
    task: &Task,
    role: Role,
    tools: &Tools,
    mut take: impl FnMut(&[u8]) -> Result<(), E> + Send,
) -> Result<(), Failure> {
    let mut lost = Lost::default();
    for batch in artifacts(task, role).chunks(BATCH) {
        if task.is_cancelled() {
            return Err(Failure::Cancelled);
        }
        let here = lost.fetch(task, batch, tools)?;
        tools.install(task, || here.iter().for_each(|(artifact, bytes)| lost.check(*artifact, take(bytes))));
    }
    lost.verdict()
}

/// Inputs that are missing or damaged.
#[derive(Debug, Default)]
pub(super) struct Lost {
    digests: Vec<Digest>,
    message: String,
}

impl Lost {
    /// Downloads these, which shows as progress; what is lost is left out, a failure of another kind ends the task.
    pub(super) fn fetch(
        &mut self,
        task: &Task,
        artifacts: &[Artifact],
        tools: &Tools,
    ) -> Result<Vec<(Artifact, Bytes)>, Failure> {
        let mut here = Vec::with_capacity(artifacts.len());
        for (artifact, bytes) in artifacts.iter().zip(tools.fetch.all(&task.client, artifacts)) {
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

    /// Takes note of one that does not fit.
    pub(super) fn check(&mut self, artifact: Artifact, outcome: Result<(), impl Display>) {
        if let Err(error) = outcome {
            self.digests.push(artifact.digest);
            self.message = error.to_string();
        }
    }

    /// Fails if anything is lost.
    pub(super) fn verdict(&mut self) -> Result<(), Failure> {
        if self.digests.is_empty() {
            return Ok(());
        }
        let Self { digests, message } = std::mem::take(self);
        Err(Failure::LostInputs { digests, message })
    }
}
