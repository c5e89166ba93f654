//! First pass in steps, which several machines can share.
//!
//! [`Underway::begin`] links all elements on one machine. Then, three times, rays are cast and their results are applied. The rays
//! are cast by blocks of leaves ([`Aimed::cast`]), the rest is done on one machine again ([`Aimed::settle`]). Between two rounds,
//! and at the end if the field guides paths, the guides are computed by blocks of groups of leaves ([`Settled::guides`]). The state
//! between steps travels as bytes. The blocks depend only on the elements, so the distribution over machines changes no bit, and
//! [`crate::solve`], which does all steps in one process, has the same result.

use crate::arena::Arena;
use crate::bytes::{Damaged, Reader, Writer, colors, flat, place};
use crate::element::{Element, Kind};
use crate::gather::{Arriving, FROM_ELEMENTS, FROM_SOURCES, Light, Lights};
use crate::incoming::{self, Purpose};
use crate::link::Link;
use crate::portals::{self, Portal};
use crate::rays::{Aims, Casting, Rays, Sights, are_whole, origins, part};
use crate::scene::Scene;
use crate::solve::{Cancelled, Options, Report, Solution, Solver, Underway, leaves};
use femc_field::{Guide, Harmonics, Lobe, NONE};
use femc_math::Rgb;
use femc_math::hash::mix64;
use femc_prepared::Prepared;
use std::sync::OnceLock;
use std::sync::atomic::AtomicBool;

/// Computes the light of a prepared frame. The result depends only on the frame and the options, not on threads.
/// - errors: `cancel` was set.
pub fn solve(prepared: &Prepared, options: &Options, cancel: &AtomicBool) -> Result<Solution, Cancelled> {
    let (mut underway, mut found) = (Underway::begin(prepared, options, cancel)?, Vec::new());
    while !underway.is_settled() {
        let aimed = underway.aim(prepared, options, found);
        let sights = vec![aimed.cast(prepared, 0, 1)];
        let settled = take_in(aimed.underway, aimed.casting, prepared, options, sights, cancel)?;
        found = if options.guides { vec![settled.guides(prepared, 0, 1)] } else { Vec::new() };
        underway = settled.underway;
    }
    Ok(underway.solution(prepared, found))
}

/// Returns the minimum number of bytes of the first pass of a prepared frame: for elements that are not split, and for one ray from
/// each part of them. Memory for splits and links beyond that follows from [`Options::memory`].
pub fn least_bytes(prepared: &Prepared) -> u64 {
    let surfaces = Scene::new(prepared).surfaces.len();
    // Each surface is an element, and has about one cluster.
    (surfaces * (2 * (size_of::<Element>() + Lights::BYTES) + size_of::<Arriving>() + crate::rays::LEAST_BYTES)) as u64
}

/// A first pass before rays are cast, with their guides.
#[derive(Debug)]
pub struct Aimed {
    underway: Underway,
    aims: Aims,
    casting: Casting,
}

/// A first pass after the results of rays were applied.
#[derive(Debug)]
pub struct Settled {
    underway: Underway,
    rays: Rays,
    groups: OnceLock<Groups>,
}

/// Groups of leaves that have one guide each.
#[derive(Debug)]
struct Groups {
    groups: Vec<(u32, Vec<u32>)>,
    /// Total rays and leaves of the groups before each group, and at the end of all.
    first: Vec<u32>,
}

/// Guides of some groups of leaves.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Found {
    groups: Vec<Vec<u32>>,
    found: Vec<(f32, Vec<Lobe>)>,
}

const ELEMENTS: &[u8; 8] = b"element2";
const LINKS: &[u8; 8] = b"links  1";
const FOUND: &[u8; 8] = b"guides 2";

impl Underway {
    /// Creates all elements and links of a prepared frame, before rays are cast.
    /// - errors: `cancel` was set.
    pub fn begin(prepared: &Prepared, options: &Options, cancel: &AtomicBool) -> Result<Self, Cancelled> {
        let scene = Scene::new(prepared);
        Ok(Solver::new(&scene, options, cancel)?.now)
    }

