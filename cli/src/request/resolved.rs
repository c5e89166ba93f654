//! Resolved request: a scene or job file of the command line with the typed settings, checked and planned.

use super::picture::attributes;
use super::{FrameMetadata, JobFile, points_file};
use crate::args::{Filter, Guide, Method, SettingsArgs, StatsMode};
use crate::exit::{Failure, failed, usage};
use crate::output::faults::{self, FaultLine};
use crate::output::{BusyIndicator, Printer, human};
use crate::threads;
use crate::values::{Frames, Size};
use femc_fault::{PretendedValue, pretended_value};
use femc_import::{Bundle, ImportErrors, LoadedScene, ScenePath, Warning};
use femc_model::JobNotes;
use femc_pipeline::measure::MeasureRequest;
use femc_pipeline::method_choice::{self, MethodChoice, SolvedFirstPass};
use femc_pipeline::{
    DarkLayer, FIRST_PASS_FEATURE, Feature, Layer, Plan, PlanError, PrepareError, Preset, SceneSource, Settings,
    SettingsError, StopCondition, lamp_labels,
};
use femc_scene::{Scene, Severity};
use femc_worker::Parcel;
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// A request that has been checked against its scene.
pub struct ResolvedRequest {
    /// The scene file.
    pub path: PathBuf,
    /// The scene file, with the root of its files.
    scene_path: ScenePath,
    /// The scene with its overrides.
    pub source: SceneSource,
    /// Files of the scene, relative to its root.
    pub files: Vec<String>,
    /// The resolved settings.
    pub settings: Settings,
    /// Stages and tasks to run.
    pub plan: Plan,
    /// Reason for the method, if the settings left it open and [`Self::choose_method`] chose it.
    pub choice: Option<MethodChoice>,
    /// First pass that was solved for the choice.
    pub solved: Option<SolvedFirstPass>,
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
pub struct ImportedScene {
    /// The scene file.
    pub path: PathBuf,
    scene_path: ScenePath,
    files: Vec<String>,
    source: SceneSource,
}

/// Frame rate of a clip, per second, if the scene does not set one.
const DEFAULT_RATE: f64 = 24.0;

/// Function that returns the location of a setting, given its long name or `set.SELECTOR`; `None`: on the command line.
pub type LocateSetting<'a> = &'a dyn Fn(&str) -> Option<String>;

impl ImportedScene {
    /// Imports the scene at `path`, whose files are below `root` (`None`: below its folder). Warnings go to stderr.
    pub fn open(path: &Path, root: Option<&Path>, printer: Printer) -> Result<Self, Failure> {
        let (scene_path, loaded) = load_scene(path, root)?;
        let warnings = loaded.warnings.iter().map(|warning| warning_line(&scene_path, warning, Severity::Warning));
        let notes = loaded.notes.iter().map(|note| warning_line(&scene_path, note, Severity::Note));
        faults::note_faults(printer, &warnings.chain(notes).collect::<Vec<_>>(), &path.display().to_string());
        check_varies(&scene_path, &loaded.scene)?;
        let source = SceneSource::new(Arc::new(loaded.scene));
        Ok(Self { path: path.to_owned(), scene_path, files: loaded.files, source })
    }

    /// Returns the number of the scene's files besides the scene file.
    #[cfg(feature = "openjd")]
    pub fn other_file_count(&self) -> usize {
        self.files.len().saturating_sub(1)
    }

    /// Checks settings against the scene, and plans.
    pub fn resolve(&self, typed: &SettingsArgs, at: LocateSetting<'_>) -> Result<ResolvedRequest, Failure> {
        if let (Some(Guide::Tables1998), Some(Method::Auto | Method::Pt | Method::Fem)) = (typed.guide, typed.method) {
            let place = at("guide").unwrap_or_else(|| "--guide".to_owned());
            return Err(usage(format!("{place}: tables of 1998 guide two passes; use `--method femc` with it")));
        }
        let settings = resolve_settings(typed);
        let measure =
            typed.measure.as_deref().map(|path| points_file::load_for(path, self.source.scene())).transpose()?;
        self.resolve_with(Settings { measure, ..settings }, typed, at)
    }

