//! Laws of recorded paths: selections, histograms, densities and representatives equal counts by loops, which share no code with the
//! crate.

use crate::conditions::generated::{Draws, random_condition, random_path, written};
use crate::conditions::meaning::{ENDS, INTERACTIONS, Own, TECHNIQUES, luminance, value_of};
use crate::conditions::{NAMES, condition};
use crate::scales::{bin_among, edges};
use crate::synthetic::{is_bad, merge_parts, path, scope, task, tiles};
use femc_paths::attribute::Attribute;
use femc_paths::histogram::{Histograms, Table};
use femc_paths::pixels::PixelMaps;
use femc_paths::recorded::{HistogramRequest, PairKey, Weighting};
use femc_paths::represent::{Distance, PathBins, Target, choose_representative, rarest_paths};
use femc_paths::schema::Scale;
use femc_paths::selection::{BitMask, SelectedRecords};
use femc_paths::{FrameStatistics, LightPath, LightRecord, LightStatistics, Name, PathKey, RecordedPaths, Scope};
use std::collections::{BTreeMap, BTreeSet};
use std::sync::atomic::AtomicBool;

static RUNNING: AtomicBool = AtomicBool::new(false);

/// Number of samples of each pixel of a tile: 2, 4 or 6.
fn samples_of(tile: u32) -> u32 {
    2 + 2 * (tile % 3)
}

/// Creates a frame of random paths, whose tiles have different numbers of samples.
fn frame(number: u32) -> LightStatistics {
    let scope = Scope { frame: number, ..scope(400) };
    let mut all = merge_parts(&scope, tiles(&scope).map(|tile| task(&scope, tile, 0..samples_of(tile))));
    let mut draws = Draws(u64::from(number));
    for own in all.paths.values_mut() {
        let key = own.key;
        *own = random_path(&mut draws);
        own.key = key;
        // No value lies at an edge of a bin.
        own.intersections.iter_mut().for_each(|it| it.position = it.position.map(|axis| axis + 0.013));
        own.lights.iter_mut().for_each(|it| it.radiance = it.radiance.map(|channel| 1.01 * channel));
    }
    all.names.extend(NAMES.clone());
    all
}

fn recorded() -> RecordedPaths {
    RecordedPaths::new(FrameStatistics::from_statistics([2, 5].map(frame)).unwrap())
}

/// Part of the image that a sample is, in pixels: half a pixel, divided by the samples of its half, in steps of 2^-32.
fn image_part(key: PathKey) -> f64 {
    let (x, y) = (key.pixel % 36, key.pixel / 36);
    let half = f64::from(samples_of(y / 8 * 5 + x / 8) / 2);
    (0.5 / half * 4_294_967_296.0).round() / 4_294_967_296.0
}

/// A record: its path, and its intersection or light.
type Record<'a> = (&'a LightPath, Option<usize>, Option<&'a LightRecord>);

/// Returns the records of a table, in order.
fn records(paths: &[LightPath], table: Table) -> Vec<Record<'_>> {
    let mut all = Vec::new();
    for path in paths {
        match table {
            Table::Paths => all.push((path, None, None)),
            Table::Intersections => all.extend((0..path.intersections.len()).map(|at| (path, Some(at), None))),
            Table::Lights => all.extend(path.lights.iter().map(|light| (path, None, Some(light)))),
        }
    }
    all
}

/// Returns the name of a record; `None`: the attribute is not a name.
fn name_of(field: &str, (path, at, light): Record<'_>) -> Option<Name> {
    let mut brightest: Option<&LightRecord> = None;
    for light in &path.lights {
        if brightest.is_none_or(|it| luminance(it.radiance) <= luminance(light.radiance)) {
            brightest = Some(light);
        }
    }
    let name = match field {
        "first.object" => path.intersections.first().map(|it| it.object),
        "brightest.light" => brightest.map(|it| it.light),
        "object" => Some(path.intersections[at?].object),
        "material" => Some(path.intersections[at?].material),
        "light" => Some(light?.light),
        "occluder" => light?.occluder,
        _ => return None,
    };
    Some(name.unwrap_or(Name(0)))
}

