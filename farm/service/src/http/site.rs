//! Protection against pages of other sites, and the login cookie.
//!
//! A browser sends requests on behalf of any page that it shows. So a change must come as JSON with a custom header: a form of
//! another site cannot send it, and a script could only after this server permits it, which it never does. An `Origin` header, if
//! present, must be the coordinator itself. Requests that the browser marks as cross-site are refused. A coordinator without
//! authentication could also be reached by a page whose host name was made to resolve to this machine (DNS rebinding). So it
//! answers only requests that name it by its own address.

use std::net::IpAddr;

use ::http::Method;
use ::http::header::{AUTHORIZATION, CONTENT_TYPE, COOKIE, HOST, HeaderName, HeaderValue, ORIGIN};

use super::RequestHead;
use super::connected_client::ConnectedClient;
use super::error::HttpError;
use super::route::Route;

/// Name of the cookie without a port.
const COOKIE_NAME: &str = "femc";
/// Header that only the web page and programs send.
const OWN_HEADER: HeaderName = HeaderName::from_static("x-femc");
const FETCH_SITE: HeaderName = HeaderName::from_static("sec-fetch-site");
const FETCH_MODE: HeaderName = HeaderName::from_static("sec-fetch-mode");

/// Returns the name of the cookie, which contains the port of the address. Browsers send cookies to all ports of a host, so
/// coordinators on one machine need different names.
fn cookie_name(host: &str) -> String {
    let port = host.rsplit_once(':').map(|(_, port)| port).filter(|port| port.parse::<u16>().is_ok());
    port.map_or_else(|| COOKIE_NAME.to_owned(), |port| format!("{COOKIE_NAME}-{port}"))
}

/// Returns the token of a request, from the header or else from the cookie.
pub(super) fn token<'a>(request_head: &RequestHead<'a>) -> Result<Option<&'a str>, HttpError> {
    let (headers, cookie_name) = (request_head.headers, cookie_name(&host(request_head)));
    if let Some(header) = headers.get(AUTHORIZATION) {
        // A header that is not a bearer token gives an empty token, which is invalid.
        return Ok(Some(text(header).strip_prefix("Bearer ").unwrap_or_default()));
    }
    let cookies = headers.get_all(COOKIE).into_iter().flat_map(|cookies| text(cookies).split(';'));
    let mut own = cookies.filter_map(|cookie| cookie.trim().split_once('=')).filter(|(name, _)| *name == cookie_name);
    let token = own.next().map(|(_, value)| value);
    if own.next().is_some() {
        return Err(invalid("Cookie", "the request has two cookies of this coordinator: log out and log in again"));
    }
    Ok(token.filter(|token| !token.is_empty()))
}

fn text(value: &HeaderValue) -> &str {
    value.to_str().unwrap_or_default()
}

fn invalid(field: &str, message: &str) -> HttpError {
    HttpError::Invalid { field: field.into(), message: message.into() }
}

/// Makes the cookie that holds a token; `None` deletes the cookie.
pub(super) fn cookie(request_head: &RequestHead<'_>, token: Option<&str>, is_encrypted: bool) -> Option<HeaderValue> {
    let name = cookie_name(&host(request_head));
    let secure = if is_encrypted { "; Secure" } else { "" };
    let end = if token.is_none() { "; Max-Age=0" } else { "" };
    let token = token.unwrap_or_default();
    let mut value =
        HeaderValue::try_from(format!("{name}={token}; HttpOnly; SameSite=Strict; Path=/{secure}{end}")).ok()?;
    value.set_sensitive(true);
    Some(value)
}

/// Refuses requests that a page of another site may have sent.
pub(super) fn check(
    route: &Route,
    request_head: &RequestHead<'_>,
    client: &ConnectedClient,
    requires_authentication: bool,
) -> Result<(), HttpError> {
    let host = host(request_head);
    if !requires_authentication && client.address.is_some() && !is_own(&host, client) {
        return Err(HttpError::ForeignHost { host });
    }
    if let Some(origin) = request_head.headers.get(ORIGIN).map(text)
        && origin.split_once("://").is_none_or(|(_, authority)| !authority.eq_ignore_ascii_case(&host))
    {
        return Err(HttpError::CrossSite { origin: origin.to_owned() });
    }
    let header = |name: HeaderName| request_head.headers.get(name).map(text).unwrap_or_default();
    let is_visit =
        *request_head.method == Method::GET && header(FETCH_MODE) == "navigate" && matches!(route, Route::Page(_));
    if matches!(header(FETCH_SITE), "cross-site" | "same-site") && !is_visit {
        return Err(HttpError::CrossSite { origin: "another site".into() });
    }
    if route.is_change() {
        let kind = header(CONTENT_TYPE).split(';').next().unwrap_or_default().trim();
        if !kind.eq_ignore_ascii_case("application/json") {
            return Err(invalid("Content-Type", "must be application/json"));
        }
        if header(OWN_HEADER) != "1" {
            return Err(invalid("X-Femc", "requests that change something must have the header `X-Femc: 1`"));
        }
    }
    Ok(())
}

