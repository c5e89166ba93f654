//! A k-d tree of points.
//!
//! All leaves lie at one depth. Nodes are therefore numbered as in a heap and need no links, and the points below a node are
//! contiguous in one list.

use crate::basis::{DIMENSIONS, Point};
use rayon::prelude::*;

/// Maximum number of points in a leaf.
const MAX_LEAF_POINTS: usize = 8;
/// Number of points of a node from which the dimension of its cut is chosen.
const SAMPLES: usize = 128;

/// A k-d tree. Points keep their given numbers.
#[derive(Clone, Debug)]
pub struct Tree {
    /// Dimension and coordinate of the cut of each inner node.
    cuts: Vec<(u8, f32)>,
    /// Index of the first point of each leaf, and the end of the last leaf.
    starts: Vec<u32>,
    /// Numbers of the points, leaf by leaf.
    order: Vec<u32>,
}

impl Tree {
    /// Builds the tree of all points, at least one.
    pub fn new(points: &[Point]) -> Self {
        let mut order: Vec<u32> = (0..points.len() as u32).collect();
        let (mut starts, mut cuts) = (vec![0, points.len()], Vec::new());
        while starts.windows(2).any(|node| node[1] - node[0] > MAX_LEAF_POINTS) {
            let nodes = slices(&mut order, &starts);
            cuts.par_extend(nodes.into_par_iter().map(|node| halve(node, points)));
            let middles = starts.windows(2).flat_map(|node| [node[0], node[0] + (node[1] - node[0]) / 2]);
            starts = middles.chain([points.len()]).collect();
        }
        // Sorting makes the order in a leaf independent of how the halves were found.
        slices(&mut order, &starts).into_par_iter().for_each(<[u32]>::sort_unstable);
        Self { cuts, starts: starts.into_iter().map(|start| start as u32).collect(), order }
    }

    /// Returns the leaf whose part of space contains a point.
    #[inline]
    pub fn leaf(&self, point: &Point) -> u32 {
        let mut node = 0;
        while let Some(&(dimension, cut)) = self.cuts.get(node) {
            node = 2 * node + 1 + usize::from(point[usize::from(dimension)] >= cut);
        }
        (node - self.cuts.len()) as u32
    }

    /// Returns the number of levels above the leaves.
    pub fn height(&self) -> u32 {
        (self.cuts.len() + 1).ilog2()
    }

    /// Returns the points below the node that is `height` levels above a leaf, where `height` is at most [`Tree::height`]. There is
    /// at least one.
    #[inline]
    pub fn points_below(&self, leaf: u32, height: u32) -> &[u32] {
        let first = (leaf >> height << height) as usize;
        &self.order[self.starts[first] as usize..self.starts[first + (1 << height)] as usize]
    }
}

/// Splits the order into one slice per node of a level.
fn slices<'a>(mut order: &'a mut [u32], starts: &[usize]) -> Vec<&'a mut [u32]> {
    let mut nodes = Vec::with_capacity(starts.len() - 1);
    for bounds in starts.windows(2) {
        let (node, rest) = order.split_at_mut(bounds[1] - bounds[0]);
        nodes.push(node);
        order = rest;
    }
    nodes
}

/// Cuts a node at its median, along the dimension in which a sample of its points varies most.
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
    fn points_lie_in_their_leaves_and_nodes_hold_their_leaves() {
        let coordinate = |at: u32, i: usize| mix32(at * 64 + i as u32) as f32;
        for count in [1, 2, 9, 1000] {
            let points: Vec<Point> = (0..count).map(|at| std::array::from_fn(|i| coordinate(at, i))).collect();
            let tree = Tree::new(&points);
            for (at, point) in points.iter().enumerate() {
                let leaf = tree.leaf(point);
                assert!(
                    tree.points_below(leaf, 0).contains(&(at as u32))
                        && tree.points_below(leaf, 0).len() <= MAX_LEAF_POINTS
                );
                for height in 0..tree.height() {
                    let [part, whole] = [height, height + 1].map(|height| tree.points_below(leaf, height));
                    assert!(part.iter().all(|it| whole.contains(it)) && whole.len() >= 2 * part.len() - 1);
                }
                assert_eq!(tree.points_below(leaf, tree.height()).len(), points.len());
            }
        }
    }
}
