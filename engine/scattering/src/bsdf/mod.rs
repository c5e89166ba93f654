//! Surface scattering: one member per file, dispatched by an enum.
//!
//! `eval` is `f |cos wi|` without delta parts. `pdf` is the density of `sample` over solid angle without delta parts. It includes
//! the probability of choosing a non-delta part, so it may integrate to less than 1. The weight of a sample is `f |cos wi| / pdf`.
//! The probabilities of the lobes depend only on `wo` and the material.

pub mod coat;
pub mod dielectric;
pub mod diffuse;
mod energy;
pub mod mirror;
pub mod opaque;
pub mod sheet;

use crate::Fresnel;
use crate::microfacet::SMOOTH_ALPHA;
use coat::Coat;
pub use dielectric::Dielectric;
pub use diffuse::Diffuse;
use femc_math::{Rgb, glam::Vec3A};
pub use mirror::Mirror;
pub use opaque::Opaque;
pub use sheet::Sheet;

/// Sides of a surface that exist.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Sides {
    /// Only the front. The tracer lets rays pass from behind.
    One,
    /// Both sides, with equal properties.
    #[default]
    Two,
}

impl Sides {
    /// Checks whether the surface exists for a viewer at height `z`.
    #[inline]
    pub fn exist_at(self, z: f32) -> bool {
        z > 0.0 || self == Self::Two
    }
}

/// Kind of lobe from which a direction was sampled.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LobeKind {
    /// Lambertian, reflected or transmitted.
    Diffuse,
    /// A microfacet lobe.
    Glossy,
    /// A single direction; `pdf` is then the probability of choosing it.
    Delta,
}

/// Side of the surface on which a sample leaves.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Transmitted {
    /// Reflected: `wi` is on the side of `wo`.
    No,
    /// Transmitted: `wi` is on the other side.
    Yes,
}

/// A sampled direction.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BsdfSample {
    /// Unit direction, local frame, away from the surface.
    pub wi: Vec3A,
    /// `f |cos wi| / pdf`, with the factor `1 / eta^2` of refracted radiance.
    pub weight: Rgb,
    /// Density, 1/sr; for [`LobeKind::Delta`] the probability of the choice.
    pub pdf: f32,
    /// Lobe of the sample.
    pub lobe: LobeKind,
    /// Side on which it leaves.
    pub transmitted: Transmitted,
    /// Index on `wi`'s side over that on `wo`'s; 1 unless refracted. Russian roulette tests `throughput * product(eta^2)`.
    pub eta: f32,
}

/// Parameters of the scene format's reflection model.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MaterialParameters {
    /// Sides that exist.
    pub sides: Sides,
    /// Diffuse reflectance.
    pub rd: Rgb,
    /// Diffuse transmittance.
    pub td: Rgb,
    /// Specular reflectance.
    pub rs: Rgb,
    /// Specular transmittance.
    pub ts: Rgb,
    /// GGX roughness of `rs`; 0 is a mirror.
    pub rs_alpha: f32,
    /// GGX roughness of `ts`; 0 is clear.
    pub ts_alpha: f32,
    /// Complex index of refraction (re, im), if given. The format's default (1, 0) counts as not given.
    pub ior: Option<(f32, f32)>,
}

impl Default for MaterialParameters {
    fn default() -> Self {
        Self {
            sides: Sides::Two,
            rd: Rgb::ZERO,
            td: Rgb::ZERO,
            rs: Rgb::ZERO,
            ts: Rgb::ZERO,
            rs_alpha: 0.0,
            ts_alpha: 0.0,
            ior: None,
        }
    }
}

/// A surface's scattering function.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Bsdf {
    /// Absorbs everything.
    Black,
    /// Lambertian reflection.
    Diffuse(Diffuse),
    /// Perfect mirror.
    Mirror(Mirror),
    /// Diffuse and specular reflection.
    Opaque(Opaque),
    /// Thin sheet: reflection and transmission without refraction.
    Sheet(Sheet),
    /// Boundary of a solid dielectric.
    Dielectric(Dielectric),
}

