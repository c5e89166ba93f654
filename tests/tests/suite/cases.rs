//! Small scenes that once failed, and pairs of scenes that describe the same light.
//!
//! Needs `../shared/{pairs,cases}`; skipped with a printed line if they are missing, unless `FEMC_REQUIRE` names `refs`. .ci/run
//! runs [`brief`] and tests/all runs [`long`]. To run them here:
//! `cargo test --release -p femc-tests --test suite cases -- --include-ignored --nocapture`.

use femc_require::shared_folder;
use femc_tests::agreement::Estimate;
use std::path::Path;
use std::sync::Arc;

/// Probability of a false alarm in one scene.
const LEVEL: f64 = 1e-5;

fn estimate(file: &Path, spp: u32) -> Estimate {
    let loaded = femc_import::load_scene_file(file).unwrap_or_else(|error| panic!("{}: {error}", file.display()));
    let estimate = Estimate::from_scene(&Arc::new(loaded.scene), None, spp);
    println!("{}: {estimate:?}", file.display());
    estimate
}

/// Compares both scenes of each pair at `spp` samples. Checks that a ratio wrong by the factor `detectable_factor` would be
/// detected.
fn pairs_agree(spp: u32, detectable_factor: f64) {
    let Some(folder) = shared_folder("pairs") else { return };
    let pairs = [
        ("two-matched-solids", 1.0),
        ("cloud-in-haze", 1.0),
        ("clear-film", 1.0),
        ("moving-ies", 1.0),
        ("point-behind-pane", 0.9),
    ];
    for (name, ratio) in pairs {
        let [a, b] = ["a", "b"].map(|side| estimate(&folder.join(format!("{name}.{side}.mgf")), spp));
        assert!(a.mean > 0.0 && a.p_value(b.scaled(ratio)) >= LEVEL, "{name}: {a:?} is not {ratio} times {b:?}");
        assert!(a.p_value(b.scaled(detectable_factor * ratio)) < LEVEL, "{name}: nobody would see {detectable_factor}");
    }
}

/// Checks a furnace whose paths have thousands of events. Checks that an error of the radiance by the factor `detectable_factor`
/// would be detected.
fn furnace(name: &str, spp: u32, detectable_factor: f64) {
    let Some(folder) = shared_folder("cases") else { return };
    let hundred = Estimate { mean: 100.0, error: 0.0 };
    let found = estimate(&folder.join(name), spp);
    assert!(found.p_value(hundred) >= LEVEL, "{name}: {found:?}");
    assert!(
        found.p_value(hundred.scaled(detectable_factor)) < LEVEL,
        "{name}: nobody would see {detectable_factor}: {found:?}"
    );
}

/// Tests of .ci/run: fewer samples, so they detect only larger errors.
mod brief {
    use super::{furnace, pairs_agree};

    #[test]
    #[ignore = ".ci/run: seconds a core"]
    fn pairs_have_the_ratio_that_they_should_have() {
        pairs_agree(8, 1.15);
    }

    #[test]
    #[ignore = ".ci/run: seconds a core"]
    fn where_nearly_nothing_is_absorbed_a_furnace_stays_a_furnace() {
        furnace("furnace-0.99.mgf", 1, 1.03);
    }
}

mod long {
    use super::{furnace, pairs_agree};

    #[test]
    #[ignore = "tests/all: half a minute"]
    fn pairs_have_the_ratio_that_they_should_have() {
        pairs_agree(48, 1.05);
    }

    #[test]
    #[ignore = "tests/all: half a minute"]
    fn where_nearly_nothing_is_absorbed_a_furnace_stays_a_furnace() {
        furnace("furnace-0.99.mgf", 2, 1.02);
        // An error of a tenth is detected. This is the light that was once missing.
        furnace("conservative-fog.mgf", 4, 1.1);
    }
}
