//! The painter's view of a render: objects and their forms, with separate light, bounced light and gloss.

use crate::{Guides, PainterError};
use femc_film::{Image, ToneCurve, tone};
use femc_math::elementary::tan;
use std::collections::BTreeMap;

/// Half of the assumed field of view, degrees, because depth alone does not determine it. A wrong value makes forms look flatter or
/// rounder.
const HALF_VIEW: f32 = 15.0;
/// Albedo difference of neighbors, summed over all channels, below which they belong to one object.
const MAX_ALBEDO_DIFFERENCE: f32 = 0.03;
/// Size in pixels below which an object is merged into its surroundings: mostly edges of mixed pixels.
const SMALL: usize = 60;

/// Planes of the painter's view, row by row and of the picture's size. Positions are in pixels: the center of the first pixel is
/// (0.5, 0.5).
#[derive(Clone, Debug)]
pub struct RenderView {
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Displayed picture, sRGB in 0..1.
    pub displayed: Vec<[f32; 3]>,
    /// Luma of the displayed picture.
    pub luma: Vec<f32>,
    /// Color of the surface itself, sRGB in 0..1.
    pub local_color: Vec<[f32; 3]>,
    /// Direct light on the surface. The value 1 is exceeded by one pixel in fifty.
    pub light: Vec<f32>,
    /// Direct light divided by the square root of the object's brightest light, so that weakly lit objects are painted half as dark
    /// as they are.
    pub balanced_light: Vec<f32>,
    /// Light from other surfaces, in the same unit as `light`.
    pub bounce: Vec<f32>,
    /// Strength of the highlight, 0..1.
    pub gloss: Vec<f32>,
    /// Unit normal: x to the right, y down, z toward the eye.
    pub normal: Vec<[f32; 3]>,
    /// Number of the object; the largest object has number 0.
    pub object: Vec<u8>,
    /// Curvature of each object: 0 for a plane, about 0.5 for a ball.
    pub curvature: Vec<f32>,
}

impl RenderView {
    /// Analyzes a render.
    /// - errors: it has no direct light.
    pub fn from_guides(guides: &Guides) -> Result<Self, PainterError> {
        let (width, height) = (guides.width as usize, guides.height as usize);
        let layer = |number: usize| guides.layers[number].iter().map(|&color| finite(color)).collect::<Vec<_>>();
        let [full, direct, specular, bounced] = [layer(0), layer(1), layer(2), layer(4)];
        let albedo: Vec<_> = guides.albedo.iter().map(|&color| finite(color)).collect();
        let image = Image { width: guides.width, height: guides.height, pixels: full };
        let curve = ToneCurve::auto([&image]);
        let displayed: Vec<_> = image.pixels.iter().map(|&color| curve.display(color)).collect();
        let fallen = |layer: &[[f32; 3]]| -> Vec<f32> {
            layer.iter().zip(&albedo).map(|(&light, &albedo)| luma(light) / luma(albedo).max(0.02)).collect()
        };
        let (mut light, mut bounce) = (fallen(&direct), fallen(&bounced));
        let most = percentile_98(&light);
        if !(most > 0.0 && most.is_finite()) {
            return Err(PainterError::Dark);
        }
        light.iter_mut().chain(&mut bounce).for_each(|value| *value /= most);
        let mut gloss: Vec<f32> = specular.iter().map(|&color| luma(color)).collect();
        // A highlight counts where it is as bright as the lit area beside it.
        let glaring = gloss
            .iter()
            .copied()
            .fold(0.0, f32::max)
            .max(0.2 * percentile_98(&direct.iter().map(|&c| luma(c)).collect::<Vec<_>>()));
        gloss.iter_mut().for_each(|value| *value /= glaring);
        let object = segment_objects(width, height, &albedo);
        let normal = normals(width, height, &guides.depth, &object);
        let balanced_light = balance_light(&light, &object);
        let curvature = object_curvature(&normal, &object);
        Ok(Self {
            width,
            height,
            luma: displayed.iter().map(|&color| luma(color)).collect(),
            displayed,
            local_color: albedo.iter().map(|color| color.map(|c| tone::srgb(c.clamp(0.0, 1.0)))).collect(),
            light,
            balanced_light,
            bounce,
            gloss,
            normal,
            object,
            curvature,
        })
    }

