//! Tests of the answers about recorded light, on few paths that are a function of their keys.

mod growth;

use super::open_light;
use femc_paths::attribute::ATTRIBUTE_COUNTS;
use femc_paths::{
    FrameStatistics, InteractionKind, Intersection, LightPath, LightRecord, LightStatistics, LightTechnique, Name,
    NameKind, PathEnd, PathKey, PortionKey, SampleCounters, Scope,
};
use femc_service::{
    AxisPairs, EarlierRows, LightAnswer, LightCall, LightCallKind, LightData, LightError, LightSource, PathCount,
    VoxelLevel,
};
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

const OBJECTS: [&str; 3] = ["room.wall", "plant", "lamp"];
/// Samples of each pixel.
const SAMPLES: u32 = 16;

fn scope(frame: u32) -> Scope {
    Scope {
        seed: 5,
        frame,
        film: [12, 8],
        tile_size: 8,
        lower: [0.0; 3],
        upper: [4.0, 2.0, 1.0],
        max_records: 700,
        sketch_size: 2,
        has_full_histograms: false,
    }
}

/// Returns the path of a sample. Its intersections are on the grid of positions.
fn path(key: PathKey) -> LightPath {
    let draw = |number: u32| (key.hash(1) >> (8 * number) & 255) as u32;
    let depth = draw(0) % 5;
    let lamp = Name::new(NameKind::Lamp, if draw(1) % 3 == 0 { "window" } else { "lamp" });
    let lights: Vec<LightRecord> = (0..=depth)
        .map(|vertex| LightRecord {
            vertex,
            order: vertex,
            light: lamp,
            medium: Name::NONE,
            radiance: if draw(vertex + 1) < 100 { [0.0; 3] } else { [draw(vertex) as f32, 2.0, 1.0] },
            occluder: (draw(vertex + 1) < 100).then(|| Name::new(NameKind::Object, "plant")),
            technique: if vertex == 0 { LightTechnique::CameraNextEvent } else { LightTechnique::NextEvent },
        })
        .collect();
    let radiance = lights.iter().fold([0.0; 3], |sum: [f32; 3], light| {
        [sum[0] + light.radiance[0], sum[1] + light.radiance[1], sum[2] + light.radiance[2]]
    });
    let intersection = |bounce: u32| Intersection {
        parent: bounce,
        bounce,
        position: [f64::from(draw(bounce)) / 64.0, f64::from(draw(2)) / 128.0, 0.5],
        radiance: [f32::from(bounce as u8), 1.0, draw(3) as f32],
        throughput: [0.5; 3],
        object: Name::new(NameKind::Object, OBJECTS[(draw(bounce + 2) % 3) as usize]),
        material: Name::new(NameKind::Material, "paint"),
        interaction: if bounce + 1 == depth { InteractionKind::Absorbed } else { InteractionKind::Diffuse },
    };
    let end = if depth == 0 { PathEnd::Escaped } else { PathEnd::Absorbed };
    let intersections = (0..depth).map(intersection).collect();
    LightPath { key, radiance, throughput: [0.25; 3], depth, end, intersections, lights }
}

/// Returns the statistics of some samples of a tile.
fn part(scope: &Scope, tile: u32, samples: std::ops::Range<u32>) -> LightStatistics {
    let mut statistics = LightStatistics::new(*scope, 0.75);
    let texts = [(NameKind::Lamp, "window"), (NameKind::Lamp, "lamp"), (NameKind::Material, "paint")];
    for (kind, text) in OBJECTS.map(|text| (NameKind::Object, text)).into_iter().chain(texts) {
        statistics.names.insert(Name::new(kind, text), (kind, text.to_owned()));
    }
    for half in 0..2 {
        let mut counters = SampleCounters::with_pixels(scope.tile_area(tile) as usize);
        for (at, pixel) in scope.tile_pixels(tile).enumerate() {
            for sample in samples.clone().filter(|sample| sample % 2 == half) {
                let path = path(PathKey { frame: scope.frame, pixel, sample });
                counters.count(path.luminance(), path.depth, path.end);
                counters.pixels[at].count(path.luminance(), 0.25, path.depth);
                if scope.has_full_histograms {
                    counters.count_bins(scope, &path);
                }
                let order = (path.key.hash(scope.seed), path.key);
                if statistics.must_record(path.key) {
                    statistics.paths.insert(order, path.clone());
                }
                statistics.brightest.insert(order, path);
            }
        }
        let key = PortionKey { tile, half: half as u8, begin: samples.start, end: samples.end };
        statistics.portions.insert(key, counters);
    }
    statistics.trim();
    statistics
}

fn parts(scope: &Scope) -> Vec<LightStatistics> {
    (0..2).flat_map(|tile| [0..4, 4..SAMPLES].map(|samples| part(scope, tile, samples))).collect()
}

fn frame(scope: &Scope) -> LightStatistics {
    let mut parts = parts(scope).into_iter();
    let mut all = parts.next().unwrap();
    all.merge_all(parts).unwrap();
    all
}

