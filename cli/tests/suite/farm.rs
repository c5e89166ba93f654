//! Tests with coordinator, workers and clients as separate processes.

use crate::common;
use crate::common::{TestFolder, TestProcess, file_names, finished_share, samples_done, start_coordinator, submit};

fn worker(dir: &TestFolder, url: &str) -> TestProcess {
    dir.start(&format!("worker --join {url} --threads 1"))
}

fn frames_done(dir: &TestFolder, url: &str, job: &str) -> u64 {
    let ran = dir.run(&format!("status {job} --json --server {url}")).exits(0);
    ran.json()["frames_done"].as_u64().expect("a number")
}

const SETTINGS: &str = "--spp 12 --size 64x64";

fn assert_same_as_one_process(dir: &TestFolder, settings: &str) {
    dir.run(&format!("render fog.mgf -o alone {settings}")).exits(0);
    assert_eq!(file_names(&dir.path("out")), file_names(&dir.path("alone")));
    for name in file_names(&dir.path("alone")) {
        let (farm, alone) = (dir.path("out").join(&name), dir.path("alone").join(&name));
        assert_eq!(common::pixels(&farm), common::pixels(&alone), "{name}");
    }
}

#[test]
fn a_killed_worker_costs_no_pixel() {
    let dir = TestFolder::new();
    let (mut farm, url) = start_coordinator(&dir, 0);
    let (mut victim, _second, _third) = (worker(&dir, &url), worker(&dir, &url), worker(&dir, &url));
    let job = submit(&dir, &url, SETTINGS);
    farm.wait_until("a finished frame", || frames_done(&dir, &url, &job) >= 1);
    assert!(frames_done(&dir, &url, &job) < 8, "it is not over yet");
    assert!(victim.kill(), "the victim was alive");
    dir.run(&format!("watch {job} --server {url}")).exits(0);
    dir.run(&format!("fetch {job} -o out --server {url}")).exits(0);
    assert_same_as_one_process(&dir, SETTINGS);
}

#[test]
fn adaptive_tile_frames_equal_one_process() {
    const SETTINGS: &str = "--error 0.02 --size 96x64 --frames 1..2";
    let dir = TestFolder::new();
    let (mut farm, url) = start_coordinator(&dir, 0);
    let (mut victim, _second, _third) = (worker(&dir, &url), worker(&dir, &url), worker(&dir, &url));
    let job = submit(&dir, &url, SETTINGS);
    let decisions = || {
        let rows = dir.run(&format!("stats {job} --by task --json --server {url}")).exits(0).json();
        let is_decision = |row: &&serde_json::Value| row["task"].as_str().is_some_and(|task| task.contains("/decide."));
        rows.as_array().expect("rows").iter().filter(is_decision).count()
    };
    farm.wait_until("a round", || decisions() >= 1);
    assert!(victim.kill(), "the victim was alive");
    dir.run(&format!("watch {job} --server {url}")).exits(0);
    dir.run(&format!("fetch {job} -o out --server {url}")).exits(0);
    assert_same_as_one_process(&dir, SETTINGS);
    // Sum the samples of all rounds for each tile of the first frame.
    let rows = dir.run(&format!("stats {job} --by task --json --server {url}")).exits(0).json();
    let mut samples = std::collections::BTreeMap::new();
    for row in rows.as_array().expect("rows").iter().filter(|row| row["frame"] == 1 && !row["tile"].is_null()) {
        *samples.entry(row["tile"].as_u64()).or_insert(0) += row["samples"].as_u64().expect("a number") / 256;
    }
    let (least, most) = (samples.values().min(), samples.values().max());
    assert!(samples.len() == 24 && least >= Some(&8) && least < most, "{samples:?}");
    let is_end_of_round = |count: &u64| matches!(count >> count.trailing_zeros(), 1 | 3);
    assert!(samples.values().all(is_end_of_round), "every other round doubles the samples: {samples:?}");
}

