//! Measurement of the directions that lead out of clusters.

use super::Rays;
use crate::arena::Arena;
use crate::exits::{clusters_around, is_root};
use femc_field::NONE;
use rayon::prelude::*;

impl Rays {
    /// Returns the shares of the directions of each whole surface that lead out of the clusters around it: by surface in the order
    /// of the elements, and by cluster, the smallest first.
    pub fn exit_shares(&self, arena: &Arena) -> Vec<f32> {
        let mut depth = vec![0u32; arena.elements.len()];
        let mut whole = vec![NONE; arena.elements.len()];
        for (index, element) in arena.elements.iter().enumerate() {
            if is_root(arena, index as u32) {
                whole[index] = index as u32;
            } else if element.surface_part().is_some() {
                whole[index] = whole[element.parent as usize];
            }
            depth[index] = if element.parent == NONE { 0 } else { depth[element.parent as usize] + 1 };
        }
        // Number of clusters, from the smallest, that a ray leaves.
        let left = |surface: u32, hit: u32| {
            let (mut a, mut b) = (surface, hit);
            while a != b {
                if depth[a as usize] >= depth[b as usize] {
                    a = arena.elements[a as usize].parent;
                } else {
                    b = arena.elements[b as usize].parent;
                }
            }
            (depth[surface as usize] - depth[a as usize]).saturating_sub(1) as usize
        };
        let of_leaf = |place: usize| {
            let surface = whole[self.leaves[place] as usize];
            let mut weights = Vec::new();
            if surface != NONE {
                weights = vec![0.0f32; depth[surface as usize] as usize + 1];
                let hits = &self.hits[self.first[place] as usize..self.first[place + 1] as usize];
                for hit in hits.iter().filter(|hit| hit.density[0] > 0.0) {
                    let target = whole.get(hit.leaf as usize).copied().unwrap_or(NONE);
                    let number = if target == NONE { depth[surface as usize] as usize } else { left(surface, target) };
                    weights[number] += 1.0 / hit.density[0];
                }
            }
            (surface, weights)
        };
        let by_leaf: Vec<(u32, Vec<f32>)> = (0..self.leaves.len()).into_par_iter().map(of_leaf).collect();
        let mut by_surface = vec![Vec::new(); arena.elements.len()];
        for (surface, weights) in by_leaf.into_iter().filter(|(surface, _)| *surface != NONE) {
            let sums: &mut Vec<f32> = &mut by_surface[surface as usize];
            sums.resize(weights.len(), 0.0);
            sums.iter_mut().zip(weights).for_each(|(sum, weight)| *sum += weight);
        }
        let mut shares = Vec::new();
        for index in (0..arena.elements.len()).filter(|&index| is_root(arena, index as u32)) {
            let sums = &by_surface[index];
            let all: f32 = sums.iter().sum();
            for (k, _) in clusters_around(arena, arena.elements[index].parent).enumerate() {
                let out: f32 = sums.iter().skip(k + 1).sum();
                shares.push(if all > 0.0 { out / all } else { 1.0 });
            }
        }
        shares
    }
}
