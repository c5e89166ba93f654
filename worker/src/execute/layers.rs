//! Layers and features of an image. The image task assembles them from the resolved groups beside the picture.

use std::collections::BTreeMap;

use femc_film::{AovPiece, FeatureImage, FilmError, FrameImage, LayerImage, Provenance, exr};
use femc_model::{Failure, Role};
use femc_pipeline::{Settings, cryptomatte, feature_channels, feature_layout, feature_mattes};
use femc_scene::Scene;

use super::image::encode_failure;
use super::inputs::{read_groups, tiling};
use super::{Tools, settings_failure};
use crate::clock::Stopwatch;
use crate::task_table::Task;

/// Encodes all layers of a frame as a file.
pub(super) fn encode_frame_layers(
    task: &Task,
    tools: &Tools,
    settings: &Settings,
    scene: &Scene,
    image: &FrameImage,
    provenance: &Provenance,
) -> Result<Vec<u8>, Failure> {
    let (watch, tiling) = (Stopwatch::start(), tiling(task)?);
    let has = (!settings.layers.is_empty(), !settings.features.is_empty());
    let names = settings.layers.iter().map(|layer| layer.name.clone());
    let mut light = LayerImage::black(names, tiling.width, tiling.height);
    let mut features = FeatureImage::new(feature_layout(&settings.features), tiling.width, tiling.height);
    let account = |piece: &AovPiece| (piece.tiling(), piece.tiles(), piece.samples().to_vec());
    read_groups(task, Role::LayerPixels, tools, AovPiece::decode, account, |piece| {
        if (piece.light.is_some(), piece.features.is_some()) != has {
            return Err(FilmError::Corrupt("the layers or features do not match the job's settings"));
        }
        piece.light.iter().try_for_each(|piece| LayerImage::put(&mut light, piece))?;
        piece.features.iter().try_for_each(|piece| features.put(piece))
    })?;
    let texts = mattes(settings, scene, &features)?;
    let names = if has.1 { feature_channels(&settings.features) } else { Vec::new() };
    let features: Vec<(String, Vec<f32>)> = names.into_iter().zip(features.channels).collect();
    let file = tools.install(task, || exr::encode_layers(image, &light, &features, &texts, provenance));
    tracing::debug!(layers = light.len(), features = features.len(), seconds = watch.seconds(), "assembled the layers");
    file.map_err(|error| encode_failure(&error))
}

/// Returns the Cryptomatte attributes of the file: how ids are computed, and the names of the objects in the frame.
fn mattes(settings: &Settings, scene: &Scene, image: &FeatureImage) -> Result<Vec<(String, String)>, Failure> {
    let mut texts = Vec::new();
    for (kind, (matte, names)) in feature_mattes(&settings.features, scene).into_iter().enumerate() {
        let there = image.ids(kind);
        let named = names.iter().filter(|(_, id)| there.contains(id));
        let manifest: BTreeMap<&str, String> = named.map(|(name, id)| (name.as_str(), format!("{id:08x}"))).collect();
        let all = [
            ("name", matte.to_owned()),
            ("hash", "MurmurHash3_32".to_owned()),
            ("conversion", "uint32_to_float32".to_owned()),
            ("manifest", serde_json::to_string(&manifest).map_err(settings_failure)?),
        ];
        texts.extend(all.map(|(what, text)| (cryptomatte::metadata_key(matte, what), text)));
    }
    Ok(texts)
}
