//! Regions of surfaces: a grid over the parameters of each surface, for lookups in constant time.
//!
//! The grids are as fine as the leaves, within limits. A grid cell has the data of the leaf at its center, so a region only
//! approximates a leaf. Guides may be wrong without changing a mean, so this is enough for them.

use crate::{Cell, Leaf, NONE, Split};
use femc_math::glam::Vec2;

/// A region of a surface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Region {
    /// Index of its data.
    pub data: u32,
    /// Mean irradiance of its leaf, lx by channel, without direct light from light sources.
    pub light: [f32; 3],
}

/// Grids of all surfaces.
#[derive(Clone, Debug, Default)]
pub(crate) struct RegionGrids {
    grids: Vec<Grid>,
    regions: Vec<Region>,
}

/// Grid of a surface: the index of its first region, or [`NONE`], and the binary logarithm of its size by parameter.
#[derive(Clone, Copy, Debug)]
struct Grid {
    first: u32,
    bits: [u8; 2],
}

/// Maximum of the binary logarithm of the number of regions of a surface.
const MAX_BITS: u32 = 14;
/// Binary logarithm of the maximum number of regions for each leaf of a surface; for triangles, whose cells do not lie along the
/// parameters, and which fill only half of their grids, one more.
const BITS_OVER_LEAVES: u32 = 2;
/// Maximum number of regions for each cell of the field.
const MAX_REGIONS_OVER_CELLS: usize = 8;

/// Number of leaves below a cell, and of splits on the longest way to one: by parameter, and bisections.
#[derive(Clone, Copy, Default)]
struct Depth {
    leaves: u32,
    splits: [u32; 3],
}

impl RegionGrids {
    /// Creates the grids.
    /// - `roots`: first cell by surface, or [`NONE`];
    /// - `cells`: parts of surfaces down to `leaves`; halves come after the cell that contains them;
    /// - `data`: data by leaf.
    pub fn new(roots: &[u32], cells: &[Cell], leaves: &[Leaf], data: &[u32]) -> Self {
        let mut depths = vec![Depth::default(); cells.len()];
        for (index, cell) in cells.iter().enumerate().rev() {
            let next = cell.next as usize;
            depths[index] = match cell.split {
                Split::None => Depth { leaves: 1, splits: [0; 3] },
                split => {
                    let [a, b] = [depths[next], depths[next + 1]];
                    let mut splits = [0, 1, 2].map(|axis| a.splits[axis].max(b.splits[axis]));
                    splits[match split {
                        Split::None | Split::Half(0) => 0,
                        Split::Half(_) => 1,
                        Split::Bisection => 2,
                    }] += 1;
                    Depth { leaves: a.leaves.saturating_add(b.leaves), splits }
                }
            };
        }
        let light: Vec<[f32; 3]> = leaves.iter().map(|leaf| leaf.mean_irradiance().to_array()).collect();
        let most = MAX_REGIONS_OVER_CELLS * cells.len();
        let mut out = Self { grids: Vec::with_capacity(roots.len()), regions: Vec::new() };
        for &root in roots {
            if root == NONE {
                out.grids.push(Grid { first: NONE, bits: [0; 2] });
                continue;
            }
            let mut bits = depths[root as usize].bits();
            if out.regions.len() + (1 << (bits[0] + bits[1])) > most {
                bits = [0; 2];
            }
            out.grids.push(Grid { first: out.regions.len() as u32, bits });
            let [width, height] = bits.map(|bits| 1u32 << bits);
            for place in (0..width * height).map(|at| [at % width, at / width]) {
                let center = Vec2::new((place[0] as f32 + 0.5) / width as f32, (place[1] as f32 + 0.5) / height as f32);
                if let Some((leaf, _)) = Cell::find(cells, root, center) {
                    out.regions.push(Region { data: data[leaf as usize], light: light[leaf as usize] });
                }
            }
        }
        out
    }

    /// Returns the region of a point of a surface. `None` if the surface has no data.
    /// - `place`: the point's parameters on the surface.
    #[inline]
    pub fn at(&self, surface: u32, place: impl FnOnce() -> Vec2) -> Option<Region> {
        let Grid { first, bits } = *self.grids.get(surface as usize)?;
        if first == NONE {
            return None;
        }
        let mut index = first;
        if bits != [0; 2] {
            let place = place();
            let along = |at: f32, bits: u8| {
                let size = 1u32 << bits;
                // A conversion to an integer clamps negative numbers and NaN to 0.
                ((at * size as f32) as u32).min(size - 1)
            };
            index += along(place.x, bits[0]) + (along(place.y, bits[1]) << bits[0]);
        }
        self.regions.get(index as usize).copied()
    }
}

