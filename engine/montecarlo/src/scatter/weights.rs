//! Weights of all techniques that find the same light from the same vertex: they sum to 1.
//!
//! Each test samples a lamp from a vertex. Then it searches for the random numbers with which the path leaves the vertex in the
//! direction of that sample, and lets the path hit the lamp. A weight is the ratio of the light with all techniques to the light
//! with one of them alone. So the tests check the weights that real samples have. They use no density of their own.

use super::*;
use crate::dimensions as dim;
use crate::fog::{Collision, FogSampler, FoggyRay};
use crate::guided::GuideDirections;
use crate::technique::MisTechnique;
use crate::test_scene::{path_along, prepare};
use crate::tracer::{Guidance, PathSettings};
use crate::window::WeightWindow;
use femc_emission::{DeltaKind, LightSample, LightWeights};
use femc_field::{
    Ball, Cell, DirectionTable, DirectionTables, Form, Leaf, Outline, Parallelogram, RegionTargets, Split, Surface,
    TABLE_CELLS, TableCells, TableExtent, TargetGuide, TargetPack,
};
use femc_math::glam::Vec3A;
use femc_math::hash::{mix64, unit_f32};
use femc_prepared::Prepared;
use femc_prepared::media::DistanceSample;
use femc_stats::testing::chi2::Cells;
use femc_stats::testing::{Moments, sphere_test};

/// Maximum distance of a found direction from the requested one.
const NEAR: f32 = 5e-6;
/// Maximum difference of a sum of weights from 1.
const ROUNDING: f32 = 2e-3;

/// Lamps of several forms and sizes above the origin.
const LAMPS: &str = "\
m bright =
 sides 2
 c
 ed 300
m dim =
 sides 1
 c
 ed 40
m bright
v s =
 p .6 .3 1.2
sph s .25
m dim
v a =
 p -.9 -.5 .8
v b =
 p -.9 .5 .8
v c =
 p -.4 .5 1.4
v d =
 p -.4 -.5 1.4
f a b c d
m bright
v r =
 p .2 -.9 1
 n 0 .6 -.8
ring r .05 .2
v tiny =
 p .1 .5 .9
sph tiny .01
";

/// Returns the scene of a floor below the lamps.
/// - `material`: lines of the floor's material.
fn floor(material: &str) -> Prepared {
    let corners = "v e =\n p -2 -2 0\nv f =\n p 2 -2 0\nv g =\n p 2 2 0\nv h =\n p -2 2 0\n";
    prepare(&format!("{LAMPS}m floor =\n sides 2\n{material}m floor\n{corners}f e f g h\n"))
}

/// Materials of the floor: matte, rough, nearly a mirror under a coat, and a sheet that transmits.
const MATERIALS: [(&str, &str); 4] = [
    ("matte", " c\n rd .7\n"),
    ("rough", " c\n rd .2\n rs .5 .3\n"),
    ("coat", " c\n crgb .6 .3 .1\n rd .5\n c\n rs .2 .05\n"),
    ("sheet", " c\n rd .3\n td .3\n rs .1 .4\n"),
];

/// A field over the floor, and its guide.
struct Guide {
    field: Field,
    targets: Option<TargetGuide>,
}

impl Guide {
    /// Returns the guide at a point of the floor, and its share of directions.
    fn at(&self, surface: &SurfaceInteraction<'_>) -> Option<(GuideDirections<'_>, f32)> {
        let (guide, share) = SurfaceGuide::new(&self.field, self.targets.as_ref(), surface).leaf?;
        Some((guide.directions_at(surface.point.position)?, share))
    }
}

