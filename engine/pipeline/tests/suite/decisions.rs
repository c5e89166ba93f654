//! Tests of the variance by decision.

use crate::statistics::{FOG, GAP, ROOM, prepared};
use femc_pipeline::variance_by_decision::{Decision, DecisionKey, MeanEstimate, VarianceByDecision, WeightedPixel};
use femc_pipeline::{Method, Prepared, Settings};

/// First row of pixels that do not see the lamp of the room.
const BELOW_LAMP: u32 = 6;

fn settings(max_depth: u32) -> Settings {
    Settings { method: Method::Pt, max_depth, seed: 5, size: Some([20, 12]), ..Settings::default() }
}

/// Returns the room without its mirror, whose rare bright samples have no reliable variance.
fn matte_room() -> String {
    ROOM.replace("rs .9 0", "rd .5")
}

/// Returns the parts of the pixels from a row down.
fn parts(prepared: &Prepared, settings: &Settings, row: u32, spp: u32) -> VarianceByDecision {
    let pixels: Vec<WeightedPixel> =
        (row * 20..20 * 12).map(|at| WeightedPixel { pixel: (at % 20, at / 20), weight: 1.0 }).collect();
    VarianceByDecision::from_replay(prepared, settings, &pixels, 0..spp)
}

/// Returns the part of a decision on all segments.
fn share(found: &VarianceByDecision, decision: Decision) -> f64 {
    let own = found.parts.iter().filter(|(key, _)| key.decision == Some(decision));
    own.map(|(_, part)| part.mean).sum::<f64>() / found.sum.mean
}

/// Checks that the parts add up, and that their sum is the variance of the samples (4 standard errors: once in 16,000 times).
fn assert_adds_up(name: &str, found: &VarianceByDecision) {
    let sum: f64 = found.parts.values().map(|part| part.mean).sum();
    assert!((sum / found.sum.mean - 1.0).abs() < 1e-9, "{name}: {sum} {:?}", found.sum);
    let MeanEstimate { mean, error } = found.spread;
    let z = (found.sum.mean - mean) / (error * error + found.sum.error.powi(2)).sqrt();
    println!("{name}: {:.4} and {mean:.4}, {z:+.2} standard errors, {} replays", found.sum.mean, found.replays);
    assert!(z.abs() < 4.0, "{name}: {:?} {:?}", found.sum, found.spread);
}

#[test]
fn parts_of_decisions_add_up_to_the_variance_of_samples() {
    let guided = Settings { method: Method::Femc, ..settings(0) };
    let cases = [
        ("room", matte_room(), settings(0)),
        ("fog", format!("{FOG}{}", matte_room()), settings(0)),
        ("split paths", GAP.to_owned(), guided),
    ];
    for (name, text, settings) in cases {
        let prepared = prepared(&text, &settings);
        let found = parts(&prepared, &settings, BELOW_LAMP, 16);
        assert_adds_up(name, &found);
        let directions = |is_guided: bool| {
            let is_own = |key: &DecisionKey| key.decision == Some(Decision::Direction) && key.is_guided == is_guided;
            found.parts.iter().any(|(key, part)| is_own(key) && part.mean != 0.0)
        };
        assert!(directions(false), "{name}");
        assert_eq!(directions(true), settings.method == Method::Femc, "{name}");
        let has_distances = found.parts.keys().any(|key| key.decision == Some(Decision::Distance));
        assert_eq!(has_distances, name == "fog", "{name}");
        if settings.method == Method::Pt {
            assert_eq!(share(&found, Decision::Lamp), 0.0, "{name}: there is only one lamp");
            assert!(share(&found, Decision::LampPoint) > 0.001, "{name}");
        }
    }
}

/// Directly visible light depends on the position in the pixel alone. Direct light on the floor depends on the choice between two
/// lamps, if the weights of lamps do not know that one of them is hidden.
#[test]
fn variance_is_in_the_decision_that_causes_it() {
    let seen = settings(1);
    let prepared_room = prepared(ROOM, &seen);
    let found = parts(&prepared_room, &seen, 0, 16);
    assert_adds_up("visible light", &found);
    let of_camera = share(&found, Decision::Camera) + share(&found, Decision::CameraEmitter);
    assert!((of_camera - 1.0).abs() < 1e-9, "{:?}", found.parts);

    let second = "m lid =\n\tc\n\trd .1\nv q =\n\tp .4 -.6 2.2\nm glow\no second\nsph q .2\no\nv r1 =\n\tp -2 -2 1.7\nv r2 =\n\tp 3 -2 1.7\nv r3 =\n\
                  \tp 3 .1 1.7\nv r4 =\n\tp -2 .1 1.7\nm lid\no lid\nf r1 r2 r3 r4\no\n";
    let direct = settings(2);
    let prepared_room = prepared(&format!("{}{second}", matte_room()), &direct);
    let found = parts(&prepared_room, &direct, BELOW_LAMP, 16);
    assert_adds_up("two lamps", &found);
    assert!(share(&found, Decision::Lamp) > 0.1, "{:?}", found.parts);
    assert_eq!(share(&found, Decision::Roulette), 0.0);
}
