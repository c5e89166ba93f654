//! Task execution for simulations: the runtime really executes the tasks, and the simulation decides how long they take.

use std::future::pending;
use std::sync::atomic::Ordering;
use std::sync::{Arc, mpsc};

use femc_model::{Failure, Lane, Phase};

use crate::config::{SimulatedOutcome, TaskSimulation};
use crate::execute::{Product, Tools, execute};
use crate::outcome::OutcomeHandler;
use crate::task_table::{Task, TaskTable};
use crate::threads::UpcomingFrame;

/// Number of progress steps per task.
const STEPS: u32 = 8;

/// Starts the executors. They end when the table is closed. They prepare no frames ahead.
pub(crate) fn start(
    simulation: &TaskSimulation,
    tools: &Tools,
    table: &Arc<TaskTable>,
    outcomes: &OutcomeHandler,
) -> mpsc::Sender<UpcomingFrame> {
    for lane in Lane::ALL {
        let (pace, tools, table, finish) = (simulation.clone(), tools.clone(), table.clone(), outcomes.clone());
        tokio::spawn(async move {
            while let Some(task) = table.take_async(lane).await {
                tools.journal.begin(&task);
                let outcome = work(&task, &pace, &tools).await;
                tools.journal.end(&task);
                finish.handle(&task, outcome);
            }
        });
    }
    mpsc::channel().0
}

async fn work(task: &Arc<Task>, simulation: &TaskSimulation, tools: &Tools) -> Result<Product, Failure> {
    task.begin();
    task.set_phase(Phase::Preparing);
    let inputs: Vec<_> = task.assignment.spec.artifacts().chain(task.assignment.spec.hint_artifacts()).collect();
    let fetch = tools.fetch.prefetch(task, &inputs).await;
    task.set_phase(Phase::Working);
    let ((whole, fate), units) = (simulation.simulate(&task.assignment), units(task));
    for step in 1..=STEPS {
        tokio::time::sleep(whole / STEPS).await;
        task.units.store(units * u64::from(step) / u64::from(STEPS), Ordering::Relaxed);
        if task.is_cancelled() {
            return Err(Failure::Cancelled);
        }
    }
    match fate {
        SimulatedOutcome::Done => {}
        SimulatedOutcome::Panic => return Err(Failure::Panicked { message: "simulated panic of the task".into() }),
        SimulatedOutcome::KillProcess(kill) => {
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
    let (stage, work) = (task.assignment.task.stage, &task.assignment.spec);
    let size = task.spec.graph.stage(stage.number).map_or(0, |stage| stage.sizes.units(work.item));
    if stage.kind.is_divided() { size * work.steps.len() as u64 } else { u64::from(STEPS) }
}