fn field() -> Field {
    let form = Form::Parallelogram([Vec3A::new(-2.0, -2.0, 0.0), Vec3A::X * 4.0, Vec3A::Y * 4.0]);
    let surface = Surface { instance: 0, primitives: [0; 2], material: 0, side: Side::Front, form };
    Field {
        surfaces: vec![surface],
        roots: vec![0],
        cells: vec![Cell { outline: Outline::WHOLE, split: Split::None, next: 0 }],
        leaves: vec![Leaf::Rectangle([Rgb::splat(5.0); 4])],
        sides: vec![vec![[0; 2]; 64]; 4],
        ..Field::default()
    }
}

/// Returns a guide that samples most of the directions toward two targets: a ball around a lamp, and a parallelogram beside the lamps.
fn target_guide() -> Guide {
    let field = field();
    let ball = Ball { center: Vec3A::new(0.6, 0.3, 1.2), radius: 0.4 };
    let beside = Parallelogram { corner: Vec3A::new(-1.9, 0.4, 0.2), edges: [Vec3A::Y, Vec3A::new(0.3, 0.0, 0.9)] };
    let region = RegionTargets { shares: [0.4, 0.3, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0], ..Default::default() };
    let pack = TargetPack::new(&[ball.into(), beside.into()]);
    let targets = Some(TargetGuide::new(&field, vec![pack], vec![region], &[0]));
    Guide { field, targets }
}

/// Returns a guide with a table of directions, mostly toward the lamps.
fn table_guide() -> Guide {
    let extent = TableExtent::Hemisphere(Vec3A::Z);
    let mut light = [0.2; TABLE_CELLS];
    for dir in [Vec3A::new(0.6, 0.3, 1.2), Vec3A::new(-0.6, 0.0, 1.1)] {
        light[TableCells::new(extent).find(dir.normalize()).expect("above the floor")] = 30.0;
    }
    let tables = DirectionTables::new(vec![DirectionTable::new(extent, &light)], Vec::new());
    Guide { field: Field { tables, ..field() }, targets: None }
}

fn settings(single_technique: Option<MisTechnique>) -> PathSettings {
    PathSettings { seed: 1, max_depth: 0, single_technique }
}

/// Returns the ray to a point of the floor.
fn ray_to_floor(scene: &Prepared, number: u32) -> Ray {
    let at = |k: u32| unit_f32((mix64(u64::from(3 * number + k)) >> 32) as u32) - 0.5;
    let height = if number % 4 == 3 { -1.0 } else { 1.0 };
    let target = Vec3A::new(at(0), at(1), 0.0);
    let origin = Vec3A::new(0.5 + at(2), -2.0, height);
    let shift = scene.origin.as_vec3a();
    Ray { origin: origin - shift, dir: (target - origin).normalize(), t_max: f32::INFINITY, time: 0.5 }
}

fn interaction<'s>(scene: &'s Prepared, ray: &Ray) -> SurfaceInteraction<'s> {
    let hit = scene.world.intersect(ray).expect("the floor");
    SurfaceInteraction::new(scene, ray, hit, scene.shading_point(ray, &hit))
}

/// Repeats the choice of a lamp, and of a point on it, by a path at a surface.
fn repeat_lamp_sample(
    scene: &Prepared,
    path: &PathState,
    surface: &SurfaceInteraction<'_>,
) -> Option<(u32, LightSample)> {
    let context = scene.lights.point_context(surface.point.position, surface.lit_side(), surface.lobes(path.ray.dir));
    let (mut weights, mut stream) = (LightWeights::default(), path.stream);
    scene.lights.weigh(&context, &mut weights);
    let number = || dim::draw_48(&mut stream, path.base + dim::LIGHT);
    let (light, _) = scene.lights.choose(&weights, &context, number)?;
    stream.seek(path.base + dim::LIGHT_POINT);
    let (position, u) = (surface.point.position, stream.next_2d());
    let sample = scene.lights.sample_light(&scene.world, &scene.textures, light, position, path.ray.time, u)?;
    Some((light, sample))
}

