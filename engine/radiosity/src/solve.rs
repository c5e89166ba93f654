//! Solver: creates elements and links, and iterates until the light no longer changes.

use crate::arena::Arena;
use crate::census::Census;
use crate::element::{Element, Kind};
use crate::gather::{Bound, FROM_ELEMENTS, FROM_SOURCES, Lights, cell_of};
use crate::lamps::{LampLink, LampVerdict};
use crate::link::{Judge, Link, Verdict};
use crate::portals::Portal;
use crate::rays::{Casting, Rays};
use crate::scene::Scene;
use crate::visibility::Eye;
use femc_field::{Field, Guide, Guides, Harmonics, Leaf, Lobe, NONE};
use femc_math::Rgb;
use femc_math::color::luminance;
use rayon::prelude::*;
use std::sync::atomic::{AtomicBool, Ordering};

/// Accuracy and limits of a solution.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Options {
    /// Maximum error of one link, as a share of its receiver's irradiance.
    pub error: f32,
    /// Limit for the bytes of elements and links. When it is reached, elements are not split further. When links alone reach it,
    /// links are not refined further.
    pub memory: usize,
    /// Whether the field must have guides: the directions from which light comes, for sampling.
    pub guides: bool,
}

impl Default for Options {
    fn default() -> Self {
        Self { error: 0.3, memory: 1 << 30, guides: false }
    }
}

/// Statistics of a solution.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Report {
    /// Number of parts of surfaces and of fog.
    pub elements: usize,
    /// Number of elements that are not split.
    pub leaves: usize,
    /// Number of links among elements.
    pub links: usize,
    /// Number of links with light sources.
    pub lamp_links: usize,
    /// Number of links that are less exact than requested because their elements may not be split further.
    pub refused: usize,
    /// Number of visibility rays.
    pub rays: u64,
    /// Number of iterations, each of which passes light through all links.
    pub iterations: usize,
    /// Estimated change of the light that leaves all elements by further iterations, as a share of that light.
    pub residual: f32,
    /// Greatest irradiance of a point if everything that it sees has a radiosity of 1. It is 1 in a closed scene if all links are
    /// exact.
    pub row_sum: f32,
    /// Whether light grew from reflection to reflection. Irradiance beyond 1 in the sense of `row_sum` was then removed.
    pub bounded: bool,
    /// Light that rays find on all surfaces, relative to that of the links there; 1 if the links have none.
    pub checked: f32,
    /// Root mean square of the resulting correction over all surfaces, relative to the links' mean.
    pub corrected: f32,
    /// Number of bytes of elements, links and rays.
    pub bytes: usize,
    /// Elements and links by kind.
    pub census: Census,
}

/// Light of a scene, with a report.
#[derive(Clone, Debug)]
pub struct Solution {
    /// Light of the scene.
    pub field: Field,
    /// Direct light from light sources, as in the elements, by leaf of the field.
    pub direct: Vec<Leaf>,
    /// Report on the solution.
    pub report: Report,
}

/// Error: the caller cancelled the solution.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Cancelled;

/// Allowed errors of a link in successive levels, as multiples of the requested error.
const COARSE: [f32; 3] = [8.0, 2.5, 1.0];
/// Share of the light that leaves all elements. Iteration stops when the change is no more than this. A greater
/// [`Report::residual`] means that the light has not converged.
pub const RESIDUAL: f32 = 1e-4;
/// Number of successive iterations with growing changes after which light counts as growing.
const GROWING: usize = 4;
/// Maximum number of iterations at one level of refinement.
const ITERATIONS: usize = 400;
/// Number of times that rays are cast. Between two casts, leaves are split where the rays find shadows.
pub const ROUNDS: u32 = 3;
/// Number of times that the links' light is compared with the same rays.
const CHECKS: usize = 2;
/// Share of the mean irradiance that is added to an element's when a link's error is judged.
const FLOOR: f32 = 0.03;
/// Minimum limit for the bytes of links, even if elements and links have a smaller limit.
const LEAST_MEMORY: usize = 1 << 20;
/// Minimum area, and minimum volume of fog, of an element that may be split: shares of the total, divided by the error.
const LEAST_AREA: f32 = 1e-4;
const LEAST_VOLUME: f32 = 1e-5;
/// Share of all surfaces' area, or of the fog's volume, of an element that may have exactly the requested error.
const UNIT: f32 = 1e-3;

