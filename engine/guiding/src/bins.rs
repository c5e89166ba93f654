//! Bins of a leaf of the field. Light can be much narrower than a leaf.

use femc_field::Parallelogram;
use femc_math::cross;
use femc_math::glam::Vec3A;

/// Number of halvings from a leaf to a bin.
pub const BIN_LEVELS: u32 = 6;

/// Bins of a leaf that is a parallelogram. Each halving is across the longer edges.
#[derive(Clone, Copy, Debug)]
pub struct LeafBins {
    outline: Parallelogram,
    /// Vectors whose dot products with an offset from the corner are its coordinates along the edges.
    across: [Vec3A; 2],
    /// Index of the halved edge, by halving.
    axes: [usize; BIN_LEVELS as usize],
}

impl LeafBins {
    /// - `outline`: parallelogram of the leaf.
    pub fn new(outline: Parallelogram) -> Self {
        let [a, b] = outline.edges;
        let normal = cross(a, b);
        let across = [cross(b, normal), cross(normal, a)].map(|it| it / normal.length_squared());
        let mut lengths = [a.length(), b.length()];
        let axes = std::array::from_fn(|_| {
            let longer = usize::from(lengths[1] > lengths[0]);
            lengths[longer] *= 0.5;
            longer
        });
        Self { outline, across, axes }
    }

    /// Returns the number of the bin at a position of the leaf, with a bit for each halving, the first one highest.
    pub fn bin(&self, position: Vec3A) -> u32 {
        let offset = position - self.outline.corner;
        let mut place = self.across.map(|across| offset.dot(across));
        self.axes.iter().fold(0, |bin, &axis| {
            // Of a number that is not one, the first half is taken.
            let upper = place[axis] >= 0.5;
            place[axis] = 2.0 * place[axis] - if upper { 1.0 } else { 0.0 };
            bin << 1 | u32::from(upper)
        })
    }

    /// Returns the parallelogram of all bins whose numbers begin with the bits of `first`.
    /// - `level`: number of these bits, at most [`BIN_LEVELS`].
    pub fn part(&self, level: u32, first: u32) -> Parallelogram {
        let mut out = self.outline;
        for (at, &axis) in self.axes.iter().take(level as usize).enumerate() {
            out.edges[axis] *= 0.5;
            if first >> (level - 1 - at as u32) & 1 > 0 {
                out.corner += out.edges[axis];
            }
        }
        out
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use femc_math::hash::{mix64, unit_f32};

    #[test]
    fn a_position_lies_in_its_bin() {
        let edges = [Vec3A::new(0.3, 0.1, 0.0), Vec3A::new(0.0, 0.2, 2.0)];
        let bins = LeafBins::new(Parallelogram { corner: Vec3A::new(1.0, -2.0, 0.5), edges });
        let mut counts = [0u32; 1 << BIN_LEVELS];
        for k in 0..6400u64 {
            let number = |n: u64| unit_f32((mix64(2 * k + n) >> 32) as u32);
            let position = bins.part(0, 0).point_at([number(0), number(1)]);
            let bin = bins.bin(position);
            counts[bin as usize] += 1;
            for level in 0..=BIN_LEVELS {
                let part = bins.part(level, bin >> (BIN_LEVELS - level));
                let half = (part.edges[0] + part.edges[1]) * 0.5;
                let offset = position - part.center();
                let inside = bins.across.iter().all(|it| offset.dot(*it).abs() <= half.dot(*it).abs() * 1.001);
                assert!(inside && (part.area() * (1 << level) as f32 / bins.outline.area() - 1.0).abs() < 1e-4);
            }
        }
        assert!(counts.iter().all(|count| (60..150).contains(count)), "{counts:?}");
        let bin = bins.part(BIN_LEVELS, 0);
        assert!(bin.edges[1].length() < 2.0 * bin.edges[0].length(), "{bin:?}");
    }
}
