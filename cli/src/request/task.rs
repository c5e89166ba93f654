use femc_model::{StageKind, TaskKey};
use std::str::FromStr;

/// Tasks of a job: of a frame, of a round of it, or one.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Tasks {
    frame: Option<u32>,
    round: Option<u32>,
    kind: Option<StageKind>,
    index: Option<u32>,
}

/// A job, and tasks of it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct JobTasks {
    /// The job's number.
    pub job: u64,
    /// All of its tasks, unless some are named.
    pub tasks: Tasks,
}

/// Why a text names no tasks.
#[derive(Debug, PartialEq, Eq, thiserror::Error)]
#[error("`{0}` names no task; write a frame, like 12, or a task, like 12.0/render/3 or 12.0/image")]
pub struct TasksError(String);

impl Tasks {
    /// Whether the task is one of these.
    pub fn hold(&self, task: &TaskKey) -> bool {
        fn is<T: PartialEq + Copy>(wanted: Option<T>, found: T) -> bool {
            wanted.is_none_or(|wanted| wanted == found)
        }
        let stage = task.stage;
        is(self.frame, stage.frame)
            && is(self.round, stage.round)
            && is(self.kind, stage.kind)
            && is(self.index, task.index)
    }
}

impl FromStr for Tasks {
    type Err = TasksError;

    fn from_str(text: &str) -> Result<Self, TasksError> {
        let wrong = || TasksError(text.to_owned());
        let number = |text: &str| text.parse::<u32>().map_err(|_| wrong());
        let mut parts = text.split('/');
        let stage = parts.next().unwrap_or_default();
        let (frame, round) = match stage.split_once('.') {
            Some((frame, round)) => (number(frame)?, Some(number(round)?)),
            None => (number(stage)?, None),
        };
        let kind = parts.next().map(|name| StageKind::named(name).ok_or_else(wrong)).transpose()?;
        let index = parts.next().map(number).transpose()?;
        if parts.next().is_some() {
            return Err(wrong());
        }
        Ok(Self { frame: Some(frame), round, kind, index })
    }
}

impl FromStr for JobTasks {
    type Err = TasksError;

    fn from_str(text: &str) -> Result<Self, TasksError> {
        let (job, tasks) = match text.split_once('/') {
            Some((job, tasks)) => (job, tasks.parse()?),
            None => (text, Tasks::default()),
        };
        Ok(Self { job: job.parse().map_err(|_| TasksError(text.to_owned()))?, tasks })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use femc_model::{JobId, Stage};

    #[test]
    fn a_task_is_named_as_it_is_printed_or_by_a_part_of_that() {
        let stage = Stage { frame: 3, round: 1, number: 0, kind: StageKind::Render };
        let task = TaskKey { job: JobId(7), stage, index: 12 };
        let printed: JobTasks = task.to_string().parse().expect("as printed");
        assert!(printed.job == 7 && printed.tasks.hold(&task));
        assert!(!printed.tasks.hold(&TaskKey { index: 13, ..task }));
        for (text, holds) in [
            ("3", true),
            ("3.1", true),
            ("3.1/render", true),
            ("3/render/12", true),
            ("4", false),
            ("3.0", false),
            ("3.1/image", false),
            ("3.1/render/1", false),
        ] {
            assert_eq!(text.parse::<Tasks>().map(|tasks| tasks.hold(&task)), Ok(holds), "{text}");
        }
        for text in ["", "a", "3.", "3/paint", "3/render/", "3/render/1/2", "-1", "1.2.3"] {
            assert!(text.parse::<Tasks>().is_err(), "{text}");
        }
        assert!("7".parse::<JobTasks>().is_ok_and(|all| all.tasks.hold(&task)) && "x/3".parse::<JobTasks>().is_err());
    }
}
