//! Shared mathematics: the glam re-export, elementary functions with the same bits on every machine, orthonormal frames, warps,
//! counter-based randomness and scrambled Sobol points.
//!
//! Everything here is a pure function of its arguments. Transcendental functions come from the `libm` crate or are polynomials
//! (see [`elementary`]). They never come from the platform, so all machines of a mixed farm render the same picture.
#![deny(missing_docs)]

pub mod color;
pub mod elementary;
pub mod frame;
pub mod hash;
pub mod sampler;
pub mod transform;
pub mod warp;

pub use color::Rgb;
pub use frame::Frame;
pub use glam;
pub use sampler::SampleStream;
pub use transform::Transform;

/// Computes the cross product and rounds each product. The function of glam fuses one product where the compiler may use FMA, so
/// its bits depend on the target.
#[inline]
pub fn cross(a: glam::Vec3A, b: glam::Vec3A) -> glam::Vec3A {
    use glam::Vec3Swizzles;
    (a.zxy() * b - b.zxy() * a).zxy()
}

/// Relative error bound of `n` chained f32 operations, `n eps / (1 - n eps)` with `eps = 2^-24` (\[higham2002\]).
#[inline]
pub const fn gamma(n: u32) -> f32 {
    const EPSILON: f32 = f32::EPSILON * 0.5;
    (n as f32 * EPSILON) / (1.0 - n as f32 * EPSILON)
}
