//! Compares every technique for finding light with the others and with all of them combined. Each technique is complete, so they
//! agree if their densities, weights and transmittances are right. Tests that always run have the fewest samples that show this.
//! tests/all uses up to four times as many.

use femc_montecarlo::MisTechnique;
use femc_pipeline::{Settings, StopCondition};
use femc_stats::testing::sidak;
use femc_tests::agreement::Estimate;
use femc_tests::text::{block, camera, horizontal_square, material, quad};
use femc_tests::{parse_scene, parse_scene_files, render_frame};

/// Probability of a false alarm over all comparisons of one scene.
const LEVEL: f64 = 1e-4;

const FOG: &str = "medium fog =\n sigma_s .5\n sigma_a .1\n phase hg .4\n";

/// Checks that every pair of {all, light, scatter} agrees.
fn assert_techniques_agree(name: &str, text: &str, spp: u32) {
    let scene = parse_scene_files(&[("test.mgf", text)]);
    let techniques = [None, Some(MisTechnique::Light), Some(MisTechnique::Scatter)];
    let estimates = techniques.map(|only| Estimate::from_scene(&scene, only, spp));
    println!("{name}: {estimates:?}");
    // Near a source in fog, sampling only points on the source has infinite variance. Estimates that are too noisy are ignored.
    let known: Vec<usize> = (0..3).filter(|&i| estimates[i].error < 0.05 * estimates[i].mean).collect();
    assert!(known.contains(&0) && known.len() >= 2, "{name}: too noisy: {estimates:?}");
    for (n, &i) in known.iter().enumerate() {
        for &j in &known[n + 1..] {
            let (a, b) = (estimates[i], estimates[j]);
            let is_same = a.p_value(b) >= sidak(LEVEL, 3);
            assert!(is_same, "{name}: {:?} {a:?} is not {:?} {b:?}", techniques[i], techniques[j]);
        }
    }
}

fn panel(half: f64) -> String {
    material("lamp", &["sides 2", "ed 100"]) + &horizontal_square("lamp", [0.3, 0.0, 3.0], half)
}

fn floor(lines: &[&str]) -> String {
    material("floor", lines) + &horizontal_square("floor", [0.0; 3], 4.0)
}

fn camera_from_above() -> String {
    camera("-2 -.5 1.5", "0 0 .3", 25.0)
}

fn surfaces(spp_factor: u32) {
    let kinds: [(&str, &[&str]); 7] = [
        ("diffuse", &["sides 2", "rd .6"]),
        ("rough", &["sides 2", "rs .7 .3"]),
        ("both", &["sides 2", "rd .3", "rs .5 .2"]),
        ("coated", &["sides 2", "ir 1.5 0", "rd .5", "rs .5 .15"]),
        ("metal", &["sides 2", "ir .2 3.9", "rs .9 .2"]),
        ("translucent", &["sides 2", "rd .3", "td .4"]),
        ("frosted", &["sides 2", "ts .6 .3", "rd .2"]),
    ];
    for (name, lines) in kinds {
        let below = material("ground", &["sides 2", "rd .5"]) + &horizontal_square("ground", [0.0, 0.0, -0.6], 4.0);
        assert_techniques_agree(name, &(camera_from_above() + &panel(1.5) + &floor(lines) + &below), 8 * spp_factor);
    }
}

fn panes(spp_factor: u32) {
    let pane = |lines: &[&str], z: f64| material("pane", lines) + &horizontal_square("pane", [0.0, 0.0, z], 6.0);
    let panes: [(&str, &[&str]); 4] = [
        ("pane", &["sides 2", "ts .8 0", "rs .15 0"]),
        ("stained pane", &["sides 2", "rd .2", "td .1", "ts .6 0"]),
        ("film", &["sides 1", "ir 1 0", "ts .9 0"]),
        ("nearly matched", &["sides 1", "ir 1.0005 0", "ts .9 0", "rd .05"]),
    ];
    for (name, lines) in panes {
        for fog in ["", "mbox fog -3 -3 .2 3 3 2.6\n"] {
            let two = pane(lines, 2.0) + &pane(lines, 1.2);
            let text = camera_from_above() + FOG + fog + &panel(1.5) + &floor(&["sides 2", "rd .6"]) + &two;
            assert_techniques_agree(&format!("{name} {fog}"), &text, 8 * spp_factor);
        }
    }
}

