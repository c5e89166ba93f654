//! Import of a template as a job file. Tasks that differ only in their frames become one variant. Settings that differ between
//! variants become axes.

use super::file_paths::{absolute, relative};
use super::task_command::{CommandPart, ExecutionSettings, TaskCommand};
use super::template::{Template, TemplateError};
use crate::args::StatsMode;
use crate::request::{Change, JobFile};
use crate::values::Frames;
use femc_model::JobSpec;
use openjd_model::job::HostRequirements;
use std::cmp::Reverse;
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

/// Attribute of hosts that carries a job's tags.
pub const TAGS: &str = "attr.femc.tags";
const RUN_ACTION: &str = "steps.0.script.actions.onRun";

/// A job file, and the parts of the template that it lacks.
#[derive(Debug)]
pub struct ImportedJob {
    /// Text of the job file, TOML.
    pub text: String,
    /// Parts that were left out, one line each.
    pub left_out: Vec<String>,
    /// Number of variants, >= 1.
    pub variants: usize,
}

/// Settings of each variant, by name.
type Variants = Vec<BTreeMap<String, Change>>;

/// Imports a template as a job file that does the same as the template's tasks, for the path `out`.
pub fn import(template: &Template, out: &Path) -> Result<ImportedJob, TemplateError> {
    let mut left_out = check_supported(template)?;
    let tasks = read_tasks(template)?;
    let (scene, execution) = common_request(template, &tasks)?;
    let flags: BTreeSet<&str> = tasks.iter().flat_map(|task| task.left_out.iter().copied()).collect();
    for flag in flags {
        left_out.push(
            template.line_about(
                &format!("{RUN_ACTION}.args"),
                format!("`{flag}` is left out: a sweep has its own outputs"),
            ),
        );
    }
    let (variants, twice) = variants(template, tasks)?;
    if twice > 0 {
        left_out.push(
            template.line_about("steps.0.parameterSpace", format!("{twice} tasks repeat other tasks and are left out")),
        );
    }
    let axes = axes(template, &variants);
    let (tags, lost) = tags(template);
    left_out.extend(lost);
    let folder = out.parent().unwrap_or(Path::new(""));
    let mut lines = heading_lines(template);
    lines.push(format!("scene = {}", quoted(&relative(folder, &absolute(template.folder(), &scene)))));
    lines.extend(settings_lines(&variants[0], &axes, &execution, &tags));
    lines.extend(sweep_lines(&variants, &axes));
    let text = lines.join("\n") + "\n";
    // The imported job file must pass the checks of any other job file.
    JobFile::parse(out, &text).map_err(|error| template.fault("steps.0.parameterSpace", error))?;
    Ok(ImportedJob { text, left_out, variants: variants.len() })
}

/// Refuses templates that cannot become a sweep. Returns lines about parts that are left out.
fn check_supported(template: &Template) -> Result<Vec<String>, TemplateError> {
    let (job, written) = (&template.job, &template.source);
    if job.steps.len() > 1 {
        return Err(template.fault("steps.1", "a sweep has one step; write a template for each step"));
    }
    let step = &written.steps[0];
    if step.let_bindings.is_some() || step.script.as_ref().is_some_and(|script| script.let_bindings.is_some()) {
        return Err(template.fault("steps.0", "`let` is not supported; write the expressions where they are used"));
    }
    let mut left_out = Vec::new();
    let mut leave = |is_there: bool, at: &str, why: &str| {
        if is_there {
            left_out.push(template.line_about(at, format!("is left out: {why}")));
        }
    };
    let workers = "femc's workers do not set up environments";
    leave(job.job_environments.is_some(), "jobEnvironments", workers);
    leave(job.steps[0].step_environments.is_some(), "steps.0.stepEnvironments", workers);
    leave(
        job.steps[0].script.embedded_files.is_some(),
        "steps.0.script.embeddedFiles",
        "`femc render` needs no embedded files",
    );
    let action = template.action();
    leave(action.timeout.is_some(), &format!("{RUN_ACTION}.timeout"), "the farm ends tasks that make no progress");
    leave(action.cancelation.is_some(), &format!("{RUN_ACTION}.cancelation"), "a cancelled task ends within a second");
    Ok(left_out)
}

fn read_tasks(template: &Template) -> Result<Vec<TaskCommand>, TemplateError> {
    let read = |line: &Vec<String>| {
        TaskCommand::parse(line).map_err(|(word, what)| match word {
            CommandPart::Command => template.fault(&format!("{RUN_ACTION}.command"), what),
            CommandPart::Arguments => template.fault(&format!("{RUN_ACTION}.args"), what),
        })
    };
    template.command_lines()?.iter().map(read).collect()
}

