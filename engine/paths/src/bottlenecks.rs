//! What makes an image noisy, and what makes its paths long, by object, material and interaction, and by lamp.
//!
//! A part of a sample is laid to the vertex whose scattering made it: the one that a point on a lamp was drawn from, or the latest that
//! the path had not gone straight through when it came to a lamp. So the parts of a sample add up to it, and the covariances of the parts
//! with the sample add up to its variance. Of a part c of a sample L the covariance is estimated by c (L - m), where m is the mean of the
//! pixel's other samples, which knows nothing of L; by the weight of the sample in its pixel, squared, it is what the part adds to the
//! variance of the image. It is below 0 where a part is missing when the rest is bright.
//!
//! Samples are of two kinds ([`Weighed`]): the brightest of each portion, which are all known and count once, and others, which are known
//! by the fair subset and count as many times as it is smaller. So a rare bright sample is neither missed nor counted for more than it is.

use crate::pixels::Maps;
use crate::record::{Found, Interaction, Kind, Light, Name, Names, Path, PathKey, luminance};
use crate::statistics::{DEEP, IMAGE_BITS, PortionKey, Statistics, brightness};
use std::collections::{BTreeMap, BTreeSet};

/// What light was scattered by.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Part {
    /// The object; none: the camera, a medium, or something without a name.
    pub object: Name,
    /// The material or the medium.
    pub material: Name,
    /// How the path went on, or how light came to it; `None`: any way, or the camera.
    pub interaction: Option<Interaction>,
}

/// What parts are told apart by.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum By {
    /// Object, material and interaction.
    Part,
    /// Object.
    Object,
    /// Material or medium.
    Material,
}

impl By {
    fn of(self, part: Part) -> Part {
        match self {
            Self::Part => part,
            Self::Object => Part { object: part.object, ..Part::default() },
            Self::Material => Part { material: part.material, ..Part::default() },
        }
    }
}

/// What is known of a part. Sums of shares of many frames are sums of these.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Evidence {
    /// Intersections of recorded paths.
    pub records: u64,
    /// Recorded paths that have come to it.
    pub paths: u64,
    /// Sum of their depths.
    pub depths: u64,
    /// Intersections of all samples, estimated.
    pub intersections: f64,
    /// Throughput that arrives at it at an intersection of number [`DEEP`] or later, of all samples, estimated.
    pub deep: f64,
    /// Light of the image that it has scattered last, cd/m2, summed over the pixels.
    pub light: f64,
    /// What it adds to the variance of the image, (cd/m2)^2, summed over the pixels.
    pub variance: f64,
}

impl Evidence {
    /// Mean depth of the paths that have come to it.
    pub fn depth(&self) -> f64 {
        self.depths as f64 / self.paths.max(1) as f64
    }

    fn merge(&mut self, other: &Self) {
        self.records += other.records;
        self.paths += other.paths;
        self.depths += other.depths;
        self.intersections += other.intersections;
        self.deep += other.deep;
        self.light += other.light;
        self.variance += other.variance;
    }
}

/// What is known of a lamp.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Lamp {
    /// How often recorded paths have looked for it or met it.
    pub records: u64,
    /// How often something was in between.
    pub hidden: u64,
    /// Light of the image that is from it, cd/m2, summed over the pixels.
    pub light: f64,
    /// What its light adds to the variance of the image, (cd/m2)^2, summed over the pixels.
    pub variance: f64,
}

/// A bright sample.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Firefly {
    /// Which.
    pub key: PathKey,
    /// cd/m2.
    pub luminance: f32,
    /// Mean of the pixel's other samples, cd/m2.
    pub others: f64,
    /// What it adds to the variance of the image, (cd/m2)^2.
    pub variance: f64,
    /// What has scattered most of it.
    pub part: Part,
    /// The lamp of that.
    pub lamp: Name,
    /// How that was found.
    pub found: Found,
}

