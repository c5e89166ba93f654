//! Reader of PNG: interprets values by the color chunks of the specification's third edition, in the order of precedence cICP,
//! iCCP, sRGB, then gAMA and cHRM.

use super::{
    ImageFile, RawImage, Role,
    exif::Exif,
    icc,
    primaries::{Chromaticities, Matrix},
    printable, rgb_of_channels,
    transfer::Transfer,
};
use crate::ImportFault;
use std::io::Cursor;

/// The gAMA value that stands for sRGB, and the tolerance for rounded digits (1 %).
const SRGB_GAMMA: [u32; 2] = [45_455, 455];

/// Properties of the values in a file's chunks.
#[derive(Debug, Default, PartialEq)]
struct PngHeader {
    /// Primaries, transfer function, matrix and range by ITU-T H.273.
    cicp: Option<[u8; 4]>,
    /// Name of the color profile.
    profile: Option<String>,
    srgb: bool,
    /// Encoding exponent times 100000.
    gamma: Option<u32>,
    chromaticities: Option<Chromaticities>,
    animated: bool,
    exif: Exif,
    /// Color chunks that cannot be used.
    damaged: Vec<String>,
}

pub(super) fn open(file: &ImageFile<'_>) -> Result<RawImage, ImportFault> {
    let fault = |error: png::DecodingError| file.bad_file(error.to_string());
    let mut decoder = png::Decoder::new(Cursor::new(file.bytes));
    // Palettes and depths below 8 bits are expanded to whole bytes; 16 bits stay.
    decoder.set_transformations(png::Transformations::EXPAND);
    let mut reader = decoder.read_info().map_err(fault)?;
    let (width, height) = file.check_size(reader.info().width as usize, reader.info().height as usize)?;
    let (color, depth) = reader.output_color_type();
    let size = reader.output_buffer_size().ok_or_else(|| file.bad_file("the image is too large for this machine"))?;
    let mut header = PngHeader::read(file.bytes);
    if let Some(profile) = reader.info().icc_profile.as_deref().and_then(icc::description) {
        header.profile = Some(profile);
    }
    let mut values = vec![0; size];
    reader.next_frame(&mut values).map_err(fault)?;

    let is_color = file.role == Role::Color;
    let mut remarks = header.exif.remarks(is_color, true);
    if header.animated {
        remarks.push("animation is not used: the texture is the still image of the file".to_owned());
    }
    let interpretation = match file.role {
        Role::Color => header.interpretation(file)?,
        Role::Normals => ColorInterpretation::default(),
    };
    let is_gray = color.samples() < 3;
    remarks.extend(interpretation.remarks);
    let channels = color.samples();
    let bytes = if depth == png::BitDepth::Sixteen { 2 } else { 1 };
    let most = if bytes == 2 { f64::from(u16::MAX) } else { f64::from(u8::MAX) };
    let table: Vec<f32> = (0..=most as u32)
        .map(|value| interpretation.transfer.value(interpretation.range.normalize(f64::from(value), most), file.role))
        .collect();
    let number = |pixel: &[u8], i: usize| match bytes {
        1 => usize::from(pixel[i]),
        _ => usize::from(u16::from_be_bytes([pixel[2 * i], pixel[2 * i + 1]])),
    };
    let pixels = values.chunks_exact(bytes * channels);
    if channels % 2 == 0 && pixels.clone().any(|pixel| number(pixel, channels - 1) < most as usize) {
        remarks.push("alpha is not used: transparent pixels keep their color".to_owned());
    }
    let pixels = pixels.map(|pixel| rgb_of_channels(channels, |i| table[number(pixel, i)])).collect();
    let to_rec709 = if is_gray { None } else { interpretation.to_rec709 };
    Ok(RawImage { width, height, pixels, to_rec709, remarks })
}

/// Interpretation of a file's values.
struct ColorInterpretation {
    transfer: Transfer,
    range: Range,
    to_rec709: Option<Matrix>,
    remarks: Vec<String>,
}

impl Default for ColorInterpretation {
    fn default() -> Self {
        Self { transfer: Transfer::Srgb, range: Range::Full, to_rec709: None, remarks: Vec::new() }
    }
}

