//! `femc stylize`: paints renders in the style of a painted example, guided by light.

mod checkpoint;
mod row;

use crate::args::{FormatArgs, glob_match};
use crate::clock::Clock;
use crate::exit::{Exit, Failure, failed, usage};
use crate::output::{Printer, Progress, human, json};
use crate::threads;
use crate::values::{Exposure, PaintingStyle, guide_frame};
use checkpoint::RunCheckpoint;
use clap::{Args, ValueEnum};
use femc_film::{LuminanceLevels, ToneCurve, file};
use femc_stylize::{
    ChannelImage, Checkpoint, Example, GuideFrame, PreviousFrame, ProgressObserver, Settings, StylizeError,
    StylizedImage, frames,
};
use row::Row;
use serde::Serialize;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};

/// Paint renders in the style of a painted example, guided by light
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  \
    femc render room.mgf -o room.exr --layers guides\n  \
    femc stylize --style oil --target room.layers.exr -o room.png\n  \
    femc stylize --style painted.png --source ball.layers.exr --target room.layers.exr -o room.png\n  \
    femc stylize --style painted.png --source ball.layers.exr --target 'drive/*.layers.exr' -o painted/\n\n\
    A painting is painted over its source, a render, pixel by pixel. The guides are the layers of light that both source and target \
    have; without such layers, the pictures themselves. The source has its own exposure; all targets share another. Several \
    targets are painted one after the other, as frames of a clip: with layers motion (and depth), each frame follows the \
    painting of the frames before it. The same files and settings give the same pictures with any number of threads.")]
pub struct StylizeArgs {
    /// Painting, of the source's size; or a style that comes with femc: hatching, watercolor, oil, cel
    #[arg(long, value_name = "PAINTED.png")]
    style: PathBuf,
    /// Render that was painted [default: that of the styles that come with femc]
    #[arg(long, value_name = "A.exr")]
    source: Option<PathBuf>,
    /// Renders to paint; * matches any text in the name of a file
    #[arg(long, value_name = "B.exr", num_args = 1.., required = true)]
    target: Vec<PathBuf>,
    /// Picture to write; for several targets a folder, `FOLDER/`
    #[arg(long, short, value_name = "OUT.png")]
    out: PathBuf,
    /// Layers used as guides [default: all layers of light that source and target have]
    #[arg(long, value_name = "NAMES", value_delimiter = ',')]
    guides: Vec<String>,
    /// Exposure of the targets: auto, or an exposure value (EV at ISO 100)
    #[arg(long, value_name = "EV", default_value_t = Exposure::Auto)]
    exposure: Exposure,
    /// Search method for patches
    #[arg(long, value_enum, default_value_t = Method::Balanced)]
    method: Method,
    /// Weight of all guides against the style: higher values follow the light more and the brush less
    #[arg(long, value_name = "WEIGHT", default_value_t = Settings::default().mu)]
    mu: f32,
    /// Importance of using the whole painting: the color difference, in levels of 255, that average use is worth
    #[arg(long, value_name = "LEVELS", default_value_t = Settings::default().balance)]
    balance: f32,
    /// Amount by which the painting of a clip may change where the frames do not, from 0 (none) to 1 (each frame is painted
    /// independently)
    #[arg(long, value_name = "PART", default_value_t = Settings::default().boil)]
    boil: f32,
    /// Width of patches, pixels: odd, 3 to 15
    #[arg(long, value_name = "N", default_value_t = Settings::default().patch)]
    patch: usize,
    /// Levels of the image pyramids [default: 6, or the most that the images allow]
    #[arg(long, value_name = "N")]
    levels: Option<usize>,
    /// Searches at each level, each followed by a vote
    #[arg(long, value_name = "N", default_value_t = Settings::default().iterations as u32,
        value_parser = clap::value_parser!(u32).range(1..=100))]
    iterations: u32,
    /// Threads [default: all cores]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=4096))]
    threads: Option<u32>,
    #[command(flatten)]
    format: FormatArgs,
}

