//! The camera of a frame: rays from film positions.

use femc_geometry::Ray;
use femc_math::elementary::double;
use femc_math::glam::{DVec3, Vec3A};
use femc_math::warp;
use std::f64::consts::PI;

/// A thin-lens camera, or a pinhole when the lens radius is 0, in the prepared frame.
/// Its pose is interpolated over the shutter.
#[derive(Clone, Debug)]
pub struct KernelCamera {
    poses: Vec<CameraPose>,
    /// Film width and height, pixels.
    pub film: [u32; 2],
    lens_radius: f32,
    focus: f32,
}

/// Eye and axes at one time; `right` and `down` span the film at unit distance per pixel.
#[derive(Clone, Copy, Debug)]
pub struct CameraPose {
    origin: Vec3A,
    forward: Vec3A,
    right: Vec3A,
    down: Vec3A,
    /// Unit vectors of the lens plane.
    lens: [Vec3A; 2],
}

impl CameraPose {
    /// A pose from eye, looked-at point and up direction (prepared frame, f64), vertical field of view in degrees.
    /// `None` when the view direction or the up direction is degenerate.
    pub fn new(origin: DVec3, target: DVec3, up: DVec3, fov: f64, film: [u32; 2]) -> Option<Self> {
        let forward = (target - origin).try_normalize()?;
        let right = forward.cross(up).try_normalize()?;
        let down = forward.cross(right);
        let pixel = 2.0 * double::tan(fov * PI / 360.0) / f64::from(film[1]);
        let f32v = |v: DVec3| v.as_vec3a();
        Some(Self {
            origin: f32v(origin),
            forward: f32v(forward),
            right: f32v(right * pixel),
            down: f32v(down * pixel),
            lens: [f32v(right), f32v(down)],
        })
    }
}

impl KernelCamera {
    /// A camera whose poses are equally spaced over the shutter (one: it does not move).
    pub fn new(poses: Vec<CameraPose>, film: [u32; 2], lens_radius: f32, focus: f32) -> Self {
        debug_assert!(!poses.is_empty());
        Self { poses, film, lens_radius, focus }
    }

    fn pose(&self, time: f32) -> CameraPose {
        let n = self.poses.len() - 1;
        if n == 0 {
            return self.poses[0];
        }
        let x = time * n as f32;
        let i = (x as usize).min(n - 1);
        let (a, b, w) = (&self.poses[i], &self.poses[i + 1], x - i as f32);
        let mix = |p: Vec3A, q: Vec3A| p + (q - p) * w;
        CameraPose {
            origin: mix(a.origin, b.origin),
            forward: mix(a.forward, b.forward),
            right: mix(a.right, b.right),
            down: mix(a.down, b.down),
            lens: [mix(a.lens[0], b.lens[0]), mix(a.lens[1], b.lens[1])],
        }
    }

    /// The ray through film position (`x`, `y`), pixels, y down; `lens` in [0,1)^2; `time` in [0, 1] of the shutter.
    #[inline]
    pub fn ray(&self, x: f32, y: f32, lens: [f32; 2], time: f32) -> Ray {
        let pose = self.pose(time);
        let (cx, cy) = (x - 0.5 * self.film[0] as f32, y - 0.5 * self.film[1] as f32);
        let toward = pose.forward + pose.right * cx + pose.down * cy;
        let (mut origin, mut dir) = (pose.origin, toward);
        if self.lens_radius > 0.0 {
            let d = warp::disc(lens) * self.lens_radius;
            let shift = pose.lens[0] * d.x + pose.lens[1] * d.y;
            origin += shift;
            dir = toward * self.focus - shift;
        }
        Ray { origin, dir: dir.normalize(), t_max: f32::INFINITY, time }
    }

    /// Distance of `position` from the eye along the view axis at mid-shutter, m.
    pub fn depth(&self, position: Vec3A, time: f32) -> f32 {
        let pose = self.pose(time);
        (position - pose.origin).dot(pose.forward.normalize())
    }

    /// The eye at shutter opening.
    pub fn eye(&self) -> Vec3A {
        self.poses[0].origin
    }
}
