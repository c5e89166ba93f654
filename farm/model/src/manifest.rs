//! Manifests: the files of a scene as pieces in the artifact store. A job's `bundle` names a manifest.
//!
//! A manifest lists the pieces and the position of every file in them. The farm uses only the list of pieces: it checks that they
//! exist and keeps them. A bundle that is not a manifest has no pieces: earlier versions stored a scene as one artifact.

use std::collections::BTreeMap;

use crate::{Artifact, Digest};

const MAGIC: &[u8; 8] = b"femcmnft";
const VERSION: u32 = 1;

/// Files of a scene, and the artifacts that hold them.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Manifest {
    /// The artifacts.
    pub pieces: Vec<BundlePiece>,
    /// Position of each file, by its path. Paths are relative, `/`-separated, and have no `.`, `..` or empty component.
    pub files: BTreeMap<String, FileExtent>,
}

/// An artifact that holds a large file or several small ones, compressed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct BundlePiece {
    /// Artifact in the store (compressed).
    pub artifact: Artifact,
    /// Size after unpacking, in bytes.
    pub unpacked: u64,
}

/// Position of a file.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct FileExtent {
    /// Index of the piece.
    pub piece: u32,
    /// First byte in the unpacked piece.
    pub offset: u64,
    /// Size of the file in bytes.
    pub bytes: u64,
}

/// Reason why bytes are not a valid manifest.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum ManifestError {
    /// The bytes were not made by [`Manifest::encode`].
    #[error("not a manifest")]
    Magic,
    /// Another version of the format wrote it.
    #[error("the manifest has version {found}, but this program reads version {VERSION}")]
    Version {
        /// Version found.
        found: u32,
    },
    /// The manifest is truncated or has invalid content.
    #[error("the manifest is damaged")]
    Damaged,
    /// A path could lead out of the scene's folder, or systems would interpret it differently.
    #[error("the manifest contains the invalid path {path:?}")]
    Path {
        /// Path from the manifest.
        path: String,
    },
    /// A path occurs twice or is out of order.
    #[error("the manifest lists {path:?} twice or out of order")]
    Order {
        /// Path from the manifest.
        path: String,
    },
    /// A file extends past the end of its piece.
    #[error("the manifest is damaged: {path:?} extends past the end of its piece")]
    Extent {
        /// Path of the file.
        path: String,
    },
    /// A quantity exceeds its limit.
    #[error("too many {what}: at most {limit}")]
    TooLarge {
        /// Quantity that exceeds its limit.
        what: &'static str,
        /// Maximum permitted value.
        limit: u64,
    },
}

impl Manifest {
    /// Maximum size of an encoded manifest in bytes.
    pub const MAX_BYTES: u64 = 64 << 20;
    /// Maximum number of pieces.
    pub const MAX_PIECES: u32 = 1 << 16;
    /// Maximum length of a path in bytes.
    pub const MAX_PATH: usize = 1024;
    /// Maximum total size in bytes of a scene's files, and of its unpacked pieces.
    pub const MAX_UNPACKED: u64 = 4 << 30;

    /// Returns whether `bytes` begin like a manifest.
    pub fn is_manifest(bytes: &[u8]) -> bool {
        bytes.starts_with(MAGIC)
    }

    /// Encodes the manifest. Equal manifests give equal bytes. Fails if [`Manifest::decode`] would refuse it.
    pub fn encode(&self) -> Result<Vec<u8>, ManifestError> {
        self.check()?;
        let mut out = Vec::from(MAGIC);
        out.extend(VERSION.to_le_bytes());
        out.extend((self.pieces.len() as u32).to_le_bytes());
        for BundlePiece { artifact, unpacked } in &self.pieces {
            out.extend(artifact.digest.as_bytes());
            out.extend(artifact.bytes.to_le_bytes());
            out.extend(unpacked.to_le_bytes());
        }
        out.extend((self.files.len() as u32).to_le_bytes());
        for (path, FileExtent { piece, offset, bytes }) in &self.files {
            out.extend((path.len() as u32).to_le_bytes());
            out.extend(path.as_bytes());
            out.extend(piece.to_le_bytes());
            out.extend(offset.to_le_bytes());
            out.extend(bytes.to_le_bytes());
        }
        limit("bytes in a manifest", out.len() as u64, Self::MAX_BYTES)?;
        Ok(out)
    }

