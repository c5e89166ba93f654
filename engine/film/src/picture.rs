//! 8-bit pictures: PNG files and contact sheets.

use crate::rect::MAX_FILM_PIXELS;
use crate::{FilmError, Image};

/// sRGB picture of 8 bits per channel, row by row from the top left.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Picture {
    /// Number of columns.
    pub width: u32,
    /// Number of rows.
    pub height: u32,
    /// `width * height` pixels.
    pub pixels: Vec<[u8; 3]>,
}

impl Picture {
    /// Encodes the picture as a PNG file; equal pictures give equal bytes.
    pub fn to_png(&self) -> Result<Vec<u8>, FilmError> {
        let mut bytes = Vec::new();
        let mut encoder = png::Encoder::new(&mut bytes, self.width, self.height);
        encoder.set_color(png::ColorType::Rgb);
        encoder.set_depth(png::BitDepth::Eight);
        encoder.set_source_srgb(png::SrgbRenderingIntent::Perceptual);
        encoder
            .write_header()
            .and_then(|mut writer| writer.write_image_data(self.pixels.as_flattened()))
            .map_err(|e| FilmError::Format { what: "writing PNG", cause: e.to_string() })?;
        Ok(bytes)
    }

    /// Decodes a PNG file as written by [`Picture::to_png`]; any other file is an error.
    pub fn from_png(bytes: &[u8]) -> Result<Self, FilmError> {
        let damaged = |e: png::DecodingError| FilmError::Format { what: "reading PNG", cause: e.to_string() };
        let mut reader = png::Decoder::new(std::io::Cursor::new(bytes)).read_info().map_err(damaged)?;
        let (width, height) = reader.info().size();
        if reader.output_color_type() != (png::ColorType::Rgb, png::BitDepth::Eight) {
            return Err(FilmError::Corrupt("the PNG file has an unexpected color type"));
        }
        if !(1..=MAX_FILM_PIXELS).contains(&(u64::from(width) * u64::from(height))) {
            return Err(FilmError::Size { width: width.into(), height: height.into(), limit: MAX_FILM_PIXELS });
        }
        let mut out = vec![0; 3 * width as usize * height as usize];
        reader.next_frame(&mut out).and_then(|_| reader.finish()).map_err(damaged)?;
        let pixels = out.as_chunks().0.to_vec();
        Ok(Self { width, height, pixels })
    }

    /// Decodes any PNG file, as painting programs write them: gray or colors, palettes, 1 to 16 bits per channel (the upper 8 of 16
    /// are kept). Transparent pixels show white paper.
    pub fn from_any_png(bytes: &[u8]) -> Result<Self, FilmError> {
        Self::from_any_png_counting_transparent(bytes).map(|(picture, _)| picture)
    }

    /// Decodes like [`Self::from_any_png`], and also returns the number of pixels through which the paper shows.
    pub fn from_any_png_counting_transparent(bytes: &[u8]) -> Result<(Self, usize), FilmError> {
        let damaged = |e: png::DecodingError| FilmError::Format { what: "reading PNG", cause: e.to_string() };
        let mut decoder = png::Decoder::new(std::io::Cursor::new(bytes));
        decoder.set_transformations(png::Transformations::normalize_to_color8());
        let mut reader = decoder.read_info().map_err(damaged)?;
        let (width, height) = reader.info().size();
        if !(1..=MAX_FILM_PIXELS).contains(&(u64::from(width) * u64::from(height))) {
            return Err(FilmError::Size { width: width.into(), height: height.into(), limit: MAX_FILM_PIXELS });
        }
        let channels = reader.output_color_type().0.samples();
        let mut out = vec![0; channels * width as usize * height as usize];
        reader.next_frame(&mut out).and_then(|_| reader.finish()).map_err(damaged)?;
        let over_paper = |value: u8, alpha: u8| {
            let (value, alpha) = (u32::from(value), u32::from(alpha));
            ((value * alpha + 255 * (255 - alpha) + 127) / 255) as u8
        };
        let pixel = |pixel: &[u8]| match *pixel {
            [gray] => [gray; 3],
            [gray, alpha] => [over_paper(gray, alpha); 3],
            [red, green, blue] => [red, green, blue],
            [red, green, blue, alpha] => [red, green, blue].map(|value| over_paper(value, alpha)),
            _ => [0; 3],
        };
        let is_clear = |pixel: &&[u8]| matches!(pixel, [_, alpha] | [_, _, _, alpha] if *alpha < u8::MAX);
        let clear = out.chunks_exact(channels).filter(is_clear).count();
        let pixels = out.chunks_exact(channels).map(pixel).collect();
        Ok((Self { width, height, pixels }, clear))
    }

