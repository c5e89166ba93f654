//! Materials: what crosses a surface, and textures.

use super::midpoints;
use crate::material::{Crossing, KernelMaterial, Orientation, mapped_normal};
use crate::texture::Texture;
use femc_math::Rgb;
use femc_math::glam::{Vec2, Vec3A};
use femc_scene::{Image, Ior, Material, MediumId, Sides, TintedScalar};

fn tinted(amount: f64, color: [f64; 3]) -> TintedScalar {
    TintedScalar { amount, color }
}

#[test]
fn clear_sheets_transmit_their_tint() {
    let gray = KernelMaterial::new(&Material { rd: tinted(0.5, [1.0; 3]), ..Material::default() });
    assert_eq!(gray.crossing, [Crossing::Scatter; 2]);
    assert_eq!(gray.crossing[0].straight_through(), Rgb::ZERO);
    assert_eq!(gray.orientation, Orientation::TowardViewer);
    let pane = Material {
        sides: Sides::Two,
        ts: tinted(0.5, [0.4, 1.0, 1.2]),
        rd: tinted(0.1, [1.0; 3]),
        ..Material::default()
    };
    let pane = KernelMaterial::new(&pane);
    for side in pane.crossing {
        let Crossing::Clear { tint } = side else { panic!("{side:?}") };
        assert!((tint - Rgb::new(0.2, 0.5, 0.6)).abs().max_element() < 1e-6, "{tint}");
        assert_eq!(side.straight_through(), tint);
    }
}

#[test]
fn interfaces_that_only_bound_a_medium_do_not_scatter() {
    let matched = Material {
        sides: Sides::One,
        ior: Some(Ior { re: 1.0, im: 0.0 }),
        ts: tinted(0.8, [1.0; 3]),
        inside: Some(MediumId(3)),
        ..Material::default()
    };
    let kernel = KernelMaterial::new(&matched);
    for side in kernel.crossing {
        assert!(matches!(side, Crossing::Null { tint } if (tint.x - 0.8).abs() < 1e-6), "{side:?}");
    }
    assert_eq!((kernel.interior_medium, kernel.orientation), (Some(3), Orientation::Front));
    let glass = KernelMaterial::new(&Material { ior: Some(Ior { re: 1.5, im: 0.0 }), ..matched.clone() });
    assert!(glass.crossing.iter().all(|side| !matches!(side, Crossing::Null { .. })), "glass bends light");
    assert_eq!(glass.orientation, Orientation::Front);
    // A one-sided surface with a medium behind it is crossed from behind.
    let shell =
        KernelMaterial::new(&Material { ior: None, ts: tinted(0.0, [1.0; 3]), rd: tinted(0.5, [1.0; 3]), ..matched });
    assert_eq!(shell.crossing, [Crossing::Scatter, Crossing::Null { tint: Rgb::ONE }]);
}

#[test]
fn parameters_are_products_of_amount_and_color() {
    let material = Material { rd: tinted(0.5, [0.2, 1.0, 1.6]), rs_alpha: 0.25, ..Material::default() };
    let kernel = KernelMaterial::new(&material);
    assert!((kernel.parameters.rd - Rgb::new(0.1, 0.5, 0.8)).abs().max_element() < 1e-6, "{}", kernel.parameters.rd);
    assert_eq!(kernel.parameters.rs_alpha, 0.25);
    let negative = KernelMaterial::new(&Material { rd: tinted(0.5, [-1.0, 0.5, 0.5]), ..Material::default() });
    assert_eq!(negative.parameters.rd.x, 0.0);
}

fn image(width: u32, height: u32) -> Image {
    let pixel = |k: u32| [(k % width) as f32, (k / width) as f32, (k * k % 7) as f32];
    Image { path: String::new(), width, height, pixels: (0..width * height).map(pixel).collect() }
}

/// Bilinear value by the definition: a sum over all texels of tent functions, repeated over the plane.
#[test]
fn textures_are_sums_of_tents() {
    let picture = image(5, 3);
    let texture = Texture::new(&picture);
    for u in midpoints(13).map(|u| 3.0 * u - 1.2) {
        for v in midpoints(11).map(|v| 3.0 * v - 1.3) {
            let mut want = [0.0f64; 3];
            for (k, pixel) in (0u32..).zip(&picture.pixels) {
                let center = [(f64::from(k % 5) + 0.5) / 5.0, 1.0 - (f64::from(k / 5) + 0.5) / 3.0];
                let tent = |x: f64, size: f64| (1.0 - (x - x.round()).abs() * size).max(0.0);
                let weight = tent(u - center[0], 5.0) * tent(v - center[1], 3.0);
                want.iter_mut().zip(pixel).for_each(|(sum, x)| *sum += weight * f64::from(*x));
            }
            let found = texture.lookup(Vec2::new(u as f32, v as f32));
            let off = found.to_array().into_iter().zip(want).map(|(a, b)| (f64::from(a) - b).abs()).fold(0.0, f64::max);
            assert!(off < 1e-4, "{u} {v}: {found}, not {want:?}");
        }
    }
    assert_eq!(texture.brightest(), 4.0);
    let white = Texture::new(&Image { pixels: Vec::new(), ..picture });
    assert_eq!((white.lookup(Vec2::new(0.3, 0.8)), white.brightest()), (Rgb::ONE, 1.0), "an image without pixels");
}

#[test]
fn textures_scale_the_diffuse_share_alone_and_at_most_by_one() {
    let kernel = KernelMaterial::new(&Material { rd: tinted(0.5, [1.0; 3]), ..Material::default() });
    let albedo = |texel: Rgb| kernel.textured_bsdf(texel).albedo(Vec3A::Z);
    assert!((albedo(Rgb::new(0.2, 0.5, 4.0)) - Rgb::new(0.1, 0.25, 0.5)).abs().max_element() < 1e-6);
    assert_eq!(albedo(Rgb::splat(-1.0)), Rgb::ZERO);
}

#[test]
fn normal_maps_tilt_the_normal_in_the_frame_of_the_texture() {
    let map = |texel: [f32; 3]| Texture::new(&Image { path: String::new(), width: 1, height: 1, pixels: vec![texel] });
    let tilted = |texel| mapped_normal(Vec3A::Z, Vec3A::X * 3.0, &map(texel), Vec2::new(0.5, 0.5));
    assert!(tilted([0.0, 0.0, 1.0]).distance(Vec3A::Z) < 1e-5, "the texel of a flat map");
    assert!(tilted([0.6, 0.0, 0.8]).distance(Vec3A::new(0.6, 0.0, 0.8)) < 1e-5, "along u");
    assert!(tilted([0.0, 0.6, 0.8]).distance(Vec3A::new(0.0, 0.6, 0.8)) < 1e-5, "along v");
}
