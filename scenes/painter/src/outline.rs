//! Outlines of objects, and of light and shadow on them, as lines.

use crate::RenderView;
use crate::canvas::trace_streamline;

/// Distance between points of an outline, pixels.
pub const STEP: f32 = 1.0;
/// Distance below which two lines are merged, pixels.
const MIN_LINE_DISTANCE: f32 = 3.0;

/// A line, or a piece of one.
#[derive(Clone, Debug)]
pub struct Line {
    /// Object that the line outlines, or lies on.
    pub object: u8,
    /// Points, [`STEP`] apart.
    pub points: Vec<[f32; 2]>,
}

/// Returns the lines where objects meet, each once, smoothed over a pixel or two. Round objects come first, because they are mostly
/// in front of others.
pub fn outlines(view: &RenderView) -> Vec<Line> {
    let mut drawn = PointGrid::new(view.width, view.height, MIN_LINE_DISTANCE);
    let mut objects: Vec<u8> = (0..view.curvature.len() as u8).collect();
    let curved = |object: u8| view.curvature[usize::from(object)];
    objects.sort_by(|&a, &b| curved(b).total_cmp(&curved(a)));
    let mut lines = Vec::new();
    for object in objects {
        let found = contours(view, &object_mask(view, object), 0.5, &mut drawn, |_, _| true);
        lines.extend(found.into_iter().map(|points| Line { object, points }));
    }
    lines
}

/// Returns the lines on which `plane` has the value `level`, on each object separately.
/// - `keep`: whether a line may pass through a point.
pub fn level_lines(view: &RenderView, plane: &[f32], level: f32, keep: impl Fn(f32, f32) -> bool) -> Vec<Line> {
    let mut lines = Vec::new();
    for object in 0..view.curvature.len() as u8 {
        let mut drawn = PointGrid::new(view.width, view.height, MIN_LINE_DISTANCE);
        let on_it = |x: f32, y: f32| view.object[view.pixel_index(x, y)] == object && keep(x, y);
        let found = contours(view, plane, level, &mut drawn, on_it);
        lines.extend(found.into_iter().map(|points| Line { object, points }));
    }
    lines
}

fn contours(
    view: &RenderView,
    plane: &[f32],
    level: f32,
    drawn: &mut PointGrid,
    keep: impl Fn(f32, f32) -> bool,
) -> Vec<Vec<[f32; 2]>> {
    let mut lines = Vec::new();
    let direction = |x: f32, y: f32| {
        let value = |dx: f32, dy: f32| view.interpolate(plane, x + dx, y + dy);
        let (gx, gy) = (0.5 * (value(1.0, 0.0) - value(-1.0, 0.0)), 0.5 * (value(0.0, 1.0) - value(0.0, -1.0)));
        [-gy, gx]
    };
    for at in 0..plane.len() {
        let (column, row) = (at % view.width, at / view.width);
        let crossed = |next: usize| (plane[at] < level) != (plane[next] < level);
        if !(column + 1 < view.width && crossed(at + 1) || row + 1 < view.height && crossed(at + view.width)) {
            continue;
        }
        let start = [column as f32 + 0.5, row as f32 + 0.5];
        if !keep(start[0], start[1]) || !drawn.is_free(start[0], start[1], 0.0) {
            continue;
        }
        let mut taken: Vec<[f32; 2]> = Vec::new();
        let points = trace_streamline(start, STEP, direction, |x, y, n| {
            let within = x > -1.0 && y > -1.0 && x < view.width as f32 + 1.0 && y < view.height as f32 + 1.0;
            let met = taken.iter().rev().skip(8).any(|p| (p[0] - x).abs() + (p[1] - y).abs() < 1.5);
            taken.push([x, y]);
            within && n < 4000 && !met && keep(x, y) && drawn.is_free(x, y, 0.0)
        });
        if points.len() > 6 {
            points.iter().for_each(|p| drawn.insert(p[0], p[1]));
            lines.push(points);
        }
    }
    lines
}

/// Returns 1 inside the object, 0 outside, and a slope in between.
fn object_mask(view: &RenderView, object: u8) -> Vec<f32> {
    let sharp: Vec<f32> = view.object.iter().map(|&number| f32::from(u8::from(number == object))).collect();
    let soft = blur(view, &sharp);
    blur(view, &soft)
}

fn blur(view: &RenderView, plane: &[f32]) -> Vec<f32> {
    let (width, height) = (view.width, view.height);
    let mean = |at: usize| {
        let (column, row) = (at % width, at / width);
        let (mut sum, mut count) = (0.0, 0.0);
        for y in row.saturating_sub(1)..(row + 2).min(height) {
            for x in column.saturating_sub(1)..(column + 2).min(width) {
                sum += plane[y * width + x];
                count += 1.0;
            }
        }
        sum / count
    };
    (0..plane.len()).map(mean).collect()
}

/// Set of occupied points, which keeps lines apart.
#[derive(Clone, Debug)]
pub struct PointGrid {
    columns: usize,
    rows: usize,
    cell: f32,
    points: Vec<Vec<[f32; 2]>>,
}

impl PointGrid {
    /// Creates an empty set for a picture of this size in pixels. `apart` is the greatest distance for queries.
    pub fn new(width: usize, height: usize, apart: f32) -> Self {
        let cells = |pixels: usize| (pixels as f32 / apart) as usize + 1;
        let (columns, rows) = (cells(width), cells(height));
        Self { columns, rows, cell: apart, points: vec![Vec::new(); columns * rows] }
    }

    fn cell(&self, x: f32, y: f32) -> (usize, usize) {
        let index = |v: f32, count: usize| ((v / self.cell).max(0.0) as usize).min(count - 1);
        (index(x, self.columns), index(y, self.rows))
    }

    /// Adds a point.
    pub fn insert(&mut self, x: f32, y: f32) {
        let (column, row) = self.cell(x, y);
        self.points[row * self.columns + column].push([x, y]);
    }

    /// Checks that no point is closer than `apart`; 0 means the greatest distance.
    pub fn is_free(&self, x: f32, y: f32, apart: f32) -> bool {
        let apart = if apart > 0.0 { apart.min(self.cell) } else { self.cell };
        let (column, row) = self.cell(x, y);
        for r in row.saturating_sub(1)..(row + 2).min(self.rows) {
            for c in column.saturating_sub(1)..(column + 2).min(self.columns) {
                let close = |p: &[f32; 2]| (p[0] - x) * (p[0] - x) + (p[1] - y) * (p[1] - y) < apart * apart;
                if self.points[r * self.columns + c].iter().any(close) {
                    return false;
                }
            }
        }
        true
    }
}
