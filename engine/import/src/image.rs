//! Image files to linear Rec.709.
//!
//! PNG and JPEG hold sRGB (\[iec61966\]) and are made linear through a table; EXR is linear already. Normal maps are not
//! colours: their values go from [0, 1] to [-1, 1] as they stand. Sizes are checked in the file's header, before any pixel
//! is decoded. Alpha is not used. What a file decodes to is the same on every machine: JPEG by integers alone, and EXR files
//! whose compression is decoded by whatever the processor has (DWA) are refused.

use crate::Fault;
use exr::{compression::Compression, meta::MetaData, prelude as exr_prelude};
use exr_prelude::{ReadChannels, ReadLayers};
use femc_math::elementary::double as elementary;
use femc_scene::Image;
use std::io::Cursor;
use zune_jpeg::JpegDecoder;
use zune_jpeg::zune_core::bytestream::ZCursor;
use zune_jpeg::zune_core::colorspace::ColorSpace;
use zune_jpeg::zune_core::options::DecoderOptions;

/// Most pixels along one side.
const MAX_SIDE: u32 = 32_768;
/// Most memory of all images of a scene, bytes: one of the largest size, and then some.
const MAX_MEMORY: u64 = 16 << 30;

/// What an image is for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(crate) enum Role {
    /// Factors on colours.
    Color,
    /// Directions in the tangent frame.
    Normals,
}

/// An image and what was odd about it.
#[derive(Debug)]
pub(crate) struct Decoded {
    pub image: Image,
    /// Whether negative colours were taken as 0.
    pub negative: bool,
}

/// Bytes of a decoded image.
pub(crate) fn memory(width: u32, height: u32) -> u64 {
    u64::from(width) * u64::from(height) * 12
}

/// Decodes a file. `used` is the memory that other images take, bytes.
pub(crate) fn decode(path: &str, bytes: &[u8], role: Role, used: u64) -> Result<Decoded, Fault> {
    let bad =
        |reason: String| Fault::BadFile { path: path.to_owned(), reason, advice: "save it again as PNG, JPEG or EXR" };
    let check = |width: usize, height: usize| {
        let side = |n: usize| u32::try_from(n).ok().filter(|n| (1..=MAX_SIDE).contains(n));
        let (Some(w), Some(h)) = (side(width), side(height)) else {
            return Err(bad(format!("it has {width} x {height} pixels, 1 to {MAX_SIDE} a side are possible")));
        };
        if used.saturating_add(memory(w, h)) > MAX_MEMORY {
            return Err(bad(format!("it takes the images of the scene above {MAX_MEMORY} bytes")));
        }
        Ok((w, h))
    };
    let (width, height, mut pixels) = match bytes {
        [0x89, b'P', b'N', b'G', ..] => open_png(bytes, role, &bad, &check)?,
        [0xff, 0xd8, ..] => open_jpeg(bytes, role, &bad, &check)?,
        [0x76, 0x2f, 0x31, 0x01, ..] => open_exr(bytes, &bad, &check)?,
        _ => return Err(bad("it is none of PNG, JPEG and EXR".into())),
    };
    if !pixels.iter().flatten().all(|x| x.is_finite()) {
        return Err(bad("it has pixels that are not finite".into()));
    }
    let mut negative = false;
    if let Role::Color = role {
        for value in pixels.iter_mut().flatten().filter(|x| **x < 0.0) {
            negative = true;
            *value = 0.0;
        }
    } else if bytes[0] == 0x76 {
        pixels.iter_mut().flatten().for_each(|x| *x = 2.0 * *x - 1.0);
    }
    Ok(Decoded { image: Image { path: path.to_owned(), width, height, pixels }, negative })
}

type Pixels = (u32, u32, Vec<[f32; 3]>);
type Check<'a> = dyn Fn(usize, usize) -> Result<(u32, u32), Fault> + 'a;

