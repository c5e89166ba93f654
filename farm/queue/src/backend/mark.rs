//! The mark: a small file beside the SQLite log that states how much the log must contain.
//!
//! SQLite treats the first damaged frame of its write-ahead log as the log's end. One flipped bit would silently lose all
//! acknowledged records after it. So the number of the last durable record and the highest incarnation are also kept in the mark.
//! It is written after a commit and before the commit is acknowledged. It is handed to the operating system and not synced, which
//! costs a few microseconds: a killed process loses nothing of it. After a power cut it may be a second old; then it requires fewer
//! records than exist, never more.
//!
//! Two slots are written in turn, so that a torn write of one leaves the other intact.

use std::fs::{self, File, OpenOptions};
use std::io::{self, Read as _, Seek as _, SeekFrom, Write as _};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

/// Identity of a log, as stored in its header.
pub(super) type Identity = [u8; 16];

/// Content of a mark.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Known {
    pub(super) identity: Identity,
    /// Number of the last record known to be durable; all records before it are durable, too.
    pub(super) sequence: i64,
    /// The highest reserved incarnation.
    pub(super) incarnation: u32,
}

/// Result of reading a mark's file.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Found {
    Nothing,
    /// Neither slot is valid. A crash cannot cause this.
    Damaged,
    Mark(Known),
}

/// An open mark.
#[derive(Debug)]
pub(super) struct Mark {
    file: File,
    path: PathBuf,
    known: Known,
    /// Number of the latest write; its parity selects the slot.
    turn: u64,
    synced: Instant,
    /// Whether the latest write succeeded.
    is_written: bool,
}

const MAGIC: &[u8; 8] = b"femcmark";
const VERSION: u32 = 1;
/// Sizes in bytes of a slot's content and of its checksum.
const BODY: usize = 48;
const SUM: usize = 16;
/// Size in bytes of a block; each slot has its own block.
const BLOCK: usize = 4096;

fn encode(known: &Known, turn: u64) -> [u8; BODY + SUM] {
    let mut slot = [0; BODY + SUM];
    slot[..8].copy_from_slice(MAGIC);
    slot[8..12].copy_from_slice(&VERSION.to_le_bytes());
    slot[12..16].copy_from_slice(&known.incarnation.to_le_bytes());
    slot[16..24].copy_from_slice(&turn.to_le_bytes());
    slot[24..32].copy_from_slice(&known.sequence.to_le_bytes());
    slot[32..48].copy_from_slice(&known.identity);
    let sum = blake3::hash(&slot[..BODY]);
    slot[BODY..].copy_from_slice(&sum.as_bytes()[..SUM]);
    slot
}

fn decode(slot: &[u8]) -> Option<(u64, Known)> {
    let slot: &[u8; BODY + SUM] = slot.get(..BODY + SUM)?.try_into().ok()?;
    let (body, sum) = slot.split_at(BODY);
    let is_sound = blake3::hash(body).as_bytes()[..SUM] == *sum;
    let (head, body) = body.split_at(16);
    if !is_sound || head[..8] != *MAGIC || head[8..12] != VERSION.to_le_bytes() {
        return None;
    }
    let known = Known {
        incarnation: u32::from_le_bytes(head[12..16].try_into().ok()?),
        sequence: i64::from_le_bytes(body[8..16].try_into().ok()?),
        identity: body[16..32].try_into().ok()?,
    };
    Some((u64::from_le_bytes(body[..8].try_into().ok()?), known))
}

/// Returns the number and the content of the later valid slot.
fn latest(bytes: &[u8]) -> Option<(u64, Known)> {
    [bytes, bytes.get(BLOCK..).unwrap_or_default()].into_iter().filter_map(decode).max_by_key(|(turn, _)| *turn)
}

impl Mark {
    /// Minimum time between two syncs to the disk.
    const SYNC: Duration = Duration::from_secs(1);

    /// Reads the mark at `path`.
    pub(super) fn look(path: &Path) -> io::Result<Found> {
        let mut bytes = Vec::new();
        match File::open(path) {
            Ok(file) => file.take(2 * BLOCK as u64).read_to_end(&mut bytes)?,
            Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(Found::Nothing),
            Err(error) => return Err(error),
        };
        Ok(latest(&bytes).map_or(Found::Damaged, |(_, known)| Found::Mark(known)))
    }

