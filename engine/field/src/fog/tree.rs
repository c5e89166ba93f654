//! Tree of boxes of fog.

use femc_math::Rgb;
use femc_math::glam::{DVec3, Vec3A};

/// A box of fog that is not split.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FogLeaf {
    /// Mean radiance from all directions, cd/m2, without direct light from light sources, at the center; and its change from one
    /// side to the other by axis.
    pub mean: [Rgb; 4],
    /// First-order change of the scattered radiance with direction, relative to the mean: the fog scatters the mean radiance times
    /// `1 + anisotropy.dot(w)`, but no less than a twentieth, toward a unit direction `w`.
    pub anisotropy: Vec3A,
    /// Mean scattering coefficient, 1/m.
    pub sigma_s: Rgb,
    /// Mean extinction coefficient, 1/m.
    pub sigma_t: Rgb,
}

impl FogLeaf {
    /// Maximum length of the anisotropy: all light comes from one direction, and is scattered straight ahead.
    const MAX_ANISOTROPY: f32 = 3.0;
    /// Minimum of [`FogLeaf::directional_factor`]. No phase function scatters nothing back.
    const MIN_FACTOR: f32 = 0.05;

    /// Returns the radiance that the fog scatters toward a unit direction, relative to the mean radiance.
    #[inline]
    pub(super) fn directional_factor(&self, toward: Vec3A) -> f32 {
        (1.0 + self.anisotropy.dot(toward)).max(Self::MIN_FACTOR)
    }

    /// Reduces the changes by channel until no point of the box has a negative value. The mean over the box does not change.
    pub fn limit_slopes(mut self) -> Self {
        let [middle, slopes @ ..] = &mut self.mean;
        *middle = middle.max(Rgb::ZERO);
        let most: Rgb = slopes.iter().map(|slope| slope.abs() * 0.5).sum();
        for axis in 0..3 {
            if most[axis] > middle[axis] {
                let scale = middle[axis] / most[axis];
                slopes.iter_mut().for_each(|slope| slope[axis] *= scale);
            }
        }
        self
    }

    /// Checks that it is finite and nowhere negative, up to rounding.
    fn is_valid(&self) -> bool {
        let [middle, slopes @ ..] = self.mean;
        let most: Rgb = slopes.iter().map(|slope| slope.abs() * 0.5).sum();
        let coefficients = [self.sigma_s, self.sigma_t];
        coefficients.iter().all(|sigma| sigma.is_finite() && sigma.cmpge(Rgb::ZERO).all())
            && middle.is_finite()
            && most.is_finite()
            && (most * (1.0 - 1e-5)).cmple(middle).all()
            && self.anisotropy.length() <= Self::MAX_ANISOTROPY * (1.0 + 1e-5)
            && (self.sigma_s.max_element() * (middle + most).max_element() * (1.0 + Self::MAX_ANISOTROPY)).is_finite()
    }
}

/// A box of fog.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum FogCell {
    /// A box that is split in two across an axis.
    Split {
        /// Axis: 0, 1 or 2.
        axis: u8,
        /// Coordinate of the split, prepared frame, m.
        at: f32,
    },
    /// A box that is not split.
    Leaf(FogLeaf),
}

/// A node in the form for traversal: the coordinate of its split, and the index of the lower half, times 4, plus the axis; plus 3
/// for a leaf.
#[derive(Clone, Copy, Debug)]
pub(super) struct Node {
    at: f32,
    next: u32,
}

/// Kind of a node.
pub(super) enum NodeKind {
    Split { axis: usize, at: f32, low: u32 },
    Leaf(u32),
}

impl Node {
    #[inline]
    pub(super) fn kind(self) -> NodeKind {
        match self.next & 3 {
            3 => NodeKind::Leaf(self.next >> 2),
            axis => NodeKind::Split { axis: axis as usize, at: self.at, low: self.next >> 2 },
        }
    }
}

/// A leaf with its position.
#[derive(Clone, Copy, Debug)]
pub(super) struct PlacedLeaf {
    pub(super) leaf: FogLeaf,
    /// Center, prepared frame, m.
    center: DVec3,
    /// One over its edges, 1/m; 0 for an edge of length 0.
    inverse: DVec3,
    /// Whether its extinction is equal for all channels.
    pub(super) is_gray: bool,
}

impl PlacedLeaf {
    /// Returns the mean radiance from all directions at a point of the box, cd/m2.
    #[inline]
    fn value_at(&self, point: DVec3) -> Rgb {
        let local = ((point - self.center) * self.inverse).as_vec3a();
        let [middle, x, y, z] = self.leaf.mean;
        (middle + x * local.x + y * local.y + z * local.z).max(Rgb::ZERO)
    }

    /// Returns the mean radiance at a point, not clamped at 0, and its change per m along a direction.
    #[inline]
    pub(super) fn value_and_slope(&self, point: DVec3, dir: DVec3) -> [Rgb; 2] {
        let [local, step] = [(point - self.center) * self.inverse, dir * self.inverse].map(|v| v.as_vec3a());
        let [middle, x, y, z] = self.leaf.mean;
        [middle + x * local.x + y * local.y + z * local.z, x * step.x + y * step.y + z * step.z]
    }
}

/// Boxes of fog inside one bounding box.
#[derive(Clone, Debug, Default)]
pub struct FogTree {
    pub(super) min: Vec3A,
    pub(super) max: Vec3A,
    pub(super) nodes: Vec<Node>,
    pub(super) leaves: Vec<PlacedLeaf>,
}

