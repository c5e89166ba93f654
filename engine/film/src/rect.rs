//! Pixel rectangles and the division of a film into tiles.

use crate::FilmError;
use serde::{Deserialize, Serialize};

/// Maximum number of pixels of a film (8192 x 8192).
pub const MAX_FILM_PIXELS: u64 = 1 << 26;

/// Pixels `x .. x + width`, `y .. y + height` of a film; y points down, (0, 0) is the top left pixel.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
pub struct Rect {
    /// Leftmost column.
    pub x: u32,
    /// Top row.
    pub y: u32,
    /// Number of columns.
    pub width: u32,
    /// Number of rows.
    pub height: u32,
}

impl Rect {
    /// Returns the number of pixels.
    pub fn area(&self) -> u64 {
        u64::from(self.width) * u64::from(self.height)
    }

    /// Checks whether the rectangle contains the pixel (`x`, `y`) of the film.
    #[inline]
    pub fn contains(&self, x: u32, y: u32) -> bool {
        x.wrapping_sub(self.x) < self.width && y.wrapping_sub(self.y) < self.height
    }

    /// Returns the pixels (x, y) of the film, row by row.
    pub fn pixels(self) -> impl Iterator<Item = (u32, u32)> {
        (0..self.height).flat_map(move |y| (0..self.width).map(move |x| (self.x + x, self.y + y)))
    }

    pub(crate) fn check(self, limit: u64) -> Result<Self, FilmError> {
        let fits = |start: u32, length: u32| start.checked_add(length).is_some();
        if (1..=limit).contains(&self.area()) && fits(self.x, self.width) && fits(self.y, self.height) {
            return Ok(self);
        }
        Err(FilmError::Size { width: self.width.into(), height: self.height.into(), limit })
    }
}

impl std::fmt::Display for Rect {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}x{}+{}+{}", self.width, self.height, self.x, self.y)
    }
}

/// Division of a film into square tiles, row by row from the top left; the last tiles of a row and those of the last row may be
/// smaller.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct Tiling {
    /// Film width, pixels.
    pub width: u32,
    /// Film height, pixels.
    pub height: u32,
    /// Edge of a tile, pixels.
    pub edge: u32,
}

impl Tiling {
    /// Creates a tiling. Checks that the numbers of pixels of film and tiles are positive and within the limits.
    pub fn new(width: u32, height: u32, edge: u32) -> Result<Self, FilmError> {
        Rect { x: 0, y: 0, width, height }.check(MAX_FILM_PIXELS)?;
        Rect { x: 0, y: 0, width: edge.min(width), height: edge.min(height) }.check(crate::tile::MAX_TILE_PIXELS)?;
        Ok(Self { width, height, edge })
    }

    /// Returns the number of tiles.
    pub fn count(&self) -> usize {
        self.columns() as usize * self.height.div_ceil(self.edge) as usize
    }

    /// Returns the pixels of tile `index`; `None` past the last one.
    pub fn rect(&self, index: usize) -> Option<Rect> {
        if index >= self.count() {
            return None;
        }
        let (row, column) = (index as u32 / self.columns(), index as u32 % self.columns());
        let (x, y) = (column * self.edge, row * self.edge);
        Some(Rect { x, y, width: self.edge.min(self.width - x), height: self.edge.min(self.height - y) })
    }

    /// Returns all tiles in order.
    pub fn rects(self) -> impl Iterator<Item = Rect> {
        (0..self.count()).filter_map(move |i| self.rect(i))
    }

    /// Returns the tile with exactly these pixels.
    pub fn index_of(&self, rect: Rect) -> Option<usize> {
        let index =
            rect.y as usize / self.edge as usize * self.columns() as usize + rect.x as usize / self.edge as usize;
        (self.rect(index) == Some(rect)).then_some(index)
    }

    fn columns(&self) -> u32 {
        self.width.div_ceil(self.edge)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tiles_cover_every_pixel_once_and_know_their_index() {
        for (width, height, edge) in [(1, 1, 64), (64, 64, 64), (65, 63, 64), (100, 37, 16), (7, 300, 9)] {
            let tiling = Tiling::new(width, height, edge).unwrap();
            let mut seen = vec![0; (width * height) as usize];
            for (i, rect) in tiling.rects().enumerate() {
                assert_eq!(tiling.index_of(rect), Some(i));
                rect.pixels().for_each(|(x, y)| seen[(y * width + x) as usize] += 1);
            }
            assert!(seen.iter().all(|&n| n == 1));
            assert_eq!(tiling.rect(tiling.count()), None);
            assert_eq!(tiling.index_of(Rect { x: 1, y: 0, width: 1, height: 1 }), None);
        }
    }

    #[test]
    fn films_without_pixels_or_with_too_many_are_refused() {
        for (w, h, e) in
            [(0, 1, 1), (1, 0, 1), (1, 1, 0), (u32::MAX, u32::MAX, 64), (8193, 8192, 64), (8192, 8192, 8192)]
        {
            assert!(matches!(Tiling::new(w, h, e), Err(FilmError::Size { .. })), "{w}x{h}/{e}");
        }
        assert!(Tiling::new(8192, 8192, 64).is_ok());
    }
}
