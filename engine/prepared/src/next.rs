//! Where what a frame shows is in the next frame of the clip, and where that frame's camera sees it.
//!
//! A point stays on its surface: it is carried by the motions of the group that it is part of, and taken at the same time of the next
//! shutter through the same point of the lens. So a point that moves with the camera has no motion, whatever blurs it.

use crate::camera::{KernelCamera, View};
use crate::compile::NONE;
use crate::frame::{FrameSpec, PrepareError, Prepared, Sight, find_camera, kernel_camera};
use femc_geometry::{InstanceInput, World};
use femc_math::glam::Vec3A;

/// The next frame, as far as the surfaces of this one go.
#[derive(Clone, Debug)]
pub struct NextFrame {
    camera: KernelCamera,
    /// The instances that move over the clip.
    moving: World,
    /// By instance of the frame: its index in `moving`, or `NONE`.
    index: Vec<u32>,
}

impl NextFrame {
    /// What comes after a frame; `None`: it is the last of its clip, or a still.
    /// - `spec`: what the frame was prepared by.
    pub fn of(prepared: &Prepared, spec: &FrameSpec) -> Result<Option<Self>, PrepareError> {
        let scene = &prepared.scene;
        let frame = prepared.frame + 1;
        if frame > scene.frame_count() {
            return Ok(None);
        }
        let now = scene.scalars_at(scene.frame_time(frame))?;
        let camera = find_camera(&now.cameras, spec.camera.as_deref())?;
        let shutter = scene.shutter(camera, frame);
        let sight = Sight { camera, film: prepared.camera.film, shutter, origin: prepared.origin };
        let camera = kernel_camera(&now.paths, &FrameSpec { frame, ..spec.clone() }, &sight)?;
        let (mut inputs, mut index) = (Vec::new(), Vec::with_capacity(prepared.instances.len()));
        for instance in prepared.instances.iter() {
            if !instance.motions.iter().any(|motion| motion.is_animated(&now.paths)) {
                index.push(NONE);
                continue;
            }
            index.push(inputs.len() as u32);
            let (pose, _) = instance.pose_over(shutter, &now.paths, prepared.origin);
            inputs.push(InstanceInput { blas: instance.compiled.blas.clone(), pose });
        }
        Ok(Some(Self { camera, moving: World::build(inputs), index }))
    }

    /// From where a point is on the film to where it will be, pixels, x to the right and y down; `None`: the next camera does not have it
    /// in front.
    /// - `position`: on the surface of an instance, prepared frame; `time`: of the shutter;
    /// - `view`: of the camera now, through the point `lens` of the lens at that time.
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
