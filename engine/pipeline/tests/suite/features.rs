//! Tests of features of rendered tiles against known values of simple scenes.

use femc_film::tile::NONE_HELD;
use femc_film::{AovPiece, AovTile, FeatureImage, Rect, Tiling};
use femc_import::{Bundle, load_scene};
use femc_math::elementary::double;
use femc_pipeline::{
    Feature, FeaturePlan, Layer, LayerPlan, Method, Outputs, Prepared, RenderTask, SceneSource, Settings,
    StatisticsPlan, StopCondition, cryptomatte, feature_channels, feature_layout, frame_key, plan_job, prepare_frame,
};
use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

/// A camera 4 m above the ground that looks down on 4 m x 4 m of it: 0.5 m a pixel; x points right, y up.
const DOWN: &str =
    "camera main =\n\torigin 100 20 4\n\ttarget 100 20 0\n\tup 0 1 0\n\tfov 53.13010235415598\n\tfilm 8 8\n";
/// A lamp outside the view.
const LAMP: &str = "m glow =\n\ted 100\nv l =\n\tp 100 20 9\no lamp\nm glow\nsph l .2\no\n";

/// Returns a rectangle of the ground as an object at a height, from (x0, y0) to (x1, y1) relative to the center.
fn sheet(name: &str, material: &str, [x0, y0, x1, y1]: [f64; 4], z: f64) -> String {
    let corner = |n: &str, x: f64, y: f64| format!("v {n} =\n\tp {} {} {z}\n", 100.0 + x, 20.0 + y);
    let corners = [corner("a", x0, y0), corner("b", x1, y0), corner("c", x1, y1), corner("d", x0, y1)].concat();
    format!("{corners}o {name}\nm {material}\nf a b c d\no\n")
}

const MATTE: &str = "m matte =\n\tc\n\tcxy .3333 .3333\n\trd .4\n";

fn settings(features: &[Feature], spp: u32) -> Settings {
    let features = features.iter().copied().collect();
    Settings { stop: StopCondition::Spp(spp), method: Method::Pt, features, ..Settings::default() }
}

fn world(text: &str, settings: &Settings, frame: u32) -> Prepared {
    let files = BTreeMap::from([("scene.mgf".to_owned(), text.as_bytes().to_vec())]);
    let scene = load_scene(&Bundle(files), "scene.mgf").unwrap_or_else(|e| panic!("{e}")).scene;
    let source = SceneSource::new(Arc::new(scene));
    plan_job(source.scene(), settings, None).unwrap_or_else(|e| panic!("{e}"));
    prepare_frame(&source, settings, frame, None).unwrap()
}

fn tile(prepared: &Prepared, settings: &Settings) -> AovTile {
    let [width, height] = prepared.camera.film;
    let StopCondition::Spp(spp) = settings.stop else { panic!("{settings:?}") };
    let light = LayerPlan::new(prepared, settings).unwrap();
    let light = (!settings.layers.is_empty()).then_some(&light);
    let features = FeaturePlan::from_settings(prepared, settings).unwrap();
    let outputs = Outputs { layers: light, features: features.as_ref(), statistics: None };
    let rect = Rect { x: 0, y: 0, width, height };
    RenderTask::new(prepared, settings, rect, 0..spp).render(outputs).unwrap().aovs
}

/// Returns the features of a frame by channel.
fn features(text: &str, settings: &Settings, frame: u32) -> BTreeMap<String, Vec<f32>> {
    let prepared = world(text, settings, frame);
    let [width, height] = prepared.camera.film;
    let mut piece = AovPiece::new(Tiling::new(width, height, 64).unwrap(), 0);
    piece.put(&tile(&prepared, settings), NONE_HELD).unwrap();
    let mut image = FeatureImage::new(feature_layout(&settings.features), width, height);
    image.put(piece.features.as_ref().unwrap()).unwrap();
    feature_channels(&settings.features).into_iter().zip(image.channels).collect()
}

/// Returns the index of pixel (`x`, `y`) with rows of 8.
fn pixel_index(x: usize, y: usize) -> usize {
    8 * y + x
}

