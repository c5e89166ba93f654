//! The previous frame, reprojected into the frame that is painted now.

use crate::{ChannelImage, PatchField, PatchGrid, StylizeError, StylizedImage};

/// Number that stands for no pixel and no patch.
const NONE: u32 = u32::MAX;

/// The painting of the previous frame, reprojected along the motion of the scene.
#[derive(Clone, Debug)]
pub struct PreviousFrame {
    /// Red, green, blue, and a last channel that is 1 where a pixel of the previous frame arrives and 0 elsewhere (colors are 0
    /// there).
    image: ChannelImage,
    /// Source pixel in the previous frame of each pixel, or [`NONE`].
    source_pixels: Vec<u32>,
    field: PatchField,
}

impl PreviousFrame {
    /// Moves each pixel of the previous frame to its position in this frame. If several pixels arrive at one position, the nearest
    /// one wins.
    /// - `motion`: of the previous frame, pixels along x and y to the position of the same point in the next frame; not finite:
    ///   unknown;
    /// - `depth`: of the previous frame, one channel, decides occlusion; 0: background, which hides nothing. Without depth, larger
    ///   motion counts as nearer;
    /// - errors: sizes or channels do not fit.
    pub fn new(painted: &StylizedImage, motion: [&[f32]; 2], depth: Option<&[f32]>) -> Result<Self, StylizeError> {
        Self::from_field(&painted.image, painted.field.clone(), motion, depth)
    }

    /// Does the work of [`Self::new`] for an image that `field` has painted.
    pub(crate) fn from_field(
        image: &ChannelImage,
        field: PatchField,
        motion: [&[f32]; 2],
        depth: Option<&[f32]>,
    ) -> Result<Self, StylizeError> {
        let (width, height) = (image.width(), image.height());
        let layers = motion.into_iter().chain(depth);
        if let Some(values) = layers.map(<[f32]>::len).find(|&values| values != width * height) {
            let (width, height) = (width as u32, height as u32);
            return Err(StylizeError::Shape { width, height, channels: 1, values });
        }
        let mut from = vec![NONE; width * height];
        let nearness = |at: usize| match depth {
            Some(depth) if depth[at] > 0.0 => -depth[at],
            Some(_) => f32::NEG_INFINITY,
            None => motion[0][at] * motion[0][at] + motion[1][at] * motion[1][at],
        };
        for (at, (dx, dy)) in motion[0].iter().zip(motion[1]).enumerate() {
            let (x, y) = ((at % width) as f32 + dx, (at / width) as f32 + dy);
            let within = |place: f32, end: usize| (-0.5..end as f32 - 0.5).contains(&place);
            if within(x, width) && within(y, height) {
                let to = (y + 0.5) as usize * width + (x + 0.5) as usize;
                if from[to] == NONE || nearness(at) > nearness(from[to] as usize) {
                    from[to] = at as u32;
                }
            }
        }
        let from = fill_gaps(&from, width, height);
        let image = ChannelImage::from_rows(width, height, 4, |y, row| {
            for (x, out) in row.chunks_mut(4).enumerate() {
                if let Some(at) = Some(from[y * width + x] as usize).filter(|&at| at != NONE as usize) {
                    out[..3].copy_from_slice(image.pixel(at % width, at / width));
                    out[3] = 1.0;
                }
            }
        });
        Ok(Self { image, source_pixels: from, field })
    }

    /// Returns columns and rows.
    pub(crate) fn size(&self) -> [u32; 2] {
        self.image.size()
    }

    /// Returns the colors and their coverage at all levels.
    pub(crate) fn pyramid(&self, levels: usize) -> Vec<ChannelImage> {
        self.image.pyramid(levels)
    }

    /// Returns the source patches that the target patches of a level had in the previous frame, or [`NONE`].
    /// - `level`: 0 is the finest.
    pub(crate) fn patches(&self, target: PatchGrid, source: PatchGrid, level: usize) -> Vec<u32> {
        let (width, height, radius) = (self.image.width(), self.image.height(), target.patch() / 2);
        let patch = |q: u32| {
            let (x, y) = target.corner(q);
            let fine = |corner: usize, end: usize| ((corner + radius) << level).min(end - 1);
            let from = self.source_pixels[fine(y, height) * width + fine(x, width)] as usize;
            if from == NONE as usize {
                return NONE;
            }
            let near = |middle: usize, count: usize| middle.saturating_sub(radius).min(count - 1);
            let (u, v) =
                (near(from % width, self.field.target.columns()), near(from / width, self.field.target.rows()));
            let (p, q) = self.field.source.corner(self.field.patches[self.field.target.at(u, v) as usize]);
            let coarse = |corner: usize, count: usize| near((corner + radius) >> level, count);
            source.at(coarse(p, source.columns()), coarse(q, source.rows()))
        };
        (0..target.count() as u32).map(patch).collect()
    }

