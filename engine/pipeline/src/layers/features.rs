//! Features of a frame (AOVs): data of the first visible surface, in addition to the light.
//!
//! The recorder itself traces the camera ray of each sample to the first surface ([`first_surface`]). This costs one more ray per
//! sample, and fog or mirrors of the path do not affect it. Without features no recorder receives camera rays, and there is no
//! cost.

use crate::preparation::frame_spec;
use crate::render::RenderTask;
use crate::settings::Settings;
use femc_film::features::RANKS;
use femc_film::{FeatureLayout, FeatureSums, FeatureTile, FilmError};
use femc_geometry::Ray;
use femc_layers::{Feature, cryptomatte};
use femc_math::{Rgb, SampleStream};
use femc_montecarlo::first_surface;
use femc_montecarlo::record::{BranchEvent, Continuation, Contribution, RecordLevel, Recorder, Termination, Vertex};
use femc_prepared::camera::View;
use femc_prepared::{NextFrame, PrepareError, Prepared};
use femc_scene::Scene;

/// The features requested for a frame.
#[derive(Clone, Debug)]
pub struct FeaturePlan {
    features: Vec<Feature>,
    seed: u64,
    /// Next frame, if motion is requested and there is one.
    next: Option<NextFrame>,
    /// Ids of the scene's objects and materials, if they are requested.
    objects: Vec<u32>,
    materials: Vec<u32>,
    /// Id of unnamed things.
    unnamed: u32,
}

impl FeaturePlan {
    /// Returns the features in the settings. `None`: there are none.
    /// - errors: the next frame, which motion needs, cannot be prepared.
    pub fn from_settings(prepared: &Prepared, settings: &Settings) -> Result<Option<Self>, PrepareError> {
        let features: Vec<Feature> = settings.features.iter().copied().collect();
        if features.is_empty() {
            return Ok(None);
        }
        let has_motion = features.contains(&Feature::Motion);
        let next =
            if has_motion { NextFrame::from_frame(prepared, &frame_spec(settings, prepared.frame))? } else { None };
        let ids = |feature, names: &mut dyn Iterator<Item = &str>| -> Vec<u32> {
            if features.contains(&feature) { names.map(cryptomatte_id).collect() } else { Vec::new() }
        };
        let objects = ids(Feature::Object, &mut prepared.scene.objects.iter().map(|object| object.name.as_str()));
        let materials = 0..prepared.materials.len() as u32;
        let materials = ids(Feature::Material, &mut materials.map(|material| prepared.material_name(material)));
        Ok(Some(Self { features, seed: settings.seed, next, objects, materials, unnamed: cryptomatte_id("") }))
    }

    /// Returns the layout of a pixel.
    pub fn layout(&self) -> FeatureLayout {
        feature_layout(&self.features)
    }

    /// Creates the features of a tile from the recorders, in order.
    pub(crate) fn tile(
        &self,
        task: &RenderTask<'_>,
        recorders: Vec<FeatureRecorder<'_>>,
    ) -> Result<FeatureTile, FilmError> {
        let sums = FeatureSums::concat(self.layout(), recorders.into_iter().map(|recorder| recorder.sums));
        FeatureTile::new(task.rect, task.samples.clone(), sums)
    }
}

/// Returns the id of a name, or of the empty name.
fn cryptomatte_id(name: &str) -> u32 {
    cryptomatte::id(if name.is_empty() { cryptomatte::UNNAMED } else { name })
}

/// Returns the layout of a pixel with these features.
pub fn feature_layout<'a>(features: impl IntoIterator<Item = &'a Feature>) -> FeatureLayout {
    features.into_iter().fold(FeatureLayout::default(), |all, feature| FeatureLayout {
        values: all.values + feature.channels().len() as u32,
        ids: all.ids + u32::from(feature.cryptomatte_name().is_some()),
    })
}

/// Returns the Cryptomattes of these features, in the order of their ids: the name of each, and the scene names with their ids.
pub fn feature_mattes<'a>(
    features: impl IntoIterator<Item = &'a Feature>,
    scene: &Scene,
) -> Vec<(&'static str, Vec<(String, u32)>)> {
    let with_ids = |names: &mut dyn Iterator<Item = &String>| {
        let named = names.filter(|name| !name.is_empty()).map(|name| (name.clone(), cryptomatte_id(name)));
        named.chain([(cryptomatte::UNNAMED.to_owned(), cryptomatte_id(""))]).collect()
    };
    let of = |feature: &Feature| {
        let names = match feature {
            Feature::Object => with_ids(&mut scene.objects.iter().map(|object| &object.name)),
            Feature::Material => with_ids(&mut scene.materials.iter().map(|material| &material.name)),
            _ => Vec::new(),
        };
        feature.cryptomatte_name().map(|matte| (matte, names))
    };
    features.into_iter().filter_map(of).collect()
}

