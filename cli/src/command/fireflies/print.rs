//! Prints the report for people.

use super::report::{BlockReport, BrightestReport, FirefliesReport, LampReport, OriginReport, ScattererReport};
use crate::output::{Printer, human};

/// Number of origins in the table.
const MAX_ROWS: usize = 15;
/// Number of brightest samples whose paths are printed.
const MAX_PATHS: usize = 3;

/// Prints blocks, table and paths.
pub fn print(printer: Printer, report: &FirefliesReport) {
    if report.blocks.is_empty() {
        printer.result("no block has an error");
        return;
    }
    printer
        .result(format!("{}\n", human::table(&["block", "error", "mean", "worst pixels", "mostly"], &blocks(report))));
    let rows: Vec<Vec<String>> = report.origins.iter().take(MAX_ROWS).map(row).collect();
    let header = ["variance", "light", "bounce", "what happened", "on what", "lamp", "brightest sample"];
    printer.result(human::table(&header, &rows));
    if let more @ 1.. = report.origins.len().saturating_sub(MAX_ROWS) {
        let rest: f64 = report.origins.iter().skip(MAX_ROWS).map(|origin| origin.share).sum();
        let more = human::counted_noun(more as u64, "more origin");
        printer.result(format!("and {more} with {} (--json lists all)", share(rest)));
    }
    printer.result("\npaths of the brightest samples, from the camera:");
    for origin in report.origins.iter().take(MAX_PATHS) {
        printer.result(format!("  {}", path(origin)));
    }
    if let Some(decisions) = &report.decisions {
        printer.result("");
        decisions.table().into_iter().for_each(|line| printer.result(line));
    }
    if report.unlike > 0 {
        printer.result(printer.style_warning(&format!(
            "{} with unknown samples: their first samples were used",
            human::counted_noun(report.unlike, "pixel")
        )));
    }
}

fn blocks(report: &FirefliesReport) -> Vec<Vec<String>> {
    let row = |block: &BlockReport| {
        let pixels = block.pixels.iter().map(|it| format!("{},{} {}", it.x, it.y, share(it.share)));
        let mostly = block.origins.first().map(|it| {
            let lamp = it.lamp.as_ref().map_or(String::new(), |it| format!(", {}", it.name));
            format!("{} bounce {}, {}, {}{lamp}", share(it.share), it.bounce, technique(it), describe_scatterer(&it.on))
        });
        vec![
            format!("{},{}", block.x, block.y),
            human::percent(block.relative_error),
            number(block.mean),
            pixels.collect::<Vec<_>>().join("  "),
            mostly.unwrap_or_default(),
        ]
    };
    report.blocks.iter().map(row).collect()
}

fn row(origin: &OriginReport) -> Vec<String> {
    let BrightestReport { x, y, sample, luminance, times_mean, .. } = &origin.brightest;
    vec![
        share(origin.share),
        share(origin.light),
        origin.bounce.to_string(),
        technique(origin),
        describe_scatterer(&origin.on),
        origin.lamp.as_ref().map_or(String::new(), lamp),
        format!("{x},{y} #{sample}: {} cd/m2, {} x mean", number(*luminance), number(*times_mean)),
    ]
}

/// Returns text like `light drawn at a surface`, `lamp met by scattering, guided`.
fn technique(origin: &OriginReport) -> String {
    format!("{}{}", origin.how, if origin.guided { ", guided" } else { "" })
}

fn path(origin: &OriginReport) -> String {
    let BrightestReport { x, y, sample, path, .. } = &origin.brightest;
    let vertices = path.iter().map(|it| {
        let place = it.position.map(|p| format!("{p:.2}")).join(" ");
        let what = if it.on.material.is_none() && it.on.medium.is_none() {
            "lamp".to_owned()
        } else {
            describe_scatterer(&it.on)
        };
        format!("{what} ({place})")
    });
    format!("{x},{y} #{sample}: {}", vertices.collect::<Vec<_>>().join(" > "))
}

/// Returns text like `asphalt of street`, `medium fog`.
fn describe_scatterer(on: &ScattererReport) -> String {
    let unnamed = |name: &str| if name.is_empty() { "(unnamed)".to_owned() } else { name.to_owned() };
    match (&on.material, &on.medium) {
        (Some(material), _) if on.object.is_empty() => unnamed(material),
        (Some(material), _) => format!("{} of {}", unnamed(material), on.object),
        (None, Some(medium)) => format!("medium {medium}"),
        (None, None) => "camera".to_owned(),
    }
}

fn lamp(lamp: &LampReport) -> String {
    let name = if lamp.name.is_empty() { "(unnamed)" } else { &lamp.name };
    let object = if lamp.object.is_empty() { String::new() } else { format!(" of {}", lamp.object) };
    format!("{name}{object}, {}", lamp.location())
}

fn share(fraction: f64) -> String {
    format!("{:.1} %", 100.0 * fraction)
}

/// Formats a number with three digits.
fn number(value: f64) -> String {
    match value.abs() {
        0.0 => "0".to_owned(),
        a if (0.01..10.0).contains(&a) => format!("{value:.3}"),
        a if (10.0..1000.0).contains(&a) => format!("{value:.1}"),
        a if a >= 1000.0 => format!("{value:.0}"),
        _ => format!("{value:.2e}"),
    }
}
