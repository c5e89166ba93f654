//! Decimal commas.
//!
//! LM-63 takes a comma as a separator, so `1200,5` is two numbers. A file says how many numbers it has: 13, the angles, and
//! an intensity for every pair of them. With `v` and `h` angles these are `(v + 1) (h + 1) + 12`. One number too many or too
//! few in any place makes a total that the counts it then announces cannot have, so a file with decimal commas is never read
//! as a lamp of another flux: its reading ends in an error. This module finds the errors that decimal commas caused. (Only
//! the count of tilt factors may be changed to one that happens to fit.)

use super::numbers::{Comma, Numbers, decimal_end};
use crate::{Fault, ImportError, Position};

/// Reads numbers with `read`; an error that decimal commas caused names them.
/// - `line`: line of the file in which `text` starts.
///
/// Decimal commas are the cause if the file can be read whole with them, if numbers are left over, or if they make the two
/// lines above the angles have 10 and 3 numbers.
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
    let Some((at, found)) = first_decimal_comma(text) else { return Err(error) };
    let proved = read(&mut Numbers::new(path, text, line, Comma::Decimal)).is_ok();
    let left_over = matches!(*error.fault, Fault::LeftOver { .. });
    if proved || left_over || standard_lines_have_decimal_commas(text) {
        let before = &text[..at];
        let start = before.iter().rposition(|&byte| byte == b'\n').map_or(0, |newline| newline + 1);
        let breaks = before.iter().filter(|&&byte| byte == b'\n').count() as u32;
        let column = (at - start) as u32 + 1;
        let at = Position { file: path.to_owned(), line: line.saturating_add(breaks), column };
        return Err(ImportError::new(at, Fault::DecimalComma { found }));
    }
    Err(error)
}

/// Offset and text of the first number with a decimal comma.
fn first_decimal_comma(text: &[u8]) -> Option<(usize, String)> {
    let mut at = 0;
    while at < text.len() {
        let field = &text[at..];
        if let Some(end) = decimal_end(field) {
            return Some((at, String::from_utf8_lossy(&field[..end]).into_owned()));
        }
        at += field.iter().position(u8::is_ascii_whitespace).map_or(field.len(), |end| end + 1);
    }
    None
}

/// Whether one of the two lines that hold 10 and 3 numbers by the standard does so with decimal commas alone. They are looked
/// for among all lines, as the data of `TILT=INCLUDE` may stand before them.
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
            [pair[0], pair[1]].map(|line| [Comma::Separator, Comma::Decimal].map(|comma| count(line, comma)));
        ten[1] == 10 && three[1] == 3 && (ten[0] > 10 || three[0] > 3)
    })
}
