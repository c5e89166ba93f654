//! Distribution of the light between a specular part and the diffuse part below it.

use crate::Fresnel;
use femc_math::Rgb;

/// A specular reflectance `R(w) = rs F(|cos w|)` above a diffuse part.
///
/// Without an index of refraction, both parts are used as given. With one, the diffuse part is multiplied by
/// `(1 - R(wo)) (1 - R(wi)) / (1 - R_mean)`, where `R_mean` is the cosine-weighted mean of R (\[kelemen2001\]). This is reciprocal,
/// and its directional albedo is exactly `rd (1 - R(wo))`, the light that the specular part leaves. Rough lobes use the R of the
/// smooth surface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Coat {
    /// Specular reflectance before the Fresnel factor.
    pub rs: Rgb,
    /// Fresnel factor.
    pub fresnel: Fresnel,
    /// `1 / (1 - R_mean)`; 1 without an index.
    normalization: Rgb,
}

impl Coat {
    /// Precomputes the mean reflectance.
    pub fn new(rs: Rgb, fresnel: Fresnel) -> Self {
        let normalization = match fresnel {
            Fresnel::Unit => Rgb::ONE,
            Fresnel::Dielectric { .. } | Fresnel::Conductor { .. } => {
                (Rgb::ONE - rs * fresnel.mean()).max(Rgb::splat(1e-6)).recip()
            }
        };
        Self { rs, fresnel, normalization }
    }

    /// Returns `1 / (1 - R_mean)`; 1 without an index.
    #[inline]
    pub fn normalization(&self) -> Rgb {
        self.normalization
    }

    /// Returns R at `cos` in [0, 1].
    #[inline]
    pub fn reflectance(&self, cos: f32) -> Rgb {
        self.rs * self.fresnel.eval(cos)
    }

    /// Returns the light that the specular part leaves at `cos`: the factor on the diffuse part's directional albedo.
    #[inline]
    pub fn transmitted(&self, cos: f32) -> Rgb {
        match self.fresnel {
            Fresnel::Unit => Rgb::ONE,
            Fresnel::Dielectric { .. } | Fresnel::Conductor { .. } => Rgb::ONE - self.reflectance(cos),
        }
    }

    /// Returns the factor on the diffuse part's `f` for a pair of directions.
    #[inline]
    pub fn diffuse_factor(&self, cos_o: f32, cos_i: f32) -> Rgb {
        match self.fresnel {
            Fresnel::Unit => Rgb::ONE,
            Fresnel::Dielectric { .. } | Fresnel::Conductor { .. } => {
                self.transmitted(cos_o) * self.transmitted(cos_i) * self.normalization
            }
        }
    }
}
