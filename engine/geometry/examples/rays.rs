//! Compares rays per second with plain obvhs trees on the same rays:
//! `cargo run --release -p femc-geometry --features yardsticks --example rays [MESH.bin]`.
//!
//! Without a file it traces a Cornell box of 36 triangles and a bumpy terrain of half a million. A file contains u32 vertex and
//! triangle counts, ten f32 of a camera (origin, target, up, vertical field of view in degrees), positions and indices. All
//! contenders trace the same primary rays ("coherent") and cosine-distributed rays from their hit points ("bounce"). The best of
//! the interleaved rounds counts.

use femc_geometry::{Blas, Cull, Hit, InstanceInput, Pose, Ray, RayLanes, TriangleInput, World, offset_origin};
use femc_math::{
    cross,
    elementary::{sin_cos, tan},
    glam::{Affine3A, Vec3A},
};
use femc_simd::{Lanes, WIDTH, lanes_of};
use obvhs::{
    BvhBuildParams, bvh2::builder::build_bvh2_from_tris, cwbvh::builder::build_cwbvh_from_tris, ray::RayHit,
    triangle::Triangle,
};
use std::{
    sync::Arc,
    time::{Duration, Instant},
};

/// A mesh and a camera.
pub struct Mesh {
    pub name: String,
    pub triangles: Vec<[Vec3A; 3]>,
    pub camera: [f32; 10],
}

/// Number of hits and sum of distances.
pub type TraceSummary = (usize, f64);
/// A named ray tracer.
pub type Contender = (String, Box<dyn Fn(&[Ray]) -> TraceSummary + Sync>);

fn random(state: &mut u64) -> f32 {
    *state ^= *state << 13;
    *state ^= *state >> 7;
    *state ^= *state << 17;
    (*state >> 40) as f32 / 16_777_216.0
}

/// Reads a mesh file.
pub fn read_mesh(path: &str) -> Mesh {
    let bytes = std::fs::read(path).expect("the mesh file can be read");
    let word = |i: usize| u32::from_le_bytes(bytes[4 * i..4 * i + 4].try_into().expect("four bytes"));
    let float = |i: usize| f32::from_bits(word(i));
    let (vertices, faces) = (word(0) as usize, word(1) as usize);
    let vertex = |i: u32| Vec3A::from_array([0, 1, 2].map(|k| float(12 + 3 * i as usize + k)));
    let index = |i: usize| word(12 + 3 * vertices + i);
    Mesh {
        name: path.to_owned(),
        triangles: (0..faces).map(|f| [0, 1, 2].map(|k| vertex(index(3 * f + k)))).collect(),
        camera: std::array::from_fn(|i| float(2 + i)),
    }
}

fn push_box(out: &mut Vec<[Vec3A; 3]>, center: Vec3A, half: Vec3A, turn: f32, faces: &[usize]) {
    let (s, c) = sin_cos(turn);
    let at = |i: usize| {
        let sign = |bit: usize| if i >> bit & 1 == 0 { -1.0 } else { 1.0 };
        let p = half * Vec3A::new(sign(0), sign(1), sign(2));
        center + Vec3A::new(c * p.x - s * p.y, s * p.x + c * p.y, p.z)
    };
    const QUADS: [[usize; 4]; 6] = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]];
    for &face in faces {
        let [a, b, c, d] = QUADS[face].map(at);
        out.extend([[a, b, c], [a, c, d]]);
    }
}

/// Returns a room without its front wall, with two blocks and a lamp: 36 triangles.
pub fn cornell() -> Mesh {
    let mut triangles = Vec::new();
    push_box(&mut triangles, Vec3A::splat(2.75), Vec3A::splat(2.75), 0.0, &[0, 1, 3, 4, 5]);
    push_box(&mut triangles, Vec3A::new(1.8, 3.6, 1.65), Vec3A::new(0.8, 0.8, 1.65), 0.3, &[0, 1, 2, 3, 4, 5]);
    push_box(&mut triangles, Vec3A::new(3.7, 1.7, 0.8), Vec3A::new(0.8, 0.8, 0.8), -0.3, &[0, 1, 2, 3, 4, 5]);
    push_box(&mut triangles, Vec3A::new(2.75, 2.75, 5.49), Vec3A::new(0.65, 0.5, 0.005), 0.0, &[0]);
    Mesh { name: "cornell".into(), triangles, camera: [2.75, -8.0, 2.75, 2.75, 0.0, 2.75, 0.0, 0.0, 1.0, 39.0] }
}

