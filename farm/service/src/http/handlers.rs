//! Handlers of the routes.

use std::pin::Pin;
use std::sync::Arc;
use std::time::{SystemTime, UNIX_EPOCH};

use ::http::header::{LOCATION, SET_COOKIE};
use ::http::{HeaderValue, Response, StatusCode};
use bytes::Bytes;
use femc_model::{
    ChunkSize, Chunks, JobId, JobSpec, LogRecord, LogText, OwnerUsage, Refusal, TaskFilter, TaskKey, TaskPage,
    TaskStatus, Tick, WorkerList,
};
use femc_trust::Holder;
use http_body_util::{BodyExt as _, LengthLimitError, Limited};
use serde::Serialize;

use super::error::HttpError;
use super::order::TaskOrder;
use super::response::{self, Body};
use super::route::{Query, Route, TaskWindow, Window};
use super::{Http, RequestHead, site};
use crate::access::{AuditEntry, Caller, CallerKey};
use crate::attempts::{GroupBy, JobRecord, RowsAsJson, columns, rows_of_page};
use crate::call::{AttemptPage, Call, JobList, JobShape};
use crate::picture::PictureKind;
use crate::view::{FrameJson, JobJson, LogJson, OfflineJson, SpecJson, TaskJson, WorkerJson, usage_columns};

/// Identity of the caller, and facts about the farm.
#[derive(Serialize)]
struct Me<'a> {
    name: Option<&'a str>,
    role: Option<&'static str>,
    secured: bool,
    version: &'static str,
    engine: &'a str,
    farm_time: f64,
}

#[derive(Serialize)]
struct Jobs {
    jobs: Vec<JobJson>,
    warnings: Vec<String>,
}

#[derive(Serialize)]
struct Job {
    job: JobJson,
    spec: SpecJson,
}

#[derive(Serialize)]
struct Frames {
    total: usize,
    /// Sum over all frames and the job's own stages, including those that this response leaves out.
    processor_seconds: Option<f64>,
    wall_seconds: Option<f64>,
    frames: Vec<FrameJson>,
}

#[derive(Serialize)]
struct Tasks {
    total: u64,
    tasks: Vec<TaskJson>,
}

#[derive(Serialize)]
struct Workers {
    workers: Vec<WorkerJson>,
    offline: Vec<OfflineJson>,
}

#[derive(Serialize)]
struct Usage<'a> {
    usage: RowsAsJson<'a, OwnerUsage>,
}

#[derive(Serialize)]
struct Attempts<'a> {
    attempts: RowsAsJson<'a>,
    next: Option<u64>,
}

#[derive(Serialize)]
struct Logs {
    records: Vec<LogJson>,
    /// Report time of the last record, by the farm's clock: the `since` of the next request.
    latest: Option<f64>,
}

#[derive(Serialize)]
struct AuditLines {
    lines: Vec<serde_json::Value>,
}

