//! Pilot paths of one block, and the recorder that learns from them.

use crate::bins::LeafBins;
use crate::openings::Line;
use crate::shares::DirectionRecord;
use crate::sums::{MAX_VALUE, PositionGrid, SumsByBin, SumsByVoxel};
use femc_field::{PACK_TARGETS, Target, TargetDirections, TargetGuide};
use femc_geometry::Ray;
use femc_math::Rgb;
use femc_math::color::luminance;
use femc_math::glam::Vec3A;
use femc_montecarlo::record::{
    BranchEvent, Continuation, Contribution, Direction, Expectation, LightTechnique, RecordLevel, Recorder,
    Termination, Vertex,
};
use femc_montecarlo::{FRAME_SHARE, Guidance, PathSettings, PixelFilter, Tracer, WeightWindow};
use femc_prepared::Prepared;
use std::ops::Range;

/// Key of the random numbers of pilot paths.
const SEED: u64 = 0x706f_696e_7465_7273;
/// Light along a direction, relative to the light expected, from which on it is a surprise.
const SURPRISE: f32 = 8.0;
/// Maximum number of surprising lines of a block.
const MAX_LINES: usize = 1024;
/// Maximum number of directions that a block records. Paths after that add no directions.
pub const MAX_DIRECTIONS: usize = 1 << 16;
/// Reach of a direction that leaves the scene, m.
const FAR: f32 = 1e6;
/// Margin by which a segment that ends on a target is extended, relative to its length. Positions are rounded.
const MARGIN: f32 = 1e-3;

/// Filter of pilot paths: the square of a pixel.
#[derive(Clone, Copy)]
struct SquareFilter;

impl PixelFilter for SquareFilter {
    fn sample(self, u: [f32; 2]) -> [f32; 2] {
        [u[0] - 0.5, u[1] - 0.5]
    }

    fn density(self, offset: [f32; 2]) -> f32 {
        if offset.iter().all(|at| at.abs() <= 0.5) { 1.0 } else { 0.0 }
    }
}

/// Traces the pilot paths with numbers in a range.
/// - `guidance`: guidance of the paths by a field and by the guide of `pilot`;
/// - `count`: number of paths of the round, which are spread evenly over the film.
pub fn trace_block<'a>(
    scene: &Prepared,
    guidance: Guidance<'_>,
    mut pilot: Pilot<'a>,
    paths: Range<u32>,
    count: u32,
) -> Pilot<'a> {
    // A path without branches has one direction at each vertex.
    let window = WeightWindow { upper: f32::INFINITY, ..guidance.window };
    let settings = PathSettings { seed: SEED, max_depth: 0, single_technique: None };
    pilot.floor = FRAME_SHARE * guidance.frame_light;
    let mut tracer = Tracer::with_recorder(scene, settings, pilot).with_guidance(Guidance { window, ..guidance });
    let pixels = scene.camera.film.map(u64::from).iter().product::<u64>();
    for path in paths {
        let pixel = u64::from(path) * pixels / u64::from(count) % pixels.max(1);
        tracer.recorder.number = path;
        let sample = tracer.sample(pixel as u32, path, SquareFilter);
        tracer.recorder.end_sample(Some(sample.color));
    }
    let rays = tracer.counters.rays + tracer.counters.shadow_rays;
    Pilot { rays, ..tracer.recorder }
}

/// Drops all but the lines of most weight. Equal ones are ordered by their numbers.
pub fn keep_heaviest(lines: &mut Vec<(Line, u64)>, most: usize) {
    lines.sort_by(|a, b| b.0.weight.total_cmp(&a.0.weight).then(a.1.cmp(&b.1)));
    lines.truncate(most);
}

/// Places that directions can reach.
pub struct PilotPlaces {
    /// Bins of the leaves of flat surfaces.
    pub bins: Vec<Option<LeafBins>>,
    /// Positions of all else.
    pub grid: PositionGrid,
}

/// Recorder of pilot paths.
pub struct Pilot<'a> {
    /// Directions that paths took.
    pub records: Vec<DirectionRecord>,
    /// Sums by bin of a leaf that directions reached, and by voxel that they reached elsewhere, without those toward targets.
    pub bins: SumsByBin,
    pub voxels: SumsByVoxel,
    /// Surprising lines, each with the number of its path and direction.
    pub lines: Vec<(Line, u64)>,
    /// Light by target.
    pub passing: Passing,
    /// Number of rays.
    pub rays: u64,
    guide: &'a TargetGuide,
    places: &'a PilotPlaces,
    /// Targets whose light is measured, at most [`PACK_TARGETS`].
    targets: &'a [Target],
    /// Light that is added to the light expected of a path, cd/m2.
    floor: f32,
    /// Number of the current path.
    number: u32,
    /// Directions that the current path took.
    directions: Vec<PilotDirection>,
}

