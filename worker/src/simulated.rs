//! Hands for simulations: the tasks are really done, on the runtime itself, and take the time that the simulation says.

use std::sync::atomic::Ordering;
use std::sync::{Arc, mpsc};
use std::time::Duration;

use femc_model::{Failure, Phase};

use crate::config::Pace;
use crate::execute::{Product, Tools, execute};
use crate::fetch::Fetch;
use crate::finish::Finish;
use crate::table::{Lane, Table, Task};
use crate::threads::Ahead;

/// Steps in which a task shows its progress.
const STEPS: u32 = 8;

/// Starts the hands; they end when the table is closed. Nothing is prepared ahead.
pub(crate) fn start(pace: &Pace, tools: &Tools, table: &Arc<Table>, finish: &Finish) -> mpsc::Sender<Ahead> {
    for lane in Lane::ALL {
        let (pace, tools, table, finish) = (pace.clone(), tools.clone(), table.clone(), finish.clone());
        tokio::spawn(async move {
            while let Some(task) = table.taken(lane).await {
                let outcome = work(&task, &pace, &tools).await;
                finish.done(&task, outcome);
            }
        });
    }
    mpsc::channel().0
}

async fn work(task: &Task, pace: &Pace, tools: &Tools) -> Result<Product, Failure> {
    task.enter(Phase::Preparing);
    let inputs: Vec<_> = task.assignment.work.inputs().collect();
    let fetch = Fetch::collect(&task.client, task.spec.bundle, &inputs).await;
    task.enter(Phase::Working);
    let step: Duration = pace.of(&task.assignment) / STEPS;
    for _ in 0..STEPS {
        tokio::time::sleep(step).await;
        task.samples.fetch_add(1, Ordering::Relaxed);
        if task.is_cancelled() {
            return Err(Failure::Cancelled);
        }
    }
    execute(task, &Tools { fetch, ..tools.clone() })
}
