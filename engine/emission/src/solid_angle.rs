//! Triangles and rectangles seen from a point: solid angle, and uniform points over it.
//!
//! The reference point is already subtracted. One arc tangent gives the solid angle. Sines and cosines of the spherical angles come
//! from the edges' plane normals, so a sample costs only one more sine-cosine. [`RectangleView`] computes in single precision, all else in
//! double precision.

use femc_math::elementary::double::{atan2, sin_cos};
use femc_math::elementary::{fast_atan2, sin_cos_of_turns};
use femc_math::glam::DVec3;
use std::f64::consts::TAU;

/// Solid angle below which points are sampled by area: the integrand is flat over such a small light.
pub const MIN_SOLID_ANGLE: f64 = 1e-8;
/// Square of (radius / distance) below which a light counts as far. The density over solid angle of a point sampled by area then
/// varies little, and sampling by area costs a tenth.
pub const FAR_RATIO2: f32 = 0.05;

/// Checks whether a flat light is far.
/// - `reach2`: square of its radius about its middle, m2; `distance2`: squared distance of its middle from the reference, m2.
#[inline]
pub fn is_far(reach2: f32, distance2: f32) -> bool {
    reach2 < FAR_RATIO2 * distance2
}

/// Solid angle above which directions are sampled over the hemisphere and tested: the spherical angles degenerate toward 2 pi.
pub const MAX_SOLID_ANGLE: f64 = 6.2;

/// Sampling strategy for points of a flat light from one reference point, shared by `sample` and `pdf`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Strategy {
    /// Uniform over this solid angle, sr.
    SolidAngle(f64),
    /// Uniform over the hemisphere on the light's side; directions that miss are dropped.
    Hemisphere,
    /// Uniform over the area.
    Area,
    /// The reference is in the light's plane: nothing arrives.
    EdgeOn,
}

impl Strategy {
    /// Returns the strategy for a `solid_angle`.
    #[inline]
    pub fn from_solid_angle(solid_angle: f64) -> Self {
        if solid_angle >= MAX_SOLID_ANGLE {
            Self::Hemisphere
        } else if solid_angle >= MIN_SOLID_ANGLE {
            Self::SolidAngle(solid_angle)
        } else if solid_angle > 0.0 {
            Self::Area
        } else {
            Self::EdgeOn
        }
    }
}

/// Computes the solid angle, sr in [0, 2 pi], of the triangle with vertices `a`, `a + e1`, `a + e2` seen from the origin
/// (\[vanoosterom1983\]). `cross` is `e1 x e2`; the volume is computed from it, and not from three nearly parallel vertex vectors.
#[inline]
pub fn triangle(a: DVec3, e1: DVec3, e2: DVec3, cross: DVec3) -> f64 {
    let (b, c) = (a + e1, a + e2);
    let (la, lb, lc) = (a.length(), b.length(), c.length());
    let denominator = la * lb * lc + a.dot(b) * lc + a.dot(c) * lb + b.dot(c) * la;
    2.0 * atan2(a.dot(cross).abs(), denominator)
}

