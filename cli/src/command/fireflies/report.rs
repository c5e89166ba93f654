//! The report of `femc fireflies`, with names instead of indices.

use super::frame::{Frame, WorstBlock};
use crate::output::decisions::DecisionsReport;
use femc_pipeline::Prepared;
use femc_pipeline::replay::Replay;
use femc_pipeline::variance_attribution::{
    BrightestContribution, ContributionKind, ContributionOrigin, Lamps, LastScatterer, OriginShare,
    VarianceAttribution, scatterer,
};
use femc_scene::LampKind;
use serde::Serialize;
use std::path::Path;

/// Number of pixels listed per block.
const MAX_PIXELS: usize = 3;
/// Number of origins listed per block.
const MAX_ORIGINS: usize = 5;

/// The whole report.
#[derive(Serialize)]
pub struct FirefliesReport {
    frame: String,
    scene: String,
    /// Number of samples that were traced again.
    pub samples: u64,
    /// Number of pixels in the blocks.
    pub pixels: u64,
    /// Number of these pixels whose mean differs from the mean of the samples traced again.
    pub unlike: u64,
    /// Blocks, worst first.
    pub blocks: Vec<BlockReport>,
    /// Origins in all these blocks together, each block weighted by its relative variance; the largest share first.
    pub origins: Vec<OriginReport>,
    /// Parts of the variance by decision, if requested.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub decisions: Option<DecisionsReport>,
}

/// A block.
#[derive(Serialize)]
pub struct BlockReport {
    /// Column of the upper left pixel.
    pub x: u32,
    /// Row of the upper left pixel.
    pub y: u32,
    /// Width in pixels.
    pub width: u32,
    /// Height in pixels.
    pub height: u32,
    /// Relative error, as the file states it.
    pub relative_error: f64,
    /// Mean luminance, cd/m2.
    pub mean: f64,
    /// Pixels with the most variance.
    pub pixels: Vec<PixelReport>,
    /// Origins with the largest shares.
    pub origins: Vec<OriginReport>,
}

/// A pixel and its share of its block's variance.
#[derive(Serialize)]
pub struct PixelReport {
    /// Column.
    pub x: u32,
    /// Row.
    pub y: u32,
    /// Share of the variance, 0 to 1.
    pub share: f64,
}

/// An origin of light.
#[derive(Clone, Serialize)]
pub struct OriginReport {
    /// Share of the variance.
    pub share: f64,
    /// Share of the light.
    pub light: f64,
    /// Segment of the path; 0 is the camera's.
    pub bounce: u32,
    /// Technique.
    pub how: &'static str,
    /// Whether the first pass has guided a direction of the path before the light, with the method `femc`.
    #[serde(skip_serializing_if = "std::ops::Not::not")]
    pub guided: bool,
    /// Object or medium that scattered the path last.
    pub on: ScattererReport,
    /// Lamp; none: a glowing medium.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub lamp: Option<LampReport>,
    /// The brightest contribution.
    pub brightest: BrightestReport,
}

/// Object or medium that scattered light.
#[derive(Clone, Default, Serialize)]
pub struct ScattererReport {
    /// Dotted name of the innermost object.
    #[serde(skip_serializing_if = "String::is_empty")]
    pub object: String,
    /// Material.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub material: Option<String>,
    /// Medium.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub medium: Option<String>,
}

/// A lamp, named as in `femc check`.
#[derive(Clone, Serialize)]
pub struct LampReport {
    kind: &'static str,
    /// Name of the material, or path of the IES file.
    pub name: String,
    /// Dotted name of the innermost object.
    #[serde(skip_serializing_if = "String::is_empty")]
    pub object: String,
    file: String,
    line: u32,
}

/// The brightest contribution of an origin.
#[derive(Clone, Serialize)]
pub struct BrightestReport {
    /// Column of its pixel.
    pub x: u32,
    /// Row of its pixel.
    pub y: u32,
    /// Number of the sample.
    pub sample: u32,
    /// Luminance, cd/m2.
    pub luminance: f64,
    /// Luminance divided by the pixel's mean.
    pub times_mean: f64,
    /// Vertices of the path from the camera to the place where light was found.
    pub path: Vec<VertexReport>,
}

/// A vertex of a path.
#[derive(Clone, Serialize)]
pub struct VertexReport {
    /// Object or medium at the vertex.
    #[serde(flatten)]
    pub on: ScattererReport,
    /// Position in the world, m.
    pub position: [f64; 3],
}

/// Lookup of names for indices.
pub struct Names<'a> {
    /// The frame.
    pub prepared: &'a Prepared,
    /// Its lamps.
    pub lamps: &'a Lamps,
    /// Function that returns a file of the scene as it is reached from the current folder.
    pub display_path: &'a dyn Fn(&str) -> String,
}

impl LampReport {
    /// Returns the location as `file:line`.
    pub fn location(&self) -> String {
        format!("{}:{}", self.file, self.line)
    }
}

