//! Renders the references in `tests/references` again by brute force: two independent images of each room, and their statistics.
//!
//! `cargo run --release -p femc-tests --example references [-- NAME..]`

use femc_film::Image;
use femc_tests::brute::BruteForceTracer;
use femc_tests::reference::{ROOMS, Reference, rooms_folder, scene_digest};
use std::error::Error;
use std::path::Path;
use std::time::Instant;

/// Samples per pixel of each half.
const SPP: u32 = 32_768;

fn main() -> Result<(), Box<dyn Error>> {
    let names: Vec<String> = std::env::args().skip(1).collect();
    let all = ROOMS.map(String::from).to_vec();
    (if names.is_empty() { all } else { names }).iter().try_for_each(|name| make(name))
}

fn make(name: &str) -> Result<(), Box<dyn Error>> {
    let scene = femc_import::load_scene_file(&rooms_folder().join(format!("{name}.mgf")))?.scene;
    let (brute, start) = (BruteForceTracer::new(&scene), Instant::now());
    let halves = [1, 2].map(|seed| brute.render(seed, SPP));
    println!("{name}: {:.1} s", start.elapsed().as_secs_f64());
    for (half, image) in ["A", "B"].into_iter().zip(&halves) {
        write(&rooms_folder().join(format!("{name}_{half}.exr")), image)?;
    }
    let reference = Reference::new(halves);
    let notes = serde_json::json!({
        "scene_blake3": scene_digest(&rooms_folder(), &scene).to_string(),
        "spp_of_each_half": SPP,
        "mean": reference.mean(),
        "noise_relmse": reference.noise_relmse(),
    });
    Ok(std::fs::write(rooms_folder().join(format!("{name}.json")), format!("{notes:#}\n"))?)
}

fn write(path: &Path, image: &Image) -> exr::error::UnitResult {
    let (width, height) = (image.width as usize, image.height as usize);
    exr::prelude::write_rgb_file(path, width, height, |x, y| -> (f32, f32, f32) { image.pixels[y * width + x].into() })
}
