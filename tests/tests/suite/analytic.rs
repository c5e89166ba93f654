//! Scenes with closed-form radiance. Every check is statistical at a stated level, or exact.

use femc_film::FrameImage;
use femc_math::color::LUMINANCE_WEIGHTS;
use femc_pipeline::{Settings, StopCondition};
use femc_tests::{parse_scene, render_frame};

fn spp(n: u32) -> Settings {
    Settings { stop: StopCondition::Spp(n), seed: 5, ..Settings::default() }
}

/// Returns the mean luminance of the image and an upper bound of its standard error.
fn mean(image: &FrameImage) -> (f64, f64) {
    let weights = LUMINANCE_WEIGHTS.to_array().map(f64::from);
    let dot = |p: &[f32; 3], map: fn(f64) -> f64| (0..3).map(|i| weights[i] * map(f64::from(p[i]))).sum::<f64>();
    let n = image.color.pixels.len() as f64;
    let sum: f64 = image.color.pixels.iter().map(|p| dot(p, |x| x)).sum();
    let variance: f64 = image.variance.iter().map(|p| dot(p, f64::sqrt).powi(2)).sum();
    (sum / n, variance.sqrt() / n)
}

/// Checks that the mean is within 4 standard errors (two-sided level 6e-5), plus `slack` (relative) for f32 in the scene itself.
fn assert_mean(image: &FrameImage, expected: f64, slack: f64) {
    let (value, error) = mean(image);
    println!("{value} +- {error}, expected {expected}");
    assert!(value.is_finite() && (value - expected).abs() <= 4.0 * error + slack * expected);
}

/// Returns a closed box around the origin with walls of material `wall`, seen from inside.
fn closed_box(wall: &str, extra: &str) -> String {
    format!(
        "camera main =\n origin 0.3 0.2 0.1\n target 1 0.4 0\n fov 60\n film 16 16\n{extra}\nm wall =\n{wall}\n\
         v a =\n p -1 -1 -1\nv b =\n p 1 -1 -1\nv c =\n p 1 1 -1\nv d =\n p -1 1 -1\nm wall\nprism a b c d -2\n"
    )
}

#[test]
fn furnace_has_emittance_over_one_minus_reflectance_everywhere() {
    let text = closed_box(" sides 2\n c\n rd .5\n ed 3.14159265358979", "");
    assert_mean(&render_frame(&parse_scene(&text), &spp(64), 1), 2.0, 1e-4);
}

#[test]
fn a_furnace_with_glossy_walls_agrees_with_its_own_losses_only() {
    // Mirrors lose nothing: rs 0.5 as a perfect mirror.
    let text = closed_box(" sides 2\n c\n rs .5 0\n ed 3.14159265358979", "");
    assert_mean(&render_frame(&parse_scene(&text), &spp(64), 1), 2.0, 1e-4);
}

#[test]
fn furnace_with_little_absorption_has_exact_brightness() {
    // A path has lost nothing when it ends, however long it is: the weights stay 1 and the variance is finite.
    for wall in [" sides 2\n c\n rd .99\n ed 3.14159265358979", " sides 2\n c\n rd .4\n rs .59 0\n ed 3.14159265358979"]
    {
        assert_mean(&render_frame(&parse_scene(&closed_box(wall, "")), &spp(64), 1), 100.0, 1e-4);
    }
}

#[test]
fn thick_fog_that_absorbs_nothing_leaves_a_furnace_as_it_is() {
    let text = closed_box(" sides 2\n c\n rd .5\n ed 3.14159265358979", "medium fog =\n sigma_s 80\nmglobal fog");
    assert_mean(&render_frame(&parse_scene(&text), &spp(16), 1), 2.0, 1e-4);
}

#[test]
fn a_lamp_that_is_smaller_than_a_pixel_is_seen_by_every_sample() {
    // The image of a ball on the axis is a circle of radius r / sqrt(d^2 - r^2) on the plane at distance 1.
    let (radius, distance) = (0.01f64, 10.0f64);
    let text = format!(
        "camera main =\n origin 0 0 0\n target 1 0 0\n fov 30\n film 9 9\nm lamp =\n sides 1\n c\n ed 314159.265358979\n\
         v s =\n p {distance} 0 0\nm lamp\nsph s {radius}\n"
    );
    let pixel = 2.0 * 15f64.to_radians().tan() / 9.0;
    let area = std::f64::consts::PI * radius * radius / (distance * distance - radius * radius);
    let image = render_frame(&parse_scene(&text), &spp(16), 1);
    let (value, error) = mean(&image);
    let expected = 1e5 * area / (pixel * pixel) / 81.0;
    println!("{value} +- {error}, expected {expected}");
    assert!((value / expected - 1.0).abs() < 1e-3, "16 samples a pixel, of which none but drawn ones meet the lamp");
}

