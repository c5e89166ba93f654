//! Bounds of light between any two elements, against exact form factors of polygons and point samples of other shapes.

use super::{GRAY, face, full_arena, oracle, prepare, split};
use crate::arena::Arena;
use crate::bounds::{Extent, Interval, form_factor, irradiance, transmittance};
use crate::element::Element;
use crate::gather::ElementLights;
use crate::scene::Scene;
use crate::solve::{SolveOptions, SolverState};
use crate::visibility::{RandomNumbers, VisibilityTester};
use femc_field::{Form, Side};
use femc_math::color::luminance;
use femc_math::glam::{DVec3, Vec2};
use std::f64::consts::PI;
use std::fmt::Write as _;
use std::sync::atomic::AtomicBool;

/// Returns surfaces of all kinds and sizes that touch, overlap, or are far from each other, in a box of fog.
fn random_world(numbers: &mut RandomNumbers) -> String {
    let mut text = String::from(
        "medium haze =\n  crgb 0.3 0.6 1\n  sigma_s 0.1\n  sigma_a 0.1\nmbox haze -3 -3 -1 3 1 2\n\
         medium ground =\n  sigma_s 0.1\n  density height 0 0.5\nmglobal ground\n",
    );
    let mut anchor = [0.0f32; 3];
    for index in 0..24 {
        let size = 10.0f32.powf(3.5 * numbers.next() - 2.5);
        if numbers.next() < 0.6 {
            anchor = [0; 3].map(|_| 6.0 * numbers.next() - 3.0);
        }
        let mut near = |scale: f32| {
            let [x, y, z] = anchor.map(|x| x + scale * (2.0 * numbers.next() - 1.0));
            format!("{x} {y} {z}")
        };
        let [a, b, c] = [near(0.0), near(size), near(size)];
        let (d, needle) = (near(0.3 * size), near(0.01 * size));
        let direction = near(10.0);
        let (share, turn) = (0.05 + 0.9 * numbers.next(), 360.0 * numbers.next());
        let sides = 1 + u32::from(numbers.next() < 0.3);
        write!(text, "m gray{index} =\n  sides {sides}\n  c\n  rd 0.5\nm gray{index}\n").unwrap();
        let moved = numbers.next() < 0.3;
        if moved {
            writeln!(text, "xf -rz {turn} -rx 40 -s {}", 0.5 + share).unwrap();
        }
        let inward = if numbers.next() < 0.3 { "-" } else { "" };
        match (numbers.next() * 8.0) as u32 {
            0 => write!(text, "v a =\n  p {a}\nv b =\n  p {b}\nv c =\n  p {c}\nf a b c\n").unwrap(),
            1 => write!(text, "v a =\n  p {a}\nv b =\n  p {b}\nv c =\n  p {needle}\nf a b c\n").unwrap(),
            2 => {
                let [p, q, r] = [&a, &b, &c].map(|at| at.split(' ').map(|x| x.parse().unwrap()).collect::<Vec<f32>>());
                let far = [0, 1, 2].map(|k| q[k] + r[k] - p[k]);
                let far = format!("{} {} {}", far[0], far[1], far[2]);
                write!(text, "v a =\n  p {a}\nv b =\n  p {b}\nv d =\n  p {far}\nv c =\n  p {c}\nf a b d c\n").unwrap();
            }
            3 => write!(text, "v a =\n  p {a}\nsph a {inward}{size}\n").unwrap(),
            4 => write!(text, "v a =\n  p {a}\nv b =\n  p {b}\ncyl a {inward}{} b\n", size * share).unwrap(),
            5 => {
                let (from, to) = (size * share, size * (1.0 - share));
                write!(text, "v a =\n  p {d}\nv b =\n  p {c}\ncone a {inward}{from} b {inward}{to}\n").unwrap();
            }
            6 => write!(text, "v a =\n  p {a}\n  n {direction}\nring a {} {size}\n", share * size).unwrap(),
            _ => write!(text, "v a =\n  p {a}\n  n {direction}\ntorus a {inward}{} {inward}{size}\n", share * size)
                .unwrap(),
        }
        if moved {
            text += "xf\n";
        }
    }
    text
}

/// A point, and its normal on a surface.
#[derive(Clone, Copy, Debug)]
struct Point {
    position: DVec3,
    normal: Option<DVec3>,
}