#[test]
fn of_a_plane_depth_position_normal_and_albedo_are_known() {
    let settings = settings(&[Feature::Normal, Feature::Position, Feature::Depth, Feature::Albedo], 64);
    let text = format!("{DOWN}{MATTE}{}{LAMP}", sheet("ground", "matte", [-9.0, -9.0, 9.0, 9.0], 0.0));
    let found = features(&text, &settings, 1);
    let names = ["albedo.B", "albedo.G", "albedo.R", "coverage.A", "depth.Z"];
    let others = ["normal.X", "normal.Y", "normal.Z", "position.X", "position.Y", "position.Z"];
    assert!(found.keys().map(String::as_str).eq(names.into_iter().chain(others)));
    for (x, y) in (0..8).flat_map(|y| (0..8).map(move |x| (x, y))) {
        let value = |name: &str| f64::from(found[name][pixel_index(x, y)]);
        assert_eq!(["normal.X", "normal.Y", "normal.Z"].map(value), [0.0, 0.0, 1.0]);
        assert_eq!(value("coverage.A"), 1.0);
        assert!((value("depth.Z") - 4.0).abs() < 1e-5, "{}", value("depth.Z"));
        assert!(value("position.Z").abs() < 1e-5);
        // 64 stratified samples a pixel: the mean position is that of the pixel's center to a fiftieth of a pixel.
        let [px, py] = [100.0 - 1.75 + 0.5 * x as f64, 20.0 + 1.75 - 0.5 * y as f64];
        assert!((value("position.X") - px).abs() < 0.01, "{} {px}", value("position.X"));
        assert!((value("position.Y") - py).abs() < 0.01, "{} {py}", value("position.Y"));
        assert!(["albedo.R", "albedo.G", "albedo.B"].iter().all(|name| (value(name) - 0.4).abs() < 1e-3));
    }
    // From below, the normal is on the side of the camera.
    let below = text.replace("origin 100 20 4", "origin 100 20 -4");
    assert!(features(&below, &settings, 1)["normal.Z"].iter().all(|z| *z == -1.0));
}

#[test]
fn half_covered_pixel_has_half_coverage_and_means_of_that_half() {
    let settings = settings(&[Feature::Depth], 256);
    // Up to the middle of the fifth column. At a height of 1 m it looks larger by 4/3.
    let text = format!("{DOWN}{MATTE}{}{LAMP}", sheet("board", "matte", [-9.0, -9.0, 0.75 * 0.25, 9.0], 1.0));
    let found = features(&text, &settings, 1);
    for y in 0..8 {
        let [cover, depth] = ["coverage.A", "depth.Z"].map(|name| [3, 4, 5].map(|x| found[name][pixel_index(x, y)]));
        assert_eq!([cover[0], cover[2], depth[2]], [1.0, 0.0, 0.0]);
        assert!((cover[1] - 0.5).abs() <= 4.0 / 256.0, "{cover:?}");
        assert!((depth[1] - 3.0).abs() < 1e-5, "{depth:?}");
    }
}

#[test]
fn fog_is_no_surface_mirrors_are_and_panes_by_reflectance() {
    let settings = settings(&[Feature::Depth, Feature::Albedo], 256);
    let materials = "m mirror =\n\trs .9 0\nm pane =\n\trs .1 0\n\tts .6 0\nm edge =\n\tsides 1\n\tir 1 0\n\tts 1 0\n";
    let ground = sheet("ground", "matte", [-9.0, -9.0, 9.0, 9.0], 0.0);
    let above = |material: &str| {
        let above = sheet("above", material, [-9.0, -9.0, 9.0, 9.0], 1.0);
        format!("{DOWN}{MATTE}{materials}{ground}{above}{LAMP}")
    };
    let mean = |values: &[f32]| values.iter().sum::<f32>() / values.len() as f32;
    let mirror = features(&above("mirror"), &settings, 1);
    assert!(mirror["depth.Z"].iter().all(|depth| (depth - 3.0).abs() < 1e-5));
    assert!(mirror["albedo.G"].iter().all(|albedo| (albedo - 0.9).abs() < 1e-2));
    let edge = features(&above("edge"), &settings, 1);
    assert!(edge["depth.Z"].iter().all(|depth| (depth - 4.0).abs() < 1e-5));
    let pane = features(&above("pane"), &settings, 1);
    // The share of the pane is a seventh, the rest is the ground.
    let [share, depth, albedo] = [1.0 / 7.0, mean(&pane["depth.Z"]), mean(&pane["albedo.G"])];
    assert!((depth - (3.0 * share + 4.0 * (1.0 - share))).abs() < 0.01, "{depth}");
    assert!((albedo - (0.1 * share + 0.4 * (1.0 - share))).abs() < 0.01, "{albedo}");
    // Fog changes nothing.
    let fog = format!("{}medium haze =\n\tsigma_s 2\nmglobal haze\n", above("pane"));
    assert_eq!(features(&fog, &settings, 1), pane);
}

