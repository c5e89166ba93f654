//! Law of conditions: whatever the condition and the path, the crate selects what the second evaluator selects.

use super::meaning::{ENDS, FIELDS, INTERACTIONS, Kind, Meaning, TECHNIQUES};
use super::{LAMPS, MATERIALS, NAMES, OBJECTS, intersection, light, light_path, small_scope};
use femc_paths::query::{Condition, Query, Selection};
use femc_paths::{InteractionKind, LightPath, LightTechnique, Name, NameKind, PathEnd, PathKey};

/// Pseudo-random draws (splitmix64).
pub(crate) struct Draws(pub(crate) u64);

impl Draws {
    pub(crate) fn below(&mut self, count: usize) -> usize {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let a = (self.0 ^ self.0 >> 30).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        let b = (a ^ a >> 27).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((b ^ b >> 31) % count as u64) as usize
    }

    pub(crate) fn one<T: Copy>(&mut self, all: &[T]) -> T {
        all[self.below(all.len())]
    }

    fn is_one_in(&mut self, count: usize) -> bool {
        self.below(count) == 0
    }
}

/// Values of records and of comparisons. They are few, so that many are equal.
const VALUES: [f32; 6] = [0.0, 0.5, 1.0, 2.0, 3.0, 4.0];

pub(crate) fn random_path(draws: &mut Draws) -> LightPath {
    const SIZES: [usize; 8] = [0, 0, 1, 2, 3, 4, 6, 9];
    // More than 16 lights are found in another way.
    const LIGHTS: [usize; 8] = [0, 1, 2, 3, 5, 8, 17, 30];
    let (count, lights) = (draws.one(&SIZES), draws.one(&LIGHTS));
    let is_split = draws.is_one_in(2);
    let mut path = light_path(Vec::new(), Vec::new());
    for number in 0..count {
        let parent = if is_split { draws.below(number + 1) } else { number };
        let mut it = intersection(parent as u32, if draws.is_one_in(8) { "" } else { draws.one(&OBJECTS) });
        it.bounce = draws.below(4) as u32;
        it.position = std::array::from_fn(|_| f64::from(draws.one(&VALUES)) - 1.0);
        it.radiance = std::array::from_fn(|_| draws.one(&VALUES));
        it.throughput = std::array::from_fn(|_| draws.one(&VALUES));
        it.material = Name::new(NameKind::Material, draws.one(&MATERIALS));
        it.interaction = draws.one(InteractionKind::ALL);
        path.intersections.push(it);
    }
    for _ in 0..lights {
        // Some lights lie past the recorded intersections.
        let mut it = light(draws.below(count + 2) as u32, 0.0);
        it.radiance = std::array::from_fn(|_| draws.one(&VALUES));
        it.light = Name::new(NameKind::Lamp, if draws.is_one_in(6) { "" } else { draws.one(&LAMPS) });
        it.occluder = draws.is_one_in(3).then(|| super::object(draws.one(&OBJECTS)));
        it.technique = draws.one(LightTechnique::ALL);
        path.lights.push(it);
    }
    path.key = PathKey { frame: 3, pixel: draws.below(35) as u32, sample: draws.below(4) as u32 };
    path.radiance = std::array::from_fn(|_| draws.one(&VALUES));
    path.throughput = std::array::from_fn(|_| draws.one(&VALUES));
    path.depth = draws.below(5) as u32;
    path.end = draws.one(PathEnd::ALL);
    path
}

pub(crate) fn random_term(draws: &mut Draws) -> Meaning {
    match draws.below(12) {
        0 => Meaning::Then((0..2 + draws.below(2)).map(|_| draws.one(&OBJECTS)).collect()),
        1 => {
            let low: [f64; 3] = std::array::from_fn(|_| f64::from(draws.one(&VALUES)) - 1.5);
            let sides: [f64; 3] = std::array::from_fn(|_| 1.0 + f64::from(draws.one(&VALUES)));
            let [x, y, z] = low;
            Meaning::InBox([x, y, z, x + sides[0], y + sides[1], z + sides[2]])
        }
        2 => {
            // No line leads through the center of a pixel.
            let mut place = |size: usize| draws.below(100 * size) as f64 / 100.0 + 0.001_37;
            Meaning::InLasso((0..3 + place(5) as usize).map(|_| [place(8) - 0.5, place(6) - 0.5]).collect())
        }
        _ => {
            let (field, kind) = draws.one(FIELDS);
            let words: &[&'static str] = match kind {
                Kind::Number => {
                    let sign = draws.one(&["==", "!=", "<", "<=", ">", ">="]);
                    // The luminance is rounded, so it is not compared with values that it might have.
                    let shift = if field == "brightest.radiance" { 0.013 } else { 0.0 };
                    return Meaning::Number(field, sign, f64::from(draws.one(&VALUES)) - shift);
                }
                Kind::Name => draws.one(&[&OBJECTS[..], &OBJECTS, &MATERIALS, &LAMPS]),
                Kind::Ends => &ENDS,
                Kind::Interactions => &INTERACTIONS,
                Kind::Techniques => &TECHNIQUES,
            };
            Meaning::Word(field, draws.one(&["==", "!="]), draws.one(words))
        }
    }
}

