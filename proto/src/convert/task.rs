//! Tasks, leases, assignments and results.

use std::ops::Range;

use femc_model::{
    Artefact, Assignment, Decision, Epoch, FrameParts, GatherResult, Grid, JobId, MergeInputs, MergeResult, More,
    Parts, Stage, StageKind, TaskKey, TaskResult, TileResult, Work,
};

use super::{ConvertError, each, maybe, need};
use crate::wire;

impl From<StageKind> for wire::StageKind {
    fn from(kind: StageKind) -> Self {
        match kind {
            StageKind::Render => Self::Render,
            StageKind::Merge => Self::Merge,
            StageKind::Gather => Self::Gather,
        }
    }
}

pub(super) fn stage_kind(value: i32) -> Result<StageKind, ConvertError> {
    let unknown = ConvertError::Unknown { field: "stage.kind", value };
    Ok(match wire::StageKind::try_from(value).map_err(|_| unknown.clone())? {
        wire::StageKind::Unspecified => return Err(unknown),
        wire::StageKind::Render => StageKind::Render,
        wire::StageKind::Merge => StageKind::Merge,
        wire::StageKind::Gather => StageKind::Gather,
    })
}

impl From<TaskKey> for wire::TaskKey {
    fn from(task: TaskKey) -> Self {
        let TaskKey { job, stage: Stage { frame, round, kind }, index } = task;
        Self { job: job.0, frame, round, kind: wire::StageKind::from(kind).into(), index }
    }
}

impl TryFrom<wire::TaskKey> for TaskKey {
    type Error = ConvertError;

    fn try_from(wire: wire::TaskKey) -> Result<Self, ConvertError> {
        let stage = Stage { frame: wire.frame, round: wire.round, kind: stage_kind(wire.kind)? };
        Ok(Self { job: JobId(wire.job), stage, index: wire.index })
    }
}

pub(super) fn to_lease(task: TaskKey, epoch: Epoch) -> Option<wire::Lease> {
    Some(wire::Lease { task: Some(task.into()), epoch: epoch.0 })
}

pub(super) fn from_lease(lease: Option<wire::Lease>) -> Result<(TaskKey, Epoch), ConvertError> {
    let lease = need("lease", lease)?;
    Ok((need("lease.task", lease.task)?.try_into()?, Epoch(lease.epoch)))
}

pub(super) fn to_range(range: &Range<u32>) -> wire::Range {
    wire::Range { start: range.start, end: range.end }
}

pub(super) fn from_range(range: wire::Range) -> Range<u32> {
    range.start..range.end
}

impl From<Assignment> for wire::Assignment {
    fn from(assignment: Assignment) -> Self {
        use wire::assignment::Work as Wire;
        let Assignment { task, epoch, lease, copy_of, work } = assignment;
        let work = match work {
            Work::Render { tile, samples } => {
                Wire::Render(wire::RenderWork { samples: Some(to_range(&samples)), tile })
            }
            Work::Merge { inputs, spp, elapsed, busy_seconds, more } => {
                let (Parts { previous, tiles }, groups) = match inputs {
                    MergeInputs::Tiles(parts) => (parts, Vec::new()),
                    MergeInputs::Groups(groups) => (Parts { previous: None, tiles: Vec::new() }, groups),
                };
                let (tiles, groups) = (list(tiles), list(groups));
                let (previous, more) = (previous.map(Into::into), more == More::Rounds);
                Wire::Merge(wire::MergeWork { previous, tiles, spp, elapsed, busy_seconds, more, groups })
            }
            Work::Gather { span, parts: Parts { previous, tiles }, more } => Wire::Gather(wire::GatherWork {
                span: Some(wire::Range { start: span.start, end: span.end }),
                previous: previous.map(Into::into),
                tiles: list(tiles),
                more: more == More::Rounds,
            }),
        };
        let copy_of = copy_of.map_or(0, |epoch| epoch.0);
        Self { lease: to_lease(task, epoch), lease_time: lease, work: Some(work), copy_of }
    }
}

impl TryFrom<wire::Assignment> for Assignment {
    type Error = ConvertError;

