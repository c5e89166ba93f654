//! Bottlenecks of light transport, with names in place of keys.

use super::files::read;
use crate::ReportError;
use crate::human;
use femc_pipeline::paths::bottlenecks::{Bottlenecks, Grouping, PartStatistics, ScenePart};
use femc_pipeline::paths::{LightStatistics, Name};
use serde::Serialize;
use std::fmt;
use std::path::{Path, PathBuf};

/// Sort key of the rows, greatest first.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SortKey {
    /// Noise.
    Noise,
    /// Light.
    Light,
    /// Number of intersections.
    Work,
    /// Throughput after 8 intersections.
    Deep,
}

impl SortKey {
    fn value(self, evidence: &PartStatistics) -> f64 {
        match self {
            Self::Noise => evidence.noise,
            Self::Light => evidence.light,
            Self::Work => evidence.intersections,
            Self::Deep => evidence.deep_throughput,
        }
    }
}

/// Report of `femc bottlenecks`.
#[derive(Debug, Serialize)]
pub struct BottleneckReport {
    /// Files that were read.
    pub files: Vec<String>,
    /// Number of samples of the frames.
    pub samples: u64,
    /// Fraction of samples whose paths have 8 intersections or more.
    pub deep_samples: f64,
    /// Most important bottlenecks.
    pub findings: Vec<Finding>,
    /// Rows by object, material and interaction.
    pub parts: Vec<PartRow>,
    /// Rows by object.
    pub objects: Vec<PartRow>,
    /// Rows by material.
    pub materials: Vec<PartRow>,
    /// Rows by lamp.
    pub lamps: Vec<LampRow>,
    /// Samples that add the most noise.
    pub fireflies: Vec<FireflyRow>,
}

/// A part of the scene with its fractions of the totals.
#[derive(Clone, Debug, Serialize)]
pub struct PartRow {
    /// Dotted name; none: the camera, fog, or an object without a name.
    pub object: Option<String>,
    /// Name of the material or the medium.
    pub material: Option<String>,
    /// Interaction with which paths continued.
    pub interaction: Option<&'static str>,
    /// Fraction of the noise.
    pub noise: f64,
    /// Fraction of the light.
    pub light: f64,
    /// Fraction of the intersections.
    pub work: f64,
    /// Fraction of the throughput after 8 intersections.
    pub deep: f64,
    /// Fraction of the recorded paths that begin there.
    pub begun: f64,
    /// Mean depth of the paths that begin there; none: there are no such paths.
    pub depth: Option<f64>,
    /// Mean throughput of the paths that begin there at the 8th intersection.
    pub left: Option<f64>,
    /// Mean depth of all other paths.
    pub depth_of_others: f64,
    /// Mean throughput of all other paths at the 8th intersection.
    pub left_of_others: f64,
    /// Number of recorded intersections.
    pub records: u64,
}

/// A lamp with its fractions of the totals.
#[derive(Clone, Debug, Serialize)]
pub struct LampRow {
    /// Object that contains the lamp, and its emitter; none: a first pass.
    pub lamp: Option<String>,
    /// Fraction of the noise.
    pub noise: f64,
    /// Fraction of the light.
    pub light: f64,
    /// Fraction of `records` in which an object hid the lamp.
    pub hidden: f64,
    /// Number of times that recorded paths sampled or hit the lamp.
    pub records: u64,
}

/// A sample that adds much noise.
#[derive(Clone, Debug, Serialize)]
pub struct FireflyRow {
    /// File of the sample's frame.
    pub file: String,
    /// Column of the pixel.
    pub x: u32,
    /// Row of the pixel.
    pub y: u32,
    /// Number of the sample in the pixel.
    pub sample: u32,
    /// Luminance of the sample, cd/m2.
    pub luminance: f64,
    /// Mean of the pixel's other samples, cd/m2.
    pub others: f64,
    /// Fraction of the total noise.
    pub noise: f64,
    /// Object that scattered most of the sample's light.
    pub object: Option<String>,
    /// Material that scattered most of the sample's light.
    pub material: Option<String>,
    /// Interaction that scattered most of the sample's light.
    pub interaction: Option<&'static str>,
    /// Lamp of that light.
    pub lamp: Option<String>,
    /// Technique that found that light.
    pub found: &'static str,
}

/// A bottleneck.
#[derive(Clone, Debug, Serialize)]
#[serde(tag = "what", rename_all = "lowercase")]
pub enum Finding {
    /// The object that adds the most noise.
    Noise(PartRow),
    /// The object that keeps paths bright and long.
    Deep(PartRow),
    /// The object with the most intersections.
    Work(PartRow),
    /// The lamp whose light adds the most noise.
    Lamp(LampRow),
    /// The sample that adds the most noise.
    Firefly(FireflyRow),
}

