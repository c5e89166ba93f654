//! Prints digests of the results of this engine build, one line for each thing. Builds that print the same lines render the same
//! bits.
//!
//! `tests/builds` runs it for several processors and compares. The first line is the engine's name. Builds with the same name may
//! work on one frame, so their other lines must be equal.

use femc_film::Frame;
use femc_film::exr::{Provenance, encode};
use femc_math::elementary::{self, double};
use femc_pipeline::{BUILD, Outputs, RenderTask, SceneSource, Settings, StopCondition, plan_job, prepare_frame};
use std::error::Error;
use std::path::Path;
use std::sync::Arc;

type RenderCase = (&'static str, &'static str, [u32; 2], u32, &'static [u32]);

/// Scene, camera, film, samples a pixel, and frames. Together they cover every kind of surface, medium, light, texture, photometry
/// and motion, seen by pinholes and lenses, at rest and in motion.
const RENDER_CASES: [RenderCase; 10] = [
    ("zoo.mgf", "main", [96, 64], 32, &[1, 7]),
    ("zoo.mgf", "close", [64, 48], 16, &[4]),
    ("zoo.mgf", "moving", [64, 48], 16, &[1, 12]),
    ("cornell.mgf", "main", [64, 64], 32, &[1]),
    ("cornell-fog.mgf", "main", [64, 64], 32, &[1]),
    ("glossy.mgf", "main", [64, 48], 32, &[1]),
    ("greenhouse.mgf", "main", [64, 48], 16, &[1]),
    ("greenhouse.mgf", "outside", [48, 32], 16, &[1]),
    ("roundabout.mgf", "driver", [64, 36], 16, &[1, 60]),
    ("roundabout-ies.mgf", "kerbside", [64, 36], 16, &[30]),
];

fn main() -> Result<(), Box<dyn Error>> {
    println!("engine {BUILD}");
    print_function_digests();
    print_image_digests()?;
    for (file, camera, size, spp, frames) in RENDER_CASES {
        render_frames(file, camera, size, spp, frames)?;
    }
    Ok(())
}

/// Renders the frames `frames`, and prints digests of the description, the exact sums and the finished file.
fn render_frames(file: &str, camera: &str, size: [u32; 2], spp: u32, frames: &[u32]) -> Result<(), Box<dyn Error>> {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../scenes").join(file);
    let scene = Arc::new(femc_import::load_scene_file(&path)?.scene);
    println!("{file} {}", scene.digest());
    let settings = Settings {
        camera: Some(camera.to_owned()),
        size: Some(size),
        stop: StopCondition::Spp(spp),
        ..Settings::default()
    };
    let (source, plan) = (SceneSource::new(scene.clone()), plan_job(&scene, &settings, Some(frames))?);
    for &frame in frames {
        let prepared = prepare_frame(&source, &settings, frame, None)?;
        let (mut film, mut sums) = (Frame::new(plan.tiling), blake3::Hasher::new());
        for rect in plan.tiling.rects() {
            let tile = RenderTask::new(&prepared, &settings, rect, 0..spp).render(Outputs::default())?.tile;
            sums.update(&tile.encode());
            film.insert(tile)?;
        }
        let image = film.resolve();
        let provenance = Provenance { error: image.error(), ..Provenance::default() };
        let finished = blake3::hash(&encode(&image, &provenance)?);
        println!("{file} {camera} {frame} sums {} file {finished}", sums.finalize());
    }
    Ok(())
}

/// Prints digests of images as used by textures.
fn print_image_digests() -> Result<(), Box<dyn Error>> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../import/tests/files");
    for name in ["orange.jpg", "gray.jpg"] {
        let scene = format!("m wall =\n rd .5\n map_rd {name}\n");
        let files =
            vec![("image.mgf".to_owned(), scene.into_bytes()), (name.to_owned(), std::fs::read(folder.join(name))?)];
        println!(
            "{name} {}",
            femc_import::load_scene(&femc_import::Bundle(files.into_iter().collect()), "image.mgf")?.scene.digest()
        );
    }
    Ok(())
}

/// Prints a digest of each function's values over arguments of all magnitudes.
fn print_function_digests() {
    type Single = fn(f32) -> f32;
    type Double = fn(f64) -> f64;
    let singles: [(&str, Single, Double); 15] = [
        ("sin", elementary::sin, double::sin),
        ("cos", elementary::cos, double::cos),
        ("tan", elementary::tan, double::tan),
        ("asin", elementary::asin, double::asin),
        ("acos", elementary::acos, double::acos),
        ("atan", elementary::atan, double::atan),
        ("exp", elementary::exp, double::exp),
        ("exp_m1", elementary::exp_m1, double::exp_m1),
        ("ln", elementary::ln, double::ln),
        ("ln_1p", elementary::ln_1p, double::ln_1p),
        ("log2", elementary::log2, double::log2),
        ("log10", elementary::log10, double::log10),
        ("cbrt", elementary::cbrt, double::cbrt),
        ("sin_cos.0", |x| elementary::sin_cos(x).0, |x| double::sin_cos(x).0),
        ("sin_cos.1", |x| elementary::sin_cos(x).1, |x| double::sin_cos(x).1),
    ];
    for (name, single, double) in singles {
        print_digest(name, |x, _| single(x), |x, _| double(x));
    }
    print_digest("atan2", elementary::atan2, double::atan2);
    print_digest("pow", elementary::pow, double::pow);
    print_digest("hypot", elementary::hypot, double::hypot);
    print_digest("fmod", elementary::fmod, double::fmod);
}

/// Evaluates arguments of all signs and magnitudes, and the same number of arguments between -8 and 8.
fn print_digest(name: &str, single: impl Fn(f32, f32) -> f32, double: impl Fn(f64, f64) -> f64) {
    let mut hash = blake3::Hasher::new();
    // The sign and payload of a NaN are undefined. No result may depend on them.
    let canonical = |x: f64| if x.is_nan() { f64::NAN.to_bits() } else { x.to_bits() };
    let mut state = 0u64;
    for _ in 0..1 << 17 {
        let mut next = || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (state ^ state >> 29).wrapping_mul(0xbf58_476d_1ce4_e5b9)
        };
        let (a, b) = (next(), next());
        let near = |bits: u64| (bits as i64) as f64 * 2f64.powi(-60);
        for value in [
            f64::from(single(f32::from_bits((a >> 32) as u32), f32::from_bits((b >> 32) as u32))),
            f64::from(single(near(a) as f32, near(b) as f32)),
            double(f64::from_bits(a), f64::from_bits(b)),
            double(near(a), near(b)),
        ] {
            hash.update(&canonical(value).to_le_bytes());
        }
    }
    println!("{name} {}", hash.finalize());
}
