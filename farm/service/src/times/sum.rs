//! Sums of the times of several attempts.

use femc_model::{AttemptTimes, ResourceUsage, Tick};

/// Time span and usage of an attempt, in seconds of the farm's clock.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Span {
    /// Time at which the lease was granted.
    pub granted: f64,
    /// Time at which the work started, not before the lease.
    pub began: f64,
    /// Time at which the work stopped, not after the lease.
    pub stopped: f64,
    /// Time at which the lease ended.
    pub ended: f64,
    /// Seconds of work as measured by the worker, or the length of the lease if there is no measurement.
    pub wall: f64,
    /// Processor seconds.
    pub processor: f64,
}

impl Span {
    /// Makes the span of an attempt.
    /// - `usage`: measurement of the worker, if known.
    pub fn new(granted: Tick, ended: Tick, usage: Option<ResourceUsage>) -> Self {
        let seconds = |tick: Tick| tick.0 as f64 / 1000.0;
        let granted = seconds(granted);
        let ended = seconds(ended).max(granted);
        let Some(usage) = usage else {
            return Self { granted, began: granted, stopped: ended, ended, wall: ended - granted, processor: 0.0 };
        };
        // The grant time of a lease that was handed over to another coordinator may lie after the start of its work.
        let began = (granted + usage.wait).min(ended - usage.wall).max(granted);
        let stopped = (began + usage.wall).min(ended);
        Self { granted, began, stopped, ended, wall: usage.wall, processor: usage.cpu }
    }
}

/// Accumulates attempts.
///
/// Processor and wall seconds are sums. Waiting is the time from the first lease to the end of the last one, minus the union of the
/// times in which some attempt ran. Laws: the processor and wall seconds of the frames add up to those of their job. Waiting is not
/// negative. Waiting plus wall seconds are at least the time from the first lease to the end of the last one.
#[derive(Debug, Clone, Default)]
pub struct Sum {
    times: AttemptTimes,
    lease: Option<(f64, f64)>,
    runs: Vec<(f64, f64)>,
}

impl Sum {
    /// Adds an attempt.
    pub fn add(&mut self, span: &Span) {
        self.times.attempts += 1;
        self.times.processor += span.processor;
        self.times.wall += span.wall;
        let (first, last) = self.lease.unwrap_or((span.granted, span.ended));
        self.lease = Some((first.min(span.granted), last.max(span.ended)));
        self.runs.push((span.began, span.stopped));
    }

    /// Returns the sums; `None`: nothing was added.
    pub fn times(mut self) -> Option<AttemptTimes> {
        let (first, last) = self.lease?;
        self.runs.sort_by(|a, b| a.0.total_cmp(&b.0));
        let (mut busy, mut until) = (0.0, first);
        for (began, stopped) in self.runs {
            busy += (stopped - began.max(until)).max(0.0);
            until = f64::max(until, stopped);
        }
        Some(AttemptTimes { waiting: (last - first - busy).max(0.0), ..self.times })
    }
}

impl FromIterator<Span> for Sum {
    fn from_iter<I: IntoIterator<Item = Span>>(spans: I) -> Self {
        let mut sum = Self::default();
        spans.into_iter().for_each(|span| sum.add(&span));
        sum
    }
}
