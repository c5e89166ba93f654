//! Task graphs of jobs: the form of a plan that the farm runs.
//!
//! A frame of one round is rendered, and its image is made from its tiles. The image of a large frame is made from groups of tiles,
//! which are united in parallel with the rendering. The image task then reads less, at the price of two outputs per group.
//!
//! A frame of several rounds always has groups, even if there is only one. A decision closes the loop: it reads the errors of all
//! tiles, some kilobytes, and determines how many samples each tile gets in the next round. The image is made once, after the loop.
//!
//! A method with a first pass runs it before all other stages, once for all frames of one world. Each tile reads its light. The
//! first pass is one task, or many tasks ([`split_first_pass`](crate::split_first_pass)). With [`Method::Femc`], one task then learns the
//! targets of a frame's paths, which its tiles read.
//!
//! With light statistics, each tile outputs, in addition to its sums, the statistics of its samples' paths. When it is known which
//! samples count, the image task unites those of all rounds, for many tiles by groups.

use crate::Method;
use crate::measure::MeasureRequest;
use femc_film::Tiling;
use femc_graph::{Graph, Need, Reach, Role, Round, Scope, StageKind, StageTemplate, TaskSizes, tag};
use std::num::NonZeroU32;

/// Returns a stage of frames with `tasks` equal tasks.
fn per_frame(kind: StageKind, tasks: u32, outputs: &[Role]) -> StageTemplate {
    StageTemplate::new(kind, Scope::Frame, TaskSizes::even(tasks, 1), outputs)
}

