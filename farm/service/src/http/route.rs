//! Routes: the meaning of paths.

use ::http::Method;
use ::http::header::HeaderName;
use femc_model::{JobId, TaskFilter, TaskKey, TaskState, Tick};

use super::RequestHead;
use super::error::HttpError;
use super::light;
use super::order::TaskOrder;
use crate::file::{FrameFile, FrameModel, ResultFile};
use crate::light::{LightQuestion, LightTarget};
use crate::operation::Operation;
use crate::picture::{ComparedPicture, PictureKind};

/// Parsed request.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Route {
    /// A file of the web page.
    Page(String),
    Login,
    Logout,
    Me,
    /// Changes since the event with this id.
    Feed(Option<String>),
    Jobs,
    Job(JobId),
    Frames(JobId, Window),
    Tasks(JobId, TaskWindow),
    /// Attempts, from this record on; or all attempts at one task.
    Attempts(JobId, u64, Option<TaskKey>),
    /// Logs since this time of the farm's clock; only those of one task, if it is given.
    Logs(JobId, Tick, Option<TaskKey>),
    /// A frame as a picture.
    Picture(JobId, u32, PictureKind),
    /// A question about recorded light.
    Light(LightQuestion),
    /// A comparison of two pictures.
    Compare([ComparedPicture; 2]),
    /// The files with light statistics beside the farm.
    LightFiles,
    /// Maps of a file with light statistics.
    FileMaps(usize),
    /// A result of a job as a file.
    Download(JobId, ResultFile),
    /// The model of the frame nearest to this one; `None`: of the first frame.
    Model(JobId, FrameModel, Option<u32>),
    /// A model of a file with light statistics, which has none.
    FileModel(usize),
    Control,
    Workers,
    /// Usage by owner and month.
    Usage,
    Drain,
    /// The latest lines of the audit log.
    Audit(usize),
}

/// A window of a list.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Window {
    pub(super) from: usize,
    pub(super) count: usize,
}

/// A window of a job's tasks.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct TaskWindow {
    pub(super) filter: TaskFilter,
    /// Sort order. `None`: the order of the job.
    pub(super) order: Option<TaskOrder>,
    pub(super) from: u64,
    pub(super) count: usize,
}

const LAST_EVENT: HeaderName = HeaderName::from_static("last-event-id");