    /// Decodes and checks a manifest.
    pub fn decode(bytes: &[u8]) -> Result<Self, ManifestError> {
        limit("bytes in a manifest", bytes.len() as u64, Self::MAX_BYTES)?;
        let mut rest = bytes;
        if take::<8>(&mut rest) != Ok(*MAGIC) {
            return Err(ManifestError::Magic);
        }
        let found = u32::from_le_bytes(take(&mut rest)?);
        if found != VERSION {
            return Err(ManifestError::Version { found });
        }
        let mut manifest = Self::default();
        for _ in 0..u32::from_le_bytes(take(&mut rest)?) {
            let digest = Digest::from_bytes(take(&mut rest)?);
            let artifact = Artifact { digest, bytes: u64::from_le_bytes(take(&mut rest)?) };
            manifest.pieces.push(BundlePiece { artifact, unpacked: u64::from_le_bytes(take(&mut rest)?) });
        }
        for _ in 0..u32::from_le_bytes(take(&mut rest)?) {
            let length = u32::from_le_bytes(take(&mut rest)?) as usize;
            let (path, tail) = rest.split_at_checked(length).ok_or(ManifestError::Damaged)?;
            rest = tail;
            let path = String::from_utf8(path.to_vec()).map_err(|_| ManifestError::Damaged)?;
            let piece = u32::from_le_bytes(take(&mut rest)?);
            let (offset, bytes) = (u64::from_le_bytes(take(&mut rest)?), u64::from_le_bytes(take(&mut rest)?));
            if manifest.files.last_key_value().is_some_and(|(last, _)| *last >= path) {
                return Err(ManifestError::Order { path });
            }
            manifest.files.insert(path, FileExtent { piece, offset, bytes });
        }
        if !rest.is_empty() {
            return Err(ManifestError::Damaged);
        }
        manifest.check()?;
        Ok(manifest)
    }

    fn check(&self) -> Result<(), ManifestError> {
        limit("pieces in a scene", self.pieces.len() as u64, Self::MAX_PIECES.into())?;
        let unpacked = self.pieces.iter().fold(0u64, |sum, piece| sum.saturating_add(piece.unpacked));
        limit("unpacked bytes in a scene", unpacked, Self::MAX_UNPACKED)?;
        // Files may share bytes. The limit prevents that a small scene unpacks to a huge one.
        let bytes = self.files.values().fold(0u64, |sum, extent| sum.saturating_add(extent.bytes));
        limit("bytes in the files of a scene", bytes, Self::MAX_UNPACKED)?;
        for (path, extent) in &self.files {
            if !is_normal(path) {
                return Err(ManifestError::Path { path: path.clone() });
            }
            let piece = self.pieces.get(extent.piece as usize);
            let end = extent.offset.checked_add(extent.bytes);
            if piece.zip(end).is_none_or(|(piece, end)| end > piece.unpacked) {
                return Err(ManifestError::Extent { path: path.clone() });
            }
        }
        Ok(())
    }
}

fn limit(what: &'static str, found: u64, limit: u64) -> Result<(), ManifestError> {
    if found <= limit { Ok(()) } else { Err(ManifestError::TooLarge { what, limit }) }
}

fn take<const N: usize>(rest: &mut &[u8]) -> Result<[u8; N], ManifestError> {
    let (head, tail) = rest.split_first_chunk::<N>().ok_or(ManifestError::Damaged)?;
    *rest = tail;
    Ok(*head)
}

