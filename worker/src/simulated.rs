//! Task execution for simulations: the runtime really executes the tasks, and the simulation decides how long they take.

use std::future::pending;
use std::sync::atomic::Ordering;
use std::sync::{Arc, mpsc};

use femc_model::{Failure, Lane, Phase};

use crate::config::{Fate, Pace};
use crate::execute::{Product, Tools, execute};
use crate::finish::Finish;
use crate::table::{Table, Task};
use crate::threads::Ahead;

/// Number of progress steps per task.
const STEPS: u32 = 8;

/// Starts the executors. They end when the table is closed. They prepare no frames ahead.
pub(crate) fn start(pace: &Pace, tools: &Tools, table: &Arc<Table>, finish: &Finish) -> mpsc::Sender<Ahead> {
    for lane in Lane::ALL {
        let (pace, tools, table, finish) = (pace.clone(), tools.clone(), table.clone(), finish.clone());
        tokio::spawn(async move {
            while let Some(task) = table.taken(lane).await {
                tools.journal.begin(&task);
                let outcome = work(&task, &pace, &tools).await;
                tools.journal.end(&task);
                finish.done(&task, outcome);
            }
        });
    }
    mpsc::channel().0
}

async fn work(task: &Arc<Task>, pace: &Pace, tools: &Tools) -> Result<Product, Failure> {
    task.begin();
    task.enter(Phase::Preparing);
    let inputs: Vec<_> = task.assignment.work.artifacts().chain(task.assignment.work.hinted()).collect();
    let fetch = tools.fetch.collect(task, &inputs).await;
    task.enter(Phase::Working);
    let ((whole, fate), units) = (pace.of(&task.assignment), units(task));
    for step in 1..=STEPS {
        tokio::time::sleep(whole / STEPS).await;
        task.units.store(units * u64::from(step) / u64::from(STEPS), Ordering::Relaxed);
        if task.is_cancelled() {
            return Err(Failure::Cancelled);
        }
    }
    match fate {
        Fate::Done => {}
        Fate::Panics => return Err(Failure::Panicked { message: "simulated panic of the task".into() }),
        Fate::Kills(kill) => {
            kill();
            pending::<()>().await;
        }
    }
    // The real execution counts the units again; it takes no simulated time.
    task.units.store(0, Ordering::Relaxed);
    let mut product = execute(task, &Tools { fetch, ..tools.clone() })?;
    product.result.seconds = whole.as_secs_f64();
    Ok(product)
}

/// Returns the task's units of work; for a task that is not cut into units, the number of simulation steps.
fn units(task: &Task) -> u64 {
    let (stage, work) = (task.assignment.task.stage, &task.assignment.work);
    let size = task.spec.graph.stage(stage.number).map_or(0, |stage| stage.sizes.of(work.item));
    if stage.kind.is_cut() { size * work.steps.len() as u64 } else { u64::from(STEPS) }
}