fn fogs(spp_factor: u32) {
    let boxed = "mbox fog -2 -2 .1 2 2 2.5\n";
    let skin = material("skin", &["sides 1", "ir 1 0", "ts 1 0", "inside fog"]);
    let solid = skin.clone() + &block("skin", [-1.0, -1.0, 0.2], [1.0, 1.0, 1.6]);
    let haze = "medium haze =\n sigma_s .15\n sigma_a .02\n phase schlick -.3\n";
    let glass = material("glass", &["sides 1", "ir 1.5 0", "ts 1 .2", "inside fog"]);
    let fogs = [
        ("everywhere", "mglobal fog\n".to_owned()),
        ("box", boxed.to_owned()),
        ("box in haze", format!("{haze}mglobal haze\n{boxed}")),
        ("boxes that overlap", format!("{haze}mbox haze -1 -3 0 3 1 2\n{boxed}")),
        ("solid", solid.clone()),
        ("solid in haze", format!("{haze}mglobal haze\n{solid}")),
        ("solid in a box", format!("{haze}mbox haze -2 -2 .1 2 2 2.5\n{solid}")),
        ("rough glass", glass + &block("glass", [-1.0, -1.0, 0.2], [1.0, 1.0, 1.6])),
        ("thin above", format!("{}mglobal mist\n", FOG.replace("fog", "mist") + " density height .5 .6\n")),
        ("colored", "medium smoke =\n c\n crgb .9 .5 .2\n sigma_s .8\n sigma_a .1\nmglobal smoke\n".to_owned()),
    ];
    for (name, fog) in fogs {
        let text = camera_from_above() + FOG + &fog + &panel(1.5) + &floor(&["sides 2", "rd .4"]);
        assert_techniques_agree(name, &text, 8 * spp_factor);
    }
}

fn sources(spp_factor: u32) {
    let at = |shape: &str| {
        format!(
            "m lamp =\n c\n sides 2\n ed 100\nv s =\n p .3 0 .5\n n .1 .3 -1\nv t =\n p .9 .4 .7\nm lamp\n{shape}\n"
        )
    };
    let sources = ["sph s .2", "cyl s .1 t", "cone s .2 t .05", "ring s .05 .3", "torus s .1 .3"];
    for shape in sources {
        for fog in ["", "mglobal fog\n"] {
            let still = camera_from_above()
                + FOG
                + fog
                + &floor(&["sides 2", "rd .5"])
                + &at(shape).replace("p .3 0 .5", "p .3 0 1.2");
            assert_techniques_agree(&format!("{shape} {fog}"), &still, 4 * spp_factor);
            let moves = "time 0 1 10\npath p = linear\n key 0 -t 0 -.4 0 -rz 20\n key 1 -t .3 4 .6 -rz 70 -s 1.2\n";
            let text = camera_from_above().replace("film 8 8\n", "film 8 8\n shutter 0 .9\n") + FOG + fog;
            let text =
                format!("{moves}{text}{}xf -s 2\nxf -path p\n{}xf\nxf\n", floor(&["sides 2", "rd .5"]), at(shape));
            assert_techniques_agree(&format!("moving {shape} {fog}"), &text, 4 * spp_factor);
        }
    }
}

/// Returns `count` lamps over a floor: panels that face down, panels with a narrow lobe, balls and long strips, in alternation.
fn lamps(count: u32) -> String {
    let power = 2000.0 / f64::from(count);
    let size = if count > 100 { 0.5 } else { 1.0 };
    let kinds = material("down", &["sides 1", &format!("ed {power}")])
        + &material("lobe", &["sides 1", "lobe 12", &format!("ed {power}")])
        + &material("both", &["sides 2", &format!("ed {power}")]);
    let lamp = |i: u32| {
        // Positions without a pattern.
        let [x, y, z] = [0.618_034, 0.754_878, 0.569_84].map(|step: f64| (f64::from(i + 1) * step).fract());
        let (x, y, z) = (6.0 * x - 3.0, 6.0 * y - 3.0, 1.0 + 1.5 * z);
        let panel = |material: &str, a: f64, b: f64| {
            let corner = |u: f64, v: f64| format!("{} {} {z}", x + u * a * size, y + v * b * size);
            let face = [corner(-1.0, -1.0), corner(-1.0, 1.0), corner(1.0, 1.0), corner(1.0, -1.0)];
            quad(material, face.each_ref().map(String::as_str))
        };
        match i % 4 {
            0 => panel("down", 0.3, 0.2),
            1 => panel("lobe", 0.3, 0.3),
            2 => format!("v s{i} =\n p {x} {y} {z}\nm both\nsph s{i} {}\n", 0.2 * size),
            _ => panel("both", 1.0, 0.05),
        }
    };
    (0..count).fold(kinds, |text, i| text + &lamp(i))
}

