//! Tests of the automaton against an independent matcher: Brzozowski's derivatives of the expression tree, one event at a time.

mod dialect;

use femc_layers::{
    Automaton, DEAD_STATE, EventKind, Expression, LabelSet, Layer, LayerError, NO_LAYERS, Node, Preset, Symbol,
    Vocabulary,
};
use proptest::prelude::*;

/// A path: each event with the name of the thing where it happens.
type Word = Vec<(EventKind, &'static str)>;

/// Remaining part of an expression after some events.
#[derive(Clone, Debug)]
enum Remainder {
    Never,
    Done,
    Node(Node),
    Then(Box<Remainder>, Box<Remainder>),
    Either(Vec<Remainder>),
}

fn may_end(rest: &Remainder) -> bool {
    match rest {
        Remainder::Never => false,
        Remainder::Done => true,
        Remainder::Node(node) => is_nullable(node),
        Remainder::Then(one, other) => may_end(one) && may_end(other),
        Remainder::Either(all) => all.iter().any(may_end),
    }
}

fn is_nullable(node: &Node) -> bool {
    match node {
        Node::Event(_) => false,
        Node::Sequence(nodes) => nodes.iter().all(is_nullable),
        Node::Choice(nodes) => nodes.iter().any(is_nullable),
        Node::OneOrMore(node) => is_nullable(node),
        Node::ZeroOrMore(_) | Node::Optional(_) => true,
    }
}

fn then(one: Remainder, other: Remainder) -> Remainder {
    match (one, other) {
        (Remainder::Never, _) | (_, Remainder::Never) => Remainder::Never,
        (Remainder::Done, other) => other,
        (one, Remainder::Done) => one,
        (one, other) => Remainder::Then(Box::new(one), Box::new(other)),
    }
}

fn derivative(rest: &Remainder, event: (EventKind, &str)) -> Remainder {
    match rest {
        Remainder::Never | Remainder::Done => Remainder::Never,
        Remainder::Node(node) => node_derivative(node, event),
        Remainder::Then(one, other) => {
            let through = then(derivative(one, event), (**other).clone());
            if may_end(one) { Remainder::Either(vec![through, derivative(other, event)]) } else { through }
        }
        Remainder::Either(all) => Remainder::Either(all.iter().map(|one| derivative(one, event)).collect()),
    }
}

fn node_derivative(node: &Node, (kind, name): (EventKind, &str)) -> Remainder {
    match node {
        Node::Event(event) if event.matches(kind, |label| label == name) => Remainder::Done,
        Node::Event(_) => Remainder::Never,
        Node::Choice(nodes) => {
            Remainder::Either(nodes.iter().map(|node| node_derivative(node, (kind, name))).collect())
        }
        Node::Optional(node) => node_derivative(node, (kind, name)),
        Node::ZeroOrMore(inner) | Node::OneOrMore(inner) => {
            then(node_derivative(inner, (kind, name)), Remainder::Node(Node::ZeroOrMore(inner.clone())))
        }
        Node::Sequence(nodes) => {
            let Some((first, others)) = nodes.split_first() else { return Remainder::Never };
            let others = Remainder::Node(Node::Sequence(others.to_vec()));
            let through = then(node_derivative(first, (kind, name)), others.clone());
            if is_nullable(first) {
                Remainder::Either(vec![through, derivative(&others, (kind, name))])
            } else {
                through
            }
        }
    }
}

fn matches_word(expression: &Expression, word: &Word) -> bool {
    let mut rest = derivative(&Remainder::Node(expression.node().clone()), (EventKind::Camera, ""));
    for event in word {
        rest = derivative(&rest, *event);
    }
    may_end(&rest)
}

const NAMES: [&str; 3] = ["", "a", "b"];

fn automaton(layers: &[Layer]) -> (Automaton, Vocabulary) {
    let vocabulary = Automaton::vocabulary(layers).unwrap();
    let sets: Vec<LabelSet> = NAMES.iter().map(|name| vocabulary.label_set(&[*name])).collect();
    (Automaton::new(layers, &vocabulary, sets).unwrap(), vocabulary)
}

fn accepted((automaton, vocabulary): &(Automaton, Vocabulary), word: &Word) -> u64 {
    let state = word.iter().fold(automaton.start(), |state, (kind, name)| {
        automaton.next(state, automaton.label_offset(vocabulary.label_set(&[*name])).unwrap().symbol(*kind))
    });
    automaton.layer_sets()[usize::from(automaton.accepting_layers(state, Symbol::NONE))]
}

fn events() -> impl Strategy<Value = String> {
    let letters = prop::sample::select(vec![
        ".",
        "C",
        "R",
        "T",
        "V",
        "D",
        "G",
        "S",
        "L",
        "O",
        "B",
        "<RD>",
        "<TS>",
        "<[RT]G>",
        "<R[^D]'a'>",
        "<L.'a'>",
        "<L.['a''b']>",
        "<..[^'a']>",
        "'b'",
        "[DG]",
        "[^D]",
        "[^LOB]",
        "[<RD>'a']",
        "[^V'b']",
    ]);
    letters.prop_map(str::to_owned)
}

fn expressions() -> impl Strategy<Value = String> {
    let tree = events().prop_recursive(4, 24, 4, |inner| {
        prop_oneof![
            prop::collection::vec(inner.clone(), 1..4).prop_map(|all| all.concat()),
            prop::collection::vec(inner.clone(), 1..4).prop_map(|all| format!("({})", all.join("|"))),
            (inner, prop::sample::select(vec!["*", "+", "?"])).prop_map(|(one, sign)| format!("({one}){sign}")),
        ]
    });
    tree.prop_map(|rest| format!("C{rest}"))
}

fn words() -> impl Strategy<Value = Word> {
    let scattered = (prop::sample::select(EventKind::ALL[1..8].to_vec()), prop::sample::select(NAMES.to_vec()));
    let source = (prop::sample::select(EventKind::ALL[8..].to_vec()), prop::sample::select(NAMES.to_vec()));
    (prop::collection::vec(scattered, 0..7), source).prop_map(|(mut word, source)| {
        word.push(source);
        word
    })
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(400))]

    #[test]
    fn automaton_of_all_layers_accepts_what_each_expression_accepts(
        texts in prop::collection::vec(expressions(), 1..5),
        words in prop::collection::vec(words(), 1..30),
    ) {
        let layers: Vec<Layer> =
            texts.iter().enumerate().map(|(number, text)| Layer::new(format!("layer{number}"), text)).collect();
        let automaton = automaton(&layers);
        let expressions: Vec<Expression> = layers.iter().map(|layer| layer.parse().unwrap()).collect();
        for word in &words {
            let expected = expressions.iter().enumerate().fold(0, |all, (n, it)| all | u64::from(matches_word(it, word)) << n);
            prop_assert_eq!(accepted(&automaton, word), expected, "{:?} of {:?}", word, texts);
        }
    }

    #[test]
    fn no_text_makes_the_parser_panic_and_faults_lie_within_it(text in "[CRTVDGSLOB.*+?|()\\[\\]^<>' ax\u{e4}]{0,24}") {
        if let Err(error) = Expression::parse(&text) {
            prop_assert!(error.position <= text.chars().count());
            prop_assert!(error.to_string().lines().count() == 3);
        }
    }
}

