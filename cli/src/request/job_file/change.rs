//! A change of one setting of an image, or of one scalar of a scene.

use super::fault::one_line;
use crate::args::{Filter, Guide, Method, SettingsArgs};
use crate::values::{DurationArg, Frames, Override, Size};
use serde::Deserialize;
#[cfg(feature = "openjd")]
use std::collections::BTreeMap;
use toml::Spanned;
use toml::de::{DeValue, ValueDeserializer};

/// A setting or scalar and its new value.
#[derive(Clone, Debug, PartialEq)]
pub enum Change {
    /// A scalar of the scene.
    Scalar(Override),
    /// `camera`
    Camera(String),
    /// `size`
    Size(Size),
    /// `frames`
    Frames(Frames),
    /// `spp`
    Spp(u32),
    /// `error`
    Error(f64),
    /// `time`
    Time(DurationArg),
    /// `method`
    Method(Method),
    /// `guide`
    Guide(Guide),
    /// `max-depth`
    MaxDepth(u32),
    /// `filter`
    Filter(Filter),
    /// `seed`
    Seed(u64),
}

/// Parses a value of a given type.
fn parse_value<'d, T: Deserialize<'d>>(value: &Spanned<DeValue<'d>>) -> Result<T, String> {
    T::deserialize(ValueDeserializer::from(value.clone())).map_err(|e| one_line(e.message()))
}

impl Change {
    pub(super) fn read<'d>(name: &str, value: &Spanned<DeValue<'d>>) -> Result<Self, String> {
        Ok(match name {
            "camera" => Self::Camera(parse_value(value)?),
            "size" => Self::Size(parse_value(value)?),
            "frames" => Self::Frames(parse_value(value)?),
            "spp" => Self::Spp(parse_value(value)?),
            "error" => Self::Error(parse_value(value)?),
            "time" => Self::Time(parse_value(value)?),
            "method" => Self::Method(parse_value(value)?),
            "guide" => Self::Guide(parse_value(value)?),
            "max-depth" => Self::MaxDepth(parse_value(value)?),
            "filter" => Self::Filter(parse_value(value)?),
            "seed" => Self::Seed(parse_value(value)?),
            selector => Self::Scalar(Override { selector: selector.to_owned(), value: parse_value(value)? }),
        })
    }

    /// Checks the value as the command line checks the flag.
    pub(super) fn check(&self) -> Result<(), &'static str> {
        match self {
            Self::Spp(0) => Err("spp must be at least 1"),
            Self::Error(e) if !(e.is_finite() && *e > 0.0) => Err("error must be a relative error > 0, like 0.05"),
            Self::Time(t) if !(t.seconds.is_finite() && t.seconds > 0.0) => Err("time must be > 0"),
            Self::Scalar(Override { value, .. }) if !value.is_finite() => Err("the value must be a finite number"),
            _ => Ok(()),
        }
    }

    /// Returns the value as text, for people and folder names: the shortest text that parses to the same value.
    pub fn text(&self) -> String {
        match self {
            Self::Scalar(Override { value, .. }) | Self::Error(value) => shortest(*value),
            Self::Camera(name) => name.clone(),
            Self::Size(Size { width, height }) => format!("{width}x{height}"),
            Self::Frames(frames) => frames.to_string(),
            Self::Spp(n) | Self::MaxDepth(n) => n.to_string(),
            Self::Time(time) => format!("{}s", shortest(time.seconds)),
            Self::Method(Method::Auto) => "auto".to_owned(),
            Self::Method(Method::Pt) => "pt".to_owned(),
            Self::Method(Method::Fem) => "fem".to_owned(),
            Self::Method(Method::Femc) => "femc".to_owned(),
            Self::Guide(Guide::Targets) => "targets".to_owned(),
            Self::Guide(Guide::Tables1998) => "1998".to_owned(),
            Self::Filter(Filter::Box) => "box".to_owned(),
            Self::Filter(Filter::Triangle) => "triangle".to_owned(),
            Self::Filter(Filter::Gaussian) => "gaussian".to_owned(),
            Self::Filter(Filter::BlackmanHarris) => "blackman-harris".to_owned(),
            Self::Seed(n) => n.to_string(),
        }
    }

    /// Returns the value, if it is a number.
    pub fn as_number(&self) -> Option<f64> {
        match self {
            Self::Scalar(Override { value, .. }) | Self::Error(value) => Some(*value),
            Self::Spp(n) | Self::MaxDepth(n) => Some(f64::from(*n)),
            Self::Time(time) => Some(time.seconds),
            Self::Seed(n) => Some(*n as f64),
            Self::Camera(_) | Self::Size(_) | Self::Frames(_) | Self::Method(_) | Self::Guide(_) | Self::Filter(_) => {
                None
            }
        }
    }

    /// Applies the change. A stopping rule replaces all others.
    pub(super) fn apply(&self, settings: &mut SettingsArgs) {
        let stop = |settings: &mut SettingsArgs| (settings.spp, settings.error, settings.time) = (None, None, None);
        match self {
            Self::Scalar(change) => settings.set.push(change.clone()),
            Self::Camera(name) => settings.camera = Some(name.clone()),
            Self::Size(size) => settings.size = Some(*size),
            Self::Frames(frames) => settings.frames = Some(frames.clone()),
            Self::Spp(n) => {
                stop(settings);
                settings.spp = Some(*n);
            }
            Self::Error(e) => {
                stop(settings);
                settings.error = Some(*e);
            }
            Self::Time(time) => {
                stop(settings);
                settings.time = Some(*time);
            }
            Self::Method(method) => settings.method = Some(*method),
            Self::Guide(guide) => settings.guide = Some(*guide),
            Self::MaxDepth(n) => settings.max_depth = Some(*n),
            Self::Filter(filter) => settings.filter = Some(*filter),
            Self::Seed(n) => settings.seed = Some(*n),
        }
    }
}

