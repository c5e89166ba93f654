//! Preview of the frame in progress, refreshed beside a progress display.

use super::client::FarmClient;
use super::preview::PreviewFrame;
use crate::exit::{Failure, failed};
use crate::output::half_blocks::{DrawingSize, draw};
use femc_film::ToneCurve;
use femc_model::JobId;
use std::path::PathBuf;
use std::time::Duration;
use tokio::sync::watch;
use tokio::task::{JoinHandle, block_in_place};

/// Interval between two refreshes.
const REFRESH_INTERVAL: Duration = Duration::from_secs(2);

/// Destinations of the preview.
#[derive(Clone, Debug)]
pub struct PreviewTargets {
    /// Whether it is drawn for a terminal.
    pub on_terminal: bool,
    /// File that always contains the latest picture.
    pub file: Option<PathBuf>,
}

/// A background task that previews a job. It ends when this value is dropped.
pub struct LivePreview {
    drawings: watch::Receiver<String>,
    task: JoinHandle<Result<(), Failure>>,
}

impl LivePreview {
    /// Starts the background task.
    pub fn new(farm: FarmClient, job: JobId, targets: PreviewTargets) -> Self {
        let (sender, drawings) = watch::channel(String::new());
        Self { drawings, task: tokio::spawn(run_preview(farm, job, targets, sender)) }
    }

    /// Returns the latest drawing, if it is new.
    /// - errors: the file cannot be written.
    pub async fn latest(&mut self) -> Result<Option<String>, Failure> {
        if self.task.is_finished() {
            (&mut self.task).await.map_err(failed)??;
        }
        let is_new = self.drawings.has_changed().unwrap_or(false);
        Ok(is_new.then(|| self.drawings.borrow_and_update().clone()))
    }
}

impl Drop for LivePreview {
    fn drop(&mut self) {
        self.task.abort();
    }
}

async fn run_preview(
    farm: FarmClient,
    job: JobId,
    targets: PreviewTargets,
    sender: watch::Sender<String>,
) -> Result<(), Failure> {
    let mut partial = None;
    loop {
        // If the coordinator is away or parts are gone, this preview is skipped: the next one shows more.
        if let Ok(Some(frame)) = fetch_partial(&farm, job, partial.take()).await {
            block_in_place(|| publish(&frame, &targets, &sender))?;
            partial = Some(frame);
        }
        tokio::time::sleep(REFRESH_INTERVAL).await;
    }
}

/// Returns the first frame in progress, as far as it is done. `previous`: the previous preview, which is extended if possible.
async fn fetch_partial(
    farm: &FarmClient,
    job: JobId,
    previous: Option<PreviewFrame>,
) -> Result<Option<PreviewFrame>, Failure> {
    let Some(parts) = farm.parts(job).await?.into_iter().next() else { return Ok(None) };
    let mut partial = match previous.filter(|before| before.can_extend(&parts)) {
        Some(before) => before,
        None => PreviewFrame::new(&parts)?,
    };
    Ok(partial.add_parts(farm, &parts).await?.then_some(partial))
}

fn publish(frame: &PreviewFrame, targets: &PreviewTargets, sender: &watch::Sender<String>) -> Result<(), Failure> {
    let color = frame.image()?.color;
    let curve = ToneCurve::auto([&color]);
    if targets.on_terminal {
        // If the receiver is gone, the preview has ended.
        let _ = sender.send(draw(&color, curve, DrawingSize::from_stderr_or_default()));
    }
    if let Some(file) = &targets.file {
        let png = curve.picture(&color).to_png().map_err(failed)?;
        femc_film::file::write_atomic(file, &png).map_err(failed)?;
    }
    Ok(())
}
