//! `femc paths FRAME.paths`: the light paths of a frame that was rendered with `--stats`.

mod table;

use crate::args::FormatArgs;
use crate::attempts::{Column, Json, csv, human, write_parquet};
use crate::exit::{Exit, Failure, failed, usage};
use crate::output::{Say, human as words, json};
use clap::{Args, ValueEnum};
use femc_pipeline::paths::query::{Condition, Query, is_known};
use femc_pipeline::paths::represent::{Bins, Target, representative};
use femc_pipeline::paths::schema::path_bins;
use femc_pipeline::paths::{Kind, Path as LightPath, Statistics};
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use table::Match;

/// List light paths of a frame: where they have been, and what light they have found
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  \
    femc paths box.paths                                        # what there is\n  \
    femc paths box.paths --where 'radiance.g > 2 and bounce == 2 and interaction == reflection'\n  \
    femc paths box.paths --object room.plant --then room.wall --table intersections --csv\n  \
    femc paths box.paths --where 'occluder == door' --in 0,0,0,1,1,2.5 --json | jq length\n  \
    femc paths box.paths --few 5000 --parquet few.parquet && python3 -c \\\n    \
    \"import pandas; print(pandas.read_parquet('few.parquet').radiance_g.describe())\"\n  \
    femc paths box.paths --table pairs --parquet pairs.parquet\n\n\
    A condition is asked of every intersection of a path: bounce, position.x .y .z, radiance.r .g .b, throughput.r .g .b, \
    object, material, interaction (absorbed, emission, diffuse, glossy, reflection, refraction, straight, volume); of the lights that \
    were looked for there: light, light.radiance.r .g .b, occluder, found; of the path: path.radiance.r .g .b, path.throughput.r .g .b, \
    depth, pixel.x, pixel.y, sample, end (escaped, absorbed, roulette, depth, field). == != < <= > >= and or not ( ). An object is \
    also all that is in it.\n\n\
    The paths are a fair subset of all samples, by hashes of their numbers; the share is said. --brightest and --deepest are those of \
    greatest radiance, and of greatest throughput after 8 intersections or more, of all samples.")]
pub struct PathsArgs {
    /// The file beside the frame
    #[arg(value_name = "FRAME.paths")]
    file: PathBuf,
    /// What an intersection of the path is like
    #[arg(long = "where", value_name = "CONDITION")]
    condition: Option<String>,
    /// Object that the path has come to
    #[arg(long, value_name = "NAME")]
    object: Option<String>,
    /// Object that it has come to later (repeatable)
    #[arg(long, value_name = "NAME", requires = "object")]
    then: Vec<String>,
    /// Corners of a box of the world that the intersection is in, m
    #[arg(long = "in", value_name = "X,Y,Z,X,Y,Z", value_delimiter = ',', allow_hyphen_values = true)]
    within: Option<Vec<f64>>,
    /// The brightest samples of each tile in place of a fair subset
    #[arg(long, conflicts_with_all = ["deepest", "few"])]
    brightest: bool,
    /// The deepest paths of greatest throughput of each tile in place of a fair subset
    #[arg(long, conflicts_with = "few")]
    deepest: bool,
    /// List N paths whose histograms are nearest to the histograms of all paths
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    few: Option<u32>,
    /// What a line is of
    #[arg(long, value_enum, default_value_t = Table::Paths, value_name = "WHAT")]
    table: Table,
    /// Lines for people
    #[arg(long, value_name = "N", default_value_t = 20)]
    lines: usize,
    /// Print CSV on stdout, the names of the columns first
    #[arg(long, conflicts_with = "json")]
    csv: bool,
    /// Write an Apache Parquet file
    #[arg(long, value_name = "FILE", conflicts_with_all = ["json", "csv"])]
    parquet: Option<PathBuf>,
    #[command(flatten)]
    format: FormatArgs,
}

/// What is listed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Table {
    /// A path
    Paths,
    /// An intersection that is as asked for
    Intersections,
    /// A light that such a path has looked for
    Lights,
    /// A bin of an attribute's histogram, of all paths of the file
    Histograms,
    /// A bin of the histogram of two attributes
    Pairs,
    /// A voxel of the scene's box, with the energy of the paths' intersections
    Voxels,
    /// A pixel of the image, with what is known of all its samples
    Pixels,
}

/// List.
pub fn run(args: &PathsArgs, say: Say) -> Result<Exit, Failure> {
    let all = read(&args.file)?;
    let query = query(args, &all)?;
    let found = found(args, &all, &query, say);
    let out = Out { args, say };
    match args.table {
        Table::Paths => out.put(&table::paths(), &table::path_rows(&all, &found))?,
        Table::Intersections => out.put(&table::intersections(), &table::intersection_rows(&all, &found))?,
        Table::Lights => out.put(&table::lights(), &table::light_rows(&all, &found))?,
        Table::Histograms => out.put(&table::histograms(), &table::bin_rows(&all))?,
        Table::Pairs => out.put(&table::pairs(), &table::pair_rows(&all))?,
        Table::Voxels => out.put(&table::voxels(), &table::voxel_rows(&all, &found))?,
        Table::Pixels => out.put(&table::pixels(), &table::pixel_rows(&all))?,
    }
    Ok(Exit::Done)
}

