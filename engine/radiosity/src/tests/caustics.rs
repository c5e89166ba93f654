//! Light of lamps that clear solids refract and mirrors reflect.

use super::{face, prepare, prepared_position};
use crate::arena::Arena;
use crate::caustics::Caustics;
use crate::scene::Scene;
use crate::{Solution, SolutionView, SolveOptions, solve};
use femc_math::color::luminance;
use femc_math::glam::{Vec2, Vec3A};
use femc_prepared::Prepared;
use std::sync::atomic::AtomicBool;

fn solution(prepared: &Prepared) -> Solution {
    solve(prepared, &SolveOptions::default(), &AtomicBool::new(false)).unwrap()
}

/// Point of a surface.
struct Point {
    position: Vec3A,
    /// Its share of the area, m2.
    size: f64,
    /// Irradiance of the field and directly from lamps, lx.
    field: f64,
    direct: f64,
}

fn points(prepared: &Prepared, solution: &Solution, surface: u32) -> Vec<Point> {
    let view = SolutionView::new(prepared, &solution.field);
    let source = &solution.field.surfaces[surface as usize];
    let mut out = Vec::new();
    for (leaf, outline) in solution.field.leaves_of(surface) {
        let area = f64::from(source.area() * outline.edges[0].perp_dot(outline.edges[1]).abs());
        for k in 0..16 {
            let local = (Vec2::new((k % 4) as f32, (k / 4) as f32) + 0.5) * 0.25;
            let spot = source.point_at(outline.point_at(local));
            let light = view.irradiance(leaf, local, spot.normal);
            let [field, direct] = [light.indirect, light.direct].map(|x| f64::from(luminance(x)));
            out.push(Point { position: spot.position, size: area / 16.0, field, direct });
        }
    }
    out
}

/// Maximum radii of rings around the middle of the floor, m.
const RINGS: [f64; 5] = [0.4, 0.8, 1.2, 1.6, 3.0];

/// Light of the field on a floor, compared with that of a point at the center of a bulb.
struct FloorLight {
    /// Flux relative to the true one: of the whole floor, and of rings around the middle.
    whole: f64,
    rings: [f64; RINGS.len()],
    /// Rms difference of the irradiances, relative to the mean.
    rms: f64,
    /// Greatest direct light, lx.
    direct: f64,
}

/// - `bulb`: position of the point, m;
/// - `intensity`: its intensity, cd.
fn floor_light(prepared: &Prepared, bulb: [f64; 3], intensity: f64) -> FloorLight {
    let solution = solution(prepared);
    let bulb = prepared_position(prepared, bulb);
    let (mut rings, mut square, mut area, mut direct) = ([[0.0f64; 2]; RINGS.len()], 0.0, 0.0, 0.0f64);
    for Point { position, size, field, direct: straight } in points(prepared, &solution, 0) {
        let way = (position - bulb).as_dvec3();
        let want = intensity * way.z.abs() / way.length().powi(3);
        let from_middle = (position.as_dvec3() + prepared.origin).truncate().length();
        let ring = &mut rings[RINGS.iter().position(|radius| from_middle < *radius).unwrap()];
        *ring = [ring[0] + size * field, ring[1] + size * want];
        (square, area, direct) = (square + size * (field - want).powi(2), area + size, direct.max(straight));
    }
    let [found, want] = [0, 1].map(|k| rings.iter().map(|ring| ring[k]).sum::<f64>());
    let rms = (square * area).sqrt() / want;
    FloorLight { whole: found / want, rings: rings.map(|[found, want]| found / want), rms, direct }
}

/// A floor of 4 m x 4 m that reflects half of the light, a bulb of 1257 lm above it, and what is around them.
/// - `at`: position of the bulb, m.
fn bulb([x, y, z]: [f64; 3], around: &str) -> Prepared {
    let floor = face(&[[-2.0, -2.0, 0.0], [2.0, -2.0, 0.0], [2.0, 2.0, 0.0], [-2.0, 2.0, 0.0]]);
    prepare(&format!(
        "m gray =\n  sides 1\n  c\n  rd 0.5\nm gray\n{floor}m bright =\n  sides 1\n  c\n  ed 1000000\nm bright\n\
         v s =\n  p {x} {y} {z}\nsph s 0.01\n{around}"
    ))
}

/// Intensity of the bulb, cd.
const INTENSITY: f64 = 1e6 * 1e-4;

/// A bulb in the middle of a ball of glass shines evenly in all directions, so the floor has the light of a point.
#[test]
fn a_bulb_in_a_ball_of_glass_lights_a_floor_as_a_point_does() {
    let at = [0.0, 0.0, 1.0];
    let prepared = bulb(at, "m glass =\n  sides 1\n  ir 1.52 0\n  c\n  ts 1 0\nm glass\nsph s 0.05\n");
    // The ball reflects 4.26 % at normal incidence, to the bulb, which absorbs it.
    let FloorLight { whole, rings, rms, direct } = floor_light(&prepared, at, INTENSITY * (1.0 - 0.0426));
    assert!((whole - 1.0).abs() < 0.02, "{whole}");
    assert!(rings.iter().all(|ring| (ring - 1.0).abs() < 0.05), "{rings:?}");
    assert!(rms < 0.1 && direct < 1e-3, "{rms} {direct}");
}

