//! Counters and histograms. Clones share the values. Counting never waits and holds locks only briefly.

use std::collections::BTreeMap;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

/// A number that only grows.
#[derive(Debug, Clone, Default)]
pub struct Counter(Arc<AtomicU64>);

impl Counter {
    /// Adds `more`.
    pub fn add(&self, more: u64) {
        self.0.fetch_add(more, Ordering::Relaxed);
    }

    /// Returns the count so far.
    pub fn get(&self) -> u64 {
        self.0.load(Ordering::Relaxed)
    }
}

/// A duration that only grows, counted in nanoseconds.
#[derive(Debug, Clone, Default)]
pub struct Seconds(Counter);

impl Seconds {
    /// Adds `seconds`; negative values and NaN add nothing.
    pub fn add(&self, seconds: f64) {
        // The cast saturates and turns NaN into 0.
        self.0.add((seconds * 1e9) as u64);
    }

    /// Returns the seconds so far.
    pub fn get(&self) -> f64 {
        self.0.get() as f64 / 1e9
    }
}

/// A counter per key.
#[derive(Debug, Clone)]
pub struct Tally<K>(Arc<Mutex<BTreeMap<K, u64>>>);

impl<K: Ord + Clone> Tally<K> {
    /// Creates a tally with these keys at 0. If a series appeared only with its first event, a rate query would miss that event.
    pub fn with_keys(keys: impl IntoIterator<Item = K>) -> Self {
        Self(Arc::new(Mutex::new(keys.into_iter().map(|key| (key, 0)).collect())))
    }

    /// Adds `more` to the counter of `key`.
    pub fn add(&self, key: K, more: u64) {
        *self.0.lock().unwrap_or_else(PoisonError::into_inner).entry(key).or_default() += more;
    }

    /// Returns the counts so far, in the order of the keys.
    pub fn get(&self) -> Vec<(K, u64)> {
        let counts = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        counts.iter().map(|(key, count)| (key.clone(), *count)).collect()
    }
}

/// A histogram of durations.
#[derive(Debug, Clone)]
pub struct Histogram(Arc<Buckets>);

#[derive(Debug)]
struct Buckets {
    /// Upper bounds in seconds, ascending.
    bounds: &'static [f64],
    /// One count per bound, and one for durations above all bounds.
    counts: Vec<AtomicU64>,
    sum: Seconds,
}

impl Histogram {
    /// Bounds from 0.1 ms to 10 s, for disk writes and calls.
    pub const LATENCIES: &'static [f64] =
        &[0.0001, 0.000_25, 0.0005, 0.001, 0.0025, 0.005, 0.01, 0.025, 0.05, 0.1, 0.25, 0.5, 1.0, 2.5, 10.0];

    /// Creates a histogram with these upper bounds, in seconds, ascending.
    pub fn new(bounds: &'static [f64]) -> Self {
        let counts = (0..=bounds.len()).map(|_| AtomicU64::new(0)).collect();
        Self(Arc::new(Buckets { bounds, counts, sum: Seconds::default() }))
    }

    /// Records one duration.
    pub fn observe(&self, took: Duration) {
        let seconds = took.as_secs_f64();
        let place = self.0.bounds.partition_point(|bound| *bound < seconds);
        self.0.counts[place].fetch_add(1, Ordering::Relaxed);
        self.0.sum.add(seconds);
    }

    /// Returns each upper bound, the last one infinite, with the number of durations that do not exceed it.
    pub(crate) fn cumulative_counts(&self) -> impl Iterator<Item = (f64, u64)> + '_ {
        let bounds = self.0.bounds.iter().copied().chain([f64::INFINITY]);
        bounds.zip(&self.0.counts).scan(0, |sum, (bound, count)| {
            *sum += count.load(Ordering::Relaxed);
            Some((bound, *sum))
        })
    }

    pub(crate) fn sum(&self) -> f64 {
        self.0.sum.get()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn duration_counts_in_its_bucket_and_all_above() {
        let histogram = Histogram::new(&[0.5, 1.0]);
        [250, 500, 750, 3_000]
            .into_iter()
            .for_each(|milliseconds| histogram.observe(Duration::from_millis(milliseconds)));
        assert_eq!(histogram.cumulative_counts().collect::<Vec<_>>(), [(0.5, 2), (1.0, 3), (f64::INFINITY, 4)]);
        assert_eq!(histogram.sum(), 4.5);
    }

    #[test]
    fn what_is_no_time_adds_none() {
        let seconds = Seconds::default();
        [f64::NAN, -1.0, 0.25].into_iter().for_each(|time| seconds.add(time));
        assert_eq!(seconds.get(), 0.25);
    }

    #[test]
    fn keys_are_there_before_their_first_event() {
        let tally = Tally::with_keys(["lost", "done"]);
        tally.add("done", 2);
        assert_eq!(tally.clone().get(), [("done", 2), ("lost", 0)]);
    }
}
