//! Scalars of materials, media and cameras: their names, their storage and the range of each.

use super::Constraint;
use crate::description::{Camera, Density, Ior, Material, Medium, Phase, ScatteringPart, Sides, TintedScalar};
use std::sync::LazyLock;

/// Maximum width and height of the film, pixels; the limit of textures.
const FILM_LIMIT: u32 = 32768;

/// A tinted quantity of a material.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Quantity {
    Part(ScatteringPart),
    Emittance,
}

impl Quantity {
    fn get(self, material: &Material) -> &TintedScalar {
        match self {
            Self::Part(part) => part.fraction(material),
            Self::Emittance => &material.ed,
        }
    }

    fn get_mut(self, material: &mut Material) -> &mut TintedScalar {
        match self {
            Self::Part(part) => part.fraction_mut(material),
            Self::Emittance => &mut material.ed,
        }
    }
}

/// A scalar of a material.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum MaterialField {
    Amount(Quantity),
    Channel(Quantity, usize),
    Roughness(ScatteringPart),
    IorReal,
    IorImaginary,
    Lobe,
    Sides,
}

impl MaterialField {
    /// Returns all fields with their names, in the order of messages.
    pub(super) fn all() -> &'static [(String, Self)] {
        static ALL: LazyLock<Vec<(String, MaterialField)>> = LazyLock::new(|| {
            let tinted = |name: &str, quantity: Quantity| {
                let channel = |(axis, letter)| (format!("{name}.{letter}"), MaterialField::Channel(quantity, axis));
                let channels = ["r", "g", "b"].into_iter().enumerate().map(channel);
                std::iter::once((name.to_owned(), MaterialField::Amount(quantity))).chain(channels).collect::<Vec<_>>()
            };
            let of_part = |part: ScatteringPart| {
                let roughness = part.roughness_name().map(|name| (name.to_owned(), MaterialField::Roughness(part)));
                tinted(part.name(), Quantity::Part(part)).into_iter().chain(roughness)
            };
            let others = [
                ("ir", MaterialField::IorReal),
                ("ir.im", MaterialField::IorImaginary),
                ("lobe", MaterialField::Lobe),
                ("sides", MaterialField::Sides),
            ];
            let parts = ScatteringPart::ALL.into_iter().flat_map(of_part);
            let emittance = tinted("ed", Quantity::Emittance);
            parts.chain(emittance).chain(others.map(|(name, field)| (name.to_owned(), field))).collect()
        });
        &ALL
    }

    pub(super) fn read(self, material: &Material) -> Option<f64> {
        match self {
            Self::Amount(quantity) => Some(quantity.get(material).amount),
            Self::Channel(quantity, channel) => Some(quantity.get(material).color[channel]),
            Self::Roughness(part) => part.roughness(material),
            Self::IorReal => material.ior.map(|ior| ior.re),
            Self::IorImaginary => material.ior.map(|ior| ior.im),
            Self::Lobe => Some(material.lobe.unwrap_or(0.0)),
            Self::Sides => Some(if material.sides == Sides::One { 1.0 } else { 2.0 }),
        }
    }

    pub(super) fn write(self, material: &mut Material, value: f64) {
        match self {
            Self::Amount(quantity) => quantity.get_mut(material).amount = value,
            Self::Channel(quantity, channel) => quantity.get_mut(material).color[channel] = value,
            Self::Roughness(part) => {
                if let Some(roughness) = part.roughness_mut(material) {
                    *roughness = value;
                }
            }
            Self::IorReal => material.ior = material.ior.map(|ior| Ior { re: value, ..ior }),
            Self::IorImaginary => material.ior = material.ior.map(|ior| Ior { im: value, ..ior }),
            Self::Lobe => material.lobe = (value != 0.0).then_some(value),
            Self::Sides => material.sides = if value == 1.0 { Sides::One } else { Sides::Two },
        }
    }

    pub(super) fn check_value(self, value: f64) -> Result<(), Constraint> {
        match self {
            Self::Amount(Quantity::Emittance) | Self::Roughness(_) | Self::IorImaginary | Self::Lobe => {
                not_negative(value)
            }
            Self::Amount(Quantity::Part(_)) => within(value, 0.0, 1.0),
            Self::Channel(..) => finite(value),
            Self::IorReal => positive(value),
            Self::Sides => either(value, 1, 2),
        }
    }
}