fn source(name: &str, parts: &[LightStatistics]) -> LightSource {
    let parts = parts.iter().map(|it| it.encode().into()).collect();
    LightSource { name: name.to_owned(), parts, is_growing: false }
}

fn open(sources: Vec<LightSource>) -> Arc<dyn LightData> {
    open_light("a tag", sources).unwrap_or_else(|e| panic!("{e}")).expect("recorded paths")
}

/// Opens frames 3 and 4.
fn open_frames() -> Arc<dyn LightData> {
    open(vec![source("frame 3", &parts(&scope(3))), source("frame 4", &[frame(&scope(4))])])
}

fn call(kind: LightCallKind, condition: Option<&str>) -> LightCall {
    LightCall { kind, condition: condition.map(str::to_owned), bounds: None }
}

fn ask(light: &Arc<dyn LightData>, kind: LightCallKind, condition: Option<&str>) -> Result<Vec<u8>, LightError> {
    match light.answer(&call(kind, condition), None, &AtomicBool::new(false))? {
        LightAnswer::Json(bytes) | LightAnswer::Columns(bytes) | LightAnswer::Rows { columns: bytes, .. } => Ok(bytes),
    }
}

/// An answer, decoded by the text of the contract.
struct Decoded {
    header: Value,
    columns: BTreeMap<String, Vec<f64>>,
}

impl Decoded {
    fn column(&self, name: &str) -> &[f64] {
        self.columns.get(name).unwrap_or_else(|| panic!("no column {name}"))
    }

    /// Returns whole numbers; `None`: 0xffffffff.
    fn numbers(&self, name: &str) -> Vec<Option<usize>> {
        self.column(name).iter().map(|it| (*it != f64::from(u32::MAX)).then_some(*it as usize)).collect()
    }

    /// Returns the numbers of the set bits.
    fn mask(&self, table: &str) -> Vec<usize> {
        let bytes = self.column(&format!("{table}.mask"));
        (0..8 * bytes.len()).filter(|number| bytes[number >> 3] as u8 >> (number & 7) & 1 == 1).collect()
    }
}

fn decode(bytes: &[u8]) -> Decoded {
    let word = |at: usize| u32::from_le_bytes(bytes[at..at + 4].try_into().unwrap()) as usize;
    assert_eq!((&bytes[..4], word(4)), (&b"FLCV"[..], 1));
    let body = 12 + word(8);
    assert_eq!(body % 8, 0, "columns begin at a multiple of 8");
    let header: Value = serde_json::from_slice(&bytes[12..body]).unwrap();
    let (mut columns, mut end) = (BTreeMap::new(), 0);
    for column in header["columns"].as_array().unwrap() {
        let number = |field: &str| column[field].as_u64().unwrap() as usize;
        let (length, offset) = (number("length"), number("offset"));
        let size = match column["type"].as_str().unwrap() {
            "u8" => 1,
            "u32" | "f32" => 4,
            "f64" => 8,
            other => panic!("unknown type {other}"),
        };
        assert!(offset % 8 == 0 && offset >= end && offset < end + 8, "{column}");
        end = offset + size * length;
        let own = &bytes[body + offset..body + end];
        let values = own.chunks_exact(size).map(|own| match (size, column["type"] == "u32") {
            (1, _) => f64::from(own[0]),
            (4, true) => f64::from(u32::from_le_bytes(own.try_into().unwrap())),
            (4, false) => f64::from(f32::from_le_bytes(own.try_into().unwrap())),
            _ => f64::from_le_bytes(own.try_into().unwrap()),
        });
        let values: Vec<f64> = values.collect();
        assert_eq!(values.len(), length);
        assert!(columns.insert(column["name"].as_str().unwrap().to_owned(), values).is_none(), "{column} twice");
    }
    assert_eq!(bytes.len(), body + end);
    assert_eq!(header["tag"], "a tag");
    Decoded { header, columns }
}

fn ask_columns(light: &Arc<dyn LightData>, kind: LightCallKind, condition: Option<&str>) -> Decoded {
    decode(&ask(light, kind, condition).unwrap_or_else(|e| panic!("{e:?}")))
}

fn schema(light: &Arc<dyn LightData>) -> Value {
    serde_json::from_slice(&ask(light, LightCallKind::Schema, None).unwrap()).unwrap()
}

/// Returns the recorded paths in the order of their numbers: by frame and hash.
fn recorded() -> Vec<LightPath> {
    let keys = |frame| (0..96).flat_map(move |pixel| (0..SAMPLES).map(move |sample| PathKey { frame, pixel, sample }));
    let mut all: Vec<(u64, PathKey)> = [3, 4].into_iter().flat_map(keys).map(|key| (key.hash(5), key)).collect();
    all.sort_unstable();
    // As many of the smallest hashes as one frame keeps.
    all.truncate(700);
    all.sort_unstable_by_key(|(hash, key)| (key.frame, *hash));
    all.into_iter().map(|(_, key)| path(key)).collect()
}

