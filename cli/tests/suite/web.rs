//! Tests of the farm over HTTP: the life of a job on a web page, from its submission to its picture.
#![cfg(unix)]

use std::io::{BufRead as _, BufReader, Write as _};
use std::net::TcpStream;
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use crate::common::http::{Answer, CHANGE, half_float, send_request};
use crate::common::{STEP_TIMEOUT, TestFolder, start_coordinator, submit};

fn get(address: &str, path: &str) -> Answer {
    send_request(address, &format!("GET /api/v1/{path}"), &[], "")
}

fn address(url: &str) -> String {
    url.trim_start_matches("http://").to_owned()
}

/// A web page that listens for events.
struct EventListener(BufReader<TcpStream>);

impl EventListener {
    fn connect(address: &str, last: Option<&str>) -> Self {
        let mut stream = TcpStream::connect(address).expect("a connection");
        stream.set_read_timeout(Some(STEP_TIMEOUT)).expect("a timeout");
        let last = last.map_or(String::new(), |id| format!("Last-Event-ID: {id}\r\n"));
        write!(stream, "GET /api/v1/feed HTTP/1.1\r\nHost: {address}\r\n{last}\r\n").expect("it listens");
        Self(BufReader::new(stream))
    }

    /// Returns the kind, the id and the data of the next event; `None`: the connection ended.
    fn next(&mut self) -> Option<(String, String, serde_json::Value)> {
        let (mut id, mut kind) = (String::new(), String::new());
        loop {
            let mut line = String::new();
            if self.0.read_line(&mut line).ok()? == 0 {
                return None;
            }
            if let Some(text) = line.strip_prefix("id: ") {
                id = text.trim().to_owned();
            } else if let Some(text) = line.strip_prefix("event: ") {
                kind = text.trim().to_owned();
            } else if let Some(text) = line.strip_prefix("data: ") {
                return Some((kind, id, serde_json::from_str(text).expect("JSON")));
            }
        }
    }
}

