//! Measurements against closed forms, their intervals against the truth, and their laws.

use crate::layers::scene;
use femc_geometry::Ray;
use femc_math::elementary::double::atan;
use femc_math::glam::Vec3A;
use femc_pipeline::measure::{
    Area, Grid, MeasureRequest, MeasureSettings, Measured, Place, Points, Quantity, Reading, SurfaceSide, WorkPlane,
    measure, resolve_places, summarize, work_plane,
};
use femc_pipeline::{Prepared, SceneSource, Settings, StopCondition, prepare_world};
use std::f64::consts::PI;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};

/// Emittance of the lamps, lm/m2.
const EMITTANCE: f64 = 100.0;

fn prepare(text: &str) -> Prepared {
    let camera = "camera main =\n origin 0 -9 1\n target 0 0 1\n fov 1\n film 1 1\n";
    let source = SceneSource::new(Arc::new(scene(&format!("{camera}{text}"))));
    prepare_world(&source, &Settings::default(), 1, None).unwrap_or_else(|error| panic!("{error}"))
}

const SETTINGS: MeasureSettings =
    MeasureSettings { stop: StopCondition::Error(0.01), max_depth: 0, seed: 1, by_lamp: false };

fn pairs(places: &[Place], readings: &[Reading]) -> Vec<Measured> {
    let pair = |(place, reading): (&Place, &Reading)| Measured { place: place.info.clone(), reading: reading.clone() };
    places.iter().zip(readings).map(pair).collect()
}

fn read(scene: &Prepared, request: &MeasureRequest, settings: &MeasureSettings) -> (Vec<Place>, Vec<Reading>) {
    let places = resolve_places(scene, request).unwrap_or_else(|error| panic!("{error}"));
    let (cancel, progress) = (AtomicBool::new(false), AtomicU64::new(0));
    let read = |(number, place): (u32, &Place)| measure(scene, number, place, settings, &cancel, &progress);
    let readings: Option<Vec<Reading>> = (0..).zip(&places).map(read).collect();
    let readings = readings.expect("not cancelled");
    let samples: u64 = readings.iter().map(|reading| reading.samples + reading.bad_samples).sum();
    assert_eq!(samples, progress.load(Ordering::Relaxed));
    (places, readings)
}

fn area(name: &str, object: &str, side: SurfaceSide, cells: u32) -> MeasureRequest {
    let part = Area { name: name.into(), object: object.into(), side, cells };
    MeasureRequest { area: vec![part], ..MeasureRequest::default() }
}

/// Checks that a value differs from the truth by less than twice the half width of its interval, and that the interval is narrow.
fn assert_near(name: &str, value: f64, half_width: f64, truth: f64, most: f64) {
    assert!((value - truth).abs() < 2.0 * half_width + 1e-5 * truth, "{name}: {value} +- {half_width} for {truth}");
    assert!(half_width < most * truth, "too noisy: {name}: {value} +- {half_width} for {truth}");
}

/// A black box of 2 m x 3 m x 1 m around a ball of 0.1 m, whose center is 0.4 m above the floor. All faces point inside.
fn black_box() -> Prepared {
    prepare(
        "m lamp =\n sides 1\n c\n ed 100\nm black =\n sides 1\n c\n rd 0\n\
         v c =\n p .3 -.2 .4\nm lamp\no bulb\nsph c .1\no\nm black\n\
         v a =\n p -1 -1.5 0\nv b =\n p 1 -1.5 0\nv d =\n p 1 1.5 0\nv e =\n p -1 1.5 0\n\
         v f =\n p -1 -1.5 1\nv g =\n p 1 -1.5 1\nv h =\n p 1 1.5 1\nv i =\n p -1 1.5 1\n\
         o room\no floor\nf a b d e\no\no ceiling\nf i h g f\no\n\
         o walls\nf f g b a\nf g h d b\nf h i e d\nf i f a e\no\no\n",
    )
}

/// Returns the solid angle of a rectangle that is parallel to the plane z = 0, from the origin, sr.
fn solid_angle([x0, x1, y0, y1]: [f64; 4], z: f64) -> f64 {
    let corner = |x: f64, y: f64| atan(x * y / (z * (x * x + y * y + z * z).sqrt()));
    corner(x1, y1) - corner(x0, y1) - corner(x1, y0) + corner(x0, y0)
}

