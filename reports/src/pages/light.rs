//! Page about light: pictures of the statistics of frames' paths.

use super::figure::{Area, BLUE, DrawResult, FONT, ORANGE, figure};
use super::page::Page;
use crate::ReportError;
use crate::attempts::visible_cells;
use crate::human;
use crate::light::{BottleneckReport as Findings, bottleneck_table as table};
use femc_film::Picture;
use femc_pipeline::paths::LightStatistics;
use femc_pipeline::paths::attribute::Attribute;
use femc_pipeline::paths::histogram::{Counts, Histograms, Table};
use femc_pipeline::paths::pixels::{Pixel, PixelMaps};
use femc_pipeline::paths::schema::{FINE_BINS, Scale, Words, radiance_edge, throughput_edge};
use plotters::prelude::*;
use std::path::PathBuf;

/// Most files that are shown individually.
pub const MAX_FILES: usize = 24;
/// Number of lines of a table.
const LINES: usize = 20;
/// Number of histograms side by side.
const ACROSS: usize = 4;
/// Height of a histogram, pixels.
const HEIGHT: u32 = 150;
/// Widest picture, pixels.
const MAX_PICTURE_WIDTH: u32 = 1024;

/// Returns the HTML file about the light of frames.
pub fn html(frames: &[(PathBuf, LightStatistics)], findings: &Findings) -> Result<String, ReportError> {
    let names: Vec<String> = frames.iter().map(|(path, _)| path.display().to_string()).collect();
    let mut page = Page::new(&format!("Light of {}", shortened(&names)));
    let samples: u64 = frames.iter().map(|(_, all)| all.samples()).sum();
    let recorded: usize = frames.iter().map(|(_, all)| all.paths.len()).sum();
    page.facts(&[
        ("Frames", names.len().to_string()),
        ("Samples", human::quantity(samples as f64)),
        ("Recorded paths", human::quantity(recorded as f64)),
        ("Paths with at least 8 intersections", human::percent(findings.deep_samples)),
    ]);
    page.section("Findings", "See `femc bottlenecks`.");
    findings.findings.iter().for_each(|finding| page.text(&finding.to_string()));
    let (titles, cells) = visible_cells(&table::part_columns(), &findings.parts[..findings.parts.len().min(LINES)]);
    page.cells(&titles, &cells);
    if findings.lamps.len() > 1 {
        let (titles, cells) = visible_cells(&table::lamp_columns(), &findings.lamps[..findings.lamps.len().min(LINES)]);
        page.cells(&titles, &cells);
    }
    for ((_, all), name) in frames.iter().zip(&names) {
        page.section(&format!("Maps of {name}"), "All samples of each pixel. Dark: low; bright: high.");
        for map in maps(all) {
            page.picture(&map.title, &map.png()?);
        }
        for table in Table::ALL {
            let histograms = Histograms::from_statistics(all, table);
            page.section(
                &format!("Histograms of {} of {name}", table.name()),
                "Recorded paths. Bars: fractions of the image; lines: fractions of the samples.",
            );
            page.figures(&draw(&histograms)?, "No such record.");
        }
    }
    Ok(page.finish())
}

fn shortened(names: &[String]) -> String {
    match names {
        [one] => one.clone(),
        [first, .., last] => format!("{first} to {last}"),
        [] => String::new(),
    }
}

/// A map of the film with its color scale.
struct Map {
    title: String,
    film: [u32; 2],
    shares: Vec<f64>,
}

fn maps(all: &LightStatistics) -> Vec<Map> {
    let maps = PixelMaps::from_statistics(all);
    let pixels: Vec<Pixel> = maps.pixels().collect();
    let logarithmic = |of: fn(&Pixel) -> f64, title: &str, unit: &str| {
        let values: Vec<f64> = pixels.iter().map(of).collect();
        let most = values.iter().copied().fold(0.0, f64::max);
        let least = values.iter().copied().filter(|value| *value > 0.0).fold(most, f64::min).max(most * 1e-5);
        let share = |value: &f64| {
            if *value > 0.0 && most > least {
                ((value / least).ln() / (most / least).ln()).clamp(0.0, 1.0)
            } else {
                0.0
            }
        };
        let [low, high] = [least, most].map(human::number);
        let title = format!("{title}, {unit}: {low} to {high}, logarithmic");
        Map { title, film: maps.film, shares: values.iter().map(share).collect() }
    };
    let linear = |of: fn(&Pixel) -> f64, title: &str| {
        let values: Vec<f64> = pixels.iter().map(of).collect();
        let (least, most) =
            values.iter().fold((f64::INFINITY, 0.0_f64), |(least, most), it| (least.min(*it), most.max(*it)));
        let share = |value: &f64| if most > least { (value - least) / (most - least) } else { 0.0 };
        let [low, high] = [least, most].map(human::number);
        Map { title: format!("{title}: {low} to {high}"), film: maps.film, shares: values.iter().map(share).collect() }
    };
    vec![
        logarithmic(|it| it.luminance, "Luminance", "cd/m2"),
        logarithmic(|it| it.variance.sqrt(), "Standard deviation of a sample", "cd/m2"),
        linear(|it| it.depth, "Intersections of a path"),
        linear(|it| it.throughput, "Throughput at the end of a path"),
    ]
}

