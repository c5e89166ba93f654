//! A frame for a page that shows radiances: planes of half floats, one channel after the other.
//!
//! | bytes | what |
//! | --- | --- |
//! | 4 | `FMXC` |
//! | 4 | version, 1 |
//! | 4, 4 | width, height |
//! | 4 | number of channels |
//! | each | length of its name (4), its name |
//! | each | width x height half floats, row by row from the top left |
//!
//! All little-endian. Channels: R, G, B (linear Rec.709), Y (cd/m2), error (relative standard error of the pixel's block, -1 where nothing
//! is known), samples. Of light statistics: depth (intersections of a path, mean), throughput (at its end, mean), deviation (standard
//! deviation of the luminance of a sample, cd/m2); -1 where a pixel has no sample. What is beyond the range of half floats is their greatest value.

use femc_film::{FilmError, FrameImage, exr};
use femc_paths::Statistics;
use femc_paths::pixels::{Maps, Pixel};
use half::f16;
use std::io::Cursor;

const MAGIC: &[u8; 4] = b"FMXC";
const VERSION: u32 = 1;
const NAMES: [&str; 6] = ["R", "G", "B", "Y", "error", "samples"];
const MAPS: [&str; 3] = ["depth", "throughput", "deviation"];

/// Of a finished frame.
pub fn of_exr(bytes: &[u8]) -> Result<Vec<u8>, FilmError> {
    let names = ["R", "G", "B", "relative_error.Y", "samples.Y"];
    let (width, height, [r, g, b, errors, samples]) = exr::decode_channels(Cursor::new(bytes), names)?;
    let pixels: Vec<[f32; 3]> = r.into_iter().zip(g).zip(b).map(|((r, g), b)| [r, g, b]).collect();
    Ok(encode(&femc_film::Image { width, height, pixels }, &errors, samples.into_iter()))
}

/// Of a frame in work.
pub fn of_frame(image: &FrameImage) -> Vec<u8> {
    let errors = exr::errors(&image.error(), image);
    encode(&image.color, &errors, image.samples.iter().map(|&samples| samples as f32))
}

fn encode(image: &femc_film::Image, errors: &[f32], samples: impl Iterator<Item = f32>) -> Vec<u8> {
    let count = image.pixels.len();
    let mut bytes = head([image.width, image.height], &NAMES);
    for channel in 0..3 {
        put(&mut bytes, image.pixels.iter().map(|pixel| pixel[channel]));
    }
    put(&mut bytes, (0..count).map(|at| image.luminance(at)));
    put(&mut bytes, errors.iter().copied());
    put(&mut bytes, samples);
    bytes
}

/// Of a frame's light statistics.
pub fn of_statistics(bytes: &[u8]) -> Result<Vec<u8>, FilmError> {
    let statistics = Statistics::decode(bytes).map_err(|_| FilmError::Corrupt("the light statistics are damaged"))?;
    let maps = Maps::of(&statistics);
    let pixels: Vec<Pixel> = maps.pixels().collect();
    let mut bytes = head(maps.film, &MAPS);
    let of: [fn(&Pixel) -> f64; 3] = [|it| it.depth, |it| it.throughput, |it| it.variance.sqrt()];
    for of in of {
        let value = |pixel: &Pixel| if pixel.samples > 0 { of(pixel) as f32 } else { -1.0 };
        put(&mut bytes, pixels.iter().map(value));
    }
    Ok(bytes)
}

/// What stands before the planes; there is room behind it for all of them.
fn head([width, height]: [u32; 2], names: &[&str]) -> Vec<u8> {
    let mut bytes = Vec::with_capacity(128 + 2 * names.len() * width as usize * height as usize);
    bytes.extend(MAGIC);
    for number in [VERSION, width, height, names.len() as u32] {
        bytes.extend(number.to_le_bytes());
    }
    for name in names {
        bytes.extend((name.len() as u32).to_le_bytes());
        bytes.extend(name.bytes());
    }
    bytes
}

fn put(bytes: &mut Vec<u8>, values: impl Iterator<Item = f32>) {
    let most = f16::MAX.to_f32();
    bytes.extend(values.flat_map(|value| f16::from_f32(value.clamp(-most, most)).to_le_bytes()));
}

#[cfg(test)]
mod tests {
    use super::*;
    use femc_film::Image;

    #[test]
    fn planes_follow_their_names_and_huge_values_stay_finite() {
        let image = Image { width: 2, height: 1, pixels: vec![[1.0, 2.0, 4.0], [1e9, 0.0, 0.0]] };
        let bytes = encode(&image, &[-1.0, 0.5], [16.0, 8.0].into_iter());
        let number = |at: usize| u32::from_le_bytes(bytes[at..at + 4].try_into().unwrap());
        assert_eq!((&bytes[..4], number(4), number(8), number(12), number(16)), (&b"FMXC"[..], 1, 2, 1, 6));
        let head = 20 + NAMES.iter().map(|name| 4 + name.len()).sum::<usize>();
        let planes: Vec<f32> =
            bytes[head..].chunks(2).map(|half| f16::from_le_bytes(half.try_into().unwrap()).to_f32()).collect();
        assert_eq!(planes.len(), 12);
        assert_eq!(planes[..6], [1.0, 65504.0, 2.0, 0.0, 4.0, 0.0]);
        assert!((planes[6] - image.luminance(0)).abs() < 1e-2 && planes[7] == 65504.0);
        assert_eq!(planes[8..], [-1.0, 0.5, 16.0, 8.0]);
    }
}
