//! Pairs of scenes that describe the same light in two ways and use different code. Their means are equal, or have a known ratio.

use femc_tests::agreement::Estimate;
use femc_tests::text::{block, camera, horizontal_square, material, quad};

/// Samples per pixel of each of 48 renderings.
const SPP: u32 = 48;
/// Probability of a false alarm in one pair.
const LEVEL: f64 = 1e-5;

/// Returns a luminaire of 1000 cd in all directions. Its opening is a box with this edge length, m.
fn ies(edge: f64) -> String {
    format!(
        "IESNA:LM-63-2002\n[TEST] isotropic\nTILT=NONE\n1 1000 1 3 1 1 2 {edge} {edge} {edge}\n1 1 1\n0 90 180\n0\n\
         1000 1000 1000\n"
    )
}

/// Checks that the mean of `a` is `ratio` times that of `b`, and that an error of one percent would be detected.
fn assert_ratio(a: &str, b: &str, ratio: f64) {
    let (sized, point) = (ies(0.1), ies(0.0));
    let estimate =
        |text: &str| Estimate::from_files(&[("test.mgf", text), ("sized.ies", &sized), ("point.ies", &point)], SPP);
    let (a, b) = (estimate(a), estimate(b).scaled(ratio));
    println!("{a:?} {b:?}");
    assert!(a.mean > 0.0 && a.p_value(b) >= LEVEL, "{a:?} is not {b:?}");
    assert!(a.p_value(b.scaled(1.05)) < LEVEL, "nobody would see five percent: {a:?} {b:?}");
}

fn lamp() -> String {
    material("lamp", &["sides 2", "ed 100"]) + &horizontal_square("lamp", [0.0, 0.0, 3.0], 2.5)
}

fn skin(inside: &str) -> String {
    material("skin", &["sides 1", "ir 1 0", "ts 1 0", inside])
}

const FOG: &str = "medium fog =\n sigma_s .6\n sigma_a .2\n";
const HAZE: &str = "medium haze =\n sigma_s .1\n sigma_a .02\n";

#[test]
fn fog_in_two_solids_in_line_equals_fog_in_two_boxes() {
    let room = camera("-6 0 0", "0 0 0", 6.0) + &lamp() + FOG;
    let solids = skin("inside fog") + &block("skin", [-2.0, -1.0, -1.0], [-1.0, 1.0, 1.0]);
    let solids = solids + &block("skin", [1.0, -1.0, -1.0], [2.0, 1.0, 1.0]);
    let boxes = "mbox fog -2 -1 -1 -1 1 1\nmbox fog 1 -1 -1 2 1 1\n";
    assert_ratio(&format!("{room}{solids}"), &format!("{room}{boxes}"), 1.0);
}

#[test]
fn a_cloud_in_haze_does_not_depend_on_whether_it_has_a_skin() {
    let room = camera("-6 0 0", "0 0 0", 4.0) + &lamp() + FOG + HAZE + "mglobal haze\n";
    let solid = skin("inside fog") + &block("skin", [-1.0; 3], [1.0; 3]);
    assert_ratio(&format!("{room}{solid}"), &format!("{room}mbox fog -1 -1 -1 1 1 1\n"), 1.0);
}

#[test]
fn skins_inside_skins_are_boxes_inside_boxes() {
    let room = camera("-6 0 0", "0 0 0", 6.0) + &lamp() + FOG + HAZE;
    let outer = skin("inside haze") + &block("skin", [-2.0; 3], [2.0; 3]);
    let solids = outer + &skin("inside fog").replace("skin", "core") + &block("core", [-1.0; 3], [1.0; 3]);
    let boxes = "mbox haze -2 -2 -2 2 2 2\nmbox fog -1 -1 -1 1 1 1\n";
    assert_ratio(&format!("{room}{solids}"), &format!("{room}{boxes}"), 1.0);
}

