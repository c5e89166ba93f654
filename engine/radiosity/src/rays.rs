//! Light that the links have wrong, found by rays from the leaves.
//!
//! Links are kept where each alone matters little, but many that are wrong in the same way matter together: a leaf beneath a table is
//! in the shadow of all of them. So from each leaf rays look for the light that arrives: they are few and noisy, but never biased.
//! What the links bring is scaled to what the rays find, over parts of surfaces as small as the rays can tell apart: from each
//! surface down its tree, as far as the rays of a part differ from what is known of the part above by more than chance
//! (James and Stein's estimator, \[efron1973\]).

use crate::arena::Arena;
use crate::element::{Element, Kind};
use crate::gather::{FROM_ELEMENTS, FROM_SOURCES, Lights};
use crate::scene::{Scene, TIME};
use crate::visibility::{Eye, Numbers};
use femc_field::{NONE, SurfaceSpot};
use femc_math::Rgb;
use femc_math::color::luminance;
use femc_math::glam::{Vec2, Vec3A};
use femc_math::warp;
use femc_prepared::media::{Distance, Inside};
use rayon::prelude::*;

/// Least and most rays from each quarter of a leaf, and as many in all where that is in between.
const RAYS: [usize; 2] = [8, 256];
const ALL: usize = 1 << 16;
/// Quarters of a leaf, which its nodes stand for.
const QUARTERS: usize = 4;
/// Squared difference, in variances of it, up to which it is taken as chance, where links may have the error [`ROUGH`] or more; the more
/// exact they are, the less is a difference their fault.
const CHANCE: f32 = 4.0;
const ROUGH: f32 = 0.3;
/// What links bring is scaled up to so much at most.
const MOST: f32 = 4.0;

/// What a ray has met.
#[derive(Clone, Copy, Debug)]
struct Sight {
    /// The leaf, or [`NONE`].
    leaf: u32,
    /// Irradiance of the ray's origin, if all rays met it, over the leaf's radiosity; of fog over its irradiance.
    share: f32,
    /// Normal there, in 127ths.
    normal: [i8; 3],
}

/// Rays from all leaves of surfaces.
pub struct Rays {
    /// The leaves, by index.
    leaves: Vec<u32>,
    /// By leaf, quarter and ray.
    sights: Vec<Sight>,
    /// Rays from a quarter.
    each: usize,
    /// Rays that were traced.
    pub traced: u64,
}

/// What rays have found.
pub struct Found {
    /// Light that arrives by the rays over that by the links; 1 where these bring none.
    pub ratio: f32,
    /// Root mean square of what is changed, over what the links bring on average.
    pub changed: f32,
    /// The leaves, and by how much the irradiance of their quarters differs, lx.
    pub contrast: Vec<(u32, f32)>,
}

/// Sums over a part of a surface, by which rays and links are compared.
#[derive(Clone, Copy, Debug, Default)]
struct Sums {
    /// Light that arrives by the rays and by the links, lm.
    rays: f32,
    links: f32,
    /// By the rays' squares, lm lx.
    squares: f32,
    /// By the one ray that brings most, lm.
    most: f32,
    /// By leaf the area squared over the rays, times what arrives by the links, and times the square of that.
    variances: [f32; 2],
}

impl Sums {
    fn of(area: f32, found: &[f32], links: f32) -> Self {
        let count = found.len() as f32;
        let each = area / count;
        let weight = area * each;
        Self {
            rays: each * found.iter().sum::<f32>(),
            links: area * links,
            squares: each * found.iter().map(|x| x * x).sum::<f32>(),
            most: each * found.iter().copied().fold(0.0, f32::max),
            variances: [weight * links, weight * links * links],
        }
    }

    fn add(&mut self, other: &Self) {
        self.rays += other.rays;
        self.links += other.links;
        self.squares += other.squares;
        self.most = self.most.max(other.most);
        self.variances.iter_mut().zip(other.variances).for_each(|(sum, part)| *sum += part);
    }

    /// Irradiance of a ray that meets something bright, lx; no less than in the part above, as few rays may have missed that.
    fn bright(&self, above: f32) -> f32 {
        if self.rays > 0.0 { above.max(self.squares / self.rays) } else { above }
    }

    /// Scale of the links here.
    /// - `above`: what is known of the part above;
    /// - `chance`: the squared difference, in variances of it, that is taken as chance.
    fn scale(&self, above: Known, chance: f32) -> f32 {
        let Known { scale, bright } = above;
        if self.links <= 0.0 {
            return scale;
        }
        // One ray that has met the fog at a lamp is no proof of more light.
        let rays =
            if self.rays > scale * self.links { (self.rays - self.most).max(scale * self.links) } else { self.rays };
        let difference = rays - scale * self.links;
        // As if the scale above were right: of what a part receives few rays may have missed all.
        let variance = (scale * bright * self.variances[0] - scale * scale * self.variances[1]).max(0.0);
        let sure = 1.0 - chance * variance / (difference * difference).max(f32::MIN_POSITIVE);
        (scale + sure.max(0.0) * (rays / self.links - scale)).clamp(0.0, MOST)
    }
}

