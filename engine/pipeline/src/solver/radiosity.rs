//! Hierarchical radiosity as a solver.

use super::{BlockOutput, LinkedState, RayState, Solver};
use crate::render::RenderError;
use crate::settings::Method;
use femc_prepared::Prepared;
use femc_radiosity::{
    CastingState, GuideKind, RAY_ROUNDS, RayHits, Solution, SolveOptions, SolveReport, SolverState, StepDecodeError,
};
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

/// Maximum error of a link if the solution guides paths. Such a solution need not be exact; it only has to know where light comes
/// from.
const GUIDING_ERROR: f32 = 1.0;

/// Hierarchical radiosity with the options of a method.
pub(super) struct Radiosity(SolveOptions);

impl Radiosity {
    pub(super) fn new(method: Method) -> Self {
        Self(match method {
            Method::Femc => SolveOptions { error: GUIDING_ERROR, ..SolveOptions::default() },
            Method::Femc1998 => {
                SolveOptions { error: GUIDING_ERROR, guides: GuideKind::Tables, ..SolveOptions::default() }
            }
            Method::Auto | Method::Pt | Method::Fem => SolveOptions::default(),
        })
    }
}

impl Solver for Radiosity {
    fn key(&self) -> Vec<u8> {
        let SolveOptions { error, memory, guides } = self.0;
        let (error, memory) = (error.to_bits().to_le_bytes(), (memory as u64).to_le_bytes());
        error.into_iter().chain(memory).chain([guides as u8]).collect()
    }

    fn rounds(&self) -> u32 {
        RAY_ROUNDS
    }

    fn min_bytes(&self, prepared: &Prepared) -> u64 {
        femc_radiosity::min_solve_bytes(prepared)
    }

    fn solve(&self, prepared: &Prepared, cancel: &AtomicBool) -> Result<Solution, RenderError> {
        femc_radiosity::solve(prepared, &self.0, cancel).map_err(|_| RenderError::Cancelled)
    }

    fn begin(&self, prepared: &Prepared, cancel: &AtomicBool) -> Result<Box<dyn LinkedState>, RenderError> {
        let state = SolverState::new(prepared, &self.0, cancel).map_err(|_| RenderError::Cancelled)?;
        Ok(Box::new(Linked(state, self.0)))
    }

    fn decode(
        &self,
        prepared: &Prepared,
        start: &[u8],
        latest: Option<&[u8]>,
    ) -> Result<Box<dyn LinkedState>, StepDecodeError> {
        let (elements, links) = SolverState::split_start(start)?;
        Ok(Box::new(Linked(SolverState::decode(prepared, latest.unwrap_or(elements), links)?, self.0)))
    }

    fn decode_rays(&self, bytes: &[u8]) -> Result<BlockOutput, StepDecodeError> {
        Ok(BlockOutput::new(RayHits::decode(bytes)?))
    }
}

#[derive(Debug)]
struct Linked(SolverState, SolveOptions);

impl LinkedState for Linked {
    fn report(&self) -> SolveReport {
        self.0.report()
    }

    fn encode_start(&self) -> Vec<u8> {
        self.0.encode_start()
    }

    fn encode_elements(&self) -> Vec<u8> {
        self.0.encode_elements()
    }

    fn before_rays(self: Box<Self>, prepared: &Prepared) -> Arc<dyn RayState> {
        let Self(state, options) = *self;
        Arc::new(Casting(state.plan_rays(prepared, &options), options))
    }

    fn solution(&self, prepared: &Prepared) -> Solution {
        self.0.solution(prepared, &self.1)
    }
}

#[derive(Debug)]
struct Casting(CastingState, SolveOptions);

impl RayState for Casting {
    fn cast(&self, prepared: &Prepared, block: u32, blocks: u32) -> Vec<u8> {
        self.0.cast(prepared, block, blocks).encode()
    }

    fn apply(
        &self,
        prepared: &Prepared,
        rays: Vec<BlockOutput>,
        cancel: &AtomicBool,
    ) -> Result<Option<Box<dyn LinkedState>>, RenderError> {
        let Ok(hits) = BlockOutput::unwrap_all(rays) else { return Ok(None) };
        let applied = self.0.apply_hits(prepared, &self.1, hits, cancel).map_err(|_| RenderError::Cancelled)?;
        Ok(applied.map(|state| -> Box<dyn LinkedState> { Box::new(Linked(state, self.1)) }))
    }
}
