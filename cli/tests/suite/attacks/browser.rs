//! Attacks over HTTP/1: by other sites' pages in a user's browser, and by programs.

use std::net::Ipv4Addr;
use std::time::{Duration, Instant};

use tokio::io::{AsyncReadExt as _, AsyncWriteExt as _};

use super::Target;
use super::peer::{connect, connect_from, wait_until_closed};
use crate::common::http::{Answer, CHANGE, send, send_request};

const CANCEL: &str = "{\"jobs\":[1],\"action\":\"cancel\"}";

fn assert_answer(answer: &Answer, status: u16, code: &str) {
    assert_eq!((answer.status, answer.code().as_str()), (status, code));
}

/// Checks that the job still exists.
fn assert_job_queued(target: &Target) {
    let jobs = send_request(target.address(), "GET /api/v1/jobs", &[], "").json();
    assert_eq!(jobs["jobs"][0]["state"], "queued");
}

pub async fn cross_site(target: &mut Target) -> String {
    target.submit();
    let post = |head: &[&str]| send_request(target.address(), "POST /api/v1/jobs/control", head, CANCEL);
    let [json, own] = CHANGE;
    // Content types that a form can send.
    for kind in ["application/x-www-form-urlencoded", "text/plain", "multipart/form-data"] {
        assert_answer(&post(&[&format!("Content-Type: {kind}")]), 400, "invalid");
    }
    assert_answer(&post(&[json]), 400, "invalid");
    assert_answer(&post(&[json, own, "Origin: http://evil.example"]), 403, "cross_site");
    assert_answer(&post(&[json, own, "Origin: null"]), 403, "cross_site");
    assert_answer(&post(&[json, own, "Sec-Fetch-Site: cross-site"]), 403, "cross_site");
    let get = send_request(target.address(), "GET /api/v1/jobs", &["Origin: http://evil.example"], "");
    assert_answer(&get, 403, "cross_site");
    assert_eq!(get.header("access-control-allow-origin"), "", "no page of another site may read");
    let preflight =
        send_request(target.address(), "OPTIONS /api/v1/jobs/control", &["Origin: http://evil.example"], "");
    assert_eq!((preflight.status, preflight.header("access-control-allow-headers")), (405, ""));
    let login = send_request(target.address(), "POST /login", &["Origin: http://evil.example"], "token=x");
    assert_eq!(login.status, 403);
    assert_job_queued(target);
    "403 cross_site, 400 where a form could have sent it".to_owned()
}

pub async fn rebinding(target: &mut Target) -> String {
    target.submit();
    for host in ["evil.example", "evil.example:7878", "127.0.0.1.evil.example", "10.1.2.3:7878", ""] {
        let host_line = format!("Host: {host}");
        assert_answer(&send_request(target.address(), "GET /api/v1/jobs", &[&host_line], ""), 403, "foreign_host");
        let head = [&*host_line, CHANGE[0], CHANGE[1]];
        assert_answer(&send_request(target.address(), "POST /api/v1/jobs/control", &head, CANCEL), 403, "foreign_host");
        assert_eq!(send_request(target.address(), "GET /", &[&host_line], "").status, 403);
    }
    assert_job_queued(target);
    "403 foreign_host".to_owned()
}

pub async fn path_traversal(target: &mut Target) -> String {
    for path in [
        "/../../../../etc/passwd",
        "/assets/../../../../etc/passwd",
        "/assets/..%2f..%2f..%2fetc%2fpasswd",
        "/%2e%2e/%2e%2e/etc/passwd",
        "//etc/passwd",
        "/assets/farm.db",
        "/api/v1/jobs/../../farm.db",
        "/api/v1/jobs/1/frames/1/../../../../farm.db",
    ] {
        let answer = send_request(target.address(), &format!("GET {path}"), &["Accept: */*"], "");
        let text = String::from_utf8_lossy(&answer.body).into_owned();
        assert!(!text.contains("root:") && !text.contains("SQLite"), "{path}: {text}");
        assert!(matches!(answer.status, 400 | 404) || text.starts_with("<!doctype html>"), "{path}: {}", answer.status);
    }
    "404, or the page".to_owned()
}

pub async fn huge_body(target: &mut Target) -> String {
    let host = target.address().to_owned();
    let announced = format!(
        "POST /api/v1/jobs/control HTTP/1.1\r\nHost: {host}\r\nContent-Type: application/json\r\nX-Femc: 1\r\n\
         Content-Length: 4294967296\r\nConnection: close\r\n\r\n"
    );
    let mut request = announced.into_bytes();
    request.resize(request.len() + (16 << 20), b' ');
    let answer = send(&host, &request);
    assert_answer(&answer, 413, "too_large");
    let login =
        send_request(&host, "POST /login", &["Content-Type: application/x-www-form-urlencoded"], &"x".repeat(1 << 20));
    assert_eq!(login.status, 413);
    "413 too_large".to_owned()
}