/// A ball sends the same share of its flux to a surface as its center would.
#[test]
fn means_over_surfaces_have_the_flux_of_a_ball() {
    let scene = black_box();
    let flux = EMITTANCE * 4.0 * PI * 0.01;
    let rectangle = [-1.3, 0.7, -1.3, 1.7];
    let floor = flux * solid_angle(rectangle, 0.4) / (4.0 * PI);
    let ceiling = flux * solid_angle(rectangle, 0.6) / (4.0 * PI);
    let mut sum = 0.0;
    for (object, expected, surface) in [
        ("room.floor", floor, 6.0),
        ("room.ceiling", ceiling, 6.0),
        ("room.walls", flux - floor - ceiling, 10.0),
        ("room", flux, 22.0),
    ] {
        let (places, readings) = read(&scene, &area("s", object, SurfaceSide::Front, 40), &SETTINGS);
        let [summary] = &summarize(&pairs(&places, &readings))[..] else { panic!("one part") };
        assert_near(object, summary.mean.value * surface, summary.mean.half_width * surface, expected, 0.01);
        assert!((summary.area.expect("an area") / surface - 1.0).abs() < 1e-6, "{object}: {summary:?}");
        assert!((40..=80).contains(&places.len()), "{object}: {} cells", places.len());
        assert!(summary.least.value <= summary.mean.value && summary.mean.value <= summary.greatest.value);
        sum += summary.mean.value * surface;
    }
    assert!((sum / (2.0 * flux) - 1.0).abs() < 0.01, "the parts make the whole: {sum}");
    let (_, dark) = read(&scene, &area("s", "room", SurfaceSide::Back, 8), &SETTINGS);
    assert!(dark.iter().all(|reading| reading.value == 0.0 && reading.is_converged), "no light outside");
    let (places, readings) = read(&scene, &area("s", "room.floor", SurfaceSide::Both, 8), &SETTINGS);
    let summary = &summarize(&pairs(&places, &readings))[0];
    let lit: Vec<f64> = readings.iter().map(|reading| reading.value).filter(|value| *value > 0.0).collect();
    let least = lit.iter().copied().fold(f64::INFINITY, f64::min);
    assert_eq!((summary.dark, summary.uniformity), (lit.len() as u64, 0.0));
    assert!((summary.lit_uniformity - least / (2.0 * summary.mean.value)).abs() < 1e-6, "{summary:?}");
}

/// Points of cells of all shapes lie on surfaces that rays hit there.
#[test]
fn cells_cover_surfaces_of_all_shapes_evenly() {
    let scene = prepare(
        "m gray =\n sides 2\n c\n rd .5\nm gray\n\
         v a =\n p 0 0 0\nv b =\n p 0 0 1.5\nv n =\n p 5 0 0\n n 1 2 2\n\
         v t =\n p 9 0 0\n n 2 -1 2\n\
         o ball\nxf -t -9 0 0 -s 1.3\nsph a .7\nxf\no\no cone\nxf -t -5 0 0 -rx 40\ncone a .8 b .2\nxf\no\n\
         o ring\nring n .3 1.1\no\no donut\ntorus t .2 .7\no\n",
    );
    let sphere = 4.0 * PI * (0.7f64 * 1.3).powi(2);
    let cone = PI * (0.8 + 0.2) * (1.5f64 * 1.5 + 0.36).sqrt();
    let ring = PI * (1.1 * 1.1 - 0.3 * 0.3);
    let torus = 4.0 * PI * PI * 0.45 * 0.25;
    for (object, expected) in [("ball", sphere), ("cone", cone), ("ring", ring), ("donut", torus)] {
        let places = resolve_places(&scene, &area("s", object, SurfaceSide::Both, 50)).expect("cells");
        let total: f64 = places.iter().map(|place| place.info.weight()).sum();
        assert!((total / (2.0 * expected) - 1.0).abs() < 1e-5, "{object}: {total} for {expected}");
        assert!((100..=200).contains(&places.len()), "{object}: {}", places.len());
        for place in &places {
            assert!(place.info.weight() > 0.3 * expected / 50.0 && place.info.weight() < 1.01 * expected / 50.0);
            let at = scene.from_world(place.info.position);
            // A ray from far outside along the line through the point meets the surface there, at one of its hits.
            let dir = Vec3A::new(0.267, -0.535, 0.802).normalize();
            let mut ray = Ray { origin: at - dir * 20.0, dir, t_max: f32::INFINITY, time: 0.5 };
            let mut nearest = f32::INFINITY;
            while let Some(hit) = scene.world.intersect(&ray) {
                let point = scene.shading_point(&ray, &hit);
                nearest = nearest.min(point.position.distance(at));
                ray.origin = point.position + dir * 1e-3;
            }
            assert!(nearest < 2e-3, "{object}: {nearest} m beside the surface");
        }
    }
}