/// Returns a bumpy square of 2 n^2 triangles in a closed box.
pub fn terrain(n: usize) -> Mesh {
    let at = |i: usize, j: usize| {
        let (x, y) = (20.0 * i as f32 / n as f32 - 10.0, 20.0 * j as f32 / n as f32 - 10.0);
        let z = 0.6 * sin_cos(1.3 * x).0 * sin_cos(0.9 * y).1
            + 0.2 * sin_cos(5.1 * x + 3.3 * y).0
            + 0.05 * sin_cos(31.0 * x - 27.0 * y).0;
        Vec3A::new(x, y, z)
    };
    let mut triangles = Vec::new();
    for i in 0..n {
        for j in 0..n {
            let [a, b, c, d] = [at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j + 1)];
            triangles.extend([[a, b, c], [a, c, d]]);
        }
    }
    push_box(&mut triangles, Vec3A::new(0.0, 0.0, 3.0), Vec3A::new(10.5, 10.5, 6.0), 0.0, &[0, 1, 2, 3, 4, 5]);
    Mesh {
        name: format!("terrain-{}", triangles.len()),
        triangles,
        camera: [-9.0, -9.5, 4.0, 0.0, 0.0, 0.5, 0.0, 0.0, 1.0, 55.0],
    }
}

/// Returns the world of the mesh.
pub fn world(mesh: &Mesh) -> World {
    let triangles = mesh.triangles.iter().map(|&vertices| TriangleInput { vertices, cull: Cull::None }).collect();
    let blas = Arc::new(Blas::build(triangles, vec![]));
    World::build(vec![InstanceInput { blas, pose: Pose::Fixed(Affine3A::IDENTITY) }])
}

/// Returns primary rays through n^2 pixels, and one bounce of each.
pub fn rays(mesh: &Mesh, world: &World, n: usize) -> [Vec<Ray>; 2] {
    let c = &mesh.camera;
    let origin = Vec3A::new(c[0], c[1], c[2]);
    let forward = (Vec3A::new(c[3], c[4], c[5]) - origin).normalize();
    let right = cross(forward, Vec3A::new(c[6], c[7], c[8])).normalize();
    let up = cross(right, forward);
    let reach = tan(c[9].to_radians() / 2.0);
    let primary: Vec<Ray> = (0..n * n)
        .map(|i| {
            let at = |k: usize| (k as f32 + 0.5) * 2.0 / n as f32 - 1.0;
            Ray::new(origin, (forward + right * (at(i % n) * reach) - up * (at(i / n) * reach)).normalize())
        })
        .collect();
    let mut state = 88_172_645_463_325_252;
    let bounce = primary
        .iter()
        .filter_map(|ray| {
            let hit = world.intersect(ray)?;
            let at = world.interaction(ray, &hit);
            let normal = if at.normal.dot(ray.dir) > 0.0 { -at.normal } else { at.normal };
            let z = 1.0 - 2.0 * random(&mut state);
            let (s, c) = sin_cos(std::f32::consts::TAU * random(&mut state));
            let r = (1.0 - z * z).max(0.0).sqrt();
            let dir = (normal + Vec3A::new(r * c, r * s, z) * 0.999).normalize();
            Some(Ray::new(offset_origin(at.position, at.error, normal, dir), dir))
        })
        .collect();
    [primary, bounce]
}

/// Rays by coordinate, for calls with several rays.
struct RayArrays {
    origin: [Lanes; 3],
    dir: [Lanes; 3],
    t_max: Lanes,
    time: Lanes,
}

impl RayArrays {
    /// Copies up to [`WIDTH`] rays. Returns their lanes, too.
    fn new(rays: &[Ray]) -> (Self, u32) {
        let none = [Lanes::ZERO; 3];
        let mut arrays = Self { origin: none, dir: none, t_max: Lanes::ZERO, time: Lanes::ZERO };
        for (lane, ray) in rays.iter().enumerate() {
            for axis in 0..3 {
                arrays.origin[axis].0[lane] = ray.origin[axis];
                arrays.dir[axis].0[lane] = ray.dir[axis];
            }
            (arrays.t_max.0[lane], arrays.time.0[lane]) = (ray.t_max, ray.time);
        }
        (arrays, (1 << rays.len()) - 1)
    }

    fn rays(&self) -> RayLanes<'_> {
        RayLanes { origin: &self.origin, dir: &self.dir, t_max: &self.t_max, time: &self.time }
    }
}

fn tally(rays: &[Ray], trace: impl Fn(&Ray) -> Option<f32>) -> TraceSummary {
    rays.iter().filter_map(trace).fold((0, 0.0), |(n, s), t| (n + 1, s + f64::from(t)))
}

