//! Resolved request: a scene or job file of the command line with the typed settings, checked and planned.

use super::picture::attributes;
use super::{JobFile, Stated};
use crate::args::{Filter, Method, SettingsArgs, Stats};
use crate::exit::{Failure, failed, usage};
use crate::output::faults::{self, Line};
use crate::output::{Busy, Say, human};
use crate::threads;
use crate::values::{Frames, Size};
use femc_fault::{Pretense, pretended};
use femc_import::{Bundle, ImportErrors, Loaded, ScenePath, Warning};
use femc_model::JobNotes;
use femc_pipeline::auto::{self, Choice};
use femc_pipeline::{
    DarkLayer, FIRST_PASS, Feature, Layer, Plan, PlanError, PrepareError, Preset, Settings, SettingsError, Source,
    Stop, lamp_labels,
};
use femc_scene::{Scene, Severity};
use femc_worker::Parcel;
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// A request that has been checked against its scene.
pub struct Asked {
    /// The scene file.
    pub path: PathBuf,
    /// The scene file, with the root of its files.
    place: ScenePath,
    /// The scene with its overrides.
    pub source: Source,
    /// Files of the scene, relative to its root.
    pub files: Vec<String>,
    /// The resolved settings.
    pub settings: Settings,
    /// Stages and tasks to run.
    pub plan: Plan,
    /// Reason for the method, if the settings left it open and [`Self::decided`] chose it.
    pub choice: Option<Choice>,
    /// Whether the frames were chosen or are all frames of the clip.
    pub frames_chosen: FramesChosen,
    /// Number of embedded workers, >= 1.
    pub workers: u32,
    /// Threads per worker; `None`: all cores.
    pub threads: Option<u32>,
    /// Priority of a job file.
    pub priority: Option<u8>,
    /// Tags of a job file.
    pub tags: Vec<String>,
    /// Name of a job file.
    pub given_name: Option<String>,
    /// Notes of a job file.
    pub notes: JobNotes,
}

/// Origin of the choice of frames.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FramesChosen {
    /// `--frames`, or `frames` of the job file.
    Typed,
    /// No choice: all frames of the clip.
    All,
}

/// An imported scene without settings, for one request or for all variants of a sweep.
pub struct Base {
    /// The scene file.
    pub path: PathBuf,
    place: ScenePath,
    files: Vec<String>,
    source: Source,
}

/// Frame rate of a clip, per second, if the scene does not set one.
const DEFAULT_RATE: f64 = 24.0;

/// Function that returns the location of a setting, given its long name or `set.SELECTOR`; `None`: on the command line.
pub type At<'a> = &'a dyn Fn(&str) -> Option<String>;

impl Base {
    /// Imports the scene at `path`, whose files are below `root` (`None`: below its folder). Warnings go to stderr.
    pub fn open(path: &Path, root: Option<&Path>, say: Say) -> Result<Self, Failure> {
        let (place, loaded) = load(path, root)?;
        let warnings = loaded.warnings.iter().map(|warning| line_of(&place, warning, Severity::Warning));
        let notes = loaded.notes.iter().map(|note| line_of(&place, note, Severity::Note));
        faults::remark(say, &warnings.chain(notes).collect::<Vec<_>>(), &path.display().to_string());
        known_varies(&place, &loaded.scene)?;
        let source = Source::new(Arc::new(loaded.scene));
        Ok(Self { path: path.to_owned(), place, files: loaded.files, source })
    }

    /// Returns the number of the scene's files besides the scene file.
    #[cfg(feature = "openjd")]
    pub fn others(&self) -> usize {
        self.files.len().saturating_sub(1)
    }

    /// Checks settings against the scene, and plans.
    pub fn ask(&self, typed: &SettingsArgs, at: At<'_>) -> Result<Asked, Failure> {
        self.ask_for(settings(typed), typed, at)
    }

