//! Checks that images are right on average however their samples end, and that their claimed errors are true.
//!
//! The long version, with many seeds: `cargo run --release -p femc-tests --example honesty`.

use femc_film::{FrameImage, PixelChannels, Rect, Sample, Tile, Tiling, pixel_errors};
use femc_math::{Rgb, hash};
use femc_pipeline::{Settings, StopCondition};
use femc_tests::honesty::{Experiment, MeanWithError, Rule, SeedStatistics, render_by_rule};
use femc_tests::reference::{ROOMS, Reference, rooms_folder};
use std::ops::Range;
use std::sync::Arc;

/// Renders a film of 4 x 4 pixels. One sample in 50 is 40, and the others are such that the mean is 1.
fn render_rare_bright_samples(seed: u64, rule: Rule) -> f64 {
    let draw = |rect: Rect, samples: Range<u32>| {
        let mut tile = Tile::new(rect, samples.clone()).unwrap();
        for ((x, y), sample) in rect.pixels().flat_map(|pixel| samples.clone().map(move |sample| (pixel, sample))) {
            let word = hash::combine(&[seed, u64::from(x), u64::from(y), u64::from(sample)]);
            let light = if word.is_multiple_of(50) { 40.0 } else { 0.2 / 0.98 };
            tile.add(x, y, sample, &Sample { color: Rgb::splat(light), ..Sample::MISS });
        }
        Ok(tile)
    };
    let settings = Settings { stop: StopCondition::Error(0.4), ..Settings::default() };
    let rendered = render_by_rule(&settings, &settings.rounds()[..10], Tiling::new(4, 4, 32).unwrap(), rule, draw);
    let image = rendered.frame.resolve();
    (0..16).map(|at| f64::from(image.color.luminance(at))).sum::<f64>() / 16.0
}

#[test]
fn tile_stopped_by_other_half_is_unbiased_and_by_itself_is_not() {
    let mean =
        |rule| MeanWithError::mean(&(0..3000).map(|seed| render_rare_bright_samples(seed, rule)).collect::<Vec<_>>());
    let crosswise = mean(Rule::Settings);
    assert!((crosswise.value - 1.0).abs() < 4.0 * crosswise.error && crosswise.error < 0.02, "{crosswise:?}");
    let peeking = mean(Rule::Peeking);
    assert!(
        (peeking.value - 1.0).abs() > 4.0 * peeking.error,
        "the test would not find a rule that is wrong: {peeking:?}"
    );
}

/// Compares many seeds of a room with its brute-force reference.
fn room(name: &str, stop: StopCondition, seeds: u64) -> SeedStatistics {
    let scene = femc_import::load_scene_file(&rooms_folder().join(format!("{name}.mgf")))
        .unwrap_or_else(|error| panic!("{error}"))
        .scene;
    let experiment = Experiment::new(&Arc::new(scene), Settings { stop, ..Settings::default() }).unwrap();
    let reference = Reference::read(&rooms_folder(), name);
    let verdict =
        SeedStatistics::from_seeds(&reference, (1..=seeds).map(|seed| experiment.render_seed(seed, Rule::Settings)));
    println!("{name} {stop:?}: {verdict:?}");
    verdict
}

#[test]
fn claimed_errors_are_true_and_intervals_hold_truth() {
    let mut covered = Vec::new();
    for (name, error) in [("box", 0.011), ("glossy", 0.013), ("fog", 0.025)] {
        let said = room(name, StopCondition::Spp(16), 16);
        // The limit is 4 standard errors. All seeds share one reference image, whose noise is subtracted only on average.
        assert!(
            (said.true_over_claimed.value - 1.0).abs() < 4.0 * said.true_over_claimed.error + 0.02,
            "{name}: {:?}",
            said.true_over_claimed
        );
        assert!(said.true_over_claimed.error < 0.03, "{name}: {:?}", said.true_over_claimed);
        covered.push(said.coverage.value);
        let said = room(name, StopCondition::Error(error), 16);
        assert!(said.bias.value.abs() < 4.0 * said.bias.error && said.drawn_spp.value > 16.0, "{name}: {said:?}");
        covered.push(said.coverage.value);
    }
    let coverage = MeanWithError::mean(&covered).value;
    // There are some 400 intervals.
    assert!((0.91..0.99).contains(&coverage), "{covered:?}");
}

/// Numbers of pixels by whether their interval contains the reference's luminance.
#[derive(Debug, Default)]
struct Coverage {
    lit: usize,
    covered: usize,
    unlit: usize,
    /// Pixels whose reference is within 1.96 times the error of their block.
    covered_by_block: usize,
}

impl Coverage {
    fn add(&mut self, image: &FrameImage, reference: &Reference) {
        let width = image.color.width as usize;
        let luminance: Vec<f32> = (0..image.color.pixels.len()).map(|at| image.color.luminance(at)).collect();
        let samples: Vec<f32> = image.samples.iter().map(|&samples| samples as f32).collect();
        let variance = &image.luminance_variance;
        let errors = pixel_errors(PixelChannels { width, luminance: &luminance, variance, samples: &samples });
        let blocks = femc_film::exr::block_error_plane(&image.error(), image);
        for (at, error) in errors.iter().enumerate() {
            let Some(error) = error else {
                self.unlit += 1;
                continue;
            };
            let distance = (reference.pixel_luminance(at) / f64::from(luminance[at]) - 1.0).abs();
            self.lit += 1;
            self.covered += usize::from(distance <= error.half_width());
            self.covered_by_block += usize::from(distance <= 1.96 * f64::from(blocks[at]));
        }
    }

    fn fraction_of_lit(&self, held: usize) -> f64 {
        held as f64 / self.lit as f64
    }
}

#[test]
fn intervals_of_pixels_hold_truth_in_90_to_97_percent() {
    for name in ROOMS {
        let scene = femc_import::load_scene_file(&rooms_folder().join(format!("{name}.mgf")))
            .unwrap_or_else(|error| panic!("{error}"))
            .scene;
        let settings = Settings { stop: StopCondition::Spp(64), ..Settings::default() };
        let experiment = Experiment::new(&Arc::new(scene), settings).unwrap();
        let reference = Reference::read(&rooms_folder(), name);
        let mut coverage = Coverage::default();
        for seed in 1..=8 {
            coverage.add(&experiment.render_seed(seed, Rule::Settings).image, &reference);
        }
        let (own, block) =
            (coverage.fraction_of_lit(coverage.covered), coverage.fraction_of_lit(coverage.covered_by_block));
        println!(
            "{name}: {own:.3} of {} lit pixels, {} unlit; by the block's error {block:.3}",
            coverage.lit, coverage.unlit
        );
        assert!((0.90..=0.97).contains(&own), "{name}: {own}");
        assert!(block < 0.5, "{name}: the block's error is no pixel's: {block}");
        assert!(coverage.lit > 1000, "{name}: {coverage:?}");
    }
}
