//! Elements of a solution as triangles with their light, for viewing.
//!
//! Every leaf has its own vertices, because the light jumps from leaf to leaf. Curved leaves are divided along a grid over the
//! whole surface, so that neighbors share its lines. If a leaf is finer than the grid, its neighbor's chord misses the vertex by
//! less than the grid's own error.

use crate::scene::SHUTTER_TIME;
use crate::view::SolutionView;
use femc_field::{Form, NONE, Outline, Side, Surface, SurfaceSpot};
use femc_geometry::Quadric;
use femc_math::Rgb;
use femc_math::color::luminance;
use femc_math::cross;
use femc_math::glam::{Vec2, Vec3A};
use femc_prepared::{Orientation, Prepared};
use femc_scattering::Sides;
use std::collections::BTreeMap;

/// Content of a mesh.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum MeshContent {
    /// Elements.
    Elements,
    /// Light sources that reflect nothing and therefore are not elements.
    Lamps,
}

/// All triangles of a material, one side. Prepared frame, m. Arrays are by vertex unless stated otherwise.
#[derive(Clone, Debug, PartialEq)]
pub struct Mesh {
    /// Content of the mesh.
    pub content: MeshContent,
    /// Index of the material.
    pub material: u32,
    /// Side from which the mesh is visible.
    pub side: Side,
    /// Positions.
    pub positions: Vec<[f32; 3]>,
    /// Unit normals of the side.
    pub normals: Vec<[f32; 3]>,
    /// Luminance by channel, cd/m2, along the normal: reflected, transmitted and emitted.
    pub radiance: Vec<[f32; 3]>,
    /// Irradiance, lx by channel.
    pub irradiance: Vec<[f32; 3]>,
    /// Part of the irradiance that comes directly from light sources.
    pub direct: Vec<[f32; 3]>,
    /// Index of the leaf in the field, or [`NONE`] for lamps.
    pub leaves: Vec<u32>,
    /// Index of the surface in the field, or [`NONE`].
    pub surfaces: Vec<u32>,
    /// Vertices of each triangle, counterclockwise as seen from the side.
    pub triangles: Vec<[u32; 3]>,
    /// Endpoints of the leaves' edges.
    pub edges: Vec<[u32; 2]>,
}

impl Mesh {
    fn new((part, material, back): (MeshContent, u32, bool)) -> Self {
        Self {
            content: part,
            material,
            side: if back { Side::Back } else { Side::Front },
            positions: Vec::new(),
            normals: Vec::new(),
            radiance: Vec::new(),
            irradiance: Vec::new(),
            direct: Vec::new(),
            leaves: Vec::new(),
            surfaces: Vec::new(),
            triangles: Vec::new(),
            edges: Vec::new(),
        }
    }

    fn push(&mut self, spot: &SurfaceSpot, [radiance, irradiance, direct]: [Rgb; 3], leaf: u32, surface: u32) {
        self.positions.push(spot.position.to_array());
        self.normals.push(spot.normal.to_array());
        self.radiance.push(radiance.to_array());
        self.irradiance.push(irradiance.to_array());
        self.direct.push(direct.to_array());
        self.leaves.push(leaf);
        self.surfaces.push(surface);
    }

    /// Returns the luminance, cd/m2, and the area, m2, of each triangle.
    pub fn luminances(&self) -> impl Iterator<Item = (f32, f32)> {
        self.triangles.iter().map(|triangle| {
            let [a, b, c] = triangle.map(|vertex| Vec3A::from(self.positions[vertex as usize]));
            let sum: Rgb = triangle.iter().map(|&vertex| Rgb::from_array(self.radiance[vertex as usize])).sum();
            (luminance(sum) / 3.0, 0.5 * cross(b - a, c - a).length())
        })
    }

    /// Adds a triangle, with its front on the side of the vertices' normals, if it has an area.
    fn triangle(&mut self, corners: [u32; 3]) {
        let [a, b, c] = corners.map(|corner| Vec3A::from(self.positions[corner as usize]));
        let normal: Vec3A = corners.iter().map(|&corner| Vec3A::from(self.normals[corner as usize])).sum();
        let facing = cross(b - a, c - a);
        // At the poles of a grid, two of the corners coincide.
        let longest = (b - a).length_squared().max((c - a).length_squared()).max((c - b).length_squared());
        if facing.length_squared() <= (MIN_HEIGHT_RATIO * longest) * (MIN_HEIGHT_RATIO * longest) {
            return;
        }
        let [a, b, c] = corners;
        self.triangles.push(if facing.dot(normal) < 0.0 { [a, c, b] } else { [a, b, c] });
    }
}

