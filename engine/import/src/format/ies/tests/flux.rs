//! Tests that the flux of a lamp is the integral of its table.

use super::{super::flux::lumens, *};
use femc_emission::photometry::{IntensityDistribution, PhotometryKind};
use proptest::prelude::*;

/// Returns ascending angles from `first` to `last`. `inner` has the angles in between, in 256ths of the span.
fn list(first: f64, last: f64, inner: &[u8]) -> Vec<f64> {
    let mut angles: Vec<f64> = inner.iter().map(|&part| first + (last - first) * f64::from(part) / 256.0).collect();
    angles.extend([first, last]);
    angles.sort_by(f64::total_cmp);
    angles.dedup();
    angles
}

fn rendered(photometry: &Photometry) -> f64 {
    let kind = match photometry.kind {
        PhotometryType::A => PhotometryKind::A,
        PhotometryType::B => PhotometryKind::B,
        PhotometryType::C => PhotometryKind::C,
    };
    let Photometry { vertical, horizontal, candela, .. } = photometry;
    IntensityDistribution::new(kind, vertical, horizontal, candela).unwrap().flux()
}

#[test]
fn the_flux_of_simple_lamps_is_known() {
    let pi = std::f64::consts::PI;
    let flux_of = |kind: u32, vertical: &str, horizontal: &str, candela: &str| {
        let (v, h) = (vertical.split(' ').count(), horizontal.split(' ').count());
        let head = format!("IESNA91\nTILT=NONE\n1 -1 1 {v} {h} {kind} 2 0 0 0\n1 1 1\n");
        let lamp = read(&format!("{head}{vertical}\n{horizontal}\n{candela}\n")).unwrap();
        lumens(&lamp.photometry)
    };
    let near = |a: f64, b: f64| assert!((a / b - 1.0).abs() < 1e-9, "{a} for {b}");
    near(flux_of(1, "0 180", "0", "1 1"), 4.0 * pi);
    near(flux_of(1, "0 90", "0", "1 1"), 2.0 * pi);
    near(flux_of(1, "0 90", "0 90", "1 1 1 1"), 2.0 * pi);
    near(flux_of(1, "0 90", "90 270", "1 1 1 1"), 2.0 * pi);
    near(flux_of(1, "0 90", "0 120 240", "1 1 1 1 1 1"), 2.0 * pi);
    // 2 pi times the integral of (1 - v 2/pi) sin v.
    near(flux_of(1, "0 90", "0", "1 0"), 2.0 * pi * (1.0 - 2.0 / pi));
    near(flux_of(2, "-90 90", "-90 90", "1 1 1 1"), 2.0 * pi);
    near(flux_of(2, "-90 90", "0 90", "1 1 1 1"), 2.0 * pi);
    near(flux_of(3, "-90 90", "-90 90", "1 1 1 1"), 2.0 * pi);
    near(flux_of(3, "0 90", "0 90", "1 1 1 1"), pi);
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 1000, failure_persistence: None, ..ProptestConfig::default() })]

    /// A renderer's lamp has the flux of its table, for all photometric types and symmetries.
    #[test]
    fn a_lamp_has_the_flux_of_its_table(
        (kind, vertical, horizontal) in prop_oneof![
            Just((PhotometryType::C, [0.0, 90.0], [0.0, 90.0])),
            Just((PhotometryType::C, [0.0, 180.0], [0.0, 180.0])),
            Just((PhotometryType::C, [90.0, 180.0], [0.0, 360.0])),
            Just((PhotometryType::C, [0.0, 180.0], [90.0, 270.0])),
            Just((PhotometryType::C, [2.5, 177.5], [5.0, 355.0])),
            Just((PhotometryType::C, [0.0, 90.0], [0.0, 60.0])),
            Just((PhotometryType::C, [0.0, 60.0], [0.0, 140.0])),
            Just((PhotometryType::C, [0.0, 180.0], [0.0, 300.0])),
            Just((PhotometryType::A, [-90.0, 90.0], [-90.0, 90.0])),
            Just((PhotometryType::A, [0.0, 90.0], [0.0, 90.0])),
            Just((PhotometryType::A, [-30.0, 20.0], [-40.0, 50.0])),
            Just((PhotometryType::B, [-90.0, 90.0], [-90.0, 90.0])),
            Just((PhotometryType::B, [-90.0, 90.0], [0.0, 90.0])),
            Just((PhotometryType::B, [-30.0, 20.0], [-40.0, 50.0])),
        ],
        inner in prop::collection::vec(1u8..=255, 4..40),
        more in prop::collection::vec(1u8..=255, 4..40),
        single: bool,
        candela in prop::collection::vec(0.0..1000.0f64, 1000),
    ) {
        let vertical = list(vertical[0], vertical[1], &inner);
        let horizontal = if single && kind == PhotometryType::C { vec![0.0] } else { list(horizontal[0], horizontal[1], &more) };
        let count = vertical.len() * horizontal.len();
        let candela: Vec<f64> = candela.into_iter().cycle().take(count).collect();
        let words = |numbers: &[f64]| numbers.iter().map(|x| x.to_string()).collect::<Vec<_>>().join(" ");
        let code = match kind { PhotometryType::C => 1, PhotometryType::B => 2, PhotometryType::A => 3 };
        let text = format!(
            "IES:LM-63-2019\nTILT=NONE\n1 -1 1 {} {} {code} 2 0 0 0\n1 1.1 1\n{}\n{}\n{}\n",
            vertical.len(), horizontal.len(), words(&vertical), words(&horizontal), words(&candela)
        );
        let lamp = read(&text).unwrap();
        let (exact, rendered) = (lumens(&lamp.photometry), rendered(&lamp.photometry));
        prop_assert!((rendered / exact - 1.0).abs() < 1e-3, "{exact} lm, rendered {rendered} lm: {text}");
    }
}
