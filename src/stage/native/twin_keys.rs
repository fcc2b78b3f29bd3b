//! What was composed before, found by everything that composes it.

use openusd::sdf;
use std::collections::{HashMap, VecDeque};

/// Fields of a spec by name, sorted.
pub(super) type Key = Vec<(String, sdf::Value)>;

/// Keys that are compared with as they are before one is spelled out to be looked up, which takes some µs: the
/// prototypes that instances beside each other take turns in.
const RECENT: usize = 32;

/// Values by keys. A key has no order and no hash, only equality.
pub(super) struct ByKey<T> {
    recent: VecDeque<(Key, T)>,
    all: HashMap<String, T>,
}

impl<T> Default for ByKey<T> {
    fn default() -> Self {
        Self {
            recent: VecDeque::new(),
            all: HashMap::new(),
        }
    }
}

impl<T: Clone> ByKey<T> {
    /// The value of `key`.
    pub(super) fn get(&mut self, key: &Key) -> Option<T> {
        let recent = self.recent.iter().find(|(other, _)| other == key);
        if let Some((_, value)) = recent {
            return Some(value.clone());
        }
        let value = self.all.get(&spelled(key))?.clone();
        self.set_recent(key.clone(), value.clone());
        Some(value)
    }

    pub(super) fn insert(&mut self, key: Key, value: T) {
        self.all.insert(spelled(&key), value.clone());
        self.set_recent(key, value);
    }

    fn set_recent(&mut self, key: Key, value: T) {
        self.recent.truncate(RECENT - 1);
        self.recent.push_front((key, value));
    }
}

fn spelled(key: &Key) -> String {
    key.iter()
        .map(|(name, value)| format!("{name}={value:?};"))
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn keys_are_found_however_many_came_between() {
        let key = |number: i32| vec![("kind".to_owned(), sdf::Value::Int(number))];
        let mut known = ByKey::default();
        let count = 3 * i32::try_from(RECENT).unwrap();
        for number in 0..count {
            assert_eq!(known.get(&key(number)), None);
            known.insert(key(number), number);
        }
        for number in 0..count {
            assert_eq!(known.get(&key(number)), Some(number));
        }
        assert_eq!(known.get(&Vec::new()), None);
    }
}
