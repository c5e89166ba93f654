//! The written form of a template, of specification 2023-09 without extensions.

use crate::command::openjd::template::TemplateError;
use crate::request::Change;
use crate::values::Frames;
use serde::Serialize;
use std::path::Path;

/// Contents of a template.
pub struct Document {
    /// Name; a format string.
    pub name: String,
    /// Description for people.
    pub description: String,
    /// Parameters of the job.
    pub parameters: Vec<Parameter>,
    /// Parameters of the tasks.
    pub space: Vec<TaskParameter>,
    /// Expression that combines the task parameters.
    pub combination: String,
    /// Program; a format string.
    pub command: String,
    /// Arguments of the program; format strings.
    pub args: Vec<String>,
    /// Attribute that hosts must have.
    pub attributes: Option<HostAttribute>,
}

/// A path parameter that can be set when the template is submitted.
#[derive(Serialize)]
#[serde(rename_all = "camelCase")]
pub struct Parameter {
    name: &'static str,
    r#type: &'static str,
    object_type: &'static str,
    data_flow: &'static str,
    default: String,
    description: &'static str,
}

/// A parameter of tasks and its values.
pub struct TaskParameter {
    /// Name; an identifier.
    pub name: String,
    /// Values, at least one.
    pub range: Range,
}

/// Values of a task parameter.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[serde(untagged)]
pub enum Range {
    /// Whole numbers as a range: `1-24:2`.
    Ints(String),
    /// Whole numbers.
    IntList(Vec<serde_json::Number>),
    /// Numbers, as written.
    Floats(Vec<serde_json::Number>),
    /// Other values as text.
    Texts(Vec<String>),
}

/// An attribute that hosts must have with all these values.
#[derive(Serialize)]
#[serde(rename_all = "camelCase")]
pub struct HostAttribute {
    /// Name of the attribute.
    pub name: &'static str,
    /// Values, at least one.
    pub all_of: Vec<String>,
}

impl Parameter {
    /// Returns the parameter for the scene file.
    pub fn scene(default: String) -> Self {
        let description = "The scene file. On all hosts, the files that it includes must lie beside it.";
        Self { name: "Scene", r#type: "PATH", object_type: "FILE", data_flow: "IN", default, description }
    }

    /// Returns the parameter for the folder of the frames.
    pub fn out(default: String) -> Self {
        let description = "Folder for the frames.";
        Self { name: "Out", r#type: "PATH", object_type: "DIRECTORY", data_flow: "OUT", default, description }
    }
}

impl Range {
    /// Returns the values of an axis: numbers if the specification supports them, else texts.
    pub fn from_changes(changes: &[&Change]) -> Self {
        let numbers = || changes.iter().map(|change| change.text().parse().ok()).collect::<Option<Vec<_>>>();
        let fits = |change: &&&Change| match change {
            Change::Spp(_) | Change::MaxDepth(_) => true,
            Change::Seed(seed) => i64::try_from(*seed).is_ok(),
            _ => false,
        };
        let is_float = |change: &&&Change| matches!(change, Change::Scalar(_) | Change::Error(_));
        let range = match changes {
            all if all.iter().all(|change| fits(&change)) => numbers().map(Self::IntList),
            all if all.iter().all(|change| is_float(&change)) => numbers().map(Self::Floats),
            _ => None,
        };
        range.unwrap_or_else(|| Self::Texts(changes.iter().map(|change| change.text()).collect()))
    }

    /// Returns the range of some frames, ascending.
    pub fn from_frames(all: &[u32]) -> Self {
        let whole = || Self::IntList(all.iter().map(|&frame| frame.into()).collect());
        Frames::from_even_steps(all)
            .map_or_else(whole, |frames| Self::Ints(frames.to_string().replace("..", "-").replace('+', ":")))
    }

    fn kind(&self) -> &'static str {
        match self {
            Self::Ints(_) | Self::IntList(_) => "INT",
            Self::Floats(_) => "FLOAT",
            Self::Texts(_) => "STRING",
        }
    }
}

#[derive(Serialize)]
#[serde(rename_all = "camelCase")]
struct TemplateDocument<'a> {
    specification_version: &'static str,
    name: &'a str,
    description: &'a str,
    parameter_definitions: &'a [Parameter],
    steps: [Step<'a>; 1],
}

#[derive(Serialize)]
#[serde(rename_all = "camelCase")]
struct Step<'a> {
    name: &'static str,
    parameter_space: Space<'a>,
    #[serde(skip_serializing_if = "Option::is_none")]
    host_requirements: Option<Hosts<'a>>,
    script: Script<'a>,
}

#[derive(Serialize)]
#[serde(rename_all = "camelCase")]
struct Space<'a> {
    task_parameter_definitions: Vec<Definition<'a>>,
    combination: &'a str,
}

#[derive(Serialize)]
struct Definition<'a> {
    name: &'a str,
    r#type: &'static str,
    range: &'a Range,
}

impl<'a> Definition<'a> {
    fn from_parameter(parameter: &'a TaskParameter) -> Self {
        Self { name: &parameter.name, r#type: parameter.range.kind(), range: &parameter.range }
    }
}

#[derive(Serialize)]
struct Hosts<'a> {
    attributes: [&'a HostAttribute; 1],
}

#[derive(Serialize)]
struct Script<'a> {
    actions: Actions<'a>,
}

#[derive(Serialize)]
#[serde(rename_all = "camelCase")]
struct Actions<'a> {
    on_run: Action<'a>,
}

#[derive(Serialize)]
struct Action<'a> {
    command: &'a str,
    args: &'a [String],
}

impl Document {
    /// Writes the template as JSON if `out` ends in `.json`, else as YAML.
    pub fn write(&self, out: &Path) -> Result<String, TemplateError> {
        let whole = TemplateDocument {
            specification_version: "jobtemplate-2023-09",
            name: &self.name,
            description: &self.description,
            parameter_definitions: &self.parameters,
            steps: [Step {
                name: "Render",
                parameter_space: Space {
                    task_parameter_definitions: self.space.iter().map(Definition::from_parameter).collect(),
                    combination: &self.combination,
                },
                host_requirements: self.attributes.as_ref().map(|attribute| Hosts { attributes: [attribute] }),
                script: Script { actions: Actions { on_run: Action { command: &self.command, args: &self.args } } },
            }],
        };
        let unwritable = |error: &dyn std::fmt::Display| TemplateError::Faults {
            faults: vec![format!("{}: cannot be written: {error}", out.display())],
        };
        if out.extension().is_some_and(|extension| extension == "json") {
            return serde_json::to_string_pretty(&whole).map(|text| text + "\n").map_err(|error| unwritable(&error));
        }
        serde_saphyr::to_string(&whole).map_err(|error| unwritable(&error))
    }
}
