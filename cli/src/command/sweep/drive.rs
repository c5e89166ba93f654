//! Queues the variants of a sweep, and collects their frames as they finish.

use super::folder::{Folder, Order, Shot};
use super::work::{Planned, Work};
use crate::clock::Clock;
use crate::command::client::Farm;
use crate::command::interrupt::Interrupt;
use crate::command::render::FoundBeside;
use crate::command::subject::{self, Logs};
use crate::command::submit::own_key;
use crate::exit::{Failure, interrupted};
use crate::output::{Progress, Say, Snapshot, job as show};
use femc_model::{Control, Digest, FrameRecord, JobId, JobSpec, JobState, JobStatus};
use femc_reports::attempts::{JobRecord, write_record};
use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

/// Shortest interval between two status calls, used first, for small scenes.
const FIRST_LOOK: Duration = Duration::from_millis(20);
const LAST_LOOK: Duration = Duration::from_millis(300);

/// A job of the sweep.
pub struct Queued<'a> {
    /// Variant whose frames it renders.
    pub variant: &'a Planned,
    /// Number of the job.
    pub job: JobId,
    /// Wanted frames of the job that are not fetched yet.
    open: BTreeSet<u32>,
    seen: u32,
}

/// Links frames that exist under another name. Returns the frames that no file has yet, each with the first variant that needs it.
pub fn missing<'a>(work: &'a Work, folder: &mut Folder) -> Result<Vec<(&'a Planned, Vec<u32>)>, Failure> {
    let (mut missing, mut ordered) = (Vec::new(), BTreeSet::new());
    for variant in &work.variants {
        let mut frames = Vec::new();
        for planning in &variant.frames {
            let name = variant.file(planning.frame);
            if folder.has(&name, &planning.key) {
                continue;
            }
            if folder.knows(&planning.key) {
                folder.link(&name, &planning.key)?;
            } else if ordered.insert(&planning.key) {
                frames.push(planning.frame);
            }
        }
        if !frames.is_empty() {
            missing.push((variant, frames));
        }
    }
    Ok(missing)
}

/// Queues a job for each variant with missing frames. Finds jobs again that an earlier run queued.
pub async fn queue<'a>(
    work: &Work,
    missing: Vec<(&'a Planned, Vec<u32>)>,
    folder: &mut Folder,
    farm: &Farm,
) -> Result<Vec<Queued<'a>>, Failure> {
    for (variant, frames) in &missing {
        let order = order(variant, frames, folder);
        folder.keep(&variant.name, order);
    }
    // Save the orders before the first submission, so that jobs queued from here on are found again.
    folder.save()?;
    let mut queued = Vec::new();
    for (variant, frames) in missing {
        let order = order(variant, &frames, folder);
        let spec = JobSpec { frames: order.frames.clone(), ..variant.spec.clone() };
        let (job, _) = farm.submit(&work.scene, Digest::of(order.ticket.as_bytes()), spec).await?;
        folder.keep(&variant.name, Order { job: Some(job.0), ..order });
        queued.push(Queued { variant, job, open: frames.into_iter().collect(), seen: 0 });
    }
    folder.save()?;
    Ok(queued)
}

/// Returns the open order of a variant, if it contains these frames, else a new one.
fn order(variant: &Planned, frames: &[u32], folder: &Folder) -> Order {
    let key = |frames: &[u32]| JobSpec { frames: frames.to_vec(), ..variant.spec.clone() }.key().to_string();
    let fits =
        |order: &&Order| frames.iter().all(|frame| order.frames.contains(frame)) && order.spec == key(&order.frames);
    folder.order(&variant.name).filter(fits).cloned().unwrap_or_else(|| Order {
        frames: frames.to_vec(),
        spec: key(frames),
        ticket: format!("{}/{}", own_key(), variant.name),
        job: None,
    })
}

