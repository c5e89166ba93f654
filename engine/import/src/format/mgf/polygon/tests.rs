use super::*;

fn flat(points: &[[f64; 2]]) -> Vec<DVec3> {
    points.iter().map(|p| DVec3::new(p[0], p[1], 0.0)).collect()
}

/// Triangulates, and checks area and orientation of every triangle. Returns the outcome and the triangles.
fn triangulate(points: &[DVec3], holes: &[u32]) -> (Triangulation, Vec<[u32; 3]>) {
    let mut triangulator = Triangulator::default();
    let outcome = triangulator.triangulate(points, holes);
    let normal = outcome.area.normalize_or_zero();
    let mut sum = 0.0;
    for t in &triangulator.triangles {
        let [a, b, c] = t.map(|i| points[i as usize]);
        let area = 0.5 * (b - a).cross(c - a).dot(normal);
        // The sign of slivers along straight edges depends on the rounding of their corners.
        assert!(area > -1e-12 * outcome.area.length(), "triangle {t:?} is turned over");
        sum += area;
    }
    if outcome.covered {
        assert!((sum - outcome.area.length()).abs() <= 1e-9 * sum.abs(), "{sum} is not {}", outcome.area.length());
    }
    (outcome, triangulator.triangles)
}

#[test]
fn a_concave_quadrangle_is_cut_inside() {
    let (outcome, triangles) = triangulate(&flat(&[[0.0, 0.0], [2.0, 1.0], [0.0, 2.0], [0.5, 1.0]]), &[]);
    assert!(outcome.covered);
    assert_eq!(triangles, [[1, 2, 3], [1, 3, 0]]);
}

#[test]
fn a_comb_is_covered() {
    let mut points = vec![[0.0, -1.0], [20.0, -1.0]];
    points.extend((0..20).rev().flat_map(|i| {
        let x = f64::from(i);
        [[x + 0.9, 0.0], [x + 0.5, 5.0], [x + 0.1, 0.0]]
    }));
    let (outcome, triangles) = triangulate(&flat(&points), &[]);
    assert!(outcome.covered);
    assert_eq!(triangles.len(), points.len() - 2);
}

#[test]
fn a_seam_makes_a_hole() {
    // The specification's `f v1 v2 v3 v4 v5 v6 v7 v8 v5 v4`: outer square, seam v4 v5, inner square in the opposite direction.
    let p = [[0.0, 0.0], [4.0, 0.0], [4.0, 4.0], [0.0, 4.0], [1.0, 3.0], [3.0, 3.0], [3.0, 1.0], [1.0, 1.0]];
    let seam = [p[0], p[1], p[2], p[3], p[4], p[5], p[6], p[7], p[4], p[3]];
    let (outcome, triangles) = triangulate(&flat(&seam), &[]);
    assert!(outcome.covered);
    assert!((outcome.area.z - 12.0).abs() < 1e-12);
    assert_eq!(triangles.len(), 8);
}

#[test]
fn explicit_holes_are_cut_out_whichever_way_they_are_wound() {
    let outer = [[0.0, 0.0], [9.0, 0.0], [9.0, 4.0], [0.0, 4.0]];
    let one = [[1.0, 1.0], [1.0, 3.0], [3.0, 3.0], [3.0, 1.0]];
    let two = [[5.0, 1.0], [5.0, 3.0], [7.0, 3.0], [7.0, 1.0]];
    let all: Vec<_> = [outer, one, two].concat();
    let (outcome, triangles) = triangulate(&flat(&all), &[4, 8]);
    assert!(outcome.covered && !outcome.hole_wound_like_outer);
    assert!((outcome.area.z - 28.0).abs() < 1e-12);
    assert_eq!(triangles.len(), 14);
    let mut reversed = all;
    reversed[4..8].reverse();
    let (outcome, _) = triangulate(&flat(&reversed), &[4, 8]);
    assert!(outcome.covered && outcome.hole_wound_like_outer);
    assert!((outcome.area.z - 28.0).abs() < 1e-12);
}

