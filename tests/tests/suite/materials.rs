//! Energy of materials from the scene file to the image: no channel of any material returns more than it receives.

use femc_film::Frame;
use femc_math::Rgb;
use femc_math::color::LUMINANCE_WEIGHTS;
use femc_math::glam::Vec3A;
use femc_pipeline::radiosity::{SolveOptions, VerifyError, solve};
use femc_pipeline::{
    Method, Outputs, Prepared, RenderTask, SceneSource, Settings, StopCondition, plan_job, prepare_frame,
};
use femc_prepared::KernelMaterial;
use femc_tests::parse_scene;
use femc_tests::rng::Rng;
use std::fmt::Write as _;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

/// Draws a number in [0, 1).
fn unit(rng: &mut Rng) -> f64 {
    (rng.bits() >> 11) as f64 / (1u64 << 53) as f64
}

/// Draws lines that set a color: saturated chromaticities near the corners of Rec.709, spectral ones outside of it, or raw colors.
fn color(rng: &mut Rng) -> String {
    let corners = [(0.64, 0.33), (0.30, 0.60), (0.15, 0.06), (0.7, 0.29), (0.17, 0.01), (0.3127, 0.329)];
    let (x, y) = corners[(6.0 * unit(rng)) as usize];
    match unit(rng) {
        u if u < 0.15 => " c\n".to_owned(),
        u if u < 0.3 => format!(" c\n crgb {:.3} {:.3} {:.3}\n", 4.0 * unit(rng), 4.0 * unit(rng), 4.0 * unit(rng)),
        _ => format!(" c\n cxy {x} {y}\n"),
    }
}

/// Draws a material of the scene format. The importer scales sums of luminances above 1.
/// - `opaque`: without transmittance, two-sided.
fn material(rng: &mut Rng, name: &str, opaque: bool) -> String {
    let mut text = format!("m {name} =\n");
    let sides = if opaque || unit(rng) < 0.5 { 2 } else { 1 };
    let _ = writeln!(text, " sides {sides}");
    let kinds: &[&str] = if opaque { &["rd", "rs"] } else { &["rd", "td", "rs", "ts"] };
    for kind in kinds {
        if unit(rng) < 0.3 {
            continue;
        }
        let roughness = [0.0, 1.0, 1e-3 * unit(rng), unit(rng), 0.3 * unit(rng)][(5.0 * unit(rng)) as usize];
        let rest = if kind.ends_with('s') { format!(" {roughness:.5}") } else { String::new() };
        let _ = writeln!(text, "{} {kind} {:.4}{rest}", color(rng), unit(rng));
    }
    let index = match unit(rng) {
        u if u < 0.5 => None,
        u if u < 0.6 => Some((1.0, 0.0)),
        u if u < 0.8 => Some((0.3 + 2.5 * unit(rng), 0.0)),
        u if u < 0.85 => Some((10f64.powf(4.0 * unit(rng) - 2.0), 0.0)),
        _ => Some((0.05 + 3.0 * unit(rng), 5.0 * unit(rng))),
    };
    if let Some((re, im)) = index {
        let _ = writeln!(text, " ir {re:.4} {im:.4}");
    }
    text
}

/// Computes the directional albedo from `n^3` stratified samples, without the factor of the squared index of refraction.
fn albedo(kernel: &KernelMaterial, texel: Option<Rgb>, wo: Vec3A, n: u32) -> Rgb {
    let bsdf = texel.map_or(kernel.bsdf, |texel| kernel.textured_bsdf(texel));
    let mut rng = Rng::new(52);
    let mut at = |k: u32| ((f64::from(k) + unit(&mut rng)) / f64::from(n)).min(1.0 - 1e-7) as f32;
    let mut sum = Rgb::ZERO;
    for k in 0..n * n * n {
        let (u, choice) = ([at(k % n), at(k / n % n)], at(k / n / n));
        if let Some(s) = bsdf.sample(wo, u, choice) {
            assert!(s.weight.is_finite() && s.pdf > 0.0, "{kernel:?}, {wo}: {s:?}");
            sum += s.weight * s.eta * s.eta;
        }
    }
    sum / (n * n * n) as f32
}