fn many_lamps(spp_factor: u32) {
    let fog = |more: &str| format!("medium mist =\n sigma_s .3\n sigma_a .05\n{more}");
    let fogs = [
        ("clear", String::new()),
        ("isotropic", fog("") + "mglobal mist\n"),
        ("forward", fog(" phase hg .85\n") + "mglobal mist\n"),
        ("backward", fog(" phase hg -.5\n") + "mglobal mist\n"),
        ("thin above", fog(" density height 1 .5\n") + "mglobal mist\n"),
        ("lamps inside and outside", fog("") + "mbox mist -5 -1 0 0 4 1.8\n"),
        ("thick", "medium mist =\n sigma_s 8\n sigma_a .4\nmbox mist -3 -3 0 3 3 1.2\n".to_owned()),
    ];
    for count in [2, 40, 150] {
        for (name, fog) in &fogs {
            let text = camera_from_above() + fog + &lamps(count) + &floor(&["sides 2", "rd .3", "rs .3 .2"]);
            assert_techniques_agree(&format!("{count} lamps, {name}"), &text, 16 * spp_factor);
        }
    }
}

/// Lamps smaller than a pixel, visible to the camera.
fn small_lamps(spp_factor: u32) {
    let lamp = |shape: &str| {
        format!(
            "m lamp =\n c\n sides 2\n ed 1e5\nv s =\n p .3 0 1.2\n n .9 .3 .1\nv t =\n p .31 .01 1.22\nm lamp\n{shape}\n"
        )
    };
    let pane = material("pane", &["sides 2", "ts .8 0", "rs .1 0"])
        + "v pa =\n p -1 -5 -5\nv pb =\n p -1 5 -5\nv pc =\n p -1 5 5\nv pd =\n p -1 -5 5\nm pane\nf pa pb pc pd\n";
    let view = camera("-4 -.5 1.5", "0 0 1", 25.0);
    let lens = view.replace(" film 8 8\n", " film 8 8\n lens .02 4.3\n");
    let blurred = view.replace(" film 8 8\n", " film 8 8\n lens .2 9\n");
    let thin = "medium fog =\n sigma_s .05\n sigma_a .05\nmglobal fog\n";
    for shape in ["sph s .03", "cyl s .02 t", "ring s 0 .05"] {
        let lamp = lamp(shape);
        for (how, text) in [
            ("in the open", view.clone() + &lamp),
            ("behind a pane", view.clone() + &lamp + &pane),
            ("by a lens", lens.clone() + &lamp),
            ("out of focus", blurred.clone() + &lamp),
            ("in fog", view.clone() + thin + &lamp),
        ] {
            assert_techniques_agree(&format!("{shape} {how}"), &text, 16 * spp_factor);
        }
    }
    let moves = "time 0 1 10\npath p = linear\n key 0 -t 0 -.1 0\n key 1 -t 0 .2 .1\n";
    let text = view.replace(" film 8 8\n", " film 8 8\n shutter 0 .9\n");
    assert_techniques_agree("moving", &format!("{moves}{text}xf -path p\n{}xf\n", lamp("sph s .03")), 16 * spp_factor);
}

