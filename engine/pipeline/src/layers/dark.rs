//! Detection of layers that stay black because their paths need an event that nothing in the scene makes.
//!
//! The possible events follow from the scene's description: the scattering of materials that are shown at some time, placed media,
//! and emitters. For a varying scalar, all its values count. The set of events may be too large (a surface that no light reaches
//! counts), but never too small. So a layer that is reported here has no light in any frame.

use crate::settings::Settings;
use femc_layers::{
    EventKind, EventPattern, Expression, LabelSet, UnlitReason, Vocabulary, format_kinds, parse_layers, unlit_reason,
};
use femc_scattering::microfacet::SMOOTH_ALPHA;
use femc_scene::objects::hidden_objects;
use femc_scene::{Material, MediumId, ObjectId, ScatteringPart, Scene, Sides};
use std::collections::BTreeSet;
use std::fmt;

/// A layer that no light of the scene can reach.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct DarkLayer {
    /// Name of the layer.
    pub layer: String,
    /// Reason.
    pub reason: String,
}

impl fmt::Display for DarkLayer {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "layer `{}` stays black: {}", self.layer, self.reason)
    }
}

/// Returns the layers of the settings that stay black in every frame of the scene. Overrides must be applied.
pub fn dark_layers(scene: &Scene, settings: &Settings) -> Vec<DarkLayer> {
    let Ok(expressions) = parse_layers(&settings.layers) else { return Vec::new() };
    let longest = (settings.max_depth > 0).then_some(settings.max_depth as usize);
    let sources = EventSources::new(scene);
    let dark = settings.layers.iter().zip(&expressions).filter_map(|(layer, expression)| {
        let reason = dark_reason(&sources, expression, longest)?;
        Some(DarkLayer { layer: layer.name.clone(), reason })
    });
    dark.collect()
}

fn dark_reason(sources: &EventSources<'_>, expression: &Expression, longest: Option<usize>) -> Option<String> {
    let events = expression.events();
    let vocabulary = Vocabulary::from_labels(events.iter().flat_map(|event| event.labels()))?;
    let made = sources.events(&vocabulary);
    Some(match unlit_reason(expression, &vocabulary, &made, longest)? {
        UnlitReason::NoCamera => "a path begins at the camera; begin the expression with `C`".into(),
        UnlitReason::NoSource => {
            "a path ends at its only light source; end the expression with `L`, `[LOB]` or `.*`".into()
        }
        UnlitReason::TooLong(segments) => format!(
            "its shortest path has {segments} segments, and --max-depth allows {}; raise --max-depth",
            longest.unwrap_or_default()
        ),
        UnlitReason::Missing(missing) => {
            let reasons: Vec<String> =
                missing.iter().map(|event| describe_missing(event, &vocabulary, &made)).collect();
            reasons.join("; ")
        }
    })
}

