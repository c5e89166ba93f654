//! Visibility and transmittance between a point and a light.

use crate::path::Counters;
use femc_emission::LightSample;
use femc_geometry::{Ray, offset_origin, segment};
use femc_math::Rgb;
use femc_math::glam::Vec3A;
use femc_prepared::media::{Inside, MediaRay};
use femc_prepared::{Crossing, Prepared};

/// Interfaces that a shadow ray may cross.
const MAX_CROSSINGS: u32 = 64;

/// Shadow rays and their buffers.
#[derive(Default)]
pub struct Shadow {
    media: MediaRay,
}

impl Shadow {
    /// Share of the light of `light` that reaches `from` (position, error bound, normal; zero normal: a point in a medium),
    /// 0 where something opaque is between. `inside`: the media at the start of the segment.
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
        if MEDIA && scene.has_null_crossings {
            return self.through(scene, ray, inside, counters);
        }
        if scene.world.occluded(&ray) {
            return Rgb::ZERO;
        }
        if MEDIA { self.attenuation(scene, &ray, inside) } else { Rgb::ONE }
    }

    fn attenuation(&mut self, scene: &Prepared, ray: &Ray, inside: &Inside) -> Rgb {
        if scene.media.along(ray.origin, ray.dir, ray.t_max, inside, &mut self.media) {
            scene.media.transmittance(&self.media)
        } else {
            Rgb::ONE
        }
    }

    /// A shadow ray that passes index-matched interfaces and keeps track of the media behind them.
    fn through(&mut self, scene: &Prepared, mut ray: Ray, inside: &Inside, counters: &mut Counters) -> Rgb {
        let mut inside = *inside;
        let mut share = Rgb::ONE;
        for _ in 0..MAX_CROSSINGS {
            let Some(hit) = scene.world.intersect(&ray) else {
                return share * self.attenuation(scene, &ray, &inside);
            };
            let point = scene.surface(&ray, &hit);
            let material = &scene.materials[point.material as usize];
            let back = point.normal.dot(ray.dir) > 0.0;
            let Crossing::Null { tint } = material.crossing[usize::from(back)] else { return Rgb::ZERO };
            let travelled = Ray { t_max: hit.t, ..ray };
            share *= tint * self.attenuation(scene, &travelled, &inside);
            if let Some(medium) = material.inside {
                if back { inside.remove(medium) } else { inside.push(medium) }
            }
            let origin = offset_origin(point.position, point.error, point.normal, ray.dir);
            let rest = ray.t_max - (origin - ray.origin).dot(ray.dir);
            if rest <= 0.0 {
                return share;
            }
            ray = Ray { origin, t_max: rest, ..ray };
            counters.shadow_rays += 1;
        }
        Rgb::ZERO
    }
}
