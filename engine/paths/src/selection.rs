//! Selections of recorded paths: a query evaluated over all of them.
//!
//! A selection is three masks, for paths, intersections and lights. Bit `number` of a mask belongs to the record of this number
//! ([`RecordedPaths`]). A selection is exact over the recorded paths. Its counts, divided by the share of recorded samples, estimate
//! counts of all samples.

use crate::attribute::Table;
use crate::query::{Query, Selection};
use crate::recorded::RecordedPaths;
use crate::statistics::IMAGE_BITS;
use std::sync::atomic::{AtomicBool, Ordering};

/// Number of paths between two looks at the cancel flag.
const CANCEL_PERIOD: u32 = 1024;

/// Error: the caller set the cancel flag.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("cancelled")]
pub struct Cancelled;

/// Error: pixels of frames with different films cannot be added.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "frame {} has a film of {} x {} pixels, but frame {} has {} x {}; choose frames with one film",
    .frames[0], .films[0][0], .films[0][1], .frames[1], .films[1][0], .films[1][1]
)]
pub struct FilmMismatch {
    /// Numbers of two frames.
    pub frames: [u32; 2],
    /// Their films, pixels.
    pub films: [[u32; 2]; 2],
}

/// Returns an error if the flag is set. It reads the flag only for some numbers.
#[inline]
pub(crate) fn check_cancelled(number: u32, is_cancelled: &AtomicBool) -> Result<(), Cancelled> {
    if number.is_multiple_of(CANCEL_PERIOD) && is_cancelled.load(Ordering::Relaxed) { Err(Cancelled) } else { Ok(()) }
}

/// Amount of work between two looks at the cancel flag, in evaluations of terms: less than a millisecond.
const CANCEL_WORK: usize = 1 << 16;

/// Watch over the cancel flag. It reads the flag at first and then after a fixed amount of work.
#[derive(Debug)]
pub struct CancelCheck<'a> {
    is_cancelled: &'a AtomicBool,
    /// Work since the last look at the flag.
    work: usize,
}

impl<'a> CancelCheck<'a> {
    /// Creates a watch over a flag.
    pub fn new(is_cancelled: &'a AtomicBool) -> Self {
        Self { is_cancelled, work: CANCEL_WORK }
    }

    /// Adds work. Returns an error if it is time to look at the flag, and the flag is set.
    #[inline]
    pub fn add(&mut self, work: usize) -> Result<(), Cancelled> {
        self.work = self.work.saturating_add(work);
        if self.work >= CANCEL_WORK { self.look() } else { Ok(()) }
    }

    /// Returns an error if the flag is set.
    pub fn look(&mut self) -> Result<(), Cancelled> {
        self.work = 0;
        if self.is_cancelled.load(Ordering::Relaxed) { Err(Cancelled) } else { Ok(()) }
    }
}

/// A set of record numbers: bit `number & 7` of byte `number >> 3`.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct BitMask {
    bytes: Vec<u8>,
}

impl BitMask {
    /// Creates an empty set of numbers below `length`.
    pub fn new(length: u32) -> Self {
        Self { bytes: vec![0; length.div_ceil(8) as usize] }
    }

    /// Adds a number, which must be below the length.
    #[inline]
    pub fn insert(&mut self, number: u32) {
        self.bytes[(number >> 3) as usize] |= 1 << (number & 7);
    }

    /// Checks whether the set has a number.
    #[inline]
    pub fn contains(&self, number: u32) -> bool {
        self.bytes.get((number >> 3) as usize).is_some_and(|byte| byte >> (number & 7) & 1 == 1)
    }

    /// Returns the numbers in the set, ascending.
    pub fn numbers(&self) -> impl Iterator<Item = u32> + '_ {
        let in_byte = |(at, byte): (u32, &u8)| {
            let byte = *byte;
            (0..8).filter(move |bit| byte >> bit & 1 == 1).map(move |bit| 8 * at + bit)
        };
        (0..).zip(&self.bytes).flat_map(in_byte)
    }

    /// Returns the number of members.
    pub fn count(&self) -> u32 {
        self.bytes.iter().map(|byte| byte.count_ones()).sum()
    }

    /// Returns the bytes.
    pub fn as_bytes(&self) -> &[u8] {
        &self.bytes
    }
}

/// Selected records.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct SelectedRecords {
    /// Selected paths.
    pub paths: BitMask,
    /// Selected intersections of selected paths.
    pub intersections: BitMask,
    /// Selected lights of selected paths.
    pub lights: BitMask,
}

