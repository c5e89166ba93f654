//! Writing of channels by name, such as layers for later use, with a precision for each channel.

use super::write::{encode_channels, floats, write_error};
use crate::FilmError;
use exr::prelude::{AnyChannel, FlatSamples, f16};
use std::collections::BTreeMap;

/// Storage format of a channel's values.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Precision {
    /// 16 bits: 11 binary digits, up to 65504.
    Half,
    /// 32 bits, unchanged.
    Float,
}

/// A channel and its values.
#[derive(Clone, Copy, Debug)]
pub struct NamedChannel<'a> {
    /// Name, such as `full.R`.
    pub name: &'a str,
    /// Values, one per pixel, row by row from the top left.
    pub values: &'a [f32],
    /// Storage format.
    pub precision: Precision,
}

/// Encodes a file of the form that [`super::encode`] writes, with these channels.
/// - `size`: width and height;
/// - `attributes`: text attributes by name;
/// - errors: the number of values of a channel is not the number of pixels, or its precision cannot hold a value.
pub fn encode_named_channels(
    size: [u32; 2],
    channels: &[NamedChannel<'_>],
    attributes: &BTreeMap<String, String>,
) -> Result<Vec<u8>, FilmError> {
    let pixels = size[0] as usize * size[1] as usize;
    let channels = channels.iter().map(|channel| exr_channel(channel, pixels)).collect::<Result<_, _>>()?;
    encode_channels(size, channels, attributes.iter().map(|(name, text)| (name.clone(), text.clone())).collect())
}

fn exr_channel(channel: &NamedChannel<'_>, pixels: usize) -> Result<AnyChannel<FlatSamples>, FilmError> {
    let NamedChannel { name, values, precision } = *channel;
    if values.len() != pixels {
        return Err(write_error(format!("channel `{name}` has {} values for {pixels} pixels", values.len())));
    }
    match precision {
        Precision::Float => Ok(floats(name, values.iter().copied())),
        Precision::Half => match values.iter().find(|v| !f16::from_f32(**v).is_finite()) {
            Some(value) => {
                Err(write_error(format!("channel `{name}` has the value {value}, which does not fit in 16 bits")))
            }
            None => {
                let halves = values.iter().map(|&value| f16::from_f32(value)).collect();
                Ok(AnyChannel::new(name, FlatSamples::F16(halves)))
            }
        },
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::exr::decode_channels;
    use std::io::Cursor;

    fn half<'a>(name: &'a str, values: &'a [f32]) -> NamedChannel<'a> {
        NamedChannel { name, values, precision: Precision::Half }
    }

    #[test]
    fn channels_come_back_by_name_as_precisely_as_they_were_stored() {
        let fine = [1.0, 1.000_1, 0.1, 70_000.0];
        let coarse = [1.0, 1.000_1, 0.1, 65_504.0];
        let channels =
            [half("full.R", &coarse), NamedChannel { name: "depth.Z", values: &fine, precision: Precision::Float }];
        let texts = BTreeMap::from([("femc:spp".to_owned(), "4".to_owned())]);

        let bytes = encode_named_channels([2, 2], &channels, &texts).unwrap();
        let (width, height, [depth, full]) = decode_channels(Cursor::new(&bytes), ["depth.Z", "full.R"]).unwrap();

        assert_eq!((width, height), (2, 2));
        assert_eq!(depth, fine);
        assert_eq!(full, [1.0, 1.0, 0.099_975_586, 65_504.0]);
        assert_eq!(bytes, encode_named_channels([2, 2], &channels, &texts).unwrap());
    }

    #[test]
    fn values_too_few_or_too_large_are_refused_by_name() {
        let texts = BTreeMap::new();
        let refused =
            |values: &[f32]| encode_named_channels([2, 1], &[half("full.G", values)], &texts).unwrap_err().to_string();
        assert!(refused(&[1.0]).contains("`full.G` has 1 values for 2 pixels"), "{}", refused(&[1.0]));
        assert!(refused(&[1.0, 65_520.0]).contains("65520"), "{}", refused(&[1.0, 65_520.0]));
        assert!(refused(&[f32::NAN, 0.0]).contains("NaN"), "{}", refused(&[f32::NAN, 0.0]));
    }
}
