//! What would run, and what is left out and why.

use crate::first_pass_steps::{first_pass_blocks, in_blocks};
use crate::layers::{feature_layout, unknown_label};
use crate::settings::{Method, Settings, SettingsError, Stop};
use crate::stage::{Stage, fan, stages, with_layers, with_statistics};
use femc_film::{FilmError, Tiling};
use femc_scene::Scene;
use serde::{Deserialize, Serialize};

/// The plan of a job.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Plan {
    /// Camera.
    pub camera: String,
    /// The film, cut into tiles.
    pub tiling: Tiling,
    /// Samples a pixel at the end of each round.
    pub rounds: Vec<u32>,
    /// Frames of the clip to render, ascending.
    pub frames: Vec<u32>,
    /// The method chosen.
    pub method: Method,
    /// What runs: each stage is named by its place.
    pub stages: Vec<Stage>,
    /// What is left out.
    pub left_out: Vec<LeftOut>,
}

/// Something that does not run.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct LeftOut {
    /// Name of the feature that does not run.
    pub what: String,
    /// Reason for which it does not run.
    pub reason: String,
}

/// What a plan leaves out where paths are traced alone.
pub const FIRST_PASS: &str = "finite-element first pass";

/// Why there is no plan.
#[derive(Debug, thiserror::Error)]
pub enum PlanError {
    /// Settings out of their domains.
    #[error(transparent)]
    Settings(#[from] SettingsError),
    /// The camera is missing or wrong.
    #[error(transparent)]
    Camera(#[from] femc_prepared::PrepareError),
    /// The film is too large.
    #[error(transparent)]
    Film(#[from] FilmError),
    /// A frame is outside of the clip.
    #[error("frame {frame} is outside of the clip, which has frames 1 to {last}")]
    FrameOutside {
        /// The frame asked for.
        frame: u32,
        /// The last frame.
        last: u32,
    },
    /// No frame at all.
    #[error("no frames are left to render; give --frames A..B within 1..{last}")]
    NoFrames {
        /// The last frame.
        last: u32,
    },
}

impl Plan {
    /// Camera samples of one frame after `rounds` rounds.
    pub fn samples_per_frame(&self, rounds: usize) -> u64 {
        let spp = self.rounds.get(rounds.saturating_sub(1)).copied().unwrap_or(0);
        u64::from(self.tiling.width) * u64::from(self.tiling.height) * u64::from(spp)
    }
}

/// Plans a job. `frames`: the frames asked for; `None`: all. The overrides must have been applied to `scene`.
pub fn plan(scene: &Scene, settings: &Settings, frames: Option<&[u32]>) -> Result<Plan, PlanError> {
    settings.check()?;
    unknown_label(scene, &settings.layers).map_err(SettingsError::Layers)?;
    let camera = femc_prepared::find_camera(&scene.cameras, settings.camera.as_deref())?;
    let film = settings.size.unwrap_or(camera.film);
    let last = scene.frame_count();
    let frames: Vec<u32> = match frames {
        None => (1..=last).collect(),
        Some(frames) => {
            if let Some(&frame) = frames.iter().find(|f| **f == 0 || **f > last) {
                return Err(PlanError::FrameOutside { frame, last });
            }
            frames.to_vec()
        }
    };
    if frames.is_empty() {
        return Err(PlanError::NoFrames { last });
    }
    let rounds = settings.rounds();
    let tiling = Tiling::new(film[0], film[1], tile_edge(settings.stop, film))?;
    if let Some(allocation) = &settings.allocation {
        allocation.check_tiles(&tiling).map_err(SettingsError::Allocation)?;
    }
    // Whether a first pass is worth it a pilot says (`auto`), of which the settings that come here know the outcome.
    let method = if settings.method == Method::Auto { Method::Pt } else { settings.method };
    let stages = in_blocks(stages(&tiling, &rounds, fan(&tiling), method), method, first_pass_blocks(scene));
    let stages = if settings.statistics { with_statistics(stages) } else { stages };
    let stages = if settings.has_layers() { with_layers(stages, &tiling, weight_of_layers(settings)) } else { stages };
    let left_out = |what: &str, reason: &str| LeftOut { what: what.into(), reason: reason.into() };
    let mut left_out = match method {
        Method::Fem => {
            vec![left_out("paths beyond the first diffuse surface", "the method `fem` takes that light from elements")]
        }
        Method::Femc => Vec::new(),
        Method::Auto | Method::Pt => vec![left_out(
            FIRST_PASS,
            "path tracing does without; `--method femc` guides paths by its solution, `--method fem` renders that",
        )],
    };
    let spared = scene.spared(camera).into_iter();
    left_out.extend(spared.map(|s| LeftOut { what: s.feature.to_string(), reason: s.reason }));
    Ok(Plan { camera: camera.name.clone(), tiling, rounds, frames, method, stages, left_out })
}

/// What a pixel's layers and features weigh, a layer as 1.
fn weight_of_layers(settings: &Settings) -> usize {
    let features = feature_layout(&settings.features);
    let bytes = 16 * features.values + 64 * features.ids;
    settings.layers.len() + bytes.div_ceil(104) as usize
}

/// Edges of tiles that have their own numbers of samples, pixels. The worst block of a tile decides, so tiles of one block draw fewest
/// samples (roundabout at 0.05: 10.8 a pixel, 19.1 with four blocks); a film of more tiles than that is worth is cut in tiles of four.
const UNEVEN_EDGES: [u32; 2] = [16, 32];

/// Most tiles of one block that a film is cut in.
const MOST_OF_ONE_BLOCK: u32 = 1024;

/// Edge of a tile: tasks of about a quarter of a million samples, at least a few tasks a frame.
fn tile_edge(stop: Stop, film: [u32; 2]) -> u32 {
    let tiles = |edge: u32| film[0].div_ceil(edge) * film[1].div_ceil(edge);
    let spp = match stop {
        Stop::Spp(n) => n,
        Stop::Error(_) | Stop::Time(_) => {
            let [one, four] = UNEVEN_EDGES;
            return if tiles(one) <= MOST_OF_ONE_BLOCK { one } else { four };
        }
    };
    let mut edge = 128u32;
    while edge > 16 && u64::from(edge * edge) * u64::from(spp) > 1 << 18 {
        edge /= 2;
    }
    while edge > 16 && tiles(edge) < 8 {
        edge /= 2;
    }
    edge
}