#[test]
fn ten_thousand_materials_return_no_more_than_they_receive() {
    let (mut rng, mut limited, mut worst) = (Rng::new(50), 0, 0.0f32);
    for _ in 0..20 {
        let text: String = (0..500).map(|k| material(&mut rng, &format!("m{k}"), false) + "v a =\nsph a 1\n").collect();
        for description in &parse_scene(&text).materials {
            limited += u32::from((0..3).any(|channel| description.channel_demand(channel) > 1.001));
            let kernel = KernelMaterial::new(description);
            let wo = Vec3A::new(0.0, unit(&mut rng) as f32 * 0.999, 0.0);
            let z = (1.0 - wo.y * wo.y).sqrt() * if unit(&mut rng) < 0.5 { -1.0 } else { 1.0 };
            let wo = wo + Vec3A::Z * z;
            // Texture values above 1 are clamped.
            let texel = Rgb::new(1.5, unit(&mut rng) as f32, 40.0);
            for texel in [None, Some(texel)] {
                if albedo(&kernel, texel, wo, 5).max_element() > 1.02 {
                    worst = worst.max(albedo(&kernel, texel, wo, 40).max_element() - 1.0);
                    assert!(worst <= 5e-3, "gain {worst} from {wo} with {texel:?}: {description:?}");
                }
            }
        }
    }
    println!("{limited} of 10000 materials are limited; largest gain {worst}");
    assert!(limited > 2500);
}

/// Returns a closed room of one material around a black lamp of 1000 lm/m2.
fn room(material: &str) -> String {
    format!(
        "{material}m lamp =\n sides 1\n c\n ed 1000\nv a =\n p -2 -2 0\nv b =\n p 2 -2 0\nv c =\n p 2 2 0\nv d =\n p -2 2 0\n\
         m wall\nprism d c b a 3\nv o =\n p 0 0 2\nm lamp\nsph o .4\n\
         camera main =\n origin 1.5 -1.5 1\n target 0 0 1\n fov 60\n film 8 8\n"
    )
}

/// Renders a frame with the samples of `settings`.
fn render_frame(prepared: &Prepared, settings: &Settings) -> Frame {
    let StopCondition::Spp(spp) = settings.stop else { panic!("a fixed number of samples") };
    let plan = plan_job(&prepared.scene, settings, Some(&[1])).unwrap_or_else(|error| panic!("{error}"));
    let mut film = Frame::new(plan.tiling);
    for rect in plan.tiling.rects() {
        let done = RenderTask::new(prepared, settings, rect, 0..spp).render(Outputs::default());
        film.insert(done.unwrap_or_else(|error| panic!("{error}")).tile).unwrap_or_else(|error| panic!("{error}"));
    }
    film
}

#[test]
fn random_material_rooms_gain_no_light_and_have_no_bad_samples() {
    let mut rng = Rng::new(51);
    for k in 0..60 {
        let text = room(&material(&mut rng, "wall", true));
        let source = SceneSource::new(parse_scene(&text));
        let settings = Settings { stop: StopCondition::Spp(16), method: Method::Pt, ..Settings::default() };
        let prepared = prepare_frame(&source, &settings, 1, None).unwrap_or_else(|error| panic!("{error}"));
        let film = render_frame(&prepared, &settings);
        assert_eq!(film.bad_samples().total(), 0, "{k}: {text}");
        let pixels = film.resolve().color.pixels;
        // The lamp bounds every pixel. The test compares the median with it: where a channel's albedo is near 1 in a lobe that is
        // sampled for other channels, weights have infinite variance and single pixels are far off.
        let mut luminances: Vec<f32> = pixels.iter().map(|p| Rgb::from_array(*p).dot(LUMINANCE_WEIGHTS)).collect();
        luminances.sort_by(f32::total_cmp);
        let median = luminances[luminances.len() / 2];
        assert!(median <= 1000.0 / std::f32::consts::PI, "{k}: {median}: {text}");
        let solved = solve(&prepared, &SolveOptions::default(), &AtomicBool::new(false)).expect("nobody cancels");
        // Few rays hit mirrors, so a valid solution may keep slightly too much light. A material that gains energy multiplies it.
        let verdict = solved.verify(&prepared);
        let is_sound = matches!(verdict, Ok(()) | Err(VerifyError::NotConverged { .. }))
            || matches!(verdict, Err(VerifyError::EnergyGain { ratio }) if ratio < 1.5);
        assert!(is_sound && solved.report.residual.is_finite(), "{k}: {verdict:?}: {:?}: {text}", solved.report);
    }
}

