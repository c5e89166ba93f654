//! `femc-sim`: runs simulated farms, one for each seed, and reports which failed.

mod long_run;

use std::collections::BTreeMap;
use std::process::{Command, ExitCode, Stdio};
use std::time::Instant;

use anyhow::Context as _;
use clap::Parser;
use femc_sim::{FaultPlan, Outcome, RunDetail, run_world};
use serde::{Deserialize, Serialize};

/// Runs the farm in simulated worlds with people and faults and checks its guarantees
#[derive(Debug, Parser)]
#[command(
    name = "femc-sim",
    after_help = "Examples:\n  \
    femc-sim --seeds 2000\n  \
    femc-sim --from 1234 --seeds 1 --story    # all messages of one world\n  \
    femc-sim soak --hours 24                  # one world for a day\n\n\
    Exit code 1 if a world violated a guarantee. Its seed is printed; rerun the seed to reproduce the violation.",
    args_conflicts_with_subcommands = true
)]
struct Args {
    #[command(subcommand)]
    long: Option<long_run::LongRun>,
    /// Number of seeds
    #[arg(long, default_value_t = 200)]
    seeds: u64,
    /// First seed
    #[arg(long, default_value_t = 0)]
    from: u64,
    /// Processes that run worlds in parallel
    #[arg(long, default_value_t = 2, value_parser = clap::value_parser!(u64).range(1..=1024))]
    processes: u64,
    /// Run every n-th world twice and compare; 0: none
    #[arg(long, default_value_t = 10)]
    twice_each: u64,
    /// Print all messages
    #[arg(long, requires = "from")]
    story: bool,
    /// Print the summary as JSON
    #[arg(long)]
    json: bool,
}

/// Summary of all worlds.
#[derive(Debug, Default, Serialize, Deserialize)]
struct Summary {
    seeds: u64,
    wrong: BTreeMap<u64, Vec<String>>,
    simulated_seconds: f64,
    stale_messages: u64,
    fired: BTreeMap<String, u64>,
    counts: BTreeMap<String, u64>,
    /// Number of worlds in which each fault or action occurred.
    worlds: BTreeMap<String, u64>,
}

impl Summary {
    fn add(&mut self, other: Self) {
        self.seeds += other.seeds;
        self.wrong.extend(other.wrong);
        self.simulated_seconds += other.simulated_seconds;
        self.stale_messages += other.stale_messages;
        for (fault, times) in other.fired {
            *self.fired.entry(fault).or_default() += times;
        }
        for (what, times) in other.counts {
            *self.counts.entry(what).or_default() += times;
        }
        for (what, worlds) in other.worlds {
            *self.worlds.entry(what).or_default() += worlds;
        }
    }
}

fn main() -> anyhow::Result<ExitCode> {
    let args = Args::parse();
    if let Some(long) = args.long {
        return long.run();
    }
    let begun = Instant::now();
    let sum = if args.processes == 1 || args.seeds == 1 || args.story {
        run_in_process(&args)?
    } else {
        run_in_processes(&args)?
    };
    if args.json {
        println!("{}", serde_json::to_string(&sum)?);
    } else {
        for (seed, wrong) in &sum.wrong {
            println!("seed {seed}:");
            wrong.iter().for_each(|violation| println!("  {violation}"));
        }
        println!(
            "{} seeds, {} wrong; {:.0} simulated s in {:.1} s; {} stale messages",
            sum.seeds,
            sum.wrong.len(),
            sum.simulated_seconds,
            begun.elapsed().as_secs_f64(),
            sum.stale_messages
        );
        let of_worlds = |what: &String| sum.worlds.get(what).copied().unwrap_or(0);
        let all = sum.fired.iter().chain(&sum.counts);
        all.for_each(|(what, times)| println!("  {times:6} in {:4} worlds: {what}", of_worlds(what)));
    }
    Ok(if sum.wrong.is_empty() { ExitCode::SUCCESS } else { ExitCode::FAILURE })
}

/// Runs the worlds one after the other in this process.
fn run_in_process(args: &Args) -> anyhow::Result<Summary> {
    let mut sum = Summary::default();
    for seed in args.from..args.from + args.seeds {
        let plan = FaultPlan::from_seed(seed);
        let detail = if args.story { RunDetail::Story } else { RunDetail::Outcome };
        let outcome = run_world(seed, &plan, detail)?;
        outcome.story.iter().for_each(|line| println!("{line}"));
        let mut wrong: Vec<String> = outcome.violations.iter().map(ToString::to_string).collect();
        if args.twice_each > 0 && seed % args.twice_each == 0 {
            wrong.extend(difference(&outcome, &run_world(seed, &plan, detail)?));
        }
        if !wrong.is_empty() {
            sum.wrong.insert(seed, wrong);
        }
        let all = outcome.fired.keys().chain(outcome.counts.keys());
        let worlds = all.map(|&what| (what.to_owned(), 1)).collect();
        let fired = outcome.fired.into_iter().map(|(fault, times)| (fault.to_owned(), u64::from(times))).collect();
        sum.add(Summary {
            seeds: 1,
            wrong: BTreeMap::new(),
            simulated_seconds: outcome.seconds,
            stale_messages: outcome.stale,
            fired,
            counts: outcome.counts.into_iter().map(|(what, times)| (what.to_owned(), times)).collect(),
            worlds,
        });
    }
    Ok(sum)
}

fn difference(first: &Outcome, second: &Outcome) -> Option<String> {
    let place = || first.story.iter().zip(&second.story).find(|(first, second)| first != second);
    let at = place().map(|(first, second)| format!(": {first} | {second}")).unwrap_or_default();
    (first.trace != second.trace).then(|| format!("the seed gives different worlds{at}"))
}

/// Runs the worlds in separate processes, because worlds of one process cannot run in parallel.
fn run_in_processes(args: &Args) -> anyhow::Result<Summary> {
    let program = std::env::current_exe()?;
    let share = args.seeds.div_ceil(args.processes);
    let mut children = Vec::new();
    for from in (0..args.processes).map(|number| number * share).take_while(|&from| from < args.seeds) {
        let seeds = share.min(args.seeds - from);
        let numbers =
            [("--from", args.from + from), ("--seeds", seeds), ("--processes", 1), ("--twice-each", args.twice_each)];
        let mut child = Command::new(&program);
        for (name, value) in numbers {
            child.args([name, &value.to_string()]);
        }
        children.push(child.arg("--json").stdout(Stdio::piped()).spawn()?);
    }
    let mut sum = Summary::default();
    for child in children {
        let output = child.wait_with_output()?.stdout;
        sum.add(serde_json::from_slice(&output).context("a process did not finish")?);
    }
    Ok(sum)
}
