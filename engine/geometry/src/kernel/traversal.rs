//! Traversal of an eight-wide tree, nearest first or in any order.

use super::{
    local_ray::RayData,
    stack::{Entry, Stack},
};
use crate::tree::{Child, Node, Tree};
use femc_math::gamma;
use femc_simd::{Simd, Vector};

/// Leaf test of a nearest-first traversal.
pub(crate) trait NearestLeaf {
    /// Tests the leaf. Returns the distance beyond which hits no longer count.
    fn visit(&mut self, leaf: Child) -> f32;
}

/// Leaf test of an any-order traversal.
pub(crate) trait AnyLeaf {
    /// Tests the leaf. Returns whether it ends the traversal.
    fn visit(&mut self, leaf: Child) -> bool;
}

/// Ray data of the box test, broadcast to all lanes.
struct Slabs<V> {
    origin: [V; 3],
    inverse: [V; 3],
    near: [usize; 3],
    zero: V,
    widen: V,
}

impl<V: Vector> Slabs<V> {
    #[inline(always)]
    fn new<S: Simd<V = V>>(simd: S, ray: impl RayData) -> Self {
        Self {
            origin: [simd.splat(ray.origin(0)), simd.splat(ray.origin(1)), simd.splat(ray.origin(2))],
            inverse: [simd.splat(ray.inverse(0)), simd.splat(ray.inverse(1)), simd.splat(ray.inverse(2))],
            near: [ray.near(0), ray.near(1), ray.near(2)],
            zero: simd.splat(0.0),
            // Ize's bound for the rounding of both ends (\[ize2013\]): no box that the exact ray hits is missed.
            widen: simd.splat(1.0 + 2.0 * gamma(3)),
        }
    }

    /// Returns the bits of the boxes that the ray hits before `limit`, and the distances at which it enters them. Products of 0 and
    /// infinity (the ray lies in a plane of the box) are NaN, which the order of operands discards.
    #[inline(always)]
    fn test<S: Simd<V = V>>(&self, simd: S, node: &Node, limit: V) -> (u32, V) {
        let (mut enter, mut leave) = (self.zero, limit);
        for axis in 0..3 {
            let planes = &node.planes[axis];
            let near = simd.load(&planes[self.near[axis] & 1]);
            let far = simd.load(&planes[(self.near[axis] & 1) ^ 1]);
            enter = ((near - self.origin[axis]) * self.inverse[axis]).max(enter);
            leave = ((far - self.origin[axis]) * self.inverse[axis]).min(leave);
        }
        (enter.le(leave * self.widen).signs(), enter)
    }
}

/// Visits leaves roughly in order of their boxes' distances. Boxes beyond the limit are skipped.
#[inline(always)]
pub(crate) fn traverse_nearest_first<S: Simd>(
    simd: S,
    tree: &Tree,
    ray: impl RayData,
    limit: f32,
    leaf: &mut impl NearestLeaf,
) {
    let slabs = Slabs::new(simd, ray);
    let mut stack = Stack::new();
    let mut limit = limit;
    let mut wide_limit = simd.splat(limit);
    let mut current = tree.root;
    if current == Child::NONE {
        return;
    }
    loop {
        if current.is_node() {
            let node = &tree.nodes[current.index()];
            let (mask, distances) = slabs.test(simd, node, wide_limit);
            if mask & mask.wrapping_sub(1) == 0 {
                if mask != 0 {
                    current = node.children[mask.trailing_zeros() as usize & 7];
                    continue;
                }
            } else {
                let count = stack.push(simd, mask, distances, &node.children);
                stack.sort_top(count);
            }
        } else {
            limit = leaf.visit(current);
            wide_limit = simd.splat(limit);
        }
        current = loop {
            match stack.pop() {
                None => return,
                Some(entry) if entry.distance() <= limit * (1.0 + 2.0 * gamma(3)) => break Entry::child(entry),
                Some(_) => {}
            }
        };
    }
}

/// Visits leaves whose boxes the ray hits before `limit`, until one ends the traversal. Returns whether one did.
#[inline(always)]
pub(crate) fn traverse_any<S: Simd>(
    simd: S,
    tree: &Tree,
    ray: impl RayData,
    limit: f32,
    leaf: &mut impl AnyLeaf,
) -> bool {
    let slabs = Slabs::new(simd, ray);
    let mut stack = Stack::new();
    let limit = simd.splat(limit);
    let mut current = tree.root;
    if current == Child::NONE {
        return false;
    }
    loop {
        if current.is_node() {
            let node = &tree.nodes[current.index()];
            let (mask, distances) = slabs.test(simd, node, limit);
            stack.push(simd, mask, distances, &node.children);
        } else if leaf.visit(current) {
            return true;
        }
        match stack.pop() {
            None => return false,
            Some(entry) => current = entry.child(),
        }
    }
}
