//! Errors in layers.

/// An expression that cannot be parsed.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{}", self.text())]
pub struct ExpressionError {
    /// The expression.
    pub expression: String,
    /// Position of the error, in characters from the beginning.
    pub at: usize,
    /// Expected input at this position.
    pub expected: &'static str,
}

impl ExpressionError {
    fn text(&self) -> String {
        let Self { expression, at, expected } = self;
        let found = match expression.chars().nth(*at) {
            Some(found) => format!("`{found}` at character {}", at + 1),
            None if expression.is_empty() => "nothing".to_owned(),
            None => "its end".to_owned(),
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
    #[error("`{0}` is no layer; write NAME=EXPRESSION, like direct=CDL")]
    Form(String),
    /// The name is not valid for channels.
    #[error("a layer cannot be called `{0}`; a name has 1 to 64 letters, digits, `_` and `-`")]
    Name(String),
    /// The file already has channels with this name.
    #[error("a layer cannot be called `{0}`: the file has channels of that name; choose another")]
    Taken(String),
    /// Two layers have the same name.
    #[error("two layers are called `{0}`; give each a name of its own")]
    Twice(String),
    /// There are too many layers.
    #[error("there are {0} layers; a frame has at most {most}", most = crate::MOST_LAYERS)]
    Many(usize),
    /// No preset and no feature has this name.
    #[error(
        "there are no layers called `{0}`; choose among {presets}, {features}",
        presets = crate::Preset::NAMES.join(", "),
        features = crate::Feature::NAMES.join(", ")
    )]
    Preset(String),
    /// Layers of lamps are requested, but the scene has no lamps.
    #[error("the scene has no lamps, so that there are no layers of `lamps`")]
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
        "layer `{layer}`: nothing in the scene is called `{label}`; a label is the name of an object, a material, a medium or a lamp \
         (OBJECT/MATERIAL)"
    )]
    Label {
        /// Name of the layer.
        layer: String,
        /// The label.
        label: String,
    },
    /// The layers name too many labels.
    #[error("the layers name {0} objects and lamps; they may name {most}", most = crate::Vocabulary::MOST)]
    Labels(usize),
    /// The automaton is too large.
    #[error(
        "the layers together are too complex: they would take more than {0} states; leave some out, or make them simpler"
    )]
    Complex(usize),
}
