//! Techniques to find light, where there is more than one.

/// Technique to find the light of a source. All techniques are combined with the power heuristic. Each is complete alone, except
/// for sources that it cannot find, so any two can be compared.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum MisTechnique {
    /// A point on a source is sampled; in a medium, together with a distance by the light of that source scattered on the segment.
    Light,
    /// Scattering or the camera's ray hits the source. It never finds point sources.
    Scatter,
}

/// Returns the weight of a technique by the power heuristic, or of a single technique.
/// - `squared_pdf_ratios`: the squared densities of the other techniques, as multiples of its own.
#[inline]
pub(crate) fn mis_weight(single_technique: Option<MisTechnique>, own: MisTechnique, squared_pdf_ratios: f32) -> f32 {
    match single_technique {
        None => 1.0 / (1.0 + squared_pdf_ratios),
        Some(only) => f32::from(u8::from(only == own)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::square;
    use femc_math::elementary::pow;

    #[test]
    fn weights_of_both_techniques_sum_to_one_for_all_densities() {
        let densities = || (-40..=40).map(|exponent| pow(10.0, 0.25 * exponent as f32));
        for light in densities() {
            for scatter in densities() {
                let weights = |only| {
                    let by_light = mis_weight(only, MisTechnique::Light, square(scatter / light));
                    [by_light, mis_weight(only, MisTechnique::Scatter, square(light / scatter))]
                };
                let [a, b] = weights(None);
                assert!((0.0..=1.0).contains(&a) && (0.0..=1.0).contains(&b), "{light} {scatter}: {a} {b}");
                assert!((a + b - 1.0).abs() < 1e-6, "{light} {scatter}: {a} + {b}");
                assert_eq!(weights(Some(MisTechnique::Light)), [1.0, 0.0]);
                assert_eq!(weights(Some(MisTechnique::Scatter)), [0.0, 1.0]);
            }
        }
    }

    #[test]
    fn no_rival_leaves_all_the_weight_and_an_infinite_one_none() {
        assert_eq!(mis_weight(None, MisTechnique::Light, 0.0), 1.0);
        assert_eq!(mis_weight(None, MisTechnique::Scatter, f32::INFINITY), 0.0);
    }
}
