//! First pass in steps, which several machines can share.
//!
//! [`SolverState::new`] links all elements on one machine. Then, three times, rays are cast and their results are applied. The rays
//! are cast by blocks of leaves ([`CastingState::cast`]), the rest is done on one machine again ([`CastingState::apply_hits`]).
//! The state between steps travels as bytes. The blocks depend only on the elements, so the distribution over machines changes no
//! bit, and [`crate::solve`], which does all steps in one process, has the same result.

use crate::arena::Arena;
use crate::bytes::{Reader, StepDecodeError, Writer, colors_from_floats, to_floats};
use crate::element::Element;
use crate::exits::ClusterWeights;
use crate::gather::{ElementLight, ElementLights, FROM_ELEMENTS, FROM_LAMPS, IncidentLight};
use crate::link::Link;
use crate::rays::{RayHits, RayPlan};
use crate::scene::Scene;
use crate::solve::{Cancelled, GuideKind, Solution, SolveOptions, SolveReport, Solver, SolverState};
use crate::tables::direction_tables;
use femc_field::{Cell, Harmonics, Leaf, NONE};
use femc_math::Rgb;
use femc_math::hash::mix64;
use femc_prepared::Prepared;
use std::sync::atomic::AtomicBool;

/// Computes the light of a prepared frame. The result depends only on the frame and the options, not on threads.
/// - errors: `cancel` was set.
pub fn solve(prepared: &Prepared, options: &SolveOptions, cancel: &AtomicBool) -> Result<Solution, Cancelled> {
    let mut state = SolverState::new(prepared, options, cancel)?;
    while !state.is_finished() {
        let casting = state.plan_rays(prepared, options);
        let hits = vec![casting.cast(prepared, 0, 1)];
        state = correct_with_rays(casting.state, casting.plan, prepared, options, hits, cancel)?;
    }
    Ok(state.solution(prepared, options))
}

/// Returns the minimum number of bytes of the first pass of a prepared frame: for the tree of clusters over all surfaces, and for
/// the leaves of the field. Memory for elements, links and rays beyond that follows from [`SolveOptions::memory`].
pub fn min_solve_bytes(prepared: &Prepared) -> u64 {
    let surface = Arena::SURFACE_BYTES + 2 * size_of::<Leaf>() + size_of::<Cell>();
    (Scene::new(prepared).surfaces.len() * surface) as u64
}

/// A first pass before rays are cast.
#[derive(Debug)]
pub struct CastingState {
    state: SolverState,
    plan: RayPlan,
}

const ELEMENTS_MAGIC: &[u8; 8] = b"element7";
const LINKS_MAGIC: &[u8; 8] = b"links  1";

impl SolverState {
    /// Creates all elements and links of a prepared frame, before rays are cast.
    /// - errors: `cancel` was set.
    pub fn new(prepared: &Prepared, options: &SolveOptions, cancel: &AtomicBool) -> Result<Self, Cancelled> {
        let scene = Scene::new(prepared);
        Ok(Solver::new(&scene, options, cancel)?.state)
    }

    /// Returns the number of times that rays have been cast.
    pub fn round(&self) -> u32 {
        self.round
    }

    /// Returns the statistics so far.
    pub fn report(&self) -> SolveReport {
        let elements = self.arena.elements.iter().filter(|element| element.is_leaf() || !element.is_cluster()).count();
        SolveReport { elements, links: self.links.len(), ..self.report }
    }

    /// Prepares the state for casting rays.
    pub fn plan_rays(mut self, prepared: &Prepared, options: &SolveOptions) -> CastingState {
        let scene = Scene::new(prepared);
        if self.arena.root != NONE && !self.is_finished() {
            self.split_uneven_leaves(&scene);
        }
        let plan = self.ray_plan(options.memory);
        CastingState { state: self, plan }
    }

    /// Creates the solution.
    pub fn solution(&self, prepared: &Prepared, options: &SolveOptions) -> Solution {
        let mut solution = self.finish(Scene::new(prepared));
        if options.guides == GuideKind::Tables && self.arena.root != NONE {
            solution.field.tables = direction_tables(&self.arena, &self.lights, &self.links);
        }
        solution
    }

