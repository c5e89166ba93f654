//! A tree of boxes of fog.

use femc_math::Rgb;
use femc_math::glam::{DVec3, Vec3A};

/// A box of fog that is not cut further.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FogLeaf {
    /// Mean radiance from all around, cd/m2, without what comes straight from light sources, at the middle; and its change from one
    /// side to the other by axis.
    pub mean: [Rgb; 4],
    /// Mean scattering coefficient, 1/m.
    pub sigma_s: Rgb,
    /// Mean extinction coefficient, 1/m.
    pub sigma_t: Rgb,
}

impl FogLeaf {
    /// The same with changes that are so small, by channel, that no point of the box has less than nothing. The mean over the box
    /// stays.
    pub fn limited(mut self) -> Self {
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

    /// Whether it is finite and nowhere less than nothing, but for rounding.
    fn is_sound(&self) -> bool {
        let [middle, slopes @ ..] = self.mean;
        let most: Rgb = slopes.iter().map(|slope| slope.abs() * 0.5).sum();
        let coefficients = [self.sigma_s, self.sigma_t];
        coefficients.iter().all(|sigma| sigma.is_finite() && sigma.cmpge(Rgb::ZERO).all())
            && middle.is_finite()
            && most.is_finite()
            && (most * (1.0 - 1e-5)).cmple(middle).all()
            && (self.sigma_s.max_element() * (middle + most).max_element()).is_finite()
    }
}

/// A box of fog.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum FogCell {
    /// One that is cut in two across an axis.
    Cut {
        /// 0, 1 or 2.
        axis: u8,
        /// Coordinate of the cut, prepared frame, m.
        at: f32,
    },
    /// One that is not.
    Leaf(FogLeaf),
}

/// A node as it is walked: the coordinate of its cut, and index of the lower half, times 4, plus the axis; of a leaf plus 3.
#[derive(Clone, Copy, Debug)]
pub(super) struct Node {
    at: f32,
    next: u32,
}

/// What a node is.
pub(super) enum Kind {
    Cut { axis: usize, at: f32, low: u32 },
    Leaf(u32),
}

impl Node {
    #[inline]
    pub(super) fn kind(self) -> Kind {
        match self.next & 3 {
            3 => Kind::Leaf(self.next >> 2),
            axis => Kind::Cut { axis: axis as usize, at: self.at, low: self.next >> 2 },
        }
    }
}

/// A leaf and where it is.
#[derive(Clone, Copy, Debug)]
pub(super) struct Placed {
    pub(super) leaf: FogLeaf,
    /// Middle, prepared frame, m.
    center: DVec3,
    /// One over its edges, 1/m; 0 where it has none.
    inverse: DVec3,
    /// Whether its extinction is the same for all channels.
    pub(super) is_gray: bool,
}

impl Placed {
    /// Mean radiance from all around at a point of the box, cd/m2.
    #[inline]
    fn at(&self, point: DVec3) -> Rgb {
        let local = ((point - self.center) * self.inverse).as_vec3a();
        let [middle, x, y, z] = self.leaf.mean;
        (middle + x * local.x + y * local.y + z * local.z).max(Rgb::ZERO)
    }

    /// The same, not cut off at 0, and its change per m along a direction.
    #[inline]
    pub(super) fn along(&self, point: DVec3, dir: DVec3) -> [Rgb; 2] {
        let [local, step] = [(point - self.center) * self.inverse, dir * self.inverse].map(|v| v.as_vec3a());
        let [middle, x, y, z] = self.leaf.mean;
        [middle + x * local.x + y * local.y + z * local.z, x * step.x + y * step.y + z * step.z]
    }
}

/// Boxes of fog within one that holds all.
#[derive(Clone, Debug, Default)]
pub struct FogTree {
    pub(super) min: Vec3A,
    pub(super) max: Vec3A,
    pub(super) nodes: Vec<Node>,
    pub(super) leaves: Vec<Placed>,
}

impl FogTree {
    /// Most boxes of a tree.
    const MOST: usize = 1 << 29;