impl FirefliesReport {
    /// Creates the report from the blocks' accounts.
    pub fn new(
        path: &Path,
        scene: &Path,
        frame: &Frame,
        worst: &[WorstBlock],
        accounts: &[VarianceAttribution],
        names: &Names<'_>,
    ) -> Self {
        let mut whole = VarianceAttribution::default();
        for (block, account) in worst.iter().zip(accounts) {
            whole.merge(account.clone().scaled(1.0 / (block.scale * block.scale)));
        }
        let blocks = worst.iter().zip(accounts).map(|(block, account)| {
            let mut pixels = account.pixels.clone();
            pixels.sort_by(|a, b| b.1.total_cmp(&a.1).then(a.0.cmp(&b.0)));
            let all = account.variance();
            let share = |&((x, y), variance): &((u32, u32), f64)| PixelReport { x, y, share: fraction(variance, all) };
            BlockReport {
                x: block.rect.x,
                y: block.rect.y,
                width: block.rect.width,
                height: block.rect.height,
                relative_error: block.error,
                mean: block.mean,
                pixels: pixels.iter().take(MAX_PIXELS).map(share).collect(),
                origins: origins(account, frame, names, MAX_ORIGINS),
            }
        });
        Self {
            frame: path.display().to_string(),
            scene: scene.display().to_string(),
            samples: whole.samples,
            pixels: whole.pixels.len() as u64,
            unlike: whole.mismatched,
            blocks: blocks.collect(),
            origins: origins(&whole, frame, names, usize::MAX),
            decisions: None,
        }
    }
}

fn fraction(part: f64, all: f64) -> f64 {
    if all > 0.0 { part / all } else { 0.0 }
}

/// Returns the origins with the largest shares, in order.
fn origins(account: &VarianceAttribution, frame: &Frame, names: &Names<'_>, most: usize) -> Vec<OriginReport> {
    let mut sorted: Vec<(&ContributionOrigin, &OriginShare)> = account.origins.iter().collect();
    sorted.sort_by(|a, b| b.1.variance.total_cmp(&a.1.variance));
    let (variance, mean) = (account.variance(), account.origins.values().map(|part| part.mean).sum());
    let report = |(origin, it): (&ContributionOrigin, &OriginShare)| OriginReport {
        share: fraction(it.variance, variance),
        light: fraction(it.mean, mean),
        bounce: origin.bounce,
        how: technique_text(origin.technique),
        guided: origin.guided,
        on: names.scatterer(origin.scatterer),
        lamp: origin.lamp.map(|lamp| names.lamp(lamp)),
        brightest: names.brightest(frame, origin, &it.brightest),
    };
    sorted.into_iter().take(most).map(report).collect()
}

fn technique_text(how: ContributionKind) -> &'static str {
    match how {
        ContributionKind::CameraNextEvent => "lamp drawn from the camera",
        ContributionKind::CameraHit => "lamp met by the camera's ray",
        ContributionKind::SpecularHit => "lamp met behind a mirror or glass",
        ContributionKind::ScatteredHit => "lamp met by scattering",
        ContributionKind::NextEvent => "light drawn at a surface",
        ContributionKind::Airlight => "airlight of a lamp",
        ContributionKind::Glow => "glow of a medium",
        ContributionKind::Field => "light of the first pass",
    }
}

impl Names<'_> {
    fn scatterer(&self, on: LastScatterer) -> ScattererReport {
        match on {
            LastScatterer::Camera => ScattererReport::default(),
            LastScatterer::Surface { object, material } => ScattererReport {
                object: self.prepared.object_name(object).to_owned(),
                material: Some(self.prepared.material_name(material).to_owned()),
                medium: None,
            },
            LastScatterer::Medium(medium) => ScattererReport {
                medium: Some(self.prepared.medium_name(medium).to_owned()),
                ..ScattererReport::default()
            },
        }
    }

    fn lamp(&self, lamp: u32) -> LampReport {
        let lamp = &self.lamps.names[lamp as usize];
        let (kind, name) = match &lamp.kind {
            LampKind::Surface { material } => ("material", material),
            LampKind::Luminaire { path } => ("ies", path),
            LampKind::Medium { medium } => ("medium", medium),
        };
        let file = self.prepared.scene.files.get(lamp.location.file as usize).map_or("", String::as_str);
        LampReport {
            kind,
            name: name.clone(),
            object: lamp.object.clone(),
            file: (self.display_path)(file),
            line: lamp.location.line,
        }
    }

    /// Traces the brightest sample once more to get its path.
    fn brightest(&self, frame: &Frame, origin: &ContributionOrigin, it: &BrightestContribution) -> BrightestReport {
        let mut replay = Replay::new(self.prepared, &frame.settings);
        let (_, recording) = replay.sample(it.pixel, it.sample);
        let is_it = |entry: &&(_, u32)| {
            ContributionOrigin::new(self.prepared, self.lamps, recording, &entry.0, entry.1) == *origin
        };
        let luminance = |color| f64::from(femc_pipeline::variance_attribution::luminance(color));
        let found = recording.contributions.iter().filter(is_it);
        let found = found.max_by(|a, b| luminance(a.0.color).total_cmp(&luminance(b.0.color)));
        let vertex = |on, position| VertexReport { on, position: self.prepared.to_world(position) };
        let path = found.map(|(contribution, last)| {
            let steps = recording.steps.branch(*last).map(|step| step.vertex);
            let mut path: Vec<VertexReport> =
                steps.map(|it| vertex(self.scatterer(scatterer(self.prepared, it.location)), it.position)).collect();
            path.reverse();
            if !matches!(origin.technique, ContributionKind::NextEvent | ContributionKind::Glow) {
                let end = if origin.technique == ContributionKind::Airlight {
                    self.scatterer(origin.scatterer)
                } else {
                    ScattererReport::default()
                };
                path.push(vertex(end, contribution.position));
            }
            path
        });
        BrightestReport {
            x: it.pixel.0,
            y: it.pixel.1,
            sample: it.sample,
            luminance: it.luminance,
            times_mean: fraction(it.luminance, it.mean),
            path: path.unwrap_or_default(),
        }
    }
}
