//! Tables of stage kinds and of output roles. They hold everything that the farm knows about a kind, besides its code.

use serde::{Deserialize, Serialize};

/// Kind of a stage: the work its tasks do. Its properties are a row of [`StageKind::properties`]. The worker's code for a kind is a
/// file in `worker/src/execute`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub enum StageKind {
    /// Renders samples of a tile.
    Render,
    /// Combines outputs of one role.
    Reduce,
    /// Measures a frame and writes its image.
    Image,
    /// Does exact arithmetic on numbers, to exercise the farm.
    Drill,
    /// Decides from the errors of a frame's tiles whether another round follows, and how many samples each tile gets in it.
    Decide,
    /// Tone-maps frames with one exposure, and makes a contact sheet or a clip of them.
    Encode,
    /// Solves the first pass once for all frames of one shared content, before their samples. If the first pass is divided into
    /// blocks, this kind is the part that one task does for all blocks.
    FirstPass,
    /// Computes one block of a first pass.
    FirstPassBlock,
    /// Paints a frame in a style, from its layers and the painting of the preceding frame.
    Paint,
}

/// Lane of a task. A worker runs tasks of one lane one after another, and tasks of different lanes in parallel.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Lane {
    /// Uses all threads of the worker.
    Compute,
    /// Joins existing outputs.
    Join,
}

impl Lane {
    /// All lanes.
    pub const ALL: [Self; 2] = [Self::Compute, Self::Join];

    /// Name in one word.
    pub fn name(self) -> &'static str {
        match self {
            Self::Compute => "compute",
            Self::Join => "join",
        }
    }
}

/// Data that a task prefers to have on its worker.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Affinity {
    /// The prepared frame: a worker preferably continues with a frame that it has prepared.
    Frame,
    /// Only the inputs of the task.
    Inputs,
}

/// Destination of the log of a successful attempt. Logs of failures always go to the store.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum LogDestination {
    /// The log is part of the report and is kept in memory.
    Report,
    /// The log goes to the store.
    Store,
}

/// Row of the table of kinds.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct StageKindProperties {
    /// Name in one word.
    pub name: &'static str,
    /// Unit in which the steps are counted, for display.
    pub unit: &'static str,
    /// Lane in which the tasks compete for the worker.
    pub lane: Lane,
    /// Whether a lease may cover a part of a task's steps.
    pub is_divided: bool,
    /// Data because of which the scheduler prefers a worker.
    pub affinity: Affinity,
    /// Destination of the logs of the kind's tasks.
    pub log: LogDestination,
}

impl StageKind {
    /// All variants, in the order of the table.
    pub const ALL: [Self; 9] = [
        Self::Render,
        Self::Reduce,
        Self::Image,
        Self::Drill,
        Self::Decide,
        Self::Encode,
        Self::FirstPass,
        Self::FirstPassBlock,
        Self::Paint,
    ];

    /// Returns the kind's row of the table.
    pub fn properties(self) -> StageKindProperties {
        use Lane::{Compute, Join};
        use LogDestination::{Report, Store};
        let row = |name, unit, lane, is_cut, near, log| StageKindProperties {
            name,
            unit,
            lane,
            is_divided: is_cut,
            affinity: near,
            log,
        };
        match self {
            Self::Render => row("render", "pixel samples", Compute, true, Affinity::Frame, Report),
            Self::Reduce => row("reduce", "inputs", Join, false, Affinity::Inputs, Report),
            Self::Image => row("image", "inputs", Join, false, Affinity::Inputs, Store),
            Self::Drill => row("drill", "inputs", Compute, false, Affinity::Inputs, Report),
            Self::Decide => row("decide", "inputs", Join, false, Affinity::Inputs, Report),
            // A video encoder uses all threads, too.
            Self::Encode => row("encode", "inputs", Compute, false, Affinity::Inputs, Report),
            // There is one task per content, and it is long, so its log is stored.
            Self::FirstPass => row("first-pass", "solutions", Compute, false, Affinity::Inputs, Store),
            Self::FirstPassBlock => row("first-pass-block", "blocks", Compute, false, Affinity::Inputs, Report),
            Self::Paint => row("paint", "inputs", Compute, false, Affinity::Inputs, Report),
        }
    }

    /// Name in one word.
    pub fn name(self) -> &'static str {
        self.properties().name
    }

    /// Returns the kind with this name.
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|kind| kind.name() == name)
    }

    /// Returns whether a lease may cover a part of a task's steps.
    pub fn is_divided(self) -> bool {
        self.properties().is_divided
    }

    /// Returns the position in [`StageKind::ALL`].
    pub const fn index(self) -> usize {
        self as usize
    }
}

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
    /// Elements of an unfinished first pass, and their light.
    Elements,
    /// Links between the elements of an unfinished first pass.
    Links,
    /// Hits of the rays of one block of a first pass.
    Rays,
    /// Guiding data of a block: the directions from which its light comes.
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
}

impl Role {
    /// All variants, in the order of the table.
    pub const ALL: [Self; 27] = [
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
    ];

    /// Returns the role's row of the table.
    pub fn properties(self) -> RoleProperties {
        let row = |name, is_result, is_optional| RoleProperties { name, is_result, is_optional };
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
            Self::Statistics => row("statistics", true, false),
            Self::Elements => row("elements", false, false),
            Self::Links => row("links", false, false),
            Self::Rays => row("rays", false, false),
            Self::Guides => row("guides", false, false),
            Self::Layers => row("layers", false, false),
            Self::LayerPixels => row("layer-pixels", false, false),
            Self::LayerImage => row("layer-image", true, false),
            Self::Painted => row("painted", true, false),
            // Kept, so that a painting that is lost while the job runs can be repainted alone.
            Self::Brushwork => row("brushwork", true, false),
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

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use super::*;

    #[test]
    fn the_tables_are_whole_and_no_name_is_there_twice() {
        for (index, kind) in StageKind::ALL.into_iter().enumerate() {
            assert_eq!(kind.index(), index);
        }
        for (index, role) in Role::ALL.into_iter().enumerate() {
            assert_eq!(role.index(), index);
        }
        let kinds: BTreeSet<&str> = StageKind::ALL.iter().map(|kind| kind.name()).collect();
        let roles: BTreeSet<&str> = Role::ALL.iter().map(|role| role.name()).collect();
        assert_eq!((kinds.len(), roles.len()), (StageKind::ALL.len(), Role::ALL.len()));
    }
}
