//! Tests that one import lists all errors of a scene, and none that only follows from another one.

use crate::{broken::TABLE, common::bundle};
use femc_import::{ImportErrors, ImportFault, MAX_ERRORS, load_scene, load_scene_or_all_errors};
use proptest::prelude::*;

/// Returns the errors of the scene `t.mgf` beside these files.
fn errors(text: &str, files: &[(&str, &str)]) -> ImportErrors {
    let files = [&[("t.mgf", text)][..], files].concat();
    load_scene_or_all_errors(&bundle(&files), "t.mgf").expect_err("a scene with errors")
}

/// Returns the positions of the errors of a scene, `line:column`.
fn positions(text: &str) -> Vec<String> {
    errors(text, &[]).errors.iter().map(|error| format!("{}:{}", error.at.line, error.at.column)).collect()
}

/// Pieces of a scene with faults. Each `!` before a line stands for one error of the line. `#` stands for a number that no other
/// piece has. The lines after an error in a piece use the name that the faulty line should have defined.
const PIECES: &[&str] = &[
    "!m no#\nm no#\n\trd .5\nsph a 1",
    "!m copy# = no#\n\trd .5\nm copy#\nsph a 1",
    "!m a b#\nsph a 1",
    "m dull# =\n!\trd 1.5\n!\tsides 3\n!\trs .5\n\ted 3\nsph a 1",
    "m maps# =\n!\tmap_rd lost#.png\n\tmap_ed lost#.png\n!\tmap_n \"half#.png\nsph a 1",
    "!f a b no#\nf no# a b\nf no# no# no#",
    "!v w# = no#\nring w# 1 2\nring no# 1 2\nprism w# w# w# 1",
    "v w# =\n!\tp 0 x# 0\ncyl w# 1 a\ncone a 1 w# 2\ntorus w# 1 2",
    "v w# =\n!\tn 1 2\nring w# 1 2",
    "!!cyl no# 1 no#x\nprism no# no#x no# 1",
    "!sph a 0\n!ring a 2 1\n!cyl a 1 a",
    "!c no#\n\tcxy .3 .3\nc no#\nm m# =\n\trd .5",
    "!c mixed# = no#\n!\tcxy .7 .6\nc other# =\n\tcmix 1 mixed# 1 no#",
    "c m# =\n!\tcmix 1 no#\nc other# =\n\tcmix 1 m#\nc",
    "!xf -ty #\nxf -t 1 0 0\nsph a 1\nxf\nxf",
    "!xf -path no#\nsph a 1\nxf\nxf -path no#\nxf",
    "!xf -a 1e6 -t 1 0 0 -a 1e6 -t 0 1 0\nsph a 1\nxf",
    "!o a b #\no inner\nsph a 1\no\no",
    "!xf\n!o",
    "!camera view# = no#\n\ttarget 0 0 0\ncamera view#\n\tup 0 0 1",
    "camera view# =\n!\ttarget 0 0\n",
    "camera view# =\n\ttarget 0 1 0\n!\tfov 180\n!\tfilm 0 1\n!\talong no#\n\talong no#",
    "!camera parallel# =\n\ttarget 0 0 5",
    "!mbox no# 0 0 0 1 1 1\nmglobal no#\nm body# =\n\tinside no#",
    "medium fog# =\n!\tphase mie\n!\tsigma_s -1\n\tglow 3\nmglobal fog#",
    "!path p# = cubic\n\tkey 0\n\tkey 1 -t 1 0 0\nxf -path p#\nxf",
    "path p# = linear\n!\tkey x",
    "!path bare# = linear",
    "path p# = linear\n\tkey 0\n!\tkey 0\n\tkey 1\n!path p# = linear",
    "!ies lost#.ies\nies lost#.ies -t 0 0 1",
    "!ies bad.ies -t # 0 0",
    "!vary a.b# 0 1\n!vary a.b = 0 1 0 #",
    "!time 5 1 24\n!time 0 1 0",
    "!mbox gas 0 0 0 # 1 0\n!xf -s 0\nmglobal gas\nxf",
];

/// Returns the line of each planted error.
fn planted_lines(text: &str) -> Vec<u32> {
    let count = |line: &str| line.len() - line.trim_start_matches('!').len();
    (1..).zip(text.lines()).flat_map(|(n, line)| std::iter::repeat_n(n, count(line))).collect()
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 300, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn planted_faults_are_listed_one_by_one_in_order_of_place(picks in prop::collection::vec(0..PIECES.len(), 1..30)) {
        let mut text = String::from("medium gas =\nsigma_s 1\nv a =\nv b =\n\tp 1 0 0\nm plain =\n\trd .5\n");
        let mut lamp_is_bad = false;
        for (n, &pick) in picks.iter().enumerate() {
            // The error of a file is reported where the file is used first.
            let piece = PIECES[pick];
            let piece = if lamp_is_bad && piece.contains("bad.ies") { piece.replace('!', "") } else { piece.to_owned() };
            lamp_is_bad |= piece.contains("bad.ies");
            text.push_str(&piece.replace('#', &format!("{n}")));
            text.push('\n');
        }
        let planted = planted_lines(&text);
        let text = text.replace('!', "");
        let listed = errors(&text, &[("bad.ies", "no photometry")]);
        let lines: Vec<u32> = listed.errors.iter().filter(|error| error.at.file == "t.mgf").map(|error| error.at.line).collect();
        // The fault of the lamp is in its own file.
        let of_lamp = listed.errors.iter().filter(|error| error.at.file == "bad.ies").count();
        prop_assert_eq!(of_lamp, usize::from(lamp_is_bad));
        let planted: Vec<u32> = planted.into_iter().filter(|&n| !text.lines().nth(n as usize - 1).is_some_and(|line| line.contains("bad.ies"))).take(MAX_ERRORS).collect();
        if listed.complete {
            prop_assert_eq!(lines, planted, "{}\n{:#?}", text, listed.errors);
        }
    }
}

