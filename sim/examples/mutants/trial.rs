//! Runs mutants, several in parallel.

use std::collections::{BTreeMap, BTreeSet};
use std::fs::{self, OpenOptions};
use std::io::{BufRead as _, BufReader, Write as _};
use std::os::unix::process::CommandExt as _;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::{Mutex, mpsc};
use std::time::{Duration, Instant};

use anyhow::{Context as _, bail, ensure};
use clap::Args;
use serde::Deserialize;

use crate::group::Group;
use crate::list::{self, Mutant};
use crate::weave::{self, WovenSource};

/// Arguments of the `run` command.
#[derive(Debug, Args)]
pub struct RunArgs {
    /// Group of sources: farm, light, views or commands
    #[arg(value_parser = Group::from_name)]
    pub group: &'static Group,
    /// Use the sources of this commit instead of the checkout
    #[arg(long, value_name = "COMMIT")]
    at: Option<String>,
    /// File of verdicts, one per line; mutants listed there are not run again. It is for the same sources only [default:
    /// mutants/GROUP-SOURCES under the target directory]
    #[arg(long, value_name = "FILE")]
    verdicts: Option<PathBuf>,
    /// Run only mutants whose line in the list contains this text, such as the name of a file
    #[arg(long, value_name = "TEXT")]
    only: Option<String>,
    /// Run surviving mutants again
    #[arg(long)]
    again: bool,
    /// Number of mutants that run in parallel
    #[arg(long, default_value_t = 2)]
    jobs: usize,
    /// Number of worlds for each mutant
    #[arg(long, default_value_t = 20)]
    seeds: u64,
}

/// Time limit of a mutant: a multiple of the usual duration, plus a constant, because some mutants slow tests and worlds down. A
/// mutant that exceeds it counts as hanging.
const TIME_LIMIT: (u32, Duration) = (4, Duration::from_secs(20));

/// Verdict on a mutant that does not compile.
const COMPILE_ERROR_VERDICT: &str = "does not compile";

/// Runs the mutants of the list that have no verdict.
pub fn run(root: &Path, list: &Path, args: &RunArgs) -> anyhow::Result<()> {
    let home = crate::target(root).join("mutants");
    let group = args.group;
    let (tree, sources) = check_out(root, &home, args.at.as_deref())?;
    let keys = list::read(list)?;
    let mut all: BTreeMap<String, Mutant> =
        list::list_mutants(&tree, group)?.into_iter().map(|mutant| (mutant.key.clone(), mutant)).collect();
    let mutants: Vec<(usize, Mutant)> = (1..).zip(&keys).filter_map(|(n, key)| Some((n, all.remove(key)?))).collect();
    let gone = keys.len() - mutants.len();
    let wanted = |mutant: &Mutant| args.only.as_ref().is_none_or(|text| mutant.key.contains(text));
    let mutants: Vec<(usize, Mutant)> = mutants.into_iter().filter(|(_, mutant)| wanted(mutant)).collect();
    let path = args.verdicts.clone().unwrap_or_else(|| home.join(format!("{}-{}", group.name, &sources[..12])));
    let origin = format!("# sources {sources}, {} worlds", if group.has_worlds() { args.seeds } else { 0 });
    let mut verdicts = read(&path, &origin)?;
    let out =
        mutants.iter().filter(|(_, m)| verdicts.get(&m.key).is_some_and(|verdict| verdict == COMPILE_ERROR_VERDICT));
    let built = build(&tree, &home, group, &mutants, out.map(|(number, _)| *number).collect())?;
    if args.again {
        verdicts.retain(|_, verdict| verdict != "survived");
    }
    for (number, mutant) in &mutants {
        if !built.mutants.contains(number) {
            verdicts.insert(mutant.key.clone(), COMPILE_ERROR_VERDICT.into());
        }
    }
    save(&path, &origin, &verdicts)?;
    let trial = Trial::new(&tree, group, built, args.seeds)?;
    let mut left: Vec<&(usize, Mutant)> = mutants.iter().filter(|(_, m)| !verdicts.contains_key(&m.key)).collect();
    left.reverse();
    println!("{} mutants, {} to try", mutants.len(), left.len());
    let (left, file) = (Mutex::new(left), Mutex::new(OpenOptions::new().append(true).create(true).open(&path)?));
    std::thread::scope(|scope| {
        let workers: Vec<_> = (0..args.jobs.max(1)).map(|_| scope.spawn(|| trial.work(&left, &file))).collect();
        workers.into_iter().try_for_each(|worker| worker.join().unwrap_or_else(|_| bail!("a thread panicked")))
    })?;
    let explained = root.join("sim/mutants/explained");
    print_summary(&read(&path, &origin)?, &read_explained(&explained)?, &keys, gone);
    Ok(())
}

