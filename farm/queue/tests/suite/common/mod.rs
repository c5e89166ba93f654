//! A model of the log's contents, and reproducible random numbers.
#![allow(dead_code, reason = "each suite uses a part of it")]

use std::collections::BTreeMap;

use femc_queue::{Batch, LogContents, Note, NotePage, Queue};

/// SplitMix64 generator: the same seed gives the same numbers.
#[derive(Debug, Clone)]
pub struct SplitMix64(pub u64);

impl SplitMix64 {
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
pub struct OwnedBatch {
    pub records: Vec<Vec<u8>>,
    pub notes: Vec<Note>,
    pub forgotten: Vec<u64>,
}

impl OwnedBatch {
    /// Creates a random batch, sometimes an empty one.
    pub fn random(rng: &mut SplitMix64) -> Self {
        let most = [1, 3, 9, 80][rng.below(4) as usize];
        let records = (0..rng.below(most)).map(|_| rng.bytes(400)).collect();
        let some = if rng.below(2) == 0 { 0 } else { rng.below(5) };
        let notes = (0..some).map(|_| Note { subject: rng.below(4), bytes: rng.bytes(300) }).collect();
        let forgotten = (0..rng.below(8).saturating_sub(6)).map(|_| rng.below(4)).collect();
        Self { records, notes, forgotten }
    }

    pub fn batch(&self) -> Batch<'_> {
        Batch { records: &self.records, notes: &self.notes, forgotten: &self.forgotten }
    }
}

/// Expected contents of a log.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct LogModel {
    pub snapshot: Option<Vec<u8>>,
    pub records: Vec<Vec<u8>>,
    notes: BTreeMap<u64, Vec<Vec<u8>>>,
}

impl LogModel {
    pub fn append(&mut self, batch: &OwnedBatch) {
        self.records.extend_from_slice(&batch.records);
        for subject in &batch.forgotten {
            self.notes.remove(subject);
        }
        for Note { subject, bytes } in &batch.notes {
            self.notes.entry(*subject).or_default().push(bytes.clone());
        }
    }

    pub fn snapshot(&mut self, state: Vec<u8>) {
        (self.snapshot, self.records) = (Some(state), Vec::new());
    }

    pub fn notes(&self, subject: u64) -> Vec<Vec<u8>> {
        self.notes.get(&subject).cloned().unwrap_or_default()
    }

    pub fn check(&self, contents: &LogContents, when: &str) {
        let LogContents { snapshot, records, torn, missing: lost } = contents;
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
        let NotePage { notes, next } = queue.notes(subject, at).await.unwrap();
        let bytes: usize = notes.iter().map(Vec::len).sum();
        let is_full = notes.len() == NotePage::MAX_NOTES || bytes >= NotePage::MAX_BYTES;
        assert!(
            notes.len() <= NotePage::MAX_NOTES && (is_full || next.is_none()),
            "{} notes, {bytes} bytes",
            notes.len()
        );
        let before = bytes - notes.last().map_or(0, Vec::len);
        assert!(before < NotePage::MAX_BYTES, "{before} bytes before the last");
        all.extend(notes);
        from = next;
    }
    all
}
