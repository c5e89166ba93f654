//! Direct light that elements receive from light sources. A source is evaluated at each point; it is never an element itself.

use crate::element::{Element, Kind};
use crate::fog_factor::{FACE, along};
use crate::form_factor::{polygon, solid_angle};
use crate::link::{Judge, unproved};
use crate::scene::{Lamp, TIME};
use crate::visibility::{Eye, Numbers, spot};
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
pub enum LampVerdict {
    Drop,
    Keep { link: LampLink, refused: bool },
    Receiver,
}

/// Number of rays that test whether any light of a source arrives.
const LOOK: u32 = 16;
/// Number of points by axis on a source that is large as seen from the element.
const STRATA: u32 = 2;
/// Minimum radius of a large source, as a share of the distance.
const LARGE: f32 = 0.1;
/// Minimum radius of an element near a source, as a share of the distance.
const NEAR: f32 = 0.3;
/// Maximum share of a source's light that needs no closer test, times the error.
const TAKEN: f32 = 0.3;

impl Judge<'_> {
    /// Decides on the light of a source at an element.
    pub fn judge_lamp(&self, receiver: u32, lamp: u32, eye: &mut Eye) -> LampVerdict {
        let p = &self.arena.elements[receiver as usize];
        if p.radius.is_infinite() {
            // Surfaces and fog together cannot be judged as one.
            return LampVerdict::Receiver;
        }
        let Lamp { center, radius, intensity, .. } = self.scene.lamps[lamp as usize];
        let flat = p.kind == Kind::Patch && self.scene.surfaces[p.surface as usize].is_flat();
        if (flat || p.kind == Kind::Cluster && p.normal != Vec3A::ZERO)
            && p.normal.dot(center - p.center) + radius + p.radius * 1e-5 <= 0.0
        {
            return LampVerdict::Drop;
        }
        let way = center - p.center;
        let distance = way.length();
        let wide = p.is_wide();
        // A few points do not represent a large element's light from a near or one-sided source.
        let close = (p.radius / distance.max(1e-20)).min(1.0);
        let reach = distance.max(0.5 * p.radius);
        let share = if p.kind == Kind::Fog { 0.25 } else { 1.0 };
        let hidden_part = share * intensity * close / (reach * reach) * eye.fog(self.scene, p.center, center);
        let allowed = self.allowed(p, &self.light[receiver as usize]);
        if p.kind != Kind::Patch && close > NEAR && hidden_part > allowed && self.may_cut(p) {
            return LampVerdict::Receiver;
        }
        // A box around the source absorbs this share of the source's light in the fog; four points cannot measure that.
        if p.kind == Kind::Fog && close > NEAR && !self.full {
            let taken = 4.0 * hidden_part * p.size * self.extinction(p) / (PI * intensity);
            if taken > TAKEN * self.error {
                return LampVerdict::Receiver;
            }
        }
        let large = radius > LARGE * (distance - p.radius).max(0.0);
        let mut link = LampLink { receiver, lamp, light: [Rgb::ZERO; 4], dir: way.normalize_or(Vec3A::Z) };
        let mut numbers = Numbers::new(&[p.key, u64::from(lamp), 7]);
        // Light without occlusion: by points of the source, or exactly, if the points only measure the occlusion.
        let exact = large && !self.scene.lamps[lamp as usize].polygons.is_empty() && !wide;
        let mut open = [Rgb::ZERO; 4];
        let mut weight = [0.0f32; 4];
        let mut points = [[None; (STRATA * STRATA) as usize]; 4];
        for node in 0..p.count {
            let count = if large { STRATA * STRATA } else { 1 };
            for (k, point) in points[node].iter_mut().enumerate().take(count as usize) {
                let u = if large {
                    let place = [k as u32 % STRATA, k as u32 / STRATA];
                    place.map(|at| (at as f32 + numbers.next()) / STRATA as f32)
                } else {
                    [0.5; 2]
                };
                *point = self.arriving(p, &p.nodes[node], lamp, u);
                if let Some((light, _)) = point {
                    *light *= 1.0 / count as f32;
                    weight[node] += luminance(*light);
                    open[node] += *light;
                }
            }
            if exact {
                open[node] = self.exactly(p, &p.nodes[node], lamp);
            }
        }
        let amounts = open.map(luminance);
        let mean = amounts[..p.count].iter().sum::<f32>() / p.count as f32;
        let most = amounts[..p.count].iter().copied().fold(0.0, f32::max);
        let least = amounts[..p.count].iter().copied().fold(f32::INFINITY, f32::min);
        let near = (p.radius / distance.max(1e-20)).min(1.0);
        let error = match p.kind {
            Kind::Cluster | Kind::Ball => mean * (0.1 + 4.0 * near * near),
            // A linear function has the mean of its nodes at the center, so the difference there is what the points miss.
            _ => {
                let spot = SurfaceSpot { position: p.center, normal: p.normal, error: p.nodes[0].error };
                let middle = match (exact, large) {
                    (true, _) => luminance(self.exactly(p, &spot, lamp)),
                    (_, true) => mean,
                    _ => self.arriving(p, &spot, lamp, [0.5; 2]).map_or(0.0, |(light, _)| luminance(light)),
                };
                (middle - mean).abs() + 0.1 * (most - least) + self.missed(p, lamp)
            }
        };
        if error > allowed && self.may_cut(p) {
            let in_doubt = self.in_doubt(p, allowed);
            let looks = allowed < in_doubt && mean * unproved(LOOK) <= in_doubt;
            return if looks && self.is_dark(p, lamp, eye) { LampVerdict::Drop } else { LampVerdict::Receiver };
        }
        if most <= 0.0 {
            return LampVerdict::Drop;
        }
        let mut shares = [1.0f32; 4];
        for node in 0..p.count {
            let mut got = Rgb::ZERO;
            for (light, to) in points[node].iter().flatten() {
                let from = if wide {
                    let part = numbers.next();
                    let spot = spot(self.arena, self.scene, p, (part * 4.0) as u32, &mut numbers, |_| 1.0);
                    if spot.normal != Vec3A::ZERO && spot.normal.dot(to.position - spot.position) <= 0.0 {
                        p.nodes[node]
                    } else {
                        spot
                    }
                } else {
                    p.nodes[node]
                };
                got += *light * eye.through(self.scene, &from, to);
            }
            if weight[node] > 0.0 {
                shares[node] = luminance(got) / weight[node];
            }
            // The points' own sum, if there is no exact value.
            link.light[node] = if exact { open[node] * shares[node] } else { got };
        }
        if p.kind == Kind::Fog && close > NEAR && !large {
            // Light of the box that the nodes miss is spread over it.
            let seen = shares.iter().sum::<f32>() * 0.25;
            let through: f32 =
                p.nodes.iter().map(|node| eye.fog(self.scene, node.position, center)).sum::<f32>() * 0.25;
            let whole = self.mean_of_fog(p, lamp, center) * (seen / through.max(f32::MIN_POSITIVE)).min(1.0);
            let got = link.light.into_iter().sum::<Rgb>() * 0.25;
            let less = whole - got;
            let more = less.max(Rgb::ZERO);
            let scale = (whole / got.max(Rgb::splat(f32::MIN_POSITIVE))).min(Rgb::ONE);
            link.light = link.light.map(|light| light * scale + more);
        }
        let hidden = &shares[..p.count];
        let spread = hidden.iter().copied().fold(0.0, f32::max) - hidden.iter().copied().fold(1.0, f32::min);
        let refused = 0.5 * spread * mean > allowed;
        if refused && self.may_cut(p) {
            return LampVerdict::Receiver;
        }
        LampVerdict::Keep { link, refused: refused || error > allowed }
    }

    /// Returns the mean light over a box of fog from a source, treated as a point, through the fog, as a quarter of the light from
    /// all directions. It integrates over the directions through the box's faces: lengths up to the far faces minus those up to the
    /// near ones.
    fn mean_of_fog(&self, p: &Element, lamp: u32, source: Vec3A) -> Rgb {
        let extinction = self.extinction(p);
        let mut sum = Rgb::ZERO;
        for axis in 0..3 {
            for side in [-1.0, 1.0] {
                let [a, b] = [1, 2].map(|step| (axis + step) % 3);
                let area = 4.0 * p.half[a] * p.half[b] / (FACE * FACE) as f32;
                for k in 0..FACE * FACE {
                    let [x, y] = [k % FACE, k / FACE].map(|k| (2 * k + 1) as f32 / FACE as f32 - 1.0);
                    let mut place = Vec3A::ZERO;
                    (place[axis], place[a], place[b]) = (side, x, y);
                    let position = p.center + p.half * place;
                    let way = position - source;
                    let Some((light, _)) =
                        self.arriving(p, &SurfaceSpot { position, ..SurfaceSpot::default() }, lamp, [0.5; 2])
                    else {
                        continue;
                    };
                    // Light that leaves through the face counts positive, entering light negative.
                    sum += light * (area * side * way[axis] / way.length() * along(extinction, way.length()));
                }
            }
        }
        (sum / p.size).max(Rgb::ZERO)
    }

    /// Returns the irradiance of a patch from a source, treated as a point, that the nodes miss, lx. A source close to a large
    /// patch is far from all nodes. The total is known from the solid angle of the patch.
    fn missed(&self, p: &Element, lamp: u32) -> f32 {
        if p.kind != Kind::Patch {
            return 0.0;
        }
        let Lamp { center, intensity, .. } = self.scene.lamps[lamp as usize];
        let mut corners = p.corners;
        let is_curved = p.corner_count == 0;
        let corners = &mut corners[..if is_curved { 4 } else { p.corner_count }];
        let mut whole = solid_angle(center, corners);
        if is_curved {
            // Chords of a curve, in either order.
            corners.reverse();
            whole = whole.max(solid_angle(center, corners));
        }
        let at = |node: &SurfaceSpot| {
            let way = center - node.position;
            let distance2 = way.length_squared();
            node.normal.dot(way).max(0.0) / (distance2 * distance2.sqrt()).max(f32::MIN_POSITIVE)
        };
        let mean = p.nodes[..p.count].iter().map(at).sum::<f32>() / p.count as f32;
        intensity * (whole / p.size - mean).abs()
    }

    /// Checks whether all rays between points of an element and of a source are occluded.
    fn is_dark(&self, p: &Element, lamp: u32, eye: &mut Eye) -> bool {
        let mut numbers = Numbers::new(&[p.key, u64::from(lamp), 8]);
        !(0..LOOK).any(|part| {
            let from = spot(self.arena, self.scene, p, part % 4, &mut numbers, |_| 1.0);
            let u = [numbers.next(), numbers.next()];
            let to = self.arriving(p, &from, lamp, u);
            to.is_some_and(|(_, to)| eye.seen(self.scene, &from, &to) > 0.0)
        })
    }

    /// Returns the unoccluded light at a spot from a polygon of constant radiance.
    fn exactly(&self, p: &Element, spot: &SurfaceSpot, lamp: u32) -> Rgb {
        let of = |(corners, luminance): &(Vec<Vec3A>, Rgb)| match p.kind {
            Kind::Fog => *luminance * (0.25 * solid_angle(spot.position, corners)),
            _ => *luminance * (PI * polygon(spot.position, spot.normal, corners)),
        };
        self.scene.lamps[lamp as usize].polygons.iter().map(of).sum()
    }

    /// Returns the unoccluded light at a spot from a point of a source, and that point.
    fn arriving(&self, p: &Element, spot: &SurfaceSpot, lamp: u32, u: [f32; 2]) -> Option<(Rgb, SurfaceSpot)> {
        let prepared = self.scene.prepared;
        let sample = prepared.lights.sample_light(&prepared.world, &prepared.textures, lamp, spot.position, TIME, u)?;
        let share = match p.kind {
            Kind::Patch => spot.normal.dot(sample.dir).max(0.0),
            Kind::Fog => 0.25,
            Kind::Cluster | Kind::Ball => 1.0,
        };
        let light = sample.radiance * (share / sample.pdf);
        (share > 0.0 && light.is_finite())
            .then_some((light, SurfaceSpot { position: sample.position, error: sample.error, normal: sample.normal }))
    }
}
