//! The grammar of light path expressions, as in Open Shading Language.
//!
//! ```text
//! choice   = sequence { "|" sequence }
//! sequence = { item [ "*" | "+" | "?" | "{" N [ "," M ] "}" ] }
//! item     = event | "(" choice ")"
//! event    = "." | LETTER | LABEL | "[" ["^"] { LETTER | LABEL | angle } "]" | angle
//! angle    = "<" part [ part ] { LABEL | "[" ["^"] LABEL { LABEL } "]" | "." } ">"
//! part     = "." | LETTER | "[" ["^"] { LETTER } "]"
//! LETTER   = C R T V D G S L O B
//! LABEL    = "'" text "'"
//! ```
//!
//! The first part in angles is the type (`C R T V L O B`), the second the scattering (`D G S`). Spaces are ignored. The prefix
//! `lpe:`, which other renderers require, is skipped ([`crate::dialect`]).

use crate::dialect::{self, BARE_LABEL, SCATTERING_FIRST};
use crate::error::ExpressionError;
use crate::event::{ANY_KIND, EventClass, EventKind, EventPattern};

/// A part of an expression.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Node {
    /// One event.
    Event(EventPattern),
    /// A sequence of parts; an empty one matches no event.
    Sequence(Vec<Node>),
    /// A choice of one part.
    Choice(Vec<Node>),
    /// Any number of repetitions, `*`.
    ZeroOrMore(Box<Node>),
    /// One or more repetitions, `+`.
    OneOrMore(Box<Node>),
    /// Zero or one occurrence, `?`.
    Optional(Box<Node>),
}

/// A parsed expression.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Expression(pub(crate) Node);

/// Maximum number of characters of an expression.
const MAX_CHARS: usize = 4096;
/// Maximum depth of nested parentheses.
const MAX_DEPTH: usize = 64;
/// Maximum number of repetitions in `{n,m}`.
const MAX_REPETITIONS: usize = 64;
/// Maximum number of events of an expression with repetitions written out.
const MAX_EVENTS: usize = 2048;

const REFLECTED: u16 = 0b111 << EventKind::ReflectedDiffuse as u16;
const TRANSMITTED: u16 = 0b111 << EventKind::TransmittedDiffuse as u16;
const DIFFUSE: u16 = EventKind::ReflectedDiffuse.bit() | EventKind::TransmittedDiffuse.bit();
const GLOSSY: u16 = EventKind::ReflectedGlossy.bit() | EventKind::TransmittedGlossy.bit();
const SPECULAR: u16 = EventKind::ReflectedSpecular.bit() | EventKind::TransmittedSpecular.bit();

/// Returns the kinds of a type letter.
fn type_of(letter: char) -> Option<u16> {
    Some(match letter {
        'C' => EventKind::Camera.bit(),
        'R' => REFLECTED,
        'T' => TRANSMITTED,
        'V' => EventKind::Volume.bit(),
        'L' => EventKind::Light.bit(),
        'O' => EventKind::Object.bit(),
        'B' => EventKind::Background.bit(),
        _ => return None,
    })
}

/// Returns the kinds of a scattering letter.
fn scattering_of(letter: char) -> Option<u16> {
    Some(match letter {
        'D' => DIFFUSE,
        'G' => GLOSSY,
        'S' => SPECULAR,
        _ => return None,
    })
}

impl Expression {
    /// Parses an expression.
    pub fn parse(text: &str) -> Result<Self, ExpressionError> {
        let mut parser = Parser { text, chars: text.chars().collect(), at: 0, depth: 0, events: 0 };
        if parser.chars.len() > MAX_CHARS {
            parser.at = MAX_CHARS;
            return Err(parser.expected("at most 4096 characters"));
        }
        match dialect::prefix_length(&parser.chars) {
            Ok(length) => parser.at = length,
            Err((at, expected)) => {
                parser.at = at;
                return Err(parser.expected(expected));
            }
        }
        let node = parser.choice()?;
        match parser.peek() {
            None => Ok(Self(node)),
            Some(')') => Err(parser.expected("an event: this parenthesis closes nothing")),
            Some(_) => Err(parser.expected_event()),
        }
    }

    /// Returns the expression as a tree.
    pub fn node(&self) -> &Node {
        &self.0
    }

