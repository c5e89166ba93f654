//! Light statistics of the samples that a task renders.
//!
//! Every sample is counted; the few that are chosen by their hash are recorded whole while they are rendered. The brightest and the deepest
//! are known only when all are done: they are traced again then, as any sample can be.
//!
//! What is chosen is a function of the settings: of all samples that a frame may have at the end of a round about twice as many records
//! as it keeps, but no more than one sample in 64, so that recording takes no more than some hundredths of the time, nor fewer than
//! 10,000, which take none worth speaking of. A task of a later round keeps a smaller share, and the least share holds for the frame.

use crate::render::{RenderError, RenderedTile, render_rows};
use crate::replay::{Replay, is_good};
use crate::settings::Settings;
use femc_film::Rect;
use femc_geometry::{Ray, offset_origin};
use femc_math::Rgb;
use femc_math::color::luminance;
use femc_math::hash::Begun;
use femc_montecarlo::record::{
    Contribution, Found as FoundBy, Leaving, Place, Recorder, Scatterer, Stop, Transmitted, Vertex,
};
use femc_paths::pixels::PixelSums;
use femc_paths::record::{MOST_INTERSECTIONS, MOST_LIGHTS, Names};
use femc_paths::statistics::DEEP;
use femc_paths::{
    Counters, End, Found, Interaction, Intersection, Kind, Light, Name, Path, PathKey, PortionKey, Scope, Statistics,
};
use femc_prepared::Prepared;
use femc_scene::{LampKind, ObjectId};
use std::cmp::Reverse;
use std::collections::BinaryHeap;
use std::ops::Range;
use std::sync::OnceLock;
use std::sync::atomic::{AtomicBool, AtomicU64};

/// Records that a frame keeps: 16 for each of the 5,000 of a representative set.
const KEEP: u32 = 16 * 5000;
/// Records of each sketch for each half of a tile.
const TOP: u32 = 16;
/// Records that are chosen for each one that is kept, if all tiles are rendered to the end of the round.
const SPARE: f64 = 2.0;
/// Most records that are chosen, as a share of all samples.
const MOST: f64 = 1.0 / 64.0;
/// Records that are chosen in any case.
const LEAST: f64 = 10_000.0;

/// What a frame's statistics are.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StatisticsPlan {
    /// What they are of.
    pub scope: Scope,
}

impl StatisticsPlan {
    /// Of a frame.
    /// - `edge`: width and height of its tiles, pixels.
    pub fn of(prepared: &Prepared, settings: &Settings, edge: u32) -> Self {
        let bounds = prepared.world.bounds();
        let (lower, upper) = rounded(prepared.in_world(bounds.min), prepared.in_world(bounds.max));
        let (film, frame) = (prepared.camera.film, prepared.frame);
        let (seed, is_full) = (settings.seed, settings.full_statistics);
        Self { scope: Scope { seed, frame, film, edge, lower, upper, keep: KEEP, top: TOP, is_full } }
    }

    /// Share of the samples whose paths are recorded by a task.
    fn share(&self, settings: &Settings, samples: &Range<u32>) -> f64 {
        let rounds = settings.rounds();
        let end = rounds.into_iter().find(|end| *end >= samples.end).unwrap_or(samples.end);
        let [width, height] = self.scope.film.map(f64::from);
        let all = width * height * f64::from(end.max(1));
        (SPARE * f64::from(self.scope.keep) / all).min(MOST).max(LEAST / all)
    }
}

/// A box made larger to a multiple of a sixteenth of its size, rounded to a power of two: the same for worlds that differ a little.
fn rounded(lower: [f64; 3], upper: [f64; 3]) -> ([f64; 3], [f64; 3]) {
    let size = (0..3).map(|axis| upper[axis] - lower[axis]).fold(0.0, f64::max);
    if !size.is_finite() || size <= 0.0 {
        return ([0.0; 3], [1.0; 3]);
    }
    let mut step = 1.0f64;
    while step * 16.0 < size {
        step *= 2.0;
    }
    while step * 8.0 >= size {
        step /= 2.0;
    }
    (lower.map(|x| (x / step).floor() * step), upper.map(|x| (x / step).ceil() * step))
}

