//! Expiration times as text.

use time::{Date, Duration, Month, OffsetDateTime, PrimitiveDateTime, Time};

/// Parses a time in whole seconds, UTC: `2027-02-19T10:00:00Z`, or `2027-02-19`, which means the first second of that day.
pub(crate) fn parse(text: &str) -> Option<OffsetDateTime> {
    let (date, time) = text.split_once('T').map_or((text, None), |(date, time)| (date, Some(time)));
    let [year, month, day] = numbers(date, '-', [4, 2, 2])?;
    let month = Month::try_from(u8::try_from(month).ok()?).ok()?;
    let date = Date::from_calendar_date(year as i32, month, day as u8).ok()?;
    let time = match time {
        None => Time::MIDNIGHT,
        Some(time) => {
            let [hour, minute, second] = numbers(time.strip_suffix('Z')?, ':', [2, 2, 2])?;
            Time::from_hms(hour as u8, minute as u8, second as u8).ok()?
        }
    };
    Some(PrimitiveDateTime::new(date, time).assume_utc())
}

/// Parses three numbers separated by `between`, with exactly these numbers of digits.
fn numbers(text: &str, between: char, digits: [usize; 3]) -> Option<[u32; 3]> {
    let mut parts = text.split(between);
    let mut number = |digits| {
        let part = parts.next()?;
        (part.len() == digits && part.bytes().all(|byte| byte.is_ascii_digit())).then(|| part.parse().ok())?
    };
    let numbers = [number(digits[0])?, number(digits[1])?, number(digits[2])?];
    parts.next().is_none().then_some(numbers)
}

/// Formats a time as [`parse`] reads it.
pub(crate) fn format(moment: OffsetDateTime) -> String {
    let (date, time) = (moment.date(), moment.time());
    let (hour, minute, second) = time.as_hms();
    let month = u8::from(date.month());
    format!("{:04}-{month:02}-{:02}T{hour:02}:{minute:02}:{second:02}Z", date.year(), date.day())
}

/// Returns the time `days` days from now.
pub(crate) fn after_days(days: u32) -> OffsetDateTime {
    OffsetDateTime::now_utc() + Duration::days(i64::from(days))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_moment_comes_back_and_a_date_is_its_first_second() {
        for moment in ["2027-02-19T10:00:09Z", "1999-12-31T23:59:59Z"] {
            assert_eq!(format(parse(moment).unwrap()), moment);
        }
        assert_eq!(parse("2028-02-29"), parse("2028-02-29T00:00:00Z"));
        for wrong in [
            "",
            "2027",
            "2027-2-19",
            "2027-13-01",
            "2027-02-30",
            "2027-02-19T24:00:00Z",
            "2027-02-19T10:00:00",
            "-027-02-19",
            "2027-02-19-1",
            "+027-02-19",
        ] {
            assert_eq!(parse(wrong), None, "{wrong}");
        }
    }
}
