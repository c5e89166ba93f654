//! Queries for paths, by the places that they visited and the light found there.
//!
//! A [`Condition`] is evaluated at each intersection of a path. For a path without intersections, it is evaluated once without an
//! intersection:
//!
//! ```text
//! radiance.g > 2 and bounce == 2 and (interaction == reflection or object == room.mirror)
//! ```
//!
//! The names are the fields of the attributes ([`Attribute::all`](crate::attribute::Attribute::all)). A name of an intersection
//! means this intersection, a name of a light any light sampled there.
//!
//! Numbers are compared with `==`, `!=`, `<`, `<=`, `>`, `>=`, words with the first two. A name matches an object and everything in
//! it: `room` matches `room.wall`, too. A missing value equals nothing, and `!=` holds if `==` does not: `occluder != door` holds if
//! nothing is in the way, and `first.x != 2` holds for a path without intersections.
//!
//! More terms, which `and`, `or` and `not` join with the others:
//!
//! | term | holds if |
//! | --- | --- |
//! | `any(C)`, `all(C)` | C holds at some intersection of the path, or at all of them |
//! | `light(C)`, `lights(C)` | C holds for some light of the path, or for all of them |
//! | `NAME then NAME ...` | the path visits these objects in this order |
//! | `in box(X,Y,Z,X,Y,Z)` | the intersection lies in the box with this lower and upper corner, world, m |
//! | `in lasso(X,Y,X,Y,X,Y ...)` | the center of the path's pixel lies within the closed line, pixels (even-odd rule) |
//!
//! Within `light` and `lights`, names of lights refer to that one light, and names of intersections to the intersection where it was
//! sampled. A condition has at most 64 terms `any`, `all`, `light` and `lights`.
//!
//! A query selects paths, intersections and lights ([`Selection`]). A path is selected if the condition holds at some intersection.
//! An intersection of a selected path is selected if the condition holds for it alone: there, `any(C)` and `all(C)` mean C at this
//! intersection, `light(C)` and `lights(C)` mean C for the lights sampled there. A condition without these four terms selects all
//! lights of its paths. Any other condition selects the lights for which it holds alone: there, `light(C)` and `lights(C)` mean C
//! for this light.

mod matcher;
mod parse;

pub use matcher::{Matcher, Selection};

use crate::attribute::Attribute;
use crate::record::{Name, Names};
use parse::{MAX_DEPTH, MAX_QUANTIFIERS, MAX_TOKENS};
use std::fmt;

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
    Number(&'static Attribute, CompareOp, f64),
    /// Comparison of a word or a name.
    Word(&'static Attribute, EqualityOp, String),
    /// The condition holds at this many of the path's intersections.
    Intersections(Quantity, Box<Self>),
    /// The condition holds for this many of the path's lights.
    Lights(Quantity, Box<Self>),
    /// The path visits these objects in this order: the first at any intersection, each of the others at any later one.
    Sequence(Vec<String>),
    /// The intersection lies in the box with these corners, world, m.
    InBox([[f64; 3]; 2]),
    /// The center of the path's pixel lies within the closed line, pixels.
    InLasso(Vec<[f64; 2]>),
}

/// Number of things for which a condition must hold.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Quantity {
    /// At least one.
    Any,
    /// Every one. For lights, the condition also holds if there are none. A path without intersections is examined once without an
    /// intersection.
    All,
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

/// Comparison operator of words.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum EqualityOp {
    /// `==`
    Is,
    /// `!=`
    IsNot,
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
    #[error("column {column}: unknown name {name:?}; known names: {}", known_names())]
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
    /// Too many quantifiers.
    #[error("more than {MAX_QUANTIFIERS} conditions any(..), all(..), light(..), lights(..)")]
    TooManyQuantifiers,
}

/// Returns the names in conditions for error messages, without the further axes and channels.
fn known_names() -> String {
    let is_first = |field: &&str| ![".y", ".z", ".g", ".b"].iter().any(|end| field.ends_with(end));
    Attribute::all().map(|it| it.field).filter(is_first).collect::<Vec<_>>().join(", ")
}

