//! A second path tracer, against which the renderer is compared. It is slow, uses f64, and is as simple as possible.
//!
//! It shares the scene description with the renderer and nothing else: no bounding volume hierarchy, no light sampling, no multiple
//! importance sampling. A path finds light only by hitting it. Every triangle is tested for every segment. Directions are derived
//! from uniform ones, by rejection or by weighting. The price is tens of thousands of samples per pixel.
//!
//! It supports triangles, opaque materials (`rd`, rough `rs`, `ed`), a pinhole camera and one gray medium that fills all space.

use crate::rng::Rng;
use femc_film::Image;
use femc_math::glam::DVec3;
use femc_scene::{Camera, Group, Material, Phase, RegionBounds, Scene, Sides, TintedScalar};
use rayon::prelude::*;
use std::f64::consts::{FRAC_1_PI, TAU};

/// Distance from a surface at which segments begin, m. Coordinates of a few meters are exact to 1e-15.
const RAY_OFFSET: f64 = 1e-9;

/// Kind of scattering event along a path from the camera.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Scatterer {
    /// Diffuse part of a surface.
    Diffuse,
    /// Rough mirror of a surface.
    Glossy,
    /// Fog.
    Fog,
}

/// A scene prepared for [`BruteForceTracer::render`].
pub struct BruteForceTracer {
    triangles: Vec<Triangle>,
    surfaces: Vec<Surface>,
    fog: Option<Fog>,
    camera: PinholeCamera,
}

struct Triangle {
    corner: DVec3,
    edges: [DVec3; 2],
    /// Unit normal of the front.
    normal: DVec3,
    surface: usize,
}

struct Surface {
    diffuse: DVec3,
    glossy: DVec3,
    alpha: f64,
    /// Emitted radiance, cd/m2.
    radiance: DVec3,
    sides: Sides,
}

struct Fog {
    sigma_t: f64,
    albedo: f64,
    phase: Phase,
}

struct PinholeCamera {
    origin: DVec3,
    forward: DVec3,
    /// Steps of one pixel to the right and one down, at distance 1.
    steps: [DVec3; 2],
    film: [u32; 2],
}

impl BruteForceTracer {
    /// Prepares a scene, seen by its first camera.
    ///
    /// # Panics
    /// If the scene contains something that this tracer does not support.
    pub fn new(scene: &Scene) -> Self {
        Self {
            triangles: triangles(&scene.groups[0]),
            surfaces: scene.materials.iter().map(Surface::new).collect(),
            fog: Fog::from_scene(scene),
            camera: PinholeCamera::new(&scene.cameras[0]),
        }
    }

    /// Renders the mean of `spp` samples per pixel. Images of different seeds are independent.
    pub fn render(&self, seed: u32, spp: u32) -> Image {
        let [image] = self.render_classes(seed, spp, |_| [true]);
        image
    }

    /// Like [`Self::render`], but renders one image per class of paths.
    /// - `classify`: returns the classes of a path that hits a lamp, given its scattering events.
    pub fn render_classes<const N: usize>(
        &self,
        seed: u32,
        spp: u32,
        classify: impl Fn(&[Scatterer]) -> [bool; N] + Sync,
    ) -> [Image; N] {
        let [width, height] = self.camera.film;
        let pixel = |index: u32| {
            // Streams begin at random positions of the generator's single sequence.
            let mut rng = Rng::new(Rng::new(u64::from(seed) << 32 | u64::from(index)).bits());
            let corner = [index % width, index / width].map(f64::from);
            let mut sums = [DVec3::ZERO; N];
            let mut found = |path: &[Scatterer], radiance: DVec3| {
                let classes = sums.iter_mut().zip(classify(path)).filter(|(_, belongs)| *belongs);
                classes.for_each(|(sum, _)| *sum += radiance);
            };
            (0..spp).for_each(|_| self.sample(corner, &mut rng, &mut found));
            sums.map(|sum| (sum / f64::from(spp)).as_vec3().to_array())
        };
        let pixels: Vec<[[f32; 3]; N]> = (0..width * height).into_par_iter().map(pixel).collect();
        std::array::from_fn(|class| Image {
            width,
            height,
            pixels: pixels.iter().map(|classes| classes[class]).collect(),
        })
    }

