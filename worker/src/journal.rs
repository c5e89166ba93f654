//! Journal of the tasks that a worker is computing. A task is entered before it begins. Entries that are still there at the next
//! start belong to tasks during which the worker died.
//!
//! The journal is one small file beside the outbox and shares the outbox's lock. Each change overwrites it from the start in one
//! write:
//!
//! | bytes | content |
//! | --- | --- |
//! | 8 | `FEMCWORK` |
//! | 4 | format version, 3 |
//! | 32 | BLAKE3 of the entries |
//! | 8 | length of the entries |
//! | | boot id of the machine, the worker's instance, and the leases of the tasks being computed, in postcard |
//!
//! The file is not synced: data that a process has written survive its death by any signal and by lack of memory. A machine that
//! loses power may leave the current page, an older one or a torn one. None of them blames a task, because the machine's boot id
//! has changed since, on systems that tell it (Linux). An orderly end and a request to stop empty the journal, so that no task is
//! blamed for them.

use std::fs::{File, OpenOptions};
use std::io::{self, Read as _, Seek as _, SeekFrom, Write as _};
use std::path::Path;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use femc_model::{Death, Digest, HeldLease, JobSpec};

use crate::task_table::Task;

const MAGIC: &[u8; 8] = b"FEMCWORK";
const VERSION: u32 = 3;
/// Bytes before the entries.
const HEADER_BYTES: usize = 8 + 4 + 32 + 8;

/// A worker's journal. Clones share it. The default is a file beside the outbox, if the outbox is a folder.
#[derive(Debug, Clone, Default)]
pub struct Journal(Arc<Mutex<JournalState>>);

#[derive(Debug, Default)]
struct JournalState {
    page: Page,
    /// Boot id of the machine, and the instance of the worker that writes.
    boot: String,
    instance: u64,
    computing: Vec<HeldLease>,
    /// Tasks that an earlier process left, until the coordinator knows them.
    previous_death: Option<Death>,
    /// Set when tasks are no longer entered.
    is_closed: bool,
    /// Set when an earlier process has died.
    is_careful: bool,
    /// Key of the latest job; computing it takes time.
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
    /// Name of the file.
    const FILE: &str = "computing";

    /// Creates a journal in memory that outlives its worker, for simulations: the next worker that starts with it finds the
    /// entries.
    pub fn in_memory() -> Self {
        Self(Arc::new(Mutex::new(JournalState { page: Page::Memory(Vec::new()), ..JournalState::default() })))
    }

    fn lock(&self) -> MutexGuard<'_, JournalState> {
        // A panic within the few lines under this lock is harmless: the page is written again.
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Opens the journal at the start of a worker and reads the entries of an earlier process.
    /// - `folder`: the outbox folder, which belongs to this worker alone.
    pub(crate) fn open(&self, folder: Option<&Path>, instance: u64) {
        self.open_with_boot_id(boot(), folder, instance);
    }

    fn open_with_boot_id(&self, boot: String, folder: Option<&Path>, instance: u64) {
        let mut book = self.lock();
        if let (Page::None, Some(folder)) = (&book.page, folder) {
            let path = folder.join(Self::FILE);
            match OpenOptions::new().read(true).write(true).create(true).truncate(false).open(&path) {
                Ok(file) => book.page = Page::File(file),
                Err(error) => {
                    tracing::warn!(file = %path.display(), %error, "cannot open the journal of running tasks");
                }
            }
        }
        let left = book.page.read().and_then(|bytes| decode(&bytes));
        // After a crash of the machine itself, no task is blamed here: the coordinator draws its own conclusions.
        let left = left.filter(|(of, _)| *of == boot).map(|(_, death)| death);
        book.previous_death = left.filter(|death| !death.computing.is_empty());
        if let Some(death) = &book.previous_death {
            tracing::warn!(
                tasks = death.computing.len(),
                "an earlier process of this worker died while it computed tasks"
            );
        }
        book.boot = boot;
        (book.instance, book.is_closed, book.is_careful) = (instance, false, book.previous_death.is_some());
        book.computing.clear();
    }

    /// Returns the tasks that an earlier process was computing when it died, until they are reported.
    pub(crate) fn death(&self) -> Option<Death> {
        self.lock().previous_death.clone()
    }

    /// Checks whether the worker computes only what its journal names. It does after the death of an earlier process, so that the
    /// journal names the task that kills the worker.
    pub(crate) fn is_careful(&self) -> bool {
        self.lock().is_careful
    }

