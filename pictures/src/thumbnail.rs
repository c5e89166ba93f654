//! Thumbnails. Each pixel is the mean of a block: of radiances where they are known, otherwise of display values.

use femc_film::{FilmError, Image, Picture, ToneCurve};

/// Makes a thumbnail of an image, with automatic exposure and at most `rows` rows.
pub fn from_image(image: &Image, rows: u32) -> Result<Vec<u8>, FilmError> {
    let (width, height) = thumbnail_size(image.width, image.height, rows);
    let pixels = block_means((image.width, image.height), (width, height), |at| {
        // A value that is not finite would spoil the whole block.
        image.pixels[at].map(|value| if value.is_finite() { f64::from(value) } else { 0.0 })
    });
    let small = Image { width, height, pixels: pixels.into_iter().map(|mean| mean.map(|v| v as f32)).collect() };
    ToneCurve::auto([&small]).picture(&small).to_png()
}

/// Makes a thumbnail of a PNG file that the farm wrote, with at most `rows` rows.
pub fn from_picture(png: &[u8], rows: u32) -> Result<Vec<u8>, FilmError> {
    let picture = Picture::from_png(png)?;
    let (width, height) = thumbnail_size(picture.width, picture.height, rows);
    let pixels = block_means((picture.width, picture.height), (width, height), |at| picture.pixels[at].map(f64::from));
    let pixels = pixels.into_iter().map(|mean| mean.map(|value| value.round() as u8)).collect();
    Picture { width, height, pixels }.to_png()
}

/// Returns the columns and rows of a thumbnail with the same aspect ratio, never more than the image has.
fn thumbnail_size(width: u32, height: u32, rows: u32) -> (u32, u32) {
    if height <= rows {
        return (width, height);
    }
    let columns = u64::from(width) * u64::from(rows) / u64::from(height.max(1));
    (columns.clamp(1, u64::from(width.max(1))) as u32, rows)
}

/// Returns the mean of each block of pixels. Block sizes differ by at most one pixel.
fn block_means(from: (u32, u32), to: (u32, u32), pixel: impl Fn(usize) -> [f64; 3]) -> Vec<[f64; 3]> {
    let bound = |place: u32, small: u32, large: u32| (u64::from(place) * u64::from(large) / u64::from(small)) as u32;
    let mut out = Vec::with_capacity(to.0 as usize * to.1 as usize);
    for y in 0..to.1 {
        let rows = bound(y, to.1, from.1)..bound(y + 1, to.1, from.1);
        for x in 0..to.0 {
            let columns = bound(x, to.0, from.0)..bound(x + 1, to.0, from.0);
            let count = f64::from(rows.end - rows.start) * f64::from(columns.end - columns.start);
            let mut sum = [0.0; 3];
            for at in rows.clone().flat_map(|y| columns.clone().map(move |x| (y, x))) {
                let value = pixel(at.0 as usize * from.0 as usize + at.1 as usize);
                (0..3).for_each(|channel| sum[channel] += value[channel]);
            }
            out.push(sum.map(|sum| sum / count.max(1.0)));
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_thumbnail_keeps_aspect_and_mean_and_is_never_larger() {
        assert_eq!(
            [thumbnail_size(640, 360, 90), thumbnail_size(32, 32, 90), thumbnail_size(3, 1000, 10)],
            [(160, 90), (32, 32), (1, 10)]
        );
        let pixels = (0..6 * 4).map(|at| [at as u8; 3]).collect();
        let png = Picture { width: 6, height: 4, pixels }.to_png().unwrap();
        let small = Picture::from_png(&from_picture(&png, 2).unwrap()).unwrap();
        assert_eq!((small.width, small.height), (3, 2));
        // The first block has the values 0, 1, 6 and 7.
        assert_eq!(small.pixels[0], [4; 3]);
        assert!(from_picture(b"no PNG", 2).is_err());
        let black = Image::filled(5, 5, [f32::NAN, f32::INFINITY, 0.0]);
        assert!(from_image(&black, 2).is_ok(), "what is not finite counts as black");
    }
}
