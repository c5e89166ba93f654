//! Refinement: elements and links as fine as the light requires.

use super::{Cancelled, Solver, SolverState};
use crate::arena::Arena;
use crate::caustics::{CausticLight, Caustics};
use crate::element::Element;
use crate::gather::FROM_LAMPS;
use crate::lamps::{LampLink, LampLinkDecision};
use crate::link::{Link, LinkDecision, Oracle};
use crate::scene::SHUTTER_TIME;
use crate::tuning::{
    CLUSTER_SAMPLES, IRRADIANCE_FLOOR, MAX_REFERENCE, MIN_AREA_SHARE, MIN_LINK_MEMORY, MIN_VOLUME_SHARE, UNIT_SHARE,
};
use crate::visibility::VisibilityTester;
use femc_field::{Harmonics, NONE, SurfaceSpot};
use femc_math::color::luminance;
use femc_math::glam::{Vec2, Vec3A};
use rayon::prelude::*;
use std::sync::atomic::Ordering;

impl Solver<'_> {
    /// Returns the mean irradiance of all surfaces, by luminance, lx.
    fn mean(&self) -> f32 {
        let Arena { surfaces, root, .. } = self.state.arena;
        self.state.lights.elements[if surfaces == NONE { root } else { surfaces } as usize].mean
    }

    /// Makes a first estimate of the irradiance of the elements from index `first` on, without occlusion of the light sources. Parts
    /// of surfaces and of fog have the estimate of the whole.
    pub(super) fn estimate_irradiance(&mut self, first: usize) {
        let (lights, world) = (&self.scene.prepared.lights, &self.scene.prepared.world);
        let arena = &self.state.arena;
        let estimates: Vec<Option<f32>> = arena.elements[first..]
            .par_iter()
            .map(|element| {
                let has_parts = element.is_cluster() && !element.is_leaf();
                if has_parts || arena.elements.get(element.parent as usize).is_some_and(|parent| !parent.is_cluster()) {
                    return None;
                }
                let at = |spot: &SurfaceSpot, lamp: u32| {
                    let textures = &self.scene.prepared.textures;
                    let sample = lights.sample_light(world, textures, lamp, spot.position, SHUTTER_TIME, [0.5; 2]);
                    sample.map_or(0.0, |sample| {
                        let has_normal = spot.normal != Vec3A::ZERO;
                        let share = if has_normal { spot.normal.dot(sample.dir).max(0.0) } else { 0.25 };
                        luminance(sample.radiance) * share / sample.pdf
                    })
                };
                let of = |spot: SurfaceSpot| (0..lights.len() as u32).map(|lamp| at(&spot, lamp)).sum::<f32>();
                let finite = |mean: f32| if mean.is_finite() { mean } else { 0.0 };
                let members = arena.members(element);
                if members.is_empty() {
                    return Some(finite(element.nodes().map(of).sum::<f32>() / element.node_count() as f32));
                }
                let (mut sum, mut area) = (0.0, 0.0);
                for member in members.iter().step_by(members.len().div_ceil(CLUSTER_SAMPLES)) {
                    let source = &self.scene.surfaces[member.surface as usize];
                    let mean = finite(of(source.point_at(Vec2::splat(1.0 / 3.0))));
                    (sum, area) = (sum + mean * member.area, area + member.area);
                }
                Some(sum / area)
            })
            .collect();
        for (light, estimate) in self.state.lights.elements[first..].iter_mut().zip(estimates) {
            if let Some(mean) = estimate {
                (light.mean, light.min_mean) = (mean, mean);
            }
        }
        for index in (first..self.state.arena.elements.len()).rev() {
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

    pub(super) fn oracle(&self, error: f32, links: usize) -> Oracle<'_> {
        let size = |element: u32| self.state.arena.elements.get(element as usize).map_or(0.0, Element::size);
        let (area, volume) = (size(self.state.arena.surfaces), size(self.state.arena.fog));
        let mean = self.mean();
        // If all light of the lamps arrived once. The mean may be unknown in the beginning.
        let lamps = &self.scene.prepared.lights;
        let of_lamps = (0..lamps.len() as u32).map(|lamp| lamps.power(lamp)).sum::<f32>() / area.max(f32::MIN_POSITIVE);
        Oracle {
            scene: self.scene,
            arena: &self.state.arena,
            lights: &self.state.lights.elements,
            intensity: &self.state.lights.intensity,
            error,
            floor: IRRADIANCE_FLOOR * mean,
            max_reference: MAX_REFERENCE * mean.max(of_lamps),
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
            link_budget_exhausted: links > self.options.memory.max(MIN_LINK_MEMORY) / size_of::<Link>(),
        }
    }

    /// Computes the light of the sources, on elements that are as fine as it requires.
    /// - `is_first`: whether no light is known yet.
    pub(super) fn link_lamps(&mut self, error: f32, is_first: bool) -> Result<(), Cancelled> {
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
            let first = self.state.lights.elements.len();
            self.state.lights.grow(self.scene, &self.state.arena);
            if is_first {
                self.estimate_irradiance(first);
            }
            pending = next;
        }
        done.sort_unstable_by_key(|link| (link.receiver, link.lamp));
        self.state.report.lamp_links = done.len();
        let SolverState { arena, lights, .. } = &mut self.state;
        lights.clear(FROM_LAMPS);
        for link in done {
            if let Some(directional) = arena.elements[link.receiver as usize].directional() {
                lights.incident[directional].total[FROM_LAMPS] += Harmonics::from_direction(link.dir, link.light[0]);
            } else {
                let own = &mut lights.elements[link.receiver as usize].total[FROM_LAMPS];
                own.iter_mut().zip(link.light).for_each(|(sum, light)| *sum += light);
            }
        }
        lights.push(arena, FROM_LAMPS);
        Ok(())
    }

    /// Sets the light of caustics on all elements. Returns the leaves that have some, and the difference between the irradiances of
    /// their parts, lx.
    pub(super) fn set_caustics(&mut self, caustics: &Caustics) -> Vec<(u32, f32)> {
        if caustics.is_empty() {
            return Vec::new();
        }
        let CausticLight { nodes, contrast } = caustics.light(&self.state.arena);
        self.state.lights.caustics = nodes;
        contrast
    }

    /// Splits leaves until each represents the light of caustics as exactly as requested.
    pub(super) fn refine_caustics(&mut self, caustics: &Caustics, error: f32) -> Result<(), Cancelled> {
        loop {
            let contrast = self.set_caustics(caustics);
            if contrast.is_empty() {
                return Ok(());
            }
            if self.cancel.load(Ordering::Relaxed) {
                return Err(Cancelled);
            }
            self.state.lights.reflect_all(self.scene, &self.state.arena);
            let oracle = self.oracle(error, self.state.links.len());
            let is_uneven = |&&(leaf, contrast): &&(u32, f32)| {
                let element = &oracle.arena.elements[leaf as usize];
                let allowed = oracle.allowed_error(element, &oracle.lights[leaf as usize]);
                0.5 * contrast > allowed && oracle.may_split(leaf)
            };
            let uneven: Vec<u32> = contrast.iter().filter(is_uneven).map(|&(leaf, _)| leaf).collect();
            if uneven.is_empty() {
                return Ok(());
            }
            for leaf in uneven {
                self.state.arena.ensure_children(self.scene, leaf);
            }
            self.state.lights.grow(self.scene, &self.state.arena);
        }
    }

    /// Refines links until each is as exact as requested.
    /// - `dark`: receivers and sources of links that brought no light at the last level, ascending. The function tests these links again,
    ///   and replaces the list by the links that bring no light at this level.
    pub(super) fn refine_links(&mut self, error: f32, dark: &mut Vec<[u32; 2]>) -> Result<(), Cancelled> {
        let links = std::mem::take(&mut self.state.links);
        let mut pending: Vec<[u32; 2]> = std::mem::take(dark);
        pending.extend(links.into_iter().map(|link| [link.receiver, link.source]));
        // The order determines in which order elements are created.
        pending.sort_unstable();
        let mut done = Vec::new();
        self.state.lights.link_errors.fill(0.0);
        while !pending.is_empty() {
            if self.cancel.load(Ordering::Relaxed) {
                return Err(Cancelled);
            }
            let oracle = self.oracle(error, done.len() + pending.len());
            let (verdicts, rays) =
                decide_all(&pending, |&[receiver, source], eye| oracle.decide(receiver, source, eye));
            self.state.report.rays += rays;
            let mut next = Vec::new();
            for ([receiver, source], verdict) in pending.into_iter().zip(verdicts) {
                match verdict {
                    LinkDecision::Drop => {}
                    LinkDecision::Keep { link, is_inexact: refused, error } => {
                        if link.factors == [0.0; 4] {
                            dark.push([receiver, source]);
                        } else {
                            done.push(link);
                            self.state.lights.link_errors[receiver as usize] += error * error;
                        }
                        self.state.report.inexact_links += usize::from(refused);
                    }
                    LinkDecision::SplitReceiver => {
                        let (children, _) = self.state.arena.ensure_children(self.scene, receiver);
                        next.extend(children.map(|child| [child, source]));
                    }
                    LinkDecision::SplitSource => {
                        let (children, _) = self.state.arena.ensure_children(self.scene, source);
                        next.extend(children.map(|child| [receiver, child]));
                    }
                    LinkDecision::SplitBoth => {
                        let ([a, b], _) = self.state.arena.ensure_children(self.scene, receiver);
                        next.extend([[a, a], [a, b], [b, a], [b, b]]);
                    }
                }
            }
            self.state.lights.grow(self.scene, &self.state.arena);
            pending = next;
        }
        done.sort_unstable_by_key(|link| (link.receiver, link.source));
        self.state.links = done;
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