    /// Traces a path through a random point of a pixel. Reports the radiance of each lamp that it hits, cd/m2.
    fn sample(&self, corner: [f64; 2], rng: &mut Rng, on_lamp_hit: &mut impl FnMut(&[Scatterer], DVec3)) {
        let (mut origin, mut dir) = (self.camera.origin, self.camera.direction(corner.map(|x| x + rng.unit())));
        let (mut throughput, mut path) = (DVec3::ONE, Vec::new());
        loop {
            let hit = self.nearest(origin, dir);
            let reach = hit.map_or(f64::INFINITY, |(t, _)| t);
            if let Some((t, fog)) = self.collision(reach, rng) {
                if rng.unit() >= fog.albedo {
                    return;
                }
                path.push(Scatterer::Fog);
                origin += dir * t;
                dir = fog.scatter(dir, rng);
                continue;
            }
            let Some((t, triangle)) = hit else { return };
            let surface = &self.surfaces[triangle.surface];
            if surface.radiance != DVec3::ZERO {
                on_lamp_hit(&path, throughput * surface.radiance);
            }
            let normal = triangle.normal * -triangle.normal.dot(dir).signum();
            let Some((wi, weight, by)) = surface.scatter(normal, -dir, rng) else { return };
            path.push(by);
            throughput *= weight;
            origin += dir * t;
            dir = wi;
        }
    }

    fn nearest(&self, origin: DVec3, dir: DVec3) -> Option<(f64, &Triangle)> {
        let seen = self.triangles.iter().filter(|it| match self.surfaces[it.surface].sides {
            Sides::One => it.normal.dot(dir) < 0.0,
            Sides::Two => true,
        });
        seen.filter_map(|it| Some((it.intersect(origin, dir)?, it))).min_by(|a, b| a.0.total_cmp(&b.0))
    }

    /// Draws the distance of a collision with the fog, if it is less than `reach`.
    fn collision(&self, reach: f64, rng: &mut Rng) -> Option<(f64, &Fog)> {
        let fog = self.fog.as_ref()?;
        let t = -(1.0 - rng.unit()).ln() / fog.sigma_t;
        (t < reach).then_some((t, fog))
    }
}

fn triangles(group: &Group) -> Vec<Triangle> {
    assert!(group.quadrics.is_empty() && group.luminaires.is_empty() && group.instances.is_empty(), "triangles alone");
    let of_face = |face: &femc_scene::Face| {
        let first = face.first_triangle as usize;
        let surface = face.material.index();
        let corners = group.triangles[first..first + face.triangle_count as usize].iter();
        corners
            .map(|corners| Triangle::new(corners.map(|index| group.vertices[index as usize].position), surface))
            .collect::<Vec<_>>()
    };
    group.faces.iter().flat_map(of_face).collect()
}

impl Triangle {
    fn new([a, b, c]: [DVec3; 3], surface: usize) -> Self {
        let edges = [b - a, c - a];
        Self { corner: a, edges, normal: edges[0].cross(edges[1]).normalize(), surface }
    }

    /// Returns the distance along a ray, computed with Cramer's rule.
    fn intersect(&self, origin: DVec3, dir: DVec3) -> Option<f64> {
        let [e1, e2] = self.edges;
        let p = dir.cross(e2);
        let scale = 1.0 / e1.dot(p);
        let s = origin - self.corner;
        let u = s.dot(p) * scale;
        let q = s.cross(e1);
        let v = dir.dot(q) * scale;
        let t = e2.dot(q) * scale;
        (u >= 0.0 && v >= 0.0 && u + v <= 1.0 && t > RAY_OFFSET).then_some(t)
    }
}

impl Surface {
    fn new(material: &Material) -> Self {
        let known = Material {
            name: material.name.clone(),
            location: material.location,
            sides: material.sides,
            rd: material.rd,
            rs: material.rs,
            rs_alpha: material.rs_alpha,
            ed: material.ed,
            ..Material::default()
        };
        assert_eq!(*material, known, "an opaque material without maps");
        let color = |tinted: &TintedScalar| DVec3::from(tinted.color) * tinted.amount;
        // If a channel would reflect more light than it receives, it is scaled down to 1 (docs/formats.md).
        let limit = (color(&material.rd) + color(&material.rs)).max(DVec3::ONE);
        Self {
            diffuse: color(&material.rd) / limit,
            glossy: color(&material.rs) / limit,
            alpha: material.rs_alpha,
            radiance: color(&material.ed) * FRAC_1_PI,
            sides: material.sides,
        }
    }

    /// Draws a part of the reflection and a direction. Returns the direction, the factor on light from there, and the part; `None`:
    /// absorbed.
    /// - `normal`: on the side of `wo`.
    fn scatter(&self, normal: DVec3, wo: DVec3, rng: &mut Rng) -> Option<(DVec3, DVec3, Scatterer)> {
        // Probabilities of the parts: at least their share in any channel, at most 1 together (a paint may be red and its gloss
        // blue).
        let (diffuse, glossy) = (self.diffuse.max_element(), self.glossy.max_element());
        let both = (diffuse + glossy).max(1.0);
        let (diffuse, glossy) = (diffuse / both, glossy / both);
        let part = rng.unit();
        if part < diffuse {
            let wi = rng.direction(|wi| wi.dot(normal));
            Some((wi, self.diffuse / diffuse, Scatterer::Diffuse))
        } else if part < diffuse + glossy {
            let wi = rng.direction(|wi| f64::from(u8::from(wi.dot(normal) > 0.0)));
            Some((wi, self.glossy / glossy * (TAU * ggx_lobe(normal, wo, wi, self.alpha)), Scatterer::Glossy))
        } else {
            None
        }
    }
}

