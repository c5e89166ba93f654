//! Surfaces of one group in its own frame, with their tree.

use crate::{
    Aabb, Facing, Quadric,
    shape::CrossingFilter,
    tree::{Child, Lanes, LeafRule, Tree, WIDTH, collapse},
};
use femc_math::glam::Vec3A;

/// Visibility of a surface to rays that come from behind.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub enum Cull {
    /// Visible from both sides.
    #[default]
    None,
    /// Invisible from behind: rays pass through.
    Back,
}

/// A triangle, counter-clockwise seen from the front.
#[derive(Clone, Copy, Debug)]
pub struct TriangleInput {
    /// Vertices, m. Neighbors are watertight if they share bit-identical floats.
    pub vertices: [Vec3A; 3],
    /// Visibility from behind.
    pub cull: Cull,
}

/// An analytic shape.
#[derive(Clone, Copy, Debug)]
pub struct ShapeInput {
    /// The surface.
    pub shape: Quadric,
    /// Visibility from behind.
    pub cull: Cull,
}

/// Up to eight triangles. Unused slots contain NaN vertices, which no ray hits.
#[derive(Clone, Debug)]
#[repr(C, align(32))]
pub(crate) struct Block {
    /// Coordinates of the three vertices and the normal, by axis.
    pub rows: [[Lanes; 4]; 3],
    pub primitives: [u32; WIDTH],
    /// Bit i: triangle i is invisible from behind.
    pub culled: u32,
}

/// An analytic shape in the form that the kernels test.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Shape {
    pub quadric: Quadric,
    pub cull: Cull,
    pub primitive: u32,
}

impl Shape {
    /// Returns the crossings that count. `mirrored`: the shape is seen through a map of negative determinant, which swaps its
    /// sides.
    #[inline]
    pub fn crossings(&self, mirrored: bool) -> CrossingFilter {
        match (self.cull, (self.quadric.facing() == Facing::Outward) != mirrored) {
            (Cull::None, _) => CrossingFilter::All,
            (Cull::Back, true) => CrossingFilter::Entering,
            (Cull::Back, false) => CrossingFilter::Leaving,
        }
    }
}

/// A bottom-level tree: triangles and shapes in the frame of their group. It is immutable, and instances share it.
#[derive(Clone, Debug)]
pub struct Blas {
    pub(crate) tree: Tree,
    pub(crate) blocks: Vec<Block>,
    pub(crate) shapes: Vec<Shape>,
    /// Vertices by primitive index.
    pub(crate) triangles: Vec<[[f32; 3]; 3]>,
    /// Shapes by primitive index minus the number of triangles.
    pub(crate) quadrics: Vec<Quadric>,
}

impl Blas {
    /// Builds the tree. Primitive indices are positions in `triangles`, then `triangles.len()` + positions in `shapes`. Triangles
    /// without area and surfaces with non-finite coordinates keep their index and are never hit.
    #[expect(clippy::needless_pass_by_value, reason = "the function consumes its inputs; the signature shows it")]
    pub fn build(triangles: Vec<TriangleInput>, shapes: Vec<ShapeInput>) -> Self {
        let mut boxes = Vec::with_capacity(triangles.len() + shapes.len());
        let mut primitives = Vec::with_capacity(boxes.capacity());
        for (index, triangle) in triangles.iter().enumerate() {
            if unit_normal(&triangle.vertices).is_some() {
                boxes.push(Aabb::around(&triangle.vertices));
                primitives.push(index as u32);
            }
        }
        for (index, input) in shapes.iter().enumerate() {
            if input.shape.is_valid() {
                boxes.push(input.shape.bounds());
                primitives.push((triangles.len() + index) as u32);
            }
        }
        let mut leaves = LeafBuilder {
            triangles: &triangles,
            shape_inputs: &shapes,
            primitives: &primitives,
            blocks: Vec::new(),
            shapes: Vec::new(),
        };
        let tree = collapse(&boxes, &mut leaves);
        let (blocks, shape_leaves) = (leaves.blocks, leaves.shapes);
        Self {
            tree,
            blocks,
            shapes: shape_leaves,
            triangles: triangles.iter().map(|t| t.vertices.map(|v| v.to_array())).collect(),
            quadrics: shapes.iter().map(|s| s.shape).collect(),
        }
    }

