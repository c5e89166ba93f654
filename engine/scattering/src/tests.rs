//! Tests of the laws that every member obeys. Random numbers are hashes of fixed keys. Levels are divided by the number of tests.

use crate::bsdf::Example;
use crate::fresnel::dielectric;
use crate::{Bsdf, LobeKind, MaterialParameters, Phase, Sides, Transmitted};
use femc_math::glam::{DVec3, Vec3A};
use femc_math::hash::{combine, unit_f32};
use femc_math::{Frame, Rgb, warp};
use femc_stats::testing::chi2::Cells;
use femc_stats::testing::{assert_covers, sidak, sphere_test};

/// Chance of a false alarm of one whole test function.
const LEVEL: f64 = 1e-3;

/// Returns a uniform number in [0, 1) from a key.
pub(crate) fn uniform(key: &[u64]) -> f32 {
    unit_f32((combine(key) >> 32) as u32)
}

fn uniform_pair(seed: u64, i: u64) -> [f32; 2] {
    [uniform(&[seed, i, 1]), uniform(&[seed, i, 2])]
}

fn gray(x: f32) -> Rgb {
    Rgb::splat(x)
}

/// Returns every member, at several roughnesses, with colors that differ by channel, and the index of the inside.
fn members() -> Vec<(String, Bsdf, f32)> {
    let bsdf = |it: Example| (it.name, Bsdf::from_parameters(&it.parameters), it.inside);
    Example::all().into_iter().map(bsdf).collect()
}

/// Returns viewing directions on both sides, from the pole to grazing.
fn views() -> Vec<Vec3A> {
    [1.0f32, 0.7, 0.25, 0.03].into_iter().flat_map(|c| [warp::direction(c, 0.13), -warp::direction(c, 0.4)]).collect()
}

fn random_direction(seed: u64, i: u64) -> Vec3A {
    warp::sphere(uniform_pair(seed, i))
}

#[test]
fn every_member_is_in_the_laws() {
    assert_covers(include_str!("bsdf/mod.rs"), "Bsdf", &["Black"], members().into_iter().map(|(_, bsdf, _)| bsdf));
    assert_covers(include_str!("phase/mod.rs"), "Phase", &[], phases());
}

#[test]
fn members_are_the_cheapest_that_have_the_parameters() {
    let p = MaterialParameters::default();
    let of = |p: MaterialParameters| Bsdf::from_parameters(&p);
    assert!(matches!(of(p), Bsdf::Black));
    assert!(matches!(of(MaterialParameters { rd: gray(0.5), ior: Some((1.5, 0.0)), ..p }), Bsdf::Diffuse(_)));
    assert!(matches!(of(MaterialParameters { rs: gray(0.5), ..p }), Bsdf::Mirror(_)));
    assert!(matches!(of(MaterialParameters { rs: gray(0.5), rs_alpha: 0.1, ..p }), Bsdf::Opaque(_)));
    assert!(matches!(of(MaterialParameters { ts: gray(0.5), ior: Some((1.5, 0.0)), ..p }), Bsdf::Sheet(_)));
    let solid = MaterialParameters { ts: gray(0.5), sides: Sides::One, ..p };
    assert!(matches!(of(solid), Bsdf::Sheet(_)), "without an index nothing is bent");
    assert!(matches!(of(MaterialParameters { ior: Some((1.5, 0.0)), ..solid }), Bsdf::Dielectric(_)));
    assert!(matches!(of(MaterialParameters { ior: Some((0.2, 3.0)), ..solid }), Bsdf::Sheet(_)), "not a conductor");
}

#[test]
fn what_is_diffuse_and_what_is_glossy_is_all() {
    for (name, bsdf, _) in members() {
        let gloss = match bsdf {
            Bsdf::Dielectric(b) => Bsdf::Dielectric(b.without_diffuse()),
            other => other.without_lambertian(),
        };
        for (wo, i) in views().into_iter().flat_map(|wo| (0..200).map(move |i| (wo, i))) {
            let wi = random_direction(77, i);
            let (all, share) = (bsdf.eval(wo, wi), bsdf.diffuse_share(wo, wi));
            assert!(share.min_element() >= 0.0 && share.max_element() <= 1.0, "{name}: {share}");
            let rest = all * (Rgb::ONE - share) - gloss.eval(wo, wi);
            assert!(rest.abs().max_element() <= 2e-6 * all.max_element(), "{name} {wo} {wi}: {rest} of {all}");
        }
    }
}

