//! Tests of queries for paths.

use crate::synthetic::{merge_parts, scope, tasks};
use femc_paths::query::{Condition, Query, QueryError};
use femc_paths::{InteractionKind, LightPath, LightStatistics, Name, NameKind, PathEnd};

fn matching_paths<'a>(all: &'a LightStatistics, query: &Query) -> Vec<(&'a LightPath, Vec<usize>)> {
    let matches = |path: &'a LightPath| {
        let places = query.matches(&all.scope, &all.names, path)?;
        Some((path, places.into_iter().collect()))
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
        plants.first().is_some_and(|plant| walls.iter().any(|wall| wall > plant))
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
    for text in ["", "and", "\"", "é == 2", "object == é", "not", "object ==", "object == )", "depth == 1e999"] {
        let _ = Condition::parse(text).map_err(|error| error.to_string());
    }
}
