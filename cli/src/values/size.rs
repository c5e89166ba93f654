use serde::Deserialize;
use serde::de::{Deserializer, Error as _};
use std::str::FromStr;

/// Largest film side in pixels: the scene format's limit for textures, also used for films.
const LARGEST: u32 = 32768;

/// A film size, `320x180`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Size {
    /// Pixels per row, 1..=32768.
    pub width: u32,
    /// Rows, 1..=32768.
    pub height: u32,
}

/// Error of a text that is not a film size.
#[derive(Debug, PartialEq, Eq, thiserror::Error)]
pub enum SizeError {
    /// The text does not consist of two numbers.
    #[error("`{0}` is not a film size; write width x height in pixels, like 320x180")]
    InvalidFormat(String),
    /// A side is zero or too large.
    #[error("each side of a film must have 1 to {LARGEST} pixels")]
    Range,
}

impl FromStr for Size {
    type Err = SizeError;

    fn from_str(text: &str) -> Result<Self, SizeError> {
        let wrong = || SizeError::InvalidFormat(text.to_owned());
        let (width, height) = text.split_once(['x', 'X']).ok_or_else(wrong)?;
        let side = |text: &str| text.parse::<u32>().map_err(|_| wrong());
        let size = Self { width: side(width)?, height: side(height)? };
        let fits = |side: u32| (1..=LARGEST).contains(&side);
        if fits(size.width) && fits(size.height) { Ok(size) } else { Err(SizeError::Range) }
    }
}

impl<'de> Deserialize<'de> for Size {
    fn deserialize<D: Deserializer<'de>>(from: D) -> Result<Self, D::Error> {
        String::deserialize(from)?.parse().map_err(D::Error::custom)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_size_is_width_then_height() {
        assert_eq!("320x180".parse(), Ok(Size { width: 320, height: 180 }));
        assert_eq!("1X1".parse(), Ok(Size { width: 1, height: 1 }));
    }

    #[test]
    fn what_is_no_film_is_refused() {
        for text in ["", "320", "x", "320x", "-1x5", "3.5x4", "1x2x3"] {
            assert_eq!(text.parse::<Size>(), Err(SizeError::InvalidFormat(text.to_owned())), "{text}");
        }
        assert_eq!("0x4".parse::<Size>(), Err(SizeError::Range));
        assert_eq!("4x32769".parse::<Size>(), Err(SizeError::Range));
    }
}
