//! Pictures as a clip: animated PNG and GIF by this program, any other format by ffmpeg, which knows it from the file's name.
//!
//! A clip names its encoder. It is exempt from same bytes, for another ffmpeg makes other ones; the pictures in it are not.

use std::ffi::OsStr;
use std::fmt::Display;
use std::io::{Read as _, Write as _};
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::Duration;

use femc_film::animation::AnimationFormat;
use femc_film::file::write_atomic;
use femc_film::{Animation, FilmError, Picture};

/// The tag of workers that have ffmpeg.
pub const FFMPEG: &str = "ffmpeg";

/// Between two looks at whether ffmpeg has ended.
const LOOK: Duration = Duration::from_millis(20);

/// Why there is no clip.
#[derive(Debug, thiserror::Error)]
pub enum ClipError<E> {
    /// A picture cannot be had.
    #[error("{0}")]
    Picture(E),
    /// It cannot be encoded here.
    #[error(transparent)]
    Film(#[from] FilmError),
    /// What ffmpeg said, or why it does not run.
    #[error("ffmpeg: {0}")]
    Ffmpeg(String),
    /// Nobody waits for it any more.
    #[error("cancelled")]
    Cancelled,
}

/// The version of the ffmpeg on the PATH, as it says itself; `None`: there is none that runs.
pub fn ffmpeg() -> Option<String> {
    let ran = Command::new("ffmpeg").arg("-version").stdin(Stdio::null()).stderr(Stdio::null()).output().ok()?;
    let output = String::from_utf8_lossy(&ran.stdout);
    let version = output.split_whitespace().nth(2).unwrap_or("of unknown version").to_owned();
    ran.status.success().then_some(version)
}

/// Writes `pictures`, all of this size, as a clip. The file is there whole or not at all, but for one that ffmpeg writes.
/// - `path`: its extension names the format.
/// - `rate`: frames a second.
/// - `count`: how many pictures there are.
/// - `is_cancelled`: looked at before every picture and while the encoder ends.
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
    let Ok(format) = AnimationFormat::of(path) else {
        return by_ffmpeg(path, [width, height], rate, pictures, is_cancelled);
    };
    let mut bytes = Vec::new();
    let mut animation = Animation::new(&mut bytes, format, (width, height), count, rate)?;
    for picture in pictures {
        animation.add(&picture?)?;
    }
    animation.finish()?;
    Ok(write_atomic(path, &bytes)?)
}

/// Ends with its owner, whatever comes.
struct Encoder(Child);

impl Drop for Encoder {
    fn drop(&mut self) {
        // It has ended by itself, or nobody waits for it.
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// Raw pictures into ffmpeg.
fn by_ffmpeg<E>(
    path: &Path,
    [width, height]: [u32; 2],
    rate: f64,
    pictures: impl Iterator<Item = Result<Picture, ClipError<E>>>,
    is_cancelled: &dyn Fn() -> bool,
) -> Result<(), ClipError<E>> {
    let at = |error: &dyn Display| ClipError::Ffmpeg(error.to_string());
    let version = ffmpeg().ok_or_else(|| at(&"it is not on the PATH"))?;
    let comment = format!("comment=femc {}, ffmpeg {version}", env!("CARGO_PKG_VERSION"));
    let mut encoder = Command::new("ffmpeg")
        .args(["-y", "-loglevel", "error", "-f", "rawvideo", "-pix_fmt", "rgb24"])
        .args(["-s", &format!("{width}x{height}"), "-r", &rate.to_string(), "-i", "-"])
        // The usual chroma needs even sides.
        .args(["-vf", "pad=ceil(iw/2)*2:ceil(ih/2)*2", "-pix_fmt", "yuv420p", "-metadata", &comment])
        .arg::<&OsStr>(path.as_ref())
        .stdin(Stdio::piped())
        .stdout(Stdio::null())
        .stderr(Stdio::piped())
        .spawn()
        .map(Encoder)
        .map_err(|error| at(&error))?;
    let (pipe, errors) = (encoder.0.stdin.take(), encoder.0.stderr.take());
    // It is heard while it is fed, or each would wait for the other.
    let heard = std::thread::spawn(move || {
        let mut text = String::new();
        // What cannot be read says nothing.
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
            None => std::thread::sleep(LOOK),
        }
    };
    // What ffmpeg says of its end tells more than a broken pipe.
    if !status.success() {
        return Err(at(&heard.join().unwrap_or_default().trim()));
    }
    fed.map_err(|error| at(&error))
}
