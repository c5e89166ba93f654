//! Control of the embedded farm: submit or resume a job, write frames as they finish, stop on request.

use super::beside::Found;
use super::report::FrameReport;
use super::state::State;
use super::target::Target;
use crate::clock::Clock;
use crate::command::client::{self, Farm};
use crate::command::embedded::{self, Embedded};
use crate::command::interrupt::Interrupt;
use crate::command::subject::{self, Logs};
use crate::exit::{Failure, failed, interrupted};
use crate::output::{Progress, Say, job as show};
use crate::request::Asked;
use crate::request::picture;
use crate::values::Exposure;
use femc_fault::{Point, pass_async};
use femc_model::{Control, FrameRecord, JobId, JobState};
use femc_reports::attempts::JobRecord;
use femc_worker::Parcel;
use std::collections::{BTreeMap, btree_map::Entry};
use std::time::Duration;

/// Shortest interval between two status calls, used first, for small scenes.
const FIRST_LOOK: Duration = Duration::from_millis(10);
const LAST_LOOK: Duration = Duration::from_millis(200);

/// A request to render frames into files.
pub struct Order<'a> {
    /// The request.
    pub asked: &'a Asked,
    /// File or folder that the frames are written to.
    pub target: &'a Target,
    /// Exposure of pictures.
    pub exposure: Exposure,
    /// All requested frames.
    pub frames: &'a [u32],
    /// Requested frames whose files do not exist yet.
    pub missing: Vec<u32>,
    /// Whether the run is shown in a browser.
    pub watch: bool,
    /// The scene's files.
    pub scene: Parcel,
    /// Whether the usage of the tasks is read at the end.
    pub wants_record: bool,
}

/// Result of a run.
pub struct Made {
    /// Rendered frames.
    pub frames: Vec<FrameReport>,
    /// Usage of the tasks, if requested. It includes the earlier runs that this run resumed.
    pub record: Option<JobRecord>,
}

/// Renders the missing frames.
pub fn run(order: &Order<'_>, state: &State, say: Say) -> Result<Made, Failure> {
    client::runtime()?.block_on(async {
        let mut interrupt = Interrupt::listen()?;
        let plan = embedded::Plan {
            log: state.log(),
            artifacts: state.artifacts(),
            workers: order.asked.workers,
            threads: order.asked.threads,
        };
        let (mut farm, client) = Embedded::start(plan).await?;
        if order.watch {
            farm.show(say);
        }
        let outcome = tokio::select! {
            outcome = frames(order, &client, state, &mut interrupt, say) => outcome,
            broken = farm.broken() => return Err(broken),
        };
        drop(client);
        farm.stop().await;
        outcome
    })
}

async fn frames(
    order: &Order<'_>,
    farm: &Farm,
    state: &State,
    interrupt: &mut Interrupt,
    say: Say,
) -> Result<Made, Failure> {
    let job = job(order, farm, state).await?;
    let (mut written, mut seen) = (BTreeMap::new(), 0);
    let mut progress = Progress::new(say, Clock);
    let mut look = FIRST_LOOK;
    loop {
        let status = farm.status(job).await?;
        let mut lost = false;
        if status.frames_done > seen {
            let records = farm.frames(job).await?;
            seen = records.len() as u32;
            // The job of an earlier run also contains frames whose files exist already.
            for record in records.iter().filter(|record| order.missing.contains(&record.frame)) {
                if let Entry::Vacant(place) = written.entry(record.frame) {
                    match write(order, farm, record).await? {
                        Some(report) => drop(place.insert(report)),
                        None => lost = true,
                    }
                }
            }
        }
        progress.show(&show::snapshot(&status, Some(order.asked.settings.stop)));
        if lost {
            // The frame is rendered again and counts afterwards.
            seen = 0;
        }
        if status.state.has_ended() && !lost {
            progress.finish();
            if status.state != JobState::Done {
                let mut lines = show::trouble(&status);
                lines.push(format!(
                    "{} of {} frames are finished; rerun the command to retry the others",
                    status.frames_done, status.frames_total
                ));
                return Err(failed(lines.join("\n")));
            }
            let record =
                if order.wants_record { Some(subject::of_job(farm, job, Logs::Failures).await?) } else { None };
            return Ok(Made { frames: written.into_values().collect(), record });
        }
        tokio::select! {
            () = tokio::time::sleep(look) => look = (look * 3 / 2).min(LAST_LOOK),
            () = interrupt.wait() => {
                progress.finish();
                let done = order.frames.len() - order.missing.len() + written.len();
                return Err(interrupted(format!(
                    "interrupted: {done} of {} frames are finished in {}; rerun the command to resume",
                    order.frames.len(), order.target.display()
                )));
            }
        }
    }
}

/// Returns the job that an earlier run left, if it fits these frames, else a new one.
async fn job(order: &Order<'_>, farm: &Farm, state: &State) -> Result<JobId, Failure> {
    let frames = state.frames().filter(|frames| order.fit(frames)).unwrap_or_else(|| order.missing.clone());
    state.keep_frames(&frames)?;
    let spec = client::job_spec(order.asked, &order.scene, frames)?;
    let (job, _) = farm.submit(&order.scene, spec.key(), spec).await?;
    for other in farm.jobs().await? {
        match other.state {
            JobState::Paused if other.job == job => farm.control(job, Control::Resume).await?,
            JobState::Failed | JobState::Cancelled if other.job == job => farm.control(job, Control::Retry).await?,
            state if other.job != job && !state.has_ended() => farm.control(other.job, Control::Cancel).await?,
            _ => {}
        }
    }
    Ok(job)
}

impl Order<'_> {
    /// Returns whether a job of `frames` renders all missing frames, and only requested frames.
    fn fit(&self, frames: &[u32]) -> bool {
        let asked_for = frames.iter().all(|frame| self.frames.contains(frame));
        asked_for && self.missing.iter().all(|frame| frames.contains(frame))
    }
}

/// Writes a finished frame; `None`: its image or a file beside it is damaged or gone.
async fn write(order: &Order<'_>, farm: &Farm, record: &FrameRecord) -> Result<Option<FrameReport>, Failure> {
    let path = order.target.path(record.frame);
    let Some(bytes) = farm.image(record).await? else { return Ok(None) };
    let bytes = if picture::is_picture(&path) { picture::of_exr(&bytes, order.exposure)? } else { bytes };
    let Some(beside) = Found::fetch(farm, record).await? else { return Ok(None) };
    beside.write(&path)?;
    pass_async(Point::RenderBeforeFile).await;
    femc_film::file::write_atomic(&path, &bytes).map_err(failed)?;
    pass_async(Point::RenderAfterFile).await;
    Ok(Some(FrameReport {
        frame: record.frame,
        file: path.display().to_string(),
        spp: record.spp,
        relative_error: record.relative_error,
        blocks: record.blocks.map(|blocks| blocks.all),
        unlit_blocks: record.blocks.map(|blocks| blocks.unlit),
        seconds: record.busy_seconds,
        bad_samples: record.bad_samples,
    }))
}
