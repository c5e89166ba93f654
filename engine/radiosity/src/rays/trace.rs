//! Generation of rays on leaves, and their hits.

use super::{RayHit, part_count};
use crate::arena::Arena;
use crate::element::{Element, FOG_NODES, Shape};
use crate::scene::{SHUTTER_TIME, Scene};
use crate::tuning::MAX_CLEAR_SURFACES;
use crate::visibility::{RandomNumbers, VisibilityTester};
use femc_field::{NONE, SurfaceSpot};
use femc_geometry::{Ray, offset_origin};
use femc_math::color::luminance;
use femc_math::glam::{Vec2, Vec3A};
use femc_math::{Frame, Rgb, warp};
use femc_prepared::media::{DistanceSample, MediumStack};
use femc_prepared::{Crossing, Orientation, Prepared};
use femc_scattering::{LobeKind, Transmitted};

/// Packs a unit vector in 127ths.
pub(super) fn pack_normal(normal: Vec3A) -> [i8; 3] {
    (normal * 127.0).round().to_array().map(|x| x as i8)
}

pub(super) fn unpack_normal(normal: [i8; 3]) -> Vec3A {
    Vec3A::from_array(normal.map(f32::from)).normalize_or_zero()
}

/// Returns the part of a box of fog at a point, m: the part nearest to one of its nodes.
pub fn fog_part(element: &Element, point: Vec3A) -> usize {
    let local = (point - element.center) / element.half_extent;
    let closeness = FOG_NODES.map(|node| node.dot(local));
    (1..FOG_NODES.len()).fold(0, |best, k| if closeness[k] > closeness[best] { k } else { best })
}

/// Returns a random point of a part of a box of fog. The parts are mirror images of each other.
fn point_of_fog(element: &Element, part: usize, numbers: &mut RandomNumbers) -> SurfaceSpot {
    let local = Vec3A::new(numbers.next(), numbers.next(), numbers.next()) * 2.0 - 1.0;
    let from = fog_part(element, element.center + element.half_extent * local);
    let mirrored = local * FOG_NODES[from].signum() * FOG_NODES[part].signum();
    SurfaceSpot { position: element.center + element.half_extent * mirrored, ..SurfaceSpot::default() }
}

/// Returns the part of a leaf at a position in it.
pub fn leaf_part(element: &Element, local: Vec2) -> usize {
    if element.is_triangle() {
        let weights = [1.0 - local.x - local.y, local.x, local.y];
        (1..3).fold(0, |best, k| if weights[k] > weights[best] { k } else { best })
    } else {
        usize::from(local.x >= 0.5) + 2 * usize::from(local.y >= 0.5)
    }
}

/// Returns the origin of a ray of a leaf, its direction, and two further numbers in [0, 1). The directions have the cosine
/// distribution; in fog, all directions are equally probable. Successive rays begin on the parts of the leaf in turn.
/// - `rays_per_part`: number of rays of a part;
/// - `round`: number of the round; each has different rays.
pub(super) fn generate_ray(
    scene: &Scene<'_>,
    arena: &Arena,
    element: &Element,
    ray: usize,
    rays_per_part: usize,
    round: u32,
) -> (SurfaceSpot, Vec3A, [f32; 2]) {
    let parts = part_count(element);
    let (part, turn) = (ray % parts, ray / parts);
    let mut numbers = RandomNumbers::new(&[element.key, 11, u64::from(round), part as u64]);
    let shift = [numbers.next(), numbers.next()];
    let mut numbers = RandomNumbers::new(&[element.key, 12, u64::from(round), ray as u64]);
    let lattice = |turn: usize, of: usize| {
        // Shifted lattices.
        [(turn as f32 + shift[0]) / of as f32, (turn as f32 * 0.618_034 + shift[1]).fract()]
    };
    if element.is_volume() {
        let spot = point_of_fog(element, part, &mut numbers);
        let u = lattice(turn, rays_per_part);
        return (spot, warp::direction(1.0 - 2.0 * u[0], u[1]), [numbers.next(), numbers.next()]);
    }
    let mut local = Vec2::new(numbers.next(), numbers.next());
    if parts == 3 {
        // Each of three parts has the points nearest to one corner.
        if local.x + local.y > 1.0 {
            local = Vec2::ONE - local;
        }
        let mut weights = [1.0 - local.x - local.y, local.x, local.y];
        let most = (1..3).fold(0, |best, k| if weights[k] > weights[best] { k } else { best });
        weights.swap(most, part);
        local = Vec2::new(weights[1], weights[2]);
    } else {
        local = 0.5 * (local + Vec2::new((part % 2) as f32, (part / 2) as f32));
    }
    let spot = if let Shape::Cluster(cluster) = &element.shape {
        arena.point_of_cluster(scene, cluster, 0.25 * (numbers.next() + part as f32), (2.0 * local).fract())
    } else {
        element.point_at(scene, local)
    };
    let u = lattice(turn, rays_per_part);
    let dir = (warp::direction(1.0 - 2.0 * u[0], u[1]) + spot.normal).normalize_or(spot.normal);
    (spot, dir, [numbers.next(), numbers.next()])
}

