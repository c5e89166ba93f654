//! Laws of conditions. Expected results come from tables written by hand, and from a second evaluator that shares no code with the
//! crate ([`meaning`]).

mod attributes;
pub(crate) mod generated;
pub(crate) mod meaning;
mod tables;

use femc_paths::query::{Condition, Query, Selection};
use femc_paths::record::Names;
use femc_paths::{
    InteractionKind, Intersection, LightPath, LightRecord, LightTechnique, Name, NameKind, PathEnd, PathKey, Scope,
};
use std::sync::LazyLock;

/// A film of 7 x 5 pixels.
pub(crate) fn small_scope() -> Scope {
    Scope { seed: 1, frame: 3, film: [7, 5], tile_size: 8, max_records: 1000, ..Scope::default() }
}

pub(crate) fn object(text: &str) -> Name {
    Name::new(NameKind::Object, text)
}

/// Objects. The first nine are `room` and objects in it. The names of most others are similar.
pub(crate) const OBJECTS: [&str; 14] = [
    "room",
    "room.floor",
    "room.floor.tile",
    "room/lamp",
    "room.a",
    "room.b",
    "room.c",
    "room.d",
    "room.e",
    "roomy",
    "roo",
    "ball",
    "ball.room",
    "door",
];
pub(crate) const MATERIALS: [&str; 3] = ["chrome", "chrome.dull", "ball"];
pub(crate) const LAMPS: [&str; 3] = ["lamp a", "lamp a/bulb", "lamp"];

/// All names.
pub(crate) static NAMES: LazyLock<Names> = LazyLock::new(|| {
    let kinds = [(NameKind::Object, &OBJECTS[..]), (NameKind::Material, &MATERIALS), (NameKind::Lamp, &LAMPS)];
    let all = kinds.into_iter().flat_map(|(kind, texts)| texts.iter().map(move |text| (kind, *text)));
    all.map(|(kind, text)| (Name::new(kind, text), (kind, text.to_owned()))).collect()
});

/// Creates an intersection after another one, by its number from 1, or after the camera (0).
pub(crate) fn intersection(parent: u32, text: &str) -> Intersection {
    Intersection {
        parent,
        bounce: parent,
        position: [0.0; 3],
        radiance: [0.0; 3],
        throughput: [1.0; 3],
        object: object(text),
        material: Name::NONE,
        interaction: InteractionKind::Diffuse,
    }
}

/// Creates a light at an intersection, by its number from 1, or at the camera (0).
pub(crate) fn light(vertex: u32, gray: f32) -> LightRecord {
    LightRecord {
        vertex,
        order: vertex,
        light: Name::NONE,
        medium: Name::NONE,
        radiance: [gray; 3],
        occluder: None,
        technique: LightTechnique::NextEvent,
    }
}

pub(crate) fn light_path(intersections: Vec<Intersection>, lights: Vec<LightRecord>) -> LightPath {
    LightPath {
        key: PathKey { frame: 3, pixel: 0, sample: 0 },
        radiance: [0.0; 3],
        throughput: [1.0; 3],
        depth: intersections.len() as u32,
        end: PathEnd::Absorbed,
        intersections,
        lights,
    }
}

pub(crate) fn condition(text: &str) -> Query {
    Query { condition: Some(Condition::parse(text).unwrap_or_else(|e| panic!("{text}: {e}"))), ..Query::default() }
}

/// Returns the selected intersections and lights of a path; `None`: the path is not selected. All ways to ask must agree.
pub(crate) fn selected(text: &str, path: &LightPath) -> Option<Selection> {
    let scope = small_scope();
    let query = condition(text);
    let matcher = query.compile(&scope, &NAMES);
    let found = matcher.select(path);
    assert_eq!(matcher.is_match(path), found.is_some(), "{text}");
    // A selection that is used again keeps nothing.
    let mut used = Selection { intersections: vec![7, 8], lights: vec![9] };
    assert_eq!(matcher.select_into(path, &mut used), found.is_some(), "{text}");
    if let Some(found) = &found {
        assert_eq!(used, *found, "{text}");
    }
    found
}

/// Formats a selection: `0 2 | 1` are the selected intersections and lights, `none` is a path that is not selected.
pub(crate) fn phrase(found: Option<&Selection>) -> String {
    let list = |all: &[u32]| all.iter().map(u32::to_string).collect::<Vec<_>>().join(" ");
    found.map_or("none".into(), |it| format!("{} | {}", list(&it.intersections), list(&it.lights)).trim().to_owned())
}
