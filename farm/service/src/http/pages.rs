//! Files of the web page, which are part of the program.

use ::http::header::{CACHE_CONTROL, HeaderValue};
use ::http::{Response, StatusCode};

use super::error::HttpError;
use super::response::{self, Body};

/// Files by path in the page's folder, such as `index.html` and `assets/index-4f2a.js`.
#[derive(Debug, Clone, Copy, Default)]
pub struct PageFiles(pub &'static [(&'static str, &'static [u8])]);

impl PageFiles {
    const INDEX: &str = "index.html";
    /// Folder of files with hashes in their names. The content of such a file never changes.
    const HASHED: &str = "assets/";

    /// Returns whether the page was left out of the build.
    pub fn is_empty(self) -> bool {
        self.0.is_empty()
    }

    /// Returns the file at a path. A path without a file belongs to the page's own router and returns the page.
    pub(super) fn get(self, path: &str) -> Result<Response<Body>, HttpError> {
        let path = path.trim_start_matches('/');
        let find = |path: &str| self.0.iter().find(|(name, _)| *name == path);
        let is_file = path.starts_with(Self::HASHED) || path.rsplit('/').next().is_some_and(|last| last.contains('.'));
        let found = match find(path) {
            None if is_file => return Err(HttpError::UnknownPath { path: format!("/{path}") }),
            None => find(Self::INDEX),
            found => found,
        };
        let (name, bytes) = found.ok_or(HttpError::NoWebPage)?;
        let mut response = response::bytes(StatusCode::OK, kind(name), *bytes);
        let cached = if name.starts_with(Self::HASHED) { "public, max-age=31536000, immutable" } else { "no-cache" };
        response.headers_mut().insert(CACHE_CONTROL, HeaderValue::from_static(cached));
        Ok(response)
    }
}

/// Returns the media type of a file, from its name.
fn kind(name: &str) -> &'static str {
    match name.rsplit('.').next().unwrap_or_default() {
        "html" => "text/html; charset=utf-8",
        "js" | "mjs" => "text/javascript; charset=utf-8",
        "css" => "text/css; charset=utf-8",
        "json" | "webmanifest" | "map" => "application/json",
        "svg" => "image/svg+xml",
        "png" => "image/png",
        "ico" => "image/x-icon",
        "woff2" => "font/woff2",
        "wasm" => "application/wasm",
        "txt" => "text/plain; charset=utf-8",
        _ => "application/octet-stream",
    }
}

#[cfg(test)]
mod tests {
    use femc_model::StageKind;

    #[test]
    fn the_pages_know_all_kinds_of_tasks_and_no_others() {
        let source = include_str!("../../../../web/src/lib/kinds.ts");
        let list =
            source.split_once("KINDS = [").and_then(|(_, rest)| rest.split_once(']')).expect("a list of kinds").0;
        let mut known: Vec<&str> = list.split('\'').skip(1).step_by(2).collect();
        let mut kinds: Vec<&str> = StageKind::ALL.iter().map(|kind| kind.name()).collect();
        known.sort_unstable();
        kinds.sort_unstable();
        assert_eq!(known, kinds, "web/src/lib/kinds.ts and graph/src/kind.rs");
    }
}
