//! A k-d tree of points.
//!
//! All leaves lie at one depth, so nodes are numbered as in a heap and need no links, and the points below a node are neighbors in one list.

use crate::basis::{DIMENSIONS, Point};
use rayon::prelude::*;

/// Points of a leaf at most.
const LEAF: usize = 8;
/// Points of a node by which the dimension of its cut is chosen.
const SAMPLES: usize = 128;

/// The tree. Points keep the numbers that they are given by.
#[derive(Clone, Debug)]
pub struct Tree {
    /// Of each inner node the dimension and the coordinate of its cut.
    cuts: Vec<(u8, f32)>,
    /// Where the points of each leaf begin, and where those of the last one end.
    starts: Vec<u32>,
    /// Numbers of the points, leaf by leaf.
    order: Vec<u32>,
}

impl Tree {
    /// The tree of all points, one at least.
    pub fn of(points: &[Point]) -> Self {
        let mut order: Vec<u32> = (0..points.len() as u32).collect();
        let (mut starts, mut cuts) = (vec![0, points.len()], Vec::new());
        while starts.windows(2).any(|node| node[1] - node[0] > LEAF) {
            let nodes = slices(&mut order, &starts);
            cuts.par_extend(nodes.into_par_iter().map(|node| halve(node, points)));
            let middles = starts.windows(2).flat_map(|node| [node[0], node[0] + (node[1] - node[0]) / 2]);
            starts = middles.chain([points.len()]).collect();
        }
        // What lies in a leaf is the same however the halves were found.
        slices(&mut order, &starts).into_par_iter().for_each(<[u32]>::sort_unstable);
        Self { cuts, starts: starts.into_iter().map(|start| start as u32).collect(), order }
    }

    /// The leaf in whose part of space a point lies.
    #[inline]
    pub fn leaf(&self, at: &Point) -> u32 {
        let mut node = 0;
        while let Some(&(dimension, cut)) = self.cuts.get(node) {
            node = 2 * node + 1 + usize::from(at[usize::from(dimension)] >= cut);
        }
        (node - self.cuts.len()) as u32
    }

    /// Levels of nodes above the leaves.
    pub fn height(&self) -> u32 {
        (self.cuts.len() + 1).ilog2()
    }

    /// The points below the node that is `height` levels, [`Tree::height`] at most, above a leaf. There is one at least.
    #[inline]
    pub fn below(&self, leaf: u32, height: u32) -> &[u32] {
        let first = (leaf >> height << height) as usize;
        &self.order[self.starts[first] as usize..self.starts[first + (1 << height)] as usize]
    }
}

/// The nodes of a level as slices.
fn slices<'a>(mut order: &'a mut [u32], starts: &[usize]) -> Vec<&'a mut [u32]> {
    let mut nodes = Vec::with_capacity(starts.len() - 1);
    for bounds in starts.windows(2) {
        let (node, rest) = order.split_at_mut(bounds[1] - bounds[0]);
        nodes.push(node);
        order = rest;
    }
    nodes
}

/// Cuts a node at its middle, along the dimension in which a sample of its points varies most.
fn halve(node: &mut [u32], points: &[Point]) -> (u8, f32) {
    let step = node.len().div_ceil(SAMPLES);
    let (mut sums, mut squares, mut count) = ([0.0f64; DIMENSIONS], [0.0f64; DIMENSIONS], 0.0);
    for point in node.iter().step_by(step).map(|&at| &points[at as usize]) {
        count += 1.0;
        for (i, &value) in point.iter().enumerate() {
            sums[i] += f64::from(value);
            squares[i] += f64::from(value) * f64::from(value);
        }
    }
    let spread: [f64; DIMENSIONS] = std::array::from_fn(|i| squares[i] - sums[i] * sums[i] / count);
    let widest = (0..DIMENSIONS).fold(0, |widest, i| if spread[i] > spread[widest] { i } else { widest });
    let along = |at: &u32| points[*at as usize][widest];
    let middle = node.len() / 2;
    node.select_nth_unstable_by(middle, |a, b| along(a).total_cmp(&along(b)).then(a.cmp(b)));
    (widest as u8, along(&node[middle]))
}

#[cfg(test)]
mod tests {
    use super::*;
    use femc_math::hash::mix32;

    #[test]
    fn points_lie_in_their_leaves_and_nodes_hold_what_their_leaves_hold() {
        let coordinate = |at: u32, i: usize| mix32(at * 64 + i as u32) as f32;
        for count in [1, 2, 9, 1000] {
            let points: Vec<Point> = (0..count).map(|at| std::array::from_fn(|i| coordinate(at, i))).collect();
            let tree = Tree::of(&points);
            for (at, point) in points.iter().enumerate() {
                let leaf = tree.leaf(point);
                assert!(tree.below(leaf, 0).contains(&(at as u32)) && tree.below(leaf, 0).len() <= LEAF);
                for height in 0..tree.height() {
                    let [part, whole] = [height, height + 1].map(|height| tree.below(leaf, height));
                    assert!(part.iter().all(|it| whole.contains(it)) && whole.len() >= 2 * part.len() - 1);
                }
                assert_eq!(tree.below(leaf, tree.height()).len(), points.len());
            }
        }
    }
}