/// Assignment of source patches to target patches.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum, Serialize)]
#[serde(rename_all = "lowercase")]
enum Method {
    /// By similarity, with a penalty on source patches that are used often
    Balanced,
    /// The best source patch for each target patch, by brute force: slow, for comparison
    Em,
}

#[derive(Serialize)]
struct StylizeReport {
    method: Method,
    mu: f32,
    balance: f32,
    boil: f32,
    patch: usize,
    iterations: usize,
    guides: Vec<String>,
    seconds: f64,
    frames: Vec<Row>,
}

/// Runs `femc stylize`.
pub fn run(args: &StylizeArgs, printer: Printer) -> Result<Exit, Failure> {
    let targets = expand_targets(&args.target)?;
    let outputs = args.outputs(&targets)?;
    let style = PaintingStyle::read(&args.style, args.source.as_deref())?;
    if let Some(paper) = style.transparency_warning() {
        printer.warning(format!("--style {}: {paper}", args.style.display()));
    }
    let (settings, threads) = (args.settings(), args.threads.unwrap_or(0));
    let curve = common_curve(args.exposure, &targets)?;
    let request = PaintRequest { style: &style, guides: &args.guides, curve, settings, threads };
    let PaintResult { guides, seconds, frames, has_motion } =
        request.paint(&targets, &outputs, &RunCheckpoint::path(&args.out), printer)?;
    let Settings { mu, balance, boil, patch, iterations, .. } = settings;
    let report = StylizeReport { method: args.method, mu, balance, boil, patch, iterations, guides, seconds, frames };
    if args.format.json {
        json::print(printer, &report)?;
    } else {
        print(printer, &report);
    }
    if report.frames.len() > 1 && !has_motion {
        printer.note(
            "each target was painted independently, because they have no layer `motion`; \
                `femc render --layers motion,depth` writes it",
        );
    }
    Ok(Exit::Done)
}

/// A request to paint frames.
pub struct PaintRequest<'a> {
    /// Style of the paintings.
    pub style: &'a PaintingStyle,
    /// Names of the guiding layers; empty: all that source and frames have.
    pub guides: &'a [String],
    /// Tone curve of the frames.
    pub curve: ToneCurve,
    /// Settings of the painter.
    pub settings: Settings,
    /// Threads; 0: all cores.
    pub threads: u32,
}

/// Result of painting.
pub struct PaintResult {
    /// Names of the layers used as guides.
    pub guides: Vec<String>,
    /// Total time in seconds.
    pub seconds: f64,
    /// Report rows, frame by frame.
    pub frames: Vec<Row>,
    /// Whether the frames have motion vectors.
    pub has_motion: bool,
}

