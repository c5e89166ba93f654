//! Interaction of a path with a surface: shading frame, sides, and the media behind it.

use femc_emission::BsdfLobes;
use femc_geometry::{Hit, Ray, offset_origin};
use femc_math::Frame;
use femc_math::glam::Vec3A;
use femc_prepared::media::MediumStack;
use femc_prepared::{Crossing, KernelMaterial, Orientation, Prepared, ShadingPoint};
use femc_scattering::Bsdf;

/// A point that a ray hit, with its BSDF and shading frame.
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
    pub bsdf: Bsdf,
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
            None => material.bsdf,
            Some(map) => material.textured_bsdf(scene.textures[map as usize].lookup(point.uv)),
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
