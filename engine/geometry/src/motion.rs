//! Poses of instances over the shutter.

use crate::Aabb;
use femc_math::{
    elementary::{acos, sin},
    glam::{Affine3, Affine3A, Mat3, Mat3A, Quat, Vec3, Vec3A},
};

/// Placement of an instance: local frame to world frame.
#[derive(Clone, Debug)]
pub enum Pose {
    /// A fixed pose.
    Fixed(Affine3A),
    /// Poses at equally spaced times from 0 to 1 of the shutter. Between two poses, positions and scales are interpolated linearly
    /// and rotations along the shortest arc; a shear is lost. A single pose is equivalent to a fixed one.
    Moving(Vec<Affine3A>),
}

/// Returns whether the pose mirrors. Uses scalar arithmetic, like the parts of a pose: glam's wide types fuse products where the
/// compiler may use FMA.
fn mirrors(pose: &Affine3A) -> bool {
    Mat3::from(pose.matrix3).determinant() < 0.0
}

/// A map and its inverse.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Placement {
    pub to_world: Affine3A,
    pub to_local: Affine3A,
    pub mirrored: bool,
}

impl Placement {
    pub fn new(to_world: Affine3A) -> Self {
        let inverse = to_world.as_daffine3().inverse();
        let m = inverse.matrix3;
        Self {
            to_world,
            to_local: Affine3A {
                matrix3: Mat3A::from_cols(m.x_axis.as_vec3a(), m.y_axis.as_vec3a(), m.z_axis.as_vec3a()),
                translation: inverse.translation.as_vec3a(),
            },
            mirrored: mirrors(&to_world),
        }
    }
}

/// Components of one pose.
#[derive(Clone, Copy, Debug)]
struct PoseComponents {
    translation: Vec3A,
    rotation: Quat,
    scale: Vec3,
}

/// A motion in the form that the tracer evaluates.
#[derive(Clone, Debug)]
pub(crate) struct Motion {
    keys: Vec<PoseComponents>,
    /// For each segment, the angle between the rotations as quaternions, radians, and 1 / its sine; 0 if the angle is too small for
    /// it.
    arcs: Vec<(f32, f32)>,
    pub mirrored: bool,
}

impl Motion {
    /// Creates a motion from at least two poses.
    pub fn new(poses: &[Affine3A]) -> Self {
        let mut keys: Vec<PoseComponents> = poses
            .iter()
            .map(|pose| {
                let (scale, rotation, translation) = Affine3::from(*pose).to_scale_rotation_translation();
                PoseComponents { translation: translation.into(), rotation: rotation.normalize(), scale }
            })
            .collect();
        let mut arcs = Vec::with_capacity(keys.len());
        for i in 1..keys.len() {
            let mut cosine = keys[i - 1].rotation.dot(keys[i].rotation);
            if cosine < 0.0 {
                keys[i].rotation = -keys[i].rotation;
                cosine = -cosine;
            }
            let angle = acos(cosine.min(1.0));
            arcs.push(if angle > 1e-3 { (angle, 1.0 / sin(angle)) } else { (angle, 0.0) });
        }
        let mirrored = poses.first().is_some_and(mirrors);
        Self { keys, arcs, mirrored }
    }

    fn components_at(&self, time: f32) -> PoseComponents {
        let x = time.clamp(0.0, 1.0) * self.arcs.len() as f32;
        let segment = (x as usize).min(self.arcs.len() - 1);
        let s = x - segment as f32;
        let (a, b) = (&self.keys[segment], &self.keys[segment + 1]);
        let (angle, inverse_sine) = self.arcs[segment];
        let (wa, wb) = if inverse_sine == 0.0 {
            (1.0 - s, s)
        } else {
            (sin((1.0 - s) * angle) * inverse_sine, sin(s * angle) * inverse_sine)
        };
        PoseComponents {
            translation: a.translation * (1.0 - s) + b.translation * s,
            rotation: (a.rotation * wa + b.rotation * wb).normalize(),
            scale: a.scale * (1.0 - s) + b.scale * s,
        }
    }

    pub fn pose_at(&self, time: f32) -> Affine3A {
        let p = self.components_at(time);
        Affine3A::from_scale_rotation_translation(p.scale, p.rotation, p.translation.into())
    }

    pub fn placement_at(&self, time: f32) -> Placement {
        let p = self.components_at(time);
        let to_world = Affine3A::from_scale_rotation_translation(p.scale, p.rotation, p.translation.into());
        // (T R S)^-1 = S^-1 R^T T^-1, row by row.
        let inverse_scale = Vec3A::ONE / Vec3A::from(p.scale);
        let turned = Mat3A::from_quat(p.rotation).transpose();
        let linear = Mat3A::from_cols(
            turned.x_axis * inverse_scale,
            turned.y_axis * inverse_scale,
            turned.z_axis * inverse_scale,
        );
        let to_local = Affine3A { matrix3: linear, translation: linear * -p.translation };
        Placement { to_world, to_local, mirrored: self.mirrored }
    }

    /// Returns a box around the moving `local` over the whole shutter. It unites the boxes at steps of each segment, each grown by
    /// the maximum distance of a point from the chord between steps: h^2 / 8 times the greatest acceleration of a corner.
    pub fn swept_bounds(&self, local: &Aabb) -> Aabb {
        const STEPS: usize = 16;
        let reach = local.min.abs().max(local.max.abs()).length();
        let mut total = Aabb::EMPTY;
        for (segment, &(angle, _)) in self.arcs.iter().enumerate() {
            let (a, b) = (&self.keys[segment], &self.keys[segment + 1]);
            let turn = 2.0 * angle;
            let scale = a.scale.abs().max(b.scale.abs()).max_element();
            let growth = (a.scale - b.scale).abs().max_element();
            let acceleration = (turn * turn * scale + 2.0 * turn * growth) * reach;
            let bulge = acceleration / (8 * STEPS * STEPS) as f32;
            for step in 0..=STEPS {
                let time = (segment as f32 + step as f32 / STEPS as f32) / self.arcs.len() as f32;
                total = total.union(local.transformed(&self.pose_at(time)).expanded(bulge));
            }
        }
        // The times between steps are rounded. Between neighboring boxes positions are linear in time, so the union covers the
        // chords.
        let slack = total.min.abs().max(total.max.abs()).max_element() * femc_math::gamma(8);
        total.expanded(slack)
    }
}
