//! Tests of the manual: each page of `docs/` is run as a script.
//!
//! Blocks marked `sh` run in the order of the page, in a folder with a copy of `scenes/` and `deploy/`. Blocks marked
//! `toml file=NAME` (or `mgf`, `ies`) are written there. Blocks marked `python` run if pandas and polars are installed. Blocks
//! marked `text` are output of a program, or, with `by=FILE`, commands that the named test runs. A page fails if any of its
//! commands fails.
#![cfg(unix)]

use femc_require::Prerequisite;
use std::fmt::Write as _;
use std::net::TcpListener;
use std::os::unix::process::CommandExt as _;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::atomic::{AtomicU32, Ordering};

/// Beginning of the script: background processes end with it.
const BEGIN: &str = "set -euo pipefail\n\
    export FEMC_SERVER=http://127.0.0.1:7878\n\
    trap 'kill -9 $(jobs -p) 2>/dev/null || true' EXIT\n\
    until_it_listens() {\n\
    \x20   for _ in $(seq 600); do (exec 3<>/dev/tcp/127.0.0.1/$1) 2>/dev/null && return; sleep 0.05; done\n\
    \x20   echo \"nobody listens at $1\" >&2; return 1\n\
    }\n";

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("..")
}

/// A block between fences, and the attributes of its first fence.
struct Block {
    attributes: String,
    text: String,
}

fn blocks(page: &str) -> Vec<Block> {
    let mut blocks = Vec::new();
    let mut open: Option<Block> = None;
    for line in page.lines() {
        match (line.strip_prefix("```"), open.take()) {
            (Some(_), Some(block)) => blocks.push(block),
            (Some(is), None) => open = Some(Block { attributes: is.to_owned(), text: String::new() }),
            (None, Some(mut block)) => {
                block.text.push_str(line);
                block.text.push('\n');
                open = Some(block);
            }
            (None, None) => {}
        }
    }
    assert!(open.is_none(), "a block without an end");
    blocks
}

/// Returns a free port from 20000 to 31999. The system assigns no ports in this range (its own begin at 32768), so the port is
/// still free when the page uses it.
fn free_port() -> String {
    static NEXT: AtomicU32 = AtomicU32::new(0);
    let is_free = |port: &u32| TcpListener::bind(("127.0.0.1", *port as u16)).is_ok();
    let ports = std::iter::repeat_with(|| {
        let number = NEXT.fetch_add(1, Ordering::Relaxed);
        20_000 + std::process::id().wrapping_mul(101).wrapping_add(number) % 12_000
    });
    ports.take(12_000).find(is_free).expect("a port").to_string()
}

fn python() -> Option<String> {
    let python = std::env::var("FEMC_TEST_PYTHON").unwrap_or_else(|_| "python3".to_owned());
    let ran = Command::new(&python).args(["-c", "import pandas, polars"]).output();
    let python = ran.is_ok_and(|ran| ran.status.success()).then_some(python);
    Prerequisite::Python.or_skip(python, "a block that needs pandas and polars (tests/python installs them)")
}

/// Returns the page as a script.
fn script(page: &str) -> String {
    let mut script = BEGIN.to_owned();
    for Block { attributes: is, text } in blocks(page) {
        let mut words = is.split_whitespace();
        match (words.next(), words.next().and_then(|word| word.strip_prefix("file="))) {
            (Some("sh"), None) => {
                for line in text.lines() {
                    // A reader would have seen that the coordinator listens, and that a killed process is gone. The script waits
                    // for both.
                    let listens = line.starts_with("femc coordinator") && line.ends_with('&');
                    let dies = line.strip_prefix("kill -9 ").and_then(|who| who.split_whitespace().next());
                    let seen = match dies {
                        Some(job) => format!("\nwait {job} || true"),
                        None if listens => "\nuntil_it_listens 7878".to_owned(),
                        None => String::new(),
                    };
                    let _ = writeln!(script, "{line}{seen}");
                }
            }
            (Some("toml" | "mgf" | "ies"), Some(file)) => {
                let _ = write!(script, "cat >{file} <<'END OF FILE'\n{text}END OF FILE\n");
            }
            (Some("text"), None) => {
                if let Some(test) = is.split_whitespace().nth(1).and_then(|word| word.strip_prefix("by=")) {
                    assert!(root().join(test).exists(), "`{is}`: there is no such test");
                }
            }
            (Some("python"), None) => {
                if let Some(python) = python() {
                    let _ = write!(script, "{python} - <<'END OF FILE'\n{text}END OF FILE\n");
                }
            }
            _ => panic!("what is a block marked `{is}`?"),
        }
    }
    ["7878", "7879", "9464", "9465"].iter().fold(script, |script, port| script.replace(port, &free_port()))
}

