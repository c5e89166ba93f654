//! Paper or canvas at twice the picture's size, and strokes on it.

use femc_film::Picture;

/// Canvas pixels per picture pixel along each axis.
pub const SUPERSAMPLING: usize = 2;

/// A point of a stroke, in picture pixels.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Dab {
    /// Column.
    pub x: f32,
    /// Row.
    pub y: f32,
    /// Half the width of the stroke at the point.
    pub radius: f32,
}

/// A canvas pixel that a stroke covers.
#[derive(Clone, Copy, Debug)]
pub struct CoveredPixel {
    /// Index of the canvas pixel.
    pub at: usize,
    /// Column in picture pixels.
    pub x: f32,
    /// Row in picture pixels.
    pub y: f32,
    /// Covered fraction of the pixel, 0..1.
    pub cover: f32,
    /// Length of the stroke up to the pixel, in picture pixels.
    pub along: f32,
    /// Position across the stroke, from -1 at one border to 1 at the other.
    pub across: f32,
}

/// Data of a pixel while a stroke covers it.
#[derive(Clone, Copy, Debug, Default)]
struct PixelCoverage {
    cover: f32,
    /// Depth inside the stroke at its nearest point.
    depth: f32,
    along: f32,
    across: f32,
}

/// A canvas. Colors are sRGB in 0..1.
#[derive(Clone, Debug)]
pub struct Canvas {
    /// Columns of the canvas.
    pub width: usize,
    /// Rows of the canvas.
    pub height: usize,
    /// Pixels of the canvas.
    pub pixels: Vec<[f32; 3]>,
    coverage: Vec<PixelCoverage>,
}

impl Canvas {
    /// Creates a canvas for a picture of this size in pixels.
    pub fn new(width: usize, height: usize, paper: [f32; 3]) -> Self {
        let (width, height) = (SUPERSAMPLING * width, SUPERSAMPLING * height);
        Self {
            width,
            height,
            pixels: vec![paper; width * height],
            coverage: vec![PixelCoverage::default(); width * height],
        }
    }

    /// Returns the center of a canvas pixel, in picture pixels.
    pub fn position(&self, at: usize) -> (f32, f32) {
        let center = |n: usize| (n as f32 + 0.5) / SUPERSAMPLING as f32;
        (center(at % self.width), center(at / self.width))
    }

    /// Returns the pixels that a stroke through `dabs` covers, each once, from the top left.
    pub fn covered_pixels(&mut self, dabs: &[Dab]) -> Vec<CoveredPixel> {
        let mut touched = Vec::new();
        let mut along = 0.0;
        let only = dabs.first().map(|dab| [*dab, *dab]);
        let pairs = dabs.windows(2).map(|pair| [pair[0], pair[1]]);
        for [a, b] in pairs.chain(only.filter(|_| dabs.len() == 1)) {
            let (dx, dy) = (b.x - a.x, b.y - a.y);
            let length = (dx * dx + dy * dy).sqrt();
            let most = a.radius.max(b.radius) + 1.0;
            let fine = SUPERSAMPLING as f32;
            let span = |from: f32, to: f32, end: usize| {
                let low = ((from.min(to) - most) * fine).max(0.0) as usize;
                low.min(end)..(((from.max(to) + most) * fine).max(0.0) as usize + 1).min(end)
            };
            for row in span(a.y, b.y, self.height) {
                for column in span(a.x, b.x, self.width) {
                    let at = row * self.width + column;
                    let (x, y) = self.position(at);
                    let (u, v) = (x - a.x, y - a.y);
                    let t = if length > 0.0 { ((u * dx + v * dy) / (length * length)).clamp(0.0, 1.0) } else { 0.0 };
                    let (ox, oy) = (u - t * dx, v - t * dy);
                    let off = (ox * ox + oy * oy).sqrt();
                    let radius = a.radius + t * (b.radius - a.radius);
                    let cover = ((radius - off) * fine + 0.5).clamp(0.0, 1.0);
                    let coverage = &mut self.coverage[at];
                    if cover == 0.0 || (coverage.cover > 0.0 && radius - off <= coverage.depth) {
                        continue;
                    }
                    if coverage.cover == 0.0 {
                        touched.push(at);
                    }
                    let side = if dx * v - dy * u < 0.0 { -1.0 } else { 1.0 };
                    let across = side * (off / radius.max(1e-3)).min(1.0);
                    *coverage = PixelCoverage { cover, depth: radius - off, along: along + t * length, across };
                }
            }
            along += length;
        }
        touched.sort_unstable();
        let touch = |at: usize| {
            let PixelCoverage { cover, along, across, .. } = std::mem::take(&mut self.coverage[at]);
            let (x, y) = ((at % self.width) as f32, (at / self.width) as f32);
            CoveredPixel {
                at,
                x: (x + 0.5) / SUPERSAMPLING as f32,
                y: (y + 0.5) / SUPERSAMPLING as f32,
                cover,
                along,
                across,
            }
        };
        touched.into_iter().map(touch).collect()
    }

