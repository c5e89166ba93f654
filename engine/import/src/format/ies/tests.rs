mod commas;
mod editions;
mod flux;

use super::*;
use femc_scene::{Opening, PhotometryType};

fn read(text: &str) -> Result<PhotometricFile, ImportError> {
    parse("lamp.ies", text.as_bytes(), &mut |name| match name {
        "bend.tlt" => Ok((name.to_owned(), Arc::new(b"1\n3\n0 45 90\n1 .9 .5\nEND\n".to_vec()))),
        "commas.tlt" => Ok((name.to_owned(), Arc::new(b"1\n3\n0 45 90\n1 0,9 0,5\n".to_vec()))),
        "long.tlt" => Ok((name.to_owned(), Arc::new(b"1\n3\n0 45 90\n1 .9 .5 .1\n".to_vec()))),
        _ if name.len() > 100 => crate::files::resolve("lamp.ies", name).map(|path| (path, Arc::default())),
        _ => Err(ImportFault::Unreadable { path: name.to_owned(), reason: "not found".into(), near: None }),
    })
}

/// Returns the warnings of a file.
fn warnings(lamp: &PhotometricFile) -> Vec<&str> {
    lamp.remarks.warnings.iter().map(|(_, what)| &**what).collect()
}

/// Formats a file from type, sizes and angle lists; intensities count up from 1.
fn file(header: &str, kind: u32, size: &str, vertical: &str, horizontal: &str) -> String {
    let count = |list: &str| list.split_whitespace().count();
    let (v, h) = (count(vertical), count(horizontal));
    let candela: Vec<String> = (1..=v * h).map(|i| i.to_string()).collect();
    format!("{header}1 1000 2 {v} {h} {kind} 2 {size}\n1 1 100\n{vertical}\n{horizontal}\n{}\n", candela.join("\n"))
}

const C: &str = "IESNA:LM-63-2002\n[TEST] t\nTILT=NONE\n";

#[test]
fn all_header_variants_read_the_same() {
    let bodies = ["", "IESNA91\n[TEST]\n", "IESNA:LM-63-1995\n[A] b\n[MORE] c\n", C, "IES:LM-63-2019\r\n[X] y\r\n"];
    for body in bodies {
        let header = if body.contains("TILT") { body.to_owned() } else { format!("{body}TILT=NONE\r\n") };
        let lamp = read(&file(&header, 1, "0 0 0", "0 90 180", "0")).unwrap();
        assert_eq!(lamp.photometry.candela, [2.0, 4.0, 6.0], "{body:?}");
        assert!(lamp.remarks == Remarks::default() && lamp.tilt.is_none());
    }
}

#[test]
fn types_a_b_and_c_have_their_own_ranges() {
    for (code, kind) in [(1, PhotometryType::C), (2, PhotometryType::B), (3, PhotometryType::A)] {
        let (vertical, horizontal) = if code == 1 { ("0 90", "0 90 180") } else { ("-90 0 90", "-90 0 90") };
        let photometry = read(&file(C, code, "0 0 0", vertical, horizontal)).unwrap().photometry;
        assert_eq!(photometry.kind, kind);
        let stride = photometry.vertical.len();
        assert_eq!(photometry.candela[stride], 2.0 * (stride as f64 + 1.0), "second plane follows the first");
    }
    assert!(read(&file(C, 1, "0 0 0", "-90 90", "0")).is_err(), "type C has no negative angles");
    assert!(read(&file(C, 2, "0 0 0", "0 180", "0 90")).is_err(), "type B ends at 90");
}

#[test]
fn factors_multiply_and_feet_become_metres() {
    let text = "TILT=NONE\n1 -1 10 2 1 1 1 1 2 .5\n.5 .8 60\n0 90\n0\n100 50\n";
    let PhotometricFile { photometry, .. } = read(text).unwrap();
    assert_eq!(photometry.candela, [400.0, 200.0]);
    assert_eq!(photometry.opening, Opening::Box { width: 0.3048, length: 0.6096, height: 0.1524 });
}

