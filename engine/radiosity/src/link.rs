//! Links: the light that one element receives from another, and the decision whether a link is exact enough.

use crate::arena::Arena;
use crate::element::{Cluster, Curved, Element, Patch, PatchForm, Shape};
use crate::form_factor::{is_near, polygon_form_factor, solid_angle};
use crate::gather::ElementLight;
use crate::scene::Scene;
use crate::visibility::{RandomNumbers, VisibilityTester, sample_point};
use femc_field::SurfaceSpot;
use femc_math::color::luminance;
use femc_math::glam::Vec3A;
use std::f32::consts::PI;

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
    /// A final link: it is exact enough, or its elements cannot be split further (`is_inexact`).
    Keep { link: Link, is_inexact: bool },
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
    /// Maximum error of a link, as a share of the receiver's irradiance.
    pub error: f32,
    /// Irradiance that is added to the receiver's, lx.
    pub floor: f32,
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

/// Minimum sum of the radii of a box of fog and its neighbor, as a share of their distance.
const MIN_NEIGHBOR_RADII: f32 = 0.5;

/// Bounds of the error scale, for large and for small elements.
const ERROR_SCALE_BOUNDS: [f32; 2] = [0.5, 4.0];

/// Minimum share of a source in the receiver's view, by radius over distance, in the estimate of the number of similar sources.
const MIN_SOURCE_SHARE: f32 = 0.03;

/// Weight of the light at a box's edge that the nodes miss. With a small weight, large adjacent boxes would be linked. Their light
/// travels from edge to edge, where no node is, and is lost.
const EDGE_WEIGHT: f32 = 2.0;
/// Weight for a surface as the source, which is adjacent to a larger part of the box.
const SURFACE_EDGE_WEIGHT: f32 = 4.0;

/// Optical thickness of half of a box of fog above which its light to itself is not treated as one value.
const THICK_DEPTH: f32 = 0.5;

/// Optical thickness of a surface's radius, times radius over distance, up to which its nodes suffice for the attenuation by fog.
const THIN_DEPTH: f32 = 0.1;

/// Number of visibility rays of a first test, and of a second one if the first found the source partly occluded.
const VISIBILITY_RAYS: [u32; 2] = [4, 12];
/// Limit for the light of a source that no ray has reached, in multiples of the minimum irradiance that an error is relative to.
/// Below, the source counts as dark. Otherwise dark areas would be split finely only to prove their darkness.
const UNPROVED_LIGHT: f32 = 10.0;
/// Maximum light of a link, as a share of the allowed error, for which one ray is enough.
const ONE_RAY_LIGHT: f32 = 0.2;

