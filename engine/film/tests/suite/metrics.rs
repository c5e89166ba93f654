//! Tests of error metrics: hand-computed values, known properties, and images that cannot be compared.

use femc_film::{FilmError, Image, compare_images};
use femc_math::hash;

fn noise(width: u32, height: u32, seed: u64, amount: f32) -> Image {
    let pixel = |i: u64| [0, 1, 2].map(|c| 1.0 + amount * (hash::unit_f32(hash::combine(&[seed, i, c]) as u32) - 0.5));
    Image { width, height, pixels: (0..u64::from(width * height)).map(pixel).collect() }
}

#[test]
fn equal_images_have_no_error_at_all() {
    let image = noise(40, 30, 1, 0.8);
    let c = compare_images(&image, &image).unwrap();
    assert_eq!((c.mse, c.relmse, c.flip, c.mean_ratio), (0.0, 0.0, 0.0, 1.0));
    assert!(c.psnr == f64::INFINITY && (c.ssim - 1.0).abs() < 1e-12);
    assert_eq!((c.worst.relative, c.excluded.pixels), (0.0, 0));
    let black = Image::filled(4, 4, [0.0; 3]);
    let c = compare_images(&black, &black).unwrap();
    assert_eq!((c.relmse, c.flip, c.mean_ratio), (0.0, 0.0, 1.0));
}

#[test]
fn sums_are_those_done_by_hand() {
    let reference = Image { width: 2, height: 1, pixels: vec![[1.0, 2.0, 0.0], [4.0, 4.0, 4.0]] };
    let image = Image { width: 2, height: 1, pixels: vec![[1.5, 2.0, 0.5], [4.0, 3.0, 4.0]] };
    let c = compare_images(&image, &reference).unwrap();
    assert!((c.mse - 1.5 / 6.0).abs() < 1e-12);
    let relative = 0.25 / 1.01 + 0.25 / 0.01 + 1.0 / 16.01;
    assert!((c.relmse - relative / 6.0).abs() < 1e-12);
    assert!((c.psnr - 10.0 * femc_math::elementary::double::log10(16.0 / 0.25)).abs() < 1e-9);
    assert_eq!(c.mean_ratio, 1.0);
    assert_eq!((c.worst.x, c.worst.y, c.worst.value), (0, 0, [1.5, 2.0, 0.5]));
    assert!((c.worst.relative - (0.25 / 1.01 + 25.0) / 3.0).abs() < 1e-9);
}

#[test]
fn more_noise_is_a_larger_error_in_every_metric() {
    let reference = Image::filled(48, 48, [1.0; 3]);
    let steps: Vec<_> =
        [0.1, 0.4, 1.6].map(|amount| compare_images(&noise(48, 48, 9, amount), &reference).unwrap()).to_vec();
    for pair in steps.windows(2) {
        assert!(pair[0].mse < pair[1].mse && pair[0].relmse < pair[1].relmse && pair[0].flip < pair[1].flip);
        assert!(pair[0].psnr > pair[1].psnr && pair[0].ssim > pair[1].ssim);
    }
    assert!(steps.iter().all(|c| (0.0..=1.0).contains(&c.flip) && (-1.0..=1.0).contains(&c.ssim)));
}

#[test]
fn a_brightness_factor_shows_in_the_mean_ratio() {
    let reference = noise(16, 16, 3, 0.5);
    let mut image = reference.clone();
    image.pixels.iter_mut().flatten().for_each(|v| *v *= 1.25);
    assert!((compare_images(&image, &reference).unwrap().mean_ratio - 1.25).abs() < 1e-7);
}

#[test]
fn flip_is_independent_of_the_luminance_unit() {
    let (a, b) = (noise(40, 40, 5, 0.6), noise(40, 40, 6, 0.6));
    let scaled = |i: &Image| Image { pixels: i.pixels.iter().map(|p| p.map(|v| v * 1024.0)).collect(), ..i.clone() };
    let flip = compare_images(&a, &b).unwrap().flip;
    assert!((compare_images(&scaled(&a), &scaled(&b)).unwrap().flip - flip).abs() < 1e-4);
    assert!(flip > 0.01);
}

#[test]
fn pixels_that_are_not_finite_are_counted_and_left_out() {
    let reference = noise(16, 16, 3, 0.5);
    let (mut image, mut odd) = (noise(16, 16, 4, 0.5), reference.clone());
    image.pixels[3] = reference.pixels[3];
    image.pixels[7] = reference.pixels[7];
    let clean = compare_images(&image, &reference).unwrap();
    image.pixels[3][1] = f32::NAN;
    odd.pixels[7][0] = f32::INFINITY;
    let c = compare_images(&image, &odd).unwrap();
    assert_eq!((c.excluded.image, c.excluded.reference, c.excluded.pixels), (1, 1, 2));
    assert!((c.mse * 254.0 - clean.mse * 256.0).abs() < 1e-9, "the two equal pixels had no error");
    assert!([c.relmse, c.psnr, c.ssim, c.flip, c.mean_ratio].iter().all(|v| v.is_finite()));
    let nothing = Image::filled(2, 2, [f32::NAN; 3]);
    assert!(matches!(compare_images(&nothing, &nothing), Err(FilmError::NothingToCompare)));
}

#[test]
fn images_of_different_sizes_are_refused() {
    let error = compare_images(&noise(4, 3, 1, 0.1), &noise(3, 4, 1, 0.1)).unwrap_err();
    assert_eq!(error.to_string(), "the image sizes differ: 4x3 and 3x4");
}