/// Returns the scene and settings that all tasks must have in common.
fn common_request(template: &Template, tasks: &[TaskCommand]) -> Result<(PathBuf, ExecutionSettings), TemplateError> {
    let args = format!("{RUN_ACTION}.args");
    let Some(first) = tasks.first() else {
        return Err(template.fault("steps.0.parameterSpace", "the template has no tasks"));
    };
    if let Some(other) = tasks.iter().find(|task| task.scene != first.scene) {
        let (a, b) = (first.scene.display(), other.scene.display());
        return Err(template.fault(&args, format!("a sweep has one scene, but the template has {a} and {b}")));
    }
    if first.scene.extension().is_some_and(|extension| extension == "toml") {
        let scene = first.scene.display();
        return Err(template.fault(&args, format!("{scene} is already a job file; run it with `femc sweep`")));
    }
    if tasks.iter().any(|task| task.execution != first.execution) {
        return Err(template.fault(&args, "--workers, --threads and --stats cannot differ from task to task"));
    }
    Ok((first.scene.clone(), first.execution.clone()))
}

/// Tasks whose settings differ only in their frames.
struct TaskGroup {
    changes: BTreeMap<String, Change>,
    /// Frames of the tasks, without duplicates; empty: all frames of the clip.
    frames: Vec<Frames>,
}

/// Returns the variants in the order of the tasks, and the number of duplicate tasks.
fn variants(template: &Template, tasks: Vec<TaskCommand>) -> Result<(Variants, usize), TemplateError> {
    let (groups, twice) = group_tasks(tasks);
    let joined: Option<Vec<Vec<Frames>>> = groups.iter().map(|group| join_frames(&group.frames)).collect();
    let all_frames = match joined {
        Some(joined) => joined,
        // The frames of some group cannot be written as one setting: then each task is a variant.
        None => groups.iter().map(|group| group.frames.clone()).collect(),
    };
    let mut variants = Variants::new();
    for (group, frames) in groups.into_iter().zip(all_frames) {
        let with = |frames: &Frames| {
            let frames = ("frames".to_owned(), Change::Frames(frames.clone()));
            group.changes.clone().into_iter().chain([frames]).collect()
        };
        variants.extend(frames.iter().map(with));
        if frames.is_empty() {
            variants.push(group.changes);
        }
    }
    let names = |changes: &BTreeMap<String, Change>| changes.keys().cloned().collect::<Vec<String>>().join(", ");
    match variants.iter().find(|variant| names(variant) != names(&variants[0])) {
        None => Ok((variants, twice)),
        Some(other) => {
            let [a, b] = [names(&variants[0]), names(other)];
            Err(template
                .fault(&format!("{RUN_ACTION}.args"), format!("tasks give different settings: some {a}, some {b}")))
        }
    }
}

fn group_tasks(tasks: Vec<TaskCommand>) -> (Vec<TaskGroup>, usize) {
    let (mut known, mut groups, mut twice) = (BTreeMap::new(), Vec::<TaskGroup>::new(), 0);
    for task in tasks {
        let key: Vec<(String, String)> = task.changes.iter().map(|c| (c.name().to_owned(), c.text())).collect();
        let next = groups.len();
        let at = *known.entry((key, task.frames.is_some())).or_insert(next);
        let is_new = at == next;
        if is_new {
            let changes = task.changes.into_iter().map(|change| (change.name().to_owned(), change)).collect();
            groups.push(TaskGroup { changes, frames: Vec::new() });
        }
        let others = &mut groups[at].frames;
        match task.frames.filter(|frames| !others.contains(frames)) {
            Some(frames) => others.push(frames),
            None => twice += usize::from(!is_new),
        }
    }
    (groups, twice)
}

/// Returns the frames of several tasks as one setting, if they do not overlap and have one step.
fn join_frames(frames: &[Frames]) -> Option<Vec<Frames>> {
    if frames.len() < 2 {
        return Some(frames.to_vec());
    }
    let most = JobSpec::MAX_FRAMES as u32;
    let resolved = frames.iter().map(|frames| frames.resolve(most).ok()).collect::<Option<Vec<_>>>();
    let mut all = resolved?.concat();
    all.sort_unstable();
    let overlap = all.windows(2).any(|pair| pair[0] == pair[1]);
    Frames::from_even_steps(&all).filter(|_| !overlap).map(|frames| vec![frames])
}

/// Returns the names of the settings that differ, the one that changes most slowly first. Settings that change together are in the
/// order of the arguments.
fn axes(template: &Template, variants: &Variants) -> Vec<String> {
    let first = &variants[0];
    let changes_at = |name: &String| variants.iter().position(|changes| changes[name].text() != first[name].text());
    let args: Vec<&str> = template.action().args.iter().flatten().map(|arg| arg.raw()).collect();
    let argument = |name: &str| {
        let flags = [format!("--{name}"), format!("--set={name}="), format!("{name}=")];
        args.iter().position(|arg| flags.iter().any(|flag| arg.starts_with(flag)))
    };
    let mut found: Vec<(usize, &String)> = first.keys().filter_map(|name| Some((changes_at(name)?, name))).collect();
    found.sort_by_key(|(at, name)| (Reverse(*at), argument(name)));
    found.into_iter().map(|(_, name)| name.clone()).collect()
}

