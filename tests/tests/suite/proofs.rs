//! Runs `tests/all` in temporary repositories with planted parts and results.
#![cfg(unix)]

use super::crates::root;
use std::fs;
use std::os::unix::fs::PermissionsExt;
use std::path::Path;
use std::process::Command;
use tempfile::TempDir;

/// A repository with `tests/all`, a folder `code`, and a program `cargo` whose tests have the result lines in the file `results/WORD`.
struct Repository {
    folder: TempDir,
    commit: String,
}

/// Exit code and output of `tests/all`.
struct Run {
    code: i32,
    output: String,
}

impl Run {
    /// Returns the first line that contains a word, or an empty line.
    fn line(&self, word: &str) -> &str {
        self.output.lines().find(|line| line.contains(word)).unwrap_or_default()
    }
}

const CARGO: &str = r#"#!/usr/bin/env bash
case "$*" in *--no-run*) exit 0 ;; esac
cat "results/${@: -1}"
"#;

const PARTS: &str = "\
# name | minutes | counts | due by | without | command
two-programs | 1 | tests | code | | suite two
no-test | 1 | tests | code | | suite none
failing-test | 1 | tests | code | | cat results/fails; exit 101
lines | 1 | lines | code | | echo '12 lines, 0 of which do not hold'
json | 1 | seeds | code | | echo '{\"seeds\":40}'; echo end
silent | 1 | lines | code | | echo nothing
uncounted | 1 | - | code | | echo 0 lines
skipping | 1 | tests | code | | echo 'skipped: no server'; suite none
lacking | 1 | tests | code | | exit 69
";

const RESULTS: [(&str, &str); 3] = [
    (
        "two",
        "test result: ok. 3 passed; 0 failed; 1 ignored\ntest result: ok. 4 passed; 0 failed; 0 ignored\n\
         test result: ok. 0 passed; 0 failed; 0 ignored\n",
    ),
    ("none", "test result: ok. 0 passed; 0 failed; 0 ignored; 0 measured; 17 filtered out\n"),
    ("fails", "test a ... FAILED\ntest result: FAILED. 1 passed; 1 failed; 0 ignored\nerror: test failed\n"),
];

const OLD_HEADER: &str = "date\tpart\tresult\twall s\tcpu s\tcommit\tmachine\tsaid";

impl Repository {
    fn new() -> Self {
        let folder = TempDir::new().expect("a folder");
        let at = folder.path();
        for made in ["tests", "code", "results", "bin"] {
            fs::create_dir(at.join(made)).expect("a folder");
        }
        for copied in ["tests/all", "tests/clock"] {
            fs::copy(root().join(copied), at.join(copied)).expect("a script");
        }
        fs::write(at.join("bin/cargo"), CARGO).expect("a program");
        fs::set_permissions(at.join("bin/cargo"), fs::Permissions::from_mode(0o755)).expect("a program");
        fs::write(at.join("tests/parts"), PARTS).expect("parts");
        fs::write(at.join("code/file"), "1").expect("a file");
        RESULTS.iter().for_each(|(name, lines)| fs::write(at.join("results").join(name), lines).expect("a result"));
        fs::write(at.join(".gitignore"), "target\n").expect("a file");
        git(at, &["init", "--quiet"]);
        let mut made = Self { folder, commit: String::new() };
        made.commit();
        made
    }

    fn commit(&mut self) {
        let at = self.folder.path();
        git(at, &["add", "--all"]);
        git(at, &["commit", "--quiet", "--allow-empty", "--message", "change"]);
        self.commit = git(at, &["rev-parse", "HEAD"]);
    }

    /// Writes results. Each is `DATE PART RESULT COMMIT RAN`, without RAN for a line of an older version.
    fn with_results(lines: &[&str]) -> Self {
        let made = Self::new();
        let mut text = format!("{OLD_HEADER}\n");
        for line in lines {
            let mut words = line.splitn(5, ' ');
            let [date, part, result, commit] = std::array::from_fn(|_| words.next().expect("a word"));
            let commit = if commit == "HEAD" { &made.commit } else { commit };
            text += &format!("2026-11-{date}T10:00\t{part}\t{result}\t1\t1\t{commit}\ta machine\tlast line");
            text += &words.next().map(|ran| format!("\t{ran}")).unwrap_or_default();
            text.push('\n');
        }
        fs::write(made.folder.path().join("tests/proofs.tsv"), text).expect("results");
        made
    }

    fn run(&self, arguments: &[&str]) -> Run {
        let at = self.folder.path();
        let path = format!("{}:{}", at.join("bin").display(), std::env::var("PATH").expect("PATH"));
        let mut script = Command::new("bash");
        script.arg("tests/all").args(arguments).current_dir(at).env("PATH", path).env("CARGO_TARGET_DIR", "target");
        let ran = without_git_variables(script.env_remove("FEMC_PROOFS")).output().expect("bash");
        let output = [ran.stdout, ran.stderr].concat();
        Run { code: ran.status.code().expect("an exit code"), output: String::from_utf8(output).expect("text") }
    }

    /// Returns part, result, last line of the output, and count of each appended line.
    fn appended(&self) -> Vec<[String; 4]> {
        let text = fs::read_to_string(self.folder.path().join("tests/proofs.tsv")).expect("results");
        let cells = |line: &str| {
            let cells: Vec<&str> = line.split('\t').collect();
            assert_eq!(cells.len(), 9, "{line}");
            [1, 2, 7, 8].map(|at| cells[at].to_owned())
        };
        text.lines().filter(|line| line.split('\t').count() > 8 && !line.starts_with("date")).map(cells).collect()
    }
}

