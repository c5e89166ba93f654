//! Logs of tasks: each log collects the events of the thread that executes the task.
//!
//! [`TaskLogs`] is a layer of the program's tracing subscriber. A thread marks its work for a task with [`TaskLog::record_during`],
//! and the layer writes that thread's events to the task's log. Events of other threads go to no task log. Without the layer, a log
//! consists of its header alone.

use std::cell::RefCell;
use std::collections::VecDeque;
use std::fmt::{self, Write as _};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use tracing::field::{Field, Visit};
use tracing::{Event, Level, Subscriber};
use tracing_subscriber::layer::{Context, Layer};

use crate::clock::Stopwatch;

thread_local! {
    static CURRENT: RefCell<Option<TaskLog>> = const { RefCell::new(None) };
}

/// Subscriber layer that writes events to the logs of tasks.
#[derive(Debug, Clone, Copy, Default)]
pub struct TaskLogs;

impl<S: Subscriber> Layer<S> for TaskLogs {
    fn on_event(&self, event: &Event<'_>, _: Context<'_, S>) {
        CURRENT.with_borrow(|current| {
            if let Some(log) = current {
                log.append_event(event);
            }
        });
    }
}

/// A task's log; clones share it.
#[derive(Debug, Clone, Default)]
pub(crate) struct TaskLog(Arc<Mutex<Lines>>);

/// The first and the last lines of a log. The cause of a failure is usually near one of the two.
#[derive(Debug, Default)]
struct Lines {
    began: Option<Stopwatch>,
    first: Vec<String>,
    first_bytes: usize,
    last: VecDeque<String>,
    last_bytes: usize,
    left_out: u64,
}

impl TaskLog {
    /// Size limit of the first lines and of the last lines, bytes each.
    const HALF: usize = 30 << 10;
    /// Size limit of a line, bytes.
    const LINE: usize = 4 << 10;

    /// Starts the clock of the task.
    pub(crate) fn begin(&self) {
        self.lock().began = Some(Stopwatch::start());
    }

    /// Returns the seconds since the task began; `None` if it has not begun.
    pub(crate) fn seconds(&self) -> Option<f64> {
        self.lock().began.map(Stopwatch::seconds)
    }

    /// Runs `work` and collects this thread's events in the task's log meanwhile.
    pub(crate) fn record_during<T>(&self, work: impl FnOnce() -> T) -> T {
        /// Restores the previous log on drop, even if the work panics.
        struct RestorePrevious(Option<TaskLog>);
        impl Drop for RestorePrevious {
            fn drop(&mut self) {
                CURRENT.set(self.0.take());
            }
        }
        let _back = RestorePrevious(CURRENT.replace(Some(self.clone())));
        work()
    }

    fn append_event(&self, event: &Event<'_>) {
        let mut lines = self.lock();
        let level = event.metadata().level();
        let mut line = format!("{:>10.3} s {level:>5} ", lines.began.map_or(0.0, Stopwatch::seconds));
        event.record(&mut EventWriter(&mut line));
        lines.put(truncate(&line.replace('\n', "\n             "), Self::LINE).to_owned());
    }

    /// Returns the header and the lines in at most `limit` bytes. Lines that do not fit are left out in the middle.
    pub(crate) fn render(&self, header: &str, limit: usize) -> String {
        let lines = self.lock();
        let all: Vec<&String> = lines.first.iter().chain(&lines.last).collect();
        let room = limit.saturating_sub(header.len() + 64);
        let whole = |lines: &[&String]| lines.iter().map(|line| line.len() + 1).sum::<usize>();
        let (mut head, mut tail) = (lines.first.len(), lines.first.len());
        if whole(&all) > room {
            head = fitting(all.iter().take(head).copied(), room / 2);
            tail = all.len() - fitting(all[head..].iter().rev().copied(), room - whole(&all[..head]));
        }
        let left_out = lines.left_out + (tail - head) as u64;
        let mut text = truncate(header, limit.saturating_sub(64)).to_owned();
        all[..head].iter().for_each(|line| text.extend([line.as_str(), "\n"]));
        if left_out > 0 {
            let _ = writeln!(text, "             ... {left_out} lines left out");
        }
        all[tail..].iter().for_each(|line| text.extend([line.as_str(), "\n"]));
        text
    }