impl SelectedRecords {
    /// Returns the mask of a table.
    pub fn mask(&self, table: Table) -> &BitMask {
        match table {
            Table::Paths => &self.paths,
            Table::Intersections => &self.intersections,
            Table::Lights => &self.lights,
        }
    }

    /// Returns the numbers of selected paths, intersections and lights.
    pub fn counts(&self) -> [u32; 3] {
        Table::ALL.map(|table| self.mask(table).count())
    }
}

/// Selected paths of a pixel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PixelDensity {
    /// Row-major index of the pixel.
    pub pixel: u32,
    /// Number of selected recorded paths of all frames.
    pub count: u32,
    /// Contribution of these paths to the pixel's value, cd/m2, as a mean over the frames.
    pub contribution: f64,
    /// Mean luminance of these paths, cd/m2.
    pub mean_luminance: f64,
}

impl RecordedPaths {
    /// Evaluates a query over all paths.
    pub fn select(&self, query: &Query, is_cancelled: &AtomicBool) -> Result<SelectedRecords, Cancelled> {
        let [paths, intersections, lights] = self.totals().map(BitMask::new);
        let mut all = SelectedRecords { paths, intersections, lights };
        let mut own = Selection::default();
        let mut check = CancelCheck::new(is_cancelled);
        for frame in self.frames() {
            check.look()?;
            let matcher = query.compile(&frame.scope, &frame.names);
            for number in frame.paths.clone() {
                let path = &self.paths()[number as usize];
                check.add(matcher.work(path))?;
                if matcher.select_into(path, &mut own) {
                    all.paths.insert(number);
                    let (intersection, light) = (self.intersections_of(number).start, self.lights_of(number).start);
                    own.intersections.iter().for_each(|index| all.intersections.insert(intersection + index));
                    own.lights.iter().for_each(|index| all.lights.insert(light + index));
                }
            }
        }
        Ok(all)
    }

    /// Returns the share of the image's light that the selected paths carry, of all recorded paths; `None`: there is no light.
    pub fn light_share(&self, paths: &BitMask) -> Option<f64> {
        let (mut selected, mut all) = (0.0, 0.0);
        for number in 0..self.paths().len() as u32 {
            let light = self.light(number);
            all += light;
            if paths.contains(number) {
                selected += light;
            }
        }
        (all > 0.0).then(|| selected / all)
    }

    /// Returns an estimate of the number of samples that a number of recorded paths stands for.
    pub fn estimate_samples(&self, paths: u32) -> f64 {
        f64::from(paths) / self.share().max(f64::MIN_POSITIVE)
    }

    /// Returns the pixels that have selected paths, ascending.
    ///
    /// The contribution of a path is its luminance times the part of the pixel that its sample is. Samples that are not recorded do
    /// not contribute. For several frames of one film, counts are summed over the frames, and contributions are averaged.
    pub fn density(&self, paths: &BitMask) -> Result<Vec<PixelDensity>, FilmMismatch> {
        if let [first, others @ ..] = self.frames()
            && let Some(other) = others.iter().find(|other| other.scope.film != first.scope.film)
        {
            let frames = [first, other];
            return Err(FilmMismatch {
                frames: frames.map(|it| it.scope.frame),
                films: frames.map(|it| it.scope.film),
            });
        }
        let mut all: Vec<(u32, u32)> =
            paths.numbers().map(|number| (self.paths()[number as usize].key.pixel, number)).collect();
        all.sort_unstable();
        let frames = self.frames().len().max(1) as f64;
        let pixel = |own: &[(u32, u32)]| {
            let sum = |value: &dyn Fn(u32) -> f64| own.iter().map(|(_, number)| value(*number)).sum::<f64>();
            let luminance = |number: u32| f64::from(self.paths()[number as usize].luminance());
            PixelDensity {
                pixel: own[0].0,
                count: own.len() as u32,
                contribution: sum(&|number| self.light(number)) / frames,
                mean_luminance: sum(&luminance) / own.len() as f64,
            }
        };
        Ok(all.chunk_by(|a, b| a.0 == b.0).map(pixel).collect())
    }

    /// Returns the contribution of a path to its pixel's value, cd/m2.
    fn light(&self, number: u32) -> f64 {
        let (path, weight) = (&self.paths()[number as usize], self.image_weights()[number as usize]);
        f64::from(path.luminance()) * weight as f64 / (1u64 << IMAGE_BITS) as f64
    }
}