    /// Returns the number of times that rays have been cast.
    pub fn round(&self) -> u32 {
        self.round
    }

    /// Returns the statistics so far.
    pub fn report(&self) -> Report {
        let elements = self.arena.elements.iter().filter(|element| element.kind != Kind::Cluster).count();
        Report { elements, links: self.links.len(), ..self.report }
    }

    /// Prepares the state for casting rays.
    /// - `found`: guides of all groups of leaves, in order; none before the first rays.
    pub fn aim(mut self, prepared: &Prepared, options: &Options, found: Vec<Found>) -> Aimed {
        let scene = Scene::new(prepared);
        let leaves = leaves(&self.arena);
        let (guides, lobes) = joined(found, &leaves);
        let mut aims = Aims::new(&self.arena, &leaves, &guides, &lobes);
        if self.arena.root != NONE {
            self.cut(&scene);
        }
        aims.grow(&self.arena);
        let casting = self.casting(options.memory);
        Aimed { underway: self, aims, casting }
    }

    /// Creates the state after rays from their hits, in order.
    /// - errors: the hits belong to other elements.
    pub fn settled(self, sights: Vec<Sights>) -> Result<Settled, Damaged> {
        let origins = origins(&self.arena);
        if !are_whole(&self.arena, &sights, origins.len()) {
            return Err(OTHERS);
        }
        let rays = Rays::new(origins, self.round, sights);
        Ok(Settled::new(self, rays))
    }

    /// Creates the solution.
    /// - `found`: guides of all groups, in order; none for a field that does not guide paths.
    pub fn solution(&self, prepared: &Prepared, found: Vec<Found>) -> Solution {
        self.finish(Scene::new(prepared), joined(found, &leaves(&self.arena)))
    }

    /// Encodes the links, which do not change after the first step.
    pub fn encode_links(&self) -> Vec<u8> {
        let mut writer = Writer::new(LINKS);
        writer.numbers(self.links.iter().map(|link| link.receiver));
        writer.numbers(self.links.iter().map(|link| link.source));
        writer.rows(&self.links.iter().map(|link| link.factors).collect::<Vec<_>>());
        writer.finish()
    }

    /// Encodes everything else: the splits of the elements, and their light.
    pub fn encode_elements(&self) -> Vec<u8> {
        let mut writer = Writer::new(ELEMENTS);
        let Report { lamp_links, refused, rays, iterations, residual, row_sum, bounded, checked, corrected, .. } =
            self.report;
        writer.number(mark(&self.links));
        writer.number(u64::from(self.round));
        let [bounded, worth_more] = [bounded, self.worth_more].map(usize::from);
        let numbers = [lamp_links, refused, iterations, bounded, worth_more, self.most_rays];
        numbers.into_iter().for_each(|number| writer.number(number as u64));
        writer.number(rays);
        writer.rows(&[[residual, row_sum, checked, corrected]]);
        writer.numbers(self.arena.cuts.iter().copied());
        writer.numbers(self.uneven.iter().copied());
        portals::write(&self.portals, &mut writer);
        let Lights { of, arriving, taken, more } = &self.lights;
        let brightness = |light: &Light| {
            let Light { radiosity, darkest, brightest, mean, least, .. } = light;
            let [r, g, b] = radiosity.to_array();
            [r, g, b, *darkest, *brightest, *mean, *least]
        };
        writer.rows(&of.iter().map(brightness).collect::<Vec<_>>());
        writer.rows(taken);
        writer.rows(&more.iter().map(flat::<4, 12>).collect::<Vec<_>>());
        // Wide elements store their light by direction, others at their nodes.
        let elements = || self.arena.elements.iter().zip(of);
        let own = |kind: usize| -> Vec<[f32; 12]> {
            elements().filter(|(element, _)| !element.is_wide()).map(|(_, light)| flat(&light.own[kind])).collect()
        };
        [FROM_SOURCES, FROM_ELEMENTS].into_iter().for_each(|kind| writer.rows(&own(kind)));
        let sent = elements().filter(|(element, _)| element.is_wide()).map(|(_, light)| flat::<9, 27>(&light.sent.0));
        writer.rows(&sent.collect::<Vec<_>>());
        let around = |get: fn(&Arriving) -> &Harmonics| -> Vec<[f32; 27]> {
            arriving.iter().map(|arriving| flat(&get(arriving).0)).collect()
        };
        writer.rows(&around(|arriving| &arriving.own[FROM_SOURCES]));
        writer.rows(&around(|arriving| &arriving.own[FROM_ELEMENTS]));
        writer.rows(&around(|arriving| &arriving.more));
        writer.finish()
    }

