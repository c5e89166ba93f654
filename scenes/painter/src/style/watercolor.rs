//! Watercolor: transparent washes on white paper, from light to dark. Pigment gathers at the edges of a wash and in hollows of the
//! paper, wet paint runs into wet paint, and backruns bloom (\[curtis1997\] describes all these). Highlights and thin gaps between
//! objects stay white.

use crate::canvas::{Canvas, Dab, follow, mix, ramp};
use crate::outline::{Near, outlines};
use crate::{Sight, chance, chance::Place};
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
pub fn paint(sight: &Sight) -> Picture {
    let mut sheet = Sheet::new(sight);
    sheet.pencil();
    for object in 0..sight.curved.len() as u8 {
        sheet.first_wash(object);
        if sight.curved[usize::from(object)] < 0.05 {
            sheet.broad(object);
        }
    }
    for object in 0..sight.curved.len() as u8 {
        sheet.half_shadow(object);
        sheet.shadow(object);
        sheet.glow(object);
    }
    sheet.strokes();
    sheet.accents();
    sheet.canvas.picture()
}

struct Sheet<'a> {
    sight: &'a Sight,
    canvas: Canvas,
    /// Height of the paper, about -1..1.
    tooth: Vec<f32>,
    /// Object of each canvas pixel, with the error of an unsteady hand.
    object: Vec<u8>,
    /// Distance from the border of the object, pixels.
    inner: Vec<f32>,
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
    fn new(sight: &'a Sight) -> Self {
        let mut canvas = Canvas::new(sight.width, sight.height, PAPER);
        let count = canvas.pixels.len();
        let places: Vec<(f32, f32)> = (0..count).map(|at| canvas.position(at)).collect();
        let tooth: Vec<f32> = places.iter().map(|&(x, y)| tooth(x, y)).collect();
        for (pixel, height) in canvas.pixels.iter_mut().zip(&tooth) {
            *pixel = PAPER.map(|c| c + 0.012 * height);
        }
        let object: Vec<u8> = places
            .iter()
            .map(|&(x, y)| {
                let (u, v) = unsteady(x, y);
                sight.object[sight.at(x + u, y + v)]
            })
            .collect();
        let mut inner = vec![0.0; count];
        for number in 0..sight.curved.len() as u8 {
            let inside: Vec<bool> = object.iter().map(|&o| o == number).collect();
            let far = canvas.depth_within(&inside);
            inner.iter_mut().zip(far).for_each(|(most, far)| *most = f32::max(*most, far));
        }
        let (light, bounce) = (sight.blurred(&sight.lit, 1), sight.blurred(&sight.bounce, 1));
        Self { sight, canvas, tooth, object, inner, light, bounce }
    }

    /// Returns direct and bounced light at a point. An unsteady hand displaces the direct light.
    fn lit(&self, x: f32, y: f32) -> (f32, f32) {
        let (u, v) = unsteady(x + 40.0, y);
        (self.sight.smooth(&self.light, x + 1.5 * u, y + 1.5 * v), self.sight.smooth(&self.bounce, x, y))
    }

    /// Draws faint pencil lines first.
    fn pencil(&mut self) {
        for outline in outlines(self.sight) {
            for (number, piece) in outline.points.chunks(34).enumerate() {
                let word = |word: u64| chance::signed(&[70, outline.object.into(), number as u64, word]);
                let dab = |(n, &[x, y]): (usize, &[f32; 2])| {
                    let off = 0.7 * word(1) + 0.03 * (n as f32 - 17.0) * word(2);
                    Dab { x: x + off, y: y + 0.5 * off, radius: 0.36 }
                };
                let dabs: Vec<Dab> = piece.iter().enumerate().map(dab).collect();
                for touch in self.canvas.touched(&dabs) {
                    let held = ramp(-0.5, 0.5, self.tooth[touch.at]);
                    self.canvas.glaze(touch.at, GRAPHITE, touch.cover * 0.75 * held);
                }
            }
        }
    }

    /// Paints a wash in the area `inside`, with the density `amount`.
    fn lay(&mut self, wash: &Wash, inside: &[bool], amount: impl Fn(usize, f32, f32) -> f32) {
        let far = self.canvas.depth_within(inside);
        let absorbed = wash.pigment.map(|c| -ln(c.clamp(0.02, 0.995)));
        let (width, height) = (self.sight.width as f32, self.sight.height as f32);
        let blooms: Vec<[f32; 3]> = (0..u64::from(wash.blooms))
            .map(|n| {
                let word = |word: u64| chance::unit(&[80, wash.seed.into(), n, word]);
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
            density *= 1.0 + wash.flow * chance::cloud(wash.seed, x / 26.0, y / 20.0, 4);
            density *=
                (1.0 - wash.grain * (self.tooth[at] + 0.5 * chance::noise(wash.seed + 9, x / 0.9, y / 0.9))).max(0.15);
            for (number, &[cx, cy, radius]) in blooms.iter().enumerate() {
                let (u, v) = (x - cx, y - cy);
                let ragged = chance::cloud(wash.seed + 50 + number as u32, x / 7.0, y / 7.0, 3);
                let off = (u * u + v * v).sqrt() / radius * (1.0 + 0.35 * ragged);
                density *= 1.0 - 0.38 * ramp(1.0, 0.75, off) + 0.42 * ramp(0.82, 0.98, off) * ramp(1.12, 1.0, off);
            }
            let pixel = &mut self.canvas.pixels[at];
            (0..3).for_each(|i| pixel[i] *= exp(-density * absorbed[i]));
        }
    }

    /// Returns the pixels of an object, without the paper that stays white around it.
    fn of(&self, object: u8, also: impl Fn(usize, f32, f32) -> bool) -> Vec<bool> {
        let inside = |at: usize| {
            if self.object[at] != object {
                return false;
            }
            let (x, y) = self.canvas.position(at);
            let gap = 0.35 + 1.5 * chance::cloud(90 + u32::from(object), x / 16.0, y / 16.0, 2);
            self.inner[at] > gap && also(at, x, y)
        };
        (0..self.object.len()).map(inside).collect()
    }

    /// Returns the object's color as a pigment. A little ochre in all pigments makes light differ more than objects.
    fn pigment(&self, object: u8) -> [f32; 3] {
        let mut sum = [0.0f32; 3];
        let of_it = self.sight.object.iter().zip(&self.sight.local).filter(|(o, _)| **o == object);
        let count = of_it.map(|(_, color)| (0..3).for_each(|i| sum[i] += color[i])).count().max(1);
        let mean = sum.map(|c| c / count as f32);
        let most = mean.into_iter().fold(0.0, f32::max);
        let own = mean.map(|c| pow((c + 0.12) / (most + 0.12), 2.3).clamp(0.10, 0.99));
        mix(own, OCHRE, 0.4)
    }

    fn first_wash(&mut self, object: u8) {
        let sight = self.sight;
        let lying = self.lies(object);
        let wash = Wash {
            seed: 100 + 10 * u32::from(object),
            pigment: self.pigment(object),
            edge: 0.55,
            grain: 0.20,
            flow: 0.42,
            blooms: if sight.curved[usize::from(object)] > 0.05 { 1 } else { 5 },
        };
        // Paper shows through where a dry brush moved quickly.
        let inside = self.of(object, |at, x, y| {
            let quick =
                if lying { chance::cloud(15, x / 34.0, y / 4.0, 3) } else { chance::cloud(16, x / 18.0, y / 22.0, 3) };
            let dry = ramp(0.28, 0.75, quick);
            sight.smooth(&sight.gloss, x, y) < 0.30 && self.tooth[at] < 1.25 - 1.5 * dry
        });
        let (light, bounce) = (self.light.clone(), self.bounce.clone());
        let round = sight.curved[usize::from(object)] > 0.05;
        self.lay(&wash, &inside, |_, x, y| {
            let (lit, thrown) = (sight.smooth(&light, x, y), sight.smooth(&bounce, x, y));
            let dark = (1.0 - lit - thrown).clamp(0.0, 1.0);
            if round { 0.42 + 0.55 * dark } else { 0.50 + 0.45 * dark }
        });
    }

    fn lies(&self, object: u8) -> bool {
        let of_it = self.sight.object.iter().zip(&self.sight.normal).filter(|(o, _)| **o == object);
        let (up, count) = of_it.fold((0.0, 0.0f32), |(up, count), (_, n)| (up - n[1], count + 1.0));
        up / count.max(1.0) > 0.6
    }

    /// Paints the half shadow into the damp first wash, so it has no edge toward the light.
    fn half_shadow(&mut self, object: u8) {
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
        let lit: Vec<f32> = self.everywhere(|sheet, x, y| sheet.lit(x, y).0);
        let inside = self.of(object, |at, _, _| lit[at] < 0.72);
        self.lay(&wash, &inside, |at, _, _| 0.55 * ramp(0.70, 0.25, lit[at]));
    }

    /// Paints the shadow after the half shadow is dry, so it has an edge, except where the light fades slowly.
    fn shadow(&mut self, object: u8) {
        let seed = 300 + 10 * u32::from(object);
        let lit: Vec<f32> =
            self.everywhere(|sheet, x, y| sheet.lit(x, y).0 + 0.03 * chance::cloud(seed + 5, x / 9.0, y / 9.0, 2));
        let violet = std::array::from_fn(|i| 0.5 * (ULTRAMARINE[i] + VIOLET[i]));
        for (n, (below, density, pigment)) in [(0.30, 0.46, violet), (0.10, 0.32, ULTRAMARINE)].into_iter().enumerate()
        {
            let wash = Wash { seed: seed + n as u32, pigment, edge: 0.65, grain: 0.30, flow: 0.45, blooms: 2 };
            let inside = self.of(object, |at, _, _| lit[at] < below);
            let bounce = self.bounce.clone();
            let sight = self.sight;
            self.lay(&wash, &inside, |_, x, y| density * (1.15 - 2.6 * sight.smooth(&bounce, x, y)).clamp(0.3, 1.1));
        }
    }

    /// Adds warm paint to the wet shadow where there is bounced light.
    fn glow(&mut self, object: u8) {
        let wash =
            Wash { seed: 400 + 10 * u32::from(object), pigment: SIENNA, edge: 0.0, grain: 0.15, flow: 0.65, blooms: 0 };
        let lit: Vec<f32> = self.everywhere(|sheet, x, y| sheet.lit(x, y).0);
        let inside = self.of(object, |at, _, _| lit[at] < 0.6);
        let (bounce, sight) = (self.bounce.clone(), self.sight);
        self.lay(&wash, &inside, |at, x, y| {
            0.7 * ramp(0.10, 0.30, sight.smooth(&bounce, x, y)) * ramp(0.6, 0.2, lit[at])
        });
    }

    fn everywhere(&self, value: impl Fn(&Self, f32, f32) -> f32) -> Vec<f32> {
        let at = |at: usize| {
            let (x, y) = self.canvas.position(at);
            value(self, x, y)
        };
        (0..self.object.len()).map(at).collect()
    }

    /// Paints over flat objects with a broad brush while they dry. Overlapping strokes leave more paint.
    fn broad(&mut self, object: u8) {
        let sight = self.sight;
        let lying = self.lies(object);
        let absorbed = self.pigment(object).map(|c| -ln(c.clamp(0.02, 0.995)));
        for Place { key, x, y } in chance::places(1000 + u64::from(object), sight.width, sight.height, 9.0) {
            let word = |word: u64| chance::signed(&[key, word]);
            if word(3) < -0.2 || sight.object[sight.at(x, y)] != object {
                continue;
            }
            let tilt = if lying { [1.0, 0.06 * word(4)] } else { [0.9, -0.75 + 0.35 * word(4)] };
            let longest = 9.0 + 6.0 * word(5);
            let line = follow([x, y], 2.0, |_, _| tilt, |_, _, n| n as f32 <= longest);
            let dabs: Vec<Dab> = line
                .iter()
                .map(|&[x, y]| {
                    let sway = 1.2 * chance::noise(86, x / 9.0, y / 9.0);
                    Dab { x, y: y + sway, radius: (if lying { 2.6 } else { 4.6 }) * (1.0 + 0.3 * word(6)) }
                })
                .collect();
            for touch in self.canvas.touched(&dabs) {
                if self.object[touch.at] != object || self.inner[touch.at] < 0.8 {
                    continue;
                }
                let (lit, _) = self.lit(touch.x, touch.y);
                let edge = 0.55 + 0.9 * ramp(0.72, 0.97, touch.across.abs());
                let dry = ramp(0.9, 0.2, self.tooth[touch.at] + 0.5 * ramp(10.0, 40.0, touch.along));
                let density = (0.15 + 0.09 * word(7)) * (1.25 - 0.5 * lit) * touch.cover * edge * dry;
                let pixel = &mut self.canvas.pixels[touch.at];
                (0..3).for_each(|i| pixel[i] *= exp(-density * absorbed[i]));
            }
        }
    }

    /// Paints small strokes along the forms over the dry washes.
    fn strokes(&mut self) {
        let sight = self.sight;
        let mut taken = Near::new(sight.width, sight.height, 6.5);
        for Place { key, x, y } in chance::places(75, sight.width, sight.height, 3.0) {
            let word = |word: u64| chance::signed(&[key, word]);
            let (lit, thrown) = self.lit(x, y);
            let dark = (1.0 - lit - thrown).max(0.0);
            if chance::unit(&[key, 8]) > ramp(0.12, 0.6, dark)
                || sight.smooth(&sight.gloss, x, y) > 0.1
                || !taken.free(x, y, 0.0)
            {
                continue;
            }
            let at = sight.at(x, y);
            let object = sight.object[at];
            let direction = |x: f32, y: f32| {
                let n = sight.normal[sight.at(x, y)];
                let axis = [0.45f32, -0.80, 0.40];
                match sight.curved[usize::from(object)] > 0.05 {
                    true => [n[1] * axis[2] - n[2] * axis[1], n[2] * axis[0] - n[0] * axis[2]],
                    false if n[1] < -0.6 => [1.0, 0.08 * word(3)],
                    false => [0.8, -0.7 + 0.4 * word(3)],
                }
            };
            let longest = 2.0 + 5.0 * chance::unit(&[key, 9]);
            let line =
                follow([x, y], 1.5, direction, |x, y, n| n as f32 <= longest && sight.object[sight.at(x, y)] == object);
            line.iter().for_each(|p| taken.take(p[0], p[1]));
            let wide = 2.0 + 1.1 * word(4);
            let count = line.len() as f32;
            let dabs: Vec<Dab> = line
                .iter()
                .enumerate()
                .map(|(n, &[x, y])| Dab { x, y, radius: wide * (0.55 + 0.45 * ramp(0.0, 0.4, n as f32 / count)) })
                .collect();
            let base = self.pigment(object);
            let cold = if lit < 0.3 { ULTRAMARINE } else { VIOLET };
            let pigment: [f32; 3] = std::array::from_fn(|i| {
                let mixed = 0.5 + 0.4 * word(5);
                base[i] * (1.0 - mixed) + mixed * cold[i]
            });
            let absorbed = pigment.map(|c| -ln(c.clamp(0.02, 0.995)));
            for touch in self.canvas.touched(&dabs) {
                let edge = 0.65 + 0.8 * ramp(0.5, 0.95, touch.across * (0.6 + 0.4 * word(7)) + 0.2);
                let grain = 1.0 - 0.35 * self.tooth[touch.at];
                let spread = 0.45 + 1.1 * ramp(0.0, 9.0, touch.along);
                let density = (0.09 + 0.17 * dark) * (1.0 + 0.5 * word(6)) * spread * touch.cover * edge * grain;
                let pixel = &mut self.canvas.pixels[touch.at];
                (0..3).for_each(|i| pixel[i] *= exp(-density * absorbed[i]));
            }
        }
    }

    /// Paints the darkest areas, which receive no light.
    fn accents(&mut self) {
        let wash = Wash { seed: 500, pigment: INDIGO, edge: 0.4, grain: 0.35, flow: 0.35, blooms: 0 };
        let dim: Vec<f32> = self.everywhere(|sheet, x, y| {
            let (lit, thrown) = sheet.lit(x, y);
            lit + 4.0 * thrown + 0.015 * chance::cloud(510, x / 8.0, y / 8.0, 2)
        });
        for object in 0..self.sight.curved.len() as u8 {
            let inside = self.of(object, |at, _, _| dim[at] < 0.38);
            self.lay(&wash, &inside, |at, _, _| 0.6 * ramp(0.38, 0.16, dim[at]));
        }
    }
}

/// Returns the displacement by an unsteady hand, pixels.
fn unsteady(x: f32, y: f32) -> (f32, f32) {
    let far =
        |seed: u32| 1.3 * chance::noise(seed, x / 21.0, y / 21.0) + 0.5 * chance::noise(seed + 1, x / 5.0, y / 5.0);
    (far(40), far(44))
}

/// Height of cold-pressed paper.
fn tooth(x: f32, y: f32) -> f32 {
    let (u, v) = (x + 0.8 * chance::noise(22, x / 4.0, y / 4.0), y + 0.8 * chance::noise(23, x / 4.0, y / 4.0));
    0.75 * chance::noise(20, u / 2.3, v / 2.0) + 0.4 * chance::noise(21, u / 1.1, v / 1.1)
}
