//! Downloads of job results, whole or in parts. They are streamed from the store, so that an image of any size needs little memory.
//!
//! The bytes are read and checked before the first of them is sent, so that a damaged file gives an error response and not a broken
//! download. This reads a file twice; the second time the operating system usually has it in its cache. A part that starts later in
//! the file, as players request when they seek, is sent without this check if the file was stored or read recently.

use std::io;
use std::ops::Range;

use ::http::header::{
    ACCEPT_RANGES, CACHE_CONTROL, CONTENT_DISPOSITION, CONTENT_LENGTH, CONTENT_RANGE, CONTENT_TYPE, ETAG, HeaderValue,
};
use ::http::{Method, Response, StatusCode};
use bytes::Bytes;
use femc_model::{Artifact, JobId, JobSpec};
use femc_store::{Integrity, Store, StoreError};
use futures_util::Stream;
use futures_util::stream::unfold;

use super::error::HttpError;
use super::range::{self, RequestedRange};
use super::response::{self, Body};
use super::{Http, RequestHead};
use crate::access::{CallerKey, TransferSlot};
use crate::call::{Call, JobShape};
use crate::farm::Farm;
use crate::file::{FrameFile, FrameModel, ResultFile, media_type};
use crate::job_control::store_refusal;

/// Number of first bytes that determine the media type.
const HEAD: u64 = 64;

/// A result of a job, with its bytes.
#[derive(Clone, Copy)]
struct ResultOf {
    job: JobId,
    file: ResultFile,
    artifact: Artifact,
}

