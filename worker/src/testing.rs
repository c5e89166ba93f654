//! What a worker reads and nobody else, as decoders of bytes, for fuzzing.

use bytes::Bytes;
use femc_model::Manifest;

use crate::{outbox, parcel};

/// Whether bytes are a result as the outbox keeps them.
pub fn is_kept_result(bytes: &[u8]) -> bool {
    outbox::decode(&Bytes::copy_from_slice(bytes), crate::engine()).is_some()
}

/// Whether these pieces are those of the manifest, and hold its files.
pub fn is_scene(manifest: &Manifest, pieces: &[Bytes]) -> bool {
    parcel::unpack(manifest, pieces).is_ok()
}