    /// Creates a mark at `path` and replaces an existing file. It is on the disk when this returns.
    pub(super) fn put(path: &Path, known: Known) -> io::Result<Self> {
        let mut new = path.to_owned().into_os_string();
        new.push(".new");
        let new = PathBuf::from(new);
        let mut blocks = vec![0; 2 * BLOCK];
        for (turn, block) in (1..).zip(blocks.chunks_mut(BLOCK)) {
            block[..BODY + SUM].copy_from_slice(&encode(&known, turn));
        }
        let mut file = OpenOptions::new().create(true).truncate(true).write(true).open(&new)?;
        let put = (|| {
            file.write_all(&blocks)?;
            file.sync_all()?;
            fs::rename(&new, path)?;
            folder(path)?.sync_all()
        })();
        if let Err(error) = put {
            // The file may not exist: its creation may have failed.
            let _ = fs::remove_file(&new);
            return Err(error);
        }
        Ok(Self { file, path: path.to_owned(), known, turn: 2, synced: Instant::now(), is_written: true })
    }

    pub(super) fn known(&self) -> &Known {
        &self.known
    }

    /// Notes that the records up to `sequence` are durable.
    pub(super) fn note(&mut self, sequence: i64) {
        self.known.sequence = sequence;
        self.written();
        if self.synced.elapsed() >= Self::SYNC {
            self.synced = Instant::now();
            let (file, path) = (self.file.try_clone(), self.path.clone());
            // The log's writer does not wait for the sync.
            tokio::task::spawn_blocking(move || {
                if let Err(error) = file.and_then(|file| file.sync_data()) {
                    tracing::warn!(path = %path.display(), %error, "cannot sync the log's mark to the disk");
                }
            });
        }
    }

    /// Writes the next slot. A failure is only logged: an outdated mark merely requires fewer records than exist.
    fn written(&mut self) {
        let written = self.write();
        if let (Err(error), true) = (&written, self.is_written) {
            tracing::warn!(path = %self.path.display(), %error, "cannot write the log's mark: it is outdated");
        }
        self.is_written = written.is_ok();
    }

    fn write(&mut self) -> io::Result<()> {
        self.turn += 1;
        let place = if self.turn % 2 == 1 { 0 } else { BLOCK as u64 };
        self.file.seek(SeekFrom::Start(place))?;
        self.file.write_all(&encode(&self.known, self.turn))
    }

    /// Reserves the incarnations up to this one, so that none of them is assigned again. The mark is on the disk when this returns.
    pub(super) fn reserve(&mut self, incarnation: u32) -> io::Result<()> {
        self.known.incarnation = incarnation;
        self.write()?;
        self.sync()
    }

    /// Syncs the mark to the disk.
    pub(super) fn sync(&mut self) -> io::Result<()> {
        self.synced = Instant::now();
        self.file.sync_data()
    }
}

/// Opens the folder that contains `path`.
fn folder(path: &Path) -> io::Result<File> {
    let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty());
    File::open(folder.unwrap_or(Path::new(".")))
}

#[cfg(test)]
mod tests {
    use super::*;

    const KNOWN: Known = Known { identity: [7; 16], sequence: 5, incarnation: 3 };

    #[tokio::test]
    async fn mark_survives_one_lost_slot_and_is_at_most_one_batch_older() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("log-mark");
        assert_eq!(Mark::look(&path).unwrap(), Found::Nothing);
        let mut mark = Mark::put(&path, KNOWN).unwrap();
        for sequence in [8, 9] {
            mark.note(sequence);
        }
        let whole = fs::read(&path).unwrap();
        assert_eq!(latest(&whole), Some((4, Known { sequence: 9, ..KNOWN })));
        for bit in 0..8 * whole.len() {
            let mut flipped = whole.clone();
            flipped[bit / 8] ^= 1 << (bit % 8);
            let (_, known) = latest(&flipped).expect("the other slot");
            assert!(matches!(known, Known { sequence: 8 | 9, identity: [7, ..], incarnation: 3 }), "bit {bit}");
        }
        for length in 0..whole.len() {
            let found = latest(&whole[..length]).map(|(_, known)| known.sequence);
            assert_eq!(found.is_some(), length >= BODY + SUM, "{length}");
            assert!(found.is_none_or(|sequence| sequence == 8 || length >= BLOCK + BODY + SUM), "{length}");
        }
        fs::write(&path, b"").unwrap();
        assert_eq!(Mark::look(&path).unwrap(), Found::Damaged);
    }
}