#[test]
fn fog_that_absorbs_nothing_leaves_a_furnace_as_it_is() {
    for phase in ["iso", "hg .7", "schlick -.5", "rayleigh"] {
        let fog = format!("medium fog =\n sigma_s 1.5\n phase {phase}\nmglobal fog");
        let text = closed_box(" sides 2\n c\n rd .5\n ed 3.14159265358979", &fog);
        assert_mean(&render_frame(&parse_scene(&text), &spp(128), 1), 2.0, 1e-4);
    }
}

#[test]
fn a_medium_as_bright_as_its_walls_is_invisible() {
    // sigma_a L = glow / (4 pi) with L = 1 = ed / pi: exact on every path.
    for density in ["uniform", "height -.5 .6"] {
        let fog =
            format!("medium gas =\n sigma_a 2\n glow {}\n density {density}\nmglobal gas", 8.0 * std::f64::consts::PI);
        let text = closed_box(" sides 2\n c\n ed 3.14159265358979", &fog);
        let image = render_frame(&parse_scene(&text), &spp(256), 1);
        assert_mean(&image, 1.0, 1e-4);
    }
}

#[test]
fn a_clear_absorber_attenuates_exactly() {
    let wall = "camera main =\n origin 0 0 0\n target 1 0 0\n fov 1\n film 4 4\nm wall =\n sides 2\n c\n ed 3.14159265358979\n\
                v a =\n p 5 -9 -9\nv b =\n p 5 9 -9\nv c =\n p 5 9 9\nv d =\n p 5 -9 9\nm wall\nf a b c d\n";
    let boxed = format!("{wall}medium gas =\n sigma_a .8\nmbox gas 1 -9 -9 3 9 9\n");
    assert_mean(&render_frame(&parse_scene(&boxed), &spp(4), 1), (-1.6f64).exp(), 1e-4);
    // Two overlapping media add up.
    let two = format!("{boxed}medium more =\n sigma_a .5\nmbox more 2 -9 -9 9 9 9\n");
    assert_mean(&render_frame(&parse_scene(&two), &spp(4), 1), (-1.6f64 - 1.5).exp(), 1e-4);
    // Fog that thins with height: horizontal rays at z = 0, with z0 = -1 and scale 2, see exp(-1/2) of its density.
    let height = format!("{wall}medium gas =\n sigma_a .8\n density height -1 2\nmglobal gas\n");
    assert_mean(&render_frame(&parse_scene(&height), &spp(4), 1), (-0.8 * 5.0 * (-0.5f64).exp()).exp(), 1e-3);
}

#[test]
fn a_diffuse_floor_under_a_sphere_receives_its_form_factor() {
    // Area element dA to a sphere vertically above: F = (R / d)^2; L = rho / pi * pi * L_lamp * F.
    let text = "camera main =\n origin 0 -.001 1\n target 0 0 0\n up 0 1 0\n fov .05\n film 4 4\n\
                m floor =\n sides 2\n c\n rd .6\nm lamp =\n sides 1\n c\n ed 314.159265358979\n\
                v a =\n p -1 -1 0\nv b =\n p 1 -1 0\nv c =\n p 1 1 0\nv d =\n p -1 1 0\nm floor\nf a b c d\n\
                v s =\n p 0 0 4\nm lamp\nsph s .5\n";
    assert_mean(&render_frame(&parse_scene(text), &spp(256), 1), 0.6 * 100.0 * (0.5f64 / 4.0).powi(2), 2e-3);
}

#[test]
fn airlight_of_a_point_source_has_its_closed_form() {
    // Isotropic point of 1 cd at distance 1 from the line of sight, sigma_s = sigma_t = 1, eye 2 m before the foot: 0.008933162
    // (Gauss quadrature of exp(-(t + 2) - r) / (4 pi r^2)).
    let ies = "IESNA:LM-63-2002\n[TEST] isotropic\nTILT=NONE\n1 1000 1 3 1 1 2 0 0 0\n1 1 1\n0 90 180\n0\n1 1 1\n";
    let text = "camera main =\n origin -2 0 0\n target 0 0 0\n fov .02\n film 8 8\n\
                medium fog =\n sigma_s 1\nmglobal fog\nies lamp.ies -t 0 0 1\n";
    let scene = femc_tests::parse_scene_files(&[("test.mgf", text), ("lamp.ies", ies)]);
    let settings = Settings { max_depth: 2, ..spp(512) };
    assert_mean(&render_frame(&scene, &settings, 1), 0.008_933_162, 2e-4);
}

#[test]
fn depth_one_shows_only_what_emits() {
    let text = closed_box(" sides 2\n c\n rd .5\n ed 3.14159265358979", "medium fog =\n sigma_s .5\nmglobal fog");
    let clear = closed_box(" sides 2\n c\n rd .5\n ed 3.14159265358979", "");
    let settings = Settings { max_depth: 1, ..spp(16) };
    assert_mean(&render_frame(&parse_scene(&clear), &settings, 1), 1.0, 1e-5);
    let (foggy, _) = mean(&render_frame(&parse_scene(&text), &settings, 1));
    assert!(foggy < 0.9, "{foggy}");
}

