//! Motion vectors: the position on the next frame's film of a point that a frame shows.
//!
//! A point stays on its surface: the motions of its group carry it. It is projected at the same time of the next shutter, through
//! the same point of the lens. So a point that moves with the camera has no motion, even if it is blurred.

use crate::camera::{KernelCamera, View};
use crate::compile::NONE;
use crate::frame::{FrameSpec, FrameView, PrepareError, Prepared, find_camera, kernel_camera};
use femc_geometry::{InstanceInput, World};
use femc_math::glam::Vec3A;

/// The next frame, for the surfaces of this one.
#[derive(Clone, Debug)]
pub struct NextFrame {
    camera: KernelCamera,
    /// Instances that move during the clip.
    moving: World,
    /// Index in `moving`, or `NONE`, for each instance of the frame.
    index: Vec<u32>,
}

impl NextFrame {
    /// Returns the frame after a frame; `None` if it is the last of its clip, or a still.
    /// - `spec`: specification with which the frame was prepared.
    pub fn from_frame(prepared: &Prepared, spec: &FrameSpec) -> Result<Option<Self>, PrepareError> {
        let scene = &prepared.scene;
        let frame = prepared.frame + 1;
        if frame > scene.frame_count() {
            return Ok(None);
        }
        let scalars = scene.scalars_at(scene.frame_time(frame))?;
        let camera = find_camera(&scalars.cameras, spec.camera.as_deref())?;
        let shutter = scene.shutter(camera, frame);
        let (film, origin, filter_radius) = (prepared.camera.film, prepared.origin, spec.filter_radius);
        let view = FrameView { camera, film, shutter, origin, filter_radius };
        let camera = kernel_camera(&scalars.paths, &FrameSpec { frame, ..spec.clone() }, &view)?;
        let (mut inputs, mut index) = (Vec::new(), Vec::with_capacity(prepared.instances.len()));
        for instance in prepared.instances.iter() {
            if !instance.motions.iter().any(|motion| motion.is_animated(&scalars.paths)) {
                index.push(NONE);
                continue;
            }
            index.push(inputs.len() as u32);
            let (pose, _) = instance.pose_over(shutter, &scalars.paths, prepared.origin);
            inputs.push(InstanceInput { blas: instance.compiled.blas.clone(), pose });
        }
        Ok(Some(Self { camera, moving: World::build(inputs), index }))
    }

    /// Returns the motion of a point on the film from this frame to the next, pixels, x to the right and y down; `None` if the
    /// point is not in front of the next camera.
    /// - `position`: on the surface of an instance, prepared frame; `time`: of the shutter;
    /// - `view`: of the current camera, through the point `lens` of the lens at that time.
    pub fn motion(
        &self,
        prepared: &Prepared,
        (instance, position, time): (u32, Vec3A, f32),
        (view, lens): (&View, [f32; 2]),
    ) -> Option<[f32; 2]> {
        let moved = match self.index[instance as usize] {
            NONE => position,
            moving => {
                let now = prepared.world.pose_at(instance, time).as_daffine3();
                let next = self.moving.pose_at(moving, time).as_daffine3();
                if now == next {
                    position
                } else {
                    next.transform_point3(now.inverse().transform_point3(position.as_dvec3())).as_vec3a()
                }
            }
        };
        let (from, _) = view.project(position)?;
        let (to, _) = self.camera.view(lens, time).project(moved)?;
        Some([to[0] - from[0], to[1] - from[1]])
    }
}
