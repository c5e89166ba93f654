//! Receivers: points at which light is measured without a camera.
//!
//! A receiver weights the radiance from each direction. All weights here integrate to pi over the sphere, so weight over pi is a
//! density of directions: a sample of it has the mean of the radiances as its estimate. Lamps are sampled, too, and combined with
//! the sampled directions as at a surface.

use crate::dimensions as dim;
use crate::path_state::{PathState, PreviousVertex, SegmentOrigin};
use crate::record::{Contribution, Decision, LightTechnique, RecordLevel, Recorder};
use crate::square;
use crate::technique::{MisTechnique, mis_weight};
use crate::tracer::{PathSample, Tracer};
use femc_emission::{DeltaKind, PointContext};
use femc_geometry::{Ray, offset_origin};
use femc_math::glam::Vec3A;
use femc_math::{Frame, Rgb, SampleStream, cross, warp};
use femc_prepared::media::MediumStack;
use std::f32::consts::{FRAC_1_PI, PI};

/// Weight of the radiance from each direction.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Sensitivity {
    /// Illuminance of a plane: the cosine with the normal, 0 below the horizon.
    Plane {
        /// Unit normal.
        normal: Vec3A,
    },
    /// Mean illuminance of the curved side of a small cylinder: the sine with its axis, over pi (\[cie1987\]).
    Cylinder {
        /// Unit axis.
        axis: Vec3A,
    },
    /// Mean illuminance of a small sphere: 1/4.
    Sphere,
    /// Luminance that arrives along one direction.
    Ray {
        /// Unit vector toward the source of the light.
        toward: Vec3A,
    },
}

impl Sensitivity {
    /// Returns the density of [`Self::sample`], 1/sr, for a unit direction toward the light: the weight over pi. A ray has none.
    #[inline]
    pub fn pdf(&self, dir: Vec3A) -> f32 {
        match *self {
            Self::Plane { normal } => warp::cosine_hemisphere_pdf(normal.dot(dir)),
            Self::Cylinder { axis } => cross(axis, dir).length() * (FRAC_1_PI * FRAC_1_PI),
            Self::Sphere => 0.25 * FRAC_1_PI,
            Self::Ray { .. } => 0.0,
        }
    }

    /// Samples a unit direction toward the light from `u` in [0, 1)^2.
    #[inline]
    pub fn sample(&self, u: [f32; 2]) -> Vec3A {
        match *self {
            Self::Plane { normal } => Frame::from_normal(normal).to_world(warp::cosine_hemisphere(u)),
            // The first coordinate of an even point of the disc has the density of the cosine. Given the first, the second is
            // even between its ends.
            Self::Cylinder { axis } => {
                let point = warp::disc(u);
                let height = (1.0 - point.x * point.x).max(0.0).sqrt();
                let azimuth = if height > 0.0 { 0.5 + 0.5 * (point.y / height).clamp(-1.0, 1.0) } else { 0.0 };
                Frame::from_normal(axis).to_world(warp::direction(point.x, azimuth))
            }
            Self::Sphere => warp::sphere(u),
            Self::Ray { toward } => toward,
        }
    }

    /// Returns the side from which light arrives, as context for the choice of a lamp; zero if it arrives from all sides.
    fn lit_side(&self) -> Vec3A {
        if let Self::Plane { normal } = *self { normal } else { Vec3A::ZERO }
    }
}

/// A point at which light is measured.
#[derive(Clone, Copy)]
pub struct Receiver {
    /// Position, prepared frame, m.
    pub position: Vec3A,
    /// Absolute bound per axis of the position's error, m.
    pub error: Vec3A,
    /// Unit normal of the surface on which the point lies, on the side of the light; zero for a point in space.
    pub normal: Vec3A,
    /// Weight of the directions.
    pub sensitivity: Sensitivity,
    /// Media of the closed objects that contain the point.
    pub medium_stack: MediumStack,
}

