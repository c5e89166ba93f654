//! Tests of light in numbers. Expected values come from loops over the records.

use crate::synthetic::{merge_parts, scope, task, tiles};
use femc_math::elementary::ln;
use femc_math::hash::{combine, unit_f32};
use femc_paths::query::{Condition, Query};
use femc_paths::record::luminance;
use femc_paths::selection::SelectedRecords;
use femc_paths::summary::{Estimate, Group, LightAmount, LightSummary, RowSubject};
use femc_paths::{
    FrameStatistics, LightPath, LightRecord, LightStatistics, LightTechnique, Name, NameKind, PathEnd, PathKey,
    PortionKey, RecordedPaths, SampleCounters, Scope,
};
use std::sync::atomic::AtomicBool;

static RUNNING: AtomicBool = AtomicBool::new(false);

fn recorded() -> RecordedPaths {
    let frame = |number: u32| {
        let scope = Scope { frame: number, ..scope(3000) };
        // The frames have different numbers of samples, so their records have different weights.
        merge_parts(&scope, tiles(&scope).map(|tile| task(&scope, tile, 0..if number == 4 { 12 } else { 4 })))
    };
    RecordedPaths::new(FrameStatistics::from_statistics([3, 4].map(frame)).unwrap())
}

fn select(all: &RecordedPaths, text: &str) -> SelectedRecords {
    let condition = Condition::parse(text).unwrap_or_else(|e| panic!("{text}: {e}"));
    all.select(&Query { condition: Some(condition), ..Query::default() }, &RUNNING).unwrap()
}

fn summarize(all: &RecordedPaths, text: &str) -> LightSummary {
    let selected = (!text.is_empty()).then(|| select(all, text));
    all.summarize(selected.as_ref(), &RUNNING).unwrap()
}

/// Standard error for the effective number of paths.
fn widened(parts: &[f64], error: f64) -> Option<f64> {
    let (sum, squares) = (parts.iter().sum::<f64>(), parts.iter().map(|x| x * x).sum::<f64>());
    let effective = if squares > 0.0 { sum * sum / squares } else { 0.0 };
    (effective >= 30.0).then(|| error * (1.0 + 10.0 / effective).sqrt())
}

/// Mean of values with weights, and its standard error, by their definitions.
fn mean(values: &[f64], weights: &[f64]) -> Estimate {
    let sum: f64 = weights.iter().sum();
    let mean = values.iter().zip(weights).map(|(x, w)| x * w).sum::<f64>() / sum;
    let square: f64 = values.iter().zip(weights).map(|(x, w)| (w * (x - mean) / sum).powi(2)).sum();
    let parts: Vec<f64> = values.iter().zip(weights).map(|(x, w)| x * w).collect();
    Estimate { value: mean, standard_error: widened(&parts, square.sqrt()) }
}

#[track_caller]
fn assert_near(a: Estimate, b: Estimate, what: &str) {
    let is_near = |a: f64, b: f64| (a - b).abs() <= 1e-9 * b.abs().max(1e-12);
    assert!(is_near(a.value, b.value), "{what}: {a:?}, not {b:?}");
    assert_eq!(a.standard_error.is_some(), b.standard_error.is_some(), "{what}: {a:?}, not {b:?}");
    let (own, other) = (a.standard_error.unwrap_or(0.0), b.standard_error.unwrap_or(0.0));
    assert!((own - other).abs() <= 1e-6 * other, "{what}: {a:?}, not {b:?}");
}

/// Numbers of a row by loops: light of each path, and its intersections.
fn row_by_loops(
    all: &RecordedPaths,
    light: impl Fn(u32, &LightPath) -> Option<f64>,
    energies: impl Fn(u32, &LightPath) -> Vec<f64>,
) -> LightAmount {
    let weights: Vec<f64> = all.image_weights().iter().map(|units| *units as f64 / 4_294_967_296.0).collect();
    let (mut lights, mut own, mut paths) = (Vec::new(), Vec::new(), 0);
    for (number, path) in (0u32..).zip(all.paths()) {
        let found = light(number, path);
        paths += u32::from(found.is_some());
        lights.push(found.unwrap_or(0.0));
        own.push(energies(number, path));
    }
    let records: usize = own.iter().map(Vec::len).sum();
    let energy = (records > 0).then(|| {
        let sums: Vec<f64> = own.iter().map(|it| it.iter().sum()).collect();
        let ratio = sums.iter().sum::<f64>() / records as f64;
        let square: f64 = own.iter().zip(&sums).map(|(it, sum)| (sum - ratio * it.len() as f64).powi(2)).sum();
        let standard_error = widened(&sums, square.sqrt() / records as f64);
        Estimate { value: ratio, standard_error }
    });
    let counts: Vec<f64> = own.iter().map(|it| it.len() as f64).collect();
    let per_path = mean(&counts, &vec![1.0; counts.len()]);
    LightAmount { paths, light: mean(&lights, &weights), records: records as u64, per_path, energy }
}

