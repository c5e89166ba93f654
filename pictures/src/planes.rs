//! Encoding of a frame for a page that shows radiances: planes of half floats, one channel after the other.
//!
//! | bytes | content |
//! | --- | --- |
//! | 4 | `FMXC` |
//! | 4 | version, 1 |
//! | 4, 4 | width, height |
//! | 4 | number of channels |
//! | each | length of its name (4), its name |
//! | each | width x height half floats, row by row from the top left |
//!
//! All numbers are little-endian. The channels are:
//! - R, G, B: linear Rec.709.
//! - Y: luminance in cd/m2.
//! - error: half width of the 95 % interval of the mean luminance of the pixel's block of 16 x 16, relative to that mean. -1 where
//!   it is not known.
//! - standard_error: standard error of the pixel's luminance, relative to it. -1 where it is not known. It is stored instead of the
//!   variance, because half floats end at 6e-8.
//! - freedom: degrees of freedom of the standard error. -1 where it is not known.
//! - samples: number of samples.
//!
//! Light statistics have these channels, with -1 where a pixel has no sample:
//! - depth: mean number of intersections of a path.
//! - throughput: mean throughput at the end of a path.
//! - deviation: standard deviation of the luminance of a sample in cd/m2.
//!
//! A statistics file has these channels and, from its own sums, Y, standard_error, freedom and samples.
//!
//! Values beyond the range of half floats become the greatest half float.

use femc_film::{FilmError, FrameImage, Image, PixelChannels, PixelError, exr, pixel_errors};
use femc_paths::pixels::{Pixel, PixelMaps};
use femc_paths::{FrameStatistics, LightStatistics};
use half::f16;
use std::io::Cursor;

const MAGIC: &[u8; 4] = b"FMXC";
const VERSION: u32 = 1;
/// Value that stands for "not known".
const UNKNOWN: f32 = -1.0;
const PIXEL_CHANNELS: [&str; 8] = ["R", "G", "B", "Y", "error", "standard_error", "freedom", "samples"];
const MAP_CHANNELS: [&str; 3] = ["depth", "throughput", "deviation"];
const FILE_CHANNELS: [&str; 7] = ["Y", "standard_error", "freedom", "samples", "depth", "throughput", "deviation"];

/// Encodes a finished frame.
pub fn encode_exr(bytes: &[u8]) -> Result<Vec<u8>, FilmError> {
    let names = ["R", "G", "B", "relative_error.Y", "variance.Y", "samples.Y"];
    let (width, height, [r, g, b, errors, variance, samples]) = exr::decode_channels(Cursor::new(bytes), names)?;
    let pixels: Vec<[f32; 3]> = r.into_iter().zip(g).zip(b).map(|((r, g), b)| [r, g, b]).collect();
    Ok(encode(&Image { width, height, pixels }, &errors, &variance, &samples))
}

/// Encodes an unfinished frame.
pub fn encode_frame(image: &FrameImage) -> Vec<u8> {
    let errors = exr::block_error_plane(&image.error(), image);
    let samples: Vec<f32> = image.samples.iter().map(|&samples| samples as f32).collect();
    encode(&image.color, &errors, &image.luminance_variance, &samples)
}

/// Encodes an image and its errors.
/// - `errors`: relative errors of the pixels' blocks.
/// - `variance`: variances of the pixels' luminance.
fn encode(image: &Image, errors: &[f32], variance: &[f32], samples: &[f32]) -> Vec<u8> {
    let luminance: Vec<f32> = (0..image.pixels.len()).map(|at| image.luminance(at)).collect();
    let width = image.width as usize;
    let own = pixel_errors(PixelChannels { width, luminance: &luminance, variance, samples });
    let mut bytes = start_header([image.width, image.height], &PIXEL_CHANNELS);
    for channel in 0..3 {
        push_plane(&mut bytes, image.pixels.iter().map(|pixel| pixel[channel]));
    }
    push_plane(&mut bytes, luminance.iter().copied());
    push_plane(&mut bytes, errors.iter().copied());
    push_plane(&mut bytes, known(&own, |error| error.standard_error as f32));
    push_plane(&mut bytes, known(&own, |error| f32::from(error.freedom)));
    push_plane(&mut bytes, samples.iter().copied());
    bytes
}

const DAMAGED: FilmError = FilmError::Corrupt("the light statistics are damaged");

/// Encodes the light statistics of a frame.
pub fn encode_statistics(bytes: &[u8]) -> Result<Vec<u8>, FilmError> {
    let statistics = LightStatistics::decode(bytes).map_err(|_| DAMAGED)?;
    let maps = PixelMaps::from_statistics(&statistics);
    let pixels: Vec<Pixel> = maps.pixels().collect();
    let mut bytes = start_header(maps.film, &MAP_CHANNELS);
    push_maps(&mut bytes, &pixels);
    Ok(bytes)
}