    /// Computes the mean difference of `image` from the previous frame over its known pixels, in levels of 255; `None`: no pixel is
    /// known.
    pub fn flicker(&self, image: &ChannelImage) -> Option<f64> {
        let pixels = self.image.values().chunks(4).zip(image.values().chunks(3)).filter(|(before, _)| before[3] > 0.0);
        let differences = |(before, now): (&[f32], &[f32])| {
            before[..3].iter().zip(now).map(|(a, b)| f64::from((a - b).abs())).sum::<f64>() / 3.0
        };
        let (sum, count) = pixels.map(differences).fold((0.0, 0u32), |(sum, count), it| (sum + it, count + 1));
        (count > 0).then(|| 255.0 * sum / f64::from(count))
    }
}

/// Fills the gaps that open between pixels that move apart. A gap with at least five known neighbors takes the source of the first
/// of them.
fn fill_gaps(from: &[u32], width: usize, height: usize) -> Vec<u32> {
    let around = |at: usize| {
        let (x, y) = (at % width, at / width);
        let rows = y.saturating_sub(1)..(y + 2).min(height);
        rows.flat_map(move |v| (x.saturating_sub(1)..(x + 2).min(width)).map(move |u| v * width + u))
    };
    let fill = |(at, &known): (usize, &u32)| {
        let mut near = around(at).map(|beside| from[beside]).filter(|&it| it != NONE);
        match near.clone().count() {
            _ if known != NONE => known,
            5.. => near.next().unwrap_or(NONE),
            _ => NONE,
        }
    };
    from.iter().enumerate().map(fill).collect()
}

/// Blends the painting toward the previous frame.
/// - `before`: colors of the previous frame times their coverage, and the coverage;
/// - `hold`: weight of the previous frame, 0 to 1.
pub(crate) fn blend_with_previous(image: &ChannelImage, before: &ChannelImage, hold: f32) -> ChannelImage {
    ChannelImage::from_rows(image.width(), image.height(), 3, |y, row| {
        let pixels = image.run(0, y, image.width()).chunks(3).zip(before.run(0, y, image.width()).chunks(4));
        for (out, (now, before)) in row.chunks_mut(3).zip(pixels) {
            for (i, out) in out.iter_mut().enumerate() {
                *out = now[i] + hold * (before[i] - before[3] * now[i]);
            }
        }
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{ChannelImage, QualityMetrics};

    fn painted(width: u32, height: u32) -> StylizedImage {
        let values = (0..width * height * 3).map(|i| i as f32 / 1000.0).collect();
        let image = ChannelImage::new(width, height, 3, values).expect("an image");
        let grid = PatchGrid::new(width as usize, height as usize, 3);
        let field = PatchField { target: grid, source: grid, patches: (0..grid.count() as u32).collect() };
        let figures = QualityMetrics::new(&field, [&image; 2], &image, &image);
        StylizedImage { image, field, levels: 1, quality: figures }
    }

    #[test]
    fn pixels_and_their_patches_move_to_where_they_are_seen() {
        let painted = painted(9, 6);
        let before = PreviousFrame::new(&painted, [&[2.0; 54], &[1.0; 54]], None).expect("it fits");
        for (x, y) in [(2, 1), (8, 5), (5, 3)] {
            assert_eq!(before.image.pixel(x, y)[..3], *painted.image.pixel(x - 2, y - 1));
        }
        assert_eq!(before.image.pixel(1, 3), [0.0; 4], "nothing comes there");
        let grid = painted.field.target;
        let patches = before.patches(grid, grid, 0);
        assert_eq!(patches[grid.at(4, 2) as usize], grid.at(2, 1));
        assert_eq!(patches[grid.at(0, 2) as usize], NONE);
    }

    #[test]
    fn nearer_pixels_hide_farther_ones_and_gaps_are_filled() {
        let painted = painted(6, 4);
        let mut motion = vec![0.0; 24];
        motion[6] = 2.0;
        motion[3] = f32::NAN;
        let mut depth = vec![5.0; 24];
        for (of_first, seen) in [(1.0, 6), (9.0, 8)] {
            depth[6] = of_first;
            let before = PreviousFrame::new(&painted, [&motion, &[0.0; 24]], Some(&depth)).expect("it fits");
            assert_eq!((before.source_pixels[8], before.source_pixels[3]), (seen, 2), "a gap is filled from around it");
        }
        depth[8] = 0.0;
        let before = PreviousFrame::new(&painted, [&motion, &[0.0; 24]], Some(&depth)).expect("it fits");
        assert_eq!(before.source_pixels[8], 6, "the sky hides nothing");
        assert!(PreviousFrame::new(&painted, [&motion, &[0.0; 23]], None).is_err());
    }

    #[test]
    fn what_did_not_change_does_not_flicker() {
        let painted = painted(7, 5);
        let before = PreviousFrame::new(&painted, [&[0.0; 35], &[0.0; 35]], None).expect("it fits");
        assert_eq!(before.flicker(&painted.image), Some(0.0));
        let brighter = painted.image.values().iter().map(|value| value + 0.1).collect();
        let brighter = ChannelImage::new(7, 5, 3, brighter).expect("an image");
        assert!((before.flicker(&brighter).expect("it is known") - 25.5).abs() < 1e-3);
        let gone = PreviousFrame::new(&painted, [&[100.0; 35], &[0.0; 35]], None).expect("it fits");
        assert_eq!(gone.flicker(&painted.image), None);
    }
}