/// Samples a direction uniformly over the spherical triangle of `solid_angle` sr with the vertices `a`, `b`, `c` (\[arvo1995\]).
/// `None` if the triangle is degenerate.
pub fn sample_triangle(a: DVec3, b: DVec3, c: DVec3, solid_angle: f64, u: [f32; 2]) -> Option<DVec3> {
    let (a, b, c) = (a.normalize(), b.normalize(), c.normalize());
    // Cross products of differences are exact to rounding for narrow triangles.
    let ab = a.cross(b - a).normalize();
    let ca = c.cross(a - c).normalize();
    let cos_alpha = (-ab.dot(ca)).clamp(-1.0, 1.0);
    let sin_alpha = ab.cross(ca).length();
    // A smaller triangle a, b, c' of area u S: q = (angle phi at ...) of Arvo's equations 5 to 9, with 1 - cos kept.
    let (s, _) = sin_cos(f64::from(u[0]) * solid_angle);
    let (half, _) = sin_cos(0.5 * f64::from(u[0]) * solid_angle);
    let versine = 2.0 * half * half;
    let cosine = 1.0 - versine;
    let sin_phi = cosine * sin_alpha - s * cos_alpha;
    let cos_phi = -cosine * cos_alpha - s * sin_alpha;
    let k1 = cos_alpha * versine - s * sin_alpha;
    let k2 = -s * cos_alpha + sin_alpha * (0.5 * (a - b).length_squared() - versine);
    let denominator = (k2 * sin_phi + k1 * cos_phi) * sin_alpha;
    let cos_b = if denominator == 0.0 {
        1.0 // For u = 0, c' is a.
    } else {
        ((k2 + (k2 * cos_phi - k1 * sin_phi) * cos_alpha) / denominator).clamp(-1.0, 1.0)
    };
    let across = (c - a * c.dot(a)).normalize();
    let c_new = a * cos_b + across * (1.0 - cos_b * cos_b).max(0.0).sqrt();
    // Uniform height on the arc from b to c'.
    let versine = f64::from(u[1]) * 0.5 * (c_new - b).length_squared();
    let away = c_new - b * c_new.dot(b);
    let w = b * (1.0 - versine) + away.normalize_or_zero() * (versine * (2.0 - versine)).max(0.0).sqrt();
    w.is_finite().then_some(w)
}

/// Solid angle, sr, above which a [`RectangleView`] is precise. Below, at grazing directions, points are sampled by area.
pub const MIN_RECTANGLE_SOLID_ANGLE: f32 = 0.03;

/// A rectangle as seen from a point, in single precision, with the axes x and y along its sides and the point at the origin.
/// Coordinates are in units of the rectangle's extent, the sum of its sides.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RectangleView {
    x: [f32; 2],
    y: [f32; 2],
    z: f32,
    solid_angle: f32,
    /// Unit complex number with the angle g2 + g3 of \[urena2013\].
    far_angles: [f32; 2],
}

impl RectangleView {
    /// Creates the view.
    /// - `corner`: coordinates of the corner with the least x and y, m, z > 0; `size`: extents, m.
    #[inline]
    pub fn new(corner: [f32; 3], size: [f32; 2]) -> Self {
        // In units of the extent, products of coordinates neither overflow nor vanish.
        let unit = 1.0 / (size[0] + size[1]);
        let [x0, y0, z] = corner.map(|x| x * unit);
        let (x1, y1) = (x0 + size[0] * unit, y0 + size[1] * unit);
        let (z2, x00, x11, y00, y11) = (z * z, x0 * x0, x1 * x1, y0 * y0, y1 * y1);
        // The spherical angle at a corner (x, y) has cosine +- x y and sine z |corner|, over a common factor.
        let near = product([x1 * y0, z * (x11 + y00 + z2).sqrt()], [-x1 * y1, z * (x11 + y11 + z2).sqrt()]);
        let far = product([x0 * y1, z * (x00 + y11 + z2).sqrt()], [-x0 * y0, z * (x00 + y00 + z2).sqrt()]);
        let all = product(near, far);
        // The four angles sum to 2 pi + S. Only inside the rectangle, S can be above pi.
        let sum = fast_atan2(all[1], all[0]);
        let is_inside = x0 * x1 < 0.0 && y0 * y1 < 0.0;
        let beyond = if is_inside { sum + TAU as f32 } else { 0.0 };
        let scale = 1.0 / (far[0] * far[0] + far[1] * far[1]).sqrt();
        Self {
            x: [x0, x1],
            y: [y0, y1],
            z,
            solid_angle: if sum < 0.0 { beyond } else { sum },
            far_angles: far.map(|part| part * scale),
        }
    }

    /// Returns the solid angle, sr in [0, 2 pi). The relative error is below 1e-5.
    #[inline]
    pub fn solid_angle(&self) -> f32 {
        self.solid_angle
    }