#[track_caller]
fn assert_amount(a: &LightAmount, b: &LightAmount, what: &str) {
    assert_near(a.light, b.light, what);
    assert_near(a.per_path, b.per_path, what);
    assert_eq!((a.paths, a.records), (b.paths, b.records), "{what}");
    assert_eq!(a.energy.is_some(), b.energy.is_some(), "{what}");
    assert_near(a.energy.unwrap_or_default(), b.energy.unwrap_or_default(), what);
}

#[test]
fn numbers_of_light_are_sums_over_the_records() {
    let all = recorded();
    let text = |name: Name| match all.names().number(name) {
        0 => "",
        number => &all.names().entries()[number as usize - 1].1,
    };
    for condition in
        ["", "bounce >= 1 and not object == plant", "light(occluder == plant)", "depth == 2 or bounce == 3"]
    {
        let selected = (!condition.is_empty()).then(|| select(&all, condition));
        let has_path = |number: u32| selected.as_ref().is_none_or(|it| it.paths.contains(number));
        let energies = |number: u32, path: &LightPath, holds: &dyn Fn(usize) -> bool| -> Vec<f64> {
            let own = all.intersections_of(number).zip(path.intersections.iter().enumerate());
            let chosen = own.filter(|(at, (index, _))| {
                has_path(number) && holds(*index) && selected.as_ref().is_none_or(|it| it.intersections.contains(*at))
            });
            chosen.map(|(_, (_, it))| it.radiance.iter().map(|x| f64::from(*x)).sum::<f64>() / 3.0).collect()
        };
        let lights = |number: u32, path: &LightPath, holds: &dyn Fn(&LightRecord) -> bool| -> Vec<f64> {
            let own = all.lights_of(number).zip(&path.lights);
            let chosen = own.filter(|(at, it)| {
                has_path(number) && holds(it) && selected.as_ref().is_none_or(|it| it.lights.contains(*at))
            });
            chosen.map(|(_, it)| f64::from(luminance(it.radiance))).collect()
        };
        let summary = summarize(&all, condition);
        let total = row_by_loops(
            &all,
            |number, path| has_path(number).then(|| f64::from(path.luminance())),
            |number, path| energies(number, path, &|_| true),
        );
        assert_amount(&summary.total, &total, condition);
        assert_eq!(summary.left_out, [0; 3]);
        let [objects, bounces, lamps] = &summary.groups;
        let names: Vec<String> = objects.iter().map(|(subject, _)| subject.text()).collect();
        assert!(
            ["room", "room.floor", "room.wall"].iter().all(|name| names.contains(&(*name).to_owned())),
            "{names:?}"
        );
        for (subject, amount) in objects {
            let is_in = |path: &LightPath, index: usize| {
                let it = &path.intersections[index];
                let is_medium = it.object == Name::NONE && it.interaction == femc_paths::InteractionKind::Volume;
                match subject {
                    // The synthetic media are materials, which are not names of media.
                    RowSubject::Nameless => it.object == Name::NONE,
                    RowSubject::Object(name) => {
                        !is_medium
                            && text(it.object)
                                .strip_prefix(&name[..])
                                .is_some_and(|rest| rest.is_empty() || rest.starts_with('.'))
                    }
                    other => panic!("{other:?}"),
                }
            };
            // A light came by the object if a selected intersection with it lies between the light and the camera.
            let is_selected = |number: u32, index: usize| {
                let at = all.intersections_of(number).start + index as u32;
                selected.as_ref().is_none_or(|it| it.intersections.contains(at))
            };
            let came_by = |number: u32, path: &LightPath, light: &LightRecord| {
                let mut vertex = light.vertex as usize;
                let mut way = Vec::new();
                while vertex > 0 {
                    way.push(vertex - 1);
                    vertex = path.intersections[vertex - 1].parent as usize;
                }
                way.into_iter().any(|index| is_in(path, index) && is_selected(number, index))
            };
            let expected = row_by_loops(
                &all,
                |number, path| {
                    let own = energies(number, path, &|index| is_in(path, index));
                    (!own.is_empty()).then(|| lights(number, path, &|light| came_by(number, path, light)).iter().sum())
                },
                |number, path| energies(number, path, &|index| is_in(path, index)),
            );
            assert_amount(amount, &expected, &format!("{condition}: {subject:?}"));
        }
        for (subject, amount) in bounces {
            let is_at = |path: &LightPath, vertex: u32| match subject {
                RowSubject::Camera => vertex == 0,
                RowSubject::Bounce(bounce) => vertex > 0 && path.intersections[vertex as usize - 1].bounce == *bounce,
                other => panic!("{other:?}"),
            };
            let own_energies =
                |number: u32, path: &LightPath| energies(number, path, &|index| is_at(path, index as u32 + 1));
            let expected = row_by_loops(
                &all,
                |number, path| {
                    let own = lights(number, path, &|light| is_at(path, light.vertex));
                    (!own.is_empty() || !own_energies(number, path).is_empty()).then(|| own.iter().sum())
                },
                own_energies,
            );
            assert_amount(amount, &expected, &format!("{condition}: {subject:?}"));
        }
        assert_eq!(lamps.len(), 2, "{lamps:?}");
        for (subject, amount) in lamps {
            let own =
                |number: u32, path: &LightPath| lights(number, path, &|light| text(light.light) == subject.text());
            let expected = row_by_loops(
                &all,
                |number, path| (!own(number, path).is_empty()).then(|| own(number, path).iter().sum()),
                |_, _| Vec::new(),
            );
            let counted = row_by_loops(&all, |_, _| None, own);
            let (records, per_path) = (counted.records, counted.per_path);
            assert_amount(amount, &LightAmount { records, per_path, ..expected }, &format!("{condition}: {subject:?}"));
        }
        let sum = |rows: &[(RowSubject, LightAmount)]| rows.iter().map(|(_, amount)| amount.light.value).sum::<f64>();
        assert!((sum(bounces) - sum(lamps)).abs() < 1e-9 * sum(lamps), "{condition}");
        if !condition.contains("light(") {
            // Without a condition on lights, all lights of the selected paths are selected.
            assert!((sum(lamps) - summary.total.light.value).abs() < 1e-5 * sum(lamps), "{condition}");
        }
    }
}

