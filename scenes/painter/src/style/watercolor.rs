//! Watercolor: transparent washes on white paper, from light to dark. Pigment gathers at the edges of a wash and in hollows of the
//! paper, wet paint runs into wet paint, and backruns bloom (\[curtis1997\] describes all these). Highlights and thin gaps between
//! objects stay white.

use crate::canvas::{Canvas, Dab, mix, smoothstep, trace_streamline};
use crate::outline::{PointGrid, outlines};
use crate::{RenderView, random, random::StrokeStart};
use femc_film::Picture;
use femc_math::elementary::{exp, ln, pow};

const PAPER: [f32; 3] = [0.985, 0.975, 0.945];
const GRAPHITE: [f32; 3] = [0.55, 0.54, 0.55];
/// Transmittance of a pigment of density 1.
const ULTRAMARINE: [f32; 3] = [0.26, 0.34, 0.66];
const VIOLET: [f32; 3] = [0.50, 0.36, 0.58];
const SIENNA: [f32; 3] = [0.92, 0.50, 0.24];
const OCHRE: [f32; 3] = [0.97, 0.82, 0.58];
const INDIGO: [f32; 3] = [0.16, 0.18, 0.32];

/// Paints a picture in this style.
pub fn paint(view: &RenderView) -> Picture {
    let mut sheet = Sheet::new(view);
    sheet.draw_pencil_lines();
    for object in 0..view.curvature.len() as u8 {
        sheet.paint_first_wash(object);
        if view.curvature[usize::from(object)] < 0.05 {
            sheet.paint_broad_strokes(object);
        }
    }
    for object in 0..view.curvature.len() as u8 {
        sheet.paint_half_shadow(object);
        sheet.paint_shadow(object);
        sheet.paint_glow(object);
    }
    sheet.paint_strokes();
    sheet.paint_accents();
    sheet.canvas.picture()
}

struct Sheet<'a> {
    view: &'a RenderView,
    canvas: Canvas,
    /// Height of the paper, about -1..1.
    tooth: Vec<f32>,
    /// Object of each canvas pixel, with the error of an unsteady hand.
    object: Vec<u8>,
    /// Distance from the border of the object, pixels.
    border_distance: Vec<f32>,
    light: Vec<f32>,
    bounce: Vec<f32>,
}

/// Properties of a wash.
struct Wash {
    seed: u32,
    pigment: [f32; 3],
    /// Additional density at its edges.
    edge: f32,
    /// Strength of gathering in hollows of the paper.
    grain: f32,
    /// Unevenness of the flow.
    flow: f32,
    /// Number of backruns.
    blooms: u32,
}

impl<'a> Sheet<'a> {
    fn new(view: &'a RenderView) -> Self {
        let mut canvas = Canvas::new(view.width, view.height, PAPER);
        let count = canvas.pixels.len();
        let places: Vec<(f32, f32)> = (0..count).map(|at| canvas.position(at)).collect();
        let tooth: Vec<f32> = places.iter().map(|&(x, y)| tooth(x, y)).collect();
        for (pixel, height) in canvas.pixels.iter_mut().zip(&tooth) {
            *pixel = PAPER.map(|c| c + 0.012 * height);
        }
        let object: Vec<u8> = places
            .iter()
            .map(|&(x, y)| {
                let (u, v) = hand_jitter(x, y);
                view.object[view.pixel_index(x + u, y + v)]
            })
            .collect();
        let mut border_distance = vec![0.0; count];
        for number in 0..view.curvature.len() as u8 {
            let inside: Vec<bool> = object.iter().map(|&o| o == number).collect();
            let far = canvas.distance_to_border(&inside);
            border_distance.iter_mut().zip(far).for_each(|(most, far)| *most = f32::max(*most, far));
        }
        let (light, bounce) = (view.blurred(&view.balanced_light, 1), view.blurred(&view.bounce, 1));
        Self { view, canvas, tooth, object, border_distance, light, bounce }
    }

