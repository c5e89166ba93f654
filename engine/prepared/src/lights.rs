//! Light sources of a frame, with their placements and textures.

use crate::compile::{Emitter, EmitterShape, NONE};
use crate::texture::Texture;
use femc_emission::light::{
    Cone, Parallelogram, PhotometricPoint, PhotometricSolid, Ring, Solid, Sphere, Torus, Triangle, UniformRectangle,
};
use femc_emission::{
    AngularProfile, BsdfLobes, Emission, EmissionCone, EmittingSides, IntensityDistribution, Light, LightBounds,
    LightSample, LightSampleContext, LightSampler, LightWeights, PhotometryError, PhotometryKind, PointContext,
    SegmentContext,
};
use femc_geometry::{Aabb, World};
use femc_math::Rgb;
use femc_math::elementary::double::cbrt;
use femc_math::glam::{Affine3, Affine3A, DAffine3, DVec3, Vec2, Vec3A};
use femc_scene::{Facing, Luminaire, Material, Opening, Photometry, PhotometryType, Scene, Shape};
use std::sync::Arc;

/// Optical depth beyond which fog hides almost everything; light from there is not sampled deliberately.
const MAX_OPTICAL_DEPTH: f32 = 10.0;

/// All light sources. A light is fixed in the prepared frame, or in the frame of an instance that moves during the shutter.
#[derive(Debug, Default)]
pub struct Lights {
    lights: Vec<Light>,
    instances: Vec<LightInstance>,
    /// Centers of the lights, in the frames in which they are stored.
    centers: Vec<Vec3A>,
    /// Bounds of the lights over the shutter, prepared frame, and their flux, lm.
    bounds_and_power: Vec<(Aabb, f32)>,
    sampler: LightSampler,
    /// Maximum length of a ray segment that is considered when a light is chosen for it, m.
    reach: f32,
}

/// Carrier and texture of a light.
#[derive(Clone, Copy, Debug)]
pub struct LightInstance {
    /// Moving instance that carries it, or `NONE`.
    pub moving_instance: u32,
    /// Texture of its emission, or `NONE`.
    pub texture: u32,
    /// Texture coordinates at the corners of a triangle.
    pub uv: [Vec2; 3],
    /// Maximum distance of the traced surface from the light's surface, m, per axis.
    pub position_error: f32,
}

impl Default for LightInstance {
    fn default() -> Self {
        Self { moving_instance: NONE, texture: NONE, uv: [Vec2::ZERO; 3], position_error: 0.0 }
    }
}

/// A point on the surface of a light, prepared frame.
#[derive(Clone, Copy, Debug)]
pub struct EmitterPoint {
    /// Index of the light.
    pub light: u32,
    /// Geometric normal, unit, on the front side.
    pub normal: Vec3A,
    /// Parametric coordinates on the light's primitive.
    pub parametric: [f32; 2],
}

impl Lights {
    /// Combines lights with their entries (same length and order) in `world`.
    /// - `extinction`: extinction of the media at a point of the prepared frame, 1/m.
    pub fn new(
        lights: Vec<Light>,
        instances: Vec<LightInstance>,
        world: &World,
        extinction: impl Fn(Vec3A) -> f32,
    ) -> Self {
        debug_assert_eq!(lights.len(), instances.len());
        let centers = lights.iter().map(Light::center).collect();
        let bounds: Vec<_> = lights
            .iter()
            .zip(&instances)
            .map(|(light, instance)| bounds(light, instance, world, &extinction))
            .collect();
        let reach = 4.0 * world.bounds().size().max_element();
        let reach = if reach.is_finite() && reach > 0.0 { reach } else { 1e6 };
        let bounds_and_power =
            bounds.iter().map(|light| (Aabb { min: light.low, max: light.high }, light.power)).collect();
        Self { sampler: LightSampler::new(&bounds), lights, instances, centers, bounds_and_power, reach }
    }

    /// Returns whether there are no lights.
    pub fn is_empty(&self) -> bool {
        self.instances.is_empty()
    }

    /// Returns the number of lights.
    pub fn len(&self) -> usize {
        self.instances.len()
    }

    /// Returns the bounds of a light over the whole shutter, prepared frame, m.
    pub fn bounds(&self, light: u32) -> Aabb {
        self.bounds_and_power[light as usize].0
    }

