//! Paths, and what they ask for.

use ::http::Method;
use ::http::header::HeaderName;
use femc_model::JobId;

use super::Asked;
use super::fault::Fault;
use crate::operation::Operation;

/// What a request asks for.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) enum Route {
    /// A file of the page.
    Page(String),
    Login,
    Logout,
    Me,
    /// Changes since an event, by its id.
    Feed(Option<String>),
    Jobs,
    Job(JobId),
}

const LAST_EVENT: HeaderName = HeaderName::from_static("last-event-id");

impl Route {
    /// Of a request.
    pub(super) fn of(asked: &Asked<'_>) -> Result<Self, Fault> {
        let path = asked.uri.path();
        let Some(call) = path.strip_prefix("/api/v1/") else { return Self::of_page(asked, path) };
        let query = Query(asked.uri.query().unwrap_or_default());
        let segments: Vec<&str> = call.split('/').collect();
        let (route, method) = match segments[..] {
            ["me"] => (Self::Me, Method::GET),
            ["feed"] => {
                let last = asked.headers.get(LAST_EVENT).and_then(|id| id.to_str().ok()).map(str::to_owned);
                (Self::Feed(last.or_else(|| query.get("since"))), Method::GET)
            }
            ["jobs"] => (Self::Jobs, Method::GET),
            ["jobs", job] => (Self::Job(number("job", job)?), Method::GET),
            _ => return Err(Fault::Nowhere { path: path.to_owned() }),
        };
        route.by(asked, &method, path)
    }

    fn of_page(asked: &Asked<'_>, path: &str) -> Result<Self, Fault> {
        match path {
            "/login" if asked.method == Method::POST => Ok(Self::Login),
            "/logout" => Self::Logout.by(asked, &Method::POST, path),
            _ if path == "/api" || path.starts_with("/api/") => Err(Fault::Nowhere { path: path.to_owned() }),
            _ => Self::Page(path.to_owned()).by(asked, &Method::GET, path),
        }
    }

    fn by(self, asked: &Asked<'_>, method: &Method, path: &str) -> Result<Self, Fault> {
        if asked.method == method {
            return Ok(self);
        }
        let allowed = if method == Method::GET { "GET" } else { "POST" };
        Err(Fault::Method { path: path.to_owned(), allowed })
    }

    /// What it is.
    pub(super) fn operation(&self) -> Operation {
        match self {
            Self::Page(_) => Operation::Page,
            Self::Login => Operation::Login,
            Self::Logout => Operation::Logout,
            Self::Me => Operation::Me,
            Self::Feed(_) => Operation::Feed,
            Self::Jobs => Operation::List,
            Self::Job(_) => Operation::Status,
        }
    }

    /// Whether it changes something of the farm, by JSON.
    pub(super) fn is_change(&self) -> bool {
        match self {
            Self::Page(_) | Self::Login | Self::Logout | Self::Me | Self::Feed(_) | Self::Jobs | Self::Job(_) => false,
        }
    }
}

/// A number, or another name, within a path.
fn number<T: std::str::FromStr>(field: &str, text: &str) -> Result<T, Fault>
where
    T::Err: std::fmt::Display,
{
    text.parse().map_err(|error| Fault::Invalid { field: field.into(), message: format!("`{text}`: {error}") })
}

/// The part of an address behind the question mark.
#[derive(Debug, Clone, Copy)]
pub(super) struct Query<'a>(pub(super) &'a str);

impl Query<'_> {
    /// The first value of this name; an empty one is none.
    pub(super) fn get(self, name: &str) -> Option<String> {
        let value = form_urlencoded::parse(self.0.as_bytes()).find(|(key, _)| key == name)?.1;
        Some(value.into_owned()).filter(|value| !value.is_empty())
    }
}
