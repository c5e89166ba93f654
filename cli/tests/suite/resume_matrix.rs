//! The law of commands that resume: a run that is broken off with some arguments and continued with others has the results of a fresh
//! run with these.
//!
//! For each argument that decides results, a run with its first value is broken off and continued with its second value. A fresh run
//! with the second value must have the same files. A sweep also continues after a complete first run, and a bench refuses to continue
//! or has the measurements of a fresh one. The arguments come from `femc COMMAND --help`, so each new argument must be
//! added to a table here. Likewise, a worker that renders jobs with both values in turn has the results of a worker for each.

use crate::common::{FOG, TestFolder, file_names, start_coordinator};
use femc_film::exr::Channels;
use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Duration;

/// Arguments of all commands that decide no result.
const SHOWN: &[&str] =
    &["--quiet", "--verbose", "--color", "--log-format", "--config", "--print-config", "--help", "--json"];

/// Cases of a command.
struct Matrix {
    /// Command, with arguments of all runs.
    command: &'static str,
    /// More arguments of all runs. An argument of a case replaces the same argument here.
    base: &'static [&'static str],
    cases: &'static [Case],
    /// Arguments that decide no result: places of the results, what is shown, and what runs elsewhere.
    inert: &'static [&'static str],
    /// Output of a run in which a new file shows that the run has begun.
    begun: &'static str,
}

/// An argument, and the arguments of the run that is broken off and of the run that continues.
struct Case {
    argument: &'static str,
    first: &'static str,
    second: &'static str,
    /// Arguments of the base that exclude this one.
    without: &'static [&'static str],
}

const fn case(argument: &'static str, first: &'static str, second: &'static str) -> Case {
    Case { argument, first, second, without: &[] }
}

const RENDER: Matrix = Matrix {
    command: "render room.mgf",
    base: &["--frames 1..2", "--size 24x24", "--spp 16", "--method pt", "--preview"],
    cases: &[
        case("--exposure", "--exposure 5", "--exposure 9"),
        Case {
            without: &["--frames", "--size", "--spp", "--method"],
            ..case("--replay", "--replay one.exr", "--replay two.exr")
        },
        case("--video", "", "--video clip.png"),
        case("--preview", "", "--preview --layers direct"),
        case("--contact-sheet", "", "--contact-sheet sheet.png"),
        case("--camera", "--camera main", "--camera side"),
        case("--size", "--size 24x24", "--size 32x24"),
        case("--frames", "--frames 1..2", "--frames 2..3"),
        case("--spp", "--spp 16", "--spp 24"),
        Case { without: &["--spp"], ..case("--error", "--error 0.4", "--error 0.1") },
        case("--method", "--method pt", "--method femc"),
        Case {
            without: &["--method"],
            ..case("--guide", "--method femc --guide targets", "--method femc --guide 1998")
        },
        case("--max-depth", "--max-depth 2", "--max-depth 3"),
        case("--filter", "--filter box", "--filter gaussian"),
        case("--seed", "--seed 1", "--seed 2"),
        case("--workers", "--workers 1", "--workers 2"),
        case("--threads", "--threads 1", "--threads 2"),
        case("--set", "--set material.lamp.ed=300", "--set material.lamp.ed=200"),
        case("--stats", "--stats=some", "--stats=full"),
        case("--layer", "--layer direct=CDL", "--layer direct=CD*L"),
        case("--layers", "--layers direct", "--layers direct,indirect"),
        case("--style", "--style oil", "--style cel"),
        case("--boil", "--style oil --boil 0", "--style oil --boil 0.9"),
        case(
            "--style-source",
            "--style one.png --style-source one.layers.exr",
            "--style one.png --style-source two.layers.exr",
        ),
        case("--measure", "--measure few.toml", "--measure more.toml"),
    ],
    // The samples of a time budget depend on the clock, so no two runs are alike. `--measure-only` is refused.
    inert: &["--out", "--report", "--fresh", "--watch", "--root", "--time", "--measure-only"],
    begun: "room.0001.exr",
};

