//! Emission directions of a luminaire, sampled in proportion to its flux.

use super::SplitMix64;
use crate::description::{Photometry, PhotometryType};
use femc_math::elementary::double::{asin, sin_cos};
use femc_math::glam::DVec3;

/// Tolerance on the limits of horizontal angles, degrees, as in the renderer's tables.
const SLACK: f64 = 1e-3;

/// Cells of a luminaire's table, weighted by their flux.
pub(crate) struct EmissionSampler {
    kind: PhotometryType,
    symmetry: Symmetry,
    /// Cells in the order of the table; `cumulative_flux` ascends.
    cells: Vec<Cell>,
}

/// A cell between neighboring angles of the table.
struct Cell {
    /// Sum of the flux up to and including this cell, in units of the table.
    cumulative_flux: f64,
    vertical: [f64; 2],
    horizontal: [f64; 2],
}

/// Symmetry of the table: it leaves out directions that are mirror images of others.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Symmetry {
    None,
    /// Mirrored about the plane of 0 degrees.
    Across0,
    /// Mirrored about the plane of 90 degrees.
    Across90,
    /// Mirrored about both planes.
    Quadrants,
}

impl EmissionSampler {
    /// Builds the cells. Returns `None` for a table that emits nothing.
    pub fn new(table: &Photometry) -> Option<Self> {
        let (first, last) = (*table.horizontal.first()?, *table.horizontal.last()?);
        let is_single = table.horizontal.len() == 1;
        let symmetry = match table.kind {
            PhotometryType::C if is_single => Symmetry::None,
            PhotometryType::C if (first - 90.0).abs() <= SLACK && (last - 270.0).abs() <= SLACK => Symmetry::Across90,
            PhotometryType::C if last - first <= 90.0 + SLACK && first >= -SLACK => Symmetry::Quadrants,
            PhotometryType::C if last - first <= 180.0 + SLACK => Symmetry::Across0,
            PhotometryType::A | PhotometryType::B if !is_single && first >= -SLACK => Symmetry::Across0,
            _ => Symmetry::None,
        };
        let planes = planes(table, symmetry);
        let mut sampler = Self { kind: table.kind, symmetry, cells: Vec::new() };
        let (count, mut sum) = (table.vertical.len(), 0.0);
        for sector in planes.windows(2) {
            let horizontal = [sector[0].0, sector[1].0];
            for v in 1..count {
                let vertical = [table.vertical[v - 1], table.vertical[v]];
                let corner = |plane: usize, v: usize| table.candela.get(plane * count + v).copied().unwrap_or(0.0);
                let corners = [corner(sector[0].1, v - 1), corner(sector[0].1, v), corner(sector[1].1, v - 1)];
                let candela = corners.into_iter().sum::<f64>() + corner(sector[1].1, v);
                let flux = candela * sampler.solid_angle(vertical, horizontal);
                if flux > 0.0 {
                    sum += flux;
                    sampler.cells.push(Cell { cumulative_flux: sum, vertical, horizontal });
                }
            }
        }
        (sum > 0.0 && sum.is_finite()).then_some(sampler)
    }

    /// Returns the solid angle of a cell, in arbitrary units.
    fn solid_angle(&self, vertical: [f64; 2], horizontal: [f64; 2]) -> f64 {
        let sine = |degrees: f64| sin_cos(degrees.to_radians()).0;
        let cosine = |degrees: f64| sin_cos(degrees.to_radians()).1;
        let [v, h] = [vertical, horizontal].map(|[low, high]| high - low);
        match self.kind {
            PhotometryType::C => h * (cosine(vertical[0]) - cosine(vertical[1])),
            PhotometryType::A => h * (sine(vertical[1]) - sine(vertical[0])),
            PhotometryType::B => v * (sine(horizontal[1]) - sine(horizontal[0])),
        }
    }

    /// Returns a random unit direction in the luminaire's frame.
    /// - `at`: position in the cumulative flux, in [0, 1).
    pub fn sample_direction(&self, at: f64, rng: &mut SplitMix64) -> DVec3 {
        let sum = self.cells.last().map_or(0.0, |cell| cell.cumulative_flux);
        let index = self.cells.partition_point(|cell| cell.cumulative_flux <= at * sum).min(self.cells.len() - 1);
        let Cell { vertical, horizontal, .. } = self.cells[index];
        let [a, b] = [rng.next_f64(), rng.next_f64()];
        let even = |[low, high]: [f64; 2], u: f64| low + (high - low) * u;
        // Angles about the polar axis are uniform; angles from it are sampled by solid angle.
        let sine = |ends: [f64; 2], u: f64| {
            asin(even(ends.map(|degrees| sin_cos(degrees.to_radians()).0), u).clamp(-1.0, 1.0)).to_degrees()
        };
        let (v, h) = match self.kind {
            PhotometryType::C => (sine(vertical.map(|v| v - 90.0), a) + 90.0, even(horizontal, b)),
            PhotometryType::A => (sine(vertical, a), even(horizontal, b)),
            PhotometryType::B => (even(vertical, a), sine(horizontal, b)),
        };
        let h = match (self.symmetry, (4.0 * rng.next_f64()) as u32) {
            (Symmetry::Across0, 0 | 1) | (Symmetry::Quadrants, 0) => -h,
            (Symmetry::Across90, 0 | 1) | (Symmetry::Quadrants, 1) => 180.0 - h,
            (Symmetry::Quadrants, 2) => 180.0 + h,
            _ => h,
        };
        direction(self.kind, v, h)
    }
}