/// Returns the world and the plain obvhs trees as contenders.
pub fn contenders(mesh: &Mesh, world: World) -> Vec<Contender> {
    let all: Vec<Triangle> = mesh.triangles.iter().map(|&[v0, v1, v2]| Triangle { v0, v1, v2 }).collect();
    let params = BvhBuildParams::medium_build();
    let plain = |r: &Ray| obvhs::ray::Ray::new(r.origin, r.dir, 0.0, r.t_max);
    let two = build_bvh2_from_tris(&all, params, &mut Duration::default());
    let two_triangles: Vec<Triangle> = two.primitive_indices.iter().map(|&i| all[i as usize]).collect();
    let wide = build_cwbvh_from_tris(&all, params, &mut Duration::default());
    let wide_triangles: Vec<Triangle> = wide.primitive_indices.iter().map(|&i| all[i as usize]).collect();
    let [shadow_world, lane_world, shadow_lane_world] = [(); 3].map(|()| world.clone());
    vec![
        (
            "obvhs bvh2".into(),
            Box::new(move |rays: &[Ray]| {
                tally(rays, |r| {
                    let mut hit = RayHit::none();
                    two.ray_traverse(plain(r), &mut hit, |r, id| two_triangles[id].intersect(r)).then_some(hit.t)
                })
            }),
        ),
        (
            "obvhs cwbvh".into(),
            Box::new(move |rays: &[Ray]| {
                tally(rays, |r| {
                    let mut hit = RayHit::none();
                    wide.ray_traverse(plain(r), &mut hit, |r, id| wide_triangles[id].intersect(r)).then_some(hit.t)
                })
            }),
        ),
        ("femc".into(), Box::new(move |rays: &[Ray]| tally(rays, |r| world.intersect(r).map(|h| h.t)))),
        (
            "femc, 8 a call".into(),
            Box::new(move |rays: &[Ray]| {
                let mut summary = (0, 0.0);
                for rays in rays.chunks(WIDTH) {
                    let (lanes, used) = RayArrays::new(rays);
                    let mut hits = [Hit { t: 0.0, instance: 0, primitive: 0, u: 0.0, v: 0.0 }; WIDTH];
                    let found = lane_world.intersect_lanes(lanes.rays(), used, &mut hits);
                    summary = lanes_of(found).fold(summary, |(n, s), lane| (n + 1, s + f64::from(hits[lane].t)));
                }
                summary
            }),
        ),
        (
            "femc any hit, 8".into(),
            Box::new(move |rays: &[Ray]| {
                let count = rays.chunks(WIDTH).map(|rays| {
                    let (lanes, used) = RayArrays::new(rays);
                    shadow_lane_world.occluded_lanes(lanes.rays(), used).count_ones() as usize
                });
                (count.sum(), 0.0)
            }),
        ),
        ("femc any hit".into(), Box::new(move |rays: &[Ray]| tally(rays, |r| shadow_world.occluded(r).then_some(0.0)))),
    ]
}

/// Returns million rays per second on `threads` threads, and the answer.
fn measure(rays: &[Ray], threads: usize, trace: &(dyn Fn(&[Ray]) -> TraceSummary + Sync)) -> (f64, TraceSummary) {
    let start = Instant::now();
    let chunk = rays.len().div_ceil(threads);
    let answer = std::thread::scope(|scope| {
        let parts: Vec<_> = rays.chunks(chunk).map(|part| scope.spawn(move || trace(part))).collect();
        parts.into_iter().map(|p| p.join().expect("no panic")).fold((0, 0.0), |a, b| (a.0 + b.0, a.1 + b.1))
    });
    (rays.len() as f64 / start.elapsed().as_secs_f64() / 1e6, answer)
}

/// Prints a table: contenders by ray set and threads, Mrays/s, best of `rounds`.
pub fn compare(sets: &[(&str, &[Ray])], contenders: &[Contender], rounds: usize) {
    for (set, rays) in sets {
        for threads in [1, 2] {
            let mut best = vec![(0.0f64, (0, 0.0)); contenders.len()];
            for _ in 0..rounds {
                for (best, (_, trace)) in best.iter_mut().zip(contenders) {
                    let (speed, answer) = measure(rays, threads, &**trace);
                    *best = (best.0.max(speed), answer);
                }
            }
            for ((speed, (hits, sum)), (name, _)) in best.iter().zip(contenders) {
                let mean = sum / *hits as f64;
                println!(
                    "{set:9} {threads}T {name:15} {speed:8.3} Mrays/s {:7.1} ns  hits {hits} mean t {mean:.5}",
                    1e3 * threads as f64 / speed
                );
            }
        }
    }
}

/// Builds and compares.
pub fn run(mesh: &Mesh, extra: Vec<Contender>) {
    let start = Instant::now();
    let world = world(mesh);
    println!(
        "{}: {} triangles, built in {:.1} ms",
        mesh.name,
        mesh.triangles.len(),
        1e3 * start.elapsed().as_secs_f64()
    );
    let sides = std::env::var("RAYS_SIDE").ok().and_then(|s| s.parse().ok()).unwrap_or(1024);
    let rounds = std::env::var("RAYS_ROUNDS").ok().and_then(|s| s.parse().ok()).unwrap_or(5);
    let [primary, bounce] = rays(mesh, &world, sides);
    let mut all = contenders(mesh, world);
    all.extend(extra);
    compare(&[("coherent", &primary), ("bounce", &bounce)], &all, rounds);
}

#[allow(dead_code, reason = "also a module of other harnesses")]
fn main() {
    match std::env::args().nth(1) {
        Some(path) => run(&read_mesh(&path), vec![]),
        None => [cornell(), terrain(500)].iter().for_each(|mesh| run(mesh, vec![])),
    }
}
