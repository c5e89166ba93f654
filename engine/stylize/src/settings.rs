//! How to stylize.

use crate::{Planes, StylizeError};

/// How target patches get their source patches.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Method {
    /// By what they cost, with a price on source patches that are used much.
    Balanced,
    /// Each target patch has the best source patch, by brute force: algorithm 1 of the founding document, for comparison.
    Em,
}

/// Settings of a run.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Settings {
    /// How patches are found.
    pub method: Method,
    /// Weight of all guides together against the style, from 0 on.
    pub mu: f32,
    /// Price of mean use: the difference of the style's colors that it equals, levels of 255, from 0 on.
    pub balance: f32,
    /// Width of patches, pixels: odd, 3 to 15.
    pub patch: usize,
    /// Levels of the pyramids; `None`: 6, or as many as the images allow.
    pub levels: Option<usize>,
    /// Searches, each with its vote, at each level.
    pub iterations: usize,
    /// How much a painting may change where its frame does not: 0 holds on to the frame before, 1 paints each frame anew.
    pub boil: f32,
}

impl Default for Settings {
    fn default() -> Self {
        Self { method: Method::Balanced, mu: 2.0, balance: 17.0, patch: 5, levels: None, iterations: 8, boil: 0.2 }
    }
}

impl Settings {
    /// Levels where none are asked for and the images are large.
    const LEVELS: usize = 6;

    /// Most levels for images of these sizes: the shortest side of the coarsest one has two patches. One level needs one patch.
    fn most_levels(&self, images: [&Planes; 2]) -> usize {
        let sides = images.iter().flat_map(|image| [image.width(), image.height()]);
        let shortest = sides.min().unwrap_or(0);
        if shortest < self.patch {
            return 0;
        }
        (1..usize::BITS as usize)
            .take_while(|&levels| levels == 1 || shortest >> (levels - 1) >= 2 * self.patch)
            .count()
    }

    /// The number of levels.
    /// - errors: a setting is out of range, by itself or for these images.
    pub(crate) fn check(&self, source: &Planes, target: &Planes) -> Result<usize, StylizeError> {
        if !(self.mu.is_finite() && self.mu >= 0.0) {
            return Err(StylizeError::Mu(self.mu));
        }
        if !(self.balance.is_finite() && self.balance >= 0.0) {
            return Err(StylizeError::Balance(self.balance));
        }
        if !(0.0..=1.0).contains(&self.boil) {
            return Err(StylizeError::Boil(self.boil));
        }
        if !(3..=15).contains(&self.patch) || self.patch.is_multiple_of(2) {
            return Err(StylizeError::Patch(self.patch));
        }
        let most = self.most_levels([source, target]);
        let levels = self.levels.unwrap_or(Self::LEVELS.min(most.max(1)));
        if (1..=most).contains(&levels) {
            return Ok(levels);
        }
        Err(StylizeError::Levels { levels, most, patch: self.patch })
    }
}
