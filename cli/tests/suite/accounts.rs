//! Tests of comments, labels, deleted jobs, usage, and notifications of a job's end.

use crate::common::{TestFolder, TestProcess, start_coordinator, status};
use std::io::{Read, Write};
use std::net::TcpListener;
use std::sync::mpsc::{Receiver, channel};
use std::time::Duration;

/// A received message: its head in lower case, and its body.
struct ReceivedMessage {
    head: String,
    body: serde_json::Value,
}

impl ReceivedMessage {
    fn header(&self, name: &str) -> &str {
        let of = |line: &'_ str| line.strip_prefix(name).and_then(|rest| rest.strip_prefix(": ")).map(str::len);
        let line = self.head.lines().find(|line| of(line).is_some()).unwrap_or_else(|| panic!("{name}: {}", self.head));
        &line[name.len() + 2..]
    }
}

/// Starts a server for messages on a free port. It answers with these statuses, and then always with 200.
fn start_receiver(statuses: &'static [&str]) -> (u16, Receiver<ReceivedMessage>) {
    let listener = TcpListener::bind("127.0.0.1:0").expect("a port");
    let port = listener.local_addr().expect("its address").port();
    let (send, received) = channel();
    std::thread::spawn(move || {
        for (number, stream) in listener.incoming().enumerate() {
            let mut stream = stream.expect("a connection");
            let (mut bytes, mut piece) = (Vec::new(), [0; 4096]);
            let (head, body) = loop {
                let read = stream.read(&mut piece).expect("a request");
                bytes.extend_from_slice(&piece[..read]);
                let text = String::from_utf8_lossy(&bytes).into_owned();
                let Some((head, body)) = text.split_once("\r\n\r\n") else { continue };
                let head = head.to_lowercase();
                let length = head.lines().find_map(|line| line.strip_prefix("content-length: "));
                if length.and_then(|length| length.parse().ok()) == Some(body.len()) {
                    break (head, body.to_owned());
                }
            };
            let status = statuses.get(number).unwrap_or(&"200 OK");
            write!(stream, "HTTP/1.1 {status}\r\nContent-Length: 0\r\nConnection: close\r\n\r\n").expect("an answer");
            let body = serde_json::from_str(&body).expect("JSON");
            if send.send(ReceivedMessage { head, body }).is_err() {
                return;
            }
        }
    });
    (port, received)
}

fn next_message(received: &Receiver<ReceivedMessage>) -> ReceivedMessage {
    received.recv_timeout(Duration::from_secs(60)).expect("a message")
}

fn start(dir: &TestFolder, options: &str) -> (TestProcess, String) {
    let line = format!("coordinator --listen 127.0.0.1:0 --store sqlite:farm.db --artifacts artifacts {options}");
    let mut coordinator = dir.start(&line);
    let url = coordinator.address();
    (coordinator, url)
}

fn submit(dir: &TestFolder, url: &str, more: &[&str]) -> String {
    let mut command = dir.command(&format!("submit fog.mgf --size 16x16 --spp 1 --server {url}"));
    let output = command.args(more).output().expect("femc runs");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    String::from_utf8_lossy(&output.stdout).lines().last().expect("a number").to_owned()
}