impl Rays {
    /// Casts them.
    /// - `room`: bytes that they may take; where that is too little, there are fewer, one from each quarter at least.
    pub fn new(scene: &Scene<'_>, arena: &Arena, room: usize) -> Self {
        let is_leaf = |index: &u32| {
            let element = &arena.elements[*index as usize];
            element.is_leaf() && matches!(element.kind, Kind::Patch | Kind::Ball)
        };
        let leaves: Vec<u32> = (0..arena.elements.len() as u32).filter(is_leaf).collect();
        let quarters = QUARTERS * leaves.len().max(1);
        let fit = (room / (size_of::<Sight>() * quarters)).max(1);
        let each = (ALL / quarters).clamp(RAYS[0], RAYS[1]).min(fit);
        let chunks: Vec<(Vec<Sight>, u64)> = leaves
            .par_chunks(64)
            .map(|leaves| {
                let mut eye = Eye::default();
                let mut sights = Vec::with_capacity(leaves.len() * QUARTERS * each);
                for &leaf in leaves {
                    let origins = origins(scene, &arena.elements[leaf as usize], each);
                    sights.extend(origins.map(|(spot, dir, u)| met(scene, arena, &spot, dir, u, &mut eye)));
                }
                (sights, eye.rays)
            })
            .collect();
        let traced = chunks.iter().map(|(_, rays)| rays).sum();
        Self { leaves, sights: chunks.into_iter().flat_map(|(sights, _)| sights).collect(), each, traced }
    }

    /// Bytes.
    pub fn bytes(&self) -> usize {
        size_of_val(&*self.sights) + size_of_val(&*self.leaves)
    }

    /// Sets what the leaves receive beyond what links bring.
    /// - `error`: what a link may have.
    pub fn correct(&self, scene: &Scene<'_>, arena: &Arena, lights: &mut Lights, error: f32) -> Found {
        let chance = CHANCE * (ROUGH / error).max(1.0);
        let by_leaf: Vec<[Sums; QUARTERS]> = self
            .leaves
            .par_iter()
            .zip(self.sights.par_chunks(QUARTERS * self.each))
            .map(|(&leaf, sights)| {
                let element = &arena.elements[leaf as usize];
                let found: Vec<f32> = sights.iter().map(|sight| received(arena, lights, sight)).collect();
                let area = element.size / QUARTERS as f32;
                let links = brought(scene, element, leaf, lights, self.each);
                [0, 1, 2, 3].map(|k| Sums::of(area, &found[k * self.each..(k + 1) * self.each], links[k]))
            })
            .collect();
        let mut sums = vec![Sums::default(); arena.elements.len()];
        for (&leaf, quarters) in self.leaves.iter().zip(&by_leaf) {
            quarters.iter().for_each(|quarter| sums[leaf as usize].add(quarter));
        }
        let mut all = Sums::default();
        for index in (0..arena.elements.len()).rev() {
            let element = &arena.elements[index];
            let part = sums[index];
            if is_root(arena, element) {
                all.add(&part);
            } else if element.surface != NONE {
                sums[element.parent as usize].add(&part);
            }
        }
        // A parent comes before its children; what its parts have together is known best of it.
        let whole =
            Known { scale: all.scale(Known { scale: 1.0, bright: all.bright(0.0) }, chance), bright: all.bright(0.0) };
        let mut known = vec![whole; arena.elements.len()];
        let roots: Vec<u32> = arena.roots.iter().copied().filter(|&root| root != NONE).collect();
        let parts: Vec<Sums> = roots.iter().map(|&root| sums[root as usize]).collect();
        for (&root, part) in roots.iter().zip(whole.of_parts(&all, chance, &parts)) {
            known[root as usize] = part;
        }
        for (index, element) in arena.elements.iter().enumerate() {
            if element.surface == NONE || element.is_leaf() {
                continue;
            }
            let parts = element.children.map(|child| sums[child as usize]);
            let parts = known[index].of_parts(&sums[index], chance, &parts);
            element.children.iter().zip(parts).for_each(|(&child, part)| known[child as usize] = part);
        }
        let mut contrast = Vec::with_capacity(self.leaves.len());
        let (mut changed, mut whole, mut area) = (0.0f64, 0.0f64, 0.0f64);
        for (&leaf, quarters) in self.leaves.iter().zip(&by_leaf) {
            let above = known[leaf as usize];
            let element = &arena.elements[leaf as usize];
            let mut parts = [above.scale; QUARTERS];
            let taken = lights.taken[leaf as usize];
            if element.kind == Kind::Ball {
                let arriving = &mut lights.arriving[element.wide as usize];
                arriving.more = arriving.whole[FROM_ELEMENTS] * Rgb::splat(above.scale - taken[0]);
            } else {
                let shares = above.of_parts(&sums[leaf as usize], chance, quarters);
                parts.iter_mut().zip(shares).for_each(|(part, share)| *part = share.scale);
                let whole = lights.of[leaf as usize].whole[FROM_ELEMENTS];
                for (node, more) in lights.more[leaf as usize].iter_mut().enumerate() {
                    *more = whole[node] * (parts[node] - taken[node]);
                }
            }
            let found = quarters.iter().zip(parts).map(|(quarter, part)| quarter.links * part);
            let (low, high) =
                found.fold((f32::INFINITY, 0.0f32), |(low, high), light| (low.min(light), high.max(light)));
            contrast.push((leaf, (high - low) * QUARTERS as f32 / element.size));
            for (quarter, part) in quarters.iter().zip(parts) {
                let size = f64::from(element.size) / QUARTERS as f64;
                changed += (f64::from(quarter.links) * f64::from(part - 1.0)).powi(2) / size.max(f64::MIN_POSITIVE);
                (whole, area) = (whole + f64::from(quarter.links), area + size);
            }
        }
        let area = area.max(f64::MIN_POSITIVE);
        let changed = (changed / area).sqrt() / (whole / area).max(f64::MIN_POSITIVE);
        let ratio = if all.links > 0.0 { all.rays / all.links } else { 1.0 };
        Found { ratio, changed: changed as f32, contrast }
    }
}