impl<S: Send + 'static> Http<S> {
    /// Answers with a result of a job, or with a part of it.
    pub(super) async fn download(
        &self,
        request_head: &RequestHead<'_>,
        job: JobId,
        file: ResultFile,
        caller_key: CallerKey,
    ) -> Result<Response<Body>, HttpError> {
        let JobShape { spec, .. } = self.0.farm.call(|reply| Call::Shape { job, reply }).await?;
        let records = self.0.farm.call(|reply| Call::Frames { job, reply }).await?;
        let artifact =
            file.artifact(&spec, &records).ok_or_else(|| HttpError::NoResult { job, file: file.describe() })?;
        self.send_result(request_head, &spec, ResultOf { job, file, artifact }, caller_key).await
    }

    /// Answers with the model of the frame that is nearest to `frame` among those that have one; 204: there is none yet.
    pub(super) async fn model(
        &self,
        request_head: &RequestHead<'_>,
        job: JobId,
        (model, frame): (FrameModel, Option<u32>),
        caller_key: CallerKey,
    ) -> Result<Response<Body>, HttpError> {
        let JobShape { spec, .. } = self.0.farm.call(|reply| Call::Shape { job, reply }).await?;
        let file = model.file();
        let role = file.role();
        if !spec.graph.stages.iter().any(|stage| stage.outputs.contains(&role)) {
            return Err(match model {
                FrameModel::Geometry => HttpError::NoGeometry { job },
                FrameModel::Solution => HttpError::NoSolution { job },
                FrameModel::Targets => HttpError::NoTargets { job },
            });
        }
        let finished = self.0.farm.call(|reply| Call::Frames { job, reply }).await?;
        let mut made: Vec<(u32, Artifact)> =
            finished.iter().filter_map(|record| Some((record.frame, record.output(role)?))).collect();
        let wanted = frame.unwrap_or(0);
        if made.iter().all(|(finished, _)| *finished != wanted) {
            let unfinished = self.0.farm.call(|reply| Call::Parts { job, reply }).await?;
            made.extend(unfinished.iter().filter_map(|parts| {
                let output = parts.outputs.iter().find(|output| output.role == role)?;
                Some((parts.frame, output.artifact))
            }));
        }
        // Of two frames at equal distance, the earlier one is chosen.
        let Some((nearest, artifact)) = made.into_iter().min_by_key(|&(frame, _)| (frame.abs_diff(wanted), frame))
        else {
            return Ok(response::empty(StatusCode::NO_CONTENT));
        };
        let file = ResultFile::Frame(nearest, file);
        self.send_result(request_head, &spec, ResultOf { job, file, artifact }, caller_key).await
    }

    /// Answers with an artifact, or with a part of it.
    async fn send_result(
        &self,
        request_head: &RequestHead<'_>,
        spec: &JobSpec,
        ResultOf { job, file, artifact }: ResultOf,
        caller_key: CallerKey,
    ) -> Result<Response<Body>, HttpError> {
        let tag = format!("\"{}\"", artifact.digest);
        if range::is_cached_by_client(request_head.headers, &tag) {
            return Ok(with_cache_headers(response::empty(StatusCode::NOT_MODIFIED), &tag));
        }
        let is_head = *request_head.method == Method::HEAD;
        // Ranges are defined for GET only.
        let requested = if is_head {
            RequestedRange::Whole
        } else {
            range::requested_range(request_head.headers, artifact.bytes, &tag)
        };
        let slot = self.0.transfer_slots.acquire(caller_key).await;
        let is_sound = match &requested {
            _ if is_head => self.0.store.size(&artifact.digest).await.map(|size| size == Some(artifact.bytes)),
            RequestedRange::Unsatisfiable => Ok(true),
            RequestedRange::Part(part) if part.start > 0 => {
                self.0.store.verify_unless_recent(&artifact).await.map(is_intact)
            }
            RequestedRange::Part(_) | RequestedRange::Whole => {
                self.0.store.verify(&artifact.digest).await.map(is_intact)
            }
        };
        let media = match is_sound {
            Ok(true) => self.media_type(file, &artifact).await,
            Ok(false) => Err(StoreError::Missing { digest: artifact.digest }),
            Err(error) => Err(error),
        };
        let (kind, extension) = match media {
            Ok(media) => media,
            Err(error) => return Err(self.unreadable(job, file, &artifact, &error).await),
        };
        let (status, part) = match requested {
            RequestedRange::Whole => (StatusCode::OK, 0..artifact.bytes),
            RequestedRange::Part(part) => (StatusCode::PARTIAL_CONTENT, part),
            RequestedRange::Unsatisfiable => return Err(HttpError::Range { length: artifact.bytes }),
        };
        let length = part.end - part.start;
        let mut response = if is_head {
            let mut response = response::empty(status);
            response.headers_mut().insert(CONTENT_LENGTH, length.into());
            response
        } else {
            let (store, farm) = (self.0.store.clone(), self.0.farm.clone());
            let mut sending =
                DownloadStream { store, farm, artifact, part: part.clone(), block: Bytes::new(), _slot: slot };
            // Reads the first block before the status is sent, so that a missing file gives an error response.
            match sending.fill().await {
                Ok(()) => response::stream(status, length, pieces(sending)),
                Err(error) => return Err(self.unreadable(job, file, &artifact, &error).await),
            }
        };
        let headers = response.headers_mut();
        headers.insert(CONTENT_TYPE, HeaderValue::from_static(kind));
        headers.insert(ACCEPT_RANGES, HeaderValue::from_static("bytes"));
        if status == StatusCode::PARTIAL_CONTENT {
            let range = format!("bytes {}-{}/{}", part.start, part.end - 1, artifact.bytes);
            headers.extend(HeaderValue::try_from(range).ok().map(|range| (CONTENT_RANGE, range)));
        }
        let disposition = HeaderValue::try_from(disposition(&file.name(spec, extension)));
        headers.extend(disposition.ok().map(|disposition| (CONTENT_DISPOSITION, disposition)));
        Ok(with_cache_headers(response, &tag))
    }

    /// Returns the media type and the usual extension of a result.
    async fn media_type(
        &self,
        file: ResultFile,
        artifact: &Artifact,
    ) -> Result<(&'static str, &'static str), StoreError> {
        match file {
            ResultFile::Frame(_, FrameFile::Image | FrameFile::Layers) => Ok(("image/x-exr", "exr")),
            ResultFile::Frame(_, FrameFile::Statistics) => Ok(("application/octet-stream", "paths")),
            ResultFile::Frame(_, FrameFile::Geometry | FrameFile::Solution) => Ok(("model/gltf-binary", "glb")),
            ResultFile::Frame(_, FrameFile::Readings | FrameFile::Targets) => Ok(("application/json", "json")),
            ResultFile::Sheet | ResultFile::Frame(..) => Ok(("image/png", "png")),
            ResultFile::Clip => {
                let head = self.0.store.read_range(&artifact.digest, 0..artifact.bytes.min(HEAD)).await;
                Ok(media_type(&head?))
            }
        }
    }

    /// Explains why a result cannot be read. A damaged or missing result is recreated.
    async fn unreadable(&self, job: JobId, file: ResultFile, artifact: &Artifact, error: &StoreError) -> HttpError {
        match error {
            StoreError::Missing { .. } | StoreError::Mismatch { .. } => {
                report_unless_intact(&self.0.store, &self.0.farm, artifact).await;
                HttpError::ResultLost { job, file: file.describe() }
            }
            StoreError::Unsound { .. }
            | StoreError::TooLarge { .. }
            | StoreError::Url { .. }
            | StoreError::Medium { .. } => store_refusal(error).into(),
        }
    }
}

