//! Tests of selections of recorded paths. Expected values come from loops over the records.

use crate::synthetic::{OBJECTS, leads_through, merge_parts, path, scope, task, tasks, tiles};
use femc_paths::attribute::{ATTRIBUTE_COUNTS, intersection_bins, light_bins, path_bins};
use femc_paths::histogram::Table;
use femc_paths::octree::Root;
use femc_paths::query::{Condition, Query};
use femc_paths::record::luminance;
use femc_paths::recorded::{CountedSamples, HistogramRequest, OTHERS_BIN, PairKey, Weighting};
use femc_paths::represent::{Target, choose_representative_within};
use femc_paths::schema::FINE_BINS;
use femc_paths::selection::{BitMask, CancelCheck, Cancelled, SelectedRecords};
use femc_paths::{
    FrameStatistics, InteractionKind, Intersection, LightPath, LightRecord, LightStatistics, LightTechnique, Name,
    NameKind, PathEnd, PathKey, RecordedPaths, Scope,
};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

static RUNNING: AtomicBool = AtomicBool::new(false);

fn frame(number: u32, keep: u32) -> LightStatistics {
    let scope = Scope { frame: number, ..scope(keep) };
    merge_parts(&scope, tiles(&scope).map(|tile| task(&scope, tile, 0..6)))
}

/// Returns the records of three frames of one film.
fn recorded() -> RecordedPaths {
    RecordedPaths::new(FrameStatistics::from_statistics([3, 4, 9].map(|number| frame(number, 3000))).unwrap())
}

fn query(text: &str) -> Query {
    Query { condition: Some(Condition::parse(text).unwrap_or_else(|e| panic!("{text}: {e}"))), ..Query::default() }
}

fn select(all: &RecordedPaths, text: &str) -> SelectedRecords {
    all.select(&query(text), &RUNNING).unwrap()
}

fn object(text: &str) -> Name {
    Name::new(NameKind::Object, text)
}

fn lamp(text: &str) -> Name {
    Name::new(NameKind::Lamp, text)
}

fn in_room(name: Name) -> bool {
    [object("room.floor"), object("room.wall")].contains(&name)
}

/// A path with an intersection and a light of it. A condition on one of them is a function of this.
struct Item<'a> {
    path: &'a LightPath,
    at: Option<&'a Intersection>,
    light: Option<&'a LightRecord>,
}

impl Item<'_> {
    /// Checks whether some light in question fulfills a condition: this light, or else all lights of the intersection.
    fn some_light(&self, holds: impl Fn(&LightRecord) -> bool) -> bool {
        if let Some(light) = self.light {
            return holds(light);
        }
        let vertex = self.at.map_or(0, |at| 1 + self.path.intersections.iter().position(|it| it == at).unwrap() as u32);
        self.path.lights.iter().any(|light| light.vertex == vertex && holds(light))
    }

    fn some_at(&self, holds: impl Fn(&Intersection) -> bool) -> bool {
        self.at.is_some_and(holds)
    }
}

