//! The first pass as many tasks: the steps of [`femc_radiosity`] with a method's options, and the number of blocks.
//!
//! One task solves a small scene. For larger scenes, rays and guides are computed in blocks, which are separate tasks. One task
//! does the steps between. The result is the same to the bit.

use crate::first_pass::options;
use crate::render::RenderError;
use crate::settings::Method;
use crate::stage::{Loop, Need, Reach, Role, Scope, Stage, StageKind};
use femc_prepared::Prepared;
use femc_radiosity::{Aimed, Found, Settled, Sights, Underway};
use femc_scene::Scene;
use std::sync::atomic::AtomicBool;

/// Number of times that rays are cast.
const ROUNDS: u32 = femc_radiosity::ROUNDS;

/// Number of surfaces of a block, and maximum number of blocks.
const SURFACES: u64 = 64;
const MOST_BLOCKS: u64 = 32;
/// Minimum number of blocks that is worth the split.
const LEAST_BLOCKS: u64 = 4;

/// Returns the number of blocks of a scene's first pass; 1: it is one task. The number depends on the surfaces of the scene, each
/// counted as often as it is placed. It is the same for all times, overrides and cameras.
pub fn first_pass_blocks(scene: &Scene) -> u32 {
    let blocks = surfaces(scene) / SURFACES;
    if blocks < LEAST_BLOCKS { 1 } else { blocks.min(MOST_BLOCKS) as u32 }
}

/// Counts faces and curved surfaces, each as often as it is placed.
pub fn surfaces(scene: &Scene) -> u64 {
    let mut known = vec![None; scene.groups.len()];
    count(scene, 0, &mut known)
}

fn count(scene: &Scene, group: usize, known: &mut [Option<u64>]) -> u64 {
    let (Some(of), Some(&count_of)) = (scene.groups.get(group), known.get(group)) else { return 0 };
    if let Some(count) = count_of {
        return count;
    }
    let own = (of.faces.len() + of.quadrics.len()) as u64;
    let placed = of.instances.iter();
    let sum = placed.fold(own, |sum, it| sum.saturating_add(count(scene, it.group.0 as usize, known)));
    known[group] = Some(sum);
    sum
}

/// Returns the number of blocks of a job's first pass, from its stages; 1: it is one task, or there is none.
pub fn blocks_of(stages: &[Stage]) -> u32 {
    let blocks = stages.iter().filter(|stage| stage.kind == StageKind::FirstPassBlock);
    blocks.flat_map(|stage| &stage.sizes).map(|(count, _)| *count).max().unwrap_or(1)
}

/// Returns the stages of a job with its first pass split into `blocks` blocks. A job without a first pass stays unchanged.
pub fn in_blocks(stages: Vec<Stage>, method: Method, blocks: u32) -> Vec<Stage> {
    if blocks <= 1 || stages.first().is_none_or(|stage| stage.kind != StageKind::FirstPass) {
        return stages;
    }
    let mut all = steps(method, blocks);
    // The last one makes the outputs of the first stage of `stages`.
    let more = all.len() as u16 - 1;
    all.extend(stages.into_iter().skip(1).map(|stage| Stage {
        needs: stage.needs.into_iter().map(|need| Need { stage: need.stage + more, ..need }).collect(),
        closes: stage.closes.map(|closes| Loop { first: closes.first + more, ..closes }),
        ..stage
    }));
    all
}

