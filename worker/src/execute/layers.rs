//! Layers and features. Reduce tasks unite and resolve the sums of a group of tiles once it is known which samples count. The image
//! task assembles the groups beside the picture.

use std::collections::BTreeMap;

use femc_film::tile::NONE_HELD;
use femc_film::{AovPiece, AovTile, FeatureImage, FilmError, FrameImage, LayerImage, Provenance, exr};
use femc_model::{Failure, Phase, Role, StageTemplate};
use femc_pipeline::{Settings, cryptomatte, feature_channels, feature_layout, feature_mattes};
use femc_scene::Scene;

use super::image::encode_failure;
use super::inputs::{LostInputs, expected_samples, previous_stops, read_groups, tile_span, tiling};
use super::{Product, Tools, settings_failure};
use crate::clock::Stopwatch;
use crate::task_table::Task;

/// Unites and resolves the layers of a group of tiles.
pub(super) fn reduce(task: &Task, stage: &StageTemplate, tools: &Tools) -> Result<Product, Failure> {
    task.set_phase(Phase::Working);
    let watch = Stopwatch::start();
    let (tiling, stops) = (tiling(task)?, previous_stops(task, tools)?);
    let begin = stops.as_ref().map_or(0, |stops| stops.progress.first_sample);
    let span = tile_span(task, stage, Role::Layers)?;
    // Parts of each tile.
    let mut inputs: BTreeMap<u32, Vec<_>> = span.clone().map(|tile| (tile, Vec::new())).collect();
    for input in task.assignment.spec.inputs_of_role(Role::Layers) {
        inputs.entry(input.item).or_default().push(input.output.artifact);
    }
    let (mut lost, mut piece) = (LostInputs::default(), AovPiece::new(tiling, span.start as usize));
    for (place, (tile, artifacts)) in inputs.iter().enumerate() {
        if task.is_cancelled() {
            return Err(Failure::Cancelled);
        }
        let ends = stops.as_ref().and_then(|stops| stops.ends.get(*tile as usize)).copied().unwrap_or(NONE_HELD);
        let mut parts = Vec::with_capacity(artifacts.len());
        let here = lost.fetch(task, artifacts, tools)?;
        tools.install(task, || {
            for (artifact, bytes) in &here {
                lost.check(*artifact, AovTile::decode(bytes).map(|part| parts.push(part)));
            }
        });
        if parts.len() < artifacts.len() {
            continue;
        }
        // A tile with missing parts or with wrong samples is rendered again.
        let given = expected_samples(task, place).end;
        let united = AovTile::from_parts(parts, begin, ends).map_err(|error| error.to_string()).and_then(|all| {
            let samples = all.samples();
            if samples.is_some_and(|samples| (samples.start, samples.end) == (begin, given)) {
                piece.put(&all, ends).map_err(|error| error.to_string())
            } else {
                Err(format!("tile {tile} has layers of samples {samples:?}, expected {begin}..{given}"))
            }
        });
        if let Err(message) = united {
            if artifacts.is_empty() {
                return Err(Failure::Panicked { message });
            }
            artifacts.iter().for_each(|artifact| lost.check(*artifact, Err(&message)));
        }
    }
    lost.finish()?;
    let mut product = Product::default();
    product.put(stage, Role::LayerPixels, || tools.install(task, || piece.encode()));
    tracing::debug!(tiles = span.len(), seconds = watch.seconds(), "combined the layers");
    product.result.seconds = watch.seconds();
    Ok(product)
}

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
