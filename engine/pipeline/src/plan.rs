//! Plans: the stages that run, and the features that are left out, with reasons.

use crate::first_pass_steps::{first_pass_blocks, split_first_pass};
use crate::layers::{check_labels, feature_layout};
use crate::settings::{Method, Settings, SettingsError, StopCondition};
use crate::stage::{
    job_graph, tiles_per_group, with_geometry, with_layers, with_measurement, with_solution, with_statistics,
};
use femc_film::{FilmError, Tiling};
use femc_graph::Graph;
use femc_scene::Scene;
use serde::{Deserialize, Serialize};

/// The plan of a job.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Plan {
    /// Name of the camera.
    pub camera: String,
    /// Film, split into tiles.
    pub tiling: Tiling,
    /// Samples a pixel at the end of each round.
    pub rounds: Vec<u32>,
    /// Frames of the clip to render, ascending.
    pub frames: Vec<u32>,
    /// Chosen method.
    pub method: Method,
    /// Stages that run.
    pub graph: Graph,
    /// Features that are left out.
    pub left_out: Vec<OmittedFeature>,
}

/// A feature that does not run.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct OmittedFeature {
    /// Name of the feature that does not run.
    pub what: String,
    /// Reason why it does not run.
    pub reason: String,
}

/// Name of the feature that a plan leaves out for path tracing alone.
pub const FIRST_PASS_FEATURE: &str = "finite-element first pass";

/// Reason why there is no plan.
#[derive(Debug, thiserror::Error)]
pub enum PlanError {
    /// Settings out of their domains.
    #[error(transparent)]
    Settings(#[from] SettingsError),
    /// The camera is missing or invalid.
    #[error(transparent)]
    Camera(#[from] femc_prepared::PrepareError),
    /// The film is too large.
    #[error(transparent)]
    Film(#[from] FilmError),
    /// A frame is outside the clip.
    #[error("frame {frame} is outside the clip, which has frames 1 to {last}")]
    FrameOutside {
        /// Requested frame.
        frame: u32,
        /// Last frame of the clip.
        last: u32,
    },
    /// There is no frame to render.
    #[error("no frames are left to render; give --frames A..B within 1..{last}")]
    NoFrames {
        /// Last frame of the clip.
        last: u32,
    },
}

impl Plan {
    /// Returns the number of camera samples of one frame after `rounds` rounds.
    pub fn samples_per_frame(&self, rounds: usize) -> u64 {
        let spp = self.rounds.get(rounds.saturating_sub(1)).copied().unwrap_or(0);
        u64::from(self.tiling.width) * u64::from(self.tiling.height) * u64::from(spp)
    }
}

/// Plans a job. `frames`: the requested frames; `None`: all. The overrides must have been applied to `scene`.
pub fn plan_job(scene: &Scene, settings: &Settings, frames: Option<&[u32]>) -> Result<Plan, PlanError> {
    settings.check()?;
    check_labels(scene, &settings.layers).map_err(SettingsError::Layers)?;
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
    // A pilot decides whether a first pass is worth it (`method_choice`). Settings that arrive here already contain its result.
    let is_plain = settings.method == Method::Auto || settings.measure_only;
    let method = if is_plain { Method::Pt } else { settings.method };
    let graph = split_first_pass(
        job_graph(&tiling, &rounds, tiles_per_group(&tiling), method),
        method,
        first_pass_blocks(scene),
    );
    let graph = if settings.statistics { with_statistics(graph) } else { graph };
    let graph = if settings.has_layers() { with_layers(graph, &tiling, weight_of_layers(settings)) } else { graph };
    // Viewers show recorded light among the surfaces of its frame, and the light of the first pass on them.
    let graph = if settings.statistics { with_solution(with_geometry(graph)) } else { graph };
    let graph = match &settings.measure {
        Some(request) if settings.measure_only => with_measurement(Graph::default(), request),
        Some(request) => with_measurement(graph, request),
        None => graph,
    };
    let left_out = |what: &str, reason: &str| OmittedFeature { what: what.into(), reason: reason.into() };
    let mut left_out = match method {
        _ if settings.measure_only => vec![left_out("images", "`measure-only`: the frames are only measured")],
        Method::Fem => {
            vec![left_out("paths beyond the first diffuse surface", "the method `fem` takes that light from elements")]
        }
        Method::Femc | Method::Femc1998 => Vec::new(),
        Method::Auto | Method::Pt => vec![left_out(
            FIRST_PASS_FEATURE,
            "path tracing does not use it; `--method femc` guides paths with its solution, `--method fem` renders its solution",
        )],
    };
    let spared = scene.unused_features(camera).into_iter();
    left_out.extend(spared.map(|s| OmittedFeature { what: s.feature.to_string(), reason: s.reason }));
    Ok(Plan { camera: camera.name.clone(), tiling, rounds, frames, method, graph, left_out })
}

/// Returns the cost of a pixel's layers and features, with a layer as 1.
fn weight_of_layers(settings: &Settings) -> usize {
    let features = feature_layout(&settings.features);
    let bytes = 16 * features.values + 64 * features.ids;
    settings.layers.len() + bytes.div_ceil(104) as usize
}

/// Edges of tiles with individual numbers of samples, pixels. The worst block of a tile decides, so tiles of one block draw the
/// fewest samples (roundabout at 0.05: 10.8 a pixel, 19.1 with four blocks). A film with too many such tiles is split into tiles of
/// four blocks.
const UNEVEN_EDGES: [u32; 2] = [16, 32];

/// Maximum number of tiles of one block in a film.
const MAX_ONE_BLOCK_TILES: u32 = 1024;

/// Returns the edge of a tile: tasks have about a quarter of a million samples, and a frame has at least a few tasks.
fn tile_edge(stop: StopCondition, film: [u32; 2]) -> u32 {
    let tiles = |edge: u32| film[0].div_ceil(edge) * film[1].div_ceil(edge);
    let spp = match stop {
        StopCondition::Spp(n) => n,
        StopCondition::Error(_) | StopCondition::Time(_) => {
            let [one, four] = UNEVEN_EDGES;
            return if tiles(one) <= MAX_ONE_BLOCK_TILES { one } else { four };
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
