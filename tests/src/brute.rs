//! A second path tracer, to hold the renderer against: slow, in f64, and as simple as can be.
//!
//! It takes a scene's description from the renderer and nothing else: no tree of boxes, no choice of lights, no multiple
//! importance sampling. A path finds light only by running into it, every triangle is tried for every segment, and
//! directions come from uniform ones, by rejection or by weight. The price is tens of thousands of samples a pixel.
//!
//! It knows triangles, opaque materials (`rd`, rough `rs`, `ed`), a pinhole camera and one gray medium that fills all space.

use crate::rng::Rng;
use femc_film::Image;
use femc_math::glam::DVec3;
use femc_scene::{Camera, Group, Material, Phase, RegionBounds, Scene, Sides, Tinted};
use rayon::prelude::*;
use std::f64::consts::{FRAC_1_PI, TAU};

/// Segments begin this far from their surface, m: coordinates of a few metres are exact to 1e-15.
const NEAR: f64 = 1e-9;

/// What scatters a path, from the camera on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Scatterer {
    /// The diffuse part of a surface.
    Diffuse,
    /// The rough mirror of a surface.
    Glossy,
    /// Fog.
    Fog,
}

/// A scene that is ready for [`Brute::image`].
pub struct Brute {
    triangles: Vec<Triangle>,
    surfaces: Vec<Surface>,
    fog: Option<Fog>,
    eye: Eye,
}

struct Triangle {
    corner: DVec3,
    edges: [DVec3; 2],
    /// Unit, to the front.
    normal: DVec3,
    surface: usize,
}

struct Surface {
    diffuse: DVec3,
    glossy: DVec3,
    alpha: f64,
    /// Emitted, cd/m2.
    radiance: DVec3,
    sides: Sides,
}

struct Fog {
    sigma_t: f64,
    albedo: f64,
    phase: Phase,
}

struct Eye {
    origin: DVec3,
    forward: DVec3,
    /// One pixel to the right and one down, at distance 1.
    steps: [DVec3; 2],
    film: [u32; 2],
}

impl Brute {
    /// The scene by its first camera.
    ///
    /// # Panics
    /// If the scene has something that this tracer does not know.
    pub fn new(scene: &Scene) -> Self {
        Self {
            triangles: triangles(&scene.groups[0]),
            surfaces: scene.materials.iter().map(Surface::new).collect(),
            fog: Fog::of(scene),
            eye: Eye::new(&scene.cameras[0]),
        }
    }

    /// Mean of `spp` samples a pixel; images of different seeds are independent.
    pub fn image(&self, seed: u32, spp: u32) -> Image {
        let [image] = self.classes(seed, spp, |_| [true]);
        image
    }