#[test]
fn samples_follow_the_density() {
    let cases: Vec<_> = members()
        .into_iter()
        .filter(|(_, bsdf, _)| !bsdf.is_delta_only())
        .flat_map(|(name, bsdf, _)| views().into_iter().map(move |wo| (name.clone(), bsdf, wo)))
        .filter(|(name, _, wo)| wo.z > 0.0 || !name.starts_with("one-sided"))
        .collect();
    let level = sidak(LEVEL, cases.len());
    for (k, (name, bsdf, wo)) in cases.iter().enumerate() {
        // For narrow lobes, the pole of the cells is at the mirror direction, so that the peak is at the border of a row of cells.
        // Otherwise the pole is at the normal, so that the horizon is a border.
        let narrow = name.ends_with("0.02");
        if narrow && wo.z.abs() < 0.1 {
            continue; // The horizon cuts the lobe where neither choice has a border.
        }
        let frame = Frame::from_normal(if narrow { Vec3A::new(-wo.x, -wo.y, wo.z) } else { Vec3A::Z });
        let world = |d: [f64; 3]| frame.to_world(Vec3A::new(d[0] as f32, d[1] as f32, d[2] as f32)).normalize();
        let result = sphere_test(
            |d| f64::from(bsdf.pdf(*wo, world(d))),
            |i| {
                let key = k as u64;
                let sample = bsdf.sample(*wo, uniform_pair(key, i), uniform(&[key, i, 3]))?;
                let d = frame.to_local(sample.wi);
                (sample.lobe != LobeKind::Delta).then_some([f64::from(d.x), f64::from(d.y), f64::from(d.z)])
            },
            Cells::default(),
            40_000,
        );
        if dielectric(wo.z.abs(), 1.0 / 1.5).reflectance == 1.0 && result.integral == 0.0 {
            // Total reflection of smooth glass leaves nothing for other lobes, and no sample came from them.
            assert_eq!(result.stray, 0, "{name}, wo {wo}");
            continue;
        }
        result.expect(level, &format!("{name}, wo {wo}"));
    }
}

#[test]
fn sample_weight_is_value_over_pdf_and_sides_are_correct() {
    for (k, (name, bsdf, n)) in members().into_iter().enumerate() {
        for wo in views() {
            for i in 0..2000 {
                let key = 1000 + k as u64;
                let Some(s) = bsdf.sample(wo, uniform_pair(key, i), uniform(&[key, i, 3])) else { continue };
                assert!((s.wi.length() - 1.0).abs() < 1e-4 && s.weight.min_element() >= 0.0, "{name} {wo}: {s:?}");
                assert!(s.pdf > 0.0 && s.pdf.is_finite() && s.weight.is_finite(), "{name} {wo}: {s:?}");
                assert_eq!(s.transmitted == Transmitted::Yes, s.wi.z * wo.z < 0.0, "{name} {wo}: {s:?}");
                let index = |z: f32| if z > 0.0 { 1.0 } else { n };
                let eta = if bsdf.is_refractive() { index(s.wi.z) / index(wo.z) } else { 1.0 };
                assert!((s.eta - eta).abs() < 1e-6, "{name} {wo}: {s:?}");
                if s.lobe == LobeKind::Delta {
                    continue;
                }
                let (value, pdf) = (bsdf.eval(wo, s.wi), bsdf.pdf(wo, s.wi));
                assert!((s.pdf / pdf - 1.0).abs() < 1e-3, "{name} {wo}: {s:?} against pdf {pdf}");
                let close = (s.weight - value / pdf).abs().max_element() <= 1e-3 * s.weight.max_element();
                assert!(close, "{name} {wo}: {s:?} against {value} / {pdf}");
            }
        }
    }
}

impl Bsdf {
    fn is_refractive(&self) -> bool {
        matches!(self, Self::Dielectric(_))
    }
}