/// The statistics in a file.
pub fn read(file: &Path) -> Result<Statistics, Failure> {
    let bytes = std::fs::read(file).map_err(|error| usage(format!("{}: {error}", file.display())))?;
    Statistics::decode(&bytes).map_err(|error| failed(format!("{}: {error}", file.display())))
}

fn query(args: &PathsArgs, all: &Statistics) -> Result<Query, Failure> {
    let condition = args.condition.as_deref().map(Condition::parse).transpose();
    let condition = condition.map_err(|error| usage(format!("--where: {error}")))?;
    let objects: Vec<String> = args.object.iter().chain(&args.then).cloned().collect();
    for object in &objects {
        if !is_known(&all.names, object) {
            let known = all.names.values().filter(|(kind, _)| *kind == Kind::Object).map(|(_, name)| name.as_str());
            let known: BTreeSet<&str> = known.collect();
            let some: Vec<&str> = known.iter().copied().take(12).collect();
            let more = if known.len() > some.len() { ", ..." } else { "" };
            return Err(usage(format!(
                "no path of {} has come to an object {object:?}; known are {}{more}",
                args.file.display(),
                some.join(", ")
            )));
        }
    }
    let corners = |numbers: &[f64]| match *numbers {
        [a, b, c, d, e, f] if numbers.iter().all(|x| x.is_finite()) && a <= d && b <= e && c <= f => {
            Ok([[a, b, c], [d, e, f]])
        }
        _ => Err(usage("--in: six numbers: the lower corner of the box, then the upper one")),
    };
    let within = args.within.as_deref().map(corners).transpose()?;
    Ok(Query { condition, objects, within })
}

/// The paths that are asked for, in the order of the file.
fn found<'a>(args: &PathsArgs, all: &'a Statistics, query: &Query, say: Say) -> Vec<Match<'a>> {
    let few = args.few.map(|few| chosen(all, few as usize, say));
    let (paths, what): (Vec<&LightPath>, _) = match (args.brightest, args.deepest) {
        (true, _) => (all.fireflies(), "of the brightest"),
        (_, true) => (all.bottlenecks(), "of the deepest"),
        _ => (all.paths.values().collect(), "recorded"),
    };
    let of = paths.len();
    let mut found = Vec::new();
    for (number, path) in (0..).zip(paths) {
        if few.as_ref().is_some_and(|few| !few.contains(&number)) {
            continue;
        }
        if let Some(places) = query.matches(&all.scope, &all.names, path) {
            found.push(Match { number, path, places });
        }
    }
    let (samples, share) = (all.samples(), words::number(100.0 * all.share()));
    let about = if args.brightest || args.deepest || few.is_some() {
        String::new()
    } else {
        format!(", about {} samples", words::quantity(found.len() as f64 / all.share().max(f64::MIN_POSITIVE)))
    };
    say.note(format!(
        "{} of {of} paths {what}{about}; {share} % of {} samples are recorded",
        found.len(),
        words::quantity(samples as f64)
    ));
    found
}

/// Numbers of paths that stand for all.
fn chosen(all: &Statistics, few: usize, say: Say) -> BTreeSet<u32> {
    let bins: Vec<Bins> = all.paths.values().map(|path| path_bins(&all.scope, path)).collect();
    let candidates = &bins[..bins.len().min(few.saturating_mul(8))];
    let found = representative(candidates, &Target::of(&bins), few);
    say.note(format!(
        "{} paths stand for {}: D = {:.4}, DJ = {:.3}; worth {:.0} of equal weight",
        found.chosen.len(),
        bins.len(),
        found.distance.single,
        found.distance.joint,
        found.effective
    ));
    found.chosen.into_iter().collect()
}

struct Out<'a> {
    args: &'a PathsArgs,
    say: Say,
}

impl Out<'_> {
    fn put<R>(&self, columns: &[Column<R>], rows: &[R]) -> Result<(), Failure> {
        let Self { args, say } = *self;
        if let Some(path) = &args.parquet {
            write_parquet(path, columns, rows)?;
            say.note(format!("{}: {} rows", path.display(), rows.len()));
        } else if args.format.json {
            json::print(say, &Json(columns, rows))?;
        } else if args.csv {
            say.result(csv(columns, rows));
        } else if !rows.is_empty() {
            say.result(human(columns, &rows[..rows.len().min(args.lines)]));
            if rows.len() > args.lines {
                say.note(format!(
                    "and {} more; --lines, --csv, --json and --parquet list them",
                    rows.len() - args.lines
                ));
            }
        }
        Ok(())
    }
}
