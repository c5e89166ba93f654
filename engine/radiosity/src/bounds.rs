//! Bounded propagation: bounds of the light that any element receives from any other.
//!
//! From a box, a cone of normals and an area of each element, [`form_factor`] bounds the form factor at every point of the
//! receiver, [`transmittance`] that of the fog between the elements, and [`irradiance`] their product with the radiosity
//! \[stamminger1997\]. The kernel is cos cos / (pi r2), so its bounds follow from bounds of the two cosines and of the distance.
//! Close to the source, its solid angle bounds the factor instead.
//!
//! The bounds hold for patches, curved elements, boxes of fog and clusters of surfaces, also if they touch or overlap. They are
//! rounded outward. They ignore other surfaces, so they are the bounds of the light without occlusion. With occlusion, only the
//! upper bound holds.
//!
//! Median of the upper bound over the factor at a point, in a million random pairs, by the distance of the centers in sums of the
//! radii (test `a_million_random_pairs_are_within_their_bounds`):
//!
//! | distance | flat elements | pairs with curved elements, fog or clusters |
//! | --- | --- | --- |
//! | 1 to 2 | 21 | 26 |
//! | 2 to 4 | 4.9 | 10 |
//! | 4 to 8 | 2.2 | 5.1 |
//! | 8 to 16 | 1.5 | 3.7 |
//! | 16 to 64 | 1.16 | 3.0 |
//! | above | 1.03 | 2.6 |
//!
//! The refiner takes two decisions with them: it drops pairs that are behind each other (`is_behind`), and it skips sources that
//! send nothing. A bound of the factor takes about as long as the factor itself (0.2 us), so it decides nothing else there. Of the
//! pairs of a furnished room, it proved 0.1 % more to be dark, and 2 % to have less than a hundredth of the allowed error. With
//! fog it proved a third to have so little, but links there did not become faster when bounds replaced estimates of their errors.

mod cone;

pub use cone::NormalCone;
pub(crate) use cone::{curved_box, spread_of_normals};

use crate::element::{Element, Shape};
use crate::gather::ElementLight;
use crate::solve::SolverState;
use crate::tuning::BEHIND_HEIGHT;
use femc_geometry::Aabb;
use femc_math::Rgb;
use femc_math::color::luminance;
use femc_math::elementary::double::{cbrt, sin_cos};
use femc_math::elementary::{self, exp};
use femc_math::glam::{DVec3, Vec3A};
use femc_prepared::media::Media;
use std::f32::consts::FRAC_PI_2;
use std::f64::consts::PI;

/// A closed interval of numbers that are not negative.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Interval {
    /// Lower bound.
    pub low: f32,
    /// Upper bound; may be infinite.
    pub high: f32,
}

/// Relative rounding of bounds that are computed in double precision from values in single precision.
const ROUNDING: f64 = 1e-5;

impl Interval {
    /// Returns the interval rounded outward.
    fn outward([low, high]: [f64; 2]) -> Self {
        let low = low * (1.0 - ROUNDING);
        Self {
            low: if low > 0.0 { low as f32 } else { 0.0 },
            high: (high * (1.0 + ROUNDING)) as f32 + f32::MIN_POSITIVE,
        }
    }

    /// Returns the products of numbers of two intervals.
    pub fn product(self, other: Self) -> Self {
        let high = if self.high <= 0.0 || other.high <= 0.0 { 0.0 } else { self.high * other.high };
        Self { low: self.low * other.low, high }
    }
}

/// Geometry of an element, as the bounds use it.
#[derive(Clone, Copy, Debug)]
pub struct Extent {
    /// Center of the box.
    pub center: DVec3,
    /// Half of the box's edges, rounded outward.
    pub half: DVec3,
    /// Cone of the normals; `None` for fog.
    pub normals: Option<NormalCone>,
    /// Point of the plane that contains the element, if there is one, and the rounding of its height, m.
    pub plane: Option<(DVec3, f64)>,
    /// Least and greatest area, m2, or volume of fog, m3.
    pub size: [f64; 2],
    /// Maximum number of times that a line crosses the element's surfaces from their back to their front.
    pub layers: f64,
}

impl Extent {
    /// Returns the geometry of an element. `None` for the cluster of all surfaces and the fog, which has no bounds.
    pub(crate) fn new(element: &Element) -> Option<Self> {
        if !element.radius.is_finite() {
            return None;
        }
        let patch = element.patch();
        // Rounding of the box itself, and of the points of a patch.
        let reach = element.box_center.abs() + element.half_extent;
        let error = patch.map_or(Vec3A::ZERO, |patch| patch.nodes()[0].error);
        let flat = patch.filter(|patch| patch.part.is_flat);
        // The spread of a flat part is the rounding of its normal, and so of its area.
        let rounding = 1e-5 + 4.0 * flat.map_or(0.0, |patch| f64::from(patch.part.spread));
        let size = f64::from(element.size());
        Some(Self {
            center: element.box_center.as_dvec3(),
            half: (element.half_extent + error + reach * (16.0 * f32::EPSILON)).as_dvec3(),
            normals: (!element.is_volume()).then(|| element.normals()),
            plane: flat.map(|_| (element.center.as_dvec3(), f64::from(error.length()))),
            size: [size * (1.0 - rounding).max(0.0), size * (1.0 + rounding)],
            layers: f64::from(element.layers()),
        })
    }

