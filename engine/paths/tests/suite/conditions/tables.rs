//! Truth tables of conditions on paths of a few vertices.

use super::{intersection, light, light_path, object, phrase, selected};
use femc_paths::{InteractionKind, LightPath, Name, NameKind, PathEnd, PathKey};

/// A path through objects, one after the other.
fn line(objects: &[&str]) -> LightPath {
    light_path((0u32..).zip(objects).map(|(parent, text)| intersection(parent, text)).collect(), Vec::new())
}

/// Checks which paths a condition selects: `+` selected, `-` not.
fn check_paths(paths: &[LightPath], table: &[(&str, &str)]) {
    for (text, expected) in table {
        let found: String = paths.iter().map(|path| if selected(text, path).is_some() { '+' } else { '-' }).collect();
        assert_eq!(found, *expected, "{text}");
    }
}

/// Checks what a condition selects of a path, in the notation of [`phrase`].
fn check_parts(path: &LightPath, table: &[(&str, &str)]) {
    for (text, expected) in table {
        assert_eq!(phrase(selected(text, path).as_ref()), *expected, "{text}");
    }
}

#[test]
fn objects_are_visited_in_order_and_again() {
    let paths = [
        line(&[]),
        line(&["ball"]),
        line(&["ball", "door"]),
        line(&["door", "ball"]),
        line(&["ball", "door", "ball"]),
        line(&["ball", "roomy", "ball"]),
        line(&["room", "door", "room.floor"]),
        line(&["room.floor", "roomy", "roo"]),
        line(&["room/lamp", "ball.room", "door"]),
    ];
    check_paths(
        &paths,
        &[
            ("ball then ball", "----++---"),
            ("ball then door", "--+-+---+"),
            ("door then ball", "---++----"),
            ("ball then door then ball", "----+----"),
            ("door then ball then door", "---------"),
            ("not ball then ball", "++++--+++"),
            ("room then room", "------+--"),
            ("room then room.floor", "------+--"),
            ("room.floor then room", "---------"),
            ("room then roo", "-------+-"),
            ("room then ball", "--------+"),
            ("room then ball then door", "--------+"),
            ("ball.room then door", "--------+"),
            ("roo then room", "---------"),
            ("ball then nothing", "---------"),
        ],
    );
}

#[test]
fn a_sequence_stays_on_one_branch() {
    // ball - door - room, and from ball also roomy - roo, and from the camera a second tree: door - ball.
    let path = light_path(
        vec![
            intersection(0, "ball"),
            intersection(1, "door"),
            intersection(1, "roomy"),
            intersection(2, "room"),
            intersection(3, "roo"),
            intersection(0, "door"),
            intersection(6, "ball"),
        ],
        Vec::new(),
    );
    for (text, is_selected) in [
        ("ball then door", true),
        ("ball then door then room", true),
        ("ball then roomy then roo", true),
        ("ball then roo", true),
        ("door then roomy", false),
        ("roomy then room", false),
        ("door then roo", false),
        ("ball then room then roo", false),
        ("door then ball", true),
        ("room then door", false),
        ("door then ball then door", false),
        ("ball then ball", false),
        ("door then door", false),
    ] {
        assert_eq!(selected(text, &path).is_some(), is_selected, "{text}");
    }
}

#[test]
fn a_name_covers_what_lies_in_it_and_no_more() {
    let path = line(&["room", "room.floor", "room.floor.tile", "room/lamp", "roomy", "roo", "ball.room", ""]);
    check_parts(
        &path,
        &[
            ("object == room", "0 1 2 3 |"),
            ("object == room.floor", "1 2 |"),
            ("object == room.floor.tile", "2 |"),
            ("object == room/lamp", "3 |"),
            ("object == roomy", "4 |"),
            ("object == roo", "5 |"),
            ("object == ball", "6 |"),
            ("object == floor", "none"),
            ("object == room.floor.tile.x", "none"),
            ("object == \"\"", "none"),
            ("object != room", "4 5 6 7 |"),
            ("object != nothing", "0 1 2 3 4 5 6 7 |"),
        ],
    );
    // Ten names lie in a parent that is no object itself.
    let many: Vec<String> = (0..10).map(|number| format!("hall.{number}")).collect();
    let scope = super::small_scope();
    let mut names = super::NAMES.clone();
    names.extend(many.iter().map(|text| (object(text), (NameKind::Object, text.clone()))));
    let mut all: Vec<&str> = many.iter().map(String::as_str).collect();
    all.insert(4, "door");
    let hall = super::condition("object == hall");
    let found = hall.compile(&scope, &names).select(&line(&all));
    assert_eq!(phrase(found.as_ref()), "0 1 2 3 5 6 7 8 9 10 |");
}

