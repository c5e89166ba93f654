//! Cache of scenes that are read and frames that are ready to render. It keeps the few used last.
//!
//! The first thread that needs a frame prepares it, and the others wait. So a frame is prepared once, even if many threads and
//! workers share the cache. Failures are not cached.
//!
//! All keys are content hashes, so the variants of a sweep share what is equal between them. They read the scene once. If their
//! worlds are equal, they differ in the camera alone ([`femc_pipeline::prepare`]). Otherwise unchanged surfaces are taken over from
//! any other frame of any variant.
//!
//! The light of a first pass is fetched and read once for all frames and tiles of its world. Its key is the digest of its artifact.
//! While a first pass is solved in blocks, the solver states that the blocks start from are cached too, for one first pass at a
//! time.
//!
//! Scenes, frames and lights are limited by number (2, 3 and 2), because the size of a frame follows from its scene, and frames of
//! a scene share what does not change. The pieces that scenes are made of are limited by bytes, see [`PieceCache`].

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use femc_metrics::{Counter, Page};
use femc_model::{Artifact, Digest, Failure, JobSpec};
use femc_pipeline::{
    Field, FrameKey, FrameLight, Layer, LayerPlan, Prepared, RayState, SceneSource, Settings, Solution, TargetDocument,
};
use femc_proto::Client;
use femc_scene::Scene;

use crate::PieceCache;
use crate::bundle::fetch_bundle;
use crate::fetch::Fetcher;

/// Outputs of other tasks that a prepared frame depends on.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(crate) struct FrameInputs {
    /// Light of the first pass of the frame's world; `None` without a first pass.
    pub(crate) light: Option<Artifact>,
    /// Targets of its paths.
    pub(crate) targets: TargetSource,
}

/// Source of the targets of a frame's paths.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(crate) enum TargetSource {
    /// No paths are traced in the frame.
    #[default]
    None,
    /// The worker learns them when it prepares the frame, if its method has targets. Graphs of earlier versions have no task for it.
    Frame,
    /// Output of a learn task.
    Stored(Artifact),
}

/// A scene with the job's overrides applied.
#[derive(Debug)]
pub(crate) struct LoadedScene {
    source: SceneSource,
    pub(crate) settings: Settings,
    /// Content hash of the scene.
    pub(crate) digest: String,
    /// Frame keys computed so far, by frame.
    keys: Mutex<BTreeMap<u32, FrameKey>>,
}

impl LoadedScene {
    /// Returns the scene.
    pub(crate) fn scene(&self) -> &Scene {
        self.source.scene()
    }

    /// Returns the frame's key: the digests of what the frame is made from.
    pub(crate) fn frame_key(&self, frame: u32) -> Result<FrameKey, Failure> {
        if let Some(frame_key) = lock(&self.keys).get(&frame) {
            return Ok(*frame_key);
        }
        let frame_key = femc_pipeline::frame_key(&self.source, &self.settings, frame);
        let frame_key = frame_key.map_err(|error| Failure::Scene { message: error.to_string() })?;
        lock(&self.keys).insert(frame, frame_key);
        Ok(frame_key)
    }
}

/// Cache of scenes and prepared frames. Clones share it.
#[derive(Debug, Clone)]
pub struct Cache(Arc<CacheInner>);

#[derive(Debug)]
struct CacheInner {
    /// Scenes as the files describe them, without overrides.
    sources: LruCache<Digest, SceneSource>,
    /// Scenes with a job's overrides.
    scenes: LruCache<Digest, Arc<LoadedScene>>,
    /// Prepared frames.
    frames: LruCache<(FrameKey, FrameInputs), Arc<Prepared>>,
    /// Compiled layers of frames. The tiles of a frame share them.
    layers: LruCache<(FrameKey, Vec<Layer>), Arc<LayerPlan>>,
    /// Lights of first passes: `fields` for lamps of brightness 1, `frame_lights` for the brightness of the frames' lamps.
    fields: LruCache<Digest, Arc<Field>>,
    frame_lights: LruCache<(Digest, u32), FrameLight>,
    /// First passes that were solved before the job, by the keys of their tasks. A task takes its solution out.
    solved: Mutex<BTreeMap<Digest, Arc<Solution>>>,
    /// States of unfinished first passes before their rays, by their input artifacts.
    states_before_rays: LruCache<Digest, Arc<dyn RayState>>,
    pieces: PieceCache,
}

