use super::*;
use crate::light::{Parallelogram, Sphere};
use crate::{Emission, Light, Profile, Sides};
use femc_math::Rgb;
use femc_math::hash::{combine, unit_f32};

fn number(key: &[u64]) -> f32 {
    unit_f32((combine(key) >> 32) as u32)
}

fn vector(key: u64, i: u64, scale: f32) -> Vec3A {
    Vec3A::new(number(&[key, i, 0]) - 0.5, number(&[key, i, 1]) - 0.5, number(&[key, i, 2]) - 0.5) * (2.0 * scale)
}

fn emission(sides: Sides, profile: Profile, emittance: f32) -> Emission {
    Emission { emittance: Rgb::splat(emittance), profile, sides }
}

/// Panels of all kinds in a hall of 40 m, some of them bundled, and a few balls.
fn hall(count: u64) -> Vec<Light> {
    let one = |i: u64| {
        let place = if i.is_multiple_of(3) { vector(1, i / 9, 20.0) + vector(2, i, 0.4) } else { vector(1, i, 20.0) };
        let bright = 10.0f32.powf(3.0 * number(&[3, i]));
        if i.is_multiple_of(7) {
            return Light::Sphere(Sphere::new(place, 0.1, emission(Sides::One, Profile::Lambertian, bright)));
        }
        let (u, v) = (vector(4, i, 0.3), vector(5, i, 0.3));
        let sides = if i.is_multiple_of(2) { Sides::One } else { Sides::Two };
        let profile =
            if i.is_multiple_of(5) { Profile::Lobe { exponent: 60.0 * number(&[6, i]) } } else { Profile::Lambertian };
        Light::Parallelogram(Parallelogram::new(place, u, v, emission(sides, profile, bright)))
    };
    (0..count).map(one).collect()
}

fn tree(lights: &[Light]) -> LightTree {
    let bounds: Vec<LightBounds> = lights
        .iter()
        .map(|light| {
            let (low, high) = light.bounds();
            LightBounds { low, high, power: light.power(), cone: light.emission_cone() }
        })
        .collect();
    LightTree::new(&bounds)
}

fn points(count: u64) -> impl Iterator<Item = AtPoint> {
    (0..count).map(|i| {
        let normal = if i.is_multiple_of(3) { Vec3A::ZERO } else { vector(11, i, 1.0).normalize() };
        AtPoint { position: vector(10, i, 22.0), normal, haze: if i.is_multiple_of(2) { 0.05 } else { 0.0 } }
    })
}

fn segments(count: u64) -> impl Iterator<Item = AlongSegment> {
    (0..count).map(|i| AlongSegment {
        origin: vector(12, i, 22.0),
        dir: vector(13, i, 1.0).normalize(),
        range: (number(&[14, i]), 1.0 + 40.0 * number(&[15, i])),
        haze: 0.03,
    })
}

