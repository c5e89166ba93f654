//! What images and settings can be at fault in.

/// Errors of this crate; decide by variant.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum StylizeError {
    /// An image has no pixels, no channels, or another number of values than its size asks for.
    #[error("image of {width}x{height} pixels and {channels} channels with {values} values")]
    Shape {
        /// Columns.
        width: u32,
        /// Rows.
        height: u32,
        /// Channels.
        channels: usize,
        /// Values given.
        values: usize,
    },
    /// A value of an image is NaN or infinite.
    #[error("pixel {x},{y} is not finite")]
    NotFinite {
        /// Column.
        x: u32,
        /// Row.
        y: u32,
    },
    /// A file is none of a picture.
    #[error("{0}")]
    File(String),
    /// A frame has no layer of this name.
    #[error("no layer `{0}`")]
    NoGuide(String),
    /// Source and target share no guide.
    #[error("source has {source_guides:?}, target {target_guides:?}: no guide in common")]
    NothingInCommon {
        /// Of the source.
        source_guides: Vec<String>,
        /// Of the target.
        target_guides: Vec<String>,
    },
    /// The style is not of the size of the source's guides.
    #[error("style of {style:?} pixels for a source of {source_size:?}")]
    StyleSize {
        /// Columns and rows of the style.
        style: [u32; 2],
        /// Columns and rows of the guides.
        source_size: [u32; 2],
    },
    /// The style has other channels than three colors.
    #[error("style of {0} channels, not 3")]
    StyleChannels(usize),
    /// Source and target have other numbers of guide channels.
    #[error("{source_channels} guide channels of the source, {target_channels} of the target")]
    Channels {
        /// Of the source.
        source_channels: usize,
        /// Of the target.
        target_channels: usize,
    },
    /// The weight of the guides is no number from 0 on.
    #[error("mu {0} is no finite number from 0 on")]
    Mu(f32),
    /// The price of use is no number from 0 on.
    #[error("balance {0} is no finite number from 0 on")]
    Balance(f32),
    /// The dial of boiling is no number from 0 to 1.
    #[error("boil {0} is no number from 0 to 1")]
    Boil(f32),
    /// The frame before is not of the target's size.
    #[error("frame before of {before:?} pixels for a target of {target:?}")]
    BeforeSize {
        /// Columns and rows of the frame before.
        before: [u32; 2],
        /// Columns and rows of the target.
        target: [u32; 2],
    },
    /// What was begun is not of these images and settings.
    #[error("what was begun is not of these images")]
    Begun,
    /// Bytes that are none of brushwork, or damaged ones.
    #[error("what was painted of the frame before is damaged")]
    Brushwork,
    /// The width of patches is even or out of range.
    #[error("patch {0} is no odd number from 3 to 15")]
    Patch(usize),
    /// The pyramid has no level, or its coarsest one is too small for patches.
    #[error("{levels} levels, where images of this size allow 1 to {most} with patches of {patch} pixels")]
    Levels {
        /// Asked for.
        levels: usize,
        /// Allowed; 0: not even one.
        most: usize,
        /// Width of a patch, pixels.
        patch: usize,
    },
}

impl From<femc_film::FilmError> for StylizeError {
    fn from(error: femc_film::FilmError) -> Self {
        Self::File(error.to_string())
    }
}