fn open_png(bytes: &[u8], role: Role, bad: &dyn Fn(String) -> Fault, check: &Check<'_>) -> Result<Pixels, Fault> {
    let fault = |error: png::DecodingError| bad(error.to_string());
    let mut decoder = png::Decoder::new(Cursor::new(bytes));
    // Palettes and fewer than 8 bits become whole bytes; 16 bits stay.
    decoder.set_transformations(png::Transformations::EXPAND);
    let mut reader = decoder.read_info().map_err(fault)?;
    let (width, height) = check(reader.info().width as usize, reader.info().height as usize)?;
    let (color, depth) = reader.output_color_type();
    let size = reader.output_buffer_size().ok_or_else(|| bad("it is too large for this machine".into()))?;
    let mut values = vec![0; size];
    reader.next_frame(&mut values).map_err(fault)?;
    let channels = color.samples();
    let pixels = if depth == png::BitDepth::Sixteen {
        let table: Vec<f32> = (0..=u16::MAX).map(|x| value(f64::from(x) / 65_535.0, role)).collect();
        let at = |pixel: &[u8], i: usize| table[usize::from(u16::from_be_bytes([pixel[2 * i], pixel[2 * i + 1]]))];
        values.chunks_exact(2 * channels).map(|pixel| spread(channels, |i| at(pixel, i))).collect()
    } else {
        let table = byte_table(role);
        values.chunks_exact(channels).map(|pixel| spread(channels, |i| table[usize::from(pixel[i])])).collect()
    };
    Ok((width, height, pixels))
}

/// Red, green and blue of a pixel of 1 to 4 channels; grey ones repeat.
fn spread(channels: usize, at: impl Fn(usize) -> f32) -> [f32; 3] {
    if channels < 3 { [at(0); 3] } else { [at(0), at(1), at(2)] }
}

fn open_jpeg(bytes: &[u8], role: Role, bad: &dyn Fn(String) -> Fault, check: &Check<'_>) -> Result<Pixels, Fault> {
    let most = usize::from(u16::MAX);
    let options =
        DecoderOptions::default().set_max_width(most).set_max_height(most).jpeg_set_out_colorspace(ColorSpace::RGB);
    let mut decoder = JpegDecoder::new_with_options(ZCursor::new(bytes), options);
    decoder.decode_headers().map_err(|error| bad(error.to_string()))?;
    let (width, height) = decoder.dimensions().ok_or_else(|| bad("its header has no size".into()))?;
    let (width, height) = check(width, height)?;
    let values = decoder.decode().map_err(|error| bad(error.to_string()))?;
    let table = byte_table(role);
    let pixels = values.chunks_exact(3).map(|p| [0, 1, 2].map(|i| table[usize::from(p[i])])).collect();
    Ok((width, height, pixels))
}

fn byte_table(role: Role) -> Vec<f32> {
    (0..=u8::MAX).map(|x| value(f64::from(x) / 255.0, role)).collect()
}

/// A value of the file in [0, 1] in its role.
fn value(x: f64, role: Role) -> f32 {
    match role {
        Role::Normals => (2.0 * x - 1.0) as f32,
        Role::Color if x <= 0.04045 => (x / 12.92) as f32,
        Role::Color => elementary::pow((x + 0.055) / 1.055, 2.4) as f32,
    }
}

