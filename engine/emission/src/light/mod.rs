//! Light sources: one type per file, dispatched by an enum.
//!
//! `sample` draws a point as seen from a reference point. `pdf` returns the density that `sample` has for a point that was found by
//! other means. Both densities are over solid angle at the reference. The strategy depends only on the light and the reference, so
//! the two always agree.

pub mod cone;
pub mod parallelogram;
pub mod photometric_point;
pub mod photometric_solid;
pub mod ring;
pub mod sphere;
pub mod torus;
pub mod triangle;

use crate::{AngularProfile, Emission, EmittingSides};
pub use cone::Cone;
use femc_math::color::luminance;
use femc_math::elementary::double;
use femc_math::glam::{DVec3, Vec3A};
use femc_math::{Rgb, cross, gamma};
pub use parallelogram::{Parallelogram, UniformRectangle};
pub use photometric_point::PhotometricPoint;
pub use photometric_solid::{Face, PhotometricSolid, Solid};
pub use ring::Ring;
pub use sphere::Sphere;
use std::f64::consts::{FRAC_PI_2, PI, TAU};
pub use torus::Torus;
pub use triangle::Triangle;

/// Kind of a light's samples: with a density, or of a point.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DeltaKind {
    /// An ordinary sample.
    No,
    /// The light is a point: no ray hits it, and the sample's weight under multiple importance sampling is 1.
    Position,
}

/// A point on a light as seen from a reference point.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LightSample {
    /// Direction from the reference to the light, unit.
    pub dir: Vec3A,
    /// Distance, m.
    pub distance: f32,
    /// Position of the point, m.
    pub position: Vec3A,
    /// Front normal of the emitter at the point; zero for points.
    pub normal: Vec3A,
    /// Error bound of `position`, m, by coordinate.
    pub error: Vec3A,
    /// Radiance toward the reference, cd/m2; for a delta light, intensity over squared distance, lx. Not divided by `pdf`.
    pub radiance: Rgb,
    /// Density, 1/sr; 1 for a delta light.
    pub pdf: f32,
    /// Kind of sample.
    pub delta: DeltaKind,
    /// Parameters of the point: (s, t) along the edges, barycentric (b1, b2), or (azimuth / 2 pi, height) on round shapes.
    pub uv: [f32; 2],
}

/// Bound on the directions of an emitter's normals, and the profile of the emission about them.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EmissionCone {
    /// Axis of the normals' cone, unit.
    pub axis: Vec3A,
    /// Cosine of the half angle of the normals' cone; -1: light in every direction.
    pub cos_normals: f32,
    /// Exponent of the intensity as a power of the cosine with the normal, >= 1 (1: Lambertian).
    pub exponent: f32,
    /// Whether light also leaves along the opposite normals.
    pub two_sided: bool,
}

impl EmissionCone {
    /// Cone of all directions.
    pub const ALL: Self = Self { axis: Vec3A::Z, cos_normals: -1.0, exponent: 1.0, two_sided: false };

    /// Checks whether light may leave in every direction.
    pub fn is_omnidirectional(&self) -> bool {
        self.cos_normals <= -1.0
    }

    /// Returns a cone that contains both.
    pub fn join(&self, other: &Self) -> Self {
        let exponent = self.exponent.min(other.exponent);
        let two_sided = self.two_sided || other.two_sided;
        let angle = |cos: f32| f64::from(double::acos(f64::from(cos.clamp(-1.0, 1.0))) as f32);
        let (a, b) = (angle(self.cos_normals), angle(other.cos_normals));
        if self.is_omnidirectional() || other.is_omnidirectional() {
            return Self { exponent, two_sided, ..Self::ALL };
        }
        let between = angle(self.axis.dot(other.axis));
        // One cone contains the other.
        for (wide, narrow, cone) in [(a, b, self), (b, a, other)] {
            if (between + narrow).min(PI) <= wide {
                return Self { exponent, two_sided, ..*cone };
            }
        }
        let half = 0.5 * (a + b + between);
        let across = cross(self.axis, other.axis);
        if half >= PI || across.length_squared() == 0.0 {
            return Self { exponent, two_sided, ..Self::ALL };
        }
        // The first axis is turned toward the second by the missing angle.
        let (sin, cos) = double::sin_cos(half - a);
        let sideways = cross(across.normalize(), self.axis);
        let axis = (self.axis * cos as f32 + sideways * sin as f32).normalize();
        Self { axis, cos_normals: double::cos(half) as f32 - 1e-6, exponent, two_sided }
    }

