//! Drill jobs with iterating and shared stages. Computes the answers of their frames directly from the arithmetic, without a farm.

use bytes::Bytes;
use femc_model::{Digest, Graph, Grid, JobNotes, JobSpec, Need, Reach, Role, Round, Scope, Sizes, StageKind, Template};

use femc_schedule::Config;

use crate::stage::{FRAMES, Stage};

/// Number of values in a block.
const NUMBERS: usize = 16;
/// Placeholder for a scene. Nothing reads it.
const BUNDLE: &[u8] = b"no scene";
/// Cache size that holds the shared stages of one content, but not of two.
pub(crate) const BYTES: u64 = Config::SHARED_OVERHEAD * 3 / 2;

/// Input of a drill: blocks of numbers that iterate. Each round reads all blocks of the previous round.
#[derive(Debug, Clone, Copy)]
struct Content {
    seed: u64,
    blocks: u32,
    rounds: u32,
}

impl Content {
    fn of(number: u64) -> Self {
        Self { seed: number, blocks: 4 + (number % 5) as u32, rounds: 2 + (number / 5 % 2) as u32 }
    }

    /// Builds the graph. Shared stages: the blocks, the end of each round, which the next round reads, and a field from the last
    /// round. Stages of a frame: a pair computed from the field, which may read the pair of the previous frame, and the answer.
    fn graph(&self) -> Graph {
        let drill = |scope, tasks, makes: &[Role]| Template::new(StageKind::Drill, scope, Sizes::even(tasks, 1), makes);
        let before = |stage| Need { stage, role: Role::Numbers, reach: Reach::All, round: Round::Before, gaps: false };
        Graph {
            stages: vec![
                drill(Scope::Content, self.blocks, &[Role::Numbers]).needs(before(0)).needs(before(1)),
                drill(Scope::Content, 1, &[Role::Numbers]).reads(0, Role::Numbers, Reach::All).closes(0, self.rounds),
                drill(Scope::Content, 1, &[Role::Numbers]).reads(0, Role::Numbers, Reach::All),
                drill(Scope::Frame, 2, &[Role::Numbers]).reads(2, Role::Numbers, Reach::All).looks_at(
                    3,
                    Role::Numbers,
                    Reach::Same,
                ),
                drill(Scope::Frame, 1, &[Role::Answer]).reads(3, Role::Numbers, Reach::All),
            ],
        }
    }

    /// Computes the field, which all frames read.
    fn field(&self) -> Vec<u64> {
        let first = |place: u64| mixed(self.seed ^ mixed(place));
        let own = |block: u32| mixed(u64::from(block) << 32);
        let fresh =
            |block: u32| (0..NUMBERS as u64).map(|place| mixed(first(place).wrapping_add(own(block)))).collect();
        let mut blocks: Vec<(u32, Vec<u64>)> = (0..self.blocks).map(|block| (block, fresh(block))).collect();
        for _ in 1..self.rounds {
            let end = joined(&blocks, own(0));
            blocks.push((0, end));
            blocks = (0..self.blocks).map(|block| (block, joined(&blocks, own(block)))).collect();
        }
        joined(&blocks, own(0))
    }
}

/// Sums blocks, weighting block `n` with `2 n + 1`, and adds a number of the task.
fn joined(blocks: &[(u32, Vec<u64>)], own: u64) -> Vec<u64> {
    let times =
        |(block, numbers): &(u32, Vec<u64>), place: usize| numbers[place].wrapping_mul(2 * u64::from(*block) + 1);
    let sum = |place| blocks.iter().fold(0u64, |sum, block| sum.wrapping_add(times(block, place)));
    (0..NUMBERS).map(|place| mixed(sum(place).wrapping_add(own))).collect()
}

/// Hashes a number with SplitMix64.
fn mixed(value: u64) -> u64 {
    let value = value.wrapping_add(0x9e37_79b9_7f4a_7c15);
    let value = (value ^ (value >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    let value = (value ^ (value >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    value ^ (value >> 31)
}

/// Returns the job whose content has this number. Two jobs of one number share their stages.
pub(crate) fn stage(number: u64) -> Stage {
    let content = Content::of(number);
    let field = [(0, content.field())];
    let answer = |frame: &u32| {
        let own = |item: u64| mixed(item << 32 | u64::from(*frame));
        let pair = [0, 1].map(|item| (item, joined(&field, own(item.into()))));
        let numbers = joined(&pair, own(0));
        let bytes: Vec<u8> = numbers.iter().flat_map(|number| number.to_le_bytes()).collect();
        Digest::of(&bytes).to_string()
    };
    let mut spec = JobSpec {
        name: "drill".into(),
        bundle: Digest::of(BUNDLE),
        entry: "drill".into(),
        settings: format!(r#"{{"drill":{{"seed":{number},"numbers":{NUMBERS}}}}}"#),
        frames: FRAMES.to_vec(),
        grid: Grid { film: [1, 1], tile: 1 },
        graph: content.graph(),
        contents: Vec::new(),
        priority: 50,
        owner: "me".into(),
        tags: Vec::new(),
        notes: JobNotes::default(),
    };
    let key = femc_worker::drill_key(&spec);
    spec.contents = key.into_iter().map(|key| (FRAMES.len() as u32, key)).collect();
    Stage {
        spec,
        bundle: Bytes::from_static(BUNDLE),
        result: Role::Answer,
        digests: FRAMES.iter().map(answer).collect(),
        light: (femc_pipeline::Method::Pt, 1),
    }
}
