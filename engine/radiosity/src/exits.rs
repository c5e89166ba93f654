//! Distribution of the light that a cluster receives among its surfaces.

use crate::arena::Arena;
use femc_field::NONE;

/// Weights of the light that clusters receive, by surface and cluster: the share of the surface's directions that lead out of the
/// cluster, relative to the mean over the cluster's surfaces. The insides of a closed box receive nothing of the
/// box's light, and the outsides all of it.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ClusterWeights {
    /// First weight by element; used for elements that are whole surfaces in a cluster.
    first: Vec<u32>,
    /// Weights of the clusters of each surface, the smallest cluster first.
    pub weights: Vec<f32>,
}

impl ClusterWeights {
    /// Creates weights of 1.
    pub fn new(arena: &Arena) -> Self {
        let mut out = Self::default();
        for (index, element) in arena.elements.iter().enumerate() {
            out.first.push(out.weights.len() as u32);
            if is_whole_surface(arena, index as u32) {
                let count = clusters_around(arena, element.parent).count();
                out.weights.extend(std::iter::repeat_n(1.0, count));
            }
        }
        while out.first.last() == Some(&(out.weights.len() as u32)) {
            out.first.pop();
        }
        out
    }

    /// Returns the clusters around a surface with the weight of their light, the smallest first. Empty for elements that are not
    /// whole surfaces.
    pub fn clusters_of<'a>(&'a self, arena: &'a Arena, index: usize) -> impl Iterator<Item = (u32, f32)> + 'a {
        let first = if is_whole_surface(arena, index as u32) { self.first.get(index) } else { None };
        let weights = first.map_or(&[][..], |&first| &self.weights[first as usize..]);
        clusters_around(arena, arena.elements[index].parent).zip(weights.iter().copied())
    }

    /// Sets the weights from the shares of directions that lead out of clusters.
    /// - `shares`: shares by whole surface, in the order of the elements, and by cluster, as the weights.
    pub fn set_exit_shares(&mut self, arena: &Arena, shares: Vec<f32>) {
        self.weights = shares;
        let mut sums = vec![[0.0f64; 2]; arena.elements.len()];
        let surfaces = || (0..self.first.len()).filter(|&index| is_whole_surface(arena, index as u32));
        for index in surfaces() {
            let area = f64::from(arena.elements[index].size());
            for (cluster, share) in self.clusters_of(arena, index) {
                let [all, out] = &mut sums[cluster as usize];
                (*all, *out) = (*all + area, *out + area * f64::from(share));
            }
        }
        let mut clusters = Vec::with_capacity(self.weights.len());
        surfaces().for_each(|index| clusters.extend(self.clusters_of(arena, index).map(|(cluster, _)| cluster)));
        for (weight, cluster) in self.weights.iter_mut().zip(clusters) {
            let [all, out] = sums[cluster as usize];
            *weight = if out > 0.0 { (f64::from(*weight) * all / out) as f32 } else { 1.0 };
        }
    }
}

/// Returns the clusters that contain a cluster, itself first.
pub fn clusters_around(arena: &Arena, cluster: u32) -> impl Iterator<Item = u32> + '_ {
    let own = (cluster != NONE).then_some(cluster);
    std::iter::successors(own, |&index| {
        let parent = arena.elements[index as usize].parent;
        (parent != NONE).then_some(parent)
    })
}

/// Checks whether an element is a whole surface, not a part of one.
pub fn is_whole_surface(arena: &Arena, index: u32) -> bool {
    let element = &arena.elements[index as usize];
    let parent = arena.elements.get(element.parent as usize);
    element.surface_part().is_some() && parent.is_none_or(|parent| parent.surface_part().is_none())
}