/// Returns a point of a part of a surface or of fog, in double precision.
fn point_of(scene: &Scene<'_>, element: &Element, local: Vec2, height: f32) -> Point {
    let Some(part) = element.surface_part() else {
        let place = DVec3::new(local.x.into(), local.y.into(), height.into()) * 2.0 - 1.0;
        return Point { position: element.center.as_dvec3() + element.half_extent.as_dvec3() * place, normal: None };
    };
    let (surface, at) = (&scene.surfaces[part.surface as usize], part.outline.point_at(local).as_dvec2());
    let (position, normal) = match &surface.form {
        Form::Triangle([corner, a, b]) | Form::Parallelogram([corner, a, b]) => {
            let [corner, a, b] = [corner, a, b].map(|v| v.as_dvec3());
            (corner + a * at.x + b * at.y, a.cross(b))
        }
        Form::Curved { shape, pose } => {
            let (position, normal) = shape.point_at([at.x, shape.parameter_at_share(at.y)]);
            let columns = [pose.matrix3.x_axis, pose.matrix3.y_axis, pose.matrix3.z_axis].map(|axis| axis.as_dvec3());
            let turned = |v: DVec3| columns[0] * v.x + columns[1] * v.y + columns[2] * v.z;
            (turned(position) + pose.translation.as_dvec3(), turned(normal))
        }
    };
    let normal = if surface.side == Side::Back { -normal } else { normal };
    Point { position, normal: Some(normal.normalize()) }
}

/// A part of a source, prepared for the reference.
enum Part {
    /// Corners in double precision, counterclockwise as seen from the side.
    Polygon(Vec<DVec3>),
    /// Points with equal shares of a size.
    Points(Vec<Point>, f64),
}

const POINTS: u32 = 128;

fn part_of(scene: &Scene<'_>, element: &Element, numbers: &mut RandomNumbers) -> Part {
    let polygon = element.patch().filter(|patch| !patch.polygon().is_empty());
    let Some(patch) = polygon else {
        let mut next = || point_of(scene, element, Vec2::new(numbers.next(), numbers.next()), numbers.next());
        return Part::Points((0..POINTS).map(|_| next()).collect(), f64::from(element.size()));
    };
    let ends: &[Vec2] = if patch.polygon().len() == 3 {
        &[Vec2::ZERO, Vec2::X, Vec2::Y]
    } else {
        &[Vec2::ZERO, Vec2::X, Vec2::ONE, Vec2::Y]
    };
    let corners: Vec<DVec3> = ends.iter().map(|end| point_of(scene, element, *end, 0.0).position).collect();
    let turn = (corners[1] - corners[0]).cross(corners[2] - corners[0]);
    let is_turned = turn.dot(patch.normal.as_dvec3()) < 0.0;
    Part::Polygon(if is_turned { corners.into_iter().rev().collect() } else { corners })
}

/// Returns the form factor of a part at a point, and its standard deviation.
fn factor(at: &Point, part: &Part) -> [f64; 2] {
    match (part, at.normal) {
        (Part::Polygon(corners), Some(normal)) => [lambert(at.position, normal, corners), 0.0],
        (Part::Polygon(corners), None) => {
            let angle: f64 = (1..corners.len() - 1)
                .map(|k| {
                    let [a, b, c] = [corners[0], corners[k], corners[k + 1]].map(|p| (p - at.position).normalize());
                    2.0 * (-a.dot(b.cross(c))).atan2(1.0 + a.dot(b) + b.dot(c) + c.dot(a))
                })
                .sum();
            [angle.max(0.0) / (4.0 * PI), 0.0]
        }
        (Part::Points(points, size), normal) => {
            let kernel = |from: &Point| {
                let way = from.position - at.position;
                let (distance2, dir) = (way.length_squared(), way.normalize_or_zero());
                let arriving = normal.map_or(0.25, |normal| normal.dot(dir).max(0.0));
                let leaving = from.normal.map_or(1.0, |normal| (-normal.dot(dir)).max(0.0));
                if distance2 > 0.0 { arriving * leaving / (PI * distance2) * size } else { 0.0 }
            };
            let n = points.len() as f64;
            let (sum, squares) = points.iter().map(kernel).fold((0.0, 0.0), |(s, q), x| (s + x, q + x * x));
            let mean = sum / n;
            [mean, ((squares / n - mean * mean).max(0.0) / (n - 1.0)).sqrt()]
        }
    }
}

