use femc_model::{JobId, StageKind, TaskKey};
use std::str::FromStr;

/// Selection of tasks of a job: a frame, a round, all stages of a kind, one stage, or one task.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct TaskSelector {
    frame: Option<u32>,
    round: Option<u32>,
    kind: Option<StageKind>,
    /// Number of the stage in the job's graph.
    stage: Option<u16>,
    index: Option<u32>,
}

/// A job, and a selection of its tasks.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct JobTaskSelector {
    /// The job, or the shared job.
    pub job: JobId,
    /// Selected tasks; all of the job if none are named.
    pub tasks: TaskSelector,
}

/// Error of a text that does not name tasks.
#[derive(Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "`{0}` is not a task; write a frame, like 12, or a task, like 12.0/render.0/3, or all tasks of a kind, like 12.0/image"
)]
pub struct TaskSelectorError(String);

impl TaskSelector {
    /// Returns whether the task is selected.
    pub fn matches(&self, task: &TaskKey) -> bool {
        fn is_match<T: PartialEq + Copy>(wanted: Option<T>, found: T) -> bool {
            wanted.is_none_or(|wanted| wanted == found)
        }
        let stage = task.stage;
        is_match(self.frame, stage.frame)
            && is_match(self.round, stage.round)
            && is_match(self.kind, stage.kind)
            && is_match(self.stage, stage.number)
            && is_match(self.index, task.index)
    }
}

impl FromStr for TaskSelector {
    type Err = TaskSelectorError;

    fn from_str(text: &str) -> Result<Self, TaskSelectorError> {
        let wrong = || TaskSelectorError(text.to_owned());
        let number = |text: &str| text.parse::<u32>().map_err(|_| wrong());
        let mut parts = text.split('/');
        let frame_round = parts.next().unwrap_or_default();
        let (frame, round) = match frame_round.split_once('.') {
            Some((frame, round)) => (number(frame)?, Some(number(round)?)),
            None => (number(frame_round)?, None),
        };
        let (kind, stage) = match parts.next().map(|stage| stage.split_once('.').ok_or(stage)) {
            Some(Ok((kind, stage))) => (Some(kind), Some(stage.parse().map_err(|_| wrong())?)),
            Some(Err(kind)) => (Some(kind), None),
            None => (None, None),
        };
        let kind = kind.map(|name| StageKind::from_name(name).ok_or_else(wrong)).transpose()?;
        let index = parts.next().map(number).transpose()?;
        if parts.next().is_some() {
            return Err(wrong());
        }
        Ok(Self { frame: Some(frame), round, kind, stage, index })
    }
}

impl FromStr for JobTaskSelector {
    type Err = TaskSelectorError;

    fn from_str(text: &str) -> Result<Self, TaskSelectorError> {
        let (job, tasks) = match text.split_once('/') {
            Some((job, tasks)) => (job, tasks.parse()?),
            None => (text, TaskSelector::default()),
        };
        Ok(Self { job: job.parse().map_err(|_| TaskSelectorError(text.to_owned()))?, tasks })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use femc_model::Stage;

    #[test]
    fn a_name_as_it_is_printed_holds_its_task_and_no_other() {
        let of = |frame, number, kind, index| (Stage { frame, round: 0, number, kind }, index);
        let mut tasks =
            vec![of(3, 0, StageKind::Render, 1), of(3, 1, StageKind::Image, 0), of(3, 1, StageKind::Image, 1)];
        // Reduce stages: groups and levels of a frame; stills, sheet and clip of a job.
        tasks.extend([2, 3].map(|number| of(3, number, StageKind::Reduce, 0)));
        tasks.extend([4, 5, 6].map(|number| of(Stage::JOB_FRAME, number, StageKind::EncodePicture, 0)));
        let jobs = [JobId(7), JobId::shared(7)];
        let tasks = jobs.iter().flat_map(|&job| tasks.iter().map(move |&(stage, index)| TaskKey { job, stage, index }));
        let tasks: Vec<TaskKey> = tasks.collect();
        for task in &tasks {
            let printed: JobTaskSelector = task.to_string().parse().expect("as printed");
            let held: Vec<&TaskKey> =
                tasks.iter().filter(|other| printed.job == other.job && printed.tasks.matches(other)).collect();
            assert_eq!(held, [task]);
        }
    }

    #[test]
    fn tasks_are_named_by_a_part_of_what_is_printed() {
        let stage = Stage { frame: 3, round: 1, number: 0, kind: StageKind::Render };
        let task = TaskKey { job: JobId(7), stage, index: 12 };
        for (text, holds) in [
            ("3", true),
            ("3.1", true),
            ("3.1/render", true),
            ("3/render.0", true),
            ("3/render/12", true),
            ("4", false),
            ("3.0", false),
            ("3.1/image", false),
            ("3.1/image.0", false),
            ("3.1/render.1", false),
            ("3.1/render/1", false),
        ] {
            assert_eq!(text.parse::<TaskSelector>().map(|tasks| tasks.matches(&task)), Ok(holds), "{text}");
        }
        for text in ["", "a", "3.", "3/knit", "3/render/", "3/render/1/2", "3/render./1", "3/render.x", "-1", "1.2.3"] {
            assert!(text.parse::<TaskSelector>().is_err(), "{text}");
        }
        assert!(
            "7".parse::<JobTaskSelector>().is_ok_and(|all| all.tasks.matches(&task))
                && "x/3".parse::<JobTaskSelector>().is_err()
        );
    }
}
