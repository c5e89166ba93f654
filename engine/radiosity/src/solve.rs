//! Solver: creates elements and links, and iterates until the light no longer changes.

use crate::arena::Arena;
use crate::census::Census;
use crate::element::{Element, Shape};
use crate::gather::{ElementLights, EnergyBound, FROM_ELEMENTS, FROM_LAMPS};
use crate::lamps::{LampLink, LampLinkDecision};
use crate::link::{Link, LinkDecision, Oracle};
use crate::portals::Portal;
use crate::rays::{RayPlan, Rays};
use crate::scene::Scene;
use crate::visibility::VisibilityTester;
use femc_field::{Cell, Field, Guide, Guides, Harmonics, Leaf, Lobe, NONE, Split, SurfaceSpot};
use femc_math::Rgb;
use femc_math::color::luminance;
use rayon::prelude::*;
use std::sync::atomic::{AtomicBool, Ordering};

/// Accuracy and limits of a solution.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SolveOptions {
    /// Maximum error of one link, as a share of its receiver's irradiance.
    pub error: f32,
    /// Limit for the bytes of elements and links. When it is reached, elements are not split further. When links alone reach it,
    /// links are not refined further.
    pub memory: usize,
    /// Whether the field must have guides: the directions from which light comes, for sampling.
    pub guides: bool,
}

impl Default for SolveOptions {
    fn default() -> Self {
        Self { error: 0.3, memory: 1 << 30, guides: false }
    }
}

/// Statistics of a solution.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct SolveReport {
    /// Number of parts of surfaces and of fog.
    pub elements: usize,
    /// Number of elements that are not split.
    pub leaves: usize,
    /// Number of links among elements.
    pub links: usize,
    /// Number of links with light sources.
    pub lamp_links: usize,
    /// Number of links that are less exact than requested because their elements may not be split further.
    pub inexact_links: usize,
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
    pub is_energy_bounded: bool,
    /// Light that rays find on all surfaces, relative to that of the links there; 1 if the links have none.
    pub ray_link_ratio: f32,
    /// Root mean square of the resulting correction over all surfaces, relative to the links' mean.
    pub ray_correction: f32,
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
    pub report: SolveReport,
}

/// Error: the caller cancelled the solution.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Cancelled;

/// Allowed errors of a link in successive levels, as multiples of the requested error.
const ERROR_LEVELS: [f32; 3] = [8.0, 2.5, 1.0];
/// Share of the light that leaves all elements. Iteration stops when the change is no more than this. A greater
/// [`SolveReport::residual`] means that the light has not converged.
pub const TARGET_RESIDUAL: f32 = 1e-4;
/// Number of successive iterations with growing changes after which light counts as growing.
const MAX_GROWING: usize = 4;
/// Maximum number of iterations at one level of refinement.
const MAX_ITERATIONS: usize = 400;
/// Number of times that rays are cast. Between two casts, leaves are split where the rays find shadows.
pub const RAY_ROUNDS: u32 = 3;
/// Number of times that the links' light is compared with the same rays.
const RAY_CHECKS: usize = 2;
/// Share of the mean irradiance that is added to an element's when a link's error is judged.
const IRRADIANCE_FLOOR: f32 = 0.03;
/// Minimum limit for the bytes of links, even if elements and links have a smaller limit.
const MIN_MEMORY: usize = 1 << 20;
/// Minimum area, and minimum volume of fog, of an element that may be split: shares of the total, divided by the error.
const MIN_AREA_SHARE: f32 = 1e-4;
const MIN_VOLUME_SHARE: f32 = 1e-5;
/// Share of all surfaces' area, or of the fog's volume, of an element that may have exactly the requested error.
const UNIT_SHARE: f32 = 1e-3;

/// State of a first pass that is not finished: elements, links, light.
#[derive(Clone, Debug)]
pub struct SolverState {
    pub(crate) arena: Arena,
    pub(crate) lights: ElementLights,
    /// Links by receiver and source, ascending.
    pub(crate) links: Vec<Link>,
    pub(crate) report: SolveReport,
    /// Maximum number of bytes of rays.
    pub(crate) max_ray_bytes: usize,
    /// Number of times that rays have been cast; [`RAY_ROUNDS`] if no more are needed.
    pub(crate) round: u32,
    /// Leaves to split before rays are cast again.
    pub(crate) uneven_leaves: Vec<u32>,
    /// Whether more rays are worth casting, because some must measure the light through portals.
    pub(crate) needs_more_rays: bool,
    /// Portals found by the latest rays, for a field that guides paths.
    pub(crate) portals: Vec<Portal>,
}

