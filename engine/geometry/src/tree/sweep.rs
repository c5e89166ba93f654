//! Top-down building for small inputs: every split of the centroids along every axis is weighed by surface area.

use super::binary::BinaryNode;
use crate::Aabb;

/// How a range of primitives is cut.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Cut {
    SurfaceArea,
    Median,
}

pub(super) fn build(boxes: &[Aabb]) -> Vec<BinaryNode> {
    split_all(boxes, Cut::SurfaceArea)
}

pub(super) fn build_balanced(boxes: &[Aabb]) -> Vec<BinaryNode> {
    split_all(boxes, Cut::Median)
}

fn split_all(boxes: &[Aabb], cut: Cut) -> Vec<BinaryNode> {
    let mut order: Vec<u32> = (0..boxes.len() as u32).collect();
    let unset = BinaryNode { bounds: Aabb::EMPTY, first: 0, is_leaf: true };
    let mut nodes = Vec::with_capacity(2 * boxes.len());
    nodes.push(unset);
    let mut pending = vec![(0, 0..boxes.len())];
    while let Some((index, range)) = pending.pop() {
        let part = &mut order[range.clone()];
        let bounds = part.iter().fold(Aabb::EMPTY, |b, &i| b.union(boxes[i as usize]));
        if let [only] = *part {
            nodes[index] = BinaryNode { bounds, first: only, is_leaf: true };
            continue;
        }
        let middle = match cut {
            Cut::SurfaceArea => split_by_area(boxes, part),
            Cut::Median => split_at_median(boxes, part, &bounds),
        };
        let first = nodes.len();
        nodes[index] = BinaryNode { bounds, first: first as u32, is_leaf: false };
        nodes.extend([unset, unset]);
        pending.push((first, range.start..range.start + middle));
        pending.push((first + 1, range.start + middle..range.end));
    }
    nodes
}

fn sort_along(boxes: &[Aabb], part: &mut [u32], axis: usize) {
    let key = |i: u32| boxes[i as usize].center()[axis];
    part.sort_unstable_by(|&a, &b| key(a).total_cmp(&key(b)).then(a.cmp(&b)));
}

/// Orders `part` along the best axis and returns the best place to cut, between 1 and its length - 1.
fn split_by_area(boxes: &[Aabb], part: &mut [u32]) -> usize {
    let mut best = (f32::INFINITY, 0, part.len() / 2);
    let mut above = vec![0.0f32; part.len()];
    for axis in 0..3 {
        sort_along(boxes, part, axis);
        let mut b = Aabb::EMPTY;
        for (k, &i) in part.iter().enumerate().rev() {
            b = b.union(boxes[i as usize]);
            above[k] = b.half_area() * (part.len() - k) as f32;
        }
        let mut b = Aabb::EMPTY;
        for k in 1..part.len() {
            b = b.union(boxes[part[k - 1] as usize]);
            let cost = b.half_area() * k as f32 + above[k];
            if cost < best.0 {
                best = (cost, axis, k);
            }
        }
    }
    if best.1 != 2 {
        sort_along(boxes, part, best.1);
    }
    best.2
}

fn split_at_median(boxes: &[Aabb], part: &mut [u32], bounds: &Aabb) -> usize {
    sort_along(boxes, part, bounds.size().max_position());
    part.len() / 2
}