    /// Returns the luminous flux of a light, lm.
    pub fn power(&self, light: u32) -> f32 {
        self.bounds_and_power[light as usize].1
    }

    /// Returns the maximum luminous flux of a light with its texture, lm. A texture's values may be above 1.
    pub fn max_power(&self, textures: &[Texture], light: u32) -> f32 {
        let texture = match self.instances[light as usize].texture {
            NONE => 1.0,
            texture => textures[texture as usize].brightest().max(1.0),
        };
        texture * self.power(light)
    }

    /// Returns whether rays can hit a light, because it is not a point.
    pub(crate) fn can_be_hit(&self, light: u32) -> bool {
        !matches!(self.lights[light as usize], Light::PhotometricPoint(_))
    }

    /// Describes a point that receives light.
    /// - `normal`: normal of the side that light is scattered from; zero if light counts from all sides.
    /// - `lobes`: scattering lobes at the point, if they are known.
    #[inline]
    pub fn point_context(&self, position: Vec3A, normal: Vec3A, lobes: Option<BsdfLobes>) -> PointContext {
        PointContext { position, normal, lobes }
    }

    /// Describes a ray segment that receives light.
    /// - `range`: first and last distance, m.
    /// - `fog`: its extinction, 1/m, and the parameter of its phase function
    ///   ([`Media::mean_properties`](crate::media::Media::mean_properties)).
    /// - `angles`: angles at which each light is evaluated.
    #[inline]
    pub fn segment_context(
        &self,
        origin: Vec3A,
        dir: Vec3A,
        range: (f32, f32),
        fog: (f32, f32),
        angles: u32,
    ) -> SegmentContext {
        let (extinction, phase) = fog;
        let reach = self.reach.min(MAX_OPTICAL_DEPTH / extinction.max(f32::MIN_POSITIVE));
        let (start, end) = range;
        SegmentContext { origin, dir, range: (start, end.min(start + reach)), end, angles, extinction, phase }
    }

    /// Computes weights of all lights for a point or segment. Later choices read them from `weights`.
    #[inline]
    pub fn weigh(&self, context: &impl LightSampleContext, weights: &mut LightWeights) {
        self.sampler.weigh(context, weights);
    }

    /// Chooses a light for a weighed point or segment. Returns (index, probability), or `None` if no light can reach it.
    /// - `u`: draws a number in [0, 1). A sole light needs none.
    #[inline]
    pub fn choose(
        &self,
        weights: &LightWeights,
        context: &impl LightSampleContext,
        u: impl FnOnce() -> f64,
    ) -> Option<(u32, f32)> {
        self.sampler.choose(weights, context, u)
    }

    /// Returns the probability that [`Lights::choose`] chooses a light.
    #[inline]
    pub fn probability(&self, weights: &LightWeights, context: &impl LightSampleContext, light: u32) -> f32 {
        self.sampler.probability(weights, context, light)
    }

    /// Returns all lights, for sampling directions that pass near them.
    #[inline]
    pub fn sampler(&self) -> &LightSampler {
        &self.sampler
    }

    /// Returns the intensities of a stationary light with measured photometry along some directions (unit, away from it), cd;
    /// `None` for other lights.
    #[inline]
    pub(crate) fn intensities(&self, light: u32, directions: impl FnOnce() -> [Vec3A; 8]) -> Option<[f32; 8]> {
        let source = &self.lights[light as usize];
        let stands = self.instances[light as usize].moving_instance == NONE;
        (stands && source.has_intensity()).then(|| directions().map(|dir| source.intensity(dir).unwrap_or(0.0)))
    }

    /// Samples a point on one light. The density is that of the point alone.
    #[inline]
    pub fn sample_light(
        &self,
        world: &World,
        textures: &[Texture],
        light: u32,
        reference: Vec3A,
        time: f32,
        u: [f32; 2],
    ) -> Option<LightSample> {
        let instance = &self.instances[light as usize];
        let mut sample = if instance.moving_instance == NONE {
            self.lights[light as usize].sample(reference, u)?
        } else {
            let pose = world.pose_at(instance.moving_instance, time);
            sample_moving(&self.lights[light as usize], &pose, reference, u)?
        };
        sample.error += instance.position_error;
        if instance.texture != NONE {
            sample.radiance *= instance.texel(textures, sample.uv);
        }
        Some(sample)
    }

