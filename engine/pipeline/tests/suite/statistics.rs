//! Tests of light statistics of rendered tiles.

use femc_film::{Rect, Tiling};
use femc_import::{Bundle, load_scene};
use femc_pipeline::paths::bottlenecks::{Bottlenecks, Grouping};
use femc_pipeline::paths::histogram::{Histograms, Table};
use femc_pipeline::paths::{
    InteractionKind, LightPath, LightRecord, LightStatistics, LightTechnique, Name, NameKind, PathEnd,
};
use femc_pipeline::replay::Replay;
use femc_pipeline::{
    Method, Outputs, Prepared, RenderTask, SceneSource, Settings, StatisticsPlan, StopCondition, prepare_frame,
};
use std::collections::BTreeMap;
use std::ops::Range;
use std::sync::Arc;

/// A room with a mirror ball and a plate above a white floor. The plate hides the lamp from a part of the floor.
pub(crate) const ROOM: &str = "\
camera main =
	origin 0 -3 1
	target 0 0 .8
	fov 60
	film 20 12
m white =
	sides 1
	c
	rd .7
m gray =
	c
	rd .4
m mirror =
	rs .9 0
m glow =
	sides 1
	ed 500
v a =
	p -4 -4 0
v b =
	p 4 -4 0
v c =
	p 4 4 0
v d =
	p -4 4 0
m white
o floor
f a b c d
o
v o =
	p .6 0 .5
m mirror
o ball
sph o .5
o
v e =
	p -.6 -.3 1.2
v f =
	p -.2 -.3 1.2
v g =
	p -.2 .3 1.2
v h =
	p -.6 .3 1.2
m gray
o plate
f e f g h
o
v l =
	p -.4 0 2
m glow
o lamp
sph l .2
o
";

pub(crate) const FOG: &str = "medium fog =\n\tsigma_s .3\nmbox fog -4 -4 0 4 4 3\n";

pub(crate) fn prepared(text: &str, settings: &Settings) -> Prepared {
    let files = BTreeMap::from([("room.mgf".to_owned(), text.as_bytes().to_vec())]);
    let scene = load_scene(&Bundle(files), "room.mgf").unwrap_or_else(|e| panic!("{e}")).scene;
    prepare_frame(&SceneSource::new(Arc::new(scene)), settings, 1, None).unwrap_or_else(|e| panic!("{e}"))
}

fn settings() -> Settings {
    Settings { stop: StopCondition::Spp(8), seed: 5, statistics: true, ..Settings::default() }
}

fn tiling(prepared: &Prepared) -> Tiling {
    Tiling { width: prepared.camera.film[0], height: prepared.camera.film[1], edge: 8 }
}

fn render_tile_statistics(
    prepared: &Prepared,
    settings: &Settings,
    rect: Rect,
    samples: Range<u32>,
) -> (Vec<u8>, LightStatistics) {
    let plan = StatisticsPlan::new(prepared, settings, 8);
    let outputs = Outputs { statistics: Some(&plan), ..Outputs::default() };
    let rendered = RenderTask::new(prepared, settings, rect, samples).render(outputs);
    let rendered = rendered.unwrap_or_else(|e| panic!("{e}"));
    (rendered.tile.encode(), rendered.statistics.expect("statistics"))
}

/// Returns the statistics of a frame, rendered tile by tile in tasks that end at these samples.
fn frame_statistics(prepared: &Prepared, settings: &Settings, ends: &[u32]) -> LightStatistics {
    let ranges = || [0].iter().chain(ends).zip(ends).map(|(begin, end)| *begin..*end);
    let tasks = tiling(prepared).rects().flat_map(|rect| ranges().map(move |range| (rect, range)));
    let parts = tasks.map(|(rect, range)| render_tile_statistics(prepared, settings, rect, range).1);
    let mut all: Option<LightStatistics> = None;
    for part in parts {
        match &mut all {
            Some(all) => all.merge(part).unwrap_or_else(|e| panic!("{e}")),
            None => all = Some(part),
        }
    }
    all.unwrap().into_image_samples(0, |_, _| u32::MAX)
}

#[test]
fn statistics_change_no_bit_of_a_tile_and_hold_all_laws() {
    let small = |method| Settings { method, size: Some([24, 16]), ..settings() };
    let cases = [
        (ROOM.to_owned(), settings()),
        (format!("{FOG}{ROOM}"), settings()),
        (include_str!("../../../../scenes/cornell.mgf").to_owned(), small(Method::Pt)),
        (include_str!("../../../../scenes/glossy.mgf").to_owned(), small(Method::Pt)),
        (include_str!("../../../../scenes/glossy.mgf").to_owned(), small(Method::Femc)),
        (GAP.to_owned(), guided_settings()),
    ];
    for (text, settings) in cases {
        let prepared = prepared(&text, &settings);
        for rect in tiling(&prepared).rects() {
            let alone = RenderTask::new(&prepared, &settings, rect, 0..8).render(Outputs::default()).unwrap().tile;
            let (tile, statistics) = render_tile_statistics(&prepared, &settings, rect, 0..8);
            assert!(tile == alone.encode());
            assert_eq!(statistics.samples(), rect.area() * 8);
            assert_eq!(statistics.totals().invalid, alone.bad_samples().total());
            let read = LightStatistics::decode(&statistics.encode()).unwrap_or_else(|e| panic!("{e}"));
            assert!(read == statistics);
        }
    }
}

