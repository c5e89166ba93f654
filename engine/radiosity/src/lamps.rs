//! Direct light that elements receive from light sources. A source is evaluated at each point; it is never an element itself.

use crate::element::{Element, PatchForm, Shape};
use crate::fog_factor::{FACE_POINTS, attenuated_length};
use crate::form_factor::{polygon_form_factor, solid_angle};
use crate::link::{Oracle, occlusion_bound};
use crate::scene::{Lamp, SHUTTER_TIME};
use crate::visibility::{RandomNumbers, VisibilityTester, sample_point};
use femc_field::SurfaceSpot;
use femc_math::Rgb;
use femc_math::color::luminance;
use femc_math::glam::Vec3A;
use std::f32::consts::PI;

/// Light of one source that an element receives.
#[derive(Clone, Copy, Debug)]
pub struct LampLink {
    /// Index of the receiver.
    pub receiver: u32,
    /// Index of the source.
    pub lamp: u32,
    /// Irradiance at each node; for a wide element, on a surface that faces the source.
    pub light: [Rgb; 4],
    /// Unit direction toward the source, for a wide element.
    pub dir: Vec3A,
}

/// Decision on the light of a source at an element.
#[derive(Clone, Copy, Debug)]
pub enum LampLinkDecision {
    Drop,
    Keep { link: LampLink, is_inexact: bool },
    SplitReceiver,
}

/// Number of rays that test whether any light of a source arrives.
const VISIBILITY_RAYS: u32 = 16;
/// Number of points by axis on a source that is large as seen from the element.
const STRATA: u32 = 2;
/// Minimum radius of a large source, as a share of the distance.
const LARGE_SOURCE: f32 = 0.1;
/// Minimum radius of an element near a source, as a share of the distance.
const NEAR_ELEMENT: f32 = 0.3;
/// Maximum share of a source's light that needs no closer test, times the error.
const MAX_ABSORBED: f32 = 0.3;

