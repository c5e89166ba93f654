//! What a worker is computing, written down before it begins: what is still there when it starts again has died with it.
//!
//! One small file beside the outbox, whose lock it shares, written in one go at its beginning:
//!
//! | bytes | what |
//! | --- | --- |
//! | 8 | `FEMCWORK` |
//! | 4 | format version, 3 |
//! | 32 | BLAKE3 of the entries |
//! | 8 | length of the entries |
//! | | which start of the machine it is, the process's number, and the leases of the tasks under way, in postcard |
//!
//! It is not synced: what a process has written outlives its death by whatever signal, and by lack of memory. A machine that
//! loses its power may leave the page whole, an older one or a torn one; none of them says anything, since no task has to do with
//! it: the machine has started again since, where the system tells that (Linux). An orderly end, and being asked to end, empties
//! it: what a worker is made to leave has not killed it.

use std::fs::{File, OpenOptions};
use std::io::{self, Read as _, Seek as _, SeekFrom, Write as _};
use std::path::Path;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use femc_model::{Death, Digest, HeldLease, JobSpec};

use crate::table::Task;

const MAGIC: &[u8; 8] = b"FEMCWORK";
const VERSION: u32 = 3;
/// Bytes before the entries.
const FRONT: usize = 8 + 4 + 32 + 8;

/// A worker's journal; clones are the same one. The default is a file beside the outbox, if there is one.
#[derive(Debug, Clone, Default)]
pub struct Journal(Arc<Mutex<Book>>);

#[derive(Debug, Default)]
struct Book {
    page: Page,
    /// The start of the machine, and the process that writes.
    boot: String,
    instance: u64,
    computing: Vec<HeldLease>,
    /// What an earlier process left, until it is told.
    before: Option<Death>,
    /// What is computed from now on is not written down.
    is_closed: bool,
    /// An earlier process has died.
    is_careful: bool,
    /// The latest job's key, which takes time to find.
    job: Option<(Arc<JobSpec>, Digest)>,
}

#[derive(Debug, Default)]
enum Page {
    #[default]
    None,
    File(File),
    Memory(Vec<u8>),
}

impl Journal {
    /// The name of the file.
    const FILE: &str = "computing";

    /// One that outlives its worker in memory, for simulations: a worker that starts with it finds what the one before has left.
    pub fn in_memory() -> Self {
        Self(Arc::new(Mutex::new(Book { page: Page::Memory(Vec::new()), ..Book::default() })))
    }

    fn lock(&self) -> MutexGuard<'_, Book> {
        // A panic within the few lines under this lock leaves a page that is written again.
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// A worker's process begins: reads what an earlier one has left.
    /// - `folder`: of the outbox, which is this worker's alone.
    pub(crate) fn open(&self, folder: Option<&Path>, instance: u64) {
        self.open_after(boot(), folder, instance);
    }

    fn open_after(&self, boot: String, folder: Option<&Path>, instance: u64) {
        let mut book = self.lock();
        if let (Page::None, Some(folder)) = (&book.page, folder) {
            let path = folder.join(Self::FILE);
            match OpenOptions::new().read(true).write(true).create(true).truncate(false).open(&path) {
                Ok(file) => book.page = Page::File(file),
                Err(error) => tracing::warn!(file = %path.display(), %error, "what it computes is not written down"),
            }
        }
        let left = book.page.read().and_then(|bytes| decode(&bytes));
        // What was under way when the machine itself went down has not ended it: the coordinator presumes what it may.
        let left = left.filter(|(of, _)| *of == boot).map(|(_, death)| death);
        book.before = left.filter(|death| !death.computing.is_empty());
        if let Some(death) = &book.before {
            tracing::warn!(tasks = death.computing.len(), "an earlier process of this worker died while it computed");
        }
        book.boot = boot;
        (book.instance, book.is_closed, book.is_careful) = (instance, false, book.before.is_some());
        book.computing.clear();
    }

    /// What an earlier process was computing when it died, until that is told.
    pub(crate) fn death(&self) -> Option<Death> {
        self.lock().before.clone()
    }

    /// Whether the worker does without what its journal does not name: an earlier process has died, and it is to show what of.
    pub(crate) fn is_careful(&self) -> bool {
        self.lock().is_careful
    }

    /// The coordinator has heard of it.
    pub(crate) fn death_reported(&self) {
        let mut book = self.lock();
        if book.before.take().is_some() {
            book.write();
        }
    }

    /// A task is about to be computed.
    pub(crate) fn begin(&self, task: &Task) {
        let mut book = self.lock();
        if book.is_closed || matches!(book.page, Page::None) {
            return;
        }
        let known = book.job.as_ref().filter(|(spec, _)| Arc::ptr_eq(spec, &task.spec)).map(|(_, key)| *key);
        let key = known.unwrap_or_else(|| task.spec.key());
        book.job = Some((task.spec.clone(), key));
        book.computing.push(task.lease_of(key));
        book.write();
    }

    /// It is not computed any more.
    pub(crate) fn end(&self, task: &Task) {
        let mut book = self.lock();
        let (task, epoch) = task.key();
        let place = book.computing.iter().position(|lease| (lease.task, lease.epoch) == (task, epoch));
        if let Some(place) = place {
            book.computing.remove(place);
            book.write();
        }
    }

    /// The worker is asked to end, or ends: nothing that it is at from now on is held against the tasks.
    pub(crate) fn close(&self) {
        let mut book = self.lock();
        book.is_closed = true;
        if !std::mem::take(&mut book.computing).is_empty() {
            book.write();
        }
    }
}

