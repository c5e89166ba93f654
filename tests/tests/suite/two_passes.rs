//! Guided paths have the same mean as unguided paths, whatever the guide says.

use crate::first_pass::{cube, furnace};
use femc_field::{
    Ball, DirectionTable, DirectionTables, Form, Leaf, Parallelogram, RegionTargets, Surface, TableExtent, Target,
    TargetGuide, TargetPack,
};
use femc_film::Filter;
use femc_math::color::luminance;
use femc_math::glam::Vec3A;
use femc_math::hash::{mix64, unit_f32};
use femc_math::sampler::{REPLICATES, replicate_of};
use femc_montecarlo::{Guidance, PathSettings, Tracer, keep_seen_tables};
use femc_pipeline::radiosity::{self, GuideKind, SolveOptions};
use femc_pipeline::{
    Field, FilterAdapter, SceneSource, Settings, TargetDocument, TargetError, TargetKind, prepare_frame,
};
use femc_prepared::Prepared;
use femc_scene::Scene;
use femc_tests::parse_scene;
use rayon::prelude::*;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

const EDGE: u32 = 48;
/// Side length of a block in pixels.
const BLOCK: u32 = 8;

fn prepare_scene_file(name: &str) -> Prepared {
    let path = format!("{}/../scenes/{name}.mgf", env!("CARGO_MANIFEST_DIR"));
    let loaded = femc_import::load_scene_file(path.as_ref()).unwrap_or_else(|e| panic!("{e}"));
    prepare_scene(Arc::new(loaded.scene))
}

fn prepare_scene(scene: Arc<Scene>) -> Prepared {
    let settings = Settings { size: Some([EDGE; 2]), ..Settings::default() };
    prepare_frame(&SceneSource::new(scene), &settings, 1, None).unwrap_or_else(|e| panic!("{e}"))
}

fn solve(prepared: &Prepared) -> Field {
    solve_with(prepared, GuideKind::None)
}

fn solve_with(prepared: &Prepared, guides: GuideKind) -> Field {
    let options = SolveOptions { error: 1.0, guides, ..SolveOptions::default() };
    radiosity::solve(prepared, &options, &AtomicBool::new(false)).unwrap_or_else(|e| panic!("{e:?}")).field
}

/// Renders the mean luminance of each block of pixels. Returns it with its variance.
fn blocks(prepared: &Prepared, guide: Option<&Field>, seed: u64, spp: u32) -> Vec<[f64; 2]> {
    guided_blocks(prepared, guide.map(|field| Guidance::new(prepared, field)), seed, spp)
}

/// Renders blocks with paths that the light of a field ends and splits, and that no target guides.
fn window_blocks(prepared: &Prepared, field: &Field, seed: u64, spp: u32) -> Vec<[f64; 2]> {
    let targets = TargetGuide::without_targets(field);
    guided_blocks(prepared, Some(Guidance::new(prepared, field).with_targets(prepared, &targets)), seed, spp)
}

/// Renders the mean luminance of each block of pixels with paths that are guided. Returns it with its variance.
fn guided_blocks(prepared: &Prepared, guidance: Option<Guidance<'_>>, seed: u64, spp: u32) -> Vec<[f64; 2]> {
    let path = PathSettings { seed, max_depth: 0, single_technique: None };
    let across = EDGE / BLOCK;
    let block = |index: u32| {
        let mut tracer = Tracer::new(prepared, path);
        if let Some(guidance) = guidance {
            tracer = tracer.with_guidance(guidance);
        }
        let (mut mean, mut variance) = (0.0, 0.0);
        for k in 0..BLOCK * BLOCK {
            let pixel = (index / across * BLOCK + k / BLOCK) * EDGE + index % across * BLOCK + k % BLOCK;
            let drawn = (0..spp)
                .map(|sample| f64::from(luminance(tracer.sample(pixel, sample, FilterAdapter(Filter::Box)).color)));
            let (sum, squares) = drawn.fold((0.0, 0.0), |(sum, squares), x| (sum + x, squares + x * x));
            let (n, share) = (f64::from(spp), f64::from(BLOCK * BLOCK));
            mean += sum / n / share;
            variance += (squares / n - (sum / n).powi(2)) / (n - 1.0) / (share * share);
        }
        [mean, variance]
    };
    (0..across * across).into_par_iter().map(block).collect()
}