#[test]
fn job_end_webhooks_are_signed_retried_and_restricted_by_url() {
    let dir = TestFolder::new();
    dir.write("key", "whsec_MfKQ9r8GKYqrTwjUPD8ILPZIo2LaLaSw\n");
    let (port, received) = start_receiver(&["503 Service Unavailable", "302 Found"]);
    let (mut farm, url) = start(&dir, &format!("--notify-allow http://127.0.0.1:{port}/hooks/ --notify-key key"));
    for refused in [format!("http://127.0.0.1:{port}/admin"), "http://169.254.169.254/".to_owned()] {
        let ran = dir.run(&format!("submit fog.mgf --notify {refused} --server {url}")).exits(2);
        assert!(ran.stderr().contains("does not notify") && ran.stderr().contains(&refused), "{}", ran.stderr());
    }
    let notify = format!("http://127.0.0.1:{port}/hooks/femc");
    let job = submit(&dir, &url, &["--frames", "1", "--notify", &notify, "--label", "shot=12", "--comment", "a draft"]);
    dir.run(&format!("cancel {job} --server {url}")).exits(0);
    let all: Vec<ReceivedMessage> = (0..3).map(|_| next_message(&received)).collect();
    for one in &all {
        assert!(one.head.starts_with("post /hooks/femc http/1.1"), "{}", one.head);
        assert_eq!(one.header("webhook-id"), all[0].header("webhook-id"), "a repetition has the same name");
        assert!(one.header("webhook-signature").starts_with("v1,"));
        assert_eq!(one.body["type"], "job.cancelled");
        assert_eq!(one.body["data"]["job"].to_string(), job);
        assert_eq!(one.body["data"]["labels"]["shot"], "12");
        assert_eq!(one.body["data"]["comment"], "a draft");
    }
    // The coordinator logs the first notification as sent before it sends the second one.
    let second = submit(&dir, &url, &["--frames", "2", "--notify", &notify]);
    dir.run(&format!("cancel {second} --server {url}")).exits(0);
    assert_eq!(next_message(&received).body["data"]["job"].to_string(), second);
    farm.signal("TERM");
    farm.end().exits(0);
    let (_farm, url) = start(&dir, &format!("--notify-allow http://127.0.0.1:{port}/hooks/ --notify-key key"));
    let other = submit(&dir, &url, &["--frames", "2", "--notify", &notify]);
    dir.run(&format!("cancel {other} --server {url}")).exits(0);
    // The second message may arrive twice: it was accepted just before the coordinator stopped.
    let job = loop {
        let job = next_message(&received).body["data"]["job"].to_string();
        if job != second {
            break job;
        }
    };
    assert_eq!(job, other);
}

#[test]
fn unsent_job_end_webhook_is_sent_after_coordinator_restart() {
    let dir = TestFolder::new();
    dir.write("key", "0123456789abcdef0123456789abcdef");
    let closed = TcpListener::bind("127.0.0.1:0").expect("a port");
    let port = closed.local_addr().expect("its address").port();
    drop(closed);
    let options = format!("--notify-allow http://127.0.0.1:{port}/ --notify-key key");
    let (mut farm, url) = start(&dir, &options);
    let job = submit(&dir, &url, &["--frames", "1", "--notify", &format!("http://127.0.0.1:{port}/a")]);
    dir.run(&format!("cancel {job} --server {url}")).exits(0);
    farm.kill();
    let listener = TcpListener::bind(("127.0.0.1", port)).expect("the port is free");
    let (_farm, _) = start(&dir, &options);
    let (mut stream, _) = listener.accept().expect("a message");
    let mut head = [0; 16];
    stream.read_exact(&mut head).expect("its head");
    assert_eq!(&head[..7], b"POST /a");
}

#[test]
fn a_command_runs_at_the_end_of_each_job_and_knows_it() {
    let dir = TestFolder::new();
    dir.write(
        "end.sh",
        "cat > \"ended-$FEMC_JOB.json\"; echo \"$FEMC_NAME $FEMC_STATE $FEMC_FRAMES_DONE/$FEMC_FRAMES\" >> ends\n",
    );
    let line = "coordinator --listen 127.0.0.1:0 --store sqlite:farm.db --artifacts artifacts --on-end";
    let mut farm = TestProcess::spawn(dir.command(line).arg("sh end.sh"));
    let url = farm.address();
    let done = submit(&dir, &url, &["--frames", "1,3", "--name", "draft"]);
    let worker = dir.start(&format!("worker --join {url} --threads 1"));
    dir.run(&format!("watch {done} --server {url}")).exits(0);
    farm.wait_until("the first end", || dir.read("ends").lines().count() == 1);
    assert_eq!(dir.read("ends"), "draft done 2/2\n");
    let message: serde_json::Value = serde_json::from_str(&dir.read(&format!("ended-{done}.json"))).expect("JSON");
    assert_eq!((&message["type"], &message["data"]["frames_done"]), (&"job.done".into(), &2.into()));
    drop(worker);
    let cancelled = submit(&dir, &url, &["--frames", "2"]);
    dir.run(&format!("cancel {cancelled} --server {url}")).exits(0);
    farm.wait_until("the second end", || dir.read("ends").lines().count() == 2);
    assert!(dir.read("ends").ends_with("fog cancelled 0/1\n"), "{}", dir.read("ends"));
}

