//! A sweep checked against its scene: its variants, and the keys of their frames.

use crate::args::{Method, SettingsArgs};
use crate::command::client;
use crate::exit::{Failure, failed, usage};
use crate::output::Say;
use crate::request::{Asked, Base, JobFile, Measures, typed_keys};
use femc_model::{Digest, JobSpec};
use femc_pipeline::{Settings, Stop};
use femc_scene::SceneDigest;
use femc_worker::Parcel;
use std::path::Path;

/// Largest number of frames of all variants together.
const MAX_FRAMES: usize = 1 << 20;

/// The checked request of a sweep.
pub struct Work {
    /// Names of the axes: selectors and settings.
    pub axes: Vec<String>,
    /// Names of the axes, shortened as far as they stay unique.
    pub labels: Vec<String>,
    /// Variants, in the order of the sweep.
    pub variants: Vec<Planned>,
    /// Regions and contrasts to measure besides the film.
    pub measures: Measures,
    /// The scene's files.
    pub scene: Parcel,
    /// The first variant, for a trial of the cost.
    pub first: Asked,
}

/// A variant as it will be rendered.
pub struct Planned {
    /// Name of its folder.
    pub name: String,
    /// A value for each axis.
    pub values: Vec<Value>,
    /// First part of the names of its frames' files.
    pub stem: String,
    /// Job of all frames of the variant. Its name consists of the file names' first part and the variant's name.
    pub spec: JobSpec,
    /// Stopping rule of a frame.
    pub stop: Stop,
    /// Frames, ascending.
    pub frames: Vec<Planning>,
}

/// A value of an axis.
#[derive(Clone, Debug)]
pub struct Value {
    /// Value as text, for people.
    pub text: String,
    /// Value as a number, if it is one.
    pub number: Option<f64>,
}

/// A frame and its keys.
pub struct Planning {
    /// Frame number.
    pub frame: u32,
    /// Digest of the engine build of this program, everything that the camera sees, and the sampling settings. Frames with equal
    /// keys have the same pixels.
    pub key: String,
    /// Digest of the world. Frames with equal worlds are prepared once, apart from the camera.
    pub world: SceneDigest,
}

impl Work {
    /// Reads the job file `path`, applies `typed` and checks every variant. Renders at most a pilot of the first variant, if no
    /// method is named.
    pub fn open(path: &Path, typed: &SettingsArgs, say: Say) -> Result<Self, Failure> {
        let mut job = JobFile::load(path).map_err(usage)?;
        let sweep = job.sweep.take().ok_or_else(|| {
            let path = path.display();
            usage(format!("{path}: the job has no [sweep]; `femc submit {path}` queues it"))
        })?;
        let keys = typed_keys(typed);
        if let Some(axis) = sweep.axes.iter().find(|axis| keys.contains(axis.name.as_str())) {
            return Err(usage(format!(
                "{}: `{}` is an axis of the sweep, but also given on the command line; remove one of them",
                job.shown(axis.place),
                axis.name
            )));
        }
        job.replaced(typed);
        let mut settings = typed.clone().over(job.settings.clone());
        let base = Base::open(&job.scene, settings.root.as_deref(), say)?;
        let mut work: Option<Self> = None;
        let mut frames = 0;
        for variant in sweep.variants() {
            let of_axis = |key: &str| {
                let mut choices = sweep.axes.iter().zip(&variant.choices);
                choices.find(|(axis, _)| key.strip_prefix("set.").unwrap_or(key) == axis.name)
            };
            let at = |key: &str| of_axis(key).map(|(_, choice)| job.shown(choice.place)).or_else(|| job.at(key));
            let mut asked = base.ask(&variant.apply(&settings), &at)?;
            (asked.priority, asked.tags, asked.given_name) = (job.priority, job.tags.clone(), job.name.clone());
            asked.notes = job.notes.clone();
            // All variants use the method of the first one, so that they can be compared.
            if work.is_none() {
                asked.warn(say);
                asked = asked.decided(say)?;
                asked.explain(say);
                if asked.plan.method == femc_pipeline::Method::Femc {
                    settings.method = Some(Method::Femc);
                }
            }
            check_regions(&job, &asked)?;
            frames += asked.plan.frames.len();
            if frames > MAX_FRAMES {
                let place = job.shown(sweep.place());
                return Err(usage(format!("{place}: the variants have more than {MAX_FRAMES} frames together")));
            }
            let values =
                variant.choices.iter().map(|c| Value { text: c.text.clone(), number: c.change.as_number() }).collect();
            let scene = match &work {
                Some(work) => work.scene.clone(),
                None => asked.parcel()?,
            };
            let varied =
                sweep.axes.iter().zip(&variant.choices).map(|(axis, choice)| (axis.name.clone(), choice.text.clone()));
            asked.notes.labels.extend(varied);
            let planned = Planned::new(variant.name.clone(), values, &asked, &scene)?;
            match &mut work {
                Some(work) => work.variants.push(planned),
                None => {
                    work = Some(Self {
                        axes: sweep.axes.iter().map(|axis| axis.name.clone()).collect(),
                        labels: sweep.labels(),
                        variants: vec![planned],
                        measures: job.measures.clone(),
                        scene,
                        first: asked,
                    });
                }
            }
        }
        work.ok_or_else(|| failed("the sweep has no variants"))
    }

