//! Animation at a given time: clips and frames, motion paths, cameras on paths, scalars that vary.
//!
//! Poses are similarities, possibly mirrored. They are interpolated as scale (linear), rotation (slerp on the shorter arc) and
//! translation (linear or spline). A mirrored pose is treated as a rotation followed by the point reflection -1, so two mirrored
//! keys interpolate like two unmirrored ones. The code uses only plain arithmetic and [`femc_math::elementary`], so every machine
//! computes the same bits.
//!
//! The spline is the centripetal Catmull-Rom curve of \[yuksel2011\]: the distance between knots is the square root of the distance
//! between keys, and time runs evenly over each segment. The curve has no loops or cusps. The price is that the speed, but not the
//! direction, may jump at a key.

use crate::{
    ObjectId,
    description::{Camera, Clip, GroupId, Interpolation, Key, Motion, MotionPath, MotionStep, Scene, Vary},
    objects::inherited_flags,
};
use femc_math::{
    Transform,
    elementary::double::{atan2, sin},
    glam::{DMat3, DQuat, DVec3},
};
use serde::Serialize;

impl Clip {
    /// Returns the number of frames: of the frames k = 1, 2, .. whose time is before the end plus half a frame; at least 1.
    pub fn frame_count(&self) -> u32 {
        (((self.end - self.start) * self.fps + 0.5).ceil() as u32).max(1)
    }

    /// Returns the time of frame `k` (the first is 1), s.
    pub fn frame_time(&self, k: u32) -> f64 {
        self.start + (f64::from(k) - 1.0) / self.fps
    }
}

impl Vary {
    /// Returns the value at `time` (s): linear between keys, constant before the first and after the last key.
    pub fn at(&self, time: f64) -> f64 {
        let after = self.keys.partition_point(|key| key.0 <= time);
        match (after.checked_sub(1).map(|i| self.keys[i]), self.keys.get(after)) {
            (Some((t0, v0)), Some(&(t1, v1))) => v0 + (v1 - v0) * ((time - t0) / (t1 - t0)),
            (Some((_, value)), None) | (None, Some(&(_, value))) => value,
            (None, None) => 0.0,
        }
    }
}

impl MotionPath {
    /// Returns the pose at `time` (s). Before the first key this is the first key's pose, after the last key the last key's pose,
    /// and without keys the identity. At the time of a key it equals the key's pose to the bit.
    pub fn at(&self, time: f64) -> Transform {
        let after = self.keys.partition_point(|key| key.time <= time);
        let Some(before) = after.checked_sub(1) else {
            return self.keys.first().map_or(Transform::IDENTITY, |key| key.pose);
        };
        let (Some(k1), Some(k0)) = (self.keys.get(after), self.keys.get(before)) else {
            return self.keys[before].pose;
        };
        if time == k0.time || self.is_still(before) {
            return k0.pose;
        }
        let u = (time - k0.time) / (k1.time - k0.time);
        let (from, to) = (Similarity::from_transform(&k0.pose), Similarity::from_transform(&k1.pose));
        let translation = match self.interpolation {
            Interpolation::Linear => from.translation + (to.translation - from.translation) * u,
            Interpolation::Spline => self.spline(before, u),
        };
        Similarity {
            scale: from.scale + (to.scale - from.scale) * u,
            rotation: slerp(from.rotation, to.rotation, u),
            translation,
        }
        .transform()
    }

    /// Returns whether the pose is the same at all times.
    pub fn is_constant(&self) -> bool {
        self.keys.windows(2).all(|pair| pair[0].pose == pair[1].pose)
    }

