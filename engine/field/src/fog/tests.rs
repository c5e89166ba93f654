//! Tests of the light along lines, on random trees.

use super::{FogCell, FogLeaf, FogLine, FogTree};
use femc_math::Rgb;
use femc_math::elementary::double::exp;
use femc_math::glam::{DVec3, Vec3A};
use femc_stats::testing::{chi2::pooled_test, sidak};
use proptest::prelude::*;

/// Generator of numbers in [0, 1) from a seed.
struct Numbers(u64);

impl Numbers {
    fn next(&mut self) -> f32 {
        self.0 = femc_math::hash::mix64(self.0.wrapping_add(0x9e37_79b9_7f4a_7c15));
        (self.0 >> 40) as f32 / (1u64 << 24) as f32
    }

    fn color(&mut self, scale: f32) -> Rgb {
        Rgb::new(self.next(), self.next(), self.next()) * scale
    }
}

/// Kind of fog in a tree.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Fog {
    /// Gray fog, with an extinction from 0 to 1e3 per m.
    Gray,
    /// Colored fog, with an extinction from 0 to 1e3 per m.
    Colored,
    /// Furnace: constant radiance, albedo 1.
    Furnace,
}

fn leaf(numbers: &mut Numbers, fog: Fog) -> FogLeaf {
    let exponent = 11.0 * numbers.next() - 8.0;
    let scale = if numbers.next() < 0.15 { 0.0 } else { femc_math::elementary::pow(10.0, exponent) };
    let sigma_t = if fog == Fog::Colored { numbers.color(scale) } else { Rgb::splat(scale) };
    if fog == Fog::Furnace {
        let mean = [Rgb::splat(3.0), Rgb::ZERO, Rgb::ZERO, Rgb::ZERO];
        return FogLeaf { mean, anisotropy: Vec3A::ZERO, sigma_s: sigma_t, sigma_t };
    }
    // Fog without extinction may still send light.
    let sigma_s = numbers.color(1.0) * sigma_t.max(Rgb::splat(0.01));
    let slope = |numbers: &mut Numbers| numbers.color(6.0) - 3.0;
    let mean = [numbers.color(2.0), slope(numbers), slope(numbers), slope(numbers)];
    let anisotropy = (numbers.color(2.0) - 1.0) * 1.5;
    FogLeaf { mean, anisotropy, sigma_s, sigma_t }.limit_slopes()
}

/// Creates a random tree in [-1, 1] x [-1, 1] x [0, 3].
fn tree(seed: u64, fog: Fog) -> FogTree {
    let mut numbers = Numbers(seed);
    let bounds = [Vec3A::new(-1.0, -1.0, 0.0), Vec3A::new(1.0, 1.0, 3.0)];
    let mut boxes = vec![bounds];
    let mut cells = Vec::new();
    let most = (numbers.next() * 200.0) as usize;
    while let Some([min, max]) = boxes.get(cells.len()).copied() {
        if boxes.len() < most && (cells.len() < 3 || numbers.next() < 0.8) {
            let axis = (numbers.next() * 3.0) as usize;
            // Halves, as in the solver, or a random position.
            let share = if numbers.next() < 0.5 { 0.5 } else { numbers.next() };
            let at = (min[axis] + (max[axis] - min[axis]) * share).clamp(min[axis], max[axis]);
            let (mut low, mut high) = (max, min);
            (low[axis], high[axis]) = (at, at);
            boxes.extend([[min, low], [high, max]]);
            cells.push(FogCell::Split { axis: axis as u8, at });
        } else {
            cells.push(FogCell::Leaf(leaf(&mut numbers, fog)));
        }
    }
    FogTree::new(bounds, &cells).expect("a tree")
}