impl Oracle<'_> {
    /// Checks whether an element has parts, or may be split.
    pub fn may_split(&self, element: &Element) -> bool {
        match &element.shape {
            _ if self.link_budget_exhausted => false,
            Shape::Cluster(_) => true,
            _ if !element.is_leaf() => true,
            _ if self.element_budget_exhausted => false,
            Shape::Volume(fog) => fog.volume > self.min_volume,
            Shape::Patch(Patch { part, .. }) | Shape::Curved(Curved { part, .. }) => part.area > self.min_area,
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
            _ => self.error * (0.5 * (light.min_mean + light.mean) + self.floor) * weight(self.unit_area / p.size()),
        }
    }

    /// Returns the allowed error if no ray has reached the source.
    pub fn unproved_error(&self, p: &Element, allowed: f32) -> f32 {
        allowed
            .max(self.error * UNPROVED_LIGHT * if p.is_volume() { self.fog_floor } else { self.floor })
    }

    /// Returns the extinction at the center of an element, 1/m.
    pub fn extinction(&self, element: &Element) -> f32 {
        self.extinction_at(element.center)
    }

    fn extinction_at(&self, point: Vec3A) -> f32 {
        self.scene.uniform_extinction.unwrap_or_else(|| self.scene.prepared.media.extinction_at(point))
    }

    /// Decides on a link.
    pub fn decide(&self, receiver: u32, source: u32, tester: &mut VisibilityTester) -> LinkDecision {
        let (p, q) = (&self.arena.elements[receiver as usize], &self.arena.elements[source as usize]);
        if receiver == source {
            return self.decide_self_link(receiver, p, tester);
        }
        if is_behind(self.scene, p, q) || is_behind(self.scene, q, p) {
            return LinkDecision::Drop;
        }
        let distance = p.center.distance(q.center);
        let wide = p.is_directional() || q.is_directional();
        let (from, to) = (&self.lights[source as usize], &self.lights[receiver as usize]);
        let mut link = Link { receiver, source, factors: [0.0; 4] };
        let dir = (p.center - q.center) / distance.max(f32::MIN_POSITIVE);
        let radiosity =
            luminance(if q.is_directional() { from.intensity.cosine_integral(dir) } else { from.radiosity });
        if radiosity <= 0.0 && from.brightest <= 0.0 {
            return LinkDecision::Keep { link, is_inexact: false };
        }
        let allowed = self.allowed_error(p, to);
        // The center of a wide element represents all of it only from far away. Near the source, parts of the receiver as large as
        // the source receive up to the source's radiosity. An error counts by the root of their share of the receiver.
        if wide && distance < 1.5 * (p.radius + q.radius) {
            let share = (q.radius / p.radius).min(1.0).sqrt();
            // For fog, the length from which light comes.
            let length = if q.is_volume() { q.radius.min(1.0 / self.extinction(q)) } else { 1.0 };
            if luminance(from.radiosity) * length * share > 0.5 * allowed {
                let larger_first = if p.radius > q.radius { [1.0, 0.0] } else { [0.0, 1.0] };
                if let Some(verdict) = self.choose_split(p, q, larger_first) {
                    return verdict;
                }
            }
        }

        let count = p.node_count();
        for (factor, node) in link.factors.iter_mut().zip(p.nodes()) {
            *factor = self.factor(p, q, &node, tester);
        }
        let nodes = &link.factors[..count];
        let mut mean = nodes.iter().sum::<f32>() / count as f32;
        let middle = if count > 1 { self.factor(p, q, &p.center_spot(), tester) } else { mean };
        let (low, high) = nodes.iter().fold((f32::INFINITY, 0.0f32), |(low, high), &f| (low.min(f), high.max(f)));
        let reach = radiosity.max(from.brightest * if q.is_directional() { 0.0 } else { 1.0 });
        let close = |element: &Element| (element.radius / distance.max(1e-20)).min(1.0);
        let (near_p, near_q) = (close(p), close(q));
        let spread = 0.5 * (from.brightest - from.darkest);
        // A small source at a box of fog mostly lights the fog next to itself, where there may be no node. The light that the whole
        // box receives is computed in the reverse direction. The part that the nodes miss is spread over the box.
        let is_beside = p.is_volume()
            && near_p + near_q > MIN_NEIGHBOR_RADII
            && match &q.shape {
                Shape::Patch(_) => q.radius < p.radius,
                Shape::Volume(_) => q.size() < p.size(),
                Shape::Cluster(_) | Shape::Curved(_) => false,
            };
        let unseen_part = if is_beside {
            let back: f32 = q.nodes().map(|spot| self.factor_from_fog(q, p, &spot, tester)).sum::<f32>()
                / q.node_count() as f32;
            let share = if q.is_volume() { 1.0 } else { 0.25 };
            let whole = share * back * q.size() / p.size();
            let less = whole - mean;
            let scale = if mean > 0.0 { (whole / mean).min(1.0) } else { 1.0 };
            link.factors = link.factors.map(|factor| factor * scale + less.max(0.0));
            mean = whole;
            less.abs()
        } else {
            0.0
        };
        let edge = match (&p.shape, &q.shape) {
            (Shape::Volume(_), Shape::Volume(_)) => EDGE_WEIGHT * self.edge_error(p, q, &link.factors, tester),
            (Shape::Volume(_), Shape::Patch(_)) => {
                SURFACE_EDGE_WEIGHT * self.edge_error(p, q, &link.factors, tester)
            }
            _ => 0.0,
        };
        let mut errors = [
            if p.is_directional() {
                mean * radiosity * (0.1 + 2.0 * near_p * near_p)
            } else {
                let shape = 0.5 * near_p * near_p * mean;
                (2.0 * (middle - mean).abs() + 0.03 * (high - low) + shape + unseen_part + edge) * radiosity
            },
            if q.is_directional() {
                mean * radiosity * (0.1 + 2.0 * near_q * near_q)
            } else {
                // A few points represent a shape that is not a polygon.
                let is_bent = q.patch().is_some_and(|patch| patch.form == PatchForm::Bent);
                let shape = if is_bent { 0.5 * near_q * near_q } else { 0.0 };
                mean * (spread * (2.0 * near_q).min(1.0) + shape * radiosity)
            },
        ];
        // A source that is small from here is one of many adjacent ones, whose errors at the receiver are alike and add up.
        if p.is_volume() {
            errors[0] /= near_q.max(MIN_SOURCE_SHARE);
        } else {
            let share = if wide { 0.25 * near_q * near_q } else { mean };
            let many = 1.0 / share.sqrt().clamp(MIN_SOURCE_SHARE, 1.0);
            errors = errors.map(|error| error * many);
        }
        if self.scene.fog.is_some() {
            // The attenuation by fog varies over the source. A box of fog also has no single distance.
            let thickness = (self.extinction(q) * q.radius).min(1.0);
            let shape = if q.is_volume() { near_q * near_q } else { 0.0 };
            errors[1] += mean * radiosity * (shape + 0.3 * near_q * thickness);
        }
        let amount = mean * reach;
        let unproved_error = self.unproved_error(p, allowed);
        if errors[0] + errors[1] > allowed {
            // In the dark, it is worth testing first whether any light arrives.
            let looks = allowed < unproved_error
                && amount * occlusion_bound(VISIBILITY_RAYS[0] + VISIBILITY_RAYS[1]) <= unproved_error;
            let is_dark = looks
                && self.cast_visibility_rays(p, q, tester, false, true).0[..count]
                    .iter()
                    .all(|&seen| seen == 0.0);
            if is_dark {
                return LinkDecision::Keep { link: Link { factors: [0.0; 4], ..link }, is_inexact: false };
            }
            if let Some(verdict) = self.choose_split(p, q, errors) {
                return verdict;
            }
        }
        if amount <= 0.0 {
            return LinkDecision::Keep { link, is_inexact: false };
        }
        // Occlusion.
        let (seen, refused) = self.cast_visibility_rays(
            p,
            q,
            tester,
            amount <= ONE_RAY_LIGHT * allowed,
            amount * occlusion_bound(VISIBILITY_RAYS[0]) > unproved_error,
        );
        let least = seen[..count].iter().copied().fold(1.0f32, f32::min);
        let most = seen[..count].iter().copied().fold(0.0f32, f32::max);
        let hidden = if most == 0.0 { refused } else { 0.5 * (most - least).max(refused) };
        link.factors.iter_mut().zip(seen).for_each(|(factor, seen)| *factor *= seen);
        let error = amount * hidden;
        if error > if most == 0.0 { unproved_error } else { allowed } {
            let sizes = if p.radius > q.radius { [error, 0.0] } else { [0.0, error] };
            return self.choose_split(p, q, sizes).unwrap_or(LinkDecision::Keep { link, is_inexact: true });
        }
        LinkDecision::Keep { link, is_inexact: errors[0] + errors[1] > allowed }
    }

    /// Splits the element that causes the error, or else the other one. `None` if neither can be split.
    fn choose_split(&self, p: &Element, q: &Element, errors: [f32; 2]) -> Option<LinkDecision> {
        let order = if errors[0] >= errors[1] {
            [(p, LinkDecision::SplitReceiver), (q, LinkDecision::SplitSource)]
        } else {
            [(q, LinkDecision::SplitSource), (p, LinkDecision::SplitReceiver)]
        };
        order.into_iter().find(|(element, _)| self.may_split(element)).map(|(_, verdict)| verdict)
    }

    fn decide_self_link(&self, receiver: u32, p: &Element, tester: &mut VisibilityTester) -> LinkDecision {
        let keep =
            |factors| LinkDecision::Keep { link: Link { receiver, source: receiver, factors }, is_inexact: false };
        let is_convex = |surface: u32| !self.scene.surfaces[surface as usize].is_concave();
        match &p.shape {
            Shape::Cluster(_) => LinkDecision::SplitBoth,
            Shape::Patch(Patch { part, .. }) | Shape::Curved(Curved { part, .. }) if is_convex(part.surface) => {
                LinkDecision::Drop
            }
            Shape::Curved(_) => {
                if self.may_split(p) || !p.is_leaf() {
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
                if (thick || factors[0] * spread > self.allowed_error(p, &to)) && self.may_split(p) {
                    return LinkDecision::SplitBoth;
                }
                keep(factors)
            }
        }
    }

    /// Returns the factor of an element at a point through the fog, without occlusion, as in [`Link::factors`].
    pub fn factor(&self, p: &Element, q: &Element, node: &SurfaceSpot, tester: &mut VisibilityTester) -> f32 {
        if q.is_volume() {
            return self.factor_from_fog(p, q, node, tester);
        }
        let way = q.center - node.position;
        let mut distance2 = way.length_squared();
        if p.is_directional() || q.is_directional() {
            // Minimum mean distance of the parts of both elements.
            let reach = p.radius + q.radius;
            distance2 = distance2.max(0.25 * reach * reach);
        }
        let distance = distance2.sqrt();
        let near = is_near(distance2, q.radius) && !p.is_directional();
        // Sums over parts of the source, by area and direction from the point.
        let parts = |patch: &Patch, of: &dyn Fn(&SurfaceSpot, f32) -> f32| -> f32 {
            if near {
                let nodes = patch.nodes();
                nodes.iter().map(|part| of(part, patch.part.area / nodes.len() as f32)).sum()
            } else {
                of(&SurfaceSpot { position: q.center, normal: patch.normal, ..*node }, patch.part.area)
            }
        };
        let is_close_polygon =
            |patch: &Patch| patch.form != PatchForm::Bent && distance2 < 25.0 * q.radius * q.radius;
        let open = match (&p.shape, &q.shape) {
            (Shape::Patch(_), Shape::Patch(patch)) if is_close_polygon(patch) => {
                polygon_form_factor(node.position, node.normal, patch.polygon())
            }
            (Shape::Patch(_), Shape::Patch(patch)) => {
                parts(patch, &|part, area| point_form_factor(node, part, area)).min(1.0)
            }
            (Shape::Patch(_), _) => (node.normal.dot(way) / distance).max(0.0) / distance2,
            (Shape::Volume(_), Shape::Patch(patch)) if is_close_polygon(patch) => {
                solid_angle(node.position, patch.polygon()) / (4.0 * PI)
            }
            (Shape::Volume(_), Shape::Patch(patch)) => {
                0.25 * parts(patch, &|part, area| point_solid_angle_factor(node, part, area))
            }
            (Shape::Volume(_), _) => return self.factor_at_fog(p, q, distance2, node, tester),
            (_, Shape::Patch(patch)) => {
                patch.part.area * (-patch.normal.dot(way) / distance).max(0.0) / (PI * distance2)
            }
            _ => 1.0 / distance2,
        };
        if open <= 0.0 || self.scene.uniform_extinction == Some(0.0) {
            return open.max(0.0);
        }
        let Some(patch) = q.patch().filter(|_| near) else {
            return open * tester.fog_transmittance(self.scene, node.position, q.center);
        };
        // Near parts are attenuated less: the mean is weighted by the kernel at points of the source, at more points where that
        // matters.
        let (mut weight, mut through) = (0.0, 0.0);
        let mut add = |part: &SurfaceSpot| {
            let kernel = if p.patch().is_some() {
                point_form_factor(node, part, 1.0)
            } else {
                point_solid_angle_factor(node, part, 1.0)
            };
            weight += kernel;
            through += kernel * tester.fog_transmittance(self.scene, node.position, part.position);
        };
        let thickness = self.extinction(q) * q.radius;
        if patch.form != PatchForm::Bent && thickness * q.radius > THIN_DEPTH * distance {
            let is_triangle = patch.form == PatchForm::Triangle;
            let corners = patch.polygon();
            let (a, b, last) = (corners[0], corners[1], corners[corners.len() - 1]);
            for k in 0..64 {
                let mut u = [k % 8, k / 8].map(|k| (k as f32 + 0.5) / 8.0);
                if is_triangle && u[0] + u[1] > 1.0 {
                    u = u.map(|u| 1.0 - u);
                }
                let position = a + (b - a) * u[0] + (last - a) * u[1];
                add(&SurfaceSpot { position, ..patch.nodes()[0] });
            }
        } else {
            patch.nodes().iter().for_each(add);
        }
        if weight > 0.0 {
            open * through / weight
        } else {
            open * tester.fog_transmittance(self.scene, node.position, q.center)
        }
    }

    /// Returns the share of the source's light that reaches each node, and the uncertainty of the shares.
    /// - `one_ray`: one ray is enough;
    /// - `recheck_unseen`: cast more rays if the first rays do not reach the source.
    fn cast_visibility_rays(
        &self,
        p: &Element,
        q: &Element,
        tester: &mut VisibilityTester,
        one_ray: bool,
        recheck_unseen: bool,
    ) -> ([f32; 4], f32) {
        let mut numbers = RandomNumbers::new(&[p.key, q.key]);
        let (mut got, mut cast) = ([0.0f32; 4], [0u32; 4]);
        let (mut hits, mut misses) = (0u32, 0u32);
        // A single ray goes from a random node to a random quarter.
        let first = (numbers.next() * 12.0) as u32;
        for (round, rays) in VISIBILITY_RAYS.into_iter().enumerate() {
            if round == 1 && (misses == 0 || one_ray || hits == 0 && !recheck_unseen) {
                break;
            }
            for k in 0..if one_ray { 1 } else { rays } {
                let turn = k + first;
                let node = turn as usize % p.node_count();
                for _ in 0..4 {
                    let to = sample_point(self.arena, self.scene, q, (turn + turn / 4) % 4, &mut numbers, |part| {
                        luminance(self.lights[part as usize].radiosity)
                    });
                    let from = if p.is_directional() {
                        sample_point(self.arena, self.scene, p, turn % 4, &mut numbers, |_| 1.0)
                    } else {
                        p.node(node)
                    };
                    let way = to.position - from.position;
                    if faces(&from, way) && faces(&to, -way) {
                        let share = tester.visibility(self.scene, &from, &to);
                        got[node] += share;
                        cast[node] += 1;
                        *if share > 0.0 { &mut hits } else { &mut misses } += 1;
                        break;
                    }
                }
            }
        }
        let total: u32 = cast.iter().sum();
        if total == 0 {
            return ([0.0; 4], 0.0);
        }
        let mean = got.iter().sum::<f32>() / total as f32;
        let seen = [0, 1, 2, 3].map(|k| if cast[k] > 0 { got[k] / cast[k] as f32 } else { mean });
        let share = hits as f32 / total as f32;
        // A source that no ray has reached may still be visible.
        let unsure = if hits == 0 { occlusion_bound(total) } else { (share * (1.0 - share)).sqrt() };
        (seen, unsure)
    }
}

