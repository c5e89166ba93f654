//! Procedural test images: a lit ball, and strokes over it.

use femc_math::hash::combine;
use femc_stylize::ChannelImage;

/// Hashes words to a number in 0..1.
pub fn hash_to_unit(words: &[u64]) -> f32 {
    (combine(words) >> 40) as f32 / (1 << 24) as f32
}

/// Makes guides of a ball on a table: its light, its direct light and its highlight, with a little noise.
/// - `middle`: center of the ball, as fractions of width and height.
pub fn guides(width: u32, height: u32, middle: [f32; 2], seed: u64) -> ChannelImage {
    let radius = 0.3 * width.min(height) as f32;
    let mut values = Vec::new();
    for (y, x) in (0..height).flat_map(|y| (0..width).map(move |x| (y, x))) {
        let (u, v) = (x as f32 - middle[0] * width as f32, y as f32 - middle[1] * height as f32);
        let (u, v) = (u / radius, v / radius);
        let inside = 1.0 - u * u - v * v;
        let cosine = if inside > 0.0 { (0.5 * inside.sqrt() - 0.6 * u - 0.6 * v).max(0.0) } else { 0.0 };
        let table = 0.2 + 0.4 * y as f32 / height as f32;
        let direct = if inside > 0.0 { cosine } else { table };
        let noise = 0.02 * hash_to_unit(&[seed, x.into(), y.into()]);
        values.extend([(0.1 + 0.8 * direct + noise).min(1.0), direct.min(1.0), cosine.powi(8).min(1.0)]);
    }
    ChannelImage::new(width, height, 3, values).expect("an image")
}

/// Makes a painting of guides: their light as a color, and diagonal strokes.
pub fn style(guides: &ChannelImage) -> ChannelImage {
    let (width, height) = (guides.width() as u32, guides.height() as u32);
    let mut values = Vec::new();
    for (y, x) in (0..height).flat_map(|y| (0..width).map(move |x| (y, x))) {
        let light = guides.pixel(x as usize, y as usize)[0];
        let stroke = 0.25 * hash_to_unit(&[7, u64::from(x + y) / 3, u64::from(x) / 11]);
        values.extend([light * 0.7 + stroke, light * 0.5 + stroke, 0.6 - 0.4 * light + stroke]);
    }
    ChannelImage::new(width, height, 3, values).expect("an image")
}
