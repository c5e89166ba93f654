use femc_math::glam::{Affine3A, DVec3, Vec3A};

/// An axis-aligned box, m. Empty when `min > max`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Aabb {
    /// Least corner.
    pub min: Vec3A,
    /// Greatest corner.
    pub max: Vec3A,
}

impl Aabb {
    /// The box of no points.
    pub const EMPTY: Self = Self { min: Vec3A::INFINITY, max: Vec3A::NEG_INFINITY };

    /// Returns the smallest box around `points`.
    pub fn around(points: &[Vec3A]) -> Self {
        points.iter().fold(Self::EMPTY, |b, &p| Self { min: b.min.min(p), max: b.max.max(p) })
    }

    /// Returns the smallest f32 box around the f64 box `center` ± `half`.
    pub fn around_center(center: DVec3, half: DVec3) -> Self {
        let down = |x: f64| if f64::from(x as f32) <= x { x as f32 } else { (x as f32).next_down() };
        let up = |x: f64| if f64::from(x as f32) >= x { x as f32 } else { (x as f32).next_up() };
        let (lo, hi) = (center - half, center + half);
        Self { min: Vec3A::new(down(lo.x), down(lo.y), down(lo.z)), max: Vec3A::new(up(hi.x), up(hi.y), up(hi.z)) }
    }

    /// Returns the smallest box around both.
    #[must_use]
    pub fn union(self, other: Self) -> Self {
        Self { min: self.min.min(other.min), max: self.max.max(other.max) }
    }

    /// Returns whether the box contains no point.
    pub fn is_empty(&self) -> bool {
        !self.min.cmple(self.max).all()
    }

    /// Returns the edge lengths, m; negative when empty.
    pub fn size(&self) -> Vec3A {
        self.max - self.min
    }

    /// Returns the center, m.
    pub fn center(&self) -> Vec3A {
        self.min * 0.5 + self.max * 0.5
    }

    /// Returns half of the surface area, m^2; 0 when empty.
    pub fn half_area(&self) -> f32 {
        let s = self.size().max(Vec3A::ZERO);
        s.x * s.y + s.y * s.z + s.z * s.x
    }

    /// Returns the box grown by `margin` on each side, m.
    #[must_use]
    pub fn expanded(self, margin: f32) -> Self {
        if self.is_empty() { self } else { Self { min: self.min - margin, max: self.max + margin } }
    }

    /// Returns a box around the image of this one, enlarged for rounding.
    #[must_use]
    pub fn transformed(&self, map: &Affine3A) -> Self {
        if self.is_empty() {
            return Self::EMPTY;
        }
        let (c, h) = (self.center(), self.size() * 0.5);
        let m = map.matrix3;
        let absolute = |v: Vec3A| m.x_axis.abs() * v.x + m.y_axis.abs() * v.y + m.z_axis.abs() * v.z;
        let center = map.transform_point3a(c);
        let reach = absolute(h);
        // Rounding of the two products, and of the center and half size themselves.
        let slack = (absolute(c.abs() + h) + map.translation.abs()) * femc_math::gamma(8);
        Self { min: center - reach - slack, max: center + reach + slack }
    }

    /// Returns the eight corners.
    pub fn corners(&self) -> [Vec3A; 8] {
        std::array::from_fn(|i| {
            let pick = |bit: usize, lo: f32, hi: f32| if i >> bit & 1 == 0 { lo } else { hi };
            Vec3A::new(
                pick(0, self.min.x, self.max.x),
                pick(1, self.min.y, self.max.y),
                pick(2, self.min.z, self.max.z),
            )
        })
    }
}
