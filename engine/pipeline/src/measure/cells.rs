//! Cells of nearly equal area on the surfaces of objects.

use femc_geometry::Quadric;
use femc_math::glam::{Affine3A, DVec3, Vec3A};
use femc_math::{cross, warp};
use femc_prepared::Prepared;
use femc_scene::objects::is_name_within;

/// A part of a surface.
#[derive(Clone, Debug)]
enum PieceShape {
    /// A triangle, group's frame, m; counterclockwise seen from the front.
    Triangle([Vec3A; 3]),
    /// A part of a curved surface, group's frame: a rectangle in the parameter `u` and in the share of the area below `v`.
    Curved { shape: Quadric, low: [f64; 2], high: [f64; 2] },
}

/// A piece of a cell.
#[derive(Clone, Debug)]
struct Piece {
    instance: u32,
    shape: PieceShape,
    /// Area in the world, m2.
    area: f64,
}

/// Part of the surfaces of an object, whose points have equal density.
#[derive(Clone, Debug)]
pub struct Cell {
    pieces: Vec<Piece>,
    area: f64,
}

/// A point of a cell in the prepared frame.
#[derive(Clone, Copy, Debug)]
pub(super) struct CellPoint {
    /// Position, m.
    pub position: Vec3A,
    /// Bound of the position's error by axis, m.
    pub error: Vec3A,
    /// Unit normal of the front side.
    pub normal: Vec3A,
}

/// Maximum number of halvings of a primitive.
const MAX_HALVINGS: u32 = 24;
/// Relative bound of the error of a position: a transformation of numbers with 24 bits.
const POSITION_ERROR: f32 = 1e-6;
/// Minimum area of a cell, relative to the requested area. Halves of too large pieces have at least this.
const FILLED: f64 = 0.5;

impl Piece {
    /// Returns the two halves of the piece, across its longest side.
    fn split(self) -> [Self; 2] {
        let Self { instance, area, .. } = self;
        let half = |shape| Self { instance, shape, area: 0.5 * area };
        match self.shape {
            PieceShape::Triangle(corners) => {
                let length = |side: usize| corners[side].distance_squared(corners[(side + 1) % 3]);
                let longest =
                    if length(0) >= length(1).max(length(2)) { 0 } else { 1 + usize::from(length(2) > length(1)) };
                let [a, b, c] = [0, 1, 2].map(|at| corners[(longest + at) % 3]);
                let middle = 0.5 * (a + b);
                [half(PieceShape::Triangle([a, middle, c])), half(PieceShape::Triangle([middle, b, c]))]
            }
            PieceShape::Curved { shape, low, high } => {
                let middle = [0, 1].map(|axis| 0.5 * (low[axis] + high[axis]));
                let at = |axis: usize, value: f64| {
                    let mut point = middle;
                    point[axis] = value;
                    curved_point(&shape, point).0
                };
                // The path over the middle: a piece that goes around is longer than the distance of its ends.
                let length = |axis: usize| {
                    let center = at(axis, middle[axis]);
                    at(axis, low[axis]).distance(center) + center.distance(at(axis, high[axis]))
                };
                let axis = usize::from(length(1) > length(0));
                let (mut end, mut begin) = (high, low);
                (end[axis], begin[axis]) = (middle[axis], middle[axis]);
                [
                    half(PieceShape::Curved { shape, low, high: end }),
                    half(PieceShape::Curved { shape, low: begin, high }),
                ]
            }
        }
    }

    /// Returns a point from two numbers in [0, 1), in the group's frame, and the direction of the front's normal there.
    fn point(&self, u: [f32; 2]) -> (Vec3A, Vec3A) {
        match &self.shape {
            PieceShape::Triangle([a, b, c]) => {
                let [to_b, to_c] = warp::triangle(u);
                let (ab, ac) = (*b - *a, *c - *a);
                (*a + ab * to_b + ac * to_c, cross(ab, ac))
            }
            PieceShape::Curved { shape, low, high } => {
                let at = [0, 1].map(|axis| low[axis] + (high[axis] - low[axis]) * f64::from(u[axis]));
                let (position, normal) = curved_point(shape, at);
                (position.as_vec3a(), normal.as_vec3a())
            }
        }
    }
}

/// Returns a point of a curved surface, and the normal of its front side.
fn curved_point(shape: &Quadric, [u, share]: [f64; 2]) -> (DVec3, DVec3) {
    shape.point_at([u, shape.parameter_at_share(share)])
}

