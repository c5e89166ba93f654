//! Tests of samples against densities. The density over directions is evaluated at the hits of the reference tracer, over a fine
//! grid of the cone about the light. Silhouettes do not follow cell borders; with the fine grid they cost only a per mille.

use super::*;
use femc_math::warp;
use femc_stats::testing::chi2::pooled_test;
use femc_stats::testing::sidak;

/// Number of cells of the cone, by 1 - cos and by azimuth.
const CELLS: usize = 12;
const SAMPLES: u64 = 10_000;

/// Points that a light can sample. Lights sampled by area also draw hidden points; those sampled by direction draw only the
/// nearest.
#[derive(Clone, Copy, PartialEq)]
enum SampledPoints {
    All,
    Nearest,
}

fn sampled_points(light: &Light) -> SampledPoints {
    match light {
        Light::Cone(_) | Light::Torus(_) => SampledPoints::All,
        Light::PhotometricSolid(l) if matches!(l.solid, Solid::Cylinder { .. }) => SampledPoints::All,
        _ => SampledPoints::Nearest,
    }
}

/// Computes the density of `sample` in direction `dir`: the sum over the points that it can draw there.
fn density(case: &Case, reference: Vec3A, dir: Vec3A) -> f64 {
    let shining = tracer::crossings(&case.patches, reference.as_dvec3(), dir.as_dvec3())
        .into_iter()
        .filter(|(_, n)| case.light.radiance(-dir, n.as_vec3a()) != Rgb::ZERO)
        .map(|(t, n)| {
            let position = (reference.as_dvec3() + dir.as_dvec3() * t).as_vec3a();
            f64::from(case.light.pdf(reference, position, n.as_vec3a(), dir))
        });
    match sampled_points(&case.light) {
        SampledPoints::All => shining.sum(),
        SampledPoints::Nearest => shining.take(1).sum(),
    }
}

/// Returns the cone about the directions of a light's samples: axis and 1 - cos of the half angle, with a margin.
fn sample_cone(light: &Light, reference: Vec3A) -> Option<(Frame, f32)> {
    let frame = Frame::from_normal((light.center() - reference).normalize_or(Vec3A::Z));
    let widest = (0..4000)
        .filter_map(|i| light.sample(reference, uniform_pair(99, i)))
        .map(|s| 1.0 - s.dir.dot(frame.normal))
        .fold(None, |widest: Option<f32>, x| Some(widest.map_or(x, |w| w.max(x))));
    widest.map(|w| (frame, (1.1 * w).clamp(1e-9, 2.0)))
}

#[test]
fn samples_follow_the_density_from_near_far_and_inside() {
    let references = [v(0.2, -0.3, 1.9), v(2.5, 1.0, 1.2), v(-0.4, -3.0, -2.0), v(0.15, 0.2, 0.05), v(0.31, -0.2, 2.0)];
    let level = sidak(LEVEL, 2 * cases().len() * references.len());
    for (k, case) in cases().iter().enumerate() {
        let mut lit = 0;
        for (j, &reference) in references.iter().enumerate() {
            let what = format!("{} from {reference}", case.name);
            let Some((frame, widest)) = sample_cone(&case.light, reference) else { continue };
            lit += 1;
            let cell = |x: f32, azimuth: f32| {
                let row = ((x / widest * CELLS as f32) as usize).min(CELLS - 1);
                row * CELLS + ((azimuth * CELLS as f32) as usize).min(CELLS - 1)
            };
            let mut expected = vec![0.0; CELLS * CELLS];
            // Grid points along a cell. More are needed where the density is singular at the silhouette, like 1 / cos.
            let fine = CELLS
                * match sampled_points(&case.light) {
                    SampledPoints::All => 44,
                    SampledPoints::Nearest => 20,
                };
            let solid_angle = TAU * f64::from(widest) / (fine * fine) as f64;
            for i in 0..fine * fine {
                let at = |i: usize| (i as f32 + 0.5) / fine as f32;
                let (x, azimuth) = (widest * at(i / fine), at(i % fine));
                let dir = frame.to_world(warp::direction(1.0 - x, azimuth)).normalize();
                expected[cell(x, azimuth)] += solid_angle * density(case, reference, dir);
            }
            let mut observed = vec![0u64; CELLS * CELLS];
            for i in 0..SAMPLES {
                let Some(s) = case.light.sample(reference, uniform_pair((k * 16 + j) as u64, i)) else { continue };
                let d = frame.to_local(s.dir);
                let azimuth = (d.y.atan2(d.x) / std::f32::consts::TAU).rem_euclid(1.0);
                observed[cell((1.0 - d.z).max(0.0), azimuth)] += 1;
            }
            let integral: f64 = expected.iter().sum();
            let drawn: u64 = observed.iter().sum();
            // The density lacks the share of failed samples (drawn on the dark side). Allow 1 % for the grid, and the noise.
            let share = drawn as f64 / SAMPLES as f64;
            let noise = 4.0 * (share * (1.0 - share) / SAMPLES as f64).sqrt();
            assert!((integral - share).abs() < 0.01 + noise, "{what}: density {integral}, share drawn {share}");
            // Cells where the grid expects almost nothing are left out. In the others, the grid's own error is far below the noise
            // of the counts.
            for (e, o) in expected.iter_mut().zip(&mut observed) {
                if *e * (SAMPLES as f64) < 0.5 {
                    (*e, *o) = (0.0, 0);
                }
            }
            let kept: u64 = observed.iter().sum();
            assert!(drawn - kept < 30, "{what}: {} samples where there is no density", drawn - kept);
            let scale = kept as f64 / expected.iter().sum::<f64>();
            let counts: Vec<f64> = expected.iter().map(|e| e * scale).collect();
            let result = pooled_test(&counts, &observed);
            assert!(result.p >= level, "{what}: {result:?}");
        }
        assert!(lit >= 2, "{} is lit from {lit} references only", case.name);
    }
}

