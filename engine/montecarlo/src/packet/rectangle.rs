//! Points on a rectangular lamp from several reference points: `Parallelogram::sample` in lanes.

use super::vectors::{Functions, V3};
use femc_emission::light::UniformRectangle;
use femc_emission::{EmittingSides, solid_angle};
use femc_math::gamma;
use femc_simd::{Simd, Vector};
use std::f32::consts::TAU;

/// A point on the lamp for each lane.
pub struct LampPoints<V> {
    /// Lanes with a point that sends light to the reference.
    pub lit: u32,
    /// Lanes whose point the scalar function must sample, because the lamp nearly fills a hemisphere.
    pub unsampled: u32,
    pub dir: V3<V>,
    pub position: V3<V>,
    pub error: V3<V>,
    pub normal: V3<V>,
    pub radiance: V3<V>,
    /// Density, 1/sr.
    pub pdf: V,
    /// 0 for lamps that are points, otherwise 1.
    pub can_be_hit: V,
}

/// Samples points from `u` in [0, 1)^2.
/// - `position_error`: maximum distance of the traced surface from the lamp, m.
#[inline(always)]
pub fn sample_points<S: Simd>(
    simd: S,
    lamp: &UniformRectangle,
    position_error: f32,
    reference: V3<S::V>,
    u: [S::V; 2],
) -> LampPoints<S::V> {
    let [edge_u, edge_v] = lamp.edges;
    let normal = V3::splat(simd, lamp.normal);
    let corner = V3::splat(simd, lamp.origin) - reference;
    let behind = corner.dot(normal);
    let mut dark = behind.equal(simd.splat(0.0)).signs();
    if lamp.sides == EmittingSides::One {
        dark |= simd.is_positive(behind).signs();
    }
    let center = corner + V3::splat(simd, 0.5 * (edge_u + edge_v));
    let is_near = (simd.splat(solid_angle::FAR_RATIO2) * center.dot(center)).le(simd.splat(lamp.reach2));
    let mut at = u;
    let mut by_solid_angle = None;
    let mut unsampled = 0;
    if is_near.signs() & !dark != 0 {
        let [x, y] = lamp.axes;
        let (x, y) = (corner.dot(V3::splat(simd, x)), corner.dot(V3::splat(simd, y)));
        let view = Views::new(simd, [x, y, simd.abs(behind)], lamp.size);
        let is_view = is_near & simd.splat(solid_angle::MIN_RECTANGLE_SOLID_ANGLE).le(view.solid_angle);
        unsampled = (is_near & simd.splat(solid_angle::MAX_SOLID_ANGLE as f32).le(view.solid_angle)).signs() & !dark;
        let sampled = view.sample(simd, u);
        at = [is_view.select(sampled[0], u[0]), is_view.select(sampled[1], u[1])];
        by_solid_angle = Some((is_view, simd.splat(1.0) / view.solid_angle));
    }
    let position =
        V3::splat(simd, lamp.origin) + V3::splat(simd, edge_u).scale(at[0]) + V3::splat(simd, edge_v).scale(at[1]);
    let between = position - reference;
    let distance2 = between.dot(between);
    let distance = distance2.sqrt();
    let dir = between.over(distance);
    let cos = dir.dot(normal);
    let by_area = distance2 / (simd.splat(lamp.area) * simd.abs(cos));
    let by_area = simd.abs(by_area).lt(simd.splat(f32::INFINITY)).select(by_area, simd.splat(0.0));
    let pdf = match by_solid_angle {
        None => by_area,
        Some((is_view, pdf)) => is_view.select(pdf, by_area),
    };
    let mut lit = simd.is_positive(pdf).signs()
        & simd.finite(pdf)
        & simd.is_positive(distance2).signs()
        & simd.finite(distance2)
        & !cos.equal(simd.splat(0.0)).signs();
    if lamp.sides == EmittingSides::One {
        lit &= !simd.is_positive(cos).signs();
    }
    let error = (position.abs(simd) + V3::splat(simd, lamp.scale)).scale(simd.splat(gamma(5)));
    let error = error.plus(simd.splat(position_error));
    LampPoints {
        lit: lit & !dark & !unsampled,
        unsampled,
        dir,
        position,
        error,
        normal,
        radiance: V3::splat(simd, lamp.radiance),
        pdf,
        can_be_hit: simd.splat(1.0),
    }
}

