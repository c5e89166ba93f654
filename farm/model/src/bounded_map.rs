//! A map with bounded size that keeps the latest entries. It bounds the memory of a session that lasts for years.

use std::collections::{BTreeMap, VecDeque};

/// The latest inserted values, by key.
#[derive(Debug, Clone)]
pub struct BoundedMap<K, V> {
    capacity: usize,
    values: BTreeMap<K, V>,
    /// Keys, oldest first.
    order: VecDeque<K>,
}

impl<K: Ord + Copy, V> BoundedMap<K, V> {
    /// Makes a map that holds up to `capacity` values, at least one.
    pub fn new(capacity: usize) -> Self {
        Self { capacity: capacity.max(1), values: BTreeMap::new(), order: VecDeque::new() }
    }

    /// Returns the value of `key`, if it is still held.
    pub fn get(&self, key: &K) -> Option<&V> {
        self.values.get(key)
    }

    /// Inserts a value as the latest. Drops the oldest value if there are too many.
    pub fn insert(&mut self, key: K, value: V) {
        if self.values.insert(key, value).is_some() {
            self.order.retain(|other| *other != key);
        }
        self.order.push_back(key);
        if self.order.len() > self.capacity
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
        let mut map = BoundedMap::new(2);
        map.insert(1, "one");
        map.insert(2, "two");
        map.insert(1, "one again");
        map.insert(3, "three");
        assert_eq!([1, 2, 3].map(|key| map.get(&key).copied()), [Some("one again"), None, Some("three")]);
    }
}