/// Searches for the numbers, in a part of the square, with which a sampler samples a direction. `None`: there are none.
/// - `wi`: unit, local frame;
/// - `part`: range of the first number.
fn search(directions: &DirectionSampler<'_>, wi: Vec3A, part: [f32; 2], choice: f32) -> Option<DirectionNumbers> {
    const GRID: u32 = 24;
    let distance = |u: [f32; 2]| {
        let sample = directions.sample(u, choice).filter(|found| found.sample.lobe != LobeKind::Delta);
        sample.map_or(f32::INFINITY, |found| (found.sample.wi - wi).length())
    };
    let size = part[1] - part[0];
    let inside = |u: [f32; 2]| [u[0].clamp(part[0], part[1] - 1e-6), u[1] - u[1].floor()];
    let cells = (0..GRID * GRID).map(|at| [at % GRID, at / GRID].map(|k| (k as f32 + 0.5) / GRID as f32));
    let starts = cells.map(|[x, y]| [part[0] + size * x, y]).map(|u| (distance(u), u));
    let (mut least, mut best) = starts.min_by(|a, b| a.0.total_cmp(&b.0))?;
    let mut step = [size / GRID as f32, 1.0 / GRID as f32];
    for _ in 0..60 {
        let center = best;
        for [x, y] in (0..25).map(|at| [at % 5 - 2, at / 5 - 2]) {
            let u = inside([center[0] + 0.5 * x as f32 * step[0], center[1] + 0.5 * y as f32 * step[1]]);
            let found = distance(u);
            if found < least {
                (least, best) = (found, u);
            }
        }
        if best == center {
            step = step.map(|step| 0.6 * step);
        }
    }
    (least < NEAR).then_some(DirectionNumbers { u: best, choice })
}

/// Weights at the vertices of one scene.
#[derive(Default)]
struct Tally {
    /// Number of sums, of those from directions of the guide, and of those in which no weight is close to 0.
    sums: u32,
    by_guide: u32,
    balanced: u32,
}

impl Tally {
    /// Adds the sums of the weights at one vertex. Each way to sample the direction of the lamp's point gives a sum.
    fn add(&mut self, name: &str, scene: &Prepared, guide: Option<&Guide>, number: u32) {
        let ray = ray_to_floor(scene, number);
        let surface = &interaction(scene, &ray);
        let path = path_along(scene, ray, number.into());
        let Some((light, sample)) = repeat_lamp_sample(scene, &path, surface) else { return };
        let tracer = |technique| {
            let tracer = Tracer::new(scene, settings(technique));
            let Some(Guide { field, targets }) = guide else { return tracer };
            let (targets, window) = (targets.as_ref(), WeightWindow::OPEN);
            tracer.with_guidance(Guidance { field, targets, samples_directions: true, window, frame_light: 1.0 })
        };
        let sampled = |technique| {
            let (mut tracer, mut out) =
                (tracer(technique), PathSample { color: Rgb::ZERO, albedo: Rgb::ZERO, depth: f32::INFINITY });
            let _ = tracer.scatter_at_surface::<false, false>(&mut path.clone(), surface.clone(), &mut out);
            (tracer, out.color)
        };
        let (mut all, light_of_all) = sampled(None);
        let (mut by_scattering, nothing) = sampled(Some(MisTechnique::Scatter));
        let (_, light_alone) = sampled(Some(MisTechnique::Light));
        assert_eq!(nothing, Rgb::ZERO, "{name}: a lamp was sampled");
        if light_alone == Rgb::ZERO {
            return;
        }
        let weight_of_light = luminance(light_of_all) / luminance(light_alone);
        assert_ne!(sample.delta, DeltaKind::Position);
        let guide = guide.and_then(|guide| guide.at(surface));
        let mut directions = DirectionSampler::new(&surface.bsdf, &surface.frame, surface.wo);
        let mut parts = vec![];
        let mut first = 0.0;
        if let Some((guide, share)) = &guide {
            directions.add_guide(guide, *share);
            parts.push(([0.0, *share], 0.5));
            first = *share;
        }
        parts.extend([0.02, 0.35, 0.65, 0.98].map(|choice| ([first, 1.0], choice)));
        let light_context =
            &scene.lights.point_context(surface.point.position, surface.lit_side(), surface.lobes(ray.dir));
        let continuing = Continuing { surface, directions: &directions, light_context, expected: None };
        for (part, choice) in parts {
            let Some(numbers) = search(&directions, surface.frame.to_local(sample.dir), part, choice) else { continue };
            let hit_light = |tracer: &mut Tracer<'_>| {
                let mut path = path;
                let rule = RouletteRule::ByWeight;
                let ends = tracer.continue_path::<false, false>(&mut path, continuing, numbers, rule).is_break();
                let hit = scene.world.intersect(&path.ray).filter(|_| !ends)?;
                let point = scene.shading_point(&path.ray, &hit);
                let emitted = || luminance(tracer.emitter_hit(&path.ray, &point, &path.previous));
                (point.light == light).then(|| (emitted(), path))
            };
            let (Some((of_all, branch)), Some((alone, _))) = (hit_light(&mut all), hit_light(&mut by_scattering))
            else {
                continue;
            };
            let waiting = light_of_waiting_branch(scene, branch);
            assert!((waiting / of_all - 1.0).abs() < 1e-5, "{name}, vertex {number}: {waiting}, at once {of_all}");
            let sum = weight_of_light + of_all / alone;
            assert!((sum - 1.0).abs() < ROUNDING, "{name}, vertex {number}, lamp {light}, numbers {numbers:?}: {sum}");
            self.sums += 1;
            self.by_guide += u32::from(part[0] < first);
            self.balanced += u32::from((0.02..0.98).contains(&weight_of_light));
        }
    }
}

