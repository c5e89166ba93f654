//! Renders and times frames in this process. There is no farm and there are no files: only the samples and the stopping rules are
//! timed.

use crate::clock::Clock;
use crate::exit::{Failure, failed, interrupted, usage};
use crate::output::decisions::DecisionsReport;
use crate::request::ResolvedRequest;
use femc_pipeline::paths::record::luminance;
use femc_pipeline::variance_by_decision::{VarianceByDecision, WeightedPixel};
use femc_pipeline::{Prepared, RenderError, Settings};
use femc_reports::bench::Run;
use femc_reports::bench::method::Method;
use femc_reports::bench::reference::Reference;
use femc_reports::bench::setup::SceneSetup;
use femc_reports::bench::worst::worst_block;
use rayon::ThreadPool;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64};
use std::time::Duration;

/// A scene that is rendered many times.
pub struct BenchScene {
    /// Scene and settings, as the record names them.
    pub setup: SceneSetup,
    resolved: ResolvedRequest,
    reference: Reference,
}

/// A [`BenchScene`] with its scene compiled.
pub struct PreparedScene<'a> {
    scene: &'a BenchScene,
    prepared: Prepared,
    /// The scene with the light of a first pass, for each method that has one.
    first_passes: Vec<(femc_pipeline::Method, FirstPassFrame)>,
    pool: &'a ThreadPool,
    cancel: &'a AtomicBool,
}

/// A frame with the light of its first pass, and the time that the pass took.
struct FirstPassFrame {
    prepared: Prepared,
    seconds: Duration,
    cpu: Duration,
}

/// Maximum number of pixels whose variance is attributed to decisions.
const MAX_DECISION_PIXELS: f64 = 4096.0;
/// Edge of the tile that is rendered before the first timing, in pixels.
const WARM_UP: u32 = 64;

impl BenchScene {
    /// Creates a bed.
    /// - errors: the reference has another size than the film.
    pub fn new(resolved: ResolvedRequest, reference: Reference, reference_name: &str) -> Result<Self, Failure> {
        let film = resolved.film();
        let size = [reference.image.width, reference.image.height];
        if film != size {
            let [width, height] = size;
            return Err(usage(format!(
                "{}: the film has {}x{} pixels, the reference {reference_name} {width}x{height}; give --size {width}x{height}",
                resolved.path.display(),
                film[0],
                film[1]
            )));
        }
        let setup = SceneSetup {
            name: resolved.name(),
            file: resolved.path.display().to_string(),
            digest: resolved.scene().digest().to_string(),
            frame: resolved.plan.frames.first().copied().unwrap_or(1),
            film,
            settings: common_settings(&resolved.settings)?,
            reference: reference_name.to_owned(),
            reference_digest: femc_film::pixel_digest(&reference.image).to_hex().to_string(),
        };
        Ok(Self { setup, resolved, reference })
    }

    /// Returns the reference.
    pub fn reference(&self) -> &Reference {
        &self.reference
    }

    /// Compiles the scene and renders a small tile to warm up.
    pub fn prepare<'a>(&'a self, pool: &'a ThreadPool, cancel: &'a AtomicBool) -> Result<PreparedScene<'a>, Failure> {
        let ResolvedRequest { source, settings, .. } = &self.resolved;
        let prepared = pool.install(|| femc_pipeline::prepare_world(source, settings, self.setup.frame, None));
        let prepared = prepared.map_err(failed)?;
        let [width, height] = self.setup.film;
        let (across, down) = (WARM_UP.min(width), WARM_UP.min(height));
        let (x, y) = ((width - across) / 2, (height - down) / 2);
        let rect = femc_film::Rect { x, y, width: across, height: down };
        let task = femc_pipeline::RenderTask {
            cancel: Some(cancel),
            ..femc_pipeline::RenderTask::new(&prepared, settings, rect, 0..1)
        };
        pool.install(|| task.render(femc_pipeline::Outputs::default())).map_err(map_render_error)?;
        Ok(PreparedScene { scene: self, prepared, first_passes: Vec::new(), pool, cancel })
    }
}

