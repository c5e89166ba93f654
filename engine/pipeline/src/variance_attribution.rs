//! Sources of the variance of a block of pixels.
//!
//! A sample is a sum of contributions, each with an [`ContributionOrigin`]. The variance of independent samples
//! `x = sum over g of x_g` is `E[(x - m) x] = sum over g of E[(x - m) x_g]`. So the covariances of the contributions with their sum
//! are shares that add up to the variance. (This ignores that the samples of a replicate are evenly spread. The dominant samples of
//! a noisy block are rare and bright, and even spread does not affect them.)

use crate::replay::{CountedSamples, Replay};
use crate::settings::Settings;
use femc_film::Rect;
use femc_math::Rgb;
pub use femc_math::color::luminance;
use femc_montecarlo::record::{Contribution, InteractionKind, LightTechnique, Recording, Step, VertexLocation};
use femc_prepared::Prepared;
use femc_prepared::names::LampName;
use femc_scene::ObjectId;
use rayon::prelude::*;
use std::collections::BTreeMap;
use std::sync::atomic::{AtomicU64, Ordering};

/// Way in which light entered a sample.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum ContributionKind {
    /// A point on the lamp was sampled from the camera.
    CameraNextEvent,
    /// The camera ray hit the lamp.
    CameraHit,
    /// The path hit the lamp behind a mirror or refracting glass.
    SpecularHit,
    /// The path hit the lamp after it was scattered.
    ScatteredHit,
    /// A point on the lamp was sampled from a surface.
    NextEvent,
    /// A point on the lamp was sampled, with a distance by its light that a medium on the segment scatters.
    Airlight,
    /// A medium emits light.
    Glow,
    /// Light of the first pass, with the method `fem`.
    Field,
}

/// Last scatterer of light.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum LastScatterer {
    /// None: the light travels straight to the camera.
    Camera,
    /// A surface.
    Surface {
        /// The innermost object that holds it.
        object: Option<ObjectId>,
        /// Index of its material.
        material: u32,
    },
    /// A medium, by index.
    Medium(u16),
}

/// Origin of a contribution.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct ContributionOrigin {
    /// Segment of the path, 0: the camera's.
    pub bounce: u32,
    /// Way in which the light entered.
    pub technique: ContributionKind,
    /// Whether the guide of a first pass sampled a direction of the path before this contribution.
    pub guided: bool,
    /// Last scatterer.
    pub scatterer: LastScatterer,
    /// Index of the lamp in [`Lamps::names`]. `None`: a medium.
    pub lamp: Option<u32>,
}

/// The lamps of a frame. Lights of one kind in one object are one lamp.
pub struct Lamps {
    /// Names of the lamps. The order is that of the first light of each lamp.
    pub names: Vec<LampName>,
    lamp_of_light: Vec<u32>,
}

impl Lamps {
    /// Groups all lights of a frame into lamps.
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
        Self { names, lamp_of_light: of_light }
    }
}

impl ContributionOrigin {
    /// Returns the origin of a contribution to a sample. `vertex`: number of the latest vertex of its branch.
    pub fn new(
        prepared: &Prepared,
        lamps: &Lamps,
        recording: &Recording,
        contribution: &Contribution,
        vertex: u32,
    ) -> Self {
        let source = recording.last_scattering(vertex);
        let before = source.map_or(LastScatterer::Camera, |step| scatterer(prepared, step.vertex.location));
        let in_medium = contribution.medium.map_or(before, LastScatterer::Medium);
        let (kind, last_scatterer) = match contribution.technique {
            LightTechnique::CameraNextEvent => (ContributionKind::CameraNextEvent, LastScatterer::Camera),
            LightTechnique::EmitterHit => match source.map(Step::interaction) {
                None => (ContributionKind::CameraHit, LastScatterer::Camera),
                Some(InteractionKind::Reflection | InteractionKind::Refraction) => {
                    (ContributionKind::SpecularHit, before)
                }
                Some(_) => (ContributionKind::ScatteredHit, before),
            },
            LightTechnique::NextEvent => (ContributionKind::NextEvent, before),
            LightTechnique::Airlight => (ContributionKind::Airlight, in_medium),
            LightTechnique::Glow => (ContributionKind::Glow, in_medium),
            LightTechnique::Field => (ContributionKind::Field, before),
        };
        let lamp = contribution.light.and_then(|light| lamps.lamp_of_light.get(light as usize).copied());
        let guided = |step: &Step| step.continuation.is_some_and(|continuation| continuation.is_guide_sample);
        // The direction in which the path leaves a vertex does not affect a lamp that was sampled there.
        let not_left = matches!(contribution.technique, LightTechnique::NextEvent | LightTechnique::Field);
        let guided = recording.steps.branch(vertex).skip(usize::from(not_left)).any(guided);
        Self { bounce: contribution.bounce, technique: kind, guided, scatterer: last_scatterer, lamp }
    }
}