/// Returns the root mean square and the greatest of the differences, in standard errors.
fn differences(a: &[[f64; 2]], b: &[[f64; 2]]) -> [f64; 2] {
    let z = |(a, b): (&[f64; 2], &[f64; 2])| (a[0] - b[0]) / (a[1] + b[1]).max(1e-30).sqrt();
    let (squares, most) = a.iter().zip(b).map(z).fold((0.0, 0.0f64), |(sum, most), z| (sum + z * z, most.max(z.abs())));
    [(squares / a.len() as f64).sqrt(), most]
}

/// Checks that the blocks agree. If samples were independent, the root mean square of 36 blocks would exceed 1.35 once in 500
/// times, and the greatest difference 4.5 once in 4,000. Samples of a pixel are stratified, so differences are smaller. A density
/// that is 30 % wrong gives 4.35 and 10.0.
fn assert_same_means(name: &str, a: &[[f64; 2]], b: &[[f64; 2]]) {
    let [rms, most] = differences(a, b);
    println!("{name}: differences {rms:.2} standard errors rms, {most:.2} at most");
    assert!(rms < 1.35 && most < 4.5, "{name}: {rms} {most}");
}

/// Tables of directions, at the surfaces and in the fog that the camera sees, and at all.
#[test]
fn tables_of_directions_change_no_mean() {
    for (name, has_fog) in [("cornell", false), ("cornell-fog", true)] {
        let prepared = prepare_scene_file(name);
        let mut field = solve_with(&prepared, GuideKind::Tables);
        let paths = blocks(&prepared, None, 1, 128);
        let all = field.tables.count();
        assert!(all[0] > 50 && (all[1] > 50) == has_fog, "{name}: {all:?} tables");
        assert_same_means(name, &paths, &blocks(&prepared, Some(&field), 2, 128));
        keep_seen_tables(&prepared, &mut field);
        let seen = field.tables.count();
        assert!(seen[0] > 10 && seen[0] < all[0] && (seen[1] > 10) == has_fog, "{name}: {seen:?} of {all:?}");
        assert_same_means(name, &paths, &blocks(&prepared, Some(&field), 3, 128));
        // Any directions at all.
        let table = |k: usize| {
            let light = std::array::from_fn(|cell| if (cell * 7 + k).is_multiple_of(31) { 1.0 } else { 0.0 });
            DirectionTable::new(TableExtent::Sphere, &light)
        };
        let [leaves, fog] = [field.leaves.len(), field.fog.leaves().count()];
        field.tables = DirectionTables::new((0..leaves).map(table).collect(), (0..fog).map(table).collect());
        assert_same_means(name, &paths, &blocks(&prepared, Some(&field), 4, 128));
    }
}