/// Returns whether every system reads the path as the same file below the scene's folder.
fn is_normal(path: &str) -> bool {
    let parts = || path.split('/');
    path.len() <= Manifest::MAX_PATH
        && path.as_bytes().get(1) != Some(&b':')
        && !path.contains(|c: char| c == '\\' || c.is_control())
        && parts().all(|part| !matches!(part, "" | "." | ".."))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn piece(name: &[u8], unpacked: u64) -> BundlePiece {
        BundlePiece { artifact: Artifact::from_bytes(name), unpacked }
    }

    fn sample() -> Manifest {
        Manifest {
            pieces: vec![piece(b"pack", 10), piece(b"texture", 1 << 20)],
            files: BTreeMap::from([
                ("lamps/a.ies".into(), FileExtent { piece: 0, offset: 7, bytes: 3 }),
                ("main.mgf".into(), FileExtent { piece: 0, offset: 0, bytes: 7 }),
                ("wall.png".into(), FileExtent { piece: 1, offset: 0, bytes: 1 << 20 }),
            ]),
        }
    }

    /// Encodes like [`Manifest::encode`], but accepts any paths in any order.
    fn raw(paths: &[&str]) -> Vec<u8> {
        let mut out = Manifest { files: BTreeMap::new(), ..sample() }.encode().unwrap();
        out.truncate(out.len() - 4);
        out.extend((paths.len() as u32).to_le_bytes());
        for path in paths {
            out.extend((path.len() as u32).to_le_bytes());
            out.extend(path.as_bytes());
            out.extend([0; 4 + 8 + 8]);
        }
        out
    }

    #[test]
    fn a_manifest_comes_back_and_an_older_bundle_is_none() {
        let bytes = sample().encode().unwrap();
        assert!(Manifest::is_manifest(&bytes) && !Manifest::is_manifest(b"femcbndl"));
        assert_eq!(Manifest::decode(&bytes), Ok(sample()));
        assert_eq!(Manifest::decode(b"femcbndl"), Err(ManifestError::Magic));
        assert_eq!(Manifest::decode(&Manifest::default().encode().unwrap()), Ok(Manifest::default()));
    }

    #[test]
    fn one_cut_or_flipped_anywhere_never_panics() {
        let bytes = sample().encode().unwrap();
        for n in 0..bytes.len() {
            assert!(Manifest::decode(&bytes[..n]).is_err(), "cut at {n}");
            for bits in [0x01, 0x80, 0xff] {
                let mut flipped = bytes.clone();
                flipped[n] ^= bits;
                let _ = Manifest::decode(&flipped);
            }
        }
    }

    #[test]
    fn paths_that_lead_elsewhere_are_refused_on_both_sides() {
        let (long, longer) = ("x".repeat(Manifest::MAX_PATH + 1), "x/".repeat(2047) + "xx");
        for path in [
            "/abs", "..", "../up", "a/../b", "a\\b", "nul\0", "", ".", "./x", "a//b", "dir/", "c:/x", "a\nb", &long,
            &longer,
        ] {
            assert_eq!(Manifest::decode(&raw(&[path])), Err(ManifestError::Path { path: path.into() }));
            let files = BTreeMap::from([(path.to_owned(), FileExtent { piece: 0, offset: 0, bytes: 0 })]);
            let manifest = Manifest { files, ..sample() };
            assert_eq!(manifest.encode(), Err(ManifestError::Path { path: path.into() }));
        }
        assert!(Manifest::decode(&raw(&["..a", "a..", "b.c/d"])).is_ok());
    }

    #[test]
    fn a_path_twice_or_out_of_order_is_refused() {
        assert_eq!(Manifest::decode(&raw(&["a", "a"])), Err(ManifestError::Order { path: "a".into() }));
        assert_eq!(Manifest::decode(&raw(&["b", "a"])), Err(ManifestError::Order { path: "a".into() }));
    }

    #[test]
    fn files_beyond_their_piece_and_oversized_scenes_are_refused() {
        for extent in [
            FileExtent { piece: 2, offset: 0, bytes: 0 },
            FileExtent { piece: 0, offset: 8, bytes: 3 },
            FileExtent { piece: 0, offset: u64::MAX, bytes: 2 },
        ] {
            let manifest = Manifest { files: BTreeMap::from([("a".into(), extent)]), ..sample() };
            assert_eq!(manifest.encode(), Err(ManifestError::Extent { path: "a".into() }), "{extent:?}");
        }
        let huge = Manifest { pieces: vec![piece(b"a", u64::MAX), piece(b"b", u64::MAX)], ..Manifest::default() };
        assert!(matches!(huge.encode(), Err(ManifestError::TooLarge { what: "unpacked bytes in a scene", .. })));
        let half = FileExtent { piece: 0, offset: 0, bytes: Manifest::MAX_UNPACKED / 2 + 1 };
        let pieces = vec![piece(b"a", half.bytes)];
        let bomb = Manifest { pieces, files: BTreeMap::from([("a".into(), half), ("b".into(), half)]) };
        assert!(matches!(bomb.encode(), Err(ManifestError::TooLarge { what: "bytes in the files of a scene", .. })));
        let many = Manifest { pieces: vec![piece(b"a", 0); (1 << 16) + 1], ..Manifest::default() };
        assert!(matches!(many.encode(), Err(ManifestError::TooLarge { what: "pieces in a scene", .. })));
    }
}
