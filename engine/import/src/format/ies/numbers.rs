//! Reader of the free-form numbers of LM-63.
//!
//! Blanks, line ends, or one comma with or without blanks after it separate numbers. Two commas in a row are rejected, and so is a
//! comma directly before a number that does not follow a number: `,5` may be a decimal fraction.

use crate::{ImportError, ImportFault, Position, text::excerpt};

/// Meaning of a comma.
#[derive(Clone, Copy, PartialEq)]
pub(super) enum Comma {
    /// A comma separates numbers: the rule of LM-63.
    Separator,
    /// From this offset of the text on, a comma between two digits is a decimal point if it is the only comma between blanks. Files
    /// are never accepted with this reading. It only proves that a file has decimal commas.
    DecimalFrom(usize),
}

/// Sequential reader of the numbers of a text.
#[derive(Clone)]
pub(super) struct Numbers<'t> {
    file: &'t str,
    text: &'t [u8],
    comma: Comma,
    /// Offset of the next byte.
    at: usize,
    /// Offset after the last number; 0 before the first.
    end: usize,
    line: u32,
    column: u32,
}

impl<'t> Numbers<'t> {
    /// Creates a reader.
    /// - `line`: line of the file in which `text` starts.
    pub fn new(file: &'t str, text: &'t [u8], line: u32, comma: Comma) -> Self {
        Self { file, text, comma, at: 0, end: 0, line, column: 1 }
    }

    /// Returns the unread text.
    pub fn rest(&self) -> &'t [u8] {
        &self.text[self.at..]
    }

    /// Returns the position of the next field.
    pub fn position(&self) -> Position {
        Position { file: self.file.to_owned(), line: self.line, column: self.column }
    }

    /// Moves to the next field and returns it without consuming it.
    pub fn peek_field(&mut self) -> Option<&'t [u8]> {
        let rest = self.rest();
        let skip = rest.iter().position(|byte| !separates(*byte)).unwrap_or(rest.len());
        for byte in &rest[..skip] {
            if *byte == b'\n' {
                (self.line, self.column) = (self.line.saturating_add(1), 1);
            } else {
                self.column = self.column.saturating_add(1);
            }
        }
        self.at += skip;
        let rest = self.rest();
        let inside_list = self.at > 0 && self.text[self.at - 1] == b',';
        let end = match self.comma {
            Comma::DecimalFrom(start) if self.at >= start && !inside_list => {
                decimal_end(rest).unwrap_or_else(|| field_end(rest))
            }
            Comma::DecimalFrom(_) | Comma::Separator => field_end(rest),
        };
        (end > 0).then(|| &rest[..end])
    }

    /// Consumes the next field, which is `field`.
    pub fn consume(&mut self, field: &[u8]) {
        self.at += field.len();
        self.end = self.at;
        self.column = self.column.saturating_add(field.len() as u32);
    }

    /// Returns an error at the next field.
    pub fn bad_file(&self, reason: String, advice: &'static str) -> ImportError {
        ImportError::new(self.position(), ImportFault::BadFile { path: self.file.to_owned(), reason, advice })
    }

    pub fn number(&mut self, what: &'static str) -> Result<f64, ImportError> {
        let Some(field) = self.peek_field() else {
            return Err(self.bad_file(format!("the file ends before the {what}"), "check whether it is truncated"));
        };
        self.check_commas(field)?;
        let Some(value) = parse(field) else {
            return Err(ImportError::new(
                self.position(),
                ImportFault::NotANumber { found: excerpt(field), expected: what },
            ));
        };
        if !value.is_finite() {
            return Err(ImportError::new(self.position(), ImportFault::NotFinite { what }));
        }
        self.consume(field);
        Ok(value)
    }

    /// Rejects commas before the next field, `field`, that do not follow a number.
    fn check_commas(&self, field: &[u8]) -> Result<(), ImportError> {
        let gap = &self.text[self.end..self.at];
        let commas = gap.iter().filter(|&&byte| byte == b',').count();
        let leading = gap.ends_with(b",") && (gap.len() > 1 || self.end == 0);
        if leading && field.first().is_some_and(u8::is_ascii_digit) {
            let mut at = self.position();
            at.column = at.column.saturating_sub(1);
            let found = format!(",{}", excerpt(field));
            return Err(ImportError::new(at, ImportFault::DecimalComma { found }));
        }
        if commas > 1 || (commas > 0 && self.end == 0) {
            let advice = "separate two numbers with one comma, or with spaces only";
            return Err(self.bad_file("a number is missing between commas".into(), advice));
        }
        Ok(())
    }

    pub fn number_in(
        &mut self,
        what: &'static str,
        domain: &'static str,
        allowed: impl Fn(f64) -> bool,
    ) -> Result<f64, ImportError> {
        self.peek_field();
        let (line, column) = (self.line, self.column);
        let value = self.number(what)?;
        if allowed(value) {
            return Ok(value);
        }
        let at = Position { file: self.file.to_owned(), line, column };
        Err(ImportError::new(at, ImportFault::OutOfRange { what, value, allowed: domain }))
    }

    pub fn whole_number(
        &mut self,
        what: &'static str,
        low: f64,
        high: f64,
        domain: &'static str,
    ) -> Result<usize, ImportError> {
        Ok(self.number_in(what, domain, |x| x >= low && x <= high && x == x.trunc())? as usize)
    }

    pub fn ascending_numbers(
        &mut self,
        count: usize,
        what: &'static str,
        low: f64,
        high: f64,
        domain: &'static str,
    ) -> Result<Vec<f64>, ImportError> {
        let mut angles: Vec<f64> = Vec::new();
        for _ in 0..count {
            let last = angles.last().copied();
            angles.push(self.number_in(what, domain, |x| x >= low && x <= high && last.is_none_or(|last| x > last))?);
        }
        Ok(angles)
    }

    /// Fails if anything but blanks and a line `END` follows.
    /// - `last`: name of the last number of the file.
    pub fn finish(&mut self, last: &'static str) -> Result<(), ImportError> {
        let mut ahead = self.clone();
        let Some(first) = ahead.peek_field() else { return Ok(()) };
        if first.eq_ignore_ascii_case(b"END") || first.eq_ignore_ascii_case(b"[END]") {
            ahead.consume(first);
            if ahead.peek_field().is_none() {
                return Ok(());
            }
        }
        self.peek_field();
        let mut count = 0;
        let mut counting = self.clone();
        while counting.number(last).is_ok() {
            count += 1;
        }
        let found = excerpt(first);
        Err(ImportError::new(self.position(), ImportFault::LeftOver { found, numbers: count, last }))
    }
}

