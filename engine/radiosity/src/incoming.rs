//! Where the light of a leaf comes from, as the guides of the field have it.
//!
//! Links and rays tell along which ways light comes to a group of leaves. Ways in about the same direction are merged until few bundles
//! are left: of all pairs that one whose joint mean direction loses least. Each bundle becomes a lobe. A group has a guide only if that
//! lowers the variance of a sample of the direction, by the links and by the rays that the lobes were not made of.

use crate::arena::Arena;
use crate::element::{Element, Kind};
use crate::gather::Lights;
use crate::link::Link;
use crate::rays::{Rays, Seen};
use crate::scene::Scene;
use femc_field::{Block, Directions, Guide, LOBES, Lobe, NONE};
use femc_math::color::luminance;
use femc_math::elementary::{atan2, sin_cos};
use femc_math::glam::Vec3A;
use femc_math::{Frame, warp};
use std::f32::consts::PI;

/// Cells of directions by axis of a square, over which the hemisphere is spread, before lobes are merged.
const GRID: usize = 8;
const CELLS: usize = GRID * GRID;
/// A source is taken in parts where its radius is more than this share of the distance.
const LARGE: f32 = 0.3;
/// Parts of a link's source at most.
const PARTS: usize = 64;
/// Shares of directions that are drawn by lobes, of which the best is taken.
const SHARES: [f32; 3] = [0.25, 0.5, 0.75];
/// Rays that a guide is made of at least, if the surface has so many.
const ENOUGH: usize = 2048;
/// Share of a group's mean irradiance that is added to a leaf's when their light is weighed against each other.
const EVEN: f32 = 0.2;
/// Nearest place of a lobe, over the distance of what it is of, and places that are tried from there on.
const NEAREST: f32 = 0.15;
const DEPTHS: u32 = 17;
/// Times that ways are given to lobes anew.
const SETTLING: usize = 3;
/// Variance of a sample with the guide over that without it from which on there is none.
const WORTH: f32 = 0.85;

/// Light along a way.
#[derive(Clone, Copy, Debug)]
struct Part {
    /// The way, m.
    origin: Vec3A,
    target: Vec3A,
    /// Mean square distance from the target across the view, m2.
    spread: f32,
    /// Irradiance.
    amount: f32,
}

/// Ways in about one direction.
#[derive(Clone, Copy, Debug, Default)]
struct Bundle {
    amount: f32,
    /// Sum of amount times direction, and times 1 / distance.
    toward: Vec3A,
    nearness: f32,
    /// Sum of amount times the mean square angle that a way itself is wide.
    width: f32,
}

impl Bundle {
    fn of(part: &Part, from: Vec3A) -> Self {
        let way = part.target - from;
        let distance = way.length().max(f32::MIN_POSITIVE);
        let width = (part.spread / (distance * distance)).min(1.0);
        let Part { amount, .. } = *part;
        Self { amount, toward: way * (amount / distance), nearness: amount / distance, width: amount * width }
    }

    fn add(&mut self, other: &Self) {
        self.amount += other.amount;
        self.toward += other.toward;
        self.nearness += other.nearness;
        self.width += other.width;
    }

    fn lobe(&self, center: Vec3A) -> Lobe {
        let length = self.toward.length();
        let distance = self.amount / self.nearness.max(f32::MIN_POSITIVE);
        // Mean of 1 - cos, of the ways' directions, and of their own widths.
        let off = (1.0 - length / self.amount).max(0.0) + 0.5 * self.width / self.amount;
        let along = self.toward / length.max(f32::MIN_POSITIVE);
        Lobe::round(center + along * distance, along, 2.0 * off * distance * distance, self.amount)
    }
}

/// Sums over the ways of a lobe, in a plane across its axis: places there, and slopes.
#[derive(Clone, Copy, Debug, Default)]
struct Focus {
    amount: f32,
    place: [f32; 2],
    slope: [f32; 2],
    /// Of amount times the products of places, of places and slopes, and of slopes: of the first axes, both, the second ones.
    places: [f32; 3],
    both: [f32; 3],
    slopes: [f32; 3],
    /// Of amount times the way's own width at the target, and times its distance.
    width: f32,
    distance: f32,
}

/// Products of the components of two, made symmetric.
fn products(a: [f32; 2], b: [f32; 2]) -> [f32; 3] {
    [a[0] * b[0], 0.5 * (a[0] * b[1] + a[1] * b[0]), a[1] * b[1]]
}

