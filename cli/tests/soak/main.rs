//! Soak test: real processes run for a quarter of an hour with random faults. Every job must end as expected with the same frames
//! as one process, each task must take effect once, and at the end nothing may be larger than in the middle.
//!
//! ```text
//! FEMC_SOAK_MINUTES=15 FEMC_SOAK_SEED=1 FEMC_SOAK_OUT=/tmp/soak \
//!     cargo test --release -p femc --test soak -- --ignored --nocapture
//! ```
//!
//! Under `tests/postgres` there are two coordinators on one PostgreSQL. The seed determines the kinds and times of the faults; the
//! machine determines what they hit. `FEMC_SOAK_OUT` is a folder for the measurements (`soak.csv`) and the summary (`soak.json`).
#![cfg(target_os = "linux")]

#[path = "../suite/common/mod.rs"]
mod common;
mod farm;
mod faults;
mod gauge;
mod journal;
mod person;

use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use farm::Farm;
use gauge::Gauge;
use journal::Journal;

fn number(name: &str, default: f64) -> f64 {
    std::env::var(name).map_or(default, |text| text.parse().unwrap_or_else(|_| panic!("{name}={text} is no number")))
}

#[test]
#[ignore = "takes FEMC_SOAK_MINUTES, 1 if it does not say; the head of the file has the command"]
fn farm_under_random_faults_loses_repeats_and_leaks_nothing() {
    let time = Duration::from_secs_f64(60.0 * number("FEMC_SOAK_MINUTES", 1.0));
    let seed = number("FEMC_SOAK_SEED", 1.0) as u64;
    let farm = Farm::new();
    let alone = person::alone(&farm.place);
    let (begun, is_over) = (Instant::now(), AtomicBool::new(false));
    let (tally, fired, gauges, journal) = std::thread::scope(|scope| {
        let faults = scope.spawn(|| faults::storm(&farm, seed, begun + time));
        let gauges = scope.spawn(|| gauge::watch(&farm, begun, &is_over));
        let journal = scope.spawn(|| Journal::follow(&farm, &is_over));
        let tally = person::work(&farm, &alone, seed, begun + time);
        is_over.store(true, Ordering::SeqCst);
        let fired = faults.join().expect("the faults end");
        (tally, fired, gauges.join().expect("the gauges end"), journal.join().expect("the journal ends"))
    });
    let journal = journal.end(&farm);
    let growth = gauge::growth(&gauges, time);
    let sum = serde_json::json!({
        "seed": seed,
        "seconds": begun.elapsed().as_secs_f64(),
        "jobs": tally,
        "faults": fired,
        "log": journal,
        "grown": growth,
    });
    if let Some(folder) = std::env::var_os("FEMC_SOAK_OUT").map(std::path::PathBuf::from) {
        std::fs::create_dir_all(&folder).expect("a folder");
        std::fs::write(folder.join("soak.csv"), Gauge::table(&gauges, ",")).expect("the measurements are written");
        std::fs::write(folder.join("soak.json"), format!("{sum:#}\n")).expect("the sum is written");
    }
    println!("{}\n{sum:#}", Gauge::table(&gauges, "\t"));
    assert!(tally.wrong.is_empty(), "{:#?}", tally.wrong);
    assert!(journal.twice.is_empty(), "counted twice: {:?}", journal.twice);
    assert!(growth.is_empty(), "{growth:#?}");
    assert!(tally.done > 0 && fired.values().sum::<u64>() > 0, "something happened: {sum:#}");
}
