//! Interface between the first pass as tasks and its solvers.
//!
//! A solver computes a [`Solution`] as a whole, or in steps that several machines share. Between steps only bytes travel, which the
//! solver alone reads. All solvers have the same steps: one task begins, then, in rounds, blocks cast rays and one task applies their
//! results. A new solver implements the traits here, in a file beside [`radiosity`], and [`solver`] selects it.

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

/// A solver of the first pass. Its results depend only on the prepared frame and on the solver, not on threads or blocks.
pub trait Solver: Send + Sync {
    /// Returns bytes that identify the solver and its options, for the digest of a solution's inputs.
    fn key(&self) -> Vec<u8>;

    /// Returns the number of times that blocks cast rays and one task applies the results.
    fn rounds(&self) -> u32;

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
    /// - `latest`: output of [`LinkedState::encode_elements`] after the latest round; `None` before the first;
    /// - errors: the bytes are damaged, of another version, or belong to different frames.
    fn decode(
        &self,
        prepared: &Prepared,
        start: &[u8],
        latest: Option<&[u8]>,
    ) -> Result<Box<dyn LinkedState>, StepDecodeError>;

    /// Decodes the output of [`RayState::cast`].
    /// - errors: the bytes are damaged.
    fn decode_rays(&self, bytes: &[u8]) -> Result<BlockOutput, StepDecodeError>;
}

/// Decoded output of a block, which only its solver can read.
pub struct BlockOutput(Box<dyn Any + Send>);

impl BlockOutput {
    /// Wraps an output.
    pub fn new<T: Any + Send>(output: T) -> Self {
        Self(Box::new(output))
    }

    /// Returns the contents of outputs, in order.
    /// - errors: some output has another type: it is of another solver.
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

    /// Encodes what the latest round has changed in the state of the first step.
    fn encode_elements(&self) -> Vec<u8>;

    /// Prepares the state for the rays of the next round.
    fn before_rays(self: Box<Self>, prepared: &Prepared) -> Arc<dyn RayState>;

    /// Creates the solution.
    fn solution(&self, prepared: &Prepared) -> Solution;
}

/// State of a solution before the rays of a round.
pub trait RayState: Debug + Send + Sync {
    /// Casts the rays of block `block` of `blocks` blocks. Returns an output for [`Solver::decode_rays`].
    fn cast(&self, prepared: &Prepared, block: u32, blocks: u32) -> Vec<u8>;

    /// Applies the outputs of all blocks, in order.
    /// - returns `None` if they belong to other elements;
    /// - errors: `cancel` was set.
    fn apply(
        &self,
        prepared: &Prepared,
        rays: Vec<BlockOutput>,
        cancel: &AtomicBool,
    ) -> Result<Option<Box<dyn LinkedState>>, RenderError>;
}
