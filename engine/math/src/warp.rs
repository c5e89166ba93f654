//! Maps from the unit square to directions and discs. All densities are per steradian or per unit area.

use crate::elementary::{sin_cos_of_octant, sin_cos_of_turns};
use glam::{Vec2, Vec3A};
use std::f32::consts::{FRAC_1_PI, FRAC_PI_4};

/// Maps to a uniform point in the unit disc, concentric map (\[shirley1997\]); density 1/pi.
#[inline]
pub fn disc(u: [f32; 2]) -> Vec2 {
    let (a, b) = (2.0 * u[0] - 1.0, 2.0 * u[1] - 1.0);
    // The angle is measured from the nearer axis.
    let along_x = a.abs() > b.abs();
    let (most, least) = if along_x { (a, b) } else { (b, a) };
    let ratio = if most == 0.0 { 0.0 } else { least / most };
    let (sin, cos) = sin_cos_of_octant(FRAC_PI_4 * ratio);
    let (along, across) = (most * cos, most * sin);
    if along_x { Vec2::new(along, across) } else { Vec2::new(across, along) }
}

/// Maps to a cosine-distributed direction about +z; density `cos / pi`.
#[inline]
pub fn cosine_hemisphere(u: [f32; 2]) -> Vec3A {
    let d = disc(u);
    Vec3A::new(d.x, d.y, (1.0 - d.length_squared()).max(0.0).sqrt())
}

/// Returns the density of [`cosine_hemisphere`], 1/sr, for a direction with cosine `cos` (0 below the horizon).
#[inline]
pub fn cosine_hemisphere_pdf(cos: f32) -> f32 {
    cos.max(0.0) * FRAC_1_PI
}

/// Maps to a uniform direction on the sphere; density 1/(4 pi).
#[inline]
pub fn sphere(u: [f32; 2]) -> Vec3A {
    direction(1.0 - 2.0 * u[0], u[1])
}

/// Returns the unit vector with z = `cos` and azimuth `2 pi u`.
#[inline]
pub fn direction(cos: f32, u: f32) -> Vec3A {
    let sin = ((1.0 - cos) * (1.0 + cos)).max(0.0).sqrt();
    let (s, c) = sin_cos_of_turns(u);
    Vec3A::new(sin * c, sin * s, cos)
}

/// Returns the unit vector with 1 - z = `versine`, 0 to 2, and azimuth `2 pi u`. Small versines keep their precision near the axis.
#[inline]
pub fn direction_from_versine(versine: f64, u: f32) -> Vec3A {
    let versine = versine.clamp(0.0, 2.0);
    let sin = (versine * (2.0 - versine)).sqrt() as f32;
    let (s, c) = sin_cos_of_turns(u);
    Vec3A::new(sin * c, sin * s, (1.0 - versine) as f32)
}

/// Maps to uniform barycentric coordinates (b1, b2) on a triangle, low distortion (\[heitz2019\]).
#[inline]
pub fn triangle(u: [f32; 2]) -> [f32; 2] {
    if u[1] > u[0] {
        let x = u[0] * 0.5;
        [x, u[1] - x]
    } else {
        let y = u[1] * 0.5;
        [u[0] - y, y]
    }
}
