//! Verification of a solution: the light has converged, and surfaces do not absorb more than light sources send.
//!
//! Both conditions are necessary and can be checked on the solution itself. Neither proves that the light is in the right places. A
//! solution that fails either check must not be used for pictures or for decisions of path tracing: its local values are as wrong
//! as its total.

use crate::look::{Look, Summary};
use crate::solve::{RESIDUAL, Report, Solution};
use femc_prepared::Prepared;

/// Maximum ratio of the absorbed flux to the flux that is sent. Links are approximate: valid solutions of closed rooms, especially
/// in fog and for guides, absorb up to a tenth more than is sent (docs/first-pass.md).
const MOST_KEPT: f64 = 1.25;
/// Maximum light that further iterations may add, as a share of all light. If surfaces absorb very little, iterations end with some
/// light not yet absorbed.
const MOST_LEFT: f32 = 0.05;

/// Reason why a solution cannot be trusted.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum Untrusted {
    /// The light does not converge.
    #[error("its light does not converge: after {iterations} iterations the residual is {residual}")]
    Restless {
        /// Number of iterations.
        iterations: usize,
        /// Light that further iterations would add, as a share of all light; NaN if it has grown without bound.
        residual: f32,
    },
    /// Surfaces absorb more light than is sent.
    #[error("surfaces absorb {ratio:.4} times the light that lamps emit")]
    Gains {
        /// Flux that surfaces absorb, divided by the flux of all light sources.
        ratio: f64,
    },
}

impl Solution {
    /// Checks that the light has converged, and that surfaces absorb no more than is sent.
    /// - `prepared`: the frame that was solved.
    /// - errors: [`Untrusted`]; a picture of the solution would be wrong.
    pub fn verify(&self, prepared: &Prepared) -> Result<(), Untrusted> {
        self.report.verify(&Look::new(prepared, self).summary())
    }
}

impl Report {
    /// Checks the solution with its light, see [`Solution::verify`].
    pub fn verify(&self, light: &Summary) -> Result<(), Untrusted> {
        let Self { iterations, residual, bounded, .. } = *self;
        // Light that grew, was bounded, and still changes cannot converge.
        let most = if bounded { RESIDUAL } else { MOST_LEFT };
        if !residual.is_finite() || residual > most {
            return Err(Untrusted::Restless { iterations, residual });
        }
        let Summary { absorbed, emitted_at_most: emitted, .. } = *light;
        if absorbed > MOST_KEPT * emitted || !absorbed.is_finite() {
            return Err(Untrusted::Gains { ratio: absorbed / emitted });
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(residual: f32, emitted: f64, absorbed: f64) -> Result<(), Untrusted> {
        let report = Report { residual, iterations: 7, ..Report::default() };
        report.verify(&Summary { emitted, emitted_at_most: emitted, absorbed, ..Summary::default() })
    }

    #[test]
    fn converged_solution_that_gains_no_energy_is_trusted() {
        assert_eq!(of(1e-4, 100.0, 100.0), Ok(()));
        assert_eq!(of(0.0, 0.0, 0.0), Ok(()), "a dark scene");
    }

    #[test]
    fn growing_unconverged_or_nonfinite_light_is_not_trusted() {
        assert_eq!(of(1e-5, 100.0, 177.0), Err(Untrusted::Gains { ratio: 1.77 }));
        assert!(matches!(of(1e-5, 100.0, f64::NAN), Err(Untrusted::Gains { .. })));
        assert!(matches!(of(1e-5, 0.0, 1.0), Err(Untrusted::Gains { .. })), "light from nothing");
        assert_eq!(of(0.5, 100.0, 50.0), Err(Untrusted::Restless { iterations: 7, residual: 0.5 }));
        assert!(matches!(of(f32::NAN, 100.0, 50.0), Err(Untrusted::Restless { .. })));
        let (bounded, light) = (Report { residual: 0.01, bounded: true, ..Report::default() }, Summary::default());
        assert!(matches!(bounded.verify(&light), Err(Untrusted::Restless { .. })));
    }
}
