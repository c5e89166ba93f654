//! Media along rays: transmittance, distances, events and glow.

use super::midpoints;
use crate::media::{DensityProfile, DistanceSample, KernelMedium, Media, MediaRay, MediumStack};
use femc_math::Rgb;
use femc_math::glam::{Affine3A, Quat, Vec3A};
use femc_scattering::Phase;

fn medium(sigma_s: [f32; 3], sigma_t: [f32; 3]) -> KernelMedium {
    KernelMedium {
        sigma_s: sigma_s.into(),
        sigma_t: sigma_t.into(),
        glow: Rgb::ZERO,
        phase: Phase::Isotropic,
        profile: DensityProfile::Uniform,
    }
}

fn gray(sigma_s: f32, sigma_t: f32) -> KernelMedium {
    medium([sigma_s; 3], [sigma_t; 3])
}

/// Fog of scale height 2 m above a height of 1 m.
fn valley_fog() -> KernelMedium {
    KernelMedium { profile: DensityProfile::Height { z0: 1.0, inverse_scale: 0.5 }, ..gray(0.3, 0.4) }
}

fn ray_in(media: &Media, origin: Vec3A, dir: Vec3A, length: f32, stack: &MediumStack) -> MediaRay {
    let mut ray = MediaRay::default();
    media.find_intervals(origin, dir, length, stack, &mut ray);
    ray
}

fn ray(media: &Media, origin: Vec3A, dir: Vec3A, length: f32) -> MediaRay {
    ray_in(media, origin, dir, length, &MediumStack::default())
}

/// A cube of edge 2 around the origin, turned about z by 45 degrees.
fn turned_cube() -> Media {
    let mut media = Media::new(vec![gray(0.5, 0.5)], false);
    let to_local = Affine3A::from_quat(Quat::from_rotation_z(std::f32::consts::FRAC_PI_4));
    media.fill_box(0, to_local, Vec3A::NEG_ONE, Vec3A::ONE);
    media
}

#[test]
fn transmittance_of_a_turned_box_follows_its_chord() {
    let media = turned_cube();
    let root = 2.0f64.sqrt();
    for (y, chord) in [(0.0, 2.0 * root), (0.7, 2.0 * (root - 0.7)), (1.5, 0.0)] {
        let found = media.transmittance(&ray(&media, Vec3A::new(-5.0, y, 0.3), Vec3A::X, f32::INFINITY)).x;
        assert!((f64::from(found) - (-0.5 * chord).exp()).abs() < 1e-5, "{y}: {found}");
    }
    // A segment that begins inside and ends inside.
    let found = media.transmittance(&ray(&media, Vec3A::ZERO, Vec3A::Z, 0.25)).x;
    assert!((f64::from(found) - (-0.125f64).exp()).abs() < 1e-6, "{found}");
    let mut none = MediaRay::default();
    assert!(!media.find_intervals(Vec3A::new(-5.0, 1.5, 0.0), Vec3A::X, 100.0, &MediumStack::default(), &mut none));
}

#[test]
fn overlapping_media_add_up_and_gaps_are_clear() {
    let mut media = Media::new(vec![gray(0.5, 0.5), medium([0.1, 0.2, 0.3], [0.2, 0.4, 0.6])], false);
    let slab = |media: &mut Media, index, from: f32, to: f32| {
        media.fill_box(index, Affine3A::IDENTITY, Vec3A::new(from, -9.0, -9.0), Vec3A::new(to, 9.0, 9.0));
    };
    slab(&mut media, 0, 0.0, 2.0);
    slab(&mut media, 1, 1.0, 3.0);
    slab(&mut media, 0, 5.0, 6.0);
    let found = media.transmittance(&ray(&media, Vec3A::new(-1.0, 0.0, 0.0), Vec3A::X, 100.0));
    for (found, sigma) in found.to_array().into_iter().zip([0.2f64, 0.4, 0.6]) {
        let want = (-(0.5 * 3.0 + sigma * 2.0)).exp();
        assert!((f64::from(found) / want - 1.0).abs() < 1e-5, "{found}, not {want}");
    }
    let at = |x: f32| media.extinction_color_at(Vec3A::new(x, 0.0, 0.0)).z;
    assert_eq!([-0.5, 0.5, 1.5, 2.5, 4.0, 5.5].map(at), [0.0, 0.5, 1.1, 0.6, 0.0, 0.5]);
    assert_eq!(media.scattering_at(Vec3A::new(1.5, 0.0, 0.0)), Rgb::new(0.6, 0.7, 0.8));
    // Only fog that is gray and everywhere is uniform.
    assert_eq!(media.uniform_extinction(), None);
    let mut everywhere = Media::new(vec![gray(0.1, 0.25)], false);
    everywhere.fill_everywhere(0);
    assert_eq!(everywhere.uniform_extinction(), Some(0.25));
}

