//! A map with bounded size that keeps the latest entries. It bounds the memory of a session that lasts for years.

use std::collections::{BTreeMap, VecDeque};

/// The latest inserted values, by key.
#[derive(Debug, Clone)]
pub struct Latest<K, V> {
    most: usize,
    values: BTreeMap<K, V>,
    /// Keys, oldest first.
    order: VecDeque<K>,
}

impl<K: Ord + Copy, V> Latest<K, V> {
    /// Makes a map that holds up to `most` values, at least one.
    pub fn new(most: usize) -> Self {
        Self { most: most.max(1), values: BTreeMap::new(), order: VecDeque::new() }
    }

    /// Returns the value of `key`, if it is still held.
    pub fn get(&self, key: &K) -> Option<&V> {
        self.values.get(key)
    }

    /// Inserts a value as the latest. Drops the oldest value if there are too many.
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