    /// Returns the density of [`Self::sample`], 1/sr.
    #[inline]
    pub fn density(&self) -> f32 {
        1.0 / self.solid_angle
    }

    /// Samples a point uniformly over the solid angle, as coordinates (s, t) in [0, 1]^2 along the two axes (\[urena2013\]).
    #[inline]
    pub fn sample(&self, u: [f32; 2]) -> [f32; 2] {
        let Self { x: [x0, x1], y: [y0, y1], z, .. } = *self;
        let z2 = z * z;
        let (r0, r1) = (1.0 / (y0 * y0 + z2), 1.0 / (y1 * y1 + z2));
        let (b0, b1) = (-y0 * r0.sqrt(), y1 * r1.sqrt());
        let (sin, cos) = sin_cos_of_turns(u[0] * self.solid_angle * (1.0 / TAU as f32));
        let [cos, sin] = product([cos, sin], [self.far_angles[0], -self.far_angles[1]]);
        // See `SphericalRectangle::sample`.
        let f = cos * b0 - b1;
        let below = f * f - z2 * r0 * sin * sin;
        let numerator = (z * sin).copysign(if f < 0.0 { -sin } else { sin });
        let xu = if below > 0.0 { numerator / below.sqrt() } else { f32::INFINITY.copysign(numerator) };
        let xu = xu.max(x0).min(x1);
        let d2 = xu * xu + z2;
        let (h0, h1) = (y0 / (d2 + y0 * y0).sqrt(), y1 / (d2 + y1 * y1).sqrt());
        let h = h0 + u[1] * (h1 - h0);
        let h2 = h * h;
        let yv = if h2 < 1.0 { (h * (d2 / (1.0 - h2)).sqrt()).max(y0).min(y1) } else { y1 };
        [(xu - x0) / (x1 - x0), (yv - y0) / (y1 - y0)]
    }
}

#[inline]
fn product(a: [f32; 2], b: [f32; 2]) -> [f32; 2] {
    [a[0] * b[0] - a[1] * b[1], a[0] * b[1] + a[1] * b[0]]
}

/// A rectangle as seen from the origin: corner at (`x0`, `y0`) in its own axes, plane at distance `z0` > 0.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SphericalRectangle {
    x0: f64,
    x1: f64,
    y0: f64,
    y1: f64,
    z0: f64,
    solid_angle: f64,
    /// Unit complex number with the angle g2 + g3 of \[urena2013\].
    far_angles: (f64, f64),
}

impl SphericalRectangle {
    /// Prepares a rectangle.
    /// - `corner`: from the reference point to the corner.
    /// - `x`, `y`, `z`: the rectangle's unit axes; `size`: its extents along x and y.
    #[inline]
    pub fn new(corner: DVec3, x: DVec3, y: DVec3, z: DVec3, size: [f64; 2]) -> Self {
        let (x0, y0, z0) = (corner.dot(x), corner.dot(y), corner.dot(z).abs());
        let (x1, y1) = (x0 + size[0], y0 + size[1]);
        // The spherical angle at a corner (x, y) has cosine +- x y and sine z |corner|, over a common factor.
        let corner_angle = |x: f64, y: f64, sign: f64| (sign * x * y, z0 * (x * x + y * y + z0 * z0).sqrt());
        let near = multiply(corner_angle(x1, y0, 1.0), corner_angle(x1, y1, -1.0));
        let far = multiply(corner_angle(x0, y1, 1.0), corner_angle(x0, y0, -1.0));
        let all = multiply(near, far);
        let sum = atan2(all.1, all.0);
        // The four angles sum to 2 pi + S.
        let solid_angle = if z0 == 0.0 {
            0.0
        } else if sum < -1e-12 {
            sum + TAU
        } else {
            sum.max(0.0)
        };
        Self { x0, x1, y0, y1, z0, solid_angle, far_angles: normalize(far) }
    }

