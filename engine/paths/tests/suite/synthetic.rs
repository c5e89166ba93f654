//! A synthetic renderer: a path is a function of seed and key.

use femc_math::elementary::ln;
use femc_math::hash::{combine, unit_f32};
use femc_paths::statistics::depth_rank;
use femc_paths::{
    InteractionKind, Intersection, LightPath, LightRecord, LightStatistics, LightTechnique, Name, NameKind, PathEnd,
    PathKey, PortionKey, SampleCounters, Scope,
};
use std::ops::Range;

pub(crate) const SEED: u64 = 7;

/// Creates the scope of a film of 5 x 3 tiles, with narrower tiles at the end of each row and column.
pub(crate) fn scope(keep: u32) -> Scope {
    Scope {
        seed: SEED,
        frame: 3,
        film: [36, 20],
        tile_size: 8,
        lower: [-2.0, 0.0, 0.0],
        upper: [4.0, 3.0, 2.5],
        max_records: keep,
        sketch_size: 3,
        has_full_histograms: false,
    }
}

pub(crate) fn tiles(scope: &Scope) -> Range<u32> {
    let [columns, rows] = scope.film.map(|size| size.div_ceil(scope.tile_size));
    0..columns * rows
}

pub(crate) const OBJECTS: [&str; 5] = ["room.floor", "room.wall", "plant", "lamp", ""];

/// Random numbers of one path.
struct PathRandom(u64);

impl PathRandom {
    fn next(&mut self) -> f32 {
        self.0 = combine(&[self.0, 1]);
        unit_f32((self.0 >> 32) as u32)
    }

    fn below(&mut self, count: u32) -> u32 {
        (self.next() * count as f32) as u32
    }
}

/// Checks whether the way from the camera to an intersection leads through another one, by their indices.
pub(crate) fn leads_through(path: &LightPath, mut to: usize, through: usize) -> bool {
    while let Some(before) = (path.intersections[to].parent as usize).checked_sub(1) {
        if before == through {
            return true;
        }
        to = before;
    }
    false
}

pub(crate) fn path(scope: &Scope, key: PathKey) -> LightPath {
    let mut rolls = PathRandom(combine(&[SEED, u64::from(key.frame), u64::from(key.pixel), u64::from(key.sample)]));
    let (x, y) = (key.pixel % scope.film[0], key.pixel / scope.film[0]);
    let count = (-ln(rolls.next().max(1e-6)) * 3.0) as u32;
    // One in four paths is split: some of its intersections follow an earlier one.
    let hash = |number: u32| combine(&[SEED, 2, u64::from(key.pixel), u64::from(key.sample), u64::from(number)]) as u32;
    let is_branched = hash(0) % 4 == 0;
    let parents: Vec<u32> =
        (0..count).map(|bounce| if is_branched && bounce >= 2 { 1 + hash(bounce) % bounce } else { bounce }).collect();
    let mut throughput = [1.0f32; 3];
    let (mut intersections, mut lights) = (Vec::new(), Vec::new());
    for bounce in 0..count {
        let part = [x as f64 / scope.film[0] as f64, y as f64 / scope.film[1] as f64, 0.5];
        let spread = f64::from(bounce) / 4.0;
        let position = std::array::from_fn(|axis| {
            let own = part[axis] + spread * f64::from(rolls.next() - 0.5);
            scope.lower[axis] + own.clamp(0.0, 1.0) * (scope.upper[axis] - scope.lower[axis])
        });
        let object = rolls.below(5) as usize;
        let ways =
            [InteractionKind::Diffuse, InteractionKind::Glossy, InteractionKind::Reflection, InteractionKind::Volume];
        intersections.push(Intersection {
            parent: parents[bounce as usize],
            bounce,
            position,
            radiance: [rolls.next() * 30.0, rolls.next() * 20.0, rolls.next() * 10.0],
            throughput,
            object: Name::new(NameKind::Object, OBJECTS[object]),
            material: Name::new(NameKind::Material, ["white", "metal"][object % 2]),
            interaction: ways[rolls.below(4) as usize],
        });
        lights.push(LightRecord {
            // Light of the segment that leads here belongs to the intersection before.
            vertex: if is_branched && bounce % 2 == 0 { parents[bounce as usize] } else { bounce + 1 },
            order: if is_branched && bounce % 2 == 0 { bounce } else { bounce + 1 },
            light: Name::new(NameKind::Lamp, ["lamp a", "lamp b"][rolls.below(2) as usize]),
            medium: Name::NONE,
            radiance: [rolls.next(); 3],
            occluder: (rolls.next() < 0.2).then(|| Name::new(NameKind::Object, OBJECTS[rolls.below(4) as usize])),
            technique: LightTechnique::NextEvent,
        });
        throughput = throughput.map(|factor| factor * (0.4 + 0.6 * rolls.next()));
    }
    let bright = if rolls.next() < 0.002 { 5e4 } else { 1.0 };
    let radiance = throughput.map(|factor| factor * bright * (1.0 + x as f32) * -ln(rolls.next().max(1e-6)));
    let end = if count == 0 {
        PathEnd::Escaped
    } else {
        [PathEnd::Absorbed, PathEnd::Roulette, PathEnd::Depth][rolls.below(3) as usize]
    };
    // The lights' parts add up to the sample. A path without intersections has no radiance.
    let parts: f32 = lights.iter().map(|it: &LightRecord| it.radiance[0]).sum();
    lights.iter_mut().for_each(|it| it.radiance = radiance.map(|all| all * it.radiance[0] / parts));
    let radiance = if count == 0 { [0.0; 3] } else { radiance };
    let mut path = LightPath { key, radiance, throughput, depth: 0, end, intersections, lights };
    path.depth = path.levels().into_iter().max().unwrap_or(0);
    path
}