impl Default for Cache {
    fn default() -> Self {
        Self::new(Self::FRAMES)
    }
}

impl Cache {
    /// Largest number of scenes. Scenes are larger and rarer than frames.
    const SCENES: usize = 2;

    /// Default of the largest number of prepared frames; see [`Cache::new`].
    const FRAMES: usize = 3;

    /// Largest number of first-pass lights.
    const FIELDS: usize = 2;

    /// Creates a cache of at most `frames` prepared frames. Frames share what does not change between them.
    pub fn new(frames: usize) -> Self {
        Self::with_limits(frames, PieceCache::in_memory(PieceCache::DEFAULT_MEMORY_LIMIT))
    }

    /// Creates a cache with the default number of frames and the given scene pieces.
    pub fn with_pieces(pieces: PieceCache) -> Self {
        Self::with_limits(Self::FRAMES, pieces)
    }

    fn with_limits(frames: usize, pieces: PieceCache) -> Self {
        let [sources, frames] = [Self::SCENES, frames.max(1)];
        Self(Arc::new(CacheInner {
            sources: LruCache::new(sources),
            scenes: LruCache::new(Self::SCENES),
            frames: LruCache::new(frames),
            layers: LruCache::new(frames),
            fields: LruCache::new(Self::FIELDS),
            frame_lights: LruCache::new(Self::FIELDS),
            solved: Mutex::default(),
            states_before_rays: LruCache::new(1),
            pieces,
        }))
    }

    /// Drops all scenes, frames and lights. Values in use stay in memory until their users drop them.
    pub(crate) fn clear(&self) {
        self.0.sources.clear();
        self.0.scenes.clear();
        self.0.frames.clear();
        self.0.fields.clear();
        self.0.frame_lights.clear();
        self.drop_solver_states();
    }

    /// Drops the solver states of unfinished first passes.
    fn drop_solver_states(&self) {
        self.0.states_before_rays.clear();
    }

    /// Writes the hit and miss counts to the metrics page.
    pub(crate) fn write_metrics(&self, page: &mut Page) {
        let CacheInner { sources, scenes, frames, fields, pieces, .. } = &*self.0;
        let looks = [
            ("files", &sources.hits, &sources.misses),
            ("scenes", &scenes.hits, &scenes.misses),
            ("frames", &frames.hits, &frames.misses),
            ("first passes", &fields.hits, &fields.misses),
        ];
        let help = "Lookups in the caches of prepared data: scene files, scenes, frames, first passes.";
        let family = page.counter("femc_worker_cache_lookups_total", help);
        looks.into_iter().fold(family, |family, (cache, hits, misses)| {
            let family = family.labeled(&[("cache", cache), ("outcome", "hit")], hits.get() as f64);
            family.labeled(&[("cache", cache), ("outcome", "miss")], misses.get() as f64)
        });
        page.gauge("femc_worker_pieces_bytes", "Bytes of scene pieces in the cache.").count(pieces.bytes());
        let help = "Bytes of scene pieces that were not in the cache and were downloaded.";
        page.counter("femc_worker_pieces_fetched_bytes_total", help).count(pieces.fetched());
    }

    /// Returns the job's scene, read and with the job's overrides applied.
    pub(crate) fn scene(&self, spec: &JobSpec, client: &Client, fetch: &Fetcher) -> Result<Arc<LoadedScene>, Failure> {
        self.0.scenes.get_or(scene_key(spec), || self.load_scene(spec, client, fetch).map(Arc::new))
    }

