//! Directions of later rays toward the portals that earlier rays have found.

use crate::arena::Arena;
use crate::portals::Portal;
use femc_field::{Block, Directions, Lobe, NONE, SurfaceSpot};
use femc_math::glam::Vec3A;
use std::f32::consts::PI;

/// Share of a leaf's rays that are cast toward portals.
const AIMED: f32 = 0.25;

/// Lobes toward the portals in front of a leaf, for a share of its rays.
#[derive(Clone, Debug)]
pub struct Aim(Option<Block>);

/// Lobes toward portals, by leaf.
#[derive(Clone, Debug, Default)]
pub struct Aims {
    by_element: Vec<u32>,
    aims: Vec<Aim>,
}

impl Aims {
    /// Creates the lobes of all flat leaves. Rays search at the portals for light that the leaf has not found.
    pub fn new(arena: &Arena, portals: &[Portal]) -> Self {
        if portals.is_empty() {
            return Self::default();
        }
        let mut out = Self { by_element: vec![NONE; arena.elements.len()], aims: Vec::new() };
        for (aim, leaf) in out.by_element.iter_mut().zip(&arena.elements) {
            if !(leaf.is_leaf() && leaf.patch().is_some()) {
                continue;
            }
            let lobe = |portal: &Portal| portal.lobe(leaf.center, leaf.normal(), 1.0);
            let lobes: Vec<Lobe> = portals.iter().filter_map(lobe).collect();
            if !lobes.is_empty() {
                *aim = out.aims.len() as u32;
                out.aims.push(Aim(Some(Block::new(&lobes))));
            }
        }
        out
    }

    /// Returns the lobes of a leaf.
    pub fn get(&self, leaf: u32) -> &Aim {
        let at = self.by_element.get(leaf as usize).copied().unwrap_or(NONE);
        self.aims.get(at as usize).unwrap_or(&Aim::NONE)
    }
}

impl Aim {
    pub const NONE: Self = Self(None);

    /// Returns the number of rays of a part that are cast toward portals.
    pub fn number(&self, each: usize) -> usize {
        self.0.as_ref().map_or(0, |_| (each as f32 * AIMED) as usize)
    }

    pub fn sample(&self, point: Vec3A, choice: f32, u: [f32; 2]) -> Option<Vec3A> {
        Some(Directions::new(self.0.as_ref()?, point).non_empty()?.sample(choice, u))
    }

    /// Returns the density of directions relative to the cosine distribution.
    pub fn ratio(&self, spot: &SurfaceSpot, dir: Vec3A, each: usize) -> f32 {
        let aimed = self.number(each);
        let (Some(block), true) = (&self.0, aimed > 0) else { return 1.0 };
        let Some(directions) = Directions::new(block, spot.position).non_empty() else { return 1.0 };
        let share = aimed as f32 / each as f32;
        let cosine = (spot.normal.dot(dir) / PI).max(1e-6);
        1.0 - share + share * directions.pdf(dir) / cosine
    }
}
