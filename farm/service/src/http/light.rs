//! Questions about recorded light: their parameters, and the answers.

use ::http::{Response, StatusCode};
use serde::Serialize;

use super::error::HttpError;
use super::response::{self, Body};
use super::route::{Query, invalid, number};
use super::{Http, RequestHead};
use crate::access::CallerKey;
use crate::light::{
    AxisPairs, Corners, LightAnswer, LightCall, LightCallKind, LightQuestion, LightTarget, LightViewError, PathCount,
    TaggedAnswer, VoxelLevel,
};
use crate::picture::ComparedPicture;

/// Maximum number of frames in one question.
const MAX_FRAMES: usize = 64;

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

/// Parses a picture to compare: `JOB/FRAME`, or the number of a file.
pub(super) fn compared(field: &str, query: Query<'_>) -> Result<ComparedPicture, HttpError> {
    let text = query.get(field).ok_or_else(|| invalid(field, "expected JOB/FRAME, or the number of a file"))?;
    match text.split_once('/') {
        Some((job, frame)) => Ok(ComparedPicture::Frame(number(field, job)?, number(field, frame)?)),
        None => Ok(ComparedPicture::File(number(field, &text)?)),
    }
}

/// Parses a question.
pub(super) fn parse_question(
    target: LightTarget,
    call: &str,
    query: Query<'_>,
    path: &str,
) -> Result<LightQuestion, HttpError> {
    let call = parse_call(call, query, path)?;
    let since = query.get("since").filter(|_| matches!(call.kind, LightCallKind::Paths { .. }));
    Ok(LightQuestion { target, call, since })
}

/// Parses the parameters of a call.
fn parse_call(call: &str, query: Query<'_>, path: &str) -> Result<LightCall, HttpError> {
    let condition = query.get("where").filter(|text| !text.trim().is_empty());
    let kind = match call {
        "schema" => LightCallKind::Schema,
        "paths" => {
            let fault = || invalid("count", &format!("expected a number from 1 to {}", PathCount::MAX));
            let count = query.number("count")?.map(|count| PathCount::new(count).ok_or_else(fault));
            let count = count.transpose()?.unwrap_or_default();
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
            let fault = || invalid("level", &format!("expected a number from 0 to {}", VoxelLevel::MAX));
            let level = query.number("level")?.map(|level| VoxelLevel::new(level).ok_or_else(fault));
            let level = level.transpose()?.unwrap_or_default();
            LightCallKind::Voxels { level, bounce: query.number("bounce")? }
        }
        "summary" => LightCallKind::Summary,
        "selection" => LightCallKind::Selection { with_density: query.get("density").as_deref() == Some("1") },
        _ => return Err(HttpError::UnknownPath { path: path.to_owned() }),
    };
    Ok(LightCall { kind, condition, bounds: bounds(query)? })
}

/// Parses the corners of a box.
fn bounds(query: Query<'_>) -> Result<Option<Corners>, HttpError> {
    let Some(text) = query.get("box") else { return Ok(None) };
    let numbers: Option<Vec<f64>> = text.split(',').map(|part| part.trim().parse().ok()).collect();
    let corners = match numbers.as_deref() {
        Some(&[a, b, c, d, e, f]) => Corners::new([[a, b, c], [d, e, f]]),
        _ => None,
    };
    let fault = || invalid("box", "expected six numbers: the lower corner and then the upper corner, m");
    corners.map(Some).ok_or_else(fault)
}

/// Parses pairs of attributes, such as `paths:0-3,lights:1-2`.
fn pairs(query: Query<'_>) -> Result<AxisPairs, HttpError> {
    let Some(text) = query.get("pairs") else { return Ok(AxisPairs::default()) };
    let mut pairs = Vec::new();
    for part in text.split(',') {
        let fault = || invalid("pairs", &format!("`{part}`: expected a table and two attributes, such as paths:0-3"));
        let (table, axes) = part.split_once(':').ok_or_else(fault)?;
        let table = ["paths", "intersections", "lights"].iter().position(|name| *name == table).ok_or_else(fault)?;
        let (a, b) = axes.split_once('-').ok_or_else(fault)?;
        pairs.push([table, number("pairs", a)?, number("pairs", b)?]);
    }
    AxisPairs::new(pairs).ok_or_else(|| invalid("pairs", &format!("at most {} pairs are possible", AxisPairs::MAX)))
}

impl<S: Send + 'static> Http<S> {
    /// Answers a question about recorded light.
    pub(super) async fn light(
        &self,
        request_head: &RequestHead<'_>,
        question: LightQuestion,
        caller_key: CallerKey,
    ) -> Result<Response<Body>, HttpError> {
        let known = request_head.known_tag();
        let answered = self.0.light.answer(&self.0.farm, question, known, caller_key).await?;
        let Some(TaggedAnswer { tag, answer }) = answered else { return Ok(response::empty(StatusCode::NO_CONTENT)) };
        let mut response = match answer {
            None => response::empty(StatusCode::NOT_MODIFIED),
            Some((LightAnswer::Json(bytes), slot)) => response::large_bytes("application/json", bytes.into(), slot),
            Some((LightAnswer::Columns(columns) | LightAnswer::Rows { columns, .. }, slot)) => {
                response::large_bytes("application/vnd.femc.columns", columns.into(), slot)
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

    /// Compares two pictures.
    pub(super) async fn compare(
        &self,
        request_head: &RequestHead<'_>,
        pictures: [ComparedPicture; 2],
        caller_key: CallerKey,
    ) -> Result<Response<Body>, HttpError> {
        let known = request_head.known_tag();
        let _slot = self.0.pixel_slots.acquire(caller_key).await;
        let compared = self.0.pictures.compare(&self.0.farm, &self.0.light, pictures, known).await?;
        let Some(compared) = compared else { return Ok(response::empty(StatusCode::NO_CONTENT)) };
        let mut response = if known == Some(compared.tag.as_str()) {
            response::empty(StatusCode::NOT_MODIFIED)
        } else {
            response::bytes(StatusCode::OK, "application/json", compared.bytes)
        };
        response::tag(&mut response, &compared.tag);
        Ok(response)
    }

    /// Returns the reason why a statistics file has no geometry and no solution.
    pub(super) fn file_model(&self, file: usize) -> HttpError {
        if file < self.0.light.files().len() {
            HttpError::NoFileModel { file }
        } else {
            LightViewError::NoFile { number: file }.into()
        }
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
            LightViewError::Lost { job, frame, digest } => Self::LightLost { job, frame, digest },
            LightViewError::Unreadable { message } => Self::UnreadableLight { message },
            LightViewError::NoStatistics { job, frame } => {
                Self::NoResult { job, file: format!("light statistics of frame {frame}") }
            }
            LightViewError::NoFile { number } => Self::UnknownPath { path: format!("/api/v1/files/{number}") },
        }
    }
}
