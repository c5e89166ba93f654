//! The first pass as many tasks: the stages of a solver's steps ([`Solver`](crate::Solver)), and the number
//! of blocks.
//!
//! One task solves a small scene. For larger scenes, rays are cast in blocks, which are separate tasks. One task does the steps
//! between. The result is the same to the bit.

use crate::settings::Method;
use crate::solver::solver;
use crate::stage::graph_of;
use femc_graph::{Graph, Loop, Need, Reach, Role, Scope, StageKind, StageTemplate, TaskSizes};
use femc_scene::Scene;

/// Number of surfaces of a block, and maximum number of blocks.
const SURFACES_PER_BLOCK: u64 = 64;
const MAX_BLOCKS: u64 = 32;
/// Minimum number of blocks that is worth the split.
const MIN_BLOCKS: u64 = 4;

/// Returns the number of blocks of a scene's first pass; 1: it is one task. The number depends on the surfaces of the scene, each
/// counted as often as it is placed. It is the same for all times, overrides and cameras.
pub fn first_pass_blocks(scene: &Scene) -> u32 {
    let blocks = count_surfaces(scene) / SURFACES_PER_BLOCK;
    if blocks < MIN_BLOCKS { 1 } else { blocks.min(MAX_BLOCKS) as u32 }
}

/// Counts faces and curved surfaces, each as often as it is placed.
pub fn count_surfaces(scene: &Scene) -> u64 {
    let mut known = vec![None; scene.groups.len()];
    count_group_surfaces(scene, 0, &mut known)
}

fn count_group_surfaces(scene: &Scene, group: usize, known: &mut [Option<u64>]) -> u64 {
    let (Some(of), Some(&count_of)) = (scene.groups.get(group), known.get(group)) else { return 0 };
    if let Some(count) = count_of {
        return count;
    }
    let own = (of.faces.len() + of.quadrics.len()) as u64;
    let placed = of.instances.iter();
    let sum = placed.fold(own, |sum, it| sum.saturating_add(count_group_surfaces(scene, it.group.0 as usize, known)));
    known[group] = Some(sum);
    sum
}

/// Returns the number of blocks of a job's first pass, from its graph; 1: it is one task, or there is none.
pub fn planned_first_pass_blocks(graph: &Graph) -> u32 {
    graph.stage_of_kind(StageKind::FirstPassRays).map_or(1, |(_, stage)| stage.tasks())
}

/// Returns the graph of a job with its first pass split into `blocks` blocks. A job without a first pass stays unchanged.
pub fn split_first_pass(graph: Graph, method: Method, blocks: u32) -> Graph {
    if blocks <= 1 || graph.stages.first().is_none_or(|stage| stage.kind != StageKind::FirstPass) {
        return graph;
    }
    let mut all = first_pass_stages(method, blocks);
    // The last one makes the outputs of the first stage of `graph`.
    let more = all.len() as u16 - 1;
    all.extend(graph.stages.into_iter().skip(1).map(|stage| StageTemplate {
        needs: stage.needs.into_iter().map(|need| Need { stage: need.stage + more, ..need }).collect(),
        closes: stage.closes.map(|closes| Loop { first: closes.first + more, ..closes }),
        ..stage
    }));
    graph_of(all)
}