/// Returns a segment: random, along an axis, or along the border of boxes; from within or from outside.
fn segment(tree: &FogTree, seed: u64) -> (Vec3A, Vec3A, [f32; 2]) {
    let mut numbers = Numbers(seed);
    let [min, max] = tree.bounds();
    let mut point = |slack: f32| min + (max - min) * ((numbers.color(1.0) - 0.5) * slack + 0.5);
    let (mut from, to) = (point(2.0), point(1.0));
    let mut dir = (to - from).normalize_or(Vec3A::Z);
    let kind = (numbers.next() * 4.0) as u32;
    let axis = (numbers.next() * 3.0) as usize;
    if kind >= 2 {
        dir = Vec3A::ZERO;
        dir[axis] = if numbers.next() < 0.5 { 1.0 } else { -1.0 };
        let inside = min.max(from).min(max);
        (from, from[axis]) = (inside, from[axis]);
    }
    if kind == 3 {
        // In the plane of a split across another axis.
        let planes: Vec<(u8, f32)> = tree
            .cells()
            .filter_map(|cell| if let FogCell::Split { axis, at } = cell { Some((axis, at)) } else { None })
            .filter(|&(across, _)| usize::from(across) != axis)
            .collect();
        if let Some(&(across, at)) = planes.get((numbers.next() * planes.len() as f32) as usize) {
            from[usize::from(across)] = at;
        }
    }
    let t0 = if numbers.next() < 0.5 { 0.0 } else { numbers.next() };
    (from, dir, [t0, t0 + 5.0 * numbers.next()])
}

/// Returns the leaf at a point, and its box, using only the cells.
fn leaf_at(tree: &FogTree, position: DVec3) -> Option<(FogLeaf, [DVec3; 2])> {
    let cells: Vec<FogCell> = tree.cells().collect();
    let [mut min, mut max] = tree.bounds().map(|corner| corner.as_dvec3());
    if position.cmplt(min).any() || position.cmpgt(max).any() {
        return None;
    }
    let mut index = 0;
    loop {
        match cells[index] {
            FogCell::Leaf(leaf) => return Some((leaf, [min, max])),
            FogCell::Split { axis, at } => {
                let (axis, at) = (usize::from(axis), f64::from(at));
                let before = cells[..index].iter().filter(|cell| matches!(cell, FogCell::Split { .. })).count();
                let is_low = position[axis] < at;
                index = 2 * before + 1 + usize::from(!is_low);
                if is_low { max[axis] = at } else { min[axis] = at }
            }
        }
    }
}

/// Gauss' rule of five points on [0, 1].
const GAUSS: [(f64, f64); 5] = [
    (0.046_910_077_030_668, 0.118_463_442_528_095),
    (0.230_765_344_947_158_5, 0.239_314_335_249_683_2),
    (0.5, 0.284_444_444_444_444_4),
    (0.769_234_655_052_841_5, 0.239_314_335_249_683_2),
    (0.953_089_922_969_332, 0.118_463_442_528_095),
];

/// Returns the distances at which a segment enters another leaf.
fn borders_of_leaves(tree: &FogTree, origin: Vec3A, dir: Vec3A, [t0, t1]: [f32; 2]) -> Vec<f64> {
    let (o, d) = (origin.as_dvec3(), dir.as_dvec3());
    let [min, max] = tree.bounds();
    let mut planes: Vec<(usize, f32)> = (0..3).flat_map(|axis| [(axis, min[axis]), (axis, max[axis])]).collect();
    planes.extend(
        tree.cells().filter_map(|cell| {
            if let FogCell::Split { axis, at } = cell { Some((usize::from(axis), at)) } else { None }
        }),
    );
    let (t0, t1) = (f64::from(t0), f64::from(t1));
    let crossing = |&(axis, at): &(usize, f32)| (f64::from(at) - o[axis]) / d[axis];
    let mut places: Vec<f64> = planes.iter().map(crossing).filter(|t| *t > t0 && *t < t1).chain([t0, t1]).collect();
    places.sort_by(f64::total_cmp);
    places
}