#[test]
fn the_condition_of_a_row_selects_its_records() {
    let all = recorded();
    let summary = summarize(&all, "");
    let mut conditions = 0;
    for (group, rows) in Group::ALL.into_iter().zip(&summary.groups) {
        for (subject, amount) in rows {
            let Some(condition) = subject.condition(group) else { continue };
            conditions += 1;
            let own = summarize(&all, &condition.to_string());
            let at = Group::ALL.iter().position(|it| *it == group).unwrap();
            let row = own.groups[at].iter().find(|(it, _)| it == subject).map(|(_, amount)| *amount).unwrap();
            assert_near(row.light, amount.light, &condition.to_string());
            match group {
                Group::Object => {
                    let records = LightAmount { light: amount.light, ..own.total };
                    assert_amount(&records, amount, &condition.to_string());
                }
                Group::Bounce | Group::Lamp => {
                    let others: f64 =
                        own.groups[at].iter().filter(|(it, _)| it != subject).map(|it| it.1.light.value).sum();
                    assert_eq!(others, 0.0, "{condition}: only this row has light");
                }
            }
        }
    }
    assert!(conditions > 10, "{conditions}");
}

/// Returns a small frame of lamps that the camera sees.
/// - `lamp`: name of the lamp of a sample; its argument is uniform in 0..1.
fn frame_of_lamps(number: u32, max_records: u32, lamp: impl Fn(f32) -> String) -> LightStatistics {
    let scope = Scope { frame: number, film: [16, 12], max_records, ..scope(max_records) };
    let mut all = LightStatistics::new(scope, 1.0);
    for tile in tiles(&scope) {
        let mut counters = [0, 1].map(|_| SampleCounters::with_pixels(scope.tile_area(tile) as usize));
        for pixel in scope.tile_pixels(tile) {
            for sample in 0..16 {
                let key = PathKey { frame: number, pixel, sample };
                counters[usize::from(key.half())].count(1.0, 0, PathEnd::Escaped);
                if !all.must_record(key) {
                    continue;
                }
                let draw = |salt: u64| unit_f32((combine(&[salt, key.hash(1)]) >> 32) as u32);
                let lamp = lamp(draw(1));
                all.names.insert(Name::new(NameKind::Lamp, &lamp), (NameKind::Lamp, lamp.clone()));
                let brightness = -ln(draw(2).max(1e-6)) * (1.0 + (pixel % 16) as f32);
                let light = LightRecord {
                    vertex: 0,
                    order: 0,
                    light: Name::new(NameKind::Lamp, &lamp),
                    medium: Name::NONE,
                    radiance: [brightness; 3],
                    occluder: None,
                    technique: LightTechnique::EmitterHit,
                };
                let path = LightPath {
                    key,
                    radiance: [brightness; 3],
                    throughput: [0.0; 3],
                    depth: 0,
                    end: PathEnd::Escaped,
                    intersections: Vec::new(),
                    lights: vec![light],
                };
                all.paths.insert((key.hash(scope.seed), key), path);
            }
        }
        for (half, counters) in (0..).zip(counters) {
            all.portions.insert(PortionKey { tile, half, begin: 0, end: 16 }, counters);
        }
    }
    all.trim();
    all
}