fn open_exr(bytes: &[u8], bad: &dyn Fn(String) -> Fault, check: &Check<'_>) -> Result<Pixels, Fault> {
    let meta = MetaData::read_from_buffered(Cursor::new(bytes), false).map_err(|error| bad(error.to_string()))?;
    for header in &meta.headers {
        check(header.layer_size.width(), header.layer_size.height())?;
        if matches!(header.compression, Compression::DWAA(_) | Compression::DWAB(_)) {
            return Err(bad("it is compressed with DWA, which other processors decode to other values".into()));
        }
    }
    let read = exr_prelude::read()
        .no_deep_data()
        .largest_resolution_level()
        .rgba_channels(
            |size: exr_prelude::Vec2<usize>, _: &exr_prelude::RgbaChannels| {
                (size.width(), vec![[0.0f32; 3]; size.area()])
            },
            |(width, pixels), at, (r, g, b, _): (f32, f32, f32, f32)| pixels[at.y() * *width + at.x()] = [r, g, b],
        )
        .first_valid_layer()
        .all_attributes()
        .non_parallel()
        .from_buffered(Cursor::new(bytes))
        .map_err(|error| bad(error.to_string()))?;
    let size = read.layer_data.size;
    let (width, height) = check(size.width(), size.height())?;
    Ok((width, height, read.layer_data.channel_data.pixels.1))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn png_of((width, height): (u32, u32), color: png::ColorType, depth: png::BitDepth, values: &[u8]) -> Vec<u8> {
        let mut bytes = Vec::new();
        let mut encoder = png::Encoder::new(&mut bytes, width, height);
        encoder.set_color(color);
        encoder.set_depth(depth);
        if color == png::ColorType::Indexed {
            encoder.set_palette(vec![0, 188, 255, 255, 0, 188]);
        }
        encoder.write_header().and_then(|mut writer| writer.write_image_data(values)).unwrap();
        bytes
    }

    fn exr_bytes(pixel: (f32, f32, f32)) -> Vec<u8> {
        exr_with(Compression::Uncompressed, pixel)
    }

    fn exr_with(compression: Compression, pixel: (f32, f32, f32)) -> Vec<u8> {
        use exr_prelude::WritableImage;
        let mut bytes = Cursor::new(Vec::new());
        let encoding = exr_prelude::Encoding { compression, ..exr_prelude::Encoding::UNCOMPRESSED };
        let channels = exr_prelude::SpecificChannels::rgb(|_| pixel);
        let layer = exr_prelude::Layer::new((3, 2), exr_prelude::LayerAttributes::default(), encoding, channels);
        let image = exr_prelude::Image::from_layer(layer);
        image.write().non_parallel().to_buffered(&mut bytes).unwrap();
        bytes.into_inner()
    }

    #[test]
    fn srgb_becomes_linear_at_every_depth_with_and_without_alpha_and_palette() {
        use png::{BitDepth, ColorType};
        let sixteen: Vec<u8> = [0u16, 188 * 257, 65_535].iter().flat_map(|x| x.to_be_bytes()).collect();
        for (color, depth, pixel) in [
            (ColorType::Rgb, BitDepth::Eight, &[0, 188, 255][..]),
            (ColorType::Rgba, BitDepth::Eight, &[0, 188, 255, 9]),
            (ColorType::Rgb, BitDepth::Sixteen, &sixteen),
            (ColorType::Indexed, BitDepth::Eight, &[0]),
        ] {
            let bytes = png_of((2, 1), color, depth, &pixel.repeat(2));
            let Decoded { image, negative } = decode("t.png", &bytes, Role::Color, 0).unwrap();
            assert_eq!((image.width, image.height, image.pixels.len(), negative), (2, 1, 2, false));
            let [r, g, b] = image.pixels[1];
            assert!(r == 0.0 && b == 1.0 && (g - 0.5029).abs() < 1e-4, "{color:?}: {:?}", image.pixels[1]);
        }
        // Grey: with alpha, and of one bit, where a row's last byte has bits to spare.
        let grey = png_of((1, 1), ColorType::GrayscaleAlpha, BitDepth::Eight, &[255, 0]);
        assert_eq!(decode("g.png", &grey, Role::Color, 0).unwrap().image.pixels, [[1.0; 3]]);
        let bits = png_of((3, 2), ColorType::Grayscale, BitDepth::One, &[0b0100_0000, 0b1010_0000]);
        let bits = decode("g.png", &bits, Role::Color, 0).unwrap().image.pixels;
        assert_eq!(bits, [0.0, 1.0, 0.0, 1.0, 0.0, 1.0].map(|x| [x; 3]));
    }

    #[test]
    fn jpeg_is_read_in_color_and_in_grey() {
        // 8 x 8 pixels of (255, 128, 0), and 5 x 3 of grey 188.
        let color = decode("t.jpg", include_bytes!("../tests/files/orange.jpg"), Role::Color, 0).unwrap().image;
        assert_eq!((color.width, color.height, color.pixels.len()), (8, 8, 64));
        let near = |pixel: &[f32; 3], wanted: [f32; 3]| (0..3).all(|i| (pixel[i] - wanted[i]).abs() < 0.03);
        assert!(color.pixels.iter().all(|p| near(p, [1.0, 0.2159, 0.0])), "{:?}", color.pixels[0]);
        let grey = decode("t.jpg", include_bytes!("../tests/files/grey.jpg"), Role::Color, 0).unwrap().image;
        assert_eq!((grey.width, grey.height, grey.pixels.len()), (5, 3, 15));
        assert!(grey.pixels.iter().all(|p| near(p, [0.5029; 3])), "{:?}", grey.pixels[0]);
    }

    #[test]
    fn exr_stays_as_it_is() {
        let decoded = decode("t.exr", &exr_bytes((0.25, 1.5, 3.0)), Role::Color, 0).unwrap();
        assert_eq!((decoded.image.width, decoded.image.height), (3, 2));
        assert!(decoded.image.pixels.iter().all(|p| *p == [0.25, 1.5, 3.0]));
    }

    #[test]
    fn an_exr_that_the_processor_decodes_in_its_own_way_is_refused() {
        for compression in [Compression::DWAA(None), Compression::DWAB(None)] {
            let fault = decode("t.exr", &exr_with(compression, (0.25, 1.5, 3.0)), Role::Color, 0).unwrap_err();
            assert!(fault.to_string().contains("DWA"), "{fault}");
        }
        let piz = decode("t.exr", &exr_with(Compression::PIZ, (0.25, 1.5, 3.0)), Role::Color, 0).unwrap();
        assert_eq!(piz.image.pixels, [[0.25, 1.5, 3.0]; 6]);
    }

    #[test]
    fn normal_maps_are_mapped_to_directions_and_not_through_srgb() {
        let map = png_of((1, 1), png::ColorType::Rgb, png::BitDepth::Eight, &[0, 51, 255]);
        let decoded = decode("n.png", &map, Role::Normals, 0).unwrap();
        assert_eq!(decoded.image.pixels, [[-1.0, -0.6, 1.0]]);
        let decoded = decode("n.exr", &exr_bytes((0.5, 0.0, 1.0)), Role::Normals, 0).unwrap();
        assert_eq!(decoded.image.pixels[0], [0.0, -1.0, 1.0]);
    }

    #[test]
    fn negative_values_are_taken_as_zero_and_infinite_ones_refused() {
        let decoded = decode("t.exr", &exr_bytes((-1.0, 0.5, 0.5)), Role::Color, 0).unwrap();
        assert!(decoded.negative && decoded.image.pixels[0] == [0.0, 0.5, 0.5]);
        assert!(decode("t.exr", &exr_bytes((f32::INFINITY, 0.5, 0.5)), Role::Color, 0).is_err());
    }

    #[test]
    fn sizes_beyond_the_limit_are_refused_by_the_header() {
        // A header that claims 40000 x 2 pixels, and nothing behind it.
        let mut png = png_of((4, 2), png::ColorType::Grayscale, png::BitDepth::Eight, &[1; 8]);
        png[16..20].copy_from_slice(&40_000u32.to_be_bytes());
        let checksum = crc32(&png[12..29]).to_be_bytes();
        png[29..33].copy_from_slice(&checksum);
        let fault = decode("big.png", &png, Role::Color, 0).unwrap_err();
        assert!(fault.to_string().contains("40000 x 2"), "{fault}");
        let fault = decode("t.exr", &exr_bytes((0.0, 0.0, 0.0)), Role::Color, MAX_MEMORY).unwrap_err();
        assert!(fault.to_string().contains("bytes"), "{fault}");
    }

    #[test]
    fn rubbish_is_refused() {
        for bytes in [&b""[..], b"BM", b"\x89PNG\r\n\x1a\nxx", b"\xff\xd8\xff", b"\x76\x2f\x31\x01\x02"] {
            assert!(decode("x", bytes, Role::Color, 0).is_err());
        }
    }

    fn crc32(bytes: &[u8]) -> u32 {
        !bytes.iter().fold(!0u32, |crc, &byte| {
            (0..8).fold(crc ^ u32::from(byte), |c, _| if c & 1 == 1 { (c >> 1) ^ 0xedb8_8320 } else { c >> 1 })
        })
    }
}
