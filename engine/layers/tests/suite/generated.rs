//! Laws of expressions: whatever the expressions and the path, the automaton accepts what the second implementation accepts.

use crate::meaning::{Event, Labels, Machine, Part, Single, Tree, is_source};
use femc_layers::{Automaton, EventKind, Expression, LabelSet, Layer, Symbol, UnlitReason, Vocabulary, unlit_reason};
use std::collections::BTreeSet;

/// Pseudo-random draws (splitmix64).
struct Draws(u64);

impl Draws {
    fn below(&mut self, count: usize) -> usize {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let a = (self.0 ^ self.0 >> 30).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        let b = (a ^ a >> 27).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((b ^ b >> 31) % count as u64) as usize
    }

    fn one<T: Copy>(&mut self, all: &[T]) -> T {
        all[self.below(all.len())]
    }
}

/// Names of the things in the scene.
const THINGS: [&[&str]; 9] =
    [&[], &["a"], &["a.b"], &["ab"], &["b"], &["b", "a.b.c"], &["it's"], &["a.b/c"], &["x", "b.a"]];
const LABELS: [&str; 6] = ["a", "a.b", "ab", "b", "it's", "a.b/c"];

fn labels(draws: &mut Draws) -> Vec<&'static str> {
    (0..1 + draws.below(2)).map(|_| draws.one(&LABELS)).collect()
}

fn part(draws: &mut Draws, letters: &[char]) -> Part {
    let some = |draws: &mut Draws| (0..1 + draws.below(2)).map(|_| draws.one(letters)).collect();
    match draws.below(5) {
        0 => Part::Dot,
        1 => Part::Set(some(draws)),
        2 => Part::Except(some(draws)),
        _ => Part::One(draws.one(letters)),
    }
}

fn single(draws: &mut Draws) -> Single {
    match draws.below(10) {
        0 => Single::Dot,
        1..5 => Single::Letter(draws.one(&['R', 'T', 'V', 'D', 'G', 'S', 'L', 'O', 'B', 'D', 'L', 'C'])),
        5 => Single::Label(draws.one(&LABELS)),
        _ => loop {
            let types = part(draws, &['C', 'R', 'T', 'V', 'L', 'O', 'B', 'R', 'T']);
            let scatterings = (draws.below(2) == 0).then(|| part(draws, &['D', 'G', 'S']));
            let labels = match draws.below(6) {
                0 => Labels::Some(labels(draws)),
                1 => Labels::Set(labels(draws)),
                2 => Labels::Except(labels(draws)),
                // A dot alone would be the scattering.
                3 if scatterings.is_some() => Labels::Dot,
                _ => Labels::Any,
            };
            // A combination that no kind has is refused.
            let kinds = Single::Angle(types.clone(), scatterings.clone(), Labels::Any);
            if EventKind::ALL.iter().any(|kind| kinds.matches((*kind, &[]))) {
                break Single::Angle(types, scatterings, labels);
            }
        },
    }
}

fn tree(draws: &mut Draws, depth: usize) -> Tree {
    let kind = if depth == 0 { draws.below(3) } else { draws.below(9) };
    let some = |draws: &mut Draws| (0..1 + draws.below(3)).map(|_| single(draws)).collect();
    match kind {
        0 => Tree::One(single(draws)),
        1 => Tree::Bracket(some(draws)),
        2 => Tree::Except(some(draws)),
        3 | 4 => Tree::Sequence((0..1 + draws.below(3)).map(|_| tree(draws, depth - 1)).collect()),
        5 => Tree::Choice((0..1 + draws.below(3)).map(|_| tree(draws, depth - 1)).collect()),
        6 => {
            let least = draws.below(3);
            Tree::Times(least, (least + draws.below(3)).max(1), Box::new(tree(draws, depth - 1)))
        }
        _ => Tree::Sign(draws.one(&['*', '+', '?']), Box::new(tree(draws, depth - 1))),
    }
}

/// Draws an expression. Nearly all begin with the camera, and most end with a source.
fn expression(draws: &mut Draws) -> Tree {
    let depth = draws.below(4);
    let mut all = vec![tree(draws, depth)];
    if draws.below(20) > 0 {
        all.insert(0, Tree::One(Single::Letter('C')));
    }
    if draws.below(3) > 0 {
        all.push(Tree::Bracket(['L', 'O', 'B'].map(Single::Letter).into()));
    }
    Tree::Sequence(all)
}

fn word(draws: &mut Draws) -> Vec<Event> {
    let mut all: Vec<Event> =
        (0..draws.below(7)).map(|_| (draws.one(&EventKind::ALL[1..8]), draws.one(&THINGS))).collect();
    all.push((draws.one(&EventKind::ALL[8..]), draws.one(&THINGS)));
    all
}

fn written(tree: &Tree, draws: &mut Draws) -> String {
    format!("{}{}", draws.one(&["", "", "lpe:"]), tree.text(draws.one(&["", " ", "  "])))
}

