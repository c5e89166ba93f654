//! Preparation of a frame: places compiled groups, collects lights, and converts media and camera.

use crate::camera::{CameraPose, KernelCamera};
use crate::camera_emitters::CameraEmitters;
use crate::compile::{Cache, CompiledGroup, Compiler, GroupPlacement, NONE, mirror_transform, surface_class};
use crate::lights::{LightInstance, Lights, PhotometryTables};
use crate::material::{Crossing, KernelMaterial};
use crate::media::{DensityProfile, KernelMedium, Media, MediumStack};
use crate::scene_source::SceneSource;
use crate::texture::Texture;
use femc_emission::Light;
use femc_field::{Field, TargetGuide};
use femc_geometry::{InstanceInput, Pose, Ray, World, offset_origin};
use femc_math::Rgb;
use femc_math::elementary::double;
use femc_math::glam::{Affine3A, DAffine3, DVec3, Vec3A};
use femc_scattering::Phase;
use femc_scene::frame_key::{FrameKey, Viewpoint};
use femc_scene::{Camera, Density, Motion, MotionPath, RegionBounds, Scalars, Scene};
use std::f64::consts::PI;
use std::sync::{Arc, OnceLock};

/// Selection of the frame of a scene to prepare.
#[derive(Clone, Debug, PartialEq)]
pub struct FrameSpec {
    /// Name of the camera; `None` selects the scene's first.
    pub camera: Option<String>,
    /// Film size that replaces the camera's own.
    pub size: Option<[u32; 2]>,
    /// Frame of the clip, from 1.
    pub frame: u32,
    /// Radius of the pixel filter, pixels.
    pub filter_radius: f32,
}

/// Error of the preparation of a frame.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum PrepareError {
    /// The scene has no camera.
    #[error("the scene has no camera; add a `camera` to it")]
    NoCamera,
    /// No camera has this name.
    #[error("unknown camera `{name}`; the scene has {}", known.join(", "))]
    UnknownCamera {
        /// Requested name.
        name: String,
        /// Names of the existing cameras.
        known: Vec<String>,
    },
    /// The camera has no valid view direction.
    #[error("camera `{name}` looks along its up direction or at its own origin in frame {frame}")]
    DegenerateCamera {
        /// Name of the camera.
        name: String,
        /// Number of the frame.
        frame: u32,
    },
    /// A measured intensity distribution is unusable.
    #[error("a luminaire's photometry cannot be used: {0}")]
    Photometry(#[from] femc_emission::PhotometryError),
    /// The first pass has no usable solution.
    #[error("{reason}")]
    FirstPass {
        /// Reason, and an alternative.
        reason: String,
    },
    /// A varied scalar cannot be set.
    #[error(transparent)]
    Selector(#[from] femc_scene::SelectorError),
}

/// An instance of a compiled group, for the kernels.
#[derive(Clone, Debug)]
pub struct GroupInstance {
    /// Surfaces of the group.
    pub compiled: Arc<CompiledGroup>,
    /// Motions from the group's frame to the world, innermost first.
    pub motions: Vec<Motion>,
    /// Whether the group was mirrored when it was compiled.
    mirrored: bool,
    /// Light index of the first emitter.
    pub first_light: u32,
}

/// A frame that is ready to trace.
#[derive(Debug)]
pub struct Prepared {
    /// Description from which the frame was prepared.
    pub scene: Arc<Scene>,
    /// Digests of the frame's inputs. Frames with equal worlds share everything but the camera.
    pub frame_key: FrameKey,
    /// Frame of the clip, from 1.
    pub frame: u32,
    /// All surfaces.
    pub world: Arc<World>,
    /// Instances by instance index of `world`.
    pub instances: Arc<Vec<GroupInstance>>,
    /// Materials by material index of the description.
    pub materials: Arc<Vec<KernelMaterial>>,
    /// Textures by image index of the description.
    pub textures: Arc<Vec<Texture>>,
    /// Intensity distributions of luminaires.
    pub photometry: Arc<PhotometryTables>,
    /// Light sources.
    pub lights: Arc<Lights>,
    /// Participating media.
    pub media: Arc<Media>,
    /// The camera.
    pub camera: KernelCamera,
    /// Small light sources, listed by the pixels that see them.
    pub camera_emitters: CameraEmitters,
    /// World position of the prepared frame's origin, m.
    pub origin: DVec3,
    /// Minimum distance between a light and a ray, m; smaller distances are raised to it. It is a millionth of the scene's extent.
    pub min_light_distance: f32,
    /// Media of the closed objects that contain the camera.
    pub camera_medium_stack: MediumStack,
    /// Whether light can go straight through a surface. If so, shadow rays examine the surfaces that they hit.
    pub has_clear_surfaces: bool,
    /// Brightness of the lamps ([`Scalars::brightness`]).
    pub brightness: f32,
    field: Option<Arc<Field>>,
    targets: Option<Arc<TargetGuide>>,
    /// Mean light that the field expects at the first surfaces of the frame, cd/m2, once it was computed.
    pub field_light: OnceLock<f32>,
    /// Number of branches into which unguided paths are split at their first vertices. The renderer chooses it.
    pub first_branches: u32,
    cache: Cache,
}

/// Viewpoint of a frame.
pub(crate) struct FrameView<'a> {
    pub camera: &'a Camera,
    pub film: [u32; 2],
    pub shutter: [f64; 2],
    pub origin: DVec3,
    pub filter_radius: f32,
}

