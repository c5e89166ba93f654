//! Arguments of one entity: typed access with the position of each argument.

use super::lexer::{Quotes, Token};
use crate::{ImportError, ImportFault, Position};
use femc_math::glam::DVec3;
use std::borrow::Cow;

pub(super) type Result<T> = std::result::Result<T, ImportError>;

/// An entity and its arguments.
#[derive(Clone, Copy)]
pub(super) struct Args<'a> {
    pub file: &'a str,
    pub file_index: u32,
    tokens: &'a [Token<'a>],
}

impl<'a> Args<'a> {
    /// Creates the arguments. `tokens` must contain at least the entity's name.
    pub fn new(file: &'a str, file_index: u32, tokens: &'a [Token<'a>]) -> Self {
        Self { file, file_index, tokens }
    }

    pub fn entity(&self) -> Cow<'a, str> {
        String::from_utf8_lossy(self.tokens[0].text)
    }

    /// Returns the number of arguments.
    pub fn len(&self) -> usize {
        self.tokens.len() - 1
    }

    /// Returns the position of the entity.
    pub fn entity_position(&self) -> Position {
        self.position(&self.tokens[0])
    }

    /// Returns the location of the entity, for descriptions.
    pub fn location(&self) -> femc_scene::Location {
        let token = &self.tokens[0];
        femc_scene::Location { file: self.file_index, line: token.line, column: token.column }
    }

    fn position(&self, token: &Token<'_>) -> Position {
        Position { file: self.file.to_owned(), line: token.line, column: token.column }
    }

    /// Returns an error for the entity as a whole.
    pub fn fault(&self, fault: ImportFault) -> ImportError {
        ImportError::new(self.entity_position(), fault)
    }

    /// Returns the position of argument `i`, or of the entity if there is no such argument.
    pub fn argument_at(&self, i: usize) -> Position {
        self.position(self.tokens.get(i + 1).unwrap_or(&self.tokens[0]))
    }

    /// Returns an error for argument `i`.
    pub fn fault_at(&self, i: usize, fault: ImportFault) -> ImportError {
        ImportError::new(self.argument_at(i), fault)
    }

    /// Checks that the number of arguments is in `range`. `expected` describes the range in words.
    pub fn check_count(&self, range: impl std::ops::RangeBounds<usize>, expected: &'static str) -> Result<()> {
        if range.contains(&self.len()) {
            return Ok(());
        }
        Err(self.fault(ImportFault::ArgumentCount { entity: self.entity().into_owned(), expected, found: self.len() }))
    }

    /// Returns argument `i` as bytes; empty if there is none.
    pub fn raw(&self, i: usize) -> &'a [u8] {
        self.tokens.get(i + 1).map_or(b"", |token| token.text)
    }

    /// Returns argument `i` as text.
    pub fn text(&self, i: usize) -> Cow<'a, str> {
        String::from_utf8_lossy(self.raw(i))
    }

    /// Returns whether the first argument is in double quotes.
    pub fn is_quoted(&self) -> bool {
        self.tokens.get(1).is_some_and(|token| token.quotes != Quotes::None)
    }

    /// Checks that the first argument, if quoted, ends with a quote and a blank.
    pub fn check_quotes(&self) -> Result<()> {
        let Some(name) = self.tokens.get(1) else { return Ok(()) };
        if name.quotes == Quotes::Open {
            return Err(self.fault_at(0, ImportFault::UnclosedQuote));
        }
        let end = name.column as usize + name.text.len() + 2;
        match self.tokens.get(2) {
            Some(next) if self.is_quoted() && next.line == name.line && next.column as usize == end => {
                Err(self.fault_at(1, ImportFault::AfterQuote { found: self.text(1).into_owned() }))
            }
            _ => Ok(()),
        }
    }

    /// Returns the first `n` arguments with the blanks between them.
    pub fn joined(&self, n: usize) -> String {
        let mut text = self.text(0).into_owned();
        for pair in self.tokens[1..=n].windows(2) {
            let end = pair[0].column as usize + pair[0].text.len();
            let blanks = if pair[0].line == pair[1].line { (pair[1].column as usize).saturating_sub(end) } else { 1 };
            text.extend(std::iter::repeat_n(' ', blanks.max(1)));
            text.push_str(&String::from_utf8_lossy(pair[1].text));
        }
        text
    }

    /// Returns argument `i` as a finite number.
    pub fn number(&self, i: usize, what: &'static str) -> Result<f64> {
        let raw = self.raw(i);
        let value =
            std::str::from_utf8(raw).ok().filter(|text| numeric(text)).and_then(|text| text.parse::<f64>().ok());
        match value {
            Some(value) if value.is_finite() => Ok(value),
            Some(_) => Err(self.fault_at(i, ImportFault::NotFinite { what })),
            None if self.is_non_finite_word(i) => Err(self.fault_at(i, ImportFault::NotFinite { what })),
            None => Err(self.fault_at(i, ImportFault::NotANumber { found: self.text(i).into_owned(), expected: what })),
        }
    }

    fn is_non_finite_word(&self, i: usize) -> bool {
        let word = self.text(i).to_ascii_lowercase();
        matches!(word.trim_start_matches(['+', '-']), "inf" | "infinity" | "nan")
    }

    /// Returns argument `i` as a number for which `allowed` holds. `domain` describes the domain in words.
    pub fn number_in(
        &self,
        i: usize,
        what: &'static str,
        domain: &'static str,
        allowed: impl Fn(f64) -> bool,
    ) -> Result<f64> {
        let value = self.number(i, what)?;
        if allowed(value) { Ok(value) } else { Err(self.out_of_range(i, what, value, domain)) }
    }

    /// Returns the error for a number outside its domain.
    pub fn out_of_range(&self, i: usize, what: &'static str, value: f64, allowed: &'static str) -> ImportError {
        self.fault_at(i, ImportFault::OutOfRange { what, value, allowed })
    }

    /// Returns argument `i` as a whole number in `[low, high]`.
    pub fn whole_number(&self, i: usize, what: &'static str, range: [u64; 2], domain: &'static str) -> Result<u64> {
        let [low, high] = range;
        let value = self.number_in(i, what, domain, |x| x >= low as f64 && x <= high as f64 && x == x.trunc())?;
        Ok(value as u64)
    }

    /// Returns arguments `i`, `i + 1`, `i + 2` as a vector.
    pub fn vector(&self, i: usize, what: &'static str) -> Result<DVec3> {
        Ok(DVec3::new(self.number(i, what)?, self.number(i + 1, what)?, self.number(i + 2, what)?))
    }

    /// Returns the entity with only the arguments from `i` on.
    pub fn tail(&self, i: usize) -> Tail<'a> {
        Tail { args: *self, first: i }
    }
}

/// Arguments from some index on.
#[derive(Clone, Copy)]
pub(super) struct Tail<'a> {
    pub args: Args<'a>,
    pub first: usize,
}

/// Returns whether `text` starts like a number in C (Rust also parses words such as `inf`).
fn numeric(text: &str) -> bool {
    text.bytes().all(|byte| matches!(byte, b'0'..=b'9' | b'+' | b'-' | b'.' | b'e' | b'E'))
}