/// Targets as learned, and any targets at all.
#[test]
fn targets_change_no_mean() {
    for (name, openings) in [("cornell", 0), ("glossy", 0), ("cornell-fog", 0), ("door-ajar", 2)] {
        let prepared = prepare_scene_file(name);
        let field = solve(&prepared);
        let paths = blocks(&prepared, None, 1, 128);
        let check = |kind: &str, guide: &TargetGuide, seed| {
            let guidance = Guidance::new(&prepared, &field).with_targets(&prepared, guide);
            assert_same_means(&format!("{name}, {kind}"), &paths, &guided_blocks(&prepared, Some(guidance), seed, 128));
        };
        let learned = femc_guiding::learn(&prepared, &field, &AtomicBool::new(false)).expect("not cancelled");
        let found = learned.openings.len();
        assert!((openings..=2 * openings).contains(&found), "{name}: {:?}", learned.openings);
        assert!(openings > 0 || !learned.patches.is_empty(), "{name}: nothing is guided");
        let guide = learned.guide(&field);
        check("learned", &guide, 2);
        // Targets in other places than those learned, and any targets with any light.
        let away = Vec3A::new(0.3, -0.2, 0.4);
        let moved = |target: &Target| match *target {
            Target::Parallelogram(it) => Target::from(Parallelogram { corner: it.corner + away, ..it }),
            Target::Ball(it) => Ball { center: it.center + away, ..it }.into(),
        };
        let packs = guide.packs().iter();
        let packs = packs.map(|pack| TargetPack::new(&pack.targets().iter().map(moved).collect::<Vec<_>>()));
        let mut displaced = guide.clone();
        displaced.set_targets(packs.collect(), guide.by_region().to_vec());
        check("displaced", &displaced, 3);
        let vector = |k: u64| {
            let number = |axis: u64| 4.0 * unit_f32((mix64(3 * k + axis) >> 32) as u32) - 2.0;
            Vec3A::new(number(0), number(1), number(2))
        };
        let target = |k: u64| match k % 3 {
            0 => Target::from(Ball { center: vector(3 * k), radius: vector(3 * k + 1).length() }),
            _ => Parallelogram { corner: vector(3 * k), edges: [vector(3 * k + 1), vector(3 * k + 2)] }.into(),
        };
        let packs = (0..3).map(|pack| TargetPack::new(&(0..8).map(|k| target(8 * pack + k)).collect::<Vec<_>>()));
        let region = |leaf: u32| {
            let share = |k: usize| if (leaf as usize + k).is_multiple_of(3) { 0.02 * (k + 1) as f32 } else { 0.0 };
            let light_scale = 4f32.powi((leaf % 5) as i32 - 2);
            RegionTargets { pack: leaf % 3, shares: std::array::from_fn(share), light_scale }
        };
        let leaves: Vec<u32> = (0..field.leaves.len() as u32).collect();
        let any = TargetGuide::new(&field, packs.collect(), leaves.iter().map(|&leaf| region(leaf)).collect(), &leaves);
        check("at random", &any, 4);
        // Parts of the surfaces themselves, in whose planes many vertices are.
        let part = |surface: &Surface| match surface.form {
            Form::Parallelogram([corner, a, b]) => {
                Some(Target::from(Parallelogram { corner: corner + (a + b) * 0.25, edges: [a * 0.5, b * 0.5] }))
            }
            Form::Triangle(_) | Form::Curved { .. } => None,
        };
        let parts: Vec<Target> = field.surfaces.iter().filter_map(part).take(8).collect();
        assert!(parts.len() > 4, "{name}: {parts:?}");
        let everywhere = RegionTargets { shares: [0.05; 8], ..Default::default() };
        let walls = TargetGuide::new(&field, vec![TargetPack::new(&parts)], vec![everywhere], &vec![0; leaves.len()]);
        check("in the planes of surfaces", &walls, 5);
    }
}

/// From twenty places of the camera, the gap of the door and the triangle above the door.
#[test]
fn both_openings_of_the_door_are_found() {
    let path = format!("{}/../scenes/door-ajar.mgf", env!("CARGO_MANIFEST_DIR"));
    let text = std::fs::read_to_string(path).unwrap_or_else(|e| panic!("{e}"));
    for view in 0..20 {
        let origin = format!("origin {} {} 1.7", -2.6 + 0.02 * f64::from(view), -1.4 + 0.11 * f64::from(view % 7));
        let prepared = prepare_scene(parse_scene(&text.replace("origin -2.6 -1.4 1.7", &origin)));
        let field = solve(&prepared);
        let learned = femc_guiding::learn(&prepared, &field, &AtomicBool::new(false)).expect("not cancelled");
        let found = learned.openings.iter().map(|opening| {
            let corners = [[0.0, 0.0], [0.0, 1.0], [1.0, 0.0], [1.0, 1.0]]
                .map(|at| opening.target.point_at(at) + prepared.origin.as_vec3a());
            let low = corners.iter().fold(Vec3A::INFINITY, |low, corner| low.min(*corner));
            [low, corners.iter().fold(Vec3A::NEG_INFINITY, |high, corner| high.max(*corner))]
        });
        let found: Vec<[Vec3A; 2]> = found.collect();
        println!("view {view}: {found:.3?}");
        // The gap is open between the edge of the door, at (0.91, -0.29) .. (0.95, -0.30), and the jamb at (1, -0.3).
        // Two openings may share it.
        let gaps = found.iter().filter(|[low, high]| low.x > 0.9 && high.x < 1.02 && high.y < -0.25);
        let [low, high] =
            gaps.fold([f32::INFINITY, f32::NEG_INFINITY], |[low, high], gap| [low.min(gap[0].z), high.max(gap[1].z)]);
        let is_gap = low.abs() < 0.01 && (high - 2.0).abs() < 0.1;
        // The triangle is at the height of the upper edge of the door, which is also that of the lintel. A parallelogram around it
        // may be tilted.
        let is_above = |[low, high]: &[Vec3A; 2]| (low.z - 2.0).abs() < 0.04 && (high.z - 2.0).abs() < 0.04;
        assert!(is_gap && found.iter().any(is_above), "view {view}: {found:?}");
    }
}