#[test]
fn each_piece_lists_its_errors_including_that_of_a_plain_import() {
    for piece in PIECES {
        let text = format!("medium gas =\nsigma_s 1\nv a =\nv b =\n\tp 1 0 0\n{}", piece.replace('#', "7"));
        let planted = planted_lines(&text);
        let text = text.replace('!', "");
        let listed = errors(&text, &[("bad.ies", "no photometry")]);
        let lines: Vec<u32> = listed.errors.iter().map(|error| error.at.line).collect();
        if !piece.contains("bad.ies") {
            assert_eq!(lines, planted, "{text}\n{:#?}", listed.errors);
        }
        assert!(listed.complete);
        let first = load_scene(&bundle(&[("t.mgf", &text), ("bad.ies", "no photometry")]), "t.mgf").unwrap_err();
        assert!(listed.errors.contains(&first), "{first}");
    }
}

#[test]
fn a_scene_with_one_fault_lists_one() {
    for (what, text, at, _) in TABLE {
        // A name with blanks, an unclosed object and similar faults. The table has one error per scene.
        let listed = errors(
            text,
            &[
                ("closes.mgf", "xf\n"),
                ("part.mgf", "v a =\np x 0 0\n"),
                ("lamp.ies", "TILT=NONE\n1 1 1 2 1 1 1 0 0 0 1 1 1 0 90 0 5 5\n"),
                ("short.ies", "TILT=NONE\n1 1 1 2 1 1 1 0 0 0 1 1 1 0 90 0 5\n"),
            ],
        );
        let places: Vec<String> = listed.errors.iter().map(|error| error.at.to_string()).collect();
        assert_eq!(places, [*at], "{what}: {:#?}", listed.errors);
    }
}

#[test]
fn all_undefined_materials_are_named_once_with_their_definition() {
    let text = "v a =\nm oak\nsph a 1\nm slate\nsph a 1\nm oak\nsph a 1\nm wool\nf a a x a y\n";
    let listed = errors(text, &[]);
    let said: Vec<String> = listed.errors.iter().map(ToString::to_string).collect();
    assert_eq!(positions(text), ["2:3", "4:3", "8:3", "9:7", "9:11"]);
    for (line, name) in said.iter().zip(["oak", "slate", "wool"]) {
        assert!(line.contains(&format!("undefined material `{name}`; define it before this line")), "{line}");
        assert!(line.contains(&format!("`m {name} =` and `rd r`")), "{line}");
    }
}

#[test]
fn late_definition_is_an_error_only_at_the_first_use() {
    let text = "v a =\nm oak\nsph a 1\nm oak =\n\trd .5\nm oak\nxf -path p\nxf\npath p = linear\nkey 0\nring x 1 2\nv x =\nring x 1 2\n";
    assert_eq!(positions(text), ["2:3", "7:10", "11:6", "13:6"]);
}

#[test]
fn names_that_a_skipped_include_may_define_are_no_errors() {
    let text =
        "i lost.mgf\nm oak\n\trd 2\nf a b c\nfov 40\nsigma_s 1\nkey 0\ncamera main\n\torigin 0 0 0\ni lost.mgf\n";
    assert_eq!(positions(text), ["1:3", "3:5"]);
}

#[test]
fn errors_in_includes_follow_the_includer_and_are_listed_once() {
    let listed = errors("i part.mgf\ni part.mgf -t 0 0 1\nrd 2\n", &[("part.mgf", "v a =\np x\nm no\n")]);
    let places: Vec<String> = listed.errors.iter().map(|error| error.at.to_string()).collect();
    assert_eq!(places, ["t.mgf:3:4", "part.mgf:2:1", "part.mgf:3:3"]);
}

#[test]
fn error_list_ends_at_100_errors_or_the_memory_limit() {
    let listed = errors(&"rd 2\n".repeat(MAX_ERRORS + 50), &[]);
    assert_eq!((listed.errors.len(), listed.complete), (MAX_ERRORS, false));
    let listed = errors("v a =\nrd 2\nxf -a 1e8 -t 1 0 0\nsph a 1\nsph a 1\nxf\nrd 2\n", &[]);
    assert!(matches!(*listed.errors[1].fault, ImportFault::TooManyPrimitives { .. }), "{listed:#?}");
    assert_eq!((listed.errors.len(), listed.complete), (2, false));
}