/// Returns the bin of a value that is not a name, in a box of the world.
fn own_bin(field: &str, [lower, upper]: [[f64; 3]; 2], (path, at, light): Record<'_>) -> u8 {
    let place = |words: &[&str], own: &str| words.iter().position(|word| *word == own).unwrap() as u8 + 1;
    let number = match value_of(path, 36, field, at, light) {
        None => return 0,
        Some(Own::Text(own)) if field == "end" => return place(&ENDS, own),
        Some(Own::Text(own)) if field == "found" => return place(&TECHNIQUES, own),
        Some(Own::Text(own)) => return place(&INTERACTIONS, own),
        Some(Own::Number(number)) => number,
    };
    match field {
        "pixel.x" => (number as u32 * 64 / 36) as u8,
        "pixel.y" => (number as u32 * 64 / 20) as u8,
        "depth" | "bounce" => number.min(63.0) as u8,
        _ if field.contains("throughput") => bin_among(&edges(Scale::Throughput), number as f32),
        _ if field.contains("radiance") => bin_among(&edges(Scale::Radiance), number as f32),
        _ => {
            let axis = "xyz".find(&field[field.len() - 1..]).unwrap();
            let part = ((number - lower[axis]) * 63.0 / (upper[axis] - lower[axis])).floor();
            1 + part.clamp(0.0, 62.0) as u8
        }
    }
}

/// Returns the bins of names: the most frequent name has bin 1. Equally frequent names are in order of kind and text.
fn categories(field: &str, all: &[Record<'_>]) -> BTreeMap<Name, u8> {
    let mut counts: BTreeMap<Name, usize> = BTreeMap::new();
    for name in all.iter().filter_map(|record| name_of(field, *record)).filter(|name| name.0 != 0) {
        *counts.entry(name).or_default() += 1;
    }
    let mut ranked: Vec<Name> = counts.keys().copied().collect();
    ranked.sort_by_key(|name| (usize::MAX - counts[name], NAMES[name].clone()));
    let own = (1..).zip(ranked).map(|(bin, name)| (name, bin));
    own.chain([(Name(0), 0)]).collect()
}

#[test]
fn histograms_of_records_equal_loops() {
    let all = recorded();
    let mut draws = Draws(8);
    let mask = |count: u32, draws: &mut Draws| {
        let mut mask = BitMask::new(count);
        (0..count).filter(|_| draws.below(3) > 0).for_each(|number| mask.insert(number));
        mask
    };
    let [paths, intersections, lights] = all.totals().map(|count| mask(count, &mut draws));
    let selected = SelectedRecords { paths, intersections, lights };
    let pairs = [(Table::Paths, 0, 14), (Table::Paths, 9, 2), (Table::Intersections, 9, 1), (Table::Lights, 4, 0)]
        .map(|(table, row, column)| PairKey { table, row, column });
    let own_box = [[-2.0, 0.0, 0.0], [4.0, 3.0, 2.5]];
    for (selected, weighting, bounds) in [
        (None, Weighting::Samples, None),
        (Some(&selected), Weighting::Samples, Some([[-1.5, -2.0, 0.5], [3.0, 1.0, 2.0]])),
        (Some(&selected), Weighting::Image, None),
        (None, Weighting::Image, Some([[0.0; 3], [1.0, 2.0, 3.0]])),
    ] {
        let request = HistogramRequest { selected, pairs: &pairs, weighting, bounds };
        let found = all.histograms(&request, &RUNNING).unwrap();
        for table in Table::ALL {
            let records = records(all.paths(), table);
            let bins = |attribute: &Attribute| -> Vec<u8> {
                let names = categories(attribute.field, &records);
                let bin = |record: &Record<'_>| match name_of(attribute.field, *record) {
                    Some(name) => names[&name],
                    None => own_bin(attribute.field, bounds.unwrap_or(own_box), *record),
                };
                records.iter().map(bin).collect()
            };
            let columns: Vec<Vec<u8>> = table.attributes().iter().map(bins).collect();
            let weights: Vec<f64> = (0..)
                .zip(&records)
                .map(|(number, (path, ..))| match weighting {
                    _ if !selected.is_none_or(|it| it.mask(table).contains(number)) => 0.0,
                    Weighting::Samples => 1.0,
                    Weighting::Image => image_part(path.key),
                })
                .collect();
            for (axis, (column, attribute)) in columns.iter().zip(table.attributes()).enumerate() {
                let mut counts = vec![0.0; 64];
                column.iter().zip(&weights).for_each(|(bin, weight)| counts[usize::from(*bin)] += weight);
                let found = &found.single[table as usize][axis];
                let is_near = |(a, b): (&f64, &f64)| (a - b).abs() < 1e-9;
                assert!(found.iter().zip(&counts).all(is_near), "{} {weighting:?} {bounds:?}", attribute.field);
            }
            for (pair, found) in pairs.iter().zip(&found.pairs).filter(|it| it.0.table == table) {
                let mut counts = vec![0.0; 64 * 64];
                for ((row, column), weight) in columns[pair.row].iter().zip(&columns[pair.column]).zip(&weights) {
                    counts[64 * usize::from(*row) + usize::from(*column)] += weight;
                }
                assert!(found.iter().zip(&counts).all(|(a, b)| (f64::from(*a) - b).abs() < 1e-4), "{pair:?}");
            }
        }
    }
}