/// Optical depth by quadrature, as a function of the height.
fn depth_by_quadrature(z: f64, dz: f64, length: f64) -> f64 {
    const STEPS: u32 = 100_000;
    let density = |t: f64| (-((z + dz * t * length - 1.0) * 0.5).max(0.0)).exp();
    0.4 * length / f64::from(STEPS) * midpoints(STEPS).map(density).sum::<f64>()
}

#[test]
fn fog_that_thins_out_has_the_depth_of_the_quadrature() {
    let mut media = Media::new(vec![valley_fog()], false);
    media.fill_everywhere(0);
    for (z, dz, length) in
        [(0.0, 0.6, 9.0), (8.0, -0.6, 20.0), (0.5, 0.0, 3.0), (4.0, 0.0, 3.0), (3.0, 1e-5, 10.0), (40.0, -1.0, 45.0)]
    {
        let x = (1.0f64 - dz * dz).sqrt();
        let dir = Vec3A::new(x as f32, 0.0, dz as f32);
        let found = media.transmittance(&ray(&media, Vec3A::new(7.0, 2.0, z as f32), dir, length as f32)).y;
        let want = (-depth_by_quadrature(z, dz, length)).exp();
        assert!((f64::from(found) - want).abs() < 2e-5, "{z} {dz} {length}: {found}, not {want}");
    }
    assert!((media.extinction_at(Vec3A::new(0.0, 0.0, 3.0)) - 0.4 * (-1.0f32).exp()).abs() < 1e-6);
}

/// The distance for `u` has the optical depth -ln(1 - u).
#[test]
fn distances_are_sampled_by_inverting_the_optical_depth() {
    let mut media = Media::new(vec![valley_fog()], false);
    media.fill_everywhere(0);
    let (z, dz) = (0.2, 0.8);
    let along = ray(&media, Vec3A::new(0.0, 0.0, z as f32), Vec3A::new(0.6, 0.0, dz as f32), 30.0);
    let end = 1.0 - (-depth_by_quadrature(z, dz, 30.0)).exp();
    let mut scattered = 0;
    for u in midpoints(40) {
        match media.sample_distance(&along, u, 0.5) {
            DistanceSample::Scatter(event) => {
                scattered += 1;
                let depth = depth_by_quadrature(z, dz, f64::from(event.t));
                assert!((depth + (1.0 - u).ln()).abs() < 2e-4, "{u}: a depth of {depth}");
                let density = 0.4 * (-((z + dz * f64::from(event.t) - 1.0) * 0.5).max(0.0)).exp();
                assert!((f64::from(event.pdf) / (density * (1.0 - u)) - 1.0).abs() < 1e-3, "{u}: {}", event.pdf);
                assert!((event.weight.x - 0.75).abs() < 1e-4, "the albedo: {}", event.weight);
                let at = media.event_at(&along, event.t).expect("fog");
                assert!((at.pdf / event.pdf - 1.0).abs() < 1e-4);
            }
            DistanceSample::Through { weight } => {
                assert!(u > end - 1e-4 && (weight - Rgb::ONE).abs().max_element() < 1e-4, "{u} {weight}");
            }
        }
    }
    assert_eq!(scattered, midpoints(40).filter(|&u| u < end).count());
}

/// Over all distances and channels, the weights have the scattered light in the mean, and those that pass the transmittance.
#[test]
fn colored_distances_are_unbiased() {
    let (sigma_s, sigma_t) = ([0.1f64, 0.5, 0.9], [0.2f64, 0.5, 1.5]);
    let mut media = Media::new(vec![medium(sigma_s.map(|x| x as f32), sigma_t.map(|x| x as f32))], false);
    media.fill_box(0, Affine3A::IDENTITY, Vec3A::ZERO, Vec3A::splat(2.0));
    let along = ray(&media, Vec3A::new(-1.0, 1.0, 1.0), Vec3A::X, 10.0);
    const COUNT: u32 = 3000;
    let (mut scattered, mut through) = ([0.0f64; 3], [0.0f64; 3]);
    for u in midpoints(COUNT) {
        for channel in [0.1, 0.4, 0.9] {
            let (sum, weight) = match media.sample_distance(&along, u, channel) {
                DistanceSample::Scatter(event) => (&mut scattered, event.weight),
                DistanceSample::Through { weight } => (&mut through, weight),
            };
            sum.iter_mut().zip(weight.to_array()).for_each(|(sum, x)| *sum += f64::from(x) / f64::from(3 * COUNT));
        }
    }
    for channel in 0..3 {
        let passed = (-2.0 * sigma_t[channel]).exp();
        let want = sigma_s[channel] / sigma_t[channel] * (1.0 - passed);
        assert!((scattered[channel] - want).abs() < 2e-3, "{channel}: {}, not {want}", scattered[channel]);
        assert!((through[channel] - passed).abs() < 2e-3, "{channel}: {}, not {passed}", through[channel]);
    }
}

