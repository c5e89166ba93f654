//! Tests of the geometry of frames from a farm: the surfaces beside the recorded light.
#![cfg(unix)]

use crate::common::http::{Answer, send_request};
use crate::common::{TestFolder, TestProcess, start_coordinator, status, submit};

const SETTINGS: &str = "--frames 1..3 --size 48x32 --spp 4 --stats";

fn get(url: &str, path: &str, head: &[&str]) -> Answer {
    send_request(url.trim_start_matches("http://"), &format!("GET /api/v1/{path}"), head, "")
}

fn start_worker(dir: &TestFolder, url: &str) -> TestProcess {
    dir.start(&format!("worker --join {url} --threads 1"))
}

/// Returns the geometry of the first three frames of a finished job.
fn geometry(url: &str, job: &str) -> [Vec<u8>; 3] {
    [1, 2, 3].map(|frame| {
        let answer = get(url, &format!("jobs/{job}/geometry?frame={frame}"), &[]);
        assert_eq!((answer.status, answer.header("content-type")), (200, "model/gltf-binary"));
        let name = format!("attachment; filename=\"fog.000{frame}.glb\"");
        assert_eq!(answer.header("content-disposition"), name);
        let file = get(url, &format!("jobs/{job}/frames/{frame}/geometry.glb"), &[]);
        assert!(file.body == answer.body, "frame {frame}");
        answer.body
    })
}

/// Returns the document of binary glTF.
fn document(glb: &[u8]) -> serde_json::Value {
    assert_eq!(&glb[..4], b"glTF");
    let length = u32::from_le_bytes(glb[12..16].try_into().expect("four bytes")) as usize;
    serde_json::from_slice(&glb[20..20 + length]).expect("JSON")
}

#[test]
fn geometry_has_equal_bytes_for_any_workers_despite_a_kill() {
    let alone = TestFolder::new();
    let (_coordinator, url) = start_coordinator(&alone, 0);
    let _worker = start_worker(&alone, &url);
    let job = submit(&alone, &url, SETTINGS);
    alone.run(&format!("watch {job} --server {url}")).exits(0);
    let first = geometry(&url, &job);
    let document = document(&first[0]);
    assert_eq!(document["asset"]["version"], "2.0");
    let extras = &document["scenes"][0]["extras"];
    assert!(extras["triangles"].as_u64().is_some_and(|triangles| triangles > 0), "{extras}");

    let farm = TestFolder::new();
    let (_other_coordinator, url) = start_coordinator(&farm, 0);
    let mut workers: Vec<TestProcess> = (0..3).map(|_| start_worker(&farm, &url)).collect();
    let job = submit(&farm, &url, SETTINGS);
    let mut doomed = workers.pop().expect("three");
    doomed.wait_until("a frame is done", || status(&farm, &url, &job)["frames_done"].as_u64() > Some(0));
    doomed.kill();
    farm.run(&format!("watch {job} --server {url}")).exits(0);
    assert!(geometry(&url, &job) == first, "equal bytes");

    let tag = get(&url, &format!("jobs/{job}/geometry"), &[]).header("etag").to_owned();
    let again = get(&url, &format!("jobs/{job}/geometry?frame=1"), &[&format!("If-None-Match: {tag}")]);
    assert_eq!((again.status, again.body.len()), (304, 0));
}

/// Returns the finite-element solutions of the first two frames of a finished job.
fn solutions(url: &str, job: &str) -> [Vec<u8>; 2] {
    [1, 2].map(|frame| {
        let answer = get(url, &format!("jobs/{job}/solution?frame={frame}"), &[]);
        assert_eq!((answer.status, answer.header("content-type")), (200, "model/gltf-binary"));
        answer.body
    })
}

#[test]
fn solution_has_equal_bytes_for_any_workers_and_methods() {
    let settings = |method: &str| format!("--frames 1..2 --size 48x32 --spp 4 --stats --method {method}");
    let alone = TestFolder::new();
    let (_coordinator, url) = start_coordinator(&alone, 0);
    let _worker = start_worker(&alone, &url);
    let [job, other] = ["fem", "pt"].map(|method| submit(&alone, &url, &settings(method)));
    for job in [&job, &other] {
        alone.run(&format!("watch {job} --server {url}")).exits(0);
    }
    let first = solutions(&url, &job);
    let document = document(&first[0]);
    let extras = &document["scenes"][0]["extras"];
    assert!(extras["triangles"].as_u64().is_some_and(|triangles| triangles > 0), "{extras}");
    assert_eq!(extras["triangles"], extras["full_triangles"]);
    let refused = get(&url, &format!("jobs/{other}/solution"), &[]);
    let message = refused.json()["error"]["message"].to_string();
    assert!(refused.status == 404 && message.contains("its method has no first pass"), "{message}");

    let farm = TestFolder::new();
    let (_other_coordinator, url) = start_coordinator(&farm, 0);
    let _workers: Vec<TestProcess> = (0..3).map(|_| start_worker(&farm, &url)).collect();
    let job = submit(&farm, &url, &settings("fem"));
    farm.run(&format!("watch {job} --server {url}")).exits(0);
    assert!(solutions(&url, &job) == first, "equal bytes");
}

#[test]
fn job_without_statistics_has_no_geometry_and_says_so() {
    let dir = TestFolder::new();
    let (_coordinator, url) = start_coordinator(&dir, 0);
    let (plain, recorded) =
        (submit(&dir, &url, "--frames 1 --spp 1"), submit(&dir, &url, "--frames 1 --spp 1 --stats"));
    let kinds = |job: &str| -> Vec<String> {
        let stages = get(&url, &format!("jobs/{job}"), &[]).json()["spec"]["stages"].clone();
        let stages = stages.as_array().expect("stages").iter();
        stages.map(|stage| stage["kind"].as_str().expect("a kind").to_owned()).collect()
    };
    assert!(!kinds(&plain).contains(&"geometry".to_owned()), "{:?}", kinds(&plain));
    assert!(kinds(&recorded).contains(&"geometry".to_owned()), "{:?}", kinds(&recorded));
    let refused = get(&url, &format!("jobs/{plain}/geometry"), &[]);
    assert_eq!((refused.status, refused.code()), (404, "not_found".to_owned()));
    let message = refused.json()["error"]["message"].to_string();
    assert!(message.contains("submitted without geometry"), "{message}");
    // No worker has begun.
    assert_eq!(get(&url, &format!("jobs/{recorded}/geometry"), &[]).status, 204);
    assert_eq!(get(&url, "files/0/geometry", &[]).status, 404);
}
