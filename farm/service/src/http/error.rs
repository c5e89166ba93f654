//! Errors of HTTP requests.

use ::http::header::{ACCEPT, ALLOW, CONTENT_RANGE, HeaderValue, RETRY_AFTER};
use ::http::{Response, StatusCode};
use femc_model::{Digest, JobId, Refusal};
use serde_json::json;

use super::RequestHead;
use super::response::{self, Body};
use crate::access::Outcome;

/// Error of a request.
#[derive(Debug, thiserror::Error)]
pub(super) enum HttpError {
    /// Refusal of the farm or of the gate.
    #[error(transparent)]
    Refused(#[from] Refusal),
    /// The path does not exist.
    #[error("unknown path {path}")]
    UnknownPath {
        /// Path of the request.
        path: String,
    },
    /// This build does not include the web page.
    #[error("this coordinator was built without the web page")]
    NoWebPage,
    /// The path does not support the method.
    #[error("{path} supports only {allowed}")]
    Method {
        /// Path of the request.
        path: String,
        /// Supported methods.
        allowed: &'static str,
    },
    /// A parameter, a field or a header is not valid.
    #[error("{field}: {message}")]
    Invalid {
        /// Name of the parameter, field or header.
        field: String,
        /// Fault of the value.
        message: String,
    },
    /// The request comes from a page of another site.
    #[error("the request comes from a page of {origin}, not from a page of this coordinator")]
    CrossSite {
        /// Origin of the page, according to the browser.
        origin: String,
    },
    /// The request names the coordinator with a host name that is not its own.
    #[error(
        "requests for the host {host} are refused: without authentication, the coordinator serves only its own addresses"
    )]
    ForeignHost {
        /// Host of the request.
        host: String,
    },
    /// The token of the address does not sign in a browser any more.
    #[error("this address is not valid any more: it signs in one browser, once, while its `femc view` runs")]
    UsedAddress,
    /// The job does not make this result, or the result is not finished.
    #[error("job {job} has no {file}, or the result is not finished")]
    NoResult {
        /// The job.
        job: JobId,
        /// Description of the result.
        file: String,
    },
    /// The job has no stage that makes geometry.
    #[error("job {job} was submitted without geometry: without `--stats`, or with an earlier version of femc")]
    NoGeometry {
        /// The job.
        job: JobId,
    },
    /// The job has no stage that makes a finite-element solution for viewers.
    #[error(
        "job {job} has no finite-element solution to look at: its method has no first pass, or it was submitted without \
         `--stats` or with an earlier version of femc"
    )]
    NoSolution {
        /// The job.
        job: JobId,
    },
    /// The job learns no targets.
    #[error(
        "job {job} learns no targets: its method does not guide paths by targets, or an earlier version of femc submitted it"
    )]
    NoTargets {
        /// The job.
        job: JobId,
    },
    /// A file with light statistics contains no scene.
    #[error("file {file} contains recorded paths but no scene, so it has no geometry and no finite-element solution")]
    NoFileModel {
        /// Number of the file.
        file: usize,
    },
    /// A result is damaged or missing in the store.
    #[error("{file} of job {job} is damaged or missing in the farm's store")]
    ResultLost {
        /// The job.
        job: JobId,
        /// Description of the result.
        file: String,
    },
    /// The light statistics of a frame are damaged or missing in the store.
    #[error(
        "frame {frame} of job {job}: its light statistics are damaged or missing in the farm's store (artifact {digest})"
    )]
    LightLost {
        /// The job.
        job: JobId,
        /// The frame.
        frame: u32,
        /// Digest of the statistics.
        digest: Digest,
    },
    /// Light statistics cannot be read.
    #[error("{message}")]
    UnreadableLight {
        /// Name of the source, and its fault.
        message: String,
    },
    /// The requested range starts past the end of the file.
    #[error("Range: the file has only {length} bytes")]
    Range {
        /// Size of the file in bytes.
        length: u64,
    },
    /// The body is too large.
    #[error("the request body exceeds {limit} bytes")]
    TooLarge {
        /// Limit in bytes.
        limit: usize,
    },
    /// The headers are too large.
    #[error("the request headers exceed {limit} bytes")]
    HeadersTooLarge {
        /// Limit in bytes. Each header counts 32 bytes in addition to its name and value.
        limit: u32,
    },
    /// The body cannot be read.
    #[error("cannot read the request body: {message}")]
    UnreadableBody {
        /// Error of the transfer.
        message: String,
    },
}

