//! Truth tables of single events, presets and names, written by hand.

use crate::meaning::{has_label, letters};
use femc_layers::{Automaton, EventKind, Expression, LabelSet, Layer, Preset, Symbol, Vocabulary, format_kinds};

/// Things with no name, in `a`, in `a.b`, in `ab`, in `b`.
const THINGS: [&[&str]; 5] = [&[], &["a"], &["a.b"], &["ab"], &["b"]];

/// All kinds but the camera match.
const ALL: &str = "++++++++++";
/// No kind matches.
const NO: &str = "----------";

/// A row: the event; whether the camera matches; the kinds that match at each of [`THINGS`], in the order RD RG RS TD TG TS V L O B.
type Row = (&'static str, bool, [&'static str; 5]);

const fn anywhere(kinds: &'static str) -> [&'static str; 5] {
    [kinds; 5]
}

const EVENTS: &[Row] = &[
    (".", true, anywhere(ALL)),
    ("C", true, anywhere(NO)),
    ("R", false, anywhere("+++-------")),
    ("T", false, anywhere("---+++----")),
    ("V", false, anywhere("------+---")),
    ("D", false, anywhere("+--+------")),
    ("G", false, anywhere("-+--+-----")),
    ("S", false, anywhere("--+--+----")),
    ("L", false, anywhere("-------+--")),
    ("O", false, anywhere("--------+-")),
    ("B", false, anywhere("---------+")),
    ("<RD>", false, anywhere("+---------")),
    ("<RG>", false, anywhere("-+--------")),
    ("<RS>", false, anywhere("--+-------")),
    ("<TD>", false, anywhere("---+------")),
    ("<TG>", false, anywhere("----+-----")),
    ("<TS>", false, anywhere("-----+----")),
    ("<.G>", false, anywhere("-+--+-----")),
    ("<R.>", false, anywhere("+++-------")),
    ("<V.>", false, anywhere("------+---")),
    ("<C>", true, anywhere(NO)),
    ("<...>", true, anywhere(ALL)),
    ("<[RT]G>", false, anywhere("-+--+-----")),
    ("<R[DS]>", false, anywhere("+-+-------")),
    ("<R[^D]>", false, anywhere("-++-------")),
    ("<[^RT]>", true, anywhere("------++++")),
    ("<[^C]>", false, anywhere(ALL)),
    ("<.[^D]>", true, anywhere("-++-++++++")),
    ("<[VL].>", false, anywhere("------++--")),
    ("[DG]", false, anywhere("++-++-----")),
    ("[RL]", false, anywhere("+++----+--")),
    ("[<RD>V]", false, anywhere("+-----+---")),
    ("[^D]", true, anywhere("-++-++++++")),
    ("[^C]", false, anywhere(ALL)),
    ("[^DG]", true, anywhere("--+--+++++")),
    ("[^RTV]", true, anywhere("-------+++")),
    ("[^LOB]", true, anywhere("+++++++---")),
    ("[^<RD>V]", true, anywhere("-+++++-+++")),
    ("[^<[RT]D><TS>]", true, anywhere("-++-+-++++")),
    ("[^.]", false, anywhere(NO)),
    ("'a'", false, [NO, ALL, ALL, NO, NO]),
    ("'a.b'", false, [NO, NO, ALL, NO, NO]),
    ("'ab'", false, [NO, NO, NO, ALL, NO]),
    ("['a']", false, [NO, ALL, ALL, NO, NO]),
    ("['a''b']", false, [NO, ALL, ALL, NO, ALL]),
    ("[^'a']", true, [ALL, NO, NO, ALL, ALL]),
    ("[^'a''b']", true, [ALL, NO, NO, ALL, NO]),
    ("[^'a.b']", true, [ALL, ALL, NO, ALL, ALL]),
    ("<..'a'>", false, [NO, ALL, ALL, NO, NO]),
    ("<..'a''b'>", false, [NO, ALL, ALL, NO, ALL]),
    ("<..['a''b']>", false, [NO, ALL, ALL, NO, ALL]),
    ("<..[^'a']>", true, [ALL, NO, NO, ALL, ALL]),
    ("<..[^'a''b']>", true, [ALL, NO, NO, ALL, NO]),
    ("<RD'a'>", false, [NO, "+---------", "+---------", NO, NO]),
    ("<R'a'>", false, [NO, "+++-------", "+++-------", NO, NO]),
    ("<R.'b'>", false, [NO, NO, NO, NO, "+++-------"]),
    ("<L.'ab'>", false, [NO, NO, NO, "-------+--", NO]),
    ("<[LO]['a''ab']>", false, [NO, "-------++-", "-------++-", "-------++-", NO]),
    ("<T[^D]'a'>", false, [NO, "----++----", "----++----", NO, NO]),
    ("<R[^'a']>", false, ["+++-------", NO, NO, "+++-------", "+++-------"]),
    ("<RD[^'a''b']>", false, ["+---------", NO, NO, "+---------", NO]),
    ("<R[^D][^'a.b']>", false, ["-++-------", "-++-------", NO, "-++-------", "-++-------"]),
    ("[D'a']", false, ["+--+------", ALL, ALL, "+--+------", "+--+------"]),
    ("[<RD'a'>V]", false, ["------+---", "+-----+---", "+-----+---", "------+---", "------+---"]),
    ("[^D'a']", true, ["-++-++++++", NO, NO, "-++-++++++", "-++-++++++"]),
    ("[^<RD'a'>V]", true, ["++++++-+++", "-+++++-+++", "-+++++-+++", "++++++-+++", "++++++-+++"]),
    ("[^<R[^'a']>]", true, ["---+++++++", ALL, ALL, "---+++++++", "---+++++++"]),
    ("[^<L[^'a']>'b']", true, ["+++++++-++", ALL, ALL, "+++++++-++", NO]),
];

