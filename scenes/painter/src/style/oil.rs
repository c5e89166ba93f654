//! Oil on canvas: coarse strokes first, and finer ones where the painting still differs from the render (\[hertzmann1998\]).
//! Strokes follow forms and contours, and bristles leave ridges. Lights are warm, shadows violet, and bounced light glows in them.

use crate::canvas::{Canvas, Dab, SUPERSAMPLING, mix, smoothstep, trace_streamline};
use crate::render_view::luma;
use crate::{RenderView, random, random::StrokeStart};
use femc_film::Picture;

/// Color of the primed canvas, which shows between strokes.
const GROUND: [f32; 3] = [0.47, 0.31, 0.22];

struct Brush {
    /// Half the width, pixels.
    radius: f32,
    /// Longest stroke, in half widths.
    max_length: f32,
    /// Color difference above which the brush is used.
    min_difference: f32,
    /// Greatest color difference between the paint of two strokes.
    color_variation: f32,
    /// Thickness of the paint.
    body: f32,
}

const BRUSHES: [Brush; 4] = [
    Brush { radius: 7.5, max_length: 7.0, min_difference: 0.0, color_variation: 0.075, body: 0.7 },
    Brush { radius: 4.2, max_length: 8.0, min_difference: 0.045, color_variation: 0.07, body: 0.9 },
    Brush { radius: 2.5, max_length: 9.0, min_difference: 0.06, color_variation: 0.06, body: 1.0 },
    Brush { radius: 1.4, max_length: 9.0, min_difference: 0.085, color_variation: 0.04, body: 1.2 },
];

/// Paints a picture in this style.
pub fn paint(view: &RenderView) -> Picture {
    let mut painting = Painting {
        view,
        target: target_colors(view),
        canvas: Canvas::new(view.width, view.height, GROUND),
        height: Vec::new(),
    };
    painting.prime();
    for (number, brush) in BRUSHES.iter().enumerate() {
        painting.paint_layer(number as u64, brush);
    }
    painting.paint_highlights();
    painting.shade_relief();
    painting.canvas.picture()
}

struct Painting<'a> {
    view: &'a RenderView,
    target: Vec<[f32; 3]>,
    canvas: Canvas,
    /// Height of the paint on each canvas pixel.
    height: Vec<f32>,
}

/// Computes the colors that the painting should have.
fn target_colors(view: &RenderView) -> Vec<[f32; 3]> {
    const LIT: [f32; 3] = [1.06, 0.98, 0.82];
    const COLD: [f32; 3] = [0.20, 0.19, 0.36];
    const GLOW: [f32; 3] = [0.60, 0.31, 0.07];
    let color = |at: usize| {
        let local = view.local_color[at];
        // Increase the saturation.
        let gray = luma(local);
        let rich = local.map(|c| (gray + 1.9 * (c - gray)).clamp(0.02, 1.0));
        let light = 0.5 * (view.light[at] + view.balanced_light[at]);
        let lit = smoothstep(0.02, 0.85, light);
        let shade = mix(rich.map(|c| 0.42 * c), COLD, 0.58);
        let half = std::array::from_fn(|i| rich[i] * [0.78, 0.66, 0.60][i]);
        let full = std::array::from_fn(|i| (rich[i] * 1.10 * LIT[i]).min(1.0));
        let base = if lit < 0.5 { mix(shade, half, 2.0 * lit) } else { mix(half, full, 2.0 * lit - 1.0) };
        let glow = (1.0 - 0.8 * lit) * smoothstep(0.08, 0.30, view.bounce[at]) * 0.60;
        let warmed = std::array::from_fn(|i| base[i] + glow * GLOW[i] * (0.35 + rich[i]));
        // Areas without light are nearly black.
        let deep = smoothstep(0.30, 0.08, light + 2.0 * view.bounce[at]);
        let color = mix(warmed, [0.09, 0.07, 0.15], 0.6 * deep);
        mix(color, [1.0, 0.985, 0.93], smoothstep(0.25, 0.95, view.gloss[at]))
    };
    (0..view.luma.len()).map(color).collect()
}

