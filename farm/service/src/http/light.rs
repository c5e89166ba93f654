//! Questions about recorded light: their parameters, and the answers.

use ::http::{Response, StatusCode};
use serde::Serialize;

use super::error::HttpError;
use super::response::{self, Body};
use super::route::{Query, invalid, number};
use super::{Http, RequestHead};
use crate::access::CallerKey;
use crate::light::{LightAnswer, LightCall, LightCallKind, LightTarget, LightViewError, TaggedAnswer};

/// Maximum number of frames in one question.
const MAX_FRAMES: usize = 64;
/// Maximum number of joint histograms in one answer.
const MAX_PAIRS: usize = 256;
/// Numbers of paths in a representative set.
const PATH_COUNTS: std::ops::RangeInclusive<u32> = 1..=20_000;
const DEFAULT_PATHS: u32 = 5000;
const MAX_LEVEL: u32 = 7;

#[derive(Serialize)]
struct Files<'a> {
    files: Vec<File<'a>>,
}

#[derive(Serialize)]
struct File<'a> {
    file: usize,
    name: &'a str,
    /// Null: the file cannot be read now.
    bytes: Option<u64>,
}

/// Parses the frames of a question, such as `1,3,5..8`.
pub(super) fn frames(query: Query<'_>) -> Result<Vec<u32>, HttpError> {
    let fault = || invalid("frames", "expected frame numbers, such as 1,3,5..8");
    let text = query.get("frames").ok_or_else(fault)?;
    let mut frames = Vec::new();
    for part in text.split(',') {
        let (first, last) = part.split_once("..").unwrap_or((part, part));
        let (first, last): (u32, u32) = first.trim().parse().ok().zip(last.trim().parse().ok()).ok_or_else(fault)?;
        if first > last {
            return Err(fault());
        }
        if frames.len() + (last - first) as usize >= MAX_FRAMES {
            return Err(invalid("frames", &format!("at most {MAX_FRAMES} frames are possible")));
        }
        frames.extend(first..=last);
    }
    frames.sort_unstable();
    frames.dedup();
    Ok(frames)
}

/// Parses the parameters of a call.
pub(super) fn parse_call(call: &str, query: Query<'_>, path: &str) -> Result<LightCall, HttpError> {
    let condition = query.get("where").filter(|text| !text.trim().is_empty());
    let kind = match call {
        "schema" => LightCallKind::Schema,
        "paths" => {
            let count = query.number("count")?.unwrap_or(DEFAULT_PATHS);
            if !PATH_COUNTS.contains(&count) {
                return Err(invalid("count", &format!("expected a number from 1 to {}", PATH_COUNTS.end())));
            }
            let brightest = match query.get("among").as_deref() {
                None | Some("all") => false,
                Some("brightest") => true,
                Some(_) => return Err(invalid("among", "expected all or brightest")),
            };
            LightCallKind::Paths { count, brightest }
        }
        "histograms" => {
            let by_image = match query.get("by").as_deref() {
                None | Some("samples") => false,
                Some("image") => true,
                Some(_) => return Err(invalid("by", "expected samples or image")),
            };
            LightCallKind::Histograms { pairs: pairs(query)?, by_image }
        }
        "voxels" => {
            let level = query.number("level")?.unwrap_or(5);
            if level > MAX_LEVEL {
                return Err(invalid("level", &format!("expected a number from 0 to {MAX_LEVEL}")));
            }
            LightCallKind::Voxels { level, bounce: query.number("bounce")? }
        }
        "selection" => LightCallKind::Selection { with_density: query.get("density").as_deref() == Some("1") },
        _ => return Err(HttpError::UnknownPath { path: path.to_owned() }),
    };
    Ok(LightCall { kind, condition, bounds: bounds(query)? })
}

