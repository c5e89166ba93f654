//! Links: the light that one element receives from another, and the decision whether a link is exact enough.

mod estimate;
mod occlusion;

pub use estimate::directional_share;
pub use occlusion::occlusion_bound;

use crate::arena::Arena;
use crate::bounds::{Interval, is_behind, sent};
use crate::element::{Curved, Element, Patch, Shape};
use crate::factor::point_form_factor;
use crate::gather::ElementLight;
use crate::scene::Scene;
use crate::tuning::{CLOSE_LIGHT, CLOSE_RADII, ERROR_SCALE_BOUNDS, MAX_FINER, THICK_DEPTH, UNPROVED_LIGHT};
use crate::visibility::VisibilityTester;
use femc_field::Harmonics;
use femc_math::color::luminance;
use femc_math::glam::Vec3A;

/// Light from one element to another.
#[derive(Clone, Copy, Debug)]
pub struct Link {
    /// Index of the receiver.
    pub receiver: u32,
    /// Index of the source.
    pub source: u32,
    /// Share of the source's radiosity that arrives as irradiance at each of the receiver's nodes. For a wide source it is the
    /// factor of the intensity, and for a wide receiver that on a surface that faces the source: 1/m2.
    pub factors: [f32; 4],
}

/// Decision on a link.
#[derive(Clone, Copy, Debug)]
pub enum LinkDecision {
    /// No link: no light can travel this way.
    Drop,
    /// A final link: it is exact enough, or its elements cannot be split further (`is_inexact`). `error` is the estimated error of the
    /// irradiance by this link, lx.
    Keep { link: Link, is_inexact: bool, error: f32 },
    /// Links to the receiver's parts instead.
    SplitReceiver,
    /// Links from the source's parts instead.
    SplitSource,
    /// Links among the element's parts, instead of a link of the element with itself.
    SplitBoth,
}

/// Refinement oracle, which decides on links.
pub struct Oracle<'a> {
    pub scene: &'a Scene<'a>,
    pub arena: &'a Arena,
    pub lights: &'a [ElementLight],
    /// Intensity that elements with light by direction send, cd.
    pub intensity: &'a [Harmonics],
    /// Maximum error of a link, as a share of the receiver's irradiance.
    pub error: f32,
    /// Irradiance that is added to the receiver's, lx.
    pub floor: f32,
    /// Maximum irradiance of a surface that an error is relative to, lx.
    pub max_reference: f32,
    /// Irradiance that is added to that of fog, lx.
    pub fog_floor: f32,
    /// Area of an element that may have the requested error, m2. The error of another element is scaled with the inverse root of
    /// its area.
    pub unit_area: f32,
    /// Volume of fog that may have the requested error, m3.
    pub unit_volume: f32,
    /// Area up to which an element is not split any more, m2.
    pub min_area: f32,
    /// Volume up to which fog is not split any more, m3.
    pub min_volume: f32,
    /// Whether no more elements may be created.
    pub element_budget_exhausted: bool,
    /// Whether no link may be split, even with existing elements.
    pub link_budget_exhausted: bool,
}

/// A receiver and a source, which are different elements.
#[derive(Clone, Copy, Debug)]
pub struct Pair<'a> {
    /// Indices of the receiver and the source.
    receiver: u32,
    source: u32,
    /// The receiver, and the source.
    pub p: &'a Element,
    pub q: &'a Element,
    /// Light of the source.
    from: &'a ElementLight,
    /// Distance of the centers, m.
    distance: f32,
    /// Radius of the receiver, and of the source, over the distance; at most 1.
    near_p: f32,
    near_q: f32,
    /// Luminance of the source's radiosity, lx; of a source with light by direction the intensity toward the receiver, cd.
    radiosity: f32,
    /// Allowed error of the irradiance, lx.
    allowed: f32,
}

impl Pair<'_> {
    /// Checks whether one of the elements has its light by direction.
    fn has_directional(&self) -> bool {
        self.p.is_directional() || self.q.is_directional()
    }

    /// Bounds of the source's radiosity.
    fn sent(&self) -> Interval {
        sent(self.from)
    }

    fn keep(&self, factors: [f32; 4], is_inexact: bool) -> LinkDecision {
        LinkDecision::Keep {
            link: Link { receiver: self.receiver, source: self.source, factors },
            is_inexact,
            error: 0.0,
        }
    }
}

