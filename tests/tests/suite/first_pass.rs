//! The finite-element first pass: closed forms, references, and inputs that break finite elements.

mod closed_forms;
mod hard;

use femc_math::color::luminance;
use femc_math::glam::Vec3A;
use femc_pipeline::radiosity::{self, SolveOptions};
use femc_pipeline::{
    Field, FieldMismatch, FrameLight, Method, SceneSource, Settings, Side, Solution, StopCondition, attach_first_pass,
    encode_solution, first_pass_key, first_pass_world, frame_key, prepare_frame, prepare_world, solve_first_pass,
};
use femc_tests::generated_scenes::{Kind, generate_scene};
use femc_tests::reference::{Reference, rooms_folder};
use femc_tests::{parse_scene, render_frame};
use std::f64::consts::PI;
use std::fmt::Write as _;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

const CAMERA: &str = "camera main =\n  origin .31 .42 .23\n  target .8 .6 .7\n  fov 90\n  film 24 24\n";

/// Returns the unit cube with inward faces and the current material.
pub(crate) fn cube() -> String {
    let mut text = String::new();
    for (k, [x, y, z]) in
        [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0, 0, 1], [1, 0, 1], [1, 1, 1], [0, 1, 1]].iter().enumerate()
    {
        let _ = writeln!(text, "v p{k} =\n  p {x} {y} {z}");
    }
    for face in ["p0 p1 p2 p3", "p7 p6 p5 p4", "p0 p4 p5 p1", "p1 p5 p6 p2", "p2 p6 p7 p3", "p3 p7 p4 p0"] {
        let _ = writeln!(text, "f {face}");
    }
    text
}

fn solve(text: &str) -> Solution {
    let prepared = prepare_frame(&SceneSource::new(parse_scene(text)), &Settings::default(), 1, None)
        .unwrap_or_else(|e| panic!("{e}"));
    let solution = solve_first_pass(&prepared, Method::Fem, &AtomicBool::new(false)).unwrap_or_else(|e| panic!("{e}"));
    let light = solution.field.leaves.len();
    assert!(light > 0 || solution.report.elements == 0, "{:?}", solution.report);
    solution
}

fn solve_to(text: &str, error: f32) -> Solution {
    let prepared = prepare_frame(&SceneSource::new(parse_scene(text)), &Settings::default(), 1, None)
        .unwrap_or_else(|e| panic!("{e}"));
    let options = SolveOptions { error, ..SolveOptions::default() };
    radiosity::solve(&prepared, &options, &AtomicBool::new(false)).unwrap_or_else(|e| panic!("{e:?}"))
}

/// Returns the least, mean and greatest irradiance of all surfaces on this side, at points spread over them.
fn irradiances(solution: &Solution, wanted: Side) -> [f64; 3] {
    let field = &solution.field;
    let (mut low, mut high, mut sum, mut count) = (f64::INFINITY, 0.0f64, 0.0, 0.0);
    for surface in field.surfaces.iter().filter(|surface| surface.side == wanted) {
        for k in 0..64u32 {
            let mut place = [k % 8, k / 8].map(|k| (k as f32 + 0.5) / 8.0);
            if place[0] + place[1] > 1.0 && matches!(surface.form, femc_pipeline::Form::Triangle(_)) {
                place = place.map(|x| 1.0 - x);
            }
            let spot = surface.point_at(place.into());
            let v = match surface.form {
                femc_pipeline::Form::Curved { shape, .. } => shape.parameter_at_share(f64::from(place[1])) as f32,
                _ => place[1],
            };
            let hit = femc_geometry::Hit {
                t: 1.0,
                instance: surface.instance,
                primitive: surface.primitives[0],
                u: place[0],
                v,
            };
            let value = f64::from(field.irradiance(&hit, wanted, spot.position, spot.normal).y);
            assert!(value.is_finite() && value >= 0.0, "{value}");
            (low, high, sum, count) = (low.min(value), high.max(value), sum + value, count + 1.0);
        }
    }
    [low, sum / count, high]
}