#[test]
fn reciprocity_holds() {
    for (k, (name, bsdf, n)) in members().into_iter().enumerate() {
        if name.starts_with("one-sided") {
            continue; // The front scatters light that the back, which does not exist, cannot send.
        }
        let mut seen = 0;
        for i in 0..4000 {
            let wo = random_direction(2000 + k as u64, 2 * i);
            // Half of the partners are near the specular directions, where narrow lobes are not zero.
            let wi = match bsdf.sample(wo, uniform_pair(k as u64, i), uniform(&[k as u64, i, 4])) {
                Some(s) if s.lobe == LobeKind::Glossy => s.wi,
                _ => random_direction(2000 + k as u64, 2 * i + 1),
            };
            if wo.z.abs().min(wi.z.abs()) < 0.02 {
                continue;
            }
            let index = |z: f32| if z > 0.0 { 1.0 } else { n };
            let there = bsdf.eval(wo, wi) / (wi.z.abs() * index(wo.z) * index(wo.z));
            let back = bsdf.eval(wi, wo) / (wo.z.abs() * index(wi.z) * index(wi.z));
            let scale = there.max_element().max(1e-3);
            assert!((there - back).abs().max_element() <= 4e-3 * scale, "{name}: {wo} {wi}: {there} {back}");
            seen += usize::from(there.max_element() > 0.0);
        }
        assert!(bsdf.is_delta_only() || seen > 500, "{name}: only {seen} pairs scatter");
    }
}

/// Returns the mean weight of `n^3` stratified samples with the square of the index removed, which is the directional albedo, and
/// an upper bound of its standard error.
pub(crate) fn furnace(bsdf: &Bsdf, wo: Vec3A, key: u64, n: u64) -> (Rgb, f32) {
    let (mut sum, mut sum2) = (DVec3::ZERO, 0.0f64);
    for i in 0..n * n * n {
        let jitter = [0, 1, 2].map(|d| uniform(&[key, i, d]));
        let cell = [i % n, i / n % n, i / n / n];
        let [a, b, c] = [0, 1, 2].map(|d| ((cell[d] as f32 + jitter[d]) / n as f32).min(1.0 - f32::EPSILON / 2.0));
        if let Some(s) = bsdf.sample(wo, [a, b], c) {
            let weight = (s.weight * s.eta * s.eta).as_dvec3();
            sum += weight;
            sum2 += weight.max_element() * weight.max_element();
        }
    }
    let count = (n * n * n) as f64;
    ((sum / count).as_vec3a(), ((sum2 / count).sqrt() / count.sqrt()) as f32)
}

#[test]
fn no_member_creates_energy() {
    for (k, (name, bsdf, _)) in members().into_iter().enumerate() {
        for wo in views() {
            let (albedo, error) = furnace(&bsdf, wo, 3000 + k as u64, 16);
            assert!(albedo.max_element() <= 1.0 + 3.0 * error, "{name} {wo}: {albedo} +- {error}");
            // The reported albedo ignores the loss of single scattering. It is an upper bound, and close for smooth members.
            let reported = bsdf.albedo(wo);
            let rough = name.ends_with("0.4") || name.ends_with(" 1") || (bsdf.is_refractive() && !bsdf.has_delta());
            let tolerance = if name.ends_with(|c: char| c.is_ascii_digit()) { 0.05 } else { 2e-3 };
            if bsdf.sample(wo, [0.5; 2], 0.5).is_some() && !rough && wo.z.abs() > 0.1 {
                let miss = (reported - albedo).abs().max_element();
                assert!(miss < tolerance + 3.0 * error, "{name} {wo}: {reported} reported, {albedo} measured");
            }
        }
    }
}

/// The share of light from all directions is the mean of the shares by direction, as samples find them.
#[test]
fn hemispherical_albedo_is_the_mean_by_direction() {
    for (k, (name, bsdf, _)) in members().into_iter().enumerate() {
        if !matches!(bsdf, Bsdf::Opaque(_)) {
            continue;
        }
        let cosines = (0..24).map(|k| ((k as f32 + 0.5) / 24.0).sqrt());
        let sums = cosines.map(|cos| furnace(&bsdf, warp::direction(cos, 0.13), 7000 + k as u64, 16));
        let (mean, error) =
            sums.fold((Rgb::ZERO, 0.0f32), |(mean, error), (albedo, e)| (mean + albedo / 24.0, error + e));
        let found = bsdf.hemispherical_albedo();
        let miss = (found - mean).abs().max_element();
        assert!(miss < 0.01 + 3.0 * error / 24.0, "{name}: {found} instead of {mean}");
        let (diffuse, transmitted) = bsdf.diffuse_albedos();
        let expected = if bsdf.has_delta() { diffuse.min(found) } else { found };
        assert!(diffuse == expected && transmitted == Rgb::ZERO, "{name}: {diffuse} of {found}");
    }
}

