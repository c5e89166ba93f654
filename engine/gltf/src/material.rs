//! Materials for viewers.

use femc_math::Rgb;
use femc_math::color::luminance;
use femc_prepared::Prepared;
use femc_scattering::Sides;
use serde_json::{Value, json};

/// Name of a material without a name.
const UNNAMED: &str = "unnamed";
/// Smallest opacity, so that clear surfaces stay visible.
const MIN_OPACITY: f32 = 0.2;

/// Returns a material.
/// - base color: the reflectance and transmittance of all kinds, at most 1 per channel
/// - alpha: 1 minus the transmittance, at least 0.2
/// - emission of lamps: their color, with the largest channel 1
pub(crate) fn material(prepared: &Prepared, number: u32) -> Value {
    let described = prepared.scene.materials.get(number as usize);
    let kernel = &prepared.materials[number as usize];
    let parameters = &kernel.parameters;
    let transmitted = parameters.td + parameters.ts;
    let base = (parameters.rd + parameters.rs + transmitted).clamp(Rgb::ZERO, Rgb::ONE);
    let opacity = (1.0 - luminance(transmitted)).clamp(MIN_OPACITY, 1.0);
    let is_clear = luminance(transmitted) > 0.0;
    let [red, green, blue] = base.to_array();
    let mut material = json!({
        "name": name(prepared, number),
        "pbrMetallicRoughness": {
            "baseColorFactor": [red, green, blue, if is_clear { opacity } else { 1.0 }],
            "metallicFactor": 0.0,
            "roughnessFactor": 1.0,
        },
        "doubleSided": parameters.sides == Sides::Two || parameters.ior.is_some(),
    });
    if is_clear {
        material["alphaMode"] = "BLEND".into();
    }
    let color = described.filter(|it| it.ed.amount > 0.0).map_or([0.0; 3], |it| it.ed.color);
    let largest = color.iter().copied().fold(0.0, f64::max);
    if largest > 0.0 && largest.is_finite() {
        material["emissiveFactor"] = color.map(|channel| (channel / largest).clamp(0.0, 1.0) as f32).as_slice().into();
    }
    material
}

/// Returns the name of a material.
fn name(prepared: &Prepared, number: u32) -> &str {
    match prepared.material_name(number) {
        "" => UNNAMED,
        name => name,
    }
}