    /// Checks settings against the scene, and plans. Only the frames, layers, workers and threads are taken from `typed`.
    fn ask_for(&self, settings: Settings, typed: &SettingsArgs, at: At<'_>) -> Result<Asked, Failure> {
        let named = |key: &str| at(key).unwrap_or_else(|| format!("--{}", key.split('.').next().unwrap_or(key)));
        let source = self.source.variant(&settings.overrides);
        let source = source.map_err(|e| usage(format!("{}: {e}", named(&format!("set.{}", e.selector())))))?;
        let scene = source.scene();
        let asked_for = layers(scene, typed, &named)?;
        let nothing = asked_for.0.is_empty() && asked_for.1.is_empty();
        let (layers, features) = if nothing { (settings.layers, settings.features) } else { asked_for };
        let settings = Settings { layers, features, ..settings };
        let frames = typed
            .frames
            .as_ref()
            .map(|frames| frames.resolve(scene.frame_count()))
            .transpose()
            .map_err(|e| usage(format!("{}: {e}", named("frames"))))?;
        let plan = planned(scene, &settings, frames.as_deref()).map_err(|e| refused(&self.path, &e, &named))?;
        Ok(Asked {
            path: self.path.clone(),
            place: self.place.clone(),
            source,
            files: self.files.clone(),
            settings,
            plan,
            choice: None,
            frames_chosen: if frames.is_some() { FramesChosen::Typed } else { FramesChosen::All },
            workers: typed.workers.unwrap_or(1),
            threads: typed.threads,
            priority: None,
            tags: Vec::new(),
            given_name: None,
            notes: JobNotes::default(),
        })
    }
}

impl Asked {
    /// Reads the scene or job file `path`, applies `typed`, and plans. Warnings of the import go to stderr.
    pub fn open(path: &Path, typed: SettingsArgs, say: Say) -> Result<Self, Failure> {
        let asked = if is_job(path) {
            let mut job = JobFile::load(path).map_err(usage)?;
            if let Some(sweep) = &job.sweep {
                let path = path.display();
                return Err(usage(format!(
                    "{}: this job has variants; render them with `femc sweep {path}`, or list them with `femc plan {path}`",
                    job.shown(sweep.place())
                )));
            }
            job.replaced(&typed);
            let settings = typed.over(job.settings.clone());
            let base = Base::open(&job.scene, settings.root.as_deref(), say)?;
            let asked = base.ask(&settings, &|key| job.at(key))?;
            Self { priority: job.priority, tags: job.tags, given_name: job.name, notes: job.notes, ..asked }
        } else {
            Base::open(path, typed.root.as_deref(), say)?.ask(&typed, &|_| None)?
        };
        asked.warn(say);
        Ok(asked)
    }

    /// Reads the scene at `path`, and plans to render the frame in the file `replayed` again.
    pub fn again(path: &Path, replayed: &Path, typed: SettingsArgs, say: Say) -> Result<Self, Failure> {
        if is_job(path) {
            return Err(usage("--replay: give the scene of the frame; a job file has its own settings"));
        }
        let shown = replayed.display();
        let Some(attributes) = attributes(replayed) else {
            return Err(usage(format!(
                "--replay: {shown} is not a readable frame; give an EXR or PNG file that femc has written"
            )));
        };
        let Stated { settings, frame, scene, engine } = Stated::of(replayed, &attributes)?;
        let typed = SettingsArgs { frames: Some(Frames::one(frame)), ..typed };
        let asked = Base::open(path, typed.root.as_deref(), say)?.ask_for(settings, &typed, &|_| None)?;
        if asked.scene().digest().to_string() != scene {
            let path = path.display();
            return Err(failed(format!(
                "--replay: {shown} was rendered from another scene than {path}, or from another state of it"
            )));
        }
        if engine != femc_worker::engine() {
            say.warning(format!("--replay: {shown} is from another build of the engine ({engine}): pixels may differ"));
        }
        asked.warn(say);
        Ok(asked)
    }

    /// Chooses the method if the settings leave it open: a pilot finds out whether a first pass saves time.
    pub fn decided(mut self, say: Say) -> Result<Self, Failure> {
        if self.settings.method != femc_pipeline::Method::Auto {
            return Ok(self);
        }
        let failed = |e: &dyn std::fmt::Display| failed(format!("{}: {e}", self.path.display()));
        let pool = threads::pool(self.threads)?;
        let busy = Busy::new(say, "a pilot of the first frame decides whether a first pass saves time");
        let choice = pool.install(|| auto::choose(&self.source, &self.settings, &self.plan)).map_err(|e| failed(&e))?;
        drop(busy);
        if choice.method == femc_pipeline::Method::Pt {
            if let Some(left) = self.plan.left_out.iter_mut().find(|left| left.what == FIRST_PASS) {
                left.reason.clone_from(&choice.reason);
            }
        } else {
            self.settings.method = choice.method;
            self.plan =
                planned(self.source.scene(), &self.settings, Some(&self.plan.frames)).map_err(|e| failed(&e))?;
        }
        self.choice = Some(choice);
        Ok(self)
    }