    fn try_from(wire: wire::Assignment) -> Result<Self, ConvertError> {
        use wire::assignment::Work as Wire;
        let (task, epoch) = from_lease(wire.lease)?;
        let work = match need("assignment.work", wire.work)? {
            Wire::Render(wire::RenderWork { samples, tile }) => {
                Work::Render { tile, samples: from_range(need("render.samples", samples)?) }
            }
            Wire::Merge(merge) => Work::Merge {
                inputs: if merge.groups.is_empty() {
                    MergeInputs::Tiles(Parts { previous: maybe(merge.previous)?, tiles: each(merge.tiles)? })
                } else {
                    MergeInputs::Groups(each(merge.groups)?)
                },
                spp: merge.spp,
                elapsed: merge.elapsed,
                busy_seconds: merge.busy_seconds,
                more: more(merge.more),
            },
            Wire::Gather(gather) => {
                let wire::Range { start, end } = need("gather.span", gather.span)?;
                let parts = Parts { previous: maybe(gather.previous)?, tiles: each(gather.tiles)? };
                Work::Gather { span: start..end, parts, more: more(gather.more) }
            }
        };
        let copy_of = (wire.copy_of > 0).then_some(Epoch(wire.copy_of));
        Ok(Self { task, epoch, lease: wire.lease_time, copy_of, work })
    }
}

fn more(another: bool) -> More {
    if another { More::Rounds } else { More::Last }
}

fn list(artefacts: Vec<Artefact>) -> Vec<wire::Artefact> {
    artefacts.into_iter().map(Into::into).collect()
}

impl From<TaskResult> for wire::completed::Result {
    fn from(result: TaskResult) -> Self {
        match result {
            TaskResult::Tile(TileResult { tile, samples, bad_samples, seconds }) => {
                Self::Tile(wire::TileResult { tile: Some(tile.into()), samples, bad_samples, seconds })
            }
            TaskResult::Merge(result) => Self::Merge(wire::MergeResult {
                decision: match result.decision {
                    Decision::Continue => wire::Decision::Continue,
                    Decision::Done => wire::Decision::Done,
                }
                .into(),
                sums: result.sums.map(Into::into),
                image: result.image.map(Into::into),
                preview: result.preview.map(Into::into),
                relative_error: result.relative_error,
                bad_samples: result.bad_samples,
                seconds: result.seconds,
            }),
            TaskResult::Gather(GatherResult { sums, pixels, seconds }) => {
                Self::Gather(wire::GatherResult { sums: sums.map(Into::into), pixels: Some(pixels.into()), seconds })
            }
        }
    }
}

impl TryFrom<wire::completed::Result> for TaskResult {
    type Error = ConvertError;

    fn try_from(wire: wire::completed::Result) -> Result<Self, ConvertError> {
        use wire::completed::Result as Wire;
        Ok(match wire {
            Wire::Tile(wire::TileResult { tile, samples, bad_samples, seconds }) => {
                let tile = need("tile.artefact", tile)?.try_into()?;
                Self::Tile(TileResult { tile, samples, bad_samples, seconds: finite(seconds)? })
            }
            Wire::Merge(merge) => Self::Merge(MergeResult {
                decision: decision(merge.decision)?,
                sums: maybe(merge.sums)?,
                image: maybe(merge.image)?,
                preview: maybe(merge.preview)?,
                relative_error: merge.relative_error,
                bad_samples: merge.bad_samples,
                seconds: finite(merge.seconds)?,
            }),
            Wire::Gather(wire::GatherResult { sums, pixels, seconds }) => {
                let pixels = need("gather.pixels", pixels)?.try_into()?;
                Self::Gather(GatherResult { sums: maybe(sums)?, pixels, seconds: finite(seconds)? })
            }
        })
    }
}

fn decision(value: i32) -> Result<Decision, ConvertError> {
    let unknown = ConvertError::Unknown { field: "merge.decision", value };
    Ok(match wire::Decision::try_from(value).map_err(|_| unknown.clone())? {
        wire::Decision::Unspecified => return Err(unknown),
        wire::Decision::Continue => Decision::Continue,
        wire::Decision::Done => Decision::Done,
    })
}

/// Seconds are summed: one that is not a number would spoil the sum for good.
pub(super) fn finite(seconds: f64) -> Result<f64, ConvertError> {
    let is_sound = seconds.is_finite() && seconds >= 0.0;
    is_sound.then_some(seconds).ok_or(ConvertError::Range { field: "seconds" })
}

impl From<FrameParts> for wire::FrameParts {
    fn from(FrameParts { frame, grid, sums, tiles, groups }: FrameParts) -> Self {
        let Grid { film: [film_width, film_height], tile } = grid;
        let (sums, tiles, groups) = (list(sums), list(tiles), list(groups));
        Self { frame, film_width, film_height, tile, sums, tiles, groups }
    }
}

impl TryFrom<wire::FrameParts> for FrameParts {
    type Error = ConvertError;

    fn try_from(wire: wire::FrameParts) -> Result<Self, ConvertError> {
        Ok(Self {
            frame: wire.frame,
            grid: Grid { film: [wire.film_width, wire.film_height], tile: wire.tile },
            sums: each(wire.sums)?,
            tiles: each(wire.tiles)?,
            groups: each(wire.groups)?,
        })
    }
}
