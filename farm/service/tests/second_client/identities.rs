//! Laws of rights: an answer depends on its caller, and not on the callers before.

use std::sync::{Arc, Mutex};
use std::time::Duration;

use femc_service::{Gate, Http};
use femc_trust::{Authority, Holder, Role, Tokens};
use http::header::{AUTHORIZATION, HeaderName, IF_NONE_MATCH};
use http_body_util::BodyExt as _;
use serde_json::Value;
use tokio::time::{Instant, timeout};

use crate::common::{Answer, Random, ask, post, send, wide_limits};
use crate::documentation;
use crate::feed::{self, FarmState};
use crate::world::{Server, World};

/// A caller.
#[derive(Debug, Clone)]
struct Caller {
    name: &'static str,
    /// Role as in the documentation; empty: no identity.
    role: &'static str,
    /// Value of the header `Authorization`.
    authorization: String,
}

impl Caller {
    fn header(&self) -> (HeaderName, &str) {
        (AUTHORIZATION, &self.authorization)
    }

    /// Returns whether the documentation permits a request to this caller.
    fn may(&self, allowed: &str) -> bool {
        let roles: &[&str] = match allowed {
            "everybody" => return true,
            "any identity" => &["worker", "viewer", "submitter", "operator", "admin"],
            "viewers" => &["viewer", "submitter", "operator", "admin"],
            "the owner, if a submitter; operators" => &["submitter", "operator", "admin"],
            "operators" => &["operator", "admin"],
            "admins" => &["admin"],
            other => panic!("unknown callers: {other}"),
        };
        roles.contains(&self.role)
    }
}

/// An authority with callers of all kinds.
struct Identities {
    _folder: tempfile::TempDir,
    authority: Authority,
    callers: Vec<Caller>,
}

impl Identities {
    fn new() -> Self {
        let folder = tempfile::tempdir().expect("a folder");
        let authority = Authority::init(folder.path(), "farm").expect("an authority");
        let mut callers =
            vec![Caller { name: "a caller without identity", role: "", authorization: "Bearer x".into() }];
        for (name, role) in [
            ("vera", "viewer"),
            ("ann", "submitter"),
            ("bob", "submitter"),
            ("otto", "operator"),
            ("ada", "admin"),
            ("w1", "worker"),
        ] {
            let user = |role| Holder::User { name: name.into(), role };
            let holder = match role {
                "viewer" => user(Role::Viewer),
                "submitter" => user(Role::Submitter),
                "operator" => user(Role::Operator),
                "admin" => user(Role::Admin),
                _ => Holder::Worker { name: name.into() },
            };
            let secret = authority.issue_token(holder, 1).expect("a token").token().secret();
            callers.push(Caller { name, role, authorization: format!("Bearer {secret}") });
        }
        Self { _folder: folder, authority, callers }
    }

    fn gate(&self) -> Gate {
        let tokens = Tokens::open(self.authority.tokens_path()).expect("the tokens");
        Gate::new(Some((None, Some(tokens))), wide_limits(), None)
    }

    fn caller(&self, name: &str) -> &Caller {
        self.callers.iter().find(|caller| caller.name == name).expect("a caller")
    }
}

/// Makes the farm and its server.
async fn server(folder: &tempfile::TempDir) -> Server {
    let file = folder.path().join("file");
    std::fs::write(&file, "light of a file").expect("a file");
    Server::new(&World::new(vec![file])).await
}

/// Returns the documented requests with numbers, except the feed, and their callers.
fn requests() -> Vec<(String, String)> {
    let all = documentation::requests().into_iter().filter(|request| !request.path.ends_with("/feed"));
    let line = |request: &documentation::Request| {
        let path =
            request.path.replace("JOB", "7").replace("/frames/N/", "/frames/3/").replace("/files/N/", "/files/0/");
        // The example of the documentation names frames that the job lacks.
        let path =
            path.replace("frames=1,3,5..8", "frames=3").replace("frames=1", "frames=3").replace("CONDITION", "d");
        format!("{} {path}", request.method)
    };
    all.map(|request| (line(&request), request.allowed)).collect()
}

#[tokio::test(start_paused = true)]
async fn rights_do_not_depend_on_earlier_callers() {
    let (folder, identities) = (tempfile::tempdir().expect("a folder"), Identities::new());
    let (server, gate) = (server(&folder).await, identities.gate());
    let start = || Server::with_store(&server.world.lock().unwrap(), server.store.clone(), gate.clone());
    let mut contents = 0;
    for (line, allowed) in requests() {
        // A request of an admin shows the content.
        let whole = ask(&start().http, &line, &[identities.caller("ada").header()]).await;
        for first in &identities.callers {
            for second in &identities.callers {
                let server = start();
                for caller in [first, second] {
                    let headers = [caller.header(), (IF_NONE_MATCH, &format!("\"{}\"", whole.tag))];
                    for headers in [&headers[..1], &headers[..]] {
                        let got = ask(&server.http, &line, headers).await;
                        check(&got, &whole, caller, caller.may(&allowed), &line);
                    }
                }
            }
        }
        contents += u32::from(whole.status == 200);
    }
    assert!(contents >= 24, "{contents} requests have content");
}

