//! Pen and ink: strokes along the form on toned paper. Darker areas have more crossing layers, in a warm ink in the half shadow and
//! a cold one in the dark. Highlights and well-lit areas stay paper. The strokes of a layer are streamlines that keep their
//! distance (\[jobard1997\]).

use crate::canvas::{Canvas, Dab, mix, smoothstep, trace_streamline};
use crate::outline::{PointGrid, STEP, outlines};
use crate::{RenderView, random, random::StrokeStart};
use femc_film::Picture;
use femc_math::elementary::pow;

const PAPER: [f32; 3] = [0.965, 0.935, 0.865];
const SEPIA: [f32; 3] = [0.44, 0.24, 0.13];
const UMBER: [f32; 3] = [0.24, 0.15, 0.14];
const INDIGO: [f32; 3] = [0.10, 0.14, 0.36];

/// Layer of strokes of one direction.
struct Layer {
    /// Darkness above which there are strokes.
    min_darkness: f32,
    /// Distance between strokes, pixels.
    spacing: f32,
    ink: [f32; 3],
    /// Axis around which strokes run on round objects.
    axis: [f32; 3],
    /// Direction on horizontal surfaces, followed by that on vertical ones.
    lying: [f32; 2],
    standing: [f32; 2],
}

const LAYERS: [Layer; 5] = [
    Layer {
        min_darkness: 0.20,
        spacing: 4.6,
        ink: SEPIA,
        axis: [0.42, -0.86, 0.30],
        lying: [1.0, 0.06],
        standing: [1.0, -0.95],
    },
    Layer {
        min_darkness: 0.42,
        spacing: 4.4,
        ink: SEPIA,
        axis: [-0.25, -0.90, 0.36],
        lying: [1.0, -0.28],
        standing: [1.0, -0.45],
    },
    Layer {
        min_darkness: 0.60,
        spacing: 4.2,
        ink: UMBER,
        axis: [0.85, -0.42, 0.32],
        lying: [1.0, 0.42],
        standing: [0.25, -1.0],
    },
    Layer {
        min_darkness: 0.70,
        spacing: 3.7,
        ink: INDIGO,
        axis: [0.15, -0.80, -0.58],
        lying: [0.9, -0.75],
        standing: [1.0, 0.30],
    },
    Layer {
        min_darkness: 0.83,
        spacing: 3.1,
        ink: INDIGO,
        axis: [0.70, 0.55, 0.45],
        lying: [1.0, 0.12],
        standing: [0.6, -1.0],
    },
];

/// Paints a picture in this style.
pub fn paint(view: &RenderView) -> Picture {
    let mut canvas = Canvas::new(view.width, view.height, PAPER);
    for at in 0..canvas.pixels.len() {
        let (x, y) = canvas.position(at);
        let grain = 0.018 * tooth(x, y) + 0.02 * random::cloud(5, x / 70.0, y / 50.0, 3);
        canvas.pixels[at] = PAPER.map(|c| c + grain);
    }
    let dark = darkness(view);
    for (number, layer) in LAYERS.iter().enumerate() {
        hatch(&mut canvas, view, &dark, number as u64, layer);
    }
    contours(&mut canvas, view, &dark);
    canvas.picture()
}

/// Roughness of the paper, about -1..1.
fn tooth(x: f32, y: f32) -> f32 {
    0.6 * random::noise(11, x / 1.3, y / 1.3) + 0.5 * random::noise(12, x / 3.1, y / 2.6)
}

/// Computes the darkness that is drawn, 0..1: it depends less on the objects' colors, and highlights stay paper.
fn darkness(view: &RenderView) -> Vec<f32> {
    let value = |at: usize| {
        let local = 0.6 + 0.4 * crate::render_view::luma(view.local_color[at]);
        let lit = local * (0.5 * (view.light[at] + view.balanced_light[at]) + 0.6 * view.bounce[at]);
        (1.06 - 1.08 * pow(lit.max(0.0), 0.62) - 1.2 * view.gloss[at]).clamp(0.0, 1.0)
    };
    view.blurred(&(0..view.luma.len()).map(value).collect::<Vec<_>>(), 1)
}

fn direction(view: &RenderView, layer: &Layer, x: f32, y: f32) -> [f32; 2] {
    let at = view.pixel_index(x, y);
    let (n, a) = (view.normal[at], layer.axis);
    if view.curvature[usize::from(view.object[at])] > 0.05 {
        [n[1] * a[2] - n[2] * a[1], n[2] * a[0] - n[0] * a[2]]
    } else if n[1] < -0.6 {
        layer.lying
    } else {
        layer.standing
    }
}