#[test]
fn white_surface_without_rough_specular_keeps_all_energy() {
    let p = MaterialParameters::default();
    let ior = Some((1.5, 0.0));
    for (name, p) in [
        ("white", MaterialParameters { rd: gray(1.0), ..p }),
        ("mirror", MaterialParameters { rs: gray(1.0), ..p }),
        ("half mirror", MaterialParameters { rd: gray(0.5), rs: gray(0.5), ..p }),
        ("sheet", MaterialParameters { rd: gray(0.25), td: gray(0.25), rs: gray(0.25), ts: gray(0.25), ..p }),
        ("glass", MaterialParameters { ts: gray(1.0), ior, sides: Sides::One, ..p }),
        ("opal", MaterialParameters { ts: gray(0.4), rd: gray(0.3), td: gray(0.3), ior, sides: Sides::One, ..p }),
    ] {
        let bsdf = Bsdf::from_parameters(&p);
        for wo in views() {
            let (albedo, error) = furnace(&bsdf, wo, 77, 16);
            // Two per mille for the quadrature of the mean reflectance.
            assert!((albedo - gray(1.0)).abs().max_element() < 2e-3 + 3.0 * error, "{name} {wo}: {albedo} +- {error}");
        }
    }
}

#[test]
fn the_diffuse_part_gets_what_the_specular_part_leaves() {
    let bsdf = Bsdf::from_parameters(&MaterialParameters {
        rd: gray(0.6),
        rs: gray(0.4),
        ior: Some((1.5, 0.0)),
        ..MaterialParameters::default()
    });
    for wo in views() {
        let f = dielectric(wo.z.abs(), 1.5).reflectance * 0.4;
        let (albedo, error) = furnace(&bsdf, wo, 5, 16);
        assert!((albedo.x - (f + 0.6 * (1.0 - f))).abs() < 2e-3 + 3.0 * error, "{wo}: {albedo}");
    }
}

#[test]
fn the_plain_model_is_the_textbook_formula() {
    // f cos = rd cos / pi + rs D G2 / (4 cos_o), in double precision and with the usual forms of D and Lambda.
    let (rd, rs, alpha) = (0.25f64, 0.6f64, 0.15f64);
    let bsdf = Bsdf::from_parameters(&MaterialParameters {
        rd: gray(rd as f32),
        rs: gray(rs as f32),
        rs_alpha: alpha as f32,
        ..MaterialParameters::default()
    });
    for i in 0..2000 {
        let (a, b) = (random_direction(9, 2 * i), random_direction(9, 2 * i + 1));
        let (wo, wi) = (Vec3A::new(a.x, a.y, a.z.abs().max(0.02)), Vec3A::new(b.x, b.y, b.z.abs().max(0.02)));
        let (wo, wi) = (wo.normalize(), wi.normalize());
        let (o, w) = (wo.as_dvec3(), wi.as_dvec3());
        let h = (o + w).normalize();
        let tan2 = 1.0 / (h.z * h.z) - 1.0;
        let d = 1.0 / (std::f64::consts::PI * alpha * alpha * h.z.powi(4) * (1.0 + tan2 / (alpha * alpha)).powi(2));
        let lambda = |c: f64| 0.5 * ((1.0 + alpha * alpha * (1.0 / (c * c) - 1.0)).sqrt() - 1.0);
        let g2 = 1.0 / (1.0 + lambda(o.z) + lambda(w.z));
        let expected = rd / std::f64::consts::PI * w.z + rs * d * g2 / (4.0 * o.z);
        let found = f64::from(bsdf.eval(wo, wi).x);
        assert!((found / expected - 1.0).abs() < 1e-4, "{wo} {wi}: {found} against {expected}");
        let below = bsdf.eval(-wo, Vec3A::new(wi.x, wi.y, -wi.z));
        assert!((below - bsdf.eval(Vec3A::new(-wo.x, -wo.y, wo.z), wi)).length() < 1e-6, "alike on both sides");
        assert_eq!(bsdf.eval(wo, -wi), Rgb::ZERO, "opaque");
    }
}