/// State of a first pass that is not finished: elements, links, light.
#[derive(Clone, Debug)]
pub struct Underway {
    pub(crate) arena: Arena,
    pub(crate) lights: Lights,
    /// Links by receiver and source, ascending.
    pub(crate) links: Vec<Link>,
    pub(crate) report: Report,
    /// Maximum number of bytes of rays.
    pub(crate) most_rays: usize,
    /// Number of times that rays have been cast; [`ROUNDS`] if no more are needed.
    pub(crate) round: u32,
    /// Leaves to split before rays are cast again.
    pub(crate) uneven: Vec<u32>,
    /// Whether more rays are worth casting, because some must measure the light through portals.
    pub(crate) worth_more: bool,
    /// Portals found by the latest rays, for a field that guides paths.
    pub(crate) portals: Vec<Portal>,
}

impl Underway {
    /// Checks whether all rounds of rays are done.
    pub(crate) fn is_settled(&self) -> bool {
        self.round == ROUNDS
    }

    fn bytes(&self, links: usize) -> usize {
        links * size_of::<Link>()
            + self.arena.elements.len() * (size_of::<Element>() + Lights::BYTES)
            + self.arena.wide * size_of::<crate::gather::Arriving>()
    }

    /// Plans the next rays.
    /// - `memory`: maximum number of bytes of elements, links and rays.
    pub(crate) fn casting(&self, memory: usize) -> Casting {
        if self.is_settled() {
            return Casting::none();
        }
        let room = memory.saturating_sub(self.bytes(self.links.len()));
        Casting::new(&self.arena, &self.lights, self.round + 1, room, self.worth_more)
    }

    /// Splits the leaves on which rays have found shadows.
    pub(crate) fn cut(&mut self, scene: &Scene<'_>) {
        for leaf in std::mem::take(&mut self.uneven) {
            let (halves, _) = self.arena.children(scene, leaf);
            for half in halves {
                self.arena.children(scene, half);
            }
        }
        self.lights.grow(&self.arena);
        self.lights.push_pull(scene, &self.arena);
    }

    /// Creates the solution.
    /// - `guides`: guides by leaf, and their lobes.
    pub(crate) fn finish(&self, scene: Scene<'_>, (guides, lobes): (Vec<Guide>, Vec<Lobe>)) -> Solution {
        let elements = &self.arena.elements;
        let report = if self.arena.root == NONE {
            Report::default()
        } else {
            Report {
                elements: elements.iter().filter(|element| element.kind != Kind::Cluster).count(),
                leaves: elements.iter().filter(|element| element.is_leaf()).count(),
                links: self.links.len(),
                bytes: self.bytes(self.links.len()) + self.most_rays,
                census: Census::new(elements, &self.links),
                ..self.report
            }
        };
        let (field, direct, fog) = field(scene, &self.arena, &self.lights);
        // `Solution::verify` rejects NaN.
        let residual = if fog == FogLight::Sound { report.residual } else { f32::NAN };
        let report = Report { residual, ..report };
        let field = Field { guides: Guides::new(guides, lobes, &field.cells, &field.leaves), ..field };
        Solution { field, direct, report }
    }
}

pub(crate) struct Solver<'a> {
    scene: &'a Scene<'a>,
    pub(crate) now: Underway,
    options: &'a Options,
    cancel: &'a AtomicBool,
}

