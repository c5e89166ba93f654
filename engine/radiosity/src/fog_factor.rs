//! Form factors between points and boxes of fog.

use crate::element::{Element, FOG_NODES, Shape};
use crate::factor::{point_form_factor, point_solid_angle_factor};
use crate::form_factor::{polygon_form_factor, solid_angle};
use crate::link::Oracle;
use crate::tuning::{AT_EDGE, FACE_POINTS, FAR_BOX_RADII, FAR_FACE_POINTS, MIN_FACE_DISTANCE, NEAR_BOX_RADII};
use crate::visibility::VisibilityTester;
use femc_field::SurfaceSpot;
use femc_math::cross;
use femc_math::elementary::{exp, ln};
use femc_math::glam::Vec3A;
use std::f32::consts::PI;

/// Kernel of a small surface at a spot: the spot, the surface's spot, its area.
type Kernel = fn(&SurfaceSpot, &SurfaceSpot, f32) -> f32;

impl Oracle<'_> {
    /// Returns the difference, at the edge of a box of fog next to a surface or another box, between the light received there and
    /// the value interpolated from the nodes.
    pub fn edge_error(&self, p: &Element, q: &Element, factors: &[f32; 4], tester: &mut VisibilityTester) -> f32 {
        let nearest = ((q.center - p.center) / p.half_extent).clamp(Vec3A::NEG_ONE, Vec3A::ONE) * AT_EDGE;
        let spot = SurfaceSpot { position: p.center + p.half_extent * nearest, ..SurfaceSpot::default() };
        let linear: f32 = factors.iter().zip(FOG_NODES).map(|(f, node)| f * (0.25 + 0.75 * node.dot(nearest))).sum();
        (self.factor(p, q, &spot, tester) - linear).abs()
    }

    /// Computes the factor of a box of fog as the source. Near the box it uses its faces, see [`box_factor`].
    pub fn factor_from_fog(&self, p: &Element, q: &Element, node: &SurfaceSpot, tester: &mut VisibilityTester) -> f32 {
        let way = q.center - node.position;
        let mut distance2 = way.length_squared();
        if p.is_directional() {
            let reach = p.radius + q.radius;
            distance2 = distance2.max(0.25 * reach * reach);
        }
        let distance = distance2.sqrt();
        let extinction = self.extinction(q);
        if p.is_directional() || distance > FAR_BOX_RADII * q.radius {
            let share = match p.shape {
                Shape::Volume(_) => 1.0,
                Shape::Patch(_) => 4.0 * (node.normal.dot(way) / distance).max(0.0),
                Shape::Cluster(_) | Shape::Curved(_) => 4.0,
            };
            if share <= 0.0 {
                return 0.0;
            }
            // Mean over the box of the decay along the way, relative to its value at the center.
            let decay = q.half_extent * way.abs() * (extinction / distance);
            let spread = |x: f32| 1.0 + x * x * (1.0 / 6.0 + x * x * (1.0 / 120.0 + x * x / 5040.0));
            let through = decay.to_array().into_iter().map(spread).product::<f32>()
                * tester.fog_transmittance(self.scene, node.position, q.center);
            return share * q.size() / (4.0 * PI * distance2) * through;
        }
        // Fewer points suffice where the distances to a face differ less.
        let count = if distance > NEAR_BOX_RADII * q.radius { FAR_FACE_POINTS } else { FACE_POINTS };
        box_factor(extinction, (q.center, q.half_extent), node, p.patch().is_some(), count as usize)
    }

    /// Computes the factor of a wide source at a box of fog. At a point outside, it is that of the source's center. Inside the box
    /// around the source, it is the mean over the box.
    pub fn factor_at_fog(
        &self,
        p: &Element,
        q: &Element,
        distance2: f32,
        node: &SurfaceSpot,
        tester: &mut VisibilityTester,
    ) -> f32 {
        if (q.center - p.center).abs().cmple(p.half_extent).all() {
            // A quarter of 4 pi times the path length of light in the box, divided by its volume.
            let length = attenuated_length(self.extinction(p), p.half_extent.min_element());
            return PI * length / p.size();
        }
        0.25 / distance2 * tester.fog_transmittance(self.scene, node.position, q.center)
    }
}

