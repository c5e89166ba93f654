//! Tests that compare the search with brute force.

use crate::images::{guides, style};
use femc_stylize::{Patches, Settings, Weights, brute_force, search};

/// Returns the mean energy of the search, with the default number of passes, relative to brute force; both without prices.
fn energy_ratio(width: u32, height: u32) -> f64 {
    let (source, target) = (guides(width, height, [0.5, 0.5], 1), guides(width, height, [0.4, 0.6], 2));
    let settings = Settings::default();
    let weights = Weights::new(&settings, source.channels());
    let [source, target] =
        [&source, &target].map(|guides| Patches::new(Some(&style(guides)), guides, weights, settings.patch));
    let fields = [search(&source, &target, 0.0, settings.iterations as u32), brute_force(&source, &target, |_| ())];
    let [found, least] = fields.map(|field| {
        let energy = |(q, &p): (usize, &u32)| f64::from(source.energy(p, &target, q as u32, u32::MAX));
        field.patches.iter().enumerate().map(energy).sum::<f64>()
    });
    eprintln!("energy {:.4} of the least", found / least);
    found / least
}

#[test]
fn the_search_agrees_with_brute_force() {
    let ratio = energy_ratio(48, 40);
    assert!((1.0..1.1).contains(&ratio), "{ratio}");
}

/// Takes too long for every run: 96 x 96 pixels by brute force.
#[test]
#[ignore = "a minute"]
fn the_search_agrees_with_brute_force_in_a_larger_image() {
    let ratio = energy_ratio(96, 96);
    assert!((1.0..1.1).contains(&ratio), "{ratio}");
}
