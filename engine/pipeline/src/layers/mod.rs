//! Layers of a frame: light separated by light path expressions while it is rendered.
//!
//! A layer's sample is the part of the picture's sample that its expression accepts. These are the events:
//!
//! - a surface that scatters: `R` or `T` by the side from which the light comes, `D` or `G` by the shares of the BSDF's lobes for
//!   the two directions, independent of the sampler of the direction (a BSDF, a light, a guide); `S` for a single direction. If
//!   both lobes scatter, the path continues in two states, each with its share. So no noise is added to the picture's, and layers
//!   that partition the paths sum up to the picture sample by sample;
//! - a medium that scatters: `V`;
//! - a lamp, found with any technique: `L`; a medium that emits: `O`. There is no background, `B`;
//! - surfaces that light goes straight through: none, since the way to a lamp leads through them, too.

mod dark;
mod features;
mod id_collisions;
mod recorder;

pub use dark::{DarkLayer, dark_layers};
pub(crate) use features::FeatureRecorder;
pub use features::{FeaturePlan, feature_channels, feature_layout, feature_mattes};
pub use id_collisions::cryptomatte_collisions;

use crate::render::RenderTask;
use crate::settings::Settings;
use femc_film::tile::HALVES;
use femc_film::{FilmError, LayerSetLight, LayerTile, LightSums};
use femc_layers::{Automaton, LabelOffset, LabelSet, Layer, LayerError, Vocabulary, parse_layers};
use femc_prepared::Prepared;
use femc_scene::{LampKind, ObjectId, Scene};
use recorder::FinishedPixels;
pub(crate) use recorder::LayerRecorder;
use std::collections::BTreeSet;

/// The layers of a frame, compiled for its scene.
#[derive(Clone, Debug)]
pub struct LayerPlan {
    automaton: Automaton,
    /// Number of layers.
    count: usize,
    /// Labels in the automaton for things without labels.
    plain: LabelOffset,
    /// Row in `surfaces` by object, and index in the row by material. This and the fields below are empty if no layer uses names.
    objects: Vec<u32>,
    materials: Vec<u32>,
    surfaces: Vec<LabelOffset>,
    media: Vec<LabelOffset>,
    lamps: Vec<LabelOffset>,
    /// Whether no surface and no medium has labels.
    is_unlabeled: bool,
}

impl LayerPlan {
    /// Compiles the layers in the settings.
    /// - errors: an expression is invalid, or there are too many states.
    pub fn new(prepared: &Prepared, settings: &Settings) -> Result<Self, LayerError> {
        let (layers, scene) = (&settings.layers, &prepared.scene);
        let vocabulary = Automaton::vocabulary(layers)?;
        let is_labeled = !vocabulary.labels().is_empty();
        let all = |names: &mut dyn Iterator<Item = LabelSet>| if is_labeled { names.collect() } else { Vec::new() };
        let objects = all(&mut scene.objects.iter().map(|object| vocabulary.label_set(&[&object.name])));
        let material = |material: usize| vocabulary.label_set(&[prepared.material_name(material as u32)]);
        let materials = all(&mut (0..prepared.materials.len()).map(material));
        let media = all(&mut scene.media.iter().map(|medium| vocabulary.label_set(&[&medium.name])));
        let lamp = |light: usize| lamp_label_set(prepared, &vocabulary, light as u32);
        let lamps = all(&mut (0..prepared.lights.len()).map(lamp));
        // Ascending, so that the empty set is the first.
        let unique = |sets: &[LabelSet]| {
            let all: BTreeSet<_> = sets.iter().copied().chain([LabelSet::default()]).collect();
            all.into_iter().collect::<Vec<_>>()
        };
        let (rows, columns) = (unique(&objects), unique(&materials));
        let surfaces: Vec<LabelSet> =
            rows.iter().flat_map(|object| columns.iter().map(|material| object.union(*material))).collect();
        let automaton = Automaton::new(layers, &vocabulary, surfaces.iter().chain(&media).chain(&lamps).copied())?;
        let plain = automaton.label_offset(LabelSet::default()).unwrap_or_default();
        let known =
            |sets: Vec<LabelSet>| sets.into_iter().map(|set| automaton.label_offset(set).unwrap_or(plain)).collect();
        let index_in = |all: &[LabelSet], set: &LabelSet| all.partition_point(|one| one < set);
        Ok(Self {
            count: layers.len(),
            plain,
            is_unlabeled: surfaces.iter().chain(&media).all(|set| *set == LabelSet::default()),
            objects: objects.iter().map(|set| (index_in(&rows, set) * columns.len()) as u32).collect(),
            materials: materials.iter().map(|set| index_in(&columns, set) as u32).collect(),
            surfaces: known(surfaces),
            media: known(media),
            lamps: known(lamps),
            automaton,
        })
    }

    /// Returns the number of layers.
    pub fn count(&self) -> usize {
        self.count
    }

    /// Returns the automaton of all expressions.
    pub fn automaton(&self) -> &Automaton {
        &self.automaton
    }

    /// Creates the layers of a tile from the recorders, in order.
    pub(crate) fn tile(
        &self,
        task: &RenderTask<'_>,
        recorders: Vec<LayerRecorder<'_>>,
    ) -> Result<LayerTile, FilmError> {
        let runs = recorders.into_iter().map(LayerRecorder::finish).collect();
        let (counts, light) = concat_pixels(runs, &self.automaton);
        LayerTile::new(task.rect, task.samples.clone(), self.count as u32, counts, light)
    }