#[test]
fn features_samples_layers_and_statistics_are_independent() {
    let text = format!("{DOWN}{MATTE}{}{LAMP}", sheet("ground", "matte", [-1.0, -1.0, 1.0, 1.0], 0.0));
    let only = settings(&[Feature::Normal, Feature::Depth], 8);
    let both = Settings { layers: vec![Layer::new("direct", "C[RTV]?[LOB]")], ..only.clone() };
    let light = Settings { features: BTreeSet::new(), ..both.clone() };
    let prepared = world(&text, &both, 1);
    let rect = Rect { x: 0, y: 0, width: 8, height: 8 };
    let plans = (LayerPlan::new(&prepared, &both).unwrap(), FeaturePlan::from_settings(&prepared, &both).unwrap());
    assert!(FeaturePlan::from_settings(&prepared, &light).unwrap().is_none());
    let statistics = StatisticsPlan::new(&prepared, &both, 64);
    let task = RenderTask::new(&prepared, &both, rect, 0..8);
    let picture = task.render(Outputs::default()).unwrap().tile;
    let only_layers = Outputs { layers: Some(&plans.0), ..Outputs::default() };
    let layers = RenderTask { settings: &light, ..task.clone() }.render(only_layers).unwrap().aovs.light;
    let mut seen = Vec::new();
    for light in [None, Some(&plans.0)] {
        for of in [None, Some(&statistics)] {
            let outputs = Outputs { layers: light, features: plans.1.as_ref(), statistics: of };
            let rendered = task.render(outputs).unwrap();
            assert!(rendered.tile == picture);
            assert_eq!(rendered.aovs.light, light.and(layers.clone()));
            assert_eq!(rendered.statistics.is_some(), of.is_some());
            seen.push(rendered.aovs.features.unwrap());
        }
    }
    assert!(seen.iter().all(|features| *features == seen[0]));
    // The method `fem` has features, though it has no layers.
    let fem = Settings { method: Method::Fem, ..only.clone() };
    assert_eq!(features(&text, &fem, 1), features(&text, &only, 1));
}

/// Returns the motion of a pixel and its mean position on the ground, relative to the center of the picture, x to the right, y
/// down, m.
fn motion_and_position(found: &BTreeMap<String, Vec<f32>>, pixel: usize) -> ([f64; 2], [f64; 2]) {
    let value = |name: &str| f64::from(found[name][pixel]);
    let place = [value("position.X") - 100.0, 20.0 - value("position.Y")];
    (["motion.X", "motion.Y"].map(value), place)
}