#[test]
fn the_right_hand_rule_holds_for_every_axis_and_both_windings() {
    let square = [[0.0, 0.0], [2.0, 0.0], [2.0, 1.0], [1.0, 0.4], [0.0, 1.0]];
    for axis in 0..3 {
        for reversed in [false, true] {
            let place = |p: &[f64; 2]| {
                let mut v = DVec3::splat(3.0);
                (v[(axis + 1) % 3], v[(axis + 2) % 3]) = (p[0], p[1]);
                v
            };
            let mut points: Vec<_> = square.iter().map(place).collect();
            if reversed {
                points.reverse();
            }
            let (outcome, triangles) = triangulate(&points, &[]);
            assert_eq!(outcome.area[axis] > 0.0, !reversed);
            assert!(outcome.covered && triangles.len() == 3);
        }
    }
}

#[test]
fn vertices_on_straight_edges_are_kept() {
    let points = flat(&[[0.0, 0.0], [1.0, 0.0], [2.0, 0.0], [3.0, 0.0], [3.0, 2.0], [1.5, 2.0], [0.0, 2.0]]);
    let (outcome, triangles) = triangulate(&points, &[]);
    assert!(outcome.covered);
    for i in 0..points.len() as u32 {
        assert!(triangles.iter().flatten().any(|&j| j == i), "vertex {i} is lost in {triangles:?}");
    }
    assert_eq!(triangles.len(), 5);
}

#[test]
fn faces_without_area_have_no_triangles() {
    for points in [
        flat(&[[0.0, 0.0], [1.0, 1.0], [2.0, 2.0]]),
        flat(&[[1.0, 1.0]; 5]),
        flat(&[[0.0, 0.0], [1.0, 0.0], [0.0, 0.0], [1.0, 0.0]]),
    ] {
        assert_eq!(triangulate(&points, &[]).1.len(), 0);
    }
}

#[test]
fn a_polygon_that_crosses_itself_is_found_out() {
    let bow = flat(&[[0.0, 0.0], [2.0, 2.0], [2.0, 0.0], [0.0, 1.0]]);
    assert!(!triangulate(&bow, &[]).0.covered);
}

#[test]
fn the_deviation_from_the_plane_is_measured() {
    let mut points = flat(&[[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]]);
    assert_eq!(triangulate(&points, &[]).0.deviation, 0.0);
    points[2].z = 0.2;
    let deviation = triangulate(&points, &[]).0.deviation;
    assert!((0.02..0.1).contains(&deviation), "{deviation}");
}

/// A small random number generator in [0, 1) (a 64-bit linear congruence) with a fixed seed.
struct Random(u64);

impl Random {
    fn next(&mut self) -> f64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 11) as f64 / (1u64 << 53) as f64
    }
}

/// Returns a star-shaped polygon around the origin in a random plane; some edges have a vertex in the middle.
fn random_polygon(random: &mut Random) -> Vec<DVec3> {
    let n = 3 + (random.next() * 30.0) as usize;
    let corners: Vec<[f64; 2]> = (0..n)
        .map(|i| {
            let angle = (i as f64 + 0.8 * random.next()) / n as f64 * std::f64::consts::TAU;
            let radius = 0.2 + random.next();
            let (s, c) = femc_math::elementary::double::sin_cos(angle);
            [radius * c, radius * s]
        })
        .collect();
    let mut flat = Vec::new();
    for i in 0..n {
        let (a, b) = (corners[i], corners[(i + 1) % n]);
        flat.push(a);
        if random.next() < 0.3 {
            flat.push([0.5 * (a[0] + b[0]), 0.5 * (a[1] + b[1])]);
        }
    }
    let axis = DVec3::new(random.next() - 0.5, random.next() - 0.5, random.next() - 0.5).normalize_or(DVec3::X);
    let (u, v) = axis.any_orthonormal_pair();
    let offset = DVec3::new(random.next(), random.next(), random.next()) * 100.0;
    flat.iter().map(|p| offset + u * p[0] + v * p[1]).collect()
}

#[test]
fn random_polygons_in_random_planes_are_covered() {
    let mut random = Random(1);
    for i in 0..5000 {
        let points = random_polygon(&mut random);
        let (outcome, triangles) = triangulate(&points, &[]);
        assert!(outcome.covered, "polygon {i}: {points:?}");
        assert!(outcome.deviation < 1e-9);
        let missing = (0..points.len() as u32).filter(|i| !triangles.iter().flatten().any(|j| i == j)).count();
        assert_eq!(missing, 0, "polygon {i}: {points:?}");
    }
}