#[test]
fn histograms_of_statistics_equal_loops() {
    let all = frame(3);
    let paths: Vec<LightPath> = all.paths.values().cloned().collect();
    let own_box = [[-2.0, 0.0, 0.0], [4.0, 3.0, 2.5]];
    for table in Table::ALL {
        let (found, records) = (Histograms::from_statistics(&all, table), records(&paths, table));
        let mut columns = Vec::new();
        for (attribute, counts) in table.attributes().iter().zip(&found.attributes) {
            let bin = |record: &Record<'_>| match name_of(attribute.field, *record) {
                Some(Name(0)) => 0,
                Some(Name(key)) => 1 + key % 63,
                None => u64::from(own_bin(attribute.field, own_box, *record)),
            };
            let column: Vec<u64> = records.iter().map(bin).collect();
            for bin in 0..64u64 {
                let own: Vec<&Record<'_>> =
                    records.iter().zip(&column).filter(|it| *it.1 == bin).map(|it| it.0).collect();
                let image: f64 = own.iter().map(|(path, ..)| image_part(path.key) * 4_294_967_296.0).sum();
                let found = (counts.samples[bin as usize], counts.image[bin as usize]);
                assert_eq!(found, (own.len() as u64, image as u64), "{} bin {bin}", attribute.field);
            }
            columns.push(column);
        }
        for (pair, [a, b]) in found.pairs.iter().zip(table.pairs()) {
            let index = |name: &str| table.attributes().iter().position(|it| it.name == name).unwrap();
            let mut counts = vec![0u64; 64 * 64];
            let joint = columns[index(a)].iter().zip(&columns[index(b)]);
            joint.for_each(|(row, column)| counts[(64 * row + column) as usize] += 1);
            assert!(pair.samples == counts, "{a} and {b}");
        }
    }
}

#[test]
fn selections_densities_and_shares_equal_loops() {
    let all = recorded();
    let mut draws = Draws(4);
    let (mut tried, mut partial) = (0, 0);
    while tried < 60 {
        let depth = 1 + draws.below(3);
        let meaning = random_condition(&mut draws, depth);
        let text = written(&meaning, &mut draws);
        let found = all.select(&condition(&text), &RUNNING).unwrap();
        let mut expected = [const { BTreeSet::new() }; 3];
        let (mut intersection, mut light, mut pixels) = (0, 0, BTreeMap::<u32, [f64; 3]>::new());
        let (mut selected_light, mut all_light) = (0.0, 0.0);
        for (number, path) in (0u32..).zip(all.paths()) {
            let own = f64::from(luminance(path.radiance));
            all_light += own * image_part(path.key);
            if let Some([intersections, lights]) = meaning.select(path, 36) {
                expected[0].insert(number);
                expected[1].extend(intersections.iter().map(|at| intersection + at));
                expected[2].extend(lights.iter().map(|at| light + at));
                selected_light += own * image_part(path.key);
                let pixel = pixels.entry(path.key.pixel).or_default();
                let of_frames = own * image_part(path.key) / 2.0;
                *pixel = [pixel[0] + 1.0, pixel[1] + of_frames, pixel[2] + own];
            }
            intersection += path.intersections.len() as u32;
            light += path.lights.len() as u32;
        }
        for (table, expected) in Table::ALL.into_iter().zip(&expected) {
            assert!(found.mask(table).numbers().eq(expected.iter().copied()), "{text}: {table:?}");
            assert_eq!(found.counts()[table as usize], expected.len() as u32);
        }
        let is_near = |a: f64, b: f64| (a - b).abs() < 1e-6 * (1.0 + b.abs());
        assert!(is_near(all.light_share(&found.paths).unwrap(), selected_light / all_light), "{text}");
        let densities = all.density(&found.paths).unwrap();
        assert_eq!(densities.len(), pixels.len());
        for (own, (pixel, [count, light, sum])) in densities.iter().zip(pixels) {
            assert_eq!((own.pixel, f64::from(own.count)), (pixel, count), "{text}");
            assert!(is_near(own.contribution, light) && is_near(own.mean_luminance, sum / count), "{text}: {own:?}");
        }
        tried += 1;
        partial += usize::from((1..all.paths().len()).contains(&expected[0].len()));
    }
    assert!(partial > 20, "{partial}");
}

