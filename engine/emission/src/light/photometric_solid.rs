//! A convex luminous opening with a measured intensity distribution.
//!
//! Every point of the surface has the radiance `L(w) = I(w) / A(w)` toward `w`, where A is the area of the body projected along w.
//! Therefore the intensity from afar is exactly I for every direction, and neighboring faces match in brightness. Flat openings get
//! a thickness of 1 % of their largest extent, but at least 1 mm. If I does not vanish in the plane of the opening, light must
//! leave through a side.

use super::{LightSample, area_pdf, assemble_sample};
use crate::photometry::IntensityDistribution;
use crate::solid_angle::{MIN_SOLID_ANGLE, SphericalRectangle};
use femc_math::Rgb;
use femc_math::color::luminance;
use femc_math::elementary::double::sin_cos;
use femc_math::glam::{DVec3, Vec3A};
use std::f64::consts::{PI, TAU};
use std::sync::Arc;

/// Thickness of a flat opening relative to its largest extent.
const RELATIVE_THICKNESS: f32 = 0.01;
/// Minimum thickness, m.
const MIN_THICKNESS: f32 = 1e-3;

/// Shape of the opening, in the luminaire's frame, centered on the origin.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Solid {
    /// Half extents along x, y and z, m, > 0.
    Box {
        /// Half extents.
        half: [f32; 3],
    },
    /// A cylinder about the z axis.
    Cylinder {
        /// Radius, m, > 0.
        radius: f32,
        /// Half of the height, m, > 0.
        half_height: f32,
    },
    /// A ball.
    Sphere {
        /// Radius, m, > 0.
        radius: f32,
    },
}

impl Solid {
    /// Creates a box with these full extents, m; zero extents are thickened.
    pub fn cuboid(x: f32, y: f32, z: f32) -> Self {
        let least = thickness(x.max(y).max(z));
        Self::Box { half: [x, y, z].map(|e| 0.5 * e.max(least)) }
    }

    /// Creates a cylinder of this diameter and height, m; a zero height is thickened.
    pub fn cylinder(diameter: f32, height: f32) -> Self {
        let least = thickness(diameter.max(height));
        Self::Cylinder { radius: 0.5 * diameter.max(least), half_height: 0.5 * height.max(least) }
    }

    /// Creates a ball of this diameter, m.
    pub fn sphere(diameter: f32) -> Self {
        Self::Sphere { radius: 0.5 * diameter.max(MIN_THICKNESS) }
    }

    /// Returns the area projected along the unit direction `w` of the luminaire's frame, m2; > 0.
    #[inline]
    pub fn projected_area(&self, w: Vec3A) -> f32 {
        match *self {
            Self::Box { half: [x, y, z] } => 4.0 * (y * z * w.x.abs() + x * z * w.y.abs() + x * y * w.z.abs()),
            Self::Cylinder { radius, half_height } => {
                let across = (w.x * w.x + w.y * w.y).sqrt();
                radius * (std::f32::consts::PI * radius * w.z.abs() + 4.0 * half_height * across)
            }
            Self::Sphere { radius } => std::f32::consts::PI * radius * radius,
        }
    }
}

fn thickness(extent: f32) -> f32 {
    (RELATIVE_THICKNESS * extent).max(MIN_THICKNESS)
}

/// A part of the opening's surface in the common frame, for the ray tracer; normals point outward, emission is one-sided.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Face {
    /// A parallelogram with front side `edge_u x edge_v`, whatever the handedness of the luminaire's axes.
    Parallelogram {
        /// A corner, m.
        origin: Vec3A,
        /// Edge from it, m.
        edge_u: Vec3A,
        /// Other edge, m.
        edge_v: Vec3A,
    },
    /// Open cylinder, outward normals.
    Cylinder {
        /// Center of one end, m.
        base: Vec3A,
        /// Center of the other end, m.
        top: Vec3A,
        /// Radius, m.
        radius: f32,
    },
    /// A disc.
    Disc {
        /// Center, m.
        center: Vec3A,
        /// Normal, unit.
        normal: Vec3A,
        /// Radius, m.
        radius: f32,
    },
    /// A sphere, outward normals.
    Sphere {
        /// Center, m.
        center: Vec3A,
        /// Radius, m.
        radius: f32,
    },
}

