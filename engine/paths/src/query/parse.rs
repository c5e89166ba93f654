//! Parser of conditions.

use super::{CompareOp, Condition, EqualityOp, Quantity, QueryError};
use crate::attribute::Attribute;
use crate::schema::Scale;

/// Maximum nesting depth of conditions.
pub(super) const MAX_DEPTH: usize = 64;
/// Maximum number of words and signs of a condition.
pub(super) const MAX_TOKENS: usize = 2048;
/// Maximum number of quantifiers of a condition.
pub(super) const MAX_QUANTIFIERS: usize = 64;

impl Condition {
    /// Parses a condition.
    pub fn parse(text: &str) -> Result<Self, QueryError> {
        let mut parser = Parser { tokens: tokenize(text)?, at: 0, depth: 0, quantifiers: 0 };
        let condition = parser.disjunction()?;
        match parser.tokens.get(parser.at) {
            None => Ok(condition),
            Some(_) => Err(parser.expected("`and`, `or` or the end")),
        }
    }
}

/// A token of a condition, with its column.
type Token = (usize, String);

/// Checks whether a name may contain the character without quotation marks.
pub(super) fn is_word_character(c: char) -> bool {
    c.is_alphanumeric() || "._-+/#:".contains(c)
}

fn tokenize(text: &str) -> Result<Vec<Token>, QueryError> {
    let (mut all, mut rest) = (Vec::new(), text);
    loop {
        rest = rest.trim_start();
        let column = text.len() - rest.len() + 1;
        let Some(first) = rest.chars().next() else { return Ok(all) };
        let length = match first {
            '(' | ')' => 1,
            '"' => match rest[1..].find('"') {
                Some(end) => end + 2,
                None => {
                    let found = rest.to_owned();
                    return Err(QueryError::Expected { column, found, expected: "a closing quotation mark" });
                }
            },
            '=' | '!' | '<' | '>' => rest.find(|c| !"=!<>".contains(c)).unwrap_or(rest.len()),
            _ if is_word_character(first) => rest.find(|c| !is_word_character(c)).unwrap_or(rest.len()),
            _ => first.len_utf8(),
        };
        if all.len() == MAX_TOKENS {
            return Err(QueryError::TooLong);
        }
        all.push((column, rest[..length].to_owned()));
        rest = &rest[length..];
    }
}

struct Parser {
    tokens: Vec<Token>,
    at: usize,
    depth: usize,
    /// Number of quantifiers so far.
    quantifiers: usize,
}

impl Parser {
    fn next(&mut self) -> Option<Token> {
        let token = self.tokens.get(self.at).cloned();
        self.at += 1;
        token
    }

    fn accept(&mut self, word: &str) -> bool {
        let takes = self.tokens.get(self.at).is_some_and(|(_, token)| token == word);
        self.at += usize::from(takes);
        takes
    }

    fn is_next(&self, word: &str, ahead: usize) -> bool {
        self.tokens.get(self.at + ahead).is_some_and(|(_, token)| token == word)
    }

    fn require(&mut self, word: &str, expected: &'static str) -> Result<(), QueryError> {
        if self.accept(word) { Ok(()) } else { Err(self.expected(expected)) }
    }

    fn expected(&self, expected: &'static str) -> QueryError {
        let end = self.tokens.last().map_or(1, |(column, token)| column + token.len());
        let (column, found) = self.tokens.get(self.at).cloned().unwrap_or((end, String::new()));
        QueryError::Expected { column, found, expected }
    }

    fn disjunction(&mut self) -> Result<Condition, QueryError> {
        let mut all = self.conjunction()?;
        while self.accept("or") {
            all = Condition::Or(Box::new(all), Box::new(self.conjunction()?));
        }
        Ok(all)
    }

    fn conjunction(&mut self) -> Result<Condition, QueryError> {
        let mut all = self.term()?;
        while self.accept("and") {
            all = Condition::And(Box::new(all), Box::new(self.term()?));
        }
        Ok(all)
    }

    fn term(&mut self) -> Result<Condition, QueryError> {
        self.depth += 1;
        if self.depth > MAX_DEPTH {
            return Err(QueryError::TooDeep);
        }
        let condition = if self.accept("not") {
            Condition::Not(Box::new(self.term()?))
        } else if self.is_next("(", 0) {
            self.in_parentheses()?
        } else if self.is_next("(", 1)
            && let Some(bind) = self.accept_quantifier()
        {
            self.quantifiers += 1;
            if self.quantifiers > MAX_QUANTIFIERS {
                return Err(QueryError::TooManyQuantifiers);
            }
            bind(Box::new(self.in_parentheses()?))
        } else if self.accept("in") {
            self.region()?
        } else if self.is_next("then", 1) {
            self.sequence()?
        } else {
            self.comparison()?
        };
        self.depth -= 1;
        Ok(condition)
    }