#[test]
fn smooth_glass_obeys_snell_and_rough_glass_tends_to_it() {
    let p =
        MaterialParameters { ts: gray(1.0), ior: Some((1.5, 0.0)), sides: Sides::One, ..MaterialParameters::default() };
    let smooth = Bsdf::from_parameters(&p);
    let rough = Bsdf::from_parameters(&MaterialParameters { ts_alpha: 2e-3, ..p });
    assert!(smooth.is_delta_only() && !rough.has_delta());
    for wo in views() {
        let n = if wo.z > 0.0 { 1.5f32 } else { 1.0 / 1.5 };
        let f = dielectric(wo.z.abs(), n).reflectance;
        let through = smooth.sample(wo, [0.2, 0.6], 0.999_999).expect("glass absorbs nothing");
        if f < 1.0 {
            assert_eq!(through.transmitted, Transmitted::Yes);
            assert!((through.wi.x * n + wo.x).abs() < 1e-6 && (through.wi.y * n + wo.y).abs() < 1e-6);
            assert!((through.weight.x * n * n - 1.0).abs() < 1e-5, "chosen by F, the weight is the index factor alone");
        } else {
            assert_eq!(through.transmitted, Transmitted::No, "total internal reflection");
        }
        if wo.z.abs() > 0.2 && (f - 1.0).abs() > 1e-3 {
            let near = rough.sample(wo, [0.2, 0.6], 0.999_999).expect("the ray hits a facet");
            assert!((near.wi - through.wi).length() < 0.02, "{wo}: {near:?} {through:?}");
        }
    }
}

#[test]
fn sheets_do_not_refract_and_transmit_the_mirrored_lobe() {
    let p = MaterialParameters { rs: gray(0.4), ts: gray(0.4), ..MaterialParameters::default() };
    let clear = Bsdf::from_parameters(&MaterialParameters { rs: gray(0.0), ior: Some((1.5, 0.0)), ..p });
    let rough = Bsdf::from_parameters(&MaterialParameters { rs_alpha: 0.3, ts_alpha: 0.3, ..p });
    for (i, wo) in views().into_iter().enumerate() {
        let s = clear.sample(wo, [0.1, 0.2], 0.3).expect("clear");
        assert_eq!((s.wi, s.weight, s.eta), (-wo, gray(0.4), 1.0), "rs and ts as they stand");
        let wi = random_direction(4, i as u64);
        let mirrored = Vec3A::new(wi.x, wi.y, -wi.z);
        assert_eq!(rough.eval(wo, wi), rough.eval(wo, mirrored));
    }
}

#[test]
fn a_one_sided_surface_does_nothing_behind() {
    let p = MaterialParameters {
        sides: Sides::One,
        rd: gray(0.3),
        rs: gray(0.3),
        td: gray(0.2),
        ..MaterialParameters::default()
    };
    for bsdf in [p, MaterialParameters { td: gray(0.0), ..p }, MaterialParameters { rs: gray(0.0), td: gray(0.0), ..p }]
    {
        let bsdf = Bsdf::from_parameters(&bsdf);
        let (front, back) = (Vec3A::new(0.6, 0.0, 0.8), Vec3A::new(0.6, 0.0, -0.8));
        assert!(bsdf.sample(front, [0.3; 2], 0.9).is_some() && bsdf.sample(back, [0.3; 2], 0.9).is_none());
        assert_eq!((bsdf.eval(back, back), bsdf.pdf(back, back)), (Rgb::ZERO, 0.0));
    }
}

