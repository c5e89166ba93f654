//! A model of the log's contents, and reproducible random numbers.
#![allow(dead_code, reason = "each suite uses a part of it")]

use std::collections::BTreeMap;

use femc_queue::{Batch, Contents, Note, Page, Queue};

/// SplitMix64 generator: the same seed gives the same numbers.
#[derive(Debug, Clone)]
pub struct Chance(pub u64);

impl Chance {
    pub fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    /// Returns a number from 0 to less than `end`.
    pub fn below(&mut self, end: u64) -> u64 {
        self.next() % end
    }

    /// Returns fewer than `most` random bytes, sometimes none.
    pub fn bytes(&mut self, most: u64) -> Vec<u8> {
        let length = if self.below(8) == 0 { 0 } else { self.below(most) };
        (0..length).map(|_| self.next() as u8).collect()
    }
}

/// A batch that owns its data.
#[derive(Debug, Clone, Default)]
pub struct Work {
    pub records: Vec<Vec<u8>>,
    pub notes: Vec<Note>,
    pub forgotten: Vec<u64>,
}

impl Work {
    /// Creates a random batch, sometimes an empty one.
    pub fn by(chance: &mut Chance) -> Self {
        let most = [1, 3, 9, 80][chance.below(4) as usize];
        let records = (0..chance.below(most)).map(|_| chance.bytes(400)).collect();
        let some = if chance.below(2) == 0 { 0 } else { chance.below(5) };
        let notes = (0..some).map(|_| Note { subject: chance.below(4), bytes: chance.bytes(300) }).collect();
        let forgotten = (0..chance.below(8).saturating_sub(6)).map(|_| chance.below(4)).collect();
        Self { records, notes, forgotten }
    }

    pub fn batch(&self) -> Batch<'_> {
        Batch { records: &self.records, notes: &self.notes, forgotten: &self.forgotten }
    }
}

/// Expected contents of a log.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Model {
    pub snapshot: Option<Vec<u8>>,
    pub records: Vec<Vec<u8>>,
    notes: BTreeMap<u64, Vec<Vec<u8>>>,
}

impl Model {
    pub fn append(&mut self, work: &Work) {
        self.records.extend_from_slice(&work.records);
        for subject in &work.forgotten {
            self.notes.remove(subject);
        }
        for Note { subject, bytes } in &work.notes {
            self.notes.entry(*subject).or_default().push(bytes.clone());
        }
    }

    pub fn snapshot(&mut self, state: Vec<u8>) {
        (self.snapshot, self.records) = (Some(state), Vec::new());
    }

    pub fn notes(&self, subject: u64) -> Vec<Vec<u8>> {
        self.notes.get(&subject).cloned().unwrap_or_default()
    }

    pub fn check(&self, found: &Contents, when: &str) {
        let Contents { snapshot, records, torn, lost } = found;
        let counts = |records: &[Vec<u8>]| (records.len(), records.iter().map(Vec::len).sum::<usize>());
        assert_eq!(counts(records), counts(&self.records), "{when}: records and their bytes");
        assert!(*records == self.records && *snapshot == self.snapshot, "{when}: other bytes");
        assert_eq!((*torn, *lost), (0, None), "{when}");
    }
}

/// Reads all pages of a subject and concatenates them.
pub async fn all_notes<Q: Queue>(queue: &mut Q, subject: u64) -> Vec<Vec<u8>> {
    let (mut all, mut from) = (Vec::new(), Some(0));
    while let Some(at) = from {
        let Page { notes, next } = queue.notes(subject, at).await.unwrap();
        let bytes: usize = notes.iter().map(Vec::len).sum();
        let is_full = notes.len() == Page::NOTES || bytes >= Page::BYTES;
        assert!(notes.len() <= Page::NOTES && (is_full || next.is_none()), "{} notes, {bytes} bytes", notes.len());
        let before = bytes - notes.last().map_or(0, Vec::len);
        assert!(before < Page::BYTES, "{before} bytes before the last");
        all.extend(notes);
        from = next;
    }
    all
}
