//! Tests that each JPEG segment that affects the values is used or named by a remark.

use super::*;
use crate::image::{exif, icc};

const ORANGE: &[u8] = include_bytes!("../../../tests/files/orange.jpg");

/// Returns the file with a segment before all others.
fn with_segment(marker: u8, data: &[u8]) -> Vec<u8> {
    let length = (data.len() as u16 + 2).to_be_bytes();
    [&ORANGE[..2], &[0xff, marker], &length, data, &ORANGE[2..]].concat()
}

fn remarks(file: &[u8], role: Role) -> Vec<String> {
    decode("t.jpg", file, role, 0).unwrap().remarks
}

#[test]
fn a_plain_file_has_no_remark() {
    assert!(remarks(ORANGE, Role::Color).is_empty());
}

#[test]
fn orientation_profile_and_color_space_are_named() {
    let exif = |orientation, space| [b"Exif\0\0", &exif::tests::tiff(false, orientation, space)[..]].concat();
    let profile = |name| [b"ICC_PROFILE\0\x01\x01", &icc::tests::profile(name, true)[..]].concat();
    for (marker, data, remark, of_colors) in [
        (0xe1, exif(6, 1), "EXIF orientation 6 is not applied", false),
        (0xe1, exif(1, 1), "", false),
        (0xe1, exif(1, 65_535), "EXIF color space 65535 (uncalibrated)", true),
        (0xe1, exif(1, 2), "EXIF color space 2 (Adobe RGB)", true),
        (0xe2, profile("Display P3"), "color profile `Display P3` is not applied: values are read as sRGB", true),
        (0xe2, profile("sRGB built-in"), "", true),
        (0xe2, b"ICC_PROFILE\0\x01\x01damaged".to_vec(), "color profile `(unnamed)`", true),
        (0xe2, b"MPF\0II*\0".to_vec(), "holds several pictures", false),
        (0xed, b"Photoshop 3.0\0".to_vec(), "", false),
        (0xfe, b"a comment".to_vec(), "", false),
    ] {
        for role in [Role::Color, Role::Normals] {
            let said = remarks(&with_segment(marker, &data), role);
            if remark.is_empty() || of_colors && role == Role::Normals {
                assert!(said.is_empty(), "{marker:x}: {said:?}");
            } else {
                assert!(said.len() == 1 && said[0].contains(remark), "{marker:x}: {said:?}");
            }
        }
    }
}

#[test]
fn the_transform_of_adobes_segment_is_used() {
    let adobe = |transform: u8| with_segment(0xee, &[&b"Adobe\0\x64\0\0\0\0"[..], &[transform]].concat());
    let pixel = |file: &[u8]| decode("t.jpg", file, Role::Normals, 0).unwrap().image.pixels[0];
    assert_eq!(pixel(&adobe(1)), pixel(ORANGE));
    // Y, Cb, Cr of orange (255, 128, 0), read as red, green and blue.
    let [y, cb, cr] = pixel(&adobe(0)).map(|x| 127.5 * (x + 1.0));
    assert!((y - 151.0).abs() < 4.0 && (cb - 43.0).abs() < 4.0 && (cr - 202.0).abs() < 4.0, "{y} {cb} {cr}");
}

#[test]
fn components_called_r_g_b_are_named() {
    // The JFIF segment implies YCbCr; without it, the names of the components imply RGB.
    let start = ORANGE.windows(2).position(|two| two == [0xff, 0xc0]).expect("a frame header");
    let mut file = ORANGE.to_vec();
    for (i, name) in b"RGB".iter().enumerate() {
        file[start + 10 + 3 * i] = *name;
    }
    let scan = file.windows(2).position(|two| two == [0xff, 0xda]).expect("a scan header");
    for (i, name) in b"RGB".iter().enumerate() {
        file[scan + 5 + 2 * i] = *name;
    }
    let jfif = file.windows(5).position(|five| five == b"JFIF\0");
    if let Some(jfif) = jfif {
        file[jfif] = b'X';
    }
    let said = remarks(&file, Role::Color);
    assert!(said.len() == 1 && said[0].contains("named R, G and B"), "{said:?}");
    assert!(remarks(&file, Role::Normals).is_empty());
}

#[test]
fn a_file_cut_anywhere_is_refused_or_read() {
    for n in 0..ORANGE.len() {
        let _ = decode("t.jpg", &ORANGE[..n], Role::Color, 0);
    }
}
