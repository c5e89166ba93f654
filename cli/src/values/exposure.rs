//! Exposure of a picture of a frame.

use femc_film::{Image, LuminanceLevels, ToneCurve};
use std::fmt;
use std::str::FromStr;

/// Value of middle gray, before the tone curve.
const MIDDLE_GRAY: f64 = 0.18;
/// Mean luminance for EV 0 at ISO 100, cd/m2: K / 100 with the K = 12.5 of light meters.
const EV_ZERO: f64 = 0.125;

/// A requested exposure.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum Exposure {
    /// The log-average luminance becomes middle gray.
    #[default]
    Auto,
    /// Exposure value at ISO 100: a luminance of 2^EV / 8 cd/m2 becomes middle gray, and each step up halves the picture's light.
    Ev(f64),
}

impl Exposure {
    /// Returns the tone curve for frames with these levels.
    pub fn curve(self, levels: &LuminanceLevels) -> ToneCurve {
        match self {
            Self::Auto => ToneCurve::from_levels(levels),
            Self::Ev(ev) => ToneCurve { exposure: (MIDDLE_GRAY / (EV_ZERO * ev.exp2())) as f32 },
        }
    }

    /// Returns the tone curve for one frame.
    pub fn curve_of(self, image: &Image) -> ToneCurve {
        self.curve(&LuminanceLevels::from_image(image))
    }
}

/// Returns the exposure value of a curve.
pub fn ev(curve: ToneCurve) -> f64 {
    (MIDDLE_GRAY / (EV_ZERO * f64::from(curve.exposure))).log2()
}

impl FromStr for Exposure {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        if text == "auto" {
            return Ok(Self::Auto);
        }
        match text.parse::<f64>() {
            Ok(ev) if (-20.0..=40.0).contains(&ev) => Ok(Self::Ev(ev)),
            _ => Err(format!("`{text}` is not an exposure; write auto, or an exposure value from -20 to 40, like 7.5")),
        }
    }
}

impl fmt::Display for Exposure {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Auto => f.write_str("auto"),
            Self::Ev(ev) => write!(f, "{ev}"),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn fixed_exposure_maps_to_middle_gray_and_auto_reports_its_ev() {
        let curve = Exposure::Ev(7.0).curve(&LuminanceLevels::default());
        assert!((f64::from(curve.exposure) * 16.0 - MIDDLE_GRAY).abs() < 1e-6, "EV 7 is for 16 cd/m2");
        assert!((ev(curve) - 7.0).abs() < 1e-6);
        let auto = Exposure::Auto.curve_of(&Image::filled(4, 4, [16.0; 3]));
        assert!((ev(auto) - 7.0).abs() < 0.1, "{}", ev(auto));
    }

    #[test]
    fn exposures_are_auto_or_a_number_and_read_back_what_they_show() {
        for text in ["auto", "-3", "7.5"] {
            assert_eq!(text.parse::<Exposure>().map(|exposure| exposure.to_string()), Ok(text.to_owned()));
        }
        for text in ["", "bright", "nan", "inf", "1e9"] {
            assert!(text.parse::<Exposure>().is_err_and(|error| error.contains("write auto")), "{text}");
        }
    }
}
