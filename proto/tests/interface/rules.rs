//! Tests that every element of the interface is documented and follows the rules of buf's categories STANDARD and COMMENTS, with
//! the exceptions below. (`proto/lint` runs buf itself if it is available.)

use crate::elements::{Element, Kind, elements, file};

/// Exception to buf's rule that a service name ends in `Service`: the name is part of every call's path on the wire.
const SERVICES: [&str; 3] = ["Jobs", "Workers", "Artifacts"];

/// Exception to buf's rule that a call `X` uses `XRequest` and `XResponse`, each only once: both sides of a session share its
/// messages, and several calls return a job's status.
const NAME_EXCEPTIONS: [&str; 3] = ["Jobs.Status", "Jobs.Watch", "Workers.Session"];

fn all() -> Vec<Element> {
    elements(&file())
}

/// Returns the names of the elements that violate `rule`.
fn violations(mut rule: impl FnMut(&Element) -> bool) -> Vec<String> {
    all().into_iter().filter(|element| !rule(element)).map(|element| element.name).collect()
}

fn is_pascal(name: &str) -> bool {
    name.starts_with(|c: char| c.is_ascii_uppercase()) && name.chars().all(|c| c.is_ascii_alphanumeric())
}

fn is_snake(name: &str) -> bool {
    let is_part = |c: char| c.is_ascii_lowercase() || c.is_ascii_digit() || c == '_';
    name.starts_with(|c: char| c.is_ascii_lowercase())
        && name.chars().all(is_part)
        && !name.contains("__")
        && !name.ends_with('_')
}

/// Converts `JobState` to `JOB_STATE`.
fn screaming(name: &str) -> String {
    let mut out = String::new();
    for c in name.chars() {
        if c.is_ascii_uppercase() && !out.is_empty() {
            out.push('_');
        }
        out.push(c.to_ascii_uppercase());
    }
    out
}

#[test]
fn every_element_has_a_comment_of_whole_sentences() {
    assert!(all().len() > 350, "the walk finds them");
    let undocumented = violations(|element| element.comment.len() > 3);
    assert!(undocumented.is_empty(), "no comment: {undocumented:?}");
    let unfinished = violations(|element| element.comment.ends_with('.'));
    assert!(unfinished.is_empty(), "no full stop: {unfinished:?}");
}

#[test]
fn every_call_says_who_may_call_it() {
    let silent =
        violations(|element| !matches!(element.kind, Kind::Call { .. }) || element.comment.contains("Who may: "));
    assert!(silent.is_empty(), "{silent:?}");
}

#[test]
fn names_are_written_as_the_rules_have_them() {
    let badly = violations(|element| match element.kind {
        Kind::Service | Kind::Call { .. } | Kind::Message | Kind::Enum => is_pascal(element.last()),
        Kind::Field { .. } | Kind::Oneof => is_snake(element.last()),
        Kind::Value { .. } => {
            let enum_name = element.name.rsplit('.').nth(1).expect("a value's enum");
            element.last().strip_prefix(&screaming(enum_name)).is_some_and(|rest| rest.starts_with('_'))
        }
    });
    assert!(badly.is_empty(), "{badly:?}");
    let services: Vec<String> = violations(|element| element.kind != Kind::Service);
    assert_eq!(services, SERVICES, "a new service ends in `Service`");
}

#[test]
fn an_enum_s_value_0_says_nothing() {
    let badly = violations(|element| match element.kind {
        Kind::Value { number } => (number == 0) == element.last().ends_with("_UNSPECIFIED"),
        _ => true,
    });
    assert!(badly.is_empty(), "{badly:?}");
}

#[test]
fn a_call_s_messages_are_its_own_and_named_after_it() {
    let badly = violations(|element| match &element.kind {
        Kind::Call { request, reply } if !NAME_EXCEPTIONS.contains(&element.name.as_str()) => {
            let named =
                |text: &str, end: &str| text.trim_start_matches("stream ") == format!("{}{end}", element.last());
            named(request, "Request") && named(reply, "Reply")
        }
        _ => true,
    });
    assert!(badly.is_empty(), "{badly:?}");
}

#[test]
fn the_package_has_a_version_and_the_file_lies_under_its_name() {
    let file = file();
    assert_eq!((file.package(), file.syntax(), file.name()), ("femc.v1", "proto3", "femc/v1/femc.proto"));
}