    /// Decodes the output of [`Underway::encode_elements`] and [`Underway::encode_links`], for the same world.
    /// - errors: the bytes are damaged, or belong to different worlds.
    pub fn decode(prepared: &Prepared, elements: &[u8], links: &[u8]) -> Result<Self, Damaged> {
        let scene = Scene::new(prepared);
        let mut reader = Reader::new(elements, ELEMENTS)?;
        let mark_of_links = reader.number()?;
        let mut number = || usize::try_from(reader.number()?).map_err(|_| Damaged("a number is too large"));
        let round = number()?;
        let [lamp_links, refused, iterations, bounded, worth_more, most_rays] =
            [number()?, number()?, number()?, number()?, number()?, number()?];
        let rays = reader.number()?;
        let [residual, row_sum, checked, corrected] = reader.rows::<4>(1)?[0];
        let (bounded, worth_more) = (bounded != 0, worth_more != 0);
        let report = Report {
            lamp_links,
            refused,
            rays,
            iterations,
            residual,
            row_sum,
            bounded,
            checked,
            corrected,
            ..Report::default()
        };
        let mut arena = Arena::new(&scene);
        for cut in reader.numbers()? {
            let may_be_cut = |element: &Element| element.is_leaf() && element.kind != Kind::Cluster;
            if !arena.elements.get(cut as usize).is_some_and(may_be_cut) {
                return Err(OTHERS);
            }
            arena.children(&scene, cut);
        }
        let uneven = reader.numbers()?;
        let is_surface = |leaf: &u32| {
            arena.elements.get(*leaf as usize).is_some_and(|element| element.is_leaf() && element.surface != NONE)
        };
        if !uneven.iter().all(is_surface) {
            return Err(OTHERS);
        }
        let portals = portals::read(&mut reader)?;
        let mut lights = Lights::new(&arena);
        let count = arena.elements.len();
        for (light, row) in lights.of.iter_mut().zip(reader.rows::<7>(count)?) {
            let [r, g, b, darkest, brightest, mean, least] = row;
            let radiosity = Rgb::from_array([r, g, b]);
            *light = Light { radiosity, darkest, brightest, mean, least, ..Light::NOTHING };
        }
        lights.taken = reader.rows::<4>(count)?;
        lights.more = reader.rows::<12>(count)?.iter().map(|row| colors(row)).collect();
        let elements = || arena.elements.iter().enumerate();
        let at_nodes: Vec<usize> =
            elements().filter(|(_, element)| !element.is_wide()).map(|(index, _)| index).collect();
        for kind in [FROM_SOURCES, FROM_ELEMENTS] {
            for (&index, row) in at_nodes.iter().zip(reader.rows::<12>(at_nodes.len())?) {
                lights.of[index].own[kind] = colors(&row);
            }
        }
        let wide: Vec<usize> = elements().filter(|(_, element)| element.is_wide()).map(|(index, _)| index).collect();
        for (&index, row) in wide.iter().zip(reader.rows::<27>(wide.len())?) {
            lights.of[index].sent = Harmonics(colors(&row));
        }
        let sets: [fn(&mut Arriving) -> &mut Harmonics; 3] =
            [|it| &mut it.own[FROM_SOURCES], |it| &mut it.own[FROM_ELEMENTS], |it| &mut it.more];
        for set in sets {
            for (arriving, row) in lights.arriving.iter_mut().zip(reader.rows::<27>(arena.wide)?) {
                *set(arriving) = Harmonics(colors(&row));
            }
        }
        reader.end()?;
        lights.push_all(&arena);
        let links = read_links(&arena, links)?;
        if mark(&links) != mark_of_links {
            return Err(OTHERS);
        }
        Ok(Self { arena, lights, links, report, most_rays, round: round as u32, uneven, worth_more, portals })
    }
}

