//! Folder of a sweep: its frames, their keys, and open orders.
//!
//! `sweep.json` stores the key of every file, so that a frame is rendered only once, even if several variants show it or the sweep
//! is extended. A file is written before its entry in `sweep.json`. A file without an entry is fetched again.

use super::resolved::{PlannedVariant, ResolvedSweep};
use crate::clock::{Clock, Timestamp};
use crate::command::readings;
use crate::command::render::{SidecarKinds, Sidecars};
use crate::exit::{Failure, failed};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::fs;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};
use std::time::Duration;

/// Name of the manifest.
const MANIFEST: &str = "sweep.json";
/// Shortest interval between two writes of the manifest, which is large with very many frames.
const SAVE_INTERVAL: Duration = Duration::from_secs(1);

/// A folder and its manifest.
pub struct SweepFolder {
    path: PathBuf,
    manifest: Manifest,
    by_key: BTreeMap<String, String>,
    last_save: Timestamp,
    /// Files that each frame has beside it.
    sidecars: SidecarKinds,
}

#[derive(Default, Serialize, Deserialize)]
struct Manifest {
    /// Engine build of the program.
    engine: String,
    /// Variants of the latest run, in order.
    variants: Vec<NamedVariant>,
    /// Frames by their paths in this folder.
    files: BTreeMap<String, FrameEntry>,
    /// Jobs with frames that are not fetched yet, by variant.
    orders: BTreeMap<String, JobOrder>,
}

#[derive(Serialize, Deserialize)]
struct NamedVariant {
    name: String,
    values: BTreeMap<String, String>,
}

/// An existing frame.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct FrameEntry {
    /// Digest of the inputs of the frame.
    pub key: String,
    /// Samples per pixel.
    pub spp: u32,
    /// Worst relative error of a block, if known.
    pub relative_error: Option<f64>,
    /// Seconds that workers spent on the frame.
    pub seconds: f64,
    /// Number of samples left out.
    pub bad_samples: u64,
    /// File that it equals, if it was not rendered for this variant.
    pub same_as: Option<String>,
}

/// A job that was queued, or is about to be.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct JobOrder {
    /// Frames of the job.
    pub frames: Vec<u32>,
    /// Digest of everything that determines the job's pixels.
    pub spec: String,
    /// Unique ticket: submissions with it are one job, however often they are repeated.
    pub ticket: String,
    /// Number of the job, once the farm has assigned it.
    pub job: Option<u64>,
}

impl SweepFolder {
    /// Opens the folder, which need not exist.
    /// - `sidecars`: files without which a frame counts as missing.
    pub fn open(path: &Path, sidecars: SidecarKinds) -> Result<Self, Failure> {
        let file = path.join(MANIFEST);
        let manifest: Manifest = match fs::read(&file) {
            Ok(text) => serde_json::from_slice(&text).map_err(|e| {
                failed(format!("{}: {e}; this file was not written by femc: move it away", file.display()))
            })?,
            Err(e) if e.kind() == ErrorKind::NotFound => Manifest::default(),
            Err(e) => return Err(failed(format!("{}: {e}", file.display()))),
        };
        let mut folder =
            Self { path: path.to_owned(), manifest, by_key: BTreeMap::new(), last_save: Clock.now(), sidecars };
        folder.prune_missing();
        Ok(folder)
    }

    /// Removes entries whose files are missing or damaged.
    fn prune_missing(&mut self) {
        let (path, sidecars) = (self.path.clone(), self.sidecars);
        self.manifest.files.retain(|name, _| {
            let path = path.join(name);
            sidecars.all_exist(&path) && is_sound(&path)
        });
        let mut files: Vec<_> = self.manifest.files.iter().collect();
        // The last of several equal files represents them: a rendered one rather than a linked one.
        files.sort_by_key(|(_, shot)| shot.same_as.is_none());
        self.by_key = files.into_iter().map(|(name, shot)| (shot.key.clone(), name.clone())).collect();
    }

    /// Returns the path of a file in the folder.
    pub fn join(&self, name: &str) -> PathBuf {
        self.path.join(name)
    }

    /// Returns the path of the folder.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Returns the entry of a file.
    pub fn entry(&self, name: &str) -> Option<&FrameEntry> {
        self.manifest.files.get(name)
    }

    /// Returns the engine build of the folder's frames, if it is not this program's.
    pub fn other_engine(&self) -> Option<&str> {
        let engine = &*self.manifest.engine;
        (!self.manifest.files.is_empty() && engine != femc_worker::engine()).then_some(engine)
    }

    /// Returns whether the file `name` exists and has this key.
    pub fn has(&self, name: &str, key: &str) -> bool {
        self.entry(name).is_some_and(|shot| shot.key == key)
    }

