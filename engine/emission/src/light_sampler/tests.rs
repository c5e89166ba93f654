use super::*;
use crate::light::{Parallelogram, Sphere};
use crate::{AngularProfile, BsdfLobes, Emission, EmissionCone, EmittingSides, Light, PointContext, SegmentContext};
use femc_math::hash::{combine, unit_f32};
use femc_math::{Rgb, warp};
use femc_stats::testing::sidak;
use femc_stats::testing::ztest::z_test;

fn number(key: &[u64]) -> f32 {
    unit_f32((combine(key) >> 32) as u32)
}

fn vector(key: u64, i: u64, scale: f32) -> Vec3A {
    Vec3A::new(number(&[key, i, 0]) - 0.5, number(&[key, i, 1]) - 0.5, number(&[key, i, 2]) - 0.5) * (2.0 * scale)
}

fn emission(sides: EmittingSides, profile: AngularProfile, emittance: f32) -> Emission {
    Emission { emittance: Rgb::splat(emittance), profile, sides }
}

/// Makes panels of all kinds in a hall of 40 m, some of them in groups, and a few balls.
fn hall(count: u64) -> Vec<Light> {
    let one = |i: u64| {
        let place = if i.is_multiple_of(3) { vector(1, i / 9, 20.0) + vector(2, i, 0.4) } else { vector(1, i, 20.0) };
        let bright = 10.0f32.powf(3.0 * number(&[3, i]));
        if i.is_multiple_of(7) {
            return Light::Sphere(Sphere::new(
                place,
                0.1,
                emission(EmittingSides::One, AngularProfile::Lambertian, bright),
            ));
        }
        let (u, v) = (vector(4, i, 0.3), vector(5, i, 0.3));
        let sides = if i.is_multiple_of(2) { EmittingSides::One } else { EmittingSides::Two };
        let profile = if i.is_multiple_of(5) {
            AngularProfile::Lobe { exponent: 60.0 * number(&[6, i]) }
        } else {
            AngularProfile::Lambertian
        };
        Light::Parallelogram(Parallelogram::new(place, u, v, emission(sides, profile, bright)))
    };
    (0..count).map(one).collect()
}

fn bounds(light: &Light, extinction: f32) -> LightBounds {
    let (low, high) = light.bounds();
    LightBounds { low, high, center: light.center(), power: light.power(), extinction, cone: light.emission_cone() }
}

fn sampler(lights: &[Light]) -> LightSampler {
    sampler_in_fog(lights, 0.02)
}

fn sampler_in_fog(lights: &[Light], extinction: f32) -> LightSampler {
    LightSampler::new(&lights.iter().map(|light| bounds(light, extinction)).collect::<Vec<_>>())
}

/// A choice among lights at one place.
struct LightChoice<'a, P> {
    lights: &'a LightSampler,
    context: &'a P,
    weights: LightWeights,
}

impl<'a, P: LightSampleContext> LightChoice<'a, P> {
    fn new(lights: &'a LightSampler, context: &'a P) -> Self {
        let mut weights = LightWeights::default();
        lights.weigh(context, &mut weights);
        Self { lights, context, weights }
    }

    fn choose(&self, u: f64) -> Option<(u32, f32)> {
        self.lights.choose(&self.weights, self.context, || u)
    }

    fn probability(&self, light: u32) -> f32 {
        self.lights.probability(&self.weights, self.context, light)
    }
}

fn point_context(position: Vec3A, normal: Vec3A) -> PointContext {
    PointContext { position, normal, lobes: None }
}

fn points(count: u64) -> impl Iterator<Item = PointContext> {
    (0..count).map(|i| {
        let normal = if i.is_multiple_of(3) { Vec3A::ZERO } else { vector(11, i, 1.0).normalize() };
        let lobes = (i % 3 == 1).then(|| BsdfLobes {
            diffuse: number(&[16, i]),
            glossy: 0.5,
            alpha: 0.3 * number(&[17, i]) + 1e-3,
            wo: (normal + vector(18, i, 0.9)).normalize(),
        });
        PointContext { position: vector(10, i, 22.0), normal, lobes }
    })
}

fn segment(origin: Vec3A, dir: Vec3A, range: (f32, f32)) -> SegmentContext {
    SegmentContext { origin, dir, range, end: range.1, angles: 3, extinction: 0.03, phase: 0.6 }
}

