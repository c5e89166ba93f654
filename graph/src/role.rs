//! Table of output roles.

use serde::{Deserialize, Serialize};

use crate::tag;

/// Role of an output. Its properties are a row of [`Role::properties`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub enum Role {
    /// Encoded sums of a tile's samples.
    Tile,
    /// Encoded sums of several tiles.
    Sums,
    /// Resolved pixels of several tiles.
    Pixels,
    /// A finished image as EXR.
    Image,
    /// The finished image, tone-mapped, as PNG.
    Preview,
    /// Numbers of a drill.
    Numbers,
    /// Result of a drill.
    Answer,
    /// Errors of several tiles: their distance from convergence.
    Errors,
    /// Encoded sums of a tile's samples in blocks of pixels.
    Thumbnail,
    /// Histogram of the luminance of pixel blocks, over one or more frames.
    Levels,
    /// A frame with the clip's exposure as PNG, input of the contact sheet and the clip.
    Picture,
    /// A frame with the clip's exposure as PNG, a result for users.
    Still,
    /// Contact sheet: all frames in one PNG.
    Sheet,
    /// All frames as a clip.
    Clip,
    /// Number of samples at which each tile of a frame ends.
    Stops,
    /// Solution of a first pass.
    Field,
    /// Path statistics of the samples of one or more tiles.
    Paths,
    /// Path statistics of all samples that count in a frame.
    Statistics,
    /// Role of earlier versions for [`Role::SolverState`], like the three below.
    Elements,
    /// See [`Role::Elements`].
    Links,
    /// See [`Role::Elements`].
    Rays,
    /// See [`Role::Elements`].
    Guides,
    /// Encoded sums of the layers of a tile's samples.
    Layers,
    /// Resolved layers of several tiles.
    LayerPixels,
    /// The layers of a finished image as EXR.
    LayerImage,
    /// A frame in a painted style as PNG.
    Painted,
    /// State from which the painting of the next frame continues.
    Brushwork,
    /// State of an unfinished first pass: what one of its steps has made, for the later steps. Only the solver reads it.
    SolverState,
    /// The surfaces of a frame as binary glTF.
    Geometry,
    /// The finite-element solution of a frame as binary glTF.
    Solution,
    /// Readings of some places of a frame.
    ReadingBlock,
    /// All readings of a frame, as JSON.
    Readings,
    /// The targets of a frame's paths, as JSON.
    Targets,
}

/// Row of the table of roles.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct RoleProperties {
    /// Name in one word.
    pub name: &'static str,
    /// Whether the output is a result of the job: it is kept with the job, and recreated when it is lost.
    pub is_result: bool,
    /// Whether a task may omit the output.
    pub is_optional: bool,
    /// Tags of the workers that know the role; none: all workers that know the kinds of the stages that make it.
    pub tags: &'static [&'static str],
}

impl Role {
    /// All variants, in the order of the table.
    pub const ALL: [Self; 33] = [
        Self::Tile,
        Self::Sums,
        Self::Pixels,
        Self::Image,
        Self::Preview,
        Self::Numbers,
        Self::Answer,
        Self::Errors,
        Self::Thumbnail,
        Self::Levels,
        Self::Picture,
        Self::Still,
        Self::Sheet,
        Self::Clip,
        Self::Stops,
        Self::Field,
        Self::Paths,
        Self::Statistics,
        Self::Elements,
        Self::Links,
        Self::Rays,
        Self::Guides,
        Self::Layers,
        Self::LayerPixels,
        Self::LayerImage,
        Self::Painted,
        Self::Brushwork,
        Self::SolverState,
        Self::Geometry,
        Self::Solution,
        Self::ReadingBlock,
        Self::Readings,
        Self::Targets,
    ];

    /// Returns the role's row of the table.
    pub fn properties(self) -> RoleProperties {
        let row = |name, is_result, is_optional| RoleProperties { name, is_result, is_optional, tags: &[] };
        match self {
            Self::Tile => row("tile", false, false),
            Self::Sums => row("sums", false, false),
            Self::Pixels => row("pixels", false, false),
            Self::Image => row("image", true, false),
            Self::Preview => row("preview", true, true),
            Self::Numbers => row("numbers", false, false),
            Self::Answer => row("answer", true, false),
            Self::Errors => row("errors", false, false),
            Self::Thumbnail => row("thumbnail", false, false),
            Self::Levels => row("levels", false, false),
            Self::Picture => row("picture", false, false),
            Self::Still => row("still", true, false),
            Self::Sheet => row("sheet", true, false),
            Self::Clip => row("clip", true, false),
            Self::Stops => row("stops", false, false),
            Self::Field => row("field", false, false),
            Self::Paths => row("paths", false, false),
            Self::Statistics => RoleProperties { tags: &[tag::STATISTICS], ..row("statistics", true, false) },
            Self::Elements => row("elements", false, false),
            Self::Links => row("links", false, false),
            Self::Rays => row("rays", false, false),
            Self::Guides => row("guides", false, false),
            Self::Layers => row("layers", false, false),
            Self::LayerPixels => row("layer-pixels", false, false),
            Self::LayerImage => {
                RoleProperties { tags: &[tag::LAYERS, tag::FEATURES], ..row("layer-image", true, false) }
            }
            Self::Painted => row("painted", true, false),
            // Kept, so that a painting that is lost while the job runs can be repainted alone.
            Self::Brushwork => row("brushwork", true, false),
            Self::SolverState => row("solver-state", false, false),
            Self::Geometry => row("geometry", true, false),
            Self::Solution => row("solution", true, false),
            Self::ReadingBlock => row("reading-block", false, false),
            Self::Readings => row("readings", true, false),
            Self::Targets => row("targets", true, false),
        }
    }

    /// Name in one word.
    pub fn name(self) -> &'static str {
        self.properties().name
    }

    /// Returns the position in [`Role::ALL`].
    pub const fn index(self) -> usize {
        self as usize
    }
}
