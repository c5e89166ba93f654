use femc_math::glam::Vec3A;
use femc_simd::{Lanes, WIDTH};

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

/// Several rays, one in each lane.
#[derive(Clone, Copy, Debug)]
pub struct RayLanes<'a> {
    /// Origins by axis, m, world frame.
    pub origin: &'a [Lanes; 3],
    /// Unit directions by axis, world frame.
    pub dir: &'a [Lanes; 3],
    /// Maximum distances, m, exclusive; may be infinite.
    pub t_max: &'a Lanes,
    /// Times in the shutter, 0 to 1.
    pub time: &'a Lanes,
}

impl RayLanes<'_> {
    /// Returns the ray of a lane.
    #[inline(always)]
    pub fn ray(&self, lane: usize) -> Ray {
        let vector =
            |axes: &[Lanes; 3]| Vec3A::new(axes[0].0[lane % WIDTH], axes[1].0[lane % WIDTH], axes[2].0[lane % WIDTH]);
        Ray {
            origin: vector(self.origin),
            dir: vector(self.dir),
            t_max: self.t_max.0[lane % WIDTH],
            time: self.time.0[lane % WIDTH],
        }
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