    #[inline]
    fn surface(&self, object: Option<ObjectId>, material: u32) -> LabelOffset {
        let row = object.and_then(|object| self.objects.get(object.index())).copied().unwrap_or_default();
        let column = self.materials.get(material as usize).copied().unwrap_or_default();
        self.surfaces.get((row + column) as usize).copied().unwrap_or(self.plain)
    }

    #[inline]
    fn medium(&self, medium: u16) -> LabelOffset {
        self.media.get(usize::from(medium)).copied().unwrap_or(self.plain)
    }

    #[inline]
    fn lamp(&self, light: Option<u32>) -> LabelOffset {
        light.and_then(|light| self.lamps.get(light as usize)).copied().unwrap_or(self.plain)
    }
}

fn lamp_label_set(prepared: &Prepared, vocabulary: &Vocabulary, light: u32) -> LabelSet {
    let lamp = prepared.lamp_name(light);
    let kind = match &lamp.kind {
        LampKind::Surface { material } => material,
        LampKind::Luminaire { path } => path,
        LampKind::Medium { medium } => medium,
    };
    vocabulary.label_set(&[&lamp.object, kind, &format!("{}/{kind}", lamp.object)])
}

/// Returns the labels of a scene's lamps, each once: object and material, or photometric file, of an emitter, and the names of
/// emitting media.
pub fn lamp_labels(scene: &Scene) -> Vec<String> {
    let object = |object: Option<ObjectId>| {
        object.and_then(|object| scene.objects.get(object.index())).map_or("", |object| &object.name)
    };
    let surfaces = scene.groups.iter().flat_map(|group| {
        let faces = group.faces.iter().map(|face| (face.object, face.material));
        faces.chain(group.quadrics.iter().map(|quadric| (quadric.object, quadric.material)))
    });
    let emitting = surfaces.filter_map(|(of, material)| {
        let material =
            scene.materials.get(material.index()).filter(|material| material.ed.photometric_amount() > 0.0)?;
        Some(format!("{}/{}", object(of), material.name))
    });
    let luminaires = scene.groups.iter().flat_map(|group| &group.luminaires).filter_map(|luminaire| {
        let file = scene.photometry.get(luminaire.photometry.index())?;
        Some(format!("{}/{}", object(luminaire.object), file.path))
    });
    let media = scene.media.iter().filter(|medium| medium.glow > 0.0).map(|medium| medium.name.clone());
    emitting.chain(luminaires).chain(media).collect::<BTreeSet<_>>().into_iter().collect()
}

/// Checks that layers use only names that the scene has.
pub(crate) fn check_labels(scene: &Scene, layers: &[Layer]) -> Result<(), LayerError> {
    let expressions = parse_layers(layers)?;
    let labels = || expressions.iter().flat_map(|it| it.events()).flat_map(|event| event.labels());
    if labels().next().is_none() {
        return Ok(());
    }
    // Labels of a lamp: its object, and its material or file.
    let objects: BTreeSet<&str> = scene.objects.iter().map(|object| object.name.as_str()).collect();
    let emitting = scene.materials.iter().map(|it| &it.name).chain(scene.photometry.iter().map(|it| &it.path));
    let emitting: BTreeSet<&str> = emitting.map(String::as_str).collect();
    let media: BTreeSet<&str> = scene.media.iter().map(|medium| medium.name.as_str()).collect();
    let is_object = |label: &str| {
        let within = |name: &str| femc_scene::objects::is_name_within(name, label);
        objects.range(label..).take_while(|name| name.starts_with(label)).any(|name| within(name))
    };
    let is_lamp = |label: &str| {
        let cuts = label.match_indices('/').map(|(at, _)| (&label[..at], &label[at + 1..]));
        cuts.into_iter()
            .any(|(object, kind)| (object.is_empty() || objects.contains(object)) && emitting.contains(kind))
    };
    let is_known =
        |label: &str| is_object(label) || emitting.contains(label) || media.contains(label) || is_lamp(label);
    for (layer, expression) in layers.iter().zip(&expressions) {
        let unknown = expression.events().into_iter().flat_map(|event| event.labels()).find(|label| !is_known(label));
        if let Some(label) = unknown {
            return Err(LayerError::UnknownLabel { layer: layer.name.clone(), label: label.to_owned() });
        }
    }
    Ok(())
}

/// Concatenates the pixels of several runs of rows.
fn concat_pixels(runs: Vec<FinishedPixels>, automaton: &Automaton) -> (Vec<[u32; HALVES]>, Vec<LayerSetLight>) {
    let (mut counts, mut light) = (Vec::new(), vec![Vec::new(); automaton.layer_sets().len()]);
    for run in runs {
        for (all, own) in light.iter_mut().zip(run.light).filter(|(_, own)| !own.is_empty()) {
            all.resize(counts.len(), LightSums::default());
            all.extend(own);
        }
        counts.extend(run.count);
    }
    let pixels = counts.len();
    let lit = light.into_iter().zip(automaton.layer_sets()).filter(|(sums, _)| !sums.is_empty());
    let light = lit.map(|(mut sums, &layers)| {
        sums.resize(pixels, LightSums::default());
        LayerSetLight { layers, sums }
    });
    (counts, light.collect())
}
