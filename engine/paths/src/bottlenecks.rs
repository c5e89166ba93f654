//! Sources of noise and of long paths, by object, material and interaction, and by lamp.
//!
//! Each light contribution of a sample is attributed to the vertex that scattered it: the vertex from which the point on the lamp
//! was sampled, or, if the path hit the lamp, the last vertex before it that the path did not go straight through. The
//! contributions of a sample add up to the sample.
//!
//! The noise of a sample is the square of its excess over the mean of the other samples of its pixel. It is divided among the
//! contributions of the sample in proportion to their light. It is multiplied by the squared weight of the sample in its pixel and
//! divided by the squared mean of its block of 16 x 16 pixels, as in the relative error of a block.
//!
//! There are two kinds of samples ([`WeightedPath`]). The brightest samples of each portion are all known and count once. The other
//! samples are known through the fair subset, and each counts as the inverse of the subset's share. So a rare bright sample is
//! neither missed nor counted more often than once.
//!
//! Long paths are attributed to the first intersection of a path, which all paths through a pixel of that part share. The measure
//! is the throughput that is left when they reach intersection number [`DEEP_PATH_DEPTH`]. Later intersections say little, because
//! a longer path has more of them.

use crate::pixels::PixelMaps;
use crate::record::{
    InteractionKind, Intersection, LightPath, LightRecord, LightTechnique, Name, Names, PathKey, luminance,
};
use crate::statistics::{DEEP_PATH_DEPTH, IMAGE_BITS, LightStatistics, PortionKey, brightness};
use std::collections::BTreeMap;

/// Part of the scene that scattered light.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct ScenePart {
    /// Object. None for the camera, a medium, or an unnamed object.
    pub object: Name,
    /// Material or medium.
    pub material: Name,
    /// Interaction with which the path continued, or through which light arrived. `None`: any interaction, or the camera.
    pub interaction: Option<InteractionKind>,
}

impl ScenePart {
    fn from_intersection(it: &Intersection) -> Self {
        Self { object: it.object, material: it.material, interaction: Some(it.interaction) }
    }
}

/// Criterion that distinguishes parts.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Grouping {
    /// Object, material and interaction.
    Part,
    /// Object.
    Object,
    /// Material or medium.
    Material,
}

impl Grouping {
    fn group(self, part: ScenePart) -> ScenePart {
        match self {
            Self::Part => part,
            Self::Object => ScenePart { object: part.object, ..ScenePart::default() },
            Self::Material => ScenePart { material: part.material, ..ScenePart::default() },
        }
    }
}

/// Statistics of a part.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct PartStatistics {
    /// Intersections of recorded paths.
    pub records: u64,
    /// Estimated number of intersections of all samples.
    pub intersections: f64,
    /// Estimated throughput that arrives at the part at intersection number [`DEEP_PATH_DEPTH`] or later, summed over all samples.
    pub deep_throughput: f64,
    /// Number of recorded paths whose first intersection is this part. Intersections that a path goes straight through are skipped.
    pub first_hits: u64,
    /// Sum of the depths of those paths.
    pub depth_sum: u64,
    /// Sum of the throughputs with which those paths reach intersection number [`DEEP_PATH_DEPTH`].
    pub remaining_throughput: f64,
    /// Light in the image whose last scattering is at this part, cd/m2, summed over the pixels.
    pub light: f64,
    /// Noise of the image: relative variance of its blocks, summed over the blocks.
    pub noise: f64,
}

impl PartStatistics {
    /// Returns the mean depth of the paths that begin at the part.
    pub fn mean_depth(&self) -> f64 {
        self.depth_sum as f64 / self.first_hits.max(1) as f64
    }

    /// Returns the mean throughput of these paths at intersection number [`DEEP_PATH_DEPTH`].
    pub fn mean_remaining_throughput(&self) -> f64 {
        self.remaining_throughput / self.first_hits.max(1) as f64
    }

    fn merge(&mut self, other: &Self) {
        self.records += other.records;
        self.intersections += other.intersections;
        self.deep_throughput += other.deep_throughput;
        self.first_hits += other.first_hits;
        self.depth_sum += other.depth_sum;
        self.remaining_throughput += other.remaining_throughput;
        self.light += other.light;
        self.noise += other.noise;
    }