#[test]
fn bsdf_is_finite_at_grazing_tiny_roughness_and_sample_corners() {
    let p = MaterialParameters { rd: gray(0.2), rs: gray(0.4), ..MaterialParameters::default() };
    let edge = [0.0f32, 1e-7, 0.5, 1.0 - f32::EPSILON / 2.0];
    let mut drawn = 0;
    for alpha in [0.0f32, 5e-5, 1.01e-4, 1e-3, 1.0] {
        let materials = [
            MaterialParameters { rs_alpha: alpha, ..p },
            MaterialParameters { rs_alpha: alpha, ior: Some((1.5, 0.0)), ..p },
            MaterialParameters { rs_alpha: alpha, ior: Some((0.1, 5.0)), ..p },
            MaterialParameters { ts: gray(0.4), ts_alpha: alpha, rs_alpha: alpha, ..p },
            MaterialParameters { ts: gray(0.4), ts_alpha: alpha, ior: Some((1.5, 0.0)), sides: Sides::One, ..p },
            MaterialParameters { ts: gray(0.4), ts_alpha: alpha, ior: Some((1.0 + 1e-6, 0.0)), sides: Sides::One, ..p },
        ];
        for bsdf in materials.map(|m| Bsdf::from_parameters(&m)) {
            for cos in [1.0f32, 1e-3, 1e-7, 1e-20] {
                for wo in [warp::direction(cos, 0.0), -warp::direction(cos, 0.3)] {
                    for key in 0..64usize {
                        let [a, b, c] = [edge[key % 4], edge[key / 4 % 4], edge[key / 16]];
                        let Some(s) = bsdf.sample(wo, [a, b], c) else { continue };
                        drawn += 1;
                        assert!(s.wi.is_finite() && s.weight.is_finite() && s.pdf.is_finite() && s.pdf > 0.0, "{s:?}");
                        assert!(s.weight.max_element() < 1e4, "{bsdf:?} {wo} {s:?}");
                        assert!(bsdf.eval(wo, s.wi).is_finite() && bsdf.pdf(wo, s.wi).is_finite());
                    }
                }
            }
            let flat = Vec3A::X;
            assert!(bsdf.sample(flat, [0.5; 2], 0.5).is_none_or(|s| s.weight.is_finite()));
            assert!(bsdf.eval(flat, Vec3A::Z).is_finite() && bsdf.eval(Vec3A::Z, flat).is_finite());
        }
    }
    assert!(drawn > 10_000);
}

fn phases() -> Vec<Phase> {
    let mut list = vec![Phase::Isotropic, Phase::Rayleigh];
    for x in [-0.9f32, -0.3, 0.0, 1e-4, 0.5, 0.85, 0.99] {
        list.extend([Phase::HenyeyGreenstein { g: x }, Phase::Schlick { k: x }]);
    }
    list
}

#[test]
fn phase_samples_match_the_phase_function_and_its_mean_cosine() {
    let level = sidak(LEVEL, phases().len());
    for (k, phase) in phases().into_iter().enumerate() {
        let wo = random_direction(6, k as u64);
        let frame = Frame::from_normal(-wo);
        let world = |d: [f64; 3]| frame.to_world(Vec3A::new(d[0] as f32, d[1] as f32, d[2] as f32)).normalize();
        let (n, mut sum, mut sum2) = (60_000u64, 0.0f64, 0.0f64);
        let result = sphere_test(
            |d| f64::from(phase.pdf(wo, world(d))),
            |i| {
                let s = phase.sample(wo, uniform_pair(500 + k as u64, i));
                assert_eq!(s.pdf, phase.eval(wo, s.wi));
                let d = frame.to_local(s.wi);
                sum += f64::from(d.z);
                sum2 += f64::from(d.z) * f64::from(d.z);
                Some([f64::from(d.x), f64::from(d.y), f64::from(d.z)])
            },
            Cells::default(),
            n,
        );
        result.expect(level, &format!("{phase:?}"));
        assert!((result.integral - 1.0).abs() < 1e-3, "{phase:?}: {}", result.integral);
        let mean = sum / n as f64;
        let error = ((sum2 / n as f64 - mean * mean) / n as f64).sqrt();
        assert!(
            (mean - f64::from(phase.mean_cosine())).abs() < 4.5 * error,
            "{phase:?}: mean cosine {mean} +- {error}"
        );
    }
}

#[test]
fn positive_parameters_scatter_forward_along_the_propagation() {
    let wo = Vec3A::Z; // The ray came along -z; straight through is wi = -z.
    for phase in [Phase::HenyeyGreenstein { g: 0.7 }, Phase::Schlick { k: 0.7 }] {
        assert!(phase.eval(wo, -Vec3A::Z) > 10.0 * phase.eval(wo, Vec3A::Z));
    }
}