#[test]
fn walls_emitting_on_both_sides_light_room_as_inward_ones_do() {
    for albedo in [0.5, 0.9, 0.985] {
        let mean = |sides: u32| {
            let text = format!(
                "camera main =\n origin .3 .2 .1\n target 1 .4 0\n fov 60\n film 8 8\nm wall =\n sides {sides}\n c\n rd {albedo}\n\
                 ed 3.14159265358979\nv a =\n p -1 -1 -1\nv b =\n p 1 -1 -1\nv c =\n p 1 1 -1\nv d =\n p -1 1 -1\nm wall\n\
                 prism a b c d -2\n"
            );
            let settings = Settings { stop: StopCondition::Spp(16), method: Method::Fem, ..Settings::default() };
            let prepared = prepare_frame(&SceneSource::new(parse_scene(&text)), &settings, 1, None)
                .unwrap_or_else(|e| panic!("{e}"));
            let image = render_frame(&prepared, &settings).resolve().color;
            let n = image.pixels.len();
            (0..n).map(|at| f64::from(image.luminance(at))).sum::<f64>() / n as f64
        };
        let ([one, two], want) = ([mean(1), mean(2)], 1.0 / (1.0 - albedo));
        println!("albedo {albedo}: {one:.4} and {two:.4}, wanted {want:.4}");
        assert!((one / want - 1.0).abs() < 0.03 && (two / want - 1.0).abs() < 0.03, "{albedo}: {one} {two} {want}");
    }
}

#[test]
fn scenes_of_the_1990s_have_no_bad_sample() {
    let Some(folder) = femc_require::shared_folder("scenes-real") else { return };
    for name in ["corridor", "cube", "examp1", "floor_gloss", "office2/office2", "soda"] {
        let loaded =
            femc_import::load_scene_file(&folder.join(format!("{name}.mgf"))).unwrap_or_else(|e| panic!("{e}"));
        let settings =
            Settings { stop: StopCondition::Spp(64), method: Method::Pt, size: Some([32, 24]), ..Settings::default() };
        let prepared = prepare_frame(&SceneSource::new(Arc::new(loaded.scene)), &settings, 1, None);
        let film = render_frame(&prepared.unwrap_or_else(|error| panic!("{name}: {error}")), &settings);
        assert_eq!(film.bad_samples().total(), 0, "{name}");
    }
}

#[test]
fn lamp_texture_above_1_raises_light_and_solution_is_trusted() {
    let text = "m wall =\n sides 2\n c\n rd .5\nm lamp =\n sides 1\n c\n ed 1000\nv a =\n p -2 -2 0\nv b =\n p 2 -2 0\nv c =\n p 2 2 0\n\
        v d =\n p -2 2 0\nm wall\nprism d c b a 3\nv e =\n p -.5 -.5 2.9\n uv 0 0\nv f =\n p -.5 .5 2.9\n uv 0 1\nv g =\n p .5 .5 2.9\n\
        uv 1 1\nv h =\n p .5 -.5 2.9\n uv 1 0\nm lamp\nf e f g h\n\
        camera main =\n origin 1.5 -1.5 1\n target 0 0 1\n fov 60\n film 8 8\n";
    for (value, kept) in [(1.0, 1.0), (4.0, 4.0)] {
        let mut textured = femc_scene::Scene::clone(&parse_scene(text));
        textured.images.push(femc_scene::Image { path: String::new(), width: 1, height: 1, pixels: vec![[value; 3]] });
        let lamp = textured.materials.iter_mut().find(|material| material.name == "lamp").expect("the lamp");
        lamp.map_ed = Some(femc_scene::ImageId(0));
        let prepared = prepare_frame(&SceneSource::new(Arc::new(textured)), &Settings::default(), 1, None);
        let prepared = prepared.unwrap_or_else(|error| panic!("{error}"));
        let solved = solve(&prepared, &SolveOptions::default(), &AtomicBool::new(false)).expect("nobody cancels");
        let light = femc_pipeline::radiosity::SolutionView::new(&prepared, &solved.field).totals();
        let ratio = light.absorbed / light.emitted;
        assert!((ratio / kept - 1.0).abs() < 0.1, "texture {value}: {ratio} times the emittance is kept");
        assert_eq!(solved.verify(&prepared), Ok(()));
    }
}