    /// Returns the events of the expression.
    pub fn events(&self) -> Vec<&EventPattern> {
        fn collect<'a>(node: &'a Node, all: &mut Vec<&'a EventPattern>) {
            match node {
                Node::Event(event) => all.push(event),
                Node::Sequence(nodes) | Node::Choice(nodes) => nodes.iter().for_each(|node| collect(node, all)),
                Node::ZeroOrMore(node) | Node::OneOrMore(node) | Node::Optional(node) => collect(node, all),
            }
        }
        let mut all = Vec::new();
        collect(&self.0, &mut all);
        all
    }
}

const EXPECTED_EVENT: &str = "an event: `.`, one of C R T V D G S L O B, `<..>`, `[..]`, `(..)` or a label in quotes";

struct Parser<'a> {
    text: &'a str,
    chars: Vec<char>,
    at: usize,
    depth: usize,
    /// Number of events so far, with repetitions written out.
    events: usize,
}

/// Returns the number of events of a part of an expression.
fn count_events(node: &Node) -> usize {
    match node {
        Node::Event(_) => 1,
        Node::Sequence(nodes) | Node::Choice(nodes) => nodes.iter().map(count_events).sum(),
        Node::ZeroOrMore(node) | Node::OneOrMore(node) | Node::Optional(node) => count_events(node),
    }
}