/// Checks the sources out into a worktree at a fixed path, so that its build can be reused. Returns the path, and the identity of the
/// sources.
fn check_out(root: &Path, home: &Path, at: Option<&str>) -> anyhow::Result<(PathBuf, String)> {
    let git = |arguments: &[&str]| -> anyhow::Result<String> {
        let ran = Command::new("git").arg("-C").arg(root).args(arguments).output()?;
        ensure!(ran.status.success(), "git {arguments:?}: {}", String::from_utf8_lossy(&ran.stderr));
        Ok(String::from_utf8(ran.stdout)?.trim().to_owned())
    };
    let commit = match at {
        Some(commit) => commit.to_owned(),
        // Use the state of the checkout, not that of the worktree.
        None => match git(&["stash", "create"])? {
            unchanged if unchanged.is_empty() => git(&["rev-parse", "HEAD"])?,
            changed => changed,
        },
    };
    let tree = home.join("tree");
    fs::create_dir_all(home)?;
    if tree.exists() {
        let mut checkout = Command::new("git");
        checkout.arg("-C").arg(&tree).args(["checkout", "--quiet", "--force", "--detach", &commit]);
        ensure!(checkout.status()?.success(), "{} is no worktree", tree.display());
    } else {
        git(&["worktree", "add", "--quiet", "--force", "--detach", &tree.display().to_string(), &commit])?;
    }
    let sources = git(&["rev-parse", &format!("{commit}^{{tree}}")])?;
    Ok((tree, sources))
}

/// Executables of one build.
#[derive(Debug, Default)]
struct BuildOutput {
    /// Test executables by crate.
    tests: BTreeMap<String, Vec<PathBuf>>,
    simulation: PathBuf,
    /// Numbers of the mutants in this build.
    mutants: BTreeSet<usize>,
}

#[derive(Debug, Deserialize)]
struct Message {
    reason: String,
    message: Option<Diagnostic>,
    executable: Option<PathBuf>,
    package_id: Option<String>,
    profile: Option<Profile>,
}

#[derive(Debug, Deserialize)]
struct Profile {
    /// Whether the executable contains tests.
    test: bool,
}

#[derive(Debug, Deserialize)]
struct Diagnostic {
    level: String,
    rendered: Option<String>,
    spans: Vec<DiagnosticSpan>,
}

#[derive(Debug, Deserialize)]
struct DiagnosticSpan {
    file_name: String,
    byte_start: usize,
    is_primary: bool,
}

/// Weaves the mutants into the sources and builds them. Drops mutants that do not compile and repeats until the build succeeds.
/// - `out`: mutants that are known not to compile.
fn build(
    tree: &Path,
    home: &Path,
    group: &Group,
    mutants: &[(usize, Mutant)],
    mut out: BTreeSet<usize>,
) -> anyhow::Result<BuildOutput> {
    let sources = sources(tree, group, mutants)?;
    loop {
        let mut woven: BTreeMap<&str, WovenSource> = BTreeMap::new();
        for (file, source) in &sources {
            let of_file: Vec<(usize, &Mutant)> = mutants
                .iter()
                .filter(|(number, mutant)| mutant.file == *file && !out.contains(number))
                .map(|(number, mutant)| (*number, mutant))
                .collect();
            let mut text = weave::weave(source, &of_file).with_context(|| file.clone())?;
            if group.crates.iter().any(|(_, folder)| *file == root_file(tree, folder)) {
                text.text.push_str(weave::SWITCH);
            }
            fs::write(tree.join(file), &text.text)?;
            woven.insert(file, text);
        }
        let mut tests = vec!["test", "--no-run", "--locked"];
        group.crates.iter().for_each(|(name, _)| tests.extend(["-p", name]));
        let (mut messages, is_built) = cargo(tree, home, &tests)?;
        let mut is_whole = is_built;
        if is_built && group.has_worlds() {
            let (more, is_built) = cargo(tree, home, &["build", "--release", "--locked", "-p", "femc-sim"])?;
            messages.extend(more);
            is_whole = is_built;
        }
        if is_whole {
            let within = woven.values().flat_map(|woven| woven.mutants.iter().copied()).collect();
            return collect_build(group, messages, within);
        }
        let before = out.len();
        for error in messages.iter().filter_map(|m| m.message.as_ref()).filter(|error| error.level == "error") {
            let spots = error.spans.iter().filter(|spot| spot.is_primary);
            let guilty = spots.filter_map(|spot| woven.get(spot.file_name.as_str())?.origin(spot.byte_start));
            let guilty: Vec<usize> = guilty.collect();
            if guilty.is_empty() && !error.spans.is_empty() {
                eprintln!("{}", error.rendered.as_deref().unwrap_or_default());
            }
            out.extend(guilty);
        }
        ensure!(out.len() > before, "the woven sources do not compile, and no mutant is guilty");
        println!("{} mutants do not compile so far", out.len());
    }
}

