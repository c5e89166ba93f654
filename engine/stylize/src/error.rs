//! Errors in images and settings.

/// Errors of this crate; decide by variant.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum StylizeError {
    /// An image has no pixels, no channels, or a number of values that does not match its size.
    #[error("an image of {width}x{height} pixels and {channels} channels cannot have {values} values")]
    Shape {
        /// Number of columns.
        width: u32,
        /// Number of rows.
        height: u32,
        /// Number of channels.
        channels: usize,
        /// Number of given values.
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
    /// A file is not a valid picture.
    #[error("{0}")]
    File(String),
    /// A frame has no layer with this name.
    #[error("no layer `{0}`")]
    NoGuide(String),
    /// Source and target share no guide.
    #[error(
        "source and target have no guide in common: the source has {source_guides:?}, the target has {target_guides:?}"
    )]
    NothingInCommon {
        /// Guides of the source.
        source_guides: Vec<String>,
        /// Guides of the target.
        target_guides: Vec<String>,
    },
    /// The style has another size than the source's guides.
    #[error("the style has {style:?} pixels, but the source has {source_size:?}")]
    StyleSize {
        /// Columns and rows of the style.
        style: [u32; 2],
        /// Columns and rows of the guides.
        source_size: [u32; 2],
    },
    /// The style does not have three channels.
    #[error("the style has {0} channels; it must have 3")]
    StyleChannels(usize),
    /// Source and target have different numbers of guide channels.
    #[error("the source has {source_channels} guide channels, but the target has {target_channels}")]
    Channels {
        /// Guide channels of the source.
        source_channels: usize,
        /// Guide channels of the target.
        target_channels: usize,
    },
    /// The weight of the guides is negative or not finite.
    #[error("mu is {0}; it must be finite and not negative")]
    Mu(f32),
    /// The price of use is negative or not finite.
    #[error("balance is {0}; it must be finite and not negative")]
    Balance(f32),
    /// The amount of boiling is not between 0 and 1.
    #[error("boil is {0}; it must be from 0 to 1")]
    Boil(f32),
    /// The previous frame has another size than the target.
    #[error("the previous frame has {before:?} pixels, but the target has {target:?}")]
    PreviousFrameSize {
        /// Columns and rows of the previous frame.
        before: [u32; 2],
        /// Columns and rows of the target.
        target: [u32; 2],
    },
    /// The checkpoint belongs to other images or settings.
    #[error("the checkpoint belongs to other images or settings")]
    ForeignCheckpoint,
    /// The bytes are not brushwork, or they are damaged.
    #[error("the brushwork of the previous frame is damaged")]
    Brushwork,
    /// The width of patches is even or out of range.
    #[error("patch is {0}; it must be an odd number from 3 to 15")]
    Patch(usize),
    /// The pyramid has no level, or its coarsest one is too small for patches.
    #[error("{levels} levels are not possible: images of this size allow 1 to {most} with patches of {patch} pixels")]
    Levels {
        /// Requested levels.
        levels: usize,
        /// Maximum number of levels; 0: not even one fits.
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
