//! Image textures: bilinear lookup, repeated over the plane.

use femc_math::Rgb;
use femc_math::glam::Vec2;
use std::sync::Arc;

/// A texture. v points up; row 0 of the image is at the top.
#[derive(Clone, Debug)]
pub struct Texture {
    width: u32,
    height: u32,
    pixels: Arc<Vec<Rgb>>,
    brightest: f32,
}

impl Texture {
    /// Creates a texture from an image's pixels; an empty image gives a white 1 x 1 texture.
    pub fn new(image: &femc_scene::Image) -> Self {
        let expected = image.width as usize * image.height as usize;
        if expected == 0 || image.pixels.len() != expected {
            return Self { width: 1, height: 1, pixels: Arc::new(vec![Rgb::ONE]), brightest: 1.0 };
        }
        let pixels: Vec<Rgb> = image.pixels.iter().map(|&p| Rgb::from_array(p)).collect();
        let brightest = pixels.iter().map(|pixel| pixel.max_element()).fold(0.0, f32::max);
        Self { width: image.width, height: image.height, pixels: Arc::new(pixels), brightest }
    }

    /// Returns the greatest value of a channel.
    pub fn brightest(&self) -> f32 {
        self.brightest
    }

    fn texel(&self, x: i64, y: i64) -> Rgb {
        let (x, y) = (x.rem_euclid(i64::from(self.width)), y.rem_euclid(i64::from(self.height)));
        self.pixels[(y * i64::from(self.width) + x) as usize]
    }

    /// Returns the value at `uv`, bilinear between texel centers.
    pub fn lookup(&self, uv: Vec2) -> Rgb {
        let x = uv.x * self.width as f32 - 0.5;
        let y = (1.0 - uv.y) * self.height as f32 - 0.5;
        let (x0, y0) = (x.floor(), y.floor());
        let (fx, fy) = (x - x0, y - y0);
        let (ix, iy) = (x0 as i64, y0 as i64);
        let top = self.texel(ix, iy) * (1.0 - fx) + self.texel(ix.saturating_add(1), iy) * fx;
        let bottom = self.texel(ix, iy.saturating_add(1)) * (1.0 - fx)
            + self.texel(ix.saturating_add(1), iy.saturating_add(1)) * fx;
        top * (1.0 - fy) + bottom * fy
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_texel_center_gives_its_texel_and_v_points_up() {
        let image = femc_scene::Image {
            path: String::new(),
            width: 2,
            height: 2,
            pixels: vec![[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 1.0, 1.0]],
        };
        let texture = Texture::new(&image);
        assert_eq!(texture.lookup(Vec2::new(0.25, 0.75)), Rgb::new(1.0, 0.0, 0.0));
        assert_eq!(texture.lookup(Vec2::new(0.75, 0.25)), Rgb::ONE);
        assert_eq!(texture.lookup(Vec2::new(1.25, -0.25)), Rgb::new(1.0, 0.0, 0.0));
        assert_eq!(texture.lookup(Vec2::new(0.5, 0.5)), Rgb::new(0.5, 0.5, 0.5));
    }
}