#[test]
fn killed_coordinator_resumes_and_its_worker_rejoins() {
    let dir = TestFolder::new();
    let (mut first, url) = start_coordinator(&dir, 0);
    let _worker = worker(&dir, &url);
    let job = submit(&dir, &url, SETTINGS);
    first.wait_until("a finished frame", || frames_done(&dir, &url, &job) >= 1);
    let before = frames_done(&dir, &url, &job);
    assert!(before < 8, "it is not over yet");
    assert!(first.kill(), "the coordinator was alive");
    let port = url.rsplit(':').next().and_then(|port| port.parse().ok()).expect("a port");
    let (_second, url) = start_coordinator(&dir, port);
    assert!(frames_done(&dir, &url, &job) >= before, "what was finished is finished");
    dir.run(&format!("watch {job} --server {url}")).exits(0);
    dir.run(&format!("fetch {job} -o out --server {url}")).exits(0);
    assert_same_as_one_process(&dir, SETTINGS);
}

#[test]
fn a_frame_in_work_can_be_seen_and_shows_what_it_will_be() {
    let dir = TestFolder::new();
    let (mut farm, url) = start_coordinator(&dir, 0);
    let mut worker = worker(&dir, &url);
    let job = submit(&dir, &url, "--spp 200 --size 64x64 --frames 1");
    let tiles = || common::status(&dir, &url, &job)["active"][0]["tiles_done"].as_u64().unwrap_or(0);
    farm.wait_until("a tile", || tiles() >= 1);
    worker.signal("STOP");
    let ran = dir.run(&format!("fetch {job} -o out --partial --json --server {url}")).exits(1);
    assert_eq!(ran.json()["partial"][0], "out/fog.0001.partial.exr", "{}", ran.stdout());
    worker.signal("CONT");
    dir.run(&format!("watch {job} --server {url}")).exits(0);
    dir.run(&format!("fetch {job} -o out --partial --server {url}")).exits(0);
    let (partial, whole) =
        (common::film(&dir.path("out/fog.0001.partial.exr")), common::film(&dir.path("out/fog.0001.exr")));
    assert_eq!((partial.width, partial.height), (whole.width, whole.height));
    let lit = partial.rgb.iter().filter(|value| **value > 0.0).count();
    assert!(lit > 0 && lit < whole.rgb.len(), "{lit} of {} values", whole.rgb.len());
    let differs = |(part, whole): (&f32, &f32)| *part > 0.0 && part.to_bits() != whole.to_bits();
    assert!(!partial.rgb.iter().zip(&whole.rgb).any(differs), "what is there is what it will be");
}

#[test]
fn a_task_under_way_lives_through_the_coordinator_s_death() {
    let dir = TestFolder::new();
    let (mut first, url) = start_coordinator(&dir, 0);
    let _worker = worker(&dir, &url);
    // Each tile takes some seconds.
    let job = submit(&dir, &url, "--spp 1500 --size 32x32 --frames 1");
    first.wait_until("some samples", || finished_share(&dir, &url, &job) > 0.1);
    let before = finished_share(&dir, &url, &job);
    assert!(before < 0.7 && first.kill(), "it is not over, and the coordinator was alive");
    let port = url.rsplit(':').next().and_then(|port| port.parse().ok()).expect("a port");
    let (mut second, url) = start_coordinator(&dir, port);
    second.wait_until("progress", || finished_share(&dir, &url, &job) > before);
    dir.run(&format!("watch {job} --server {url}")).exits(0);
    // The second coordinator has recorded all attempts that ended while it ran, each with its lease's epoch.
    let logs = dir.run(&format!("logs {job} --json --server {url}")).exits(0).json();
    let granted_by = |log: &serde_json::Value| log["epoch"].as_u64().map_or(0, |epoch| epoch >> 40);
    let of_the_first = logs.as_array().expect("a list").iter().filter(|log| granted_by(log) == 1).count();
    assert!(of_the_first >= 1, "what was under way began anew: {logs}");
    let status = dir.run(&format!("status {job} --json --server {url}")).exits(0).json();
    assert_eq!(status["state"], "done");
}

