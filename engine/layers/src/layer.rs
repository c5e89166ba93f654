//! Layers: expressions with names for their channels.

use crate::error::LayerError;
use crate::expression::Expression;
use crate::feature::Feature;
use serde::{Deserialize, Serialize};
use std::collections::BTreeSet;
use std::str::FromStr;

/// Maximum number of layers of a frame: one bit each in a word.
pub const MAX_LAYERS: usize = 64;

/// Names of other channels in the file, which layers cannot use.
const RESERVED_NAMES: [&str; 4] = ["samples", "variance", "coverage", "relative_error"];

/// A layer as the user requests it.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub struct Layer {
    /// Name of its channels.
    pub name: String,
    /// Light path expression that selects the light of the layer.
    pub expression: String,
}

impl Layer {
    /// Creates a layer with this name and expression.
    pub fn new(name: impl Into<String>, expression: impl Into<String>) -> Self {
        Self { name: name.into(), expression: expression.into() }
    }

    /// Parses the expression.
    /// - errors: the name or the expression is invalid.
    pub fn parse(&self) -> Result<Expression, LayerError> {
        let is_fit = |c: char| c.is_ascii_alphanumeric() || c == '_' || c == '-';
        if !(1..=64).contains(&self.name.len()) || !self.name.chars().all(is_fit) {
            return Err(LayerError::InvalidName(self.name.clone()));
        }
        if RESERVED_NAMES.contains(&self.name.as_str()) || Feature::is_reserved_name(&self.name) {
            return Err(LayerError::ReservedName(self.name.clone()));
        }
        Expression::parse(&self.expression).map_err(|cause| LayerError::Expression { layer: self.name.clone(), cause })
    }
}

impl FromStr for Layer {
    type Err = LayerError;

    fn from_str(text: &str) -> Result<Self, LayerError> {
        let (name, expression) = text.split_once('=').ok_or_else(|| LayerError::InvalidForm(text.to_owned()))?;
        let layer = Self::new(name.trim(), expression.trim());
        layer.parse().map(|_| layer)
    }
}

/// Parses the expressions of all layers of a frame.
pub fn parse_layers(layers: &[Layer]) -> Result<Vec<Expression>, LayerError> {
    if layers.len() > MAX_LAYERS {
        return Err(LayerError::TooManyLayers(layers.len()));
    }
    let mut names = BTreeSet::new();
    if let Some(twice) = layers.iter().find(|layer| !names.insert(&layer.name)) {
        return Err(LayerError::DuplicateName(twice.name.clone()));
    }
    layers.iter().map(Layer::parse).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn layer_is_name_and_expression_and_anything_else_is_refused() {
        assert_eq!("direct = CDL".parse(), Ok(Layer::new("direct", "CDL")));
        assert_eq!("CDL".parse::<Layer>(), Err(LayerError::InvalidForm("CDL".into())));
        assert_eq!("a.b=CDL".parse::<Layer>(), Err(LayerError::InvalidName("a.b".into())));
        assert_eq!("=CDL".parse::<Layer>(), Err(LayerError::InvalidName(String::new())));
        assert_eq!("samples=CDL".parse::<Layer>(), Err(LayerError::ReservedName("samples".into())));
        assert_eq!("motion=CDL".parse::<Layer>(), Err(LayerError::ReservedName("motion".into())));
        assert_eq!("crypto_object00=CDL".parse::<Layer>(), Err(LayerError::ReservedName("crypto_object00".into())));
        let error = "a=C<".parse::<Layer>().unwrap_err().to_string();
        assert!(error.starts_with("layer `a`: found the end of the expression; expected a type"), "{error}");
        let twice = [Layer::new("a", "CL"), Layer::new("a", "CDL")];
        assert_eq!(parse_layers(&twice), Err(LayerError::DuplicateName("a".into())));
        let many: Vec<Layer> = (0..65).map(|i| Layer::new(format!("a{i}"), "CL")).collect();
        assert_eq!(parse_layers(&many), Err(LayerError::TooManyLayers(65)));
    }
}