/// Returns the mean irradiance of a rectangle's front side, without direct light of lamps.
fn mean_irradiance(solution: &Solution, surface: usize) -> f64 {
    const EDGE: u32 = 64;
    let it = &solution.field.surfaces[surface];
    let at = |k: u32| {
        let place = [k % EDGE, k / EDGE].map(|k| (k as f32 + 0.5) / EDGE as f32);
        let spot = it.point_at(place.into());
        let (instance, primitive) = (it.instance, it.primitives[0]);
        let hit = femc_geometry::Hit { t: 1.0, instance, primitive, u: place[0], v: place[1] };
        f64::from(solution.field.irradiance(&hit, it.side, spot.position, spot.normal).y)
    };
    (0..EDGE * EDGE).map(at).sum::<f64>() / f64::from(EDGE * EDGE)
}

pub(crate) fn furnace(reflectance: f64, fog: &str) -> String {
    format!("{CAMERA}{fog}m wall =\n  sides 1\n  rd {reflectance}\n  ed {PI}\n{}", cube())
}

/// Without subdivision, every point sees the whole of each wall, and the form factors are exact. With subdivision, light that a
/// part receives through links of the whole wall is linear over the wall. This causes the error, which returns at each reflection.
#[test]
fn surfaces_of_evenly_shining_closed_box_have_furnace_light() {
    for reflectance in [0.2, 0.5, 0.9] {
        // The luminance is 1 / (1 - rd) everywhere, of which 1 comes directly from the walls.
        let want = PI * (1.0 / (1.0 - reflectance) - 1.0);
        for error in [0.5, 0.1, 0.03, 0.01] {
            let solution = solve_to(&furnace(reflectance, ""), error);
            let [low, mean, high] = irradiances(&solution, Side::Front).map(|value| value / want - 1.0);
            let times = 1.0 / (1.0 - reflectance);
            println!("{reflectance}, {error}: {low:.5} {mean:.5} {high:.5}, {} leaves", solution.report.leaves);
            let (of_mean, of_all) = if solution.report.leaves == 6 {
                (1e-3, 3e-3)
            } else {
                (0.2 * f64::from(error) * times, f64::from(error))
            };
            assert!(
                mean.abs() < of_mean && low > -of_all && high < of_all,
                "{reflectance}, {error}: {low} {mean} {high}"
            );
        }
    }
}

#[test]
fn fog_that_takes_nothing_leaves_the_furnace_as_it_is() {
    for scattering in [0.3, 1.0] {
        let fog = format!("medium air =\n  sigma_s {scattering}\nmbox air 0 0 0 1 1 1\n");
        let text = furnace(0.5, &fog);
        let settings = Settings { stop: StopCondition::Spp(64), method: Method::Fem, ..Settings::default() };
        let image = render_frame(&parse_scene(&text), &settings, 1);
        let values: Vec<f64> = image.color.pixels.iter().map(|p| f64::from(p[1])).collect();
        let mean = values.iter().sum::<f64>() / values.len() as f64;
        assert!((mean - 2.0).abs() < 0.04, "{scattering}: {mean}");
    }
}

/// Four points of a ceiling can all be far from a lamp that hangs close to it, and miss its light there.
#[test]
fn a_lamp_next_to_a_ceiling_lights_it_as_the_closed_form_says() {
    let (radius, below) = (0.04f64, 0.12f64);
    let mut text = String::from(CAMERA);
    text.push_str("m wall =\n  sides 1\n  rd 0.5\n");
    text.push_str(&cube().replace(" 1\n", " 4\n").replace(" 1 ", " 4 ").replace(" 1 ", " 4 "));
    let _ = write!(text, "m lamp =\n  ed 100\nv l =\n  p 1.7 2.3 {}\nsph l {radius}\n", 4.0 - below);
    for error in [1.0, 0.3] {
        let Solution { mut field, report } = solve_to(&text, error);
        field.leaves = std::mem::take(&mut field.direct);
        const EDGE: u32 = 256;
        let (mut have, mut want) = (0.0, 0.0);
        let ceiling = &field.surfaces[1];
        for k in 0..EDGE * EDGE {
            let place = [k % EDGE, k / EDGE].map(|k| (k as f32 + 0.5) / EDGE as f32);
            let spot = ceiling.point_at(place.into());
            let (instance, primitive) = (ceiling.instance, ceiling.primitives[0]);
            let hit = femc_geometry::Hit { t: 1.0, instance, primitive, u: place[0], v: place[1] };
            have += f64::from(field.irradiance(&hit, ceiling.side, spot.position, spot.normal).y);
            // Irradiance of a sphere of luminance L: pi L times the squared sine of its angle, times the cosine.
            let [x, y] = [0, 1].map(|axis| 4.0 * f64::from(place[axis]) - [2.3, 1.7][axis]);
            let distance2 = x * x + y * y + below * below;
            want += 100.0 * radius * radius / distance2 * below / distance2.sqrt();
        }
        println!("error {error}: {:.4} of the closed form, {} elements", have / want, report.elements);
        assert!((have / want - 1.0).abs() < 0.03, "error {error}: {}", have / want);
    }
}