/// Evaluates a condition without quantifiers by loops. It selects all lights of its paths.
fn select_by_loops(all: &RecordedPaths, holds: impl Fn(&Item<'_>) -> bool) -> SelectedRecords {
    let [paths, intersections, lights] = all.totals().map(BitMask::new);
    let mut found = SelectedRecords { paths, intersections, lights };
    let (mut intersection, mut light) = (0, 0);
    for (number, path) in (0u32..).zip(all.paths()) {
        let mut places: Vec<Option<&Intersection>> = path.intersections.iter().map(Some).collect();
        if places.is_empty() {
            places.push(None);
        }
        let is_selected = places.iter().any(|at| holds(&Item { path, at: *at, light: None }));
        if is_selected {
            found.paths.insert(number);
        }
        for at in &path.intersections {
            if is_selected && holds(&Item { path, at: Some(at), light: None }) {
                found.intersections.insert(intersection);
            }
            intersection += 1;
        }
        for _ in &path.lights {
            if is_selected {
                found.lights.insert(light);
            }
            light += 1;
        }
    }
    found
}

type Holds = fn(&Item<'_>) -> bool;

/// Conditions on the path, the intersection and its lights, and equivalent functions.
const PLAIN: [(&str, Holds); 13] = [
    ("bounce == 2", |it| it.some_at(|at| at.bounce == 2)),
    ("radiance.g > 12 and interaction == reflection", |it| {
        it.some_at(|at| at.radiance[1] > 12.0 && at.interaction == InteractionKind::Reflection)
    }),
    ("object == room or material == metal", |it| {
        it.some_at(|at| in_room(at.object) || at.material == Name::new(NameKind::Material, "metal"))
    }),
    ("not object == plant", |it| !it.some_at(|at| at.object == object("plant"))),
    ("in box(-1,0,0,1.5,2,1.5)", |it| {
        it.some_at(|at| {
            let [x, y, z] = at.position;
            (-1.0..=1.5).contains(&x) && (0.0..=2.0).contains(&y) && (0.0..=1.5).contains(&z)
        })
    }),
    ("in lasso(4,2,20,2,20,15,4,15)", |it| {
        let (x, y) = (it.path.key.pixel % 36, it.path.key.pixel / 36);
        (4..20).contains(&x) && (2..15).contains(&y)
    }),
    ("depth >= 3 and end == roulette", |it| it.path.depth >= 3 && it.path.end == PathEnd::Roulette),
    ("occluder == room", |it| it.some_light(|light| light.occluder.is_some_and(in_room))),
    ("light == \"lamp a\" and light.radiance.r > 0.5", |it| {
        it.some_light(|light| light.light == lamp("lamp a")) && it.some_light(|light| light.radiance[0] > 0.5)
    }),
    ("found == surface", |it| it.some_light(|light| light.technique == LightTechnique::NextEvent)),
    ("first.object == lamp and last.y > 1.5", |it| {
        let [first, last] = [it.path.intersections.first(), it.path.intersections.last()];
        first.is_some_and(|it| it.object == object("lamp")) && last.is_some_and(|it| it.position[1] > 1.5)
    }),
    ("path.radiance.b > 10 and brightest.light == \"lamp b\"", |it| {
        let brightest = it.path.lights.iter().map(|light| luminance(light.radiance)).fold(0.0, f32::max);
        let mut lights = it.path.lights.iter().rev();
        it.path.radiance[2] > 10.0
            && lights.find(|light| luminance(light.radiance) == brightest).is_some_and(|it| it.light == lamp("lamp b"))
    }),
    ("room.wall then plant", |it| {
        let on = |name: &'static str| {
            let all = it.path.intersections.iter().enumerate();
            all.filter(move |(_, it)| it.object == object(name)).map(|(index, _)| index)
        };
        on("plant").any(|plant| on("room.wall").any(|wall| leads_through(it.path, plant, wall)))
    }),
];

#[test]
fn masks_equal_those_of_loops() {
    let all = recorded();
    for (text, holds) in PLAIN {
        let found = select(&all, text);
        let expected = select_by_loops(&all, holds);
        assert_eq!(found.counts(), expected.counts(), "{text}");
        assert!(found == expected, "{text}");
        let [paths, _, _] = found.counts();
        assert!(paths > 10 && paths < all.totals()[0], "{text}: {paths} paths");
    }
}

#[test]
fn lights_in_any_order_belong_to_their_vertices() {
    let mut statistics = frame(3, 3000);
    for path in statistics.paths.values_mut() {
        path.lights = path.lights.repeat(5);
        path.lights.reverse();
    }
    let all = RecordedPaths::new(FrameStatistics::from_statistics([statistics]).unwrap());
    for (text, holds) in PLAIN.iter().filter(|(text, _)| ["occ", "lig", "fou"].contains(&&text[..3])) {
        assert!(select(&all, text) == select_by_loops(&all, holds), "{text}");
    }
    // An intersection alone has the lights sampled there.
    let found = select(&all, "light(light.radiance.g > 1)");
    let expected = select_by_loops(&all, |it| it.some_light(|light| light.radiance[1] > 1.0));
    assert!(expected.counts()[1] > 10 && found.intersections == expected.intersections);
}

#[test]
fn quantities_select_paths_as_a_whole() {
    let all = recorded();
    // Conditions on a path, and the paths that they select.
    type IsSelected = fn(&LightPath) -> bool;
    let conditions: [(&str, IsSelected); 4] = [
        ("any(object == plant) and any(interaction == volume)", |path| {
            path.intersections.iter().any(|it| it.object == object("plant"))
                && path.intersections.iter().any(|it| it.interaction == InteractionKind::Volume)
        }),
        ("all(radiance.r < 20)", |path| {
            !path.intersections.is_empty() && path.intersections.iter().all(|it| it.radiance[0] < 20.0)
        }),
        ("light(light == \"lamp a\" and light.radiance.g > 1)", |path| {
            path.lights.iter().any(|light| light.light == lamp("lamp a") && light.radiance[1] > 1.0)
        }),
        ("lights(not occluder == room) and depth > 0", |path| {
            path.depth > 0 && path.lights.iter().all(|light| !light.occluder.is_some_and(in_room))
        }),
    ];
    for (text, is_selected) in conditions {
        let found = select(&all, text);
        let expected: Vec<u32> =
            (0u32..).zip(all.paths()).filter(|(_, path)| is_selected(path)).map(|(number, _)| number).collect();
        assert!(found.paths.numbers().eq(expected.iter().copied()), "{text}");
        assert!(expected.len() > 10 && expected.len() < all.paths().len(), "{text}: {}", expected.len());
    }
    // Of a selected path, the intersections and lights that fulfill the inner condition alone.
    let found = select(&all, "light(light.radiance.g > 1)");
    let bright: Vec<u32> = {
        let lights = all.paths().iter().flat_map(|path| &path.lights);
        (0..).zip(lights).filter(|(_, light)| light.radiance[1] > 1.0).map(|(number, _)| number).collect()
    };
    assert!(found.lights.numbers().eq(bright));
}

#[test]
fn everything_and_nothing_have_all_and_no_records() {
    let all = recorded();
    let everything = all.select(&Query::default(), &RUNNING).unwrap();
    let records = |items: fn(&LightPath) -> usize| all.paths().iter().map(items).sum::<usize>() as u32;
    let totals = [all.paths().len() as u32, records(|it| it.intersections.len()), records(|it| it.lights.len())];
    assert_eq!((everything.counts(), all.totals()), (totals, totals));
    assert_eq!(all.light_share(&everything.paths), Some(1.0));
    assert_eq!(everything, select(&all, "sample >= 0"));
    let nothing = select(&all, "depth < 0");
    assert_eq!((nothing.counts(), all.light_share(&nothing.paths)), ([0; 3], Some(0.0)));
    let samples: u64 = all.frames().iter().map(|frame| frame.samples).sum();
    let estimate = all.estimate_samples(totals[0]);
    // The recorded paths are a subset drawn by hashes.
    let deviation = 4.0 * (f64::from(totals[0]) * (1.0 - all.share())).sqrt() / all.share();
    assert!((estimate - samples as f64).abs() < deviation && all.share() < 0.5, "{estimate} of {samples}");
}

#[test]
fn negation_complements_what_is_asked_of_paths() {
    let all = recorded();
    for text in
        ["depth > 2", "first.object == plant", "room.wall then plant", "any(bounce == 3)", "in lasso(0,0,9,0,9,20)"]
    {
        let (own, other) = (select(&all, text), select(&all, &format!("not ({text})")));
        for number in 0..all.totals()[0] {
            assert!(own.paths.contains(number) != other.paths.contains(number), "{text}: path {number}");
        }
        let shares = [&own, &other].map(|it| all.light_share(&it.paths).unwrap());
        assert!((shares[0] + shares[1] - 1.0).abs() < 1e-12 && shares[0] < 1.0, "{text}: {shares:?}");
    }
    // A path may have intersections of both kinds, but an intersection is of one kind.
    let (own, other) = (select(&all, "bounce == 1"), select(&all, "not bounce == 1"));
    assert!((0..all.totals()[1]).all(|at| !(own.intersections.contains(at) && other.intersections.contains(at))));
    assert!(own.paths.numbers().any(|number| other.paths.contains(number)));
}

#[test]
fn conditions_on_paths_intersect_and_unite() {
    let all = recorded();
    let terms =
        ["any(object == plant)", "all(radiance.g < 15)", "light(light.radiance.r > 1)", "pixel.x < 20", "end == depth"];
    for (index, a) in terms.iter().enumerate() {
        for b in &terms[index + 1..] {
            let [own, other] = [a, b].map(|text| select(&all, text));
            let both = select(&all, &format!("{a} and {b}"));
            let either = select(&all, &format!("{a} or {b}"));
            for number in 0..all.totals()[0] {
                let found = [&own, &other, &both, &either].map(|it| it.paths.contains(number));
                assert_eq!(found[2..], [found[0] && found[1], found[0] || found[1]], "{a}, {b}: path {number}");
            }
        }
    }
}

#[test]
fn densities_add_up_and_are_parts_of_pixels() {
    let all = recorded();
    let selected = select(&all, "depth > 1");
    let pixels = all.density(&selected.paths).unwrap();
    assert_eq!(pixels.iter().map(|it| it.count).sum::<u32>(), selected.counts()[0]);
    assert!(pixels.is_sorted_by(|a, b| a.pixel < b.pixel));
    // All portions have 3 samples a half, so each sample is a sixth of its pixel.
    let mut expected = vec![0.0; 36 * 20];
    for path in all.paths().iter().filter(|path| path.depth > 1) {
        expected[path.key.pixel as usize] += f64::from(path.luminance()) / 6.0 / 3.0;
    }
    for it in &pixels {
        let own = std::mem::take(&mut expected[it.pixel as usize]);
        assert!((it.contribution - own).abs() <= 1e-6 * own, "{it:?}, expected {own}");
        let of_pixel = all.paths().iter().filter(|path| path.depth > 1 && path.key.pixel == it.pixel);
        let mean = of_pixel.map(|path| f64::from(path.luminance())).sum::<f64>() / f64::from(it.count);
        assert!((it.mean_luminance - mean).abs() <= 1e-6 * mean, "{it:?}, expected {mean}");
    }
    assert!(expected.iter().all(|rest| *rest == 0.0), "pixels are missing");
    let light = |paths: &BitMask| all.density(paths).unwrap().iter().map(|it| it.contribution).sum::<f64>();
    let everything = all.select(&Query::default(), &RUNNING).unwrap();
    let share = light(&selected.paths) / light(&everything.paths);
    assert!((all.light_share(&selected.paths).unwrap() - share).abs() < 1e-12);
}

#[test]
fn frames_of_different_films_have_no_common_density() {
    let mut wide = Scope { frame: 5, film: [40, 20], ..scope(3000) };
    wide.max_records = 3000;
    let wide = merge_parts(&wide, tiles(&wide).map(|tile| task(&wide, tile, 0..2)));
    let all = RecordedPaths::new(FrameStatistics::from_statistics([frame(3, 3000), wide]).unwrap());
    let selected = select(&all, "pixel.x >= 36");
    assert!(selected.counts()[0] > 0, "pixel numbers refer to the film of each frame");
    let error = all.density(&selected.paths).unwrap_err().to_string();
    assert_eq!(error, "frame 3 has a film of 36 x 20 pixels, but frame 5 has 40 x 20; choose frames with one film");
}

#[test]
fn histograms_of_selections_add_up_and_equal_loops() {
    let all = recorded();
    let pairs = [(Table::Paths, 8, 14), (Table::Paths, 3, 2), (Table::Intersections, 7, 1), (Table::Lights, 3, 5)]
        .map(|(table, row, column)| PairKey { table, row, column });
    for text in [None, Some("object == plant and bounce < 3"), Some("depth < 0")] {
        let selected = text.map(|text| select(&all, text));
        for weighting in [Weighting::Samples, Weighting::Image] {
            let request = HistogramRequest { selected: selected.as_ref(), pairs: &pairs, weighting, bounds: None };
            let found = all.histograms(&request, &RUNNING).unwrap();
            assert_eq!(found.counted, CountedSamples::Recorded);
            let unit = if weighting == Weighting::Samples { 1.0 } else { 1.0 / 6.0 };
            let counts = selected.as_ref().map_or(all.totals(), SelectedRecords::counts);
            let is_near = |a: f64, b: f64| (a - b).abs() <= 1e-6 * b.abs();
            for (table, count) in Table::ALL.into_iter().zip(counts) {
                for counts in &found.single[table as usize] {
                    assert!(is_near(counts.iter().sum(), unit * f64::from(count)), "{text:?}, {table:?}");
                }
            }
            for (pair, joint) in pairs.iter().zip(&found.pairs) {
                let (rows, _) = joint.as_chunks::<FINE_BINS>();
                for bin in 0..FINE_BINS {
                    let row: f64 = rows[bin].iter().map(|it| f64::from(*it)).sum();
                    let column: f64 = rows.iter().map(|row| f64::from(row[bin])).sum();
                    let single = &found.single[pair.table as usize];
                    assert!(is_near(row, single[pair.row][bin]), "{pair:?}, row {bin}");
                    assert!(is_near(column, single[pair.column][bin]), "{pair:?}, column {bin}");
                }
            }
        }
    }
    let selected = select(&all, "radiance.r > 10");
    let request =
        HistogramRequest { selected: Some(&selected), pairs: &[], weighting: Weighting::Samples, bounds: None };
    let found = all.histograms(&request, &RUNNING).unwrap();
    // Depths of paths, and bounces of intersections.
    let (mut depths, mut bounces) = ([0.0; FINE_BINS], [0.0; FINE_BINS]);
    for path in all.paths() {
        let bright: Vec<&Intersection> = path.intersections.iter().filter(|it| it.radiance[0] > 10.0).collect();
        depths[path.depth as usize] += if bright.is_empty() { 0.0 } else { 1.0 };
        bright.iter().for_each(|it| bounces[it.bounce as usize] += 1.0);
    }
    assert_eq!((found.single[0][8], found.single[1][0]), (depths, bounces));
}

#[test]
fn bins_are_those_of_the_schema_except_for_names() {
    let all = recorded();
    for bounds in [None, Some([[-2.0, 0.5, 0.0], [2.0, 1.0, 5.0]])] {
        let request = HistogramRequest { selected: None, pairs: &[], weighting: Weighting::Samples, bounds };
        let found = all.histograms(&request, &RUNNING).unwrap();
        let mut expected = ATTRIBUTE_COUNTS.map(|axes| vec![[0.0; FINE_BINS]; axes]);
        for path in all.paths() {
            let [lower, upper] = bounds.unwrap_or(all.bounds());
            let scope = Scope { lower, upper, ..scope(1) };
            let mut add = |table: Table, bins: &[u8]| {
                let counts = expected[table as usize].iter_mut().zip(bins);
                counts.for_each(|(counts, bin)| counts[usize::from(*bin)] += 1.0);
            };
            add(Table::Paths, &path_bins(&scope, path));
            path.intersections.iter().for_each(|it| add(Table::Intersections, &intersection_bins(&scope, it)));
            path.lights.iter().for_each(|it| add(Table::Lights, &light_bins(&scope, it)));
        }
        for table in Table::ALL {
            for (axis, attribute) in table.attributes().iter().enumerate() {
                let is_name = all.categories().iter().any(|it| it.table == table && it.attribute == axis);
                let (own, expected) = (found.single[table as usize][axis], expected[table as usize][axis]);
                assert!(is_name || own == expected, "{} of {table:?}, {bounds:?}", attribute.name);
            }
        }
    }
}

#[test]
fn categories_are_the_names_by_falling_number_of_records() {
    let all = recorded();
    let request = HistogramRequest { selected: None, pairs: &[], weighting: Weighting::Samples, bounds: None };
    let found = all.histograms(&request, &RUNNING).unwrap();
    let mut axes: Vec<(&str, &str)> = Vec::new();
    for it in all.categories() {
        axes.push((it.table.name(), it.table.attributes()[it.attribute].name));
        let counts = found.single[it.table as usize][it.attribute];
        let own = &counts[1..=it.names.len()];
        assert!(!own.is_empty() && own.is_sorted_by(|a, b| a >= b) && own.iter().all(|count| *count > 0.0));
        assert!(counts[it.names.len() + 1..].iter().all(|count| *count == 0.0), "few names leave no others");
    }
    assert_eq!(
        axes,
        [
            ("paths", "first.object"),
            ("paths", "light"),
            ("intersections", "object"),
            ("intersections", "material"),
            ("lights", "light"),
            ("lights", "occluder"),
        ]
    );
    let objects = &all.categories()[2];
    let counts = found.single[1][7];
    for (bin, index) in (1..).zip(&objects.names) {
        let (kind, text) = &all.names().entries()[*index as usize];
        let expected = all.paths().iter().flat_map(|path| &path.intersections);
        let expected = expected.filter(|it| it.object == Name::new(*kind, text)).count();
        assert_eq!(counts[bin], expected as f64, "{text}");
    }
    let nameless = all.paths().iter().flat_map(|path| &path.intersections).filter(|it| it.object == Name::NONE);
    assert_eq!(counts[0], nameless.count() as f64);
    assert_eq!(objects.names.len(), OBJECTS.len() - 1);
}

#[test]
fn rare_names_share_the_last_bin() {
    let mut statistics = frame(3, 3000);
    // Path k hits object k mod 100 first, and the first 50 objects twice as often.
    let texts: Vec<String> = (0..100).map(|number| format!("thing{number:03}")).collect();
    for text in &texts {
        statistics.names.insert(object(text), (NameKind::Object, text.clone()));
    }
    let mut next = 0;
    let mut counts = [0u64; 100];
    for path in statistics.paths.values_mut() {
        if let Some(first) = path.intersections.first_mut() {
            let place = if next % 150 < 100 { next % 150 } else { next % 150 - 100 };
            first.object = object(&texts[place]);
            counts[place] += 1;
            next += 1;
        }
    }
    assert!(next > 300);
    let all = RecordedPaths::new(FrameStatistics::from_statistics([statistics]).unwrap());
    let request = HistogramRequest { selected: None, pairs: &[], weighting: Weighting::Samples, bounds: None };
    let found = all.histograms(&request, &RUNNING).unwrap().single[0][14];
    let categories = &all.categories()[0];
    let mut ranked: Vec<(u64, &str)> = counts.into_iter().zip(texts.iter().map(String::as_str)).collect();
    ranked.sort_by(|a, b| b.0.cmp(&a.0).then(a.1.cmp(b.1)));
    let chosen: Vec<&str> =
        categories.names.iter().map(|index| all.names().entries()[*index as usize].1.as_str()).collect();
    assert_eq!(chosen, ranked[..62].iter().map(|(_, text)| *text).collect::<Vec<_>>());
    let others: u64 = ranked[62..].iter().map(|(count, _)| count).sum();
    assert_eq!(found[usize::from(OTHERS_BIN)], others as f64);
    assert!((0..62).all(|place| found[place + 1] == ranked[place].0 as f64));
}

#[test]
fn full_histograms_count_all_samples() {
    let scope = Scope { has_full_histograms: true, ..scope(300) };
    let statistics = merge_parts(&scope, tiles(&scope).map(|tile| task(&scope, tile, 0..6)));
    let good = statistics.samples() - statistics.totals().invalid;
    let all = RecordedPaths::new(FrameStatistics::from_statistics([statistics]).unwrap());
    assert!(all.has_full_histograms() && all.totals()[0] <= 300);
    let pairs = [PairKey { table: Table::Paths, row: 8, column: 9 }];
    let ask = |selected: Option<&SelectedRecords>, bounds| {
        let request = HistogramRequest { selected, pairs: &pairs, weighting: Weighting::Samples, bounds };
        all.histograms(&request, &RUNNING).unwrap()
    };
    let found = ask(None, None);
    assert_eq!(found.counted, CountedSamples::All);
    // The synthetic renderer again, sample by sample. It has fewer names than bins, so each has a bin of its own.
    let (mut depths, mut objects) = ([0.0; FINE_BINS], [0.0; FINE_BINS]);
    for pixel in 0..36 * 20 {
        for sample in 0..6 {
            let key = PathKey { frame: 3, pixel, sample };
            if crate::synthetic::is_bad(key) {
                continue;
            }
            let path = path(&scope, key);
            depths[path.depth as usize] += 1.0;
            for it in &path.intersections {
                let bin = (1..).zip(&all.categories()[2].names).find(|(_, index)| {
                    let (kind, text) = &all.names().entries()[**index as usize];
                    Name::new(*kind, text) == it.object
                });
                objects[bin.map_or(0, |(bin, _)| bin)] += 1.0;
            }
        }
    }
    assert_eq!(found.single[0][8], depths);
    assert_eq!(depths.iter().sum::<f64>(), good as f64);
    assert_eq!(found.single[1][7], objects);
    assert_eq!(found.pairs[0].iter().sum::<f32>(), all.totals()[0] as f32);
    for (selected, bounds) in [(Some(select(&all, "depth >= 0")), None), (None, Some([[0.0; 3], [1.0; 3]]))] {
        let found = ask(selected.as_ref(), bounds);
        assert_eq!(found.counted, CountedSamples::Recorded);
        assert_eq!(found.single[0][8].iter().sum::<f64>(), f64::from(all.totals()[0]));
    }
}

#[test]
fn representatives_of_a_selection_are_selected() {
    let all = recorded();
    let selected = select(&all, "depth > 1 and pixel.x < 18");
    let [count, ..] = selected.counts();
    let found = all.choose_representatives(Some(&selected.paths), None, 40, &RUNNING).unwrap();
    assert_eq!((found.numbers.len(), found.weights.len(), found.represented), (40, 40, count as usize));
    assert!(found.numbers.is_sorted_by(|a, b| a < b));
    assert!(found.numbers.iter().all(|number| selected.paths.contains(*number)));
    assert!((found.weights.iter().sum::<f64>() - 40.0).abs() < 1e-6);
    // Candidates are those with the smallest hashes.
    let hash = |number: u32| all.paths()[number as usize].key.hash(crate::synthetic::SEED);
    let mut hashes: Vec<u64> = selected.paths.numbers().map(hash).collect();
    hashes.sort_unstable();
    assert!(hashes.len() > 320);
    assert!(found.numbers.iter().all(|number| hash(*number) <= hashes[319]));
    let few = select(&all, "depth == 5 and pixel.x < 4");
    let found = all.choose_representatives(Some(&few.paths), None, 500, &RUNNING).unwrap();
    assert!(!found.numbers.is_empty() && found.numbers.iter().copied().eq(few.paths.numbers()));
    assert!(found.distance.single < 1e-12);
    let nothing = all.choose_representatives(Some(&select(&all, "depth < 0").paths), None, 500, &RUNNING).unwrap();
    assert_eq!((nothing.numbers.len(), nothing.represented), (0, 0));
}

#[test]
fn voxels_count_the_selected_intersections() {
    let all = recorded();
    let [lower, upper] = all.bounds();
    let selected = select(&all, "object == plant");
    for (selected, level, bounce) in [(None, 0, None), (None, 3, Some(1)), (Some(&selected), 5, None)] {
        let voxels = all.voxels(Root::around(lower, upper, level), selected, bounce, &RUNNING).unwrap();
        let (mut count, mut energy) = (0, 0.0);
        for it in all.paths().iter().flat_map(|path| &path.intersections) {
            let is_wanted =
                bounce.is_none_or(|bounce| it.bounce == bounce) && (selected.is_none() || it.object == object("plant"));
            if is_wanted {
                count += 1;
                energy += it.radiance.iter().map(|it| f64::from(*it)).sum::<f64>() / 3.0;
            }
        }
        assert!(voxels.is_sorted_by(|(a, _), (b, _)| a < b));
        assert_eq!(voxels.iter().map(|(_, voxel)| voxel.count).sum::<u64>(), count);
        let sum: f64 = voxels.iter().map(|(_, voxel)| voxel.energy.value()).sum();
        assert!(count > 100 && (sum - energy).abs() < 1e-6 * energy);
        assert!(voxels.len() > 1 || level == 0);
    }
}

#[test]
fn records_do_not_depend_on_order_and_division() {
    let scope = scope(900);
    let whole = merge_parts(&scope, tasks(&scope));
    let mut parts = tasks(&scope);
    parts.reverse();
    let later = parts.split_off(parts.len() / 3);
    let [a, b] = [parts, later].map(|parts| merge_parts(&scope, parts));
    let one = RecordedPaths::new(FrameStatistics::from_statistics([whole, frame(4, 900)]).unwrap());
    let other = RecordedPaths::new(FrameStatistics::from_statistics([frame(4, 900), b, a]).unwrap());
    assert_eq!((one.paths(), one.image_weights()), (other.paths(), other.image_weights()));
    assert_eq!(one.brightest(), other.brightest());
    assert!(!one.brightest().is_empty() && one.frame_of(one.totals()[0] - 1) == 1 && one.frame_of(0) == 0);
    let request = HistogramRequest {
        selected: None,
        pairs: &[PairKey { table: Table::Lights, row: 4, column: 0 }],
        weighting: Weighting::Image,
        bounds: None,
    };
    assert_eq!(one.histograms(&request, &RUNNING), other.histograms(&request, &RUNNING));
    assert_eq!(
        one.choose_representatives(None, None, 50, &RUNNING).unwrap(),
        other.choose_representatives(None, None, 50, &RUNNING).unwrap()
    );
}

#[test]
fn a_cancelled_question_ends_without_an_answer() {
    let all = recorded();
    let cancelled = AtomicBool::new(true);
    assert_eq!(all.select(&query("depth > 1"), &cancelled), Err(Cancelled));
    let request = HistogramRequest { selected: None, pairs: &[], weighting: Weighting::Samples, bounds: None };
    assert_eq!(all.histograms(&request, &cancelled), Err(Cancelled));
    assert!(all.voxels(Root::around([0.0; 3], [1.0; 3], 2), None, None, &cancelled).is_err());
    assert_eq!(all.choose_representatives(None, None, 50, &cancelled), Err(Cancelled));
}

#[test]
fn the_cancel_flag_is_read_after_a_fixed_amount_of_work() {
    let is_cancelled = AtomicBool::new(false);
    let looks_after = |work: usize| {
        is_cancelled.store(false, Ordering::Relaxed);
        let mut check = CancelCheck::new(&is_cancelled);
        check.add(work).unwrap();
        is_cancelled.store(true, Ordering::Relaxed);
        (1..).find(|_| check.add(work).is_err()).unwrap()
    };
    assert_eq!([1, 1 << 10, 1 << 20].map(looks_after), [1 << 16, 1 << 6, 1]);
    let all = recorded();
    let candidates: Vec<_> = all.paths().iter().map(|path| path_bins(&scope(1), path)).collect();
    let target = Target::from_paths(&candidates);
    let mut check = CancelCheck::new(&is_cancelled);
    is_cancelled.store(false, Ordering::Relaxed);
    check.look().unwrap();
    is_cancelled.store(true, Ordering::Relaxed);
    let found = choose_representative_within(&candidates, &target, 1000, &mut check);
    assert_eq!(found, Err(Cancelled), "exchanges are work");
}

/// Prints times for 80,000 paths with about 5 intersections and 5 lights each. Run it with
/// `cargo test --release -p femc-paths --test suite -- --ignored --nocapture times`.
#[test]
#[ignore = "measures time"]
fn times_of_questions() {
    let scope = Scope { max_records: 80_000, film: [360, 200], ..scope(80_000) };
    let parts = tiles(&scope).map(|tile| task(&scope, tile, 0..6));
    let statistics = merge_parts(&scope, parts);
    // Only paths with an intersection, twice as long.
    let mut longer = statistics.clone();
    for path in longer.paths.values_mut() {
        let intersections = path.intersections.clone();
        path.intersections.extend(intersections);
        path.lights = path.lights.iter().flat_map(|light| [*light; 2]).collect();
        path.depth *= 2;
    }
    let start = Instant::now();
    let all = RecordedPaths::new(FrameStatistics::from_statistics([longer]).unwrap());
    println!("{:?}: collected in {:?}, {} MB", all.totals(), start.elapsed(), all.memory_bytes() / 1_000_000);
    let time = |name: &str, act: &dyn Fn() -> String| {
        let times: Vec<_> = (0..25)
            .map(|_| {
                let start = Instant::now();
                (start.elapsed(), act(), start.elapsed())
            })
            .collect();
        let mut elapsed: Vec<_> = times.iter().map(|(begin, _, end)| *end - *begin).collect();
        elapsed.sort_unstable();
        println!("{name}: median {:?}, least {:?}, {}", elapsed[12], elapsed[0], times[0].1);
    };
    let conditions = [
        "depth > 3",
        "radiance.g > 2 and bounce == 2 and (interaction == reflection or object == room.wall)",
        "object == room and light(occluder == plant and light.radiance.g > 0)",
        "any(object == plant) and all(radiance.r < 25) and pixel.x > 20",
        "in lasso(40,20,200,20,200,150,40,150) and in box(-1,0,0,1.5,2,1.5)",
        "room.wall then plant then lamp",
        "brightest.light == \"lamp a\" and path.radiance.g > 0.5 and path.radiance.g < 50",
    ];
    for text in conditions {
        time(text, &|| format!("{:?}", select(&all, text).counts()));
    }
    let selected = select(&all, "depth > 3");
    time("density", &|| format!("{}", all.density(&selected.paths).unwrap().len()));
    time("light share", &|| format!("{:?}", all.light_share(&selected.paths)));
    let pairs: Vec<PairKey> = (0..19).map(|row| PairKey { table: Table::Paths, row, column: row + 1 }).collect();
    for (name, selected, bounds) in [
        ("histograms of all, 19 pairs", None, None),
        ("histograms of a selection, 19 pairs", Some(&selected), None),
        ("histograms in another box, 19 pairs", None, Some([[0.0; 3], [1.0; 3]])),
    ] {
        let request = HistogramRequest { selected, pairs: &pairs, weighting: Weighting::Samples, bounds };
        time(name, &|| format!("{:?}", all.histograms(&request, &RUNNING).unwrap().counted));
    }
    time("5000 representatives", &|| {
        format!("{:?}", all.choose_representatives(None, None, 5000, &RUNNING).unwrap().distance)
    });
    time("5000 representatives of a selection", &|| {
        format!("{:?}", all.choose_representatives(Some(&selected.paths), None, 5000, &RUNNING).unwrap().distance)
    });
    let [lower, upper] = all.bounds();
    time("voxels of level 6", &|| {
        format!("{}", all.voxels(Root::around(lower, upper, 6), None, None, &RUNNING).unwrap().len())
    });
}