impl Focus {
    fn add(&mut self, part: &Part, center: Vec3A, frame: &Frame) {
        let dir = frame.to_local((part.target - part.origin).normalize_or(Vec3A::Z));
        let ahead = dir.z.max(0.2);
        let slope = [dir.x / ahead, dir.y / ahead];
        let from = frame.to_local(part.origin - center);
        let place = [from.x - slope[0] * from.z, from.y - slope[1] * from.z];
        let (amount, distance) = (part.amount, part.target.distance(part.origin));
        self.amount += amount;
        let sums = [(&mut self.places, place, place), (&mut self.both, place, slope), (&mut self.slopes, slope, slope)];
        for (sum, a, b) in sums {
            sum.iter_mut().zip(products(a, b)).for_each(|(sum, of)| *sum += of * amount);
        }
        for axis in 0..2 {
            self.place[axis] += place[axis] * amount;
            self.slope[axis] += slope[axis] * amount;
        }
        self.width += amount * (part.spread / (distance * distance).max(f32::MIN_POSITIVE)).min(1.0);
        self.distance += amount * distance;
    }

    /// The lobe through where the ways fill the least solid angle as seen from the leaf: at a gap that all go through, or at a source.
    fn lobe(&self, center: Vec3A, frame: &Frame) -> Option<Lobe> {
        if self.amount <= 0.0 {
            return None;
        }
        let share = 1.0 / self.amount;
        let [place, slope] = [self.place, self.slope].map(|of| of.map(|sum| sum * share));
        let less = |sum: [f32; 3], mean: [f32; 3]| [0, 1, 2].map(|k| sum[k] * share - mean[k]);
        let places = less(self.places, products(place, place));
        let both = less(self.both, products(place, slope));
        let slopes = less(self.slopes, products(slope, slope));
        let (distance, width) = (self.distance * share, self.width * share);
        // Covariance in the plane at a depth, of the ways' middles and of their own widths.
        let at = |depth: f32| {
            let mut of = [0, 1, 2].map(|k| places[k] + 2.0 * depth * both[k] + depth * depth * slopes[k]);
            let own = 0.5 * depth * depth * width.max(1e-6);
            (of[0], of[2]) = (of[0].max(0.0) + own, of[2].max(0.0) + own);
            of
        };
        let solid_angle = |depth: f32| {
            let [a, b, c] = at(depth);
            (a * c - b * b).max(0.0) / depth.powi(4)
        };
        let depths = (0..=DEPTHS).map(|k| distance * (NEAREST + (1.0 - NEAREST) * k as f32 / DEPTHS as f32));
        let (depth, _) = depths
            .map(|depth| (depth, solid_angle(depth)))
            .fold((distance, f32::INFINITY), |best, it| if it.1 < best.1 { it } else { best });
        let [a, b, c] = at(depth);
        // Main axes.
        let turn = 0.5 * atan2(2.0 * b, a - c);
        let (sin, cos) = sin_cos(turn);
        let along = a * cos * cos + 2.0 * b * sin * cos + c * sin * sin;
        let across = (a + c - along).max(0.25 * depth * depth * width.max(1e-6));
        let axes = [(cos, sin, along), (-sin, cos, across)]
            .map(|(x, y, square)| frame.to_world(Vec3A::new(x, y, 0.0)) * (2.0 * square.max(f32::MIN_POSITIVE)).sqrt());
        let middle = Vec3A::new(place[0] + slope[0] * depth, place[1] + slope[1] * depth, depth);
        Some(Lobe { target: center + frame.to_world(middle), axes, share: self.amount })
    }
}

