//! Faults of the import and of the scene: one list, in order of place, and by kinds.

use crate::output::{Say, human};
use crate::request::shown;
use femc_import::{ImportError, Loaded, Oddity, ScenePath, Warning};
use femc_scene::check::{Fault, FaultKind, Severity, check};
use femc_scene::{Location, Scene};
use serde::Serialize;

/// Places that a line names besides the first.
const PLACES: usize = 3;

/// A fault.
#[derive(Serialize)]
pub struct Line {
    /// How bad.
    pub severity: Severity,
    /// Kind, in the words of `--json`.
    pub kind: String,
    /// File, as it is reached from here.
    pub file: String,
    /// Line, from 1; 0: the file as a whole.
    pub line: u32,
    /// Column of an error of the import, from 1.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub column: Option<u32>,
    /// What is wrong.
    pub message: String,
    /// What to do about it.
    #[serde(skip_serializing_if = "String::is_empty")]
    pub advice: String,
}

impl Line {
    fn place(&self) -> String {
        match (self.line, self.column) {
            (0, _) => self.file.clone(),
            (line, None) => format!("{}:{line}", self.file),
            (line, Some(column)) => format!("{}:{line}:{column}", self.file),
        }
    }
}

/// Faults of one severity and kind.
#[derive(Serialize)]
pub struct Kind {
    /// How bad.
    pub severity: Severity,
    /// Kind.
    pub kind: String,
    /// How many.
    pub count: usize,
    /// The first places, `file:line`.
    pub places: Vec<String>,
}

/// Kind of the errors of a scene that cannot be imported.
const IMPORT: &str = "import";

/// An error of a scene that cannot be imported.
pub fn unreadable(root: &ScenePath, ImportError { at, fault }: &ImportError) -> Line {
    Line {
        severity: Severity::Error,
        kind: IMPORT.to_owned(),
        file: shown(root, &at.file),
        line: at.line,
        column: Some(at.column).filter(|&column| column > 0),
        message: fault.to_string(),
        advice: String::new(),
    }
}

/// Warnings and notes of the import and faults of the scene, in order of place; what two of them say is said once.
pub fn lines(root: &ScenePath, loaded: &Loaded) -> Vec<Line> {
    let scene: &Scene = &loaded.scene;
    let faults = check(scene);
    let index = |file: &str| scene.files.iter().position(|name| name == file).unwrap_or(usize::MAX);
    let mut keyed: Vec<((usize, u32), Line)> = Vec::new();
    let warnings = loaded.warnings.iter().map(|warning| (Severity::Warning, warning));
    let notes = loaded.notes.iter().map(|note| (Severity::Note, note));
    for (severity, Warning { at, oddity }) in warnings.chain(notes) {
        let place = (index(&at.file), at.line);
        let same = same_as(oddity);
        let again = |fault: &Fault| {
            let Location { file, line, .. } = fault.location;
            (file as usize, line) == place && Some(fault.kind) == same
        };
        if !faults.iter().any(again) {
            let (kind, file) = (oddity.kind().to_owned(), shown(root, &at.file));
            let (line, message, advice) = (at.line, oddity.to_string(), String::new());
            let line = Line { severity, kind, file, line, column: None, message, advice };
            keyed.push((place, line));
        }
    }
    for Fault { severity, kind, location, message, advice } in faults {
        let file = scene.files.get(location.file as usize).map_or("", String::as_str);
        let (kind, file, line, column) = (kebab(kind), shown(root, file), location.line, None);
        let line = Line { severity, kind, file, line, column, message, advice };
        keyed.push(((location.file as usize, location.line), line));
    }
    keyed.sort_by_key(|(place, _)| *place);
    keyed.into_iter().map(|(_, line)| line).collect()
}

/// The fault of a scene that says the same as a warning of the import.
fn same_as(oddity: &Oddity) -> Option<FaultKind> {
    match oddity {
        Oddity::NoArea => Some(FaultKind::DegenerateSurface),
        Oddity::NotPlanar { .. } => Some(FaultKind::NonPlanarFace),
        Oddity::OutOfGamut => Some(FaultKind::OutOfGamut),
        Oddity::ChannelAboveOne { .. } => Some(FaultKind::EnergyGain),
        Oddity::Replaced { .. } => Some(FaultKind::DuplicateName),
        Oddity::UnknownEntity { .. }
        | Oddity::CrossesItself
        | Oddity::HoleOrientation
        | Oddity::LeftOpen { .. }
        | Oddity::NotTransformed { .. }
        | Oddity::Photometry { .. }
        | Oddity::TooBright { .. }
        | Oddity::NoTextureCoordinates { .. }
        | Oddity::NegativeSpectrum { .. }
        | Oddity::NoLuminance { .. }
        | Oddity::OutsideFolder { .. }
        | Oddity::DefaultCamera { .. }
        | Oddity::Texture { .. }
        | Oddity::More { .. } => None,
    }
}

/// The name of a kind as in JSON.
fn kebab(kind: FaultKind) -> String {
    serde_json::to_value(kind).ok().and_then(|name| name.as_str().map(str::to_owned)).unwrap_or_default()
}

/// The lines of each severity and kind, errors first, else in order of their first places.
fn groups(lines: &[Line]) -> Vec<Vec<&Line>> {
    let mut groups: Vec<Vec<&Line>> = Vec::new();
    for line in lines {
        match groups.iter_mut().find(|group| (group[0].severity, &group[0].kind) == (line.severity, &line.kind)) {
            Some(group) => group.push(line),
            None => groups.push(vec![line]),
        }
    }
    groups.sort_by_key(|group| group[0].severity);
    groups
}

/// The kinds, with counts and first places.
pub fn kinds(lines: &[Line]) -> Vec<Kind> {
    let kind = |group: Vec<&Line>| Kind {
        severity: group[0].severity,
        kind: group[0].kind.clone(),
        count: group.len(),
        places: group.iter().take(1 + PLACES).map(|line| line.place()).collect(),
    };
    groups(lines).into_iter().map(kind).collect()
}

/// A line for each kind; or for each fault, where all are wanted.
pub fn print(say: Say, lines: &[Line], all: bool) {
    // Each error of the import is a fault of its own.
    let each = all || lines.iter().any(|line| line.kind == IMPORT);
    let groups = if each { lines.iter().map(|line| vec![line]).collect() } else { groups(lines) };
    for group in groups {
        let Line { severity, kind, message, advice, .. } = group[0];
        if say.quiet() && *severity != Severity::Error {
            continue;
        }
        let label = severity.to_string();
        let label = match severity {
            Severity::Error => say.bad(&label),
            Severity::Warning => say.doubtful(&label),
            Severity::Note => label,
        };
        let advice = if advice.is_empty() { String::new() } else { format!("; {advice}") };
        let times = if group.len() > 1 { format!("{} ({kind}), the first: ", group.len()) } else { String::new() };
        say.result(format!("{}: {label}: {times}{message}{advice}{}", group[0].place(), others(&group)));
    }
}

/// Places of a kind besides the first.
fn others(group: &[&Line]) -> String {
    let mut places: Vec<String> = group.iter().map(|line| line.place()).collect();
    places.dedup();
    let named = places.iter().skip(1).take(PLACES).cloned().collect::<Vec<_>>().join(", ");
    match places.len().saturating_sub(1 + PLACES) {
        _ if named.is_empty() => String::new(),
        0 => format!(" (also at {named})"),
        more => format!(" (also at {named} and {}; --all lists them)", human::count(more as u64, "more place")),
    }
}