#[test]
fn no_two_states_of_the_automaton_take_the_same_paths() {
    // Two equivalent spellings, and parts that never match.
    let layers = [Layer::new("a", "C(D|G)*L"), Layer::new("b", "C[DG]*(L|LC)|CVVVC")];
    let (automaton, _) = automaton(&layers);
    // The dead state, the state before the lamp, and the state after it.
    assert_eq!(automaton.states(), 3);
    assert_eq!(
        (automaton.accepting_layers(DEAD_STATE, Symbol::NONE), automaton.layer_sets()),
        (NO_LAYERS, &[0, 0b11][..])
    );
    assert_eq!(automaton.next(automaton.start(), Symbol::NONE), automaton.start());
}

#[test]
fn presets_that_part_the_paths_take_every_path_once() {
    let parts = [[Preset::Direct, Preset::Indirect], [Preset::Fog, Preset::Surfaces]];
    for presets in parts {
        let layers: Vec<Layer> = presets.iter().flat_map(|preset| preset.layers([]).unwrap()).collect();
        let automaton = automaton(&layers);
        let mut runner = proptest::test_runner::TestRunner::deterministic();
        runner
            .run(&words(), |word| {
                prop_assert_eq!(accepted(&automaton, &word).count_ones(), 1, "{:?}", word);
                Ok(())
            })
            .unwrap();
    }
}

#[test]
fn lamps_partition_light_and_object_labels_cover_their_contents() {
    let layers = Preset::Lamps.layers(["a", "b"]).unwrap();
    let automaton = automaton(&layers);
    for (name, layers) in [("a", 1), ("b", 2), ("", 0)] {
        let word = vec![(EventKind::ReflectedGlossy, "b"), (EventKind::Volume, ""), (EventKind::Light, name)];
        assert_eq!(accepted(&automaton, &word), layers, "{name}");
    }
    let vocabulary = Vocabulary::from_labels(["room", "room.desk"]).unwrap();
    let has = |name: &str| ["room", "room.desk"].map(|label| vocabulary.contains(vocabulary.label_set(&[name]), label));
    assert_eq!(
        [has("room.desk.lamp"), has("room.deskx"), has("rooms"), has("x.room")],
        [[true, true], [true, false], [false, false], [false, false]]
    );
}

#[test]
fn layers_that_would_take_too_many_states_are_refused() {
    // Knowing whether the twentieth event from the end is diffuse takes a state for each subset of twenty events.
    let tail = ".".repeat(20);
    let layers = [Layer::new("deep", format!("C.*D{tail}"))];
    let vocabulary = Automaton::vocabulary(&layers).unwrap();
    let outcome = Automaton::new(&layers, &vocabulary, [LabelSet::default()]);
    assert_eq!(outcome, Err(LayerError::TooManyStates(65535)));
}