/// Renders samples of a tile as [`render_tile`](crate::render_tile) does, to the bit, and says what is known of them.
pub fn render_with_statistics(
    prepared: &Prepared,
    settings: &Settings,
    plan: &StatisticsPlan,
    rect: Rect,
    samples: Range<u32>,
    cancel: &AtomicBool,
    progress: &AtomicU64,
) -> Result<(RenderedTile, Statistics), RenderError> {
    let names = SceneNames::new(prepared);
    let mut statistics = Statistics::new(plan.scope, plan.share(settings, &samples));
    // What is traced again is counted already.
    let again = Scope { is_full: false, ..plan.scope };
    let recorder = || PathRecorder::new(&names, statistics.threshold, plan.scope);
    let (rendered, heard) = render_rows(prepared, settings, rect, samples.clone(), cancel, progress, recorder)?;
    let mut all = Heard::new();
    heard.into_iter().for_each(|recorder| all.merge(recorder.heard));
    let corner = rect.y * plan.scope.film[0] + rect.x;
    let tile = plan.scope.tile_of(corner);
    for ((half, counters), pixels) in (0..).zip(all.counters).zip(all.pixels) {
        let portion = PortionKey { tile, half, begin: samples.start, end: samples.end };
        statistics.portions.insert(portion, Counters { pixels, ..counters });
    }
    let order = |path: Path| ((path.key.hash(plan.scope.seed), path.key), path);
    statistics.paths.extend(all.paths.drain(..).map(order));
    // Everything is wanted of what is traced again.
    let mut replay = Replay::recording(prepared, settings, PathRecorder::new(&names, u64::MAX, again));
    let [bright, deep] = [all.bright, all.deep].map(Tops::keys);
    let width = plan.scope.film[0];
    for key in bright.iter().chain(&deep) {
        let _ = replay.sample((key.pixel % width, key.pixel / width), key.sample);
    }
    let again = replay.into_recorder().heard;
    for path in again.paths {
        let (key, path) = order(path);
        if bright.contains(&path.key) {
            statistics.brightest.insert(key, path.clone());
        }
        if deep.contains(&path.key) {
            statistics.deepest.insert(key, path);
        }
    }
    statistics.names = all.names;
    statistics.names.extend(again.names);
    statistics.settle();
    Ok((rendered, statistics))
}

/// Keys of what a scene's parts are called, each made when it is first wanted.
struct SceneNames<'a> {
    prepared: &'a Prepared,
    objects: Vec<OnceLock<Name>>,
    materials: Vec<OnceLock<Name>>,
    media: Vec<OnceLock<Name>>,
    lamps: Vec<OnceLock<Name>>,
}

impl<'a> SceneNames<'a> {
    fn new(prepared: &'a Prepared) -> Self {
        let room = |count: usize| (0..count).map(|_| OnceLock::new()).collect();
        Self {
            prepared,
            objects: room(prepared.scene.objects.len()),
            materials: room(prepared.materials.len()),
            media: room(prepared.scene.media.len()),
            lamps: room(prepared.lights.len()),
        }
    }

    fn object(&self, object: Option<ObjectId>) -> Name {
        let Some(object) = object else { return Name::NONE };
        name(&self.objects, object.index(), || Name::of(Kind::Object, self.prepared.object_name(Some(object))))
    }

    fn material(&self, material: u32) -> Name {
        name(&self.materials, material as usize, || Name::of(Kind::Material, self.prepared.material_name(material)))
    }

    fn medium(&self, medium: u16) -> Name {
        name(&self.media, usize::from(medium), || Name::of(Kind::Medium, self.prepared.medium_name(medium)))
    }

    fn lamp(&self, light: u32) -> Name {
        name(&self.lamps, light as usize, || Name::of(Kind::Lamp, &self.lamp_text(light)))
    }

    /// The object that holds a lamp, and what emits: its material, or its file.
    fn lamp_text(&self, light: u32) -> String {
        let lamp = self.prepared.lamp_name(light);
        let kind = match lamp.kind {
            LampKind::Surface { material } => material,
            LampKind::Luminaire { path } => path,
            LampKind::Medium { medium } => medium,
        };
        format!("{}/{kind}", lamp.object)
    }
}

fn name(known: &[OnceLock<Name>], index: usize, make: impl FnOnce() -> Name) -> Name {
    known.get(index).map_or(Name::NONE, |name| *name.get_or_init(make))
}

/// What was heard of some samples.
struct Heard {
    counters: [Counters; 2],
    /// Of each half, in the order in which they were rendered: row by row.
    pixels: [Vec<PixelSums>; 2],
    paths: Vec<Path>,
    bright: Tops,
    deep: Tops,
    names: Names,
}

