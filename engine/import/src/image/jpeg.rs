//! Reader of JPEG: interprets values by the segments before the first scan.

use super::{ImageFile, RawImage, Role, exif::Exif, icc, transfer::Transfer};
use crate::ImportFault;
use zune_jpeg::JpegDecoder;
use zune_jpeg::zune_core::bytestream::ZCursor;
use zune_jpeg::zune_core::colorspace::ColorSpace;
use zune_jpeg::zune_core::options::DecoderOptions;

/// Pixel properties in a file's segments.
#[derive(Debug, Default)]
struct JpegHeader {
    /// Number of components.
    components: u8,
    /// Whether the components are named `R`, `G`, `B`.
    is_named_rgb: bool,
    has_jfif: bool,
    /// Color transform of Adobe's segment: 0 none; 1 YCbCr; 2 YCCK.
    adobe: Option<u8>,
    /// Name of the color profile.
    profile: Option<String>,
    exif: Exif,
    has_more_pictures: bool,
}

pub(super) fn open(file: &ImageFile<'_>) -> Result<RawImage, ImportFault> {
    let most = usize::from(u16::MAX);
    let options =
        DecoderOptions::default().set_max_width(most).set_max_height(most).jpeg_set_out_colorspace(ColorSpace::RGB);
    let mut decoder = JpegDecoder::new_with_options(ZCursor::new(file.bytes), options);
    decoder.decode_headers().map_err(|error| file.bad_file(error.to_string()))?;
    let (width, height) = decoder.dimensions().ok_or_else(|| file.bad_file("the header has no image size"))?;
    let (width, height) = file.check_size(width, height)?;
    let header = JpegHeader::read(file.bytes);
    if !matches!(header.components, 1 | 3 | 4) {
        return Err(file.bad_file(format!("the image has {} components; 1, 3 or 4 are supported", header.components)));
    }
    let values = decoder.decode().map_err(|error| file.bad_file(error.to_string()))?;
    let table = Transfer::Srgb.byte_table(file.role);
    let pixels = values.chunks_exact(3).map(|p| [0, 1, 2].map(|i| table[usize::from(p[i])])).collect();
    let remarks = header.remarks(file.role == Role::Color);
    Ok(RawImage { width, height, pixels, to_rec709: None, remarks })
}

impl JpegHeader {
    fn read(bytes: &[u8]) -> Self {
        let mut header = Self::default();
        let mut rest = bytes.get(2..).unwrap_or_default();
        while let [0xff, marker, tail @ ..] = rest {
            // Fill bytes, and markers without a length.
            if matches!(marker, 0xff) {
                rest = &rest[1..];
                continue;
            }
            if matches!(marker, 0x01 | 0xd0..=0xd8) {
                rest = tail;
                continue;
            }
            // The first scan, or the end.
            if matches!(marker, 0xda | 0xd9) {
                break;
            }
            let Some((length, _)) = tail.split_first_chunk::<2>() else { break };
            let length = usize::from(u16::from_be_bytes(*length));
            let (Some(data), Some(after)) = (tail.get(2..length), tail.get(length..)) else { break };
            header.read_segment(*marker, data);
            rest = after;
        }
        header
    }

    fn read_segment(&mut self, marker: u8, data: &[u8]) {
        match marker {
            0xc0..=0xcf if !matches!(marker, 0xc4 | 0xc8 | 0xcc) => {
                self.components = data.get(5).copied().unwrap_or(0);
                let names: Vec<u8> = data.iter().skip(6).step_by(3).take(3).copied().collect();
                self.is_named_rgb = self.components == 3 && names == b"RGB";
            }
            0xe0 => self.has_jfif |= data.starts_with(b"JFIF\0"),
            0xe1 => {
                if let Some(tiff) = data.strip_prefix(b"Exif\0\0") {
                    self.exif = Exif::read(tiff);
                }
            }
            // A profile may span several segments; its name is in the first one.
            0xe2 => {
                if let Some([1, _, profile @ ..]) = data.strip_prefix(b"ICC_PROFILE\0") {
                    self.profile = Some(icc::description(profile).unwrap_or_else(|| "(unnamed)".to_owned()));
                }
                self.has_more_pictures |= data.starts_with(b"MPF\0");
            }
            0xee if data.starts_with(b"Adobe") => self.adobe = data.get(11).copied(),
            _ => {}
        }
    }

    fn remarks(&self, is_color: bool) -> Vec<String> {
        let mut remarks = self.exif.remarks(is_color, self.profile.is_some());
        if self.has_more_pictures {
            remarks.push("the file holds several pictures: only the first one is used".to_owned());
        }
        if !is_color {
            return remarks;
        }
        if self.components == 4 {
            let name = if self.adobe == Some(2) { "YCCK" } else { "CMYK" };
            remarks.push(format!(
                "the colors are inks ({name}) and are converted to RGB without a color profile: save the image as RGB"
            ));
        } else {
            remarks.extend(self.profile.as_deref().and_then(|name| icc::remark(name, "sRGB")));
        }
        if self.is_named_rgb && self.adobe.is_none() && !self.has_jfif {
            remarks.push("the components are named R, G and B but are read as YCbCr: save the image again".to_owned());
        }
        remarks
    }
}
