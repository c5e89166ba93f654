//! The first surface that a ray from the camera meets: what features of a frame are about.
//!
//! Fog is no surface, nor is a boundary that is there to bound a medium alone. A clear sheet is looked through with the share of the light
//! that goes straight through it among all that it scatters: a pane is itself in some samples, and what is behind it in the others, as it
//! is for light paths. The number that decides is the one that chooses the lobe of a path there.

use crate::dimensions as dim;
use crate::path::{bsdf_at, local_wo};
use femc_geometry::{Hit, Ray, offset_origin};
use femc_math::color::luminance;
use femc_math::glam::Vec3A;
use femc_math::{Rgb, SampleStream};
use femc_prepared::{Crossing, Prepared, SurfacePoint};

/// Surfaces that a ray may go through.
const MOST: u32 = 1 << 12;

/// What was met, prepared frame.
#[derive(Clone, Copy, Debug)]
pub struct FirstSurface {
    /// Instance and primitive.
    pub hit: Hit,
    /// The point.
    pub point: SurfacePoint,
    /// Shading normal on the side of the camera, unit.
    pub normal: Vec3A,
    /// Share of the light that it scatters: all that it reflects and transmits, but for what goes straight through.
    pub albedo: Rgb,
}

/// The first surface along `ray`, the ray of a camera sample with these random numbers; `None`: it leaves the scene.
pub fn first_surface(scene: &Prepared, ray: &Ray, mut stream: SampleStream) -> Option<FirstSurface> {
    let mut ray = *ray;
    for number in 0..MOST {
        let hit = scene.world.intersect(&ray)?;
        let point = scene.surface(&ray, &hit);
        let material = &scene.materials[point.material as usize];
        let back = point.normal.dot(ray.dir) > 0.0;
        let crossing = material.crossing[usize::from(back)];
        let bsdf = bsdf_at(scene, material, &point);
        let (frame, wo) = local_wo(material, &point, ray.dir);
        let all = bsdf.albedo(wo);
        let is_seen = match crossing {
            Crossing::Scatter => true,
            Crossing::Null { .. } => false,
            Crossing::Clear { tint } => {
                stream.seek(dim::ray(number) + dim::LOBE);
                stream.next_1d() * luminance(all) >= luminance(tint)
            }
        };
        if is_seen {
            let normal = if frame.normal.dot(ray.dir) > 0.0 { -frame.normal } else { frame.normal };
            let albedo = (all - crossing.unbent()).max(Rgb::ZERO);
            return Some(FirstSurface { hit, point, normal, albedo });
        }
        ray.origin = offset_origin(point.position, point.error, point.normal, ray.dir);
    }
    None
}
