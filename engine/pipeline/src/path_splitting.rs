//! Choice of the number of branches into which a frame's paths are split at their first vertices.
//!
//! Branches share the camera ray, and all that is computed on it. They reduce the noise of the light that comes by way of other
//! surfaces or of fog. They are wasted where most of the noise comes from the camera ray itself and from the lamps, for example in
//! a street that is lit directly. A pilot traces the same samples of some pixels without branches and with the maximum number. The
//! variance of a sample with `k` branches is about `a + b / k`, and its work is about `c + d * k` rays (\[rath2022\]).
//! Samples of the pilot do not count in any image, and the choice is a function of the frame and its settings alone.

use crate::render::FilterAdapter;
use crate::settings::{Method, Settings};
use femc_math::glam::DVec3;
use femc_math::sampler::{REPLICATES, replicate_of};
use femc_montecarlo::{Packet, PathSample, PathSettings, Tracer};
use femc_prepared::Prepared;
use rayon::prelude::*;

/// Maximum number of branches.
const MAX_BRANCHES: u32 = 4;
/// Number of pixels of the pilot at most, and the number of pixels of the film for each of them. A film with fewer than
/// [`MIN_PIXELS`] of them has no pilot.
const PIXELS: u32 = 512;
const FILM_PIXELS_EACH: u32 = 128;
const MIN_PIXELS: u32 = 24;
/// Number of pixels after which the pilot ends if the maximum number of branches costs at least [`HOPELESS`] times one branch.
const FIRST_PIXELS: u32 = 64;
const HOPELESS: f64 = 2.0;
/// Number of samples of each of these pixels.
const SAMPLES: u32 = 16;
/// Seed of the pilot's random numbers. The samples of an image must not depend on their own variance.
const SEED: u64 = 0x70_696c_6f74;
/// Share of the frame's mean that is added to the mean of a pixel, by which its noise is divided.
const DARK_SHARE: f64 = 0.1;
/// Minimum gain by twice as many branches. A sample should not take more work for nothing.
const MIN_GAIN: f64 = 1.02;

/// Samples of the pilot.
#[derive(Clone, Debug, Default)]
struct Pilot {
    /// Pixels with one branch, and with [`MAX_BRANCHES`].
    pixels: Vec<[PilotPixel; 2]>,
}

/// Samples of a pixel.
#[derive(Clone, Copy, Debug, Default)]
struct PilotPixel {
    /// Mean color of each replicate, cd/m2.
    replicates: [DVec3; REPLICATES],
    /// Number of rays.
    rays: u64,
}

/// Costs of samples with one branch, and with [`MAX_BRANCHES`].
#[derive(Clone, Copy, Debug, PartialEq)]
struct Costs {
    /// Relative variances, in a common unit.
    variance: [f64; 2],
    /// Numbers of rays, in a common unit.
    rays: [f64; 2],
}

/// Chooses the number of branches of a frame's paths.
pub(crate) fn choose_branches(prepared: &Prepared, settings: &Settings) -> u32 {
    let [width, height] = prepared.camera.film;
    let pixels = (width.saturating_mul(height) / FILM_PIXELS_EACH).min(PIXELS);
    if settings.method != Method::Pt || settings.max_depth == 1 || pixels < MIN_PIXELS {
        return 1;
    }
    let mut pilot = Pilot::default();
    pilot.trace(prepared, settings, pixels.min(FIRST_PIXELS));
    if pixels > FIRST_PIXELS && !pilot.costs().are_hopeless() {
        pilot.trace(prepared, settings, pixels);
    }
    pilot.costs().best_branches()
}

impl Costs {
    /// Returns the product of variance and work, divided by that of one branch.
    fn product(&self, branches: u32) -> f64 {
        let most = f64::from(MAX_BRANCHES);
        let share = |[single, split]: [f64; 2]| split / single;
        // `a + b / k` and `c + d * k`.
        let b = (1.0 - share(self.variance)) / (1.0 - 1.0 / most);
        let d = (share(self.rays) - 1.0) / (most - 1.0);
        let k = f64::from(branches);
        (1.0 - b * (1.0 - 1.0 / k)) * (1.0 + d * (k - 1.0))
    }

    /// Checks whether one branch is much better than the maximum number.
    fn are_hopeless(&self) -> bool {
        self.product(MAX_BRANCHES) >= HOPELESS
    }

    /// Returns the number of branches with the least product of variance and work. It is 1 where nothing is noisy.
    fn best_branches(&self) -> u32 {
        let mut branches = 1;
        while branches < MAX_BRANCHES && self.product(branches) > MIN_GAIN * self.product(2 * branches) {
            branches *= 2;
        }
        branches
    }
}

impl Pilot {
    /// Traces more pixels, up to `pixels`.
    fn trace(&mut self, prepared: &Prepared, settings: &Settings, pixels: u32) {
        let more = self.pixels.len() as u32..pixels;
        let path = PathSettings { seed: SEED, max_depth: settings.max_depth, single_technique: None };
        let packet = |branches| Packet::new(|| Tracer::new(prepared, path).with_first_branches(branches));
        let pixels = more.into_par_iter().map_init(
            || [1, MAX_BRANCHES].map(packet),
            |packets, number| {
                let pixel = pilot_pixel(prepared.camera.film, number);
                packets.each_mut().map(|packet| PilotPixel::trace(packet, settings, pixel))
            },
        );
        self.pixels.par_extend(pixels);
    }