const SELECTION: LightCallKind = LightCallKind::Selection { with_density: true };

fn all_paths(count: u32) -> LightCallKind {
    LightCallKind::Paths { count: PathCount::new(count).unwrap(), brightest: false }
}

fn brightest(count: u32) -> LightCallKind {
    LightCallKind::Paths { count: PathCount::new(count).unwrap(), brightest: true }
}

fn histograms(pairs: &[[usize; 3]], by_image: bool) -> LightCallKind {
    LightCallKind::Histograms { pairs: AxisPairs::new(pairs.to_vec()).unwrap(), by_image }
}

fn voxels(level: u32, bounce: Option<u32>) -> LightCallKind {
    LightCallKind::Voxels { level: VoxelLevel::new(level).unwrap(), bounce }
}

#[test]
fn the_schema_describes_axes_names_and_totals() {
    let schema = schema(&open_frames());
    let paths = recorded();
    assert_eq!((&schema["tag"], &schema["version"], &schema["growing"]), (&json!("a tag"), &json!(1), &json!(false)));
    assert_eq!((&schema["frames"], &schema["film"]), (&json!([3, 4]), &json!([12, 8])));
    assert_eq!(schema["box"], json!([[0.0, 0.0, 0.0], [4.0, 2.0, 1.0]]));
    assert_eq!((&schema["samples"], &schema["bad_samples"]), (&json!(2 * 96 * SAMPLES), &json!(0)));
    let share = schema["share"].as_f64().unwrap();
    assert!((share - 700.0 / (2.0 * 96.0 * f64::from(SAMPLES))).abs() < 0.03, "{share}");
    assert_eq!((&schema["recorded"], &schema["full_histograms"]), (&json!(700), &json!(false)));
    let count = |items: fn(&LightPath) -> usize| paths.iter().map(items).sum::<usize>();
    let (intersections, lights) = (count(|it| it.intersections.len()), count(|it| it.lights.len()));
    assert_eq!(schema["counts"], json!({ "paths": 700, "intersections": intersections, "lights": lights }));
    assert_eq!(schema["names"], json!(["lamp", "plant", "room.wall", "paint", "lamp", "window"]));
    assert_eq!(schema["kinds"], json!(["object", "object", "object", "material", "light", "light"]));
    assert_eq!(schema["words"]["end"], json!(["escaped", "absorbed", "roulette", "depth", "field"]));
    assert_eq!(schema["words"]["found"], json!(["sight", "met", "surface", "airlight", "glow", "field"]));
    for edges in ["radiance_edges", "throughput_edges"] {
        let edges: Vec<f64> = schema[edges].as_array().unwrap().iter().map(|it| it.as_f64().unwrap()).collect();
        assert!(edges.len() == 64 && edges[0] == 0.0 && edges.is_sorted());
    }
    // Each field is a name in conditions.
    let tables = &schema["tables"];
    let light = open_frames();
    for (table, axes) in ["paths", "intersections", "lights"].iter().zip(ATTRIBUTE_COUNTS) {
        let all = tables[table].as_array().unwrap();
        assert_eq!(all.len(), axes);
        for axis in all {
            let field = axis["field"].as_str().unwrap();
            let condition = match axis["scale"].as_str().unwrap() {
                "class" => format!("{field} != {}", axis["words"][0].as_str().unwrap()),
                "name" => format!("{field} != nothing"),
                _ => format!("{field} > -1e9"),
            };
            assert!(ask(&light, SELECTION, Some(&condition)).is_ok(), "{condition}");
        }
    }
    assert_eq!(tables["paths"][2], json!({ "name": "radiance.r", "scale": "radiance", "field": "path.radiance.r" }));
    let brightest = tables["paths"].as_array().unwrap().iter().find(|axis| axis["name"] == "light");
    assert_eq!(brightest.expect("an axis")["field"], "brightest.light");
    assert_eq!(tables["lights"][0]["field"], "light.radiance.r");
}