    /// Returns the corners of a stationary flat polygonal light, prepared frame, m; empty for other lights.
    pub(crate) fn corners(&self, light: u32) -> Vec<Vec3A> {
        let stands = self.instances[light as usize].moving_instance == NONE;
        if stands { self.lights[light as usize].corners() } else { Vec::new() }
    }

    /// Returns a stationary flat polygonal light that is uniformly bright in position and direction; `None` for other lights. The
    /// result is its corners, counter-clockwise about the front normal, the luminance of its sides, and whether the back emits,
    /// too.
    pub fn uniform_polygon(&self, light: u32) -> Option<(Vec<Vec3A>, Rgb, bool)> {
        let (normal, emission) = match &self.lights[light as usize] {
            Light::Triangle(triangle) => (triangle.normal(), triangle.emission),
            Light::Parallelogram(parallelogram) => (parallelogram.normal(), parallelogram.emission),
            _ => return None,
        };
        let mut corners = self.corners(light);
        let even = emission.profile == AngularProfile::Lambertian && self.instances[light as usize].texture == NONE;
        if corners.len() < 3 || !even {
            return None;
        }
        if femc_math::cross(corners[1] - corners[0], corners[2] - corners[0]).dot(normal) < 0.0 {
            corners.reverse();
        }
        let both = emission.sides == EmittingSides::Two;
        Some((corners, emission.radiance(1.0), both))
    }

    /// Returns the sole light of the scene if it is a stationary rectangle of the same radiance everywhere, and the maximum distance
    /// of the traced surface from it, m.
    pub fn sole_rectangle(&self) -> Option<(UniformRectangle, f32)> {
        let sole = self.sampler.sole()? as usize;
        let instance = &self.instances[sole];
        let Light::Parallelogram(parallelogram) = &self.lights[sole] else { return None };
        let is_plain = instance.moving_instance == NONE && instance.texture == NONE;
        let rectangle = parallelogram.uniform_rectangle().filter(|_| is_plain)?;
        Some((rectangle, instance.position_error))
    }

    /// Samples the point of a stationary flat light that is seen from `reference` in direction `dir` (unit), with density 1.
    #[inline]
    pub fn sample_toward(&self, textures: &[Texture], light: u32, reference: Vec3A, dir: Vec3A) -> Option<LightSample> {
        let instance = &self.instances[light as usize];
        let mut sample = self.lights[light as usize].sample_in_direction(reference, dir)?;
        sample.error += instance.position_error;
        if instance.texture != NONE {
            sample.radiance *= instance.texel(textures, sample.uv);
        }
        Some(sample)
    }

    /// Returns the density, 1/sr, with which [`Lights::sample_light`] samples a point that a ray hit, without the light's
    /// probability.
    #[inline]
    pub fn pdf(
        &self,
        world: &World,
        light: u32,
        reference: Vec3A,
        time: f32,
        point: (Vec3A, Vec3A),
        dir: Vec3A,
    ) -> f32 {
        let instance = &self.instances[light as usize];
        let source = &self.lights[light as usize];
        if instance.moving_instance == NONE {
            return source.pdf(reference, point.0, point.1, dir);
        }
        let back = inverse(&world.pose_at(instance.moving_instance, time));
        source.pdf(
            back.transform_point3a(reference),
            back.transform_point3a(point.0),
            back.transform_vector3a(point.1).normalize_or_zero(),
            back.transform_vector3a(dir).normalize_or_zero(),
        )
    }

    /// Returns the radiance, cd/m2, that a light emits from a point in `dir` (unit, away from it).
    #[inline]
    pub fn radiance(
        &self,
        world: &World,
        textures: &[Texture],
        &EmitterPoint { light, normal, parametric }: &EmitterPoint,
        dir: Vec3A,
        time: f32,
    ) -> Rgb {
        let instance = &self.instances[light as usize];
        let source = &self.lights[light as usize];
        let mut radiance = if instance.moving_instance == NONE {
            source.radiance(dir, normal)
        } else {
            let pose = world.pose_at(instance.moving_instance, time);
            let back = inverse(&pose);
            let local = |v: Vec3A| back.transform_vector3a(v).normalize_or_zero();
            source.radiance(local(dir), local(normal)) * radiance_scale(source, pose_scale(&pose))
        };
        if instance.texture != NONE {
            radiance *= instance.texel(textures, parametric);
        }
        radiance
    }