/// The guides of leaves of surfaces, in the order of `leaves`, and their lobes. Leaves next to each other have one together, so that it
/// is made of as many rays as it takes: what few rays find lights all of them.
/// - `links`: by receiver, ascending.
pub fn guides(
    scene: &Scene<'_>,
    arena: &Arena,
    lights: &Lights,
    links: &[Link],
    rays: &Rays,
    leaves: &[u32],
) -> (Vec<Guide>, Vec<Lobe>) {
    use rayon::prelude::*;
    let groups = groups(arena, leaves, (ENOUGH / rays.by_leaf().max(1)).max(1));
    let found: Vec<(f32, Vec<Lobe>)> = groups
        .par_iter()
        .map(|(group, leaves)| {
            let area: f32 = leaves.iter().map(|&leaf| arena.elements[leaf as usize].size).sum();
            let mean = |leaf: &u32| arena.elements[*leaf as usize].size * lights.of[*leaf as usize].mean / area;
            let least = EVEN * leaves.iter().map(mean).sum::<f32>();
            if !(least > f32::MIN_POSITIVE && least.is_finite()) {
                return (0.0, Vec::new());
            }
            let (mut ways, mut seen) = (Vec::new(), Vec::new());
            for &leaf in leaves {
                let (element, light) = (&arena.elements[leaf as usize], &lights.of[leaf as usize]);
                // Dark leaves next to bright ones count nearly as much.
                let scale = element.size / area / (light.mean + least);
                let first = ways.len();
                by_links(arena, lights, links, leaf, &mut ways);
                ways[first..].iter_mut().for_each(|part: &mut Part| part.amount *= scale);
                let of = rays.of(scene, arena, lights, leaf).into_iter().filter(|ray| ray.irradiance.is_finite());
                seen.extend(of.map(|ray| Seen { irradiance: ray.irradiance * scale * leaves.len() as f32, ..ray }));
            }
            guide(&arena.elements[*group as usize], &ways, &seen)
        })
        .collect();
    let mut lobes = Vec::new();
    let mut guides = vec![Guide::default(); leaves.len()];
    let place: std::collections::HashMap<u32, usize> = leaves.iter().enumerate().map(|(k, &leaf)| (leaf, k)).collect();
    for ((_, leaves), (share, of)) in groups.iter().zip(found) {
        let guide = Guide { first: lobes.len() as u32, count: of.len() as u32, share };
        lobes.extend(of);
        leaves.iter().for_each(|leaf| guides[place[leaf]] = guide);
    }
    (guides, lobes)
}

