//! Materials: energy and color.

use super::{Faults, Scope};
use crate::{
    FaultKind::{EnergyGain, OutOfGamut, Scale},
    Severity::{Error, Note, Warning},
    description::{Material, Scene, Sides, Tinted},
};

/// Emittance beyond the surface of the sun's order, lm/m2.
const BRIGHTEST: f64 = 1e9;
/// Room for rounded white points.
const ROOM: f64 = 1e-3;

pub(super) fn check(scope: &Scope<'_>, faults: &mut Faults) {
    let materials = scope.scene.materials.iter().zip(&scope.used).filter(|(_, used)| **used);
    for (material, _) in materials {
        energy(scope.scene, material, faults);
        gamut(material, faults);
        if material.ed.amount > BRIGHTEST {
            let message = format!("{} emits {:.1e} lm/m2", title(material), material.ed.amount);
            faults.add(Warning, Scale, material.location, message, "check the unit of `ed`");
        }
    }
}

/// `material `name``, or `the unnamed material`.
pub(super) fn title(material: &Material) -> String {
    if material.name.is_empty() { "the unnamed material".into() } else { format!("material `{}`", material.name) }
}

fn energy(scene: &Scene, material: &Material, faults: &mut Faults) {
    let sum = material.reflectance_sum();
    if sum > Material::SUM_LIMIT {
        let message =
            format!("{} gives back {sum:.4} times the light that it gets (rd + td + rs + ts)", title(material));
        faults.add(Error, EnergyGain, material.location, message, "make them smaller");
        return;
    }
    let channels = [0, 1, 2].map(|channel| gain(scene, material, channel));
    let (strongest, value) = if channels[0] >= channels[1] && channels[0] >= channels[2] {
        ("red", channels[0])
    } else if channels[1] >= channels[2] {
        ("green", channels[1])
    } else {
        ("blue", channels[2])
    };
    if value > 1.0 + ROOM {
        let message = format!("{} gives back {value:.3} times the {strongest} light that it gets", title(material));
        faults.add(Warning, EnergyGain, material.location, message, "make it darker, or its color less saturated");
    }
}

/// Most of the light of a channel that comes back in all directions together.
fn gain(scene: &Scene, material: &Material, channel: usize) -> f64 {
    let part = |tinted: &Tinted| (tinted.amount * tinted.color[channel]).max(0.0);
    let texture = material.map_rd.and_then(|image| scene.images.get(image.index()));
    let brightest = texture
        .map_or(1.0, |image| image.pixels.iter().fold(0.0_f64, |most, pixel| most.max(f64::from(pixel[channel]))));
    let diffuse = part(&material.rd) * brightest + part(&material.td);
    let (rs, ts) = (part(&material.rs), part(&material.ts));
    match (material.ior, material.sides) {
        // Fresnel shares the light out between the lobes, so none needs to leave room for the others.
        (Some(_), Sides::One) if material.ts.amount > 0.0 => ts.max(diffuse),
        (Some(_), _) => (rs + ts).max(diffuse),
        (None, _) => diffuse + rs + ts,
    }
}

fn gamut(material: &Material, faults: &mut Faults) {
    let quantities =
        [("rd", &material.rd), ("td", &material.td), ("rs", &material.rs), ("ts", &material.ts), ("ed", &material.ed)];
    for (name, tinted) in quantities.into_iter().filter(|(_, tinted)| tinted.amount > 0.0) {
        if let Some(channel) = tinted.color.iter().position(|value| *value < -1e-3) {
            let message = format!(
                "the color of `{name}` of {} is outside Rec.709: {} = {:.3}",
                title(material),
                ["red", "green", "blue"][channel],
                tinted.color[channel]
            );
            faults.add(Note, OutOfGamut, material.location, message, "take a less saturated color if it matters");
        }
    }
}