    /// Creates a placeholder for a missing picture: gray with a cross.
    pub fn placeholder(width: u32, height: u32) -> Self {
        const CARD: [u8; 3] = [112; 3];
        const CROSS: [u8; 3] = [48; 3];
        let (w, h) = (i64::from(width), i64::from(height));
        // The lines are a 16th of the shorter side wide, measured along the longer one.
        let broad = (w.min(h) / 16).max(1) * w.max(h);
        let is_cross = |x: i64, y: i64| {
            let [falling, rising] = [x, w - 1 - x].map(|x| (2 * x + 1) * h - (2 * y + 1) * w);
            falling.abs().min(rising.abs()) <= broad
        };
        let pixel = move |x, y| if is_cross(x, y) { CROSS } else { CARD };
        let pixels = (0..h).flat_map(|y| (0..w).map(move |x| (x, y))).map(|(x, y)| pixel(x, y)).collect();
        Self { width, height, pixels }
    }

    /// Shrinks the picture by the smallest whole factor that makes it at most `width` wide. Each pixel is the mean of a block (a
    /// smaller block at the right and lower border).
    pub fn shrunk_to(&self, width: u32) -> Self {
        let pixels = self.pixels.iter().map(|pixel| pixel.map(f32::from)).collect();
        let small = Image { width: self.width, height: self.height, pixels }.shrunk_to(width);
        let pixels = small.pixels.iter().map(|pixel| pixel.map(|value| (value + 0.5) as u8)).collect();
        Self { width: small.width, height: small.height, pixels }
    }
}

impl Image {
    /// Shrinks the image by the smallest whole factor that makes it at most `width` wide. Each pixel is the mean of a block of
    /// linear pixels (a smaller block at the right and lower border).
    pub fn shrunk_to(&self, width: u32) -> Self {
        self.shrunk_by(self.width.div_ceil(width.max(1)).max(1))
    }

    /// Shrinks the image by a whole factor of at least 1. Each pixel is the mean of a block.
    pub(crate) fn shrunk_by(&self, factor: u32) -> Self {
        let (columns, rows) = (self.width.div_ceil(factor), self.height.div_ceil(factor));
        let block = |x: u32, y: u32| {
            let (mut sum, mut count) = ([0.0f32; 3], 0.0f32);
            for row in (y * factor)..((y + 1) * factor).min(self.height) {
                for column in (x * factor)..((x + 1) * factor).min(self.width) {
                    let pixel = self.pixels[row as usize * self.width as usize + column as usize];
                    (0..3).for_each(|i| sum[i] += pixel[i]);
                    count += 1.0;
                }
            }
            sum.map(|s| s / count)
        };
        let pixels = (0..rows).flat_map(|y| (0..columns).map(move |x| block(x, y))).collect();
        Self { width: columns, height: rows, pixels }
    }
}

/// Value for the columns of a contact sheet that stands for as many columns as rows, or one more.
pub const NEARLY_SQUARE: u32 = 0;
/// Returns the width of each of `count` frames' pictures on a contact sheet, pixels. It is 320, or less for several hundred frames,
/// so that the sheet of any clip has at most about 2^25 square pixels.
pub fn sheet_width(count: u32) -> u32 {
    const MAX_SHEET_PIXELS: u32 = 1 << 25;
    (MAX_SHEET_PIXELS / count.max(1)).isqrt().clamp(16, 320)
}

/// Pixels between and around the pictures of a contact sheet.
const GAP: u32 = 4;
/// Background color of the sheet.
const PAPER: [u8; 3] = [24, 24, 24];