    fn in_parentheses(&mut self) -> Result<Condition, QueryError> {
        self.require("(", "`(`")?;
        let inner = self.disjunction()?;
        self.require(")", "`)`")?;
        Ok(inner)
    }

    fn accept_quantifier(&mut self) -> Option<fn(Box<Condition>) -> Condition> {
        let bind: fn(Box<Condition>) -> Condition = match self.tokens.get(self.at)?.1.as_str() {
            "any" => |inner| Condition::Intersections(Quantity::Any, inner),
            "all" => |inner| Condition::Intersections(Quantity::All, inner),
            "light" => |inner| Condition::Lights(Quantity::Any, inner),
            "lights" => |inner| Condition::Lights(Quantity::All, inner),
            _ => return None,
        };
        self.at += 1;
        Some(bind)
    }

    /// Parses a box or a lasso, after `in`.
    fn region(&mut self) -> Result<Condition, QueryError> {
        if self.accept("box") {
            let missing = self.expected("six numbers in parentheses, the lower corner before the upper");
            return match self.numbers()?[..] {
                [a, b, c, d, e, f] if a <= d && b <= e && c <= f => Ok(Condition::InBox([[a, b, c], [d, e, f]])),
                _ => Err(missing),
            };
        }
        self.require("lasso", "`box` or `lasso`")?;
        let missing = self.expected("three or more points in parentheses, as X,Y,X,Y");
        let numbers = self.numbers()?;
        let (points, rest) = numbers.as_chunks::<2>();
        if points.len() < 3 || !rest.is_empty() {
            return Err(missing);
        }
        Ok(Condition::InLasso(points.to_vec()))
    }

    /// Parses numbers in parentheses, separated by commas.
    fn numbers(&mut self) -> Result<Vec<f64>, QueryError> {
        self.require("(", "`(`")?;
        let mut all = vec![self.number()?];
        while self.accept(",") {
            all.push(self.number()?);
        }
        self.require(")", "`,` or `)`")?;
        Ok(all)
    }

    fn number(&mut self) -> Result<f64, QueryError> {
        let missing = self.expected("a number");
        let value = self.next().and_then(|(_, text)| text.parse::<f64>().ok());
        value.filter(|value| value.is_finite()).ok_or(missing)
    }

    /// Parses names of objects, separated by `then`.
    fn sequence(&mut self) -> Result<Condition, QueryError> {
        let mut names = vec![self.name()?];
        while self.accept("then") {
            names.push(self.name()?);
        }
        Ok(Condition::Sequence(names))
    }

    /// Parses a name or a word, in quotation marks or not.
    fn name(&mut self) -> Result<String, QueryError> {
        let missing = self.expected("a word");
        let (_, value) = self.next().ok_or(missing.clone())?;
        match value.strip_prefix('"').and_then(|text| text.strip_suffix('"')) {
            Some(text) => Ok(text.to_owned()),
            None if value.starts_with(|c| "()=!<>,".contains(c)) => Err(missing),
            None => Ok(value),
        }
    }

    fn comparison(&mut self) -> Result<Condition, QueryError> {
        let missing = self.expected("a name");
        let (column, name) = self.next().ok_or(missing.clone())?;
        if !name.starts_with(char::is_alphabetic) {
            return Err(missing);
        }
        let attribute =
            Attribute::from_field(&name).ok_or_else(|| QueryError::UnknownName { column, name: name.clone() })?;
        let order = self.compare_op()?;
        // Names may be anything.
        let words = match attribute.scale {
            Scale::Class(words) => words.list(),
            Scale::Name => Vec::new(),
            Scale::Film(_) | Scale::World(_) | Scale::Radiance | Scale::Throughput | Scale::Count => {
                return Ok(Condition::Number(attribute, order, self.number()?));
            }
        };
        let equality = match order {
            CompareOp::Equal => EqualityOp::Is,
            CompareOp::Unequal => EqualityOp::IsNot,
            _ => {
                self.at -= 1;
                return Err(self.expected("`==` or `!=`"));
            }
        };
        let column = self.tokens.get(self.at).map_or(0, |(column, _)| *column);
        let value = self.name()?;
        if !words.is_empty() && !words.contains(&value.as_str()) {
            return Err(QueryError::UnknownWord { column, name, word: value, words });
        }
        Ok(Condition::Word(attribute, equality, value))
    }

    fn compare_op(&mut self) -> Result<CompareOp, QueryError> {
        let missing = self.expected("`==`, `!=`, `<`, `<=`, `>` or `>=`");
        match self.next().as_ref().map(|(_, token)| token.as_str()) {
            Some("==" | "=") => Ok(CompareOp::Equal),
            Some("!=") => Ok(CompareOp::Unequal),
            Some("<") => Ok(CompareOp::Below),
            Some("<=") => Ok(CompareOp::AtMost),
            Some(">") => Ok(CompareOp::Above),
            Some(">=") => Ok(CompareOp::AtLeast),
            _ => Err(missing),
        }
    }
}
