//! Lexer of MGF lines and fields.
//!
//! A trailing `\` joins the next line. Blanks separate fields. Each field keeps its position, so a fault in a joined line names the
//! physical line. Nothing is copied: fields borrow from the text. A double quote at the start of a file name (the first argument of
//! `i`, `ies` and the `map` entities) starts a field that ends at the next quote or at the end of the line; `\` has no special
//! meaning in it. Elsewhere quotes are ordinary characters.

/// Maximum length of a joined line, bytes.
pub(super) const MAX_LINE: usize = 4096;

/// A field of a line.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Token<'t> {
    pub text: &'t [u8],
    pub line: u32,
    pub column: u32,
    pub quotes: Quotes,
}

/// Quoting of a field.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Quotes {
    /// No quotes: blanks end the field.
    None,
    /// A pair of double quotes, which are not part of the field's text.
    Pair,
    /// A double quote that is not closed on its line.
    Open,
}

/// Error for a line that is too long, with the line where it starts.
#[derive(Debug, PartialEq)]
pub(super) struct LineTooLong {
    pub line: u32,
}

/// Reader of a text, one joined line at a time.
pub(super) struct Lexer<'t> {
    rest: &'t [u8],
    line: u32,
}

impl<'t> Lexer<'t> {
    pub fn new(text: &'t [u8]) -> Self {
        Self { rest: text.strip_prefix(b"\xef\xbb\xbf").unwrap_or(text), line: 0 }
    }

    /// Fills `tokens` with the fields of the next line that has any; returns false at the end of the text. Skips comments.
    pub fn next_line(&mut self, tokens: &mut Vec<Token<'t>>) -> Result<bool, LineTooLong> {
        loop {
            tokens.clear();
            let mut length = 0;
            let first = self.line + 1;
            while !self.rest.is_empty() {
                let (bytes, joined) = self.read_physical_line(tokens);
                length += bytes;
                if !joined {
                    break;
                }
            }
            let comment = tokens.first().is_some_and(|token| token.text[0] == b'#');
            if length > MAX_LINE && !comment {
                return Err(LineTooLong { line: first });
            }
            if !tokens.is_empty() && !comment {
                return Ok(true);
            }
            if self.rest.is_empty() {
                return Ok(false);
            }
        }
    }

    /// Adds the fields of one physical line. Returns its length and whether a `\` joins the next line to it.
    fn read_physical_line(&mut self, tokens: &mut Vec<Token<'t>>) -> (usize, bool) {
        let bytes = self.rest;
        self.line = self.line.saturating_add(1);
        let mut at = 0;
        while at < bytes.len() && bytes[at] != b'\n' {
            let start = at;
            if let [entity] = tokens[..]
                && bytes[at] == b'"'
                && has_file_name(entity.text)
            {
                let line = bytes[at + 1..].split(|byte| matches!(byte, b'\n' | b'\r')).next().unwrap_or_default();
                let end = line.iter().position(|&byte| byte == b'"');
                let text = &line[..end.unwrap_or(line.len())];
                let quotes = if end.is_some() { Quotes::Pair } else { Quotes::Open };
                tokens.push(Token { text, line: self.line, column: start as u32 + 1, quotes });
                at += 1 + text.len() + usize::from(end.is_some());
                continue;
            }
            while at < bytes.len() && !is_space(bytes[at]) {
                at += 1;
            }
            // A line with more fields than allowed bytes is too long (or a comment), so its fields take no memory.
            if at > start && tokens.len() > MAX_LINE {
                continue;
            }
            if at > start {
                tokens.push(Token {
                    text: &bytes[start..at],
                    line: self.line,
                    column: start as u32 + 1,
                    quotes: Quotes::None,
                });
            } else {
                at += 1;
            }
        }
        self.rest = bytes.get(at + 1..).unwrap_or_default();
        let line = &bytes[..at];
        let line = line.strip_suffix(b"\r").unwrap_or(line);
        let in_quotes = tokens.last().is_some_and(|last| last.quotes == Quotes::Open);
        let joined = line.ends_with(b"\\") && !in_quotes;
        if let (true, Some(last)) = (joined, tokens.last_mut().filter(|last| last.text.ends_with(b"\\"))) {
            last.text = &last.text[..last.text.len() - 1];
            if last.text.is_empty() {
                tokens.pop();
            }
        }
        (line.len(), joined)
    }
}

/// Returns whether the first argument of an entity is a file name.
fn has_file_name(entity: &[u8]) -> bool {
    matches!(entity, b"i" | b"ies" | b"map_rd" | b"map_ed" | b"map_n")
}

fn is_space(byte: u8) -> bool {
    byte <= b' ' && matches!(byte, b' ' | b'\t' | b'\n' | b'\r' | 0x0b | 0x0c)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn all(text: &[u8]) -> Vec<Vec<(String, u32, u32)>> {
        let (mut lexer, mut tokens, mut lines) = (Lexer::new(text), Vec::new(), Vec::new());
        while lexer.next_line(&mut tokens).unwrap() {
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
    fn quotes_count_at_the_start_of_a_file_name_alone() {
        let fields = |text: &[u8]| -> Vec<String> {
            all(text).concat().into_iter().map(|(field, _, column)| format!("{column}:{field}")).collect()
        };
        for entity in ["i", "ies", "map_rd", "map_ed", "map_n"] {
            let at = entity.len() + 2;
            let quoted = fields(format!("{entity} \"my  lamp.ies\" -t").as_bytes());
            assert_eq!(quoted, [format!("1:{entity}"), format!("{at}:my  lamp.ies"), format!("{}:-t", at + 15)]);
            let inside = fields(format!("{entity} my\"lamp \"x y\"").as_bytes());
            assert_eq!(inside.len(), 4, "{inside:?}");
        }
        for entity in ["m", "c", "v", "o", "camera", "xf", "f"] {
            let fields = fields(format!("{entity} \"we ird\"").as_bytes());
            assert_eq!(fields[1..], [format!("{}:\"we", entity.len() + 2), format!("{}:ird\"", entity.len() + 6)]);
        }
        // A quote ends with its line, for every kind of line end. A `\\` within quotes joins no lines.
        assert_eq!(fields(b"i \"a b\r\ni \"c\\\"\n"), ["1:i", "3:a b", "1:i", "3:c\\"]);
        for line_end in ["\n", "\r\n"] {
            let text = format!("i \"\\{line_end}o d{line_end}i \"e \\{line_end}o");
            assert_eq!(fields(text.as_bytes()), ["1:i", "3:\\", "1:o", "3:d", "1:i", "3:e \\", "1:o"]);
        }
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
    fn a_line_of_a_million_fields_takes_no_memory_for_them() {
        for (start, expected) in [("x ", Err(LineTooLong { line: 1 })), ("# ", Ok(false))] {
            let text = start.to_owned() + &"y ".repeat(1_000_000);
            let (mut lexer, mut tokens) = (Lexer::new(text.as_bytes()), Vec::new());
            assert_eq!(lexer.next_line(&mut tokens), expected);
            assert!(tokens.capacity() <= 4 * MAX_LINE);
        }
    }

    #[test]
    fn the_limit_holds_for_joined_lines_and_not_for_comments() {
        let text = format!("# {}\nx {}\\\ny\n", "c".repeat(9000), "a".repeat(4094));
        let (mut lexer, mut tokens) = (Lexer::new(text.as_bytes()), Vec::new());
        assert_eq!(lexer.next_line(&mut tokens), Err(LineTooLong { line: 2 }));
        let fits = format!("x {}\n", "a".repeat(4094));
        assert_eq!(all(fits.as_bytes()).len(), 1);
    }
}