/// Lays out `pictures` in rows of `columns` ([`NEARLY_SQUARE`]: as many columns as rows), each in a cell of the largest size, with
/// small gaps. Without pictures, the sheet is empty and one gap in size.
pub fn contact_sheet(pictures: &[Picture], columns: u32) -> Picture {
    let count = pictures.len() as u32;
    let columns = if columns == 0 { (1..=count).find(|c| c * c >= count).unwrap_or(0) } else { columns.min(count) };
    let rows = if columns == 0 { 0 } else { count.div_ceil(columns) };
    let cell_width = pictures.iter().map(|p| p.width).max().unwrap_or(0) + GAP;
    let cell_height = pictures.iter().map(|p| p.height).max().unwrap_or(0) + GAP;
    let (width, height) = (GAP + columns * cell_width, GAP + rows * cell_height);
    let mut sheet = Picture { width, height, pixels: vec![PAPER; width as usize * height as usize] };
    for (i, picture) in (0..count).zip(pictures) {
        let (left, top) = (GAP + i % columns * cell_width, GAP + i / columns * cell_height);
        for (y, row) in (0..picture.height).zip(picture.pixels.chunks(picture.width as usize)) {
            let start = (top + y) as usize * width as usize + left as usize;
            sheet.pixels[start..start + row.len()].copy_from_slice(row);
        }
    }
    sheet
}

#[cfg(test)]
mod tests {
    use super::*;

    fn plain(width: u32, height: u32, value: u8) -> Picture {
        Picture { width, height, pixels: vec![[value; 3]; (width * height) as usize] }
    }

    #[test]
    fn a_sheet_of_many_frames_has_small_pictures() {
        assert_eq!([0, 1, 300, 10_000, 65_536].map(sheet_width), [320, 320, 320, 57, 22]);
    }

    #[test]
    fn a_png_decodes_to_the_same_pixels() {
        let mut picture = plain(7, 3, 9);
        picture.pixels[8] = [1, 2, 250];
        let bytes = picture.to_png().unwrap();
        assert_eq!(bytes, picture.to_png().unwrap());
        let mut reader = png::Decoder::new(std::io::Cursor::new(bytes)).read_info().unwrap();
        let mut out = vec![0; reader.output_buffer_size().unwrap()];
        let info = reader.next_frame(&mut out).unwrap();
        assert_eq!((info.width, info.height, info.color_type), (7, 3, png::ColorType::Rgb));
        assert_eq!(out[..info.buffer_size()], *picture.pixels.as_flattened());
    }

    #[test]
    fn a_picture_comes_back_from_its_png_and_no_other_file_is_one() {
        let mut picture = plain(7, 3, 9);
        picture.pixels[8] = [1, 2, 250];
        let bytes = picture.to_png().unwrap();
        assert_eq!(Picture::from_png(&bytes).unwrap(), picture);
        assert!((0..bytes.len()).all(|end| Picture::from_png(&bytes[..end]).is_err()));
        let mut gray = Vec::new();
        let mut encoder = png::Encoder::new(&mut gray, 1, 1);
        encoder.set_color(png::ColorType::Grayscale);
        encoder.write_header().unwrap().write_image_data(&[7]).unwrap();
        assert!(matches!(Picture::from_png(&gray), Err(FilmError::Corrupt(_))));
    }

