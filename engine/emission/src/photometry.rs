//! Measured luminous intensity distributions (LM-63 photometric types A, B and C) as functions of direction.
//!
//! Luminaire frame: nadir is -z, and the photometric horizontal of the zero-degree plane is +x (\[lm63\], key definitions).
//! - Type C: `v` from nadir (0) to zenith (180), `h` counter-clockwise about the vertical axis from +x.
//! - Type B: planes share the horizontal y axis: `v` turns the plane from nadir (0) to +x (90), `h` is the angle within it,
//!   clockwise, that is toward -y.
//! - Type A: planes share the vertical axis: `v` is the elevation (-90 nadir), `h` the azimuth from +x, clockwise.
//!
//! Values are interpolated bilinearly in the angles. Partial tables are expanded. Type C tables have quadrants (0..90), halves
//! (0..180 or 90..270) or a full turn, of which the last plane 360 may be missing. A single plane is rotationally symmetric. Types
//! A and B that start at 0 are mirrored in `h`. Directions beyond the tabulated angles have no intensity.

use femc_math::elementary;
use femc_math::elementary::double;
use femc_math::glam::{DVec3, Vec3A};
use thiserror::Error;

/// Photometric coordinate system.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PhotometryKind {
    /// Vertical axis of rotation, angles from the horizontal.
    A,
    /// Horizontal axis of rotation.
    B,
    /// Vertical axis of rotation, angles from nadir.
    C,
}

/// Reason why a table is not a distribution.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum PhotometryError {
    /// A list of angles is empty, not finite or not strictly ascending.
    #[error("the {axis} angles are not strictly ascending")]
    Angles {
        /// "vertical" or "horizontal".
        axis: &'static str,
    },
    /// The number of candela values is not the product of the numbers of angles.
    #[error(
        "expected one candela value for each pair of {vertical} vertical and {horizontal} horizontal angles, found {found}"
    )]
    Count {
        /// Number of given values.
        found: usize,
        /// Number of vertical angles.
        vertical: usize,
        /// Number of horizontal angles.
        horizontal: usize,
    },
    /// A value is negative or not finite.
    #[error("candela value {index} is negative or not finite")]
    Candela {
        /// Index of the value.
        index: usize,
    },
}

/// Symmetry that maps the horizontal angle of a direction into the table.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Symmetry {
    /// One plane for all angles.
    Rotational,
    /// 0..90 of 360: mirror images in all four quadrants.
    Quadrants,
    /// 0..180: mirror image about the plane 0-180.
    Across0,
    /// 90..270: mirror image about the plane 90-270.
    Across90,
    /// A full turn.
    Full,
    /// Types A and B from 0: mirror image about 0.
    Mirrored,
    /// Types A and B with angles of both signs.
    Signed,
}

/// A luminous intensity distribution, cd by direction.
#[derive(Clone, Debug, PartialEq)]
pub struct IntensityDistribution {
    kind: PhotometryKind,
    symmetry: Symmetry,
    /// Vertical angles, degrees, strictly ascending.
    vertical: Vec<f32>,
    /// Horizontal angles, degrees, strictly ascending; 360 is appended to a full turn without it.
    horizontal: Vec<f32>,
    /// Intensities, cd; `candela[h * vertical.len() + v]`.
    candela: Vec<f32>,
    flux: f64,
}

/// Tolerance in degrees at the ends of the tabulated ranges.
const ANGLE_TOLERANCE: f32 = 1e-3;

impl IntensityDistribution {
    /// Creates the distribution from a table.
    /// - angles in degrees; `candela[h * vertical.len() + v]` in cd, all multipliers applied.
    pub fn new(
        kind: PhotometryKind,
        vertical: &[f64],
        horizontal: &[f64],
        candela: &[f64],
    ) -> Result<Self, PhotometryError> {
        check_angles(vertical, "vertical")?;
        check_angles(horizontal, "horizontal")?;
        let (nv, nh) = (vertical.len(), horizontal.len());
        if candela.len() != nv * nh {
            return Err(PhotometryError::Count { found: candela.len(), vertical: nv, horizontal: nh });
        }
        if let Some(index) = candela.iter().position(|c| !c.is_finite() || *c < 0.0) {
            return Err(PhotometryError::Candela { index });
        }
        let single = |values: &[f64]| -> Vec<f32> { values.iter().map(|&v| v as f32).collect() };
        let mut table = Self {
            kind,
            symmetry: symmetry(kind, horizontal),
            vertical: single(vertical),
            horizontal: single(horizontal),
            candela: single(candela),
            flux: 0.0,
        };
        if table.symmetry == Symmetry::Full && horizontal[nh - 1] < 360.0 - f64::from(ANGLE_TOLERANCE) {
            table.horizontal.push((horizontal[0] + 360.0) as f32);
            table.candela.extend_from_within(..nv);
        }
        table.flux = table.integrate();
        Ok(table)
    }

