//! Plausibility checks of a file's luminous flux.

use super::{Remark, fields::Fields};

/// Largest ratio of a luminaire's flux to the flux of its lamps that gets no note. Ratings are rounded, and lamps are warmer or
/// colder.
const TOLERANCE: f64 = 1.1;
/// Relative difference up to which a flux counts as 1000 lm.
const EQUAL: f64 = 1e-3;

/// Returns a warning if the table has no light.
pub(super) fn no_light(fields: &Fields, lumens: f64) -> Option<Remark> {
    (lumens == 0.0).then(|| (fields.lumens_at.clone(), "all intensities are 0: the lamp emits no light".into()))
}

/// Returns a note if the table has more light than its lamps.
pub(super) fn excess_flux_remark(fields: &Fields, lumens: f64) -> Option<Remark> {
    let of_lamps = fields.lamps * fields.lumens * fields.ballast;
    let what = format!(
        "the intensities add up to {lumens:.0} lm, more than the {of_lamps:.0} lm of the lamps; the intensities are used; check the \
         candela multiplier"
    );
    (of_lamps > 0.0 && lumens > TOLERANCE * of_lamps).then(|| (fields.lumens_at.clone(), what.into()))
}

/// Returns a hint if the file may be normalized to 1000 lm: the table has that flux, or its lamps have that flux and nothing scales
/// them.
pub(super) fn normalization_hint(fields: &Fields, lumens: f64) -> Option<Remark> {
    let is_1000 = |lumens: f64| (lumens / 1000.0 - 1.0).abs() <= EQUAL;
    let excess = excess_flux_remark(fields, lumens).is_some();
    let gives = if is_1000(lumens) {
        "the flux of this file is exactly 1000 lm".to_owned()
    } else if is_1000(fields.lumens) && fields.multiplier == 1.0 && lumens > 0.0 && !excess {
        format!("the flux of this file is {lumens:.0} lm from lamps of exactly 1000 lm")
    } else {
        return None;
    };
    let what = format!(
        "{gives}: intensities are often normalized to lamps of 1000 lm (cd/klm); if so, scale them by the lamp's flux / 1000 lm, \
         as in `ies FILE -m 2.5` for 2500 lm"
    );
    Some((fields.lumens_at.clone(), what.into()))
}