/// Learning does not depend on the number of threads.
#[test]
fn learning_has_the_same_bits_for_any_threads() {
    let prepared = prepare_scene_file("door-ajar");
    let field = solve(&prepared);
    let [one, three] = [1, 3].map(|threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap_or_else(|e| panic!("{e}"));
        format!("{:?}", pool.install(|| femc_guiding::learn(&prepared, &field, &AtomicBool::new(false))))
    });
    assert!(one == three);
}

#[test]
fn learning_ends_when_it_is_cancelled() {
    let prepared = prepare_scene_file("door-ajar");
    let field = solve(&prepared);
    assert!(femc_guiding::learn(&prepared, &field, &AtomicBool::new(true)).is_none());
}

/// The document of targets gives the same guide to the bit, and says how much of the light comes through the openings.
#[test]
fn targets_come_back_from_their_document() {
    for name in ["door-ajar", "cornell-fog", "ball"] {
        let prepared = prepare_scene_file(name);
        let field = solve(&prepared);
        let learned = femc_guiding::learn(&prepared, &field, &AtomicBool::new(false)).expect("not cancelled");
        let document = TargetDocument::new(&learned, prepared.origin);
        let bytes = document.encode().expect("a document");
        let decoded = TargetDocument::decode(&bytes).expect("the document");
        assert_eq!(decoded, document);
        let guide = decoded.guide(&field).expect("targets of the field");
        assert_eq!(format!("{guide:?}"), format!("{:?}", learned.guide(&field)), "{name}");
        println!("{name}: {} bytes, {:?}", bytes.len(), document.targets);
        assert!(document.targets.iter().all(|target| (0.0..=1.0).contains(&target.light)));
        if name == "door-ajar" {
            // All light of the room comes through gaps around the door.
            let openings = document.targets.iter().filter(|target| target.kind == TargetKind::Opening);
            let light: f32 = openings.map(|target| target.light).sum();
            assert!((0.9..1.1).contains(&light), "{light}");
            let other = solve(&prepare_scene_file("cornell"));
            assert!(matches!(decoded.guide(&other), Err(TargetError::Leaves)));
        }
    }
}

#[test]
fn damaged_targets_are_refused() {
    let sound = r#"{"format":"femc targets 1","origin":[0,0,0],"paths":1,"rays":2,"targets":
        [{"kind":"opening","light":0.5,"shape":"parallelogram","corner":[0,0,0],"edges":[[1,0,0],[0,1,0]]}],"parts":
        [{"shape":"ball","center":[0,0,1],"radius":2}],"regions":[{"shares":[0.5,0,0,0,0,0,0,0],"light_scale":1}],
        "leaf_regions":[[7,0]]}"#;
    assert!(TargetDocument::decode(sound.as_bytes()).is_ok());
    for (from, to, error) in [
        ("targets 1", "targets 2", "format \"femc targets 2\""),
        ("\"center\":[0,0,1]", "\"center\":[0,0,1e39]", "a shape is not finite"),
        ("[0.5,0", "[0.5,0.6", "shares"),
        ("[0.5,0", "[-0.5,0", "shares"),
        ("\"light_scale\":1", "\"light_scale\":0", "light of a region"),
        ("[7,0]", "[7,1]", "a leaf has no region"),
        ("\"opening\"", "\"door\"", "damaged targets"),
        ("[0,1,0]]", "[0,1]]", "damaged targets"),
    ] {
        let damaged = sound.replace(from, to);
        assert_ne!(damaged, sound);
        let refusal = TargetDocument::decode(damaged.as_bytes()).expect_err(to).to_string();
        assert!(refusal.contains(error), "{to}: {refusal}");
    }
}

