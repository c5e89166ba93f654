//! Settings of stylization.

use crate::{ChannelImage, StylizeError};

/// Method that assigns source patches to target patches.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Method {
    /// Cheapest source patch, with a price on source patches that are used often.
    Balanced,
    /// Best source patch of each target patch, by brute force: algorithm 1 of the founding document, for comparison.
    Em,
}

/// Settings of a run.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Settings {
    /// Method of the patch search.
    pub method: Method,
    /// Weight of all guides together relative to the style, at least 0.
    pub mu: f32,
    /// Price of mean use, as the equal difference of the style's colors, levels of 255, at least 0.
    pub balance: f32,
    /// Width of patches, pixels: odd, 3 to 15.
    pub patch: usize,
    /// Levels of the pyramids; `None`: 6, or the maximum for the images if that is less.
    pub levels: Option<usize>,
    /// Number of searches at each level; each is followed by a vote.
    pub iterations: usize,
    /// Allowed change of the painting where the frame does not change: 0 keeps the previous frame, 1 paints each frame from
    /// scratch.
    pub boil: f32,
}

impl Default for Settings {
    fn default() -> Self {
        Self { method: Method::Balanced, mu: 2.0, balance: 17.0, patch: 5, levels: None, iterations: 8, boil: 0.2 }
    }
}

impl Settings {
    /// Default number of levels for large images.
    const LEVELS: usize = 6;

    /// Returns the maximum number of levels for images of these sizes: the shortest side of the coarsest one has two patches. A
    /// single level needs one patch.
    fn max_levels(&self, images: [&ChannelImage; 2]) -> usize {
        let sides = images.iter().flat_map(|image| [image.width(), image.height()]);
        let shortest = sides.min().unwrap_or(0);
        if shortest < self.patch {
            return 0;
        }
        (1..usize::BITS as usize)
            .take_while(|&levels| levels == 1 || shortest >> (levels - 1) >= 2 * self.patch)
            .count()
    }

    /// Checks the settings and returns the number of levels.
    /// - errors: a setting is out of range, by itself or for these images.
    pub(crate) fn check(&self, source: &ChannelImage, target: &ChannelImage) -> Result<usize, StylizeError> {
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
        let most = self.max_levels([source, target]);
        let levels = self.levels.unwrap_or(Self::LEVELS.min(most.max(1)));
        if (1..=most).contains(&levels) {
            return Ok(levels);
        }
        Err(StylizeError::Levels { levels, most, patch: self.patch })
    }
}