/// Returns the names of the channels of these features, in the order of
/// [`FeatureImage::channels`](femc_film::FeatureImage::channels).
pub fn feature_channels<'a>(features: impl IntoIterator<Item = &'a Feature> + Clone) -> Vec<String> {
    let names = |feature: &Feature| {
        let name = feature.name();
        feature.channels().iter().map(move |part| format!("{name}.{part}"))
    };
    // Each layer of a Cryptomatte has two ranks: id, share, id, share.
    let ranks = |matte: &'static str| {
        let parts = (0..RANKS / 2).flat_map(|number| ["R", "G", "B", "A"].map(|part| (number, part)));
        parts.map(move |(number, part)| format!("{matte}{number:02}.{part}"))
    };
    let values = features.clone().into_iter().flat_map(names);
    let mattes = features.into_iter().filter_map(|feature| feature.cryptomatte_name()).flat_map(ranks);
    values.chain(["coverage.A".to_owned()]).chain(mattes).collect()
}

/// Recorder that sums the features of the pixels that a tracer renders one after the other.
pub(crate) struct FeatureRecorder<'a> {
    plan: &'a FeaturePlan,
    prepared: &'a Prepared,
    sums: FeatureSums,
    current_pixel: Option<u32>,
    // State of the current sample:
    key: [u32; 2],
    values: Vec<f64>,
    ids: Vec<u32>,
    has_hit: bool,
}

impl<'a> FeatureRecorder<'a> {
    pub(crate) fn new(plan: &'a FeaturePlan, prepared: &'a Prepared) -> Self {
        let sums = FeatureSums::new(plan.layout());
        let (values, ids) = (Vec::new(), Vec::new());
        Self { plan, prepared, sums, current_pixel: None, key: [0; 2], values, ids, has_hit: false }
    }
}

impl Recorder for FeatureRecorder<'_> {
    const WANTS_OCCLUDERS: bool = false;
    const WANTS_ZERO_LIGHT: bool = false;
    const WANTS_CAMERA_RAYS: bool = true;

    fn begin_sample(&mut self, pixel: u32, sample: u32) -> RecordLevel {
        if self.current_pixel != Some(pixel) {
            self.current_pixel = Some(pixel);
            self.sums.begin_pixel();
        }
        self.key = [pixel, sample];
        RecordLevel::End
    }

    fn camera_ray(&mut self, view: &View, lens: [f32; 2], ray: &Ray) {
        let prepared = self.prepared;
        let stream = SampleStream::new(self.plan.seed, prepared.frame, self.key[0], self.key[1]);
        let first = first_surface(prepared, ray, stream);
        self.has_hit = first.is_some();
        let Some(first) = first else { return };
        self.values.clear();
        self.ids.clear();
        for feature in &self.plan.features {
            match feature {
                Feature::Normal => self.values.extend(first.normal.as_dvec3().to_array()),
                Feature::Position => self.values.extend(prepared.to_world(first.point.position)),
                Feature::Depth => self.values.push(prepared.camera.depth(first.point.position, ray.time).into()),
                Feature::Albedo => self.values.extend(first.albedo.to_array().map(f64::from)),
                Feature::FirstPassError => self.values.push(first.field_error.into()),
                Feature::Motion => {
                    let point = (first.hit.instance, first.point.position, ray.time);
                    let next = self.plan.next.as_ref();
                    let motion = next.and_then(|next| next.motion(prepared, point, (view, lens)));
                    self.values.extend(motion.unwrap_or_default().map(f64::from));
                }
                Feature::Object => {
                    let object = prepared.object_of(first.hit.instance, first.hit.primitive);
                    let known = object.and_then(|object| self.plan.objects.get(object.index()));
                    self.ids.push(known.copied().unwrap_or(self.plan.unnamed));
                }
                Feature::Material => {
                    let known = self.plan.materials.get(first.point.material as usize);
                    self.ids.push(known.copied().unwrap_or(self.plan.unnamed));
                }
            }
        }
    }

    fn vertex(&mut self, _: impl FnOnce() -> Vertex) {}

    fn branch(&mut self, _: BranchEvent) {}

    fn leave(&mut self, _: Continuation) {}

    fn occluded(&mut self, _: impl FnOnce() -> Ray) {}

    fn contribution(&mut self, _: impl FnOnce() -> Contribution) {}

    fn terminate(&mut self, _: Termination) {}

    fn end_sample(&mut self, color: Option<Rgb>) {
        // Samples that the film rejects do not count here either.
        if color.is_some() {
            self.sums.add(self.has_hit.then_some((&self.values, &self.ids)));
        }
    }
}
