//! Numbered patches, the source patch of each target patch, and the image that they paint.

use crate::ChannelImage;
use crate::patches::STYLE_CHANNELS;

/// The patches of an image: all patches that lie fully inside, numbered row by row by their upper left pixel.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PatchGrid {
    columns: usize,
    rows: usize,
    patch: usize,
}

impl PatchGrid {
    /// Creates the grid of the patches of `patch * patch` pixels of an image, which must be at least that large.
    pub fn new(width: usize, height: usize, patch: usize) -> Self {
        debug_assert!(width >= patch && height >= patch, "{width}x{height} pixels for a patch of {patch}");
        Self { columns: width + 1 - patch, rows: height + 1 - patch, patch }
    }

    /// Creates the grid of an image that is large enough.
    pub(crate) fn from_image(image: &ChannelImage, patch: usize) -> Self {
        Self::new(image.width(), image.height(), patch)
    }

    /// Returns the number of patches, at least 1.
    pub fn count(&self) -> usize {
        self.columns * self.rows
    }

    /// Returns the width of a patch, pixels.
    pub fn patch(&self) -> usize {
        self.patch
    }

    /// Returns the number of patches in a row.
    pub fn columns(&self) -> usize {
        self.columns
    }

    /// Returns the number of rows of patches.
    pub fn rows(&self) -> usize {
        self.rows
    }

    /// Returns the patch whose corner is `offset` away from `corner`; `None`: outside of the grid.
    #[inline]
    pub(crate) fn neighbor(&self, corner: [usize; 2], offset: [isize; 2]) -> Option<u32> {
        let x = corner[0].checked_add_signed(offset[0]).filter(|&x| x < self.columns)?;
        let y = corner[1].checked_add_signed(offset[1]).filter(|&y| y < self.rows)?;
        Some(self.at(x, y))
    }

    /// Returns column and row of the upper left pixel of patch `at`.
    #[inline]
    pub fn corner(&self, at: u32) -> (usize, usize) {
        (at as usize % self.columns, at as usize / self.columns)
    }

    /// Returns the patch with this corner.
    #[inline]
    pub fn at(&self, x: usize, y: usize) -> u32 {
        (y * self.columns + x) as u32
    }
}

/// The source patch of each target patch: the nearest neighbor field.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct PatchField {
    /// Patches of the target.
    pub target: PatchGrid,
    /// Patches of the source.
    pub source: PatchGrid,
    /// Number of the source patch, by number of the target patch.
    pub patches: Vec<u32>,
}

impl PatchField {
    /// Paints an image with the field. Each pixel is the mean of the pixels of all patches that cover it, weighted with the square
    /// of a tent, because a patch is most reliable in its middle.
    /// - `style`: the painted style, three channels.
    pub fn vote(&self, style: &ChannelImage) -> ChannelImage {
        let patch = self.target.patch;
        let (width, height) = (self.target.columns + patch - 1, self.target.rows + patch - 1);
        // First and last corner of the patches that cover a column or row.
        let over = |at: usize, count: usize| (at + 1).saturating_sub(patch)..=at.min(count - 1);
        let weight = |within: usize| (within + 1).min(patch - within).pow(2) as f32;
        ChannelImage::from_rows(width, height, STYLE_CHANNELS, |y, row| {
            for (x, out) in row.chunks_mut(STYLE_CHANNELS).enumerate() {
                let mut weights = 0.0f32;
                for v in over(y, self.target.rows) {
                    for u in over(x, self.target.columns) {
                        let (p, q) = self.source.corner(self.patches[self.target.at(u, v) as usize]);
                        let color = style.pixel(p + x - u, q + y - v);
                        let weight = weight(x - u) * weight(y - v);
                        out.iter_mut().zip(color).for_each(|(out, value)| *out += weight * value);
                        weights += weight;
                    }
                }
                out.iter_mut().for_each(|out| *out /= weights);
            }
        })
    }

    /// Returns the field for images twice as large: each patch keeps its offset from the position of its coarse patch.
    pub(crate) fn upsampled(&self, target: PatchGrid, source: PatchGrid) -> Self {
        let radius = target.patch / 2;
        // Centers double; corners lie one radius before the centers.
        let coarse = |fine: usize, count: usize| (fine.saturating_sub(radius) / 2).min(count - 1);
        let fine =
            |p: usize, q: usize, q_fine: usize, count: usize| (2 * p + q_fine).saturating_sub(2 * q).min(count - 1);
        let patches = (0..target.count() as u32).map(|at| {
            let (x, y) = target.corner(at);
            let (u, v) = (coarse(x, self.target.columns), coarse(y, self.target.rows));
            let (p, q) = self.source.corner(self.patches[self.target.at(u, v) as usize]);
            source.at(fine(p, u, x, source.columns), fine(q, v, y, source.rows))
        });
        Self { target, source, patches: patches.collect() }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ramp(width: usize, height: usize) -> ChannelImage {
        ChannelImage::from_rows(width, height, STYLE_CHANNELS, |y, row| {
            let pixels = row.chunks_mut(STYLE_CHANNELS).enumerate();
            pixels.for_each(|(x, out)| out.copy_from_slice(&[x as f32, y as f32, (x * y) as f32]));
        })
    }

    #[test]
    fn the_identity_paints_the_style_and_doubles_to_the_identity() {
        let style = ramp(9, 7);
        let grid = PatchGrid::new(9, 7, 3);
        let field = PatchField { target: grid, source: grid, patches: (0..grid.count() as u32).collect() };
        let close = |a: &ChannelImage| a.values().iter().zip(style.values()).all(|(a, b)| (a - b).abs() < 1e-4);
        assert!(close(&field.vote(&style)));
        let large = PatchGrid::new(18, 14, 3);
        assert_eq!(field.upsampled(large, large).patches, (0..large.count() as u32).collect::<Vec<_>>());
    }

    #[test]
    fn a_pixel_is_the_weighted_mean_of_the_patches_over_it() {
        let style = ramp(6, 3);
        // Two target patches side by side, both with the leftmost source patch.
        let field =
            PatchField { target: PatchGrid::new(4, 3, 3), source: PatchGrid::new(6, 3, 3), patches: vec![0, 0] };
        let painted = field.vote(&style);
        let reds: Vec<f32> = (0..4).map(|x| painted.pixel(x, 0)[0]).collect();
        // Column 1: 1 with weight 4 from the left patch, 0 with weight 1 from the right one.
        assert_eq!(reds, [0.0, 0.8, 1.2, 2.0]);
    }
}
