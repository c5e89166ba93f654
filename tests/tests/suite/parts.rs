//! Compares the parts of `tests/all` with the manifests: a change must trigger the parts that it may have broken.

use super::crates::{members, root};
use std::collections::{BTreeMap, BTreeSet};

type Names = BTreeSet<String>;

/// A line of `tests/parts` with its groups expanded.
struct Part {
    name: String,
    counts: String,
    triggers: Names,
    exemptions: Names,
    command: String,
}

fn parts() -> Vec<Part> {
    let text = std::fs::read_to_string(root().join("tests/parts")).expect("tests/parts");
    let mut groups = BTreeMap::new();
    let mut parts = Vec::new();
    for line in text.lines().filter(|line| !line.is_empty() && !line.starts_with('#')) {
        if let Some((group, words)) = line.split_once(": = ") {
            groups.insert(group, words);
            continue;
        }
        let cells: Vec<&str> = line.splitn(6, '|').map(str::trim).collect();
        let [name, minutes, counts, due, without, command] = cells[..] else { panic!("a line of six columns: {line}") };
        assert!(minutes.parse::<u32>().is_ok_and(|minutes| minutes > 0), "{name}: {minutes} minutes");
        let words = |list: &str| -> Names {
            let mut words = Names::new();
            for word in list.split_whitespace() {
                let group =
                    word.strip_suffix(':').map(|name| groups.get(name).unwrap_or_else(|| panic!("no group {name}")));
                words.extend(group.unwrap_or(&word).split_whitespace().map(str::to_owned));
            }
            words
        };
        parts.push(Part {
            name: name.into(),
            counts: counts.into(),
            triggers: words(due),
            exemptions: words(without),
            command: command.into(),
        });
    }
    parts
}

#[test]
fn each_part_is_there_once_and_names_what_there_is() {
    let mut names = Names::new();
    for part in parts() {
        assert!(names.insert(part.name.clone()), "{} is there twice", part.name);
        for word in part.triggers.union(&part.exemptions) {
            assert!(root().join(word).exists(), "{}: there is no {word}", part.name);
        }
    }
}

#[test]
fn dependencies_of_part_make_it_due_or_are_named_as_exempt() {
    let members = members();
    for part in parts() {
        let mut reached = Names::new();
        for member in members.values().filter(|member| part.triggers.contains(&member.folder)) {
            let used = member.direct.iter().filter_map(|name| members.get(name));
            reached.extend(used.map(|used| used.folder.clone()));
        }
        let forgotten: Vec<_> =
            reached.iter().filter(|used| !part.triggers.contains(*used) && !part.exemptions.contains(*used)).collect();
        assert!(forgotten.is_empty(), "{}: its crates depend on {forgotten:?}, which it does not name", part.name);
        let both: Vec<_> = part.triggers.intersection(&part.exemptions).collect();
        assert!(both.is_empty(), "{}: {both:?} make it due and do not", part.name);
    }
}

#[test]
fn every_crate_makes_some_part_due() {
    // These are tests or tools of scripts. Every run of the tests covers them.
    const OTHERS: [&str; 3] = ["proto/generate", "tests", "tests/require"];
    let due: Names = parts().into_iter().flat_map(|part| part.triggers).collect();
    let members = members();
    let idle: Vec<_> = members.values().map(|member| &member.folder).filter(|folder| !due.contains(*folder)).collect();
    let idle: Vec<_> = idle.into_iter().filter(|folder| !OTHERS.contains(&folder.as_str())).collect();
    assert!(idle.is_empty(), "{idle:?}");
}

#[test]
fn a_part_of_tests_counts_tests() {
    for part in parts() {
        let is_of_tests = part.command.contains("suite ") || part.command.contains("cargo test");
        assert_eq!(part.counts == "tests", is_of_tests, "{}: it counts {}", part.name, part.counts);
        assert!(!part.counts.is_empty(), "{}: it counts nothing, which is `-`", part.name);
    }
}

#[test]
fn the_gate_checks_the_results_of_the_parts() {
    let gate = std::fs::read_to_string(root().join(".ci/run")).expect(".ci/run");
    assert!(gate.lines().any(|line| line == "tests/all --check"), ".ci/run does not check tests/proofs.tsv");
}

#[test]
fn what_a_command_names_is_there() {
    let folders: Vec<_> = members().into_values().map(|member| root().join(member.folder)).collect();
    for part in parts() {
        for word in part.command.split_whitespace() {
            if let Some(example) = word.strip_prefix("$bin/examples/") {
                let is_there = |path: &str| folders.iter().any(|folder| folder.join("examples").join(path).exists());
                assert!(
                    is_there(&format!("{example}.rs")) || is_there(&format!("{example}/main.rs")),
                    "{}: {word}",
                    part.name
                );
            }
            if let Some(module) = word.trim_end_matches('\'').strip_suffix("::") {
                let is_there =
                    folders.iter().any(|folder| folder.join("tests/suite").join(format!("{module}.rs")).exists());
                assert!(is_there, "{}: no suite has a module {module}", part.name);
            }
            if word.starts_with("tests/") || word.starts_with("sim/") {
                assert!(root().join(word).exists(), "{}: {word}", part.name);
            }
        }
    }
}