/// Retries failed jobs of an earlier run, and resumes paused ones.
pub async fn wake(queued: &[Queued<'_>], farm: &Farm) -> Result<(), Failure> {
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
pub async fn cancel_others(queued: &[Queued<'_>], farm: &Farm) -> Result<(), Failure> {
    let ours: BTreeSet<JobId> = queued.iter().map(|queued| queued.job).collect();
    for status in farm.jobs().await?.iter().filter(|s| !ours.contains(&s.job) && !s.state.has_ended()) {
        farm.control(status.job, Control::Cancel).await?;
    }
    Ok(())
}

/// Stores the usage of each job's attempts, for `femc stats` and `femc report`.
async fn keep_record(queued: &[Queued<'_>], folder: &Folder, farm: &Farm) -> Result<(), Failure> {
    let run =
        std::time::SystemTime::now().duration_since(std::time::UNIX_EPOCH).map_or(0, |since| since.as_millis() as u64);
    for queued in queued {
        let Some(order) = folder.order(&queued.variant.name) else { continue };
        let record = subject::of_job(farm, queued.job, Logs::Failures).await?;
        let record = JobRecord { run, variant: Some(queued.variant.name.clone()), ..record };
        write_record(&record, &folder.join(&subject::kept_file(&order.ticket)))?;
    }
    Ok(())
}

/// Writes frames as they finish until all jobs have ended. Returns lines about problems.
pub async fn collect(
    queued: &mut [Queued<'_>],
    folder: &mut Folder,
    farm: &Farm,
    interrupt: &mut Interrupt,
    say: Say,
) -> Result<Vec<String>, Failure> {
    let mut progress = Progress::new(say, Clock);
    let mut look = FIRST_LOOK;
    loop {
        let all: BTreeMap<JobId, JobStatus> =
            farm.patient_jobs().await?.into_iter().map(|status| (status.job, status)).collect();
        let mut is_whole = true;
        for queued in queued.iter_mut() {
            if let Some(status) = all.get(&queued.job).filter(|status| status.frames_done > queued.seen) {
                queued.seen = status.frames_done;
                if queued.take(folder, farm).await? == Took::NotAll {
                    // A lost frame is rendered again and counts afterwards.
                    (queued.seen, is_whole) = (0, false);
                }
            }
        }
        let ours: Vec<&JobStatus> = queued.iter().filter_map(|queued| all.get(&queued.job)).collect();
        progress.show(&together(&ours, queued));
        if is_whole && ours.iter().all(|status| status.state.has_ended()) {
            progress.finish();
            folder.save()?;
            keep_record(queued, folder, farm).await?;
            return Ok(troubles(queued, &all));
        }
        tokio::select! {
            () = tokio::time::sleep(look) => look = (look * 3 / 2).min(LAST_LOOK),
            () = interrupt.wait() => {
                progress.finish();
                folder.save()?;
                let open: usize = queued.iter().map(|queued| queued.open.len()).sum();
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
enum Took {
    All,
    /// A file of a frame was damaged or gone.
    NotAll,
}

impl Queued<'_> {
    /// Writes the finished frames.
    async fn take(&mut self, folder: &mut Folder, farm: &Farm) -> Result<Took, Failure> {
        let mut took = Took::All;
        for record in farm.frames(self.job).await? {
            let planning = self.variant.frames.iter().find(|planning| planning.frame == record.frame);
            if let Some(planning) = planning.filter(|_| self.open.contains(&record.frame)) {
                let Some(bytes) = farm.image(&record).await? else {
                    took = Took::NotAll;
                    continue;
                };
                let Some(beside) = FoundBeside::fetch(farm, &record).await? else {
                    took = Took::NotAll;
                    continue;
                };
                let name = self.variant.file(record.frame);
                folder.write(&name, &bytes, &beside, shot(&planning.key, &record))?;
                self.open.remove(&record.frame);
            }
        }
        Ok(took)
    }
}

fn shot(key: &str, record: &FrameRecord) -> Shot {
    Shot {
        key: key.to_owned(),
        spp: record.spp,
        relative_error: record.relative_error,
        seconds: record.busy_seconds,
        bad_samples: record.bad_samples,
        same_as: None,
    }
}

fn troubles(queued: &[Queued<'_>], all: &BTreeMap<JobId, JobStatus>) -> Vec<String> {
    let trouble = |queued: &Queued<'_>| {
        let name = &queued.variant.name;
        match all.get(&queued.job) {
            Some(status) if status.state == JobState::Done => Vec::new(),
            Some(status) => {
                let mut lines = vec![format!("{name}: job {} is {}", queued.job, status.state.name())];
                lines.extend(show::trouble(status));
                lines
            }
            None => vec![format!("{name}: the farm no longer knows job {}", queued.job)],
        }
    };
    queued.iter().flat_map(trouble).collect()
}

/// Returns the progress of all jobs as if they were one.
fn together(jobs: &[&JobStatus], queued: &[Queued<'_>]) -> Snapshot {
    let mut sum = Snapshot::default();
    let mut weighted = 0.0;
    for status in jobs {
        let stop = queued.iter().find(|queued| queued.job == status.job).map(|queued| queued.variant.stop);
        let one = show::snapshot(status, stop);
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
    Snapshot { fraction: weighted / sum.frames.max(1) as f64, ..sum }
}
