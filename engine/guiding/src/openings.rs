//! Search for openings: gaps through which light comes, as parallelograms in space.
//!
//! The input is lines along which more light arrived than expected. Such a line has passed through a gap, or it comes from a bright
//! place. Short rays, the feelers, find where blockers squeeze the line: at its waist. The search then walks along the waist, as
//! along a slit, until it is blocked or opens. Thin sheets have no waist, so the edges that surround the line as seen from its end
//! are a second way. At last, the openings that explain most light per solid angle are chosen.

mod edges;
mod waist;

use edges::find_by_edges;
use femc_field::Parallelogram;
use femc_math::cross;
use femc_math::elementary::ln;
use femc_math::glam::Vec3A;
use std::f32::consts::{PI, TAU};

/// Way along which much light arrived.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Line {
    /// Points where the light arrived and from where it came, prepared frame, m.
    pub ends: [Vec3A; 2],
    /// Weight, positive.
    pub weight: f32,
}

impl Line {
    fn length(&self) -> f32 {
        self.ends[0].distance(self.ends[1])
    }
}

/// Surfaces that block light.
pub trait Blockers {
    /// Returns the distance of the nearest surface from `origin` in the unit direction `dir`, up to `reach`, m.
    fn distance(&self, origin: Vec3A, dir: Vec3A, reach: f32) -> Option<f32>;
}

/// An opening through which light comes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Opening {
    /// Parallelogram that contains the opening.
    pub target: Parallelogram,
    /// Share of the weight of all lines that pass through it, in 0..1.
    pub share: f32,
}

/// Maximum width of a waist, relative to the distance from either end of the line.
const NARROW: f32 = 0.5;
/// Minimum share of an opening's parallelogram that is open. A triangle fills half.
const MIN_OPEN_SHARE: f32 = 0.35;
/// Maximum solid angle of an opening as seen from its lines, sr.
const MAX_SOLID_ANGLE: f32 = 0.25;
/// Minimum share of the weight of all lines, and minimum number of lines, that pass through an opening.
const MIN_SHARE: f32 = 0.01;
const MIN_LINES: usize = 2;
/// Minimum ratio of the weight of the lines that pass through an opening to that of lines in random directions.
const MIN_LIFT: f32 = 3.0;
/// Number of searches that must have found a line's opening until no other starts at the line. The narrowest one explains its
/// light best.
const CANDIDATES: usize = 4;
/// Number of times that blocked parts are cut from the edges of an opening.
const TIGHTENINGS: u32 = 3;

/// Finds the openings through which lines pass, those that explain most first.
/// - `known`: targets whose lines are left out;
/// - `most`: maximum number of openings.
pub fn find_openings(blockers: &impl Blockers, lines: &[Line], known: &[Parallelogram], most: usize) -> Vec<Opening> {
    let passes = |line: &Line, target: &Parallelogram| target.crossing(line.ends[0], line.ends[1]).is_some();
    let total: f32 = lines.iter().map(|line| line.weight).sum();
    let mut rest: Vec<Line> =
        lines.iter().filter(|line| !known.iter().any(|target| passes(line, target))).copied().collect();
    // Openings by the line with which they were found.
    let mut groups: Vec<Vec<Parallelogram>> = Vec::new();
    for line in &rest {
        let is_tried = |group: &&Vec<Parallelogram>| group.iter().any(|target| passes(line, target));
        if groups.iter().filter(is_tried).count() >= CANDIDATES {
            continue;
        }
        let mut found = waist::find_by_waist(blockers, line);
        if found.is_empty() {
            found.extend(find_by_edges(blockers, line));
        }
        found.iter_mut().for_each(|target| *target = tighten(blockers, target));
        found.retain(|target| passes(line, target));
        groups.push(found);
    }
    let candidates: Vec<Parallelogram> = groups.into_iter().flatten().collect();
    let mut out = Vec::new();
    while out.len() < most {
        let rated = candidates.iter().map(|target| (Rating::new(target, &rest), target));
        let rest_weight: f32 = rest.iter().map(|line| line.weight).sum();
        let fit = rated.filter(|(rating, _)| {
            rating.score > 0.0
                && rating.lines >= MIN_LINES
                && rating.weight >= MIN_SHARE * total
                && rating.weight >= MIN_LIFT * rating.chance * rest_weight
        });
        let best = fit.fold(None::<(Rating, &Parallelogram)>, |best, it| match best {
            Some(best) if best.0.score >= it.0.score => Some(best),
            _ => Some(it),
        });
        let Some((rating, &target)) = best else { break };
        out.push(Opening { target, share: rating.weight / total });
        rest.retain(|line| !passes(line, &target));
    }
    out
}