/// Returns the share of a source that may be visible although this number of rays missed it.
pub fn occlusion_bound(rays: u32) -> f32 {
    0.5 / (rays + 2) as f32
}

fn faces(spot: &SurfaceSpot, way: Vec3A) -> bool {
    spot.normal == Vec3A::ZERO || spot.normal.dot(way) > 0.0
}

/// Returns the form factor of a small surface of area `area` at a spot, from another spot.
pub fn point_form_factor(at: &SurfaceSpot, from: &SurfaceSpot, area: f32) -> f32 {
    let way = from.position - at.position;
    let distance2 = way.length_squared();
    if distance2 <= 0.0 {
        return 0.0;
    }
    area * at.normal.dot(way).max(0.0) * (-from.normal.dot(way)).max(0.0) / (PI * distance2 * distance2)
}

/// Returns the form factor without the cosine of the receiver.
pub fn point_solid_angle_factor(at: &SurfaceSpot, from: &SurfaceSpot, area: f32) -> f32 {
    let way = from.position - at.position;
    let distance2 = way.length_squared();
    if distance2 <= 0.0 {
        return 0.0;
    }
    area * (-from.normal.dot(way)).max(0.0) / (PI * distance2 * distance2.sqrt())
}

/// Checks whether all of `b` is behind the flat element `a`.
fn is_behind(scene: &Scene<'_>, a: &Element, b: &Element) -> bool {
    let lowest = match &a.shape {
        Shape::Patch(patch) if scene.surfaces[patch.part.surface as usize].is_flat() => a.center,
        Shape::Cluster(Cluster { normal: Some(normal), .. }) => {
            a.box_center - *normal * normal.abs().dot(a.half_extent)
        }
        Shape::Patch(_) | Shape::Cluster(_) | Shape::Curved(_) | Shape::Volume(_) => return false,
    };
    b.max_height(lowest, a.normal()) <= 1e-5 * (a.radius + b.radius)
}