/// Compiles one layer for some things, and returns its automaton with the symbols of the things.
fn compile(text: &str, things: &[&[&str]]) -> (Automaton, Vec<LabelSet>) {
    let layers = [Layer::new("it", text)];
    let vocabulary = Automaton::vocabulary(&layers).unwrap_or_else(|e| panic!("{text}: {e}"));
    let sets: Vec<LabelSet> = things.iter().map(|names| vocabulary.label_set(names)).collect();
    (Automaton::new(&layers, &vocabulary, sets.clone()).unwrap(), sets)
}

#[test]
fn single_events_match_what_the_table_says() {
    for (text, has_camera, rows) in EVENTS {
        let (alone, _) = compile(text, &THINGS);
        assert_eq!(alone.accepting_layers(alone.start(), Symbol::NONE) != 0, *has_camera, "{text} is the camera");
        let (after, sets) = compile(&format!("C{text}"), &THINGS);
        for (set, (names, expected)) in sets.iter().zip(THINGS.iter().zip(rows)) {
            let matches = |kind: &EventKind| {
                let state = after.next(after.start(), after.label_offset(*set).unwrap().symbol(*kind));
                if after.accepting_layers(state, Symbol::NONE) != 0 { '+' } else { '-' }
            };
            let found: String = EventKind::ALL[1..].iter().map(matches).collect();
            assert_eq!(found, *expected, "{text} at {names:?}");
        }
    }
}

#[test]
fn a_repetition_counts_exactly() {
    for (text, counts) in [
        ("CD{3}L", vec![3]),
        ("CD{1}L", vec![1]),
        ("CD{2,4}L", vec![2, 3, 4]),
        ("CD{0,2}L", vec![0, 1, 2]),
        ("CD{1,1}L", vec![1]),
        ("C(DD){1,2}L", vec![2, 4]),
        ("C(D?){2}L", vec![0, 1, 2]),
        ("CDD?D?L", vec![1, 2, 3]),
        ("CD+DL", vec![2, 3, 4, 5]),
        ("C(DD)*L", vec![0, 2, 4]),
        ("C(DDD)+L", vec![3]),
    ] {
        let (automaton, sets) = compile(text, &[&[]]);
        let offset = automaton.label_offset(sets[0]).unwrap();
        let is_taken = |count: &usize| {
            let diffuse = offset.symbol(EventKind::ReflectedDiffuse);
            let state = (0..*count).fold(automaton.start(), |state, _| automaton.next(state, diffuse));
            let state = automaton.next(state, offset.symbol(EventKind::Light));
            automaton.accepting_layers(state, Symbol::NONE) != 0
        };
        assert_eq!((0..6).filter(is_taken).collect::<Vec<_>>(), counts, "{text}");
    }
}

/// Reads a word like `RD V L`.
fn word(text: &str) -> Vec<EventKind> {
    let kind_of = |text: &str| {
        let spelled = |kind: &&EventKind| {
            let (ty, scattering) = letters(**kind);
            [Some(ty), scattering].into_iter().flatten().collect::<String>() == text
        };
        *EventKind::ALL.iter().find(spelled).unwrap()
    };
    text.split(' ').map(kind_of).collect()
}

