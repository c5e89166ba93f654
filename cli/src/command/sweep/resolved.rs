//! A sweep checked against its scene: its variants, and the keys of their frames.

use crate::args::{Method, SettingsArgs};
use crate::command::client;
use crate::command::readings::readings_path;
use crate::exit::{Failure, failed, usage};
use crate::output::Printer;
use crate::request::{ImportedScene, JobFile, Measures, ResolvedRequest, typed_keys};
use femc_model::{Digest, JobSpec};
use femc_pipeline::{Settings, StopCondition};
use femc_scene::SceneDigest;
use femc_worker::Parcel;
use std::path::{Path, PathBuf};

/// Largest number of frames of all variants together.
const MAX_FRAMES: usize = 1 << 20;

/// The checked request of a sweep.
pub struct ResolvedSweep {
    /// Names of the axes: selectors and settings.
    pub axes: Vec<String>,
    /// Names of the axes, shortened as far as they stay unique.
    pub labels: Vec<String>,
    /// Variants, in the order of the sweep.
    pub variants: Vec<PlannedVariant>,
    /// Regions and contrasts to measure besides the film.
    pub measures: Measures,
    /// The scene's files.
    pub scene: Parcel,
    /// The first variant, for a trial of the cost.
    pub first: ResolvedRequest,
}

/// A variant as it will be rendered.
pub struct PlannedVariant {
    /// Name of its folder.
    pub name: String,
    /// A value for each axis.
    pub values: Vec<AxisText>,
    /// First part of the names of its frames' files.
    pub stem: String,
    /// Job of all frames of the variant. Its name consists of the file names' first part and the variant's name.
    pub spec: JobSpec,
    /// Whether the frames are only measured and have no pictures.
    pub is_only_measured: bool,
    /// Stopping rule of a frame.
    pub stop: StopCondition,
    /// Frames, ascending.
    pub frames: Vec<PlannedFrame>,
}

/// A value of an axis.
#[derive(Clone, Debug)]
pub struct AxisText {
    /// Value as text, for people.
    pub text: String,
    /// Value as a number, if it is one.
    pub number: Option<f64>,
}

/// A frame and its keys.
pub struct PlannedFrame {
    /// Frame number.
    pub frame: u32,
    /// Digest of the engine build of this program, everything that the camera sees, and the sampling settings. Frames with equal
    /// keys have the same pixels.
    pub key: String,
    /// Digest of the world. Frames with equal worlds are prepared once, apart from the camera.
    pub world: SceneDigest,
}

impl ResolvedSweep {
    /// Reads the job file `path`, applies `typed` and checks every variant. Renders at most a pilot of the first variant, if no
    /// method is named.
    pub fn open(path: &Path, typed: &SettingsArgs, printer: Printer) -> Result<Self, Failure> {
        let mut job = JobFile::load(path).map_err(usage)?;
        let sweep = job.sweep.take().ok_or_else(|| {
            let path = path.display();
            usage(format!("{path}: the job has no [sweep]; `femc submit {path}` queues it"))
        })?;
        let keys = typed_keys(typed);
        if let Some(axis) = sweep.axes.iter().find(|axis| keys.contains(axis.name.as_str())) {
            return Err(usage(format!(
                "{}: `{}` is an axis of the sweep, but also given on the command line; remove one of them",
                job.format_location(axis.position),
                axis.name
            )));
        }
        job.remove_replaced(typed);
        let mut settings = typed.clone().merge_over(job.settings.clone());
        let imported = ImportedScene::open(&job.scene, settings.root.as_deref(), printer)?;
        let mut resolved_sweep: Option<Self> = None;
        let mut frames = 0;
        for variant in sweep.variants() {
            let of_axis = |key: &str| {
                let mut choices = sweep.axes.iter().zip(&variant.values);
                choices.find(|(axis, _)| key.strip_prefix("set.").unwrap_or(key) == axis.name)
            };
            let at = |key: &str| {
                of_axis(key).map(|(_, choice)| job.format_location(choice.position)).or_else(|| job.location(key))
            };
            let mut resolved = imported.resolve(&variant.apply(&settings), &at)?;
            (resolved.priority, resolved.tags, resolved.given_name) =
                (job.priority, job.tags.clone(), job.name.clone());
            resolved.notes = job.notes.clone();
            // All variants use the method of the first one, so that they can be compared.
            if resolved_sweep.is_none() {
                resolved.warn(printer);
                resolved = resolved.choose_method(printer)?;
                resolved.explain_method(printer);
                if resolved.plan.method == femc_pipeline::Method::Femc {
                    settings.method = Some(Method::Femc);
                }
            }
            check_regions(&job, &resolved)?;
            frames += resolved.plan.frames.len();
            if frames > MAX_FRAMES {
                let place = job.format_location(sweep.position());
                return Err(usage(format!("{place}: the variants have more than {MAX_FRAMES} frames together")));
            }
            let values = variant
                .values
                .iter()
                .map(|c| AxisText { text: c.text.clone(), number: c.change.as_number() })
                .collect();
            let scene = match &resolved_sweep {
                Some(resolved_sweep) => resolved_sweep.scene.clone(),
                None => resolved.parcel()?,
            };
            let varied =
                sweep.axes.iter().zip(&variant.values).map(|(axis, choice)| (axis.name.clone(), choice.text.clone()));
            resolved.notes.labels.extend(varied);
            let planned = PlannedVariant::new(variant.name.clone(), values, &resolved, &scene)?;
            match &mut resolved_sweep {
                Some(resolved_sweep) => resolved_sweep.variants.push(planned),
                None => {
                    resolved_sweep = Some(Self {
                        axes: sweep.axes.iter().map(|axis| axis.name.clone()).collect(),
                        labels: sweep.labels(),
                        variants: vec![planned],
                        measures: job.measures.clone(),
                        scene,
                        first: resolved,
                    });
                }
            }
        }
        resolved_sweep.ok_or_else(|| failed("the sweep has no variants"))
    }

