//! Tests of every field in every edition.

use super::{super::edition::Edition, super::opening::opening, *};

/// First lines of the editions, in order.
const LINES: [&str; 5] = ["", "IESNA91\n", "IESNA:LM-63-1995\n", "IESNA:LM-63-2002\n", "IES:LM-63-2019\n"];
const FIELDS: [&str; 13] = ["1", "-1", "1", "3", "1", "1", "2", "0", "0", "0", "1", "1", "20"];

/// Effect of a value on a file.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Effect {
    /// Multiplies the intensities by this factor.
    Scales(f64),
    /// Multiplies the intensities and gives a warning.
    Warns(f64),
    /// Multiplies the intensities and gives a note.
    Notes(f64),
    /// Gives an error.
    Fails,
}
use Effect::{Fails, Notes, Scales, Warns};

fn text(line: &str, fields: &[&str]) -> String {
    format!("{line}TILT=NONE\n{}\n{}\n0 45 90\n0\n10 5 2\n", fields[..10].join(" "), fields[10..].join(" "))
}

fn effect_of(text: &str) -> Effect {
    let Ok(PhotometricFile { photometry, remarks, .. }) = read(text) else { return Fails };
    let scale = photometry.candela[0] / 10.0;
    for (value, written) in photometry.candela.iter().zip([10.0, 5.0, 2.0]) {
        assert!((value / written / scale - 1.0).abs() < 1e-12, "{text}");
    }
    match (remarks.warnings.len(), remarks.notes.len()) {
        (0, 0) => Scales(scale),
        (1, 0) => Warns(scale),
        (0, 1) => Notes(scale),
        _ => panic!("{text}: {remarks:?}"),
    }
}

#[test]
fn every_field_of_every_edition_counts_or_is_said() {
    let all = |effect| [effect; 5];
    let second = |old: Effect, reserved: Effect, code: Effect| [old, old, reserved, reserved, code];
    let table: &[(usize, &str, [Effect; 5])] = &[
        // Number of lamps and lumens per lamp have no effect.
        (0, "4", all(Scales(1.0))),
        (0, "0", all(Warns(1.0))),
        (0, "1.5", all(Warns(1.0))),
        (0, "-1", all(Fails)),
        (1, "800", all(Scales(1.0))),
        (1, "-1.0", all(Scales(1.0))),
        (1, "0", all(Warns(1.0))),
        (1, "-2", all(Warns(1.0))),
        (1, "10", all(Notes(1.0))),
        // Candela multiplier.
        (2, "2.5", all(Scales(2.5))),
        (2, "0", all(Fails)),
        (2, "-1", all(Fails)),
        // Numbers of angles.
        (3, "1", all(Fails)),
        (3, "2", all(Fails)),
        (3, "4", all(Fails)),
        (3, "3.5", all(Fails)),
        (4, "0", all(Fails)),
        (4, "2", all(Fails)),
        // Photometric type, units.
        (5, "0", all(Fails)),
        (5, "2", all(Scales(1.0))),
        (5, "3", all(Scales(1.0))),
        (5, "4", all(Fails)),
        (6, "1", all(Scales(1.0))),
        (6, "0", all(Fails)),
        (6, "3", all(Fails)),
        // Width, length, height.
        (7, "-.5", all(Scales(1.0))),
        (8, ".5", all(Warns(1.0))),
        (9, "x", all(Fails)),
        // Ballast factor.
        (10, ".9", all(Scales(0.9))),
        (10, "0", all(Fails)),
        (10, "-1", all(Fails)),
        // The editions differ in this field.
        (11, "1.10000", second(Scales(1.1), Warns(1.0), Scales(1.0))),
        (11, "1.00001", second(Scales(1.00001), Warns(1.0), Scales(1.0))),
        (11, "1.111", second(Scales(1.111), Warns(1.0), Scales(1.0))),
        (11, "1.11001", second(Scales(1.11001), Warns(1.0), Notes(1.0))),
        (11, ".95", second(Scales(0.95), Warns(1.0), Notes(1.0))),
        (11, "0", second(Warns(1.0), Warns(1.0), Notes(1.0))),
        (11, "-1", second(Fails, Warns(1.0), Notes(1.0))),
        (11, "x", all(Fails)),
        // Input watts have no effect.
        (12, "0", all(Scales(1.0))),
        (12, "-5", all(Scales(1.0))),
        (12, "x", all(Fails)),
    ];
    for line in LINES {
        assert_eq!(effect_of(&text(line, &FIELDS)), Scales(1.0), "{line}");
    }
    for (field, value, expected) in table {
        let mut fields = FIELDS;
        fields[*field] = value;
        for (line, expected) in LINES.iter().zip(expected) {
            let found = effect_of(&text(line, &fields));
            let near = match (found, *expected) {
                (Scales(a), Scales(b)) | (Warns(a), Warns(b)) | (Notes(a), Notes(b)) => (a / b - 1.0).abs() < 1e-12,
                (a, b) => a == b,
            };
            assert!(near, "field {field} is {value} in {line:?}: {found:?}, not {expected:?}");
        }
    }
}