/// Family of scattering functions of a material, which decides which parameters share the light.
enum Model {
    /// Boundary of a solid dielectric.
    Solid {
        /// Relative index of refraction.
        eta: f32,
    },
    /// Thin sheet.
    Sheet {
        /// Fresnel factor of the reflected specular part.
        fresnel: Fresnel,
    },
    /// Only reflection.
    Opaque {
        /// Fresnel factor of the specular part.
        fresnel: Fresnel,
    },
}

impl MaterialParameters {
    fn model(&self) -> Model {
        let present = |color: Rgb| color.max_element() > 0.0;
        let fresnel = match self.ior {
            None => Fresnel::Unit,
            Some((eta, k)) if k > 0.0 => Fresnel::Conductor { eta, k },
            Some((1.0, _)) => Fresnel::Unit,
            Some((eta, _)) => Fresnel::Dielectric { eta },
        };
        match (self.sides, fresnel) {
            (Sides::One, Fresnel::Dielectric { eta }) if present(self.ts) => Model::Solid { eta },
            _ if present(self.ts) => Model::Sheet { fresnel: Fresnel::Unit },
            _ if present(self.td) => Model::Sheet { fresnel },
            _ => Model::Opaque { fresnel },
        }
    }
}

impl Bsdf {
    /// Returns the cheapest member with these parameters, limited as by [`MaterialParameters::energy_conserving`]. A solid
    /// dielectric (one side, real index, `ts` > 0) reflects F with the roughness of `ts`; `rs` and its roughness do not count
    /// there.
    pub fn from_parameters(parameters: &MaterialParameters) -> Self {
        let p = parameters.energy_conserving();
        let present = |color: Rgb| color.max_element() > 0.0;
        // A surface with an index bounds a solid, so it exists from both sides.
        let sides = if p.ior.is_some() { Sides::Two } else { p.sides };
        match p.model() {
            Model::Solid { eta } => Self::Dielectric(Dielectric::new(eta, p.ts, p.ts_alpha, p.rd, p.td)),
            Model::Sheet { fresnel } => Self::Sheet(Sheet {
                rd: p.rd,
                td: p.td,
                coat: Coat::new(p.rs, fresnel),
                ts: p.ts,
                rs_alpha: p.rs_alpha,
                ts_alpha: p.ts_alpha,
                sides,
            }),
            Model::Opaque { fresnel } => match (present(p.rd), present(p.rs)) {
                (false, false) => Self::Black,
                (true, false) => Self::Diffuse(Diffuse { rd: p.rd, sides }),
                (false, true) if p.rs_alpha <= SMOOTH_ALPHA => Self::Mirror(Mirror { rs: p.rs, fresnel, sides }),
                (_, true) => {
                    Self::Opaque(Opaque { rd: p.rd, coat: Coat::new(p.rs, fresnel), alpha: p.rs_alpha, sides })
                }
            },
        }
    }

    /// Multiplies the diffuse reflectance by `factor` (a texture's value in [0, 1]). It is cheap enough for use at a hit.
    #[inline]
    pub fn with_diffuse_factor(&self, factor: Rgb) -> Self {
        match *self {
            Self::Black => Self::Black,
            Self::Diffuse(b) => Self::Diffuse(Diffuse { rd: b.rd * factor, ..b }),
            Self::Mirror(b) => Self::Mirror(b),
            Self::Opaque(b) => Self::Opaque(Opaque { rd: b.rd * factor, ..b }),
            Self::Sheet(b) => Self::Sheet(Sheet { rd: b.rd * factor, ..b }),
            Self::Dielectric(b) => Self::Dielectric(b.with_diffuse_factor(factor)),
        }
    }

