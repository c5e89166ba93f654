//! Bundles: a scene's files in memory and on the wire.
//!
//! Equal contents have equal encodings (sorted names, fixed-width little-endian lengths, one compression level), so equal scenes
//! have equal digests. Decoding checks the size against the caller's limit before it allocates memory.

use crate::files::{FileSource, MAX_PATH};
use std::{
    collections::BTreeMap,
    io::{self, Read},
};

const MAGIC: &[u8; 8] = b"femcbndl";
const VERSION: u32 = 1;
const LEVEL: i32 = 3;

/// Files by normalized path.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Bundle(pub BTreeMap<String, Vec<u8>>);

/// Error of decoding or encoding a bundle.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum BundleError {
    /// Bytes that [`Bundle::encode`] did not write.
    #[error("not a scene bundle")]
    Magic,
    /// A bundle of another version.
    #[error("the bundle has version {found}; this program reads version {VERSION}")]
    Version {
        /// Version of the bundle.
        found: u32,
    },
    /// A bundle that is too large once decompressed.
    #[error("bundle of {size} bytes exceeds the limit of {limit}")]
    TooLarge {
        /// Size, bytes.
        size: u64,
        /// Limit, bytes.
        limit: u64,
    },
    /// A bundle that is truncated or has invalid content.
    #[error("bundle is damaged")]
    Damaged,
    /// A file name that is not normalized.
    #[error("bundle holds the invalid file name {name:?}")]
    Name {
        /// The name.
        name: String,
    },
}

impl FileSource for Bundle {
    fn size(&self, path: &str) -> io::Result<u64> {
        self.get(path).map(|bytes| bytes.len() as u64)
    }

    fn read(&self, path: &str) -> io::Result<Vec<u8>> {
        self.get(path).cloned()
    }

    fn names(&self, folder: &str) -> Vec<String> {
        let name_in_folder = |path: &String| {
            let (parent, name) = path.rsplit_once('/').unwrap_or(("", path));
            (parent == folder).then(|| name.to_owned())
        };
        self.0.keys().filter_map(name_in_folder).collect()
    }
}

impl Bundle {
    /// Reads `names` (as listed in [`crate::LoadedScene::files`]) from `files`.
    pub fn from_files(files: &dyn FileSource, names: &[String]) -> io::Result<Self> {
        names.iter().map(|name| Ok((name.clone(), files.read(name)?))).collect::<io::Result<_>>().map(Self)
    }

    fn get(&self, path: &str) -> io::Result<&Vec<u8>> {
        self.0.get(path).ok_or_else(|| io::Error::new(io::ErrorKind::NotFound, "not in the bundle"))
    }

    /// Encodes the bundle. Equal bundles give equal bytes. Fails on a name that [`Bundle::decode`] would reject.
    pub fn encode(&self) -> Result<Vec<u8>, BundleError> {
        let mut payload = Vec::new();
        payload.extend((self.0.len() as u64).to_le_bytes());
        for (name, bytes) in &self.0 {
            check_name(name)?;
            payload.extend((name.len() as u32).to_le_bytes());
            payload.extend(name.as_bytes());
            payload.extend((bytes.len() as u64).to_le_bytes());
            payload.extend(bytes);
        }
        let mut out = Vec::from(MAGIC);
        out.extend(VERSION.to_le_bytes());
        out.extend((payload.len() as u64).to_le_bytes());
        out.extend(zstd::bulk::compress(&payload, LEVEL).map_err(|_| BundleError::Damaged)?);
        Ok(out)
    }

