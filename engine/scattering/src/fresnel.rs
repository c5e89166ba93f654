//! Fresnel reflectance of unpolarized light.

/// Factor on a specular lobe.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum Fresnel {
    /// Factor 1 for every angle: materials without an index of refraction.
    #[default]
    Unit,
    /// A dielectric with relative index `eta` (other side over this side).
    Dielectric {
        /// Relative index of refraction, > 0.
        eta: f32,
    },
    /// A conductor with the complex relative index `eta + i k`.
    Conductor {
        /// Real part.
        eta: f32,
        /// Imaginary part, > 0.
        k: f32,
    },
}

impl Fresnel {
    /// Returns the reflectance, in [0, 1], at an angle of incidence with cosine `cos` in [0, 1].
    #[inline]
    pub fn eval(self, cos: f32) -> f32 {
        match self {
            Self::Unit => 1.0,
            Self::Dielectric { eta } => dielectric(cos, eta).reflectance,
            Self::Conductor { eta, k } => conductor(cos, eta, k),
        }
    }

    /// Returns the cosine-weighted mean over the hemisphere, `2 int F(c) c dc`, by 512 midpoints in `c^2` (error below 1e-4).
    ///
    /// The mean on the denser side of a dielectric follows from that on the other side, `1 - F = eta^2 (1 - F')`, because its cone
    /// of refraction can be narrower than the distance of two midpoints.
    pub fn mean(self) -> f32 {
        const N: u32 = 512;
        if let Self::Dielectric { eta } = self
            && eta < 1.0
        {
            return 1.0 - self.transmitted_mean();
        }
        let sum: f64 = (0..N).map(|i| f64::from(self.eval(((f64::from(i) + 0.5) / f64::from(N)).sqrt() as f32))).sum();
        (sum / f64::from(N)) as f32
    }

    /// Returns `1 - mean()` without the rounding error of that difference for small indices.
    pub fn transmitted_mean(self) -> f32 {
        match self {
            Self::Dielectric { eta } if eta < 1.0 => eta * eta * (1.0 - Self::Dielectric { eta: 1.0 / eta }.mean()),
            other => 1.0 - other.mean(),
        }
    }
}

/// Reflectance and refraction of a smooth dielectric interface at one angle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Interface {
    /// Reflectance; 1 beyond the critical angle.
    pub reflectance: f32,
    /// Cosine of the refracted direction with the normal on the other side; 0 beyond the critical angle.
    pub cos_transmitted: f32,
}

/// Computes the exact Fresnel equations for relative index `eta` (other side over the side of incidence) and cosine `cos` in [0,
/// 1].
#[inline]
pub fn dielectric(cos: f32, eta: f32) -> Interface {
    let sin2_transmitted = (1.0 - cos) * (1.0 + cos) / (eta * eta);
    if sin2_transmitted >= 1.0 {
        return Interface { reflectance: 1.0, cos_transmitted: 0.0 };
    }
    let cos_transmitted = (1.0 - sin2_transmitted).sqrt();
    let s = (cos - eta * cos_transmitted) / (cos + eta * cos_transmitted);
    let p = (eta * cos - cos_transmitted) / (eta * cos + cos_transmitted);
    Interface { reflectance: (0.5 * (s * s + p * p)).min(1.0), cos_transmitted }
}

/// Computes the exact Fresnel equations for the complex relative index `eta + i k` and cosine `cos` in [0, 1].
#[inline]
pub fn conductor(cos: f32, eta: f32, k: f32) -> f32 {
    let cos2 = cos * cos;
    let sin2 = 1.0 - cos2;
    let real = eta * eta - k * k - sin2;
    let modulus = (real * real + 4.0 * eta * eta * k * k).sqrt();
    let a = (0.5 * (modulus + real)).max(0.0).sqrt();
    let s_sum = modulus + cos2;
    let s_cross = 2.0 * cos * a;
    let s = (s_sum - s_cross) / (s_sum + s_cross);
    let p_sum = cos2 * modulus + sin2 * sin2;
    let p_cross = s_cross * sin2;
    let p = s * (p_sum - p_cross) / (p_sum + p_cross);
    (0.5 * (s + p)).clamp(0.0, 1.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn dielectric_reflectance_has_the_textbook_values() {
        assert!((dielectric(1.0, 1.5).reflectance - 0.04).abs() < 1e-6);
        assert!((dielectric(0.0, 1.5).reflectance - 1.0).abs() < 1e-6);
        // At Brewster's angle the parallel part vanishes. Half the squared perpendicular part is left.
        let cos = 1.0 / (1.0f32 + 1.5 * 1.5).sqrt();
        let s = (1.0f32 - 1.5 * 1.5) / (1.0 + 1.5 * 1.5);
        assert!((dielectric(cos, 1.5).reflectance - 0.5 * s * s).abs() < 1e-6);
        assert_eq!(dielectric(0.5, 1.0 / 1.5).reflectance, 1.0, "total internal reflection");
        assert!(dielectric(0.3, 1.0).reflectance < 1e-12, "index-matched");
    }

    #[test]
    fn reflectance_is_the_same_from_both_sides_of_one_ray() {
        for i in 5..=100 {
            let there = dielectric(i as f32 / 100.0, 1.33);
            let back = dielectric(there.cos_transmitted, 1.0 / 1.33);
            assert!((there.reflectance - back.reflectance).abs() < 5e-5, "{there:?} {back:?}");
        }
    }

    #[test]
    fn conductor_without_absorption_is_dielectric_and_silver_bright() {
        for i in 1..=100 {
            let cos = i as f32 / 100.0;
            assert!((conductor(cos, 1.5, 0.0) - dielectric(cos, 1.5).reflectance).abs() < 2e-5);
        }
        let normal = ((0.2f32 - 1.0).powi(2) + 3.9 * 3.9) / ((0.2f32 + 1.0).powi(2) + 3.9 * 3.9);
        assert!((conductor(1.0, 0.2, 3.9) - normal).abs() < 1e-6);
    }

    #[test]
    fn mean_glass_reflectance_matches_published_and_inside_values() {
        // Diffuse Fresnel reflectance for n = 1.5: 0.0918 outside, 0.5963 inside (\[duntley1942\] and many since).
        let outside = Fresnel::Dielectric { eta: 1.5 }.mean();
        let inside = Fresnel::Dielectric { eta: 1.0 / 1.5 }.mean();
        assert!((outside - 0.0918).abs() < 2e-4 && (inside - 0.5963).abs() < 5e-4, "{outside} {inside}");
        assert!(((1.0 - outside) - 1.5 * 1.5 * (1.0 - inside)).abs() < 2e-3);
    }
}
