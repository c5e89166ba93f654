//! LM-63 photometric files \[lm63\]: the variants of 1986, 1991, 1995, 2002 and 2019, types A, B and C.
//!
//! Keyword lines up to `TILT=` are read over; all that follows is numbers in free form. The angle lists stay as the file has
//! them (a file may cover a quadrant, a half or the whole sphere: the symmetry is the photometry type's); candela values
//! get the file's multiplier and ballast factors. Data a little outside the standard with one clear meaning is taken
//! with a warning.

mod numbers;

use crate::{Fault, ImportError, Position};
use femc_scene::{Location, Opening, Photometry, PhotometryType};
use numbers::Numbers;
use std::sync::Arc;

/// Most angles of one list.
const MAX_ANGLES: f64 = 100_000.0;
const FOOT: f64 = 0.3048;

/// A file as read.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Luminaire {
    /// Without its place in a scene.
    pub photometry: Photometry,
    /// How the lamp's output depends on the luminaire's tilt.
    pub tilt: Option<Tilt>,
    /// What was odd.
    pub oddities: Vec<(Position, &'static str)>,
}

/// Output factors by tilt.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Tilt {
    /// Degrees from the position of the measurement, strictly ascending.
    pub angles: Vec<f64>,
    /// Factors on the intensities.
    pub factors: Vec<f64>,
}

impl Tilt {
    /// The factor at `angle` degrees: linear between the angles of the list, constant outside.
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

/// Path and text of the file that a name in the text stands for.
pub(crate) type Named = Result<(String, Arc<Vec<u8>>), Fault>;

/// Reads a file. `open` gives the text of the tilt file that it names.
pub(crate) fn parse(path: &str, text: &[u8], open: &mut dyn FnMut(&str) -> Named) -> Result<Luminaire, ImportError> {
    let (tilt_at, spec, rest) = tilt_line(path, text)?;
    let mut numbers = Numbers { file: path, rest, line: tilt_at.line + 1, column: 1 };
    let tilt = match spec.to_ascii_uppercase().as_str() {
        "NONE" => None,
        "INCLUDE" => Some(tilt(&mut numbers)?),
        _ => {
            let (path, text) = open(&spec).map_err(|fault| ImportError::new(tilt_at, fault))?;
            Some(tilt(&mut Numbers { file: &path, rest: &text, line: 1, column: 1 })?)
        }
    };
    let mut oddities = Vec::new();
    let photometry = photometry(path, &mut numbers, &mut oddities)?;
    if numbers.token().is_some() {
        oddities.push((numbers.here(), "text after the last intensity is not used"));
    }
    Ok(Luminaire { photometry, tilt, oddities })
}

/// The place and value of `TILT=`, and the text after that line.
fn tilt_line<'t>(path: &str, text: &'t [u8]) -> Result<(Position, String, &'t [u8]), ImportError> {
    let (mut rest, mut line) = (text, 0);
    while !rest.is_empty() {
        let end = rest.iter().position(|&byte| byte == b'\n');
        let this = rest[..end.unwrap_or(rest.len())].trim_ascii();
        rest = end.map_or(&[], |end| &rest[end + 1..]);
        line += 1;
        if this.len() >= 4
            && this[..4].eq_ignore_ascii_case(b"TILT")
            && let Some(value) = this[4..].trim_ascii_start().strip_prefix(b"=")
        {
            let at = Position { file: path.to_owned(), line, column: 1 };
            return Ok((at, String::from_utf8_lossy(value.trim_ascii()).into_owned(), rest));
        }
    }
    let fault = Fault::BadFile {
        path: path.to_owned(),
        reason: "it has no TILT= line".into(),
        advice: "is it an IES (LM-63) file?",
    };
    Err(ImportError::new(Position { file: path.to_owned(), line: line.max(1), column: 0 }, fault))
}

