//! Reader of the numbers above the angles: one group of 10 and one of 3.

use super::{
    Remarks,
    edition::{SecondFactor, is_generation_type},
    header::{EditionSource, Header},
    numbers::Numbers,
    opening::opening,
};
use crate::{ImportError, Position};
use femc_scene::{Opening, PhotometryType};

/// Maximum number of angles in a list.
pub(super) const MAX_ANGLES: f64 = 100_000.0;
const FOOT: f64 = 0.3048;

/// Numbers above the angles that femc uses.
pub(super) struct Fields {
    pub lamps: f64,
    /// Lumens per lamp; negative in absolute photometry.
    pub lumens: f64,
    pub lumens_at: Position,
    pub multiplier: f64,
    /// Product of the ballast factors.
    pub ballast: f64,
    pub vertical: usize,
    pub horizontal: usize,
    pub kind: PhotometryType,
    pub opening: Opening,
}

impl Fields {
    pub fn read(header: &Header<'_>, numbers: &mut Numbers<'_>, remarks: &mut Remarks) -> Result<Self, ImportError> {
        numbers.peek_field();
        let lamps_at = numbers.position();
        let lamps = numbers.number_in("number of lamps", ">= 0", |x| x >= 0.0)?;
        if lamps < 1.0 || lamps != lamps.trunc() {
            remarks.warn(
                lamps_at,
                format!(
                    "number of lamps is {lamps}; it should be a whole number of at least 1 (the value is not used)"
                ),
            );
        }
        numbers.peek_field();
        let lumens_at = numbers.position();
        let lumens = numbers.number("lumens per lamp")?;
        if lumens <= 0.0 && lumens != -1.0 {
            let what = format!(
                "lumens per lamp is {lumens}; it should be positive, or -1 for absolute photometry (the value is not used)"
            );
            remarks.warn(lumens_at.clone(), what);
        }
        let multiplier = numbers.number_in("candela multiplier", "> 0", |x| x > 0.0)?;
        // A table with a single vertical angle covers no solid angle, so the lamp would emit no light.
        let [two, one] = ["a whole number in [2, 100000]", "a whole number in [1, 100000]"];
        let vertical = numbers.whole_number("number of vertical angles", 2.0, MAX_ANGLES, two)?;
        let horizontal = numbers.whole_number("number of horizontal angles", 1.0, MAX_ANGLES, one)?;
        let kind = match numbers.whole_number("photometric type", 1.0, 3.0, "1 (C), 2 (B) or 3 (A)")? {
            1 => PhotometryType::C,
            2 => PhotometryType::B,
            _ => PhotometryType::A,
        };
        let unit = match numbers.whole_number("units", 1.0, 2.0, "1 (feet) or 2 (meters)")? {
            1 => FOOT,
            _ => 1.0,
        };
        numbers.peek_field();
        let size_at = numbers.position();
        let mut size = [0.0; 3];
        for (value, what) in size.iter_mut().zip(["width", "length", "height"]) {
            *value = numbers.number(what)? * unit;
        }
        let (opening, odd) = opening(header.edition, size);
        if let Some(odd) = odd {
            remarks.warn(size_at, odd);
        }
        let ballast = numbers.number_in("ballast factor", "> 0", |x| x > 0.0)?;
        let ballast = ballast * second_factor(header, numbers, remarks)?;
        numbers.number("input watts")?;
        Ok(Self { lamps, lumens, lumens_at, multiplier, ballast, vertical, horizontal, kind, opening })
    }

    /// Returns the factor on the intensities of the file.
    pub fn factor(&self) -> f64 {
        self.multiplier * self.ballast
    }
}

/// Reads the field after the ballast factor. Returns its value if it is a factor in this edition, and 1 otherwise.
fn second_factor(header: &Header<'_>, numbers: &mut Numbers<'_>, remarks: &mut Remarks) -> Result<f64, ImportError> {
    numbers.peek_field();
    let at = numbers.position();
    let year = header.edition.year();
    if let EditionSource::Unclear { line } = &header.edition_source {
        let mut ahead = numbers.clone();
        let value = ahead.number("field after the ballast factor")?;
        if value != 1.0 {
            let reason = format!(
                "the field after the ballast factor is {value}; only the editions of 1986 and 1991 use it as a factor, and `{line}` does \
                 not name a known edition"
            );
            return Err(numbers.bad_file(reason, "name the edition in the first line, as in `IESNA:LM-63-2002`"));
        }
    }
    match header.edition.second_factor() {
        SecondFactor::BallastLamp => {
            let factor = numbers.number_in("ballast-lamp factor", ">= 0", |x| x >= 0.0)?;
            if factor == 0.0 {
                remarks.warn(at, "ballast-lamp factor is 0: treated as 1");
                return Ok(1.0);
            }
            if factor != 1.0 && header.edition_source == (EditionSource::Nowhere { keywords: true }) {
                let what = format!(
                    "ballast-lamp factor {factor} is applied: no line names an edition, so the file is read as the edition of 1986, but \
                     its keywords are newer; name the edition in the first line"
                );
                remarks.warn(at, what);
            }
            Ok(factor)
        }
        SecondFactor::Reserved => {
            let value = numbers.number("field after the ballast factor")?;
            if value != 1.0 {
                let what = format!(
                    "the field after the ballast factor is {value}: the edition of {year} reserves it, so it is not used (in files of \
                     1986 and 1991 it is a factor)"
                );
                remarks.warn(at, what);
            }
            Ok(1.0)
        }
        SecondFactor::GenerationType => {
            let code = numbers.number("file generation type")?;
            if !is_generation_type(code) {
                let what =
                    format!("file generation type {code} is not a code of the edition of {year}; it is not used");
                remarks.note(at, what);
            }
            Ok(1.0)
        }
    }
}
