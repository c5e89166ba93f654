//! The image task: assembles a frame and computes its error.

use femc_film::{BadSamples, FilmError, FrameImage, Piece, Provenance, SampleRange, ToneCurve, exr};
use femc_model::{Blocks, Decision, Failure, More, Phase, Role, Template};
use femc_pipeline::{Allocation, Settings, Stop};

use super::union::{groups, tiles, tiling, union};
use super::{Product, Tools, layers, statistics, unfit};
use crate::clock::Stopwatch;
use crate::table::Task;

pub(crate) fn image(task: &Task, stage: &Template, tools: &Tools) -> Result<Product, Failure> {
    task.enter(Phase::Preparing);
    let watch = Stopwatch::start();
    if task.assignment.work.more == More::Rounds {
        return Err(unfit("invalid job graph: an image stage cannot decide on rounds; a decide stage must do this"));
    }
    let read = tools.cache.scene(&task.spec, &task.client, &tools.fetch)?;
    task.enter(Phase::Working);
    task.account.prepared(watch.elapsed());
    let work = &task.assignment.work;
    let (image, bad, samples) = if stage.needs.iter().any(|need| need.role == Role::Pixels) {
        put_together(task, tools)?
    } else {
        let frame = union(task, tiles(task, stage, Role::Tile)?, tools)?;
        let samples = (0..frame.tiling().count()).flat_map(|tile| frame.ranges(tile)).copied().collect();
        (tools.install(task, || frame.resolve()), frame.bad(), samples)
    };
    let settings: Settings = serde_json::from_str(&task.spec.settings).map_err(unfit)?;
    let is_timed = matches!(settings.stop, Stop::Time(_));
    let allocation = Allocation::of(&samples).filter(|_| is_timed);
    let text = |value: Option<&Allocation>| value.map(serde_json::to_string).transpose().map_err(unfit);
    let (count, bytes) = work.artifacts().fold((0, 0), |(n, sum), input| (n + 1, sum + input.bytes));
    let spp = image.mean_spp();
    tracing::debug!(inputs = count, bytes, spp, seconds = watch.seconds(), "assembled the frame");
    let error = tools.install(task, || image.error());
    tracing::debug!(error = error.worst, bad = bad.total(), "measured the frame");
    let provenance = Provenance {
        version: env!("CARGO_PKG_VERSION").into(),
        engine: crate::engine().into(),
        settings: serde_json::to_string(&settings.stated()).map_err(unfit)?,
        bias: settings.method.bias().map(Into::into),
        allocation: text(allocation.as_ref())?,
        scene: read.digest.clone(),
        frame: task.assignment.task.stage.frame,
        seconds: work.busy_seconds + watch.seconds(),
        spp,
        error: error.clone(),
        bad,
    };
    let (file, preview) =
        tools.install(task, || pictures(&image, &provenance)).map_err(|error| damaged_picture(&error))?;
    let mut product = Product::default();
    product.put(stage, Role::Image, || file);
    product.put(stage, Role::Preview, || preview);
    if stage.makes.contains(&Role::Statistics) {
        let bytes = statistics::of_frame(task, tools)?;
        product.put(stage, Role::Statistics, || bytes);
    }
    if stage.makes.contains(&Role::LayerImage) {
        let bytes = layers::of_frame(task, tools, &settings, read.scene(), &image, &provenance)?;
        product.put(stage, Role::LayerImage, || bytes);
    }
    product.result.decision = stage.closes.map(|_| Decision::Done);
    product.result.relative_error = error.reached();
    product.result.blocks = Some(Blocks { all: error.blocks.len() as u32, unlit: error.unlit as u32 });
    product.result.seconds = watch.seconds();
    Ok(product)
}

fn pictures(image: &FrameImage, provenance: &Provenance) -> Result<(Vec<u8>, Vec<u8>), FilmError> {
    let preview = || ToneCurve::auto([&image.color]).picture(&image.color).to_png();
    let (file, preview) = rayon::join(|| exr::encode(image, provenance), preview);
    Ok((file?, preview?))
}

pub(super) fn damaged_picture(error: &FilmError) -> Failure {
    Failure::Panicked { message: format!("cannot encode the image: {error}") }
}

/// Returns the resolved pixels of all tiles, the count of rejected samples, and the sample range of each tile.
fn put_together(task: &Task, tools: &Tools) -> Result<(FrameImage, BadSamples, Vec<SampleRange>), Failure> {
    let tiling = tiling(task)?;
    let (mut image, mut bad) = (FrameImage::black(tiling.width, tiling.height), BadSamples::default());
    let mut samples = Vec::with_capacity(tiling.count());
    let account = |piece: &Piece| (piece.tiling(), piece.tiles(), piece.samples().to_vec());
    groups(task, Role::Pixels, tools, Piece::decode, account, |piece| {
        bad.merge(piece.bad());
        samples.extend_from_slice(piece.samples());
        image.put(&piece)
    })?;
    Ok((image, bad, samples))
}
