//! Stages of a job: the form of a plan that the farm runs.
//!
//! A frame of one round is rendered, and its image is made from its tiles. The image of a large frame is made from groups of tiles,
//! which are united in parallel with the rendering. The image task then reads less, at the price of two outputs per group.
//!
//! A frame of several rounds always has groups, even if there is only one. A decision closes the loop: it reads the errors of all
//! tiles, some kilobytes, and determines how many samples each tile gets in the next round. The image is made once, after the loop.
//!
//! A method with a first pass runs it before all other stages, once for all frames of one world. Each tile reads its light. The
//! first pass is one task, or many tasks ([`split_first_pass`](crate::split_first_pass)).
//!
//! With light statistics, each tile outputs, in addition to its sums, the statistics of its samples' paths. When it is known which
//! samples count, the image task unites those of all rounds, for many tiles by groups.

use crate::Method;
use femc_film::Tiling;
use serde::{Deserialize, Serialize};
use std::num::NonZeroU32;

/// An array of tasks of one kind. Stages are identified by their index in the plan. A stage needs only stages before it or, from
/// the round before, any stage of its loop.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Stage {
    /// Kind of its tasks.
    pub kind: StageKind,
    /// Unit that has this stage once: a frame, a job, or a shared content.
    pub scope: Scope,
    /// Tasks in order, as runs of equal ones: number of tasks, and units of work per step of each. For [`StageKind::Render`] a unit
    /// is a pixel.
    pub sizes: Vec<(u32, u64)>,
    /// Total steps of each task at the end of each round, ascending. For [`StageKind::Render`] these are samples a pixel. Empty for
    /// other kinds.
    pub steps: Vec<u32>,
    /// Outputs that its tasks read.
    pub needs: Vec<Need>,
    /// Roles of its outputs.
    pub makes: Vec<Role>,
    /// Loop that the stage closes.
    pub closes: Option<Loop>,
}

/// Kind of the tasks of a stage.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum StageKind {
    /// Renders samples of a tile.
    Render,
    /// Unites the tiles of a group.
    Reduce,
    /// Decides from the errors of a frame's tiles whether another round follows, and how many samples each tile gets in it.
    Decide,
    /// Measures a frame and writes its image.
    Image,
    /// Solves the first pass of a world, or does the steps of it that one task does for all blocks.
    FirstPass,
    /// Computes a block of a first pass: its rays, or its guides.
    FirstPassBlock,
}

/// Unit that has a stage once.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Scope {
    /// Whole job.
    Job,
    /// Each frame.
    Frame,
    /// Content shared by frames and jobs with one key.
    Content,
}

/// Role of an output.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Role {
    /// Sums of a tile's samples.
    Tile,
    /// Sums of several tiles.
    Sums,
    /// Resolved pixels of several tiles.
    Pixels,
    /// Errors of several tiles, for the test of convergence.
    Errors,
    /// Ends of the halves of the tiles.
    Stops,
    /// A finished image.
    Image,
    /// A finished image, tone-mapped.
    Preview,
    /// Light of a first pass.
    Field,
    /// Statistics of the paths of samples.
    Paths,
    /// Statistics of the paths of all samples that count in a frame.
    Statistics,
    /// Elements of an unfinished first pass, and their light.
    Elements,
    /// Links between these elements.
    Links,
    /// Ray hits of a block.
    Rays,
    /// Guides of a block: the directions from which its light comes.
    Guides,
    /// Sums of the layers of a tile's samples.
    Layers,
    /// Resolved layers of several tiles.
    LayerPixels,
    /// The layers of a finished image.
    LayerImage,
}

/// Outputs of one role of a stage, which the tasks of another read.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Need {
    /// Stage that makes them.
    pub stage: u16,
    /// Role of the outputs.
    pub role: Role,
    /// Tasks of that stage whose outputs are read.
    pub reach: Reach,
    /// Round of that stage whose outputs are read.
    pub round: Round,
}

/// Tasks of a stage whose outputs a task reads.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Reach {
    /// All tasks.
    All,
    /// Task with the same index.
    Same,
    /// Tasks from `i * n` to `(i + 1) * n`, for task `i`.
    Fan(NonZeroU32),
}

/// Round of a stage whose outputs a task reads.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Round {
    /// Same round within a loop; last round of a stage whose loop is over.
    Same,
    /// Round before; none in the first round.
    Before,
    /// All rounds of a stage whose loop is over.
    Every,
}