impl PaintRequest<'_> {
    /// Paints frames in order, each after its predecessor; needs at least one target. An interrupted run resumes at the level where
    /// it stopped.
    /// - `outputs`: picture file of each target;
    /// - `checkpoint_path`: checkpoint file, which exists while painting runs.
    pub fn paint(
        &self,
        targets: &[PathBuf],
        outputs: &[PathBuf],
        checkpoint_path: &Path,
        printer: Printer,
    ) -> Result<PaintResult, Failure> {
        let (clock, progress) = (Clock, Mutex::new(Progress::new(printer, Clock)));
        let started = clock.now();
        let PaintingStyle { painting, source, source_path, .. } = self.style;
        let first = guide_frame("--target", &targets[0])?;
        let names = match self.guides {
            [] => frames::common_guides(source, &first).map_err(|error| map_stylize_error(&error, &targets[0]))?,
            named => named.iter().map(String::as_str).collect(),
        };
        let shown = source.guides(&names, ToneCurve::auto(source.exposure_image().as_ref()));
        let guides = shown.map_err(|error| map_stylize_error(&error, source_path))?;
        let example = Example { style: painting, guides: &guides };
        let pool = threads::pool(Some(self.threads))?;
        let paint = |frame: &GuideFrame,
                     before: Option<&PreviousFrame>,
                     begun: Option<Checkpoint>,
                     watch: &dyn ProgressObserver| {
            let shown = frame.guides(&names, self.curve)?;
            pool.install(|| femc_stylize::stylize(example, &shown, before, &self.settings, begun, watch))
        };
        let keys = self.frame_keys(&names, &guides, targets);
        let mut checkpoint = RunCheckpoint::read(checkpoint_path).filter(|kept| {
            let painted = outputs.get(..kept.frame).unwrap_or_default();
            keys.get(kept.frame) == Some(&kept.key) && painted.iter().all(|out| out.exists())
        });
        let mut first = Some(first);
        let (mut rows, mut last): (Vec<Row>, Option<(StylizedImage, GuideFrame)>) = (Vec::new(), None);
        if let Some(checkpoint) = &mut checkpoint {
            printer.note(format!(
                "{}: resuming, {} of {} painted",
                checkpoint_path.display(),
                checkpoint.frame,
                targets.len()
            ));
            rows = std::mem::take(&mut checkpoint.rows);
            if let Some(target) = checkpoint.frame.checked_sub(1).map(|at| &targets[at]) {
                let frame = guide_frame("--target", target)?;
                let done = Checkpoint { levels_left: 0, patches: std::mem::take(&mut checkpoint.last) };
                let painted =
                    paint(&frame, None, Some(done), &()).map_err(|error| map_stylize_error(&error, target))?;
                last = Some((painted, frame));
            }
        }
        let (first_left, mut begun) = checkpoint.map_or((0, None), |kept| (kept.frame, kept.in_progress));
        for (at, (target, out)) in targets.iter().zip(outputs).enumerate().skip(first_left) {
            let began = clock.now();
            let frame = match first.take().filter(|_| at == 0) {
                Some(first) => first,
                None => guide_frame("--target", target)?,
            };
            let to_failure = |error: StylizeError| map_stylize_error(&error, target);
            let before = pool.install(|| last.as_ref().and_then(|(painted, frame)| warp_previous(painted, frame)));
            let before = before.transpose().map_err(to_failure)?;
            let fields = last.map(|(painted, _)| painted.field.patches).unwrap_or_default();
            let keep = |begun| {
                RunCheckpoint::new(keys[at].clone(), at, rows.clone(), fields.clone(), begun).write(checkpoint_path)
            };
            if at > first_left {
                keep(None)?;
            }
            let watch = PaintingObserver {
                report_progress: &|now| {
                    let part = (at as f64 + now.fraction) / targets.len() as f64;
                    let text = || format!("{}: level {}/{}", out.display(), now.level, now.levels);
                    progress.lock().unwrap_or_else(PoisonError::into_inner).update(part, text);
                },
                save_checkpoint: &|begun| {
                    if let Err(failure) = keep(Some(begun)) {
                        printer.warning(format!(
                            "{}: cannot save the progress: {}",
                            checkpoint_path.display(),
                            failure.message
                        ));
                    }
                },
            };
            let painted = paint(&frame, before.as_ref(), begun.take(), &watch).map_err(to_failure)?;
            file::write_atomic(out, &frames::image_to_picture(&painted.image).to_png().map_err(failed)?)
                .map_err(failed)?;
            let flicker = before.and_then(|before| before.flicker(&painted.image));
            rows.push(Row::new(out, &painted, flicker, clock.since(began).as_secs_f64()));
            last = Some((painted, frame));
        }
        match std::fs::remove_file(checkpoint_path) {
            Err(error) if error.kind() != std::io::ErrorKind::NotFound => {
                return Err(failed(format!("{}: {error}", checkpoint_path.display())));
            }
            _ => {}
        }
        Ok(PaintResult {
            guides: names.into_iter().map(str::to_owned).collect(),
            seconds: clock.since(started).as_secs_f64(),
            frames: rows,
            has_motion: last.is_some_and(|(_, frame)| frame.motion().is_some()),
        })
    }

    /// Returns a digest for each frame of everything that determines its bytes.
    fn frame_keys(&self, names: &[&str], guides: &ChannelImage, targets: &[PathBuf]) -> Vec<String> {
        let mut key = blake3::Hasher::new();
        let Self { curve, settings, .. } = self;
        key.update(format!("{} {settings:?} {curve:?} {names:?}", env!("CARGO_PKG_VERSION")).as_bytes());
        for image in [&self.style.painting, guides] {
            for value in image.values() {
                key.update(&value.to_le_bytes());
            }
        }
        let digest = |target: &PathBuf| {
            key.update(&std::fs::read(target).unwrap_or_default());
            key.finalize().to_hex().to_string()
        };
        targets.iter().map(digest).collect()
    }
}

