//! Solver: creates elements and links, and iterates until the light no longer changes.

mod acceleration;
mod refine;
mod solution;

pub use solution::Solution;
pub(crate) use solution::{fog_leaves, surface_leaves};

use crate::arena::Arena;
use crate::caustics::Caustics;
use crate::census::Census;
use crate::element::Element;
use crate::exits::ClusterWeights;
use crate::gather::ElementLights;
use crate::link::Link;
use crate::rays::{RayPlan, Rays};
use crate::scene::Scene;
use crate::tuning::{
    COARSE_RAY_CHECKS, COARSE_RESIDUAL, ERROR_LEVELS, MAX_ITERATIONS, MAX_LAMP_ERROR, MAX_RAY_CHECK_RATIO,
    RAY_CHECK_CHANGE, RAY_CHECKS, RAY_ROUNDS, TARGET_RESIDUAL,
};
use acceleration::Acceleration;
use femc_field::NONE;
use std::sync::atomic::{AtomicBool, Ordering};

/// Accuracy and limits of a solution.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SolveOptions {
    /// Maximum error of one link, as a share of its receiver's irradiance.
    pub error: f32,
    /// Limit for the bytes of elements and links. When it is reached, elements are not split further. When links alone reach it,
    /// links are not refined further.
    pub memory: usize,
    /// Guides that the field must have.
    pub guides: GuideKind,
}

/// Kind of the guides of a field.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum GuideKind {
    /// The field has only light.
    #[default]
    None,
    /// Tables of directions of leaves, as in the method of 1998.
    Tables,
}

impl Default for SolveOptions {
    fn default() -> Self {
        Self { error: 0.3, memory: 1 << 30, guides: GuideKind::None }
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
    /// Estimated change of the light that leaves all elements by further iterations, as a share of that light. NaN if the light is
    /// not finite.
    pub residual: f32,
    /// Greatest irradiance of a point by the links if everything that it sees has a radiosity of 1. It is at most 1 if all links are
    /// exact. The light of links is scaled down where it is more.
    pub row_sum: f32,
    /// Light between elements by what they send, relative to what the corrected links bring: 1 if these conserve the light. The
    /// greatest deviation of a channel from 1.
    pub imbalance: f32,
    /// Light that rays find on all surfaces, relative to that of the links there; 1 if the links have none.
    pub ray_link_ratio: f32,
    /// Root mean square of the resulting correction over all surfaces, relative to the links' mean.
    pub ray_correction: f32,
    /// Number of bytes of elements, links and rays.
    pub bytes: usize,
    /// Elements and links by kind.
    pub census: Census,
}

/// Error: the caller cancelled the solution.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Cancelled;

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
}

impl SolverState {
    /// Checks whether all rounds of rays are done.
    pub(crate) fn is_finished(&self) -> bool {
        self.round == RAY_ROUNDS
    }

    /// Returns the change of the sent flux, relative to that flux.
    /// - `before`: output of [`ElementLights::sent_light`] before the change.
    fn change_since(&self, before: &[f32]) -> f32 {
        let weights = ElementLights::sent_light_weights(&self.arena);
        let (mut change, mut whole) = (0.0f64, 0.0f64);
        for ((now, before), weight) in self.lights.sent_light(&self.arena).iter().zip(before).zip(weights) {
            change += f64::from(weight * (now - before).abs());
            whole += f64::from(weight * now);
        }
        if whole > 0.0 { (change / whole) as f32 } else { 0.0 }
    }

    fn bytes(&self, links: usize) -> usize {
        links * size_of::<Link>()
            + self.arena.elements.len() * (size_of::<Element>() + ElementLights::BYTES)
            + self.arena.directional_count * ElementLights::DIRECTIONAL_BYTES
    }

    /// Plans the next rays.
    /// - `memory`: maximum number of bytes of elements, links and rays.
    pub(crate) fn ray_plan(&self, memory: usize) -> RayPlan {
        if self.is_finished() {
            return RayPlan::empty();
        }
        let room = memory.saturating_sub(self.bytes(self.links.len()));
        RayPlan::new(&self.arena, &self.lights, self.round + 1, room)
    }