impl<'a> FrameView<'a> {
    fn new(source: &SceneSource, scalars: &'a Scalars, spec: &FrameSpec) -> Result<Self, PrepareError> {
        let scene = source.scene();
        let camera = find_camera(&scalars.cameras, spec.camera.as_deref())?;
        Ok(Self {
            camera,
            film: spec.size.unwrap_or(camera.film),
            shutter: scene.shutter(camera, spec.frame),
            origin: rebase_origin(source, spec.camera.as_deref())?,
            filter_radius: spec.filter_radius,
        })
    }

    fn frame_key(&self, source: &SceneSource, scalars: &Scalars, frame: u32) -> FrameKey {
        let Self { camera, film, shutter, origin, filter_radius } = *self;
        let viewpoint = Viewpoint { camera, film, frame, shutter, origin, filter_radius };
        source.scene().frame_key(source.static_digest(), scalars, &viewpoint)
    }
}

/// Returns the digests of the inputs of a frame, without preparing it.
pub fn frame_key(source: &SceneSource, spec: &FrameSpec) -> Result<FrameKey, PrepareError> {
    let scene = source.scene();
    let scalars = scene.scalars_at(scene.frame_time(spec.frame))?;
    Ok(FrameView::new(source, &scalars, spec)?.frame_key(source, &scalars, spec.frame))
}

/// Prepares a frame. `previous` is any other frame; the two share what they have in common. If their worlds are equal, this is
/// everything but the camera. If one scene is a variant of the other, it is the unchanged surfaces.
pub fn prepare_frame(
    source: &SceneSource,
    spec: &FrameSpec,
    previous: Option<&Prepared>,
) -> Result<Prepared, PrepareError> {
    let scene = source.scene();
    prepare_with(source, spec, &scene.scalars_at(scene.frame_time(spec.frame))?, previous)
}

/// Prepares a frame like [`prepare_frame`], but with lamps of brightness 1 ([`Scalars::with_unit_brightness`]). Frames with equal
/// [`FrameKey::light`] give the same world.
pub fn prepare_frame_at_unit_brightness(
    source: &SceneSource,
    spec: &FrameSpec,
    previous: Option<&Prepared>,
) -> Result<Prepared, PrepareError> {
    let scene = source.scene();
    prepare_with(source, spec, &scene.scalars_at(scene.frame_time(spec.frame))?.with_unit_brightness(), previous)
}