/// Wrong light in the field ends paths too early or too late, which only costs time.
#[test]
fn light_that_is_wrong_changes_no_mean() {
    let prepared = prepare_scene_file("cornell");
    let field = solve(&prepared);
    let paths = blocks(&prepared, None, 1, 128);
    type Scale = fn(usize) -> f32;
    let wrong: [(&str, Scale); 4] = [
        ("three times as bright", |_| 3.0),
        ("dark in half of the leaves", |leaf| (leaf % 2) as f32),
        ("at random", |leaf| 10f32.powi((leaf * 7 % 9) as i32 - 4)),
        ("endless in places", |leaf| if leaf % 3 == 0 { f32::INFINITY } else { 1.0 }),
    ];
    for (name, scale) in wrong {
        let changed = with_scaled_leaves(&field, scale);
        assert_same_means(name, &paths, &window_blocks(&prepared, &changed, 2, 128));
    }
}

/// Returns a field with the light of each leaf multiplied by a factor.
fn with_scaled_leaves(field: &Field, factor: impl Fn(usize) -> f32) -> Field {
    let mut leaves = field.leaves.clone();
    for (k, leaf) in leaves.iter_mut().enumerate() {
        match leaf {
            Leaf::Triangle(values) => values.iter_mut().for_each(|value| *value *= factor(k)),
            Leaf::Rectangle(values) => values.iter_mut().for_each(|value| *value *= factor(k)),
            Leaf::Curved(light) => light.0.iter_mut().for_each(|value| *value *= factor(k)),
        }
    }
    Field { leaves, ..field.clone() }
}

/// In a closed box whose walls shine evenly, the luminance is 1 / (1 - albedo) everywhere. Fields that are wrong by wall split paths
/// at some walls and end them at others.
#[test]
fn pixels_of_a_furnace_have_its_light_if_paths_are_split() {
    type Scale = fn(usize) -> f32;
    let scales: [(&str, Scale); 3] = [
        ("as solved", |_| 1.0),
        ("wrong by wall", |leaf| 3f32.powi((leaf * 7 % 5) as i32 - 2)),
        ("dark walls", |leaf| (leaf % 2) as f32),
    ];
    for (albedo, fog) in [(0.5, ""), (0.8, ""), (0.5, "medium air =\n  sigma_s 1\nmbox air 0 0 0 1 1 1\n")] {
        let prepared = prepare_scene(parse_scene(&furnace(albedo, fog)));
        let field = solve(&prepared);
        for (name, scale) in scales {
            let changed = with_scaled_leaves(&field, scale);
            let name = format!("albedo {albedo}, {} bytes of fog, {name}", fog.len());
            assert_pixels_have_light(&name, &prepared, &changed, 1.0 / (1.0 - albedo));
        }
    }
}

/// The weights of lamps differ from vertex to vertex. A branch that is resumed needs the weights at the vertex that it left.
#[test]
fn branches_weigh_lamps_as_at_the_vertex_they_left() {
    let lamp = |name: &str, [x, y, z]: [f64; 3]| {
        let corner = |k: usize, [dx, dy]: [f64; 2]| format!("v {name}{k} =\n  p {} {} {z}\n", x + dx, y + dy);
        let corners: String = [[0.0, 0.0], [0.3, 0.0], [0.3, 0.3], [0.0, 0.3]]
            .into_iter()
            .enumerate()
            .map(|(k, at)| corner(k, at))
            .collect();
        format!("{corners}f {name}0 {name}1 {name}2 {name}3\n")
    };
    let lamps = [lamp("s", [0.02, 0.02, 0.15]), lamp("t", [0.68, 0.68, 0.85]), lamp("u", [0.68, 0.02, 0.4])].concat();
    let camera = "camera main =\n  origin .31 .42 .53\n  target .8 .6 .7\n  fov 90\n  film 24 24\n";
    let wall = format!("m wall =\n  sides 2\n  c\n  rd .8\n{}", cube());
    let text = format!("{camera}{wall}m lamp =\n  sides 2\n  c\n  rd .5\n  ed 10\n{lamps}");
    let prepared = prepare_scene(parse_scene(&text));
    let field = solve(&prepared);
    let changed = with_scaled_leaves(&field, |leaf| 3f32.powi((leaf * 7 % 5) as i32 - 2));
    assert_same_means("three lamps", &blocks(&prepared, None, 1, 256), &window_blocks(&prepared, &changed, 2, 256));
}