#[test]
fn pixels_equal_loops_over_their_samples() {
    let scope = scope(400);
    let all = merge_parts(&scope, tiles(&scope).map(|tile| task(&scope, tile, 0..samples_of(tile))));
    let maps = PixelMaps::from_statistics(&all);
    assert_eq!(maps.pixels().len(), 720);
    for (pixel, found) in (0u32..).zip(maps.pixels()) {
        let count = samples_of(pixel / 36 / 8 * 5 + pixel % 36 / 8);
        let keys = (0..count).map(|sample| PathKey { frame: 3, pixel, sample });
        let good: Vec<LightPath> = keys.filter(|key| !is_bad(*key)).map(|key| path(&scope, key)).collect();
        let halves = [0, 1].map(|half| good.iter().filter(|it| it.key.sample % 2 == half).collect::<Vec<_>>());
        let halves: Vec<Vec<&LightPath>> = halves.into_iter().filter(|half| !half.is_empty()).collect();
        let mean_in = |half: &[&LightPath], value: fn(&LightPath) -> f64| {
            half.iter().map(|it| value(it)).sum::<f64>() / half.len() as f64
        };
        let mean = |value: fn(&LightPath) -> f64| {
            halves.iter().map(|half| mean_in(half, value)).sum::<f64>() / halves.len().max(1) as f64
        };
        let light: fn(&LightPath) -> f64 = |it| f64::from(luminance(it.radiance));
        let spread: f64 = halves
            .iter()
            .flat_map(|half| {
                half.iter().map(|it| (light(it) - mean_in(half, light)) * (light(it) - mean_in(half, light)))
            })
            .sum();
        let free = good.len() - halves.len();
        let variance = if free == 0 { 0.0 } else { spread / free as f64 };
        let throughput = mean(|it| f64::from(it.throughput.into_iter().fold(0.0, f32::max)));
        let is_near = |a: f64, b: f64| (a - b).abs() < 3e-4 * (1.0 + b.abs());
        assert_eq!(found.samples, good.len() as u64);
        assert!(is_near(found.luminance, mean(light)) && is_near(found.variance, variance), "{pixel}: {found:?}");
        assert!(is_near(found.throughput, throughput) && is_near(found.depth, mean(|it| f64::from(it.depth))));
        if let [first, others @ ..] = &good[..]
            && !others.is_empty()
        {
            let expected = others.iter().map(light).sum::<f64>() / others.len() as f64;
            let own = maps.mean_of_others(pixel, luminance(first.radiance)).unwrap();
            assert!((own - expected).abs() < 1e-4 * (1.0 + light(first)), "{pixel}: {own}, not {expected}");
        }
    }
}

