//! Worker threads: a compute lane, a join lane, and a thread that prepares frames ahead. Each of these three prepares scenes and
//! frames on a pool of its own. Join tasks also compute on that pool: on the render pool, a finished frame's image would wait for
//! the render tasks of other frames. So there are more threads than processors while a join task runs.
//!
//! A lane consists of two threads: the task thread, which executes a task, and one that waits for it. Rendering notices a cancellation
//! within milliseconds, but reading a large scene or building its trees does not. In that case the lane abandons the task thread. The
//! hand's thread runs on detached, its result is discarded, and the lane continues with a new hand. So the worker is free for other
//! tasks at once. An abandoned hand costs memory and processor time until it ends, so their number is limited. At the limit, the
//! lane waits.

use std::sync::{Arc, Mutex, PoisonError, mpsc};
use std::thread::JoinHandle;
use std::time::Duration;

use femc_fault::{Point, pass_point};
use femc_model::{Epoch, Failure, JobSpec, Lane, TaskKey};
use femc_proto::Client;
use rayon::{ThreadPool, ThreadPoolBuilder};

use crate::clock::Stopwatch;
use crate::config::WorkerError;
use crate::execute::{Tools, execute};
use crate::niceness::Niceness;
use crate::outcome::OutcomeHandler;
use crate::task_table::{Outcome, Task, TaskTable};

/// A frame that will be needed soon.
pub(crate) struct UpcomingFrame {
    pub(crate) spec: Arc<JobSpec>,
    pub(crate) frame: u32,
    pub(crate) client: Client,
    /// The task that needs it.
    pub(crate) task: (TaskKey, Epoch),
}

/// Starts the threads. They end when the table is closed and the sender of frames ahead is dropped.
pub(crate) fn start(
    name: &str,
    tools: &Tools,
    table: &Arc<TaskTable>,
    outcomes: &OutcomeHandler,
) -> Result<mpsc::Sender<UpcomingFrame>, WorkerError> {
    for lane in Lane::ALL {
        let (table, finish, name) = (table.clone(), outcomes.clone(), format!("{name} {}", lane.name()));
        let mut runner = LaneRunner::new(name.clone(), lane, tools.clone())?;
        spawn(name, move || {
            while let Some(task) = table.take(lane) {
                if let Some(outcome) = runner.work(&task) {
                    finish.handle(&task, outcome);
                }
            }
        })?;
    }
    let (upcoming_frames, frames) = mpsc::channel::<UpcomingFrame>();
    let (Tools { cache, fetch, memory, nice, .. }, table) =
        (tools.with_own_pool(&format!("{name} ahead"))?, table.clone());
    spawn(format!("{name} prepare"), move || {
        nice.apply();
        for UpcomingFrame { spec, frame, client, task } in frames {
            let Some(task) = table.get(&task).filter(|_| memory.has_room_ahead()) else { continue };
            let fetch = fetch.for_task(&task);
            // Errors are ignored here: the task itself fails in the same way and reports it.
            let prepare = || drop(cache.frame(&spec, frame, task.frame_inputs(), &client, &fetch));
            let _ = std::panic::catch_unwind(std::panic::AssertUnwindSafe(prepare));
        }
    })?;
    Ok(upcoming_frames)
}

/// Executes the tasks of a lane one after the other.
struct LaneRunner {
    name: String,
    lane: Lane,
    tools: Tools,
    thread: TaskThread,
}

/// Abandoned task threads: threads whose tasks were cancelled but still run. Clones share the list.
#[derive(Debug, Clone, Default)]
pub(crate) struct AbandonedThreads(Arc<Mutex<Vec<JoinHandle<()>>>>);

impl AbandonedThreads {
    /// Returns the number of abandoned threads that still run.
    pub(crate) fn count(&self) -> usize {
        let mut threads = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        threads.retain(|thread| !thread.is_finished());
        threads.len()
    }

    fn push(&self, thread: JoinHandle<()>) {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).push(thread);
    }
}

/// A thread that executes tasks.
struct TaskThread {
    tasks: mpsc::Sender<Arc<Task>>,
    outcomes: mpsc::Receiver<Outcome>,
    handle: JoinHandle<()>,
}

impl LaneRunner {
    /// Interval between checks whether a task is cancelled.
    const POLL_INTERVAL: Duration = Duration::from_millis(50);
    /// Time that a cancelled task may continue before its hand is abandoned.
    const GRACE: Duration = Duration::from_millis(250);
    /// Largest number of abandoned threads that run at the same time.
    const MAX_ABANDONED: usize = 3;