    /// Returns direct and bounced light at a point. An unsteady hand displaces the direct light.
    fn light_at(&self, x: f32, y: f32) -> (f32, f32) {
        let (u, v) = hand_jitter(x + 40.0, y);
        (self.view.interpolate(&self.light, x + 1.5 * u, y + 1.5 * v), self.view.interpolate(&self.bounce, x, y))
    }

    /// Draws faint pencil lines first.
    fn draw_pencil_lines(&mut self) {
        for outline in outlines(self.view) {
            for (number, piece) in outline.points.chunks(34).enumerate() {
                let word = |word: u64| random::signed(&[70, outline.object.into(), number as u64, word]);
                let dab = |(n, &[x, y]): (usize, &[f32; 2])| {
                    let off = 0.7 * word(1) + 0.03 * (n as f32 - 17.0) * word(2);
                    Dab { x: x + off, y: y + 0.5 * off, radius: 0.36 }
                };
                let dabs: Vec<Dab> = piece.iter().enumerate().map(dab).collect();
                for touch in self.canvas.covered_pixels(&dabs) {
                    let held = smoothstep(-0.5, 0.5, self.tooth[touch.at]);
                    self.canvas.glaze(touch.at, GRAPHITE, touch.cover * 0.75 * held);
                }
            }
        }
    }

    /// Paints a wash in the area `inside`, with the density `amount`.
    fn paint_wash(&mut self, wash: &Wash, inside: &[bool], amount: impl Fn(usize, f32, f32) -> f32) {
        let far = self.canvas.distance_to_border(inside);
        let absorbed = wash.pigment.map(|c| -ln(c.clamp(0.02, 0.995)));
        let (width, height) = (self.view.width as f32, self.view.height as f32);
        let blooms: Vec<[f32; 3]> = (0..u64::from(wash.blooms))
            .map(|n| {
                let word = |word: u64| random::unit(&[80, wash.seed.into(), n, word]);
                [width * word(1), height * word(2), 7.0 + 17.0 * word(3)]
            })
            .collect();
        for at in (0..inside.len()).filter(|&at| inside[at]) {
            let (x, y) = self.canvas.position(at);
            let mut density = amount(at, x, y);
            if density <= 0.0 {
                continue;
            }
            density *= 1.0 + wash.edge * (exp(-far[at] / 0.9) + 0.25 * exp(-far[at] / 4.0));
            density *= 1.0 + wash.flow * random::cloud(wash.seed, x / 26.0, y / 20.0, 4);
            density *=
                (1.0 - wash.grain * (self.tooth[at] + 0.5 * random::noise(wash.seed + 9, x / 0.9, y / 0.9))).max(0.15);
            for (number, &[cx, cy, radius]) in blooms.iter().enumerate() {
                let (u, v) = (x - cx, y - cy);
                let ragged = random::cloud(wash.seed + 50 + number as u32, x / 7.0, y / 7.0, 3);
                let off = (u * u + v * v).sqrt() / radius * (1.0 + 0.35 * ragged);
                density *= 1.0 - 0.38 * smoothstep(1.0, 0.75, off)
                    + 0.42 * smoothstep(0.82, 0.98, off) * smoothstep(1.12, 1.0, off);
            }
            let pixel = &mut self.canvas.pixels[at];
            (0..3).for_each(|i| pixel[i] *= exp(-density * absorbed[i]));
        }
    }

    /// Returns the pixels of an object, without the paper that stays white around it.
    fn object_mask(&self, object: u8, also: impl Fn(usize, f32, f32) -> bool) -> Vec<bool> {
        let inside = |at: usize| {
            if self.object[at] != object {
                return false;
            }
            let (x, y) = self.canvas.position(at);
            let gap = 0.35 + 1.5 * random::cloud(90 + u32::from(object), x / 16.0, y / 16.0, 2);
            self.border_distance[at] > gap && also(at, x, y)
        };
        (0..self.object.len()).map(inside).collect()
    }