/// Minimum height of a triangle over its longest edge. Flatter triangles are dropped.
const MIN_HEIGHT_RATIO: f32 = 1e-7;
/// Possible numbers of steps of a grid around an axis.
const GRID_STEPS: [u32; 3] = [16, 32, 64];
/// Distance of a chord of the grid from the surface that is not visible, as a share of the scene's extent.
const MAX_SAGITTA: f32 = 2e-5;

/// Returns the meshes of a solution, in an order that depends only on the scene: elements, then lamps.
pub fn solution_meshes(view: &SolutionView<'_>) -> Vec<Mesh> {
    let mut meshes = BTreeMap::new();
    let extent = view.prepared.world.bounds().size().length();
    let field = view.field;
    for (index, surface) in (0u32..).zip(&field.surfaces) {
        let key = (MeshContent::Elements, surface.material, surface.side == Side::Back);
        for (leaf, outline) in field.leaves_of(index) {
            let mesh = meshes.entry(key).or_insert_with(|| Mesh::new(key));
            let grid = Grid::new(surface, &outline, extent);
            grid.add(mesh, |mesh, local, spot| {
                let place = outline.point_at(local);
                let inside = outline.point_at(local.lerp(Vec2::splat(1.0 / 3.0), 1e-3));
                let arriving = view.irradiance(leaf, local, spot.normal);
                let sent = view.radiance(index, arriving, place, inside);
                mesh.push(spot, [sent, arriving.total(), arriving.direct], leaf, index);
            });
        }
    }
    for surface in emitting_surfaces(view) {
        let key = (MeshContent::Lamps, surface.material, surface.side == Side::Back);
        let grid = Grid::new(&surface, &Outline::WHOLE, extent);
        let mesh = meshes.entry(key).or_insert_with(|| Mesh::new(key));
        grid.add(mesh, |mesh, local, spot| {
            mesh.push(spot, [view.emitted(&surface, local, spot), Rgb::ZERO, Rgb::ZERO], NONE, NONE);
        });
    }
    meshes.into_values().filter(|mesh| !mesh.triangles.is_empty()).collect()
}

/// Returns the sides of emitting surfaces that are not elements.
fn emitting_surfaces(view: &SolutionView<'_>) -> Vec<Surface> {
    let Prepared { world, instances, materials, .. } = view.prepared;
    let mut lamps = Vec::new();
    for (instance, group) in (0u32..).zip(instances.iter()) {
        let pose = world.pose_at(instance, SHUTTER_TIME);
        let blas = &group.compiled.blas;
        for (primitive, about) in (0u32..).zip(&group.compiled.primitives) {
            let sides = view.field.sides.get(instance as usize).and_then(|sides| sides.get(primitive as usize));
            if about.emitter == NONE || sides != Some(&[NONE; 2]) {
                continue;
            }
            let form = match (blas.triangle(primitive), blas.quadric(primitive)) {
                (Some(corners), _) => {
                    let [a, b, c] = corners.map(|corner| pose.transform_point3a(corner));
                    Form::Triangle([a, b - a, c - a])
                }
                (None, Some(shape)) => Form::Curved { shape, pose },
                (None, None) => continue,
            };
            let kernel = &materials[about.material as usize];
            let both = kernel.parameters.sides == Sides::Two && kernel.orientation == Orientation::TowardViewer;
            for side in [Side::Front, Side::Back].into_iter().take(1 + usize::from(both)) {
                let (primitives, form) = ([primitive; 2], form.clone());
                let surface = Surface { instance, primitives, material: about.material, side, form };
                if surface.area().is_finite() {
                    lamps.push(surface);
                }
            }
        }
    }
    lamps
}

/// Vertices of a leaf.
struct Grid<'a> {
    surface: &'a Surface,
    /// Columns of vertices by their first local coordinate; empty for a triangle.
    columns: Vec<f32>,
    /// Rows by the second parameter of the shape, and by the second local coordinate.
    rows: Vec<(f64, f32)>,
    outline: Outline,
}