    /// Records that the coordinator knows of the death.
    pub(crate) fn clear_death(&self) {
        let mut book = self.lock();
        if book.previous_death.take().is_some() {
            book.write();
        }
    }

    /// Enters a task that is about to be computed.
    pub(crate) fn begin(&self, task: &Task) {
        let mut book = self.lock();
        if book.is_closed || matches!(book.page, Page::None) {
            return;
        }
        let known = book.job.as_ref().filter(|(spec, _)| Arc::ptr_eq(spec, &task.spec)).map(|(_, key)| *key);
        let key = known.unwrap_or_else(|| task.spec.key());
        book.job = Some((task.spec.clone(), key));
        book.computing.push(task.lease_with_key(key));
        book.write();
    }

    /// Removes a task that is no longer computed.
    pub(crate) fn end(&self, task: &Task) {
        let mut book = self.lock();
        let (task, epoch) = task.key();
        let place = book.computing.iter().position(|lease| (lease.task, lease.epoch) == (task, epoch));
        if let Some(place) = place {
            book.computing.remove(place);
            book.write();
        }
    }

    /// Closes the journal when the worker is asked to stop or ends: from now on no task is blamed for the end of the process.
    pub(crate) fn close(&self) {
        let mut book = self.lock();
        book.is_closed = true;
        if !std::mem::take(&mut book.computing).is_empty() {
            book.write();
        }
    }
}

impl JournalState {
    fn write(&mut self) {
        let written = encode(&self.boot, self.instance, &self.computing).map_err(io::Error::other);
        if let Err(error) = written.and_then(|bytes| self.page.write(&bytes)) {
            tracing::warn!(%error, "cannot write the journal of running tasks");
            // Remove the older page, because it names the wrong tasks.
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
            // Abandon a file that can be neither written nor emptied.
            Self::File(file) => {
                if file.set_len(0).is_err() {
                    *self = Self::None;
                }
            }
        }
    }
}

/// Returns the boot id of this machine; empty if the system has none.
fn boot() -> String {
    let boot_id = std::fs::read_to_string("/proc/sys/kernel/random/boot_id").unwrap_or_default();
    boot_id.trim().to_owned()
}

fn encode(boot: &str, instance: u64, computing: &[HeldLease]) -> Result<Vec<u8>, postcard::Error> {
    let entries = postcard::to_stdvec(&(boot, instance, computing))?;
    let mut page = MAGIC.to_vec();
    page.extend(VERSION.to_le_bytes());
    page.extend(Digest::compute(&entries).as_bytes());
    page.extend((entries.len() as u64).to_le_bytes());
    page.extend(entries);
    Ok(page)
}

/// Decodes a page of [`encode`] and ignores bytes that follow it. Returns the boot id and the tasks; `None` for anything else.
fn decode(page: &[u8]) -> Option<(String, Death)> {
    let front = page.get(..HEADER_BYTES)?;
    if front[..8] != *MAGIC || front[8..12] != VERSION.to_le_bytes() {
        return None;
    }
    let length = usize::try_from(u64::from_le_bytes(front[44..].try_into().ok()?)).ok()?;
    let entries = page.get(HEADER_BYTES..HEADER_BYTES.checked_add(length)?)?;
    if Digest::compute(entries).as_bytes()[..] != front[12..44] {
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
    async fn journal_names_only_tasks_at_process_death_until_reported() {
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
        // Two processes die in a row, the second before it has reported the first death.
        assert_eq!(named(&open(8)), Some((7, vec![2])));
        let journal = open(9);
        assert_eq!(journal.death().map(|death| death.computing), Some(vec![second.lease()]));
        journal.clear_death();
        assert_eq!((named(&journal), named(&open(10))), (None, None));
        journal.begin(&first);
        journal.close();
        journal.begin(&second);
        assert_eq!(named(&open(11)), None, "asked to end, it is not killed by what it is at");
    }

    #[tokio::test]
    async fn tasks_computed_at_power_loss_are_not_blamed() {
        let place = tempfile::tempdir().unwrap();
        let open = |boot: &str, instance| {
            let journal = Journal::default();
            journal.open_with_boot_id(boot.into(), Some(place.path()), instance);
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
    async fn damaged_page_names_nothing_and_memory_page_outlives_worker() {
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
