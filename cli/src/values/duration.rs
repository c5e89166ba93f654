use jiff::{Span, SpanTotal, Unit};
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

/// Returns the seconds of a duration in the format of [`jiff::fmt::friendly`] or ISO 8601; days have 24 hours. Returns `None` for months
/// and years, whose lengths vary.
fn with_units(text: &str) -> Option<f64> {
    let total = |text: &str| {
        let span: Span = text.parse().ok()?;
        span.total(SpanTotal::from(Unit::Second).days_are_24_hours()).ok()
    };
    // Jiff reads no fraction of a day, and no fraction without a digit before the point.
    let (number, unit) = text.split_at(text.find(|c: char| c.is_ascii_alphabetic()).unwrap_or(text.len()));
    match number.parse::<f64>() {
        Ok(number) if unit.bytes().all(|byte| byte.is_ascii_alphabetic()) => Some(number * total(&format!("1{unit}"))?),
        _ => total(text),
    }
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
        assert_eq!(seconds("2h30m"), Some(9000.0));
        assert_eq!(seconds("1.5d"), Some(129_600.0));
        assert_eq!(seconds(".5h"), Some(1800.0));
        assert_eq!(seconds("1d12h0.5s"), Some(129_600.5));
        for text in ["90 secs", "1 min 30 s", "1min30s", "1 minute, 30 seconds", "00:01:30", "PT1M30S"] {
            assert_eq!(seconds(text), Some(90.0), "{text}");
        }
    }

    #[test]
    fn what_is_no_positive_time_is_refused() {
        for text in
            ["", "s", "90x", "-3s", "0", "inf", "NaN", "1h30", "m2", "1..2s", "3s ago", "1mo", "1y", "1.5y", "1d ever"]
        {
            assert_eq!(seconds(text), None, "{text}");
        }
    }
}