/// Checks the answer to a caller.
fn check(got: &Answer, whole: &Answer, caller: &Caller, is_permitted: bool, line: &str) {
    let case = format!("{line} of {}", caller.name);
    if !is_permitted {
        assert_eq!(got.status, if caller.role.is_empty() { 401 } else { 403 }, "{case}");
        let error: Value = serde_json::from_slice(&got.body).unwrap_or_else(|error| panic!("{case}: {error}"));
        assert!(error["error"]["code"].is_string() && got.tag.is_empty(), "{case}");
        return;
    }
    if line.ends_with("/me") {
        let me: Value = serde_json::from_slice(&got.body).expect("JSON");
        assert_eq!((&me["name"], &me["role"]), (&caller.name.into(), &caller.role.into()), "{case}");
        return;
    }
    // Requests to log in have no token here.
    assert!(!matches!(got.status, 401 | 403) || line.ends_with("/login"), "{case}: {}", got.status);
    if whole.status == 200 && got.status != 304 {
        assert_eq!(got, whole, "{case}");
    }
    assert!(got.status != 304 || !whole.tag.is_empty(), "{case}");
}

#[tokio::test(start_paused = true)]
async fn control_of_a_job_does_not_depend_on_earlier_callers() {
    /// Callers, and the jobs of ann and bob that they may control.
    const MAY: [(&str, [bool; 2]); 6] = [
        ("vera", [false, false]),
        ("ann", [true, false]),
        ("bob", [false, true]),
        ("otto", [true, true]),
        ("ada", [true, true]),
        ("w1", [false, false]),
    ];
    let (folder, identities) = (tempfile::tempdir().expect("a folder"), Identities::new());
    let server = server(&folder).await;
    for first in MAY {
        for second in MAY {
            let world = server.world.lock().unwrap().clone();
            let server = Server::with_store(&world, server.store.clone(), identities.gate());
            for (name, may) in [first, second] {
                let body = r#"{"jobs": [7, 8], "action": "pause"}"#;
                let got = post(&server.http, "/api/v1/jobs/control", identities.caller(name).header(), body).await;
                if matches!(name, "vera" | "w1") {
                    assert_eq!(got.status, 403, "{name}");
                    continue;
                }
                let json: Value = serde_json::from_slice(&got.body).expect("JSON");
                let due: Vec<u64> = [7, 8].into_iter().zip(may).filter(|(_, may)| *may).map(|(job, _)| job).collect();
                assert_eq!(json["done"], serde_json::json!(due), "{name} after {}: {json}", first.0);
            }
        }
    }
}

/// Reads events until one fits or the time is over. Returns `None` when the feed ends.
async fn next_event(body: &mut femc_service::Body, patience: Duration) -> Option<bool> {
    let until = Instant::now() + patience;
    loop {
        match timeout(until - Instant::now(), body.frame()).await {
            Err(_) => return Some(false),
            Ok(None) => return None,
            Ok(Some(frame)) => {
                let bytes = frame.expect("no error").into_data().expect("data");
                if !bytes.starts_with(b":") {
                    return Some(true);
                }
            }
        }
    }
}

async fn listen(http: &Http<()>, caller: &Caller) -> femc_service::Body {
    let response = send(http, "GET /api/v1/feed", &[caller.header()]).await;
    assert_eq!(response.status(), 200, "{}", caller.name);
    response.into_body()
}

#[tokio::test(start_paused = true)]
async fn a_feed_ends_with_its_token_and_others_go_on() {
    for (is_busy, order) in [(false, [0, 1]), (false, [1, 0]), (true, [0, 1]), (true, [1, 0])] {
        let (identities, mut random) = (Identities::new(), Random(1));
        let state = Arc::new(Mutex::new(FarmState::default()));
        let http = feed::start(&state, identities.gate());
        let (leaving, staying) = (identities.caller("vera").clone(), identities.caller("ann").clone());
        let mut bodies = Vec::new();
        for place in order {
            bodies.push(listen(&http, [&leaving, &staying][place]).await);
        }
        let mut own = bodies.swap_remove(order[1]);
        let mut ended = bodies.pop().expect("two feeds");
        for body in [&mut ended, &mut own] {
            assert_eq!(next_event(body, Duration::from_millis(1)).await, Some(true), "a snapshot");
        }
        identities.authority.revoke("vera").expect("revoked");
        let until = Instant::now() + Duration::from_secs(2);
        let mut is_open = true;
        while is_open && Instant::now() < until {
            if is_busy {
                (0..9).for_each(|_| state.lock().unwrap().change(&mut random));
            }
            is_open = next_event(&mut ended, Duration::from_millis(500)).await.is_some();
        }
        assert!(!is_open, "the feed ends within two seconds after its token");
        for _ in 0..3 {
            (0..9).for_each(|_| state.lock().unwrap().change(&mut random));
            assert_eq!(next_event(&mut own, Duration::from_secs(2)).await, Some(true), "the other feed has news");
        }
        assert_eq!(send(&http, "GET /api/v1/feed", &[leaving.header()]).await.status(), 401);
        let mut another = listen(&http, &staying).await;
        assert_eq!(next_event(&mut another, Duration::from_millis(1)).await, Some(true), "a new feed has a snapshot");
    }
}