    /// Computes the solid angle of the emitted directions, weighted by a cosine at the border (\[conty2018\]). A single normal with
    /// a Lambertian profile gives pi.
    pub fn measure(&self) -> f32 {
        let normals = double::acos(f64::from(self.cos_normals.clamp(-1.0, 1.0)));
        let whole = (normals + FRAC_PI_2).min(PI);
        let (sin, cos) = double::sin_cos(normals);
        let border = 2.0 * whole * sin - double::cos(normals - 2.0 * whole) - 2.0 * normals * sin + cos;
        (TAU * (1.0 - cos) + FRAC_PI_2 * border) as f32
    }
}

/// A light source.
#[derive(Clone, Debug, PartialEq)]
pub enum Light {
    /// A flat triangle.
    Triangle(Triangle),
    /// A parallelogram; rectangles are sampled by their solid angle.
    Parallelogram(Parallelogram),
    /// A sphere.
    Sphere(Sphere),
    /// An open truncated cone or cylinder.
    Cone(Cone),
    /// An annulus or disc.
    Ring(Ring),
    /// A torus.
    Torus(Torus),
    /// A point with a measured intensity distribution.
    PhotometricPoint(PhotometricPoint),
    /// A convex luminous opening with a measured intensity distribution.
    PhotometricSolid(PhotometricSolid),
}

macro_rules! dispatch {
    ($light:expr, $l:ident => $body:expr) => {
        match $light {
            Light::Triangle($l) => $body,
            Light::Parallelogram($l) => $body,
            Light::Sphere($l) => $body,
            Light::Cone($l) => $body,
            Light::Ring($l) => $body,
            Light::Torus($l) => $body,
            Light::PhotometricPoint($l) => $body,
            Light::PhotometricSolid($l) => $body,
        }
    };
}

impl Light {
    /// Draws a point from `u` in [0, 1)^2. `None`: no light reaches the reference in this draw. Law: directions follow
    /// [`Self::pdf`] (tests `samples_follow_the_density_*`).
    #[inline]
    pub fn sample(&self, reference: Vec3A, u: [f32; 2]) -> Option<LightSample> {
        dispatch!(self, l => l.sample(reference, u))
    }

    /// Returns the density, 1/sr, that [`Self::sample`] has for the point `position` of this light with front normal `normal`, seen
    /// in direction `dir` (unit, from the reference to the light). 0 for delta lights and where the light does not emit.
    #[inline]
    pub fn pdf(&self, reference: Vec3A, position: Vec3A, normal: Vec3A, dir: Vec3A) -> f32 {
        dispatch!(self, l => l.pdf(reference, position, normal, dir))
    }

    /// Returns the radiance, cd/m2, in direction `dir_from_light` (unit, away from the light) at a point with front normal
    /// `normal`.
    #[inline]
    pub fn radiance(&self, dir_from_light: Vec3A, normal: Vec3A) -> Rgb {
        match self {
            Self::Triangle(l) => l.emission.radiance(dir_from_light.dot(normal)),
            Self::Parallelogram(l) => l.emission.radiance(dir_from_light.dot(normal)),
            Self::Sphere(l) => l.emission.radiance(dir_from_light.dot(normal)),
            Self::Cone(l) => l.emission.radiance(dir_from_light.dot(normal)),
            Self::Ring(l) => l.emission.radiance(dir_from_light.dot(normal)),
            Self::Torus(l) => l.emission.radiance(dir_from_light.dot(normal)),
            Self::PhotometricPoint(_) => Rgb::ZERO,
            Self::PhotometricSolid(l) => l.radiance(dir_from_light, normal),
        }
    }