#[test]
fn presets_take_the_paths_that_their_names_promise() {
    // Layers: full, direct_diffuse, direct_specular, two_diffuse, diffuse_interreflection; direct, indirect, fog, surfaces.
    const PATHS: &[(&str, &str)] = &[
        ("L", "+----+--+"),
        ("B", "+----+--+"),
        ("RD L", "++-+-+--+"),
        ("TD O", "++-+-+--+"),
        ("RG L", "+-+--+--+"),
        ("TS B", "+-+--+--+"),
        ("V L", "+----+-+-"),
        ("RD TD L", "+--++-+-+"),
        ("RD RD RD L", "+---+-+-+"),
        ("RD RS L", "+-----+-+"),
        ("RS RD L", "+-----+-+"),
        ("TS TS L", "+-----+-+"),
        ("V V L", "+-----++-"),
        ("V RD L", "+-----++-"),
        ("RD V L", "+-----++-"),
        ("RD RD V B", "+---+-++-"),
        ("RS TG V RD O", "+-----++-"),
        ("RG RD RD RD B", "+-----+-+"),
    ];
    let presets = [Preset::Guides, Preset::Direct, Preset::Indirect, Preset::Fog, Preset::Surfaces];
    let layers: Vec<Layer> = presets.iter().flat_map(|preset| preset.layers([]).unwrap()).collect();
    let names: Vec<&str> = layers.iter().map(|layer| layer.name.as_str()).collect();
    let guides = ["full", "direct_diffuse", "direct_specular", "two_diffuse", "diffuse_interreflection"];
    assert_eq!((&names[..5], &names[5..]), (&guides[..], &["direct", "indirect", "fog", "surfaces"][..]));
    let automaton = Automaton::new(&layers, &Vocabulary::default(), [LabelSet::default()]).unwrap();
    let offset = automaton.label_offset(LabelSet::default()).unwrap();
    for (text, expected) in PATHS {
        let events = word(text);
        let state = events.iter().fold(automaton.start(), |state, kind| automaton.next(state, offset.symbol(*kind)));
        let taken = automaton.layer_sets()[usize::from(automaton.accepting_layers(state, Symbol::NONE))];
        let found: String = (0..9).map(|layer| if taken >> layer & 1 == 1 { '+' } else { '-' }).collect();
        assert_eq!(found, *expected, "{text}");
        // The last event may be asked for before it is passed.
        let (last, before) = events.split_last().unwrap();
        let state = before.iter().fold(automaton.start(), |state, kind| automaton.next(state, offset.symbol(*kind)));
        let taken = automaton.layer_sets()[usize::from(automaton.accepting_layers(state, offset.symbol(*last)))];
        let found: String = (0..9).map(|layer| if taken >> layer & 1 == 1 { '+' } else { '-' }).collect();
        assert_eq!(found, *expected, "{text}");
    }
}

#[test]
fn a_lamp_has_its_own_layer_whatever_its_name() {
    let lamps = ["desk.lamp", "it's", r"back\slash", "desk", "hall", "desk.lamp"];
    let layers = Preset::Lamps.layers(lamps).unwrap();
    let names: Vec<&str> = layers.iter().map(|layer| layer.name.as_str()).collect();
    assert_eq!(names, ["lamp_desk_lamp", "lamp_it_s", "lamp_back_slash", "lamp_desk", "lamp_hall"]);
    let vocabulary = Automaton::vocabulary(&layers).unwrap();
    let things: [&[&str]; 6] = [&["desk.lamp"], &["it's"], &[r"back\slash"], &["desk"], &["hall.bulb"], &["halls"]];
    let sets = things.map(|names| vocabulary.label_set(names));
    let automaton = Automaton::new(&layers, &vocabulary, sets).unwrap();
    let expected = [0b01001, 0b00010, 0b00100, 0b01000, 0b10000, 0];
    for ((set, names), expected) in sets.iter().zip(things).zip(expected) {
        for kind in ["L", "O", "B"].map(|text| word(text)[0]) {
            let symbol = automaton.label_offset(*set).unwrap().symbol(kind);
            let taken = automaton.layer_sets()[usize::from(automaton.accepting_layers(automaton.start(), symbol))];
            assert_eq!(taken, expected, "{kind:?} at {names:?}");
        }
    }
}

