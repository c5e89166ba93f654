//! Measures the time of queries to a tree of fog, in nanoseconds: `cargo run --release -p femc-field --example fog`. The tree is
//! regular, of 4,096 boxes or of the given number (a power of 2). Random lines go through 15 boxes each on average.

use femc_field::{FogCell, FogLeaf, FogLine, FogTree};
use femc_math::Rgb;
use femc_math::elementary::cbrt;
use femc_math::glam::Vec3A;
use std::hint::black_box;
use std::time::Instant;

/// Number of lines, and number of repetitions of each round of queries. The least time counts.
const LINES: usize = 4096;
const ROUNDS: u32 = 30;

fn tree(depth: u32, color: Rgb) -> FogTree {
    let mut cells = Vec::new();
    let mut boxes = vec![[Vec3A::ZERO, Vec3A::ONE]];
    while let Some([min, max]) = boxes.get(cells.len()).copied() {
        // The level of the k-th box of a full tree follows from the logarithm.
        let level = (cells.len() + 1).ilog2();
        if level < depth {
            let axis = (level % 3) as usize;
            let at = 0.5 * (min[axis] + max[axis]);
            let (mut low, mut high) = (max, min);
            (low[axis], high[axis]) = (at, at);
            boxes.extend([[min, low], [high, max]]);
            cells.push(FogCell::Split { axis: axis as u8, at });
        } else {
            let mean = [Rgb::ONE, Rgb::splat(0.3), Rgb::splat(-0.2), Rgb::splat(0.1)];
            let leaf = FogLeaf { mean, anisotropy: Vec3A::ZERO, sigma_s: color, sigma_t: color * (1.0 + min.x) };
            cells.push(FogCell::Leaf(leaf.limit_slopes()));
        }
    }
    FogTree::new([Vec3A::ZERO, Vec3A::ONE], &cells).unwrap_or_default()
}

/// Returns points of a lattice that fills the cube evenly (\[roberts2018\]).
fn point(k: usize, seed: f64) -> Vec3A {
    let step = |a: f64| (seed + a * k as f64).fract() as f32;
    Vec3A::new(step(0.819_172_513_396_164_4), step(0.671_043_606_703_789_3), step(0.549_700_477_901_970_2))
}

/// Returns the least time of a query, ns.
fn time(mut query: impl FnMut(usize)) -> f64 {
    let round = |_| {
        let start = Instant::now();
        (0..LINES).for_each(&mut query);
        start.elapsed().as_secs_f64() * 1e9 / LINES as f64
    };
    (0..ROUNDS).map(round).fold(f64::INFINITY, f64::min)
}

fn main() {
    let boxes: usize = std::env::args().nth(1).and_then(|text| text.parse().ok()).unwrap_or(4096);
    println!("fog\tpoint, ns\tline, ns\tboxes a line\tline, ns a box\tdraw, ns\tdensity, ns");
    for (name, color) in [("gray", Rgb::splat(0.7)), ("in color", Rgb::new(0.7, 0.6, 0.5))] {
        let tree = tree(boxes.max(2).ilog2(), color);
        let points: Vec<Vec3A> = (0..LINES).map(|k| point(k, 0.5)).collect();
        // Lines of this length hit 15 boxes on average, with 16 boxes by axis.
        let edge = cbrt(tree.leaves().count() as f32);
        let length = 14.0 / (1.5 * edge);
        let of = |k: usize| {
            let (from, to) = (point(k, 0.1), point(k, 0.7));
            (from, (to - from).normalize_or(Vec3A::X))
        };
        let lines: Vec<(Vec3A, Vec3A)> = (0..LINES).map(of).collect();
        let mut line = FogLine::default();
        let at = time(|k| {
            black_box(tree.mean_radiance(points[k]));
        });
        let along = time(|k| {
            let (origin, dir) = lines[k];
            tree.radiance_along(origin, dir, 0.0, length, &mut line);
            black_box(line.luminance());
        });
        let mut met = 0;
        for &(origin, dir) in &lines {
            tree.radiance_along(origin, dir, 0.0, length, &mut line);
            met += line.leaves();
        }
        let met = met as f64 / LINES as f64;
        let drawn = time(|k| {
            black_box(line.sample((k as f64 + 0.5) / LINES as f64));
        });
        let density = time(|k| {
            black_box(line.pdf(length * k as f32 / LINES as f32));
        });
        println!("{name}\t{at:.1}\t{along:.0}\t{met:.1}\t{:.1}\t{drawn:.0}\t{density:.0}", along / met);
    }
}
