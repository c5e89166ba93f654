//! Light that travels straight from a small emitter to the camera.

use crate::record::{Contribution, LightTechnique, RecordLevel, Recorder};
use crate::square;
use crate::technique::{MisTechnique, mis_weight};
use crate::tracer::{PixelFilter, Tracer};
use femc_math::Rgb;
use femc_math::glam::Vec3A;
use femc_prepared::camera::View;
use femc_prepared::camera_emitters::PixelEmitters;

/// Number of points that a sample draws on the small emitters visible in its pixel. Such pixels are few, and partly occluded lamps
/// would make them the noisiest of all.
pub(crate) const CAMERA_NEXT_EVENTS: u32 = 4;

/// A camera sample of a pixel that sees small emitters.
pub(crate) struct CameraSample<'a, F> {
    /// Emitters visible in the pixel.
    pub emitters: PixelEmitters<'a>,
    /// Camera with the sample's point on the lens.
    pub view: &'a View,
    /// Time in the shutter.
    pub time: f32,
    /// Center of the pixel on the film, pixels.
    pub center: [f32; 2],
    /// Filter of the film.
    pub filter: F,
    /// Events that the recorder receives.
    pub record_level: RecordLevel,
}

impl<R: Recorder> Tracer<'_, R> {
    /// Samples light that travels straight from a small emitter to the camera, with one of [`CAMERA_NEXT_EVENTS`] points.
    /// - `number`: chooses the emitter, `u` the point; in [0, 1).
    pub(crate) fn sample_camera_emitter(
        &mut self,
        sample: &CameraSample<'_, impl PixelFilter>,
        number: f32,
        u: [f32; 2],
    ) -> Rgb {
        let scene = self.scene;
        let &CameraSample { emitters, view, time, center, filter, record_level } = sample;
        let choice = emitters.choose(number, center);
        // Point, its position on the film, and the density of that, 1/pixel2.
        let drawn = match &choice.part {
            Some(part) => part.sample(u).and_then(|film_position| {
                let dir = view.ray(film_position).dir;
                let point = scene.lights.sample_toward(&scene.textures, choice.light, view.origin, dir)?;
                Some((point, film_position, 1.0 / part.area()))
            }),
            None => scene
                .lights
                .sample_light(&scene.world, &scene.textures, choice.light, view.origin, time, u)
                .and_then(|point| {
                    let (film_position, _) = view.project(point.position)?;
                    Some((point, film_position, point.pdf * view.solid_angle(film_position)))
                }),
        };
        let Some((point, film_position, pdf)) = drawn else { return Rgb::ZERO };
        let density = filter.density([film_position[0] - center[0], film_position[1] - center[1]]);
        if density <= 0.0 || point.radiance == Rgb::ZERO {
            return Rgb::ZERO;
        }
        let pdf = CAMERA_NEXT_EVENTS as f32 * choice.probability * pdf;
        let weight = mis_weight(self.settings.single_technique, MisTechnique::Light, square(density / pdf));
        let from = (view.origin, Vec3A::ZERO, Vec3A::ZERO);
        let counters = &mut self.counters;
        let visibility = if scene.media.is_empty() {
            self.shadow.visibility::<false>(scene, from, &point, time, &scene.camera_medium_stack, counters)
        } else {
            self.shadow.visibility::<true>(scene, from, &point, time, &scene.camera_medium_stack, counters)
        };
        let color = point.radiance * visibility * (weight * density / pdf);
        if record_level == RecordLevel::All {
            self.recorder.contribution(|| Contribution {
                color,
                throughput: Rgb::ONE,
                bounce: 0,
                technique: LightTechnique::CameraNextEvent,
                light: Some(choice.light),
                position: point.position,
            });
        }
        color
    }
}