    /// Returns the object's color as a pigment. A little ochre in all pigments makes light differ more than objects.
    fn pigment(&self, object: u8) -> [f32; 3] {
        let mut sum = [0.0f32; 3];
        let of_it = self.view.object.iter().zip(&self.view.local_color).filter(|(o, _)| **o == object);
        let count = of_it.map(|(_, color)| (0..3).for_each(|i| sum[i] += color[i])).count().max(1);
        let mean = sum.map(|c| c / count as f32);
        let most = mean.into_iter().fold(0.0, f32::max);
        let own = mean.map(|c| pow((c + 0.12) / (most + 0.12), 2.3).clamp(0.10, 0.99));
        mix(own, OCHRE, 0.4)
    }

    fn paint_first_wash(&mut self, object: u8) {
        let view = self.view;
        let lying = self.is_horizontal(object);
        let wash = Wash {
            seed: 100 + 10 * u32::from(object),
            pigment: self.pigment(object),
            edge: 0.55,
            grain: 0.20,
            flow: 0.42,
            blooms: if view.curvature[usize::from(object)] > 0.05 { 1 } else { 5 },
        };
        // Paper shows through where a dry brush moved quickly.
        let inside = self.object_mask(object, |at, x, y| {
            let quick =
                if lying { random::cloud(15, x / 34.0, y / 4.0, 3) } else { random::cloud(16, x / 18.0, y / 22.0, 3) };
            let dry = smoothstep(0.28, 0.75, quick);
            view.interpolate(&view.gloss, x, y) < 0.30 && self.tooth[at] < 1.25 - 1.5 * dry
        });
        let (light, bounce) = (self.light.clone(), self.bounce.clone());
        let round = view.curvature[usize::from(object)] > 0.05;
        self.paint_wash(&wash, &inside, |_, x, y| {
            let (lit, thrown) = (view.interpolate(&light, x, y), view.interpolate(&bounce, x, y));
            let dark = (1.0 - lit - thrown).clamp(0.0, 1.0);
            if round { 0.42 + 0.55 * dark } else { 0.50 + 0.45 * dark }
        });
    }

    fn is_horizontal(&self, object: u8) -> bool {
        let of_it = self.view.object.iter().zip(&self.view.normal).filter(|(o, _)| **o == object);
        let (up, count) = of_it.fold((0.0, 0.0f32), |(up, count), (_, n)| (up - n[1], count + 1.0));
        up / count.max(1.0) > 0.6
    }

    /// Paints the half shadow into the damp first wash, so it has no edge toward the light.
    fn paint_half_shadow(&mut self, object: u8) {
        let pigment = self.pigment(object);
        let deeper = std::array::from_fn(|i| pigment[i] * (0.35 + 0.65 * VIOLET[i]));
        let wash = Wash {
            seed: 200 + 10 * u32::from(object),
            pigment: deeper,
            edge: 0.18,
            grain: 0.26,
            flow: 0.45,
            blooms: 2,
        };
        let lit: Vec<f32> = self.canvas_values(|sheet, x, y| sheet.light_at(x, y).0);
        let inside = self.object_mask(object, |at, _, _| lit[at] < 0.72);
        self.paint_wash(&wash, &inside, |at, _, _| 0.55 * smoothstep(0.70, 0.25, lit[at]));
    }

    /// Paints the shadow after the half shadow is dry, so it has an edge, except where the light fades slowly.
    fn paint_shadow(&mut self, object: u8) {
        let seed = 300 + 10 * u32::from(object);
        let lit: Vec<f32> = self
            .canvas_values(|sheet, x, y| sheet.light_at(x, y).0 + 0.03 * random::cloud(seed + 5, x / 9.0, y / 9.0, 2));
        let violet = std::array::from_fn(|i| 0.5 * (ULTRAMARINE[i] + VIOLET[i]));
        for (n, (below, density, pigment)) in [(0.30, 0.46, violet), (0.10, 0.32, ULTRAMARINE)].into_iter().enumerate()
        {
            let wash = Wash { seed: seed + n as u32, pigment, edge: 0.65, grain: 0.30, flow: 0.45, blooms: 2 };
            let inside = self.object_mask(object, |at, _, _| lit[at] < below);
            let bounce = self.bounce.clone();
            let view = self.view;
            self.paint_wash(&wash, &inside, |_, x, y| {
                density * (1.15 - 2.6 * view.interpolate(&bounce, x, y)).clamp(0.3, 1.1)
            });
        }
    }