/// Returns Lambert's form factor in double precision, of the part of a polygon above the horizon.
fn lambert(point: DVec3, normal: DVec3, corners: &[DVec3]) -> f64 {
    let mut above = Vec::new();
    for (k, &corner) in corners.iter().enumerate() {
        let (a, b) = (corner - point, corners[(k + 1) % corners.len()] - point);
        let (ha, hb) = (normal.dot(a), normal.dot(b));
        if ha >= 0.0 {
            above.push(a);
        }
        if ha * hb < 0.0 {
            above.push(a + (b - a) * (ha / (ha - hb)));
        }
    }
    let edge = |k: usize| {
        let (a, b) = (above[k], above[(k + 1) % above.len()]);
        let across = a.cross(b);
        let sine = across.length();
        if sine > 0.0 { sine.atan2(a.dot(b)) * normal.dot(across) / sine } else { 0.0 }
    };
    (-(0..above.len()).map(edge).sum::<f64>() / (2.0 * PI)).max(0.0)
}

/// Parts of surfaces under an element; fog for fog.
fn parts_under(arena: &Arena, index: u32) -> Vec<u32> {
    let element = &arena.elements[index as usize];
    if !element.is_cluster() {
        return vec![index];
    }
    element.children.into_iter().flat_map(|child| parts_under(arena, child)).collect()
}

/// Result of comparing bounds with references.
#[derive(Default)]
struct Comparison {
    pairs: usize,
    /// Pairs of points whose factor or transmittance is not within the bounds.
    violations: Vec<String>,
    /// Distance in sums of the radii, and upper bound over the factor; for pairs of flat elements, and for other pairs.
    tightness: [Vec<[f64; 2]>; 2],
    /// Number of pairs whose factor is proved to be 0, and that whose factor is 0.
    zero: [usize; 2],
}

impl Comparison {
    /// Compares random pairs of one world.
    fn compare(&mut self, seed: u64, pairs: usize) {
        let mut numbers = RandomNumbers::new(&[seed, 0xb0]);
        let prepared = prepare(&random_world(&mut numbers));
        let scene = Scene::new(&prepared);
        let mut arena = full_arena(&scene);
        for root in 0..arena.elements.len() as u32 {
            if !arena.elements[root as usize].is_cluster() {
                split(&mut arena, &scene, root, (numbers.next() * 5.0) as u32);
            }
        }
        let count = arena.elements.len();
        let parts: Vec<Option<Part>> = arena
            .elements
            .iter()
            .map(|element| (!element.is_cluster()).then(|| part_of(&scene, element, &mut numbers)))
            .collect();
        let extents: Vec<Option<Extent>> = arena.elements.iter().map(Extent::new).collect();
        let mut tester = VisibilityTester::default();
        let clusters: Vec<usize> = (0..count).filter(|&index| arena.elements[index].is_cluster()).collect();
        for _ in 0..pairs {
            let mut choose = || match (numbers.next() < 0.15, numbers.next()) {
                (true, u) => clusters[(u * clusters.len() as f32) as usize],
                (false, u) => (u * count as f32) as usize,
            };
            let [p, q] = [choose(), choose()];
            let (Some(receiver), Some(source)) = (&extents[p], &extents[q]) else { continue };
            let (under, sources) = (parts_under(&arena, p as u32), parts_under(&arena, q as u32));
            let pick = |parts: &[u32], u: f32| parts[(u * parts.len() as f32) as usize] as usize;
            let (of_p, of_q) = (pick(&under, numbers.next()), pick(&sources, numbers.next()));
            let mut point = |index: usize| {
                let element = &arena.elements[index];
                let mut local = Vec2::new(numbers.next(), numbers.next());
                if numbers.next() < 0.3 {
                    local = local.round();
                }
                if element.is_triangle() && local.x + local.y > 1.0 {
                    local = Vec2::ONE - local;
                }
                point_of(&scene, element, local, numbers.next())
            };
            let (at, other) = (point(of_p), point(of_q));
            let [mut factor_at, mut variance] = [0.0; 2];
            for &part in &sources {
                let [part, deviation] = parts[part as usize].as_ref().map_or([0.0; 2], |part| factor(&at, part));
                (factor_at, variance) = (factor_at + part, variance + deviation * deviation);
            }
            let (bound, noise) = (form_factor(receiver, source), 6.0 * variance.sqrt());
            self.pairs += 1;
            let holds = bound.low.is_finite()
                && f64::from(bound.low) <= factor_at + noise + 1e-12
                && factor_at - noise <= f64::from(bound.high) + 1e-9;
            let [from, to] = [at, other].map(|point| point.position.as_vec3a());
            let through = f64::from(tester.fog_transmittance(&scene, from, to));
            let fog = transmittance(&prepared.media, receiver, source);
            let fog_holds = (f64::from(fog.low) - 1e-5..=f64::from(fog.high) + 1e-5).contains(&through);
            // Of a source whose radiosity is between 0.5 and 2.
            let (low, high, radiosity) = (0.5, 2.0, f64::from(0.5 + 1.5 * numbers.next()));
            let light = irradiance(&prepared.media, receiver, source, Interval { low, high });
            let arriving = |factor: f64| factor * through * radiosity;
            let light_holds = f64::from(light.low) <= arriving(factor_at + noise) + 1e-5
                && arriving(factor_at - noise) <= f64::from(light.high) * 1.0001 + 1e-9;
            let misses = [(at, receiver), (other, source)].map(|(point, extent)| outside(extent, &point));
            if !(holds && fog_holds && light_holds && misses.iter().flatten().all(|miss| *miss <= 0.0)) {
                let [p, q] = [p, q].map(|index| &arena.elements[index].shape);
                self.violations.push(format!(
                    "world {seed}, {holds} {fog_holds} {light_holds} {misses:?}: {factor_at} with noise {noise}, not in {bound:?}; {through} in {fog:?}; {at:?} {receiver:?} {source:?} {p:?} {q:?}"
                ));
            }
            self.zero[0] += usize::from(bound.high == 0.0);
            self.zero[1] += usize::from(factor_at == 0.0);
            if factor_at > 1e-9 && variance.sqrt() < 0.1 * factor_at {
                let [a, b] = [receiver, source].map(|extent| extent.half.length());
                let distance = (receiver.center - source.center).length() / (a + b);
                let is_flat = receiver.plane.is_some() && source.plane.is_some();
                self.tightness[usize::from(!is_flat)].push([distance, f64::from(bound.high) / factor_at]);
            }
        }
    }

