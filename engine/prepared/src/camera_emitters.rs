//! Lists of small light sources by the pixels that see them.
//!
//! A distant lamp may be smaller than a pixel, or fill only a part of one. Few camera rays through random positions of the pixel
//! hit it, so each hit has a large weight and the pixel is noisy. Instead, a path may begin by sampling a point on such a lamp. The
//! lists contain the lamps that a pixel may see; a shadow ray tests whether they are hidden. Correctness does not depend on
//! complete lists, because camera rays still hit unlisted lamps by chance.
//!
//! For a flat polygon and a stationary pinhole camera, the outline on the film is known. A position is sampled in the part of the
//! outline that the pixel's filter reaches, so the lamp's share of the pixel has no variance. For other lamps, a point anywhere on
//! the lamp is sampled.

use crate::camera::KernelCamera;
use crate::compile::NONE;
use crate::film_polygon::FilmPolygon;
use crate::lights::Lights;
use femc_math::gamma;
use femc_math::glam::{BVec3A, Vec3A};

/// Maximum image size, in pixels, of listed lamps without an outline. Camera rays hit larger ones by chance.
const MAX_IMAGE_SIZE: f32 = 8.0;
/// Maximum image size, in pixels, of listed lamps with an outline. Only pixels at its border are listed.
const MAX_POLYGON_SIZE: f32 = 256.0;
/// Minimum area of a part of an outline, pixels2, for which a pixel is listed.
const MIN_PART_AREA: f32 = 1e-7;
/// Maximum uncertainty of a point's position on the film, in pixels.
const MAX_UNCERTAINTY: f32 = 0.02;
/// Maximum number of entries of all lists, 16 bytes each. The lamps that send most light to the camera come first.
const MAX_ENTRIES: usize = 1 << 22;

/// Lists of small lights for all pixels.
#[derive(Clone, Debug, Default)]
pub struct CameraEmitters {
    /// Entries, sorted by pixel, then by light.
    entries: Vec<ListedEmitter>,
    polygons: Vec<FilmPolygon>,
    /// Radius of the pixel filter, pixels.
    radius: f32,
    /// One bit per pixel: whether it has a list.
    has_list: Vec<u64>,
}

#[derive(Clone, Copy, Debug)]
struct ListedEmitter {
    pixel: u32,
    light: u32,
    /// Cumulative share of the pixel's lights up to and including this one.
    cumulative_share: f32,
    /// Number of its outline, or `NONE`.
    polygon: u32,
}

/// Lights of one pixel.
#[derive(Clone, Copy, Debug)]
pub struct PixelEmitters<'a> {
    entries: &'a [ListedEmitter],
    all: &'a CameraEmitters,
}

/// A chosen light.
#[derive(Clone, Copy, Debug)]
pub struct EmitterChoice {
    /// Index of the light.
    pub light: u32,
    /// Probability of the choice.
    pub probability: f32,
    /// Part of the light's outline on the film that the pixel's filter reaches. `None` means that a point on the light must be
    /// sampled.
    pub part: Option<FilmPolygon>,
}

/// Image of a light on the film.
struct Image {
    low: [f32; 2],
    high: [f32; 2],
    /// Maximum light that the lamp sends to the camera, lm/m2.
    strength: f32,
    polygon: Option<FilmPolygon>,
}

impl CameraEmitters {
    /// Lists the `lights` that `camera` may see. `radius`: radius of the pixel filter, pixels.
    pub(crate) fn new(camera: &KernelCamera, lights: &Lights, radius: f32) -> Self {
        let image = |light| polygon_image(camera, lights, light).or_else(|| bounds_image(camera, lights, light));
        let mut images: Vec<(u32, Image)> = (0..lights.len() as u32)
            .filter(|&light| lights.can_be_hit(light))
            .filter_map(|light| Some((light, image(light)?)))
            .collect();
        images.sort_by(|a, b| b.1.strength.total_cmp(&a.1.strength).then(a.0.cmp(&b.0)));
        let mut all = Self { radius, ..Self::default() };
        for (light, image) in images {
            all.list_emitter(camera, light, &image);
            if all.entries.len() > MAX_ENTRIES {
                break;
            }
        }
        all.normalize_shares(camera.film);
        all
    }

