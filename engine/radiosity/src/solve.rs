//! The solver: elements, links, light, until the light no longer changes.

use crate::arena::Arena;
use crate::census::Census;
use crate::element::{Element, Kind};
use crate::gather::{Bound, FROM_ELEMENTS, FROM_SOURCES, Lights, cell_of};
use crate::incoming::{Purpose, guides, portals};
use crate::lamps::{LampLink, LampVerdict};
use crate::link::{Judge, Link, Verdict};
use crate::portals::Portal;
use crate::rays::{Aims, Rays};
use crate::scene::Scene;
use crate::visibility::Eye;
use femc_field::{Field, Guide, Guides, Harmonics, Leaf, Lobe, NONE};
use femc_math::Rgb;
use femc_math::color::luminance;
use femc_prepared::Prepared;
use rayon::prelude::*;
use std::sync::atomic::{AtomicBool, Ordering};

/// How exact the solution is to be, and what it may take.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Options {
    /// Greatest error of one link, as a share of its receiver's irradiance.
    pub error: f32,
    /// Bytes that elements and links may take.
    pub memory: usize,
    /// Whether the field is to say where light comes from, for those who draw directions by it.
    pub guides: bool,
}

impl Default for Options {
    fn default() -> Self {
        Self { error: 0.3, memory: 1 << 30, guides: false }
    }
}

/// What a solution is made of.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Report {
    /// Parts of surfaces and of fog.
    pub elements: usize,
    /// Those that are not cut further.
    pub leaves: usize,
    /// Links among elements.
    pub links: usize,
    /// Links with light sources.
    pub lamp_links: usize,
    /// Links that are not as exact as asked for: the elements may not be cut further.
    pub refused: usize,
    /// Visibility rays.
    pub rays: u64,
    /// Times that light was passed on through all links.
    pub iterations: usize,
    /// What further iterations would change of the light that leaves all elements, as far as the latest tell, as a share of it.
    pub residual: f32,
    /// Greatest irradiance of a point if all that it sees had a radiosity of 1: 1 in a closed scene, if all links were exact.
    pub row_sum: f32,
    /// Whether light grew from reflection to reflection: what points receive beyond 1 in that sense was left out then.
    pub bounded: bool,
    /// Light that rays find on all surfaces, over what the links bring there; 1 where these bring none.
    pub checked: f32,
    /// Root mean square, over all surfaces, of what was changed by that, over the links' mean.
    pub corrected: f32,
    /// Bytes of elements, links and rays.
    pub bytes: usize,
    /// Elements and links by kind.
    pub census: Census,
}

/// The light of a scene, and how it was found.
#[derive(Clone, Debug)]
pub struct Solution {
    /// The light.
    pub field: Field,
    /// By leaf of the field: what comes straight from light sources, as the elements have it.
    pub direct: Vec<Leaf>,
    /// How it was found.
    pub report: Report,
}

/// The caller cancelled it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Cancelled;

/// Errors of a link that are allowed one after the other, as multiples of what is asked for.
const COARSE: [f32; 3] = [8.0, 2.5, 1.0];
/// An iteration after which the light that leaves all elements would change by no more than this share of it is the last. A greater
/// [`Report::residual`] says that light did not come to rest.
pub const RESIDUAL: f32 = 1e-4;
/// Iterations in a row that each change more than the one before: light grows.
const GROWING: usize = 4;
/// Most iterations at one level of refinement.
const ITERATIONS: usize = 400;
/// Times that rays are cast, and between them leaves cut where these find shadows.
const ROUNDS: u32 = 3;
/// Times that the light of the links is compared with that of the same rays.
const CHECKS: usize = 2;
/// Share of the mean irradiance that is added to an element's when a link's error is judged.
const FLOOR: f32 = 0.03;
/// Parts of all surfaces' area, and of the fog's volume, that are not cut further, over the error.
const LEAST_AREA: f32 = 1e-4;
const LEAST_VOLUME: f32 = 1e-5;
/// An element of this part of all surfaces' area, or of the fog's volume, may have the error that is asked for as it is.
const UNIT: f32 = 1e-3;