impl HttpError {
    fn status(&self) -> StatusCode {
        match self {
            Self::Refused(refusal) => match refusal {
                Refusal::NoSuchJob { .. } | Refusal::NoSuchWorker { .. } | Refusal::NoSuchArtifact { .. } => {
                    StatusCode::NOT_FOUND
                }
                Refusal::Ended { .. }
                | Refusal::StaleEpoch
                | Refusal::MissingArtifacts { .. }
                | Refusal::Resume { .. } => StatusCode::CONFLICT,
                Refusal::Invalid { .. } | Refusal::DigestMismatch { .. } => StatusCode::BAD_REQUEST,
                // Over HTTP, this refusal means only that the caller made too many calls per second.
                Refusal::TooLarge { .. } => StatusCode::TOO_MANY_REQUESTS,
                Refusal::ArtifactTooLarge { .. } => StatusCode::PAYLOAD_TOO_LARGE,
                Refusal::NoRoom { .. } | Refusal::Unavailable { .. } => StatusCode::SERVICE_UNAVAILABLE,
                Refusal::Forbidden { .. } => StatusCode::FORBIDDEN,
                Refusal::Unauthenticated { .. } => StatusCode::UNAUTHORIZED,
            },
            Self::UnknownPath { .. }
            | Self::NoWebPage
            | Self::NoResult { .. }
            | Self::NoGeometry { .. }
            | Self::NoSolution { .. }
            | Self::NoTargets { .. }
            | Self::NoFileModel { .. }
            | Self::ResultLost { .. }
            | Self::LightLost { .. } => StatusCode::NOT_FOUND,
            Self::UnreadableLight { .. } => StatusCode::UNPROCESSABLE_ENTITY,
            Self::Range { .. } => StatusCode::RANGE_NOT_SATISFIABLE,
            Self::Method { .. } => StatusCode::METHOD_NOT_ALLOWED,
            Self::Invalid { .. } => StatusCode::BAD_REQUEST,
            Self::UsedAddress => StatusCode::GONE,
            Self::CrossSite { .. } | Self::ForeignHost { .. } => StatusCode::FORBIDDEN,
            Self::TooLarge { .. } => StatusCode::PAYLOAD_TOO_LARGE,
            Self::HeadersTooLarge { .. } => StatusCode::REQUEST_HEADER_FIELDS_TOO_LARGE,
            Self::UnreadableBody { .. } => StatusCode::REQUEST_TIMEOUT,
        }
    }

