//! Openings between two blockers that squeeze a line.

use super::{Blockers, Line, MIN_OPEN_SHARE, NARROW, open_share};
use femc_field::Parallelogram;
use femc_math::elementary::sin_cos;
use femc_math::glam::Vec3A;
use femc_math::{Frame, cross};
use std::f32::consts::{FRAC_PI_2, PI};

/// Number of points along a line, and of directions across it, for the first feelers.
const DEPTHS: u32 = 64;
const AXES: u32 = 8;
/// Number of steps in which the narrowest place is searched.
const REFINEMENTS: u32 = 24;
/// Number of directions along a waist that are tried.
const WAYS: i32 = 9;
/// Minimum length of a gap, relative to the longest one in another direction.
const MIN_LENGTH: f32 = 0.7;
/// Step of a walk along a waist, in widths.
const STEP: f32 = 0.6;
/// Width at which a walk ends, in widths of its start: there, the gap opens or closes.
const WIDTHS: [f32; 2] = [0.1, 2.2];
/// Step across a walk to a narrower place, in widths.
const SHIFT: f32 = 0.2;
/// Length of an opening beyond the last place of a walk, unless it is blocked: in widths, and at most in lengths.
const MARGINS: [f32; 2] = [1.0, 0.03];
/// Ratio of widths by which a line must become wider on both sides of its waist.
const WIDENING: f32 = 1.5;
/// Number of places on each side where it may be wider, at twice the distance each.
const WIDER_PLACES: u32 = 9;
/// Maximum number of steps of a walk in one direction.
const MAX_STEPS: u32 = 600;

/// Place where two blockers are close to each other.
#[derive(Clone, Copy, Debug)]
struct Waist {
    /// Point in the middle between the blockers, m.
    center: Vec3A,
    /// Unit direction from one blocker to the other.
    across: Vec3A,
    /// Distance of the blockers, m.
    width: f32,
}

impl Waist {
    /// Measures the distance of blockers on both sides of a point. `None`: no blockers within `reach` of each other.
    fn measure(blockers: &impl Blockers, point: Vec3A, across: Vec3A, reach: f32) -> Option<Self> {
        let high = blockers.distance(point, across, reach)?;
        let low = blockers.distance(point, -across, reach - high)?;
        let center = point + across * (0.5 * (high - low));
        (high + low > 0.0).then_some(Self { center, across, width: high + low })
    }
}

/// Returns openings between the blockers that squeeze a line most: the gap as found in several directions. It is empty if nothing
/// squeezes the line.
pub fn find_by_waist(blockers: &impl Blockers, line: &Line) -> Vec<Parallelogram> {
    let Some((waist, along)) = find_waist(blockers, line) else { return Vec::new() };
    let normal = (along - waist.across * along.dot(waist.across)).normalize_or_zero();
    let third = cross(waist.across, normal);
    let ways = (0..WAYS).map(|way| {
        let (sin, cos) = sin_cos((way - WAYS / 2) as f32 * PI / 12.0);
        third * cos + normal * sin
    });
    let grown = ways.filter_map(|way| grow(blockers, &waist, way));
    let gaps: Vec<Gap> = grown.filter(|gap| open_share(blockers, &gap.target) >= MIN_OPEN_SHARE).collect();
    let longest = gaps.iter().map(|gap| gap.length).fold(0.0, f32::max);
    gaps.into_iter().filter(|gap| gap.length >= MIN_LENGTH * longest).map(|gap| gap.target).collect()
}

/// Gap along which a search has walked.
struct Gap {
    target: Parallelogram,
    /// Length between its blockers, m, without margins.
    length: f32,
}