impl<'a> Solver<'a> {
    /// Creates a solver with all links refined.
    /// - errors: `cancel` was set.
    pub(crate) fn new(scene: &'a Scene<'a>, options: &'a Options, cancel: &'a AtomicBool) -> Result<Self, Cancelled> {
        let arena = Arena::new(scene);
        let lights = Lights::new(&arena);
        let (links, report) = (Vec::new(), Report::default());
        let (uneven, portals) = (Vec::new(), Vec::new());
        let underway =
            Underway { arena, lights, links, report, most_rays: 0, round: 0, uneven, worth_more: false, portals };
        let mut solver = Self::with(underway, scene, options, cancel);
        let root = solver.now.arena.root;
        if root == NONE {
            return Ok(solver);
        }
        solver.open();
        solver.now.links = vec![Link { receiver: root, source: root, factors: [0.0; 4] }];
        for (round, coarse) in COARSE.into_iter().enumerate() {
            let is_last = round + 1 == COARSE.len();
            (solver.now.report.refused, solver.now.report.bounded) = (0, false);
            solver.now.lights.unbounded();
            let error = options.error * coarse;
            // Direct light first, then the light between elements.
            solver.light_up(error.min(0.1))?;
            if round == 0 {
                solver.now.lights.push_pull(scene, &solver.now.arena);
            }
            solver.refine(error)?;
            if is_last {
                let Underway { arena, lights, links, report, .. } = &mut solver.now;
                report.row_sum = lights.row_sum(scene, arena, links, Bound::None);
            }
            solver.iterate(if is_last { RESIDUAL } else { 1e-2 })?;
        }
        Ok(solver)
    }

    /// Creates a solver that continues from a state.
    pub(crate) fn with(underway: Underway, scene: &'a Scene<'a>, options: &'a Options, cancel: &'a AtomicBool) -> Self {
        Self { scene, now: underway, options, cancel }
    }

    /// Returns the mean irradiance of all surfaces, by luminance, lx.
    fn mean(&self) -> f32 {
        let roots = self.now.arena.roots.iter().filter(|&&root| root != NONE);
        let (sum, area) = roots.fold((0.0f64, 0.0f64), |(sum, area), &root| {
            let size = f64::from(self.now.arena.elements[root as usize].size);
            (sum + size * f64::from(self.now.lights.of[root as usize].mean), area + size)
        });
        if area > 0.0 { (sum / area) as f32 } else { self.now.lights.of[self.now.arena.root as usize].mean }
    }

    /// Makes a first estimate of the irradiance of elements, without occlusion of the light sources.
    fn open(&mut self) {
        let (lights, world) = (&self.scene.prepared.lights, &self.scene.prepared.world);
        let found: Vec<f32> = self
            .now
            .arena
            .elements
            .par_iter()
            .map(|element| {
                if element.kind == Kind::Cluster {
                    return 0.0;
                }
                let spots = &element.nodes[..element.count];
                let at = |spot: &femc_field::SurfaceSpot, lamp: u32| {
                    let textures = &self.scene.prepared.textures;
                    let sample =
                        lights.sample_light(world, textures, lamp, spot.position, crate::scene::TIME, [0.5; 2]);
                    sample.map_or(0.0, |sample| {
                        let share =
                            if element.kind == Kind::Patch { spot.normal.dot(sample.dir).max(0.0) } else { 0.25 };
                        luminance(sample.radiance) * share / sample.pdf
                    })
                };
                let sum: f32 =
                    spots.iter().map(|spot| (0..lights.len() as u32).map(|lamp| at(spot, lamp)).sum::<f32>()).sum();
                sum / element.count as f32
            })
            .collect();
        for (light, mean) in self.now.lights.of.iter_mut().zip(found) {
            light.mean = if mean.is_finite() { mean } else { 0.0 };
            light.least = light.mean;
        }
        for index in (0..self.now.arena.elements.len()).rev() {
            let element = &self.now.arena.elements[index];
            if !element.is_leaf() {
                let [a, b] = element.children.map(|child| child as usize);
                let sizes = [a, b].map(|child| self.now.arena.elements[child].size);
                let mean = (self.now.lights.of[a].mean * sizes[0] + self.now.lights.of[b].mean * sizes[1])
                    / (sizes[0] + sizes[1]);
                self.now.lights.of[index].mean = if mean.is_finite() { mean } else { 0.0 };
                self.now.lights.of[index].least = self.now.lights.of[a].least.min(self.now.lights.of[b].least);
            }
        }
    }

