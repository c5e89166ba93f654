//! Logs of tasks.

use femc_model::{AttemptOutcome, LogRecord, LogText, TaskLog, Tick};

use super::task::{finite_seconds, from_lease, to_lease};
use super::{ConvertError, required};
use crate::wire;

impl From<TaskLog> for wire::TaskLog {
    fn from(log: TaskLog) -> Self {
        use wire::task_log::Text;
        let TaskLog { outcome: attempt, seconds, text } = log;
        let text = match text {
            LogText::Inline(text) => Text::Inline(text),
            LogText::Stored(artifact) => Text::Stored(artifact.into()),
        };
        Self { done: attempt == AttemptOutcome::Done, seconds, text: Some(text) }
    }
}

impl TryFrom<wire::TaskLog> for TaskLog {
    type Error = ConvertError;

    fn try_from(wire: wire::TaskLog) -> Result<Self, ConvertError> {
        use wire::task_log::Text;
        let wire::TaskLog { done, seconds, text } = wire;
        let text = match required("log.text", text)? {
            Text::Inline(text) if text.len() > LogText::MAX_INLINE => {
                return Err(ConvertError::Range { field: "log.inline" });
            }
            Text::Inline(text) => LogText::Inline(text),
            Text::Stored(artifact) if artifact.bytes > LogText::MAX_STORED as u64 => {
                return Err(ConvertError::Range { field: "log.stored" });
            }
            Text::Stored(artifact) => LogText::Stored(artifact.try_into()?),
        };
        let attempt = if done { AttemptOutcome::Done } else { AttemptOutcome::Failed };
        Ok(Self { outcome: attempt, seconds: finite_seconds(seconds)?, text })
    }
}

impl From<LogRecord> for wire::LogRecord {
    fn from(record: LogRecord) -> Self {
        let LogRecord { task, epoch, worker, reported_at: Tick(at), log } = record;
        Self { lease: to_lease(task, epoch), worker, at, log: Some(log.into()) }
    }
}

impl TryFrom<wire::LogRecord> for LogRecord {
    type Error = ConvertError;

    fn try_from(wire: wire::LogRecord) -> Result<Self, ConvertError> {
        let wire::LogRecord { lease, worker, at, log } = wire;
        let (task, epoch) = from_lease(lease)?;
        Ok(Self { task, epoch, worker, reported_at: Tick(at), log: required("record.log", log)?.try_into()? })
    }
}
