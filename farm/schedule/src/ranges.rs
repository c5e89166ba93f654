//! Sets of task numbers, stored as ranges: a million waiting tasks need one entry.

use std::collections::BTreeMap;
use std::ops::Range;

use serde::{Deserialize, Serialize};

/// A set of numbers, stored as disjoint ranges that do not touch.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct RangeSet {
    /// Ends of the ranges, by their starts.
    ranges: BTreeMap<u32, u32>,
}

impl RangeSet {
    /// Returns the ranges, ascending.
    pub fn ranges(&self) -> impl Iterator<Item = Range<u32>> + '_ {
        self.ranges.iter().map(|(&start, &end)| start..end)
    }

    /// Returns the numbers, ascending.
    pub fn iter(&self) -> impl Iterator<Item = u32> + '_ {
        self.ranges().flatten()
    }

    /// Checks whether the set is empty.
    pub fn is_empty(&self) -> bool {
        self.ranges.is_empty()
    }

    /// Counts the numbers; visits all ranges.
    pub fn count(&self) -> u32 {
        self.ranges().map(|range| range.end - range.start).sum()
    }

    /// Checks whether the set contains `value`.
    pub fn contains(&self, value: u32) -> bool {
        self.ranges.range(..=value).next_back().is_some_and(|(_, &end)| value < end)
    }

    /// Adds `value`, if it is not in the set.
    pub fn insert(&mut self, value: u32) {
        if self.contains(value) {
            return;
        }
        let end = self.ranges.remove(&(value + 1)).unwrap_or(value + 1);
        match self.ranges.range_mut(..=value).next_back() {
            Some((_, before)) if *before == value => *before = end,
            _ => {
                self.ranges.insert(value, end);
            }
        }
    }

    /// Adds all numbers of `range`.
    pub fn insert_range(&mut self, range: Range<u32>) {
        if range.is_empty() {
            return;
        }
        let before = self.ranges.range(..range.start).next_back().filter(|&(_, &end)| end >= range.start);
        let start = before.map_or(range.start, |(&start, _)| start);
        let last = self.ranges.range(..=range.end).next_back().map_or(range.end, |(_, &end)| end.max(range.end));
        let inside: Vec<u32> = self.ranges.range(start..=range.end).map(|(&start, _)| start).collect();
        for start in inside {
            self.ranges.remove(&start);
        }
        self.ranges.insert(start, last);
    }

    /// Checks whether the set contains some numbers of `range`.
    pub fn intersects(&self, range: &Range<u32>) -> bool {
        !range.is_empty() && self.ranges.range(..range.end).next_back().is_some_and(|(_, &end)| end > range.start)
    }

    /// Removes all numbers of `range` that are in the set.
    pub fn remove_range(&mut self, range: Range<u32>) {
        if range.is_empty() {
            return;
        }
        let touched = |entry: &(&u32, &u32)| *entry.1 > range.start;
        while let Some((&start, &end)) = self.ranges.range(..range.end).next_back().filter(touched) {
            self.ranges.remove(&start);
            if range.end < end {
                self.ranges.insert(range.end, end);
            }
            if start < range.start {
                self.ranges.insert(start, range.start);
            }
            if start <= range.start {
                return;
            }
        }
    }

    /// Returns the numbers from `value` on that are in the set without a gap.
    pub fn run_from(&self, value: u32) -> Range<u32> {
        let around = self.ranges.range(..=value).next_back().filter(|&(_, &end)| value < end);
        value..around.map_or(value, |(_, &end)| end)
    }

    /// Checks whether the set contains all numbers of `range`.
    pub fn covers(&self, range: &Range<u32>) -> bool {
        self.run_from(range.start).end >= range.end
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use proptest::prelude::*;

    use super::*;

    proptest! {
        #[test]
        fn a_range_set_is_a_set(steps in prop::collection::vec((0u32..3, 0u32..24, 0u32..6), 0..200)) {
            let (mut ranges, mut set) = (RangeSet::default(), (4..12).collect::<BTreeSet<u32>>());
            ranges.insert_range(4..12);
            for (step, value, length) in steps {
                let range = value..value + length;
                prop_assert_eq!(ranges.covers(&range), range.clone().all(|value| set.contains(&value)));
                prop_assert_eq!(ranges.run_from(value).count(), (value..).take_while(|value| set.contains(value)).count());
                prop_assert_eq!(ranges.intersects(&range), range.clone().any(|value| set.contains(&value)));
                match step {
                    0 => {
                        ranges.insert(value);
                        set.insert(value);
                    }
                    1 => {
                        ranges.insert_range(range.clone());
                        set.extend(range);
                    }
                    _ => {
                        ranges.remove_range(range.clone());
                        set.retain(|value| !range.contains(value));
                    }
                }
                prop_assert_eq!(ranges.iter().collect::<Vec<_>>(), set.iter().copied().collect::<Vec<_>>());
                prop_assert_eq!(ranges.count() as usize, set.len());
                prop_assert_eq!(ranges.contains(value), set.contains(&value));
                let ends: Vec<_> = ranges.ranges().collect();
                prop_assert!(ends.windows(2).all(|pair| pair[0].end < pair[1].start), "ranges touch: {:?}", ends);
            }
        }
    }

    #[test]
    fn a_million_waiting_tasks_are_one_entry() {
        let mut set = RangeSet::default();
        set.insert_range(0..1_000_000);
        (0..1000).for_each(|value| set.remove_range(value..value + 1));
        assert_eq!((set.ranges.len(), set.count()), (1, 999_000));
    }
}
