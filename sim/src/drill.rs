//! Drill jobs with iterating and shared stages. Computes the answers of their frames directly from the arithmetic, without a farm.

use bytes::Bytes;
use femc_model::{
    Digest, Graph, Grid, JobNotes, JobSpec, Need, Reach, Role, Round, Scope, StageKind, StageTemplate, TaskSizes,
};

use femc_schedule::Config;

use crate::test_jobs::{FRAMES, TestJob};

/// Number of values in a block.
const NUMBERS: usize = 16;
/// Placeholder for a scene. Nothing reads it.
const BUNDLE: &[u8] = b"no scene";
/// Cache size that holds the shared stages of one content, but not of two.
pub(crate) const CACHE_BYTES: u64 = Config::SHARED_OVERHEAD * 3 / 2;

/// Input of a drill: blocks of numbers that iterate. Each round reads all blocks of the previous round.
#[derive(Debug, Clone, Copy)]
struct Content {
    seed: u64,
    blocks: u32,
    rounds: u32,
}

impl Content {
    fn from_number(number: u64) -> Self {
        Self { seed: number, blocks: 4 + (number % 5) as u32, rounds: 2 + (number / 5 % 2) as u32 }
    }

    /// Builds the graph. Shared stages: the blocks, the end of each round, which the next round reads, and a field from the last
    /// round. Stages of a frame: a pair computed from the field, which may read the pair of the previous frame, and the answer.
    fn graph(&self) -> Graph {
        let drill = |scope, tasks, makes: &[Role]| {
            StageTemplate::new(StageKind::Drill, scope, TaskSizes::even(tasks, 1), makes)
        };
        let before =
            |stage| Need { stage, role: Role::Numbers, reach: Reach::All, round: Round::Previous, gaps: false };
        Graph {
            stages: vec![
                drill(Scope::Content, self.blocks, &[Role::Numbers]).with_need(before(0)).with_need(before(1)),
                drill(Scope::Content, 1, &[Role::Numbers])
                    .with_input(0, Role::Numbers, Reach::All)
                    .with_loop(0, self.rounds),
                drill(Scope::Content, 1, &[Role::Numbers]).with_input(0, Role::Numbers, Reach::All),
                drill(Scope::Frame, 2, &[Role::Numbers]).with_input(2, Role::Numbers, Reach::All).with_hint(
                    3,
                    Role::Numbers,
                    Reach::Same,
                ),
                drill(Scope::Frame, 1, &[Role::Answer]).with_input(3, Role::Numbers, Reach::All),
            ],
        }
    }

    /// Computes the field, which all frames read.
    fn field(&self) -> Vec<u64> {
        let first = |place: u64| mix(self.seed ^ mix(place));
        let own = |block: u32| mix(u64::from(block) << 32);
        let fresh = |block: u32| (0..NUMBERS as u64).map(|place| mix(first(place).wrapping_add(own(block)))).collect();
        let mut blocks: Vec<(u32, Vec<u64>)> = (0..self.blocks).map(|block| (block, fresh(block))).collect();
        for _ in 1..self.rounds {
            let end = weighted_sum(&blocks, own(0));
            blocks.push((0, end));
            blocks = (0..self.blocks).map(|block| (block, weighted_sum(&blocks, own(block)))).collect();
        }
        weighted_sum(&blocks, own(0))
    }
}

/// Sums blocks, weighting block `n` with `2 n + 1`, and adds a number of the task.
fn weighted_sum(blocks: &[(u32, Vec<u64>)], own: u64) -> Vec<u64> {
    let times =
        |(block, numbers): &(u32, Vec<u64>), place: usize| numbers[place].wrapping_mul(2 * u64::from(*block) + 1);
    let sum = |place| blocks.iter().fold(0u64, |sum, block| sum.wrapping_add(times(block, place)));
    (0..NUMBERS).map(|place| mix(sum(place).wrapping_add(own))).collect()
}

/// Hashes a number with SplitMix64.
fn mix(value: u64) -> u64 {
    let value = value.wrapping_add(0x9e37_79b9_7f4a_7c15);
    let value = (value ^ (value >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    let value = (value ^ (value >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    value ^ (value >> 31)
}

/// Returns the job whose content has this number. Two jobs of one number share their stages.
pub(crate) fn drill_job(number: u64) -> TestJob {
    let content = Content::from_number(number);
    let field = [(0, content.field())];
    let answer = |frame: &u32| {
        let own = |item: u64| mix(item << 32 | u64::from(*frame));
        let pair = [0, 1].map(|item| (item, weighted_sum(&field, own(item.into()))));
        let numbers = weighted_sum(&pair, own(0));
        let bytes: Vec<u8> = numbers.iter().flat_map(|number| number.to_le_bytes()).collect();
        Digest::compute(&bytes).to_string()
    };
    let mut spec = JobSpec {
        name: "drill".into(),
        bundle: Digest::compute(BUNDLE),
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
    TestJob {
        spec,
        bundle: Bytes::from_static(BUNDLE),
        result_role: Role::Answer,
        digests: FRAMES.iter().map(answer).collect(),
        method_and_blocks: (femc_pipeline::Method::Pt, 1),
    }
}