    /// Adds warm paint to the wet shadow where there is bounced light.
    fn paint_glow(&mut self, object: u8) {
        let wash =
            Wash { seed: 400 + 10 * u32::from(object), pigment: SIENNA, edge: 0.0, grain: 0.15, flow: 0.65, blooms: 0 };
        let lit: Vec<f32> = self.canvas_values(|sheet, x, y| sheet.light_at(x, y).0);
        let inside = self.object_mask(object, |at, _, _| lit[at] < 0.6);
        let (bounce, view) = (self.bounce.clone(), self.view);
        self.paint_wash(&wash, &inside, |at, x, y| {
            0.7 * smoothstep(0.10, 0.30, view.interpolate(&bounce, x, y)) * smoothstep(0.6, 0.2, lit[at])
        });
    }

    fn canvas_values(&self, value: impl Fn(&Self, f32, f32) -> f32) -> Vec<f32> {
        let at = |at: usize| {
            let (x, y) = self.canvas.position(at);
            value(self, x, y)
        };
        (0..self.object.len()).map(at).collect()
    }

    /// Paints over flat objects with a broad brush while they dry. Overlapping strokes leave more paint.
    fn paint_broad_strokes(&mut self, object: u8) {
        let view = self.view;
        let lying = self.is_horizontal(object);
        let absorbed = self.pigment(object).map(|c| -ln(c.clamp(0.02, 0.995)));
        for StrokeStart { key, x, y } in random::stroke_starts(1000 + u64::from(object), view.width, view.height, 9.0) {
            let word = |word: u64| random::signed(&[key, word]);
            if word(3) < -0.2 || view.object[view.pixel_index(x, y)] != object {
                continue;
            }
            let tilt = if lying { [1.0, 0.06 * word(4)] } else { [0.9, -0.75 + 0.35 * word(4)] };
            let longest = 9.0 + 6.0 * word(5);
            let line = trace_streamline([x, y], 2.0, |_, _| tilt, |_, _, n| n as f32 <= longest);
            let dabs: Vec<Dab> = line
                .iter()
                .map(|&[x, y]| {
                    let sway = 1.2 * random::noise(86, x / 9.0, y / 9.0);
                    Dab { x, y: y + sway, radius: (if lying { 2.6 } else { 4.6 }) * (1.0 + 0.3 * word(6)) }
                })
                .collect();
            for touch in self.canvas.covered_pixels(&dabs) {
                if self.object[touch.at] != object || self.border_distance[touch.at] < 0.8 {
                    continue;
                }
                let (lit, _) = self.light_at(touch.x, touch.y);
                let edge = 0.55 + 0.9 * smoothstep(0.72, 0.97, touch.across.abs());
                let dry = smoothstep(0.9, 0.2, self.tooth[touch.at] + 0.5 * smoothstep(10.0, 40.0, touch.along));
                let density = (0.15 + 0.09 * word(7)) * (1.25 - 0.5 * lit) * touch.cover * edge * dry;
                let pixel = &mut self.canvas.pixels[touch.at];
                (0..3).for_each(|i| pixel[i] *= exp(-density * absorbed[i]));
            }
        }
    }