fn steps(method: Method, blocks: u32) -> Vec<Stage> {
    let of =
        |kind, tasks, makes: &[Role]| Stage { scope: Scope::Content, ..Stage::of_frame(kind, vec![(tasks, 1)], makes) };
    let one = |makes: &[Role]| of(StageKind::FirstPass, 1, makes);
    let block = |makes: &[Role]| of(StageKind::FirstPassBlock, blocks, makes);
    let mut all = vec![one(&[Role::Elements, Role::Links])];
    // Stages that make the latest elements and guides.
    let (mut elements, mut guides) = (0, None);
    for round in 1..=ROUNDS {
        let begin = |stage: Stage| {
            let stage = stage.reads(elements, Role::Elements, Reach::All).reads(0, Role::Links, Reach::All);
            guides.map_or(stage.clone(), |guides| stage.reads(guides, Role::Guides, Reach::All))
        };
        let rays = all.len() as u16;
        let is_end = round == ROUNDS && !options(method).guides;
        let settle = begin(one(if is_end { &[Role::Field] } else { &[Role::Elements] }));
        all.push(begin(block(&[Role::Rays])));
        all.push(settle.reads(rays, Role::Rays, Reach::All));
        if is_end {
            break;
        }
        elements = rays + 1;
        if !options(method).guides {
            continue;
        }
        guides = Some(rays + 2);
        let guide = block(&[Role::Guides]).reads(elements, Role::Elements, Reach::All);
        all.push(guide.reads(0, Role::Links, Reach::All).reads(rays, Role::Rays, Reach::All));
        if round == ROUNDS {
            let end = one(&[Role::Field]).reads(elements, Role::Elements, Reach::All);
            all.push(end.reads(0, Role::Links, Reach::All).reads(rays + 2, Role::Guides, Reach::All));
        }
    }
    all
}

/// Creates all elements and links of a prepared frame, as the first step.
/// - errors: `cancel` was set.
pub fn begin(prepared: &Prepared, method: Method, cancel: &AtomicBool) -> Result<Underway, RenderError> {
    Underway::begin(prepared, &options(method), cancel).map_err(|_| RenderError::Cancelled)
}

/// Prepares the state for casting rays.
/// - `found`: results of the blocks of the round before, in order; none before the first rays.
pub fn aim(underway: Underway, prepared: &Prepared, method: Method, found: Vec<Found>) -> Aimed {
    underway.aim(prepared, &options(method), found)
}

