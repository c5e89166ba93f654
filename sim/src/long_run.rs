//! Commands that run one world for a long time.

use std::process::ExitCode;
use std::time::Duration;

use clap::Subcommand;
use femc_sim::{Measurement, RunDetail, Soak, SoakReport};

/// Kind of long run.
#[derive(Debug, Subcommand)]
pub enum LongRun {
    Soak(Args),
}

/// Run one world for a long time, with people, storms of faults and an operator, and check that nothing grows
///
/// A storm of faults begins every simulated minute. Three people submit job after job, pause, cancel, retry, change priorities; an
/// operator drains workers and removes garbage. Each job's frames and its part of the log are audited after its end. Ended jobs
/// expire after ten minutes. Runs of at least 4 hours also check that memory, log and store do not grow: the mean of the second
/// half of the measurements may exceed that of the first half by at most 5 %, without the first eighth of all measurements. Exit
/// code 1 if anything went wrong.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Simulated hours for which people submit jobs
    #[arg(long, default_value_t = 24.0, value_parser = hours)]
    hours: f64,
    /// Seed that decides everything
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// Print all messages
    #[arg(long)]
    story: bool,
    /// Print the result as JSON
    #[arg(long)]
    json: bool,
}

fn hours(text: &str) -> Result<f64, String> {
    text.parse().ok().filter(|hours| (0.01..=8760.0).contains(hours)).ok_or_else(|| "give 0.01 to 8760".to_owned())
}

impl LongRun {
    /// Runs the world.
    pub fn run(&self) -> anyhow::Result<ExitCode> {
        match self {
            Self::Soak(args) => soak(args),
        }
    }
}

fn soak(args: &Args) -> anyhow::Result<ExitCode> {
    let time = Duration::from_secs_f64(args.hours * 3600.0);
    let detail = if args.story { RunDetail::Story } else { RunDetail::Outcome };
    let soak = Soak { seed: args.seed, time, detail };
    let report = soak.run(|gauge| {
        let Measurement { hours, seconds, jobs_ended, resident_bytes, ends, .. } = gauge;
        let memory = *resident_bytes as f64 / f64::from(1 << 20);
        eprintln!(
            "{hours:6.2} h of {:.2} after {seconds:.0} s: {jobs_ended} jobs, {memory:.1} MiB, {ends} connection ends",
            args.hours
        );
    })?;
    report.story.iter().for_each(|line| println!("{line}"));
    if args.json {
        println!("{}", serde_json::to_string(&report)?);
    } else {
        print_report(args, &report);
    }
    Ok(if report.violations.is_empty() { ExitCode::SUCCESS } else { ExitCode::FAILURE })
}

fn print_report(args: &Args, report: &SoakReport) {
    println!(" hours  memory   jobs   kept    log  snapshots  artifacts   store  audited  faults");
    println!("           MiB  ended           KiB                          KiB  records");
    for Measurement {
        hours,
        resident_bytes,
        jobs_ended,
        jobs_kept,
        log_bytes,
        snapshots,
        artifacts,
        artifact_bytes,
        audited_records,
        faults,
        ..
    } in &report.gauges
    {
        println!(
            "{hours:6.2} {:7.1} {jobs_ended:6} {jobs_kept:6} {:6} {snapshots:10} {artifacts:10} {:7} {audited_records:8} {faults:7}",
            *resident_bytes as f64 / f64::from(1 << 20),
            log_bytes >> 10,
            artifact_bytes >> 10,
        );
    }
    report.fired.iter().for_each(|(fault, times)| println!("  {times:6} {fault}"));
    report.counts.iter().for_each(|(what, times)| println!("  {times:6} {what}"));
    report.violations.iter().for_each(|violation| println!("seed {}: {violation}", args.seed));
    println!(
        "seed {}: {:.0} simulated s, {} violations; at most {} records in the log; world {}",
        args.seed,
        report.seconds,
        report.violations.len(),
        report.longest_log,
        &report.trace[..16]
    );
}
