//! A checked template with bound parameters, and the command lines of its tasks.

use super::positions::{PositionMap, to_position};
use crate::values::TextPosition;
use openjd_expr::{ExprValue, FormatStringOptions, PathFormat};
use openjd_model::job::{Action, Job};
use openjd_model::template::JobTemplate;
use openjd_model::{
    CallerLimits, DocumentType, JobParameterInputValues, JobParameterType, JobParameterValues, ModelError, PathElement,
    PathParameterOptions, StepParameterSpaceIterator, SymbolTable, TaskParameterSet, build_symbol_table, create_job,
    decode_job_template, preprocess_job_parameters,
};
use std::path::{Path, PathBuf};

/// Largest number of tasks.
const MAX_TASKS: u64 = 1 << 20;
/// Supported extensions of the specification.
const EXTENSIONS: [&str; 4] = ["TASK_CHUNKING", "EXPR", "FEATURE_BUNDLE_1", "REDACTED_ENV_VARS"];

/// An error of a file that is not a template, or not a sweep.
#[derive(Debug, thiserror::Error)]
pub enum TemplateError {
    /// The file cannot be read.
    #[error("{}: {cause}", path.display())]
    Read {
        /// File of the template.
        path: PathBuf,
        /// Error of the system.
        cause: std::io::Error,
    },
    /// The template violates the specification, or cannot be used here.
    #[error("{}", faults.join("\n"))]
    Faults {
        /// Faults, one line each: file, line, column, part, description.
        faults: Vec<String>,
    },
}

/// A job template whose parameters have values.
#[derive(Debug)]
pub struct Template {
    path: PathBuf,
    positions: PositionMap,
    /// Template as written.
    pub source: JobTemplate,
    /// Job with values for the parameters.
    pub job: Job,
    values: JobParameterValues,
}

/// Parses the path of a part of a template, names and numbers separated by points: `steps.0.script`.
pub fn parse_path(path: &str) -> Vec<PathElement> {
    let element = |part: &str| match part.parse() {
        Ok(index) => PathElement::Index(index),
        Err(_) => PathElement::Field(part.to_owned()),
    };
    path.split('.').filter(|part| !part.is_empty()).map(element).collect()
}

impl Template {
    /// Reads and checks the file `path`; `given`: values of parameters by name.
    pub fn open(path: &Path, given: &[(String, String)]) -> Result<Self, TemplateError> {
        let read = |cause| TemplateError::Read { path: path.to_owned(), cause };
        Self::parse(path, &std::fs::read_to_string(path).map_err(read)?, given)
    }

    /// Parses and checks the template in `text`; `path`: its file.
    pub fn parse(path: &Path, text: &str, given: &[(String, String)]) -> Result<Self, TemplateError> {
        let positions = PositionMap::parse(text);
        let limits = CallerLimits { max_task_count: Some(MAX_TASKS), ..CallerLimits::default() };
        let form = match path.extension() {
            Some(extension) if extension == "json" => DocumentType::Json,
            _ => DocumentType::Yaml,
        };
        let bound = || {
            let document = openjd_model::template::parse::document_string_to_object(text, form, &limits)?;
            let source = decode_job_template(document, Some(&EXTENSIONS), &limits)?;
            let folder = super::file_paths::absolute(path.parent().unwrap_or(Path::new("")), Path::new(""));
            let here = super::file_paths::absolute(Path::new(""), Path::new(""));
            let (folder, here) = (folder.to_string_lossy(), here.to_string_lossy());
            let options =
                PathParameterOptions { allow_template_dir_walk_up: true, ..PathParameterOptions::new(&folder, &here) };
            let given = given.iter().map(|(name, value)| (name.clone(), ExprValue::String(value.clone())));
            let values = preprocess_job_parameters(&source, &JobParameterInputValues::from_iter(given), &[], &options)?;
            let context = source.default_validation_context().with_caller_limits(limits.clone());
            let job = create_job(&source, &values, &context)?;
            Ok((source, job, values))
        };
        match bound() {
            Ok((source, job, values)) => Ok(Self { path: path.to_owned(), positions, source, job, values }),
            Err(error) => Err(TemplateError::Faults { faults: faults(path, text, &positions, &error) }),
        }
    }

    /// Returns the folder of the template.
    pub fn folder(&self) -> &Path {
        self.path.parent().unwrap_or(Path::new(""))
    }

    /// Returns the file's name.
    pub fn file(&self) -> String {
        self.path.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default()
    }

    /// Returns a line about a part of the template: file, line, column, part, `message`.
    pub fn line_about(&self, at: &str, message: impl std::fmt::Display) -> String {
        let at = parse_path(at);
        line_about(&self.path, self.positions.find(&at), &at, message)
    }

    /// Returns an error about a part of the template.
    pub fn fault(&self, at: &str, message: impl std::fmt::Display) -> TemplateError {
        TemplateError::Faults { faults: vec![self.line_about(at, message)] }
    }