/// Views of the rectangle: `RectangleView` in lanes.
struct Views<V> {
    x: [V; 2],
    y: [V; 2],
    z: V,
    solid_angle: V,
    far_angles: [V; 2],
}

impl<V: Vector> Views<V> {
    #[inline(always)]
    fn new<S: Simd<V = V>>(simd: S, corner: [V; 3], size: [f32; 2]) -> Self {
        let unit = 1.0 / (size[0] + size[1]);
        let (width, height) = (simd.splat(size[0] * unit), simd.splat(size[1] * unit));
        let unit = simd.splat(unit);
        let (x0, y0, z) = (corner[0] * unit, corner[1] * unit, corner[2] * unit);
        let (x1, y1) = (x0 + width, y0 + height);
        let (z2, x00, x11, y00, y11) = (z * z, x0 * x0, x1 * x1, y0 * y0, y1 * y1);
        let near = product([x1 * y0, z * (x11 + y00 + z2).sqrt()], [simd.negate(x1) * y1, z * (x11 + y11 + z2).sqrt()]);
        let far = product([x0 * y1, z * (x00 + y11 + z2).sqrt()], [simd.negate(x0) * y0, z * (x00 + y00 + z2).sqrt()]);
        let all = product(near, far);
        let sum = simd.fast_atan2(all[1], all[0]);
        let zero = simd.splat(0.0);
        let is_inside = (x0 * x1).lt(zero) & (y0 * y1).lt(zero);
        let beyond = is_inside & (sum + simd.splat(TAU));
        let scale = simd.splat(1.0) / (far[0] * far[0] + far[1] * far[1]).sqrt();
        Self {
            x: [x0, x1],
            y: [y0, y1],
            z,
            solid_angle: sum.lt(zero).select(beyond, sum),
            far_angles: [far[0] * scale, far[1] * scale],
        }
    }

    #[inline(always)]
    fn sample<S: Simd<V = V>>(&self, simd: S, u: [V; 2]) -> [V; 2] {
        let Self { x: [x0, x1], y: [y0, y1], z, solid_angle, far_angles } = *self;
        let z2 = z * z;
        let (r0, r1) = (simd.splat(1.0) / (y0 * y0 + z2), simd.splat(1.0) / (y1 * y1 + z2));
        let (b0, b1) = (simd.negate(y0) * r0.sqrt(), y1 * r1.sqrt());
        let [sin, cos] = simd.sin_cos_of_turns(u[0] * solid_angle * simd.splat(1.0 / TAU));
        let [cos, sin] = product([cos, sin], [far_angles[0], simd.negate(far_angles[1])]);
        let f = cos * b0 - b1;
        let below = f * f - z2 * r0 * sin * sin;
        let sign = f.lt(simd.splat(0.0)).select(simd.negate(sin), sin);
        let numerator = simd.copysign(z * sin, sign);
        let bounded = numerator / below.sqrt();
        let xu = simd.is_positive(below).select(bounded, simd.copysign(simd.splat(f32::INFINITY), numerator));
        let xu = xu.max(x0).min(x1);
        let d2 = xu * xu + z2;
        let (h0, h1) = (y0 / (d2 + y0 * y0).sqrt(), y1 / (d2 + y1 * y1).sqrt());
        let h = h0 + u[1] * (h1 - h0);
        let h2 = h * h;
        let inside = (h * (d2 / (simd.splat(1.0) - h2)).sqrt()).max(y0).min(y1);
        let yv = h2.lt(simd.splat(1.0)).select(inside, y1);
        [(xu - x0) / (x1 - x0), (yv - y0) / (y1 - y0)]
    }
}

#[inline(always)]
fn product<V: Vector>(a: [V; 2], b: [V; 2]) -> [V; 2] {
    [a[0] * b[0] - a[1] * b[1], a[0] * b[1] + a[1] * b[0]]
}
