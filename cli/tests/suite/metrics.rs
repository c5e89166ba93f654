//! Tests of metrics: the values agree with the work that was done, and dashboards and alerts only use existing names.

use crate::common::http::{free_port, get, metrics, send_request};
use crate::common::{TestFolder, TestProcess, status, submit};
use femc_metrics::testing::Samples;
use std::collections::BTreeSet;

fn start_coordinator(dir: &TestFolder, port: u16) -> (TestProcess, String) {
    let line = "coordinator --listen 127.0.0.1:0 --store sqlite:farm.db --artifacts artifacts";
    let mut running = dir.start(&format!("{line} --metrics {port}"));
    let url = running.address();
    (running, url)
}

#[test]
fn the_numbers_are_those_of_the_job() {
    let dir = TestFolder::new();
    let [port, own] = [free_port(), free_port()];
    let (mut farm, url) = start_coordinator(&dir, port);
    farm.wait_until("an answer", || get(port, "/readyz").is_some_and(|(status, _)| status == 200));
    let job = submit(&dir, &url, "--spp 4 --frames 1..2");
    let before = metrics(port);
    assert_eq!(before.value("femc_tasks_ready", &[("stage", "render")]), Some(8.0), "two frames of four tiles");
    assert_eq!(before.value("femc_samples_left", &[]), Some(2.0 * 32.0 * 32.0 * 4.0));
    assert_eq!(before.value("femc_jobs", &[("state", "queued")]), Some(1.0));
    assert_eq!(before.value("femc_leader", &[]), Some(1.0));

    let mut worker = dir.start(&format!("worker --join {url} --threads 2 --metrics {own}"));
    farm.wait_until("the job's end", || status(&dir, &url, &job)["state"] == "done");
    let attempts = dir.run(&format!("stats {job} --by attempt --json --server {url}")).exits(0).json();
    let attempts = attempts.as_array().expect("a list").len() as f64;
    // The last acknowledgement may still be on its way.
    worker.wait_until("all acknowledged", || metrics(own).sum("femc_worker_tasks_done_total", &[]) == attempts);

    for (path, code) in [("/api/v1/jobs", 200), ("/api/v1/jobs/99", 404), ("/api/v1/jobs/98", 404)] {
        let answer = send_request(url.trim_start_matches("http://"), &format!("GET {path}"), &[], "");
        assert_eq!(answer.status, code, "{path}");
    }
    let farm_now = metrics(port);
    let value = |name: &str, labels: &[(&str, &str)]| farm_now.value(name, labels).expect(name);
    assert_eq!(value("femc_jobs", &[("state", "done")]), 1.0);
    assert_eq!(value("femc_tasks_done_total", &[("stage", "render")]), 8.0);
    assert_eq!(value("femc_tasks_done_total", &[("stage", "image")]), 2.0);
    assert_eq!((attempts, value("femc_attempts_total", &[("ending", "done")])), (10.0, 10.0));
    assert_eq!(farm_now.sum("femc_tasks_ready", &[]) + farm_now.sum("femc_tasks_leased", &[]), 0.0);
    assert_eq!(value("femc_samples_left", &[]), 0.0);
    assert_eq!(value("femc_workers", &[("state", "idle")]), 1.0);
    assert_eq!(value("femc_threads", &[]), 2.0);
    let submitted = [("method", "/femc.v1.Jobs/Submit"), ("code", "OK")];
    assert_eq!(value("femc_rpc_calls_total", &submitted), 1.0);
    assert_eq!(value("femc_rpc_seconds_count", &submitted[..1]), 1.0);
    let missed = [("operation", "Jobs/Status"), ("status", "404")];
    assert_eq!(
        (value("femc_http_requests_total", &missed), value("femc_http_seconds_count", &missed[..1])),
        (2.0, 2.0)
    );
    let listed = [("operation", "Jobs/List"), ("status", "200")];
    assert_eq!(value("femc_http_requests_total", &listed), 1.0);
    assert!(value("femc_log_append_seconds_count", &[]) > 0.0 && value("femc_log_file_bytes", &[]) > 4096.0);

    let worker_now = metrics(own);
    let value = |name: &str, labels: &[(&str, &str)]| worker_now.value(name, labels).expect(name);
    assert_eq!(value("femc_worker_samples_total", &[]), 2.0 * 32.0 * 32.0 * 4.0);
    assert_eq!(value("femc_worker_tasks_done_total", &[("stage", "render")]), 8.0);
    assert_eq!(value("femc_worker_cache_lookups_total", &[("cache", "frames"), ("outcome", "miss")]), 2.0);
    assert_eq!((value("femc_worker_outbox_results", &[]), value("femc_worker_connected", &[])), (0.0, 1.0));
    let sent = value("femc_worker_sent_bytes_total", &[]);
    let received = farm_now.value("femc_store_received_bytes_total", &[]).expect("bytes");
    assert!(sent > 0.0 && received >= sent, "{received} hold {sent}, and the scene");
}

