//! Decoders of bytes that only workers read, for fuzzing.

use bytes::Bytes;
use femc_model::Manifest;

use crate::{outbox, parcel};

/// Checks that bytes decode as a result in the outbox.
pub fn is_stored_result(bytes: &[u8]) -> bool {
    outbox::decode(&Bytes::copy_from_slice(bytes), crate::engine()).is_some()
}

/// Checks that these pieces match the manifest and contain its files.
pub fn is_scene(manifest: &Manifest, pieces: &[Bytes]) -> bool {
    parcel::unpack(manifest, pieces).is_ok()
}
