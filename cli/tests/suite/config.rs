//! Tests of the precedence of settings: flag, environment, file, default.

use crate::common::{CommandOutput, TestFolder};
use std::process::Command;

const FILE: &str = "\
server = \"http://file:1\"
[coordinator]
lease = \"10s\"
compact = 77
share = [\"ann=3\", \"bob=2\"]
insecure = true
[worker]
join = \"http://file:2\"
tags = [\"a\", \"b\"]
";

/// Returns the output of `femc LINE --print-config` with this environment.
fn print_config(dir: &TestFolder, line: &str, environment: &[(&str, &str)]) -> String {
    let mut command: Command = dir.command(&format!("{line} --print-config"));
    let output = command.envs(environment.iter().copied()).output().expect("femc starts");
    assert!(output.status.success(), "{line}: {}", String::from_utf8_lossy(&output.stderr));
    String::from_utf8_lossy(&output.stdout).into_owned()
}

#[test]
fn flags_override_environment_then_file_then_default() {
    let dir = TestFolder::new();
    dir.write("femc.toml", FILE);
    let lease = [("FEMC_LEASE", "20s")];
    for (line, environment, expected) in [
        ("coordinator --lease 30s", &lease[..], "lease = \"30s\"  # flag"),
        ("coordinator", &lease[..], "lease = \"20s\"  # FEMC_LEASE"),
        ("coordinator", &[], "lease = \"10s\"  # femc.toml:3:1"),
        ("coordinator --config other.toml", &[], "lease = \"4.5s\"  # default"),
        ("coordinator", &[("FEMC_CONFIG", "other.toml")], "lease = \"4.5s\"  # default"),
        ("coordinator", &[], "compact = 77  # femc.toml:4:1"),
        ("coordinator", &[], "share = [\"ann=3\", \"bob=2\"]  # femc.toml:5:1"),
        ("coordinator --share eve=9", &[], "share = [\"eve=9\"]  # flag"),
        ("coordinator", &[], "insecure = true  # femc.toml:6:1"),
        ("coordinator", &[("FEMC_INSECURE", "false")], "insecure = false  # FEMC_INSECURE"),
        ("coordinator", &[], "# keep-ended is not set"),
        ("coordinator", &[("FEMC_KEEP_ENDED", "30d")], "keep-ended = \"30d\"  # FEMC_KEEP_ENDED"),
        ("coordinator", &[("FEMC_STORE", "postgres://a:b@c/d")], "store = \"postgres://a:***@c/d\"  # FEMC_STORE"),
        ("worker", &[], "join = \"http://file:2\"  # femc.toml:8:1"),
        ("worker", &[("FEMC_SERVER", "http://env:3")], "join = \"http://env:3\"  # FEMC_SERVER"),
        ("worker", &[], "tags = [\"a\", \"b\"]  # femc.toml:9:1"),
        ("jobs", &[], "server = \"http://file:1\"  # femc.toml:1:1"),
        ("jobs --server http://flag:4", &[("FEMC_SERVER", "http://env:3")], "server = \"http://flag:4\"  # flag"),
        ("", &[], "compact = 77  # femc.toml:4:1"),
        ("", &[], "[worker]"),
        ("render", &[], "log-format = \"text\"  # default"),
    ] {
        dir.write("other.toml", "");
        let text = print_config(&dir, line, environment);
        assert!(text.lines().any(|line| line == expected), "{line} {environment:?}: {expected}\n{text}");
    }
}

#[test]
fn what_is_printed_can_be_kept_as_a_file() {
    let dir = TestFolder::new();
    dir.write("femc.toml", FILE);
    let values = |text: &str| -> Vec<String> {
        let lines = text.lines().filter(|line| !line.starts_with('#'));
        lines.map(|line| line.split("  # ").next().unwrap_or_default().to_owned()).collect()
    };
    let first = print_config(&dir, "", &[]);
    dir.write("again.toml", &first);
    assert_eq!(values(&print_config(&dir, "--config again.toml", &[])), values(&first));
}

#[test]
fn a_setting_of_the_file_holds() {
    let dir = TestFolder::new();
    dir.write("femc.toml", "server = \"http://127.0.0.1:1\"\n");
    let ran = dir.run("jobs").exits(4);
    assert!(ran.stderr().contains("http://127.0.0.1:1"), "{}", ran.stderr());
}

#[test]
fn a_fault_of_the_file_is_told_with_its_place() {
    let dir = TestFolder::new();
    for (text, said) in [
        ("[coordinator]\n  leese = \"3s\"\n", "femc.toml:2:3: unknown key leese"),
        ("sparkle = 1\n", "femc.toml:1:1: unknown key sparkle"),
        ("\n[renderer]\n", "femc.toml:2:2: unknown table [renderer]"),
        ("coordinator = 3\n", "femc.toml:1:1: coordinator must be a table"),
        ("[coordinator]\nlease = \"forever\"\n", "femc.toml:2:9: invalid value 'forever' for '--lease"),
        ("[coordinator]\nlease = [\"3s\", \"4s\"]\n", "femc.toml:2:9: lease takes one value"),
        ("[coordinator]\ninsecure = 3\n", "femc.toml:2:12: insecure must be true or false"),
        ("[worker]\nnice = 99\n", "femc.toml:2:8: invalid value '99' for '--nice"),
        ("[worker]\nnice = {}\n", "femc.toml:2:8: give a string"),
        ("[worker\n", "femc.toml:1:"),
        ("color = \"mauve\"\n", "femc.toml:1:9: invalid value 'mauve' for '--color"),
    ] {
        dir.write("femc.toml", text);
        let ran: CommandOutput = dir.run("coordinator --print-config").exits(2);
        assert!(ran.stderr().contains(said), "{text}: {}", ran.stderr());
    }
    let ran = dir.run("--config nowhere.toml jobs").exits(1);
    assert!(ran.stderr().contains("--config nowhere.toml"), "{}", ran.stderr());
}
