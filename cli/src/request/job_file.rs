//! JOB.toml: a scene and its settings by their long names, in a file.

use super::{Budget, Frames, Override, Size};
use crate::args::{Filter, Method, SettingsArgs};
use serde::Deserialize;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// A parsed job file.
#[derive(Debug)]
pub struct JobFile {
    /// The scene, relative paths already taken from the job file's folder.
    pub scene: PathBuf,
    /// The settings, as if typed.
    pub settings: SettingsArgs,
    /// 0..=100.
    pub priority: Option<u8>,
    /// Workers that may take it carry all of these.
    pub tags: Vec<String>,
}

/// Why a job file is refused.
#[derive(Debug, thiserror::Error)]
pub enum JobFileError {
    /// Not readable.
    #[error("{}: {cause}", path.display())]
    Read {
        /// The job file.
        path: PathBuf,
        /// What the system says.
        cause: std::io::Error,
    },
    /// Not TOML, or not a job.
    #[error("{}:{line}:{column}: {what}", path.display())]
    Form {
        /// The job file.
        path: PathBuf,
        /// From 1.
        line: usize,
        /// From 1.
        column: usize,
        /// What is wrong there.
        what: String,
    },
}

/// The file's own form. `_` and `-` are both accepted in `max-depth`.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields, rename_all = "kebab-case")]
struct Written {
    scene: PathBuf,
    camera: Option<String>,
    size: Option<Size>,
    frames: Option<Frames>,
    spp: Option<u32>,
    error: Option<f64>,
    time: Option<Budget>,
    method: Option<Method>,
    #[serde(alias = "max_depth")]
    max_depth: Option<u32>,
    filter: Option<Filter>,
    seed: Option<u64>,
    workers: Option<u32>,
    threads: Option<u32>,
    #[serde(default)]
    stats: bool,
    priority: Option<u8>,
    #[serde(default)]
    tags: Vec<String>,
    #[serde(default)]
    set: BTreeMap<String, f64>,
    sweep: Option<toml::Spanned<toml::Table>>,
}

impl JobFile {
    /// Read and check `path`.
    pub fn load(path: &Path) -> Result<Self, JobFileError> {
        let text =
            std::fs::read_to_string(path).map_err(|cause| JobFileError::Read { path: path.to_owned(), cause })?;
        Self::parse(path, &text)
    }

    /// The job in `text`, which stands in the file `path`.
    pub fn parse(path: &Path, text: &str) -> Result<Self, JobFileError> {
        let fault = |offset: usize, what: String| {
            let (line, column) = position(text, offset);
            JobFileError::Form { path: path.to_owned(), line, column, what }
        };
        let job: Written =
            toml::from_str(text).map_err(|e| fault(e.span().map_or(0, |s| s.start), one_line(e.message())))?;
        if let Some(sweep) = &job.sweep {
            let what = "sweeps are not there yet: take [sweep] out, and queue a job for each value with --set";
            return Err(fault(sweep.span().start, what.to_owned()));
        }
        check(&job).map_err(|(key, what)| fault(offset_of(text, key), what))?;
        let folder = path.parent().unwrap_or(Path::new(""));
        Ok(Self {
            scene: folder.join(&job.scene),
            settings: SettingsArgs {
                camera: job.camera,
                size: job.size,
                frames: job.frames,
                spp: job.spp,
                error: job.error,
                time: job.time,
                method: job.method,
                max_depth: job.max_depth,
                filter: job.filter,
                seed: job.seed,
                workers: job.workers,
                threads: job.threads,
                set: job.set.into_iter().map(|(selector, value)| Override { selector, value }).collect(),
                stats: job.stats,
            },
            priority: job.priority,
            tags: job.tags,
        })
    }
}

/// What the command line refuses of a flag is refused of a key: the key at fault and what is wrong.
fn check(job: &Written) -> Result<(), (&'static str, String)> {
    let stops = [job.spp.is_some(), job.error.is_some(), job.time.is_some()];
    if stops.iter().filter(|&&given| given).count() > 1 {
        let key = if job.spp.is_some() { "spp" } else { "error" };
        return Err((key, "spp, error and time exclude each other: keep one of them".to_owned()));
    }
    if job.spp == Some(0) {
        return Err(("spp", "spp is at least 1".to_owned()));
    }
    if job.error.is_some_and(|error| !(error.is_finite() && error > 0.0)) {
        return Err(("error", "error is a relative error > 0, like 0.05".to_owned()));
    }
    if job.priority.is_some_and(|priority| priority > 100) {
        return Err(("priority", "priority goes from 0 to 100".to_owned()));
    }
    if job.workers == Some(0) {
        return Err(("workers", "workers is at least 1".to_owned()));
    }
    if job.threads == Some(0) {
        return Err(("threads", "threads is at least 1".to_owned()));
    }
    if let Some((selector, value)) = job.set.iter().find(|(_, value)| !value.is_finite()) {
        return Err(("[set]", format!("`{selector}` = {value} is no finite number")));
    }
    Ok(())
}

/// Byte offset of the line that begins with `key`.
fn offset_of(text: &str, key: &str) -> usize {
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

/// Line and column, both from 1, of a byte offset.
fn position(text: &str, offset: usize) -> (usize, usize) {
    let before = text.get(..offset).unwrap_or(text);
    let line_start = before.rfind('\n').map_or(0, |i| i + 1);
    (before.matches('\n').count() + 1, before[line_start..].chars().count() + 1)
}

fn one_line(message: &str) -> String {
    message.lines().map(str::trim).collect::<Vec<_>>().join("; ")
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
        assert_eq!(settings.time, Some(Budget { seconds: 90.0 }));
        assert_eq!((settings.method, settings.filter), (Some(Method::Pt), Some(Filter::BlackmanHarris)));
        assert_eq!((settings.max_depth, settings.seed, settings.stats), (Some(5), Some(3), true));
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
            ("spp = 0", "spp is at least 1"),
            ("spp = 4\nerror = 0.1", "exclude each other"),
            ("error = -1.0", "relative error"),
            ("priority = 101", "0 to 100"),
            ("threads = 0", "threads is at least 1"),
            ("frames = \"5..1\"", "comes before"),
            ("size = \"4\"", "320x180"),
        ] {
            let error = parse(&format!("scene = \"a.mgf\"\n{line}\n")).expect_err(line);
            assert!(error.starts_with("jobs/night.toml:2:") && error.contains(fault), "{line}: {error}");
        }
    }

    #[test]
    fn a_sweep_is_refused_and_not_ignored() {
        let error = parse("scene = \"a.mgf\"\n[sweep]\n\"medium.fog.sigma_s\" = [0.1]\n").expect_err("a fault");
        assert!(error.starts_with("jobs/night.toml:2:1: sweeps are not there yet"), "{error}");
    }

    #[test]
    fn a_job_without_a_scene_is_refused() {
        assert!(parse("spp = 4").is_err_and(|error| error.contains("missing field `scene`")));
    }
}
