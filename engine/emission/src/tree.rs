//! Choice of one light among many, in proportion to a bound on the light that each may send to a place.
//!
//! The lights form a binary tree (\[conty2018\]). A node stores the sphere around its lights, the cone of their normals and their
//! power. A place (a point, or a segment of a ray in fog) gives every node an importance. The choice starts among the nodes that
//! are small as seen from the place ([`TreeCut`]). From one of them it descends, each time in proportion to the importance. A light
//! has probability zero only if it can send nothing.
//!
//! Importances are bounds where that matters (a light that faces a place is never lost) and estimates elsewhere. With
//! [`LightTree::probability_from`] for the weights, the choice is unbiased for any importances.

mod build;
mod importance;

use crate::light::EmissionCone;
use arrayvec::ArrayVec;
use build::{Cluster, partition_leaves};
use femc_math::glam::Vec3A;

pub use importance::{BsdfLobes, Node, NodeImportance, PointContext, SegmentContext};

/// Depth below which nodes are split in the middle, which limits the depth of the tree.
const MAX_SAOH_DEPTH: u32 = 32;
/// Nodes whose middle is nearer than this multiple of their radius are opened before the choice starts: inside or near its sphere,
/// a node says almost nothing about the distances of its lights.
const OPENING_RATIO: f32 = 2.0;
/// Maximum number of nodes among which a choice starts.
const MAX_CUT: usize = 32;
/// Child index that marks a leaf; its light's index is stored beside it.
const LEAF: u32 = u32::MAX;
/// Rank of a light without power.
const ABSENT: u32 = u32::MAX;

/// Properties of a light that the tree uses.
#[derive(Clone, Copy, Debug)]
pub struct LightBounds {
    /// Lower corner of the bounding box, m.
    pub low: Vec3A,
    /// Upper corner of the bounding box, m.
    pub high: Vec3A,
    /// A point in the middle, m; for a flat light, it lies in its plane.
    pub center: Vec3A,
    /// Luminous flux, lm.
    pub power: f32,
    /// Extinction of the media around the light, 1/m; it makes far lights less important.
    pub extinction: f32,
    /// Bound on normals and emission.
    pub cone: EmissionCone,
}

/// A binary tree of lights.
#[derive(Clone, Debug, Default)]
pub struct LightTree {
    nodes: Vec<Node>,
    /// Rank of each light among the leaves from left to right; [`ABSENT`] if it is not in the tree.
    ranks: Vec<u32>,
    /// Node of each rank.
    leaves: Vec<u32>,
}

impl LightTree {
    /// Builds a tree over `lights`; choices return indices into them. Lights without power, or with bounds that are not finite, are
    /// left out and never chosen.
    pub fn new(lights: &[LightBounds]) -> Self {
        let has_power = |l: &LightBounds| l.power > 0.0 && l.power.is_finite() && (l.low + l.high).is_finite();
        let mut leaves: Vec<Cluster> = (0..lights.len() as u32)
            .zip(lights)
            .filter(|(_, light)| has_power(light))
            .map(|(index, light)| Cluster::new(light, index))
            .collect();
        let mut tree = Self { nodes: Vec::new(), ranks: vec![ABSENT; lights.len()], leaves: vec![0; leaves.len()] };
        if !leaves.is_empty() {
            tree.nodes.reserve(2 * leaves.len() - 1);
            tree.nodes.push(Node::PLACEHOLDER);
            tree.build(0, &mut leaves, 0, 0);
        }
        tree
    }

    /// Builds the subtree of `leaves` at node `at`.
    /// - `first`: rank of the first of the leaves.
    fn build(&mut self, at: usize, leaves: &mut [Cluster], first: u32, depth: u32) {
        let ranks = (first, leaves.len() as u32);
        let whole = leaves.iter().skip(1).fold(leaves[0], |all, leaf| all.join(leaf));
        if let [leaf] = leaves {
            self.nodes[at] = Node { ranks, ..whole.node(LEAF, leaf.light) };
            self.ranks[leaf.light as usize] = first;
            self.leaves[first as usize] = at as u32;
            return;
        }
        let middle = if depth < MAX_SAOH_DEPTH { partition_leaves(&whole, leaves) } else { leaves.len() / 2 };
        let children = self.nodes.len();
        self.nodes.push(Node::PLACEHOLDER);
        self.nodes.push(Node::PLACEHOLDER);
        self.nodes[at] = Node { ranks, ..whole.node(children as u32, 0) };
        let (left, right) = leaves.split_at_mut(middle);
        self.build(children, left, first, depth + 1);
        self.build(children + 1, right, first + middle as u32, depth + 1);
    }

    /// Returns the probability of the first child of a node; `None` if neither can send anything.
    #[inline]
    fn first_child_probability(&self, children: u32, context: &impl NodeImportance) -> Option<f64> {
        let pair = &self.nodes[children as usize..children as usize + 2];
        let (a, b) = (f64::from(context.importance(&pair[0])), f64::from(context.importance(&pair[1])));
        let share = a / (a + b);
        (share.is_finite()).then_some(share)
    }

