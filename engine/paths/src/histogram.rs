//! Histograms of records: of each attribute in 64 bins, and of each pair of attributes of one table in 64 x 64 bins.
//!
//! They are exact over the samples that [`LightStatistics::threshold`] chose: integer counts of the records. Divided by
//! [`LightStatistics::share`] they estimate the counts of all samples. If the [scope is full](crate::Scope::has_full_histograms),
//! histograms of single attributes also exist for all samples ([`Histograms::attributes_of_all_samples`]). Each histogram exists
//! twice:
//!
//! - by samples: a record counts 1;
//! - by image: a record counts the part of the image that its sample is, in units of 2^-32 of a pixel
//!   ([`LightStatistics::image_weight`]). If tiles have different numbers of samples, only this one shows what is visible in the
//!   image.

pub use crate::attribute::Table;
use crate::attribute::{ATTRIBUTE_COUNTS, LIGHT_ATTRIBUTES, intersection_bins, light_bins, path_bins};
use crate::schema::FINE_BINS;
use crate::statistics::{LightStatistics, image_weight};

/// Counts in bins, by samples and by image.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Counts {
    /// Number of records.
    pub samples: Vec<u64>,
    /// Parts of the image, in units of 2^-32 of a pixel.
    pub image: Vec<u64>,
}

impl Counts {
    fn new(bins: usize) -> Self {
        Self { samples: vec![0; bins], image: vec![0; bins] }
    }

    /// Adds the counts of other samples in the same bins.
    pub fn merge(&mut self, other: &Self) {
        for (mine, theirs) in [(&mut self.samples, &other.samples), (&mut self.image, &other.image)] {
            mine.iter_mut().zip(theirs).for_each(|(mine, theirs)| *mine = mine.saturating_add(*theirs));
        }
    }

    #[inline]
    fn add(&mut self, bin: usize, weight: u64) {
        self.samples[bin] += 1;
        self.image[bin] += weight;
    }
}

/// The histograms of one table.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Histograms {
    /// The table.
    pub table: Table,
    /// Counts of each attribute, in the order of the schema: 64 bins.
    pub attributes: Vec<Counts>,
    /// Counts of each pair of attributes `(a, b)` with `a < b`, in order: 64 x 64 bins, with the bin of `a` as the row.
    pub pairs: Vec<Counts>,
}

impl Histograms {
    /// Computes the histograms of the records of one table.
    pub fn from_statistics(statistics: &LightStatistics, table: Table) -> Self {
        let axes = table.attributes().len();
        let attributes = vec![Counts::new(FINE_BINS); axes];
        let mut all =
            Self { table, attributes, pairs: vec![Counts::new(FINE_BINS * FINE_BINS); axes * (axes - 1) / 2] };
        for path in statistics.paths.values() {
            let weight = statistics.image_weight(path.key);
            match table {
                Table::Paths => all.add(&path_bins(&statistics.scope, path), weight),
                Table::Intersections => {
                    let bins = path.intersections.iter().map(|it| intersection_bins(&statistics.scope, it));
                    bins.for_each(|bins| all.add(&bins, weight));
                }
                Table::Lights => {
                    let bins = path.lights.iter().map(|it| light_bins(&statistics.scope, it));
                    bins.for_each(|bins| all.add(&bins, weight));
                }
            }
        }
        all
    }

    /// Returns the histograms of single attributes over all samples, in order, or `None` if the [scope is not
    /// full](crate::Scope::has_full_histograms).
    pub fn attributes_of_all_samples(statistics: &LightStatistics, table: Table) -> Option<Vec<Counts>> {
        if !statistics.scope.has_full_histograms {
            return None;
        }
        let [paths, intersections, _] = ATTRIBUTE_COUNTS;
        let (skipped, axes) = match table {
            Table::Paths => (0, paths),
            Table::Intersections => (paths, intersections),
            Table::Lights => (paths + intersections, LIGHT_ATTRIBUTES.len()),
        };
        let mut all = vec![Counts::new(FINE_BINS); axes];
        for (key, counters) in &statistics.portions {
            let weight = image_weight(statistics.half_counts(key.tile), key.half);
            let own = counters.bins.as_chunks::<FINE_BINS>().0.iter().skip(skipped);
            for (sums, counts) in all.iter_mut().zip(own) {
                for (bin, count) in counts.iter().enumerate() {
                    sums.samples[bin] = sums.samples[bin].saturating_add(*count);
                    sums.image[bin] = sums.image[bin].saturating_add(count.saturating_mul(weight));
                }
            }
        }
        Some(all)
    }

    fn add(&mut self, bins: &[u8], weight: u64) {
        let mut pair = 0;
        for (a, &row) in bins.iter().enumerate() {
            self.attributes[a].add(usize::from(row), weight);
            for &column in &bins[a + 1..] {
                self.pairs[pair].add(usize::from(row) * FINE_BINS + usize::from(column), weight);
                pair += 1;
            }
        }
    }

    /// Returns the names of the pairs of attributes, in the order of [`Self::pairs`].
    pub fn pair_names(&self) -> impl Iterator<Item = [&'static str; 2]> + use<> {
        self.table.pairs()
    }
}