    #[test]
    fn any_png_becomes_colors_and_transparency_shows_white_paper() {
        let file = |color: png::ColorType, depth: png::BitDepth, data: &[u8]| {
            let mut bytes = Vec::new();
            let mut encoder = png::Encoder::new(&mut bytes, 2, 1);
            encoder.set_color(color);
            encoder.set_depth(depth);
            encoder.write_header().unwrap().write_image_data(data).unwrap();
            bytes
        };
        let eight = png::BitDepth::Eight;
        for (bytes, expected) in [
            (file(png::ColorType::Grayscale, eight, &[7, 200]), [[7; 3], [200; 3]]),
            (file(png::ColorType::GrayscaleAlpha, eight, &[0, 255, 0, 0]), [[0; 3], [255; 3]]),
            (file(png::ColorType::Rgb, eight, &[1, 2, 3, 4, 5, 6]), [[1, 2, 3], [4, 5, 6]]),
            (file(png::ColorType::Rgba, eight, &[1, 2, 3, 255, 100, 0, 0, 51]), [[1, 2, 3], [224, 204, 204]]),
            (file(png::ColorType::Grayscale, png::BitDepth::Sixteen, &[9, 77, 10, 88]), [[9; 3], [10; 3]]),
            (file(png::ColorType::Grayscale, png::BitDepth::One, &[0b0100_0000]), [[0; 3], [255; 3]]),
        ] {
            assert_eq!(Picture::from_any_png(&bytes).unwrap().pixels, expected);
            let clear = Picture::from_any_png_counting_transparent(&bytes).unwrap().1;
            let white = expected.iter().filter(|pixel| **pixel == [255; 3] || **pixel == [224, 204, 204]).count();
            assert_eq!(clear, if bytes[25] & 4 == 0 { 0 } else { white }, "color type {}", bytes[25]);
            assert!((0..bytes.len()).all(|end| Picture::from_any_png(&bytes[..end]).is_err()));
        }
    }

    #[test]
    fn missing_picture_is_a_card_with_a_cross_between_its_corners() {
        for (width, height) in [(64, 64), (160, 90), (9, 40), (1, 1)] {
            let card = Picture::placeholder(width, height);
            let at = |x: u32, y: u32| card.pixels[(y * width + x) as usize];
            let cross = at(0, 0);
            let corners = [at(width - 1, 0), at(0, height - 1), at(width - 1, height - 1), at(width / 2, height / 2)];
            assert_eq!(corners, [cross; 4], "{width} x {height}");
            let crossed = card.pixels.iter().filter(|&&pixel| pixel == cross).count() as f64 / card.pixels.len() as f64;
            assert!(width < 9 || (0.05..0.5).contains(&crossed), "{width} x {height}: {crossed}");
        }
    }

    #[test]
    fn a_shrunk_picture_has_the_means_of_blocks() {
        let picture = Picture { width: 4, height: 2, pixels: (0..8).map(|i| [10 * i, 255, 0]).collect() };
        assert_eq!(picture.shrunk_to(2).pixels, [[25, 255, 0], [45, 255, 0]]);
        assert_eq!(picture.shrunk_to(4), picture);
    }

    #[test]
    fn a_sheet_holds_every_picture_in_its_cell() {
        let pictures: Vec<Picture> = (0..5).map(|i| plain(4 + i, 3, 100 + i as u8)).collect();
        let sheet = contact_sheet(&pictures, 0);
        assert_eq!((sheet.width, sheet.height), (GAP + 3 * (8 + GAP), GAP + 2 * (3 + GAP)));
        for (i, p) in pictures.iter().enumerate() {
            let found = sheet.pixels.iter().filter(|&&pixel| pixel == p.pixels[0]).count();
            assert_eq!(found, p.pixels.len(), "picture {i}");
        }
        assert_eq!(sheet.pixels[(GAP * sheet.width + GAP) as usize], [100; 3]);
        assert_eq!(sheet.pixels[0], PAPER);
        assert_eq!(contact_sheet(&pictures, 1).width, GAP + 8 + GAP);
        assert_eq!(contact_sheet(&[], 0).pixels.len(), (GAP * GAP) as usize);
    }

    #[test]
    fn shrinking_keeps_the_mean_and_the_borders() {
        let image = Image { width: 4, height: 2, pixels: (0..8).map(|i| [i as f32, 1.0, 0.0]).collect() };
        let half = image.shrunk_to(2);
        assert_eq!((half.width, half.height), (2, 1));
        assert_eq!(half.pixels, [[2.5, 1.0, 0.0], [4.5, 1.0, 0.0]]);
        assert_eq!(image.shrunk_to(4), image);
        assert_eq!(image.shrunk_to(3).width, 2);
        assert_eq!(image.shrunk_to(1).pixels, [[3.5, 1.0, 0.0]]);
    }
}
