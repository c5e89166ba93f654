//! Factor between a point of one element and another element: the light that arrives through fog, without occlusion.

use crate::element::{Element, Patch, PatchForm, Shape};
use crate::form_factor::{is_near, polygon_form_factor, solid_angle};
use crate::link::Oracle;
use crate::tuning::{POLYGON_RADII, THIN_DEPTH};
use crate::visibility::VisibilityTester;
use femc_field::SurfaceSpot;
use std::f32::consts::PI;

impl Oracle<'_> {
    /// Returns the factor of an element at a point through the fog, without occlusion, as in [`Link::factors`].
    pub fn factor(&self, p: &Element, q: &Element, node: &SurfaceSpot, tester: &mut VisibilityTester) -> f32 {
        if q.is_volume() {
            return self.factor_from_fog(p, q, node, tester);
        }
        let way = q.center - node.position;
        let mut distance2 = way.length_squared();
        if p.is_directional() || q.is_directional() {
            // Minimum mean distance of the parts of both elements.
            let reach = p.radius + q.radius;
            distance2 = distance2.max(0.25 * reach * reach);
        }
        let distance = distance2.sqrt();
        let near = is_near(distance2, q.radius) && !p.is_directional();
        // Sums over parts of the source, by area and direction from the point.
        let parts = |patch: &Patch, of: &dyn Fn(&SurfaceSpot, f32) -> f32| -> f32 {
            if near {
                let nodes = patch.nodes();
                nodes.iter().map(|part| of(part, patch.part.area / nodes.len() as f32)).sum()
            } else {
                of(&SurfaceSpot { position: q.center, normal: patch.normal, ..*node }, patch.part.area)
            }
        };
        let is_close_polygon = |patch: &Patch| {
            patch.form != PatchForm::Bent && distance2 < POLYGON_RADII * POLYGON_RADII * q.radius * q.radius
        };
        let open = match (&p.shape, &q.shape) {
            (Shape::Patch(_), Shape::Patch(patch)) if is_close_polygon(patch) => {
                polygon_form_factor(node.position, node.normal, patch.polygon())
            }
            (Shape::Patch(_), Shape::Patch(patch)) => {
                parts(patch, &|part, area| point_form_factor(node, part, area)).min(1.0)
            }
            (Shape::Patch(_), _) => (node.normal.dot(way) / distance).max(0.0) / distance2,
            (Shape::Volume(_), Shape::Patch(patch)) if is_close_polygon(patch) => {
                solid_angle(node.position, patch.polygon()) / (4.0 * PI)
            }
            (Shape::Volume(_), Shape::Patch(patch)) => {
                0.25 * parts(patch, &|part, area| point_solid_angle_factor(node, part, area))
            }
            (Shape::Volume(_), _) => return self.factor_at_fog(p, q, distance2, node, tester),
            (_, Shape::Patch(patch)) => {
                patch.part.area * (-patch.normal.dot(way) / distance).max(0.0) / (PI * distance2)
            }
            _ => 1.0 / distance2,
        };
        if open <= 0.0 || self.scene.uniform_extinction == Some(0.0) {
            return open.max(0.0);
        }
        let Some(patch) = q.patch().filter(|_| near) else {
            return open * tester.fog_transmittance(self.scene, node.position, q.center);
        };
        // Near parts are attenuated less: the mean is weighted by the kernel at points of the source, at more points where that
        // matters.
        let (mut weight, mut through) = (0.0, 0.0);
        let mut add = |part: &SurfaceSpot| {
            let kernel = if p.patch().is_some() {
                point_form_factor(node, part, 1.0)
            } else {
                point_solid_angle_factor(node, part, 1.0)
            };
            weight += kernel;
            through += kernel * tester.fog_transmittance(self.scene, node.position, part.position);
        };
        let thickness = self.extinction(q) * q.radius;
        if patch.form != PatchForm::Bent && thickness * q.radius > THIN_DEPTH * distance {
            let is_triangle = patch.form == PatchForm::Triangle;
            let corners = patch.polygon();
            let (a, b, last) = (corners[0], corners[1], corners[corners.len() - 1]);
            for k in 0..64 {
                let mut u = [k % 8, k / 8].map(|k| (k as f32 + 0.5) / 8.0);
                if is_triangle && u[0] + u[1] > 1.0 {
                    u = u.map(|u| 1.0 - u);
                }
                let position = a + (b - a) * u[0] + (last - a) * u[1];
                add(&SurfaceSpot { position, ..patch.nodes()[0] });
            }
        } else {
            patch.nodes().iter().for_each(add);
        }
        if weight > 0.0 {
            open * through / weight
        } else {
            open * tester.fog_transmittance(self.scene, node.position, q.center)
        }
    }
}

/// Returns the form factor of a small surface of area `area` at a spot, from another spot.
pub fn point_form_factor(at: &SurfaceSpot, from: &SurfaceSpot, area: f32) -> f32 {
    let way = from.position - at.position;
    let distance2 = way.length_squared();
    if distance2 <= 0.0 {
        return 0.0;
    }
    area * at.normal.dot(way).max(0.0) * (-from.normal.dot(way)).max(0.0) / (PI * distance2 * distance2)
}

/// Returns the form factor without the cosine of the receiver.
pub fn point_solid_angle_factor(at: &SurfaceSpot, from: &SurfaceSpot, area: f32) -> f32 {
    let way = from.position - at.position;
    let distance2 = way.length_squared();
    if distance2 <= 0.0 {
        return 0.0;
    }
    area * (-from.normal.dot(way)).max(0.0) / (PI * distance2 * distance2.sqrt())
}