fn segments(count: u64) -> impl Iterator<Item = SegmentContext> {
    (0..count).map(|i| {
        let range = (number(&[14, i]), 1.0 + 40.0 * number(&[15, i]));
        segment(vector(12, i, 22.0), vector(13, i, 1.0).normalize(), range)
    })
}

/// Checks that evenly spaced numbers choose lights with the reported probabilities. The probabilities sum to 1, minus the share of
/// the numbers that choose no light: in a tree, a number may lead to a cluster whose lights all face away. Returns this share.
fn assert_probabilities(lights: &LightSampler, count: usize, context: &impl LightSampleContext) -> f64 {
    let choice = LightChoice::new(lights, context);
    let probabilities: Vec<f64> = (0..count as u32).map(|light| f64::from(choice.probability(light))).collect();
    let n = 4000;
    let (mut counts, mut nothing) = (vec![0u32; count], 0.0);
    for i in 0..n {
        match choice.choose((f64::from(i) + 0.5) / f64::from(n)) {
            None => nothing += 1.0 / f64::from(n),
            Some((light, probability)) => {
                assert_eq!(probability, choice.probability(light), "light {light}");
                counts[light as usize] += 1;
            }
        }
    }
    let sum: f64 = probabilities.iter().sum();
    assert!((sum + nothing - 1.0).abs() < 5e-3 && (nothing > 0.0 || (sum - 1.0).abs() < 1e-3), "{sum} {nothing}");
    for (light, (&count, probability)) in counts.iter().zip(&probabilities).enumerate() {
        // A light owns one interval of the numbers: the count is off by less than one step at each end.
        assert!(
            (f64::from(count) - probability * f64::from(n)).abs() < 1.01,
            "light {light}: {count} of {n}, {probability}"
        );
    }
    nothing
}

#[test]
fn choices_have_the_probabilities_that_are_told() {
    for count in [1, 2, 3, 40, 300] {
        let lights = hall(count);
        let sampler = sampler(&lights);
        let nothing: f64 = points(20).map(|place| assert_probabilities(&sampler, lights.len(), &place)).sum();
        assert!(count < 40 || nothing < 5.0, "{count} lights: {nothing} of 20 choices find none");
        segments(6).for_each(|place| assert_eq!(assert_probabilities(&sampler, lights.len(), &place), 0.0));
    }
}

#[test]
fn a_light_that_reaches_a_place_is_never_lost() {
    for count in [120, 300] {
        a_light_that_reaches_a_place_is_never_lost_among(count);
    }
}

fn a_light_that_reaches_a_place_is_never_lost_among(count: u64) {
    let lights = hall(count);
    let sampler = sampler(&lights);
    let mut reached = 0;
    for (i, place) in points(400).enumerate() {
        let choice = LightChoice::new(&sampler, &place);
        for (light, source) in lights.iter().enumerate() {
            let u = [number(&[20, i as u64, light as u64]), number(&[21, i as u64, light as u64])];
            let Some(sample) = source.sample(place.position, u) else { continue };
            if place.normal == Vec3A::ZERO || place.normal.dot(sample.dir) > 0.0 {
                reached += 1;
                let probability = choice.probability(light as u32);
                assert!(probability > 0.0, "place {i}, light {light}: {place:?} {source:?}");
            }
        }
    }
    assert!(reached > 10_000, "{reached}");
}

#[test]
fn what_faces_away_and_what_is_behind_is_not_chosen() {
    let down = |x: f64| {
        let (u, v) = (Vec3A::Y, Vec3A::X);
        let panel = emission(EmittingSides::One, AngularProfile::Lambertian, 10.0);
        Light::Parallelogram(Parallelogram::new(Vec3A::new(x as f32, 0.0, 3.0), u, v, panel))
    };
    let lights = [down(0.0), down(30.0)];
    let sampler = sampler(&lights);
    let above = point_context(Vec3A::new(0.0, 0.0, 5.0), Vec3A::ZERO);
    let choice = LightChoice::new(&sampler, &above);
    assert!(choice.choose(0.3).is_none() && choice.probability(0) == 0.0);
    assert!(LightChoice::new(&sampler, &point_context(Vec3A::ZERO, -Vec3A::Z)).choose(0.3).is_none());
    let near = LightChoice::new(&sampler, &point_context(Vec3A::new(0.5, 0.5, 0.0), Vec3A::Z)).probability(0);
    assert!(near > 0.99, "{near}");
    let beside = segment(Vec3A::new(28.0, -9.0, 1.0), Vec3A::Y, (0.0, 20.0));
    let beside = LightChoice::new(&sampler, &beside).probability(1);
    assert!(beside > 0.9, "{beside}");
    let over = segment(Vec3A::new(28.0, -9.0, 4.0), Vec3A::Y, (0.0, 20.0));
    assert!(LightChoice::new(&sampler, &over).choose(0.3).is_none());
    // The evaluated range is above the lamps; farther on, the ray passes below them.
    let down =
        SegmentContext { end: 200.0, ..segment(Vec3A::new(28.0, -9.0, 4.0), Vec3A::new(0.0, 0.6, -0.8), (0.0, 1.0)) };
    assert!(LightChoice::new(&sampler, &down).probability(1) > 0.0);
}

