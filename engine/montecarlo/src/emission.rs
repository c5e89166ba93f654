//! Emission of a surface that the path hit.

use crate::camera_next_event::CAMERA_NEXT_EVENTS;
use crate::path_state::{PreviousVertex, SegmentOrigin};
use crate::square;
use crate::technique::{MisTechnique, mis_weight};
use crate::tracer::Tracer;
use femc_geometry::Ray;
use femc_math::Rgb;
use femc_prepared::ShadingPoint;

impl<R> Tracer<'_, R> {
    /// Returns the emission of a surface that the path hit, weighted against the other techniques that could have found it.
    #[inline]
    pub(crate) fn emitter_hit(&self, ray: &Ray, point: &ShadingPoint, previous: &PreviousVertex) -> Rgb {
        let (scene, light) = (self.scene, point.light);
        let radiance = scene.lights.radiance(
            &scene.world,
            &scene.textures,
            light,
            ray.time,
            point.normal,
            -ray.dir,
            point.parametric,
        );
        if radiance == Rgb::ZERO {
            return radiance;
        }
        let at = (point.position, point.normal);
        let light_pdf = || scene.lights.pdf(&scene.world, light, previous.position, ray.time, at, ray.dir);
        let others = match &previous.origin {
            SegmentOrigin::Delta => return radiance,
            SegmentOrigin::Camera { pixel, film_position, film_pdf, solid_angle } => {
                let emitters = scene.camera_emitters.get(*pixel);
                let choice = emitters.and_then(|seen| seen.find(light, scene.camera.center(*pixel)));
                let Some(choice) = choice else { return radiance };
                let pdf = match &choice.part {
                    Some(part) if part.contains(*film_position) => 1.0 / part.area(),
                    Some(_) => return radiance,
                    None => light_pdf() * solid_angle,
                };
                square(CAMERA_NEXT_EVENTS as f32 * choice.probability * pdf / film_pdf)
            }
            SegmentOrigin::Surface { light_context, pdf } => {
                square(light_pdf() * scene.lights.probability(&self.surface_weights, light_context, light) / pdf)
            }
            SegmentOrigin::Medium { collision, phase_pdf } => {
                let distance = self.fog_before.airlight_pdf(scene, light, ray.time, &collision.event);
                square(light_pdf() * distance / (phase_pdf * collision.event.pdf))
            }
        };
        radiance * mis_weight(self.settings.single_technique, MisTechnique::Scatter, others)
    }
}
