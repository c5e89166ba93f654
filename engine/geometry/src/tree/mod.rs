//! Eight-wide trees over boxes.
//!
//! A binary tree ([`sweep`]) is cut into nodes of up to eight children, and subtrees of up to eight triangles become one leaf
//! block. Dynamic programming over the surface area cost selects the cuts (\[ylitie2017\]). Nodes store full floats in a structure
//! of arrays, 256 bytes. This takes more memory than compressed nodes, but a box test takes three vector operations per plane pair
//! and no decoding.

mod collapse;
mod sweep;

pub(crate) use collapse::{LeafRule, collapse};

use crate::Aabb;

/// Eight numbers, one for each child or triangle. [`WIDTH`] is the maximum number of children of a node and of triangles in a leaf.
pub(crate) use femc_simd::{Lanes, WIDTH};

/// Maximum number of entries of a traversal's stack.
pub(crate) const STACK_CAPACITY: usize = 384;

/// A reference to a child: a node, or a leaf of one of two kinds.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
#[repr(transparent)]
pub(crate) struct Child(pub u32);

impl Child {
    const LEAF: u32 = 1 << 31;
    const SECOND: u32 = 1 << 30;
    const INDEX: u32 = Self::SECOND - 1;
    /// No child: for a tree without primitives.
    pub const NONE: Self = Self(u32::MAX);

    pub fn node(index: usize) -> Self {
        debug_assert!(index < Self::INDEX as usize);
        Self(index as u32)
    }

    /// Returns a leaf of the first kind: a block of triangles, or an instance.
    pub fn first_kind(index: usize) -> Self {
        debug_assert!(index < Self::INDEX as usize);
        Self(Self::LEAF | index as u32)
    }

    /// Returns a leaf of the second kind: a shape.
    pub fn second_kind(index: usize) -> Self {
        debug_assert!(index < Self::INDEX as usize);
        Self(Self::LEAF | Self::SECOND | index as u32)
    }

    #[inline(always)]
    pub fn is_node(self) -> bool {
        self.0 < Self::LEAF
    }

    #[inline(always)]
    pub fn is_second_kind(self) -> bool {
        self.0 & Self::SECOND != 0
    }

    #[inline(always)]
    pub fn index(self) -> usize {
        (self.0 & Self::INDEX) as usize
    }
}

/// Eight boxes and their children. Unused slots contain empty boxes, which no ray hits.
#[derive(Clone, Debug)]
#[repr(C, align(64))]
pub(crate) struct Node {
    /// Planes by axis, then the least and the greatest.
    pub planes: [[Lanes; 2]; 3],
    pub children: [Child; WIDTH],
}

impl Node {
    fn new() -> Self {
        Self {
            planes: [[Lanes([f32::INFINITY; WIDTH]), Lanes([f32::NEG_INFINITY; WIDTH])]; 3],
            children: [Child::NONE; WIDTH],
        }
    }

    fn set(&mut self, slot: usize, bounds: &Aabb, child: Child) {
        for axis in 0..3 {
            self.planes[axis][0].0[slot] = bounds.min[axis];
            self.planes[axis][1].0[slot] = bounds.max[axis];
        }
        self.children[slot] = child;
    }
}

/// An eight-wide tree. [`collapse`] ensures that traversal needs at most [`STACK_CAPACITY`] entries.
#[derive(Clone, Debug)]
pub(crate) struct Tree {
    pub nodes: Vec<Node>,
    pub root: Child,
    pub bounds: Aabb,
}
