//! The tiles of a film, numbered in rows from the upper left corner.

use serde::{Deserialize, Serialize};

use crate::TaskSizes;

/// A film cut into square tiles; the last column and row may be narrower.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct Grid {
    /// Width and height of the film in pixels.
    pub film: [u32; 2],
    /// Side of a tile in pixels.
    pub tile: u32,
}

/// Pixels of a tile: `x..x + width`, `y..y + height`, y downwards.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct TileRect {
    /// First column.
    pub x: u32,
    /// First row.
    pub y: u32,
    /// Columns.
    pub width: u32,
    /// Rows.
    pub height: u32,
}

impl TileRect {
    /// Returns the number of pixels.
    pub const fn pixels(&self) -> u64 {
        self.width as u64 * self.height as u64
    }
}

impl Grid {
    /// Returns the number of tiles.
    pub const fn tiles(&self) -> u32 {
        self.film[0].div_ceil(self.tile) * self.film[1].div_ceil(self.tile)
    }

    /// Returns the number of pixels of the film.
    pub const fn pixels(&self) -> u64 {
        self.film[0] as u64 * self.film[1] as u64
    }

    /// Returns the tiles as task sizes: one unit per pixel.
    pub fn sizes(&self) -> TaskSizes {
        let rects = (0..self.tiles()).filter_map(|tile| self.rect(tile));
        rects.map(|rect| (1, rect.pixels())).collect()
    }

    /// Returns the tile with number `index`, or `None` past the last.
    pub fn rect(&self, index: u32) -> Option<TileRect> {
        if index >= self.tiles() {
            return None;
        }
        let columns = self.film[0].div_ceil(self.tile);
        let (x, y) = (index % columns * self.tile, index / columns * self.tile);
        Some(TileRect { x, y, width: self.tile.min(self.film[0] - x), height: self.tile.min(self.film[1] - y) })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_tiles_cover_every_pixel_once() {
        let grid = Grid { film: [100, 50], tile: 32 };
        let mut seen = vec![0; 5000];
        for index in 0..grid.tiles() {
            let rect = grid.rect(index).unwrap();
            for y in rect.y..rect.y + rect.height {
                for x in rect.x..rect.x + rect.width {
                    seen[(y * 100 + x) as usize] += 1;
                }
            }
        }
        assert!(seen.iter().all(|&count| count == 1));
        assert_eq!(grid.rect(grid.tiles()), None);
    }
}