    /// Returns the radius of a sphere around the box.
    fn radius(&self) -> f64 {
        self.half.length()
    }
}

/// Ways from the points of one element to the points of another.
struct Ways<'a> {
    from: &'a Extent,
    to: &'a Extent,
    /// Way between the centers of the boxes; the ways differ from it by at most `half`.
    middle: DVec3,
    half: DVec3,
    /// Least and greatest length.
    length: [f64; 2],
}

impl<'a> Ways<'a> {
    fn new(from: &'a Extent, to: &'a Extent) -> Self {
        let (middle, half) = (to.center - from.center, from.half + to.half);
        let least = (middle.abs() - half).max(DVec3::ZERO).length();
        let length = [least, (middle.abs() + half).length()];
        Self { from, to, middle, half, length }
    }

    fn reversed(&self) -> Self {
        Self { from: self.to, to: self.from, middle: -self.middle, half: self.half, length: self.length }
    }

    /// Returns the least and greatest height of the ends above planes through the beginnings with normal `axis`.
    fn heights(&self, axis: DVec3) -> [f64; 2] {
        let (middle, half) = match self.from.plane {
            // All beginnings are in one plane.
            Some((point, error)) => {
                let angle = self.from.normals.map_or(0.0, |normals| f64::from(normals.angle));
                (axis.dot(self.to.center - point), axis.abs().dot(self.to.half) + error + angle * self.length[1])
            }
            None => (axis.dot(self.middle), axis.abs().dot(self.half)),
        };
        [middle - half, middle + half]
    }

    /// Returns the least and greatest cosine between normals at the beginnings and the ways; not clipped at 0. `None` for fog.
    fn cosines(&self) -> Option<[f64; 2]> {
        let cone = self.from.normals?;
        let (axis, angle) = (cone.axis.as_dvec3(), f64::from(cone.angle));
        let [least, most] = self.length;
        // Cosines with the axis, from the heights of the ends.
        let [low, high] = self.heights(axis);
        let of_height = |height: f64, length: f64| if length > 0.0 { height / length } else { height.signum() };
        let mut low = of_height(low, if low > 0.0 { most } else { least }).max(-1.0);
        let mut high = of_height(high, if high > 0.0 { least } else { most }).min(1.0);
        // From the cone around the ways.
        let distance = self.middle.length();
        let sine = self.half.length() / distance.max(f64::MIN_POSITIVE);
        if sine < 1.0 {
            let cosine = axis.dot(self.middle) / distance;
            let turn = (sine, (1.0 - sine * sine).sqrt());
            low = low.max(cosine_after(cosine, turn, 1.0));
            high = high.min(cosine_after(cosine, turn, -1.0));
        }
        if angle >= PI {
            return Some([-1.0, 1.0]);
        }
        let turn = sin_cos(angle);
        Some([cosine_after(low.min(1.0), turn, 1.0), cosine_after(high.max(-1.0), turn, -1.0)])
    }
}

/// Returns the cosine of an angle that is increased or decreased, within [0, pi].
/// - `cosine`: cosine of the angle;
/// - `turn`: sine and cosine of the change, which is in [0, pi];
/// - `sign`: 1 for an increase, -1 for a decrease.
fn cosine_after(cosine: f64, turn: (f64, f64), sign: f64) -> f64 {
    // The angle and the change sum to more than pi, or the change is greater than the angle.
    if sign * cosine <= -turn.1 {
        return -sign;
    }
    let sine = (1.0 - cosine * cosine).max(0.0).sqrt();
    (cosine * turn.1 - sign * sine * turn.0).clamp(-1.0, 1.0)
}

/// Bounds the form factor at every point of a receiver: the irradiance there per radiosity of the source, without occlusion and fog. For
/// fog as the receiver it is a quarter of the light from all directions; for fog as the source it is the irradiance per radiosity per
/// m, in m.
pub fn form_factor(receiver: &Extent, source: &Extent) -> Interval {
    let ways = Ways::new(receiver, source);
    let [least, most] = ways.length;
    let arriving = ways.cosines().map_or([0.25; 2], clipped);
    let leaving = ways.reversed().cosines().map_or([1.0; 2], clipped);
    if arriving[1] <= 0.0 || leaving[1] <= 0.0 {
        return Interval { low: 0.0, high: 0.0 };
    }
    let low = source.size[0] * arriving[0] * leaving[0] / (PI * most * most);
    let near = near_factor(&ways, arriving[1], source.size[1]);
    let mut high = if source.normals.is_some() { source.layers * near } else { near };
    if least > 0.0 {
        high = high.min(source.size[1] * arriving[1] * leaving[1] / (PI * least * least));
    }
    Interval::outward([low.min(high), high])
}

