//! Numbering of the tasks of a stage. The steps of each task are divided into equal chunks. One lease covers one or
//! more chunks of a task, depending on the time that they take.

use std::num::NonZeroU64;
use std::ops::Range;

use serde::{Deserialize, Serialize};

use crate::{StageTemplate, TaskSizes};

/// Size of the chunks into which a job's tasks are divided. It is fixed for the life of the job.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum ChunkSize {
    /// No division: a lease covers all steps of a task.
    #[default]
    Whole,
    /// Chunks of about this many units of work, up to twice as many. Chunks are smaller if the task has fewer units, and larger if
    /// the task would otherwise have more than [`Chunks::MAX_PER_TASK`] chunks.
    Units(NonZeroU64),
}

/// Steps of a round whose tasks differ in their number of steps: the steps each task has taken at the start and at the end of the
/// round.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct UnevenSteps {
    /// Steps of each task at the start of the round, not greater than at its end.
    pub from: Vec<u32>,
    /// Steps of each task at the end of the round.
    pub to: Vec<u32>,
}

impl UnevenSteps {
    fn steps(&self, task: u32) -> Range<u32> {
        let at = |steps: &[u32]| steps.get(task as usize).copied().unwrap_or(0);
        at(&self.from)..at(&self.to)
    }
}

/// Total number of steps of each task, in task order. A single number if all tasks have taken equally many.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct StepsTaken(Vec<u32>);

impl StepsTaken {
    /// Returns the steps of the task at this position; `None` if they are not known.
    pub fn get(&self, index: usize) -> Option<u32> {
        if let [all] = self.0[..] { Some(all) } else { self.0.get(index).copied() }
    }

    /// Returns the shortest list that represents the steps: one number if all are equal.
    pub fn numbers(&self) -> &[u32] {
        &self.0
    }
}

impl FromIterator<u32> for StepsTaken {
    fn from_iter<I: IntoIterator<Item = u32>>(steps: I) -> Self {
        let mut steps: Vec<u32> = steps.into_iter().collect();
        if steps.windows(2).all(|pair| pair[0] == pair[1]) {
            steps.truncate(1);
        }
        Self(steps)
    }
}

/// Steps of the tasks of a round.
#[derive(Debug, Clone, PartialEq, Eq)]
enum Steps<'a> {
    /// All tasks take these steps.
    Even(Range<u32>),
    Uneven(&'a UnevenSteps),
}

/// Keys of one stage in one round. Chunk `g` of task `t` has the key `t * stride + g`. A lease covers a run of chunks of one task,
/// and its key is that of the first chunk. A task without steps has no chunks.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Chunks<'a> {
    sizes: &'a TaskSizes,
    steps: Steps<'a>,
    stride: u32,
}

impl<'a> Chunks<'a> {
    /// Maximum number of chunks of a task.
    pub const MAX_PER_TASK: u32 = 64;

    /// Numbers the tasks of a round of a stage. The plan alone decides which task a key belongs to: a task that takes more steps
    /// than planned has larger chunks, not more chunks.
    /// - `uneven`: steps of the tasks, where tasks differ.
    pub fn new(
        template: &'a StageTemplate,
        round: u32,
        uneven: Option<&'a UnevenSteps>,
        chunk_size: ChunkSize,
    ) -> Self {
        let steps = uneven.map_or_else(|| Steps::Even(template.steps_of(round)), Steps::Uneven);
        let most = template.steps_of(round).len() as u32;
        let mut stride = 1;
        if let ChunkSize::Units(size) = chunk_size
            && template.kind.is_divided()
        {
            let units = template.sizes.max() * u64::from(most);
            stride = (units / size).clamp(1, u64::from(most.clamp(1, Self::MAX_PER_TASK))) as u32;
        }
        Self { sizes: &template.sizes, steps, stride }
    }

    /// Number of tasks of the stage.
    pub fn tasks(&self) -> u32 {
        self.sizes.tasks()
    }

    /// Maximum number of chunks of a task in this stage.
    pub fn stride(&self) -> u32 {
        self.stride
    }

    /// Returns whether every task has the same number of chunks.
    pub fn is_even(&self) -> bool {
        matches!(self.steps, Steps::Even(_))
    }

    /// Returns the range from the first key to past the last. In an uneven stage, some numbers in it are not keys.
    pub fn all_keys(&self) -> Range<u32> {
        0..self.tasks() * self.stride
    }

    /// Returns the task that a key belongs to.
    pub fn task(&self, key: u32) -> u32 {
        key / self.stride
    }

    /// Returns the keys of a task.
    pub fn of_task(&self, task: u32) -> Range<u32> {
        let first = task * self.stride;
        let count = match &self.steps {
            Steps::Even(_) => self.stride,
            Steps::Uneven(uneven) => self.stride.min(uneven.steps(task).len() as u32),
        };
        first..first + count
    }

    /// Returns the range from the first key of the first task to past the last key of the last task.
    pub fn of_tasks(&self, tasks: &Range<u32>) -> Range<u32> {
        tasks.start * self.stride..tasks.end * self.stride
    }

    /// Returns all steps that a task takes in the round.
    pub fn steps_of(&self, task: u32) -> Range<u32> {
        match &self.steps {
            Steps::Even(steps) => steps.clone(),
            Steps::Uneven(uneven) => uneven.steps(task),
        }
    }

    /// Returns the steps of a run of chunks of one task.
    pub fn steps(&self, run: &Range<u32>) -> Range<u32> {
        let task = self.task(run.start);
        let keys = self.of_task(task);
        let (first, count, steps) = (keys.start, keys.len() as u64, self.steps_of(task));
        let bound = |chunk: u32| steps.start + (steps.len() as u64 * u64::from(chunk) / count.max(1)) as u32;
        bound(run.start - first)..bound(run.end - first)
    }

