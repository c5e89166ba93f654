use std::str::FromStr;

/// Working hours of a worker: windows of a week, in local time.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Hours(Vec<Window>);

/// A window of time on some days, which may end on the next day.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Window {
    /// First and last day on which the window begins, Monday 0; the last may come before the first.
    days: (u8, u8),
    /// Begin in minutes since midnight, 0..1440.
    begin: u16,
    /// Length in minutes, > 0.
    length: u16,
}

/// Minutes of a day.
const DAY: u16 = 24 * 60;
const DAY_NAMES: [&str; 7] = ["mon", "tue", "wed", "thu", "fri", "sat", "sun"];

/// Error of a text that does not describe working hours.
#[derive(Debug, PartialEq, Eq, thiserror::Error)]
#[error("`{0}` is not a time window; write it like 20:00-06:00 or Mon-Fri 20:00-06:00, several with commas")]
pub struct HoursError(String);

impl FromStr for Hours {
    type Err = HoursError;

    fn from_str(text: &str) -> Result<Self, HoursError> {
        let window = |text: &str| parse_window(text.trim()).ok_or_else(|| HoursError(text.trim().to_owned()));
        text.split(',').map(window).collect::<Result<_, _>>().map(Self)
    }
}

fn parse_window(text: &str) -> Option<Window> {
    let (days, times) = match text.split_once(char::is_whitespace) {
        Some((days, times)) => (parse_days(days)?, times.trim()),
        None => ((0, 6), text),
    };
    let (begin, end) = times.split_once('-')?;
    let (begin, end) = (parse_time(begin)?, parse_time(end)?);
    let length = if end > begin { end - begin } else { end + DAY - begin };
    (begin < DAY && length <= DAY && begin != end).then_some(Window { days, begin, length })
}

fn parse_days(text: &str) -> Option<(u8, u8)> {
    let day = |text: &str| DAY_NAMES.iter().position(|name| text.eq_ignore_ascii_case(name)).map(|day| day as u8);
    match text.split_once('-') {
        Some((first, last)) => Some((day(first)?, day(last)?)),
        None => day(text).map(|day| (day, day)),
    }
}

/// Parses `HH:MM`, up to 24:00.
fn parse_time(text: &str) -> Option<u16> {
    let (hours, minutes) = text.split_once(':')?;
    let part = |text: &str| if text.len() <= 2 { text.parse::<u16>().ok() } else { None };
    let (hours, minutes) = (part(hours)?, part(minutes).filter(|minutes| *minutes < 60)?);
    let whole = hours * 60 + minutes;
    (hours <= 24 && whole <= DAY).then_some(whole)
}

impl Hours {
    /// Returns whether a window contains this minute.
    /// - `day`: Monday 0 to Sunday 6.
    /// - `minute`: minute of the day.
    pub fn contains(&self, day: u8, minute: u16) -> bool {
        self.0.iter().any(|window| {
            let is_day = |day: u8| {
                let (first, last) = window.days;
                if first <= last { (first..=last).contains(&day) } else { day >= first || day <= last }
            };
            let today = is_day(day) && (window.begin..window.begin.saturating_add(window.length)).contains(&minute);
            // Part of a window that began yesterday and ends today.
            let rest = (window.begin + window.length).saturating_sub(DAY);
            today || (is_day((day + 6) % 7) && minute < rest)
        })
    }

    /// Returns whether a window contains the present, in local time.
    pub fn contains_now(&self) -> bool {
        let now = jiff::Zoned::now();
        let minute = u16::from(now.hour().unsigned_abs()) * 60 + u16::from(now.minute().unsigned_abs());
        self.contains(now.weekday().to_monday_zero_offset().unsigned_abs(), minute)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn hours(text: &str) -> Hours {
        text.parse().unwrap_or_else(|error| panic!("{error}"))
    }

    #[test]
    fn a_window_over_midnight_belongs_to_the_day_on_which_it_begins() {
        let nights = hours("20:00-06:00");
        assert!(
            (0..7).all(|day| nights.contains(day, 20 * 60) && nights.contains(day, 0) && nights.contains(day, 359))
        );
        assert!((0..7).all(|day| !nights.contains(day, 6 * 60) && !nights.contains(day, 20 * 60 - 1)));
        let workdays = hours("Mon-Fri 20:00-06:00");
        assert!(workdays.contains(4, 23 * 60) && workdays.contains(5, 300), "Friday's night ends on Saturday");
        assert!(
            !workdays.contains(5, 23 * 60) && !workdays.contains(6, 300) && !workdays.contains(0, 300),
            "Sunday has none"
        );
    }

    #[test]
    fn several_windows_add_up_and_a_week_may_be_cut_anywhere() {
        let both = hours("Mon-Fri 18:00-24:00, sat-sun 00:00-24:00");
        assert!(
            both.contains(0, 1439)
                && !both.contains(0, 60)
                && both.contains(5, 0)
                && both.contains(6, 1439)
                && !both.contains(1, 0)
        );
        let over_the_end = hours("Sat-Mon 10:00-11:00");
        let days: Vec<u8> = (0..7).filter(|&day| over_the_end.contains(day, 630)).collect();
        assert_eq!(days, [0, 5, 6]);
    }

    #[test]
    fn what_is_no_window_is_refused() {
        for text in [
            "",
            "20:00",
            "20-06",
            "25:00-06:00",
            "20:60-06:00",
            "20:00-20:00",
            "Mo 20:00-06:00",
            "20:00-06:00,",
            "24:00-01:00",
            "-1:00-02:00",
        ] {
            assert!(text.parse::<Hours>().is_err(), "{text}");
        }
    }
}
