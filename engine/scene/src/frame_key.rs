//! What one frame of a scene is made from, as digests: frames of variants that have equal ones can share the work.
//!
//! Layers, each a hash of the one before: what no selector reaches ([`StaticDigest`]: surfaces, images, photometry), the content
//! (the world at the frame's time, wherever it is seen from), the world as it is prepared, around an origin that may follow
//! the camera, and the view of one camera. Time itself does not count, only what is made of it: a scalar that varies counts
//! with its value, a path with what it does while the shutter is open ([`Passage`]): where it stands still, with its pose. The
//! digests never miss a difference; they may see one that no pixel shows (a material that nothing has), and then work is
//! done twice.

use crate::animation::Passage;
use crate::description::{Camera, Luminaire, Material, Medium, MediumRegion, MotionPath, MotionStep, PathId, Scene};
use crate::digest::{Canonical, NOWHERE, SceneDigest};
use crate::selector::Scalars;
use femc_math::glam::DVec3;
use std::collections::BTreeSet;

/// What overrides do not reach; equal for all variants of a scene.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct StaticDigest(SceneDigest);

/// What a frame is made from.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct FrameKey {
    /// What overrides do not reach.
    pub static_digest: StaticDigest,
    /// All but the camera and where the prepared frame's coordinates begin: what is done for one may serve all frames, cameras and
    /// variants that have it.
    pub content: SceneDigest,
    /// All but the camera, as it is prepared: frames with equal ones share the prepared world.
    pub world: SceneDigest,
    /// The world, but for the brightness of its lamps ([`Scalars::brightness`]): frames with equal ones have the same light but for a factor.
    pub light: SceneDigest,
    /// All: frames with equal ones have the same pixels under the same settings.
    pub view: SceneDigest,
}

/// Which camera sees what, and when.
#[derive(Clone, Copy, Debug)]
pub struct Viewpoint<'a> {
    /// The camera at the frame's time.
    pub camera: &'a Camera,
    /// Pixels of the film.
    pub film: [u32; 2],
    /// Frame of the clip, from 1: it keys the samples.
    pub frame: u32,
    /// Opening and closing of the shutter, s.
    pub shutter: [f64; 2],
    /// World position of the coordinates' origin, m.
    pub origin: DVec3,
}

impl Scene {
    /// Digest of what no selector reaches. It reads the whole geometry: compute it once for all variants.
    pub fn static_digest(&self) -> StaticDigest {
        let mut canonical = Canonical::of("fixed");
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

    /// What a frame is made from.
    /// - `static_digest`: this scene's, or that of the scene that it is a variant of;
    /// - `now`: [`Scene::scalars_at`] the frame's time.
    pub fn frame_key(&self, static_digest: StaticDigest, now: &Scalars, viewpoint: &Viewpoint<'_>) -> FrameKey {
        let Viewpoint { camera, film, frame, shutter, origin } = *viewpoint;
        let paths = self.paths_of_surfaces();
        let paths = || paths.iter().map(|path| now.paths.get(path.index()));
        let content_of = |what: &str, now: &Scalars| {
            let mut canonical = Canonical::of(what);
            canonical.value(&static_digest.0);
            canonical.table(&now.materials, |material| Material { location: NOWHERE, ..material.clone() });
            canonical.table(&now.objects, |object| object);
            canonical.table(&now.media, |medium| Medium { location: NOWHERE, ..medium.clone() });
            canonical.value(&now.luminaires.len());
            now.luminaires.iter().for_each(|group| canonical.table(group, |luminaire| luminaire.multiplier));
            paths().for_each(|path| canonical.path(path, shutter));
            canonical.digest()
        };
        let world_of = |what: &str, content: SceneDigest| {
            let mut canonical = Canonical::of(what);
            // What moves at other times is prepared as what moves, where the shutter is open.
            canonical.value(&(content, origin, shutter[1] > shutter[0]));
            paths().for_each(|path| canonical.value(&path.map(MotionPath::is_constant)));
            canonical.digest()
        };
        let content = content_of("content", now);
        let world = world_of("world", content);
        let light = world_of("light", content_of("content of brightness 1", &now.of_brightness_one()));
        let mut canonical = Canonical::of("view");
        canonical.value(&(world, film, frame));
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
    /// What a frame is made from that tells of the next one, too: its view is that of both.
    pub fn before(self, next: &Self) -> Self {
        let mut canonical = Canonical::of("view and next");
        canonical.value(&(self.view, next.view));
        Self { view: canonical.digest(), ..self }
    }
}

impl Canonical {
    /// A path as one frame sees it; one that is not there is none.
    fn path(&mut self, path: Option<&MotionPath>, shutter: [f64; 2]) {
        match path.map(|path| path.between(shutter)) {
            Some(passage @ Passage::Moving(..)) => self.value(&(shutter, passage)),
            Some(still) => self.value(&still),
            None => self.value(&()),
        }
    }
}
