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
    /// Creates weights of 1 for the current elements.
    fn ones(arena: &Arena) -> Self {
        let mut out = Self::default();
        for (index, element) in arena.elements.iter().enumerate() {
            out.first.push(out.weights.len() as u32);
            if is_root(arena, index as u32) {
                let count = clusters_around(arena, element.parent).count();
                out.weights.extend(std::iter::repeat_n(1.0, count));
            }
        }
        out
    }

    /// Creates weights from their numbers. Returns `None` if there are weights and they belong to other elements.
    pub fn from_numbers(arena: &Arena, weights: Vec<f32>) -> Option<Self> {
        if weights.is_empty() {
            return Some(Self::default());
        }
        let ones = Self::ones(arena);
        (ones.weights.len() == weights.len()).then_some(Self { weights, ..ones })
    }

    /// Returns the clusters around a surface with the weight of their light, the smallest first. Empty for elements that are not
    /// whole surfaces.
    pub fn clusters_of<'a>(&'a self, arena: &'a Arena, index: usize) -> impl Iterator<Item = (u32, f32)> + 'a {
        let first = if is_root(arena, index as u32) { self.first.get(index) } else { None };
        let weights = first.map_or(&[][..], |&first| &self.weights[first as usize..]);
        clusters_around(arena, arena.elements[index].parent).zip(weights.iter().copied())
    }

    /// Creates the weights from the shares of directions that lead out of clusters.
    /// - `shares`: shares by whole surface or cluster without parts, in the order of the elements, and by cluster around it.
    pub fn from_exit_shares(arena: &Arena, shares: Vec<f32>) -> Self {
        let mut out = Self { weights: shares, ..Self::ones(arena) };
        let mut sums = vec![[0.0f64; 2]; arena.elements.len()];
        let surfaces = || (0..out.first.len()).filter(|&index| is_root(arena, index as u32));
        for index in surfaces() {
            let area = f64::from(arena.elements[index].size());
            for (cluster, share) in out.clusters_of(arena, index) {
                let [all, out] = &mut sums[cluster as usize];
                (*all, *out) = (*all + area, *out + area * f64::from(share));
            }
        }
        let mut clusters = Vec::with_capacity(out.weights.len());
        surfaces().for_each(|index| clusters.extend(out.clusters_of(arena, index).map(|(cluster, _)| cluster)));
        for (weight, cluster) in out.weights.iter_mut().zip(clusters) {
            let [all, out] = sums[cluster as usize];
            *weight = if out > 0.0 { (f64::from(*weight) * all / out) as f32 } else { 1.0 };
        }
        out
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

/// Checks whether an element is a whole surface, or a cluster without parts.
pub fn is_root(arena: &Arena, index: u32) -> bool {
    let element = &arena.elements[index as usize];
    let parent = arena.elements.get(element.parent as usize);
    let is_surface = element.surface_part().is_some() && parent.is_none_or(|parent| parent.surface_part().is_none());
    is_surface || element.is_cluster() && element.is_leaf()
}
