//! Pixel properties in EXIF data: the orientation and the color space.

/// EXIF tags that affect pixels.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Exif {
    /// Orientation: 1 as stored; 2 to 8 rotated or mirrored.
    orientation: Option<u16>,
    /// Color space: 1 sRGB; 2 Adobe RGB; 65535 another one.
    color_space: Option<u16>,
}

impl Exif {
    /// Reads the tags of a TIFF structure.
    pub fn read(tiff: &[u8]) -> Self {
        let little = tiff.starts_with(b"II");
        let number = |at: usize, bytes: usize| -> Option<usize> {
            let bytes = tiff.get(at..at.checked_add(bytes)?)?.iter().map(|&byte| usize::from(byte));
            let add = |sum: usize, byte: usize| sum << 8 | byte;
            Some(if little { bytes.rev().fold(0, add) } else { bytes.fold(0, add) })
        };
        // Returns the value of a tag that fits into its entry.
        let tag = |directory: usize, wanted: usize| -> Option<(usize, usize)> {
            let count = number(directory, 2)?;
            let entry = (0..count).map(|i| directory + 2 + 12 * i).find(|&at| number(at, 2) == Some(wanted))?;
            Some((number(entry + 8, 2)?, number(entry + 8, 4)?))
        };
        let short = |directory, wanted| tag(directory, wanted).and_then(|(short, _)| u16::try_from(short).ok());
        let Some(first) = number(4, 4) else { return Self::default() };
        let color_space = tag(first, 0x8769).and_then(|(_, inner)| short(inner, 0xa001));
        Self { orientation: short(first, 0x0112), color_space }
    }

    /// Returns remarks on the tags that are not used. A color profile in the file takes precedence over the color space.
    pub fn remarks(&self, is_color: bool, has_profile: bool) -> Vec<String> {
        let mut remarks = Vec::new();
        if let Some(orientation @ 2..=8) = self.orientation {
            remarks.push(format!(
                "EXIF orientation {orientation} is not applied: rotate the image or the texture coordinates"
            ));
        }
        if let (Some(space @ (2 | 65_535)), true, false) = (self.color_space, is_color, has_profile) {
            let name = if space == 2 { "Adobe RGB" } else { "uncalibrated" };
            remarks.push(format!("EXIF color space {space} ({name}) is not applied: values are read as sRGB"));
        }
        remarks
    }
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;

    /// Returns a TIFF structure with an orientation and a color space.
    pub fn tiff(little: bool, orientation: u16, color_space: u16) -> Vec<u8> {
        let mut bytes = if little { b"II".to_vec() } else { b"MM".to_vec() };
        let two = |n: u16| if little { n.to_le_bytes() } else { n.to_be_bytes() };
        let four = |n: u32| if little { n.to_le_bytes() } else { n.to_be_bytes() };
        bytes.extend([&two(42)[..], &four(8), &two(2)].concat());
        bytes.extend([&two(0x0112)[..], &two(3), &four(1), &two(orientation), &two(0)].concat());
        bytes.extend([&two(0x8769)[..], &two(4), &four(1), &four(38), &four(0)].concat());
        bytes.extend([&two(1)[..], &two(0xa001), &two(3), &four(1), &two(color_space), &two(0)].concat());
        bytes
    }

    #[test]
    fn both_byte_orders_are_read_and_rubbish_says_nothing() {
        for little in [true, false] {
            let exif = Exif::read(&tiff(little, 6, 65_535));
            assert_eq!(exif, Exif { orientation: Some(6), color_space: Some(65_535) });
            assert_eq!(exif.remarks(true, false).len(), 2);
            assert_eq!((exif.remarks(true, true).len(), exif.remarks(false, false).len()), (1, 1));
            assert!(Exif::read(&tiff(little, 1, 1)).remarks(true, false).is_empty());
            let whole = tiff(little, 3, 1);
            assert!((0..whole.len()).all(|n| Exif::read(&whole[..n]).remarks(true, false).len() <= 2));
        }
        assert_eq!(Exif::read(b"MM\0*\xff\xff\xff\xff"), Exif::default());
    }
}
