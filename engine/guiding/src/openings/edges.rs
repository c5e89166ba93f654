//! Openings in thin sheets: edges that surround a line as seen from its start.

use super::{Blockers, Line, MIN_OPEN_SHARE, NARROW, open_share};
use femc_field::Parallelogram;
use femc_math::elementary::sin_cos;
use femc_math::glam::Vec3A;
use femc_math::{Frame, cross};
use std::f32::consts::TAU;

/// Number of directions around a line in which edges are searched.
const TURNS: u32 = 32;
/// Tangents of the angles with the line at which rays search for an edge: the least one, its growth, and the limit.
const TANGENTS: [f32; 3] = [0.004, 1.4, 1.2];
/// Minimum number of edges that determine a plane.
const MIN_EDGES: usize = 10;
/// Ratio of the depths on both sides of an edge, at most.
const JUMP: f32 = 0.85;
/// Maximum depth of an edge, in lengths of the line. Beyond, it is an edge of what is at the line's end.
const MAX_DEPTH: f32 = 0.9;
/// Maximum distance of edges from their plane, in sizes of the opening.
const MAX_UNEVENNESS: f32 = 0.1;
/// Maximum cosine of the angle between the edges of an opening.
const MAX_COSINE: f32 = 0.8;
/// Number of halvings of the angle at an edge.
const REFINEMENTS: u32 = 16;

/// Returns the opening of a thin sheet through which a line passes. `None` if too few edges surround it.
pub fn find_by_edges(blockers: &impl Blockers, line: &Line) -> Option<Parallelogram> {
    let length = line.length();
    let along = (line.ends[1] - line.ends[0]) / length;
    if !along.is_finite() {
        return None;
    }
    let frame = Frame::from_normal(along);
    let across = (0..TURNS).map(|turn| {
        let (sin, cos) = sin_cos(TAU * turn as f32 / TURNS as f32);
        frame.to_world(Vec3A::new(cos, sin, 0.0))
    });
    let view = View { blockers, start: line.ends[0], along, length };
    let edges: Vec<(Vec3A, Option<Vec3A>)> = across.map(|across| (across, view.find_edge(across))).collect();
    let found: Vec<Vec3A> = edges.iter().filter_map(|(_, edge)| *edge).collect();
    if found.len() < MIN_EDGES {
        return None;
    }
    // Area vector of the polygon of edges.
    let first = found[0];
    let area: Vec3A = (1..found.len() - 1).map(|k| cross(found[k] - first, found[k + 1] - first) * 0.5).sum();
    let normal = area.normalize_or_zero();
    let middle = found.iter().sum::<Vec3A>() / found.len() as f32;
    let size = found.iter().map(|edge| edge.distance(middle)).fold(0.0, f32::max);
    let is_plane = found.iter().all(|edge| (*edge - middle).dot(normal).abs() <= MAX_UNEVENNESS * size);
    let depth = (middle - line.ends[0]).dot(normal) / along.dot(normal);
    let is_between = depth > 0.0 && depth < MAX_DEPTH * length;
    if !is_plane || normal == Vec3A::ZERO || !is_between {
        return None;
    }
    // Where no edge was found, a surface may cross the plane, such as the floor below a door.
    let passage = line.ends[0] + along * depth;
    let reach = depth.min(length - depth);
    let sides = edges.iter().map(|&(across, edge)| {
        edge.or_else(|| {
            let way = (across - normal * (across.dot(normal))).normalize_or_zero();
            Some(passage + way * blockers.distance(passage, way, reach)?)
        })
    });
    let outline: Vec<Vec3A> = sides.collect::<Option<_>>()?;
    let target = least_parallelogram(&outline, normal);
    let is_narrow = target.edges.iter().any(|edge| edge.length() < NARROW * reach);
    (is_narrow && open_share(blockers, &target) >= MIN_OPEN_SHARE).then_some(target)
}

/// Depths of surfaces as seen from the start of a line.
struct View<'a, B> {
    blockers: &'a B,
    start: Vec3A,
    /// Unit direction and length of the line.
    along: Vec3A,
    length: f32,
}

