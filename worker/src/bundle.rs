//! Reads the files of a job's scene from the local piece cache or, if they are missing there, from the farm's store.

use bytes::Bytes;
use femc_fault::{Point, pass_point};
use femc_import::Bundle;
use femc_model::{Artifact, Digest, Failure, Manifest};
use femc_proto::Client;

use crate::PieceCache;
use crate::fetch::Fetcher;
use crate::parcel;

/// Number of pieces downloaded in parallel.
const BATCH: usize = 16;

/// Returns the files of the scene whose manifest has the digest `name`.
pub(crate) fn fetch_bundle(
    name: &Digest,
    client: &Client,
    fetch: &Fetcher,
    pieces: &PieceCache,
) -> Result<Bundle, Failure> {
    let bytes = match pieces.get(name) {
        Some(bytes) => bytes,
        None => {
            let bytes = fetch.manifest_or_scene(client, name)?;
            pieces.insert(name, &bytes);
            bytes
        }
    };
    if !Manifest::is_manifest(&bytes) {
        return Bundle::decode(&bytes, Manifest::MAX_UNPACKED).map_err(|error| lost_scene_failure(name, &[], &error));
    }
    let manifest = Manifest::decode(&bytes).map_err(|error| lost_scene_failure(name, &[], &error))?;
    let artifacts: Vec<Artifact> = manifest.pieces.iter().map(|piece| piece.artifact).collect();
    let contents = contents(name, &artifacts, client, fetch, pieces)?;
    parcel::unpack(&manifest, &contents).map_err(|error| lost_scene_failure(name, &[], &error))
}

fn contents(
    name: &Digest,
    artifacts: &[Artifact],
    client: &Client,
    fetch: &Fetcher,
    pieces: &PieceCache,
) -> Result<Vec<Bytes>, Failure> {
    let mut contents: Vec<Option<Bytes>> = artifacts.iter().map(|artifact| pieces.get(&artifact.digest)).collect();
    let missing: Vec<usize> = (0..artifacts.len()).filter(|&index| contents[index].is_none()).collect();
    for batch in missing.chunks(BATCH) {
        pass_point(Point::WorkerMidFetch);
        let wanted: Vec<Artifact> = batch.iter().map(|&index| artifacts[index]).collect();
        for (&index, bytes) in batch.iter().zip(fetch.fetch_all(client, &wanted)) {
            let bytes = bytes.map_err(|failure| match failure {
                Failure::LostInputs { digests, message } => lost_scene_failure(name, &digests, &message),
                other => other,
            })?;
            pieces.insert(&artifacts[index].digest, &bytes);
            contents[index] = Some(bytes);
        }
    }
    Ok(contents.into_iter().flatten().collect())
}

/// Reports an incomplete scene. The lost inputs include the scene's own digest, because the scheduler knows that one.
fn lost_scene_failure(name: &Digest, digests: &[Digest], message: &dyn std::fmt::Display) -> Failure {
    let digests = digests.iter().chain([name]).copied().collect();
    Failure::LostInputs { digests, message: format!("the scene is incomplete: {message}; submit it again") }
}
