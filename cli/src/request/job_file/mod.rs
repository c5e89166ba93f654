//! JOB.toml: a file with a scene and its settings by their long names; with `[sweep]`, also its variants.

mod axis;
mod change;
mod fault;
mod measures;
mod range;
mod sweep;
#[cfg(test)]
mod sweep_tests;
mod variant_names;

pub use fault::JobFileError;
pub use measures::Measures;
pub use sweep::Sweep;
#[cfg(feature = "openjd")]
pub use {axis::Axis, change::Change, sweep::SweepMode};

use crate::args::{Filter, Guide, Method, SettingsArgs, StatsMode, job_name};
use crate::values::{DurationArg, Frames, Override, Size, TextPosition};
use fault::{Fault, one_line};
use femc_model::JobNotes;
use femc_pipeline::Layer;
use serde::Deserialize;
use serde::de::IgnoredAny;
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use toml::de::{DeTable, DeValue};

/// A parsed job file.
#[derive(Debug)]
pub struct JobFile {
    /// Path of the job file.
    pub path: PathBuf,
    /// Path of the scene. Relative paths have been resolved against the job file's folder.
    pub scene: PathBuf,
    /// Settings, as if typed.
    pub settings: SettingsArgs,
    /// Priority, 0..=100.
    pub priority: Option<u8>,
    /// Tags that workers need to run the job, all of them.
    pub tags: Vec<String>,
    /// Name of the job and of its files.
    pub name: Option<String>,
    /// Comment, labels, URL to notify.
    pub notes: JobNotes,
    /// Variants, if the file has `[sweep]`.
    pub sweep: Option<Sweep>,
    /// Measurements in the frames of a sweep.
    pub measures: Measures,
    positions: BTreeMap<String, TextPosition>,
}

/// The file as written. `_` and `-` are both accepted in keys.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields, rename_all = "kebab-case")]
struct RawJobFile {
    scene: PathBuf,
    camera: Option<String>,
    size: Option<Size>,
    frames: Option<Frames>,
    spp: Option<u32>,
    error: Option<f64>,
    time: Option<DurationArg>,
    method: Option<Method>,
    guide: Option<Guide>,
    #[serde(alias = "max_depth")]
    max_depth: Option<u32>,
    filter: Option<Filter>,
    seed: Option<u64>,
    workers: Option<u32>,
    threads: Option<u32>,
    root: Option<PathBuf>,
    stats: Option<StatsValue>,
    #[serde(default)]
    layers: Vec<String>,
    #[serde(default)]
    layer: BTreeMap<String, String>,
    measure: Option<PathBuf>,
    #[serde(default, alias = "measure_only")]
    measure_only: bool,
    priority: Option<u8>,
    #[serde(default)]
    tags: Vec<String>,
    name: Option<String>,
    #[serde(default)]
    comment: String,
    #[serde(default)]
    labels: BTreeMap<String, String>,
    notify: Option<String>,
    #[serde(default)]
    set: BTreeMap<String, f64>,
    /// These tables are read without serde, to get the location of each value.
    #[serde(rename = "sweep")]
    _sweep: Option<IgnoredAny>,
    #[serde(rename = "regions")]
    _regions: Option<IgnoredAny>,
    #[serde(rename = "contrasts")]
    _contrasts: Option<IgnoredAny>,
}

/// Value of `stats`: `true`, `false` or `"full"`.
#[derive(Debug, Deserialize)]
#[serde(untagged, expecting = "expected true, false or \"full\"")]
enum StatsValue {
    Flag(bool),
    Mode(StatsWord),
}

#[derive(Debug, Deserialize)]
#[serde(rename_all = "lowercase")]
enum StatsWord {
    Full,
}

impl StatsValue {
    fn mode(self) -> Option<StatsMode> {
        match self {
            Self::Flag(is_wanted) => is_wanted.then_some(StatsMode::Some),
            Self::Mode(StatsWord::Full) => Some(StatsMode::Full),
        }
    }
}

impl JobFile {
    /// Reads and checks `path`.
    pub fn load(path: &Path) -> Result<Self, JobFileError> {
        let text =
            std::fs::read_to_string(path).map_err(|cause| JobFileError::Read { path: path.to_owned(), cause })?;
        Self::parse(path, &text)
    }

    /// Parses the job in `text`; `path`: its file.
    pub fn parse(path: &Path, text: &str) -> Result<Self, JobFileError> {
        Self::read(path, text).map_err(|fault| fault.in_file(path, text))
    }