/// A luminaire with a luminous opening.
#[derive(Clone, Debug, PartialEq)]
pub struct PhotometricSolid {
    /// Center of the opening, m.
    pub center: Vec3A,
    /// The luminaire's x, y and z axes, unit and perpendicular; left-handed after a mirroring transform.
    pub axes: [Vec3A; 3],
    /// Shape of the opening, m.
    pub solid: Solid,
    /// Intensity by direction.
    pub distribution: Arc<IntensityDistribution>,
    /// Color and multiplier of the intensity; luminance 1 keeps the candela of the file.
    pub tint: Rgb,
}

/// A sampled point of the surface: position and outward normal relative to the center, in luminaire axes.
struct SurfaceSample {
    position: DVec3,
    normal: DVec3,
    /// Density over solid angle, or over area.
    density: Density,
    uv: [f64; 2],
}

enum Density {
    SolidAngle(f64),
    Area(f64),
}

/// One face of a box as seen from a reference point, in luminaire axes.
#[derive(Clone, Copy)]
struct BoxFace {
    axis: usize,
    sign: f64,
    view: SphericalRectangle,
    /// Area times the reference's distance in front of the face: proportional to the projected area over d^3.
    facing: f64,
}

impl PhotometricSolid {
    fn local(&self, v: DVec3) -> DVec3 {
        let [x, y, z] = self.axes.map(|a| a.as_dvec3());
        DVec3::new(v.dot(x), v.dot(y), v.dot(z))
    }

    fn world(&self, v: DVec3) -> DVec3 {
        let [x, y, z] = self.axes.map(|a| a.as_dvec3());
        x * v.x + y * v.y + z * v.z
    }

    /// Returns the luminous intensity of the whole light, cd, in the direction `dir` (unit, common frame, away from the light).
    #[inline]
    pub fn intensity(&self, dir: Vec3A) -> Rgb {
        let local = Vec3A::new(dir.dot(self.axes[0]), dir.dot(self.axes[1]), dir.dot(self.axes[2]));
        self.tint * self.distribution.intensity(local)
    }

    /// Returns the radiance, cd/m2, toward `dir` (unit, common frame, away from the light) from a point with outward normal
    /// `normal`.
    #[inline]
    pub fn radiance(&self, dir: Vec3A, normal: Vec3A) -> Rgb {
        if dir.dot(normal) <= 0.0 {
            return Rgb::ZERO;
        }
        let w = Vec3A::new(dir.dot(self.axes[0]), dir.dot(self.axes[1]), dir.dot(self.axes[2]));
        self.tint * (self.distribution.intensity(w) / self.solid.projected_area(w))
    }

    /// Returns the faces of a box that face `p` (relative to the center, luminaire axes).
    fn visible_faces(half: [f32; 3], p: DVec3) -> ([Option<BoxFace>; 3], f64, f64) {
        let half = half.map(f64::from);
        let units = [DVec3::X, DVec3::Y, DVec3::Z];
        let (mut sides, mut solid_angle, mut facing) = ([None; 3], 0.0, 0.0);
        for axis in 0..3 {
            let sign = if p[axis] < 0.0 { -1.0 } else { 1.0 };
            let before = p[axis].abs() - half[axis];
            if before <= 0.0 {
                continue;
            }
            let (a, b) = ((axis + 1) % 3, (axis + 2) % 3);
            let corner = units[axis] * (sign * half[axis]) - units[a] * half[a] - units[b] * half[b] - p;
            let size = [2.0 * half[a], 2.0 * half[b]];
            let view = SphericalRectangle::new(corner, units[a], units[b], units[axis], size);
            let side = BoxFace { axis, sign, view, facing: size[0] * size[1] * before };
            solid_angle += view.solid_angle();
            facing += side.facing;
            sides[axis] = Some(side);
        }
        (sides, solid_angle, facing)
    }