fn hatch(canvas: &mut Canvas, view: &RenderView, dark: &[f32], number: u64, layer: &Layer) {
    let step = 1.5;
    let mut taken = PointGrid::new(view.width, view.height, layer.spacing);
    for StrokeStart { key, x, y } in random::stroke_starts(40 + number, view.width, view.height, 2.0) {
        let word = |word: u64| random::signed(&[key, word]);
        let object = view.object[view.pixel_index(x, y)];
        // Strokes begin and end slightly early or late.
        let enough = layer.min_darkness + 0.07 * word(3);
        let dark_at = |x: f32, y: f32| view.interpolate(dark, x, y);
        if dark_at(x, y) < enough || !taken.is_free(x, y, 0.0) {
            continue;
        }
        let longest = (19.0 + 9.0 * word(4)) / step;
        let line = trace_streamline(
            [x, y],
            step,
            |x, y| direction(view, layer, x, y),
            |x, y, n| {
                let within = x > -2.0 && y > -2.0 && x < view.width as f32 + 2.0 && y < view.height as f32 + 2.0;
                within
                    && (n as f32) < longest
                    && view.object[view.pixel_index(x, y)] == object
                    && dark_at(x, y) > enough
                    && taken.is_free(x, y, 0.5 * layer.spacing)
            },
        );
        if line.len() < 4 {
            continue;
        }
        line.iter().for_each(|p| taken.insert(p[0], p[1]));
        let dabs: Vec<Dab> = line
            .iter()
            .enumerate()
            .map(|(n, &[x, y])| {
                let t = n as f32 / (line.len() - 1) as f32;
                let pressed = smoothstep(0.0, 0.18, t) * smoothstep(1.0, 0.55, t);
                let much = smoothstep(layer.min_darkness - 0.04, layer.min_darkness + 0.34, dark_at(x, y));
                let sway = 0.35 * random::noise(60 + number as u32, 0.11 * (x + 31.0 * word(5)), 0.11 * y);
                Dab { x: x + sway, y: y - sway, radius: 0.16 + (0.16 + 0.40 * much) * pressed }
            })
            .collect();
        draw_stroke(canvas, &dabs, tint_ink(layer.ink, view.local_color[view.pixel_index(x, y)]), 0.86 + 0.1 * word(6));
    }
}

/// Mixes the ink with a little of the object's color, less for darker inks.
fn tint_ink(ink: [f32; 3], local: [f32; 3]) -> [f32; 3] {
    let gray = crate::render_view::luma(local);
    let mixed = std::array::from_fn(|i| (ink[i] + 0.9 * (local[i] - gray)).clamp(0.04, 0.7));
    mix(ink, mixed, (4.5 * (crate::render_view::luma(ink) - 0.1)).clamp(0.0, 0.8))
}

/// Draws a stroke of the pen, which skips hollows of the paper.
fn draw_stroke(canvas: &mut Canvas, dabs: &[Dab], color: [f32; 3], strength: f32) {
    for touch in canvas.covered_pixels(dabs) {
        let held = smoothstep(-0.95, -0.35, tooth(touch.x, touch.y));
        canvas.glaze(touch.at, color, touch.cover * strength * (0.35 + 0.65 * held));
    }
}

/// Draws outlines, heavy in the dark and missing in the light.
fn contours(canvas: &mut Canvas, view: &RenderView, dark: &[f32]) {
    for outline in outlines(view) {
        for (number, piece) in outline.points.chunks((26.0 / STEP) as usize).enumerate() {
            // Two strokes of the pen that do not quite meet.
            for go in 0..2u64 {
                let word = |word: u64| random::signed(&[50, outline.object.into(), number as u64, go, word]);
                let dabs: Vec<Dab> = piece
                    .iter()
                    .enumerate()
                    .map(|(n, &[x, y])| {
                        let t = n as f32 / piece.len() as f32;
                        let darkest = [(2.5, 0.0), (-2.5, 0.0), (0.0, 2.5), (0.0, -2.5)]
                            .map(|(u, v)| view.interpolate(dark, x + u, y + v))
                            .into_iter()
                            .fold(0.0, f32::max);
                        let off = 0.5 * word(1) + 0.8 * word(2) * (t - 0.5);
                        let pressed = 0.35 + 0.65 * smoothstep(0.0, 0.2, t) * smoothstep(1.0, 0.7, t);
                        Dab {
                            x: x + off,
                            y: y - 0.6 * off,
                            radius: (0.26 + 0.55 * smoothstep(0.15, 0.8, darkest)) * pressed,
                        }
                    })
                    .collect();
                draw_stroke(canvas, &dabs, UMBER, 0.9);
            }
        }
    }
}