impl Depth {
    /// Returns the binary logarithm of the size of a grid by parameter.
    fn bits(self) -> [u8; 2] {
        let [x, y, bisections] = self.splits;
        let finer = u32::from(bisections > 0);
        let mut bits = [x, y].map(|bits| bits + bisections.div_ceil(2) + finer);
        let most = MAX_BITS.min(self.leaves.next_power_of_two().ilog2() + BITS_OVER_LEAVES + finer);
        while bits[0] + bits[1] > most {
            let longer = usize::from(bits[1] > bits[0]);
            bits[longer] -= 1;
        }
        bits.map(|bits| bits as u8)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Outline;
    use femc_math::Rgb;

    /// Splits a surface into leaves, breadth first. `split`: split of the cell with this number, or none.
    fn cells(split: impl Fn(usize) -> Split) -> (Vec<Cell>, Vec<Leaf>) {
        let mut outlines = vec![Outline::WHOLE];
        let (mut cells, mut leaves) = (Vec::new(), Vec::new());
        while let Some(&outline) = outlines.get(cells.len()) {
            let split = split(cells.len());
            let next = if split == Split::None {
                leaves.push(Leaf::Triangle([Rgb::splat(leaves.len() as f32); 3]));
                leaves.len() - 1
            } else {
                outlines.extend(Outline::halves(split, |a, b| (b - a).length()));
                outlines.len() - 2
            };
            cells.push(Cell { outline, split, next: next as u32 });
        }
        (cells, leaves)
    }

    /// Uneven splits of a rectangle, first by one parameter and then by the other: regions are exact, up to the limits of the grid.
    #[test]
    fn regions_of_a_rectangle_are_its_leaves() {
        let (cells, leaves) = cells(|number| match number {
            0 | 1 => Split::Half(0),
            2 | 4 | 6 => Split::Half(1),
            _ => Split::None,
        });
        let data: Vec<u32> = (0..leaves.len() as u32).map(|leaf| 10 * leaf).collect();
        let grids = RegionGrids::new(&[NONE, 0], &cells, &leaves, &data);
        assert!(grids.at(0, || Vec2::splat(0.5)).is_none() && grids.at(2, || Vec2::splat(0.5)).is_none());
        for place in (0..400).map(|at| Vec2::new((at % 20) as f32 + 0.5, (at / 20) as f32 + 0.5) / 20.0) {
            let (leaf, _) = Cell::find(&cells, 0, place).expect("a leaf");
            let region = grids.at(1, || place).expect("a region");
            assert_eq!((region.data, region.light), (10 * leaf, [leaf as f32; 3]), "{place}");
        }
        for outside in [-1.0, 2.0, f32::NAN, f32::INFINITY] {
            assert!(grids.at(1, || Vec2::new(outside, 0.1)).is_some());
        }
    }

    /// Cells of a triangle do not lie along the parameters, so regions at the borders of leaves may differ.
    #[test]
    fn most_regions_of_a_triangle_are_its_leaves() {
        let (cells, leaves) = cells(|number| if number < 31 { Split::Bisection } else { Split::None });
        let data: Vec<u32> = (0..leaves.len() as u32).collect();
        let grids = RegionGrids::new(&[0], &cells, &leaves, &data);
        let places = (0..1600).map(|at| Vec2::new((at % 40) as f32 + 0.3, (at / 40) as f32 + 0.4) / 40.0);
        let inside: Vec<Vec2> = places.filter(|place| place.x + place.y < 1.0).collect();
        let is_exact = |place: &&Vec2| {
            let leaf = Cell::find(&cells, 0, **place).map(|(leaf, _)| leaf);
            grids.at(0, || **place).map(|region| region.data) == leaf
        };
        let exact = inside.iter().filter(is_exact).count();
        assert!(exact * 10 > inside.len() * 7, "{exact} of {}", inside.len());
    }

    /// A long chain of splits has no grid as fine as its last leaf.
    #[test]
    fn the_number_of_regions_is_limited() {
        let (cells, leaves) = cells(|number| if number % 2 == 0 && number < 60 { Split::Half(0) } else { Split::None });
        let grids = RegionGrids::new(&[0], &cells, &leaves, &vec![0; leaves.len()]);
        assert!(grids.regions.len() <= 8 * leaves.len(), "{} for {}", grids.regions.len(), leaves.len());
    }
}
