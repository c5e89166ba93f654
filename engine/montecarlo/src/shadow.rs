//! Visibility and transmittance between a point and a light.

use crate::surface::cross_boundary;
use crate::tracer::TracerCounters;
use femc_emission::LightSample;
use femc_geometry::{Ray, shadow_segment};
use femc_math::Rgb;
use femc_math::glam::Vec3A;
use femc_prepared::Prepared;
use femc_prepared::media::{MediaRay, MediumStack};

/// Maximum number of clear surfaces that a shadow ray may pass. Behind more, the sample counts as bad.
const MAX_CROSSINGS: u32 = 1 << 16;

/// Shadow ray tester with its buffers.
#[derive(Default)]
pub struct ShadowTester {
    media: MediaRay,
}

impl ShadowTester {
    /// Returns the share of the light of `light` that reaches `from` (position, error bound, normal; zero normal: a point in a
    /// medium). It is 0 if something opaque lies between. `medium_stack`: the media at the start of the segment.
    #[inline]
    pub fn visibility<const MEDIA: bool>(
        &mut self,
        scene: &Prepared,
        from: (Vec3A, Vec3A, Vec3A),
        light: &LightSample,
        time: f32,
        medium_stack: &MediumStack,
        counters: &mut TracerCounters,
    ) -> Rgb {
        counters.shadow_rays += 1;
        let ray = shadow_segment(from, (light.position, light.error, light.normal), time);
        if scene.has_clear_surfaces {
            return self.trace_through_clear::<MEDIA>(scene, ray, light, medium_stack, counters);
        }
        if scene.world.occluded(&ray) {
            return Rgb::ZERO;
        }
        self.media_transmittance::<MEDIA>(scene, &ray, medium_stack)
    }

    #[inline]
    fn media_transmittance<const MEDIA: bool>(
        &mut self,
        scene: &Prepared,
        ray: &Ray,
        medium_stack: &MediumStack,
    ) -> Rgb {
        if MEDIA && scene.media.find_intervals(ray.origin, ray.dir, ray.t_max, medium_stack, &mut self.media) {
            scene.media.transmittance(&self.media)
        } else {
            Rgb::ONE
        }
    }

    /// Traces a shadow ray through clear surfaces and keeps track of the media behind them.
    fn trace_through_clear<const MEDIA: bool>(
        &mut self,
        scene: &Prepared,
        mut ray: Ray,
        light: &LightSample,
        medium_stack: &MediumStack,
        counters: &mut TracerCounters,
    ) -> Rgb {
        let mut medium_stack = *medium_stack;
        let mut share = Rgb::ONE;
        for _ in 0..MAX_CROSSINGS {
            let Some(hit) = scene.world.intersect(&ray) else {
                return share * self.media_transmittance::<MEDIA>(scene, &ray, &medium_stack);
            };
            let point = scene.shading_point(&ray, &hit);
            let material = &scene.materials[point.material as usize];
            let back = point.normal.dot(ray.dir) > 0.0;
            let travelled = Ray { t_max: hit.t, ..ray };
            share *= material.crossing[usize::from(back)].straight_through();
            if share == Rgb::ZERO {
                return share;
            }
            share *= self.media_transmittance::<MEDIA>(scene, &travelled, &medium_stack);
            cross_boundary(&mut medium_stack, material, back);
            // The ray is recomputed toward the light: the remaining length, rounded, may reach the light's own surface.
            let from = (point.position, point.error, point.normal);
            ray = shadow_segment(from, (light.position, light.error, light.normal), ray.time);
            counters.shadow_rays += 1;
        }
        Rgb::NAN
    }
}
