//! Fuzzer of the importer: mutates a built-in corpus of scenes and photometric files in all editions and encodings, imports them,
//! and checks and surveys the results. A panic is a finding.
//!
//! `cargo run --release -p femc-import --example fuzz_import -- --seconds 600 --seed 1`

use femc_import::{Bundle, load_scene, load_scene_or_all_errors};
use std::{
    collections::BTreeMap,
    panic::{AssertUnwindSafe, catch_unwind},
    time::{Duration, Instant},
};

mod corpus;
use corpus::{Rng, mutate};

fn main() {
    let (mut seconds, mut seed) = (60.0, 1u64);
    let mut args = std::env::args().skip(1);
    while let Some(name) = args.next() {
        let value = args.next().unwrap_or_default();
        let known = match name.as_str() {
            "--seconds" => value.parse().map(|s| seconds = s).is_ok(),
            "--seed" => value.parse().map(|s| seed = s).is_ok(),
            _ => false,
        };
        if !known {
            eprintln!("usage: fuzz_import [--seconds N] [--seed S]");
            std::process::exit(2);
        }
    }
    std::panic::set_hook(Box::new(|_| {}));
    let (start, limit) = (Instant::now(), Duration::from_secs_f64(seconds));
    let (mut runs, mut accepted, mut slowest) = (0u64, 0u64, Duration::ZERO);
    let mut findings = Vec::new();
    while start.elapsed() < limit {
        let mut rng = Rng::new(seed.wrapping_add(runs));
        let bundle = Bundle(mutate(&mut rng));
        let began = Instant::now();
        let look = |bundle: &Bundle| {
            let scene = match load_scene_or_all_errors(bundle, "t.mgf") {
                Ok(loaded) => loaded.scene,
                Err(listed) => {
                    // The list contains the error at which a plain import stops.
                    let first = load_scene(bundle, "t.mgf").expect_err("the first error");
                    assert!(listed.errors.contains(&first) || !listed.complete);
                    return Err(first);
                }
            };
            let _faults = femc_scene::check_scene(&scene);
            let _survey = femc_scene::survey_scene(&scene, &|_| 1.0);
            Ok::<(), femc_import::ImportError>(())
        };
        match catch_unwind(AssertUnwindSafe(|| look(&bundle))) {
            Ok(result) => accepted += u64::from(result.is_ok()),
            Err(_) => findings.push(seed.wrapping_add(runs)),
        }
        slowest = slowest.max(began.elapsed());
        runs += 1;
    }
    println!(
        "{runs} executions, {accepted} scenes accepted, slowest {:.1} ms, seeds {seed}..",
        slowest.as_secs_f64() * 1e3
    );
    for &finding in findings.iter().take(10) {
        println!("panic with seed {finding}; its files:");
        let files: BTreeMap<String, Vec<u8>> = mutate(&mut Rng::new(finding));
        for (name, bytes) in files {
            println!("--- {name}\n{}", String::from_utf8_lossy(&bytes));
        }
    }
    println!("{} panics", findings.len());
    std::process::exit(i32::from(!findings.is_empty()));
}