    /// Warns if nothing in the scene emits light, and of layers that will be black in this scene. There is no warning for layers
    /// that belong to a set (`guides`, `lamps`), because a set has all of its layers in every scene.
    pub fn warn(&self, say: Say) {
        let scene = self.scene();
        if scene.is_dark() {
            let path = self.path.display();
            say.warning(format!(
                "{path}: nothing in the scene emits light, so every picture is black; see `femc check {path}`"
            ));
        }
        let sets: Vec<Layer> =
            [Preset::Guides, Preset::Lamps].into_iter().flat_map(|set| self.layers_of(set)).collect();
        let is_own = |dark: &DarkLayer| sets.iter().all(|layer| layer.name != dark.layer);
        for dark in femc_pipeline::dark_layers(scene, &self.settings).into_iter().filter(is_own) {
            say.warning(dark);
        }
        for merged in femc_pipeline::merged_names(scene, &self.settings.features) {
            say.warning(merged);
        }
    }

    /// Returns the layers of a preset in this scene; empty if the scene has none.
    fn layers_of(&self, preset: Preset) -> Vec<Layer> {
        preset.layers(lamp_labels(self.scene()).iter().map(String::as_str)).unwrap_or_default()
    }

    /// Prints why the pilot has chosen a first pass.
    pub fn explain(&self, say: Say) {
        if let Some(Choice { method: femc_pipeline::Method::Femc, reason, .. }) = &self.choice {
            say.note(format!("a first pass guides the paths: {reason}; `--method pt` renders without it"));
        }
    }

    /// Returns the scene file with the root of its files.
    pub fn place(&self) -> &ScenePath {
        &self.place
    }

    /// Returns the scene with its overrides.
    pub fn scene(&self) -> &Arc<Scene> {
        self.source.scene()
    }

    /// Returns the path of the scene file, relative to the root of its files.
    pub fn entry(&self) -> String {
        self.place.entry().to_owned()
    }

    /// Returns the name of the job file, or the scene file's stem. It is the first part of the frames' file names.
    pub fn name(&self) -> String {
        self.given_name.clone().unwrap_or_else(|| self.stem())
    }

    fn stem(&self) -> String {
        self.path.file_stem().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default()
    }

    /// Returns the film size in pixels.
    pub fn film(&self) -> [u32; 2] {
        [self.plan.tiling.width, self.plan.tiling.height]
    }

    /// Returns the frame rate per second for a clip of these frames. A clip of every third frame has a third of the scene's rate,
    /// so that it plays in real time.
    pub fn rate(&self, frames: &[u32]) -> f64 {
        let fps = self.scene().clip.map_or(DEFAULT_RATE, |clip| clip.fps);
        let step = match frames {
            [first, second, ..] => f64::from(second - first),
            _ => 1.0,
        };
        (fps / step).clamp(0.01, 100.0)
    }

    /// Returns all files of the scene as artifacts.
    pub fn parcel(&self) -> Result<Parcel, Failure> {
        let cannot =
            |e: &dyn std::fmt::Display| failed(format!("{}: cannot be packed for the farm: {e}", self.path.display()));
        let bundle = Bundle::gather(&self.place.disk(), &self.files).map_err(|e| cannot(&e))?;
        Parcel::pack(&bundle).map_err(|e| cannot(&e))
    }
}

/// Plans the request. Development builds may cut stages in other ways than the plan.
fn planned(scene: &Scene, settings: &Settings, frames: Option<&[u32]>) -> Result<Plan, PlanError> {
    let mut plan = femc_pipeline::plan(scene, settings, frames)?;
    if let Some(fan) = pretended(Pretense::Fan).and_then(|fan| fan.parse().ok()) {
        plan.stages = femc_pipeline::stages(&plan.tiling, &plan.rounds, fan, plan.method);
    }
    if let Some(blocks) = pretended(Pretense::Blocks).and_then(|blocks| blocks.parse().ok()) {
        plan.stages = femc_pipeline::in_blocks(plan.stages, plan.method, blocks);
    }
    Ok(plan)
}

