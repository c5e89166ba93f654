//! Triangulation of planar polygons, which may be concave and have seams or holes.
//!
//! The polygon is projected along the largest component of its normal. This keeps coordinates exact, and so also collinearity and
//! equality. Ear clipping \[eberly2002\] (crate `earcut`) then cuts it into triangles. Ear clipping drops vertices in the middle of
//! straight edges. They are restored, because a neighbor's edge may end there. A comparison of signed areas decides whether the
//! triangles represent the polygon.

use earcut::Earcut;
use femc_math::glam::DVec3;

/// Relative difference of areas above which the triangles do not represent the polygon.
const AREA_TOLERANCE: f64 = 1e-9;
/// Ratio of area to squared size below which a face has no area.
const NO_AREA: f64 = 1e-15;

/// Result of a triangulation.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Triangulation {
    /// Vector area of the outer contour minus the holes, m2, by the right-hand rule.
    pub area: DVec3,
    /// Largest distance of a vertex from the mean plane, divided by the size of the polygon.
    pub deviation: f64,
    /// Whether the triangles add up to the area.
    pub covered: bool,
    /// Whether a hole is wound like the outer contour.
    pub hole_wound_like_outer: bool,
}

/// Triangulator that reuses its buffers.
#[derive(Default)]
pub(super) struct Triangulator {
    earcut: Earcut<f64>,
    flat: Vec<[f64; 2]>,
    cut: Vec<u32>,
    /// Triangles of the last run: indices into the points, counter-clockwise about the area. Empty if there is no area.
    pub triangles: Vec<[u32; 3]>,
}

impl Triangulator {
    /// Triangulates the contours of `points`. `holes` are the first indices of the contours after the outer one.
    pub fn triangulate(&mut self, points: &[DVec3], holes: &[u32]) -> Triangulation {
        self.triangles.clear();
        let outer = &points[..holes.first().map_or(points.len(), |&first| first as usize)];
        let outer_area = vector_area(outer);
        let hole_areas: Vec<DVec3> =
            contours(points.len(), holes).skip(1).map(|range| vector_area(&points[range])).collect();
        let like_outer = |area: &DVec3| area.dot(outer_area) > 0.0;
        let hole_wound_like_outer = hole_areas.iter().any(like_outer);
        let sum = |total: DVec3, area: &DVec3| total + if like_outer(area) { -*area } else { *area };
        let area = hole_areas.iter().fold(outer_area, sum);
        let size = extent(outer);
        let deviation = deviation(points, outer_area.normalize_or_zero(), size);
        let mut outcome = Triangulation { area, deviation, covered: true, hole_wound_like_outer };
        // The comparison is written so that NaN also counts as no area.
        let has_area = area.length() > NO_AREA * size * size && area.is_finite();
        if !has_area {
            return outcome;
        }
        self.project(points, outer_area);
        if !self.triangulate_simple(points.len(), holes) {
            self.clip_ears(points.len(), holes);
        }
        let signed: f64 = self.triangles.iter().map(|&t| self.signed_area(t)).sum();
        let expected = projected(area, outer_area);
        outcome.covered = (signed - expected).abs() <= AREA_TOLERANCE * expected.abs();
        outcome
    }

    /// Drops the axis along which `normal` is largest. Contours that are counter-clockwise about `normal` stay counter-clockwise.
    fn project(&mut self, points: &[DVec3], normal: DVec3) {
        let (axis, positive) = dominant(normal);
        let (u, v) = ((axis + 1) % 3, (axis + 2) % 3);
        let (u, v) = if positive { (u, v) } else { (v, u) };
        self.flat.clear();
        self.flat.extend(points.iter().map(|p| [p[u], p[v]]));
    }

    /// Triangulates triangles and quadrangles without holes directly; returns false if that is not possible.
    fn triangulate_simple(&mut self, n: usize, holes: &[u32]) -> bool {
        let candidates: &[&[[u32; 3]]] = match (n, holes) {
            (3, []) => &[&[[0, 1, 2]]],
            (4, []) => &[&[[0, 1, 2], [0, 2, 3]], &[[1, 2, 3], [1, 3, 0]]],
            _ => return false,
        };
        let positive = |split: &&&[[u32; 3]]| split.iter().all(|&t| self.signed_area(t) > 0.0);
        let Some(split) = candidates.iter().find(positive) else { return false };
        self.triangles.extend_from_slice(split);
        true
    }