    /// Returns the solid angle, sr in [0, 2 pi).
    #[inline]
    pub fn solid_angle(&self) -> f64 {
        self.solid_angle
    }

    /// Samples a point uniformly over the solid angle, as coordinates (s, t) in [0, 1]^2 along the two axes (\[urena2013\]).
    pub fn sample(&self, u: [f32; 2]) -> [f64; 2] {
        let Self { x0, x1, y0, y1, z0, .. } = *self;
        let z02 = z0 * z0;
        let (r0, r1) = (1.0 / (y0 * y0 + z02), 1.0 / (y1 * y1 + z02));
        let (b0, b1) = (-y0 * r0.sqrt(), y1 * r1.sqrt());
        let (sin, cos) = sin_cos(f64::from(u[0]) * self.solid_angle);
        let (cos, sin) = multiply((cos, sin), (self.far_angles.0, -self.far_angles.1));
        // The paper's cu = sign(f) / sqrt(f^2 + b0^2) with f = (cos b0 - b1) / sin; here xu = z0 cu / sqrt(1 - cu^2) is
        // multiplied out, and 1 - b0^2 is taken from the sides.
        let f = cos * b0 - b1;
        let below = f * f - z02 * r0 * sin * sin;
        let numerator = (z0 * sin).copysign(if f < 0.0 { -sin } else { sin });
        let xu = if below > 0.0 { numerator / below.sqrt() } else { f64::INFINITY.copysign(numerator) };
        let xu = xu.clamp(x0, x1);
        let d2 = xu * xu + z02;
        let (h0, h1) = (y0 / (d2 + y0 * y0).sqrt(), y1 / (d2 + y1 * y1).sqrt());
        let h = h0 + f64::from(u[1]) * (h1 - h0);
        let h2 = h * h;
        let yv = if h2 < 1.0 { (h * (d2 / (1.0 - h2)).sqrt()).clamp(y0, y1) } else { y1 };
        [(xu - x0) / (x1 - x0), (yv - y0) / (y1 - y0)]
    }
}

#[inline]
fn multiply(a: (f64, f64), b: (f64, f64)) -> (f64, f64) {
    (a.0 * b.0 - a.1 * b.1, a.0 * b.1 + a.1 * b.0)
}