fn first_pass_stages(method: Method, blocks: u32) -> Vec<StageTemplate> {
    let step = |kind, tasks, role| StageTemplate::new(kind, Scope::Content, TaskSizes::even(tasks, 1), &[role]);
    let one = |kind| step(kind, 1, Role::SolverState);
    let block = |kind| step(kind, blocks, Role::SolverState);
    let read = |stage: StageTemplate, from: &[u16]| {
        from.iter().fold(stage, |stage, &number| stage.with_input(number, Role::SolverState, Reach::All))
    };
    let rounds = solver(method).rounds();
    let mut all = vec![one(StageKind::FirstPassStart)];
    // Stages that made the latest elements, the links, and the rays of this round.
    let mut latest = vec![0];
    for round in 1..=rounds {
        let rays = all.len() as u16;
        all.push(read(block(StageKind::FirstPassRays), &latest));
        latest.push(rays);
        // The last stage applies the last rays.
        if round < rounds {
            all.push(read(one(StageKind::FirstPassSolve), &latest));
            latest = vec![rays + 1, 0];
        }
    }
    all.push(read(step(StageKind::FirstPassFinish, 1, Role::Field), &latest));
    all
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::solver::BlockOutput;
    use crate::{StepDecodeError, job_graph, tiles_per_group};
    use femc_film::Tiling;
    use femc_graph::{Round, tag};
    use femc_prepared::Prepared;
    use femc_radiosity::SolverState;
    use std::collections::BTreeSet;
    use std::sync::atomic::AtomicBool;

    #[test]
    fn blocks_are_leading_stages_and_tiles_read_the_last_output() {
        let tiling = Tiling { width: 272, height: 256, edge: 16 };
        for (method, count) in [(Method::Fem, 7), (Method::Femc, 7), (Method::Femc1998, 7)] {
            for rounds in [&[4][..], &[4, 8]] {
                let whole = job_graph(&tiling, rounds, tiles_per_group(&tiling), method);
                assert_eq!(
                    (planned_first_pass_blocks(&whole), split_first_pass(whole.clone(), method, 1)),
                    (1, whole.clone())
                );
                let cut = split_first_pass(whole.clone(), method, 7);
                assert_eq!((planned_first_pass_blocks(&cut), cut.stages.len()), (7, whole.stages.len() - 1 + count));
                let tags: BTreeSet<&str> = match method {
                    Method::Femc1998 => [tag::FIRST_PASS, tag::TASK_KINDS, tag::GUIDE_1998].into(),
                    Method::Femc => [tag::FIRST_PASS, tag::TARGETS, tag::TASK_KINDS].into(),
                    _ => [tag::FIRST_PASS, tag::TASK_KINDS].into(),
                };
                let tags_of = |stage: &StageTemplate| stage.tags.iter().cloned().collect::<BTreeSet<String>>();
                assert!(cut.stages.iter().all(|stage| tags_of(stage).iter().eq(tags.iter())));
                let cut = cut.stages;
                for (number, stage) in cut.iter().enumerate() {
                    for need in &stage.needs {
                        assert!(cut[usize::from(need.stage)].outputs.contains(&need.role), "{number}: {need:?}");
                        assert!(usize::from(need.stage) < number || need.round == Round::Previous);
                    }
                    let read = |role| {
                        cut.iter().any(|it| {
                            it.needs.iter().any(|need| (usize::from(need.stage), need.role) == (number, role))
                        })
                    };
                    let is_end = stage.outputs.contains(&Role::Image);
                    assert!(
                        is_end || stage.outputs.iter().all(|&role| read(role)),
                        "{number}: nobody reads {:?}",
                        stage.outputs
                    );
                }
                let field = cut.iter().position(|stage| stage.outputs == [Role::Field]).unwrap();
                assert_eq!(field, count - 1);
                let readers = cut.iter().filter(|stage| stage.needs.iter().any(|need| need.role == Role::Field));
                let kinds = readers.map(|stage| stage.kind).collect::<Vec<_>>();
                let learn: &[StageKind] = if method == Method::Femc { &[StageKind::Learn] } else { &[] };
                assert_eq!(kinds, [learn, &[StageKind::Render]].concat());
            }
        }
        let paths = job_graph(&tiling, &[4], tiles_per_group(&tiling), Method::Pt);
        assert_eq!(split_first_pass(paths.clone(), Method::Pt, 7), paths);
    }

    /// A wall with a gap, a lamp behind it, a sphere, and fog. It gives patches, curved elements, clusters and boxes.
    const SCENE: &str = "camera main =\n  origin 0 -1.5 1\n  target 0 0 1\n  fov 60\n  film 8 8\n
medium haze =\n  sigma_s 0.1\nmbox haze -2 -2 0 2 2 2\n
m gray =\n  c\n  rd 0.6\n  sides 2\nm bright =\n  c\n  ed 2000\n
v a =\n  p -2 -2 0\nv b =\n  p 2 -2 0\nv c =\n  p 2 2 0\nv d =\n  p -2 2 0\n
v e =\n  p -2 0.5 0\nv f =\n  p 1.6 0.5 0\nv g =\n  p 1.6 0.5 2\nv h =\n  p -2 0.5 2\n
v i =\n  p 0.5 -0.5 0.4\nv j =\n  p -1 1.5 1\n
m gray\nf a b c d\nf e f g h\nsph i 0.3\nm bright\nsph j 0.2\n";

    const EMPTY: &str = "camera main =\n  target 0 1 0\n  film 8 8\nm gray =\n  rd 0.6\n";

    fn scene(text: &str) -> Scene {
        let bundle = std::collections::BTreeMap::from([("a.mgf".to_owned(), text.as_bytes().to_vec())]);
        femc_import::load_scene(&femc_import::Bundle(bundle), "a.mgf").unwrap().scene
    }

    fn prepare_scene(text: &str) -> Prepared {
        let scene = scene(text);
        crate::prepare_world(&crate::SceneSource::new(scene.into()), &crate::Settings::default(), 1, None).unwrap()
    }

    static CANCEL: AtomicBool = AtomicBool::new(false);

    /// Runs all steps. Each step receives only the bytes of the steps before.
    fn solve_in_steps(prepared: &Prepared, method: Method, blocks: u32) -> Vec<u8> {
        let solver = solver(method);
        let begun = solver.begin(prepared, &CANCEL).unwrap();
        let (start, mut latest) = (begun.encode_start(), None::<Vec<u8>>);
        let linked = |latest: &Option<Vec<u8>>| solver.decode(prepared, &start, latest.as_deref()).unwrap();
        let mut solution = None;
        for round in 0..solver.rounds() {
            let aimed = || linked(&latest).before_rays(prepared);
            let before = aimed();
            let rays: Vec<Vec<u8>> = (0..blocks).map(|block| before.cast(prepared, block, blocks)).collect();
            let hits = || -> Vec<BlockOutput> { rays.iter().map(|rays| solver.decode_rays(rays).unwrap()).collect() };
            let swapped = hits().into_iter().rev().collect();
            if round == 0 && blocks == 3 && begun.report().elements > 0 {
                assert!(aimed().apply(prepared, swapped, &CANCEL).unwrap().is_none());
                let others = vec![BlockOutput::new(())];
                assert!(aimed().apply(prepared, others, &CANCEL).unwrap().is_none(), "outputs of another solver");
            }
            let settled = aimed().apply(prepared, hits(), &CANCEL).unwrap().unwrap();
            latest = Some(settled.encode_elements());
            solution = Some(settled.solution(prepared));
        }
        let solution = crate::encode_solution(&solution.expect("a round"));
        assert!(crate::encode_solution(&linked(&latest).solution(prepared)) == solution, "the state as bytes");
        solution
    }

    #[test]
    fn first_pass_in_blocks_has_the_bytes_of_an_undivided_one() {
        for text in [SCENE, EMPTY] {
            let prepared = prepare_scene(text);
            for (method, blocks) in [(Method::Fem, 3), (Method::Femc, 64), (Method::Femc1998, 5)] {
                let whole = crate::encode_solution(&crate::solve_first_pass(&prepared, method, &CANCEL).unwrap());
                assert!(solve_in_steps(&prepared, method, blocks) == whole, "{method:?} in {blocks}");
            }
        }
    }

    #[test]
    fn what_is_damaged_or_of_another_world_is_refused() {
        let [one, other] = [SCENE.to_owned(), SCENE.replace("f e f g h\n", "")].map(|text| prepare_scene(&text));
        let solver = solver(Method::Femc);
        let begun = solver.begin(&one, &CANCEL).unwrap();
        let start = begun.encode_start();
        let aimed = begun.before_rays(&one);
        let rays = aimed.cast(&one, 0, 1);
        let hits = |bytes: &[u8]| solver.decode_rays(bytes);
        let settled = aimed.apply(&one, vec![hits(&rays).unwrap()], &CANCEL).unwrap().unwrap();
        let latest = settled.encode_elements();
        let small = solver.begin(&other, &CANCEL).unwrap();
        let start_of_other = small.encode_start();
        let (elements, links) = SolverState::split_start(&start).unwrap();
        let (others, links_of_others) = SolverState::split_start(&start_of_other).unwrap();
        let join = |elements: &[u8], links: &[u8]| [&(elements.len() as u64).to_le_bytes(), elements, links].concat();
        let decode = |start: &[u8], latest: Option<&[u8]>| solver.decode(&one, start, latest).map(|_| ());
        assert_eq!((decode(&start, None), decode(&start, Some(&latest))), (Ok(()), Ok(())));
        assert!(solver.decode(&other, &start, None).is_err());
        assert!(solver.decode(&other, &join(others, links), None).is_err());
        assert!(decode(&start_of_other, None).is_err() && decode(&join(elements, links_of_others), None).is_err());
        assert!(decode(&start, Some(others)).is_err() && decode(&start, Some(links)).is_err());
        assert!(decode(&join(links, links), None).is_err() && hits(links).is_err());
        let rays_of_one = vec![hits(&rays).unwrap()];
        assert!(small.before_rays(&other).apply(&other, rays_of_one, &CANCEL).unwrap().is_none());
        for cut in [1, 2, 9, 101, usize::MAX] {
            let of = |bytes: &[u8]| bytes[..bytes.len().saturating_sub(cut)].to_vec();
            assert!(decode(&of(&start), None).is_err() && decode(&start, Some(&of(&latest))).is_err());
            assert!(decode(&join(&of(elements), links), None).is_err());
            assert!(hits(&of(&rays)).is_err());
        }
        assert!(decode(&start[..7], None).is_err() && decode(&start[..99], None).is_err());
        for bytes in [latest, rays] {
            let mut other = bytes;
            other[8] += 1;
            let error = decode(&start, Some(&other)).unwrap_err();
            assert_eq!(error, StepDecodeError::Version(2));
            assert!(error.to_string().contains("has version 2, and this program reads only version 1"), "{error}");
            assert_eq!(hits(&other).map(|_| ()).unwrap_err(), error);
        }
    }

    #[test]
    fn large_scenes_get_more_blocks_and_small_scenes_get_one() {
        let with = |faces: usize| {
            let (text, _) = SCENE.split_once("f a b c d").unwrap();
            first_pass_blocks(&scene(&format!("{text}{}", "f a b c d\n".repeat(faces))))
        };
        assert_eq!([0, 30, 255, 256, 1000, 1 << 20].map(with), [1, 1, 1, 4, 15, 32]);
    }
}
