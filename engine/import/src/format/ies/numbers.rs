//! The free-form numbers of LM-63.

use crate::{Fault, ImportError, Position};

/// Numbers in free form, separated by blanks or commas.
pub(super) struct Numbers<'f, 't> {
    pub file: &'f str,
    pub rest: &'t [u8],
    pub line: u32,
    pub column: u32,
}

impl<'t> Numbers<'_, 't> {
    /// The place of the next field.
    pub fn here(&self) -> Position {
        Position { file: self.file.to_owned(), line: self.line, column: self.column }
    }

    /// Moves to the next field, if there is one, without taking it.
    pub fn token(&mut self) -> Option<&'t [u8]> {
        let separator = |byte: &u8| byte.is_ascii_whitespace() || matches!(byte, b',' | 0x0b | 0 | 0x1a);
        let skip = self.rest.iter().position(|byte| !separator(byte)).unwrap_or(self.rest.len());
        for byte in &self.rest[..skip] {
            self.advance(*byte);
        }
        self.rest = &self.rest[skip..];
        let end = self.rest.iter().position(separator).unwrap_or(self.rest.len());
        (end > 0).then(|| &self.rest[..end])
    }

    fn advance(&mut self, byte: u8) {
        if byte == b'\n' {
            (self.line, self.column) = (self.line.saturating_add(1), 1);
        } else {
            self.column = self.column.saturating_add(1);
        }
    }

    pub fn number(&mut self, what: &'static str) -> Result<f64, ImportError> {
        let Some(field) = self.token() else {
            let reason = format!("it ends where the {what} should be");
            let fault = Fault::BadFile { path: self.file.to_owned(), reason, advice: "it may be cut short" };
            return Err(ImportError::new(self.here(), fault));
        };
        let text = std::str::from_utf8(field).ok().filter(|t| t.bytes().all(|b| b"0123456789+-.eE".contains(&b)));
        let Some(value) = text.and_then(|text| text.parse::<f64>().ok()) else {
            let found = String::from_utf8_lossy(field).into_owned();
            return Err(ImportError::new(self.here(), Fault::NotANumber { found, expected: what }));
        };
        if !value.is_finite() {
            return Err(ImportError::new(self.here(), Fault::NotFinite { what }));
        }
        self.rest = &self.rest[field.len()..];
        self.column = self.column.saturating_add(field.len() as u32);
        Ok(value)
    }

    pub fn number_in(
        &mut self,
        what: &'static str,
        domain: &'static str,
        allowed: impl Fn(f64) -> bool,
    ) -> Result<f64, ImportError> {
        self.token();
        let at = self.here();
        let value = self.number(what)?;
        if allowed(value) {
            return Ok(value);
        }
        Err(ImportError::new(at, Fault::OutOfRange { what, value, allowed: domain }))
    }

    pub fn whole(
        &mut self,
        what: &'static str,
        low: f64,
        high: f64,
        domain: &'static str,
    ) -> Result<usize, ImportError> {
        Ok(self.number_in(what, domain, |x| x >= low && x <= high && x == x.trunc())? as usize)
    }

    pub fn ascending(
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
}