/// Returns the number of steps of a quadrature over a stretch: a twentieth of a free path or less each.
fn steps(leaf: &FogLeaf, length: f64) -> u32 {
    (20.0 * f64::from(leaf.sigma_t.max_element()) * length).ceil().clamp(1.0, 2e4) as u32
}

/// Returns the arriving light and the transmittance by quadrature.
fn quadrature(tree: &FogTree, origin: Vec3A, dir: Vec3A, range: [f32; 2]) -> ([f64; 3], [f64; 3]) {
    let (o, d) = (origin.as_dvec3(), dir.as_dvec3());
    let (mut sum, mut depth) = ([0.0; 3], [0.0f64; 3]);
    for pair in borders_of_leaves(tree, origin, dir, range).windows(2) {
        let (a, length) = (pair[0], pair[1] - pair[0]);
        let Some((leaf, [low, high])) = leaf_at(tree, o + d * (a + 0.5 * length)) else { continue };
        let sigma = leaf.sigma_t.to_array().map(f64::from);
        let steps = steps(&leaf, length);
        let toward_start = f64::from(leaf.directional_factor(-dir));
        for step in 0..steps {
            for (x, weight) in GAUSS {
                let s = (f64::from(step) + x) / f64::from(steps) * length;
                let local = (o + d * (a + s) - 0.5 * (low + high)) / (high - low);
                for k in 0..3 {
                    let [middle, x, y, z] = leaf.mean.map(|color| f64::from(color[k]));
                    let part = |slope: f64, at: f64| if slope == 0.0 { 0.0 } else { slope * at };
                    let mean = (middle + part(x, local.x) + part(y, local.y) + part(z, local.z)).max(0.0);
                    let sent = f64::from(leaf.sigma_s[k]) * mean * toward_start;
                    sum[k] += weight * length / f64::from(steps) * sent * exp(-depth[k] - sigma[k] * s);
                }
            }
        }
        (0..3).for_each(|k| depth[k] += sigma[k] * length);
    }
    (sum, depth.map(|depth| exp(-depth)))
}