    /// Returns the error code: one word, for programs.
    pub(super) fn code(&self) -> &'static str {
        match self {
            Self::Refused(refusal) => code(refusal),
            Self::UnknownPath { .. }
            | Self::NoWebPage
            | Self::NoResult { .. }
            | Self::NoGeometry { .. }
            | Self::NoSolution { .. }
            | Self::NoTargets { .. }
            | Self::NoFileModel { .. } => "not_found",
            Self::ResultLost { .. } | Self::LightLost { .. } => "lost",
            Self::UnreadableLight { .. } => "unreadable",
            Self::Range { .. } => "range",
            Self::Method { .. } => "method_not_allowed",
            Self::Invalid { .. } => "invalid",
            Self::UsedAddress => "used",
            Self::CrossSite { .. } => "cross_site",
            Self::ForeignHost { .. } => "foreign_host",
            Self::TooLarge { .. } => "too_large",
            Self::HeadersTooLarge { .. } => "headers_too_large",
            Self::UnreadableBody { .. } => "cut",
        }
    }

    /// Returns advice for the user.
    fn help(&self) -> &'static str {
        match self {
            Self::Refused(refusal) => match refusal {
                Refusal::NoSuchJob { .. } => "GET /api/v1/jobs lists the jobs",
                Refusal::NoSuchWorker { .. } => "GET /api/v1/feed lists the workers",
                Refusal::NoSuchArtifact { .. } => {
                    "the artifact may have been deleted; request its current digest again"
                }
                Refusal::Ended { .. } => "retry the job if it has unfinished tasks",
                Refusal::Invalid { .. } => "see docs/http.md for the parameters",
                Refusal::TooLarge { .. } => "wait a second, then send requests less often",
                Refusal::NoRoom { .. } => "free disk space there (`femc gc`)",
                Refusal::Unavailable { .. } => "retry in a few seconds",
                Refusal::Forbidden { .. } => "ask the farm's admin for an identity with that role (`femc ca`)",
                Refusal::Unauthenticated { .. } => {
                    "POST /login with a token from `femc ca token`, or send the token as `Authorization: Bearer TOKEN`"
                }
                Refusal::StaleEpoch
                | Refusal::DigestMismatch { .. }
                | Refusal::ArtifactTooLarge { .. }
                | Refusal::MissingArtifacts { .. }
                | Refusal::Resume { .. } => "use `femc submit`",
            },
            Self::UnknownPath { .. } => "see docs/http.md for all paths; the paths of the API begin with /api/v1",
            Self::NoWebPage => "GET /api/v1/jobs and /api/v1/feed return JSON; see docs/http.md for all paths",
            Self::Method { .. } | Self::Invalid { .. } => "see docs/http.md for methods, headers and parameters",
            Self::CrossSite { .. } => "use the coordinator's own page, or a program, which sends no Origin header",
            Self::ForeignHost { .. } => {
                "use its address, such as http://127.0.0.1:PORT; host names need a coordinator with --identity or --token-file"
            }
            Self::UsedAddress => "open the latest address in the terminal of `femc view`, or run the command again",
            Self::NoResult { .. } => {
                "GET /api/v1/jobs/JOB/frames lists the `outputs` of finished frames; frame 0 has the outputs of the whole job"
            }
            Self::NoGeometry { .. } => "submit the job again with `--stats`; the recorded light has voxels",
            Self::NoSolution { .. } => "submit the job again with `--stats` and `--method femc`",
            Self::NoTargets { .. } => "submit the job again with `--method femc`",
            Self::NoFileModel { .. } => "open the job of the scene in a farm; the recorded light has voxels",
            Self::ResultLost { .. } | Self::LightLost { .. } => {
                "the farm makes the result again (if the job failed or was cancelled: after a retry); \
                 request it when it is finished"
            }
            Self::UnreadableLight { .. } => {
                "render the frame again with `--stats`, by the same version of femc as this program"
            }
            Self::Range { .. } => "request a range within the file, or the whole file without `Range`",
            Self::TooLarge { .. } => "send a smaller body",
            Self::HeadersTooLarge { .. } => "send fewer or shorter headers, such as cookies",
            Self::UnreadableBody { .. } => "send the complete request again without pauses",
        }
    }

    /// Returns the outcome for the audit log.
    pub(super) fn outcome(&self) -> Outcome {
        match self {
            Self::Refused(Refusal::Forbidden { .. } | Refusal::Unauthenticated { .. } | Refusal::TooLarge { .. })
            | Self::CrossSite { .. }
            | Self::ForeignHost { .. }
            | Self::UsedAddress
            | Self::TooLarge { .. }
            | Self::HeadersTooLarge { .. } => Outcome::Refused,
            Self::Refused(_)
            | Self::UnknownPath { .. }
            | Self::NoWebPage
            | Self::Method { .. }
            | Self::Invalid { .. }
            | Self::NoResult { .. }
            | Self::NoGeometry { .. }
            | Self::NoSolution { .. }
            | Self::NoTargets { .. }
            | Self::NoFileModel { .. }
            | Self::ResultLost { .. }
            | Self::LightLost { .. }
            | Self::UnreadableLight { .. }
            | Self::Range { .. }
            | Self::UnreadableBody { .. } => Outcome::Failed,
        }
    }

    /// Makes the response: JSON, or a small page if a browser shows it to a user.
    pub(super) fn response(&self, request_head: &RequestHead<'_>) -> Response<Body> {
        let status = self.status();
        let accepts = request_head.headers.get(ACCEPT).and_then(|accept| accept.to_str().ok()).unwrap_or_default();
        let is_for_people = !request_head.uri.path().starts_with("/api/") && accepts.contains("text/html");
        let mut response = if is_for_people {
            response::message_page(status, &self.to_string(), self.help())
        } else {
            let error = json!({ "code": self.code(), "message": self.to_string(), "help": self.help() });
            response::json_with(status, &json!({ "error": error }))
        };
        if let Self::Method { allowed, .. } = self {
            response.headers_mut().insert(ALLOW, HeaderValue::from_static(allowed));
        }
        if let Self::Range { length } = self {
            let range = HeaderValue::try_from(format!("bytes */{length}"));
            response.headers_mut().extend(range.ok().map(|range| (CONTENT_RANGE, range)));
        }
        if matches!(status, StatusCode::TOO_MANY_REQUESTS | StatusCode::SERVICE_UNAVAILABLE) {
            response.headers_mut().insert(RETRY_AFTER, HeaderValue::from_static("2"));
        }
        response
    }
}

/// Returns the refusal in one word.
pub(super) fn code(refusal: &Refusal) -> &'static str {
    match refusal {
        Refusal::NoSuchJob { .. } | Refusal::NoSuchWorker { .. } | Refusal::NoSuchArtifact { .. } => "not_found",
        Refusal::Ended { .. } => "ended",
        Refusal::Invalid { .. } => "invalid",
        Refusal::StaleEpoch => "stale_epoch",
        Refusal::DigestMismatch { .. } => "digest_mismatch",
        Refusal::TooLarge { .. } => "too_many",
        Refusal::ArtifactTooLarge { .. } => "too_large",
        Refusal::MissingArtifacts { .. } => "missing_artifacts",
        Refusal::Resume { .. } => "resume",
        Refusal::Forbidden { .. } => "forbidden",
        Refusal::Unavailable { .. } => "unavailable",
        Refusal::NoRoom { .. } => "no_room",
        Refusal::Unauthenticated { .. } => "unauthenticated",
    }
}