    /// Returns the shares of irradiance that the Lambertian parts reflect and transmit toward `wo`. Times the irradiance of the
    /// side of `wo`, and of the other side, over pi, this is their radiance.
    pub fn lambertian(&self, wo: Vec3A) -> (Rgb, Rgb) {
        let cos = wo.z.abs();
        match self {
            Self::Diffuse(b) if b.sides.exist_at(wo.z) => (b.rd, Rgb::ZERO),
            Self::Opaque(b) if b.sides.exist_at(wo.z) => (b.rd * b.coat.transmitted(cos), Rgb::ZERO),
            Self::Sheet(b) if b.sides.exist_at(wo.z) => {
                (b.rd * b.coat.transmitted(cos), b.td * b.coat.transmitted(cos))
            }
            // Without Lambertian parts, or seen from a side that does not exist.
            Self::Black
            | Self::Diffuse(_)
            | Self::Mirror(_)
            | Self::Opaque(_)
            | Self::Sheet(_)
            | Self::Dielectric(_) => (Rgb::ZERO, Rgb::ZERO),
        }
    }

    /// Returns the diffuse reflectance and transmittance for a method that knows only diffuse surfaces: the shares of light from all
    /// directions. Glossy reflection counts as diffuse. Mirrors and clear solids contribute nothing. Takes some thousand evaluations
    /// for a coat.
    pub fn diffuse_albedos(&self) -> (Rgb, Rgb) {
        match self {
            Self::Black | Self::Mirror(_) | Self::Dielectric(_) => (Rgb::ZERO, Rgb::ZERO),
            Self::Diffuse(b) => (b.rd, Rgb::ZERO),
            Self::Opaque(b) if b.is_smooth() => (b.hemispherical_diffuse_albedo(), Rgb::ZERO),
            Self::Opaque(b) => (b.hemispherical_albedo(), Rgb::ZERO),
            Self::Sheet(b) => (b.rd, b.td),
        }
    }

    /// Returns the share of light from all directions that is scattered, with mirror reflection and refraction. Only for opaque
    /// surfaces is it the mean over all directions; for others it is the albedo toward a direction in the middle.
    pub fn hemispherical_albedo(&self) -> Rgb {
        /// Direction halfway between the normal and grazing, by solid angle.
        const MEAN_DIRECTION: Vec3A = Vec3A::new(0.866_025_4, 0.0, 0.5);
        if let Self::Opaque(b) = self { b.hemispherical_albedo() } else { self.albedo(MEAN_DIRECTION) }
    }

    /// Removes the Lambertian parts. The boundary of a clear solid stays unchanged.
    pub fn without_lambertian(&self) -> Self {
        match *self {
            Self::Diffuse(_) => Self::Black,
            Self::Opaque(b) => Self::Opaque(Opaque { rd: Rgb::ZERO, ..b }),
            Self::Sheet(b) => Self::Sheet(Sheet { rd: Rgb::ZERO, td: Rgb::ZERO, ..b }),
            Self::Black | Self::Mirror(_) | Self::Dielectric(_) => *self,
        }
    }

    /// Returns `f |cos wi|`, 1/sr, without delta parts. Laws: reciprocal (`reciprocity_holds`), the white furnace keeps at most 1
    /// (`no_member_creates_energy`).
    #[inline]
    pub fn eval(&self, wo: Vec3A, wi: Vec3A) -> Rgb {
        match self {
            Self::Diffuse(b) => b.eval(wo, wi),
            Self::Opaque(b) => b.eval(wo, wi),
            Self::Sheet(b) => b.eval(wo, wi),
            Self::Dielectric(b) => b.eval(wo, wi),
            Self::Black | Self::Mirror(_) => Rgb::ZERO,
        }
    }

