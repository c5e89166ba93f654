//! Tests that `--threads N` is the number of compute threads, in every command and every task.
#![cfg(target_os = "linux")]

use crate::common::http::{free_port, metrics};
use crate::common::{CommandOutput, TestFolder, TestProcess, start_coordinator};
use std::fmt::Write as _;
use std::process::Command;

/// Number of threads of rayon's global pool, if anything used it. They do not fit into [`MEMORY`], so that such a use panics.
const GLOBAL: usize = 1000;
/// Address space of a process in KiB; a thread's stack takes 2 MiB of it.
const MEMORY: usize = 1_500_000;

/// Returns `femc` in a process in which rayon's global pool cannot be started.
fn confined_command(dir: &TestFolder, line: &str) -> Command {
    let mut command = Command::new("sh");
    let femc = dir.command(line);
    command.arg("-c").arg(format!("ulimit -v {MEMORY}; exec \"$0\" \"$@\"")).arg(femc.get_program());
    command.args(femc.get_args()).current_dir(dir.path(""));
    for (name, value) in femc.get_envs() {
        match value {
            Some(value) => command.env(name, value),
            None => command.env_remove(name),
        };
    }
    // Each arena of the allocator also uses address space.
    command.env("RAYON_NUM_THREADS", GLOBAL.to_string()).env("MALLOC_ARENA_MAX", "2");
    command
}

fn run(dir: &TestFolder, line: &str) -> CommandOutput {
    TestProcess::spawn(&mut confined_command(dir, line)).end().exits(0)
}

/// Writes scenes whose trees and images are large enough for many threads: a fine mesh in `fine.mgf`, and `wide.mgf`, whose camera
/// sees nothing, so that its many pixels take little time.
fn scenes(dir: &TestFolder) {
    let (fog, mut mesh) = (dir.read("fog.mgf"), String::from("m wall\n"));
    let side = 60;
    for (x, y) in (0..=side).flat_map(|y| (0..=side).map(move |x| (x, y))) {
        let at = |n: i32| 1.8 * f64::from(n) / f64::from(side) - 0.9;
        writeln!(mesh, "v g{x}_{y} =\n\tp {} {} 0.2", at(x), at(y)).expect("text");
    }
    for (x, y) in (0..side).flat_map(|y| (0..side).map(move |x| (x, y))) {
        let (a, b) = (x + 1, y + 1);
        writeln!(mesh, "f g{x}_{y} g{a}_{y} g{a}_{b}\nf g{x}_{y} g{a}_{b} g{x}_{b}").expect("text");
    }
    dir.write("fine.mgf", &format!("{fog}{mesh}"));
    dir.write("wide.mgf", &fog.replace("origin 0 -3.4 1", "origin 0 -3.4 50").replace("target 0 0 1", "target 0 0 90"));
}

#[test]
fn a_render_starts_no_threads_beside_its_own() {
    let dir = TestFolder::new();
    scenes(&dir);
    for line in [
        "fine.mgf --frames 1 --spp 1 --layers guides --stats",
        "wide.mgf --frames 1 --spp 1 --size 640x420 --layers guides --preview --contact-sheet sheet.png",
        "fog.mgf --frames 1..2 --error 0.5 --size 64x64 --layers guides --style oil",
        "fog.mgf --frames 1 --spp 1 --method fem",
        "fog.mgf --frames 1 --spp 1 --method femc",
    ] {
        run(&dir, &format!("render {line} --threads 1 -o out"));
    }
    run(&dir, "plan fine.mgf --frames 1 --spp 1 --threads 1 --json");
}

/// Stack size of a thread in bytes. It is large, so that when a thread does not fit, the earlier threads still have room for their
/// allocations.
const STACK: usize = 128 << 20;

#[test]
fn thread_start_failure_is_an_error_with_advice() {
    let dir = TestFolder::new();
    let (_farm, url) = start_coordinator(&dir, 0);
    for line in [
        format!("worker --join {url} --threads {GLOBAL}"),
        format!("render fog.mgf --frames 1 --spp 1 --method pt --threads {GLOBAL} -o out"),
        format!("plan fog.mgf --frames 1 --threads {GLOBAL}"),
    ] {
        let mut command = confined_command(&dir, &line);
        let error = TestProcess::spawn(command.env("RUST_MIN_STACK", STACK.to_string())).end().exits(1).stderr();
        assert!(error.contains("cannot start threads") && error.contains("ulimit -u"), "{line}: {error}");
        assert!(!error.contains("panic"), "{line}: {error}");
    }
}

#[test]
fn worker_starts_no_extra_threads_for_any_task() {
    let dir = TestFolder::new();
    scenes(&dir);
    let (_farm, url) = start_coordinator(&dir, 0);
    let port = free_port();
    let line = format!("worker --join {url} --threads 1 --name w1 --metrics {port}");
    let mut worker = TestProcess::spawn(&mut confined_command(&dir, &line));
    for line in [
        "fine.mgf --frames 1..2 --spp 1 --layers guides --stats --method pt",
        "wide.mgf --frames 1 --spp 1 --size 640x420 --preview --method pt",
        "fog.mgf --frames 1..2 --error 0.5 --contact-sheet sheet.png --layers guides --style oil --method pt",
        "fog.mgf --frames 1 --spp 1 --method femc",
    ] {
        let ran = dir.run(&format!("submit {line} --server {url}")).exits(0);
        let job = ran.stdout().lines().last().expect("a job").to_owned();
        dir.run(&format!("watch {job} --quiet --server {url}")).exits(0);
    }
    let done = metrics(port);
    let frames = ["render", "reduce", "decide", "image", "reduce-layers", "count-levels", "first-pass"];
    for stage in frames.into_iter().chain(["reduce-levels", "encode-picture", "encode-sheet", "paint"]) {
        let tasks = done.value("femc_worker_tasks_done_total", &[("stage", stage)]);
        assert!(tasks.is_some_and(|tasks| tasks > 0.0), "no task of {stage}: {tasks:?}");
    }
    let said = worker.kill_for_stderr();
    assert!(!said.contains("panic"), "{said}");
}