/// Links that are each exact enough can be wrong in sum. Rays correct this, and find light from mirrors. The mean irradiance is
/// within 4 % of that of paths, in fog within 10 %.
#[test]
fn leaves_have_the_irradiance_that_paths_find() {
    let room = std::fs::read_to_string(concat!(env!("CARGO_MANIFEST_DIR"), "/../scenes/cornell.mgf")).expect("a scene");
    let fog = "medium air =\n  sigma_s 0.08\n  sigma_a 0.02\n  phase iso\nmglobal air\n";
    let mirrors = room.replace("\trd 1\nm teal", "\trd .2\n\trs .8 0\nm teal");
    assert_ne!(mirrors, room);
    for (name, text, most) in [
        ("clear", room.clone(), [0.04, 0.03]),
        ("mirrors", mirrors, [0.04, 0.05]),
        ("fog", format!("{fog}{room}"), [0.1, 0.03]),
    ] {
        let scene = parse_scene(&text);
        let points = femc_tests::irradiance::sample_points(&scene, 600, 256).unwrap_or_else(|e| panic!("{e}"));
        let solution = solve_to(&text, 0.3);
        let found = femc_tests::irradiance::compare(&scene, &solution, &points).unwrap_or_else(|e| panic!("{e}"));
        println!(
            "{name}: {found:?}, checked {}, corrected {}",
            solution.report.ray_link_ratio, solution.report.ray_correction
        );
        assert!((found.mean_ratio - 1.0).abs() < most[0] && found.lit_relmse < most[1], "{name}: {found:?}");
    }
}

/// Solves a box whose walls emit evenly and whose floor is the only reflector. Every other side receives its light according to its
/// form factor.
fn floor_alone([x, y, z]: [f64; 3]) -> [f64; 3] {
    let mut text = String::from(CAMERA);
    for (k, corner) in
        [[0., 0., 0.], [x, 0., 0.], [x, y, 0.], [0., y, 0.], [0., 0., z], [x, 0., z], [x, y, z], [0., y, z]]
            .iter()
            .enumerate()
    {
        let _ = writeln!(text, "v p{k} =\n  p {} {} {}", corner[0], corner[1], corner[2]);
    }
    let dark = 1e-6;
    for (reflectance, face) in [
        (0.5, "p0 p1 p2 p3"),
        (dark, "p7 p6 p5 p4"),
        (dark, "p0 p4 p5 p1"),
        (dark, "p1 p5 p6 p2"),
        (dark, "p2 p6 p7 p3"),
        (dark, "p3 p7 p4 p0"),
    ] {
        let _ = writeln!(text, "m m{reflectance} =\n  sides 1\n  rd {reflectance}\n  ed {PI}\nf {face}");
    }
    let solution = solve_to(&text, 0.01);
    // Surfaces are in face order: the ceiling, the side along x, the side along y.
    [1, 2, 3].map(|surface| mean_irradiance(&solution, surface) / (0.5 * PI))
}