/// Applies the ray hits of all blocks, in order.
/// - returns `None` if the hits belong to other elements;
/// - errors: `cancel` was set.
pub fn settle(
    aimed: &Aimed,
    prepared: &Prepared,
    method: Method,
    sights: Vec<Sights>,
    cancel: &AtomicBool,
) -> Result<Option<Settled>, RenderError> {
    aimed.settle(prepared, &options(method), sights, cancel).map_err(|_| RenderError::Cancelled)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::stage::Round;
    use crate::{fan, stages};
    use femc_film::Tiling;

    #[test]
    fn blocks_are_leading_stages_and_tiles_read_the_last_output() {
        let tiling = Tiling { width: 272, height: 256, edge: 16 };
        for (method, count) in [(Method::Fem, 7), (Method::Femc, 11)] {
            for rounds in [&[4][..], &[4, 8]] {
                let whole = stages(&tiling, rounds, fan(&tiling), method);
                assert_eq!((blocks_of(&whole), in_blocks(whole.clone(), method, 1)), (1, whole.clone()));
                let cut = in_blocks(whole.clone(), method, 7);
                assert_eq!((blocks_of(&cut), cut.len()), (7, whole.len() - 1 + count));
                for (number, stage) in cut.iter().enumerate() {
                    for need in &stage.needs {
                        assert!(cut[usize::from(need.stage)].makes.contains(&need.role), "{number}: {need:?}");
                        assert!(usize::from(need.stage) < number || need.round == Round::Before);
                    }
                    let read = |role| {
                        cut.iter().any(|it| {
                            it.needs.iter().any(|need| (usize::from(need.stage), need.role) == (number, role))
                        })
                    };
                    let is_end = stage.makes.contains(&Role::Image);
                    assert!(
                        is_end || stage.makes.iter().all(|&role| read(role)),
                        "{number}: nobody reads {:?}",
                        stage.makes
                    );
                }
                let field = cut.iter().position(|stage| stage.makes == [Role::Field]).unwrap();
                assert_eq!(field, count - 1);
                let readers = cut.iter().filter(|stage| stage.needs.iter().any(|need| need.role == Role::Field));
                assert_eq!(readers.map(|stage| stage.kind).collect::<Vec<_>>(), [StageKind::Render]);
            }
        }
        let paths = stages(&tiling, &[4], fan(&tiling), Method::Pt);
        assert_eq!(in_blocks(paths.clone(), Method::Pt, 7), paths);
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
        femc_import::load(&femc_import::Bundle(bundle), "a.mgf").unwrap().scene
    }

    fn prepared(text: &str) -> Prepared {
        let scene = scene(text);
        crate::prepare_world(&crate::Source::new(scene.into()), &crate::Settings::default(), 1, None).unwrap()
    }

    static CANCEL: AtomicBool = AtomicBool::new(false);

    /// Runs all steps. Each step receives only the bytes of the steps before.
    fn stepped(prepared: &Prepared, method: Method, blocks: u32) -> Vec<u8> {
        let begun = begin(prepared, method, &CANCEL).unwrap();
        let (mut elements, links) = (begun.encode_elements(), begun.encode_links());
        let read = |elements: &[u8]| Underway::decode(prepared, elements, &links).unwrap();
        let mut guides: Vec<Vec<u8>> = Vec::new();
        for round in 0..ROUNDS {
            let aimed = || {
                let found = guides.iter().map(|bytes| Found::decode(bytes).unwrap()).collect();
                aim(read(&elements), prepared, method, found)
            };
            let before = aimed();
            let rays: Vec<Vec<u8>> = (0..blocks).map(|block| before.cast(prepared, block, blocks).encode()).collect();
            let sights = || rays.iter().map(|bytes| Sights::decode(bytes).unwrap()).collect::<Vec<_>>();
            let swapped = sights().into_iter().rev().collect::<Vec<_>>();
            if round == 0 && blocks == 3 && begun.report().elements > 0 {
                assert!(settle(&aimed(), prepared, method, swapped, &CANCEL).unwrap().is_none());
            }
            let settled = settle(&aimed(), prepared, method, sights(), &CANCEL).unwrap().unwrap();
            elements = settled.underway().encode_elements();
            if options(method).guides {
                let after = read(&elements).settled(sights()).unwrap();
                guides = (0..blocks).map(|block| after.guides(prepared, block, blocks).encode()).collect();
            }
        }
        let found = guides.iter().map(|bytes| Found::decode(bytes).unwrap()).collect();
        crate::encode_solution(&read(&elements).solution(prepared, found))
    }

    #[test]
    fn first_pass_in_blocks_has_the_bytes_of_an_undivided_one() {
        for text in [SCENE, EMPTY] {
            let prepared = prepared(text);
            for (method, blocks) in [(Method::Fem, 3), (Method::Femc, 64)] {
                let whole = crate::encode_solution(&crate::first_pass(&prepared, method, &CANCEL).unwrap());
                assert!(stepped(&prepared, method, blocks) == whole, "{method:?} in {blocks}");
            }
        }
    }

    #[test]
    fn what_is_damaged_or_of_another_world_is_refused() {
        let [one, other] = [SCENE.to_owned(), SCENE.replace("f e f g h\n", "")].map(|text| prepared(&text));
        let begun = begin(&one, Method::Femc, &CANCEL).unwrap();
        let (elements, links) = (begun.encode_elements(), begun.encode_links());
        let aimed = aim(begun, &one, Method::Femc, Vec::new());
        let rays = aimed.cast(&one, 0, 1);
        let settled = settle(&aimed, &one, Method::Femc, vec![rays.clone()], &CANCEL).unwrap().unwrap();
        let (rays, guides) = (rays.encode(), settled.guides(&one, 0, 1).encode());
        let small = begin(&other, Method::Femc, &CANCEL).unwrap();
        let [others, links_of_others] = [small.encode_elements(), small.encode_links()];
        assert!(Underway::decode(&other, &elements, &links).is_err());
        assert!(Underway::decode(&other, &others, &links).is_err());
        assert!(Underway::decode(&one, &elements, &links_of_others).is_err());
        assert!(Underway::decode(&one, &links, &links).is_err() && Sights::decode(&guides).is_err());
        assert!(small.settled(vec![Sights::decode(&rays).unwrap()]).is_err());
        for cut in [1, 2, 9, 101, usize::MAX] {
            let of = |bytes: &[u8]| bytes[..bytes.len().saturating_sub(cut)].to_vec();
            assert!(Underway::decode(&one, &of(&elements), &links).is_err());
            assert!(Underway::decode(&one, &elements, &of(&links)).is_err());
            assert!(Sights::decode(&of(&rays)).is_err() && Found::decode(&of(&guides)).is_err());
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
