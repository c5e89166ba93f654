//! Measures extreme scenes and compares each with its known truth: `cargo run --release -p femc-tests --example stress`.
//!
//! - `--quick`: takes seconds, with ten times the standard errors and without long cases;
//! - `--coarser F`: allows F times the standard errors, in about 1/F^2 of the time;
//! - `--only GROUP`: runs one group (may be repeated); `--list` prints the groups;
//! - `--rays N`: grazing rays of the group `tight`, for instance `1e9`;
//! - `--json`: prints each line of the table as JSON.
//!
//! The exit code is 1 if a line fails. Seeds are fixed, so all runs print the same.

use femc_tests::stress::{Effort, GROUPS, ResultLine, Verdict};
use std::process::ExitCode;

/// Output format.
#[derive(Clone, Copy)]
enum Form {
    Table,
    Json,
}

fn main() -> ExitCode {
    let (mut effort, mut form, mut only) = (Effort::FULL, Form::Table, Vec::new());
    let mut rays = None;
    let mut args = std::env::args().skip(1);
    while let Some(arg) = args.next() {
        match arg.as_str() {
            "--quick" => effort = Effort::QUICK,
            "--json" => form = Form::Json,
            "--only" => only.extend(args.next()),
            "--coarser" => {
                effort.error_factor = args.next().and_then(|f| f.parse().ok()).unwrap_or(effort.error_factor);
            }
            "--rays" => rays = args.next().and_then(|n| n.parse::<f64>().ok()).map(|n| n as u64),
            "--list" => {
                GROUPS.iter().for_each(|group| println!("{:10} {}", group.name, group.about));
                return ExitCode::SUCCESS;
            }
            _ => {
                eprintln!("stress [--quick] [--coarser F] [--json] [--only GROUP]... [--rays N] [--list], not {arg}");
                return ExitCode::from(2);
            }
        }
    }
    effort.rays = rays.unwrap_or(effort.rays);
    if let Form::Table = form {
        println!(
            "{:64} {:>14} {:>9} {:>14} {:>6} {:>9} {:>7}",
            "", "measured", "error", "true", "sigmas", "samples", "s"
        );
    }
    let (mut lines, mut failed) = (0, 0);
    for group in GROUPS.iter().filter(|group| only.is_empty() || only.iter().any(|name| name == group.name)) {
        group.run(&effort, |line| {
            lines += 1;
            failed += usize::from(!line.holds());
            match form {
                Form::Table => print(&line),
                Form::Json => println!("{}", json(&line)),
            }
        });
    }
    if let Form::Table = form {
        println!("{lines} lines, {failed} of which do not hold");
    }
    if failed == 0 { ExitCode::SUCCESS } else { ExitCode::FAILURE }
}

fn print(line: &ResultLine) {
    let relative = if line.truth == 0.0 { line.error } else { line.error / line.truth };
    let ResultLine { name, value, truth, samples, seconds, .. } = line;
    let z = line.z();
    let samples = *samples as f64;
    print!("{name:64} {value:>14.8e} {relative:>9.1e} {truth:>14.8e} {z:>+6.1} {samples:>9.1e} {seconds:>7.1}");
    match &line.verdict {
        Verdict::Holds => println!(),
        Verdict::Fails(why) => println!("  FAILS: {why}"),
    }
}

fn json(line: &ResultLine) -> serde_json::Value {
    let why = match &line.verdict {
        Verdict::Holds => None,
        Verdict::Fails(why) => Some(why),
    };
    serde_json::json!({
        "name": line.name,
        "value": line.value,
        "error": line.error,
        "truth": line.truth,
        "sigmas": line.z(),
        "samples": line.samples,
        "bad": line.bad,
        "seconds": line.seconds,
        "holds": line.holds(),
        "why": why,
    })
}
