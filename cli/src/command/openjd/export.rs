//! Export of a job as a template. Each task runs `femc render` for one variant and some frames.

mod document;

use super::file_paths::relative;
use super::import::TAGS;
use super::template::{Template, TemplateError};
use crate::args::StatsMode;
use crate::request::{Change, JobFile, SweepMode};
use crate::values::Frames;
use document::{Document, HostAttribute, Parameter, Range, TaskParameter};
use openjd_expr::escape_format_string;
use std::collections::BTreeSet;
use std::num::NonZeroUsize;
use std::path::Path;

/// A template, and the parts of the job that it lacks.
#[derive(Debug)]
pub struct ExportedTemplate {
    /// JSON or YAML, depending on the extension of the file name.
    pub text: String,
    /// Parts that were left out, one line each.
    pub left_out: Vec<String>,
}

/// Distribution of a job's frames to tasks.
#[derive(Clone, Copy, Debug)]
pub struct FrameChunks<'a> {
    /// Frames of every variant, ascending; unused if frames are an axis.
    pub all: &'a [u32],
    /// Largest number of frames per task.
    pub chunk: NonZeroUsize,
}

/// Exports `job` as a template for the file `out`.
pub fn export(job: &JobFile, frames: FrameChunks<'_>, out: &Path) -> Result<ExportedTemplate, TemplateError> {
    let (mut columns, zipped) = columns(job);
    let stem = job.scene.file_stem().map(|stem| stem.to_string_lossy().into_owned()).unwrap_or_default();
    let mut place = vec!["{{Param.Out}}".to_owned()];
    place.extend((!columns.is_empty()).then(|| variant_folder(&columns)));
    let mut combination = columns.iter().map(|column| column.parameter.clone()).collect::<Vec<_>>().join(if zipped {
        ", "
    } else {
        " * "
    });
    if zipped && columns.len() > 1 {
        combination = format!("({combination})");
    }
    if !columns.iter().any(|column| column.name == "frames") {
        let column = chunk_column(frames);
        place.push(match column.parameter.as_str() {
            "Frame" => format!("{}.{{{{Task.Param.Frame}}}}.exr", escape_format_string(&stem)),
            chunk => format!("{{{{Task.Param.{chunk}}}}}"),
        });
        combination = if combination.is_empty() {
            column.parameter.clone()
        } else {
            format!("{combination} * {}", column.parameter)
        };
        columns.push(column);
    }
    let mut args = vec!["render".to_owned(), "{{Param.Scene}}".to_owned(), "-o".to_owned(), place.join("/")];
    args.extend(columns.iter().map(Column::flag));
    args.extend(constant_flags(job));
    let file = job.path.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
    let (tags, mut left_out) = host_tags(job);
    left_out.extend(unsupported_parts(job));
    let document = Document {
        name: job.path.file_stem().map(|name| escape_format_string(&name.to_string_lossy())).unwrap_or_default(),
        description: format!("{file} by femc {}", env!("CARGO_PKG_VERSION")),
        parameters: vec![
            Parameter::scene(relative(out.parent().unwrap_or(Path::new("")), &job.scene)),
            Parameter::out(stem),
        ],
        space: columns
            .into_iter()
            .map(|column| TaskParameter { name: column.parameter, range: column.range })
            .collect(),
        combination,
        command: "femc".to_owned(),
        args,
        attributes: tags,
    };
    let text = document.write(out)?;
    // The exported template must pass the checks of any other template.
    Template::parse(out, &text, &[])?;
    Ok(ExportedTemplate { text, left_out })
}

/// A task parameter and its flag.
struct Column {
    /// Long name of the setting, or the selector.
    name: String,
    /// Name used in the names of variants.
    label: String,
    /// Name used in the template.
    parameter: String,
    is_scalar: bool,
    range: Range,
}

impl Column {
    fn flag(&self) -> String {
        let value = format!("{{{{Task.Param.{}}}}}", self.parameter);
        if self.is_scalar {
            format!("--set={}={value}", escape_format_string(&self.name))
        } else {
            format!("--{}={value}", self.name)
        }
    }
}

/// Returns a column for each axis, and whether their values are combined one by one (zip).
fn columns(job: &JobFile) -> (Vec<Column>, bool) {
    let Some(sweep) = &job.sweep else { return (Vec::new(), false) };
    let mut used = BTreeSet::from(["Frame".to_owned(), "Frames".to_owned()]);
    let column = |(axis, label): (&crate::request::Axis, String)| {
        let safe = identifier(&label);
        let mut parameter = safe.clone();
        for n in 2.. {
            if used.insert(parameter.clone()) {
                break;
            }
            parameter = format!("{safe}x{n}");
        }
        let changes: Vec<&Change> = axis.values.iter().map(|choice| &choice.change).collect();
        let is_scalar = changes.iter().any(|change| matches!(change, Change::Scalar(_)));
        Column { name: axis.name.clone(), label, parameter, is_scalar, range: Range::from_changes(&changes) }
    };
    (sweep.axes.iter().zip(sweep.labels()).map(column).collect(), sweep.mode == SweepMode::Zip)
}

