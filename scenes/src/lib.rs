//! Example scenes: generated ones, and the location of the hand-written ones.
//!
//! The scene files lie beside this crate's manifest (`scenes/*.mgf` and their parts in sub-folders). The short ones are written by
//! hand. This crate writes those in [`generate_all`] deterministically. They are committed, so that rendering them does not need
//! the generator. A test keeps both equal, byte for byte.
#![deny(missing_docs)]

mod greenhouse;
mod ies;
mod mgf_writer;
mod png;
mod roundabout;

/// A file of a scene.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct SceneFile {
    /// Path relative to the scenes' folder, `/`-separated.
    pub path: String,
    /// Content of the file.
    pub bytes: Vec<u8>,
}

impl SceneFile {
    fn text(path: &str, text: String) -> Self {
        Self { path: path.to_owned(), bytes: text.into_bytes() }
    }
}

/// Names for [`generate_scene`], in the order of the files in [`generate_all`].
pub const NAMES: [&str; 3] = ["roundabout", "greenhouse", "zoo"];

/// Generates the files of one scene: the scene file first where the generator writes it, then its parts.
/// - `name`: one of [`NAMES`]; `None` for any other.
pub fn generate_scene(name: &str) -> Option<Vec<SceneFile>> {
    match name {
        "roundabout" => Some(roundabout::files()),
        "greenhouse" => Some(greenhouse::files()),
        "zoo" => Some(vec![
            SceneFile { path: "zoo/checker.png".into(), bytes: png::checker() },
            SceneFile { path: "zoo/ripples.png".into(), bytes: png::ripples() },
            SceneFile::text("zoo/spot.ies", ies::spot()),
        ]),
        _ => None,
    }
}

/// Returns all generated files.
pub fn generate_all() -> Vec<SceneFile> {
    NAMES.iter().filter_map(|name| generate_scene(name)).flatten().collect()
}

/// Returns the folder of the committed scenes, as it was when this crate was compiled.
pub fn scenes_folder() -> &'static std::path::Path {
    std::path::Path::new(env!("CARGO_MANIFEST_DIR"))
}