/// Returns the luminance of the lamp that a branch hits, if other vertices have weighed the lamps while it waited.
fn light_of_waiting_branch(scene: &Prepared, mut branch: PathState) -> f32 {
    let mut tracer = Tracer::new(scene, PathSettings { max_depth: branch.bounce + 1, ..settings(None) });
    let elsewhere = scene.lights.point_context(Vec3A::new(-0.7, 0.1, 0.6), Vec3A::X, None);
    scene.lights.weigh(&elsewhere, &mut tracer.surface_weights);
    branch.throughput = Rgb::ONE;
    tracer.pending.push(branch);
    let nowhere = Ray { origin: Vec3A::Z * 100.0, dir: Vec3A::Z, t_max: f32::INFINITY, time: 0.5 };
    let gone = path_along(scene, nowhere, 0);
    luminance(tracer.trace::<false, false>(gone).color)
}

#[test]
fn weights_of_lamps_and_scattering_sum_to_one() {
    let [targets, table] = [target_guide(), table_guide()];
    for (name, material) in MATERIALS {
        let scene = floor(material);
        for guide in [None, Some(&targets), Some(&table)] {
            let mut tally = Tally::default();
            (0..120).for_each(|number| tally.add(name, &scene, guide, number));
            let Tally { sums, by_guide, balanced } = tally;
            println!("{name}, guided {}: {sums} sums, {by_guide} from the guide, {balanced} balanced", guide.is_some());
            assert!(sums > 60 && balanced > 20, "{name}: {sums} sums, {balanced} balanced");
            assert_eq!(by_guide > 10, guide.is_some(), "{name}: {by_guide}");
        }
    }
}

