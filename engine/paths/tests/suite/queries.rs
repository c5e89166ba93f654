//! Tests of queries for paths.

use crate::synthetic::{leads_through, merge_parts, scope, tasks};
use femc_paths::query::{Condition, Query, QueryError, Selection, is_known_name, is_within};
use femc_paths::{
    InteractionKind, Intersection, LightPath, LightRecord, LightStatistics, Name, NameKind, PathEnd, PathKey,
};

fn matching_paths<'a>(all: &'a LightStatistics, query: &Query) -> Vec<(&'a LightPath, Vec<usize>)> {
    let matcher = query.compile(&all.scope, &all.names);
    let matches = |path: &'a LightPath| {
        let selection = matcher.select(path)?;
        Some((path, selection.intersections.into_iter().map(|index| index as usize).collect()))
    };
    all.paths.values().filter_map(matches).collect()
}

fn parse_query(text: &str) -> Query {
    Query { condition: Some(Condition::parse(text).unwrap_or_else(|e| panic!("{e}"))), ..Query::default() }
}

#[test]
fn a_condition_finds_the_intersections_that_a_loop_finds() {
    let all = merge_parts(&scope(900), tasks(&scope(900)));
    let found = matching_paths(&all, &parse_query("radiance.g > 2 and bounce == 2 and interaction == reflection"));
    let mut expected = Vec::new();
    for path in all.paths.values() {
        let holds = |place: &usize| {
            let it = &path.intersections[*place];
            it.radiance[1] > 2.0 && it.bounce == 2 && it.interaction == InteractionKind::Reflection
        };
        let places: Vec<usize> = (0..path.intersections.len()).filter(holds).collect();
        if !places.is_empty() {
            expected.push((path, places));
        }
    }
    assert!(expected.len() > 10 && found == expected, "{} and {}", expected.len(), found.len());
}

#[test]
fn names_are_those_of_things_and_of_what_is_in_them() {
    let all = merge_parts(&scope(900), tasks(&scope(900)));
    let count =
        |text: &str| matching_paths(&all, &parse_query(text)).iter().map(|(_, places)| places.len()).sum::<usize>();
    let on = |objects: &[&str]| {
        let names: Vec<Name> = objects.iter().map(|object| Name::new(NameKind::Object, object)).collect();
        all.paths.values().flat_map(|path| &path.intersections).filter(|it| names.contains(&it.object)).count()
    };
    assert_eq!(count("object == room"), on(&["room.floor", "room.wall"]));
    assert_eq!(count("object == \"room.wall\""), on(&["room.wall"]));
    assert_eq!(count("object == roo"), 0);
    let all_of_them = count("bounce >= 0");
    assert_eq!(count("not object == room"), all_of_them - on(&["room.floor", "room.wall"]));
    assert_eq!(count("object == plant or object == lamp"), on(&["plant", "lamp"]));
    assert_eq!(count("occluder != plant") + count("occluder == plant"), all_of_them);
    assert!(count("occluder == plant") > 0);
}

#[test]
fn paths_without_intersections_are_asked_by_what_paths_have() {
    let all = merge_parts(&scope(900), tasks(&scope(900)));
    let found = matching_paths(&all, &parse_query("end == escaped and depth < 1"));
    assert!(!found.is_empty() && found.iter().all(|(path, places)| path.end == PathEnd::Escaped && places.is_empty()));
    assert_eq!(matching_paths(&all, &Query::default()).len(), all.paths.len());
    let halves = ["pixel.x < 18", "pixel.x >= 18"].map(|text| matching_paths(&all, &parse_query(text)).len());
    assert!(halves[0] > 100 && halves[1] > 100 && halves.iter().sum::<usize>() == all.paths.len());
}

#[test]
fn objects_come_one_after_the_other_and_a_box_has_what_is_in_it() {
    let all = merge_parts(&scope(900), tasks(&scope(900)));
    let on = |path: &LightPath, object: &str| -> Vec<usize> {
        let name = Name::new(NameKind::Object, object);
        (0..path.intersections.len()).filter(|at| path.intersections[*at].object == name).collect()
    };
    let query = Query { objects: vec!["plant".into(), "room.wall".into()], ..Query::default() };
    let expected = all.paths.values().filter(|path| {
        let (plants, walls) = (on(path, "plant"), on(path, "room.wall"));
        plants.iter().any(|plant| walls.iter().any(|wall| leads_through(path, *wall, *plant)))
    });
    assert!(matching_paths(&all, &query).iter().map(|(path, _)| *path).eq(expected));
    let within = Some([[0.0, 0.0, 0.0], [1.0, 3.0, 1.0]]);
    let found = matching_paths(&all, &Query { within, ..Query::default() });
    let is_in = |x: [f64; 3]| (0.0..=1.0).contains(&x[0]) && x[2] <= 1.0;
    let expected: usize =
        all.paths.values().flat_map(|path| &path.intersections).filter(|it| is_in(it.position)).count();
    assert!(expected > 10);
    assert_eq!(found.iter().map(|(_, places)| places.len()).sum::<usize>(), expected);
}

