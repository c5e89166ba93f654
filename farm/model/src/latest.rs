//! What was told last: a session of years remembers no more than one of days.

use std::collections::{BTreeMap, VecDeque};

/// The values that were put in last, by their keys.
#[derive(Debug, Clone)]
pub struct Latest<K, V> {
    most: usize,
    values: BTreeMap<K, V>,
    /// Oldest first.
    order: VecDeque<K>,
}

impl<K: Ord + Copy, V> Latest<K, V> {
    /// Holds `most` values, at least one.
    pub fn new(most: usize) -> Self {
        Self { most: most.max(1), values: BTreeMap::new(), order: VecDeque::new() }
    }

    /// The value of `key`, if it is one of the latest.
    pub fn get(&self, key: &K) -> Option<&V> {
        self.values.get(key)
    }

    /// Puts a value in, as the latest; the oldest goes where there are too many.
    pub fn put(&mut self, key: K, value: V) {
        if self.values.insert(key, value).is_some() {
            self.order.retain(|other| *other != key);
        }
        self.order.push_back(key);
        if self.order.len() > self.most
            && let Some(oldest) = self.order.pop_front()
        {
            self.values.remove(&oldest);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_oldest_goes_and_what_comes_again_is_the_latest() {
        let mut latest = Latest::new(2);
        latest.put(1, "one");
        latest.put(2, "two");
        latest.put(1, "one again");
        latest.put(3, "three");
        assert_eq!([1, 2, 3].map(|key| latest.get(&key).copied()), [Some("one again"), None, Some("three")]);
    }
}