impl<'a> Oracle<'a> {
    /// Checks whether an element has parts, or may be split.
    pub fn may_split(&self, index: u32) -> bool {
        let element = &self.arena.elements[index as usize];
        match &element.shape {
            _ if self.link_budget_exhausted => false,
            _ if !element.is_leaf() => true,
            _ if self.element_budget_exhausted => false,
            Shape::Cluster(_) => true,
            Shape::Volume(fog) => fog.volume > self.min_volume,
            Shape::Patch(Patch { part, .. }) | Shape::Curved(Curved { part, .. }) => {
                // Bright places are split more finely.
                let brightness = self.lights[index as usize].mean / self.max_reference.max(f32::MIN_POSITIVE);
                part.area * brightness.clamp(1.0, MAX_FINER) > self.min_area
            }
        }
    }

    /// Returns the error that a link of a receiver may have, lx. Boxes of fog that contain a light source are bright only at their
    /// center.
    pub fn allowed_error(&self, p: &Element, light: &ElementLight) -> f32 {
        // A larger element is a larger part of the scene.
        let weight = |ratio: f32| ratio.sqrt().clamp(ERROR_SCALE_BOUNDS[0], ERROR_SCALE_BOUNDS[1]);
        match &p.shape {
            Shape::Volume(fog) => {
                self.error * (light.min_mean + self.fog_floor) * weight(self.unit_volume / fog.volume)
            }
            _ => {
                let irradiance = (0.5 * (light.min_mean + light.mean)).min(self.max_reference);
                self.error * (irradiance + self.floor) * weight(self.unit_area / p.size())
            }
        }
    }

    /// Returns the allowed error if no ray has reached the source.
    pub fn unproved_error(&self, p: &Element, allowed: f32) -> f32 {
        allowed.max(self.error * UNPROVED_LIGHT * if p.is_volume() { self.fog_floor } else { self.floor })
    }

    /// Returns the extinction at the center of an element, 1/m.
    pub fn extinction(&self, element: &Element) -> f32 {
        self.extinction_at(element.center)
    }

    fn extinction_at(&self, point: Vec3A) -> f32 {
        self.scene.uniform_extinction.unwrap_or_else(|| self.scene.prepared.media.extinction_at(point))
    }