/// Indirect light of pilot paths, relative to the light expected of each.
#[derive(Default)]
pub struct Passing {
    all: f64,
    /// Light that passed through an opening or came from a patch.
    by_target: [f64; PACK_TARGETS],
}

impl Passing {
    /// Adds the light of a block.
    pub fn add(&mut self, other: &Self) {
        self.all += other.all;
        self.by_target.iter_mut().zip(other.by_target).for_each(|(sum, more)| *sum += more);
    }

    /// Returns the shares of the first targets in the light, in 0..1. The sum can exceed 1, since light can pass through several.
    pub fn shares(&self, count: usize) -> Vec<f32> {
        let share = |light: f64| if self.all > 0.0 { (light / self.all).min(1.0) as f32 } else { 0.0 };
        self.by_target.into_iter().map(share).take(count).collect()
    }
}

/// A direction of a pilot path.
struct PilotDirection {
    direction: Direction,
    /// Luminance that the path found along it, cd/m2 in the sample.
    found: f32,
    /// Luminance that the path found up to the next vertex, and what the field expects there. It has much less variance.
    estimate: f32,
    /// Point that the path reached.
    end: Option<Vec3A>,
    /// Whether the path has left the next vertex.
    is_closed: bool,
    /// Region that the path reached. `None`: the field has no data there.
    end_region: Option<u32>,
}

impl PilotDirection {
    /// Returns whether the path passed through a target, or reached it, along the direction.
    fn reaches(&self, target: &Target) -> bool {
        let Direction { position: from, dir, .. } = self.direction;
        match (target, self.end) {
            (Target::Parallelogram(target), end) => {
                let to = end.map_or(from + dir * FAR, |end| end + (end - from) * MARGIN);
                target.crossing(from, to).is_some()
            }
            (Target::Ball(ball), end) => {
                end.is_some_and(|end| end.distance(ball.center) <= ball.radius * (1.0 + MARGIN))
            }
        }
    }
}

impl<'a> Pilot<'a> {
    /// - `places`: places that directions can reach;
    /// - `targets`: targets whose light is measured.
    pub fn new(guide: &'a TargetGuide, places: &'a PilotPlaces, targets: &'a [Target]) -> Self {
        let (records, bins, voxels) = (Vec::new(), SumsByBin::new(), SumsByVoxel::new());
        let (lines, directions, passing) = (Vec::new(), Vec::new(), Passing::default());
        Self {
            records,
            bins,
            voxels,
            lines,
            passing,
            rays: 0,
            guide,
            places,
            targets,
            floor: 0.0,
            number: 0,
            directions,
        }
    }

    /// Measures how much of the light of the current path came through or from each target.
    /// - `center`: light expected of the path.
    fn measure_passing(&mut self, center: f32) {
        let light = |it: &PilotDirection| f64::from((it.found / center).clamp(0.0, MAX_VALUE));
        let Some(first) = self.directions.first() else { return };
        self.passing.all += light(first);
        for (target, sum) in self.targets.iter().zip(&mut self.passing.by_target) {
            // What a later direction finds, the first one has counted.
            *sum += self.directions.iter().find(|it| it.reaches(target)).map_or(0.0, light);
        }
    }

    /// Returns the densities of a direction by sampler, targets, then the BSDF, relative to the density of all together; and the share
    /// of a region's directions toward targets that the surface takes.
    fn ratios(&self, direction: &Direction) -> ([f32; PACK_TARGETS + 1], f32) {
        let mut ratios = [0.0; PACK_TARGETS + 1];
        ratios[PACK_TARGETS] = 1.0 / direction.pdf_ratio;
        let own =
            self.guide.by_region().get(direction.expectation.region as usize).filter(|_| direction.guide_share > 0.0);
        let Some(region) = own else { return (ratios, 1.0) };
        let Some(pack) = self.guide.packs().get(region.pack as usize) else { return (ratios, 1.0) };
        let Some(directions) = TargetDirections::new(pack, region, direction.position) else { return (ratios, 1.0) };
        let each = directions.each(direction.dir);
        let whole = each.iter().sum::<f32>();
        if whole > 0.0 {
            // What the guide brings to the density of all together.
            let guided = (1.0 - (1.0 - direction.guide_share) * ratios[PACK_TARGETS]).max(0.0);
            let scale = guided / (whole * direction.guide_share);
            let weights = directions.weights();
            (0..PACK_TARGETS).filter(|&k| each[k] > 0.0).for_each(|k| ratios[k] = each[k] / weights[k] * scale);
        }
        (ratios, direction.guide_share / region.share())
    }
}

