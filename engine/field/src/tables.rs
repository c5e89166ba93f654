//! Tables of directions: the guides of the method of 1998. They are a baseline for the present guides.
//!
//! Each leaf has a distribution of directions over cells between parallels and meridians, all of equal solid angle. The probability
//! of a cell is the share of the leaf's light that comes from it. There is no parallax: all points of a leaf have the same table.

use femc_math::Frame;
use femc_math::elementary::atan2;
use femc_math::glam::Vec3A;
use femc_math::warp;
use std::f32::consts::PI;

use crate::NONE;

/// Number of intervals between parallels.
const ROWS: usize = 16;
/// Number of intervals between meridians.
const COLUMNS: usize = 32;
/// Number of cells of a table.
pub const TABLE_CELLS: usize = ROWS * COLUMNS;
/// Share of the directions that is spread evenly over the cells.
const EVEN_SHARE: f32 = 0.02;

/// Directions that a table covers.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum TableExtent {
    /// The hemisphere around a unit normal, which is the pole of the parallels.
    Hemisphere(Vec3A),
    /// All directions. The pole is the z axis of the prepared frame.
    Sphere,
}

impl TableExtent {
    fn frame(self) -> Frame {
        Frame::from_normal(match self {
            Self::Hemisphere(normal) => normal,
            Self::Sphere => Vec3A::Z,
        })
    }

    /// Returns the least cosine with the pole.
    fn min_cosine(self) -> f32 {
        match self {
            Self::Hemisphere(_) => 0.0,
            Self::Sphere => -1.0,
        }
    }
}

/// Cells of an extent: 16 rows between parallels, 32 columns between meridians.
#[derive(Clone, Copy, Debug)]
pub struct TableCells {
    frame: Frame,
    min_cosine: f32,
}

impl TableCells {
    /// Creates the cells.
    #[inline]
    pub fn new(extent: TableExtent) -> Self {
        Self { frame: extent.frame(), min_cosine: extent.min_cosine() }
    }

    /// Returns the cell of a direction. `None`: the extent does not contain it.
    /// - `dir`: unit.
    #[inline]
    pub fn find(&self, dir: Vec3A) -> Option<usize> {
        let local = self.frame.to_local(dir);
        if local.z < self.min_cosine {
            return None;
        }
        let row = (((1.0 - local.z) / (1.0 - self.min_cosine) * ROWS as f32) as usize).min(ROWS - 1);
        let turn = atan2(local.y, local.x) / (2.0 * PI);
        let column = ((if turn < 0.0 { turn + 1.0 } else { turn }) * COLUMNS as f32) as usize;
        Some(row * COLUMNS + column.min(COLUMNS - 1))
    }

    /// Returns the solid angle of a cell, sr.
    fn solid_angle(&self) -> f32 {
        2.0 * PI * (1.0 - self.min_cosine) / TABLE_CELLS as f32
    }
}

/// Distribution of directions over the cells of an extent.
#[derive(Clone, Debug, PartialEq)]
pub struct DirectionTable {
    extent: TableExtent,
    /// Sum of the probabilities of all cells up to each one, row by row; the last is 1.
    sums: Box<[f32; TABLE_CELLS]>,
}

impl DirectionTable {
    /// Creates a table. `None`: there is no light.
    /// - `light`: light by cell ([`TableCells::find`]), in any unit.
    pub fn new(extent: TableExtent, light: &[f64; TABLE_CELLS]) -> Option<Self> {
        let whole: f64 = light.iter().sum();
        if !(whole > 0.0 && whole.is_finite() && light.iter().all(|light| *light >= 0.0)) {
            return None;
        }
        let even = f64::from(EVEN_SHARE) / TABLE_CELLS as f64;
        let mut sum = 0.0;
        let mut sums = Box::new([0.0; TABLE_CELLS]);
        for (out, light) in sums.iter_mut().zip(light) {
            sum += even + (1.0 - f64::from(EVEN_SHARE)) * light / whole;
            *out = sum as f32;
        }
        sums[TABLE_CELLS - 1] = 1.0;
        Self::from_sums(extent, sums)
    }

    /// Creates a table from its sums. `None`: they do not rise to 1, or the pole is not a unit vector.
    pub(crate) fn from_sums(extent: TableExtent, sums: Box<[f32; TABLE_CELLS]>) -> Option<Self> {
        let mut before = 0.0;
        let rises = sums.iter().all(|&sum| std::mem::replace(&mut before, sum) < sum);
        let is_unit = match extent {
            TableExtent::Hemisphere(normal) => (normal.length_squared() - 1.0).abs() < 1e-3,
            TableExtent::Sphere => true,
        };
        (rises && before == 1.0 && is_unit).then_some(Self { extent, sums })
    }

    /// Returns the directions that the table covers.
    pub fn extent(&self) -> TableExtent {
        self.extent
    }

    /// Returns the sum of the probabilities of all cells up to each one.
    pub(crate) fn sums(&self) -> &[f32; TABLE_CELLS] {
        &self.sums
    }

