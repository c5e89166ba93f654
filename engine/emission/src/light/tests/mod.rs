//! Tests of laws that hold for every light. Random numbers are hashes of fixed keys; levels are divided by the number of tests.

mod closed_forms;
mod density;
mod tracer;

use super::*;
use crate::{AngularProfile, Emission, EmittingSides, IntensityDistribution, PhotometryKind};
use femc_math::Frame;
use femc_math::hash::{combine, unit_f32};
use femc_stats::testing::assert_covers;
use std::sync::Arc;
use tracer::Patch;

/// Probability of a false alarm of one whole test function.
const LEVEL: f64 = 1e-3;

fn uniform_pair(seed: u64, i: u64) -> [f32; 2] {
    [0, 1].map(|d| unit_f32((combine(&[seed, i, d]) >> 32) as u32))
}

fn emission(sides: EmittingSides) -> Emission {
    Emission { emittance: Rgb::new(3.0, 2.0, 1.0), profile: AngularProfile::Lambertian, sides }
}

fn v(x: f32, y: f32, z: f32) -> Vec3A {
    Vec3A::new(x, y, z)
}

/// Makes an intensity that changes with both angles and is nowhere zero.
fn distribution() -> Arc<IntensityDistribution> {
    let vertical: Vec<f64> = (0..=12).map(|i| f64::from(i) * 15.0).collect();
    let horizontal = [0.0, 45.0, 90.0];
    let candela: Vec<f64> = horizontal
        .iter()
        .flat_map(|h| vertical.iter().map(move |v| 100.0 + 50.0 * v.to_radians().cos() + 0.2 * h))
        .collect();
    Arc::new(IntensityDistribution::new(PhotometryKind::C, &vertical, &horizontal, &candela).expect("a valid table"))
}

fn luminaire(solid: Solid) -> PhotometricSolid {
    let frame = Frame::from_normal(v(0.48, 0.6, 0.64));
    PhotometricSolid {
        center: v(0.3, -0.2, 1.0),
        axes: [frame.tangent, frame.bitangent, frame.normal],
        solid,
        distribution: distribution(),
        tint: Rgb::ONE,
    }
}

/// The point has no surface; `closed_forms` has its laws.
#[test]
fn every_kind_of_light_is_in_the_laws() {
    let lights = cases().into_iter().map(|case| case.light);
    assert_covers(include_str!("../mod.rs"), "Light", &["PhotometricPoint"], lights);
}

/// A light and its surface in the form of the reference tracer.
struct Case {
    name: &'static str,
    light: Light,
    patches: Vec<Patch>,
}

/// Makes every kind of light about the origin, about a meter in size.
fn cases() -> Vec<Case> {
    let (one, two) = (emission(EmittingSides::One), emission(EmittingSides::Two));
    let lobe = Emission { profile: AngularProfile::Lobe { exponent: 6.0 }, ..one };
    let mut list = Vec::new();
    let mut add = |name, light, patches| list.push(Case { name, light, patches });

    let [a, b, c] = [v(-0.5, -0.6, 0.1), v(0.9, -0.2, 0.0), v(0.1, 0.8, 0.3)];
    add("triangle", Light::Triangle(Triangle::new([a, b, c], one)), vec![Patch::Triangle([a, b, c])]);
    add("lobed triangle", Light::Triangle(Triangle::new([a, b, c], lobe)), vec![Patch::Triangle([a, b, c])]);
    for (name, o, p, q, e) in [
        ("rectangle", v(-0.6, -0.5, 0.0), v(1.2, 0.0, 0.0), v(0.0, 1.0, 0.0), two),
        ("skew parallelogram", v(-0.6, -0.5, 0.0), v(1.2, 0.1, 0.2), v(0.3, 0.9, -0.2), one),
    ] {
        add(name, Light::Parallelogram(Parallelogram::new(o, p, q, e)), Patch::parallelogram(o, p, q));
    }
    let center = v(0.1, 0.2, -0.1);
    for (name, radius, e) in [("sphere", 0.7, one), ("two-sided sphere", 0.7, two), ("hollow sphere", -0.7, one)] {
        add(name, Light::Sphere(Sphere::new(center, radius, e)), vec![Patch::Sphere { center, radius }]);
    }
    let (base, top) = (v(-0.1, 0.0, -0.5), v(0.1, 0.1, 0.5));
    for (name, radii, e) in [("cone", [0.6, 0.2], one), ("cylinder", [0.4, 0.4], two), ("funnel", [-0.1, -0.6], one)] {
        let light = Light::Cone(Cone::new(base, radii[0], top, radii[1], e));
        add(name, light, vec![Patch::Cone { base, top, radii }]);
    }
    let (center, normal) = (v(0.0, 0.1, 0.0), v(0.48, 0.6, 0.64));
    let ring = Light::Ring(Ring::new(center, normal, 0.3, 0.8, one));
    add("ring", ring, vec![Patch::Ring { center, normal, radii: [0.3, 0.8] }]);
    let torus = Light::Torus(Torus::new(center, normal, 0.4, 0.8, one));
    add("torus", torus, vec![Patch::Torus { center, axis: normal, radii: [0.4, 0.8] }]);
    for (name, solid) in [
        ("box luminaire", Solid::cuboid(0.5, 0.9, 0.3)),
        ("flat luminaire", Solid::cuboid(0.5, 0.9, 0.0)),
        ("drum luminaire", Solid::cylinder(0.6, 0.4)),
        ("ball luminaire", Solid::sphere(0.8)),
    ] {
        let light = luminaire(solid);
        let patches = light.faces().iter().flat_map(Patch::from_face).collect();
        add(name, Light::PhotometricSolid(light), patches);
    }
    list
}
