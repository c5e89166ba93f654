//! Compares the reference scenes with images of an independent renderer. The noise of both images counts.
//!
//! Needs `../shared/refs`; skipped with a printed line if it is missing, unless `FEMC_REQUIRE` names `refs`. Two tests always run,
//! those of [`brief`] run in .ci/run, those of [`long`] in tests/all. To run all here:
//! `cargo test --release -p femc-tests --test suite references -- --include-ignored --nocapture`.

use femc_pipeline::{Settings, StopCondition};
use femc_require::shared_folder;
use femc_tests::reference::{Comparison, Reference};
use femc_tests::render_frame;
use std::sync::Arc;

/// Side length of a block in pixels.
const BLOCK: usize = 16;

/// Renders `name` at `spp` and checks it: mean within `tolerance`, error (minus the reference's own noise) at most `limit`, no
/// block's mean off by more than 4.5 standard errors.
fn check(name: &str, spp: u32, tolerance: f64, limit: f64) {
    if let Some(c) = check_bounds(name, spp, tolerance, limit) {
        assert_blocks_agree(&c);
    }
}

/// Like [`check`], but without the blocks: with few samples of a scene with rare bright paths, the variance of a block is too
/// uncertain.
fn check_bounds(name: &str, spp: u32, tolerance: f64, limit: f64) -> Option<Comparison> {
    let c = measure_scene(name, spp)?;
    let net = c.relmse - c.reference_noise;
    assert!((c.mean_ratio - 1.0).abs() <= tolerance, "mean ratio {}", c.mean_ratio);
    assert!(net <= limit, "relmse less the reference's own noise {net} > {limit}");
    Some(c)
}

fn assert_blocks_agree(c: &Comparison) {
    assert!(c.worst_z <= 4.5, "block {:?} is {} standard errors off", c.worst_block, c.worst_z);
}

/// Renders `name` at `spp` and compares; `None` if the references are missing.
fn measure_scene(name: &str, spp: u32) -> Option<Comparison> {
    let folder = shared_folder("refs")?;
    let loaded = femc_import::load_scene_file(&folder.join(format!("{name}.mgf"))).unwrap_or_else(|e| panic!("{e}"));
    let start = std::time::Instant::now();
    let settings = Settings { stop: StopCondition::Spp(spp), ..Settings::default() };
    let image = render_frame(&Arc::new(loaded.scene), &settings, 1);
    let seconds = start.elapsed().as_secs_f64();
    let c = Reference::read(&folder, name).compare(&image, BLOCK);
    let net = c.relmse - c.reference_noise;
    println!(
        "{name}: {spp} spp, {seconds:.2} s, mean_ratio {:.5}, relmse {:.4e} (reference's own {:.2e}, net {net:.4e}), K {:.3e}, worst z {:.2} at {:?}",
        c.mean_ratio,
        c.relmse,
        c.reference_noise,
        net * seconds,
        c.worst_z,
        c.worst_block
    );
    Some(c)
}

#[test]
fn cornell_at_a_few_samples_has_the_reference_s_mean_and_blocks() {
    check("cornell", 16, 0.005, 1.2e-2);
}

#[test]
fn cornell_fog_at_few_samples_has_reference_s_mean_and_blocks() {
    check("cornell-fog", 16, 0.01, 7.5e-2);
}

/// Tests of .ci/run: a quarter of the samples of [`long`], so four times the error.
mod brief {
    use super::{check, check_bounds};

    #[test]
    #[ignore = ".ci/run: seconds a core"]
    fn cornell_is_within_its_bounds() {
        check("cornell", 64, 0.005, 2.9e-3);
    }

    #[test]
    #[ignore = ".ci/run: seconds a core"]
    fn cornell_glossy_is_within_its_bounds() {
        check_bounds("cornell-glossy", 64, 0.005, 8e-3);
    }

    #[test]
    #[ignore = ".ci/run: seconds a core"]
    fn sphere_is_within_its_bounds() {
        check("sphere", 64, 0.01, 5.6e-2);
    }

    /// The blocks are checked at 512 samples. At 16 samples, so few camera rays hit lamps of a hundredth of a pixel that a block
    /// may contain none, and then its samples do not show their own variance.
    #[test]
    #[ignore = ".ci/run: seconds a core"]
    fn roundabout_is_within_its_bounds() {
        check("roundabout", 16, 0.01, 3e-2);
    }
}

/// Tests of tests/all.
mod long {
    use super::{assert_blocks_agree, check, measure_scene};

    #[test]
    #[ignore = "tests/all: half a minute"]
    fn cornell_is_within_its_bounds() {
        check("cornell", 256, 0.005, 7.1e-4);
    }

    #[test]
    #[ignore = "tests/all: half a minute"]
    fn cornell_fog_is_within_its_bounds() {
        check("cornell-fog", 256, 0.005, 4.6e-3);
    }

    #[test]
    #[ignore = "tests/all: half a minute"]
    fn cornell_glossy_is_within_its_bounds() {
        check("cornell-glossy", 256, 0.005, 1.97e-3);
    }

    #[test]
    #[ignore = "tests/all: half a minute"]
    fn sphere_is_within_its_bounds() {
        check("sphere", 256, 0.005, 1.40e-2);
    }

    #[test]
    #[ignore = "tests/all: half a minute"]
    fn roundabout_is_within_its_bounds() {
        check("roundabout", 64, 0.01, 8e-3);
    }

    #[test]
    #[ignore = "tests/all: minutes"]
    fn roundabout_at_many_samples_has_reference_s_mean_and_blocks() {
        if let Some(c) = measure_scene("roundabout", 512) {
            assert!((c.mean_ratio - 1.0).abs() <= 0.01, "mean ratio {}", c.mean_ratio);
            assert_blocks_agree(&c);
        }
    }
}