/// Decodes the sums of the pixels of a statistics file. The first of several frames is decoded.
pub fn decode_file(bytes: &[u8]) -> Result<PixelMaps, FilmError> {
    let statistics = if FrameStatistics::has_magic(bytes) {
        let frames = FrameStatistics::decode(bytes).map_err(|_| DAMAGED)?;
        frames.into_frames().into_iter().next().ok_or(FilmError::Corrupt("the file has no frames"))?
    } else {
        LightStatistics::decode(bytes).map_err(|_| DAMAGED)?
    };
    Ok(PixelMaps::from_statistics(&statistics))
}

/// Encodes the pixels of a statistics file. The first of several frames is encoded.
pub fn encode_file(bytes: &[u8]) -> Result<Vec<u8>, FilmError> {
    let maps = decode_file(bytes)?;
    let pixels: Vec<Pixel> = maps.pixels().collect();
    let plane = |value: fn(&Pixel) -> f64| -> Vec<f32> { pixels.iter().map(|pixel| value(pixel) as f32).collect() };
    let (luminance, samples) = (plane(|pixel| pixel.luminance), plane(|pixel| pixel.samples as f64));
    let variance = plane(|pixel| if pixel.samples > 0 { pixel.variance / pixel.samples as f64 } else { 0.0 });
    let width = maps.film[0] as usize;
    let errors = pixel_errors(PixelChannels { width, luminance: &luminance, variance: &variance, samples: &samples });
    let mut bytes = start_header(maps.film, &FILE_CHANNELS);
    push_plane(&mut bytes, luminance.iter().copied());
    push_plane(&mut bytes, known(&errors, |error| error.standard_error as f32));
    push_plane(&mut bytes, known(&errors, |error| f32::from(error.freedom)));
    push_plane(&mut bytes, samples.iter().copied());
    push_maps(&mut bytes, &pixels);
    Ok(bytes)
}

/// Appends the planes of [`MAP_CHANNELS`].
fn push_maps(bytes: &mut Vec<u8>, pixels: &[Pixel]) {
    let of: [fn(&Pixel) -> f64; 3] = [|it| it.depth, |it| it.throughput, |it| it.variance.sqrt()];
    for of in of {
        let value = |pixel: &Pixel| if pixel.samples > 0 { of(pixel) as f32 } else { UNKNOWN };
        push_plane(bytes, pixels.iter().map(value));
    }
}

/// Returns a value of each error, or [`UNKNOWN`].
fn known(errors: &[Option<PixelError>], value: fn(PixelError) -> f32) -> impl Iterator<Item = f32> + '_ {
    errors.iter().map(move |error| error.map_or(UNKNOWN, value))
}