#[test]
fn camera_inside_cloud_sees_same_with_and_without_skin() {
    let room = camera(".1 .2 -.3", "2 0 1", 40.0) + &lamp() + FOG;
    let solid = skin("inside fog") + &block("skin", [-1.0; 3], [1.0; 3]);
    assert_ratio(&format!("{room}{solid}"), &format!("{room}mbox fog -1 -1 -1 1 1 1\n"), 1.0);
}

/// Returns a floor with `between` between it and the light.
fn floor_below(between: &str, light: &str) -> String {
    let floor = material("floor", &["sides 2", "rd .5"]) + &horizontal_square("floor", [0.0; 3], 9.0);
    camera("0 0 1", "0 0 0", 10.0) + &floor + between + light
}

fn panel() -> String {
    material("lamp", &["sides 2", "ed 100"]) + &horizontal_square("lamp", [0.0, 0.0, 3.0], 0.5)
}

#[test]
fn a_clear_film_without_a_medium_is_nothing() {
    let film = skin("") + &horizontal_square("skin", [0.0, 0.0, 2.0], 9.0);
    assert_ratio(&floor_below(&film, &panel()), &floor_below("", &panel()), 1.0);
    assert_ratio(&floor_below(&film, "ies point.ies -t 0 0 3\n"), &floor_below("", "ies point.ies -t 0 0 3\n"), 1.0);
}

#[test]
fn a_tinted_film_takes_its_share_of_every_light() {
    let film = material("film", &["sides 1", "ir 1 0", "ts .6 0"]) + &horizontal_square("film", [0.0, 0.0, 2.0], 9.0);
    for light in [panel(), "ies point.ies -t 0 0 3\n".into(), "ies sized.ies -t 0 0 3\n".into()] {
        assert_ratio(&floor_below(&film, &light), &floor_below("", &light), 0.6);
    }
}

#[test]
fn light_comes_through_panes_that_do_not_bend_it() {
    // The upper pane has no reflection, so that no light is reflected back and forth between the panes.
    let pane = |name: &str, rs: &str, z: f64| {
        material(name, &["sides 2", "ts .9 0", rs]) + &horizontal_square(name, [0.0, 0.0, z], 9.0)
    };
    let one = pane("pane", "", 2.0);
    let two = pane("pane", "", 2.0) + &pane("upper", "", 2.5);
    for light in [panel(), "ies point.ies -t 0 0 3\n".into(), "ies sized.ies -t 0 0 3\n".into()] {
        assert_ratio(&floor_below(&one, &light), &floor_below("", &light), 0.9);
        assert_ratio(&floor_below(&two, &light), &floor_below("", &light), 0.81);
    }
}

#[test]
fn fog_behind_a_pane_is_lit_through_it() {
    let scene = |pane: &str| {
        let light = "ies point.ies -t 0 0 3\n";
        format!("{}{FOG}mbox fog -1 -1 -1 1 1 1\n{pane}{light}", camera("-6 0 0", "0 0 0", 6.0))
    };
    let pane = material("pane", &["sides 2", "ts .7 0"]) + &horizontal_square("pane", [0.0, 0.0, 2.0], 30.0);
    assert_ratio(&scene(&pane), &scene(""), 0.7);
}

#[test]
fn a_lamp_behind_a_pane_is_seen_in_a_mirror_and_by_the_camera() {
    let mirror = material("mirror", &["sides 2", "rs .8 0"]) + &horizontal_square("mirror", [0.0; 3], 9.0);
    let pane = material("pane", &["sides 2", "ts .9 0"]) + &horizontal_square("pane", [0.0, 0.0, 2.0], 9.0);
    let scene = |pane: &str| camera("0 0 1", ".1 0 0", 10.0) + &mirror + pane + &lamp();
    assert_ratio(&scene(&pane), &scene(""), 0.9);
    let above = |pane: &str| camera("0 0 1", ".1 0 4", 10.0) + pane + &lamp();
    assert_ratio(&above(&pane), &above(""), 0.9);
}