    /// Returns the frame, ready to render.
    /// - `inputs`: the light of a first pass is required exactly if the job's method has one.
    pub(crate) fn frame(
        &self,
        spec: &JobSpec,
        frame: u32,
        inputs: FrameInputs,
        client: &Client,
        fetch: &Fetcher,
    ) -> Result<(Arc<LoadedScene>, Arc<Prepared>), Failure> {
        let loaded = self.scene(spec, client, fetch)?;
        if loaded.settings.method.has_first_pass() != inputs.light.is_some() {
            let message =
                "invalid job graph: it must have a first-pass stage if, and only if, the method has a first pass";
            return Err(Failure::Settings { message: message.into() });
        }
        let targets = if loaded.settings.method.has_targets() { inputs.targets } else { TargetSource::None };
        let inputs = FrameInputs { targets, ..inputs };
        self.prepared(loaded, frame, inputs, client, fetch)
    }

    /// Returns the frame, ready for all that does not depend on the light of a first pass.
    pub(crate) fn unlit_frame(
        &self,
        spec: &JobSpec,
        frame: u32,
        client: &Client,
        fetch: &Fetcher,
    ) -> Result<(Arc<LoadedScene>, Arc<Prepared>), Failure> {
        let loaded = self.scene(spec, client, fetch)?;
        let frame_key = loaded.frame_key(frame)?;
        match self.0.frames.latest(|(other, _)| *other == frame_key) {
            Some(prepared) => Ok((loaded, prepared)),
            None => self.prepared(loaded, frame, FrameInputs::default(), client, fetch),
        }
    }

    /// Returns the frame, ready for measurements, and its scene. It does not depend on the picture of the job.
    pub(crate) fn measured_frame(
        &self,
        spec: &JobSpec,
        frame: u32,
        client: &Client,
        fetch: &Fetcher,
    ) -> Result<(Arc<LoadedScene>, Arc<Prepared>), Failure> {
        let loaded = self.scene(spec, client, fetch)?;
        let scene_fault = |error: &dyn std::fmt::Display| Failure::Scene { message: error.to_string() };
        let settings = loaded.settings.of_measurement();
        let frame_key =
            femc_pipeline::frame_key(&loaded.source, &settings, frame).map_err(|error| scene_fault(&error))?;
        let prepared = self.0.frames.get_or((frame_key, FrameInputs::default()), || {
            let previous = self
                .0
                .frames
                .latest(|(other, _)| other.world == frame_key.world || other.static_digest == frame_key.static_digest);
            let made =
                fetch.prepare(|| femc_pipeline::prepare_world(&loaded.source, &settings, frame, previous.as_deref()));
            let mut prepared = made.map_err(|error| scene_fault(&error))?;
            prepared.set_field(None);
            Ok(Arc::new(prepared))
        })?;
        Ok((loaded, prepared))
    }

    /// Returns the compiled layers of a prepared frame; `None` if the job asks for no layers.
    pub(crate) fn layers(
        &self,
        loaded: &LoadedScene,
        frame: u32,
        prepared: &Prepared,
    ) -> Result<Option<Arc<LayerPlan>>, Failure> {
        if loaded.settings.layers.is_empty() {
            return Ok(None);
        }
        let key = (loaded.frame_key(frame)?, loaded.settings.layers.clone());
        let plan = self.0.layers.get_or(key, || {
            let plan = LayerPlan::new(prepared, &loaded.settings);
            plan.map(Arc::new).map_err(|error| Failure::Settings { message: error.to_string() })
        });
        plan.map(Some)
    }