    /// Returns the share of Lambertian lobes in [`Self::eval`] by channel, in 0..1. The rest is in glossy lobes. It is 0 if nothing
    /// is scattered (test `what_is_diffuse_and_what_is_glossy_is_all`).
    pub fn diffuse_share(&self, wo: Vec3A, wi: Vec3A) -> Rgb {
        // If the specular lobes are deltas, only the diffuse part is left.
        let diffuse = match *self {
            Self::Black | Self::Mirror(_) => return Rgb::ZERO,
            Self::Diffuse(_) => return Rgb::ONE,
            Self::Opaque(b) => Self::Opaque(Opaque { alpha: 0.0, ..b }),
            Self::Sheet(b) => Self::Sheet(Sheet { rs_alpha: 0.0, ts_alpha: 0.0, ..b }),
            Self::Dielectric(b) => Self::Dielectric(b.smooth()),
        };
        let (part, all) = (diffuse.eval(wo, wi), self.eval(wo, wi));
        let share = |part: f32, all: f32| if all > 0.0 { (part / all).min(1.0) } else { 0.0 };
        let ([a, b, c], [x, y, z]) = (part.to_array(), all.to_array());
        Rgb::new(share(a, x), share(b, y), share(c, z))
    }

    /// Returns the density of [`Self::sample`], 1/sr, without delta parts. It includes the probability of choosing a non-delta
    /// part.
    #[inline]
    pub fn pdf(&self, wo: Vec3A, wi: Vec3A) -> f32 {
        match self {
            Self::Diffuse(b) => b.pdf(wo, wi),
            Self::Opaque(b) => b.pdf(wo, wi),
            Self::Sheet(b) => b.pdf(wo, wi),
            Self::Dielectric(b) => b.pdf(wo, wi),
            Self::Black | Self::Mirror(_) => 0.0,
        }
    }

    /// Samples a direction from `u` in [0, 1)^2; `choice` in [0, 1) picks the lobe. `None`: the light is absorbed.
    #[inline]
    pub fn sample(&self, wo: Vec3A, u: [f32; 2], choice: f32) -> Option<BsdfSample> {
        match self {
            Self::Black => None,
            Self::Diffuse(b) => b.sample(wo, u),
            Self::Mirror(b) => b.sample(wo),
            Self::Opaque(b) => b.sample(wo, u, choice),
            Self::Sheet(b) => b.sample(wo, u, choice),
            Self::Dielectric(b) => b.sample(wo, u, choice),
        }
    }

    /// Checks whether [`Self::sample`] depends on its number `choice`.
    #[inline]
    pub fn has_choice(&self) -> bool {
        match self {
            Self::Black | Self::Diffuse(_) | Self::Mirror(_) => false,
            Self::Opaque(_) | Self::Sheet(_) | Self::Dielectric(_) => true,
        }
    }

    /// Checks whether every sample is a delta (or there is none). Light sampling is then useless.
    #[inline]
    pub fn is_delta_only(&self) -> bool {
        match self {
            Self::Black | Self::Mirror(_) => true,
            Self::Diffuse(_) => false,
            Self::Opaque(b) => b.is_smooth() && b.rd.max_element() <= 0.0,
            Self::Sheet(b) => {
                let rough = |color: Rgb, alpha: f32| color.max_element() > 0.0 && alpha > SMOOTH_ALPHA;
                let diffuse = b.rd.max_element() > 0.0 || b.td.max_element() > 0.0;
                !(diffuse || rough(b.coat.rs, b.rs_alpha) || rough(b.ts, b.ts_alpha))
            }
            Self::Dielectric(b) => b.is_smooth() && !b.has_diffuse(),
        }
    }

    /// Checks whether some samples are deltas.
    #[inline]
    pub fn has_delta(&self) -> bool {
        match self {
            Self::Black | Self::Diffuse(_) => false,
            Self::Mirror(_) => true,
            Self::Opaque(b) => b.is_smooth() && b.coat.rs.max_element() > 0.0,
            Self::Sheet(b) => {
                let smooth = |color: Rgb, alpha: f32| color.max_element() > 0.0 && alpha <= SMOOTH_ALPHA;
                smooth(b.coat.rs, b.rs_alpha) || smooth(b.ts, b.ts_alpha)
            }
            Self::Dielectric(b) => b.is_smooth(),
        }
    }

