use femc_math::glam::{BVec3, DVec3};
use femc_scene::{Scene, SelectorError, StaticDigest};
use std::sync::Arc;

/// A scene from which frames are prepared. It tracks what it shares with its variants, so that their frames share all equal data.
#[derive(Clone, Debug)]
pub struct SceneSource {
    scene: Arc<Scene>,
    static_digest: StaticDigest,
    center: Option<DVec3>,
}

/// Maximum distance along any axis, m, from the scene's middle to a camera whose frames have their origin there. At that distance
/// from an origin, positions are accurate to 4 um.
const MAX_CENTER_DISTANCE: f64 = 128.0;
/// Grid of the origins of other cameras, m. Near an origin, positions are accurate to 1 um.
const ORIGIN_GRID: f64 = 32.0;

impl SceneSource {
    /// Creates the source of a scene. Reads the whole scene once, for its digest.
    pub fn new(scene: Arc<Scene>) -> Self {
        let (static_digest, middle) = (scene.static_digest(), scene_center(&scene));
        Self { scene, static_digest, center: middle }
    }

    /// Returns a variant with scalars set, in order. Selectors do not reach anything that the static digest covers.
    pub fn variant<S: AsRef<str>>(&self, values: &[(S, f64)]) -> Result<Self, SelectorError> {
        let mut scene = Scene::clone(&self.scene);
        for (selector, value) in values {
            scene.set(selector.as_ref(), *value)?;
        }
        Ok(Self { scene: Arc::new(scene), ..*self })
    }

    /// Returns the scene.
    pub fn scene(&self) -> &Arc<Scene> {
        &self.scene
    }

    /// Returns the digest of everything that all variants share.
    pub fn static_digest(&self) -> StaticDigest {
        self.static_digest
    }

    /// Returns the origin of frames for a camera at `position`, m. It is the scene's middle if that is near, so that the frames of
    /// all cameras there share the world.
    pub fn origin(&self, position: DVec3) -> DVec3 {
        let near = self.center.filter(|middle| (position - middle).abs().max_element() <= MAX_CENTER_DISTANCE);
        near.unwrap_or_else(|| (position / ORIGIN_GRID).round() * ORIGIN_GRID)
    }
}

/// Returns the middle of everything that does not move, in whole meters; `None` if there is nothing.
fn scene_center(scene: &Scene) -> Option<DVec3> {
    let mut boxes = vec![None; scene.groups.len()];
    let (min, max) = group_bounds(scene, 0, &mut boxes);
    (min.cmple(max).all() && min.is_finite() && max.is_finite()).then(|| ((min + max) / 2.0).round())
}

type Bounds = (DVec3, DVec3);

/// Returns the bounds of a group's own points and of the groups that are placed in it and do not move. `boxes`: known bounds.
fn group_bounds(scene: &Scene, group: usize, boxes: &mut [Option<Bounds>]) -> Bounds {
    if let Some(known) = boxes[group] {
        return known;
    }
    let grown = |(min, max): Bounds, p: DVec3| (min.min(p), max.max(p));
    let nothing = (DVec3::INFINITY, DVec3::NEG_INFINITY);
    let group_here = &scene.groups[group];
    let mut all = group_here.positions().fold(nothing, grown);
    for instance in &group_here.instances {
        let Some(pose) = instance.motion.as_static() else { continue };
        let (min, max) = group_bounds(scene, instance.group.index(), boxes);
        if min.cmple(max).all() {
            let corner = |n: u32| DVec3::select(BVec3::from_array([0, 1, 2].map(|axis| n >> axis & 1 == 1)), max, min);
            all = (0..8).map(|n| pose.transform_point3(corner(n))).fold(all, grown);
        }
    }
    boxes[group] = Some(all);
    all
}
