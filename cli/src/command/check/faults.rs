//! Faults of the import and of the scene, merged into one list in the order of their locations.

use crate::output::faults::{FaultLine, IMPORT};
use crate::request::{warning_line, with_root_prefix};
use femc_import::{ImportError, LoadedScene, ScenePath, Warning, WarningKind};
use femc_scene::check::{FaultKind, SceneFault, Severity, check_scene};
use femc_scene::{Location, Scene};

/// Returns the line for an error of a scene that cannot be imported.
pub fn import_error_line(root: &ScenePath, ImportError { at, fault }: &ImportError) -> FaultLine {
    FaultLine {
        severity: Severity::Error,
        kind: IMPORT.to_owned(),
        file: with_root_prefix(root, &at.file),
        line: at.line,
        column: Some(at.column).filter(|&column| column > 0),
        message: fault.to_string(),
        advice: String::new(),
    }
}

/// Returns the warnings and notes of the import and the faults of the scene, in the order of their locations. A warning that
/// repeats a fault is left out.
pub fn fault_lines(root: &ScenePath, loaded: &LoadedScene) -> Vec<FaultLine> {
    let scene: &Scene = &loaded.scene;
    let faults = check_scene(scene);
    let index = |file: &str| scene.files.iter().position(|name| name == file).unwrap_or(usize::MAX);
    let mut keyed: Vec<((usize, u32), FaultLine)> = Vec::new();
    let warnings = loaded.warnings.iter().map(|warning| (Severity::Warning, warning));
    let notes = loaded.notes.iter().map(|note| (Severity::Note, note));
    for (severity, warning) in warnings.chain(notes) {
        let Warning { at, kind: oddity } = warning;
        let place = (index(&at.file), at.line);
        let same = equivalent_fault(oddity);
        let again = |fault: &SceneFault| {
            let Location { file, line, .. } = fault.location;
            (file as usize, line) == place && Some(fault.kind) == same
        };
        if !faults.iter().any(again) {
            keyed.push((place, warning_line(root, warning, severity)));
        }
    }
    for SceneFault { severity, kind, location, message, advice } in faults {
        let file = scene.files.get(location.file as usize).map_or("", String::as_str);
        let (kind, file, line, column) = (kind_name(kind), with_root_prefix(root, file), location.line, None);
        let line = FaultLine { severity, kind, file, line, column, message, advice };
        keyed.push(((location.file as usize, location.line), line));
    }
    keyed.sort_by_key(|(place, _)| *place);
    keyed.into_iter().map(|(_, line)| line).collect()
}

/// Returns the fault of a scene that reports the same problem as a warning of the import.
fn equivalent_fault(warning_kind: &WarningKind) -> Option<FaultKind> {
    match warning_kind {
        WarningKind::NoArea => Some(FaultKind::DegenerateSurface),
        WarningKind::NotPlanar { .. } => Some(FaultKind::NonPlanarFace),
        WarningKind::OutOfGamut => Some(FaultKind::OutOfGamut),
        WarningKind::ChannelAboveOne { .. } => Some(FaultKind::EnergyGain),
        WarningKind::DefinitionReplaced { .. } => Some(FaultKind::DuplicateName),
        WarningKind::UnknownEntity { .. }
        | WarningKind::CrossesItself
        | WarningKind::HoleOrientation
        | WarningKind::ObjectReopened { .. }
        | WarningKind::LeftOpen { .. }
        | WarningKind::NotTransformed { .. }
        | WarningKind::Photometry { .. }
        | WarningKind::TooBright { .. }
        | WarningKind::NoTextureCoordinates { .. }
        | WarningKind::NegativeSpectrum { .. }
        | WarningKind::NoLuminance { .. }
        | WarningKind::OutsideFolder { .. }
        | WarningKind::DefaultCamera { .. }
        | WarningKind::Texture { .. }
        | WarningKind::TooManyWarnings { .. } => None,
    }
}

/// Returns the name of a kind as in JSON.
fn kind_name(kind: FaultKind) -> String {
    serde_json::to_value(kind).ok().and_then(|name| name.as_str().map(str::to_owned)).unwrap_or_default()
}