    fn sample_box(half: [f32; 3], p: DVec3, u: [f32; 2]) -> Option<SurfaceSample> {
        let (sides, solid_angle, facing) = Self::visible_faces(half, p);
        let narrow = solid_angle < MIN_SOLID_ANGLE;
        let total = if narrow { facing } else { solid_angle };
        let weight = |s: &BoxFace| if narrow { s.facing } else { s.view.solid_angle() };
        let mut goal = f64::from(u[0]) * total;
        let mut chosen = None;
        for side in sides.iter().flatten().filter(|s| weight(s) > 0.0) {
            let fraction = goal / weight(side);
            chosen = Some((side, fraction.min(1.0)));
            if fraction < 1.0 {
                break;
            }
            goal -= weight(side);
        }
        let (side, fraction) = chosen?;
        let u = [fraction as f32, u[1]];
        let uv = if narrow { u.map(f64::from) } else { side.view.sample(u) };
        let mut position = DVec3::ZERO;
        let mut normal = DVec3::ZERO;
        let (a, b) = ((side.axis + 1) % 3, (side.axis + 2) % 3);
        let extent = |axis: usize| f64::from(half[axis]);
        position[side.axis] = side.sign * extent(side.axis);
        position[a] = (2.0 * uv[0] - 1.0) * extent(a);
        position[b] = (2.0 * uv[1] - 1.0) * extent(b);
        normal[side.axis] = side.sign;
        let density = Self::box_density(half, side, solid_angle, facing);
        Some(SurfaceSample { position, normal, density, uv })
    }

    fn box_density(half: [f32; 3], side: &BoxFace, solid_angle: f64, facing: f64) -> Density {
        if solid_angle >= MIN_SOLID_ANGLE {
            return Density::SolidAngle(1.0 / solid_angle);
        }
        let (a, b) = ((side.axis + 1) % 3, (side.axis + 2) % 3);
        let area = 4.0 * f64::from(half[a]) * f64::from(half[b]);
        Density::Area(side.facing / facing / area)
    }

    /// Returns the lateral area and the area of the cap that faces `p` (0 if none), with the cap's side.
    fn cylinder_areas(radius: f32, half_height: f32, p: DVec3) -> (f64, f64, f64) {
        let (r, h) = (f64::from(radius), f64::from(half_height));
        let lateral = if p.x * p.x + p.y * p.y > r * r { 2.0 * TAU * r * h } else { 0.0 };
        let cap = if p.z.abs() > h { PI * r * r } else { 0.0 };
        (lateral, cap, if p.z < 0.0 { -1.0 } else { 1.0 })
    }

    fn sample_cylinder(radius: f32, half_height: f32, p: DVec3, u: [f32; 2]) -> Option<SurfaceSample> {
        let (lateral, cap, side) = Self::cylinder_areas(radius, half_height, p);
        let (r, h) = (f64::from(radius), f64::from(half_height));
        let total = lateral + cap;
        let goal = f64::from(u[0]) * total;
        let (sin, cos) = sin_cos(TAU * f64::from(u[1]));
        let density = Density::Area(1.0 / total);
        if total <= 0.0 {
            None
        } else if goal < lateral {
            let t = goal / lateral;
            let position = DVec3::new(r * cos, r * sin, (2.0 * t - 1.0) * h);
            Some(SurfaceSample { position, normal: DVec3::new(cos, sin, 0.0), density, uv: [f64::from(u[1]), t] })
        } else {
            let t = ((goal - lateral) / cap).clamp(0.0, 1.0).sqrt();
            let position = DVec3::new(r * t * cos, r * t * sin, side * h);
            Some(SurfaceSample { position, normal: DVec3::Z * side, density, uv: [f64::from(u[1]), t] })
        }
    }

    /// See [`super::Light::sample`].
    pub fn sample(&self, reference: Vec3A, u: [f32; 2]) -> Option<LightSample> {
        let origin = reference.as_dvec3();
        let center = self.center.as_dvec3();
        let p = self.local(origin - center);
        let sample = match self.solid {
            Solid::Box { half } => Self::sample_box(half, p, u)?,
            Solid::Cylinder { radius, half_height } => Self::sample_cylinder(radius, half_height, p, u)?,
            Solid::Sphere { radius } => {
                let view = super::sphere::OutsideView::new(f64::from(radius), -p)?;
                let outward = view.sample(u);
                SurfaceSample {
                    position: outward * f64::from(radius),
                    normal: outward,
                    density: Density::SolidAngle(view.density()),
                    uv: [f64::from(u[1]), 0.5 * (outward.z + 1.0)],
                }
            }
        };
        let normal = self.world(sample.normal);
        assemble_sample(
            origin,
            center + self.world(sample.position),
            normal,
            self.center.abs() + Vec3A::splat(sample.position.length() as f32),
            |dir, distance| solid_angle_pdf(&sample.density, distance * distance, dir.dot(normal)),
            |dir, _| self.radiance(-dir.as_vec3a(), normal.as_vec3a()),
            sample.uv,
        )
    }

