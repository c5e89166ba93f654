//! Top-down builder: it evaluates every split of the centroids along every axis by surface area.
//!
//! The centroids are sorted once per axis. A split preserves the three orders by a stable partition, so a level costs linear time.
//! The two sides run in parallel, and the result does not depend on their order. It was chosen over obvhs' clustering with
//! reinsertion by measurement. Its trees trace 5 to 14 % more rays per second. Its time is bounded, while clustering takes
//! quadratic time for stacks of equal boxes. The price is a build time that is 1.5 times as long on one thread.

use crate::Aabb;

/// Minimum size of ranges that are split in parallel.
const PARALLEL: usize = 4096;
/// Depth below which ranges are halved. Otherwise nested boxes, each slightly larger than the last, would make a chain.
const MAX_SWEEP_DEPTH: u32 = 48;

/// A node. An inner node has its children at `first` and `first + 1`; a leaf contains primitive `first`.
#[derive(Clone, Copy, Debug)]
pub(super) struct BinaryNode {
    pub bounds: Aabb,
    pub first: u32,
    pub is_leaf: bool,
}

/// Builds a binary tree with one primitive per leaf; node 0 is the root. Without boxes there are no nodes.
pub(super) fn build(boxes: &[Aabb]) -> Vec<BinaryNode> {
    build_from(boxes, 0)
}

/// Builds a tree of minimum depth.
pub(super) fn build_balanced(boxes: &[Aabb]) -> Vec<BinaryNode> {
    build_from(boxes, MAX_SWEEP_DEPTH)
}

fn build_from(boxes: &[Aabb], depth: u32) -> Vec<BinaryNode> {
    let order = |axis: usize| {
        let mut order: Vec<u32> = (0..boxes.len() as u32).collect();
        let keys: Vec<f32> = boxes.iter().map(|b| b.center()[axis]).collect();
        order.sort_unstable_by(|&a, &b| compare_keys(&keys, a, b));
        order
    };
    let (mut x, (mut y, mut z)) = if boxes.len() < PARALLEL {
        (order(0), (order(1), order(2)))
    } else {
        rayon::join(|| order(0), || rayon::join(|| order(1), || order(2)))
    };
    let unset = BinaryNode { bounds: Aabb::EMPTY, first: 0, is_leaf: true };
    let mut nodes = vec![unset; (2 * boxes.len()).saturating_sub(1)];
    if let Some((root, below)) = nodes.split_first_mut() {
        PrimitiveRange { boxes, orders: [&mut x, &mut y, &mut z] }.split(root, below, 1, depth);
    }
    nodes
}

fn compare_keys(keys: &[f32], a: u32, b: u32) -> std::cmp::Ordering {
    keys[a as usize].total_cmp(&keys[b as usize]).then(a.cmp(&b))
}

/// A range of primitives, sorted by their centroids along each axis.
struct PrimitiveRange<'a> {
    boxes: &'a [Aabb],
    orders: [&'a mut [u32]; 3],
}

impl PrimitiveRange<'_> {
    /// Builds the subtree of this range: its root in `node`, the other 2 n - 2 nodes in `below`, whose first element is node number
    /// `first`.
    fn split(self, node: &mut BinaryNode, below: &mut [BinaryNode], first: u32, depth: u32) {
        let count = self.orders[0].len();
        let bounds = self.orders[0].iter().fold(Aabb::EMPTY, |b, &i| b.union(self.boxes[i as usize]));
        if count == 1 {
            *node = BinaryNode { bounds, first: self.orders[0][0], is_leaf: true };
            return;
        }
        *node = BinaryNode { bounds, first, is_leaf: false };
        let best = if depth < MAX_SWEEP_DEPTH { self.cheapest_split() } else { None };
        let (axis, left) = best.unwrap_or_else(|| (bounds.size().max_position(), count / 2));
        let (low, high) = self.partition(axis, left);
        let [low_node, high_node, rest @ ..] = below else { unreachable!("n > 1 primitives have 2 n - 2 nodes below") };
        let (low_below, high_below) = rest.split_at_mut(2 * left - 2);
        let (low_first, high_first) = (first + 2, first + 2 * left as u32);
        if count < PARALLEL {
            low.split(low_node, low_below, low_first, depth + 1);
            high.split(high_node, high_below, high_first, depth + 1);
        } else {
            rayon::join(
                || low.split(low_node, low_below, low_first, depth + 1),
                || high.split(high_node, high_below, high_first, depth + 1),
            );
        }
    }

    /// Returns the axis and the number of primitives on the left of the cheapest split, if a split is cheaper than none.
    fn cheapest_split(&self) -> Option<(usize, usize)> {
        let count = self.orders[0].len();
        let mut above = vec![0.0f32; count];
        let (mut least, mut best) = (f32::INFINITY, None);
        for (axis, order) in self.orders.iter().enumerate() {
            let mut b = Aabb::EMPTY;
            for (k, &i) in order.iter().enumerate().rev() {
                b = b.union(self.boxes[i as usize]);
                above[k] = b.half_area() * (count - k) as f32;
            }
            if axis == 0 {
                least = above[0];
            }
            let mut b = Aabb::EMPTY;
            for k in 1..count {
                b = b.union(self.boxes[order[k - 1] as usize]);
                let cost = b.half_area() * k as f32 + above[k];
                if cost < least {
                    (least, best) = (cost, Some((axis, k)));
                }
            }
        }
        best
    }
}

impl<'a> PrimitiveRange<'a> {
    /// Returns the first `left` primitives along `axis`, and the others, each sorted along all axes.
    fn partition(self, axis: usize, left: usize) -> (Self, Self) {
        let pivot = self.orders[axis][left];
        let key = |i: u32| self.boxes[i as usize].center()[axis];
        let pivot_key = key(pivot);
        let is_left = |i: u32| key(i).total_cmp(&pivot_key).then(i.cmp(&pivot)).is_lt();
        let mut spare = Vec::with_capacity(self.orders[axis].len() - left);
        let boxes = self.boxes;
        let [x, y, z] = self.orders.map(|order| {
            spare.clear();
            let mut kept = 0;
            for k in 0..order.len() {
                let i = order[k];
                if is_left(i) {
                    order[kept] = i;
                    kept += 1;
                } else {
                    spare.push(i);
                }
            }
            order[kept..].copy_from_slice(&spare);
            order.split_at_mut(left)
        });
        (PrimitiveRange { boxes, orders: [x.0, y.0, z.0] }, PrimitiveRange { boxes, orders: [x.1, y.1, z.1] })
    }
}
