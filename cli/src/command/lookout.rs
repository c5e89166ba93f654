//! Preview of the frame in progress, refreshed beside a progress display.

use super::client::Farm;
use super::preview::Partial;
use crate::exit::{Failure, failed};
use crate::output::blocks::{Room, draw};
use femc_film::ToneCurve;
use femc_model::JobId;
use std::path::PathBuf;
use std::time::Duration;
use tokio::sync::watch;
use tokio::task::{JoinHandle, block_in_place};

/// Interval between two refreshes.
const EVERY: Duration = Duration::from_secs(2);

/// Destinations of the preview.
#[derive(Clone, Debug)]
pub struct Views {
    /// Whether it is drawn for a terminal.
    pub drawn: bool,
    /// File that always contains the latest picture.
    pub file: Option<PathBuf>,
}

/// A background task that previews a job. It ends when this value is dropped.
pub struct Lookout {
    drawn: watch::Receiver<String>,
    task: JoinHandle<Result<(), Failure>>,
}

impl Lookout {
    /// Starts the background task.
    pub fn new(farm: Farm, job: JobId, views: Views) -> Self {
        let (tell, drawn) = watch::channel(String::new());
        Self { drawn, task: tokio::spawn(look(farm, job, views, tell)) }
    }

    /// Returns the latest drawing, if it is new.
    /// - errors: the file cannot be written.
    pub async fn latest(&mut self) -> Result<Option<String>, Failure> {
        if self.task.is_finished() {
            (&mut self.task).await.map_err(failed)??;
        }
        let is_new = self.drawn.has_changed().unwrap_or(false);
        Ok(is_new.then(|| self.drawn.borrow_and_update().clone()))
    }
}

impl Drop for Lookout {
    fn drop(&mut self) {
        self.task.abort();
    }
}

async fn look(farm: Farm, job: JobId, views: Views, tell: watch::Sender<String>) -> Result<(), Failure> {
    let mut partial = None;
    loop {
        // If the coordinator is away or parts are gone, this preview is skipped: the next one shows more.
        if let Ok(Some(seen)) = see(&farm, job, partial.take()).await {
            block_in_place(|| show(&seen, &views, &tell))?;
            partial = Some(seen);
        }
        tokio::time::sleep(EVERY).await;
    }
}

/// Returns the first frame in progress, as far as it is done. `before`: the previous preview, which is extended if possible.
async fn see(farm: &Farm, job: JobId, before: Option<Partial>) -> Result<Option<Partial>, Failure> {
    let Some(parts) = farm.parts(job).await?.into_iter().next() else { return Ok(None) };
    let mut partial = match before.filter(|before| before.may_take(&parts)) {
        Some(before) => before,
        None => Partial::new(&parts)?,
    };
    Ok(partial.take(farm, &parts).await?.then_some(partial))
}

fn show(seen: &Partial, views: &Views, tell: &watch::Sender<String>) -> Result<(), Failure> {
    let color = seen.image()?.color;
    let curve = ToneCurve::auto([&color]);
    if views.drawn {
        // If the receiver is gone, the preview has ended.
        let _ = tell.send(draw(&color, curve, Room::at_stderr_or_usual()));
    }
    if let Some(file) = &views.file {
        let png = curve.picture(&color).to_png().map_err(failed)?;
        femc_film::file::write_atomic(file, &png).map_err(failed)?;
    }
    Ok(())
}
