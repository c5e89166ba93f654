//! Checks the view of the shipped guides: a ball, a table, a wall, and the dark beside it.

use femc_painter::outline::outlines;
use femc_painter::{Guides, Sight};
use std::path::Path;

fn ball() -> Sight {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../styles/ball.layers.exr");
    Sight::of(&Guides::read(&path).unwrap()).unwrap()
}

/// Center of the ball in the picture, followed by its radius, pixels.
const MIDDLE: [f32; 2] = [160.0, 163.0];
const RADIUS: f32 = 101.0;

#[test]
fn there_are_four_things_and_one_of_them_is_round() {
    let sight = ball();
    assert_eq!(sight.curved.len(), 4, "a wall, a ball, a table, and the dark");
    let at = |x: f32, y: f32| sight.object[sight.at(x, y)];
    let (round, table, wall) = (at(160.0, 160.0), at(30.0, 300.0), at(30.0, 30.0));
    assert!(round != table && table != wall && wall != round);
    let curved = |object: u8| sight.curved[usize::from(object)];
    assert!(curved(round) > 0.2 && curved(table) < 0.02 && curved(wall) < 0.02, "{:?}", sight.curved);
    // The normals of the ball point away from its center, those of the table up, those of the wall to the eye.
    for (x, y) in [(110.0f32, 120.0f32), (200.0, 140.0), (160.0, 220.0)] {
        let n = sight.normal[sight.at(x, y)];
        let (u, v) = ((x - MIDDLE[0]) / RADIUS, (y - MIDDLE[1]) / RADIUS);
        assert!((n[0] - u).abs() < 0.12 && (n[1] - v).abs() < 0.25, "at {x}, {y}: {n:?}");
    }
    assert!(sight.normal[sight.at(30.0, 300.0)][1] < -0.9 && sight.normal[sight.at(30.0, 30.0)][2] > 0.9);
}

#[test]
fn light_shadow_highlight_and_light_thrown_back_are_told_apart() {
    let sight = ball();
    let of = |plane: &[f32], x: f32, y: f32| sight.smooth(plane, x, y);
    assert!(of(&sight.light, 120.0, 140.0) > 0.8, "the ball is lit on the left");
    assert!(
        of(&sight.light, 180.0, 248.0) < 0.05 && of(&sight.bounce, 180.0, 248.0) > 0.15,
        "and from below by the table"
    );
    assert!(of(&sight.light, 270.0, 235.0) < 0.05, "it casts a shadow");
    assert!(of(&sight.bounce, 160.0, 268.0) < 0.1, "where it stands it is dark");
    let brightest = (0..sight.gloss.len()).max_by(|&a, &b| sight.gloss[a].total_cmp(&sight.gloss[b])).unwrap();
    let (x, y) = ((brightest % 320) as f32, (brightest / 320) as f32);
    assert!((x - 130.0).abs() < 12.0 && (y - 132.0).abs() < 12.0, "the highlight is at {x}, {y}");
}

#[test]
fn the_outline_of_the_ball_goes_around_it() {
    let sight = ball();
    let round = sight.object[sight.at(160.0, 160.0)];
    let points: Vec<[f32; 2]> =
        outlines(&sight).into_iter().filter(|line| line.object == round).flat_map(|line| line.points).collect();
    assert!((560..700).contains(&points.len()), "{} points, one a pixel", points.len());
    for [x, y] in points {
        let (u, v) = (x - MIDDLE[0], y - MIDDLE[1]);
        assert!(((u * u + v * v).sqrt() - RADIUS).abs() < 4.0, "{x}, {y}");
    }
}
