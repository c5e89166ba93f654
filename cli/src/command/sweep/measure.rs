//! Measurements of the frames of a sweep: `frames` has one row per frame, `variants` one per variant.

use super::folder::{FrameEntry, SweepFolder};
use super::resolved::{PlannedVariant, ResolvedSweep};
use crate::command::readings;
use crate::exit::{Failure, failed};
use crate::output::human;
use femc_film::{Image, exr};
use femc_pipeline::measure::SummaryRow;
use femc_reports::measure::part_rows;
use femc_reports::sweep::{Cells, Table};
use serde::Serialize;
use std::collections::BTreeMap;

/// Measurements of a frame.
pub struct FrameMeasurement<'a> {
    variant: &'a PlannedVariant,
    frame: u32,
    entry: FrameEntry,
    /// Mean luminance of the film, cd/m2; `None`: the frame has no picture.
    luminance: Option<f64>,
    /// Mean luminances of the regions, cd/m2.
    regions: Vec<f64>,
    contrasts: Vec<Option<f64>>,
}

/// Measures all existing frames, in the order of the sweep.
pub fn measure<'a>(sweep: &'a ResolvedSweep, folder: &SweepFolder) -> Result<Vec<FrameMeasurement<'a>>, Failure> {
    let mut seen: BTreeMap<String, (Option<f64>, Vec<f64>)> = BTreeMap::new();
    let mut measured = Vec::new();
    for variant in &sweep.variants {
        for planned in &variant.frames {
            let name = variant.file(planned.frame);
            let Some(shot) = folder.entry(&name).filter(|entry| entry.key == planned.key) else { continue };
            if variant.is_only_measured {
                seen.insert(shot.key.clone(), (None, Vec::new()));
            } else if !seen.contains_key(&shot.key) {
                let image = exr::read(&folder.join(&name)).map_err(failed)?.image;
                let regions = sweep.measures.regions.iter().map(|region| mean(&image, region.bounds)).collect();
                seen.insert(shot.key.clone(), (Some(mean(&image, [0, 0, image.width, image.height])), regions));
            }
            let (luminance, regions) = seen[&shot.key].clone();
            let contrasts = contrasts(sweep, &regions);
            measured.push(FrameMeasurement {
                variant,
                frame: planned.frame,
                entry: shot.clone(),
                luminance,
                regions,
                contrasts,
            });
        }
    }
    Ok(measured)
}

/// Returns the mean luminance of the finite pixels in a rectangle, cd/m2.
fn mean(image: &Image, [x0, y0, x1, y1]: [u32; 4]) -> f64 {
    let (x1, y1) = (x1.min(image.width), y1.min(image.height));
    let pixels = (y0..y1).flat_map(|y| (x0..x1).map(move |x| y as usize * image.width as usize + x as usize));
    let finite = pixels.map(|at| f64::from(image.luminance(at))).filter(|y| y.is_finite());
    let (sum, count) = finite.fold((0.0, 0u64), |(sum, count), y| (sum + y, count + 1));
    sum / count.max(1) as f64
}

/// Returns Weber contrasts; none against black.
fn contrasts(sweep: &ResolvedSweep, regions: &[f64]) -> Vec<Option<f64>> {
    let of = |name: &str| {
        sweep.measures.regions.iter().zip(regions).find(|(region, _)| region.name == name).map(|(_, l)| *l)
    };
    let contrast = |target: &str, background: &str| {
        let (target, background) = (of(target)?, of(background).filter(|background| *background > 0.0)?);
        Some((target - background) / background)
    };
    sweep.measures.contrasts.iter().map(|pair| contrast(&pair.target, &pair.background)).collect()
}