/// Lamps for a tree: more than are weighted one by one.
#[test]
fn weights_sum_to_one_for_more_lamps_than_are_weighed() {
    let lamps = "m lamp =\n sides 1\n c\n ed 100\nm lamp\nv l =\n p -.8 -.8 .5\nxf -a 13 -t .12 0 0 -a 13 -t 0 .12 .03\nsph l .04\nxf\n";
    let corners = "v e =\n p -2 -2 0\nv f =\n p 2 -2 0\nv g =\n p 2 2 0\nv h =\n p -2 2 0\n";
    let scene = prepare(&format!("{lamps}m floor =\n sides 2\n c\n rd .3\n rs .3 .1\nm floor\n{corners}f e f g h\n"));
    assert_eq!(scene.lights.len(), 169);
    let (guide, mut tally) = (target_guide(), Tally::default());
    (0..150).for_each(|number| tally.add("many lamps", &scene, Some(&guide), number));
    assert!(tally.sums > 40, "{} sums", tally.sums);
}

/// Density of each sampled direction, asked again.
#[test]
fn the_density_of_a_sample_is_the_one_asked_later() {
    let guides = [target_guide(), table_guide()];
    for ((name, material), guide) in MATERIALS.into_iter().flat_map(|it| guides.iter().map(move |guide| (it, guide))) {
        let scene = floor(material);
        let surface = &interaction(&scene, &ray_to_floor(&scene, 1));
        let (guide, share) = guide.at(surface).expect("a guide");
        let mut directions = DirectionSampler::new(&surface.bsdf, &surface.frame, surface.wo);
        directions.add_guide(&guide, share);
        let found: Vec<_> = (0..20_000).filter_map(|at| draw(&directions, at)).collect();
        for GuidedSample { sample, .. } in &found {
            let asked = directions.pdf(sample.wi, surface.frame.to_world(sample.wi));
            assert!((asked / sample.pdf - 1.0).abs() < 1e-3, "{name}: {} and {asked}", sample.pdf);
        }
        assert!(found.len() > 5_000, "{name}: {}", found.len());
        assert!(found.iter().filter(|found| found.is_guide_sample).count() > 1_000, "{name}");
    }
}

/// Samples of the mixture of guide and BSDF over the whole sphere, on a sheet that scatters to both sides. They follow the density
/// that weighs lamps, and their weights have the mean reflectance.
#[test]
fn directions_follow_the_density_that_weighs_lamps() {
    const NUMBER: u64 = 60_000;
    let scene = floor(" c\n rd .4\n td .4\n");
    let surface = &interaction(&scene, &ray_to_floor(&scene, 1));
    for (name, guide) in [("targets", target_guide()), ("table", table_guide())] {
        let (guide, share) = guide.at(surface).expect("a guide");
        let mut directions = DirectionSampler::new(&surface.bsdf, &surface.frame, surface.wo);
        directions.add_guide(&guide, share);
        let pdf = |wi: [f64; 3]| {
            let wi = Vec3A::from(wi.map(|x| x as f32));
            f64::from(directions.pdf(wi, surface.frame.to_world(wi)))
        };
        let mut weights = Moments::default();
        let sample = |at| {
            let found = draw(&directions, at);
            weights.add(found.as_ref().map_or(0.0, |found| luminance(found.sample.weight).into()));
            found.map(|found| found.sample.wi.to_array().map(f64::from))
        };
        let chi = sphere_test(pdf, sample, Cells::default(), NUMBER);
        // The densities are discontinuous, so the test of densities does not apply. Their own tests have one.
        assert!((chi.integral - 1.0).abs() < 2e-2, "{name}: {chi:?}");
        assert!(weights.p_value(0.8) > 1e-4, "{name}: {weights:?}");
    }
}

/// Draws a sample with numbers that depend on `at`.
fn draw(directions: &DirectionSampler<'_>, at: u64) -> Option<GuidedSample> {
    let number = |k: u64| unit_f32((mix64(3 * at + k) >> 32) as u32);
    directions.sample([number(0), number(1)], number(2))
}

/// Fog around the lamps.
const FOG: &str = "medium haze =\n c\n cxy .4 .45\n sigma_s .3\n sigma_a .1\n phase hg .4\nmglobal haze\n";

