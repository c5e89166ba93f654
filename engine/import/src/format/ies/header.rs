//! Reader of the lines above the numbers: the edition, keywords, and `TILT=`.

use super::{Remarks, edition::Edition};
use crate::{ImportError, ImportFault, Position, text::excerpt};

/// Source of a file's edition.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum EditionSource {
    /// A line that names the edition.
    Line,
    /// No line names an edition, so the file is of 1986. That edition had no keywords yet.
    Nowhere {
        /// Whether the file has keyword lines.
        keywords: bool,
    },
    /// A line that names LM-63, but no existing edition.
    Unclear {
        /// Start of the line.
        line: String,
    },
}

/// Content of the lines above the numbers.
pub(super) struct Header<'t> {
    /// Edition; 2002 if the header is unclear. The openings of 2002 and 2019 have the same shapes.
    pub edition: Edition,
    pub edition_source: EditionSource,
    /// Position and value of `TILT=`.
    pub tilt_at: Position,
    pub tilt: String,
    /// Text after that line.
    pub rest: &'t [u8],
}

impl<'t> Header<'t> {
    pub fn read(path: &str, text: &'t [u8], remarks: &mut Remarks) -> Result<Self, ImportError> {
        let place = |line, column| Position { file: path.to_owned(), line, column };
        let (mut rest, mut line) = (text, 0);
        let mut first_text = true;
        let mut keywords = false;
        let mut known_edition: Option<(Edition, EditionSource)> = None;
        while !rest.is_empty() {
            let end = rest.iter().position(|&byte| byte == b'\n').unwrap_or(rest.len());
            let this = without_mark(rest[..end].trim_ascii()).trim_ascii();
            rest = rest.get(end + 1..).unwrap_or_default();
            line += 1;
            if let Some(tilt) = tilt_value(this) {
                let (edition, edition_source) =
                    known_edition.unwrap_or((Edition::E1986, EditionSource::Nowhere { keywords }));
                let tilt = String::from_utf8_lossy(tilt).into_owned();
                return Ok(Self { edition, edition_source, tilt_at: place(line, 1), tilt, rest });
            }
            keywords |= this.starts_with(b"[");
            let year = if known_edition.is_none() { edition_year(this) } else { None };
            // Below the first line, a mention of LM-63 without a year is a label.
            if let Some(year) = year.filter(|year| first_text || year.is_some()) {
                let shown = excerpt(this);
                let read = year.and_then(Edition::from_year);
                if let Some(edition) = read.filter(|edition| Some(edition.year()) != year) {
                    let year = edition.year();
                    remarks.warn(
                        place(line, 1),
                        format!("`{shown}` is not a known edition: read as the edition of {year}"),
                    );
                }
                if let (Some(edition), false) = (read, first_text) {
                    let year = edition.year();
                    remarks.warn(
                        place(line, 1),
                        format!("the edition is not in the first line: read as the edition of {year}"),
                    );
                }
                let unclear = (Edition::E2002, EditionSource::Unclear { line: shown });
                known_edition = Some(read.map_or(unclear, |edition| (edition, EditionSource::Line)));
            }
            first_text &= this.is_empty();
        }
        let fault = ImportFault::BadFile {
            path: path.to_owned(),
            reason: "the file has no TILT= line".into(),
            advice: "check that it is an IES (LM-63) file",
        };
        Err(ImportError::new(place(line.max(1), 0), fault))
    }
}

/// Removes a byte order mark. Programs that join texts may leave one before any line.
fn without_mark(line: &[u8]) -> &[u8] {
    line.strip_prefix(b"\xef\xbb\xbf").unwrap_or(line)
}

fn tilt_value(line: &[u8]) -> Option<&[u8]> {
    let (name, value) = line.split_at_checked(4)?;
    let value = value.trim_ascii_start().strip_prefix(b"=")?;
    name.eq_ignore_ascii_case(b"TILT").then(|| value.trim_ascii())
}

/// Returns the year of a line that names an edition: `None` for other lines, `Some(None)` for a line that names LM-63 without a
/// year.
fn edition_year(line: &[u8]) -> Option<Option<u32>> {
    let skip = |text: &str| text.trim_start_matches([' ', '\t', ':', '-', '_', '/', '.']).to_owned();
    let text = String::from_utf8_lossy(line).to_ascii_uppercase();
    let text = text.strip_prefix("ANSI").map_or(text.clone(), skip);
    let society = text.strip_prefix("IESNA").or(text.strip_prefix("IES")).map(skip);
    let (has_society, text) = (society.is_some(), society.unwrap_or(text));
    let standard = text.strip_prefix("LM").map(skip).and_then(|text| text.strip_prefix("63").map(skip));
    let (has_standard, text) = (standard.is_some(), standard.unwrap_or(text));
    let digits = text.bytes().take_while(u8::is_ascii_digit).count();
    let number = text[..digits].parse().ok();
    let year = match (digits, number) {
        (4, year) => year,
        (2, Some(year)) => Some(if year < 86 { 2000 + year } else { 1900 + year }),
        _ => None,
    };
    if has_standard {
        return Some(year);
    }
    // `IESNA91` alone is the line of that edition. Other text after the society's name is a label of 1986.
    let exact =
        digits == text.len() && year.is_some_and(|year| Edition::from_year(year).is_some_and(|e| e.year() == year));
    (has_society && exact).then_some(year)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_that_name_an_edition_are_told_from_labels() {
        for (line, year) in [
            ("IESNA91", Some(Some(1991))),
            ("IESNA95", Some(Some(1995))),
            ("IESNA:LM-63-1986", Some(Some(1986))),
            ("IESNA:LM-63-1995", Some(Some(1995))),
            ("IESNA:LM-63-2002", Some(Some(2002))),
            ("iesna: lm-63-2002", Some(Some(2002))),
            ("IES:LM-63-2019", Some(Some(2019))),
            ("ANSI/IES LM-63-19", Some(Some(2019))),
            ("ANSI/IESNA LM-63-02 (R2008)", Some(Some(2002))),
            ("LM-63-1995", Some(Some(1995))),
            ("IES:LM-63-2031", Some(Some(2031))),
            ("IESNA:LM-63", Some(None)),
            ("IES:LM-63-20191", Some(None)),
            ("IES file of a lamp", None),
            ("IES 2000 W FLOODLIGHT", None),
            ("IES 2000", None),
            ("IESNA", None),
            ("[TEST] IES:LM-63-2019", None),
            ("", None),
            ("\u{df}ANSI", None),
        ] {
            assert_eq!(edition_year(line.as_bytes()), year, "{line}");
        }
    }
}