    /// Returns the center of a light, prepared frame, m.
    #[inline]
    pub fn center(&self, world: &World, light: u32, time: f32) -> Vec3A {
        let center = self.centers[light as usize];
        match self.instances[light as usize].moving_instance {
            NONE => center,
            carrier => world.pose_at(carrier, time).transform_point3a(center),
        }
    }
}

impl LightInstance {
    fn texel(&self, textures: &[Texture], parametric: [f32; 2]) -> Rgb {
        let [b1, b2] = parametric;
        let uv = self.uv[0] * (1.0 - b1 - b2) + self.uv[1] * b1 + self.uv[2] * b2;
        textures[self.texture as usize].lookup(uv).max(Rgb::ZERO)
    }
}

/// Returns the inverse, with scalar arithmetic: glam's wide types fuse products where the compiler may use FMA.
#[inline]
fn inverse(pose: &Affine3A) -> Affine3A {
    Affine3::from(*pose).inverse().into()
}

/// Samples a point on a light that a moving instance carries. Poses are similarities: densities per steradian stay the same,
/// lengths scale.
fn sample_moving(light: &Light, pose: &Affine3A, reference: Vec3A, u: [f32; 2]) -> Option<LightSample> {
    let back = inverse(pose);
    let mut sample = light.sample(back.transform_point3a(reference), u)?;
    let scale = pose_scale(pose);
    sample.dir = pose.transform_vector3a(sample.dir).normalize_or_zero();
    sample.position = pose.transform_point3a(sample.position);
    sample.normal = pose.transform_vector3a(sample.normal).normalize_or_zero();
    sample.error = pose.matrix3.abs() * sample.error + sample.position.abs() * femc_math::gamma(4);
    sample.distance *= scale;
    sample.radiance *= radiance_scale(light, scale);
    Some(sample)
}

/// Returns the factor by which a pose, which is a similarity, scales lengths.
#[inline]
fn pose_scale(pose: &Affine3A) -> f32 {
    pose.matrix3.x_axis.length()
}

/// Returns the factor on the radiance of a light that a pose has scaled. Surfaces keep their radiance. A luminaire keeps its
/// intensity, which now comes from a larger opening, or from farther away.
#[inline]
fn radiance_scale(light: &Light, scale: f32) -> f32 {
    if light.has_intensity() { 1.0 / (scale * scale) } else { 1.0 }
}

/// Returns the bounds with which a light is chosen, in the prepared frame over the whole shutter.
fn bounds(light: &Light, instance: &LightInstance, world: &World, extinction: impl Fn(Vec3A) -> f32) -> LightBounds {
    let ((low, high), power) = (light.bounds(), light.power());
    if instance.moving_instance == NONE {
        let center = light.center();
        return LightBounds { low, high, center, power, extinction: extinction(center), cone: light.emission_cone() };
    }
    let swept = world.swept_bounds(instance.moving_instance, &Aabb { min: low, max: high });
    let scale = pose_scale(&world.pose_at(instance.moving_instance, 0.5));
    let power = if light.has_intensity() { power } else { power * scale * scale };
    let (low, high) = (swept.min, swept.max);
    let center = (low + high) * 0.5;
    LightBounds { low, high, center, power, extinction: extinction(center), cone: EmissionCone::ALL }
}

/// Returns the shape of an emitter in the frame in which its light is stored.
pub fn transform_emitter_shape(emitter: &Emitter, to_frame: &DAffine3) -> EmitterShape {
    match emitter.shape {
        EmitterShape::Triangle(p) => EmitterShape::Triangle(p.map(|p| to_frame.transform_point3(p))),
        EmitterShape::Parallelogram([o, a, b]) => EmitterShape::Parallelogram([
            to_frame.transform_point3(o),
            to_frame.transform_vector3(a),
            to_frame.transform_vector3(b),
        ]),
        EmitterShape::Curved(shape) => EmitterShape::Curved(crate::compile::transform_shape(&shape, to_frame)),
        EmitterShape::Photometric(luminaire) => {
            EmitterShape::Photometric(Luminaire { to_group: *to_frame * luminaire.to_group, ..luminaire })
        }
    }
}

/// Measured intensity distributions of a scene, ready to evaluate.
#[derive(Clone, Debug, Default)]
pub struct PhotometryTables {
    tables: Vec<(Arc<IntensityDistribution>, Opening)>,
}

