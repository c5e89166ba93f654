//! Axis-aligned boxes, and a tree that finds boxes near a box or along a ray.

use femc_math::Transform;
use femc_math::glam::{BVec3, DVec3};
use std::ops::ControlFlow;

/// Maximum number of boxes in a leaf.
const LEAF: usize = 4;

/// An axis-aligned box.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Bounds {
    pub min: DVec3,
    pub max: DVec3,
}

impl Bounds {
    pub const EMPTY: Self = Self { min: DVec3::INFINITY, max: DVec3::NEG_INFINITY };

    pub fn from_points(points: impl IntoIterator<Item = DVec3>) -> Self {
        points.into_iter().fold(Self::EMPTY, |bounds, p| Self { min: bounds.min.min(p), max: bounds.max.max(p) })
    }

    /// Returns the bounds of the transformed box.
    pub fn transformed(&self, transform: &Transform) -> Self {
        if self.is_empty() {
            return *self;
        }
        let corner = |i: u8| DVec3::select(BVec3::new(i & 1 > 0, i & 2 > 0, i & 4 > 0), self.max, self.min);
        Self::from_points((0..8).map(|i| transform.transform_point3(corner(i))))
    }

    pub fn union(self, other: Self) -> Self {
        Self { min: self.min.min(other.min), max: self.max.max(other.max) }
    }

    pub fn is_empty(&self) -> bool {
        !self.min.cmple(self.max).all()
    }

    pub fn grown(self, margin: f64) -> Self {
        Self { min: self.min - margin, max: self.max + margin }
    }

    pub fn overlaps(&self, other: &Self) -> bool {
        self.min.cmple(other.max).all() && other.min.cmple(self.max).all()
    }

    pub fn center(&self) -> DVec3 {
        0.5 * (self.min + self.max)
    }

    /// Returns the length of the diagonal; 0 when empty.
    pub fn diagonal(&self) -> f64 {
        if self.is_empty() { 0.0 } else { (self.max - self.min).length() }
    }

    /// Returns the largest absolute coordinate; 0 when empty.
    pub fn magnitude(&self) -> f64 {
        if self.is_empty() { 0.0 } else { self.min.abs().max(self.max.abs()).max_element() }
    }
}

/// A binary tree of boxes, split at the median of the longest axis.
#[derive(Default)]
pub(crate) struct BoxTree {
    nodes: Vec<Node>,
    /// Box numbers; those of a leaf are adjacent.
    order: Vec<u32>,
    boxes: Vec<Bounds>,
}

struct Node {
    bounds: Bounds,
    /// Boxes of a leaf in `order`. Empty for an inner node; its first child is the next node.
    first: u32,
    count: u32,
    second_child: u32,
}

impl BoxTree {
    pub fn new(boxes: &[Bounds]) -> Self {
        let order = (0..boxes.len() as u32).collect();
        let mut tree = Self { nodes: Vec::new(), order, boxes: boxes.to_vec() };
        if !boxes.is_empty() {
            tree.build(0, boxes.len());
        }
        tree
    }

    fn build(&mut self, first: usize, end: usize) {
        let boxes = &self.boxes;
        let bounds = self.order[first..end].iter().map(|&i| boxes[i as usize]).fold(Bounds::EMPTY, Bounds::union);
        let node = self.nodes.len();
        self.nodes.push(Node { bounds, first: first as u32, count: (end - first) as u32, second_child: 0 });
        if end - first <= LEAF {
            return;
        }
        let axis = (bounds.max - bounds.min).max_position();
        let center = |i: u32| boxes[i as usize].min[axis] + boxes[i as usize].max[axis];
        let middle = (end - first) / 2;
        self.order[first..end].select_nth_unstable_by(middle, |&a, &b| center(a).total_cmp(&center(b)).then(a.cmp(&b)));
        self.nodes[node].count = 0;
        self.build(first, first + middle);
        self.nodes[node].second_child = self.nodes.len() as u32;
        self.build(first + middle, end);
    }

    /// Calls `visit` with the number of every box that the ray hits before `far`. `visit` returns the new `far`, which it may
    /// shorten.
    pub fn visit_along_ray(&self, origin: DVec3, dir: DVec3, mut far: f64, mut visit: impl FnMut(usize, f64) -> f64) {
        let inverse = dir.recip();
        let meets = |bounds: &Bounds, far: f64| {
            let (a, b) = ((bounds.min - origin) * inverse, (bounds.max - origin) * inverse);
            // If a direction component is 0 and the origin is on the plane, the quotient is NaN. `min` and `max` then return the
            // other value.
            let (near, end) = (a.min(b).max_element(), a.max(b).min_element());
            near.max(0.0) <= end.min(far)
        };
        let mut open = if self.nodes.is_empty() { Vec::new() } else { vec![0] };
        while let Some(index) = open.pop() {
            let node = &self.nodes[index as usize];
            if !meets(&node.bounds, far) {
                continue;
            }
            if node.count == 0 {
                open.extend([node.second_child, index + 1]);
            }
            for &number in &self.order[node.first as usize..(node.first + node.count) as usize] {
                far = visit(number as usize, far);
            }
        }
    }

    /// Calls `visit` with the number of every box that overlaps `near`, in the order of the tree, until `visit` breaks.
    pub fn visit_overlapping(&self, near: &Bounds, mut visit: impl FnMut(usize) -> ControlFlow<()>) -> ControlFlow<()> {
        let mut open = if self.nodes.is_empty() { Vec::new() } else { vec![0] };
        while let Some(index) = open.pop() {
            let node = &self.nodes[index as usize];
            if !node.bounds.overlaps(near) {
                continue;
            }
            if node.count == 0 {
                open.extend([node.second_child, index + 1]);
            }
            for &number in &self.order[node.first as usize..(node.first + node.count) as usize] {
                if self.boxes[number as usize].overlaps(near) {
                    visit(number as usize)?;
                }
            }
        }
        ControlFlow::Continue(())
    }
}