    fn new(name: String, lane: Lane, tools: Tools) -> Result<Self, WorkerError> {
        Ok(Self { thread: TaskThread::new(&name, lane, &tools)?, name, lane, tools })
    }

    /// Executes the task; `None` if it was cancelled and does not end.
    fn work(&mut self, task: &Arc<Task>) -> Option<Outcome> {
        let died = || Some(Err(Failure::Panicked { message: "the thread of the task died".into() }));
        if self.thread.tasks.send(task.clone()).is_err() {
            self.replace_thread();
            return died();
        }
        let mut cancelled: Option<Stopwatch> = None;
        loop {
            match self.thread.outcomes.recv_timeout(Self::POLL_INTERVAL) {
                Ok(outcome) => return Some(outcome),
                Err(mpsc::RecvTimeoutError::Disconnected) => {
                    self.tools.journal.end(task);
                    self.replace_thread();
                    return died();
                }
                Err(mpsc::RecvTimeoutError::Timeout) if task.is_cancelled() => {
                    let since = cancelled.get_or_insert_with(Stopwatch::start);
                    if since.elapsed() >= Self::GRACE
                        && self.tools.abandoned_threads.count() < Self::MAX_ABANDONED
                        && self.replace_thread()
                    {
                        tracing::info!(
                            task = %task.key().0,
                            "cancelled, but not interruptible: the thread continues detached and its result is discarded"
                        );
                        return None;
                    }
                }
                Err(mpsc::RecvTimeoutError::Timeout) => pass_point(Point::WorkerInTask),
            }
        }
    }

    /// Starts a new hand; returns whether that succeeded. If not, the lane keeps the old one.
    fn replace_thread(&mut self) -> bool {
        match TaskThread::new(&self.name, self.lane, &self.tools) {
            Ok(hand) => {
                self.tools.abandoned_threads.push(std::mem::replace(&mut self.thread, hand).handle);
                true
            }
            Err(error) => {
                tracing::warn!(%error, "cannot start a thread");
                false
            }
        }
    }
}

impl TaskThread {
    /// Starts a thread. After the task thread is dropped, the thread ends with its current task.
    fn new(name: &str, lane: Lane, tools: &Tools) -> Result<Self, WorkerError> {
        let (tasks, line) = mpsc::channel::<Arc<Task>>();
        let (done, outcomes) = mpsc::channel();
        let tools = tools.with_own_pool(name)?.for_lane(lane);
        let thread = spawn(format!("{name} hand"), move || {
            tools.nice.apply();
            for task in line {
                tools.journal.begin(&task);
                let outcome = execute(&task, &tools);
                tools.journal.end(&task);
                if done.send(outcome).is_err() {
                    break;
                }
            }
        })?;
        Ok(Self { tasks, outcomes, handle: thread })
    }
}

impl Tools {
    /// Returns a copy of the tools with a separate pool to prepare scenes and frames.
    fn with_own_pool(&self, name: &str) -> Result<Self, WorkerError> {
        let pool = pool(format!("{name} prepare"), self.pool.current_num_threads(), self.nice)?;
        Ok(Self { fetch: self.fetch.with_pool(pool), ..self.clone() })
    }

    /// Returns the tools with the pool on which tasks of `lane` compute.
    fn for_lane(self, lane: Lane) -> Self {
        match lane {
            Lane::Compute => self,
            Lane::Join => Self { pool: self.fetch.pool().clone(), ..self },
        }
    }
}

/// Creates a pool of compute threads.
/// - `threads`: number of threads; 0: as many as the machine runs at once.
pub(crate) fn pool(name: String, threads: usize, nice: Niceness) -> Result<Arc<ThreadPool>, WorkerError> {
    let pool = ThreadPoolBuilder::new()
        .num_threads(threads)
        .thread_name(move |index| format!("{name} {index}"))
        .start_handler(move |_| nice.apply());
    pool.build().map(Arc::new).map_err(|error| WorkerError::Threads(error.to_string()))
}

fn spawn(name: String, work: impl FnOnce() + Send + 'static) -> Result<JoinHandle<()>, WorkerError> {
    std::thread::Builder::new().name(name).spawn(work).map_err(|error| WorkerError::Threads(error.to_string()))
}
