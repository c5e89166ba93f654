//! Control of the embedded farm: submit or resume a job, write frames as they finish, stop on request.

use super::report::FrameReport;
use super::sidecars::Sidecars;
use super::state::RunState;
use super::target::Target;
use crate::clock::Clock;
use crate::command::client::{self, FarmClient};
use crate::command::embedded::{EmbeddedConfig, EmbeddedFarm};
use crate::command::interrupt::Interrupt;
use crate::command::subject::{self, IncludedLogs};
use crate::exit::{Failure, failed, interrupted};
use crate::output::{Printer, Progress, job as show};
use crate::request::ResolvedRequest;
use crate::request::picture;
use crate::values::Exposure;
use femc_fault::{Point, pass_point_async};
use femc_model::{Control, FrameRecord, JobId, JobState};
use femc_reports::attempts::JobRecord;
use femc_worker::Parcel;
use std::collections::{BTreeMap, btree_map::Entry};
use std::time::Duration;

/// Shortest interval between two status calls, used first, for small scenes.
const MIN_POLL_INTERVAL: Duration = Duration::from_millis(10);
const MAX_POLL_INTERVAL: Duration = Duration::from_millis(200);

/// A request to render frames into files.
pub struct RenderRequest<'a> {
    /// The request.
    pub resolved: &'a ResolvedRequest,
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
pub struct RenderResult {
    /// Rendered frames.
    pub frames: Vec<FrameReport>,
    /// Usage of the tasks, if requested. It includes the earlier runs that this run resumed.
    pub record: Option<JobRecord>,
}

/// Renders the missing frames.
pub fn run(request: &RenderRequest<'_>, state: &RunState, printer: Printer) -> Result<RenderResult, Failure> {
    client::runtime()?.block_on(async {
        let mut interrupt = Interrupt::listen()?;
        let resolved = request.resolved;
        let settings = EmbeddedConfig {
            solved: resolved.solved.clone(),
            ..EmbeddedConfig::with_files(state.log(), state.artifacts(), resolved.workers, resolved.threads)
        };
        let (mut farm, client) = EmbeddedFarm::start(settings).await?;
        if request.watch {
            farm.show_in_browser(printer);
        }
        let outcome = tokio::select! {
            outcome = render_frames(request, &client, state, &mut interrupt, printer) => outcome,
            broken = farm.wait_for_failure() => return Err(broken),
        };
        drop(client);
        farm.stop().await;
        outcome
    })
}

async fn render_frames(
    request: &RenderRequest<'_>,
    farm: &FarmClient,
    state: &RunState,
    interrupt: &mut Interrupt,
    printer: Printer,
) -> Result<RenderResult, Failure> {
    let job = find_or_submit_job(request, farm, state).await?;
    let (mut written, mut seen) = (BTreeMap::new(), 0);
    let mut progress = Progress::new(printer, Clock);
    let mut poll_interval = MIN_POLL_INTERVAL;
    loop {
        let status = farm.status(job).await?;
        let mut lost = false;
        if status.frames_done > seen {
            let records = farm.frames(job).await?;
            seen = records.len() as u32;
            // The job of an earlier run also contains frames whose files exist already.
            for record in records.iter().filter(|record| request.missing.contains(&record.frame)) {
                if let Entry::Vacant(place) = written.entry(record.frame) {
                    match write_frame(request, farm, record).await? {
                        Some(report) => drop(place.insert(report)),
                        None => lost = true,
                    }
                }
            }
        }
        progress.show(&show::progress_snapshot(&status, Some(request.resolved.settings.stop)));
        if lost {
            // The frame is rendered again and counts afterwards.
            seen = 0;
        }
        if status.state.has_ended() && !lost {
            progress.finish();
            if status.state != JobState::Done {
                let mut lines = show::failure_lines(&status);
                lines.push(format!(
                    "{} of {} frames are finished; rerun the command to retry the others",
                    status.frames_done, status.frames_total
                ));
                return Err(failed(lines.join("\n")));
            }
            let record = if request.wants_record {
                Some(subject::fetch_record(farm, job, IncludedLogs::Failures).await?)
            } else {
                None
            };
            return Ok(RenderResult { frames: written.into_values().collect(), record });
        }
        tokio::select! {
            () = tokio::time::sleep(poll_interval) => poll_interval = (poll_interval * 3 / 2).min(MAX_POLL_INTERVAL),
            () = interrupt.wait() => {
                progress.finish();
                let done = request.frames.len() - request.missing.len() + written.len();
                return Err(interrupted(format!(
                    "interrupted: {done} of {} frames are finished in {}; rerun the command to resume",
                    request.frames.len(), request.target.display()
                )));
            }
        }
    }
}

/// Returns the job that an earlier run left, if it fits these frames, else a new one.
async fn find_or_submit_job(
    request: &RenderRequest<'_>,
    farm: &FarmClient,
    state: &RunState,
) -> Result<JobId, Failure> {
    let frames =
        state.frames().filter(|frames| request.is_satisfied_by(frames)).unwrap_or_else(|| request.missing.clone());
    state.save_frames(&frames)?;
    let spec = client::job_spec(request.resolved, &request.scene, frames)?;
    let (job, _) = farm.submit(&request.scene, spec.key(), spec).await?;
    for other in farm.jobs().await? {
        match other.state {
            JobState::Paused if other.job == job => farm.control(job, Control::Resume).await?,
            JobState::Failed | JobState::Cancelled if other.job == job => farm.control(job, Control::Retry).await?,
            state if other.job != job && !state.has_ended() => farm.cancel_if_running(other.job).await?,
            _ => {}
        }
    }
    Ok(job)
}

impl RenderRequest<'_> {
    /// Returns whether a job of `frames` renders all missing frames, and only requested frames.
    fn is_satisfied_by(&self, frames: &[u32]) -> bool {
        let asked_for = frames.iter().all(|frame| self.frames.contains(frame));
        asked_for && self.missing.iter().all(|frame| frames.contains(frame))
    }
}

/// Writes a finished frame; `None`: its image or a file beside it is damaged or gone.
async fn write_frame(
    request: &RenderRequest<'_>,
    farm: &FarmClient,
    record: &FrameRecord,
) -> Result<Option<FrameReport>, Failure> {
    let path = request.target.path(record.frame);
    let Some(bytes) = farm.image(record).await? else { return Ok(None) };
    let bytes = if picture::is_picture(&path) { picture::from_exr(&bytes, request.exposure)? } else { bytes };
    let Some(sidecars) = Sidecars::fetch(farm, record).await? else { return Ok(None) };
    sidecars.write(&path)?;
    pass_point_async(Point::RenderBeforeFile).await;
    femc_film::file::write_atomic(&path, &bytes).map_err(failed)?;
    pass_point_async(Point::RenderAfterFile).await;
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