    /// Prints the median of upper bound over factor by distance.
    fn print_tightness(&mut self) {
        println!("{} pairs, {} violations; factor 0: {:?} proved, all", self.pairs, self.violations.len(), self.zero);
        for (pairs, what) in self.tightness.iter().zip(["flat", "other"]) {
            println!("{what} elements: distance in radii\tpairs\tbound / factor: first quarter\tmedian\tthird quarter");
            let ends = [0.0, 0.5, 1.0, 2.0, 4.0, 8.0, 16.0, 64.0, f64::INFINITY];
            for [from, to] in ends.array_windows() {
                let mut ratios: Vec<f64> =
                    pairs.iter().filter(|it| (*from..*to).contains(&it[0])).map(|it| it[1]).collect();
                ratios.sort_by(f64::total_cmp);
                if let n @ 1.. = ratios.len() {
                    let [low, middle, high] = [n / 4, n / 2, n * 3 / 4].map(|k| ratios[k]);
                    println!("{from} to {to}\t{n}\t{low:.3}\t{middle:.3}\t{high:.3}");
                }
            }
        }
    }
}

/// Returns the distance of a point from the box that the bounds use, and the angle of its normal from the cone; not positive inside.
fn outside(extent: &Extent, point: &Point) -> [f64; 2] {
    let off = (point.position - extent.center).abs() - extent.half;
    let angle = point.normal.zip(extent.normals).map_or(0.0, |(normal, cone)| {
        let axis = cone.axis.as_dvec3();
        axis.cross(normal).length().atan2(axis.dot(normal)) - f64::from(cone.angle) - 2e-7
    });
    [off.max_element(), angle]
}

#[test]
fn random_pairs_are_within_their_bounds() {
    let mut comparison = Comparison::default();
    (0..20).for_each(|seed| comparison.compare(seed, 1000));
    assert!(comparison.violations.is_empty(), "{:#?}", &comparison.violations[..comparison.violations.len().min(3)]);
    assert!(comparison.pairs > 15_000);
    // Bounds that are far too large would hold as well.
    let mut far: Vec<f64> = comparison.tightness.iter().flatten().filter(|it| it[0] > 4.0).map(|it| it[1]).collect();
    far.sort_by(f64::total_cmp);
    assert!(far[far.len() / 2] < 3.0, "{}", far[far.len() / 2]);
    assert!(comparison.zero[0] * 3 > comparison.zero[1], "{:?} factors of 0", comparison.zero);
}