#[test]
fn distances_and_weights_of_a_set_equal_their_formulas() {
    let mut draws = Draws(6);
    let table = Table::Paths.attributes();
    let all: Vec<PathBins> =
        (0..300).map(|_| std::array::from_fn(|axis| (draws.below(40) * (1 + axis % 2)).min(63) as u8)).collect();
    let coarse = |bins: &PathBins, axis: usize| match table[axis].field {
        "depth" | "end" | "first.interaction" => usize::from(bins[axis].min(9)),
        _ => usize::from(bins[axis]) * 10 / 64,
    };
    // D over the bins of each attribute, and DJ over the joint bins of each two neighbors.
    let distance = |set: &[PathBins]| {
        let share = |all: &[PathBins], fits: &dyn Fn(&PathBins) -> bool| {
            all.iter().filter(|bins| fits(bins)).count() as f64 / all.len() as f64
        };
        let (mut single, mut joint) = (0.0, 0.0);
        for axis in 0..table.len() {
            for bin in 0..10 {
                let fits = |bins: &PathBins| coarse(bins, axis) == bin;
                single += (share(&all, &fits) - share(set, &fits)).abs();
                for other in (0..10).filter(|_| axis + 1 < table.len()) {
                    let fits = |bins: &PathBins| coarse(bins, axis) == bin && coarse(bins, axis + 1) == other;
                    joint += (share(&all, &fits) - share(set, &fits)).abs();
                }
            }
        }
        [single, joint]
    };
    let target = Target::from_paths(&all);
    let found = choose_representative(&all[..120], &target, 30);
    let set: Vec<PathBins> = found.chosen.iter().map(|at| all[*at as usize]).collect();
    let expected = distance(&set);
    for own in [found.distance, Distance::between(&set, &target)] {
        assert!((own.single - expected[0]).abs() < 1e-9 && (own.joint - expected[1]).abs() < 1e-9, "{own:?}");
    }
    assert!(expected[0] < distance(&all[..30])[0], "exchanges bring the set nearer");
    // Raking takes ten rounds over the attributes. Each round scales the weights in a bin until the bin has its share of all paths.
    let mut weights = vec![1.0; set.len()];
    for axis in (0..10).flat_map(|_| 0..table.len()) {
        let before = weights.clone();
        for (bins, weight) in set.iter().zip(&mut weights) {
            let is_alike = |other: &&PathBins| coarse(other, axis) == coarse(bins, axis);
            let wanted = all.iter().filter(is_alike).count() as f64 / all.len() as f64 * set.len() as f64;
            let own: f64 = set.iter().zip(&before).filter(|it| is_alike(&it.0)).map(|it| it.1).sum();
            *weight *= wanted / own;
        }
    }
    let sum: f64 = weights.iter().sum();
    weights.iter_mut().for_each(|weight| *weight *= 30.0 / sum);
    assert!(found.weights.iter().zip(&weights).all(|(own, expected)| (own - expected).abs() < 1e-9));
    let squares: f64 = weights.iter().map(|weight| weight * weight).sum();
    assert!((found.effective_size - 900.0 / squares).abs() < 1e-9);
    // The rarest paths, by counting the paths that share a bin.
    let rarity = |at: &u32| {
        let shared = |axis: usize| all.iter().filter(|it| it[axis] == all[*at as usize][axis]).count();
        (0..table.len()).map(shared).min().unwrap()
    };
    let mut order: Vec<u32> = (0..300).collect();
    order.sort_by_key(|at| (rarity(at), *at));
    assert_eq!(rarest_paths(&all, 40), order[..40]);
}

#[test]
fn histograms_of_all_samples_equal_loops() {
    let scope = Scope { has_full_histograms: true, ..scope(400) };
    let all = merge_parts(&scope, tiles(&scope).map(|tile| task(&scope, tile, 0..samples_of(tile))));
    let keys = (0..720u32).flat_map(|pixel| {
        (0..samples_of(pixel / 36 / 8 * 5 + pixel % 36 / 8)).map(move |sample| PathKey { frame: 3, pixel, sample })
    });
    let paths: Vec<LightPath> = keys.filter(|key| !is_bad(*key)).map(|key| path(&scope, key)).collect();
    assert!(paths.len() > 4 * all.paths.len());
    let recorded = RecordedPaths::new(FrameStatistics::from_statistics([all.clone()]).unwrap());
    let request = HistogramRequest { selected: None, pairs: &[], weighting: Weighting::Image, bounds: None };
    let shown = recorded.histograms(&request, &RUNNING).unwrap();
    for table in Table::ALL {
        let (found, records) = (Histograms::attributes_of_all_samples(&all, table).unwrap(), records(&paths, table));
        for (axis, (attribute, found)) in table.attributes().iter().zip(&found).enumerate() {
            let (mut samples, mut image) = ([0u64; 64], [0.0; 64]);
            for record in &records {
                let bin = match name_of(attribute.field, *record) {
                    Some(Name(0)) => 0,
                    Some(Name(key)) => 1 + (key % 63) as usize,
                    None => usize::from(own_bin(attribute.field, [scope.lower, scope.upper], *record)),
                };
                samples[bin] += 1;
                image[bin] += image_part(record.0.key);
            }
            assert_eq!(found.samples, samples, "{}", attribute.field);
            let own: Vec<f64> = found.image.iter().map(|it| *it as f64 / 4_294_967_296.0).collect();
            let is_near = |(a, b): (&f64, &f64)| (a - b).abs() < 1e-6;
            assert!(own.iter().zip(&image).all(is_near), "{}", attribute.field);
            // Names have other bins there, but all records are counted.
            let shown = &shown.single[table as usize][axis];
            let is_name = name_of(attribute.field, records[0]).is_some();
            assert!(is_name || shown.iter().zip(&image).all(is_near), "{}", attribute.field);
            assert!((shown.iter().sum::<f64>() - image.iter().sum::<f64>()).abs() < 1e-6, "{}", attribute.field);
        }
    }
}
