//! Orthonormal frames.

use glam::Vec3A;

/// A right-handed orthonormal frame; `normal` is its z axis.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Frame {
    /// x axis, unit.
    pub tangent: Vec3A,
    /// y axis, unit.
    pub bitangent: Vec3A,
    /// z axis, unit.
    pub normal: Vec3A,
}

impl Frame {
    /// Builds a frame about `normal` (unit), continuous except at the sign change of z (\[duff2017\]).
    #[inline]
    pub fn from_normal(normal: Vec3A) -> Self {
        let sign = 1.0f32.copysign(normal.z);
        let a = -1.0 / (sign + normal.z);
        let b = normal.x * normal.y * a;
        Self {
            tangent: Vec3A::new(1.0 + sign * normal.x * normal.x * a, sign * b, -sign * normal.x),
            bitangent: Vec3A::new(b, sign + normal.y * normal.y * a, -normal.y),
            normal,
        }
    }

    /// Converts a world direction to frame coordinates.
    #[inline]
    pub fn to_local(&self, v: Vec3A) -> Vec3A {
        Vec3A::new(v.dot(self.tangent), v.dot(self.bitangent), v.dot(self.normal))
    }

    /// Converts frame coordinates to a world direction.
    #[inline]
    pub fn to_world(&self, v: Vec3A) -> Vec3A {
        self.tangent * v.x + self.bitangent * v.y + self.normal * v.z
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frames_are_orthonormal_and_invertible_for_every_normal() {
        for i in 0..2000u32 {
            let z = 1.0 - 2.0 * (i as f32 + 0.5) / 2000.0;
            let (s, c) = crate::elementary::sin_cos(i as f32 * 2.399_963);
            let r = (1.0 - z * z).sqrt();
            let frame = Frame::from_normal(Vec3A::new(r * c, r * s, z));
            assert!((crate::cross(frame.tangent, frame.bitangent) - frame.normal).length() < 1e-5);
            assert!((frame.tangent.length() - 1.0).abs() < 1e-5 && frame.tangent.dot(frame.bitangent).abs() < 1e-5);
            let v = Vec3A::new(0.3, -0.4, 0.5);
            assert!((frame.to_world(frame.to_local(v)) - v).length() < 1e-5);
        }
    }
}
