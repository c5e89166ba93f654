//! Tests of a real coordinator on a real disk that is full, and that nobody else uses.

use crate::common;
use crate::common::http::{free_port, get, metrics};
use crate::common::{TestFolder, finished_share, status, submit};
use std::path::Path;
use std::process::Command;

/// A small RAM disk, which is unmounted when dropped.
struct RamDisk<'a>(&'a Path);

impl<'a> RamDisk<'a> {
    /// Mounts the disk. Returns `None` if only an administrator may, and prints that.
    fn mount(at: &'a Path, size: &str) -> Option<Self> {
        std::fs::create_dir_all(at).expect("a folder");
        let mount =
            Command::new("mount").args(["-t", "tmpfs", "-o", &format!("size={size}"), "tmpfs"]).arg(at).output();
        if mount.is_ok_and(|mount| mount.status.success()) {
            return Some(Self(at));
        }
        println!("skipped: no disk can be mounted here");
        None
    }

    /// Writes until the disk is full.
    fn fill(&self) {
        use std::io::Write as _;
        let mut file = std::fs::File::create(self.0.join("ballast")).expect("a file");
        for size in [1 << 16, 1 << 12, 1] {
            while file.write(&vec![1; size]).is_ok_and(|written| written > 0) {}
        }
    }

    fn empty(&self) {
        std::fs::remove_file(self.0.join("ballast")).expect("the file goes");
    }
}

impl Drop for RamDisk<'_> {
    fn drop(&mut self) {
        // A failed test may still have open files there.
        let _ = Command::new("umount").arg("--lazy").arg(self.0).status();
    }
}

#[test]
fn coordinator_reports_a_full_log_disk_and_resumes_with_room() {
    let dir = TestFolder::new();
    let at = dir.path("small");
    let Some(disk) = RamDisk::mount(&at, "24m") else { return };
    let port = free_port();
    let line = "coordinator --listen 127.0.0.1:0 --store sqlite:small/farm.db --artifacts artifacts --keep-free 1MiB";
    let mut farm = dir.start(&format!("{line} --metrics {port}"));
    let url = farm.address();
    let job = submit(&dir, &url, "--spp 64 --frames 1..6");
    let _worker = dir.start(&format!("worker --join {url} --threads 1 --outbox memory"));
    farm.wait_until("some samples", || finished_share(&dir, &url, &job) > 0.1);
    disk.fill();
    farm.wait_until("a full log", || {
        get(port, "/readyz").is_some_and(|(code, body)| code == 503 && body.contains("room"))
    });
    assert_eq!(metrics(port).value("femc_log_waits_for_room", &[]), Some(1.0));
    farm.wait_until("a look at the disk", || {
        metrics(port).value("femc_disk_free_bytes", &[("holds", "log")]).is_some_and(|free| free < 1e6)
    });
    assert!(get(port, "/healthz").is_some_and(|(code, _)| code == 200), "no restart helps");
    let ran = dir.run(&format!("jobs --server {url}"));
    assert!(ran.stderr().contains("no room for the log"), "{}", ran.stderr());
    let ran = dir.run(&format!("submit fog.mgf --spp 1 --frames 1 --server {url}")).exits(1);
    assert!(ran.stderr().contains("accepts no new jobs"), "{}", ran.stderr());
    assert!(farm.is_running());
    disk.empty();
    farm.wait_until("room", || get(port, "/readyz").is_some_and(|(code, _)| code == 200));
    farm.wait_until("the job's end", || status(&dir, &url, &job)["state"] == "done");
    dir.run(&format!("fetch {job} -o out --server {url}")).exits(0);
    dir.run("render fog.mgf -o alone --spp 64 --frames 1..6").exits(0);
    for frame in common::file_names(&dir.path("alone")) {
        let same = common::pixels(&dir.path("out").join(&frame)) == common::pixels(&dir.path("alone").join(&frame));
        assert!(same, "{frame}");
    }
    // After a kill and a restart everything is there.
    disk.fill();
    assert!(farm.kill());
    disk.empty();
    let mut farm = dir.start(line);
    let url = farm.address();
    assert_eq!(status(&dir, &url, &job)["state"], "done");
    drop(farm);
}

#[test]
fn disk_filling_up_is_reported_by_jobs_before_jobs_are_refused() {
    let dir = TestFolder::new();
    let at = dir.path("small");
    let Some(_disk) = RamDisk::mount(&at, "24m") else { return };
    let line = "coordinator --listen 127.0.0.1:0 --store sqlite:small/farm.db --artifacts artifacts";
    let mut farm = dir.start(&format!("{line} --keep-free 8MiB"));
    let url = farm.address();
    submit(&dir, &url, "--spp 1 --frames 1");
    let ran = dir.run(&format!("jobs --server {url}")).exits(0);
    assert!(ran.stderr().contains("MiB are free for the log"), "{}", ran.stderr());
    std::fs::write(at.join("ballast"), vec![1; 15 << 20]).expect("there is room");
    farm.wait_until("a refusal", || {
        let ran = dir.run(&format!("submit fog.mgf --spp 1 --frames 1 --server {url}"));
        ran.stderr().contains("accepts no new jobs")
    });
    let ran = dir.run(&format!("jobs --server {url}")).exits(0);
    assert!(ran.stderr().contains("new jobs are refused until"), "{}", ran.stderr());
}
