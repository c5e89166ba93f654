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
pub(super) struct WatermarkState {
    pub(super) identity: Identity,
    /// Number of the last record known to be durable; all records before it are durable, too.
    pub(super) sequence: i64,
    /// The highest reserved incarnation.
    pub(super) incarnation: u32,
}

/// Result of reading a mark's file.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum WatermarkFile {
    Missing,
    /// Neither slot is valid. A crash cannot cause this.
    Damaged,
    Valid(WatermarkState),
}

/// An open mark.
#[derive(Debug)]
pub(super) struct Watermark {
    file: File,
    path: PathBuf,
    state: WatermarkState,
    /// Number of the latest write; its parity selects the slot.
    write_count: u64,
    last_sync: Instant,
    /// Whether the latest write succeeded.
    is_current: bool,
}

const MAGIC: &[u8; 8] = b"femcmark";
const VERSION: u32 = 1;
/// Sizes in bytes of a slot's content and of its checksum.
const SLOT_BYTES: usize = 48;
const CHECKSUM_BYTES: usize = 16;
/// Size in bytes of a block; each slot has its own block.
const BLOCK: usize = 4096;

fn encode(state: &WatermarkState, turn: u64) -> [u8; SLOT_BYTES + CHECKSUM_BYTES] {
    let mut slot = [0; SLOT_BYTES + CHECKSUM_BYTES];
    slot[..8].copy_from_slice(MAGIC);
    slot[8..12].copy_from_slice(&VERSION.to_le_bytes());
    slot[12..16].copy_from_slice(&state.incarnation.to_le_bytes());
    slot[16..24].copy_from_slice(&turn.to_le_bytes());
    slot[24..32].copy_from_slice(&state.sequence.to_le_bytes());
    slot[32..48].copy_from_slice(&state.identity);
    let sum = blake3::hash(&slot[..SLOT_BYTES]);
    slot[SLOT_BYTES..].copy_from_slice(&sum.as_bytes()[..CHECKSUM_BYTES]);
    slot
}

fn decode(slot: &[u8]) -> Option<(u64, WatermarkState)> {
    let slot: &[u8; SLOT_BYTES + CHECKSUM_BYTES] = slot.get(..SLOT_BYTES + CHECKSUM_BYTES)?.try_into().ok()?;
    let (body, sum) = slot.split_at(SLOT_BYTES);
    let is_sound = blake3::hash(body).as_bytes()[..CHECKSUM_BYTES] == *sum;
    let (head, body) = body.split_at(16);
    if !is_sound || head[..8] != *MAGIC || head[8..12] != VERSION.to_le_bytes() {
        return None;
    }
    let state = WatermarkState {
        incarnation: u32::from_le_bytes(head[12..16].try_into().ok()?),
        sequence: i64::from_le_bytes(body[8..16].try_into().ok()?),
        identity: body[16..32].try_into().ok()?,
    };
    Some((u64::from_le_bytes(body[..8].try_into().ok()?), state))
}

/// Returns the number and the content of the later valid slot.
fn latest_slot(bytes: &[u8]) -> Option<(u64, WatermarkState)> {
    [bytes, bytes.get(BLOCK..).unwrap_or_default()].into_iter().filter_map(decode).max_by_key(|(turn, _)| *turn)
}

impl Watermark {
    /// Minimum time between two syncs to the disk.
    const SYNC_INTERVAL: Duration = Duration::from_secs(1);

    /// Reads the mark at `path`.
    pub(super) fn read(path: &Path) -> io::Result<WatermarkFile> {
        let mut bytes = Vec::new();
        match File::open(path) {
            Ok(file) => file.take(2 * BLOCK as u64).read_to_end(&mut bytes)?,
            Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(WatermarkFile::Missing),
            Err(error) => return Err(error),
        };
        Ok(latest_slot(&bytes).map_or(WatermarkFile::Damaged, |(_, state)| WatermarkFile::Valid(state)))
    }

