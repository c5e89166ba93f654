//! Tests of the sources of noise and long paths.

use crate::world::{self, OBJECTS, scope, tasks, united};
use femc_paths::bottlenecks::{Bottlenecks, By, Evidence, Part, scattered_by, weighed};
use femc_paths::pixels::Maps;
use femc_paths::statistics::{DEEP, Scope, Statistics};
use femc_paths::{Kind, Name, Path, PathKey, record};
use std::collections::BTreeMap;

fn frame(keep: u32) -> Statistics {
    united(&scope(keep), tasks(&scope(keep))).counted(0, |_, _| u32::MAX)
}

/// Returns all samples that count.
fn all(scope: &Scope) -> Vec<Path> {
    let keys = (0..36 * 20).flat_map(|pixel| (0..16).map(move |sample| PathKey { frame: 3, pixel, sample }));
    keys.filter(|key| !world::is_bad(*key)).map(|key| world::path(scope, key)).collect()
}

/// Computes each object's part of the noise from all samples, with the formula.
fn noises(scope: &Scope) -> BTreeMap<Name, f64> {
    let [columns, rows] = [36 / 16 + 1, 20 / 16 + 1];
    let block = |pixel: u32| (pixel / 36 / 16 * columns + pixel % 36 / 16) as usize;
    let mut by_pixel = BTreeMap::<u32, Vec<Path>>::new();
    all(scope).into_iter().for_each(|path| by_pixel.entry(path.key.pixel).or_default().push(path));
    let mut sums = vec![0.0; (columns * rows) as usize];
    for (pixel, paths) in &by_pixel {
        sums[block(*pixel)] += paths.iter().map(|it| f64::from(it.luminance())).sum::<f64>() / paths.len() as f64;
    }
    let mut noises: BTreeMap<Name, f64> = OBJECTS.map(|text| (Name::of(Kind::Object, text), 0.0)).into();
    for (pixel, paths) in &by_pixel {
        let n = paths.len() as f64;
        for path in paths {
            let own = f64::from(path.luminance());
            let others = (paths.iter().map(|it| f64::from(it.luminance())).sum::<f64>() - own) / (n - 1.0);
            let noise = ((own - others).max(0.0) / n / sums[block(*pixel)]).powi(2);
            for light in &path.lights {
                let part = f64::from(record::luminance(light.radiance)) / own;
                *noises.get_mut(&scattered_by(path, light).object).unwrap() += noise * part;
            }
        }
    }
    noises
}

fn of_object(found: &Bottlenecks, object: Name) -> Evidence {
    found.parts[&Part { object, ..Part::default() }]
}

#[test]
fn parts_of_all_samples_match_the_formula_and_add_up() {
    // Everything is recorded: the limit is not reached, and the share is 1.
    let scope = scope(1 << 20);
    let mut all = Statistics::new(scope, 1.0);
    let parts = world::tiles(&scope).map(|tile| world::record(&scope, tile, 0..16, 1.0, |_, _| true));
    all.unite_all(parts).unwrap();
    let found = Bottlenecks::of(&all, By::Object);
    let expected = noises(&scope);
    let total: f64 = expected.values().sum();
    for (object, noise) in &expected {
        // A pixel with bad samples weighs its other samples as if the bad ones were present.
        let own = of_object(&found, *object).noise;
        assert!((own - noise).abs() < 0.01 * total, "{own} and {noise} of {total}");
    }
    let light: f64 = Maps::of(&all).pixels().map(|it| it.luminance).sum();
    assert!((found.total.light / light - 1.0).abs() < 0.01, "{} and {light}", found.total.light);
    let sum = |of: fn(&Evidence) -> f64| found.parts.values().map(of).sum::<f64>();
    assert!((sum(|it| it.noise) / found.total.noise - 1.0).abs() < 1e-9);
    assert!((sum(|it| it.light) / found.total.light - 1.0).abs() < 1e-9);
    let lamps = found.lamps.values().map(|it| it.noise).sum::<f64>();
    assert!((lamps / found.total.noise - 1.0).abs() < 1e-9);
}