/// Finds the light of a prepared frame. The result depends on the frame and the options alone, not on threads.
/// - errors: `cancel` was set.
pub fn solve(prepared: &Prepared, options: &Options, cancel: &AtomicBool) -> Result<Solution, Cancelled> {
    let scene = Scene::new(prepared);
    let arena = Arena::new(&scene);
    if arena.root == NONE {
        let field = Field {
            roots: vec![NONE; scene.surfaces.len()],
            sides: scene.sides,
            surfaces: scene.surfaces,
            ..Field::default()
        };
        return Ok(Solution { field, direct: Vec::new(), report: Report::default() });
    }
    let lights = Lights::new(&arena);
    let mut solver = Solver {
        scene: &scene,
        arena,
        lights,
        links: Vec::new(),
        report: Report::default(),
        most_rays: 0,
        options,
        cancel,
    };
    solver.open();
    solver.links = vec![Link { receiver: solver.arena.root, source: solver.arena.root, factors: [0.0; 4] }];
    for (round, coarse) in COARSE.into_iter().enumerate() {
        let is_last = round + 1 == COARSE.len();
        (solver.report.refused, solver.report.bounded) = (0, false);
        solver.lights.unbounded();
        let error = options.error * coarse;
        // Where the light falls first; then where it goes.
        solver.light_up(error.min(0.1))?;
        if round == 0 {
            solver.lights.push_pull(&scene, &solver.arena);
        }
        solver.refine(error)?;
        if is_last {
            solver.report.row_sum = solver.lights.row_sum(&scene, &solver.arena, &solver.links, Bound::None);
        }
        solver.iterate(if is_last { RESIDUAL } else { 1e-2 })?;
    }
    let rays = solver.check()?;
    let report = solver.finish();
    let (mut guides, mut lobes) = Default::default();
    if options.guides {
        let leaves = leaves(&solver.arena);
        (guides, lobes) = solver.guides(&rays, &leaves, &solver.portals(&rays, &leaves), Purpose::Paths);
    }
    let Solver { arena, lights, .. } = solver;
    let (field, direct) = field(scene, &arena, &lights);
    let field = Field { guides: Guides::new(guides, lobes, &field.cells, &field.leaves), ..field };
    Ok(Solution { field, direct, report })
}

struct Solver<'a> {
    scene: &'a Scene<'a>,
    arena: Arena,
    lights: Lights,
    links: Vec<Link>,
    report: Report,
    /// Bytes of rays at most.
    most_rays: usize,
    options: &'a Options,
    cancel: &'a AtomicBool,
}

