//! Digests of the inputs of one frame. Frames of variants with equal digests can share work.
//!
//! There are four layers, each a hash of the one before:
//! - [`StaticDigest`]: everything that no selector reaches (surfaces, images, photometry);
//! - the content: the world at the frame's time, regardless of the viewpoint;
//! - the prepared world, around an origin that may follow the camera;
//! - the view of one camera, through a pixel filter.
//!
//! Time itself does not count, only its effects. A scalar that varies counts with its value. A path counts with its motion while
//! the shutter is open ([`PathMotion`]); where it stands still, it counts with its pose. The digests never miss a difference. They
//! may differ for a change that no pixel shows (a material that is on no surface), and then work is done twice.

use crate::animation::PathMotion;
use crate::description::{Camera, Luminaire, Material, Medium, MediumRegion, MotionPath, MotionStep, PathId, Scene};
use crate::digest::{CanonicalHasher, NOWHERE, SceneDigest};
use crate::selector::Scalars;
use femc_math::glam::DVec3;
use std::collections::BTreeSet;

/// Digest of everything that overrides do not reach; equal for all variants of a scene.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct StaticDigest(SceneDigest);

/// Digests of the inputs of a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct FrameKey {
    /// Digest of everything that overrides do not reach.
    pub static_digest: StaticDigest,
    /// Digest of everything but the camera and the origin of the prepared frame's coordinates. Work done for one content serves all
    /// frames, cameras and variants with the same digest.
    pub content: SceneDigest,
    /// Digest of everything but the camera, as prepared. Frames with equal digests share the prepared world.
    pub world: SceneDigest,
    /// Digest of the world without the brightness of its lamps ([`Scalars::brightness`]). Frames with equal digests have the same
    /// light up to a factor.
    pub light: SceneDigest,
    /// Digest of all inputs. Frames with equal digests have the same pixels under the same settings.
    pub view: SceneDigest,
}

/// The camera, film, frame and shutter of a view.
#[derive(Clone, Copy, Debug)]
pub struct Viewpoint<'a> {
    /// The camera at the frame's time.
    pub camera: &'a Camera,
    /// Pixels of the film.
    pub film: [u32; 2],
    /// Frame of the clip, counted from 1. It is a key of the samples.
    pub frame: u32,
    /// Opening and closing of the shutter, s.
    pub shutter: [f64; 2],
    /// World position of the prepared coordinates' origin, m.
    pub origin: DVec3,
    /// Radius of the pixel filter, pixels. It decides which pixels see a lamp.
    pub filter_radius: f32,
}

impl Scene {
    /// Returns the digest of everything that no selector reaches. It reads the whole geometry: compute it once for all variants.
    pub fn static_digest(&self) -> StaticDigest {
        let mut canonical = CanonicalHasher::new("fixed");
        canonical.value(&self.groups.len());
        for group in &self.groups {
            canonical.surfaces(group);
            canonical.value(&group.instances);
            canonical.table(&group.luminaires, |luminaire| Luminaire {
                location: NOWHERE,
                multiplier: 1.0,
                ..*luminaire
            });
        }
        canonical.table(&self.regions, |region| MediumRegion { location: NOWHERE, ..*region });
        canonical.photometry(&self.photometry);
        canonical.images(&self.images);
        StaticDigest(canonical.digest())
    }

    /// Returns the digests of a frame's inputs.
    /// - `static_digest`: that of this scene, or of the scene that it is a variant of;
    /// - `now`: [`Scene::scalars_at`] the frame's time.
    pub fn frame_key(&self, static_digest: StaticDigest, now: &Scalars, viewpoint: &Viewpoint<'_>) -> FrameKey {
        let Viewpoint { camera, film, frame, shutter, origin, filter_radius } = *viewpoint;
        let paths = self.paths_of_surfaces();
        let paths = || paths.iter().map(|path| now.paths.get(path.index()));
        let content_of = |form: &str, now: &Scalars| {
            let mut canonical = CanonicalHasher::new(form);
            canonical.value(&static_digest.0);
            canonical.table(&now.materials, |material| Material { location: NOWHERE, ..material.clone() });
            canonical.table(&now.objects, |object| object);
            canonical.table(&now.media, |medium| Medium { location: NOWHERE, ..medium.clone() });
            canonical.value(&now.luminaires.len());
            now.luminaires.iter().for_each(|group| canonical.table(group, |luminaire| luminaire.multiplier));
            paths().for_each(|path| canonical.path(path, shutter));
            canonical.digest()
        };
        let world_of = |form: &str, content: SceneDigest| {
            let mut canonical = CanonicalHasher::new(form);
            // With an open shutter, geometry that moves only at other times is prepared as moving geometry, too.
            canonical.value(&(content, origin, shutter[1] > shutter[0]));
            paths().for_each(|path| canonical.value(&path.map(MotionPath::is_constant)));
            canonical.digest()
        };
        let content = content_of("content", now);
        let world = world_of("world", content);
        let light = world_of("light", content_of("content of brightness 1", &now.with_unit_brightness()));
        let mut canonical = CanonicalHasher::new("view");
        canonical.value(&(world, film, frame, filter_radius));
        canonical.value(&Camera { name: String::new(), location: NOWHERE, film, ..camera.clone() });
        let along = camera.along.and_then(|path| now.paths.get(path.index()));
        canonical.path(along, shutter);
        canonical.value(&along.map(MotionPath::is_constant));
        FrameKey { static_digest, content, world, light, view: canonical.digest() }
    }

    fn paths_of_surfaces(&self) -> BTreeSet<PathId> {
        let steps = self.groups.iter().flat_map(|group| &group.instances).flat_map(|instance| &instance.motion.steps);
        let along = |step: &MotionStep| match step {
            MotionStep::Along(path) => Some(*path),
            MotionStep::Static(_) => None,
        };
        steps.filter_map(along).collect()
    }
}

impl FrameKey {
    /// Returns the digests of a frame whose output also depends on the next frame: the view combines both views.
    pub fn with_next(self, next: &Self) -> Self {
        let mut canonical = CanonicalHasher::new("view and next");
        canonical.value(&(self.view, next.view));
        Self { view: canonical.digest(), ..self }
    }
}

impl CanonicalHasher {
    /// Adds a path as one frame sees it; a missing path adds an empty value.
    fn path(&mut self, path: Option<&MotionPath>, shutter: [f64; 2]) {
        match path.map(|path| path.motion_during(shutter)) {
            Some(motion @ PathMotion::Moving(..)) => self.value(&(shutter, motion)),
            Some(still) => self.value(&still),
            None => self.value(&()),
        }
    }
}
