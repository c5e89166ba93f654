use femc_scene::{Fixed, Scene, SelectorError};
use std::sync::Arc;

/// A scene to prepare frames of, which knows what it has in common with its variants: frames of one share with frames of
/// another whatever is equal.
#[derive(Clone, Debug)]
pub struct Source {
    scene: Arc<Scene>,
    fixed: Fixed,
}

impl Source {
    /// A scene; reads all of it once, for its digest.
    pub fn new(scene: Arc<Scene>) -> Self {
        let fixed = scene.fixed();
        Self { scene, fixed }
    }

    /// The same with scalars set, in order. Selectors reach nothing of what the digest is of.
    pub fn variant<S: AsRef<str>>(&self, values: &[(S, f64)]) -> Result<Self, SelectorError> {
        let mut scene = Scene::clone(&self.scene);
        for (selector, value) in values {
            scene.set(selector.as_ref(), *value)?;
        }
        Ok(Self { scene: Arc::new(scene), fixed: self.fixed })
    }

    /// The scene.
    pub fn scene(&self) -> &Arc<Scene> {
        &self.scene
    }

    /// Digest of what all variants have in common.
    pub fn fixed(&self) -> Fixed {
        self.fixed
    }
}