    fn read(path: &Path, text: &str) -> Result<Self, Fault> {
        let wrong = |e: toml::de::Error| Fault::new(e.span().map_or(0, |s| s.start), one_line(e.message()));
        let job: RawJobFile = toml::from_str(text).map_err(wrong)?;
        check(&job).map_err(|(key, what)| Fault::new(key_offset(text, key), what))?;
        let table = DeTable::parse(text).map_err(wrong)?;
        let table = table.get_ref();
        let sweep = table.get("sweep").map(|table| Sweep::read(table, text)).transpose()?;
        let measures = Measures::read(table.get("regions"), table.get("contrasts"), text)?;
        let folder = path.parent().unwrap_or(Path::new(""));
        Ok(Self {
            path: path.to_owned(),
            sweep,
            measures,
            positions: setting_positions(table, text),
            scene: folder.join(&job.scene),
            settings: SettingsArgs {
                camera: job.camera,
                size: job.size,
                frames: job.frames,
                spp: job.spp,
                error: job.error,
                time: job.time,
                method: job.method,
                guide: job.guide,
                max_depth: job.max_depth,
                filter: job.filter,
                seed: job.seed,
                workers: job.workers,
                threads: job.threads,
                set: job.set.into_iter().map(|(selector, value)| Override { selector, value }).collect(),
                root: job.root.map(|root| folder.join(root)),
                stats: job.stats.and_then(StatsValue::mode),
                layer: job.layer.into_iter().map(|(name, expression)| Layer { name, expression }).collect(),
                layers: job.layers,
                measure: job.measure.map(|points| folder.join(points)),
                measure_only: job.measure_only,
            },
            priority: job.priority,
            tags: job.tags,
            name: job.name,
            notes: JobNotes { comment: job.comment, labels: job.labels, notify: job.notify },
        })
    }

    /// Returns the location of a setting, such as `frames` or the override `set.medium.fog.sigma_s`: `job.toml:3:10`.
    pub fn location(&self, key: &str) -> Option<String> {
        self.positions.get(key).map(|place| self.format_location(*place))
    }

    /// Formats a location in this file for a message.
    pub fn format_location(&self, position: TextPosition) -> String {
        format!("{}:{}:{}", self.path.display(), position.line, position.column)
    }

    /// Removes the locations of settings that the command line replaces.
    pub fn remove_replaced(&mut self, typed: &SettingsArgs) {
        let keys = typed_keys(typed);
        self.positions.retain(|key, _| !keys.contains(key.strip_prefix("set.").unwrap_or(key)));
    }
}

/// Returns the long names of the typed settings, and the selectors of typed overrides. A typed stopping rule adds the names of all
/// three.
pub fn typed_keys(typed: &SettingsArgs) -> BTreeSet<&str> {
    let SettingsArgs { camera, size, frames, spp, error, time, method, guide, max_depth, filter, seed, set, .. } =
        typed;
    let stop = spp.is_some() || error.is_some() || time.is_some();
    let given = [
        ("camera", camera.is_some()),
        ("size", size.is_some()),
        ("frames", frames.is_some()),
        ("spp", stop),
        ("error", stop),
        ("time", stop),
        ("method", method.is_some()),
        ("guide", guide.is_some()),
        ("max-depth", max_depth.is_some()),
        ("filter", filter.is_some()),
        ("seed", seed.is_some()),
    ];
    let settings = given.into_iter().filter(|(_, given)| *given).map(|(key, _)| key);
    settings.chain(set.iter().map(|change| change.selector.as_str())).collect()
}

fn setting_positions(table: &DeTable<'_>, text: &str) -> BTreeMap<String, TextPosition> {
    let mut positions = BTreeMap::new();
    for (key, value) in table {
        positions.insert(key.get_ref().replace('_', "-"), TextPosition::from_offset(text, key.span().start));
        if let ("set", DeValue::Table(set)) = (key.get_ref().as_ref(), value.get_ref()) {
            let place = |(key, _): (&toml::Spanned<std::borrow::Cow<'_, str>>, _)| {
                (format!("set.{}", key.get_ref()), TextPosition::from_offset(text, key.span().start))
            };
            positions.extend(set.iter().map(place));
        }
    }
    positions
}

/// Checks the keys as the command line checks the flags. The error contains the faulty key and a description.
fn check(job: &RawJobFile) -> Result<(), (&'static str, String)> {
    let stops = [job.spp.is_some(), job.error.is_some(), job.time.is_some()];
    if stops.iter().filter(|&&given| given).count() > 1 {
        let key = if job.spp.is_some() { "spp" } else { "error" };
        return Err((key, "spp, error and time exclude each other: keep one of them".to_owned()));
    }
    if job.spp == Some(0) {
        return Err(("spp", "spp must be at least 1".to_owned()));
    }
    if job.error.is_some_and(|error| !(error.is_finite() && error > 0.0)) {
        return Err(("error", "error must be a relative error > 0, like 0.05".to_owned()));
    }
    if job.priority.is_some_and(|priority| priority > 100) {
        return Err(("priority", "priority must be from 0 to 100".to_owned()));
    }
    if let Some(Err(fault)) = job.name.as_deref().map(job_name) {
        return Err(("name", fault));
    }
    let notes = JobNotes { comment: job.comment.clone(), labels: job.labels.clone(), notify: job.notify.clone() };
    if let Err(fault) = notes.check() {
        return Err((fault.field(), fault.to_string()));
    }
    if job.workers == Some(0) {
        return Err(("workers", "workers must be at least 1".to_owned()));
    }
    if job.threads == Some(0) {
        return Err(("threads", "threads must be at least 1".to_owned()));
    }
    if let Some((selector, value)) = job.set.iter().find(|(_, value)| !value.is_finite()) {
        return Err(("[set]", format!("`{selector}` = {value} is not a finite number")));
    }
    Ok(())
}

