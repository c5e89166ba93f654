//! Tests of commas between numbers and within them.

use super::*;

const GOOD: &str = "IESNA:LM-63-2002\nTILT=INCLUDE\n1\n3\n0 45 90\n1 0.9 0.5\n1 9000.5 1.5 4 2 1 2 0.25 0.5 0.1\n0.95 1 20.5\n0 22.5 67.5 90\n0 \
                    90\n1200.5 900 500.25 0.5\n1100.5 800 400.25 0.5\n";

fn error(text: &str) -> String {
    read(text).map_or_else(|error| error.to_string(), |lamp| format!("read as {:?}", lamp.photometry.candela))
}

/// Returns the offsets of all decimal points among the numbers.
fn points() -> Vec<usize> {
    let start = GOOD.find("INCLUDE").unwrap();
    GOOD.match_indices('.').map(|(at, _)| at).filter(|&at| at > start).collect()
}

#[test]
fn each_decimal_comma_is_named_where_it_is() {
    assert!(read(GOOD).unwrap().remarks == Remarks::default());
    for at in points() {
        let mut text = GOOD.to_owned();
        text.replace_range(at..=at, ",");
        let start = text[..at].rfind([' ', '\n']).unwrap() + 1;
        let end = at + text[at..].find([' ', '\n']).unwrap();
        let line = text[..at].matches('\n').count() + 1;
        let column = start - text[..at].rfind('\n').unwrap();
        let error = error(&text);
        assert!(
            error.starts_with(&format!("lamp.ies:{line}:{column}: `{}`: decimal commas", &text[start..end])),
            "{error}"
        );
    }
}

#[test]
fn decimal_commas_all_over_a_file_are_named_at_the_first() {
    let first = GOOD.find("TILT").unwrap();
    let text = format!("{}{}", &GOOD[..first], GOOD[first..].replace('.', ","));
    assert!(error(&text).starts_with("lamp.ies:6:3: `0,9`: decimal commas"), "{}", error(&text));
    let separated = text.replace(' ', ", ");
    assert!(error(&separated).starts_with("lamp.ies:6:4: `0,9`: decimal commas"), "{}", error(&separated));
    let plain = text.replace("INCLUDE\n1\n3\n0 45 90\n1 0,9 0,5", "NONE");
    assert!(error(&plain).starts_with("lamp.ies:3:3: `9000,5`: decimal commas"), "{}", error(&plain));
}

#[test]
fn decimal_commas_beside_lists_with_commas_are_named() {
    let numbers = "1 900,5 1,5 4 1 1 2 0 0 0\n0,95 1 20,5\n0,30,60,90\n0\n";
    let list = format!("TILT=NONE\n{numbers}1200,900,500,0\n");
    assert!(error(&list).starts_with("lamp.ies:2:3: `900,5`: decimal commas"), "{}", error(&list));
    // The table is also too short, but the two lines above the angles already show the cause.
    let broken = format!("TILT=NONE\n{numbers}1200,900\n");
    assert!(error(&broken).starts_with("lamp.ies:2:3: `900,5`: decimal commas"), "{}", error(&broken));
}

/// A list of two angles, `0,90`, looks like a number with a decimal comma.
#[test]
fn left_over_numbers_are_decimal_commas_if_these_explain_them() {
    let text = |table: &str| format!("TILT=NONE\n1 -1 1 2 2 1 2 0 0 0\n1 1 20\n0,90\n0,90\n{table}\n");
    for (table, says) in [
        ("9,5,2,1\n7", "lamp.ies:7:1: 1 number follows the last intensity"),
        ("9 5 2 1 7", "lamp.ies:6:9: 1 number follows"),
        ("9 5 2 1 7 8", "lamp.ies:6:9: 2 numbers follow"),
        ("9 5 2 1 7 8 9", "lamp.ies:6:9: 3 numbers follow"),
        ("9 5 2 1\nlabel", "lamp.ies:7:1: `label` follows"),
        ("9 5,5 2 1", "lamp.ies:6:3: `5,5`: decimal commas"),
        ("9,5 5 2,25 1", "lamp.ies:6:1: `9,5`: decimal commas"),
        ("9,5 5,0 2,25 1,5", "lamp.ies:6:1: `9,5`: decimal commas"),
        ("9,5 5 2,25 1 7", "lamp.ies:6:9: 3 numbers follow"),
    ] {
        assert!(error(&text(table)).starts_with(says), "{table}: {}", error(&text(table)));
    }
}

#[test]
fn a_comma_before_a_number_may_be_a_fraction_and_is_refused() {
    let text = |table: &str| format!("TILT=NONE\n1 -1 1 3 1 1 2 0 0 0\n1 1 20\n0 45 90\n0\n{table}\n");
    for (table, column, found) in
        [("9 ,5 2", 3, ",5"), (",5 3 2", 1, ",5"), ("9 ,25 ,5", 3, ",25"), ("9,5,,5", 5, ",5")]
    {
        let expected = format!("lamp.ies:6:{column}: `{found}`: decimal commas");
        assert!(error(&text(table)).starts_with(&expected), "{table}: {}", error(&text(table)));
    }
    assert!(error(&text("9,, 5 2")).contains("a number is missing between commas"), "{}", error(&text("9,, 5 2")));
    let long = error("TILT=commas.tlt\n1 -1 1 2 1 1 2 0 0 0\n1 1 20\n0 90\n0\n1 2\n");
    assert!(long.starts_with("commas.tlt:4:3: `0,9`: decimal commas"), "{long}");
}

#[test]
fn commas_that_separate_work_with_and_without_blanks() {
    let expected = read(GOOD).unwrap();
    let start = GOOD.find("INCLUDE").unwrap() + 8;
    for separator in [",", ", ", " , ", ",\t", "\n", ",\n", "\n\n"] {
        let text = format!("{}{}", &GOOD[..start], GOOD[start..].trim_end().replace([' ', '\n'], separator));
        let lamp = read(&text);
        assert!(lamp.as_ref().is_ok_and(|lamp| lamp == &expected), "{separator:?}: {lamp:?}");
    }
}

#[test]
fn a_fault_beside_commas_that_separate_keeps_its_name() {
    let text = "TILT=NONE\n1,-1,1,3,1,1,2,0,0,0\n1,1,20\n0,45,90\n0\n9,x,2\n";
    assert!(error(text).starts_with("lamp.ies:6:3: `x` is not a number"), "{}", error(text));
    let short = "TILT=NONE\n1,-1,1,3,1,1,2,0,0,0\n1,1,20\n0,45,90\n0\n9,5\n";
    assert!(error(short).contains("the file ends before the intensity"), "{}", error(short));
}