fn prepare_with(
    source: &SceneSource,
    spec: &FrameSpec,
    scalars: &Scalars,
    previous: Option<&Prepared>,
) -> Result<Prepared, PrepareError> {
    let scene = source.scene();
    let view = FrameView::new(source, scalars, spec)?;
    let frame_key = view.frame_key(source, scalars, spec.frame);
    let camera = kernel_camera(&scalars.paths, spec, &view)?;
    let mut prepared = match previous.filter(|p| p.frame_key.static_digest == frame_key.static_digest) {
        Some(previous) if previous.frame_key.world == frame_key.world => Prepared {
            scene: scene.clone(),
            frame_key,
            frame: spec.frame,
            world: previous.world.clone(),
            instances: previous.instances.clone(),
            materials: previous.materials.clone(),
            textures: previous.textures.clone(),
            photometry: previous.photometry.clone(),
            lights: previous.lights.clone(),
            media: previous.media.clone(),
            camera,
            camera_emitters: CameraEmitters::default(),
            origin: previous.origin,
            min_light_distance: previous.min_light_distance,
            camera_medium_stack: MediumStack::default(),
            has_clear_surfaces: previous.has_clear_surfaces,
            brightness: previous.brightness,
            field: previous.field.clone(),
            targets: None,
            field_light: OnceLock::new(),
            first_branches: 1,
            cache: previous.cache.clone(),
        },
        previous => build_world(scene, scalars, &view, frame_key, camera, spec.frame, previous)?,
    };
    prepared.camera_medium_stack = prepared.media_at(prepared.camera.eye());
    prepared.camera_emitters = CameraEmitters::new(&prepared.camera, &prepared.lights, spec.filter_radius);
    Ok(prepared)
}

/// Builds a world. `previous`: a frame of a variant of the same scene, if any.
fn build_world(
    scene: &Arc<Scene>,
    scalars: &Scalars,
    view: &FrameView<'_>,
    frame_key: FrameKey,
    camera: KernelCamera,
    frame: u32,
    previous: Option<&Prepared>,
) -> Result<Prepared, PrepareError> {
    let FrameView { shutter, origin, .. } = *view;
    let (textures, photometry) = match previous {
        Some(previous) => (previous.textures.clone(), previous.photometry.clone()),
        None => (Arc::new(scene.images.iter().map(Texture::new).collect()), Arc::new(PhotometryTables::new(scene)?)),
    };

    let classes: Vec<_> = scalars.materials.iter().map(surface_class).collect();
    let empty = Cache::new();
    let at_open = |motion: &Motion| motion.at(&scalars.paths, shutter[0]);
    let previous_cache = previous.map_or(&empty, |p| &p.cache);
    let mut compiler = Compiler::new(scene, scalars, &photometry, &classes, origin, previous_cache, &at_open);
    compiler.run();
    let (placements, cache) = (compiler.placements, compiler.cache);

    // The last material is the black body behind the openings of luminaires.
    let black = femc_scene::Material::default();
    let is_nothing = |medium: femc_scene::MediumId| scalars.media[medium.index()].is_vacuum();
    let kernel = |material: &femc_scene::Material| KernelMaterial {
        interior_medium: material.inside.filter(|&medium| !is_nothing(medium)).map(|medium| medium.0 as u16),
        ..KernelMaterial::new(material)
    };
    let materials: Vec<_> = scalars.materials.iter().chain([&black]).map(kernel).collect();
    let mut assembly = Assembly {
        scalars,
        photometry: &photometry,
        origin,
        shutter,
        inputs: Vec::new(),
        instances: Vec::new(),
        lights: Vec::new(),
        light_instances: Vec::new(),
    };
    for group in placements {
        assembly.add_group(group);
    }
    let media = convert_media(scene, scalars, origin, materials.iter().any(|m| m.interior_medium.is_some()));
    let has_clear_surfaces = materials.iter().any(|m| m.crossing.iter().any(|&c| c != Crossing::Scatter));
    let Assembly { inputs, instances, lights, light_instances, .. } = assembly;
    let world = World::build(inputs);
    let extent = world.bounds().size().max_element();
    let lights = Lights::new(lights, light_instances, &world, |point| media.extinction_at(point));
    Ok(Prepared {
        scene: scene.clone(),
        frame_key,
        frame,
        min_light_distance: if extent.is_finite() { (extent * 1e-6).max(1e-9) } else { 1e-6 },
        world: Arc::new(world),
        instances: Arc::new(instances),
        materials: Arc::new(materials),
        textures,
        photometry,
        lights: Arc::new(lights),
        media: Arc::new(media),
        camera,
        camera_emitters: CameraEmitters::default(),
        origin,
        camera_medium_stack: MediumStack::default(),
        has_clear_surfaces,
        brightness: scalars.brightness() as f32,
        field: None,
        targets: None,
        field_light: OnceLock::new(),
        first_branches: 1,
        cache,
    })
}

