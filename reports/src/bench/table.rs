//! Figures as text, equal on a terminal and on a page.

use super::method::Method;
use super::setup::Setup;
use super::statistics::{Estimate, Interval};
use super::summary::{MethodSummary, Point, SceneSummary, Summary};
use crate::human::{counted_noun, percent, quantity};

/// Titles and rows of a table.
pub type Table = (Vec<&'static str>, Vec<Vec<String>>);

/// Fraction of reference noise in an error above which the image's own error is uncertain.
const MAX_NOISE_SHARE: f64 = 0.5;

/// Returns the setup of the measurements as names and values.
pub fn facts(setup: &Setup, summary: &Summary) -> [(&'static str, String); 4] {
    let seeds = match summary.seeds[..] {
        [first, .., last] => format!("{first} to {last}"),
        [one] => one.to_string(),
        [] => "none".to_owned(),
    };
    let Setup { processor, cores, threads, version, engine, profile, instructions } = setup;
    [
        ("Machine", format!("{processor}, {}", counted_noun(*cores as u64, "core"))),
        ("Threads", threads.to_string()),
        ("Build", format!("femc {version}, {profile}, {instructions}, engine {engine}")),
        ("Seeds", seeds),
    ]
}

/// Returns the table of a scene's methods and budgets.
pub fn points(scene: &SceneSummary) -> Table {
    let titles = vec![
        "method",
        "budget",
        "spp",
        "seconds",
        "median",
        "cpu",
        "relmse",
        "mse",
        "flip",
        "worst block",
        "1/(relmse s)",
        "time at equal relmse",
        "at equal worst block",
    ];
    let first = scene.methods.first().map_or("", |first| first.method);
    (titles, scene.points.iter().map(|point| row(point, first)).collect())
}

fn row(point: &Point, first: &str) -> Vec<String> {
    let budget = Method::from_name(point.method)
        .map_or_else(|_| three_digits(point.budget), |it| it.format_budget(point.budget));
    vec![
        point.method.to_owned(),
        budget,
        three_digits(point.spp),
        format_estimate(point.seconds),
        three_digits(point.seconds_median),
        three_digits(point.cpu_seconds.mean),
        format_estimate(point.relmse),
        format_estimate(point.mse),
        format_estimate(point.flip),
        format_estimate(point.worst),
        point.efficiency.map_or_else(|| "-".to_owned(), format_interval),
        if point.method == first { "1".to_owned() } else { format_ratio(point.time_ratio) },
        if point.method == first { "1".to_owned() } else { format_ratio(point.worst_time_ratio) },
    ]
}

/// Returns notes that a reader of a scene's figures must know.
pub fn notes(scene: &SceneSummary) -> Vec<String> {
    let mut notes = Vec::new();
    match scene.reference_noise {
        Some(noise) => notes.push(format!(
            "the reference's own relmse {} and mse {} are subtracted; flip and the worst block include its noise",
            three_digits(noise.relmse),
            three_digits(noise.mse)
        )),
        None => notes.push("the reference's own noise is unknown and counts as error".to_owned()),
    }
    for point in scene.points.iter().filter(|point| point.noise_share.is_some_and(|share| share > MAX_NOISE_SHARE)) {
        let (method, budget) = (point.method, point.budget);
        let share = percent(point.noise_share.unwrap_or_default());
        notes.push(format!(
            "{method}, {budget}: {share} of the measured relmse is the reference's noise; use a better reference"
        ));
    }
    notes
}

/// Returns the table that compares methods with the first one. It is empty if there is no other method.
pub fn methods(summary: &Summary) -> Table {
    let titles = vec!["method", "scenes", "efficiency at equal relmse", "time at equal relmse", "at equal worst block"];
    let row = |method: &MethodSummary| {
        vec![
            method.method.to_owned(),
            method.scenes.to_string(),
            format_ratio(method.efficiency_ratio),
            format_ratio(method.time_ratio),
            format_ratio(method.worst_time_ratio),
        ]
    };
    (titles, summary.methods.iter().skip(1).map(row).collect())
}

/// Formats an estimate: `0.0123 ±4 %`.
pub fn format_estimate(estimate: Estimate) -> String {
    let relative = estimate.half_width.map(|half| half / estimate.mean).filter(|it| it.is_finite() && *it >= 0.0);
    match relative {
        Some(relative) => format!("{} ±{}", three_digits(estimate.mean), percent(relative)),
        None => three_digits(estimate.mean),
    }
}

/// Formats an interval: `12.5 (11.8 to 13.3)`.
fn format_interval(interval: Interval) -> String {
    match interval.interval {
        Some([low, high]) => {
            format!("{} ({} to {})", three_digits(interval.value), three_digits(low), three_digits(high))
        }
        None => three_digits(interval.value),
    }
}

/// Formats a ratio at equal error.
fn format_ratio(ratio: Option<Interval>) -> String {
    ratio.map_or_else(|| "outside the measured range".to_owned(), format_interval)
}

/// Formats a number with three significant digits.
pub fn three_digits(value: f64) -> String {
    let size = value.abs();
    if size >= 1e4 {
        return quantity(value);
    }
    if size < 1e-3 && size > 0.0 {
        return format!("{value:.2e}");
    }
    let decimals = if size > 0.0 { (2 - size.log10().floor() as i32).clamp(0, 5) as usize } else { 0 };
    let text = format!("{value:.decimals$}");
    // A sample count of 4.00 becomes 4.
    if text.contains('.') && value.fract() == 0.0 { format!("{value:.0}") } else { text }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_have_three_digits_that_count() {
        let shown = [0.012_345, 0.5, 4.0, 123.4, 0.000_123_4, 45_600.0, 0.0, -0.02].map(three_digits);
        assert_eq!(shown, ["0.0123", "0.500", "4", "123", "1.23e-4", "45.6 k", "0", "-0.0200"]);
        assert_eq!(format_estimate(Estimate { mean: 2.5, half_width: Some(0.1) }), "2.50 ±4.00 %");
        assert_eq!(format_interval(Interval { value: 2.0, interval: Some([1.5, 2.5]) }), "2 (1.50 to 2.50)");
    }
}