impl PreparedScene<'_> {
    /// Returns the index in `first_passes` of a method's first pass. The pass is solved once, as in `femc render`; all frames share
    /// its light and its seconds.
    fn first_pass_index(&mut self, method: femc_pipeline::Method) -> Result<usize, Failure> {
        if let Some(at) = self.first_passes.iter().position(|(of, _)| *of == method) {
            return Ok(at);
        }
        let BenchScene { setup, resolved, .. } = self.scene;
        let (source, settings, known) = (&resolved.source, &resolved.settings, Some(&self.prepared));
        let worlds = || {
            let prepared = femc_pipeline::prepare_world(source, settings, setup.frame, known)?;
            Ok((prepared, femc_pipeline::first_pass_world(source, settings, setup.frame, known)?))
        };
        let worlds: Result<_, femc_pipeline::PrepareError> = self.pool.install(worlds);
        let (mut prepared, world) = worlds.map_err(failed)?;
        let (clock, cpu) = (Clock, femc_worker::process_time());
        let begun = clock.now();
        let solution = self
            .pool
            .install(|| femc_pipeline::solve_first_pass(&world, method, self.cancel))
            .map_err(map_render_error)?;
        let light = femc_pipeline::FrameLight::new(Arc::new(solution.field), prepared.brightness);
        self.pool.install(|| femc_pipeline::attach_first_pass(&mut prepared, light)).map_err(failed)?;
        self.pool.install(|| femc_pipeline::attach_learned_targets(&mut prepared, method)).map_err(failed)?;
        let (seconds, cpu) = (clock.since(begun), femc_worker::process_time().saturating_sub(cpu));
        self.first_passes.push((method, FirstPassFrame { prepared, seconds, cpu }));
        Ok(self.first_passes.len() - 1)
    }

    /// Attributes the relative variance of a method's samples to decisions: `samples` samples of pixels that are spread over the
    /// film.
    pub fn attribute_to_decisions(&mut self, method: &Method, samples: u32) -> Result<DecisionsReport, Failure> {
        let first_pass = method.transport.has_first_pass().then(|| self.first_pass_index(method.transport));
        let prepared = match first_pass.transpose()? {
            Some(at) => &self.first_passes[at].1.prepared,
            None => &self.prepared,
        };
        let settings = Settings { method: method.transport, ..self.scene.resolved.settings.clone() };
        let image = &self.scene.reference.image;
        let area = f64::from(image.width) * f64::from(image.height);
        let step = (area / MAX_DECISION_PIXELS).sqrt().ceil().max(1.0) as u32;
        let [columns, rows] = [image.width, image.height].map(|size| (0..size).step_by(step as usize));
        let pixel = |(x, y): (u32, u32)| {
            let light = f64::from(luminance(image.pixels[(y * image.width + x) as usize]));
            // As in `relmse`.
            WeightedPixel { pixel: (x, y), weight: 1.0 / (light * light + 0.01) }
        };
        let pixels: Vec<WeightedPixel> = rows.flat_map(|y| columns.clone().map(move |x| (x, y))).map(pixel).collect();
        let found = self.pool.install(|| VarianceByDecision::from_replay(prepared, &settings, &pixels, 0..samples));
        Ok(DecisionsReport::new(&found))
    }

    /// Chooses the method if the settings leave it open. Returns the settings, and the wall and processor time of the pilot if there
    /// was one.
    fn choose_method(&self, settings: Settings) -> Result<(Settings, Option<[Duration; 2]>), Failure> {
        if settings.method != femc_pipeline::Method::Auto {
            return Ok((settings, None));
        }
        let BenchScene { setup, resolved, .. } = self.scene;
        let (clock, cpu) = (Clock, femc_worker::process_time());
        let begun = clock.now();
        let plan = femc_pipeline::plan_job(resolved.scene(), &settings, Some(&[setup.frame])).map_err(failed)?;
        let choose = || femc_pipeline::method_choice::choose_method(&resolved.source, &settings, &plan);
        let (choice, _) = self.pool.install(choose).map_err(failed)?;
        let taken = [clock.since(begun), femc_worker::process_time().saturating_sub(cpu)];
        Ok((Settings { method: choice.method, ..settings }, Some(taken)))
    }

    /// Renders one frame and compares it with the reference. The time of a method with a first pass includes the first pass, and
    /// that of `auto` the pilot.
    pub fn run(&mut self, method: &Method, budget: f64, seed: u64) -> Result<Run, Failure> {
        let BenchScene { setup, resolved, reference } = self.scene;
        let settings =
            Settings { stop: method.stop(budget), method: method.transport, seed, ..resolved.settings.clone() };
        let (settings, pilot) = self.choose_method(settings)?;
        let plan = femc_pipeline::plan_job(resolved.scene(), &settings, Some(&[setup.frame])).map_err(failed)?;
        let first_pass =
            if settings.method.has_first_pass() { Some(self.first_pass_index(settings.method)?) } else { None };
        let first_pass = first_pass.map(|at| &self.first_passes[at].1);
        let prepared = first_pass.map_or(&self.prepared, |lit| &lit.prepared);
        // A pilot that chooses a first pass has solved it, so it counts once.
        let before = pilot.or(first_pass.map(|lit| [lit.seconds, lit.cpu]));
        let [first, first_cpu] = before.unwrap_or([Duration::ZERO; 2]);
        let (clock, progress) = (Clock, AtomicU64::new(0));
        let (begun, cpu) = (clock.now(), femc_worker::process_time());
        let rendered = self.pool.install(|| {
            let seconds = |_| clock.since(begun).as_secs_f64();
            let (tiling, rounds) = (plan.tiling, &plan.rounds);
            femc_pipeline::render_frame(prepared, &settings, tiling, rounds, seconds, self.cancel, &progress)
        });
        let (seconds, cpu) = (clock.since(begun), femc_worker::process_time().saturating_sub(cpu));
        let rendered = rendered.map_err(map_render_error)?;
        let image = rendered.frame.resolve().color;
        let found = femc_film::compare_images(&image, &reference.image).map_err(failed)?;
        let [width, height] = setup.film.map(f64::from);
        Ok(Run {
            scene: setup.name.clone(),
            method: method.name.to_owned(),
            budget,
            seed,
            seconds: (first + seconds).as_secs_f64(),
            first_pass_seconds: first.as_secs_f64(),
            cpu_seconds: (first_cpu + cpu).as_secs_f64(),
            samples: rendered.samples,
            spp: rendered.samples as f64 / (width * height),
            rays: rendered.rays,
            mse: found.mse,
            relmse: found.relmse,
            flip: found.flip,
            worst: worst_block(&image, &reference.image),
            left_out: found.excluded.pixels,
        })
    }
}

/// Returns the settings that are the same in all runs.
fn common_settings(settings: &Settings) -> Result<serde_json::Value, Failure> {
    let text = serde_json::to_string(settings).map_err(failed)?;
    // Parse the text, so that the numbers are bit by bit those that are later read from a file.
    let mut value: serde_json::Value = serde_json::from_str(&text).map_err(failed)?;
    if let Some(fields) = value.as_object_mut() {
        ["stop", "seed", "method"].iter().for_each(|field| drop(fields.remove(*field)));
    }
    Ok(value)
}

fn map_render_error(error: RenderError) -> Failure {
    match error {
        RenderError::Cancelled => interrupted("interrupted; with -o, rerun the command to resume"),
        error => failed(error),
    }
}
