//! Scene description: plain data that an importer fills and the preparation of a frame reads.

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
    /// Materials in order of first definition. A redefinition of a material name (MGF allows it) is a new entry.
    pub materials: Vec<Material>,
    /// Named objects; nested objects have dotted names.
    pub objects: Vec<Object>,
    /// Groups of surfaces; `groups[0]` is the world and always exists.
    pub groups: Vec<Group>,
    /// Participating media.
    pub media: Vec<Medium>,
    /// Regions that the media fill.
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

/// A position in a source file, for messages. Line and column count from 1; column 0 means the whole line.
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
            /// Returns the id as an index.
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

/// A named object. Surfaces refer to the innermost object that contains them.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Object {
    /// Full dotted name, such as `car.wheel`.
    pub name: String,
    /// The enclosing object.
    pub parent: Option<ObjectId>,
    /// True if the object and all objects that it encloses are not rendered.
    pub hidden: bool,
}

/// An image texture. Row 0 is at the top.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Image {
    /// Path as given in the scene file.
    pub path: String,
    /// Pixels per row.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// Linear Rec.709 (for a normal map: the encoded values mapped to [-1, 1]), `width * height` entries, row-major.
    pub pixels: Vec<[f32; 3]>,
}