/// Two rooms with a gap between them. Guided paths are split there.
pub(crate) const GAP: &str = include_str!("../../../../scenes/door-ajar.mgf");

fn guided_settings() -> Settings {
    Settings { method: Method::Femc, size: Some([20, 12]), ..settings() }
}

#[test]
fn records_are_the_samples_themselves_and_their_lights_add_up() {
    let cases = [
        (ROOM.to_owned(), settings()),
        (format!("{FOG}{ROOM}"), settings()),
        (GAP.to_owned(), guided_settings()),
        (format!("medium haze =\n\tsigma_s .1\nmglobal haze\n{GAP}"), guided_settings()),
    ];
    for (text, settings) in cases {
        let prepared = prepared(&text, &settings);
        let all = frame_statistics(&prepared, &settings, &[8]);
        assert_eq!(all.share(), 1.0, "a small frame has all of its samples");
        assert_eq!(all.paths.len() as u64, 20 * 12 * 8 - all.totals().invalid);
        let mut replay = Replay::new(&prepared, &settings);
        let mut branches = 0;
        for path in all.paths.values() {
            let (color, recording) = replay.sample((path.key.pixel % 20, path.key.pixel / 20), path.key.sample);
            assert_eq!(Some(path.radiance), color.map(|color| color.to_array()));
            let nodes = recording.steps.nodes().iter().filter(|node| node.repeats == 0);
            assert!(!is_whole(path) || path.intersections.len() == nodes.count());
            branches += (0u32..).zip(&path.intersections).filter(|(before, it)| it.parent != *before).count();
            assert_branches_add_up(path);
            let sum = |lights: &mut dyn Iterator<Item = f64>| lights.sum::<f64>();
            let is_near = |a: f64, b: f32| (a - f64::from(b)).abs() <= 1e-4 * a.abs() + 1e-6;
            let lights = sum(&mut path.lights.iter().map(|light| f64::from(light.radiance[1])));
            let has_all_lights = path.lights.len() < femc_pipeline::paths::record::MAX_LIGHTS;
            assert!(!has_all_lights || is_near(lights, path.radiance[1]), "{path:?}");
            // The light at the camera is the radiance that leaves the first vertex plus the light found before it.
            if let Some(first) = path.intersections.first() {
                let early = path.lights.iter().filter(|light| light.vertex == 0);
                let own = recording.contributions.iter().filter(|(it, vertex)| {
                    *vertex == 0 && it.position == recording.steps.nodes()[0].step.vertex.position
                });
                let own = sum(&mut own.map(|(it, _)| f64::from(it.color.to_array()[1])));
                let early_sum = sum(&mut early.map(|light| f64::from(light.radiance[1])));
                let sent = f64::from(first.radiance[1]) * f64::from(first.throughput[1]);
                assert!(is_near(sent + early_sum - own, path.radiance[1]), "{path:?}");
            }
        }
        assert_eq!(branches > 100, settings.method == Method::Femc, "{branches} branches");
    }
}

/// Checks whether a record has all intersections of its path.
fn is_whole(path: &LightPath) -> bool {
    path.intersections.len() < femc_pipeline::paths::record::MAX_INTERSECTIONS
}

/// Checks that the light that leaves each intersection is the light found there, plus that of its branches. A lamp that a branch
/// hits counts for the intersection before it, and may also count for the one at the lamp.
fn assert_branches_add_up(path: &LightPath) {
    let light = |radiance: [f32; 3]| f64::from(radiance[1]);
    for (number, it) in (1u32..).zip(&path.intersections).filter(|_| is_whole(path)) {
        let sent = light(it.radiance) * light(it.throughput);
        let children = path.intersections.iter().filter(|child| child.parent == number);
        let of_children: f64 = children.map(|child| light(child.radiance) * light(child.throughput)).sum();
        let sum = |counts: &dyn Fn(&LightRecord) -> bool| -> f64 {
            path.lights.iter().filter(|it| counts(it)).map(|it| light(it.radiance)).sum()
        };
        let own = sum(&|it| it.vertex == number);
        let met = sum(&|it| it.technique == LightTechnique::EmitterHit);
        let tolerance = 1e-4 * (sent + own) + 1e-5 + met;
        assert!((sent - own - of_children).abs() <= tolerance, "{number}: {sent} {own} {of_children} {path:?}");
    }
}

#[test]
fn statistics_do_not_depend_on_the_division_into_tasks() {
    let (settings, prepared) = (settings(), prepared(&format!("{FOG}{ROOM}"), &settings()));
    let bytes = frame_statistics(&prepared, &settings, &[8]).encode();
    for ends in [&[4, 8][..], &[1, 4, 5, 8]] {
        assert!(frame_statistics(&prepared, &settings, ends).encode() == bytes, "{ends:?}");
    }
}

