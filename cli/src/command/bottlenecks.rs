//! `femc bottlenecks FRAME.paths...`: lists the objects, materials and lamps that make frames noisy, and those that make paths
//! long.

use crate::args::FormatArgs;
use crate::exit::{Exit, Failure};
use crate::output::{Say, json};
use clap::{Args, ValueEnum};
use femc_reports::attempts::{Column, csv, human};
use femc_reports::light::{self, Report, bottleneck_table as table};
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
    of: Option<Of>,
    /// Sort key of the lines
    #[arg(long, value_enum, default_value_t = Order::Noise, value_name = "WHAT")]
    by: Order,
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
pub enum Of {
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
pub enum Order {
    /// The most noise
    Noise,
    /// The most light
    Light,
    /// The most intersections
    Work,
    /// The most throughput after 8 intersections
    Deep,
}

impl From<Order> for light::Order {
    fn from(order: Order) -> Self {
        match order {
            Order::Noise => Self::Noise,
            Order::Light => Self::Light,
            Order::Work => Self::Work,
            Order::Deep => Self::Deep,
        }
    }
}

/// Runs `femc bottlenecks`.
pub fn run(args: &BottlenecksArgs, say: Say) -> Result<Exit, Failure> {
    let report = Report::read(&args.files, args.by.into())?;
    if args.format.json {
        json::print(say, &report)?;
        return Ok(Exit::Done);
    }
    if args.csv {
        say.result(match args.of.unwrap_or(Of::Parts) {
            Of::Parts => csv(&table::parts(), &report.parts),
            Of::Objects => csv(&table::objects(), &report.objects),
            Of::Materials => csv(&table::materials(), &report.materials),
            Of::Lamps => csv(&table::lamps(), &report.lamps),
            Of::Fireflies => csv(&table::fireflies(), &report.fireflies),
        });
        return Ok(Exit::Done);
    }
    let lines = args.lines;
    match args.of {
        Some(Of::Parts) => show(say, &table::parts(), &report.parts, lines),
        Some(Of::Objects) => show(say, &table::objects(), &report.objects, lines),
        Some(Of::Materials) => show(say, &table::materials(), &report.materials, lines),
        Some(Of::Lamps) => show(say, &table::lamps(), &report.lamps, lines),
        Some(Of::Fireflies) => show(say, &table::fireflies(), &report.fireflies, lines),
        None => {
            report.findings.iter().for_each(|finding| say.result(finding));
            say.result("");
            show(say, &table::parts(), &report.parts, lines);
        }
    }
    Ok(Exit::Done)
}

/// Prints a table for people.
fn show<R>(say: Say, columns: &[Column<R>], rows: &[R], lines: usize) {
    if rows.is_empty() {
        say.note("no such records");
        return;
    }
    say.result(human(columns, &rows[..rows.len().min(lines)]));
    if rows.len() > lines {
        say.note(format!("and {} more; --lines, --csv and --json list them", rows.len() - lines));
    }
}
