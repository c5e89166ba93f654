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
