//! Where the variance of a block of pixels comes from.
//!
//! A sample is a sum of contributions, each of an [`Origin`]. Of independent samples `x = sum over g of x_g` the variance is
//! `E[(x - m) x] = sum over g of E[(x - m) x_g]`: the covariances of the contributions with their sum are shares that add up to all.
//! (That the samples of a replicate are spread evenly is not looked at: what dominates a bad block are rare bright samples, to which
//! that does not matter.)

use crate::replay::{Counted, Replay};
use crate::settings::Settings;
use femc_film::Rect;
use femc_math::Rgb;
pub use femc_math::color::luminance;
use femc_montecarlo::record::{Contribution, Found, Leaving, Place, Recording, Step};
use femc_prepared::Prepared;
use femc_prepared::names::LampName;
use femc_scene::ObjectId;
use rayon::prelude::*;
use std::collections::BTreeMap;
use std::sync::atomic::{AtomicU64, Ordering};

/// How light came into a sample.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum How {
    /// A point on the lamp was drawn from the camera.
    Sight,
    /// The camera's ray has met the lamp.
    Seen,
    /// The path has met the lamp behind a mirror or bending glass.
    Mirrored,
    /// The path has met the lamp after it was scattered.
    Scattered,
    /// A point on the lamp was drawn from a surface.
    Surface,
    /// A point on the lamp, and a distance by what a medium on the segment scatters of its light.
    Airlight,
    /// A medium glows.
    Glow,
    /// From the first pass, with the method `fem`.
    Field,
}

/// What light was scattered by last.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum On {
    /// Nothing: it comes straight to the camera.
    Camera,
    /// A surface.
    Surface {
        /// The innermost object that holds it.
        object: Option<ObjectId>,
        /// Index of its material.
        material: u32,
    },
    /// A medium, by its index.
    Medium(u16),
}

/// Where a contribution comes from.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Origin {
    /// Segment of the path, 0: the camera's.
    pub bounce: u32,
    /// How it came in.
    pub how: How,
    /// Whether a first pass has drawn a direction of the path until then.
    pub guided: bool,
    /// What it was scattered by.
    pub on: On,
    /// The lamp, by its place in [`Lamps::names`]; `None`: a medium.
    pub lamp: Option<u32>,
}

/// The lamps of a frame: lights of one kind in one object are one lamp.
pub struct Lamps {
    /// Their names; the place is that of the first.
    pub names: Vec<LampName>,
    of_light: Vec<u32>,
}

impl Lamps {
    /// Of all lights of a frame.
    pub fn new(prepared: &Prepared) -> Self {
        let (mut known, mut names) = (BTreeMap::new(), Vec::<LampName>::new());
        let lights = 0..prepared.lights.len() as u32;
        let of_light = lights.map(|light| {
            let name = prepared.lamp_name(light);
            *known.entry((name.kind.clone(), name.object.clone())).or_insert_with(|| {
                names.push(name);
                names.len() as u32 - 1
            })
        });
        let of_light = of_light.collect();
        Self { names, of_light }
    }
}

impl Origin {
    /// Of a contribution to a sample; `vertices`: of the path until then.
    pub fn of(prepared: &Prepared, lamps: &Lamps, recording: &Recording, it: &Contribution, vertices: usize) -> Self {
        let source = recording.source(vertices);
        let before = source.map_or(On::Camera, |step| on(prepared, step.vertex.place));
        let (how, on) = match it.found {
            Found::Sight => (How::Sight, On::Camera),
            Found::Met => match source.map(|step| step.leaving) {
                None => (How::Seen, On::Camera),
                Some(Some(Leaving::Delta(_))) => (How::Mirrored, before),
                Some(_) => (How::Scattered, before),
            },
            Found::Surface => (How::Surface, before),
            Found::Airlight(medium) => (How::Airlight, On::Medium(medium)),
            Found::Glow(medium) => (How::Glow, On::Medium(medium)),
            Found::Field => (How::Field, before),
        };
        let lamp = it.light.and_then(|light| lamps.of_light.get(light as usize).copied());
        let guided = |step: &Step| matches!(step.leaving, Some(Leaving::Scattered { by_guide: true, .. }));
        // How the path goes on from where a lamp was drawn changes nothing of that.
        let left = vertices.saturating_sub(usize::from(matches!(it.found, Found::Surface | Found::Field)));
        let guided = recording.steps[..left].iter().any(guided);
        Self { bounce: it.bounce, how, guided, on, lamp }
    }
}

/// What a place of a path is to an account.
pub fn on(prepared: &Prepared, place: Place) -> On {
    match place {
        Place::Surface { instance, primitive, material } => {
            On::Surface { object: prepared.object_of(instance, primitive), material }
        }
        Place::Medium(medium) => On::Medium(medium),
    }
}

/// A pixel as its file has it.
#[derive(Clone, Copy, Debug)]
pub struct Expected {
    /// Samples that its mean is of.
    pub samples: u32,
    /// The mean, cd/m2.
    pub color: [f32; 3],
}

/// The brightest contribution of an origin.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Brightest {
    /// Column and row of the pixel.
    pub pixel: (u32, u32),
    /// Number of the sample.
    pub sample: u32,
    /// Its luminance, cd/m2.
    pub luminance: f64,
    /// Mean luminance of the pixel's samples, cd/m2.
    pub mean: f64,
}

/// What comes from one origin.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Part {
    /// Part of the variance of the block's mean luminance, cd2/m4; below 0 where it is dark when the rest is bright.
    pub variance: f64,
    /// Part of the mean luminance, cd/m2.
    pub mean: f64,
    /// Its brightest contribution.
    pub brightest: Brightest,
}

