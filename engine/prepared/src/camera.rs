//! Camera of a frame: generates rays from film positions.

use femc_geometry::Ray;
use femc_math::elementary::double;
use femc_math::glam::{DVec3, Vec3A};
use femc_math::{cross, warp};
use std::f64::consts::PI;

/// A thin-lens camera, or a pinhole when the lens radius is 0, in the prepared frame. Its pose is interpolated over the shutter.
#[derive(Clone, Debug)]
pub struct KernelCamera {
    poses: Vec<CameraPose>,
    /// Film width and height, pixels.
    pub film: [u32; 2],
    lens_radius: f32,
    focus: f32,
}

/// Eye and axes at one time. `right` and `down` span one pixel of the film at unit distance.
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
    /// Creates a pose from eye, target and up direction (prepared frame, f64) and the vertical field of view in degrees. Returns
    /// `None` if the view direction or the up direction is degenerate.
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

/// View of the film through one point of the lens at one time.
#[derive(Clone, Copy, Debug)]
pub struct View {
    /// Point of the lens.
    pub origin: Vec3A,
    /// Vector to the middle of the film's image, not unit.
    pub toward: Vec3A,
    /// Steps of one pixel to the right and one down on the film's image.
    pub steps: [Vec3A; 2],
    /// Middle of the film, pixels.
    pub middle: [f32; 2],
    time: f32,
}

impl View {
    /// Returns the direction through film position (`x`, `y`), pixels, y down; not unit.
    #[inline]
    fn film_direction(&self, [x, y]: [f32; 2]) -> Vec3A {
        self.toward + self.steps[0] * (x - self.middle[0]) + self.steps[1] * (y - self.middle[1])
    }

    /// Returns the ray through a film position, pixels, y down.
    #[inline]
    pub fn ray(&self, film_position: [f32; 2]) -> Ray {
        Ray {
            origin: self.origin,
            dir: self.film_direction(film_position).normalize(),
            t_max: f32::INFINITY,
            time: self.time,
        }
    }

    /// Projects a point onto the plane of the film, possibly outside the film. Also returns its distance along the view axis,
    /// relative to that of the film's image. Returns `None` behind the lens.
    #[inline]
    pub fn project(&self, position: Vec3A) -> Option<([f32; 2], f32)> {
        let normal = cross(self.steps[0], self.steps[1]);
        let away = position - self.origin;
        let depth = normal.dot(away) / normal.dot(self.toward);
        if depth <= 0.0 || !depth.is_finite() {
            return None;
        }
        let beside = away / depth - self.toward;
        // The steps are perpendicular. Between two poses of a rotating camera they are only nearly so: solve for both.
        let [a, b] = self.steps;
        let (aa, ab, bb) = (a.dot(a), a.dot(b), b.dot(b));
        let (pa, pb) = (beside.dot(a), beside.dot(b));
        let scale = 1.0 / (aa * bb - ab * ab);
        let place = [(pa * bb - pb * ab) * scale + self.middle[0], (pb * aa - pa * ab) * scale + self.middle[1]];
        Some((place, depth))
    }

    /// Returns the solid angle of a pixel's area at a film position, sr.
    #[inline]
    pub fn solid_angle(&self, film_position: [f32; 2]) -> f32 {
        let through = self.film_direction(film_position);
        let distance2 = through.length_squared();
        through.dot(cross(self.steps[0], self.steps[1])).abs() / (distance2 * distance2.sqrt())
    }
}

impl KernelCamera {
    /// Creates a camera whose poses are equally spaced over the shutter. A camera with one pose does not move.
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

    /// Returns the center of a pixel (row-major index), pixels.
    #[inline]
    pub fn center(&self, pixel: u32) -> [f32; 2] {
        [(pixel % self.film[0]) as f32 + 0.5, (pixel / self.film[0]) as f32 + 0.5]
    }

    /// Returns the view through one point of the lens: `lens` in [0,1)^2; `time` in [0, 1] of the shutter.
    #[inline]
    pub fn view(&self, lens: [f32; 2], time: f32) -> View {
        let pose = self.pose(time);
        let mut view = View {
            origin: pose.origin,
            toward: pose.forward,
            steps: [pose.right, pose.down],
            middle: self.film.map(|size| 0.5 * size as f32),
            time,
        };
        if self.has_lens() {
            let d = warp::disc(lens) * self.lens_radius;
            let shift = pose.lens[0] * d.x + pose.lens[1] * d.y;
            view.origin += shift;
            view.toward = pose.forward * self.focus - shift;
            view.steps = view.steps.map(|step| step * self.focus);
        }
        view
    }

    /// Checks whether the views depend on the time in the shutter.
    #[inline]
    pub fn moves(&self) -> bool {
        self.poses.len() > 1
    }

    /// Checks whether the views depend on the position on the lens.
    #[inline]
    pub fn has_lens(&self) -> bool {
        self.lens_radius > 0.0
    }

    /// Iterates over the views through the middle of the lens at all poses.
    pub(crate) fn views(&self) -> impl Iterator<Item = View> + '_ {
        let last = (self.poses.len() - 1).max(1) as f32;
        let pinhole = Self { lens_radius: 0.0, ..self.clone() };
        (0..self.poses.len()).map(move |k| pinhole.view([0.5; 2], k as f32 / last))
    }

    /// Returns the view if the camera does not move and is a pinhole.
    pub fn pinhole(&self) -> Option<View> {
        (self.poses.len() == 1 && self.lens_radius == 0.0).then(|| self.view([0.5; 2], 0.0))
    }

    /// Returns the radius of the blur spot, in pixels, of a point at `distance` along the view axis, m.
    pub(crate) fn blur(&self, distance: f32) -> f32 {
        if self.lens_radius > 0.0 {
            self.lens_radius * (1.0 / self.focus - 1.0 / distance).abs() / self.poses[0].right.length()
        } else {
            0.0
        }
    }

    /// Returns the distance of `position` from the eye along the view axis at mid-shutter, m.
    pub fn depth(&self, position: Vec3A, time: f32) -> f32 {
        let pose = self.pose(time);
        (position - pose.origin).dot(pose.forward.normalize())
    }

    /// Returns the eye at shutter opening.
    pub fn eye(&self) -> Vec3A {
        self.poses[0].origin
    }
}
