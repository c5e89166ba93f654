//! Check of the URLs that jobs may name. Without it, submitters could make the coordinator send requests into its own network.

use std::fmt;
use std::str::FromStr;

use url::Url;

/// Prefix of URLs: scheme, host, port, and whole segments of a path.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct UrlPrefix(Url);

/// Error for a text that is not a [`UrlPrefix`].
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("`{text}` is not a valid URL prefix: {message}; write it like https://hooks.example.com/femc/")]
pub struct PrefixError {
    text: String,
    message: String,
}

impl FromStr for UrlPrefix {
    type Err = PrefixError;

    fn from_str(text: &str) -> Result<Self, PrefixError> {
        let fault = |message: String| PrefixError { text: text.to_owned(), message };
        let url = parse_http_url(text).map_err(fault)?;
        if url.query().is_some() || url.fragment().is_some() {
            return Err(fault("it must not contain a query (?) or a fragment (#)".to_owned()));
        }
        Ok(Self(url))
    }
}

impl fmt::Display for UrlPrefix {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.fmt(f)
    }
}

impl UrlPrefix {
    /// Returns whether a URL begins with this prefix.
    fn allows(&self, url: &Url) -> bool {
        let is_there = url.scheme() == self.0.scheme()
            && url.host() == self.0.host()
            && url.port_or_known_default() == self.0.port_or_known_default();
        let rest = url.path().strip_prefix(self.0.path());
        is_there && rest.is_some_and(|rest| self.0.path().ends_with('/') || rest.is_empty() || rest.starts_with('/'))
    }

    /// Returns the server without the path, which may be a secret.
    fn server(&self) -> String {
        self.0.origin().ascii_serialization()
    }
}

/// Parses an HTTP URL that has a host and no user name.
fn parse_http_url(text: &str) -> Result<Url, String> {
    let url = Url::parse(text).map_err(|error| error.to_string())?;
    if !matches!(url.scheme(), "http" | "https") {
        return Err(format!("it begins with {}: instead of https: or http:", url.scheme()));
    }
    if url.host().is_none() {
        return Err("it has no host".to_owned());
    }
    if !url.username().is_empty() || url.password().is_some() {
        return Err("it contains a user name or a password, which other users could read".to_owned());
    }
    Ok(url)
}

/// Parses a URL and checks that one of the prefixes permits it. Otherwise returns the reason for the refusal.
pub(super) fn check_url(prefixes: &[UrlPrefix], text: &str) -> Result<Url, String> {
    let url = parse_http_url(text).map_err(|message| format!("cannot notify `{text}`: {message}"))?;
    if prefixes.iter().any(|prefix| prefix.allows(&url)) {
        return Ok(url);
    }
    if prefixes.is_empty() {
        return Err("this coordinator sends no notifications: it was started without --notify-allow".to_owned());
    }
    let mut servers: Vec<String> = prefixes.iter().map(UrlPrefix::server).collect();
    servers.dedup();
    Err(format!("this coordinator does not notify `{text}`: it allows only certain URLs of {}", servers.join(", ")))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_begins_so_is_allowed_and_nothing_that_only_looks_so() {
        let prefixes = ["https://hooks.test/femc/", "http://127.0.0.1:9000", "https://a.test/x"];
        let prefixes: Vec<UrlPrefix> = prefixes.iter().map(|text| text.parse().expect(text)).collect();
        for good in [
            "https://hooks.test/femc/",
            "https://hooks.test/femc/a/b?c=d",
            "https://HOOKS.test:443/femc/x",
            "https://hooks.test/other/../femc/x",
            "http://127.0.0.1:9000/any/path",
            "https://a.test/x",
            "https://a.test/x/y",
        ] {
            assert!(check_url(&prefixes, good).is_ok(), "{good}");
        }
        for bad in [
            "https://hooks.test/femc",
            "https://hooks.test/femc/../admin",
            "https://hooks.test/femc/%2e%2e/admin",
            "https://hooks.test/femc\\..\\..\\admin",
            "https://hooks.test.evil.test/femc/",
            "https://hooks.test@evil.test/femc/",
            "https://ann:secret@hooks.test/femc/",
            "https://hooks.test:8443/femc/",
            "http://hooks.test/femc/",
            "http://127.0.0.1:9001/",
            "http://127.0.0.1.evil.test:9000/",
            "http://169.254.169.254/latest/meta-data",
            "https://a.test/xy",
            "file:///etc/passwd",
            "ftp://hooks.test/femc/",
            "hooks.test/femc/",
            "",
        ] {
            assert!(check_url(&prefixes, bad).is_err(), "{bad}");
        }
        let told = check_url(&prefixes, "https://evil.test/").expect_err("not allowed");
        assert!(told.contains("https://hooks.test") && !told.contains("/femc"), "{told}");
        assert!(check_url(&[], "https://hooks.test/").expect_err("none is").contains("--notify-allow"));
    }

    #[test]
    fn a_prefix_is_a_url_of_http_and_ends_with_a_path() {
        for text in
            ["hooks.test", "https://", "https://a.test/?b", "https://a.test/#b", "https://u@a.test/", "file:///x"]
        {
            assert!(text.parse::<UrlPrefix>().is_err(), "{text}");
        }
    }
}
