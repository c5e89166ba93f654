//! Interface between the first pass as tasks and its solvers.
//!
//! A solver computes a [`Solution`] as a whole, or in steps that several machines share. Between steps only bytes travel, which the
//! solver alone reads. All solvers have the same steps: one task begins, blocks cast rays, one task applies their results, and, for
//! a field that guides paths, blocks compute guides. A solver with other phases has empty outputs for those that it lacks. A new
//! solver implements the traits here, in a file beside [`radiosity`], and [`solver`] selects it.

mod radiosity;

use crate::render::RenderError;
use crate::settings::Method;
use femc_prepared::Prepared;
use femc_radiosity::{Solution, SolveReport, StepDecodeError};
use std::any::Any;
use std::fmt::Debug;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

/// Returns the solver of a method's first pass, with its options.
pub fn solver(method: Method) -> Arc<dyn Solver> {
    Arc::new(radiosity::Radiosity::new(method))
}

/// Phases of a solution in steps.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SolverPhases {
    /// Number of times that blocks cast rays and one task applies the results.
    pub rounds: u32,
    /// Whether blocks compute guides after the last round.
    pub has_guides: bool,
}

/// A solver of the first pass. Its results depend only on the prepared frame and on the solver, not on threads or blocks.
pub trait Solver: Send + Sync {
    /// Returns bytes that identify the solver and its options, for the digest of a solution's inputs.
    fn key(&self) -> Vec<u8>;

    /// Returns the phases of a solution in steps.
    fn phases(&self) -> SolverPhases;

    /// Returns the minimum number of bytes of memory for a prepared frame.
    fn min_bytes(&self, prepared: &Prepared) -> u64;

    /// Computes the solution as a whole.
    /// - errors: `cancel` was set.
    fn solve(&self, prepared: &Prepared, cancel: &AtomicBool) -> Result<Solution, RenderError>;

    /// Does the first step of a solution.
    /// - errors: `cancel` was set.
    fn begin(&self, prepared: &Prepared, cancel: &AtomicBool) -> Result<Box<dyn LinkedState>, RenderError>;

    /// Decodes the state between two rounds.
    /// - `start`: output of [`LinkedState::encode_start`];
    /// - `latest`: output of [`GuideState::encode_elements`] after the latest round; `None` before the first;
    /// - errors: the bytes are damaged, of another version, or belong to different frames.
    fn decode(
        &self,
        prepared: &Prepared,
        start: &[u8],
        latest: Option<&[u8]>,
    ) -> Result<Box<dyn LinkedState>, StepDecodeError>;

    /// Decodes the output of a block.
    /// - errors: the bytes are damaged.
    fn decode_block(&self, phase: BlockPhase, bytes: &[u8]) -> Result<BlockOutput, StepDecodeError>;
}

/// Phase that blocks compute.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum BlockPhase {
    /// Output of [`RayState::cast`].
    Rays,
    /// Output of [`GuideState::guides`].
    Guides,
}

/// Decoded output of a block, which only its solver can read.
pub struct BlockOutput(Box<dyn Any + Send>);

impl BlockOutput {
    /// Wraps an output.
    pub fn new<T: Any + Send>(output: T) -> Self {
        Self(Box::new(output))
    }

    /// Returns the contents of outputs, in order.
    /// - errors: some output has another type: it is of another solver or phase.
    pub fn unwrap_all<T: Any>(outputs: Vec<Self>) -> Result<Vec<T>, StepDecodeError> {
        let unwrap = |output: Self| output.0.downcast::<T>().map(|output| *output);
        outputs
            .into_iter()
            .map(unwrap)
            .collect::<Result<_, _>>()
            .map_err(|_| StepDecodeError::Damaged("it is of another solver"))
    }
}

/// State of a solution between two rounds.
pub trait LinkedState: Debug + Send + Sync {
    /// Returns the statistics so far.
    fn report(&self) -> SolveReport;

    /// Encodes the state of the first step.
    fn encode_start(&self) -> Vec<u8>;

    /// Prepares the state for the rays of the next round.
    fn before_rays(self: Box<Self>, prepared: &Prepared) -> Arc<dyn RayState>;

    /// Prepares the state for guides.
    /// - `rays`: outputs of all blocks of this round, in order.
    fn after_rays(self: Box<Self>, rays: Vec<BlockOutput>) -> Result<Arc<dyn GuideState>, StepDecodeError>;

    /// Creates the solution.
    /// - `guides`: outputs of all blocks, in order; none for a field that does not guide paths.
    fn solution(&self, prepared: &Prepared, guides: Vec<BlockOutput>) -> Result<Solution, StepDecodeError>;
}

/// State of a solution before the rays of a round.
pub trait RayState: Debug + Send + Sync {
    /// Casts the rays of block `block` of `blocks` blocks. Returns an output of [`BlockPhase::Rays`].
    fn cast(&self, prepared: &Prepared, block: u32, blocks: u32) -> Vec<u8>;

    /// Applies the outputs of all blocks, in order.
    /// - returns `None` if they belong to other elements;
    /// - errors: `cancel` was set.
    fn apply(
        &self,
        prepared: &Prepared,
        rays: Vec<BlockOutput>,
        cancel: &AtomicBool,
    ) -> Result<Option<Arc<dyn GuideState>>, RenderError>;
}

/// State of a solution after the rays of a round.
pub trait GuideState: Debug + Send + Sync {
    /// Computes the guides of block `block` of `blocks` blocks. Returns an output of [`BlockPhase::Guides`].
    fn guides(&self, prepared: &Prepared, block: u32, blocks: u32) -> Vec<u8>;

    /// Returns the statistics so far.
    fn report(&self) -> SolveReport;

    /// Encodes what this round has changed in the state of the first step.
    fn encode_elements(&self) -> Vec<u8>;

    /// Creates the solution of a field without lobes.
    fn solution(&self, prepared: &Prepared) -> Solution;
}