impl Parser<'_> {
    fn expected(&self, expected: &'static str) -> ExpressionError {
        ExpressionError { expression: self.text.to_owned(), position: self.at, expected }
    }

    /// Returns the error that an event is expected here, with advice if the character has a meaning in another renderer.
    fn expected_event(&self) -> ExpressionError {
        let advice = self.chars.get(self.at).and_then(|found| dialect::advice(*found));
        self.expected(advice.unwrap_or(EXPECTED_EVENT))
    }

    /// Returns the next character that is not a space.
    fn peek(&mut self) -> Option<char> {
        while self.chars.get(self.at).is_some_and(|c| c.is_whitespace()) {
            self.at += 1;
        }
        self.chars.get(self.at).copied()
    }

    fn accept(&mut self, wanted: char) -> bool {
        let is_there = self.peek() == Some(wanted);
        self.at += usize::from(is_there);
        is_there
    }

    fn choice(&mut self) -> Result<Node, ExpressionError> {
        let mut all = vec![self.sequence()?];
        while self.accept('|') {
            all.push(self.sequence()?);
        }
        Ok(if all.len() == 1 { all.remove(0) } else { Node::Choice(all) })
    }

    fn sequence(&mut self) -> Result<Node, ExpressionError> {
        let mut all = Vec::new();
        while let Some(next) = self.peek() {
            if matches!(next, '|' | ')') {
                break;
            }
            let mut item = self.item(next)?;
            while let Some(repeat @ ('*' | '+' | '?' | '{')) = self.peek() {
                let boxed = |item| Box::new(item);
                item = match repeat {
                    '{' => self.repetition(item)?,
                    '*' => Node::ZeroOrMore(boxed(item)),
                    '+' => Node::OneOrMore(boxed(item)),
                    _ => Node::Optional(boxed(item)),
                };
                self.at += 1;
                // Each further sign would add a level to every recursion over the tree.
                if matches!(self.peek(), Some('*' | '+' | '?' | '{')) {
                    return Err(self.expected("at most one repetition sign per event; use parentheses for more"));
                }
            }
            all.push(item);
        }
        if all.is_empty() {
            return Err(self.expected(EXPECTED_EVENT));
        }
        Ok(if all.len() == 1 { all.remove(0) } else { Node::Sequence(all) })
    }

    /// Parses `{n}` or `{n,m}` after an item and writes the repetitions out. Stops at the closing brace.
    fn repetition(&mut self, item: Node) -> Result<Node, ExpressionError> {
        const FORM: &str = "`{n}` or `{n,m}` with n <= m, at least 1 and at most 64 times";
        let start = self.at;
        self.at += 1;
        let least = self.number().ok_or_else(|| self.expected(FORM))?;
        let most = if self.accept(',') { self.number().ok_or_else(|| self.expected(FORM))? } else { least };
        if self.peek() != Some('}') {
            return Err(self.expected("`}`"));
        }
        if most == 0 || most < least || most > MAX_REPETITIONS {
            self.at = start;
            return Err(self.expected(FORM));
        }
        self.events += (most - 1) * count_events(&item);
        if self.events > MAX_EVENTS {
            self.at = start;
            return Err(self.expected(
                "fewer repetitions: an expression has at most 2048 events with all repetitions written out",
            ));
        }
        let surely = std::iter::repeat_n(item.clone(), least);
        let maybe = std::iter::repeat_n(Node::Optional(Box::new(item)), most - least);
        Ok(Node::Sequence(surely.chain(maybe).collect()))
    }

    /// Parses a whole number.
    fn number(&mut self) -> Option<usize> {
        self.peek();
        let digits: String = self.chars[self.at..].iter().take_while(|c| c.is_ascii_digit()).collect();
        self.at += digits.len();
        digits.parse().ok()
    }

    fn item(&mut self, next: char) -> Result<Node, ExpressionError> {
        match next {
            '(' => {
                if self.depth == MAX_DEPTH {
                    return Err(self.expected("at most 64 nested parentheses"));
                }
                self.depth += 1;
                self.at += 1;
                let inner = self.choice()?;
                if !self.accept(')') {
                    return Err(self.expected("`)`"));
                }
                self.depth -= 1;
                Ok(inner)
            }
            '[' => {
                self.events += 1;
                self.bracket().map(Node::Event)
            }
            _ => match self.class()? {
                Some(class) => {
                    self.events += 1;
                    Ok(Node::Event(EventPattern::from_class(class)))
                }
                None => Err(self.expected_event()),
            },
        }
    }

    /// Parses one event without brackets; `None`: the next character begins no event.
    fn class(&mut self) -> Result<Option<EventClass>, ExpressionError> {
        let Some(next) = self.peek() else { return Ok(None) };
        let plain = |kinds| Ok(Some(EventClass { kinds, labels: None }));
        match next {
            '.' => {
                self.at += 1;
                plain(ANY_KIND)
            }
            '\'' => Ok(Some(EventClass { kinds: ANY_KIND, labels: Some((vec![self.label()?], false)) })),
            '<' => self.angle().map(Some),
            letter => match type_of(letter).or_else(|| scattering_of(letter)) {
                Some(kinds) => {
                    self.at += 1;
                    plain(kinds)
                }
                None => Ok(None),
            },
        }
    }

    /// Parses `[..]` or `[^..]`.
    fn bracket(&mut self) -> Result<EventPattern, ExpressionError> {
        self.at += 1;
        let negated = self.accept('^');
        let mut any = Vec::new();
        while let Some(class) = self.class()? {
            any.push(class);
        }
        if any.is_empty() || !self.accept(']') {
            let advice = self.peek().and_then(dialect::advice);
            return Err(self.expected(advice.unwrap_or(if any.is_empty() {
                EXPECTED_EVENT
            } else {
                "an event, or `]`"
            })));
        }
        Ok(EventPattern { any, negated })
    }

    /// Parses `<type scattering 'label'>`.
    fn angle(&mut self) -> Result<EventClass, ExpressionError> {
        self.at += 1;
        const TYPE: &str = "a type: `.`, one of C R T V L O B, or some of them in brackets";
        let kinds = self.part(type_of, TYPE)?;
        let kinds = kinds.ok_or_else(|| match self.peek() {
            Some(found) if scattering_of(found).is_some() => self.expected(SCATTERING_FIRST),
            Some(found) => self.expected(dialect::advice(found).unwrap_or(TYPE)),
            None => self.expected(TYPE),
        })?;
        let start = self.at;
        let scattering = "a scattering (`.`, one of D G S, or some of them in brackets), a label in quotes, or `>`";
        let kinds = match self.part(scattering_of, scattering)? {
            None => kinds,
            // Any scattering includes none: lamps, the camera and fog have no scattering letter.
            Some(ANY_KIND) => kinds,
            Some(scattering) => kinds & scattering,
        };
        if kinds == 0 {
            self.at = start;
            self.peek();
            return Err(self.expected("a label or `>`: only R and T have a scattering"));
        }
        let labels = match self.peek() {
            Some('.') => {
                self.at += 1;
                None
            }
            Some('\'') => Some((self.labels()?, false)),
            Some('[') => {
                self.at += 1;
                let negated = self.accept('^');
                let labels = self.labels()?;
                if !self.accept(']') {
                    return Err(self.expected("a label in quotes, or `]`"));
                }
                Some((labels, negated))
            }
            _ => None,
        };
        if !self.accept('>') {
            let advice = self.peek().and_then(|found| {
                let next = self.chars.get(self.at + 1);
                let is_word =
                    found.is_alphanumeric() && next.is_some_and(|next| next.is_alphanumeric() || *next == '.');
                if is_word { Some(BARE_LABEL) } else { dialect::advice(found) }
            });
            let plain = if labels.is_some() { "`>`" } else { "a label in quotes, or `>`" };
            return Err(self.expected(advice.unwrap_or(plain)));
        }
        Ok(EventClass { kinds, labels })
    }

    /// Parses a letter, a dot, or letters in brackets; `None`: something else follows. Brackets with labels count as something
    /// else.
    fn part(
        &mut self,
        kinds_of: fn(char) -> Option<u16>,
        wanted: &'static str,
    ) -> Result<Option<u16>, ExpressionError> {
        match self.peek() {
            Some('.') => {
                self.at += 1;
                Ok(Some(ANY_KIND))
            }
            Some('[') => {
                let start = self.at;
                self.at += 1;
                let negated = self.accept('^');
                if self.peek() == Some('\'') {
                    self.at = start;
                    return Ok(None);
                }
                let mut kinds = 0;
                while let Some(found) = self.peek().and_then(kinds_of) {
                    kinds |= found;
                    self.at += 1;
                }
                if kinds == 0 || !self.accept(']') {
                    return Err(self.expected(if kinds == 0 { wanted } else { "another letter, or `]`" }));
                }
                Ok(Some(if negated { ANY_KIND & !kinds } else { kinds }))
            }
            Some(letter) => Ok(kinds_of(letter).inspect(|_| self.at += 1)),
            None => Ok(None),
        }
    }

    fn labels(&mut self) -> Result<Vec<String>, ExpressionError> {
        let mut all = Vec::new();
        while self.peek() == Some('\'') {
            all.push(self.label()?);
        }
        if all.is_empty() { Err(self.expected("a label in quotes")) } else { Ok(all) }
    }

    /// Parses `'text'`, with `\'` for a quote and `\\` for a backslash.
    fn label(&mut self) -> Result<String, ExpressionError> {
        self.at += 1;
        let (start, mut label) = (self.at, String::new());
        loop {
            let next = self.chars.get(self.at).copied();
            self.at += 1;
            match next {
                Some('\'') if label.is_empty() => {
                    self.at = start;
                    return Err(self.expected("the text of a label"));
                }
                Some('\'') => return Ok(label),
                Some('\\') if matches!(self.chars.get(self.at), Some('\'' | '\\')) => {
                    label.push(self.chars[self.at]);
                    self.at += 1;
                }
                Some(other) => label.push(other),
                None => {
                    self.at = self.chars.len();
                    return Err(self.expected("`'`, which closes the label"));
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn fault(text: &str) -> (usize, &'static str) {
        let error = Expression::parse(text).expect_err(text);
        (error.position, error.expected)
    }

    #[test]
    fn a_fault_is_shown_under_its_place_with_what_was_expected() {
        let error = Expression::parse("C<RX>L").unwrap_err();
        let text = error.to_string();
        assert!(text.starts_with("found `X` at character 4; expected a label in quotes, or `>`"), "{text}");
        let lines: Vec<&str> = text.lines().collect();
        assert_eq!(lines[1..], ["    C<RX>L", "       ^"]);
        assert_eq!(lines[1].find('X'), lines[2].find('^'));
    }

    #[test]
    fn every_kind_of_fault_has_its_place() {
        for (text, at) in [
            ("", 0),
            ("CX", 1),
            ("C(DL", 4),
            ("CD)L", 2),
            ("C[DL", 4),
            ("C[]L", 2),
            ("C<", 2),
            ("C<D>", 2),
            ("C<LD>", 3),
            ("C<VD>", 3),
            ("C<R[DX]>", 5),
            ("C<L'a", 5),
            ("C<L''>", 4),
            ("*", 0),
            ("CD**L", 3),
            ("C||L", 2),
            ("C<R['a'D]>", 7),
        ] {
            assert_eq!(fault(text).0, at, "{text}: {:?}", fault(text));
        }
        assert_eq!(fault(&"(".repeat(70)).0, 64);
        assert_eq!(fault(&"C".repeat(5000)).0, 4096);
    }

    #[test]
    fn spaces_do_not_count_and_a_dot_is_everything() {
        assert_eq!(Expression::parse(" C <R D> * L "), Expression::parse("C<RD>*L"));
        assert_eq!(Expression::parse("C<...>L"), Expression::parse("C.L"));
        assert_eq!(Expression::parse("C[R]L").map(|e| e.0), Expression::parse("CRL").map(|e| e.0));
    }

    #[test]
    fn labels_may_hold_quotes() {
        let expression = Expression::parse(r"C<L.'it\'s \\ a.b'>").unwrap();
        assert_eq!(expression.events()[1].labels().collect::<Vec<_>>(), [r"it's \ a.b"]);
    }
}
