//! First surface that a camera ray hits, for the features of a frame.
//!
//! Fog is not a surface, nor is a boundary that only bounds a medium. A clear sheet is passed with a probability equal to the share
//! of the straight-through light in all light that it scatters. A pane counts as itself in some samples, and as the surface behind
//! it in the others, as for light paths. The random number of this decision is the one that chooses the lobe of a path there.

use crate::dimensions as dim;
use crate::scatter::field_light_error;
use crate::surface::SurfaceInteraction;
use femc_geometry::{Hit, Ray};
use femc_math::color::luminance;
use femc_math::glam::Vec3A;
use femc_math::{Rgb, SampleStream};
use femc_prepared::{Crossing, Prepared, ShadingPoint};

/// Maximum number of surfaces that a ray may go through.
const MAX_SURFACES: u32 = 1 << 12;

/// First surface of a camera sample, prepared frame.
#[derive(Clone, Copy, Debug)]
pub struct FirstSurface {
    /// Instance and primitive.
    pub hit: Hit,
    /// Point of the surface.
    pub point: ShadingPoint,
    /// Shading normal on the side of the camera, unit.
    pub normal: Vec3A,
    /// Albedo: the share of light reflected and transmitted, without the straight-through part.
    pub albedo: Rgb,
    /// Estimated root mean square error of the light of the first pass that the surface scatters diffusely toward the camera, cd/m2.
    pub field_error: f32,
}

/// Returns the first surface along `ray`, the ray of a camera sample with these random numbers. `None`: the ray leaves the
/// scene.
pub fn first_surface(scene: &Prepared, ray: &Ray, stream: SampleStream) -> Option<FirstSurface> {
    let surface = find_first_surface(scene, ray, stream)?;
    let SurfaceInteraction { hit, point, crossing, frame, .. } = surface;
    let normal = if frame.normal.dot(ray.dir) > 0.0 { -frame.normal } else { frame.normal };
    let albedo = (surface.bsdf.albedo(surface.wo) - crossing.straight_through()).max(Rgb::ZERO);
    let field_error = scene.field().map_or(0.0, |field| field_light_error(field, &surface));
    Some(FirstSurface { hit, point, normal, albedo, field_error })
}

/// Returns rays through the centers of pixels on a grid over the film, row by row, with the first surfaces that they hit.
/// - `count`: number of rays by axis of the film.
pub(crate) fn first_surfaces_on_grid(
    scene: &Prepared,
    count: [u32; 2],
) -> impl Iterator<Item = (Ray, Option<SurfaceInteraction<'_>>)> {
    let film = scene.camera.film;
    let view = scene.camera.view([0.5; 2], 0.5);
    (0..count[0] * count[1]).map(move |at| {
        let place = [at % count[0], at / count[0]];
        let [x, y] = [0, 1]
            .map(|axis| (u64::from(film[axis]) * u64::from(2 * place[axis] + 1) / u64::from(2 * count[axis])) as u32);
        let pixel = y * film[0] + x;
        let ray = view.ray(scene.camera.center(pixel));
        (ray, find_first_surface(scene, &ray, SampleStream::new(0, scene.frame, pixel, 0)))
    })
}

/// Returns the interaction with the first surface along `ray`, as [`first_surface`] does.
pub(crate) fn find_first_surface<'s>(
    scene: &'s Prepared,
    ray: &Ray,
    mut stream: SampleStream,
) -> Option<SurfaceInteraction<'s>> {
    let mut ray = *ray;
    for number in 0..MAX_SURFACES {
        let hit = scene.world.intersect(&ray)?;
        let surface = SurfaceInteraction::new(scene, &ray, hit, scene.shading_point(&ray, &hit));
        let is_seen = match surface.crossing {
            Crossing::Scatter => true,
            Crossing::Null { .. } => false,
            Crossing::Clear { tint } => {
                stream.seek(dim::ray_base(number) + dim::LOBE);
                stream.next_1d() * luminance(surface.bsdf.albedo(surface.wo)) >= luminance(tint)
            }
        };
        if is_seen {
            return Some(surface);
        }
        ray = surface.ray_behind(&ray);
    }
    None
}