fn copy(from: &Path, to: &Path) {
    std::fs::create_dir_all(to).expect("a folder");
    for entry in std::fs::read_dir(from).expect("a folder") {
        let entry = entry.expect("an entry");
        let (path, to) = (entry.path(), to.join(entry.file_name()));
        if path.is_dir() { copy(&path, &to) } else { std::fs::copy(&path, &to).map(drop).expect("a file") }
    }
}

/// Runs a page of `docs/` with these variables.
fn run_page(page: &str, variables: &[(&str, String)]) {
    let text = std::fs::read_to_string(root().join("docs").join(page)).expect("a page");
    // With `pipefail`, a command that `head` leaves fails now and then.
    assert!(!script(&text).contains("| head"), "docs/{page}: use `sed -n 1,3p`, which reads all lines");
    let folder = tempfile::tempdir().expect("a folder");
    for name in ["scenes", "deploy"] {
        copy(&root().join(name), &folder.path().join(name));
    }
    let femc = Path::new(env!("CARGO_BIN_EXE_femc")).parent().expect("a folder");
    let path = format!("{}:{}", femc.display(), std::env::var("PATH").unwrap_or_default());
    let ran = Command::new("timeout")
        .args(["300", "bash", "-c", &script(&text)])
        .current_dir(folder.path())
        .env("PATH", path)
        .envs(variables.iter().map(|(name, value)| (name, value)))
        .process_group(0)
        .output()
        .expect("timeout");
    let output = format!("{}\n{}", String::from_utf8_lossy(&ran.stdout), String::from_utf8_lossy(&ran.stderr));
    assert!(ran.status.success(), "docs/{page}: {}\n{output}", ran.status);
    assert!(!output.contains("panicked"), "docs/{page}\n{output}");
}

/// Defines a test for each page, and one that fails if a page has no test.
macro_rules! pages {
    ($($test:ident: $page:literal,)*) => {
        const PAGES: &[&str] = &[$($page),*];
        $(#[test]
        fn $test() {
            run_page($page, &[]);
        })*
    };
}

pages! {
    browser: "browser.md",
    clusters: "clusters.md",
    first_farm: "first-farm.md",
    two_machines: "two-machines.md",
    tls: "tls.md",
    operations: "operations.md",
    security: "security.md",
    http: "http.md",
    sweeps: "sweeps.md",
    statistics: "statistics.md",
    stylize: "stylize.md",
    troubleshooting: "troubleshooting.md",
    accuracy: "accuracy.md",
    bench: "bench.md",
    first_pass: "first-pass.md",
    two_passes: "two-passes.md",
    layers: "layers.md",
    light: "light.md",
    measure: "measure.md",
    studies: "studies.md",
    paths: "paths.md",
    formats: "formats.md",
    scenes: "scenes.md",
}

/// Runs with artifacts in a bucket under `tests/s3`, else in a folder.
#[test]
fn postgres_and_s3() {
    let Some(database) = Prerequisite::Postgres.variable_or_skip("FEMC_TEST_POSTGRES") else { return };
    let bucket = Prerequisite::S3.variable_or_skip("FEMC_TEST_S3");
    let bucket = bucket.map_or("artifacts".to_owned(), |bucket| format!("{bucket}/manual"));
    run_page("postgres-s3.md", &[("DATABASE", database), ("BUCKET", bucket)]);
}

/// Pages without commands, or whose commands other tests run (`postgres_and_s3`, `openjd`).
const OTHERS: [&str; 5] = ["README.md", "design.md", "openjd.md", "postgres-s3.md", "wire.md"];

#[test]
fn every_page_is_run() {
    for entry in std::fs::read_dir(root().join("docs")).expect("docs") {
        let name = entry.expect("an entry").file_name().to_string_lossy().into_owned();
        if name.ends_with(".md") {
            assert!(PAGES.contains(&&*name) || OTHERS.contains(&&*name), "docs/{name}: no test runs its commands");
        }
    }
}
