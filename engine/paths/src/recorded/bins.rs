//! Histograms of selected records, for single attributes and for chosen pairs.

use super::categories::{OTHERS_BIN, name_axes, names_in};
use super::{Bounds, RecordedFrame, RecordedPaths};
use crate::attribute::{
    ATTRIBUTE_COUNTS, Attribute, INTERSECTION_ATTRIBUTES, LIGHT_ATTRIBUTES, intersection_bins, light_bins, path_bins,
};
use crate::histogram::{Counts, Table};
use crate::record::{LightPath, Name};
use crate::represent::PathBins;
use crate::schema::{FINE_BINS, Scale, name_bin};
use crate::selection::{Cancelled, SelectedRecords, check_cancelled};
use crate::statistics::{IMAGE_BITS, Scope};
use std::borrow::Cow;
use std::sync::atomic::AtomicBool;

/// Weight of a record in a histogram.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Weighting {
    /// A record counts 1.
    Samples,
    /// A record counts the part of the image that its sample is, in pixels.
    Image,
}

/// A pair of attributes of a table.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct PairKey {
    /// Table of the attributes.
    pub table: Table,
    /// Index of the attribute of the rows.
    pub row: usize,
    /// Index of the attribute of the columns.
    pub column: usize,
}

/// Histograms to compute.
#[derive(Clone, Copy, Debug)]
pub struct HistogramRequest<'a> {
    /// Records to count; `None`: all.
    pub selected: Option<&'a SelectedRecords>,
    /// Pairs of attributes. Their indices must be valid.
    pub pairs: &'a [PairKey],
    /// Weight of a record.
    pub weighting: Weighting,
    /// Box for the bins of positions; `None`: the box of the frames.
    pub bounds: Option<Bounds>,
}

/// Samples that the histograms of single attributes contain.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CountedSamples {
    /// Samples whose paths are recorded.
    Recorded,
    /// All samples.
    All,
}

/// Histograms of records. Names are in the bins of their [categories](super::Categories).
#[derive(Clone, Debug, PartialEq)]
pub struct RecordHistograms {
    /// Samples in the histograms of single attributes.
    pub counted: CountedSamples,
    /// Counts of each attribute of each table.
    pub single: [Vec<[f64; FINE_BINS]>; 3],
    /// Counts of recorded paths for each requested pair: 64 x 64 bins, row by row.
    pub pairs: Vec<Vec<f32>>,
}

/// Bins of all records, with categories for names.
#[derive(Clone, Debug)]
pub(super) struct RecordBins {
    paths: Vec<PathBins>,
    intersections: Vec<[u8; INTERSECTION_ATTRIBUTES.len()]>,
    lights: Vec<[u8; LIGHT_ATTRIBUTES.len()]>,
}

impl RecordBins {
    /// Computes the bins.
    /// - `category`: returns the bin of a name, from the index of the attribute among those that are names, and the name.
    pub(super) fn new(
        frames: &[RecordedFrame],
        paths: &[LightPath],
        path_bins: &[PathBins],
        category: impl Fn(usize, Name) -> u8,
    ) -> Self {
        let mut all = Self { paths: path_bins.to_vec(), intersections: Vec::new(), lights: Vec::new() };
        for frame in frames {
            for number in frame.paths.clone() {
                let path = &paths[number as usize];
                let firsts = [number as usize, all.intersections.len(), all.lights.len()];
                all.intersections.extend(path.intersections.iter().map(|it| intersection_bins(&frame.scope, it)));
                all.lights.extend(path.lights.iter().map(|it| light_bins(&frame.scope, it)));
                for (axis, (table, attribute, descriptor)) in name_axes().enumerate() {
                    for (record, name) in (firsts[table as usize]..).zip(names_in(descriptor, path)) {
                        all.row_mut(table, record)[attribute] = category(axis, name);
                    }
                }
            }
        }
        all
    }

    /// Replaces the bins of positions by the bins of another box.
    fn with_bounds(&self, paths: &[LightPath], scope: &Scope) -> Self {
        let mut all = self.clone();
        let positions = |table: Table| {
            let axes = table.attributes().iter().enumerate();
            axes.filter(|(_, it)| matches!(it.scale, Scale::World(_))).collect::<Vec<(usize, &Attribute)>>()
        };
        for table in Table::ALL {
            for (axis, attribute) in positions(table) {
                let values = paths.iter().flat_map(|path| attribute.values(scope, path));
                for (record, value) in values.enumerate() {
                    all.row_mut(table, record)[axis] = attribute.scale.bin(scope, value);
                }
            }
        }
        all
    }

    fn row_mut(&mut self, table: Table, record: usize) -> &mut [u8] {
        match table {
            Table::Paths => &mut self.paths[record],
            Table::Intersections => &mut self.intersections[record],
            Table::Lights => &mut self.lights[record],
        }
    }

    fn row(&self, table: Table, record: usize) -> &[u8] {
        match table {
            Table::Paths => &self.paths[record],
            Table::Intersections => &self.intersections[record],
            Table::Lights => &self.lights[record],
        }
    }

    pub(super) fn memory_bytes(&self) -> usize {
        size_of_val(&self.paths[..]) + size_of_val(&self.intersections[..]) + size_of_val(&self.lights[..])
    }
}