    /// Returns the motion between two times, s. Poses at times in between depend on nothing else.
    pub fn motion_during(&self, [from, to]: [f64; 2]) -> PathMotion<'_> {
        let first = self.keys.partition_point(|key| key.time <= from).saturating_sub(1);
        let end = (self.keys.partition_point(|key| key.time < to) + 1).min(self.keys.len());
        if to <= from || first + 1 >= end || (first..end - 1).all(|segment| self.is_still(segment)) {
            return PathMotion::Still(self.at(from));
        }
        // A spline segment also depends on the keys before and after it.
        let around = usize::from(self.interpolation == Interpolation::Spline);
        let keys = &self.keys[first.saturating_sub(around)..(end + around).min(self.keys.len())];
        PathMotion::Moving(self.interpolation, keys)
    }

    /// Returns whether nothing moves in the segment that begins at key `first`. This is the case when both ends are equal, for a
    /// spline too.
    fn is_still(&self, first: usize) -> bool {
        self.keys[first].pose == self.keys[first + 1].pose
    }

    /// Returns the translation at fraction `u` of the segment that begins at key `first`.
    fn spline(&self, first: usize, u: f64) -> DVec3 {
        let point = |key: &Key| key.pose.translation;
        let (p1, p2) = (point(&self.keys[first]), point(&self.keys[first + 1]));
        if p1 == p2 {
            return p1;
        }
        // Beyond the first and last key, the curve is extended by reflecting its last segment.
        let before = first.checked_sub(1).map(|i| point(&self.keys[i])).filter(|&p| p != p1);
        let after = self.keys.get(first + 2).map(point).filter(|&p| p != p2);
        let (p0, p3) = (before.unwrap_or(p1 * 2.0 - p2), after.unwrap_or(p2 * 2.0 - p1));
        let knot = |a: DVec3, b: DVec3| (b - a).length().sqrt();
        let (d0, d1, d2) = (knot(p0, p1), knot(p1, p2), knot(p2, p3));
        let m1 = ((p1 - p0) / d0 - (p2 - p0) / (d0 + d1) + (p2 - p1) / d1) * d1;
        let m2 = ((p2 - p1) / d1 - (p3 - p1) / (d1 + d2) + (p3 - p2) / d2) * d1;
        let (u2, u3) = (u * u, u * u * u);
        p1 * (2.0 * u3 - 3.0 * u2 + 1.0) + m1 * (u3 - 2.0 * u2 + u) + p2 * (3.0 * u2 - 2.0 * u3) + m2 * (u3 - u2)
    }
}

/// Motion along a path during a time interval.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub enum PathMotion<'a> {
    /// The path keeps this pose.
    Still(Transform),
    /// The path moves like a path that has these keys only.
    Moving(Interpolation, &'a [Key]),
}

/// Parts of a similarity: `scale * rotation`, then the translation. A negative scale means mirrored.
struct Similarity {
    scale: f64,
    rotation: DQuat,
    translation: DVec3,
}

impl Similarity {
    fn from_transform(pose: &Transform) -> Self {
        let m = pose.matrix3;
        let scale = m.x_axis.length().copysign(m.determinant());
        let rotation = if scale == 0.0 { DQuat::IDENTITY } else { DQuat::from_mat3(&(m * scale.recip())) };
        Self { scale, rotation, translation: pose.translation }
    }

    fn transform(&self) -> Transform {
        Transform { matrix3: DMat3::from_quat(self.rotation) * self.scale, translation: self.translation }
    }
}

/// Interpolates linearly on the sphere, on the shorter arc (\[shoemake1985\]). Takes and returns unit quaternions.
fn slerp(a: DQuat, b: DQuat, u: f64) -> DQuat {
    let b = if a.dot(b) < 0.0 { -b } else { b };
    // Twice the angle between half-sum and half-difference: accurate near 0, where acos is not.
    let angle = 2.0 * atan2((b - a).length(), (a + b).length());
    let whole = sin(angle);
    if whole < 1e-12 {
        return (a * (1.0 - u) + b * u).normalize();
    }
    (a * (sin((1.0 - u) * angle) / whole) + b * (sin(u * angle) / whole)).normalize()
}

impl Motion {
    /// Returns the transform at `time` (s), from local points to the parent's frame.
    /// - `paths`: the scene's paths, which the steps index; a step along a missing path is the identity.
    pub fn at(&self, paths: &[MotionPath], time: f64) -> Transform {
        self.steps.iter().fold(Transform::IDENTITY, |done, step| {
            let pose = match step {
                MotionStep::Static(transform) => *transform,
                MotionStep::Along(path) => paths.get(path.index()).map_or(Transform::IDENTITY, |path| path.at(time)),
            };
            pose * done
        })
    }