/// In light from all sides, closed shapes receive it in front and none inside. A ring receives it on both sides.
#[test]
fn fronts_of_curved_surfaces_are_outside() {
    let scene = prepare(
        "m sky =\n sides 2\n c\n ed 100\nm black =\n sides 2\n c\n rd 0\nv o =\n p 0 0 0\nm sky\nsph o -40\nm black\n\
         v a =\n p -5 0 0\nv t =\n p 5 0 0\n n 2 -1 2\nv r =\n p 0 5 0\n n 1 2 2\n\
         o ball\nsph a .7\no\no donut\ntorus t .2 .7\no\no ring\nring r .3 1.1\no\n",
    );
    let settings = MeasureSettings { stop: StopCondition::Spp(256), ..SETTINGS };
    let light = |object: &str, side| {
        let (_, readings) = read(&scene, &area("s", object, side, 12), &settings);
        readings.iter().map(|reading| reading.value).fold(0.0, f64::max) / EMITTANCE
    };
    for (object, inside) in [("ball", 0.0), ("donut", 0.0), ("ring", 1.0)] {
        assert!((0.9..1.1).contains(&light(object, SurfaceSide::Front)), "{object}");
        assert!((light(object, SurfaceSide::Back) - inside).abs() < 0.1, "{object}");
    }
}

/// Several lamps of several kinds in a gray room, and fog.
fn lit_room() -> Prepared {
    prepare(
        "medium haze =\n sigma_s .1\nmglobal haze\n\
         m left =\n sides 1\n c\n ed 100\nm right =\n sides 1\n c\n crgb 1 .5 .2\n ed 60\nm gray =\n sides 2\n c\n rd .5\n\
         v c =\n p .6 0 .7\nm right\no lamps\no ball\nsph c .1\no\n\
         v p =\n p -.9 -.3 .9\nv q =\n p -.9 .3 .9\nv r =\n p -.5 .3 .9\nv s =\n p -.5 -.3 .9\nm left\no panel\nf p q r s\no\no\n\
         m gray\nv a =\n p -1 -1 0\nv b =\n p 1 -1 0\nv d =\n p 1 1 0\nv e =\n p -1 1 0\n\
         v f =\n p -1 -1 1\nv g =\n p 1 -1 1\nv h =\n p 1 1 1\nv i =\n p -1 1 1\n\
         o room\nf a b d e\nf i h g f\nf f g b a\nf g h d b\nf h i e d\nf i f a e\no\n",
    )
}

fn mixed_request() -> MeasureRequest {
    let points = |name: &str, quantity, direction| Points {
        name: name.into(),
        quantity,
        at: vec![[0.1, 0.2, 0.3], [-0.4, 0.1, 0.5]],
        direction,
        observer: None,
    };
    MeasureRequest {
        points: vec![
            points("plane", Quantity::Illuminance, None),
            points("upright", Quantity::Cylindrical, None),
            points("sphere", Quantity::Spherical, None),
            points("view", Quantity::Luminance, Some([1.0, 0.0, -0.2])),
        ],
        ..area("floor", "room", SurfaceSide::Front, 6)
    }
}

