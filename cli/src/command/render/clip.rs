//! What is made of finished frames: previews, a contact sheet, a clip. All read the EXR files, and all frames of a run
//! are shown with one exposure, so that a clip does not flicker.

use super::report::Report;
use crate::exit::{Failure, failed};
use crate::output::Say;
use crate::request::Asked;
use femc_film::animation::AnimationFormat;
use femc_film::{Animation, Image, Picture, ToneCurve, contact_sheet, exr, file::write_atomic};
use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

/// Frames that set the exposure: enough to know a clip by, few enough to hold.
const EXPOSED: usize = 8;
/// Width of a picture on a contact sheet, pixels.
const THUMBNAIL: u32 = 320;
/// Columns of a sheet: as the film's library sees fit.
const NEARLY_SQUARE: u32 = 0;
/// Frames a second of a clip that does not say.
const DEFAULT_RATE: f64 = 24.0;

/// What to make.
pub struct Extras {
    preview: bool,
    video: Option<PathBuf>,
    sheet: Option<PathBuf>,
}

impl Extras {
    /// As asked for.
    pub fn new(args: &super::RenderArgs) -> Self {
        Self { preview: args.preview, video: args.video.clone(), sheet: args.contact_sheet.clone() }
    }

    fn any(&self) -> bool {
        self.preview || self.video.is_some() || self.sheet.is_some()
    }
}

/// Make it, and enter it in the report.
pub fn write(asked: &Asked, report: &mut Report, extras: &Extras, say: Say) -> Result<(), Failure> {
    if !extras.any() || report.files.is_empty() {
        return Ok(());
    }
    let curve = exposure(&report.files)?;
    let show = |path: &String| Ok(curve.picture(&image(path)?));
    if extras.preview {
        for path in &report.files {
            let preview = Path::new(path).with_extension("png");
            write_atomic(&preview, &show(path)?.to_png().map_err(failed)?).map_err(failed)?;
            report.previews.push(preview.display().to_string());
        }
    }
    if let Some(path) = &extras.sheet {
        let small = |path: &String| Ok(curve.picture(&image(path)?.shrunk_to(THUMBNAIL)));
        let pictures: Vec<Picture> = report.files.iter().map(small).collect::<Result<_, Failure>>()?;
        let sheet = contact_sheet(&pictures, NEARLY_SQUARE).to_png().map_err(failed)?;
        write_atomic(path, &sheet).map_err(failed)?;
        report.contact_sheet = Some(path.display().to_string());
    }
    if let Some(path) = &extras.video {
        let path = video(path, report.size, rate(asked, report), &report.files, &show, say)?;
        report.video = Some(path.display().to_string());
    }
    Ok(())
}

fn image(path: &str) -> Result<Image, Failure> {
    exr::read(Path::new(path)).map(|file| file.image).map_err(failed)
}

/// One tone curve for all, from frames spread over the clip.
fn exposure(files: &[String]) -> Result<ToneCurve, Failure> {
    let step = files.len().div_ceil(EXPOSED);
    let images: Vec<Image> = files.iter().step_by(step).map(|path| image(path)).collect::<Result<_, Failure>>()?;
    Ok(ToneCurve::auto(&images))
}

/// Frames a second: a clip of every third frame plays at a third of the rate, in real time.
fn rate(asked: &Asked, report: &Report) -> f64 {
    let fps = asked.scene().clip.map_or(DEFAULT_RATE, |clip| clip.fps);
    let step = match report.frames.as_slice() {
        [first, second, ..] => f64::from(second.frame - first.frame),
        _ => 1.0,
    };
    (fps / step).clamp(0.01, 100.0)
}

/// Write the clip; the path may become another one where there is no ffmpeg.
fn video(
    path: &Path,
    size: [u32; 2],
    rate: f64,
    files: &[String],
    show: &dyn Fn(&String) -> Result<Picture, Failure>,
    say: Say,
) -> Result<PathBuf, Failure> {
    if let Some(folder) = path.parent().filter(|folder| !folder.as_os_str().is_empty()) {
        std::fs::create_dir_all(folder).map_err(|e| failed(format!("{}: {e}", folder.display())))?;
    }
    let animated = match AnimationFormat::of(path) {
        Ok(format) => Some((format, path.to_owned())),
        Err(_) if ffmpeg_is_there() => None,
        Err(_) => {
            let other = path.with_extension("png");
            say.warning(format!(
                "--video {}: ffmpeg is not on the PATH; writing the animated PNG {} instead",
                path.display(),
                other.display()
            ));
            Some((AnimationFormat::Apng, other))
        }
    };
    match animated {
        Some((format, path)) => {
            animate(&path, format, size, rate, files, show)?;
            Ok(path)
        }
        None => {
            encode(path, size, rate, files, show)?;
            Ok(path.to_owned())
        }
    }
}

fn ffmpeg_is_there() -> bool {
    let quiet = |command: &mut Command| {
        command.arg("-version").stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::null()).status()
    };
    quiet(&mut Command::new("ffmpeg")).is_ok_and(|status| status.success())
}

fn animate(
    path: &Path,
    format: AnimationFormat,
    [width, height]: [u32; 2],
    rate: f64,
    files: &[String],
    show: &dyn Fn(&String) -> Result<Picture, Failure>,
) -> Result<(), Failure> {
    let at = |e: &dyn std::fmt::Display| failed(format!("{}: {e}", path.display()));
    let mut bytes = Vec::new();
    let mut animation =
        Animation::new(&mut bytes, format, (width, height), files.len() as u32, rate).map_err(|e| at(&e))?;
    for file in files {
        animation.add(&show(file)?).map_err(|e| at(&e))?;
    }
    animation.finish().map_err(|e| at(&e))?;
    write_atomic(path, &bytes).map_err(failed)
}

/// Raw pictures into ffmpeg, which knows the format from the name.
fn encode(
    path: &Path,
    [width, height]: [u32; 2],
    rate: f64,
    files: &[String],
    show: &dyn Fn(&String) -> Result<Picture, Failure>,
) -> Result<(), Failure> {
    let at = |e: &dyn std::fmt::Display| failed(format!("{}: ffmpeg: {e}", path.display()));
    let mut ffmpeg = Command::new("ffmpeg")
        .args(["-y", "-loglevel", "error", "-f", "rawvideo", "-pix_fmt", "rgb24"])
        .args(["-s", &format!("{width}x{height}"), "-r", &rate.to_string(), "-i", "-"])
        // The usual chroma needs even sides.
        .args(["-vf", "pad=ceil(iw/2)*2:ceil(ih/2)*2", "-pix_fmt", "yuv420p"])
        .arg(path)
        .stdin(Stdio::piped())
        .stdout(Stdio::null())
        .stderr(Stdio::piped())
        .spawn()
        .map_err(|e| at(&e))?;
    let mut fed = Ok(());
    if let Some(mut pipe) = ffmpeg.stdin.take() {
        for file in files {
            let picture = show(file)?;
            fed = pipe.write_all(picture.pixels.as_flattened());
            if fed.is_err() {
                break;
            }
        }
    }
    // What ffmpeg says of its end tells more than a broken pipe.
    let output = ffmpeg.wait_with_output().map_err(|e| at(&e))?;
    if !output.status.success() {
        return Err(at(&String::from_utf8_lossy(&output.stderr).trim()));
    }
    fed.map_err(|e| at(&e))
}