    /// Returns whether the transform changes over time.
    pub fn is_animated(&self, paths: &[MotionPath]) -> bool {
        self.steps.iter().any(|step| match step {
            MotionStep::Static(_) => false,
            MotionStep::Along(path) => paths.get(path.index()).is_some_and(|path| !path.is_constant()),
        })
    }
}

impl Camera {
    /// Returns the camera at `time` (s) in the world frame: its origin, target and up direction are transformed by the pose of its
    /// path. Lens and focus do not change, even where the path scales.
    pub fn at(&self, paths: &[MotionPath], time: f64) -> Self {
        let mut camera = Self { along: None, ..self.clone() };
        if let Some(path) = self.along.and_then(|path| paths.get(path.index())) {
            let pose = path.at(time);
            camera.origin = pose.transform_point3(self.origin);
            camera.target = pose.transform_point3(self.target);
            camera.up = pose.transform_vector3(self.up);
        }
        camera
    }

    /// Returns whether the camera moves over time.
    pub fn is_animated(&self, paths: &[MotionPath]) -> bool {
        self.along.and_then(|path| paths.get(path.index())).is_some_and(|path| !path.is_constant())
    }
}

impl Scene {
    /// Returns the number of frames of the clip; 1 for a still.
    pub fn frame_count(&self) -> u32 {
        self.clip.map_or(1, |clip| clip.frame_count())
    }

    /// Returns the time of frame `k` (the first is 1), s; 0 for a still.
    pub fn frame_time(&self, k: u32) -> f64 {
        self.clip.map_or(0.0, |clip| clip.frame_time(k))
    }

    /// Returns the times at which the shutter of `camera` opens and closes in frame `k`, s. For a still, both are the frame's time,
    /// because there is no frame interval to take a fraction of.
    pub fn shutter(&self, camera: &Camera, k: u32) -> [f64; 2] {
        let (time, interval) = (self.frame_time(k), self.clip.map_or(0.0, |clip| 1.0 / clip.fps));
        [time + camera.shutter_open * interval, time + camera.shutter_close * interval]
    }

    /// Returns for every group whether its contents change over time in the group's own frame. They change if something placed in
    /// the group (at any depth) moves, or if `hidden` of an object in it varies. Groups that do not change keep their acceleration
    /// structure from frame to frame.
    pub fn changing_groups(&self) -> Vec<bool> {
        let blinking = self.blinking_objects();
        let blinks = |object: Option<ObjectId>| object.is_some_and(|object| blinking[object.index()]);
        let mut changes: Vec<bool> = self
            .groups
            .iter()
            .map(|group| {
                group.instances.iter().any(|instance| instance.motion.is_animated(&self.paths))
                    || group.faces.iter().any(|face| blinks(face.object))
                    || group.quadrics.iter().any(|quadric| blinks(quadric.object))
                    || group.luminaires.iter().any(|luminaire| blinks(luminaire.object))
            })
            .collect();
        // The graph has no cycles, so changes propagate from children to parents in at most as many rounds as its depth.
        loop {
            let mut spread = false;
            for (index, group) in self.groups.iter().enumerate() {
                let holds = |&GroupId(id): &GroupId| changes.get(id as usize) == Some(&true);
                if !changes[index] && group.instances.iter().any(|instance| holds(&instance.group)) {
                    changes[index] = true;
                    spread = true;
                }
            }
            if !spread {
                return changes;
            }
        }
    }

    /// Returns for every object whether a `vary` hides or shows it or an object that encloses it.
    pub fn blinking_objects(&self) -> Vec<bool> {
        let varied: std::collections::BTreeSet<&str> = self
            .varies
            .iter()
            .filter_map(|vary| vary.selector.strip_prefix("object.")?.strip_suffix(".hidden"))
            .collect();
        inherited_flags(&self.objects, |object| varied.contains(object.name.as_str()))
    }
}