#[test]
fn sample_fields_agree_with_each_other_and_the_later_density() {
    for (k, case) in cases().iter().enumerate() {
        let mut seen = 0;
        for i in 0..3000 {
            let key = 700 + k as u64;
            let reference = (warp::sphere(uniform_pair(key, 2 * i)) * 2.0).as_dvec3() * f64::from(1 + (i % 5) as u8);
            let reference = reference.as_vec3a();
            let Some(s) = case.light.sample(reference, uniform_pair(key, 2 * i + 1)) else { continue };
            seen += 1;
            let what = format!("{} from {reference}: {s:?}", case.name);
            assert!((s.dir.length() - 1.0).abs() < 1e-5 && (s.normal.length() - 1.0).abs() < 1e-5, "{what}");
            assert!((reference + s.dir * s.distance - s.position).length() < 2e-6 * (1.0 + s.distance), "{what}");
            let pdf = case.light.pdf(reference, s.position, s.normal, s.dir);
            assert!((pdf / s.pdf - 1.0).abs() < 1e-3, "{what}: asked later {pdf}");
            let radiance = case.light.radiance(-s.dir, s.normal);
            assert!((radiance - s.radiance).length() < 1e-4 * radiance.length(), "{what}: asked later {radiance}");
            let (low, high) = case.light.bounds();
            let slack = Vec3A::splat(1e-5);
            assert!(
                s.position.cmpge(low - slack).all() && s.position.cmple(high + slack).all(),
                "{what}: {low} {high}"
            );
            let error = f64::from(s.error.max_element());
            assert!(error > 0.0 && error < 1e-5, "{what}");
            let near = tracer::crossings(&case.patches, reference.as_dvec3(), s.dir.as_dvec3())
                .iter()
                .any(|(t, n)| (t - f64::from(s.distance)).abs() < 1e-3 && n.distance(s.normal.as_dvec3()) < 2e-2);
            let grazing = s.dir.dot(s.normal).abs() < 0.02;
            assert!(near || grazing || case.name == "torus", "{what}: not on the surface");
        }
        assert!(seen > 300, "{}: only {seen} samples", case.name);
    }
}

#[test]
fn dark_sides_of_one_sided_lights_have_no_samples_or_density() {
    let one = emission(EmittingSides::One);
    let behind = v(0.1, 0.0, -1.0);
    for light in [
        Light::Triangle(Triangle::new([v(0.0, 0.0, 0.0), v(1.0, 0.0, 0.0), v(0.0, 1.0, 0.0)], one)),
        Light::Parallelogram(Parallelogram::new(Vec3A::ZERO, Vec3A::X, Vec3A::Y, one)),
        Light::Ring(Ring::new(Vec3A::ZERO, Vec3A::Z, 0.0, 1.0, one)),
    ] {
        let point = v(0.2, 0.2, 0.0);
        let (up, down) = ((point - behind).normalize(), (point - v(0.1, 0.0, 1.0)).normalize());
        for i in 0..100 {
            assert_eq!(light.sample(behind, uniform_pair(3, i)), None);
            assert_eq!(light.sample(v(0.3, 0.2, 0.0), uniform_pair(3, i)), None, "in the plane of the light");
            assert!(light.sample(v(0.1, 0.0, 1.0), uniform_pair(3, i)).is_some());
        }
        assert_eq!(light.pdf(behind, point, Vec3A::Z, up), 0.0);
        assert!(light.pdf(v(0.1, 0.0, 1.0), point, Vec3A::Z, down) > 0.0);
    }
    let outward = Light::Sphere(Sphere::new(Vec3A::ZERO, 1.0, one));
    assert_eq!(outward.sample(v(0.3, 0.0, 0.0), [0.5; 2]), None, "inside a lamp that shines outward");
    let inward = Light::Sphere(Sphere::new(Vec3A::ZERO, -1.0, one));
    let far = inward.sample(v(3.0, 0.0, 0.0), [0.3; 2]).expect("seen through its transparent near wall");
    assert!(far.position.x < 0.0 && far.distance > 3.0);
}