const SWEEP: Matrix = Matrix {
    command: "sweep job.toml --local",
    base: &["--frames 1..2", "--size 16x16", "--spp 16", "--method pt"],
    cases: &[
        case("--camera", "--camera main", "--camera side"),
        case("--size", "--size 16x16", "--size 24x16"),
        case("--frames", "--frames 1..2", "--frames 2..3"),
        case("--spp", "--spp 16", "--spp 24"),
        Case { without: &["--spp"], ..case("--error", "--error 0.4", "--error 0.1") },
        case("--method", "--method pt", "--method femc"),
        Case {
            without: &["--method"],
            ..case("--guide", "--method femc --guide targets", "--method femc --guide 1998")
        },
        case("--max-depth", "--max-depth 2", "--max-depth 3"),
        case("--filter", "--filter box", "--filter gaussian"),
        case("--seed", "--seed 1", "--seed 2"),
        case("--workers", "--workers 1", "--workers 2"),
        case("--threads", "--threads 1", "--threads 2"),
        case("--set", "--set camera.main.fov=30", "--set camera.main.fov=50"),
        case("--stats", "--stats=some", "--stats=full"),
        case("--layer", "--layer direct=CDL", "--layer direct=CD*L"),
        case("--layers", "--layers direct", "--layers direct,indirect"),
        case("--measure", "--measure few.toml", "--measure more.toml"),
        case("--measure-only", "--measure few.toml", "--measure few.toml --measure-only"),
    ],
    inert: &[
        "--out",
        "--detach",
        "--local",
        "--priority",
        "--owner",
        "--comment",
        "--label",
        "--notify",
        "--server",
        "--identity",
        "--token-file",
        "--root",
        "--time",
    ],
    begun: "ed=100/room.0001.exr",
};

const STYLIZE: Matrix = Matrix {
    command: "stylize",
    base: &[
        "--style one.png",
        "--source one.layers.exr",
        "--target t-1.exr --target t-2.exr",
        "--iterations 2",
        "--levels 2",
    ],
    cases: &[
        case("--style", "--style one.png", "--style two.png"),
        case("--source", "--source one.layers.exr", "--source two.layers.exr"),
        case("--target", "--target t-1.exr --target t-2.exr", "--target t-2.exr --target t-1.exr"),
        case("--guides", "--guides full", "--guides full,direct_diffuse"),
        case("--exposure", "--exposure 5", "--exposure 9"),
        case("--method", "--method balanced", "--method em"),
        case("--mu", "--mu 1", "--mu 5"),
        case("--balance", "--balance 1", "--balance 40"),
        case("--boil", "--boil 0", "--boil 0.9"),
        case("--patch", "--patch 3", "--patch 5"),
        case("--levels", "--levels 2", "--levels 1"),
        case("--iterations", "--iterations 2", "--iterations 3"),
        case("--threads", "--threads 1", "--threads 2"),
    ],
    inert: &["--out"],
    begun: ".part",
};

/// Like the others, with a file of measurements instead of a folder of results. `one` and `two` are references.
const BENCH: Matrix = Matrix {
    command: "bench room.mgf --json",
    base: &[
        "--reference one.exr",
        "--methods pt,adaptive",
        "--spp 2,4",
        "--error 0.8",
        "--seeds 2",
        "--size 32x32",
        "--threads 1",
    ],
    cases: &[
        case("--reference", "--reference one.exr", "--reference two.exr"),
        case("--methods", "--methods pt", "--methods femc"),
        case("--spp", "--spp 2,4", "--spp 3,4"),
        case("--error", "--error 0.8", "--error 0.4"),
        case("--seeds", "--seeds 1", "--seeds 2"),
        case("--seed", "--seed 1", "--seed 2"),
        case("--camera", "--camera main", "--camera side"),
        case("--size", "--size 32x32", "--size 24x32 --reference small.exr"),
        case("--frames", "--frames 1", "--frames 3"),
        case("--max-depth", "--max-depth 2", "--max-depth 3"),
        case("--filter", "--filter box", "--filter gaussian"),
        case("--threads", "--threads 1", "--threads 2"),
        case("--set", "--set material.lamp.ed=300", "--set material.lamp.ed=200"),
    ],
    // Parts of variances are printed, but not kept.
    inert: &["--out", "--report", "--root", "--decisions"],
    begun: ".json",
};

