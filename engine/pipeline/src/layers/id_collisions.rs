//! Detection of names that share one id in a Cryptomatte, so that a compositor cannot separate them.

use super::features::feature_mattes;
use femc_layers::{Feature, cryptomatte};
use femc_scene::Scene;
use std::collections::{BTreeMap, BTreeSet};

/// Returns a warning for every id that stands for different things in one of these features: an object or material called `default`
/// beside unnamed things, and different names with one hash.
pub fn cryptomatte_collisions(scene: &Scene, features: &BTreeSet<Feature>) -> Vec<String> {
    let mut all = Vec::new();
    for feature in features.iter().filter(|feature| feature.cryptomatte_name().is_some()) {
        let kind = feature.name();
        if has_default(scene, *feature) && has_unnamed(scene, *feature) {
            let unnamed =
                if *feature == Feature::Object { "the surfaces without an object" } else { "the unnamed material" };
            all.push(format!(
                "--layers {kind}: the {kind} called `{}` has the same Cryptomatte id as {unnamed}: a compositor \
                 cannot separate them; rename it",
                cryptomatte::UNNAMED
            ));
        }
        let mut names: BTreeMap<u32, BTreeSet<String>> = BTreeMap::new();
        for (_, ids) in feature_mattes([feature], scene) {
            ids.into_iter().for_each(|(name, id)| _ = names.entry(id).or_default().insert(name));
        }
        for names in names.into_values().filter(|names| names.len() > 1) {
            let names: Vec<String> = names.iter().map(|name| format!("`{name}`")).collect();
            let names = names.join(", ");
            all.push(format!(
                "--layers {kind}: {names} have the same Cryptomatte id by chance: a compositor cannot separate them; rename one"
            ));
        }
    }
    all
}

fn has_default(scene: &Scene, feature: Feature) -> bool {
    let is_default = |name: &String| name == cryptomatte::UNNAMED;
    match feature {
        Feature::Object => scene.objects.iter().any(|object| is_default(&object.name)),
        _ => scene.materials.iter().any(|material| is_default(&material.name)),
    }
}

/// Checks whether a surface is in no object, or has the unnamed material.
fn has_unnamed(scene: &Scene, feature: Feature) -> bool {
    let faces = scene.groups.iter().flat_map(|group| group.faces.iter().map(|face| (face.object, face.material)));
    let curved = scene.groups.iter().flat_map(|group| group.quadrics.iter().map(|it| (it.object, it.material)));
    faces.chain(curved).any(|(object, material)| match feature {
        Feature::Object => object.is_none(),
        _ => scene.materials.get(material.index()).is_none_or(|material| material.name.is_empty()),
    })
}