/// All that is found of frames.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Bottlenecks {
    /// Of all together.
    pub total: Evidence,
    /// By what parts are told apart by.
    pub parts: BTreeMap<Part, Evidence>,
    /// By lamp; none: a first pass.
    pub lamps: BTreeMap<Name, Lamp>,
    /// Samples that add most to the variance, the most first, each with the number of its frame among those that were merged.
    pub fireflies: Vec<(usize, Firefly)>,
    /// Frames.
    pub frames: usize,
    /// Samples of all frames.
    pub samples: u64,
    /// Those of them whose paths are deep.
    pub deep_samples: u64,
    /// Names that all this has.
    pub names: Names,
}

/// A path, and the samples that it stands for.
#[derive(Clone, Copy, Debug)]
pub struct Weighed<'a> {
    /// The path.
    pub path: &'a Path,
    /// Samples.
    pub weight: f64,
}

/// Paths that stand for all samples: all that are brighter than the least bright one that its portion keeps, and of the others those
/// recorded by hash.
pub fn weighed(all: &Statistics) -> Vec<Weighed<'_>> {
    let top = all.scope.top as usize;
    // Of a portion that keeps fewer than it may, all samples are there.
    let mut cuts: BTreeMap<PortionKey, (usize, f32)> = BTreeMap::new();
    for path in all.brightest.values() {
        if let Some(portion) = all.portion_of(path.key) {
            let (count, least) = cuts.entry(portion).or_insert((0, f32::INFINITY));
            (*count, *least) = (*count + 1, least.min(brightness(path)));
        }
    }
    let cut = |path: &Path| {
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
    let bright = bright.map(|path| Weighed { path, weight: 1.0 });
    bright.chain(others.map(|path| Weighed { path, weight })).collect()
}

/// What has scattered the light.
pub fn scattered_by(path: &Path, light: &Light) -> Part {
    let volume = |material| Part { material, interaction: Some(Interaction::Volume), ..Part::default() };
    let vertices = &path.intersections[..path.intersections.len().min(light.vertex as usize)];
    let vertex = match light.found {
        // Of the segment after the vertex.
        Found::Airlight => return volume(Name::NONE),
        Found::Glow => return volume(light.light),
        Found::Sight => None,
        Found::Met => vertices.iter().rev().find(|it| it.interaction != Interaction::Straight),
        Found::Surface | Found::Field => vertices.last(),
    };
    let part =
        |it: &crate::Intersection| Part { object: it.object, material: it.material, interaction: Some(it.interaction) };
    vertex.map(part).unwrap_or_default()
}

/// Bright samples that are kept.
const FIREFLIES: usize = 1000;

impl Bottlenecks {
    /// Of a frame.
    pub fn of(all: &Statistics, by: By) -> Self {
        let maps = Maps::of(all);
        let mut found = Self { frames: 1, samples: all.samples(), names: all.names.clone(), ..Self::default() };
        found.deep_samples = all.totals().depth[DEEP as usize..].iter().sum();
        let weight = 1.0 / all.share().max(f64::MIN_POSITIVE);
        for path in all.paths.values() {
            found.count(path, weight, by);
        }
        for Weighed { path, weight } in weighed(all) {
            let image = all.image_weight(path.key) as f64 / (1u64 << IMAGE_BITS) as f64;
            let excess =
                maps.others(path.key.pixel, path.luminance()).map_or(0.0, |it| f64::from(path.luminance()) - it);
            for light in &path.lights {
                let part = f64::from(luminance(light.radiance));
                let (light_of, variance) = (weight * image * part, weight * image * image * part * excess);
                let evidence = found.parts.entry(by.of(scattered_by(path, light))).or_default();
                for it in [evidence, &mut found.total] {
                    it.light += light_of;
                    it.variance += variance;
                }
                let lamp = found.lamps.entry(light.light).or_default();
                lamp.light += light_of;
                lamp.variance += variance;
            }
        }
        found.fireflies = fireflies(all, &maps, by).into_iter().map(|it| (0, it)).collect();
        found
    }