/// Choices at evenly spaced numbers have the probabilities that the tree tells; those sum to 1, but for the choices that end
/// among lights of which none reaches the place.
fn agrees(tree: &LightTree, lights: usize, place: &impl Place) -> f64 {
    let probabilities: Vec<f64> = (0..lights as u32).map(|light| f64::from(tree.probability(place, light))).collect();
    let n = 4000;
    let (mut counts, mut nothing) = (vec![0u32; lights], 0.0);
    for i in 0..n {
        match tree.choose(place, (f64::from(i) + 0.5) / f64::from(n)) {
            None => nothing += 1.0 / f64::from(n),
            Some((light, probability)) => {
                assert_eq!(probability, tree.probability(place, light), "light {light}");
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
        let tree = tree(&lights);
        let nothing: f64 = points(20).map(|place| agrees(&tree, lights.len(), &place)).sum();
        assert!(count < 40 || nothing < 5.0, "{count} lights: {nothing} of 20 choices find none");
        segments(6).for_each(|place| assert_eq!(agrees(&tree, lights.len(), &place), 0.0));
    }
}

#[test]
fn a_light_that_reaches_a_place_is_never_lost() {
    let lights = hall(120);
    let tree = tree(&lights);
    let mut reached = 0;
    for (i, place) in points(400).enumerate() {
        for (light, source) in lights.iter().enumerate() {
            let u = [number(&[20, i as u64, light as u64]), number(&[21, i as u64, light as u64])];
            let Some(sample) = source.sample(place.position, u) else { continue };
            if place.normal == Vec3A::ZERO || place.normal.dot(sample.dir) > 0.0 {
                reached += 1;
                let probability = tree.probability(&place, light as u32);
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
        let panel = emission(Sides::One, Profile::Lambertian, 10.0);
        Light::Parallelogram(Parallelogram::new(Vec3A::new(x as f32, 0.0, 3.0), u, v, panel))
    };
    let lights = [down(0.0), down(30.0)];
    let tree = tree(&lights);
    let above = AtPoint { position: Vec3A::new(0.0, 0.0, 5.0), normal: Vec3A::ZERO, haze: 0.0 };
    assert!(tree.choose(&above, 0.3).is_none() && tree.probability(&above, 0) == 0.0);
    let turned = AtPoint { position: Vec3A::ZERO, normal: -Vec3A::Z, haze: 0.0 };
    assert!(tree.choose(&turned, 0.3).is_none());
    let near = AtPoint { position: Vec3A::new(0.5, 0.5, 0.0), normal: Vec3A::Z, haze: 0.0 };
    assert!(tree.probability(&near, 0) > 0.99, "{}", tree.probability(&near, 0));
    let beside = AlongSegment { origin: Vec3A::new(28.0, -9.0, 1.0), dir: Vec3A::Y, range: (0.0, 20.0), haze: 0.0 };
    assert!(tree.probability(&beside, 1) > 0.9, "{}", tree.probability(&beside, 1));
}

/// Lamps along two crossing roads, 8 m high, facing down.
fn street() -> Vec<Light> {
    let lamp = |x: f32, y: f32| {
        let (place, panel) = (Vec3A::new(x, y, 8.0), emission(Sides::One, Profile::Lambertian, 1e4));
        Light::Parallelogram(Parallelogram::new(place, Vec3A::Y * 0.2, Vec3A::X * 0.5, panel))
    };
    let along = (-12..12i16).map(|i| 25.0 * f32::from(i));
    along.flat_map(|x| [lamp(x, 5.0), lamp(-5.0, x + 12.0)]).collect()
}

#[test]
fn under_street_lamps_the_choice_is_nearly_in_proportion_to_what_they_send() {
    let lights = street();
    let tree = tree(&lights);
    for i in 0..500 {
        let (along, beside) = (600.0 * (number(&[40, i]) - 0.5), 12.0 * (number(&[41, i]) - 0.5));
        let [x, y] = if i % 2 == 0 { [along, beside] } else { [beside, along] };
        let place = AtPoint { position: Vec3A::new(x, y, 0.5), normal: Vec3A::Z, haze: 0.0 };
        let (mut sent, mut squares) = (0.0, 0.0);
        for (index, light) in lights.iter().enumerate() {
            let Some(sample) = light.sample(place.position, [0.5; 2]) else { continue };
            let part = f64::from(sample.radiance.max_element() * place.normal.dot(sample.dir) / sample.pdf);
            sent += part;
            squares += part * part / f64::from(tree.probability(&place, index as u32));
        }
        // Relative second moment of one choice: 1 of the best one.
        assert!(squares / (sent * sent) < 1.7, "{place:?}: {}", squares / (sent * sent));
    }
}

#[test]
fn lights_in_one_spot_without_power_and_without_end_are_no_trouble() {
    let ball =
        |power: f32| Light::Sphere(Sphere::new(Vec3A::ONE, 0.1, emission(Sides::One, Profile::Lambertian, power)));
    let lights: Vec<Light> = (0..3000).map(|i| ball(if i % 3 == 0 { 0.0 } else { 1.0 })).collect();
    let tree = tree(&lights);
    let place = AtPoint { position: Vec3A::ZERO, normal: Vec3A::ZERO, haze: 0.0 };
    for i in 0..100 {
        let (light, probability) = tree.choose(&place, f64::from(i) / 100.0).expect("lights");
        assert!(light % 3 != 0 && (probability * 2000.0 - 1.0).abs() < 0.1, "{light} {probability}");
        assert_eq!(tree.probability(&place, light), probability);
    }
    assert_eq!(tree.probability(&place, 0), 0.0);
    assert!(LightTree::new(&[]).choose(&place, 0.5).is_none());
    let endless = LightBounds { low: Vec3A::ZERO, high: Vec3A::INFINITY, power: 1.0, cone: EmissionCone::ALL };
    assert!(LightTree::new(&[endless]).is_empty());
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