#[test]
fn quantifiers_on_paths_without_anything() {
    let empty = light_path(Vec::new(), Vec::new());
    let lit = light_path(Vec::new(), vec![light(0, 2.0)]);
    let bare = light_path(vec![intersection(0, "ball")], Vec::new());
    check_paths(
        &[empty, lit, bare],
        &[
            ("bounce == 0", "--+"),
            ("not bounce == 0", "++-"),
            ("any(bounce == 0)", "--+"),
            ("not any(bounce == 0)", "++-"),
            // A path without intersections is examined once without an intersection.
            ("all(bounce == 0)", "--+"),
            ("not all(bounce == 0)", "++-"),
            ("all(depth == 0)", "++-"),
            ("any(not bounce == 0)", "++-"),
            ("light(found == surface)", "-+-"),
            ("not light(found == surface)", "+-+"),
            ("lights(found == surface)", "+++"),
            ("lights(found == met)", "+-+"),
            ("not lights(found == met)", "-+-"),
            ("light(not found == met)", "-+-"),
            ("found == surface", "-+-"),
            ("not found == surface", "+-+"),
            ("light(bounce == 0)", "---"),
            ("any(light.radiance.g == 2)", "-+-"),
            ("any(light(bounce == 0)) or lights(bounce == 0)", "+-+"),
        ],
    );
}

#[test]
fn a_missing_value_equals_nothing() {
    let empty = light_path(Vec::new(), Vec::new());
    let mut hidden = light_path(vec![intersection(0, "ball")], vec![light(1, 0.0)]);
    hidden.lights[0].occluder = Some(object("door"));
    let mut open = hidden.clone();
    open.lights[0].occluder = None;
    open.intersections[0].position = [3.0, 0.0, 0.0];
    check_paths(
        &[empty, hidden, open],
        &[
            ("occluder == door", "-+-"),
            ("occluder != door", "+-+"),
            ("not occluder == door", "+-+"),
            ("not occluder != door", "-+-"),
            ("first.object == ball", "-++"),
            ("first.object != ball", "+--"),
            ("last.interaction == diffuse", "-++"),
            ("last.interaction != diffuse", "+--"),
            ("brightest.light != lamp", "+++"),
            ("first.x == 3", "--+"),
            ("first.x != 3", "++-"),
            ("not first.x != 3", "--+"),
            ("first.x <= 3", "-++"),
            ("first.x > 3", "---"),
            ("brightest.radiance != 0", "+--"),
            ("brightest.radiance >= 0", "-++"),
            ("object != ball", "+--"),
            ("position.x != 3", "++-"),
            ("light.radiance.r != 0", "+--"),
        ],
    );
}

#[test]
fn comparisons_hold_at_equality_as_their_signs_say() {
    let path = light_path([0, 1, 2].map(|parent| intersection(parent, "ball")).into(), Vec::new());
    check_parts(
        &path,
        &[
            ("bounce == 1", "1 |"),
            ("bounce = 1", "1 |"),
            ("bounce != 1", "0 2 |"),
            ("bounce < 1", "0 |"),
            ("bounce <= 1", "0 1 |"),
            ("bounce > 1", "2 |"),
            ("bounce >= 1", "1 2 |"),
            ("bounce > 1.999", "2 |"),
            ("bounce > -1", "0 1 2 |"),
            ("bounce >= 0.5e1", "none"),
        ],
    );
}

