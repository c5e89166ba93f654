//! Runs tests with and without their prerequisites in separate processes, because environment variables are fixed per process.

use femc_require::Prerequisite;
use std::process::Command;

/// Variable that makes the prerequisite available in the process under test.
const PREREQUISITE: &str = "FEMC_REQUIRE_TEST_THING";

/// Needs S3, which is available if [`PREREQUISITE`] is set. Only [`run`] runs this test.
#[test]
#[ignore = "a test that the others run in a process of its own"]
fn needy() {
    if Prerequisite::S3.variable_or_skip(PREREQUISITE).is_some() {
        println!("it runs");
    }
}

/// Runs `needy`. Returns whether it passes, and its output.
fn run(required: &str, thing: Option<&str>) -> (bool, String) {
    let mut command = Command::new(std::env::current_exe().expect("this program"));
    command.args(["--exact", "needy", "--ignored", "--nocapture"]);
    command
        .env(femc_require::VARIABLE, required)
        .env_remove(PREREQUISITE)
        .envs(thing.map(|value| (PREREQUISITE, value)));
    let ran = command.output().expect("a process");
    let output = [ran.stdout, ran.stderr].map(|bytes| String::from_utf8_lossy(&bytes).into_owned());
    (ran.status.success(), output.concat())
}

#[test]
fn a_test_without_its_need_is_skipped_with_a_line() {
    for required in ["", "postgres,python,refs"] {
        let (passes, output) = run(required, None);
        assert!(
            passes && output.contains(&format!("skipped: {PREREQUISITE} is not set (tests/s3 sets it)")),
            "{output}"
        );
    }
}

#[test]
fn test_without_required_need_fails_naming_need_and_requester() {
    let (passes, output) = run("refs,s3", None);
    assert!(!passes && output.contains(&format!("FEMC_REQUIRE asks for s3: {PREREQUISITE} is not set")), "{output}");
    assert!(!output.contains("skipped"), "{output}");
}

#[test]
fn a_test_with_its_need_runs() {
    for required in ["", "s3"] {
        let (passes, output) = run(required, Some("here"));
        assert!(passes && output.contains("it runs") && !output.contains("skipped"), "{output}");
    }
}

#[test]
fn an_unknown_word_fails_also_the_test_that_has_its_need() {
    for thing in [None, Some("here")] {
        let (passes, output) = run("s3,postgress", thing);
        assert!(
            !passes && output.contains("names `postgress`, which is none of postgres, s3, python, refs"),
            "{output}"
        );
    }
}