impl<S: Send + 'static> Http<S> {
    /// Maximum size in bytes of a form or of JSON in a request.
    const MAX_BODY_BYTES: usize = 64 << 10;

    /// Runs the request of a route.
    pub(super) async fn respond<B>(
        &self,
        route: Route,
        request_head: &RequestHead<'_>,
        body: Pin<&mut B>,
        caller: Option<Arc<Caller>>,
        caller_key: CallerKey,
        audit_entry: &AuditEntry,
    ) -> Result<Response<Body>, HttpError>
    where
        B: http_body::Body<Data = Bytes> + Send,
        B::Error: std::fmt::Display,
    {
        match route {
            Route::Page(path) => self.0.site.files.get(&path),
            Route::Login => self.login(request_head, &self.read_body(body).await?, audit_entry),
            Route::Logout => self.redirect_with_cookie(request_head, None),
            Route::Me => Ok(self.me(caller.as_deref())),
            Route::Feed(last) => Ok(response::events(self.0.feed.listen(last.as_deref(), caller))),
            Route::Jobs => self.jobs().await,
            Route::Job(job) => self.job(job).await,
            Route::Frames(job, window) => self.frames(job, window).await,
            Route::Tasks(job, window) => self.tasks(job, window).await,
            Route::Attempts(job, from, task) => self.attempts(job, from, task).await,
            Route::Logs(job, since, task) => self.logs(job, since, task, caller_key).await,
            Route::Picture(job, frame, wanted) => self.picture(request_head, job, frame, wanted, caller_key).await,
            Route::Light(question) => self.light(request_head, question, caller_key).await,
            Route::Compare(pictures) => self.compare(request_head, pictures, caller_key).await,
            Route::LightFiles => Ok(self.light_files()),
            Route::FileMaps(file) => self.file_maps(request_head, file, caller_key).await,
            Route::FileModel(file) => Err(self.file_model(file)),
            Route::Model(job, model, frame) => self.model(request_head, job, (model, frame), caller_key).await,
            Route::Download(job, file) => self.download(request_head, job, file, caller_key).await,
            Route::Workers => self.workers().await,
            Route::Usage => self.usage().await,
            Route::Control => self.control(&self.read_body(body).await?, caller.as_deref(), audit_entry).await,
            Route::Drain => self.drain(&self.read_body(body).await?, audit_entry).await,
            Route::Audit(count) => self.audit(count).await,
        }
    }

    /// Reads a whole body. Fails if the body is too large or late.
    async fn read_body<B>(&self, body: Pin<&mut B>) -> Result<Bytes, HttpError>
    where
        B: http_body::Body<Data = Bytes> + Send,
        B::Error: std::fmt::Display,
    {
        if body.size_hint().lower() > Self::MAX_BODY_BYTES as u64 {
            return Err(HttpError::TooLarge { limit: Self::MAX_BODY_BYTES });
        }
        let patience = self.0.gate.limits().request_timeout;
        let mapped = body.map_err(|error| std::io::Error::other(error.to_string()));
        let whole = tokio::time::timeout(patience, Limited::new(mapped, Self::MAX_BODY_BYTES).collect()).await;
        let late = || HttpError::UnreadableBody { message: format!("timeout after {} s", patience.as_secs()) };
        match whole.map_err(|_| late())? {
            Ok(whole) => Ok(whole.to_bytes()),
            Err(error) if error.is::<LengthLimitError>() => Err(HttpError::TooLarge { limit: Self::MAX_BODY_BYTES }),
            Err(error) => Err(HttpError::UnreadableBody { message: error.to_string() }),
        }
    }

    /// Takes a token from a form, and sets a cookie with it. The token of an address is exchanged for the token of the session.
    fn login(
        &self,
        request_head: &RequestHead<'_>,
        form: &Bytes,
        audit_entry: &AuditEntry,
    ) -> Result<Response<Body>, HttpError> {
        let kind = request_head.headers.get(::http::header::CONTENT_TYPE).and_then(|kind| kind.to_str().ok());
        if !kind.is_some_and(|kind| kind.starts_with("application/x-www-form-urlencoded")) {
            let message = "must be application/x-www-form-urlencoded, with the field `token`".into();
            return Err(HttpError::Invalid { field: "Content-Type".into(), message });
        }
        let form = std::str::from_utf8(form).unwrap_or_default();
        let token = Query(form).get("token").unwrap_or_default();
        let logins = self.0.gate.logins();
        let token = logins.and_then(|logins| logins.exchange(token.trim())).unwrap_or(token.trim());
        let caller = self.0.gate.caller_of_token(token).map_err(|refusal| match logins {
            Some(_) => HttpError::UsedAddress,
            None => refusal.into(),
        })?;
        audit_entry.set_caller(&caller);
        self.redirect_with_cookie(request_head, Some(token))
    }

    /// Redirects to the page, and sets or clears the cookie.
    fn redirect_with_cookie(
        &self,
        request_head: &RequestHead<'_>,
        token: Option<&str>,
    ) -> Result<Response<Body>, HttpError> {
        let mut response = response::bytes(StatusCode::SEE_OTHER, "text/plain; charset=utf-8", Bytes::new());
        response.headers_mut().insert(LOCATION, HeaderValue::from_static("/"));
        if let Some(cookie) = site::cookie(request_head, token, self.0.is_encrypted) {
            response.headers_mut().insert(SET_COOKIE, cookie);
        }
        Ok(response)
    }

    fn me(&self, caller: Option<&Caller>) -> Response<Body> {
        let now = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
        let role = caller.map(|caller| match &caller.holder {
            Holder::User { role, .. } => role.name(),
            Holder::Worker { .. } => "worker",
            Holder::Coordinator { .. } => "coordinator",
        });
        response::json(&Me {
            name: caller.map(|caller| caller.holder.name()),
            role,
            secured: self.0.is_encrypted,
            version: env!("CARGO_PKG_VERSION"),
            engine: &self.0.site.engine,
            farm_time: now.as_secs_f64(),
        })
    }

    async fn jobs(&self) -> Result<Response<Body>, HttpError> {
        let JobList { jobs, warnings } = self.0.farm.call(|reply| Call::List { reply }).await?;
        Ok(response::json(&Jobs { jobs: jobs.iter().map(JobJson::from).collect(), warnings }))
    }

    async fn job(&self, job: JobId) -> Result<Response<Body>, HttpError> {
        let status = self.0.farm.call(|reply| Call::Status { job, reply }).await?;
        let shape = self.0.farm.call(|reply| Call::Shape { job, reply }).await?;
        Ok(response::json(&Job { job: JobJson::from(&status), spec: SpecJson::from(&*shape.spec) }))
    }

    async fn frames(&self, job: JobId, Window { from, count }: Window) -> Result<Response<Body>, HttpError> {
        /// Maximum number of frames in one response.
        const MAX_FRAMES: usize = 10_000;
        let shape = self.0.farm.call(|reply| Call::Shape { job, reply }).await?;
        let [width, height] = shape.spec.grid.film;
        let pixels = u64::from(width) * u64::from(height);
        let mut frames = self.0.farm.call(|reply| Call::FrameTable { job, reply }).await?;
        let times = self.0.farm.times(job, &shape).await?;
        let sums = times.as_ref().map(|times| times.totals());
        let total = frames.len();
        let window = frames.iter_mut().skip(from).take(count.min(MAX_FRAMES));
        let frames = window.map(|frame| {
            if let Some(times) = &times {
                times.fill_frame(frame);
            }
            FrameJson::new(frame, pixels)
        });
        Ok(response::json(&Frames {
            total,
            processor_seconds: sums.map(|(processor, _)| processor),
            wall_seconds: sums.map(|(_, wall)| wall),
            frames: frames.collect(),
        }))
    }

    async fn tasks(&self, job: JobId, window: TaskWindow) -> Result<Response<Body>, HttpError> {
        /// Maximum number of tasks in one response.
        const MAX_TASKS: usize = 10_000;
        let TaskWindow { filter, order, from, count } = window;
        let count = count.min(MAX_TASKS);
        if let Some(order) = order {
            let all = self.sorted_tasks(job, filter, order).await?;
            let first = usize::try_from(from).unwrap_or(usize::MAX);
            let tasks = all.iter().skip(first).take(count).map(TaskJson::from).collect();
            return Ok(response::json(&Tasks { total: all.len() as u64, tasks }));
        }
        let TaskPage { total, mut tasks } =
            self.0.farm.call(|reply| Call::Tasks { job, filter, from, count, reply }).await?;
        let shape = self.0.farm.call(|reply| Call::Shape { job, reply }).await?;
        if let Some(times) = self.0.farm.times(job, &shape).await? {
            tasks.iter_mut().for_each(|task| times.fill_task(task));
        }
        Ok(response::json(&Tasks { total, tasks: tasks.iter().map(TaskJson::from).collect() }))
    }

    /// Returns all tasks that pass a filter, sorted.
    async fn sorted_tasks(
        &self,
        job: JobId,
        filter: TaskFilter,
        order: TaskOrder,
    ) -> Result<Arc<Vec<TaskStatus>>, HttpError> {
        if let Some(sorted) = self.0.sorted_tasks.get(job, filter, order) {
            return Ok(sorted);
        }
        let (from, count) = (0, usize::MAX);
        let TaskPage { total, mut tasks } =
            self.0.farm.call(|reply| Call::Tasks { job, filter, from, count, reply }).await?;
        if total > tasks.len() as u64 {
            let message = format!(
                "cannot sort {total} tasks, at most {} are possible: filter them by frame, stage or state",
                tasks.len()
            );
            return Err(HttpError::Invalid { field: "sort".into(), message });
        }
        let shape = self.0.farm.call(|reply| Call::Shape { job, reply }).await?;
        let times = self.0.farm.times(job, &shape).await?;
        let work = move || {
            if let Some(times) = times {
                tasks.iter_mut().for_each(|task| times.fill_task(task));
            }
            order.sort(&mut tasks);
            tasks
        };
        let failed = |error: tokio::task::JoinError| Refusal::Unavailable { message: error.to_string() };
        let tasks = Arc::new(tokio::task::spawn_blocking(work).await.map_err(failed)?);
        self.0.sorted_tasks.put(job, filter, order, tasks.clone());
        Ok(tasks)
    }

    async fn attempts(&self, job: JobId, from: u64, task: Option<TaskKey>) -> Result<Response<Body>, HttpError> {
        let JobShape { spec, chunk_size: cut } = self.0.farm.call(|reply| Call::Shape { job, reply }).await?;
        let page = |from| self.0.farm.call(move |reply| Call::Attempts { job, from, reply });
        let AttemptPage { mut attempts, mut next } = page(from).await?;
        if let Some(task) = task {
            attempts.retain(|attempt| lease_belongs_to(&spec, cut, &task, &attempt.task));
            while let Some(from) = next {
                let more = page(from).await?;
                attempts.extend(
                    more.attempts.into_iter().filter(|attempt| lease_belongs_to(&spec, cut, &task, &attempt.task)),
                );
                next = more.next;
            }
        }
        let record = JobRecord { job, run: 0, variant: None, spec: *spec, cut, attempts, failures: Vec::new() };
        let (columns, rows) = (columns(GroupBy::Attempt), rows_of_page(record));
        Ok(response::json(&Attempts { attempts: RowsAsJson(&columns, &rows), next }))
    }

    async fn logs(
        &self,
        job: JobId,
        since: Tick,
        task: Option<TaskKey>,
        caller_key: CallerKey,
    ) -> Result<Response<Body>, HttpError> {
        let JobShape { spec, chunk_size: cut } = self.0.farm.call(|reply| Call::Shape { job, reply }).await?;
        let all = self.0.farm.call(|reply| Call::Logs { job, since, reply }).await?;
        let is_wanted = |record: &LogRecord| task.is_none_or(|task| lease_belongs_to(&spec, cut, &task, &record.task));
        let wanted = all.into_iter().filter(is_wanted);
        let wanted: Vec<LogRecord> = wanted.collect();
        let latest = wanted.iter().map(|record| record.reported_at.0 as f64 / 1000.0).next_back();
        let _slot = self.0.transfer_slots.acquire(caller_key).await;
        let mut records = Vec::with_capacity(wanted.len());
        for record in wanted {
            let text = match &record.log.text {
                LogText::Inline(text) => text.clone(),
                LogText::Stored(artifact) => match self.0.store.get(&artifact.digest).await {
                    Ok(bytes) => String::from_utf8_lossy(&bytes).into_owned(),
                    Err(error) => format!("cannot read the log: {error}\n"),
                },
            };
            records.push(LogJson::new(&record, text));
        }
        Ok(response::json(&Logs { records, latest }))
    }

    async fn picture(
        &self,
        request_head: &RequestHead<'_>,
        job: JobId,
        frame: u32,
        kind: PictureKind,
        caller_key: CallerKey,
    ) -> Result<Response<Body>, HttpError> {
        let slot = match kind {
            PictureKind::Thumbnail { .. } => self.0.transfer_slots.acquire(caller_key).await,
            PictureKind::Pixels | PictureKind::Maps | PictureKind::FileMaps => {
                self.0.pixel_slots.acquire(caller_key).await
            }
        };
        let known = request_head.known_tag();
        let Some(drawn) = self.0.pictures.get(&self.0.farm, job, frame, kind, known).await? else {
            return Ok(response::empty(StatusCode::NO_CONTENT));
        };
        let mut response = match kind {
            _ if known == Some(drawn.tag.as_str()) => response::empty(StatusCode::NOT_MODIFIED),
            PictureKind::Thumbnail { .. } => response::bytes(StatusCode::OK, "image/png", drawn.bytes),
            PictureKind::Pixels | PictureKind::Maps | PictureKind::FileMaps => {
                response::large_bytes("application/vnd.femc.pixels", drawn.bytes, slot)
            }
        };
        response::tag(&mut response, &drawn.tag);
        Ok(response)
    }

    async fn workers(&self) -> Result<Response<Body>, HttpError> {
        let WorkerList { connected: there, offline } = self.0.farm.call(|reply| Call::Workers { reply }).await?;
        let workers = there.iter().map(WorkerJson::from).collect();
        let offline = offline.iter().map(OfflineJson::from).collect();
        Ok(response::json(&Workers { workers, offline }))
    }

    async fn usage(&self) -> Result<Response<Body>, HttpError> {
        let usage = self.0.farm.call(|reply| Call::Usage { reply }).await?;
        Ok(response::json(&Usage { usage: RowsAsJson(&usage_columns(), &usage) }))
    }

    async fn audit(&self, count: usize) -> Result<Response<Body>, HttpError> {
        let audit = self.0.gate.audit().cloned();
        let audit =
            audit.ok_or(Refusal::Unavailable { message: "this coordinator writes no audit log (`--audit`)".into() })?;
        let lines = tokio::task::spawn_blocking(move || audit.latest(count)).await;
        let failed = |message: String| Refusal::Unavailable { message };
        let lines = lines.map_err(|error| failed(error.to_string()))?.map_err(|error| failed(error.to_string()))?;
        Ok(response::json(&AuditLines { lines }))
    }
}

/// Returns whether a lease belongs to a task. The task is named by its own key, or by its key before it was divided into chunks.
fn lease_belongs_to(spec: &JobSpec, cut: ChunkSize, task: &TaskKey, lease: &TaskKey) -> bool {
    let item = || {
        let template = spec.graph.stage(lease.stage.number)?;
        Some(Chunks::new(template, lease.stage.round, None, cut).task(lease.index))
    };
    task.job == lease.job && task.stage == lease.stage && (task.index == lease.index || item() == Some(task.index))
}