#[test]
fn page_follows_job_from_submission_to_picture_and_controls_it() {
    let dir = TestFolder::new();
    let (_coordinator, url) = start_coordinator(&dir, 0);
    let address = address(&url);
    let me = get(&address, "me").json();
    assert!(me["role"].is_null() && me["secured"] == false && me["engine"].as_str().is_some_and(|it| !it.is_empty()));
    let job = submit(&dir, &url, "--frames 1..2 --spp 4");
    // The list equals that of the command line.
    let listed = get(&address, "jobs").json();
    assert_eq!(listed["jobs"], dir.run(&format!("jobs --json --server {url}")).exits(0).json());
    let submitted = listed["jobs"][0]["submitted"].as_f64().expect("a date");
    let now = SystemTime::now().duration_since(UNIX_EPOCH).expect("a date").as_secs_f64();
    assert!((now - STEP_TIMEOUT.as_secs_f64()..=now).contains(&submitted), "{submitted}, and it is {now}");
    let table = dir.run(&format!("jobs --server {url}")).exits(0).stdout();
    assert!(table.lines().next().is_some_and(|head| head.ends_with("age")), "{table}");
    let one = get(&address, &format!("jobs/{job}")).json();
    assert_eq!((&one["spec"]["film"][0], &one["spec"]["frames"][1]), (&32.into(), &2.into()));
    let page = get(&address, &format!("jobs/{job}/tasks?count=2&frame=1&stage=0")).json();
    assert_eq!((&page["total"], page["tasks"].as_array().expect("tasks").len()), (&4.into(), 2));
    assert_eq!(page["tasks"][1]["task"], format!("{job}/1.0/render.0/1"));
    assert_eq!(get(&address, &format!("jobs/{job}/frames/1/thumbnail.png")).status, 204, "nothing yet");
    let control = |body: &str| send_request(&address, "POST /api/v1/jobs/control", &CHANGE, body).json();
    let paused = control(&format!("{{\"jobs\":[{job},99],\"action\":\"pause\"}}"));
    assert_eq!((&paused["done"][0], &paused["refused"][0]["code"]), (&1.into(), &"not_found".into()));
    assert_eq!(get(&address, &format!("jobs/{job}")).json()["job"]["state"], "paused");
    control(&format!("{{\"jobs\":[{job}],\"action\":\"resume\"}}"));
    let _worker = dir.start(&format!("worker --join {url} --name w1 --threads 1"));
    dir.run(&format!("watch {job} --server {url}")).exits(0);
    let frames = get(&address, &format!("jobs/{job}/frames")).json();
    let frames = frames["frames"].as_array().expect("frames");
    assert!(frames.iter().all(|frame| frame["state"] == "done" && frame["has_image"] == true), "{frames:?}");
    let window = get(&address, &format!("jobs/{job}/frames?from=1&count=1")).json();
    assert_eq!((&window["total"], &window["frames"][0]["frame"]), (&2.into(), &2.into()));
    let done = get(&address, &format!("jobs/{job}/tasks?state=done")).json();
    let all = get(&address, &format!("jobs/{job}/tasks")).json();
    assert_eq!(done["total"], all["total"]);
    assert_eq!(get(&address, &format!("jobs/{job}/tasks?state=failed")).json()["total"], 0);
    let attempts = get(&address, &format!("jobs/{job}/attempts")).json();
    let attempts = attempts["attempts"].as_array().expect("attempts");
    assert!(!attempts.is_empty() && attempts.iter().all(|it| it["worker"] == "w1" && it["ending"] == "done"));
    let picture = get(&address, &format!("jobs/{job}/frames/2/thumbnail.png?height=16"));
    assert_eq!((picture.status, picture.header("content-type")), (200, "image/png"));
    assert!(picture.body.starts_with(b"\x89PNG"));
    let tag = format!("If-None-Match: {}", picture.header("etag"));
    let again =
        send_request(&address, &format!("GET /api/v1/jobs/{job}/frames/2/thumbnail.png?height=16"), &[&tag], "");
    assert_eq!((again.status, again.body.len()), (304, 0));
    let pixels = get(&address, &format!("jobs/{job}/frames/2/pixels"));
    assert_eq!((pixels.status, &pixels.body[..4]), (200, &b"FMXC"[..]));
    let head = 20 + 8 * 4 + "RGBYerrorstandard_errorfreedomsamples".len();
    assert_eq!(pixels.body.len(), head + 8 * 2 * 32 * 32);
    let drained =
        send_request(&address, "POST /api/v1/workers/drain", &CHANGE, "{\"workers\":[\"w1\"],\"action\":\"begin\"}");
    assert_eq!(drained.json()["done"].as_array().expect("sessions").len(), 1);
    let lines = get(&address, "audit?count=5").json();
    assert_eq!(
        (&lines["lines"][0]["call"], &lines["lines"][0]["outcome"]),
        (&"Jobs/DrainWorkers".into(), &"ok".into())
    );
    for (path, status) in [
        ("jobs/x", 400),
        ("jobs/77", 404),
        ("jobs/1/tasks?state=odd", 400),
        ("jobs/1/tasks?from=-1", 400),
        ("jobs/1/frames/1/thumbnail.png?height=9999999", 400),
        ("audit?count=0", 400),
        ("nothing", 404),
    ] {
        let answer = get(&address, path);
        assert_eq!(answer.status, status, "{path}");
        let error = &answer.json()["error"];
        assert!(error["message"].as_str().is_some_and(|it| !it.is_empty()) && error["help"].is_string(), "{path}");
    }
    let retried = control(&format!("{{\"jobs\":[{job}],\"action\":\"retry\",\"frames\":[2,7]}}"));
    assert_eq!((&retried["done"][0], &retried["refused"][0]["code"]), (&().into(), &"invalid".into()));
    assert!(retried["refused"][0]["message"].as_str().is_some_and(|it| it.contains("frame 7")), "{retried}");
    for body in [
        "",
        "{}",
        "{\"jobs\":[1],\"action\":\"explode\"}",
        "{\"jobs\":[1],\"action\":\"priority\"}",
        "{\"jobs\":[1],\"action\":\"pause\",\"frames\":[1]}",
        "{\"jobs\":[1],\"action\":\"retry\",\"frames\":[-1]}",
    ] {
        assert_eq!(send_request(&address, "POST /api/v1/jobs/control", &CHANGE, body).status, 400, "{body}");
    }
}

