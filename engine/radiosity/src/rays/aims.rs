//! Guides for later rays, from the results of earlier ones.

use crate::arena::Arena;
use femc_field::{Block, Directions, Guide, Lobe, NONE, SurfaceSpot};
use femc_math::glam::Vec3A;
use std::collections::HashMap;
use std::f32::consts::PI;

/// Guide for a share of a leaf's rays.
#[derive(Clone, Debug)]
pub struct Aim(Option<(Block, f32)>);

/// Guides for a share of the rays, by element.
#[derive(Clone, Debug, Default)]
pub struct Aims {
    by_element: Vec<u32>,
    aims: Vec<Aim>,
}

impl Aims {
    /// Creates the guides.
    /// - `guides`: guide of each leaf, in the order of `leaves`.
    pub fn new(arena: &Arena, leaves: &[u32], guides: &[Guide], lobes: &[Lobe]) -> Self {
        let mut out = Self { by_element: vec![NONE; arena.elements.len()], aims: Vec::new() };
        let mut known = HashMap::new();
        for (&leaf, guide) in leaves.iter().zip(guides).filter(|(_, guide)| guide.count > 0) {
            let range = guide.first as usize..(guide.first + guide.count) as usize;
            out.by_element[leaf as usize] = *known.entry(guide.first).or_insert_with(|| {
                out.aims.push(Aim(Some((Block::new(&lobes[range]), guide.share))));
                out.aims.len() as u32 - 1
            });
        }
        out
    }

    /// Gives new elements the guides of their parents.
    pub fn grow(&mut self, arena: &Arena) {
        if self.aims.is_empty() {
            return;
        }
        for element in &arena.elements[self.by_element.len()..] {
            self.by_element.push(if element.parent == NONE { NONE } else { self.by_element[element.parent as usize] });
        }
    }

    pub fn get(&self, leaf: u32) -> &Aim {
        let at = self.by_element.get(leaf as usize).copied().unwrap_or(NONE);
        self.aims.get(at as usize).unwrap_or(&Aim::NONE)
    }
}

impl Aim {
    pub const NONE: Self = Self(None);

    /// Returns the number of guided rays of a part.
    pub fn number(&self, each: usize) -> usize {
        self.0.as_ref().map_or(0, |(_, share)| ((each as f32 * share) as usize).min(each - 1))
    }

    pub fn sample(&self, point: Vec3A, choice: f32, u: [f32; 2]) -> Option<Vec3A> {
        let (block, _) = self.0.as_ref()?;
        Some(Directions::new(block, point).non_empty()?.sample(choice, u))
    }

    /// Returns the density of directions relative to the cosine distribution.
    pub fn ratio(&self, spot: &SurfaceSpot, dir: Vec3A, each: usize) -> f32 {
        let aimed = self.number(each);
        let (Some((block, _)), true) = (&self.0, aimed > 0) else { return 1.0 };
        let Some(directions) = Directions::new(block, spot.position).non_empty() else { return 1.0 };
        let share = aimed as f32 / each as f32;
        let cosine = (spot.normal.dot(dir) / PI).max(1e-6);
        1.0 - share + share * directions.pdf(dir) / cosine
    }
}