#[test]
fn masks_have_the_bits_of_the_selected_records() {
    let light = open_frames();
    let found = ask_columns(&light, SELECTION, Some("object == plant  and bounce>=1"));
    assert_eq!(found.header["text"], "object == plant and bounce >= 1");
    let (mut paths, mut intersections, mut next) = (Vec::new(), Vec::new(), 0);
    let plant = Name::new(NameKind::Object, "plant");
    let (mut light_sum, mut all_light) = (0.0, 0.0);
    for (number, path) in recorded().iter().enumerate() {
        let own: Vec<usize> = (0..path.intersections.len())
            .filter(|&at| path.intersections[at].object == plant && path.intersections[at].bounce >= 1)
            .map(|at| next + at)
            .collect();
        next += path.intersections.len();
        all_light += f64::from(path.luminance());
        if !own.is_empty() {
            paths.push(number);
            light_sum += f64::from(path.luminance());
        }
        intersections.extend(own);
    }
    assert!(paths.len() > 50 && paths.len() < 600, "{}", paths.len());
    assert_eq!((found.mask("paths"), found.mask("intersections")), (paths.clone(), intersections.clone()));
    let counts = &found.header["counts"];
    assert_eq!((&counts["paths"], &counts["intersections"]), (&json!(paths.len()), &json!(intersections.len())));
    assert_eq!(counts["lights"], json!(found.mask("lights").len()));
    let schema = schema(&light);
    assert_eq!((&found.header["totals"], &found.header["recorded"]), (&schema["counts"], &json!(700)));
    // All pixels have the same number of samples, so shares of the light are shares of the luminance.
    let share = found.header["light_share"].as_f64().unwrap();
    assert!((share - light_sum / all_light).abs() < 1e-6);
    let samples = found.header["samples"].as_f64().unwrap();
    assert!((samples * schema["share"].as_f64().unwrap() - paths.len() as f64).abs() < 1e-6);
    let pixels = found.column("density.pixel");
    assert!(pixels.is_sorted_by(|a, b| a < b) && pixels.iter().all(|pixel| *pixel < 96.0));
    assert_eq!(found.column("density.count").iter().sum::<f64>(), paths.len() as f64);
    let density: f64 = found.column("density.light").iter().sum();
    let expected = light_sum / f64::from(SAMPLES) / 2.0;
    assert!((density - expected).abs() < 1e-5 * expected, "{density}, expected {expected}");
    let luminances = found.column("density.luminance").iter().zip(found.column("density.count"));
    let sum: f64 = luminances.map(|(mean, count)| mean * count).sum();
    assert!((sum - light_sum).abs() < 1e-5 * light_sum, "{sum}, expected {light_sum}");
    let sparse = ask_columns(&light, LightCallKind::Selection { with_density: false }, Some("object == plant"));
    assert!(!sparse.columns.contains_key("density.pixel"));
}

#[test]
fn representatives_are_rows_of_records() {
    let light = open_frames();
    let schema = schema(&light);
    let names = schema["names"].as_array().unwrap();
    let name = |value: f64| (value > 0.0).then(|| names[value as usize - 1].as_str().unwrap());
    let all = recorded();
    let (mut first_intersection, mut first_light) = (vec![0], vec![0]);
    for path in &all {
        first_intersection.push(first_intersection.last().unwrap() + path.intersections.len());
        first_light.push(first_light.last().unwrap() + path.lights.len());
    }
    for (condition, count, set) in [(None, 60, 60), (Some("depth == 3"), 10, 10), (None, 20_000, 700)] {
        let found = ask_columns(&light, all_paths(count), condition);
        let numbers: Vec<usize> = found.numbers("paths.number").into_iter().flatten().collect();
        assert_eq!((&found.header["set"], numbers.len()), (&json!(set), set));
        assert!(numbers.is_sorted_by(|a, b| a < b));
        assert!((found.column("paths.weight").iter().sum::<f64>() - set as f64).abs() < 1e-3);
        assert!(found.header["effective_size"].as_f64().unwrap() <= set as f64 + 1e-6);
        let selected = ask_columns(&light, SELECTION, Some(condition.unwrap_or("depth >= 0")));
        let mask = selected.mask("paths");
        assert!(numbers.iter().all(|number| mask.contains(number)), "{condition:?}");
        assert_eq!(found.header["candidates"], json!(mask.len()));
        let (owners, parents) = (found.numbers("intersections.path"), found.numbers("intersections.parent"));
        let (mut intersection, mut own_light) = (0, 0);
        for (row, number) in numbers.iter().enumerate() {
            let path = &all[*number];
            let value = |axis: &str| found.column(&format!("paths.{axis}"))[row];
            assert_eq!(
                [value("pixel.x"), value("pixel.y"), value("sample"), value("frame"), value("depth")],
                [path.key.pixel % 12, path.key.pixel / 12, path.key.sample, path.key.frame, path.depth].map(f64::from)
            );
            assert_eq!(value("radiance.r"), f64::from(path.radiance[0]));
            assert_eq!(value("end"), f64::from(path.end as u8 + 1));
            let brightest = path.brightest_light().unwrap().light;
            let expected = if brightest == Name::new(NameKind::Lamp, "window") { "window" } else { "lamp" };
            assert_eq!(name(value("light")), Some(expected));
            assert_eq!(value("first.x").is_nan(), path.intersections.is_empty());
            for (index, it) in path.intersections.iter().enumerate() {
                assert_eq!(owners[intersection], Some(row));
                assert_eq!(parents[intersection], (index > 0).then(|| intersection - 1));
                let own = found.numbers("intersections.number")[intersection];
                assert_eq!(own, Some(first_intersection[*number] + index));
                let x = found.column("intersections.position.x")[intersection];
                assert!((x - it.position[0]).abs() < 1e-6);
                let object = name(found.column("intersections.object")[intersection]).unwrap();
                assert_eq!(Name::new(NameKind::Object, object), it.object);
                intersection += 1;
            }
            let first_row = intersection - path.intersections.len();
            for (index, it) in path.lights.iter().enumerate() {
                assert_eq!(found.numbers("lights.path")[own_light], Some(row));
                let parent = found.numbers("lights.intersection")[own_light];
                assert_eq!(parent, (it.vertex > 0).then(|| first_row + it.vertex as usize - 1));
                assert_eq!(found.numbers("lights.number")[own_light], Some(first_light[*number] + index));
                let occluder = name(found.column("lights.occluder")[own_light]);
                assert_eq!(occluder, it.occluder.map(|_| "plant"));
                own_light += 1;
            }
        }
        assert_eq!((intersection, own_light), (owners.len(), found.column("lights.path").len()));
    }
}