    /// Paints the fraction `cover` of a pixel with `color`.
    pub fn blend(&mut self, at: usize, color: [f32; 3], cover: f32) {
        self.pixels[at] = mix(self.pixels[at], color, cover);
    }

    /// Applies ink or glaze: the present color shows through, darkened by `color`.
    pub fn glaze(&mut self, at: usize, color: [f32; 3], cover: f32) {
        let pixel = &mut self.pixels[at];
        (0..3).for_each(|i| pixel[i] *= 1.0 - cover * (1.0 - color[i]));
    }

    /// Computes the distance of each canvas pixel `inside` to the nearest pixel outside, in picture pixels; 0 outside. Counts steps
    /// along rows, columns and diagonals, which makes distances up to 8 % too large.
    pub fn distance_to_border(&self, inside: &[bool]) -> Vec<f32> {
        const DIAGONAL: f32 = std::f32::consts::SQRT_2;
        let (width, height) = (self.width as isize, self.height as isize);
        let mut far: Vec<f32> = inside.iter().map(|&inside| if inside { 1e6 } else { 0.0 }).collect();
        let near = [(-1, 0, 1.0), (0, -1, 1.0), (-1, -1, DIAGONAL), (1, -1, DIAGONAL)];
        for sign in [1, -1] {
            for n in 0..far.len() {
                let at = if sign > 0 { n } else { far.len() - 1 - n };
                let (column, row) = (at as isize % width, at as isize / width);
                for (dx, dy, length) in near {
                    let (x, y) = (column + sign * dx, row + sign * dy);
                    if x >= 0 && x < width && y >= 0 && y < height {
                        far[at] = far[at].min(far[(y * width + x) as usize] + length);
                    }
                }
            }
        }
        far.into_iter().map(|steps| steps / SUPERSAMPLING as f32).collect()
    }

    /// Returns the picture: each pixel is the mean of its canvas pixels.
    pub fn picture(&self) -> Picture {
        let (width, height) = (self.width / SUPERSAMPLING, self.height / SUPERSAMPLING);
        let pixel = |at: usize| {
            let (column, row) = (SUPERSAMPLING * (at % width), SUPERSAMPLING * (at / width));
            let mut sum = [0.0f32; 3];
            for y in row..row + SUPERSAMPLING {
                for x in column..column + SUPERSAMPLING {
                    (0..3).for_each(|i| sum[i] += self.pixels[y * self.width + x][i].clamp(0.0, 1.0));
                }
            }
            sum.map(|s| (255.0 * s / (SUPERSAMPLING * SUPERSAMPLING) as f32 + 0.5) as u8)
        };
        Picture { width: width as u32, height: height as u32, pixels: (0..width * height).map(pixel).collect() }
    }
}

/// Interpolates from `a` to `b`.
pub fn mix(a: [f32; 3], b: [f32; 3], t: f32) -> [f32; 3] {
    std::array::from_fn(|i| a[i] + t * (b[i] - a[i]))
}

