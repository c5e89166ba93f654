//! Checks energy and color of materials.

use super::{Faults, Scope};
use crate::{
    FaultKind::{EnergyGain, OutOfGamut, Scale},
    Severity::{Error, Note, Warning},
    description::{Material, ScatteringPart},
};

/// Emittance above that of the sun's surface, lm/m2.
const MAX_EMITTANCE: f64 = 1e9;
/// Tolerance for rounded white points.
const ROOM: f64 = 1e-3;

pub(super) fn check(scope: &Scope<'_>, faults: &mut Faults) {
    let materials = scope.scene.materials.iter().zip(&scope.used).filter(|(_, used)| **used);
    for (material, _) in materials {
        check_energy(material, faults);
        check_gamut(material, faults);
        if material.ed.amount > MAX_EMITTANCE {
            let message = format!("{} emits {:.1e} lm/m2", title(material), material.ed.amount);
            faults.add(Warning, Scale, material.location, message, "check the unit of `ed`");
        }
    }
}

/// Returns `material `name``, or `the unnamed material`.
pub(super) fn title(material: &Material) -> String {
    if material.name.is_empty() { "the unnamed material".into() } else { format!("material `{}`", material.name) }
}

fn check_energy(material: &Material, faults: &mut Faults) {
    let sum = material.reflectance_sum();
    if sum > Material::SUM_LIMIT {
        let message =
            format!("{} returns {sum:.4} times the light that it receives ({})", title(material), ScatteringPart::SUM);
        faults.add(Error, EnergyGain, material.location, message, "reduce these values");
        return;
    }
    let channels = [0, 1, 2].map(|channel| material.channel_demand(channel));
    let (strongest, value) = if channels[0] >= channels[1] && channels[0] >= channels[2] {
        ("red", channels[0])
    } else if channels[1] >= channels[2] {
        ("green", channels[1])
    } else {
        ("blue", channels[2])
    };
    if value > 1.0 + ROOM {
        let message = format!(
            "{} would return {value:.3} times the {strongest} light that it receives: limited to the received light",
            title(material)
        );
        faults.add(Warning, EnergyGain, material.location, message, "make it darker, or its color less saturated");
    }
}

fn check_gamut(material: &Material, faults: &mut Faults) {
    let parts = ScatteringPart::ALL.map(|part| (part.name(), part.fraction(material)));
    for (name, tinted) in parts.into_iter().chain([("ed", &material.ed)]).filter(|(_, tinted)| tinted.amount > 0.0) {
        if let Some(channel) = tinted.color.iter().position(|value| *value < -1e-3) {
            let message = format!(
                "the color of `{name}` of {} is outside Rec.709: {} = {:.3}",
                title(material),
                ["red", "green", "blue"][channel],
                tinted.color[channel]
            );
            faults.add(Note, OutOfGamut, material.location, message, "use a less saturated color if this matters");
        }
    }
}