impl FogTree {
    /// Maximum number of boxes of a tree.
    const MAX_CELLS: usize = 1 << 29;

    /// Creates a tree.
    /// - `min`, `max`: corners of the bounding box, prepared frame, m;
    /// - `cells`: the bounding box first; the halves of all split boxes follow in the order of these, lower half first.
    /// - returns `None` if cells do not form such a tree, something is not finite, or light or a coefficient is negative.
    pub fn new([min, max]: [Vec3A; 2], cells: &[FogCell]) -> Option<Self> {
        let cuts = cells.iter().filter(|cell| matches!(cell, FogCell::Split { .. })).count();
        let sound = min.is_finite() && max.is_finite() && min.cmple(max).all() && cells.len() < Self::MAX_CELLS;
        if !sound || cells.len() != 2 * cuts + 1 {
            return None;
        }
        let mut tree = Self { min, max, nodes: Vec::with_capacity(cells.len()), leaves: Vec::with_capacity(cuts + 1) };
        let mut boxes = Vec::with_capacity(cells.len());
        boxes.push([min, max]);
        for (index, cell) in cells.iter().enumerate() {
            // If all boxes before are leaves, there is no box for this cell.
            let [min, max] = *boxes.get(index)?;
            match *cell {
                FogCell::Split { axis, at } => {
                    let axis = usize::from(axis);
                    if axis > 2 || !(min[axis]..=max[axis]).contains(&at) {
                        return None;
                    }
                    tree.nodes.push(Node { at, next: (boxes.len() as u32) << 2 | axis as u32 });
                    let (mut low_max, mut high_min) = (max, min);
                    (low_max[axis], high_min[axis]) = (at, at);
                    boxes.extend([[min, low_max], [high_min, max]]);
                }
                FogCell::Leaf(leaf) => {
                    if !leaf.is_valid() {
                        return None;
                    }
                    tree.nodes.push(Node { at: 0.0, next: (tree.leaves.len() as u32) << 2 | 3 });
                    let [min, max] = [min, max].map(|corner| corner.as_dvec3());
                    let edges = max - min;
                    let inverse =
                        DVec3::from_array([0, 1, 2].map(|k| if edges[k] > 0.0 { 1.0 / edges[k] } else { 0.0 }));
                    let sigma = leaf.sigma_t;
                    let is_gray = sigma.x == sigma.y && sigma.y == sigma.z;
                    tree.leaves.push(PlacedLeaf { leaf, center: 0.5 * (min + max), inverse, is_gray });
                }
            }
        }
        Some(tree)
    }

    /// Multiplies the light by a factor.
    pub(crate) fn scale(&mut self, factor: f32) {
        self.leaves.iter_mut().flat_map(|placed| &mut placed.leaf.mean).for_each(|light| *light *= factor);
    }

    /// Checks whether there are no boxes.
    pub fn is_empty(&self) -> bool {
        self.nodes.is_empty()
    }

    /// Returns the corners of the bounding box, prepared frame, m.
    pub fn bounds(&self) -> [Vec3A; 2] {
        [self.min, self.max]
    }

    /// Returns all boxes in the order of [`FogTree::new`].
    pub fn cells(&self) -> impl Iterator<Item = FogCell> + '_ {
        self.nodes.iter().map(|node| match node.kind() {
            NodeKind::Split { axis, at, .. } => FogCell::Split { axis: axis as u8, at },
            NodeKind::Leaf(index) => FogCell::Leaf(self.leaves[index as usize].leaf),
        })
    }

    /// Returns all boxes that are not split.
    pub fn leaves(&self) -> impl Iterator<Item = &FogLeaf> {
        self.leaves.iter().map(|placed| &placed.leaf)
    }

    /// Returns the number of bytes of the tree.
    pub fn memory(&self) -> usize {
        size_of_val(&*self.nodes) + size_of_val(&*self.leaves)
    }

    /// Returns the mean radiance from all directions at a point, cd/m2, without direct light from light sources; 0 outside of the
    /// boxes.
    pub fn mean_radiance(&self, point: Vec3A) -> Rgb {
        self.find(point).map_or(Rgb::ZERO, |placed| placed.value_at(point.as_dvec3()))
    }

    /// Returns the radiance that fog at a point scatters toward a unit direction, per scattering coefficient, cd/m2, without direct
    /// light from light sources; 0 outside of the boxes.
    pub fn scattered_radiance(&self, point: Vec3A, toward: Vec3A) -> Rgb {
        self.find(point)
            .map_or(Rgb::ZERO, |placed| placed.value_at(point.as_dvec3()) * placed.leaf.directional_factor(toward))
    }

    fn find(&self, point: Vec3A) -> Option<&PlacedLeaf> {
        self.leaf_at(point).map(|index| &self.leaves[index as usize])
    }

    /// Returns the index of the leaf that contains a point, in the order of [`Self::leaves`]. `None`: outside of the boxes.
    pub fn leaf_at(&self, point: Vec3A) -> Option<u32> {
        if self.nodes.is_empty() || point.cmplt(self.min).any() || point.cmpgt(self.max).any() {
            return None;
        }
        let place = point.to_array();
        let mut node = self.nodes[0];
        loop {
            match node.kind() {
                NodeKind::Split { axis, at, low } => node = self.nodes[low as usize + usize::from(place[axis] >= at)],
                NodeKind::Leaf(index) => return Some(index),
            }
        }
    }
}
