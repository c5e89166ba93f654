//! Reader of LM-63 photometric files \[lm63\]: the editions of 1986, 1991, 1995, 2002 and 2019, types A, B and C.
//!
//! The lines up to `TILT=` name the edition ([`header`]). The rest is numbers in free form. The angle lists stay as in the file: a
//! file may cover a quadrant, a half or the whole sphere, and the photometry type defines the symmetry. Candela values are
//! multiplied by the file's multiplier and the factors of its edition. Data slightly outside the standard that has one clear
//! meaning is accepted with a warning. Anything that would make the luminous flux differ from the integral of the table is an
//! error.

mod angles;
mod commas;
mod edition;
mod fields;
mod flux;
mod header;
mod hints;
mod numbers;
mod opening;

use crate::{ImportError, ImportFault, Position};
use commas::read_numbers;
use femc_scene::{Location, Photometry};
use fields::{Fields, MAX_ANGLES};
use header::Header;
use numbers::Numbers;
use std::{borrow::Cow, sync::Arc};

/// A photometric file as read.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct PhotometricFile {
    /// Photometry, without its location in a scene.
    pub photometry: Photometry,
    /// Dependence of the lamp's output on the luminaire's tilt.
    pub tilt: Option<Tilt>,
    /// Warnings and notes about the data.
    pub remarks: Remarks,
    /// Hint that the file may be normalized to 1000 lm, for a lamp that no scene scales.
    pub normalization_hint: Option<Remark>,
}

/// A position and a sentence.
pub(crate) type Remark = (Position, Cow<'static, str>);

/// Warnings and notes of a file.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Remarks {
    pub warnings: Vec<Remark>,
    pub notes: Vec<Remark>,
}

impl Remarks {
    fn warn(&mut self, at: Position, text: impl Into<Cow<'static, str>>) {
        self.warnings.push((at, text.into()));
    }

    fn note(&mut self, at: Position, text: impl Into<Cow<'static, str>>) {
        self.notes.push((at, text.into()));
    }

    fn append(&mut self, mut other: Self) {
        self.warnings.append(&mut other.warnings);
        self.notes.append(&mut other.notes);
    }
}

/// Output factors by tilt.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Tilt {
    /// Angles from the orientation during the measurement, degrees, strictly ascending.
    pub angles: Vec<f64>,
    /// Factors on the intensities.
    pub factors: Vec<f64>,
}

impl Tilt {
    /// Returns the factor at `angle` degrees: linear between the listed angles, constant outside.
    pub fn factor(&self, angle: f64) -> f64 {
        let after = self.angles.partition_point(|&a| a <= angle);
        match (after.checked_sub(1), self.angles.get(after)) {
            (Some(i), Some(next)) => {
                let f = (angle - self.angles[i]) / (next - self.angles[i]);
                self.factors[i] * (1.0 - f) + self.factors[after] * f
            }
            (Some(i), None) => self.factors[i],
            (None, _) => self.factors[0],
        }
    }
}

/// Path and text of a file named in the text.
pub(crate) type NamedFile = Result<(String, Arc<Vec<u8>>), ImportFault>;

/// Parses the decoded text of a file. `open` returns the tilt file that the text names.
pub(crate) fn parse(
    path: &str,
    text: &[u8],
    open: &mut dyn FnMut(&str) -> NamedFile,
) -> Result<PhotometricFile, ImportError> {
    let mut remarks = Remarks::default();
    let header = Header::read(path, text, &mut remarks)?;
    let included = header.tilt.eq_ignore_ascii_case("INCLUDE");
    let named_tilt = match &*header.tilt {
        name if included || name.eq_ignore_ascii_case("NONE") => None,
        "" => {
            let (path, reason) = (path.to_owned(), "`TILT=` has no value".into());
            let fault = ImportFault::BadFile {
                path,
                reason,
                advice: "write `TILT=NONE`, `TILT=INCLUDE` or the name of a file",
            };
            return Err(ImportError::new(header.tilt_at, fault));
        }
        name => {
            let (path, text) = open(name).map_err(|fault| ImportError::new(header.tilt_at.clone(), fault))?;
            Some(read_numbers(&path, &text, 1, |numbers| {
                let tilt = tilt(numbers)?;
                numbers.finish("tilt factor").map(|()| tilt)
            })?)
        }
    };
    let (included_tilt, photometry, fields, more) =
        read_numbers(path, header.rest, header.tilt_at.line + 1, |numbers| {
            let mut remarks = Remarks::default();
            let tilt = if included { Some(tilt(numbers)?) } else { None };
            let fields = Fields::read(&header, numbers, &mut remarks)?;
            let photometry = photometry(path, &fields, numbers, &mut remarks)?;
            numbers.finish("intensity")?;
            Ok((tilt, photometry, fields, remarks))
        })?;
    remarks.append(more);
    let lumens = flux::lumens(&photometry);
    remarks.warnings.extend(hints::no_light(&fields, lumens));
    remarks.notes.extend(hints::excess_flux_remark(&fields, lumens));
    let normalization_hint = hints::normalization_hint(&fields, lumens);
    Ok(PhotometricFile { photometry, tilt: included_tilt.or(named_tilt), remarks, normalization_hint })
}

fn tilt(numbers: &mut Numbers<'_>) -> Result<Tilt, ImportError> {
    numbers.whole_number("lamp-to-luminaire geometry", 1.0, 3.0, "1, 2 or 3")?;
    let count = numbers.whole_number("number of tilt angles", 1.0, MAX_ANGLES, "a whole number in [1, 100000]")?;
    let angles = numbers.ascending_numbers(
        count,
        "tilt angle",
        -180.0,
        180.0,
        "in [-180, 180] and greater than the previous angle",
    )?;
    let factors =
        (0..count).map(|_| numbers.number_in("tilt factor", ">= 0", |x| x >= 0.0)).collect::<Result<_, _>>()?;
    Ok(Tilt { angles, factors })
}

fn photometry(
    path: &str,
    fields: &Fields,
    numbers: &mut Numbers<'_>,
    remarks: &mut Remarks,
) -> Result<Photometry, ImportError> {
    let kind = fields.kind;
    let vertical = angles::vertical(numbers, kind, fields.vertical, remarks)?;
    let (horizontal, wrap) = angles::horizontal(numbers, kind, fields.horizontal, remarks)?;
    let mut candela = intensities(numbers, fields.vertical * fields.horizontal, fields.factor(), remarks)?;
    if wrap {
        candela.extend_from_within(..fields.vertical);
    }
    let (path, opening) = (path.to_owned(), fields.opening);
    Ok(Photometry { path, kind, vertical, horizontal, candela, opening, location: Location::default() })
}

fn intensities(
    numbers: &mut Numbers<'_>,
    count: usize,
    factor: f64,
    remarks: &mut Remarks,
) -> Result<Vec<f64>, ImportError> {
    let mut negative = None;
    // No memory is reserved, because the count is only a claim of the file.
    let mut candela = Vec::new();
    for _ in 0..count {
        let value = numbers.number("intensity (cd)")? * factor;
        if !value.is_finite() {
            return Err(ImportError::new(
                numbers.position(),
                ImportFault::NotFinite { what: "intensity (cd) multiplied by its factors" },
            ));
        }
        if value < 0.0 {
            negative.get_or_insert_with(|| numbers.position());
        }
        candela.push(value.max(0.0));
    }
    if let Some(at) = negative {
        remarks.warn(at, "negative intensities are treated as 0");
    }
    Ok(candela)
}

#[cfg(test)]
mod tests;