    /// Returns a receiver and a source as a pair.
    pub fn pair(&self, receiver: u32, source: u32) -> Pair<'a> {
        let (p, q) = (&self.arena.elements[receiver as usize], &self.arena.elements[source as usize]);
        let (from, to) = (&self.lights[source as usize], &self.lights[receiver as usize]);
        let distance = p.center.distance(q.center);
        let dir = (p.center - q.center) / distance.max(f32::MIN_POSITIVE);
        let sent = match q.directional() {
            Some(directional) => self.intensity[directional].cosine_integral(dir),
            None => from.radiosity,
        };
        let close = |element: &Element| (element.radius / distance.max(1e-20)).min(1.0);
        let (near_p, near_q) = (close(p), close(q));
        let (radiosity, allowed) = (luminance(sent), self.allowed_error(p, to));
        Pair { receiver, source, p, q, from, distance, near_p, near_q, radiosity, allowed }
    }

    /// Decides on a link.
    pub fn decide(&self, receiver: u32, source: u32, tester: &mut VisibilityTester) -> LinkDecision {
        let (p, q) = (&self.arena.elements[receiver as usize], &self.arena.elements[source as usize]);
        if receiver == source {
            return self.decide_self_link(receiver, p, tester);
        }
        if is_behind(p, q) || is_behind(q, p) {
            return LinkDecision::Drop;
        }
        let pair = self.pair(receiver, source);
        if pair.radiosity <= 0.0 && pair.sent().high <= 0.0 {
            return pair.keep([0.0; 4], false);
        }
        if let Some(split) = self.split_close(&pair) {
            return split;
        }
        let estimate = self.estimate(&pair, tester);
        let is_inexact = estimate.errors[0] + estimate.errors[1] > pair.allowed;
        let brightest = pair.radiosity.max(pair.sent().high * if q.is_directional() { 0.0 } else { 1.0 });
        let amount = estimate.mean * brightest;
        if is_inexact {
            if self.is_dark(&pair, amount, tester) {
                return pair.keep([0.0; 4], false);
            }
            if let Some(split) = self.choose_split(&pair, estimate.errors) {
                return split;
            }
        }
        if amount <= 0.0 {
            return pair.keep(estimate.factors, false);
        }
        let mut decision = self.decide_by_occlusion(&pair, (estimate.factors, amount), is_inexact, tester);
        if let LinkDecision::Keep { error, .. } = &mut decision {
            *error = estimate.error;
        }
        decision
    }

    /// Splits a pair that is too close for light by direction. The center of such an element represents all of it only from far
    /// away. Near the source, parts of the receiver as large as the source receive up to the source's radiosity. An error counts by
    /// the root of their share of the receiver.
    fn split_close(&self, pair: &Pair<'_>) -> Option<LinkDecision> {
        let Pair { p, q, .. } = *pair;
        let is_close = pair.has_directional() && pair.distance < CLOSE_RADII * (p.radius + q.radius);
        if !is_close {
            return None;
        }
        let share = (q.radius / p.radius).min(1.0).sqrt();
        // For fog, the length from which light comes.
        let length = if q.is_volume() { q.radius.min(1.0 / self.extinction(q)) } else { 1.0 };
        let is_bright = luminance(pair.from.radiosity) * length * share > CLOSE_LIGHT * pair.allowed;
        let larger_first = if p.radius > q.radius { [1.0, 0.0] } else { [0.0, 1.0] };
        is_bright.then(|| self.choose_split(pair, larger_first)).flatten().filter(|split| {
            // The parts of a small cluster would be as close.
            let is_small = q.is_cluster() && q.is_leaf() && q.radius < p.radius;
            !(is_small && matches!(split, LinkDecision::SplitSource))
        })
    }

    /// Splits the element that causes the error, or else the other one. `None` if neither can be split.
    fn choose_split(&self, pair: &Pair<'_>, errors: [f32; 2]) -> Option<LinkDecision> {
        let order = if errors[0] >= errors[1] {
            [(pair.receiver, LinkDecision::SplitReceiver), (pair.source, LinkDecision::SplitSource)]
        } else {
            [(pair.source, LinkDecision::SplitSource), (pair.receiver, LinkDecision::SplitReceiver)]
        };
        order.into_iter().find(|&(element, _)| self.may_split(element)).map(|(_, verdict)| verdict)
    }

    fn decide_self_link(&self, receiver: u32, p: &Element, tester: &mut VisibilityTester) -> LinkDecision {
        let keep = |factors| LinkDecision::Keep {
            link: Link { receiver, source: receiver, factors },
            is_inexact: false,
            error: 0.0,
        };
        let is_convex = |surface: u32| !self.scene.surfaces[surface as usize].is_concave();
        match &p.shape {
            Shape::Cluster(_) => {
                // What the surfaces of a small cluster send to each other is found by rays.
                let light = &self.lights[receiver as usize];
                let is_bright = || luminance(light.radiosity) > CLOSE_LIGHT * self.allowed_error(p, light);
                if !p.is_leaf() || is_bright() && self.may_split(receiver) {
                    LinkDecision::SplitBoth
                } else {
                    keep([0.0; 4])
                }
            }
            Shape::Patch(Patch { part, .. }) | Shape::Curved(Curved { part, .. }) if is_convex(part.surface) => {
                LinkDecision::Drop
            }
            Shape::Curved(_) => {
                if self.may_split(receiver) || !p.is_leaf() {
                    LinkDecision::SplitBoth
                } else {
                    LinkDecision::Drop
                }
            }
            Shape::Patch(patch) => {
                // The inner side of a sphere has a constant kernel. For other surfaces, this is the mean over the other nodes.
                let (nodes, mut factors) = (patch.nodes(), [0.0; 4]);
                for (k, factor) in factors.iter_mut().enumerate().take(nodes.len()) {
                    let others = (0..nodes.len()).filter(|&j| j != k);
                    let sum: f32 = others.map(|j| point_form_factor(&nodes[k], &nodes[j], patch.part.area)).sum();
                    *factor = sum / (nodes.len() - 1) as f32;
                }
                keep(factors)
            }
            Shape::Volume(_) => {
                let to = self.lights[receiver as usize];
                let spread = 0.5 * (to.brightest - to.darkest);
                let mut factors = [0.0; 4];
                for (factor, node) in factors.iter_mut().zip(p.nodes()) {
                    *factor = self.factor(p, p, &node, tester);
                }
                let thick = self.extinction(p) * p.half_extent.max_element() > THICK_DEPTH;
                if (thick || factors[0] * spread > self.allowed_error(p, &to)) && self.may_split(receiver) {
                    return LinkDecision::SplitBoth;
                }
                keep(factors)
            }
        }
    }
}