/// Converts `sigma_s` to `SigmaS`: only letters and digits, because older implementations allow nothing else in combinations.
fn identifier(label: &str) -> String {
    let parts = label.split(|c: char| !c.is_ascii_alphanumeric()).filter(|part| !part.is_empty());
    let part = |part: &str| part[..1].to_ascii_uppercase() + &part[1..];
    let joined: String = parts.map(part).collect::<String>().chars().take(60).collect();
    if joined.starts_with(|c: char| c.is_ascii_alphabetic()) { joined } else { format!("P{joined}") }
}

/// Returns the folder of a variant, named as by `femc sweep`.
fn variant_folder(columns: &[Column]) -> String {
    let part =
        |column: &Column| format!("{}={{{{Task.Param.{}}}}}", escape_format_string(&column.label), column.parameter);
    columns.iter().map(part).collect::<Vec<_>>().join(",")
}

fn chunk_column(FrameChunks { all, chunk }: FrameChunks<'_>) -> Column {
    let column = |parameter: &str, range| Column {
        name: "frames".to_owned(),
        label: String::new(),
        parameter: parameter.to_owned(),
        is_scalar: false,
        range,
    };
    if chunk.get() == 1 {
        return column("Frame", Range::from_frames(all));
    }
    let text = |some: &[u32]| Frames::from_list(some).to_string();
    column("Frames", Range::Texts(all.chunks(chunk.get()).map(text).collect()))
}

/// Returns the flags that are the same for all variants.
fn constant_flags(job: &JobFile) -> Vec<String> {
    let axes: BTreeSet<&str> = job.sweep.iter().flat_map(|sweep| &sweep.axes).map(|axis| axis.name.as_str()).collect();
    let is_stop = |name: &str| ["spp", "error", "time"].contains(&name);
    let has_stop = axes.iter().any(|name| is_stop(name));
    let is_varied = |change: &Change| {
        axes.contains(change.name()) || change.name() == "frames" || (has_stop && is_stop(change.name()))
    };
    let flag = |change: Change| {
        let (name, value) = (change.name(), change.text());
        escape_format_string(&match &change {
            Change::Scalar(_) => format!("--set={name}={value}"),
            _ => format!("--{name}={value}"),
        })
    };
    let mut flags: Vec<String> =
        Change::from_settings(&job.settings).into_iter().filter(|change| !is_varied(change)).map(flag).collect();
    flags.extend(job.settings.workers.map(|n| format!("--workers={n}")));
    flags.extend(job.settings.threads.map(|n| format!("--threads={n}")));
    flags.extend(job.settings.stats.map(|stats| match stats {
        StatsMode::Some => "--stats".to_owned(),
        StatsMode::Full => "--stats=full".to_owned(),
    }));
    flags
}

/// Returns the tags as an attribute of hosts, and lines about tags that cannot be a value of an attribute.
fn host_tags(job: &JobFile) -> (Option<HostAttribute>, Vec<String>) {
    let is_value = |tag: &&String| {
        let may_begin = |c: char| c.is_ascii_alphabetic() || c == '_';
        let may_be = |c: char| c.is_ascii_alphanumeric() || c == '_' || c == '-';
        tag.starts_with(may_begin) && tag.chars().all(may_be) && tag.len() <= 100
    };
    let (fit, unfit): (Vec<&String>, Vec<&String>) = job.tags.iter().partition(is_value);
    let left_out = |tag: &String| {
        omission_line(job, "tags", &format!("`{tag}` is left out: it is not a valid value of a host attribute"))
    };
    let attribute = HostAttribute { name: TAGS, all_of: fit.into_iter().cloned().collect() };
    (Some(attribute).filter(|attribute| !attribute.all_of.is_empty()), unfit.into_iter().map(left_out).collect())
}

/// Returns lines about the parts of a job that a template cannot express.
fn unsupported_parts(job: &JobFile) -> Vec<String> {
    let mut lost = Vec::new();
    if job.priority.is_some() {
        lost.push(omission_line(job, "priority", "is left out: the priority is set when a template is submitted"));
    }
    if job.settings.root.is_some() {
        lost.push(omission_line(job, "root", "is left out: add `--root` to the commands of the template"));
    }
    if !job.measures.regions.is_empty() {
        lost.push(omission_line(
            job,
            "regions",
            "and contrasts are left out: `femc sweep` measures them, tasks do not",
        ));
    }
    lost
}

fn omission_line(job: &JobFile, key: &str, why: &str) -> String {
    format!("{}: {key} {why}", job.location(key).unwrap_or_else(|| job.path.display().to_string()))
}
