//! Tests of the first pass on a farm: each world has one task, and every worker that solves it produces the same bytes.

use std::collections::BTreeMap;

use crate::common::{FOG, TestFolder, TestProcess, file_names, pixels, start_coordinator, status, submit};
use femc_model::{Digest, Role, TaskKey};
use femc_queue::Queue as _;
use femc_schedule::Fact;

/// Creates a folder with the room, in which only the view changes.
fn still_folder() -> TestFolder {
    let dir = TestFolder::new();
    let text = FOG.replace("vary medium.fog.sigma_s = 0 0.02 1 0.3", "vary camera.main.fov = 0 40 1 30");
    assert_ne!(text, FOG);
    dir.write("still.mgf", &text);
    dir
}

/// Reads from the log how many first passes began, and the solution of each, by its task.
async fn solutions(dir: &TestFolder) -> (usize, BTreeMap<TaskKey, Digest>) {
    let mut log = femc_queue::Sqlite::open(&dir.path("farm.db")).await.expect("a log");
    let (mut begun, mut done) = (0, BTreeMap::new());
    for record in log.load().await.expect("its records").records {
        match Fact::decode(&record).expect("a fact").1 {
            Fact::SharedJobBegun { .. } => begun += 1,
            Fact::Done { task, result, .. } if task.job.is_shared() => {
                let field = result.outputs.iter().find(|output| output.role == Role::Field);
                assert!(field.is_some() || begun > 0, "{task} is of something that was begun");
                if let Some(field) = field {
                    assert!(done.insert(task, field.artifact.digest).is_none(), "{task} counts twice");
                }
            }
            _ => {}
        }
    }
    (begun, done)
}

/// Returns only the solutions, in the order of their requests.
async fn fields_of(dir: &TestFolder) -> Vec<Digest> {
    solutions(dir).await.1.into_values().collect()
}

fn run<T>(work: impl Future<Output = T>) -> T {
    tokio::runtime::Runtime::new().expect("a runtime").block_on(work)
}

/// Submits frames of a scene with a first pass. Returns the job's number.
fn submit_frames(dir: &TestFolder, url: &str, scene: &str, method: &str) -> String {
    let line = format!("submit {scene} --server {url} --method {method} --spp 4 --frames 1..2");
    dir.run(&line).exits(0).stdout().trim().to_owned()
}

/// Fetches the job's frames and checks that their pixels equal those of one process.
fn assert_frames_equal(dir: &TestFolder, url: &str, job: &str, scene: &str, method: &str, threads: u32) {
    dir.run(&format!("watch {job} --server {url}")).exits(0);
    dir.run(&format!("fetch {job} -o out --server {url}")).exits(0);
    let line = format!("render {scene} -o alone --method {method} --spp 4 --frames 1..2 --threads {threads}");
    dir.run(&line).exits(0);
    let frames = file_names(&dir.path("alone"));
    assert!(frames.len() >= 2, "{frames:?}");
    for frame in frames {
        assert_eq!(pixels(&dir.path("out").join(&frame)), pixels(&dir.path("alone").join(&frame)), "{frame}");
    }
}

#[test]
fn frames_of_one_world_share_a_first_pass_for_any_parallelism() {
    let mut fields = Vec::new();
    for (workers, threads) in [(1, 2), (3, 1)] {
        let dir = still_folder();
        let (mut farm, url) = start_coordinator(&dir, 0);
        let _workers: Vec<TestProcess> =
            (0..workers).map(|_| dir.start(&format!("worker --join {url} --threads {threads}"))).collect();
        // The two methods have a solution each: one is shown directly, the other guides paths.
        for method in ["fem", "femc"] {
            let job = submit_frames(&dir, &url, "still.mgf", method);
            assert_frames_equal(&dir, &url, &job, "still.mgf", method, 3 - threads);
            std::fs::remove_dir_all(dir.path("alone")).expect("frames");
            std::fs::remove_dir_all(dir.path("out")).expect("frames");
        }
        farm.kill();
        let (begun, done) = run(solutions(&dir));
        assert_eq!((begun, done.len()), (2, 2), "{done:?}");
        fields.push(done.into_values().collect::<Vec<_>>());
    }
    assert_eq!(fields[0], fields[1], "the same solutions to the bit");
}

#[test]
fn each_world_has_its_first_pass_and_a_second_job_reuses_them() {
    let dir = still_folder();
    let (mut farm, url) = start_coordinator(&dir, 0);
    let _worker = dir.start(&format!("worker --join {url} --threads 2"));
    let first = submit_frames(&dir, &url, "fog.mgf", "fem");
    assert_frames_equal(&dir, &url, &first, "fog.mgf", "fem", 1);
    let line = format!("submit fog.mgf --server {url} --method fem --spp 1 --seed 7 --size 16x16 --frames 2");
    let second = dir.run(&line).exits(0).stdout().trim().to_owned();
    dir.run(&format!("watch {second} --server {url}")).exits(0);
    let paths = submit(&dir, &url, "--method pt --spp 1 --frames 1");
    dir.run(&format!("watch {paths} --server {url}")).exits(0);
    farm.kill();
    let (begun, done) = run(solutions(&dir));
    assert_eq!((begun, done.len()), (2, 2), "one for each fog, none for the other jobs: {done:?}");
}