#[test]
fn jobs_are_found_by_label_and_deleted_jobs_keep_their_usage() {
    let dir = TestFolder::new();
    let (mut farm, url) = start_coordinator(&dir, 0);
    let job = submit(&dir, &url, &["--frames", "1,5", "--label", "shot=12", "--comment", "before the change of lamps"]);
    let other = submit(&dir, &url, &["--frames", "1", "--label", "shot=13"]);
    let found = dir.run(&format!("jobs --label shot=12 --json --server {url}")).exits(0).json();
    assert_eq!(found.as_array().map(Vec::len), Some(1), "{found}");
    assert_eq!(
        (found[0]["job"].to_string(), &found[0]["comment"]),
        (job.clone(), &"before the change of lamps".into())
    );
    let told = dir.run(&format!("status {job} --server {url}")).exits(0).stdout();
    assert!(told.contains("before the change of lamps") && told.contains("shot=12"), "{told}");
    let early = dir.run(&format!("delete {job} --server {url}")).exits(2);
    assert!(early.stderr().contains("cancel it first"), "{}", early.stderr());
    let _worker = dir.start(&format!("worker --join {url} --threads 1"));
    dir.run(&format!("watch {job} --server {url}")).exits(0);
    dir.run(&format!("watch {other} --server {url}")).exits(0);
    dir.run(&format!("delete --label shot=12 --server {url}")).exits(0);
    dir.run(&format!("status {job} --server {url}")).exits(2);
    assert_eq!(status(&dir, &url, &other)["state"], "done");
    // Usage includes values that are not durable yet.
    let csv = dir.run(&format!("usage --csv --server {url}")).exits(0).stdout();
    let mut lines = csv.lines();
    assert_eq!(lines.next(), Some("month,owner,jobs,frames,tasks,samples,worker_seconds,processor_seconds"));
    let row: Vec<&str> = lines.next().expect("a row").split(',').collect();
    assert_eq!(row[2..4], ["2", "3"], "{csv}");
    // Three frames of 16 x 16 pixels at one sample.
    assert_eq!((row[5], lines.next()), ("768", None), "{csv}");
    let (worker, processor): (f64, f64) = (row[6].parse().expect("seconds"), row[7].parse().expect("seconds"));
    assert!(worker > 0.0 && processor > 0.0, "{csv}");
    farm.signal("TERM");
    farm.end().exits(0);
}

#[test]
fn the_jobs_of_a_sweep_are_named_and_labelled_by_what_varies() {
    let dir = TestFolder::new();
    dir.write(
        "j.toml",
        "scene = \"fog.mgf\"\nframes = \"1\"\nspp = 1\nsize = \"16x16\"\ncomment = \"which fog\"\n\
         [labels]\nshot = \"12\"\n[sweep]\n\"medium.fog.sigma_s\" = [0.05, 0.2]\n",
    );
    let (_farm, url) = start_coordinator(&dir, 0);
    dir.run(&format!("sweep j.toml --priority 70 --owner ann --label by=hand --server {url}")).exits(0);
    let jobs = dir.run(&format!("jobs --json --server {url}")).exits(0).json();
    for (job, value) in jobs.as_array().expect("jobs").iter().zip(["0.05", "0.2"]) {
        assert_eq!(job["name"], format!("fog-sigma_s={value}"));
        assert_eq!(
            (&job["priority"], &job["owner"], &job["comment"]),
            (&70.into(), &"ann".into(), &"which fog".into())
        );
        assert_eq!(job["labels"], serde_json::json!({"by": "hand", "medium.fog.sigma_s": value, "shot": "12"}));
    }
    assert_eq!(jobs.as_array().map(Vec::len), Some(2));
}