#[test]
fn a_worker_without_a_coordinator_is_well_and_not_ready() {
    let dir = TestFolder::new();
    let [port, own] = [free_port(), free_port()];
    let (mut farm, url) = start_coordinator(&dir, port);
    let mut worker = dir.start(&format!("worker --join {url} --threads 1 --metrics {own}"));
    let code = |path: &str| get(own, path).map(|(status, _)| status);
    worker.wait_until("a session", || code("/readyz") == Some(200));
    farm.kill();
    worker.wait_until("its loss", || code("/readyz") == Some(503));
    assert_eq!(code("/healthz"), Some(200));
    assert_eq!(metrics(own).value("femc_worker_connected", &[]), Some(0.0));
    assert_eq!(code("/"), Some(404));
}

/// Returns the names of metrics in a text.
fn file_names(text: &str) -> BTreeSet<&str> {
    let words = text.split(|c: char| !(c.is_ascii_alphanumeric() || c == '_'));
    words.filter(|word| word.starts_with("femc_") || word.starts_with("process_")).collect()
}

#[test]
fn alerts_dashboard_and_manual_name_existing_metrics() {
    let dir = TestFolder::new();
    let [port, own] = [free_port(), free_port()];
    let (mut farm, url) = start_coordinator(&dir, port);
    let mut worker = dir.start(&format!("worker --join {url} --threads 1 --metrics {own}"));
    worker.wait_until("a session", || get(own, "/readyz").is_some_and(|(status, _)| status == 200));
    let pages: [Samples; 2] = [metrics(port), metrics(own)];
    let exported: BTreeSet<&str> = pages.iter().flat_map(Samples::names).collect();
    let kinds: BTreeSet<&str> = pages.iter().flat_map(|page| page.kinds.keys()).map(String::as_str).collect();
    let root = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("..");
    for file in [
        "deploy/prometheus/alerts.yml",
        "deploy/grafana/femc.json",
        "deploy/kubernetes/scaling.yaml",
        "deploy/kubernetes/prometheus-adapter.yaml",
    ] {
        let text = std::fs::read_to_string(root.join(file)).expect(file);
        let strangers: Vec<&str> = file_names(&text).difference(&exported).copied().collect();
        assert!(strangers.is_empty() && !file_names(&text).is_empty(), "{file} names {strangers:?}");
    }
    let text = std::fs::read_to_string(root.join("docs/operations.md")).expect("the page of operations");
    let documented = file_names(&text);
    let missing: Vec<&&str> = kinds.iter().filter(|name| !documented.contains(**name)).collect();
    assert!(missing.is_empty(), "docs/operations.md does not tell of {missing:?}");
    let strangers: Vec<&&str> = documented.iter().filter(|name| !kinds.contains(**name)).collect();
    assert!(strangers.is_empty(), "docs/operations.md tells of {strangers:?}");
    assert!(farm.is_running());
}