/// Returns the scatterer for a surface or medium at a vertex.
pub fn scatterer(prepared: &Prepared, location: VertexLocation) -> LastScatterer {
    match location {
        VertexLocation::Surface { instance, primitive, material } => {
            LastScatterer::Surface { object: prepared.object_of(instance, primitive), material }
        }
        VertexLocation::Medium(medium) => LastScatterer::Medium(medium),
    }
}

/// A pixel in a file.
#[derive(Clone, Copy, Debug)]
pub struct ExpectedPixel {
    /// Number of samples in its mean.
    pub samples: u32,
    /// Mean, cd/m2.
    pub color: [f32; 3],
}

/// The brightest contribution of an origin.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BrightestContribution {
    /// Column and row of the pixel.
    pub pixel: (u32, u32),
    /// Number of the sample.
    pub sample: u32,
    /// Luminance of the contribution, cd/m2.
    pub luminance: f64,
    /// Mean luminance of the pixel's samples, cd/m2.
    pub mean: f64,
}

/// Statistics of one origin.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct OriginShare {
    /// Part of the variance of the block's mean luminance, cd2/m4. It is negative if the origin is dark when the rest is bright.
    pub variance: f64,
    /// Part of the mean luminance, cd/m2.
    pub mean: f64,
    /// Brightest contribution of the origin.
    pub brightest: BrightestContribution,
}

/// Sources of variance of some pixels.
#[derive(Clone, Debug, Default)]
pub struct VarianceAttribution {
    /// Statistics by origin.
    pub origins: BTreeMap<ContributionOrigin, OriginShare>,
    /// Pixels with their contributions to the variance of the block's mean, cd2/m4.
    pub pixels: Vec<((u32, u32), f64)>,
    /// Number of traced samples.
    pub samples: u64,
    /// Number of pixels whose replayed mean differs from that in the file, because the file does not say which samples count.
    pub mismatched: u64,
}

impl VarianceAttribution {
    /// Traces the samples of the pixels of `rect` again.
    /// - `expected`: returns the pixel in the file;
    /// - `progress`: counts samples.
    pub fn from_replay(
        prepared: &Prepared,
        settings: &Settings,
        lamps: &Lamps,
        rect: Rect,
        expected: impl Fn((u32, u32)) -> ExpectedPixel + Sync,
        progress: &AtomicU64,
    ) -> Self {
        let pixels: Vec<(u32, u32)> = rect.pixels().collect();
        let accounts: Vec<Self> = pixels
            .par_iter()
            .map(|&pixel| {
                let replayed = PixelReplay::new(prepared, settings, lamps, pixel, expected(pixel), progress);
                replayed.attribute(pixels.len() as f64)
            })
            .collect();
        let mut whole = Self::default();
        accounts.into_iter().for_each(|account| whole.merge(account));
        whole
    }

    /// Adds the statistics of other pixels of the same block, or of another block.
    pub fn merge(&mut self, other: Self) {
        for (origin, part) in other.origins {
            let both = |mine: &mut OriginShare| {
                mine.variance += part.variance;
                mine.mean += part.mean;
                if part.brightest.luminance > mine.brightest.luminance {
                    mine.brightest = part.brightest;
                }
            };
            self.origins.entry(origin).and_modify(both).or_insert(part);
        }
        self.pixels.extend(other.pixels);
        self.samples += other.samples;
        self.mismatched += other.mismatched;
    }