#[test]
fn intervals_of_95_percent_contain_the_truth_as_often() {
    // 400 frames: of 95 % intervals, 95 +- 2.2 % contain the truth (two standard deviations). Variation between the pixels makes
    // the intervals slightly too wide.
    const FRAMES: u32 = 400;
    let truth = 8.5;
    let (mut hits, mut biases) = ([0; 3], [0.0; 3]);
    for frame in 0..FRAMES {
        // Lamp `weak` has a quarter of the samples.
        let lamp = |draw: f32| if draw < 0.25 { "weak" } else { "strong" }.to_owned();
        let frames = FrameStatistics::from_statistics([frame_of_lamps(frame, 600, lamp)]).unwrap();
        let summary = RecordedPaths::new(frames).summarize(None, &RUNNING).unwrap();
        let lamp = |name: &str| summary.groups[2].iter().find(|(it, _)| it.text() == name).unwrap().1.light;
        let found = [(summary.total.light, truth), (lamp("weak"), truth / 4.0), (lamp("strong"), truth * 0.75)];
        for (at, (estimate, truth)) in found.into_iter().enumerate() {
            let error = estimate.standard_error.unwrap();
            hits[at] += u32::from((estimate.value - truth).abs() <= 1.96 * error);
            biases[at] += (estimate.value - truth) / error / f64::from(FRAMES).sqrt();
        }
    }
    let shares = hits.map(|hits| f64::from(hits) / f64::from(FRAMES));
    assert!(shares.iter().all(|share| (0.93..=0.98).contains(share)), "{shares:?}");
    assert!(biases.iter().all(|bias: &f64| bias.abs() < 3.5), "{biases:?} standard errors");
}

#[test]
fn an_amount_of_light_from_few_paths_has_no_error() {
    // The synthetic paths have few bright samples, which carry most of the light.
    let all = recorded();
    let summary = summarize(&all, "");
    assert_eq!(summary.total.light.standard_error, None, "{:?}", summary.total);
    assert!(summary.total.energy.unwrap().standard_error.is_some(), "energies are alike");
    let dim = summarize(&all, "path.radiance.g < 1000");
    assert!(dim.total.light.standard_error.is_some(), "{:?}", dim.total);
}

#[test]
fn only_the_rows_with_the_most_light_are_listed() {
    let frame = frame_of_lamps(1, 3000, |draw| format!("lamp {}", (draw * 1500.0) as u32));
    let all = RecordedPaths::new(FrameStatistics::from_statistics([frame]).unwrap());
    let summary = all.summarize(None, &RUNNING).unwrap();
    let lamps = &summary.groups[2];
    let names = all.names().entries().len();
    assert_eq!((lamps.len(), summary.left_out), (1000, [0, 0, names - 1000]), "{names} lamps");
    assert!(lamps.windows(2).all(|two| two[0].1.light.value >= two[1].1.light.value));
}

#[test]
fn the_light_of_a_lamp_within_another_counts_once() {
    let frame = frame_of_lamps(1, 3000, |draw| if draw < 0.5 { "sign" } else { "sign.letter" }.to_owned());
    let all = RecordedPaths::new(FrameStatistics::from_statistics([frame]).unwrap());
    let summary = all.summarize(None, &RUNNING).unwrap();
    let lamps = &summary.groups[2];
    let sum: f64 = lamps.iter().map(|(_, amount)| amount.light.value).sum();
    assert_eq!(lamps.len(), 2);
    assert!((sum / summary.total.light.value - 1.0).abs() < 1e-6, "{lamps:?}");
}

#[test]
fn a_bounce_of_any_number_takes_one_row() {
    let mut frame = task(&scope(3000), 1, 0..4);
    let path = frame.paths.values_mut().find(|path| !path.intersections.is_empty()).unwrap();
    path.intersections[0].bounce = u32::MAX;
    let all = RecordedPaths::new(FrameStatistics::from_statistics([frame]).unwrap());
    let bounces = &all.summarize(None, &RUNNING).unwrap().groups[1];
    assert_eq!(bounces.last().unwrap().0, RowSubject::Bounce(u32::MAX));
}
