//! Table of stage kinds. It holds everything that the farm knows about a kind, besides its code.

use serde::{Deserialize, Serialize};

use crate::tag;

/// Kind of a stage: the work its tasks do. Its properties are a row of [`StageKind::properties`]. The worker's code for a kind is a
/// file in `worker/src/execute`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub enum StageKind {
    /// Renders samples of a tile.
    Render,
    /// Unites the tiles of a group.
    Reduce,
    /// Measures a frame and writes its image.
    Image,
    /// Does exact arithmetic on numbers, to exercise the farm.
    Drill,
    /// Decides from the errors of a frame's tiles whether another round follows, and how many samples each tile gets in it.
    Decide,
    /// Kind of earlier versions for [`StageKind::EncodePicture`], [`StageKind::EncodeSheet`] and [`StageKind::EncodeClip`].
    Encode,
    /// Solves the first pass once for all frames of one shared content, before their samples.
    FirstPass,
    /// Kind of earlier versions for [`StageKind::FirstPassRays`] and [`StageKind::FirstPassGuides`].
    FirstPassBlock,
    /// Paints a frame in a style, from its layers and the painting of the preceding frame.
    Paint,
    /// Creates the elements and links of a first pass in blocks.
    FirstPassStart,
    /// Casts the rays of one block of a first pass.
    FirstPassRays,
    /// Solves a first pass again, corrected by the rays of all blocks.
    FirstPassSolve,
    /// Computed guides of one block of a first pass in earlier versions. Workers of this version make an empty output.
    FirstPassGuides,
    /// Makes the light of a first pass in blocks from its last state.
    FirstPassFinish,
    /// Counts the luminance levels of a group of tiles.
    CountLevels,
    /// Adds up luminance levels of groups of tiles, or of frames.
    ReduceLevels,
    /// Combines the path statistics of a group of tiles.
    ReducePaths,
    /// Unites and resolves the layers of a group of tiles.
    ReduceLayers,
    /// Encodes a frame as PNG, with the exposure common to all frames.
    EncodePicture,
    /// Encodes all frames as a contact sheet.
    EncodeSheet,
    /// Encodes all frames as a clip.
    EncodeClip,
    /// Writes the surfaces of a frame as triangles, for viewers.
    Geometry,
    /// Writes the finite-element solution of a frame as triangles, for viewers.
    Solution,
    /// Measures light at some of the places of a request.
    Measure,
    /// Joins the measurements of a frame.
    JoinReadings,
    /// Learns the targets of a frame's paths, before its samples.
    Learn,
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
    /// Tags of the workers that know the kind; none: all workers know it.
    pub tags: &'static [&'static str],
}

impl StageKind {
    /// All variants, in the order of the table.
    pub const ALL: [Self; 26] = [
        Self::Render,
        Self::Reduce,
        Self::Image,
        Self::Drill,
        Self::Decide,
        Self::Encode,
        Self::FirstPass,
        Self::FirstPassBlock,
        Self::Paint,
        Self::FirstPassStart,
        Self::FirstPassRays,
        Self::FirstPassSolve,
        Self::FirstPassGuides,
        Self::FirstPassFinish,
        Self::CountLevels,
        Self::ReduceLevels,
        Self::ReducePaths,
        Self::ReduceLayers,
        Self::EncodePicture,
        Self::EncodeSheet,
        Self::EncodeClip,
        Self::Geometry,
        Self::Solution,
        Self::Measure,
        Self::JoinReadings,
        Self::Learn,
    ];

    /// Returns the kind's row of the table.
    pub fn properties(self) -> StageKindProperties {
        use Lane::{Compute, Join};
        use LogDestination::{Report, Store};
        let row = |name, unit, lane, is_divided, affinity, log, tags| StageKindProperties {
            name,
            unit,
            lane,
            is_divided,
            affinity,
            log,
            tags,
        };
        let step = |name, unit, log| {
            row(name, unit, Compute, false, Affinity::Inputs, log, &[tag::FIRST_PASS, tag::TASK_KINDS])
        };
        let split = |name, lane| row(name, "inputs", lane, false, Affinity::Inputs, Report, &[tag::TASK_KINDS]);
        match self {
            Self::Render => row("render", "pixel samples", Compute, true, Affinity::Frame, Report, &[]),
            Self::Reduce => row("reduce", "inputs", Join, false, Affinity::Inputs, Report, &[]),
            Self::Image => row("image", "inputs", Join, false, Affinity::Inputs, Store, &[]),
            Self::Drill => row("drill", "inputs", Compute, false, Affinity::Inputs, Report, &[]),
            Self::Decide => row("decide", "inputs", Join, false, Affinity::Inputs, Report, &[]),
            Self::Encode => row("encode", "inputs", Compute, false, Affinity::Inputs, Report, &[]),
            // There is one task per content, and it is long, so its log is stored.
            Self::FirstPass => {
                row("first-pass", "solutions", Compute, false, Affinity::Inputs, Store, &[tag::FIRST_PASS])
            }
            Self::FirstPassBlock => {
                row("first-pass-block", "blocks", Compute, false, Affinity::Inputs, Report, &[tag::FIRST_PASS_BLOCKS])
            }
            Self::Paint => row("paint", "inputs", Compute, false, Affinity::Inputs, Report, &[tag::PAINTING]),
            Self::FirstPassStart => step("first-pass-start", "solutions", Store),
            Self::FirstPassRays => step("first-pass-rays", "blocks", Report),
            Self::FirstPassSolve => step("first-pass-solve", "solutions", Store),
            Self::FirstPassGuides => step("first-pass-guides", "blocks", Report),
            Self::FirstPassFinish => step("first-pass-finish", "solutions", Store),
            Self::CountLevels => split("count-levels", Join),
            Self::ReduceLevels => split("reduce-levels", Join),
            Self::ReducePaths => split("reduce-paths", Join),
            Self::ReduceLayers => split("reduce-layers", Join),
            Self::EncodePicture => split("encode-picture", Compute),
            Self::EncodeSheet => split("encode-sheet", Compute),
            // A video encoder uses all threads, too.
            Self::EncodeClip => split("encode-clip", Compute),
            Self::Geometry => row("geometry", "frames", Compute, false, Affinity::Frame, Report, &[tag::GEOMETRY]),
            Self::Solution => row("solution", "frames", Compute, false, Affinity::Frame, Report, &[tag::SOLUTION]),
            Self::Measure => row("measure", "samples", Compute, false, Affinity::Frame, Report, &[tag::MEASUREMENTS]),
            Self::JoinReadings => {
                row("join-readings", "inputs", Join, false, Affinity::Inputs, Report, &[tag::MEASUREMENTS])
            }
            Self::Learn => row("learn", "frames", Compute, false, Affinity::Frame, Report, &[tag::TARGETS]),
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