    /// Returns the action of the first step.
    pub fn action(&self) -> &Action {
        &self.job.steps[0].script.actions.on_run
    }

    /// Returns the command line of each task of the first step, in the order of its parameter space.
    pub fn command_lines(&self) -> Result<Vec<Vec<String>>, TemplateError> {
        let spaced = |error: ModelError| self.fault("steps.0.parameterSpace", one_line(&error.to_string()));
        let tasks: Vec<TaskParameterSet> = match &self.job.steps[0].parameter_space {
            Some(space) => StepParameterSpaceIterator::new(space).map_err(spaced)?.collect(),
            None => vec![TaskParameterSet::new()],
        };
        let job = self.symbols().map_err(|error| self.fault("parameterDefinitions", one_line(&error.to_string())))?;
        tasks.iter().map(|task| self.command_line(&job, task)).collect()
    }

    /// Returns the symbols that format strings may use, without the task's own parameters.
    fn symbols(&self) -> Result<SymbolTable, ModelError> {
        let mut symbols = build_symbol_table(&self.values)?;
        for (name, value) in self.values.iter().filter(|(_, value)| value.param_type == JobParameterType::Path) {
            symbols.set(&format!("Param.{name}"), value.value.clone())?;
        }
        symbols.set("Job.Name", ExprValue::String(self.job.name.clone()))?;
        symbols.set("Step.Name", ExprValue::String(self.job.steps[0].name.clone()))?;
        Ok(symbols)
    }

    fn command_line(&self, job: &SymbolTable, task: &TaskParameterSet) -> Result<Vec<String>, TemplateError> {
        let mut symbols = job.clone();
        for (name, value) in task {
            for of in ["Param", "RawParam"] {
                let set = symbols.set(&format!("Task.{of}.{name}"), value.value.clone());
                set.map_err(|error| self.fault("steps.0.parameterSpace", error))?;
            }
        }
        let action = self.action();
        let words = [("command".to_owned(), &action.command)].into_iter();
        let words = words.chain(action.args.iter().flatten().enumerate().map(|(n, arg)| (format!("args.{n}"), arg)));
        let options = FormatStringOptions::new().with_path_format(PathFormat::host());
        let mut line = Vec::new();
        for (at, word) in words {
            let value = word.resolve_with(&symbols, &options);
            let unknown = |error: &dyn std::fmt::Display| {
                self.fault(&format!("steps.0.script.actions.onRun.{at}"), one_line(&error.to_string()))
            };
            match value.map_err(|error| unknown(&error))? {
                ExprValue::Null => {}
                ExprValue::ListString(words, _) => line.extend(words),
                other => line.push(other.to_display_string()),
            }
        }
        Ok(line)
    }
}

/// Returns the faults of a template, one per line.
fn faults(path: &Path, text: &str, positions: &PositionMap, error: &ModelError) -> Vec<String> {
    match error {
        ModelError::ModelValidation(all) => {
            let line = |fault: &openjd_model::ValidationError| {
                let what = fault.detail.as_ref().map_or(&fault.message, |detail| &detail.summary);
                line_about(path, positions.find(&fault.path), &fault.path, one_line(what))
            };
            all.errors.iter().map(line).collect()
        }
        other => {
            // The error for a malformed template has no location; parsing the text once more yields one.
            let again = serde_saphyr::from_str::<JobTemplate>(text).err();
            vec![line_about(
                path,
                again.and_then(|error| to_position(error.location()?)),
                &[],
                one_line(&plain_message(other)),
            )]
        }
    }
}

/// Returns the message without the name of the error kind.
fn plain_message(error: &ModelError) -> String {
    match error {
        ModelError::DecodeValidation(what) | ModelError::Compatibility(what) | ModelError::UnsupportedSchema(what) => {
            what.clone()
        }
        other => other.to_string(),
    }
}

fn line_about(
    path: &Path,
    position: Option<TextPosition>,
    at: &[PathElement],
    message: impl std::fmt::Display,
) -> String {
    let mut line = path.display().to_string();
    if let Some(TextPosition { line: row, column }) = position {
        line.push_str(&format!(":{row}:{column}"));
    }
    let mut pointer = String::new();
    for element in at {
        match element {
            PathElement::Field(name) if pointer.is_empty() => pointer.push_str(name),
            PathElement::Field(name) => pointer.push_str(&format!(".{name}")),
            PathElement::Index(index) => pointer.push_str(&format!("[{index}]")),
        }
    }
    let gap = if pointer.is_empty() { "" } else { ": " };
    format!("{line}: {pointer}{gap}{message}")
}

/// Returns the first line of a message, which is complete. Further lines only quote the source.
fn one_line(message: &str) -> String {
    message.lines().map(str::trim).find(|line| !line.is_empty()).unwrap_or_default().to_owned()
}
