//! Recorded light of frames, for the light view. The farm does not know the records: a program that does supplies an [`OpenLight`]
//! function.

mod call;
mod views;

use bytes::Bytes;
use std::fmt;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

pub use call::{
    AxisPairs, Corners, EarlierRows, LightAnswer, LightCall, LightCallKind, LightError, PathCount, RowIdentity,
    VoxelLevel,
};
pub(crate) use views::{LightQuestion, LightTarget, LightViewError, LightViews, TaggedAnswer};

/// Size limit of the encoded light statistics of one question, bytes.
pub const MAX_LIGHT_BYTES: u64 = 256 << 20;

/// Recorded light of one frame, or of one file.
#[derive(Debug, Clone)]
pub struct LightSource {
    /// Name of the source, such as `frame 3`.
    pub name: String,
    /// Light statistics, or the parts of an unfinished frame.
    pub parts: Vec<Bytes>,
    /// Whether more parts follow.
    pub is_growing: bool,
}

/// Function that decodes recorded light and unites its frames. It may take seconds. `None`: no sample is recorded yet.
/// - `tag`: identifies the sources; all answers contain it.
pub type OpenLight = fn(tag: &str, sources: Vec<LightSource>) -> Result<Option<Arc<dyn LightData>>, LightFault>;

/// Fault of recorded light.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct LightFault {
    /// Names of the faulty sources.
    pub sources: Vec<String>,
    /// Index of the faulty part, if the source has several.
    pub part: Option<usize>,
    /// Description of the fault.
    pub message: String,
}

/// Writes the sources, the part and the fault.
impl fmt::Display for LightFault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}: ", self.sources.join(", "))?;
        self.part.map_or(Ok(()), |part| write!(f, "part {}: ", part + 1))?;
        f.write_str(&self.message)
    }
}

/// Decoded recorded light.
pub trait LightData: Send + Sync {
    /// Approximate size in memory, bytes.
    fn memory_bytes(&self) -> usize;

    /// Answers a call. It may take seconds.
    /// - `earlier`: rows that the client has from an earlier answer. An answer with rows may refer to them.
    /// - `is_cancelled`: set when the client is gone; the call then returns [`LightError::Cancelled`] early.
    fn answer(
        &self,
        call: &LightCall,
        earlier: Option<&EarlierRows>,
        is_cancelled: &AtomicBool,
    ) -> Result<LightAnswer, LightError>;
}

/// A file with light statistics that this program serves beside the farm.
#[derive(Debug, Clone)]
pub struct LightFile {
    /// Name for display.
    pub name: String,
    /// Path of the file. The file is read again when it changes.
    pub path: PathBuf,
}