impl SolverState {
    /// Checks whether all rounds of rays are done.
    pub(crate) fn is_finished(&self) -> bool {
        self.round == RAY_ROUNDS
    }

    fn bytes(&self, links: usize) -> usize {
        links * size_of::<Link>()
            + self.arena.elements.len() * (size_of::<Element>() + ElementLights::BYTES)
            + self.arena.directional_count * size_of::<crate::gather::IncidentLight>()
    }

    /// Plans the next rays.
    /// - `memory`: maximum number of bytes of elements, links and rays.
    pub(crate) fn ray_plan(&self, memory: usize) -> RayPlan {
        if self.is_finished() {
            return RayPlan::empty();
        }
        let room = memory.saturating_sub(self.bytes(self.links.len()));
        RayPlan::new(&self.arena, &self.lights, self.round + 1, room, self.needs_more_rays)
    }

    /// Splits the leaves on which rays have found shadows.
    pub(crate) fn split_uneven_leaves(&mut self, scene: &Scene<'_>) {
        for leaf in std::mem::take(&mut self.uneven_leaves) {
            let (halves, _) = self.arena.ensure_children(scene, leaf);
            for half in halves {
                self.arena.ensure_children(scene, half);
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
            SolveReport::default()
        } else {
            SolveReport {
                elements: elements.iter().filter(|element| !element.is_cluster()).count(),
                leaves: elements.iter().filter(|element| element.is_leaf()).count(),
                links: self.links.len(),
                bytes: self.bytes(self.links.len()) + self.max_ray_bytes,
                census: Census::new(elements, &self.links),
                ..self.report
            }
        };
        let (field, direct, fog) = build_field(scene, &self.arena, &self.lights);
        // `Solution::verify` rejects NaN.
        let residual = if fog == FogLight::Valid { report.residual } else { f32::NAN };
        let report = SolveReport { residual, ..report };
        let field = Field { guides: Guides::new(guides, lobes, &field.cells, &field.leaves), ..field };
        Solution { field, direct, report }
    }
}

pub(crate) struct Solver<'a> {
    scene: &'a Scene<'a>,
    pub(crate) state: SolverState,
    options: &'a SolveOptions,
    cancel: &'a AtomicBool,
}

impl<'a> Solver<'a> {
    /// Creates a solver with all links refined.
    /// - errors: `cancel` was set.
    pub(crate) fn new(
        scene: &'a Scene<'a>,
        options: &'a SolveOptions,
        cancel: &'a AtomicBool,
    ) -> Result<Self, Cancelled> {
        let arena = Arena::new(scene);
        let lights = ElementLights::new(&arena);
        let (links, report) = (Vec::new(), SolveReport::default());
        let (uneven_leaves, portals) = (Vec::new(), Vec::new());
        let state = SolverState {
            arena,
            lights,
            links,
            report,
            max_ray_bytes: 0,
            round: 0,
            uneven_leaves,
            needs_more_rays: false,
            portals,
        };
        let mut solver = Self::from_state(state, scene, options, cancel);
        let root = solver.state.arena.root;
        if root == NONE {
            return Ok(solver);
        }
        solver.estimate_irradiance();
        solver.state.links = vec![Link { receiver: root, source: root, factors: [0.0; 4] }];
        for (round, coarse) in ERROR_LEVELS.into_iter().enumerate() {
            let is_last = round + 1 == ERROR_LEVELS.len();
            (solver.state.report.inexact_links, solver.state.report.is_energy_bounded) = (0, false);
            solver.state.lights.accept_all();
            let error = options.error * coarse;
            // Direct light first, then the light between elements.
            solver.link_lamps(error.min(0.1))?;
            if round == 0 {
                solver.state.lights.push_pull(scene, &solver.state.arena);
            }
            solver.refine_links(error)?;
            if is_last {
                let SolverState { arena, lights, links, report, .. } = &mut solver.state;
                report.row_sum = lights.row_sum(scene, arena, links, EnergyBound::None);
            }
            solver.iterate(if is_last { TARGET_RESIDUAL } else { 1e-2 })?;
        }
        Ok(solver)
    }

    /// Creates a solver that continues from a state.
    pub(crate) fn from_state(
        state: SolverState,
        scene: &'a Scene<'a>,
        options: &'a SolveOptions,
        cancel: &'a AtomicBool,
    ) -> Self {
        Self { scene, state, options, cancel }
    }

