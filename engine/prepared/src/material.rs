//! Materials in the form that the kernels read.

use crate::texture::Texture;
use femc_math::Rgb;
use femc_math::glam::{Vec2, Vec3A};
use femc_scattering::{Bsdf, MaterialParameters, Sides as KernelSides};
use femc_scene::{Material, ScatteringPart, Sides, TintedScalar};

/// Effect of a surface on light that hits it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Crossing {
    /// Scattering by the BSDF.
    Scatter,
    /// Scattering by the BSDF, with a part that goes straight on: a clear sheet. Shadow rays pass with that part.
    Clear {
        /// Share of the radiance that goes straight on.
        tint: Rgb,
    },
    /// All light goes straight on, multiplied by the tint. This is an index-matched clear interface that only bounds a medium.
    Null {
        /// Factor on the radiance.
        tint: Rgb,
    },
}

impl Crossing {
    /// Returns the share of the radiance that goes straight on.
    #[inline]
    pub fn straight_through(self) -> Rgb {
        match self {
            Self::Scatter => Rgb::ZERO,
            Self::Clear { tint } | Self::Null { tint } => tint,
        }
    }
}

/// A material of a prepared frame.
#[derive(Clone, Debug)]
pub struct KernelMaterial {
    /// Scattering where no texture changes it.
    pub bsdf: Bsdf,
    /// Parameters of the description. In `bsdf` they are limited to the light that the surface receives.
    pub parameters: MaterialParameters,
    /// Effects on light from the front and from the back.
    pub crossing: [Crossing; 2],
    /// Orientation of the shading frame: toward the viewer if there is no solid behind the surface.
    pub orientation: Orientation,
    /// Medium behind the surface.
    pub interior_medium: Option<u16>,
    /// Texture of `rd`.
    pub map_rd: Option<u32>,
    /// Texture of `ed`.
    pub map_ed: Option<u32>,
    /// Normal map.
    pub map_n: Option<u32>,
}

/// Orientation of the shading frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Orientation {
    /// The frame's normal is turned to the side from which the path comes.
    TowardViewer,
    /// The frame's normal stays on the front side (solids).
    Front,
}

/// Returns the linear Rec.709 product of a scalar and its color; channels are at least 0 and finite.
fn product(tinted: &TintedScalar) -> Rgb {
    Rgb::from_array(tinted.color.map(|c| (c * tinted.amount).clamp(0.0, f64::from(f32::MAX)) as f32))
}

impl KernelMaterial {
    /// Converts a description. A channel that demands more light than the surface receives (a saturated color of luminance 1 can)
    /// is limited, see [`MaterialParameters::energy_conserving`]; the import warns of it.
    pub fn new(material: &Material) -> Self {
        let parameters = MaterialParameters {
            sides: match material.sides {
                Sides::One => KernelSides::One,
                Sides::Two => KernelSides::Two,
            },
            rd: product(&material.rd),
            td: product(&material.td),
            rs: product(&material.rs),
            ts: product(&material.ts),
            rs_alpha: material.rs_alpha as f32,
            ts_alpha: material.ts_alpha as f32,
            ior: material.ior.map(|i| (i.re as f32, i.im as f32)),
        };
        let solid = material.sides == Sides::One && material.ior.is_some();
        let matched = solid
            && material.ior.is_some_and(|i| i.re == 1.0 && i.im == 0.0)
            && material.ts_alpha == 0.0
            && material.ts.amount > 0.0
            && ScatteringPart::ALL
                .iter()
                .all(|part| *part == ScatteringPart::SpecularTransmission || part.fraction(material).amount == 0.0);
        let bsdf = Bsdf::from_parameters(&parameters);
        let tint = bsdf.straight_through();
        let crossing_if_hit = if tint == Rgb::ZERO { Crossing::Scatter } else { Crossing::Clear { tint } };
        let crossing = if matched {
            [Crossing::Null { tint }; 2]
        } else if material.sides == Sides::One && !solid && material.inside.is_some() {
            // Such a surface is invisible from behind. Rays only hit it there because a medium ends (see `surface_class`).
            [crossing_if_hit, Crossing::Null { tint: Rgb::ONE }]
        } else {
            [crossing_if_hit; 2]
        };
        Self {
            bsdf,
            parameters,
            crossing,
            orientation: if solid { Orientation::Front } else { Orientation::TowardViewer },
            interior_medium: material.inside.map(|m| m.0 as u16),
            map_rd: material.map_rd.map(|m| m.0),
            map_ed: material.map_ed.map(|m| m.0),
            map_n: material.map_n.map(|m| m.0),
        }
    }

    /// Returns the BSDF at a point where the texture of `rd` has the value `texel`.
    pub fn textured_bsdf(&self, texel: Rgb) -> Bsdf {
        self.bsdf.with_diffuse_factor(texel.clamp(Rgb::ZERO, Rgb::ONE))
    }
}

/// Returns the shading normal of a normal map. `map` at `uv` contains the tangent-space normal; `tangent` is the direction of
/// increasing u.
pub fn mapped_normal(normal: Vec3A, tangent: Vec3A, map: &Texture, uv: Vec2) -> Vec3A {
    let texel = map.lookup(uv);
    let tangent = (tangent - normal * normal.dot(tangent)).normalize_or_zero();
    if tangent == Vec3A::ZERO {
        return normal;
    }
    let bitangent = femc_math::cross(normal, tangent);
    (tangent * texel.x + bitangent * texel.y + normal * texel.z.max(1e-3)).normalize_or(normal)
}