fn heading_lines(template: &Template) -> Vec<String> {
    let mut lines = vec![format!("{}, from the Open Job Description template {}", template.job.name, template.file())];
    lines.extend(template.job.description.iter().flat_map(|text| text.lines()).map(str::to_owned));
    lines.iter().map(|line| format!("# {}", line.replace(char::is_control, " "))).collect()
}

/// Returns the lines of the settings that all variants have in common.
fn settings_lines(
    changes: &BTreeMap<String, Change>,
    axes: &[String],
    execution: &ExecutionSettings,
    tags: &[String],
) -> Vec<String> {
    let mut lines = Vec::new();
    if !tags.is_empty() {
        lines.push(format!("tags = [{}]", tags.iter().map(|tag| quoted(tag)).collect::<Vec<_>>().join(", ")));
    }
    lines.extend(execution.workers.map(|n| format!("workers = {n}")));
    lines.extend(execution.threads.map(|n| format!("threads = {n}")));
    lines.extend(execution.stats.map(|stats| match stats {
        StatsMode::Some => "stats = true".to_owned(),
        StatsMode::Full => "stats = \"full\"".to_owned(),
    }));
    let same = || changes.values().filter(|change| !axes.iter().any(|axis| axis == change.name()));
    let is_scalar = |change: &&Change| matches!(change, Change::Scalar(_));
    lines.extend(same().filter(|c| !is_scalar(c)).map(|change| format!("{} = {}", change.name(), value(change))));
    let scalars: Vec<&Change> = same().filter(is_scalar).collect();
    if !scalars.is_empty() {
        lines.push("[set]".to_owned());
    }
    lines.extend(scalars.into_iter().map(|change| format!("{} = {}", quoted(change.name()), value(change))));
    lines
}

/// Returns the lines of the sweep: all combinations (grid) if the variants are exactly those, else value by value (zip).
fn sweep_lines(variants: &Variants, axes: &[String]) -> Vec<String> {
    if axes.is_empty() {
        return Vec::new();
    }
    let column = |axis: &String| -> Vec<String> { variants.iter().map(|changes| value(&changes[axis])).collect() };
    let distinct = |axis: &String| {
        let mut seen = BTreeSet::new();
        column(axis).into_iter().filter(|value| seen.insert(value.clone())).collect::<Vec<String>>()
    };
    // Variants are distinct, so equal numbers of variants and combinations mean that all combinations are there.
    let combinations = axes.iter().try_fold(1usize, |count, axis| count.checked_mul(distinct(axis).len()));
    let is_grid = combinations == Some(variants.len());
    let mut lines = vec!["[sweep]".to_owned()];
    if !is_grid {
        lines.push("mode = \"zip\"".to_owned());
    }
    for axis in axes {
        let values = if is_grid { distinct(axis) } else { column(axis) };
        let is_scalar = matches!(variants[0][axis], Change::Scalar(_));
        let name = if is_scalar { quoted(axis) } else { axis.clone() };
        lines.push(format!("{name} = [{}]", values.join(", ")));
    }
    lines
}

/// Returns the tags, and lines about requirements that are not tags.
fn tags(template: &Template) -> (Vec<String>, Vec<String>) {
    let Some(HostRequirements { amounts, attributes }) = &template.job.steps[0].host_requirements else {
        return (Vec::new(), Vec::new());
    };
    let (mut tags, mut lost) = (Vec::new(), Vec::new());
    let at = "steps.0.hostRequirements";
    let why = format!("is left out: only tags select workers (attribute `{TAGS}`, allOf)");
    for (n, attribute) in attributes.iter().flatten().enumerate() {
        match (&attribute.any_of, &attribute.all_of) {
            (None, Some(all)) if attribute.name.eq_ignore_ascii_case(TAGS) => tags.extend(all.iter().cloned()),
            _ => lost.push(template.line_about(&format!("{at}.attributes.{n}"), &why)),
        }
    }
    lost.extend((0..amounts.iter().flatten().count()).map(|n| template.line_about(&format!("{at}.amounts.{n}"), &why)));
    (tags, lost)
}

/// Formats a value as TOML.
fn value(change: &Change) -> String {
    match change.as_number() {
        Some(_) if !matches!(change, Change::Time(_)) => change.text(),
        _ => quoted(&change.text()),
    }
}

fn quoted(text: &str) -> String {
    toml::Value::String(text.to_owned()).to_string()
}