    /// Returns the mean irradiance of all surfaces, by luminance, lx.
    fn mean(&self) -> f32 {
        let roots = self.state.arena.roots.iter().filter(|&&root| root != NONE);
        let (sum, area) = roots.fold((0.0f64, 0.0f64), |(sum, area), &root| {
            let size = f64::from(self.state.arena.elements[root as usize].size());
            (sum + size * f64::from(self.state.lights.elements[root as usize].mean), area + size)
        });
        if area > 0.0 { (sum / area) as f32 } else { self.state.lights.elements[self.state.arena.root as usize].mean }
    }

    /// Makes a first estimate of the irradiance of elements, without occlusion of the light sources.
    fn estimate_irradiance(&mut self) {
        let (lights, world) = (&self.scene.prepared.lights, &self.scene.prepared.world);
        let estimates: Vec<f32> = self
            .state
            .arena
            .elements
            .par_iter()
            .map(|element| {
                if element.is_cluster() {
                    return 0.0;
                }
                let at = |spot: &SurfaceSpot, lamp: u32| {
                    let textures = &self.scene.prepared.textures;
                    let sample =
                        lights.sample_light(world, textures, lamp, spot.position, crate::scene::SHUTTER_TIME, [0.5; 2]);
                    sample.map_or(0.0, |sample| {
                        let share = if element.patch().is_some() {
                            spot.normal.dot(sample.dir).max(0.0)
                        } else {
                            0.25
                        };
                        luminance(sample.radiance) * share / sample.pdf
                    })
                };
                let of = |spot: SurfaceSpot| (0..lights.len() as u32).map(|lamp| at(&spot, lamp)).sum::<f32>();
                let sum: f32 = element.nodes().map(of).sum();
                sum / element.node_count() as f32
            })
            .collect();
        for (light, mean) in self.state.lights.elements.iter_mut().zip(estimates) {
            light.mean = if mean.is_finite() { mean } else { 0.0 };
            light.min_mean = light.mean;
        }
        for index in (0..self.state.arena.elements.len()).rev() {
            let element = &self.state.arena.elements[index];
            if !element.is_leaf() {
                let [a, b] = element.children.map(|child| child as usize);
                let sizes = [a, b].map(|child| self.state.arena.elements[child].size());
                let mean = (self.state.lights.elements[a].mean * sizes[0]
                    + self.state.lights.elements[b].mean * sizes[1])
                    / (sizes[0] + sizes[1]);
                self.state.lights.elements[index].mean = if mean.is_finite() { mean } else { 0.0 };
                self.state.lights.elements[index].min_mean =
                    self.state.lights.elements[a].min_mean.min(self.state.lights.elements[b].min_mean);
            }
        }
    }