#[test]
fn stopped_worker_finishes_its_task_and_leaves_the_rest() {
    let dir = TestFolder::new();
    let (mut farm, url) = start_coordinator(&dir, 0);
    let mut leaver = worker(&dir, &url);
    let job = submit(&dir, &url, SETTINGS);
    farm.wait_until("a finished frame", || frames_done(&dir, &url, &job) >= 1);
    leaver.signal("TERM");
    leaver.end().exits(0);
    let workers = dir.run(&format!("workers --json --server {url}")).exits(0).json();
    assert_eq!(workers.as_array().map(Vec::len), Some(0), "{workers}");
    let status = dir.run(&format!("status {job} --json --server {url}")).exits(0).json();
    assert!(status["frames_done"].as_u64().is_some_and(|frames| frames < 8), "it is not over yet: {status}");
    assert!(status["failure"].is_null() && status["quarantined"].as_array().is_some_and(Vec::is_empty), "{status}");
    let _other = worker(&dir, &url);
    dir.run(&format!("watch {job} --server {url}")).exits(0);
    dir.run(&format!("fetch {job} -o out --server {url}")).exits(0);
    assert_same_as_one_process(&dir, SETTINGS);
}

#[test]
fn after_an_edit_only_the_changed_files_are_sent() {
    let dir = TestFolder::new();
    let (_farm, url) = start_coordinator(&dir, 0);
    // Incompressible comments stand in for a mesh.
    let mut state = 1u64;
    let mut line = |_| {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        format!("# {:016x}{:016x}\n", state.rotate_left(7), state.wrapping_mul(state))
    };
    dir.write("mesh.mgf", &(0..20_000).map(&mut line).collect::<String>());
    let submit = |brightness: u32| {
        dir.write("main.mgf", &format!("# {brightness}\ni mesh.mgf\n{}", common::FOG));
        let line = format!("submit main.mgf --spp 4 --frames 1 --json --server {url}");
        let report = dir.run(&line).exits(0).json();
        let number = |key: &str| report[key].as_u64().expect("a number");
        (number("job"), number("scene_bytes"), number("sent_bytes"))
    };
    let (_, size, first) = submit(300);
    assert!(first == size && size > 300_000, "{first} of {size} bytes");
    assert_eq!(submit(300).2, 0, "the same scene again");
    let (edited, size, sent) = submit(301);
    println!("{sent} of {size} bytes after the edit");
    assert!((1..10_000).contains(&sent), "{sent} of {size} bytes");
    let _worker = dir.start(&format!("worker --join {url} --threads 1 --cache pieces --cache-size 1MiB"));
    dir.run(&format!("watch {edited} --server {url}")).exits(0);
    dir.run(&format!("fetch {edited} -o out --server {url}")).exits(0);
    dir.run("render main.mgf -o alone --spp 4 --frames 1").exits(0);
    let pixels = |folder| common::pixels(&dir.path(folder).join("main.0001.exr"));
    assert_eq!(pixels("out"), pixels("alone"));
    assert!(file_names(&dir.path("pieces")).len() >= 3, "manifest, mesh and the rest are kept");
}

#[test]
fn job_without_workers_is_reported_and_a_watch_can_be_left() {
    let dir = TestFolder::new();
    let (_farm, url) = start_coordinator(&dir, 0);
    let job = submit(&dir, &url, "--spp 1 --frames 1");
    let ran = dir.run(&format!("status {job} --why --server {url}")).exits(0);
    assert!(ran.stdout().contains("no worker"), "{}", ran.stdout());
    let jobs = dir.run(&format!("jobs --json --server {url}")).exits(0).json();
    assert_eq!(jobs[0]["job"].to_string(), job);
    let mut watch = dir.start(&format!("watch {job} --server {url}"));
    // Nothing shows that the watch has started; the test passes whenever the signal comes.
    std::thread::sleep(std::time::Duration::from_millis(300));
    watch.signal("INT");
    watch.end().exits(3);
}

