//! Tests of representative sets: few paths that represent many.

use crate::synthetic::{SEED, path, scope};
use femc_paths::PathKey;
use femc_paths::attribute::{PATH_ATTRIBUTES, path_bins};
use femc_paths::represent::{Distance, PathBins, Target, best_random_set, choose_representative, rarest_paths};

/// Returns the bins of about `samples` paths, in order of their hashes.
fn bins(samples: u32) -> Vec<PathBins> {
    let scope = scope(1);
    let pixels = scope.film[0] * scope.film[1];
    let keys =
        (0..pixels).flat_map(|pixel| (0..samples / pixels).map(move |sample| PathKey { frame: 3, pixel, sample }));
    let mut keys: Vec<(u64, PathKey)> = keys.map(|key| (key.hash(SEED), key)).collect();
    keys.sort_unstable();
    keys.into_iter().map(|(_, key)| path_bins(&scope, &path(&scope, key))).collect()
}

#[test]
fn exchange_gets_much_nearer_than_the_best_random_set() {
    const N: usize = 5000;
    let all = bins(200_000);
    let target = Target::from_paths(&all);
    let candidates = &all[..8 * N];
    let uniform = Distance::between(&candidates[..N], &target);
    let best = best_random_set(candidates, &target, N, 10);
    let found = choose_representative(candidates, &target, N);
    println!("uniform {uniform:?}, best of 10 {best:?}, exchanged {:?}", found.distance);
    assert!(found.distance.single <= 0.03 && found.distance.joint <= 0.3, "{:?}", found.distance);
    assert!(best.single > 0.1 && best.single < 1.2 * uniform.single, "{best:?}");
    assert_eq!(found, choose_representative(candidates, &target, N), "the same candidates give the same set");
    assert!(found.chosen.len() == N && found.chosen.is_sorted_by(|a, b| a < b));
    let chosen: Vec<&PathBins> = found.chosen.iter().map(|place| &candidates[*place as usize]).collect();
    assert_eq!(Distance::between(chosen, &target), found.distance);
}

#[test]
fn weights_make_every_attribute_right_and_cost_little() {
    let all = bins(60_000);
    let target = Target::from_paths(&all);
    let found = choose_representative(&all[..20_000], &target, 2000);
    let sum: f64 = found.weights.iter().sum();
    assert!((sum - 2000.0).abs() < 1e-6, "{sum}");
    assert!(found.effective_size > 1900.0 && found.effective_size <= 2000.0, "{}", found.effective_size);
    for axis in 0..PATH_ATTRIBUTES.len() {
        let coarse = |bins: &PathBins| PATH_ATTRIBUTES[axis].scale.coarse(bins[axis]);
        for bin in 0..10 {
            let own = found.chosen.iter().zip(&found.weights).filter(|(at, _)| coarse(&all[**at as usize]) == bin);
            let own = own.map(|(_, weight)| weight).sum::<f64>() / 2000.0;
            let whole = all.iter().filter(|bins| coarse(bins) == bin).count() as f64 / all.len() as f64;
            assert!((own - whole).abs() < 2e-3, "{}, bin {bin}: {own}, not {whole}", PATH_ATTRIBUTES[axis].name);
        }
    }
}

#[test]
fn of_few_candidates_all_are_taken_and_of_none_none() {
    let all = bins(1440);
    let target = Target::from_paths(&all);
    let found = choose_representative(&all, &target, 5000);
    assert_eq!(found.chosen.len(), all.len());
    assert!(found.distance.single < 1e-12 && (found.effective_size - all.len() as f64).abs() < 1e-6);
    let nothing = choose_representative(&[], &Target::from_paths([]), 5000);
    assert!(nothing.chosen.is_empty() && nothing.effective_size == 0.0);
}

#[test]
fn the_rarest_are_those_that_are_alone_in_a_bin() {
    let mut all = vec![[5u8; PATH_ATTRIBUTES.len()]; 100];
    all[37][3] = 60;
    all[81][0] = 1;
    all[82][0] = 1;
    assert_eq!(rarest_paths(&all, 3), [37, 81, 82]);
}
