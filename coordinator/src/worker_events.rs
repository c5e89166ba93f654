//! Messages of workers as events of the scheduler.

use femc_model::{Digest, Failure, FromWorker, TaskUsage, WorkerId};
use femc_schedule::Event;

/// Takes the log out of a worker's report.
pub(crate) fn take_log(worker: WorkerId, message: &mut FromWorker) -> Option<Event> {
    match message {
        FromWorker::Completed { task, epoch, log, .. } | FromWorker::Failed { task, epoch, log, .. } => {
            let (task, epoch) = (*task, *epoch);
            log.take().map(|log| Event::Logged { worker, task, epoch, log })
        }
        FromWorker::Register(_) | FromWorker::Heartbeat { .. } | FromWorker::Draining | FromWorker::Available => None,
    }
}

/// Takes the usage of leases out of a worker's message: of a reported lease, or of revoked leases.
pub(crate) fn take_usage(message: &mut FromWorker) -> impl Iterator<Item = TaskUsage> + use<> {
    let (reported, others) = match message {
        FromWorker::Heartbeat { usage, .. } => (None, std::mem::take(usage)),
        FromWorker::Completed { task, epoch, usage, .. } | FromWorker::Failed { task, epoch, usage, .. } => {
            let (task, epoch) = (*task, *epoch);
            (usage.map(|usage| TaskUsage { task, epoch, usage }), Vec::new())
        }
        FromWorker::Register(_) | FromWorker::Draining | FromWorker::Available => (None, Vec::new()),
    };
    reported.into_iter().chain(others)
}

/// Makes the event of a completion whose artifact is missing.
pub(crate) fn artifact_missing(
    worker: WorkerId,
    report: &FromWorker,
    artifact: Digest,
    message: String,
) -> Option<Event> {
    let FromWorker::Completed { task, epoch, .. } = report else { return None };
    let (task, epoch) = (*task, *epoch);
    tracing::warn!(job = task.job.0, %task, worker = worker.0, message, "result rejected: artifact missing or damaged");
    Some(Event::ArtifactMissing { worker, task, epoch, artifact, message })
}

/// Converts a worker's message to an event of the scheduler.
pub(crate) fn to_event(worker: WorkerId, message: FromWorker) -> Option<Event> {
    Some(match message {
        FromWorker::Heartbeat { tasks, .. } => Event::Heartbeat { worker, tasks },
        FromWorker::Completed { task, epoch, result, .. } => Event::Completed { worker, task, epoch, result },
        FromWorker::Failed { task, epoch, failure, .. } => {
            match failure {
                Failure::Cancelled => {
                    tracing::debug!(job = task.job.0, %task, worker = worker.0, "task given back");
                }
                _ => tracing::warn!(job = task.job.0, %task, worker = worker.0, %failure, "task failed"),
            }
            Event::Failed { worker, task, epoch, failure }
        }
        FromWorker::Draining => Event::Draining { worker },
        FromWorker::Available => Event::Available { worker },
        // A session has one registration, which has been processed before.
        FromWorker::Register(_) => return None,
    })
}
