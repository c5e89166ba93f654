//! Guides of the field: the directions from which the light of a leaf comes.
//!
//! Links and rays give the ways along which light reaches a group of leaves. Lobes are fitted to these ways ([`crate::lobes`]). A
//! group has a guide only if it lowers the variance of a sample of the direction. This is tested with the links and with the rays
//! that were not used for the fit.

use crate::arena::Arena;
use crate::element::Element;
use crate::gather::ElementLights;
use crate::link::Link;
use crate::lobes::{Part, fit};
use crate::portals::{self, Line, Portal};
use crate::rays::{BentLamps, IncidentSegment, Rays, SentLight};
use crate::scene::Scene;
use femc_field::{Block, Directions, Guide, LOBES, Lobe, NONE, SurfaceSpot};
use femc_math::color::luminance;
use femc_math::elementary::atan2;
use femc_math::glam::Vec3A;
use femc_math::{Frame, warp};
use rayon::prelude::*;
use std::collections::HashMap;
use std::f32::consts::PI;

/// Number of cells of directions by axis of a square, onto which the hemisphere is mapped.
const GRID: usize = 8;
const CELLS: usize = GRID * GRID;
/// Minimum radius of a source that is divided into parts, as a share of the distance.
const LARGE: f32 = 0.3;
/// Maximum number of parts of a link's source.
const PARTS: usize = 64;
/// Candidates for the share of directions that are sampled from lobes. The best is chosen.
const SHARES: [f32; 4] = [0.125, 0.25, 0.5, 0.75];
/// Minimum effective number of ways for a guide, if the surface has that many. The effective number is that of equally bright ways.
const ENOUGH: f32 = 50.0;
/// Share of a group's mean irradiance that is added to a leaf's when the leaves' light is compared.
const EVEN: f32 = 0.2;
/// Maximum variance of a sample with the guide, relative to that without it. Above, there is no guide.
const WORTH: f32 = 0.75;
/// Minimum brightness of a way relative to the mean, for the search for portals.
const BRIGHT: f32 = 8.0;
/// Share of a lobe toward a portal that no ray of the group has found.
const BEWARE: f32 = 0.1;

/// Computes, for each group of leaves, the share of directions to sample from its lobes, and the lobes. Adjacent leaves share one
/// guide, so that it is based on enough rays: light that few rays find reaches all of these leaves.
/// - `links`: links by receiver, ascending.
pub fn of_groups(
    scene: &Scene<'_>,
    arena: &Arena,
    lights: &ElementLights,
    (links, rays): (&[Link], &Rays),
    groups: &[(u32, Vec<u32>)],
    portals: &[Portal],
) -> Vec<(f32, Vec<Lobe>)> {
    let light_sent = SentLight::new(arena, lights, BentLamps::Included);
    groups
        .par_iter()
        .map(|(group, leaves)| {
            let area: f32 = leaves.iter().map(|&leaf| arena.elements[leaf as usize].size()).sum();
            let mean = |leaf: &u32| arena.elements[*leaf as usize].size() * lights.elements[*leaf as usize].mean / area;
            let least = EVEN * leaves.iter().map(mean).sum::<f32>();
            let is_flat = arena.elements[*group as usize].patch().is_some();
            if !(is_flat && least > f32::MIN_POSITIVE && least.is_finite()) {
                return (0.0, Vec::new());
            }
            let (mut ways, mut seen) = (Vec::new(), Vec::new());
            for &leaf in leaves {
                let (element, light) = (&arena.elements[leaf as usize], &lights.elements[leaf as usize]);
                // Dark leaves next to bright ones count nearly as much.
                let scale = element.size() / area / (light.mean + least);
                let first = ways.len();
                add_links(arena, lights, links, leaf, &mut ways);
                ways[first..].iter_mut().for_each(|part: &mut Part| part.amount *= scale);
                let of = rays
                    .incident_segments((scene, arena), &light_sent, leaf, |irradiance, _| irradiance.is_finite())
                    .into_iter();
                let number = area / element.size();
                seen.extend(of.map(|ray| IncidentSegment {
                    irradiance: ray.irradiance * scale,
                    ray_count: ray.ray_count * number,
                    ..ray
                }));
            }
            let element = &arena.elements[*group as usize];
            let found = guide(element, &ways, &seen, portals);
            toward(found, element, portals)
        })
        .collect()
}

