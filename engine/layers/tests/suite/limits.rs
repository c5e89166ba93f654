//! Limits of expressions, on both sides of each, and the texts of errors.

use femc_layers::{Automaton, EventKind, Expression, Feature, LabelSet, Layer, LayerError, MAX_LAYERS, parse_layers};

fn position_of_error(text: &str) -> Option<usize> {
    Expression::parse(text).err().map(|error| error.position)
}

#[test]
fn an_expression_has_at_most_4096_characters() {
    assert_eq!(position_of_error(&format!("C{}", "D".repeat(4095))), None);
    assert_eq!(position_of_error(&format!("C{}", "D".repeat(4096))), Some(4096));
}

#[test]
fn parentheses_are_nested_at_most_64_deep() {
    let nested = |depth| format!("C{}D{}L", "(".repeat(depth), ")".repeat(depth));
    assert_eq!(position_of_error(&nested(64)), None);
    assert_eq!(position_of_error(&nested(65)), Some(65));
    assert_eq!(position_of_error(&format!("C{}L", "(D)".repeat(200))), None, "one after the other");
}

#[test]
fn repetitions_are_written_out_to_at_most_2048_events() {
    assert_eq!(position_of_error("CD{64}L"), None);
    assert_eq!(position_of_error("CD{65}L"), Some(2));
    for event in ["D", "<RD>", "[DG]", "'a'"] {
        // With the camera, 31 times 64 events and 63 events are 2048.
        let most = format!("C{}{event}{{63}}", format!("{event}{{64}}").repeat(31));
        assert_eq!(position_of_error(&most), None, "{event}");
        let repetition = most.rfind('{');
        assert_eq!(position_of_error(&most.replace("{63}", "{64}")), repetition, "{event}");
        assert_eq!(position_of_error(&most.replace("{63}", "{0,64}")), repetition, "{event}");
        assert_eq!(position_of_error(&most.replace('C', "CV")), repetition.map(|at| at + 1), "{event}");
    }
}

#[test]
fn a_frame_has_at_most_64_layers() {
    let layers = |count: usize| (0..count).map(|n| Layer::new(format!("layer{n}"), "CL")).collect::<Vec<_>>();
    assert_eq!(parse_layers(&layers(MAX_LAYERS)).map(|all| all.len()), Ok(64));
    assert_eq!(parse_layers(&layers(65)), Err(LayerError::TooManyLayers(65)));
}

#[test]
fn an_automaton_of_thousands_of_states_is_accepted() {
    // Knowing whether the eleventh event from the end is diffuse takes a state for each subset of eleven events.
    let layers = [Layer::new("deep", format!("C.*D{}", ".".repeat(10)))];
    let vocabulary = Automaton::vocabulary(&layers).unwrap();
    let automaton = Automaton::new(&layers, &vocabulary, [LabelSet::default()]).unwrap();
    assert!(automaton.states() >= 1 << 11, "{} states", automaton.states());
}

#[test]
fn a_backslash_before_a_letter_is_a_character() {
    for (text, label) in [(r"C'a\b'L", r"a\b"), (r"C'a\'b'L", "a'b"), (r"C'a\\b'L", r"a\b"), (r"C'\a\'L'L", r"\a'L")] {
        let expression = Expression::parse(text).unwrap_or_else(|error| panic!("{text}: {error}"));
        assert_eq!(expression.events()[1].labels().collect::<Vec<_>>(), [label], "{text}");
    }
    assert_eq!(position_of_error(r"C'a\"), Some(4));
    assert_eq!(position_of_error(r"C'a\'"), Some(5));
}

#[test]
fn errors_name_the_expected_text() {
    for (text, said) in [
        ("", "found nothing; expected an event"),
        ("C(", "found the end of the expression; expected an event"),
        ("CUL", "user lobes (`U`) do not exist here"),
        ("C({2})L", "an event before the repetition"),
        ("CD&L", "for paths that match two expressions"),
        ("C<[x]D>L", "expected a type"),
        ("C<[Rx]D>L", "expected another letter, or `]`"),
        ("C<R[Dx]>L", "expected another letter, or `]`"),
        ("C<R[x]>L", "expected a scattering"),
        ("C<L.desk>", "label in straight single quotes, like <L.'key'>"),
        ("C<L.Lamp>", "label in straight single quotes, like <L.'key'>"),
        ("C<L.\"key\">", "expected an event, or a label in straight single quotes"),
        ("C<RD%>L", "expected a label in quotes, or `>`"),
        ("C<RD'a'%>L", "expected `>`"),
        ("CD)L", "this parenthesis closes nothing"),
    ] {
        let error = Expression::parse(text).map(|found| panic!("{text}: {found:?}")).unwrap_err().to_string();
        assert!(error.contains(said), "{text}: {error}");
    }
}

#[test]
fn an_event_may_match_with_some_labels() {
    let second = |text: &str| Expression::parse(text).unwrap().events()[1].clone();
    // Light at a place without `a` and with `b` matches. The label of the reflection is of no concern to it.
    assert!(second("C[^'a'<L.[^'b']><RD'b'>]").may_match(EventKind::Light));
    assert!(!second("C[^<L.>]").may_match(EventKind::Light));
    let anywhere = second("C<L.'a'>").with_any_kind();
    for kind in EventKind::ALL {
        assert!(anywhere.matches(kind, |label| label == "a") && !anywhere.matches(kind, |_| false), "{kind:?}");
    }
}

#[test]
fn features_have_the_channels_of_their_numbers() {
    for (name, channels, matte) in [
        ("normal", &["X", "Y", "Z"][..], None),
        ("position", &["X", "Y", "Z"], None),
        ("depth", &["Z"], None),
        ("albedo", &["R", "G", "B"], None),
        ("motion", &["X", "Y"], None),
        ("object", &[], Some("crypto_object")),
        ("material", &[], Some("crypto_material")),
        ("first_pass_error", &["Y"], None),
    ] {
        let feature = Feature::from_name(name).unwrap();
        assert_eq!((feature.channels(), feature.cryptomatte_name()), (channels, matte), "{name}");
    }
    assert_eq!(Feature::NAMES.len(), 8);
}
