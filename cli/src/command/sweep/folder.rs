//! The folder of a sweep: what is there, what it is made from, and what was ordered and is not there yet.
//!
//! `sweep.json` says of every file which key it has, so that a frame is rendered once, whichever variants show it and
//! however often the sweep is extended. Files come first and what is said of them second: a file of which nothing is said is
//! fetched once more.

use super::work::{Planned, Work};
use crate::clock::{Clock, Moment};
use crate::command::render::{Beside, FoundBeside};
use crate::exit::{Failure, failed};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::fs;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};
use std::time::Duration;

/// Name of the file that tells what is there.
const MANIFEST: &str = "sweep.json";
/// It is written at most so often: with very many frames it is large.
const EVERY: Duration = Duration::from_secs(1);

/// A folder and what is known of it.
pub struct Folder {
    path: PathBuf,
    manifest: Manifest,
    by_key: BTreeMap<String, String>,
    saved: Moment,
    /// What each frame has beside it.
    beside: Beside,
}

#[derive(Default, Serialize, Deserialize)]
struct Manifest {
    /// The program's build of the engine.
    engine: String,
    /// Those of the latest run, in order.
    variants: Vec<Named>,
    /// Frames by their paths in this folder.
    files: BTreeMap<String, Shot>,
    /// Jobs whose frames are not all here yet, by variant.
    orders: BTreeMap<String, Order>,
}

#[derive(Serialize, Deserialize)]
struct Named {
    name: String,
    values: BTreeMap<String, String>,
}

/// A frame that is there.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Shot {
    /// What it is made from.
    pub key: String,
    /// Samples a pixel.
    pub spp: u32,
    /// Worst relative error of a block, where it is known.
    pub relative_error: Option<f64>,
    /// Seconds that workers spent on it.
    pub seconds: f64,
    /// Samples left out.
    pub bad_samples: u64,
    /// The file that it is the same as, if it was not rendered for this variant.
    pub same_as: Option<String>,
}

/// A job that was queued, or was about to be.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Order {
    /// Its frames.
    pub frames: Vec<u32>,
    /// Digest of all that decides its pixels.
    pub spec: String,
    /// What makes it a job of its own on a farm, however often it is submitted.
    pub ticket: String,
    /// Its number, once the farm has given it one.
    pub job: Option<u64>,
}

impl Folder {
    /// Open the folder, which need not be there.
    /// - `beside`: files without which a frame counts as missing.
    pub fn open(path: &Path, beside: Beside) -> Result<Self, Failure> {
        let file = path.join(MANIFEST);
        let manifest: Manifest = match fs::read(&file) {
            Ok(text) => serde_json::from_slice(&text).map_err(|e| {
                failed(format!("{}: {e}; it was not written by this program: move it away", file.display()))
            })?,
            Err(e) if e.kind() == ErrorKind::NotFound => Manifest::default(),
            Err(e) => return Err(failed(format!("{}: {e}", file.display()))),
        };
        let mut folder = Self { path: path.to_owned(), manifest, by_key: BTreeMap::new(), saved: Clock.now(), beside };
        folder.forget_what_is_gone();
        Ok(folder)
    }

    /// Only files that are there and whole count.
    fn forget_what_is_gone(&mut self) {
        let (path, beside) = (self.path.clone(), self.beside);
        self.manifest.files.retain(|name, _| {
            let path = path.join(name);
            beside.are_there(&path) && femc_film::exr::read_attributes(&path).is_ok()
        });
        let mut files: Vec<_> = self.manifest.files.iter().collect();
        // Of equal files the last one stands for all: one that was rendered rather than linked.
        files.sort_by_key(|(_, shot)| shot.same_as.is_none());
        self.by_key = files.into_iter().map(|(name, shot)| (shot.key.clone(), name.clone())).collect();
    }

    /// The path of a file in it.
    pub fn join(&self, name: &str) -> PathBuf {
        self.path.join(name)
    }

    /// The folder.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// What is said of a file.
    pub fn shot(&self, name: &str) -> Option<&Shot> {
        self.manifest.files.get(name)
    }

    /// The build of the engine that the folder's frames are of, if it is not this program's.
    pub fn other_engine(&self) -> Option<&str> {
        let engine = &*self.manifest.engine;
        (!self.manifest.files.is_empty() && engine != femc_worker::engine()).then_some(engine)
    }

    /// Whether the file `name` is there and has this key.
    pub fn has(&self, name: &str, key: &str) -> bool {
        self.shot(name).is_some_and(|shot| shot.key == key)
    }

    /// Whether some file has this key.
    pub fn knows(&self, key: &str) -> bool {
        self.by_key.contains_key(key)
    }

    /// Make `name` the same file as the one that has this key; nothing if there is none.
    pub fn link(&mut self, name: &str, key: &str) -> Result<(), Failure> {
        let Some(source) = self.by_key.get(key).cloned().filter(|source| source != name) else { return Ok(()) };
        let Some(shot) = self.manifest.files.get(&source).cloned() else { return Ok(()) };
        let (from, to) = (self.join(&source), self.join(name));
        for (from, to) in self.beside.files(&from).zip(self.beside.files(&to)) {
            same(&from, &to).map_err(|e| failed(format!("{}: {e}", to.display())))?;
        }
        same(&from, &to).map_err(|e| failed(format!("{}: {e}", to.display())))?;
        self.enter(name, Shot { same_as: Some(shot.same_as.unwrap_or(source)), ..shot });
        Ok(())
    }

    /// Write a finished frame, and what lies beside it.
    pub fn write(&mut self, name: &str, bytes: &[u8], beside: &FoundBeside, shot: Shot) -> Result<(), Failure> {
        beside.write(&self.join(name))?;
        femc_film::file::write_atomic(&self.join(name), bytes).map_err(failed)?;
        self.enter(name, shot);
        if Clock.since(self.saved) >= EVERY { self.save() } else { Ok(()) }
    }

    fn enter(&mut self, name: &str, shot: Shot) {
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
        self.by_key.entry(shot.key.clone()).or_insert_with(|| name.to_owned());
        self.manifest.files.insert(name.to_owned(), shot);
    }

    /// Remember the variants of this run.
    pub fn name(&mut self, work: &Work) {
        let values = |variant: &Planned| {
            work.axes.iter().zip(&variant.values).map(|(axis, value)| (axis.clone(), value.text.clone())).collect()
        };
        let named = |variant: &Planned| Named { name: variant.name.clone(), values: values(variant) };
        self.manifest.variants = work.variants.iter().map(named).collect();
        self.manifest.engine = femc_worker::engine().to_owned();
    }

    /// The job that a variant was ordered with.
    pub fn order(&self, variant: &str) -> Option<&Order> {
        self.manifest.orders.get(variant)
    }

    /// Remember an order.
    pub fn keep(&mut self, variant: &str, order: Order) {
        self.manifest.orders.insert(variant.to_owned(), order);
    }

    /// All frames are here: no order is open any more.
    pub fn settle(&mut self) {
        self.manifest.orders.clear();
    }

    /// Make all that is known durable.
    pub fn save(&mut self) -> Result<(), Failure> {
        self.saved = Clock.now();
        let text = serde_json::to_vec_pretty(&self.manifest).map_err(failed)?;
        femc_film::file::write_atomic(&self.join(MANIFEST), &text).map_err(failed)
    }
}

/// Makes `to` the same file as `from`: a hard link, a copy where there are none. A file that is there is replaced, never
/// written into: it may be another variant's, too.
fn same(from: &Path, to: &Path) -> std::io::Result<()> {
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