/// What is known of a part of a surface.
#[derive(Clone, Copy, Debug)]
struct Known {
    /// Light that arrives over that by the links.
    scale: f32,
    /// Irradiance of a ray that meets something bright, lx.
    bright: f32,
}

impl Known {
    /// Of the parts of a whole, which together have what the whole has.
    fn of_parts(self, whole: &Sums, chance: f32, parts: &[Sums]) -> Vec<Self> {
        let above = Self { bright: whole.bright(self.bright), ..self };
        let scales: Vec<f32> = parts.iter().map(|part| part.scale(above, chance)).collect();
        let together: f32 = parts.iter().zip(&scales).map(|(part, scale)| part.links * scale).sum();
        let more = (self.scale * whole.links / together.max(f32::MIN_POSITIVE)).min(MOST);
        let bright = |part: &Sums| part.bright(above.bright);
        parts.iter().zip(scales).map(|(part, scale)| Self { scale: scale * more, bright: bright(part) }).collect()
    }
}

fn is_root(arena: &Arena, element: &Element) -> bool {
    element.surface != NONE && (element.parent == NONE || arena.elements[element.parent as usize].surface == NONE)
}

/// Points of a leaf by quarter, directions by the cosine, and two numbers in [0, 1) for each.
fn origins<'a>(
    scene: &'a Scene<'_>,
    element: &'a Element,
    each: usize,
) -> impl Iterator<Item = (SurfaceSpot, Vec3A, [f32; 2])> + 'a {
    let surface = &scene.surfaces[element.surface as usize];
    let is_triangle = matches!(surface.form, femc_field::Form::Triangle(_));
    let mut numbers = Numbers::new(&[element.key, 11]);
    (0..QUARTERS).flat_map(move |quarter| {
        let shift = [numbers.next(), numbers.next()];
        let rays: Vec<_> = (0..each)
            .map(|ray| {
                let mut local = Vec2::new(numbers.next(), numbers.next());
                if is_triangle {
                    // Of three parts, of the points next to a corner each.
                    if local.x + local.y > 1.0 {
                        local = Vec2::ONE - local;
                    }
                    let mut weights = [1.0 - local.x - local.y, local.x, local.y];
                    let most = (1..3).fold(0, |best, k| if weights[k] > weights[best] { k } else { best });
                    weights.swap(most, (quarter + ray * usize::from(quarter == 3)) % 3);
                    local = Vec2::new(weights[1], weights[2]);
                } else {
                    local = 0.5 * (local + Vec2::new((quarter % 2) as f32, (quarter / 2) as f32));
                }
                let spot = surface.at(element.outline.at(local));
                // A lattice, shifted.
                let u = [(ray as f32 + shift[0]) / each as f32, (ray as f32 * 0.618_034 + shift[1]).fract()];
                let dir = (warp::direction(1.0 - 2.0 * u[0], u[1]) + spot.normal).normalize_or(spot.normal);
                (spot, dir, [numbers.next(), numbers.next()])
            })
            .collect();
        rays
    })
}