/// Conversion of settings into changes.
#[cfg(feature = "openjd")]
impl Change {
    /// Returns the changes that turn empty settings into these, one per setting and selector. They do not include `workers`,
    /// `threads` and `stats`, which change no pixel.
    pub fn from_settings(settings: &SettingsArgs) -> Vec<Self> {
        let SettingsArgs {
            camera, size, frames, spp, error, time, method, guide, max_depth, filter, seed, set, ..
        } = settings;
        let last: BTreeMap<&str, &Override> = set.iter().map(|change| (change.selector.as_str(), change)).collect();
        let given = [
            camera.clone().map(Self::Camera),
            size.map(Self::Size),
            frames.clone().map(Self::Frames),
            spp.map(Self::Spp),
            error.map(Self::Error),
            time.map(Self::Time),
            method.map(Self::Method),
            guide.map(Self::Guide),
            max_depth.map(Self::MaxDepth),
            filter.map(Self::Filter),
            seed.map(Self::Seed),
        ];
        let scalars = last.into_values().cloned().map(Self::Scalar);
        given.into_iter().flatten().chain(scalars).collect()
    }

    /// Returns the setting's long name, or the selector.
    pub fn name(&self) -> &str {
        match self {
            Self::Scalar(Override { selector, .. }) => selector,
            Self::Camera(_) => "camera",
            Self::Size(_) => "size",
            Self::Frames(_) => "frames",
            Self::Spp(_) => "spp",
            Self::Error(_) => "error",
            Self::Time(_) => "time",
            Self::Method(_) => "method",
            Self::Guide(_) => "guide",
            Self::MaxDepth(_) => "max-depth",
            Self::Filter(_) => "filter",
            Self::Seed(_) => "seed",
        }
    }
}

/// Formats a number as `0.02`, `10000`, `1e-9`.
fn shortest(number: f64) -> String {
    let [plain, scientific] = [number.to_string(), format!("{number:e}")];
    if plain.len() <= scientific.len() + 3 { plain } else { scientific }
}