/// Form factors of two parallel rectangles and of two with a common edge (\[howell2010\], C-11 and C-14).
#[test]
fn rectangles_have_their_form_factors() {
    for (sides, want) in [
        ([1.0, 1.0, 1.0], [0.199_824_9, 0.200_043_8, 0.200_043_8]),
        ([1.0, 2.0, 1.0], [0.285_875_4, 0.232_852_6, 0.240_636_0]),
    ] {
        let have = floor_alone(sides);
        println!("{sides:?}: {have:?}, wanted {want:?}");
        for (have, want) in have.iter().zip(want) {
            assert!((have - want).abs() < 1e-4, "{sides:?}: {have}, not {want}");
        }
    }
}

#[test]
fn sphere_with_lamp_inside_gathers_light_as_integrating_sphere() {
    for reflectance in [0.5, 0.9] {
        let text = format!(
            "{CAMERA}m wall =\n  sides 1\n  rd {reflectance}\nv c =\n  p 0 0 0\nsph c -1\nm lamp =\n  sides 1\n  ed 100\nv l =\n  p .2 .1 0\nsph l .02\n"
        );
        let solution = solve(&text);
        let flux = 100.0 * 4.0 * PI * 0.02 * 0.02;
        let want = flux * reflectance / (4.0 * PI * (1.0 - reflectance));
        let [low, mean, high] = irradiances(&solution, Side::Front);
        assert!((mean / want - 1.0).abs() < 0.015, "{reflectance}: {mean}, not {want}");
        assert!(low > 0.95 * want && high < 1.05 * want, "{reflectance}: {low} to {high}, not {want}");
    }
}

#[test]
fn the_reference_room_looks_as_its_reference_does() {
    let loaded = femc_import::load_scene_file(&rooms_folder().join("box.mgf")).unwrap_or_else(|e| panic!("{e}"));
    let settings = Settings { stop: StopCondition::Spp(64), method: Method::Fem, ..Settings::default() };
    let image = render_frame(&Arc::new(loaded.scene), &settings, 1);
    let c = Reference::read(&rooms_folder(), "box").compare(&image, 16);
    println!("relmse {:.4} less {:.4}, mean ratio {:.3}", c.relmse, c.reference_noise, c.mean_ratio);
    assert!(c.relmse - c.reference_noise < 0.02 && (c.mean_ratio - 1.0).abs() < 0.06, "{c:?}");
}

#[test]
fn a_lamp_in_fog_looks_as_by_path_tracing() {
    let lamp = "m lamp =\n  sides 1\n  ed 100\nv l0 =\n  p .4 .4 .98\nv l1 =\n  p .6 .4 .98\nv l2 =\n  p .6 .6 .98\nv l3 =\n  p .4 .6 .98\nf l3 l2 l1 l0\n";
    for scattering in [0.5, 1.0] {
        let fog = format!("medium air =\n  sigma_s {scattering}\n  sigma_a .1\nmbox air 0 0 0 1 1 1\n");
        let text = format!("{CAMERA}{fog}{lamp}m wall =\n  sides 1\n  rd .5\n{}", cube());
        let mean = |method, spp| {
            let settings = Settings { stop: StopCondition::Spp(spp), method, ..Settings::default() };
            let image = render_frame(&parse_scene(&text), &settings, 1);
            image.color.pixels.iter().map(|p| f64::from(p[1])).sum::<f64>() / image.color.pixels.len() as f64
        };
        let (by_elements, by_paths) = (mean(Method::Fem, 32), mean(Method::Pt, 256));
        println!("scattering {scattering}: {by_elements:.4} by elements, {by_paths:.4} by paths");
        assert!(
            (by_elements / by_paths - 1.0).abs() < 0.08,
            "{scattering}: {by_elements} by elements, {by_paths} by paths"
        );
    }
}

