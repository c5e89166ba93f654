//! Queries for paths, by the places that they visited and the light found there.
//!
//! A [`Condition`] is evaluated at each intersection of a path. For a path without intersections, it is evaluated once without an
//! intersection:
//!
//! ```text
//! radiance.g > 2 and bounce == 2 and (interaction == reflection or object == room.mirror)
//! ```
//!
//! | name | of | value |
//! | --- | --- | --- |
//! | `bounce`, `position.x` `.y` `.z`, `radiance.r` `.g` `.b`, `throughput.r` `.g` `.b` | the intersection | number |
//! | `object`, `material` | the intersection | name |
//! | `interaction` | the intersection | a word of [`InteractionKind`] |
//! | `light`, `occluder` | any light sampled there | name |
//! | `light.radiance.r` `.g` `.b` | any of them | number |
//! | `found` | any of them | a word of [`LightTechnique`] |
//! | `path.radiance.r` `.g` `.b`, `path.throughput.r` `.g` `.b`, `depth`, `pixel.x`, `pixel.y`, `sample` | the path | number |
//! | `end` | the path | a word of [`PathEnd`] |
//!
//! Numbers are compared with `==`, `!=`, `<`, `<=`, `>`, `>=`, words with the first two. A name matches an object and everything in
//! it: `room` matches `room.wall`, too. A missing value equals nothing: `occluder != door` holds if nothing is in the way,
//! `occluder == door` does not.

use crate::record::{InteractionKind, Intersection, LightPath, LightRecord, LightTechnique, Name, Names, PathEnd};
use crate::statistics::Scope;
use std::collections::BTreeSet;

/// A query for paths.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Query {
    /// Condition on an intersection. `None` accepts any path, even one without intersections.
    pub condition: Option<Condition>,
    /// Objects that the path must visit in this order: the first at any intersection, each of the others at any later one.
    pub objects: Vec<String>,
    /// Corners of a box, world, m, that must contain the intersection.
    pub within: Option<[[f64; 3]; 2]>,
}

/// A condition.
#[derive(Clone, Debug, PartialEq)]
pub enum Condition {
    /// Both conditions hold.
    And(Box<Self>, Box<Self>),
    /// At least one of the conditions holds.
    Or(Box<Self>, Box<Self>),
    /// The condition does not hold.
    Not(Box<Self>),
    /// Comparison of a number.
    Number(NumberField, CompareOp, f64),
    /// Comparison of a word or a name.
    Word(WordField, EqualityOp, String),
}

/// Comparison operator of numbers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CompareOp {
    /// `==`
    Equal,
    /// `!=`
    Unequal,
    /// `<`
    Below,
    /// `<=`
    AtMost,
    /// `>`
    Above,
    /// `>=`
    AtLeast,
}

impl CompareOp {
    fn compare(self, a: f64, b: f64) -> bool {
        match self {
            Self::Equal => a == b,
            Self::Unequal => a != b,
            Self::Below => a < b,
            Self::AtMost => a <= b,
            Self::Above => a > b,
            Self::AtLeast => a >= b,
        }
    }
}

/// Comparison operator of words.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum EqualityOp {
    /// `==`
    Is,
    /// `!=`
    IsNot,
}

/// A number of a path, an intersection or a light.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum NumberField {
    /// `bounce`
    Bounce,
    /// `position`, by axis
    Position(usize),
    /// `radiance`, by channel
    Radiance(usize),
    /// `throughput`, by channel
    Throughput(usize),
    /// `light.radiance`, by channel
    LightRadiance(usize),
    /// `path.radiance`, by channel
    PathRadiance(usize),
    /// `path.throughput`, by channel
    PathThroughput(usize),
    /// `depth`
    Depth,
    /// `pixel`, by axis
    Pixel(usize),
    /// `sample`
    Sample,
}