impl Route {
    /// Parses a request.
    pub(super) fn parse(request_head: &RequestHead<'_>) -> Result<Self, HttpError> {
        let path = request_head.uri.path();
        let Some(call) = path.strip_prefix("/api/v1/") else { return Self::parse_page(request_head, path) };
        let query = Query(request_head.uri.query().unwrap_or_default());
        let segments: Vec<&str> = call.split('/').collect();
        let (route, method) = match segments[..] {
            ["me"] => (Self::Me, Method::GET),
            ["feed"] => {
                let last = request_head.headers.get(LAST_EVENT).and_then(|id| id.to_str().ok()).map(str::to_owned);
                (Self::Feed(last.or_else(|| query.get("since"))), Method::GET)
            }
            ["jobs"] => (Self::Jobs, Method::GET),
            ["jobs", "control"] => (Self::Control, Method::POST),
            ["jobs", job] => (Self::Job(number("job", job)?), Method::GET),
            ["jobs", job, "frames"] => {
                let (from, count) = (query.number("from")?.unwrap_or(0), query.number("count")?.unwrap_or(10_000));
                (Self::Frames(number("job", job)?, Window { from, count }), Method::GET)
            }
            ["jobs", job, "tasks"] => (Self::Tasks(number("job", job)?, window(query)?), Method::GET),
            ["jobs", job, "attempts"] => {
                let (from, task) = (query.number("from")?.unwrap_or(0), query.number("task")?);
                (Self::Attempts(number("job", job)?, from, task), Method::GET)
            }
            ["jobs", job, "logs"] => {
                let since = query.number::<f64>("since")?.unwrap_or(0.0);
                // There are no logs beyond the range of milliseconds.
                let since = Tick((since * 1000.0) as u64);
                (Self::Logs(number("job", job)?, since, query.number("task")?), Method::GET)
            }
            ["jobs", job, "frames", frame, picture] => {
                let kind = match picture {
                    "pixels" => PictureKind::Pixels,
                    "maps" => PictureKind::Maps,
                    "thumbnail.png" => PictureKind::Thumbnail { height: height(query)? },
                    _ => {
                        let file = FrameFile::ALL.into_iter().find(|file| file.segment() == picture);
                        let file = file.ok_or_else(|| HttpError::UnknownPath { path: path.to_owned() })?;
                        let file = ResultFile::Frame(number("frame", frame)?, file);
                        return Self::Download(number("job", job)?, file).require_get_or_head(request_head, path);
                    }
                };
                (Self::Picture(number("job", job)?, number("frame", frame)?, kind), Method::GET)
            }
            ["jobs", job, "clip"] => {
                return Self::Download(number("job", job)?, ResultFile::Clip).require_get_or_head(request_head, path);
            }
            ["jobs", job, "sheet.png"] => {
                return Self::Download(number("job", job)?, ResultFile::Sheet).require_get_or_head(request_head, path);
            }
            ["jobs", job, model @ ("geometry" | "solution" | "targets")] => {
                let model = match model {
                    "geometry" => FrameModel::Geometry,
                    "solution" => FrameModel::Solution,
                    _ => FrameModel::Targets,
                };
                let route = Self::Model(number("job", job)?, model, query.number("frame")?);
                return route.require_get_or_head(request_head, path);
            }
            ["jobs", job, "light", call] => {
                let target = LightTarget::Frames(number("job", job)?, light::frames(query)?);
                (Self::Light(light::parse_question(target, call, query, path)?), Method::GET)
            }
            ["compare"] => (Self::Compare([light::compared("a", query)?, light::compared("b", query)?]), Method::GET),
            ["files"] => (Self::LightFiles, Method::GET),
            ["files", file, "maps"] => (Self::FileMaps(number("file", file)?), Method::GET),
            ["files", file, "geometry" | "solution"] => (Self::FileModel(number("file", file)?), Method::GET),
            ["files", file, "light", call] => {
                let target = LightTarget::File(number("file", file)?);
                (Self::Light(light::parse_question(target, call, query, path)?), Method::GET)
            }
            ["workers"] => (Self::Workers, Method::GET),
            ["usage"] => (Self::Usage, Method::GET),
            ["workers", "drain"] => (Self::Drain, Method::POST),
            ["audit"] => {
                let count = query.number("count")?.unwrap_or(200);
                if !(1..=10_000).contains(&count) {
                    return Err(invalid("count", "expected a number from 1 to 10000"));
                }
                (Self::Audit(count), Method::GET)
            }
            _ => return Err(HttpError::UnknownPath { path: path.to_owned() }),
        };
        route.require_method(request_head, &method, path)
    }

    fn parse_page(request_head: &RequestHead<'_>, path: &str) -> Result<Self, HttpError> {
        match path {
            "/login" if request_head.method == Method::POST => Ok(Self::Login),
            "/logout" => Self::Logout.require_method(request_head, &Method::POST, path),
            _ if path == "/api" || path.starts_with("/api/") => Err(HttpError::UnknownPath { path: path.to_owned() }),
            _ => Self::Page(path.to_owned()).require_method(request_head, &Method::GET, path),
        }
    }

    fn require_method(self, request_head: &RequestHead<'_>, method: &Method, path: &str) -> Result<Self, HttpError> {
        if request_head.method == method {
            return Ok(self);
        }
        let allowed = if method == Method::GET { "GET" } else { "POST" };
        Err(HttpError::Method { path: path.to_owned(), allowed })
    }

    /// Accepts GET and HEAD only.
    fn require_get_or_head(self, request_head: &RequestHead<'_>, path: &str) -> Result<Self, HttpError> {
        if matches!(*request_head.method, Method::GET | Method::HEAD) {
            return Ok(self);
        }
        Err(HttpError::Method { path: path.to_owned(), allowed: "GET, HEAD" })
    }