#[test]
fn precedence_is_or_then_and_then_not() {
    // Intersection k has bit 0, 1, 2 of k as a, b, c.
    let mut path = light_path((0..8).map(|parent| intersection(parent, "ball")).collect(), Vec::new());
    for (number, it) in path.intersections.iter_mut().enumerate() {
        it.position = [0, 1, 2].map(|bit| f64::from(number as u32 >> bit & 1));
    }
    let named = |text: &str| {
        let words = text.split(' ').map(|word| {
            let inner = word.trim_matches(['(', ')']);
            let axis = match inner {
                "a" => "position.x == 1",
                "b" => "position.y == 1",
                "c" => "position.z == 1",
                _ => return word.to_owned(),
            };
            word.replace(inner, axis)
        });
        words.collect::<Vec<_>>().join(" ")
    };
    for (text, expected) in [
        ("a", "1 3 5 7 |"),
        ("a and b", "3 7 |"),
        ("a or b", "1 2 3 5 6 7 |"),
        ("a or b and c", "1 3 5 6 7 |"),
        ("(a or b) and c", "5 6 7 |"),
        ("a and b or c", "3 4 5 6 7 |"),
        ("a and (b or c)", "3 5 7 |"),
        ("not a and b", "2 6 |"),
        ("not (a and b)", "0 1 2 4 5 6 |"),
        ("not a or b", "0 2 3 4 6 7 |"),
        ("not (a or b)", "0 4 |"),
        ("not not a", "1 3 5 7 |"),
        ("a and not b or c and not a", "1 4 5 6 |"),
        ("not a and not b and not c", "0 |"),
    ] {
        assert_eq!(phrase(selected(&named(text), &path).as_ref()), expected, "{text}");
    }
}

#[test]
fn a_box_has_its_borders() {
    let mut path = light_path((0..8).map(|parent| intersection(parent, "ball")).collect(), Vec::new());
    let positions = [
        [1.0, 2.0, 3.0],
        [2.0, 4.0, 6.0],
        [1.5, 3.0, 4.5],
        [0.999, 3.0, 4.5],
        [2.001, 3.0, 4.5],
        [1.5, 1.999, 4.5],
        [1.5, 4.001, 4.5],
        [1.5, 3.0, 6.001],
    ];
    path.intersections.iter_mut().zip(positions).for_each(|(it, position)| it.position = position);
    check_parts(
        &path,
        &[
            ("in box(1,2,3,2,4,6)", "0 1 2 |"),
            ("not in box(1,2,3,2,4,6)", "3 4 5 6 7 |"),
            ("in box(1,2,3,1,2,3)", "0 |"),
            ("in box(0,0,0,9,9,9)", "0 1 2 3 4 5 6 7 |"),
            ("in box(1.5,1.999,4.5,1.5,4.001,6.001)", "2 5 6 7 |"),
            ("in box(-3,-2,-1,0,0,0)", "none"),
        ],
    );
    assert!(selected("in box(0,0,0,9,9,9)", &light_path(Vec::new(), Vec::new())).is_none());
}

#[test]
fn a_lasso_follows_concave_lines_and_crossings() {
    // A film of 7 x 5 pixels, row by row.
    let drawn = |text: &str| -> Vec<String> {
        let row = |y: u32| {
            let is_in = |x: u32| {
                let mut path = light_path(Vec::new(), Vec::new());
                path.key = PathKey { frame: 3, pixel: 7 * y + x, sample: 0 };
                selected(text, &path).is_some()
            };
            (0..7).map(|x| if is_in(x) { '#' } else { '.' }).collect()
        };
        (0..5).map(row).collect()
    };
    // A rectangle, an L, a U, a triangle, and a line that crosses itself: its middle is outside (even-odd rule).
    assert_eq!(drawn("in lasso(1,1,4,1,4,3,1,3)"), [".......", ".###...", ".###...", ".......", "......."]);
    assert_eq!(drawn("in lasso(0,0,2,0,2,3,6,3,6,5,0,5)"), ["##.....", "##.....", "##.....", "######.", "######."]);
    assert_eq!(
        drawn("in lasso(0,0,1,0,1,4,4,4,4,0,5,0,5,5,0,5)"),
        ["#...#..", "#...#..", "#...#..", "#...#..", "#####.."]
    );
    assert_eq!(drawn("in lasso(0.1,0,6.9,0,0.1,4.5)"), ["######.", "#####..", "###....", "##.....", "......."]);
    assert_eq!(
        drawn("in lasso(0,0,5,0,5,5,0,5,0,0,1,1,1,4,4,4,4,1,1,1)"),
        ["#####..", "#...#..", "#...#..", "#...#..", "#####.."]
    );
    assert_eq!(drawn("not in lasso(0,0,7,0,7,4,0,4)"), [".......", ".......", ".......", ".......", "#######"]);
}