#[test]
fn label_sets_equal_comparisons_of_names() {
    let labels = ["", "a", "a.b", "a.b.c", "ab", "b", "b.a", "a.", ".", "aa", "it's", "a b", "B"];
    let labels = &labels[1..];
    let vocabulary = Vocabulary::from_labels(labels.iter().chain(&labels[2..5]).copied()).unwrap();
    assert_eq!(vocabulary.labels().len(), labels.len());
    let names = ["", "a", "a.b", "a.bc", "a.b.c.d", "ab.c", "b.a", "b.ab", "aa", "a b.c", "b", "x", "it's.x", "B.a"];
    for one in names {
        for other in names {
            let both = vocabulary.label_set(&[one, other]);
            assert_eq!(both, vocabulary.label_set(&[one]).union(vocabulary.label_set(&[other])));
            for label in labels {
                let expected = has_label(&[one, other], label);
                assert_eq!(vocabulary.contains(both, label), expected, "{label} at {one} and {other}");
            }
            assert!(!vocabulary.contains(both, "x") && !vocabulary.contains(both, "a.bc"));
        }
    }
    // The last of 128 labels works like the first.
    let many: Vec<String> = (0..129).map(|number| format!("label{number:03}")).collect();
    let full = Vocabulary::from_labels(many[..128].iter().map(String::as_str)).unwrap();
    for at in [0, 63, 64, 127] {
        let set = full.label_set(&[&format!("{}.x", many[at])]);
        let found: Vec<usize> = (0..129).filter(|label| full.contains(set, &many[*label])).collect();
        assert_eq!(found, [at]);
    }
    assert!(Vocabulary::from_labels(many.iter().map(String::as_str)).is_none());
}

/// Reads the kinds of a text of [`format_kinds`], a bit for each kind.
fn kinds_in(text: &str) -> u16 {
    let bits = |fits: &dyn Fn((char, Option<char>)) -> bool| {
        (0u16..).zip(EventKind::ALL).filter(|(_, kind)| fits(letters(*kind))).fold(0, |set, (bit, _)| set | 1 << bit)
    };
    let (mut set, mut rest) = (0, text.strip_prefix('[').and_then(|rest| rest.strip_suffix(']')).unwrap_or(text));
    while let Some(first) = rest.chars().next() {
        let length = if first == '<' { rest.find('>').unwrap() + 1 } else { 1 };
        let (one, others) = rest.split_at(length);
        let inner = one.trim_matches(['<', '>']).replace(['[', ']'], "");
        let (ty, scatterings) = inner.split_at(1);
        let ty = ty.chars().next().unwrap();
        set |= match one {
            "." => bits(&|_| true),
            _ if scatterings.is_empty() => bits(&|(own, scattering)| own == ty || scattering == Some(ty)),
            _ => bits(&|(own, scattering)| own == ty && scattering.is_some_and(|it| scatterings.contains(it))),
        };
        rest = others;
    }
    set
}

#[test]
fn texts_of_kinds_mean_these_kinds() {
    for set in 1u16..1 << 11 {
        let kinds = (0..11).filter(|bit| set >> bit & 1 == 1).map(|bit| EventKind::ALL[bit]);
        let text = format_kinds(kinds);
        // `.` leaves open whether the camera is meant: it is never missing.
        let ignored = if text == "." { 1 } else { 0 };
        assert_eq!(kinds_in(&text) | ignored, set | ignored, "{text}");
    }
}

#[test]
fn an_event_is_described_by_its_kinds_and_labels() {
    for (text, expected) in [
        ("'a'", ". at 'a'"),
        ("['a''b']", ". at 'a' or 'b'"),
        ("[^'a''b']", ". at places other than 'a' or 'b'"),
        ("<RD'a'>", "<RD> at 'a'"),
        ("<R[^D][^'a']>", "<R[GS]> at places other than 'a'"),
        ("[^D]", "[C<RG><RS><TG><TS>VLOB]"),
        ("[LO]", "[LO]"),
        ("<[LO]'b'>", "[LO] at 'b'"),
    ] {
        let expression = Expression::parse(text).unwrap();
        assert_eq!(expression.events()[0].to_string(), expected, "{text}");
    }
    // Lamps that are in `b` and not in `a`: some labels must be missing and others present.
    let expression = Expression::parse("[^'a'<L.[^'b']>]").unwrap();
    assert!(expression.events()[0].may_match(EventKind::Light));
    let expression = Expression::parse("[^'b'<L.[^'b']>]").unwrap();
    assert!(!expression.events()[0].may_match(EventKind::Light));
}
