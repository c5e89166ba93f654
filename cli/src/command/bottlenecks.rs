//! `femc bottlenecks FRAME.paths...`: lists the objects, materials and lamps that make frames noisy, and those that make paths
//! long.

use crate::args::FormatArgs;
use crate::exit::{Exit, Failure};
use crate::output::{Printer, json};
use clap::{Args, ValueEnum};
use femc_reports::attempts::{Column, csv, text_table};
use femc_reports::light::{self, BottleneckReport, bottleneck_table as table};
use std::path::PathBuf;

/// List the objects, materials and lamps that make frames noisy, and those that make paths long
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  \
    femc bottlenecks box.paths                                  # findings, and all parts of the scene\n  \
    femc bottlenecks drive/*.paths --of objects                 # all frames of a clip together\n  \
    femc bottlenecks box.paths --of lamps --csv\n  \
    femc bottlenecks box.paths --of fireflies --lines 50        # the samples that add most to the noise\n  \
    femc bottlenecks box.paths --json | jq '.findings'\n\n\
    noise: squared excess of samples over the other samples of their pixel, attributed to what scattered the light last; \
    relative to blocks, as with --error. light: the light of the image, attributed in the same way. work: the intersections of \
    paths. deep: the throughput that arrives at the 8th intersection or later. seen: paths whose first intersection is there. \
    depth: mean number of intersections of these paths. left: throughput of these paths that remains at the 8th intersection; \
    if it is high, long paths are necessary.\n\n\
    `femc render --stats` writes the files. A file contains all of the brightest samples of each tile, and a fair subset of the \
    other samples.")]
pub struct BottlenecksArgs {
    /// Statistics files (.paths) of the frames
    #[arg(value_name = "FRAME.paths", required = true)]
    files: Vec<PathBuf>,
    /// Subject of a line; without it, findings and their parts are listed
    #[arg(long, value_enum, value_name = "WHAT")]
    of: Option<RowSubject>,
    /// Sort key of the lines
    #[arg(long, value_enum, default_value_t = SortKey::Noise, value_name = "WHAT")]
    by: SortKey,
    /// Number of lines in the table
    #[arg(long, value_name = "N", default_value_t = 15)]
    lines: usize,
    /// Print CSV on stdout, with a header line
    #[arg(long, conflicts_with = "json")]
    csv: bool,
    #[command(flatten)]
    format: FormatArgs,
}

/// Subject of a line.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum RowSubject {
    /// A combination of object, material and interaction
    Parts,
    /// An object
    Objects,
    /// A material
    Materials,
    /// A lamp
    Lamps,
    /// A sample
    Fireflies,
}

/// Sort key of the lines.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum SortKey {
    /// The most noise
    Noise,
    /// The most light
    Light,
    /// The most intersections
    Work,
    /// The most throughput after 8 intersections
    Deep,
}

impl From<SortKey> for light::SortKey {
    fn from(key: SortKey) -> Self {
        match key {
            SortKey::Noise => Self::Noise,
            SortKey::Light => Self::Light,
            SortKey::Work => Self::Work,
            SortKey::Deep => Self::Deep,
        }
    }
}

/// Runs `femc bottlenecks`.
pub fn run(args: &BottlenecksArgs, printer: Printer) -> Result<Exit, Failure> {
    let report = BottleneckReport::read(&args.files, args.by.into())?;
    if args.format.json {
        json::print(printer, &report)?;
        return Ok(Exit::Done);
    }
    if args.csv {
        printer.result(match args.of.unwrap_or(RowSubject::Parts) {
            RowSubject::Parts => csv(&table::part_columns(), &report.parts),
            RowSubject::Objects => csv(&table::object_columns(), &report.objects),
            RowSubject::Materials => csv(&table::material_columns(), &report.materials),
            RowSubject::Lamps => csv(&table::lamp_columns(), &report.lamps),
            RowSubject::Fireflies => csv(&table::firefly_columns(), &report.fireflies),
        });
        return Ok(Exit::Done);
    }
    let lines = args.lines;
    match args.of {
        Some(RowSubject::Parts) => print_table(printer, &table::part_columns(), &report.parts, lines),
        Some(RowSubject::Objects) => print_table(printer, &table::object_columns(), &report.objects, lines),
        Some(RowSubject::Materials) => print_table(printer, &table::material_columns(), &report.materials, lines),
        Some(RowSubject::Lamps) => print_table(printer, &table::lamp_columns(), &report.lamps, lines),
        Some(RowSubject::Fireflies) => print_table(printer, &table::firefly_columns(), &report.fireflies, lines),
        None => {
            report.findings.iter().for_each(|finding| printer.result(finding));
            printer.result("");
            print_table(printer, &table::part_columns(), &report.parts, lines);
        }
    }
    Ok(Exit::Done)
}

/// Prints a table for people.
fn print_table<R>(printer: Printer, columns: &[Column<R>], rows: &[R], lines: usize) {
    if rows.is_empty() {
        printer.note("no such records");
        return;
    }
    printer.result(text_table(columns, &rows[..rows.len().min(lines)]));
    if rows.len() > lines {
        printer.note(format!("and {} more; --lines, --csv and --json list them", rows.len() - lines));
    }
}