fn read_links(arena: &Arena, bytes: &[u8]) -> Result<Vec<Link>, Damaged> {
    let mut reader = Reader::new(bytes, LINKS)?;
    let (receivers, sources) = (reader.numbers()?, reader.numbers()?);
    let factors = reader.rows::<4>(receivers.len())?;
    reader.end()?;
    let ends = receivers.iter().zip(&sources);
    let is_there = |end: &u32| (*end as usize) < arena.elements.len();
    if receivers.len() != sources.len()
        || !receivers.is_sorted()
        || !ends.clone().all(|(p, q)| is_there(p) && is_there(q))
    {
        return Err(OTHERS);
    }
    let links = ends.zip(factors).map(|((&receiver, &source), factors)| Link { receiver, source, factors });
    Ok(links.collect())
}

/// Computes a digest that distinguishes links.
fn mark(links: &[Link]) -> u64 {
    let of = |link: &Link| u64::from(link.receiver) << 32 | u64::from(link.source);
    links.iter().fold(links.len() as u64, |mark, link| mix64(mark ^ of(link)))
}

const OTHERS: Damaged = Damaged("it belongs to other elements");

impl Aimed {
    /// Casts the rays of block `block` of `blocks` blocks.
    pub fn cast(&self, prepared: &Prepared, block: u32, blocks: u32) -> Sights {
        let scene = Scene::new(prepared);
        self.casting.cast(&scene, &self.underway.arena, &self.aims, self.casting.part(block, blocks))
    }

    /// Applies the results of the rays of all blocks, in order.
    /// - returns `None` if they belong to other elements;
    /// - errors: `cancel` was set.
    pub fn settle(
        &self,
        prepared: &Prepared,
        options: &Options,
        sights: Vec<Sights>,
        cancel: &AtomicBool,
    ) -> Result<Option<Settled>, Cancelled> {
        let fits = self.casting.fits(&self.underway.arena, &sights);
        let taken = || take_in(self.underway.clone(), self.casting.clone(), prepared, options, sights, cancel);
        fits.then(taken).transpose()
    }
}

/// Applies the results of all rays.
fn take_in(
    underway: Underway,
    casting: Casting,
    prepared: &Prepared,
    options: &Options,
    sights: Vec<Sights>,
    cancel: &AtomicBool,
) -> Result<Settled, Cancelled> {
    let scene = Scene::new(prepared);
    let rays = casting.rays(sights);
    let mut solver = Solver::with(underway, &scene, options, cancel);
    solver.settle(&rays)?;
    let mut settled = Settled::new(solver.now, rays);
    if options.guides {
        settled.seek_portals(&scene);
    }
    Ok(settled)
}

impl Settled {
    fn new(underway: Underway, rays: Rays) -> Self {
        Self { underway, rays, groups: OnceLock::new() }
    }

    /// Returns the state after that.
    pub fn underway(&self) -> &Underway {
        &self.underway
    }

    /// Computes the guides of block `block` of `blocks` blocks of groups of leaves.
    pub fn guides(&self, prepared: &Prepared, block: u32, blocks: u32) -> Found {
        let scene = Scene::new(prepared);
        let Underway { arena, lights, links, portals, .. } = &self.underway;
        let Groups { groups, first } = self.groups.get_or_init(|| self.groups());
        let groups = &groups[part(first, block, blocks)];
        // The guides serve rays first, and paths at the end.
        let purpose = if self.underway.is_settled() { Purpose::Paths } else { Purpose::Rays };
        let found = incoming::of_groups(&scene, arena, lights, (links, &self.rays), groups, portals, purpose);
        let groups = groups.iter().map(|(_, leaves)| leaves.clone()).collect();
        Found { groups, found }
    }

