//! Packs a scene's files into artifacts and unpacks them.
//!
//! Large files are pieces of their own. Small files share packs, so that a scene of a thousand lamps does not become a thousand
//! artifacts. The files' paths decide where a pack ends, so an edit changes only the pack of the edited file. Pieces are compressed
//! at a fixed level, so that equal files are equal artifacts.

use std::collections::BTreeMap;
use std::io::Read as _;

use bytes::Bytes;
use femc_import::Bundle;
use femc_model::{Artifact, BundlePiece, Digest, FileExtent, Manifest, ManifestError};

/// Smallest size in bytes of a file that is a piece of its own.
const LARGE: usize = 256 << 10;
/// Largest size of a pack in bytes.
const PACK: usize = 1 << 20;
/// A pack also ends after a path whose hash selects it, one path in this many.
const PATHS: u8 = 32;
/// Compression level of zstd.
const LEVEL: i32 = 3;

/// A scene ready to be uploaded.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Parcel {
    /// Encoded manifest, the artifact that a job's `bundle` names.
    pub manifest: Bytes,
    /// All pieces, in the manifest's order.
    pub pieces: Vec<Bytes>,
}

/// Error of packing or unpacking a scene.
#[derive(Debug, thiserror::Error)]
pub enum ParcelError {
    /// The manifest is invalid.
    #[error(transparent)]
    Manifest(#[from] ManifestError),
    /// A piece does not unpack to what the manifest says.
    #[error("piece {digest} of the scene is damaged")]
    Piece {
        /// Digest of the piece.
        digest: Digest,
    },
    /// zstd failed to compress.
    #[error("compression: {0}")]
    Compression(std::io::Error),
}

impl Parcel {
    /// Packs the files of `bundle`. Equal files give equal bytes.
    pub fn pack(bundle: &Bundle) -> Result<Self, ParcelError> {
        let (mut manifest, mut pieces) = (Manifest::default(), Vec::new());
        let mut seal = |content: &[u8], files: &mut Vec<(&String, u64)>| {
            let piece = Bytes::from(zstd::bulk::compress(content, LEVEL).map_err(ParcelError::Compression)?);
            let (index, mut offset) = (manifest.pieces.len() as u32, 0);
            manifest
                .pieces
                .push(BundlePiece { artifact: Artifact::from_bytes(&piece), unpacked: content.len() as u64 });
            pieces.push(piece);
            for (path, bytes) in files.drain(..) {
                manifest.files.insert(path.clone(), FileExtent { piece: index, offset, bytes });
                offset += bytes;
            }
            Ok::<_, ParcelError>(())
        };
        let (mut pack, mut packed) = (Vec::new(), Vec::new());
        for (path, content) in &bundle.0 {
            let size = content.len() as u64;
            if content.len() >= LARGE {
                seal(content, &mut vec![(path, size)])?;
                continue;
            }
            if pack.len() + content.len() > PACK {
                seal(&std::mem::take(&mut pack), &mut packed)?;
            }
            pack.extend_from_slice(content);
            packed.push((path, size));
            if Digest::compute(path.as_bytes()).as_bytes()[0].is_multiple_of(PATHS) {
                seal(&std::mem::take(&mut pack), &mut packed)?;
            }
        }
        if !packed.is_empty() {
            seal(&pack, &mut packed)?;
        }
        Ok(Self { manifest: manifest.encode()?.into(), pieces })
    }

    /// Returns the manifest's digest, the value of a job's `bundle`.
    pub fn digest(&self) -> Digest {
        Digest::compute(&self.manifest)
    }

    /// Returns all artifacts. The manifest comes last, so that it is in the store only if its pieces are.
    pub fn artifacts(&self) -> Vec<Bytes> {
        self.pieces.iter().chain([&self.manifest]).cloned().collect()
    }