impl Painting<'_> {
    /// Paints the canvas weave and a rubbed ground.
    fn prime(&mut self) {
        for at in 0..self.canvas.pixels.len() {
            let (x, y) = self.canvas.position(at);
            let (column, row) = ((x * SUPERSAMPLING as f32) as i32, (y * SUPERSAMPLING as f32) as i32);
            let thread = if (column / 2 + row / 2) % 2 == 0 { column % 2 } else { row % 2 };
            let weave = 0.5 * thread as f32 + 0.3 * random::noise(3, x / 0.8, y / 0.8);
            self.height.push(0.22 * weave);
            let rubbed = 0.06 * random::cloud(8, x / 18.0, y / 18.0, 3);
            self.canvas.pixels[at] = GROUND.map(|c| c + rubbed + 0.02 * weave);
        }
    }

    fn paint_layer(&mut self, number: u64, brush: &Brush) {
        let view = self.view;
        let target = self.target_at_brush_size(brush.radius);
        let tone: Vec<f32> = target.iter().map(|&color| luma(color)).collect();
        for StrokeStart { key, x, y } in
            random::stroke_starts(20 + number, view.width, view.height, 1.05 * brush.radius)
        {
            let word = |word: u64| random::signed(&[key, word]);
            let at = view.pixel_index(x, y);
            if self.difference(&target, x, y, brush.radius) < brush.min_difference {
                continue;
            }
            let color = target[at];
            let object = view.object[at];
            let longest = brush.max_length * brush.radius * (0.55 + 0.25 * word(3));
            let walk = (0.5 * brush.radius).max(0.8);
            let direction = |x: f32, y: f32| self.direction(&tone, x, y, brush.radius, number);
            let line = trace_streamline([x, y], walk, direction, |x, y, n| {
                let here = view.pixel_index(x, y);
                let off: f32 = (0..3).map(|i| (target[here][i] - color[i]).abs()).sum();
                n as f32 * walk < 0.5 * longest && view.object[here] == object && off < 0.16
            });
            let count = line.len().max(2) - 1;
            let dabs: Vec<Dab> = line
                .iter()
                .enumerate()
                .map(|(n, &[x, y])| {
                    let t = n as f32 / count as f32;
                    let pressed = 0.72 + 0.28 * smoothstep(0.0, 0.25, t) * smoothstep(1.0, 0.7, t);
                    Dab { x, y, radius: brush.radius * pressed * (0.92 + 0.12 * word(4)) }
                })
                .collect();
            self.stroke(&dabs, self.vary_color(color, brush.color_variation, &word), brush, key);
        }
    }

    /// Blurs the wanted colors to the size of the brush.
    fn target_at_brush_size(&self, radius: f32) -> Vec<[f32; 3]> {
        let plane = |i: usize| {
            let values: Vec<f32> = self.target.iter().map(|color| color[i]).collect();
            self.view.blurred(&values, (0.5 * radius) as usize)
        };
        let [r, g, b] = [plane(0), plane(1), plane(2)];
        r.into_iter().zip(g).zip(b).map(|((r, g), b)| [r, g, b]).collect()
    }

    /// Returns the mean difference between the painting and the wanted colors under the brush.
    fn difference(&self, target: &[[f32; 3]], x: f32, y: f32, radius: f32) -> f32 {
        let mut sum = 0.0;
        for (u, v) in [(0.0, 0.0), (0.7, 0.0), (-0.7, 0.0), (0.0, 0.7), (0.0, -0.7)] {
            let (x, y) = (x + u * radius, y + v * radius);
            let column = ((x * SUPERSAMPLING as f32).max(0.0) as usize).min(self.canvas.width - 1);
            let row = ((y * SUPERSAMPLING as f32).max(0.0) as usize).min(self.canvas.height - 1);
            let there = self.canvas.pixels[row * self.canvas.width + column];
            let wanted = target[self.view.pixel_index(x, y)];
            sum += (0..3).map(|i| (there[i] - wanted[i]).abs()).sum::<f32>() / 3.0;
        }
        sum / 5.0
    }

    /// Returns the direction of a stroke: around round objects, across steep slopes of the light, and elsewhere along the sway of
    /// the wrist.
    fn direction(&self, tone: &[f32], x: f32, y: f32, radius: f32, number: u64) -> [f32; 2] {
        let view = self.view;
        let at = view.pixel_index(x, y);
        let value = |u: f32, v: f32| view.interpolate(tone, x + u * radius, y + v * radius);
        let (gx, gy) = (value(1.0, 0.0) - value(-1.0, 0.0), value(0.0, 1.0) - value(0.0, -1.0));
        let steep = (gx * gx + gy * gy).sqrt();
        let contour = [-gy / steep.max(1e-4), gx / steep.max(1e-4)];
        let n = view.normal[at];
        let turn = 0.9 * random::noise(30 + number as u32, x / 38.0, y / 30.0);
        let wrist = if view.curvature[usize::from(view.object[at])] > 0.05 {
            // Circles of latitude about a tilted axis.
            let axis = [-0.35f32, -0.82, 0.45];
            [n[1] * axis[2] - n[2] * axis[1], n[2] * axis[0] - n[0] * axis[2]]
        } else if n[1] < -0.6 {
            [1.0, 0.10 + 0.35 * turn]
        } else {
            [0.75, -0.65 + turn]
        };
        let trust = smoothstep(0.02, 0.10, steep);
        let sign = if wrist[0] * contour[0] + wrist[1] * contour[1] < 0.0 { -1.0 } else { 1.0 };
        std::array::from_fn(|i| (1.0 - trust) * wrist[i] + trust * sign * contour[i])
    }

    /// Varies the color of a stroke: lighter or darker, warmer or colder.
    fn vary_color(&self, color: [f32; 3], variation: f32, word: &impl Fn(u64) -> f32) -> [f32; 3] {
        let (light, warm, green) = (variation * word(11), variation * word(12), 0.5 * variation * word(13));
        [color[0] + light + 0.6 * warm, color[1] + light + green, color[2] + light - 0.8 * warm]
    }

    fn stroke(&mut self, dabs: &[Dab], color: [f32; 3], brush: &Brush, key: u64) {
        let bristles = (brush.radius * 2.2).max(2.0);
        let touches = self.canvas.covered_pixels(dabs);
        let length = touches.iter().map(|touch| touch.along).fold(1.0, f32::max);
        let seed = key as u32;
        for touch in touches {
            let hair = random::noise(seed, touch.across * bristles, touch.along / (4.0 * brush.radius));
            let fine = random::noise(seed ^ 77, touch.across * bristles * 2.3, touch.along / (2.5 * brush.radius));
            // The brush runs dry toward the end, where some bristles leave nothing.
            let spent = smoothstep(0.55, 1.05, touch.along / length);
            let wet = smoothstep(-0.55, -0.15, hair + 0.4 * fine + 0.25 - 1.0 * spent);
            let cover = touch.cover * (0.35 + 0.65 * wet) * (0.88 + 0.12 * wet);
            let streak = 0.045 * hair + 0.035 * fine;
            let paint = color.map(|c| c + streak);
            self.canvas.blend(touch.at, paint, cover.min(1.0));
            // The brush pushes paint to the sides and to the end.
            let ridge = smoothstep(0.62, 0.9, touch.across.abs()) + 0.5 * smoothstep(0.85, 1.0, touch.along / length);
            let thick = brush.body * (0.30 + 0.45 * hair + 0.25 * fine + 0.45 * ridge);
            self.height[touch.at] += cover * (thick - 0.8 * self.height[touch.at]);
        }
    }

    /// Paints the highlights last, in thick paint.
    fn paint_highlights(&mut self) {
        let view = self.view;
        let brush = Brush { radius: 2.6, max_length: 3.0, min_difference: 0.0, color_variation: 0.02, body: 1.8 };
        for StrokeStart { key, x, y } in random::stroke_starts(28, view.width, view.height, 4.0) {
            if view.interpolate(&view.gloss, x, y) < 0.72 {
                continue;
            }
            let line = trace_streamline([x, y], 1.0, |_, _| [1.0, -0.8], |_, _, n| n < 4);
            let dabs: Vec<Dab> = line.iter().map(|&[x, y]| Dab { x, y, radius: brush.radius }).collect();
            self.stroke(&dabs, [1.0, 0.99, 0.94], &brush, key);
        }
    }

    /// Lights the ridges of the paint from the upper left.
    fn shade_relief(&mut self) {
        let (width, height) = (self.canvas.width, self.canvas.height);
        let relief = |column: usize, row: usize| self.height[row.min(height - 1) * width + column.min(width - 1)];
        for row in 0..height {
            for column in 0..width {
                let dx = relief(column + 1, row) - relief(column.saturating_sub(1), row);
                let dy = relief(column, row + 1) - relief(column, row.saturating_sub(1));
                let facing = (dx + dy).clamp(-0.9, 0.9);
                let pixel = &mut self.canvas.pixels[row * width + column];
                let shine = 0.16 * smoothstep(0.25, 0.8, facing);
                *pixel = pixel.map(|c| c * (1.0 + 0.20 * facing) + shine * (0.25 + 0.75 * c));
            }
        }
    }
}