#[test]
fn what_is_no_condition_says_where_and_what_is_expected() {
    let error = |text: &str| Condition::parse(text).unwrap_err().to_string();
    assert_eq!(error("radiance.g >"), "column 13: found \"\", expected a number");
    assert_eq!(error("bounce ~ 2"), "column 8: found \"~\", expected `==`, `!=`, `<`, `<=`, `>` or `>=`");
    assert_eq!(error("interaction < glossy"), "column 13: found \"<\", expected `==` or `!=`");
    assert_eq!(error("bounce == 2 bounce"), "column 13: found \"bounce\", expected `and`, `or` or the end");
    assert_eq!(error("bounce == nan"), "column 11: found \"nan\", expected a number");
    assert_eq!(error("(bounce == 2"), "column 13: found \"\", expected `)`");
    assert!(error("radiance.x > 2").starts_with("column 1: unknown name \"radiance.x\"; known names: bounce,"));
    assert!(error("end == mirror").starts_with("column 8: end cannot be \"mirror\"; it is one of escaped, absorbed"));
    assert_eq!(Condition::parse(&"(".repeat(1000)), Err(QueryError::TooDeep));
    assert_eq!(Condition::parse(&"depth == 1 and ".repeat(1000)), Err(QueryError::TooLong));
    let quantifiers = ["any", "all", "light", "lights"];
    let terms = |count| {
        let terms: Vec<String> = (0..count).map(|at| format!("{}(bounce == {at})", quantifiers[at % 4])).collect();
        terms.join(" or ")
    };
    assert!(Condition::parse(&terms(64)).is_ok());
    assert_eq!(error(&terms(65)), "more than 64 conditions any(..), all(..), light(..), lights(..)");
    let nested = |count| format!("{}depth == 1", "not ".repeat(count));
    assert!(Condition::parse(&nested(63)).is_ok());
    assert_eq!(Condition::parse(&nested(64)), Err(QueryError::TooDeep));
    for sign in ["(", ")", "=", "!=", "<", ">", ","] {
        let found = format!("column 11: found \"{sign}\", expected a word");
        assert_eq!(error(&format!("object == {sign}")), found, "a sign cannot be a name");
    }
    for text in ["", "and", "\"", "é == 2", "object == é", "not", "object ==", "object == )", "depth == 1e999"] {
        let _ = Condition::parse(text).map_err(|error| error.to_string());
    }
}

/// Returns the selected paths with what is selected of them.
fn selections(all: &LightStatistics, text: &str) -> Vec<(PathKey, Selection)> {
    let query = parse_query(text);
    let matcher = query.compile(&all.scope, &all.names);
    all.paths.values().filter_map(|path| Some((path.key, matcher.select(path)?))).collect()
}

fn selected_paths(all: &LightStatistics, text: &str) -> Vec<PathKey> {
    selections(all, text).into_iter().map(|(key, _)| key).collect()
}

fn paths_where(all: &LightStatistics, is_selected: impl Fn(&LightPath) -> bool) -> Vec<PathKey> {
    all.paths.values().filter(|path| is_selected(path)).map(|path| path.key).collect()
}

#[test]
fn quantities_of_intersections_equal_loops() {
    let all = merge_parts(&scope(900), tasks(&scope(900)));
    let is_deep = |it: &Intersection| it.bounce >= 1;
    let hit = |path: &&LightPath| !path.intersections.is_empty();
    let some = paths_where(&all, |path| path.intersections.iter().any(is_deep));
    assert!(some.len() > 10 && some.len() < all.paths.len());
    assert_eq!(selected_paths(&all, "any(bounce >= 1)"), some);
    assert_eq!(selected_paths(&all, "bounce >= 1"), some);
    let every = paths_where(&all, |path| hit(&path) && path.intersections.iter().all(|it| it.bounce == 0));
    assert!(!every.is_empty());
    assert_eq!(selected_paths(&all, "all(bounce == 0)"), every);
    // Conditions on different intersections of a path.
    let both = paths_where(&all, |path| {
        path.intersections.iter().any(|it| it.interaction == InteractionKind::Reflection)
            && path.intersections.iter().any(|it| it.interaction == InteractionKind::Diffuse)
    });
    assert!(!both.is_empty());
    assert_eq!(selected_paths(&all, "any(interaction == reflection) and any(interaction == diffuse)"), both);
    assert!(selected_paths(&all, "interaction == reflection and interaction == diffuse").is_empty());
}

