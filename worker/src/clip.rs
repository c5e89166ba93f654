//! Encodes pictures as a clip. This program writes animated PNG and GIF itself. ffmpeg writes any other format, chosen by the file
//! extension.
//!
//! A clip names its encoder. Clips are exempt from the rule that equal jobs give equal bytes, because another ffmpeg version writes
//! other bytes. The pictures in a clip are not exempt.

use std::ffi::OsStr;
use std::fmt::Display;
use std::io::{Read as _, Write as _};
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::Duration;

use femc_film::animation::AnimationFormat;
use femc_film::file::write_atomic;
use femc_film::{Animation, FilmError, Picture};

/// Tag of workers that have ffmpeg.
pub const FFMPEG: &str = "ffmpeg";

/// Interval between checks whether ffmpeg has exited.
const POLL_INTERVAL: Duration = Duration::from_millis(20);

/// Error of writing a clip.
#[derive(Debug, thiserror::Error)]
pub enum ClipError<E> {
    /// A picture is not available.
    #[error("{0}")]
    Picture(E),
    /// The built-in encoder failed.
    #[error(transparent)]
    Film(#[from] FilmError),
    /// ffmpeg failed or does not run: its error output, or the reason.
    #[error("ffmpeg: {0}")]
    Ffmpeg(String),
    /// The caller cancelled the clip.
    #[error("cancelled")]
    Cancelled,
}

/// Returns the version that the ffmpeg on the PATH reports; `None` if there is no ffmpeg that runs.
pub fn ffmpeg_version() -> Option<String> {
    let ran = Command::new("ffmpeg").arg("-version").stdin(Stdio::null()).stderr(Stdio::null()).output().ok()?;
    let output = String::from_utf8_lossy(&ran.stdout);
    let version = output.split_whitespace().nth(2).unwrap_or("of unknown version").to_owned();
    ran.status.success().then_some(version)
}

/// Writes `pictures` as a clip. All pictures must have the given size. The file is written atomically, except for a file that
/// ffmpeg writes.
/// - `path`: output file; its extension selects the format.
/// - `rate`: frames per second.
/// - `count`: number of pictures.
/// - `is_cancelled`: checked before every picture and while the encoder finishes.
pub fn write<E>(
    path: &Path,
    [width, height]: [u32; 2],
    rate: f64,
    count: u32,
    pictures: impl IntoIterator<Item = Result<Picture, E>>,
    is_cancelled: &dyn Fn() -> bool,
) -> Result<(), ClipError<E>> {
    let pictures = pictures.into_iter().map(|picture| match picture {
        _ if is_cancelled() => Err(ClipError::Cancelled),
        Ok(picture) if [picture.width, picture.height] == [width, height] => Ok(picture),
        Ok(Picture { width: w, height: h, .. }) => {
            Err(FilmError::SizesDiffer { a_width: w, a_height: h, b_width: width, b_height: height }.into())
        }
        Err(error) => Err(ClipError::Picture(error)),
    });
    let Ok(format) = AnimationFormat::from_path(path) else {
        return write_with_ffmpeg(path, [width, height], rate, pictures, is_cancelled);
    };
    let mut bytes = Vec::new();
    let mut animation = Animation::new(&mut bytes, format, (width, height), count, rate)?;
    for picture in pictures {
        animation.add(&picture?)?;
    }
    animation.finish()?;
    Ok(write_atomic(path, &bytes)?)
}

/// An ffmpeg process that is killed when its owner drops it.
struct Encoder(Child);

impl Drop for Encoder {
    fn drop(&mut self) {
        // The process has already exited, or its result is no longer needed.
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// Pipes the raw pictures into ffmpeg.
fn write_with_ffmpeg<E>(
    path: &Path,
    [width, height]: [u32; 2],
    rate: f64,
    pictures: impl Iterator<Item = Result<Picture, ClipError<E>>>,
    is_cancelled: &dyn Fn() -> bool,
) -> Result<(), ClipError<E>> {
    let at = |error: &dyn Display| ClipError::Ffmpeg(error.to_string());
    let version = ffmpeg_version().ok_or_else(|| at(&"not found on the PATH"))?;
    let comment = format!("comment=femc {}, ffmpeg {version}", env!("CARGO_PKG_VERSION"));
    let mut encoder = Command::new("ffmpeg")
        .args(["-y", "-loglevel", "error", "-f", "rawvideo", "-pix_fmt", "rgb24"])
        .args(["-s", &format!("{width}x{height}"), "-r", &rate.to_string(), "-i", "-"])
        // The usual chroma subsampling needs even width and height.
        .args(["-vf", "pad=ceil(iw/2)*2:ceil(ih/2)*2", "-pix_fmt", "yuv420p", "-metadata", &comment])
        .arg::<&OsStr>(path.as_ref())
        .stdin(Stdio::piped())
        .stdout(Stdio::null())
        .stderr(Stdio::piped())
        .spawn()
        .map(Encoder)
        .map_err(|error| at(&error))?;
    let (pipe, errors) = (encoder.0.stdin.take(), encoder.0.stderr.take());
    // Read the errors while the pictures are written; otherwise the two processes could block each other.
    let error_reader = std::thread::spawn(move || {
        let mut text = String::new();
        // Error output that cannot be read counts as empty.
        let _ = errors.map(|mut errors| errors.read_to_string(&mut text));
        text
    });
    let mut fed = Ok(());
    if let Some(mut pipe) = pipe {
        for picture in pictures {
            fed = pipe.write_all(picture?.pixels.as_flattened());
            if fed.is_err() {
                break;
            }
        }
    }
    let status = loop {
        match encoder.0.try_wait().map_err(|error| at(&error))? {
            Some(status) => break status,
            None if is_cancelled() => return Err(ClipError::Cancelled),
            None => std::thread::sleep(POLL_INTERVAL),
        }
    };
    // The error output of ffmpeg says more than a broken pipe.
    if !status.success() {
        return Err(at(&error_reader.join().unwrap_or_default().trim()));
    }
    fed.map_err(|error| at(&error))
}