fn assert_close(have: Rgb, want: [f64; 3], scale: f64, label: &str) {
    for k in 0..3 {
        let error = (f64::from(have[k]) - want[k]).abs();
        assert!(error <= 1e-6 * (want[k] + 1e-6 * scale) + 1e-30, "{label}: {have} {want:?}");
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 400, rng_seed: proptest::test_runner::RngSeed::Fixed(36), ..ProptestConfig::default() })]

    #[test]
    fn a_line_has_what_quadrature_finds(seed: u64, way: u64, colored: bool) {
        let tree = tree(seed, if colored { Fog::Colored } else { Fog::Gray });
        let (origin, dir, range) = segment(&tree, way);
        let mut line = FogLine::default();
        tree.radiance_along(origin, dir, range[0], range[1], &mut line);
        let (sum, through) = quadrature(&tree, origin, dir, range);
        let scale = sum.iter().copied().fold(0.0, f64::max);
        assert_close(line.radiance(), sum, scale, "total");
        assert_close(line.transmittance(), through, 1.0, "transmittance");
        let want: f64 = (0..3).map(|k| sum[k] * f64::from(femc_math::color::LUMINANCE_WEIGHTS[k])).sum();
        prop_assert!((f64::from(line.luminance()) - want).abs() <= 1e-6 * want + 1e-30, "{} {want}", line.luminance());
    }

    #[test]
    fn two_parts_of_a_line_are_the_whole(seed: u64, way: u64, colored: bool, share in 0.0f32..1.0) {
        let tree = tree(seed, if colored { Fog::Colored } else { Fog::Gray });
        let (origin, dir, [t0, t1]) = segment(&tree, way);
        let cut = t0 + (t1 - t0) * share;
        let [mut whole, mut near, mut far] = [(); 3].map(|()| FogLine::default());
        tree.radiance_along(origin, dir, t0, t1, &mut whole);
        tree.radiance_along(origin, dir, t0, cut, &mut near);
        tree.radiance_along(origin, dir, cut, t1, &mut far);
        let both = near.radiance() + near.transmittance() * far.radiance();
        let most = whole.radiance().max_element();
        prop_assert!((both - whole.radiance()).abs().max_element() <= 2e-6 * most, "{both} {}", whole.radiance());
        let through = near.transmittance() * far.transmittance();
        prop_assert!((through - whole.transmittance()).abs().max_element() <= 2e-6);
    }

    #[test]
    fn in_a_furnace_a_line_has_what_it_takes_of_the_light_behind(seed: u64, way: u64) {
        let tree = tree(seed, Fog::Furnace);
        let (origin, dir, [t0, t1]) = segment(&tree, way);
        let mut line = FogLine::default();
        tree.radiance_along(origin, dir, t0, t1, &mut line);
        let want = (Rgb::ONE - line.transmittance()) * 3.0;
        prop_assert!((line.radiance() - want).abs().max_element() <= 1e-6, "{} {want}", line.radiance());
    }

    #[test]
    fn the_density_integrates_to_the_share_of_what_is_drawn(seed: u64, way: u64, colored: bool) {
        let tree = tree(seed, if colored { Fog::Colored } else { Fog::Gray });
        let (origin, dir, [t0, t1]) = segment(&tree, way);
        let mut line = FogLine::default();
        tree.radiance_along(origin, dir, t0, t1, &mut line);
        // The light up to the point sampled for u is the share u of all light.
        let mut before = t0;
        for k in 0..16 {
            let u = f64::from(k) / 16.0;
            let Some(drawn) = line.sample(u) else {
                prop_assert!(line.luminance() == 0.0);
                break;
            };
            prop_assert!(drawn.t >= before && drawn.t <= t1 && drawn.pdf.is_finite());
            prop_assert_eq!(line.pdf(drawn.t), drawn.pdf);
            before = drawn.t;
            let mut near = FogLine::default();
            tree.radiance_along(origin, dir, t0, drawn.t, &mut near);
            // The position is rounded.
            let slack = f64::from(drawn.pdf) * f64::from(drawn.t) * f64::from(f32::EPSILON);
            let share = f64::from(near.luminance()) / f64::from(line.luminance());
            prop_assert!((share - u).abs() <= 2e-6 + slack, "{share} {u}");
        }
    }
}

/// Returns borders of cells with equal shares of the light, and the light up to each of them.
fn borders(tree: &FogTree, line: &FogLine, (origin, dir, t0): (Vec3A, Vec3A, f32), cells: u32) -> (Vec<f32>, Vec<f64>) {
    let mut near = FogLine::default();
    (1..cells)
        .filter_map(|k| line.sample(f64::from(k) / f64::from(cells)))
        .map(|drawn| {
            tree.radiance_along(origin, dir, t0, drawn.t, &mut near);
            (drawn.t, f64::from(near.luminance()) / f64::from(line.luminance()))
        })
        .unzip()
}

