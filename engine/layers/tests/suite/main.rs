//! Tests of the automaton against an independent matcher: Brzozowski's derivatives of the expression tree, one event at a time.

mod dialect;

use femc_layers::{
    Automaton, DEAD, Expression, Kind, LabelSet, Layer, LayerError, NO_LAYERS, Node, Preset, Symbol, Vocabulary,
};
use proptest::prelude::*;

/// A path: each event with the name of the thing where it happens.
type Word = Vec<(Kind, &'static str)>;

/// Remaining part of an expression after some events.
#[derive(Clone, Debug)]
enum Rest {
    Never,
    Done,
    Node(Node),
    Then(Box<Rest>, Box<Rest>),
    Either(Vec<Rest>),
}

fn may_end(rest: &Rest) -> bool {
    match rest {
        Rest::Never => false,
        Rest::Done => true,
        Rest::Node(node) => is_nullable(node),
        Rest::Then(one, other) => may_end(one) && may_end(other),
        Rest::Either(all) => all.iter().any(may_end),
    }
}

fn is_nullable(node: &Node) -> bool {
    match node {
        Node::Event(_) => false,
        Node::Sequence(nodes) => nodes.iter().all(is_nullable),
        Node::Choice(nodes) => nodes.iter().any(is_nullable),
        Node::Some(node) => is_nullable(node),
        Node::Any(_) | Node::Maybe(_) => true,
    }
}

fn then(one: Rest, other: Rest) -> Rest {
    match (one, other) {
        (Rest::Never, _) | (_, Rest::Never) => Rest::Never,
        (Rest::Done, other) => other,
        (one, Rest::Done) => one,
        (one, other) => Rest::Then(Box::new(one), Box::new(other)),
    }
}

fn derivative(rest: &Rest, event: (Kind, &str)) -> Rest {
    match rest {
        Rest::Never | Rest::Done => Rest::Never,
        Rest::Node(node) => of_node(node, event),
        Rest::Then(one, other) => {
            let through = then(derivative(one, event), (**other).clone());
            if may_end(one) { Rest::Either(vec![through, derivative(other, event)]) } else { through }
        }
        Rest::Either(all) => Rest::Either(all.iter().map(|one| derivative(one, event)).collect()),
    }
}

fn of_node(node: &Node, (kind, name): (Kind, &str)) -> Rest {
    match node {
        Node::Event(event) if event.fits(kind, |label| label == name) => Rest::Done,
        Node::Event(_) => Rest::Never,
        Node::Choice(nodes) => Rest::Either(nodes.iter().map(|node| of_node(node, (kind, name))).collect()),
        Node::Maybe(node) => of_node(node, (kind, name)),
        Node::Any(inner) | Node::Some(inner) => {
            then(of_node(inner, (kind, name)), Rest::Node(Node::Any(inner.clone())))
        }
        Node::Sequence(nodes) => {
            let Some((first, others)) = nodes.split_first() else { return Rest::Never };
            let others = Rest::Node(Node::Sequence(others.to_vec()));
            let through = then(of_node(first, (kind, name)), others.clone());
            if is_nullable(first) { Rest::Either(vec![through, derivative(&others, (kind, name))]) } else { through }
        }
    }
}

fn fits(expression: &Expression, word: &Word) -> bool {
    let mut rest = derivative(&Rest::Node(expression.node().clone()), (Kind::Camera, ""));
    for event in word {
        rest = derivative(&rest, *event);
    }
    may_end(&rest)
}

const NAMES: [&str; 3] = ["", "a", "b"];

fn automaton(layers: &[Layer]) -> (Automaton, Vocabulary) {
    let vocabulary = Automaton::vocabulary(layers).unwrap();
    let sets: Vec<LabelSet> = NAMES.iter().map(|name| vocabulary.set(&[*name])).collect();
    (Automaton::new(layers, &vocabulary, sets).unwrap(), vocabulary)
}

fn accepted((automaton, vocabulary): &(Automaton, Vocabulary), word: &Word) -> u64 {
    let state = word.iter().fold(automaton.start(), |state, (kind, name)| {
        automaton.next(state, automaton.labels(vocabulary.set(&[*name])).unwrap().event(*kind))
    });
    automaton.layers()[usize::from(automaton.takers(state, Symbol::NONE))]
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
    let scattered = (prop::sample::select(Kind::ALL[1..8].to_vec()), prop::sample::select(NAMES.to_vec()));
    let source = (prop::sample::select(Kind::ALL[8..].to_vec()), prop::sample::select(NAMES.to_vec()));
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
            let expected = expressions.iter().enumerate().fold(0, |all, (n, it)| all | u64::from(fits(it, word)) << n);
            prop_assert_eq!(accepted(&automaton, word), expected, "{:?} of {:?}", word, texts);
        }
    }

    #[test]
    fn no_text_makes_the_parser_panic_and_faults_lie_within_it(text in "[CRTVDGSLOB.*+?|()\\[\\]^<>' ax\u{e4}]{0,24}") {
        if let Err(error) = Expression::parse(&text) {
            prop_assert!(error.at <= text.chars().count());
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
    assert_eq!((automaton.takers(DEAD, Symbol::NONE), automaton.layers()), (NO_LAYERS, &[0, 0b11][..]));
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
        let word = vec![(Kind::ReflectedGlossy, "b"), (Kind::Volume, ""), (Kind::Light, name)];
        assert_eq!(accepted(&automaton, &word), layers, "{name}");
    }
    let vocabulary = Vocabulary::of(["room", "room.desk"]).unwrap();
    let has = |name: &str| ["room", "room.desk"].map(|label| vocabulary.has(vocabulary.set(&[name]), label));
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
    assert_eq!(outcome, Err(LayerError::Complex(65535)));
}