/// Range of values from black to white.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Range {
    /// From the least to the largest value.
    Full,
    /// From 16 to 235 of 8 bits, as in video.
    Narrow,
}

impl Range {
    /// Maps a value of `0..=most` to [0, 1].
    fn normalize(self, value: f64, max_value: f64) -> f64 {
        match self {
            Self::Full => value / max_value,
            Self::Narrow => {
                let step = (max_value + 1.0) / 256.0;
                ((value / step - 16.0) / 219.0).clamp(0.0, 1.0)
            }
        }
    }
}

impl PngHeader {
    fn read(bytes: &[u8]) -> Self {
        let mut header = Self::default();
        let mut rest = bytes.get(8..).unwrap_or_default();
        let mut before_pixels = true;
        while let Some((kind, data, is_sound)) = next_chunk(&mut rest) {
            let is_color = matches!(kind, b"cICP" | b"iCCP" | b"sRGB" | b"gAMA" | b"cHRM");
            match kind {
                b"IDAT" => before_pixels = false,
                b"acTL" => header.animated = true,
                b"eXIf" if is_sound => header.exif = Exif::read(data),
                _ if is_color && !(is_sound && before_pixels && header.read_color_chunk(kind, data)) => {
                    let name = String::from_utf8_lossy(kind);
                    header.damaged.push(format!("chunk {name} is damaged or misplaced: it is not used"));
                }
                _ => {}
            }
        }
        header
    }

    /// Reads a color chunk. Returns false if it contains nothing that can be used.
    fn read_color_chunk(&mut self, kind: &[u8; 4], data: &[u8]) -> bool {
        let number = |i: usize| {
            let four = data.get(4 * i..4 * i + 4)?;
            Some(u32::from_be_bytes(four.try_into().ok()?))
        };
        match (kind, data.len()) {
            // PNG contains red, green and blue, so it has no matrix.
            (b"cICP", 4) if data[2] == 0 && data[3] <= 1 => self.cicp = Some([data[0], data[1], data[2], data[3]]),
            (b"iCCP", _) => {
                let name = data.iter().take(80).position(|&byte| byte == 0).unwrap_or(0);
                self.profile = Some(printable(&data[..name].iter().map(|&byte| char::from(byte)).collect::<String>()));
            }
            (b"sRGB", 1) => self.srgb = true,
            (b"gAMA", 4) => self.gamma = number(0).filter(|&gamma| gamma > 0),
            (b"cHRM", 32) => {
                let xy = |i: usize| [2 * i, 2 * i + 1].map(|i| f64::from(number(i).unwrap_or(0)) / 1e5);
                // White comes first.
                self.chromaticities = Some([xy(1), xy(2), xy(3), xy(0)]);
            }
            _ => return false,
        }
        kind != b"gAMA" || self.gamma.is_some()
    }

    /// Returns the interpretation of color values, by the chunk with the highest precedence.
    fn interpretation(&self, file: &ImageFile<'_>) -> Result<ColorInterpretation, ImportFault> {
        let mut interpretation =
            ColorInterpretation { remarks: self.damaged.clone(), ..ColorInterpretation::default() };
        if let Some([primaries, transfer, _, range]) = self.cicp {
            interpretation.transfer = cicp_transfer(transfer, file, &mut interpretation.remarks)?;
            interpretation.range = if range == 1 { Range::Full } else { Range::Narrow };
            match cicp_primaries(primaries) {
                Some(primaries) => interpretation.set_primaries(primaries),
                None => interpretation.remarks.push(format!("primaries {primaries} of cICP are treated as Rec.709")),
            }
            return Ok(interpretation);
        }
        let is_srgb = match &self.profile {
            Some(name) if icc::is_srgb(name) => true,
            Some(name) => {
                let instead = if self.gamma.is_some() && !self.srgb { "gAMA and cHRM say" } else { "sRGB" };
                interpretation.remarks.extend(icc::remark(name, instead));
                self.srgb
            }
            None => self.srgb,
        };
        if is_srgb {
            return Ok(interpretation);
        }
        if let Some(gamma) = self.gamma.filter(|gamma| gamma.abs_diff(SRGB_GAMMA[0]) > SRGB_GAMMA[1]) {
            interpretation.transfer = Transfer::Power(1e5 / f64::from(gamma));
        }
        if let Some(chromaticities) = self.chromaticities {
            interpretation.set_primaries(chromaticities);
        }
        Ok(interpretation)
    }
}