#[test]
fn the_brightest_come_first() {
    let light = open_frames();
    let found = ask_columns(&light, brightest(6), None);
    let luminances = |found: &Decoded| -> Vec<f64> {
        let channels = ["r", "g", "b"].map(|channel| found.column(&format!("paths.radiance.{channel}")));
        let weights = [0.2126, 0.7152, 0.0722];
        (0..channels[0].len()).map(|row| (0..3).map(|it| weights[it] * channels[it][row]).sum()).collect()
    };
    let own = luminances(&found);
    assert!(own.len() == 6 && own.windows(2).all(|pair| pair[0] > pair[1] - 1e-2), "{own:?}");
    let keys = [3, 4].into_iter().flat_map(|frame| {
        (0..96).flat_map(move |pixel| (0..SAMPLES).map(move |sample| PathKey { frame, pixel, sample }))
    });
    let greatest = keys.map(|key| f64::from(path(key).luminance())).fold(0.0, f64::max);
    assert!((own[0] - greatest).abs() < 1e-3 * greatest, "of all samples, not only of the recorded ones");
    // Those among the recorded paths have their numbers.
    let every = ask_columns(&light, brightest(100), None);
    let (all, numbers) = (recorded(), every.numbers("paths.number"));
    assert!(numbers.iter().any(Option::is_some) && numbers.iter().any(Option::is_none));
    for (row, number) in numbers.iter().enumerate() {
        let value = |axis: &str| every.column(&format!("paths.{axis}"))[row] as u32;
        let key =
            PathKey { frame: value("frame"), pixel: value("pixel.x") + 12 * value("pixel.y"), sample: value("sample") };
        assert_eq!(*number, all.iter().position(|path| path.key == key));
    }
    let owners = every.numbers("intersections.path");
    for (owner, number) in owners.iter().zip(every.numbers("intersections.number")) {
        assert_eq!(number.is_some(), numbers[owner.unwrap()].is_some());
    }
    assert!(
        ["paths", "intersections", "lights"]
            .iter()
            .all(|it| every.column(&format!("{it}.selected")).iter().all(|mark| *mark == 1.0))
    );
    let rows = numbers.len();
    assert_eq!((&every.header["selected"], &every.header["set"]), (&json!(rows), &json!(rows)));
    // A condition marks rows and omits none.
    let plants = ask_columns(&light, brightest(100), Some("depth > 2 and object == plant"));
    assert!(plants.column("paths.sample") == every.column("paths.sample") && plants.header["set"] == json!(rows));
    assert_eq!(plants.header["candidates"], every.header["candidates"]);
    let plant = schema(&light)["names"].as_array().unwrap().iter().position(|name| name == "plant").unwrap() + 1;
    let (mut marks, mut expected) = (vec![0.0; rows], Vec::new());
    for (owner, object) in plants.numbers("intersections.path").iter().zip(plants.column("intersections.object")) {
        let is_selected = *object == plant as f64 && plants.column("paths.depth")[owner.unwrap()] > 2.0;
        expected.push(f64::from(u8::from(is_selected)));
        marks[owner.unwrap()] += f64::from(u8::from(is_selected));
    }
    marks.iter_mut().for_each(|mark: &mut f64| *mark = mark.min(1.0));
    assert_eq!((plants.column("paths.selected"), plants.column("intersections.selected")), (&marks[..], &expected[..]));
    let count = marks.iter().sum::<f64>();
    assert!(count > 1.0 && count < rows as f64 && plants.header["selected"] == json!(count as u32));
    // A condition without quantifiers selects all lights of its paths.
    let of_plants = plants.numbers("lights.path").into_iter().map(|owner| marks[owner.unwrap()]);
    assert!(of_plants.eq(plants.column("lights.selected").iter().copied()));
    let selected = ask_columns(&light, SELECTION, Some("depth > 2 and object == plant"));
    for (number, mark) in plants.numbers("paths.number").iter().zip(&marks) {
        assert!(number.is_none_or(|number| selected.mask("paths").contains(&number) == (*mark == 1.0)));
    }
    assert!(!ask_columns(&light, all_paths(60), Some("depth > 2")).columns.contains_key("paths.selected"));
}