impl PhotometryTables {
    /// Builds the tables, in the order of the scene's photometry indices.
    pub fn new(scene: &Scene) -> Result<Self, PhotometryError> {
        let table = |p: &Photometry| {
            let kind = match p.kind {
                PhotometryType::A => PhotometryKind::A,
                PhotometryType::B => PhotometryKind::B,
                PhotometryType::C => PhotometryKind::C,
            };
            let table = IntensityDistribution::new(kind, &p.vertical, &p.horizontal, &p.candela)?;
            Ok((Arc::new(table), p.opening))
        };
        Ok(Self { tables: scene.photometry.iter().map(table).collect::<Result<_, _>>()? })
    }

    /// Returns the light of a luminaire. `to_frame` maps the luminaire's own frame to the frame in which the light is stored.
    pub fn light(&self, luminaire: &Luminaire, to_frame: &DAffine3) -> Light {
        let (table, opening) = &self.tables[luminaire.photometry.index()];
        let scale = cbrt(to_frame.matrix3.determinant().abs());
        let axis = |v: DVec3| v.normalize_or_zero().as_vec3a();
        let m = to_frame.matrix3;
        let axes = [axis(m.x_axis), axis(m.y_axis), axis(m.z_axis)];
        let position = to_frame.translation.as_vec3a();
        let tint = Rgb::from_array(luminaire.color.map(|c| (c * luminaire.multiplier).max(0.0) as f32));
        let size = |x: f64| (x * scale) as f32;
        let solid = match *opening {
            Opening::Point => {
                return Light::PhotometricPoint(PhotometricPoint { position, axes, distribution: table.clone(), tint });
            }
            Opening::Box { width, length, height } => Solid::cuboid(size(length), size(width), size(height)),
            Opening::Cylinder { diameter, height } => Solid::cylinder(size(diameter), size(height)),
            Opening::Sphere { diameter } => Solid::sphere(size(diameter)),
        };
        Light::PhotometricSolid(PhotometricSolid { center: position, axes, solid, distribution: table.clone(), tint })
    }
}

/// Returns the light of an emitter. `material` is that of its surface; luminaires have none.
pub fn light_from_shape(shape: &EmitterShape, material: Option<&Material>, tables: &PhotometryTables) -> Light {
    let black = Material::default();
    let material = material.unwrap_or(&black);
    let c = material.ed.color.map(|c| (c * material.ed.amount).max(0.0) as f32);
    let emission = Emission {
        emittance: Rgb::from_array(c),
        profile: material.lobe.map_or(AngularProfile::Lambertian, |n| AngularProfile::Lobe { exponent: n as f32 }),
        sides: match material.sides {
            femc_scene::Sides::One => EmittingSides::One,
            femc_scene::Sides::Two => EmittingSides::Two,
        },
    };
    let v = |p: &DVec3| p.as_vec3a();
    let signed = |radius: f64, facing: Facing| match facing {
        Facing::Outward => radius as f32,
        Facing::Inward => -radius as f32,
    };
    match shape {
        EmitterShape::Triangle([a, b, c]) => Light::Triangle(Triangle::new([v(a), v(b), v(c)], emission)),
        EmitterShape::Parallelogram([o, a, b]) => Light::Parallelogram(Parallelogram::new(v(o), v(a), v(b), emission)),
        EmitterShape::Curved(Shape::Sphere { center, radius, facing }) => {
            Light::Sphere(Sphere::new(v(center), signed(*radius, *facing), emission))
        }
        EmitterShape::Curved(Shape::Cone { start, end, start_radius, end_radius, facing }) => Light::Cone(Cone::new(
            v(start),
            signed(*start_radius, *facing),
            v(end),
            signed(*end_radius, *facing),
            emission,
        )),
        EmitterShape::Curved(Shape::Ring { center, normal, inner, outer }) => {
            Light::Ring(Ring::new(v(center), v(normal), *inner as f32, *outer as f32, emission))
        }
        EmitterShape::Curved(Shape::Torus { center, axis, major, minor, facing }) => Light::Torus(Torus::new(
            v(center),
            v(axis),
            signed(major - minor, *facing),
            signed(major + minor, *facing),
            emission,
        )),
        EmitterShape::Photometric(luminaire) => tables.light(luminaire, &luminaire.to_group),
    }
}
