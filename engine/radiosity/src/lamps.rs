//! Direct light that elements receive from light sources. A source is evaluated at each point; it is never an element itself.

use crate::element::{Element, PatchForm, Shape};
use crate::fog_factor::attenuated_length;
use crate::form_factor::{polygon_form_factor, solid_angle};
use crate::link::{Oracle, directional_share, occlusion_bound};
use crate::scene::{Lamp, SHUTTER_TIME};
use crate::tuning::{
    BEHIND_HEIGHT, CLUSTER_REACH, CLUSTER_SHARE, DIRECTIONAL_ERROR, DIRECTIONAL_LAMP_ERROR, DIRECTIONAL_SHADOW_RAYS,
    FACE_POINTS, FACING_ATTEMPTS, LAMP_NODES_WEIGHT, LAMP_STRATA, LAMP_VISIBILITY_RAYS, LARGE_SOURCE,
    MAX_LAMP_ABSORBED, MAX_MEMBERS, NEAR_ELEMENT,
};
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

/// A receiver and a light source.
struct LampPair<'a> {
    /// Index of the receiver, and the receiver.
    receiver: u32,
    p: &'a Element,
    /// Index of the source, and the source.
    lamp: u32,
    source: &'a Lamp,
    /// Distance of the centers, m.
    distance: f32,
    /// Radius of the receiver over the distance; at most 1.
    near: f32,
    /// Allowed error of the irradiance, lx.
    allowed: f32,
}

impl LampPair<'_> {
    /// Checks whether the source is large as seen from the element.
    fn is_large(&self) -> bool {
        self.source.radius > LARGE_SOURCE * (self.distance - self.p.radius).max(0.0)
    }

    /// Checks whether the light is computed exactly, so that points of the source only measure the occlusion.
    fn is_exact(&self) -> bool {
        self.is_large() && !self.source.polygons.is_empty() && !self.p.is_directional()
    }
}

/// Points of a source, and the light without occlusion.
struct OpenLight {
    /// Light and points of the source, by node of the receiver.
    points: [[Option<(Rgb, SurfaceSpot)>; (LAMP_STRATA * LAMP_STRATA) as usize]; 4],
    /// Luminance of the points' light, by node.
    weight: [f32; 4],
    /// Light at each node, lx.
    nodes: [Rgb; 4],
    /// Mean and maximum over the nodes, by luminance, lx.
    mean: f32,
    most: f32,
    /// Estimated error, lx.
    error: f32,
}

impl<'a> Oracle<'a> {
    /// Decides on the light of a source at an element.
    pub fn decide_lamp_link(&self, receiver: u32, lamp: u32, tester: &mut VisibilityTester) -> LampLinkDecision {
        let p = &self.arena.elements[receiver as usize];
        if p.radius.is_infinite() {
            // Surfaces and fog together cannot be judged as one.
            return LampLinkDecision::SplitReceiver;
        }
        if self.is_large_cluster(p) && self.may_split(receiver) {
            return LampLinkDecision::SplitReceiver;
        }
        if self.is_behind_receiver(p, lamp) {
            return LampLinkDecision::Drop;
        }
        let pair = self.lamp_pair(receiver, lamp);
        if self.must_split_near(&pair, tester) {
            return LampLinkDecision::SplitReceiver;
        }
        let mut numbers = RandomNumbers::new(&[p.key, u64::from(lamp), 7]);
        let open = self.open_light(&pair, &mut numbers);
        let mut error = open.error;
        let is_whole_cluster = p.is_cluster() && p.is_leaf();
        if error > pair.allowed && is_whole_cluster && self.may_split(receiver) {
            // Only the surfaces that see the source have the error.
            let (seen, bound) = (self.visible_share(p, lamp, tester), occlusion_bound(LAMP_VISIBILITY_RAYS));
            if seen == 0.0 && CLUSTER_SHARE * open.mean * bound <= self.unproved_error(p, pair.allowed) {
                return LampLinkDecision::Drop;
            }
            error *= (seen + bound).min(1.0);
        }
        if error > pair.allowed && self.may_split(receiver) {
            let unproved_error = self.unproved_error(p, pair.allowed);
            let looks =
                pair.allowed < unproved_error && open.mean * occlusion_bound(LAMP_VISIBILITY_RAYS) <= unproved_error;
            return if looks && self.is_occluded(p, lamp, tester) {
                LampLinkDecision::Drop
            } else {
                LampLinkDecision::SplitReceiver
            };
        }
        if open.most <= 0.0 {
            return LampLinkDecision::Drop;
        }
        let (mut light, shares) = self.occluded_light(&pair, &open, &mut numbers, tester);
        if p.is_volume() && pair.near > NEAR_ELEMENT && !pair.is_large() {
            self.add_missed_lamp_light(&pair, &mut light, shares, tester);
        }
        let shares = &shares[..p.node_count()];
        let spread = shares.iter().copied().fold(0.0, f32::max) - shares.iter().copied().fold(1.0, f32::min);
        let is_uneven = 0.5 * spread * open.mean > pair.allowed;
        if is_uneven && self.may_split(receiver) {
            return LampLinkDecision::SplitReceiver;
        }
        let dir = (pair.source.center - p.center).normalize_or(Vec3A::Z);
        let link = LampLink { receiver, lamp, light, dir };
        LampLinkDecision::Keep { link, is_inexact: is_uneven || error > pair.allowed }
    }

