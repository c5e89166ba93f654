//! `femc compare A.exr B.exr`: measures the error of an image against a reference; compares folders frame by frame.

mod clips;
mod image;

use crate::args::FormatArgs;
use crate::exit::{Exit, Failure, failed};
use crate::output::{Printer, human, json};
use clap::Args;
use femc_film::metrics::{Comparison, ExcludedPixels, WorstPixel};
use image::read;
use serde::Serialize;
use std::path::PathBuf;

/// Error of image A against the reference B: mse, relmse, psnr, ssim, flip, mean_ratio, and the worst pixel
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  \
    femc compare cornell.exr reference.exr\n  \
    femc compare a.exr b.exr --json | jq .relmse\n  \
    femc compare fog/sigma_s=0.01 fog/sigma_s=0.02    # two variants of a sweep, frame by frame\n\n\
    mse: mean (A-B)^2; relmse: mean (A-B)^2/(B^2+0.01); psnr: in dB against B's largest value; ssim: structural \
    similarity of the displayed luminance (1: equal); flip: mean HDR-FLIP (0: equal); mean_ratio: mean A / mean B. \
    Pixels that are not finite in A or B are counted and left out.")]
pub struct CompareArgs {
    /// The image, or a folder of frames
    #[arg(value_name = "A.exr")]
    image: PathBuf,
    /// The reference, or a folder of frames
    #[arg(value_name = "B.exr")]
    reference: PathBuf,
    #[command(flatten)]
    format: FormatArgs,
}

#[derive(Serialize)]
struct CompareReport {
    image: String,
    reference: String,
    width: u32,
    height: u32,
    mse: f64,
    relmse: f64,
    /// Infinite for equal images, which is null in JSON.
    psnr: f64,
    ssim: f64,
    flip: f64,
    mean_ratio: f64,
    worst_pixel: WorstPixel,
    excluded: ExcludedPixels,
    same_pixels: bool,
}

/// Runs `femc compare`.
pub fn run(args: &CompareArgs, printer: Printer) -> Result<Exit, Failure> {
    if args.image.is_dir() && args.reference.is_dir() {
        return clips::run(&args.image, &args.reference, args.format.json, printer);
    }
    let (image, reference) = (read(&args.image)?, read(&args.reference)?);
    let names = format!("{} and {}", args.image.display(), args.reference.display());
    let comparison =
        femc_film::compare_images(&image, &reference).map_err(|e| failed(format!("cannot compare {names}: {e}")))?;
    let Comparison { mse, relmse, psnr, ssim, flip, mean_ratio, worst, excluded } = comparison;
    let report = CompareReport {
        image: args.image.display().to_string(),
        reference: args.reference.display().to_string(),
        width: image.width,
        height: image.height,
        mse,
        relmse,
        psnr,
        ssim,
        flip,
        mean_ratio,
        worst_pixel: worst,
        excluded,
        same_pixels: femc_film::pixel_digest(&image) == femc_film::pixel_digest(&reference),
    };
    if args.format.json {
        json::print(printer, &report)?;
    } else {
        print(printer, &report);
    }
    Ok(Exit::Done)
}

fn print(printer: Printer, report: &CompareReport) {
    let row = |name: &str, value: String| vec![name.to_owned(), value];
    let rows = [
        row("mse", format!("{:.6e}", report.mse)),
        row("relmse", format!("{:.6e}", report.relmse)),
        row("psnr", format!("{:.3} dB", report.psnr)),
        row("ssim", format!("{:.6}", report.ssim)),
        row("flip", format!("{:.6}", report.flip)),
        row("mean_ratio", format!("{:.6}", report.mean_ratio)),
    ];
    printer.result(human::table(&["metric", "value"], &rows));
    let WorstPixel { x, y, value, reference, relative } = report.worst_pixel;
    printer.result(format!("worst pixel {x},{y}: {value:?}, reference {reference:?}, relative error^2 {relative:.4e}"));
    if report.same_pixels {
        printer.result("the pixels are equal bit by bit");
    }
    if report.excluded.pixels > 0 {
        let ExcludedPixels { image, reference, pixels } = report.excluded;
        printer.result(printer.style_warning(&format!(
            "{} left out: not finite ({image} of A, {reference} of B)",
            human::counted_noun(pixels, "pixel")
        )));
    }
}