#[test]
fn expressions_take_the_paths_that_the_second_machine_takes() {
    let mut draws = Draws(1);
    let mut counts = [0; 2];
    for _ in 0..700 {
        let trees: Vec<Tree> = (0..1 + draws.below(4)).map(|_| expression(&mut draws)).collect();
        let texts: Vec<String> = trees.iter().map(|tree| written(tree, &mut draws)).collect();
        let layers: Vec<Layer> = (0..).zip(&texts).map(|(at, text)| Layer::new(format!("layer{at}"), text)).collect();
        let vocabulary = Automaton::vocabulary(&layers).unwrap_or_else(|e| panic!("{e}"));
        let sets = THINGS.map(|names| vocabulary.label_set(names));
        let automaton = Automaton::new(&layers, &vocabulary, sets).unwrap_or_else(|e| panic!("{e}"));
        let machines: Vec<Machine> = trees.iter().map(Machine::new).collect();
        for _ in 0..25 {
            let word = word(&mut draws);
            let state = word.iter().fold(automaton.start(), |state, (kind, names)| {
                let offset = automaton.label_offset(vocabulary.label_set(names)).unwrap();
                automaton.next(state, offset.symbol(*kind))
            });
            let found = automaton.layer_sets()[usize::from(automaton.accepting_layers(state, Symbol::NONE))];
            for (layer, machine) in machines.iter().enumerate() {
                let expected = machine.accepts(&word);
                assert_eq!(found >> layer & 1 == 1, expected, "{} and {word:?}", texts[layer]);
                counts[usize::from(expected)] += 1;
            }
        }
    }
    assert!(counts[1] > 2000 && counts[0] > 2000, "{counts:?}");
}

#[test]
fn one_event_matches_as_its_meaning_says() {
    let mut draws = Draws(2);
    for _ in 0..1500 {
        let tree = tree(&mut draws, 0);
        let text = tree.text("");
        let expression = Expression::parse(&text).unwrap_or_else(|e| panic!("{e}"));
        let [event] = expression.events()[..] else { panic!("{text} is one event") };
        for kind in EventKind::ALL {
            let found = THINGS.map(|names| event.matches(kind, |label| crate::meaning::has_label(names, label)));
            assert_eq!(found, THINGS.map(|names| tree.matches((kind, names)).unwrap()), "{text} and {kind:?}");
            // An event that matches at some thing may match.
            assert!(event.may_match(kind) || !found.contains(&true), "{text} may match {kind:?}");
        }
    }
}

#[test]
fn a_layer_is_dark_if_no_path_of_the_scene_is_in_it() {
    let mut draws = Draws(3);
    let mut counts = [0; 5];
    for _ in 0..2500 {
        let tree = expression(&mut draws);
        let text = written(&tree, &mut draws);
        let layer = Expression::parse(&text).unwrap_or_else(|e| panic!("{e}"));
        let labels: BTreeSet<&str> = layer.events().iter().flat_map(|event| event.labels()).collect();
        let vocabulary = Vocabulary::from_labels(labels).unwrap();
        // A scene of a few events.
        let mut scene: Vec<Event> =
            (0..draws.below(5)).map(|_| (draws.one(&EventKind::ALL[1..8]), draws.one(&THINGS))).collect();
        scene.extend((0..draws.below(3)).map(|_| (draws.one(&EventKind::ALL[8..]), draws.one(&THINGS))));
        let possible: BTreeSet<(EventKind, LabelSet)> =
            scene.iter().map(|(kind, names)| (*kind, vocabulary.label_set(names))).collect();
        let longest = (draws.below(2) == 0).then(|| 1 + draws.below(4));
        let machine = Machine::new(&tree);
        let is_made = |tree: &Tree, kind: EventKind| {
            scene.iter().any(|event| event.0 == kind && tree.matches(*event) == Some(true))
        };
        let is_allowed =
            |tree: &Tree, kind: EventKind| THINGS.iter().any(|names| tree.matches((kind, names)) == Some(true));
        let shortest = machine.shortest(is_made);
        let found = unlit_reason(&layer, &vocabulary, &possible, longest);
        let context = format!("{text} in {scene:?}, at most {longest:?}: {shortest:?}");
        match &found {
            None => assert!(shortest.is_some_and(|segments| longest.is_none_or(|most| segments <= most)), "{context}"),
            Some(UnlitReason::TooLong(segments)) => {
                assert_eq!(shortest, Some(*segments), "{context}");
                assert!(longest.is_some_and(|most| *segments > most), "{context}");
            }
            Some(UnlitReason::NoCamera) => assert!(!machine.begins_with_the_camera(), "{context}"),
            Some(UnlitReason::NoSource) => {
                assert!(machine.begins_with_the_camera() && machine.shortest(is_allowed).is_none(), "{context}");
            }
            Some(UnlitReason::Missing(missing)) => {
                assert!(shortest.is_none() && !missing.is_empty(), "{context}");
                // With the missing events there is a path, and no path has fewer missing events.
                let with = machine.shortest(|tree, kind| {
                    let own = Expression::parse(&tree.text("")).unwrap();
                    is_made(tree, kind) || missing.contains(own.events()[0]) && is_allowed(tree, kind)
                });
                assert!(with.is_some(), "{context}: {missing:?}");
                let fewest = machine.fewest_missing(is_made, is_allowed);
                assert!(fewest.is_some_and(|fewest| missing.len() <= fewest), "{context}: {fewest:?} {missing:?}");
            }
        }
        let kind = match found {
            None => 0,
            Some(UnlitReason::NoCamera) => 1,
            Some(UnlitReason::NoSource) => 2,
            Some(UnlitReason::TooLong(_)) => 3,
            Some(UnlitReason::Missing(_)) => 4,
        };
        counts[kind] += 1;
    }
    assert!(counts.iter().all(|count| *count > 20), "{counts:?}");
}

#[test]
fn a_source_ends_a_path_and_no_other_kind_does() {
    let sources: Vec<EventKind> = EventKind::ALL.into_iter().filter(|kind| is_source(*kind)).collect();
    assert_eq!(sources, [EventKind::Light, EventKind::Object, EventKind::Background]);
    assert!(EventKind::ALL.iter().all(|kind| kind.is_source() == is_source(*kind)));
}