    /// Returns the density of [`Self::sample`] in a unit direction, 1/sr.
    #[inline]
    pub fn pdf(&self, dir: Vec3A) -> f32 {
        let cells = TableCells::new(self.extent);
        cells.find(dir).map_or(0.0, |cell| self.probability(cell) / cells.solid_angle())
    }

    fn probability(&self, cell: usize) -> f32 {
        self.sums[cell] - if cell == 0 { 0.0 } else { self.sums[cell - 1] }
    }

    /// Samples a direction. The first number chooses the parallels, the second the meridians between them.
    /// - `u`: in [0, 1)^2.
    #[inline]
    pub fn sample(&self, u: [f32; 2]) -> Vec3A {
        let row_end = |row: usize| self.sums[(row + 1) * COLUMNS - 1];
        let row = (0..ROWS - 1).take_while(|row| row_end(*row) <= u[0]).count();
        let start = if row == 0 { 0.0 } else { row_end(row - 1) };
        let mass = row_end(row) - start;
        let along = (u[0] - start) / mass;
        let cells = &self.sums[row * COLUMNS..(row + 1) * COLUMNS];
        let wanted = start + u[1] * mass;
        let column = cells[..COLUMNS - 1].partition_point(|sum| *sum <= wanted);
        let before = if column == 0 { start } else { cells[column - 1] };
        let across = ((wanted - before) / (cells[column] - before)).clamp(0.0, 1.0);
        let height = ((row as f32 + along) / ROWS as f32).clamp(0.0, 1.0);
        let cos = 1.0 - (1.0 - self.extent.min_cosine()) * height;
        self.extent.frame().to_world(warp::direction(cos, (column as f32 + across) / COLUMNS as f32))
    }
}

/// Tables of the leaves of a field.
#[derive(Clone, Debug, Default)]
pub struct DirectionTables {
    /// Index of the table by leaf of surfaces, or [`NONE`]; empty without tables.
    by_leaf: Vec<u32>,
    /// Index of the table by leaf of fog, or [`NONE`]; empty without tables.
    by_fog_leaf: Vec<u32>,
    tables: Vec<DirectionTable>,
}

impl DirectionTables {
    /// Creates the tables of a field.
    /// - `leaves`, `fog`: table by leaf of surfaces, and by leaf of fog; `None` for a leaf without light.
    pub fn new(leaves: Vec<Option<DirectionTable>>, fog: Vec<Option<DirectionTable>>) -> Self {
        let mut tables = Vec::new();
        let mut number = |table: Option<DirectionTable>| match table {
            Some(table) => {
                tables.push(table);
                tables.len() as u32 - 1
            }
            None => NONE,
        };
        let by_leaf = leaves.into_iter().map(&mut number).collect();
        let by_fog_leaf = fog.into_iter().map(&mut number).collect();
        Self { by_leaf, by_fog_leaf, tables }
    }

    /// Creates tables from indices of `tables`. `None`: an index is out of its range.
    pub(crate) fn from_indices(by_leaf: Vec<u32>, by_fog_leaf: Vec<u32>, tables: Vec<DirectionTable>) -> Option<Self> {
        let is_valid = |&index: &u32| index == NONE || (index as usize) < tables.len();
        (by_leaf.iter().all(is_valid) && by_fog_leaf.iter().all(is_valid)).then_some(Self {
            by_leaf,
            by_fog_leaf,
            tables,
        })
    }

    /// Checks whether no tables were computed. A field whose leaves have no light has tables without content.
    pub fn is_empty(&self) -> bool {
        self.by_leaf.is_empty() && self.by_fog_leaf.is_empty()
    }

    /// Returns the indices by leaf of surfaces and by leaf of fog, and the tables.
    pub(crate) fn parts(&self) -> (&[u32], &[u32], &[DirectionTable]) {
        (&self.by_leaf, &self.by_fog_leaf, &self.tables)
    }

    /// Returns the table of a leaf of a surface.
    pub fn of_leaf(&self, leaf: u32) -> Option<&DirectionTable> {
        self.tables.get(*self.by_leaf.get(leaf as usize)? as usize)
    }

    /// Returns the table of a leaf of fog.
    pub fn of_fog_leaf(&self, leaf: u32) -> Option<&DirectionTable> {
        self.tables.get(*self.by_fog_leaf.get(leaf as usize)? as usize)
    }

    /// Removes the tables of all leaves for which a condition does not hold.
    /// - `keeps_leaf`, `keeps_fog_leaf`: conditions by index of the leaf of surfaces and of fog.
    pub fn retain(&mut self, keeps_leaf: impl Fn(usize) -> bool, keeps_fog_leaf: impl Fn(usize) -> bool) {
        let select = |indices: &[u32], keeps: &dyn Fn(usize) -> bool| {
            let table =
                |(leaf, &index): (usize, &u32)| self.tables.get(index as usize).filter(|_| keeps(leaf)).cloned();
            indices.iter().enumerate().map(table).collect()
        };
        *self = Self::new(select(&self.by_leaf, &keeps_leaf), select(&self.by_fog_leaf, &keeps_fog_leaf));
    }

