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
mod log_summary;
mod measurements;
mod simulated_user;

use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use farm::Farm;
use log_summary::LogSummary;
use measurements::Measurement;

fn number(name: &str, default: f64) -> f64 {
    std::env::var(name).map_or(default, |text| text.parse().unwrap_or_else(|_| panic!("{name}={text} is no number")))
}

#[test]
#[ignore = "takes FEMC_SOAK_MINUTES, 1 if it does not say; the head of the file has the command"]
fn farm_under_random_faults_loses_repeats_and_leaks_nothing() {
    let time = Duration::from_secs_f64(60.0 * number("FEMC_SOAK_MINUTES", 1.0));
    let seed = number("FEMC_SOAK_SEED", 1.0) as u64;
    let farm = Farm::new();
    let reference = simulated_user::reference_frames(&farm.dir);
    let (begun, is_over) = (Instant::now(), AtomicBool::new(false));
    let (tally, fired, measurements, summary) = std::thread::scope(|scope| {
        let faults = scope.spawn(|| faults::inject_faults(&farm, seed, begun + time));
        let measurements = scope.spawn(|| measurements::measure_repeatedly(&farm, begun, &is_over));
        let summary = scope.spawn(|| LogSummary::observe(&farm, &is_over));
        let tally = simulated_user::run_user(&farm, &reference, seed, begun + time);
        is_over.store(true, Ordering::SeqCst);
        let fired = faults.join().expect("the faults end");
        (tally, fired, measurements.join().expect("the gauges end"), summary.join().expect("the journal ends"))
    });
    let summary = summary.end(&farm);
    let growth = measurements::growth(&measurements, time);
    let sum = serde_json::json!({
        "seed": seed,
        "seconds": begun.elapsed().as_secs_f64(),
        "jobs": tally,
        "faults": fired,
        "log": summary,
        "grown": growth,
    });
    if let Some(folder) = std::env::var_os("FEMC_SOAK_OUT").map(std::path::PathBuf::from) {
        std::fs::create_dir_all(&folder).expect("a folder");
        std::fs::write(folder.join("soak.csv"), Measurement::table(&measurements, ","))
            .expect("the measurements are written");
        std::fs::write(folder.join("soak.json"), format!("{sum:#}\n")).expect("the sum is written");
    }
    println!("{}\n{sum:#}", Measurement::table(&measurements, "\t"));
    assert!(tally.wrong.is_empty(), "{:#?}", tally.wrong);
    assert!(summary.twice.is_empty(), "counted twice: {:?}", summary.twice);
    assert!(growth.is_empty(), "{growth:#?}");
    assert!(tally.done > 0 && fired.values().sum::<u64>() > 0, "something happened: {sum:#}");
}