/// A word of a path, an intersection or a light.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum WordField {
    /// `object`
    Object,
    /// `material`
    Material,
    /// `interaction`
    Interaction,
    /// `light`
    Light,
    /// `occluder`
    Occluder,
    /// `found`
    Technique,
    /// `end`
    End,
}

/// Reason why a text is not a valid condition.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum QueryError {
    /// Unexpected text.
    #[error("column {column}: found {found:?}, expected {expected}")]
    Expected {
        /// Column in the text, from 1.
        column: usize,
        /// Text found there; empty at the end of the text.
        found: String,
        /// Text expected there.
        expected: &'static str,
    },
    /// Unknown name.
    #[error("column {column}: unknown name {name:?}; known names: {}", KNOWN.join(", "))]
    UnknownName {
        /// Column in the text, from 1.
        column: usize,
        /// The name.
        name: String,
    },
    /// Unknown word.
    #[error("column {column}: {name} cannot be {word:?}; it is one of {}", .words.join(", "))]
    UnknownWord {
        /// Column in the text, from 1.
        column: usize,
        /// Name that is compared.
        name: String,
        /// The word.
        word: String,
        /// Words that are known.
        words: Vec<&'static str>,
    },
    /// Conditions are nested too deep.
    #[error("more than {MAX_DEPTH} nested conditions")]
    TooDeep,
    /// The condition is too long.
    #[error("more than {MAX_TOKENS} words and signs")]
    TooLong,
}

/// Names in conditions, for error messages.
const KNOWN: [&str; 17] = [
    "bounce",
    "position.x",
    "radiance.r",
    "throughput.r",
    "object",
    "material",
    "interaction",
    "light",
    "occluder",
    "light.radiance.r",
    "found",
    "path.radiance.r",
    "path.throughput.r",
    "depth",
    "pixel.x",
    "sample",
    "end",
];

/// Maximum nesting depth of conditions.
const MAX_DEPTH: usize = 64;
/// Maximum number of words and signs of a condition.
const MAX_TOKENS: usize = 2048;

enum Field {
    Number(NumberField),
    Word(WordField),
}

fn parse_field(name: &str) -> Option<Field> {
    let part = |prefix: &str, parts: &str| {
        let rest = name.strip_prefix(prefix)?;
        (rest.len() == 1).then(|| parts.find(rest)).flatten()
    };
    let number = match name {
        "bounce" => Some(NumberField::Bounce),
        "depth" => Some(NumberField::Depth),
        "sample" => Some(NumberField::Sample),
        _ => None,
    };
    let number = number
        .or_else(|| part("position.", "xyz").map(NumberField::Position))
        .or_else(|| part("radiance.", "rgb").map(NumberField::Radiance))
        .or_else(|| part("throughput.", "rgb").map(NumberField::Throughput))
        .or_else(|| part("light.radiance.", "rgb").map(NumberField::LightRadiance))
        .or_else(|| part("path.radiance.", "rgb").map(NumberField::PathRadiance))
        .or_else(|| part("path.throughput.", "rgb").map(NumberField::PathThroughput))
        .or_else(|| part("pixel.", "xy").map(NumberField::Pixel));
    let word = match name {
        "object" => Some(WordField::Object),
        "material" => Some(WordField::Material),
        "interaction" => Some(WordField::Interaction),
        "light" => Some(WordField::Light),
        "occluder" => Some(WordField::Occluder),
        "found" => Some(WordField::Technique),
        "end" => Some(WordField::End),
        _ => None,
    };
    number.map(Field::Number).or(word.map(Field::Word))
}

/// Returns the known words. It is empty for names, which may be anything.
fn known_words(word: WordField) -> Vec<&'static str> {
    match word {
        WordField::Object | WordField::Material | WordField::Light | WordField::Occluder => Vec::new(),
        WordField::Interaction => InteractionKind::ALL.iter().map(|it| it.word()).collect(),
        WordField::Technique => LightTechnique::ALL.iter().map(|it| it.word()).collect(),
        WordField::End => PathEnd::ALL.iter().map(|it| it.word()).collect(),
    }
}