/// A lamp that shines on the ceiling close above it, too: the room does not see that bright part of the ceiling.
#[test]
fn light_behind_a_lamp_stays_there() {
    let corners = [[-0.02, -0.02], [0.02, -0.02], [0.02, 0.02], [-0.02, 0.02]].map(|[x, y]| [0.4 + x, 0.6 + y]);
    let mut text = format!("{CAMERA}m wall =\n  sides 1\n  rd .6\n{}m lamp =\n  sides 2\n  rd 0\n  ed 1000\n", cube());
    for (k, [x, y]) in corners.iter().enumerate() {
        let _ = writeln!(text, "v l{k} =\n  p {x} {y} .998");
    }
    text += "f l0 l1 l2 l3\n";
    let scene = parse_scene(&text);
    let points = femc_tests::irradiance::sample_points(&scene, 600, 256).unwrap_or_else(|e| panic!("{e}"));
    let found =
        femc_tests::irradiance::compare(&scene, &solve_to(&text, 0.3), &points).unwrap_or_else(|e| panic!("{e}"));
    println!("{found:?}");
    assert!((found.mean_ratio - 1.0).abs() < 0.05 && found.lit_relmse < 0.03, "{found:?}");
}

/// A kitchen of small curved objects, whose links carry more light than there is. Without a bound, light grew to 1e19 times its
/// value.
#[test]
fn light_that_grows_from_reflection_to_reflection_is_bounded() {
    let Some(folder) = femc_require::shared_folder("scenes-real") else { return };
    let loaded = femc_import::load_scene_file(&folder.join("soda.mgf")).unwrap_or_else(|e| panic!("{e}"));
    let prepared = prepare_frame(&SceneSource::new(Arc::new(loaded.scene)), &Settings::default(), 1, None);
    let prepared = prepared.unwrap_or_else(|e| panic!("{e}"));
    let options = SolveOptions { error: 0.3, ..SolveOptions::default() };
    let Solution { field, report } =
        radiosity::solve(&prepared, &options, &AtomicBool::new(false)).unwrap_or_else(|e| panic!("{e:?}"));
    assert!(report.row_sum > 2.0 && report.residual <= 1e-4 && report.imbalance < 0.05, "{report:?}");
    let [_, _, most] = irradiances(&Solution { field: Field { direct: Vec::new(), ..field }, report }, Side::Front);
    assert!(most < 1e4, "{most} lx, where paths find a mean of 4");
}

#[test]
fn threads_change_no_bit() {
    let text = format!(
        "{}m box =\n  rd .5\nprism p0 p1 p2 p3 -.2\nm ball =\n  rd .3\nsph p6 .3\n",
        furnace(0.4, "medium air =\n  sigma_s 1\nmbox air 0 0 0 1 1 1\n")
    );
    let solved = [1, 2].map(|threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap_or_else(|e| panic!("{e}"));
        format!("{:?}", pool.install(|| solve(&text)))
    });
    assert!(solved[0] == solved[1], "the solution depends on the number of threads");
}

#[test]
fn decoded_solution_is_bit_identical_and_lights_frame_equally() {
    let text = format!(
        "{}m box =\n  rd .5\nprism p0 p1 p2 p3 -.2\nm ball =\n  rd .3\nsph p6 .3\n",
        furnace(0.4, "medium air =\n  sigma_s 1\nmbox air 0 0 0 1 1 1\n")
    );
    let solution = solve(&text);
    let bytes = encode_solution(&solution);
    let (field, statistics) = Field::decode(&bytes).unwrap_or_else(|e| panic!("{e}"));
    assert_eq!(format!("{field:?}"), format!("{:?}", solution.field));
    assert_eq!((statistics.links, statistics.residual), (solution.report.links as u64, solution.report.residual));
    assert!(field.encode(&statistics) == bytes && bytes.len() < solution.field.memory());
    let source = SceneSource::new(parse_scene(&text));
    let mut world = prepare_world(&source, &Settings::default(), 1, None).unwrap_or_else(|e| panic!("{e}"));
    let brightness = world.brightness;
    let light = |field: &Field, brightness: f32| FrameLight::new(Arc::new(field.clone()), brightness);
    assert_eq!(attach_first_pass(&mut world, light(&field, 1.5 * brightness)), Err(FieldMismatch::Brightness));
    assert!(world.field().is_none());
    assert_eq!(attach_first_pass(&mut world, light(&field, brightness)), Ok(()));
    let other = SceneSource::new(parse_scene(&furnace(0.4, "")));
    let mut other = prepare_world(&other, &Settings::default(), 1, None).unwrap_or_else(|e| panic!("{e}"));
    let other_brightness = other.brightness;
    assert_eq!(attach_first_pass(&mut other, light(&field, other_brightness)), Err(FieldMismatch::Surfaces));
    assert!(other.field().is_none());
}