/// The level of all tests together is 1e-3.
#[test]
fn distances_are_drawn_by_the_light_that_comes_from_them() {
    const LINES: u64 = 40;
    const DRAWN: u32 = 20_000;
    let level = sidak(1e-3, LINES as usize);
    for k in 0..LINES {
        let tree = tree(k, if k % 2 == 0 { Fog::Gray } else { Fog::Colored });
        let (origin, dir, [t0, t1]) = segment(&tree, 1000 + k);
        let mut line = FogLine::default();
        tree.radiance_along(origin, dir, t0, t1, &mut line);
        if line.luminance() == 0.0 {
            continue;
        }
        // Equidistant points are tested, too, because the light's own quantiles might hide errors between them.
        let (mut places, mut upto) = borders(&tree, &line, (origin, dir, t0), 16);
        let mut near = FogLine::default();
        for step in 1..16u8 {
            let t = t0 + (t1 - t0) * f32::from(step) / 16.0;
            tree.radiance_along(origin, dir, t0, t, &mut near);
            places.push(t);
            upto.push(f64::from(near.luminance()) / f64::from(line.luminance()));
        }
        places.sort_by(f32::total_cmp);
        upto.sort_by(f64::total_cmp);
        let shares = |i: usize| upto.get(i).copied().unwrap_or(1.0) - if i == 0 { 0.0 } else { upto[i - 1] };
        let expected: Vec<f64> = (0..=upto.len()).map(|i| shares(i) * f64::from(DRAWN)).collect();
        let mut counts = vec![0; expected.len()];
        let mut numbers = Numbers(7 + k);
        for _ in 0..DRAWN {
            let drawn = line.sample(f64::from(numbers.next())).expect("light");
            counts[places.partition_point(|place| *place <= drawn.t)] += 1;
        }
        let result = pooled_test(&expected, &counts);
        // Light that comes from only one place leaves nothing to test.
        assert!(result.p >= level || result.dof == 0, "line {k}: {result:?}");
    }
}

#[test]
fn the_density_integrates_to_one() {
    let mut tested = 0;
    for k in 0..1000 {
        let tree = tree(k, if k % 2 == 0 { Fog::Gray } else { Fog::Colored });
        let (origin, dir, [t0, t1]) = segment(&tree, 2000 + k);
        let mut line = FogLine::default();
        tree.radiance_along(origin, dir, t0, t1, &mut line);
        // If a free path is within the rounding of the distance, a quadrature is impossible.
        let thickest = tree.leaves().map(|leaf| leaf.sigma_t.max_element()).fold(0.0, f32::max);
        if line.luminance() == 0.0 || thickest > 100.0 {
            continue;
        }
        let mut sum = 0.0;
        for pair in borders_of_leaves(&tree, origin, dir, [t0, t1]).windows(2) {
            let (a, length) = (pair[0], pair[1] - pair[0]);
            let Some((leaf, _)) = leaf_at(&tree, origin.as_dvec3() + dir.as_dvec3() * (a + 0.5 * length)) else {
                continue;
            };
            let steps = steps(&leaf, length);
            for (step, (x, weight)) in (0..steps).flat_map(|step| GAUSS.map(|point| (step, point))) {
                let t = a + (f64::from(step) + x) / f64::from(steps) * length;
                sum += f64::from(line.pdf(t as f32)) * weight * length / f64::from(steps);
            }
        }
        tested += 1;
        assert!((sum - 1.0).abs() < 1e-5, "line {k}: {sum}");
    }
    assert!(tested > 50, "{tested} lines");
}

#[test]
fn a_point_has_the_light_of_its_box_and_none_outside() {
    let tree = tree(5, Fog::Colored);
    let mut numbers = Numbers(3);
    for _ in 0..1000 {
        let point = Vec3A::new(-1.2, -1.2, -0.2) + numbers.color(1.0) * Vec3A::new(2.4, 2.4, 3.4);
        let want = leaf_at(&tree, point.as_dvec3()).map_or(Rgb::ZERO, |(leaf, [min, max])| {
            let local = ((point.as_dvec3() - min) / (max - min) - 0.5).as_vec3a();
            let [middle, x, y, z] = leaf.mean;
            (middle + x * local.x + y * local.y + z * local.z).max(Rgb::ZERO)
        });
        assert!((tree.mean_radiance(point) - want).abs().max_element() <= 1e-5, "{point}");
    }
    assert!(FogTree::default().mean_radiance(Vec3A::ZERO) == Rgb::ZERO);
    assert!(FogTree::default().scattered_radiance(Vec3A::ZERO, Vec3A::X) == Rgb::ZERO);
}