    /// Returns the world that the first pass of a frame solves.
    pub(crate) fn world(
        &self,
        spec: &JobSpec,
        frame: u32,
        client: &Client,
        fetch: &Fetcher,
    ) -> Result<Arc<Prepared>, Failure> {
        let loaded = self.scene(spec, client, fetch)?;
        let frame_key = loaded.frame_key(frame)?;
        // No frame's world has this digest, so the key is free for the first pass's world.
        let key = FrameKey { world: frame_key.light, ..frame_key };
        self.0.frames.get_or((key, FrameInputs::default()), || {
            let previous = self.0.frames.latest(|(other, _)| other.static_digest == frame_key.static_digest);
            let world = fetch.prepare(|| {
                femc_pipeline::first_pass_world(&loaded.source, &loaded.settings, frame, previous.as_deref())
            });
            let mut world = world.map_err(|error| Failure::Scene { message: error.to_string() })?;
            world.set_field(None);
            Ok(Arc::new(world))
        })
    }

    fn prepared(
        &self,
        loaded: Arc<LoadedScene>,
        frame: u32,
        inputs: FrameInputs,
        client: &Client,
        fetch: &Fetcher,
    ) -> Result<(Arc<LoadedScene>, Arc<Prepared>), Failure> {
        let (frame_key, method) = (loaded.frame_key(frame)?, loaded.settings.method);
        let same_world = || self.0.frames.latest(|(other, _)| other.world == frame_key.world);
        let same_surfaces = || self.0.frames.latest(|(other, _)| other.static_digest == frame_key.static_digest);
        let prepared = self.0.frames.get_or((frame_key, inputs), || {
            let previous = same_world().or_else(same_surfaces);
            let prepared = fetch
                .prepare(|| femc_pipeline::prepare_world(&loaded.source, &loaded.settings, frame, previous.as_deref()));
            let mut prepared = prepared.map_err(|error| Failure::Scene { message: error.to_string() })?;
            prepared.set_field(None);
            if let Some(light) = inputs.light {
                let frame_light = self.frame_light(light, prepared.brightness, client, fetch)?;
                fetch
                    .prepare(|| femc_pipeline::attach_first_pass(&mut prepared, frame_light))
                    .map_err(|error| lost_input_failure(light, &error))?;
            }
            match inputs.targets {
                TargetSource::None => {}
                TargetSource::Frame => {
                    let learned = fetch.prepare(|| femc_pipeline::attach_learned_targets(&mut prepared, method));
                    learned.map_err(|error| Failure::Scene { message: error.to_string() })?;
                }
                TargetSource::Stored(targets) => {
                    let bytes = fetch.fetch_all(client, &[targets]).pop().unwrap_or(Err(Failure::Cancelled))?;
                    let attach = || {
                        let document = TargetDocument::decode(&bytes)?;
                        femc_pipeline::attach_targets(&mut prepared, &document)
                    };
                    fetch.prepare(attach).map_err(|error| lost_input_failure(targets, &error))?;
                }
            }
            Ok(Arc::new(prepared))
        })?;
        Ok((loaded, prepared))
    }

    /// Returns the light of a first pass, scaled to the brightness of the frame's lamps.
    fn frame_light(
        &self,
        light: Artifact,
        brightness: f32,
        client: &Client,
        fetch: &Fetcher,
    ) -> Result<FrameLight, Failure> {
        self.0.frame_lights.get_or((light.digest, brightness.to_bits()), || {
            let field = self.unit_field(light, client, fetch)?;
            Ok(fetch.prepare(|| FrameLight::new(field, brightness)))
        })
    }

    fn unit_field(&self, light: Artifact, client: &Client, fetch: &Fetcher) -> Result<Arc<Field>, Failure> {
        self.0.fields.get_or(light.digest, || {
            // The first pass is finished, so its solver states are no longer needed.
            self.drop_solver_states();
            let bytes = fetch.fetch_all(client, &[light]).pop().unwrap_or(Err(Failure::Cancelled))?;
            let (field, _) =
                fetch.prepare(|| Field::decode(&bytes)).map_err(|error| lost_input_failure(light, &error))?;
            Ok(Arc::new(field))
        })
    }