    /// Returns the nodes among which a choice for `context` starts: those that are small as seen from there, breadth first.
    #[inline]
    pub fn cut_for(&self, context: &impl NodeImportance) -> TreeCut {
        let mut cut = TreeCut { nodes: ArrayVec::new(), total: 0.0 };
        let mut queue = ArrayVec::<u32, { 2 * MAX_CUT }>::new();
        queue.extend((!self.nodes.is_empty()).then_some(0));
        let (mut at, mut parts) = (0, 1);
        while let Some(&index) = queue.get(at) {
            at += 1;
            let node = &self.nodes[index as usize];
            if parts < MAX_CUT
                && node.children != LEAF
                && context.distance2(node) < OPENING_RATIO * OPENING_RATIO * node.radius2
            {
                parts += 1;
                queue.extend([node.children, node.children + 1]);
                continue;
            }
            let importance = context.importance(node);
            if importance > 0.0 {
                cut.nodes.push((index, importance));
                cut.total += f64::from(importance);
            }
        }
        cut
    }

    /// Returns the leaves from left to right: neighbors in this order are near each other.
    pub fn leaves(&self) -> Vec<Node> {
        self.leaves.iter().map(|&at| self.nodes[at as usize]).collect()
    }

    /// Returns the leaf of a light; `None` if it is not in the tree.
    #[inline]
    pub fn leaf(&self, light: u32) -> Option<&Node> {
        self.rank(light).map(|rank| &self.nodes[self.leaves[rank] as usize])
    }

    /// Returns the position of a light among the leaves; `None` if it is not in the tree.
    #[inline]
    pub fn rank(&self, light: u32) -> Option<usize> {
        self.ranks.get(light as usize).filter(|&&rank| rank != ABSENT).map(|&rank| rank as usize)
    }

    /// Returns at most `max_nodes` nodes that together hold every light once. Bright and wide nodes are split first.
    pub fn clusters(&self, max_nodes: usize) -> Vec<Node> {
        let weight = |node: &Node| node.intensity * node.radius;
        let mut parts: Vec<Node> = self.nodes.first().copied().into_iter().collect();
        while parts.len() < max_nodes {
            let inner = parts.iter().enumerate().filter(|(_, node)| node.children != LEAF);
            let Some((at, node)) = inner.max_by(|a, b| weight(a.1).total_cmp(&weight(b.1)).then(b.0.cmp(&a.0))) else {
                break;
            };
            let children = node.children as usize;
            parts.splice(at..=at, self.nodes[children..children + 2].iter().copied());
        }
        parts
    }

    /// Chooses a light for `context` with `u` in [0, 1): its index and probability > 0. `None`: no light can send anything.
    /// - `cut`: from [`Self::cut_for`] for the same place.
    #[inline]
    pub fn choose_from(&self, cut: &TreeCut, context: &impl NodeImportance, u: f64) -> Option<(u32, f32)> {
        if !(cut.total > 0.0 && cut.total.is_finite()) {
            return None;
        }
        let (mut rest, mut chosen) = (u * cut.total, None);
        for &(index, importance) in &cut.nodes {
            let importance = f64::from(importance);
            chosen = Some((index, importance, rest.min(importance)));
            if rest < importance {
                break;
            }
            rest -= importance;
        }
        let (index, importance, rest) = chosen?;
        let mut u = (rest / importance).min(1.0 - f64::EPSILON);
        let mut node = &self.nodes[index as usize];
        let mut probability = importance / cut.total;
        while node.children != LEAF {
            let share = self.first_child_probability(node.children, context)?;
            if u < share {
                u /= share;
                probability *= share;
                node = &self.nodes[node.children as usize];
            } else {
                u = ((u - share) / (1.0 - share)).min(1.0 - f64::EPSILON);
                probability *= 1.0 - share;
                node = &self.nodes[node.children as usize + 1];
            }
        }
        let probability = probability as f32;
        (probability > 0.0).then_some((node.light, probability))
    }

    /// Returns the probability with which [`Self::choose_from`] chooses `light` for `context`.
    #[inline]
    pub fn probability_from(&self, cut: &TreeCut, context: &impl NodeImportance, light: u32) -> f32 {
        let rank = self.ranks[light as usize];
        if rank == ABSENT || !cut.total.is_finite() {
            return 0.0;
        }
        let has = |part: &&(u32, f32)| self.nodes[part.0 as usize].contains_rank(rank);
        let Some(&(index, importance)) = cut.nodes.iter().find(has) else { return 0.0 };
        let mut node = &self.nodes[index as usize];
        let mut probability = f64::from(importance) / cut.total;
        while node.children != LEAF {
            let Some(share) = self.first_child_probability(node.children, context) else { return 0.0 };
            let first = &self.nodes[node.children as usize];
            if first.contains_rank(rank) {
                probability *= share;
                node = first;
            } else {
                probability *= 1.0 - share;
                node = &self.nodes[node.children as usize + 1];
            }
        }
        probability as f32
    }
}

/// The nodes among which a choice for a place starts.
#[derive(Clone, Debug)]
pub struct TreeCut {
    /// Nodes that may send something, with their importance.
    nodes: ArrayVec<(u32, f32), MAX_CUT>,
    /// Sum of the importances.
    total: f64,
}
