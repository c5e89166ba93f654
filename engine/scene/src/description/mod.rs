//! The description: plain data, filled by an importer, read by the preparation of a frame.

mod animation;
mod camera;
mod geometry;
mod luminaire;
mod material;
mod medium;

pub use animation::*;
pub use camera::*;
pub use geometry::*;
pub use luminaire::*;
pub use material::*;
pub use medium::*;

use serde::{Deserialize, Serialize};

/// A whole scene. Group 0 is the world. All ids index the vectors here.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub struct Scene {
    /// Name for output files: the scene file's stem.
    pub name: String,
    /// Source files, for [`Location`].
    pub files: Vec<String>,
    /// Materials in order of first definition. A material redefined under one name (MGF allows it) is a new entry.
    pub materials: Vec<Material>,
    /// Named objects; nested ones carry dotted names.
    pub objects: Vec<Object>,
    /// Groups of surfaces; `groups[0]` is the world and always present.
    pub groups: Vec<Group>,
    /// Participating media.
    pub media: Vec<Medium>,
    /// Where the media are.
    pub regions: Vec<MediumRegion>,
    /// Measured luminous intensity distributions (IES), shared by luminaires.
    pub photometry: Vec<Photometry>,
    /// Image textures, decoded to linear Rec.709.
    pub images: Vec<Image>,
    /// Cameras; the first is the default.
    pub cameras: Vec<Camera>,
    /// The clip; `None` for a still.
    pub clip: Option<Clip>,
    /// Motion paths.
    pub paths: Vec<MotionPath>,
    /// Scalars over time.
    pub varies: Vec<Vary>,
}

/// A place in a source file, for messages. Line and column count from 1; column 0: the whole line.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub struct Location {
    /// Index into [`Scene::files`].
    pub file: u32,
    /// Line, from 1.
    pub line: u32,
    /// Column, from 1; 0 = the whole line.
    pub column: u32,
}

macro_rules! ids {
    ($($(#[$doc:meta])* $name:ident;)*) => {$(
        $(#[$doc])*
        #[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
        pub struct $name(pub u32);
        impl $name {
            /// As an index.
            pub const fn index(self) -> usize { self.0 as usize }
        }
    )*};
}

ids! {
    /// Index into [`Scene::materials`].
    MaterialId;
    /// Index into [`Scene::objects`].
    ObjectId;
    /// Index into [`Scene::groups`].
    GroupId;
    /// Index into [`Scene::media`].
    MediumId;
    /// Index into [`Scene::photometry`].
    PhotometryId;
    /// Index into [`Scene::images`].
    ImageId;
    /// Index into [`Scene::paths`].
    PathId;
}

/// A named object; surfaces refer to the innermost one that holds them.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Object {
    /// Full dotted name, `car.wheel`.
    pub name: String,
    /// The enclosing object.
    pub parent: Option<ObjectId>,
    /// Not rendered when true; so is all that it encloses.
    pub hidden: bool,
}

/// An image texture, row 0 on top.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Image {
    /// Path as the scene names it.
    pub path: String,
    /// Pixels per row.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// Linear Rec.709 (for a normal map: the encoded values mapped to [-1, 1]), `width * height` entries, row-major.
    pub pixels: Vec<[f32; 3]>,
}
