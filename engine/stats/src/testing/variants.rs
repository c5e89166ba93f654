//! Completeness of a list of test cases: every variant of an enum has one.

use std::collections::BTreeSet;
use std::fmt::Debug;

/// Asserts that `cases` has a value of each variant of an enum, so that a new variant cannot be left out of the laws.
/// - `source`: Rust source that declares the enum, at the margin: `include_str!("mod.rs")`;
/// - `name`: name of the enum;
/// - `exempt`: variants that need no case.
///
/// The enum's `Debug` must print the name of the variant first, as the derived one does.
///
/// # Panics
/// If a variant has no case, if an exempt one has a case or does not exist, or if the source does not declare the enum.
pub fn assert_covers<T: Debug>(source: &str, name: &str, exempt: &[&str], cases: impl IntoIterator<Item = T>) {
    let declared = variants(source, name);
    let mut expected: BTreeSet<String> = declared.iter().cloned().collect();
    for variant in exempt {
        assert!(expected.remove(*variant), "{name} has no variant {variant}");
    }
    let first_word =
        |text: String| text.split(|c: char| !c.is_alphanumeric() && c != '_').next().unwrap_or("").to_owned();
    let found: BTreeSet<String> = cases.into_iter().map(|case| first_word(format!("{case:?}"))).collect();
    assert_eq!(found, expected, "the cases (left) and the variants of {name} that need one (right) differ");
}

/// Returns the names of the variants of an enum that is declared at the margin of `source`.
fn variants(source: &str, name: &str) -> Vec<String> {
    let head = format!("pub enum {name} {{");
    let body = source.split_once(&head).map(|(_, rest)| rest.split("\n}").next().unwrap_or(""));
    let body = body.unwrap_or_else(|| panic!("the source does not declare enum {name}"));
    let is_variant =
        |line: &&str| line.starts_with("    ") && line.as_bytes().get(4).is_some_and(u8::is_ascii_uppercase);
    let name_of = |line: &str| line.trim().chars().take_while(|c| c.is_alphanumeric()).collect();
    body.lines().filter(is_variant).map(name_of).collect()
}

#[cfg(test)]
mod tests {
    use super::{assert_covers, variants};

    #[derive(Debug)]
    #[allow(dead_code)] // A field is read by Debug alone.
    pub enum Shape {
        Dot,
        Circle(f32),
        Box { width: f32 },
    }

    const SOURCE: &str = "
/// A shape.
pub enum Shape {
    /// A dot.
    Dot,
    #[default]
    Circle(f32),
    Box {
        /// Width.
        width: f32,
    },
}
pub enum Other {
    More,
}
";

    #[test]
    fn variants_are_read_from_the_source() {
        assert_eq!(variants(SOURCE, "Shape"), ["Dot", "Circle", "Box"]);
        assert_eq!(variants(SOURCE, "Other"), ["More"]);
    }

    #[test]
    fn a_list_with_all_variants_covers_the_enum() {
        assert_covers(SOURCE, "Shape", &[], [Shape::Dot, Shape::Circle(1.0), Shape::Box { width: 2.0 }, Shape::Dot]);
        assert_covers(SOURCE, "Shape", &["Dot"], [Shape::Circle(1.0), Shape::Box { width: 2.0 }]);
    }

    #[test]
    #[should_panic(expected = "the variants of Shape that need one")]
    fn a_missing_variant_is_found() {
        assert_covers(SOURCE, "Shape", &[], [Shape::Dot, Shape::Circle(1.0)]);
    }

    #[test]
    #[should_panic(expected = "Shape has no variant Line")]
    fn an_exempt_variant_must_exist() {
        assert_covers(SOURCE, "Shape", &["Line"], [Shape::Dot]);
    }
}
