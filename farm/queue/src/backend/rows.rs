//! Records with a number and a checksum, as the databases keep them.

use crate::{Contents, Page, QueueError};

/// A row as it was read.
pub(super) struct Row {
    pub(super) sequence: i64,
    pub(super) sum: Vec<u8>,
    pub(super) bytes: Vec<u8>,
}

impl Row {
    fn is_sound(&self) -> bool {
        self.sum == checksum(self.sequence, &self.bytes)
    }
}

/// The notes in these rows, of which there is one more than a page holds if another page follows.
pub(super) fn page(rows: Vec<Row>) -> Page {
    Page::of(rows.into_iter().map(|row| {
        let is_sound = row.sum == note_checksum(&row.bytes);
        if !is_sound {
            tracing::warn!(number = row.sequence, "a note beside the log is damaged");
        }
        (row.sequence.cast_unsigned(), is_sound.then_some(row.bytes))
    }))
}

/// Of a note's content.
pub(super) fn note_checksum(bytes: &[u8]) -> Vec<u8> {
    blake3::hash(bytes).as_bytes()[..16].to_vec()
}

/// Of the record's place and content, so that a record that strayed is found too.
pub(super) fn checksum(sequence: i64, bytes: &[u8]) -> Vec<u8> {
    let mut hash = blake3::Hasher::new();
    hash.update(&sequence.to_le_bytes()).update(bytes);
    hash.finalize().as_bytes()[..16].to_vec()
}

/// What the rows say, and the number of the last sound one. Damage at the end is a torn tail; damage before sound records
/// is an error.
pub(super) fn contents(
    snapshot: Option<Row>,
    rows: impl IntoIterator<Item = Row>,
) -> Result<(Contents, i64), QueueError> {
    let mut contents = Contents::default();
    let mut last = 0;
    if let Some(snapshot) = snapshot {
        if !snapshot.is_sound() {
            return Err(QueueError::DamagedSnapshot);
        }
        last = snapshot.sequence;
        contents.snapshot = Some(snapshot.bytes);
    }
    let mut broken = None;
    for row in rows {
        match broken {
            None if row.is_sound() && row.sequence == last + 1 => {
                last = row.sequence;
                contents.records.push(row.bytes);
            }
            None if row.is_sound() => return Err(QueueError::Damaged { sequence: last + 1, after: 1 }),
            None => {
                broken = Some(row.sequence);
                contents.torn = 1;
            }
            Some(sequence) if row.is_sound() => return Err(QueueError::Damaged { sequence, after: 1 }),
            Some(_) => contents.torn += 1,
        }
    }
    Ok((contents, last))
}