/// Checks the frame's mean at 4 standard errors (once in 16,000 times), each block's mean at 5, and each pixel's mean at 8, because
/// the few samples of a pixel are not distributed normally.
fn assert_pixels_have_light(name: &str, prepared: &Prepared, field: &Field, light: f64) {
    const SPP: u32 = 64;
    let (n, count) = (f64::from(SPP), REPLICATES as f64);
    let targets = TargetGuide::without_targets(field);
    let pixel = |pixel: u32| {
        let path = PathSettings { seed: 3, max_depth: 0, single_technique: None };
        let guidance = Guidance::new(prepared, field).with_targets(prepared, &targets);
        let mut tracer = Tracer::new(prepared, path).with_guidance(guidance);
        let mut sums = [0.0; REPLICATES];
        for sample in 0..SPP {
            let drawn = tracer.sample(pixel, sample, FilterAdapter(Filter::Box));
            sums[replicate_of(sample)] += f64::from(luminance(drawn.color));
        }
        let mean = sums.iter().sum::<f64>() / n;
        let spread: f64 = sums.iter().map(|sum| (sum * count / n - mean).powi(2)).sum();
        [mean, spread / (count * (count - 1.0)), tracer.counters.segments as f64 / n]
    };
    let pixels: Vec<[f64; 3]> = (0..EDGE * EDGE).into_par_iter().map(pixel).collect();
    let number = pixels.len() as f64;
    let [mean, variance, segments] = [0, 1, 2].map(|at| pixels.iter().map(|pixel| pixel[at]).sum::<f64>() / number);
    let z = (mean - light) / (variance / number).sqrt();
    let worst = |errors: &mut dyn Iterator<Item = f64>| errors.map(f64::abs).fold(0.0, f64::max) / variance.sqrt();
    let of_pixels = worst(&mut pixels.iter().map(|pixel| pixel[0] - light));
    let (across, area) = (EDGE / BLOCK, f64::from(BLOCK * BLOCK));
    let block = |index: u32| {
        let rows = (0..BLOCK).map(|row| (index / across * BLOCK + row) * EDGE + index % across * BLOCK);
        rows.flat_map(|row| row..row + BLOCK).map(|pixel| pixels[pixel as usize][0] - light).sum::<f64>() / area.sqrt()
    };
    let of_blocks = worst(&mut (0..across * across).map(block));
    println!(
        "{name}: {z:+.2} standard errors, worst block {of_blocks:.2}, worst pixel {of_pixels:.2}, {segments:.1} segments"
    );
    assert!(z.abs() < 4.0, "{name}: {mean} {light} {z}");
    assert!(of_blocks < 5.0 && of_pixels < 8.0, "{name}: {of_blocks} {of_pixels}");
}

/// A lamp shines at the ceiling, which lights everything else. Guided samples have less variance there.
#[test]
fn paths_that_are_guided_have_less_variance() {
    let path = format!("{}/../scenes/cornell.mgf", env!("CARGO_MANIFEST_DIR"));
    let text = std::fs::read_to_string(path).expect("a scene");
    let turned = text.replace("xf -t 0 0.1 3.98", "xf -rx 180 -t 0 0.1 3.2");
    assert_ne!(turned, text);
    let prepared = prepare_scene(parse_scene(&turned));
    let [field, tables] = [GuideKind::None, GuideKind::Tables].map(|guides| solve_with(&prepared, guides));
    let learned = femc_guiding::learn(&prepared, &field, &AtomicBool::new(false)).expect("not cancelled");
    let variance = |blocks: Vec<[f64; 2]>| {
        blocks.iter().map(|[mean, variance]| variance / (mean * mean + 1e-2)).sum::<f64>() / blocks.len() as f64
    };
    let unguided = variance(blocks(&prepared, None, 1, 64));
    let guide = learned.guide(&field);
    let targets = Guidance::new(&prepared, &field).with_targets(&prepared, &guide);
    for (name, guidance, least) in [("targets", targets, 2.0), ("tables", Guidance::new(&prepared, &tables), 1.2)] {
        let ratio = unguided / variance(guided_blocks(&prepared, Some(guidance), 2, 64));
        println!("{name}: variance without a guide over that with one: {ratio:.2}");
        assert!(ratio > least, "{name}: {ratio}");
    }
}