/// Returns the root file of a crate: of its library, or else of its program.
fn root_file(tree: &Path, folder: &str) -> String {
    let library = format!("{folder}/src/lib.rs");
    if tree.join(&library).exists() { library } else { format!("{folder}/src/main.rs") }
}

fn sources(tree: &Path, group: &Group, mutants: &[(usize, Mutant)]) -> anyhow::Result<BTreeMap<String, String>> {
    let mut files: BTreeSet<String> = mutants.iter().map(|(_, mutant)| mutant.file.clone()).collect();
    files.extend(group.crates.iter().map(|(_, folder)| root_file(tree, folder)));
    files.into_iter().map(|file| Ok((file.clone(), fs::read_to_string(tree.join(&file))?))).collect()
}

fn cargo(tree: &Path, home: &Path, arguments: &[&str]) -> anyhow::Result<(Vec<Message>, bool)> {
    let mut command = Command::new("cargo");
    command.args(arguments).args(["--message-format", "json", "--quiet"]).current_dir(tree);
    // Warnings arrive as JSON and are not printed. The switches cause hundreds of warnings about needless parentheses.
    let output = command.env("CARGO_TARGET_DIR", home.join("build")).stderr(Stdio::inherit()).output()?;
    let lines = output.stdout.split(|&byte| byte == b'\n').filter(|line| line.starts_with(b"{"));
    let messages = lines.map(serde_json::from_slice).collect::<Result<_, _>>()?;
    Ok((messages, output.status.success()))
}

fn collect_build(group: &Group, messages: Vec<Message>, mutants: BTreeSet<usize>) -> anyhow::Result<BuildOutput> {
    let mut built = BuildOutput { mutants, ..BuildOutput::default() };
    for message in messages.into_iter().filter(|message| message.reason == "compiler-artifact") {
        let (Some(executable), Some(package)) = (message.executable, message.package_id) else { continue };
        if executable.parent().is_some_and(|folder| folder.ends_with("examples")) {
            continue;
        }
        let tested = group.crates.iter().find(|(_, folder)| package.contains(&format!("/{folder}#")));
        // The programs of a crate that its tests start are no tests.
        let is_test = message.profile.is_some_and(|profile| profile.test);
        match tested.filter(|_| is_test) {
            Some((name, _)) => built.tests.entry((*name).to_owned()).or_default().push(executable),
            None if executable.ends_with("femc-sim") => built.simulation = executable,
            None => {}
        }
    }
    let has_worlds = built.simulation.exists() || !group.has_worlds();
    ensure!(has_worlds && built.tests.len() == group.crates.len(), "not all was built: {built:?}");
    Ok(built)
}

/// Executables and time limits for running mutants.
struct Trial<'a> {
    tree: &'a Path,
    group: &'a Group,
    built: BuildOutput,
    seeds: u64,
    /// Usual duration of the tests of each crate, and of the worlds.
    baseline: BTreeMap<String, Duration>,
}

/// Key of the worlds' duration in [`Trial::baseline`].
const SIMULATION_KEY: &str = "simulation";

impl<'a> Trial<'a> {
    /// Measures the usual durations, without any mutant.
    fn new(tree: &'a Path, group: &'a Group, mut built: BuildOutput, seeds: u64) -> anyhow::Result<Self> {
        // Run small test executables first: the large ones start processes and wait for clocks.
        let size = |path: &PathBuf| fs::metadata(path).map_or(0, |found| found.len());
        built.tests.values_mut().for_each(|tests| tests.sort_by_key(size));
        let mut trial = Self { tree, group, built, seeds, baseline: BTreeMap::new() };
        let most = Duration::from_secs(1800);
        for (name, _) in group.crates {
            let begun = Instant::now();
            if let Some(killer) = trial.killing_test(name, 0, most)? {
                bail!("{killer} fails without any mutant");
            }
            trial.baseline.insert((*name).to_owned(), begun.elapsed());
            println!("{name}: {:.1} s", begun.elapsed().as_secs_f64());
        }
        if !group.has_worlds() {
            return Ok(trial);
        }
        let begun = Instant::now();
        ensure!(trial.worlds_pass(0, most)?, "a world goes wrong without any mutant");
        trial.baseline.insert(SIMULATION_KEY.to_owned(), begun.elapsed());
        println!("{seeds} worlds: {:.1} s", begun.elapsed().as_secs_f64());
        Ok(trial)
    }