/// Returns an estimate of the irradiance of a point directly from lamps, lx, by a shadow ray to one of them. In fog it is a quarter
/// of the light from all directions.
/// - `key`: key of the random numbers.
pub(super) fn direct_irradiance(
    scene: &Scene<'_>,
    from: &SurfaceSpot,
    [element, round, ray]: [u64; 3],
    tester: &mut VisibilityTester,
) -> Rgb {
    let Prepared { lights, world, textures, .. } = scene.prepared;
    let mut numbers = RandomNumbers::new(&[element, 13, round, ray]);
    let context = lights.point_context(from.position, from.normal, None);
    lights.weigh(&context, &mut tester.lamps);
    let number = f64::from(numbers.next());
    let Some((lamp, probability)) = lights.choose(&tester.lamps, &context, || number) else {
        return Rgb::ZERO;
    };
    let u = [numbers.next(), numbers.next()];
    let Some(sample) = lights.sample_light(world, textures, lamp, from.position, SHUTTER_TIME, u) else {
        return Rgb::ZERO;
    };
    let cosine = if from.normal == Vec3A::ZERO { 0.25 } else { from.normal.dot(sample.dir) };
    let light = sample.radiance * (cosine / (sample.pdf * probability));
    if cosine <= 0.0 || !light.is_finite() || light == Rgb::ZERO {
        return Rgb::ZERO;
    }
    let to = SurfaceSpot { position: sample.position, error: sample.error, normal: sample.normal };
    light * tester.transmittance(scene, from, &to)
}

/// Kind of quantity that a path carries.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PathKind {
    /// Radiance along a ray of a leaf.
    Radiance,
    /// Flux from a lamp.
    Flux,
}

/// End of a path through mirrors and clear surfaces.
#[derive(Clone, Copy, Debug)]
pub struct PathEnd {
    pub at: Landing,
    /// Share of the radiance, by luminance, that arrives at the path's origin.
    pub share: f32,
    /// Share of the flux from the origin that arrives here, divided by the probability of the path.
    pub flux: Rgb,
    /// Whether a mirror or a refracting surface has changed the direction.
    pub is_bent: bool,
    /// Whether the path has left a surface by its specular lobes.
    pub is_turned: bool,
}

/// Kind of end of a path.
#[derive(Clone, Copy, Debug)]
pub enum Landing {
    /// A side of a surface that scatters, with the point's parameters and the normal of the side.
    Surface { surface: u32, place: Vec2, normal: Vec3A },
    /// A point in the fog, m.
    Fog(Vec3A),
    /// No element.
    Nowhere,
}

/// Traces a ray to its hit: a surface that scatters, or the fog. Mirrors and clear surfaces pass it on.
/// - `u`: numbers in [0, 1).
pub(super) fn trace_ray(
    scene: &Scene<'_>,
    arena: &Arena,
    from: &SurfaceSpot,
    dir: Vec3A,
    u: [f32; 2],
    tester: &mut VisibilityTester,
) -> RayHit {
    let mut numbers = RandomNumbers::new(&[u64::from(u[0].to_bits()), u64::from(u[1].to_bits())]);
    let end = follow_path(scene, arena, from, dir, PathKind::Radiance, &mut numbers, tester);
    let PathEnd { share, is_turned, .. } = end;
    match end.at {
        Landing::Surface { surface, place, normal } => {
            let (leaf, local) = arena.element_at(arena.roots[surface as usize], place, 0.0);
            let part = leaf_part(&arena.elements[leaf as usize], local) as u8;
            RayHit { leaf, share, normal: pack_normal(normal), part, is_two_way: !is_turned, ..RayHit::MISS }
        }
        Landing::Fog(point) => {
            let Some(leaf) = arena.fog_at(point) else { return RayHit::MISS };
            let part = fog_part(&arena.elements[leaf as usize], point) as u8;
            RayHit { leaf, share, part, is_two_way: !is_turned, ..RayHit::MISS }
        }
        Landing::Nowhere => RayHit::MISS,
    }
}

