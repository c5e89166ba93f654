//! Tests of images, most of them written by the tests themselves.

mod exr_header;
mod jpeg_header;
mod png_header;

use super::{png::crc32, *};
use ::exr::{compression::Compression, prelude as exr_prelude};
use std::io::Cursor;

fn png_of((width, height): (u32, u32), color: ::png::ColorType, depth: ::png::BitDepth, values: &[u8]) -> Vec<u8> {
    let mut bytes = Vec::new();
    let mut encoder = ::png::Encoder::new(&mut bytes, width, height);
    encoder.set_color(color);
    encoder.set_depth(depth);
    if color == ::png::ColorType::Indexed {
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
fn srgb_becomes_linear_for_any_depth_alpha_and_palette() {
    use ::png::{BitDepth, ColorType};
    let sixteen: Vec<u8> = [0u16, 188 * 257, 65_535].iter().flat_map(|x| x.to_be_bytes()).collect();
    for (color, depth, pixel) in [
        (ColorType::Rgb, BitDepth::Eight, &[0, 188, 255][..]),
        (ColorType::Rgba, BitDepth::Eight, &[0, 188, 255, 9]),
        (ColorType::Rgb, BitDepth::Sixteen, &sixteen),
        (ColorType::Indexed, BitDepth::Eight, &[0]),
    ] {
        let bytes = png_of((2, 1), color, depth, &pixel.repeat(2));
        let DecodedImage { image, remarks } = decode("t.png", &bytes, Role::Color, 0).unwrap();
        assert_eq!(
            (image.width, image.height, image.pixels.len(), remarks.is_empty() || color == ColorType::Rgba),
            (2, 1, 2, true)
        );
        let [r, g, b] = image.pixels[1];
        assert!(r == 0.0 && b == 1.0 && (g - 0.5029).abs() < 1e-4, "{color:?}: {:?}", image.pixels[1]);
    }
    // Gray: with alpha, and with one bit, where the last byte of a row has unused bits.
    let gray = png_of((1, 1), ColorType::GrayscaleAlpha, BitDepth::Eight, &[255, 0]);
    assert_eq!(decode("g.png", &gray, Role::Color, 0).unwrap().image.pixels, [[1.0; 3]]);
    let bits = png_of((3, 2), ColorType::Grayscale, BitDepth::One, &[0b0100_0000, 0b1010_0000]);
    let bits = decode("g.png", &bits, Role::Color, 0).unwrap().image.pixels;
    assert_eq!(bits, [0.0, 1.0, 0.0, 1.0, 0.0, 1.0].map(|x| [x; 3]));
}

#[test]
fn jpeg_is_read_in_color_and_in_grey() {
    // 8 x 8 pixels of (255, 128, 0), and 5 x 3 of gray 188.
    let color = decode("t.jpg", include_bytes!("../../../tests/files/orange.jpg"), Role::Color, 0).unwrap().image;
    assert_eq!((color.width, color.height, color.pixels.len()), (8, 8, 64));
    let near = |pixel: &[f32; 3], wanted: [f32; 3]| (0..3).all(|i| (pixel[i] - wanted[i]).abs() < 0.03);
    assert!(color.pixels.iter().all(|p| near(p, [1.0, 0.2159, 0.0])), "{:?}", color.pixels[0]);
    let gray = decode("t.jpg", include_bytes!("../../../tests/files/gray.jpg"), Role::Color, 0).unwrap().image;
    assert_eq!((gray.width, gray.height, gray.pixels.len()), (5, 3, 15));
    assert!(gray.pixels.iter().all(|p| near(p, [0.5029; 3])), "{:?}", gray.pixels[0]);
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
    let map = png_of((1, 1), ::png::ColorType::Rgb, ::png::BitDepth::Eight, &[0, 51, 255]);
    let decoded = decode("n.png", &map, Role::Normals, 0).unwrap();
    assert_eq!(decoded.image.pixels, [[-1.0, -0.6, 1.0]]);
    let decoded = decode("n.exr", &exr_bytes((0.5, 0.0, 1.0)), Role::Normals, 0).unwrap();
    assert_eq!(decoded.image.pixels[0], [0.0, -1.0, 1.0]);
}

#[test]
fn negative_values_are_taken_as_zero_and_infinite_ones_refused() {
    let decoded = decode("t.exr", &exr_bytes((-1.0, 0.5, 0.5)), Role::Color, 0).unwrap();
    assert!(
        decoded.remarks == ["image has negative values: treated as 0"] && decoded.image.pixels[0] == [0.0, 0.5, 0.5]
    );
    assert!(decode("t.exr", &exr_bytes((f32::INFINITY, 0.5, 0.5)), Role::Color, 0).is_err());
}

#[test]
fn sizes_beyond_the_limit_are_refused_by_the_header() {
    // A header that claims 40000 x 2 pixels, without enough data.
    let mut png = png_of((4, 2), ::png::ColorType::Grayscale, ::png::BitDepth::Eight, &[1; 8]);
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