/// Returns a table with a row for each frame.
pub fn frames(sweep: &ResolvedSweep, measured: &[FrameMeasurement<'_>]) -> Table {
    let rows: Vec<Vec<&FrameMeasurement<'_>>> = measured.iter().map(|one| vec![one]).collect();
    let mut table = variant_table(sweep, &measured.iter().map(|one| one.variant).collect::<Vec<_>>());
    table.add("frame", Cells::Count(measured.iter().map(|one| i64::from(one.frame)).collect()));
    table.add("file", Cells::Text(measured.iter().map(|one| one.variant.file(one.frame)).collect()));
    let same_as = |one: &FrameMeasurement<'_>| one.entry.same_as.clone().unwrap_or_default();
    table.add("same_as", Cells::Text(measured.iter().map(same_as).collect()));
    add_measurements(sweep, &rows, &mut table);
    table
}

/// Returns a table with a row for each variant: means of its frames, the worst error, the sum of the seconds.
pub fn variants(sweep: &ResolvedSweep, measured: &[FrameMeasurement<'_>]) -> Table {
    let of = |variant: &PlannedVariant| measured.iter().filter(|one| std::ptr::eq(one.variant, variant)).collect();
    let rows: Vec<Vec<&FrameMeasurement<'_>>> = sweep.variants.iter().map(of).collect();
    let mut table = variant_table(sweep, &sweep.variants.iter().collect::<Vec<_>>());
    table.add("frames", Cells::Count(rows.iter().map(|row| row.len() as i64).collect()));
    let linked = |row: &Vec<&FrameMeasurement<'_>>| row.iter().filter(|one| one.entry.same_as.is_some()).count() as i64;
    table.add("frames_linked", Cells::Count(rows.iter().map(linked).collect()));
    add_measurements(sweep, &rows, &mut table);
    table
}

/// Starts a table with the columns of the variant and its values.
fn variant_table(sweep: &ResolvedSweep, rows: &[&PlannedVariant]) -> Table {
    let mut table = Table::default();
    table.add("variant", Cells::Text(rows.iter().map(|variant| variant.name.clone()).collect()));
    for (at, axis) in sweep.axes.iter().enumerate() {
        let values = || rows.iter().map(|variant| &variant.values[at]);
        let cells = if sweep.variants.iter().all(|variant| variant.values[at].number.is_some()) {
            Cells::Number(values().map(|value| value.number).collect())
        } else {
            Cells::Text(values().map(|value| value.text.clone()).collect())
        };
        table.add(axis, cells);
    }
    table
}

fn add_measurements(sweep: &ResolvedSweep, rows: &[Vec<&FrameMeasurement<'_>>], table: &mut Table) {
    let mut add = |name: String, value: &dyn Fn(&FrameMeasurement<'_>) -> Option<f64>, join: fn(&[f64]) -> f64| {
        let cell = |row: &Vec<&FrameMeasurement<'_>>| {
            let values: Vec<f64> = row.iter().filter_map(|one| value(one)).collect();
            (!values.is_empty()).then(|| join(&values))
        };
        table.add(name, Cells::Number(rows.iter().map(cell).collect()));
    };
    let mean: fn(&[f64]) -> f64 = |values| values.iter().sum::<f64>() / values.len() as f64;
    add("mean_luminance".into(), &|one| one.luminance, mean);
    for (at, region) in sweep.measures.regions.iter().enumerate() {
        add(format!("luminance.{}", region.name), &|one| one.regions.get(at).copied(), mean);
    }
    for (at, contrast) in sweep.measures.contrasts.iter().enumerate() {
        add(format!("contrast.{}", contrast.name), &|one| one.contrasts[at], mean);
    }
    add("relative_error".into(), &|one| one.entry.relative_error, |values| values.iter().copied().fold(0.0, f64::max));
    add("spp".into(), &|one| Some(f64::from(one.entry.spp)), mean);
    add("seconds".into(), &|one| Some(one.entry.seconds), |values| values.iter().sum());
}

/// Readings of a part in a frame of a variant.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct MeasuredPart {
    /// Name of the variant.
    variant: String,
    /// Place of the variant in the sweep.
    #[serde(skip)]
    place: usize,
    frame: u32,
    /// Summary of the part's readings. A single reading is its own mean.
    #[serde(flatten)]
    summary: SummaryRow,
}

/// Reads the readings of all existing frames, in the order of the sweep.
pub fn measured_parts(sweep: &ResolvedSweep, folder: &SweepFolder) -> Result<Vec<MeasuredPart>, Failure> {
    let mut parts = Vec::new();
    if sweep.first.settings.measure.is_none() {
        return Ok(parts);
    }
    for (place, variant) in sweep.variants.iter().enumerate() {
        for planned in &variant.frames {
            let name = variant.file(planned.frame);
            if folder.has(&name, &planned.key) {
                let document = readings::read(&folder.join(&name))?;
                let part =
                    |summary| MeasuredPart { variant: variant.name.clone(), place, frame: planned.frame, summary };
                parts.extend(part_rows(&document).into_iter().map(part));
            }
        }
    }
    Ok(parts)
}

/// Returns a table with a row for each part in each frame of each variant.
pub fn readings(sweep: &ResolvedSweep, parts: &[MeasuredPart]) -> Table {
    let mut table = variant_table(sweep, &parts.iter().map(|part| &sweep.variants[part.place]).collect::<Vec<_>>());
    let rows = || parts.iter().map(|part| &part.summary);
    let text = |value: fn(&SummaryRow) -> String| Cells::Text(rows().map(value).collect());
    let number = |value: fn(&SummaryRow) -> Option<f64>| Cells::Number(rows().map(value).collect());
    table.add("frame", Cells::Count(parts.iter().map(|part| i64::from(part.frame)).collect()));
    table.add("part", text(|row| row.part.clone()));
    table.add("quantity", text(|row| row.quantity.word().to_owned()));
    table.add("lamp", text(|row| row.lamp.clone().unwrap_or_default()));
    table.add("readings", Cells::Count(rows().map(|row| row.readings as i64).collect()));
    table.add("area_m2", number(|row| row.area));
    table.add("mean", number(|row| Some(row.mean)));
    table.add("unit", text(|row| row.unit.clone()));
    table.add("mean_half_width", number(|row| Some(row.mean_half_width)));
    table.add("least", number(|row| row.least));
    table.add("greatest", number(|row| row.greatest));
    table.add("uniformity", number(|row| row.uniformity));
    table.add("dark", Cells::Count(rows().map(|row| row.dark as i64).collect()));
    table.add("lit_uniformity", number(|row| row.lit_uniformity));
    table
}

/// Returns a table of the parts for people, without the light by lamp.
pub fn readings_text(sweep: &ResolvedSweep, parts: &[MeasuredPart]) -> String {
    let optional = |value: Option<f64>| value.map_or_else(|| "-".to_owned(), human::number);
    let row = |part: &MeasuredPart| {
        let SummaryRow { part: name, mean, unit, mean_half_width, least, greatest, uniformity, .. } = &part.summary;
        let error = if *mean > 0.0 { human::percent(mean_half_width / mean) } else { "-".to_owned() };
        vec![
            sweep.title(&sweep.variants[part.place]),
            part.frame.to_string(),
            name.clone(),
            format!("{} {unit}", human::number(*mean)),
            error,
            optional(*least),
            optional(*greatest),
            optional(*uniformity),
        ]
    };
    let rows: Vec<Vec<String>> = parts.iter().filter(|part| part.summary.lamp.is_none()).map(row).collect();
    human::table(&["variant", "frame", "part", "mean", "error", "least", "greatest", "uniformity"], &rows)
}