/// Imports the scene at `path`, whose files are below `root` (`None`: below its folder). Errors name files as they are reached from
/// the current folder. Of several errors, the message shows the first.
pub fn load(path: &Path, root: Option<&Path>) -> Result<(ScenePath, Loaded), Failure> {
    let place = locate(path, root)?;
    let loaded = place.load_or_list().map_err(|failed_import| {
        let ImportErrors { errors, complete } = failed_import;
        let first = shown(&place, &errors[0]);
        let more = match errors.len() - 1 {
            0 if complete => String::new(),
            0 => format!("; there may be more errors: `femc check {}` lists them", path.display()),
            more => {
                let least = if complete { "" } else { "at least " };
                let more = human::count(more as u64, "more error");
                format!("; {least}{more}: `femc check {}` lists them", path.display())
            }
        };
        failed(format!("{first}{more}"))
    })?;
    Ok((place, loaded))
}

/// Checks that `path` is a file, and returns it with its root (`None`: its folder).
pub fn locate(path: &Path, root: Option<&Path>) -> Result<ScenePath, Failure> {
    match path.metadata() {
        Err(e) => return Err(usage(format!("{}: {e}; give the path of a scene file", path.display()))),
        Ok(data) if data.is_dir() => {
            return Err(usage(format!("{} is a folder; give the path of a scene file", path.display())));
        }
        Ok(_) => {}
    }
    let place = match root {
        None => ScenePath::new(path),
        Some(root) if !root.is_dir() => {
            return Err(usage(format!(
                "--root {}: no such folder; give a folder that contains the scene",
                root.display()
            )));
        }
        Some(root) => ScenePath::below(root, path),
    };
    place.map_err(usage)
}

/// Checks that the selector of each `vary` exists. Otherwise the job would fail on the farm, in every frame and without a location
/// in the file.
fn known_varies(place: &ScenePath, scene: &Scene) -> Result<(), Failure> {
    for vary in &scene.varies {
        if let Err(e) = scene.get(&vary.selector) {
            let file = scene.files.get(vary.location.file as usize).map_or("", String::as_str);
            return Err(failed(format!("{}:{}: vary: {e}", shown(place, file), vary.location.line)));
        }
    }
    Ok(())
}

/// Returns the line for a warning or note of the import.
pub fn line_of(place: &ScenePath, warning: &Warning, severity: Severity) -> Line {
    let Warning { at, oddity } = warning;
    let (kind, file) = (oddity.kind().to_owned(), shown(place, &at.file));
    Line { severity, kind, file, line: at.line, column: None, message: oddity.to_string(), advice: String::new() }
}

/// Extends the file name at the beginning of a message: from the path below the scene's root to the path from the current folder.
pub fn shown(place: &ScenePath, message: impl std::fmt::Display) -> String {
    let root = place.root();
    if root == Path::new(".") { message.to_string() } else { format!("{}/{message}", root.display()) }
}

/// Maps settings that do not fit the scene to wrong usage, and scenes that cannot be prepared to failure.
fn refused(path: &Path, e: &PlanError, named: &dyn Fn(&str) -> String) -> Failure {
    let message = format!("{}: {e}", path.display());
    match e {
        PlanError::Camera(PrepareError::UnknownCamera { .. }) => usage(format!("{}: {message}", named("camera"))),
        PlanError::Camera(_) => failed(message),
        PlanError::Settings(SettingsError::Domain { setting, .. }) => usage(format!("{}: {e}", named(setting))),
        PlanError::Settings(SettingsError::Allocation(e)) => usage(format!("--replay: {e}")),
        PlanError::Settings(SettingsError::DepthOfElements(_)) => usage(format!("{}: {e}", named("method"))),
        PlanError::Settings(SettingsError::LayersOfElements) => usage(format!("{}: {e}", named("method"))),
        PlanError::Settings(SettingsError::Layers(_)) => usage(format!("{}: {e}", named("layer"))),
        PlanError::Film(_) => usage(format!("{}: {message}", named("size"))),
        PlanError::Settings(SettingsError::Selector(_))
        | PlanError::FrameOutside { .. }
        | PlanError::NoFrames { .. } => usage(message),
    }
}

