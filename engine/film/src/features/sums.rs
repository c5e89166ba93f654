//! Sums over the samples of pixels.

use super::FeatureLayout;

/// Denominator of the fixed-point values: a value is a multiple of 1 over this.
const UNIT: f64 = (1u64 << 40) as f64;
/// Largest absolute value.
const MAX_VALUE: f64 = (1u64 << 40) as f64;
/// Largest term.
pub(super) const MAX_TERM: i128 = 1 << 80;

/// Converts a number to a term: clamped to the limits, and 0 for NaN.
#[inline]
fn quantize(value: f64) -> i128 {
    (value.clamp(-MAX_VALUE, MAX_VALUE) * UNIT).round() as i128
}

/// Returns the mean of `count` values with this sum.
pub(super) fn mean(sum: i128, count: u32) -> f64 {
    if count == 0 { 0.0 } else { sum as f64 / UNIT / f64::from(count) }
}

/// Number of samples of each id, for each pixel: (id, samples), ids ascending.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(super) struct IdCounts {
    /// End of the entries of each pixel.
    ends: Vec<usize>,
    pub entries: Vec<[u32; 2]>,
}

impl IdCounts {
    pub fn push(&mut self, pixel: &[[u32; 2]]) {
        self.entries.extend_from_slice(pixel);
        self.ends.push(self.entries.len());
    }

    pub fn pixels(&self) -> impl Iterator<Item = &[[u32; 2]]> {
        let starts = std::iter::once(0).chain(self.ends.iter().copied());
        starts.zip(&self.ends).map(|(start, end)| &self.entries[start..*end])
    }

    /// Creates the shares from the pixels' numbers of entries; `None`: they do not match the entries.
    pub fn new(counts: &[u32], entries: Vec<[u32; 2]>) -> Option<Self> {
        let mut end = 0usize;
        let ends: Vec<usize> = counts
            .iter()
            .map(|count| {
                end = end.saturating_add(*count as usize);
                end
            })
            .collect();
        (end == entries.len()).then_some(Self { ends, entries })
    }

    /// Returns the shares of the samples of both.
    pub fn merged(&self, other: &Self) -> Self {
        let mut all = Self::default();
        let mut pixel = Vec::new();
        for (mine, theirs) in self.pixels().zip(other.pixels()) {
            pixel.clear();
            pixel.extend_from_slice(mine);
            theirs.iter().for_each(|[id, count]| add(&mut pixel, *id, *count));
            all.push(&pixel);
        }
        all
    }
}

fn add(pixel: &mut Vec<[u32; 2]>, id: u32, count: u32) {
    match pixel.binary_search_by_key(&id, |entry| entry[0]) {
        Ok(at) => pixel[at][1] = pixel[at][1].saturating_add(count),
        Err(at) => pixel.insert(at, [id, count]),
    }
}

/// Sums of pixels, which are filled one after the other.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct FeatureSums {
    pub(super) layout: FeatureLayout,
    /// Good samples and hits of each pixel.
    pub(super) counts: Vec<[u32; 2]>,
    /// Sums of the values, pixel by pixel.
    pub(super) values: Vec<i128>,
    pub(super) id_counts: Vec<IdCounts>,
    /// Ids of the current pixel.
    current_ids: Vec<Vec<[u32; 2]>>,
}

impl FeatureSums {
    /// Creates sums without pixels.
    pub fn new(layout: FeatureLayout) -> Self {
        let kinds = layout.ids as usize;
        let (shares, open) = (vec![IdCounts::default(); kinds], vec![Vec::new(); kinds]);
        Self { layout, id_counts: shares, current_ids: open, ..Self::default() }
    }

    pub(super) fn from_parts(
        layout: FeatureLayout,
        counts: Vec<[u32; 2]>,
        values: Vec<i128>,
        shares: Vec<IdCounts>,
    ) -> Self {
        Self { counts, values, id_counts: shares, ..Self::new(layout) }
    }

    /// Finishes the current pixel, if there is one, and starts the next.
    pub fn begin_pixel(&mut self) {
        self.end_pixel();
        self.counts.push([0; 2]);
        self.values.resize(self.values.len() + self.layout.values as usize, 0);
    }

    fn end_pixel(&mut self) {
        if self.id_counts.iter().all(|shares| shares.ends.len() == self.counts.len()) {
            return;
        }
        for (shares, open) in self.id_counts.iter_mut().zip(&mut self.current_ids) {
            shares.push(open);
            open.clear();
        }
    }

    /// Adds a sample to the current pixel: the values and ids of the hit, as many as in the layout; `None`: no hit.
    #[inline]
    pub fn add(&mut self, hit: Option<(&[f64], &[u32])>) {
        let Some([samples, hits]) = self.counts.last_mut() else { return };
        *samples = samples.saturating_add(1);
        let Some((values, ids)) = hit else { return };
        *hits = hits.saturating_add(1);
        let first = self.values.len() - self.layout.values as usize;
        self.values[first..].iter_mut().zip(values).for_each(|(sum, value)| *sum += quantize(*value));
        self.current_ids.iter_mut().zip(ids).for_each(|(open, id)| add(open, *id, 1));
    }

    /// Concatenates the pixels of several sums.
    pub fn concat(layout: FeatureLayout, all: impl IntoIterator<Item = Self>) -> Self {
        let mut joined = Self::new(layout);
        for mut next in all {
            next.end_pixel();
            joined.counts.append(&mut next.counts);
            joined.values.append(&mut next.values);
            for (mine, theirs) in joined.id_counts.iter_mut().zip(&next.id_counts) {
                theirs.pixels().for_each(|pixel| mine.push(pixel));
            }
        }
        joined
    }

    /// Adds the samples of the same pixels.
    pub(super) fn merge(&mut self, other: &Self) {
        let counts = self.counts.as_flattened_mut().iter_mut().zip(other.counts.as_flattened());
        counts.for_each(|(a, b)| *a = a.saturating_add(*b));
        self.values.iter_mut().zip(&other.values).for_each(|(a, b)| *a = a.saturating_add(*b));
        self.id_counts.iter_mut().zip(&other.id_counts).for_each(|(a, b)| *a = a.merged(b));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_rounded_once_and_what_is_none_is_zero() {
        for (value, units) in [(0.5, 1i128 << 39), (-3.0, -3 << 40), (2f64.powi(-41), 1), (2f64.powi(-42), 0)] {
            assert_eq!(quantize(value), units, "{value}");
        }
        assert_eq!((quantize(f64::INFINITY), quantize(-1e30), quantize(f64::NAN)), (MAX_TERM, -MAX_TERM, 0));
        assert!((mean(quantize(-0.1) + quantize(0.3), 2) - 0.1).abs() <= 1.0 / UNIT);
        assert_eq!(mean(0, 0), 0.0);
    }
}
