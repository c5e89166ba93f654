//! Cel style with outlines: few flat tones of gouache with the marks of a flat brush, cold shadows that are warm from below, and
//! brush-pen lines that are thicker in the dark, feathered where shadow begins.

use crate::canvas::{Canvas, Dab, mix, smoothstep, trace_streamline};
use crate::outline::{Line, PointGrid, level_lines, outlines};
use crate::render_view::luma;
use crate::{RenderView, random, random::StrokeStart};
use femc_film::Picture;

const INK: [f32; 3] = [0.09, 0.07, 0.13];
/// Light below which a surface is in half shadow, followed by the limit of full shadow.
const HALF_SHADOW: f32 = 0.60;
const SHADOW: f32 = 0.16;
/// Gloss above which a surface has a highlight.
const SHINE: f32 = 0.42;

/// Paints a picture in this style.
pub fn paint(view: &RenderView) -> Picture {
    let mut cel = Cel {
        view,
        canvas: Canvas::new(view.width, view.height, [0.5; 3]),
        balanced_light: view.blurred(&view.balanced_light, 2),
        bounce: view.blurred(&view.bounce, 2),
    };
    cel.paint_flat_tones();
    cel.paint_brush_strokes();
    cel.draw_shadow_edges();
    cel.draw_feathers();
    cel.draw_outlines();
    cel.canvas.picture()
}

struct Cel<'a> {
    view: &'a RenderView,
    canvas: Canvas,
    balanced_light: Vec<f32>,
    bounce: Vec<f32>,
}

/// Tone of a point, from the darkest.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Tone {
    Deep,
    Shadow,
    Reflected,
    Half,
    Full,
    Shine,
}