impl Map {
    fn png(&self) -> Result<Vec<u8>, ReportError> {
        let [width, height] = self.film;
        let pixels = self.shares.iter().map(|share| color(*share)).collect();
        Picture { width, height, pixels }.shrunk_to(MAX_PICTURE_WIDTH).to_png().map_err(ReportError::from)
    }
}

/// Maps a fraction to a color from dark blue through red to light yellow. Lightness increases with the fraction.
fn color(share: f64) -> [u8; 3] {
    const STOPS: [[f64; 3]; 5] =
        [[8.0, 8.0, 30.0], [75.0, 20.0, 110.0], [185.0, 50.0, 85.0], [245.0, 135.0, 40.0], [252.0, 250.0, 190.0]];
    let place = share.clamp(0.0, 1.0) * (STOPS.len() - 1) as f64;
    let from = (place as usize).min(STOPS.len() - 2);
    let part = place - from as f64;
    std::array::from_fn(|channel| {
        let [a, b] = [STOPS[from][channel], STOPS[from + 1][channel]];
        (a + (b - a) * part + 0.5) as u8
    })
}

/// Draws the histograms of a table. Names have no order, so their histograms are left out. A table without records gives no
/// picture.
fn draw(histograms: &Histograms) -> Result<Vec<String>, ReportError> {
    let all = histograms.table.attributes().iter().zip(&histograms.attributes);
    let shown: Vec<(&Attribute, &Counts)> = all.filter(|(attribute, _)| attribute.scale != Scale::Name).collect();
    if shown.iter().all(|(_, counts)| counts.samples.iter().all(|count| *count == 0)) {
        return Ok(Vec::new());
    }
    let rows = shown.len().div_ceil(ACROSS);
    let drawn = figure(HEIGHT * rows as u32, |area| {
        let places = area.split_evenly((rows, ACROSS));
        shown.iter().zip(places).try_for_each(|((attribute, counts), place)| histogram(&place, attribute, counts))
    })?;
    Ok(vec![drawn])
}

fn shares(counts: &[u64]) -> Vec<f64> {
    let all: u64 = counts.iter().fold(0, |sum, count| sum.saturating_add(*count));
    counts.iter().map(|count| *count as f64 / all.max(1) as f64).collect()
}

fn histogram(area: &Area<'_>, attribute: &Attribute, counts: &Counts) -> DrawResult {
    let (image, samples) = (shares(&counts.image), shares(&counts.samples));
    // Leave out empty bins at the end.
    let last = samples.iter().rposition(|share| *share > 0.0).unwrap_or(0);
    let bins = match attribute.scale {
        Scale::Count | Scale::Class(_) => last + 1,
        _ => FINE_BINS,
    };
    let most = image.iter().chain(&samples).copied().fold(0.0, f64::max) * 1.05;
    let mut chart = ChartBuilder::on(area)
        .margin(6)
        .caption(attribute.name, FONT)
        .x_label_area_size(18)
        .y_label_area_size(34)
        .build_cartesian_2d(0.0..bins as f64, 0.0..most.max(1e-9))?;
    chart
        .configure_mesh()
        .disable_mesh()
        .label_style(("sans-serif", 10))
        .x_labels(if matches!(attribute.scale, Scale::Class(_)) { bins } else { 5 })
        .y_labels(3)
        .x_label_formatter(&|bin| label(attribute, *bin))
        .y_label_formatter(&|share| human::percent(*share))
        .draw()?;
    let bars = (0..bins)
        .filter(|bin| image[*bin] > 0.0)
        .map(|bin| Rectangle::new([(bin as f64, 0.0), (bin as f64 + 1.0, image[bin])], BLUE.filled()));
    chart.draw_series(bars)?;
    let steps = (0..bins).flat_map(|bin| [(bin as f64, samples[bin]), (bin as f64 + 1.0, samples[bin])]);
    chart.draw_series(LineSeries::new(steps, ORANGE.stroke_width(1)))?;
    Ok(())
}

/// Returns the label of a bin's lower end.
fn label(attribute: &Attribute, place: f64) -> String {
    let bin = place.round().clamp(0.0, (FINE_BINS - 1) as f64) as u8;
    match attribute.scale {
        Scale::Radiance => power(radiance_edge(bin)),
        Scale::Throughput => power(throughput_edge(bin)),
        Scale::Count => bin.to_string(),
        Scale::Film(_) | Scale::World(_) => human::percent(f64::from(bin) / FINE_BINS as f64),
        Scale::Class(words) => class(words, bin).to_owned(),
        Scale::Name => String::new(),
    }
}

fn power(edge: f64) -> String {
    if edge > 0.0 { format!("{edge:.0e}") } else { "0".to_owned() }
}

/// Returns the word of a bin of words.
fn class(words: Words, bin: u8) -> &'static str {
    let Some(number) = bin.checked_sub(1).map(usize::from) else { return "none" };
    words.list().get(number).copied().unwrap_or("")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn colors_become_lighter_and_words_are_those_of_the_bins() {
        let light = |share: f64| {
            let [r, g, b] = color(share).map(f64::from);
            0.2126 * r + 0.7152 * g + 0.0722 * b
        };
        assert!((0..100).all(|step| light(f64::from(step) / 100.0) < light(f64::from(step + 1) / 100.0)));
        assert_eq!(
            (class(Words::End, 0), class(Words::End, 1), class(Words::Technique, 2)),
            ("none", "escaped", "met")
        );
        assert_eq!(class(Words::Interaction, 3), "diffuse");
    }
}