    /// Checks whether a cluster without parts is too large for a few rays to represent its surfaces.
    fn is_large_cluster(&self, p: &Element) -> bool {
        self.arena.members(p).len() > MAX_MEMBERS || p.is_cluster() && p.is_leaf() && p.size() > self.unit_area
    }

    fn lamp_pair(&self, receiver: u32, lamp: u32) -> LampPair<'a> {
        let (p, source) = (&self.arena.elements[receiver as usize], &self.scene.lamps[lamp as usize]);
        let distance = (source.center - p.center).length();
        let near = (p.radius / distance.max(1e-20)).min(1.0);
        LampPair {
            receiver,
            p,
            lamp,
            source,
            distance,
            near,
            allowed: self.allowed_error(p, &self.lights[receiver as usize]),
        }
    }

    /// Checks whether a source is behind an element with one normal.
    fn is_behind_receiver(&self, p: &Element, lamp: u32) -> bool {
        let Lamp { center, radius, .. } = self.scene.lamps[lamp as usize];
        let height = |normal: Vec3A| normal.dot(center - p.center) + radius + p.radius * BEHIND_HEIGHT;
        p.single_normal().is_some_and(|normal| height(normal) <= 0.0)
    }

    /// Checks whether an element is too close to a source: a few points do not represent a large element's light from a near or
    /// one-sided source.
    fn must_split_near(&self, pair: &LampPair<'_>, tester: &mut VisibilityTester) -> bool {
        let LampPair { p, near, allowed, .. } = *pair;
        let Lamp { center, intensity, .. } = *pair.source;
        if p.patch().is_some() || near <= NEAR_ELEMENT {
            return false;
        }
        // Surfaces of a cluster may be much closer to the source than its center.
        let reach = match p.shape {
            Shape::Cluster(_) if p.is_leaf() => (pair.distance - p.radius).max(CLUSTER_REACH * p.radius),
            _ => pair.distance.max(0.5 * p.radius),
        };
        let share = if p.is_volume() { 0.25 } else { 1.0 };
        let hidden_part =
            share * intensity * near / (reach * reach) * tester.fog_transmittance(self.scene, p.center, center);
        if hidden_part > allowed && self.may_split(pair.receiver) {
            return true;
        }
        // A box around the source absorbs this share of the source's light in the fog; four points cannot measure that.
        let absorbed = || 4.0 * hidden_part * p.size() * self.extinction(p) / (PI * intensity);
        p.is_volume() && !self.element_budget_exhausted && absorbed() > MAX_LAMP_ABSORBED * self.error
    }

    /// Computes the light without occlusion.
    fn open_light(&self, pair: &LampPair<'_>, numbers: &mut RandomNumbers) -> OpenLight {
        let LampPair { p, lamp, .. } = *pair;
        let (is_large, is_exact, count) = (pair.is_large(), pair.is_exact(), p.node_count());
        let (mut nodes, mut weight) = ([Rgb::ZERO; 4], [0.0f32; 4]);
        let mut points = [[None; (LAMP_STRATA * LAMP_STRATA) as usize]; 4];
        for (index, node) in p.nodes().enumerate() {
            let samples = if is_large { LAMP_STRATA * LAMP_STRATA } else { 1 };
            for (k, point) in points[index].iter_mut().enumerate().take(samples as usize) {
                let u = if is_large {
                    let place = [k as u32 % LAMP_STRATA, k as u32 / LAMP_STRATA];
                    place.map(|at| (at as f32 + numbers.next()) / LAMP_STRATA as f32)
                } else {
                    [0.5; 2]
                };
                *point = self.unoccluded_light(p, &node, lamp, u);
                if let Some((light, _)) = point {
                    *light *= 1.0 / samples as f32;
                    weight[index] += luminance(*light);
                    nodes[index] += *light;
                }
            }
            if is_exact {
                nodes[index] = self.polygon_irradiance(p, &node, lamp);
            }
        }
        let amounts = nodes.map(luminance);
        let amounts = &amounts[..count];
        let mean = amounts.iter().sum::<f32>() / count as f32;
        let most = amounts.iter().copied().fold(0.0, f32::max);
        let least = amounts.iter().copied().fold(f32::INFINITY, f32::min);
        let error = if p.is_directional() {
            directional_share(p) * mean * (DIRECTIONAL_ERROR[0] + DIRECTIONAL_LAMP_ERROR * pair.near * pair.near)
        } else {
            // A linear function has the mean of its nodes at the center, so the difference there is what the points miss.
            let spot = p.center_spot();
            let middle = match (is_exact, is_large) {
                (true, _) => luminance(self.polygon_irradiance(p, &spot, lamp)),
                (_, true) => mean,
                _ => self.unoccluded_light(p, &spot, lamp, [0.5; 2]).map_or(0.0, |(light, _)| luminance(light)),
            };
            (middle - mean).abs() + LAMP_NODES_WEIGHT * (most - least) + self.missed_irradiance(p, lamp)
        };
        OpenLight { points, weight, nodes, mean, most, error }
    }

    /// Returns the light at the nodes with occlusion, and the share that is not occluded.
    fn occluded_light(
        &self,
        pair: &LampPair<'_>,
        open: &OpenLight,
        numbers: &mut RandomNumbers,
        tester: &mut VisibilityTester,
    ) -> ([Rgb; 4], [f32; 4]) {
        let LampPair { p, .. } = *pair;
        let (mut light_at, mut shares) = ([Rgb::ZERO; 4], [1.0f32; 4]);
        for (index, node) in p.nodes().enumerate() {
            let (node, mut got) = (&node, Rgb::ZERO);
            for (light, to) in open.points[index].iter().flatten() {
                if !p.is_directional() {
                    got += *light * tester.transmittance(self.scene, node, to);
                    continue;
                }
                for part in 0..DIRECTIONAL_SHADOW_RAYS {
                    let is_facing = |spot: &SurfaceSpot| {
                        spot.normal == Vec3A::ZERO || spot.normal.dot(to.position - spot.position) > 0.0
                    };
                    let mut sample = || sample_point(self.arena, self.scene, p, part, numbers, |_| 1.0);
                    let from = (0..FACING_ATTEMPTS).map(|_| sample()).find(is_facing);
                    let through = tester.transmittance(self.scene, from.as_ref().unwrap_or(node), to);
                    got += *light * (through / DIRECTIONAL_SHADOW_RAYS as f32);
                }
            }
            if open.weight[index] > 0.0 {
                shares[index] = luminance(got) / open.weight[index];
            }
            // The points' own sum, if there is no exact value.
            light_at[index] = if pair.is_exact() { open.nodes[index] * shares[index] } else { got };
        }
        (light_at, shares)
    }

    /// Spreads the light of a box of fog that the nodes miss over the box.
    fn add_missed_lamp_light(
        &self,
        pair: &LampPair<'_>,
        light: &mut [Rgb; 4],
        shares: [f32; 4],
        tester: &mut VisibilityTester,
    ) {
        let LampPair { p, lamp, source: &Lamp { center, .. }, .. } = *pair;
        let seen = shares.iter().sum::<f32>() * 0.25;
        let through: f32 =
            p.nodes().map(|node| tester.fog_transmittance(self.scene, node.position, center)).sum::<f32>() * 0.25;
        let whole = self.mean_fog_light(p, lamp, center) * (seen / through.max(f32::MIN_POSITIVE)).min(1.0);
        let got = light.iter().sum::<Rgb>() * 0.25;
        let less = whole - got;
        let more = less.max(Rgb::ZERO);
        let scale = (whole / got.max(Rgb::splat(f32::MIN_POSITIVE))).min(Rgb::ONE);
        *light = light.map(|light| light * scale + more);
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
        !self.test_visibility(p, lamp, tester).any(|is_visible| is_visible == Some(true))
    }

    /// Returns the share of the rays from points of an element that face a source that are not occluded; 0 if no points face it.
    fn visible_share(&self, p: &Element, lamp: u32, tester: &mut VisibilityTester) -> f32 {
        let (mut visible, mut all) = (0, 0);
        for is_visible in self.test_visibility(p, lamp, tester).flatten() {
            (visible, all) = (visible + u32::from(is_visible), all + 1);
        }
        if all > 0 { visible as f32 / all as f32 } else { 0.0 }
    }

    /// Tests rays between points of an element and of a source. `None` for points that do not face the source.
    fn test_visibility<'b>(
        &'b self,
        p: &'b Element,
        lamp: u32,
        tester: &'b mut VisibilityTester,
    ) -> impl Iterator<Item = Option<bool>> + 'b {
        let mut numbers = RandomNumbers::new(&[p.key, u64::from(lamp), 8]);
        (0..LAMP_VISIBILITY_RAYS).map(move |part| {
            let from = sample_point(self.arena, self.scene, p, part % 4, &mut numbers, |_| 1.0);
            let u = [numbers.next(), numbers.next()];
            let is_facing =
                |to: &SurfaceSpot| from.normal == Vec3A::ZERO || from.normal.dot(to.position - from.position) > 0.0;
            let to = self.unoccluded_light(p, &from, lamp, u).map(|(_, to)| to).filter(is_facing)?;
            Some(tester.visibility(self.scene, &from, &to) > 0.0)
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