/// `D G2 / (4 cos_o cos_i) cos_i`, 1/sr: GGX with height-correlated Smith shadowing, \[heitz2014\].
fn ggx_lobe(normal: DVec3, wo: DVec3, wi: DVec3, alpha: f64) -> f64 {
    let square = alpha * alpha;
    let (cos_o, cos_i, cos_h) = (wo.dot(normal), wi.dot(normal), (wo + wi).normalize().dot(normal));
    let d = square * FRAC_1_PI / (cos_h * cos_h * (square - 1.0) + 1.0).powi(2);
    let slope = |cos: f64| (square + (1.0 - square) * cos * cos).sqrt();
    d * 0.5 * cos_i / (cos_o * slope(cos_i) + cos_i * slope(cos_o))
}

impl Fog {
    fn from_scene(scene: &Scene) -> Option<Self> {
        let region = scene.regions.first()?;
        let medium = &scene.media[region.medium.index()];
        assert!(
            scene.regions.len() == 1 && region.bounds == RegionBounds::Everywhere,
            "a single medium without bounds"
        );
        assert!([medium.color, medium.absorption_color] == [[1.0; 3]; 2] && medium.glow == 0.0, "a gray medium");
        let sigma_t = medium.sigma_s + medium.sigma_a;
        Some(Self { sigma_t, albedo: medium.sigma_s / sigma_t, phase: medium.phase })
    }

    fn scatter(&self, dir: DVec3, rng: &mut Rng) -> DVec3 {
        match self.phase {
            Phase::Isotropic => rng.direction(|_| 1.0),
            Phase::HenyeyGreenstein { g } => {
                let most = 1.0 - g.abs();
                rng.direction(|wi| (most * most / (1.0 + g * g - 2.0 * g * wi.dot(dir))).powf(1.5))
            }
            Phase::Schlick { .. } | Phase::Rayleigh => panic!("an isotropic or Henyey-Greenstein phase function"),
        }
    }
}

impl PinholeCamera {
    fn new(camera: &Camera) -> Self {
        assert!(camera.lens_radius == 0.0 && camera.along.is_none(), "a pinhole camera that does not move");
        let forward = (camera.target - camera.origin).normalize();
        let right = forward.cross(camera.up).normalize();
        let step = 2.0 * (0.5 * camera.fov).to_radians().tan() / f64::from(camera.film[1]);
        let steps = [right * step, forward.cross(right) * step];
        Self { origin: camera.origin, forward, steps, film: camera.film }
    }

    /// Returns the direction through a point of the film, in pixels from the top left.
    fn direction(&self, film_point: [f64; 2]) -> DVec3 {
        let [x, y] = [0, 1].map(|axis| film_point[axis] - 0.5 * f64::from(self.film[axis]));
        (self.forward + self.steps[0] * x + self.steps[1] * y).normalize()
    }
}

impl Rng {
    /// Draws a number in 0..1, 1 excluded.
    fn unit(&mut self) -> f64 {
        (self.bits() >> 11) as f64 / (1u64 << 53) as f64
    }

    /// Draws a unit direction with a density proportional to `chance` (at most 1), by rejection.
    fn direction(&mut self, chance: impl Fn(DVec3) -> f64) -> DVec3 {
        loop {
            let place = DVec3::from([(); 3].map(|()| 2.0 * self.unit() - 1.0));
            let square = place.length_squared();
            if square <= 1.0 && square > 0.0 {
                let dir = place / square.sqrt();
                if self.unit() < chance(dir) {
                    return dir;
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::BruteForceTracer;
    use crate::parse_scene;

    #[test]
    fn furnace_has_emittance_over_one_minus_reflectance_in_fog_too() {
        let furnace = "camera main =\n origin .3 .2 .1\n target 1 .4 0\n fov 60\n film 8 8\nm wall =\n sides 2\n c\n rd .5\n\
             ed 3.14159265358979\nv a =\n p -1 -1 -1\nv b =\n p 1 -1 -1\nv c =\n p 1 1 -1\nv d =\n p -1 1 -1\nm wall\n\
             prism a b c d -2\n";
        let fog = "medium fog =\n sigma_s .8\n phase hg .5\nmglobal fog\n";
        for text in [furnace.to_owned(), format!("{furnace}{fog}")] {
            let image = BruteForceTracer::new(&parse_scene(&text)).render(1, 2000);
            let n = image.pixels.len();
            let mean = (0..n).map(|at| f64::from(image.luminance(at))).sum::<f64>() / n as f64;
            // The number of walls hit is geometric, with mean and variance 2. The bound is four standard errors.
            let error = (2.0 / (n as f64 * 2000.0)).sqrt();
            assert!((mean - 2.0).abs() <= 4.0 * error, "{mean} +- {error}");
        }
    }
}
