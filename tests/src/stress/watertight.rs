//! Grazing rays along edges and through vertices of closed meshes, from inside: none may get out.
//!
//! Meshes are star-shaped about their center, so a vertex or a point of a face that is moved toward the center is inside. Each ray
//! begins at such a point, anywhere inside or slightly below the surface. It passes through a vertex, through a point of an edge,
//! or along an edge.

use super::ResultLine;
use super::measure::Effort;
use femc_geometry::{Blas, Cull, InstanceInput, Pose, Ray, TriangleInput, World};
use femc_math::glam::{Affine3A, Quat, Vec3, Vec3A};
use rayon::prelude::*;
use std::f32::consts::{PI, TAU};
use std::sync::Arc;
use std::time::Instant;

pub fn run(effort: &Effort, report: &mut dyn FnMut(ResultLine)) {
    let meshes = [
        ("a cube", cube(1, |x| x)),
        ("a cube of needles", cube(64, |x| x.signum() * x.abs().powi(5))),
        ("a globe", globe(48, 96, |_| 1.0)),
        ("a globe of needles", globe(3, 4096, |_| 1.0)),
        ("a bumpy globe", globe(100, 200, |p| 1.0 + 0.15 * (9.0 * p.x).sin() * (7.0 * p.y + 5.0 * p.z).cos())),
    ];
    let turned = Quat::from_axis_angle(Vec3::new(0.36, 0.48, 0.8), 1.1);
    let far = Affine3A::from_translation(Vec3::new(400.7, -300.1, 77.7));
    let places = [
        ("", Affine3A::IDENTITY),
        (", placed far from the origin", far),
        (
            ", turned and scaled",
            Affine3A::from_scale_rotation_translation(Vec3::splat(0.37), turned, Vec3::new(3.1, 2.7, -1.9)),
        ),
    ];
    let rays = effort.rays / (meshes.len() * (places.len() + 1)) as u64;
    for (name, mesh) in meshes {
        let mesh = Mesh::new(mesh, Vec3A::ZERO);
        for (place_name, place) in places {
            report(leaks(&format!("tight: {name}{place_name}"), &mesh, place, rays));
        }
        // Rounding makes needles degenerate and merges vertices.
        let rounded: Triangles =
            mesh.triangles.iter().map(|triangle| triangle.map(|p| far.transform_point3a(p))).collect();
        let mesh = Mesh::new(rounded, far.translation);
        report(leaks(
            &format!("tight: {name} with coordinates of hundreds of meters"),
            &mesh,
            Affine3A::IDENTITY,
            rays,
        ));
    }
}

type Triangles = Vec<[Vec3A; 3]>;

struct Mesh {
    triangles: Triangles,
    middle: Vec3A,
    blas: Arc<Blas>,
}

impl Mesh {
    fn new(triangles: Triangles, middle: Vec3A) -> Self {
        let inputs = triangles.iter().map(|&vertices| TriangleInput { vertices, cull: Cull::None }).collect();
        let blas = Arc::new(Blas::build(inputs, Vec::new()));
        Self { triangles, middle, blas }
    }
}

/// Returns a cube whose faces have n x n cells with warped corners.
fn cube(n: usize, warp: impl Fn(f32) -> f32) -> Triangles {
    let place = |i: usize| warp(2.0 * i as f32 / n as f32 - 1.0);
    let mut mesh = Vec::new();
    for axis in 0..3 {
        for side in [-1.0f32, 1.0] {
            let corner = |i: usize, j: usize| {
                let mut p = [side; 3];
                (p[(axis + 1) % 3], p[(axis + 2) % 3]) = (place(i), place(j));
                Vec3A::from_array(p)
            };
            for (i, j) in (0..n * n).map(|cell| (cell / n, cell % n)) {
                let [a, b, c, d] = [corner(i, j), corner(i + 1, j), corner(i + 1, j + 1), corner(i, j + 1)];
                mesh.extend([[a, b, c], [a, c, d]]);
            }
        }
    }
    mesh
}

