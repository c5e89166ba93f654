//! Decoding of image files to linear Rec.709.
//!
//! A file's header defines the meaning of its values (`docs/formats.md` lists the fields). Each header field is either used, or a
//! remark says that it is not. Without such fields, PNG and JPEG are sRGB (\[iec61966\]), and EXR is linear Rec.709. Normal maps
//! are not colors: their values are mapped from [0, 1] to [-1, 1] without a transfer function. Sizes are checked in the header
//! before any pixel is decoded. Decoding gives the same result on every machine: JPEG uses only integers, and EXR files with DWA
//! compression are rejected, because its decoder depends on the processor's features.

mod exif;
mod exr;
mod icc;
mod jpeg;
mod png;
mod primaries;
mod transfer;

use crate::ImportFault;
use femc_scene::Image;
use primaries::Matrix;

/// Maximum number of pixels along one side.
const MAX_SIDE: u32 = 32_768;
/// Maximum memory of all images of a scene, bytes: somewhat more than one image of the largest size.
const MAX_MEMORY: u64 = 16 << 30;
/// Component value below which a color is outside Rec.709; smaller negative values come from rounding.
const OUTSIDE: f32 = -1e-4;

/// Use of an image.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(crate) enum Role {
    /// Factors on colors.
    Color,
    /// Directions in the tangent frame.
    Normals,
}

/// A decoded image and its remarks.
#[derive(Debug)]
pub(crate) struct DecodedImage {
    pub image: Image,
    /// Header fields that are not used, and values that were changed.
    pub remarks: Vec<String>,
}

/// Returns the memory of a decoded image, bytes.
pub(crate) fn memory_size(width: u32, height: u32) -> u64 {
    u64::from(width) * u64::from(height) * 12
}

/// A file while it is decoded.
struct ImageFile<'b> {
    path: &'b str,
    bytes: &'b [u8],
    role: Role,
    /// Memory used by other images, bytes.
    used: u64,
}

/// Values of a file. Colors are linear, in the file's primaries.
struct RawImage {
    width: u32,
    height: u32,
    pixels: Vec<[f32; 3]>,
    /// Matrix to Rec.709; `None` if the values are already in Rec.709.
    to_rec709: Option<Matrix>,
    remarks: Vec<String>,
}

impl ImageFile<'_> {
    /// Returns the fault of a file that cannot be used.
    fn bad_file(&self, reason: impl Into<String>) -> ImportFault {
        self.bad_file_with_advice(reason, "save it again as PNG, JPEG or EXR")
    }

    fn bad_file_with_advice(&self, reason: impl Into<String>, advice: &'static str) -> ImportFault {
        ImportFault::BadFile { path: self.path.to_owned(), reason: reason.into(), advice }
    }

    /// Checks that an image of this size fits the limits.
    fn check_size(&self, width: usize, height: usize) -> Result<(u32, u32), ImportFault> {
        let side = |n: usize| u32::try_from(n).ok().filter(|n| (1..=MAX_SIDE).contains(n));
        let (Some(w), Some(h)) = (side(width), side(height)) else {
            return Err(
                self.bad_file(format!("the image has {width} x {height} pixels; each side must have 1 to {MAX_SIDE}"))
            );
        };
        if self.used.saturating_add(memory_size(w, h)) > MAX_MEMORY {
            return Err(
                self.bad_file(format!("with this image, the images of the scene take more than {MAX_MEMORY} bytes"))
            );
        }
        Ok((w, h))
    }
}

/// Decodes a file. `used` is the memory used by other images, bytes.
pub(crate) fn decode(path: &str, bytes: &[u8], role: Role, used: u64) -> Result<DecodedImage, ImportFault> {
    let file = ImageFile { path, bytes, role, used };
    let raw = match bytes {
        [0x89, b'P', b'N', b'G', ..] => png::open(&file)?,
        [0xff, 0xd8, ..] => jpeg::open(&file)?,
        [0x76, 0x2f, 0x31, 0x01, ..] => exr::open(&file)?,
        _ => return Err(file.bad_file("the file is not a PNG, JPEG or EXR image")),
    };
    let RawImage { width, height, mut pixels, to_rec709, mut remarks } = raw;
    if !pixels.iter().flatten().all(|x| x.is_finite()) {
        return Err(file.bad_file("the image has pixels that are not finite"));
    }
    if role == Role::Color {
        let (outside, what) = match to_rec709 {
            Some(_) => (OUTSIDE, "image has colors outside Rec.709: negative components are treated as 0"),
            None => (0.0, "image has negative values: treated as 0"),
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
    Ok(DecodedImage { image, remarks })
}

/// Returns red, green and blue of a pixel with 1 to 4 channels; gray is repeated.
fn rgb_of_channels(channels: usize, at: impl Fn(usize) -> f32) -> [f32; 3] {
    if channels < 3 { [at(0); 3] } else { [at(0), at(1), at(2)] }
}

/// Makes a name from a file printable: removes control characters and shortens it.
fn printable(name: &str) -> String {
    name.chars().filter(|c| !c.is_control()).take(64).collect::<String>().trim().to_owned()
}

#[cfg(test)]
mod tests;