#[test]
fn openings_follow_the_signs_of_their_sizes() {
    let opening = |size: &str| {
        let lamp = read(&file(C, 1, size, "0 90", "0")).unwrap();
        (lamp.photometry.opening, lamp.remarks.warnings.len())
    };
    assert_eq!(opening("0 0 0"), (Opening::Point, 0));
    assert_eq!(opening(".5 2 0"), (Opening::Box { width: 0.5, length: 2.0, height: 0.0 }, 0));
    assert_eq!(opening("-.4 0 0"), (Opening::Cylinder { diameter: 0.4, height: 0.0 }, 0));
    assert_eq!(opening("-.4 -.4 0"), (Opening::Cylinder { diameter: 0.4, height: 0.0 }, 0));
    assert_eq!(opening("-.4 -.4 1.5"), (Opening::Cylinder { diameter: 0.4, height: 1.5 }, 0));
    assert!(matches!(opening("-.4 -.4 -.4"), (Opening::Sphere { diameter }, 0) if (diameter - 0.4).abs() < 1e-12));
    assert!(matches!(opening("-.4 -.9 0"), (Opening::Cylinder { diameter, .. }, 1) if (diameter - 0.6).abs() < 1e-12));
    assert_eq!(opening("-.4 2 -.4"), (Opening::Box { width: 0.4, length: 2.0, height: 0.4 }, 1));
    assert_eq!(opening("0 -.4 -.4"), (Opening::Box { width: 0.0, length: 0.4, height: 0.4 }, 1));
    assert_eq!(opening("0 3 0"), (Opening::Point, 1));
}

#[test]
fn numbers_may_stand_on_any_line() {
    let text = "TILT=NONE\n1\n1000,1 2\n\n1 1 2 0 0 0 1 1\n1 0\n90 0 7\n\n8\n";
    let lamp = read(text).unwrap();
    assert_eq!(lamp.photometry.candela, [7.0, 8.0]);
    assert!(lamp.remarks == Remarks::default());
}

#[test]
fn tilt_is_read_in_place_or_from_its_file_and_interpolates() {
    let inline = read(&file("TILT=INCLUDE\n1\n3\n0 45 90\n1 .9 .5\n", 1, "0 0 0", "0 90", "0")).unwrap().tilt.unwrap();
    let named = read(&file("TILT=bend.tlt\n", 1, "0 0 0", "0 90", "0")).unwrap().tilt.unwrap();
    assert_eq!(inline, named);
    assert!((named.factor(22.5) - 0.95).abs() < 1e-12);
    assert_eq!([named.factor(-5.0), named.factor(45.0), named.factor(120.0)], [1.0, 0.9, 0.5]);
    let missing = read(&file("TILT=none.tlt\n", 1, "0 0 0", "0 90", "0")).unwrap_err();
    assert_eq!((missing.at.line, missing.at.column), (1, 1));
}

#[test]
fn an_open_circle_is_closed_by_its_first_plane() {
    let lamp = read(&file(C, 1, "0 0 0", "0 90", "0 90 180 270")).unwrap();
    assert_eq!(lamp.photometry.horizontal, [0.0, 90.0, 180.0, 270.0, 360.0]);
    assert_eq!(lamp.photometry.candela[8..], lamp.photometry.candela[..2]);
    assert_eq!(lamp.remarks.warnings.len(), 1);
}

#[test]
fn odd_files_are_taken_with_a_remark() {
    for text in [
        file(C, 1, "0 0 0", "0 60", "0"),
        file(C, 1, "0 0 0", "0 90", "0 45"),
        file(C, 1, "0 0 0", "0 90", "0 100"),
        file(C, 1, "0 0 0", "0 90", "20 140 260"),
        "TILT=NONE\n1 -1 1 2 1 1 2 0 0 0 1 0 1 0 90 0 5 5\n".into(),
        "TILT=NONE\n1 -1 1 2 1 1 2 0 0 0 1 1 1 0 90 0 5 -5\n".into(),
        "TILT=NONE\n1 -1 1 2 1 1 2 0 0 0 1 1 1 0 90 0 0 0\n".into(),
    ] {
        let lamp = read(&text).unwrap();
        assert_eq!(warnings(&lamp).len(), 1, "{text}: {:?}", warnings(&lamp));
    }
}

