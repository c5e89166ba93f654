//! One axis of a sweep: a selector or a setting, and its values.

use super::place::{Fault, Place};
use super::range::Range;
use super::sweep::MAX_VARIANTS;
use crate::args::{Filter, Method, SettingsArgs};
use crate::request::{Budget, Frames, Override, Size};
use serde::Deserialize;
use std::borrow::Cow;
use toml::Spanned;
use toml::de::{DeValue, ValueDeserializer};

/// What is varied, and the values that it takes.
#[derive(Debug)]
pub struct Axis {
    /// Selector, or the setting's long name.
    pub name: String,
    /// At least one.
    pub choices: Vec<Choice>,
    /// Where the name stands.
    pub place: Place,
    /// Byte offset of the same.
    pub offset: usize,
}

/// A value of an axis.
#[derive(Clone, Debug)]
pub struct Choice {
    /// What it changes.
    pub change: Change,
    /// The value as it is shown and names folders.
    pub text: String,
    /// Where it stands.
    pub place: Place,
    /// Byte offset of the same.
    pub offset: usize,
}

/// What a choice changes.
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
    Time(Budget),
    /// `method`
    Method(Method),
    /// `max-depth`
    MaxDepth(u32),
    /// `filter`
    Filter(Filter),
    /// `seed`
    Seed(u64),
}

/// Keys of a job file that are no settings of an image.
const NOT_VARIED: [&str; 8] = ["scene", "workers", "threads", "priority", "tags", "stats", "set", "sweep"];
/// The ones that are, as they are named in messages.
const SETTINGS: &str = "camera, size, frames, spp, error, time, method, max-depth, filter, seed";

impl Axis {
    pub(super) fn read(key: &Spanned<Cow<'_, str>>, value: &Spanned<DeValue<'_>>, text: &str) -> Result<Self, Fault> {
        let (name, offset) = (key.get_ref().replace("max_depth", "max-depth"), key.span().start);
        if NOT_VARIED.contains(&name.as_str()) {
            return Err(Fault::new(
                offset,
                format!("`{name}` cannot be varied; an axis is a selector or one of {SETTINGS}"),
            ));
        }
        let choices: Vec<Choice> = match value.get_ref() {
            DeValue::Array(values) => {
                values.iter().map(|value| Choice::read(&name, value, text)).collect::<Result<_, _>>()?
            }
            DeValue::Table(table) => Range::read(&name, value.span().start, table)?
                .values()
                .into_iter()
                .map(|number| Choice::number(&name, number, value.span().start, text))
                .collect::<Result<_, _>>()?,
            _ => {
                let what = format!("`{name}`: an axis is a list of values, or {{ from = 1, to = 10, steps = 4 }}");
                return Err(Fault::new(value.span().start, what));
            }
        };
        match choices.len() {
            0 => Err(Fault::new(value.span().start, format!("`{name}` has no values; take it out, or give it some"))),
            n if n > MAX_VARIANTS => {
                Err(Fault::new(offset, format!("`{name}` has {n} values; a sweep has at most {MAX_VARIANTS} variants")))
            }
            _ => Ok(Self { name, choices, place: Place::of(text, offset), offset }),
        }
    }
}

impl Choice {
    fn read(name: &str, value: &Spanned<DeValue<'_>>, text: &str) -> Result<Self, Fault> {
        let offset = value.span().start;
        let source = text.get(value.span()).unwrap_or_default();
        let change = Change::read(name, value).map_err(|what| Fault::new(offset, format!("`{name}`: {what}")))?;
        change.check().map_err(|what| Fault::new(offset, format!("`{name}` = {source}: {what}")))?;
        Ok(Self { text: change.text(), change, place: Place::of(text, offset), offset })
    }

    /// A value of a range.
    fn number(name: &str, number: f64, offset: usize, text: &str) -> Result<Self, Fault> {
        let whole =
            || (number.fract() == 0.0 && (0.0..=f64::from(u32::MAX)).contains(&number)).then_some(number as u32);
        let change = match name {
            "error" => Some(Change::Error(number)),
            "time" => Some(Change::Time(Budget { seconds: number })),
            "spp" => whole().map(Change::Spp),
            "max-depth" => whole().map(Change::MaxDepth),
            "seed" => whole().map(|n| Change::Seed(n.into())),
            "camera" | "size" | "frames" | "method" | "filter" => None,
            selector => Some(Change::Scalar(Override { selector: selector.to_owned(), value: number })),
        };
        let change = change.ok_or_else(|| {
            Fault::new(offset, format!("`{name}` cannot be {number}, a step of this range; give a list of values"))
        })?;
        change.check().map_err(|what| Fault::new(offset, format!("`{name}` = {number}: {what}")))?;
        Ok(Self { text: change.text(), change, place: Place::of(text, offset), offset })
    }
}