#[test]
fn every_answer_has_headers_against_cross_site_attacks() {
    let dir = TestFolder::new();
    let (_coordinator, url) = start_coordinator(&dir, 0);
    for line in ["GET /", "GET /jobs/7", "GET /api/v1/me", "GET /api/v1/nothing", "POST /login", "PUT /", "GET /no.js"]
    {
        let answer = send_request(&address(&url), line, &[], "");
        let policy = answer.header("content-security-policy");
        assert!(policy.contains("default-src 'none'") && policy.contains("frame-ancestors 'none'"), "{line}");
        assert!(!policy.contains("unsafe"), "{line}: no script within the page");
        assert_eq!(answer.header("x-content-type-options"), "nosniff", "{line}");
    }
}

#[test]
fn a_page_goes_on_when_the_coordinator_was_restarted() {
    let dir = TestFolder::new();
    let (mut first, url) = start_coordinator(&dir, 0);
    let address = address(&url);
    let port = address.rsplit(':').next().and_then(|port| port.parse().ok()).expect("a port");
    let mut page = EventListener::connect(&address, None);
    let (kind, id, data) = page.next().expect("an event");
    assert_eq!((kind.as_str(), data["jobs"].as_array().map(Vec::len)), ("snapshot", Some(0)));
    submit(&dir, &url, "--frames 1 --spp 1");
    let (kind, second, data) = page.next().expect("an event");
    assert_eq!((kind.as_str(), &data["jobs"][0]["job"]), ("delta", &1.into()));
    // After a reconnect, the page gets the missed events as one delta, and nothing if it is up to date.
    let (kind, now, data) = EventListener::connect(&address, Some(&id)).next().expect("an event");
    assert_eq!((kind.as_str(), &now, &data["jobs"][0]["job"]), ("delta", &second, &1.into()));
    first.kill();
    assert!(page.next().is_none(), "it ends with the coordinator");
    let (_coordinator, url) = start_coordinator(&dir, port);
    submit(&dir, &url, "--frames 1 --spp 1");
    let (kind, third, data) = EventListener::connect(&address, Some(&second)).next().expect("an event");
    assert_eq!((kind.as_str(), data["jobs"].as_array().map(Vec::len)), ("snapshot", Some(2)));
    assert_ne!(third.split('-').next(), second.split('-').next(), "another start");
}

#[test]
fn an_open_feed_ends_when_its_token_is_taken_back() {
    let dir = TestFolder::new();
    dir.run("ca init").exits(0);
    dir.run("ca token user eve --role viewer").exits(0);
    let line = "coordinator --listen 127.0.0.1:0 --store memory --artifacts memory --token-file femc-ca/tokens";
    let mut coordinator = dir.start(line);
    let url = coordinator.first_line().split_whitespace().last().expect("the address").to_owned();
    let address = address(&url);
    let token = std::fs::read_to_string(dir.path("eve.token")).expect("a token");
    let token = token.lines().next().expect("a line");
    let mut stream = TcpStream::connect(&address).expect("a connection");
    stream.set_read_timeout(Some(STEP_TIMEOUT)).expect("a timeout");
    write!(stream, "GET /api/v1/feed HTTP/1.1\r\nHost: farm\r\nCookie: femc={token}\r\n\r\n").expect("it listens");
    let mut page = EventListener(BufReader::new(stream));
    assert_eq!(page.next().expect("an event").0, "snapshot");
    let (_, port) = address.rsplit_once(':').expect("a port");
    let cookie = format!("Cookie: femc-{port}={token}");
    let me = send_request(&address, "GET /api/v1/me", &[&cookie], "").json();
    assert_eq!((&me["name"], &me["role"]), (&"eve".into(), &"viewer".into()));
    let begun = Instant::now();
    dir.run("ca revoke eve").exits(0);
    assert!(page.next().is_none());
    assert!(begun.elapsed() < Duration::from_secs(60));
    assert_eq!(send_request(&address, "GET /api/v1/me", &[&cookie], "").status, 401);
    assert_eq!(send_request(&address, "GET /", &[], "").header("location"), "", "the page itself is for everybody");
}

