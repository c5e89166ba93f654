//! Faults of a scene: errors, probable mistakes (warnings), and remarks (notes).
//!
//! Every check is sound in one direction: a warning names something that can be seen in the description itself and never guesses
//! about a picture. Geometry is checked at the start of the clip. The list is sorted by location in the files, then by kind and
//! text.

mod animation;
mod cameras;
mod closed;
mod coplanar;
mod faces;
mod hidden_lamps;
mod light_paths;
mod lights;
mod materials;
mod media;
mod names;
mod nested_media;
mod overlap;

use crate::description::{Location, Scene};
use crate::world::Scope;
use serde::Serialize;
use std::fmt;

/// Severity of a fault.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Severity {
    /// The scene cannot be rendered as it stands.
    Error,
    /// Probably a mistake.
    Warning,
    /// Worth knowing, but not a mistake.
    Note,
}

impl fmt::Display for Severity {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Error => "error",
            Self::Warning => "warning",
            Self::Note => "note",
        })
    }
}

/// Kind of fault.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum FaultKind {
    /// A surface without area.
    DegenerateSurface,
    /// A face whose corners do not lie in one plane.
    NonPlanarFace,
    /// Surfaces that overlap in one plane.
    OverlappingFaces,
    /// A name that is defined but never used.
    UnusedName,
    /// Two definitions of one name.
    DuplicateName,
    /// A selector that matches nothing, or that sets an impossible value.
    BadSelector,
    /// A material that reflects and transmits more light than it receives.
    EnergyGain,
    /// A color with a negative channel.
    OutOfGamut,
    /// A medium that is not placed, or whose region has no volume.
    MediumWithoutBounds,
    /// Media nested deeper than a path can track.
    NestedMedia,
    /// A medium too thick to see through, or too thin to see.
    OpticalDepth,
    /// A boundary of a solid or a medium that has holes.
    OpenBoundary,
    /// A light that lights nothing.
    LightsNothing,
    /// A one-sided wall whose back lets light through.
    OneSidedWall,
    /// A closed scene that no light leaves.
    EnergyTrap,
    /// A size or an emittance far from any real value.
    Scale,
    /// A camera that is missing, or that cannot see.
    Camera,
    /// Motion that cannot be followed.
    Animation,
    /// A check that was cut short.
    Incomplete,
}

/// A fault of a scene.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct SceneFault {
    /// Severity. Only an error prevents rendering.
    pub severity: Severity,
    /// Kind of fault.
    pub kind: FaultKind,
    /// Location. Line 1 of the scene file stands for the scene as a whole.
    pub location: Location,
    /// Description of the fault.
    pub message: String,
    /// Advice on how to fix it.
    pub advice: String,
}

impl SceneFault {
    /// Formats the fault as `file:line: warning: message; advice`.
    pub fn display<'a>(&'a self, scene: &'a Scene) -> impl fmt::Display + 'a {
        DisplayFault { fault: self, scene }
    }
}

struct DisplayFault<'a> {
    fault: &'a SceneFault,
    scene: &'a Scene,
}

impl fmt::Display for DisplayFault<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let SceneFault { severity, location, message, advice, .. } = self.fault;
        write!(f, "{}: {severity}: {message}; {advice}", format_location(self.scene, *location))
    }
}

/// Formats a location as `file:line`.
fn format_location(scene: &Scene, location: Location) -> String {
    let file = scene.files.get(location.file as usize).map_or("scene", String::as_str);
    format!("{file}:{}", location.line)
}

/// Location of the scene as a whole.
const WHOLE_SCENE: Location = Location { file: 0, line: 1, column: 0 };

/// Faults found so far.
#[derive(Default)]
struct Faults(Vec<SceneFault>);

impl Faults {
    fn add(
        &mut self,
        severity: Severity,
        kind: FaultKind,
        location: Location,
        message: impl Into<String>,
        advice: impl Into<String>,
    ) {
        self.0.push(SceneFault { severity, kind, location, message: message.into(), advice: advice.into() });
    }
}

/// Returns all faults of a scene, sorted by location, kind and text. Takes O(n log n) in the number of placed triangles. At most
/// the first million triangles are checked; a note says so if there are more.
pub fn check_scene(scene: &Scene) -> Vec<SceneFault> {
    let mut faults = Faults::default();
    let scope = Scope::new(scene);
    for part in [
        names::check,
        animation::check,
        cameras::check,
        materials::check,
        media::check,
        nested_media::check,
        lights::check,
        faces::check,
        overlap::check,
        closed::check,
        light_paths::check,
        hidden_lamps::check,
    ] {
        part(&scope, &mut faults);
    }
    sorted_faults(faults)
}

/// Returns the lamps whose light no path finds: a subset of the faults of [`check_scene`], in the same order.
pub fn lamps_without_light(scene: &Scene) -> Vec<SceneFault> {
    let mut faults = Faults::default();
    let scope = Scope::new(scene);
    lights::covered_lamps(&scope, &mut faults);
    hidden_lamps::check(&scope, &mut faults);
    sorted_faults(faults)
}

fn sorted_faults(faults: Faults) -> Vec<SceneFault> {
    let mut faults = faults.0;
    faults.sort_by(|a, b| key(a).cmp(&key(b)));
    faults.dedup();
    faults
}

fn key(fault: &SceneFault) -> (Location, FaultKind, &str) {
    (fault.location, fault.kind, &fault.message)
}
