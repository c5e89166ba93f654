//! Verdict on a solution: light has come to rest, and surfaces keep no more of it than light sources send.
//!
//! Both are necessary and can be seen in the solution itself; neither says that the light is where it should be. A solution that
//! fails either is no basis for pictures, and none for decisions of path tracing: what it says of one place is as wrong as the whole.

use crate::look::{Look, Summary};
use crate::solve::{RESIDUAL, Report, Solution};
use femc_prepared::Prepared;

/// Flux that surfaces may keep over the flux that is sent. Links are approximate: sound solutions of closed rooms, in fog and for
/// guides above all, keep up to a tenth more than is sent (docs/first-pass.md).
const MOST_KEPT: f64 = 1.25;
/// Light that further iterations may bring, as a share of all light. Where surfaces take hardly any light, iterations end with
/// some of it still on its way.
const MOST_LEFT: f32 = 0.05;

/// Reason why a solution cannot be trusted.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum Untrusted {
    /// Light does not come to rest.
    #[error("its light does not come to rest: after {iterations} iterations the residual is {residual}")]
    Restless {
        /// Number of iterations.
        iterations: usize,
        /// Light that further iterations would bring, as a share of all light; NaN where it has grown beyond all numbers.
        residual: f32,
    },
    /// Surfaces keep more light than is sent.
    #[error("surfaces keep {ratio:.4} times the light that lamps send")]
    Gains {
        /// Flux that surfaces absorb over the flux of all light sources.
        ratio: f64,
    },
}

impl Solution {
    /// Checks that the light has come to rest and that surfaces keep no more than is sent.
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
        // Light that grew, was bounded, and goes on changing has no state to come to rest in.
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
    fn a_solution_that_keeps_less_than_is_sent_and_has_come_to_rest_is_trusted() {
        assert_eq!(of(1e-4, 100.0, 100.0), Ok(()));
        assert_eq!(of(0.0, 0.0, 0.0), Ok(()), "a dark scene");
    }

    #[test]
    fn light_that_grows_does_not_rest_or_is_not_finite_is_not_trusted() {
        assert_eq!(of(1e-5, 100.0, 177.0), Err(Untrusted::Gains { ratio: 1.77 }));
        assert!(matches!(of(1e-5, 100.0, f64::NAN), Err(Untrusted::Gains { .. })));
        assert!(matches!(of(1e-5, 0.0, 1.0), Err(Untrusted::Gains { .. })), "light from nothing");
        assert_eq!(of(0.5, 100.0, 50.0), Err(Untrusted::Restless { iterations: 7, residual: 0.5 }));
        assert!(matches!(of(f32::NAN, 100.0, 50.0), Err(Untrusted::Restless { .. })));
        let (bounded, light) = (Report { residual: 0.01, bounded: true, ..Report::default() }, Summary::default());
        assert!(matches!(bounded.verify(&light), Err(Untrusted::Restless { .. })));
    }
}