/// Returns the share of the radiosity (per m) of a homogeneous box of fog that a point receives, m. It uses the box's faces: for
/// all directions through a face, the length of fog from the point to the face. The lengths up to the far faces count positive,
/// those up to the near faces negative.
/// - `count`: number of points on a face by axis, at most [`FACE_POINTS`].
fn box_factor(
    extinction: f32,
    (center, half): (Vec3A, Vec3A),
    node: &SurfaceSpot,
    on_surface: bool,
    count: usize,
) -> f32 {
    let (mut sum, least) = (0.0, MIN_FACE_DISTANCE * half.length());
    for axis in 0..3 {
        for side in [-1.0, 1.0] {
            let (mut out, mut u, mut v) = (Vec3A::ZERO, Vec3A::ZERO, Vec3A::ZERO);
            out[axis] = side * half[axis];
            u[(axis + 1) % 3] = half[(axis + 1) % 3];
            v[(axis + 2) % 3] = half[(axis + 2) % 3];
            let middle = center + out;
            // Counterclockwise as seen from the side of the point. Near faces count negative.
            let inward = out.dot(node.position - middle) < 0.0;
            if (side > 0.0) == inward {
                std::mem::swap(&mut u, &mut v);
            }
            let corners = [middle - u - v, middle + u - v, middle + u + v, middle - u + v];
            let (share, kernel): (f32, Kernel) = if on_surface {
                (polygon_form_factor(node.position, node.normal, &corners), point_form_factor)
            } else {
                (solid_angle(node.position, &corners) / (4.0 * PI), point_solid_angle_factor)
            };
            if share > 0.0 {
                let length = mean_length(extinction, (middle, u, v), node, kernel, (least, count));
                sum += if inward { share * length } else { -share * length };
            }
        }
    }
    sum.max(0.0)
}

/// Returns the mean length of fog, as by [`attenuated_length`], from a point to a face with this center and these half edges.
/// - `least`: minimum distance of the point to the face for the choice of points on it, m.
fn mean_length(
    extinction: f32,
    (middle, u, v): (Vec3A, Vec3A, Vec3A),
    node: &SurfaceSpot,
    kernel: Kernel,
    (least, count): (f32, usize),
) -> f32 {
    let normal = cross(u, v).normalize_or(Vec3A::Z);
    let from = node.position - middle;
    let height = normal.dot(from).abs().max(least);
    let [across, up] = [u, v].map(|edge| {
        let half = edge.length();
        let foot = edge.dot(from) / (half * height);
        let steps = quadrature_points([-half / height - foot, half / height - foot], count);
        steps.map(|(place, weight)| (edge * ((place + foot) * height / half), weight))
    });
    let (mut weight, mut length) = (0.0, 0.0);
    for (x, of_x) in &across[..count] {
        for (y, of_y) in &up[..count] {
            let spot = SurfaceSpot { position: middle + *x + *y, normal, ..*node };
            let part = kernel(node, &spot, 1.0) * of_x * of_y;
            weight += part;
            length += part * attenuated_length(extinction, spot.position.distance(node.position));
        }
    }
    if weight > 0.0 { length / weight } else { attenuated_length(extinction, middle.distance(node.position)) }
}