#[test]
fn unclear_editions_are_read_with_a_warning_or_refused() {
    let with = |line: &str, second: &str| {
        let mut fields = FIELDS;
        fields[11] = second;
        effect_of(&text(line, &fields))
    };
    for (line, at_1, at_1_1) in [
        ("IESNA95\n", Scales(1.0), Warns(1.0)),
        ("IESNA:LM-63-1993\n", Warns(1.0), Warns(1.1)),
        ("IES:LM-63-2031\n", Warns(1.0), Warns(1.0)),
        ("\n \nIES:LM-63-2019\n", Scales(1.0), Scales(1.0)),
        ("a label\nIES:LM-63-2019\n", Warns(1.0), Warns(1.0)),
        ("a label\nanother label\n", Scales(1.0), Scales(1.1)),
        ("[TEST] no first line\n", Scales(1.0), Warns(1.1)),
        ("IESNA:LM-63\n[TEST] no year\n", Scales(1.0), Fails),
        ("a lamp\nIES LM-63 data\n", Scales(1.0), Scales(1.1)),
        ("\u{feff}IES:LM-63-2019\n", Scales(1.0), Scales(1.0)),
        ("IES:LM-63-2019\n[TEST] joined\n\u{feff}", Scales(1.0), Scales(1.0)),
    ] {
        assert_eq!((with(line, "1"), with(line, "1.1")), (at_1, at_1_1), "{line:?}");
    }
    let mut fields = FIELDS;
    fields[11] = "1.1";
    let error = read(&text("IESNA:LM-63\n", &fields)).unwrap_err().to_string();
    assert!(
        error.starts_with("lamp.ies:4:3: ") && error.contains("`IESNA:LM-63` does not name a known edition"),
        "{error}"
    );
}

#[test]
fn openings_follow_the_table_of_their_edition() {
    let flat = |width, length, height| Opening::Box { width, length, height };
    let (disk, tube) = (
        |diameter| Opening::Cylinder { diameter, height: 0.0 },
        |diameter, height| Opening::Cylinder { diameter, height },
    );
    let ball = |diameter| Opening::Sphere { diameter };
    let table = [
        // Size, opening until 1995, opening since 2002, each with whether a remark says that it is a substitute.
        ([0.0, 0.0, 0.0], (Opening::Point, false), (Opening::Point, false)),
        ([0.0, 0.0, 2.0], (Opening::Point, true), (Opening::Point, true)),
        ([2.0, 3.0, 0.0], (flat(2.0, 3.0, 0.0), false), (flat(2.0, 3.0, 0.0), false)),
        ([2.0, 3.0, 4.0], (flat(2.0, 3.0, 4.0), false), (flat(2.0, 3.0, 4.0), false)),
        ([-2.0, 0.0, 0.0], (disk(2.0), false), (disk(2.0), false)),
        ([-2.0, -2.0, 0.0], (disk(2.0), false), (disk(2.0), false)),
        ([-2.0, 0.0, 3.0], (tube(2.0, 3.0), false), (tube(2.0, 3.0), false)),
        ([-2.0, -2.0, 3.0], (tube(2.0, 3.0), false), (tube(2.0, 3.0), false)),
        ([-2.0, 0.0, -2.0], (ball(2.0), false), (flat(2.0, 0.0, 2.0), true)),
        ([-2.0, -2.0, -2.0], (ball(2.0), false), (ball(2.0), false)),
        ([-1.0, -8.0, -1.0], (ball(2.0), true), (ball(2.0), true)),
        ([0.0, 3.0, -2.0], (flat(2.0, 3.0, 2.0), true), (flat(2.0, 3.0, 2.0), true)),
        ([3.0, 0.0, -2.0], (flat(3.0, 2.0, 2.0), true), (flat(3.0, 2.0, 2.0), true)),
        ([-1.0, 4.0, 3.0], (tube(2.0, 3.0), true), (tube(2.0, 3.0), true)),
        ([4.0, -1.0, 3.0], (tube(2.0, 3.0), true), (tube(2.0, 3.0), true)),
        ([-1.0, 8.0, -1.0], (ball(2.0), true), (flat(1.0, 8.0, 1.0), true)),
        ([8.0, -1.0, -1.0], (ball(2.0), true), (flat(8.0, 1.0, 1.0), true)),
    ];
    for (size, old, new) in table {
        for edition in Edition::ALL {
            let expected = if edition >= Edition::E2002 { new } else { old };
            let (found, said) = opening(edition, size);
            let near = match (found, expected.0) {
                (Opening::Sphere { diameter: a }, Opening::Sphere { diameter: b }) => (a - b).abs() < 1e-12,
                (a, b) => a == b,
            };
            assert!(near && said.is_some() == expected.1, "{size:?} in {edition:?}: {found:?}, {said:?}");
        }
    }
}

#[test]
fn a_file_of_1000_lumens_has_a_hint() {
    // A uniform light of 1 cd has 4 pi lm.
    let even = |lumens: &str, multiplier: &str, candela: f64| {
        let text = format!(
            "IESNA91\nTILT=NONE\n1 {lumens} {multiplier} 2 1 1 2 0 0 0\n1 1 20\n0 180\n0\n{candela} {candela}\n"
        );
        read(&text).unwrap().normalization_hint
    };
    let candela = 1000.0 / (4.0 * std::f64::consts::PI);
    let hint = even("-1", "1", candela).unwrap();
    assert_eq!((hint.0.line, hint.0.column), (3, 3));
    assert!(hint.1.contains("exactly 1000 lm") && hint.1.contains("-m 2.5"), "{}", hint.1);
    assert!(even("-1", "1", 1.0009 * candela).is_some() && even("-1", "1", 0.9991 * candela).is_some());
    assert!(even("-1", "1", 1.002 * candela).is_none() && even("-1", "1", 0.998 * candela).is_none());
    assert!(even("-1", "2", 0.5 * candela).is_some());
    assert!(even("1000", "1", 0.7 * candela).unwrap().1.contains("700 lm from lamps of exactly 1000 lm"));
    assert!(even("1000", "1", 1.2 * candela).is_none(), "that is more than its lamps have");
    assert!(even("1000", "2.4", 0.7 * candela).is_none() && even("1100", "1", 0.7 * candela).is_none());
}
