//! Times of several attempts together.

use femc_model::{Tick, Times, Usage};

/// When an attempt ran and what it took. Seconds, by the farm's clock.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Span {
    /// When its lease was granted.
    pub granted: f64,
    /// When its work began: not before the lease.
    pub began: f64,
    /// When its work ended: not after the lease.
    pub stopped: f64,
    /// When its lease ended.
    pub ended: f64,
    /// Seconds of the work, as the worker measured them; else the length of the lease.
    pub wall: f64,
    /// Processor seconds.
    pub processor: f64,
}

impl Span {
    /// Span of an attempt.
    /// - `usage`: what its worker measured, if it is known.
    pub fn new(granted: Tick, ended: Tick, usage: Option<Usage>) -> Self {
        let seconds = |tick: Tick| tick.0 as f64 / 1000.0;
        let granted = seconds(granted);
        let ended = seconds(ended).max(granted);
        let Some(usage) = usage else {
            return Self { granted, began: granted, stopped: ended, ended, wall: ended - granted, processor: 0.0 };
        };
        // A lease that was handed over to another coordinator may say that it was granted after its work began.
        let began = (granted + usage.wait).min(ended - usage.wall).max(granted);
        let stopped = (began + usage.wall).min(ended);
        Self { granted, began, stopped, ended, wall: usage.wall, processor: usage.cpu }
    }
}

/// Adds attempts up.
///
/// Processor and wall seconds are sums. Waiting is the time from the first lease to the end of the last one, less the union of the times
/// in which some attempt ran. Laws: the processor and wall seconds of frames add up to those of their job; waiting is not negative;
/// waiting and wall seconds together are at least the time from the first lease to the end of the last one.
#[derive(Debug, Clone, Default)]
pub struct Sum {
    times: Times,
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

    /// All together; `None`: nothing was added.
    pub fn times(mut self) -> Option<Times> {
        let (first, last) = self.lease?;
        self.runs.sort_by(|a, b| a.0.total_cmp(&b.0));
        let (mut busy, mut until) = (0.0, first);
        for (began, stopped) in self.runs {
            busy += (stopped - began.max(until)).max(0.0);
            until = f64::max(until, stopped);
        }
        Some(Times { waiting: (last - first - busy).max(0.0), ..self.times })
    }
}

impl FromIterator<Span> for Sum {
    fn from_iter<I: IntoIterator<Item = Span>>(spans: I) -> Self {
        let mut sum = Self::default();
        spans.into_iter().for_each(|span| sum.add(&span));
        sum
    }
}
