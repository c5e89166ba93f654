//! Queues the variants of a sweep, and collects their frames as they finish.

use super::folder::{FrameEntry, JobOrder, SweepFolder};
use super::resolved::{PlannedVariant, ResolvedSweep};
use crate::clock::Clock;
use crate::command::client::FarmClient;
use crate::command::interrupt::Interrupt;
use crate::command::render::Sidecars;
use crate::command::subject::{self, IncludedLogs};
use crate::command::submit::unique_key;
use crate::exit::{Failure, interrupted};
use crate::output::{Printer, Progress, ProgressSnapshot, job as show};
use femc_model::{Control, Digest, FrameRecord, JobId, JobSpec, JobState, JobStatus};
use femc_reports::attempts::{JobRecord, write_record};
use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

/// Shortest interval between two status calls, used first, for small scenes.
const MIN_POLL_INTERVAL: Duration = Duration::from_millis(20);
const MAX_POLL_INTERVAL: Duration = Duration::from_millis(300);

/// A job of the sweep.
pub struct QueuedJob<'a> {
    /// Variant whose frames it renders.
    pub variant: &'a PlannedVariant,
    /// Number of the job.
    pub job: JobId,
    /// Wanted frames of the job that are not fetched yet.
    unfetched_frames: BTreeSet<u32>,
    frames_seen: u32,
}

/// Links frames that exist under another name. Returns the frames that no file has yet, each with the first variant that needs it.
pub fn link_existing_frames<'a>(
    sweep: &'a ResolvedSweep,
    folder: &mut SweepFolder,
) -> Result<Vec<(&'a PlannedVariant, Vec<u32>)>, Failure> {
    let (mut missing, mut ordered) = (Vec::new(), BTreeSet::new());
    for variant in &sweep.variants {
        let mut frames = Vec::new();
        for planned in &variant.frames {
            let name = variant.file(planned.frame);
            if folder.has(&name, &planned.key) {
                continue;
            }
            if folder.has_key(&planned.key) {
                folder.link(&name, &planned.key)?;
            } else if ordered.insert(&planned.key) {
                frames.push(planned.frame);
            }
        }
        if !frames.is_empty() {
            missing.push((variant, frames));
        }
    }
    Ok(missing)
}

/// Queues a job for each variant with missing frames. Finds jobs again that an earlier run queued.
pub async fn queue_jobs<'a>(
    sweep: &ResolvedSweep,
    missing: Vec<(&'a PlannedVariant, Vec<u32>)>,
    folder: &mut SweepFolder,
    farm: &FarmClient,
) -> Result<Vec<QueuedJob<'a>>, Failure> {
    for (variant, frames) in &missing {
        let order = find_or_create_order(variant, frames, folder);
        folder.set_order(&variant.name, order);
    }
    // Save the orders before the first submission, so that jobs queued from here on are found again.
    folder.save()?;
    let mut queued = Vec::new();
    for (variant, frames) in missing {
        let order = find_or_create_order(variant, &frames, folder);
        let spec = JobSpec { frames: order.frames.clone(), ..variant.spec.clone() };
        let (job, _) = farm.submit(&sweep.scene, Digest::compute(order.ticket.as_bytes()), spec).await?;
        folder.set_order(&variant.name, JobOrder { job: Some(job.0), ..order });
        queued.push(QueuedJob { variant, job, unfetched_frames: frames.into_iter().collect(), frames_seen: 0 });
    }
    folder.save()?;
    Ok(queued)
}

/// Returns the open order of a variant, if it contains these frames, else a new one.
fn find_or_create_order(variant: &PlannedVariant, frames: &[u32], folder: &SweepFolder) -> JobOrder {
    let key = |frames: &[u32]| JobSpec { frames: frames.to_vec(), ..variant.spec.clone() }.key().to_string();
    let fits =
        |order: &&JobOrder| frames.iter().all(|frame| order.frames.contains(frame)) && order.spec == key(&order.frames);
    folder.order(&variant.name).filter(fits).cloned().unwrap_or_else(|| JobOrder {
        frames: frames.to_vec(),
        spec: key(frames),
        ticket: format!("{}/{}", unique_key(), variant.name),
        job: None,
    })
}

