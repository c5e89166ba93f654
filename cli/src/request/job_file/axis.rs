//! An axis of a sweep: a selector or a setting, and its values.

use super::change::Change;
use super::fault::Fault;
use super::range::{MAX_VARIANTS, Range};
use crate::values::TextPosition;
use crate::values::{DurationArg, Override};
use std::borrow::Cow;
use toml::Spanned;
use toml::de::DeValue;

/// A selector or setting, and the values that it takes.
#[derive(Debug)]
pub struct Axis {
    /// Selector, or the setting's long name.
    pub name: String,
    /// Values, at least one.
    pub values: Vec<AxisValue>,
    /// Line and column of the name.
    pub position: TextPosition,
    /// Byte offset of the name.
    pub offset: usize,
}

/// A value of an axis.
#[derive(Clone, Debug)]
pub struct AxisValue {
    /// Change of the settings.
    pub change: Change,
    /// Text of the value, for messages and folder names.
    pub text: String,
    /// Line and column of the value.
    pub position: TextPosition,
    /// Byte offset of the value.
    pub offset: usize,
}

/// Keys of a job file that cannot be axes, because they are not settings of an image.
const NOT_VARIED: [&str; 16] = [
    "scene",
    "name",
    "comment",
    "labels",
    "notify",
    "workers",
    "threads",
    "priority",
    "tags",
    "stats",
    "layer",
    "layers",
    "measure",
    "measure-only",
    "set",
    "sweep",
];
/// Settings that can be axes, as listed in messages.
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
        let choices: Vec<AxisValue> = match value.get_ref() {
            DeValue::Array(values) => {
                values.iter().map(|value| AxisValue::read(&name, value, text)).collect::<Result<_, _>>()?
            }
            DeValue::Table(table) => Range::read(&name, value.span().start, table)?
                .values()
                .into_iter()
                .map(|number| AxisValue::number(&name, number, value.span().start, text))
                .collect::<Result<_, _>>()?,
            _ => {
                let what = format!("`{name}`: an axis must be a list of values, or {{ from = 1, to = 10, steps = 4 }}");
                return Err(Fault::new(value.span().start, what));
            }
        };
        match choices.len() {
            0 => Err(Fault::new(value.span().start, format!("`{name}` has no values; remove it, or give it values"))),
            n if n > MAX_VARIANTS => {
                Err(Fault::new(offset, format!("`{name}` has {n} values; a sweep has at most {MAX_VARIANTS} variants")))
            }
            _ => Ok(Self { name, values: choices, position: TextPosition::from_offset(text, offset), offset }),
        }
    }
}

impl AxisValue {
    fn read(name: &str, value: &Spanned<DeValue<'_>>, text: &str) -> Result<Self, Fault> {
        let offset = value.span().start;
        let source = text.get(value.span()).unwrap_or_default();
        let change = Change::read(name, value).map_err(|what| Fault::new(offset, format!("`{name}`: {what}")))?;
        change.check().map_err(|what| Fault::new(offset, format!("`{name}` = {source}: {what}")))?;
        Ok(Self { text: change.text(), change, position: TextPosition::from_offset(text, offset), offset })
    }

    /// Returns the choice for a value of a range.
    fn number(name: &str, number: f64, offset: usize, text: &str) -> Result<Self, Fault> {
        let whole =
            || (number.fract() == 0.0 && (0.0..=f64::from(u32::MAX)).contains(&number)).then_some(number as u32);
        let change = match name {
            "error" => Some(Change::Error(number)),
            "time" => Some(Change::Time(DurationArg { seconds: number })),
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
        Ok(Self { text: change.text(), change, position: TextPosition::from_offset(text, offset), offset })
    }
}
