//! Verification of a solution: the light has converged, and surfaces do not absorb more than light sources send.
//!
//! Both conditions are necessary and can be checked on the solution itself. Neither proves that the light is in the right places. A
//! solution that fails either check must not be used for pictures or for decisions of path tracing: its local values are as wrong
//! as its total.

use crate::solve::{Solution, SolveReport};
use crate::tuning::{MAX_ABSORBED_RATIO, MAX_RESIDUAL};
use crate::view::{LightTotals, SolutionView};
use femc_prepared::Prepared;

/// Reason why a solution cannot be trusted.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum VerifyError {
    /// The light does not converge.
    #[error("its light does not converge: after {iterations} iterations the residual is {residual}")]
    NotConverged {
        /// Number of iterations.
        iterations: usize,
        /// Light that further iterations would add, as a share of all light; NaN if it has grown without bound.
        residual: f32,
    },
    /// Surfaces absorb more light than is sent.
    #[error("surfaces absorb {ratio:.4} times the light that lamps emit")]
    EnergyGain {
        /// Flux that surfaces absorb, divided by the flux of all light sources.
        ratio: f64,
    },
}

impl Solution {
    /// Checks that the light has converged, and that surfaces absorb no more than is sent.
    /// - `prepared`: the frame that was solved.
    /// - errors: [`VerifyError`]; a picture of the solution would be wrong.
    pub fn verify(&self, prepared: &Prepared) -> Result<(), VerifyError> {
        self.report.verify(&SolutionView::new(prepared, &self.field).totals())
    }
}

impl SolveReport {
    /// Checks the solution with its light, see [`Solution::verify`].
    pub fn verify(&self, totals: &LightTotals) -> Result<(), VerifyError> {
        let Self { iterations, residual, .. } = *self;
        if !residual.is_finite() || residual > MAX_RESIDUAL {
            return Err(VerifyError::NotConverged { iterations, residual });
        }
        let LightTotals { absorbed, max_emitted: emitted, .. } = *totals;
        if absorbed > MAX_ABSORBED_RATIO * emitted || !absorbed.is_finite() {
            return Err(VerifyError::EnergyGain { ratio: absorbed / emitted });
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn verify_totals(residual: f32, emitted: f64, absorbed: f64) -> Result<(), VerifyError> {
        let report = SolveReport { residual, iterations: 7, ..SolveReport::default() };
        report.verify(&LightTotals { emitted, max_emitted: emitted, absorbed, ..LightTotals::default() })
    }

    #[test]
    fn converged_solution_that_gains_no_energy_is_trusted() {
        assert_eq!(verify_totals(1e-4, 100.0, 100.0), Ok(()));
        assert_eq!(verify_totals(0.0, 0.0, 0.0), Ok(()), "a dark scene");
    }

    #[test]
    fn growing_unconverged_or_nonfinite_light_is_not_trusted() {
        assert_eq!(verify_totals(1e-5, 100.0, 177.0), Err(VerifyError::EnergyGain { ratio: 1.77 }));
        assert!(matches!(verify_totals(1e-5, 100.0, f64::NAN), Err(VerifyError::EnergyGain { .. })));
        assert!(matches!(verify_totals(1e-5, 0.0, 1.0), Err(VerifyError::EnergyGain { .. })), "light from nothing");
        assert_eq!(verify_totals(0.5, 100.0, 50.0), Err(VerifyError::NotConverged { iterations: 7, residual: 0.5 }));
        assert!(matches!(verify_totals(f32::NAN, 100.0, 50.0), Err(VerifyError::NotConverged { .. })));
    }
}
