//! Small scenes that went wrong once, and pairs of scenes that describe the same light: what is true of them.
//!
//! `cargo test --release -p femc-tests --test suite cases -- --nocapture`.
//!
//! Needs `../shared/{pairs,cases}`; skipped with a printed line where they are absent, unless `FEMC_REQUIRE` names `refs`.

use femc_require::shared;
use femc_tests::agreement::Estimate;
use std::path::Path;
use std::sync::Arc;

/// Chance of a false alarm of one scene.
const LEVEL: f64 = 1e-5;

fn estimate(file: &Path, spp: u32) -> Estimate {
    let loaded = femc_import::load_path(file).unwrap_or_else(|error| panic!("{}: {error}", file.display()));
    let estimate = Estimate::of(&Arc::new(loaded.scene), None, spp);
    println!("{}: {estimate:?}", file.display());
    estimate
}

#[test]
#[cfg_attr(debug_assertions, ignore = "half a minute, with optimization")]
fn pairs_have_the_ratio_that_they_should_have() {
    let Some(folder) = shared("pairs") else { return };
    let pairs = [
        ("two-matched-solids", 1.0),
        ("cloud-in-haze", 1.0),
        ("clear-film", 1.0),
        ("moving-ies", 1.0),
        ("point-behind-pane", 0.9),
    ];
    for (name, ratio) in pairs {
        let [a, b] = ["a", "b"].map(|side| estimate(&folder.join(format!("{name}.{side}.mgf")), 48));
        assert!(a.mean > 0.0 && a.level(b.times(ratio)) >= LEVEL, "{name}: {a:?} is not {ratio} times {b:?}");
        assert!(a.level(b.times(1.05 * ratio)) < LEVEL, "{name}: nobody would see five percent");
    }
}

#[test]
#[cfg_attr(debug_assertions, ignore = "half a minute, with optimization")]
fn where_nearly_nothing_is_absorbed_a_furnace_stays_a_furnace() {
    let Some(folder) = shared("cases") else { return };
    let hundred = Estimate { mean: 100.0, error: 0.0 };
    // Paths of thousands of events: the fog's mean is worth a tenth, which is what was missing.
    for (name, spp, seen) in [("furnace-0.99.mgf", 2, 1.02), ("conservative-fog.mgf", 4, 1.1)] {
        let found = estimate(&folder.join(name), spp);
        assert!(found.level(hundred) >= LEVEL, "{name}: {found:?}");
        assert!(found.level(hundred.times(seen)) < LEVEL, "{name}: nobody would see {seen}: {found:?}");
    }
}
