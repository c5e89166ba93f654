//! Bytes that nobody meant: every decoder of the farm is given mutated and generated ones, and must refuse or accept them, without
//! a panic, in bounded time and memory. `tests/fuzz.rs` does a little of it with every run of the tests,
//! `cargo run -p femc-tests --example fuzz -- --seconds 600` as much as you like. Scenes have a fuzzer of their own, in
//! `engine/import/examples`.

mod formats;
mod mutate;
mod schema;
mod trust;
mod wire;

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::time::{Duration, Instant};

use crate::rng::Rng;

type Make = Box<dyn Fn(&mut Rng) -> Vec<u8>>;
type Decode = Box<dyn Fn(&[u8]) -> bool>;

/// A decoder under test.
pub struct Target {
    /// For people.
    pub name: String,
    /// Bytes for one execution.
    make: Make,
    /// Whether the bytes were accepted.
    decode: Decode,
}

impl Target {
    /// Mutations of valid bytes.
    fn of(name: &str, seeds: Vec<Vec<u8>>, decode: impl Fn(&[u8]) -> bool + 'static) -> Self {
        Self::dressed(name, seeds, <[u8]>::to_vec, decode)
    }

    /// The same, put into an envelope of compression or checksums that is right again.
    fn dressed(
        name: &str,
        seeds: Vec<Vec<u8>>,
        dress: impl Fn(&[u8]) -> Vec<u8> + 'static,
        decode: impl Fn(&[u8]) -> bool + 'static,
    ) -> Self {
        let make = move |rng: &mut Rng| {
            let seed = rng.pick(&seeds).clone();
            let other = rng.pick(&seeds);
            dress(&mutate::some(rng, seed, other))
        };
        Self { name: name.into(), make: Box::new(make), decode: Box::new(decode) }
    }
}

/// All of them.
pub fn targets() -> Vec<Target> {
    wire::targets().into_iter().chain(formats::targets()).chain(trust::targets()).collect()
}

/// What came of some executions.
#[derive(Debug, Default)]
pub struct Tally {
    /// Number of executions.
    pub executions: u64,
    /// How many of them were accepted.
    pub accepted: u64,
    /// The longest.
    pub slowest: Duration,
    /// Panics: target, seed, the bytes in hexadecimal.
    pub panics: Vec<(String, u64, String)>,
}

/// Gives `target` the bytes of `seed`.
pub fn execute(target: &Target, seed: u64, tally: &mut Tally) {
    let bytes = (target.make)(&mut Rng::new(seed));
    let began = Instant::now();
    let outcome = catch_unwind(AssertUnwindSafe(|| (target.decode)(&bytes)));
    tally.slowest = tally.slowest.max(began.elapsed());
    tally.executions += 1;
    match outcome {
        Ok(accepted) => tally.accepted += u64::from(accepted),
        Err(_) => {
            let hex = bytes.iter().map(|byte| format!("{byte:02x}")).collect();
            tally.panics.push((target.name.clone(), seed, hex));
        }
    }
}

/// Most bytes that this process has had in memory, where the system tells.
pub fn peak() -> Option<u64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find(|line| line.starts_with("VmHWM:"))?;
    line.split_whitespace().nth(1)?.parse::<u64>().ok().map(|kibibytes| kibibytes << 10)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_panic_is_a_finding_with_its_seed() {
        let target = Target::of("fragile", vec![vec![0; 8]], |bytes| {
            assert!(bytes.len() < 9, "too long");
            true
        });
        let mut tally = Tally::default();
        (0..100).for_each(|seed| execute(&target, seed, &mut tally));
        let (name, seed, bytes) = tally.panics.first().expect("a finding");
        assert!(name == "fragile" && bytes.len() > 16);
        let mut again = Tally::default();
        execute(&target, *seed, &mut again);
        assert_eq!(again.panics, [(name.clone(), *seed, bytes.clone())]);
    }
}