    fn oracle(&self, error: f32, links: usize) -> Oracle<'_> {
        let area: f32 = self
            .state
            .arena
            .roots
            .iter()
            .filter(|&&root| root != NONE)
            .map(|&root| self.state.arena.elements[root as usize].size())
            .sum();
        let volume = if self.state.arena.fog == NONE {
            0.0
        } else {
            self.state.arena.elements[self.state.arena.fog as usize].size()
        };
        Oracle {
            scene: self.scene,
            arena: &self.state.arena,
            lights: &self.state.lights.elements,
            error,
            floor: IRRADIANCE_FLOOR * self.mean(),
            fog_floor: if self.state.arena.fog == NONE {
                0.0
            } else {
                IRRADIANCE_FLOOR * self.state.lights.elements[self.state.arena.fog as usize].mean
            },
            unit_area: area * UNIT_SHARE,
            unit_volume: volume * UNIT_SHARE,
            min_area: area * MIN_AREA_SHARE * self.options.error,
            min_volume: volume * MIN_VOLUME_SHARE * self.options.error,
            element_budget_exhausted: self.state.bytes(links) > self.options.memory,
            link_budget_exhausted: links > self.options.memory.max(MIN_MEMORY) / size_of::<Link>(),
        }
    }

    /// Computes the light of the sources, on elements that are as fine as it requires.
    fn link_lamps(&mut self, error: f32) -> Result<(), Cancelled> {
        let mut pending: Vec<(u32, u32)> =
            (0..self.scene.prepared.lights.len() as u32).map(|lamp| (self.state.arena.root, lamp)).collect();
        let mut done: Vec<LampLink> = Vec::new();
        while !pending.is_empty() {
            if self.cancel.load(Ordering::Relaxed) {
                return Err(Cancelled);
            }
            let oracle = self.oracle(error, done.len() + pending.len());
            let (verdicts, rays) =
                decide_all(&pending, |&(receiver, lamp), eye| oracle.decide_lamp_link(receiver, lamp, eye));
            self.state.report.rays += rays;
            let mut next = Vec::new();
            for ((receiver, lamp), verdict) in pending.into_iter().zip(verdicts) {
                match verdict {
                    LampLinkDecision::Drop => {}
                    LampLinkDecision::Keep { link, is_inexact: refused } => {
                        done.push(link);
                        self.state.report.inexact_links += usize::from(refused);
                    }
                    LampLinkDecision::SplitReceiver => {
                        let (children, _) = self.state.arena.ensure_children(self.scene, receiver);
                        next.extend(children.map(|child| (child, lamp)));
                    }
                }
            }
            self.state.lights.grow(&self.state.arena);
            pending = next;
        }
        done.sort_unstable_by_key(|link| (link.receiver, link.lamp));
        self.state.report.lamp_links = done.len();
        for light in &mut self.state.lights.elements {
            light.gathered[FROM_LAMPS] = [Rgb::ZERO; 4];
        }
        for arriving in &mut self.state.lights.incident {
            arriving.gathered[FROM_LAMPS] = Harmonics::ZERO;
        }
        for link in done {
            let element = &self.state.arena.elements[link.receiver as usize];
            if let Some(directional) = element.directional() {
                self.state.lights.incident[directional].gathered[FROM_LAMPS] +=
                    Harmonics::from_direction(link.dir, link.light[0]);
            } else {
                let own = &mut self.state.lights.elements[link.receiver as usize].gathered[FROM_LAMPS];
                own.iter_mut().zip(link.light).for_each(|(sum, light)| *sum += light);
            }
        }
        Ok(())
    }

    /// Refines links until each is as exact as requested.
    fn refine_links(&mut self, error: f32) -> Result<(), Cancelled> {
        let mut pending = std::mem::take(&mut self.state.links);
        let mut done = Vec::new();
        while !pending.is_empty() {
            if self.cancel.load(Ordering::Relaxed) {
                return Err(Cancelled);
            }
            let oracle = self.oracle(error, done.len() + pending.len());
            let (verdicts, rays) = decide_all(&pending, |link, eye| oracle.decide(link.receiver, link.source, eye));
            self.state.report.rays += rays;
            let mut next = Vec::new();
            let link = |receiver: u32, source: u32| Link { receiver, source, factors: [0.0; 4] };
            for (Link { receiver, source, .. }, verdict) in pending.into_iter().zip(verdicts) {
                match verdict {
                    LinkDecision::Drop => {}
                    LinkDecision::Keep { link, is_inexact: refused } => {
                        done.push(link);
                        self.state.report.inexact_links += usize::from(refused);
                    }
                    LinkDecision::SplitReceiver => {
                        let (children, _) = self.state.arena.ensure_children(self.scene, receiver);
                        next.extend(children.map(|child| link(child, source)));
                    }
                    LinkDecision::SplitSource => {
                        let (children, _) = self.state.arena.ensure_children(self.scene, source);
                        next.extend(children.map(|child| link(receiver, child)));
                    }
                    LinkDecision::SplitBoth => {
                        let ([a, b], _) = self.state.arena.ensure_children(self.scene, receiver);
                        next.extend([(a, a), (a, b), (b, a), (b, b)].map(|(p, q)| link(p, q)));
                    }
                }
            }
            self.state.lights.grow(&self.state.arena);
            pending = next;
        }
        done.sort_unstable_by_key(|link| (link.receiver, link.source));
        self.state.links = done;
        Ok(())
    }

    fn iterate(&mut self, residual: f32) -> Result<(), Cancelled> {
        let (mut before, mut growing) = (f64::INFINITY, 0);
        for _ in 0..MAX_ITERATIONS {
            if self.cancel.load(Ordering::Relaxed) {
                return Err(Cancelled);
            }
            self.state.lights.gather(&self.state.arena, &self.state.links);
            let (change, whole) = self.state.lights.push_pull(self.scene, &self.state.arena);
            self.state.report.iterations += 1;
            growing = if change > before { growing + 1 } else { 0 };
            if growing == MAX_GROWING && !self.state.report.is_energy_bounded {
                self.state.lights.row_sum(self.scene, &self.state.arena, &self.state.links, EnergyBound::RowSums);
                (self.state.report.is_energy_bounded, before) = (true, f64::INFINITY);
                continue;
            }
            // Total change of further iterations, if each change shrinks at the latest rate.
            let rate = if before.is_finite() { (change / before).min(0.99) } else { 0.99 };
            before = change;
            let left = change * rate / (1.0 - rate);
            self.state.report.residual = if whole > 0.0 { (left / whole) as f32 } else { 0.0 };
            if self.state.report.residual <= residual {
                break;
            }
        }
        Ok(())
    }

    /// Corrects the links' light with the rays, and determines the leaves that are too large for the shadows found.
    pub(crate) fn apply_rays(&mut self, rays: &Rays) -> Result<(), Cancelled> {
        if self.state.is_finished() {
            return Ok(());
        }
        self.state.round += 1;
        if self.state.arena.root == NONE {
            return Ok(());
        }
        let mut contrast = Vec::new();
        for _ in 0..RAY_CHECKS {
            let SolverState { arena, lights, report, .. } = &mut self.state;
            let correction = rays.correct(arena, lights, self.options.error);
            (report.ray_link_ratio, report.ray_correction) = (correction.ratio, correction.changed);
            contrast = correction.contrast;
            self.iterate(TARGET_RESIDUAL)?;
        }
        self.state.max_ray_bytes = self.state.max_ray_bytes.max(rays.bytes());
        self.state.report.rays += rays.traced;
        if !self.state.is_finished() {
            let oracle = self.oracle(self.options.error, self.state.links.len());
            let is_uneven = |&(leaf, contrast): &(u32, f32)| {
                let element = &oracle.arena.elements[leaf as usize];
                0.5 * contrast > oracle.allowed_error(element, &oracle.lights[leaf as usize])
                    && oracle.may_split(element)
            };
            let uneven_leaves = contrast.iter().filter(|leaf| is_uneven(leaf)).map(|&(leaf, _)| leaf).collect();
            self.state.uneven_leaves = uneven_leaves;
            if !self.options.guides && self.state.uneven_leaves.is_empty() {
                // Nothing is split, and new rays would go nowhere else, so they would bring no new information.
                self.state.round = RAY_ROUNDS;
            }
        }
        Ok(())
    }
}