impl Heard {
    fn new() -> Self {
        Self {
            counters: Default::default(),
            pixels: Default::default(),
            paths: Vec::new(),
            bright: Tops::default(),
            deep: Tops::default(),
            names: Names::new(),
        }
    }

    fn merge(&mut self, other: Self) {
        for (mine, theirs) in self.counters.iter_mut().zip(&other.counters) {
            mine.merge_counts(theirs);
            mine.merge_bins(&theirs.bins);
        }
        self.pixels.iter_mut().zip(other.pixels).for_each(|(mine, theirs)| mine.extend(theirs));
        self.paths.extend(other.paths);
        self.bright.merge(other.bright);
        self.deep.merge(other.deep);
        self.names.extend(other.names);
    }
}

/// The keys of greatest rank of each half; of equal ranks those of least hash.
#[derive(Default)]
struct Tops([BinaryHeap<Reverse<Ranked>>; 2]);

/// The bits of a number that is not negative are in its order.
type Ranked = (u32, Reverse<(u64, PathKey)>);

impl Tops {
    #[inline]
    fn offer(&mut self, rank: f32, hash: u64, key: PathKey) {
        let half = &mut self.0[usize::from(key.half())];
        let ranked = (rank.to_bits(), Reverse((hash, key)));
        // Of equal ranks, like those of all samples that are black, few are of the least hashes.
        if half.len() < TOP as usize || half.peek().is_none_or(|Reverse(least)| ranked > *least) {
            Self::push(half, ranked);
        }
    }

    fn push(half: &mut BinaryHeap<Reverse<Ranked>>, ranked: Ranked) {
        half.push(Reverse(ranked));
        if half.len() > TOP as usize {
            half.pop();
        }
    }

    fn merge(&mut self, other: Self) {
        for (mine, theirs) in self.0.iter_mut().zip(other.0) {
            theirs.into_iter().for_each(|Reverse(ranked)| Self::push(mine, ranked));
        }
    }

    fn keys(self) -> std::collections::BTreeSet<PathKey> {
        self.0.into_iter().flatten().map(|Reverse((_, Reverse((_, key))))| key).collect()
    }
}

/// A lamp that was looked for: its contribution, the vertices until then, what hides it.
type Looked = (Contribution, usize, Option<Name>);

/// Hears of samples, and keeps what is wanted of them.
struct PathRecorder<'a> {
    names: &'a SceneNames<'a>,
    threshold: u64,
    scope: Scope,
    heard: Heard,
    // Of the sample that is being traced:
    key: PathKey,
    hash: u64,
    /// What the hashes of its pixel's samples begin with.
    pixel_hash: Begun,
    /// Whether its path is recorded.
    is_kept: bool,
    /// Whether all is heard of it: it is recorded, or all are counted.
    is_wanted: bool,
    /// The one of its pixel.
    latest: Option<u32>,
    depth: u32,
    stop: (Stop, Rgb),
    steps: Vec<(Vertex, Option<Leaving>)>,
    lights: Vec<Looked>,
    occluder: Option<Name>,
}

impl<'a> PathRecorder<'a> {
    fn new(names: &'a SceneNames<'a>, threshold: u64, scope: Scope) -> Self {
        Self {
            names,
            threshold,
            scope,
            heard: Heard::new(),
            key: PathKey::default(),
            hash: 0,
            pixel_hash: Begun::default(),
            is_kept: false,
            is_wanted: false,
            latest: None,
            depth: 0,
            stop: (Stop::Escaped, Rgb::ZERO),
            steps: Vec::new(),
            lights: Vec::new(),
            occluder: None,
        }
    }

    /// The object of the first thing on a shadow ray that lets nothing through.
    fn occluder(&self, mut ray: Ray) -> Option<Name> {
        let prepared = self.names.prepared;
        for _ in 0..CLEAR_SURFACES {
            let hit = prepared.world.intersect(&ray)?;
            let point = prepared.surface(&ray, &hit);
            let back = point.normal.dot(ray.dir) > 0.0;
            let crossing = prepared.materials[point.material as usize].crossing[usize::from(back)];
            if crossing.unbent() == Rgb::ZERO {
                return Some(self.names.object(prepared.object_of(hit.instance, hit.primitive)));
            }
            let origin = offset_origin(point.position, point.error, point.normal, ray.dir);
            ray = Ray { origin, t_max: ray.t_max - hit.t, ..ray };
        }
        None
    }