    /// - `min`, `max`: corners of the box that holds all, prepared frame, m;
    /// - `cells`: that box first; the halves of all that are cut follow in the order of these, lower half first.
    /// - returns `None` where cells are no such tree, something is not finite, or light or a coefficient is negative.
    pub fn new([min, max]: [Vec3A; 2], cells: &[FogCell]) -> Option<Self> {
        let cuts = cells.iter().filter(|cell| matches!(cell, FogCell::Cut { .. })).count();
        let sound = min.is_finite() && max.is_finite() && min.cmple(max).all() && cells.len() < Self::MOST;
        if !sound || cells.len() != 2 * cuts + 1 {
            return None;
        }
        let mut tree = Self { min, max, nodes: Vec::with_capacity(cells.len()), leaves: Vec::with_capacity(cuts + 1) };
        let mut boxes = Vec::with_capacity(cells.len());
        boxes.push([min, max]);
        for (index, cell) in cells.iter().enumerate() {
            // Where all boxes before are leaves there is none for this one.
            let [min, max] = *boxes.get(index)?;
            match *cell {
                FogCell::Cut { axis, at } => {
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
                    if !leaf.is_sound() {
                        return None;
                    }
                    tree.nodes.push(Node { at: 0.0, next: (tree.leaves.len() as u32) << 2 | 3 });
                    let [min, max] = [min, max].map(|corner| corner.as_dvec3());
                    let edges = max - min;
                    let inverse =
                        DVec3::from_array([0, 1, 2].map(|k| if edges[k] > 0.0 { 1.0 / edges[k] } else { 0.0 }));
                    let sigma = leaf.sigma_t;
                    let is_gray = sigma.x == sigma.y && sigma.y == sigma.z;
                    tree.leaves.push(Placed { leaf, center: 0.5 * (min + max), inverse, is_gray });
                }
            }
        }
        Some(tree)
    }

    /// Light times a factor.
    pub(crate) fn scale(&mut self, factor: f32) {
        self.leaves.iter_mut().flat_map(|placed| &mut placed.leaf.mean).for_each(|light| *light *= factor);
    }

    /// Whether there are no boxes.
    pub fn is_empty(&self) -> bool {
        self.nodes.is_empty()
    }

    /// Corners of the box that holds all, prepared frame, m.
    pub fn bounds(&self) -> [Vec3A; 2] {
        [self.min, self.max]
    }

    /// All boxes in the order of [`FogTree::new`].
    pub fn cells(&self) -> impl Iterator<Item = FogCell> + '_ {
        self.nodes.iter().map(|node| match node.kind() {
            Kind::Cut { axis, at, .. } => FogCell::Cut { axis: axis as u8, at },
            Kind::Leaf(index) => FogCell::Leaf(self.leaves[index as usize].leaf),
        })
    }

    /// All boxes that are not cut.
    pub fn leaves(&self) -> impl Iterator<Item = &FogLeaf> {
        self.leaves.iter().map(|placed| &placed.leaf)
    }

    /// Bytes that it takes.
    pub fn memory(&self) -> usize {
        size_of_val(&*self.nodes) + size_of_val(&*self.leaves)
    }

    /// Mean radiance from all around a point, cd/m2, without what comes straight from light sources; 0 outside of the boxes.
    pub fn mean_radiance(&self, point: Vec3A) -> Rgb {
        self.find(point).map_or(Rgb::ZERO, |placed| placed.at(point.as_dvec3()))
    }

    fn find(&self, point: Vec3A) -> Option<&Placed> {
        if self.nodes.is_empty() || point.cmplt(self.min).any() || point.cmpgt(self.max).any() {
            return None;
        }
        let place = point.to_array();
        let mut node = self.nodes[0];
        loop {
            match node.kind() {
                Kind::Cut { axis, at, low } => node = self.nodes[low as usize + usize::from(place[axis] >= at)],
                Kind::Leaf(index) => return Some(&self.leaves[index as usize]),
            }
        }
    }
}