    /// Returns the totals of the paths that do not begin at the part `one`.
    #[must_use]
    fn without(&self, one: &Self) -> Self {
        Self {
            first_hits: self.first_hits.saturating_sub(one.first_hits),
            depth_sum: self.depth_sum.saturating_sub(one.depth_sum),
            remaining_throughput: (self.remaining_throughput - one.remaining_throughput).max(0.0),
            ..Self::default()
        }
    }
}

/// Statistics of a lamp.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct LampStatistics {
    /// Number of times that recorded paths sampled or hit the lamp.
    pub records: u64,
    /// Number of times that the lamp was occluded.
    pub occluded: u64,
    /// Light of the lamp in the image, cd/m2, summed over the pixels.
    pub light: f64,
    /// Noise caused by the lamp.
    pub noise: f64,
}

/// A bright sample.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Firefly {
    /// Key of the sample.
    pub key: PathKey,
    /// Luminance of the sample, cd/m2.
    pub luminance: f32,
    /// Mean of the other samples of the pixel, cd/m2.
    pub mean_of_others: f64,
    /// Contribution to the noise.
    pub noise: f64,
    /// Part that scattered the largest contribution of the sample.
    pub part: ScenePart,
    /// Lamp of the largest contribution.
    pub lamp: Name,
    /// Technique that found the largest contribution.
    pub technique: LightTechnique,
}

/// Sources of noise and long paths in one or more frames.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Bottlenecks {
    /// Totals over all parts.
    pub total: PartStatistics,
    /// Statistics by part, as distinguished by [`Grouping`].
    pub parts: BTreeMap<ScenePart, PartStatistics>,
    /// Statistics by lamp. The empty name is the first pass.
    pub lamps: BTreeMap<Name, LampStatistics>,
    /// Samples that add most to the noise, in descending order. Each has the index of its frame among the merged frames.
    pub fireflies: Vec<(usize, Firefly)>,
    /// Number of frames.
    pub frames: usize,
    /// Number of samples of all frames.
    pub samples: u64,
    /// Number of those samples whose paths are deep.
    pub deep_samples: u64,
    /// Names used here.
    pub names: Names,
}

/// A path with the number of samples that it represents.
#[derive(Clone, Copy, Debug)]
pub struct WeightedPath<'a> {
    /// The path.
    pub path: &'a LightPath,
    /// Number of samples.
    pub weight: f64,
}

/// Returns paths that represent all samples: all paths that are brighter than the dimmest of the brightest records of their
/// portion, and, of the rest, the paths chosen by hash.
pub fn weighted_paths(all: &LightStatistics) -> Vec<WeightedPath<'_>> {
    let top = all.scope.sketch_size as usize;
    // A portion that holds fewer bright records than it may holds all its samples there.
    let mut cuts: BTreeMap<PortionKey, (usize, f32)> = BTreeMap::new();
    for path in all.brightest.values() {
        if let Some(portion) = all.portion_of(path.key) {
            let (count, least) = cuts.entry(portion).or_insert((0, f32::INFINITY));
            (*count, *least) = (*count + 1, least.min(brightness(path)));
        }
    }
    let cut = |path: &LightPath| {
        let (count, least) =
            all.portion_of(path.key).and_then(|portion| cuts.get(&portion).copied()).unwrap_or_default();
        match (top, count < top) {
            (0, _) => f32::INFINITY,
            (_, true) => f32::NEG_INFINITY,
            _ => least,
        }
    };
    let bright = all.brightest.values().filter(|path| brightness(path) > cut(path));
    let others = all.paths.values().filter(|path| brightness(path) <= cut(path));
    let weight = 1.0 / all.share().max(f64::MIN_POSITIVE);
    let bright = bright.map(|path| WeightedPath { path, weight: 1.0 });
    bright.chain(others.map(|path| WeightedPath { path, weight })).collect()
}

/// Returns the part that scattered the light.
pub fn scattering_part(path: &LightPath, light: &LightRecord) -> ScenePart {
    let volume = |material| ScenePart { material, interaction: Some(InteractionKind::Volume), ..ScenePart::default() };
    let mut vertices = path.branch(light.vertex.min(path.intersections.len() as u32));
    let vertex = match light.technique {
        // Airlight was scattered on the segment after the vertex.
        LightTechnique::Airlight => return volume(light.medium),
        LightTechnique::Glow => return volume(light.light),
        LightTechnique::CameraNextEvent => None,
        LightTechnique::EmitterHit => vertices.find(|it| it.interaction != InteractionKind::Straight),
        LightTechnique::NextEvent | LightTechnique::Field => vertices.next(),
    };
    vertex.map(ScenePart::from_intersection).unwrap_or_default()
}