impl Book {
    fn write(&mut self) {
        let written = encode(&self.boot, self.instance, &self.computing).map_err(io::Error::other);
        if let Err(error) = written.and_then(|bytes| self.page.write(&bytes)) {
            tracing::warn!(%error, "what it computes is not written down");
            // An older page would name the wrong tasks.
            self.page.clear();
        }
    }
}

impl Page {
    fn read(&mut self) -> Option<Vec<u8>> {
        match self {
            Self::None => None,
            Self::Memory(bytes) => Some(bytes.clone()),
            Self::File(file) => {
                let mut bytes = Vec::new();
                file.seek(SeekFrom::Start(0)).ok()?;
                file.read_to_end(&mut bytes).ok()?;
                Some(bytes)
            }
        }
    }

    fn write(&mut self, page: &[u8]) -> io::Result<()> {
        match self {
            Self::None => Ok(()),
            Self::Memory(bytes) => {
                *bytes = page.to_vec();
                Ok(())
            }
            Self::File(file) => {
                file.seek(SeekFrom::Start(0))?;
                file.write_all(page)
            }
        }
    }

    fn clear(&mut self) {
        match self {
            Self::None => {}
            Self::Memory(bytes) => bytes.clear(),
            // One that can be neither written nor emptied is left behind.
            Self::File(file) => {
                if file.set_len(0).is_err() {
                    *self = Self::None;
                }
            }
        }
    }
}

/// Which start of this machine it is; nothing where the system does not tell.
fn boot() -> String {
    let boot_id = std::fs::read_to_string("/proc/sys/kernel/random/boot_id").unwrap_or_default();
    boot_id.trim().to_owned()
}

fn encode(boot: &str, instance: u64, computing: &[HeldLease]) -> Result<Vec<u8>, postcard::Error> {
    let entries = postcard::to_stdvec(&(boot, instance, computing))?;
    let mut page = MAGIC.to_vec();
    page.extend(VERSION.to_le_bytes());
    page.extend(Digest::of(&entries).as_bytes());
    page.extend((entries.len() as u64).to_le_bytes());
    page.extend(entries);
    Ok(page)
}

/// What [`encode`] wrote, whatever follows it, and in which start of the machine; `None` for anything else.
fn decode(page: &[u8]) -> Option<(String, Death)> {
    let front = page.get(..FRONT)?;
    if front[..8] != *MAGIC || front[8..12] != VERSION.to_le_bytes() {
        return None;
    }
    let length = usize::try_from(u64::from_le_bytes(front[44..].try_into().ok()?)).ok()?;
    let entries = page.get(FRONT..FRONT.checked_add(length)?)?;
    if Digest::of(entries).as_bytes()[..] != front[12..44] {
        return None;
    }
    let (boot, instance, computing) = postcard::from_bytes(entries).ok()?;
    Some((boot, Death { instance, computing }))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::outbox::tests::task;

    fn named(journal: &Journal) -> Option<(u64, Vec<u32>)> {
        let death = journal.death()?;
        Some((death.instance, death.computing.iter().map(|lease| lease.task.index).collect()))
    }

    #[tokio::test]
    async fn what_was_being_computed_when_the_process_died_is_named_until_it_is_told_and_nothing_else_is() {
        let place = tempfile::tempdir().unwrap();
        let open = |instance| {
            let journal = Journal::default();
            journal.open(Some(place.path()), instance);
            journal
        };
        let (first, second) = (task(1, b"first").await, task(2, b"second").await);
        let journal = open(7);
        assert_eq!(named(&journal), None);
        journal.begin(&first);
        journal.begin(&second);
        journal.end(&first);
        // It dies; the next one too, before it has told anybody.
        assert_eq!(named(&open(8)), Some((7, vec![2])));
        let journal = open(9);
        assert_eq!(journal.death().map(|death| death.computing), Some(vec![second.lease()]));
        journal.death_reported();
        assert_eq!((named(&journal), named(&open(10))), (None, None));
        journal.begin(&first);
        journal.close();
        journal.begin(&second);
        assert_eq!(named(&open(11)), None, "asked to end, it is not killed by what it is at");
    }

    #[tokio::test]
    async fn what_was_computed_when_the_machine_lost_its_power_has_not_killed_it() {
        let place = tempfile::tempdir().unwrap();
        let open = |boot: &str, instance| {
            let journal = Journal::default();
            journal.open_after(boot.into(), Some(place.path()), instance);
            journal
        };
        let first = task(1, b"first").await;
        open("monday", 7).begin(&first);
        let journal = open("tuesday", 8);
        assert_eq!((named(&journal), journal.is_careful()), (None, false));
        journal.begin(&first);
        assert_eq!(named(&open("tuesday", 9)), Some((8, vec![1])), "a process that dies alone is another matter");
    }

    #[tokio::test]
    async fn a_page_that_is_torn_or_changed_names_nothing_and_one_in_memory_outlives_its_worker() {
        let first = task(1, b"first").await;
        let page = encode("boot", 7, &[first.lease()]).unwrap();
        assert_eq!(decode(&page).map(|(boot, death)| (boot, death.instance)), Some(("boot".into(), 7)));
        assert!((0..page.len()).all(|end| decode(&page[..end]).is_none()));
        for place in 0..page.len() {
            let mut changed = page.clone();
            changed[place] ^= 4;
            assert_eq!(decode(&changed), None, "byte {place}");
        }
        let journal = Journal::in_memory();
        journal.open(None, 1);
        journal.begin(&first);
        journal.open(None, 2);
        assert_eq!(named(&journal), Some((1, vec![1])));
        let nowhere = Journal::default();
        nowhere.open(None, 1);
        nowhere.begin(&first);
        nowhere.open(None, 2);
        assert_eq!(named(&nowhere), None);
    }
}
