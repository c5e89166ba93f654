//! `femc paths FRAME.paths...`: the light paths of frames that were rendered with `--stats`.

mod table;

use crate::args::FormatArgs;
use crate::attempts::{Column, Json, csv, human, write_parquet};
use crate::exit::{Exit, Failure, failed, usage};
use crate::output::{Say, human as words, json};
use clap::{Args, ValueEnum};
use femc_pipeline::paths::octree::Root;
use femc_pipeline::paths::query::{Condition, Query, is_in, is_known};
use femc_pipeline::paths::represent::{Bins, Target, rarest, representative};
use femc_pipeline::paths::schema::path_bins;
use femc_pipeline::paths::{Kind, Path as LightPath, Statistics};
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use table::{Frame, Match};

/// List light paths of frames: where they have been, and what light they have found
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  \
    femc paths box.paths                                        # what there is\n  \
    femc paths box.paths --where 'radiance.g > 2 and bounce == 2 and interaction == reflection'\n  \
    femc paths box.paths --object room.plant --then room.wall --table intersections --csv\n  \
    femc paths box.paths --where 'occluder == door' --in 0,0,0,1,1,2.5 --json | jq length\n  \
    femc paths box.paths --in room.plant --table intersections  # in the box of what paths have met of the plant\n  \
    femc paths box.paths --rarest 100                           # paths with what few others have\n  \
    femc paths fog/*/*.paths --table voxels --parquet fog.parquet      # one box for all, so that voxels can be compared\n  \
    femc paths new.paths --table voxels --minus old.paths       # where light has become more, and less\n  \
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
    /// The files beside the frames
    #[arg(value_name = "FRAME.paths", required = true)]
    files: Vec<PathBuf>,
    /// What an intersection of the path is like
    #[arg(long = "where", value_name = "CONDITION")]
    condition: Option<String>,
    /// Object that the path has come to
    #[arg(long, value_name = "NAME")]
    object: Option<String>,
    /// Object that it has come to later (repeatable)
    #[arg(long, value_name = "NAME", requires = "object")]
    then: Vec<String>,
    /// Corners of a box of the world that the intersection is in, m; or an object: the box of what paths have met of it
    #[arg(long = "in", value_name = "X,Y,Z,X,Y,Z|NAME", allow_hyphen_values = true)]
    within: Option<String>,
    /// The brightest samples of each tile in place of a fair subset
    #[arg(long, conflicts_with_all = ["deepest", "few", "rarest"])]
    brightest: bool,
    /// The deepest paths of greatest throughput of each tile in place of a fair subset
    #[arg(long, conflicts_with_all = ["few", "rarest"])]
    deepest: bool,
    /// List N paths whose histograms are nearest to the histograms of all paths
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    few: Option<u32>,
    /// List N paths that have something which fewest others have, the rarest first
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..), conflicts_with = "few")]
    rarest: Option<u32>,
    /// With --table voxels: what the voxels have less in another frame of the same place
    #[arg(long, value_name = "FRAME.paths")]
    minus: Option<PathBuf>,
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
    if args.minus.is_some() && (args.table != Table::Voxels || args.files.len() > 1) {
        return Err(usage("--minus: with --table voxels, and one frame"));
    }
    let name = |file: &PathBuf| file.display().to_string();
    let all: Vec<(String, Statistics)> =
        args.files.iter().map(|file| Ok((name(file), read(file)?))).collect::<Result<_, Failure>>()?;
    let minus = args.minus.as_deref().map(read).transpose()?;
    let query = query(args, &all)?;
    let mut frames = Vec::new();
    for (file, all) in &all {
        frames.push(Frame { file, all, found: found(args, all, &query, say) });
    }
    let out = Out { args, say };
    match args.table {
        Table::Paths => out.put(&table::paths(), &rows(&frames, table::path_rows))?,
        Table::Intersections => out.put(&table::intersections(), &rows(&frames, table::intersection_rows))?,
        Table::Lights => out.put(&table::lights(), &rows(&frames, table::light_rows))?,
        Table::Histograms => out.put(&table::histograms(), &rows(&frames, table::bin_rows))?,
        Table::Pairs => out.put(&table::pairs(), &rows(&frames, table::pair_rows))?,
        Table::Pixels => out.put(&table::pixels(), &rows(&frames, table::pixel_rows))?,
        Table::Voxels => {
            let root = root(frames.iter().map(|frame| frame.all).chain(&minus));
            match &minus {
                None => out.put(&table::voxels(), &rows(&frames, |frame| table::voxel_rows(frame, root)))?,
                Some(minus) => {
                    let other = Frame { file: "", all: minus, found: found(args, minus, &query, say) };
                    let rows = rows(&frames, |frame| table::difference_rows(frame, &other, root));
                    out.put(&table::differences(), &rows)?;
                }
            }
        }
    }
    Ok(Exit::Done)
}

fn rows<'a, R>(frames: &'a [Frame<'a>], of: impl Fn(&'a Frame<'a>) -> Vec<R>) -> Vec<R> {
    frames.iter().flat_map(of).collect()
}

/// The cube about the boxes of all frames. Voxels are parts of it, so all frames have the same voxels.
fn root<'a>(all: impl Iterator<Item = &'a Statistics>) -> Root {
    let (mut lower, mut upper) = ([f64::INFINITY; 3], [f64::NEG_INFINITY; 3]);
    for Statistics { scope, .. } in all {
        for axis in 0..3 {
            lower[axis] = lower[axis].min(scope.lower[axis]);
            upper[axis] = upper[axis].max(scope.upper[axis]);
        }
    }
    Root::around(lower, upper, table::LEVELS)
}

/// The statistics in a file.
pub fn read(file: &Path) -> Result<Statistics, Failure> {
    let bytes = std::fs::read(file).map_err(|error| usage(format!("{}: {error}", file.display())))?;
    Statistics::decode(&bytes).map_err(|error| failed(format!("{}: {error}", file.display())))
}

fn query(args: &PathsArgs, all: &[(String, Statistics)]) -> Result<Query, Failure> {
    let condition = args.condition.as_deref().map(Condition::parse).transpose();
    let condition = condition.map_err(|error| usage(format!("--where: {error}")))?;
    let objects: Vec<String> = args.object.iter().chain(&args.then).cloned().collect();
    objects.iter().try_for_each(|object| known(object, all))?;
    let within = args.within.as_deref().map(|within| corners(within, all)).transpose()?;
    Ok(Query { condition, objects, within })
}

/// Whether some path has come to an object.
fn known(object: &str, all: &[(String, Statistics)]) -> Result<(), Failure> {
    if all.iter().any(|(_, all)| is_known(&all.names, object)) {
        return Ok(());
    }
    let names = all.iter().flat_map(|(_, all)| all.names.values());
    let known: BTreeSet<&str> =
        names.filter(|(kind, _)| *kind == Kind::Object).map(|(_, name)| name.as_str()).collect();
    let some: Vec<&str> = known.iter().copied().take(12).collect();
    let more = if known.len() > some.len() { ", ..." } else { "" };
    let files: Vec<&str> = all.iter().map(|(file, _)| file.as_str()).collect();
    Err(usage(format!(
        "no path of {} has come to an object {object:?}; known are {}{more}",
        files.join(", "),
        some.join(", ")
    )))
}

/// Six numbers, or the box of the intersections with an object.
fn corners(within: &str, all: &[(String, Statistics)]) -> Result<[[f64; 3]; 2], Failure> {
    let numbers: Result<Vec<f64>, _> = within.split(',').map(|number| number.trim().parse::<f64>()).collect();
    match numbers.as_deref() {
        Ok(&[a, b, c, d, e, f]) if [a, b, c, d, e, f].iter().all(|x| x.is_finite()) && a <= d && b <= e && c <= f => {
            return Ok([[a, b, c], [d, e, f]]);
        }
        Err(_) if within.starts_with(char::is_alphabetic) || within.starts_with('_') => {}
        _ => {
            return Err(usage(
                "--in: six numbers: the lower corner of the box, then the upper one; or an object's name",
            ));
        }
    }
    known(within, all)?;
    let (mut low, mut high) = ([f64::INFINITY; 3], [f64::NEG_INFINITY; 3]);
    for (_, all) in all {
        for it in all.paths.values().flat_map(|path| &path.intersections) {
            if is_in(&all.names, it.object, within) {
                for axis in 0..3 {
                    low[axis] = low[axis].min(it.position[axis]);
                    high[axis] = high[axis].max(it.position[axis]);
                }
            }
        }
    }
    if low[0] > high[0] {
        return Err(usage(format!("--in: no recorded path has come to {within:?}; give the corners of its box")));
    }
    Ok([low, high])
}

/// The paths that are asked for, in the order of the file; the rarest in theirs.
fn found<'a>(args: &PathsArgs, all: &'a Statistics, query: &Query, say: Say) -> Vec<Match<'a>> {
    let chosen = match (args.few, args.rarest) {
        (Some(few), _) => Some(representatives(all, few as usize, say)),
        (None, Some(most)) => {
            Some(rarest(&bins(all), most as usize).into_iter().map(|number| (number, None)).collect())
        }
        (None, None) => None,
    };
    let (paths, what): (Vec<&LightPath>, _) = match (args.brightest, args.deepest) {
        (true, _) => (all.fireflies(), "of the brightest"),
        (_, true) => (all.bottlenecks(), "of the deepest"),
        _ => (all.paths.values().collect(), "recorded"),
    };
    let of = paths.len();
    let is_fair = !args.brightest && !args.deepest && chosen.is_none();
    let chosen: Vec<(u32, Option<f64>)> =
        chosen.unwrap_or_else(|| (0..of as u32).map(|number| (number, None)).collect());
    let matched = |&(number, weight): &(u32, Option<f64>)| {
        let path = *paths.get(number as usize)?;
        query.matches(&all.scope, &all.names, path).map(|places| Match { number, path, places, weight })
    };
    let found: Vec<Match<'a>> = chosen.iter().filter_map(matched).collect();
    let (samples, share) = (all.samples(), words::number(100.0 * all.share()));
    let about = if is_fair {
        format!(", about {} samples", words::quantity(found.len() as f64 / all.share().max(f64::MIN_POSITIVE)))
    } else {
        String::new()
    };
    say.note(format!(
        "{} of {of} paths {what}{about}; {share} % of {} samples are recorded",
        found.len(),
        words::quantity(samples as f64)
    ));
    found
}

fn bins(all: &Statistics) -> Vec<Bins> {
    all.paths.values().map(|path| path_bins(&all.scope, path)).collect()
}

/// Numbers of paths that stand for all, in order, and what each counts so that every attribute is right.
fn representatives(all: &Statistics, few: usize, say: Say) -> Vec<(u32, Option<f64>)> {
    let bins = bins(all);
    let candidates = &bins[..bins.len().min(few.saturating_mul(8))];
    let found = representative(candidates, &Target::of(&bins), few);
    say.note(format!(
        "{} paths stand for {}: D = {:.4}, DJ = {:.3}; by their weights worth {:.0} of equal weight",
        found.chosen.len(),
        bins.len(),
        found.distance.single,
        found.distance.joint,
        found.effective
    ));
    found.chosen.into_iter().zip(found.weights.into_iter().map(Some)).collect()
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
