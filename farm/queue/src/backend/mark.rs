//! How much a log must hold, in a small file beside it.
//!
//! SQLite takes the first damaged frame of its write-ahead log for the end of it: one bit, and all that was acknowledged
//! after it is gone without a word. So the number of the last durable record is kept elsewhere, too, with the highest
//! incarnation: written after a commit and before anybody hears of it. It is handed to the system, not to the disk, which
//! costs a few microseconds: a killed process loses nothing of it. Of a power cut it may be a second old; then it asks for
//! less than there is, never for more.
//!
//! Two slots are written in turn, so that one that is torn leaves the other.

use std::fs::{self, File, OpenOptions};
use std::io::{self, Read as _, Seek as _, SeekFrom, Write as _};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

/// Whose log, as it says in its header.
pub(super) type Identity = [u8; 16];

/// What a mark says.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Known {
    pub(super) identity: Identity,
    /// Number of a record that is durable, like all before it.
    pub(super) sequence: i64,
    /// The highest that was reserved.
    pub(super) incarnation: u32,
}

/// What lies in a mark's place.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Found {
    Nothing,
    /// Neither slot makes sense, which no crash leaves behind.
    Damaged,
    Mark(Known),
}

/// An open mark.
#[derive(Debug)]
pub(super) struct Mark {
    file: File,
    path: PathBuf,
    known: Known,
    /// Of the latest slot.
    turn: u64,
    synced: Instant,
    /// Whether the system took the latest.
    is_written: bool,
}

const MAGIC: &[u8; 8] = b"femcmark";
const VERSION: u32 = 1;
/// Bytes of a slot's content, and of its checksum.
const BODY: usize = 48;
const SUM: usize = 16;
/// Each slot is in a block of its own.
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

/// What the later of the sound slots says, and its turn.
fn latest(bytes: &[u8]) -> Option<(u64, Known)> {
    [bytes, bytes.get(BLOCK..).unwrap_or_default()].into_iter().filter_map(decode).max_by_key(|(turn, _)| *turn)
}

impl Mark {
    /// Between two writings to the disk.
    const SYNC: Duration = Duration::from_secs(1);

    /// What lies at `path`.
    pub(super) fn look(path: &Path) -> io::Result<Found> {
        let mut bytes = Vec::new();
        match File::open(path) {
            Ok(file) => file.take(2 * BLOCK as u64).read_to_end(&mut bytes)?,
            Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(Found::Nothing),
            Err(error) => return Err(error),
        };
        Ok(latest(&bytes).map_or(Found::Damaged, |(_, known)| Found::Mark(known)))
    }

    /// Puts a mark in place of whatever lies at `path`; it is on the disk when this returns.
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
            // There was nothing before it was made.
            let _ = fs::remove_file(&new);
            return Err(error);
        }
        Ok(Self { file, path: path.to_owned(), known, turn: 2, synced: Instant::now(), is_written: true })
    }

    pub(super) fn known(&self) -> &Known {
        &self.known
    }

    /// The records up to this one are durable.
    pub(super) fn note(&mut self, sequence: i64) {
        self.known.sequence = sequence;
        self.written();
        if self.synced.elapsed() >= Self::SYNC {
            self.synced = Instant::now();
            let (file, path) = (self.file.try_clone(), self.path.clone());
            // Whoever writes the log does not wait for it.
            tokio::task::spawn_blocking(move || {
                if let Err(error) = file.and_then(|file| file.sync_data()) {
                    tracing::warn!(path = %path.display(), %error, "the log's mark does not reach the disk");
                }
            });
        }
    }

    /// Writes the next slot. A mark that stays behind asks for too little: no reason to stop.
    fn written(&mut self) {
        let written = self.write();
        if let (Err(error), true) = (&written, self.is_written) {
            tracing::warn!(path = %self.path.display(), %error, "the log's mark stays behind");
        }
        self.is_written = written.is_ok();
    }

    fn write(&mut self) -> io::Result<()> {
        self.turn += 1;
        let place = if self.turn % 2 == 1 { 0 } else { BLOCK as u64 };
        self.file.seek(SeekFrom::Start(place))?;
        self.file.write_all(&encode(&self.known, self.turn))
    }

    /// Nobody is given an incarnation up to this one again: it is on the disk when this returns.
    pub(super) fn reserve(&mut self, incarnation: u32) -> io::Result<()> {
        self.known.incarnation = incarnation;
        self.write()?;
        self.sync()
    }

    /// Brings it to the disk.
    pub(super) fn sync(&mut self) -> io::Result<()> {
        self.synced = Instant::now();
        self.file.sync_data()
    }
}

/// The folder that a file is in.
fn folder(path: &Path) -> io::Result<File> {
    let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty());
    File::open(folder.unwrap_or(Path::new(".")))
}

#[cfg(test)]
mod tests {
    use super::*;

    const KNOWN: Known = Known { identity: [7; 16], sequence: 5, incarnation: 3 };

    #[tokio::test]
    async fn one_slot_of_two_is_enough_and_whichever_is_lost_the_other_asks_for_one_batch_less() {
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