    fn judge(&self, error: f32, links: usize) -> Judge<'_> {
        let area: f32 = self
            .now
            .arena
            .roots
            .iter()
            .filter(|&&root| root != NONE)
            .map(|&root| self.now.arena.elements[root as usize].size)
            .sum();
        let volume =
            if self.now.arena.fog == NONE { 0.0 } else { self.now.arena.elements[self.now.arena.fog as usize].size };
        Judge {
            scene: self.scene,
            arena: &self.now.arena,
            light: &self.now.lights.of,
            error,
            floor: FLOOR * self.mean(),
            fog_floor: if self.now.arena.fog == NONE {
                0.0
            } else {
                FLOOR * self.now.lights.of[self.now.arena.fog as usize].mean
            },
            unit_area: area * UNIT,
            unit_volume: volume * UNIT,
            least_area: area * LEAST_AREA * self.options.error,
            least_volume: volume * LEAST_VOLUME * self.options.error,
            full: self.now.bytes(links) > self.options.memory,
            brimful: links > self.options.memory.max(LEAST_MEMORY) / size_of::<Link>(),
        }
    }

    /// Computes the light of the sources, on elements that are as fine as it requires.
    fn light_up(&mut self, error: f32) -> Result<(), Cancelled> {
        let mut pending: Vec<(u32, u32)> =
            (0..self.scene.prepared.lights.len() as u32).map(|lamp| (self.now.arena.root, lamp)).collect();
        let mut done: Vec<LampLink> = Vec::new();
        while !pending.is_empty() {
            if self.cancel.load(Ordering::Relaxed) {
                return Err(Cancelled);
            }
            let judge = self.judge(error, done.len() + pending.len());
            let (verdicts, rays) = judged(&pending, |&(receiver, lamp), eye| judge.judge_lamp(receiver, lamp, eye));
            self.now.report.rays += rays;
            let mut next = Vec::new();
            for ((receiver, lamp), verdict) in pending.into_iter().zip(verdicts) {
                match verdict {
                    LampVerdict::Drop => {}
                    LampVerdict::Keep { link, refused } => {
                        done.push(link);
                        self.now.report.refused += usize::from(refused);
                    }
                    LampVerdict::Receiver => {
                        let (children, _) = self.now.arena.children(self.scene, receiver);
                        next.extend(children.map(|child| (child, lamp)));
                    }
                }
            }
            self.now.lights.grow(&self.now.arena);
            pending = next;
        }
        done.sort_unstable_by_key(|link| (link.receiver, link.lamp));
        self.now.report.lamp_links = done.len();
        for light in &mut self.now.lights.of {
            light.own[FROM_SOURCES] = [Rgb::ZERO; 4];
        }
        for arriving in &mut self.now.lights.arriving {
            arriving.own[FROM_SOURCES] = Harmonics::ZERO;
        }
        for link in done {
            let element = &self.now.arena.elements[link.receiver as usize];
            if element.is_wide() {
                self.now.lights.arriving[element.wide as usize].own[FROM_SOURCES] +=
                    Harmonics::toward(link.dir, link.light[0]);
            } else {
                let own = &mut self.now.lights.of[link.receiver as usize].own[FROM_SOURCES];
                own.iter_mut().zip(link.light).for_each(|(sum, light)| *sum += light);
            }
        }
        Ok(())
    }

    /// Refines links until each is as exact as requested.
    fn refine(&mut self, error: f32) -> Result<(), Cancelled> {
        let mut pending = std::mem::take(&mut self.now.links);
        let mut done = Vec::new();
        while !pending.is_empty() {
            if self.cancel.load(Ordering::Relaxed) {
                return Err(Cancelled);
            }
            let judge = self.judge(error, done.len() + pending.len());
            let (verdicts, rays) = judged(&pending, |link, eye| judge.judge(link.receiver, link.source, eye));
            self.now.report.rays += rays;
            let mut next = Vec::new();
            let link = |receiver: u32, source: u32| Link { receiver, source, factors: [0.0; 4] };
            for (Link { receiver, source, .. }, verdict) in pending.into_iter().zip(verdicts) {
                match verdict {
                    Verdict::Drop => {}
                    Verdict::Keep { link, refused } => {
                        done.push(link);
                        self.now.report.refused += usize::from(refused);
                    }
                    Verdict::Receiver => {
                        let (children, _) = self.now.arena.children(self.scene, receiver);
                        next.extend(children.map(|child| link(child, source)));
                    }
                    Verdict::Source => {
                        let (children, _) = self.now.arena.children(self.scene, source);
                        next.extend(children.map(|child| link(receiver, child)));
                    }
                    Verdict::Both => {
                        let ([a, b], _) = self.now.arena.children(self.scene, receiver);
                        next.extend([(a, a), (a, b), (b, a), (b, b)].map(|(p, q)| link(p, q)));
                    }
                }
            }
            self.now.lights.grow(&self.now.arena);
            pending = next;
        }
        done.sort_unstable_by_key(|link| (link.receiver, link.source));
        self.now.links = done;
        Ok(())
    }

    fn iterate(&mut self, residual: f32) -> Result<(), Cancelled> {
        let (mut before, mut growing) = (f64::INFINITY, 0);
        for _ in 0..ITERATIONS {
            if self.cancel.load(Ordering::Relaxed) {
                return Err(Cancelled);
            }
            self.now.lights.gather(&self.now.arena, &self.now.links);
            let (change, whole) = self.now.lights.push_pull(self.scene, &self.now.arena);
            self.now.report.iterations += 1;
            growing = if change > before { growing + 1 } else { 0 };
            if growing == GROWING && !self.now.report.bounded {
                self.now.lights.row_sum(self.scene, &self.now.arena, &self.now.links, Bound::RowSums);
                (self.now.report.bounded, before) = (true, f64::INFINITY);
                continue;
            }
            // Total change of further iterations, if each change shrinks at the latest rate.
            let rate = if before.is_finite() { (change / before).min(0.99) } else { 0.99 };
            before = change;
            let left = change * rate / (1.0 - rate);
            self.now.report.residual = if whole > 0.0 { (left / whole) as f32 } else { 0.0 };
            if self.now.report.residual <= residual {
                break;
            }
        }
        Ok(())
    }

    /// Corrects the links' light with the rays, and determines the leaves that are too large for the shadows found.
    pub(crate) fn settle(&mut self, rays: &Rays) -> Result<(), Cancelled> {
        if self.now.is_settled() {
            return Ok(());
        }
        self.now.round += 1;
        if self.now.arena.root == NONE {
            return Ok(());
        }
        let mut contrast = Vec::new();
        for _ in 0..CHECKS {
            let Underway { arena, lights, report, .. } = &mut self.now;
            let found = rays.correct(arena, lights, self.options.error);
            (report.checked, report.corrected) = (found.ratio, found.changed);
            contrast = found.contrast;
            self.iterate(RESIDUAL)?;
        }
        self.now.most_rays = self.now.most_rays.max(rays.bytes());
        self.now.report.rays += rays.traced;
        if !self.now.is_settled() {
            let judge = self.judge(self.options.error, self.now.links.len());
            let is_uneven = |&(leaf, contrast): &(u32, f32)| {
                let element = &judge.arena.elements[leaf as usize];
                0.5 * contrast > judge.allowed(element, &judge.light[leaf as usize]) && judge.may_cut(element)
            };
            let uneven = contrast.iter().filter(|leaf| is_uneven(leaf)).map(|&(leaf, _)| leaf).collect();
            self.now.uneven = uneven;
            if !self.options.guides && self.now.uneven.is_empty() {
                // Nothing is split, and new rays would go nowhere else, so they would bring no new information.
                self.now.round = ROUNDS;
            }
        }
        Ok(())
    }
}

