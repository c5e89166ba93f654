//! Animated images, for machines without a video encoder: animated PNG (24-bit color, plays in browsers) and GIF (256 colors per
//! frame, plays everywhere). Frames are encoded as they arrive, so a clip needs the memory of only one frame.

use crate::{FilmError, Picture};
use std::io::Write;
use std::path::Path;

/// Name of the encoder in the file.
const SOFTWARE: &str = concat!("femc ", env!("CARGO_PKG_VERSION"));

/// Kind of an animated image.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum AnimationFormat {
    /// Animated PNG: lossless.
    Apng,
    /// GIF: 256 colors per frame, chosen by a neural quantizer.
    Gif,
}

impl AnimationFormat {
    /// Returns the format of the extension of `path`: png, apng or gif, in any case.
    pub fn from_path(path: &Path) -> Result<Self, FilmError> {
        match path.extension().and_then(|e| e.to_str()).map(str::to_ascii_lowercase).as_deref() {
            Some("png" | "apng") => Ok(Self::Apng),
            Some("gif") => Ok(Self::Gif),
            _ => Err(FilmError::AnimationFormat(path.into())),
        }
    }
}

/// An encoder of an animated image; the image loops endlessly.
pub struct Animation<W: Write> {
    size: (u32, u32),
    rate: f64,
    added: u32,
    encoder: Encoder<W>,
}

enum Encoder<W: Write> {
    Apng(Box<png::Writer<W>>),
    Gif(Box<gif::Encoder<W>>),
}

impl<W: Write> Animation<W> {
    /// Starts an image of exactly `frames` frames of one size at `rate` frames per second (0.01 to 100).
    pub fn new(
        out: W,
        format: AnimationFormat,
        (width, height): (u32, u32),
        frames: u32,
        rate: f64,
    ) -> Result<Self, FilmError> {
        let rate = if rate.is_finite() { rate.clamp(0.01, 100.0) } else { 24.0 };
        let encoder = match format {
            AnimationFormat::Apng => Encoder::Apng(Box::new(apng(out, width, height, frames, rate).map_err(failed)?)),
            AnimationFormat::Gif => {
                let (Ok(w), Ok(h)) = (u16::try_from(width), u16::try_from(height)) else {
                    return Err(FilmError::Size { width: width.into(), height: height.into(), limit: 65535 * 65535 });
                };
                let mut encoder = gif::Encoder::new(out, w, h, &[]).map_err(failed)?;
                encoder.set_repeat(gif::Repeat::Infinite).map_err(failed)?;
                let comment = gif::AnyExtension(gif::Extension::Comment as u8);
                encoder.write_raw_extension(comment, &[SOFTWARE.as_bytes()]).map_err(failed)?;
                Encoder::Gif(Box::new(encoder))
            }
        };
        Ok(Self { size: (width, height), rate, added: 0, encoder })
    }

    /// Adds the next frame.
    pub fn add(&mut self, picture: &Picture) -> Result<(), FilmError> {
        if (picture.width, picture.height) != self.size {
            return Err(FilmError::SizesDiffer {
                a_width: picture.width,
                a_height: picture.height,
                b_width: self.size.0,
                b_height: self.size.1,
            });
        }
        match &mut self.encoder {
            Encoder::Apng(writer) => writer.write_image_data(picture.pixels.as_flattened()).map_err(failed)?,
            Encoder::Gif(encoder) => {
                /// Trade-off between quality and time, 1 (best) to 30.
                const SPEED: i32 = 10;
                let (w, h) = (self.size.0 as u16, self.size.1 as u16);
                let mut frame = gif::Frame::from_rgb_speed(w, h, picture.pixels.as_flattened(), SPEED);
                // Hundredths of a second, from rounded times, so that the clip keeps its length.
                let time = |n: u32| (100.0 * f64::from(n) / self.rate).round() as u32;
                frame.delay = u16::try_from(time(self.added + 1) - time(self.added)).unwrap_or(u16::MAX);
                encoder.write_frame(&frame).map_err(failed)?;
            }
        }
        self.added += 1;
        Ok(())
    }

    /// Finishes the image. For animated PNG, fewer frames than announced are an error.
    pub fn finish(self) -> Result<(), FilmError> {
        match self.encoder {
            Encoder::Apng(writer) => writer.finish().map_err(failed),
            Encoder::Gif(encoder) => encoder.into_inner().map_err(failed)?.flush().map_err(failed),
        }
    }
}

