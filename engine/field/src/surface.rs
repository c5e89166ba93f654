use femc_geometry::Quadric;
use femc_math::glam::{Affine3A, DVec3, Vec2, Vec3A};
use femc_math::{cross, gamma};

/// A side of a surface.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Side {
    /// Side of the geometric normal.
    Front,
    /// Opposite side.
    Back,
}

/// Shape of a surface, prepared frame, m.
#[derive(Clone, Debug)]
pub enum Form {
    /// A corner and two edges; parameters a, b >= 0 with a + b <= 1.
    Triangle([Vec3A; 3]),
    /// A corner and two edges; parameters in [0, 1].
    Parallelogram([Vec3A; 3]),
    /// A curved shape and its pose; parameters in [0, 1]: the angle around the axis / 2 pi, and the share of the area below.
    Curved {
        /// Shape in the group's frame.
        shape: Quadric,
        /// Transformation from the group's frame to the prepared frame, a similarity.
        pose: Affine3A,
    },
}

/// One side of a primitive, or of two that form a parallelogram.
#[derive(Clone, Debug)]
pub struct Surface {
    /// Index of its instance in the world.
    pub instance: u32,
    /// Its primitives in the instance; both are equal if there is only one.
    pub primitives: [u32; 2],
    /// Index of its material.
    pub material: u32,
    /// Side of the primitive.
    pub side: Side,
    /// Shape of the surface.
    pub form: Form,
}

/// A point of a surface.
#[derive(Clone, Copy, Debug, Default)]
pub struct SurfaceSpot {
    /// Position, m.
    pub position: Vec3A,
    /// Bound on its error, by axis, m.
    pub error: Vec3A,
    /// Unit normal of the side.
    pub normal: Vec3A,
}

impl Surface {
    /// Returns the point with these parameters.
    pub fn point_at(&self, parameters: Vec2) -> SurfaceSpot {
        let (position, size, normal) = match &self.form {
            Form::Triangle([origin, a, b]) | Form::Parallelogram([origin, a, b]) => {
                (*origin + *a * parameters.x + *b * parameters.y, origin.abs() + a.abs() + b.abs(), cross(*a, *b))
            }
            Form::Curved { shape, pose } => {
                let v = shape.parameter_at_share(f64::from(parameters.y));
                let (position, normal) = shape.point_at([f64::from(parameters.x), v]);
                let bounds = shape.bounds();
                let size =
                    pose.translation.abs() + bounds.min.abs().max(bounds.max.abs()) * pose.matrix3.x_axis.length();
                (pose.transform_point3a(position.as_vec3a()), size, pose.transform_vector3a(normal.as_vec3a()))
            }
        };
        let normal = normal.normalize_or(Vec3A::Z);
        let normal = if self.side == Side::Back { -normal } else { normal };
        SurfaceSpot { position, error: size * gamma(12), normal }
    }

    /// Returns the parameters of a point on it.
    /// - `position`: the point, prepared frame, m;
    /// - `hit`: its parameters from the ray tracer.
    pub fn parameters(&self, position: Vec3A, hit: [f32; 2]) -> Vec2 {
        match &self.form {
            Form::Triangle([origin, a, b]) | Form::Parallelogram([origin, a, b]) => {
                let p = position - *origin;
                let (aa, ab, bb, pa, pb) = (a.dot(*a), a.dot(*b), b.dot(*b), p.dot(*a), p.dot(*b));
                Vec2::new(pa * bb - pb * ab, pb * aa - pa * ab) / (aa * bb - ab * ab)
            }
            Form::Curved { shape, .. } => Vec2::new(hit[0], shape.share_below(f64::from(hit[1])) as f32),
        }
    }

    /// Returns the area, m2.
    pub fn area(&self) -> f32 {
        match &self.form {
            Form::Triangle([_, a, b]) => 0.5 * cross(*a, *b).length(),
            Form::Parallelogram([_, a, b]) => cross(*a, *b).length(),
            Form::Curved { shape, pose } => {
                let scale = f64::from(pose.matrix3.x_axis.length());
                (shape.area() * scale * scale) as f32
            }
        }
    }

    /// Checks whether it has a single normal.
    pub fn is_flat(&self) -> bool {
        !matches!(self.form, Form::Curved { shape, .. } if !matches!(shape, Quadric::Ring { .. }))
    }

    /// Checks whether its cells are polygons, with straight edges.
    pub fn is_polygon(&self) -> bool {
        !matches!(self.form, Form::Curved { .. })
    }

    /// Checks whether parts of the side are visible from other parts.
    pub fn is_concave(&self) -> bool {
        let Form::Curved { shape, .. } = &self.form else { return false };
        match shape {
            Quadric::Ring { .. } => false,
            // A torus is partly concave: its inner half is a saddle.
            Quadric::Torus { .. } => true,
            _ => (shape.facing() == femc_geometry::Facing::Inward) != (self.side == Side::Back),
        }
    }

    /// Returns the corner and edges of a parallelogram that two triangles form, if they do.
    pub fn join_triangles(first: [Vec3A; 3], second: [Vec3A; 3]) -> Option<[Vec3A; 3]> {
        let same =
            |a: Vec3A, b: Vec3A| (a - b).abs().max_element() <= 4.0 * f32::EPSILON * a.abs().max(b.abs()).max_element();
        let apex = first.iter().position(|&p| second.iter().all(|&q| !same(p, q)))?;
        let [a, b, c] = [0, 1, 2].map(|k| first[(apex + k) % 3].as_dvec3());
        let far = second.iter().find(|&&q| first.iter().all(|&p| !same(p, q)))?.as_dvec3();
        let miss: DVec3 = b + c - a - far;
        let shared = second.iter().filter(|&&q| first.iter().any(|&p| same(p, q))).count();
        (shared == 2 && miss.length() <= 1e-6 * (c - b).length())
            .then(|| [a.as_vec3a(), (b - a).as_vec3a(), (c - a).as_vec3a()])
    }
}
