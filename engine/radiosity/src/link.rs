//! Links: the light that one element receives from another, and the decision whether a link is exact enough.

use crate::arena::Arena;
use crate::element::{Element, Kind};
use crate::form_factor::{is_near, polygon, solid_angle};
use crate::gather::Light;
use crate::scene::Scene;
use crate::visibility::{Eye, Numbers, spot};
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
pub enum Verdict {
    /// No link: no light can travel this way.
    Drop,
    /// A final link: it is exact enough, or its elements cannot be split further (`refused`).
    Keep { link: Link, refused: bool },
    /// Links to the receiver's parts instead.
    Receiver,
    /// Links from the source's parts instead.
    Source,
    /// Links among the element's parts, instead of a link of the element with itself.
    Both,
}

/// Refinement oracle, which decides on links.
pub struct Judge<'a> {
    pub scene: &'a Scene<'a>,
    pub arena: &'a Arena,
    pub light: &'a [Light],
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
    pub least_area: f32,
    /// Volume up to which fog is not split any more, m3.
    pub least_volume: f32,
    /// Whether no more elements may be created.
    pub full: bool,
    /// Whether no link may be split, even with existing elements.
    pub brimful: bool,
}

/// Minimum sum of the radii of a box of fog and its neighbor, as a share of their distance.
const BESIDE: f32 = 0.5;

/// Bounds of the error scale, for large and for small elements.
const WEIGHTS: [f32; 2] = [0.5, 4.0];

/// Minimum share of a source in the receiver's view, by radius over distance, in the estimate of the number of similar sources.
const MANY: f32 = 0.03;

/// Weight of the light at a box's edge that the nodes miss. With a small weight, large adjacent boxes would be linked. Their light
/// travels from edge to edge, where no node is, and is lost.
const EDGE: f32 = 2.0;
/// Weight for a surface as the source, which is adjacent to a larger part of the box.
const EDGE_OF_SURFACE: f32 = 4.0;

/// Optical thickness of half of a box of fog above which its light to itself is not treated as one value.
const THICK: f32 = 0.5;

/// Optical thickness of a surface's radius, times radius over distance, up to which its nodes suffice for the attenuation by fog.
const THIN: f32 = 0.1;

/// Number of visibility rays of a first test, and of a second one if the first found the source partly occluded.
const LOOK: [u32; 2] = [4, 12];
/// Limit for the light of a source that no ray has reached, in multiples of the minimum irradiance that an error is relative to.
/// Below, the source counts as dark. Otherwise dark areas would be split finely only to prove their darkness.
const DOUBT: f32 = 10.0;
/// Maximum light of a link, as a share of the allowed error, for which one ray is enough.
const LITTLE: f32 = 0.2;

