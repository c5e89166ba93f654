//! Tests of `femc backup`: a copy of a running farm is a working farm.

use crate::common::{
    TestFolder, file_names, finished_share, pixels, start_coordinator, start_coordinator_with, status, submit,
};

const JOB: &str = "--spp 128 --frames 1..4";

#[test]
fn restored_farm_resumes_from_backup_with_identical_frames() {
    let dir = TestFolder::new();
    let (mut farm, url) = start_coordinator(&dir, 0);
    let mut worker = dir.start(&format!("worker --join {url} --threads 1 --outbox memory"));
    let job = submit(&dir, &url, JOB);
    farm.wait_until("some samples", || finished_share(&dir, &url, &job) > 0.2);
    dir.run(&format!("backup copy --server {url}")).exits(0);
    let at_copy = finished_share(&dir, &url, &job);
    let later = submit(&dir, &url, "--spp 1 --frames 1");
    assert!(status(&dir, &url, &job)["state"] != "done", "the copy was made under load");
    assert!(worker.kill() && farm.kill(), "they were at it");
    std::fs::remove_dir_all(dir.path("artifacts")).expect("all is lost");
    std::fs::remove_file(dir.path("farm.db")).expect("all is lost");

    let mut again =
        dir.start("coordinator --listen 127.0.0.1:0 --store sqlite:copy/farm.db --artifacts copy/artifacts");
    let url = again.address();
    let kept = finished_share(&dir, &url, &job);
    assert!(kept > 0.0 && kept <= at_copy, "what was done at the time of the copy is done: {kept} of {at_copy}");
    dir.run(&format!("status {later} --server {url}")).exits(2);
    let _worker = dir.start(&format!("worker --join {url} --threads 1 --outbox memory"));
    dir.run(&format!("watch {job} --server {url}")).exits(0);
    dir.run(&format!("fetch {job} -o out --server {url}")).exits(0);
    dir.run(&format!("render fog.mgf -o alone {JOB}")).exits(0);
    let frames = file_names(&dir.path("alone"));
    assert_eq!((frames.len(), &file_names(&dir.path("out"))), (4, &frames));
    for frame in frames {
        assert_eq!(
            pixels(&dir.path("out").join(&frame)),
            pixels(&dir.path("alone").join(&frame)),
            "{frame} of the farm that went on"
        );
    }
}

#[test]
fn a_second_copy_takes_what_is_new_and_names_all() {
    let dir = TestFolder::new();
    let (farm, url) = start_coordinator(&dir, 0);
    let _worker = dir.start(&format!("worker --join {url} --threads 1"));
    let job = submit(&dir, &url, "--spp 1 --frames 1");
    dir.run(&format!("watch {job} --server {url}")).exits(0);
    dir.run(&format!("backup copy --server {url}")).exits(0);
    let list = dir.read("copy/artifacts.txt");
    assert!(!list.is_empty() && list.lines().all(|name| dir.path("copy/artifacts").join(name).is_file()), "{list}");
    let ran = dir.run(&format!("backup copy --server {url}")).exits(0);
    assert!(ran.stdout().contains("; 0 were new here"), "{}", ran.stdout());
    let job = submit(&dir, &url, "--spp 2 --frames 1");
    dir.run(&format!("watch {job} --server {url}")).exits(0);
    dir.run(&format!("backup other --log-only --server {url}")).exits(0);
    assert_eq!(file_names(&dir.path("other")), ["artifacts.txt", "farm.db"]);
    assert!(dir.read("other/artifacts.txt").len() > list.len());
    assert_eq!(file_names(&dir.path(".")).into_iter().filter(|name| name.contains(".copy")).count(), 0);
    drop(farm);
}

#[test]
fn a_log_in_memory_has_no_copy_and_the_farm_goes_on() {
    let dir = TestFolder::new();
    let mut farm = dir.start("coordinator --listen 127.0.0.1:0 --store memory --artifacts memory");
    let url = farm.address();
    let ran = dir.run(&format!("backup copy --server {url}")).exits(2);
    assert!(ran.stderr().contains("it is in memory"), "{}", ran.stderr());
    dir.run(&format!("jobs --server {url}")).exits(0);
    let (_other, url) = start_coordinator_with(&dir, "artifacts");
    dir.write("file", "");
    dir.run(&format!("backup file/copy --server {url}")).exits(1);
}

#[test]
fn log_without_acknowledged_records_is_refused_unless_forced() {
    let dir = TestFolder::new();
    let (mut farm, url) = start_coordinator(&dir, 0);
    for frame in 1..=8 {
        submit(&dir, &url, &format!("--spp 1 --frames {frame}"));
    }
    assert!(farm.kill(), "it was there");
    let mut ahead = std::fs::read(dir.path("farm.db-wal")).expect("what was written ahead");
    let middle = ahead.len() / 2;
    ahead[middle] ^= 4;
    std::fs::write(dir.path("farm.db-wal"), ahead).expect("one bit is another");

    let line = "coordinator --listen 127.0.0.1:0 --store sqlite:farm.db --artifacts artifacts";
    for _ in 0..2 {
        let ran = dir.run(line).exits(1);
        assert!(
            ran.stderr().contains("records are missing") && ran.stderr().contains("--accept-loss"),
            "{}",
            ran.stderr()
        );
    }
    let mut farm = dir.start(&format!("{line} --accept-loss"));
    let url = farm.address();
    let jobs = dir.run(&format!("jobs --json --server {url}")).exits(0).json();
    assert!((1..8).contains(&jobs.as_array().expect("a list").len()), "{jobs}");
    submit(&dir, &url, "--spp 1 --frames 1");
    assert!(dir.read("audit.jsonl").contains("accept-loss"));
    assert!(farm.kill());
    let mut farm = dir.start(line);
    farm.address();
}