impl<B: Blockers> View<'_, B> {
    /// Returns the distance along the line of the surface in a direction, and the point there. Without a surface: the line's length.
    fn depth(&self, across: Vec3A, tangent: f32) -> (f32, Vec3A) {
        let way = self.along + across * tangent;
        let stretch = way.length();
        let found = self.blockers.distance(self.start, way / stretch, self.length * stretch);
        let depth = found.map_or(self.length, |distance| distance / stretch);
        (depth, self.start + way * depth)
    }

    /// Returns the nearest edge beside the line: a point on the surface in front.
    fn find_edge(&self, across: Vec3A) -> Option<Vec3A> {
        let [mut tangent, growth, limit] = TANGENTS;
        let mut before = (0.0, self.length);
        while tangent < limit {
            let (depth, _) = self.depth(across, tangent);
            if depth < JUMP * before.1
                && let Some(edge) = self.refine_edge(across, before, (tangent, depth))
            {
                return Some(edge);
            }
            before = (tangent, depth);
            tangent *= growth;
        }
        None
    }

    /// Returns the edge between two tangents, if the depths differ however close they are.
    /// - `far`, `near`: tangents and depths.
    fn refine_edge(&self, across: Vec3A, mut far: (f32, f32), mut near: (f32, f32)) -> Option<Vec3A> {
        let mut point = None;
        for _ in 0..REFINEMENTS {
            let tangent = 0.5 * (far.0 + near.0);
            let (depth, place) = self.depth(across, tangent);
            if depth * depth < far.1 * near.1 {
                near = (tangent, depth);
                point = Some(place);
            } else {
                far = (tangent, depth);
            }
        }
        let is_edge = near.1 < JUMP * far.1 && near.1 < MAX_DEPTH * self.length;
        is_edge.then(|| point.unwrap_or_else(|| self.depth(across, near.0).1))
    }
}

/// Returns the parallelogram of least area in a plane that contains the projections of points. Its edges are parallel to lines
/// between adjacent points.
fn least_parallelogram(points: &[Vec3A], normal: Vec3A) -> Parallelogram {
    let middle = points.iter().sum::<Vec3A>() / points.len() as f32;
    let sides = (0..points.len()).map(|k| {
        let side = points[(k + 1) % points.len()] - points[k];
        (side - normal * side.dot(normal)).normalize_or_zero()
    });
    let sides: Vec<Vec3A> = sides.filter(|side| *side != Vec3A::ZERO).collect();
    let pairs = sides.iter().enumerate().flat_map(|(k, a)| sides[k + 1..].iter().map(move |b| [*a, *b]));
    let across = sides.iter().map(|side| [*side, cross(normal, *side)]);
    let steep = pairs.filter(|[a, b]| a.dot(*b).abs() < MAX_COSINE).chain(across);
    let targets = steep.map(|axes| {
        let sine = 1.0 - axes[0].dot(axes[1]) * axes[0].dot(axes[1]);
        // The dot products with these are coordinates along the axes.
        let duals = [0, 1].map(|k| (axes[k] - axes[1 - k] * axes[0].dot(axes[1])) / sine);
        let (mut low, mut high) = ([f32::INFINITY; 2], [f32::NEG_INFINITY; 2]);
        for point in points {
            for k in 0..2 {
                let place = (*point - middle).dot(duals[k]);
                (low[k], high[k]) = (low[k].min(place), high[k].max(place));
            }
        }
        Parallelogram {
            corner: middle + axes[0] * low[0] + axes[1] * low[1],
            edges: [0, 1].map(|k| axes[k] * (high[k] - low[k])),
        }
    });
    // Another one must be smaller by more than rounding.
    let smaller = |best: Option<Parallelogram>, it: Parallelogram| match best {
        Some(best) if 0.999 * best.area() <= it.area() => Some(best),
        _ => Some(it),
    };
    targets.fold(None, smaller).unwrap_or(Parallelogram { corner: middle, edges: [Vec3A::ZERO; 2] })
}