/// What a ray meets first: a surface, or fog.
fn met(scene: &Scene<'_>, arena: &Arena, from: &SurfaceSpot, dir: Vec3A, u: [f32; 2], eye: &mut Eye) -> Sight {
    let nothing = Sight { leaf: NONE, share: 0.0, normal: [0; 3] };
    let (hit, share) = match eye.first(scene, from, dir) {
        Some((point, hit, share)) => (Some((point, hit)), share),
        None => (None, 1.0),
    };
    let mut share = share;
    let media = &scene.prepared.media;
    let length = hit.as_ref().map_or(f32::INFINITY, |(point, _)| point.position.distance(from.position));
    if !media.is_empty() && media.along(from.position, dir, length, &Inside::default(), &mut eye.media) {
        match media.draw(&eye.media, f64::from(u[0]), u[1]) {
            Distance::Scatter(event) => {
                let leaf = arena.fog_at(from.position + dir * event.t);
                return leaf.map_or(nothing, |leaf| Sight { leaf, share: luminance(event.weight), ..nothing });
            }
            Distance::Through { weight } => share *= luminance(weight),
        }
    }
    let Some((point, hit)) = hit else { return nothing };
    let is_back = point.normal.dot(dir) > 0.0;
    let surface = scene.sides[hit.instance as usize][hit.primitive as usize][usize::from(is_back)];
    if surface == NONE || arena.roots[surface as usize] == NONE || share <= 0.0 {
        return nothing;
    }
    let place = scene.surfaces[surface as usize].parameters(point.position, [hit.u, hit.v]);
    let leaf = arena.part_at(arena.roots[surface as usize], place, 0.0);
    let normal = if is_back { -point.normal } else { point.normal };
    Sight { leaf, share, normal: (normal * 127.0).round().to_array().map(|x| x as i8) }
}

/// Irradiance of a ray's origin, if all rays met the same, lx.
fn received(arena: &Arena, lights: &Lights, sight: &Sight) -> f32 {
    if sight.leaf == NONE {
        return 0.0;
    }
    let element = &arena.elements[sight.leaf as usize];
    let light = &lights.of[sight.leaf as usize];
    if element.kind == Kind::Fog {
        return sight.share * light.mean;
    }
    let radiosity = if element.kind == Kind::Ball {
        let normal = Vec3A::from_array(sight.normal.map(f32::from)).normalize_or_zero();
        let of = |from: usize| lights.around(element, sight.leaf as usize, from).cosine(normal);
        element.reflectance * (of(FROM_SOURCES) + of(FROM_ELEMENTS))
    } else {
        light.radiosity
    };
    sight.share * luminance(radiosity.max(Rgb::ZERO))
}

/// Irradiance that links bring to the quarters of a leaf, lx.
fn brought(scene: &Scene<'_>, element: &Element, leaf: u32, lights: &Lights, each: usize) -> [f32; QUARTERS] {
    if element.kind == Kind::Ball {
        let light = lights.arriving[element.wide as usize].whole[FROM_ELEMENTS];
        let sum: f32 =
            origins(scene, element, each).map(|(spot, ..)| luminance(light.cosine(spot.normal)).max(0.0)).sum();
        return [sum / (QUARTERS * each) as f32; QUARTERS];
    }
    let at = lights.of[leaf as usize].whole[FROM_ELEMENTS].map(|light| luminance(light.max(Rgb::ZERO)));
    // The last rays of a triangle are from all of it.
    if element.count == 3 { [at[0], at[1], at[2], (at[0] + at[1] + at[2]) / 3.0] } else { at }
}

impl Eye {
    /// The first surface that is not clear along a ray from a point of a surface, and the share of its light that gets there, by
    /// luminance, without the fog.
    fn first(
        &mut self,
        scene: &Scene<'_>,
        from: &SurfaceSpot,
        dir: Vec3A,
    ) -> Option<(femc_prepared::SurfacePoint, femc_geometry::Hit, f32)> {
        let prepared = scene.prepared;
        let origin = femc_geometry::offset_origin(from.position, from.error, from.normal, dir);
        let mut ray = femc_geometry::Ray { origin, dir, t_max: f32::INFINITY, time: TIME };
        let mut share = 1.0;
        for _ in 0..=crate::visibility::CLEAR {
            self.rays += 1;
            let hit = prepared.world.intersect(&ray)?;
            let point = prepared.surface(&ray, &hit);
            let back = point.normal.dot(dir) > 0.0;
            let clear = luminance(prepared.materials[point.material as usize].crossing[usize::from(back)].unbent());
            if clear <= 0.0 {
                return Some((point, hit, share));
            }
            share *= clear;
            ray.origin = femc_geometry::offset_origin(point.position, point.error, point.normal, dir);
        }
        None
    }
}