/// Makes lamps along two crossing roads, 8 m high, facing down.
fn street() -> Vec<Light> {
    let lamp = |x: f32, y: f32| {
        let (place, panel) = (Vec3A::new(x, y, 8.0), emission(EmittingSides::One, AngularProfile::Lambertian, 1e4));
        Light::Parallelogram(Parallelogram::new(place, Vec3A::Y * 0.2, Vec3A::X * 0.5, panel))
    };
    let along = (-12..12i16).map(|i| 25.0 * f32::from(i));
    along.flat_map(|x| [lamp(x, 5.0), lamp(-5.0, x + 12.0)]).collect()
}

#[test]
fn street_lamp_choice_is_nearly_proportional_to_sent_light() {
    let lights = street();
    let sampler = sampler_in_fog(&lights, 0.0);
    for i in 0..500 {
        let (along, beside) = (600.0 * (number(&[40, i]) - 0.5), 12.0 * (number(&[41, i]) - 0.5));
        let [x, y] = if i % 2 == 0 { [along, beside] } else { [beside, along] };
        let place = point_context(Vec3A::new(x, y, 0.5), Vec3A::Z);
        let choice = LightChoice::new(&sampler, &place);
        let (mut sent, mut squares) = (0.0, 0.0);
        for (index, light) in lights.iter().enumerate() {
            let Some(sample) = light.sample(place.position, [0.5; 2]) else { continue };
            let part = f64::from(sample.radiance.max_element() * place.normal.dot(sample.dir) / sample.pdf);
            sent += part;
            squares += part * part / f64::from(choice.probability(index as u32));
        }
        // Relative second moment of one choice; the optimum is 1.
        assert!(squares / (sent * sent) < 1.25, "{place:?}: {}", squares / (sent * sent));
    }
}

#[test]
fn coincident_powerless_and_infinite_lights_are_handled() {
    let ball = |power: f32| {
        Light::Sphere(Sphere::new(Vec3A::ONE, 0.1, emission(EmittingSides::One, AngularProfile::Lambertian, power)))
    };
    let lights: Vec<Light> = (0..3000).map(|i| ball(if i % 3 == 0 { 0.0 } else { 1.0 })).collect();
    let all = sampler(&lights);
    let place = point_context(Vec3A::ZERO, Vec3A::ZERO);
    let choice = LightChoice::new(&all, &place);
    for i in 0..100 {
        let (light, probability) = choice.choose(f64::from(i) / 100.0).expect("lights");
        assert!(light % 3 != 0 && (probability * 2000.0 - 1.0).abs() < 0.1, "{light} {probability}");
        assert_eq!(choice.probability(light), probability);
    }
    assert_eq!(choice.probability(0), 0.0);
    let few = sampler(&lights[..100]);
    let choice = LightChoice::new(&few, &place);
    assert!((0..100).all(|light| (choice.probability(light) > 0.0) == (light % 3 != 0)));
    let none = sampler(&[]);
    assert!(LightChoice::new(&none, &place).choose(0.5).is_none());
    let endless = LightBounds { high: Vec3A::INFINITY, ..bounds(&ball(1.0), 0.0) };
    assert!(LightSampler::new(&[endless]).is_empty());
}

