//! Triangles of curved surfaces.
//!
//! All shapes are surfaces of revolution. Their vertices form a grid: steps around the axis, and steps along the profile. The four
//! corners of a cell lie in one plane, because the chords of two circles about one axis over equal angles are parallel.
//!
//! The distance of the surface from the triangles has two parts. A chord of the profile deviates from its arc of radius r over the
//! angle a by at most r (1 - cos a/2). A chord around the axis deviates likewise, where r is the greatest distance from the axis.
//! [`Steps::deviation`] is the sum of both (test `surface_points_are_within_the_deviation`).

use femc_geometry::Quadric;
use femc_math::elementary::double::{acos, sin_cos};
use femc_math::glam::{DVec3, Vec3A};
use std::f64::consts::{PI, TAU};

/// Largest number of steps of a grid around the axis, and along the profile.
const MAX_STEPS: u32 = 256;
/// Smallest number of steps around a circle.
const MIN_STEPS: u32 = 8;

/// Numbers of steps of a grid on a curved surface.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Steps {
    /// Steps around the axis.
    pub around: u32,
    /// Steps along the profile.
    pub along: u32,
}

/// Radii of the arcs of a shape, m.
struct Arcs {
    /// Greatest distance from the axis.
    around: f64,
    /// Radius of the profile, and its angle; `None`: the profile is straight.
    along: Option<(f64, f64)>,
}

impl Arcs {
    fn new(shape: &Quadric) -> Self {
        match *shape {
            Quadric::Sphere { radius, .. } => Self { around: radius.into(), along: Some((radius.into(), PI)) },
            Quadric::Cone { start_radius, end_radius, .. } => {
                Self { around: start_radius.max(end_radius).into(), along: None }
            }
            Quadric::Ring { outer, .. } => Self { around: outer.into(), along: None },
            Quadric::Torus { major, minor, .. } => {
                Self { around: f64::from(major) + f64::from(minor), along: Some((minor.into(), TAU)) }
            }
        }
    }
}

/// Returns the number of equal steps over `angle` at which a chord deviates by at most `deviation` from an arc of `radius`.
fn steps_over(angle: f64, radius: f64, deviation: f64) -> u32 {
    let least = (f64::from(MIN_STEPS) * angle / TAU).ceil();
    let half = acos((1.0 - deviation / radius).clamp(-1.0, 1.0));
    // A deviation of 0 gives infinity.
    (angle / (2.0 * half)).ceil().clamp(least, f64::from(MAX_STEPS)) as u32
}

/// Returns the deviation of a chord from its arc.
fn chord_deviation(angle: f64, radius: f64, steps: u32) -> f64 {
    radius * (1.0 - sin_cos(0.5 * angle / f64::from(steps)).1)
}

impl Steps {
    /// Returns the steps for a deviation, m. Shapes that would need more than 256 steps deviate by more.
    pub fn for_deviation(shape: &Quadric, deviation: f64) -> Self {
        let arcs = Arcs::new(shape);
        match arcs.along {
            None => Self { around: steps_over(TAU, arcs.around, deviation), along: 1 },
            Some((radius, angle)) => Self {
                around: steps_over(TAU, arcs.around, 0.5 * deviation),
                along: steps_over(angle, radius, 0.5 * deviation),
            },
        }
    }

    /// Returns a bound of the distance of a surface point from the triangles, and of a point of the triangles from the surface, m.
    /// It includes the rounding of the vertices.
    pub fn deviation(self, shape: &Quadric) -> f64 {
        let arcs = Arcs::new(shape);
        let along = arcs.along.map_or(0.0, |(radius, angle)| chord_deviation(angle, radius, self.along));
        let bounds = shape.bounds();
        let largest = f64::from(bounds.min.abs().max(bounds.max.abs()).max_element());
        chord_deviation(TAU, arcs.around, self.around) + along + largest * f64::from(f32::EPSILON)
    }

    /// Returns the number of triangles of the grid.
    pub fn triangles(self, shape: &Quadric) -> u64 {
        // A tip removes one of the two triangles of each cell beside it.
        let tips = (0..self.along).map(|row| [row, row + 1].iter().filter(|row| self.is_tip(shape, **row)).count());
        u64::from(self.around) * (2 * u64::from(self.along) - tips.sum::<usize>() as u64)
    }