/// Checks whether a sample is invalid. A few samples are.
pub(crate) fn is_bad(key: PathKey) -> bool {
    combine(&[9, u64::from(key.pixel), u64::from(key.sample)]).is_multiple_of(997)
}

/// Returns the statistics of a task of a tile: all samples of a range.
pub(crate) fn task(scope: &Scope, tile: u32, samples: Range<u32>) -> LightStatistics {
    record_task(scope, tile, samples, 0.5, |statistics, key| statistics.must_record(key))
}

/// Returns the statistics of a task, with another share and another choice of records.
pub(crate) fn record_task(
    scope: &Scope,
    tile: u32,
    samples: Range<u32>,
    share: f64,
    wants: impl Fn(&LightStatistics, PathKey) -> bool,
) -> LightStatistics {
    let mut statistics = LightStatistics::new(*scope, share);
    let mut counters = [0, 1].map(|_| SampleCounters::with_pixels(scope.tile_area(tile) as usize));
    for (kind, texts) in [
        (NameKind::Object, &OBJECTS[..4]),
        (NameKind::Material, &["white", "metal"][..]),
        (NameKind::Lamp, &["lamp a", "lamp b"][..]),
    ] {
        for text in texts {
            statistics.names.insert(Name::new(kind, text), (kind, (*text).to_owned()));
        }
    }
    for (place, pixel) in scope.tile_pixels(tile).enumerate() {
        for sample in samples.clone() {
            let key = PathKey { frame: scope.frame, pixel, sample };
            let counters = &mut counters[usize::from(key.half())];
            if is_bad(key) {
                counters.invalid += 1;
                continue;
            }
            let path = path(scope, key);
            counters.count(path.luminance(), path.depth, path.end);
            let throughput = path.throughput.into_iter().fold(0.0, f32::max);
            if scope.has_full_histograms {
                counters.count_bins(scope, &path);
            }
            counters.pixels[place].count(path.luminance(), throughput, path.depth);
            let order = (key.hash(scope.seed), key);
            if wants(&statistics, key) {
                statistics.paths.insert(order, path.clone());
            }
            statistics.brightest.insert(order, path.clone());
            if depth_rank(&path).is_some() {
                statistics.deepest.insert(order, path);
            }
        }
    }
    for (half, counters) in (0..).zip(counters) {
        statistics.portions.insert(PortionKey { tile, half, begin: samples.start, end: samples.end }, counters);
    }
    statistics.trim();
    statistics
}

/// Rounds of samples.
pub(crate) const ROUNDS: [Range<u32>; 3] = [0..4, 4..8, 8..16];

/// All tasks of a frame, in order.
pub(crate) fn tasks(scope: &Scope) -> Vec<LightStatistics> {
    tiles(scope).flat_map(|tile| ROUNDS.map(|round| task(scope, tile, round))).collect()
}

pub(crate) fn merge_parts(scope: &Scope, parts: impl IntoIterator<Item = LightStatistics>) -> LightStatistics {
    let mut all = LightStatistics::new(*scope, 0.5);
    all.merge_all(parts).unwrap_or_else(|e| panic!("{e}"));
    all
}

/// Returns ends of halves as an error rule might leave them: some end one or two rounds before the last one.
pub(crate) fn ends(tile: u32, half: u8) -> u32 {
    [16, 8, 16, 4, 8][(2 * tile + u32::from(half)) as usize % 5]
}
