//! Image files to linear Rec.709.
//!
//! A file's header says what its values mean (`docs/formats.md` lists the fields): each statement is used, or a remark says
//! that it is not. PNG and JPEG without such statements hold sRGB (\[iec61966\]), EXR holds linear Rec.709. Normal maps are not
//! colors: their values go from [0, 1] to [-1, 1] as they stand. Sizes are checked in the file's header, before any pixel is
//! decoded. What a file decodes to is the same on every machine: JPEG by integers alone, and EXR files whose compression is
//! decoded by whatever the processor has (DWA) are refused.

mod exif;
mod exr;
mod icc;
mod jpeg;
mod png;
mod primaries;
mod transfer;

use crate::Fault;
use femc_scene::Image;
use primaries::Matrix;

/// Most pixels along one side.
const MAX_SIDE: u32 = 32_768;
/// Most memory of all images of a scene, bytes: one of the largest size, and then some.
const MAX_MEMORY: u64 = 16 << 30;
/// A component below this is outside Rec.709, not rounded.
const OUTSIDE: f32 = -1e-4;

/// What an image is for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(crate) enum Role {
    /// Factors on colors.
    Color,
    /// Directions in the tangent frame.
    Normals,
}

/// An image and what was odd about it.
#[derive(Debug)]
pub(crate) struct Decoded {
    pub image: Image,
    /// Statements of the file that are not used, and values that were changed.
    pub remarks: Vec<String>,
}

/// Bytes of a decoded image.
pub(crate) fn memory(width: u32, height: u32) -> u64 {
    u64::from(width) * u64::from(height) * 12
}

/// A file that is being decoded.
struct Source<'b> {
    path: &'b str,
    bytes: &'b [u8],
    role: Role,
    /// Memory that other images take, bytes.
    used: u64,
}

/// The values of a file: of colors linear, in the file's primaries.
struct Opened {
    width: u32,
    height: u32,
    pixels: Vec<[f32; 3]>,
    /// To Rec.709; `None`: they are in Rec.709.
    to_rec709: Option<Matrix>,
    remarks: Vec<String>,
}

impl Source<'_> {
    /// The fault of a file that cannot be used.
    fn bad(&self, reason: impl Into<String>) -> Fault {
        self.advised(reason, "save it again as PNG, JPEG or EXR")
    }

    fn advised(&self, reason: impl Into<String>, advice: &'static str) -> Fault {
        Fault::BadFile { path: self.path.to_owned(), reason: reason.into(), advice }
    }

    /// Fails unless an image of this size fits.
    fn check_size(&self, width: usize, height: usize) -> Result<(u32, u32), Fault> {
        let side = |n: usize| u32::try_from(n).ok().filter(|n| (1..=MAX_SIDE).contains(n));
        let (Some(w), Some(h)) = (side(width), side(height)) else {
            return Err(self.bad(format!("it has {width} x {height} pixels, 1 to {MAX_SIDE} a side are possible")));
        };
        if self.used.saturating_add(memory(w, h)) > MAX_MEMORY {
            return Err(self.bad(format!("it takes the images of the scene above {MAX_MEMORY} bytes")));
        }
        Ok((w, h))
    }
}

/// Decodes a file. `used` is the memory that other images take, bytes.
pub(crate) fn decode(path: &str, bytes: &[u8], role: Role, used: u64) -> Result<Decoded, Fault> {
    let source = Source { path, bytes, role, used };
    let opened = match bytes {
        [0x89, b'P', b'N', b'G', ..] => png::open(&source)?,
        [0xff, 0xd8, ..] => jpeg::open(&source)?,
        [0x76, 0x2f, 0x31, 0x01, ..] => exr::open(&source)?,
        _ => return Err(source.bad("it is none of PNG, JPEG and EXR")),
    };
    let Opened { width, height, mut pixels, to_rec709, mut remarks } = opened;
    if !pixels.iter().flatten().all(|x| x.is_finite()) {
        return Err(source.bad("it has pixels that are not finite"));
    }
    if role == Role::Color {
        let (outside, what) = match to_rec709 {
            Some(_) => (OUTSIDE, "it has colors outside Rec.709: negative components are taken as 0"),
            None => (0.0, "image has negative values: taken as 0"),
        };
        if let Some(matrix) = to_rec709 {
            pixels.iter_mut().for_each(|pixel| *pixel = matrix.apply(*pixel));
        }
        let mut least = 0.0f32;
        for value in pixels.iter_mut().flatten().filter(|x| **x < 0.0) {
            least = least.min(*value);
            *value = 0.0;
        }
        if least < outside {
            remarks.push(what.to_owned());
        }
    } else if bytes[0] == 0x76 {
        pixels.iter_mut().flatten().for_each(|x| *x = 2.0 * *x - 1.0);
    }
    let image = Image { path: path.to_owned(), width, height, pixels };
    Ok(Decoded { image, remarks })
}

/// Red, green and blue of a pixel of 1 to 4 channels; gray ones repeat.
fn spread(channels: usize, at: impl Fn(usize) -> f32) -> [f32; 3] {
    if channels < 3 { [at(0); 3] } else { [at(0), at(1), at(2)] }
}

/// A name out of a file, fit for a message: without control characters, and short.
fn printable(name: &str) -> String {
    name.chars().filter(|c| !c.is_control()).take(64).collect::<String>().trim().to_owned()
}

#[cfg(test)]
mod tests;