#[test]
fn fog_in_index_matched_surface_looks_like_fog_in_box() {
    let room = "camera main =\n origin 0 -4 0\n target 0 0 0\n fov 30\n film 16 16\nm lamp =\n sides 2\n c\n ed 100\n\
                v la =\n p -1 -1 2\nv lb =\n p 1 -1 2\nv lc =\n p 1 1 2\nv ld =\n p -1 1 2\nm lamp\nf la lb lc ld\n\
                medium fog =\n sigma_s .9\n sigma_a .1\n phase hg .3\n";
    let boxed = format!("{room}mbox fog -.7 -.7 -.7 .7 .7 .7\n");
    let closed = format!(
        "{room}m skin =\n sides 1\n c\n ir 1 0\n ts 1 0\n inside fog\n\
         v a =\n p -.7 -.7 -.7\nv b =\n p .7 -.7 -.7\nv c =\n p .7 .7 -.7\nv d =\n p -.7 .7 -.7\nm skin\nprism d c b a 1.4\n"
    );
    let a = mean(&render_frame(&parse_scene(&boxed), &spp(256), 1));
    let b = mean(&render_frame(&parse_scene(&closed), &spp(256), 1));
    println!("{a:?} {b:?}");
    assert!(a.0 > 0.5 && (a.0 - b.0).abs() < 4.0 * (a.1 * a.1 + b.1 * b.1).sqrt());
}

#[test]
fn a_medium_that_does_nothing_is_no_medium() {
    let room = |medium: &str| {
        let skin = "m skin =\n sides 1\n c\n ir 1 0\n ts 1 0\n inside gas\n";
        let text = format!("medium gas =\n {medium}\nmbox gas -1 -1 -1 1 1 1\n{skin}");
        parse_scene(&closed_box(" sides 2\n c\n rd .5\n ed 1", &text))
    };
    let has_media = |medium| {
        let source = femc_pipeline::SceneSource::new(room(medium));
        !femc_pipeline::prepare_frame(&source, &spp(1), 1, None).expect("a frame").media.is_empty()
    };
    assert!(!has_media("sigma_s 0\n sigma_a 0") && !has_media("sigma_s 0"));
    assert!(has_media("sigma_s .1") && has_media("sigma_a .1") && has_media("sigma_s 0\n glow 1"));
}

#[test]
fn a_moved_scene_gives_the_same_image() {
    let at = |x: f64| {
        let lamp = "m lamp =\n sides 1\n c\n ed 30\n";
        format!(
            "camera main =\n origin {} 0 1\n target {} 0 0\n up 0 1 0\n fov 40\n film 8 8\nm floor =\n sides 2\n c\n rd .5\n{lamp}\
             xf -t {x} 0 0\nv a =\n p -1 -1 0\nv b =\n p 1 -1 0\nv c =\n p 1 1 0\nv d =\n p -1 1 0\nm floor\nf a b c d\n\
             v e =\n p -1 -1 2\nv f =\n p -1 1 2\nv g =\n p 1 1 2\nv h =\n p 1 -1 2\nm lamp\nf e f g h\nxf\n",
            x + 0.2,
            x
        )
    };
    let here = mean(&render_frame(&parse_scene(&at(0.0)), &spp(64), 1));
    let there = mean(&render_frame(&parse_scene(&at(100_000.0)), &spp(64), 1));
    println!("{here:?} {there:?}");
    assert!((here.0 - there.0).abs() < 4.0 * (here.1 + there.1) + 1e-4 * here.0);
}

#[test]
fn small_placed_lamp_lights_as_much_as_baked_lamp() {
    // Regression: lights were rounded differently from the surfaces that rays hit, so shadow rays ended behind a small near lamp.
    let with = |place: &str| {
        format!(
            "camera main =\n origin 300.4 400 .3\n target 300 400 0\n fov 30\n film 16 16\nm floor =\n sides 2\n c\n rd .5\n\
             m lamp =\n sides 1\n c\n ed 100\npath still = linear\n key 0 -t 300 400 0\n\
             v a =\n p 290 390 0\nv b =\n p 310 390 0\nv c =\n p 310 410 0\nv d =\n p 290 410 0\nm floor\nf a b c d\n\
             xf {place}\nv e =\n p -.09 -.06 .01\nv f =\n p -.09 .06 .01\nv g =\n p .09 .06 .01\nv h =\n p .09 -.06 .01\n\
             m lamp\nf e f g h\nxf\n"
        )
    };
    let baked = mean(&render_frame(&parse_scene(&with("-t 300 400 0")), &spp(256), 1));
    let placed = mean(&render_frame(&parse_scene(&with("-path still")), &spp(256), 1));
    println!("{baked:?} {placed:?}");
    assert!(baked.0 > 0.1 && (baked.0 - placed.0).abs() < 4.0 * (baked.1 + placed.1) + 1e-4 * baked.0);
}