#[test]
fn paths_name_what_they_meet_and_say_how_they_went_on() {
    let (settings, prepared) = (settings(), prepared(ROOM, &settings()));
    let all = frame_statistics(&prepared, &settings, &[8]);
    let named = |kind, text: &str| {
        let name = Name::new(kind, text);
        assert_eq!(all.names.get(&name), Some(&(kind, text.to_owned())));
        name
    };
    let [ball, plate, lamp, floor] = ["ball", "plate", "lamp", "floor"].map(|object| named(NameKind::Object, object));
    let glow = named(NameKind::Lamp, "lamp/glow");
    let steps = || all.paths.values().flat_map(|path| &path.intersections);
    assert!(steps().any(|it| it.object == ball && it.interaction == InteractionKind::Reflection));
    assert!(steps().filter(|it| it.object == ball).all(|it| {
        it.material == Name::new(NameKind::Material, "mirror")
            && [InteractionKind::Reflection, InteractionKind::Absorbed].contains(&it.interaction)
    }));
    assert!(steps().any(|it| it.object == lamp && it.interaction == InteractionKind::Emission));
    assert!(steps().all(|it| it.object != floor || it.position[2].abs() < 1e-4));
    let lights = || all.paths.values().flat_map(|path| &path.lights);
    assert!(lights().all(|light| light.light == glow));
    assert!(lights().any(|light| light.occluder == Some(plate)));
    assert!(lights().all(|light| light.occluder.is_none() || light.radiance == [0.0; 3]));
    let ends = |path: &LightPath| path.end;
    assert!(all.paths.values().map(ends).any(|end| end == PathEnd::Escaped));
    assert!(all.paths.values().map(ends).all(|end| end != PathEnd::Depth));
    let histograms = Histograms::from_statistics(&all, Table::Intersections);
    assert_eq!(histograms.attributes[0].samples.iter().sum::<u64>(), steps().count() as u64);
}

#[test]
fn light_scattered_in_fog_names_the_fog_and_its_occluder() {
    let (settings, prepared) = (settings(), prepared(&format!("{FOG}{ROOM}"), &settings()));
    let all = frame_statistics(&prepared, &settings, &[8]);
    let fog = Name::new(NameKind::Medium, "fog");
    assert_eq!(all.names.get(&fog), Some(&(NameKind::Medium, "fog".to_owned())));
    let plate = Name::new(NameKind::Object, "plate");
    let lights = || all.paths.values().flat_map(|path| &path.lights);
    let in_fog = || lights().filter(|light| light.technique == LightTechnique::Airlight);
    assert!(in_fog().all(|light| light.medium == fog));
    assert!(lights().all(|light| light.technique == LightTechnique::Airlight || light.medium == Name::NONE));
    // Occluded light contributes nothing, and all light that contributes nothing but could have is occluded by something opaque.
    assert!(in_fog().all(|light| light.occluder.is_none() || light.radiance == [0.0; 3]));
    let [hidden, plates] = [|_: Name| true, |it: Name| it == Name::new(NameKind::Object, "plate")]
        .map(|is| in_fog().filter(|light| light.occluder.is_some_and(is)).count());
    assert!(plates > 20 && hidden > plates, "{hidden} hidden, {plates} of them by {plate:?}");
    let causes = Bottlenecks::from_statistics(&all, Grouping::Part);
    let scattered =
        causes.parts.iter().filter(|(part, of)| part.interaction == Some(InteractionKind::Volume) && of.light > 0.0);
    let named: Vec<Option<&str>> = scattered.map(|(part, _)| causes.name_text(part.material)).collect();
    assert_eq!(named, [Some("fog")]);
}

#[test]
fn a_sample_that_the_film_refuses_is_in_no_statistic() {
    // The film accepts radiance up to 1.1e12 cd/m2.
    let (settings, text) = (settings(), ROOM.replace("ed 500", "ed 5e13"));
    let prepared = prepared(&text, &settings);
    let mut refused = 0;
    for rect in tiling(&prepared).rects() {
        let alone = RenderTask::new(&prepared, &settings, rect, 0..8).render(Outputs::default()).unwrap().tile;
        let (_, statistics) = render_tile_statistics(&prepared, &settings, rect, 0..8);
        assert_eq!(statistics.totals().invalid, alone.bad_samples().total());
        refused += alone.bad_samples().total();
        let records = [&statistics.paths, &statistics.brightest, &statistics.deepest];
        let mut paths = records.into_iter().flat_map(|records| records.values());
        assert!(paths.all(|path| path.radiance.into_iter().all(|light| light <= 1_099_511_627_776.0)));
    }
    assert!(refused > 0 && refused < 20 * 12 * 8, "{refused} refused");
}

#[test]
fn the_longest_paths_end_by_their_depth() {
    let settings = Settings { max_depth: 2, ..settings() };
    let prepared = prepared(ROOM, &settings);
    let all = frame_statistics(&prepared, &settings, &[8]);
    assert!(all.paths.values().any(|path| path.end == PathEnd::Depth));
    assert!(all.paths.values().all(|path| path.depth <= 1));
}
