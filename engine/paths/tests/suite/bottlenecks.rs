//! Tests of the sources of noise and long paths.

use crate::synthetic::{self, OBJECTS, leads_through, merge_parts, scope, tasks};
use femc_paths::bottlenecks::{Bottlenecks, Grouping, PartStatistics, ScenePart, scattering_part, weighted_paths};
use femc_paths::pixels::PixelMaps;
use femc_paths::statistics::{DEEP_PATH_DEPTH, LightStatistics, Scope};
use femc_paths::{LightPath, Name, NameKind, PathKey, record};
use std::collections::BTreeMap;

fn frame(keep: u32) -> LightStatistics {
    merge_parts(&scope(keep), tasks(&scope(keep))).into_image_samples(0, |_, _| u32::MAX)
}

/// Returns all samples that count.
fn all(scope: &Scope) -> Vec<LightPath> {
    let keys = (0..36 * 20).flat_map(|pixel| (0..16).map(move |sample| PathKey { frame: 3, pixel, sample }));
    keys.filter(|key| !synthetic::is_bad(*key)).map(|key| synthetic::path(scope, key)).collect()
}

/// Computes each object's part of the noise from all samples, with the formula.
fn expected_noise(scope: &Scope) -> BTreeMap<Name, f64> {
    let [columns, rows] = [36 / 16 + 1, 20 / 16 + 1];
    let block = |pixel: u32| (pixel / 36 / 16 * columns + pixel % 36 / 16) as usize;
    let mut by_pixel = BTreeMap::<u32, Vec<LightPath>>::new();
    all(scope).into_iter().for_each(|path| by_pixel.entry(path.key.pixel).or_default().push(path));
    let mut sums = vec![0.0; (columns * rows) as usize];
    for (pixel, paths) in &by_pixel {
        sums[block(*pixel)] += paths.iter().map(|it| f64::from(it.luminance())).sum::<f64>() / paths.len() as f64;
    }
    let mut noises: BTreeMap<Name, f64> = OBJECTS.map(|text| (Name::new(NameKind::Object, text), 0.0)).into();
    for (pixel, paths) in &by_pixel {
        let n = paths.len() as f64;
        for path in paths {
            let own = f64::from(path.luminance());
            let others = (paths.iter().map(|it| f64::from(it.luminance())).sum::<f64>() - own) / (n - 1.0);
            let noise = ((own - others).max(0.0) / n / sums[block(*pixel)]).powi(2);
            for light in &path.lights {
                let part = f64::from(record::luminance(light.radiance)) / own;
                *noises.get_mut(&scattering_part(path, light).object).unwrap() += noise * part;
            }
        }
    }
    noises
}

fn object_statistics(found: &Bottlenecks, object: Name) -> PartStatistics {
    found.parts[&ScenePart { object, ..ScenePart::default() }]
}

#[test]
fn parts_of_all_samples_match_the_formula_and_add_up() {
    // Everything is recorded: the limit is not reached, and the share is 1.
    let scope = scope(1 << 20);
    let mut all = LightStatistics::new(scope, 1.0);
    let parts = synthetic::tiles(&scope).map(|tile| synthetic::record_task(&scope, tile, 0..16, 1.0, |_, _| true));
    all.merge_all(parts).unwrap();
    let found = Bottlenecks::from_statistics(&all, Grouping::Object);
    let expected = expected_noise(&scope);
    let total: f64 = expected.values().sum();
    for (object, noise) in &expected {
        // A pixel with bad samples weighs its other samples as if the bad ones were present.
        let own = object_statistics(&found, *object).noise;
        assert!((own - noise).abs() < 0.01 * total, "{own} and {noise} of {total}");
    }
    let light: f64 = PixelMaps::from_statistics(&all).pixels().map(|it| it.luminance).sum();
    assert!((found.total.light / light - 1.0).abs() < 0.01, "{} and {light}", found.total.light);
    let sum = |of: fn(&PartStatistics) -> f64| found.parts.values().map(of).sum::<f64>();
    assert!((sum(|it| it.noise) / found.total.noise - 1.0).abs() < 1e-9);
    assert!((sum(|it| it.light) / found.total.light - 1.0).abs() < 1e-9);
    let lamps = found.lamps.values().map(|it| it.noise).sum::<f64>();
    assert!((lamps / found.total.noise - 1.0).abs() < 1e-9);
}