fn apng<W: Write>(
    out: W,
    width: u32,
    height: u32,
    frames: u32,
    rate: f64,
) -> Result<png::Writer<W>, png::EncodingError> {
    let mut encoder = png::Encoder::new(out, width, height);
    encoder.set_color(png::ColorType::Rgb);
    encoder.set_depth(png::BitDepth::Eight);
    encoder.set_source_srgb(png::SrgbRenderingIntent::Perceptual);
    encoder.add_text_chunk("Software".into(), SOFTWARE.into())?;
    encoder.set_animated(frames.max(1), 0)?;
    // Seconds as a fraction of 16-bit numbers.
    let (numerator, denominator) = if rate >= 1.0 { (500, 500.0 * rate) } else { ((500.0 / rate) as u16, 500.0) };
    encoder.set_frame_delay(numerator, denominator.round() as u16)?;
    encoder.validate_sequence(true);
    encoder.write_header()
}

fn failed(cause: impl std::fmt::Display) -> FilmError {
    FilmError::Format { what: "writing animated image", cause: cause.to_string() }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn frames() -> Vec<Picture> {
        let shade = |k: u32| (0..64 * 32).map(|i| [(i % 64) as u8, (8 * k) as u8, 90]).collect();
        (0..5).map(|k| Picture { width: 64, height: 32, pixels: shade(k) }).collect()
    }

    fn encode(format: AnimationFormat, rate: f64) -> Vec<u8> {
        let mut bytes = Vec::new();
        let mut animation = Animation::new(&mut bytes, format, (64, 32), 5, rate).unwrap();
        frames().iter().for_each(|f| animation.add(f).unwrap());
        animation.finish().unwrap();
        bytes
    }

    #[test]
    fn an_animated_png_holds_every_frame_without_loss() {
        let bytes = encode(AnimationFormat::Apng, 24.0);
        assert_eq!(bytes, encode(AnimationFormat::Apng, 24.0));
        let mut reader = png::Decoder::new(std::io::Cursor::new(bytes)).read_info().unwrap();
        assert_eq!(reader.info().uncompressed_latin1_text[0].text, SOFTWARE);
        let control = *reader.info().animation_control().unwrap();
        assert_eq!((control.num_frames, control.num_plays), (5, 0));
        for frame in frames() {
            let mut out = vec![0; reader.output_buffer_size().unwrap()];
            reader.next_frame(&mut out).unwrap();
            assert_eq!(out, frame.pixels.as_flattened());
            let control = reader.info().frame_control().unwrap();
            assert_eq!(f64::from(control.delay_den) / f64::from(control.delay_num), 24.0);
        }
    }

    #[test]
    fn gif_approximates_every_frame_and_keeps_the_clip_length() {
        let bytes = encode(AnimationFormat::Gif, 24.0);
        assert_eq!(bytes, encode(AnimationFormat::Gif, 24.0));
        assert!(bytes.windows(SOFTWARE.len()).any(|window| window == SOFTWARE.as_bytes()), "it names its encoder");
        let mut options = gif::DecodeOptions::new();
        options.set_color_output(gif::ColorOutput::RGBA);
        let mut decoder = options.read_info(&bytes[..]).unwrap();
        let (mut count, mut hundredths) = (0, 0);
        while let Some(frame) = decoder.read_next_frame().unwrap() {
            hundredths += u32::from(frame.delay);
            let original = &frames()[count].pixels;
            let off =
                frame.buffer.chunks(4).zip(original).flat_map(|(a, b)| (0..3).map(move |i| a[i].abs_diff(b[i]))).max();
            assert!(off.unwrap() <= 24, "frame {count} is off by {off:?}");
            count += 1;
        }
        assert_eq!((count, hundredths), (5, 21));
    }

    #[test]
    fn frames_of_another_size_or_too_few_are_errors() {
        let mut bytes = Vec::new();
        let mut animation = Animation::new(&mut bytes, AnimationFormat::Apng, (64, 32), 5, 24.0).unwrap();
        let small = Picture { width: 1, height: 1, pixels: vec![[0; 3]] };
        assert!(matches!(animation.add(&small), Err(FilmError::SizesDiffer { .. })));
        animation.add(&frames()[0]).unwrap();
        assert!(animation.finish().is_err());
        assert!(Animation::new(Vec::new(), AnimationFormat::Gif, (70_000, 1), 1, 24.0).is_err());
    }

    #[test]
    fn the_extension_names_the_format() {
        assert_eq!(AnimationFormat::from_path(Path::new("a/Clip.GIF")).unwrap(), AnimationFormat::Gif);
        assert_eq!(AnimationFormat::from_path(Path::new("clip.apng")).unwrap(), AnimationFormat::Apng);
        assert!(matches!(AnimationFormat::from_path(Path::new("clip.mp4")), Err(FilmError::AnimationFormat(_))));
    }
}