    fn work(&self, left: &Mutex<Vec<&(usize, Mutant)>>, file: &Mutex<fs::File>) -> anyhow::Result<()> {
        loop {
            let Some((number, mutant)) = left.lock().ok().and_then(|mut left| left.pop()) else { return Ok(()) };
            let verdict = self.verdict(*number, mutant)?;
            let line = format!("{verdict}\t{}\n", mutant.key);
            print!("{line}");
            if let Ok(mut file) = file.lock() {
                file.write_all(line.as_bytes())?;
            }
        }
    }

    /// Runs one mutant and returns its verdict. Tests or worlds run first, whichever are faster.
    fn verdict(&self, number: usize, mutant: &Mutant) -> anyhow::Result<String> {
        let by_worlds = || -> anyhow::Result<Option<String>> {
            if !self.group.has_worlds() {
                return Ok(None);
            }
            let lives = self.worlds_pass(number, self.time_limit(SIMULATION_KEY))?;
            Ok((!lives).then(|| "the simulation".to_owned()))
        };
        let by_tests = || -> anyhow::Result<Option<String>> {
            for package in self.group.tested_crates(&mutant.package) {
                let killer = self.killing_test(package, number, self.time_limit(package))?;
                if killer.is_some() {
                    return Ok(killer);
                }
            }
            Ok(None)
        };
        let killer =
            if self.group.has_worlds() && self.baseline.get(SIMULATION_KEY) < self.baseline.get(&mutant.package) {
                by_worlds()?.map_or_else(by_tests, |killer| Ok(Some(killer)))?
            } else {
                by_tests()?.map_or_else(by_worlds, |killer| Ok(Some(killer)))?
            };
        Ok(killer.map_or_else(|| "survived".into(), |killer| format!("killed by {killer}")))
    }

    fn time_limit(&self, name: &str) -> Duration {
        let (times, more) = TIME_LIMIT;
        self.baseline.get(name).copied().unwrap_or_default() * times + more
    }

    /// Returns the test that detects the mutant.
    fn killing_test(&self, package: &str, number: usize, most: Duration) -> anyhow::Result<Option<String>> {
        let Some((_, folder)) = self.group.crates.iter().find(|(name, _)| *name == package) else { return Ok(None) };
        let begun = Instant::now();
        for test in self.built.tests.get(package).into_iter().flatten() {
            let run = |arguments: &[&str]| {
                let mut command = Command::new(test);
                command.args(arguments).current_dir(self.tree.join(folder));
                run_until_failure(&mut command, number, most.saturating_sub(begun.elapsed()))
            };
            let program = test.file_name().unwrap_or_default().to_string_lossy();
            let program = program.rsplit_once('-').map_or(&*program, |(name, _)| name).to_owned();
            // On a busy machine, a test may fail for lack of time, so a test must fail twice. A test that hangs is not repeated.
            match run(self.group.test_arguments())? {
                Outcome::Passed => {}
                Outcome::Failed(Some(test)) => {
                    if run(&[&test, "--exact"])? != Outcome::Passed {
                        return Ok(Some(format!("{program} {test}")));
                    }
                    // The failure ended the run, so the other tests have not run yet.
                    if run(self.group.test_arguments())? != Outcome::Passed {
                        return Ok(Some(program));
                    }
                }
                Outcome::Failed(None) if run(self.group.test_arguments())? == Outcome::Passed => {}
                Outcome::Failed(None) | Outcome::TimedOut => return Ok(Some(program)),
            }
        }
        Ok(None)
    }

    fn worlds_pass(&self, number: usize, most: Duration) -> anyhow::Result<bool> {
        let mut command = Command::new(&self.built.simulation);
        command.args(["--processes", "1", "--twice-each", "0", "--seeds", &self.seeds.to_string()]);
        Ok(run_until_failure(&mut command, number, most)? == Outcome::Passed)
    }
}

