//! Contents of a scene: its bounds, its lamps and their luminous flux.

use crate::output::{Printer, human};
use crate::request::{luminous_flux, with_root_prefix};
use femc_import::ScenePath;
use femc_scene::{LampKind, Scene, survey_scene};
use serde::Serialize;

/// Largest number of lamp lines in the table.
const MAX_LISTED_LAMPS: usize = 20;

/// The contents of a scene in numbers.
#[derive(Default, Serialize)]
pub struct Contents {
    bounds: Option<Bounds>,
    /// Luminous flux of all lamps, lm.
    lumens: f64,
    lamps: Vec<LampGroup>,
}

/// The bounding box, m.
#[derive(Serialize)]
struct Bounds {
    min: [f64; 3],
    max: [f64; 3],
}

/// A group of equal lamps.
#[derive(Serialize)]
struct LampGroup {
    kind: &'static str,
    name: String,
    count: u64,
    /// Flux of each lamp, lm.
    lumens: f64,
    /// Emitting area of each lamp, m2.
    #[serde(skip_serializing_if = "Option::is_none")]
    area: Option<f64>,
    file: String,
    line: u32,
}

impl Contents {
    /// Measures a scene at the start of its clip.
    pub fn from_scene(scene: &Scene, root: &ScenePath) -> Self {
        let survey = survey_scene(scene, &luminous_flux);
        let lamps = survey.lamps.into_iter().map(|lamp| {
            let (kind, name) = match lamp.kind {
                LampKind::Surface { material } => ("material", material),
                LampKind::Luminaire { path } => ("ies", path),
                LampKind::Medium { medium } => ("medium", medium),
            };
            let file = scene.files.get(lamp.location.file as usize).map_or("", String::as_str);
            LampGroup {
                kind,
                name,
                count: lamp.count,
                lumens: lamp.lumens,
                area: lamp.area,
                file: with_root_prefix(root, file),
                line: lamp.location.line,
            }
        });
        let lamps: Vec<LampGroup> = lamps.collect();
        let bounds = survey.bounds.map(|[min, max]| Bounds { min: min.to_array(), max: max.to_array() });
        Self { bounds, lumens: lamps.iter().map(|lamp| lamp.count as f64 * lamp.lumens).sum(), lamps }
    }

    /// Prints the contents for people.
    pub fn print(&self, printer: Printer) {
        if let Some(Bounds { min, max }) = self.bounds {
            let size = [0, 1, 2].map(|i| meters(max[i] - min[i])).join(" x ");
            let point = |p: [f64; 3]| p.map(meters).join(" ");
            printer.result(format!("bounds: {size} m, from {} to {}", point(min), point(max)));
        }
        if self.lamps.is_empty() {
            printer.result("lamps: none");
            return;
        }
        let count: u64 = self.lamps.iter().map(|lamp| lamp.count).sum();
        printer.result(format!("lamps: {count}, {} lm in all", lumens(self.lumens)));
        let row = |lamp: &LampGroup| {
            let name = if lamp.name.is_empty() { "(unnamed)" } else { &lamp.name };
            let area = lamp.area.map_or(String::new(), |area| format!("{area:.4}"));
            let place = format!("{}:{}", lamp.file, lamp.line);
            vec![lamp.count.to_string(), lumens(lamp.lumens), area, format!("{} {name}", lamp.kind), place]
        };
        let rows: Vec<Vec<String>> = self.lamps.iter().take(MAX_LISTED_LAMPS).map(row).collect();
        printer.result(human::table(&["count", "lm each", "m2 each", "lamp", "first at"], &rows));
        if let more @ 1.. = self.lamps.len().saturating_sub(MAX_LISTED_LAMPS) {
            printer.result(format!("and {} (--json lists all)", human::counted_noun(more as u64, "more kind")));
        }
    }
}

/// Formats a length without meaningless decimals.
fn meters(m: f64) -> String {
    let text = format!("{m:.3}");
    let text = text.trim_end_matches('0').trim_end_matches('.');
    if text == "-0" { "0".to_owned() } else { text.to_owned() }
}

fn lumens(lm: f64) -> String {
    if lm < 100.0 { format!("{lm:.3}") } else { format!("{lm:.0}") }
}