#[test]
fn joined_cones_hold_both() {
    for i in 0..2000 {
        let cone = |k: u64| EmissionCone {
            axis: vector(30 + k, i, 1.0).normalize(),
            cos_normals: 1.0 - 1.5 * number(&[32 + k, i]),
            exponent: 1.0,
            two_sided: false,
        };
        let (a, b) = (cone(0), cone(1));
        let both = a.join(&b);
        for (k, part) in [(0, a), (1, b)] {
            // A direction on the border of the part.
            let side = part.axis.cross(vector(34 + k, i, 1.0)).normalize_or(part.axis.any_orthonormal_vector());
            let border = part.axis * part.cos_normals + side * (1.0 - part.cos_normals * part.cos_normals).sqrt();
            assert!(border.dot(both.axis) >= both.cos_normals - 1e-4, "{a:?} {b:?} {both:?}");
        }
    }
}

/// Makes points in fog among 1, 40 and 300 lights.
fn from_points() -> impl Iterator<Item = (LightSampler, DirectionContext)> {
    [1, 40, 300].into_iter().enumerate().map(|(k, count)| {
        let toward = vector(50, k as u64, 1.0).normalize();
        let from = DirectionContext {
            position: vector(51, k as u64, 15.0),
            wo: toward,
            extinction: 0.05,
            phase: 0.3 * k as f32,
        };
        (sampler(&hall(count)), from)
    })
}

/// Checks that the mean of one over the density equals the solid angle of any part of the sphere, here of 8 x 16 cells. The density
/// has poles, so its inverse is summed.
#[test]
fn directions_follow_their_density() {
    let (rows, columns, n) = (8u32, 16u32, 40_000u64);
    for (k, (lights, from)) in from_points().enumerate() {
        let mut weights = LightWeights::default();
        lights.weigh_directions(&from, &mut weights);
        let cells = (rows * columns) as usize;
        let (mut sums, mut squares) = (vec![0.0f64; cells], vec![0.0f64; cells]);
        for i in 0..n {
            let u = |j: u64| number(&[52, k as u64, i, j]);
            let near = lights.sample_direction(&from, &weights, f64::from(u(0)), [u(1), u(2)]);
            let dir = near.unwrap_or_else(|| warp::sphere([u(3), u(4)]));
            let pdf = lights.direction_pdf(&from, &weights, dir, 0.25 / std::f32::consts::PI);
            assert!(pdf > 0.0 && pdf.is_finite() && (dir.length() - 1.0).abs() < 1e-5, "{dir} {pdf}");
            let row = ((0.5 * (dir.z + 1.0) * rows as f32) as usize).min(rows as usize - 1);
            let turn = dir.y.atan2(dir.x) / std::f32::consts::TAU + 0.5;
            let column = ((turn * columns as f32) as usize).min(columns as usize - 1);
            let value = 1.0 / f64::from(pdf);
            sums[row * columns as usize + column] += value;
            squares[row * columns as usize + column] += value * value;
        }
        let solid_angle = 4.0 * std::f64::consts::PI / cells as f64;
        for (sum, square) in sums.iter().zip(&squares) {
            let mean = sum / n as f64;
            let error = ((square / n as f64 - mean * mean) / n as f64).sqrt();
            let p = z_test(mean, error, solid_angle);
            assert!(p > sidak(1e-3, 3 * cells), "{} lights: {mean} +- {error}, not {solid_angle}", lights.nodes.len());
        }
    }
}

#[test]
fn every_instruction_set_gives_the_same_weights() {
    let lights = hall(100);
    let fast = sampler(&lights);
    let plain = LightSampler { blocks: fast.blocks.clone().portable(), ..fast.clone() };
    let compare = |a: &LightWeights, b: &LightWeights| {
        for light in 0..100 {
            assert_eq!(a.weights.probability(light).to_bits(), b.weights.probability(light).to_bits());
        }
    };
    let (mut a, mut b) = (LightWeights::default(), LightWeights::default());
    for place in points(50) {
        fast.weigh(&place, &mut a);
        plain.weigh(&place, &mut b);
        compare(&a, &b);
    }
    for place in segments(50) {
        fast.weigh(&place, &mut a);
        plain.weigh(&place, &mut b);
        compare(&a, &b);
    }
    for (_, from) in from_points() {
        fast.weigh_directions(&from, &mut a);
        plain.weigh_directions(&from, &mut b);
        compare(&a, &b);
        let dir = Vec3A::new(0.6, 0.0, 0.8);
        assert_eq!(fast.direction_pdf(&from, &a, dir, 0.1), plain.direction_pdf(&from, &b, dir, 0.1));
    }
}