/// Returns the guides of all leaves, in the order of `leaves`, and their lobes, from the results of groups of leaves, in order. A
/// leaf without a group has no guide.
pub fn joined<'a>(
    groups: impl Iterator<Item = (&'a [u32], (f32, Vec<Lobe>))>,
    leaves: &[u32],
) -> (Vec<Guide>, Vec<Lobe>) {
    let mut lobes = Vec::new();
    let mut guides = vec![Guide::default(); leaves.len()];
    let place: HashMap<u32, usize> = leaves.iter().enumerate().map(|(k, &leaf)| (leaf, k)).collect();
    for (of, (share, found)) in groups {
        let guide = Guide { first: lobes.len() as u32, count: found.len() as u32, share };
        lobes.extend(found);
        of.iter().filter_map(|leaf| place.get(leaf)).for_each(|&k| guides[k] = guide);
    }
    (guides, lobes)
}

/// Returns the portals of a scene, found from rays.
pub fn portals(scene: &Scene<'_>, arena: &Arena, lights: &ElementLights, rays: &Rays, leaves: &[u32]) -> Vec<Portal> {
    let area = |&leaf: &u32| f64::from(arena.elements[leaf as usize].size());
    portals::find(&bright(scene, arena, lights, rays, leaves), leaves.iter().map(area).sum())
}

/// Returns ways that are much brighter than the mean of their leaf.
fn bright(scene: &Scene<'_>, arena: &Arena, lights: &ElementLights, rays: &Rays, leaves: &[u32]) -> Vec<Line> {
    let light_sent = SentLight::new(arena, lights, BentLamps::Included);
    let light = |leaf: u32| f64::from(arena.elements[leaf as usize].size() * lights.elements[leaf as usize].mean);
    let roots: Vec<u32> = leaves.iter().map(|&leaf| root(arena, leaf)).collect();
    let mut sums: HashMap<u32, [f64; 2]> = HashMap::new();
    for (&leaf, &root) in leaves.iter().zip(&roots) {
        let sum = sums.entry(root).or_default();
        *sum = [sum[0] + light(leaf), sum[1] + f64::from(arena.elements[leaf as usize].size())];
    }
    let of = |(&leaf, root): (&u32, &u32)| {
        let element = &arena.elements[leaf as usize];
        let [whole, area] = sums[root];
        let mean = lights.elements[leaf as usize].mean + EVEN * (whole / area) as f32;
        let is_bright = |irradiance: f32, number: f32| irradiance.is_finite() && irradiance * number > BRIGHT * mean;
        let line = |ray: IncidentSegment| {
            let way = (ray.target - ray.origin).as_dvec3();
            let length = way.length();
            let weight = f64::from(ray.irradiance / mean * element.size());
            Line { origin: ray.origin.as_dvec3(), dir: way / length, length, weight }
        };
        let is_lit = mean > f32::MIN_POSITIVE;
        let of = if is_lit { rays.incident_segments((scene, arena), &light_sent, leaf, is_bright) } else { Vec::new() };
        let lines = of.into_iter().map(line);
        lines.filter(|line| line.length > 0.0 && line.weight.is_finite()).collect::<Vec<_>>()
    };
    leaves.par_iter().zip(&roots).flat_map_iter(of).collect()
}

/// Checks whether an element is a part of a surface. [`NONE`] is not.
fn is_surface(arena: &Arena, element: u32) -> bool {
    arena.elements.get(element as usize).is_some_and(|element| element.surface_part().is_some())
}