#[test]
fn frames_share_a_first_pass_if_nothing_but_the_view_changes() {
    let text = |origin: &str, rd: &str| {
        let cube = cube();
        format!("camera main =\n  origin {origin}\n  target .8 .6 .7\n  fov 90\n  film 24 24\nm w =\n  rd {rd}\n{cube}")
    };
    let key = |text: &str, settings: &Settings| {
        let found = frame_key(&SceneSource::new(parse_scene(text)), settings, 1).unwrap_or_else(|e| panic!("{e}"));
        first_pass_key(&found, Method::Fem, 1)
    };
    let settings = Settings::default();
    let here = key(&text(".3 .4 .2", ".5"), &settings);
    let other =
        Settings { size: Some([99, 7]), seed: 9, stop: StopCondition::Spp(3), method: Method::Fem, ..settings.clone() };
    assert_eq!(here, key(&text(".3 .4 .2", ".5"), &other), "neither film, seed, samples nor method count");
    assert_eq!(here, key(&text(".6 .4 100", ".5"), &settings), "nor the camera");
    assert_ne!(here, key(&text(".3 .4 .2", ".6"), &settings), "the world does");
    assert_ne!(here, key(&text(".3 .4 200", ".5"), &settings), "and where the coordinates begin");
}

/// The power of a lamp is a factor of all light. The solution is computed for a lamp of brightness 1, so its bytes do not depend on
/// which job asked first.
#[test]
fn lamps_of_any_power_share_first_pass_and_scale_its_light() {
    let text = |power: f64| {
        let fog = "medium air =\n  sigma_s 1\nmbox air 0 0 0 1 1 1\n";
        let lamp = format!("m lamp =\n  ed {power}\nv l =\n  p .5 .5 .8\nsph l .1\n");
        format!("{}{fog}m w =\n  rd .5\n{}{lamp}", CAMERA, cube())
    };
    let settings = Settings { method: Method::Femc, ..Settings::default() };
    let of = |power: f64| {
        let source = SceneSource::new(parse_scene(&text(power)));
        let key = first_pass_key(&frame_key(&source, &settings, 1).unwrap(), Method::Femc, 1);
        let world = first_pass_world(&source, &settings, 1, None).unwrap();
        let unit = solve_first_pass(&world, Method::Femc, &AtomicBool::new(false)).unwrap();
        let lit = prepare_frame(&source, &settings, 1, None).unwrap();
        let own = solve_first_pass(
            &prepare_world(&source, &settings, 1, None).unwrap(),
            Method::Femc,
            &AtomicBool::new(false),
        );
        (key, encode_solution(&unit), lit.field().unwrap().clone(), own.unwrap().field)
    };
    let (one, other) = (of(170.0), of(2310.0));
    assert_eq!(one.0, other.0);
    assert!(one.1 == other.1, "the same bytes");
    let mean = |field: &Field| field.leaves.iter().map(|leaf| f64::from(leaf.mean_illuminance())).sum::<f64>();
    let fog = |field: &Field| {
        let [min, max] = field.fog.bounds();
        f64::from(luminance(field.fog.mean_radiance(min + (max - min) * 0.3)))
    };
    // A power of two scales numbers without rounding, which would change decisions of the solver.
    let (_, _, lit, own) = of(2048.0);
    assert!((mean(&lit) / mean(&own) - 1.0).abs() < 1e-6, "{} {}", mean(&lit), mean(&own));
    assert!((fog(&lit) / fog(&own) - 1.0).abs() < 1e-6, "{} {}", fog(&lit), fog(&own));
    let power = 2310.0 / 170.0;
    assert!((mean(&other.2) / mean(&one.2) / power - 1.0).abs() < 1e-6);
    assert!((fog(&other.2) / fog(&one.2) / power - 1.0).abs() < 1e-6);
}

