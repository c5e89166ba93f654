//! Rays against the written triangles hit where the renderer's rays hit.

use super::parse::{Parsed, Triangle};
use super::{prepare_file, spread};
use femc_geometry::Ray;
use femc_gltf::{GeometryOptions, scene_geometry};
use femc_math::glam::{DVec3, Vec3A};
use femc_prepared::{Crossing, Prepared};

/// Returns the distance of the first triangle in front of a ray, and the triangle.
fn first_hit<'a>(parsed: &Parsed, triangles: &'a [Triangle], origin: DVec3, dir: DVec3) -> Option<(f64, &'a Triangle)> {
    let materials = parsed.list("materials");
    let mut best: Option<(f64, &Triangle)> = None;
    for triangle in triangles {
        let [a, b, c] = triangle.corners;
        let (ab, ac) = (b - a, c - a);
        let p = dir.cross(ac);
        let determinant = ab.dot(p);
        // The determinant is positive if the ray comes from the front.
        let is_behind = determinant < 0.0 && materials[triangle.material]["doubleSided"] == false;
        if determinant == 0.0 || is_behind {
            continue;
        }
        let s = (origin - a) / determinant;
        let u = s.dot(p);
        let q = s.cross(ab);
        let (v, t) = (dir.dot(q), ac.dot(q));
        if u >= 0.0 && v >= 0.0 && u + v <= 1.0 && t > 0.0 && best.is_none_or(|(nearest, _)| t < nearest) {
            best = Some((t, triangle));
        }
    }
    best
}

/// Rays of a scene, and what became of them.
#[derive(Debug, Default)]
pub(crate) struct Tally {
    pub(crate) hits: u32,
    /// Rays on which one of both misses, or which hit different objects.
    other_object: u32,
    other_distance: u32,
    /// Rays that hit a triangle from the other side than the surface.
    turned: u32,
}

impl Tally {
    /// Returns the number of rays that hit another place or object.
    pub(crate) fn differences(&self) -> u32 {
        self.other_object + self.other_distance + self.turned
    }
}

/// Compares the first hits of rays from the camera and from points in the scene, in all directions.
pub(crate) fn compare(prepared: &Prepared, rays: u32) -> Tally {
    let parsed = Parsed::new(&scene_geometry(prepared, &GeometryOptions::default()).unwrap());
    let triangles = parsed.triangles();
    let bounds = prepared.world.bounds();
    let mut tally = Tally::default();
    for k in 0..rays {
        let [x, y, z, w] = spread(k).map(|x| x as f32);
        // From points of the box around the scene, and from the camera, in all directions.
        let inside = bounds.min + bounds.size() * Vec3A::new(x, y, z);
        let origin = if k % 2 == 0 { prepared.camera.eye() } else { inside };
        let [u, v, ..] = spread(k + 100_000);
        let (z, angle) = (2.0 * v - 1.0, std::f64::consts::TAU * (u + f64::from(w)));
        let dir = DVec3::new((1.0 - z * z).sqrt() * angle.cos(), (1.0 - z * z).sqrt() * angle.sin(), z);
        let ray = Ray { origin, dir: dir.as_vec3a().normalize(), t_max: f32::INFINITY, time: 0.5 };
        let hit = prepared.world.intersect(&ray);
        let found = first_hit(&parsed, &triangles, ray.origin.as_dvec3(), ray.dir.as_dvec3());
        let Some(hit) = hit else {
            tally.other_object += u32::from(found.is_some());
            continue;
        };
        let surface = prepared.world.interaction(&ray, &hit);
        let cosine = f64::from(surface.normal.dot(ray.dir));
        let material = prepared.instances[hit.instance as usize].compiled.primitives[hit.primitive as usize].material;
        let crossing = prepared.materials[material as usize].crossing[usize::from(cosine > 0.0)];
        if matches!(crossing, Crossing::Null { .. }) {
            continue;
        }
        tally.hits += 1;
        let object = prepared.object_of(hit.instance, hit.primitive);
        let expected = (prepared.object_name(object), object.map(|object| u64::from(object.0)));
        let Some((t, triangle)) = found.filter(|(_, it)| parsed.object(it.node) == expected) else {
            tally.other_object += 1;
            continue;
        };
        let node = &parsed.list("nodes")[triangle.node];
        let deviation = node["extras"]["deviation"].as_f64().unwrap();
        // Both surfaces are this far apart at most; grazing rays need longer to cross the gap.
        let allowed = 3.0 * deviation / cosine.abs().max(0.05) + 1e-4 * (1.0 + f64::from(hit.t));
        if (t - f64::from(hit.t)).abs() > allowed {
            tally.other_distance += 1;
        }
        let [a, b, c] = triangle.corners;
        tally.turned += u32::from((b - a).cross(c - a).dot(surface.normal.as_dvec3()) <= 0.0);
    }
    tally
}

#[test]
fn rays_hit_the_triangles_where_the_renderer_hits() {
    for (name, frame, rays) in
        [("zoo.mgf", 1, 1500), ("zoo.mgf", 9, 500), ("gallery.mgf", 1, 2000), ("cornell.mgf", 1, 2000)]
    {
        let tally = compare(&prepare_file(name, frame), rays);
        println!("{name}, frame {frame}: {tally:?}");
        assert!(tally.hits >= rays / 8, "{name}: {tally:?}");
        // Rays that pass an outline within the deviation may hit another surface.
        assert!(tally.differences() <= rays / 200 && tally.turned == 0, "{name}: {tally:?}");
    }
}