impl<R: Recorder> Tracer<'_, R> {
    /// Computes sample `sample` of receiver `number`. The mean of the samples is the illuminance by channel, lx, or the luminance,
    /// cd/m2, of a [`Sensitivity::Ray`]. It is not checked; the caller must reject values that are not finite.
    ///
    /// Contributions that the recorder receives have the weight 1 instead of pi. Path lengths count from the receiver: segment 0
    /// ends there.
    /// - `place`: returns the receiver from two random numbers in [0, 1) and the time of the shutter in [0, 1).
    pub fn receive(&mut self, number: u32, sample: u32, place: impl FnOnce([f32; 2], f32) -> Receiver) -> Rgb {
        let record_level = self.recorder.begin_sample(number, sample);
        let mut stream = SampleStream::new(self.settings.seed, self.scene.frame, number, sample);
        stream.seek(dim::FILM);
        let u = stream.next_2d();
        stream.seek(dim::TIME);
        let time = stream.next_1d();
        let receiver = place(u, time);
        let color = match (self.scene.media.is_empty(), record_level) {
            (true, RecordLevel::End) => self.trace_receiver::<false, false>(&receiver, time, stream),
            (false, RecordLevel::End) => self.trace_receiver::<true, false>(&receiver, time, stream),
            (true, RecordLevel::All) => self.trace_receiver::<false, true>(&receiver, time, stream),
            (false, RecordLevel::All) => self.trace_receiver::<true, true>(&receiver, time, stream),
        };
        let weight = if matches!(receiver.sensitivity, Sensitivity::Ray { .. }) { 1.0 } else { PI };
        color * weight
    }

    fn trace_receiver<const MEDIA: bool, const RECORD_ALL: bool>(
        &mut self,
        receiver: &Receiver,
        time: f32,
        stream: SampleStream,
    ) -> Rgb {
        let Receiver { position, error, normal, sensitivity, medium_stack } = *receiver;
        let ray = Ray { origin: position, dir: Vec3A::Z, t_max: f32::INFINITY, time };
        let mut path = PathState::new(ray, SegmentOrigin::Delta, medium_stack, stream);
        // The receiver uses the random numbers of the first ray.
        path.begin_ray();
        let context = self.scene.lights.point_context(position, sensitivity.lit_side(), None);
        let is_ray = matches!(sensitivity, Sensitivity::Ray { .. });
        let direct =
            if is_ray { Rgb::ZERO } else { self.receive_lamp::<MEDIA, RECORD_ALL>(&mut path, receiver, &context) };
        path.stream.seek(path.base + dim::DIRECTION);
        let dir = sensitivity.sample(path.stream.next_2d());
        path.ray.origin = offset_origin(position, error, normal, dir);
        path.ray.dir = dir;
        if !is_ray {
            let origin = SegmentOrigin::Surface { light_context: context, pdf: sensitivity.pdf(dir) };
            path.previous = PreviousVertex { position, origin };
        }
        let PathSample { color, .. } = self.trace::<MEDIA, RECORD_ALL>(path);
        direct + color
    }

    /// Computes the light of a sampled lamp. The weights of the lamps for the receiver are kept.
    fn receive_lamp<const MEDIA: bool, const RECORD_ALL: bool>(
        &mut self,
        path: &mut PathState,
        receiver: &Receiver,
        context: &PointContext,
    ) -> Rgb {
        let (scene, time) = (self.scene, path.ray.time);
        let lights = &scene.lights;
        if lights.is_empty() {
            return Rgb::ZERO;
        }
        lights.weigh(context, &mut self.surface_weights);
        record!(self.recorder.decide(Decision::Lamp, path.bounce, &mut path.stream));
        let number = || dim::draw_48(&mut path.stream, path.base + dim::LIGHT);
        let Some((lamp, probability)) = lights.choose(&self.surface_weights, context, number) else { return Rgb::ZERO };
        record!(self.recorder.decide(Decision::LampPoint, path.bounce, &mut path.stream));
        path.stream.seek(path.base + dim::LIGHT_POINT);
        let u = path.stream.next_2d();
        let Some(light) = lights.sample_light(&scene.world, &scene.textures, lamp, receiver.position, time, u) else {
            return Rgb::ZERO;
        };
        let (pdf, by_direction) = (light.pdf * probability, receiver.sensitivity.pdf(light.dir));
        if by_direction == 0.0 || light.radiance == Rgb::ZERO {
            return Rgb::ZERO;
        }
        let from = (receiver.position, receiver.error, receiver.normal);
        let stack = &receiver.medium_stack;
        let visibility = self.shadow.visibility::<MEDIA>(scene, from, &light, time, stack, &mut self.counters);
        let others = if light.delta == DeltaKind::Position { 0.0 } else { square(by_direction / pdf) };
        let weight = mis_weight(self.settings.single_technique, MisTechnique::Light, others);
        let color = light.radiance * (by_direction * weight / pdf) * visibility;
        if color != Rgb::ZERO {
            record!(self.recorder.contribution(|| Contribution {
                color,
                throughput: Rgb::ONE,
                bounce: path.bounce,
                technique: LightTechnique::NextEvent,
                medium: None,
                light: Some(lamp),
                position: receiver.position,
            }));
        }
        color
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use femc_math::hash::{mix64, unit_f32};
    use femc_stats::testing::chi2::Cells;
    use femc_stats::testing::{sidak, sphere_test};

    const OBLIQUE: Vec3A = Vec3A::new(0.48, -0.6, 0.64);
    const ALL: [Sensitivity; 3] =
        [Sensitivity::Plane { normal: OBLIQUE }, Sensitivity::Cylinder { axis: OBLIQUE }, Sensitivity::Sphere];

    #[test]
    fn directions_have_the_density_that_the_sensitivity_states() {
        for (number, sensitivity) in (0..).zip(ALL) {
            let uniform = |at: u64, axis: u64| unit_f32((mix64(number << 40 | at << 1 | axis) >> 32) as u32);
            let result = sphere_test(
                |dir| sensitivity.pdf(Vec3A::from(dir.map(|x| x as f32))).into(),
                |at| Some(sensitivity.sample([uniform(at, 0), uniform(at, 1)]).to_array().map(f64::from)),
                Cells::default(),
                100_000,
            );
            assert!(result.p > sidak(1e-4, ALL.len()) && result.stray == 0, "{sensitivity:?}: {result:?}");
            assert!((result.integral - 1.0).abs() < 1e-3, "{sensitivity:?}: {result:?}");
        }
    }

    /// A cylinder and a sphere have the mean illuminance of the planes that touch them.
    #[test]
    fn curved_receivers_are_means_of_planes() {
        let planes = |normals: &[Vec3A], dir: Vec3A| {
            let sum: f64 = normals.iter().map(|normal| f64::from(normal.dot(dir).max(0.0))).sum();
            sum / normals.len() as f64
        };
        let frame = Frame::from_normal(OBLIQUE);
        let around: Vec<Vec3A> = (0..1000).map(|at| frame.to_world(warp::direction(0.0, at as f32 / 1000.0))).collect();
        let part = |at: usize, count: usize| (at as f32 + 0.5) / count as f32;
        let sphere: Vec<Vec3A> =
            (0..300 * 300).map(|at| warp::sphere([part(at / 300, 300), part(at % 300, 300)])).collect();
        for dir in (0..20).map(|at| warp::sphere([part(at, 20), (0.618_034 * at as f32).fract()])) {
            for (sensitivity, normals) in [(ALL[1], &around), (ALL[2], &sphere)] {
                let (weight, mean) = (f64::from(sensitivity.pdf(dir) * PI), planes(normals, dir));
                assert!((weight - mean).abs() < 1e-4, "{sensitivity:?}, {dir}: {weight} for {mean}");
            }
        }
    }
}