#[test]
fn a_tenth_of_the_samples_and_the_brightest_say_nearly_the_same() {
    let (whole, some) = (frame(1 << 20), frame(1200));
    assert!(some.share() < 0.2, "{}", some.share());
    let weights: f64 = weighed(&some).iter().map(|it| it.weight).sum();
    assert!((weights / whole.samples() as f64 - 1.0).abs() < 0.1, "{weights} of {}", whole.samples());
    let (scope, found) = (scope(1200), Bottlenecks::of(&some, By::Object));
    let expected = noises(&scope);
    let total: f64 = expected.values().sum();
    for (object, noise) in expected {
        let own = of_object(&found, object).noise;
        assert!((own - noise).abs() < 0.05 * total, "{own} and {noise} of {total}");
    }
    // Without the few brightest samples, the noise would be wrong.
    let blind = Statistics { brightest: BTreeMap::new(), scope: Scope { top: 0, ..some.scope }, ..some.clone() };
    let blind = Bottlenecks::of(&blind, By::Object);
    assert!((blind.total.noise / total - 1.0).abs() > 4.0 * (found.total.noise / total - 1.0).abs());
    let (first, last) = (found.fireflies.first().unwrap(), found.fireflies.last().unwrap());
    assert!(first.1.noise >= last.1.noise && first.1.luminance > 100.0 * first.1.others as f32);
}

#[test]
fn the_deep_throughput_is_what_arrives_late() {
    let (whole, scope) = (frame(1 << 20), scope(1 << 20));
    let found = Bottlenecks::of(&whole, By::Part);
    let share = whole.share();
    let late = |path: &Path| {
        let arriving = path.intersections.iter().skip(DEEP as usize - 1);
        arriving.map(|it| f64::from(it.throughput.into_iter().fold(0.0, f32::max))).sum::<f64>()
    };
    let recorded: f64 = whole.paths.values().map(late).sum();
    assert!((found.total.deep - recorded / share).abs() < 1e-6 * found.total.deep);
    let expected: f64 = all(&scope).iter().map(late).sum();
    assert!((found.total.deep / expected - 1.0).abs() < 0.2, "{} and {expected}", found.total.deep);
    let wall = Name::of(Kind::Object, OBJECTS[1]);
    let begins = |path: &&Path| path.intersections.first().is_some_and(|it| it.object == wall);
    let (own, others): (Vec<&Path>, Vec<&Path>) = whole.paths.values().filter(|path| path.depth > 0).partition(begins);
    let objects = Bottlenecks::of(&whole, By::Object);
    let evidence = of_object(&objects, wall);
    let depths = |paths: &[&Path]| paths.iter().map(|path| u64::from(path.depth)).sum::<u64>();
    assert_eq!((evidence.begun, evidence.depths), (own.len() as u64, depths(&own)));
    let rest = objects.others(&evidence);
    assert_eq!((rest.begun, rest.depths), (others.len() as u64, depths(&others)));
    assert_eq!(found.deep_samples, all(&scope).iter().filter(|path| path.depth >= DEEP).count() as u64);
    let records: usize = whole.paths.values().map(|path| path.intersections.len()).sum();
    assert_eq!(found.parts.values().map(|it| it.records).sum::<u64>(), records as u64);
}

#[test]
fn frames_are_added() {
    let one = Bottlenecks::of(&frame(900), By::Part);
    let mut two = one.clone();
    two.merge(one.clone());
    assert_eq!((two.frames, two.samples), (2, 2 * one.samples));
    assert_eq!(two.total.noise, 2.0 * one.total.noise);
    assert_eq!(two.parts.len(), one.parts.len());
    assert!(two.fireflies.iter().take(2).map(|it| it.0).eq([0, 1]), "the same sample of both");
}