#[test]
fn lamps_add_up_to_the_whole_and_are_named_as_in_layers() {
    let scene = lit_room();
    let settings = MeasureSettings { stop: StopCondition::Spp(2048), by_lamp: true, ..SETTINGS };
    let (places, readings) = read(&scene, &mixed_request(), &settings);
    let (_, without) = read(&scene, &mixed_request(), &MeasureSettings { by_lamp: false, ..settings });
    for ((place, reading), without) in places.iter().zip(&readings).zip(&without) {
        let sum: f64 = reading.lamps.iter().map(|lamp| lamp.value).sum();
        assert!(
            (sum / reading.value - 1.0).abs() < 1e-5,
            "{} {}: {sum} of {}",
            place.info.part,
            place.info.number,
            reading.value
        );
        let names: Vec<&str> = reading.lamps.iter().map(|lamp| lamp.lamp.as_str()).collect();
        assert!(names.iter().all(|name| ["lamps.ball/right", "lamps.panel/left"].contains(name)), "{names:?}");
        assert_eq!(Reading { lamps: Vec::new(), ..reading.clone() }, *without, "lamps change no reading");
        let weights = [0.2126, 0.7152, 0.0722];
        let luminance: f64 = reading.color.iter().zip(weights).map(|(color, weight)| color * weight).sum();
        assert!((luminance / reading.value - 1.0).abs() < 1e-3, "{:?} is {}", reading.color, reading.value);
    }
    let summaries = summarize(&pairs(&places, &readings));
    assert_eq!(summaries.len(), 5);
    for summary in summaries {
        let sum: f64 = summary.lamps.iter().map(|(_, light)| light.value).sum();
        assert!((sum / summary.mean.value - 1.0).abs() < 1e-5, "{summary:?}");
    }
}

#[test]
fn readings_have_the_same_bits_on_any_number_of_threads() {
    let scene = lit_room();
    let settings = MeasureSettings { stop: StopCondition::Error(0.05), by_lamp: true, ..SETTINGS };
    let on = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("threads");
        pool.install(|| read(&scene, &mixed_request(), &settings).1)
    };
    let alone = on(1);
    assert_eq!(alone, on(3));
    assert!(alone.iter().all(|reading| reading.is_converged && reading.relative_error() <= 0.05), "{alone:?}");
    let other = read(&scene, &mixed_request(), &MeasureSettings { seed: 2, ..settings }).1;
    assert!(alone.iter().zip(&other).all(|(a, b)| a.value != b.value), "the seed counts");
}

/// Intervals of 95 % cover the truth in 93 to 97 % of 100 runs, at several places and for each quantity.
#[test]
fn intervals_cover_the_truth() {
    let scene = prepare("m lamp =\n sides 1\n c\n ed 100\nm lamp\nv c =\n p .3 -.2 1\n n 0 0 -1\nring c 0 .75\n");
    let (radiance, angle): (f64, f64) = (EMITTANCE / PI, atan(0.75));
    let (sin, cos) = (0.6, 0.8);
    let truths = [
        (Quantity::Illuminance, PI * radiance * sin * sin),
        (Quantity::Cylindrical, radiance * (angle - sin * cos)),
        (Quantity::Spherical, 0.5 * PI * radiance * (1.0 - cos)),
    ];
    let points = |(quantity, _): (Quantity, f64)| Points {
        name: quantity.word().into(),
        quantity,
        at: vec![[0.3, -0.2, 0.0]; 4],
        direction: None,
        observer: None,
    };
    let request = MeasureRequest { points: truths.map(points).to_vec(), ..MeasureRequest::default() };
    for stop in [StopCondition::Spp(256), StopCondition::Error(0.01)] {
        let (mut covered, mut all) = ([0; 3], 0);
        for seed in 0..100 {
            let (_, readings) = read(&scene, &request, &MeasureSettings { stop, seed, ..SETTINGS });
            for (at, readings) in readings.chunks(4).enumerate() {
                let covers = |reading: &&Reading| (reading.value - truths[at].1).abs() <= reading.half_width;
                covered[at] += readings.iter().filter(covers).count();
            }
            all += 4;
        }
        let shares = covered.map(|count| count as f64 / f64::from(all));
        println!("{stop:?}: {shares:?}");
        assert!(shares.iter().all(|share| (0.93..=0.97).contains(share)), "{stop:?}: {shares:?}");
    }
}