#[test]
fn a_job_that_does_not_exist_is_wrong_usage() {
    let dir = TestFolder::new();
    let (_farm, url) = start_coordinator(&dir, 0);
    for command in ["status 77", "watch 77", "fetch 77 -o out"] {
        let ran = dir.run(&format!("{command} --server {url}")).exits(2);
        assert!(ran.stderr().contains("77"), "{command}: {}", ran.stderr());
    }
}

/// Waits until between a third and two thirds of the job's samples are drawn.
fn wait_until_half_done(dir: &TestFolder, farm: &mut TestProcess, url: &str, job: &str, samples: f64) {
    farm.wait_until("a third of the samples", || samples_done(dir, url, job) / samples > 0.33);
    let share = samples_done(dir, url, job) / samples;
    println!("killed with {:.0} % of the samples done", 100.0 * share);
    assert!(share < 0.67, "it is not over yet: {share}");
}

#[test]
#[ignore = "minutes: cargo test --release -p femc --test suite -- --ignored --nocapture six_ways"]
fn six_ways_to_one_frame() {
    render_in_six_ways("--spp 128 --size 192x192");
}

/// Tests tiles of 8 to 128 samples per pixel.
#[test]
#[ignore = "minutes: cargo test --release -p femc --test suite -- --ignored --nocapture six_ways"]
fn six_ways_to_one_frame_of_uneven_tiles() {
    render_in_six_ways("--error 0.03 --size 192x192");
}

/// Renders the frame of a foggy Cornell box in six ways and compares them; `FEMC_SIX_WAYS` names another scene.
fn render_in_six_ways(settings: &str) {
    let dir = TestFolder::new();
    let scene = std::env::var("FEMC_SIX_WAYS")
        .unwrap_or_else(|_| concat!(env!("CARGO_MANIFEST_DIR"), "/../scenes/cornell-fog.mgf").into());
    let (mut ways, mut samples) = (Vec::new(), 0.0);
    for (name, split) in [
        ("one worker of one thread", "--workers 1 --threads 1"),
        ("three workers of one thread", "--workers 3 --threads 1"),
        ("one worker of two threads", "--workers 1 --threads 2"),
    ] {
        let ran = dir.run(&format!("render {scene} -o one.exr {settings} {split} --json")).exits(0);
        samples = ran.json()["samples"].as_f64().expect("a number");
        ways.push((name, common::pixels(&dir.path("one.exr"))));
        std::fs::remove_file(dir.path("one.exr")).expect("it was written");
    }
    let queue = |url: &str| {
        let ran = dir.run(&format!("submit {scene} {settings} --server {url}")).exits(0);
        ran.stdout().lines().last().expect("a job id").to_owned()
    };
    let get = |url: &str, job: &str, out: &str| {
        dir.run(&format!("watch {job} --server {url}")).exits(0);
        dir.run(&format!("fetch {job} -o {out} --server {url}")).exits(0);
        let name = file_names(&dir.path(out)).into_iter().find(|name| name.ends_with(".exr")).expect("a frame");
        common::pixels(&dir.path(out).join(name))
    };

    let (mut farm, url) = start_coordinator(&dir, 0);
    let mut workers = [worker(&dir, &url), worker(&dir, &url), worker(&dir, &url)];
    let job = queue(&url);
    wait_until_half_done(&dir, &mut farm, &url, &job, samples);
    assert!(workers[1].kill(), "the victim was alive");
    ways.push(("three worker processes, one killed half way", get(&url, &job, "killed")));

    // Use a fresh farm. The same job on the old farm would be answered from the store, and another seed would be another frame.
    drop((farm, workers));
    for name in ["farm.db", "farm.db-wal", "farm.db-mark"] {
        let _ = std::fs::remove_file(dir.path(name));
    }
    std::fs::remove_dir_all(dir.path("artifacts")).expect("the artifacts");
    let (mut farm, url) = start_coordinator(&dir, 0);
    let mut workers = [worker(&dir, &url), worker(&dir, &url)];
    let job = queue(&url);
    wait_until_half_done(&dir, &mut farm, &url, &job, samples);
    assert!(farm.kill() && workers.iter_mut().all(TestProcess::kill), "all were alive");
    let port = url.rsplit(':').next().and_then(|port| port.parse().ok()).expect("a port");
    let (_farm, url) = start_coordinator(&dir, port);
    let kept = samples_done(&dir, &url, &job) / samples;
    println!("{:.0} % of the samples were kept", 100.0 * kept);
    assert!((0.1..0.67).contains(&kept), "what was acknowledged is kept, the rest is to do: {kept}");
    let _workers = [worker(&dir, &url), worker(&dir, &url)];
    ways.push(("all killed half way and started again", get(&url, &job, "resumed")));

    let line = format!("render {scene} -o clip --frames 1 {settings} --threads 1");
    let mut render = dir.start(&line);
    let begun = std::time::Instant::now();
    render.wait_until("some seconds", || begun.elapsed().as_secs() >= 4);
    assert!(render.kill(), "it was alive");
    assert!(file_names(&dir.path("clip")).is_empty(), "it had no frame yet");
    assert!(dir.path("clip/.femc").is_dir(), "what it had is kept");
    dir.run(&line).exits(0);
    let name = file_names(&dir.path("clip")).into_iter().find(|name| name.ends_with(".exr")).expect("a frame");
    ways.push(("one process, killed and started again", common::pixels(&dir.path("clip").join(name))));

    for (name, pixels) in &ways {
        println!("{}  {name}", common::digest(pixels));
        assert!(*pixels == ways[0].1, "{name}");
    }
}

