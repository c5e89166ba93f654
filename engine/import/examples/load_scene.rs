//! Imports scenes and prints their contents and the import time in seconds: `load_scene FILE ..`.

use std::{path::Path, time::Instant};

fn main() {
    for path in std::env::args().skip(1) {
        let start = Instant::now();
        let result = femc_import::load_scene_file(Path::new(&path));
        let seconds = start.elapsed().as_secs_f64();
        match result {
            Ok(loaded) => {
                let sum = |count: fn(&femc_scene::Group) -> usize| loaded.scene.groups.iter().map(count).sum::<usize>();
                println!(
                    "{path}: {} groups, {} faces, {} triangles, {} quadrics, {} instances, {} materials, {} warnings, {seconds:.4} s",
                    loaded.scene.groups.len(),
                    sum(|g| g.faces.len()),
                    sum(|g| g.triangles.len()),
                    sum(|g| g.quadrics.len()),
                    sum(|g| g.instances.len()),
                    loaded.scene.materials.len(),
                    loaded.warnings.len()
                );
                loaded.warnings.iter().for_each(|warning| println!("  {warning}"));
            }
            Err(error) => println!("{error}"),
        }
    }
}