#[test]
fn a_luminance_is_seen_from_an_observer_or_in_a_direction() {
    let scene = black_box();
    let view = |at, direction, observer| {
        let part = Points { name: "v".into(), quantity: Quantity::Luminance, at: vec![at], direction, observer };
        let request = MeasureRequest { points: vec![part], ..MeasureRequest::default() };
        read(&scene, &request, &SETTINGS).1[0].value
    };
    let bulb = [0.3, -0.2, 0.4];
    assert!((view(bulb, None, Some([-0.5, 0.5, 0.8])) / (EMITTANCE / PI) - 1.0).abs() < 1e-5);
    assert!((view([0.3, 1.0, 0.4], Some([0.0, -2.0, 0.0]), None) / (EMITTANCE / PI) - 1.0).abs() < 1e-5);
    assert_eq!(view([0.3, 1.0, 0.4], Some([0.0, 1.0, 0.0]), None), 0.0, "a black wall");
}

/// The center of a work plane below a small lamp has its inverse square, and the plane covers the floor.
#[test]
fn a_work_plane_covers_the_floor_without_its_border() {
    let scene = black_box();
    let plane = WorkPlane { height: 0.1, border: 0.25, spacing: 0.5 };
    let request = work_plane(&scene.scene, &plane).expect("a plane");
    let [Grid { corner, along, across, count, .. }] = &request.grid[..] else { panic!("one grid") };
    assert_eq!((*corner, *along, *across), ([-0.75, -1.25, 0.1], [1.5, 0.0, 0.0], [0.0, 2.5, 0.0]));
    assert_eq!(*count, [3, 5]);
    let (places, readings) = read(&scene, &request, &SETTINGS);
    assert_eq!(places[4].info.cell, Some([1, 1]));
    for (place, reading) in places.iter().zip(&readings) {
        let way = [0.3, -0.2, 0.4].iter().zip(place.info.position).map(|(a, b)| a - b).collect::<Vec<f64>>();
        let distance = way.iter().map(|x| x * x).sum::<f64>().sqrt();
        let expected = EMITTANCE * 0.01 * (way[2] / distance) / (distance * distance);
        assert_near("work plane", reading.value, reading.half_width, expected, 0.011);
    }
    let fault = work_plane(&scene.scene, &WorkPlane { border: 1.0, ..plane }).unwrap_err().to_string();
    assert_eq!(fault, "`work plane`: a border of 1 m leaves nothing of 2.00 m x 3.00 m");
}

#[test]
fn requests_that_cannot_be_measured_say_why() {
    let scene = black_box();
    let fault = |request: MeasureRequest| resolve_places(&scene, &request).err().expect("a fault").to_string();
    let point = |quantity, direction, observer| MeasureRequest {
        points: vec![Points { name: "p".into(), quantity, at: vec![[0.0; 3]], direction, observer }],
        ..MeasureRequest::default()
    };
    assert_eq!(fault(MeasureRequest::default()), "no [[points]], [[grid]] or [[area]]: there is nothing to measure");
    assert!(fault(point(Quantity::Luminance, None, None)).contains("needs `direction`"));
    assert!(fault(point(Quantity::Luminance, None, Some([0.0; 3]))).contains("at the point at which one looks"));
    assert!(fault(point(Quantity::Spherical, None, Some([1.0; 3]))).contains("only the luminance"));
    assert_eq!(fault(point(Quantity::Illuminance, Some([0.0; 3]), None)), "`p`: `direction` has no length");
    assert_eq!(
        fault(area("a", "rom", SurfaceSide::Front, 4)),
        "`a`: no visible object `rom`; the objects are bulb, room, room.ceiling, room.floor, room.walls"
    );
    let mut twice = area("a", "room", SurfaceSide::Front, 4);
    twice.area.push(twice.area[0].clone());
    assert_eq!(fault(twice), "`a`: two parts have this name");
    let mut grid = Grid {
        name: "g".into(),
        quantity: Quantity::Illuminance,
        corner: [0.0; 3],
        along: [1.0, 0.0, 0.0],
        across: [2.0, 0.0, 0.0],
        count: [2, 2],
        direction: None,
        observer: None,
    };
    let with = |grid: &Grid| MeasureRequest { grid: vec![grid.clone()], ..MeasureRequest::default() };
    assert!(fault(with(&grid)).contains("are parallel or 0"));
    (grid.across, grid.count) = ([0.0, 1.0, 0.0], [2000, 2000]);
    assert_eq!(fault(with(&grid)), "4000000 readings; at most 1048576 are possible");
    grid.corner[1] = f64::NAN;
    assert_eq!(fault(with(&grid)), "`g`: `corner` is not finite");
}
