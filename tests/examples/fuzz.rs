//! Fuzzes every decoder of the farm for a while. A panic is a finding, and its seed reproduces it.
//!
//! `cargo run -p femc-tests --example fuzz -- --seconds 600 --seed 1 [--only NAME]`

use std::process::ExitCode;
use std::time::{Duration, Instant};

use femc_tests::fuzz::{FuzzStatistics, execute, peak_memory, targets};

fn main() -> ExitCode {
    let (mut seconds, mut seed, mut only) = (60.0, 1u64, None);
    let mut args = std::env::args().skip(1);
    while let Some(name) = args.next() {
        let value = args.next().unwrap_or_default();
        let known = match name.as_str() {
            "--seconds" => value.parse().map(|s| seconds = s).is_ok(),
            "--seed" => value.parse().map(|s| seed = s).is_ok(),
            "--only" => {
                only = Some(value);
                true
            }
            _ => false,
        };
        if !known {
            eprintln!("usage: fuzz [--seconds N] [--seed S] [--only NAME]");
            return ExitCode::from(2);
        }
    }
    std::panic::set_hook(Box::new(|_| {}));
    let mut targets = targets();
    targets.retain(|target| only.as_ref().is_none_or(|only| target.name == *only));
    let mut tallies: Vec<FuzzStatistics> = targets.iter().map(|_| FuzzStatistics::default()).collect();
    let (begun, limit) = (Instant::now(), Duration::from_secs_f64(seconds));
    while begun.elapsed() < limit {
        for (target, tally) in targets.iter().zip(&mut tallies) {
            for _ in 0..16 {
                execute(target, seed, tally);
                seed = seed.wrapping_add(1);
            }
        }
    }
    println!("{:>10} {:>10} {:>11} {:>7}  target", "executions", "accepted", "slowest ms", "panics");
    for (target, tally) in targets.iter().zip(&tallies) {
        let (slowest, panics) = (tally.slowest.as_secs_f64() * 1e3, tally.panics.len());
        println!("{:>10} {:>10} {slowest:>11.1} {panics:>7}  {}", tally.executions, tally.accepted, target.name);
    }
    let all: u64 = tallies.iter().map(|tally| tally.executions).sum();
    let panics: Vec<_> = tallies.iter().flat_map(|tally| &tally.panics).collect();
    println!("{all} executions, {} panics, {} MiB at most", panics.len(), peak_memory().unwrap_or(0) >> 20);
    for (name, seed, bytes) in panics.iter().take(10) {
        println!("{name}, seed {seed}: {}", bytes.chars().take(2000).collect::<String>());
    }
    if panics.is_empty() { ExitCode::SUCCESS } else { ExitCode::FAILURE }
}
