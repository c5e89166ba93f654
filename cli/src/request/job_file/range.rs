//! A range of numbers: `{ from = 1e4, to = 1e5, steps = 4, scale = "log" }`.

use super::fault::Fault;
use serde::Deserialize as _;
use toml::Spanned;
use toml::de::{DeTable, DeValue, ValueDeserializer};

/// Largest number of variants of a sweep; each is a job and a folder.
pub const MAX_VARIANTS: usize = 4096;

/// Evenly spaced numbers, both ends included.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Range {
    from: f64,
    to: f64,
    steps: usize,
    scale: Scale,
}

/// Spacing of the numbers.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
enum Scale {
    /// Equal differences.
    #[default]
    Linear,
    /// Equal ratios.
    Log,
}

impl Range {
    /// Reads the table of axis `name`, which begins at `offset`.
    pub(super) fn read(name: &str, offset: usize, table: &DeTable<'_>) -> Result<Self, Fault> {
        for (key, value) in table {
            if !["from", "to", "steps", "scale"].contains(&key.get_ref().as_ref()) {
                let what = if matches!(value.get_ref(), DeValue::Array(_) | DeValue::Table(_)) {
                    format!("a selector needs quotes: \"{name}.{}...\" = ...", key.get_ref())
                } else {
                    format!("`{name}`: a range has from, to, steps and scale, but no `{}`", key.get_ref())
                };
                return Err(Fault::new(key.span().start, what));
            }
        }
        let value = |key: &str| {
            let missing =
                || Fault::new(offset, format!("`{name}`: a range needs from, to and steps; `{key}` is missing"));
            table.get(key).ok_or_else(missing)
        };
        let number = |key: &str| {
            let value = value(key)?;
            let number = f64::deserialize(ValueDeserializer::from(value.clone())).ok().filter(|n| n.is_finite());
            number.ok_or_else(|| Fault::new(value.span().start, format!("`{name}`: {key} must be a finite number")))
        };
        let range = Self {
            from: number("from")?,
            to: number("to")?,
            steps: steps(name, value("steps")?)?,
            scale: scale(name, table)?,
        };
        if range.scale == Scale::Log && !(range.from > 0.0 && range.to > 0.0) {
            return Err(Fault::new(offset, format!("`{name}`: on a log scale, both ends must be greater than 0")));
        }
        if range.from == range.to && range.steps > 1 {
            return Err(Fault::new(offset, format!("`{name}`: from and to are equal; all steps would be the same")));
        }
        Ok(range)
    }

    /// Returns the numbers. Those between the ends are rounded to 12 digits, so that a range of twice the steps has all numbers of
    /// the coarser one, bit by bit.
    pub(super) fn values(self) -> Vec<f64> {
        let Self { from, to, steps, scale } = self;
        let at = |step: usize| {
            let t = step as f64 / (steps - 1) as f64;
            match scale {
                Scale::Linear => from + (to - from) * t,
                Scale::Log => from * (to / from).powf(t),
            }
        };
        let value = |step| match step {
            0 => from,
            last if last == steps - 1 => to,
            step => rounded(at(step)),
        };
        (0..steps).map(value).collect()
    }
}

fn rounded(number: f64) -> f64 {
    format!("{number:.11e}").parse().unwrap_or(number)
}

fn steps(name: &str, value: &Spanned<DeValue<'_>>) -> Result<usize, Fault> {
    let steps = usize::deserialize(ValueDeserializer::from(value.clone())).ok();
    let wrong =
        || Fault::new(value.span().start, format!("`{name}`: steps must be a whole number from 1 to {MAX_VARIANTS}"));
    steps.filter(|steps| (1..=MAX_VARIANTS).contains(steps)).ok_or_else(wrong)
}

fn scale(name: &str, table: &DeTable<'_>) -> Result<Scale, Fault> {
    let Some(value) = table.get("scale") else { return Ok(Scale::default()) };
    match value.get_ref() {
        DeValue::String(text) if text == "linear" => Ok(Scale::Linear),
        DeValue::String(text) if text == "log" => Ok(Scale::Log),
        _ => Err(Fault::new(value.span().start, format!("`{name}`: scale must be \"linear\" or \"log\""))),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_finer_range_has_the_values_of_the_coarser_one() {
        for scale in [Scale::Linear, Scale::Log] {
            let values = |steps| Range { from: 1e4, to: 1e5, steps, scale }.values();
            let (coarse, fine) = (values(4), values(7));
            assert_eq!(coarse, fine.iter().step_by(2).copied().collect::<Vec<_>>(), "{scale:?}");
            assert_eq!((coarse[0], coarse[3]), (1e4, 1e5));
        }
        assert_eq!(Range { from: 2.0, to: 2.0, steps: 1, scale: Scale::Log }.values(), [2.0]);
    }
}