impl Condition {
    /// Parses a condition.
    pub fn parse(text: &str) -> Result<Self, QueryError> {
        let mut parser = Parser { tokens: tokenize(text)?, at: 0, depth: 0 };
        let condition = parser.disjunction()?;
        match parser.tokens.get(parser.at) {
            None => Ok(condition),
            Some(_) => Err(parser.expected("`and`, `or` or the end")),
        }
    }

    fn holds(&self, context: &QueryContext<'_>) -> bool {
        match self {
            Self::And(a, b) => a.holds(context) && b.holds(context),
            Self::Or(a, b) => a.holds(context) || b.holds(context),
            Self::Not(condition) => !condition.holds(context),
            Self::Number(number, order, value) => context.has_number(*number, |own| order.compare(own, *value)),
            Self::Word(word, EqualityOp::Is, value) => context.has_word(*word, value),
            Self::Word(word, EqualityOp::IsNot, value) => !context.has_word(*word, value),
        }
    }
}

/// A token of a condition, with its column.
type Token = (usize, String);

fn tokenize(text: &str) -> Result<Vec<Token>, QueryError> {
    let (mut all, mut rest) = (Vec::new(), text);
    loop {
        rest = rest.trim_start();
        let column = text.len() - rest.len() + 1;
        let Some(first) = rest.chars().next() else { return Ok(all) };
        let is_word = |c: char| c.is_alphanumeric() || "._-+/#:".contains(c);
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
            _ if is_word(first) => rest.find(|c| !is_word(c)).unwrap_or(rest.len()),
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
        } else if self.accept("(") {
            let inner = self.disjunction()?;
            if !self.accept(")") {
                return Err(self.expected("`)`"));
            }
            inner
        } else {
            self.comparison()?
        };
        self.depth -= 1;
        Ok(condition)
    }

    fn comparison(&mut self) -> Result<Condition, QueryError> {
        let missing = self.expected("a name");
        let (column, name) = self.next().ok_or(missing.clone())?;
        if !name.starts_with(char::is_alphabetic) {
            return Err(missing);
        }
        let field = parse_field(&name).ok_or_else(|| QueryError::UnknownName { column, name: name.clone() })?;
        let order = self.compare_op()?;
        match field {
            Field::Number(number) => {
                let missing = self.expected("a number");
                let value = self.next().and_then(|(_, text)| text.parse::<f64>().ok());
                Ok(Condition::Number(number, order, value.filter(|value| value.is_finite()).ok_or(missing)?))
            }
            Field::Word(word) => {
                let equality = match order {
                    CompareOp::Equal => EqualityOp::Is,
                    CompareOp::Unequal => EqualityOp::IsNot,
                    _ => {
                        self.at -= 1;
                        return Err(self.expected("`==` or `!=`"));
                    }
                };
                let missing = self.expected("a word");
                let (column, value) = self.next().ok_or(missing.clone())?;
                let value = match value.strip_prefix('"').and_then(|text| text.strip_suffix('"')) {
                    Some(text) => text.to_owned(),
                    None if value.starts_with(|c| "()=!<>".contains(c)) => return Err(missing),
                    None => value,
                };
                let words = known_words(word);
                if !words.is_empty() && !words.contains(&value.as_str()) {
                    return Err(QueryError::UnknownWord { column, name, word: value, words });
                }
                Ok(Condition::Word(word, equality, value))
            }
        }
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

/// An intersection of a path, or only the path.
struct QueryContext<'a> {
    scope: &'a Scope,
    names: &'a Names,
    path: &'a LightPath,
    /// Index of the intersection in the path.
    index: Option<usize>,
}

