//! Tests of the energy of random materials over the whole domain of the scene format.

use super::{furnace, uniform};
use crate::{Bsdf, MaterialParameters, Sides};
use femc_math::color::LUMINANCE_WEIGHTS;
use femc_math::{Rgb, warp};

/// Number of random materials of each run.
const MATERIALS: u64 = 10_000;

/// Creates a material that the scene format allows: amounts in [0, 1] whose luminances add up to at most 1; colors of luminance 1,
/// up to the most saturated ones, or raw colors; any roughness and index of refraction.
fn random_material(key: u64) -> MaterialParameters {
    let roll = |k: u64| uniform(&[key, k]);
    let color = |k: u64| {
        let mut channels = [roll(k), roll(k + 1), roll(k + 2)];
        // Saturated colors: one or two channels are 0.
        for (channel, value) in channels.iter_mut().enumerate() {
            if roll(k + 3 + channel as u64) < 0.4 {
                *value = 0.0;
            }
        }
        let raw = Rgb::from_array(channels);
        let luminance = raw.dot(LUMINANCE_WEIGHTS);
        match roll(k + 6) {
            x if x < 0.2 || luminance <= 0.0 => Rgb::ONE,
            x if x < 0.3 => raw * 3.0,
            _ => raw / luminance,
        }
    };
    // Most materials have two or three of the four parts.
    let amount = |k: u64| if roll(k) < 0.45 { 0.0 } else { roll(k + 1) };
    let [rd, td, rs, ts] = [100u64, 200, 300, 400].map(|k| color(k) * amount(k + 50));
    let sum = (rd + td + rs + ts).dot(LUMINANCE_WEIGHTS);
    // The import divides by sums above 1. Many materials of files have a sum of exactly 1.
    let scale = if sum > 1.0 || (sum > 0.0 && roll(1) < 0.5) { 1.0 / sum } else { 1.0 };
    let alpha = |k: u64| match roll(k) {
        x if x < 0.2 => 0.0,
        x if x < 0.3 => 1.0,
        x if x < 0.4 => 1e-3 * roll(k + 1),
        _ => roll(k + 1),
    };
    let ior = match roll(2) {
        x if x < 0.4 => None,
        x if x < 0.45 => Some((1.0, 0.0)),
        x if x < 0.5 => Some((1.0 + 2e-3 * (roll(3) - 0.5), 0.0)),
        x if x < 0.75 => Some((0.3 + 3.0 * roll(3), 0.0)),
        x if x < 0.8 => Some((10f32.powf(4.0 * roll(3) - 2.0), 0.0)),
        x if x < 0.95 => Some((0.05 + 3.0 * roll(3), 6.0 * roll(4))),
        _ => Some((10f32.powf(4.0 * roll(3) - 2.0), 10f32.powf(4.0 * roll(4) - 2.0))),
    };
    MaterialParameters {
        sides: if roll(5) < 0.5 { Sides::One } else { Sides::Two },
        rd: rd * scale,
        td: td * scale,
        rs: rs * scale,
        ts: ts * scale,
        rs_alpha: alpha(6),
        ts_alpha: alpha(8),
        ior,
    }
}

#[test]
fn no_material_of_the_format_returns_more_than_it_receives() {
    let (mut worst, mut asked_for_more, mut doubtful) = (0.0f32, 0, 0);
    for key in 0..MATERIALS {
        let material = random_material(key);
        let sum = material.rd + material.td + material.rs + material.ts;
        asked_for_more += u32::from(sum.max_element() > 1.01);
        let bsdf = Bsdf::from_parameters(&material);
        let cos = [1.0, uniform(&[key, 10]), 0.1 * uniform(&[key, 11])];
        for (view, cos) in cos.into_iter().enumerate() {
            let wo = warp::direction(cos.max(1e-3), 0.2) * if (key + view as u64) % 2 == 1 { -1.0 } else { 1.0 };
            // A coarse estimate for all materials, better ones for those that seem to gain.
            let (look, _) = furnace(&bsdf, wo, key, 5);
            assert!(look.is_finite(), "{material:?}, {wo}: {look}");
            if look.max_element() > 1.01 {
                doubtful += 1;
                let better = |n| furnace(&bsdf, wo, key + MATERIALS, n).0.max_element() - 1.0;
                let mut gain = better(12);
                if gain > 2e-3 {
                    gain = gain.min(better(40));
                }
                if gain > worst {
                    println!("{gain:.5} of {wo}: {material:?}");
                    worst = gain;
                }
            }
        }
    }
    println!(
        "{asked_for_more} of {MATERIALS} materials have a sum above 1.01; {doubtful} closer looks; largest gain {worst}"
    );
    assert!(asked_for_more > MATERIALS as u32 / 4);
    assert!(worst <= 3e-3, "{worst}");
}

#[test]
fn material_beyond_limits_keeps_ratios_and_others_keep_bits() {
    let p = MaterialParameters::default();
    let within = MaterialParameters { rd: Rgb::new(0.3, 0.2, 0.1), td: Rgb::splat(0.3), rs: Rgb::splat(0.4), ..p };
    assert_eq!(within.energy_conserving(), within);
    // The red of Rec.709 with `rd .3` and `rs .3`: 1.38 in red for each.
    let red = Rgb::new(1.0 / LUMINANCE_WEIGHTS.x, 0.0, 0.0);
    let beyond = MaterialParameters { rd: red * 0.3, rs: red * 0.15, ..p }.energy_conserving();
    assert!((beyond.rd.x - 2.0 / 3.0).abs() < 1e-6 && (beyond.rs.x - 1.0 / 3.0).abs() < 1e-6, "{beyond:?}");
    // A coat with an index leaves the light that it does not reflect, so the parts below it are not reduced for it.
    let coated = MaterialParameters { rd: red * 0.3, rs: red * 0.3, ior: Some((1.5, 0.0)), ..p }.energy_conserving();
    assert_eq!((coated.rd.x, coated.rs.x), (1.0, 1.0));
    // `rs` of a solid does not count.
    let solid = MaterialParameters { ts: Rgb::splat(0.9), rs: Rgb::splat(0.9), sides: Sides::One, ..coated };
    let solid = MaterialParameters { rd: Rgb::splat(0.1), ..solid };
    assert_eq!(solid.energy_conserving().ts, solid.ts);
}
