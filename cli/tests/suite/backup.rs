//! Tests of `femc backup`: a copy of a running farm is a working farm.

use crate::common::{Place, coordinator, coordinator_with, names, pixels, share, status, submit};

const JOB: &str = "--spp 128 --frames 1..4";

#[test]
fn restored_farm_resumes_from_backup_with_identical_frames() {
    let place = Place::new();
    let (mut farm, url) = coordinator(&place, 0);
    let mut worker = place.start(&format!("worker --join {url} --threads 1 --outbox memory"));
    let job = submit(&place, &url, JOB);
    farm.wait_until("some samples", || share(&place, &url, &job) > 0.2);
    place.run(&format!("backup copy --server {url}")).exits(0);
    let at_copy = share(&place, &url, &job);
    let later = submit(&place, &url, "--spp 1 --frames 1");
    assert!(status(&place, &url, &job)["state"] != "done", "the copy was made under load");
    assert!(worker.kill() && farm.kill(), "they were at it");
    std::fs::remove_dir_all(place.path("artifacts")).expect("all is lost");
    std::fs::remove_file(place.path("farm.db")).expect("all is lost");

    let mut again =
        place.start("coordinator --listen 127.0.0.1:0 --store sqlite:copy/farm.db --artifacts copy/artifacts");
    let url = again.address();
    let kept = share(&place, &url, &job);
    assert!(kept > 0.0 && kept <= at_copy, "what was done at the time of the copy is done: {kept} of {at_copy}");
    place.run(&format!("status {later} --server {url}")).exits(2);
    let _worker = place.start(&format!("worker --join {url} --threads 1 --outbox memory"));
    place.run(&format!("watch {job} --server {url}")).exits(0);
    place.run(&format!("fetch {job} -o out --server {url}")).exits(0);
    place.run(&format!("render fog.mgf -o alone {JOB}")).exits(0);
    let frames = names(&place.path("alone"));
    assert_eq!((frames.len(), &names(&place.path("out"))), (4, &frames));
    for frame in frames {
        assert_eq!(
            pixels(&place.path("out").join(&frame)),
            pixels(&place.path("alone").join(&frame)),
            "{frame} of the farm that went on"
        );
    }
}

#[test]
fn a_second_copy_takes_what_is_new_and_names_all() {
    let place = Place::new();
    let (farm, url) = coordinator(&place, 0);
    let _worker = place.start(&format!("worker --join {url} --threads 1"));
    let job = submit(&place, &url, "--spp 1 --frames 1");
    place.run(&format!("watch {job} --server {url}")).exits(0);
    place.run(&format!("backup copy --server {url}")).exits(0);
    let list = place.read("copy/artifacts.txt");
    assert!(!list.is_empty() && list.lines().all(|name| place.path("copy/artifacts").join(name).is_file()), "{list}");
    let ran = place.run(&format!("backup copy --server {url}")).exits(0);
    assert!(ran.stdout().contains("; 0 were new here"), "{}", ran.stdout());
    let job = submit(&place, &url, "--spp 2 --frames 1");
    place.run(&format!("watch {job} --server {url}")).exits(0);
    place.run(&format!("backup other --log-only --server {url}")).exits(0);
    assert_eq!(names(&place.path("other")), ["artifacts.txt", "farm.db"]);
    assert!(place.read("other/artifacts.txt").len() > list.len());
    assert_eq!(names(&place.path(".")).into_iter().filter(|name| name.contains(".copy")).count(), 0);
    drop(farm);
}

#[test]
fn a_log_in_memory_has_no_copy_and_the_farm_goes_on() {
    let place = Place::new();
    let mut farm = place.start("coordinator --listen 127.0.0.1:0 --store memory --artifacts memory");
    let url = farm.address();
    let ran = place.run(&format!("backup copy --server {url}")).exits(2);
    assert!(ran.stderr().contains("it is in memory"), "{}", ran.stderr());
    place.run(&format!("jobs --server {url}")).exits(0);
    let (_other, url) = coordinator_with(&place, "artifacts");
    place.write("file", "");
    place.run(&format!("backup file/copy --server {url}")).exits(1);
}

#[test]
fn log_without_acknowledged_records_is_refused_unless_forced() {
    let place = Place::new();
    let (mut farm, url) = coordinator(&place, 0);
    for frame in 1..=8 {
        submit(&place, &url, &format!("--spp 1 --frames {frame}"));
    }
    assert!(farm.kill(), "it was there");
    let mut ahead = std::fs::read(place.path("farm.db-wal")).expect("what was written ahead");
    let middle = ahead.len() / 2;
    ahead[middle] ^= 4;
    std::fs::write(place.path("farm.db-wal"), ahead).expect("one bit is another");

    let line = "coordinator --listen 127.0.0.1:0 --store sqlite:farm.db --artifacts artifacts";
    for _ in 0..2 {
        let ran = place.run(line).exits(1);
        assert!(
            ran.stderr().contains("records are missing") && ran.stderr().contains("--accept-loss"),
            "{}",
            ran.stderr()
        );
    }
    let mut farm = place.start(&format!("{line} --accept-loss"));
    let url = farm.address();
    let jobs = place.run(&format!("jobs --json --server {url}")).exits(0).json();
    assert!((1..8).contains(&jobs.as_array().expect("a list").len()), "{jobs}");
    submit(&place, &url, "--spp 1 --frames 1");
    assert!(place.read("audit.jsonl").contains("accept-loss"));
    assert!(farm.kill());
    let mut farm = place.start(line);
    farm.address();
}