#[test]
fn what_breaks_finite_elements_ends_all_the_same() {
    let lamp = "m lamp =\n  ed 100\nv l =\n  p .5 .5 .5\nsph l .1\n";
    let corner = |name: &str, [x, y, z]: [f64; 3]| format!("v {name} =\n  p {x:e} {y:e} {z:e}\n");
    let needle = corner("a", [0.0, 0.0, 0.0])
        + &corner("b", [1.0, 0.0, 0.0])
        + &corner("c", [0.5, 1e-6, 0.0])
        + "m w =\n  rd .5\nf a b c\n";
    let sizes = corner("a", [0.0, 0.0, 0.0])
        + &corner("b", [1e3, 0.0, 0.0])
        + &corner("c", [0.0, 1e3, 0.0])
        + &corner("d", [0.5, 0.5, 1e-3])
        + &corner("e", [0.501, 0.5, 1e-3])
        + &corner("f", [0.5, 0.501, 1e-3])
        + "m w =\n  rd .5\nf a b c\nf d e f\n";
    let twice = format!("m w =\n  rd .5\n{0}{0}", cube());
    let open = corner("a", [0.0, 0.0, 0.0])
        + &corner("b", [1.0, 0.0, 0.0])
        + &corner("c", [0.0, 1.0, 0.0])
        + "m w =\n  rd .5\nf a b c\nf a c b\n";
    let closed = "m w =\n  rd .5\nv c =\n  p .5 .5 .5\nsph c .2\n".to_owned();
    let white = format!("m w =\n  rd 1\n{}", cube());
    let shapes = "m w =\n  rd .5\nv c =\n  p 2 0 0\n  n 0 0 1\nring c .1 .5\ntorus c .1 .4\nv d =\n  p 2 0 1\ncone c .3 d 0\ncyl c .2 d\n".to_owned();
    for (what, text) in [
        ("needle", needle),
        ("sizes", sizes),
        ("twice", twice),
        ("open", open),
        ("closed", closed),
        ("white", white),
        ("shapes", shapes),
    ] {
        let solution = solve(&format!("{CAMERA}{lamp}{text}"));
        let [low, mean, high] = irradiances(&solution, Side::Front);
        assert!(low >= 0.0 && mean <= high && high.is_finite(), "{what}: {low} {mean} {high}");
        assert!(solution.report.bytes < 1 << 28, "{what}: {:?}", solution.report);
    }
    for text in [CAMERA.to_owned(), format!("{CAMERA}{lamp}"), format!("{CAMERA}m w =\n  rd .5\n{}", cube())] {
        let solution = solve(&text);
        assert!(solution.field.fog.mean_radiance(Vec3A::splat(0.5)) == Vec3A::ZERO);
    }
}

/// With little memory for links, they are few and coarse. Rays correct them, so the light of a room is about the same.
#[test]
fn links_with_little_memory_are_few_and_give_same_light() {
    let (text, _) = generate_scene(Kind::Room, 3000);
    let prepared = prepare_frame(&SceneSource::new(parse_scene(&text)), &Settings::default(), 1, None)
        .unwrap_or_else(|e| panic!("{e}"));
    let solve = |memory| {
        let options = SolveOptions { error: 1.0, memory, ..SolveOptions::default() };
        radiosity::solve(&prepared, &options, &AtomicBool::new(false)).unwrap_or_else(|e| panic!("{e:?}"))
    };
    let [free, bound] = [1 << 30, 1 << 20].map(solve);
    let links = [&free, &bound].map(|solution| solution.report.links);
    assert!(2 * links[1] < links[0], "{links:?}");
    assert!(bound.report.inexact_links > 0, "{:?}", bound.report);
    let [free, bound] = [&free, &bound].map(|solution| irradiances(solution, Side::Front)[1]);
    println!("{links:?} links, {free} and {bound} lx");
    assert!((bound / free - 1.0).abs() < 0.15, "{free} and {bound} lx by {links:?} links");
}
