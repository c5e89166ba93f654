//! Positions of the parts of a template in its file.

use crate::values::TextPosition;
use openjd_model::PathElement;
use serde::Deserialize;
use serde::de::{Deserializer, MapAccess, SeqAccess, Visitor};
use serde_saphyr::{Location, Spanned};
use std::fmt;

/// The parts of a document and their positions. JSON is read as YAML, because it is valid YAML.
#[derive(Debug)]
pub struct PositionMap(Option<Spanned<Node>>);

/// A part of a document, without its scalars.
#[derive(Debug)]
enum Node {
    Map(Vec<(String, Spanned<Node>)>),
    List(Vec<Spanned<Node>>),
    Scalar,
}

impl PositionMap {
    /// Parses a text. If it cannot be parsed, no position is known.
    pub fn parse(text: &str) -> Self {
        Self(serde_saphyr::from_str(text).ok())
    }

    /// Returns the position of the part at `path`, or of the innermost existing part around it.
    pub fn find(&self, path: &[PathElement]) -> Option<TextPosition> {
        let mut at = self.0.as_ref()?;
        for element in path {
            let inner = match (&at.value, element) {
                (Node::Map(fields), PathElement::Field(name)) => {
                    fields.iter().find(|(key, _)| key == name).map(|(_, v)| v)
                }
                (Node::List(items), PathElement::Index(index)) => items.get(*index),
                _ => None,
            };
            let Some(inner) = inner else { break };
            at = inner;
        }
        to_position(at.referenced)
    }
}

/// Converts a position, if it is known.
pub fn to_position(location: Location) -> Option<TextPosition> {
    let [line, column] = [location.line(), location.column()].map(|number| usize::try_from(number).unwrap_or(0));
    (line > 0 && column > 0).then_some(TextPosition { line, column })
}

impl<'de> Deserialize<'de> for Node {
    fn deserialize<D: Deserializer<'de>>(from: D) -> Result<Self, D::Error> {
        from.deserialize_any(AnyNode)
    }
}

struct AnyNode;

impl<'de> Visitor<'de> for AnyNode {
    type Value = Node;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("any part of a document")
    }

    fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<Node, A::Error> {
        let mut fields = Vec::new();
        while let Some(entry) = map.next_entry()? {
            fields.push(entry);
        }
        Ok(Node::Map(fields))
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut list: A) -> Result<Node, A::Error> {
        let mut items = Vec::new();
        while let Some(item) = list.next_element()? {
            items.push(item);
        }
        Ok(Node::List(items))
    }

    fn visit_bool<E>(self, _: bool) -> Result<Node, E> {
        Ok(Node::Scalar)
    }

    fn visit_i64<E>(self, _: i64) -> Result<Node, E> {
        Ok(Node::Scalar)
    }

    fn visit_u64<E>(self, _: u64) -> Result<Node, E> {
        Ok(Node::Scalar)
    }

    fn visit_f64<E>(self, _: f64) -> Result<Node, E> {
        Ok(Node::Scalar)
    }

    fn visit_str<E>(self, _: &str) -> Result<Node, E> {
        Ok(Node::Scalar)
    }

    fn visit_unit<E>(self) -> Result<Node, E> {
        Ok(Node::Scalar)
    }
}
