//! Tests that the wire format stays compatible: `wire.txt` lists every call, field and value with its number and type.

use crate::elements::{Element, Kind, elements, file};
use std::collections::BTreeSet;
use std::path::Path;

/// Environment variable that makes the test rewrite the list, after an addition.
const WRITE: &str = "FEMC_WRITE_WIRE";

#[test]
fn known_wire_elements_remain_and_new_ones_are_listed() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/interface/wire.txt");
    let all = elements(&file());
    let now: Vec<String> = all.iter().map(Element::line).collect();
    let listed = std::fs::read_to_string(&path).unwrap_or_default();
    let listed: Vec<&str> = listed.lines().collect();
    let (known, found): (BTreeSet<&str>, BTreeSet<&str>) =
        (listed.iter().copied().collect(), now.iter().map(String::as_str).collect());
    let gone: Vec<&&str> = known.difference(&found).collect();
    assert!(gone.is_empty(), "old programs use these, which are gone or changed: {gone:#?}");
    if std::env::var_os(WRITE).is_some() {
        std::fs::write(&path, now.join("\n") + "\n").expect("the list is written");
        return;
    }
    let new: Vec<&&str> = found.difference(&known).collect();
    assert!(new.is_empty(), "new on the wire, and not in wire.txt ({WRITE}=1 writes it anew): {new:#?}");
}

#[test]
fn no_number_is_used_twice_in_a_message() {
    let mut used = BTreeSet::new();
    for element in elements(&file()) {
        let (Kind::Field { number, .. } | Kind::Value { number }) = element.kind else { continue };
        let within = element.name.rsplit_once('.').expect("its message").0.to_owned();
        assert!(used.insert((within, number)), "{} has the number {number} of another", element.name);
    }
}