#[test]
fn selections_from_different_films_have_no_density() {
    let wide = Scope { film: [16, 8], ..scope(4) };
    let light = open(vec![source("frame 3", &parts(&scope(3))), source("frame 4", &[frame(&wide)])]);
    let found = ask_columns(&light, SELECTION, Some("depth > 1"));
    let fault = "frame 3 has a film of 12 x 8 pixels, but frame 4 has 16 x 8; choose frames with one film";
    assert_eq!(found.header["density_fault"], fault);
    assert!(!found.columns.keys().any(|name| name.starts_with("density.")));
    assert_eq!(found.header["counts"]["paths"], json!(found.mask("paths").len()));
    assert!(!found.mask("paths").is_empty());
    let own = ask_columns(&open_frames(), SELECTION, Some("depth > 1"));
    assert!(own.header.get("density_fault").is_none() && own.columns.contains_key("density.pixel"));
}

#[test]
fn histograms_add_up_and_have_categories() {
    let light = open_frames();
    let kind = |by_image| histograms(&[[0, 8, 3], [1, 7, 0], [2, 4, 4]], by_image);
    let found = ask_columns(&light, kind(false), None);
    assert_eq!(found.header["counted"], "recorded");
    let totals = &schema(&light)["counts"];
    for (table, axes) in ["paths", "intersections", "lights"].into_iter().zip(ATTRIBUTE_COUNTS) {
        for axis in 0..axes {
            let counts = found.column(&format!("{table}.{axis}"));
            assert!(counts.len() == 64 && json!(counts.iter().sum::<f64>() as u64) == totals[table], "{table}.{axis}");
        }
    }
    let categories = found.header["categories"].as_object().unwrap();
    let axes: Vec<&str> = categories.keys().map(String::as_str).collect();
    let mut expected = [
        "paths.first.object",
        "paths.light",
        "intersections.object",
        "intersections.material",
        "lights.light",
        "lights.occluder",
    ];
    expected.sort_unstable();
    assert_eq!(axes, expected);
    // Lamps of lights: bin k is category k - 1, and categories are indices of names.
    let lamps = found.column("lights.3");
    let names = &schema(&light)["names"];
    for (bin, index) in (1..).zip(categories["lights.light"].as_array().unwrap()) {
        let lamp = Name::new(NameKind::Lamp, names[index.as_u64().unwrap() as usize].as_str().unwrap());
        let all = recorded();
        let own = all.iter().flat_map(|path| &path.lights).filter(|it| it.light == lamp);
        assert_eq!(lamps[bin], own.count() as f64);
    }
    assert!(lamps[1] > lamps[2] && lamps[2] > 0.0 && lamps[3..].iter().all(|count| *count == 0.0));
    let joint = found.column("intersections.7-0");
    assert_eq!(joint.len(), 64 * 64);
    for bin in 0..64 {
        assert_eq!(joint[64 * bin..][..64].iter().sum::<f64>(), found.column("intersections.7")[bin], "row {bin}");
        let column: f64 = (0..64).map(|row| joint[64 * row + bin]).sum();
        assert_eq!(column, found.column("intersections.0")[bin], "column {bin}");
    }
    let diagonal = found.column("lights.4-4");
    assert!((0..64).all(|bin| diagonal[65 * bin] == found.column("lights.4")[bin]));
    let by_image = ask_columns(&light, kind(true), None);
    let part = 700.0 / f64::from(SAMPLES);
    assert!((by_image.column("paths.8").iter().sum::<f64>() - part).abs() < 1e-6, "each is a sixteenth of a pixel");
    let selected = ask_columns(&light, kind(false), Some("depth == 2"));
    assert_eq!(selected.column("paths.8")[2], found.column("paths.8")[2]);
    assert_eq!(selected.column("paths.8").iter().sum::<f64>(), found.column("paths.8")[2]);
    assert_eq!(selected.header["categories"], found.header["categories"], "bins do not depend on the selection");
}

#[test]
fn full_histograms_are_of_all_samples() {
    let scope = Scope { has_full_histograms: true, ..scope(3) };
    let light = open(vec![source("frame 3", &parts(&scope))]);
    assert_eq!(schema(&light)["full_histograms"], json!(true));
    let found = ask_columns(&light, histograms(&[], false), None);
    assert_eq!(found.header["counted"], "all samples");
    assert_eq!(found.column("paths.8").iter().sum::<f64>(), f64::from(96 * SAMPLES));
    let by_image = ask_columns(&light, histograms(&[], true), None);
    assert!((by_image.column("paths.8").iter().sum::<f64>() - 96.0).abs() < 1e-6);
}

#[test]
fn histograms_of_different_boxes_count_recorded_samples() {
    let full = |frame, upper| Scope { has_full_histograms: true, upper, ..scope(frame) };
    let [three, four] = [full(3, [4.0, 2.0, 1.0]), full(4, [4.0, 2.0, 3.0])];
    let light = open(vec![source("frame 3", &parts(&three)), source("frame 4", &[frame(&four)])]);
    assert_eq!(schema(&light)["box"], json!([[0.0, 0.0, 0.0], [4.0, 2.0, 3.0]]));
    let found = ask_columns(&light, histograms(&[], false), None);
    assert_eq!(found.header["counted"], "recorded");
    // Positions have z = 0.5: a sixth of 63 bins.
    let with_hits = recorded().iter().filter(|path| !path.intersections.is_empty()).count();
    assert_eq!(found.column("paths.12")[1 + 63 / 6], with_hits as f64);
}