pub(crate) fn random_condition(draws: &mut Draws, depth: usize) -> Meaning {
    if depth == 0 {
        return random_term(draws);
    }
    match draws.below(7) {
        0 => random_term(draws),
        1 => Meaning::Not(Box::new(random_condition(draws, depth - 1))),
        kind @ 2..5 => {
            let [a, b] = [0, 1].map(|_| Box::new(random_condition(draws, depth - 1)));
            if kind == 2 { Meaning::Or(a, b) } else { Meaning::And(a, b) }
        }
        _ => {
            let word = draws.one(&["any", "all", "light", "lights"]);
            Meaning::Each(word, Box::new(random_condition(draws, depth - 1)))
        }
    }
}

/// Writes a condition with no more parentheses than it needs, or with some more.
pub(crate) fn written(meaning: &Meaning, draws: &mut Draws) -> String {
    let quoted = |text: &str, draws: &mut Draws| {
        if text.contains(' ') || draws.is_one_in(4) { format!("\"{text}\"") } else { text.to_owned() }
    };
    let rank = |meaning: &Meaning| match meaning {
        Meaning::Or(..) => 0,
        Meaning::And(..) => 1,
        _ => 2,
    };
    let operand = |inner: &Meaning, least: usize, draws: &mut Draws| {
        let text = written(inner, draws);
        if rank(inner) < least || draws.is_one_in(6) { format!("({text})") } else { text }
    };
    let numbers = |all: &[f64]| all.iter().map(f64::to_string).collect::<Vec<_>>().join(", ");
    match meaning {
        Meaning::Or(a, b) => format!("{} or {}", operand(a, 0, draws), operand(b, 0, draws)),
        Meaning::And(a, b) => format!("{} and {}", operand(a, 1, draws), operand(b, 1, draws)),
        Meaning::Not(inner) => format!("not {}", operand(inner, 2, draws)),
        Meaning::Number(field, sign, value) => format!("{field} {sign} {value}"),
        Meaning::Word(field, sign, value) => format!("{field}{sign}{}", quoted(value, draws)),
        Meaning::Each(word, inner) => format!("{word}({})", written(inner, draws)),
        Meaning::Then(objects) => objects.iter().map(|object| quoted(object, draws)).collect::<Vec<_>>().join(" then "),
        Meaning::InBox(corners) => format!("in box({})", numbers(corners)),
        Meaning::InLasso(points) => format!("in lasso({})", numbers(points.as_flattened())),
    }
}

/// Checks a condition on paths, and returns the number of selected paths.
fn check(meaning: &Meaning, paths: &[LightPath], draws: &mut Draws, used: &mut Selection) -> usize {
    let scope = small_scope();
    let text = written(meaning, draws);
    let parsed = Condition::parse(&text).unwrap_or_else(|e| panic!("{text}: {e}"));
    let again = parsed.to_string();
    let conditions = [parsed, Condition::parse(&again).unwrap_or_else(|e| panic!("{again}: {e}"))];
    let mut count = 0;
    for condition in conditions {
        let query = Query { condition: Some(condition), ..Query::default() };
        let matcher = query.compile(&scope, &NAMES);
        for path in paths {
            let expected = meaning.select(path, 7);
            let found = matcher.select_into(path, used);
            assert_eq!((found, matcher.is_match(path)), (expected.is_some(), expected.is_some()), "{text}\n{path:?}");
            if let Some([intersections, lights]) = expected {
                assert_eq!((&used.intersections, &used.lights), (&intersections, &lights), "{text}\n{path:?}");
                count += 1;
            }
        }
    }
    count
}

#[test]
fn conditions_select_what_the_second_evaluator_selects() {
    let mut draws = Draws(1);
    let paths: Vec<LightPath> = (0..400).map(|_| random_path(&mut draws)).collect();
    let (mut used, mut counts) = (Selection::default(), [0; 3]);
    for _ in 0..2500 {
        let depth = draws.below(5);
        let meaning = random_condition(&mut draws, depth);
        let begin = draws.below(paths.len() - 12);
        let count = check(&meaning, &paths[begin..begin + 12], &mut draws, &mut used);
        counts[usize::from(count > 0) + usize::from(count == 24)] += 1;
    }
    // None, some and all of the paths.
    assert!(counts.iter().all(|count| *count > 250), "{counts:?}");
}

#[test]
fn conditions_of_more_than_64_facts_select_the_same() {
    let mut draws = Draws(2);
    let paths: Vec<LightPath> = (0..100).map(|_| random_path(&mut draws)).collect();
    let (mut used, mut some) = (Selection::default(), 0);
    let joined = |is_and: bool, a: Meaning, b: Meaning| {
        let (a, b) = (Box::new(a), Box::new(b));
        if is_and { Meaning::And(a, b) } else { Meaning::Or(a, b) }
    };
    for round in 0..120 {
        // Terms on the path that are all true, or all false, so that the two conditions among them decide.
        let is_and = draws.is_one_in(2);
        let decoy = |number: usize| {
            let on_path = Meaning::Number("sample", if is_and { "<" } else { ">" }, (1000 + number) as f64);
            joined(!is_and, on_path, Meaning::Number("bounce", if is_and { "<" } else { ">=" }, 0.0))
        };
        let mut all = random_condition(&mut draws, 3);
        for number in 0..66 + round % 3 {
            all = joined(is_and, all, decoy(number));
        }
        all = joined(is_and, all, random_condition(&mut draws, 3));
        let begin = draws.below(paths.len() - 10);
        let count = check(&all, &paths[begin..begin + 10], &mut draws, &mut used);
        some += usize::from(count > 0 && count < 20);
    }
    assert!(some > 20, "{some}");
}