/// Parses the corners of a box.
fn bounds(query: Query<'_>) -> Result<Option<[[f64; 3]; 2]>, HttpError> {
    let Some(text) = query.get("box") else { return Ok(None) };
    let numbers: Option<Vec<f64>> = text.split(',').map(|part| part.trim().parse().ok()).collect();
    match numbers.as_deref() {
        Some(&[a, b, c, d, e, f])
            if [a, b, c, d, e, f].iter().all(|it| it.is_finite()) && a <= d && b <= e && c <= f =>
        {
            Ok(Some([[a, b, c], [d, e, f]]))
        }
        _ => Err(invalid("box", "expected six numbers: the lower corner and then the upper corner, m")),
    }
}

/// Parses pairs of attributes, such as `paths:0-3,lights:1-2`.
fn pairs(query: Query<'_>) -> Result<Vec<[usize; 3]>, HttpError> {
    let Some(text) = query.get("pairs") else { return Ok(Vec::new()) };
    let mut pairs = Vec::new();
    for part in text.split(',') {
        let fault = || invalid("pairs", &format!("`{part}`: expected a table and two attributes, such as paths:0-3"));
        let (table, axes) = part.split_once(':').ok_or_else(fault)?;
        let table = ["paths", "intersections", "lights"].iter().position(|name| *name == table).ok_or_else(fault)?;
        let (a, b) = axes.split_once('-').ok_or_else(fault)?;
        pairs.push([table, number("pairs", a)?, number("pairs", b)?]);
        if pairs.len() > MAX_PAIRS {
            return Err(invalid("pairs", &format!("at most {MAX_PAIRS} pairs are possible")));
        }
    }
    Ok(pairs)
}

impl<S: Send + 'static> Http<S> {
    /// Answers a question about recorded light.
    pub(super) async fn light(
        &self,
        request_head: &RequestHead<'_>,
        target: LightTarget,
        call: LightCall,
        caller_key: CallerKey,
    ) -> Result<Response<Body>, HttpError> {
        let known = request_head.known_tag();
        let answered = self.0.light.answer(&self.0.farm, &target, call, known, caller_key).await?;
        let Some(TaggedAnswer { tag, answer }) = answered else { return Ok(response::empty(StatusCode::NO_CONTENT)) };
        let mut response = match answer {
            None => response::empty(StatusCode::NOT_MODIFIED),
            Some((LightAnswer::Json(bytes), slot)) => response::large_bytes("application/json", bytes.into(), slot),
            Some((LightAnswer::Columns(bytes), slot)) => {
                response::large_bytes("application/vnd.femc.columns", bytes.into(), slot)
            }
        };
        response::tag(&mut response, &tag);
        Ok(response)
    }

    /// Returns the maps of a statistics file.
    pub(super) async fn file_maps(
        &self,
        request_head: &RequestHead<'_>,
        file: usize,
        caller_key: CallerKey,
    ) -> Result<Response<Body>, HttpError> {
        let known = request_head.known_tag();
        let slot = self.0.pixel_slots.acquire(caller_key).await;
        let drawn = self.0.pictures.file_maps(&self.0.light, file, known).await?;
        let mut response = if known == Some(drawn.tag.as_str()) {
            response::empty(StatusCode::NOT_MODIFIED)
        } else {
            response::large_bytes("application/vnd.femc.pixels", drawn.bytes, slot)
        };
        response::tag(&mut response, &drawn.tag);
        Ok(response)
    }

    /// Lists the files with light statistics beside the farm.
    pub(super) fn light_files(&self) -> Response<Body> {
        let files = self.0.light.files().iter().enumerate().map(|(file, it)| {
            let bytes = std::fs::metadata(&it.path).ok().map(|metadata| metadata.len());
            File { file, name: &it.name, bytes }
        });
        response::json(&Files { files: files.collect() })
    }
}

impl From<LightViewError> for HttpError {
    fn from(error: LightViewError) -> Self {
        match error {
            LightViewError::Invalid { field, message } => Self::Invalid { field: field.into(), message },
            LightViewError::Refused(refusal) => Self::Refused(refusal),
            LightViewError::Unreadable { message } => Self::UnreadableLight { message },
            LightViewError::NoStatistics { job, frame } => {
                Self::NoResult { job, file: format!("light statistics of frame {frame}") }
            }
            LightViewError::NoFile { number } => Self::UnknownPath { path: format!("/api/v1/files/{number}") },
        }
    }
}