    /// Finds the portals of the scene, which all blocks of groups of leaves need.
    fn seek_portals(&mut self, scene: &Scene<'_>) {
        let Underway { arena, lights, .. } = &self.underway;
        let portals = incoming::portals(scene, arena, lights, &self.rays, &leaves(arena));
        self.underway.worth_more |= portals.iter().any(Portal::is_rare);
        self.underway.portals = portals;
    }

    fn groups(&self) -> Groups {
        let Underway { arena, lights, .. } = &self.underway;
        let leaves = leaves(arena);
        let groups = incoming::groups(arena, &leaves, &self.rays.light(arena, lights));
        let numbers = groups.iter().scan(0, |sum, (_, leaves)| {
            *sum += self.rays.number(leaves) + leaves.len() as u32;
            Some(*sum)
        });
        let first = [0].into_iter().chain(numbers).collect();
        Groups { groups, first }
    }
}

fn joined(found: Vec<Found>, leaves: &[u32]) -> (Vec<Guide>, Vec<Lobe>) {
    if found.is_empty() {
        return Default::default();
    }
    let (groups, found): (Vec<_>, Vec<_>) = found.into_iter().map(|it| (it.groups, it.found)).unzip();
    let groups: Vec<Vec<u32>> = groups.into_iter().flatten().collect();
    incoming::joined(groups.iter().map(|leaves| &**leaves).zip(found.into_iter().flatten()), leaves)
}

impl Found {
    /// Encodes the guides.
    pub fn encode(&self) -> Vec<u8> {
        let mut writer = Writer::new(FOUND);
        writer.numbers(self.groups.iter().map(|leaves| leaves.len() as u32));
        writer.numbers(self.groups.concat().into_iter());
        writer.numbers(self.found.iter().map(|(_, lobes)| lobes.len() as u32));
        writer.rows(&self.found.iter().map(|(share, _)| [*share]).collect::<Vec<_>>());
        let lobe = |&Lobe { target, axes: [a, b], share }: &Lobe| {
            [target.x, target.y, target.z, a.x, a.y, a.z, b.x, b.y, b.z, share]
        };
        let lobes: Vec<[f32; 10]> = self.found.iter().flat_map(|(_, lobes)| lobes).map(lobe).collect();
        writer.number(lobes.len() as u64);
        writer.rows(&lobes);
        writer.finish()
    }

    /// Decodes guides.
    /// - errors: the bytes are not the output of [`Found::encode`].
    pub fn decode(bytes: &[u8]) -> Result<Self, Damaged> {
        let mut reader = Reader::new(bytes, FOUND)?;
        let (sizes, mut leaves, counts) = (reader.numbers()?, reader.numbers()?, reader.numbers()?);
        let shares = reader.rows::<1>(sizes.len())?;
        let number = usize::try_from(reader.number()?).unwrap_or(usize::MAX);
        let whole = |counts: &[u32]| counts.iter().map(|&count| u64::from(count)).sum::<u64>();
        let is_whole =
            counts.len() == sizes.len() && whole(&counts) == number as u64 && whole(&sizes) == leaves.len() as u64;
        if !is_whole {
            return Err(Damaged("its number of leaves or lobes is wrong"));
        }
        let lobe =
            |row: [f32; 10]| Lobe { target: place(&row), axes: [place(&row[3..]), place(&row[6..])], share: row[9] };
        let mut lobes = reader.rows::<10>(number)?.into_iter().map(lobe);
        reader.end()?;
        let mut leaves = leaves.drain(..);
        let groups = sizes.iter().map(|&size| leaves.by_ref().take(size as usize).collect()).collect();
        let of = |(&count, [share]): (&u32, [f32; 1])| (share, lobes.by_ref().take(count as usize).collect());
        let found = counts.iter().zip(shares).map(of).collect();
        Ok(Self { groups, found })
    }
}