#[test]
fn voxels_have_all_intersections() {
    let light = open_frames();
    let all = recorded();
    let found = ask_columns(&light, voxels(3, Some(1)), None);
    assert_eq!(
        (&found.header["cube"], &found.header["level"]),
        (&json!([[0.0, 0.0, 0.0], [4.0, 4.0, 4.0]]), &json!(3))
    );
    let mut expected = BTreeMap::<usize, (f64, f64)>::new();
    for it in all.iter().flat_map(|path| &path.intersections).filter(|it| it.bounce == 1) {
        let [x, y, z] = it.position.map(|axis| (axis * 2.0) as usize);
        let own = expected.entry(x + 8 * (y + 8 * z)).or_default();
        own.0 += 1.0;
        own.1 += it.radiance.iter().map(|it| f64::from(*it)).sum::<f64>() / 3.0;
    }
    assert!(expected.len() > 5);
    let indices: Vec<usize> = found.numbers("voxels.index").into_iter().flatten().collect();
    assert!(indices.iter().eq(expected.keys()));
    for (row, (count, energy)) in expected.values().enumerate() {
        assert_eq!(found.column("voxels.count")[row], *count);
        assert!((found.column("voxels.energy")[row] - energy).abs() < 1e-5 * energy);
    }
}

#[test]
fn invalid_parameters_are_named() {
    let light = open_frames();
    let fault = |kind: LightCallKind, condition: Option<&str>| match ask(&light, kind, condition).unwrap_err() {
        LightError::Invalid { field, message } => format!("{field}: {message}"),
        LightError::Cancelled => panic!("cancelled"),
    };
    assert_eq!(fault(SELECTION, None), "where: give a condition");
    assert_eq!(fault(SELECTION, Some("bounce >")), "where: column 9: found \"\", expected a number");
    assert_eq!(fault(histograms(&[[2, 6, 0]], false), None), "pairs: lights:6-0: its attributes are 0 to 5");
    assert!(fault(histograms(&[[3, 0, 0]], false), None).starts_with("pairs: "));
    let cancelled = AtomicBool::new(true);
    for kind in [SELECTION, voxels(2, None), histograms(&[], false)] {
        let call = LightCall { kind, condition: Some("depth > 1".into()), bounds: None };
        assert_eq!(light.answer(&call, None, &cancelled), Err(LightError::Cancelled));
    }
    assert_eq!(light.answer(&call(all_paths(50), None), None, &cancelled), Err(LightError::Cancelled));
    let brightest = call(brightest(50), Some("depth > 1"));
    assert_eq!(light.answer(&brightest, None, &cancelled), Err(LightError::Cancelled));
}

#[test]
fn answers_do_not_depend_on_order_and_division() {
    let [three, four] = [scope(3), scope(4)];
    let mut reversed = parts(&three);
    reversed.reverse();
    reversed.push(reversed[1].clone());
    let united = FrameStatistics::from_statistics([frame(&three), frame(&four)]).unwrap().encode();
    let file = LightSource { name: "all.paths".into(), parts: vec![united.into()], is_growing: false };
    let same =
        [open_frames(), open(vec![source("frame 4", &parts(&four)), source("frame 3", &reversed)]), open(vec![file])];
    for (kind, condition) in [
        (LightCallKind::Schema, None),
        (all_paths(40), Some("depth > 1")),
        (brightest(40), None),
        (SELECTION, Some("object == plant")),
        (histograms(&[[0, 1, 2]], true), None),
        (voxels(4, None), None),
    ] {
        let answers: Vec<Vec<u8>> = same.iter().map(|light| ask(light, kind.clone(), condition).unwrap()).collect();
        assert!(answers[0] == answers[1] && answers[0] == answers[2], "{kind:?}");
    }
    let other = open(vec![source("frame 3", &parts(&three))]);
    assert_ne!(ask(&other, SELECTION, Some("depth > 1")), ask(&same[0], SELECTION, Some("depth > 1")));
}

#[test]
fn damaged_and_missing_data_are_told_apart() {
    let good = source("frame 3", &parts(&scope(3)));
    let fault = |sources: Vec<LightSource>| open_light("", sources).err().expect("a fault").to_string();
    let mut damaged = good.clone();
    let mut bytes = damaged.parts[2].to_vec();
    bytes[90] ^= 4;
    damaged.parts[2] = bytes.into();
    assert_eq!(fault(vec![good.clone(), damaged]), "frame 3: part 3: invalid light statistics: checksum mismatch");
    let other = source("frame 3", &[frame(&scope(3)), frame(&scope(4))]);
    assert_eq!(fault(vec![other]), "frame 3: part 2: the statistics belong to different frames or settings");
    let picture = LightSource { name: "a.exr".into(), parts: vec![vec![7; 100].into()], is_growing: false };
    assert!(fault(vec![picture]).starts_with("a.exr: invalid light statistics: wrong magic number"));
    let empty = source("a.paths", &[LightStatistics::new(scope(3), 0.5)]);
    assert_eq!(fault(vec![empty.clone()]), "a.paths: no recorded paths; render the frame again with --stats");
    let growing = LightSource { is_growing: true, ..empty };
    assert!(open_light("", vec![growing]).is_ok_and(|light| light.is_none()));
    assert!(open_light("", vec![source("frame 3", &[])]).is_ok_and(|light| light.is_none()));
    let light = open(vec![LightSource { is_growing: true, ..good }]);
    assert_eq!(schema(&light)["growing"], json!(true));
    let bytes = light.memory_bytes();
    assert!(bytes > 700 * 100 && bytes < 10_000_000, "{bytes}");
}