/// Number of samples that are listed.
const MAX_FIREFLIES: usize = 1000;
/// Ratio of mean throughputs above which a part is reported: that of paths that begin there over that of other paths.
const LONG_PATH_RATIO: f64 = 2.0;

impl BottleneckReport {
    /// Reads files and finds their bottlenecks.
    pub fn read(files: &[PathBuf], key: SortKey) -> Result<Self, ReportError> {
        let mut all: [Bottlenecks; 3] = Default::default();
        let (mut names, mut films) = (Vec::new(), Vec::new());
        for file in files {
            for statistics in read(file)?.frames {
                add(&mut all, &statistics);
                names.push(name(file));
                films.push(statistics.scope.film[0]);
            }
        }
        Ok(Self::from_bottlenecks(&all, names, &films, key))
    }

    /// Finds the bottlenecks of frames in memory.
    pub fn from_frames(frames: &[(PathBuf, LightStatistics)]) -> Self {
        let mut all: [Bottlenecks; 3] = Default::default();
        frames.iter().for_each(|(_, statistics)| add(&mut all, statistics));
        let widths: Vec<u32> = frames.iter().map(|(_, statistics)| statistics.scope.film[0]).collect();
        Self::from_bottlenecks(&all, frames.iter().map(|(file, _)| name(file)).collect(), &widths, SortKey::Noise)
    }

    fn from_bottlenecks(all: &[Bottlenecks; 3], files: Vec<String>, widths: &[u32], key: SortKey) -> Self {
        let rows = |by| {
            let own = grouped_by(all, by);
            own.ranked(|it| key.value(it)).into_iter().map(|(part, it)| row(own, part, &it)).collect::<Vec<PartRow>>()
        };
        let parts = grouped_by(all, Grouping::Part);
        let text = |name: Name| parts.name_text(name).map(str::to_owned);
        let total = &parts.total;
        let mut lamps: Vec<LampRow> = parts
            .lamps
            .iter()
            .map(|(name, it)| LampRow {
                lamp: text(*name),
                noise: share(it.noise, total.noise),
                light: share(it.light, total.light),
                hidden: share(it.occluded as f64, it.records as f64),
                records: it.records,
            })
            .collect();
        lamps.sort_by(|a, b| b.noise.total_cmp(&a.noise).then(b.light.total_cmp(&a.light)));
        let firefly = |(frame, it): &(usize, femc_pipeline::paths::bottlenecks::Firefly)| {
            let width = widths.get(*frame).copied().unwrap_or(1).max(1);
            FireflyRow {
                file: files.get(*frame).cloned().unwrap_or_default(),
                x: it.key.pixel % width,
                y: it.key.pixel / width,
                sample: it.key.sample,
                luminance: f64::from(it.luminance),
                others: it.mean_of_others,
                noise: share(it.noise, total.noise),
                object: text(it.part.object),
                material: text(it.part.material),
                interaction: it.part.interaction.map(|it| it.word()),
                lamp: text(it.lamp),
                found: it.technique.word(),
            }
        };
        let fireflies: Vec<FireflyRow> = parts.fireflies.iter().take(MAX_FIREFLIES).map(firefly).collect();
        let findings = findings(all, &lamps, &fireflies);
        Self {
            samples: parts.samples,
            deep_samples: share(parts.deep_samples as f64, parts.samples as f64),
            findings,
            parts: rows(Grouping::Part),
            objects: rows(Grouping::Object),
            materials: rows(Grouping::Material),
            lamps,
            fireflies,
            files,
        }
    }
}

/// Returns the results that are grouped by `by`.
fn grouped_by(all: &[Bottlenecks; 3], by: Grouping) -> &Bottlenecks {
    &all[by as usize]
}

fn add(all: &mut [Bottlenecks; 3], statistics: &LightStatistics) {
    for by in [Grouping::Part, Grouping::Object, Grouping::Material] {
        all[by as usize].merge(Bottlenecks::from_statistics(statistics, by));
    }
}

fn name(file: &Path) -> String {
    file.display().to_string()
}

fn share(part: f64, all: f64) -> f64 {
    if all > 0.0 { part / all } else { 0.0 }
}

