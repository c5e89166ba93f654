//! The root node of a document.

use femc_math::glam::DVec3;
use serde_json::{Value, json};
use std::f64::consts::FRAC_1_SQRT_2;

/// Returns a node that turns the scene's z up into glTF's y up and adds the origin. The nodes `0..children` are below it.
/// - `origin`: what was subtracted from the positions, m.
pub fn scene_root(origin: DVec3, children: usize) -> Value {
    let [x, y, z] = origin.to_array();
    let mut root = json!({
        "name": "scene", "translation": [x, z, -y], "rotation": [-FRAC_1_SQRT_2, 0.0, 0.0, FRAC_1_SQRT_2],
    });
    // glTF does not allow empty lists.
    if children > 0 {
        root["children"] = (0..children).collect();
    }
    root
}
