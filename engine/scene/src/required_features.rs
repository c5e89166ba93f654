//! Renderer features that a scene needs. They are computed once, so that unused features cost nothing.
//!
//! An answer holds for the whole clip: a scalar that varies counts with its largest key, and an object that is hidden now but shown
//! at some time counts as shown.

use crate::description::{Camera, Material, MediumId, ScatteringPart, Scene};
use std::collections::BTreeSet;

/// Features that the renderer needs; they select its kernel.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct RequiredFeatures {
    /// Whether some space scatters, absorbs or glows.
    pub media: bool,
    /// Whether some surface reflects or transmits specularly, rough or smooth.
    pub glossy: bool,
    /// Whether some surface has an image texture.
    pub textures: bool,
    /// Whether something moves while the shutter is open.
    pub motion: bool,
}

/// A feature that a scene may do without.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Feature {
    /// [`RequiredFeatures::media`]
    Media,
    /// [`RequiredFeatures::glossy`]
    Glossy,
    /// [`RequiredFeatures::textures`]
    Textures,
    /// [`RequiredFeatures::motion`]
    Motion,
}

impl std::fmt::Display for Feature {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Self::Media => "participating media",
            Self::Glossy => "glossy transport",
            Self::Textures => "image textures",
            Self::Motion => "motion blur",
        })
    }
}

/// A feature that is left out, with the reason.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct UnusedFeature {
    /// The feature.
    pub feature: Feature,
    /// Reason, as text for users.
    pub reason: String,
}

impl Scene {
    /// Returns the features that rendering this scene through `camera` needs.
    pub fn required_features(&self, camera: &Camera) -> RequiredFeatures {
        let materials = self.materials_shown();
        RequiredFeatures {
            media: self.media_unused_reason(&materials).is_none(),
            glossy: self.gloss_unused_reason(&materials).is_none(),
            textures: textures_unused_reason(&materials).is_none(),
            motion: self.motion_unused_reason(camera).is_none(),
        }
    }

    /// Returns the features that rendering this scene through `camera` does not need, with the reasons: those that are false in
    /// [`Self::required_features`].
    pub fn unused_features(&self, camera: &Camera) -> Vec<UnusedFeature> {
        let materials = self.materials_shown();
        let reasons = [
            (Feature::Media, self.media_unused_reason(&materials)),
            (Feature::Glossy, self.gloss_unused_reason(&materials)),
            (Feature::Textures, textures_unused_reason(&materials)),
            (Feature::Motion, self.motion_unused_reason(camera)),
        ];
        reasons.into_iter().filter_map(|(feature, reason)| Some(UnusedFeature { feature, reason: reason? })).collect()
    }

    /// Returns for each group whether it is placed in the world, at any depth.
    pub fn placed_groups(&self) -> Vec<bool> {
        let mut placed = vec![false; self.groups.len()];
        let mut open = vec![0];
        while let Some(index) = open.pop() {
            if placed.get(index) == Some(&false) {
                placed[index] = true;
                open.extend(self.groups[index].instances.iter().map(|instance| instance.group.index()));
            }
        }
        placed
    }

    /// Returns the materials of surfaces that are placed and shown at some time.
    fn materials_shown(&self) -> Vec<&Material> {
        let hidden = crate::objects::hidden_objects(&self.objects);
        let blinking = self.blinking_objects();
        let mut shown = BTreeSet::new();
        for (group, _) in self.groups.iter().zip(self.placed_groups()).filter(|(_, placed)| *placed) {
            let faces = group.faces.iter().map(|face| (face.material, face.object));
            let quadrics = group.quadrics.iter().map(|quadric| (quadric.material, quadric.object));
            let is_shown = |object: crate::ObjectId| !hidden[object.index()] || blinking[object.index()];
            let surfaces = faces.chain(quadrics).filter(|(_, object)| object.is_none_or(is_shown));
            shown.extend(surfaces.map(|(material, _)| material.index()));
        }
        shown.into_iter().filter_map(|index| self.materials.get(index)).collect()
    }

    /// Returns the largest value of a `field` of an entity: `now`, or a key of its `vary`.
    pub fn max_over_time(&self, entity: &str, field: &str, now: f64) -> f64 {
        let selector = format!("{entity}.{field}");
        let varies = self.varies.iter().filter(|vary| vary.selector == selector);
        varies.flat_map(|vary| vary.keys.iter().map(|key| key.1)).fold(now, f64::max)
    }

