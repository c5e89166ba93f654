//! Checks the view of the shipped guides: a ball, a table, a wall, and the dark beside it.

use femc_painter::outline::outlines;
use femc_painter::{Guides, RenderView};
use std::path::Path;

fn ball_view() -> RenderView {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../styles/ball.layers.exr");
    RenderView::from_guides(&Guides::read(&path).unwrap()).unwrap()
}

/// Center of the ball in the picture, followed by its radius, pixels.
const MIDDLE: [f32; 2] = [160.0, 163.0];
const RADIUS: f32 = 101.0;

#[test]
fn there_are_four_things_and_one_of_them_is_round() {
    let view = ball_view();
    assert_eq!(view.curvature.len(), 4, "a wall, a ball, a table, and the dark");
    let at = |x: f32, y: f32| view.object[view.pixel_index(x, y)];
    let (round, table, wall) = (at(160.0, 160.0), at(30.0, 300.0), at(30.0, 30.0));
    assert!(round != table && table != wall && wall != round);
    let curved = |object: u8| view.curvature[usize::from(object)];
    assert!(curved(round) > 0.2 && curved(table) < 0.02 && curved(wall) < 0.02, "{:?}", view.curvature);
    // The normals of the ball point away from its center, those of the table up, those of the wall to the eye.
    for (x, y) in [(110.0f32, 120.0f32), (200.0, 140.0), (160.0, 220.0)] {
        let n = view.normal[view.pixel_index(x, y)];
        let (u, v) = ((x - MIDDLE[0]) / RADIUS, (y - MIDDLE[1]) / RADIUS);
        assert!((n[0] - u).abs() < 0.12 && (n[1] - v).abs() < 0.25, "at {x}, {y}: {n:?}");
    }
    assert!(view.normal[view.pixel_index(30.0, 300.0)][1] < -0.9 && view.normal[view.pixel_index(30.0, 30.0)][2] > 0.9);
}

#[test]
fn light_shadow_highlight_and_light_thrown_back_are_told_apart() {
    let view = ball_view();
    let value = |plane: &[f32], x: f32, y: f32| view.interpolate(plane, x, y);
    assert!(value(&view.light, 120.0, 140.0) > 0.8, "the ball is lit on the left");
    assert!(
        value(&view.light, 180.0, 248.0) < 0.05 && value(&view.bounce, 180.0, 248.0) > 0.15,
        "and from below by the table"
    );
    assert!(value(&view.light, 270.0, 235.0) < 0.05, "it casts a shadow");
    assert!(value(&view.bounce, 160.0, 268.0) < 0.1, "where it stands it is dark");
    let brightest = (0..view.gloss.len()).max_by(|&a, &b| view.gloss[a].total_cmp(&view.gloss[b])).unwrap();
    let (x, y) = ((brightest % 320) as f32, (brightest / 320) as f32);
    assert!((x - 130.0).abs() < 12.0 && (y - 132.0).abs() < 12.0, "the highlight is at {x}, {y}");
}

#[test]
fn the_outline_of_the_ball_goes_around_it() {
    let view = ball_view();
    let round = view.object[view.pixel_index(160.0, 160.0)];
    let points: Vec<[f32; 2]> =
        outlines(&view).into_iter().filter(|line| line.object == round).flat_map(|line| line.points).collect();
    assert!((560..700).contains(&points.len()), "{} points, one a pixel", points.len());
    for [x, y] in points {
        let (u, v) = (x - MIDDLE[0], y - MIDDLE[1]);
        assert!(((u * u + v * v).sqrt() - RADIUS).abs() < 4.0, "{x}, {y}");
    }
}