    /// Lists a light for the pixels whose filter reaches its image.
    fn list_emitter(&mut self, camera: &KernelCamera, light: u32, image: &Image) {
        let radius = self.radius;
        let [columns, rows] = [0, 1].map(|axis| {
            let last = i64::from(camera.film[axis]) - 1;
            let first = (image.low[axis] - radius - 0.5).ceil() as i64;
            first.max(0)..=((image.high[axis] + radius - 0.5).floor() as i64).min(last)
        });
        let number = if image.polygon.is_some() { self.polygons.len() as u32 } else { NONE };
        let whole = image.polygon.map(|outline| outline.area());
        for (x, y) in rows.flat_map(|y| columns.clone().map(move |x| (x, y))) {
            let pixel = (y * i64::from(camera.film[0]) + x) as u32;
            let mut strength = image.strength;
            if let (Some(outline), Some(whole)) = (image.polygon, whole) {
                let area = clip_to_filter(&outline, camera.center(pixel), radius).area();
                let footprint = 4.0 * radius * radius;
                if area < MIN_PART_AREA || area > (1.0 - 1e-4) * footprint {
                    continue;
                }
                strength *= area / whole;
            }
            self.entries.push(ListedEmitter { pixel, light, cumulative_share: strength, polygon: number });
        }
        self.polygons.extend(image.polygon);
    }

    /// Converts the strengths of each pixel's lights to cumulative shares.
    fn normalize_shares(&mut self, film: [u32; 2]) {
        self.entries.sort_by_key(|entry| (entry.pixel, entry.light));
        let pixels = film[0] as usize * film[1] as usize;
        self.has_list = if self.entries.is_empty() { Vec::new() } else { vec![0; pixels.div_ceil(64)] };
        for list in self.entries.chunk_by_mut(|a, b| a.pixel == b.pixel) {
            let pixel = list[0].pixel as usize;
            self.has_list[pixel / 64] |= 1 << (pixel % 64);
            let total: f32 = list.iter().map(|entry| entry.cumulative_share).sum();
            let mut sum = 0.0;
            for entry in list.iter_mut() {
                sum += entry.cumulative_share;
                entry.cumulative_share = sum / total;
            }
            if let Some(last) = list.last_mut() {
                last.cumulative_share = 1.0;
            }
        }
    }

    /// Returns the lights that a pixel (row-major index in the whole film) may see; `None` if there are no small ones.
    #[inline]
    pub fn get(&self, pixel: u32) -> Option<PixelEmitters<'_>> {
        let word = self.has_list.get(pixel as usize / 64)?;
        if word >> (pixel % 64) & 1 == 0 {
            return None;
        }
        let first = self.entries.partition_point(|entry| entry.pixel < pixel);
        let count = self.entries[first..].partition_point(|entry| entry.pixel == pixel);
        Some(PixelEmitters { entries: &self.entries[first..first + count], all: self })
    }
}

impl PixelEmitters<'_> {
    /// Chooses a light with `u` in [0, 1).
    /// - `center`: center of the pixel, on the film.
    #[inline]
    pub fn choose(self, u: f32, center: [f32; 2]) -> EmitterChoice {
        let at = self.entries[..self.entries.len() - 1].partition_point(|entry| entry.cumulative_share <= u);
        self.choice_at(at, center)
    }

    /// Returns the choice of a given light; `None` if it is not listed.
    #[inline]
    pub fn find(self, light: u32, center: [f32; 2]) -> Option<EmitterChoice> {
        self.entries.binary_search_by_key(&light, |entry| entry.light).ok().map(|at| self.choice_at(at, center))
    }

    fn choice_at(self, at: usize, center: [f32; 2]) -> EmitterChoice {
        let entry = &self.entries[at];
        let before = if at > 0 { self.entries[at - 1].cumulative_share } else { 0.0 };
        let outline = self.all.polygons.get(entry.polygon as usize);
        let part = outline.map(|outline| clip_to_filter(outline, center, self.all.radius));
        EmitterChoice { light: entry.light, probability: entry.cumulative_share - before, part }
    }
}