    /// Returns the number of leaves of surfaces and of fog that have tables.
    pub fn count(&self) -> [usize; 2] {
        [&self.by_leaf, &self.by_fog_leaf].map(|indices| indices.iter().filter(|index| **index != NONE).count())
    }

    /// Returns the number of bytes of the tables.
    pub fn memory(&self) -> usize {
        let table = size_of::<DirectionTable>() + size_of::<[f32; TABLE_CELLS]>();
        size_of_val(&*self.by_leaf) + size_of_val(&*self.by_fog_leaf) + self.tables.len() * table
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use femc_math::hash::{mix64, unit_f32};
    use femc_stats::testing::{pooled_test, sidak};

    fn table(extent: TableExtent) -> DirectionTable {
        let mut light = [0.0; TABLE_CELLS];
        for (cell, light) in light.iter_mut().enumerate() {
            *light = if cell % 7 == 0 { (cell % 11) as f64 } else { 0.0 };
        }
        light[300] = 900.0;
        DirectionTable::new(extent, &light).expect("light")
    }

    /// Boxes of directions around another axis than the pole. A fine lattice integrates the density, which is discontinuous, over
    /// them.
    #[test]
    fn directions_of_tables_have_their_density() {
        const NUMBER: u64 = 100_000;
        let bin = |dir: Vec3A| {
            let turn = atan2(dir.y, dir.x) / (2.0 * PI) + 0.5;
            let [row, column] = [(dir.z + 1.0) * 5.0, turn * 12.0].map(|at| at as usize);
            row.min(9) * 12 + column.min(11)
        };
        let extents = [TableExtent::Sphere, TableExtent::Hemisphere(Vec3A::new(0.48, -0.6, 0.64))];
        for (number, extent) in (0..).zip(extents) {
            let table = table(extent);
            let uniform = |at: u64, axis: u64| unit_f32((mix64(number << 40 | at << 1 | axis) >> 32) as u32);
            let (mut expected, mut observed) = ([0.0; 120], [0; 120]);
            for z in 0..2000 {
                for turn in 0..1280 {
                    let dir = warp::direction((z as f32 + 0.5) / 1000.0 - 1.0, (turn as f32 + 0.5) / 1280.0);
                    expected[bin(dir)] += f64::from(table.pdf(dir)) * 4.0 * std::f64::consts::PI / (2000.0 * 1280.0);
                }
            }
            let integral: f64 = expected.iter().sum();
            assert!((integral - 1.0).abs() < 1e-3, "{extent:?}: {integral}");
            expected.iter_mut().for_each(|mass| *mass *= NUMBER as f64);
            (0..NUMBER).for_each(|at| observed[bin(table.sample([uniform(at, 0), uniform(at, 1)]))] += 1);
            pooled_test(&expected, &observed).expect(sidak(1e-4, extents.len()), &format!("{extent:?}"));
        }
    }

    /// A cell has the share of its light, but for the part that is spread evenly.
    #[test]
    fn cells_have_the_share_of_their_light() {
        let extent = TableExtent::Sphere;
        let cells = TableCells::new(extent);
        let dir = Vec3A::new(0.2, -0.5, 0.7).normalize();
        let mut light = [0.0; TABLE_CELLS];
        light[cells.find(dir).expect("all directions")] = 3.0;
        light[cells.find(-dir).expect("all directions")] = 1.0;
        let table = DirectionTable::new(extent, &light).expect("light");
        let solid_angle = 4.0 * PI / TABLE_CELLS as f32;
        for (dir, share) in [(dir, 0.75), (-dir, 0.25), (Vec3A::X, 0.0)] {
            let expected = (1.0 - EVEN_SHARE) * share + EVEN_SHARE / TABLE_CELLS as f32;
            assert!((table.pdf(dir) * solid_angle - expected).abs() < 1e-4, "{dir}");
        }
    }

    #[test]
    fn a_leaf_without_light_has_no_table() {
        assert!(DirectionTable::new(TableExtent::Sphere, &[0.0; TABLE_CELLS]).is_none());
        let mut invalid = [1.0; TABLE_CELLS];
        invalid[3] = -1.0;
        assert!(DirectionTable::new(TableExtent::Sphere, &invalid).is_none());
        assert!(TableCells::new(TableExtent::Hemisphere(Vec3A::Z)).find(Vec3A::NEG_Z).is_none());
        let mut tables = DirectionTables::new(vec![None, Some(table(TableExtent::Sphere))], vec![None]);
        assert!(tables.of_leaf(0).is_none() && tables.of_leaf(1).is_some() && tables.of_fog_leaf(0).is_none());
        tables.retain(|leaf| leaf != 1, |_| true);
        assert!(tables.of_leaf(1).is_none() && tables.count() == [0, 0] && !tables.is_empty());
        assert_eq!(tables.memory(), 3 * size_of::<u32>());
    }
}
