use femc_math::glam::{BVec3, DVec3};
use femc_scene::{Scene, SelectorError, StaticDigest};
use std::sync::Arc;

/// A scene to prepare frames of, which knows what it has in common with its variants: frames of one share with frames of
/// another whatever is equal.
#[derive(Clone, Debug)]
pub struct Source {
    scene: Arc<Scene>,
    static_digest: StaticDigest,
    middle: Option<DVec3>,
}

/// Cameras no farther than this from the scene's middle along any axis have their frames' origin there, m: what is that far
/// from an origin is known to 4 um.
const NEAR: f64 = 128.0;
/// Grid of the origins of other cameras, m: what is near one is known to 1 um.
const GRID: f64 = 32.0;

impl Source {
    /// A scene; reads all of it once, for its digest.
    pub fn new(scene: Arc<Scene>) -> Self {
        let (static_digest, middle) = (scene.static_digest(), middle(&scene));
        Self { scene, static_digest, middle }
    }

    /// The same with scalars set, in order. Selectors reach nothing of what the digest is of.
    pub fn variant<S: AsRef<str>>(&self, values: &[(S, f64)]) -> Result<Self, SelectorError> {
        let mut scene = Scene::clone(&self.scene);
        for (selector, value) in values {
            scene.set(selector.as_ref(), *value)?;
        }
        Ok(Self { scene: Arc::new(scene), ..*self })
    }

    /// The scene.
    pub fn scene(&self) -> &Arc<Scene> {
        &self.scene
    }

    /// Digest of what all variants have in common.
    pub fn static_digest(&self) -> StaticDigest {
        self.static_digest
    }

    /// Where frames have their origin that a camera at `place` sees, m: in the scene's middle if that is near, so that the
    /// frames of all cameras there share the world.
    pub fn origin(&self, place: DVec3) -> DVec3 {
        let near = self.middle.filter(|middle| (place - middle).abs().max_element() <= NEAR);
        near.unwrap_or_else(|| (place / GRID).round() * GRID)
    }
}

/// The middle of all that does not move, in whole metres; `None` where there is nothing.
fn middle(scene: &Scene) -> Option<DVec3> {
    let mut boxes = vec![None; scene.groups.len()];
    let (min, max) = bounds(scene, 0, &mut boxes);
    (min.cmple(max).all() && min.is_finite() && max.is_finite()).then(|| ((min + max) / 2.0).round())
}

type Bounds = (DVec3, DVec3);

/// Of a group's own places and of the groups that are placed in it and do not move; `boxes`: those that are known.
fn bounds(scene: &Scene, group: usize, boxes: &mut [Option<Bounds>]) -> Bounds {
    if let Some(known) = boxes[group] {
        return known;
    }
    let grown = |(min, max): Bounds, p: DVec3| (min.min(p), max.max(p));
    let nothing = (DVec3::INFINITY, DVec3::NEG_INFINITY);
    let group_here = &scene.groups[group];
    let mut all = group_here.places().fold(nothing, grown);
    for instance in &group_here.instances {
        let Some(pose) = instance.motion.as_static() else { continue };
        let (min, max) = bounds(scene, instance.group.index(), boxes);
        if min.cmple(max).all() {
            let corner = |n: u32| DVec3::select(BVec3::from_array([0, 1, 2].map(|axis| n >> axis & 1 == 1)), max, min);
            all = (0..8).map(|n| pose.transform_point3(corner(n))).fold(all, grown);
        }
    }
    boxes[group] = Some(all);
    all
}