    /// Decodes a bundle that has up to `limit` bytes once decompressed.
    pub fn decode(bytes: &[u8], limit: u64) -> Result<Self, BundleError> {
        let mut head = bytes;
        if take_array::<8>(&mut head).is_none_or(|magic| &magic != MAGIC) {
            return Err(BundleError::Magic);
        }
        let found = u32::from_le_bytes(take_array(&mut head).ok_or(BundleError::Damaged)?);
        if found != VERSION {
            return Err(BundleError::Version { found });
        }
        let size = u64::from_le_bytes(take_array(&mut head).ok_or(BundleError::Damaged)?);
        if size > limit {
            return Err(BundleError::TooLarge { size, limit });
        }
        let mut payload = Vec::new();
        let decoder = zstd::stream::read::Decoder::new(head).map_err(|_| BundleError::Damaged)?;
        decoder.take(size + 1).read_to_end(&mut payload).map_err(|_| BundleError::Damaged)?;
        if payload.len() as u64 != size {
            return Err(BundleError::Damaged);
        }
        decode_entries(&payload).map(Self)
    }
}

fn decode_entries(mut rest: &[u8]) -> Result<BTreeMap<String, Vec<u8>>, BundleError> {
    let count = u64::from_le_bytes(take_array(&mut rest).ok_or(BundleError::Damaged)?);
    let mut files = BTreeMap::<String, Vec<u8>>::new();
    for _ in 0..count {
        let length = u64::from(u32::from_le_bytes(take_array(&mut rest).ok_or(BundleError::Damaged)?));
        let name = String::from_utf8(take_slice(&mut rest, length)?.to_vec()).map_err(|_| BundleError::Damaged)?;
        check_name(&name)?;
        if files.last_key_value().is_some_and(|(last, _)| *last >= name) {
            return Err(BundleError::Damaged);
        }
        let length = u64::from_le_bytes(take_array(&mut rest).ok_or(BundleError::Damaged)?);
        files.insert(name, take_slice(&mut rest, length)?.to_vec());
    }
    if rest.is_empty() { Ok(files) } else { Err(BundleError::Damaged) }
}

fn take_array<const N: usize>(rest: &mut &[u8]) -> Option<[u8; N]> {
    let (head, tail) = rest.split_first_chunk::<N>()?;
    *rest = tail;
    Some(*head)
}

fn take_slice<'a>(rest: &mut &'a [u8], length: u64) -> Result<&'a [u8], BundleError> {
    let length = usize::try_from(length).map_err(|_| BundleError::Damaged)?;
    let (head, tail) = rest.split_at_checked(length).ok_or(BundleError::Damaged)?;
    *rest = tail;
    Ok(head)
}