/// A value by the type that it is to have.
fn typed<'d, T: Deserialize<'d>>(value: &Spanned<DeValue<'d>>) -> Result<T, String> {
    T::deserialize(ValueDeserializer::from(value.clone())).map_err(|e| super::one_line(e.message()))
}

impl Change {
    fn read<'d>(name: &str, value: &Spanned<DeValue<'d>>) -> Result<Self, String> {
        Ok(match name {
            "camera" => Self::Camera(typed(value)?),
            "size" => Self::Size(typed(value)?),
            "frames" => Self::Frames(typed(value)?),
            "spp" => Self::Spp(typed(value)?),
            "error" => Self::Error(typed(value)?),
            "time" => Self::Time(typed(value)?),
            "method" => Self::Method(typed(value)?),
            "max-depth" => Self::MaxDepth(typed(value)?),
            "filter" => Self::Filter(typed(value)?),
            "seed" => Self::Seed(typed(value)?),
            selector => Self::Scalar(Override { selector: selector.to_owned(), value: typed(value)? }),
        })
    }

    /// What the command line refuses of a flag is refused here.
    fn check(&self) -> Result<(), &'static str> {
        match self {
            Self::Spp(0) => Err("spp is at least 1"),
            Self::Error(e) if !(e.is_finite() && *e > 0.0) => Err("error is a relative error > 0, like 0.05"),
            Self::Time(t) if !(t.seconds.is_finite() && t.seconds > 0.0) => Err("a time is > 0"),
            Self::Scalar(Override { value, .. }) if !value.is_finite() => Err("it is no finite number"),
            _ => Ok(()),
        }
    }

    /// The value for people and for folders' names: the shortest text that reads back the same.
    fn text(&self) -> String {
        match self {
            Self::Scalar(Override { value, .. }) | Self::Error(value) => shortest(*value),
            Self::Camera(name) => name.clone(),
            Self::Size(Size { width, height }) => format!("{width}x{height}"),
            Self::Frames(frames) => frames.to_string(),
            Self::Spp(n) | Self::MaxDepth(n) => n.to_string(),
            Self::Time(time) => format!("{}s", shortest(time.seconds)),
            Self::Method(Method::Auto) => "auto".to_owned(),
            Self::Method(Method::Pt) => "pt".to_owned(),
            Self::Method(Method::Femc) => "femc".to_owned(),
            Self::Filter(Filter::Box) => "box".to_owned(),
            Self::Filter(Filter::Triangle) => "triangle".to_owned(),
            Self::Filter(Filter::Gaussian) => "gaussian".to_owned(),
            Self::Filter(Filter::BlackmanHarris) => "blackman-harris".to_owned(),
            Self::Seed(n) => n.to_string(),
        }
    }

    /// The value, where it is a number.
    pub fn as_number(&self) -> Option<f64> {
        match self {
            Self::Scalar(Override { value, .. }) | Self::Error(value) => Some(*value),
            Self::Spp(n) | Self::MaxDepth(n) => Some(f64::from(*n)),
            Self::Time(time) => Some(time.seconds),
            Self::Seed(n) => Some(*n as f64),
            Self::Camera(_) | Self::Size(_) | Self::Frames(_) | Self::Method(_) | Self::Filter(_) => None,
        }
    }

    /// Make the change. A stopping rule takes the place of any other.
    pub(super) fn apply(&self, settings: &mut SettingsArgs) {
        let stop = |settings: &mut SettingsArgs| (settings.spp, settings.error, settings.time) = (None, None, None);
        match self {
            Self::Scalar(change) => settings.set.push(change.clone()),
            Self::Camera(name) => settings.camera = Some(name.clone()),
            Self::Size(size) => settings.size = Some(*size),
            Self::Frames(frames) => settings.frames = Some(*frames),
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
            Self::MaxDepth(n) => settings.max_depth = Some(*n),
            Self::Filter(filter) => settings.filter = Some(*filter),
            Self::Seed(n) => settings.seed = Some(*n),
        }
    }
}

/// `0.02`, `10000`, `1e-9`.
fn shortest(number: f64) -> String {
    let [plain, scientific] = [number.to_string(), format!("{number:e}")];
    if plain.len() <= scientific.len() + 3 { plain } else { scientific }
}