    /// Returns the costs of the samples.
    fn costs(&self) -> Costs {
        let count = (2 * self.pixels.len()).max(1) as f64;
        let frame_mean = self.pixels.iter().flatten().map(PilotPixel::mean).sum::<DVec3>() / count;
        let floor = (DARK_SHARE * frame_mean).length_squared();
        let mut costs = Costs { variance: [0.0; 2], rays: [0.0; 2] };
        for both in &self.pixels {
            // Both numbers of branches have the same weight. Their own means would make the noisier one look better.
            let squared_mean = both[1].mean().length_squared() + floor;
            for (index, pixel) in both.iter().enumerate() {
                costs.rays[index] += pixel.rays as f64;
                if squared_mean > 0.0 {
                    costs.variance[index] += pixel.squared_deviations() / squared_mean;
                }
            }
        }
        costs
    }
}

impl PilotPixel {
    /// Traces the samples of a pixel.
    fn trace(packet: &mut Packet<'_>, settings: &Settings, pixel: u32) -> Self {
        let rays = |packet: &Packet<'_>| packet.counters().rays + packet.counters().shadow_rays;
        let before = rays(packet);
        let mut replicates = [DVec3::ZERO; REPLICATES];
        packet.trace(
            (0..SAMPLES).map(|sample| (pixel, sample)),
            FilterAdapter(settings.filter),
            |(_, sample), PathSample { color, .. }| {
                // The film rejects other samples.
                if color.is_finite() {
                    replicates[replicate_of(sample)] += color.as_dvec3() * (REPLICATES as f64 / f64::from(SAMPLES));
                }
            },
        );
        Self { replicates, rays: rays(packet) - before }
    }

    fn mean(&self) -> DVec3 {
        self.replicates.iter().sum::<DVec3>() / REPLICATES as f64
    }

    /// Returns the sum of the replicates' squared differences from their mean.
    fn squared_deviations(&self) -> f64 {
        let mean = self.mean();
        self.replicates.iter().map(|value| value.distance_squared(mean)).sum()
    }
}

/// Returns a pixel of the pilot (row-major index). Successive pixels are spread evenly over the film (\[roberts2018\]).
fn pilot_pixel([width, height]: [u32; 2], number: u32) -> u32 {
    let at = |edge: u32, step: u32| ((u64::from(number.wrapping_mul(step)) * u64::from(edge)) >> 32) as u32;
    at(height, 0x91e1_0da5) * width + at(width, 0xc13f_a9a9)
}

#[cfg(test)]
mod tests {
    use super::*;
    use femc_prepared::SceneSource;
    use std::sync::Arc;

    fn branches_of(name: &str, settings: &Settings) -> u32 {
        let path = format!("{}/../../scenes/{name}.mgf", env!("CARGO_MANIFEST_DIR"));
        let scene = femc_import::load_scene_file(path.as_ref()).expect("a scene").scene;
        crate::prepare_world(&SceneSource::new(Arc::new(scene)), settings, 1, None).expect("a frame").first_branches
    }

    #[test]
    fn paths_are_split_where_light_comes_by_way_of_surfaces() {
        let settings = Settings { size: Some([192, 192]), method: Method::Pt, ..Settings::default() };
        assert!(branches_of("cornell", &settings) > 1);
        assert_eq!(branches_of("roundabout", &settings), 1, "the noise is in the light of the lamps");
        let only_direct = Settings { max_depth: 1, ..settings.clone() };
        assert_eq!(branches_of("cornell", &only_direct), 1);
        let guided = Settings { method: Method::Femc, ..settings.clone() };
        assert_eq!(branches_of("cornell", &guided), 1);
        let small = Settings { size: Some([40, 30]), ..settings };
        assert_eq!(branches_of("cornell", &small), 1);
    }

    /// The model gives the measured values back, and its minimum.
    #[test]
    fn the_best_number_has_the_least_variance_times_work() {
        let costs = |variance: f64, rays: f64| Costs { variance: [8.0, 8.0 * variance], rays: [10.0, 10.0 * rays] };
        let measured = costs(0.3, 3.1);
        assert!((measured.product(1) - 1.0).abs() < 1e-12 && (measured.product(4) - 0.93).abs() < 1e-12);
        assert_eq!(costs(0.25, 3.0).best_branches(), 4);
        // a = 0.2, b = 0.8, c = d = 0.5: 1, 0.9, 1.
        assert_eq!(costs(0.4, 2.5).best_branches(), 2);
        assert_eq!(costs(0.6, 3.5).best_branches(), 1);
        assert!(costs(0.6, 3.5).are_hopeless() && !costs(0.4, 3.5).are_hopeless());
        let dark = Costs { variance: [0.0; 2], rays: [10.0, 40.0] };
        assert!(dark.best_branches() == 1 && !dark.are_hopeless());
    }

    #[test]
    fn pixels_of_the_pilot_cover_the_film() {
        let film = [40, 30];
        let mut cells = [0; 12];
        for number in 0..120 {
            let pixel = pilot_pixel(film, number);
            cells[(pixel / 40 / 10 * 4 + pixel % 40 / 10) as usize] += 1;
        }
        assert!(cells.iter().all(|count| (7..=13).contains(count)), "{cells:?}");
    }
}