    /// Checks whether light can pass to the other side.
    #[inline]
    pub fn transmits(&self) -> bool {
        match self {
            Self::Sheet(_) | Self::Dielectric(_) => true,
            Self::Black | Self::Diffuse(_) | Self::Mirror(_) | Self::Opaque(_) => false,
        }
    }

    /// Returns the share of the light that goes straight through, from either side and at any angle. Shadow rays may pass with it.
    /// A sample of that part is a [`LobeKind::Delta`], transmitted, with `wi = -wo` and `eta` 1
    /// (`what_passes_unbent_is_drawn_unbent`).
    #[inline]
    pub fn straight_through(&self) -> Rgb {
        match self {
            Self::Sheet(b) if b.ts_alpha <= SMOOTH_ALPHA => b.ts,
            Self::Dielectric(b) => b.straight_through(),
            Self::Black | Self::Diffuse(_) | Self::Mirror(_) | Self::Opaque(_) | Self::Sheet(_) => Rgb::ZERO,
        }
    }

    /// Returns an approximation of the non-delta reflection: luminance of the diffuse reflectance, of the glossy reflectance toward
    /// `wo`, and its roughness. `None` for surfaces without a glossy lobe, or with transmission.
    #[inline]
    pub fn glossy_lobes(&self, wo: Vec3A) -> Option<(f32, f32, f32)> {
        match self {
            Self::Opaque(opaque) => (!opaque.is_smooth()).then(|| opaque.lobes(wo)),
            Self::Black | Self::Diffuse(_) | Self::Mirror(_) | Self::Sheet(_) | Self::Dielectric(_) => None,
        }
    }

    /// Returns the directional albedo, reflected plus transmitted. It is exact for diffuse and smooth parts. The few percent that
    /// single scattering loses in rough lobes are not subtracted, and the square of the index ratio of refracted radiance is not
    /// included.
    #[inline]
    pub fn albedo(&self, wo: Vec3A) -> Rgb {
        match self {
            Self::Black => Rgb::ZERO,
            Self::Diffuse(b) => b.rd,
            Self::Mirror(b) => b.albedo(wo),
            Self::Opaque(b) => b.albedo(wo),
            Self::Sheet(b) => b.albedo(wo),
            Self::Dielectric(b) => b.albedo(wo),
        }
    }
}

/// A material for the tests of the laws.
#[cfg(test)]
#[derive(Clone, Debug)]
pub(crate) struct Example {
    /// Name; it ends with the roughness of a rough material.
    pub(crate) name: String,
    pub(crate) parameters: MaterialParameters,
    /// Index of the inside; 1 for surfaces that do not refract.
    pub(crate) inside: f32,
}

/// Color that differs by channel.
#[cfg(test)]
const WARM: Rgb = Rgb::new(0.5, 0.4, 0.2);

#[cfg(test)]
impl Example {
    const ROUGHNESSES: [f32; 4] = [0.02, 0.1, 0.4, 1.0];

    fn new(name: &str, parameters: MaterialParameters) -> Self {
        Self { name: name.to_owned(), parameters, inside: 1.0 }
    }

    fn rough(name: &str, alpha: f32, parameters: MaterialParameters) -> Self {
        Self::new(&format!("{name} {alpha}"), parameters)
    }

    fn solid(name: &str, parameters: MaterialParameters) -> Self {
        Self { inside: parameters.ior.map_or(1.0, |(index, _)| index), ..Self::new(name, parameters) }
    }

    /// Returns the examples of all members.
    pub(crate) fn all() -> Vec<Self> {
        [diffuse::examples(), mirror::examples(), opaque::examples(), sheet::examples(), dielectric::examples()]
            .concat()
    }
}

/// Negates the z of `v` if `z` is negative: turns a direction up, or back.
#[inline]
fn flip_to_side(v: Vec3A, z: f32) -> Vec3A {
    if z < 0.0 { Vec3A::new(v.x, v.y, -v.z) } else { v }
}