    /// Returns text like `sigma_s = 0.01, ed = 10000`.
    pub fn title(&self, variant: &Planned) -> String {
        let pairs = self.labels.iter().zip(&variant.values).map(|(label, value)| format!("{label} = {}", value.text));
        pairs.collect::<Vec<_>>().join(", ")
    }
}

impl Planned {
    fn new(name: String, values: Vec<Value>, asked: &Asked, scene: &Parcel) -> Result<Self, Failure> {
        let frame = |&frame: &u32| {
            let frame_key = femc_pipeline::frame_key(&asked.source, &asked.settings, frame);
            let frame_key = frame_key.map_err(|e| failed(format!("{}: {e}", asked.path.display())))?;
            Ok(Planning { frame, key: key(&frame_key.view, &asked.settings)?, world: frame_key.world })
        };
        let stem = asked.name();
        let spec = client::job_spec(asked, scene, asked.plan.frames.clone())?;
        Ok(Self {
            spec: JobSpec { name: format!("{stem}-{name}"), ..spec },
            stem,
            name,
            values,
            stop: asked.settings.stop,
            frames: asked.plan.frames.iter().map(frame).collect::<Result<_, Failure>>()?,
        })
    }

    /// Returns the path of a frame within the sweep's folder.
    pub fn file(&self, frame: u32) -> String {
        format!("{}/{}", self.name, crate::command::render::frame_name(&self.stem, frame))
    }
}

/// Returns the digest of everything that determines a frame's pixels.
fn key(view: &SceneDigest, settings: &Settings) -> Result<String, Failure> {
    // The digest of the view already includes the effect of these three settings.
    let sampling = Settings { camera: None, size: None, overrides: Vec::new(), ..settings.clone() };
    let text = serde_json::to_string(&(femc_worker::engine(), view.to_string(), sampling)).map_err(failed)?;
    Ok(Digest::of(text.as_bytes()).to_string())
}

fn check_regions(job: &JobFile, asked: &Asked) -> Result<(), Failure> {
    let [width, height] = asked.film();
    let outside = |bounds: [u32; 4]| bounds[2] > width || bounds[3] > height;
    match job.measures.regions.iter().find(|region| outside(region.bounds)) {
        None => Ok(()),
        Some(region) => Err(usage(format!(
            "{}: region `{}` reaches beyond a film of {width}x{height} pixels",
            job.shown(region.place),
            region.name
        ))),
    }
}