impl ColorInterpretation {
    fn set_primaries(&mut self, chromaticities: Chromaticities) {
        match Matrix::to_rec709(chromaticities) {
            Ok(matrix) => self.to_rec709 = matrix,
            Err(_) => self.remarks.push("the primaries are degenerate: they are not used".to_owned()),
        }
    }
}

/// Returns the transfer function of a code of ITU-T H.273.
fn cicp_transfer(code: u8, file: &ImageFile<'_>, remarks: &mut Vec<String>) -> Result<Transfer, ImportFault> {
    let name = match code {
        1 | 6 | 14 | 15 => return Ok(Transfer::Bt709),
        4 => return Ok(Transfer::Power(2.2)),
        5 => return Ok(Transfer::Power(2.8)),
        8 => return Ok(Transfer::Power(1.0)),
        13 => return Ok(Transfer::Srgb),
        2 => {
            remarks.push("cICP does not specify the transfer function: values are read as sRGB".to_owned());
            return Ok(Transfer::Srgb);
        }
        16 => " (PQ)",
        18 => " (HLG)",
        _ => "",
    };
    let reason = format!("transfer function {code}{name} of cICP is not supported");
    Err(file.bad_file_with_advice(reason, "save it again as EXR, or as PNG with sRGB or linear values"))
}

/// Returns the primaries of a code of ITU-T H.273.
fn cicp_primaries(code: u8) -> Option<Chromaticities> {
    const D65: [f64; 2] = [0.3127, 0.3290];
    const C: [f64; 2] = [0.310, 0.316];
    Some(match code {
        1 => super::primaries::REC709,
        4 => [[0.67, 0.33], [0.21, 0.71], [0.14, 0.08], C],
        5 => [[0.64, 0.33], [0.29, 0.60], [0.15, 0.06], D65],
        6 | 7 => [[0.630, 0.340], [0.310, 0.595], [0.155, 0.070], D65],
        8 => [[0.681, 0.319], [0.243, 0.692], [0.145, 0.049], C],
        9 => [[0.708, 0.292], [0.170, 0.797], [0.131, 0.046], D65],
        10 => [[1.0, 0.0], [0.0, 1.0], [0.0, 0.0], [1.0 / 3.0, 1.0 / 3.0]],
        11 => [[0.680, 0.320], [0.265, 0.690], [0.150, 0.060], [0.314, 0.351]],
        12 => [[0.680, 0.320], [0.265, 0.690], [0.150, 0.060], D65],
        22 => [[0.630, 0.340], [0.295, 0.605], [0.155, 0.077], D65],
        _ => return None,
    })
}

/// Returns the next chunk: its kind, its data and whether its checksum is correct.
fn next_chunk<'b>(rest: &mut &'b [u8]) -> Option<(&'b [u8; 4], &'b [u8], bool)> {
    let (length, tail) = rest.split_first_chunk::<4>()?;
    let length = usize::try_from(u32::from_be_bytes(*length)).ok()?;
    let summed = tail.get(..length.checked_add(4)?)?;
    let (kind, data) = summed.split_first_chunk::<4>()?;
    let (checksum, tail) = tail[summed.len()..].split_first_chunk::<4>()?;
    *rest = tail;
    // The decoder checks the pixel data.
    let is_sound = kind == b"IDAT" || crc32(summed) == u32::from_be_bytes(*checksum);
    Some((kind, data, is_sound))
}

/// Returns the checksum used by PNG.
pub(super) fn crc32(bytes: &[u8]) -> u32 {
    !bytes.iter().fold(!0u32, |crc, &byte| {
        (0..8).fold(crc ^ u32::from(byte), |c, _| if c & 1 == 1 { (c >> 1) ^ 0xedb8_8320 } else { c >> 1 })
    })
}