#[inline]
fn normalize(a: (f64, f64)) -> (f64, f64) {
    let scale = 1.0 / (a.0 * a.0 + a.1 * a.1).sqrt();
    (a.0 * scale, a.1 * scale)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_octant_is_an_eighth_of_the_sphere() {
        let (a, b, c) = (DVec3::X, DVec3::Y, DVec3::Z);
        let omega = triangle(a, b - a, c - a, (b - a).cross(c - a));
        assert!((omega - TAU / 4.0).abs() < 1e-14);
    }

    #[test]
    fn cube_face_is_a_sixth_of_the_sphere_and_equals_two_triangles() {
        let corner = DVec3::new(-1.0, -1.0, -1.0);
        let r = SphericalRectangle::new(corner, DVec3::X, DVec3::Y, DVec3::Z, [2.0, 2.0]);
        assert!((r.solid_angle() - 2.0 * TAU / 6.0).abs() < 1e-14);
        for (corner, size) in [
            (DVec3::new(0.3, -4.0, 0.01), [2.0, 5.0]),
            (DVec3::new(-1e3, 2e3, 50.0), [0.1, 0.3]),
            (DVec3::new(-1.0, -1.0, 1e-3), [2.0, 2.0]),
            (DVec3::new(5.0, 5.0, 2.0), [1e-3, 20.0]),
        ] {
            let (ex, ey) = (DVec3::X * size[0], DVec3::Y * size[1]);
            let n = ex.cross(ey);
            let two = triangle(corner, ex, ey, n) + triangle(corner + ex + ey, -ex, -ey, n);
            let one = SphericalRectangle::new(corner, DVec3::X, DVec3::Y, DVec3::Z, size).solid_angle();
            assert!((one - two).abs() < 1e-13 + 1e-7 * two, "{corner} {size:?}: {one} against {two}");
        }
    }

    #[test]
    fn rectangle_samples_are_uniform_in_solid_angle() {
        // The part left of x = m must receive the fraction u <= S_left / S, because the map is monotone in u[0].
        for (corner, size) in
            [(DVec3::new(-1.0, -2.0, 0.5), [2.0, 3.0]), (DVec3::new(900.0, -200.0, 400.0), [2.0, 3.0])]
        {
            let r = SphericalRectangle::new(corner, DVec3::X, DVec3::Y, DVec3::Z, size);
            for u in [0.1f32, 0.37, 0.5, 0.93] {
                let s = r.sample([u, 0.3])[0];
                let left = SphericalRectangle::new(corner, DVec3::X, DVec3::Y, DVec3::Z, [size[0] * s, size[1]]);
                let fraction = left.solid_angle() / r.solid_angle();
                assert!((fraction - f64::from(u)).abs() < 1e-7, "{corner}: {fraction} against {u}");
            }
        }
    }

    #[test]
    fn single_precision_view_of_a_rectangle_is_near_the_exact_one() {
        let corners = [
            [-1.0, -2.0, 0.5],
            [0.3, -4.0, 0.2],
            [-1.0, -1.0, 0.05],
            [5.0, 5.0, 2.0],
            [0.01, -1.5, 0.02],
            [0.01, -1.5, 2e-3],
            [1.5, -3.0, 0.02],
        ];
        let sizes = [[2.0, 3.0], [1.0, 20.0]];
        let scales = [1.0, 1e9, 1e-9];
        for (corner, size, scale) in
            corners.iter().flat_map(|it| sizes.map(|size| (it, size))).flat_map(|it| scales.map(|by| (it.0, it.1, by)))
        {
            let (corner, size) = (DVec3::from(*corner) * scale, size.map(|x| x * scale));
            let exact = SphericalRectangle::new(corner, DVec3::X, DVec3::Y, DVec3::Z, size);
            let view = RectangleView::new(corner.to_array().map(|x| x as f32), size.map(|x| x as f32));
            let ratio = f64::from(view.solid_angle()) / exact.solid_angle();
            assert!((ratio - 1.0).abs() < 1e-5, "{corner} {size:?}: {ratio}");
            if view.solid_angle() < MIN_RECTANGLE_SOLID_ANGLE {
                continue;
            }
            // The part left of a sampled point has the share u of the solid angle.
            for u in [0.01, 0.3, 0.7, 0.999] {
                let x = f64::from(view.sample([u, 0.6])[0]) * size[0];
                let left = SphericalRectangle::new(corner, DVec3::X, DVec3::Y, DVec3::Z, [x, size[1]]);
                let error = (left.solid_angle() / exact.solid_angle() - f64::from(u)).abs();
                assert!(error < 1e-4, "{corner} {size:?} {u}: {error}");
            }
        }
    }

    #[test]
    fn triangle_samples_are_uniform_in_solid_angle() {
        // c' moves on the edge a-c: the triangle a, b, c' has area u S. With u[1] = 1, the direction is c' itself.
        for scale in [1.0, 1e-2, 1e-3] {
            let a = DVec3::new(0.2, 0.1, 1.0);
            let (e1, e2) = (DVec3::new(0.8, 0.1, 0.3) * scale, DVec3::new(-0.1, 0.9, -0.2) * scale);
            let cross = e1.cross(e2);
            let omega = triangle(a, e1, e2, cross);
            for u in [0.05f32, 0.4, 0.8] {
                let w = sample_triangle(a, a + e1, a + e2, omega, [u, 1.0]).expect("not degenerate");
                let p = w * (a.dot(cross) / w.dot(cross));
                let part = triangle(a, e1, p - a, e1.cross(p - a));
                assert!((part / omega - f64::from(u)).abs() < 1e-5, "{scale} {u}: {}", part / omega);
            }
        }
    }
}