/// Retries failed jobs of an earlier run, and resumes paused ones.
pub async fn resume_jobs(queued: &[QueuedJob<'_>], farm: &FarmClient) -> Result<(), Failure> {
    let ours: BTreeSet<JobId> = queued.iter().map(|queued| queued.job).collect();
    for status in farm.jobs().await?.iter().filter(|status| ours.contains(&status.job)) {
        match status.state {
            JobState::Paused => farm.control(status.job, Control::Resume).await?,
            JobState::Failed | JobState::Cancelled => farm.control(status.job, Control::Retry).await?,
            JobState::Queued | JobState::Running | JobState::Done => {}
        }
    }
    Ok(())
}

/// Cancels jobs of an embedded farm that a changed sweep no longer needs.
pub async fn cancel_others(queued: &[QueuedJob<'_>], farm: &FarmClient) -> Result<(), Failure> {
    let ours: BTreeSet<JobId> = queued.iter().map(|queued| queued.job).collect();
    for status in farm.jobs().await?.iter().filter(|s| !ours.contains(&s.job) && !s.state.has_ended()) {
        farm.cancel_if_running(status.job).await?;
    }
    Ok(())
}

/// Stores the usage of each job's attempts, for `femc stats` and `femc report`.
async fn save_records(queued: &[QueuedJob<'_>], folder: &SweepFolder, farm: &FarmClient) -> Result<(), Failure> {
    let run =
        std::time::SystemTime::now().duration_since(std::time::UNIX_EPOCH).map_or(0, |since| since.as_millis() as u64);
    for queued in queued {
        let Some(order) = folder.order(&queued.variant.name) else { continue };
        let record = subject::fetch_record(farm, queued.job, IncludedLogs::Failures).await?;
        let record = JobRecord { run, variant: Some(queued.variant.name.clone()), ..record };
        write_record(&record, &folder.join(&subject::record_file(&order.ticket)))?;
    }
    Ok(())
}

/// Writes frames as they finish until all jobs have ended. Returns lines about problems.
pub async fn collect(
    queued: &mut [QueuedJob<'_>],
    folder: &mut SweepFolder,
    farm: &FarmClient,
    interrupt: &mut Interrupt,
    printer: Printer,
) -> Result<Vec<String>, Failure> {
    let mut progress = Progress::new(printer, Clock);
    let mut poll_interval = MIN_POLL_INTERVAL;
    loop {
        let all: BTreeMap<JobId, JobStatus> =
            farm.jobs_with_retry().await?.into_iter().map(|status| (status.job, status)).collect();
        let mut is_whole = true;
        for queued in queued.iter_mut() {
            if let Some(status) = all.get(&queued.job).filter(|status| status.frames_done > queued.frames_seen) {
                queued.frames_seen = status.frames_done;
                if queued.fetch_frames(folder, farm).await? == FetchOutcome::Incomplete {
                    // A lost frame is rendered again and counts afterwards.
                    (queued.frames_seen, is_whole) = (0, false);
                }
            }
        }
        let ours: Vec<&JobStatus> = queued.iter().filter_map(|queued| all.get(&queued.job)).collect();
        progress.show(&combined_progress(&ours, queued));
        if is_whole && ours.iter().all(|status| status.state.has_ended()) {
            progress.finish();
            folder.save()?;
            save_records(queued, folder, farm).await?;
            return Ok(problem_lines(queued, &all));
        }
        tokio::select! {
            () = tokio::time::sleep(poll_interval) => poll_interval = (poll_interval * 3 / 2).min(MAX_POLL_INTERVAL),
            () = interrupt.wait() => {
                progress.finish();
                folder.save()?;
                let open: usize = queued.iter().map(|queued| queued.unfetched_frames.len()).sum();
                return Err(interrupted(format!(
                    "interrupted: {open} frames are not in {} yet; rerun the command to resume",
                    folder.path().display()
                )));
            }
        }
    }
}

/// Result of fetching finished frames.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum FetchOutcome {
    Complete,
    /// A file of a frame was damaged or gone.
    Incomplete,
}

impl QueuedJob<'_> {
    /// Writes the finished frames.
    async fn fetch_frames(&mut self, folder: &mut SweepFolder, farm: &FarmClient) -> Result<FetchOutcome, Failure> {
        let mut outcome = FetchOutcome::Complete;
        for record in farm.frames(self.job).await? {
            let planned = self.variant.frames.iter().find(|planning| planning.frame == record.frame);
            if let Some(planned) = planned.filter(|_| self.unfetched_frames.contains(&record.frame)) {
                let file = if self.variant.is_only_measured { record.readings() } else { record.image() };
                let bytes = match file {
                    Some(artifact) => farm.get_if_present(&artifact).await?,
                    None => None,
                };
                let Some(bytes) = bytes else {
                    outcome = FetchOutcome::Incomplete;
                    continue;
                };
                let Some(sidecars) = Sidecars::fetch(farm, &record).await? else {
                    outcome = FetchOutcome::Incomplete;
                    continue;
                };
                let name = self.variant.file(record.frame);
                folder.write(&name, &bytes, &sidecars, frame_entry(&planned.key, &record))?;
                self.unfetched_frames.remove(&record.frame);
            }
        }
        Ok(outcome)
    }
}

fn frame_entry(key: &str, record: &FrameRecord) -> FrameEntry {
    FrameEntry {
        key: key.to_owned(),
        spp: record.spp,
        relative_error: record.relative_error,
        seconds: record.busy_seconds,
        bad_samples: record.bad_samples,
        same_as: None,
    }
}

fn problem_lines(queued: &[QueuedJob<'_>], all: &BTreeMap<JobId, JobStatus>) -> Vec<String> {
    let trouble = |queued: &QueuedJob<'_>| {
        let name = &queued.variant.name;
        match all.get(&queued.job) {
            Some(status) if status.state == JobState::Done => Vec::new(),
            Some(status) => {
                let mut lines = vec![format!("{name}: job {} is {}", queued.job, status.state.name())];
                lines.extend(show::failure_lines(status));
                lines
            }
            None => vec![format!("{name}: the farm no longer knows job {}", queued.job)],
        }
    };
    queued.iter().flat_map(trouble).collect()
}

/// Returns the progress of all jobs as if they were one.
fn combined_progress(jobs: &[&JobStatus], queued: &[QueuedJob<'_>]) -> ProgressSnapshot {
    let mut sum = ProgressSnapshot::default();
    let mut weighted = 0.0;
    for status in jobs {
        let stop = queued.iter().find(|queued| queued.job == status.job).map(|queued| queued.variant.stop);
        let one = show::progress_snapshot(status, stop);
        sum.frames_done += one.frames_done;
        sum.frames += one.frames;
        sum.tiles_done += one.tiles_done;
        sum.tiles += one.tiles;
        sum.samples += one.samples;
        // Take the worst frame of all jobs. A frame without light has no error.
        if one.relative_error > sum.relative_error || sum.blocks.is_none() {
            (sum.relative_error, sum.blocks) = (one.relative_error, one.blocks);
        }
        weighted += one.fraction * one.frames as f64;
    }
    ProgressSnapshot { fraction: weighted / sum.frames.max(1) as f64, ..sum }
}