/// Returns the narrowest place of a line, and the line's unit direction.
fn find_waist(blockers: &impl Blockers, line: &Line) -> Option<(Waist, Vec3A)> {
    let length = line.length();
    let along = (line.ends[1] - line.ends[0]) / length;
    if !along.is_finite() {
        return None;
    }
    let frame = Frame::from_normal(along);
    let measure = |[depth, turn, tilt]: [f32; 3]| {
        let [(sin, cos), (sine, cosine)] = [turn, tilt].map(sin_cos);
        let across = frame.to_world(Vec3A::new(cos * cosine, sin * cosine, sine));
        let reach = NARROW * depth.min(length - depth);
        (reach > 0.0).then(|| Waist::measure(blockers, line.ends[0] + along * depth, across, reach)).flatten()
    };
    let places = (0..DEPTHS * AXES).map(|at| {
        let [depth, axis] = [at / AXES, at % AXES];
        [length * (depth as f32 + 0.5) / DEPTHS as f32, PI * axis as f32 / AXES as f32, 0.0]
    });
    let first = places.filter_map(|place| Some((place, measure(place)?)));
    let (mut place, mut waist) = first.fold(None, |best: Option<([f32; 3], Waist)>, it| match best {
        Some(best) if best.1.width <= it.1.width => Some(best),
        _ => Some(it),
    })?;
    let mut steps = [length / DEPTHS as f32, FRAC_PI_2 / AXES as f32, 0.4];
    for _ in 0..REFINEMENTS {
        let before = waist.width;
        for axis in 0..3 {
            for sign in [-1.0, 1.0] {
                let mut next = place;
                next[axis] += sign * steps[axis];
                if let Some(narrower) = measure(next).filter(|found| found.width < waist.width) {
                    (place, waist) = (next, narrower);
                }
            }
        }
        if waist.width == before {
            steps = steps.map(|step| 0.5 * step);
        }
    }
    // Beside an edge of a room, the walls narrow toward the end of the line.
    let is_wider = |side: f32| {
        let steps = (0..WIDER_PLACES).map(|k| 0.5 * waist.width * (1u32 << k) as f32);
        let mut depths = steps.map(|step| place[0] + side * step).take_while(|depth| *depth > 0.0 && *depth < length);
        depths.any(|depth| {
            let point = line.ends[0] + along * depth;
            Waist::measure(blockers, point, waist.across, WIDENING * waist.width).is_none()
        })
    };
    (is_wider(-1.0) && is_wider(1.0)).then_some((waist, along))
}

/// Walks along a waist in a direction and its opposite, and returns the parallelogram of the gap.
fn grow(blockers: &impl Blockers, waist: &Waist, way: Vec3A) -> Option<Gap> {
    let mut middles = vec![*waist];
    let last = |middles: &[Waist]| middles.last().map_or(waist.center, |last| last.center);
    walk(blockers, waist, way, &mut middles);
    let end = last(&middles);
    middles.push(*waist);
    walk(blockers, waist, -way, &mut middles);
    let start = last(&middles);
    // The gap may have another direction than the walk.
    let along = (end - start).normalize_or(way);
    let length = (end - start).length();
    let reach = |from: Vec3A, way: Vec3A| {
        let blocked = blockers.distance(from, way, 1.5 * STEP * waist.width);
        // Light also passes beside the place where the gap opens.
        from + way * blocked.unwrap_or((MARGINS[0] * waist.width).min(MARGINS[1] * length))
    };
    let (start, end) = (reach(start, -along), reach(end, along));
    let long = end - start;
    let square = long.length_squared();
    let across = waist.across;
    // Coordinates across, along the blockers' direction, after a shear along the gap.
    let tilt = across.dot(long) / square;
    let straight = across - long * tilt;
    let scale = straight.length_squared();
    if !(square > 0.0 && scale > 1e-4) {
        return None;
    }
    let place = |point: Vec3A| (point - start).dot(straight) / scale;
    let sides = middles.iter().map(|waist| {
        let middle = place(waist.center);
        [middle - 0.5 * waist.width, middle + 0.5 * waist.width]
    });
    let [low, high] =
        sides.fold([f32::INFINITY, f32::NEG_INFINITY], |[low, high], side| [low.min(side[0]), high.max(side[1])]);
    let target = Parallelogram { corner: start + across * low, edges: [across * (high - low), long] };
    Some(Gap { target, length })
}

/// Walks along a waist until a blocker, or until the gap opens or closes.
/// - `way`: unit direction;
/// - `middles`: places on the way.
fn walk(blockers: &impl Blockers, waist: &Waist, way: Vec3A, middles: &mut Vec<Waist>) {
    let normal = cross(waist.across, way).normalize_or_zero();
    let mut at = *waist;
    for _ in 0..MAX_STEPS {
        let step = STEP * at.width.min(waist.width);
        if blockers.distance(at.center, way, step).is_some() {
            return;
        }
        let next = at.center + way * step;
        let shift = SHIFT * at.width;
        let shifted = [normal, -normal].into_iter().filter(|side| blockers.distance(next, *side, shift).is_none());
        let places = [next].into_iter().chain(shifted.map(|side| next + side * shift));
        let found = places.filter_map(|point| Waist::measure(blockers, point, waist.across, WIDTHS[1] * waist.width));
        // Shifted places must be narrower by more than rounding.
        let narrowest = found.fold(None::<Waist>, |best, it| match best {
            Some(best) if 0.98 * best.width <= it.width => Some(best),
            _ => Some(it),
        });
        let Some(found) = narrowest.filter(|found| found.width >= WIDTHS[0] * waist.width) else { return };
        middles.push(found);
        at = found;
    }
}
