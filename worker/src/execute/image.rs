//! The image task: assembles a frame and computes its error.

use femc_film::{BadSamples, FilmError, FrameImage, ImagePiece, Provenance, SampleRange, ToneCurve, exr};
use femc_model::{BlockCounts, Decision, Failure, NextRound, Phase, Role, StageTemplate};
use femc_pipeline::{SampleAllocation, Settings, StopCondition};

use super::inputs::{read_groups, reduce_tiles, tile_span, tiling};
use super::{Product, Tools, layers, settings_failure, statistics};
use crate::clock::Stopwatch;
use crate::task_table::Task;

pub(crate) fn image(task: &Task, stage: &StageTemplate, tools: &Tools) -> Result<Product, Failure> {
    task.set_phase(Phase::Preparing);
    let watch = Stopwatch::start();
    if task.assignment.spec.next_round == NextRound::Possible {
        return Err(settings_failure(
            "invalid job graph: an image stage cannot decide on rounds; a decide stage must do this",
        ));
    }
    let loaded = tools.cache.scene(&task.spec, &task.client, &tools.fetch)?;
    task.set_phase(Phase::Working);
    task.account.set_preparation(watch.elapsed());
    let work = &task.assignment.spec;
    let (image, bad, samples) = if stage.needs.iter().any(|need| need.role == Role::Pixels) {
        assemble_frame(task, tools)?
    } else {
        let frame = reduce_tiles(task, tile_span(task, stage, Role::Tile)?, tools)?;
        let samples = (0..frame.tiling().count()).flat_map(|tile| frame.ranges(tile)).copied().collect();
        (tools.install(task, || frame.resolve()), frame.bad_samples(), samples)
    };
    let settings: Settings = serde_json::from_str(&task.spec.settings).map_err(settings_failure)?;
    let is_timed = matches!(settings.stop, StopCondition::Time(_));
    let allocation = SampleAllocation::from_tile_samples(&samples).filter(|_| is_timed);
    let text =
        |value: Option<&SampleAllocation>| value.map(serde_json::to_string).transpose().map_err(settings_failure);
    let (count, bytes) = work.artifacts().fold((0, 0), |(n, sum), input| (n + 1, sum + input.bytes));
    let spp = image.mean_spp();
    tracing::debug!(inputs = count, bytes, spp, seconds = watch.seconds(), "assembled the frame");
    let error = tools.install(task, || image.error());
    tracing::debug!(error = error.worst, bad = bad.total(), "measured the frame");
    let provenance = Provenance {
        version: env!("CARGO_PKG_VERSION").into(),
        engine: crate::engine().into(),
        settings: serde_json::to_string(&settings.of_image()).map_err(settings_failure)?,
        bias: settings.method.bias().map(Into::into),
        allocation: text(allocation.as_ref())?,
        scene: loaded.digest.clone(),
        frame: task.assignment.task.stage.frame,
        seconds: work.busy_seconds + watch.seconds(),
        spp,
        error: error.clone(),
        bad,
    };
    let (file, preview) =
        tools.install(task, || pictures(&image, &provenance)).map_err(|error| encode_failure(&error))?;
    let mut product = Product::default();
    product.put(stage, Role::Image, || file);
    product.put(stage, Role::Preview, || preview);
    if stage.outputs.contains(&Role::Statistics) {
        let bytes = statistics::encode_frame_statistics(task, tools)?;
        product.put(stage, Role::Statistics, || bytes);
    }
    if stage.outputs.contains(&Role::LayerImage) {
        let bytes = layers::encode_frame_layers(task, tools, &settings, loaded.scene(), &image, &provenance)?;
        product.put(stage, Role::LayerImage, || bytes);
    }
    product.result.decision = stage.closes.map(|_| Decision::Done);
    product.result.relative_error = error.reached_error();
    product.result.blocks = Some(BlockCounts { all: error.blocks.len() as u32, unlit: error.unlit as u32 });
    product.result.seconds = watch.seconds();
    Ok(product)
}

fn pictures(image: &FrameImage, provenance: &Provenance) -> Result<(Vec<u8>, Vec<u8>), FilmError> {
    let preview = || ToneCurve::auto([&image.color]).picture(&image.color).to_png();
    let (file, preview) = rayon::join(|| exr::encode(image, provenance), preview);
    Ok((file?, preview?))
}

pub(super) fn encode_failure(error: &FilmError) -> Failure {
    Failure::Panicked { message: format!("cannot encode the image: {error}") }
}

/// Returns the resolved pixels of all tiles, the count of rejected samples, and the sample range of each tile.
fn assemble_frame(task: &Task, tools: &Tools) -> Result<(FrameImage, BadSamples, Vec<SampleRange>), Failure> {
    let tiling = tiling(task)?;
    let (mut image, mut bad) = (FrameImage::black(tiling.width, tiling.height), BadSamples::default());
    let mut samples = Vec::with_capacity(tiling.count());
    let account = |piece: &ImagePiece| (piece.tiling(), piece.tiles(), piece.samples().to_vec());
    read_groups(task, Role::Pixels, tools, ImagePiece::decode, account, |piece| {
        bad.merge(piece.bad_samples());
        samples.extend_from_slice(piece.samples());
        image.put(&piece)
    })?;
    Ok((image, bad, samples))
}