    /// Adds a first pass that was solved before its job, as by the pilot that chose the method. The worker's task uses it instead of
    /// solving the first pass again.
    /// - `key`: key of the task's content.
    pub fn insert_solution(&self, key: Digest, solution: Arc<Solution>) {
        self.0.solved.lock().unwrap_or_else(PoisonError::into_inner).insert(key, solution);
    }

    /// Takes out the first pass with this key.
    pub(crate) fn take_solution(&self, key: Digest) -> Option<Arc<Solution>> {
        self.0.solved.lock().unwrap_or_else(PoisonError::into_inner).remove(&key)
    }

    /// Caches the light of a first pass that this worker solved.
    pub(crate) fn insert_field(&self, digest: Digest, field: Arc<Field>) {
        self.drop_solver_states();
        // This cannot fail: the light is either cached already or inserted here.
        let _ = self.0.fields.slot(digest).get_or(|| Ok(field));
    }

    /// Returns the state of a first pass before its rays, by the artifacts that it is made of.
    pub(crate) fn state_before_rays(
        &self,
        artifacts: &[Artifact],
        make: impl FnOnce() -> Result<Arc<dyn RayState>, Failure>,
    ) -> Result<Arc<dyn RayState>, Failure> {
        self.0.states_before_rays.get_or(combined_digest(artifacts), make)
    }

    fn load_scene(&self, spec: &JobSpec, client: &Client, fetch: &Fetcher) -> Result<LoadedScene, Failure> {
        let unfit = |error: &dyn std::fmt::Display| Failure::Settings { message: error.to_string() };
        let settings: Settings = serde_json::from_str(&spec.settings).map_err(|error| unfit(&error))?;
        settings.check().map_err(|error| unfit(&error))?;
        let source = self.source(spec, client, fetch)?;
        let source = fetch.prepare(|| source.variant(&settings.overrides)).map_err(|error| unfit(&error))?;
        Ok(LoadedScene { digest: source.scene().digest().to_string(), source, settings, keys: Mutex::default() })
    }

    /// Returns the scene as its files describe it, without overrides.
    fn source(&self, spec: &JobSpec, client: &Client, fetch: &Fetcher) -> Result<SceneSource, Failure> {
        self.0.sources.get_or(files_key(spec), || {
            let bundle = fetch_bundle(&spec.bundle, client, fetch, &self.0.pieces)?;
            let loaded = fetch.prepare(|| femc_import::load_scene(&bundle, &spec.entry));
            let scene = loaded.map_err(|error| Failure::Scene { message: error.to_string() })?.scene;
            Ok(SceneSource::new(Arc::new(scene)))
        })
    }
}

#[cfg(test)]
impl Cache {
    /// Puts a scene that is not read yet into the cache.
    pub(crate) fn insert_unread_scene(&self) {
        self.0.scenes.slot(Digest::compute(b"scene"));
    }

    pub(crate) fn is_empty(&self) -> bool {
        lock(&self.0.frames.slots).is_empty() && lock(&self.0.scenes.slots).is_empty()
    }
}

/// Reports an unusable input, so that the farm computes it again.
fn lost_input_failure(input: Artifact, error: &dyn std::fmt::Display) -> Failure {
    Failure::LostInputs { digests: vec![input.digest], message: error.to_string() }
}

fn combined_digest(artifacts: &[Artifact]) -> Digest {
    Digest::compute(&artifacts.iter().flat_map(|artifact| *artifact.digest.as_bytes()).collect::<Vec<u8>>())
}

fn files_key(spec: &JobSpec) -> Digest {
    let mut bytes = spec.bundle.as_bytes().to_vec();
    bytes.extend(spec.entry.as_bytes());
    Digest::compute(&bytes)
}