/// Returns the root element of a leaf's surface.
fn root(arena: &Arena, leaf: u32) -> u32 {
    let mut at = leaf;
    loop {
        let parent = arena.elements[at as usize].parent;
        if !is_surface(arena, parent) {
            return at;
        }
        at = parent;
    }
}

/// Adds lobes for all portals in front of a group that it has no lobe for: paths must sample such light before they hit it by
/// chance.
fn toward((share, mut lobes): (f32, Vec<Lobe>), group: &Element, portals: &[Portal]) -> (f32, Vec<Lobe>) {
    let is_there = |portal: &&Portal| !lobes.iter().any(|lobe| portal.has(group.center, lobe.target));
    let seen: Vec<Lobe> = portals
        .iter()
        .filter(is_there)
        .filter_map(|portal| portal.lobe(group.center, group.normal(), BEWARE))
        .collect();
    if seen.is_empty() {
        return (share, lobes);
    }
    lobes.sort_by(|a, b| b.share.total_cmp(&a.share));
    lobes.truncate(LOBES - seen.len());
    lobes.extend(seen);
    (share.max(SHARES[0]), lobes)
}

/// Returns the smallest parts of surfaces that have [`ENOUGH`] ways, or whole surfaces, with their leaves.
/// - `light`: by leaf, the light of its ways and the sum of its squares.
pub fn groups(arena: &Arena, leaves: &[u32], light: &[(u32, [f32; 2])]) -> Vec<(u32, Vec<u32>)> {
    let mut sums = vec![[0.0f32; 2]; arena.elements.len()];
    for &(leaf, of) in light {
        let mut at = leaf;
        while is_surface(arena, at) {
            sums[at as usize].iter_mut().zip(of).for_each(|(sum, of)| *sum += of);
            at = arena.elements[at as usize].parent;
        }
    }
    let is_enough = |at: u32| {
        let [sum, squares] = sums[at as usize];
        sum * sum >= ENOUGH * squares && sum > 0.0
    };
    let mut groups: Vec<(u32, u32)> = leaves
        .iter()
        .map(|&leaf| {
            let mut at = leaf;
            while !is_enough(at) {
                let parent = arena.elements[at as usize].parent;
                if !is_surface(arena, parent) {
                    break;
                }
                at = parent;
            }
            (at, leaf)
        })
        .collect();
    groups.sort_unstable();
    groups.chunk_by(|a, b| a.0 == b.0).map(|of| (of[0].0, of.iter().map(|&(_, leaf)| leaf).collect())).collect()
}

/// Adds the light of the links of a leaf and of all elements above it.
fn add_links(arena: &Arena, lights: &ElementLights, links: &[Link], leaf: u32, parts: &mut Vec<Part>) {
    let receiver = &arena.elements[leaf as usize];
    for_each_link(arena, lights, links, leaf, |source, amount| {
        in_parts(arena, lights, receiver, source, amount, parts);
    });
}

/// Calls a function with the source of each link of a leaf and of all elements above it, and with the irradiance by the link,
/// positive.
pub(crate) fn for_each_link(
    arena: &Arena,
    lights: &ElementLights,
    links: &[Link],
    leaf: u32,
    mut receive: impl FnMut(u32, f32),
) {
    let receiver = &arena.elements[leaf as usize];
    let mut at = leaf;
    while at != NONE {
        let p = &arena.elements[at as usize];
        let first = links.partition_point(|link| link.receiver < at);
        for link in links[first..].iter().take_while(|link| link.receiver == at) {
            let q = &arena.elements[link.source as usize];
            let dir = (q.center - p.center).normalize_or(Vec3A::Z);
            let sent = luminance(lights.sent_toward(link.source as usize, q, p.center));
            let factor = if p.is_directional() {
                link.factors[0] * cosine(receiver, dir)
            } else {
                link.factors[..p.node_count()].iter().sum::<f32>() / p.node_count() as f32
            };
            let amount = sent * factor;
            if amount > 0.0 && amount.is_finite() {
                receive(link.source, amount);
            }
        }
        at = p.parent;
    }
}

