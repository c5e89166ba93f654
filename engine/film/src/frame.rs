//! One frame: the union of tiles.

use crate::tile::{ALBEDO_FRACTION, Merged, PixelSums};
use crate::{BadSamples, FilmError, FrameImage, Image, SampleRange, Tile, Tiling};

/// What an insertion did.
pub type Inserted = Merged;

/// The tiles of a frame as far as they have arrived: a set keyed by (tile, sample range), kept as one sum a tile.
///
/// The result depends on the set of inserted keys alone, not on the order or on repetitions.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Frame {
    tiling: Tiling,
    tiles: Vec<Option<Tile>>,
}

impl Frame {
    /// A frame without samples.
    pub fn new(tiling: Tiling) -> Self {
        Self { tiling, tiles: vec![None; tiling.count()] }
    }

    /// How the film is cut.
    pub fn tiling(&self) -> Tiling {
        self.tiling
    }

    /// Takes the samples of `tile` in; samples that are here already change nothing.
    /// - errors: the tile's pixels are none of the frame's tiles, or its sample ranges overlap others (see [`Tile::merge`]).
    pub fn insert(&mut self, tile: Tile) -> Result<Inserted, FilmError> {
        let index = self.tiling.index_of(tile.rect).ok_or(FilmError::NotInFrame(tile.rect))?;
        match &mut self.tiles[index] {
            Some(old) => old.merge(&tile),
            empty => {
                *empty = Some(tile);
                Ok(Merged::New)
            }
        }
    }

    /// The sums of tile `index`, `None` when nothing has arrived or there is no such tile.
    pub fn tile(&self, index: usize) -> Option<&Tile> {
        self.tiles.get(index)?.as_ref()
    }

    /// The sample ranges of tile `index` that have arrived, ascending.
    pub fn ranges(&self, index: usize) -> &[SampleRange] {
        self.tile(index).map_or(&[], Tile::ranges)
    }

    /// Account of all samples that were left out.
    pub fn bad(&self) -> BadSamples {
        let mut all = BadSamples::default();
        self.tiles.iter().flatten().for_each(|tile| all.merge(tile.bad()));
        all
    }

    /// Samples a pixel, averaged over the film; left-out samples do not count.
    pub fn mean_spp(&self) -> f64 {
        let total: u64 = self.tiles.iter().flatten().flat_map(Tile::pixels).map(|p| u64::from(p.count)).sum();
        total as f64 / (f64::from(self.tiling.width) * f64::from(self.tiling.height))
    }

    /// The image: means, variances of the means, counts. Pixels without samples are zero.
    pub fn resolve(&self) -> FrameImage {
        let Tiling { width, height, .. } = self.tiling;
        let mut image = FrameImage::black(width, height);
        for tile in self.tiles.iter().flatten() {
            for ((x, y), sums) in tile.rect.pixels().zip(&tile.pixels) {
                image.set(y as usize * width as usize + x as usize, sums);
            }
        }
        image
    }
}

impl FrameImage {
    fn black(width: u32, height: u32) -> Self {
        let count = width as usize * height as usize;
        Self {
            color: Image { width, height, pixels: vec![[0.0; 3]; count] },
            variance: vec![[0.0; 3]; count],
            albedo: vec![[0.0; 3]; count],
            depth: vec![0.0; count],
            samples: vec![0; count],
        }
    }

    fn set(&mut self, at: usize, sums: &PixelSums) {
        if sums.count == 0 {
            return;
        }
        let n = f64::from(sums.count);
        for i in 0..3 {
            let mean = sums.color[i].value() / n;
            self.color.pixels[at][i] = mean as f32;
            self.variance[at][i] = variance_of_mean(mean, sums.square[i].value(), n) as f32;
            let unit = f64::from(1u32 << ALBEDO_FRACTION);
            self.albedo[at][i] = (sums.albedo[i] as f64 / unit / n) as f32;
        }
        if sums.hits > 0 {
            self.depth[at] = (sums.depth.value() / f64::from(sums.hits)) as f32;
        }
        self.samples[at] = sums.count;
    }
}

/// Unbiased estimate of the variance of a mean of `n` independent samples from their sum of squares; one sample tells
/// nothing, and the squared mean stands in for it (a relative error of 1).
fn variance_of_mean(mean: f64, squares: f64, n: f64) -> f64 {
    if n < 2.0 {
        return mean * mean;
    }
    ((squares / n - mean * mean) / (n - 1.0)).max(0.0)
}