impl<'a> Grid<'a> {
    fn new(surface: &'a Surface, outline: &Outline, extent: f32) -> Self {
        let mut grid = Self { surface, columns: Vec::new(), rows: Vec::new(), outline: *outline };
        match &surface.form {
            Form::Triangle(_) => {}
            Form::Parallelogram(_) => {
                grid.columns = vec![0.0, 1.0];
                grid.rows = vec![(0.0, 0.0), (1.0, 1.0)];
            }
            Form::Curved { shape, pose } => {
                let [around, along] = grid_steps(shape, pose.matrix3.x_axis.length(), extent);
                let (corner, end) = (outline.point_at(Vec2::ZERO), outline.point_at(Vec2::ONE));
                let size = end - corner;
                let columns = grid_lines([corner.x, end.x].map(f64::from), around);
                grid.columns =
                    columns.iter().map(|&u| ((u - f64::from(corner.x)) / f64::from(size.x)) as f32).collect();
                let at = |share: f32| match share {
                    0.0 => 0.0,
                    1.0 => 1.0,
                    _ => shape.parameter_at_share(f64::from(share)),
                };
                let local = |v: f64| ((shape.share_below(v) - f64::from(corner.y)) / f64::from(size.y)) as f32;
                let rows = grid_lines([corner.y, end.y].map(at), along);
                grid.rows = rows.into_iter().map(|v| (v, local(v).clamp(0.0, 1.0))).collect();
            }
        }
        grid
    }

    /// Adds the vertices through `push`, which receives the local coordinates of each, then triangles and edges.
    fn add(&self, mesh: &mut Mesh, mut push: impl FnMut(&mut Mesh, Vec2, &SurfaceSpot)) {
        let first = mesh.positions.len() as u32;
        if self.columns.is_empty() {
            for local in [Vec2::ZERO, Vec2::X, Vec2::Y] {
                push(mesh, local, &self.surface.point_at(self.outline.point_at(local)));
            }
            let [a, b, c] = [0, 1, 2].map(|corner| first + corner);
            mesh.triangle([a, b, c]);
            mesh.edges.extend([[a, b], [b, c], [c, a]]);
            return;
        }
        for &(v, y) in &self.rows {
            for &x in &self.columns {
                let local = Vec2::new(x, y);
                push(mesh, local, &self.spot(local, v));
            }
        }
        let (across, up) = (self.columns.len() as u32, self.rows.len() as u32);
        let vertex = |column: u32, row: u32| first + row * across + column;
        for row in 1..up {
            for column in 1..across {
                let [a, b] = [column - 1, column].map(|column| vertex(column, row - 1));
                let [d, c] = [column - 1, column].map(|column| vertex(column, row));
                mesh.triangle([a, b, c]);
                mesh.triangle([a, c, d]);
            }
        }
        for column in 1..across {
            mesh.edges.extend([0, up - 1].map(|row| [vertex(column - 1, row), vertex(column, row)]));
        }
        for row in 1..up {
            mesh.edges.extend([0, across - 1].map(|column| [vertex(column, row - 1), vertex(column, row)]));
        }
    }

    /// Returns the surface spot of a vertex.
    /// - `v`: the second parameter of the shape.
    fn spot(&self, local: Vec2, v: f64) -> SurfaceSpot {
        let place = self.outline.point_at(local);
        let Form::Curved { shape, pose } = &self.surface.form else { return self.surface.point_at(place) };
        let (position, normal) = shape.point_at([f64::from(place.x), v]);
        let normal = pose.transform_vector3a(normal.as_vec3a()).normalize_or(Vec3A::Z);
        SurfaceSpot {
            position: pose.transform_point3a(position.as_vec3a()),
            error: Vec3A::ZERO,
            normal: if self.surface.side == Side::Back { -normal } else { normal },
        }
    }
}

/// Returns the number of steps around the axis, and along the second parameter.
fn grid_steps(shape: &Quadric, scale: f32, extent: f32) -> [u32; 2] {
    let (radius, straight) = match *shape {
        Quadric::Sphere { radius, .. } => (radius, false),
        Quadric::Cone { start_radius, end_radius, .. } => (start_radius.max(end_radius), true),
        Quadric::Ring { outer, .. } => (outer, true),
        Quadric::Torus { major, minor, .. } => (major + minor, false),
    };
    // A chord over the angle a deviates by r a^2 / 8 from its arc.
    let angle = (8.0 * MAX_SAGITTA * extent / (radius * scale).max(f32::MIN_POSITIVE)).sqrt();
    let needed = std::f32::consts::TAU / angle;
    let around = GRID_STEPS.into_iter().find(|&steps| steps as f32 >= needed).unwrap_or(GRID_STEPS[2]);
    [around, if straight { 1 } else { around / 2 }]
}