#[test]
fn a_sweep_of_the_power_of_all_lamps_has_one_first_pass() {
    let dir = still_folder();
    let (mut farm, url) = start_coordinator(&dir, 0);
    let _worker = dir.start(&format!("worker --join {url} --threads 2"));
    let still = std::fs::read_to_string(dir.path("still.mgf")).expect("a scene");
    let lamp = still.lines().find(|line| line.trim_start().starts_with("ed ")).expect("a lamp");
    for power in ["300", "41.7", "9000"] {
        let scene = format!("lamp-{power}.mgf");
        dir.write(&scene, &still.replace(lamp, &format!("\ted {power}")));
        let job = submit_frames(&dir, &url, &scene, "femc");
        assert_frames_equal(&dir, &url, &job, &scene, "femc", 1);
        std::fs::remove_dir_all(dir.path("alone")).expect("frames");
        std::fs::remove_dir_all(dir.path("out")).expect("frames");
    }
    farm.kill();
    let (begun, done) = run(solutions(&dir));
    assert_eq!((begun, done.len()), (1, 1), "{done:?}");
}

#[test]
fn worker_killed_in_a_first_pass_costs_one_more_solution() {
    let dir = still_folder();
    let (mut farm, url) = start_coordinator(&dir, 0);
    let token = dir.path("token");
    let line = format!("worker --join {url} --threads 1 --outbox memory");
    let fault = format!("worker-before-task:1:{}", token.display());
    let mut victim = TestProcess::spawn(dir.command(&line).env("FEMC_FAULT", fault));
    let job = submit_frames(&dir, &url, "still.mgf", "femc");
    victim.wait_until("its task", || token.exists());
    let why = dir.run(&format!("status {job} --why --server {url}")).exits(0).stdout();
    assert!(why.contains("first-pass"), "{why}");
    let _other = dir.start(&line);
    assert!(victim.kill(), "it was alive");
    assert_frames_equal(&dir, &url, &job, "still.mgf", "femc", 1);
    assert_eq!(status(&dir, &url, &job)["state"], "done");
    let logs = dir.run(&format!("logs {job} --server {url}")).exits(0).stdout();
    assert!(logs.contains("first-pass") && logs.contains("links="), "what it was made of is in its log: {logs}");
    let task = dir.run(&format!("logs shared-1/0.0/first-pass.0/0 --json --server {url}")).exits(0).json();
    assert_eq!(task.as_array().map(Vec::len), Some(1), "{task}");
    let stats = dir.run(&format!("stats shared-1 --by task --server {url}")).exits(0).stdout();
    assert!(stats.contains("first-pass"), "{stats}");
    farm.kill();
    let (begun, done) = run(solutions(&dir));
    assert_eq!((begun, done.len()), (1, 1), "{done:?}");
}

/// Like [`submit_frames`], with a solution in this many blocks.
fn submit_in_blocks(dir: &TestFolder, url: &str, scene: &str, method: &str, blocks: u32) -> String {
    let line = format!("submit {scene} --server {url} --method {method} --spp 4 --frames 1..2");
    let mut submission = dir.command(&line);
    TestProcess::spawn(submission.env("FEMC_PRETEND", format!("blocks={blocks}")))
        .end()
        .exits(0)
        .stdout()
        .trim()
        .to_owned()
}

#[test]
fn blocked_first_pass_is_bit_identical_for_any_workers_or_kill() {
    let mut fields = Vec::new();
    for workers in [1, 2, 3] {
        let dir = still_folder();
        let (mut farm, url) = start_coordinator(&dir, 0);
        let line = format!("worker --join {url} --threads 1 --outbox memory");
        // This worker stops in the middle of the blocks, until it is killed there.
        let token = dir.path("token");
        let fault = format!("worker-before-task:9:{}", token.display());
        let mut victim = (workers == 3).then(|| TestProcess::spawn(dir.command(&line).env("FEMC_FAULT", fault)));
        let _others: Vec<TestProcess> = (victim.iter().count()..workers).map(|_| dir.start(&line)).collect();
        for method in ["fem", "femc"] {
            let job = submit_in_blocks(&dir, &url, "still.mgf", method, 64);
            if let Some(mut victim) = victim.take() {
                victim.wait_until("its task", || token.exists());
                assert!(victim.kill(), "it was alive");
            }
            assert_frames_equal(&dir, &url, &job, "still.mgf", method, 2);
            std::fs::remove_dir_all(dir.path("alone")).expect("frames");
            std::fs::remove_dir_all(dir.path("out")).expect("frames");
        }
        farm.kill();
        fields.push(run(fields_of(&dir)));
    }
    assert_eq!(fields[0].len(), 2, "{fields:?}");
    assert!(fields.iter().all(|found| *found == fields[0]), "{fields:?}");
    // A single task that solves it as a whole produces the same bytes.
    let dir = still_folder();
    let (mut farm, url) = start_coordinator(&dir, 0);
    let _worker = dir.start(&format!("worker --join {url} --threads 2"));
    for method in ["fem", "femc"] {
        let job = submit_frames(&dir, &url, "still.mgf", method);
        dir.run(&format!("watch {job} --server {url}")).exits(0);
    }
    farm.kill();
    assert_eq!(run(fields_of(&dir)), fields[0]);
}

