//! Conversion of a binary tree to an eight-wide one.

use super::{
    Child, Node, STACK_CAPACITY, Tree, WIDTH,
    sweep::{self, BinaryNode},
};
use crate::Aabb;

/// Rule for leaves: the allowed primitives, and the cost in units of a node's test.
pub(crate) trait LeafRule {
    /// Returns whether primitives `a` and `b` may lie in one leaf (an equivalence relation).
    fn may_share(&self, a: u32, b: u32) -> bool;
    /// Returns the maximum number of primitives in a leaf that contains primitive `a`.
    fn max_primitives(&self, a: u32) -> usize;
    /// Returns the cost of testing a leaf of `count` primitives like `a`.
    fn cost(&self, a: u32, count: usize) -> f32;
    /// Creates a leaf of `primitives`.
    fn leaf(&mut self, primitives: &[u32]) -> Child;
    /// Discards all created leaves.
    fn clear(&mut self);
}

/// Builds a tree over `boxes`. `rule` creates the leaves, in the order in which a traversal meets them.
pub(crate) fn collapse(boxes: &[Aabb], rule: &mut impl LeafRule) -> Tree {
    if boxes.is_empty() {
        return Tree { nodes: Vec::new(), root: Child::NONE, bounds: Aabb::EMPTY };
    }
    let tree = Plan::new(&sweep::build(boxes), rule).emit(rule);
    if stack_need(&tree) <= STACK_CAPACITY {
        return tree;
    }
    // A degenerate input produced a chain. The balanced tree is slower to trace, but never deep: fewer than 32 levels of at most 8
    // entries.
    rule.clear();
    Plan::new(&sweep::build_balanced(boxes), rule).emit(rule)
}

/// Returns the maximum number of entries on the stack of a traversal, including the spare ones that a wide store touches.
fn stack_need(tree: &Tree) -> usize {
    let mut need = vec![0usize; tree.nodes.len()];
    for (index, node) in tree.nodes.iter().enumerate().rev() {
        let used = node.children.iter().filter(|c| **c != Child::NONE);
        let below = used.clone().filter(|c| c.is_node()).map(|c| need[c.index()]).max().unwrap_or(0);
        need[index] = used.count() + below;
    }
    need.first().copied().unwrap_or(0) + WIDTH
}

/// Optimal use of the subtree of a binary node.
#[derive(Clone, Copy)]
struct Choice {
    /// Least cost of the subtree as at most `i + 1` children of a wide node.
    cost: [f32; WIDTH - 1],
    /// Entry `i`: number of children of the left subtree when this one becomes `i + 1` children; 0 if that is no better than `i`
    /// children. Entry 0 is for a separate node with `WIDTH` children.
    left: [u8; WIDTH - 1],
    /// Number of primitives below; 0 if they cannot share a leaf.
    shareable: u32,
    /// Any primitive below.
    sample: u32,
    is_leaf: bool,
}

impl Choice {
    fn single(primitive: u32, cost: f32) -> Self {
        Self { cost: [cost; WIDTH - 1], left: [0; WIDTH - 1], shareable: 1, sample: primitive, is_leaf: true }
    }

    /// Returns the choice for a node of half area `area` from those of its children.
    fn join(l: &Self, r: &Self, area: f32, rule: &impl LeafRule) -> Self {
        let distribute = |total: usize| {
            let split = |left: usize| l.cost[left - 1] + r.cost[total - left - 1];
            let first = total.saturating_sub(WIDTH - 1).max(1);
            let mut best = (split(first), first);
            for left in first + 1..=(total - 1).min(WIDTH - 1) {
                if split(left) < best.0 {
                    best = (split(left), left);
                }
            }
            best
        };
        let count = (l.shareable + r.shareable) as usize;
        let may_share = l.shareable > 0 && r.shareable > 0 && rule.may_share(l.sample, r.sample);
        let shareable = if may_share && count <= rule.max_primitives(l.sample) { count as u32 } else { 0 };
        let (below, left) = distribute(WIDTH);
        let mut choice =
            Self { cost: [below + area; WIDTH - 1], left: [0; WIDTH - 1], shareable, sample: l.sample, is_leaf: false };
        choice.left[0] = left as u8;
        if shareable > 0 {
            let leaf = area * rule.cost(l.sample, count);
            if leaf <= choice.cost[0] {
                choice.cost = [leaf; WIDTH - 1];
                choice.is_leaf = true;
            }
        }
        for i in 1..WIDTH - 1 {
            choice.cost[i] = choice.cost[i - 1];
            let (cost, left) = distribute(i + 1);
            if cost < choice.cost[i] {
                choice.cost[i] = cost;
                choice.left[i] = left as u8;
            }
        }
        choice
    }
}

