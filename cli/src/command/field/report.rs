//! Report on a solution, for people and as JSON.

use crate::output::{Printer, human};
use femc_pipeline::radiosity::{KindCounts, LightTotals, SolveReport};
use serde::Serialize;

/// The report.
#[derive(Serialize)]
pub struct FieldReport {
    /// The scene file.
    pub scene: String,
    /// The frame.
    pub frame: u32,
    /// The solution's file.
    pub out: String,
    /// This report's file.
    pub statistics: String,
    /// Requested largest error of a link.
    pub error: f32,
    /// The solver's time, s.
    pub seconds: f64,
    /// Elements by kind.
    pub elements: ElementCounts,
    /// Elements that are not cut further.
    pub leaves: LeafCounts,
    /// Links.
    pub links: LinkCounts,
    /// Number of links that are less exact than requested.
    pub refused: usize,
    /// Number of visibility rays.
    pub rays: u64,
    /// Number of iterations. Each one passes light through all links.
    pub iterations: usize,
    /// Relative change of the light that leaves all elements, if there were further iterations.
    pub residual: f32,
    /// Largest irradiance of a point by the links if everything that it sees had a radiosity of 1. It would be 1 in a closed scene
    /// with exact links. The light of links is scaled down where it is more.
    pub row_sum: f32,
    /// Deviation from 1 of the light that elements send to each other over the light that the corrected links bring.
    pub imbalance: f32,
    /// Reason why a picture of the solution would be wrong; `null`: none is known.
    pub untrusted: Option<String>,
    /// Light that check rays find on all surfaces, divided by the light that the links bring there.
    pub checked: f32,
    /// Root mean square, over all surfaces, of the correction by the check rays, divided by the mean of the links.
    pub corrected: f32,
    /// Memory of elements, links and rays in bytes.
    pub bytes: usize,
    /// Flux, lm.
    pub energy: Energy,
    /// Mean irradiance of leaves, lx.
    pub irradiance: Irradiance,
    /// Area of the surfaces' sides, m2.
    pub area: f64,
    /// Exposure value of the colors.
    pub exposure_ev: f64,
    /// Color of a luminance of 1 cd/m2: colors are luminances times this.
    pub scale: f32,
    /// Vertices of the file.
    pub vertices: usize,
    /// Triangles of the file.
    pub triangles: usize,
}

/// Number of elements by kind.
#[derive(Serialize)]
pub struct ElementCounts {
    all: usize,
    clusters: usize,
    patches: usize,
    curved: usize,
    fog: usize,
}

impl From<KindCounts> for ElementCounts {
    fn from(kinds: KindCounts) -> Self {
        let KindCounts { clusters, patches, curved, fog } = kinds;
        Self { all: kinds.total(), clusters, patches, curved, fog }
    }
}

/// Elements that are not cut further.
#[derive(Serialize)]
pub struct LeafCounts {
    /// Leaves of surfaces and fog.
    all: usize,
    /// Number of surface sides that have leaves.
    surfaces: usize,
    median_per_surface: usize,
    most_per_surface: usize,
}

/// Links by kind.
#[derive(Serialize)]
pub struct LinkCounts {
    /// Links among elements.
    elements: usize,
    /// Links from light sources to elements.
    lamps: usize,
    by_receiver: ElementCounts,
    by_sender: ElementCounts,
}

/// Luminous flux, lm.
#[derive(Serialize)]
pub struct Energy {
    emitted: f64,
    received: f64,
    absorbed: f64,
}

/// Mean irradiance of leaves by luminance, lx. The median is weighted by area.
#[derive(Serialize)]
pub struct Irradiance {
    least: f32,
    median: f32,
    most: f32,
}

impl LeafCounts {
    /// Collects the counts from the solver's report and the field's summary.
    pub fn from_report(solve_report: &SolveReport, light: &LightTotals) -> Self {
        Self {
            all: solve_report.leaves,
            surfaces: light.surfaces,
            median_per_surface: light.median_leaves,
            most_per_surface: light.max_leaves,
        }
    }
}

impl LinkCounts {
    /// Collects the counts from the solver's report.
    pub fn from_report(solve_report: &SolveReport) -> Self {
        Self {
            elements: solve_report.links,
            lamps: solve_report.lamp_links,
            by_receiver: solve_report.census.receivers.into(),
            by_sender: solve_report.census.sources.into(),
        }
    }
}

impl From<&LightTotals> for Energy {
    fn from(light: &LightTotals) -> Self {
        Self { emitted: light.emitted, received: light.received, absorbed: light.absorbed }
    }
}

impl From<&LightTotals> for Irradiance {
    fn from(light: &LightTotals) -> Self {
        Self { least: light.min_irradiance, median: light.median, most: light.max_irradiance }
    }
}

impl FieldReport {
    /// Prints the report for people.
    pub fn print(&self, printer: Printer) {
        let row = |name: &str, value: String| vec![name.to_owned(), value];
        let ElementCounts { clusters, patches, curved, fog, .. } = self.elements;
        let quantity = |n: usize| human::quantity(n as f64);
        let by_kind = [(patches, "flat"), (curved, "curved"), (fog, "fog"), (clusters, "clusters")];
        let by_kind: Vec<String> = by_kind
            .iter()
            .filter(|(count, _)| *count > 0)
            .map(|(count, kind)| format!("{} {kind}", quantity(*count)))
            .collect();
        let by_kind = if by_kind.is_empty() { String::new() } else { format!(" ({})", by_kind.join(", ")) };
        let in_fog = if fog > 0 { " and in fog" } else { "" };
        let LinkCounts { elements, lamps, .. } = self.links;
        let Irradiance { least, median, most } = self.irradiance;
        let Energy { emitted, received, absorbed } = self.energy;
        let rows = [
            row("elements", format!("{}{by_kind}", quantity(self.elements.all))),
            row(
                "leaves",
                format!("{} on {} sides of surfaces{in_fog}", quantity(self.leaves.all), self.leaves.surfaces),
            ),
            row(
                "links",
                format!(
                    "{} between elements, {} with lamps; {} not exact enough",
                    quantity(elements),
                    quantity(lamps),
                    quantity(self.refused)
                ),
            ),
            row(
                "iterations",
                format!(
                    "{}, residual {:.1e}, row sums up to {:.2}, imbalance {:.1} %",
                    self.iterations,
                    self.residual,
                    self.row_sum,
                    100.0 * self.imbalance
                ),
            ),
            row(
                "checked",
                format!(
                    "rays find {:.3} of the light of the links; corrected by {:.1} % rms",
                    self.checked,
                    100.0 * self.corrected
                ),
            ),
            row("irradiance", format!("{least:.3} to {most:.3} lx, median {median:.3} lx")),
            row("flux", format!("{emitted:.1} lm emitted, {received:.1} lm received, {absorbed:.1} lm absorbed")),
            row("took", format!("{}, {}", human::seconds(self.seconds), human::bytes(self.bytes as u64))),
            row("shown at", format!("EV {:.2}", self.exposure_ev)),
        ];
        printer.result(human::table(&["solution", &self.out], &rows));
    }
}
