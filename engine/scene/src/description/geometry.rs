use super::{GroupId, Location, MaterialId, Motion, ObjectId, PhotometryId};
use femc_math::glam::{DVec2, DVec3};
use serde::{Deserialize, Serialize};

/// Surfaces that move together, in the group's own frame. Instances place a group in other groups.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub struct Group {
    /// Vertices of all faces.
    pub vertices: Vec<Vertex>,
    /// Triangles of all faces, vertex indices, counter-clockwise seen from the front.
    pub triangles: Vec<[u32; 3]>,
    /// Planar faces, each a run of `triangles`; in file order.
    pub faces: Vec<Face>,
    /// Curved surfaces.
    pub quadrics: Vec<Quadric>,
    /// Luminaires with measured photometry.
    pub luminaires: Vec<Luminaire>,
    /// Other groups placed in this one. The graph of groups has no cycles.
    pub instances: Vec<Instance>,
}

impl Group {
    /// Iterates over positions of the group's own surfaces and luminaires, in its frame, m: all vertices, and the middles of shapes
    /// and luminaires.
    pub fn positions(&self) -> impl Iterator<Item = DVec3> + '_ {
        let vertices = self.vertices.iter().map(|vertex| vertex.position);
        let quadrics = self.quadrics.iter().map(|quadric| quadric.shape.center());
        vertices.chain(quadrics).chain(self.luminaires.iter().map(|luminaire| luminaire.to_group.translation))
    }
}

/// A vertex, in the group's frame.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Vertex {
    /// Position, m.
    pub position: DVec3,
    /// Unit shading normal, if the file gives one.
    pub normal: Option<DVec3>,
    /// Texture coordinates; v up.
    pub uv: Option<DVec2>,
}

/// A planar polygon as given in the file.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Face {
    /// First index into [`Group::triangles`].
    pub first_triangle: u32,
    /// Number of triangles; 0 for a face without area, which is kept for diagnosis.
    pub triangle_count: u32,
    /// Material.
    pub material: MaterialId,
    /// Innermost object.
    pub object: Option<ObjectId>,
    /// Location in the file.
    pub location: Location,
}

/// A curved surface.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Quadric {
    /// The shape, in the group's frame.
    pub shape: Shape,
    /// Material.
    pub material: MaterialId,
    /// Innermost object.
    pub object: Option<ObjectId>,
    /// Location in the file.
    pub location: Location,
}

/// Orientation of a shape: whether its front side is the outer or the inner one.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Facing {
    /// Normals point outward.
    Outward,
    /// Normals point inward (negative radii in the file).
    Inward,
}

/// Curved shapes. Radii are positive; `axis` vectors are unit vectors. Shapes are never sheared or scaled unevenly: MGF's
/// transforms are similarities, so an importer maps shapes exactly.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub enum Shape {
    /// A sphere.
    Sphere {
        /// Center, m.
        center: DVec3,
        /// Radius, m.
        radius: f64,
        /// Front side.
        facing: Facing,
    },
    /// An open truncated cone; a cylinder when the radii are equal.
    Cone {
        /// Center of the first end, m.
        start: DVec3,
        /// Center of the second end, m.
        end: DVec3,
        /// Radius at `start`, m; at most one of the radii is 0.
        start_radius: f64,
        /// Radius at `end`, m.
        end_radius: f64,
        /// Front side.
        facing: Facing,
    },
    /// A flat annulus; the front is on the side of `normal`.
    Ring {
        /// Center, m.
        center: DVec3,
        /// Unit normal.
        normal: DVec3,
        /// Inner radius, m; may be 0.
        inner: f64,
        /// Outer radius, m.
        outer: f64,
    },
    /// A torus.
    Torus {
        /// Center, m.
        center: DVec3,
        /// Unit axis.
        axis: DVec3,
        /// Distance of the tube's center line from the axis, m.
        major: f64,
        /// Radius of the tube, m; at most `major`.
        minor: f64,
        /// Front side.
        facing: Facing,
    },
}

impl Shape {
    /// Returns the center of the shape.
    pub fn center(&self) -> DVec3 {
        match *self {
            Self::Sphere { center, .. } | Self::Ring { center, .. } | Self::Torus { center, .. } => center,
            Self::Cone { start, end, .. } => 0.5 * (start + end),
        }
    }
}

/// A luminaire with measured photometry. The photometric frame of LM-63 is the local one: nadir is -z, C0 is +x.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Luminaire {
    /// Intensity distribution.
    pub photometry: PhotometryId,
    /// Local frame to the group's frame.
    pub to_group: femc_math::Transform,
    /// Factor on the intensities (`-m`).
    pub multiplier: f64,
    /// Linear Rec.709 tint of luminance 1.
    pub color: [f64; 3],
    /// Innermost object.
    pub object: Option<ObjectId>,
    /// Location in the file.
    pub location: Location,
}

/// A placement of a group.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Instance {
    /// Group that is placed.
    pub group: GroupId,
    /// Transform from the group's frame to the parent's frame.
    pub motion: Motion,
}