#[test]
fn first_last_and_brightest_are_of_the_record() {
    let mut path = light_path(
        vec![intersection(0, "ball"), intersection(1, "door"), intersection(1, "room")],
        vec![light(1, 1.0), light(2, 3.0), light(0, 3.0), light(3, 2.0)],
    );
    let lamp = |text: &str| Name::new(NameKind::Lamp, text);
    path.lights[1].light = lamp("lamp a");
    path.lights[2].light = lamp("lamp");
    path.lights[3].light = lamp("lamp a/bulb");
    path.intersections[0].interaction = InteractionKind::Glossy;
    path.intersections[2].interaction = InteractionKind::Refraction;
    path.end = PathEnd::Depth;
    let all = "0 1 2 | 0 1 2 3";
    check_parts(
        &path,
        &[
            ("first.object == ball", all),
            ("first.object == room", "none"),
            ("last.object == room", all),
            ("last.object == door", "none"),
            ("first.interaction == glossy and last.interaction == refraction", all),
            ("last.interaction == glossy", "none"),
            // The last of equally bright lights.
            ("brightest.light == lamp", all),
            ("brightest.light == \"lamp a\"", "none"),
            ("brightest.radiance > 2.9 and brightest.radiance < 3.1", all),
            ("end == depth", all),
            ("end != depth", "none"),
        ],
    );
    // Green weighs the most: a light of less total radiance is the brightest.
    path.lights[0].radiance = [0.0, 5.0, 0.0];
    path.lights[0].light = lamp("lamp a/bulb");
    path.lights[1].radiance = [5.0, 0.0, 5.0];
    check_parts(&path, &[("brightest.light == \"lamp a\"", all), ("brightest.radiance > 3.57", all)]);
}

#[test]
fn parts_of_a_path_are_selected_alone() {
    // Two lights at the first intersection, one at the third, one at the camera.
    let mut path = light_path(
        vec![intersection(0, "ball"), intersection(1, "door"), intersection(2, "ball")],
        vec![light(1, 1.0), light(3, 4.0), light(1, 2.0), light(0, 8.0)],
    );
    path.lights[1].occluder = Some(object("door"));
    path.lights[2].occluder = Some(object("ball"));
    check_parts(
        &path,
        &[
            ("light.radiance.r > 1.5", "0 2 | 0 1 2 3"),
            ("light.radiance.r == 8", "none"),
            ("light(light.radiance.r == 8)", "| 3"),
            ("light(light.radiance.r > 1.5)", "0 2 | 1 2 3"),
            ("light(light.radiance.r > 1.5 and object == ball)", "0 2 | 1 2"),
            ("light(occluder == ball and light.radiance.r == 1)", "none"),
            ("occluder == ball and light.radiance.r == 1", "0 | 0 1 2 3"),
            ("lights(light.radiance.r >= 1)", "0 1 2 | 0 1 2 3"),
            ("lights(object == ball)", "none"),
            ("not lights(object == ball)", "| 3"),
            ("any(object == door)", "1 |"),
            ("any(object == door) and any(object == ball)", "|"),
            ("all(object == ball)", "none"),
            ("any(object == ball) and light(occluder == door)", "2 | 1"),
            ("any(object == door) and light(occluder == door)", "|"),
            ("any(object == door) or light(occluder == door)", "1 2 | 1"),
            ("any(light(occluder == door))", "2 | 1"),
            ("any(light.radiance.r == 2)", "0 | 2"),
            ("depth == 3", "0 1 2 | 0 1 2 3"),
            ("depth == 3 and any(bounce == 2)", "2 | 1"),
            ("ball then door", "0 1 2 | 0 1 2 3"),
            ("ball then door and any(bounce == 0)", "0 | 0 2"),
        ],
    );
}