/// Maximum number of bright samples kept.
const MAX_FIREFLIES: usize = 1000;

impl Bottlenecks {
    /// Computes the statistics of a frame.
    pub fn from_statistics(all: &LightStatistics, grouping: Grouping) -> Self {
        let maps = PixelMaps::from_statistics(all);
        let mut found = Self { frames: 1, samples: all.samples(), names: all.names.clone(), ..Self::default() };
        found.deep_samples = all.totals().depth[DEEP_PATH_DEPTH as usize..].iter().sum();
        let weight = 1.0 / all.share().max(f64::MIN_POSITIVE);
        for path in all.paths.values() {
            found.count(path, weight, grouping);
        }
        let blocks = Blocks::from_maps(&maps);
        for WeightedPath { path, weight } in weighted_paths(all) {
            let (own, image) = (f64::from(path.luminance()), image_weight(all, path));
            let noise = blocks.noise(&maps, path, image);
            for light in &path.lights {
                let part = f64::from(luminance(light.radiance));
                let noise = if own > 0.0 { weight * noise * part / own } else { 0.0 };
                let light_of = weight * image * part;
                let evidence = found.parts.entry(grouping.group(scattering_part(path, light))).or_default();
                for it in [evidence, &mut found.total] {
                    it.light += light_of;
                    it.noise += noise;
                }
                let lamp = found.lamps.entry(light.light).or_default();
                lamp.light += light_of;
                lamp.noise += noise;
            }
        }
        found.fireflies = find_fireflies(all, &maps, &blocks, grouping).into_iter().map(|it| (0, it)).collect();
        found
    }

    /// Adds the intersections and lamps of a recorded path.
    fn count(&mut self, path: &LightPath, weight: f64, grouping: Grouping) {
        let greatest = |it: &Intersection| f64::from(it.throughput.into_iter().fold(0.0, f32::max));
        let mut add = |it: &Intersection, evidence: PartStatistics| {
            self.parts.entry(grouping.group(ScenePart::from_intersection(it))).or_default().merge(&evidence);
            self.total.merge(&evidence);
        };
        let levels = path.levels();
        for (&level, it) in levels.iter().zip(&path.intersections) {
            let deep = if level < DEEP_PATH_DEPTH { 0.0 } else { weight * greatest(it) };
            add(
                it,
                PartStatistics {
                    records: 1,
                    intersections: weight,
                    deep_throughput: deep,
                    ..PartStatistics::default()
                },
            );
        }
        if let Some(first) = path.intersections.iter().find(|it| it.interaction != InteractionKind::Straight) {
            // All branches together.
            let deep = levels.iter().zip(&path.intersections).filter(|(level, _)| **level == DEEP_PATH_DEPTH);
            let left = deep.map(|(_, it)| greatest(it)).sum();
            add(
                first,
                PartStatistics {
                    first_hits: 1,
                    depth_sum: path.depth.into(),
                    remaining_throughput: left,
                    ..PartStatistics::default()
                },
            );
        }
        for light in &path.lights {
            let lamp = self.lamps.entry(light.light).or_default();
            lamp.records += 1;
            lamp.occluded += u64::from(light.occluder.is_some());
        }
    }

    /// Adds the statistics of other frames.
    pub fn merge(&mut self, other: Self) {
        self.total.merge(&other.total);
        for (part, evidence) in &other.parts {
            self.parts.entry(*part).or_default().merge(evidence);
        }
        for (name, lamp) in other.lamps {
            let own = self.lamps.entry(name).or_default();
            own.records += lamp.records;
            own.occluded += lamp.occluded;
            own.light += lamp.light;
            own.noise += lamp.noise;
        }
        let later = other.fireflies.into_iter().map(|(frame, it)| (self.frames + frame, it));
        self.fireflies.extend(later);
        self.fireflies.sort_by(|a, b| b.1.noise.total_cmp(&a.1.noise));
        self.fireflies.truncate(MAX_FIREFLIES);
        self.frames += other.frames;
        self.samples += other.samples;
        self.deep_samples += other.deep_samples;
        self.names.extend(other.names);
    }