    /// Checks settings against the scene, and plans. Only the frames, layers, workers and threads are taken from `typed`.
    fn resolve_with(
        &self,
        settings: Settings,
        typed: &SettingsArgs,
        at: LocateSetting<'_>,
    ) -> Result<ResolvedRequest, Failure> {
        let named = |key: &str| at(key).unwrap_or_else(|| format!("--{}", key.split('.').next().unwrap_or(key)));
        let source = self.source.variant(&settings.overrides);
        let source = source.map_err(|e| usage(format!("{}: {e}", named(&format!("set.{}", e.selector())))))?;
        let scene = source.scene();
        let requested = resolve_layers(scene, typed, &named)?;
        let nothing = requested.0.is_empty() && requested.1.is_empty();
        let (layers, features) = if nothing { (settings.layers, settings.features) } else { requested };
        let settings = Settings { layers, features, ..settings };
        let frames = typed
            .frames
            .as_ref()
            .map(|frames| frames.resolve(scene.frame_count()))
            .transpose()
            .map_err(|e| usage(format!("{}: {e}", named("frames"))))?;
        let plan =
            plan_request(scene, &settings, frames.as_deref()).map_err(|e| map_plan_error(&self.path, &e, &named))?;
        Ok(ResolvedRequest {
            path: self.path.clone(),
            scene_path: self.scene_path.clone(),
            source,
            files: self.files.clone(),
            settings,
            plan,
            choice: None,
            solved: None,
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

impl ResolvedRequest {
    /// Reads the scene or job file `path`, applies `typed`, and plans. Warnings of the import go to stderr.
    pub fn open(path: &Path, typed: SettingsArgs, printer: Printer) -> Result<Self, Failure> {
        let resolved = if is_job_file(path) {
            let mut job = JobFile::load(path).map_err(usage)?;
            if let Some(sweep) = &job.sweep {
                let path = path.display();
                return Err(usage(format!(
                    "{}: this job has variants; render them with `femc sweep {path}`, or list them with `femc plan {path}`",
                    job.format_location(sweep.position())
                )));
            }
            job.remove_replaced(&typed);
            let settings = typed.merge_over(job.settings.clone());
            let imported = ImportedScene::open(&job.scene, settings.root.as_deref(), printer)?;
            let resolved = imported.resolve(&settings, &|key| job.location(key))?;
            Self { priority: job.priority, tags: job.tags, given_name: job.name, notes: job.notes, ..resolved }
        } else {
            ImportedScene::open(path, typed.root.as_deref(), printer)?.resolve(&typed, &|_| None)?
        };
        resolved.warn(printer);
        Ok(resolved)
    }

    /// Reads the scene at `path`, and plans to render the frame in the file `replayed` again.
    pub fn replay(path: &Path, replayed: &Path, typed: SettingsArgs, printer: Printer) -> Result<Self, Failure> {
        if is_job_file(path) {
            return Err(usage("--replay: give the scene of the frame; a job file has its own settings"));
        }
        let shown = replayed.display();
        let Some(attributes) = attributes(replayed) else {
            return Err(usage(format!(
                "--replay: {shown} is not a readable frame; give an EXR or PNG file that femc has written"
            )));
        };
        let FrameMetadata { settings, frame, scene, engine } = FrameMetadata::parse(replayed, &attributes)?;
        let typed = SettingsArgs { frames: Some(Frames::single(frame)), ..typed };
        let resolved =
            ImportedScene::open(path, typed.root.as_deref(), printer)?.resolve_with(settings, &typed, &|_| None)?;
        if resolved.scene().digest().to_string() != scene {
            let path = path.display();
            return Err(failed(format!(
                "--replay: {shown} was rendered from another scene than {path}, or from another state of it"
            )));
        }
        if engine != femc_worker::engine() {
            printer.warning(format!(
                "--replay: {shown} is from another build of the engine ({engine}): pixels may differ"
            ));
        }
        resolved.warn(printer);
        Ok(resolved)
    }

    /// Returns the request for a measurement of the same frames, without images.
    pub fn only_measuring(mut self, request: MeasureRequest) -> Result<Self, Failure> {
        self.settings = Settings { measure: Some(request), measure_only: true, ..self.settings };
        self.plan = plan_request(self.source.scene(), &self.settings, Some(&self.plan.frames)).map_err(failed)?;
        Ok(self)
    }

    /// Chooses the method if the settings leave it open: a pilot finds out whether a first pass saves time.
    pub fn choose_method(mut self, printer: Printer) -> Result<Self, Failure> {
        if self.settings.method != femc_pipeline::Method::Auto || self.settings.measure_only {
            return Ok(self);
        }
        let failed = |e: &dyn std::fmt::Display| failed(format!("{}: {e}", self.path.display()));
        let pool = threads::pool(self.threads)?;
        let busy = BusyIndicator::new(printer, "a pilot of the first frame decides whether a first pass saves time");
        let (choice, solved) = pool
            .install(|| method_choice::choose_method(&self.source, &self.settings, &self.plan))
            .map_err(|e| failed(&e))?;
        drop(busy);
        if choice.method == femc_pipeline::Method::Pt {
            if let Some(left) = self.plan.left_out.iter_mut().find(|left| left.what == FIRST_PASS_FEATURE) {
                left.reason.clone_from(&choice.reason);
            }
        } else {
            self.settings.method = choice.method;
            self.plan =
                plan_request(self.source.scene(), &self.settings, Some(&self.plan.frames)).map_err(|e| failed(&e))?;
        }
        (self.choice, self.solved) = (Some(choice), solved);
        Ok(self)
    }

    /// Warns if nothing in the scene emits light, and of layers that will be black in this scene. There is no warning for layers
    /// that belong to a set (`guides`, `lamps`), because a set has all of its layers in every scene.
    pub fn warn(&self, printer: Printer) {
        let scene = self.scene();
        if scene.is_dark() {
            let path = self.path.display();
            printer.warning(format!(
                "{path}: nothing in the scene emits light, so every picture is black; see `femc check {path}`"
            ));
        }
        let sets: Vec<Layer> =
            [Preset::Guides, Preset::Lamps].into_iter().flat_map(|set| self.layers_of(set)).collect();
        let is_own = |dark: &DarkLayer| sets.iter().all(|layer| layer.name != dark.layer);
        for dark in femc_pipeline::dark_layers(scene, &self.settings).into_iter().filter(is_own) {
            printer.warning(dark);
        }
        for merged in femc_pipeline::cryptomatte_collisions(scene, &self.settings.features) {
            printer.warning(merged);
        }
    }

    /// Returns the layers of a preset in this scene; empty if the scene has none.
    fn layers_of(&self, preset: Preset) -> Vec<Layer> {
        preset.layers(lamp_labels(self.scene()).iter().map(String::as_str)).unwrap_or_default()
    }

    /// Prints why the pilot has chosen a first pass.
    pub fn explain_method(&self, printer: Printer) {
        if let Some(MethodChoice { method: femc_pipeline::Method::Femc, reason, .. }) = &self.choice {
            printer.note(format!("a first pass guides the paths: {reason}; `--method pt` renders without it"));
        }
    }

    /// Returns the scene file with the root of its files.
    pub fn scene_path(&self) -> &ScenePath {
        &self.scene_path
    }

    /// Returns the scene with its overrides.
    pub fn scene(&self) -> &Arc<Scene> {
        self.source.scene()
    }

    /// Returns the path of the scene file, relative to the root of its files.
    pub fn entry(&self) -> String {
        self.scene_path.entry().to_owned()
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
        let bundle = Bundle::from_files(&self.scene_path.disk(), &self.files).map_err(|e| cannot(&e))?;
        Parcel::pack(&bundle).map_err(|e| cannot(&e))
    }
}

/// Plans the request. Development builds may cut stages in other ways than the plan.
fn plan_request(scene: &Scene, settings: &Settings, frames: Option<&[u32]>) -> Result<Plan, PlanError> {
    let mut plan = femc_pipeline::plan_job(scene, settings, frames)?;
    if let Some(fan) = pretended_value(PretendedValue::Fan).and_then(|fan| fan.parse().ok()) {
        plan.graph = femc_pipeline::job_graph(&plan.tiling, &plan.rounds, fan, plan.method);
    }
    if let Some(blocks) = pretended_value(PretendedValue::Blocks).and_then(|blocks| blocks.parse().ok()) {
        plan.graph = femc_pipeline::split_first_pass(plan.graph, plan.method, blocks);
    }
    Ok(plan)
}

/// Imports the scene at `path`, whose files are below `root` (`None`: below its folder). Errors name files as they are reached from
/// the current folder. Of several errors, the message shows the first.
pub fn load_scene(path: &Path, root: Option<&Path>) -> Result<(ScenePath, LoadedScene), Failure> {
    let scene_path = locate_scene(path, root)?;
    let loaded = scene_path.load_or_all_errors().map_err(|failed_import| {
        let ImportErrors { errors, complete } = failed_import;
        let first = with_root_prefix(&scene_path, &errors[0]);
        let more = match errors.len() - 1 {
            0 if complete => String::new(),
            0 => format!("; there may be more errors: `femc check {}` lists them", path.display()),
            more => {
                let least = if complete { "" } else { "at least " };
                let more = human::counted_noun(more as u64, "more error");
                format!("; {least}{more}: `femc check {}` lists them", path.display())
            }
        };
        failed(format!("{first}{more}"))
    })?;
    Ok((scene_path, loaded))
}

/// Checks that `path` is a file, and returns it with its root (`None`: its folder).
pub fn locate_scene(path: &Path, root: Option<&Path>) -> Result<ScenePath, Failure> {
    match path.metadata() {
        Err(e) => return Err(usage(format!("{}: {e}; give the path of a scene file", path.display()))),
        Ok(data) if data.is_dir() => {
            return Err(usage(format!("{} is a folder; give the path of a scene file", path.display())));
        }
        Ok(_) => {}
    }
    let scene_path = match root {
        None => ScenePath::new(path),
        Some(root) if !root.is_dir() => {
            return Err(usage(format!(
                "--root {}: no such folder; give a folder that contains the scene",
                root.display()
            )));
        }
        Some(root) => ScenePath::with_root(root, path),
    };
    scene_path.map_err(usage)
}

/// Checks that the selector of each `vary` exists. Otherwise the job would fail on the farm, in every frame and without a location
/// in the file.
fn check_varies(scene_path: &ScenePath, scene: &Scene) -> Result<(), Failure> {
    for vary in &scene.varies {
        if let Err(e) = scene.get(&vary.selector) {
            let file = scene.files.get(vary.location.file as usize).map_or("", String::as_str);
            return Err(failed(format!("{}:{}: vary: {e}", with_root_prefix(scene_path, file), vary.location.line)));
        }
    }
    Ok(())
}

/// Returns the line for a warning or note of the import.
pub fn warning_line(scene_path: &ScenePath, warning: &Warning, severity: Severity) -> FaultLine {
    let Warning { at, kind: oddity } = warning;
    let (kind, file) = (oddity.code().to_owned(), with_root_prefix(scene_path, &at.file));
    FaultLine { severity, kind, file, line: at.line, column: None, message: oddity.to_string(), advice: String::new() }
}

/// Extends the file name at the beginning of a message: from the path below the scene's root to the path from the current folder.
pub fn with_root_prefix(scene_path: &ScenePath, message: impl std::fmt::Display) -> String {
    let root = scene_path.root();
    if root == Path::new(".") { message.to_string() } else { format!("{}/{message}", root.display()) }
}

/// Maps settings that do not fit the scene to wrong usage, and scenes that cannot be prepared to failure.
fn map_plan_error(path: &Path, e: &PlanError, named: &dyn Fn(&str) -> String) -> Failure {
    let message = format!("{}: {e}", path.display());
    match e {
        PlanError::Camera(PrepareError::UnknownCamera { .. }) => usage(format!("{}: {message}", named("camera"))),
        PlanError::Camera(_) => failed(message),
        PlanError::Settings(SettingsError::Domain { setting, .. }) => usage(format!("{}: {e}", named(setting))),
        PlanError::Settings(SettingsError::Allocation(e)) => usage(format!("--replay: {e}")),
        PlanError::Settings(SettingsError::MaxDepthWithFem(_)) => usage(format!("{}: {e}", named("method"))),
        PlanError::Settings(SettingsError::LayersWithFem) => usage(format!("{}: {e}", named("method"))),
        PlanError::Settings(SettingsError::Measure(_)) => usage(format!("{}: {e}", named("measure"))),
        PlanError::Settings(SettingsError::NothingToMeasure) => usage(format!("{}: {e}", named("measure-only"))),
        PlanError::Settings(SettingsError::Layers(_)) => usage(format!("{}: {e}", named("layer"))),
        PlanError::Film(_) => usage(format!("{}: {message}", named("size"))),
        PlanError::Settings(SettingsError::Selector(_))
        | PlanError::FrameOutside { .. }
        | PlanError::NoFrames { .. } => usage(message),
    }
}

/// Returns whether a path on the command line is a job file.
pub fn is_job_file(path: &Path) -> bool {
    path.extension().is_some_and(|extension| extension == "toml")
}

/// Returns the typed settings, completed by the defaults.
fn resolve_settings(typed: &SettingsArgs) -> Settings {
    let default = Settings::default();
    let stop = match (typed.spp, typed.error, typed.time) {
        (Some(n), _, _) => StopCondition::Spp(n),
        (_, Some(e), _) => StopCondition::Error(e),
        (_, _, Some(time)) => StopCondition::Time(time.seconds),
        (None, None, None) => default.stop,
    };
    Settings {
        camera: typed.camera.clone(),
        size: typed.size.map(|Size { width, height }| [width, height]),
        stop,
        method: match typed.guide {
            Some(Guide::Tables1998) => femc_pipeline::Method::Femc1998,
            Some(Guide::Targets) | None => typed.method.map_or(default.method, method),
        },
        max_depth: typed.max_depth.unwrap_or(default.max_depth),
        filter: typed.filter.map_or(default.filter, filter),
        seed: typed.seed.unwrap_or(default.seed),
        overrides: typed.set.iter().map(|o| (o.selector.clone(), o.value)).collect(),
        statistics: typed.stats.is_some(),
        full_statistics: typed.stats == Some(StatsMode::Full),
        layers: Vec::new(),
        features: BTreeSet::new(),
        measure: None,
        measure_only: typed.measure_only,
        allocation: None,
    }
}

/// Returns the typed layers and features. `--layers` names layers and features. The layers of `--layer` are last.
fn resolve_layers(
    scene: &Scene,
    typed: &SettingsArgs,
    named: &dyn Fn(&str) -> String,
) -> Result<(Vec<Layer>, BTreeSet<Feature>), Failure> {
    let lamps = if typed.layers.is_empty() { Vec::new() } else { lamp_labels(scene) };
    let (mut all, mut features) = (Vec::new(), BTreeSet::new());
    for name in &typed.layers {
        if let Some(feature) = Feature::from_name(name.trim()) {
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
        let beside =
            |scene: &str, message: &str| with_root_prefix(&ScenePath::new(Path::new(scene)).expect("a place"), message);
        assert_eq!(beside("a.mgf", "a.mgf:3: fault"), "a.mgf:3: fault");
        assert_eq!(beside("scenes/a.mgf", "a.mgf:3: fault"), "scenes/a.mgf:3: fault");
        assert_eq!(beside("/s/a.mgf", "lamps/b.mgf:3: fault"), "/s/lamps/b.mgf:3: fault");
    }

    #[test]
    fn what_is_not_typed_is_the_contracts_default() {
        let settings = resolve_settings(&SettingsArgs::default());
        assert_eq!((settings.stop, settings.seed, settings.max_depth), (StopCondition::Error(0.05), 1, 0));
        assert_eq!((settings.method, settings.filter), (femc_pipeline::Method::Auto, femc_film::Filter::Box));
    }
}