impl Judge<'_> {
    /// Checks whether an element has parts, or may be split.
    pub fn may_cut(&self, element: &Element) -> bool {
        match element.kind {
            _ if self.brimful => false,
            Kind::Cluster => true,
            _ if !element.is_leaf() => true,
            _ if self.full => false,
            Kind::Fog => element.size > self.least_volume,
            Kind::Patch | Kind::Ball => element.size > self.least_area,
        }
    }

    /// Returns the error that a link of a receiver may have, lx. Boxes of fog that contain a light source are bright only at their
    /// center.
    pub fn allowed(&self, p: &Element, light: &Light) -> f32 {
        // A larger element is a larger part of the scene.
        let weight = |ratio: f32| ratio.sqrt().clamp(WEIGHTS[0], WEIGHTS[1]);
        match p.kind {
            Kind::Fog => self.error * (light.least + self.fog_floor) * weight(self.unit_volume / p.size),
            _ => self.error * (0.5 * (light.least + light.mean) + self.floor) * weight(self.unit_area / p.size),
        }
    }

    /// Returns the allowed error if no ray has reached the source.
    pub fn in_doubt(&self, p: &Element, allowed: f32) -> f32 {
        allowed.max(self.error * DOUBT * if p.kind == Kind::Fog { self.fog_floor } else { self.floor })
    }

    /// Returns the extinction at the center of an element, 1/m.
    pub fn extinction(&self, element: &Element) -> f32 {
        self.haze_at(element.center)
    }

    fn haze_at(&self, point: Vec3A) -> f32 {
        self.scene.haze.unwrap_or_else(|| self.scene.prepared.media.extinction_at(point))
    }

    /// Decides on a link.
    pub fn judge(&self, receiver: u32, source: u32, eye: &mut Eye) -> Verdict {
        let (p, q) = (&self.arena.elements[receiver as usize], &self.arena.elements[source as usize]);
        if receiver == source {
            return self.judge_itself(receiver, p, eye);
        }
        if unseen(self.scene, p, q) || unseen(self.scene, q, p) {
            return Verdict::Drop;
        }
        let distance = p.center.distance(q.center);
        let wide = p.is_wide() || q.is_wide();
        let (from, to) = (&self.light[source as usize], &self.light[receiver as usize]);
        let mut link = Link { receiver, source, factors: [0.0; 4] };
        let dir = (p.center - q.center) / distance.max(f32::MIN_POSITIVE);
        let radiosity = luminance(if q.is_wide() { from.sent.cosine(dir) } else { from.radiosity });
        if radiosity <= 0.0 && from.brightest <= 0.0 {
            return Verdict::Keep { link, refused: false };
        }
        let allowed = self.allowed(p, to);
        // The center of a wide element represents all of it only from far away. Near the source, parts of the receiver as large as
        // the source receive up to the source's radiosity. An error counts by the root of their share of the receiver.
        if wide && distance < 1.5 * (p.radius + q.radius) {
            let share = (q.radius / p.radius).min(1.0).sqrt();
            // For fog, the length from which light comes.
            let length = if q.kind == Kind::Fog { q.radius.min(1.0 / self.extinction(q)) } else { 1.0 };
            if luminance(from.radiosity) * length * share > 0.5 * allowed {
                let larger_first = if p.radius > q.radius { [1.0, 0.0] } else { [0.0, 1.0] };
                if let Some(verdict) = self.cut(p, q, larger_first) {
                    return verdict;
                }
            }
        }

        for (factor, node) in link.factors.iter_mut().zip(&p.nodes[..p.count]) {
            *factor = self.factor(p, q, node, eye);
        }
        let nodes = &link.factors[..p.count];
        let mut mean = nodes.iter().sum::<f32>() / p.count as f32;
        let middle = if p.count > 1 {
            self.factor(p, q, &SurfaceSpot { position: p.center, normal: p.normal, error: p.nodes[0].error }, eye)
        } else {
            mean
        };
        let (low, high) = nodes.iter().fold((f32::INFINITY, 0.0f32), |(low, high), &f| (low.min(f), high.max(f)));
        let reach = radiosity.max(from.brightest * if q.is_wide() { 0.0 } else { 1.0 });
        let close = |element: &Element| (element.radius / distance.max(1e-20)).min(1.0);
        let (near_p, near_q) = (close(p), close(q));
        let spread = 0.5 * (from.brightest - from.darkest);
        // A small source at a box of fog mostly lights the fog next to itself, where there may be no node. The light that the whole
        // box receives is computed in the reverse direction. The part that the nodes miss is spread over the box.
        let is_beside = p.kind == Kind::Fog
            && near_p + near_q > BESIDE
            && match q.kind {
                Kind::Patch => q.radius < p.radius,
                Kind::Fog => q.size < p.size,
                Kind::Cluster | Kind::Ball => false,
            };
        let unseen_part = if is_beside {
            let spots = &q.nodes[..q.count];
            let back: f32 = spots.iter().map(|spot| self.factor_of_fog(q, p, spot, eye)).sum::<f32>() / q.count as f32;
            let share = if q.kind == Kind::Fog { 1.0 } else { 0.25 };
            let whole = share * back * q.size / p.size;
            let less = whole - mean;
            let scale = if mean > 0.0 { (whole / mean).min(1.0) } else { 1.0 };
            link.factors = link.factors.map(|factor| factor * scale + less.max(0.0));
            mean = whole;
            less.abs()
        } else {
            0.0
        };
        let edge = match (p.kind, q.kind) {
            (Kind::Fog, Kind::Fog) => EDGE * self.missed_at_edge(p, q, &link.factors, eye),
            (Kind::Fog, Kind::Patch) => EDGE_OF_SURFACE * self.missed_at_edge(p, q, &link.factors, eye),
            _ => 0.0,
        };
        let mut errors = [
            if p.is_wide() {
                mean * radiosity * (0.1 + 2.0 * near_p * near_p)
            } else {
                let shape = 0.5 * near_p * near_p * mean;
                (2.0 * (middle - mean).abs() + 0.03 * (high - low) + shape + unseen_part + edge) * radiosity
            },
            if q.is_wide() {
                mean * radiosity * (0.1 + 2.0 * near_q * near_q)
            } else {
                // A few points represent a shape that is not a polygon.
                let shape = if q.kind == Kind::Patch && q.corner_count == 0 { 0.5 * near_q * near_q } else { 0.0 };
                mean * (spread * (2.0 * near_q).min(1.0) + shape * radiosity)
            },
        ];
        // A source that is small from here is one of many adjacent ones, whose errors at the receiver are alike and add up.
        if p.kind == Kind::Fog {
            errors[0] /= near_q.max(MANY);
        } else {
            let share = if wide { 0.25 * near_q * near_q } else { mean };
            let many = 1.0 / share.sqrt().clamp(MANY, 1.0);
            errors = errors.map(|error| error * many);
        }
        if self.scene.fog.is_some() {
            // The attenuation by fog varies over the source. A box of fog also has no single distance.
            let thickness = (self.extinction(q) * q.radius).min(1.0);
            let shape = if q.kind == Kind::Fog { near_q * near_q } else { 0.0 };
            errors[1] += mean * radiosity * (shape + 0.3 * near_q * thickness);
        }
        let amount = mean * reach;
        let in_doubt = self.in_doubt(p, allowed);
        if errors[0] + errors[1] > allowed {
            // In the dark, it is worth testing first whether any light arrives.
            let looks = allowed < in_doubt && amount * unproved(LOOK[0] + LOOK[1]) <= in_doubt;
            let is_dark = looks && self.look(p, q, eye, false, true).0[..p.count].iter().all(|&seen| seen == 0.0);
            if is_dark {
                return Verdict::Keep { link: Link { factors: [0.0; 4], ..link }, refused: false };
            }
            if let Some(verdict) = self.cut(p, q, errors) {
                return verdict;
            }
        }
        if amount <= 0.0 {
            return Verdict::Keep { link, refused: false };
        }
        // Occlusion.
        let (seen, refused) = self.look(p, q, eye, amount <= LITTLE * allowed, amount * unproved(LOOK[0]) > in_doubt);
        let least = seen[..p.count].iter().copied().fold(1.0f32, f32::min);
        let most = seen[..p.count].iter().copied().fold(0.0f32, f32::max);
        let hidden = if most == 0.0 { refused } else { 0.5 * (most - least).max(refused) };
        link.factors.iter_mut().zip(seen).for_each(|(factor, seen)| *factor *= seen);
        let error = amount * hidden;
        if error > if most == 0.0 { in_doubt } else { allowed } {
            let sizes = if p.radius > q.radius { [error, 0.0] } else { [0.0, error] };
            return self.cut(p, q, sizes).unwrap_or(Verdict::Keep { link, refused: true });
        }
        Verdict::Keep { link, refused: errors[0] + errors[1] > allowed }
    }

    /// Splits the element that causes the error, or else the other one. `None` if neither can be split.
    fn cut(&self, p: &Element, q: &Element, errors: [f32; 2]) -> Option<Verdict> {
        let order = if errors[0] >= errors[1] {
            [(p, Verdict::Receiver), (q, Verdict::Source)]
        } else {
            [(q, Verdict::Source), (p, Verdict::Receiver)]
        };
        order.into_iter().find(|(element, _)| self.may_cut(element)).map(|(_, verdict)| verdict)
    }

    fn judge_itself(&self, receiver: u32, p: &Element, eye: &mut Eye) -> Verdict {
        let keep = |factors| Verdict::Keep { link: Link { receiver, source: receiver, factors }, refused: false };
        match p.kind {
            Kind::Cluster => Verdict::Both,
            Kind::Patch | Kind::Ball if !self.scene.surfaces[p.surface as usize].is_concave() => Verdict::Drop,
            Kind::Ball => {
                if self.may_cut(p) || !p.is_leaf() {
                    Verdict::Both
                } else {
                    Verdict::Drop
                }
            }
            Kind::Patch => {
                // The inner side of a sphere has a constant kernel. For other surfaces, this is the mean over the other nodes.
                let mut factors = [0.0; 4];
                for (k, factor) in factors.iter_mut().enumerate().take(p.count) {
                    let others = (0..p.count).filter(|&j| j != k);
                    let sum: f32 = others.map(|j| exchange(&p.nodes[k], &p.nodes[j], p.size)).sum();
                    *factor = sum / (p.count - 1) as f32;
                }
                keep(factors)
            }
            Kind::Fog => {
                let to = self.light[receiver as usize];
                let spread = 0.5 * (to.brightest - to.darkest);
                let mut factors = [0.0; 4];
                for (factor, node) in factors.iter_mut().zip(&p.nodes) {
                    *factor = self.factor(p, p, node, eye);
                }
                let thick = self.extinction(p) * p.half.max_element() > THICK;
                if (thick || factors[0] * spread > self.allowed(p, &to)) && self.may_cut(p) {
                    return Verdict::Both;
                }
                keep(factors)
            }
        }
    }

    /// Returns the factor of an element at a point through the fog, without occlusion, as in [`Link::factors`].
    pub fn factor(&self, p: &Element, q: &Element, node: &SurfaceSpot, eye: &mut Eye) -> f32 {
        if q.kind == Kind::Fog {
            return self.factor_of_fog(p, q, node, eye);
        }
        let way = q.center - node.position;
        let mut distance2 = way.length_squared();
        if p.is_wide() || q.is_wide() {
            // Minimum mean distance of the parts of both elements.
            let reach = p.radius + q.radius;
            distance2 = distance2.max(0.25 * reach * reach);
        }
        let distance = distance2.sqrt();
        let near = is_near(distance2, q.radius) && !p.is_wide();
        let polygon_corners = &q.corners[..q.corner_count];
        // Sums over parts of the source, by area and direction from the point.
        let parts = |of: &dyn Fn(&SurfaceSpot, f32) -> f32| -> f32 {
            if near {
                q.nodes[..q.count].iter().map(|part| of(part, q.size / q.count as f32)).sum()
            } else {
                of(&SurfaceSpot { position: q.center, normal: q.normal, ..*node }, q.size)
            }
        };
        let open = match (p.kind, q.kind) {
            (Kind::Patch, Kind::Patch) if q.corner_count > 0 && distance2 < 25.0 * q.radius * q.radius => {
                polygon(node.position, node.normal, polygon_corners)
            }
            (Kind::Patch, Kind::Patch) => parts(&|part, area| exchange(node, part, area)).min(1.0),
            (Kind::Patch, _) => (node.normal.dot(way) / distance).max(0.0) / distance2,
            (Kind::Fog, Kind::Patch) if q.corner_count > 0 && distance2 < 25.0 * q.radius * q.radius => {
                solid_angle(node.position, polygon_corners) / (4.0 * PI)
            }
            (Kind::Fog, Kind::Patch) => 0.25 * parts(&|part, area| facing(node, part, area)),
            (Kind::Fog, _) => return self.factor_at_fog(p, q, distance2, node, eye),
            (_, Kind::Patch) => q.size * (-q.normal.dot(way) / distance).max(0.0) / (PI * distance2),
            _ => 1.0 / distance2,
        };
        if open <= 0.0 || self.scene.haze == Some(0.0) {
            return open.max(0.0);
        }
        if q.kind != Kind::Patch || !near {
            return open * eye.fog(self.scene, node.position, q.center);
        }
        // Near parts are attenuated less: the mean is weighted by the kernel at points of the source, at more points where that
        // matters.
        let (mut weight, mut through) = (0.0, 0.0);
        let mut add = |part: &SurfaceSpot| {
            let kernel = if p.kind == Kind::Patch { exchange(node, part, 1.0) } else { facing(node, part, 1.0) };
            weight += kernel;
            through += kernel * eye.fog(self.scene, node.position, part.position);
        };
        let thickness = self.extinction(q) * q.radius;
        if q.corner_count > 0 && thickness * q.radius > THIN * distance {
            let [a, b, c, d] = q.corners;
            let last = if q.corner_count == 3 { c } else { d };
            for k in 0..64 {
                let mut u = [k % 8, k / 8].map(|k| (k as f32 + 0.5) / 8.0);
                if q.corner_count == 3 && u[0] + u[1] > 1.0 {
                    u = u.map(|u| 1.0 - u);
                }
                let position = a + (b - a) * u[0] + (last - a) * u[1];
                add(&SurfaceSpot { position, ..q.nodes[0] });
            }
        } else {
            q.nodes[..q.count].iter().for_each(add);
        }
        if weight > 0.0 { open * through / weight } else { open * eye.fog(self.scene, node.position, q.center) }
    }

    /// Returns the share of the source's light that reaches each node, and the uncertainty of the shares.
    /// - `little`: one ray is enough;
    /// - `doubt`: cast more rays if the first rays do not reach the source.
    fn look(&self, p: &Element, q: &Element, eye: &mut Eye, little: bool, doubt: bool) -> ([f32; 4], f32) {
        let mut numbers = Numbers::new(&[p.key, q.key]);
        let (mut got, mut cast) = ([0.0f32; 4], [0u32; 4]);
        let (mut hits, mut misses) = (0u32, 0u32);
        // A single ray goes from a random node to a random quarter.
        let first = (numbers.next() * 12.0) as u32;
        for (round, rays) in LOOK.into_iter().enumerate() {
            if round == 1 && (misses == 0 || little || hits == 0 && !doubt) {
                break;
            }
            for k in 0..if little { 1 } else { rays } {
                let turn = k + first;
                let node = turn as usize % p.count;
                for _ in 0..4 {
                    let to = spot(self.arena, self.scene, q, (turn + turn / 4) % 4, &mut numbers, |part| {
                        luminance(self.light[part as usize].radiosity)
                    });
                    let from = if p.is_wide() {
                        spot(self.arena, self.scene, p, turn % 4, &mut numbers, |_| 1.0)
                    } else {
                        p.nodes[node]
                    };
                    let way = to.position - from.position;
                    if faces(&from, way) && faces(&to, -way) {
                        let share = eye.seen(self.scene, &from, &to);
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
        let unsure = if hits == 0 { unproved(total) } else { (share * (1.0 - share)).sqrt() };
        (seen, unsure)
    }
}

/// Returns the share of a source that may be visible although this number of rays missed it.
pub fn unproved(rays: u32) -> f32 {
    0.5 / (rays + 2) as f32
}

fn faces(spot: &SurfaceSpot, way: Vec3A) -> bool {
    spot.normal == Vec3A::ZERO || spot.normal.dot(way) > 0.0
}

/// Returns the form factor of a small surface of area `area` at a spot, from another spot.
pub fn exchange(at: &SurfaceSpot, from: &SurfaceSpot, area: f32) -> f32 {
    let way = from.position - at.position;
    let distance2 = way.length_squared();
    if distance2 <= 0.0 {
        return 0.0;
    }
    area * at.normal.dot(way).max(0.0) * (-from.normal.dot(way)).max(0.0) / (PI * distance2 * distance2)
}

/// Returns the form factor without the cosine of the receiver.
pub fn facing(at: &SurfaceSpot, from: &SurfaceSpot, area: f32) -> f32 {
    let way = from.position - at.position;
    let distance2 = way.length_squared();
    if distance2 <= 0.0 {
        return 0.0;
    }
    area * (-from.normal.dot(way)).max(0.0) / (PI * distance2 * distance2.sqrt())
}

/// Checks whether all of `b` is behind the flat element `a`.
fn unseen(scene: &Scene<'_>, a: &Element, b: &Element) -> bool {
    let flat = match a.kind {
        Kind::Patch => scene.surfaces[a.surface as usize].is_flat(),
        Kind::Cluster => a.normal != Vec3A::ZERO,
        Kind::Ball | Kind::Fog => false,
    };
    let lowest = || if a.kind == Kind::Patch { a.center } else { a.middle - a.normal * a.normal.abs().dot(a.half) };
    flat && b.above(lowest(), a.normal) <= 1e-5 * (a.radius + b.radius)
}