/// Result of a run of tests.
#[derive(Debug, PartialEq)]
enum Outcome {
    Passed,
    /// The first test that failed, if the output names one.
    Failed(Option<String>),
    TimedOut,
}

/// Runs a command until it ends, until its output names a failed test, or until the time limit.
fn run_until_failure(command: &mut Command, number: usize, most: Duration) -> anyhow::Result<Outcome> {
    command.env("FEMC_MUTANT", number.to_string()).env("PROPTEST_MAX_SHRINK_ITERS", "0");
    // Tests start processes. All are in one process group, so that none outlives the run.
    command.process_group(0).stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::null());
    let mut child = command.spawn()?;
    let output = child.stdout.take().context("no output")?;
    let (sender, failures) = mpsc::channel();
    // This thread ends when the last process of the group has closed the output.
    std::thread::spawn(move || {
        let lines = BufReader::new(output).lines().map_while(Result::ok);
        lines.filter_map(|line| failed_test(&line)).for_each(|test| _ = sender.send(test));
    });
    let begun = Instant::now();
    let outcome = loop {
        if let Ok(test) = failures.try_recv() {
            break Outcome::Failed(Some(test));
        }
        if let Some(status) = child.try_wait()? {
            break if status.success() {
                Outcome::Passed
            } else {
                Outcome::Failed(failures.recv_timeout(Duration::from_secs(1)).ok())
            };
        }
        if begun.elapsed() > most {
            break Outcome::TimedOut;
        }
        std::thread::sleep(Duration::from_millis(20));
    };
    if outcome != Outcome::Passed {
        let group = format!("-{}", child.id());
        // The processes may just have ended, which is fine.
        let _ = Command::new("kill").args(["-KILL", "--", &group]).stderr(Stdio::null()).status()?;
        child.wait()?;
    }
    Ok(outcome)
}

/// Returns the name of the test that failed according to a line of output.
fn failed_test(line: &str) -> Option<String> {
    let name = line.strip_prefix("test ")?.strip_suffix(" ... FAILED")?;
    Some(name.trim_end_matches(" - should panic").to_owned())
}

type Verdicts = BTreeMap<String, String>;

/// Reads verdicts.
/// - `origin`: first line of the file, with the identity of the sources and the number of worlds. A file with another first line is
///   an error.
fn read(path: &Path, origin: &str) -> anyhow::Result<Verdicts> {
    let text = if path.exists() { fs::read_to_string(path)? } else { origin.to_owned() };
    let first = text.lines().next().unwrap_or_default();
    ensure!(first == origin, "{}: verdicts of `{first}`, not of `{origin}`; remove the file", path.display());
    let pair = |line: &str| line.split_once('\t').map(|(verdict, key)| (key.to_owned(), verdict.to_owned()));
    Ok(text.lines().filter_map(pair).collect())
}

fn save(path: &Path, origin: &str, verdicts: &Verdicts) -> anyhow::Result<()> {
    let lines: String = verdicts.iter().map(|(key, verdict)| format!("{verdict}\t{key}\n")).collect();
    fs::write(path, format!("{origin}\n{lines}")).with_context(|| path.display().to_string())
}

/// Reads the keys of mutants that may survive. Indented lines below each key give the reason.
fn read_explained(path: &Path) -> anyhow::Result<BTreeSet<String>> {
    let text = fs::read_to_string(path).with_context(|| path.display().to_string())?;
    Ok(text.lines().filter(|line| !line.starts_with([' ', '#']) && !line.is_empty()).map(str::to_owned).collect())
}

fn print_summary(verdicts: &Verdicts, explained: &BTreeSet<String>, keys: &[String], gone: usize) {
    let mut sum: BTreeMap<&str, usize> = BTreeMap::new();
    for key in keys {
        let verdict = verdicts.get(key).map_or("not tried", String::as_str);
        let kind = if verdict.starts_with("killed by the sim") {
            "killed by the simulation"
        } else if verdict.starts_with("killed") {
            "killed by tests"
        } else if verdict == "survived" && explained.contains(key) {
            "survived, which is explained"
        } else {
            verdict
        };
        *sum.entry(kind).or_default() += 1;
        if kind == "survived" {
            println!("SURVIVED {key}");
        }
    }
    println!("{} mutants, {gone} of them not in these sources any more", keys.len());
    sum.iter().for_each(|(verdict, times)| println!("  {times:6} {verdict}"));
}