/// Parses a field as a number; a comma in it is a decimal point.
fn parse(field: &[u8]) -> Option<f64> {
    let text = std::str::from_utf8(field).ok()?;
    if !field.iter().all(|byte| b"0123456789+-.,eE".contains(byte)) {
        return None;
    }
    if field.contains(&b',') { text.replace(',', ".").parse().ok() } else { text.parse().ok() }
}

fn separates(byte: u8) -> bool {
    byte.is_ascii_whitespace() || matches!(byte, b',' | 0x0b)
}

fn field_end(text: &[u8]) -> usize {
    text.iter().position(|byte| separates(*byte)).unwrap_or(text.len())
}

/// Returns the end of a number with a decimal comma at the start of `text`, unless another comma joins it to more numbers.
pub(super) fn decimal_end(text: &[u8]) -> Option<usize> {
    let whole = field_end(text);
    let digits = text[..whole].strip_prefix(b"-").or(text[..whole].strip_prefix(b"+")).unwrap_or(&text[..whole]);
    let is_whole = !digits.is_empty() && digits.iter().all(u8::is_ascii_digit);
    let digit_after = text.get(whole + 1).is_some_and(u8::is_ascii_digit);
    if !is_whole || text.get(whole) != Some(&b',') || !digit_after {
        return None;
    }
    let end = whole + 1 + field_end(&text[whole + 1..]);
    let joined = text.get(end) == Some(&b',') && text.get(end + 1).is_some_and(|&byte| !separates(byte));
    (!joined).then_some(end)
}
