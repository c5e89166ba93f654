//! Linear Rec.709 color.

/// Linear Rec.709 triple. As a radiance, its luminance is in cd/m2, the radiance unit of the scene format. The type is a `Vec3A`,
/// so a triple fits in one SIMD register.
pub type Rgb = glam::Vec3A;

/// Rec.709 luminance weights.
pub const LUMINANCE_WEIGHTS: Rgb = Rgb::from_array([0.212_639, 0.715_168_7, 0.072_192_32]);

/// Returns the Rec.709 luminance of `color`, in the unit of `color`.
#[inline]
pub fn luminance(color: Rgb) -> f32 {
    color.dot(LUMINANCE_WEIGHTS)
}