/// Describes that nothing makes an event, and suggests alternatives.
fn describe_missing(event: &EventPattern, vocabulary: &Vocabulary, made: &BTreeSet<(EventKind, LabelSet)>) -> String {
    use EventKind::{
        Background, Light, Object, ReflectedDiffuse, ReflectedGlossy, ReflectedSpecular, TransmittedDiffuse,
        TransmittedGlossy, TransmittedSpecular, Volume,
    };
    let is_labeled = event.labels().next().is_some();
    // Kinds of events made by the named things, or by anything if the event has no names.
    let any = event.with_any_kind();
    let of_named =
        |(_, set): &&(EventKind, LabelSet)| !is_labeled || any.matches(Light, |label| vocabulary.contains(*set, label));
    let there: BTreeSet<EventKind> = made.iter().filter(of_named).map(|(kind, _)| *kind).collect();
    let kinds: BTreeSet<EventKind> = event.kinds().filter(|kind| *kind != EventKind::Camera).collect();
    let has = |kind| there.contains(&kind);
    let wants = |kind| kinds.contains(&kind);
    let maker = match kinds.iter().all(|kind| kind.is_source()) {
        _ if is_labeled => "nothing",
        true if kinds.len() == 1 && wants(Background) => "no scene",
        true if kinds.len() == 1 && wants(Object) => "no medium of the scene",
        true => "nothing in the scene",
        false if kinds.len() == 1 && wants(Volume) => "no medium of the scene",
        false => "no surface of the scene",
    };
    let mut text = format!("{maker} makes the event `{}`", format_kinds(kinds.iter().copied()));
    text += &event.label_phrase();
    let meaning = match () {
        () if wants(Volume) && kinds.len() == 1 => " (scattering in a medium)",
        () if wants(Object) && kinds.len() == 1 => " (a medium that glows)",
        () if wants(Background) && kinds.len() == 1 => " (a background)",
        () if kinds.iter().all(|kind| matches!(kind, ReflectedSpecular | TransmittedSpecular)) => {
            " (a perfect mirror, or clear glass that bends light)"
        }
        () if kinds.iter().all(|kind| matches!(kind, ReflectedGlossy | TransmittedGlossy)) => " (rough gloss)",
        () if kinds.iter().all(|kind| matches!(kind, ReflectedDiffuse | TransmittedDiffuse)) => " (diffuse scattering)",
        () => "",
    };
    text += meaning;
    let pairs = [(ReflectedSpecular, ReflectedGlossy), (TransmittedSpecular, TransmittedGlossy)];
    let is_rough = pairs.iter().any(|&(mirror, rough)| wants(mirror) && !wants(rough) && has(rough));
    let is_smooth = pairs.iter().any(|&(mirror, rough)| wants(rough) && !wants(mirror) && has(mirror));
    let transmits = [TransmittedDiffuse, TransmittedGlossy, TransmittedSpecular];
    let is_source = kinds.iter().all(|kind| kind.is_source());
    if is_rough {
        text += "; its gloss is rough, which is `G`: write `G` instead of `S`, or `[GS]` for both";
    } else if is_smooth {
        text += "; its gloss is perfectly smooth, which is `S`: write `S` instead of `G`, or `[GS]` for both";
    } else if kinds.iter().all(|kind| transmits.contains(kind)) {
        text += "; light that goes straight through a clear sheet makes no event: leave it out of the expression";
    } else if is_source && has(Light) && !wants(Light) {
        text += "; lamps are `L`: write `L`, or `[LOB]` for all sources";
    } else if is_source && has(Object) && !wants(Object) {
        text += "; media that glow are `O`: write `O`, or `[LOB]` for all sources";
    } else if is_labeled && !there.is_empty() {
        text += &format!("; the events there are `{}`", format_kinds(there));
    }
    text
}

/// Sources of events in a scene.
struct EventSources<'a> {
    scene: &'a Scene,
    /// Objects and materials of surfaces that are shown at some time.
    surfaces: BTreeSet<(Option<ObjectId>, usize)>,
    /// Kinds of scattering by material, and whether it emits.
    scattering: Vec<Vec<EventKind>>,
    emits: Vec<bool>,
    /// Media that are placed.
    media: BTreeSet<MediumId>,
    /// Luminaires: object and photometric file.
    luminaires: BTreeSet<(Option<ObjectId>, usize)>,
}

impl<'a> EventSources<'a> {
    fn new(scene: &'a Scene) -> Self {
        let (hidden, blinking) = (hidden_objects(&scene.objects), scene.blinking_objects());
        let at = |all: &[bool], object: ObjectId| all.get(object.index()).copied().unwrap_or(false);
        let is_shown =
            |object: Option<ObjectId>| object.is_none_or(|object| !at(&hidden, object) || at(&blinking, object));
        let placed = scene.placed_groups();
        let groups = || scene.groups.iter().zip(&placed).filter(|(_, placed)| **placed).map(|(group, _)| group);
        let faces = groups().flat_map(|group| group.faces.iter().map(|face| (face.object, face.material.index())));
        let curved = groups().flat_map(|group| group.quadrics.iter().map(|it| (it.object, it.material.index())));
        let surfaces: BTreeSet<_> = faces.chain(curved).filter(|(object, _)| is_shown(*object)).collect();
        let lamps = groups().flat_map(|group| &group.luminaires);
        let luminaires = lamps.map(|it| (it.object, it.photometry.index())).filter(|(object, _)| is_shown(*object));
        let inside = surfaces.iter().filter_map(|(_, material)| scene.materials.get(*material)?.inside);
        Self {
            scene,
            scattering: scene.materials.iter().map(|material| scattering_kinds(scene, material)).collect(),
            emits: scene.materials.iter().map(|it| largest_value(scene, it, "ed", it.ed.amount) > 0.0).collect(),
            media: scene.regions.iter().map(|region| region.medium).chain(inside).collect(),
            luminaires: luminaires.collect(),
            surfaces,
        }
    }

