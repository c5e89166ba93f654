//! Places that receive light, and the importance of a tree node for them.

use super::LEAF;
use femc_math::glam::Vec3A;
use std::f32::consts::{FRAC_PI_2, PI};

/// Tolerance of cosines of bounds, so that rounding does not lose a light.
const COSINE_TOLERANCE: f32 = 1e-3;

/// A place that receives light.
pub trait NodeImportance {
    /// Returns the importance of a node, >= 0; 0 only if its lights can send nothing.
    fn importance(&self, node: &Node) -> f32;
    /// Returns the squared distance of the place to the middle of a node's lights, m2.
    fn distance2(&self, node: &Node) -> f32;
}

/// A point on a surface or in a medium.
#[derive(Clone, Copy, Debug)]
pub struct PointContext {
    /// Position, m.
    pub position: Vec3A,
    /// Unit normal of the side that scatters light; zero if light counts from all sides.
    pub normal: Vec3A,
    /// Scattering of the surface toward the viewer; `None`: only the normal is known.
    pub lobes: Option<BsdfLobes>,
}

/// Approximate scattering of a surface toward a viewer, as two lobes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BsdfLobes {
    /// Luminance of the diffuse reflectance.
    pub diffuse: f32,
    /// Luminance of the glossy lobe's reflectance.
    pub glossy: f32,
    /// GGX roughness of the glossy lobe.
    pub alpha: f32,
    /// Direction toward the viewer, unit, in the frame of the point.
    pub wo: Vec3A,
}

/// A segment of a ray in fog, which receives light along all of it.
#[derive(Clone, Copy, Debug)]
pub struct SegmentContext {
    /// Start of the ray, m.
    pub origin: Vec3A,
    /// Unit direction.
    pub dir: Vec3A,
    /// First and last distance on the ray of the evaluated range, m; finite.
    pub range: (f32, f32),
    /// Last distance at which light counts, m; may be infinite.
    pub end: f32,
    /// Number of angles at which a light's airlight is evaluated, at least 1.
    pub angles: u32,
    /// Extinction on the segment, 1/m.
    pub extinction: f32,
    /// Schlick's parameter of the phase function on the segment (\[blasi1993\]).
    pub phase: f32,
}

/// A node: one light, or all lights below it.
#[derive(Clone, Copy, Debug)]
pub struct Node {
    pub(crate) center: Vec3A,
    pub(crate) axis: Vec3A,
    /// Radius of the sphere around the lights, m.
    pub(crate) radius: f32,
    /// Square of the radius, m2.
    pub(super) radius2: f32,
    /// Intensity at the peak of the profile, cd, summed over the lights.
    pub(crate) intensity: f32,
    pub(crate) cos_normals: f32,
    pub(crate) sin_normals: f32,
    /// Exponent of the intensity as a power of the cosine.
    pub(crate) exponent: f32,
    pub(crate) two_sided: bool,
    /// Extinction of the media around the lights, 1/m.
    pub(crate) extinction: f32,
    /// Index of the first child, the second follows; [`LEAF`] in leaves.
    pub(super) children: u32,
    pub(super) light: u32,
    /// Ranks of its lights: the first rank and the number of lights.
    pub(super) ranks: (u32, u32),
}

/// Computes cosine and sine of `a - b`, or of 0 if a < b; both angles are in 0..pi.
#[inline]
pub(super) fn angle_difference((cos_a, sin_a): (f32, f32), (cos_b, sin_b): (f32, f32)) -> (f32, f32) {
    if cos_a >= cos_b { (1.0, 0.0) } else { (cos_a * cos_b + sin_a * sin_b, sin_a * cos_b - cos_a * sin_b) }
}

#[inline]
pub(super) fn sin_from_cos(cos: f32) -> f32 {
    (1.0 - cos * cos).max(0.0).sqrt()
}

impl Node {
    /// Returns the radius of the sphere around its lights, m.
    pub fn radius(&self) -> f32 {
        self.radius
    }

    /// Returns the extinction of the media around its lights, 1/m.
    pub fn extinction(&self) -> f32 {
        self.extinction
    }

    /// Returns the index of its light, if the node holds a single one.
    pub fn light(&self) -> u32 {
        self.light
    }

    /// Checks whether a light of this rank is in the node.
    #[inline]
    pub(super) fn contains_rank(&self, rank: u32) -> bool {
        rank.wrapping_sub(self.ranks.0) < self.ranks.1
    }

    /// Checks whether the intensity is the same in every direction.
    #[inline]
    pub(crate) fn is_omnidirectional(&self) -> bool {
        self.cos_normals <= -1.0
    }

    /// Returns three values as seen from `point`: the squared distance to the lights' middle, at least the square of their radius;
    /// the direction to it; and the cosine and sine of the angle by which the directions to individual lights may differ from it.
    #[inline]
    fn seen_from(&self, point: Vec3A) -> (f32, Vec3A, (f32, f32)) {
        let toward = self.center - point;
        let distance2 = toward.length_squared();
        if distance2 <= self.radius2 * 1.001 || distance2 == 0.0 {
            return (self.radius2.max(distance2).max(f32::MIN_POSITIVE), Vec3A::ZERO, (-1.0, 0.0));
        }
        let inverse = 1.0 / distance2.sqrt();
        let sin = self.radius * inverse;
        (distance2, toward * inverse, ((1.0 - sin * sin).max(0.0).sqrt(), sin))
    }

