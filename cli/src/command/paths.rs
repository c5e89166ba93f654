//! `femc paths FRAME.paths...`: lists the light paths of frames that were rendered with `--stats`.

use crate::args::FormatArgs;
use crate::exit::{Exit, Failure, usage};
use crate::output::{Printer, human, json};
use clap::{Args, ValueEnum};
use femc_pipeline::paths::attribute::path_bins;
use femc_pipeline::paths::octree::Root;
use femc_pipeline::paths::query::{Condition, Query, is_known_name, is_within};
use femc_pipeline::paths::recorded::RepresentativePaths;
use femc_pipeline::paths::represent::{PathBins, rarest_paths};
use femc_pipeline::paths::summary::Group;
use femc_pipeline::paths::{LightPath, LightStatistics, NameKind};
use femc_reports::attempts::{Column, RowsAsJson, csv, text_table, write_parquet};
use femc_reports::light::path_table::{self as table, Match, QueriedFrame};
use femc_reports::light::summary;
use femc_reports::light::{self, FrameSet};
use std::collections::BTreeSet;
use std::path::PathBuf;

/// List light paths of frames: their intersections, and the light that they found
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  \
    femc paths box.paths                                        # the recorded paths\n  \
    femc paths box.paths --where 'radiance.g > 2 and bounce == 2 and interaction == reflection'\n  \
    femc paths box.paths --object room.plant --then room.wall --table intersections --csv\n  \
    femc paths box.paths --where 'occluder == door' --in 0,0,0,1,1,2.5 --json | jq length\n  \
    femc paths box.paths --in room.plant --table intersections  # in the box of the intersections with the plant\n  \
    femc paths box.paths --rarest 100                           # paths with rare attributes\n  \
    femc paths fog/*/*.paths --table voxels --parquet fog.parquet      # one box for all frames, for comparable voxels\n  \
    femc paths new.paths --table voxels --minus old.paths       # where light has increased and decreased\n  \
    femc paths new.paths --by lamp,bounce --minus old.paths     # light of each lamp and bounce, and what differs\n  \
    femc paths drive --out drive.paths                          # combine all frames in a folder\n  \
    femc paths drive.paths --few 5000                           # representative paths of the whole clip\n  \
    femc paths box.paths --few 5000 --parquet few.parquet && python3 -c \\\n    \
    \"import pandas; print(pandas.read_parquet('few.parquet').radiance_g.describe())\"\n  \
    femc paths box.paths --table pairs --parquet pairs.parquet\n\n\
    A condition applies to an intersection of a path. Fields of the intersection: bounce, position.x .y .z, radiance.r .g .b, \
    throughput.r .g .b, object, material, interaction (absorbed, emission, diffuse, glossy, reflection, refraction, straight, \
    volume). Fields of the lights that were sampled there: light, light.radiance.r .g .b, occluder, found. Fields of the path: \
    path.radiance.r .g .b, path.throughput.r .g .b, depth, pixel.x, pixel.y, sample, end (escaped, absorbed, roulette, depth, \
    field), first.x .y .z, first.object, first.interaction, last.*, brightest.radiance, brightest.light. Operators: == != < <= > >= \
    and or not ( ). The name of an object includes all objects in it.\n\n\
    More conditions: any(C) and all(C): C holds at some or all intersections of the path. light(C) and lights(C): for some or all of \
    its lights. NAME then NAME: the path visits objects in this order. in box(X,Y,Z,X,Y,Z): the intersection lies in a box. \
    in lasso(X,Y,X,Y,X,Y): the pixel lies within a closed line.\n\n\
    The recorded paths are a fair subset of all samples, selected by hashes of their numbers; their share is printed. --brightest \
    and --deepest query the paths of greatest radiance, and of greatest throughput after 8 or more intersections, of all samples.")]
pub struct PathsArgs {
    /// Statistics files (.paths) of the frames, or folders of such files
    #[arg(value_name = "FRAME.paths|FOLDER", required = true)]
    files: Vec<PathBuf>,
    /// Treat the frames of all files as one file: a frame that occurs twice counts once
    #[arg(long)]
    union: bool,
    /// Write the union of the frames of all files; it can be queried like a frame
    #[arg(long, value_name = "ALL.paths", conflicts_with_all = ["csv", "json", "parquet"])]
    out: Option<PathBuf>,
    /// Condition on an intersection of the path
    #[arg(long = "where", value_name = "CONDITION")]
    condition: Option<String>,
    /// Object that the path intersects
    #[arg(long, value_name = "NAME")]
    object: Option<String>,
    /// Object that the path intersects later (repeatable)
    #[arg(long, value_name = "NAME", requires = "object")]
    then: Vec<String>,
    /// Box of the world that contains the intersection, by its corners in m; or an object: the box of its recorded intersections
    #[arg(long = "in", value_name = "X,Y,Z,X,Y,Z|NAME", allow_hyphen_values = true)]
    within: Option<String>,
    /// Query the brightest samples of each tile instead of a fair subset
    #[arg(long, conflicts_with_all = ["deepest", "few", "rarest"])]
    brightest: bool,
    /// Query the deepest paths of greatest throughput of each tile instead of a fair subset
    #[arg(long, conflicts_with_all = ["few", "rarest"])]
    deepest: bool,
    /// List N representative paths, whose histograms are nearest to the histograms of all paths
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    few: Option<u32>,
    /// List N paths with the rarest attributes, the rarest first
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..), conflicts_with = "few")]
    rarest: Option<u32>,
    /// With --table voxels or --by: compare with this file, and subtract it
    #[arg(long, value_name = "FRAME.paths")]
    minus: Option<PathBuf>,
    /// Print the light of the matching paths in the picture, in numbers, by these groups
    #[arg(long, value_enum, value_delimiter = ',', value_name = "GROUP", conflicts_with_all = ["table", "brightest", "deepest", "few", "rarest", "out"])]
    by: Vec<By>,
    /// Subject of a line
    #[arg(long, value_enum, default_value_t = Table::Paths, value_name = "WHAT")]
    table: Table,
    /// Number of lines in the table
    #[arg(long, value_name = "N", default_value_t = 20)]
    lines: usize,
    /// Print CSV on stdout, with a header line
    #[arg(long, conflicts_with = "json")]
    csv: bool,
    /// Write an Apache Parquet file
    #[arg(long, value_name = "FILE", conflicts_with_all = ["json", "csv"])]
    parquet: Option<PathBuf>,
    #[command(flatten)]
    format: FormatArgs,
}

/// Subject of a line.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Table {
    /// A path
    Paths,
    /// An intersection that matches the query
    Intersections,
    /// A light that matches the query
    Lights,
    /// A bin of an attribute's histogram, over all paths of the file
    Histograms,
    /// A bin of the histogram of two attributes
    Pairs,
    /// A voxel of the scene's box, with the energy of the paths' intersections
    Voxels,
    /// A pixel of the image, with the statistics of all its samples
    Pixels,
}

/// Group of lines.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum By {
    /// An object with all objects in it: light that came by it
    Object,
    /// A bounce: light found at its intersections
    Bounce,
    /// A lamp: its light
    Lamp,
}

impl By {
    fn group(self) -> Group {
        match self {
            Self::Object => Group::Object,
            Self::Bounce => Group::Bounce,
            Self::Lamp => Group::Lamp,
        }
    }
}

/// Runs `femc paths`.
pub fn run(args: &PathsArgs, printer: Printer) -> Result<Exit, Failure> {
    let mut sets = light::read_all(&args.files)?;
    if args.union || args.out.is_some() {
        sets = vec![light::merge(sets)?];
    }
    if let (Some(out), [set]) = (&args.out, &sets[..]) {
        let (paths, bytes) = light::write(out, set)?;
        printer.note(format!("{}: {} frames, {paths} paths, {bytes} bytes", out.display(), set.frames.len()));
        return Ok(Exit::Done);
    }
    let minus = args.minus.as_deref().map(light::read).transpose()?;
    let is_comparable = args.table == Table::Voxels || !args.by.is_empty();
    if minus.is_some() && (!is_comparable || sets.len() > 1) {
        return Err(usage("--minus: give --table voxels or --by, and one file; --union combines several files"));
    }
    let query = query(args, &sets)?;
    if !args.by.is_empty() {
        return summarize(args, &sets, minus.as_ref(), &query, printer);
    }
    let frames: Vec<QueriedFrame<'_>> = sets.iter().flat_map(|unit| run_query(args, unit, &query, printer)).collect();
    let out = TableWriter { args, printer };
    match args.table {
        Table::Paths => out.write(&table::path_columns(), &rows(&frames, table::path_rows))?,
        Table::Intersections => out.write(&table::intersection_columns(), &rows(&frames, table::intersection_rows))?,
        Table::Lights => out.write(&table::light_columns(), &rows(&frames, table::light_rows))?,
        Table::Histograms => {
            let rows: Vec<_> = sets.iter().flat_map(table::bin_rows).collect();
            out.write(&table::bin_columns(), &rows)?;
        }
        Table::Pairs => {
            out.write(&table::pair_columns(), &sets.iter().flat_map(table::pair_rows).collect::<Vec<_>>())?;
        }
        Table::Pixels => out.write(&table::pixel_columns(), &rows(&frames, table::pixel_rows))?,
        Table::Voxels => {
            let all = sets.iter().chain(&minus).flat_map(|unit| &unit.frames);
            let root = root(all);
            let by_unit: Vec<&[QueriedFrame<'_>]> = frames.chunk_by(|a, b| a.file == b.file).collect();
            match &minus {
                None => {
                    let rows: Vec<_> = by_unit.iter().flat_map(|frames| table::voxel_rows(frames, root)).collect();
                    out.write(&table::voxel_columns(), &rows)?;
                }
                Some(minus) => {
                    let others = run_query(args, minus, &query, printer);
                    out.write(&table::difference_columns(), &table::difference_rows(&frames, &others, root))?;
                }
            }
        }
    }
    Ok(Exit::Done)
}

/// Prints the light of the matching paths in numbers.
fn summarize(
    args: &PathsArgs,
    sets: &[FrameSet],
    minus: Option<&FrameSet>,
    query: &Query,
    printer: Printer,
) -> Result<Exit, Failure> {
    let groups: Vec<Group> = args.by.iter().map(|by| by.group()).collect();
    let there = minus.map(|minus| summary::summarize(minus, query)).transpose()?;
    let mut rows = Vec::new();
    for set in sets {
        let here = summary::summarize(set, query)?;
        rows.extend(summary::summary_rows(&set.file, &groups, &here, there.as_ref()));
    }
    let columns = if minus.is_some() { summary::compared_columns() } else { summary::summary_columns() };
    TableWriter { args, printer }.write(&columns, &rows)?;
    Ok(Exit::Done)
}

fn rows<'a, R>(frames: &'a [QueriedFrame<'a>], to_rows: impl Fn(&'a QueriedFrame<'a>) -> Vec<R>) -> Vec<R> {
    frames.iter().flat_map(to_rows).collect()
}

/// Returns the cube around the boxes of all frames. Voxels are parts of it, so all frames have the same voxels.
fn root<'a>(all: impl Iterator<Item = &'a LightStatistics>) -> Root {
    let (mut lower, mut upper) = ([f64::INFINITY; 3], [f64::NEG_INFINITY; 3]);
    for LightStatistics { scope, .. } in all {
        for axis in 0..3 {
            lower[axis] = lower[axis].min(scope.lower[axis]);
            upper[axis] = upper[axis].max(scope.upper[axis]);
        }
    }
    Root::around(lower, upper, table::OCTREE_LEVELS)
}

fn query(args: &PathsArgs, all: &[FrameSet]) -> Result<Query, Failure> {
    let condition = args.condition.as_deref().map(Condition::parse).transpose();
    let condition = condition.map_err(|error| usage(format!("--where: {error}")))?;
    let objects: Vec<String> = args.object.iter().chain(&args.then).cloned().collect();
    objects.iter().try_for_each(|object| check_object(object, all))?;
    let within = args.within.as_deref().map(|within| parse_box(within, all)).transpose()?;
    Ok(Query { condition, objects, within })
}

/// Checks that some path intersects an object.
fn check_object(object: &str, all: &[FrameSet]) -> Result<(), Failure> {
    let frames = || all.iter().flat_map(|unit| &unit.frames);
    if frames().any(|all| is_known_name(&all.names, object)) {
        return Ok(());
    }
    let names = frames().flat_map(|all| all.names.values());
    let known: BTreeSet<&str> =
        names.filter(|(kind, _)| *kind == NameKind::Object).map(|(_, name)| name.as_str()).collect();
    let some: Vec<&str> = known.iter().copied().take(12).collect();
    let more = if known.len() > some.len() { ", ..." } else { "" };
    let files: Vec<&str> = all.iter().map(|unit| unit.file.as_str()).collect();
    Err(usage(format!(
        "no path of {} intersects an object {object:?}; known objects: {}{more}",
        files.join(", "),
        some.join(", ")
    )))
}

/// Parses six numbers, or returns the box of the intersections with an object.
fn parse_box(within: &str, all: &[FrameSet]) -> Result<[[f64; 3]; 2], Failure> {
    let numbers: Result<Vec<f64>, _> = within.split(',').map(|number| number.trim().parse::<f64>()).collect();
    match numbers.as_deref() {
        Ok(&[a, b, c, d, e, f]) if [a, b, c, d, e, f].iter().all(|x| x.is_finite()) && a <= d && b <= e && c <= f => {
            return Ok([[a, b, c], [d, e, f]]);
        }
        Err(_) if within.starts_with(char::is_alphabetic) || within.starts_with('_') => {}
        _ => {
            return Err(usage(
                "--in: give six numbers, the lower corner of the box and then the upper corner, or the name of an object",
            ));
        }
    }
    check_object(within, all)?;
    let (mut low, mut high) = ([f64::INFINITY; 3], [f64::NEG_INFINITY; 3]);
    for all in all.iter().flat_map(|unit| &unit.frames) {
        for it in all.paths.values().flat_map(|path| &path.intersections) {
            if is_within(&all.names, it.object, within) {
                for axis in 0..3 {
                    low[axis] = low[axis].min(it.position[axis]);
                    high[axis] = high[axis].max(it.position[axis]);
                }
            }
        }
    }
    if low[0] > high[0] {
        return Err(usage(format!("--in: no recorded path intersects {within:?}; give the corners of its box")));
    }
    Ok([low, high])
}

/// Returns the matching paths, by frame, in the order of the file; with `--rarest`, the rarest paths of a frame come first.
fn run_query<'a>(args: &PathsArgs, set: &'a FrameSet, query: &Query, printer: Printer) -> Vec<QueriedFrame<'a>> {
    let of_frame = |all: &'a LightStatistics| -> Vec<&'a LightPath> {
        match (args.brightest, args.deepest) {
            (true, _) => all.fireflies(),
            (_, true) => all.bottlenecks(),
            _ => all.paths.values().collect(),
        }
    };
    // Paths are numbered across all frames of a file.
    let paths: Vec<(usize, &LightPath)> = set
        .frames
        .iter()
        .enumerate()
        .flat_map(|(frame, all)| of_frame(all).into_iter().map(move |it| (frame, it)))
        .collect();
    let all = || (0..paths.len() as u32).map(|number| (number, None)).collect();
    let chosen: Vec<(u32, Option<f64>)> = match (args.few, args.rarest) {
        (Some(few), _) => representatives(set, few as usize, printer),
        (None, Some(most)) => {
            rarest_paths(&bins(set), most as usize).into_iter().map(|number| (number, None)).collect()
        }
        (None, None) => all(),
    };
    let mut frames: Vec<QueriedFrame<'a>> =
        set.frames.iter().map(|all| QueriedFrame { file: &set.file, statistics: all, matches: Vec::new() }).collect();
    let matchers: Vec<_> = set.frames.iter().map(|all| query.compile(&all.scope, &all.names)).collect();
    let mut count = 0;
    for (number, weight) in chosen {
        let Some(&(frame, path)) = paths.get(number as usize) else { continue };
        if let Some(selection) = matchers[frame].select(path) {
            frames[frame].matches.push(Match { number, path, selection, weight });
            count += 1;
        }
    }
    print_counts(args, set, (count, paths.len()), printer);
    frames
}

/// Prints how many paths match, and how many there are.
fn print_counts(args: &PathsArgs, set: &FrameSet, (count, total): (usize, usize), printer: Printer) {
    let what = match (args.brightest, args.deepest) {
        (true, _) => "brightest",
        (_, true) => "deepest",
        _ => "recorded",
    };
    let is_fair = !args.brightest && !args.deepest && args.few.is_none() && args.rarest.is_none();
    // All frames of a file have the same share.
    let share = set.frames.first().map_or(1.0, LightStatistics::share);
    let samples: u64 = set.frames.iter().map(LightStatistics::samples).sum();
    let about = if is_fair {
        format!(", about {} samples", human::quantity(count as f64 / share.max(f64::MIN_POSITIVE)))
    } else {
        String::new()
    };
    let frames = if set.frames.len() == 1 { String::new() } else { format!(" of {} frames", set.frames.len()) };
    printer.note(format!(
        "{count} of {total} {what} paths{about}; {} % of {} samples{frames} are recorded",
        human::number(100.0 * share),
        human::quantity(samples as f64)
    ));
}

fn bins(set: &FrameSet) -> Vec<PathBins> {
    let paths = set.frames.iter().flat_map(|all| all.paths.values().map(|path| path_bins(&all.scope, path)));
    paths.collect()
}

/// Returns the numbers of representative paths, ascending, and their weights. With these weights, the histogram of every attribute
/// is right.
fn representatives(set: &FrameSet, few: usize, printer: Printer) -> Vec<(u32, Option<f64>)> {
    let mut by_hash: Vec<_> = set.frames.iter().flat_map(|all| all.paths.keys()).zip(0u32..).collect();
    by_hash.sort_unstable();
    let by_hash: Vec<u32> = by_hash.into_iter().map(|(_, number)| number).collect();
    let found = RepresentativePaths::choose(&bins(set), &by_hash, few);
    printer.note(format!(
        "{} paths represent {}: D = {:.4}, DJ = {:.3}; their weights make them equivalent to {:.0} paths of equal weight",
        found.numbers.len(),
        found.represented,
        found.distance.single,
        found.distance.joint,
        found.effective_size
    ));
    found.numbers.into_iter().zip(found.weights.into_iter().map(Some)).collect()
}

struct TableWriter<'a> {
    args: &'a PathsArgs,
    printer: Printer,
}

impl TableWriter<'_> {
    fn write<R>(&self, columns: &[Column<R>], rows: &[R]) -> Result<(), Failure> {
        let Self { args, printer } = *self;
        if let Some(path) = &args.parquet {
            write_parquet(path, columns, rows)?;
            printer.note(format!("{}: {} rows", path.display(), rows.len()));
        } else if args.format.json {
            json::print(printer, &RowsAsJson(columns, rows))?;
        } else if args.csv {
            printer.result(csv(columns, rows));
        } else if !rows.is_empty() {
            printer.result(text_table(columns, &rows[..rows.len().min(args.lines)]));
            if rows.len() > args.lines {
                printer.note(format!(
                    "and {} more; --lines, --csv, --json and --parquet list them",
                    rows.len() - args.lines
                ));
            }
        }
        Ok(())
    }
}
