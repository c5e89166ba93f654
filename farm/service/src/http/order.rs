//! Sort order of a job's tasks, by any column of their table.

use std::cmp::Ordering;
use std::fmt::Write as _;
use std::str::FromStr;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use femc_model::{AttemptTimes, JobId, TaskFilter, TaskStatus};
use tokio::time::Instant;

/// Column by which tasks are sorted. Its name is the name of the JSON field.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Column {
    Task,
    Frame,
    Stage,
    Index,
    State,
    Workers,
    Attempts,
    Seconds,
    Processor,
    Wall,
    Waiting,
    Failure,
}

impl Column {
    const ALL: [(Self, &str); 12] = [
        (Self::Task, "task"),
        (Self::Frame, "frame"),
        (Self::Stage, "stage"),
        (Self::Index, "index"),
        (Self::State, "state"),
        (Self::Workers, "workers"),
        (Self::Attempts, "attempts"),
        (Self::Seconds, "seconds"),
        (Self::Processor, "processor_seconds"),
        (Self::Wall, "wall_seconds"),
        (Self::Waiting, "waiting_seconds"),
        (Self::Failure, "failure"),
    ];

    /// Compares two tasks by this column. Returns the order, and whether each task has a value in the column.
    fn compare(self, a: &TaskStatus, b: &TaskStatus) -> (Ordering, [bool; 2]) {
        let numbers = |value: fn(&TaskStatus) -> Option<f64>| {
            let [x, y] = [value(a), value(b)];
            (x.unwrap_or_default().total_cmp(&y.unwrap_or_default()), [x.is_some(), y.is_some()])
        };
        let times = |value: fn(AttemptTimes) -> f64| {
            let [x, y] = [a.times.map(value), b.times.map(value)];
            (x.unwrap_or_default().total_cmp(&y.unwrap_or_default()), [x.is_some(), y.is_some()])
        };
        let stage = |task: &TaskStatus| (task.task.stage.number, task.task.stage.round);
        match self {
            Self::Task => (a.task.cmp(&b.task), [true; 2]),
            Self::Frame => (a.task.stage.frame.cmp(&b.task.stage.frame), [true; 2]),
            Self::Stage => (stage(a).cmp(&stage(b)), [true; 2]),
            Self::Index => (a.task.index.cmp(&b.task.index), [true; 2]),
            Self::State => (a.state.cmp(&b.state), [true; 2]),
            Self::Workers => (a.workers.cmp(&b.workers), [!a.workers.is_empty(), !b.workers.is_empty()]),
            Self::Attempts => (a.attempts.cmp(&b.attempts), [true; 2]),
            Self::Seconds => numbers(|task| task.seconds),
            Self::Processor => times(|times| times.processor),
            Self::Wall => times(|times| times.wall),
            Self::Waiting => times(|times| times.waiting),
            Self::Failure => {
                let [x, y] = [a, b].map(|task| task.failure.as_ref().map(ToString::to_string));
                (x.cmp(&y), [x.is_some(), y.is_some()])
            }
        }
    }
}

/// A sort order of tasks: `processor_seconds`, or `-processor_seconds` for descending.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct TaskOrder {
    column: Column,
    is_descending: bool,
}

/// Error for a name that is not a column of tasks.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("expected {}; a leading `-` sorts in descending order", names())]
pub(super) struct UnknownColumn;

fn names() -> String {
    let mut text = String::new();
    for (place, (_, name)) in Column::ALL.iter().enumerate() {
        let before = ["", ", ", " or "][usize::from(place > 0) + usize::from(place == Column::ALL.len() - 1)];
        // Writing to a string cannot fail.
        let _ = write!(text, "{before}{name}");
    }
    text
}

impl FromStr for TaskOrder {
    type Err = UnknownColumn;

    fn from_str(text: &str) -> Result<Self, UnknownColumn> {
        let (is_descending, name) = text.strip_prefix('-').map_or((false, text), |name| (true, name));
        let known = Column::ALL.into_iter().find(|(_, known)| *known == name);
        known.map(|(column, _)| Self { column, is_descending }).ok_or(UnknownColumn)
    }
}