    /// Returns all events, with the labels of their makers.
    fn events(&self, vocabulary: &Vocabulary) -> BTreeSet<(EventKind, LabelSet)> {
        let scene = self.scene;
        let object =
            |object: Option<ObjectId>| object.and_then(|it| scene.objects.get(it.index())).map_or("", |it| &it.name);
        let lamp = |of: Option<ObjectId>, kind: &str| {
            let of = object(of);
            (EventKind::Light, vocabulary.label_set(&[of, kind, &format!("{of}/{kind}")]))
        };
        let mut all = BTreeSet::new();
        for &(of, number) in &self.surfaces {
            let Some(material) = scene.materials.get(number) else { continue };
            // As in the recorder: the labels of the object and of the material.
            let labels = vocabulary.label_set(&[object(of)]).union(vocabulary.label_set(&[&material.name]));
            all.extend(self.scattering[number].iter().map(|kind| (*kind, labels)));
            if self.emits[number] {
                all.insert(lamp(of, &material.name));
            }
        }
        for &(of, file) in &self.luminaires {
            all.insert(lamp(of, scene.photometry.get(file).map_or("", |file| &file.path)));
        }
        for id in &self.media {
            let Some(medium) = scene.media.get(id.index()) else { continue };
            let labels = vocabulary.label_set(&[&medium.name]);
            let entity = format!("medium.{}", medium.name);
            let most = |field: &str, now: f64| scene.max_over_time(&entity, field, now);
            all.extend((most("sigma_s", medium.sigma_s) > 0.0).then_some((EventKind::Volume, labels)));
            all.extend((most("glow", medium.glow) > 0.0).then_some((EventKind::Object, labels)));
        }
        all
    }
}

fn largest_value(scene: &Scene, material: &Material, field: &str, now: f64) -> f64 {
    scene.max_over_time(&format!("material.{}", material.name), field, now)
}

/// Returns the kinds of scattering that a material may have at some time.
fn scattering_kinds(scene: &Scene, material: &Material) -> Vec<EventKind> {
    use EventKind::{
        ReflectedDiffuse as RD, ReflectedGlossy as RG, ReflectedSpecular as RS, TransmittedDiffuse as TD,
        TransmittedGlossy as TG, TransmittedSpecular as TS,
    };
    let of = format!("material.{}.", material.name);
    let varies = |field: &str| scene.varies.iter().any(|vary| vary.selector.strip_prefix(&of) == Some(field));
    let present = |field: &str, now: f64| largest_value(scene, material, field, now) > 0.0;
    let is_present = |part: ScatteringPart| present(part.name(), part.fraction(material).amount);
    // Whether a specular part is rough at some time, and whether it is smooth at some time.
    let roughness = |part: ScatteringPart| {
        part.roughness_name().zip(part.roughness(material)).map(|(field, now)| {
            let is_rough = now as f32 > SMOOTH_ALPHA;
            if varies(field) { [true, true] } else { [is_rough, !is_rough] }
        })
    };
    // A solid reflects the light that it does not refract, with the same roughness. A sheet transmits light straight through, which
    // is not an event.
    let may_change = ["sides", "ir", "ir.im"].into_iter().any(varies);
    let is_solid = material.sides == Sides::One && material.ior.is_some();
    let refracted = ScatteringPart::SpecularTransmission;
    let may_be_solid = (is_solid || may_change && material.ior.is_some()) && is_present(refracted);
    let may_be_sheet = !is_solid
        || may_change
        || material.ior.is_some_and(|ior| ior.im > 0.0 || ior.re as f32 == 1.0)
        || !is_present(refracted);
    let kinds = |part: ScatteringPart| match (roughness(part), part.is_transmitted()) {
        (None, false) => vec![(RD, true)],
        (None, true) => vec![(TD, true)],
        (Some([rough, smooth]), false) => vec![(RG, may_be_sheet && rough), (RS, may_be_sheet && smooth)],
        (Some([rough, smooth]), true) => vec![(TG, rough), (TS, may_be_solid && smooth)],
    };
    let of_parts = ScatteringPart::ALL.into_iter().filter(|part| is_present(*part)).flat_map(kinds);
    let [rough, smooth] = roughness(refracted).unwrap_or_default();
    let of_boundary = [(RG, may_be_solid && rough), (RS, may_be_solid && smooth)];
    of_parts.chain(of_boundary).filter_map(|(kind, may_be)| may_be.then_some(kind)).collect()
}