/// Returns the header, with capacity for all planes after it.
fn start_header([width, height]: [u32; 2], names: &[&str]) -> Vec<u8> {
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

fn push_plane(bytes: &mut Vec<u8>, values: impl Iterator<Item = f32>) {
    let most = f16::MAX.to_f32();
    bytes.extend(values.flat_map(|value| f16::from_f32(value.clamp(-most, most)).to_le_bytes()));
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeMap;

    fn number(bytes: &[u8], at: usize) -> u32 {
        u32::from_le_bytes(bytes[at..at + 4].try_into().unwrap())
    }

    #[test]
    fn planes_follow_their_names_and_huge_values_stay_finite() {
        let image = Image { width: 2, height: 1, pixels: vec![[1.0, 2.0, 4.0], [1e9, 0.0, 0.0]] };
        let bytes = encode(&image, &[-1.0, 0.5], &[0.0, 0.0], &[16.0, 8.0]);
        let head = [4, 8, 12, 16].map(|at| number(&bytes, at));
        assert_eq!((&bytes[..4], head), (&b"FMXC"[..], [1, 2, 1, 8]));
        let head = 20 + PIXEL_CHANNELS.iter().map(|name| 4 + name.len()).sum::<usize>();
        let planes: Vec<f32> =
            bytes[head..].chunks(2).map(|half| f16::from_le_bytes(half.try_into().unwrap()).to_f32()).collect();
        assert_eq!(planes.len(), 16);
        assert_eq!(planes[..6], [1.0, 65504.0, 2.0, 0.0, 4.0, 0.0]);
        assert!((planes[6] - image.luminance(0)).abs() < 1e-2 && planes[7] == 65504.0);
        assert_eq!(planes[8..], [-1.0, 0.5, 0.0, 0.0, 2.0, 2.0, 16.0, 8.0]);
    }

    #[test]
    fn standard_error_survives_half_floats_unlike_its_variance() {
        let image = Image { width: 1, height: 1, pixels: vec![[1e-4; 3]] };
        let bytes = encode(&image, &[0.5], &[1e-12], &[4.0]);
        let halves: Vec<f32> = bytes[bytes.len() - 16..]
            .chunks(2)
            .map(|half| f16::from_le_bytes(half.try_into().unwrap()).to_f32())
            .collect();
        assert!((halves[5] / 0.01 - 1.0).abs() < 1e-3, "{halves:?}");
        assert_eq!(f16::from_f32(1e-12).to_f32(), 0.0);
    }

    /// Decodes planes by name, as a page does.
    fn read(bytes: &[u8]) -> BTreeMap<String, Vec<f32>> {
        let [width, height, channels] = [8, 12, 16].map(|at| number(bytes, at) as usize);
        let mut at = 20;
        let mut names = Vec::new();
        for _ in 0..channels {
            let length = number(bytes, at) as usize;
            names.push(String::from_utf8(bytes[at + 4..at + 4 + length].to_vec()).unwrap());
            at += 4 + length;
        }
        assert_eq!(bytes.len(), at + 2 * width * height * channels);
        let planes = bytes[at..].chunks(2 * width * height);
        let float = |half: &[u8]| f16::from_le_bytes(half.try_into().unwrap()).to_f32();
        names.into_iter().zip(planes.map(|plane| plane.chunks(2).map(float).collect())).collect()
    }

    /// Makes a frame of 40 x 20 pixels: all pixels differ, tiles have different numbers of samples, a tile has none, some pixels
    /// are black.
    fn frame() -> FrameImage {
        let mut image = FrameImage::black(40, 20);
        for at in 0..800 {
            let (x, y) = (at % 40, at / 40);
            let word = (at as u32).wrapping_mul(2_654_435_761) >> 8;
            let light = if x > 35 || word.is_multiple_of(11) { 0.0 } else { (word % 1000) as f32 * 0.01 + 0.001 };
            image.color.pixels[at] = [light, 0.5 * light, 2.0 * light];
            image.samples[at] = if y < 4 {
                0
            } else if x < 16 {
                64
            } else {
                8
            };
            image.luminance_variance[at] = light * (word % 97) as f32 * 1e-4;
            if image.samples[at] == 0 {
                (image.color.pixels[at], image.luminance_variance[at]) = ([0.0; 3], 0.0);
            }
        }
        image
    }

    #[test]
    fn every_number_of_the_pixels_is_that_of_the_file() {
        let image = frame();
        let provenance = femc_film::Provenance { error: image.error(), ..Default::default() };
        let file = exr::encode(&image, &provenance).unwrap();
        let sent = encode_exr(&file).unwrap();
        assert_eq!(sent, encode_frame(&image), "a frame in work has the same numbers");
        let planes = read(&sent);
        assert_eq!(
            planes.keys().collect::<Vec<_>>(),
            ["B", "G", "R", "Y", "error", "freedom", "samples", "standard_error"]
        );
        let channels = exr::Channels::decode(Cursor::new(&file)).unwrap();
        let of_file = |name: &str, at: usize| f64::from(channels.get(name).unwrap()[at]);
        let luminance =
            |at: usize| 0.212_639 * of_file("R", at) + 0.715_168_7 * of_file("G", at) + 0.072_192_32 * of_file("B", at);
        let is_lit = |at: usize| luminance(at) > 0.0 && of_file("samples.Y", at) >= 2.0;
        let mut unlit = 0;
        for (x, y) in (0..20).flat_map(|y| (0..40).map(move |x| (x, y))) {
            // Independent implementation of the pool over the neighbors.
            let at = (y * 40 + x) as usize;
            let (mut sum, mut pool) = (0.0, 0.0);
            for (dx, dy) in (-1..=1).flat_map(|dy| (-1..=1).map(move |dx| (dx, dy))) {
                let there = (0..40).contains(&(x + dx)) && (0..20).contains(&(y + dy));
                let near = ((y + dy) * 40 + x + dx) as usize;
                if there && is_lit(near) {
                    sum += of_file("variance.Y", near) * of_file("samples.Y", near) / luminance(near);
                    pool += 1.0;
                }
            }
            let standard_error = (sum / pool * luminance(at) / of_file("samples.Y", at)).sqrt() / luminance(at);
            let own = |value: f64| if is_lit(at) { value } else { -1.0 };
            unlit += usize::from(!is_lit(at));
            for (name, due) in [
                ("R", of_file("R", at)),
                ("G", of_file("G", at)),
                ("B", of_file("B", at)),
                ("Y", luminance(at)),
                ("error", of_file("relative_error.Y", at)),
                ("standard_error", own(standard_error)),
                ("freedom", own(pool)),
                ("samples", of_file("samples.Y", at)),
            ] {
                let due = due.min(65504.0);
                let is = f64::from(planes[name][at]);
                // Tolerance: half a unit in the last place of a half float, plus single-precision rounding.
                assert!((is - due).abs() <= due.abs() * 5e-4 + 1e-7, "{name} at {x}, {y}: {is}, not {due}");
            }
        }
        assert!((200..600).contains(&unlit), "{unlit}");
    }
}
