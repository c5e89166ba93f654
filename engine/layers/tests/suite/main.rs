//! Tests of light path expressions. The other side of each law is a table written by hand, or a second implementation
//! ([`meaning`]).

mod dialect;
mod generated;
mod limits;
mod meaning;
mod tables;

use femc_layers::{
    Automaton, DEAD_STATE, EventKind, Expression, LabelSet, Layer, LayerError, NO_LAYERS, Preset, Symbol, Vocabulary,
};
use proptest::prelude::*;

/// A path: each event with the name of the thing where it happens.
type Word = Vec<(EventKind, &'static str)>;

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