/// Returns the cosine at a receiver; for a curved one its mean.
fn cosine(receiver: &Element, dir: Vec3A) -> f32 {
    let normal = receiver.normal();
    if normal == Vec3A::ZERO { 0.25 } else { normal.dot(dir).max(0.0) }
}

/// Divides a source's light into parts, more for a larger source.
fn in_parts(
    arena: &Arena,
    lights: &ElementLights,
    receiver: &Element,
    source: u32,
    amount: f32,
    parts: &mut Vec<Part>,
) {
    let mut open = vec![(source, amount)];
    let end = parts.len() + PARTS;
    while let Some((index, amount)) = open.pop() {
        let q = &arena.elements[index as usize];
        let distance2 = q.center.distance_squared(receiver.center);
        let is_small = q.radius * q.radius <= LARGE * LARGE * distance2;
        if is_small || q.is_leaf() || parts.len() + open.len() >= end {
            let origin = receiver.node(parts.len() % receiver.node_count()).position;
            if let Some(patch) = q.patch() {
                // Each node represents its share of the area.
                let nodes = patch.nodes();
                let amount = amount / nodes.len() as f32;
                let spread = patch.part.area / (PI * nodes.len() as f32);
                let part = |node: &SurfaceSpot| Part { origin, target: node.position, spread, amount };
                parts.extend(nodes.iter().map(part));
            } else {
                let spread = (0.5 * q.radius * q.radius).min(1e30);
                parts.push(Part { origin, target: q.center, spread, amount });
            }
            continue;
        }
        let weights = q.children.map(|child| {
            let (part, light) = (&arena.elements[child as usize], &lights.elements[child as usize]);
            let way = part.center - receiver.center;
            let distance2 = way.length_squared().max(0.25 * part.radius * part.radius).max(f32::MIN_POSITIVE);
            let dir = way.normalize_or(Vec3A::Z);
            let there = part.patch().map_or(0.5, |patch| (-patch.normal.dot(dir)).max(0.0));
            part.size() * luminance(light.radiosity).max(0.0) * cosine(receiver, dir).max(1e-3) * there.max(1e-3)
                / distance2
        });
        let sum = weights[0] + weights[1];
        for (child, weight) in q.children.into_iter().zip(weights) {
            let share = if sum > 0.0 { weight / sum } else { 0.5 };
            if share > 0.0 {
                open.push((child, amount * share));
            }
        }
    }
}

/// Returns the cell of a direction in a frame whose z is the normal. The coordinates are the squared sine and the angle, so that
/// all cells have equal shares of the cosine distribution.
fn cell(local: Vec3A) -> usize {
    let turn = atan2(local.y, local.x) / (2.0 * PI);
    let place = [1.0 - local.z * local.z, if turn < 0.0 { turn + 1.0 } else { turn }];
    let [row, column] = place.map(|at| ((at * GRID as f32) as usize).min(GRID - 1));
    row * GRID + column
}

/// Returns a direction of a cell, from a position in the cell.
fn direction(cell: usize, place: [f32; 2]) -> Vec3A {
    let row = ((cell / GRID) as f32 + place[0]) / GRID as f32;
    let column = ((cell % GRID) as f32 + place[1]) / GRID as f32;
    warp::direction((1.0 - row).max(0.0).sqrt(), column)
}