fn row(all: &Bottlenecks, part: ScenePart, evidence: &PartStatistics) -> PartRow {
    let text = |name: Name| all.name_text(name).map(str::to_owned);
    let others = all.without_part(evidence);
    PartRow {
        object: text(part.object),
        material: text(part.material),
        interaction: part.interaction.map(|it| it.word()),
        noise: share(evidence.noise, all.total.noise),
        light: share(evidence.light, all.total.light),
        work: share(evidence.intersections, all.total.intersections),
        deep: share(evidence.deep_throughput, all.total.deep_throughput),
        begun: share(evidence.first_hits as f64, all.total.first_hits as f64),
        depth: (evidence.first_hits > 0).then(|| evidence.mean_depth()),
        left: (evidence.first_hits > 0).then(|| evidence.mean_remaining_throughput()),
        depth_of_others: others.mean_depth(),
        left_of_others: others.mean_remaining_throughput(),
        records: evidence.records,
    }
}

/// Returns the object with the greatest value of `value`, with the material and interaction of its greatest part.
fn greatest_object(all: &[Bottlenecks; 3], value: impl Fn(&Bottlenecks, &PartStatistics) -> f64) -> Option<PartRow> {
    let (objects, parts) = (grouped_by(all, Grouping::Object), grouped_by(all, Grouping::Part));
    let ranked = objects.ranked(|it| value(objects, it));
    let (object, evidence) = ranked.into_iter().find(|(part, _)| part.object != Name::NONE)?;
    let of_object = |(part, _): &(ScenePart, PartStatistics)| part.object == object.object;
    let (part, _) = parts.ranked(|it| value(parts, it)).into_iter().find(of_object)?;
    let own = row(objects, ScenePart { object: object.object, ..part }, &evidence);
    (value(objects, &evidence) > 0.0)
        .then(|| PartRow { material: parts.name_text(part.material).map(str::to_owned), ..own })
}

fn findings(all: &[Bottlenecks; 3], lamps: &[LampRow], fireflies: &[FireflyRow]) -> Vec<Finding> {
    let mut findings = Vec::new();
    findings.extend(greatest_object(all, |_, it| it.noise).map(Finding::Noise));
    let is_more = |row: &PartRow| row.left.is_some_and(|left| left > LONG_PATH_RATIO * row.left_of_others);
    findings.extend(greatest_object(all, Bottlenecks::deep_throughput_variance).filter(is_more).map(Finding::Deep));
    findings.extend(greatest_object(all, |_, it| it.intersections).map(Finding::Work));
    findings.extend(lamps.first().filter(|lamp| lamp.noise > 0.0 && lamps.len() > 1).cloned().map(Finding::Lamp));
    findings.extend(fireflies.first().cloned().map(Finding::Firefly));
    findings
}

/// Formats a part: `ball (chrome, reflection)`.
fn describe_part(object: Option<&str>, material: Option<&str>, interaction: Option<&str>) -> String {
    let within: Vec<&str> = [material, interaction].into_iter().flatten().collect();
    let object = object.unwrap_or(if within.is_empty() { "the camera" } else { "-" });
    if within.is_empty() { object.to_owned() } else { format!("{object} ({})", within.join(", ")) }
}

impl PartRow {
    fn describe(&self) -> String {
        describe_part(self.object.as_deref(), self.material.as_deref(), self.interaction)
    }
}

impl fmt::Display for Finding {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        use human::{number, percent};
        match self {
            Self::Noise(row) => write!(
                f,
                "noise:       {}: {} of the noise, {} of the light",
                row.describe(),
                percent(row.noise),
                percent(row.light)
            ),
            Self::Deep(row) => write!(
                f,
                "long paths:  {}: after 8 intersections, {} of the light can still pass (elsewhere {}); {} intersections per path \
                 (elsewhere {})",
                row.describe(),
                percent(row.left.unwrap_or(0.0)),
                percent(row.left_of_others),
                number(row.depth.unwrap_or(0.0)),
                number(row.depth_of_others)
            ),
            Self::Work(row) => {
                write!(f, "most work:   {}: {} of the intersections", row.describe(), percent(row.work))
            }
            Self::Lamp(row) => write!(
                f,
                "noisy lamp:  {}: {} of the noise, {} of the light, hidden {} of the time",
                row.lamp.as_deref().unwrap_or("-"),
                percent(row.noise),
                percent(row.light),
                percent(row.hidden)
            ),
            Self::Firefly(row) => write!(
                f,
                "firefly:     {},{} #{} of {}: {} cd/m2, the other samples of the pixel have {}; caused by {}",
                row.x,
                row.y,
                row.sample,
                row.file,
                number(row.luminance),
                number(row.others),
                describe_part(row.object.as_deref(), row.material.as_deref(), row.interaction)
            ),
        }
    }
}
