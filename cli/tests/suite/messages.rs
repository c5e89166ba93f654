//! Tests of messages about problems: they must name the cause and a remedy.
#![cfg(unix)]

use crate::common;
use crate::common::{TestFolder, TestProcess, start_coordinator, submit};
use std::io::{Read as _, Write as _};
use std::net::TcpListener;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

/// Starts a farm with its own authority and creates a user of it.
fn encrypted(dir: &TestFolder) -> (TestProcess, String) {
    dir.run("ca init").exits(0);
    for holder in ["coordinator farm", "worker w1", "user ann --role submitter", "user eve --role viewer"] {
        dir.run(&format!("ca issue {holder}")).exits(0);
    }
    let mut farm = dir.start(
        "coordinator --listen 127.0.0.1:0 --store sqlite:farm.db --artifacts artifacts --identity farm.pem --revoked femc-ca/revoked",
    );
    let line = farm.first_line();
    let url = line.split_whitespace().find(|word| word.starts_with("https://")).expect("the address").to_owned();
    (farm, url)
}

/// Starts a server that answers like an old web server.
fn web_server() -> String {
    let listener = TcpListener::bind("127.0.0.1:0").expect("a port");
    let url = format!("http://{}", listener.local_addr().expect("its address"));
    std::thread::spawn(move || {
        for mut stream in listener.incoming().flatten() {
            let _ = stream.read(&mut [0; 256]);
            let _ = stream.write_all(b"HTTP/1.1 400 Bad Request\r\nContent-Length: 0\r\n\r\n");
        }
    });
    url
}

#[test]
fn unusable_address_is_not_reported_as_coordinator_not_started() {
    let (dir, other) = (TestFolder::new(), TestFolder::new());
    let (_farm, url) = encrypted(&dir);
    let (_plain, open) = start_coordinator(&other, 0);
    other.run("ca init").exits(0);
    other.run("ca issue user sue --role admin").exits(0);
    std::fs::copy(other.path("sue.pem"), dir.path("sue.pem")).expect("copied");
    let (as_http, as_https) = (url.replace("https", "http"), open.replace("http", "https"));
    let web = web_server();
    for (address, identity, said) in [
        (&as_http, "", "is encrypted; write https://"),
        (&as_https, "--identity ann.pem", "is not encrypted"),
        (&url, "--identity sue.pem", "belongs to another farm"),
        (&web, "", "is not a coordinator"),
    ] {
        for command in ["jobs --server", "submit fog.mgf --spp 1 --server", "worker --join"] {
            let error = dir.run(&format!("{command} {address} {identity}")).exits(4).stderr();
            assert!(error.contains(said) && error.contains(address.as_str()), "{command} {address}: {error}");
            assert!(!error.contains("start one"), "{command} {address}: {error}");
        }
    }
    let error = dir.run("jobs --server 127.0.0.1:7878").exits(2).stderr();
    assert!(error.contains("http:// or https://") && error.contains("http://127.0.0.1:7878"), "{error}");
    let error = dir.run("worker --join http://127.0.0.1:1 --patience 0.1").exits(4).stderr();
    assert!(error.contains("start one") && error.contains("--join") && !error.contains("--server"), "{error}");
}

#[test]
fn silent_server_is_reported_and_a_worker_waits_for_it() {
    let dir = TestFolder::new();
    // Acts like the near end of a tunnel whose far end is not up yet; after some connections it closes.
    let tunnel = TcpListener::bind("127.0.0.1:0").expect("a port");
    let port = tunnel.local_addr().expect("its address").port();
    let url = format!("http://127.0.0.1:{port}");
    let taken = Arc::new(AtomicUsize::new(0));
    let last = Arc::new(AtomicUsize::new(usize::MAX));
    let (counted, limit) = (taken.clone(), last.clone());
    let ends = std::thread::spawn(move || {
        while counted.load(Ordering::SeqCst) < limit.load(Ordering::SeqCst) {
            drop(tunnel.accept());
            counted.fetch_add(1, Ordering::SeqCst);
        }
    });
    let error = dir.run(&format!("worker --join {url} --threads 1 --patience 0.1")).exits(4).stderr();
    assert!(error.contains("does not answer") && error.contains("--join") && error.contains(&url), "{error}");
    last.store(taken.load(Ordering::SeqCst) + 10, Ordering::SeqCst);
    let mut worker = dir.start(&format!("worker --join {url} --threads 1 --patience 60s --outbox memory"));
    worker.wait_until("it goes on trying", || ends.is_finished());
    let (_farm, url) = start_coordinator(&dir, port);
    let workers = || dir.run(&format!("workers --json --server {url}")).exits(0).json();
    worker.wait_until("it is there", || workers().as_array().is_some_and(|workers| !workers.is_empty()));
}

