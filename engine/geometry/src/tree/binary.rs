//! Binary trees as the collapse wants them, and how they are made.

use super::sweep;
use crate::Aabb;
use femc_math::glam::Vec3A;
use obvhs::{
    bvh2::reinsertion::ReinsertionOptimizer,
    ploc::{PlocBuilder, PlocSearchDistance, SortPrecision},
};

/// Inputs up to this size are split by the exact sweep: better trees, at a cost that only small inputs can bear.
const SWEEP_LIMIT: usize = 1024;

/// A node: an inner one has its children at `first` and `first + 1`; a leaf holds primitive `first`.
#[derive(Clone, Copy, Debug)]
pub(super) struct BinaryNode {
    pub bounds: Aabb,
    pub first: u32,
    pub is_leaf: bool,
}

/// A binary tree with one primitive a leaf; node 0 is the root. Never empty.
pub(super) struct Binary {
    pub nodes: Vec<BinaryNode>,
}

impl Binary {
    /// A tree by surface area cost. A pure function of `boxes`: the number of threads does not matter.
    pub fn build(boxes: &[Aabb]) -> Self {
        if boxes.len() <= SWEEP_LIMIT {
            return Self { nodes: sweep::build(boxes) };
        }
        // obvhs sorts with all of rayon's threads, and the order of equal keys may depend on their number; one thread fixes it.
        match rayon::ThreadPoolBuilder::new().num_threads(1).build() {
            Ok(single) => single.install(|| Self::build_large(boxes)),
            Err(_) => Self { nodes: sweep::build(boxes) },
        }
    }

    /// A tree of least depth.
    pub fn build_balanced(boxes: &[Aabb]) -> Self {
        Self { nodes: sweep::build_balanced(boxes) }
    }

    fn build_large(boxes: &[Aabb]) -> Self {
        let boxes: Vec<obvhs::aabb::Aabb> = boxes.iter().map(|b| obvhs::aabb::Aabb::new(b.min, b.max)).collect();
        let indices = (0..boxes.len() as u32).collect();
        let mut builder = PlocBuilder::with_capacity(boxes.len());
        let mut tree = builder.build(PlocSearchDistance::Medium, &boxes, indices, SortPrecision::U64, 3);
        ReinsertionOptimizer::default().run(&mut tree, 0.05, None);
        let node = |n: &obvhs::bvh2::node::Bvh2Node| {
            let (min, max): (Vec3A, Vec3A) = (n.aabb().min, n.aabb().max);
            let is_leaf = n.is_leaf();
            let first = if is_leaf { tree.primitive_indices[n.first_index as usize] } else { n.first_index };
            BinaryNode { bounds: Aabb { min, max }, first, is_leaf }
        };
        Self { nodes: tree.nodes.iter().map(node).collect() }
    }
}