/// Follows a path through mirrors and clear surfaces.
pub fn follow_path(
    scene: &Scene<'_>,
    arena: &Arena,
    from: &SurfaceSpot,
    dir: Vec3A,
    kind: PathKind,
    numbers: &mut RandomNumbers,
    tester: &mut VisibilityTester,
) -> PathEnd {
    let prepared = scene.prepared;
    let mut ray = Ray {
        origin: offset_origin(from.position, from.error, from.normal, dir),
        dir,
        t_max: f32::INFINITY,
        time: SHUTTER_TIME,
    };
    let mut end = PathEnd { at: Landing::Nowhere, share: 1.0, flux: Rgb::ONE, is_bent: false, is_turned: false };
    let mut is_inside = false;
    for _ in 0..=MAX_CLEAR_SURFACES {
        tester.rays += 1;
        let hit = prepared.world.intersect(&ray);
        let length = hit.as_ref().map_or(f32::INFINITY, |hit| hit.t);
        let media = &prepared.media;
        // The light of a lamp in a clear solid begins inside.
        is_inside |= kind == PathKind::Flux
            && !media.is_empty()
            && hit.as_ref().is_some_and(|hit| {
                let point = prepared.shading_point(&ray, hit);
                prepared.materials[point.material as usize].orientation != Orientation::TowardViewer
                    && point.normal.dot(ray.dir) > 0.0
            });
        if !media.is_empty()
            && !is_inside
            && media.find_intervals(ray.origin, ray.dir, length, &MediumStack::default(), &mut tester.media)
        {
            match media.sample_distance(&tester.media, f64::from(numbers.next()), numbers.next()) {
                DistanceSample::Scatter(event) => {
                    end.at = Landing::Fog(ray.origin + ray.dir * event.t);
                    end.share *= luminance(event.weight);
                    end.flux *= event.weight;
                    return end;
                }
                DistanceSample::Through { weight } => {
                    end.share *= luminance(weight);
                    end.flux *= weight;
                }
            }
        }
        let Some(hit) = hit else { return end };
        let point = prepared.shading_point(&ray, &hit);
        let is_back = point.normal.dot(ray.dir) > 0.0;
        let material = &prepared.materials[point.material as usize];
        let crossing = material.crossing[usize::from(is_back)];
        let straight_through = luminance(crossing.straight_through());
        if let Crossing::Null { tint } = crossing {
            end.share *= straight_through;
            end.flux *= tint;
            ray.origin = offset_origin(point.position, point.error, point.normal, ray.dir);
            continue;
        }
        let mut specular_probability = 0.0;
        if material.bsdf.has_delta() {
            let towards_viewer = material.orientation == Orientation::TowardViewer;
            let normal = if is_back && towards_viewer { -point.normal } else { point.normal };
            let (frame, delta) = (Frame::from_normal(normal), material.bsdf.without_lambertian());
            let wo = frame.to_local(-ray.dir);
            let (reflected, transmitted) = scene.material_albedos(point.material);
            let [sent, passed] = [reflected + transmitted, delta.albedo(wo)].map(luminance);
            specular_probability = if passed > 0.0 { passed / (passed + sent) } else { 0.0 };
            if numbers.next() < specular_probability {
                let Some(sample) = delta.sample(wo, [numbers.next(), numbers.next()], numbers.next()) else {
                    return end;
                };
                end.share *= luminance(sample.weight) / specular_probability;
                // Radiance changes with the square of the index, flux does not.
                end.flux *= sample.weight * (sample.eta * sample.eta / specular_probability);
                let is_through = sample.transmitted == Transmitted::Yes;
                let is_straight = sample.lobe == LobeKind::Delta && is_through && straight_through > 0.0;
                end.is_bent |= !is_straight;
                end.is_turned = true;
                is_inside ^= is_through && sample.eta != 1.0;
                let dir = frame.to_world(sample.wi).normalize_or(normal);
                let origin = offset_origin(point.position, point.error, point.normal, dir);
                ray = Ray { origin, dir, ..ray };
                continue;
            }
        }
        let surface = scene.sides[hit.instance as usize][hit.primitive as usize][usize::from(is_back)];
        if surface == NONE || arena.roots[surface as usize] == NONE || end.share <= 0.0 {
            return end;
        }
        let place = scene.surfaces[surface as usize].parameters(point.position, [hit.u, hit.v]);
        let normal = if is_back { -point.normal } else { point.normal };
        end.share /= 1.0 - specular_probability;
        end.flux *= 1.0 / (1.0 - specular_probability);
        end.at = Landing::Surface { surface, place, normal };
        return end;
    }
    end
}