    /// Returns text like `sigma_s = 0.01, ed = 10000`.
    pub fn title(&self, variant: &PlannedVariant) -> String {
        let pairs = self.labels.iter().zip(&variant.values).map(|(label, value)| format!("{label} = {}", value.text));
        pairs.collect::<Vec<_>>().join(", ")
    }
}

impl PlannedVariant {
    fn new(name: String, values: Vec<AxisText>, resolved: &ResolvedRequest, scene: &Parcel) -> Result<Self, Failure> {
        let frame = |&frame: &u32| {
            let frame_key = femc_pipeline::frame_key(&resolved.source, &resolved.settings, frame);
            let frame_key = frame_key.map_err(|e| failed(format!("{}: {e}", resolved.path.display())))?;
            Ok(PlannedFrame { frame, key: pixel_key(&frame_key.view, &resolved.settings)?, world: frame_key.world })
        };
        let stem = resolved.name();
        let spec = client::job_spec(resolved, scene, resolved.plan.frames.clone())?;
        Ok(Self {
            spec: JobSpec { name: format!("{stem}-{name}"), ..spec },
            stem,
            name,
            values,
            is_only_measured: resolved.settings.measure_only,
            stop: resolved.settings.stop,
            frames: resolved.plan.frames.iter().map(frame).collect::<Result<_, Failure>>()?,
        })
    }

    /// Returns the path of a frame within the sweep's folder: of its picture, or of its readings if it has no picture.
    pub fn file(&self, frame: u32) -> String {
        let path = PathBuf::from(format!("{}/{}", self.name, crate::command::render::frame_name(&self.stem, frame)));
        let path = if self.is_only_measured { readings_path(&path) } else { path };
        path.display().to_string()
    }
}

/// Returns the digest of everything that determines a frame's pixels.
fn pixel_key(view: &SceneDigest, settings: &Settings) -> Result<String, Failure> {
    // The digest of the view already includes the effect of these three settings.
    let sampling = Settings { camera: None, size: None, overrides: Vec::new(), ..settings.clone() };
    let text = serde_json::to_string(&(femc_worker::engine(), view.to_string(), sampling)).map_err(failed)?;
    Ok(Digest::compute(text.as_bytes()).to_string())
}

fn check_regions(job: &JobFile, resolved: &ResolvedRequest) -> Result<(), Failure> {
    let [width, height] = resolved.film();
    let outside = |bounds: [u32; 4]| bounds[2] > width || bounds[3] > height;
    match job.measures.regions.iter().find(|region| outside(region.bounds)) {
        None => Ok(()),
        Some(region) => Err(usage(format!(
            "{}: region `{}` reaches beyond a film of {width}x{height} pixels",
            job.format_location(region.position),
            region.name
        ))),
    }
}