/// Shows the progress of a frame's painting, and saves checkpoints.
struct PaintingObserver<'a> {
    report_progress: &'a (dyn Fn(femc_stylize::Progress) + Sync),
    save_checkpoint: &'a (dyn Fn(Checkpoint) + Sync),
}

impl ProgressObserver for PaintingObserver<'_> {
    fn on_progress(&self, now: femc_stylize::Progress) {
        (self.report_progress)(now);
    }

    fn on_checkpoint(&self, begun: Checkpoint) {
        (self.save_checkpoint)(begun);
    }
}

/// Returns the previous frame, warped to the view of this one; `None`: its motion is not known.
fn warp_previous(painted: &StylizedImage, frame: &GuideFrame) -> Option<Result<PreviousFrame, StylizeError>> {
    frame.motion().map(|motion| PreviousFrame::new(painted, motion, frame.depth()))
}

impl StylizeArgs {
    fn settings(&self) -> Settings {
        let method = match self.method {
            Method::Balanced => femc_stylize::Method::Balanced,
            Method::Em => femc_stylize::Method::Em,
        };
        let Self { mu, balance, boil, patch, levels, .. } = *self;
        Settings { method, mu, balance, boil, patch, levels, iterations: self.iterations as usize }
    }

    /// Returns the picture file of each target.
    fn outputs(&self, targets: &[PathBuf]) -> Result<Vec<PathBuf>, Failure> {
        let is_png = self.out.extension().is_some_and(|ending| ending.eq_ignore_ascii_case("png"));
        match targets {
            [_] if is_png => return Ok(vec![self.out.clone()]),
            [_, _, ..] if is_png => {
                let count = human::counted_noun(targets.len() as u64, "target");
                return Err(usage(format!(
                    "-o {}: {count}, but this is one picture; give a folder, FOLDER/",
                    self.out.display()
                )));
            }
            _ => {}
        }
        let is_folder = self.out.is_dir() || self.out.as_os_str().as_encoded_bytes().ends_with(b"/");
        if !is_folder {
            return Err(usage(format!("-o {}: give FILE.png, or a folder, FOLDER/", self.out.display())));
        }
        std::fs::create_dir_all(&self.out).map_err(|error| failed(format!("-o {}: {error}", self.out.display())))?;
        let place = |target: &PathBuf| {
            let stem = Path::new(target.file_stem().unwrap_or_default());
            let stem =
                if stem.extension().is_some_and(|it| it == "layers") { stem.with_extension("") } else { stem.into() };
            let mut name = stem.into_os_string();
            name.push(".png");
            self.out.join(name)
        };
        let places: Vec<PathBuf> = targets.iter().map(place).collect();
        match (1..places.len()).find(|&at| places[..at].contains(&places[at])) {
            Some(at) => Err(usage(format!(
                "--target: two files would both be painted as {}; rename one of them",
                places[at].display()
            ))),
            None => Ok(places),
        }
    }
}

/// Returns the common tone curve of all targets.
pub fn common_curve(exposure: Exposure, targets: &[PathBuf]) -> Result<ToneCurve, Failure> {
    let mut all = LuminanceLevels::default();
    if exposure == Exposure::Auto {
        for target in targets {
            let exposed = guide_frame("--target", target)?.exposure_image();
            all.merge(&exposed.as_ref().map_or_else(LuminanceLevels::default, LuminanceLevels::from_image));
        }
    }
    Ok(exposure.curve(&all))
}

