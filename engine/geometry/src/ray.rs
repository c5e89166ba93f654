use femc_math::glam::Vec3A;

/// A ray; hits have `t` in (0, `t_max`).
#[derive(Clone, Copy, Debug)]
pub struct Ray {
    /// Origin, m, world frame.
    pub origin: Vec3A,
    /// Unit direction, world frame.
    pub dir: Vec3A,
    /// Maximum distance, m, exclusive; may be infinite.
    pub t_max: f32,
    /// Time in the shutter, 0 to 1.
    pub time: f32,
}

impl Ray {
    /// Creates an infinite ray at shutter time 0.
    pub fn new(origin: Vec3A, dir: Vec3A) -> Self {
        Self { origin, dir, t_max: f32::INFINITY, time: 0.0 }
    }

    /// Returns the point at distance `t`, m.
    pub fn at(&self, t: f32) -> Vec3A {
        self.origin + self.dir * t
    }
}

/// First hit of a ray on a surface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Hit {
    /// Distance, m.
    pub t: f32,
    /// Index of the instance in the world's input.
    pub instance: u32,
    /// Index of the primitive in its [`Blas`](crate::Blas): triangles first, then shapes.
    pub primitive: u32,
    /// Weight of the triangle's second vertex; for shapes the angle about the axis / 2 pi (see [`Quadric`](crate::Quadric)).
    pub u: f32,
    /// Weight of the triangle's third vertex; for shapes the second parameter.
    pub v: f32,
}