    /// Returns the total size of the artifacts in bytes.
    pub fn size(&self) -> u64 {
        self.pieces.iter().chain([&self.manifest]).map(|bytes| bytes.len() as u64).sum()
    }
}

/// Unpacks the files of `manifest` from `pieces`, which are in the manifest's order.
pub(crate) fn unpack(manifest: &Manifest, pieces: &[Bytes]) -> Result<Bundle, ParcelError> {
    let mut contents = Vec::with_capacity(pieces.len());
    for (BundlePiece { artifact, unpacked }, bytes) in manifest.pieces.iter().zip(pieces) {
        contents.push(content(bytes, *unpacked).ok_or(ParcelError::Piece { digest: artifact.digest })?);
    }
    let mut files = BTreeMap::new();
    for (path, extent) in &manifest.files {
        let (start, end) = (extent.offset as usize, (extent.offset + extent.bytes) as usize);
        let piece = contents.get(extent.piece as usize).and_then(|content| content.get(start..end));
        let found = piece.ok_or_else(|| ManifestError::Extent { path: path.clone() })?;
        files.insert(path.clone(), found.to_vec());
    }
    Ok(Bundle(files))
}

/// Unpacks a piece; `None` if it does not have exactly `size` bytes.
fn content(bytes: &[u8], size: u64) -> Option<Vec<u8>> {
    let mut content = Vec::new();
    let decoder = zstd::stream::read::Decoder::new(bytes).ok()?;
    decoder.take(size + 1).read_to_end(&mut content).ok()?;
    (content.len() as u64 == size).then_some(content)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn files(files: &[(&str, Vec<u8>)]) -> Bundle {
        Bundle(files.iter().map(|(path, bytes)| ((*path).to_owned(), bytes.clone())).collect())
    }

    fn noise(size: usize, seed: u64) -> Vec<u8> {
        let mut state = seed;
        let byte = |_| {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (state >> 56) as u8
        };
        (0..size).map(byte).collect()
    }

    fn scene() -> Bundle {
        let mut scene = files(&[
            ("main.mgf", b"i lamps/7.mgf\n".to_vec()),
            ("wall.png", noise(400_000, 1)),
            ("floor.png", noise(LARGE, 2)),
            ("empty", vec![]),
        ]);
        scene.0.extend((0..200).map(|i| (format!("lamps/{i}.ies"), noise(2_000, i))));
        scene
    }

    fn unpacked(parcel: &Parcel) -> Bundle {
        unpack(&Manifest::decode(&parcel.manifest).unwrap(), &parcel.pieces).unwrap()
    }

    #[test]
    fn a_scene_comes_back_and_equal_scenes_are_equal_artifacts() {
        let parcel = Parcel::pack(&scene()).unwrap();
        assert_eq!(unpacked(&parcel), scene());
        assert_eq!(Parcel::pack(&scene()).unwrap(), parcel);
        assert!((3..40).contains(&parcel.pieces.len()), "{} pieces of 204 files", parcel.pieces.len());
        let none = Parcel::pack(&Bundle::default()).unwrap();
        assert_eq!((unpacked(&none), none.pieces.len()), (Bundle::default(), 0));
    }

    #[test]
    fn an_edit_a_new_file_and_a_lost_file_change_one_pack_each() {
        let before = Parcel::pack(&scene()).unwrap();
        let mut edited = scene();
        edited.0.insert("main.mgf".into(), b"i lamps/7.mgf\n# brighter\n".to_vec());
        let mut grown = scene();
        grown.0.insert("lamps/1000.ies".into(), noise(2_000, 1000));
        let mut shrunk = scene();
        shrunk.0.remove("lamps/55.ies");
        for (what, scene) in [("edited", edited), ("grown", grown), ("shrunk", shrunk)] {
            let after = Parcel::pack(&scene).unwrap();
            let new: Vec<_> = after.pieces.iter().filter(|piece| !before.pieces.contains(piece)).collect();
            // The edit may add or remove a path that ends a pack. Then two packs change.
            assert!((1..=2).contains(&new.len()), "{what}: {} of {} pieces", new.len(), after.pieces.len());
            assert!(new.iter().all(|piece| piece.len() < LARGE), "{what}: the images stay");
            assert_ne!(after.digest(), before.digest());
            assert_eq!(unpacked(&after), scene);
        }
    }

    /// Small pieces that would unpack to gigabytes: unpacking stops at the size in the manifest, which has a limit of its own.
    #[test]
    fn a_bomb_is_not_unpacked() {
        let bomb = Bytes::from(zstd::bulk::compress(&vec![0; 1 << 28], LEVEL).unwrap());
        let manifest = |unpacked| Manifest {
            pieces: vec![BundlePiece { artifact: Artifact::from_bytes(&bomb), unpacked }],
            files: BTreeMap::from([("a".to_owned(), FileExtent { piece: 0, offset: 0, bytes: unpacked })]),
        };
        for unpacked in [0, 1, 1 << 20, (1 << 28) - 1] {
            assert!(unpack(&manifest(unpacked), std::slice::from_ref(&bomb)).is_err(), "{unpacked}");
        }
        assert!(matches!(manifest(Manifest::MAX_UNPACKED + 1).encode(), Err(ManifestError::TooLarge { .. })));
        let shared = FileExtent { piece: 0, offset: 0, bytes: 1 << 28 };
        let files = (0..100).map(|n| (n.to_string(), shared)).collect();
        let many = Manifest { files, ..manifest(1 << 28) };
        assert!(matches!(many.encode(), Err(ManifestError::TooLarge { .. })), "one piece as many files");
    }

    #[test]
    fn piece_that_mismatches_manifest_is_refused_by_name() {
        let parcel = Parcel::pack(&scene()).unwrap();
        let manifest = Manifest::decode(&parcel.manifest).unwrap();
        for (at, bad) in [
            (0, Bytes::from_static(b"no zstd")),
            (1, Bytes::from(zstd::bulk::compress(b"too short", LEVEL).unwrap())),
            (2, Bytes::from(zstd::bulk::compress(&vec![0; 50_000_000], LEVEL).unwrap())),
        ] {
            let mut pieces = parcel.pieces.clone();
            pieces[at] = bad;
            let digest = manifest.pieces[at].artifact.digest;
            let error = unpack(&manifest, &pieces).unwrap_err();
            assert!(matches!(error, ParcelError::Piece { digest: named } if named == digest), "{error}");
        }
        assert!(unpack(&manifest, &parcel.pieces[1..]).is_err(), "pieces of others");
        assert!(unpack(&manifest, &parcel.pieces[..1]).is_err(), "too few pieces");
    }
}