    /// Returns the parts sorted by `key`, in descending order.
    pub fn ranked(&self, key: impl Fn(&PartStatistics) -> f64) -> Vec<(ScenePart, PartStatistics)> {
        let mut all: Vec<(ScenePart, PartStatistics)> =
            self.parts.iter().map(|(part, evidence)| (*part, *evidence)).collect();
        all.sort_by(|a, b| key(&b.1).total_cmp(&key(&a.1)).then(a.0.cmp(&b.0)));
        all
    }

    /// Returns the totals of the paths that do not begin at a part.
    #[must_use]
    pub fn without_part(&self, part: &PartStatistics) -> PartStatistics {
        self.total.without(part)
    }

    /// Returns the part of the variance of the throughput at intersection number [`DEEP_PATH_DEPTH`] that lies between the paths
    /// that begin at a part and all other paths: p (1 - p) d^2, where p is the share of paths and d the difference of the means. It
    /// is 0 if the paths of the part have less throughput left.
    pub fn deep_throughput_variance(&self, part: &PartStatistics) -> f64 {
        let share = part.first_hits as f64 / self.total.first_hits.max(1) as f64;
        let more = (part.mean_remaining_throughput() - self.without_part(part).mean_remaining_throughput()).max(0.0);
        share * (1.0 - share) * more * more
    }

    /// Returns the text of a name, if it has one.
    pub fn name_text(&self, name: Name) -> Option<&str> {
        self.names.get(&name).map(|(_, text)| text.as_str())
    }
}

/// Edge of a block, pixels, as in the relative error.
const BLOCK: u32 = 16;

/// Blocks of the image that noise is relative to.
struct Blocks {
    columns: u32,
    width: u32,
    /// Square of the sum of the luminances of the block's pixels, (cd/m2)^2.
    squares: Vec<f64>,
}

impl Blocks {
    fn from_maps(maps: &PixelMaps) -> Self {
        let [width, height] = maps.film.map(|size| size.max(1));
        let columns = width.div_ceil(BLOCK);
        let mut blocks = Self { columns, width, squares: vec![0.0; (columns * height.div_ceil(BLOCK)) as usize] };
        for (number, pixel) in (0..).zip(maps.pixels()) {
            let block = blocks.block_index(number);
            blocks.squares[block] += pixel.luminance;
        }
        blocks.squares.iter_mut().for_each(|sum| *sum *= *sum);
        blocks
    }

    fn block_index(&self, pixel: u32) -> usize {
        let [x, y] = [pixel % self.width, pixel / self.width].map(|place| place / BLOCK);
        (y * self.columns + x) as usize
    }

    /// Returns the contribution of a sample to the relative variance of its block.
    /// - `image`: weight of the sample in its pixel.
    fn noise(&self, maps: &PixelMaps, path: &LightPath, image: f64) -> f64 {
        let own = path.luminance();
        let excess = maps.mean_of_others(path.key.pixel, own).map_or(0.0, |others| (f64::from(own) - others).max(0.0));
        let square = self.squares.get(self.block_index(path.key.pixel)).copied().unwrap_or(0.0);
        if square > 0.0 { (image * excess).powi(2) / square } else { 0.0 }
    }
}

fn image_weight(all: &LightStatistics, path: &LightPath) -> f64 {
    all.image_weight(path.key) as f64 / (1u64 << IMAGE_BITS) as f64
}

/// Returns the brightest samples, sorted by their noise in descending order.
fn find_fireflies(all: &LightStatistics, maps: &PixelMaps, blocks: &Blocks, grouping: Grouping) -> Vec<Firefly> {
    let one = |path: &LightPath| {
        let others = maps.mean_of_others(path.key.pixel, path.luminance())?;
        let light = path.lights.iter().max_by(|a, b| luminance(a.radiance).total_cmp(&luminance(b.radiance)))?;
        Some(Firefly {
            key: path.key,
            luminance: path.luminance(),
            mean_of_others: others,
            noise: blocks.noise(maps, path, image_weight(all, path)),
            part: grouping.group(scattering_part(path, light)),
            lamp: light.light,
            technique: light.technique,
        })
    };
    let mut found: Vec<Firefly> = all.brightest.values().filter_map(one).filter(|it| it.noise > 0.0).collect();
    found.sort_by(|a, b| b.noise.total_cmp(&a.noise).then(a.key.cmp(&b.key)));
    found.truncate(MAX_FIREFLIES);
    found
}
