//! Faults of a scene, one by one and by kind, with the same text in `femc check` and before a render.

use super::{Printer, human};
use femc_scene::check::Severity;
use serde::Serialize;

/// Number of locations that a line names besides the first.
const MAX_LOCATIONS: usize = 3;

/// Kind of the errors of a scene that cannot be imported.
pub const IMPORT: &str = "import";

/// A fault.
#[derive(Serialize)]
pub struct FaultLine {
    /// Severity.
    pub severity: Severity,
    /// Kind, in the words of `--json`.
    pub kind: String,
    /// File, as reached from the current folder.
    pub file: String,
    /// Line, from 1; 0: the file as a whole.
    pub line: u32,
    /// Column of an error of the import, from 1.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub column: Option<u32>,
    /// Description of the fault.
    pub message: String,
    /// Advice on what to do.
    #[serde(skip_serializing_if = "String::is_empty")]
    pub advice: String,
}

impl FaultLine {
    fn location(&self) -> String {
        match (self.line, self.column) {
            (0, _) => self.file.clone(),
            (line, None) => format!("{}:{line}", self.file),
            (line, Some(column)) => format!("{}:{line}:{column}", self.file),
        }
    }
}

/// Faults of one severity and kind.
#[derive(Serialize)]
pub struct FaultGroup {
    /// Severity.
    pub severity: Severity,
    /// Kind.
    pub kind: String,
    /// Number of faults.
    pub count: usize,
    /// First locations, `file:line`.
    pub places: Vec<String>,
}

/// Groups the lines by severity and kind: errors first, then in the order of their first locations.
fn groups(lines: &[FaultLine]) -> Vec<Vec<&FaultLine>> {
    let mut groups: Vec<Vec<&FaultLine>> = Vec::new();
    for line in lines {
        match groups.iter_mut().find(|group| (group[0].severity, &group[0].kind) == (line.severity, &line.kind)) {
            Some(group) => group.push(line),
            None => groups.push(vec![line]),
        }
    }
    groups.sort_by_key(|group| group[0].severity);
    groups
}

/// Returns the kinds, with counts and first locations.
pub fn kinds(lines: &[FaultLine]) -> Vec<FaultGroup> {
    let kind = |group: Vec<&FaultLine>| FaultGroup {
        severity: group[0].severity,
        kind: group[0].kind.clone(),
        count: group.len(),
        places: group.iter().take(1 + MAX_LOCATIONS).map(|line| line.location()).collect(),
    };
    groups(lines).into_iter().map(kind).collect()
}

/// Choice of the printed lines.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Detail {
    /// A line for each kind.
    Kinds,
    /// A line for each fault.
    All,
}

/// Prints the faults as a list on stdout.
pub fn print(printer: Printer, lines: &[FaultLine], detail: Detail) {
    // Errors of the import all have one kind, so each of them gets a line.
    let detail = if lines.iter().any(|line| line.kind == IMPORT) { Detail::All } else { detail };
    let groups = match detail {
        Detail::All => lines.iter().map(|line| vec![line]).collect(),
        Detail::Kinds => groups(lines),
    };
    for group in groups {
        let severity = group[0].severity;
        if printer.quiet() && severity != Severity::Error {
            continue;
        }
        let label = severity.to_string();
        let label = match severity {
            Severity::Error => printer.style_error(&label),
            Severity::Warning => printer.style_warning(&label),
            Severity::Note => label,
        };
        printer.result(format!("{}: {label}: {}", group[0].location(), group_text(&group, "--all lists them")));
    }
}

/// Prints the faults on stderr before the command continues: a line for each kind.
/// - `scene`: file for the hint to run `femc check`.
pub fn note_faults(printer: Printer, lines: &[FaultLine], scene: &str) {
    let more = format!("`femc check {scene} --all` lists them");
    for group in groups(lines) {
        printer.note(format!("{}: {}: {}", group[0].severity, group[0].location(), group_text(&group, &more)));
    }
}

/// Returns the first fault of a kind, the number of faults, and further locations.
/// - `more`: hint how to list the omitted locations.
fn group_text(group: &[&FaultLine], more: &str) -> String {
    let FaultLine { kind, message, advice, .. } = group[0];
    let advice = if advice.is_empty() { String::new() } else { format!("; {advice}") };
    let times = if group.len() > 1 { format!("{} ({kind}), the first: ", group.len()) } else { String::new() };
    format!("{times}{message}{advice}{}", other_locations(group, more))
}

/// Returns the locations of a kind besides the first.
fn other_locations(group: &[&FaultLine], left_out: &str) -> String {
    let mut places: Vec<String> = group.iter().map(|line| line.location()).collect();
    places.dedup();
    let named = places.iter().skip(1).take(MAX_LOCATIONS).cloned().collect::<Vec<_>>().join(", ");
    match places.len().saturating_sub(1 + MAX_LOCATIONS) {
        _ if named.is_empty() => String::new(),
        0 => format!(" (also at {named})"),
        more => format!(" (also at {named} and {}; {left_out})", human::counted_noun(more as u64, "more place")),
    }
}