/// Folder with a scene of two cameras, a sweep of it, and frames with layers.
fn test_folder() -> TestFolder {
    let dir = TestFolder::new();
    let side = "camera side =\n\torigin 0.5 -3 1.4\n\ttarget 0 0 1\n\tfov 40\n\tfilm 32 32\nmedium fog =";
    dir.write("room.mgf", &FOG.replacen("medium fog =", side, 1));
    for (name, points) in [("few", "[0, 0, 1]"), ("more", "[0, 0, 1], [0.5, 0, 1]")] {
        dir.write(&format!("{name}.toml"), &format!("spp = 64\n[[points]]\nname = \"a\"\nat = [{points}]\n"));
    }
    dir.write("job.toml", "scene = \"room.mgf\"\n[sweep]\n\"material.lamp.ed\" = [100, 300]\n");
    for (name, seed, frame) in [("one", 5, 1), ("two", 6, 4), ("t-1", 7, 2), ("t-2", 8, 6)] {
        let settings = "--size 32x32 --spp 8 --method pt --preview --layers guides,motion,depth";
        dir.run(&format!("render room.mgf -o {name}.exr --frames {frame} --seed {seed} {settings}")).exits(0);
    }
    dir.run("render room.mgf -o small.exr --frames 1 --size 24x32 --spp 8 --method pt").exits(0);
    for name in ["t-1", "t-2"] {
        std::fs::rename(dir.path(&format!("{name}.layers.exr")), dir.path(&format!("{name}.exr"))).expect("renamed");
    }
    dir
}

/// Returns the names of the arguments in a command's help.
fn arguments(dir: &TestFolder, command: &str) -> BTreeSet<String> {
    let help = dir.run(&format!("{command} --help")).exits(0).stdout();
    let lines = help.lines().map(str::trim_start).filter(|line| line.starts_with('-'));
    let name = |line: &str| {
        let from = line.find("--")?;
        let rest = &line[from + 2..];
        let end = rest.find(|c: char| !c.is_ascii_alphanumeric() && c != '-').unwrap_or(rest.len());
        (end > 0).then(|| format!("--{}", &rest[..end]))
    };
    lines.filter_map(name).collect()
}

/// Returns the command line of a run.
fn line(matrix: &Matrix, case: &Case, arguments: &str, out: &str) -> String {
    let replaced = |own: &&&str| {
        let flag = own.split(' ').next().expect("a flag");
        !(arguments.split(' ').any(|word| word == flag) || case.argument == flag || case.without.contains(&flag))
    };
    let base: Vec<&str> = matrix.base.iter().filter(replaced).copied().collect();
    format!("{} {} {arguments} -o {out}", matrix.command, base.join(" "))
}

/// Returns the digests of the results in a folder, by name.
fn results(folder: &Path) -> BTreeMap<String, blake3::Hash> {
    let mut out = BTreeMap::new();
    add_results(folder, "", &mut out);
    out
}

/// Adds the digest of a whole file.
fn add_file(out: &mut BTreeMap<String, blake3::Hash>, name: String, path: &Path) {
    out.insert(name, blake3::hash(&std::fs::read(path).expect("a file")));
}

/// Adds the digests of the results in a folder, with `at` before their names. Of an EXR file these are the channels, because its attributes have times.
/// Tables have times, too, and are left out.
fn add_results(folder: &Path, at: &str, out: &mut BTreeMap<String, blake3::Hash>) {
    for name in file_names(folder) {
        let path = folder.join(&name);
        let name = format!("{at}{name}");
        match path.extension().and_then(|extension| extension.to_str()) {
            _ if path.is_dir() => add_results(&path, &format!("{name}/"), out),
            Some("exr") => {
                let channels = format!("{:?}", Channels::read(&path).expect("an EXR file"));
                out.insert(name, blake3::hash(channels.as_bytes()));
            }
            Some("png" | "paths") => add_file(out, name, &path),
            Some("json") if name.ends_with(".readings.json") => add_file(out, name, &path),
            _ => {}
        }
    }
}