#[test]
fn quantities_of_lights_refer_to_one_light_and_its_intersection() {
    let all = merge_parts(&scope(900), tasks(&scope(900)));
    let plant = Name::new(NameKind::Object, "plant");
    let is_selected = |path: &LightPath, light: &LightRecord| {
        let parent = path.parent(light).map(|index| path.intersections[index as usize]);
        light.occluder == Some(plant) && parent.is_some_and(|it| it.interaction == InteractionKind::Diffuse)
    };
    let text = "light(occluder == plant and interaction == diffuse)";
    let found = selections(&all, text);
    let keys: Vec<PathKey> = found.iter().map(|(key, _)| *key).collect();
    assert_eq!(keys, paths_where(&all, |path| path.lights.iter().any(|light| is_selected(path, light))));
    assert!(keys.len() > 10);
    for (key, selection) in &found {
        let path = all.paths.values().find(|path| path.key == *key).unwrap();
        let lights = (0u32..).zip(&path.lights).filter(|(_, light)| is_selected(path, light));
        let lights: Vec<(u32, Option<u32>)> = lights.map(|(index, light)| (index, path.parent(light))).collect();
        assert!(selection.lights.iter().copied().eq(lights.iter().map(|(index, _)| *index)));
        let mut parents: Vec<u32> = lights.iter().filter_map(|(_, parent)| *parent).collect();
        parents.dedup();
        assert_eq!(selection.intersections, parents);
    }
    let none = paths_where(&all, |path| path.lights.iter().all(|light| light.occluder != Some(plant)));
    assert_eq!(selected_paths(&all, "lights(occluder != plant)"), none);
}

#[test]
fn sequences_boxes_and_lassos_select_as_options_do() {
    let all = merge_parts(&scope(900), tasks(&scope(900)));
    let keys =
        |query: &Query| -> Vec<PathKey> { matching_paths(&all, query).iter().map(|(path, _)| path.key).collect() };
    let sequence = Query { objects: vec!["plant".into(), "room.wall".into()], ..Query::default() };
    assert_eq!(selected_paths(&all, "plant then room.wall"), keys(&sequence));
    assert_eq!(sequence.to_condition().unwrap().to_string(), "plant then room.wall");
    let within = Query { within: Some([[0.0, 0.0, 0.0], [1.0, 3.0, 1.0]]), ..Query::default() };
    assert_eq!(selected_paths(&all, "in box(0,0,0, 1,3,1)"), keys(&within));
    let width = all.scope.film[0];
    let in_rectangle = paths_where(&all, |path| {
        let (x, y) = (path.key.pixel % width, path.key.pixel / width);
        (3..17).contains(&x) && (2..9).contains(&y)
    });
    assert!(in_rectangle.len() > 10);
    assert_eq!(selected_paths(&all, "in lasso(3,2,17,2,17,9,3,9)"), in_rectangle);
    // A pixel's center decides: half a pixel less on each side is the same.
    assert_eq!(selected_paths(&all, "in lasso(3.4,2.4,17.4,2.4,17.4,9.4,3.4,9.4)"), in_rectangle);
}

#[test]
fn conditions_on_first_last_and_brightest_equal_loops() {
    let all = merge_parts(&scope(900), tasks(&scope(900)));
    let plant = Name::new(NameKind::Object, "plant");
    let last = paths_where(&all, |path| path.intersections.last().is_some_and(|it| it.object == plant));
    assert!(!last.is_empty());
    assert_eq!(selected_paths(&all, "last.object == plant"), last);
    let first = paths_where(&all, |path| path.intersections.first().is_some_and(|it| it.position[0] < 0.5));
    assert!(!first.is_empty());
    assert_eq!(selected_paths(&all, "first.x < 0.5"), first);
    let bright =
        paths_where(&all, |path| path.lights.iter().any(|light| femc_paths::record::luminance(light.radiance) > 1.0));
    assert!(!bright.is_empty() && bright.len() < all.paths.len());
    assert_eq!(selected_paths(&all, "brightest.radiance > 1"), bright);
}