/// Returns the lobes of a leaf, and the share of directions to sample from them; no lobes if they gain nothing.
fn guide(element: &Element, links: &[Part], rays: &[IncidentSegment], portals: &[Portal]) -> (f32, Vec<Lobe>) {
    let nothing = (0.0, Vec::new());
    let by_links: f32 = links.iter().map(|part| part.amount).sum();
    let by_rays: f32 = rays.iter().map(|ray| ray.irradiance).sum();
    if !(by_links + by_rays > 0.0 && (by_links + by_rays).is_finite()) {
        return nothing;
    }
    let frame = Frame::from_normal(element.normal());
    // The fit uses the links and every other ray, whichever finds more. The remaining rays test the result.
    const SCALE: f32 = 2.0;
    let mut parts = links.to_vec();
    parts.extend(rays.iter().step_by(2).filter(|ray| ray.irradiance > 0.0).map(|ray| {
        // Half as wide as a ray's share of all directions.
        let spread = ray.target.distance_squared(ray.origin) / (2.0 * ray.ray_count);
        Part { origin: ray.origin, target: ray.target, spread, amount: ray.irradiance * SCALE }
    }));
    let Some(lobes) = fit(&parts, element.center, &frame, portals) else { return nothing };
    // Second moments of a sample of the direction, over the squared mean, for the cosine distribution and the mixtures.
    let mut moments = [[0.0f32; 2]; 1 + SHARES.len()];
    let block = Block::new(&lobes);
    let Some(directions) = Directions::new(&block, element.center).non_empty() else { return nothing };
    let mut cells = [0.0f32; CELLS];
    for part in links {
        let local = frame.to_local((part.target - element.center).normalize_or(Vec3A::ZERO));
        if local.z > 0.0 {
            cells[cell(local)] += part.amount / by_links;
        }
    }
    for (index, amount) in cells.into_iter().enumerate().filter(|(_, amount)| *amount > 0.0) {
        // A cell has 1 / CELLS of the cosine distribution. The lobes' density is evaluated at points in the cell.
        let points = [[0.25, 0.25], [0.75, 0.25], [0.25, 0.75], [0.75, 0.75]].map(|place| direction(index, place));
        // Averages the ratio of the lobes' density to that of the cosine distribution.
        let over = |local: &Vec3A| directions.pdf(frame.to_world(*local)) * PI / local.z.max(0.05);
        let lobes = points.iter().map(over).sum::<f32>() * 0.25 / CELLS as f32;
        let square = amount * amount;
        let by_cosine = 1.0 / CELLS as f32;
        moments[0][0] += square / by_cosine;
        for (moment, share) in moments[1..].iter_mut().zip(SHARES) {
            moment[0] += square / (by_cosine * (1.0 - share) + lobes * share);
        }
    }
    let odd: f32 = rays.iter().skip(1).step_by(2).map(|ray| ray.irradiance).sum();
    if odd > 0.0 {
        for ray in rays.iter().skip(1).step_by(2) {
            // Mean of the square, as if the direction had been sampled from the mixture.
            let dir = (ray.target - ray.origin).normalize_or(element.normal());
            let cosine = element.normal().dot(dir).max(1e-3) / PI;
            let square = ray.irradiance * ray.irradiance / (odd * odd) * (0.5 * ray.ray_count);
            let lobes = Directions::new(&block, ray.origin).non_empty().map_or(0.0, |directions| directions.pdf(dir));
            moments[0][1] += square;
            for (moment, share) in moments[1..].iter_mut().zip(SHARES) {
                moment[1] += square * cosine / (cosine * (1.0 - share) + lobes * share);
            }
        }
    }
    let weights = [by_links, odd * SCALE];
    let of = |moment: [f32; 2]| {
        // Each relative to its value without a guide, because a few noisy rays look like light from one place.
        let ratio = |which: usize| moment[which] / moments[0][which].max(f32::MIN_POSITIVE) * weights[which];
        (ratio(0) + ratio(1)) / (weights[0] + weights[1]).max(f32::MIN_POSITIVE)
    };
    let ratios: Vec<f32> = moments[1..].iter().map(|&moment| of(moment)).collect();
    let best = (1..SHARES.len()).fold(0, |best, k| if ratios[k] < ratios[best] { k } else { best });
    if ratios[best] < WORTH { (SHARES[best], lobes) } else { nothing }
}
