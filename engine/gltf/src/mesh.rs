//! Triangles of one piece of an object, by material.

use crate::objects::{Piece, Place, Surface, steps};
use crate::tessellation::Tessellation;
use femc_geometry::Aabb;
use femc_math::cross;
use femc_math::glam::{Affine3A, Mat3, Vec3A};
use femc_prepared::compile::{CompiledGroup, NONE};
use std::collections::{BTreeMap, HashMap};

/// Triangles of one material.
#[derive(Default)]
pub(crate) struct Part {
    pub positions: Vec<[f32; 3]>,
    /// Unit normals of the front, one for each vertex; empty: the triangles are flat.
    pub normals: Vec<[f32; 3]>,
    pub triangles: Vec<[u32; 3]>,
}

/// Shading of triangles.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum Shading {
    Flat,
    Smooth,
}

/// Triangles by material and shading.
#[derive(Default)]
pub(crate) struct PieceMesh {
    pub parts: BTreeMap<(u32, Shading), Part>,
    /// Bound of the distance of the triangles from the surfaces, m.
    pub deviation: f64,
}

/// Vertices of triangles by their bits, so that neighbors share them.
#[derive(Default)]
struct Shared(HashMap<[u32; 6], u32>);

impl Shared {
    fn vertex(&mut self, part: &mut Part, position: Vec3A, normal: Option<Vec3A>) -> u32 {
        let [p, n] = [position, normal.unwrap_or(Vec3A::ZERO)].map(|v| v.to_array().map(f32::to_bits));
        *self.0.entry([p[0], p[1], p[2], n[0], n[1], n[2]]).or_insert_with(|| {
            part.positions.push(position.to_array());
            part.normals.extend(normal.map(|normal| normal.to_array()));
            (part.positions.len() - 1) as u32
        })
    }
}

impl PieceMesh {
    /// Creates the triangles of a piece in its group's frame.
    pub(crate) fn new(piece: &Piece<'_>, share: f64) -> Self {
        let mut mesh = Self::default();
        let mut shared: BTreeMap<(u32, Shading), Shared> = BTreeMap::new();
        for primitive in piece.numbers() {
            let material = piece.group.primitives[primitive as usize].material;
            match piece.surface(primitive) {
                None => {}
                Some(Surface::Triangle(corners)) => {
                    let normals = corner_normals(piece.group, primitive);
                    let key = (material, if normals.is_some() { Shading::Smooth } else { Shading::Flat });
                    let (part, shared) = (mesh.parts.entry(key).or_default(), shared.entry(key).or_default());
                    let normal = |k: usize| normals.map(|normals| normals[k]);
                    let triangle = [0, 1, 2].map(|k| shared.vertex(part, corners[k], normal(k)));
                    part.triangles.push(triangle);
                }
                Some(Surface::Curved(shape)) => {
                    let steps = steps(&shape, share);
                    mesh.deviation = mesh.deviation.max(steps.deviation(&shape));
                    let Tessellation { positions, normals, triangles } = Tessellation::new(&shape, steps);
                    let part = mesh.parts.entry((material, Shading::Smooth)).or_default();
                    let first = part.positions.len() as u32;
                    part.positions.extend(positions.iter().map(|position| position.to_array()));
                    part.normals.extend(normals.iter().map(|normal| normal.to_array()));
                    part.triangles.extend(triangles.iter().map(|triangle| triangle.map(|vertex| first + vertex)));
                }
            }
        }
        mesh
    }

    /// Creates a box.
    pub(crate) fn of_box(bounds: &Aabb, material: u32) -> Self {
        let corner = |k: u32| {
            let side = |bit: u32, axis: usize| if k & bit == 0 { bounds.min[axis] } else { bounds.max[axis] };
            [side(1, 0), side(2, 1), side(4, 2)]
        };
        let faces = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]];
        let triangles = faces.iter().flat_map(|&[a, b, c, d]| [[a, b, c], [a, c, d]]);
        let part =
            Part { positions: (0..8).map(corner).collect(), normals: Vec::new(), triangles: triangles.collect() };
        Self { parts: BTreeMap::from([((material, Shading::Flat), part)]), deviation: 0.0 }
    }

    /// Unites copies at all places, in the prepared frame.
    pub(crate) fn placed(&self, places: &[Place]) -> Self {
        let mut all = Self::default();
        for place in places {
            let is_mirrored = Mat3::from(place.pose.matrix3).determinant() < 0.0;
            for (key, part) in &self.parts {
                let placed = all.parts.entry(*key).or_default();
                let first = placed.positions.len() as u32;
                let position = |&p: &[f32; 3]| place.pose.transform_point3a(p.into()).to_array();
                placed.positions.extend(part.positions.iter().map(position));
                let normal = |&n: &[f32; 3]| transformed_normal(&place.pose, n.into(), is_mirrored).to_array();
                placed.normals.extend(part.normals.iter().map(normal));
                let turned = |[a, b, c]: [u32; 3]| if is_mirrored { [a, c, b] } else { [a, b, c] };
                placed.triangles.extend(part.triangles.iter().map(|it| turned(it.map(|vertex| first + vertex))));
            }
        }
        let scale = places.iter().map(Place::scale).fold(0.0, f64::max);
        all.deviation = self.deviation * scale;
        all
    }

    /// Returns the number of triangles.
    pub(crate) fn triangles(&self) -> u64 {
        self.parts.values().map(|part| part.triangles.len() as u64).sum()
    }
}

/// Returns the normals that the scene file gives for the corners of a triangle; `None`: the triangle is flat.
fn corner_normals(group: &CompiledGroup, primitive: u32) -> Option<[Vec3A; 3]> {
    let corners = group.primitives[primitive as usize].corners;
    let normals = (corners != NONE).then(|| group.corners[corners as usize].normals.map(Vec3A::from))?;
    normals.iter().all(|normal| *normal != Vec3A::ZERO && normal.is_finite()).then_some(normals)
}

/// Returns a unit normal in the prepared frame, on the front.
fn transformed_normal(pose: &Affine3A, n: Vec3A, is_mirrored: bool) -> Vec3A {
    let m = pose.matrix3;
    let cofactors = cross(m.y_axis, m.z_axis) * n.x + cross(m.z_axis, m.x_axis) * n.y + cross(m.x_axis, m.y_axis) * n.z;
    let normal = cofactors.normalize_or(n);
    if is_mirrored { -normal } else { normal }
}
