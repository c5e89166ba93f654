//! Numbered records with checksums, as the databases store them.

use crate::{LogContents, NotePage, QueueError};

/// A row as read from the database.
pub(super) struct Row {
    pub(super) sequence: i64,
    pub(super) checksum: Vec<u8>,
    pub(super) bytes: Vec<u8>,
}

impl Row {
    fn is_valid(&self) -> bool {
        self.is_blank() || self.checksum == checksum(self.sequence, &self.bytes)
    }

    /// Checks whether the row represents a batch without records.
    fn is_blank(&self) -> bool {
        self.bytes.is_empty() && self.checksum == blank_checksum(self.sequence)
    }
}

/// Returns the page of notes in these rows. If another page follows, there is one row more than a page holds.
pub(super) fn note_page(rows: Vec<Row>) -> NotePage {
    NotePage::from_notes(rows.into_iter().map(|row| {
        let is_sound = row.checksum == note_checksum(&row.bytes);
        if !is_sound {
            tracing::warn!(number = row.sequence, "a note beside the log is damaged");
        }
        (row.sequence.cast_unsigned(), is_sound.then_some(row.bytes))
    }))
}

/// Computes the checksum of a note's content.
pub(super) fn note_checksum(bytes: &[u8]) -> Vec<u8> {
    blake3::hash(bytes).as_bytes()[..16].to_vec()
}

/// Computes the checksum of a record's number and content. With the number, a misplaced record is detected, too.
pub(super) fn checksum(sequence: i64, bytes: &[u8]) -> Vec<u8> {
    let mut hash = blake3::Hasher::new();
    hash.update(&sequence.to_le_bytes()).update(bytes);
    hash.finalize().as_bytes()[..16].to_vec()
}

/// Computes the checksum of a row without a record. The row has a number so that its loss is detected.
pub(super) fn blank_checksum(sequence: i64) -> Vec<u8> {
    let mut hash = blake3::Hasher::new();
    hash.update(b"no record").update(&sequence.to_le_bytes());
    hash.finalize().as_bytes()[..16].to_vec()
}

/// The sound content of a log's rows.
pub(super) struct LogRows {
    /// Content up to the first damaged or missing row.
    pub(super) contents: LogContents,
    /// Number of the last sound row.
    pub(super) last: i64,
    /// Error for the first damaged or missing row.
    pub(super) damage: Option<QueueError>,
}

/// Verifies the rows up to the first damaged or missing one. A database stores a transaction either whole or not at all, so damage
/// is never the result of an interrupted write.
pub(super) fn check_rows(snapshot: Option<Row>, rows: impl IntoIterator<Item = Row>) -> Result<LogRows, QueueError> {
    let mut contents = LogContents::default();
    let mut last = 0;
    if let Some(snapshot) = snapshot {
        if !snapshot.is_valid() {
            return Err(QueueError::DamagedSnapshot);
        }
        last = snapshot.sequence;
        contents.snapshot = Some(snapshot.bytes);
    }
    let mut rows = rows.into_iter();
    for row in rows.by_ref() {
        let is_sound = row.is_valid();
        if is_sound && row.sequence == last + 1 {
            last = row.sequence;
            if !row.is_blank() {
                contents.records.push(row.bytes);
            }
            continue;
        }
        let after = rows.filter(Row::is_valid).count() as u64 + u64::from(is_sound);
        let damage = Some(QueueError::Damaged { sequence: last + 1, after });
        return Ok(LogRows { contents, last, damage });
    }
    Ok(LogRows { contents, last, damage: None })
}