impl Recorder for Pilot<'_> {
    const WANTS_OCCLUDERS: bool = false;
    const WANTS_ZERO_LIGHT: bool = false;

    fn begin_sample(&mut self, _: u32, _: u32) -> RecordLevel {
        self.directions.clear();
        RecordLevel::All
    }

    fn vertex(&mut self, vertex: impl FnOnce() -> Vertex) {
        if let Some(last) = self.directions.last_mut().filter(|last| last.end.is_none()) {
            last.end = Some(vertex().position);
        }
    }

    fn expectation(&mut self, expectation: impl FnOnce() -> Expectation) {
        if let Some(last) = self.directions.last_mut().filter(|last| last.end_region.is_none()) {
            let Expectation { region, light } = expectation();
            last.estimate += light;
            last.end_region = Some(region);
        }
    }

    fn direction(&mut self, direction: impl FnOnce() -> Direction) {
        if let Some(last) = self.directions.last_mut() {
            last.is_closed = true;
        }
        let (found, estimate, end) = (0.0, 0.0, None);
        let (is_closed, end_region) = (false, None);
        self.directions.push(PilotDirection { direction: direction(), found, estimate, end, is_closed, end_region });
    }

    fn contribution(&mut self, contribution: impl FnOnce() -> Contribution) {
        let Contribution { color, bounce, technique, .. } = contribution();
        let light = luminance(color);
        if !(light > 0.0 && light.is_finite()) {
            return;
        }
        for it in &mut self.directions {
            // Light of a source that a direction reaches is direct light, which the field does not contain.
            if technique == LightTechnique::EmitterHit && bounce == it.direction.bounce + 1 {
                continue;
            }
            it.found += light;
            if !it.is_closed {
                it.estimate += light;
            }
        }
    }

    fn leave(&mut self, _: Continuation) {}
    fn occluded(&mut self, _: impl FnOnce() -> Ray) {}
    fn branch(&mut self, _: BranchEvent) {}
    fn terminate(&mut self, _: Termination) {}

    fn end_sample(&mut self, _: Option<Rgb>) {
        let directions = std::mem::take(&mut self.directions);
        let first = directions.first().map_or(0.0, |first| first.direction.expectation.light);
        let center = first + self.floor;
        let room = MAX_DIRECTIONS - self.records.len();
        for (at, it) in directions.iter().enumerate().take(room) {
            let Expectation { region, light: expected } = it.direction.expectation;
            let light = if it.end_region.is_some() { it.estimate } else { it.found };
            let [value, found] = [light, it.found].map(|light| light / expected);
            if !(value >= 0.0 && value.is_finite() && found.is_finite()) {
                continue;
            }
            let (ratios, guided) = self.ratios(&it.direction);
            let [value, found] = [value, found].map(|value| value.min(MAX_VALUE));
            self.records.push(DirectionRecord { region, value, found, ratios, guided });
            let chance = expected / (1.0 - it.direction.guide_share) / center;
            if let Some(end) = it.end
                && ratios[..PACK_TARGETS].iter().all(|ratio| *ratio == 0.0)
            {
                let light = [light, it.found].map(|light| light / center);
                let leaf = it.end_region.and_then(|leaf| Some((leaf, self.places.bins.get(leaf as usize)?.as_ref()?)));
                if let Some((leaf, bins)) = leaf {
                    self.bins.entry((leaf, bins.bin(end))).or_default().add_direction(light, chance);
                } else {
                    let grid = &self.places.grid;
                    self.voxels.entry(grid.voxel(end)).or_default().add_direction(grid, end, light, chance);
                }
            }
            if value > SURPRISE
                && let Some(end) = it.end
            {
                let weight = (light / center).min(MAX_VALUE);
                let key = u64::from(self.number) << 16 | at as u64;
                self.lines.push((Line { ends: [it.direction.position, end], weight }, key));
            }
        }
        if self.lines.len() >= 2 * MAX_LINES {
            keep_heaviest(&mut self.lines, MAX_LINES);
        }
        self.directions = directions;
        if !self.targets.is_empty() && center > 0.0 {
            self.measure_passing(center);
        }
    }
}
