//! Tests of `femc gc` on a farm of real processes.

use crate::common::{TestFolder, file_names, start_coordinator_with};
use std::fs::File;
use std::time::{Duration, SystemTime};

#[test]
fn garbage_goes_and_a_finished_job_can_still_be_fetched() {
    let dir = TestFolder::new();
    let (_farm, url) = start_coordinator_with(&dir, "artifacts");
    let _worker = dir.start(&format!("worker --join {url} --threads 1"));
    let ran = dir.run(&format!("submit fog.mgf --spp 4 --frames 1..2 --server {url}")).exits(0);
    let job = ran.stdout().lines().last().expect("a job id").to_owned();
    dir.run(&format!("watch {job} --server {url}")).exits(0);
    let stray = format!("artifacts/{}", file_names(&dir.path("artifacts"))[0]);
    let stray = dir.path(&stray).join("0".repeat(62));
    std::fs::write(&stray, "of no job").expect("written");
    let old = SystemTime::now() - Duration::from_secs(7200);
    File::options().write(true).open(&stray).and_then(|file| file.set_modified(old)).expect("aged");

    let report = dir.run(&format!("gc --dry-run --json --server {url}")).exits(0).json();
    assert_eq!((&report["garbage"]["artifacts"], &report["garbage"]["bytes"]), (&1.into(), &9.into()), "{report}");
    assert!(report["referenced"]["artifacts"].as_u64().is_some_and(|count| count >= 6), "{report}");
    assert!(stray.exists(), "nothing goes in a dry run");
    let ran = dir.run(&format!("gc --server {url}")).exits(0);
    assert!(ran.stdout().contains("removed: 1 artifact, 9B"), "{}", ran.stdout());
    assert!(!stray.exists());
    let ran = dir.run(&format!("gc --grace 5s --server {url}")).exits(2);
    assert!(ran.stderr().contains("at least 60 s"), "{}", ran.stderr());
    dir.run(&format!("fetch {job} -o out --server {url}")).exits(0);
    assert_eq!(file_names(&dir.path("out")).len(), 2);
}
