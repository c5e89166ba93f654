//! A slow reference tracer: the hits of a ray on a light's surface, with front normals.

use super::Face;
use femc_math::glam::{DVec3, Vec3A};

/// A piece of surface, with the conventions of the constructors of the lights.
#[derive(Clone, Debug)]
pub enum Patch {
    Triangle([Vec3A; 3]),
    Sphere { center: Vec3A, radius: f32 },
    Cone { base: Vec3A, top: Vec3A, radii: [f32; 2] },
    Ring { center: Vec3A, normal: Vec3A, radii: [f32; 2] },
    Torus { center: Vec3A, axis: Vec3A, radii: [f32; 2] },
}

/// A crossing: distance and front normal.
pub type Crossing = (f64, DVec3);

impl Patch {
    pub fn parallelogram(origin: Vec3A, u: Vec3A, v: Vec3A) -> Vec<Self> {
        let opposite = origin + u + v;
        vec![Self::Triangle([origin, origin + u, origin + v]), Self::Triangle([opposite, origin + v, origin + u])]
    }

    pub fn from_face(face: &Face) -> Vec<Self> {
        match *face {
            Face::Parallelogram { origin, edge_u, edge_v } => Self::parallelogram(origin, edge_u, edge_v),
            Face::Cylinder { base, top, radius } => vec![Self::Cone { base, top, radii: [radius; 2] }],
            Face::Disc { center, normal, radius } => vec![Self::Ring { center, normal, radii: [0.0, radius] }],
            Face::Sphere { center, radius } => vec![Self::Sphere { center, radius }],
        }
    }

    /// Returns all crossings of the line `origin + t dir`, t > 0, in no order.
    pub fn crossings(&self, origin: DVec3, dir: DVec3) -> Vec<Crossing> {
        let mut hits = match self {
            Self::Triangle(vertices) => triangle(origin, dir, vertices.map(|p| p.as_dvec3())),
            Self::Sphere { center, radius } => sphere(origin - center.as_dvec3(), dir, f64::from(*radius)),
            Self::Cone { base, top, radii } => {
                cone(origin - base.as_dvec3(), dir, top.as_dvec3() - base.as_dvec3(), radii.map(f64::from))
            }
            Self::Ring { center, normal, radii } => {
                let n = normal.as_dvec3();
                let t = (center.as_dvec3() - origin).dot(n) / dir.dot(n);
                let r = (origin + dir * t).distance(center.as_dvec3());
                let [inner, outer] = radii.map(f64::from);
                if inner <= r && r <= outer { vec![(t, n)] } else { vec![] }
            }
            Self::Torus { center, axis, radii } => {
                torus(origin - center.as_dvec3(), dir, axis.as_dvec3(), radii.map(f64::from))
            }
        };
        hits.retain(|h| h.0 > 1e-9);
        hits
    }
}

/// Returns the crossings of all patches, nearest first.
pub fn crossings(patches: &[Patch], origin: DVec3, dir: DVec3) -> Vec<Crossing> {
    let mut hits: Vec<Crossing> = patches.iter().flat_map(|p| p.crossings(origin, dir)).collect();
    hits.sort_by(|a, b| a.0.total_cmp(&b.0));
    hits
}

fn triangle(origin: DVec3, dir: DVec3, [a, b, c]: [DVec3; 3]) -> Vec<Crossing> {
    let n = (b - a).cross(c - a);
    let t = (a - origin).dot(n) / dir.dot(n);
    let p = origin + dir * t;
    let inside = |a: DVec3, b: DVec3| (b - a).cross(p - a).dot(n) >= 0.0;
    if inside(a, b) && inside(b, c) && inside(c, a) { vec![(t, n.normalize())] } else { vec![] }
}

/// Returns the roots of a t^2 + 2 b t + c.
fn roots(a: f64, b: f64, c: f64) -> Vec<f64> {
    let d = b * b - a * c;
    if d < 0.0 { vec![] } else { vec![(-b - d.sqrt()) / a, (-b + d.sqrt()) / a] }
}

fn sphere(o: DVec3, dir: DVec3, radius: f64) -> Vec<Crossing> {
    roots(1.0, o.dot(dir), o.length_squared() - radius * radius)
        .into_iter()
        .map(|t| (t, (o + dir * t) / radius))
        .collect()
}

fn cone(o: DVec3, dir: DVec3, along: DVec3, [r0, r1]: [f64; 2]) -> Vec<Crossing> {
    let (height, axis) = (along.length(), along.normalize());
    let (facing, r0, r1) = (if r0 + r1 < 0.0 { -1.0 } else { 1.0 }, r0.abs(), r1.abs());
    let slope = (r1 - r0) / height;
    let (oz, dz) = (o.dot(axis), dir.dot(axis));
    let (op, dp) = (o - axis * oz, dir - axis * dz);
    let (ro, rd) = (r0 + slope * oz, slope * dz);
    roots(dp.length_squared() - rd * rd, op.dot(dp) - ro * rd, op.length_squared() - ro * ro)
        .into_iter()
        .filter(|t| (0.0..=height).contains(&(oz + dz * t)))
        .map(|t| (t, ((op + dp * t).normalize() - axis * slope).normalize() * facing))
        .collect()
}

/// Intersects a torus by marching in steps of 1/60 m near the center and bisecting; slivers thinner than a step are missed.
fn torus(o: DVec3, dir: DVec3, axis: DVec3, [inner, outer]: [f64; 2]) -> Vec<Crossing> {
    let (major, minor) = (0.5 * (inner + outer), 0.5 * (outer - inner));
    let ring = |p: DVec3| p - axis * p.dot(axis);
    let value = |t: f64| {
        let p = o + dir * t;
        let (r, z) = (ring(p).length() - major, p.dot(axis));
        r * r + z * z - minor * minor
    };
    let start = -o.dot(dir) - outer;
    let nodes: Vec<(f64, f64)> =
        (0..=120).map(|i| start + outer * f64::from(i) / 60.0).map(|t| (t, value(t))).collect();
    let mut hits = Vec::new();
    for w in nodes.windows(2).filter(|w| w[0].1 * w[1].1 <= 0.0) {
        let (mut a, mut b) = (w[0].0, w[1].0);
        for _ in 0..40 {
            let m = 0.5 * (a + b);
            if w[0].1 * value(m) <= 0.0 { b = m } else { a = m }
        }
        let p = o + dir * a;
        hits.push((a, (p - ring(p).normalize() * major).normalize()));
    }
    hits
}
