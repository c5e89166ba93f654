//! Data of a prepared frame for the solver: sides of surfaces, their reflectance, and the bounds of the fog.

use crate::tuning::{FAR_FREE_PATHS, OPEN_RAYS};
use femc_field::{Form, NONE, Side, Surface};
use femc_geometry::Ray;
use femc_math::Rgb;
use femc_math::glam::Vec3A;
use femc_prepared::{Orientation, Prepared};
use femc_scattering::Sides;

/// Time of the shutter. Moving objects are at their position in the middle of the shutter interval.
pub const SHUTTER_TIME: f32 = 0.5;

/// Surfaces and fog of a frame.
pub struct Scene<'a> {
    pub prepared: &'a Prepared,
    pub surfaces: Vec<Surface>,
    /// Surfaces of the front and of the back by instance and primitive, or [`NONE`].
    pub sides: Vec<Vec<[u32; 2]>>,
    /// Box around the relevant fog, if there is any.
    pub fog: Option<[Vec3A; 2]>,
    /// Extinction of the fog, 1/m, if it is gray and homogeneous.
    pub uniform_extinction: Option<f32>,
    /// Light sources.
    pub lamps: Vec<Lamp>,
    /// Reflected and transmitted share by material.
    albedos: Vec<(Rgb, Rgb)>,
}

/// A light source.
pub struct Lamp {
    /// Bounding sphere.
    pub center: Vec3A,
    pub radius: f32,
    /// Luminous intensity in the brightest direction, cd, if it emits like a Lambertian surface.
    pub intensity: f32,
    /// Corners, counterclockwise around the normal, and luminance of each emitting side of a polygon with constant radiance.
    pub polygons: Vec<(Vec<Vec3A>, Rgb)>,
}

impl Lamp {
    fn new(prepared: &Prepared, lamp: u32) -> Self {
        let bounds = prepared.lights.bounds(lamp);
        let polygons = match prepared.lights.uniform_polygon(lamp) {
            None => Vec::new(),
            Some((corners, luminance, false)) => vec![(corners, luminance)],
            Some((corners, luminance, true)) => {
                let back = corners.iter().rev().copied().collect();
                vec![(corners, luminance), (back, luminance)]
            }
        };
        let intensity = prepared.lights.power(lamp) * std::f32::consts::FRAC_1_PI;
        Self { center: bounds.center(), radius: 0.5 * bounds.size().length(), intensity, polygons }
    }
}

impl<'a> Scene<'a> {
    pub fn new(prepared: &'a Prepared) -> Self {
        let albedos: Vec<_> = prepared.materials.iter().map(|material| material.bsdf.diffuse_albedos()).collect();
        let mut surfaces = Vec::new();
        let mut sides = Vec::with_capacity(prepared.instances.len());
        for (instance, group) in prepared.instances.iter().enumerate() {
            let pose = prepared.world.pose_at(instance as u32, SHUTTER_TIME);
            let blas = &group.compiled.blas;
            let triangle = |primitive: u32| blas.triangle(primitive).map(|t| t.map(|p| pose.transform_point3a(p)));
            let primitives = &group.compiled.primitives;
            let mut of = vec![[NONE; 2]; primitives.len()];
            let mut next = 0u32;
            while (next as usize) < primitives.len() {
                let (first, material) = (next, primitives[next as usize].material);
                let second = primitives.get(first as usize + 1).filter(|other| other.material == material);
                let (form, last) = match (triangle(first), second.and_then(|_| triangle(first + 1))) {
                    (Some(a), b) => match b.and_then(|b| Surface::join_triangles(a, b)) {
                        Some(joined) => (Form::Parallelogram(joined), first + 1),
                        None => (Form::Triangle([a[0], a[1] - a[0], a[2] - a[0]]), first),
                    },
                    (None, _) => match blas.quadric(first) {
                        Some(shape) => (Form::Curved { shape, pose }, first),
                        None => break,
                    },
                };
                next = last + 1;
                let (reflectance, transmittance) = albedos[material as usize];
                if reflectance == Rgb::ZERO && transmittance == Rgb::ZERO {
                    continue;
                }
                let kernel = &prepared.materials[material as usize];
                let both = kernel.parameters.sides == Sides::Two && kernel.orientation == Orientation::TowardViewer;
                for side in [Side::Front, Side::Back].into_iter().take(1 + usize::from(both)) {
                    let index = surfaces.len() as u32;
                    let primitives = [first, last];
                    for primitive in first..=last {
                        of[primitive as usize][usize::from(side == Side::Back)] = index;
                    }
                    let form = form.clone();
                    surfaces.push(Surface { instance: instance as u32, primitives, material, side, form });
                }
            }
            sides.push(of);
        }
        let lamps = (0..prepared.lights.len() as u32).map(|lamp| Lamp::new(prepared, lamp)).collect();
        Self {
            prepared,
            surfaces,
            sides,
            fog: fog_bounds(prepared),
            uniform_extinction: prepared.media.uniform_extinction(),
            lamps,
            albedos,
        }
    }

    /// Returns the reflected and transmitted shares of the light that a surface receives.
    pub fn surface_albedos(&self, surface: u32) -> (Rgb, Rgb) {
        self.material_albedos(self.surfaces[surface as usize].material)
    }

    /// Returns the diffuse reflectance and transmittance of a material.
    pub fn material_albedos(&self, material: u32) -> (Rgb, Rgb) {
        self.albedos[material as usize]
    }

    /// Returns the other side of a surface, or [`NONE`].
    pub fn other_side(&self, surface: u32) -> u32 {
        let Surface { instance, primitives, side, .. } = &self.surfaces[surface as usize];
        self.sides[*instance as usize][primitives[0] as usize][usize::from(*side == Side::Front)]
    }
}

/// Returns a box around the fog that scatters: around all surfaces, and in open directions extended by the range of light in the
/// fog.
fn fog_bounds(prepared: &Prepared) -> Option<[Vec3A; 2]> {
    if prepared.media.is_empty() {
        return None;
    }
    let mut around = prepared.world.bounds();
    let size = around.size();
    let far = (FAR_FREE_PATHS / prepared.media.extinction_at(around.center())).min(0.5 * size.max_element());
    for axis in 0..3 {
        for outward in [-1.0, 1.0] {
            if !is_open(prepared, axis, outward) {
                continue;
            }
            if outward > 0.0 { around.max[axis] += far } else { around.min[axis] -= far }
        }
    }
    let bounds = prepared.media.scattering_bounds(around)?;
    (bounds.size().cmpgt(Vec3A::ZERO).all() && bounds.size().is_finite()).then_some([bounds.min, bounds.max])
}

/// Checks whether most rays along an axis leave the scene.
fn is_open(prepared: &Prepared, axis: usize, outward: f32) -> bool {
    let bounds = prepared.world.bounds();
    let mut dir = Vec3A::ZERO;
    dir[axis] = outward;
    let leaves = |k: &u32| {
        // Points of a lattice that fills the box evenly (\[roberts2018\]).
        let step = |a: f64| (0.5 + a * f64::from(k + 1)).fract() as f32;
        let place =
            Vec3A::new(step(0.819_172_513_396_164_4), step(0.671_043_606_703_789_3), step(0.549_700_477_901_970_2));
        let origin = bounds.min + bounds.size() * place;
        !prepared.world.occluded(&Ray { origin, dir, t_max: f32::INFINITY, time: SHUTTER_TIME })
    };
    (0..OPEN_RAYS).filter(leaves).count() as u32 > OPEN_RAYS / 2
}