#[test]
fn moving_object_has_motion_to_next_frame_and_still_one_none() {
    let settings = settings(&[Feature::Position, Feature::Motion], 16);
    // In a quarter of a second it moves 0.25 m to the right and 0.125 m up the picture, at a distance of 3 m: 0.375 m a pixel.
    let board = sheet("board", "matte", [-0.7, -0.7, 0.7, 0.7], 1.0);
    let ground = sheet("ground", "matte", [-9.0, -9.0, 9.0, 9.0], 0.0);
    let text = format!(
        "time 0 1 4\n{DOWN}{MATTE}{ground}{LAMP}path slide = linear\n\tkey 0 -t 0 0 0\n\tkey 1 -t 1 .5 0\nxf -path slide\n{board}xf\n"
    );
    let found = features(&text, &settings, 1);
    let wanted = [0.25 / 0.375, -0.125 / 0.375];
    let mut moving = 0;
    for pixel in 0..64 {
        let (motion, _) = motion_and_position(&found, pixel);
        match found["position.Z"][pixel] {
            z if z > 0.999 => {
                moving += 1;
                assert!((0..2).all(|axis| (motion[axis] - wanted[axis]).abs() < 1e-3), "{motion:?}, not {wanted:?}");
            }
            z if z < 1e-3 => assert_eq!(motion, [0.0; 2]),
            _ => {}
        }
    }
    assert!(moving >= 4, "{moving} pixels of the board alone");
    // The last frame and a still have no next one.
    for (text, frame) in [(text.clone(), 5), (text.replace("time 0 1 4\n", ""), 1)] {
        let found = features(&text, &settings, frame);
        assert!(found["motion.X"].iter().chain(&found["motion.Y"]).all(|motion| *motion == 0.0));
    }
}

#[test]
fn turning_object_and_rising_camera_give_geometric_motion() {
    let settings = settings(&[Feature::Position, Feature::Motion], 16);
    let ground = sheet("ground", "matte", [-9.0, -9.0, 9.0, 9.0], 0.0);
    // At 4 m, 0.5 m a pixel: a rotation by 22.5 degrees from one frame to the next, counterclockwise.
    let turning = format!(
        "time 0 1 4\n{DOWN}{MATTE}{LAMP}path turn = linear\n\tkey 0 -rz 0 -t 100 20 0\n\tkey 1 -rz 90 -t 100 20 0\nxf -path turn\nxf -t -100 -20 0\n{ground}xf\nxf\n"
    );
    let (sin, cos) = (double::sin(22.5f64.to_radians()), double::cos(22.5f64.to_radians()));
    // A rise by 1 m.
    let rising = format!(
        "time 0 1 4\npath lift = linear\n\tkey 0 -t 0 0 0\n\tkey 1 -t 0 0 4\n{}\talong lift\n{MATTE}{ground}{LAMP}",
        DOWN
    );
    for frame in [1, 2] {
        let found = [features(&turning, &settings, frame), features(&rising, &settings, frame)];
        for pixel in 0..64 {
            let (turned, [x, y]) = motion_and_position(&found[0], pixel);
            // Rows run downward. Counterclockwise in the world is counterclockwise in the picture.
            let wanted = [x * cos + y * sin - x, y * cos - x * sin - y].map(|m| m / 0.5);
            assert!((0..2).all(|axis| (turned[axis] - wanted[axis]).abs() < 1e-3), "{turned:?}, not {wanted:?}");
            let (risen, place) = motion_and_position(&found[1], pixel);
            let distance = 3.0 + f64::from(frame);
            let wanted = place.map(|m| 8.0 * m / (distance + 1.0) - 8.0 * m / distance);
            assert!((0..2).all(|axis| (risen[axis] - wanted[axis]).abs() < 1e-3), "{risen:?}, not {wanted:?}");
        }
    }
}

#[test]
fn object_moving_with_camera_has_no_motion_in_shutter_and_lens() {
    let settings = settings(&[Feature::Motion], 16);
    let board = sheet("board", "matte", [-1.0, -1.0, 1.0, 1.0], 1.0);
    let ground = sheet("ground", "matte", [-9.0, -9.0, 9.0, 9.0], 0.0);
    let text = |along: &str| {
        format!(
            "time 0 1 4\npath ride = spline\n\tkey 0 -t 0 0 0\n\tkey .4 -t .3 .2 .1\n\tkey 1 -t 1 .2 -.2\n{DOWN}\tshutter 0 .5\n\tlens .05 2\n{along}{MATTE}{LAMP}xf -path ride\n{ground}{board}xf\n"
        )
    };
    let largest = |found: &BTreeMap<String, Vec<f32>>| {
        found["motion.X"].iter().chain(&found["motion.Y"]).fold(0f32, |most, motion| most.max(motion.abs()))
    };
    let with = features(&text("\talong ride\n"), &settings, 2);
    // The tracer approximates the spline by chords. The camera's chords are finer than those of objects.
    assert!(largest(&with) < 3e-3, "{}", largest(&with));
    let without = features(&text(""), &settings, 2);
    assert!(largest(&without) > 0.1, "{}", largest(&without));
}

