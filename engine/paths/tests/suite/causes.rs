//! What makes an image noisy and its paths long.

use crate::world::{self, OBJECTS, scope, tasks, united};
use femc_paths::bottlenecks::{Bottlenecks, By, scattered_by, weighed};
use femc_paths::pixels::Maps;
use femc_paths::statistics::{DEEP, Scope, Statistics};
use femc_paths::{Kind, Name, Path, PathKey, record};
use std::collections::BTreeMap;

fn frame(keep: u32) -> Statistics {
    united(&scope(keep), tasks(&scope(keep))).counted(0, |_, _| u32::MAX)
}

/// All samples that count.
fn all(scope: &Scope) -> Vec<Path> {
    let keys = (0..36 * 20).flat_map(|pixel| (0..16).map(move |sample| PathKey { frame: 3, pixel, sample }));
    keys.filter(|key| !world::is_bad(*key)).map(|key| world::path(scope, key)).collect()
}

/// The covariance of each object's part of a pixel with its samples, over their number: of all samples, by the formula for it.
fn variances(scope: &Scope) -> BTreeMap<Name, f64> {
    let mut by_pixel = BTreeMap::<u32, Vec<Path>>::new();
    all(scope).into_iter().for_each(|path| by_pixel.entry(path.key.pixel).or_default().push(path));
    let mut variances = BTreeMap::new();
    for paths in by_pixel.values() {
        let n = paths.len() as f64;
        let own = |path: &Path, object: Name| {
            let of = |light: &&femc_paths::Light| scattered_by(path, light).object == object;
            path.lights.iter().filter(of).map(|light| f64::from(record::luminance(light.radiance))).sum::<f64>()
        };
        let mean = paths.iter().map(|path| f64::from(path.luminance())).sum::<f64>() / n;
        for object in OBJECTS.map(|text| Name::of(Kind::Object, text)) {
            let part_mean = paths.iter().map(|path| own(path, object)).sum::<f64>() / n;
            let both = |path: &Path| (own(path, object) - part_mean) * (f64::from(path.luminance()) - mean);
            let covariance = paths.iter().map(both).sum::<f64>() / (n - 1.0);
            *variances.entry(object).or_insert(0.0) += covariance / n;
        }
    }
    variances
}

#[test]
fn of_all_samples_the_parts_are_the_covariances_and_add_up_to_the_variance() {
    // Everything is recorded: the pool has room, and the share is all.
    let scope = scope(1 << 20);
    let mut all = Statistics::new(scope, 1.0);
    let parts = world::tiles(&scope).map(|tile| world::record(&scope, tile, 0..16, 1.0, |_, _| true));
    all.unite_all(parts).unwrap();
    let found = Bottlenecks::of(&all, By::Object);
    let expected = variances(&scope);
    let total: f64 = expected.values().sum();
    for (object, variance) in &expected {
        let own = found.parts[&femc_paths::bottlenecks::Part { object: *object, ..Default::default() }];
        // A pixel whose bad samples are left out weighs its others as if they were there.
        assert!((own.variance - variance).abs() < 0.01 * total, "{} and {variance} of {total}", own.variance);
    }
    let of_pixels: f64 = Maps::of(&all).pixels().map(|it| it.variance / it.samples.max(1) as f64).sum();
    assert!((found.total.variance / of_pixels - 1.0).abs() < 0.05, "{} and {of_pixels}", found.total.variance);
    let light: f64 = Maps::of(&all).pixels().map(|it| it.luminance).sum();
    assert!((found.total.light / light - 1.0).abs() < 0.01, "{} and {light}", found.total.light);
    let sum = |of: fn(&femc_paths::bottlenecks::Evidence) -> f64| found.parts.values().map(of).sum::<f64>();
    assert!((sum(|it| it.variance) / found.total.variance - 1.0).abs() < 1e-9);
    assert!((sum(|it| it.light) / found.total.light - 1.0).abs() < 1e-9);
}

#[test]
fn a_tenth_of_the_samples_and_the_brightest_say_nearly_the_same() {
    let (whole, some) = (frame(1 << 20), frame(1200));
    assert!(some.share() < 0.2, "{}", some.share());
    let weights: f64 = weighed(&some).iter().map(|it| it.weight).sum();
    assert!((weights / whole.samples() as f64 - 1.0).abs() < 0.1, "{weights} of {}", whole.samples());
    let (scope, found) = (scope(1200), Bottlenecks::of(&some, By::Object));
    let expected = variances(&scope);
    let total: f64 = expected.values().sum();
    for (object, variance) in expected {
        let own = found.parts[&femc_paths::bottlenecks::Part { object, ..Default::default() }].variance;
        assert!((own - variance).abs() < 0.1 * total, "{own} and {variance} of {total}");
    }
    // Without the brightest, of which there are few, it would not.
    let blind = Statistics { brightest: BTreeMap::new(), scope: Scope { top: 0, ..some.scope }, ..some.clone() };
    let blind = Bottlenecks::of(&blind, By::Object);
    assert!((blind.total.variance / total - 1.0).abs() > 2.0 * (found.total.variance / total - 1.0).abs());
    let (first, last) = (found.fireflies.first().unwrap(), found.fireflies.last().unwrap());
    assert!(first.1.variance >= last.1.variance && first.1.luminance > 100.0 * first.1.others as f32);
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
    assert_eq!(two.total.variance, 2.0 * one.total.variance);
    assert_eq!(two.parts.len(), one.parts.len());
    assert!(two.fireflies.iter().take(2).map(|it| it.0).eq([0, 1]), "the same sample of both");
}
