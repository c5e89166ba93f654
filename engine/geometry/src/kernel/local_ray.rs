use femc_math::glam::{Affine3A, Vec3A};

/// A ray in the frame of one tree, with precomputed data for the box and triangle tests. The direction need not be unit: `t` is
/// that of the world's ray.
#[derive(Clone, Copy, Debug)]
pub(crate) struct LocalRay {
    pub origin: Vec3A,
    pub dir: Vec3A,
    pub inverse: Vec3A,
    /// 1 for each axis along which the direction is negative, where the greatest plane is the near one.
    pub dir_is_negative: [usize; 3],
    /// Axes permuted so that the direction's largest component is last, with the winding preserved (\[woop2013\]).
    pub axes: [usize; 3],
    /// Shear that makes the direction parallel to the last axis.
    pub shear: [f32; 2],
    /// Whether the frame is a mirror image of the world's.
    pub mirrored: bool,
}

impl LocalRay {
    #[inline(always)]
    pub fn new(origin: Vec3A, dir: Vec3A) -> Self {
        let inverse = Vec3A::ONE / dir;
        let a = dir.abs();
        let z = if a.x > a.y {
            if a.x > a.z { 0 } else { 2 }
        } else if a.y > a.z {
            1
        } else {
            2
        };
        const NEXT: [[usize; 2]; 3] = [[1, 2], [2, 0], [0, 1]];
        let d = dir.to_array();
        let down = |x: f32| (x.to_bits() >> 31) as usize;
        let flip = down(d[z]);
        let (x, y) = (NEXT[z][flip], NEXT[z][1 - flip]);
        let scale = inverse.to_array()[z];
        Self {
            origin,
            dir,
            inverse,
            dir_is_negative: [down(d[0]), down(d[1]), down(d[2])],
            axes: [x, y, z],
            shear: [d[x] * scale, d[y] * scale],
            mirrored: false,
        }
    }

    /// Transforms a world ray into the frame to which `to_local` maps.
    #[inline(always)]
    pub fn transformed(origin: Vec3A, dir: Vec3A, to_local: &Affine3A, mirrored: bool) -> Self {
        let origin = to_local.transform_point3a(origin);
        let dir = to_local.transform_vector3a(dir);
        Self { mirrored, ..Self::new(origin, dir) }
    }
}