    /// Returns the variance of the block's mean luminance, cd2/m4, estimated from the spread of the samples.
    pub fn variance(&self) -> f64 {
        self.pixels.iter().map(|(_, variance)| variance).sum()
    }

    /// Multiplies all variances by a factor, to add up blocks of different brightness.
    #[must_use]
    pub fn scaled(mut self, factor: f64) -> Self {
        self.origins.values_mut().for_each(|part| part.variance *= factor);
        self.pixels.iter_mut().for_each(|(_, variance)| *variance *= factor);
        self
    }
}

/// The samples of one pixel.
struct PixelReplay {
    pixel: (u32, u32),
    counted: CountedSamples,
    matches_file: bool,
    colors: Vec<Option<Rgb>>,
    /// Sample, origin and luminance of each contribution.
    parts: Vec<(u32, ContributionOrigin, f64)>,
}

impl PixelReplay {
    fn new(
        prepared: &Prepared,
        settings: &Settings,
        lamps: &Lamps,
        pixel: (u32, u32),
        expected: ExpectedPixel,
        progress: &AtomicU64,
    ) -> Self {
        let candidates = CountedSamples::candidates(settings, expected.samples);
        let first = CountedSamples::first_samples(expected.samples);
        let ends = candidates.iter().chain([&first]).map(|counted| counted.range().end);
        let (mut colors, mut parts) = (Vec::new(), Vec::new());
        let mut replay = Replay::new(prepared, settings);
        for sample in 0..ends.max().unwrap_or(0) {
            let (color, recording) = replay.sample(pixel, sample);
            colors.push(color);
            for (contribution, vertex) in &recording.contributions {
                let origin = ContributionOrigin::new(prepared, lamps, recording, contribution, *vertex);
                parts.push((sample, origin, f64::from(luminance(contribution.color))));
            }
        }
        progress.fetch_add(colors.len() as u64, Ordering::Relaxed);
        let likely = candidates.into_iter().find(|counted| nearly_equal(counted.mean(&colors), expected.color));
        Self { pixel, counted: likely.unwrap_or(first), matches_file: likely.is_some(), colors, parts }
    }

    /// - `area`: pixels of the block.
    fn attribute(&self, area: f64) -> VarianceAttribution {
        // Color of a sample, if it counts.
        let color = |sample: u32| self.colors[sample as usize].filter(|_| self.counted.contains(sample));
        let counted = (0..self.colors.len() as u32).filter_map(color);
        let values: Vec<f64> = counted.map(|color| f64::from(luminance(color))).collect();
        let n = values.len() as f64;
        let mean = values.iter().sum::<f64>() / n.max(1.0);
        let factor = self.counted.variance_factor() / (n - 1.0).max(1.0) / (area * area);
        let mut parts = BTreeMap::<ContributionOrigin, OriginShare>::new();
        for &(sample, origin, luminance) in &self.parts {
            let Some(color) = color(sample) else { continue };
            let all = f64::from(femc_math::color::luminance(color));
            let brightest = BrightestContribution { pixel: self.pixel, sample, luminance, mean };
            let part = parts.entry(origin).or_insert(OriginShare { variance: 0.0, mean: 0.0, brightest });
            part.variance += factor * (all - mean) * luminance;
            part.mean += luminance / (n * area);
            if luminance > part.brightest.luminance {
                part.brightest = brightest;
            }
        }
        let variance = factor * values.iter().map(|value| (value - mean).powi(2)).sum::<f64>();
        VarianceAttribution {
            origins: parts,
            pixels: vec![(self.pixel, variance)],
            samples: self.colors.len() as u64,
            mismatched: u64::from(!self.matches_file),
        }
    }
}

/// Checks whether two colors are equal up to the rounding of sums.
fn nearly_equal(a: Rgb, b: [f32; 3]) -> bool {
    let b = Rgb::from_array(b);
    (a - b).abs().max_element() <= 1e-5 * a.max_element().max(b.max_element()) + f32::MIN_POSITIVE
}