    fn lock(&self) -> MutexGuard<'_, Lines> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Lines {
    fn put(&mut self, line: String) {
        if self.last.is_empty() && self.left_out == 0 && self.first_bytes + line.len() < TaskLog::HALF {
            self.first_bytes += line.len() + 1;
            self.first.push(line);
            return;
        }
        self.last_bytes += line.len() + 1;
        self.last.push_back(line);
        while self.last_bytes > TaskLog::HALF {
            let Some(oldest) = self.last.pop_front() else { break };
            self.last_bytes -= oldest.len() + 1;
            self.left_out += 1;
        }
    }
}

/// Returns how many of the lines fit into `room` bytes.
fn fitting<'a>(lines: impl Iterator<Item = &'a String>, mut room: usize) -> usize {
    let fits = |line: &&String| {
        let needed = line.len() + 1;
        let fits = needed <= room;
        room = room.saturating_sub(needed);
        fits
    };
    lines.take_while(fits).count()
}

/// Returns a prefix of whole characters with at most `max_bytes` bytes.
pub(crate) fn truncate(text: &str, max_bytes: usize) -> &str {
    &text[..text.floor_char_boundary(max_bytes)]
}

/// Visitor that writes an event's message, then its fields.
struct EventWriter<'a>(&'a mut String);

impl Visit for EventWriter<'_> {
    fn record_debug(&mut self, field: &Field, value: &dyn fmt::Debug) {
        // Writing to a string cannot fail.
        let _ = match field.name() {
            "message" => write!(self.0, " {value:?}"),
            name => write!(self.0, " {name}={value:?}"),
        };
    }
}

/// Finest level that a task's log contains.
pub const TASK_LOG_LEVEL: Level = Level::DEBUG;

#[cfg(test)]
mod tests {
    use tracing_subscriber::layer::SubscriberExt as _;

    use super::*;

    #[test]
    fn a_log_holds_the_events_of_its_task_and_no_other_s() {
        let (one, other) = (TaskLog::default(), TaskLog::default());
        one.begin();
        tracing::subscriber::with_default(tracing_subscriber::registry().with(TaskLogs), || {
            tracing::info!("nobody's");
            one.record_during(|| {
                tracing::info!(tiles = 3, "united");
                other.record_during(|| tracing::warn!("the other's"));
                tracing::error!("two\nlines");
            });
            tracing::info!("nobody's again");
        });
        let text = one.render("header\n", 1000);
        let mut lines = text.lines();
        assert_eq!(lines.next(), Some("header"));
        assert!(lines.next().is_some_and(|line| line.contains("INFO") && line.ends_with("united tiles=3")), "{text}");
        assert!(lines.next().is_some_and(|line| line.contains("ERROR") && line.ends_with("two")), "{text}");
        assert_eq!((lines.next().map(str::trim), lines.next()), (Some("lines"), None), "{text}");
        assert!(other.render("", 1000).contains("the other's") && one.seconds().is_some() && other.seconds().is_none());
    }

    #[test]
    fn endless_log_keeps_beginning_and_end_within_byte_limit() {
        let log = TaskLog::default();
        for number in 0..10_000 {
            log.lock().put(format!("line {number}"));
        }
        for limit in [200, 2 << 10, 64 << 10] {
            let text = log.render("header\n", limit);
            assert!(text.len() <= limit, "{} of {limit}", text.len());
            assert!(text.starts_with("header\nline 0\n") && text.ends_with("line 9999\n"), "{text}");
            assert!(text.contains("lines left out"));
        }
        log.lock().put("ä".repeat(40_000));
        let (text, header) = (log.render("header\n", 500), "ü".repeat(600));
        assert!(text.len() <= 500 && text.contains("left out"));
        assert!(log.render(&header, 500).len() <= 500);
    }
}
