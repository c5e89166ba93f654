//! Simulated farms with every kind of fault. They are one test, because worlds of one process must run one after the other.

use std::collections::BTreeMap;

use std::time::Duration;

use femc_sim::{FaultPlan, RunDetail, Soak, run_world};

/// Runs a few seeds that .ci/run does not run; `cargo run --release -p femc-sim -- --seeds 200` runs more.
#[test]
fn some_worlds_lose_nothing_count_nothing_twice_and_come_again() {
    let outcome = run_world(1, &FaultPlan::default(), RunDetail::Outcome).unwrap();
    assert_eq!(outcome.violations, [], "a world without faults");
    assert!(outcome.seconds < 60.0, "it is quick: {} s", outcome.seconds);

    let mut fired: BTreeMap<&str, u32> = BTreeMap::new();
    // Number of worlds in which each action occurred.
    let mut actions: BTreeMap<&str, u32> = BTreeMap::new();
    let (mut wrong, mut shared) = (Vec::new(), 0);
    // In world 1010 one worker is alone and all tasks fail on it.
    for seed in 1000..=1016 {
        let outcome = run_world(seed, &FaultPlan::from_seed(seed), RunDetail::Outcome).unwrap();
        outcome.fired.iter().for_each(|(fault, times)| *fired.entry(fault).or_default() += times);
        outcome.counts.keys().for_each(|deed| *actions.entry(deed).or_default() += 1);
        shared += outcome.counts.get("shared stages begun").copied().unwrap_or(0);
        wrong.extend(outcome.violations.into_iter().map(|violation| (seed, violation)));
        if seed == 1003 {
            let again = run_world(seed, &FaultPlan::from_seed(seed), RunDetail::Outcome).unwrap();
            assert_eq!(outcome.trace, again.trace, "seed {seed}");
        }
    }
    assert!(wrong.is_empty(), "{wrong:#?}");
    assert!(shared > 2, "jobs share stages in some worlds: {shared}");
    let queues = [
        ("leases behind one task that waits", 3),
        ("leases of short tasks behind several that wait", 2),
        ("joins beside waiting tasks of another owner", 2),
        ("pauses of lone sick workers", 1),
        ("tasks given back by drained workers", 2),
    ];
    for (action, least) in queues {
        let worlds = actions.get(action).copied().unwrap_or(0);
        assert!(worlds >= least, "{action}: in {worlds} worlds of {least} at least");
    }

    let soak = Soak { seed: 1, time: Duration::from_secs(120), detail: RunDetail::Outcome };
    let [first, again] = [(); 2].map(|()| soak.run(|_| {}).unwrap());
    assert_eq!(first.violations, [""; 0]);
    assert!(first.counts["done"] > 5 && !first.fired.is_empty(), "{:?}", first.counts);
    assert_eq!(first.trace, again.trace, "the soak's seed");
    assert!(fired.len() >= 12, "most kinds of faults came about: {fired:?}");
}