/// Returns the path of a frame's image in the store.
fn image_path(dir: &TestFolder, fetched: &str) -> std::path::PathBuf {
    let bytes = std::fs::read(dir.path(fetched)).expect("it was fetched");
    dir.path("artifacts").join(femc_store::artifact_path(&femc_model::Digest::compute(&bytes)).to_string())
}

#[test]
fn damaged_image_of_a_cancelled_job_needs_a_retry() {
    let dir = TestFolder::new();
    let (_farm, url) = start_coordinator(&dir, 0);
    let mut worker = worker(&dir, &url);
    let job = submit(&dir, &url, "--size 64x64 --spp 64 --frames 1..8");
    worker.wait_until("a frame", || frames_done(&dir, &url, &job) > 0);
    dir.run(&format!("cancel {job} --server {url}")).exits(0);
    dir.run(&format!("fetch {job} -o part --server {url}")).exits(1);
    let first = file_names(&dir.path("part")).remove(0);
    std::fs::write(image_path(&dir, &format!("part/{first}")), b"half").expect("it is cut");
    std::fs::remove_dir_all(dir.path("part")).expect("fetched before");
    let ran = dir.run(&format!("fetch {job} -o part --server {url}")).exits(1);
    assert!(ran.stderr().contains(&format!("rendered again after `femc retry {job}`")), "{}", ran.stderr());
}

#[test]
fn damaged_image_is_named_and_rerendered_by_fetch_or_retry() {
    let dir = TestFolder::new();
    let (_farm, url) = start_coordinator(&dir, 0);
    let _worker = worker(&dir, &url);
    let job = submit(&dir, &url, SETTINGS);
    dir.run(&format!("watch {job} --server {url}")).exits(0);
    dir.run(&format!("fetch {job} -o out --server {url}")).exits(0);
    let intact = dir.run(&format!("retry {job} --server {url}")).exits(2);
    assert!(intact.stderr().contains("has ended"), "{}", intact.stderr());
    let all = file_names(&dir.path("out"));
    let (cut, flipped) = (format!("out/{}", all[1]), format!("out/{}", all[2]));
    let (at, whole) = (image_path(&dir, &cut), std::fs::read(image_path(&dir, &cut)).expect("an image"));
    std::fs::write(at, &whole[..whole.len() / 3]).expect("it is cut");
    std::fs::remove_dir_all(dir.path("out")).expect("fetched before");
    let ran = dir.run(&format!("fetch {job} -o out --server {url}")).exits(1);
    let said = format!("frame 2 of job {job} ({})", all[1]);
    assert!(ran.stderr().contains(&said) && ran.stderr().contains("rendered again"), "{}", ran.stderr());
    assert_eq!(file_names(&dir.path("out")).len(), all.len() - 1, "all others are there");
    dir.run(&format!("watch {job} --server {url}")).exits(0);
    dir.run(&format!("fetch {job} -o out --server {url}")).exits(0);

    let (at, mut bytes) = (image_path(&dir, &flipped), std::fs::read(dir.path(&flipped)).expect("an image"));
    let middle = bytes.len() / 2;
    bytes[middle] ^= 1;
    std::fs::write(at, bytes).expect("it is changed");
    let ran = dir.run(&format!("retry {job} --server {url}")).exits(0);
    assert!(ran.stderr().contains("frame 3"), "{}", ran.stderr());
    dir.run(&format!("watch {job} --server {url}")).exits(0);
    std::fs::remove_dir_all(dir.path("out")).expect("fetched before");
    dir.run(&format!("fetch {job} -o out --server {url}")).exits(0);
    assert_same_as_one_process(&dir, SETTINGS);
}