/// Returns whether a path on the command line is a job file.
pub fn is_job(path: &Path) -> bool {
    path.extension().is_some_and(|extension| extension == "toml")
}

/// Returns the typed settings, completed by the defaults.
fn settings(typed: &SettingsArgs) -> Settings {
    let default = Settings::default();
    let stop = match (typed.spp, typed.error, typed.time) {
        (Some(n), _, _) => Stop::Spp(n),
        (_, Some(e), _) => Stop::Error(e),
        (_, _, Some(time)) => Stop::Time(time.seconds),
        (None, None, None) => default.stop,
    };
    Settings {
        camera: typed.camera.clone(),
        size: typed.size.map(|Size { width, height }| [width, height]),
        stop,
        method: typed.method.map_or(default.method, method),
        max_depth: typed.max_depth.unwrap_or(default.max_depth),
        filter: typed.filter.map_or(default.filter, filter),
        seed: typed.seed.unwrap_or(default.seed),
        overrides: typed.set.iter().map(|o| (o.selector.clone(), o.value)).collect(),
        statistics: typed.stats.is_some(),
        full_statistics: typed.stats == Some(Stats::Full),
        layers: Vec::new(),
        features: BTreeSet::new(),
        allocation: None,
    }
}

/// Returns the typed layers and features. `--layers` names layers and features. The layers of `--layer` are last.
fn layers(
    scene: &Scene,
    typed: &SettingsArgs,
    named: &dyn Fn(&str) -> String,
) -> Result<(Vec<Layer>, BTreeSet<Feature>), Failure> {
    let lamps = if typed.layers.is_empty() { Vec::new() } else { lamp_labels(scene) };
    let (mut all, mut features) = (Vec::new(), BTreeSet::new());
    for name in &typed.layers {
        if let Some(feature) = Feature::named(name.trim()) {
            features.insert(feature);
            continue;
        }
        let preset = name.trim().parse().and_then(|preset: Preset| preset.layers(lamps.iter().map(String::as_str)));
        let preset = preset.map_err(|e| usage(format!("{}: {e}", named("layers"))))?;
        // A layer that is requested twice is written once.
        let new = preset.into_iter().filter(|layer| !all.contains(layer));
        all.extend(new.collect::<Vec<_>>());
    }
    all.extend(typed.layer.iter().cloned());
    Ok((all, features))
}

fn method(method: Method) -> femc_pipeline::Method {
    match method {
        Method::Auto => femc_pipeline::Method::Auto,
        Method::Pt => femc_pipeline::Method::Pt,
        Method::Fem => femc_pipeline::Method::Fem,
        Method::Femc => femc_pipeline::Method::Femc,
    }
}

fn filter(filter: Filter) -> femc_film::Filter {
    match filter {
        Filter::Box => femc_film::Filter::Box,
        Filter::Triangle => femc_film::Filter::Triangle,
        Filter::Gaussian => femc_film::Filter::Gaussian,
        Filter::BlackmanHarris => femc_film::Filter::BlackmanHarris,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn messages_name_the_file_from_where_the_user_stands() {
        let beside = |scene: &str, message: &str| shown(&ScenePath::new(Path::new(scene)).expect("a place"), message);
        assert_eq!(beside("a.mgf", "a.mgf:3: fault"), "a.mgf:3: fault");
        assert_eq!(beside("scenes/a.mgf", "a.mgf:3: fault"), "scenes/a.mgf:3: fault");
        assert_eq!(beside("/s/a.mgf", "lamps/b.mgf:3: fault"), "/s/lamps/b.mgf:3: fault");
    }

    #[test]
    fn what_is_not_typed_is_the_contracts_default() {
        let settings = settings(&SettingsArgs::default());
        assert_eq!((settings.stop, settings.seed, settings.max_depth), (Stop::Error(0.05), 1, 0));
        assert_eq!((settings.method, settings.filter), (femc_pipeline::Method::Auto, femc_film::Filter::Box));
    }
}