fn clipped(cosines: [f64; 2]) -> [f64; 2] {
    cosines.map(|cosine| cosine.max(0.0))
}

/// Returns a bound of the factor that is finite also for a point of the source: from the solid angle of the source's bounds. Lines
/// cross a surface once from its back to its front.
/// - `arriving`: greatest cosine at the receiver; a quarter for fog;
/// - `size`: area, or volume of fog, of the source.
fn near_factor(ways: &Ways<'_>, arriving: f64, size: f64) -> f64 {
    let (receiver, source) = (ways.from, ways.to);
    let is_surface = receiver.normals.is_some();
    let nearest = ((ways.middle.abs() - receiver.half).max(DVec3::ZERO)).length();
    let sine = if nearest > 0.0 { (source.radius() / nearest).min(1.0) } else { 1.0 };
    let solid_angle = if sine < 1.0 { 2.0 * PI * (1.0 - (1.0 - sine * sine).sqrt()) } else { 4.0 * PI };
    let through = arriving * solid_angle / PI;
    if source.normals.is_none() {
        // The ball of this volume around a point, or what a surface receives most of.
        let most = if is_surface { 0.8 * cbrt(15.0 * size / (4.0 * PI)) } else { cbrt(3.0 * size / (4.0 * PI)) };
        return most.min(through * 2.0 * source.radius());
    }
    let mut most = 1.0f64.min(through);
    if is_surface {
        most = most.min(sine * sine);
    }
    let least = ways.length[0];
    if least > 0.0 {
        // Area of the source's box across the ways.
        let across = ((ways.middle.abs() + ways.half) / least).min(DVec3::ONE);
        let faces =
            DVec3::new(source.half.y * source.half.z, source.half.z * source.half.x, source.half.x * source.half.y)
                * 4.0;
        most = most.min(arriving * across.dot(faces).min(faces.length()) / (PI * least * least));
    }
    most
}

/// Bounds the transmittance, by luminance, of the fog between the points of two elements. Media inside closed objects do not count.
pub fn transmittance(media: &Media, a: &Extent, b: &Extent) -> Interval {
    let [least, most] = Ways::new(a, b).length;
    let around = Aabb::around_center(a.center, a.half).union(Aabb::around_center(b.center, b.half));
    let [lowest, highest] = media.extinction_bounds(&around);
    let through = |extinction: Rgb, length: f64| {
        let channels = extinction.to_array().map(|extinction| exp(-extinction * length as f32));
        f64::from(luminance(Rgb::from_array(channels)))
    };
    let Interval { low, high } = Interval::outward([through(highest, most), through(lowest, least)]);
    Interval { low, high: high.min(1.0) }
}

/// Returns the bounds of what a source sends: the luminance of the radiosity at its parts' nodes, lx; for fog per m. The light is
/// linear between the nodes, and may exceed these bounds at the edge of a part.
pub(crate) fn sent(light: &ElementLight) -> Interval {
    Interval { low: light.darkest.max(0.0), high: light.brightest.max(0.0) }
}

/// Bounds the irradiance of every point of a receiver by a source, by luminance, lx; for fog a quarter of the light from all directions.
/// Light of one reflection alone, without occlusion.
/// - `sent`: bounds of the source's radiosity, lx; for fog per m.
pub fn irradiance(media: &Media, receiver: &Extent, source: &Extent, sent: Interval) -> Interval {
    form_factor(receiver, source).product(transmittance(media, receiver, source)).product(sent)
}

impl SolverState {
    /// Returns the geometry of each element, and the bounds of what it sends. The cluster of all surfaces and the fog has none.
    pub fn bounded_elements(&self) -> impl Iterator<Item = Option<(Extent, Interval)>> {
        let elements = self.arena.elements.iter().zip(&self.lights.elements);
        elements.map(|(element, light)| Extent::new(element).map(|extent| (extent, sent(light))))
    }
}

/// Checks whether all of `b` is behind all tangent planes of `a`, up to rounding.
pub(crate) fn is_behind(a: &Element, b: &Element) -> bool {
    let NormalCone { axis, angle } = a.normals();
    let single = a.single_normal();
    if single.is_none() && angle >= FRAC_PI_2 {
        return false;
    }
    let lowest = match &a.shape {
        Shape::Patch(patch) if patch.part.is_flat => a.center,
        _ => a.box_center - axis * axis.abs().dot(a.half_extent),
    };
    let height = b.max_height(lowest, axis);
    if single.is_some() {
        return height <= BEHIND_HEIGHT * (a.radius + b.radius);
    }
    // The planes turn away from the axis.
    let reach = ((b.box_center - a.box_center).abs() + a.half_extent + b.half_extent).length();
    height < 0.0 && {
        let (sin, cos) = elementary::sin_cos(angle);
        height * cos + reach * sin <= 0.0
    }
}
