//! The files of a job's scene: from what is kept near, else from the farm's store.

use bytes::Bytes;
use femc_fault::{Point, pass};
use femc_import::Bundle;
use femc_model::{Artefact, Digest, Failure, Manifest};
use femc_proto::Client;

use crate::Pieces;
use crate::fetch::Fetch;
use crate::parcel;

/// Pieces that are downloaded side by side.
const BATCH: usize = 16;

/// The scene that `name` names.
pub(crate) fn gather(name: &Digest, client: &Client, fetch: &Fetch, pieces: &Pieces) -> Result<Bundle, Failure> {
    let bytes = match pieces.get(name) {
        Some(bytes) => bytes,
        None => {
            let bytes = fetch.scene(client, name)?;
            pieces.keep(name, &bytes);
            bytes
        }
    };
    if !Manifest::is_one(&bytes) {
        return Bundle::decode(&bytes, Manifest::MOST_UNPACKED).map_err(|error| lost(name, &[], &error));
    }
    let manifest = Manifest::decode(&bytes).map_err(|error| lost(name, &[], &error))?;
    let artefacts: Vec<Artefact> = manifest.pieces.iter().map(|piece| piece.artefact).collect();
    let contents = contents(name, &artefacts, client, fetch, pieces)?;
    parcel::unpack(&manifest, &contents).map_err(|error| lost(name, &[], &error))
}

fn contents(
    name: &Digest,
    artefacts: &[Artefact],
    client: &Client,
    fetch: &Fetch,
    pieces: &Pieces,
) -> Result<Vec<Bytes>, Failure> {
    let mut contents: Vec<Option<Bytes>> = artefacts.iter().map(|artefact| pieces.get(&artefact.digest)).collect();
    let missing: Vec<usize> = (0..artefacts.len()).filter(|&index| contents[index].is_none()).collect();
    for batch in missing.chunks(BATCH) {
        pass(Point::WorkerMidFetch);
        let wanted: Vec<Artefact> = batch.iter().map(|&index| artefacts[index]).collect();
        for (&index, bytes) in batch.iter().zip(fetch.all(client, &wanted)) {
            let bytes = bytes.map_err(|failure| match failure {
                Failure::LostInputs { digests, message } => lost(name, &digests, &message),
                other => other,
            })?;
            pieces.keep(&artefacts[index].digest, &bytes);
            contents[index] = Some(bytes);
        }
    }
    Ok(contents.into_iter().flatten().collect())
}

/// A scene that is not whole: named by its own digest too, which the scheduler knows.
fn lost(name: &Digest, digests: &[Digest], message: &dyn std::fmt::Display) -> Failure {
    let digests = digests.iter().chain([name]).copied().collect();
    Failure::LostInputs { digests, message: format!("the scene is not whole: {message}; submit it again") }
}
