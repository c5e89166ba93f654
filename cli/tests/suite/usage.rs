//! Tests of exit codes and messages for wrong usage.

use crate::common;
use crate::common::TestFolder;

#[test]
fn wrong_usage_ends_with_2_and_names_the_flag() {
    let dir = TestFolder::new();
    for (line, said) in [
        ("render", "<SCENE>"),
        ("render fog.mgf --spq 4", "--spq"),
        ("render fog.mgf --spp 0", "--spp"),
        ("render fog.mgf --spp 4 --error 0.1", "--error"),
        ("render fog.mgf --error 0", "--error"),
        ("render fog.mgf --size 32", "--size"),
        ("render fog.mgf --frames 5..2", "--frames"),
        ("render fog.mgf --time soon", "--time"),
        ("render fog.mgf --method magic", "--method"),
        ("render fog.mgf --filter sinc", "--filter"),
        ("render fog.mgf --set fog", "--set"),
        ("render fog.mgf --threads 0", "--threads"),
        ("worker --join http://127.0.0.1:1 --nice 20", "--nice"),
        ("worker --join http://127.0.0.1:1 --memory lots", "--memory"),
        ("worker --join http://127.0.0.1:1 --memory 0", "at least 1MiB"),
        ("worker --join http://127.0.0.1:1 --hours evenings", "--hours"),
        ("worker --join http://127.0.0.1:1 --idle-exit never", "--idle-exit"),
        ("stylize fog.mgf", "stylize"),
    ] {
        let ran = dir.run(line).exits(2);
        assert!(ran.stderr().contains(said), "{line}: {}", ran.stderr());
        assert_eq!(ran.stdout(), "", "{line}: errors go to stderr");
    }
}

#[test]
fn scene_dependent_usage_errors_exit_with_2_and_render_nothing() {
    let dir = TestFolder::new();
    for (line, said) in [
        ("render nothing.mgf -o out --spp 1", "nothing.mgf"),
        ("render fog.mgf -o out --spp 1 --camera side", "main"),
        ("render fog.mgf -o out --spp 1 --frames 9", "1..8"),
        ("render fog.mgf -o out.exr --spp 1 --frames 1..2", "out.exr"),
        ("render fog.mgf -o out --spp 1 --set medium.frog.sigma_s=1", "medium.fog.sigma_s"),
        ("render fog.mgf -o out --spp 1 --set medium.fog.sigma_s=-1", "medium.fog.sigma_s"),
        ("plan fog.mgf --camera side", "main"),
    ] {
        let ran = dir.run(line).exits(2);
        assert!(ran.stderr().contains(said), "{line}: {}", ran.stderr());
    }
    assert_eq!(common::file_names(&dir.path(".")), ["fog.mgf"]);
}

#[test]
fn a_broken_scene_fails_with_its_file_and_line() {
    let dir = TestFolder::new();
    dir.write("broken.mgf", "m wall =\n\trd 1.5\n");
    for command in ["render", "plan"] {
        let ran = dir.run(&format!("{command} broken.mgf")).exits(1);
        assert!(ran.stderr().contains("broken.mgf:2"), "{command}: {}", ran.stderr());
    }
    // The list of errors is the result of `check`, regardless of which part of femc finds them.
    let ran = dir.run("check broken.mgf").exits(1);
    assert!(ran.stdout().contains("broken.mgf:2:5: error: ") && ran.stderr().is_empty(), "{}", ran.stdout());
    dir.write("lost.mgf", &common::FOG.replace("vary medium.fog", "vary medium.frog"));
    let ran = dir.run("render lost.mgf").exits(1);
    assert!(ran.stderr().contains("lost.mgf:2") && ran.stderr().contains("medium.fog.sigma_s"), "{}", ran.stderr());
}

#[test]
fn default_camera_gets_a_note_and_an_empty_scene_is_refused() {
    let dir = TestFolder::new();
    dir.write("blind.mgf", "m lamp =\n\ted 1\nv a =\n\tp 0 0 0\nsph a 1\n");
    let ran = dir.run("render blind.mgf --spp 1 --size 4x3 -o blind.exr").exits(0);
    let note = "note: blind.mgf: the scene has no camera: `default` looks from outside";
    assert!(ran.stderr().contains(note) && ran.stderr().contains("camera NAME ="), "{}", ran.stderr());
    dir.run("render blind.mgf --spp 1 --camera default --set camera.default.fov=30 --size 4x3 -o a.exr").exits(0);
    dir.write("empty.mgf", "m lamp =\n\ted 1\n");
    let ran = dir.run("render empty.mgf --spp 1").exits(1);
    assert!(ran.stderr().contains("camera"), "{}", ran.stderr());
    assert_eq!(common::file_names(&dir.path(".")), ["a.exr", "blind.exr", "blind.mgf", "empty.mgf", "fog.mgf"]);
}

#[test]
fn an_absent_server_ends_with_4_and_its_address() {
    let dir = TestFolder::new();
    // Port 1 is reserved, and no server listens there.
    for command in ["jobs", "status 1", "watch 1", "fetch 1 -o out", "submit fog.mgf --spp 1"] {
        let ran = dir.run(&format!("{command} --server http://127.0.0.1:1")).exits(4);
        assert!(ran.stderr().contains("http://127.0.0.1:1"), "{command}: {}", ran.stderr());
    }
    let ran = dir.command("jobs").env("FEMC_SERVER", "http://127.0.0.1:2").output().expect("femc starts");
    assert_eq!(ran.status.code(), Some(4));
    assert!(String::from_utf8_lossy(&ran.stderr).contains("http://127.0.0.1:2"));
}

#[test]
fn every_command_explains_itself_with_an_example() {
    let dir = TestFolder::new();
    let help = dir.run("--help").exits(0).stdout();
    let commands: Vec<&str> = help
        .lines()
        .skip_while(|line| !line.starts_with("Commands:"))
        .skip(1)
        .take_while(|line| line.starts_with("  "))
        .filter_map(|line| line.strip_prefix("  ").filter(|rest| !rest.starts_with(' ')))
        .filter_map(|line| line.split_whitespace().next())
        .filter(|&name| name != "help")
        .collect();
    assert!(commands.contains(&"render") && commands.contains(&"fetch"), "{help}");
    for command in commands {
        let help = dir.run(&format!("{command} --help")).exits(0).stdout();
        assert!(help.contains("Examples:") && help.contains(&format!("femc {command}")), "{command}: {help}");
    }
}

#[test]
fn a_job_file_with_a_fault_is_refused_at_its_line() {
    let dir = TestFolder::new();
    dir.write("job.toml", "scene = \"fog.mgf\"\nsparkle = 4\n");
    let ran = dir.run("submit job.toml --server http://127.0.0.1:1").exits(2);
    assert!(ran.stderr().contains("job.toml:2:1") && ran.stderr().contains("sparkle"), "{}", ran.stderr());
}

#[test]
fn completions_come_for_the_usual_shells() {
    let dir = TestFolder::new();
    for shell in ["bash", "zsh", "fish"] {
        let script = dir.run(&format!("completions {shell}")).exits(0).stdout();
        assert!(script.contains("femc") && script.contains("max-depth"), "{shell}");
    }
}