    /// See [`super::Light::pdf`].
    pub fn pdf(&self, reference: Vec3A, position: Vec3A, normal: Vec3A, dir: Vec3A) -> f32 {
        if dir.dot(normal) >= 0.0 {
            return 0.0;
        }
        let p = self.local(reference.as_dvec3() - self.center.as_dvec3());
        let d = match self.solid {
            Solid::Box { half } => {
                let (sides, solid_angle, facing) = Self::visible_faces(half, p);
                let n = self.local(normal.as_dvec3()).abs();
                let axis = if n.x > n.y.max(n.z) { 0 } else { 1 + usize::from(n.z > n.y) };
                match &sides[axis] {
                    Some(side) => Self::box_density(half, side, solid_angle, facing),
                    None => return 0.0,
                }
            }
            Solid::Cylinder { radius, half_height } => {
                let (lateral, cap, _) = Self::cylinder_areas(radius, half_height, p);
                Density::Area(1.0 / (lateral + cap))
            }
            Solid::Sphere { radius } => match super::sphere::OutsideView::new(f64::from(radius), -p) {
                Some(view) => Density::SolidAngle(view.density()),
                None => return 0.0,
            },
        };
        let distance2 = position.as_dvec3().distance_squared(reference.as_dvec3());
        solid_angle_pdf(&d, distance2, f64::from(dir.dot(normal)))
    }

    /// Luminous flux, lm.
    pub fn power(&self) -> f32 {
        luminance(self.tint) * self.distribution.flux() as f32
    }

    /// Half extents in luminaire axes.
    fn half_extents(&self) -> [f32; 3] {
        match self.solid {
            Solid::Box { half } => half,
            Solid::Cylinder { radius, half_height } => [radius, radius, half_height],
            Solid::Sphere { radius } => [radius; 3],
        }
    }

    /// Bounding box.
    pub fn bounds(&self) -> (Vec3A, Vec3A) {
        let [x, y, z] = self.half_extents();
        let extent = match self.solid {
            Solid::Sphere { radius } => Vec3A::splat(radius),
            Solid::Box { .. } | Solid::Cylinder { .. } => {
                self.axes[0].abs() * x + self.axes[1].abs() * y + self.axes[2].abs() * z
            }
        };
        (self.center - extent, self.center + extent)
    }

    /// Returns the surface of the opening in the common frame, with outward normals, for the ray tracer: rays can hit this light.
    pub fn faces(&self) -> Vec<Face> {
        let [x, y, z] = self.axes;
        match self.solid {
            Solid::Sphere { radius } => vec![Face::Sphere { center: self.center, radius }],
            Solid::Cylinder { radius, half_height } => {
                let (top, base) = (self.center + z * half_height, self.center - z * half_height);
                vec![
                    Face::Cylinder { base, top, radius },
                    Face::Disc { center: top, normal: z, radius },
                    Face::Disc { center: base, normal: -z, radius },
                ]
            }
            Solid::Box { half } => {
                let edges = [x * (2.0 * half[0]), y * (2.0 * half[1]), z * (2.0 * half[2])];
                let corner = self.center - 0.5 * (edges[0] + edges[1] + edges[2]);
                let face = |axis: usize, far: bool| {
                    let (u, v) = (edges[(axis + 1) % 3], edges[(axis + 2) % 3]);
                    let outward = if far { edges[axis] } else { -edges[axis] };
                    let origin = if far { corner + edges[axis] } else { corner };
                    let right = femc_math::cross(u, v).dot(outward) > 0.0;
                    let (edge_u, edge_v) = if right { (u, v) } else { (v, u) };
                    Face::Parallelogram { origin, edge_u, edge_v }
                };
                (0..3).flat_map(|axis| [face(axis, false), face(axis, true)]).collect()
            }
        }
    }
}

fn solid_angle_pdf(density: &Density, distance2: f64, cos: f64) -> f32 {
    match *density {
        Density::SolidAngle(pdf) => pdf as f32,
        Density::Area(per_area) => area_pdf(1.0 / per_area, distance2, cos),
    }
}