impl Prepared {
    /// Returns the light field found by the first pass. `None`: there was no first pass, or not yet.
    pub fn field(&self) -> Option<&Field> {
        self.field.as_deref()
    }

    /// Assigns the light field of the first pass, or removes it.
    pub fn set_field(&mut self, field: Option<Arc<Field>>) {
        (self.field, self.targets) = (field, None);
        self.field_light = OnceLock::new();
    }

    /// Returns the targets of the frame's paths. `None`: none were learned.
    pub fn targets(&self) -> Option<&TargetGuide> {
        self.targets.as_deref()
    }

    /// Assigns the targets of the frame's paths, which belong to its field. [`Self::set_field`] removes them.
    pub fn set_targets(&mut self, targets: Arc<TargetGuide>) {
        self.targets = Some(targets);
        self.field_light = OnceLock::new();
    }

    /// Returns the media of the closed objects that contain `point`. These are the objects whose surfaces a ray from the point
    /// leaves without having entered them.
    /// - `point`: prepared frame, m.
    pub fn media_at(&self, point: Vec3A) -> MediumStack {
        if self.materials.iter().all(|material| material.interior_medium.is_none()) {
            return MediumStack::default();
        }
        let mut ray = Ray { origin: point, dir: Vec3A::new(0.36, 0.48, 0.8), t_max: f32::INFINITY, time: 0.0 };
        let (mut entered, mut left) = (MediumStack::default(), Vec::new());
        for _ in 0..10_000 {
            let Some(hit) = self.world.intersect(&ray) else { break };
            let surface = self.shading_point(&ray, &hit);
            if let Some(medium) = self.materials[surface.material as usize].interior_medium {
                if surface.normal.dot(ray.dir) < 0.0 {
                    entered.push(medium);
                } else if entered.iter().any(|m| m == medium) {
                    entered.remove(medium);
                } else {
                    left.push(medium);
                }
            }
            ray.origin = offset_origin(surface.position, surface.error, surface.normal, ray.dir);
        }
        let mut inside = MediumStack::default();
        left.into_iter().rev().for_each(|m| inside.push(m));
        inside
    }
}

/// Returns the camera of a name, or the first.
pub fn find_camera<'a>(cameras: &'a [Camera], name: Option<&str>) -> Result<&'a Camera, PrepareError> {
    match name {
        None => cameras.first().ok_or(PrepareError::NoCamera),
        Some(name) => cameras.iter().find(|c| c.name == name).ok_or_else(|| PrepareError::UnknownCamera {
            name: name.into(),
            known: cameras.iter().map(|c| c.name.clone()).collect(),
        }),
    }
}

/// Returns the origin for the camera's position at the start of the clip, so that it is the same for every frame.
fn rebase_origin(source: &SceneSource, camera: Option<&str>) -> Result<DVec3, PrepareError> {
    let scene = source.scene();
    let camera = find_camera(&scene.cameras, camera)?.at(&scene.paths, scene.frame_time(1));
    Ok(source.origin(camera.origin))
}