/// Stages that run in rounds.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Loop {
    /// First stage of the loop. The last one is the stage that closes it.
    pub first: u16,
    /// Maximum number of rounds.
    pub rounds: u32,
}

impl Stage {
    pub(crate) fn per_frame(kind: StageKind, sizes: Vec<(u32, u64)>, makes: &[Role]) -> Self {
        let makes = makes.to_vec();
        Self { kind, scope: Scope::Frame, sizes, steps: Vec::new(), needs: Vec::new(), makes, closes: None }
    }

    pub(crate) fn with_need(mut self, stage: u16, role: Role, reach: Reach) -> Self {
        self.needs.push(Need { stage, role, reach, round: Round::Same });
        self
    }
}

/// Maximum number of tiles of a group: 256.
const GROUP_TILES: u64 = 256;
/// Maximum number of pixels of a group. Their sums, 236 bytes each, are united in about a second.
const GROUP_PIXELS: u64 = 1 << 18;

/// Returns the maximum number of such tiles in a group.
pub fn tiles_per_group(tiling: &Tiling) -> NonZeroU32 {
    let tile = u64::from(tiling.edge) * u64::from(tiling.edge);
    let tiles = (GROUP_PIXELS / tile.max(1)).min(GROUP_TILES) as u32;
    NonZeroU32::new(tiles).unwrap_or(NonZeroU32::MIN)
}

/// Returns the stages of a job of frames: the first pass if the method has one; tiles; groups of `fan` tiles if there
/// are more tiles or several rounds; a decision if there are several rounds; the image.
/// - `rounds`: samples a pixel at the end of each round, ascending.
pub fn job_stages(tiling: &Tiling, rounds: &[u32], fan: NonZeroU32, method: Method) -> Vec<Stage> {
    let groups = (tiling.count() as u32).div_ceil(fan.get());
    let render = Stage::per_frame(StageKind::Render, tile_areas(tiling), &[Role::Tile]);
    let mut render = Stage { steps: rounds.to_vec(), ..render };
    let mut all = Vec::new();
    if method.has_first_pass() {
        let first_pass = Stage::per_frame(StageKind::FirstPass, vec![(1, 1)], &[Role::Field]);
        all.push(Stage { scope: Scope::Content, ..first_pass });
        render = render.with_need(0, Role::Field, Reach::All);
    }
    let first = all.len() as u16;
    all.push(render);
    let reduce = |makes: &[Role]| {
        let reduce = Stage::per_frame(StageKind::Reduce, vec![(groups, 1)], makes);
        reduce.with_need(first, Role::Tile, Reach::Fan(fan))
    };
    let mut finished = (first + 1, Role::Pixels);
    if rounds.len() > 1 {
        // The reduction continues from its sums of the round before and from the decision of that round. So does the decision.
        let before = |stage, role, reach| Need { stage, role, reach, round: Round::Before };
        let stops = before(first + 2, Role::Stops, Reach::All);
        let mut reduce = reduce(&[Role::Pixels, Role::Errors, Role::Sums]);
        reduce.needs.extend([before(first + 1, Role::Sums, Reach::Same), stops]);
        let decide = Stage::per_frame(StageKind::Decide, vec![(1, 1)], &[Role::Stops]);
        let mut decide = decide.with_need(first + 1, Role::Errors, Reach::All);
        decide.needs.push(stops);
        let closes = Some(Loop { first, rounds: rounds.len() as u32 });
        all.extend([reduce, Stage { closes, ..decide }]);
    } else if groups > 1 {
        all.push(reduce(&[Role::Pixels]));
    } else {
        finished = (first, Role::Tile);
    }
    let image = Stage::per_frame(StageKind::Image, vec![(1, 1)], &[Role::Image, Role::Preview]);
    all.push(image.with_need(finished.0, finished.1, Reach::All));
    all
}

/// Number of tiles whose paths one task unites, and number of groups of them that one task reads.
const PATHS_FAN: NonZeroU32 = NonZeroU32::new(256).expect("it is not 0");