/// The account of some pixels.
#[derive(Clone, Debug, Default)]
pub struct Account {
    /// By origin.
    pub parts: BTreeMap<Origin, Part>,
    /// Variance of the pixels' means, each by its place: what they add to that of the block's mean, cd2/m4.
    pub pixels: Vec<((u32, u32), f64)>,
    /// Samples that were traced.
    pub samples: u64,
    /// Pixels whose replayed mean is not that of the file: it does not say which samples it counts.
    pub unlike: u64,
}

impl Account {
    /// Traces the samples of the pixels of `rect` again.
    /// - `expected`: the pixel of a place as its file has it;
    /// - `progress`: counts samples.
    pub fn of(
        prepared: &Prepared,
        settings: &Settings,
        lamps: &Lamps,
        rect: Rect,
        expected: impl Fn((u32, u32)) -> Expected + Sync,
        progress: &AtomicU64,
    ) -> Self {
        let pixels: Vec<(u32, u32)> = rect.pixels().collect();
        let accounts: Vec<Self> = pixels
            .par_iter()
            .map(|&pixel| {
                let replayed = Replayed::new(prepared, settings, lamps, pixel, expected(pixel), progress);
                replayed.account(pixels.len() as f64)
            })
            .collect();
        let mut whole = Self::default();
        accounts.into_iter().for_each(|account| whole.join(account));
        whole
    }

    /// Adds an account of other pixels of the same block, or of another block.
    pub fn join(&mut self, other: Self) {
        for (origin, part) in other.parts {
            let both = |mine: &mut Part| {
                mine.variance += part.variance;
                mine.mean += part.mean;
                if part.brightest.luminance > mine.brightest.luminance {
                    mine.brightest = part.brightest;
                }
            };
            self.parts.entry(origin).and_modify(both).or_insert(part);
        }
        self.pixels.extend(other.pixels);
        self.samples += other.samples;
        self.unlike += other.unlike;
    }

    /// Variance of the block's mean luminance, cd2/m4, by the spread of the samples.
    pub fn variance(&self) -> f64 {
        self.pixels.iter().map(|(_, variance)| variance).sum()
    }

    /// The same with all variances multiplied: to add up blocks of different brightness.
    #[must_use]
    pub fn scaled(mut self, factor: f64) -> Self {
        self.parts.values_mut().for_each(|part| part.variance *= factor);
        self.pixels.iter_mut().for_each(|(_, variance)| *variance *= factor);
        self
    }
}

/// The samples of one pixel.
struct Replayed {
    pixel: (u32, u32),
    counted: Counted,
    is_like: bool,
    colors: Vec<Option<Rgb>>,
    /// Sample, origin and luminance of each contribution.
    parts: Vec<(u32, Origin, f64)>,
}

impl Replayed {
    fn new(
        prepared: &Prepared,
        settings: &Settings,
        lamps: &Lamps,
        pixel: (u32, u32),
        expected: Expected,
        progress: &AtomicU64,
    ) -> Self {
        let candidates = Counted::candidates(settings, expected.samples);
        let first = Counted::first(expected.samples);
        let ends = candidates.iter().chain([&first]).map(|counted| counted.range().end);
        let (mut colors, mut parts) = (Vec::new(), Vec::new());
        let mut replay = Replay::new(prepared, settings);
        for sample in 0..ends.max().unwrap_or(0) {
            let (color, recording) = replay.sample(pixel, sample);
            colors.push(color);
            for (contribution, vertices) in &recording.contributions {
                let origin = Origin::of(prepared, lamps, recording, contribution, *vertices);
                parts.push((sample, origin, f64::from(luminance(contribution.color))));
            }
        }
        progress.fetch_add(colors.len() as u64, Ordering::Relaxed);
        let likely = candidates.into_iter().find(|counted| is_like(counted.mean(&colors), expected.color));
        Self { pixel, counted: likely.unwrap_or(first), is_like: likely.is_some(), colors, parts }
    }

    /// - `area`: pixels of the block.
    fn account(&self, area: f64) -> Account {
        // Of a sample that counts.
        let color = |sample: u32| self.colors[sample as usize].filter(|_| self.counted.has(sample));
        let counted = (0..self.colors.len() as u32).filter_map(color);
        let values: Vec<f64> = counted.map(|color| f64::from(luminance(color))).collect();
        let n = values.len() as f64;
        let mean = values.iter().sum::<f64>() / n.max(1.0);
        let factor = self.counted.variance_factor() / (n - 1.0).max(1.0) / (area * area);
        let mut parts = BTreeMap::<Origin, Part>::new();
        for &(sample, origin, luminance) in &self.parts {
            let Some(color) = color(sample) else { continue };
            let all = f64::from(femc_math::color::luminance(color));
            let brightest = Brightest { pixel: self.pixel, sample, luminance, mean };
            let part = parts.entry(origin).or_insert(Part { variance: 0.0, mean: 0.0, brightest });
            part.variance += factor * (all - mean) * luminance;
            part.mean += luminance / (n * area);
            if luminance > part.brightest.luminance {
                part.brightest = brightest;
            }
        }
        let variance = factor * values.iter().map(|value| (value - mean).powi(2)).sum::<f64>();
        Account {
            parts,
            pixels: vec![(self.pixel, variance)],
            samples: self.colors.len() as u64,
            unlike: u64::from(!self.is_like),
        }
    }
}

/// Whether two colors are the same up to the rounding of sums.
fn is_like(a: Rgb, b: [f32; 3]) -> bool {
    let b = Rgb::from_array(b);
    (a - b).abs().max_element() <= 1e-5 * a.max_element().max(b.max_element()) + f32::MIN_POSITIVE
}