    /// Returns the vertices of a triangle, group's frame, m; `None` for shapes.
    pub fn triangle(&self, primitive: u32) -> Option<[Vec3A; 3]> {
        self.triangles.get(primitive as usize).map(|t| t.map(Vec3A::from_array))
    }

    /// Returns an analytic shape, group's frame, m; `None` for triangles.
    pub fn quadric(&self, primitive: u32) -> Option<Quadric> {
        (primitive as usize).checked_sub(self.triangles.len()).and_then(|index| self.quadrics.get(index).copied())
    }

    /// Returns the bounds of all surfaces that can be hit, in the group's frame; empty if there are none.
    pub fn bounds(&self) -> Aabb {
        self.tree.bounds
    }

    /// Returns the number of primitives, including those that cannot be hit.
    pub fn primitive_count(&self) -> usize {
        self.triangles.len() + self.quadrics.len()
    }

    /// Returns the memory of the tree and the data that it references, bytes.
    pub fn memory(&self) -> usize {
        size_of_val(&*self.tree.nodes)
            + size_of_val(&*self.blocks)
            + size_of_val(&*self.shapes)
            + size_of_val(&*self.triangles)
            + size_of_val(&*self.quadrics)
    }
}

/// Returns the unit normal of the front, computed in f64; `None` without area or with non-finite coordinates.
fn unit_normal(vertices: &[Vec3A; 3]) -> Option<Vec3A> {
    let [a, b, c] = vertices.map(|v| v.as_dvec3());
    (b - a).cross(c - a).try_normalize().map(|n| n.as_vec3a()).filter(|_| vertices.iter().all(|v| v.is_finite()))
}

struct LeafBuilder<'a> {
    triangles: &'a [TriangleInput],
    shape_inputs: &'a [ShapeInput],
    /// Primitive index of each box of the tree.
    primitives: &'a [u32],
    blocks: Vec<Block>,
    shapes: Vec<Shape>,
}

impl LeafBuilder<'_> {
    fn is_triangle(&self, item: u32) -> bool {
        (self.primitives[item as usize] as usize) < self.triangles.len()
    }
}

impl LeafRule for LeafBuilder<'_> {
    fn may_share(&self, a: u32, b: u32) -> bool {
        self.is_triangle(a) && self.is_triangle(b)
    }

    fn max_primitives(&self, a: u32) -> usize {
        if self.is_triangle(a) { WIDTH } else { 1 }
    }

    fn cost(&self, a: u32, count: usize) -> f32 {
        // By measurement, a block takes about as long as a node, a shape about four times as long.
        if self.is_triangle(a) { 0.9 + 0.05 * count as f32 } else { 4.0 }
    }

    fn leaf(&mut self, items: &[u32]) -> Child {
        let first = self.primitives[items[0] as usize];
        if let Some(shape) = (first as usize).checked_sub(self.triangles.len()) {
            let input = &self.shape_inputs[shape];
            self.shapes.push(Shape { quadric: input.shape, cull: input.cull, primitive: first });
            return Child::second_kind(self.shapes.len() - 1);
        }
        let mut block = Block { rows: [[Lanes([f32::NAN; WIDTH]); 4]; 3], primitives: [u32::MAX; WIDTH], culled: 0 };
        for (lane, &item) in items.iter().enumerate() {
            let primitive = self.primitives[item as usize];
            let triangle = &self.triangles[primitive as usize];
            let [a, b, c] = triangle.vertices;
            let normal = unit_normal(&triangle.vertices).unwrap_or(Vec3A::ZERO);
            for (axis, rows) in block.rows.iter_mut().enumerate() {
                for (row, corner) in rows.iter_mut().zip([a, b, c, normal]) {
                    row.0[lane] = corner[axis];
                }
            }
            block.primitives[lane] = primitive;
            block.culled |= u32::from(triangle.cull == Cull::Back) << lane;
        }
        self.blocks.push(block);
        Child::first_kind(self.blocks.len() - 1)
    }

    fn clear(&mut self) {
        self.blocks.clear();
        self.shapes.clear();
    }
}
