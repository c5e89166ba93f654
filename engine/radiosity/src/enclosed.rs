//! Sides of surfaces that no light reaches: the inner sides of small closed bodies.
//!
//! Rays from each side find the sides that it sees. Sides that see each other form a space. A space is closed if none of its rays
//! leaves it, and if it contains no lamp. The sides of small closed spaces need no elements.

use crate::scene::{SHUTTER_TIME, Scene};
use crate::tuning::{ENCLOSED_AREA_SHARE, ENCLOSED_RAYS};
use crate::visibility::RandomNumbers;
use femc_field::{Form, NONE};
use femc_geometry::{Ray, offset_origin};
use femc_math::color::luminance;
use femc_math::glam::{Vec2, Vec3A};
use femc_math::warp;
use femc_prepared::Crossing;
use rayon::prelude::*;
use std::ops::Range;

/// A side of a surface: its number, its area, and its box.
#[derive(Clone, Copy, Debug)]
pub struct Side {
    pub surface: u32,
    pub area: f32,
    pub low: Vec3A,
    pub high: Vec3A,
}

/// A space: sides that see each other.
#[derive(Clone, Copy, Debug)]
struct Space {
    is_open: bool,
    area: f32,
    low: Vec3A,
    high: Vec3A,
}

/// End of a ray.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum RayEnd {
    /// Light may arrive this way: from outside, from a lamp, or through something that is not opaque.
    Open,
    /// A side.
    Side(u32),
    /// A black surface.
    Black,
}

/// Returns the numbers of the surfaces of small closed spaces, ascending.
pub fn enclosed_surfaces(scene: &Scene<'_>, sides: &[Side]) -> Vec<u32> {
    let mut spaces = Spaces::new(scene, sides);
    let whole: f32 = sides.iter().map(|side| side.area).sum();
    for rays in ENCLOSED_RAYS.windows(2) {
        let tested: Vec<u32> =
            sides.iter().map(|side| side.surface).filter(|&surface| !spaces.get(surface).is_open).collect();
        let ends: Vec<Vec<RayEnd>> = tested.par_iter().map(|&surface| cast(scene, surface, rays[0]..rays[1])).collect();
        for (&surface, ends) in tested.iter().zip(&ends) {
            ends.iter().for_each(|end| spaces.add(surface, *end));
        }
        spaces.open_large(ENCLOSED_AREA_SHARE * whole);
        spaces.open_around_lamps(scene);
    }
    sides.iter().map(|side| side.surface).filter(|&surface| !spaces.get(surface).is_open).collect()
}

/// Disjoint sets of sides.
struct Spaces {
    above: Vec<u32>,
    spaces: Vec<Space>,
}

impl Spaces {
    fn new(scene: &Scene<'_>, sides: &[Side]) -> Self {
        let count = scene.surfaces.len();
        let mut spaces =
            vec![Space { is_open: true, area: 0.0, low: Vec3A::INFINITY, high: Vec3A::NEG_INFINITY }; count];
        for side in sides {
            spaces[side.surface as usize] = Space { is_open: false, area: side.area, low: side.low, high: side.high };
        }
        Self { above: (0..count as u32).collect(), spaces }
    }

    fn find(&mut self, surface: u32) -> u32 {
        let mut at = surface;
        while self.above[at as usize] != at {
            let next = self.above[self.above[at as usize] as usize];
            self.above[at as usize] = next;
            at = next;
        }
        at
    }

    fn get(&mut self, surface: u32) -> Space {
        let at = self.find(surface);
        self.spaces[at as usize]
    }

    /// Adds the result of a ray from a side.
    fn add(&mut self, surface: u32, end: RayEnd) {
        let a = self.find(surface) as usize;
        match end {
            RayEnd::Black => {}
            RayEnd::Open => self.spaces[a].is_open = true,
            RayEnd::Side(other) => {
                let b = self.find(other) as usize;
                if a == b {
                    return;
                }
                let [one, two] = [self.spaces[a], self.spaces[b]];
                self.above[b] = a as u32;
                self.spaces[a] = Space {
                    is_open: one.is_open || two.is_open,
                    area: one.area + two.area,
                    low: one.low.min(two.low),
                    high: one.high.max(two.high),
                };
            }
        }
    }

    /// Counts larger spaces as open. Few rays may have missed an opening of a large space.
    /// - `max_area`: maximum area of the sides of a closed space, m2.
    fn open_large(&mut self, max_area: f32) {
        self.spaces.iter_mut().for_each(|space| space.is_open |= space.area > max_area);
    }

    /// Counts spaces around lamps as open.
    fn open_around_lamps(&mut self, scene: &Scene<'_>) {
        for space in self.spaces.iter_mut().filter(|space| !space.is_open) {
            space.is_open = scene.lamps.iter().any(|lamp| {
                let nearest = lamp.center.clamp(space.low, space.high);
                nearest.distance_squared(lamp.center) <= lamp.radius * lamp.radius
            });
        }
    }
}

/// Casts rays from a side, up to the first one that ends in the open.
fn cast(scene: &Scene<'_>, surface: u32, rays: Range<u32>) -> Vec<RayEnd> {
    let mut ends = Vec::new();
    for ray in rays {
        let end = cast_ray(scene, surface, ray);
        ends.push(end);
        if end == RayEnd::Open {
            break;
        }
    }
    ends
}

fn cast_ray(scene: &Scene<'_>, surface: u32, ray: u32) -> RayEnd {
    let prepared = scene.prepared;
    let source = &scene.surfaces[surface as usize];
    let mut numbers = RandomNumbers::new(&[u64::from(surface), 17, u64::from(ray)]);
    let mut place = Vec2::new(numbers.next(), numbers.next());
    if matches!(source.form, Form::Triangle(_)) && place.x + place.y > 1.0 {
        place = Vec2::ONE - place;
    }
    let spot = source.point_at(place);
    let dir = (warp::direction(1.0 - 2.0 * numbers.next(), numbers.next()) + spot.normal).normalize_or(spot.normal);
    let origin = offset_origin(spot.position, spot.error, spot.normal, dir);
    let ray = Ray { origin, dir, t_max: f32::INFINITY, time: SHUTTER_TIME };
    let Some(hit) = prepared.world.intersect(&ray) else { return RayEnd::Open };
    let point = prepared.shading_point(&ray, &hit);
    let is_back = point.normal.dot(dir) > 0.0;
    let material = &prepared.materials[point.material as usize];
    let crossing = material.crossing[usize::from(is_back)];
    let is_clear = matches!(crossing, Crossing::Null { .. }) || luminance(crossing.straight_through()) > 0.0;
    let (reflectance, transmittance) = scene.material_albedos(point.material);
    if point.light != NONE || is_clear || material.bsdf.has_delta() || luminance(transmittance) > 0.0 {
        return RayEnd::Open;
    }
    let other = scene.sides[hit.instance as usize][hit.primitive as usize][usize::from(is_back)];
    match other {
        NONE if luminance(reflectance) > 0.0 => RayEnd::Open,
        NONE => RayEnd::Black,
        other => RayEnd::Side(other),
    }
}