    /// Returns the operation of the route.
    pub(super) fn operation(&self) -> Operation {
        match self {
            Self::Page(_) => Operation::Page,
            Self::Login => Operation::Login,
            Self::Logout => Operation::Logout,
            Self::Me => Operation::Me,
            Self::Feed(_) => Operation::Feed,
            Self::Jobs => Operation::List,
            Self::Job(_) => Operation::Status,
            Self::Frames(..) => Operation::FrameTable,
            Self::Tasks(..) => Operation::Tasks,
            Self::Attempts(..) => Operation::Attempts,
            Self::Logs(..) => Operation::Logs,
            Self::Picture(..) => Operation::Picture,
            Self::Light(_) | Self::Compare(_) | Self::LightFiles | Self::FileMaps(_) | Self::FileModel(_) => {
                Operation::Light
            }
            Self::Download(..) | Self::Model(..) => Operation::Download,
            Self::Control => Operation::Control,
            Self::Workers => Operation::ListWorkers,
            Self::Usage => Operation::Usage,
            Self::Drain => Operation::DrainWorkers,
            Self::Audit(_) => Operation::ReadAudit,
        }
    }

    /// Returns whether the route changes the farm, with a JSON body.
    pub(super) fn is_change(&self) -> bool {
        matches!(self, Self::Control | Self::Drain)
    }
}

fn window(query: Query<'_>) -> Result<TaskWindow, HttpError> {
    let state = query.get("state").map(|name| {
        let known = TaskState::ALL.into_iter().find(|state| state.name() == name);
        known.ok_or_else(|| {
            invalid("state", &format!("unknown state `{name}` (expected waiting, queued, running, done or failed)"))
        })
    });
    let filter = TaskFilter { frame: query.number("frame")?, stage: query.number("stage")?, state: state.transpose()? };
    let (from, count) = (query.number("from")?.unwrap_or(0), query.number("count")?.unwrap_or(1000));
    Ok(TaskWindow { filter, order: query.number("sort")?, from, count })
}

/// Returns the height of a thumbnail in pixels.
fn height(query: Query<'_>) -> Result<u32, HttpError> {
    let height = query.number("height")?.unwrap_or(90);
    if (1..=1024).contains(&height) { Ok(height) } else { Err(invalid("height", "expected a number from 1 to 1024")) }
}

pub(super) fn invalid(field: &str, message: &str) -> HttpError {
    HttpError::Invalid { field: field.into(), message: message.into() }
}

/// Parses a number or an identifier in a path.
pub(super) fn number<T: std::str::FromStr>(field: &str, text: &str) -> Result<T, HttpError>
where
    T::Err: std::fmt::Display,
{
    text.parse().map_err(|error| HttpError::Invalid { field: field.into(), message: format!("`{text}`: {error}") })
}

/// Query part of a URL.
#[derive(Debug, Clone, Copy)]
pub(super) struct Query<'a>(pub(super) &'a str);

impl Query<'_> {
    /// Returns the first value with this name. An empty value counts as missing.
    pub(super) fn get(self, name: &str) -> Option<String> {
        let value = form_urlencoded::parse(self.0.as_bytes()).find(|(key, _)| key == name)?.1;
        Some(value.into_owned()).filter(|value| !value.is_empty())
    }

    /// Returns the first value with this name, as a number.
    pub(super) fn number<T: std::str::FromStr>(self, name: &str) -> Result<Option<T>, HttpError>
    where
        T::Err: std::fmt::Display,
    {
        self.get(name).map(|text| number(name, &text)).transpose()
    }
}

#[cfg(test)]
mod tests {
    use std::collections::{BTreeMap, BTreeSet};

    use ::http::{HeaderMap, Uri};
    use femc_trust::Role;

    use super::*;
    use crate::operation::Right;