    fn path(&self, color: Rgb) -> Path {
        let (stop, throughput) = self.stop;
        let kept = self.steps.len().min(MOST_INTERSECTIONS);
        let mut intersections: Vec<Intersection> =
            self.steps[..kept].iter().map(|(vertex, leaving)| self.intersection(vertex, *leaving)).collect();
        for (index, (it, (vertex, leaving))) in intersections.iter_mut().zip(&self.steps).enumerate() {
            // Emission of the vertex itself is told of before the vertex is.
            let is_own = |light: &Looked| {
                let (found, vertices, _) = light;
                found.found == FoundBy::Met && *vertices == index && found.position == vertex.position
            };
            let later = self.lights.iter().filter(|light| light.1 > index || is_own(light));
            let sum = later.fold(Rgb::ZERO, |sum, (found, ..)| sum + found.color);
            it.radiance = ratio(sum, vertex.throughput);
            let ended = leaving.is_none();
            if ended && self.lights.iter().any(|light| is_own(light) && light.0.color != Rgb::ZERO) {
                it.interaction = Interaction::Emission;
            }
        }
        let lights = self.lights.iter().take(MOST_LIGHTS).map(|(found, vertices, occluder)| Light {
            vertex: *vertices as u32,
            light: match (found.found, found.light) {
                (FoundBy::Glow(medium), None) => self.names.medium(medium),
                (_, light) => light.map_or(Name::NONE, |light| self.names.lamp(light)),
            },
            radiance: found.color.to_array(),
            occluder: *occluder,
            found: match found.found {
                FoundBy::Sight => Found::Sight,
                FoundBy::Met => Found::Met,
                FoundBy::Surface => Found::Surface,
                FoundBy::Airlight(_) => Found::Airlight,
                FoundBy::Glow(_) => Found::Glow,
                FoundBy::Field => Found::Field,
            },
        });
        Path {
            key: self.key,
            radiance: color.to_array(),
            throughput: throughput.to_array(),
            depth: self.depth,
            end: end(stop),
            intersections,
            lights: lights.collect(),
        }
    }

    fn intersection(&self, vertex: &Vertex, leaving: Option<Leaving>) -> Intersection {
        let names = self.names;
        let (object, material) = match vertex.place {
            Place::Surface { instance, primitive, material } => {
                (names.object(names.prepared.object_of(instance, primitive)), names.material(material))
            }
            Place::Medium(medium) => (Name::NONE, names.medium(medium)),
        };
        let interaction = match leaving {
            None => Interaction::Absorbed,
            Some(Leaving::Straight) => Interaction::Straight,
            Some(Leaving::Delta(Transmitted::No)) => Interaction::Reflection,
            Some(Leaving::Delta(Transmitted::Yes)) => Interaction::Refraction,
            Some(Leaving::Scattered { by: Scatterer::Diffuse, .. }) => Interaction::Diffuse,
            Some(Leaving::Scattered { by: Scatterer::Glossy, .. }) => Interaction::Glossy,
            Some(Leaving::Scattered { by: Scatterer::Phase, .. }) => Interaction::Volume,
        };
        Intersection {
            bounce: vertex.bounce,
            position: names.prepared.in_world(vertex.position),
            radiance: [0.0; 3],
            throughput: vertex.throughput.to_array(),
            object,
            material,
            interaction,
        }
    }

    /// Keeps the texts of the names that a path has.
    fn keep_names(&mut self, path: &Path) {
        let prepared = self.names.prepared;
        let mut keep = |name: Name, kind: Kind, text: &dyn Fn() -> String| {
            if name != Name::NONE && !self.heard.names.contains_key(&name) {
                self.heard.names.insert(name, (kind, text()));
            }
        };
        for (it, (vertex, _)) in path.intersections.iter().zip(&self.steps) {
            match vertex.place {
                Place::Surface { instance, primitive, material } => {
                    let object = prepared.object_of(instance, primitive);
                    keep(it.object, Kind::Object, &|| prepared.object_name(object).to_owned());
                    keep(it.material, Kind::Material, &|| prepared.material_name(material).to_owned());
                }
                Place::Medium(medium) => {
                    keep(it.material, Kind::Medium, &|| prepared.medium_name(medium).to_owned());
                }
            }
        }
        for (it, (found, ..)) in path.lights.iter().zip(&self.lights) {
            match (found.found, found.light) {
                (FoundBy::Glow(medium), None) => {
                    keep(it.light, Kind::Medium, &|| prepared.medium_name(medium).to_owned());
                }
                (_, Some(light)) => keep(it.light, Kind::Lamp, &|| self.names.lamp_text(light)),
                (_, None) => {}
            }
            if let Some(occluder) = it.occluder {
                // Of a hidden lamp only the key was kept.
                let text = || {
                    let own = |object: &&femc_scene::Object| Name::of(Kind::Object, &object.name) == occluder;
                    prepared.scene.objects.iter().find(own).map(|object| object.name.clone()).unwrap_or_default()
                };
                keep(occluder, Kind::Object, &text);
            }
        }
    }
}

