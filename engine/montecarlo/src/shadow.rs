//! Visibility and transmittance between a point and a light.

use crate::path::{Counters, cross};
use femc_emission::LightSample;
use femc_geometry::{Ray, segment};
use femc_math::Rgb;
use femc_math::glam::Vec3A;
use femc_prepared::Prepared;
use femc_prepared::media::{Inside, MediaRay};

/// Maximum number of clear surfaces that a shadow ray may pass. Behind more, the sample counts as bad.
const MAX_CROSSINGS: u32 = 1 << 16;

/// Shadow ray tester with its buffers.
#[derive(Default)]
pub struct Shadow {
    media: MediaRay,
}

impl Shadow {
    /// Returns the share of the light of `light` that reaches `from` (position, error bound, normal; zero normal: a point in a
    /// medium). It is 0 if something opaque lies between. `inside`: the media at the start of the segment.
    #[inline]
    pub fn visibility<const MEDIA: bool>(
        &mut self,
        scene: &Prepared,
        from: (Vec3A, Vec3A, Vec3A),
        light: &LightSample,
        time: f32,
        inside: &Inside,
        counters: &mut Counters,
    ) -> Rgb {
        counters.shadow_rays += 1;
        let ray = segment(from, (light.position, light.error, light.normal), time);
        if scene.has_clear_surfaces {
            return self.through::<MEDIA>(scene, ray, light, inside, counters);
        }
        if scene.world.occluded(&ray) {
            return Rgb::ZERO;
        }
        self.attenuation::<MEDIA>(scene, &ray, inside)
    }

    #[inline]
    fn attenuation<const MEDIA: bool>(&mut self, scene: &Prepared, ray: &Ray, inside: &Inside) -> Rgb {
        if MEDIA && scene.media.along(ray.origin, ray.dir, ray.t_max, inside, &mut self.media) {
            scene.media.transmittance(&self.media)
        } else {
            Rgb::ONE
        }
    }

    /// Traces a shadow ray through clear surfaces and keeps track of the media behind them.
    fn through<const MEDIA: bool>(
        &mut self,
        scene: &Prepared,
        mut ray: Ray,
        light: &LightSample,
        inside: &Inside,
        counters: &mut Counters,
    ) -> Rgb {
        let mut inside = *inside;
        let mut share = Rgb::ONE;
        for _ in 0..MAX_CROSSINGS {
            let Some(hit) = scene.world.intersect(&ray) else {
                return share * self.attenuation::<MEDIA>(scene, &ray, &inside);
            };
            let point = scene.surface(&ray, &hit);
            let material = &scene.materials[point.material as usize];
            let back = point.normal.dot(ray.dir) > 0.0;
            let travelled = Ray { t_max: hit.t, ..ray };
            share *= material.crossing[usize::from(back)].unbent();
            if share == Rgb::ZERO {
                return share;
            }
            share *= self.attenuation::<MEDIA>(scene, &travelled, &inside);
            cross(&mut inside, material, back);
            // The ray is recomputed toward the light: the remaining length, rounded, may reach the light's own surface.
            let from = (point.position, point.error, point.normal);
            ray = segment(from, (light.position, light.error, light.normal), ray.time);
            counters.shadow_rays += 1;
        }
        Rgb::NAN
    }
}
