//! How light is found, where there is more than one way.

/// A way to find the light of a source. All of them are joined by the power heuristic; each is complete alone, but for sources that
/// it cannot find, so that any two can be held against each other.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Technique {
    /// A point on a source is drawn; in a medium with a distance by the light of that source that is scattered on the segment.
    Light,
    /// The source is met by chance, by scattering or by the camera's ray; points never.
    Scatter,
}

/// Weight of a technique by the power heuristic, or of one alone.
/// - `others`: the squared densities of the other techniques, as multiples of its own.
#[inline]
pub(crate) fn weight(only: Option<Technique>, own: Technique, others: f32) -> f32 {
    match only {
        None => 1.0 / (1.0 + others),
        Some(only) => f32::from(u8::from(only == own)),
    }
}