/// Light scattered in fog: a lamp with a distance and a point, or a free flight with a direction.
#[test]
fn weights_in_fog_sum_to_one() {
    let scene = prepare(&format!("{FOG}{LAMPS}"));
    let (mut sums, mut balanced) = (0, 0);
    for seed in 0..400 {
        let start = Vec3A::new(0.1 * (seed % 7) as f32 - 0.3, -2.5, 0.6 + 0.1 * (seed % 5) as f32);
        let (origin, dir) = (start - scene.origin.as_vec3a(), Vec3A::Y);
        let path = path_along(&scene, Ray { origin, dir, t_max: f32::INFINITY, time: 0.5 }, seed);
        let t_end = scene.world.intersect(&path.ray).map_or(5.0, |hit| hit.t);
        let mut ray = FoggyRay::default();
        assert!(scene.media.find_intervals(origin, dir, t_end, &path.medium_stack, &mut ray.media));
        let mut tracer = Tracer::new(&scene, settings(None));
        let mut sample_lamp = |single_technique| {
            let mut fog = FogSampler {
                scene: &scene,
                ray: &mut ray,
                direction_weights: &mut tracer.direction_weights,
                shadow: &mut tracer.shadow,
                counters: &mut tracer.counters,
                single_technique,
            };
            fog.weigh_lights(&path);
            fog.sample_airlight(&mut path.clone(), &mut |_, _| ())
        };
        let [all, alone] = [None, Some(MisTechnique::Light)].map(&mut sample_lamp);
        let Some((all, alone)) = all.zip(alone).filter(|(_, alone)| alone.color != Rgb::ZERO) else { continue };
        assert_eq!((all.light, all.event.t), (alone.light, alone.event.t));
        let weight_of_light = luminance(all.color) / luminance(alone.color);
        let position = origin + dir * all.event.t;
        let mut stream = path.stream;
        stream.seek(path.base + dim::AIRLIGHT_POINT);
        let u = stream.next_2d();
        let lamp = scene.lights.sample_light(&scene.world, &scene.textures, all.light, position, 0.5, u);
        let lamp = lamp.expect("a point");
        // The free flight that ends at the same distance.
        let (mut low, mut high, mut found) = (0.0f64, 1.0f64, None);
        for _ in 0..50 {
            let middle = 0.5 * (low + high);
            match scene.media.sample_distance(&ray.media, middle, 0.4) {
                DistanceSample::Scatter(event) if event.t < all.event.t => (low, found) = (middle, Some(event)),
                DistanceSample::Scatter(_) | DistanceSample::Through { .. } => high = middle,
            }
        }
        let event = found.expect("an event");
        assert!((event.t / all.event.t - 1.0).abs() < 1e-4, "{} {}", event.t, all.event.t);
        let (_, phase_pdf) = scene.media.phase(&ray.media, &event, -dir, lamp.dir);
        let origin = SegmentOrigin::Medium { collision: Collision { event, position }, phase_pdf };
        let previous = PreviousVertex { position, origin };
        let onward = Ray { origin: position, dir: lamp.dir, t_max: f32::INFINITY, time: 0.5 };
        let Some(hit) = scene.world.intersect(&onward) else { continue };
        let point = scene.shading_point(&onward, &hit);
        if point.light != all.light {
            continue;
        }
        let [of_all, alone] = [None, Some(MisTechnique::Scatter)].map(|technique| {
            let mut tracer = Tracer::new(&scene, settings(technique));
            tracer.fog_before = std::mem::take(&mut ray);
            let light = luminance(tracer.emitter_hit(&onward, &point, &previous));
            ray = std::mem::take(&mut tracer.fog_before);
            light
        });
        let sum = weight_of_light + of_all / alone;
        assert!((sum - 1.0).abs() < ROUNDING, "seed {seed}, lamp {}: {sum}", all.light);
        sums += 1;
        balanced += u32::from((0.001..0.999).contains(&weight_of_light));
    }
    assert!(sums > 200 && balanced > 100, "{sums} sums, {balanced} balanced");
}