/// Returns a globe of rings and spokes with the radius `radius`.
fn globe(rings: usize, spokes: usize, radius: impl Fn(Vec3A) -> f32) -> Triangles {
    let corner = |i: usize, j: usize| {
        let (sin, cos) = if i == 0 {
            (0.0, 1.0)
        } else if i == rings {
            (0.0, -1.0)
        } else {
            (PI * i as f32 / rings as f32).sin_cos()
        };
        let (y, x) = (TAU * (j % spokes) as f32 / spokes as f32).sin_cos();
        let p = Vec3A::new(sin * x, sin * y, cos);
        p * radius(p)
    };
    let mut mesh = Vec::new();
    for (i, j) in (0..rings * spokes).map(|cell| (cell / spokes, cell % spokes)) {
        let [a, b, c, d] = [corner(i, j), corner(i + 1, j), corner(i + 1, j + 1), corner(i, j + 1)];
        if i > 0 {
            mesh.push([a, b, d]);
        }
        if i + 1 < rings {
            mesh.push([b, c, d]);
        }
    }
    mesh
}

/// SplitMix64 (\[steele2014\]) as a function of index and dimension, independent of threads.
fn random(index: u64, dimension: u64) -> u64 {
    let mut z = index.wrapping_mul(16).wrapping_add(dimension).wrapping_mul(0x9e37_79b9_7f4a_7c15);
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}

fn unit(index: u64, dimension: u64) -> f32 {
    (random(index, dimension) >> 40) as f32 / (1u64 << 24) as f32
}

fn leaks(name: &str, mesh: &Mesh, place: Affine3A, rays: u64) -> ResultLine {
    let begun = Instant::now();
    let world = World::build(vec![InstanceInput { blas: mesh.blas.clone(), pose: Pose::Fixed(place) }]);
    let chunk = 1 << 16;
    let leaks: u64 = (0..rays.div_ceil(chunk))
        .into_par_iter()
        .map(|part| {
            (part * chunk..(part * chunk + chunk).min(rays))
                .filter(|&index| leaks_out(&world, mesh, place, index))
                .count() as u64
        })
        .sum();
    let seconds = begun.elapsed().as_secs_f64();
    ResultLine::faults(name, leaks, rays, seconds, "rays leak")
}

/// Checks whether ray `index` hits nothing. Rays alternate between any-hit and nearest-hit queries.
fn leaks_out(world: &World, mesh: &Mesh, place: Affine3A, index: u64) -> bool {
    let pick = |dimension: u64| &mesh.triangles[(random(index, dimension) % mesh.triangles.len() as u64) as usize];
    let target = pick(0);
    let k = (random(index, 1) % 3) as usize;
    let (a, b) = (target[k], target[(k + 1) % 3]);
    let kind = random(index, 2) % 4;
    let through = if kind == 0 { a } else { a + (b - a) * unit(index, 3) };
    let inward = |p: Vec3A, factor: f32| mesh.middle + (p - mesh.middle) * factor;
    let (start, through) = match kind {
        // From any point inside.
        0 | 1 => {
            let [p, q, r] = pick(4);
            let (u, v) = (unit(index, 5), unit(index, 6));
            let (u, v) = if u + v > 1.0 { (1.0 - u, 1.0 - v) } else { (u, v) };
            (inward(*p + (*q - *p) * u + (*r - *p) * v, 0.98 * unit(index, 7)), through)
        }
        // From slightly below the same triangle: through an edge, or along it.
        2 => (inward(target[(k + 2) % 3], inward_factor(index)), through),
        _ => (inward(through, inward_factor(index)), b + (b - a) * 1e-3),
    };
    let (start, through) = (place.transform_point3a(start), place.transform_point3a(through));
    let Some(dir) = (through - start).try_normalize() else { return false };
    let ray = Ray::new(start, dir);
    if index.is_multiple_of(2) { world.intersect(&ray).is_none() } else { !world.occluded(&ray) }
}

/// Draws a factor that moves a point of the surface inward by 1e-4 to 1e-1 of its distance from the center.
fn inward_factor(index: u64) -> f32 {
    1.0 - 10f32.powf(-1.0 - 3.0 * unit(index, 8))
}