/// Returns the verdicts in order, and the number of their rays.
fn judged<T: Sync, V: Send>(pending: &[T], judge: impl Fn(&T, &mut Eye) -> V + Sync) -> (Vec<V>, u64) {
    let chunks: Vec<(Vec<V>, u64)> = pending
        .par_chunks(256)
        .map(|chunk| {
            let mut eye = Eye::default();
            let verdicts = chunk.iter().map(|item| judge(item, &mut eye)).collect();
            (verdicts, eye.rays)
        })
        .collect();
    let rays = chunks.iter().map(|(_, rays)| rays).sum();
    (chunks.into_iter().flat_map(|(verdicts, _)| verdicts).collect(), rays)
}

/// Returns the leaves of surfaces, in the order of the field.
pub(crate) fn leaves(arena: &Arena) -> Vec<u32> {
    let mut leaves = Vec::new();
    for &root in arena.roots.iter().filter(|&&root| root != NONE) {
        let mut order = vec![root];
        let mut at = 0;
        while at < order.len() {
            let element = &arena.elements[order[at] as usize];
            if element.is_leaf() {
                leaves.push(order[at]);
            } else {
                order.extend(element.children);
            }
            at += 1;
        }
    }
    leaves
}

/// State of the fog's light in a solution.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum FogLight {
    /// Finite and not negative, or without fog.
    Sound,
    /// Not finite, or negative: the field has no fog.
    Broken,
}