#[test]
fn retry_of_selected_frames_leaves_other_frames_unchanged() {
    let dir = TestFolder::new();
    let (_farm, url) = start_coordinator(&dir, 0);
    let _worker = worker(&dir, &url);
    let job = submit(&dir, &url, SETTINGS);
    dir.run(&format!("watch {job} --server {url}")).exits(0);
    dir.run(&format!("fetch {job} -o out --server {url}")).exits(0);
    let all = file_names(&dir.path("out"));
    for name in &all[1..3] {
        let at = image_path(&dir, &format!("out/{name}"));
        let whole = std::fs::read(&at).expect("an image");
        std::fs::write(at, &whole[..whole.len() / 3]).expect("it is cut");
    }
    for (frames, word) in [("9", "no frame 9"), ("1..1000000000", "no frame"), ("0", "begin at 1"), ("3,", "")] {
        let ran = dir.run(&format!("retry {job} --frames {frames} --server {url}")).exits(2);
        assert!(ran.stderr().contains(word), "{frames}: {}", ran.stderr());
    }
    let ran = dir.run(&format!("retry {job} --frames 1,3 --server {url}")).exits(0);
    assert!(ran.stderr().contains("of the frames 1,3"), "{}", ran.stderr());
    dir.run(&format!("watch {job} --server {url}")).exits(0);
    std::fs::remove_dir_all(dir.path("out")).expect("fetched before");
    let ran = dir.run(&format!("fetch {job} -o out --server {url}")).exits(1);
    let (asked, other) = (format!("frame 3 of job {job}"), format!("frame 2 of job {job}"));
    assert!(ran.stderr().contains(&other) && !ran.stderr().contains(&asked), "{}", ran.stderr());
    dir.run(&format!("watch {job} --server {url}")).exits(0);
    dir.run(&format!("fetch {job} -o out --server {url}")).exits(0);
    assert_same_as_one_process(&dir, SETTINGS);
}

#[test]
fn waiting_fetch_returns_all_frames_and_the_job_outcome() {
    let dir = TestFolder::new();
    let (_farm, url) = start_coordinator(&dir, 0);
    let job = submit(&dir, &url, SETTINGS);
    let mut fetch = dir.start(&format!("fetch {job} -o out --wait --server {url}"));
    // The farm has no worker yet: without `--wait` the command would have ended with exit code 1.
    dir.run(&format!("fetch {job} -o early --server {url}")).exits(1);
    let _worker = worker(&dir, &url);
    fetch.end().exits(0);
    assert_eq!(dir.run(&format!("fetch {job} -o out --json --server {url}")).exits(0).json()["state"], "done");
    assert_same_as_one_process(&dir, SETTINGS);
    let endless = submit(&dir, &url, "--size 256x256 --spp 100000");
    dir.run(&format!("cancel {endless} --server {url}")).exits(0);
    let ran = dir.run(&format!("fetch {endless} -o none --wait --server {url}")).exits(1);
    assert!(ran.stderr().contains("is cancelled"), "{}", ran.stderr());
}
