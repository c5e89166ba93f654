//! Outputs made of finished frames: previews, a contact sheet, a clip. All are made from the EXR files. All frames of a run have
//! one exposure, so that a clip does not flicker.

use super::layers;
use super::report::RenderReport;
use crate::args::ExtrasArgs;
use crate::exit::{Failure, failed};
use crate::output::Printer;
use crate::request::ResolvedRequest;
use crate::values::{Exposure, ev};
use femc_film::animation::AnimationFormat;
use femc_film::picture::{NEARLY_SQUARE, sheet_width};
use femc_film::{Image, LuminanceLevels, Picture, contact_sheet, exr, file::write_atomic};
use femc_worker::clip;
use std::path::{Path, PathBuf};

/// Writes the outputs, and adds them to the report.
pub fn write(
    resolved: &ResolvedRequest,
    report: &mut RenderReport,
    extras: &ExtrasArgs,
    exposure: Exposure,
    printer: Printer,
) -> Result<(), Failure> {
    let ExtrasArgs { video, preview, contact_sheet: sheet } = extras;
    if report.files.is_empty() || !(*preview || video.is_some() || sheet.is_some()) {
        return Ok(());
    }
    let curve = exposure.curve(&levels(&report.files)?);
    report.exposure_ev = Some(ev(curve));
    let show = |path: &String| Ok::<_, Failure>(curve.picture(&image(path)?));
    if *preview {
        for path in &report.files {
            let preview = Path::new(path).with_extension("png");
            write_atomic(&preview, &show(path)?.to_png().map_err(failed)?).map_err(failed)?;
            report.previews.push(preview.display().to_string());
            let layers = layers::write_pngs(Path::new(path), &resolved.settings.layers, Some(curve), exposure)?;
            report.previews.extend(layers.iter().map(|path| path.display().to_string()));
        }
    }
    if let Some(path) = sheet {
        let width = sheet_width(report.files.len() as u32);
        let small = |path: &String| Ok(show(path)?.shrunk_to(width));
        let pictures: Vec<Picture> = report.files.iter().map(small).collect::<Result<_, Failure>>()?;
        let sheet = contact_sheet(&pictures, NEARLY_SQUARE).to_png().map_err(failed)?;
        write_atomic(path, &sheet).map_err(failed)?;
        report.contact_sheet = Some(path.display().to_string());
    }
    if let Some(path) = video {
        let path = clip_path(path, printer)?;
        let frames: Vec<u32> = report.frames.iter().map(|frame| frame.frame).collect();
        let (rate, count) = (resolved.rate(&frames), report.files.len() as u32);
        clip::write(&path, report.size, rate, count, report.files.iter().map(show), &|| false)
            .map_err(|error| failed(format!("{}: {error}", path.display())))?;
        report.video = Some(path.display().to_string());
    }
    Ok(())
}

fn image(path: &str) -> Result<Image, Failure> {
    exr::read(Path::new(path)).map(|file| file.image).map_err(failed)
}

/// Returns the luminance levels of all frames together, for one exposure of all frames. The farm's clips use the same rule.
fn levels(files: &[String]) -> Result<LuminanceLevels, Failure> {
    let mut levels = LuminanceLevels::default();
    for path in files {
        levels.merge(&LuminanceLevels::from_image(&image(path)?));
    }
    Ok(levels)
}

/// Creates the folder of the clip and returns the clip's path: the requested one, or an animated PNG if ffmpeg is missing.
fn clip_path(path: &Path, printer: Printer) -> Result<PathBuf, Failure> {
    if let Some(folder) = path.parent().filter(|folder| !folder.as_os_str().is_empty()) {
        std::fs::create_dir_all(folder).map_err(|e| failed(format!("{}: {e}", folder.display())))?;
    }
    if AnimationFormat::from_path(path).is_ok() || clip::ffmpeg_version().is_some() {
        return Ok(path.to_owned());
    }
    let other = path.with_extension("png");
    let (path, shown) = (path.display(), other.display());
    printer.warning(format!("--video {path}: ffmpeg is not on the PATH; writing the animated PNG {shown} instead"));
    Ok(other)
}