    /// Checks whether the light is defined by its intensity, cd. The brightness of such a light does not depend on its size.
    #[inline]
    pub fn has_intensity(&self) -> bool {
        match self {
            Self::PhotometricPoint(_) | Self::PhotometricSolid(_) => true,
            Self::Triangle(_)
            | Self::Parallelogram(_)
            | Self::Sphere(_)
            | Self::Cone(_)
            | Self::Ring(_)
            | Self::Torus(_) => false,
        }
    }

    /// Returns the measured luminous intensity, cd, in direction `dir` (unit, away from the light); `None` for other lights.
    #[inline]
    pub fn intensity(&self, dir: Vec3A) -> Option<f32> {
        match self {
            Self::PhotometricPoint(l) => Some(luminance(l.intensity(dir))),
            Self::PhotometricSolid(l) => Some(luminance(l.intensity(dir))),
            Self::Triangle(_)
            | Self::Parallelogram(_)
            | Self::Sphere(_)
            | Self::Cone(_)
            | Self::Ring(_)
            | Self::Torus(_) => None,
        }
    }

    /// Returns the corners of a flat polygon in order, m; none for other shapes.
    pub fn corners(&self) -> Vec<Vec3A> {
        match self {
            Self::Triangle(l) => l.corners().to_vec(),
            Self::Parallelogram(l) => l.corners().to_vec(),
            Self::Sphere(_)
            | Self::Cone(_)
            | Self::Ring(_)
            | Self::Torus(_)
            | Self::PhotometricPoint(_)
            | Self::PhotometricSolid(_) => Vec::new(),
        }
    }

    /// Returns the point of a flat polygon that is seen from `reference` in direction `dir` (unit), with density 1: the caller has
    /// drawn the direction. `None` if the direction misses it, if it sends no light there, and for other shapes.
    #[inline]
    pub fn sample_in_direction(&self, reference: Vec3A, dir: Vec3A) -> Option<LightSample> {
        match self {
            Self::Triangle(l) => l.sample_in_direction(reference, dir),
            Self::Parallelogram(l) => l.sample_in_direction(reference, dir),
            Self::Sphere(_)
            | Self::Cone(_)
            | Self::Ring(_)
            | Self::Torus(_)
            | Self::PhotometricPoint(_)
            | Self::PhotometricSolid(_) => None,
        }
    }

    /// Luminous flux, lm.
    pub fn power(&self) -> f32 {
        dispatch!(self, l => l.power())
    }

    /// Returns the lower and upper corner of the bounding box, m.
    pub fn bounds(&self) -> (Vec3A, Vec3A) {
        dispatch!(self, l => l.bounds())
    }

    /// Returns a point in the middle of the light, m; for a flat light, it lies in its plane.
    pub fn center(&self) -> Vec3A {
        if let Self::Triangle(triangle) = self {
            return triangle.corners().iter().sum::<Vec3A>() / 3.0;
        }
        let (low, high) = self.bounds();
        (low + high) * 0.5
    }

    /// Returns the bound on normals and emission.
    pub fn emission_cone(&self) -> EmissionCone {
        match self {
            Self::Triangle(l) => flat_cone(l.normal(), &l.emission),
            Self::Parallelogram(l) => flat_cone(l.normal(), &l.emission),
            Self::Ring(l) => flat_cone(l.normal(), &l.emission),
            Self::Sphere(_)
            | Self::Cone(_)
            | Self::Torus(_)
            | Self::PhotometricPoint(_)
            | Self::PhotometricSolid(_) => EmissionCone::ALL,
        }
    }
}

fn flat_cone(normal: Vec3A, emission: &Emission) -> EmissionCone {
    let exponent = match emission.profile {
        AngularProfile::Lambertian => 1.0,
        AngularProfile::Lobe { exponent } => exponent + 1.0,
    };
    EmissionCone { axis: normal, cos_normals: 1.0, exponent, two_sided: emission.sides == EmittingSides::Two }
}

/// Returns the density over solid angle of a point drawn uniformly over `area` m2; 0 if it is not a positive finite number.
#[inline]
fn area_pdf(area: f64, distance2: f64, cos: f64) -> f32 {
    let pdf = (distance2 / (area * cos.abs())) as f32;
    if pdf.is_finite() { pdf } else { 0.0 }
}