    /// Returns the index of the pixel at a position. Positions outside use the nearest pixel.
    pub fn pixel_index(&self, x: f32, y: f32) -> usize {
        let column = x.clamp(0.0, (self.width - 1) as f32) as usize;
        let row = y.clamp(0.0, (self.height - 1) as f32) as usize;
        row * self.width + column
    }

    /// Interpolates a plane between pixel centers.
    pub fn interpolate(&self, plane: &[f32], x: f32, y: f32) -> f32 {
        let (x, y) = ((x - 0.5).clamp(0.0, (self.width - 1) as f32), (y - 0.5).clamp(0.0, (self.height - 1) as f32));
        let (column, row) =
            ((x as usize).min(self.width.saturating_sub(2)), (y as usize).min(self.height.saturating_sub(2)));
        let (u, v) = (x - column as f32, y - row as f32);
        let (right, below) = ((column + 1).min(self.width - 1), (row + 1).min(self.height - 1));
        let value = |column: usize, row: usize| plane[row * self.width + column];
        let top = value(column, row) + u * (value(right, row) - value(column, row));
        let bottom = value(column, below) + u * (value(right, below) - value(column, below));
        top + v * (bottom - top)
    }

    /// Blurs a plane within objects: averages a square of `radius` pixels to each side.
    pub fn blurred(&self, plane: &[f32], radius: usize) -> Vec<f32> {
        combine_within_object(self.width, self.height, &self.object, radius, |at, sum: &mut (f32, f32)| {
            sum.0 += plane[at];
            sum.1 += 1.0;
        })
        .into_iter()
        .map(|(sum, count)| sum / count)
        .collect()
    }
}

/// Replaces values that are not finite by black.
fn finite(color: [f32; 3]) -> [f32; 3] {
    color.map(|c| if c.is_finite() { c } else { 0.0 })
}

/// Computes Rec.709 luma or luminance.
pub fn luma(color: [f32; 3]) -> f32 {
    0.2126 * color[0] + 0.7152 * color[1] + 0.0722 * color[2]
}

/// Returns the value that one in fifty values exceeds.
fn percentile_98(values: &[f32]) -> f32 {
    let mut sorted = values.to_vec();
    sorted.sort_by(f32::total_cmp);
    sorted.get(sorted.len() * 49 / 50).copied().unwrap_or(0.0)
}

fn balance_light(light: &[f32], object: &[u8]) -> Vec<f32> {
    let count = object.iter().copied().max().map_or(0, |most| usize::from(most) + 1);
    let most = |number: usize| {
        let of_it = light.iter().zip(object).filter(|(_, o)| usize::from(**o) == number);
        percentile_98(&of_it.map(|(&light, _)| light).collect::<Vec<_>>()).max(1e-3)
    };
    let most: Vec<f32> = (0..count).map(most).collect();
    light.iter().zip(object).map(|(light, &number)| light / most[usize::from(number)].sqrt()).collect()
}

/// Combines, for each pixel, the pixels of its object in the surrounding square with `add`.
fn combine_within_object<T: Clone + Default>(
    width: usize,
    height: usize,
    object: &[u8],
    radius: usize,
    add: impl Fn(usize, &mut T),
) -> Vec<T> {
    let mut sums = vec![T::default(); width * height];
    for (at, sum) in sums.iter_mut().enumerate() {
        let (column, row) = (at % width, at / width);
        for y in row.saturating_sub(radius)..(row + radius + 1).min(height) {
            for x in column.saturating_sub(radius)..(column + radius + 1).min(width) {
                if object[y * width + x] == object[at] {
                    add(y * width + x, sum);
                }
            }
        }
    }
    sums
}

