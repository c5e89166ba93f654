//! JSON of a job's specification.

use std::collections::BTreeSet;

use femc_model::{JobSpec, Scope};
use serde::{Deserialize, Serialize};

use crate::file::FileNames;

/// A job's specification as JSON, without the tables of its tasks.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct SpecJson {
    /// Width and height in pixels.
    film: [u32; 2],
    /// Side of a tile in pixels.
    tile: u32,
    frames: Vec<u32>,
    tags: Vec<String>,
    stages: Vec<StageJson>,
    /// Name of the clip's file, if the job makes one.
    clip: Option<String>,
    /// Name of the contact sheet's file, if the job makes one.
    sheet: Option<String>,
    /// Render settings: JSON in a string.
    settings: String,
}

#[derive(Debug, Clone, PartialEq, Serialize)]
struct StageJson {
    number: u16,
    kind: &'static str,
    scope: &'static str,
    /// Numbers of the stages that the stage reads.
    needs: BTreeSet<u16>,
    /// Number of tasks in each frame (or other scope) and round, not counting chunks.
    tasks: u32,
    rounds: u32,
}

impl From<&JobSpec> for SpecJson {
    fn from(spec: &JobSpec) -> Self {
        let stages = (0..).zip(&spec.graph.stages).map(|(number, template)| StageJson {
            number,
            kind: template.kind.name(),
            scope: match template.scope {
                Scope::Job => "job",
                Scope::Frame => "frame",
                Scope::Content => "content",
            },
            needs: template.needs.iter().map(|need| need.stage).collect(),
            tasks: template.tasks(),
            rounds: spec.graph.rounds(number),
        });
        let FileNames { clip, sheet } = FileNames::new(&spec.graph);
        Self {
            film: spec.grid.film,
            tile: spec.grid.tile,
            frames: spec.frames.clone(),
            tags: spec.tags.clone(),
            stages: stages.collect(),
            clip,
            sheet,
            settings: spec.settings.clone(),
        }
    }
}

/// Returns the target relative error of each frame of a job; `None`: samples or time end the job, or the settings do not state a
/// target.
pub fn error_target(spec: &JobSpec) -> Option<f64> {
    #[derive(Deserialize)]
    struct Settings {
        stop: Stop,
    }
    #[derive(Deserialize)]
    struct Stop {
        error: f64,
    }
    serde_json::from_str(&spec.settings).ok().map(|Settings { stop }| stop.error)
}