    /// Returns whether a row of the grid is one point.
    fn is_tip(self, shape: &Quadric, row: u32) -> bool {
        let (is_first, is_last) = (row == 0, row == self.along);
        match *shape {
            Quadric::Sphere { .. } => is_first || is_last,
            Quadric::Cone { start_radius, end_radius, .. } => {
                (is_first && start_radius == 0.0) || (is_last && end_radius == 0.0)
            }
            Quadric::Ring { inner, .. } => is_first && inner == 0.0,
            // The innermost circle.
            Quadric::Torus { major, minor, .. } => major == minor && 2 * row == self.along,
        }
    }
}

/// Triangles of a shape, in its frame. No two vertices are equal, except for shapes without thickness.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Tessellation {
    /// Vertices on the surface, m.
    pub positions: Vec<Vec3A>,
    /// Unit normals of the front at the vertices; the axis at the tip of a cone.
    pub normals: Vec<Vec3A>,
    /// Vertex numbers, counter-clockwise seen from the front.
    pub triangles: Vec<[u32; 3]>,
}

impl Tessellation {
    /// Creates the triangles of a valid shape.
    pub fn new(shape: &Quadric, steps: Steps) -> Self {
        let mut mesh = Self::default();
        let is_closed = matches!(shape, Quadric::Torus { .. });
        // The last row of a torus is its first.
        let rows = if is_closed { steps.along } else { steps.along + 1 };
        let mut first_vertices = Vec::new();
        for row in 0..rows {
            let is_tip = steps.is_tip(shape, row);
            first_vertices.push((mesh.positions.len() as u32, is_tip));
            let v = f64::from(row) / f64::from(steps.along);
            if is_tip {
                mesh.push_tip(shape, v);
                continue;
            }
            for column in 0..steps.around {
                let (position, normal) = shape.point_at([f64::from(column) / f64::from(steps.around), v]);
                mesh.positions.push(position.as_vec3a());
                mesh.normals.push(normal.as_vec3a());
            }
        }
        let is_turned = is_turned(shape, steps);
        let vertex = |row: u32, column: u32| {
            let (first, is_tip) = first_vertices[(row % rows) as usize];
            if is_tip { first } else { first + column % steps.around }
        };
        for row in 0..steps.along {
            for column in 0..steps.around {
                let [a, b] = [column, column + 1].map(|column| vertex(row, column));
                let [d, c] = [column, column + 1].map(|column| vertex(row + 1, column));
                for [p, q, r] in [[a, b, c], [a, c, d]] {
                    if p != q && q != r && r != p {
                        mesh.triangles.push(if is_turned { [p, r, q] } else { [p, q, r] });
                    }
                }
            }
        }
        mesh
    }

    /// Adds the one vertex of a row without radius. Its normal is the mean around the axis.
    fn push_tip(&mut self, shape: &Quadric, v: f64) {
        let (position, first) = shape.point_at([0.0, v]);
        let (_, second) = shape.point_at([0.5, v]);
        self.positions.push(position.as_vec3a());
        self.normals.push((first + second).try_normalize().unwrap_or(first).as_vec3a());
    }
}

/// Returns whether the front is on the other side of triangles that go around the axis first, then along the profile.
fn is_turned(shape: &Quadric, steps: Steps) -> bool {
    let [u, v] = [1.0 / f64::from(steps.around), 1.0 / f64::from(steps.along)];
    // A row in the middle of a sphere or a cone, or on the outer half of a torus.
    let row = match shape {
        Quadric::Torus { .. } => 0.0,
        _ => f64::from(steps.along / 2) * v,
    };
    let corner = |u: f64, v: f64| shape.point_at([u, v]).0;
    let (a, c) = (corner(0.0, row), corner(u, row + v));
    let (b, d) = (corner(u, row), corner(0.0, row + v));
    let facing: DVec3 = (c - a).cross(d - b);
    facing.dot(shape.point_at([0.5 * u, row + 0.5 * v]).1) < 0.0
}