/// Gas that absorbs alone dims what passes, but stops no path.
#[test]
fn absorbing_gas_has_no_events() {
    let mut media = Media::new(vec![gray(0.0, 0.7)], false);
    media.fill_everywhere(0);
    let along = ray(&media, Vec3A::ZERO, Vec3A::X, 2.0);
    let DistanceSample::Through { weight } = media.sample_distance(&along, 0.999, 0.5) else { panic!("an event") };
    assert!((f64::from(weight.x) - (-1.4f64).exp()).abs() < 1e-6, "{weight}");
    assert!(media.event_at(&along, 1.0).is_none() && media.scattering_range(&along).is_none());
    assert!(media.scattering_bounds(femc_geometry::Aabb { min: Vec3A::ZERO, max: Vec3A::ONE }).is_none());
}

#[test]
fn glow_is_the_integral_of_emission_times_transmittance() {
    let mut media = Media::new(vec![KernelMedium { glow: Rgb::new(3.0, 2.0, 1.0), ..gray(0.1, 0.6) }], false);
    media.fill_box(0, Affine3A::IDENTITY, Vec3A::ZERO, Vec3A::splat(4.0));
    assert!(media.glows());
    let found = media.emitted_radiance(&ray(&media, Vec3A::new(1.0, 1.0, -2.0), Vec3A::Z, 5.0), 0.5);
    let want: f64 = midpoints(10_000).map(|t| (-0.6 * 3.0 * t).exp() * 3.0 / 10_000.0).sum();
    for (found, glow) in found.to_array().into_iter().zip([3.0, 2.0, 1.0]) {
        assert!((f64::from(found) / (glow * want) - 1.0).abs() < 1e-4, "{found}");
    }
    // Dark fog of 2 m before it.
    let mut behind = Media::new(vec![gray(0.1, 0.3), media.medium(0).clone()], false);
    behind.fill_box(1, Affine3A::IDENTITY, Vec3A::ZERO, Vec3A::splat(4.0));
    behind.fill_box(0, Affine3A::IDENTITY, Vec3A::new(0.0, 0.0, -2.0), Vec3A::new(4.0, 4.0, 0.0));
    let dimmed = behind.emitted_radiance(&ray(&behind, Vec3A::new(1.0, 1.0, -2.0), Vec3A::Z, 5.0), 0.5);
    assert!((f64::from(dimmed.x / found.x) - (-0.6f64).exp()).abs() < 1e-5, "{dimmed} {found}");
    // Glow that varies with the height is sampled at one point. The mean over the points is the integral.
    let mut valley = Media::new(vec![KernelMedium { glow: Rgb::ONE, ..valley_fog() }], false);
    valley.fill_everywhere(0);
    let up = ray(&valley, Vec3A::ZERO, Vec3A::Z, 20.0);
    let found: f64 = midpoints(2000).map(|u| f64::from(valley.emitted_radiance(&up, u as f32).x) / 2000.0).sum();
    let (mut want, mut depth) = (0.0, 0.0);
    for t in midpoints(20_000).map(|t| 20.0 * t) {
        let density = (-((t - 1.0) * 0.5).max(0.0)).exp();
        depth += 0.2e-3 * density;
        want += 1e-3 * density * (0.2e-3 * density - depth).exp().min(1.0);
        depth += 0.2e-3 * density;
    }
    assert!((found / want - 1.0).abs() < 2e-3, "{found}, not {want}");
}

#[test]
fn media_inside_objects_are_entered_and_left_in_any_order() {
    let media = Media::new(vec![gray(0.1, 0.3), gray(0.2, 0.7)], true);
    assert!(!media.is_empty());
    let mut stack = MediumStack::default();
    for medium in [0, 1, 0] {
        stack.push(medium);
    }
    assert_eq!(stack.iter().collect::<Vec<_>>(), [0, 1, 0]);
    let through =
        |stack: &MediumStack| f64::from(media.transmittance(&ray_in(&media, Vec3A::ZERO, Vec3A::X, 2.0, stack)).x);
    assert!((through(&stack) - (-2.6f64).exp()).abs() < 1e-6);
    stack.remove(0);
    assert_eq!(stack.iter().collect::<Vec<_>>(), [0, 1], "the innermost one of two is left");
    stack.remove(0);
    stack.remove(0);
    assert!((through(&stack) - (-1.4f64).exp()).abs() < 1e-6, "leaving what one is not in changes nothing");
    (0..20).for_each(|_| stack.push(1));
    assert_eq!(stack.iter().count(), 8);
}