/// The smallest parts of surfaces that have so many leaves, or whole surfaces, and their leaves.
fn groups(arena: &Arena, leaves: &[u32], enough: usize) -> Vec<(u32, Vec<u32>)> {
    let mut under = vec![0usize; arena.elements.len()];
    for &leaf in leaves {
        let mut at = leaf;
        while at != NONE && arena.elements[at as usize].surface != NONE {
            under[at as usize] += 1;
            at = arena.elements[at as usize].parent;
        }
    }
    let mut groups: Vec<(u32, u32)> = leaves
        .iter()
        .map(|&leaf| {
            let mut at = leaf;
            while under[at as usize] < enough {
                let parent = arena.elements[at as usize].parent;
                if parent == NONE || arena.elements[parent as usize].surface == NONE {
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

/// What the links of a leaf and of all elements above it bring.
fn by_links(arena: &Arena, lights: &Lights, links: &[Link], leaf: u32, parts: &mut Vec<Part>) {
    let receiver = &arena.elements[leaf as usize];
    let mut at = leaf;
    while at != NONE {
        let p = &arena.elements[at as usize];
        let first = links.partition_point(|link| link.receiver < at);
        for link in links[first..].iter().take_while(|link| link.receiver == at) {
            let (q, light) = (&arena.elements[link.source as usize], &lights.of[link.source as usize]);
            let way = q.center - p.center;
            let dir = way.normalize_or(Vec3A::Z);
            let sent = luminance(if q.is_wide() { light.sent.cosine(-dir) } else { light.radiosity });
            let factor = if p.is_wide() {
                link.factors[0] * cosine(receiver, dir)
            } else {
                link.factors[..p.count].iter().sum::<f32>() / p.count as f32
            };
            let amount = sent * factor;
            if amount > 0.0 && amount.is_finite() {
                in_parts(arena, lights, receiver, link.source, amount, parts);
            }
        }
        at = p.parent;
    }
}

/// Cosine at a receiver; of a curved one its mean.
fn cosine(receiver: &Element, dir: Vec3A) -> f32 {
    if receiver.normal == Vec3A::ZERO { 0.25 } else { receiver.normal.dot(dir).max(0.0) }
}

/// A source's light, in as many parts as it is large.
fn in_parts(arena: &Arena, lights: &Lights, receiver: &Element, source: u32, amount: f32, parts: &mut Vec<Part>) {
    let mut open = vec![(source, amount)];
    let end = parts.len() + PARTS;
    while let Some((index, amount)) = open.pop() {
        let q = &arena.elements[index as usize];
        let distance2 = q.center.distance_squared(receiver.center);
        let is_small = q.radius * q.radius <= LARGE * LARGE * distance2;
        if is_small || q.is_leaf() || parts.len() + open.len() >= end {
            let spread = 0.5 * q.radius * q.radius;
            let origin = receiver.nodes[parts.len() % receiver.count].position;
            parts.push(Part { origin, target: q.center, spread: spread.min(1e30), amount });
            continue;
        }
        let weights = q.children.map(|child| {
            let (part, light) = (&arena.elements[child as usize], &lights.of[child as usize]);
            let way = part.center - receiver.center;
            let distance2 = way.length_squared().max(0.25 * part.radius * part.radius).max(f32::MIN_POSITIVE);
            let dir = way.normalize_or(Vec3A::Z);
            let there = if part.kind == Kind::Patch { (-part.normal.dot(dir)).max(0.0) } else { 0.5 };
            let size = if part.size.is_finite() { part.size } else { 0.0 };
            size * luminance(light.radiosity).max(0.0) * cosine(receiver, dir).max(1e-3) * there.max(1e-3) / distance2
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

/// Cell of a direction in a frame whose z is the normal: by the square of the sine and by the angle, so that all have the same share
/// of the cosine.
fn cell(local: Vec3A) -> usize {
    let turn = atan2(local.y, local.x) / (2.0 * PI);
    let place = [1.0 - local.z * local.z, if turn < 0.0 { turn + 1.0 } else { turn }];
    let [row, column] = place.map(|at| ((at * GRID as f32) as usize).min(GRID - 1));
    row * GRID + column
}

/// A direction of a cell, by its place there.
fn direction(cell: usize, place: [f32; 2]) -> Vec3A {
    let row = ((cell / GRID) as f32 + place[0]) / GRID as f32;
    let column = ((cell % GRID) as f32 + place[1]) / GRID as f32;
    warp::direction((1.0 - row).max(0.0).sqrt(), column)
}

/// The lobes of a leaf, and the share of directions that they are to draw; no lobes where they gain nothing.
fn guide(element: &Element, links: &[Part], rays: &[Seen]) -> (f32, Vec<Lobe>) {
    let nothing = (0.0, Vec::new());
    let by_links: f32 = links.iter().map(|part| part.amount).sum();
    let by_rays: f32 = rays.iter().map(|ray| ray.irradiance).sum();
    if element.kind != Kind::Patch || !(by_links + by_rays > 0.0 && (by_links + by_rays).is_finite()) {
        return nothing;
    }
    let frame = Frame::from_normal(element.normal);
    let mut bundles = [Bundle::default(); CELLS];
    // What is believed is by the links and by every other ray, whichever finds more: the rest says whether that was right.
    let scale = 2.0 / rays.len().max(1) as f32;
    let mut parts = links.to_vec();
    parts.extend(rays.iter().step_by(2).filter(|ray| ray.irradiance > 0.0).map(|ray| {
        // Half as wide as a ray's share of all directions.
        let spread = ray.target.distance_squared(ray.origin) / (2 * rays.len()) as f32;
        Part { origin: ray.origin, target: ray.target, spread, amount: ray.irradiance * scale }
    }));
    for part in &parts {
        let local = frame.to_local(part.target - element.center);
        if local.z > 0.0 {
            bundles[cell(local.normalize_or(Vec3A::Z))].add(&Bundle::of(part, element.center));
        }
    }
    let Some(mut lobes) = merged(&bundles, element.center) else { return nothing };
    for _ in 0..SETTLING {
        let Some(settled) = settled(&lobes, &parts, element.center) else { break };
        lobes = settled;
    }
    // Second moments of a sample of the direction by the cosine, and by the mixtures, over the squared mean.
    let mut moments = [[0.0f32; 2]; 1 + SHARES.len()];
    let block = Block::new(&lobes);
    let Some(directions) = Directions::new(&block, 1.0, element.center) else { return nothing };
    let mut cells = [0.0f32; CELLS];
    for part in links {
        let local = frame.to_local((part.target - element.center).normalize_or(Vec3A::ZERO));
        if local.z > 0.0 {
            cells[cell(local)] += part.amount / by_links;
        }
    }
    for (index, amount) in cells.into_iter().enumerate().filter(|(_, amount)| *amount > 0.0) {
        // A cell has 1 / CELLS of the cosine; its density, by points in it.
        let points = [[0.25, 0.25], [0.75, 0.25], [0.25, 0.75], [0.75, 0.75]].map(|place| direction(index, place));
        // Of all directions by the cosine one in CELLS is there: by that the lobes' density over the cosine's is averaged.
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
        let number = rays.iter().skip(1).step_by(2).count() as f32;
        for ray in rays.iter().skip(1).step_by(2) {
            // The mean of the square, as if the direction had been drawn by the mixture.
            let dir = (ray.target - ray.origin).normalize_or(element.normal);
            let cosine = element.normal.dot(dir).max(1e-3) / PI;
            let square = ray.irradiance * ray.irradiance / (odd * odd) * number;
            let lobes = Directions::new(&block, 1.0, ray.origin).map_or(0.0, |directions| directions.pdf(dir));
            moments[0][1] += square;
            for (moment, share) in moments[1..].iter_mut().zip(SHARES) {
                moment[1] += square * cosine / (cosine * (1.0 - share) + lobes * share);
            }
        }
    }
    let weights = [by_links, odd * scale];
    let of = |moment: [f32; 2]| {
        // Each by what it is without a guide: rays that are few make of noise what looks like light from one place.
        let ratio = |which: usize| moment[which] / moments[0][which].max(f32::MIN_POSITIVE) * weights[which];
        (ratio(0) + ratio(1)) / (weights[0] + weights[1]).max(f32::MIN_POSITIVE)
    };
    let ratios: Vec<f32> = moments[1..].iter().map(|&moment| of(moment)).collect();
    let best = (1..SHARES.len()).fold(0, |best, k| if ratios[k] < ratios[best] { k } else { best });
    if ratios[best] < WORTH { (SHARES[best], lobes) } else { nothing }
}

/// Few lobes of many bundles; `None` of nothing.
fn merged(bundles: &[Bundle; CELLS], center: Vec3A) -> Option<Vec<Lobe>> {
    let mut left: Vec<Bundle> = bundles.iter().copied().filter(|bundle| bundle.amount > 0.0).collect();
    let length = |bundle: &Bundle| bundle.toward.length();
    let cost = |a: &Bundle, b: &Bundle| length(a) + length(b) - (a.toward + b.toward).length();
    // By bundle the partner after it that costs least.
    let partner = |left: &[Bundle], k: usize| {
        (k + 1..left.len())
            .map(|j| (cost(&left[k], &left[j]), j))
            .fold((f32::INFINITY, usize::MAX), |best, it| if it.0 < best.0 { it } else { best })
    };
    let mut partners: Vec<(f32, usize)> = (0..left.len()).map(|k| partner(&left, k)).collect();
    while left.len() > LOBES {
        let a = (0..left.len()).fold(0, |best, k| if partners[k].0 < partners[best].0 { k } else { best });
        let b = partners[a].1;
        if b >= left.len() {
            return None;
        }
        let of = left[b];
        left[a].add(&of);
        left.swap_remove(b);
        partners.swap_remove(b);
        let moved = left.len();
        for k in 0..left.len() {
            let to = partners[k].1;
            if k == a || k == b || to == a || to == b || to == moved {
                partners[k] = partner(&left, k);
            } else if k < a {
                let cost = cost(&left[k], &left[a]);
                if cost < partners[k].0 {
                    partners[k] = (cost, a);
                }
            }
            if k < b && b < left.len() {
                let cost = cost(&left[k], &left[b]);
                if cost < partners[k].0 {
                    partners[k] = (cost, b);
                }
            }
        }
    }
    shares(left.iter().map(|bundle| bundle.lobe(center)).collect())
}

/// The lobes once each way belongs to that of them which would draw it most often.
fn settled(lobes: &[Lobe], parts: &[Part], center: Vec3A) -> Option<Vec<Lobe>> {
    let block = Block::new(lobes);
    let mut sums = [Focus::default(); LOBES];
    let frames: Vec<Frame> =
        lobes.iter().map(|lobe| Frame::from_normal((lobe.target - center).normalize_or(Vec3A::Z))).collect();
    for part in parts {
        let dir = (part.target - part.origin).normalize_or(Vec3A::Z);
        let Some(each) = Directions::new(&block, 1.0, part.origin).map(|directions| directions.each(dir)) else {
            continue;
        };
        let best = (0..lobes.len()).fold(0, |best, k| if each[k] > each[best] { k } else { best });
        sums[best].add(part, center, &frames[best]);
    }
    shares(sums.iter().zip(&frames).filter_map(|(sum, frame)| sum.lobe(center, frame)).collect())
}

/// Lobes whose shares are of 1; `None` of nothing.
fn shares(lobes: Vec<Lobe>) -> Option<Vec<Lobe>> {
    let sum: f32 = lobes.iter().map(|lobe| lobe.share).sum();
    let is_axis = |axis: &Vec3A| axis.is_finite() && axis.length_squared() > 0.0;
    let is_sound = |lobe: &Lobe| lobe.target.is_finite() && lobe.axes.iter().all(is_axis);
    (sum > 0.0 && sum.is_finite() && lobes.iter().all(is_sound))
        .then(|| lobes.into_iter().map(|lobe| Lobe { share: lobe.share / sum, ..lobe }).collect())
}