fn check_name(name: &str) -> Result<(), BundleError> {
    let normal = crate::files::resolve("", name).is_ok_and(|path| path == name);
    if normal && name.len() <= MAX_PATH { Ok(()) } else { Err(BundleError::Name { name: name.to_owned() }) }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sample() -> Bundle {
        Bundle(BTreeMap::from([
            ("main.mgf".into(), b"i lamps/a.mgf\n".to_vec()),
            ("lamps/a.mgf".into(), vec![0, 255, 7]),
            ("empty".into(), vec![]),
        ]))
    }

    /// Adds the header to any `payload`.
    fn wrap(payload: &[u8]) -> Vec<u8> {
        let mut out = Vec::from(MAGIC);
        out.extend(VERSION.to_le_bytes());
        out.extend((payload.len() as u64).to_le_bytes());
        out.extend(zstd::bulk::compress(payload, LEVEL).unwrap());
        out
    }

    #[test]
    fn a_bundle_comes_back_and_equal_bundles_have_equal_bytes() {
        let bytes = sample().encode().unwrap();
        assert_eq!(Bundle::decode(&bytes, 1000).unwrap(), sample());
        assert_eq!(sample().encode().unwrap(), bytes);
    }

    #[test]
    fn a_bundle_cut_anywhere_or_flipped_anywhere_never_panics() {
        let bytes = sample().encode().unwrap();
        for n in 0..bytes.len() {
            assert!(Bundle::decode(&bytes[..n], 1000).is_err(), "cut at {n}");
            let mut flipped = bytes.clone();
            flipped[n] ^= 0x55;
            let _ = Bundle::decode(&flipped, 1000);
        }
    }

    #[test]
    fn a_bundle_beyond_the_limit_is_refused_by_its_header() {
        let bytes = Bundle(BTreeMap::from([("zeros".into(), vec![0; 100_000])])).encode().unwrap();
        assert!(matches!(Bundle::decode(&bytes, 1000), Err(BundleError::TooLarge { limit: 1000, .. })));
        let mut lying = bytes;
        lying[12..20].copy_from_slice(&500u64.to_le_bytes());
        assert_eq!(Bundle::decode(&lying, 1000), Err(BundleError::Damaged));
    }

    #[test]
    fn bad_names_are_refused_on_both_sides() {
        let long = ["x".repeat(1025), "x".repeat(4096), "x/".repeat(2048) + "x", "../".repeat(1365)];
        let odd =
            ["/abs", "../up", "a/../b", "..", ".", "a\\b", "nul\0", "", "./x", "a//b", "dir/", "c:x", "c:/x", "a/.."];
        for name in odd.into_iter().chain(long.iter().map(String::as_str)) {
            let bundle = Bundle(BTreeMap::from([(name.to_owned(), vec![])]));
            assert!(matches!(bundle.encode(), Err(BundleError::Name { .. })), "{name:?}");
            let mut payload = 1u64.to_le_bytes().to_vec();
            payload.extend((name.len() as u32).to_le_bytes());
            payload.extend(name.as_bytes());
            payload.extend(0u64.to_le_bytes());
            assert!(matches!(Bundle::decode(&wrap(&payload), 10_000), Err(BundleError::Name { .. })), "{name:?}");
        }
    }

    /// Names in a bundle are exact: two names that a case-insensitive disk would confuse are two files.
    #[test]
    fn duplicate_names_are_refused_and_names_are_case_sensitive() {
        let file = |name: &str| {
            let mut bytes = (name.len() as u32).to_le_bytes().to_vec();
            bytes.extend(name.as_bytes());
            bytes.extend(0u64.to_le_bytes());
            bytes
        };
        let decode = |names: [&str; 2]| {
            let payload = [&2u64.to_le_bytes()[..], &names.map(file).concat()].concat();
            Bundle::decode(&wrap(&payload), 1000)
        };
        assert_eq!(decode(["a", "a"]), Err(BundleError::Damaged));
        assert_eq!(decode(["b", "a"]), Err(BundleError::Damaged));
        let both = decode(["A", "a"]).unwrap();
        assert_eq!(both.0.len(), 2);
    }

    /// 100 bytes that decompress to a gigabyte. No more is decompressed than the header says, and the header is checked against the
    /// limit.
    #[test]
    fn a_bomb_is_not_unpacked() {
        let bomb = zstd::bulk::compress(&vec![0; 1 << 28], LEVEL).unwrap();
        for size in [0u64, 100, 1 << 20] {
            let bytes = [&MAGIC[..], &VERSION.to_le_bytes(), &size.to_le_bytes(), &bomb].concat();
            assert_eq!(Bundle::decode(&bytes, 1 << 20), Err(BundleError::Damaged), "{size}");
        }
        let honest = [&MAGIC[..], &VERSION.to_le_bytes(), &(1u64 << 28).to_le_bytes(), &bomb].concat();
        assert!(matches!(Bundle::decode(&honest, 1 << 20), Err(BundleError::TooLarge { .. })));
    }

    #[test]
    fn a_count_or_length_beyond_the_data_allocates_nothing() {
        assert_eq!(Bundle::decode(&wrap(&u64::MAX.to_le_bytes()), 1000), Err(BundleError::Damaged));
        let mut payload = 1u64.to_le_bytes().to_vec();
        payload.extend(u32::MAX.to_le_bytes());
        assert_eq!(Bundle::decode(&wrap(&payload), 1000), Err(BundleError::Damaged));
    }
}