/// Returns the byte offset of the line that begins with `key`.
fn key_offset(text: &str, key: &str) -> usize {
    let mut offset = 0;
    for line in text.split_inclusive('\n') {
        let start = line.trim_start();
        let after = start.strip_prefix(key);
        if after.is_some_and(|rest| key.starts_with('[') || rest.trim_start().starts_with('=')) {
            return offset + (line.len() - start.len());
        }
        offset += line.len();
    }
    0
}

#[cfg(test)]
mod tests {
    use super::*;

    fn parse(text: &str) -> Result<JobFile, String> {
        JobFile::parse(Path::new("jobs/night.toml"), text).map_err(|e| e.to_string())
    }

    #[test]
    fn the_example_of_the_contract_without_its_sweep_reads_whole() {
        let job = parse(
            "scene = \"roundabout.mgf\"\nframes = \"1..120\"\nerror = 0.05\npriority = 50\ntags = [\"lab\"]\n\
             [set]\n\"medium.fog.sigma_s\" = 0.03\n",
        )
        .expect("a job");
        assert_eq!(job.scene, Path::new("jobs/roundabout.mgf"));
        assert_eq!(job.settings.error, Some(0.05));
        assert_eq!(job.settings.frames, "1..120".parse().ok());
        assert_eq!((job.priority, job.tags), (Some(50), vec!["lab".to_owned()]));
        assert_eq!(job.settings.set, [Override { selector: "medium.fog.sigma_s".to_owned(), value: 0.03 }]);
    }

    #[test]
    fn an_absolute_scene_path_stays_as_it_is() {
        assert_eq!(parse("scene = \"/a/b.mgf\"").map(|job| job.scene), Ok(PathBuf::from("/a/b.mgf")));
    }

    #[test]
    fn every_setting_goes_by_its_long_name() {
        let job = parse(
            "scene = \"a.mgf\"\ncamera = \"main\"\nsize = \"32x16\"\nframes = 7\ntime = \"90s\"\nmethod = \"pt\"\n\
             max-depth = 5\nfilter = \"blackman-harris\"\nseed = 3\nstats = true\nworkers = 2\nthreads = 1\n",
        )
        .expect("a job");
        let settings = job.settings;
        assert_eq!(settings.camera.as_deref(), Some("main"));
        assert_eq!(settings.size, Some(Size { width: 32, height: 16 }));
        assert_eq!(settings.time, Some(DurationArg { seconds: 90.0 }));
        assert_eq!((settings.method, settings.filter), (Some(Method::Pt), Some(Filter::BlackmanHarris)));
        assert_eq!((settings.max_depth, settings.seed, settings.stats), (Some(5), Some(3), Some(StatsMode::Some)));
        assert_eq!((settings.workers, settings.threads), (Some(2), Some(1)));
    }

    #[test]
    fn a_misspelt_key_is_named_with_its_line() {
        let error = parse("scene = \"a.mgf\"\nspq = 4\n").expect_err("a fault");
        assert!(error.starts_with("jobs/night.toml:2:1: unknown field `spq`"), "{error}");
    }

    #[test]
    fn faults_of_value_are_named_with_their_line() {
        for (line, fault) in [
            ("spp = 0", "spp must be at least 1"),
            ("spp = 4\nerror = 0.1", "exclude each other"),
            ("error = -1.0", "relative error"),
            ("priority = 101", "0 to 100"),
            ("name = \"a/b\"", "part of file names"),
            ("comment = \"a\\nb\"", "one line"),
            ("labels = { \"\" = \"x\" }", "label name"),
            ("threads = 0", "threads must be at least 1"),
            ("frames = \"5..1\"", "comes before"),
            ("size = \"4\"", "320x180"),
        ] {
            let error = parse(&format!("scene = \"a.mgf\"\n{line}\n")).expect_err(line);
            assert!(error.starts_with("jobs/night.toml:2:") && error.contains(fault), "{line}: {error}");
        }
    }

    #[test]
    fn a_job_without_a_scene_is_refused() {
        assert!(parse("spp = 4").is_err_and(|error| error.contains("missing field `scene`")));
    }
}