/// Smooth step: 0 below `from`, 1 above `to`. `from` may be greater than `to`.
pub fn smoothstep(from: f32, to: f32, x: f32) -> f32 {
    let t = ((x - from) / (to - from)).clamp(0.0, 1.0);
    t * t * (3.0 - 2.0 * t)
}

/// Traces the line that follows a field of directions from `start`, both ways: points `step` apart, as long as `accept` returns
/// true.
/// - `direction`: of any length and either sign; zero where there is none;
/// - `accept`: whether a point, the nth from the start, is part of the line.
pub fn trace_streamline(
    start: [f32; 2],
    step: f32,
    direction: impl Fn(f32, f32) -> [f32; 2],
    mut accept: impl FnMut(f32, f32, usize) -> bool,
) -> Vec<[f32; 2]> {
    let mut line = Vec::new();
    for way in [-1.0, 1.0] {
        let [mut x, mut y] = start;
        let mut last: Option<[f32; 2]> = None;
        for n in 1.. {
            let d = direction(x, y);
            let length = (d[0] * d[0] + d[1] * d[1]).sqrt();
            if length < 1e-6 {
                break;
            }
            let sign = last.map_or(way, |l| if l[0] * d[0] + l[1] * d[1] < 0.0 { -1.0 } else { 1.0 });
            let d = d.map(|c| sign * c / length);
            (x, y, last) = (x + step * d[0], y + step * d[1], Some(d));
            if !accept(x, y, n) {
                break;
            }
            line.push([x, y]);
        }
        if way < 0.0 {
            line.reverse();
            line.push(start);
        }
    }
    line
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_stroke_covers_its_area_and_each_pixel_once() {
        let mut canvas = Canvas::new(40, 20, [1.0; 3]);
        let dabs = [5.0, 20.0, 30.0].map(|x| Dab { x, y: 10.0, radius: 2.0 });
        let touches = canvas.covered_pixels(&dabs);
        assert!(touches.windows(2).all(|pair| pair[0].at < pair[1].at));
        // 25 long and 4 wide with two half circles, in quarters of a pixel.
        let area = touches.iter().map(|touch| touch.cover).sum::<f32>() / (SUPERSAMPLING * SUPERSAMPLING) as f32;
        assert!((area - (100.0 + 4.0 * std::f32::consts::PI)).abs() < 2.0, "{area}");
        let middle = touches.iter().find(|t| (t.x - 22.25).abs() < 0.1 && (t.y - 11.75).abs() < 0.1).unwrap();
        assert!((middle.along - 17.25).abs() < 1e-3 && (middle.across - 0.875).abs() < 1e-3, "{middle:?}");
        // The next stroke is independent of this one.
        assert_eq!(canvas.covered_pixels(&dabs).len(), touches.len());
    }

    #[test]
    fn depth_grows_by_a_pixel_a_pixel_from_the_border() {
        let canvas = Canvas::new(20, 20, [1.0; 3]);
        let inside: Vec<bool> = (0..1600).map(|at| (10..30).contains(&(at % 40))).collect();
        let far = canvas.distance_to_border(&inside);
        assert_eq!([9, 10, 11, 19, 20, 29, 30].map(|column| far[800 + column]), [0.0, 0.5, 1.0, 5.0, 5.0, 0.5, 0.0]);
    }

    #[test]
    fn a_line_follows_a_circle_both_ways() {
        let around = |x: f32, y: f32| [-y, x];
        let line = trace_streamline([10.0, 0.0], 0.1, around, |_, _, n| n <= 50);
        assert_eq!(line.len(), 101);
        assert_eq!(line[50], [10.0, 0.0]);
        assert!(line[0][1] < -4.0 && line[100][1] > 4.0);
        assert!(line.iter().all(|p| ((p[0] * p[0] + p[1] * p[1]).sqrt() - 10.0).abs() < 0.1));
    }
}
