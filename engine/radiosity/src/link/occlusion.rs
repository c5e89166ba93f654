//! Occlusion of links: rays between the elements.

use super::{LinkDecision, Oracle, Pair};
use crate::tuning::{FACING_ATTEMPTS, ONE_RAY_LIGHT, VISIBILITY_RAYS};
use crate::visibility::{RandomNumbers, VisibilityTester, sample_point};
use femc_field::SurfaceSpot;
use femc_math::color::luminance;
use femc_math::glam::Vec3A;

/// Shares of a source's light that reach the receiver.
#[derive(Clone, Copy, Debug)]
struct Visibility {
    /// Share at each node of the receiver.
    nodes: [f32; 4],
    /// Uncertainty of the shares.
    uncertainty: f32,
}

/// Number of rays of a test.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum RayCount {
    /// One ray.
    One,
    /// The first test. More rays follow if the first rays reach the source only in part.
    Few,
    /// Like `Few`, but more rays follow also if none of the first rays reaches the source.
    RecheckUnseen,
}

impl Oracle<'_> {
    /// Checks whether a source whose light cannot be estimated well is occluded. In the dark it is worth testing this before a
    /// split.
    /// - `amount`: irradiance from the source without occlusion, lx.
    pub(super) fn is_dark(&self, pair: &Pair<'_>, amount: f32, tester: &mut VisibilityTester) -> bool {
        let unproved = self.unproved_error(pair.p, pair.allowed);
        let bound = amount * occlusion_bound(VISIBILITY_RAYS[0] + VISIBILITY_RAYS[1]);
        pair.allowed < unproved && bound <= unproved && {
            let seen = self.cast_visibility_rays(pair, RayCount::RecheckUnseen, tester);
            seen.nodes[..pair.p.node_count()].iter().all(|&seen| seen == 0.0)
        }
    }

    /// Decides on a link whose light is known without occlusion.
    /// - `amount`: greatest irradiance from the source without occlusion, lx;
    /// - `is_inexact`: whether the factors have more than the allowed error.
    pub(super) fn decide_by_occlusion(
        &self,
        pair: &Pair<'_>,
        (mut factors, amount): ([f32; 4], f32),
        is_inexact: bool,
        tester: &mut VisibilityTester,
    ) -> LinkDecision {
        let Pair { p, q, allowed, .. } = *pair;
        let unproved_error = self.unproved_error(p, allowed);
        let rays = if amount <= ONE_RAY_LIGHT * allowed {
            RayCount::One
        } else if amount * occlusion_bound(VISIBILITY_RAYS[0]) > unproved_error {
            RayCount::RecheckUnseen
        } else {
            RayCount::Few
        };
        let Visibility { nodes: seen, uncertainty } = self.cast_visibility_rays(pair, rays, tester);
        let at_nodes = &seen[..p.node_count()];
        let (least, most) = at_nodes.iter().fold((1.0f32, 0.0f32), |(least, most), &s| (least.min(s), most.max(s)));
        let hidden = if most == 0.0 { uncertainty } else { 0.5 * (most - least).max(uncertainty) };
        factors.iter_mut().zip(seen).for_each(|(factor, seen)| *factor *= seen);
        let error = amount * hidden;
        if error > if most == 0.0 { unproved_error } else { allowed } {
            let sizes = if p.radius > q.radius { [error, 0.0] } else { [0.0, error] };
            return self.choose_split(pair, sizes).unwrap_or_else(|| pair.keep(factors, true));
        }
        pair.keep(factors, is_inexact)
    }

    fn cast_visibility_rays(&self, pair: &Pair<'_>, count: RayCount, tester: &mut VisibilityTester) -> Visibility {
        let Pair { p, q, .. } = *pair;
        let mut numbers = RandomNumbers::new(&[p.key, q.key]);
        let (mut got, mut cast) = ([0.0f32; 4], [0u32; 4]);
        let (mut hits, mut misses) = (0u32, 0u32);
        // A single ray goes from a random node to a random quarter.
        let first = (numbers.next() * 12.0) as u32;
        for (round, rays) in VISIBILITY_RAYS.into_iter().enumerate() {
            let is_sure = misses == 0 || count == RayCount::One || hits == 0 && count != RayCount::RecheckUnseen;
            if round == 1 && is_sure {
                break;
            }
            for k in 0..if count == RayCount::One { 1 } else { rays } {
                let turn = k + first;
                let node = turn as usize % p.node_count();
                let Some(share) = self.cast_visibility_ray(pair, (turn, node), &mut numbers, tester) else { continue };
                got[node] += share;
                cast[node] += 1;
                *if share > 0.0 { &mut hits } else { &mut misses } += 1;
            }
        }
        let total: u32 = cast.iter().sum();
        if total == 0 {
            return Visibility { nodes: [0.0; 4], uncertainty: 0.0 };
        }
        let mean = got.iter().sum::<f32>() / total as f32;
        let nodes = [0, 1, 2, 3].map(|k| if cast[k] > 0 { got[k] / cast[k] as f32 } else { mean });
        let share = hits as f32 / total as f32;
        // A source that no ray has reached may still be visible.
        let uncertainty = if hits == 0 { occlusion_bound(total) } else { (share * (1.0 - share)).sqrt() };
        Visibility { nodes, uncertainty }
    }

    /// Casts a ray from a node, or from a point of a receiver with light by direction. Returns the share of light that reaches it;
    /// `None` if no chosen points face each other.
    /// - `turn`: number of the ray, which selects the strata.
    fn cast_visibility_ray(
        &self,
        pair: &Pair<'_>,
        (turn, node): (u32, usize),
        numbers: &mut RandomNumbers,
        tester: &mut VisibilityTester,
    ) -> Option<f32> {
        let Pair { p, q, .. } = *pair;
        for _ in 0..FACING_ATTEMPTS {
            let to = sample_point(self.arena, self.scene, q, (turn + turn / 4) % 4, numbers, |part| {
                luminance(self.lights[part as usize].radiosity)
            });
            let from = if p.is_directional() {
                sample_point(self.arena, self.scene, p, turn % 4, numbers, |_| 1.0)
            } else {
                p.node(node)
            };
            let way = to.position - from.position;
            if faces(&from, way) && faces(&to, -way) {
                return Some(tester.visibility(self.scene, &from, &to));
            }
        }
        None
    }
}

/// Returns the share of a source that may be visible although this number of rays missed it.
pub fn occlusion_bound(rays: u32) -> f32 {
    0.5 / (rays + 2) as f32
}

fn faces(spot: &SurfaceSpot, way: Vec3A) -> bool {
    spot.normal == Vec3A::ZERO || spot.normal.dot(way) > 0.0
}