fn without_git_variables(command: &mut Command) -> &mut Command {
    ["GIT_DIR", "GIT_WORK_TREE", "GIT_INDEX_FILE"].iter().fold(command, |command, name| command.env_remove(name))
}

fn git(folder: &Path, arguments: &[&str]) -> String {
    let mut command = Command::new("git");
    command.args(["-c", "user.name=test", "-c", "user.email=test@localhost", "-c", "commit.gpgsign=false"]);
    let ran = without_git_variables(command.args(arguments).current_dir(folder)).output().expect("git");
    assert!(ran.status.success(), "git {arguments:?}: {}", String::from_utf8_lossy(&ran.stderr));
    String::from_utf8(ran.stdout).expect("text").trim().to_owned()
}

#[test]
fn a_line_counts_what_ran_and_a_part_that_ran_nothing_fails() {
    let repository = Repository::with_results(&["24 two-programs passed HEAD"]);
    let run = repository.run(&[]);
    assert_eq!(run.code, 1, "{}", run.output);
    let all_ignored = "test result: ok. 4 passed; 0 failed; 0 ignored";
    let expected = [
        ["two-programs", "passed", all_ignored, "7 tests"],
        ["no-test", "FAILED", "", "0 tests"],
        ["failing-test", "FAILED", "error: test failed", "2 tests"],
        ["lines", "passed", "12 lines, 0 of which do not hold", "12 lines"],
        ["json", "passed", "end", "40 seeds"],
        ["silent", "FAILED", "nothing", "0 lines"],
        ["uncounted", "passed", "0 lines", "-"],
        ["skipping", "skipped", "skipped: no server", "0 tests"],
        ["lacking", "skipped", "", "0 tests"],
    ];
    assert_eq!(repository.appended(), expected);
    let text = fs::read_to_string(repository.folder.path().join("tests/proofs.tsv")).expect("results");
    assert!(text.starts_with(&format!("{OLD_HEADER}\tran\n")), "{text}");
    let check = repository.run(&["--check"]);
    assert_eq!(check.code, 1);
    let states = |state: &str| check.output.lines().filter(|line| line.starts_with(state)).count();
    assert_eq!([states("FAILED"), states("due")], [3, 2], "{}", check.output);
}

#[test]
fn a_failed_line_fails_the_check_until_the_part_passes() {
    let failed = "25 lines FAILED HEAD 3 lines";
    let check = Repository::with_results(&["24 lines passed HEAD 12 lines", failed]).run(&["--check"]);
    assert_eq!(check.code, 1, "{}", check.output);
    assert!(check.line("lines").starts_with("FAILED"), "{}", check.output);
    // The order is that of the dates: a merge may mix the lines.
    for later in [["26 lines passed HEAD 12 lines", failed], [failed, "26 lines passed HEAD 12 lines"]] {
        let check = Repository::with_results(&later).run(&["--check"]);
        assert_eq!((check.code, check.line("lines ")), (0, ""), "{}", check.output);
    }
    for other in ["26 lines passed changed 12 lines", "26 lines skipped HEAD 0 lines"] {
        let check = Repository::with_results(&[failed, other]).run(&["--check"]);
        assert_eq!(check.code, 1, "{other} does not replace the failure: {}", check.output);
    }
    let check = Repository::with_results(&["25 lines FAILED changed 3 lines"]).run(&["--check"]);
    assert_eq!(check.code, 0, "{}", check.output);
    assert!(check.line("lines ").starts_with("due"), "{}", check.output);
}

#[test]
fn a_line_without_a_test_fails_the_check() {
    let check = Repository::with_results(&["25 no-test passed HEAD 0 tests"]).run(&["--check"]);
    assert_eq!(check.code, 1, "{}", check.output);
    assert!(check.line("no-test").starts_with("FAILED"), "{}", check.output);
}

#[test]
fn a_line_of_an_older_version_makes_its_part_due() {
    let repository = Repository::with_results(&["24 two-programs passed HEAD", "25 lines FAILED HEAD"]);
    let check = repository.run(&["--check"]);
    assert_eq!(check.code, 0, "{}", check.output);
    assert_eq!(check.output.lines().filter(|line| line.starts_with("due")).count(), 9, "{}", check.output);
    let list = repository.run(&["--list"]);
    assert!(list.line("lines ").contains("due    2026-11-25T10:00 FAILED, which does not count"), "{}", list.output);
    assert!(list.line("json").contains("never run"), "{}", list.output);
    assert!(repository.run(&["--dry-run"]).output.starts_with("9 parts"));
}

#[test]
fn a_change_of_the_tested_files_makes_a_passed_part_due() {
    let mut repository = Repository::with_results(&["25 lines passed HEAD 12 lines"]);
    repository.commit();
    assert!(repository.run(&["--list"]).line("lines ").contains("passed 2026-11-25T10:00 passed, 12 lines"));
    fs::write(repository.folder.path().join("code/file"), "2").expect("a file");
    repository.commit();
    let check = repository.run(&["--check"]);
    assert_eq!(check.code, 0, "{}", check.output);
    assert!(check.line("lines ").starts_with("due"), "{}", check.output);
}
