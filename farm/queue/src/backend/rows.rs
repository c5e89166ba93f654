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
        self.is_blank() || self.sum == checksum(self.sequence, &self.bytes)
    }

    /// Whether it stands for a batch without records.
    fn is_blank(&self) -> bool {
        self.bytes.is_empty() && self.sum == blank(self.sequence)
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

/// Of a row without a record, which has a number so that its loss shows.
pub(super) fn blank(sequence: i64) -> Vec<u8> {
    let mut hash = blake3::Hasher::new();
    hash.update(b"no record").update(&sequence.to_le_bytes());
    hash.finalize().as_bytes()[..16].to_vec()
}

/// What the rows of a log hold, as far as they are sound.
pub(super) struct LogRows {
    /// Up to the first that is damaged or gone.
    pub(super) contents: Contents,
    /// The number of the last sound one.
    pub(super) last: i64,
    /// Which is damaged or gone.
    pub(super) damage: Option<QueueError>,
}

/// What the rows say up to the first that is damaged or gone. A database keeps a transaction whole or not at all: damage is
/// never the trace of a write that was cut.
pub(super) fn check_rows(snapshot: Option<Row>, rows: impl IntoIterator<Item = Row>) -> Result<LogRows, QueueError> {
    let mut contents = Contents::default();
    let mut last = 0;
    if let Some(snapshot) = snapshot {
        if !snapshot.is_sound() {
            return Err(QueueError::DamagedSnapshot);
        }
        last = snapshot.sequence;
        contents.snapshot = Some(snapshot.bytes);
    }
    let mut rows = rows.into_iter();
    for row in rows.by_ref() {
        let is_sound = row.is_sound();
        if is_sound && row.sequence == last + 1 {
            last = row.sequence;
            if !row.is_blank() {
                contents.records.push(row.bytes);
            }
            continue;
        }
        let after = rows.filter(Row::is_sound).count() as u64 + u64::from(is_sound);
        let damage = Some(QueueError::Damaged { sequence: last + 1, after });
        return Ok(LogRows { contents, last, damage });
    }
    Ok(LogRows { contents, last, damage: None })
}