#[test]
fn several_jobs_are_controlled_at_once_despite_a_bad_one() {
    let dir = TestFolder::new();
    let (_coordinator, url) = start_coordinator(&dir, 0);
    for owner in ["ann", "ann", "bob", "ann"] {
        submit(&dir, &url, &format!("--frames 1 --spp 1 --owner {owner}"));
    }
    let run = |line: &str| dir.run(&format!("{line} --server {url}"));
    let states = || -> Vec<String> {
        let jobs = run("jobs --json").exits(0).json();
        let state = |job: &serde_json::Value| job["state"].as_str().expect("a state").to_owned();
        jobs.as_array().expect("jobs").iter().map(state).collect()
    };
    assert!(run("cancel 1 99 3").exits(2).stderr().contains("99"));
    assert_eq!(states(), ["cancelled", "queued", "cancelled", "queued"]);
    run("pause --owner ann").exits(0);
    assert_eq!(states(), ["cancelled", "paused", "cancelled", "paused"], "what has ended is left alone");
    let of_bob = run("jobs --owner bob --json").exits(0).json();
    assert_eq!((of_bob.as_array().map(Vec::len), &of_bob[0]["job"]), (Some(1), &3.into()));
    assert_eq!(run("jobs --name f*g --state paused --json").exits(0).json().as_array().map(Vec::len), Some(2));
    assert!(run("cancel --name nothing").exits(2).stderr().contains("no job"));
    run("cancel").exits(2);
    run("cancel 1 --owner ann").exits(2);
    run("jobs --state odd").exits(2);
}

#[test]
fn worker_history_outlives_a_coordinator_restart() {
    let dir = TestFolder::new();
    let (mut coordinator, url) = start_coordinator(&dir, 0);
    let address = address(&url);
    let start = |name: &str| dir.start(&format!("worker --join {url} --name {name} --threads 1 --tags hall,{name}"));
    let (mut first, mut second) = (start("w1"), start("w2"));
    let now = || SystemTime::now().duration_since(UNIX_EPOCH).expect("a date").as_secs_f64();
    let names = |list: &str| -> Vec<String> {
        let workers = get(&address, "workers").json()[list].clone();
        let mut names: Vec<String> =
            workers.as_array().expect("a list").iter().map(|it| it["name"].to_string().replace('"', "")).collect();
        names.sort();
        names
    };
    coordinator.wait_until("both are there", || names("workers") == ["w1", "w2"]);
    assert_eq!(names("offline"), [""; 0]);
    let submit = format!("submit fog.mgf --frames 1 --spp 1 --method pt --tags w2 --server {url}");
    let job = dir.run(&submit).exits(0).stdout().lines().last().expect("a job").to_owned();
    dir.run(&format!("watch {job} --quiet --server {url}")).exits(0);
    let second_worker = || {
        let workers = get(&address, "workers").json()["workers"].clone();
        let second = workers.as_array().expect("a list").iter().find(|it| it["name"] == "w2").expect("w2").clone();
        (second["worker"].as_u64().expect("a number"), second["completed"].as_u64().expect("a count"))
    };
    let before = second_worker();
    assert!(before.1 > 0, "the second worker alone may do the job: {before:?}");
    first.kill();
    coordinator.wait_until("the first is missed", || names("offline") == ["w1"]);
    // The coordinator is killed, so it writes nothing at its end. The second worker stops while no coordinator runs.
    let port = url.rsplit_once(':').expect("a port").1.to_owned();
    coordinator.kill();
    second.kill();
    let line = format!("coordinator --listen 127.0.0.1:{port} --store sqlite:farm.db --artifacts artifacts");
    let mut again = dir.start(&line);
    again.address();
    assert_eq!(names("offline"), ["w1", "w2"]);
    let offline = get(&address, "workers").json()["offline"].clone();
    for worker in offline.as_array().expect("a list") {
        let last_contact = worker["last_contact"].as_f64().expect("a date");
        assert!((now() - STEP_TIMEOUT.as_secs_f64()..=now()).contains(&last_contact), "{worker}: now it is {}", now());
        assert_eq!((&worker["intake"], &worker["tags"][0]), (&"offline".into(), &"hall".into()));
    }
    let table = dir.run(&format!("workers --server {url}")).exits(0).stdout();
    assert_eq!(table.lines().filter(|line| line.ends_with("offline")).count(), 2, "{table}");
    let json = |flags: &str| dir.run(&format!("workers --json {flags} --server {url}")).exits(0).json();
    assert_eq!((json(""), json("--offline")), (serde_json::json!([]), offline));
    let mut listener = EventListener::connect(&address, None);
    let (kind, _, snapshot) = listener.next().expect("an event");
    assert_eq!((kind.as_str(), snapshot["offline"].as_array().map(Vec::len)), ("snapshot", Some(2)));
    let _back = start("w2");
    again.wait_until("the second is back", || names("workers") == ["w2"] && names("offline") == ["w1"]);
    assert_eq!(second_worker(), before, "its number, and the tasks that it has done");
}

