//! Tests that each PNG chunk that affects the values is used or named by a remark.

use super::*;
use crate::image::{exif, icc};
use ::png::{BitDepth, ColorType};
use femc_math::elementary::double::pow;

/// A chunk: its kind and its data.
type Chunk<'c> = (&'c [u8; 4], &'c [u8]);

fn chunk((kind, data): Chunk<'_>) -> Vec<u8> {
    let summed = [&kind[..], data].concat();
    [&(data.len() as u32).to_be_bytes()[..], &summed, &crc32(&summed).to_be_bytes()].concat()
}

/// Returns the file with chunks after its header.
fn with_chunks(png: &[u8], chunks: &[Chunk<'_>]) -> Vec<u8> {
    let (head, tail) = png.split_at(33);
    [head, &chunks.iter().flat_map(|&it| chunk(it)).collect::<Vec<u8>>(), tail].concat()
}

/// Returns a file of one pixel with 16 bits per channel.
fn pixel(rgb: [u16; 3]) -> Vec<u8> {
    png_of((1, 1), ColorType::Rgb, BitDepth::Sixteen, &rgb.map(u16::to_be_bytes).concat())
}

/// Returns the green value of middle gray with these chunks, and the remarks.
fn decode_gray(chunks: &[Chunk<'_>]) -> (f32, Vec<String>) {
    let decoded = decode("t.png", &with_chunks(&pixel([32_768; 3]), chunks), Role::Color, 0);
    let decoded = decoded.unwrap_or_else(|fault| panic!("{chunks:?}: {fault}"));
    (decoded.image.pixels[0][1], decoded.remarks)
}

fn gamma(value: u32) -> [u8; 4] {
    value.to_be_bytes()
}

/// Returns the data of cHRM: white, red, green, blue.
fn chrm(xy: [f64; 8]) -> Vec<u8> {
    xy.iter().flat_map(|x| ((x * 1e5).round() as u32).to_be_bytes()).collect()
}

const REC709: [f64; 8] = [0.3127, 0.3290, 0.64, 0.33, 0.30, 0.60, 0.15, 0.06];
const P3: [f64; 8] = [0.3127, 0.3290, 0.680, 0.320, 0.265, 0.690, 0.150, 0.060];
const HALF: f64 = 32_768.0 / 65_535.0;
/// Middle gray of sRGB.
const SRGB: f64 = 0.214_049;

/// Returns the data of iCCP. The profile is stored without compression.
fn iccp(name: &str, profile: &[u8]) -> Vec<u8> {
    let length = profile.len() as u16;
    let (mut a, mut b) = (1u32, 0u32);
    profile.iter().for_each(|&byte| {
        a = (a + u32::from(byte)) % 65_521;
        b = (b + a) % 65_521;
    });
    let stored = [&[0x78, 1, 1][..], &length.to_le_bytes(), &(!length).to_le_bytes(), profile].concat();
    [name.as_bytes(), &[0, 0], &stored, &(b << 16 | a).to_be_bytes()].concat()
}

#[test]
fn transfer_functions_of_chunks_are_used_by_their_precedence() {
    let adobe = iccp("ICC profile", &icc::tests::profile("Adobe RGB (1998)", false));
    let srgb = iccp("anything", &icc::tests::profile("sRGB IEC61966-2.1", true));
    let bt709 = pow((HALF + 0.099_296_826_8) / 1.099_296_826_8, 1.0 / 0.45);
    let (linear, g18, compatible) = (gamma(100_000), gamma(55_556), gamma(45_455));
    let rows: &[(&[Chunk<'_>], f64, &str)] = &[
        (&[], SRGB, ""),
        (&[(b"gAMA", &linear)], HALF, ""),
        (&[(b"gAMA", &g18)], pow(HALF, 1e5 / 55_556.0), ""),
        (&[(b"gAMA", &compatible)], SRGB, ""),
        (&[(b"gAMA", &gamma(45_000))], SRGB, ""),
        (&[(b"sRGB", &[0]), (b"gAMA", &linear)], SRGB, ""),
        (&[(b"gAMA", &linear), (b"cICP", &[1, 13, 0, 1])], SRGB, ""),
        (&[(b"cICP", &[1, 8, 0, 1])], HALF, ""),
        (&[(b"cICP", &[1, 4, 0, 1])], pow(HALF, 2.2), ""),
        (&[(b"cICP", &[1, 5, 0, 1])], pow(HALF, 2.8), ""),
        (&[(b"cICP", &[1, 1, 0, 1])], bt709, ""),
        (&[(b"cICP", &[9, 6, 0, 1])], bt709, ""),
        (&[(b"cICP", &[12, 14, 0, 1])], bt709, ""),
        (&[(b"cICP", &[1, 15, 0, 1])], bt709, ""),
        (&[(b"cICP", &[1, 2, 0, 1])], SRGB, "does not specify the transfer function"),
        (&[(b"cICP", &[99, 8, 0, 1])], HALF, "primaries 99 of cICP"),
        // Video range: 16 of 256 is black, 235 is white.
        (&[(b"cICP", &[1, 8, 0, 0])], (128.0 - 16.0) / 219.0, ""),
        (&[(b"sRGB", &[0]), (b"cICP", &[1, 8, 0, 1])], HALF, ""),
        (&[(b"iCCP", &adobe)], SRGB, "color profile `Adobe RGB (1998)` is not applied: values are read as sRGB"),
        (&[(b"iCCP", &adobe), (b"gAMA", &linear)], HALF, "`Adobe RGB (1998)` is not applied: values are read as gAMA"),
        (&[(b"iCCP", &srgb), (b"gAMA", &linear)], SRGB, ""),
        (&[(b"iCCP", &adobe), (b"cICP", &[1, 8, 0, 1])], HALF, ""),
        // Wrong lengths and values are named.
        (&[(b"gAMA", &gamma(0))], SRGB, "gAMA is damaged"),
        (&[(b"gAMA", &[0; 3])], SRGB, "gAMA is damaged"),
        (&[(b"cHRM", &[0; 31])], SRGB, "cHRM is damaged"),
        (&[(b"cHRM", &[0; 32])], SRGB, "are degenerate"),
    ];
    for (i, (chunks, wanted, remark)) in rows.iter().enumerate() {
        let (value, remarks) = decode_gray(chunks);
        assert!((f64::from(value) - wanted).abs() < 2e-5, "row {i}: {value}, not {wanted}");
        match *remark {
            "" => assert!(remarks.is_empty(), "row {i}: {remarks:?}"),
            remark => assert!(remarks.len() == 1 && remarks[0].contains(remark), "row {i}: {remarks:?}"),
        }
    }
    // PNG has red, green and blue, and no matrix.
    assert!(decode("t.png", &with_chunks(&pixel([9; 3]), &[(b"cICP", &[1, 8, 1, 1])]), Role::Color, 0).is_err());
    for (code, name) in [(16, "16 (PQ)"), (18, "18 (HLG)"), (7, "7"), (200, "200")] {
        let file = with_chunks(&pixel([9; 3]), &[(b"cICP", &[9, code, 0, 1])]);
        let fault = decode("t.png", &file, Role::Color, 0).unwrap_err().to_string();
        assert!(fault.contains(&format!("transfer function {name} of cICP")), "{fault}");
    }
}

#[test]
fn damaged_or_misplaced_color_chunks_are_named() {
    let mut file = with_chunks(&pixel([32_768; 3]), &[(b"gAMA", &gamma(100_000))]);
    file[33 + 12] ^= 1;
    let decoded = decode("t.png", &file, Role::Color, 0).unwrap();
    assert!((f64::from(decoded.image.pixels[0][1]) - SRGB).abs() < 1e-5);
    assert!(decoded.remarks[0].contains("gAMA is damaged or misplaced"), "{:?}", decoded.remarks);
    let mut file = pixel([32_768; 3]);
    let end = file.len() - 12;
    file.splice(end..end, chunk((b"sRGB", &[0])));
    let remarks = decode("t.png", &file, Role::Color, 0).unwrap().remarks;
    assert!(remarks.len() == 1 && remarks[0].contains("sRGB is damaged or misplaced"), "{remarks:?}");
}

#[test]
fn primaries_of_chunks_are_converted() {
    let decoded = |rgb: [u16; 3], chunks: &[Chunk<'_>]| {
        let DecodedImage { image, remarks } =
            decode("t.png", &with_chunks(&pixel(rgb), chunks), Role::Color, 0).unwrap();
        (image.pixels[0], remarks)
    };
    let linear = gamma(100_000);
    // A P3 color with Rec.709 components (0.2, 0.4, 0.1), by the published matrix of P3 (D65) to sRGB.
    let p3 = [0.237_1, 0.393_4, 0.128_5].map(|x: f64| (x * 65_535.0).round() as u16);
    for chunks in [&[(b"gAMA", &linear[..]), (b"cHRM", &chrm(P3)[..])][..], &[(b"cICP", &[12, 8, 0, 1][..])]] {
        let ([r, g, b], remarks) = decoded(p3, chunks);
        let to_srgb = [[1.2249, -0.2247, 0.0], [-0.0420, 1.0419, 0.0], [-0.0197, -0.0786, 1.0979]];
        for (value, row) in [r, g, b].into_iter().zip(to_srgb) {
            let wanted: f64 = (0..3).map(|k| row[k] * f64::from(p3[k]) / 65_535.0).sum();
            assert!((f64::from(value) - wanted).abs() < 3e-4, "{value} is not {wanted}");
        }
        assert!(remarks.is_empty(), "{remarks:?}");
        // White stays white; colors outside Rec.709 are clipped and named.
        let (white, _) = decoded([65_535; 3], chunks);
        assert!(white.iter().all(|x| (x - 1.0).abs() < 1e-5), "{white:?}");
        let (green, remarks) = decoded([0, 65_535, 0], chunks);
        assert!(green[0] == 0.0 && green[1] > 1.0 && remarks[0].contains("outside Rec.709"), "{green:?} {remarks:?}");
    }
    // The primaries of Rec.709 change no bit, and neither does the white point of a gray image.
    let plain = decoded([1000, 20_000, 65_535], &[]).0;
    assert_eq!(decoded([1000, 20_000, 65_535], &[(b"cHRM", &chrm(REC709))]), (plain, vec![]));
    let gray = with_chunks(&png_of((1, 1), ColorType::Grayscale, BitDepth::Eight, &[188]), &[(b"cHRM", &chrm(P3))]);
    let gray = decode("t.png", &gray, Role::Color, 0).unwrap();
    assert!(gray.image.pixels[0][0] == gray.image.pixels[0][2] && gray.remarks.is_empty());
}

#[test]
fn alpha_animation_and_orientation_are_named_where_they_matter() {
    let rgba = |alpha: u8| png_of((1, 1), ColorType::Rgba, BitDepth::Eight, &[9, 9, 9, alpha]);
    let remarks = |file: &[u8], role| decode("t.png", file, role, 0).unwrap().remarks;
    assert!(remarks(&rgba(255), Role::Color).is_empty());
    for role in [Role::Color, Role::Normals] {
        assert!(remarks(&rgba(254), role)[0].contains("alpha is not used"));
        // A transparent gray level that no pixel has, and one that a pixel has.
        let gray = png_of((1, 1), ColorType::Grayscale, BitDepth::Eight, &[7]);
        assert!(remarks(&with_chunks(&gray, &[(b"tRNS", &[0, 8])]), role).is_empty());
        assert!(remarks(&with_chunks(&gray, &[(b"tRNS", &[0, 7])]), role)[0].contains("alpha is not used"));
        let animated = [&b"acTL"[..4]].concat();
        let kind: &[u8; 4] = animated.as_slice().try_into().unwrap();
        let said = remarks(&with_chunks(&gray, &[(kind, &[0, 0, 0, 1, 0, 0, 0, 0])]), role);
        assert!(said[0].contains("animation is not used"), "{said:?}");
        let said = remarks(&with_chunks(&gray, &[(b"eXIf", &exif::tests::tiff(true, 8, 65_535))]), role);
        assert!(said.len() == 1 && said[0].contains("orientation 8"), "{said:?}");
        // Chunks that change no value give no warning.
        let harmless: &[Chunk<'_>] =
            &[(b"sBIT", &[5]), (b"pHYs", &[0, 0, 0, 1, 0, 0, 0, 2, 0]), (b"tEXt", b"a\0b"), (b"bKGD", &[0, 1])];
        assert!(remarks(&with_chunks(&gray, harmless), role).is_empty());
    }
}

#[test]
fn color_chunks_mean_nothing_to_normals() {
    let file = pixel([0, 32_768, 65_535]);
    let plain = decode("t.png", &file, Role::Normals, 0).unwrap();
    let adobe = iccp("Adobe", &icc::tests::profile("Adobe RGB (1998)", false));
    for chunks in [
        &[(b"gAMA", &gamma(100_000)[..]), (b"cHRM", &chrm(P3)[..])][..],
        &[(b"cICP", &[9, 16, 0, 0][..])],
        &[(b"iCCP", &adobe[..])],
    ] {
        let decoded = decode("t.png", &with_chunks(&file, chunks), Role::Normals, 0).unwrap();
        assert_eq!((decoded.image.pixels, decoded.remarks), (plain.image.pixels.clone(), vec![]));
    }
}
