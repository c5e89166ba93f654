use super::{ImageId, Location, MediumId};
use femc_math::color::LUMINANCE_WEIGHTS;
use serde::{Deserialize, Serialize};

/// A scalar with a color. The value is the product of both; selectors set `amount`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct TintedScalar {
    /// The scalar of the file (reflectance, transmittance, or emittance in lm/m2).
    pub amount: f64,
    /// Linear Rec.709; luminance 1 unless it was given as raw RGB.
    pub color: [f64; 3],
}

impl TintedScalar {
    /// Returns the Rec.709 luminance of the product: the photometric reflectance, transmittance or emittance. It equals the amount
    /// if the color has luminance 1, and is less for a darker raw RGB.
    pub fn photometric_amount(&self) -> f64 {
        let weights = LUMINANCE_WEIGHTS.to_array().map(f64::from);
        let weighted: f64 = self.color.iter().zip(weights).map(|(channel, weight)| channel * weight).sum();
        self.amount * weighted / weights.iter().sum::<f64>()
    }
}

impl Default for TintedScalar {
    fn default() -> Self {
        Self { amount: 0.0, color: [1.0; 3] }
    }
}

/// Sides of a surface that exist.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum Sides {
    /// Invisible from behind, unless the material has an index of refraction: then the surface bounds a solid.
    One,
    /// Looks the same from both sides and emits from both.
    #[default]
    Two,
}

/// Complex index of refraction.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Ior {
    /// Real part.
    pub re: f64,
    /// Imaginary part; > 0 for conductors.
    pub im: f64,
}

/// A material; the default is a two-sided black absorber.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Material {
    /// Name; empty for the unnamed material.
    pub name: String,
    /// Location of the material's definition.
    pub location: Location,
    /// Sidedness.
    pub sides: Sides,
    /// Diffuse reflectance.
    pub rd: TintedScalar,
    /// Diffuse transmittance.
    pub td: TintedScalar,
    /// Specular reflectance.
    pub rs: TintedScalar,
    /// GGX roughness of `rs`; 0 = mirror.
    pub rs_alpha: f64,
    /// Specular transmittance.
    pub ts: TintedScalar,
    /// GGX roughness of `ts`.
    pub ts_alpha: f64,
    /// Index of refraction, if given.
    pub ior: Option<Ior>,
    /// Emittance, lm/m2.
    pub ed: TintedScalar,
    /// Exponent n of the emission lobe: radiance = ed (n+2)/(2 pi) cos^n; `None`: Lambertian.
    pub lobe: Option<f64>,
    /// Medium behind the surface.
    pub inside: Option<MediumId>,
    /// Texture that multiplies `rd`.
    pub map_rd: Option<ImageId>,
    /// Texture that multiplies `ed`.
    pub map_ed: Option<ImageId>,
    /// Tangent-space normal map.
    pub map_n: Option<ImageId>,
}

/// A part of a material's scattering: a fraction of the light. Scene files, selectors, checks and layers know the parts from here.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ScatteringPart {
    /// `rd`
    DiffuseReflection,
    /// `td`
    DiffuseTransmission,
    /// `rs`
    SpecularReflection,
    /// `ts`
    SpecularTransmission,
}

impl ScatteringPart {
    /// All parts.
    pub const ALL: [Self; 4] =
        [Self::DiffuseReflection, Self::DiffuseTransmission, Self::SpecularReflection, Self::SpecularTransmission];
    /// Sum of the parts, for messages.
    pub const SUM: &str = "rd + td + rs + ts";

    /// Returns the name of the fraction in scene files and selectors.
    pub fn name(self) -> &'static str {
        match self {
            Self::DiffuseReflection => "rd",
            Self::DiffuseTransmission => "td",
            Self::SpecularReflection => "rs",
            Self::SpecularTransmission => "ts",
        }
    }

    /// Returns the name of the roughness in selectors; `None`: the part is diffuse.
    pub fn roughness_name(self) -> Option<&'static str> {
        match self {
            Self::DiffuseReflection | Self::DiffuseTransmission => None,
            Self::SpecularReflection => Some("rs_alpha"),
            Self::SpecularTransmission => Some("ts_alpha"),
        }
    }

    /// Returns whether the part leaves the surface on its other side.
    pub fn is_transmitted(self) -> bool {
        match self {
            Self::DiffuseReflection | Self::SpecularReflection => false,
            Self::DiffuseTransmission | Self::SpecularTransmission => true,
        }
    }

    /// Returns the fraction of the light.
    pub fn fraction(self, material: &Material) -> &TintedScalar {
        match self {
            Self::DiffuseReflection => &material.rd,
            Self::DiffuseTransmission => &material.td,
            Self::SpecularReflection => &material.rs,
            Self::SpecularTransmission => &material.ts,
        }
    }

    /// Returns the fraction of the light, for a change.
    pub fn fraction_mut(self, material: &mut Material) -> &mut TintedScalar {
        match self {
            Self::DiffuseReflection => &mut material.rd,
            Self::DiffuseTransmission => &mut material.td,
            Self::SpecularReflection => &mut material.rs,
            Self::SpecularTransmission => &mut material.ts,
        }
    }

    /// Returns the GGX roughness, for a change; `None`: the part is diffuse.
    pub fn roughness_mut(self, material: &mut Material) -> Option<&mut f64> {
        match self {
            Self::DiffuseReflection | Self::DiffuseTransmission => None,
            Self::SpecularReflection => Some(&mut material.rs_alpha),
            Self::SpecularTransmission => Some(&mut material.ts_alpha),
        }
    }

    /// Returns the GGX roughness; `None`: the part is diffuse.
    pub fn roughness(self, material: &Material) -> Option<f64> {
        match self {
            Self::DiffuseReflection | Self::DiffuseTransmission => None,
            Self::SpecularReflection => Some(material.rs_alpha),
            Self::SpecularTransmission => Some(material.ts_alpha),
        }
    }
}

impl Material {
    /// Maximum of [`Self::reflectance_sum`]: 1 plus a tolerance for rounded decimals.
    pub const SUM_LIMIT: f64 = 1.0 + 1e-4;

    /// Returns the share of equal-energy light that the surface reflects and transmits in total, photometrically: the sum of its
    /// [parts](ScatteringPart), each times the luminance of its color.
    pub fn reflectance_sum(&self) -> f64 {
        ScatteringPart::ALL.iter().map(|part| part.fraction(self).photometric_amount()).sum()
    }

    /// Returns the share of a channel's light (0 red, 1 green, 2 blue) that all parts of the material demand together. The renderer
    /// limits a channel that demands more than 1.
    ///
    /// Parts below an interface with an index of refraction receive only the light that the interface does not reflect, so they do
    /// not compete with it.
    pub fn channel_demand(&self, channel: usize) -> f64 {
        let [rd, td, rs, ts] =
            [&self.rd, &self.td, &self.rs, &self.ts].map(|part| (part.amount * part.color[channel]).max(0.0));
        let index = self.ior.filter(|ior| (ior.re, ior.im) != (1.0, 0.0));
        match (index, self.sides) {
            (Some(Ior { im, .. }), Sides::One) if im == 0.0 && self.ts.amount > 0.0 => rd + td + ts,
            (Some(_), _) if self.ts.amount == 0.0 => (rd + td).max(rs),
            _ => rd + td + rs + ts,
        }
    }
}