/// Returns the horizontal angles with their planes in the table, extended to the limits of the symmetry.
fn planes(table: &Photometry, symmetry: Symmetry) -> Vec<(f64, usize)> {
    let limits = match (table.kind, symmetry) {
        (PhotometryType::C, Symmetry::Quadrants) => Some([0.0, 90.0]),
        (PhotometryType::C, Symmetry::Across0) => Some([0.0, 180.0]),
        (PhotometryType::C, Symmetry::Across90) => Some([90.0, 270.0]),
        (PhotometryType::C, Symmetry::None) if table.horizontal.len() == 1 => Some([0.0, 360.0]),
        (PhotometryType::A, _) if table.horizontal.len() == 1 => Some([-180.0, 180.0]),
        (PhotometryType::B, _) if table.horizontal.len() == 1 => Some([-90.0, 90.0]),
        _ => None,
    };
    let mut planes: Vec<(f64, usize)> = table.horizontal.iter().copied().zip(0..).collect();
    let (first, last) = (planes[0], planes[planes.len() - 1]);
    match limits {
        Some([low, high]) if planes.len() == 1 => planes = vec![(low, 0), (high, 0)],
        Some([low, high]) => {
            if first.0 > low + SLACK {
                planes.insert(0, (low, first.1));
            }
            if last.0 < high - SLACK {
                planes.push((high, last.1));
            }
        }
        None if table.kind == PhotometryType::C && last.0 < 360.0 - SLACK => planes.push((first.0 + 360.0, first.1)),
        None => {}
    }
    planes
}

/// Returns the unit direction of two angles, degrees, in the luminaire's frame: nadir is -z.
fn direction(kind: PhotometryType, vertical: f64, horizontal: f64) -> DVec3 {
    let (sv, cv) = sin_cos(vertical.to_radians());
    let (sh, ch) = sin_cos(horizontal.to_radians());
    match kind {
        PhotometryType::C => DVec3::new(sv * ch, sv * sh, -cv),
        PhotometryType::B => DVec3::new(ch * sv, -sh, -ch * cv),
        PhotometryType::A => DVec3::new(cv * ch, -cv * sh, sv),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::description::{Location, Opening};

    fn table(kind: PhotometryType, vertical: &[f64], horizontal: &[f64], candela: &[f64]) -> Photometry {
        let (vertical, horizontal, candela) = (vertical.to_vec(), horizontal.to_vec(), candela.to_vec());
        let (path, location, opening) = (String::new(), Location::default(), Opening::Point);
        Photometry { path, kind, vertical, horizontal, candela, opening, location }
    }

    fn mean(table: &Photometry) -> DVec3 {
        let (sampler, mut rng) = (EmissionSampler::new(table).expect("it emits"), SplitMix64(3));
        (0..4096).map(|k| sampler.sample_direction((f64::from(k) + 0.5) / 4096.0, &mut rng)).sum::<DVec3>() / 4096.0
    }

    #[test]
    fn directions_lie_in_the_table_and_have_its_symmetry() {
        use PhotometryType::{A, B, C};
        let near = |found: DVec3, wanted: [f64; 3]| {
            assert!(found.abs_diff_eq(DVec3::from_array(wanted), 0.02), "{found} {wanted:?}");
        };
        let ball = table(C, &[0.0, 90.0, 180.0], &[0.0], &[1.0; 3]);
        near(mean(&ball), [0.0; 3]);
        let down = table(C, &[0.0, 90.0], &[0.0], &[1.0; 2]);
        near(mean(&down), [0.0, 0.0, -0.5]);
        near(mean(&table(C, &[0.0, 90.0], &[0.0, 90.0], &[1.0; 4])), [0.0, 0.0, -0.5]);
        near(mean(&table(C, &[0.0, 90.0], &[90.0, 270.0], &[1.0; 4])), [0.0, 0.0, -0.5]);
        // A floodlight's beam is centered on nadir, a headlamp's on the horizontal x axis.
        near(mean(&table(B, &[-90.0, 90.0], &[0.0, 90.0], &[1.0; 4])), [0.0, 0.0, -0.5]);
        near(mean(&table(A, &[-90.0, 90.0], &[0.0, 90.0], &[1.0; 4])), [0.5, 0.0, 0.0]);
        // All directions lie in a narrow beam.
        let beam = table(C, &[0.0, 1.0, 2.0, 180.0], &[0.0], &[9.0, 9.0, 0.0, 0.0]);
        assert!(mean(&beam).z < -0.999);
        assert!(EmissionSampler::new(&table(C, &[0.0, 180.0], &[0.0], &[0.0; 2])).is_none());
    }
}