    /// Paints small strokes along the forms over the dry washes.
    fn paint_strokes(&mut self) {
        let view = self.view;
        let mut taken = PointGrid::new(view.width, view.height, 6.5);
        for StrokeStart { key, x, y } in random::stroke_starts(75, view.width, view.height, 3.0) {
            let word = |word: u64| random::signed(&[key, word]);
            let (lit, thrown) = self.light_at(x, y);
            let dark = (1.0 - lit - thrown).max(0.0);
            if random::unit(&[key, 8]) > smoothstep(0.12, 0.6, dark)
                || view.interpolate(&view.gloss, x, y) > 0.1
                || !taken.is_free(x, y, 0.0)
            {
                continue;
            }
            let at = view.pixel_index(x, y);
            let object = view.object[at];
            let direction = |x: f32, y: f32| {
                let n = view.normal[view.pixel_index(x, y)];
                let axis = [0.45f32, -0.80, 0.40];
                match view.curvature[usize::from(object)] > 0.05 {
                    true => [n[1] * axis[2] - n[2] * axis[1], n[2] * axis[0] - n[0] * axis[2]],
                    false if n[1] < -0.6 => [1.0, 0.08 * word(3)],
                    false => [0.8, -0.7 + 0.4 * word(3)],
                }
            };
            let longest = 2.0 + 5.0 * random::unit(&[key, 9]);
            let line = trace_streamline([x, y], 1.5, direction, |x, y, n| {
                n as f32 <= longest && view.object[view.pixel_index(x, y)] == object
            });
            line.iter().for_each(|p| taken.insert(p[0], p[1]));
            let wide = 2.0 + 1.1 * word(4);
            let count = line.len() as f32;
            let dabs: Vec<Dab> = line
                .iter()
                .enumerate()
                .map(|(n, &[x, y])| Dab { x, y, radius: wide * (0.55 + 0.45 * smoothstep(0.0, 0.4, n as f32 / count)) })
                .collect();
            let base = self.pigment(object);
            let cold = if lit < 0.3 { ULTRAMARINE } else { VIOLET };
            let pigment: [f32; 3] = std::array::from_fn(|i| {
                let mixed = 0.5 + 0.4 * word(5);
                base[i] * (1.0 - mixed) + mixed * cold[i]
            });
            let absorbed = pigment.map(|c| -ln(c.clamp(0.02, 0.995)));
            for touch in self.canvas.covered_pixels(&dabs) {
                let edge = 0.65 + 0.8 * smoothstep(0.5, 0.95, touch.across * (0.6 + 0.4 * word(7)) + 0.2);
                let grain = 1.0 - 0.35 * self.tooth[touch.at];
                let spread = 0.45 + 1.1 * smoothstep(0.0, 9.0, touch.along);
                let density = (0.09 + 0.17 * dark) * (1.0 + 0.5 * word(6)) * spread * touch.cover * edge * grain;
                let pixel = &mut self.canvas.pixels[touch.at];
                (0..3).for_each(|i| pixel[i] *= exp(-density * absorbed[i]));
            }
        }
    }

    /// Paints the darkest areas, which receive no light.
    fn paint_accents(&mut self) {
        let wash = Wash { seed: 500, pigment: INDIGO, edge: 0.4, grain: 0.35, flow: 0.35, blooms: 0 };
        let dim: Vec<f32> = self.canvas_values(|sheet, x, y| {
            let (lit, thrown) = sheet.light_at(x, y);
            lit + 4.0 * thrown + 0.015 * random::cloud(510, x / 8.0, y / 8.0, 2)
        });
        for object in 0..self.view.curvature.len() as u8 {
            let inside = self.object_mask(object, |at, _, _| dim[at] < 0.38);
            self.paint_wash(&wash, &inside, |at, _, _| 0.6 * smoothstep(0.38, 0.16, dim[at]));
        }
    }
}

/// Returns the displacement by an unsteady hand, pixels.
fn hand_jitter(x: f32, y: f32) -> (f32, f32) {
    let far =
        |seed: u32| 1.3 * random::noise(seed, x / 21.0, y / 21.0) + 0.5 * random::noise(seed + 1, x / 5.0, y / 5.0);
    (far(40), far(44))
}

/// Height of cold-pressed paper.
fn tooth(x: f32, y: f32) -> f32 {
    let (u, v) = (x + 0.8 * random::noise(22, x / 4.0, y / 4.0), y + 0.8 * random::noise(23, x / 4.0, y / 4.0));
    0.75 * random::noise(20, u / 2.3, v / 2.0) + 0.4 * random::noise(21, u / 1.1, v / 1.1)
}
