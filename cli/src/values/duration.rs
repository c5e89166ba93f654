use serde::Deserialize;
use serde::de::{Deserializer, Error as _};
use std::str::FromStr;

/// A time budget: `90s`, `2m`, `1h30m`, `7d`, `500ms`, or a bare number of seconds.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DurationArg {
    /// Seconds, finite and > 0.
    pub seconds: f64,
}

/// Error of a text that is not a time budget.
#[derive(Debug, PartialEq, Eq, thiserror::Error)]
#[error("`{0}` is not a duration; write it like 90s, 2m, 1h30m, 7d or 500ms")]
pub struct DurationArgError(String);

impl FromStr for DurationArg {
    type Err = DurationArgError;

    fn from_str(text: &str) -> Result<Self, DurationArgError> {
        let wrong = || DurationArgError(text.to_owned());
        let seconds = match text.parse::<f64>() {
            Ok(seconds) => seconds,
            Err(_) => with_units(text).ok_or_else(wrong)?,
        };
        if seconds.is_finite() && seconds > 0.0 { Ok(Self { seconds }) } else { Err(wrong()) }
    }
}

/// Returns the sum of number-unit pairs; `None` if a number or a unit is missing or unknown.
fn with_units(mut rest: &str) -> Option<f64> {
    let mut seconds = 0.0;
    while !rest.is_empty() {
        let digits = rest.find(|c: char| !c.is_ascii_digit() && c != '.')?;
        let (number, tail) = rest.split_at(digits);
        let letters = tail.find(|c: char| !c.is_ascii_alphabetic()).unwrap_or(tail.len());
        let (unit, tail) = tail.split_at(letters);
        let scale = match unit {
            "ms" => 1e-3,
            "s" => 1.0,
            "m" | "min" => 60.0,
            "h" => 3600.0,
            "d" => 86_400.0,
            _ => return None,
        };
        seconds += number.parse::<f64>().ok()? * scale;
        rest = tail;
    }
    Some(seconds)
}

impl<'de> Deserialize<'de> for DurationArg {
    fn deserialize<D: Deserializer<'de>>(from: D) -> Result<Self, D::Error> {
        #[derive(Deserialize)]
        #[serde(untagged, expecting = "expected a number of seconds or a text such as \"10m\"")]
        enum DurationValue {
            Number(f64),
            Text(String),
        }
        let text = match DurationValue::deserialize(from)? {
            DurationValue::Number(seconds) => seconds.to_string(),
            DurationValue::Text(text) => text,
        };
        text.parse().map_err(D::Error::custom)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn seconds(text: &str) -> Option<f64> {
        text.parse::<DurationArg>().ok().map(|budget| budget.seconds)
    }

    #[test]
    fn durations_read_as_people_write_them() {
        assert_eq!(seconds("90s"), Some(90.0));
        assert_eq!(seconds("90"), Some(90.0));
        assert_eq!(seconds("2m"), Some(120.0));
        assert_eq!(seconds("1h30m"), Some(5400.0));
        assert_eq!(seconds("7d"), Some(604_800.0));
        assert_eq!(seconds("500ms"), Some(0.5));
        assert_eq!(seconds("1.5m"), Some(90.0));
    }

    #[test]
    fn what_is_no_positive_time_is_refused() {
        for text in ["", "s", "90x", "-3s", "0", "inf", "NaN", "1h30", "m2", "1..2s"] {
            assert_eq!(seconds(text), None, "{text}");
        }
    }
}
