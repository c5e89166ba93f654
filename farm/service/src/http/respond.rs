//! What each route does.

use std::sync::Arc;
use std::time::{SystemTime, UNIX_EPOCH};

use ::http::header::{LOCATION, SET_COOKIE};
use ::http::{HeaderValue, Response, StatusCode};
use bytes::Bytes;
use femc_model::JobId;
use femc_trust::Holder;
use http_body_util::{BodyExt as _, LengthLimitError, Limited};
use serde::Serialize;

use super::answer::{self, Body};
use super::fault::Fault;
use super::route::{Query, Route};
use super::{Asked, Http, site};
use crate::access::{Caller, Trail};
use crate::call::{Call, Listing};
use crate::view::{JobJson, SpecJson};

/// Who asks.
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

impl<S: Send + 'static> Http<S> {
    /// Most bytes of a form or of JSON that comes in.
    const BODY: usize = 64 << 10;

    /// Does what a route asks for.
    pub(super) async fn respond<B>(
        &self,
        route: Route,
        asked: &Asked<'_>,
        body: B,
        caller: Option<Arc<Caller>>,
        trail: &Trail,
    ) -> Result<Response<Body>, Fault>
    where
        B: http_body::Body<Data = Bytes> + Send,
        B::Error: std::fmt::Display,
    {
        match route {
            Route::Page(path) => self.0.site.files.get(&path),
            Route::Login => self.login(asked, &self.whole(body).await?, trail),
            Route::Logout => self.logged(None),
            Route::Me => Ok(self.me(caller.as_deref())),
            Route::Feed(last) => Ok(answer::events(self.0.feed.listen(last.as_deref(), caller))),
            Route::Jobs => self.jobs().await,
            Route::Job(job) => self.job(job).await,
        }
    }

    /// A body that is not too large and comes in time.
    async fn whole<B>(&self, body: B) -> Result<Bytes, Fault>
    where
        B: http_body::Body<Data = Bytes> + Send,
        B::Error: std::fmt::Display,
    {
        let patience = self.0.gate.limits().patience;
        let body = std::pin::pin!(body);
        let mapped = body.map_err(|error| std::io::Error::other(error.to_string()));
        let whole = tokio::time::timeout(patience, Limited::new(mapped, Self::BODY).collect()).await;
        let late = || Fault::Cut { message: format!("not within {} s", patience.as_secs()) };
        match whole.map_err(|_| late())? {
            Ok(whole) => Ok(whole.to_bytes()),
            Err(error) if error.is::<LengthLimitError>() => Err(Fault::TooLarge { limit: Self::BODY }),
            Err(error) => Err(Fault::Cut { message: error.to_string() }),
        }
    }

    /// Takes a token from a form, and gives a cookie that brings it along.
    fn login(&self, asked: &Asked<'_>, form: &Bytes, trail: &Trail) -> Result<Response<Body>, Fault> {
        let kind = asked.headers.get(::http::header::CONTENT_TYPE).and_then(|kind| kind.to_str().ok());
        if !kind.is_some_and(|kind| kind.starts_with("application/x-www-form-urlencoded")) {
            let message = "must be application/x-www-form-urlencoded, with the field `token`".into();
            return Err(Fault::Invalid { field: "Content-Type".into(), message });
        }
        let form = std::str::from_utf8(form).unwrap_or_default();
        let token = Query(form).get("token").unwrap_or_default();
        let caller = self.0.gate.holder(token.trim())?;
        trail.caller(&caller);
        self.logged(Some(token.trim()))
    }

    /// Back to the page, with the cookie, or without it.
    fn logged(&self, token: Option<&str>) -> Result<Response<Body>, Fault> {
        let mut response = answer::bytes(StatusCode::SEE_OTHER, "text/plain; charset=utf-8", Bytes::new());
        response.headers_mut().insert(LOCATION, HeaderValue::from_static("/"));
        if let Some(cookie) = site::cookie(token, self.0.is_encrypted) {
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
        answer::json(&Me {
            name: caller.map(|caller| caller.holder.name()),
            role,
            secured: self.0.is_encrypted,
            version: env!("CARGO_PKG_VERSION"),
            engine: &self.0.site.engine,
            farm_time: now.as_secs_f64(),
        })
    }

    async fn jobs(&self) -> Result<Response<Body>, Fault> {
        let Listing { jobs, warnings } = self.0.farm.ask(|reply| Call::List { reply }).await?;
        Ok(answer::json(&Jobs { jobs: jobs.iter().map(JobJson::from).collect(), warnings }))
    }

    async fn job(&self, job: JobId) -> Result<Response<Body>, Fault> {
        let status = self.0.farm.ask(|reply| Call::Status { job, reply }).await?;
        let shape = self.0.farm.ask(|reply| Call::Shape { job, reply }).await?;
        Ok(answer::json(&Job { job: JobJson::from(&status), spec: SpecJson::from(&*shape.spec) }))
    }
}
