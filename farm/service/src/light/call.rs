//! Questions about recorded light, and their answers.

use std::sync::Arc;

/// Maximum number of paths in an answer: 1 to [`PathCount::MAX`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct PathCount(u32);

impl PathCount {
    /// Greatest value.
    pub const MAX: u32 = 20_000;

    /// Returns the number, or `None` if it is out of range.
    pub fn new(count: u32) -> Option<Self> {
        (1..=Self::MAX).contains(&count).then_some(Self(count))
    }

    /// Returns the number.
    pub const fn get(self) -> u32 {
        self.0
    }
}

impl Default for PathCount {
    fn default() -> Self {
        Self(5000)
    }
}

/// Level of an octree with 2^level voxels a side: 0 to [`VoxelLevel::MAX`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct VoxelLevel(u32);

impl VoxelLevel {
    /// Greatest value.
    pub const MAX: u32 = 7;

    /// Returns the level, or `None` if it is out of range.
    pub fn new(level: u32) -> Option<Self> {
        (level <= Self::MAX).then_some(Self(level))
    }

    /// Returns the level.
    pub const fn get(self) -> u32 {
        self.0
    }
}

impl Default for VoxelLevel {
    fn default() -> Self {
        Self(5)
    }
}

/// Pairs of attributes, at most [`AxisPairs::MAX`]: table (0 paths, 1 intersections, 2 lights), attribute of the row, attribute of the
/// column.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct AxisPairs(Vec<[usize; 3]>);

impl AxisPairs {
    /// Maximum number of pairs.
    pub const MAX: usize = 256;

    /// Returns the pairs, or `None` if they are too many.
    pub fn new(pairs: Vec<[usize; 3]>) -> Option<Self> {
        (pairs.len() <= Self::MAX).then_some(Self(pairs))
    }

    /// Returns the pairs.
    pub fn as_slice(&self) -> &[[usize; 3]] {
        &self.0
    }
}

/// Lower and upper corner of a box, world, m: finite, and no coordinate of the lower corner is greater.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Corners([[f64; 3]; 2]);

impl Corners {
    /// Returns the corners, or `None` if they do not make a box.
    pub fn new(corners: [[f64; 3]; 2]) -> Option<Self> {
        let [lower, upper] = corners;
        let is_box = |axis: usize| lower[axis].is_finite() && upper[axis].is_finite() && lower[axis] <= upper[axis];
        (0..3).all(is_box).then_some(Self(corners))
    }

    /// Returns the corners.
    pub const fn get(self) -> [[f64; 3]; 2] {
        self.0
    }
}

/// Question about recorded light.
#[derive(Debug, Clone, PartialEq)]
pub struct LightCall {
    /// Kind of the question.
    pub kind: LightCallKind,
    /// Condition on paths, in the language of `femc paths --where`; `None`: all paths.
    pub condition: Option<String>,
    /// Box of the world for bins of positions; `None`: the box of the data.
    pub bounds: Option<Corners>,
}

/// Kind of a question about recorded light.
#[derive(Debug, Clone, PartialEq)]
pub enum LightCallKind {
    /// Attributes, names and totals.
    Schema,
    /// Representative paths with their intersections and lights.
    Paths {
        /// Maximum number of paths.
        count: PathCount,
        /// Whether the brightest samples are wanted instead of a representative set.
        brightest: bool,
    },
    /// Histograms of all attributes.
    Histograms {
        /// Pairs of attributes that need joint histograms.
        pairs: AxisPairs,
        /// Whether records weigh their part of the image instead of 1.
        by_image: bool,
    },
    /// Energy in the voxels of the scene.
    Voxels {
        /// Level of the octree.
        level: VoxelLevel,
        /// Bounce of the intersections; `None`: all.
        bounce: Option<u32>,
    },
    /// Light of the selected records in numbers: by object, by bounce and by lamp.
    Summary,
    /// Evaluation of the condition over all recorded paths.
    Selection {
        /// Whether the density over pixels is wanted.
        with_density: bool,
    },
}

/// Answer to a question about recorded light.
#[derive(Debug, Clone, PartialEq)]
pub enum LightAnswer {
    /// JSON.
    Json(Vec<u8>),
    /// Columns of numbers, as specified in `docs/http.md`.
    Columns(Vec<u8>),
    /// Columns of rows that later answers about growing data may refer to.
    Rows {
        /// Columns of numbers.
        columns: Vec<u8>,
        /// Identities of all rows that the client has after this answer, in their order.
        identities: Arc<[RowIdentity]>,
    },
}

/// Identity of a row: a digest of its values. Rows with equal identities have equal values, except their numbers among all records
/// and their weights, which change when the data grow.
pub type RowIdentity = [u8; 16];

/// Rows of an earlier answer.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct EarlierRows {
    /// Tag of the answer.
    pub tag: String,
    /// Identities of its rows, in their order.
    pub identities: Arc<[RowIdentity]>,
}

/// Reason why a question has no answer.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum LightError {
    /// A parameter of the call is not valid.
    Invalid {
        /// Name of the parameter in the request.
        field: &'static str,
        /// Fault of the parameter.
        message: String,
    },
    /// The client is gone.
    Cancelled,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_out_of_range_are_refused() {
        assert_eq!([0, 1, 20_000, 20_001].map(|count| PathCount::new(count).is_some()), [false, true, true, false]);
        assert_eq!([0, 7, 8].map(|level| VoxelLevel::new(level).is_some()), [true, true, false]);
        assert_eq!([256, 257].map(|count| AxisPairs::new(vec![[0; 3]; count]).is_some()), [true, false]);
        for (upper, is_box) in [(1.0, true), (0.0, true), (-1.0, false), (f64::NAN, false), (f64::INFINITY, false)] {
            assert_eq!(Corners::new([[0.0; 3], [1.0, upper, 1.0]]).is_some(), is_box, "{upper}");
        }
    }
}