struct Assembly<'a> {
    scalars: &'a Scalars,
    photometry: &'a PhotometryTables,
    origin: DVec3,
    shutter: [f64; 2],
    inputs: Vec<InstanceInput>,
    instances: Vec<GroupInstance>,
    lights: Vec<Light>,
    light_instances: Vec<LightInstance>,
}

impl Assembly<'_> {
    fn add_group(&mut self, placement: GroupPlacement) {
        let (paths, origin) = (&self.scalars.paths, self.origin);
        let instance = GroupInstance {
            compiled: placement.compiled,
            motions: placement.motions,
            mirrored: placement.mirrored,
            first_light: self.lights.len() as u32,
        };
        let (pose, first) = instance.pose_over(self.shutter, paths, origin);
        let moves = matches!(pose, Pose::Moving(_));
        let moving_instance = if moves { self.inputs.len() as u32 } else { NONE };
        let to_frame = if moves { DAffine3::IDENTITY } else { first };
        self.add_emitters(&instance.compiled, moving_instance, &to_frame);
        // The tracer's surface is rounded in the compiled frame and again by the pose. The light's points match it only to this
        // accuracy.
        if first != DAffine3::IDENTITY {
            let bounds = instance.compiled.blas.bounds();
            let local = bounds.min.abs().max(bounds.max.abs()).max_element();
            let scale = double::cbrt(first.matrix3.determinant().abs()) as f32;
            let shift = first.translation.abs().max_element() as f32;
            let slack = femc_math::gamma(8) * (local * scale + shift);
            self.light_instances[instance.first_light as usize..].iter_mut().for_each(|e| e.position_error = slack);
        }
        self.inputs.push(InstanceInput { blas: instance.compiled.blas.clone(), pose });
        self.instances.push(instance);
    }

    fn add_emitters(&mut self, compiled: &CompiledGroup, moving_instance: u32, to_frame: &DAffine3) {
        let first = self.lights.len();
        for emitter in &compiled.emitters {
            let material = self.scalars.materials.get(emitter.material as usize);
            let shape = crate::lights::transform_emitter_shape(emitter, to_frame);
            self.lights.push(crate::lights::light_from_shape(&shape, material, self.photometry));
            let texture = material.and_then(|m| m.map_ed).map_or(NONE, |m| m.0);
            self.light_instances.push(LightInstance { moving_instance, texture, ..LightInstance::default() });
        }
        for primitive in compiled.primitives.iter().filter(|p| p.emitter != NONE && p.corners != NONE) {
            self.light_instances[first + primitive.emitter as usize].uv =
                compiled.corners[primitive.corners as usize].uv;
        }
    }
}

impl GroupInstance {
    /// Returns the transform from compiled frame to prepared frame at `time`, s.
    fn pose(&self, time: f64, paths: &[MotionPath], origin: DVec3) -> DAffine3 {
        let mut pose = DAffine3::from_translation(self.compiled.center);
        if self.mirrored {
            pose = mirror_transform() * pose;
        }
        for motion in &self.motions {
            pose = motion.at(paths, time) * pose;
        }
        DAffine3::from_translation(-origin) * pose
    }

    /// Returns the pose over a shutter, and the transform at its opening.
    pub(crate) fn pose_over(&self, [open, close]: [f64; 2], paths: &[MotionPath], origin: DVec3) -> (Pose, DAffine3) {
        let first = self.pose(open, paths, origin);
        if close <= open || !self.motions.iter().any(|motion| motion.is_animated(paths)) {
            return (Pose::Fixed(affine(&first)), first);
        }
        let steps = pose_count(&first, &self.pose(close, paths, origin));
        let at = |k: usize| self.pose(open + (close - open) * k as f64 / (steps - 1) as f64, paths, origin);
        (Pose::Moving((0..steps).map(|k| affine(&at(k))).collect()), first)
    }
}

/// Returns a number of shutter poses, at least two, such that the rotation between neighbors stays below 15 degrees.
fn pose_count(a: &DAffine3, b: &DAffine3) -> usize {
    let (_, qa, _) = a.to_scale_rotation_translation();
    let (_, qb, _) = b.to_scale_rotation_translation();
    let angle = 2.0 * double::acos(qa.dot(qb).abs().min(1.0));
    2 + (angle / (PI / 12.0)) as usize
}