/// Rating of a candidate by the lines that pass through it.
struct Rating {
    lines: usize,
    weight: f32,
    /// Weight times the information that a line passes through the candidate, nats.
    score: f32,
    /// Share of lines in random directions that would pass through it.
    chance: f32,
}

impl Rating {
    fn new(target: &Parallelogram, lines: &[Line]) -> Self {
        let mut out = Self { lines: 0, weight: 0.0, score: 0.0, chance: 0.0 };
        let whole: f32 = lines.iter().map(|line| line.weight).sum();
        let center = target.center();
        for line in lines {
            let to_center = Line { ends: [line.ends[0], center], ..*line };
            out.chance += line.weight / whole * (solid_angle(target, &to_center, 1.0) / PI).min(1.0);
            let Some(share) = target.crossing(line.ends[0], line.ends[1]) else { continue };
            out.lines += 1;
            out.weight += line.weight;
            let solid_angle = solid_angle(target, line, share);
            if solid_angle < MAX_SOLID_ANGLE {
                out.score += line.weight * ln(TAU / solid_angle);
            }
        }
        out
    }
}

/// Returns the solid angle of a target as seen from the start of a line that crosses it, approximately, sr.
fn solid_angle(target: &Parallelogram, line: &Line, share: f32) -> f32 {
    let normal = cross(target.edges[0], target.edges[1]);
    let along = line.ends[1] - line.ends[0];
    let square = along.length_squared() * share * share;
    let projected = normal.dot(along).abs() / along.length();
    (projected / square.max(f32::MIN_POSITIVE)).clamp(f32::MIN_POSITIVE, TAU)
}

/// Number of points by edge of a parallelogram at which it is tested whether light passes.
const GRID: u32 = 16;

/// Returns the coordinates of the points of a parallelogram that let light pass, on a grid.
fn open_points<'a>(blockers: &'a impl Blockers, target: &'a Parallelogram) -> impl Iterator<Item = [f32; 2]> + 'a {
    let normal = cross(target.edges[0], target.edges[1]).normalize_or_zero();
    let reach = 0.05 * target.edges[0].length().min(target.edges[1].length());
    let center = |at: u32| (at as f32 + 0.5) / GRID as f32;
    let points = (0..GRID * GRID).map(move |at| [center(at % GRID), center(at / GRID)]);
    points.filter(move |&at| blockers.distance(target.point_at(at) - normal * reach, normal, 2.0 * reach).is_none())
}

/// Returns the share of a parallelogram that lets light pass.
fn open_share(blockers: &impl Blockers, target: &Parallelogram) -> f32 {
    open_points(blockers, target).count() as f32 / (GRID * GRID) as f32
}

/// Returns the smallest part of a parallelogram with parallel edges that contains all points that let light pass.
fn tighten(blockers: &impl Blockers, target: &Parallelogram) -> Parallelogram {
    let mut target = *target;
    for _ in 0..TIGHTENINGS {
        let (mut low, mut high) = ([1.0f32; 2], [0.0f32; 2]);
        for at in open_points(blockers, &target) {
            for axis in 0..2 {
                low[axis] = low[axis].min(at[axis] - 1.0 / GRID as f32);
                high[axis] = high[axis].max(at[axis] + 1.0 / GRID as f32);
            }
        }
        let [low, high] = [low, high].map(|at| at.map(|at| at.clamp(0.0, 1.0)));
        if low[0] >= high[0] || low[1] >= high[1] {
            break;
        }
        target = Parallelogram {
            corner: target.point_at(low),
            edges: [0, 1].map(|axis| target.edges[axis] * (high[axis] - low[axis])),
        };
    }
    target
}

#[cfg(test)]
mod tests;