/// Returns a graph of these stages, with the tags of their kinds and roles.
pub(crate) fn graph_of(stages: Vec<StageTemplate>) -> Graph {
    let mut graph = Graph { stages };
    graph.add_known_tags();
    graph
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

/// Returns the graph of a job of frames: the first pass and the learning of targets if the method has them; tiles; groups of `fan` tiles if there
/// are more tiles or several rounds; a decision if there are several rounds; the image.
/// - `rounds`: samples a pixel at the end of each round, ascending.
pub fn job_graph(tiling: &Tiling, rounds: &[u32], fan: NonZeroU32, method: Method) -> Graph {
    let groups = (tiling.count() as u32).div_ceil(fan.get());
    let sizes = tiling.rects().map(|rect| (1, rect.area())).collect();
    let mut render = StageTemplate::new(StageKind::Render, Scope::Frame, sizes, &[Role::Tile]).with_steps(rounds);
    let mut all = Vec::new();
    if method.has_first_pass() {
        let sizes = TaskSizes::even(1, 1);
        all.push(StageTemplate::new(StageKind::FirstPass, Scope::Content, sizes, &[Role::Field]));
        render = render.with_input(0, Role::Field, Reach::All);
    }
    if method.has_targets() {
        all.push(per_frame(StageKind::Learn, 1, &[Role::Targets]).with_input(0, Role::Field, Reach::All));
        render = render.with_input(1, Role::Targets, Reach::All);
    }
    let first = all.len() as u16;
    all.push(render);
    let reduce = |outputs: &[Role]| {
        per_frame(StageKind::Reduce, groups, outputs).with_input(first, Role::Tile, Reach::Fan(fan.get()))
    };
    let mut finished = (first + 1, Role::Pixels);
    if rounds.len() > 1 {
        // The reduction continues from its sums of the round before and from the decision of that round. So does the decision.
        let before = |stage, role, reach| Need { stage, role, reach, round: Round::Previous, gaps: false };
        let stops = before(first + 2, Role::Stops, Reach::All);
        let reduce = reduce(&[Role::Pixels, Role::Errors, Role::Sums])
            .with_need(before(first + 1, Role::Sums, Reach::Same))
            .with_need(stops);
        let decide = per_frame(StageKind::Decide, 1, &[Role::Stops])
            .with_input(first + 1, Role::Errors, Reach::All)
            .with_need(stops)
            .with_loop(first, rounds.len() as u32);
        all.extend([reduce, decide]);
    } else if groups > 1 {
        all.push(reduce(&[Role::Pixels]));
    } else {
        finished = (first, Role::Tile);
    }
    let image = per_frame(StageKind::Image, 1, &[Role::Image, Role::Preview]);
    all.push(image.with_input(finished.0, finished.1, Reach::All));
    if method == Method::Femc1998 {
        // Workers of earlier versions cannot read settings with this method.
        all[0].tags.push(tag::GUIDE_1998.to_owned());
    }
    graph_of(all)
}

/// Number of tiles whose paths one task unites, and number of groups of them that one task reads.
const PATHS_FAN: u32 = 256;

/// Adds light statistics to the graph of a job. Its images do not change.
pub fn with_statistics(mut graph: Graph) -> Graph {
    let (render, decide) = (number_of(&graph, StageKind::Render), number_of(&graph, StageKind::Decide));
    let Some(render) = render else { return graph };
    let stages = &mut graph.stages;
    let Some(mut image) = stages.pop() else { return graph };
    stages[usize::from(render)].outputs.push(Role::Paths);
    let tiles = stages[usize::from(render)].tasks();
    let paths = |reach| Need { stage: render, role: Role::Paths, reach, round: Round::Every, gaps: false };
    // The last decision determines which samples count.
    if tiles > PATHS_FAN {
        image = image.with_input(stages.len() as u16, Role::Paths, Reach::All);
        let reduce = per_frame(StageKind::ReducePaths, tiles.div_ceil(PATHS_FAN), &[Role::Paths]);
        stages.push(reduce.with_need(paths(Reach::Fan(PATHS_FAN))));
    } else {
        image = image.with_need(paths(Reach::All));
    }
    if let Some(decide) = decide {
        image = image.with_input(decide, Role::Stops, Reach::All);
    }
    image.outputs.push(Role::Statistics);
    stages.push(image);
    graph_of(graph.stages)
}

/// Adds the geometry of each frame to the graph of a job: its surfaces as triangles, for viewers. Its images do not change. The
/// stage reads nothing, so it runs before the first samples of its frame.
pub fn with_geometry(mut graph: Graph) -> Graph {
    graph.stages.push(per_frame(StageKind::Geometry, 1, &[Role::Geometry]));
    graph_of(graph.stages)
}

/// Adds the finite-element solution of each frame to the graph of a job with a first pass, for viewers. Its images do not change.
pub fn with_solution(mut graph: Graph) -> Graph {
    let makes_light = |stage: &StageTemplate| stage.outputs.contains(&Role::Field);
    let Some(made) = graph.stages.iter().position(makes_light) else { return graph };
    let stage = per_frame(StageKind::Solution, 1, &[Role::Solution]);
    graph.stages.push(stage.with_input(made as u16, Role::Field, Reach::All));
    graph_of(graph.stages)
}

/// Adds the measurement of each frame to the graph of a job. Its images do not change. A graph without stages becomes that of a job
/// that only measures.
pub fn with_measurement(mut graph: Graph, request: &MeasureRequest) -> Graph {
    let tasks = TaskSizes::even(request.tasks(), request.samples_per_task());
    let measure = StageTemplate::new(StageKind::Measure, Scope::Frame, tasks, &[Role::ReadingBlock]);
    let number = graph.stages.len() as u16;
    let join = per_frame(StageKind::JoinReadings, 1, &[Role::Readings]);
    graph.stages.extend([measure, join.with_input(number, Role::ReadingBlock, Reach::All)]);
    graph_of(graph.stages)
}

/// Maximum number of layer sums of a group: 104 bytes each, united in about a second.
const GROUP_SUMS: u64 = 1 << 20;

/// Adds layers to the graph of a job. Its images do not change. After the loop, when it is known which samples count, groups of
/// tiles are resolved, and the image task writes them.
/// - `layers`: number of layers, plus the equivalent of the features; not 0.
pub fn with_layers(mut graph: Graph, tiling: &Tiling, layers: usize) -> Graph {
    let (render, decide) = (number_of(&graph, StageKind::Render), number_of(&graph, StageKind::Decide));
    let Some(render) = render else { return graph };
    let stages = &mut graph.stages;
    let Some(mut image) = stages.pop() else { return graph };
    stages[usize::from(render)].outputs.push(Role::Layers);
    let tile = u64::from(tiling.edge) * u64::from(tiling.edge) * layers as u64;
    let fan = (GROUP_SUMS / tile.max(1)).clamp(1, GROUP_TILES) as u32;
    let groups = (tiling.count() as u32).div_ceil(fan);
    let layers = Need { stage: render, role: Role::Layers, reach: Reach::Fan(fan), round: Round::Every, gaps: false };
    let mut reduce = per_frame(StageKind::ReduceLayers, groups, &[Role::LayerPixels]).with_need(layers);
    if let Some(decide) = decide {
        reduce = reduce.with_input(decide, Role::Stops, Reach::All);
    }
    image = image.with_input(stages.len() as u16, Role::LayerPixels, Reach::All);
    image.outputs.push(Role::LayerImage);
    stages.extend([reduce, image]);
    graph_of(graph.stages)
}

/// Returns the number of the first stage of a kind.
fn number_of(graph: &Graph, kind: StageKind) -> Option<u16> {
    graph.stage_of_kind(kind).map(|(number, _)| number)
}

#[cfg(test)]
mod tests {
    use femc_graph::Loop;

    use super::*;
    use crate::split_first_pass;

    fn tiling(film: [u32; 2], edge: u32) -> Tiling {
        Tiling { width: film[0], height: film[1], edge }
    }

    fn kinds(film: [u32; 2], edge: u32, rounds: &[u32]) -> Vec<StageKind> {
        let tiling = tiling(film, edge);
        kinds_of(&job_graph(&tiling, rounds, tiles_per_group(&tiling), Method::Pt))
    }

    fn kinds_of(graph: &Graph) -> Vec<StageKind> {
        graph.stages.iter().map(|stage| stage.kind).collect()
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
        let all = job_graph(&tiling, &[4], NonZeroU32::new(3).unwrap(), Method::Pt).stages;
        assert_eq!(all[0].sizes.runs(), [(3, 1024), (1, 128), (3, 576), (1, 72)]);
        assert_eq!(all[1].sizes.runs(), [(3, 1)], "8 tiles in threes");
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
                let graph = job_graph(&tiling, rounds, fan, Method::Pt);
                graph.stages.iter().map(|stage| stage.outputs.contains(&role)).collect()
            };
            for role in [Role::Sums, Role::Errors] {
                assert!(!makes(&[8], role).contains(&true));
                assert_eq!(makes(&[4, 8], role), [false, true, false, false]);
            }
            let closes = |rounds: &[u32]| {
                job_graph(&tiling, rounds, fan, Method::Pt).stages.iter().rposition(|stage| stage.closes.is_some())
            };
            assert_eq!((closes(&[8]), closes(&[4, 8, 16])), (None, Some(2)));
        }
    }

    #[test]
    fn light_statistics_add_an_output_and_a_stage_for_many_tiles() {
        let all = |film, rounds: &[u32], method| {
            let tiling = tiling(film, 16);
            let without = job_graph(&tiling, rounds, tiles_per_group(&tiling), method);
            (without.stages.clone(), with_statistics(without).stages)
        };
        for method in [Method::Pt, Method::Fem] {
            for rounds in [&[4][..], &[4, 8]] {
                for (film, more) in [([256, 256], 0), ([272, 256], 1)] {
                    let (without, with) = all(film, rounds, method);
                    assert_eq!(with.len(), without.len() + more);
                    let (image, before) = (with.last().unwrap(), without.last().unwrap());
                    assert_eq!(image.needs[..before.needs.len()], before.needs);
                    assert_eq!(image.outputs, [Role::Image, Role::Preview, Role::Statistics]);
                    let stops = image.needs.iter().filter(|need| need.role == Role::Stops);
                    assert_eq!(stops.count(), rounds.len() - 1);
                    let paths = image.needs.iter().find(|need| need.role == Role::Paths).unwrap();
                    assert!(with[usize::from(paths.stage)].outputs.contains(&Role::Paths));
                }
            }
        }
    }

    #[test]
    fn targets_of_a_frame_are_learned_before_its_tiles() {
        let tiling = tiling([272, 256], 16);
        for (blocks, rounds) in [(1, &[4][..]), (7, &[4, 8])] {
            let graph = job_graph(&tiling, rounds, tiles_per_group(&tiling), Method::Femc);
            let graph = split_first_pass(graph, Method::Femc, blocks);
            let (number, learn) = graph.stage_of_kind(StageKind::Learn).expect("a stage");
            assert_eq!((learn.scope, learn.tasks(), &learn.outputs[..]), (Scope::Frame, 1, &[Role::Targets][..]));
            let (_, render) = graph.stage_of_kind(StageKind::Render).expect("a stage");
            assert_eq!(render.needs.iter().map(|need| need.role).collect::<Vec<_>>(), [Role::Field, Role::Targets]);
            assert_eq!((render.needs[0], render.needs[1].stage), (learn.needs[0], number));
            assert!(graph.stages.iter().all(|stage| stage.tags.iter().any(|own| own == tag::TARGETS)));
            let rounds = graph.rounds(number);
            assert_eq!(rounds, 1, "targets stay the same in all rounds");
        }
    }

    #[test]
    fn geometry_is_a_stage_of_frames_beside_the_others() {
        let tiling = tiling([272, 256], 16);
        for (method, rounds) in [(Method::Pt, &[4][..]), (Method::Fem, &[4, 8])] {
            let without = with_statistics(job_graph(&tiling, rounds, tiles_per_group(&tiling), method));
            let with = with_geometry(without.clone()).stages;
            let (geometry, others) = with.split_last().unwrap();
            assert_eq!((geometry.kind, geometry.scope, geometry.tasks()), (StageKind::Geometry, Scope::Frame, 1));
            assert!(geometry.needs.is_empty() && geometry.outputs == [Role::Geometry]);
            assert!(with.iter().all(|stage| stage.tags.iter().any(|own| own == tag::GEOMETRY)));
            let untagged = |stage: &StageTemplate| StageTemplate { tags: Vec::new(), ..stage.clone() };
            assert!(others.iter().map(untagged).eq(without.stages.iter().map(untagged)));
        }
    }

    #[test]
    fn solution_of_a_frame_reads_the_light_of_its_first_pass() {
        let tiling = tiling([272, 256], 16);
        let graph = |method| with_geometry(with_statistics(job_graph(&tiling, &[4], tiles_per_group(&tiling), method)));
        assert_eq!(with_solution(graph(Method::Pt)), graph(Method::Pt));
        for blocks in [1, 7] {
            let without = split_first_pass(graph(Method::Femc), Method::Femc, blocks);
            let with = with_solution(without.clone()).stages;
            let (solution, others) = with.split_last().unwrap();
            assert_eq!((solution.kind, solution.scope, solution.tasks()), (StageKind::Solution, Scope::Frame, 1));
            assert_eq!(solution.outputs, [Role::Solution]);
            let [need] = solution.needs[..] else { panic!("{:?}", solution.needs) };
            assert_eq!(need.role, Role::Field);
            assert!(others[usize::from(need.stage)].outputs.contains(&Role::Field));
            assert!(with.iter().all(|stage| stage.tags.iter().any(|own| own == tag::SOLUTION)));
            let untagged = |stage: &StageTemplate| StageTemplate { tags: Vec::new(), ..stage.clone() };
            assert!(others.iter().map(untagged).eq(without.stages.iter().map(untagged)));
        }
    }

    #[test]
    fn a_measurement_is_two_stages_beside_the_others_or_alone() {
        let request = MeasureRequest { spp: Some(1 << 18), ..crate::measure::test_request(100) };
        let tiling = tiling([272, 256], 16);
        let without = job_graph(&tiling, &[4, 8], tiles_per_group(&tiling), Method::Fem);
        for others in [without.stages, Vec::new()] {
            let with = with_measurement(Graph { stages: others.clone() }, &request).stages;
            let [before @ .., measure, join] = &with[..] else { panic!("two stages") };
            let untagged = |stage: &StageTemplate| StageTemplate { tags: Vec::new(), ..stage.clone() };
            assert!(before.iter().map(untagged).eq(others.iter().map(untagged)));
            assert_eq!((measure.kind, join.kind), (StageKind::Measure, StageKind::JoinReadings));
            assert_eq!((measure.scope, join.scope), (Scope::Frame, Scope::Frame));
            assert_eq!((measure.sizes.runs(), join.tasks()), (&[(100, 1 << 18)][..], 1));
            assert!(measure.needs.is_empty() && measure.outputs == [Role::ReadingBlock]);
            let number = others.len() as u16;
            let need =
                Need { stage: number, role: Role::ReadingBlock, reach: Reach::All, round: Round::Same, gaps: false };
            assert_eq!((&join.needs[..], &join.outputs[..]), (&[need][..], &[Role::Readings][..]));
            assert!(with.iter().all(|stage| stage.tags.iter().any(|own| own == tag::MEASUREMENTS)));
        }
    }

    #[test]
    fn first_pass_runs_once_per_world_and_only_tiles_read_it() {
        let (tiling, method) = (tiling([272, 256], 16), Method::Fem);
        for rounds in [&[4][..], &[4, 8]] {
            let without = job_graph(&tiling, rounds, tiles_per_group(&tiling), Method::Pt).stages;
            let with = job_graph(&tiling, rounds, tiles_per_group(&tiling), method).stages;
            let [first_pass, render, others @ ..] = &with[..] else { panic!("{with:?}") };
            assert_eq!((first_pass.kind, first_pass.scope), (StageKind::FirstPass, Scope::Content));
            assert_eq!((first_pass.sizes.runs(), &first_pass.outputs[..]), (&[(1, 1)][..], &[Role::Field][..]));
            assert_eq!(render.needs.iter().map(|need| need.role).collect::<Vec<_>>(), [Role::Field]);
            assert!(
                others.iter().flat_map(|stage| &stage.needs).all(|need| need.role != Role::Field && need.stage > 0)
            );
            // All other stages are unchanged, with indices greater by one.
            for (stage, before) in [render].into_iter().chain(others).zip(&without) {
                let needs = stage.needs.iter().filter(|need| need.role != Role::Field);
                let needs = needs.map(|need| Need { stage: need.stage - 1, ..*need }).collect();
                let closes = stage.closes.map(|closes| Loop { first: closes.first - 1, ..closes });
                assert_eq!(stage.tags, [tag::FIRST_PASS]);
                assert_eq!(StageTemplate { needs, closes, tags: Vec::new(), ..stage.clone() }, *before);
            }
        }
    }
}