/// Creates the field of a solution, and the direct light from light sources.
fn field(scene: Scene<'_>, arena: &Arena, lights: &Lights) -> (Field, Vec<Leaf>, FogLight) {
    let mut field = Field { roots: vec![NONE; scene.surfaces.len()], ..Field::default() };
    let mut direct = Vec::new();
    for (surface, &root) in arena.roots.iter().enumerate() {
        if root == NONE {
            continue;
        }
        // Breadth first, so that two halves are adjacent.
        let first = field.cells.len() as u32;
        field.roots[surface] = first;
        let mut order = vec![root];
        let mut at = 0;
        while at < order.len() {
            let element = &arena.elements[order[at] as usize];
            let next = if element.is_leaf() {
                field.leaves.push(leaf(element, order[at], lights, FROM_ELEMENTS));
                direct.push(leaf(element, order[at], lights, FROM_SOURCES));
                field.leaves.len() as u32 - 1
            } else {
                order.extend(element.children);
                first + order.len() as u32 - 2
            };
            field.cells.push(cell_of(element, next));
            at += 1;
        }
    }
    let mut fog = FogLight::Sound;
    if arena.fog != NONE {
        match crate::fog::tree(&scene, arena, lights) {
            Some(tree) => field.fog = tree,
            None => fog = FogLight::Broken,
        }
    }
    (field.surfaces, field.sides) = (scene.surfaces, scene.sides);
    (field, direct, fog)
}

fn leaf(element: &Element, index: u32, lights: &Lights, from: usize) -> Leaf {
    if element.is_wide() {
        return Leaf::Curved(lights.around(element, index as usize, from));
    }
    let values = lights.at_nodes(index as usize, from);
    if element.count == 3 { Leaf::Triangle([values[0], values[1], values[2]]) } else { Leaf::Rectangle(values) }
}