#[test]
fn a_plan_says_how_many_solutions_the_frames_share() {
    let dir = still_folder();
    let plan = |line: &str| dir.run(&format!("plan {line} --no-trial")).exits(0).stdout();
    let shared = plan("still.mgf --method fem --frames 1..4");
    assert!(shared.contains("first-pass") && shared.contains("solved once, and all 4 frames share it"), "{shared}");
    assert!(!shared.contains("finite-element first pass: path tracing"), "{shared}");
    assert!(shared.contains("the first pass is one task: for ") && !shared.contains("first-pass-rays"), "{shared}");
    let face = FOG.lines().rfind(|line| line.starts_with("f ")).expect("a face");
    dir.write("many.mgf", &format!("{FOG}{}", format!("{face}\n").repeat(640)));
    let many = plan("many.mgf --method femc --frames 1");
    assert!(many.contains("its rays are cast in 10 blocks, because the scene has 6"), "{many}");
    assert!(many.contains("first-pass-rays") && many.contains("solver-state of "), "{many}");
    let own = plan("fog.mgf --method fem --frames 1..4");
    assert!(own.contains("every frame has its own first pass"), "{own}");
    let none = plan("still.mgf --frames 1..4");
    assert!(!none.contains("solved") && none.contains("finite-element first pass: path tracing"), "{none}");
    let count = |line: &str| {
        let plan = dir.run(&format!("plan {line} --no-trial --json")).exits(0).json();
        (plan["first_passes"].clone(), plan["tasks"].as_u64(), plan["graph"]["stages"].as_array().map(Vec::len))
    };
    let (with, tasks, stages) = count("still.mgf --method fem --spp 4 --frames 1..4");
    let (without, fewer, before) = count("still.mgf --method pt --spp 4 --frames 1..4");
    assert_eq!((with, without), (1.into(), 0.into()));
    assert_eq!((tasks, stages), (fewer.map(|n| n + 1), before.map(|n| n + 1)));
}

/// Checks that without `--method` a pilot decides whether a first pass is solved, with the same result in `plan` and `submit`.
#[test]
fn only_large_jobs_of_a_room_are_guided_by_a_first_pass() {
    let dir = TestFolder::new();
    let door = std::fs::read_to_string(concat!(env!("CARGO_MANIFEST_DIR"), "/../scenes/door-ajar.mgf"));
    dir.write("still.mgf", &door.expect("a scene"));
    let plan = |line: &str| dir.run(&format!("plan still.mgf --frames 1 {line} --json")).exits(0).json();
    let large = plan("--size 160x120 --spp 16384");
    assert_eq!((&large["method"], &large["first_passes"]), (&"femc".into(), &1.into()), "{large}");
    let choice = &large["choice"];
    assert!(choice["pilot"]["gain"]["estimated"].as_f64().is_some_and(|gain| gain > 1.25), "{choice}");
    assert!(choice["reason"].as_str().is_some_and(|reason| reason.contains("of the variance")), "{choice}");
    let small = plan("--size 16x12 --spp 4");
    assert_eq!((&small["method"], &small["choice"]["pilot"]), (&"pt".into(), &serde_json::Value::Null), "{small}");
    let reason = &small["left_out"][0]["reason"];
    assert!(reason.as_str().is_some_and(|reason| reason.starts_with("the job is small")), "{small}");
    // A plan without a trial draws no samples, and a named method needs none.
    assert_eq!(plan("--size 160x120 --spp 16384 --no-trial")["method"], "pt");
    assert_eq!(plan("--size 160x120 --spp 16384 --method pt")["choice"], serde_json::Value::Null);

    let (_farm, url) = start_coordinator(&dir, 0);
    let line = format!("submit still.mgf --server {url} --frames 1 --size 160x120 --spp 16384");
    let said = dir.run(&line).exits(0);
    assert!(said.stderr().contains("a first pass guides the paths"), "{}", said.stderr());

    // A render in one process uses the first pass that its pilot has solved.
    let mut command = dir.command("render still.mgf -o out.exr --frames 1 --size 160x120 --spp 16384 --threads 1");
    let mut render = dir.start_command("render", command.env("FEMC_LOG", "femc=debug"));
    render.wait_until("the first pass is finished", || dir.read("render.err").contains("stored="));
    render.kill();
    let log = dir.read("render.err");
    assert!(log.contains("the first pass was solved before the job"), "{log}");
}