#[test]
fn a_tenth_of_the_samples_and_the_brightest_say_nearly_the_same() {
    let (whole, some) = (frame(1 << 20), frame(1200));
    assert!(some.share() < 0.2, "{}", some.share());
    let weights: f64 = weighted_paths(&some).iter().map(|it| it.weight).sum();
    assert!((weights / whole.samples() as f64 - 1.0).abs() < 0.1, "{weights} of {}", whole.samples());
    let (scope, found) = (scope(1200), Bottlenecks::from_statistics(&some, Grouping::Object));
    let expected = expected_noise(&scope);
    let total: f64 = expected.values().sum();
    for (object, noise) in expected {
        let own = object_statistics(&found, object).noise;
        assert!((own - noise).abs() < 0.05 * total, "{own} and {noise} of {total}");
    }
    // Without the few brightest samples, the noise would be wrong.
    let blind =
        LightStatistics { brightest: BTreeMap::new(), scope: Scope { sketch_size: 0, ..some.scope }, ..some.clone() };
    let blind = Bottlenecks::from_statistics(&blind, Grouping::Object);
    assert!((blind.total.noise / total - 1.0).abs() > 4.0 * (found.total.noise / total - 1.0).abs());
    let (first, last) = (found.fireflies.first().unwrap(), found.fireflies.last().unwrap());
    assert!(first.1.noise >= last.1.noise && first.1.luminance > 100.0 * first.1.mean_of_others as f32);
}

#[test]
fn the_deep_throughput_is_what_arrives_late() {
    let (whole, scope) = (frame(1 << 20), scope(1 << 20));
    let found = Bottlenecks::from_statistics(&whole, Grouping::Part);
    let share = whole.share();
    let late = |path: &LightPath| {
        let before = |index: usize| (0..index).filter(|other| leads_through(path, index, *other)).count();
        let arriving = (0..path.intersections.len()).filter(|index| before(*index) + 1 >= DEEP_PATH_DEPTH as usize);
        arriving
            .map(|index| &path.intersections[index])
            .map(|it| f64::from(it.throughput.into_iter().fold(0.0, f32::max)))
            .sum::<f64>()
    };
    let recorded: f64 = whole.paths.values().map(late).sum();
    assert!((found.total.deep_throughput - recorded / share).abs() < 1e-6 * found.total.deep_throughput);
    let expected: f64 = all(&scope).iter().map(late).sum();
    assert!(
        (found.total.deep_throughput / expected - 1.0).abs() < 0.2,
        "{} and {expected}",
        found.total.deep_throughput
    );
    let wall = Name::new(NameKind::Object, OBJECTS[1]);
    let begins = |path: &&LightPath| path.intersections.first().is_some_and(|it| it.object == wall);
    let (own, others): (Vec<&LightPath>, Vec<&LightPath>) =
        whole.paths.values().filter(|path| path.depth > 0).partition(begins);
    let objects = Bottlenecks::from_statistics(&whole, Grouping::Object);
    let evidence = object_statistics(&objects, wall);
    let depths = |paths: &[&LightPath]| paths.iter().map(|path| u64::from(path.depth)).sum::<u64>();
    assert_eq!((evidence.first_hits, evidence.depth_sum), (own.len() as u64, depths(&own)));
    let rest = objects.without_part(&evidence);
    assert_eq!((rest.first_hits, rest.depth_sum), (others.len() as u64, depths(&others)));
    assert_eq!(found.deep_samples, all(&scope).iter().filter(|path| path.depth >= DEEP_PATH_DEPTH).count() as u64);
    let records: usize = whole.paths.values().map(|path| path.intersections.len()).sum();
    assert_eq!(found.parts.values().map(|it| it.records).sum::<u64>(), records as u64);
}

#[test]
fn frames_are_added() {
    let one = Bottlenecks::from_statistics(&frame(900), Grouping::Part);
    let mut two = one.clone();
    two.merge(one.clone());
    assert_eq!((two.frames, two.samples), (2, 2 * one.samples));
    assert_eq!(two.total.noise, 2.0 * one.total.noise);
    assert_eq!(two.parts.len(), one.parts.len());
    assert!(two.fireflies.iter().take(2).map(|it| it.0).eq([0, 1]), "the same sample of both");
}