    /// Splits the leaves on which rays have found shadows.
    pub(crate) fn split_uneven_leaves(&mut self, scene: &Scene<'_>) {
        for leaf in std::mem::take(&mut self.uneven_leaves) {
            let (halves, _) = self.arena.ensure_children(scene, leaf);
            for half in halves {
                self.arena.ensure_children(scene, half);
            }
        }
        self.lights.grow(scene, &self.arena);
        self.lights.reflect_all(scene, &self.arena);
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
        let state = SolverState { arena, lights, links, report, max_ray_bytes: 0, round: 0, uneven_leaves: Vec::new() };
        let mut solver = Self::from_state(state, scene, options, cancel);
        let root = solver.state.arena.root;
        if root == NONE {
            return Ok(solver);
        }
        solver.estimate_irradiance(0);
        let mut dark = vec![[root, root]];
        let (caustics, rays) = Caustics::trace(scene, &solver.state.arena);
        solver.state.report.rays += rays;
        for (round, coarse) in ERROR_LEVELS.into_iter().enumerate() {
            let is_last = round + 1 == ERROR_LEVELS.len();
            solver.state.report.inexact_links = 0;
            let error = options.error * coarse;
            // Direct light first, then the light between elements.
            solver.link_lamps(error.min(MAX_LAMP_ERROR), round == 0)?;
            solver.refine_caustics(&caustics, error)?;
            if round == 0 {
                solver.state.lights.reflect_all(scene, &solver.state.arena);
            }
            solver.refine_links(error, &mut dark)?;
            solver.set_caustics(&caustics);
            let SolverState { arena, lights, links, report, .. } = &mut solver.state;
            report.row_sum = lights.bound_rows(arena, links);
            solver.iterate(if is_last { TARGET_RESIDUAL } else { COARSE_RESIDUAL })?;
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

    /// Passes light through all links until it no longer changes.
    /// - `target`: residual at which the iteration ends.
    fn iterate(&mut self, target: f32) -> Result<(), Cancelled> {
        let SolverState { arena, lights, links, report, .. } = &mut self.state;
        let mut acceleration = Acceleration::new(ElementLights::sent_light_weights(arena));
        for iteration in 1..=MAX_ITERATIONS {
            if self.cancel.load(Ordering::Relaxed) {
                return Err(Cancelled);
            }
            let input = lights.sent_light(arena);
            lights.gather(arena, links);
            report.residual = lights.reflect_all(self.scene, arena).residual();
            report.iterations += 1;
            // At the end, the elements send what they reflect, not an extrapolation, which rays would compare with the links' light.
            if report.residual <= target || report.residual.is_nan() || iteration == MAX_ITERATIONS {
                break;
            }
            let next = acceleration.next_input(&input, lights.sent_light(arena));
            lights.set_sent_light(arena, &next);
        }
        report.imbalance = lights.balance.to_array().map(|factor| (factor - 1.0).abs()).into_iter().fold(0.0, f32::max);
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
        let SolverState { arena, lights, links, report, .. } = &mut self.state;
        lights.cluster_weights = ClusterWeights::from_exit_shares(arena, rays.exit_shares(arena));
        report.row_sum = lights.bound_rows(arena, links);
        lights.gather(arena, links);
        let lamp_contrast = rays.correct_lamps(arena, lights, self.options.error);
        rays.measure_arriving_shares(arena, lights);
        let checks = if self.state.is_finished() { RAY_CHECKS } else { COARSE_RAY_CHECKS };
        let (mut last_change, mut latest) = (f32::INFINITY, None);
        for _ in 0..checks {
            let SolverState { arena, lights, report, .. } = &mut self.state;
            let before = lights.sent_light(arena);
            let correction = rays.correct(arena, lights, self.options.error);
            (report.ray_link_ratio, report.ray_correction) = (correction.ratio, correction.changed);
            latest = Some(correction);
            self.iterate(TARGET_RESIDUAL)?;
            let change = self.state.change_since(&before);
            if change <= RAY_CHECK_CHANGE || change > MAX_RAY_CHECK_RATIO * last_change {
                break;
            }
            last_change = change;
        }
        let SolverState { arena, lights, .. } = &mut self.state;
        let contrast = latest.map_or_else(Vec::new, |correction| {
            rays.estimate_errors(arena, lights, &correction);
            correction.contrast
        });
        self.state.max_ray_bytes = self.state.max_ray_bytes.max(rays.bytes());
        self.state.report.rays += rays.traced;
        if !self.state.is_finished() {
            let oracle = self.oracle(self.options.error, self.state.links.len());
            let is_uneven = |((leaf, contrast), of_lamps): &((u32, f32), f32)| {
                let element = &oracle.arena.elements[*leaf as usize];
                // The light of fog has no shadows as sharp as those on surfaces.
                !element.is_volume()
                    && 0.5 * contrast.max(*of_lamps) > oracle.allowed_error(element, &oracle.lights[*leaf as usize])
                    && oracle.may_split(*leaf)
            };
            let both = contrast.into_iter().zip(lamp_contrast);
            let uneven_leaves = both.filter(is_uneven).map(|((leaf, _), _)| leaf).collect();
            self.state.uneven_leaves = uneven_leaves;
            if self.state.uneven_leaves.is_empty() {
                // Nothing is split, and new rays would go nowhere else, so they would bring no new information.
                self.state.round = RAY_ROUNDS;
            }
        }
        Ok(())
    }
}