    /// Returns whether nothing emits light at any time: no shown surface, no luminaire and no medium. Every picture of such a scene
    /// is black.
    pub fn is_dark(&self) -> bool {
        let most =
            |kind: &str, name: &str, field: &str, now: f64| self.max_over_time(&format!("{kind}.{name}"), field, now);
        let is_black = |material: &Material| material.ed.color.iter().all(|channel| *channel <= 0.0);
        let emits = |it: &&Material| most("material", &it.name, "ed", it.ed.amount) > 0.0 && !is_black(it);
        let (hidden, blinking) = (crate::objects::hidden_objects(&self.objects), self.blinking_objects());
        let is_shown = |object: crate::ObjectId| !hidden[object.index()] || blinking[object.index()];
        let multipliers_vary = self.varies.iter().any(|vary| vary.selector.ends_with(".multiplier"));
        let shines = |it: &&crate::Luminaire| {
            let candela =
                self.photometry.get(it.photometry.index()).map(|file| file.candela.iter().any(|cd| *cd > 0.0));
            it.object.is_none_or(is_shown) && (multipliers_vary || it.multiplier > 0.0 && candela == Some(true))
        };
        let placed = self.groups.iter().zip(self.placed_groups()).filter(|(_, placed)| *placed);
        !self.materials_shown().iter().any(emits)
            && !placed.flat_map(|(group, _)| &group.luminaires).any(|it| shines(&it))
            && !self.media.iter().any(|it| most("medium", &it.name, "glow", it.glow) > 0.0)
    }

    fn media_unused_reason(&self, shown: &[&Material]) -> Option<String> {
        if self.media.is_empty() {
            return Some("the scene defines no medium".into());
        }
        let regions = self.regions.iter().map(|region| region.medium);
        let placed: BTreeSet<MediumId> = regions.chain(shown.iter().filter_map(|material| material.inside)).collect();
        if placed.is_empty() {
            return Some("no medium fills a box, the scene or the inside of a surface that is shown".into());
        }
        let acts = |medium: &crate::Medium| {
            let entity = format!("medium.{}", medium.name);
            let fields = [("sigma_s", medium.sigma_s), ("sigma_a", medium.sigma_a), ("glow", medium.glow)];
            fields.iter().any(|(field, now)| self.max_over_time(&entity, field, *now) > 0.0)
        };
        let vacuous = !placed.iter().filter_map(|id| self.media.get(id.index())).any(acts);
        vacuous.then(|| "no placed medium scatters, absorbs or glows at any time".into())
    }

    fn gloss_unused_reason(&self, shown: &[&Material]) -> Option<String> {
        let specular = || ScatteringPart::ALL.into_iter().filter(|part| part.roughness_name().is_some());
        let shines = |material: &&Material| {
            let entity = format!("material.{}", material.name);
            specular().any(|part| self.max_over_time(&entity, part.name(), part.fraction(material).amount) > 0.0)
        };
        (!shown.iter().any(shines)).then(|| {
            let names: Vec<String> = specular().map(|part| format!("`{}`", part.name())).collect();
            format!("no surface that is shown has {} above 0", names.join(" or "))
        })
    }

    fn motion_unused_reason(&self, camera: &Camera) -> Option<String> {
        if self.clip.is_none() {
            return Some("a still has no frame interval for the shutter (no `time`)".into());
        }
        let entity = format!("camera.{}", camera.name);
        let varied = |field: &str| self.varies.iter().any(|vary| vary.selector == format!("{entity}.{field}"));
        let closed = camera.shutter_open >= camera.shutter_close;
        if closed && !varied("shutter.open") && !varied("shutter.close") {
            return Some(format!("the shutter of camera `{}` is never open", camera.name));
        }
        let placed = self.placed_groups();
        let mut groups = self.groups.iter().zip(placed).filter(|(_, placed)| *placed).map(|(group, _)| group);
        let moves = |group: &crate::Group| group.instances.iter().any(|i| i.motion.is_animated(&self.paths));
        let still = !camera.is_animated(&self.paths) && !groups.any(moves);
        still.then(|| format!("neither camera `{}` nor any surface follows a path that moves", camera.name))
    }
}

fn textures_unused_reason(shown: &[&Material]) -> Option<String> {
    let textured = |m: &&Material| m.map_rd.is_some() || m.map_ed.is_some() || m.map_n.is_some();
    (!shown.iter().any(textured)).then(|| "no surface that is shown has a `map_rd`, `map_ed` or `map_n`".into())
}
