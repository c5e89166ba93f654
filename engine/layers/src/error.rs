//! Errors in layers.

/// An expression that cannot be parsed.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{}", self.text())]
pub struct ExpressionError {
    /// The expression.
    pub expression: String,
    /// Position of the error, in characters from the beginning.
    pub position: usize,
    /// Expected input at this position.
    pub expected: &'static str,
}

impl ExpressionError {
    fn text(&self) -> String {
        let Self { expression, position: at, expected } = self;
        let found = match expression.chars().nth(*at) {
            Some(found) => format!("`{found}` at character {}", at + 1),
            None if expression.is_empty() => "nothing".to_owned(),
            None => "the end of the expression".to_owned(),
        };
        // Control characters would move the caret.
        let shown: String = expression.chars().map(|c| if c.is_control() { ' ' } else { c }).collect();
        format!("found {found}; expected {expected}\n    {shown}\n    {:>1$}", '^', at + 1)
    }
}

/// Errors in the layers of a frame.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum LayerError {
    /// The text is not `NAME=EXPRESSION`.
    #[error("`{0}` is not a layer; write NAME=EXPRESSION, like direct=CDL")]
    InvalidForm(String),
    /// The name is not valid for channels.
    #[error("invalid layer name `{0}`; a name has 1 to 64 letters, digits, `_` and `-`")]
    InvalidName(String),
    /// The file already has channels with this name.
    #[error("invalid layer name `{0}`: the file already has channels with this name; choose another name")]
    ReservedName(String),
    /// Two layers have the same name.
    #[error("two layers have the name `{0}`; give each layer its own name")]
    DuplicateName(String),
    /// There are too many layers.
    #[error("there are {0} layers; the limit is {most} per frame", most = crate::MAX_LAYERS)]
    TooManyLayers(usize),
    /// No preset and no feature has this name.
    #[error(
        "unknown layers `{0}`; choose from {presets}, {features}",
        presets = crate::Preset::NAMES.join(", "),
        features = crate::Feature::NAMES.join(", ")
    )]
    UnknownPreset(String),
    /// Layers of lamps are requested, but the scene has no lamps.
    #[error("the layers `lamps` need lamps, but the scene has none")]
    NoLamps,
    /// An expression that cannot be parsed.
    #[error("layer `{layer}`: {cause}")]
    Expression {
        /// Name of the layer.
        layer: String,
        /// Error in the expression.
        cause: ExpressionError,
    },
    /// Nothing in the scene has this label.
    #[error(
        "layer `{layer}`: unknown label `{label}`; a label is the name of an object, a material, a medium or a lamp (OBJECT/MATERIAL) \
         of the scene"
    )]
    UnknownLabel {
        /// Name of the layer.
        layer: String,
        /// The label.
        label: String,
    },
    /// The layers name too many labels.
    #[error("the layers name {0} objects and lamps; the limit is {most}", most = crate::Vocabulary::MAX_LABELS)]
    TooManyLabels(usize),
    /// The automaton is too large.
    #[error("the layers together are too complex: they need more than {0} states; remove layers or simplify them")]
    TooManyStates(usize),
}