/// Adds light statistics to the stages of a job. Its images do not change.
pub fn with_statistics_stages(mut stages: Vec<Stage>) -> Vec<Stage> {
    let find = |stages: &[Stage], kind| stages.iter().position(|stage| stage.kind == kind);
    let (Some(render), Some(mut image)) = (find(&stages, StageKind::Render), stages.pop()) else { return stages };
    let decide = find(&stages, StageKind::Decide);
    stages[render].makes.push(Role::Paths);
    let tiles: u32 = stages[render].sizes.iter().map(|(count, _)| count).sum();
    let of = |stage: usize, role, reach| Need { stage: stage as u16, role, reach, round: Round::Every };
    // The last decision determines which samples count.
    if tiles > PATHS_FAN.get() {
        let groups = vec![(tiles.div_ceil(PATHS_FAN.get()), 1)];
        let mut reduce = Stage::per_frame(StageKind::Reduce, groups, &[Role::Paths]);
        reduce.needs.push(of(render, Role::Paths, Reach::Fan(PATHS_FAN)));
        image = image.with_need(stages.len() as u16, Role::Paths, Reach::All);
        stages.push(reduce);
    } else {
        image.needs.push(of(render, Role::Paths, Reach::All));
    }
    if let Some(decide) = decide {
        image = image.with_need(decide as u16, Role::Stops, Reach::All);
    }
    image.makes.push(Role::Statistics);
    stages.push(image);
    stages
}

/// Maximum number of layer sums of a group: 104 bytes each, united in about a second.
const GROUP_SUMS: u64 = 1 << 20;

/// Adds layers to the stages of a job. Its images do not change. After the loop, when it is known which samples count, groups of
/// tiles are resolved, and the image task writes them.
/// - `layers`: number of layers, plus the equivalent of the features; not 0.
pub fn with_layer_stages(mut stages: Vec<Stage>, tiling: &Tiling, layers: usize) -> Vec<Stage> {
    let find = |stages: &[Stage], kind| stages.iter().position(|stage| stage.kind == kind);
    let (Some(render), Some(mut image)) = (find(&stages, StageKind::Render), stages.pop()) else { return stages };
    let decide = find(&stages, StageKind::Decide);
    stages[render].makes.push(Role::Layers);
    let tile = u64::from(tiling.edge) * u64::from(tiling.edge) * layers as u64;
    let fan = (GROUP_SUMS / tile.max(1)).clamp(1, GROUP_TILES) as u32;
    let groups = (tiling.count() as u32).div_ceil(fan);
    let mut reduce = Stage::per_frame(StageKind::Reduce, vec![(groups, 1)], &[Role::LayerPixels]);
    let reach = Reach::Fan(NonZeroU32::new(fan).unwrap_or(NonZeroU32::MIN));
    reduce.needs.push(Need { stage: render as u16, role: Role::Layers, reach, round: Round::Every });
    if let Some(decide) = decide {
        reduce = reduce.with_need(decide as u16, Role::Stops, Reach::All);
    }
    image = image.with_need(stages.len() as u16, Role::LayerPixels, Reach::All);
    image.makes.push(Role::LayerImage);
    stages.extend([reduce, image]);
    stages
}