impl Solver<'_> {
    fn bytes(&self, links: usize) -> usize {
        links * size_of::<Link>()
            + self.arena.elements.len() * (size_of::<Element>() + Lights::BYTES)
            + self.arena.wide * size_of::<crate::gather::Arriving>()
    }

    /// Mean irradiance of all surfaces, by luminance, lx.
    fn mean(&self) -> f32 {
        let roots = self.arena.roots.iter().filter(|&&root| root != NONE);
        let (sum, area) = roots.fold((0.0f64, 0.0f64), |(sum, area), &root| {
            let size = f64::from(self.arena.elements[root as usize].size);
            (sum + size * f64::from(self.lights.of[root as usize].mean), area + size)
        });
        if area > 0.0 { (sum / area) as f32 } else { self.lights.of[self.arena.root as usize].mean }
    }

    /// A first idea of what elements receive: as if nothing were between them and the light sources.
    fn open(&mut self) {
        let (lights, world) = (&self.scene.prepared.lights, &self.scene.prepared.world);
        let found: Vec<f32> = self
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
        for (light, mean) in self.lights.of.iter_mut().zip(found) {
            light.mean = if mean.is_finite() { mean } else { 0.0 };
            light.least = light.mean;
        }
        for index in (0..self.arena.elements.len()).rev() {
            let element = &self.arena.elements[index];
            if !element.is_leaf() {
                let [a, b] = element.children.map(|child| child as usize);
                let sizes = [a, b].map(|child| self.arena.elements[child].size);
                let mean =
                    (self.lights.of[a].mean * sizes[0] + self.lights.of[b].mean * sizes[1]) / (sizes[0] + sizes[1]);
                self.lights.of[index].mean = if mean.is_finite() { mean } else { 0.0 };
                self.lights.of[index].least = self.lights.of[a].least.min(self.lights.of[b].least);
            }
        }
    }

    fn judge(&self, error: f32, links: usize) -> Judge<'_> {
        let area: f32 = self
            .arena
            .roots
            .iter()
            .filter(|&&root| root != NONE)
            .map(|&root| self.arena.elements[root as usize].size)
            .sum();
        let volume = if self.arena.fog == NONE { 0.0 } else { self.arena.elements[self.arena.fog as usize].size };
        Judge {
            scene: self.scene,
            arena: &self.arena,
            light: &self.lights.of,
            error,
            floor: FLOOR * self.mean(),
            fog_floor: if self.arena.fog == NONE { 0.0 } else { FLOOR * self.lights.of[self.arena.fog as usize].mean },
            unit_area: area * UNIT,
            unit_volume: volume * UNIT,
            least_area: area * LEAST_AREA * self.options.error,
            least_volume: volume * LEAST_VOLUME * self.options.error,
            full: self.bytes(links) > self.options.memory,
        }
    }

    /// Light of the sources, on elements as fine as it needs.
    fn light_up(&mut self, error: f32) -> Result<(), Cancelled> {
        let mut pending: Vec<(u32, u32)> =
            (0..self.scene.prepared.lights.len() as u32).map(|lamp| (self.arena.root, lamp)).collect();
        let mut done: Vec<LampLink> = Vec::new();
        while !pending.is_empty() {
            if self.cancel.load(Ordering::Relaxed) {
                return Err(Cancelled);
            }
            let judge = self.judge(error, done.len() + pending.len());
            let (verdicts, rays) = judged(&pending, |&(receiver, lamp), eye| judge.judge_lamp(receiver, lamp, eye));
            self.report.rays += rays;
            let mut next = Vec::new();
            for ((receiver, lamp), verdict) in pending.into_iter().zip(verdicts) {
                match verdict {
                    LampVerdict::Drop => {}
                    LampVerdict::Keep { link, refused } => {
                        done.push(link);
                        self.report.refused += usize::from(refused);
                    }
                    LampVerdict::Receiver => {
                        let (children, _) = self.arena.children(self.scene, receiver);
                        next.extend(children.map(|child| (child, lamp)));
                    }
                }
            }
            self.lights.grow(&self.arena);
            pending = next;
        }
        done.sort_unstable_by_key(|link| (link.receiver, link.lamp));
        self.report.lamp_links = done.len();
        for light in &mut self.lights.of {
            light.own[FROM_SOURCES] = [Rgb::ZERO; 4];
        }
        for arriving in &mut self.lights.arriving {
            arriving.own[FROM_SOURCES] = Harmonics::ZERO;
        }
        for link in done {
            let element = &self.arena.elements[link.receiver as usize];
            if element.is_wide() {
                self.lights.arriving[element.wide as usize].own[FROM_SOURCES] +=
                    Harmonics::toward(link.dir, link.light[0]);
            } else {
                let own = &mut self.lights.of[link.receiver as usize].own[FROM_SOURCES];
                own.iter_mut().zip(link.light).for_each(|(sum, light)| *sum += light);
            }
        }
        Ok(())
    }

    /// Links until each is as exact as asked for.
    fn refine(&mut self, error: f32) -> Result<(), Cancelled> {
        let mut pending = std::mem::take(&mut self.links);
        let mut done = Vec::new();
        while !pending.is_empty() {
            if self.cancel.load(Ordering::Relaxed) {
                return Err(Cancelled);
            }
            let judge = self.judge(error, done.len() + pending.len());
            let (verdicts, rays) = judged(&pending, |link, eye| judge.judge(link.receiver, link.source, eye));
            self.report.rays += rays;
            let mut next = Vec::new();
            let link = |receiver: u32, source: u32| Link { receiver, source, factors: [0.0; 4] };
            for (Link { receiver, source, .. }, verdict) in pending.into_iter().zip(verdicts) {
                match verdict {
                    Verdict::Drop => {}
                    Verdict::Keep { link, refused } => {
                        done.push(link);
                        self.report.refused += usize::from(refused);
                    }
                    Verdict::Receiver => {
                        let (children, _) = self.arena.children(self.scene, receiver);
                        next.extend(children.map(|child| link(child, source)));
                    }
                    Verdict::Source => {
                        let (children, _) = self.arena.children(self.scene, source);
                        next.extend(children.map(|child| link(receiver, child)));
                    }
                    Verdict::Both => {
                        let ([a, b], _) = self.arena.children(self.scene, receiver);
                        next.extend([(a, a), (a, b), (b, a), (b, b)].map(|(p, q)| link(p, q)));
                    }
                }
            }
            self.lights.grow(&self.arena);
            pending = next;
        }
        done.sort_unstable_by_key(|link| (link.receiver, link.source));
        self.links = done;
        Ok(())
    }

    fn iterate(&mut self, residual: f32) -> Result<(), Cancelled> {
        let (mut before, mut growing) = (f64::INFINITY, 0);
        for _ in 0..ITERATIONS {
            if self.cancel.load(Ordering::Relaxed) {
                return Err(Cancelled);
            }
            self.lights.gather(&self.arena, &self.links);
            let (change, whole) = self.lights.push_pull(self.scene, &self.arena);
            self.report.iterations += 1;
            growing = if change > before { growing + 1 } else { 0 };
            if growing == GROWING && !self.report.bounded {
                self.lights.row_sum(self.scene, &self.arena, &self.links, Bound::RowSums);
                (self.report.bounded, before) = (true, f64::INFINITY);
                continue;
            }
            // What further iterations would change in all, if each changes as much less as the latest did.
            let rate = if before.is_finite() { (change / before).min(0.99) } else { 0.99 };
            before = change;
            let left = change * rate / (1.0 - rate);
            self.report.residual = if whole > 0.0 { (left / whole) as f32 } else { 0.0 };
            if self.report.residual <= residual {
                break;
            }
        }
        Ok(())
    }

    /// Takes of the light that links bring what rays find of it, on leaves that are fine enough for the shadows that these find.
    fn check(&mut self) -> Result<Rays, Cancelled> {
        let mut aims = Aims::default();
        let mut round = 0;
        loop {
            round += 1;
            let room = self.options.memory.saturating_sub(self.bytes(self.links.len()));
            let rays = Rays::new(self.scene, &self.arena, &self.lights, &aims, round, room);
            let mut contrast = Vec::new();
            for _ in 0..CHECKS {
                let found = rays.correct(&self.arena, &mut self.lights, self.options.error);
                (self.report.checked, self.report.corrected) = (found.ratio, found.changed);
                contrast = found.contrast;
                self.iterate(RESIDUAL)?;
            }
            self.most_rays = self.most_rays.max(rays.bytes());
            self.report.rays += rays.traced;
            if round == ROUNDS {
                return Ok(rays);
            }
            let judge = self.judge(self.options.error, self.links.len());
            let is_uneven = |&(leaf, contrast): &(u32, f32)| {
                let element = &self.arena.elements[leaf as usize];
                0.5 * contrast > judge.allowed(element, &self.lights.of[leaf as usize]) && judge.may_cut(element)
            };
            let uneven: Vec<u32> = contrast.iter().filter(|leaf| is_uneven(leaf)).map(|&(leaf, _)| leaf).collect();
            if self.options.guides {
                // What guides paths later guides rays before.
                let leaves = leaves(&self.arena);
                let portals = self.portals(&rays, &leaves);
                let (guides, lobes) = self.guides(&rays, &leaves, &portals, Purpose::Rays);
                let worth_more = aims.worth_more || portals.iter().any(Portal::is_rare);
                aims = Aims::new(&self.arena, &leaves, (&guides, &lobes), worth_more);
            } else if uneven.is_empty() {
                return Ok(rays);
            }
            for leaf in uneven {
                let (halves, _) = self.arena.children(self.scene, leaf);
                for half in halves {
                    self.arena.children(self.scene, half);
                }
            }
            self.lights.grow(&self.arena);
            self.lights.push_pull(self.scene, &self.arena);
            aims.grow(&self.arena);
        }
    }

    fn portals(&self, rays: &Rays, leaves: &[u32]) -> Vec<Portal> {
        portals(self.scene, &self.arena, &self.lights, rays, leaves)
    }

    fn guides(&self, rays: &Rays, leaves: &[u32], portals: &[Portal], purpose: Purpose) -> (Vec<Guide>, Vec<Lobe>) {
        guides(self.scene, &self.arena, &self.lights, (&self.links, rays), leaves, portals, purpose)
    }

    fn finish(&self) -> Report {
        let elements = &self.arena.elements;
        Report {
            elements: elements.iter().filter(|element| element.kind != Kind::Cluster).count(),
            leaves: elements.iter().filter(|element| element.is_leaf()).count(),
            links: self.links.len(),
            bytes: self.bytes(self.links.len()) + self.most_rays,
            census: Census::new(elements, &self.links),
            ..self.report
        }
    }
}

/// Verdicts in order, and the rays that they took.
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

/// Leaves of surfaces, in the order of the field.
fn leaves(arena: &Arena) -> Vec<u32> {
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

/// What is kept of a solution, and beside it what comes straight from light sources.
fn field(scene: Scene<'_>, arena: &Arena, lights: &Lights) -> (Field, Vec<Leaf>) {
    let mut field = Field { roots: vec![NONE; scene.surfaces.len()], ..Field::default() };
    let mut direct = Vec::new();
    for (surface, &root) in arena.roots.iter().enumerate() {
        if root == NONE {
            continue;
        }
        // Breadth first, so that two halves follow each other.
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
    if arena.fog != NONE {
        field.fog = crate::fog::tree(&scene, arena, lights);
    }
    (field.surfaces, field.sides) = (scene.surfaces, scene.sides);
    (field, direct)
}

fn leaf(element: &Element, index: u32, lights: &Lights, from: usize) -> Leaf {
    if element.is_wide() {
        return Leaf::Curved(lights.around(element, index as usize, from));
    }
    let values = lights.at_nodes(index as usize, from);
    if element.count == 3 { Leaf::Triangle([values[0], values[1], values[2]]) } else { Leaf::Rectangle(values) }
}