/// Checks that a table has all arguments of its command. Returns the command's name.
fn check_arguments(dir: &TestFolder, matrix: &Matrix) -> &'static str {
    let name = matrix.command.split(' ').next().expect("a command");
    let decisive = matrix.cases.iter().map(|case| case.argument);
    let known = decisive.chain(matrix.inert.iter().chain(SHOWN).copied()).map(str::to_owned).collect();
    assert_eq!(arguments(dir, name), known, "the arguments of `femc {name}` and of its table");
    name
}

/// Calls a function for all cases of a table, several at a time: most of a run's time is waiting.
fn for_each_case(matrix: &Matrix, check: impl Fn(usize, &Case) + Sync) {
    const LANES: usize = 4;
    let next = AtomicUsize::new(0);
    let lane = || {
        while let Some(case) = Some(next.fetch_add(1, Ordering::Relaxed)).filter(|at| *at < matrix.cases.len()) {
            check(case, &matrix.cases[case]);
        }
    };
    std::thread::scope(|scope| (0..LANES).for_each(|_| drop(scope.spawn(lane))));
}

/// Checks all cases of a command, each in folders of its own. Prints how many runs were broken off before their end.
fn check(matrix: &Matrix) {
    let dir = test_folder();
    let name = check_arguments(&dir, matrix);
    let cut = AtomicUsize::new(0);
    for_each_case(matrix, |number, case| {
        let is_cut = check_case(&dir, matrix, number, case, FirstRun::BrokenOff);
        cut.fetch_add(usize::from(is_cut), Ordering::Relaxed);
    });
    let cut = cut.into_inner();
    println!("{name}: {cut} of {} runs were broken off", matrix.cases.len());
    assert!(2 * cut > matrix.cases.len(), "most runs end before they are broken off");
}

/// End of the run before the one that continues.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum FirstRun {
    BrokenOff,
    Complete,
}

/// Checks a case in folders with its number. Returns whether the first run was broken off before its end.
fn check_case(dir: &TestFolder, matrix: &Matrix, number: usize, case: &Case, first_run: FirstRun) -> bool {
    let [broken, fresh] = ["broken", "fresh"].map(|run| format!("{run}-{number}-{first_run:?}"));
    // A file of all frames goes into the folder of the run.
    let places = |words: &str, folder: &str| {
        words.replace("clip.png", &format!("{folder}/clip.png")).replace("sheet.png", &format!("{folder}/sheet.png"))
    };
    let begun = if matrix.begun.starts_with('.') {
        format!("{broken}{}", matrix.begun)
    } else {
        format!("{broken}/{}", matrix.begun)
    };
    let out = |folder: &str| format!("{folder}/");
    let mut run = dir.start_as(&broken, &line(matrix, case, &places(case.first, &broken), &out(&broken)));
    while run.is_running() && !dir.path(&begun).exists() {
        std::thread::sleep(Duration::from_millis(1));
    }
    let is_cut = match first_run {
        FirstRun::BrokenOff => run.is_running() && run.kill(),
        FirstRun::Complete => {
            run.end().exits(0);
            false
        }
    };
    dir.run(&line(matrix, case, &places(case.second, &broken), &out(&broken))).exits(0);
    dir.run(&line(matrix, case, &places(case.second, &fresh), &out(&fresh))).exits(0);
    let [found, expected] = [&broken, &fresh].map(|folder| results(&dir.path(folder)));
    assert!(!expected.is_empty(), "{}: no results", case.argument);
    for (file, hash) in expected {
        let Case { argument, first, second, .. } = case;
        assert_eq!(found.get(&file), Some(&hash), "{argument}: {file} after `{first}`, {first_run:?}, and `{second}`");
    }
    is_cut
}

#[test]
fn a_render_goes_on_only_with_the_same_arguments() {
    check(&RENDER);
}