impl Oracle<'_> {
    /// Decides on the light of a source at an element.
    pub fn decide_lamp_link(&self, receiver: u32, lamp: u32, tester: &mut VisibilityTester) -> LampLinkDecision {
        let p = &self.arena.elements[receiver as usize];
        if p.radius.is_infinite() {
            // Surfaces and fog together cannot be judged as one.
            return LampLinkDecision::SplitReceiver;
        }
        let Lamp { center, radius, intensity, .. } = self.scene.lamps[lamp as usize];
        let has_one_normal = match &p.shape {
            Shape::Patch(patch) => self.scene.surfaces[patch.part.surface as usize].is_flat(),
            Shape::Cluster(cluster) => cluster.normal.is_some(),
            Shape::Curved(_) | Shape::Volume(_) => false,
        };
        if has_one_normal && p.normal().dot(center - p.center) + radius + p.radius * 1e-5 <= 0.0 {
            return LampLinkDecision::Drop;
        }
        let way = center - p.center;
        let distance = way.length();
        let wide = p.is_directional();
        // A few points do not represent a large element's light from a near or one-sided source.
        let close = (p.radius / distance.max(1e-20)).min(1.0);
        let reach = distance.max(0.5 * p.radius);
        let share = if p.is_volume() { 0.25 } else { 1.0 };
        let hidden_part =
            share * intensity * close / (reach * reach) * tester.fog_transmittance(self.scene, p.center, center);
        let allowed = self.allowed_error(p, &self.lights[receiver as usize]);
        if p.patch().is_none() && close > NEAR_ELEMENT && hidden_part > allowed && self.may_split(p) {
            return LampLinkDecision::SplitReceiver;
        }
        // A box around the source absorbs this share of the source's light in the fog; four points cannot measure that.
        if p.is_volume() && close > NEAR_ELEMENT && !self.element_budget_exhausted {
            let taken = 4.0 * hidden_part * p.size() * self.extinction(p) / (PI * intensity);
            if taken > MAX_ABSORBED * self.error {
                return LampLinkDecision::SplitReceiver;
            }
        }
        let large = radius > LARGE_SOURCE * (distance - p.radius).max(0.0);
        let mut link = LampLink { receiver, lamp, light: [Rgb::ZERO; 4], dir: way.normalize_or(Vec3A::Z) };
        let mut numbers = RandomNumbers::new(&[p.key, u64::from(lamp), 7]);
        // Light without occlusion: by points of the source, or exactly, if the points only measure the occlusion.
        let exact = large && !self.scene.lamps[lamp as usize].polygons.is_empty() && !wide;
        let mut open = [Rgb::ZERO; 4];
        let mut weight = [0.0f32; 4];
        let mut points = [[None; (STRATA * STRATA) as usize]; 4];
        for node in 0..p.node_count() {
            let count = if large { STRATA * STRATA } else { 1 };
            for (k, point) in points[node].iter_mut().enumerate().take(count as usize) {
                let u = if large {
                    let place = [k as u32 % STRATA, k as u32 / STRATA];
                    place.map(|at| (at as f32 + numbers.next()) / STRATA as f32)
                } else {
                    [0.5; 2]
                };
                *point = self.unoccluded_light(p, &p.node(node), lamp, u);
                if let Some((light, _)) = point {
                    *light *= 1.0 / count as f32;
                    weight[node] += luminance(*light);
                    open[node] += *light;
                }
            }
            if exact {
                open[node] = self.polygon_irradiance(p, &p.node(node), lamp);
            }
        }
        let amounts = open.map(luminance);
        let mean = amounts[..p.node_count()].iter().sum::<f32>() / p.node_count() as f32;
        let most = amounts[..p.node_count()].iter().copied().fold(0.0, f32::max);
        let least = amounts[..p.node_count()].iter().copied().fold(f32::INFINITY, f32::min);
        let near = (p.radius / distance.max(1e-20)).min(1.0);
        let error = match &p.shape {
            Shape::Cluster(_) | Shape::Curved(_) => mean * (0.1 + 4.0 * near * near),
            // A linear function has the mean of its nodes at the center, so the difference there is what the points miss.
            _ => {
                let spot = p.center_spot();
                let middle = match (exact, large) {
                    (true, _) => luminance(self.polygon_irradiance(p, &spot, lamp)),
                    (_, true) => mean,
                    _ => self.unoccluded_light(p, &spot, lamp, [0.5; 2]).map_or(0.0, |(light, _)| luminance(light)),
                };
                (middle - mean).abs() + 0.1 * (most - least) + self.missed_irradiance(p, lamp)
            }
        };
        if error > allowed && self.may_split(p) {
            let unproved_error = self.unproved_error(p, allowed);
            let looks = allowed < unproved_error && mean * occlusion_bound(VISIBILITY_RAYS) <= unproved_error;
            return if looks && self.is_occluded(p, lamp, tester) {
                LampLinkDecision::Drop
            } else {
                LampLinkDecision::SplitReceiver
            };
        }
        if most <= 0.0 {
            return LampLinkDecision::Drop;
        }
        let mut shares = [1.0f32; 4];
        for node in 0..p.node_count() {
            let mut got = Rgb::ZERO;
            for (light, to) in points[node].iter().flatten() {
                let from = if wide {
                    let part = numbers.next();
                    let spot = sample_point(self.arena, self.scene, p, (part * 4.0) as u32, &mut numbers, |_| 1.0);
                    if spot.normal != Vec3A::ZERO && spot.normal.dot(to.position - spot.position) <= 0.0 {
                        p.node(node)
                    } else {
                        spot
                    }
                } else {
                    p.node(node)
                };
                got += *light * tester.transmittance(self.scene, &from, to);
            }
            if weight[node] > 0.0 {
                shares[node] = luminance(got) / weight[node];
            }
            // The points' own sum, if there is no exact value.
            link.light[node] = if exact { open[node] * shares[node] } else { got };
        }
        if p.is_volume() && close > NEAR_ELEMENT && !large {
            // Light of the box that the nodes miss is spread over it.
            let seen = shares.iter().sum::<f32>() * 0.25;
            let through: f32 =
                p.nodes().map(|node| tester.fog_transmittance(self.scene, node.position, center)).sum::<f32>() * 0.25;
            let whole = self.mean_fog_light(p, lamp, center) * (seen / through.max(f32::MIN_POSITIVE)).min(1.0);
            let got = link.light.into_iter().sum::<Rgb>() * 0.25;
            let less = whole - got;
            let more = less.max(Rgb::ZERO);
            let scale = (whole / got.max(Rgb::splat(f32::MIN_POSITIVE))).min(Rgb::ONE);
            link.light = link.light.map(|light| light * scale + more);
        }
        let hidden = &shares[..p.node_count()];
        let spread = hidden.iter().copied().fold(0.0, f32::max) - hidden.iter().copied().fold(1.0, f32::min);
        let refused = 0.5 * spread * mean > allowed;
        if refused && self.may_split(p) {
            return LampLinkDecision::SplitReceiver;
        }
        LampLinkDecision::Keep { link, is_inexact: refused || error > allowed }
    }

    /// Returns the mean light over a box of fog from a source, treated as a point, through the fog, as a quarter of the light from
    /// all directions. It integrates over the directions through the box's faces: lengths up to the far faces minus those up to the
    /// near ones.
    fn mean_fog_light(&self, p: &Element, lamp: u32, source: Vec3A) -> Rgb {
        let extinction = self.extinction(p);
        let mut sum = Rgb::ZERO;
        for axis in 0..3 {
            for side in [-1.0, 1.0] {
                let [a, b] = [1, 2].map(|step| (axis + step) % 3);
                let area = 4.0 * p.half_extent[a] * p.half_extent[b] / (FACE_POINTS * FACE_POINTS) as f32;
                for k in 0..FACE_POINTS * FACE_POINTS {
                    let [x, y] =
                        [k % FACE_POINTS, k / FACE_POINTS].map(|k| (2 * k + 1) as f32 / FACE_POINTS as f32 - 1.0);
                    let mut place = Vec3A::ZERO;
                    (place[axis], place[a], place[b]) = (side, x, y);
                    let position = p.center + p.half_extent * place;
                    let way = position - source;
                    let Some((light, _)) =
                        self.unoccluded_light(p, &SurfaceSpot { position, ..SurfaceSpot::default() }, lamp, [0.5; 2])
                    else {
                        continue;
                    };
                    // Light that leaves through the face counts positive, entering light negative.
                    sum +=
                        light * (area * side * way[axis] / way.length() * attenuated_length(extinction, way.length()));
                }
            }
        }
        (sum / p.size()).max(Rgb::ZERO)
    }

    /// Returns the irradiance of a patch from a source, treated as a point, that the nodes miss, lx. A source close to a large
    /// patch is far from all nodes. The total is known from the solid angle of the patch.
    fn missed_irradiance(&self, p: &Element, lamp: u32) -> f32 {
        let Some(patch) = p.patch() else { return 0.0 };
        let Lamp { center, intensity, .. } = self.scene.lamps[lamp as usize];
        let mut whole = solid_angle(center, patch.corners());
        if patch.form == PatchForm::Bent {
            // Chords of a curve, in either order.
            let reversed: [Vec3A; 4] = std::array::from_fn(|k| patch.corners()[3 - k]);
            whole = whole.max(solid_angle(center, &reversed));
        }
        let at = |node: &SurfaceSpot| {
            let way = center - node.position;
            let distance2 = way.length_squared();
            node.normal.dot(way).max(0.0) / (distance2 * distance2.sqrt()).max(f32::MIN_POSITIVE)
        };
        let mean = patch.nodes().iter().map(at).sum::<f32>() / patch.nodes().len() as f32;
        intensity * (whole / patch.part.area - mean).abs()
    }

    /// Checks whether all rays between points of an element and of a source are occluded.
    fn is_occluded(&self, p: &Element, lamp: u32, tester: &mut VisibilityTester) -> bool {
        let mut numbers = RandomNumbers::new(&[p.key, u64::from(lamp), 8]);
        !(0..VISIBILITY_RAYS).any(|part| {
            let from = sample_point(self.arena, self.scene, p, part % 4, &mut numbers, |_| 1.0);
            let u = [numbers.next(), numbers.next()];
            let to = self.unoccluded_light(p, &from, lamp, u);
            to.is_some_and(|(_, to)| tester.visibility(self.scene, &from, &to) > 0.0)
        })
    }

    /// Returns the unoccluded light at a spot from a polygon of constant radiance.
    fn polygon_irradiance(&self, p: &Element, spot: &SurfaceSpot, lamp: u32) -> Rgb {
        let of = |(corners, luminance): &(Vec<Vec3A>, Rgb)| match &p.shape {
            Shape::Volume(_) => *luminance * (0.25 * solid_angle(spot.position, corners)),
            _ => *luminance * (PI * polygon_form_factor(spot.position, spot.normal, corners)),
        };
        self.scene.lamps[lamp as usize].polygons.iter().map(of).sum()
    }

    /// Returns the unoccluded light at a spot from a point of a source, and that point.
    fn unoccluded_light(&self, p: &Element, spot: &SurfaceSpot, lamp: u32, u: [f32; 2]) -> Option<(Rgb, SurfaceSpot)> {
        let prepared = self.scene.prepared;
        let sample =
            prepared.lights.sample_light(&prepared.world, &prepared.textures, lamp, spot.position, SHUTTER_TIME, u)?;
        let share = match &p.shape {
            Shape::Patch(_) => spot.normal.dot(sample.dir).max(0.0),
            Shape::Volume(_) => 0.25,
            Shape::Cluster(_) | Shape::Curved(_) => 1.0,
        };
        let light = sample.radiance * (share / sample.pdf);
        (share > 0.0 && light.is_finite())
            .then_some((light, SurfaceSpot { position: sample.position, error: sample.error, normal: sample.normal }))
    }
}