    /// The same of the light of paths that are of some class, an image a class.
    /// - `of`: to which classes a path belongs that meets a lamp, by what has scattered it.
    pub fn classes<const N: usize>(
        &self,
        seed: u32,
        spp: u32,
        of: impl Fn(&[Scatterer]) -> [bool; N] + Sync,
    ) -> [Image; N] {
        let [width, height] = self.eye.film;
        let pixel = |index: u32| {
            // The generator's streams begin at random places of its one sequence.
            let mut rng = Rng::new(Rng::new(u64::from(seed) << 32 | u64::from(index)).bits());
            let corner = [index % width, index / width].map(f64::from);
            let mut sums = [DVec3::ZERO; N];
            let mut found = |path: &[Scatterer], radiance: DVec3| {
                let classes = sums.iter_mut().zip(of(path)).filter(|(_, belongs)| *belongs);
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

    /// Finds the radiance that comes in through a place of a pixel, cd/m2, lamp by lamp that a path meets.
    fn sample(&self, corner: [f64; 2], rng: &mut Rng, found: &mut impl FnMut(&[Scatterer], DVec3)) {
        let (mut origin, mut dir) = (self.eye.origin, self.eye.direction(corner.map(|x| x + rng.unit())));
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
                found(&path, throughput * surface.radiance);
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
        seen.filter_map(|it| Some((it.meets(origin, dir)?, it))).min_by(|a, b| a.0.total_cmp(&b.0))
    }

    /// Where the fog is met, if before `reach`.
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

    /// Distance along a ray, by Cramer's rule.
    fn meets(&self, origin: DVec3, dir: DVec3) -> Option<f64> {
        let [e1, e2] = self.edges;
        let p = dir.cross(e2);
        let scale = 1.0 / e1.dot(p);
        let s = origin - self.corner;
        let u = s.dot(p) * scale;
        let q = s.cross(e1);
        let v = dir.dot(q) * scale;
        let t = e2.dot(q) * scale;
        (u >= 0.0 && v >= 0.0 && u + v <= 1.0 && t > NEAR).then_some(t)
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
        let color = |tinted: &Tinted| DVec3::from(tinted.color) * tinted.amount;
        // A channel that asks for more light than the surface receives is divided by that (docs/formats.md).
        let limit = (color(&material.rd) + color(&material.rs)).max(DVec3::ONE);
        Self {
            diffuse: color(&material.rd) / limit,
            glossy: color(&material.rs) / limit,
            alpha: material.rs_alpha,
            radiance: color(&material.ed) * FRAC_1_PI,
            sides: material.sides,
        }
    }

    /// A direction and the factor on light from there, by the part of the reflection that is drawn, and that part;
    /// `None`: absorbed.
    /// - `normal`: on the side of `wo`.
    fn scatter(&self, normal: DVec3, wo: DVec3, rng: &mut Rng) -> Option<(DVec3, DVec3, Scatterer)> {
        // Chances of the parts: no smaller than their share in any channel, together at most 1 (a paint may be red, its gloss blue).
        let (diffuse, glossy) = (self.diffuse.max_element(), self.glossy.max_element());
        let both = (diffuse + glossy).max(1.0);
        let (diffuse, glossy) = (diffuse / both, glossy / both);
        let part = rng.unit();
        if part < diffuse {
            let wi = rng.direction(|wi| wi.dot(normal));
            Some((wi, self.diffuse / diffuse, Scatterer::Diffuse))
        } else if part < diffuse + glossy {
            let wi = rng.direction(|wi| f64::from(u8::from(wi.dot(normal) > 0.0)));
            Some((wi, self.glossy / glossy * (TAU * lobe(normal, wo, wi, self.alpha)), Scatterer::Glossy))
        } else {
            None
        }
    }
}

/// `D G2 / (4 cos_o cos_i) cos_i`, 1/sr: GGX with height-correlated Smith shadowing, \[heitz2014\].
fn lobe(normal: DVec3, wo: DVec3, wi: DVec3, alpha: f64) -> f64 {
    let square = alpha * alpha;
    let (cos_o, cos_i, cos_h) = (wo.dot(normal), wi.dot(normal), (wo + wi).normalize().dot(normal));
    let d = square * FRAC_1_PI / (cos_h * cos_h * (square - 1.0) + 1.0).powi(2);
    let slope = |cos: f64| (square + (1.0 - square) * cos * cos).sqrt();
    d * 0.5 * cos_i / (cos_o * slope(cos_i) + cos_i * slope(cos_o))
}

impl Fog {
    fn of(scene: &Scene) -> Option<Self> {
        let region = scene.regions.first()?;
        let medium = &scene.media[region.medium.index()];
        assert!(scene.regions.len() == 1 && region.bounds == RegionBounds::Everywhere, "one medium everywhere");
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

impl Eye {
    fn new(camera: &Camera) -> Self {
        assert!(camera.lens_radius == 0.0 && camera.along.is_none(), "a pinhole that stands still");
        let forward = (camera.target - camera.origin).normalize();
        let right = forward.cross(camera.up).normalize();
        let step = 2.0 * (0.5 * camera.fov).to_radians().tan() / f64::from(camera.film[1]);
        let steps = [right * step, forward.cross(right) * step];
        Self { origin: camera.origin, forward, steps, film: camera.film }
    }

    /// Through a place of the film, pixels from the top left.
    fn direction(&self, place: [f64; 2]) -> DVec3 {
        let [x, y] = [0, 1].map(|axis| place[axis] - 0.5 * f64::from(self.film[axis]));
        (self.forward + self.steps[0] * x + self.steps[1] * y).normalize()
    }
}

impl Rng {
    /// In 0..1, 1 excluded.
    fn unit(&mut self) -> f64 {
        (self.bits() >> 11) as f64 / (1u64 << 53) as f64
    }

    /// A unit direction with a density in proportion to `chance` (at most 1), by rejection.
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
    use super::Brute;
    use crate::scene;

    #[test]
    fn a_furnace_has_emittance_over_one_minus_reflectance_also_in_fog_that_absorbs_nothing() {
        let furnace = "camera main =\n origin .3 .2 .1\n target 1 .4 0\n fov 60\n film 8 8\nm wall =\n sides 2\n c\n rd .5\n\
             ed 3.14159265358979\nv a =\n p -1 -1 -1\nv b =\n p 1 -1 -1\nv c =\n p 1 1 -1\nv d =\n p -1 1 -1\nm wall\n\
             prism a b c d -2\n";
        let fog = "medium fog =\n sigma_s .8\n phase hg .5\nmglobal fog\n";
        for text in [furnace.to_owned(), format!("{furnace}{fog}")] {
            let image = Brute::new(&scene(&text)).image(1, 2000);
            let n = image.pixels.len();
            let mean = (0..n).map(|at| f64::from(image.luminance(at))).sum::<f64>() / n as f64;
            // The number of walls met is geometric, of mean and variance 2: four standard errors.
            let error = (2.0 / (n as f64 * 2000.0)).sqrt();
            assert!((mean - 2.0).abs() <= 4.0 * error, "{mean} +- {error}");
        }
    }
}