#[test]
fn a_sweep_goes_on_only_with_the_same_arguments() {
    check(&SWEEP);
    // A sweep notes its frames from time to time, and at its end.
    let dir = test_folder();
    for_each_case(&SWEEP, |number, case| {
        check_case(&dir, &SWEEP, number, case, FirstRun::Complete);
    });
}

#[test]
fn a_painting_goes_on_only_with_the_same_arguments() {
    check(&STYLIZE);
}

/// Returns the measured errors and samples of runs, by scene, method, budget and seed.
fn measurements(document: &serde_json::Value) -> BTreeMap<String, String> {
    let join = |run: &serde_json::Value, keys: [&str; 4]| keys.map(|key| run[key].to_string()).join(" ");
    let runs = document["runs"].as_array().expect("runs").iter();
    runs.map(|run| (join(run, ["scene", "method", "budget", "seed"]), join(run, ["mse", "relmse", "flip", "samples"])))
        .collect()
}

#[test]
fn a_bench_keeps_only_measurements_of_the_same_arguments() {
    let dir = test_folder();
    check_arguments(&dir, &BENCH);
    let refused = AtomicUsize::new(0);
    for_each_case(&BENCH, |number, case| {
        let [kept, fresh] = ["kept", "fresh"].map(|run| format!("{run}-{number}.json"));
        dir.run(&line(&BENCH, case, case.first, &kept)).exits(0);
        let before = dir.read(&kept);
        let second = dir.run(&line(&BENCH, case, case.second, &kept));
        if second.code() == Some(2) {
            assert!(second.stderr().contains(" in the file, "), "{}: {}", case.argument, second.stderr());
            assert_eq!(dir.read(&kept), before, "{}: what was refused changes nothing", case.argument);
            refused.fetch_add(1, Ordering::Relaxed);
            return;
        }
        let found = measurements(&second.exits(0).json());
        let expected = dir.run(&line(&BENCH, case, case.second, &fresh)).exits(0).json();
        for (run, errors) in measurements(&expected) {
            assert_eq!(found.get(&run), Some(&errors), "{}: {run}", case.argument);
        }
    });
    let (refused, all) = (refused.into_inner(), BENCH.cases.len());
    println!("bench: {refused} of {all} continuations were refused");
    assert!(refused >= 6 && all - refused >= 4, "{refused} of {all} refused");
}

/// Checks that nothing that a worker keeps from a job changes the next job, which differs in one setting.
#[test]
fn jobs_that_differ_in_a_setting_do_not_mix_on_a_worker() {
    let dir = test_folder();
    let (_farm, url) = start_coordinator(&dir, 0);
    let words = |case: &Case, arguments: &str| {
        let matrix = Matrix { command: "", ..SWEEP };
        line(&matrix, case, arguments, "").trim_end_matches("-o ").to_owned()
    };
    let mut jobs = Vec::new();
    for case in SWEEP.cases.iter().filter(|case| !matches!(case.argument, "--workers" | "--threads")) {
        for arguments in [case.first, case.second] {
            let settings = words(case, arguments);
            let submitted = dir.run(&format!("submit room.mgf {settings} --server {url}")).exits(0).stdout();
            jobs.push((submitted.lines().last().expect("a job").to_owned(), settings));
        }
    }
    let _worker = dir.start(&format!("worker --join {url} --threads 2"));
    for (job, settings) in jobs {
        let [of_job, alone] = ["job", "alone"].map(|folder| format!("{folder}-{job}"));
        dir.run(&format!("fetch {job} --wait -o {of_job} --server {url}")).exits(0);
        // `femc render` always makes images. The readings beside them must equal the readings of a job that only measures.
        let rendered = settings.replace(" --measure-only", "");
        dir.run(&format!("render room.mgf {rendered} -o {alone}/")).exits(0);
        let [found, mut expected] = [&of_job, &alone].map(|folder| results(&dir.path(folder)));
        if rendered != settings {
            expected.retain(|name, _| name.ends_with(".readings.json"));
        }
        assert!(!expected.is_empty(), "{settings}: no results");
        assert_eq!(found, expected, "{settings}");
    }
}
