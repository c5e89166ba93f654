//! Interaction of a path with a surface: shading frame, sides, and the media behind it.

use femc_emission::BsdfLobes;
use femc_geometry::{Hit, Ray, offset_origin};
use femc_math::Frame;
use femc_math::glam::Vec3A;
use femc_prepared::media::MediumStack;
use femc_prepared::{Crossing, KernelMaterial, Orientation, Prepared, ShadingPoint};
use femc_scattering::Bsdf;
use std::borrow::Cow;

/// A point that a ray hit, with its BSDF and shading frame.
#[derive(Clone)]
pub(crate) struct SurfaceInteraction<'s> {
    /// Instance and primitive.
    pub hit: Hit,
    /// Point of the surface.
    pub point: ShadingPoint,
    /// Material there.
    pub material: &'s KernelMaterial,
    /// Whether the ray hit the back side.
    pub back: bool,
    /// Passage of light straight through the surface.
    pub crossing: Crossing,
    /// BSDF with the texture's color.
    pub bsdf: Cow<'s, Bsdf>,
    /// Shading frame.
    pub frame: Frame,
    /// Outgoing direction, toward the ray's origin, local frame.
    pub wo: Vec3A,
}

impl<'s> SurfaceInteraction<'s> {
    /// Creates the interaction of `ray` with the surface at `point`.
    #[inline(always)]
    pub fn new(scene: &'s Prepared, ray: &Ray, hit: Hit, point: ShadingPoint) -> Self {
        let material = &scene.materials[point.material as usize];
        let back = point.normal.dot(ray.dir) > 0.0;
        let crossing = material.crossing[usize::from(back)];
        let bsdf = match material.map_rd {
            None => Cow::Borrowed(&material.bsdf),
            Some(map) => Cow::Owned(material.textured_bsdf(scene.textures[map as usize].lookup(point.uv))),
        };
        let (frame, wo) = local_wo(material, &point, ray.dir);
        Self { hit, point, material, back, crossing, bsdf, frame, wo }
    }

    /// Returns the normal of the side from which light is scattered, as context for the choice of a light; zero if the surface
    /// transmits light.
    #[inline]
    pub fn lit_side(&self) -> Vec3A {
        if self.bsdf.transmits() {
            Vec3A::ZERO
        } else if self.back {
            -self.point.normal
        } else {
            self.point.normal
        }
    }

    /// Returns the lobes toward a viewer who looks along `dir`, if they contain more information than the normal.
    #[inline]
    pub fn lobes(&self, dir: Vec3A) -> Option<BsdfLobes> {
        let (diffuse, glossy, alpha) = self.bsdf.glossy_lobes(self.wo)?;
        Some(BsdfLobes { diffuse, glossy, alpha, wo: -dir })
    }

    /// Checks whether shading and geometry agree on the side of an incident direction.
    /// - `wi`, `dir`: the direction in the local and in the prepared frame, unit.
    #[inline]
    pub fn sides_agree(&self, wi: Vec3A, dir: Vec3A) -> bool {
        // The frame's normal may point away from the front side.
        let turned = self.frame.normal.dot(self.point.normal) < 0.0;
        (wi.z > 0.0) == (self.leaves_front(dir) != turned)
    }

    /// Checks whether a direction points to the front side.
    #[inline]
    pub fn leaves_front(&self, dir: Vec3A) -> bool {
        self.point.normal.dot(dir) > 0.0
    }

    /// Updates the media of a path that goes through the surface.
    #[inline]
    pub fn cross_boundary(&self, medium_stack: &mut MediumStack) {
        cross_boundary(medium_stack, self.material, self.back);
    }

    /// Returns the rest of `ray` behind the surface.
    #[inline]
    pub fn ray_behind(&self, ray: &Ray) -> Ray {
        Ray { origin: offset_origin(self.point.position, self.point.error, self.point.normal, ray.dir), ..*ray }
    }
}

/// Returns the shading frame, and the direction toward the viewer in it.
#[inline]
fn local_wo(material: &KernelMaterial, point: &ShadingPoint, dir: Vec3A) -> (Frame, Vec3A) {
    let outward = -dir;
    let back = point.normal.dot(outward) < 0.0;
    let mut shading = point.shading_normal;
    if back && material.orientation == Orientation::TowardViewer {
        shading = -shading;
    }
    let mut frame = Frame::from_normal(shading);
    let mut wo = frame.to_local(outward);
    // An interpolated normal may put the viewer on the wrong side of the surface. Then the geometric normal is used for shading.
    let expected_front = !back || material.orientation == Orientation::TowardViewer;
    if (wo.z > 0.0) != expected_front {
        let normal =
            if back && material.orientation == Orientation::TowardViewer { -point.normal } else { point.normal };
        frame = Frame::from_normal(normal);
        wo = frame.to_local(outward);
    }
    (frame, wo)
}

