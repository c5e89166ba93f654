//! Recorded light of frames, for the light view. The farm does not know the records: a program that does supplies an [`OpenLight`]
//! function.

mod views;

use bytes::Bytes;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

pub(crate) use views::{LightTarget, LightViewError, LightViews, TaggedAnswer};

/// Size limit of the encoded light statistics of one question, bytes.
pub const MAX_LIGHT_BYTES: u64 = 256 << 20;

/// Recorded light of one frame, or of one file.
#[derive(Debug, Clone)]
pub struct LightSource {
    /// Name for messages, such as `frame 3`.
    pub name: String,
    /// Light statistics, or the parts of an unfinished frame.
    pub parts: Vec<Bytes>,
    /// Whether more parts follow.
    pub is_growing: bool,
}

/// Function that decodes recorded light and unites its frames. It may take seconds. Its error describes the fault of the source.
/// `None`: no sample is recorded yet.
/// - `tag`: identifies the sources; all answers contain it.
pub type OpenLight = fn(tag: &str, sources: Vec<LightSource>) -> Result<Option<Arc<dyn LightData>>, String>;

/// Decoded recorded light.
pub trait LightData: Send + Sync {
    /// Approximate size in memory, bytes.
    fn memory_bytes(&self) -> usize;

    /// Answers a call. It may take seconds.
    /// - `is_cancelled`: set when the client is gone; the call then returns [`LightError::Cancelled`] early.
    fn answer(&self, call: &LightCall, is_cancelled: &AtomicBool) -> Result<LightAnswer, LightError>;
}

/// Question about recorded light.
#[derive(Debug, Clone, PartialEq)]
pub struct LightCall {
    /// Kind of the question.
    pub kind: LightCallKind,
    /// Condition on paths, in the language of `femc paths --where`; `None`: all paths.
    pub condition: Option<String>,
    /// Corners of the box of the world for bins of positions, m; `None`: the box of the data.
    pub bounds: Option<[[f64; 3]; 2]>,
}

/// Kind of a question about recorded light.
#[derive(Debug, Clone, PartialEq)]
pub enum LightCallKind {
    /// Attributes, names and totals.
    Schema,
    /// Representative paths with their intersections and lights.
    Paths {
        /// Maximum number of paths.
        count: u32,
        /// Whether the brightest samples are wanted instead of a representative set.
        brightest: bool,
    },
    /// Histograms of all attributes.
    Histograms {
        /// Pairs of attributes that need joint histograms: table (0 paths, 1 intersections, 2 lights), attribute of the row, attribute
        /// of the column.
        pairs: Vec<[usize; 3]>,
        /// Whether records weigh their part of the image instead of 1.
        by_image: bool,
    },
    /// Energy in the voxels of the scene.
    Voxels {
        /// Level of the octree: 2^level voxels a side.
        level: u32,
        /// Bounce of the intersections; `None`: all.
        bounce: Option<u32>,
    },
    /// Evaluation of the condition over all recorded paths.
    Selection {
        /// Whether the density over pixels is wanted.
        with_density: bool,
    },
}

/// Answer to a question about recorded light.
#[derive(Debug, Clone, PartialEq)]
pub enum LightAnswer {
    /// JSON.
    Json(Vec<u8>),
    /// Columns of numbers, as specified in `docs/http.md`.
    Columns(Vec<u8>),
}

/// Reason why a question has no answer.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum LightError {
    /// A parameter of the call is not valid.
    Invalid {
        /// Name of the parameter in the request.
        field: &'static str,
        /// Fault of the parameter.
        message: String,
    },
    /// The client is gone.
    Cancelled,
}

/// A file with light statistics that this program serves beside the farm.
#[derive(Debug, Clone)]
pub struct LightFile {
    /// Name for display.
    pub name: String,
    /// Path of the file. The file is read again when it changes.
    pub path: PathBuf,
}