impl Cel<'_> {
    fn tone(&self, x: f32, y: f32) -> Tone {
        let sway = |seed: u32, size: f32| random::noise(seed, x / size, y / size);
        let (u, v) = (x + 0.9 * sway(1, 17.0), y + 0.9 * sway(2, 17.0));
        let lit = self.view.interpolate(&self.balanced_light, u, v);
        let bounce = self.view.interpolate(&self.bounce, u, v);
        if self.view.interpolate(&self.view.gloss, u, v) > SHINE {
            Tone::Shine
        } else if lit > HALF_SHADOW {
            Tone::Full
        } else if lit > SHADOW {
            Tone::Half
        } else if bounce > 0.20 {
            Tone::Reflected
        } else if bounce < 0.06 && lit < 0.06 {
            Tone::Deep
        } else {
            Tone::Shadow
        }
    }

    fn color(&self, at: usize, tone: Tone) -> [f32; 3] {
        let local = self.view.local_color[at];
        let gray = luma(local);
        let rich = local.map(|c| (gray + 2.4 * (c - gray)).clamp(0.02, 1.0));
        let tinted = |tint: [f32; 3], much: f32, bright: f32| mix(rich.map(|c| bright * c), tint, much);
        match tone {
            Tone::Shine => [1.0, 0.99, 0.95],
            Tone::Full => tinted([1.0, 0.93, 0.70], 0.22, 1.16),
            Tone::Half => tinted([0.78, 0.44, 0.38], 0.20, 0.90),
            Tone::Reflected => tinted([0.74, 0.30, 0.16], 0.42, 0.66),
            Tone::Shadow => tinted([0.24, 0.19, 0.46], 0.50, 0.54),
            Tone::Deep => tinted([0.11, 0.10, 0.24], 0.72, 0.35),
        }
    }

    fn paint_flat_tones(&mut self) {
        for at in 0..self.canvas.pixels.len() {
            let (x, y) = self.canvas.position(at);
            let (u, v) = (0.5 * random::noise(3, x / 9.0, y / 9.0), 0.5 * random::noise(4, x / 9.0, y / 9.0));
            let pixel = self.view.pixel_index(x + u, y + v);
            let grain = 0.012 * random::noise(6, x / 0.9, y / 0.9) + 0.018 * random::cloud(7, x / 40.0, y / 40.0, 2);
            self.canvas.pixels[at] = self.color(pixel, self.tone(x, y)).map(|c| c + grain);
        }
    }

    fn stroke_direction(&self, x: f32, y: f32) -> [f32; 2] {
        let at = self.view.pixel_index(x, y);
        let n = self.view.normal[at];
        let axis = [0.50f32, -0.75, 0.43];
        if self.view.curvature[usize::from(self.view.object[at])] > 0.05 {
            [n[1] * axis[2] - n[2] * axis[1], n[2] * axis[0] - n[0] * axis[2]]
        } else if n[1] < -0.6 {
            [1.0, 0.04]
        } else {
            [1.0, -0.55]
        }
    }

    /// Paints strokes of a flat brush within each tone, slightly lighter or darker.
    fn paint_brush_strokes(&mut self) {
        let view = self.view;
        for StrokeStart { key, x, y } in random::stroke_starts(30, view.width, view.height, 5.0) {
            let word = |word: u64| random::signed(&[key, word]);
            let (tone, at) = (self.tone(x, y), view.pixel_index(x, y));
            if tone == Tone::Shine {
                continue;
            }
            let object = view.object[at];
            let round = view.curvature[usize::from(object)] > 0.05;
            let longest = if round { 7.0 } else { 9.0 } + 4.0 * word(3);
            let line = trace_streamline(
                [x, y],
                1.5,
                |x, y| self.stroke_direction(x, y),
                |x, y, n| {
                    n as f32 <= longest && view.object[view.pixel_index(x, y)] == object && self.tone(x, y) == tone
                },
            );
            let wide = 2.3 + 0.8 * word(4);
            let dabs: Vec<Dab> = line.iter().map(|&[x, y]| Dab { x, y, radius: wide }).collect();
            let (light, warm) = (0.05 * word(5), 0.025 * word(6));
            let color = self.color(at, tone);
            let paint = [color[0] + light + warm, color[1] + light, color[2] + light - warm];
            let key = key as u32;
            let touches = self.canvas.covered_pixels(&dabs);
            for touch in touches {
                let hair = random::noise(key, 3.5 * touch.across, touch.along / 14.0);
                let dry = smoothstep(-0.55, 0.15, hair + 0.35 * random::noise(33, touch.x / 1.2, touch.y / 1.2));
                if self.tone(touch.x, touch.y) == tone && view.object[view.pixel_index(touch.x, touch.y)] == object {
                    self.canvas.blend(touch.at, paint, touch.cover * 0.8 * dry);
                }
            }
        }
    }

    /// Draws a thin dark line where a cast shadow begins.
    fn draw_shadow_edges(&mut self) {
        let (view, lit) = (self.view, self.balanced_light.clone());
        let steep = |x: f32, y: f32| {
            let value = |u: f32, v: f32| view.interpolate(&lit, x + u, y + v);
            let (gx, gy) = (value(3.0, 0.0) - value(-3.0, 0.0), value(0.0, 3.0) - value(0.0, -3.0));
            (gx * gx + gy * gy).sqrt()
        };
        let lines = level_lines(view, &lit, SHADOW, |x, y| steep(x, y) > 0.30);
        self.draw_pen_lines(&lines, 60, |_, _| 0.45);
    }

    /// Draws tapering strokes from the shadow into the half shadow.
    fn draw_feathers(&mut self) {
        let view = self.view;
        let lit = self.balanced_light.clone();
        let slope = |x: f32, y: f32| {
            let value = |u: f32, v: f32| view.interpolate(&lit, x + u, y + v);
            [value(3.0, 0.0) - value(-3.0, 0.0), value(0.0, 3.0) - value(0.0, -3.0)]
        };
        let round = |x: f32, y: f32| view.curvature[usize::from(view.object[view.pixel_index(x, y)])] > 0.05;
        for (number, (level, long)) in [(SHADOW, 17.0), (HALF_SHADOW, 11.0)].into_iter().enumerate() {
            let mut taken = PointGrid::new(view.width, view.height, 4.6);
            for line in level_lines(view, &lit, level, round) {
                for (n, &[x, y]) in line.points.iter().enumerate() {
                    let word = |word: u64| random::signed(&[50, number as u64, n as u64, word]);
                    if !taken.is_free(x, y, 0.0) {
                        continue;
                    }
                    taken.insert(x, y);
                    let [gx, gy] = slope(x, y);
                    let steep = (gx * gx + gy * gy).sqrt().max(1e-4);
                    let length = long * (0.75 + 0.35 * word(1));
                    // Strokes are slanted, and bend with the form.
                    let (dx, dy) = ((gx - 0.35 * gy) / steep, (gy + 0.35 * gx) / steep);
                    let dabs: Vec<Dab> = (0..=8)
                        .map(|n| {
                            let t = n as f32 / 8.0;
                            let (far, bend) = ((t - 0.3) * length, 1.6 * t * t);
                            let (px, py) = (x + far * dx - bend * dy, y + far * dy + bend * dx);
                            let full = if number == 0 { 1.15 } else { 0.75 };
                            Dab { x: px, y: py, radius: (full * smoothstep(0.0, 0.25, t) * (1.0 - t) + 0.08).max(0.0) }
                        })
                        .collect();
                    let object = view.object[view.pixel_index(x, y)];
                    let color = if number == 0 {
                        self.color(view.pixel_index(x, y), Tone::Shadow)
                    } else {
                        self.color(view.pixel_index(x, y), Tone::Half)
                    };
                    for touch in self.canvas.covered_pixels(&dabs) {
                        if view.object[view.pixel_index(touch.x, touch.y)] == object {
                            self.canvas.blend(touch.at, color, touch.cover * 0.92);
                        }
                    }
                }
            }
        }
    }

    /// Draws outlines.
    fn draw_outlines(&mut self) {
        let view = self.view;
        let lit = self.balanced_light.clone();
        let outlines = outlines(view);
        self.draw_pen_lines(&outlines, 70, |x, y| {
            let around = [(3.0, 0.0), (-3.0, 0.0), (0.0, 3.0), (0.0, -3.0)];
            let darkest = around.map(|(u, v)| view.interpolate(&lit, x + u, y + v)).into_iter().fold(1.0, f32::min);
            0.55 + 1.25 * smoothstep(0.75, 0.0, darkest)
        });
    }

    /// Draws lines with a brush pen, each in several strokes that taper at both ends.
    fn draw_pen_lines(&mut self, lines: &[Line], seed: u64, radius: impl Fn(f32, f32) -> f32) {
        for line in lines {
            for (number, start) in (0..line.points.len()).step_by(70).enumerate() {
                let piece = &line.points[start.saturating_sub(4)..(start + 74).min(line.points.len())];
                let word = |word: u64| random::signed(&[seed, line.object.into(), number as u64, word]);
                let dabs: Vec<Dab> = piece
                    .iter()
                    .enumerate()
                    .map(|(n, &[x, y])| {
                        let end = (n.min(piece.len() - 1 - n)) as f32;
                        let pressed = (0.35 + 0.65 * smoothstep(0.0, 14.0, end))
                            * (1.0 + 0.22 * random::noise(seed as u32, x / 9.0, y / 9.0));
                        let off = 0.35 * word(1);
                        Dab { x: x + off, y: y - off, radius: radius(x, y) * pressed }
                    })
                    .collect();
                for touch in self.canvas.covered_pixels(&dabs) {
                    let dry = smoothstep(-1.0, -0.5, random::noise(9, touch.x / 1.4, touch.y / 1.4));
                    self.canvas.blend(touch.at, INK, touch.cover * (0.75 + 0.22 * dry));
                }
            }
        }
    }
}