#[test]
fn a_condition_is_read_from_its_own_text() {
    for text in [
        "bounce == 2",
        "not bounce == 2",
        "not (bounce == 2 or depth > 3) and end == escaped",
        "(bounce == 1 or bounce == 2) and (depth < 3 and depth > 1)",
        "bounce == 1 or depth < 3 and depth > 1",
        "any(object == room and not all(bounce < 3))",
        "light(occluder == \"then\" and light.radiance.r >= 0.000001) or lights(found == sight)",
        "plant then \"and\" then room.wall",
        "in box(-1.5,0,0.25,1,2,3e9) and in lasso(0,0,10.5,0,0,10)",
        "first.x < -1 and last.interaction == glossy and brightest.light == \"a lamp\" and sample != 3",
    ] {
        let condition = Condition::parse(text).unwrap_or_else(|error| panic!("{text}: {error}"));
        let written = condition.to_string();
        assert_eq!(Condition::parse(&written).as_ref(), Ok(&condition), "{text}: {written}");
    }
    let written = |text: &str| Condition::parse(text).unwrap().to_string();
    assert_eq!(written("not (bounce == 1)"), "not bounce == 1");
    assert_eq!(
        written("((bounce == 1) and ((depth == 2) and sample == 3))"),
        "bounce == 1 and (depth == 2 and sample == 3)"
    );
    assert_eq!(written("not (bounce == 1 or (not (depth == 2)))"), "not (bounce == 1 or not depth == 2)");
    let error = |text: &str| Condition::parse(text).unwrap_err().to_string();
    assert_eq!(error("in sphere(1)"), "column 4: found \"sphere\", expected `box` or `lasso`");
    assert!(error("in box(1,2,3,0,5,6)").contains("six numbers"));
    assert!(error("in lasso(1,2,3,4)").contains("three or more points"));
    assert_eq!(error("any(bounce == 2"), "column 16: found \"\", expected `)`");
    assert_eq!(error("plant then"), "column 11: found \"\", expected a word");
}

#[test]
fn nested_terms_are_evaluated_once_for_each_path() {
    let all = merge_parts(&scope(900), tasks(&scope(900)));
    let mut path = all.paths.values().find(|path| path.depth == 3).unwrap().clone();
    path.intersections = path.intersections.repeat(85);
    path.lights = path.lights.repeat(50);
    // 70 terms that hold for the whole path come first. Without stored results, the rest needs 255^8 evaluations.
    let first: Vec<String> = (0..70).map(|at| format!("(sample != {} or bounce < 0)", 1000 + at)).collect();
    let nested = "all(lights(".repeat(4);
    let text = format!("{} and {nested}bounce >= 0{}", first.join(" and "), "))".repeat(4));
    let matcher_of = |text: &str| parse_query(text).compile(&all.scope, &all.names);
    let matcher = matcher_of(&text);
    let found = matcher.select(&path);
    assert_eq!(found.is_some(), path.lights.iter().all(|light| light.vertex > 0));
    assert!(matcher_of(&text.replace("bounce >= 0", "depth == 3 or bounce >= 0")).select(&path).is_some());
    let units = 1 + path.intersections.len() + path.lights.len();
    assert!((211 * units..500 * units).contains(&matcher.work(&path)));
    assert_eq!(matcher_of("bounce == 1").work(&path), units);
}

#[test]
fn work_of_a_selection_counts_each_term() {
    let all = merge_parts(&scope(900), tasks(&scope(900)));
    let path = all.paths.values().next().unwrap();
    let units = 1 + path.intersections.len() + path.lights.len();
    let terms = |text: &str| {
        let work = parse_query(text).compile(&all.scope, &all.names).work(path);
        assert_eq!(work % units, 0, "{text}");
        work / units
    };
    assert_eq!(terms("bounce == 1"), 1);
    assert_eq!(terms("not bounce == 1"), 2);
    assert_eq!(terms("not not bounce == 1"), 3);
    assert_eq!(terms("bounce == 1 and position.x < 2"), 3);
    assert_eq!(terms("bounce == 1 or (position.x < 2 and position.y < 3)"), 5);
    assert_eq!(terms("any(bounce == 1)"), 2);
    assert_eq!(terms("lights(not light.radiance.r > 1)"), 3);
    let triangle = terms("in lasso(0,0,10,0,0,10)");
    assert_eq!(terms("in lasso(0,0,10,0,10,10,0,10,-5,5)"), triangle + 2, "points of a line");
    assert_eq!(terms("a then b then c then d"), terms("a then b") + 2, "objects of a sequence");
}

#[test]
fn names_are_within_their_parents_and_known_with_them() {
    let all = merge_parts(&scope(900), tasks(&scope(900)));
    let (&wall, _) = all.names.iter().find(|(_, (_, text))| text == "room.wall").expect("a wall");
    for (value, is_parent) in
        [("room", true), ("room.wall", true), ("roo", false), ("room.wal", false), ("wall", false)]
    {
        assert_eq!(is_within(&all.names, wall, value), is_parent, "{value}");
        assert_eq!(is_known_name(&all.names, value), is_parent, "{value}");
    }
    assert!(!is_within(&all.names, Name::NONE, "room"));
}