impl RecordedPaths {
    /// Returns the bins of all paths by [`path_bins`], with a box for positions; `None`: the box of the frames.
    pub(super) fn path_bins_within(&self, bounds: Option<Bounds>) -> Cow<'_, [PathBins]> {
        match bounds.filter(|bounds| *bounds != self.bounds()) {
            None => Cow::Borrowed(&self.path_bins),
            Some([lower, upper]) => {
                let of_frame = |frame: &RecordedFrame| {
                    let scope = Scope { lower, upper, ..frame.scope };
                    let paths = frame.paths.clone().map(|number| &self.paths[number as usize]);
                    paths.map(|path| path_bins(&scope, path)).collect::<Vec<_>>()
                };
                Cow::Owned(self.frames.iter().flat_map(of_frame).collect())
            }
        }
    }

    /// Computes histograms. The histograms of single attributes contain all samples if these are known and the request has neither a
    /// selection nor another box.
    pub fn histograms(
        &self,
        request: &HistogramRequest<'_>,
        is_cancelled: &AtomicBool,
    ) -> Result<RecordHistograms, Cancelled> {
        let bounds = request.bounds.filter(|bounds| *bounds != self.bounds());
        let bins = match bounds {
            None => Cow::Borrowed(&self.bins),
            Some([lower, upper]) => {
                Cow::Owned(self.bins.with_bounds(&self.paths, &Scope { lower, upper, ..Scope::default() }))
            }
        };
        let scale = match request.weighting {
            Weighting::Samples => 1.0,
            Weighting::Image => 1.0 / (1u64 << IMAGE_BITS) as f64,
        };
        let (counted, single) = match &self.full {
            Some(full) if request.selected.is_none() && bounds.is_none() => {
                (CountedSamples::All, Table::ALL.map(|table| self.full_histograms(table, full, request.weighting)))
            }
            _ => {
                let mut single = ATTRIBUTE_COUNTS.map(|axes| vec![[0u64; FINE_BINS]; axes]);
                for table in Table::ALL {
                    let counts = &mut single[table as usize];
                    self.for_each_record(table, request, is_cancelled, |record, weight| {
                        for (counts, bin) in counts.iter_mut().zip(bins.row(table, record)) {
                            counts[usize::from(*bin) & (FINE_BINS - 1)] += weight;
                        }
                    })?;
                }
                let to_pixels = |counts: [u64; FINE_BINS]| counts.map(|count| count as f64 * scale);
                let single = single.map(|counts| counts.into_iter().map(to_pixels).collect());
                (CountedSamples::Recorded, single)
            }
        };
        let mut pairs = Vec::with_capacity(request.pairs.len());
        for pair in request.pairs {
            let mut counts = vec![0u64; FINE_BINS * FINE_BINS];
            self.for_each_record(pair.table, request, is_cancelled, |record, weight| {
                let row = bins.row(pair.table, record);
                let bin = usize::from(row[pair.row]) * FINE_BINS + usize::from(row[pair.column]);
                counts[bin & (FINE_BINS * FINE_BINS - 1)] += weight;
            })?;
            pairs.push(counts.into_iter().map(|count| (count as f64 * scale) as f32).collect());
        }
        Ok(RecordHistograms { counted, single, pairs })
    }

    /// Calls `visit` with the number and the weight of each selected record of a table.
    fn for_each_record(
        &self,
        table: Table,
        request: &HistogramRequest<'_>,
        is_cancelled: &AtomicBool,
        mut visit: impl FnMut(usize, u64),
    ) -> Result<(), Cancelled> {
        let mask = request.selected.map(|selected| selected.mask(table));
        for number in 0..self.paths.len() as u32 {
            check_cancelled(number, is_cancelled)?;
            let weight = match request.weighting {
                Weighting::Samples => 1,
                Weighting::Image => self.weights[number as usize],
            };
            let records = match table {
                Table::Paths => number..number + 1,
                Table::Intersections => self.intersections_of(number),
                Table::Lights => self.lights_of(number),
            };
            for record in records {
                if mask.is_none_or(|mask| mask.contains(record)) {
                    visit(record as usize, weight);
                }
            }
        }
        Ok(())
    }

    /// Returns the histograms of a table over all samples. The count of a bin that several names share is divided in proportion to
    /// their records. Names without records belong to the others.
    fn full_histograms(&self, table: Table, full: &[Vec<Counts>; 3], weighting: Weighting) -> Vec<[f64; FINE_BINS]> {
        let mut all = Vec::with_capacity(full[table as usize].len());
        for (axis, counts) in full[table as usize].iter().enumerate() {
            let own: [f64; FINE_BINS] = std::array::from_fn(|bin| match weighting {
                Weighting::Samples => counts.samples[bin] as f64,
                Weighting::Image => counts.image[bin] as f64 / (1u64 << IMAGE_BITS) as f64,
            });
            let categories = self.categories.iter().find(|it| it.table == table && it.attribute == axis);
            let Some(categories) = categories else {
                all.push(own);
                continue;
            };
            let recorded = || (1u32..).zip(self.names.keys()).zip(&categories.counts[1..]);
            let mut sums = [0u64; FINE_BINS];
            recorded().for_each(|((_, name), count)| sums[usize::from(name_bin(*name))] += count);
            let mut bins = [0.0; FINE_BINS];
            bins[0] = own[0];
            for ((number, name), count) in recorded().filter(|(_, count)| **count > 0) {
                let shared = usize::from(name_bin(*name));
                bins[usize::from(categories.bin(number))] += own[shared] * *count as f64 / sums[shared] as f64;
            }
            let unknown: f64 = (1..FINE_BINS).filter(|bin| sums[*bin] == 0).map(|bin| own[bin]).sum();
            bins[usize::from(OTHERS_BIN)] += unknown;
            all.push(bins);
        }
        all
    }
}