/// A mirror beside the floor shows a second bulb. The first one is direct light, which the field does not have.
#[test]
fn mirror_beside_a_floor_shows_a_second_bulb() {
    let wall = face(&[[-2.0, -20.0, 0.0], [-2.0, 20.0, 0.0], [-2.0, 20.0, 20.0], [-2.0, -20.0, 20.0]]);
    let prepared = bulb([-1.2, 0.4, 1.0], &format!("m mirror =\n  sides 2\n  c\n  rs 0.9 0\nm mirror\n{wall}"));
    let FloorLight { whole, rings, rms, direct } = floor_light(&prepared, [-2.8, 0.4, 1.0], 0.9 * INTENSITY);
    assert!((whole - 1.0).abs() < 0.02, "{whole}");
    assert!(rings.iter().all(|ring| (ring - 1.0).abs() < 0.06), "{rings:?}");
    assert!(rms < 0.13 && direct > 50.0, "{rms} {direct}");
}

/// Without mirrors and clear solids there are no particles.
#[test]
fn rooms_without_mirrors_and_clear_solids_have_no_particles() {
    let prepared = bulb([0.0, 0.0, 1.0], "m white =\n  c\n  rd 0.8\nm white\nv t =\n  p 0 0 0.3\nsph t 0.1\n");
    let scene = Scene::new(&prepared);
    let (caustics, rays) = Caustics::trace(&scene, &Arena::new(&scene));
    assert!(caustics.is_empty() && rays == 0);
}

/// A lamp that reflects the light of another one, seen in a mirror. Its own light is so weak that only the reflection counts.
#[test]
fn mirror_shows_the_reflection_of_a_lamp() {
    // The panel, which a screen hides from the floor, stands on the other side of the lamp that lights it.
    let scene = |emitted: &str| {
        let face_of = |x: f64, y: [f64; 2], z: [f64; 2]| {
            face(&[[x, y[0], z[0]], [x, y[1], z[0]], [x, y[1], z[1]], [x, y[0], z[1]]])
        };
        let floor = face(&[[1.0, -1.0, 0.0], [3.0, -1.0, 0.0], [3.0, 1.0, 0.0], [1.0, 1.0, 0.0]]);
        let (panel, screen) = (face_of(-2.0, [-1.0, 1.0], [0.5, 2.5]), face_of(0.0, [-3.0, 3.0], [-1.0, 1.6]));
        let mirror = face(&[[-2.0, -4.0, 3.0], [4.0, -4.0, 3.0], [4.0, 4.0, 3.0], [-2.0, 4.0, 3.0]]);
        prepare(&format!(
            "m gray =\n  sides 1\n  c\n  rd 0.5\nm gray\n{floor}m black =\n  sides 2\n  c\n  rd 0\nm black\n{screen}\
             m panel =\n  sides 2\n  c\n  rd 0.8\n{emitted}m panel\n{panel}m mirror =\n  sides 2\n  c\n  rs 0.9 0\nm mirror\n{mirror}\
             m bright =\n  sides 1\n  c\n  ed 100000\nm bright\n{}",
            face(&[[-0.5, -0.1, 1.4], [-0.5, 0.1, 1.4], [-0.5, 0.1, 1.6], [-0.5, -0.1, 1.6]])
                .replace("f c0 c1 c2 c3", "f c3 c2 c1 c0")
        ))
    };
    let received = |prepared: &Prepared| {
        points(prepared, &solution(prepared), 0).iter().map(|point| point.size * point.field).sum::<f64>()
    };
    let [dark, lamp] = ["", "  ed 1e-6\n"].map(|emitted| received(&scene(emitted)));
    assert!(dark > 1.0 && (lamp / dark - 1.0).abs() < 0.05, "{lamp} lm instead of {dark}");
}

/// Fog of four free paths in all directions scatters nearly all light of a bulb in a ball of glass, in which there is no fog.
#[test]
fn fog_around_a_bulb_in_a_ball_of_glass_scatters_its_light() {
    let at = [0.0, 0.0, 2.5];
    let around = "m glass =\n  sides 1\n  ir 1.52 0\n  c\n  ts 1 0\nm glass\nsph s 0.3\n\
                  medium fog =\n  sigma_s 2\nmbox fog -2 -2 0.1 2 2 5\n";
    let prepared = bulb(at, around);
    let scene = Scene::new(&prepared);
    let mut arena = Arena::new(&scene);
    let fog = arena.fog;
    super::split(&mut arena, &scene, fog, 6);
    let light = Caustics::trace(&scene, &arena).0.light(&arena);
    let scattered = |leaf: u32| {
        let (element, nodes) = (&arena.elements[leaf as usize], light.nodes[leaf as usize]);
        let mean = nodes.iter().map(|node| f64::from(luminance(*node))).sum::<f64>() / 4.0;
        mean * f64::from(luminance(element.received_share()) * element.size())
    };
    let found: f64 = super::leaves_of(&arena, fog).into_iter().map(scattered).sum();
    let sent = 4.0 * std::f64::consts::PI * INTENSITY * (1.0 - 0.0426);
    assert!((found / sent - 1.0).abs() < 0.03, "{found} lm of {sent}");
}