    fn clip_ears(&mut self, n: usize, holes: &[u32]) {
        self.earcut.earcut_slice(&self.flat, holes, &mut self.cut);
        for &[a, b, c] in self.cut.as_chunks::<3>().0 {
            let area = self.signed_area([a, b, c]);
            if area > 0.0 {
                self.triangles.push([a, b, c]);
            } else if area < 0.0 {
                self.triangles.push([a, c, b]);
            }
        }
        // A complete triangulation has this many triangles; fewer mean that vertices were dropped.
        if self.triangles.len() < n + 2 * holes.len() - 2 {
            self.restore_dropped();
        }
    }

    /// Splits every triangle edge at the vertices that lie on it.
    fn restore_dropped(&mut self) {
        let mut i = 0;
        // The bound always holds except under contradictory rounding. It guarantees that the loop ends.
        while i < self.triangles.len() && self.triangles.len() < 4 * self.flat.len() {
            match self.vertex_on_edge(self.triangles[i]) {
                Some([a, b, c, d]) => {
                    self.triangles[i] = [d, b, c];
                    self.triangles.push([a, d, c]);
                }
                None => i += 1,
            }
        }
    }

    /// Returns an edge a to b of the triangle (a, b, c), and a vertex d strictly inside the edge that leaves area on both sides.
    fn vertex_on_edge(&self, [x, y, z]: [u32; 3]) -> Option<[u32; 4]> {
        let splits = |[a, b, c]: [u32; 3], d: u32| {
            self.between(a, d, b) && self.signed_area([d, b, c]) > 0.0 && self.signed_area([a, d, c]) > 0.0
        };
        [[x, y, z], [y, z, x], [z, x, y]].into_iter().find_map(|[a, b, c]| {
            let d = (0..self.flat.len() as u32).find(|&d| splits([a, b, c], d))?;
            Some([a, b, c, d])
        })
    }

    /// Returns whether `d` lies on the straight edge from `a` to `b`, within rounding.
    fn between(&self, a: u32, d: u32, b: u32) -> bool {
        let [a, d, b] = [a, d, b].map(|i| self.flat[i as usize]);
        let edge = [b[0] - a[0], b[1] - a[1]];
        let part = [d[0] - a[0], d[1] - a[1]];
        let length2 = edge[0] * edge[0] + edge[1] * edge[1];
        let along = part[0] * edge[0] + part[1] * edge[1];
        let across = edge[0] * part[1] - edge[1] * part[0];
        across.abs() <= 1e-12 * length2 && along > 0.0 && along < length2
    }

    fn signed_area(&self, [a, b, c]: [u32; 3]) -> f64 {
        let [a, b, c] = [a, b, c].map(|i| self.flat[i as usize]);
        0.5 * ((b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]))
    }
}

/// Returns half the sum of the cross products (Newell's normal \[sutherland1974\]), relative to the first vertex for accuracy.
pub(super) fn vector_area(points: &[DVec3]) -> DVec3 {
    let Some(&origin) = points.first() else { return DVec3::ZERO };
    points.windows(2).map(|pair| (pair[0] - origin).cross(pair[1] - origin)).sum::<DVec3>() * 0.5
}

/// Iterates over the contours as index ranges, the outer one first.
fn contours(n: usize, holes: &[u32]) -> impl Iterator<Item = std::ops::Range<usize>> {
    let starts = std::iter::once(0).chain(holes.iter().map(|&first| first as usize));
    let ends = holes.iter().map(|&first| first as usize).chain(std::iter::once(n));
    starts.zip(ends).map(|(start, end)| start..end)
}

fn dominant(normal: DVec3) -> (usize, bool) {
    let size = normal.abs();
    let axis = if size.x >= size.y && size.x >= size.z {
        0
    } else if size.y >= size.z {
        1
    } else {
        2
    };
    (axis, normal[axis] > 0.0)
}

/// Returns the component of `area` along the projection axis of `normal`.
fn projected(area: DVec3, normal: DVec3) -> f64 {
    let (axis, positive) = dominant(normal);
    if positive { area[axis] } else { -area[axis] }
}

fn extent(points: &[DVec3]) -> f64 {
    let low = points.iter().copied().reduce(DVec3::min).unwrap_or_default();
    let high = points.iter().copied().reduce(DVec3::max).unwrap_or_default();
    (high - low).length()
}

fn deviation(points: &[DVec3], normal: DVec3, size: f64) -> f64 {
    let center = points.iter().map(|p| *p / points.len() as f64).sum::<DVec3>();
    let farthest = points.iter().map(|p| (*p - center).dot(normal).abs()).fold(0.0, f64::max);
    if size > 0.0 { farthest / size } else { 0.0 }
}

#[cfg(test)]
mod tests;