    /// Encodes the state of the first step: the elements and the links.
    pub fn encode_start(&self) -> Vec<u8> {
        let (elements, links) = rayon::join(|| self.encode_elements(), || self.encode_links());
        [&(elements.len() as u64).to_le_bytes()[..], &elements, &links].concat()
    }

    /// Splits the output of [`SolverState::encode_start`] into that of [`SolverState::encode_elements`] and that of
    /// [`SolverState::encode_links`].
    /// - errors: the bytes end early.
    pub fn split_start(bytes: &[u8]) -> Result<(&[u8], &[u8]), StepDecodeError> {
        let parts = bytes.split_first_chunk::<8>().and_then(|(length, rest)| {
            let length = usize::try_from(u64::from_le_bytes(*length)).ok()?;
            rest.split_at_checked(length)
        });
        parts.ok_or(StepDecodeError::Damaged("it ends early"))
    }

    /// Encodes the links, which do not change after the first step.
    pub fn encode_links(&self) -> Vec<u8> {
        let mut writer = Writer::new(LINKS_MAGIC);
        writer.numbers(self.links.iter().map(|link| link.receiver));
        writer.numbers(self.links.iter().map(|link| link.source));
        writer.rows(&self.links.iter().map(|link| link.factors).collect::<Vec<_>>());
        writer.finish()
    }

    /// Encodes everything else: the splits of the elements, and their light.
    pub fn encode_elements(&self) -> Vec<u8> {
        let mut writer = Writer::new(ELEMENTS_MAGIC);
        let SolveReport {
            lamp_links,
            inexact_links: refused,
            rays,
            iterations,
            residual,
            row_sum,
            imbalance,
            ray_link_ratio: checked,
            ray_correction: corrected,
            ..
        } = self.report;
        writer.number(links_digest(&self.links));
        writer.number(u64::from(self.round));
        let measured = usize::from(self.lights.has_measured_shares);
        let numbers = [lamp_links, refused, iterations, measured, self.max_ray_bytes];
        numbers.into_iter().for_each(|number| writer.number(number as u64));
        writer.number(rays);
        writer.rows(&[[residual, row_sum, imbalance, checked, corrected]]);
        let [r, g, b] = self.lights.balance.to_array();
        writer.rows(&[[r, g, b, self.lights.share_variance]]);
        writer.numbers(self.arena.splits.iter().copied());
        writer.numbers(self.uneven_leaves.iter().copied());
        let ElementLights {
            elements: lights,
            incident,
            intensity,
            cluster_weights,
            row_scale,
            lamp_scale,
            lamp_correction,
            ray_correction,
            arriving_share,
            caustics,
            link_errors,
            errors,
            ..
        } = &self.lights;
        let brightness = |light: &ElementLight| {
            let ElementLight { radiosity, darkest, brightest, mean, min_mean: least, .. } = light;
            let [r, g, b] = radiosity.to_array();
            [r, g, b, *darkest, *brightest, *mean, *least]
        };
        writer.rows(&lights.iter().map(brightness).collect::<Vec<_>>());
        writer.number(cluster_weights.weights.len() as u64);
        writer.rows(&cluster_weights.weights.iter().map(|weight| [*weight]).collect::<Vec<_>>());
        writer.rows(row_scale);
        writer.rows(lamp_scale);
        writer.rows(&lamp_correction.iter().map(to_floats::<4, 12>).collect::<Vec<_>>());
        writer.rows(arriving_share);
        writer.rows(&link_errors.iter().zip(errors).map(|(of_links, error)| [*of_links, *error]).collect::<Vec<_>>());
        writer.rows(&ray_correction.iter().map(to_floats::<4, 12>).collect::<Vec<_>>());
        writer.number(caustics.len() as u64);
        writer.rows(&caustics.iter().map(to_floats::<4, 12>).collect::<Vec<_>>());
        // Wide elements store their light by direction, others at their nodes.
        let elements = || self.arena.elements.iter().zip(lights);
        let own = |kind: usize| -> Vec<[f32; 12]> {
            elements()
                .filter(|(element, _)| !element.is_directional())
                .map(|(_, light)| to_floats(&light.total[kind]))
                .collect()
        };
        [FROM_LAMPS, FROM_ELEMENTS].into_iter().for_each(|kind| writer.rows(&own(kind)));
        writer.rows(&intensity.iter().map(|sent| to_floats::<9, 27>(&sent.0)).collect::<Vec<_>>());
        let around = |get: fn(&IncidentLight) -> &Harmonics| -> Vec<[f32; 27]> {
            incident.iter().map(|arriving| to_floats(&get(arriving).0)).collect()
        };
        writer.rows(&around(|arriving| &arriving.total[FROM_LAMPS]));
        writer.rows(&around(|arriving| &arriving.total[FROM_ELEMENTS]));
        writer.rows(&around(|arriving| &arriving.ray_correction));
        writer.finish()
    }