    /// What a recorded path says of intersections and lamps.
    fn count(&mut self, path: &Path, weight: f64, by: By) {
        let mut met = BTreeSet::new();
        for (number, it) in (1..).zip(&path.intersections) {
            let key = by.of(Part { object: it.object, material: it.material, interaction: Some(it.interaction) });
            let first = met.insert(key);
            let deep = if number < DEEP { 0.0 } else { f64::from(it.throughput.into_iter().fold(0.0, f32::max)) };
            let evidence = Evidence {
                records: 1,
                paths: u64::from(first),
                depths: if first { u64::from(path.depth) } else { 0 },
                intersections: weight,
                deep: weight * deep,
                ..Evidence::default()
            };
            self.parts.entry(key).or_default().merge(&evidence);
            self.total.merge(&Evidence { paths: 0, depths: 0, ..evidence });
        }
        self.total.paths += 1;
        self.total.depths += u64::from(path.depth);
        for light in &path.lights {
            let lamp = self.lamps.entry(light.light).or_default();
            lamp.records += 1;
            lamp.hidden += u64::from(light.occluder.is_some());
        }
    }

    /// Adds what was found of other frames.
    pub fn merge(&mut self, other: Self) {
        self.total.merge(&other.total);
        for (part, evidence) in &other.parts {
            self.parts.entry(*part).or_default().merge(evidence);
        }
        for (name, lamp) in other.lamps {
            let own = self.lamps.entry(name).or_default();
            own.records += lamp.records;
            own.hidden += lamp.hidden;
            own.light += lamp.light;
            own.variance += lamp.variance;
        }
        let later = other.fireflies.into_iter().map(|(frame, it)| (self.frames + frame, it));
        self.fireflies.extend(later);
        self.fireflies.sort_by(|a, b| b.1.variance.total_cmp(&a.1.variance));
        self.fireflies.truncate(FIREFLIES);
        self.frames += other.frames;
        self.samples += other.samples;
        self.deep_samples += other.deep_samples;
        self.names.extend(other.names);
    }

    /// The parts by what `of` says of them, the most first.
    pub fn ranked(&self, of: impl Fn(&Evidence) -> f64) -> Vec<(Part, Evidence)> {
        let mut all: Vec<(Part, Evidence)> = self.parts.iter().map(|(part, evidence)| (*part, *evidence)).collect();
        all.sort_by(|a, b| of(&b.1).total_cmp(&of(&a.1)).then(a.0.cmp(&b.0)));
        all
    }

    /// Mean depth of the recorded paths that have not come to a part.
    pub fn depth_of_others(&self, of: &Evidence) -> f64 {
        let (paths, depths) =
            (self.total.paths - of.paths.min(self.total.paths), self.total.depths - of.depths.min(self.total.depths));
        depths as f64 / paths.max(1) as f64
    }

    /// The text of a name, if it has one.
    pub fn text(&self, name: Name) -> Option<&str> {
        self.names.get(&name).map(|(_, text)| text.as_str())
    }

    /// Whether a part is a medium.
    pub fn is_medium(&self, part: Part) -> bool {
        self.names.get(&part.material).is_some_and(|(kind, _)| *kind == Kind::Medium)
    }
}

/// The brightest samples, those that add most to the variance first.
fn fireflies(all: &Statistics, maps: &Maps, by: By) -> Vec<Firefly> {
    let one = |path: &Path| {
        let own = path.luminance();
        let others = maps.others(path.key.pixel, own)?;
        let light = path.lights.iter().max_by(|a, b| luminance(a.radiance).total_cmp(&luminance(b.radiance)))?;
        let image = all.image_weight(path.key) as f64 / (1u64 << IMAGE_BITS) as f64;
        let excess = (f64::from(own) - others).max(0.0);
        let part = by.of(scattered_by(path, light));
        let variance = image * image * f64::from(own) * excess;
        Some(Firefly { key: path.key, luminance: own, others, variance, part, lamp: light.light, found: light.found })
    };
    let mut found: Vec<Firefly> = all.brightest.values().filter_map(one).filter(|it| it.variance > 0.0).collect();
    found.sort_by(|a, b| b.variance.total_cmp(&a.variance).then(a.key.cmp(&b.key)));
    found.truncate(FIREFLIES);
    found
}
