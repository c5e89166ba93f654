//! Content hash of a scene.
//!
//! The hash is BLAKE3 over a canonical serialization: a version, then every table of the description with its length, each entry in
//! postcard's encoding. Data that cannot affect a pixel are left out: the scene's name, the names of source files (images and
//! photometry count with their content) and all locations. So two files that differ only in comments, blanks, line breaks or
//! includes have equal hashes, and so does a copy of a scene elsewhere. Names of materials, media, cameras, objects and paths
//! count, because overrides use them. Order counts, because ids are indices.
//!
//! The price of the canonical form is that two descriptions of the same picture (a prism and its faces) have different hashes.

use crate::description::{
    Camera, Face, Group, Image, Location, Luminaire, Material, Medium, MediumRegion, MotionPath, Photometry, Quadric,
    Scene, Vary,
};
use serde::{Deserialize, Serialize};
use std::{
    fmt,
    io::{BufWriter, Write},
    str::FromStr,
};

/// Version of the canonical form. Raise it with every change of the form or of the description.
const VERSION: u32 = 2;

/// The content hash of a scene. Displays as 64 lower-case hexadecimal digits.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub struct SceneDigest(pub [u8; 32]);

impl fmt::Display for SceneDigest {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.iter().try_for_each(|byte| write!(f, "{byte:02x}"))
    }
}

impl fmt::Debug for SceneDigest {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "SceneDigest({self})")
    }
}

/// A text that is not a scene digest.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("a scene digest has 64 hexadecimal digits")]
pub struct DigestError;

impl FromStr for SceneDigest {
    type Err = DigestError;

    fn from_str(text: &str) -> Result<Self, DigestError> {
        blake3::Hash::from_hex(text).map(|hash| Self(*hash.as_bytes())).map_err(|_| DigestError)
    }
}

impl Scene {
    /// Returns the content hash; the [module](crate::digest) documents what counts.
    pub fn digest(&self) -> SceneDigest {
        let mut canonical = CanonicalHasher { out: BufWriter::with_capacity(1 << 16, blake3::Hasher::new()) };
        canonical.scene(self);
        let hasher = canonical.out.into_inner().expect("a hasher takes every byte");
        SceneDigest(*hasher.finalize().as_bytes())
    }
}

/// Writer that feeds the canonical form into a hash.
pub(crate) struct CanonicalHasher {
    out: BufWriter<blake3::Hasher>,
}

impl CanonicalHasher {
    /// Returns an empty writer of the form `form`. Two different forms never give the same digest.
    pub(crate) fn new(form: &str) -> Self {
        let mut canonical = Self { out: BufWriter::with_capacity(1 << 16, blake3::Hasher::new()) };
        canonical.value(&(form, VERSION));
        canonical
    }

    pub(crate) fn digest(self) -> SceneDigest {
        let hasher = self.out.into_inner().expect("a hasher takes every byte");
        SceneDigest(*hasher.finalize().as_bytes())
    }

    pub(crate) fn value(&mut self, value: &impl Serialize) {
        postcard::to_io(value, Write::by_ref(&mut self.out)).expect("plain data serialises, a hasher takes every byte");
    }

    /// Adds a table: its length, then each entry as returned by `strip`.
    pub(crate) fn table<'a, T: 'a, S: Serialize>(&mut self, entries: &'a [T], strip: impl Fn(&'a T) -> S) {
        self.value(&entries.len());
        for entry in entries {
            self.value(&strip(entry));
        }
    }

    fn scene(&mut self, scene: &Scene) {
        // No `..` here, so that a new field of the description forces a decision.
        let Scene {
            name: _,
            files: _,
            materials,
            objects,
            groups,
            media,
            regions,
            photometry,
            images,
            cameras,
            clip,
            paths,
            varies,
        } = scene;
        self.value(&VERSION);
        self.table(materials, |material| Material { location: NOWHERE, ..material.clone() });
        self.table(objects, |object| object);
        self.value(&groups.len());
        groups.iter().for_each(|group| self.group(group));
        self.table(media, |medium| Medium { location: NOWHERE, ..medium.clone() });
        self.table(regions, |region| MediumRegion { location: NOWHERE, ..*region });
        self.photometry(photometry);
        self.images(images);
        self.table(cameras, |camera| Camera { location: NOWHERE, ..camera.clone() });
        self.value(clip);
        self.table(paths, |path| {
            let MotionPath { name, location: _, interpolation, keys } = path;
            (name, interpolation, keys)
        });
        self.table(varies, |vary| {
            let Vary { selector, location: _, keys } = vary;
            (selector, keys)
        });
    }

    pub(crate) fn photometry(&mut self, photometry: &[Photometry]) {
        self.table(photometry, |photometry| {
            let Photometry { path: _, kind, vertical, horizontal, candela, opening, location: _ } = photometry;
            (kind, vertical, horizontal, candela, opening)
        });
    }

    pub(crate) fn images(&mut self, images: &[Image]) {
        self.table(images, |image| {
            let Image { path: _, width, height, pixels } = image;
            (width, height, pixels)
        });
    }

    pub(crate) fn surfaces(&mut self, group: &Group) {
        let Group { vertices, triangles, faces, quadrics, luminaires: _, instances: _ } = group;
        self.value(vertices);
        self.value(triangles);
        self.table(faces, |face| Face { location: NOWHERE, ..*face });
        self.table(quadrics, |quadric| Quadric { location: NOWHERE, ..*quadric });
    }

    fn group(&mut self, group: &Group) {
        let Group { vertices: _, triangles: _, faces: _, quadrics: _, luminaires, instances } = group;
        self.surfaces(group);
        self.table(luminaires, |luminaire| Luminaire { location: NOWHERE, ..*luminaire });
        self.value(instances);
    }
}

pub(crate) const NOWHERE: Location = Location { file: 0, line: 0, column: 0 };
