//! Comparison of two pictures in numbers.

use crate::planes::decode_file;
use femc_film::metrics::{Comparison, ExcludedPixels};
use femc_film::{FilmError, Image, compare_images, exr};
use femc_paths::pixels::Pixel;
use femc_service::PictureSource;
use serde_json::{Value, json};
use std::io::Cursor;

/// A picture, and whether its values are luminances.
struct Compared {
    image: Image,
    is_luminance: bool,
}

/// Compares a picture A with a picture B, and writes the errors of A against B as JSON. The picture of a statistics file is the mean
/// luminance of its samples. If one of the pictures is such a picture, the luminances of both are compared.
/// - errors: the fault of a source.
pub fn compare_pictures(pictures: [PictureSource; 2]) -> Result<Vec<u8>, String> {
    let [a, b] = pictures.map(read);
    let compared = [a.map_err(|error| format!("A: {error}"))?, b.map_err(|error| format!("B: {error}"))?];
    Ok(compare(compared).to_string().into_bytes())
}

fn read(picture: PictureSource) -> Result<Compared, FilmError> {
    match picture {
        PictureSource::Image(bytes) => {
            Ok(Compared { image: exr::decode(Cursor::new(bytes))?.image, is_luminance: false })
        }
        PictureSource::Statistics(bytes) => {
            let maps = decode_file(&bytes)?;
            let gray = |pixel: Pixel| [pixel.luminance as f32; 3];
            let pixels = maps.pixels().map(gray).collect();
            Ok(Compared { image: Image { width: maps.film[0], height: maps.film[1], pixels }, is_luminance: true })
        }
        PictureSource::Preview(_) | PictureSource::Parts(..) => {
            Err(FilmError::Corrupt("only finished frames can be compared"))
        }
    }
}

fn compare(pictures: [Compared; 2]) -> Value {
    let is_luminance = pictures.iter().any(|it| it.is_luminance);
    let images = pictures.map(|it| if is_luminance && !it.is_luminance { to_gray(&it.image) } else { it.image });
    let [a, b] = &images;
    let sizes = json!([[a.width, a.height], [b.width, b.height]]);
    let compared = if is_luminance { "luminance" } else { "color" };
    match compare_images(a, b) {
        Err(error) => json!({ "compared": compared, "films": sizes, "fault": error.to_string() }),
        Ok(Comparison { mse, relmse, psnr, ssim, flip, mean_ratio, worst, excluded }) => {
            let ExcludedPixels { image, reference, pixels } = excluded;
            json!({
                "compared": compared,
                "films": sizes,
                "fault": null,
                "mean": images.each_ref().map(mean_luminance),
                "mean_ratio": mean_ratio,
                "mse": mse,
                "relmse": relmse,
                "psnr": psnr.is_finite().then_some(psnr),
                "ssim": ssim,
                "flip": flip,
                "worst_pixel": { "x": worst.x, "y": worst.y },
                "excluded": { "a": image, "b": reference, "pixels": pixels },
            })
        }
    }
}

fn to_gray(image: &Image) -> Image {
    let pixels = (0..image.pixels.len()).map(|at| [image.luminance(at); 3]).collect();
    Image { width: image.width, height: image.height, pixels }
}

/// Returns the mean luminance of the pixels with finite values, cd/m2.
fn mean_luminance(image: &Image) -> f64 {
    let finite = (0..image.pixels.len()).map(|at| f64::from(image.luminance(at))).filter(|value| value.is_finite());
    let (sum, count) = finite.fold((0.0, 0u32), |(sum, count), value| (sum + value, count + 1));
    sum / f64::from(count.max(1))
}