fn affine(t: &DAffine3) -> Affine3A {
    Affine3A {
        matrix3: femc_math::glam::Mat3A::from_cols(
            t.matrix3.x_axis.as_vec3a(),
            t.matrix3.y_axis.as_vec3a(),
            t.matrix3.z_axis.as_vec3a(),
        ),
        translation: t.translation.as_vec3a(),
    }
}

/// Returns the media; a medium without any effect fills nothing. `has_interior_media`: whether some are behind surfaces.
fn convert_media(scene: &Scene, scalars: &Scalars, origin: DVec3, has_interior_media: bool) -> Media {
    let color = |c: [f64; 3], amount: f64| Rgb::from_array(c.map(|c| (c * amount).max(0.0) as f32));
    let kernels = scalars.media.iter().map(|m| {
        let sigma_s = color(m.color, m.sigma_s);
        KernelMedium {
            sigma_s,
            sigma_t: sigma_s + color(m.absorption_color, m.sigma_a),
            glow: color(m.glow_color, m.glow / (4.0 * PI)),
            phase: convert_phase(&m.phase),
            profile: match m.density {
                Density::Uniform => DensityProfile::Uniform,
                Density::Height { z0, scale } => {
                    DensityProfile::Height { z0: (z0 - origin.z) as f32, inverse_scale: (1.0 / scale) as f32 }
                }
            },
        }
    });
    let mut media = Media::new(kernels.collect(), has_interior_media);
    for region in scene.regions.iter().filter(|region| !scalars.media[region.medium.index()].is_vacuum()) {
        let medium = region.medium.0 as u16;
        match &region.bounds {
            RegionBounds::Everywhere => media.fill_everywhere(medium),
            RegionBounds::Box { min, max, to_world } => {
                // The box is relative to its own middle, so that local coordinates are small.
                let middle = 0.5 * (*min + *max);
                let to_frame = DAffine3::from_translation(-origin) * *to_world * DAffine3::from_translation(middle);
                let half = (0.5 * (*max - *min)).abs().as_vec3a();
                media.fill_box(medium, affine(&to_frame.inverse()), -half, half);
            }
        }
    }
    media
}

fn convert_phase(phase: &femc_scene::Phase) -> Phase {
    // A value below 1 may round to 1, where the density is zero.
    let most = 1f32.next_down();
    let inside = |parameter: f64| (parameter as f32).clamp(-most, most);
    match *phase {
        femc_scene::Phase::Isotropic => Phase::Isotropic,
        femc_scene::Phase::HenyeyGreenstein { g } => Phase::HenyeyGreenstein { g: inside(g) },
        femc_scene::Phase::Schlick { k } => Phase::Schlick { k: inside(k) },
        femc_scene::Phase::Rayleigh => Phase::Rayleigh,
    }
}

pub(crate) fn kernel_camera(
    paths: &[MotionPath],
    spec: &FrameSpec,
    view: &FrameView<'_>,
) -> Result<KernelCamera, PrepareError> {
    let FrameView { camera, film, shutter, origin, .. } = *view;
    let steps = if camera.is_animated(paths) && shutter[1] > shutter[0] { 5 } else { 1 };
    let poses = (0..steps).map(|k| {
        let time = shutter[0] + (shutter[1] - shutter[0]) * f64::from(k) / f64::from((steps - 1).max(1));
        let at = camera.at(paths, time);
        CameraPose::new(at.origin - origin, at.target - origin, at.up, at.fov, film)
            .ok_or_else(|| PrepareError::DegenerateCamera { name: camera.name.clone(), frame: spec.frame })
    });
    let poses = poses.collect::<Result<Vec<_>, _>>()?;
    Ok(KernelCamera::new(poses, film, camera.lens_radius as f32, camera.focus as f32))
}