/// Clear surfaces that are looked through for what hides a lamp.
const CLEAR_SURFACES: usize = 256;

fn end(stop: Stop) -> End {
    match stop {
        Stop::Escaped => End::Escaped,
        Stop::Absorbed => End::Absorbed,
        Stop::Roulette => End::Roulette,
        Stop::Depth => End::Depth,
        Stop::Field => End::Field,
    }
}

/// A part of a sample without the factor that it came with; 0 where that is 0.
fn ratio(color: Rgb, throughput: Rgb) -> [f32; 3] {
    let parts = color.to_array().into_iter().zip(throughput.to_array());
    let mut ratios = parts.map(|(color, factor)| if factor > 0.0 { (color / factor).min(f32::MAX) } else { 0.0 });
    std::array::from_fn(|_| ratios.next().unwrap_or(0.0))
}

impl Recorder for PathRecorder<'_> {
    #[inline]
    fn begin(&mut self, pixel: u32, sample: u32) {
        self.key = PathKey { frame: self.scope.frame, pixel, sample };
        if self.latest != Some(pixel) {
            self.latest = Some(pixel);
            self.pixel_hash = self.key.pixel_hash(self.scope.seed);
            self.heard.pixels.iter_mut().for_each(|pixels| pixels.push(PixelSums::default()));
        }
        self.hash = self.key.hash_in_pixel(self.pixel_hash);
        self.is_kept = self.hash < self.threshold;
        self.is_wanted = self.is_kept || self.scope.is_full;
        self.depth = 0;
        self.steps.clear();
        self.lights.clear();
    }

    #[inline]
    fn vertex(&mut self, vertex: impl FnOnce() -> Vertex) {
        self.depth += 1;
        if self.is_wanted {
            self.steps.push((vertex(), None));
        }
    }

    #[inline]
    fn leave(&mut self, way: Leaving) {
        if !self.is_wanted {
            return;
        }
        if let Some(last) = self.steps.last_mut() {
            last.1 = Some(way);
        }
    }

    #[inline]
    fn hidden(&mut self, shadow: impl FnOnce() -> Ray) {
        if self.is_wanted {
            self.occluder = self.occluder(shadow());
        }
    }

    #[inline]
    fn light(&mut self, contribution: impl FnOnce() -> Contribution) {
        if self.is_wanted {
            let (contribution, occluder) = (contribution(), self.occluder.take());
            let is_lamp = contribution.light.is_some() && contribution.found == FoundBy::Surface;
            if contribution.color != Rgb::ZERO || is_lamp {
                self.lights.push((contribution, self.steps.len(), occluder));
            }
        }
    }

    #[inline]
    fn stop(&mut self, why: Stop, throughput: Rgb) {
        self.stop = (why, throughput);
    }

    #[inline]
    fn end(&mut self, color: Rgb) {
        let half = usize::from(self.key.half());
        let counters = &mut self.heard.counters[half];
        if !is_good(color) {
            counters.bad += 1;
            return;
        }
        let (stop, throughput) = self.stop;
        let luminance = luminance(color);
        counters.count(luminance, self.depth, end(stop));
        let greatest = throughput.max_element().max(0.0);
        if let Some(pixel) = self.heard.pixels[half].last_mut() {
            pixel.count(luminance, greatest, self.depth);
        }
        self.heard.bright.offer(luminance, self.hash, self.key);
        if self.depth >= DEEP {
            self.heard.deep.offer(greatest, self.hash, self.key);
        }
        if self.is_wanted {
            let path = self.path(color);
            if self.scope.is_full {
                self.heard.counters[half].count_bins(&self.scope, &path);
            }
            if self.is_kept {
                self.keep_names(&path);
                self.heard.paths.push(path);
            }
        }
    }
}
