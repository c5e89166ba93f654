//! Functions of direction by nine spherical harmonics, which suffice for the light that Lambertian surfaces receive and send
//! (\[ramamoorthi2001\]).

use femc_math::Rgb;
use femc_math::color::luminance;
use femc_math::glam::Vec3A;
use std::f32::consts::PI;
use std::ops::{Add, AddAssign, Mul};

/// Coefficients of the real spherical harmonics up to degree 2.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Harmonics(pub [Rgb; 9]);

/// Coefficients of the clamped cosine around a direction, by degree: the function is the sum over the harmonics of these
/// coefficients times their values at the direction and at the point.
const COSINE: [f32; 3] = [PI, 2.0 * PI / 3.0, PI / 4.0];

/// Returns the values of the nine harmonics in a unit direction.
fn values(w: Vec3A) -> [f32; 9] {
    const ONE: [f32; 2] = [0.282_094_8, 0.488_602_5];
    const TWO: [f32; 3] = [1.092_548_4, 0.315_391_57, 0.546_274_2];
    [
        ONE[0],
        ONE[1] * w.y,
        ONE[1] * w.z,
        ONE[1] * w.x,
        TWO[0] * w.x * w.y,
        TWO[0] * w.y * w.z,
        TWO[1] * (3.0 * w.z * w.z - 1.0),
        TWO[0] * w.x * w.z,
        TWO[2] * (w.x * w.x - w.y * w.y),
    ]
}

/// Degree of each harmonic.
const DEGREE: [usize; 9] = [0, 1, 1, 1, 2, 2, 2, 2, 2];

impl Harmonics {
    /// Zero function.
    pub const ZERO: Self = Self([Rgb::ZERO; 9]);

    /// Creates the function with all of `amount` in the unit direction `w`.
    pub fn from_direction(w: Vec3A, amount: Rgb) -> Self {
        Self(values(w).map(|value| amount * value))
    }

    /// Creates the constant function with which a surface of any normal receives this irradiance.
    pub fn from_irradiance(irradiance: Rgb) -> Self {
        let mut out = Self::ZERO;
        out.0[0] = irradiance * (4.0 * 0.282_094_8);
        out
    }

    /// Returns the sum of the parts, each times the clamped cosine between its direction and `w` (unit). For light by its origin,
    /// this is the irradiance of a surface with that normal. For surfaces' area times radiance by their normals, it is the
    /// intensity in that direction. It is accurate to some percent of the greatest value, and never negative.
    pub fn cosine_integral(&self, w: Vec3A) -> Rgb {
        let mut sum = Rgb::ZERO;
        for ((part, value), degree) in self.0.iter().zip(values(w)).zip(DEGREE) {
            sum += *part * (value * COSINE[degree]);
        }
        sum.max(Rgb::ZERO)
    }

    /// Returns the sum of the parts' luminance times their unit directions.
    pub fn luminance_vector(&self) -> Vec3A {
        let [y, z, x] = [1, 2, 3].map(|k| luminance(self.0[k]) / 0.488_602_5);
        Vec3A::new(x, y, z)
    }

    /// Returns the sum of the parts, independent of their directions.
    pub fn total(&self) -> Rgb {
        // The first harmonic is constant.
        self.0[0] / 0.282_094_8
    }
}

impl Add for Harmonics {
    type Output = Self;

    fn add(mut self, other: Self) -> Self {
        self += other;
        self
    }
}

impl AddAssign for Harmonics {
    fn add_assign(&mut self, other: Self) {
        self.0.iter_mut().zip(other.0).for_each(|(a, b)| *a += b);
    }
}

impl Mul<Rgb> for Harmonics {
    type Output = Self;

    fn mul(self, factor: Rgb) -> Self {
        Self(self.0.map(|part| part * factor))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn harmonics_match_clamped_cosine_and_average_a_quarter() {
        let towards = |k: u32, n: u32| {
            let z = 1.0 - (2 * k + 1) as f32 / n as f32;
            femc_math::warp::direction(z, (k as f32 * 0.618_034).fract())
        };
        let from = towards(17, 100);
        let light = Harmonics::from_direction(from, Rgb::ONE);
        for k in 0..100 {
            let n = towards(k, 100);
            assert!(
                (light.cosine_integral(n).x - n.dot(from).max(0.0)).abs() < 0.1,
                "{n}: {}",
                light.cosine_integral(n)
            );
        }
        assert!((light.luminance_vector() - from).length() < 1e-5, "{}", light.luminance_vector());
        let mut all = Harmonics::ZERO;
        (0..1000).for_each(|k| all += Harmonics::from_direction(towards(k, 1000), Rgb::ONE));
        assert!((all.total().y - 1000.0).abs() < 1e-2);
        for k in 0..100 {
            assert!((all.cosine_integral(towards(k, 100)).z - 250.0).abs() < 1.0, "the mean of the clamped cosine");
        }
    }
}