/// Returns the density over solid angle of a point drawn uniformly over `area` m2; 0 if it is not finite.
#[inline]
fn single_area_pdf(area: f32, distance2: f32, cos: f32) -> f32 {
    let pdf = distance2 / (area * cos.abs());
    if pdf.is_finite() { pdf } else { 0.0 }
}

/// Assembles a sample at a point of a flat light, in single precision.
/// - `position`: point of the light, m, computed as a corner plus a multiple of each edge;
/// - `scale`: upper bound of the corner's and the multiples' coordinates, m;
/// - `pdf`: density, 1/sr, for the squared distance, m2, and the cosine at the light;
/// - `radiance`: radiance for that cosine, cd/m2.
#[inline]
fn sample_of_point(
    reference: Vec3A,
    position: Vec3A,
    normal: Vec3A,
    scale: Vec3A,
    pdf: impl FnOnce(f32, f32) -> f32,
    radiance: impl FnOnce(f32) -> Rgb,
    uv: [f32; 2],
) -> Option<LightSample> {
    let between = position - reference;
    let distance2 = between.length_squared();
    let distance = distance2.sqrt();
    let dir = between / distance;
    let cos = dir.dot(normal);
    let (pdf, radiance) = (pdf(distance2, cos), radiance(-cos));
    // A reference at the light itself, or too far away, has no direction.
    let is_lit = pdf > 0.0 && pdf.is_finite() && distance2 > 0.0 && distance2.is_finite();
    if !is_lit || radiance == Rgb::ZERO {
        return None;
    }
    let error = (position.abs() + scale) * gamma(5);
    Some(LightSample { dir, distance, position, normal, error, radiance, pdf, delta: DeltaKind::No, uv })
}

/// Returns direction and distance from `reference` to `position`, in double precision.
#[inline]
fn direction_and_distance(reference: DVec3, position: DVec3) -> Option<(DVec3, f64)> {
    let v = position - reference;
    let distance = v.length();
    (distance > 0.0 && distance.is_finite()).then(|| (v / distance, distance))
}

/// Assembles a sample at the point `position` (f64). Its error is the rounding to f32 plus `relative` ulps of `scale`.
#[inline]
fn assemble_sample(
    reference: DVec3,
    position: DVec3,
    normal: DVec3,
    scale: Vec3A,
    pdf: impl FnOnce(DVec3, f64) -> f32,
    radiance: impl FnOnce(DVec3, f32) -> Rgb,
    uv: [f64; 2],
) -> Option<LightSample> {
    let (dir, distance) = direction_and_distance(reference, position)?;
    let pdf = pdf(dir, distance);
    let radiance = radiance(dir, -dir.dot(normal) as f32);
    if pdf <= 0.0 || !pdf.is_finite() || radiance == Rgb::ZERO {
        return None;
    }
    let position = position.as_vec3a();
    Some(LightSample {
        dir: dir.as_vec3a(),
        distance: distance as f32,
        position,
        normal: normal.as_vec3a(),
        error: (position.abs() + scale) * gamma(3),
        radiance,
        pdf,
        delta: DeltaKind::No,
        uv: [uv[0] as f32, uv[1] as f32],
    })
}

/// Intersects a ray along `dir` with the plane through `a` that `e1` and `e2` span, and returns the coordinates in units of these
/// if the point is in front. `cross` is `e1 x e2`; `a` and the ray are relative to the same point.
#[inline]
fn intersect_plane(a: DVec3, [e1, e2, cross]: [DVec3; 3], dir: DVec3) -> Option<[f64; 2]> {
    let distance = a.dot(cross) / dir.dot(cross);
    let p = dir * distance - a;
    let scale = 1.0 / cross.length_squared();
    let at = [p.cross(e2).dot(cross) * scale, e1.cross(p).dot(cross) * scale];
    (distance > 0.0 && at[0] >= 0.0 && at[1] >= 0.0).then_some(at)
}

/// Returns the bounds of a set of points.
fn bounding_box(points: &[Vec3A]) -> (Vec3A, Vec3A) {
    points.iter().fold((Vec3A::INFINITY, Vec3A::NEG_INFINITY), |(low, high), &p| (low.min(p), high.max(p)))
}

#[cfg(test)]
mod tests;