struct Plan<'a> {
    binary: &'a [BinaryNode],
    choices: Vec<Choice>,
}

impl<'a> Plan<'a> {
    fn new(binary: &'a [BinaryNode], rule: &impl LeafRule) -> Self {
        let nodes = binary;
        // Parents before children.
        let mut order = Vec::with_capacity(nodes.len());
        let mut pending = vec![0u32];
        while let Some(index) = pending.pop() {
            order.push(index);
            let node = &nodes[index as usize];
            if !node.is_leaf {
                pending.extend([node.first + 1, node.first]);
            }
        }
        let mut choices = vec![Choice::single(0, 0.0); nodes.len()];
        for &index in order.iter().rev() {
            let node = &nodes[index as usize];
            let area = node.bounds.half_area();
            choices[index as usize] = if node.is_leaf {
                Choice::single(node.first, area * rule.cost(node.first, 1))
            } else {
                let (l, r) = (node.first as usize, node.first as usize + 1);
                Choice::join(&choices[l], &choices[r], area, rule)
            };
        }
        Self { binary, choices }
    }

    /// Collects the binary nodes that become children when `index` becomes at most `slots` children.
    fn children(&self, index: u32, mut slots: usize, found: &mut Vec<u32>) {
        let choice = &self.choices[index as usize];
        while slots > 1 && choice.left[slots - 1] == 0 {
            slots -= 1;
        }
        if slots == 1 {
            found.push(index);
        } else {
            let (first, left) = (self.binary[index as usize].first, usize::from(choice.left[slots - 1]));
            self.children(first, left, found);
            self.children(first + 1, slots - left, found);
        }
    }

    fn primitives(&self, index: u32) -> Vec<u32> {
        let mut found = Vec::with_capacity(WIDTH);
        let mut pending = vec![index];
        while let Some(index) = pending.pop() {
            let node = &self.binary[index as usize];
            if node.is_leaf { found.push(node.first) } else { pending.extend([node.first + 1, node.first]) }
        }
        found.sort_unstable();
        found
    }

    fn emit(&self, rule: &mut impl LeafRule) -> Tree {
        let bounds = self.binary[0].bounds;
        if self.choices[0].is_leaf {
            return Tree { nodes: Vec::new(), root: rule.leaf(&self.primitives(0)), bounds };
        }
        let mut nodes = vec![Node::new()];
        let mut pending = vec![(0usize, 0u32)];
        let mut found = Vec::with_capacity(WIDTH);
        while let Some((wide, index)) = pending.pop() {
            found.clear();
            let (first, left) = (self.binary[index as usize].first, usize::from(self.choices[index as usize].left[0]));
            self.children(first, left, &mut found);
            self.children(first + 1, WIDTH - left, &mut found);
            // An any-order traversal pops the last slot first: leaves before nodes, and large boxes, which are more likely hits,
            // before small ones.
            found.sort_by(|&a, &b| {
                let key = |i: u32| (self.choices[i as usize].is_leaf, self.binary[i as usize].bounds.half_area());
                let (ka, kb) = (key(a), key(b));
                ka.0.cmp(&kb.0).then(ka.1.total_cmp(&kb.1))
            });
            let inner = pending.len();
            for (slot, &below) in found.iter().enumerate() {
                let child = if self.choices[below as usize].is_leaf {
                    rule.leaf(&self.primitives(below))
                } else {
                    nodes.push(Node::new());
                    pending.push((nodes.len() - 1, below));
                    Child::node(nodes.len() - 1)
                };
                nodes[wide].set(slot, &self.binary[below as usize].bounds, child);
            }
            pending[inner..].reverse();
        }
        Tree { nodes, root: Child::node(0), bounds }
    }
}