    /// Decodes the output of [`SolverState::encode_elements`] and [`SolverState::encode_links`], for the same world.
    /// - errors: the bytes are damaged, or belong to different worlds.
    pub fn decode(prepared: &Prepared, elements: &[u8], links: &[u8]) -> Result<Self, StepDecodeError> {
        let scene = Scene::new(prepared);
        let mut reader = Reader::new(elements, ELEMENTS_MAGIC)?;
        let digest = reader.number()?;
        let mut number =
            || usize::try_from(reader.number()?).map_err(|_| StepDecodeError::Damaged("a number is too large"));
        let round = number()?;
        let [lamp_links, refused, iterations, measured, max_ray_bytes] =
            [number()?, number()?, number()?, number()?, number()?];
        let rays = reader.number()?;
        let [residual, row_sum, imbalance, checked, corrected] = reader.rows::<5>(1)?[0];
        let [r, g, b, share_variance] = reader.rows::<4>(1)?[0];
        let report = SolveReport {
            lamp_links,
            inexact_links: refused,
            rays,
            iterations,
            residual,
            row_sum,
            imbalance,
            ray_link_ratio: checked,
            ray_correction: corrected,
            ..SolveReport::default()
        };
        let mut arena = Arena::new(&scene);
        for cut in reader.numbers()? {
            if !arena.elements.get(cut as usize).is_some_and(Element::is_leaf) {
                return Err(OTHER_ELEMENTS);
            }
            arena.ensure_children(&scene, cut);
        }
        let uneven_leaves = reader.numbers()?;
        let is_surface = |leaf: &u32| {
            arena
                .elements
                .get(*leaf as usize)
                .is_some_and(|element| element.is_leaf() && element.surface_part().is_some())
        };
        if !uneven_leaves.iter().all(is_surface) {
            return Err(OTHER_ELEMENTS);
        }
        let mut lights = ElementLights::new(&arena);
        let count = arena.elements.len();
        for (light, row) in lights.elements.iter_mut().zip(reader.rows::<7>(count)?) {
            let [r, g, b, darkest, brightest, mean, least] = row;
            let radiosity = Rgb::from_array([r, g, b]);
            *light = ElementLight { radiosity, darkest, brightest, mean, min_mean: least, ..ElementLight::ZERO };
        }
        let number = usize::try_from(reader.number()?).unwrap_or(usize::MAX);
        let weights = reader.rows::<1>(number)?.into_iter().map(|[weight]| weight).collect();
        lights.cluster_weights = ClusterWeights::from_numbers(&arena, weights).ok_or(OTHER_ELEMENTS)?;
        lights.row_scale = reader.rows::<4>(count)?;
        lights.lamp_scale = reader.rows::<4>(count)?;
        lights.lamp_correction = reader.rows::<12>(count)?.iter().map(|row| colors_from_floats(row)).collect();
        lights.arriving_share = reader.rows::<4>(count)?;
        (lights.link_errors, lights.errors) = reader.rows::<2>(count)?.into_iter().map(|row| (row[0], row[1])).unzip();
        (lights.has_measured_shares, lights.balance) = (measured != 0, Rgb::from_array([r, g, b]));
        lights.share_variance = share_variance;
        lights.ray_correction = reader.rows::<12>(count)?.iter().map(|row| colors_from_floats(row)).collect();
        let of_caustics = if reader.number()? == 0 { 0 } else { count };
        lights.caustics = reader.rows::<12>(of_caustics)?.iter().map(|row| colors_from_floats(row)).collect();
        let elements = || arena.elements.iter().enumerate();
        let at_nodes: Vec<usize> =
            elements().filter(|(_, element)| !element.is_directional()).map(|(index, _)| index).collect();
        for kind in [FROM_LAMPS, FROM_ELEMENTS] {
            for (&index, row) in at_nodes.iter().zip(reader.rows::<12>(at_nodes.len())?) {
                lights.elements[index].total[kind] = colors_from_floats(&row);
            }
        }
        let count = arena.directional_count;
        lights.intensity = reader.rows::<27>(count)?.iter().map(|row| Harmonics(colors_from_floats(row))).collect();
        let sets: [fn(&mut IncidentLight) -> &mut Harmonics; 3] =
            [|it| &mut it.total[FROM_LAMPS], |it| &mut it.total[FROM_ELEMENTS], |it| &mut it.ray_correction];
        for set in sets {
            for (arriving, row) in lights.incident.iter_mut().zip(reader.rows::<27>(count)?) {
                *set(arriving) = Harmonics(colors_from_floats(&row));
            }
        }
        reader.expect_end()?;
        let links = read_links(&arena, links)?;
        if links_digest(&links) != digest {
            return Err(OTHER_ELEMENTS);
        }
        Ok(Self { arena, lights, links, report, max_ray_bytes, round: round as u32, uneven_leaves })
    }
}