impl Cell {
    /// Returns the area, m2.
    pub fn area(&self) -> f64 {
        self.area
    }

    /// Returns a point of even density from two numbers in [0, 1).
    /// - `time`: time of the shutter.
    pub(super) fn point(&self, scene: &Prepared, mut u: [f32; 2], time: f32) -> Option<CellPoint> {
        // The first number also chooses the piece.
        let mut left = f64::from(u[0]) * self.area;
        let last = self.pieces.last()?;
        let chosen = self.pieces.iter().find(|piece| {
            let is_here = left < piece.area;
            left -= if is_here { 0.0 } else { piece.area };
            is_here
        });
        let piece = chosen.unwrap_or(last);
        u[0] = ((left / piece.area) as f32).clamp(0.0, 1.0 - f32::EPSILON);
        let (local, normal) = piece.point(u);
        let pose = scene.world.pose_at(piece.instance, time);
        let position = pose.transform_point3a(local);
        let scale = position.abs().max_element().max(scale_of(&pose) * local.abs().max_element());
        let normal = pose.transform_vector3a(normal).normalize_or_zero();
        Some(CellPoint { position, error: Vec3A::splat(POSITION_ERROR * scale), normal })
    }
}

/// Returns the factor by which a pose scales lengths. Poses are similarities.
fn scale_of(pose: &Affine3A) -> f32 {
    pose.matrix3.x_axis.length()
}

/// Divides the surfaces of objects into cells of nearly equal area.
/// - `object`: name of an object, or of a parent of objects;
/// - `count`: number of cells. Pieces are halved until none is larger than a cell, and consecutive small pieces are united.
pub(super) fn divide(scene: &Prepared, object: &str, count: u32) -> Vec<Cell> {
    let whole = primitives(scene, object);
    let target = whole.iter().map(|piece| piece.area).sum::<f64>() / f64::from(count.max(1));
    let mut pieces = Vec::new();
    whole.into_iter().for_each(|piece| halve(piece, target, MAX_HALVINGS, &mut pieces));
    let mut cells = Vec::new();
    let mut cell = Cell { pieces: Vec::new(), area: 0.0 };
    for piece in pieces {
        cell.area += piece.area;
        cell.pieces.push(piece);
        if cell.area >= FILLED * target {
            cells.push(std::mem::replace(&mut cell, Cell { pieces: Vec::new(), area: 0.0 }));
        }
    }
    match cells.last_mut() {
        _ if cell.pieces.is_empty() => {}
        Some(last) => {
            last.area += cell.area;
            last.pieces.extend(cell.pieces);
        }
        None => cells.push(cell),
    }
    cells
}

/// Halves a piece until no part is larger than `target`, in order.
fn halve(piece: Piece, target: f64, halvings: u32, out: &mut Vec<Piece>) {
    // Halves of equal areas differ by rounding.
    if halvings == 0 || piece.area <= target * (1.0 + 1e-6) {
        out.push(piece);
        return;
    }
    piece.split().into_iter().for_each(|half| halve(half, target, halvings - 1, out));
}

/// Returns the primitives of the objects of a name, in order.
fn primitives(scene: &Prepared, object: &str) -> Vec<Piece> {
    let mut pieces = Vec::new();
    for (instance, group) in (0..).zip(scene.instances.iter()) {
        let scale = f64::from(scale_of(&scene.world.pose_at(instance, 0.0)));
        let blas = &group.compiled.blas;
        for primitive in 0..group.compiled.primitives.len() as u32 {
            if !is_name_within(scene.object_name(scene.object_of(instance, primitive)), object) {
                continue;
            }
            let (shape, area) = match (blas.triangle(primitive), blas.quadric(primitive)) {
                (Some(corners), _) => {
                    let [a, b, c] = corners.map(|corner| corner.as_dvec3());
                    (PieceShape::Triangle(corners), 0.5 * (b - a).cross(c - a).length())
                }
                (None, Some(shape)) => (PieceShape::Curved { shape, low: [0.0; 2], high: [1.0; 2] }, shape.area()),
                (None, None) => continue,
            };
            let area = area * scale * scale;
            if area > 0.0 {
                pieces.push(Piece { instance, shape, area });
            }
        }
    }
    pieces
}