pub async fn forged_tokens(target: &mut Target) -> String {
    let get = |head: &str| send_request(target.address(), "GET /api/v1/jobs", &[head], "");
    let real = target.token("eve");
    let forged = format!("femc_{}", "0".repeat(64));
    let name = format!("femc-{}", target.address().rsplit_once(':').expect("a port").1);
    for head in [
        "X-Nothing: 1".to_owned(),
        format!("Cookie: {name}={forged}"),
        format!("Cookie: {name}={}", &real[..40]),
        format!("Cookie: {name}={real}; {name}={forged}"),
        format!("Authorization: Bearer {forged}"),
        format!("Authorization: Basic {real}"),
        format!("Cookie: {name}=viewer"),
    ] {
        let answer = get(&head);
        assert!(matches!(answer.status, 400 | 401), "{head}: {}", answer.status);
    }
    let form = ["Content-Type: application/x-www-form-urlencoded"];
    let login = send_request(target.address(), "POST /login", &form, &format!("token={forged}"));
    assert_eq!((login.status, login.header("set-cookie")), (401, ""));
    // Use the real token, and the cookie after the token has been revoked.
    let login = send_request(target.address(), "POST /login", &form, &format!("token={real}"));
    let cookie = login.header("set-cookie").to_owned();
    assert_eq!((login.status, login.header("location")), (303, "/"));
    assert!(cookie.contains("; HttpOnly; SameSite=Strict; Path=/"), "{cookie}");
    let cookie = format!("Cookie: {}", cookie.split(';').next().expect("a value"));
    assert_eq!(get(&cookie).status, 200);
    let drained = send_request(target.address(), "POST /api/v1/workers/drain", &[&cookie, CHANGE[0], CHANGE[1]], "{}");
    assert_answer(&drained, 403, "forbidden");
    assert_eq!(send_request(target.address(), "GET /api/v1/audit", &[&cookie], "").status, 403);
    target.revoke("eve");
    assert_answer(&get(&cookie), 401, "unauthenticated");
    "401 unauthenticated, before and after it counted".to_owned()
}

pub async fn slow_head(target: &mut Target) -> String {
    let begun = Instant::now();
    let mut stream = connect(target.address()).await;
    stream.write_all(b"GET / HTTP/1.1\r\nHost: 127.0.0.1\r\n").await.expect("it listens");
    while begun.elapsed() < Duration::from_secs(60) {
        tokio::time::sleep(Duration::from_millis(500)).await;
        if stream.write_all(b"X").await.is_err() {
            return format!("closed after {} s", begun.elapsed().as_secs());
        }
    }
    panic!("it may send its head for ever");
}

pub async fn unread_feeds(target: &mut Target) -> String {
    let request = format!("GET /api/v1/feed HTTP/1.1\r\nHost: {}\r\n\r\n", target.address());
    let mut feeds = Vec::new();
    for n in 0..300u32 {
        let from = Ipv4Addr::new(127, 0, 0, 2 + (n % 3) as u8);
        let mut stream = connect_from(from, target.address()).await.expect("a connection");
        stream.write_all(request.as_bytes()).await.expect("it listens");
        feeds.push(stream);
    }
    // None of these clients reads; the farm continues with jobs.
    for _ in 0..5 {
        target.submit();
        tokio::time::sleep(Duration::from_secs(1)).await;
    }
    target.assert_serves_others();
    let mut bytes = vec![0; 1 << 16];
    let read = feeds[0].read(&mut bytes).await.expect("events");
    let text = String::from_utf8_lossy(&bytes[..read]).into_owned();
    assert!(text.contains("event: snapshot"), "{text}");
    "served, with bounded memory".to_owned()
}

pub async fn idle_connection(target: &mut Target) -> String {
    let begun = Instant::now();
    let mut stream = connect(target.address()).await;
    let request = format!("GET /api/v1/me HTTP/1.1\r\nHost: {}\r\n\r\n", target.address());
    stream.write_all(request.as_bytes()).await.expect("it listens");
    // The answer is sent, and no further request follows.
    tokio::time::timeout(Duration::from_secs(90), drain_until_closed(&mut stream)).await.expect("closed in time");
    format!("closed after {} s", begun.elapsed().as_secs())
}

async fn drain_until_closed(stream: &mut tokio::net::TcpStream) {
    let mut bytes = [0; 1 << 12];
    while stream.read(&mut bytes).await.is_ok_and(|count| count > 0) {}
    wait_until_closed(stream).await;
}
