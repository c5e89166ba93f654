//! Directions toward lights in fog: a scattered path should continue in a direction that passes near a light.
//!
//! A point source illuminates fog. Without losses, a ray at an angle theta from the source collects light in proportion to
//! `(pi - theta) / sin(theta)`, the integral of 1 / distance^2 along the ray. Normalized over solid angle,
//! `(pi - theta) / (pi^3 sin(theta))` is a density whose angle can be sampled in closed form.

use super::approx::{arc_sine, attenuation};
use super::light_blocks::{
    LaneWeights, LightBlocks, LightLanes, MixtureComponent, Weigh, add_scaled, dot, splat, subtract,
};
use crate::tree::Node;
use femc_math::Frame;
use femc_math::elementary::sin_cos;
use femc_math::glam::Vec3A;
use femc_simd::{Kernel, Level, Simd, Vector};
use std::f32::consts::{PI, TAU};

/// A point in fog from which a path continues.
#[derive(Clone, Copy, Debug)]
pub struct DirectionContext {
    /// Position, m.
    pub position: Vec3A,
    /// Direction in which the light leaves after scattering, unit: back along the path.
    pub wo: Vec3A,
    /// Extinction at the point, 1/m.
    pub extinction: f32,
    /// Schlick's parameter of the phase function.
    pub phase: f32,
}

impl Weigh for DirectionContext {
    /// Computes the attenuated intensity over distance, times a widened phase function toward the middle: the ray passes at some
    /// angle.
    #[inline(always)]
    fn weigh<S: Simd>(&self, simd: S, lights: &LightLanes<S>) -> S::V {
        let c = |x| simd.splat(x);
        let position = splat(simd, self.position);
        let toward = subtract(lights.center, position);
        let distance2 = dot(toward, toward).max(lights.radius * lights.radius).max(c(1e-20));
        let distance = distance2.sqrt();
        let inverse = c(1.0) / distance;
        // Light comes along -toward and leaves along self.toward.
        let cos = (c(0.0) - dot(splat(simd, self.wo), toward)) * inverse;
        let k = self.phase;
        let lobe = c(1.0) / (c(1.0) - c(k) * cos);
        let [profile, below] = lights.profile((c(0.0) - dot(lights.axis, toward)) * inverse, inverse);
        lights.intensity
            * inverse
            * attenuation(simd, c(self.extinction) * distance)
            * lobe
            * lobe
            * (c(0.2) + profile / below)
    }
}

/// Mixture density of a direction: a density about the direction to a light's middle, weighted by its trust, and the phase function
/// for the rest.
struct DirectionMixture<'a> {
    context: &'a DirectionContext,
    dir: Vec3A,
    phase: f32,
}

impl MixtureComponent for DirectionMixture<'_> {
    #[inline(always)]
    fn value<S: Simd>(&self, simd: S, center: [S::V; 3], radius: S::V) -> S::V {
        let c = |x| simd.splat(x);
        let (position, dir) = (splat(simd, self.context.position), splat(simd, self.dir));
        let toward = subtract(center, position);
        let distance = dot(toward, toward).max(c(1e-20)).sqrt();
        let inverse = c(1.0) / distance;
        let trust = trust(simd, radius * inverse, c(self.context.extinction) * distance);
        let axis = [toward[0] * inverse, toward[1] * inverse, toward[2] * inverse];
        // Half chords to the axis and to its opposite: sine and cosine of half the angle.
        let chord = subtract(dir, axis);
        let other = add_scaled(dir, axis, c(1.0));
        let sin = c(0.5) * dot(chord, chord).sqrt();
        let cos = c(0.5) * dot(other, other).sqrt();
        // Half of pi - theta is the arc sine of cos, and half of theta is the arc sine of sin. The smaller one is exact.
        let is_near = sin.lt(cos);
        let arc = arc_sine(simd, is_near.select(sin, cos).min(c(1.0)));
        let left = is_near.select(c(PI) - c(2.0) * arc, c(2.0) * arc);
        let near = left / (c(2.0 * PI * PI * PI) * (sin * cos).max(c(1e-12)));
        trust * near + (c(1.0) - trust) * c(self.phase)
    }
}

/// Computes the weight of the direction to a light's middle. It is small if the light is large as seen from the point, or behind
/// thick fog.
/// - `size`: its radius over the distance; `depth`: optical depth on the way to it.
#[inline(always)]
fn trust<S: Simd>(simd: S, size: S::V, depth: S::V) -> S::V {
    let c = |x| simd.splat(x);
    (c(1.0) - c(2.0) * size).max(c(0.0)) / (c(1.0) + c(0.06) * depth * depth)
}

/// Task that computes the trust of one light.
struct Trust {
    size: f32,
    depth: f32,
}

impl Kernel for Trust {
    type Output = f32;

    #[inline(always)]
    fn run<S: Simd>(self, simd: S) -> f32 {
        trust(simd, simd.splat(self.size), simd.splat(self.depth)).lanes().0[0]
    }
}

impl DirectionContext {
    /// Samples a direction with `choice` and `u`, all in [0, 1), among those that pass near lights of `weights`; `None`: sample the
    /// phase function instead.
    #[inline]
    pub fn sample(
        &self,
        lights: &[Node],
        weights: &LaneWeights,
        choice: f64,
        u: [f32; 2],
        level: Level,
    ) -> Option<Vec3A> {
        let (light, _, rest) = weights.choose(choice)?;
        let toward = lights[light].center - self.position;
        let distance = toward.length_squared().max(1e-20).sqrt();
        let inverse = 1.0 / distance;
        let trust = level.run(Trust { size: lights[light].radius * inverse, depth: self.extinction * distance });
        if rest >= trust {
            return None;
        }
        let axis = (toward * inverse).normalize_or(Vec3A::Z);
        // The distribution function of the angle is 1 - (1 - theta / pi)^2.
        let theta = PI * u[0] / (1.0 + (1.0 - u[0]).sqrt());
        let (sin, cos) = sin_cos(theta);
        let (sin_azimuth, cos_azimuth) = sin_cos(TAU * u[1]);
        let local = Vec3A::new(sin * cos_azimuth, sin * sin_azimuth, cos);
        Some(Frame::from_normal(axis).to_world(local).normalize())
    }

    /// Returns the density, 1/sr, of [`Self::sample`] with the phase function as the fallback.
    /// - `phase`: density of the phase function.
    #[inline]
    pub fn pdf(&self, lights: &LightBlocks, weights: &LaneWeights, dir: Vec3A, phase: f32) -> f32 {
        if weights.is_zero() { phase } else { lights.mixture(weights, &DirectionMixture { context: self, dir, phase }) }
    }
}