    /// Returns a bound on the intensity, cd, in direction `dir` (unit, from the lights to the place), whose error is `spread`.
    #[inline]
    fn bound_intensity(&self, dir: Vec3A, spread: (f32, f32)) -> f32 {
        if self.is_omnidirectional() || spread.0 <= -1.0 {
            return self.intensity;
        }
        let cos = self.axis.dot(dir);
        let cos = if self.two_sided { cos.abs() } else { cos }.clamp(-1.0, 1.0);
        let off_normals = angle_difference((cos, sin_from_cos(cos)), (self.cos_normals, self.sin_normals));
        let (cos, _) = angle_difference(off_normals, spread);
        if cos < -COSINE_TOLERANCE {
            return 0.0;
        }
        self.intensity * self.profile(cos.max(COSINE_TOLERANCE))
    }

    /// Approximates the power of the cosine by a quotient that falls off more slowly (\[schlick1994\]).
    #[inline]
    fn profile(&self, cos: f32) -> f32 {
        cos / (self.exponent - self.exponent * cos + cos)
    }

    /// Estimates the intensity, cd, toward a place from which the lights' middle lies along `toward` (m, not unit).
    #[inline]
    fn estimate_intensity(&self, toward: Vec3A) -> f32 {
        if self.is_omnidirectional() {
            return self.intensity;
        }
        let inverse = 1.0 / toward.length_squared().max(self.radius2).max(f32::MIN_POSITIVE).sqrt();
        let cos = -self.axis.dot(toward) * inverse;
        let cos = if self.two_sided { cos.abs() } else { cos };
        let open = 1.0 - self.cos_normals + self.radius * inverse;
        self.intensity * self.profile((cos + open).clamp(COSINE_TOLERANCE, 1.0))
    }
}

/// Returns an upper bound of exp(-x), x >= 0, without the cost of an exponential.
#[inline]
fn attenuation(x: f32) -> f32 {
    1.0 / (1.0 + x * (1.0 + x * (0.5 + x * (1.0 / 6.0))))
}

impl NodeImportance for PointContext {
    #[inline]
    fn distance2(&self, node: &Node) -> f32 {
        (node.center - self.position).length_squared()
    }

    #[inline]
    fn importance(&self, node: &Node) -> f32 {
        let (distance2, toward, spread) = node.seen_from(self.position);
        let intensity = node.bound_intensity(-toward, spread);
        if intensity <= 0.0 {
            return 0.0;
        }
        let mut importance = intensity / distance2;
        if self.normal != Vec3A::ZERO && spread.0 > -1.0 {
            let cos = self.normal.dot(toward).clamp(-1.0, 1.0);
            let (cos, _) = angle_difference((cos, sin_from_cos(cos)), spread);
            if cos < -COSINE_TOLERANCE {
                return 0.0;
            }
            importance *= cos.max(COSINE_TOLERANCE);
        }
        if node.extinction > 0.0 {
            importance *= attenuation(node.extinction * distance2.sqrt());
        }
        importance
    }
}

impl NodeImportance for SegmentContext {
    #[inline]
    fn distance2(&self, node: &Node) -> f32 {
        let toward = node.center - self.origin;
        (toward - self.dir * toward.dot(self.dir).clamp(self.range.0, self.range.1)).length_squared()
    }

    /// Computes the integral of 1 / distance^2 along the segment, times an estimate of the intensity toward its nearest point, or
    /// toward its ends if the nearest point is behind the lights.
    #[inline]
    fn importance(&self, node: &Node) -> f32 {
        let (t0, t1) = self.range;
        let along = (node.center - self.origin).dot(self.dir);
        let nearest = along.clamp(t0, t1);
        let beside2 = (node.center - (self.origin + self.dir * along)).length_squared();
        let h = beside2.max(node.radius2).sqrt().max(f32::MIN_POSITIVE.sqrt());
        let angle = approx_atan2(h * (t1 - t0), h * h + (t0 - along) * (t1 - along));
        let toward = |t: f32| node.estimate_intensity(node.center - (self.origin + self.dir * t));
        let mut intensity = toward(nearest);
        if intensity <= 2.0 * COSINE_TOLERANCE * node.intensity {
            intensity = intensity.max(0.5 * toward(t0).max(toward(t1)));
        }
        let importance = intensity * angle / h;
        let depth = self.extinction * (nearest - t0) + node.extinction * h;
        if depth > 0.0 { importance * attenuation(depth) } else { importance }
    }
}

/// Returns the angle whose tangent is `y / x`, 0..pi, to 1 %; y >= 0.
#[inline]
fn approx_atan2(y: f32, x: f32) -> f32 {
    let small = |t: f32| t / (1.0 + 0.28 * t * t);
    if x >= y {
        if y > 0.0 { small(y / x) } else { f32::MIN_POSITIVE }
    } else if x > -y {
        FRAC_PI_2 - small(x.abs() / y).copysign(x)
    } else {
        PI - small(y / -x)
    }
}

impl Node {
    pub(super) const PLACEHOLDER: Self = Self {
        center: Vec3A::ZERO,
        axis: Vec3A::Z,
        radius: 0.0,
        radius2: 0.0,
        intensity: 0.0,
        cos_normals: -1.0,
        sin_normals: 0.0,
        exponent: 1.0,
        two_sided: false,
        extinction: 0.0,
        children: LEAF,
        light: 0,
        ranks: (0, 0),
    };
}