impl TaskOrder {
    /// Sorts tasks. Tasks without a value in the column come last in both directions. Equal tasks stay ordered by frame, stage,
    /// round and number.
    pub(super) fn sort(self, tasks: &mut [TaskStatus]) {
        tasks.sort_by(|a, b| {
            let (order, [has_a, has_b]) = self.column.compare(a, b);
            let order = if self.is_descending { order.reverse() } else { order };
            has_b.cmp(&has_a).then(if has_a && has_b { order } else { Ordering::Equal })
        });
    }
}

/// The last sorted tasks, kept for the next pages of the same table.
#[derive(Debug, Default)]
pub(super) struct SortedTasksCache(Mutex<Option<SortedTasks>>);

#[derive(Debug, Clone)]
struct SortedTasks {
    key: (JobId, TaskFilter, TaskOrder),
    at: Instant,
    tasks: Arc<Vec<TaskStatus>>,
}

impl SortedTasksCache {
    /// Time for which a sorted list is reused.
    const MAX_AGE: Duration = Duration::from_secs(1);

    /// Returns the tasks, if the same list was sorted a moment ago.
    pub(super) fn get(&self, job: JobId, filter: TaskFilter, order: TaskOrder) -> Option<Arc<Vec<TaskStatus>>> {
        let mut last = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        *last = last.take().filter(|last| last.at.elapsed() < Self::MAX_AGE);
        last.as_ref().filter(|last| last.key == (job, filter, order)).map(|last| last.tasks.clone())
    }

    /// Stores a newly sorted list.
    pub(super) fn put(&self, job: JobId, filter: TaskFilter, order: TaskOrder, tasks: Arc<Vec<TaskStatus>>) {
        let sorted = SortedTasks { key: (job, filter, order), at: Instant::now(), tasks };
        *self.0.lock().unwrap_or_else(PoisonError::into_inner) = Some(sorted);
    }
}

#[cfg(test)]
mod tests {
    use femc_model::{Stage, StageKind, TaskKey, TaskState};

    use super::*;

    fn task(index: u32, processor: Option<f64>, worker: &str) -> TaskStatus {
        let stage = Stage { frame: 1, round: 0, number: 0, kind: StageKind::Render };
        TaskStatus {
            task: TaskKey { job: JobId(1), stage, index },
            state: TaskState::Done,
            covers_all_rounds: true,
            workers: Some(worker.to_owned()).filter(|name| !name.is_empty()).into_iter().collect(),
            attempts: index % 2,
            seconds: None,
            failure: None,
            times: processor.map(|processor| AttemptTimes { processor, ..AttemptTimes::default() }),
        }
    }

    fn sorted(order: &str) -> Vec<u32> {
        let mut tasks = [task(0, Some(2.0), "b"), task(1, None, ""), task(2, Some(9.0), "a"), task(3, Some(0.5), "b")];
        order.parse::<TaskOrder>().expect("a column").sort(&mut tasks);
        tasks.iter().map(|task| task.task.index).collect()
    }

    #[test]
    fn tasks_without_value_sort_last_and_equal_tasks_keep_order() {
        assert_eq!(sorted("processor_seconds"), [3, 0, 2, 1]);
        assert_eq!(sorted("-processor_seconds"), [2, 0, 3, 1]);
        assert_eq!(sorted("workers"), [2, 0, 3, 1]);
        assert_eq!(sorted("-workers"), [0, 3, 2, 1]);
        assert_eq!(sorted("-attempts"), [1, 3, 0, 2]);
        assert_eq!(sorted("-task"), [3, 2, 1, 0]);
        assert_eq!(sorted("seconds"), [0, 1, 2, 3], "none has one");
    }

    #[test]
    fn every_column_is_named_in_the_error_of_a_bad_one() {
        for name in ["", "-", "cpu", "--task", "Task"] {
            let error = name.parse::<TaskOrder>().expect_err("no column").to_string();
            assert!(Column::ALL.iter().all(|(_, name)| error.contains(name)), "{error}");
        }
        assert_eq!(
            names(),
            "task, frame, stage, index, state, workers, attempts, seconds, processor_seconds, wall_seconds, waiting_seconds or failure"
        );
    }
}
