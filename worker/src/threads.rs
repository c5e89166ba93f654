//! The threads that work: one renders, one merges, one prepares ahead; all compute on one pool.

use std::sync::{Arc, mpsc};

use femc_model::{JobSpec, StageKind};
use femc_proto::Client;

use crate::config::WorkerError;
use crate::execute::{Tools, execute};
use crate::finish::Finish;
use crate::table::Table;

/// A frame that will be needed soon.
pub(crate) struct Ahead {
    pub(crate) spec: Arc<JobSpec>,
    pub(crate) frame: u32,
    pub(crate) client: Client,
}

/// Starts the threads; they end when the table is closed and the sender of frames ahead is dropped.
pub(crate) fn start(
    name: &str,
    tools: &Tools,
    table: &Arc<Table>,
    finish: &Finish,
) -> Result<mpsc::Sender<Ahead>, WorkerError> {
    for (kind, what) in [(StageKind::Render, "render"), (StageKind::Merge, "merge")] {
        let (tools, table, finish) = (tools.clone(), table.clone(), finish.clone());
        spawn(format!("{name} {what}"), move || {
            while let Some(task) = table.take(kind) {
                let outcome = execute(&task, &tools);
                finish.done(&task, outcome);
            }
        })?;
    }
    let (ahead, frames) = mpsc::channel::<Ahead>();
    let Tools { cache, fetch, .. } = tools.clone();
    spawn(format!("{name} prepare"), move || {
        for Ahead { spec, frame, client } in frames {
            // The task itself meets the same failure, and reports it.
            let prepare = || drop(cache.frame(&spec, frame, &client, &fetch));
            let _ = std::panic::catch_unwind(std::panic::AssertUnwindSafe(prepare));
        }
    })?;
    Ok(ahead)
}

fn spawn(name: String, work: impl FnOnce() + Send + 'static) -> Result<(), WorkerError> {
    let spawned = std::thread::Builder::new().name(name).spawn(work);
    spawned.map(drop).map_err(|error| WorkerError::Threads(error.to_string()))
}
