//! Jobs, and the operations on them.

use femc_model::{Control, FrameRecord, Grid, JobNotes, JobSpec, JobState};

use super::{ConvertError, convert_all, convert_optional, digest_bytes, parse_digest, required};
use crate::wire;

impl From<JobSpec> for wire::JobSpec {
    fn from(spec: JobSpec) -> Self {
        let JobSpec { name, bundle, entry, settings, frames, grid, graph, contents, priority, owner, tags, notes } =
            spec;
        let Grid { film: [film_width, film_height], tile } = grid;
        let (comment, labels, notify) = split_notes(notes);
        let (bundle, graph, priority) = (digest_bytes(&bundle), Some(graph.into()), priority.into());
        let contents = contents.iter().map(|(end, key)| wire::Content { end: *end, key: digest_bytes(key) }).collect();
        Self {
            name,
            bundle,
            entry,
            settings,
            frames,
            film_width,
            film_height,
            tile,
            graph,
            priority,
            owner,
            tags,
            contents,
            comment,
            labels,
            notify,
        }
    }
}

impl TryFrom<wire::JobSpec> for JobSpec {
    type Error = ConvertError;

    fn try_from(wire: wire::JobSpec) -> Result<Self, ConvertError> {
        Ok(Self {
            name: wire.name,
            bundle: parse_digest("job.bundle", &wire.bundle)?,
            entry: wire.entry,
            settings: wire.settings,
            frames: wire.frames,
            grid: Grid { film: [wire.film_width, wire.film_height], tile: wire.tile },
            graph: required("job.graph", wire.graph)?.try_into()?,
            contents: {
                let content = |entry: wire::Content| Ok((entry.end, parse_digest("job.contents", &entry.key)?));
                wire.contents.into_iter().map(content).collect::<Result<_, ConvertError>>()?
            },
            priority: priority(wire.priority)?,
            owner: wire.owner,
            tags: wire.tags,
            notes: join_notes(wire.comment, wire.labels, wire.notify)?,
        })
    }
}

/// Returns the comment, labels and URL of a job's notes.
pub(super) fn split_notes(notes: JobNotes) -> (String, Vec<wire::Label>, Option<String>) {
    let JobNotes { comment, labels, notify } = notes;
    (comment, labels.into_iter().map(|(name, value)| wire::Label { name, value }).collect(), notify)
}

/// Builds the notes from their parts.
///
/// # Errors
/// Two labels have the same name.
pub(super) fn join_notes(
    comment: String,
    labels: Vec<wire::Label>,
    notify: Option<String>,
) -> Result<JobNotes, ConvertError> {
    let mut notes = JobNotes { comment, notify, ..JobNotes::default() };
    for wire::Label { name, value } in labels {
        if notes.labels.insert(name, value).is_some() {
            return Err(ConvertError::Range { field: "labels" });
        }
    }
    Ok(notes)
}

pub(super) fn priority(value: u32) -> Result<u8, ConvertError> {
    value.try_into().map_err(|_| ConvertError::Range { field: "priority" })
}

impl From<Control> for wire::control_request::Control {
    fn from(control: Control) -> Self {
        match control {
            Control::Pause => Self::Pause(wire::Empty {}),
            Control::Resume => Self::Resume(wire::Empty {}),
            Control::Cancel => Self::Cancel(wire::Empty {}),
            Control::Retry => Self::Retry(wire::Empty {}),
            Control::RetryFrames(frames) => Self::RetryFrames(wire::FrameNumbers { frames }),
            Control::Priority(priority) => Self::Priority(priority.into()),
            Control::Delete => Self::Delete(wire::Empty {}),
        }
    }
}

impl TryFrom<wire::control_request::Control> for Control {
    type Error = ConvertError;

    fn try_from(wire: wire::control_request::Control) -> Result<Self, ConvertError> {
        use wire::control_request::Control as Wire;
        Ok(match wire {
            Wire::Pause(_) => Self::Pause,
            Wire::Resume(_) => Self::Resume,
            Wire::Cancel(_) => Self::Cancel,
            Wire::Retry(_) => Self::Retry,
            Wire::RetryFrames(wire::FrameNumbers { frames }) => Self::RetryFrames(frames),
            Wire::Priority(value) => Self::Priority(priority(value)?),
            Wire::Delete(_) => Self::Delete,
        })
    }
}

impl From<JobState> for wire::JobState {
    fn from(state: JobState) -> Self {
        match state {
            JobState::Queued => Self::Queued,
            JobState::Running => Self::Running,
            JobState::Paused => Self::Paused,
            JobState::Done => Self::Done,
            JobState::Failed => Self::Failed,
            JobState::Cancelled => Self::Cancelled,
        }
    }
}

pub(super) fn state(value: i32) -> Result<JobState, ConvertError> {
    let unknown = ConvertError::Unknown { field: "job.state", value };
    Ok(match wire::JobState::try_from(value).map_err(|_| unknown.clone())? {
        wire::JobState::Unspecified => return Err(unknown),
        wire::JobState::Queued => JobState::Queued,
        wire::JobState::Running => JobState::Running,
        wire::JobState::Paused => JobState::Paused,
        wire::JobState::Done => JobState::Done,
        wire::JobState::Failed => JobState::Failed,
        wire::JobState::Cancelled => JobState::Cancelled,
    })
}

impl From<FrameRecord> for wire::FrameRecord {
    fn from(record: FrameRecord) -> Self {
        let FrameRecord {
            frame,
            outputs,
            spp,
            relative_error,
            blocks,
            bad_samples,
            busy_seconds,
            seconds,
            rounds,
            times,
        } = record;
        let outputs = outputs.into_iter().map(Into::into).collect();
        let (blocks, times) = (blocks.map(Into::into), times.map(Into::into));
        Self { frame, outputs, spp, relative_error, bad_samples, busy_seconds, seconds, blocks, rounds, times }
    }
}

impl TryFrom<wire::FrameRecord> for FrameRecord {
    type Error = ConvertError;

    fn try_from(wire: wire::FrameRecord) -> Result<Self, ConvertError> {
        let wire::FrameRecord {
            frame,
            outputs,
            spp,
            relative_error,
            bad_samples,
            busy_seconds,
            seconds,
            blocks,
            rounds,
            times,
        } = wire;
        let (outputs, blocks, times) = (convert_all(outputs)?, convert_optional(blocks)?, convert_optional(times)?);
        Ok(Self { frame, outputs, spp, relative_error, blocks, bad_samples, busy_seconds, seconds, rounds, times })
    }
}
