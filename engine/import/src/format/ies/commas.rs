//! Detection of decimal commas.
//!
//! LM-63 uses the comma as a separator, so `1200,5` is two numbers. The counts in a file determine its total of numbers: 13, the
//! angles, and an intensity for every pair of angles. With `v` and `h` angles these are `(v + 1) (h + 1) + 12`. If one number is
//! added or lost anywhere, the total no longer matches the counts that the file then announces. So a file with decimal commas is
//! never read as a lamp with another flux: reading it ends in an error. This module finds the errors that decimal commas caused.
//! (Only the count of tilt factors may change to one that happens to match.)

use super::numbers::{Comma, Numbers, decimal_end};
use crate::{ImportError, ImportFault, Position, text::excerpt};

/// Reads numbers with `read`. If decimal commas caused an error, the returned error says so.
/// - `line`: line of the file in which `text` starts.
///
/// Decimal commas are the cause if the file can be read completely with them, or if with them the two lines above the angles have
/// 10 and 3 numbers. If numbers are left over, only the last commas may be decimal and those before them separators: `0,90` may be
/// a list of two angles.
pub(super) fn read_numbers<T>(
    path: &str,
    text: &[u8],
    line: u32,
    mut read: impl FnMut(&mut Numbers<'_>) -> Result<T, ImportError>,
) -> Result<T, ImportError> {
    let error = match read(&mut Numbers::new(path, text, line, Comma::Separator)) {
        Ok(value) => return Ok(value),
        Err(error) => error,
    };
    let Some(first) = decimal_commas(text).next() else { return Err(error) };
    let mut is_proved = |start| read(&mut Numbers::new(path, text, line, Comma::DecimalFrom(start))).is_ok();
    let culprit = match *error.fault {
        _ if is_proved(first) || standard_lines_have_decimal_commas(text) => Some(first),
        // Each decimal comma adds one number.
        ImportFault::LeftOver { numbers: excess @ 1.., .. } => {
            nth_last_decimal_comma(text, excess).filter(|&at| is_proved(at))
        }
        _ => None,
    };
    Err(culprit.and_then(|at| decimal_comma(path, text, line, at)).unwrap_or(error))
}

/// Returns the error for the number with a decimal comma at an offset of the text.
fn decimal_comma(path: &str, text: &[u8], line: u32, at: usize) -> Option<ImportError> {
    let (before, field) = text.split_at(at);
    let found = excerpt(&field[..decimal_end(field)?]);
    let start = before.iter().rposition(|&byte| byte == b'\n').map_or(0, |newline| newline + 1);
    let breaks = before.iter().filter(|&&byte| byte == b'\n').count() as u32;
    let column = (at - start) as u32 + 1;
    let at = Position { file: path.to_owned(), line: line.saturating_add(breaks), column };
    Some(ImportError::new(at, ImportFault::DecimalComma { found }))
}

/// Iterates over the offsets of fields that may be numbers with a decimal comma.
fn decimal_commas(text: &[u8]) -> impl Iterator<Item = usize> {
    let mut at = 0;
    std::iter::from_fn(move || {
        while at < text.len() {
            let (start, field) = (at, &text[at..]);
            at += field.iter().position(u8::is_ascii_whitespace).map_or(field.len(), |end| end + 1);
            if decimal_end(field).is_some() {
                return Some(start);
            }
        }
        None
    })
}

/// Returns the offset of the `n`-th last field that may have a decimal comma.
fn nth_last_decimal_comma(text: &[u8], n: u64) -> Option<usize> {
    let skip = decimal_commas(text).count().checked_sub(usize::try_from(n).ok()?)?;
    decimal_commas(text).nth(skip)
}

/// Returns whether the two lines that must have 10 and 3 numbers by the standard have these counts only with decimal commas. The
/// first lines of the text are searched, because the data of `TILT=INCLUDE` may precede them.
fn standard_lines_have_decimal_commas(text: &[u8]) -> bool {
    let count = |line: &[u8], comma| {
        let mut numbers = Numbers::new("", line, 1, comma);
        let mut count = 0;
        while numbers.number("").is_ok() {
            count += 1;
        }
        count
    };
    let lines: Vec<&[u8]> =
        text.split(|&byte| byte == b'\n').filter(|line| !line.trim_ascii().is_empty()).take(8).collect();
    lines.windows(2).any(|pair| {
        let [ten, three] =
            [pair[0], pair[1]].map(|line| [Comma::Separator, Comma::DecimalFrom(0)].map(|comma| count(line, comma)));
        ten[1] == 10 && three[1] == 3 && (ten[0] > 10 || three[0] > 3)
    })
}