/// Returns the verdicts in order, and the number of their rays.
fn decide_all<T: Sync, V: Send>(
    pending: &[T],
    decide: impl Fn(&T, &mut VisibilityTester) -> V + Sync,
) -> (Vec<V>, u64) {
    let chunks: Vec<(Vec<V>, u64)> = pending
        .par_chunks(256)
        .map(|chunk| {
            let mut tester = VisibilityTester::default();
            let verdicts = chunk.iter().map(|item| decide(item, &mut tester)).collect();
            (verdicts, tester.rays)
        })
        .collect();
    let rays = chunks.iter().map(|(_, rays)| rays).sum();
    (chunks.into_iter().flat_map(|(verdicts, _)| verdicts).collect(), rays)
}

/// Returns the leaves of surfaces, in the order of the field.
pub(crate) fn surface_leaves(arena: &Arena) -> Vec<u32> {
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
    Valid,
    /// Not finite, or negative: the field has no fog.
    Invalid,
}

/// Creates the field of a solution, and the direct light from light sources.
fn build_field(scene: Scene<'_>, arena: &Arena, lights: &ElementLights) -> (Field, Vec<Leaf>, FogLight) {
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
                field.leaves.push(field_leaf(element, order[at], lights, FROM_ELEMENTS));
                direct.push(field_leaf(element, order[at], lights, FROM_LAMPS));
                field.leaves.len() as u32 - 1
            } else {
                order.extend(element.children);
                first + order.len() as u32 - 2
            };
            field.cells.extend(field_cell(element, next));
            at += 1;
        }
    }
    let mut fog = FogLight::Valid;
    if arena.fog != NONE {
        match crate::fog::fog_tree(&scene, arena, lights) {
            Some(tree) => field.fog = tree,
            None => fog = FogLight::Invalid,
        }
    }
    (field.surfaces, field.sides) = (scene.surfaces, scene.sides);
    (field, direct, fog)
}

/// Returns the cell of a part of a surface.
fn field_cell(element: &Element, next: u32) -> Option<Cell> {
    let part = element.surface_part()?;
    let split = if element.is_leaf() { Split::None } else { part.split };
    Some(Cell { outline: part.in_parent, split, next })
}

fn field_leaf(element: &Element, index: u32, lights: &ElementLights, from: usize) -> Leaf {
    if let Shape::Curved(curved) = &element.shape {
        return Leaf::Curved(lights.directional_irradiance(curved, index as usize, from));
    }
    let values = lights.node_irradiance(index as usize, from);
    if element.is_triangle() {
        Leaf::Triangle([values[0], values[1], values[2]])
    } else {
        Leaf::Rectangle(values)
    }
}
