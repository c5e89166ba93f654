//! Records with a number and a checksum, as the databases keep them.

use crate::{Contents, QueueError};

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