/// Returns the part of an outline that the filter of a pixel reaches.
#[inline]
fn clip_to_filter(polygon: &FilmPolygon, center: [f32; 2], radius: f32) -> FilmPolygon {
    polygon.clip(center.map(|x| x - radius), center.map(|x| x + radius))
}

/// Returns the outline of a stationary flat polygon for a stationary pinhole camera. Returns `None` for other lights and cameras,
/// and if the polygon is off the film, too large, or not wholly in front of the camera.
fn polygon_image(camera: &KernelCamera, lights: &Lights, light: u32) -> Option<Image> {
    let (corners, view) = (lights.corners(light), camera.pinhole()?);
    let points: Option<Vec<[f32; 2]>> =
        corners.iter().map(|&corner| view.project(corner).map(|(place, _)| place)).collect();
    let points = points.filter(|places| places.len() > 2)?;
    let over = |axis: usize, of: fn(f32, f32) -> f32| points.iter().map(|place| place[axis]).reduce(of).unwrap_or(0.0);
    let (low, high) = ([0, 1].map(|axis| over(axis, f32::min)), [0, 1].map(|axis| over(axis, f32::max)));
    let is_on_film = (0..2).all(|axis| high[axis] >= -2.0 && low[axis] <= camera.film[axis] as f32 + 2.0);
    let fits = (0..2).all(|axis| high[axis] - low[axis] <= MAX_POLYGON_SIZE);
    let near = corners.iter().map(|&corner| (corner - view.origin).length()).fold(f32::INFINITY, f32::min);
    let strength = lights.power(light) / (near * near);
    let polygon = FilmPolygon::new(&points);
    let is_seen = is_on_film && fits && polygon.area() > MIN_PART_AREA && strength > 0.0 && strength.is_finite();
    is_seen.then_some(Image { low, high, strength, polygon: Some(polygon) })
}

/// Returns the image of a light over the shutter; `None` if it is off the film, too large, too near or too uncertain.
fn bounds_image(camera: &KernelCamera, lights: &Lights, light: u32) -> Option<Image> {
    let (bounds, power) = (lights.bounds(light), lights.power(light));
    let (mut low, mut high, mut near) = ([f32::INFINITY; 2], [f32::NEG_INFINITY; 2], f32::INFINITY);
    for view in camera.views() {
        for k in 0..8u32 {
            let corner = Vec3A::select(BVec3A::new(k & 1 > 0, k & 2 > 0, k & 4 > 0), bounds.max, bounds.min);
            let (place, depth) = view.project(corner)?;
            let blur = camera.blur(depth);
            let distance = (corner - view.origin).length();
            near = near.min(distance);
            // Rounding of coordinates, as an angle.
            let rounding = (corner.abs() + view.origin.abs()).max_element() * gamma(4) / distance;
            if rounding > MAX_UNCERTAINTY * view.solid_angle(place).sqrt() {
                return None;
            }
            for axis in 0..2 {
                low[axis] = low[axis].min(place[axis] - blur);
                high[axis] = high[axis].max(place[axis] + blur);
            }
        }
    }
    let is_small = (0..2).all(|axis| high[axis] - low[axis] <= MAX_IMAGE_SIZE);
    let is_on_film = (0..2).all(|axis| high[axis] >= -2.0 && low[axis] <= camera.film[axis] as f32 + 2.0);
    let strength = power / (near * near);
    (is_small && is_on_film && strength > 0.0 && strength.is_finite()).then_some(Image {
        low,
        high,
        strength,
        polygon: None,
    })
}