/// Updates the media when the path crosses a surface, from the front into the object or back out.
#[inline]
pub(crate) fn cross_boundary(medium_stack: &mut MediumStack, material: &KernelMaterial, from_back: bool) {
    if let Some(medium) = material.interior_medium {
        if from_back { medium_stack.remove(medium) } else { medium_stack.push(medium) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_scene::prepare;

    /// Two balls of different media that overlap along the x axis, a ball of a third medium within the second, and a
    /// triangle above whose shading normals are tilted.
    const SCENE: &str = "\
medium a =
 sigma_s .1
medium b =
 sigma_s .2
medium c =
 sigma_s .3
m glass =
 sides 1
 ts 1 0
 inside a
m ice =
 sides 1
 ts 1 0
 inside b
m jelly =
 sides 1
 ts 1 0
 inside c
m wall =
 sides 2
 c
 rd .5
v p =
 p -.5 0 0
m glass
sph p 1
v q =
 p .5 0 0
m ice
sph q 1
v r =
 p .9 0 0
m jelly
sph r .2
m wall
v s =
 p -1 -1 3
 n .6 0 .8
v t =
 p 1 -1 3
 n .6 0 .8
v u =
 p 0 1 3
 n .6 0 .8
f s t u
";

    fn interaction<'s>(scene: &'s Prepared, ray: &Ray) -> SurfaceInteraction<'s> {
        let hit = scene.world.intersect(ray).expect("a surface");
        SurfaceInteraction::new(scene, ray, hit, scene.shading_point(ray, &hit))
    }

    /// Returns directions that cover the sphere evenly.
    fn directions() -> impl Iterator<Item = Vec3A> {
        const N: usize = 500;
        (0..N).map(|k| {
            let z = 1.0 - 2.0 * (k as f32 + 0.5) / N as f32;
            let (sin, cos) = femc_math::elementary::sin_cos(2.399_963_2 * k as f32);
            let radius = (1.0 - z * z).sqrt();
            Vec3A::new(radius * cos, radius * sin, z)
        })
    }

    /// Returns a ray from a point of the world.
    fn ray(scene: &Prepared, origin: [f32; 3], dir: [f32; 3]) -> Ray {
        let origin = Vec3A::from(origin) - scene.origin.as_vec3a();
        Ray { origin, dir: Vec3A::from(dir).normalize(), t_max: f32::INFINITY, time: 0.5 }
    }

    #[test]
    fn sides_agree_where_both_normals_see_a_direction_alike() {
        let scene = prepare(SCENE);
        let rays = [
            ray(&scene, [-4.0, 0.0, 0.1], [1.0, 0.0, 0.0]),
            ray(&scene, [-1.0, 0.0, 0.1], [-1.0, 0.2, 0.0]),
            ray(&scene, [0.0, -0.2, 4.0], [0.1, 0.0, -1.0]),
            ray(&scene, [0.0, -0.2, 2.0], [0.1, 0.0, 1.0]),
        ];
        for ray in rays {
            let surface = interaction(&scene, &ray);
            let SurfaceInteraction { point, frame, .. } = &surface;
            let mut disagree = 0;
            for dir in directions() {
                let (geometric, shading) = (point.normal.dot(dir), point.shading_normal.dot(dir));
                let agree = surface.sides_agree(frame.to_local(dir), dir);
                if geometric.abs() > 1e-3 && shading.abs() > 1e-3 {
                    assert_eq!(agree, (geometric > 0.0) == (shading > 0.0), "{ray:?} {dir}");
                    assert_eq!(surface.leaves_front(dir), geometric > 0.0);
                }
                disagree += usize::from(!agree);
            }
            assert_eq!(disagree > 10, point.normal.dot(point.shading_normal) < 0.99, "{ray:?}: {disagree}");
            assert!(surface.wo.z > 0.0 || surface.material.orientation == Orientation::Front, "{ray:?}");
        }
    }

    /// Media between the surfaces along the x axis: none, a, a and b, b, b and c, b, none, and back.
    #[test]
    fn media_change_at_each_boundary_and_end_as_they_began() {
        let scene = prepare(SCENE);
        let medium = |name: &str| scene.scene.media.iter().position(|it| it.name == name).expect("a medium") as u16;
        let [a, b, c] = ["a", "b", "c"].map(medium);
        let forth: [&[u16]; 7] = [&[], &[a], &[a, b], &[b], &[b, c], &[b], &[]];
        // On the way back, b is entered before a is.
        let back: [&[u16]; 7] = [&[], &[b], &[b, c], &[b], &[b, a], &[a], &[]];
        for (start, dir, expected) in [(-4.0, 1.0, forth), (4.0, -1.0, back)] {
            let mut stack = MediumStack::default();
            let mut ray = ray(&scene, [start, 0.01, 0.02], [dir, 0.0, 0.0]);
            for (number, media) in expected.into_iter().enumerate() {
                assert_eq!(stack.iter().collect::<Vec<_>>(), media, "{dir}: after {number} surfaces");
                if number + 1 < expected.len() {
                    let surface = interaction(&scene, &ray);
                    surface.cross_boundary(&mut stack);
                    ray = surface.ray_behind(&ray);
                }
            }
            assert!(scene.world.intersect(&ray).is_none());
        }
    }

    #[test]
    fn leaving_a_medium_that_was_not_entered_changes_nothing() {
        let scene = prepare(SCENE);
        let inside = interaction(&scene, &ray(&scene, [1.3, 0.0, 0.0], [1.0, 0.0, 0.0]));
        assert!(inside.back && inside.material.interior_medium.is_some());
        let mut stack = scene.camera_medium_stack;
        inside.cross_boundary(&mut stack);
        assert_eq!(stack.iter().count(), 0);
    }
}
