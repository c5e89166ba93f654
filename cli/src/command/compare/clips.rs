//! Compares two folders: each frame of A with the frame of the same number of B.

use super::image::read;
use crate::exit::{Exit, Failure, failed, usage};
use crate::output::{Printer, human, json};
use serde::Serialize;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

#[derive(Serialize)]
struct ClipReport {
    a: String,
    b: String,
    frames: Vec<FrameReport>,
    /// Number of frames that only one of the folders has.
    unpaired: usize,
    mean: Metrics,
}

#[derive(Serialize)]
struct FrameReport {
    frame: u32,
    #[serde(flatten)]
    metrics: Metrics,
    same_pixels: bool,
}

#[derive(Clone, Copy, Default, Serialize)]
struct Metrics {
    mse: f64,
    relmse: f64,
    ssim: f64,
    flip: f64,
    mean_ratio: f64,
}

/// Compares the frames.
pub fn run(a: &Path, b: &Path, as_json: bool, printer: Printer) -> Result<Exit, Failure> {
    let (of_a, of_b) = (frames(a)?, frames(b)?);
    let mut report = ClipReport {
        a: a.display().to_string(),
        b: b.display().to_string(),
        frames: Vec::new(),
        unpaired: 0,
        mean: Metrics::default(),
    };
    for (frame, file) in &of_a {
        let Some(other) = of_b.get(frame) else { continue };
        let (image, reference) = (read(file)?, read(other)?);
        let names = format!("{} and {}", file.display(), other.display());
        let compared = femc_film::compare_images(&image, &reference);
        let c = compared.map_err(|e| failed(format!("cannot compare {names}: {e}")))?;
        let metrics = Metrics { mse: c.mse, relmse: c.relmse, ssim: c.ssim, flip: c.flip, mean_ratio: c.mean_ratio };
        let same_pixels = femc_film::pixel_digest(&image) == femc_film::pixel_digest(&reference);
        report.frames.push(FrameReport { frame: *frame, metrics, same_pixels });
    }
    if report.frames.is_empty() {
        return Err(usage(format!("{} and {} have no frame number in common", a.display(), b.display())));
    }
    report.unpaired = of_a.len() + of_b.len() - 2 * report.frames.len();
    report.mean = mean(&report.frames);
    if as_json {
        json::print(printer, &report)?;
    } else {
        print(&report, printer);
    }
    Ok(Exit::Done)
}

/// Returns the numbered frames of a folder, `<stem>.0007.exr`.
fn frames(folder: &Path) -> Result<BTreeMap<u32, PathBuf>, Failure> {
    let at = |e: &dyn std::fmt::Display| failed(format!("{}: {e}", folder.display()));
    let mut frames = BTreeMap::new();
    for entry in std::fs::read_dir(folder).map_err(|e| at(&e))? {
        let path = entry.map_err(|e| at(&e))?.path();
        let number = |path: &Path| {
            let stem = path.file_name()?.to_str()?.strip_suffix(".exr")?;
            stem.rsplit_once('.')?.1.parse().ok()
        };
        frames.extend(number(&path).map(|number| (number, path)));
    }
    Ok(frames)
}

fn mean(frames: &[FrameReport]) -> Metrics {
    let n = frames.len() as f64;
    let of = |value: fn(&Metrics) -> f64| frames.iter().map(|frame| value(&frame.metrics)).sum::<f64>() / n;
    Metrics {
        mse: of(|m| m.mse),
        relmse: of(|m| m.relmse),
        ssim: of(|m| m.ssim),
        flip: of(|m| m.flip),
        mean_ratio: of(|m| m.mean_ratio),
    }
}

fn print(report: &ClipReport, printer: Printer) {
    let row = |name: String, m: &Metrics, same: bool| {
        let ratio = if same { "equal".to_owned() } else { format!("{:.6}", m.mean_ratio) };
        vec![
            name,
            format!("{:.6e}", m.mse),
            format!("{:.6e}", m.relmse),
            format!("{:.6}", m.ssim),
            format!("{:.6}", m.flip),
            ratio,
        ]
    };
    let mut rows: Vec<Vec<String>> =
        report.frames.iter().map(|f| row(f.frame.to_string(), &f.metrics, f.same_pixels)).collect();
    rows.push(row("mean".to_owned(), &report.mean, false));
    printer.result(human::table(&["frame", "mse", "relmse", "ssim", "flip", "mean_ratio"], &rows));
    if report.unpaired > 0 {
        printer.note(format!(
            "{} without a counterpart in the other folder",
            human::counted_noun(report.unpaired as u64, "frame")
        ));
    }
}