#[test]
fn maps_of_a_frame_equal_its_light_statistics_per_pixel() {
    let dir = TestFolder::new();
    let (_coordinator, url) = start_coordinator(&dir, 0);
    let address = address(&url);
    let (plain, job) = (submit(&dir, &url, "--frames 1 --spp 4"), submit(&dir, &url, "--frames 1 --spp 4 --stats"));
    assert_eq!(get(&address, &format!("jobs/{job}/frames/1/maps")).status, 204, "nothing yet");
    let _worker = dir.start(&format!("worker --join {url} --threads 1"));
    for job in [&plain, &job] {
        dir.run(&format!("watch {job} --server {url}")).exits(0);
    }
    assert_eq!(get(&address, &format!("jobs/{plain}/frames/1/maps")).status, 204, "it has no statistics");
    let maps = get(&address, &format!("jobs/{job}/frames/1/maps"));
    assert_eq!((maps.status, maps.header("content-type")), (200, "application/vnd.femc.pixels"));
    let names = ["depth", "throughput", "deviation"];
    let head = 20 + names.iter().map(|name| 4 + name.len()).sum::<usize>();
    assert_eq!(maps.body.len(), head + 3 * 2 * 32 * 32);
    let planes = &maps.body[head..];
    dir.run(&format!("fetch {job} -o out --server {url}")).exits(0);
    let file = names_in(&dir, "out").into_iter().find(|name| name.ends_with(".paths")).expect("statistics");
    let pixels = dir.run(&format!("paths out/{file} --table pixels --json")).exits(0).json();
    let pixels = pixels.as_array().expect("pixels");
    assert_eq!(pixels.len(), 32 * 32);
    for pixel in pixels {
        let number = |name: &str| pixel[name].as_f64().expect("a number");
        let at = (number("pixel_y") * 32.0 + number("pixel_x")) as usize;
        for (plane, name) in ["depth", "throughput"].into_iter().enumerate() {
            let half = &planes[2 * (plane * 32 * 32 + at)..][..2];
            let (sent, known) = (f64::from(half_float([half[0], half[1]])), number(name));
            assert!((sent - known).abs() <= 1e-3 * known.abs() + 1e-4, "{name} of {pixel}: {sent}");
        }
    }
}

fn names_in(dir: &TestFolder, folder: &str) -> Vec<String> {
    crate::common::file_names(&dir.path(folder))
}