    /// Returns the units of work of a run of chunks of one task.
    pub fn units(&self, run: &Range<u32>) -> u64 {
        self.sizes.units(self.task(run.start)) * self.steps(run).len() as u64
    }

    /// Returns the run that begins at key `first` and holds exactly these steps; `None` if no run does.
    pub fn find_run(&self, first: u32, steps: &Range<u32>) -> Option<Range<u32>> {
        if first >= self.all_keys().end {
            return None;
        }
        let keys = first..self.of_task(self.task(first)).end;
        keys.map(|last| first..last + 1).find(|run| self.steps(run) == *steps)
    }
}

#[cfg(test)]
mod tests {
    use crate::{Role, Scope, StageKind};

    use super::*;

    /// Makes a stage with two tasks of 64 units per step and one of 32.
    fn template(steps: &[u32]) -> StageTemplate {
        let sizes = [(2, 64), (1, 32)].into_iter().collect();
        StageTemplate::new(StageKind::Render, Scope::Frame, sizes, &[Role::Tile]).with_steps(steps)
    }

    fn chunk_size(size: u64) -> ChunkSize {
        NonZeroU64::new(size).map_or(ChunkSize::Whole, ChunkSize::Units)
    }

    fn assert_each_step_once(chunks: &Chunks<'_>) {
        assert!((1..=Chunks::MAX_PER_TASK).contains(&chunks.stride()));
        for task in 0..chunks.tasks() {
            let mut next = chunks.steps_of(task);
            for key in chunks.of_task(task) {
                let steps = chunks.steps(&(key..key + 1));
                assert!(steps.start == next.start && !steps.is_empty(), "{steps:?} after {next:?}");
                assert_eq!(chunks.task(key), task);
                next.start = steps.end;
            }
            assert!(next.is_empty(), "{next:?} is in no grain");
        }
    }

    #[test]
    fn chunks_of_a_task_hold_each_round_step_once_and_none_is_empty() {
        for (steps, size) in [(&[7, 100, 101][..], 64), (&[7, 100, 101], 200), (&[1000, 65_000], 1), (&[3], 1 << 40)] {
            let template = template(steps);
            for round in 0..steps.len() as u32 {
                assert_each_step_once(&Chunks::new(&template, round, None, chunk_size(size)));
            }
        }
    }

    #[test]
    fn uneven_tasks_have_their_own_steps_and_empty_ones_no_keys() {
        let (template, uneven) = (template(&[4, 100]), UnevenSteps { from: vec![4, 4, 4], to: vec![100, 4, 7] });
        for size in [0, 64, 1 << 40] {
            let chunks = Chunks::new(&template, 1, Some(&uneven), chunk_size(size));
            assert_each_step_once(&chunks);
            assert!(chunks.of_task(1).is_empty() && chunks.of_task(2).len() == 3.min(chunks.stride() as usize));
            assert_eq!(chunks.units(&chunks.of_task(2)), 3 * 32);
            let planned = Chunks::new(&template, 1, None, chunk_size(size));
            assert!(
                (0..3).all(|task| chunks.of_task(task).all(|key| planned.task(key) == task)),
                "regardless of the view"
            );
        }
    }

    #[test]
    fn steps_that_all_tasks_have_taken_are_one_number() {
        let taken = |steps: &[u32]| steps.iter().copied().collect::<StepsTaken>();
        let (even, uneven) = (taken(&[16, 16, 16]), taken(&[16, 32, 16]));
        assert_eq!((even.numbers(), uneven.numbers()), (&[16][..], &[16, 32, 16][..]));
        assert_eq!((0..3).map(|place| even.get(place)).collect::<Vec<_>>(), [Some(16); 3]);
        assert_eq!((uneven.get(1), uneven.get(3), taken(&[]).get(0)), (Some(32), None, None));
    }

    #[test]
    fn a_run_is_found_by_its_steps_and_nothing_else_is_one() {
        let template = template(&[10, 50]);
        let chunks = Chunks::new(&template, 1, None, chunk_size(320));
        assert_eq!((chunks.stride(), chunks.all_keys()), (8, 0..24));
        for task in 0..3 {
            let size = if task == 2 { 32 } else { 64 };
            for first in chunks.of_task(task) {
                for end in first + 1..=chunks.of_task(task).end {
                    let (run, steps) = (first..end, chunks.steps(&(first..end)));
                    assert_eq!(chunks.find_run(first, &steps), Some(run.clone()));
                    assert_eq!(chunks.units(&run), size * u64::from(5 * (end - first)));
                    assert_eq!(chunks.find_run(first, &(steps.start..steps.end + 1)), None);
                    assert_eq!(chunks.find_run(first, &(steps.start + 1..steps.end)), None);
                }
            }
        }
        assert_eq!(chunks.find_run(24, &(10..15)), None, "beyond the last task");
    }

    #[test]
    fn tasks_that_are_not_cut_are_whole() {
        let rendered = template(&[4]);
        let whole = Chunks::new(&rendered, 0, None, ChunkSize::Whole);
        assert_eq!((whole.all_keys(), whole.steps(&(1..2)), whole.units(&(2..3))), (0..3, 0..4, 4 * 32));
        let image = StageTemplate::new(StageKind::Image, Scope::Frame, TaskSizes::even(1, 1), &[Role::Image]);
        let chunks = Chunks::new(&image, 3, None, chunk_size(1));
        assert_eq!((chunks.all_keys(), chunks.steps(&(0..1)), chunks.units(&(0..1))), (0..1, 0..1, 1));
    }
}