    /// Creates a mark at `path` and replaces an existing file. It is on the disk when this returns.
    pub(super) fn create(path: &Path, known: WatermarkState) -> io::Result<Self> {
        let mut new = path.to_owned().into_os_string();
        new.push(".new");
        let new = PathBuf::from(new);
        let mut blocks = vec![0; 2 * BLOCK];
        for (turn, block) in (1..).zip(blocks.chunks_mut(BLOCK)) {
            block[..SLOT_BYTES + CHECKSUM_BYTES].copy_from_slice(&encode(&known, turn));
        }
        let mut file = OpenOptions::new().create(true).truncate(true).write(true).open(&new)?;
        let put = (|| {
            file.write_all(&blocks)?;
            file.sync_all()?;
            fs::rename(&new, path)?;
            open_parent_folder(path)?.sync_all()
        })();
        if let Err(error) = put {
            // The file may not exist: its creation may have failed.
            let _ = fs::remove_file(&new);
            return Err(error);
        }
        Ok(Self {
            file,
            path: path.to_owned(),
            state: known,
            write_count: 2,
            last_sync: Instant::now(),
            is_current: true,
        })
    }

    pub(super) fn state(&self) -> &WatermarkState {
        &self.state
    }

    /// Notes that the records up to `sequence` are durable.
    pub(super) fn advance(&mut self, sequence: i64) {
        self.state.sequence = sequence;
        self.try_write();
        if self.last_sync.elapsed() >= Self::SYNC_INTERVAL {
            self.last_sync = Instant::now();
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
    fn try_write(&mut self) {
        let written = self.write();
        if let (Err(error), true) = (&written, self.is_current) {
            tracing::warn!(path = %self.path.display(), %error, "cannot write the log's mark: it is outdated");
        }
        self.is_current = written.is_ok();
    }

    fn write(&mut self) -> io::Result<()> {
        self.write_count += 1;
        let offset = if self.write_count % 2 == 1 { 0 } else { BLOCK as u64 };
        self.file.seek(SeekFrom::Start(offset))?;
        self.file.write_all(&encode(&self.state, self.write_count))
    }

    /// Reserves the incarnations up to this one, so that none of them is assigned again. The mark is on the disk when this returns.
    pub(super) fn reserve(&mut self, incarnation: u32) -> io::Result<()> {
        self.state.incarnation = incarnation;
        self.write()?;
        self.sync()
    }

    /// Syncs the mark to the disk.
    pub(super) fn sync(&mut self) -> io::Result<()> {
        self.last_sync = Instant::now();
        self.file.sync_data()
    }
}

/// Opens the folder that contains `path`.
fn open_parent_folder(path: &Path) -> io::Result<File> {
    let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty());
    File::open(folder.unwrap_or(Path::new(".")))
}

#[cfg(test)]
mod tests {
    use super::*;

    const STATE: WatermarkState = WatermarkState { identity: [7; 16], sequence: 5, incarnation: 3 };

    #[tokio::test]
    async fn mark_survives_one_lost_slot_and_is_at_most_one_batch_older() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("log-mark");
        assert_eq!(Watermark::read(&path).unwrap(), WatermarkFile::Missing);
        let mut mark = Watermark::create(&path, STATE).unwrap();
        for sequence in [8, 9] {
            mark.advance(sequence);
        }
        let whole = fs::read(&path).unwrap();
        assert_eq!(latest_slot(&whole), Some((4, WatermarkState { sequence: 9, ..STATE })));
        for bit in 0..8 * whole.len() {
            let mut flipped = whole.clone();
            flipped[bit / 8] ^= 1 << (bit % 8);
            let (_, state) = latest_slot(&flipped).expect("the other slot");
            assert!(
                matches!(state, WatermarkState { sequence: 8 | 9, identity: [7, ..], incarnation: 3 }),
                "bit {bit}"
            );
        }
        for length in 0..whole.len() {
            let found = latest_slot(&whole[..length]).map(|(_, known)| known.sequence);
            assert_eq!(found.is_some(), length >= SLOT_BYTES + CHECKSUM_BYTES, "{length}");
            assert!(
                found.is_none_or(|sequence| sequence == 8 || length >= BLOCK + SLOT_BYTES + CHECKSUM_BYTES),
                "{length}"
            );
        }
        fs::write(&path, b"").unwrap();
        assert_eq!(Watermark::read(&path).unwrap(), WatermarkFile::Damaged);
    }
}