/// Returns both ends, and the multiples of 1 / `steps` between them.
fn grid_lines([from, to]: [f64; 2], steps: u32) -> Vec<f64> {
    let near = 1e-3 / f64::from(steps);
    let inner = (1..steps).map(|step| f64::from(step) / f64::from(steps));
    let inner = inner.filter(|&at| at > from + near && at < to - near);
    std::iter::once(from).chain(inner).chain(std::iter::once(to)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use femc_geometry::Facing;
    use femc_math::glam::Affine3A;

    fn surface(shape: Quadric, side: Side) -> Surface {
        let pose = Affine3A::from_translation([3.0, 4.0, 5.0].into());
        Surface { instance: 0, primitives: [0; 2], material: 0, side, form: Form::Curved { shape, pose } }
    }

    /// Creates the mesh of a surface with leaves: halves along both parameters alternately. Leaves at the first corner are split
    /// `deeper` more times.
    fn mesh(surface: &Surface, deeper: u32) -> Mesh {
        let mut mesh = Mesh::new((MeshContent::Elements, 0, surface.side == Side::Back));
        let mut pending = vec![(Outline::WHOLE, 0)];
        while let Some((outline, depth)) = pending.pop() {
            let deepest = 3 + if outline.corner == Vec2::ZERO { deeper } else { 0 };
            if depth < deepest {
                let halves = Outline::halves(femc_field::Split::Half((depth % 2) as u8), |_, _| 1.0);
                pending.extend(halves.map(|half| (outline.compose(&half), depth + 1)));
                continue;
            }
            let grid = Grid::new(surface, &outline, 4.0);
            grid.add(&mut mesh, |mesh, _, spot| mesh.push(spot, [Rgb::ZERO; 3], 0, 0));
        }
        mesh
    }

    /// Returns the area, and the volume on the far side of the normals. The triangles' normals must agree with the vertices'.
    fn measures(mesh: &Mesh) -> (f64, f64) {
        mesh.triangles.iter().fold((0.0, 0.0), |(area, volume), triangle| {
            let [a, b, c] = triangle.map(|k| Vec3A::from(mesh.positions[k as usize]).as_dvec3());
            let normal = (b - a).cross(c - a);
            let vertex = Vec3A::from(mesh.normals[triangle[0] as usize]).as_dvec3();
            assert!(normal.dot(vertex) > 0.0, "{triangle:?} is turned over");
            (area + 0.5 * normal.length(), volume + a.dot(normal) / 6.0)
        })
    }

    #[test]
    fn triangles_of_spheres_and_tori_close_for_any_leaves() {
        let (center, facing) = (Vec3A::new(1.0, 0.0, 0.0), Facing::Outward);
        let sphere = Quadric::Sphere { center, radius: 0.7, facing };
        let torus = Quadric::Torus { center, axis: Vec3A::new(0.6, 0.0, 0.8), major: 0.8, minor: 0.3, facing };
        let tau = std::f64::consts::TAU;
        for (shape, volume) in [(sphere, tau / 1.5 * 0.343), (torus, 0.5 * tau * tau * 0.8 * 0.09)] {
            for deeper in [0, 1, 6, 11] {
                let (found, inside) = measures(&mesh(&surface(shape, Side::Front), deeper));
                assert!((found / shape.area() - 1.0).abs() < 0.01, "{shape:?}: area {found}, not {}", shape.area());
                assert!((inside / volume - 1.0).abs() < 0.015, "{shape:?}: volume {inside}, not {volume}");
                let (same, outside) = measures(&mesh(&surface(shape, Side::Back), deeper));
                assert!(
                    (same - found).abs() < 1e-9 && (outside + inside).abs() < 1e-9,
                    "the back is the front turned over"
                );
            }
        }
    }

    #[test]
    fn cones_with_a_tip_and_rings_without_a_hole_have_their_area() {
        let (start, end, facing) = (Vec3A::ZERO, Vec3A::new(0.0, 1.0, 2.0), Facing::Inward);
        let cone = Quadric::Cone { start, end, start_radius: 0.0, end_radius: 1.0, facing };
        let ring = Quadric::Ring { center: end, normal: Vec3A::Y, inner: 0.0, outer: 1.0 };
        for shape in [cone, ring] {
            let (area, _) = measures(&mesh(&surface(shape, Side::Front), 5));
            assert!((area / shape.area() - 1.0).abs() < 0.01, "{shape:?}: {area}, not {}", shape.area());
        }
    }
}
