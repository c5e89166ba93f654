//! Benchmarks of building, closest hits and shadow rays on generated meshes: `cargo bench -p femc-geometry --features yardsticks`.

use criterion::{Criterion, criterion_group, criterion_main};
use std::hint::black_box;

#[path = "../examples/rays.rs"]
#[allow(dead_code, reason = "only the scenes and rays are used")]
mod rays;

fn bench(c: &mut Criterion) {
    for mesh in [rays::cornell(), rays::terrain(200)] {
        let world = rays::world(&mesh);
        let sets = rays::rays(&mesh, &world, 128);
        c.bench_function(&format!("{}/build", mesh.name), |b| b.iter(|| black_box(rays::world(&mesh))));
        for (name, set) in ["coherent", "bounce"].iter().zip(&sets) {
            let mut next = set.iter().cycle();
            c.bench_function(&format!("{}/{name}/intersect", mesh.name), |b| {
                b.iter(|| next.next().map(|ray| world.intersect(black_box(ray))));
            });
            let mut next = set.iter().cycle();
            c.bench_function(&format!("{}/{name}/occluded", mesh.name), |b| {
                b.iter(|| next.next().map(|ray| world.occluded(black_box(ray))));
            });
        }
    }
}

criterion_group!(benches, bench);
criterion_main!(benches);