fn read_links(arena: &Arena, bytes: &[u8]) -> Result<Vec<Link>, StepDecodeError> {
    let mut reader = Reader::new(bytes, LINKS_MAGIC)?;
    let (receivers, sources) = (reader.numbers()?, reader.numbers()?);
    let factors = reader.rows::<4>(receivers.len())?;
    reader.expect_end()?;
    let ends = receivers.iter().zip(&sources);
    let is_there = |end: &u32| (*end as usize) < arena.elements.len();
    if receivers.len() != sources.len()
        || !receivers.is_sorted()
        || !ends.clone().all(|(p, q)| is_there(p) && is_there(q))
    {
        return Err(OTHER_ELEMENTS);
    }
    let links = ends.zip(factors).map(|((&receiver, &source), factors)| Link { receiver, source, factors });
    Ok(links.collect())
}

/// Computes a digest that distinguishes links.
fn links_digest(links: &[Link]) -> u64 {
    let of = |link: &Link| u64::from(link.receiver) << 32 | u64::from(link.source);
    links.iter().fold(links.len() as u64, |mark, link| mix64(mark ^ of(link)))
}

const OTHER_ELEMENTS: StepDecodeError = StepDecodeError::Damaged("it belongs to other elements");

impl CastingState {
    /// Casts the rays of block `block` of `blocks` blocks.
    pub fn cast(&self, prepared: &Prepared, block: u32, blocks: u32) -> RayHits {
        let scene = Scene::new(prepared);
        self.plan.cast(&scene, &self.state.arena, self.plan.block_range(block, blocks))
    }

    /// Applies the results of the rays of all blocks, in order.
    /// - returns `None` if they belong to other elements;
    /// - errors: `cancel` was set.
    pub fn apply_hits(
        &self,
        prepared: &Prepared,
        options: &SolveOptions,
        hits: Vec<RayHits>,
        cancel: &AtomicBool,
    ) -> Result<Option<SolverState>, Cancelled> {
        let fits = self.plan.matches_hits(&self.state.arena, &hits);
        let taken = || correct_with_rays(self.state.clone(), self.plan.clone(), prepared, options, hits, cancel);
        fits.then(taken).transpose()
    }
}

/// Applies the results of all rays.
fn correct_with_rays(
    state: SolverState,
    plan: RayPlan,
    prepared: &Prepared,
    options: &SolveOptions,
    hits: Vec<RayHits>,
    cancel: &AtomicBool,
) -> Result<SolverState, Cancelled> {
    let scene = Scene::new(prepared);
    let rays = plan.into_rays(hits);
    let mut solver = Solver::from_state(state, &scene, options, cancel);
    solver.apply_rays(&rays)?;
    Ok(solver.state)
}