/// Nodes and centers of parts of a floor and of fog, with the factors that links have. Factors of fog are exact to some percent.
#[test]
fn factors_of_links_are_within_their_bounds() {
    let floor = face(&[[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [0.0, 1.0, 0.0]]);
    let wall = face(&[[0.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 1.0, 1.0], [0.0, 0.0, 1.0]]);
    let prepared = prepare(&format!("medium haze =\n  sigma_s 0.7\nmglobal haze\n{GRAY}{floor}{wall}"));
    let scene = Scene::new(&prepared);
    let mut arena = full_arena(&scene);
    for root in [arena.roots[0], arena.roots[1], arena.fog] {
        split(&mut arena, &scene, root, 5);
    }
    let lights = ElementLights::new(&arena);
    let oracle = oracle(&scene, &arena, &lights.elements);
    let (mut tester, mut checked) = (VisibilityTester::default(), 0);
    let elements = || arena.elements.iter().filter(|element| !element.is_directional());
    for (p, q) in elements().flat_map(|p| elements().map(move |q| (p, q))).filter(|(p, q)| p.key != q.key) {
        let gap = (p.center - q.center).abs() - 0.999 * (p.half_extent + q.half_extent);
        if p.is_volume() && q.is_volume() && gap.max_element() < 0.0 {
            // A box and its part are not linked.
            continue;
        }
        let [receiver, source] = [p, q].map(|element| Extent::new(element).expect("bounds"));
        let through = transmittance(&prepared.media, &receiver, &source);
        let bound = form_factor(&receiver, &source).product(through);
        for spot in p.nodes().chain([p.center_spot()]) {
            let factor = oracle.factor(p, q, &spot, &mut tester);
            assert!(factor <= 1.1 * bound.high && factor >= 0.9 * bound.low, "{factor} {bound:?} {p:?} {q:?}");
            checked += 1;
        }
    }
    assert!(checked > 100_000, "{checked}");
}

/// A lamp, a floor, a wall that hides a part of it, and fog.
#[test]
fn links_bring_no_more_than_the_bounds_allow() {
    let floor = face(&[[-2.0, -2.0, 0.0], [2.0, -2.0, 0.0], [2.0, 2.0, 0.0], [-2.0, 2.0, 0.0]]);
    let wall = face(&[[-2.0, 0.5, 0.0], [1.6, 0.5, 0.0], [1.6, 0.5, 2.0]]);
    let lamp = "m bright =\n  c\n  ed 2000\nm bright\nv l =\n  p -1 -1 1\nsph l 0.2\n";
    let prepared =
        prepare(&format!("medium haze =\n  sigma_s 0.1\nmbox haze -2 -2 0 2 2 2\n{GRAY}{floor}{wall}{lamp}"));
    let options = SolveOptions { error: 0.2, ..SolveOptions::default() };
    let state = SolverState::new(&prepared, &options, &AtomicBool::new(false)).unwrap();
    let bounded: Vec<Option<(Extent, Interval)>> = state.bounded_elements().collect();
    let (mut checked, mut lit) = (0, 0);
    for link in &state.links {
        let [p, q] = [link.receiver, link.source].map(|index| index as usize);
        if link.receiver == link.source || [p, q].iter().any(|&index| state.arena.elements[index].is_directional()) {
            continue;
        }
        let (Some((receiver, _)), Some((source, sent))) = (bounded[p], bounded[q]) else { panic!("{link:?}") };
        let bound = irradiance(&prepared.media, &receiver, &source, sent);
        let radiosity = luminance(state.lights.elements[q].radiosity);
        // Light that the nodes miss is spread over a box of fog.
        let nodes = &link.factors[..state.arena.elements[p].node_count()];
        let arriving = radiosity * nodes.iter().copied().fold(f32::INFINITY, f32::min);
        assert!(arriving <= 1.1 * bound.high, "{arriving} {bound:?} {link:?} {receiver:?} {source:?}");
        (checked, lit) = (checked + 1, lit + usize::from(arriving > 0.05 * bound.high));
    }
    assert!(checked > 1000 && lit > 100, "{checked} {lit}");
}

/// `cargo test --release -p femc-radiosity bounds -- --ignored --nocapture`
#[test]
#[ignore = "takes minutes"]
fn a_million_random_pairs_are_within_their_bounds() {
    let mut comparison = Comparison::default();
    let mut seed = 1000;
    while comparison.pairs < 1_000_000 {
        comparison.compare(seed, 4000);
        seed += 1;
    }
    comparison.print_tightness();
    assert!(comparison.violations.is_empty(), "{:#?}", &comparison.violations[..comparison.violations.len().min(3)]);
}