    /// Returns the luminous intensity, cd, in direction `dir` (unit, luminaire frame, away from the luminaire).
    pub fn intensity(&self, dir: Vec3A) -> f32 {
        let across = elementary::hypot(dir.x, dir.y);
        let (v, h) = match self.kind {
            PhotometryKind::C => (elementary::atan2(across, -dir.z), elementary::atan2(dir.y, dir.x)),
            PhotometryKind::A => (elementary::atan2(dir.z, across), elementary::atan2(-dir.y, dir.x)),
            PhotometryKind::B => {
                let in_plane = elementary::hypot(dir.x, dir.z);
                (elementary::atan2(dir.x, -dir.z), elementary::atan2(-dir.y, in_plane))
            }
        };
        self.interpolate(v.to_degrees(), h.to_degrees())
    }

    /// Returns the total luminous flux, lm, of the tabulated function itself.
    pub fn flux(&self) -> f64 {
        self.flux
    }

    /// Returns the largest tabulated intensity, cd.
    pub fn peak(&self) -> f32 {
        self.candela.iter().copied().fold(0.0, f32::max)
    }

    /// Returns the value at angles in degrees (`v` in the kind's own range, `h` in -180..180).
    fn interpolate(&self, v: f32, h: f32) -> f32 {
        let Some((v0, v1, tv)) = locate(&self.vertical, v) else { return 0.0 };
        let turned = if h < 0.0 { h + 360.0 } else { h };
        let h = match self.symmetry {
            Symmetry::Rotational => self.horizontal[0],
            Symmetry::Quadrants => {
                let half = if turned > 180.0 { 360.0 - turned } else { turned };
                if half > 90.0 { 180.0 - half } else { half }
            }
            Symmetry::Across0 if turned > 180.0 => 360.0 - turned,
            Symmetry::Across90 if turned < 90.0 => 180.0 - turned,
            Symmetry::Across90 if turned > 270.0 => 540.0 - turned,
            Symmetry::Full if turned < self.horizontal[0] => turned + 360.0,
            Symmetry::Across0 | Symmetry::Across90 | Symmetry::Full => turned,
            Symmetry::Mirrored => h.abs(),
            Symmetry::Signed => h,
        };
        // Type C tables that end before their symmetry does continue with their last plane.
        let h = match self.kind {
            PhotometryKind::C => h.clamp(self.horizontal[0], self.horizontal[self.horizontal.len() - 1]),
            PhotometryKind::A | PhotometryKind::B if self.horizontal.len() == 1 => self.horizontal[0],
            PhotometryKind::A | PhotometryKind::B => h,
        };
        let Some((h0, h1, th)) = locate(&self.horizontal, h) else { return 0.0 };
        let n = self.vertical.len();
        let along = |h: usize| {
            let (a, b) = (self.candela[h * n + v0], self.candela[h * n + v1]);
            a + (b - a) * tv
        };
        let (a, b) = (along(h0), along(h1));
        a + (b - a) * th
    }

    /// Integrates the flux exactly, up to rounding: the table is linear in both angles between its nodes, and the value of a
    /// linear function at the centroid of a band is its mean over the band.
    fn integrate(&self) -> f64 {
        // The polar angle of B is h, and that of A and C is v; the weight of a band is its share of the sphere.
        let (polar, about) = match self.kind {
            PhotometryKind::B => (&self.horizontal, &self.vertical),
            PhotometryKind::A | PhotometryKind::C => (&self.vertical, &self.horizontal),
        };
        let bands = match (self.kind, self.horizontal.len()) {
            (PhotometryKind::B, 1) => vec![(-90.0, 90.0)],
            _ => intervals(polar),
        };
        let sectors = match (self.kind, self.symmetry) {
            (_, Symmetry::Rotational) => vec![(0.0, 360.0)],
            (PhotometryKind::C, Symmetry::Quadrants) => intervals(&extended(about, 0.0, 90.0)),
            (PhotometryKind::C, Symmetry::Across0) => intervals(&extended(about, 0.0, 180.0)),
            (PhotometryKind::A, _) if self.horizontal.len() == 1 => vec![(-180.0, 180.0)],
            _ => intervals(about),
        };
        let mut sum = 0.0;
        for &(p0, p1) in &bands {
            // Latitudes ascend with the polar angle; C counts its angle from the nadir.
            let shift = match self.kind {
                PhotometryKind::C => -90.0,
                PhotometryKind::A | PhotometryKind::B => 0.0,
            };
            let (band, centroid) = latitudes((p0 + shift).to_radians(), (p1 + shift).to_radians());
            let middle = (centroid.to_degrees() - shift).clamp(p0, p1);
            for &(a0, a1) in &sectors {
                let (v, h) = match self.kind {
                    PhotometryKind::B => (0.5 * (a0 + a1), middle),
                    PhotometryKind::A | PhotometryKind::C => (middle, 0.5 * (a0 + a1)),
                };
                let h = if h > 180.0 { h - 360.0 } else { h };
                sum += f64::from(self.interpolate(v as f32, h as f32)) * band * (a1 - a0).to_radians();
            }
        }
        let copies = match self.symmetry {
            Symmetry::Quadrants => 4.0,
            Symmetry::Across0 | Symmetry::Across90 => 2.0,
            Symmetry::Mirrored => 2.0,
            Symmetry::Rotational | Symmetry::Full | Symmetry::Signed => 1.0,
        };
        sum * copies
    }
}