fn scene_key(spec: &JobSpec) -> Digest {
    let mut bytes = files_key(spec).as_bytes().to_vec();
    bytes.extend(spec.settings.as_bytes());
    Digest::compute(&bytes)
}

/// A least-recently-used cache of a few values.
#[derive(Debug)]
struct LruCache<K, V> {
    capacity: usize,
    /// Slots in order of use; the last used is at the end.
    slots: Mutex<Vec<(K, Arc<Slot<V>>)>>,
    hits: Counter,
    misses: Counter,
}

/// A place for a value that one thread makes while others wait.
#[derive(Debug)]
struct Slot<V>(Mutex<Option<V>>);

impl<K: PartialEq, V: Clone> LruCache<K, V> {
    fn new(capacity: usize) -> Self {
        Self { capacity, slots: Mutex::default(), hits: Counter::default(), misses: Counter::default() }
    }

    /// Returns the value for `key`; makes it if it is missing.
    fn get_or(&self, key: K, make: impl FnOnce() -> Result<V, Failure>) -> Result<V, Failure> {
        let mut looks = &self.hits;
        let value = self.slot(key).get_or(|| {
            looks = &self.misses;
            make()
        });
        looks.add(1);
        value
    }

    fn slot(&self, key: K) -> Arc<Slot<V>> {
        let mut slots = lock(&self.slots);
        let slot = match slots.iter().position(|(known, _)| *known == key) {
            Some(place) => slots.remove(place).1,
            None => Arc::new(Slot(Mutex::default())),
        };
        slots.push((key, slot.clone()));
        if slots.len() > self.capacity {
            slots.remove(0);
        }
        slot
    }

    fn clear(&self) {
        lock(&self.slots).clear();
    }

    /// Returns the last used value whose key is `wanted`. Skips values that are still being made.
    fn latest(&self, wanted: impl Fn(&K) -> bool) -> Option<V> {
        let slots = lock(&self.slots);
        // `try_lock` skips a value that another thread is making instead of waiting for it.
        slots.iter().rev().filter(|(key, _)| wanted(key)).find_map(|(_, slot)| slot.0.try_lock().ok()?.clone())
    }
}

impl<V: Clone> Slot<V> {
    fn get_or(&self, make: impl FnOnce() -> Result<V, Failure>) -> Result<V, Failure> {
        let mut value = lock(&self.0);
        if value.is_none() {
            *value = Some(make()?);
        }
        // The value exists now: it was there or was just made.
        value.clone().ok_or(Failure::Cancelled)
    }
}

/// Locks `mutex`, even after a panic: a maker that panics leaves no value, and the next user makes it again.
fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_shelf_keeps_the_latest_and_makes_each_once() {
        let shelf: LruCache<u32, u32> = LruCache::new(2);
        let made = std::cell::Cell::new(0);
        let get = |key| {
            let make = || {
                made.set(made.get() + 1);
                Ok(key * 10)
            };
            shelf.slot(key).get_or(make)
        };
        assert_eq!([get(1), get(1), get(2), get(1), get(3)], [Ok(10), Ok(10), Ok(20), Ok(10), Ok(30)]);
        assert_eq!(made.get(), 3);
        assert_eq!((get(1), made.get()), (Ok(10), 3), "used lately");
        assert_eq!((get(2), made.get()), (Ok(20), 4), "put away for 3");
    }

    #[test]
    fn failure_is_not_cached_and_unfinished_value_is_not_awaited() {
        let shelf: LruCache<u32, u32> = LruCache::new(2);
        assert_eq!(shelf.slot(1).get_or(|| Err(Failure::Cancelled)), Err(Failure::Cancelled));
        let slot = shelf.slot(1);
        let inside = slot.get_or(|| {
            assert_eq!(shelf.latest(|_| true), None);
            Ok(7)
        });
        assert_eq!((inside, shelf.latest(|_| true)), (Ok(7), Some(7)));
    }
}