#[test]
fn later_motion_changes_the_frame_key_only_with_motion_feature() {
    let source = |end: &str| {
        let board = sheet("board", "matte", [-1.0, -1.0, 1.0, 1.0], 1.0);
        let text = format!(
            "time 0 1 4\n{DOWN}{MATTE}{LAMP}path ride = linear\n\tkey 0 -t 0 0 0\n\tkey .5 -t 0 0 1\n\tkey 1 {end}\nxf -path ride\n{board}xf\n"
        );
        let files = BTreeMap::from([("scene.mgf".to_owned(), text.into_bytes())]);
        SceneSource::new(Arc::new(load_scene(&Bundle(files), "scene.mgf").unwrap_or_else(|e| panic!("{e}")).scene))
    };
    let (one, other) = (source("-t 0 0 2"), source("-t 0 0 3"));
    let same = |features: &[Feature], frame: u32| {
        let settings = settings(features, 1);
        let key = |source: &SceneSource| frame_key(source, &settings, frame).unwrap().view;
        key(&one) == key(&other)
    };
    assert_eq!([1, 2, 3, 4].map(|frame| same(&[Feature::Depth], frame)), [true, true, true, false]);
    assert_eq!([1, 2, 3, 4].map(|frame| same(&[Feature::Motion], frame)), [true, true, false, false]);
}

/// Returns the ids and shares of a pixel in a Cryptomatte, by rank.
fn ranks(found: &BTreeMap<String, Vec<f32>>, matte: &str, pixel: usize) -> Vec<(u32, f32)> {
    let value = |number: usize, part: &str| found[&format!("{matte}{number:02}.{part}")][pixel];
    let pair = |number, id, share| (value(number, id).to_bits(), value(number, share));
    (0..3).flat_map(|number| [pair(number, "R", "G"), pair(number, "B", "A")]).collect()
}

#[test]
fn object_and_material_mattes_have_the_shares_of_the_samples() {
    let settings = settings(&[Feature::Object, Feature::Material, Feature::Depth], 256);
    let board = sheet("left.board", "matte", [-9.0, -9.0, 0.25, 9.0], 0.0);
    // A surface in no object with an unnamed material. It covers the second half of the sixth column, and more.
    let bare = "m\n\trd .2\nv a =\n\tp 100.75 0 0\nv b =\n\tp 109 0 0\nv c =\n\tp 109 40 0\nv d =\n\tp 100.75 40 0\nf a b c d\n";
    let text = format!("{DOWN}{MATTE}o left\n{}o\n{bare}{LAMP}", board.replace("left.board", "board"));
    let found = features(&text, &settings, 1);
    let id = cryptomatte::id;
    let default = id("default");
    for y in 0..8 {
        let mut covers = Vec::new();
        for (x, object, material) in [(2, "left.board", "matte"), (4, "left.board", "matte"), (6, "default", "default")]
        {
            let [objects, materials] =
                ["crypto_object", "crypto_material"].map(|matte| ranks(&found, matte, pixel_index(x, y)));
            for (ranks, name) in [(&objects, object), (&materials, material)] {
                let sum: f32 = ranks.iter().map(|rank| rank.1).sum();
                assert_eq!(sum, 1.0, "{ranks:?}");
                let share: f32 = ranks.iter().filter(|rank| rank.0 == id(name)).map(|rank| rank.1).sum();
                let cover = found["coverage.A"][pixel_index(x, y)];
                assert_eq!(share, cover, "{name} {x} {ranks:?}");
                let nothing: f32 = ranks.iter().filter(|rank| rank.0 == 0).map(|rank| rank.1).sum();
                assert_eq!(nothing, 1.0 - cover, "{ranks:?}");
                covers.push(cover);
            }
        }
        assert_eq!([covers[0], covers[4]], [1.0, 1.0]);
        assert!((covers[2] - 0.5).abs() <= 4.0 / 256.0, "{covers:?}");
    }
    assert_ne!(default, id("left.board"));
}
