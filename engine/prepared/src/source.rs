use femc_math::glam::DVec3;
use femc_scene::{Fixed, Group, Scene, SelectorError};
use std::sync::Arc;

/// A scene to prepare frames of, which knows what it has in common with its variants: frames of one share with frames of
/// another whatever is equal.
#[derive(Clone, Debug)]
pub struct Source {
    scene: Arc<Scene>,
    fixed: Fixed,
    grid: f64,
}

/// The coarsest grid of origins, m: what is near a camera there is known to 1 um.
const COARSEST: f64 = 32.0;

impl Source {
    /// A scene; reads all of it once, for its digest.
    pub fn new(scene: Arc<Scene>) -> Self {
        let (fixed, grid) = (scene.fixed(), grid(&scene));
        Self { scene, fixed, grid }
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
    pub fn fixed(&self) -> Fixed {
        self.fixed
    }

    /// Prepared frames have their origin at multiples of this, m. Cameras that are nearer to each other than the scene is
    /// large mostly have the same one, so that their frames share the world.
    pub fn grid(&self) -> f64 {
        self.grid
    }
}

/// The largest power of two that is no more than a quarter of the largest group's extent; 1 m to [`COARSEST`]. With it
/// nothing is rounded more than 1e-8 of that extent.
fn grid(scene: &Scene) -> f64 {
    let extent = |group: &Group| {
        let corners = group.vertices.iter().map(|vertex| vertex.position);
        let (min, max) = corners.fold((DVec3::INFINITY, DVec3::NEG_INFINITY), |(min, max), p| (min.min(p), max.max(p)));
        (max - min).max_element().max(0.0)
    };
    let largest = scene.groups.iter().map(extent).fold(0.0, f64::max);
    let mut grid = 1.0;
    while grid < COARSEST && grid * 8.0 <= largest {
        grid *= 2.0;
    }
    grid
}