/// Converts an error into a message with advice.
/// - `path`: the faulty frame, if any.
fn map_stylize_error(error: &StylizeError, path: &Path) -> Failure {
    let path = path.display();
    match error {
        StylizeError::Mu(mu) => usage(format!("--mu {mu}: give a number that is not negative")),
        StylizeError::Balance(balance) => usage(format!("--balance {balance}: give a number that is not negative")),
        StylizeError::Boil(boil) => usage(format!("--boil {boil}: give a number from 0 to 1")),
        StylizeError::Patch(patch) => usage(format!("--patch {patch}: give an odd number from 3 to 15")),
        StylizeError::Levels { most: 0, patch, .. } => {
            usage(format!("source or {path} has fewer than {patch} rows or columns, the width of a patch; see --patch"))
        }
        StylizeError::Levels { levels, most, patch } => {
            usage(format!("--levels {levels}: images of this size and patches of {patch} pixels allow 1 to {most}"))
        }
        StylizeError::NothingInCommon { source_guides, target_guides } => failed(format!(
            "the source has the layers {}, {path} has {}: no layer in common; render both with --layers guides",
            source_guides.join(", "),
            target_guides.join(", ")
        )),
        StylizeError::NoGuide(name) => failed(format!("{path}: no layer `{name}`; see --guides")),
        StylizeError::PreviousFrameSize { .. } => {
            failed(format!("{path}: {error}; all frames of a clip have one size: paint this file separately"))
        }
        StylizeError::NotFinite { .. } => failed(format!("{path}: {error}; render or repair the image")),
        StylizeError::Shape { .. }
        | StylizeError::StyleSize { .. }
        | StylizeError::StyleChannels(_)
        | StylizeError::ForeignCheckpoint
        | StylizeError::Brushwork
        | StylizeError::File(_)
        | StylizeError::Channels { .. } => failed(format!("{path}: {error}")),
    }
}

/// Returns the files to paint: named files, and for each pattern all matching files in alphabetical order.
fn expand_targets(requested: &[PathBuf]) -> Result<Vec<PathBuf>, Failure> {
    let mut all = Vec::new();
    for path in requested {
        let Some(pattern) = path.file_name().and_then(|name| name.to_str()).filter(|name| name.contains('*')) else {
            all.push(path.clone());
            continue;
        };
        let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
        let fault = |error| failed(format!("--target {}: {error}", path.display()));
        let entries = std::fs::read_dir(folder).and_then(Iterator::collect::<Result<Vec<_>, _>>).map_err(fault)?;
        let mut names: Vec<String> = entries.iter().filter_map(|entry| entry.file_name().into_string().ok()).collect();
        names.retain(|name| glob_match(pattern, name));
        names.sort_unstable();
        if names.is_empty() {
            return Err(usage(format!("--target {}: no such file", path.display())));
        }
        all.extend(names.iter().map(|name| path.with_file_name(name)));
    }
    Ok(all)
}

fn print(printer: Printer, report: &StylizeReport) {
    let columns = ["picture", "guide error", "entropy", "unused", "sharpness", "flicker", "time"];
    let row = |row: &Row| {
        let or_none = |value: Option<f64>, digits: usize| value.map_or("-".to_owned(), |it| format!("{it:.digits$}"));
        vec![
            row.image.clone(),
            format!("{:.1}", row.figures.guide_error),
            format!("{:.2} of {:.2}", row.figures.usage_entropy, row.figures.usage_entropy_most),
            human::percent(row.figures.unused),
            or_none(row.figures.sharpness, 3),
            or_none(row.flicker, 2),
            human::seconds(row.seconds),
        ]
    };
    let rows: Vec<Vec<String>> = report.frames.iter().map(row).collect();
    printer.result(human::table(&columns, &rows));
    for row in &report.frames {
        printer.note(format!("wrote {}", row.image));
    }
}