/// Returns the tiles as runs of equal numbers of pixels.
fn tile_areas(tiling: &Tiling) -> Vec<(u32, u64)> {
    let areas: Vec<u64> = tiling.rects().map(|rect| rect.area()).collect();
    areas.chunk_by(|a, b| a == b).map(|run| (run.len() as u32, run[0])).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn tiling(film: [u32; 2], edge: u32) -> Tiling {
        Tiling { width: film[0], height: film[1], edge }
    }

    fn kinds(film: [u32; 2], edge: u32, rounds: &[u32]) -> Vec<StageKind> {
        let tiling = tiling(film, edge);
        job_stages(&tiling, rounds, tiles_per_group(&tiling), Method::Pt).iter().map(|stage| stage.kind).collect()
    }

    #[test]
    fn groups_stay_within_their_tile_and_pixel_limits() {
        let fan = |edge| tiles_per_group(&tiling([3840, 2160], edge)).get();
        assert_eq!((fan(16), fan(64), fan(1024)), (256, 64, 1), "64 x 64 x 64 pixels");
    }

    #[test]
    fn the_tiles_of_large_frames_are_reduced_and_one_group_is_none() {
        use StageKind::{Image, Reduce, Render};
        assert_eq!(kinds([512, 512], 64, &[4]), [Render, Image]);
        assert_eq!(kinds([256, 256], 16, &[4]), [Render, Image]);
        assert_eq!(kinds([272, 256], 16, &[4]), [Render, Reduce, Image]);
        let tiling = tiling([100, 50], 32);
        let all = job_stages(&tiling, &[4], NonZeroU32::new(3).unwrap(), Method::Pt);
        assert_eq!(all[0].sizes, [(3, 1024), (1, 128), (3, 576), (1, 72)]);
        assert_eq!(all[1].sizes, [(3, 1)], "8 tiles in threes");
    }

    #[test]
    fn multi_round_stages_decide_keep_sums_and_put_the_image_last() {
        use StageKind::{Decide, Image, Reduce, Render};
        for film in [[64, 64], [272, 256]] {
            assert_eq!(kinds(film, 16, &[4, 8]), [Render, Reduce, Decide, Image]);
        }
        let tiling = tiling([64, 64], 16);
        for fan in [3, 16].map(|fan| NonZeroU32::new(fan).unwrap()) {
            let makes = |rounds: &[u32], role: Role| -> Vec<bool> {
                job_stages(&tiling, rounds, fan, Method::Pt).iter().map(|stage| stage.makes.contains(&role)).collect()
            };
            for role in [Role::Sums, Role::Errors] {
                assert!(!makes(&[8], role).contains(&true));
                assert_eq!(makes(&[4, 8], role), [false, true, false, false]);
            }
            let closes = |rounds: &[u32]| {
                job_stages(&tiling, rounds, fan, Method::Pt).iter().rposition(|stage| stage.closes.is_some())
            };
            assert_eq!((closes(&[8]), closes(&[4, 8, 16])), (None, Some(2)));
        }
    }

    #[test]
    fn light_statistics_add_an_output_and_a_stage_for_many_tiles() {
        let all = |film, rounds: &[u32], method| {
            let tiling = tiling(film, 16);
            let without = job_stages(&tiling, rounds, tiles_per_group(&tiling), method);
            (without.clone(), with_statistics_stages(without))
        };
        for method in [Method::Pt, Method::Fem] {
            for rounds in [&[4][..], &[4, 8]] {
                for (film, more) in [([256, 256], 0), ([272, 256], 1)] {
                    let (without, with) = all(film, rounds, method);
                    assert_eq!(with.len(), without.len() + more);
                    let (image, before) = (with.last().unwrap(), without.last().unwrap());
                    assert_eq!(image.needs[..before.needs.len()], before.needs);
                    assert_eq!(image.makes, [Role::Image, Role::Preview, Role::Statistics]);
                    let stops = image.needs.iter().filter(|need| need.role == Role::Stops);
                    assert_eq!(stops.count(), rounds.len() - 1);
                    let paths = image.needs.iter().find(|need| need.role == Role::Paths).unwrap();
                    assert!(with[usize::from(paths.stage)].makes.contains(&Role::Paths));
                }
            }
        }
    }

    #[test]
    fn first_pass_runs_once_per_world_and_only_tiles_read_it() {
        let (tiling, method) = (tiling([272, 256], 16), Method::Fem);
        for rounds in [&[4][..], &[4, 8]] {
            let without = job_stages(&tiling, rounds, tiles_per_group(&tiling), Method::Pt);
            let with = job_stages(&tiling, rounds, tiles_per_group(&tiling), method);
            let [first_pass, render, others @ ..] = &with[..] else { panic!("{with:?}") };
            assert_eq!((first_pass.kind, first_pass.scope), (StageKind::FirstPass, Scope::Content));
            assert_eq!((&first_pass.sizes[..], &first_pass.makes[..]), (&[(1, 1)][..], &[Role::Field][..]));
            assert_eq!(render.needs.iter().map(|need| need.role).collect::<Vec<_>>(), [Role::Field]);
            assert!(
                others.iter().flat_map(|stage| &stage.needs).all(|need| need.role != Role::Field && need.stage > 0)
            );
            // All other stages are unchanged, with indices greater by one.
            for (stage, before) in [render].into_iter().chain(others).zip(&without) {
                let needs = stage.needs.iter().filter(|need| need.role != Role::Field);
                let needs = needs.map(|need| Need { stage: need.stage - 1, ..*need }).collect();
                let closes = stage.closes.map(|closes| Loop { first: closes.first - 1, ..closes });
                assert_eq!(Stage { needs, closes, ..stage.clone() }, *before);
            }
        }
    }
}