    fn route(method: &Method, path: &str) -> Result<Route, HttpError> {
        let (uri, headers): (Uri, _) = (path.parse().expect("a path"), HeaderMap::new());
        Route::parse(&RequestHead { method, uri: &uri, headers: &headers })
    }

    #[test]
    fn who_may_by_the_documentation_may() {
        let page = std::fs::read_to_string(concat!(env!("CARGO_MANIFEST_DIR"), "/../../docs/http.md")).expect("a page");
        let rows: Vec<Vec<&str>> = page.lines().map(|line| line.split(" | ").collect()).collect();
        let mut seen = BTreeMap::new();
        for row in rows.iter().filter(|row| row.len() == 3 && row[0].starts_with("| `")) {
            let right = match row[2].trim_end_matches(" |") {
                "everybody" => Right::Public,
                "any identity" => Right::AnyIdentity,
                "viewers" => Right::User(Role::Viewer),
                "the owner, if a submitter; operators" => Right::User(Role::Submitter),
                "operators" => Right::User(Role::Operator),
                "admins" => Right::User(Role::Admin),
                other => panic!("who are {other:?}?"),
            };
            for request in row[0].split('`').filter(|part| part.contains(" /")) {
                let (method, path) = request.split_once(' ').expect("a method");
                let path = path.replace("JOB", "7").replace("/N/", "/1/");
                let route = route(&method.parse().expect("a method"), &path).expect("a route");
                assert_eq!(route.operation().right(), right, "{request}");
                assert_eq!(route.is_change(), method == "POST" && path.starts_with("/api"), "{request}");
                *seen.entry(route.operation()).or_default() += 1;
            }
        }
        assert_eq!(seen.values().sum::<usize>(), 43);
        // The page itself has no row in the table, and neither have requests without an operation.
        let documented = seen.into_keys().chain([Operation::Page, Operation::Other]);
        assert_eq!(documented.collect::<BTreeSet<_>>(), BTreeSet::from(Operation::HTTP));
    }

    #[test]
    fn a_path_that_is_none_of_these_or_makes_no_sense_is_told_so() {
        for path in [
            "/api",
            "/api/",
            "/api/v1",
            "/api/v2/jobs",
            "/api/v1/jobs/7/nothing",
            "/api/v1/jobs/7/frames/1/x",
            "/api/v1/jobs/7/frames/1/image.png",
            "/api/v1/jobs/7/clip/x",
        ] {
            assert!(matches!(route(&Method::GET, path), Err(HttpError::UnknownPath { .. })), "{path}");
        }
        for path in [
            "/api/v1/jobs/",
            "/api/v1/jobs/7x",
            "/api/v1/jobs/7/frames/-1/pixels",
            "/api/v1/jobs/7/tasks?count=many",
            "/api/v1/jobs/7/tasks?state=Done",
            "/api/v1/jobs/7/tasks?sort=cpu",
            "/api/v1/jobs/7/logs?since=yesterday",
            "/api/v1/jobs/7/logs?task=7",
        ] {
            assert!(matches!(route(&Method::GET, path), Err(HttpError::Invalid { .. })), "{path}");
        }
        for (method, path) in [
            (Method::POST, "/api/v1/jobs"),
            (Method::GET, "/logout"),
            (Method::DELETE, "/"),
            (Method::POST, "/api/v1/jobs/7/clip"),
        ] {
            assert!(matches!(route(&method, path), Err(HttpError::Method { .. })), "{method} {path}");
        }
        assert_eq!(route(&Method::GET, "/login").expect("the page"), Route::Page("/login".into()));
        let Ok(Route::Tasks(job, window)) =
            route(&Method::GET, "/api/v1/jobs/shared-3/tasks?frame=0&state=failed&from=5&sort=-wall_seconds")
        else {
            panic!("it is a window of tasks");
        };
        let filter = TaskFilter { frame: Some(0), stage: None, state: Some(TaskState::Failed) };
        assert_eq!(
            (job, window),
            (JobId::shared(3), TaskWindow { filter, order: "-wall_seconds".parse().ok(), from: 5, count: 1000 })
        );
    }
}
