//! Lines and fields.
//!
//! A trailing `\` joins the next line; fields are split by blanks and keep the place where they stand, so that a fault in a
//! joined line names the physical line. Nothing is copied: fields borrow from the text.

/// Longest joined line, bytes.
pub(super) const MAX_LINE: usize = 4096;

/// A field.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Token<'t> {
    pub text: &'t [u8],
    pub line: u32,
    pub column: u32,
}

/// A line that is too long; where it starts.
#[derive(Debug, PartialEq)]
pub(super) struct TooLong {
    pub line: u32,
}

/// Reads a text joined line by joined line.
pub(super) struct Lexer<'t> {
    rest: &'t [u8],
    line: u32,
}

impl<'t> Lexer<'t> {
    pub fn new(text: &'t [u8]) -> Self {
        Self { rest: text.strip_prefix(b"\xef\xbb\xbf").unwrap_or(text), line: 0 }
    }

    /// Fills `tokens` with the fields of the next line that has any; false at the end of the text. Comments are skipped.
    pub fn next(&mut self, tokens: &mut Vec<Token<'t>>) -> Result<bool, TooLong> {
        loop {
            tokens.clear();
            let mut length = 0;
            let first = self.line + 1;
            loop {
                if self.rest.is_empty() {
                    break;
                }
                let (line, joined) = self.physical();
                length += line.len() + usize::from(joined);
                fields(line, self.line, tokens);
                if !joined {
                    break;
                }
            }
            let comment = tokens.first().is_some_and(|token| token.text[0] == b'#');
            if length > MAX_LINE && !comment {
                return Err(TooLong { line: first });
            }
            if !tokens.is_empty() && !comment {
                return Ok(true);
            }
            if self.rest.is_empty() {
                return Ok(false);
            }
        }
    }

    /// One physical line without its end, and whether a `\` joins the next one to it.
    fn physical(&mut self) -> (&'t [u8], bool) {
        let end = self.rest.iter().position(|&byte| byte == b'\n');
        let line = &self.rest[..end.unwrap_or(self.rest.len())];
        self.rest = end.map_or(&[], |end| &self.rest[end + 1..]);
        self.line = self.line.saturating_add(1);
        let line = line.strip_suffix(b"\r").unwrap_or(line);
        match line.strip_suffix(b"\\") {
            Some(line) => (line, true),
            None => (line, false),
        }
    }
}

fn fields<'t>(line: &'t [u8], number: u32, tokens: &mut Vec<Token<'t>>) {
    let blank = |byte: &u8| matches!(byte, b' ' | b'\t' | b'\r' | 0x0b | 0x0c);
    let mut at = 0;
    while let Some(start) = line[at..].iter().position(|byte| !blank(byte)).map(|skip| at + skip) {
        let end = line[start..].iter().position(blank).map_or(line.len(), |length| start + length);
        tokens.push(Token { text: &line[start..end], line: number, column: start as u32 + 1 });
        at = end;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn all(text: &[u8]) -> Vec<Vec<(String, u32, u32)>> {
        let (mut lexer, mut tokens, mut lines) = (Lexer::new(text), Vec::new(), Vec::new());
        while lexer.next(&mut tokens).unwrap() {
            let field = |t: &Token<'_>| (String::from_utf8_lossy(t.text).into_owned(), t.line, t.column);
            lines.push(tokens.iter().map(field).collect());
        }
        lines
    }

    #[test]
    fn fields_keep_their_place_across_joined_lines_and_any_line_end() {
        let lines = all(b"\xef\xbb\xbf# comment\r\n\r\n  f a\\\r\n\tb \\\nc\n#x\\\nhidden\no");
        let expected = [vec![("f", 3, 3), ("a", 3, 5), ("b", 4, 2), ("c", 5, 1)], vec![("o", 8, 1)]];
        let got: Vec<Vec<_>> = lines.iter().map(|l| l.iter().map(|(s, a, b)| (s.as_str(), *a, *b)).collect()).collect();
        assert_eq!(got, expected);
    }

    #[test]
    fn a_backslash_inside_a_line_or_before_blanks_joins_nothing() {
        assert_eq!(all(b"a\\b \\ \nc\n").len(), 2);
    }

    #[test]
    fn a_join_at_the_end_of_the_text_ends_the_line() {
        assert_eq!(all(b"a b\\").len(), 1);
        assert_eq!(all(b"a b\\\n").len(), 1);
    }

    #[test]
    fn the_limit_holds_for_joined_lines_and_not_for_comments() {
        let text = format!("# {}\nx {}\\\ny\n", "c".repeat(9000), "a".repeat(4094));
        let (mut lexer, mut tokens) = (Lexer::new(text.as_bytes()), Vec::new());
        assert_eq!(lexer.next(&mut tokens), Err(TooLong { line: 2 }));
        let fits = format!("x {}\n", "a".repeat(4094));
        assert_eq!(all(fits.as_bytes()).len(), 1);
    }
}