fn check_angles(angles: &[f64], axis: &'static str) -> Result<(), PhotometryError> {
    let ascending = angles.windows(2).all(|w| w[0] < w[1]);
    if angles.is_empty() || !ascending || angles.iter().any(|a| !a.is_finite()) {
        return Err(PhotometryError::Angles { axis });
    }
    Ok(())
}

fn symmetry(kind: PhotometryKind, horizontal: &[f64]) -> Symmetry {
    let (first, last) = (horizontal[0], horizontal[horizontal.len() - 1]);
    let slack = f64::from(ANGLE_TOLERANCE);
    match kind {
        PhotometryKind::C if horizontal.len() == 1 => Symmetry::Rotational,
        PhotometryKind::C if (first - 90.0).abs() <= slack && (last - 270.0).abs() <= slack => Symmetry::Across90,
        PhotometryKind::C if last - first <= 90.0 + slack && first >= -slack => Symmetry::Quadrants,
        PhotometryKind::C if last - first <= 180.0 + slack => Symmetry::Across0,
        PhotometryKind::C => Symmetry::Full,
        PhotometryKind::A | PhotometryKind::B if horizontal.len() > 1 && first >= -slack => Symmetry::Mirrored,
        PhotometryKind::A | PhotometryKind::B => Symmetry::Signed,
    }
}

/// Returns the neighbors of `x` in `table` and the fraction between them; `None` beyond the ends.
fn locate(table: &[f32], x: f32) -> Option<(usize, usize, f32)> {
    let last = table.len() - 1;
    if x < table[0] - ANGLE_TOLERANCE || x > table[last] + ANGLE_TOLERANCE {
        return None;
    }
    let above = table.partition_point(|&t| t <= x);
    Some(match above {
        0 => (0, 0, 0.0),
        n if n > last => (last, last, 0.0),
        n => (n - 1, n, (x - table[n - 1]) / (table[n] - table[n - 1])),
    })
}

/// Returns the intervals between neighbors.
fn intervals(nodes: &[f32]) -> Vec<(f64, f64)> {
    nodes.windows(2).map(|pair| (f64::from(pair[0]), f64::from(pair[1]))).collect()
}

/// Returns `nodes` with the ends of the range `first..=last` that they do not reach.
fn extended(nodes: &[f32], first: f32, last: f32) -> Vec<f32> {
    let inner = nodes.iter().copied().filter(|&node| node > first && node < last);
    std::iter::once(first).chain(inner).chain([last]).collect()
}

/// Returns the difference of the sines of two latitudes, and the centroid of the band between them, all in radians.
fn latitudes(from: f64, to: f64) -> (f64, f64) {
    let ((s0, c0), (s1, c1)) = (double::sin_cos(from), double::sin_cos(to));
    let band = s1 - s0;
    let moment = (to - from) * s1 + c1 - c0;
    (band, if band > 0.0 { from + moment / band } else { 0.5 * (from + to) })
}

/// Returns the unit direction, luminaire frame, of the angles (degrees) of a photometric `kind`: the inverse of the tables'
/// convention.
pub fn direction(kind: PhotometryKind, vertical: f64, horizontal: f64) -> DVec3 {
    let (sv, cv) = double::sin_cos(vertical.to_radians());
    let (sh, ch) = double::sin_cos(horizontal.to_radians());
    match kind {
        PhotometryKind::C => DVec3::new(sv * ch, sv * sh, -cv),
        PhotometryKind::B => DVec3::new(ch * sv, -sh, -ch * cv),
        PhotometryKind::A => DVec3::new(cv * ch, -cv * sh, sv),
    }
}

#[cfg(test)]
mod tests;