/// Finds regions of similar albedo, sorted by size. Small regions are merged into a neighbor.
fn segment_objects(width: usize, height: usize, albedo: &[[f32; 3]]) -> Vec<u8> {
    const NONE: usize = usize::MAX;
    let mut region = vec![NONE; width * height];
    let mut sizes = Vec::new();
    let neighbors = |at: usize| {
        let (column, row) = (at % width, at / width);
        let left = (column > 0).then(|| at - 1);
        let right = (column + 1 < width).then(|| at + 1);
        let above = (row > 0).then(|| at - width);
        let below = (row + 1 < height).then(|| at + width);
        [left, right, above, below].into_iter().flatten()
    };
    for start in 0..region.len() {
        if region[start] != NONE {
            continue;
        }
        let number = sizes.len();
        let mut size = 0;
        let mut open = vec![start];
        region[start] = number;
        while let Some(at) = open.pop() {
            size += 1;
            for next in neighbors(at) {
                let unlike: f32 = (0..3).map(|i| (albedo[at][i] - albedo[next][i]).abs()).sum();
                if region[next] == NONE && unlike < MAX_ALBEDO_DIFFERENCE {
                    region[next] = number;
                    open.push(next);
                }
            }
        }
        sizes.push(size);
    }
    let mut order: Vec<usize> = (0..sizes.len()).collect();
    order.sort_by_key(|&number| std::cmp::Reverse(sizes[number]));
    let kept: BTreeMap<usize, u8> = order
        .iter()
        .enumerate()
        .filter(|(rank, number)| *rank == 0 || (*rank < 250 && sizes[**number] >= SMALL))
        .map(|(rank, &number)| (number, rank as u8))
        .collect();
    let mut object: Vec<Option<u8>> = region.iter().map(|number| kept.get(number).copied()).collect();
    while object.iter().any(Option::is_none) {
        let grown: Vec<_> =
            (0..object.len()).map(|at| object[at].or_else(|| neighbors(at).find_map(|n| object[n]))).collect();
        object = grown;
    }
    object.into_iter().map(|number| number.unwrap_or(0)).collect()
}

fn normals(width: usize, height: usize, depth: &[f32], object: &[u8]) -> Vec<[f32; 3]> {
    let scale = 2.0 * tan(HALF_VIEW.to_radians()) / width as f32;
    let place = |at: usize| {
        let (x, y) =
            (scale * ((at % width) as f32 - 0.5 * width as f32), scale * ((at / width) as f32 - 0.5 * height as f32));
        let far = depth[at];
        [far * x, far * y, -far]
    };
    // Vector between the farthest pixels of the object on both sides, at most three away.
    let along = |at: usize, forth: usize, room: [usize; 2], step: usize| {
        let reach = |steps: usize, sign: isize| {
            (1..=steps.min(forth))
                .map(|n| at.wrapping_add_signed(sign * (n * step) as isize))
                .take_while(|&p| object[p] == object[at])
                .last()
                .unwrap_or(at)
        };
        let (a, b) = (place(reach(room[0], -1)), place(reach(room[1], 1)));
        [b[0] - a[0], b[1] - a[1], b[2] - a[2]]
    };
    let rough: Vec<[f32; 3]> = (0..depth.len())
        .map(|at| {
            let (column, row) = (at % width, at / width);
            let u = along(at, 3, [column, width - 1 - column], 1);
            let v = along(at, 3, [row, height - 1 - row], width);
            unit([v[1] * u[2] - v[2] * u[1], v[2] * u[0] - v[0] * u[2], v[0] * u[1] - v[1] * u[0]])
        })
        .collect();
    let sums = combine_within_object(width, height, object, 3, |at, sum: &mut [f32; 3]| {
        (0..3).for_each(|i| sum[i] += rough[at][i]);
    });
    sums.into_iter().map(unit).collect()
}

/// Returns a unit vector that faces the eye. For a zero vector, returns the direction to the eye.
fn unit(v: [f32; 3]) -> [f32; 3] {
    let length = (v[0] * v[0] + v[1] * v[1] + v[2] * v[2]).sqrt();
    if !(length > 0.0 && length.is_finite()) {
        return [0.0, 0.0, 1.0];
    }
    let sign = if v[2] < 0.0 { -1.0 } else { 1.0 };
    v.map(|c| sign * c / length)
}

fn object_curvature(normal: &[[f32; 3]], object: &[u8]) -> Vec<f32> {
    let count = object.iter().copied().max().map_or(0, |most| usize::from(most) + 1);
    let mut sums = vec![([0.0f32; 3], 0.0f32); count];
    for (n, &number) in normal.iter().zip(object) {
        let (sum, pixels) = &mut sums[usize::from(number)];
        (0..3).for_each(|i| sum[i] += n[i]);
        *pixels += 1.0;
    }
    let length = |v: [f32; 3]| (v[0] * v[0] + v[1] * v[1] + v[2] * v[2]).sqrt();
    sums.into_iter().map(|(sum, pixels)| 1.0 - length(sum) / pixels.max(1.0)).collect()
}
