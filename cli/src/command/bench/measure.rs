//! Renders and times frames in this process. There is no farm and there are no files: only the samples and the stopping rules are
//! timed.

use crate::clock::Clock;
use crate::exit::{Failure, failed, interrupted, usage};
use crate::request::Asked;
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
pub struct Bed {
    /// Scene and settings, as the record names them.
    pub setup: SceneSetup,
    asked: Asked,
    reference: Reference,
}

/// A [`Bed`] with its scene compiled.
pub struct Ready<'a> {
    bed: &'a Bed,
    prepared: Prepared,
    /// The scene with the light of a first pass, for each method that has one.
    lit: Vec<(femc_pipeline::Method, Lit)>,
    pool: &'a ThreadPool,
    cancel: &'a AtomicBool,
}

/// A frame with the light of its first pass, and the time that the pass took.
struct Lit {
    prepared: Prepared,
    seconds: Duration,
    cpu: Duration,
}

/// Edge of the tile that is rendered before the first timing, in pixels.
const WARM_UP: u32 = 64;

impl Bed {
    /// Creates a bed.
    /// - errors: the reference has another size than the film.
    pub fn new(asked: Asked, reference: Reference, named: &str) -> Result<Self, Failure> {
        let film = asked.film();
        let size = [reference.image.width, reference.image.height];
        if film != size {
            let [width, height] = size;
            return Err(usage(format!(
                "{}: the film has {}x{} pixels, the reference {named} {width}x{height}; give --size {width}x{height}",
                asked.path.display(),
                film[0],
                film[1]
            )));
        }
        let setup = SceneSetup {
            name: asked.name(),
            file: asked.path.display().to_string(),
            digest: asked.scene().digest().to_string(),
            frame: asked.plan.frames.first().copied().unwrap_or(1),
            film,
            settings: constant(&asked.settings)?,
            reference: named.to_owned(),
            reference_digest: femc_film::pixel_digest(&reference.image).to_hex().to_string(),
        };
        Ok(Self { setup, asked, reference })
    }

    /// Returns the reference.
    pub fn reference(&self) -> &Reference {
        &self.reference
    }

    /// Compiles the scene and renders a small tile to warm up.
    pub fn ready<'a>(&'a self, pool: &'a ThreadPool, cancel: &'a AtomicBool) -> Result<Ready<'a>, Failure> {
        let Asked { source, settings, .. } = &self.asked;
        let prepared = pool.install(|| femc_pipeline::prepare_world(source, settings, self.setup.frame, None));
        let prepared = prepared.map_err(failed)?;
        let [width, height] = self.setup.film;
        let (across, down) = (WARM_UP.min(width), WARM_UP.min(height));
        let (x, y) = ((width - across) / 2, (height - down) / 2);
        let rect = femc_film::Rect { x, y, width: across, height: down };
        let progress = AtomicU64::new(0);
        pool.install(|| femc_pipeline::render_tile(&prepared, settings, rect, 0..1, cancel, &progress))
            .map_err(ended)?;
        Ok(Ready { bed: self, prepared, lit: Vec::new(), pool, cancel })
    }
}

impl Ready<'_> {
    /// Returns the index in `lit` of a method's first pass. The pass is solved once, as in `femc render`; all frames share its
    /// light and its seconds.
    fn light(&mut self, method: femc_pipeline::Method) -> Result<usize, Failure> {
        if let Some(at) = self.lit.iter().position(|(of, _)| *of == method) {
            return Ok(at);
        }
        let Bed { setup, asked, .. } = self.bed;
        let (source, settings, known) = (&asked.source, &asked.settings, Some(&self.prepared));
        let worlds = || {
            let prepared = femc_pipeline::prepare_world(source, settings, setup.frame, known)?;
            Ok((prepared, femc_pipeline::first_pass_world(source, settings, setup.frame, known)?))
        };
        let worlds: Result<_, femc_pipeline::PrepareError> = self.pool.install(worlds);
        let (mut prepared, world) = worlds.map_err(failed)?;
        let (clock, cpu) = (Clock, femc_worker::process_time());
        let begun = clock.now();
        let solution = self.pool.install(|| femc_pipeline::first_pass(&world, method, self.cancel)).map_err(ended)?;
        let (seconds, cpu) = (clock.since(begun), femc_worker::process_time().saturating_sub(cpu));
        let field = femc_pipeline::brightened(Arc::new(solution.field), prepared.brightness);
        femc_pipeline::light(&mut prepared, field).map_err(failed)?;
        self.lit.push((method, Lit { prepared, seconds, cpu }));
        Ok(self.lit.len() - 1)
    }

    /// Renders one frame and compares it with the reference. The time of a method with a first pass includes the first pass.
    pub fn run(&mut self, method: &Method, budget: f64, seed: u64) -> Result<Run, Failure> {
        let Bed { setup, asked, reference } = self.bed;
        let settings = Settings { stop: method.stop(budget), method: method.light, seed, ..asked.settings.clone() };
        let plan = femc_pipeline::plan(asked.scene(), &settings, Some(&[setup.frame])).map_err(failed)?;
        let lit = if method.light.has_first_pass() { Some(self.light(method.light)?) } else { None };
        let lit = lit.map(|at| &self.lit[at].1);
        let prepared = lit.map_or(&self.prepared, |lit| &lit.prepared);
        let [first, first_cpu] = lit.map_or([Duration::ZERO; 2], |lit| [lit.seconds, lit.cpu]);
        let (clock, progress) = (Clock, AtomicU64::new(0));
        let (begun, cpu) = (clock.now(), femc_worker::process_time());
        let rendered = self.pool.install(|| {
            let seconds = |_| clock.since(begun).as_secs_f64();
            let (tiling, rounds) = (plan.tiling, &plan.rounds);
            femc_pipeline::render_frame(prepared, &settings, tiling, rounds, seconds, self.cancel, &progress)
        });
        let (seconds, cpu) = (clock.since(begun), femc_worker::process_time().saturating_sub(cpu));
        let rendered = rendered.map_err(ended)?;
        let image = rendered.frame.resolve().color;
        let found = femc_film::compare(&image, &reference.image).map_err(failed)?;
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
fn constant(settings: &Settings) -> Result<serde_json::Value, Failure> {
    let text = serde_json::to_string(settings).map_err(failed)?;
    // Parse the text, so that the numbers are bit by bit those that are later read from a file.
    let mut value: serde_json::Value = serde_json::from_str(&text).map_err(failed)?;
    if let Some(fields) = value.as_object_mut() {
        ["stop", "seed", "method"].iter().for_each(|field| drop(fields.remove(*field)));
    }
    Ok(value)
}

fn ended(error: RenderError) -> Failure {
    match error {
        RenderError::Cancelled => interrupted("interrupted; with -o, rerun the command to resume"),
        error => failed(error),
    }
}