#[test]
fn role_error_names_the_right_role_and_ignored_owner_is_noted() {
    let dir = TestFolder::new();
    let (_farm, url) = encrypted(&dir);
    let error = dir.run(&format!("submit fog.mgf --spp 1 --server {url} --identity eve.pem")).exits(1).stderr();
    assert!(error.contains("role submitter") && !error.contains("worker"), "{error}");
    let ran = dir.run(&format!("submit fog.mgf --spp 1 --owner bob --server {url} --identity ann.pem")).exits(0);
    assert!(ran.stderr().contains("--owner bob is ignored") && ran.stderr().contains("ann"), "{}", ran.stderr());
    let ran = dir.run(&format!("submit fog.mgf --spp 1 --owner ann --server {url} --identity ann.pem")).exits(0);
    assert!(!ran.stderr().contains("--owner"), "{}", ran.stderr());
}

#[test]
fn watch_reports_a_lost_coordinator_and_resumes_when_it_is_back() {
    let dir = TestFolder::new();
    let (mut farm, url) = start_coordinator(&dir, 0);
    let job = submit(&dir, &url, "--spp 4 --frames 1");
    let mut watch = dir.start_as("watch", &format!("watch {job} --json --server {url}"));
    watch.wait_until("the first status", || dir.read("watch.out").contains("\"event\":\"status\""));
    farm.kill();
    watch.wait_until("it is told", || dir.read("watch.err").contains("has been away for"));
    assert!(dir.read("watch.out").contains("\"event\":\"away\""), "{}", dir.read("watch.out"));
    let port = url.rsplit(':').next().and_then(|port| port.parse().ok()).expect("a port");
    let (_farm, _) = start_coordinator(&dir, port);
    watch.wait_until("it is back", || dir.read("watch.out").contains("\"event\":\"back\""));
    let _worker = dir.start(&format!("worker --join {url} --threads 1"));
    watch.end().exits(0);
    assert!(dir.read("watch.err").contains("the watch resumes"), "{}", dir.read("watch.err"));
    for line in dir.read("watch.out").lines() {
        let event: serde_json::Value = serde_json::from_str(line).expect("an object a line");
        assert!(event["event"].is_string(), "{line}");
    }
}

#[test]
fn why_reports_an_unresponsive_worker_and_one_short_of_memory() {
    let dir = TestFolder::new();
    let (mut farm, url) = start_coordinator(&dir, 0);
    let job = submit(&dir, &url, "--spp 4 --frames 1");
    let why = || dir.run(&format!("status {job} --why --server {url}")).exits(0).stdout();
    let mut poor = dir.start(&format!("worker --join {url} --threads 1 --memory 1MiB"));
    farm.wait_until("the limit is told", || why().contains("(--memory)"));
    poor.kill();
    // The worker's environment leaves it nothing to do, because the job's tags are not its own.
    let tagged = submit(&dir, &url, "--spp 100000 --frames 1 --tags lab --size 64x64");
    let mut worker = dir.start(&format!("worker --join {url} --threads 1 --tags lab"));
    let tiles = || common::status(&dir, &url, &tagged)["active"][0]["running"].as_u64().unwrap_or(0);
    farm.wait_until("it works", || tiles() > 0);
    worker.signal("STOP");
    let why = || dir.run(&format!("status {tagged} --why --server {url}")).exits(0).stdout();
    farm.wait_until("its silence is told", || why().contains("1 worker has not responded for"));
    assert!(!why().contains("rest"), "{}", why());
}