impl Query {
    /// Returns the whole query as one condition; `None` accepts any path.
    pub fn to_condition(&self) -> Option<Condition> {
        let sequence = (!self.objects.is_empty()).then(|| Condition::Sequence(self.objects.clone()));
        let within = self.within.map(Condition::InBox);
        [sequence, within, self.condition.clone()]
            .into_iter()
            .flatten()
            .reduce(|all, next| Condition::And(Box::new(all), Box::new(next)))
    }
}

/// Checks whether a name is `value` or lies in `value`.
pub fn is_within(names: &Names, name: Name, value: &str) -> bool {
    names.get(&name).is_some_and(|(_, text)| is_text_within(text, value))
}

/// Checks whether a name is known, as the name of an object or of a parent of objects.
pub fn is_known_name(names: &Names, value: &str) -> bool {
    names.values().any(|(_, text)| is_text_within(text, value))
}

fn is_text_within(text: &str, value: &str) -> bool {
    text.strip_prefix(value).is_some_and(|rest| rest.is_empty() || rest.starts_with(['.', '/']))
}

/// Writes the text from which [`Condition::parse`] reads the same condition.
impl fmt::Display for Condition {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::And(a, b) => write!(f, "{} and {}", Operand(a, is_or), Operand(b, is_and_or_or)),
            Self::Or(a, b) => write!(f, "{a} or {}", Operand(b, is_or)),
            Self::Not(inner) => write!(f, "not {}", Operand(inner, is_and_or_or)),
            Self::Number(attribute, op, value) => write!(f, "{} {op} {value}", attribute.field),
            Self::Word(attribute, op, value) => write!(f, "{} {op} {}", attribute.field, Quoted(value)),
            Self::Intersections(Quantity::Any, inner) => write!(f, "any({inner})"),
            Self::Intersections(Quantity::All, inner) => write!(f, "all({inner})"),
            Self::Lights(Quantity::Any, inner) => write!(f, "light({inner})"),
            Self::Lights(Quantity::All, inner) => write!(f, "lights({inner})"),
            Self::Sequence(names) => {
                for (place, name) in names.iter().enumerate() {
                    write!(f, "{}{}", if place > 0 { " then " } else { "" }, Quoted(name))?;
                }
                Ok(())
            }
            Self::InBox(corners) => write!(f, "in box({})", Numbers(corners.as_flattened())),
            Self::InLasso(points) => write!(f, "in lasso({})", Numbers(points.as_flattened())),
        }
    }
}

fn is_or(condition: &Condition) -> bool {
    matches!(condition, Condition::Or(..))
}

fn is_and_or_or(condition: &Condition) -> bool {
    matches!(condition, Condition::And(..) | Condition::Or(..))
}

/// An operand, in parentheses if the predicate asks for them.
struct Operand<'a>(&'a Condition, fn(&Condition) -> bool);

impl fmt::Display for Operand<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self(condition, needs_parentheses) = self;
        if needs_parentheses(condition) { write!(f, "({condition})") } else { condition.fmt(f) }
    }
}

/// A name or a word, in quotation marks unless it is a single token that no keyword equals.
struct Quoted<'a>(&'a str);

impl fmt::Display for Quoted<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let is_plain = self.0.starts_with(char::is_alphabetic)
            && self.0.chars().all(parse::is_word_character)
            && !matches!(self.0, "and" | "or" | "not" | "then" | "in" | "any" | "all" | "light" | "lights");
        if is_plain { f.write_str(self.0) } else { write!(f, "\"{}\"", self.0) }
    }
}

/// Numbers separated by commas.
struct Numbers<'a>(&'a [f64]);

impl fmt::Display for Numbers<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for (place, number) in self.0.iter().enumerate() {
            write!(f, "{}{number}", if place > 0 { "," } else { "" })?;
        }
        Ok(())
    }
}

impl fmt::Display for CompareOp {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Equal => "==",
            Self::Unequal => "!=",
            Self::Below => "<",
            Self::AtMost => "<=",
            Self::Above => ">",
            Self::AtLeast => ">=",
        })
    }
}

impl fmt::Display for EqualityOp {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Is => "==",
            Self::IsNot => "!=",
        })
    }
}
