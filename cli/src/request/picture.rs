//! A frame as a PNG: tone-mapped, with the metadata of an EXR file in text chunks, so that a later run recognizes it.

use crate::exit::{Failure, failed};
use crate::values::{Exposure, ev};
use std::collections::BTreeMap;
use std::io::Cursor;
use std::path::Path;

/// Attribute with the requested exposure.
pub const EXPOSURE: &str = "femc:exposure";
/// Attribute with the resulting exposure value.
pub const EV: &str = "femc:ev";

/// Size of the signature and header chunk of a PNG file. Further chunks follow, before the pixels.
const HEADER_SIZE: usize = 8 + 25;
/// Largest text chunk that is read, in bytes.
const MAX_TEXT: usize = 1 << 20;

/// Converts the frame of an EXR file to a PNG file.
pub fn from_exr(bytes: &[u8], exposure: Exposure) -> Result<Vec<u8>, Failure> {
    let file = femc_film::exr::decode(Cursor::new(bytes)).map_err(failed)?;
    let curve = exposure.curve_of(&file.image);
    let png = curve.picture(&file.image).to_png().map_err(failed)?;
    let own = file.attributes.into_iter().filter(|(name, _)| name.starts_with("femc:"));
    let shown = [(EXPOSURE.to_owned(), exposure.to_string()), (EV.to_owned(), format!("{:.3}", ev(curve)))];
    Ok(insert_text_chunks(&png, own.chain(shown)))
}

/// Reads the metadata of a frame's file, EXR or PNG; `None`: the file is missing or has none.
pub fn attributes(path: &Path) -> Option<BTreeMap<String, String>> {
    if is_picture(path) {
        read_text_chunks(&std::fs::read(path).ok()?)
    } else {
        femc_film::exr::read_attributes(path).ok()
    }
}

/// Returns whether a frame with this file name is a picture.
pub fn is_picture(path: &Path) -> bool {
    path.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("png"))
}

fn insert_text_chunks(png: &[u8], texts: impl Iterator<Item = (String, String)>) -> Vec<u8> {
    let (head, rest) = png.split_at(HEADER_SIZE.min(png.len()));
    let mut out = head.to_vec();
    for (name, text) in texts {
        // Keyword, then five zero bytes: end of the keyword, no compression, no language, no translation.
        let data = [b"iTXt", name.as_bytes(), &[0; 5], text.as_bytes()].concat();
        out.extend(((data.len() - 4) as u32).to_be_bytes());
        out.extend(&data);
        out.extend(crc(&data).to_be_bytes());
    }
    out.extend(rest);
    out
}

fn read_text_chunks(png: &[u8]) -> Option<BTreeMap<String, String>> {
    let (mut rest, mut found) = (png.get(HEADER_SIZE..)?, BTreeMap::new());
    loop {
        let (length, after) = rest.split_first_chunk::<4>()?;
        let length = u32::from_be_bytes(*length) as usize;
        let data = after.get(..length.checked_add(4)?)?;
        match data.strip_prefix(b"iTXt") {
            Some(text) if length <= MAX_TEXT => {
                let end = text.iter().position(|byte| *byte == 0)?;
                let value = text.get(end + 5..)?;
                found.insert(String::from_utf8(text[..end].to_vec()).ok()?, String::from_utf8(value.to_vec()).ok()?);
            }
            _ if data.starts_with(b"IDAT") => return Some(found),
            _ => {}
        }
        rest = after.get(length + 8..)?;
    }
}

/// CRC-32 of PNG chunks (IEEE 802.3).
fn crc(bytes: &[u8]) -> u32 {
    !bytes.iter().fold(!0, |crc, &byte| {
        (0..8).fold(crc ^ u32::from(byte), |c, _| if c & 1 == 1 { (c >> 1) ^ 0xedb8_8320 } else { c >> 1 })
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use femc_film::Picture;

    #[test]
    fn texts_survive_a_png_round_trip_and_garbage_has_none() {
        let picture = Picture { width: 2, height: 1, pixels: vec![[1, 2, 3], [4, 5, 6]] };
        let png = picture.to_png().expect("a PNG");
        let wanted = [("femc:settings", "{\"ä\":1}"), ("femc:spp", "")].map(|(a, b)| (a.to_owned(), b.to_owned()));
        let with = insert_text_chunks(&png, wanted.clone().into_iter());
        assert_eq!(Picture::from_png(&with).expect("the picture"), picture, "the checksums are right");
        assert_eq!(read_text_chunks(&with), Some(BTreeMap::from(wanted)));
        for end in 0..with.len() - 20 {
            let _ = read_text_chunks(&with[..end]);
        }
        assert_eq!(read_text_chunks(b"no PNG"), None);
        assert_eq!(crc(b"123456789"), 0xcbf4_3926);
    }
}