impl QueryContext<'_> {
    fn intersection(&self) -> Option<&Intersection> {
        self.index.and_then(|place| self.path.intersections.get(place))
    }

    fn lights(&self) -> impl Iterator<Item = &LightRecord> {
        let vertex = self.index.map_or(0, |place| place as u32 + 1);
        self.path.lights.iter().filter(move |light| light.vertex == vertex)
    }

    fn has_number(&self, number: NumberField, holds: impl Fn(f64) -> bool) -> bool {
        let of_intersection = |get: &dyn Fn(&Intersection) -> f64| self.intersection().is_some_and(|it| holds(get(it)));
        let width = self.scope.film[0].max(1);
        match number {
            NumberField::Bounce => of_intersection(&|it| f64::from(it.bounce)),
            NumberField::Position(axis) => of_intersection(&|it| it.position[axis]),
            NumberField::Radiance(channel) => of_intersection(&|it| f64::from(it.radiance[channel])),
            NumberField::Throughput(channel) => of_intersection(&|it| f64::from(it.throughput[channel])),
            NumberField::LightRadiance(channel) => self.lights().any(|it| holds(f64::from(it.radiance[channel]))),
            NumberField::PathRadiance(channel) => holds(f64::from(self.path.radiance[channel])),
            NumberField::PathThroughput(channel) => holds(f64::from(self.path.throughput[channel])),
            NumberField::Depth => holds(f64::from(self.path.depth)),
            NumberField::Pixel(0) => holds(f64::from(self.path.key.pixel % width)),
            NumberField::Pixel(_) => holds(f64::from(self.path.key.pixel / width)),
            NumberField::Sample => holds(f64::from(self.path.key.sample)),
        }
    }

    fn has_word(&self, word: WordField, value: &str) -> bool {
        let is = |name: Name| is_named(self.names, name, value);
        match word {
            WordField::Object => self.intersection().is_some_and(|it| is(it.object)),
            WordField::Material => self.intersection().is_some_and(|it| is(it.material)),
            WordField::Interaction => self.intersection().is_some_and(|it| it.interaction.word() == value),
            WordField::Light => self.lights().any(|it| is(it.light)),
            WordField::Occluder => self.lights().any(|it| it.occluder.is_some_and(is)),
            WordField::Technique => self.lights().any(|it| it.technique.word() == value),
            WordField::End => self.path.end.word() == value,
        }
    }
}

/// Checks whether a name is `value` or lies in `value`.
pub fn is_within(names: &Names, name: Name, value: &str) -> bool {
    is_named(names, name, value)
}

fn is_named(names: &Names, name: Name, value: &str) -> bool {
    let rest = names.get(&name).and_then(|(_, text)| text.strip_prefix(value));
    rest.is_some_and(|rest| rest.is_empty() || rest.starts_with(['.', '/']))
}

impl Query {
    /// Returns the indices of the intersections of a path that match, or `None` if the path does not match. A path without
    /// intersections can match with an empty set.
    pub fn matches(&self, scope: &Scope, names: &Names, path: &LightPath) -> Option<BTreeSet<usize>> {
        let mut later = path.intersections.iter();
        for object in &self.objects {
            later.find(|it| is_named(names, it.object, object))?;
        }
        let is_within = |place: usize| {
            let [low, high] = self.within.unwrap_or([[f64::NEG_INFINITY; 3], [f64::INFINITY; 3]]);
            let position = path.intersections[place].position;
            (0..3).all(|axis| (low[axis]..=high[axis]).contains(&position[axis]))
        };
        let holds = |place: Option<usize>| {
            let context = QueryContext { scope, names, path, index: place };
            self.condition.as_ref().is_none_or(|condition| condition.holds(&context))
        };
        if path.intersections.is_empty() {
            return (self.within.is_none() && holds(None)).then(BTreeSet::new);
        }
        let places: BTreeSet<usize> =
            (0..path.intersections.len()).filter(|&place| is_within(place) && holds(Some(place))).collect();
        (!places.is_empty()).then_some(places)
    }
}

/// Checks whether a name is known, as the name of an object or of a parent of objects.
pub fn is_known_name(names: &Names, value: &str) -> bool {
    names.keys().any(|name| is_named(names, *name, value))
}