fn tilt(numbers: &mut Numbers<'_, '_>) -> Result<Tilt, ImportError> {
    numbers.whole("lamp-to-luminaire geometry", 1.0, 3.0, "1, 2 or 3")?;
    let count = numbers.whole("number of tilt angles", 1.0, MAX_ANGLES, "a whole number in [1, 100000]")?;
    let angles = numbers.ascending(count, "tilt angle", -180.0, 180.0, "in [-180, 180] and above the one before it")?;
    let factors =
        (0..count).map(|_| numbers.number_in("tilt factor", ">= 0", |x| x >= 0.0)).collect::<Result<_, _>>()?;
    Ok(Tilt { angles, factors })
}

fn photometry(
    path: &str,
    numbers: &mut Numbers<'_, '_>,
    oddities: &mut Vec<(Position, &'static str)>,
) -> Result<Photometry, ImportError> {
    numbers.number_in("number of lamps", ">= 0", |x| x >= 0.0)?;
    numbers.number("lumens per lamp")?;
    let multiplier = numbers.number_in("candela multiplier", ">= 0", |x| x >= 0.0)?;
    let angles = "a whole number in [1, 100000]";
    let vertical_count = numbers.whole("number of vertical angles", 1.0, MAX_ANGLES, angles)?;
    let horizontal_count = numbers.whole("number of horizontal angles", 1.0, MAX_ANGLES, angles)?;
    let kind = match numbers.whole("photometric type", 1.0, 3.0, "1 (C), 2 (B) or 3 (A)")? {
        1 => PhotometryType::C,
        2 => PhotometryType::B,
        _ => PhotometryType::A,
    };
    let unit = match numbers.whole("units", 1.0, 2.0, "1 (feet) or 2 (metres)")? {
        1 => FOOT,
        _ => 1.0,
    };
    let mut size = [0.0; 3];
    for (value, what) in size.iter_mut().zip(["width", "length", "height"]) {
        *value = numbers.number(what)? * unit;
    }
    let (opening, odd) = opening(size);
    oddities.extend(odd.map(|odd| (numbers.here(), odd)));
    let ballast = numbers.number_in("ballast factor", "> 0", |x| x > 0.0)?;
    let mut ballast_lamp = numbers.number_in("ballast-lamp factor", ">= 0", |x| x >= 0.0)?;
    if ballast_lamp == 0.0 {
        oddities.push((numbers.here(), "ballast-lamp factor (a spare field since 1995) is 0: taken as 1"));
        ballast_lamp = 1.0;
    }
    numbers.number("input watts")?;
    let vertical = vertical_angles(numbers, kind, vertical_count, oddities)?;
    let (horizontal, wrap) = horizontal_angles(numbers, kind, horizontal_count, oddities)?;
    let factor = multiplier * ballast * ballast_lamp;
    let mut candela = intensities(numbers, vertical_count * horizontal_count, factor, oddities)?;
    if wrap {
        candela.extend_from_within(..vertical_count);
    }
    let path = path.to_owned();
    Ok(Photometry { path, kind, vertical, horizontal, candela, opening, location: Location::default() })
}

fn vertical_angles(
    numbers: &mut Numbers<'_, '_>,
    kind: PhotometryType,
    count: usize,
    oddities: &mut Vec<(Position, &'static str)>,
) -> Result<Vec<f64>, ImportError> {
    let what = "vertical angle";
    let (angles, whole) = match kind {
        PhotometryType::C => {
            let angles = numbers.ascending(count, what, 0.0, 180.0, "in [0, 180] and above the one before it")?;
            let whole = matches!(angles[..], [0.0 | 90.0, .., 90.0 | 180.0]);
            (angles, whole)
        }
        PhotometryType::A | PhotometryType::B => {
            let angles = numbers.ascending(count, what, -90.0, 90.0, "in [-90, 90] and above the one before it")?;
            let whole = matches!(angles[..], [-90.0 | 0.0, .., 90.0]);
            (angles, whole)
        }
    };
    if !whole {
        oddities.push((numbers.here(), "vertical angles do not cover a quadrant or a half: used as they stand"));
    }
    Ok(angles)
}

/// The angles, and whether 360 was added to close the circle.
fn horizontal_angles(
    numbers: &mut Numbers<'_, '_>,
    kind: PhotometryType,
    count: usize,
    oddities: &mut Vec<(Position, &'static str)>,
) -> Result<(Vec<f64>, bool), ImportError> {
    let what = "horizontal angle";
    if let PhotometryType::A | PhotometryType::B = kind {
        let angles = numbers.ascending(count, what, -90.0, 90.0, "in [-90, 90] and above the one before it")?;
        if !matches!(angles[..], [0.0] | [-90.0 | 0.0, .., 90.0]) {
            oddities.push((numbers.here(), "horizontal angles do not cover a quadrant or a half: used as they stand"));
        }
        return Ok((angles, false));
    }
    let mut angles = numbers.ascending(count, what, 0.0, 360.0, "in [0, 360] and above the one before it")?;
    let mut wrap = false;
    match angles[..] {
        [_] | [0.0, .., 90.0 | 180.0 | 360.0] | [90.0, .., 270.0] => {}
        [0.0, .., last] if last > 180.0 => {
            oddities.push((numbers.here(), "horizontal angles stop short of 360: the first plane closes the circle"));
            angles.push(360.0);
            wrap = true;
        }
        _ => oddities.push((numbers.here(), "horizontal angles do not end at 0, 90, 180 or 360: used as they stand")),
    }
    Ok((angles, wrap))
}

fn intensities(
    numbers: &mut Numbers<'_, '_>,
    count: usize,
    factor: f64,
    oddities: &mut Vec<(Position, &'static str)>,
) -> Result<Vec<f64>, ImportError> {
    let mut negative = None;
    // Not reserved: the count is the file's claim.
    let mut candela = Vec::new();
    for _ in 0..count {
        let value = numbers.number("intensity (cd)")? * factor;
        if !value.is_finite() {
            return Err(ImportError::new(
                numbers.here(),
                Fault::NotFinite { what: "intensity (cd) times its factors" },
            ));
        }
        if value < 0.0 {
            negative.get_or_insert_with(|| numbers.here());
        }
        candela.push(value.max(0.0));
    }
    oddities.extend(negative.map(|at| (at, "negative intensities are taken as 0")));
    Ok(candela)
}

/// The luminous opening of width (y), length (x) and height, metres; negative sizes are diameters of round shapes.
/// Round shapes that the description lacks become their box or their mean, with a remark.
fn opening([width, length, height]: [f64; 3]) -> (Opening, Option<&'static str>) {
    let boxed = Opening::Box { width: width.abs(), length: length.abs(), height: height.abs() };
    let flat = [width, length, height].iter().filter(|&&x| x != 0.0).count();
    match (width < 0.0, length < 0.0, height < 0.0) {
        _ if flat == 0 => (Opening::Point, None),
        (false, false, false) if flat == 1 => (Opening::Point, Some("luminous opening is a line: taken as a point")),
        (false, false, false) => (boxed, None),
        // Old files give a circle by one negative size, newer ones by both.
        (true, true, _) | (true, false, false) | (false, true, false) if width * length >= 0.0 => {
            let (a, b) = (width.abs(), length.abs());
            let diameter = if a == 0.0 || b == 0.0 { a.max(b) } else { (a * b).sqrt() };
            let ellipse = a != b && a != 0.0 && b != 0.0;
            if height >= 0.0 {
                let remark = ellipse.then_some("elliptic luminous opening: taken as the circle of its area");
                return (Opening::Cylinder { diameter, height }, remark);
            }
            let sphere = !ellipse && -height == diameter;
            let remark = (!sphere).then_some("ellipsoidal luminous opening: taken as the sphere of its volume");
            let diameter = femc_math::elementary::double::cbrt(diameter * diameter * -height);
            (Opening::Sphere { diameter }, remark)
        }
        _ if flat == 1 => (Opening::Point, Some("luminous opening is a line: taken as a point")),
        _ => (boxed, Some("lying round luminous opening: taken as the box around it")),
    }
}

#[cfg(test)]
mod tests;