/// Over all directions, fog scatters the mean radiance; by more ahead of the light than back.
#[test]
fn fog_scatters_more_light_ahead() {
    let leaf = FogLeaf {
        mean: [Rgb::splat(2.0), Rgb::ZERO, Rgb::ZERO, Rgb::ZERO],
        anisotropy: Vec3A::new(0.6, 0.0, -0.8),
        sigma_s: Rgb::ONE,
        sigma_t: Rgb::ONE,
    };
    let tree = FogTree::new([Vec3A::ZERO, Vec3A::ONE], &[FogCell::Leaf(leaf)]).expect("a box of fog");
    let toward = |dir: Vec3A| tree.scattered_radiance(Vec3A::splat(0.5), dir).y;
    assert!((toward(leaf.anisotropy) - 4.0).abs() < 1e-6 && (toward(-leaf.anisotropy) - 0.1).abs() < 1e-6);
    let mean = (0..1000).map(|k| {
        let z = 1.0 - (2 * k + 1) as f32 / 1000.0;
        toward(femc_math::warp::direction(z, (k as f32 * 0.618_034).fract()))
    });
    assert!((mean.sum::<f32>() / 1000.0 - 2.0).abs() < 5e-3);
}

#[test]
fn cells_that_are_no_tree_of_boxes_or_have_no_light_are_refused() {
    let bounds = [Vec3A::ZERO, Vec3A::ONE];
    let mean = [Rgb::ONE, Rgb::ONE, Rgb::ZERO, Rgb::ZERO];
    let good = FogLeaf { mean, anisotropy: Vec3A::X, sigma_s: Rgb::ONE, sigma_t: Rgb::ONE };
    let cut = |axis, at| FogCell::Split { axis, at };
    let accepted = |cells: &[FogCell]| FogTree::new(bounds, cells).is_some();
    let with = |change: fn(&mut FogLeaf)| {
        let mut leaf = good;
        change(&mut leaf);
        accepted(&[FogCell::Leaf(leaf)])
    };
    let leaf = FogCell::Leaf(good);
    assert!(accepted(&[leaf]) && accepted(&[cut(2, 0.5), leaf, cut(0, 1.0), leaf, leaf]));
    assert!(
        !accepted(&[])
            && !accepted(&[cut(0, 0.5), leaf])
            && !accepted(&[leaf, leaf])
            && !accepted(&[leaf, cut(0, 0.5), leaf])
    );
    assert!(!accepted(&[cut(3, 0.5), leaf, leaf]) && !accepted(&[cut(0, 1.5), leaf, leaf]));
    assert!(!accepted(&[cut(0, f32::NAN), leaf, leaf]));
    assert!(!accepted(&[cut(0, 0.5), cut(0, 0.7), leaf, leaf, leaf]), "a cut outside of its box");
    assert!(!with(|leaf| leaf.mean[2] = Rgb::splat(1.1)), "a negative value in a corner");
    assert!(!with(|leaf| leaf.mean[0].y = f32::NAN) && !with(|leaf| leaf.mean[3].z = f32::INFINITY));
    assert!(!with(|leaf| leaf.sigma_s.x = -1e-9) && !with(|leaf| leaf.sigma_t.z = f32::NAN));
    assert!(!with(|leaf| leaf.sigma_t.z = f32::INFINITY));
    assert!(!with(|leaf| leaf.anisotropy.y = f32::NAN) && !with(|leaf| leaf.anisotropy.y = 3.1));
    let mut large = good;
    large.sigma_s = Rgb::splat(f32::MAX);
    assert!(!accepted(&[FogCell::Leaf(FogLeaf { mean: large.mean.map(|m| m * 4.0), ..large })]), "an infinite product");
    assert!(FogTree::new([Vec3A::ONE, Vec3A::ZERO], &[leaf]).is_none());
    assert!(with(|leaf| *leaf = FogLeaf { mean: leaf.mean.map(|m| m * 7.0), ..*leaf }.limit_slopes()));
}
