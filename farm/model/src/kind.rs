//! The tables of stage kinds and of output roles: all that the farm knows of a kind beside its code.

use serde::{Deserialize, Serialize};

/// What the tasks of a stage do. Its properties are a row of [`StageKind::row`]; what a worker does for it is a file of
/// `worker/src/execute`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub enum StageKind {
    /// Renders samples of a tile.
    Render,
    /// Unites outputs of one role.
    Reduce,
    /// Measures a frame and writes its image.
    Image,
    /// Exact arithmetic on numbers, for exercises of the farm.
    Drill,
    /// Decides by the errors of a frame's tiles whether another round follows, and how many samples each tile gets in it.
    Decide,
    /// Shows frames under one exposure, and makes a contact sheet or a clip of them.
    Encode,
    /// What is solved once for all frames of one content, before their samples; where it is cut into blocks, what one task does for all.
    FirstPass,
    /// A block of what is solved so.
    FirstPassBlock,
    /// Paints a frame in a style, from its layers and what was painted of the frame before.
    Paint,
}

/// Tasks of one lane are done one after the other, those of different lanes side by side.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Lane {
    /// Takes all threads of the worker.
    Compute,
    /// Joins what is there.
    Join,
}

impl Lane {
    /// All lanes.
    pub const ALL: [Self; 2] = [Self::Compute, Self::Join];

    /// Name, one word.
    pub fn name(self) -> &'static str {
        match self {
            Self::Compute => "compute",
            Self::Join => "join",
        }
    }
}

/// What a task wants to have near.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Near {
    /// The prepared frame: a worker goes on with a frame that it has prepared.
    Frame,
    /// Nothing but its inputs.
    Inputs,
}

/// Where the log of an attempt goes that went well; those of failures are stored.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum LogPlace {
    /// It travels in the report and is kept in memory.
    Report,
    /// Into the store.
    Store,
}

/// A row of the kinds' table.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct KindRow {
    /// Name, one word.
    pub name: &'static str,
    /// What its steps are counted in, for people.
    pub unit: &'static str,
    /// With what it competes on its worker.
    pub lane: Lane,
    /// Whether a lease may cover some of a task's steps.
    pub is_cut: bool,
    /// Data for whose sake the scheduler prefers a worker.
    pub near: Near,
    /// Place where its tasks' logs are kept.
    pub log: LogPlace,
}

impl StageKind {
    /// All, in the order of the table.
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

    /// Its row of the table.
    pub fn row(self) -> KindRow {
        use Lane::{Compute, Join};
        use LogPlace::{Report, Store};
        let row = |name, unit, lane, is_cut, near, log| KindRow { name, unit, lane, is_cut, near, log };
        match self {
            Self::Render => row("render", "pixel samples", Compute, true, Near::Frame, Report),
            Self::Reduce => row("reduce", "inputs", Join, false, Near::Inputs, Report),
            Self::Image => row("image", "inputs", Join, false, Near::Inputs, Store),
            Self::Drill => row("drill", "inputs", Compute, false, Near::Inputs, Report),
            Self::Decide => row("decide", "inputs", Join, false, Near::Inputs, Report),
            // An encoder of videos takes all threads, too.
            Self::Encode => row("encode", "inputs", Compute, false, Near::Inputs, Report),
            // One a content, and long: its log is kept.
            Self::FirstPass => row("first-pass", "solutions", Compute, false, Near::Inputs, Store),
            Self::FirstPassBlock => row("first-pass-block", "blocks", Compute, false, Near::Inputs, Report),
            Self::Paint => row("paint", "inputs", Compute, false, Near::Inputs, Report),
        }
    }

    /// Name, one word.
    pub fn name(self) -> &'static str {
        self.row().name
    }

    /// The kind of this name.
    pub fn named(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|kind| kind.name() == name)
    }

    /// Whether a lease may cover some of a task's steps.
    pub fn is_cut(self) -> bool {
        self.row().is_cut
    }

    /// Its place in [`StageKind::ALL`].
    pub const fn place(self) -> usize {
        self as usize
    }
}

/// What an output is. Its properties are a row of [`Role::row`].
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
    /// The same, tone-mapped, as PNG.
    Preview,
    /// Numbers of a drill.
    Numbers,
    /// What came of a drill.
    Answer,
    /// How far each of several tiles is from converged.
    Errors,
    /// Encoded sums of a tile's samples in blocks of pixels.
    Thumbnail,
    /// Blocks of one or many frames, counted by their luminance.
    Levels,
    /// A frame under the clip's exposure as PNG, for its sheet and its clip.
    Picture,
    /// The same, for people.
    Still,
    /// All frames on one PNG.
    Sheet,
    /// All frames as a clip.
    Clip,
    /// Where the samples of tiles end that count in a frame.
    Stops,
    /// What a first pass has found.
    Field,
    /// What is known of the paths of samples: of a tile, or of several.
    Paths,
    /// The same of all samples that count in a frame.
    Statistics,
    /// Elements of a first pass that is not done, and their light.
    Elements,
    /// Links between these.
    Links,
    /// What the rays of a block of a first pass have met.
    Rays,
    /// Where the light of a block comes from.
    Guides,
    /// Encoded sums of the layers of a tile's samples.
    Layers,
    /// Resolved layers of several tiles.
    LayerPixels,
    /// The layers of a finished image as EXR.
    LayerImage,
    /// A frame in a painted style as PNG.
    Painted,
    /// What the next frame's painting goes on with.
    Brushwork,
}

/// A row of the roles' table.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct RoleRow {
    /// Name, one word.
    pub name: &'static str,
    /// Whether it is a result of the job: kept with it, and made again when it is lost.
    pub is_result: bool,
    /// Whether a task may do without it.
    pub is_optional: bool,
}

impl Role {
    /// All, in the order of the table.
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

    /// Its row of the table.
    pub fn row(self) -> RoleRow {
        let row = |name, is_result, is_optional| RoleRow { name, is_result, is_optional };
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
            // Kept, so that a painting that is lost in a job at work is made again alone.
            Self::Brushwork => row("brushwork", true, false),
        }
    }

    /// Name, one word.
    pub fn name(self) -> &'static str {
        self.row().name
    }

    /// Its place in [`Role::ALL`].
    pub const fn place(self) -> usize {
        self as usize
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use super::*;

    #[test]
    fn the_tables_are_whole_and_no_name_is_there_twice() {
        for (place, kind) in StageKind::ALL.into_iter().enumerate() {
            assert_eq!(kind.place(), place);
        }
        for (place, role) in Role::ALL.into_iter().enumerate() {
            assert_eq!(role.place(), place);
        }
        let kinds: BTreeSet<&str> = StageKind::ALL.iter().map(|kind| kind.name()).collect();
        let roles: BTreeSet<&str> = Role::ALL.iter().map(|role| role.name()).collect();
        assert_eq!((kinds.len(), roles.len()), (StageKind::ALL.len(), Role::ALL.len()));
    }
}