fn is_intact(found: Integrity) -> bool {
    matches!(found, Integrity::Intact(_))
}

/// Rereads an artifact, and reports it to the farm if it is damaged or missing.
async fn report_unless_intact<S>(store: &Store, farm: &Farm<S>, artifact: &Artifact) {
    if matches!(store.verify(&artifact.digest).await, Ok(Integrity::Damaged | Integrity::Missing)) {
        farm.report_lost(artifact.digest).await;
    }
}

fn with_cache_headers(mut response: Response<Body>, tag: &str) -> Response<Body> {
    let headers = response.headers_mut();
    // A hexadecimal digest is always a valid header value.
    headers.extend(HeaderValue::try_from(tag).ok().map(|tag| (ETAG, tag)));
    headers.insert(CACHE_CONTROL, HeaderValue::from_static("private, no-cache"));
    response
}

/// A file that is being sent to a client.
struct DownloadStream<S> {
    store: Store,
    farm: Farm<S>,
    artifact: Artifact,
    /// Part that has not been read yet.
    part: Range<u64>,
    /// Bytes that were read but not sent yet.
    block: Bytes,
    /// Held until all bytes are sent or the client has disconnected.
    _slot: TransferSlot,
}

impl<S> DownloadStream<S> {
    /// Reads the next block, if all bytes read so far are sent.
    async fn fill(&mut self) -> Result<(), StoreError> {
        if self.block.is_empty() && !self.part.is_empty() {
            let end = self.part.end.min(self.part.start + Store::READ_SIZE);
            self.block = self.store.read_range(&self.artifact.digest, self.part.start..end).await?;
            self.part.start = end;
        }
        Ok(())
    }
}

/// Returns the pieces of a file. If the rest cannot be read, the last piece is an error.
fn pieces<S: Send + 'static>(stream: DownloadStream<S>) -> impl Stream<Item = io::Result<Bytes>> + Send + 'static {
    /// Maximum size in bytes of a piece of the body.
    const PIECE: usize = 256 << 10;
    unfold(Some(stream), |sending| async {
        let mut sending = sending?;
        if let Err(error) = sending.fill().await {
            tracing::warn!(digest = %sending.artifact.digest, %error, "download aborted");
            report_unless_intact(&sending.store, &sending.farm, &sending.artifact).await;
            return Some((Err(io::Error::other(error.to_string())), None));
        }
        let block = &mut sending.block;
        let piece = block.split_to(block.len().min(PIECE));
        (!piece.is_empty()).then_some((Ok(piece), Some(sending)))
    })
}

/// Returns the header with which browsers save the response under this name (RFC 6266). Any characters are permitted. Programs that
/// do not know the extended form get a name in ASCII.
fn disposition(name: &str) -> String {
    let is_plain = |c: char| c == ' ' || (c.is_ascii_graphic() && !matches!(c, '"' | '\\' | '%' | '/'));
    let plain: String = name.chars().map(|c| if is_plain(c) { c } else { '_' }).collect();
    if plain == name {
        return format!("attachment; filename=\"{plain}\"");
    }
    let mut encoded = String::new();
    for byte in name.replace(['/', '\\'], "_").bytes() {
        // Characters that RFC 8187 permits without encoding.
        if byte.is_ascii_alphanumeric() || b"!#$&+-.^_`|~".contains(&byte) {
            encoded.push(char::from(byte));
        } else {
            encoded.push_str(&format!("%{byte:02X}"));
        }
    }
    format!("attachment; filename=\"{plain}\"; filename*=UTF-8''{encoded}")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn any_file_name_becomes_safe_one_line_header() {
        for (name, due) in [
            ("drive.0003.exr", "attachment; filename=\"drive.0003.exr\""),
            ("night drive; 2.png", "attachment; filename=\"night drive; 2.png\""),
            ("a\"b.png", "attachment; filename=\"a_b.png\"; filename*=UTF-8''a%22b.png"),
            ("50%.png", "attachment; filename=\"50_.png\"; filename*=UTF-8''50%25.png"),
            ("Straße.png", "attachment; filename=\"Stra_e.png\"; filename*=UTF-8''Stra%C3%9Fe.png"),
            ("../x.png", "attachment; filename=\".._x.png\"; filename*=UTF-8''.._x.png"),
            ("a\r\nb.png", "attachment; filename=\"a__b.png\"; filename*=UTF-8''a%0D%0Ab.png"),
        ] {
            assert_eq!(disposition(name), due);
            assert!(HeaderValue::try_from(due).is_ok(), "{name}");
        }
    }
}
