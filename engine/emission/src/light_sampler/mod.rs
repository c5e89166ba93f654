//! Choice of one light among many.
//!
//! Up to 128 lights are weighted individually, eight at a time (`light_blocks`): by the unoccluded light that they send to a point
//! (`point`), or that fog scatters on a segment (`segment`). The weights are kept, so that multiple importance sampling can later
//! look up a probability at the same place. For more lights, the tree chooses one.

pub(crate) mod approx;
mod direction;
mod light_blocks;
mod point;
mod segment;

use crate::tree::{LightBounds, LightTree, Node, NodeImportance, TreeCut};
use femc_math::glam::Vec3A;
use femc_simd::Level;
use light_blocks::{LaneWeights, LightBlocks, MAX_LIGHTS, Weigh};

pub use direction::DirectionContext;

/// A place that receives light.
pub trait LightSampleContext: NodeImportance + Weigh {}
impl<P: NodeImportance + Weigh> LightSampleContext for P {}

/// All lights of a scene.
#[derive(Clone, Debug)]
pub struct LightSampler {
    tree: LightTree,
    /// The lights from left to right in the tree if they are few, otherwise clusters of them.
    blocks: LightBlocks,
    /// Nodes in the lanes of `blocks`.
    nodes: Vec<Node>,
    /// The light of each lane, if each lane holds a single light.
    lights: Option<Vec<u32>>,
    /// The light, if there is only one.
    sole: Option<u32>,
}

/// Weights of the lights for one place.
#[derive(Clone, Debug, Default)]
pub struct LightWeights {
    weights: LaneWeights,
    cut: Option<TreeCut>,
}

impl Default for LightSampler {
    fn default() -> Self {
        Self::new(&[])
    }
}

impl LightSampler {
    /// Prepares the choice among `lights`, which returns indices into them. Lights without power, or with bounds that are not
    /// finite, are never chosen.
    pub fn new(lights: &[LightBounds]) -> Self {
        let tree = LightTree::new(lights);
        let leaves = tree.leaves();
        let is_few = leaves.len() <= MAX_LIGHTS;
        let nodes = if is_few { leaves } else { tree.clusters(MAX_LIGHTS) };
        let each: Vec<u32> = nodes.iter().map(Node::light).collect();
        Self {
            blocks: LightBlocks::new(&nodes),
            sole: match each[..] {
                [sole] if is_few => Some(sole),
                _ => None,
            },
            lights: is_few.then_some(each),
            nodes,
            tree,
        }
    }

    /// Checks whether no light can be chosen.
    pub fn is_empty(&self) -> bool {
        self.nodes.is_empty()
    }

    /// Returns the only light that can be chosen; `None` if there are several, or none.
    #[inline]
    pub fn sole(&self) -> Option<u32> {
        self.sole
    }

    /// Computes the weights of the lights for `context`.
    #[inline]
    pub fn weigh(&self, context: &impl LightSampleContext, weights: &mut LightWeights) {
        if self.sole.is_some() {
        } else if self.lights.is_some() {
            self.blocks.weigh(context, &mut weights.weights);
        } else {
            weights.cut = Some(self.tree.cut_for(context));
        }
    }

    /// Chooses a light: its index and probability > 0. `None`: no light can send anything.
    /// - `weights`: from [`Self::weigh`] for the same place;
    /// - `u`: draws a number in [0, 1). A sole light needs none.
    #[inline]
    pub fn choose(
        &self,
        weights: &LightWeights,
        context: &impl LightSampleContext,
        u: impl FnOnce() -> f64,
    ) -> Option<(u32, f32)> {
        if let Some(sole) = self.sole {
            return Some((sole, 1.0));
        }
        match &self.lights {
            Some(lights) => weights.weights.choose(u()).map(|(lane, probability, _)| (lights[lane], probability)),
            None => self.tree.choose_from(weights.cut.as_ref()?, context, u()),
        }
    }

    /// Returns the probability with which [`Self::choose`] chooses `light`.
    #[inline]
    pub fn probability(&self, weights: &LightWeights, context: &impl LightSampleContext, light: u32) -> f32 {
        if let Some(sole) = self.sole {
            return f32::from(u8::from(light == sole));
        }
        let Some(rank) = self.tree.rank(light) else { return 0.0 };
        match (&self.lights, &weights.cut) {
            (Some(_), _) => weights.weights.probability(rank),
            (None, Some(front)) => self.tree.probability_from(front, context, light),
            (None, None) => 0.0,
        }
    }

    /// Computes the weights of the lights, or of clusters of them, for a path that continues from a point in fog.
    #[inline]
    pub fn weigh_directions(&self, context: &DirectionContext, weights: &mut LightWeights) {
        self.blocks.weigh(context, &mut weights.weights);
    }

    /// Samples a direction that passes near lights. `None`: sample the phase function instead.
    #[inline]
    pub fn sample_direction(
        &self,
        context: &DirectionContext,
        weights: &LightWeights,
        choice: f64,
        u: [f32; 2],
    ) -> Option<Vec3A> {
        context.sample(&self.nodes, &weights.weights, choice, u, self.blocks.level())
    }

    /// Returns the density, 1/sr, of [`Self::sample_direction`] with the phase function as the fallback; `phase` is the density of
    /// the phase function.
    #[inline]
    pub fn direction_pdf(&self, context: &DirectionContext, weights: &LightWeights, dir: Vec3A, phase: f32) -> f32 {
        context.pdf(&self.blocks, &weights.weights, dir, phase)
    }

    /// Returns the instruction set that computes the weights.
    pub fn level(&self) -> Level {
        self.blocks.level()
    }

    /// Returns the tree's node of one light; `None` if it is never chosen.
    #[inline]
    pub fn node(&self, light: u32) -> Option<&Node> {
        self.tree.leaf(light)
    }
}

#[cfg(test)]
mod tests;
