//! Faults of the import and of the scene, merged into one list in the order of their locations.

use crate::output::faults::{IMPORT, Line};
use crate::request::{line_of, shown};
use femc_import::{ImportError, Loaded, Oddity, ScenePath, Warning};
use femc_scene::check::{Fault, FaultKind, Severity, check};
use femc_scene::{Location, Scene};

/// Returns the line for an error of a scene that cannot be imported.
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

/// Returns the warnings and notes of the import and the faults of the scene, in the order of their locations. A warning that
/// repeats a fault is left out.
pub fn lines(root: &ScenePath, loaded: &Loaded) -> Vec<Line> {
    let scene: &Scene = &loaded.scene;
    let faults = check(scene);
    let index = |file: &str| scene.files.iter().position(|name| name == file).unwrap_or(usize::MAX);
    let mut keyed: Vec<((usize, u32), Line)> = Vec::new();
    let warnings = loaded.warnings.iter().map(|warning| (Severity::Warning, warning));
    let notes = loaded.notes.iter().map(|note| (Severity::Note, note));
    for (severity, warning) in warnings.chain(notes) {
        let Warning { at, oddity } = warning;
        let place = (index(&at.file), at.line);
        let same = same_as(oddity);
        let again = |fault: &Fault| {
            let Location { file, line, .. } = fault.location;
            (file as usize, line) == place && Some(fault.kind) == same
        };
        if !faults.iter().any(again) {
            keyed.push((place, line_of(root, warning, severity)));
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

/// Returns the fault of a scene that reports the same problem as a warning of the import.
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
        | Oddity::ObjectAgain { .. }
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

/// Returns the name of a kind as in JSON.
fn kebab(kind: FaultKind) -> String {
    serde_json::to_value(kind).ok().and_then(|name| name.as_str().map(str::to_owned)).unwrap_or_default()
}