/// Unknown intensities between planes would change the flux, so they are rejected.
#[test]
fn planes_that_start_anywhere_are_refused() {
    for horizontal in ["90 180", "180 270 360", "45 90 135", "10 80", "180 360"] {
        let error = read(&file(C, 1, "0 0 0", "0 90", horizontal)).unwrap_err();
        assert!(error.to_string().starts_with("lamp.ies:7:1: first horizontal angle is "), "{error}");
    }
    for horizontal in ["37", "90 180 270", "0 90", "0 90 180", "0 180 360"] {
        assert_eq!(read(&file(C, 1, "0 0 0", "0 90", horizontal)).unwrap().remarks.warnings.len(), 0, "{horizontal}");
    }
}

#[test]
fn nothing_may_follow_the_last_intensity_but_end() {
    let good = file(C, 1, "0 0 0", "0 90", "0");
    for tail in ["END", "END\n", "\n\n end \n", "[END]\n", "  \n\n", ","] {
        assert_eq!(read(&(good.clone() + tail)).map(|lamp| lamp.remarks), Ok(Remarks::default()), "{tail:?}");
    }
    for (tail, says) in [
        ("17", "lamp.ies:10:1: 1 number follows the last intensity that the file announces"),
        ("\n17 18\n19 END", "lamp.ies:11:1: 3 numbers follow"),
        ("IESNA91\n", "lamp.ies:10:1: `IESNA91` follows"),
        ("END 5", "`END` follows"),
        ("ENDS", "`ENDS` follows"),
        ("[MORE] text", "`[MORE]` follows"),
    ] {
        let error = read(&(good.clone() + tail)).unwrap_err().to_string();
        assert!(error.contains(says) && error.contains("remove the extra data"), "{tail:?}: {error}");
    }
    let error = read(&good.replace("NONE", "long.tlt")).unwrap_err().to_string();
    assert!(error.starts_with("long.tlt:4:9: 1 number follows the last tilt factor"), "{error}");
}

#[test]
fn messages_have_the_start_of_a_long_text() {
    let good = file("IESNA:LM-63\nTILT=NONE\n", 1, "0 0 0", "0 90", "0");
    let long = "x".repeat(10_000);
    let digits = "5".repeat(10_000);
    for text in [
        good.replace("1 1 100", "1 1.1 100").replace("LM-63", &format!("LM-63 {long}")),
        good.replace("1 1 100", &format!("1 1 {long}")),
        format!("{good}{long}"),
        good.replace("0 90", &format!("0 ,{digits}")),
        good.replace("1 1 100", &format!("0,{digits} 1 100")),
        good.replace("NONE", &long),
        good.replace("NONE", &format!("/{long}")),
    ] {
        let error = read(&text).unwrap_err().to_string();
        assert!(error.len() < 400 && error.contains("..."), "{} bytes: {error:.500}", error.len());
    }
    let warned = read(&good.replace("LM-63", &format!("LM-63-2031 {long}"))).unwrap();
    assert!(warnings(&warned)[0].len() < 200, "{:?}", warnings(&warned));
}

#[test]
fn faults_name_line_and_column() {
    let good = "TILT=NONE\n1 1000 1 2 1 1 2 0 0 0\n1 1 100\n0 90\n0\n7 8\n";
    for (from, to, line, column) in [
        ("TILT=NONE", "TILTED", 6, 0),
        ("1 1000 1 2 1 1 2", "1 1000 1 2 1 4 2", 2, 14),
        ("1 1000 1 2 1 1 2", "1 1000 1 2 1 1 3", 2, 16),
        ("1 1000 1 2 1 1 2", "1 1000 1 2.5 1 1 2", 2, 10),
        ("1 1000 1 2 1 1 2", "1 1000 1 999999999 1 1 2", 2, 10),
        ("1 1000 1", "1 1000 x", 2, 8),
        ("1 1000 1", "1 1000 1e999", 2, 8),
        ("0 90", "90 0", 4, 4),
        ("0 90", "0 0", 4, 3),
        ("7 8", "7", 7, 1),
        ("7 8", "7 nan", 6, 3),
        ("1 1 100", "0 1 100", 3, 1),
        ("1 1000 1 2", "1 1000 0 2", 2, 8),
        ("1 1000 1 2", "1 1000 1 1", 2, 10),
        ("TILT=NONE", "TILT=", 1, 1),
    ] {
        let error = read(&good.replacen(from, to, 1)).unwrap_err();
        assert_eq!((error.at.line, error.at.column), (line, column), "{to}: {error}");
    }
    assert!(read("").is_err());
}
