use super::*;
use std::f64::consts::PI;

fn table(
    kind: PhotometryKind,
    vertical: &[f64],
    horizontal: &[f64],
    value: impl Fn(f64, f64) -> f64,
) -> IntensityDistribution {
    let candela: Vec<f64> =
        horizontal.iter().flat_map(|&h| vertical.iter().map(move |&v| (v, h))).map(|(v, h)| value(v, h)).collect();
    IntensityDistribution::new(kind, vertical, horizontal, &candela).expect("a valid table")
}

fn steps(from: f64, to: f64, n: u32) -> Vec<f64> {
    (0..=n).map(|i| from + (to - from) * f64::from(i) / f64::from(n)).collect()
}

fn intensity_at(table: &IntensityDistribution, v: f64, h: f64) -> f64 {
    f64::from(table.intensity(direction(table.kind, v, h).as_vec3a()))
}

#[test]
fn every_type_gives_back_its_table_and_is_linear_between() {
    let value = |v: f64, h: f64| 1000.0 + 3.0 * v + h;
    for (kind, vertical, horizontal) in [
        (PhotometryKind::C, steps(0.0, 180.0, 18), steps(0.0, 360.0, 24)),
        (PhotometryKind::B, steps(-80.0, 90.0, 17), steps(-90.0, 90.0, 9)),
        (PhotometryKind::A, steps(-90.0, 90.0, 18), steps(-60.0, 80.0, 14)),
    ] {
        let table = table(kind, &vertical, &horizontal, value);
        for &v in &vertical[1..vertical.len() - 1] {
            for &h in &horizontal[1..horizontal.len() - 1] {
                for (v, h) in [(v, h), (v + 2.5, h), (v, h + 3.0), (v - 1.0, h - 2.0)] {
                    assert!(
                        (intensity_at(&table, v, h) - value(v, h)).abs() < 2e-2,
                        "{kind:?} {v} {h}: {}",
                        intensity_at(&table, v, h)
                    );
                }
            }
        }
    }
}

#[test]
fn axes_are_those_of_the_standard() {
    let (x, y, down) = (DVec3::X, DVec3::Y, DVec3::NEG_Z);
    let close = |a: DVec3, b: DVec3| assert!(a.distance(b) < 1e-12, "{a} {b}");
    // Photometric zero is nadir: (0, 0) for B and C, (-90, 0) for A; photometric horizontal is +x.
    close(direction(PhotometryKind::C, 0.0, 0.0), down);
    close(direction(PhotometryKind::C, 90.0, 0.0), x);
    close(direction(PhotometryKind::C, 90.0, 90.0), y); // Counter-clockwise.
    close(direction(PhotometryKind::B, 0.0, 0.0), down);
    close(direction(PhotometryKind::B, 90.0, 0.0), x);
    close(direction(PhotometryKind::B, 90.0, 90.0), -y); // Clockwise.
    close(direction(PhotometryKind::A, -90.0, 0.0), down);
    close(direction(PhotometryKind::A, 0.0, 0.0), x);
    close(direction(PhotometryKind::A, 0.0, 90.0), -y); // Clockwise.
}

#[test]
fn part_tables_are_expanded_by_their_symmetry() {
    let c = PhotometryKind::C;
    let vertical = steps(0.0, 180.0, 36);
    let full = |symmetric: fn(f64) -> f64| table(c, &vertical, &steps(0.0, 360.0, 72), |v, h| 200.0 + v + symmetric(h));
    let quadrant = |h: f64| {
        let half = if h > 180.0 { 360.0 - h } else { h };
        if half > 90.0 { 180.0 - half } else { half }
    };
    let across_0 = |h: f64| if h > 180.0 { 360.0 - h } else { h };
    let across_90 = |h: f64| {
        let turned = (h + 270.0) % 360.0; // 0 at 90 degrees.
        if turned > 180.0 { 360.0 - turned } else { turned }
    };
    for (part, whole) in [
        (steps(0.0, 90.0, 18), full(quadrant)),
        (steps(0.0, 180.0, 36), full(across_0)),
        (steps(90.0, 270.0, 36), full(across_90)),
    ] {
        let of: fn(f64) -> f64 = match part[part.len() - 1] as i32 {
            90 => quadrant,
            180 => across_0,
            _ => across_90,
        };
        let folded = table(c, &vertical, &part, |v, h| 200.0 + v + of(h));
        for v in [3.0, 77.0, 160.0] {
            for h in steps(0.0, 355.0, 71) {
                let (a, b) = (intensity_at(&folded, v, h + 1.0), intensity_at(&whole, v, h + 1.0));
                assert!((a - b).abs() < 1e-2, "{part:?} {v} {h}: {a} against {b}");
            }
        }
        assert!((folded.flux() / whole.flux() - 1.0).abs() < 1e-6);
    }
    let single = table(c, &vertical, &[0.0], |v, _| v);
    assert!(
        (intensity_at(&single, 60.0, 0.0) - 60.0).abs() < 1e-3
            && (intensity_at(&single, 60.0, 213.0) - 60.0).abs() < 1e-3
    );
    let open = table(c, &vertical, &steps(0.0, 345.0, 23), |_, h| if h == 0.0 { 30.0 } else { 0.0 });
    assert!((intensity_at(&open, 90.0, 352.5) - 15.0).abs() < 1e-3, "a full turn that stops at 345 wraps");
    for kind in [PhotometryKind::A, PhotometryKind::B] {
        let half = table(kind, &steps(-90.0, 90.0, 18), &steps(0.0, 90.0, 9), |_, h| h);
        assert!(
            (intensity_at(&half, 10.0, -30.0) - 30.0).abs() < 1e-2
                && (intensity_at(&half, 10.0, 30.0) - 30.0).abs() < 1e-2
        );
    }
}