/// Returns positions on a stretch near a point, in units of the point's distance from the stretch's line, and their weights. They
/// are dense where the stretch is near the point, where the light changes most.
/// - `ends`: ends relative to the foot of the point;
/// - `count`: number of positions, at most [`FACE_POINTS`].
fn quadrature_points(ends: [f32; 2], count: usize) -> [(f32, f32); FACE_POINTS as usize] {
    // Equal steps of the area hyperbolic sine, computed with its exponential.
    let [from, to] = ends.map(|x| {
        let e = x.abs() + (x * x + 1.0).sqrt();
        if x < 0.0 { 1.0 / e } else { e }
    });
    let ratio = exp(ln(to / from) / (2 * count) as f32);
    let mut e = from * ratio;
    let mut steps = [(0.0, 0.0); FACE_POINTS as usize];
    for step in &mut steps[..count] {
        *step = (0.5 * (e - 1.0 / e), 0.5 * (e + 1.0 / e));
        e *= ratio * ratio;
    }
    steps
}

/// Returns the length of unattenuated fog that sends as much light as all fog up to a distance does through itself, m.
pub fn attenuated_length(extinction: f32, distance: f32) -> f32 {
    let x = extinction * distance;
    if x < 0.35 {
        // The series takes a tenth of the time of the function.
        let more = x * (1.0 / 24.0 - x * (1.0 / 120.0 - x / 720.0));
        return distance * (1.0 - x * (0.5 - x * (1.0 / 6.0 - more)));
    }
    if x < 2.8 {
        // The eighth power of the exponential of an eighth, by its series.
        let y = 0.125 * x;
        let e = 1.0 - y * (1.0 - y * (0.5 - y * (1.0 / 6.0 - y * (1.0 / 24.0 - y * (1.0 / 120.0 - y / 720.0)))));
        let squared = e * e;
        let fourth = squared * squared;
        return (1.0 - fourth * fourth) / extinction;
    }
    (1.0 - exp(-x)) / extinction
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Reference by directions: the fog from where a ray enters the box, or begins, to where it leaves it.
    fn reference_by_directions(extinction: f32, center: Vec3A, half: Vec3A, point: Vec3A) -> f64 {
        const N: u32 = 1000;
        let of = |k: u32| {
            let [u, v] = [k % N, k / N].map(|k| (k as f32 + 0.5) / N as f32);
            let dir = femc_math::warp::direction(1.0 - 2.0 * u, v);
            let [a, b] = [-1.0, 1.0].map(|side| (center + half * side - point) / dir);
            let (near, far) = (a.min(b).max_element().max(0.0), a.max(b).min_element());
            let part = |t: f32| f64::from((1.0 - exp(-extinction * t)) / extinction);
            if far > near { part(far) - part(near) } else { 0.0 }
        };
        (0..N * N).map(of).sum::<f64>() / f64::from(N * N)
    }

    /// Points in a box, at its face, and over its edge, for boxes that are larger and smaller, thick and thin.
    #[test]
    fn a_point_receives_of_a_box_what_all_directions_bring() {
        let boxes = [
            ([0.0, 0.0, 0.0], [0.25, 0.25, 0.25]),
            ([0.5, 0.0, 0.0], [0.25, 0.25, 0.25]),
            ([0.5, 0.5, 0.0], [0.25, 0.25, 0.25]),
            ([0.6, 0.1, 0.0], [0.5, 0.5, 0.25]),
            ([0.3, 0.0, 0.1], [0.05, 0.05, 0.1]),
            ([1.0, 0.3, 0.0], [0.85, 0.6, 0.6]),
        ];
        for extinction in [0.3, 1.0, 3.0] {
            for (center, half) in boxes.map(|(center, half)| (Vec3A::from(center), Vec3A::from(half))) {
                for place in FOG_NODES {
                    let point = place * 0.25;
                    let spot = SurfaceSpot { position: point, ..SurfaceSpot::default() };
                    let have = f64::from(box_factor(extinction, (center, half), &spot, false, FACE_POINTS as usize));
                    let want = reference_by_directions(extinction, center, half, point);
                    let scale = f64::from(half.max_element());
                    assert!(
                        (have - want).abs() < 0.02 * want + 2e-4 * scale,
                        "{extinction} {center} {point}: {have} {want}"
                    );
                }
            }
        }
    }
}
