use std::str::FromStr;

/// `--set SELECTOR=VALUE`: a scalar of the scene and its new value. The selector can only be checked with the scene.
#[derive(Clone, Debug, PartialEq)]
pub struct Override {
    /// Selector, `medium.fog.sigma_s`.
    pub selector: String,
    /// New value, finite.
    pub value: f64,
}

/// Error of a text that is not an override.
#[derive(Debug, PartialEq, Eq, thiserror::Error)]
pub enum OverrideError {
    /// The text has no `=`, or nothing before it.
    #[error("write SELECTOR=VALUE, like medium.fog.sigma_s=0.03")]
    InvalidFormat,
    /// The value is not a finite number.
    #[error("`{0}` is not a finite number; write SELECTOR=VALUE, like medium.fog.sigma_s=0.03")]
    Value(String),
}

impl FromStr for Override {
    type Err = OverrideError;

    fn from_str(text: &str) -> Result<Self, OverrideError> {
        let (selector, value) = text.split_once('=').ok_or(OverrideError::InvalidFormat)?;
        let (selector, value) = (selector.trim(), value.trim());
        if selector.is_empty() {
            return Err(OverrideError::InvalidFormat);
        }
        match value.parse::<f64>() {
            Ok(number) if number.is_finite() => Ok(Self { selector: selector.to_owned(), value: number }),
            _ => Err(OverrideError::Value(value.to_owned())),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_override_is_a_selector_and_a_number() {
        let expected = Override { selector: "medium.fog.sigma_s".to_owned(), value: 0.03 };
        assert_eq!("medium.fog.sigma_s=0.03".parse(), Ok(expected));
        assert_eq!("object.car.hidden = 1".parse::<Override>().map(|o| o.value), Ok(1.0));
    }

    #[test]
    fn half_an_override_is_refused() {
        assert_eq!("fog".parse::<Override>(), Err(OverrideError::InvalidFormat));
        assert_eq!("=3".parse::<Override>(), Err(OverrideError::InvalidFormat));
        for value in ["", "much", "NaN", "inf"] {
            assert_eq!(format!("a.b.c={value}").parse::<Override>(), Err(OverrideError::Value(value.to_owned())));
        }
    }
}