#[test]
fn nothing_shines_beyond_the_tabulated_angles() {
    let down = table(PhotometryKind::C, &steps(0.0, 90.0, 9), &[0.0], |_, _| 10.0);
    assert_eq!(
        (intensity_at(&down, 89.9, 20.0), intensity_at(&down, 90.1, 20.0), intensity_at(&down, 180.0, 0.0)),
        (10.0, 0.0, 0.0)
    );
    let flood = table(PhotometryKind::B, &steps(-30.0, 30.0, 6), &steps(-40.0, 40.0, 8), |_, _| 10.0);
    assert_eq!(
        (intensity_at(&flood, 29.0, -39.0), intensity_at(&flood, 31.0, 0.0), intensity_at(&flood, 0.0, 41.0)),
        (10.0, 0.0, 0.0)
    );
    assert_eq!(flood.intensity(Vec3A::Z), 0.0);
}

#[test]
fn flux_has_the_closed_forms() {
    let near = |found: f64, expected: f64| assert!((found / expected - 1.0).abs() < 2e-3, "{found} against {expected}");
    let c = PhotometryKind::C;
    near(table(c, &steps(0.0, 180.0, 36), &[0.0], |_, _| 100.0).flux(), 400.0 * PI);
    near(table(c, &steps(0.0, 180.0, 36), &steps(0.0, 90.0, 4), |_, _| 100.0).flux(), 400.0 * PI);
    near(table(c, &[0.0, 90.0], &[0.0, 360.0], |_, _| 100.0).flux(), 200.0 * PI);
    // Lambertian: I cos, flux pi I.
    near(table(c, &steps(0.0, 90.0, 36), &[0.0], |v, _| 100.0 * v.to_radians().cos().max(0.0)).flux(), 100.0 * PI);
    // The band |elevation| < 30 degrees: 4 pi sin 30.
    let (vertical, horizontal) = (steps(-30.0, 30.0, 6), steps(-180.0, 180.0, 36));
    near(table(PhotometryKind::A, &vertical, &horizontal, |_, _| 1.0).flux(), 2.0 * PI);
    // Planes turned by +-90 degrees about the horizontal axis make a hemisphere; here half of it in h, mirrored.
    near(table(PhotometryKind::B, &steps(-90.0, 90.0, 18), &steps(-90.0, 90.0, 18), |_, _| 1.0).flux(), 2.0 * PI);
    near(table(PhotometryKind::B, &steps(-90.0, 90.0, 18), &steps(0.0, 90.0, 9), |_, _| 1.0).flux(), 2.0 * PI);
    // The same Lambertian lamp about nadir in type B angles: cos of the angle to nadir is cos v cos h.
    let lambert = table(PhotometryKind::B, &steps(-90.0, 90.0, 72), &steps(-90.0, 90.0, 72), |v, h| {
        (v.to_radians().cos() * h.to_radians().cos()).max(0.0)
    });
    near(lambert.flux(), PI);
}

#[test]
fn bad_tables_are_refused_with_what_is_wrong() {
    let new = |v: &[f64], h: &[f64], c: &[f64]| IntensityDistribution::new(PhotometryKind::C, v, h, c).map(|_| ());
    assert_eq!(new(&[0.0, 0.0], &[0.0], &[1.0, 1.0]), Err(PhotometryError::Angles { axis: "vertical" }));
    assert_eq!(new(&[0.0], &[], &[]), Err(PhotometryError::Angles { axis: "horizontal" }));
    assert_eq!(new(&[0.0, f64::NAN], &[0.0], &[1.0, 1.0]), Err(PhotometryError::Angles { axis: "vertical" }));
    let count = PhotometryError::Count { found: 1, vertical: 2, horizontal: 1 };
    assert_eq!(new(&[0.0, 90.0], &[0.0], &[1.0]), Err(count));
    assert_eq!(new(&[0.0, 90.0], &[0.0], &[1.0, -1.0]), Err(PhotometryError::Candela { index: 1 }));
}