/// A scalar of a medium.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum MediumField {
    Scattering,
    ScatteringChannel(usize),
    Absorption,
    AbsorptionChannel(usize),
    Glow,
    GlowChannel(usize),
    HenyeyGreenstein,
    Schlick,
    DensityStart,
    DensityScale,
}

impl MediumField {
    pub(super) const ALL: [(&'static str, Self); 16] = [
        ("sigma_s", Self::Scattering),
        ("sigma_s.r", Self::ScatteringChannel(0)),
        ("sigma_s.g", Self::ScatteringChannel(1)),
        ("sigma_s.b", Self::ScatteringChannel(2)),
        ("sigma_a", Self::Absorption),
        ("sigma_a.r", Self::AbsorptionChannel(0)),
        ("sigma_a.g", Self::AbsorptionChannel(1)),
        ("sigma_a.b", Self::AbsorptionChannel(2)),
        ("glow", Self::Glow),
        ("glow.r", Self::GlowChannel(0)),
        ("glow.g", Self::GlowChannel(1)),
        ("glow.b", Self::GlowChannel(2)),
        ("phase.g", Self::HenyeyGreenstein),
        ("phase.k", Self::Schlick),
        ("density.z0", Self::DensityStart),
        ("density.h", Self::DensityScale),
    ];

    pub(super) fn read(self, medium: &Medium) -> Option<f64> {
        match (self, medium.phase, &medium.density) {
            (Self::Scattering, ..) => Some(medium.sigma_s),
            (Self::ScatteringChannel(channel), ..) => Some(medium.color[channel]),
            (Self::Absorption, ..) => Some(medium.sigma_a),
            (Self::AbsorptionChannel(channel), ..) => Some(medium.absorption_color[channel]),
            (Self::Glow, ..) => Some(medium.glow),
            (Self::GlowChannel(channel), ..) => Some(medium.glow_color[channel]),
            (Self::HenyeyGreenstein, Phase::HenyeyGreenstein { g }, _) => Some(g),
            (Self::Schlick, Phase::Schlick { k }, _) => Some(k),
            (Self::DensityStart, _, &Density::Height { z0, .. }) => Some(z0),
            (Self::DensityScale, _, &Density::Height { scale, .. }) => Some(scale),
            (Self::HenyeyGreenstein | Self::Schlick | Self::DensityStart | Self::DensityScale, ..) => None,
        }
    }

    /// Writes the scalar. A medium without this scalar stays unchanged.
    pub(super) fn write(self, medium: &mut Medium, value: f64) {
        match (self, &mut medium.phase, &mut medium.density) {
            (Self::Scattering, ..) => medium.sigma_s = value,
            (Self::ScatteringChannel(channel), ..) => medium.color[channel] = value,
            (Self::Absorption, ..) => medium.sigma_a = value,
            (Self::AbsorptionChannel(channel), ..) => medium.absorption_color[channel] = value,
            (Self::Glow, ..) => medium.glow = value,
            (Self::GlowChannel(channel), ..) => medium.glow_color[channel] = value,
            (Self::HenyeyGreenstein, Phase::HenyeyGreenstein { g }, _) => *g = value,
            (Self::Schlick, Phase::Schlick { k }, _) => *k = value,
            (Self::DensityStart, _, Density::Height { z0, .. }) => *z0 = value,
            (Self::DensityScale, _, Density::Height { scale, .. }) => *scale = value,
            (Self::HenyeyGreenstein | Self::Schlick | Self::DensityStart | Self::DensityScale, ..) => {}
        }
    }

    pub(super) fn check_value(self, value: f64) -> Result<(), Constraint> {
        match self {
            Self::Scattering
            | Self::ScatteringChannel(_)
            | Self::Absorption
            | Self::AbsorptionChannel(_)
            | Self::Glow => not_negative(value),
            Self::GlowChannel(_) | Self::DensityStart => finite(value),
            Self::HenyeyGreenstein | Self::Schlick => between(value, -1.0, 1.0),
            Self::DensityScale => positive(value),
        }
    }
}

/// A scalar of a camera.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum CameraField {
    Origin(usize),
    Target(usize),
    Up(usize),
    Fov,
    Film(usize),
    LensRadius,
    Focus,
    ShutterOpen,
    ShutterClose,
}

