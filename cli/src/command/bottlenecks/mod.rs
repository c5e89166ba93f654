//! `femc bottlenecks FRAME.paths...`: which objects, materials and lamps make frames noisy, and which make their paths long.

mod report;
pub mod table;

use crate::args::FormatArgs;
use crate::attempts::csv;
use crate::exit::{Exit, Failure};
use crate::output::{Say, json};
use clap::{Args, ValueEnum};
use femc_pipeline::paths::bottlenecks::{Bottlenecks, By, Evidence};
pub use report::Report;
use std::path::PathBuf;

/// Say which objects, materials and lamps make frames noisy, and which make their paths long
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  \
    femc bottlenecks box.paths                                  # what stands out, and the parts it stands out of\n  \
    femc bottlenecks drive/*.paths --of objects                 # of all frames of a clip together\n  \
    femc bottlenecks box.paths --of lamps --csv\n  \
    femc bottlenecks box.paths --of fireflies --lines 50        # the samples that add most to the noise\n  \
    femc bottlenecks box.paths --json | jq '.findings'\n\n\
    noise: by how much samples are brighter than the others of their pixel, squared, laid to what scattered their light last; relative \
    to blocks, as --error has it. light: the light of the image, in the same way. work: the intersections of paths. deep: the \
    throughput that arrives at the 8th intersection or later. seen: paths whose first intersection it is. depth: their intersections, \
    on average. left: the throughput that is left to them at the 8th; much of it needs long paths.\n\n\
    `femc render --stats` writes the files. A file has the brightest samples of each tile, all of them, and a fair subset of the others.")]
pub struct BottlenecksArgs {
    /// The files beside the frames
    #[arg(value_name = "FRAME.paths", required = true)]
    files: Vec<PathBuf>,
    /// What a line is of; without it the findings and their parts are listed
    #[arg(long, value_enum, value_name = "WHAT")]
    of: Option<Of>,
    /// What lines are ordered by
    #[arg(long, value_enum, default_value_t = Order::Noise, value_name = "WHAT")]
    by: Order,
    /// Lines for people
    #[arg(long, value_name = "N", default_value_t = 15)]
    lines: usize,
    /// Print CSV on stdout, the names of the columns first
    #[arg(long, conflicts_with = "json")]
    csv: bool,
    #[command(flatten)]
    format: FormatArgs,
}

/// What is listed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Of {
    /// An object, a material and an interaction
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

/// What comes first.
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

impl Order {
    fn of(self, evidence: &Evidence) -> f64 {
        match self {
            Self::Noise => evidence.noise,
            Self::Light => evidence.light,
            Self::Work => evidence.intersections,
            Self::Deep => evidence.deep,
        }
    }
}

/// List.
pub fn run(args: &BottlenecksArgs, say: Say) -> Result<Exit, Failure> {
    let report = Report::read(&args.files, args.by)?;
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
        Some(Of::Parts) => table::show(say, &table::parts(), &report.parts, lines),
        Some(Of::Objects) => table::show(say, &table::objects(), &report.objects, lines),
        Some(Of::Materials) => table::show(say, &table::materials(), &report.materials, lines),
        Some(Of::Lamps) => table::show(say, &table::lamps(), &report.lamps, lines),
        Some(Of::Fireflies) => table::show(say, &table::fireflies(), &report.fireflies, lines),
        None => {
            report.findings.iter().for_each(|finding| say.result(finding));
            say.result("");
            table::show(say, &table::parts(), &report.parts, lines);
        }
    }
    Ok(Exit::Done)
}

/// What is found of files that are read one after the other.
fn found(all: &[Bottlenecks; 3], by: By) -> &Bottlenecks {
    &all[by as usize]
}