/// Flat lamps whose outlines cross pixels: small, larger than pixels, edge on, partly hidden, and partly outside the film.
fn flat_lamps(spp_factor: u32) {
    let corners = |points: &[[f64; 3]]| -> String {
        let vertex = |(at, [x, y, z]): (usize, &[f64; 3])| format!("v p{at} =\n p {x} {y} {z}\n");
        let names: String = (0..points.len()).map(|at| format!(" p{at}")).collect();
        let vertices: String = points.iter().enumerate().map(vertex).collect();
        format!("m lamp =\n c\n sides 2\n ed 1e4\n{vertices}m lamp\nf{names}\n")
    };
    let view = camera("-4 -.5 1.5", "0 0 1", 25.0);
    let lens = view.replace(" film 8 8\n", " film 8 8\n lens .02 4.3\n");
    let thin = "medium fog =\n sigma_s .05\n sigma_a .05\nmglobal fog\n";
    let wall = material("wall", &["sides 2", "rd .5"])
        + "v wa =\n p -1 0 .5\nv wb =\n p -1 2 .5\nv wc =\n p -1 2 1.3\nv wd =\n p -1 0 1.3\nm wall\nf wa wb wc wd\n";
    let floor = floor(&["sides 2", "rd .5"]);
    for (name, points) in [
        ("triangle", &[[0.0, -0.1, 1.0], [0.1, 0.15, 1.02], [0.0, 0.1, 1.3]][..]),
        ("strip, nearly edge on", &[[0.0, -0.5, 1.2], [0.4, -0.5, 1.1], [0.4, 0.5, 1.1], [0.0, 0.5, 1.2]]),
        ("window", &[[0.0, -0.4, 0.7], [0.0, 0.45, 0.7], [0.0, 0.45, 1.3], [0.0, -0.4, 1.3]]),
        ("at the border", &[[0.0, 0.6, 0.9], [0.0, 1.5, 0.9], [0.0, 1.5, 1.1], [0.0, 0.6, 1.1]]),
    ] {
        let lamp = corners(points);
        for (how, text) in [
            ("alone", view.clone() + &lamp),
            ("over a floor, hidden in part", format!("{view}{floor}{wall}{lamp}")),
            ("in fog", format!("{view}{thin}{lamp}")),
            ("by a lens", lens.clone() + &lamp),
        ] {
            assert_techniques_agree(&format!("{name} {how}"), &text, 16 * spp_factor);
        }
    }
}

/// The camera samples the outline of a lamp, so its share of a pixel does not vary. An image of a few samples has almost no noise.
#[test]
fn a_lamp_s_share_of_a_pixel_hardly_varies() {
    let view = camera("-4 -.5 1.5", "0 0 1", 25.0);
    let lamp = "m lamp =\n c\n sides 2\n ed 1e4\nv a =\n p 0 -.5 1.2\nv b =\n p .4 -.5 1.1\nv c =\n p .4 .5 1.1\nv d =\n p 0 .5 1.2\nm lamp\nf a b c d\n";
    let settings = Settings { stop: StopCondition::Spp(16), ..Settings::default() };
    let image = render_frame(&parse_scene(&(view + lamp)), &settings, 1);
    let (mut of_share, mut pixels) = (0.0, 0);
    for at in 0..64 {
        let share = f64::from(image.color.luminance(at)) / (1e4 / std::f64::consts::PI);
        if (0.01..0.99).contains(&share) {
            // Variance of rays through random points of the pixel, which hit the lamp or miss it.
            let by_chance = (1e4 / std::f64::consts::PI).powi(2) * share * (1.0 - share) / 16.0;
            of_share += f64::from(image.luminance_variance[at]) / by_chance;
            pixels += 1;
        }
    }
    assert!(pixels > 4 && of_share < 0.01 * f64::from(pixels), "{of_share} of {pixels} pixels");
}

#[test]
fn on_surfaces_of_every_kind() {
    surfaces(1);
}

#[test]
fn behind_panes_and_films() {
    panes(1);
}

#[test]
fn small_lamps_that_the_camera_sees() {
    small_lamps(1);
}

#[test]
fn in_fog_of_every_kind() {
    fogs(3);
}

#[test]
fn from_sources_of_every_kind_that_stand_or_move() {
    sources(2);
}

#[test]
fn from_many_lamps_in_fog_of_every_kind() {
    many_lamps(1);
}

#[test]
fn flat_lamps_that_cover_parts_of_pixels() {
    flat_lamps(2);
}

mod long {
    use super::{flat_lamps, fogs, many_lamps, panes, small_lamps, sources, surfaces};

    #[test]
    #[ignore = "tests/all: half a minute"]
    fn from_many_lamps_in_fog_of_every_kind() {
        many_lamps(4);
    }

    #[test]
    #[ignore = "tests/all: half a minute"]
    fn on_surfaces_of_every_kind() {
        surfaces(4);
    }

    #[test]
    #[ignore = "tests/all: half a minute"]
    fn behind_panes_and_films() {
        panes(4);
    }

    #[test]
    #[ignore = "tests/all: half a minute"]
    fn small_lamps_that_the_camera_sees() {
        small_lamps(4);
    }

    #[test]
    #[ignore = "tests/all: half a minute"]
    fn in_fog_of_every_kind() {
        fogs(4);
    }

    #[test]
    #[ignore = "tests/all: half a minute"]
    fn from_sources_of_every_kind_that_stand_or_move() {
        sources(4);
    }

    #[test]
    #[ignore = "tests/all: half a minute"]
    fn flat_lamps_that_cover_parts_of_pixels() {
        flat_lamps(4);
    }
}