impl CameraField {
    pub(super) const ALL: [(&'static str, Self); 16] = [
        ("origin.x", Self::Origin(0)),
        ("origin.y", Self::Origin(1)),
        ("origin.z", Self::Origin(2)),
        ("target.x", Self::Target(0)),
        ("target.y", Self::Target(1)),
        ("target.z", Self::Target(2)),
        ("up.x", Self::Up(0)),
        ("up.y", Self::Up(1)),
        ("up.z", Self::Up(2)),
        ("fov", Self::Fov),
        ("film.w", Self::Film(0)),
        ("film.h", Self::Film(1)),
        ("lens", Self::LensRadius),
        ("focus", Self::Focus),
        ("shutter.open", Self::ShutterOpen),
        ("shutter.close", Self::ShutterClose),
    ];

    pub(super) fn read(self, camera: &Camera) -> f64 {
        match self {
            Self::Origin(axis) => camera.origin[axis],
            Self::Target(axis) => camera.target[axis],
            Self::Up(axis) => camera.up[axis],
            Self::Fov => camera.fov,
            Self::Film(axis) => f64::from(camera.film[axis]),
            Self::LensRadius => camera.lens_radius,
            Self::Focus => camera.focus,
            Self::ShutterOpen => camera.shutter_open,
            Self::ShutterClose => camera.shutter_close,
        }
    }

    pub(super) fn write(self, camera: &mut Camera, value: f64) {
        match self {
            Self::Origin(axis) => camera.origin[axis] = value,
            Self::Target(axis) => camera.target[axis] = value,
            Self::Up(axis) => camera.up[axis] = value,
            Self::Fov => camera.fov = value,
            Self::Film(axis) => camera.film[axis] = value as u32,
            Self::LensRadius => camera.lens_radius = value,
            Self::Focus => camera.focus = value,
            Self::ShutterOpen => camera.shutter_open = value,
            Self::ShutterClose => camera.shutter_close = value,
        }
    }

    pub(super) fn check_value(self, value: f64) -> Result<(), Constraint> {
        match self {
            Self::Origin(_) | Self::Target(_) | Self::Up(_) | Self::ShutterOpen | Self::ShutterClose => finite(value),
            Self::Fov => between(value, 0.0, 180.0),
            Self::Film(_) => count(value, FILM_LIMIT),
            Self::LensRadius => not_negative(value),
            Self::Focus => positive(value),
        }
    }
}

pub(super) fn finite(value: f64) -> Result<(), Constraint> {
    require(value.is_finite(), Constraint::Finite)
}

pub(super) fn not_negative(value: f64) -> Result<(), Constraint> {
    finite(value)?;
    require(value >= 0.0, Constraint::NotNegative)
}

pub(super) fn positive(value: f64) -> Result<(), Constraint> {
    finite(value)?;
    require(value > 0.0, Constraint::Positive)
}

pub(super) fn either(value: f64, a: u8, b: u8) -> Result<(), Constraint> {
    require(value == f64::from(a) || value == f64::from(b), Constraint::Either(a, b))
}

fn within(value: f64, low: f64, high: f64) -> Result<(), Constraint> {
    require((low..=high).contains(&value), Constraint::Within(low, high))
}

fn between(value: f64, low: f64, high: f64) -> Result<(), Constraint> {
    require(value > low && value < high, Constraint::Between(low, high))
}

fn count(value: f64, limit: u32) -> Result<(), Constraint> {
    require(value >= 1.0 && value <= f64::from(limit) && value.fract() == 0.0, Constraint::Count(limit))
}

pub(super) fn require(holds: bool, constraint: Constraint) -> Result<(), Constraint> {
    if holds { Ok(()) } else { Err(constraint) }
}