    /// Returns whether some file has this key.
    pub fn has_key(&self, key: &str) -> bool {
        self.by_key.contains_key(key)
    }

    /// Links `name` to the file that has this key; does nothing if there is none.
    pub fn link(&mut self, name: &str, key: &str) -> Result<(), Failure> {
        let Some(source) = self.by_key.get(key).cloned().filter(|source| source != name) else { return Ok(()) };
        let Some(entry) = self.manifest.files.get(&source).cloned() else { return Ok(()) };
        let (from, to) = (self.join(&source), self.join(name));
        for (from, to) in self.sidecars.paths(&from).zip(self.sidecars.paths(&to)) {
            link_or_copy(&from, &to).map_err(|e| failed(format!("{}: {e}", to.display())))?;
        }
        link_or_copy(&from, &to).map_err(|e| failed(format!("{}: {e}", to.display())))?;
        self.insert_entry(name, FrameEntry { same_as: Some(entry.same_as.unwrap_or(source)), ..entry });
        Ok(())
    }

    /// Writes a finished frame and the files beside it.
    pub fn write(&mut self, name: &str, bytes: &[u8], sidecars: &Sidecars, entry: FrameEntry) -> Result<(), Failure> {
        sidecars.write(&self.join(name))?;
        femc_film::file::write_atomic(&self.join(name), bytes).map_err(failed)?;
        self.insert_entry(name, entry);
        if Clock.since(self.last_save) >= SAVE_INTERVAL { self.save() } else { Ok(()) }
    }

    fn insert_entry(&mut self, name: &str, entry: FrameEntry) {
        if let Some(old) = self.manifest.files.get(name)
            && self.by_key.get(&old.key).is_some_and(|file| file == name)
        {
            let key = old.key.clone();
            let other = self.manifest.files.iter().find(|(file, shot)| shot.key == key && *file != name);
            match other.map(|(file, _)| file.clone()) {
                Some(other) => self.by_key.insert(key, other),
                None => self.by_key.remove(&key),
            };
        }
        self.by_key.entry(entry.key.clone()).or_insert_with(|| name.to_owned());
        self.manifest.files.insert(name.to_owned(), entry);
    }

    /// Stores the variants of this run.
    pub fn set_variants(&mut self, sweep: &ResolvedSweep) {
        let values = |variant: &PlannedVariant| {
            sweep.axes.iter().zip(&variant.values).map(|(axis, value)| (axis.clone(), value.text.clone())).collect()
        };
        let named = |variant: &PlannedVariant| NamedVariant { name: variant.name.clone(), values: values(variant) };
        self.manifest.variants = sweep.variants.iter().map(named).collect();
        self.manifest.engine = femc_worker::engine().to_owned();
    }

    /// Returns the open order of a variant.
    pub fn order(&self, variant: &str) -> Option<&JobOrder> {
        self.manifest.orders.get(variant)
    }

    /// Stores an order.
    pub fn set_order(&mut self, variant: &str, order: JobOrder) {
        self.manifest.orders.insert(variant.to_owned(), order);
    }

    /// Removes all orders, after all frames have been fetched.
    pub fn clear_orders(&mut self) {
        self.manifest.orders.clear();
    }

    /// Writes the manifest to disk.
    pub fn save(&mut self) -> Result<(), Failure> {
        self.last_save = Clock.now();
        let text = serde_json::to_vec_pretty(&self.manifest).map_err(failed)?;
        femc_film::file::write_atomic(&self.join(MANIFEST), &text).map_err(failed)
    }
}

/// Returns whether a picture or a document of readings can be read.
fn is_sound(path: &Path) -> bool {
    if readings::is_document(path) {
        readings::read(path).is_ok()
    } else {
        femc_film::exr::read_attributes(path).is_ok()
    }
}

/// Makes `to` equal to `from`: a hard link, or a copy if links are not possible. An existing file is replaced and never overwritten
/// in place, because it may belong to another variant, too.
fn link_or_copy(from: &Path, to: &Path) -> std::io::Result<()> {
    if let Some(folder) = to.parent() {
        fs::create_dir_all(folder)?;
    }
    let temporary = to.with_extension("link.tmp");
    match fs::remove_file(&temporary) {
        Err(e) if e.kind() != ErrorKind::NotFound => return Err(e),
        _ => {}
    }
    if fs::hard_link(from, &temporary).is_err() {
        fs::copy(from, &temporary)?;
    }
    match fs::remove_file(to) {
        Err(e) if e.kind() != ErrorKind::NotFound => return Err(e),
        _ => {}
    }
    fs::rename(&temporary, to)
}
