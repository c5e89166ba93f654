//! Small light sources, by the pixels that see them.
//!
//! A lamp far away may be smaller than a pixel: of camera rays that go through random places of the pixel few meet it, and each of
//! those few counts for all. A path may as well begin by drawing a point on such a lamp. The lists say which lamps a pixel may see;
//! what is hidden is found out by the shadow ray. Nothing depends on their being complete: who is not listed is met by chance.

use crate::camera::KernelCamera;
use crate::lights::Lights;
use femc_math::gamma;
use femc_math::glam::{BVec3A, Vec3A};

/// Images of lamps that are larger than this, in pixels, are met by chance.
const LARGEST: f32 = 8.0;
/// A point whose place on the film is not known this well, in pixels, is not drawn.
const ACCURACY: f32 = 0.02;
/// Most entries of all lists, 12 bytes each; the lamps that send most to the camera come first.
const MOST: usize = 1 << 22;

/// The lists.
#[derive(Clone, Debug, Default)]
pub struct Sightings {
    /// By pixel, then by light.
    entries: Vec<Entry>,
    /// A bit for each pixel: whether it has a list.
    has_list: Vec<u64>,
}

#[derive(Clone, Copy, Debug)]
struct Entry {
    pixel: u32,
    light: u32,
    /// Share of the pixel's lights up to this one.
    up_to: f32,
}

/// The lights of one pixel.
#[derive(Clone, Copy, Debug)]
pub struct Seen<'a>(&'a [Entry]);

/// Where the image of a light is.
struct Image {
    low: [f32; 2],
    high: [f32; 2],
    /// What the light sends to the camera, at most.
    strength: f32,
}

impl Sightings {
    /// Of the `lights` that `camera` may see; `radius`: of the pixel filter, pixels.
    pub(crate) fn new(camera: &KernelCamera, lights: &Lights, radius: f32) -> Self {
        let mut images: Vec<(u32, Image)> = (0..lights.len() as u32)
            .filter(|&light| lights.may_be_met(light))
            .filter_map(|light| Some((light, image(camera, lights, light)?)))
            .collect();
        images.sort_by(|a, b| b.1.strength.total_cmp(&a.1.strength).then(a.0.cmp(&b.0)));
        let mut entries: Vec<Entry> = Vec::new();
        for (light, image) in images {
            // Pixels whose filter reaches the image.
            let [columns, rows] = [0, 1].map(|axis| {
                let last = i64::from(camera.film[axis]) - 1;
                let first = (image.low[axis] - radius - 0.5).ceil() as i64;
                first.max(0)..=((image.high[axis] + radius - 0.5).floor() as i64).min(last)
            });
            let pixels = rows.flat_map(|y| columns.clone().map(move |x| (x, y)));
            let pixels = pixels.map(|(x, y)| (y * i64::from(camera.film[0]) + x) as u32);
            entries.extend(pixels.map(|pixel| Entry { pixel, light, up_to: image.strength }));
            if entries.len() > MOST {
                break;
            }
        }
        entries.sort_by_key(|entry| (entry.pixel, entry.light));
        let pixels = camera.film[0] as usize * camera.film[1] as usize;
        let mut has_list = if entries.is_empty() { Vec::new() } else { vec![0; pixels.div_ceil(64)] };
        for list in entries.chunk_by_mut(|a, b| a.pixel == b.pixel) {
            let pixel = list[0].pixel as usize;
            has_list[pixel / 64] |= 1 << (pixel % 64);
            let total: f32 = list.iter().map(|entry| entry.up_to).sum();
            let mut sum = 0.0;
            for entry in list.iter_mut() {
                sum += entry.up_to;
                entry.up_to = sum / total;
            }
            if let Some(last) = list.last_mut() {
                last.up_to = 1.0;
            }
        }
        Self { entries, has_list }
    }

    /// The lights that a pixel (row-major index in the whole film) may see; `None`: no small ones.
    #[inline]
    pub fn of(&self, pixel: u32) -> Option<Seen<'_>> {
        let word = self.has_list.get(pixel as usize / 64)?;
        if word >> (pixel % 64) & 1 == 0 {
            return None;
        }
        let first = self.entries.partition_point(|entry| entry.pixel < pixel);
        let count = self.entries[first..].partition_point(|entry| entry.pixel == pixel);
        Some(Seen(&self.entries[first..first + count]))
    }
}

impl Seen<'_> {
    /// A light by `u` in [0, 1), and its probability.
    #[inline]
    pub fn choose(self, u: f32) -> (u32, f32) {
        let at = self.0[..self.0.len() - 1].partition_point(|entry| entry.up_to <= u);
        (self.0[at].light, self.share(at))
    }

    /// Probability with which [`Self::choose`] chooses a light; 0 of others.
    #[inline]
    pub fn probability(self, light: u32) -> f32 {
        self.0.binary_search_by_key(&light, |entry| entry.light).map_or(0.0, |at| self.share(at))
    }

    fn share(self, at: usize) -> f32 {
        self.0[at].up_to - if at > 0 { self.0[at - 1].up_to } else { 0.0 }
    }
}

/// Where a light is seen over the shutter; `None` where that is not on the film, too large, too near or too uncertain.
fn image(camera: &KernelCamera, lights: &Lights, light: u32) -> Option<Image> {
    let (bounds, power) = (lights.bounds(light), lights.power(light));
    let (mut low, mut high, mut near) = ([f32::INFINITY; 2], [f32::NEG_INFINITY; 2], f32::INFINITY);
    for view in camera.views() {
        for k in 0..8u32 {
            let corner = Vec3A::select(BVec3A::new(k & 1 > 0, k & 2 > 0, k & 4 > 0), bounds.max, bounds.min);
            let (place, depth) = view.project(corner)?;
            let blur = camera.blur(depth);
            let distance = (corner - view.origin).length();
            near = near.min(distance);
            // Rounding of coordinates, as an angle, in pixels.
            let rounding = (corner.abs() + view.origin.abs()).max_element() * gamma(4) / distance;
            if rounding > ACCURACY * view.solid_angle(place).sqrt() {
                return None;
            }
            for axis in 0..2 {
                low[axis] = low[axis].min(place[axis] - blur);
                high[axis] = high[axis].max(place[axis] + blur);
            }
        }
    }
    let is_small = (0..2).all(|axis| high[axis] - low[axis] <= LARGEST);
    let is_on_film = (0..2).all(|axis| high[axis] >= -2.0 && low[axis] <= camera.film[axis] as f32 + 2.0);
    let strength = power / (near * near);
    (is_small && is_on_film && strength > 0.0 && strength.is_finite()).then_some(Image { low, high, strength })
}