/// Returns the host name, with the port, by which the client names the server.
fn host(request_head: &RequestHead<'_>) -> String {
    let authority = request_head.uri.authority().map(|authority| authority.as_str().to_owned());
    authority.or_else(|| request_head.headers.get(HOST).map(|host| text(host).to_owned())).unwrap_or_default()
}

/// Returns whether a host name is this machine's loopback, or the address at which the client reached the server. The port may
/// differ, because of tunnels.
fn is_own(host: &str, client: &ConnectedClient) -> bool {
    let name = match host.strip_prefix('[').and_then(|rest| rest.split_once(']')) {
        Some((ip, _)) => ip,
        None => host.rsplit_once(':').map_or(host, |(name, _)| name),
    };
    if name.eq_ignore_ascii_case("localhost") {
        return true;
    }
    let reached = client.local_address.map(|address| address.ip().to_canonical());
    name.parse::<IpAddr>().is_ok_and(|ip| ip.to_canonical().is_loopback() || Some(ip.to_canonical()) == reached)
}

#[cfg(test)]
mod tests {
    use ::http::{HeaderMap, Uri};

    use super::*;

    fn headers(pairs: &[(&'static str, &str)]) -> HeaderMap {
        pairs.iter().map(|(name, value)| (HeaderName::from_static(name), value.parse().unwrap())).collect()
    }

    #[test]
    fn a_host_is_the_coordinators_own_if_it_is_an_address_of_it() {
        let reached = Some("10.0.0.5:7878".parse().unwrap());
        let visitor = ConnectedClient { address: reached, local_address: reached, ..ConnectedClient::default() };
        for own in ["localhost", "LOCALHOST:9000", "127.0.0.1:7878", "127.9.9.9", "[::1]:7878", "10.0.0.5:7878"] {
            assert!(is_own(own, &visitor), "{own}");
        }
        for foreign in
            ["", "evil.example", "evil.example:7878", "localhost.evil.example", "10.0.0.6", "[::2]:1", ":", "["]
        {
            assert!(!is_own(foreign, &visitor), "{foreign}");
        }
    }

    #[test]
    fn a_token_is_the_header_s_else_the_cookie_s() {
        let uri: Uri = "/api/v1/jobs".parse().unwrap();
        let token_of = |pairs: &[(&'static str, &str)]| {
            let headers = headers(pairs);
            let head = RequestHead { method: &Method::GET, uri: &uri, headers: &headers };
            token(&head).map(|token| token.map(str::to_owned))
        };
        let own = ("host", "127.0.0.1:7878");
        assert_eq!(token_of(&[own]).unwrap(), None);
        assert_eq!(token_of(&[own, ("cookie", "a=b; femc-7878=x; c=d")]).unwrap().as_deref(), Some("x"));
        assert_eq!(token_of(&[("host", "farm"), ("cookie", "femc-7878=x; femc=y")]).unwrap().as_deref(), Some("y"));
        assert_eq!(token_of(&[("host", "[::1]:7878"), ("cookie", "femc-7878=x")]).unwrap().as_deref(), Some("x"));
        assert_eq!(token_of(&[own, ("cookie", "femc-7879=x; femc=z; femc-7878=")]).unwrap(), None, "of another port");
        let both = [own, ("cookie", "femc-7878=x"), ("authorization", "Bearer y")];
        assert_eq!(token_of(&both).unwrap().as_deref(), Some("y"));
        let basic = token_of(&[own, ("authorization", "Basic y")]).unwrap();
        assert_eq!(basic.as_deref(), Some(""), "a wrong one, and not none");
        assert!(token_of(&[own, ("cookie", "femc-7878=x; femc-7878=y")]).is_err());
    }

    #[test]
    fn what_another_site_may_have_sent_is_refused() {
        let address = Some("127.0.0.1:7878".parse().unwrap());
        let visitor = ConnectedClient { address, local_address: address, ..ConnectedClient::default() };
        let uri: Uri = "/api/v1/jobs".parse().unwrap();
        let checked = |pairs: &[(&'static str, &str)]| {
            let headers = headers(pairs);
            let asked = RequestHead { method: &Method::GET, uri: &uri, headers: &headers };
            check(&Route::Jobs, &asked, &visitor, false)
        };
        let own = ("host", "127.0.0.1:7878");
        assert!(checked(&[own]).is_ok());
        assert!(checked(&[own, ("origin", "http://127.0.0.1:7878"), ("sec-fetch-site", "same-origin")]).is_ok());
        for origin in ["http://evil.example", "null", "http://127.0.0.1:80", "http://127.0.0.1:7878.evil.example"] {
            assert!(matches!(checked(&[own, ("origin", origin)]), Err(HttpError::CrossSite { .. })), "{origin}");
        }
        assert!(matches!(checked(&[own, ("sec-fetch-site", "cross-site")]), Err(HttpError::CrossSite { .. })));
        assert!(matches!(checked(&[("host", "evil.example:7878")]), Err(HttpError::ForeignHost { .. })));
        assert!(matches!(checked(&[]), Err(HttpError::ForeignHost { .. })));
    }
}