/// Returns two versions of a scene: one with slight motion while the shutter is open, one without shutter time.
fn moving(scale: f64, what: &str) -> [String; 2] {
    ["0 .5", "0 0"].map(|shutter| {
        let text = floor_below(
            "",
            &format!(
                "path p = linear\n key 0 -t 0 0 .6\n key 1 -t .002 0 .6\nxf -s {scale}\nxf -path p\n{what}xf\nxf\n"
            ),
        );
        format!("time 0 1 10\n{}", text.replace(" film 8 8\n", &format!(" film 8 8\n shutter {shutter}\n")))
    })
}

#[test]
fn a_light_that_moves_hardly_is_as_bright_as_one_that_stands() {
    let sphere = "m lamp =\n c\n sides 1\n ed 100\nv s =\n p 0 0 .1\nm lamp\nsph s .1\n";
    let ring = "m lamp =\n c\n sides 2\n ed 100\nv s =\n p 0 0 .1\n n 0 0 -1\nm lamp\nring s 0 .2\n";
    let quad =
        material("lamp", &["sides 2", "ed 100"]) + &quad("lamp", ["-.1 -.1 0", ".1 -.1 0", ".1 .1 0", "-.1 .1 0"]);
    for what in ["ies sized.ies\n", "ies point.ies\n", sphere, ring, &quad] {
        for scale in [0.3, 5.0] {
            let [open, shut] = moving(scale, what);
            assert_ratio(&open, &shut, 1.0);
        }
    }
}

#[test]
fn luminaire_with_opening_acts_from_afar_as_point() {
    for scale in ["1", "2"] {
        let light = |file: &str| format!("ies {file}.ies -s {scale} -t 0 0 30000\n");
        assert_ratio(&floor_below("", &light("sized")), &floor_below("", &light("point")), 1.0);
    }
}

#[test]
fn thin_air_scatters_in_proportion_to_its_density() {
    // Random numbers for free distances have more than 24 bits: an optical thickness of 2e-6 is 33 steps of 24 bits.
    let air = |sigma: f64| {
        format!("{}medium air =\n sigma_s {sigma}\nmbox air -1 -1 -1 1 1 1\n{}", camera("-6 0 0", "0 0 0", 6.0), lamp())
    };
    assert_ratio(&air(1e-6), &air(1e-3), 1e-3 / (1.0 - 1e-3));
}

/// A segment in fog and a surface choose one of several lamps by its power, whatever its description. The camera looks at the floor
/// in front of them, because it would see balls, but not points.
#[test]
fn measured_lamps_of_one_intensity_are_small_balls_in_fog() {
    let room =
        camera("-6 0 1", "-4.5 0 0", 30.0) + "medium mist =\n sigma_s .1\n sigma_a .02\n phase hg .5\nmglobal mist\n";
    let floor =
        material("floor", &["sides 2", "rd .5", "rs .2 .3"]) + &horizontal_square("floor", [0.0, 0.0, 0.0], 5.0);
    let places = [[0.0, 1.0, 2.0], [1.0, -1.5, 1.5], [-1.0, 0.5, 0.7]];
    let measured: String = places.iter().map(|[x, y, z]| format!("ies point.ies -t {x} {y} {z}\n")).collect();
    // A ball's intensity is pi r^2 times its luminance, and its emittance is pi times its luminance: 1000 cd need 1000 / 0.02^2
    // lm/m2.
    let balls =
        places.iter().enumerate().map(|(k, [x, y, z])| format!("v b{k} =\n p {x} {y} {z}\nm ball\nsph b{k} .02\n"));
    let balls = material("ball", &["sides 1", "ed 2.5e6"]) + &balls.collect::<String>();
    assert_ratio(&(room.clone() + &floor + &measured), &(room + &floor + &balls), 1.0);
}
