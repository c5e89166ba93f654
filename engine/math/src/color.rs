//! Linear Rec.709 colour.

/// Linear Rec.709 triple; as a radiance its Rec.709 luminance is in cd/m2 per steradian-free convention of the
/// scene format (radiance in cd/m2). A `Vec3A`, so that a triple is one SIMD register.
pub type Rgb = glam::Vec3A;

/// Rec.709 luminance weights.
pub const LUMINANCE_WEIGHTS: Rgb = Rgb::from_array([0.212_639, 0.715_168_7, 0.072_192_32]);

/// Rec.709 luminance of `color`, in the unit of `color`.
#[inline]
pub fn luminance(color: Rgb) -> f32 {
    color.dot(LUMINANCE_WEIGHTS)
}
