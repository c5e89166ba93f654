//! Random walks with diffuse reflections: they show which points light, or a view, can reach.
//!
//! Walks tell whether a space is closed and whether light gets into it, but not how much. Their random numbers are fixed, so a
//! scene always gives the same answer.

use super::{Hit, Ray, Scope};
use femc_math::glam::DVec3;

/// Number of reflections of a walk.
const BOUNCES: u32 = 6;
/// Maximum number of surfaces that one segment passes through.
const MAX_CROSSINGS: u32 = 64;

/// End of a walk.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum WalkEnd {
    /// The walk left the scene.
    Escaped,
    /// The walk was still among surfaces.
    Inside,
}

/// A small random number generator (splitmix64). It gives the same numbers on every machine.
pub(crate) struct SplitMix64(pub u64);

impl SplitMix64 {
    /// Returns a random number in [0, 1).
    pub fn next_f64(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut x = self.0;
        x = (x ^ (x >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        x = (x ^ (x >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((x ^ (x >> 31)) >> 11) as f64 / (1u64 << 53) as f64
    }

    /// Returns a random unit vector, uniform over the sphere.
    pub fn direction(&mut self) -> DVec3 {
        loop {
            let p = 2.0 * DVec3::new(self.next_f64(), self.next_f64(), self.next_f64()) - 1.0;
            let length = p.length_squared();
            if (1e-6..=1.0).contains(&length) {
                return p / length.sqrt();
            }
        }
    }
}

/// Walks along `ray` and its reflections. `visit` receives each surface that stops the walk, the point just before it, and its
/// normal there.
pub(crate) fn random_walk(
    scope: &Scope<'_>,
    mut ray: Ray,
    rng: &mut SplitMix64,
    visit: &mut dyn FnMut(&Hit, DVec3, DVec3),
) -> WalkEnd {
    for _ in 0..BOUNCES {
        let Some(hit) = next_stopping_hit(scope, &mut ray, rng) else { return WalkEnd::Escaped };
        let normal = if hit.is_front(&ray) { hit.normal } else { -hit.normal };
        let position = ray.origin + hit.distance * ray.dir + 2.0 * scope.offset() * normal;
        visit(&hit, position, normal);
        let dir = (normal + 0.999 * rng.direction()).normalize_or(normal);
        ray = Ray { origin: position, dir, far: f64::INFINITY };
    }
    WalkEnd::Inside
}

/// Returns the next surface that stops the walk. A surface that lets light through is passed with probability 1/2.
fn next_stopping_hit(scope: &Scope<'_>, ray: &mut Ray, rng: &mut SplitMix64) -> Option<Hit> {
    for _ in 0..MAX_CROSSINGS {
        let hit = scope.first_hit(ray)?;
        let is_passed = hit.is_invisible(scope, ray) || (hit.lets_through(scope) && rng.next_f64() < 0.5);
        if !is_passed {
            return Some(hit);
        }
        ray.origin += (hit.distance + scope.offset()) * ray.dir;
    }
    None
}

impl Scope<'_> {
    /// Returns the surfaces between two points that are invisible to the ray, in order; `None` if another surface stops the light.
    pub fn invisible_backs_between(&self, from: DVec3, to: DVec3) -> Option<Vec<Hit>> {
        let mut passed = Vec::new();
        let mut ray = Ray { origin: from, dir: (to - from).try_normalize()?, far: 0.0 };
        for _ in 0..MAX_CROSSINGS {
            ray.far = ray.origin.distance(to) - 4.0 * self.offset();
            let Some(hit) = self.first_hit(&ray) else { return Some(passed) };
            if hit.is_invisible(self, &ray) {
                passed.push(hit);
            } else if !hit.lets_through(self) {
                return None;
            }
            ray.origin += (hit.distance + self.offset()) * ray.dir;
        }
        None
    }
}