#[test]
fn light_in_numbers_agrees_with_selections_of_rows() {
    let light = open_frames();
    let summary = |condition: Option<&str>| -> Value {
        serde_json::from_slice(&ask(&light, LightCallKind::Summary, condition).unwrap()).unwrap()
    };
    let schema = schema(&light);
    for condition in [None, Some("depth >= 2"), Some("light(light == window) and depth < 4")] {
        let found = summary(condition);
        assert_eq!((&found["tag"], &found["recorded"]), (&json!("a tag"), &schema["recorded"]));
        assert_eq!(found["samples"], schema["samples"]);
        if let Some(condition) = condition {
            let selection = ask_columns(&light, LightCallKind::Selection { with_density: false }, Some(condition));
            assert_eq!(found["text"], condition);
            assert_eq!(found["total"]["paths"], selection.header["counts"]["paths"], "{condition}");
            assert_eq!(found["total"]["records"], selection.header["counts"]["intersections"], "{condition}");
            let all = summary(None)["total"]["light"]["value"].as_f64().unwrap();
            let share = found["total"]["light"]["value"].as_f64().unwrap() / all;
            assert!((share - selection.header["light_share"].as_f64().unwrap()).abs() < 1e-9, "{condition}");
        }
        let lamps = found["groups"]["lamp"].as_array().unwrap();
        assert_eq!(lamps.len(), if condition.is_some_and(|it| it.contains("light(")) { 1 } else { 2 }, "{lamps:?}");
        for (group, rows) in found["groups"].as_object().unwrap() {
            for row in rows.as_array().unwrap() {
                let Some(own) = row["where"].as_str() else { continue };
                let text = condition.map_or_else(|| own.to_owned(), |condition| format!("({condition}) and {own}"));
                let selected = ask_columns(&light, LightCallKind::Selection { with_density: false }, Some(&text));
                let table = if group == "lamp" { "lights" } else { "intersections" };
                if group != "bounce" {
                    assert_eq!(selected.header["counts"][table], row["records"], "{group} {row}: {text}");
                }
            }
        }
        assert_eq!(found["left_out"], json!({ "object": 0, "bounce": 0, "lamp": 0 }));
    }
}

#[test]
fn pictures_of_files_are_compared_by_their_luminances() {
    let compare = |a: &LightStatistics, b: &LightStatistics| -> Value {
        let sources = [a, b].map(|it| femc_service::PictureSource::Statistics(it.encode().into()));
        serde_json::from_slice(&crate::compare_pictures(sources).unwrap()).unwrap()
    };
    let (a, b) = (frame(&scope(3)), frame(&scope(4)));
    let same = compare(&a, &a);
    assert_eq!((&same["mse"], &same["ssim"], &same["mean_ratio"]), (&json!(0.0), &json!(1.0), &json!(1.0)), "{same}");
    assert_eq!((&same["psnr"], &same["compared"], &same["fault"]), (&Value::Null, &json!("luminance"), &Value::Null));
    let other = compare(&a, &b);
    let mean = |it: &LightStatistics| {
        let pixels: Vec<f64> =
            femc_paths::pixels::PixelMaps::from_statistics(it).pixels().map(|it| it.luminance).collect();
        pixels.iter().sum::<f64>() / pixels.len() as f64
    };
    let ratio = other["mean_ratio"].as_f64().unwrap();
    assert!((ratio - mean(&a) / mean(&b)).abs() < 1e-6, "{other}");
    assert!(other["mse"].as_f64().unwrap() > 0.0 && other["flip"].as_f64().unwrap() > 0.0, "{other}");
    let wide = compare(&a, &frame(&Scope { film: [16, 8], ..scope(3) }));
    assert_eq!((&wide["films"], &wide["mse"]), (&json!([[12, 8], [16, 8]]), &Value::Null), "{wide}");
    assert!(wide["fault"].as_str().is_some_and(|text| text.contains("16")), "{wide}");
    let damaged = [a.encode(), vec![1, 2, 3]].map(|bytes| femc_service::PictureSource::Statistics(bytes.into()));
    let fault = crate::compare_pictures(damaged).unwrap_err();
    assert!(fault.starts_with("B: "), "{fault}");
}
