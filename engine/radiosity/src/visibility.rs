//! Visibility between two elements: rays between pseudo-random points of them.

use crate::arena::Arena;
use crate::element::{Element, Shape};
use crate::scene::{SHUTTER_TIME, Scene};
use crate::tuning::{EVEN_PARTS, MAX_CLEAR_SURFACES};
use femc_emission::LightWeights;
use femc_field::SurfaceSpot;
use femc_geometry::{Ray, offset_origin, shadow_segment};
use femc_math::color::luminance;
use femc_math::elementary::exp;
use femc_math::glam::{Vec2, Vec3A};
use femc_math::hash::{combine, unit_f32};
use femc_prepared::media::{MediaRay, MediumStack};

/// Visibility tester of one thread: rays and their buffers.
#[derive(Default)]
pub struct VisibilityTester {
    pub media: MediaRay,
    pub lamps: LightWeights,
    pub rays: u64,
}

/// Generator of numbers in [0, 1) from a key.
pub struct RandomNumbers(u64, u64);

impl RandomNumbers {
    pub fn new(words: &[u64]) -> Self {
        Self(combine(words), 0)
    }

    pub fn next(&mut self) -> f32 {
        self.1 += 1;
        unit_f32((femc_math::hash::mix64(self.0.wrapping_add(self.1.wrapping_mul(0x9e37_79b9_7f4a_7c15))) >> 32) as u32)
    }
}

impl VisibilityTester {
    /// Returns the share of light, by luminance, that travels from one point to another: 0 behind something opaque, else attenuated
    /// by clear surfaces and fog. Zero normals: points in space.
    pub fn transmittance(&mut self, scene: &Scene<'_>, from: &SurfaceSpot, to: &SurfaceSpot) -> f32 {
        let seen = self.visibility(scene, from, to);
        if seen > 0.0 { seen * self.fog_transmittance(scene, from.position, to.position) } else { 0.0 }
    }

    /// Returns the share of light without the attenuation by fog.
    pub fn visibility(&mut self, scene: &Scene<'_>, from: &SurfaceSpot, to: &SurfaceSpot) -> f32 {
        let prepared = scene.prepared;
        let end = (to.position, to.error, to.normal);
        let mut ray = shadow_segment((from.position, from.error, from.normal), end, SHUTTER_TIME);
        self.rays += 1;
        let mut share = 1.0;
        if prepared.has_clear_surfaces {
            for _ in 0..MAX_CLEAR_SURFACES {
                let Some(hit) = prepared.world.intersect(&ray) else { break };
                let point = prepared.shading_point(&ray, &hit);
                let back = point.normal.dot(ray.dir) > 0.0;
                share *= luminance(
                    prepared.materials[point.material as usize].crossing[usize::from(back)].straight_through(),
                );
                if share <= 0.0 {
                    return 0.0;
                }
                self.rays += 1;
                let origin = offset_origin(point.position, point.error, point.normal, ray.dir);
                ray = Ray { t_max: ray.t_max - ray.origin.distance(origin), origin, ..ray };
            }
        } else if prepared.world.occluded(&ray) {
            return 0.0;
        }
        share
    }

    /// Returns the transmittance of only the fog between two points.
    pub fn fog_transmittance(&mut self, scene: &Scene<'_>, from: Vec3A, to: Vec3A) -> f32 {
        let (media, way) = (&scene.prepared.media, to - from);
        let length = way.length();
        if let Some(extinction) = scene.uniform_extinction {
            return exp(-extinction * length);
        }
        let foggy = length > 0.0 && !media.is_empty();
        if foggy && media.find_intervals(from, way / length, length, &MediumStack::default(), &mut self.media) {
            luminance(media.transmittance(&self.media))
        } else {
            1.0
        }
    }
}

/// Returns a point of an element from numbers in [0, 1), in stratum `part` of four.
/// - `weight`: factor of the probability of a part, relative to its size.
pub fn sample_point(
    arena: &Arena,
    scene: &Scene<'_>,
    element: &Element,
    part: u32,
    numbers: &mut RandomNumbers,
    weight: impl Fn(u32) -> f32,
) -> SurfaceSpot {
    let mut element = element;
    while !element.is_leaf() {
        let children = element.children;
        let [a, b] = children.map(|child| &arena.elements[child as usize]);
        let [wa, wb] = [(a, children[0]), (b, children[1])].map(|(part, index)| part.size() * weight(index));
        let share = if wa + wb > 0.0 { wa / (wa + wb) } else { a.size() / (a.size() + b.size()) };
        // Strata are worth more than a choice between nearly equal parts.
        let even = a.size() / (a.size() + b.size());
        if element.patch().is_some() && (share - even).abs() < EVEN_PARTS {
            break;
        }
        element = if numbers.next() < share { a } else { b };
    }
    if let Shape::Cluster(cluster) = &element.shape {
        let u = 0.25 * (numbers.next() + part as f32);
        return arena.point_of_cluster(scene, cluster, u, Vec2::new(numbers.next(), numbers.next()));
    }
    let u = [0, 1].map(|axis| 0.5 * (numbers.next() + (part >> axis & 1) as f32));
    let Some(part) = element.surface_part() else {
        let u = Vec3A::new(u[0], u[1], numbers.next());
        let position = element.center + element.half_extent * (u * 2.0 - 1.0);
        return SurfaceSpot { position, ..SurfaceSpot::default() };
    };
    let mut local = Vec2::new(u[0], u[1]);
    if element.is_triangle() && local.x + local.y > 1.0 {
        local = Vec2::ONE - local;
    }
    part.point_at(scene, local)
}
