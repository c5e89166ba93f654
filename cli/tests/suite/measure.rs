//! Tests of `femc measure`.

use crate::common::TestFolder;
use serde_json::Value;

/// A gray room of 4 m x 4 m x 2.5 m with a ball of light.
const ROOM: &str = "\
camera main =
 origin 1.2 -1.5 1.4
 target 0 .2 0
 fov .5
 film 8 8
m lamp =
 sides 1
 c
 ed 1000
m floor =
 sides 2
 c
 rd .4
m wall =
 sides 2
 c
 rd .6
v c =
 p 0 0 2.1
m lamp
o bulb
sph c .15
o
v a =
 p -2 -2 0
v b =
 p 2 -2 0
v d =
 p 2 2 0
v e =
 p -2 2 0
v f =
 p -2 -2 2.5
v g =
 p 2 -2 2.5
v h =
 p 2 2 2.5
v i =
 p -2 2 2.5
o room
m floor
o floor
f a b d e
o
m wall
f i h g f
f f g b a
f g h d b
f h i e d
f i f a e
o
";

const POINTS: &str = "\
[[points]]
name = \"below\"
at = [[0, 0.2, 0]]

[[points]]
name = \"seen\"
quantity = \"luminance\"
at = [[0, 0.2, 0]]
observer = [1.2, -1.5, 1.4]

[[grid]]
name = \"plane\"
corner = [-1.5, -1.5, 0.75]
along = [3, 0, 0]
across = [0, 3, 0]
count = [3, 3]

[[area]]
name = \"floor\"
object = \"room.floor\"
cells = 16
";

fn folder() -> TestFolder {
    let dir = TestFolder::new();
    std::fs::write(dir.path("room.mgf"), ROOM).expect("written");
    std::fs::write(dir.path("points.toml"), POINTS).expect("written");
    dir
}

fn reading<'a>(report: &'a Value, part: &str, number: u64) -> &'a Value {
    let readings = report["readings"].as_array().expect("readings");
    let found = readings.iter().find(|row| row["part"] == part && row["number"] == number && row["lamp"].is_null());
    found.unwrap_or_else(|| panic!("{part} {number}: {report}"))
}

fn value(row: &Value, key: &str) -> f64 {
    row[key].as_f64().unwrap_or_else(|| panic!("{key}: {row}"))
}

/// A matte floor: luminance = reflectance x illuminance / pi. The picture of the same floor agrees.
#[test]
fn a_floor_its_illuminance_and_its_picture_agree() {
    let dir = folder();
    let report = dir.run("measure room.mgf points.toml --error 0.005 --json").exits(0).json();
    let (below, seen) = (reading(&report, "below", 0), reading(&report, "seen", 0));
    assert_eq!((&below["unit"], &seen["unit"]), (&Value::from("lx"), &Value::from("cd/m2")));
    let expected = 0.4 * value(below, "value") / std::f64::consts::PI;
    let width = (0.4 * value(below, "half_width") / std::f64::consts::PI).hypot(value(seen, "half_width"));
    assert!((value(seen, "value") - expected).abs() < 2.0 * width, "{seen}: {expected} +- {width}");
    assert!(width < 0.01 * expected);
    dir.run("render room.mgf -o picture.exr --spp 1024").exits(0);
    let picture = femc_film::exr::read(&dir.path("picture.exr")).expect("a picture").image;
    let weights = [0.2126, 0.7152, 0.0722];
    let luminance = |pixel: &[f32; 3]| pixel.iter().zip(weights).map(|(c, w)| f64::from(*c) * w).sum::<f64>();
    let mean = picture.pixels.iter().map(luminance).sum::<f64>() / picture.pixels.len() as f64;
    // 64 pixels of 1,024 samples have an error of the mean below 0.3 %.
    assert!((mean / expected - 1.0).abs() < 0.015, "{mean} cd/m2 in the picture, {expected} measured");
}

#[test]
fn tables_have_the_same_rows_in_all_formats_and_on_any_threads() {
    let dir = folder();
    let line = "measure room.mgf points.toml --spp 256 --by-lamp";
    let csv = dir.run(&format!("{line} --csv --threads 1")).exits(0).stdout();
    assert_eq!(csv, dir.run(&format!("{line} --csv --threads 3")).exits(0).stdout());
    let report = dir.run(&format!("{line} --json")).exits(0).json();
    let rows = report["readings"].as_array().expect("readings");
    let mut lines = csv.lines();
    let header: Vec<&str> = lines.next().expect("a header").split(',').collect();
    let lines: Vec<Vec<&str>> = lines.map(|line| line.split(',').collect()).collect();
    assert_eq!(lines.len(), rows.len());
    let place =
        |name: &str| header.iter().position(|column| *column == name).unwrap_or_else(|| panic!("{name}: {header:?}"));
    let (value_at, lamp_at, width_at) = (place("value"), place("lamp"), place("half_width"));
    for (line, row) in lines.iter().zip(rows) {
        // A reader of JSON may round the last digit.
        let is_equal =
            |at: usize, key| (line[at].parse::<f64>().expect("a number") / value(row, key) - 1.0).abs() < 1e-15;
        assert!(is_equal(value_at, "value") && is_equal(width_at, "half_width"), "{row}: {line:?}");
        assert_eq!(line[lamp_at], row["lamp"].as_str().unwrap_or(""), "{row}");
        let is_all = row["lamp"].is_null();
        assert_eq!(is_all, row["color"].is_array());
        assert!(is_all || row["lamp"] == "bulb/lamp", "{row}");
    }
    for name in ["out.csv", "out.json", "out.parquet"] {
        dir.run(&format!("{line} -o {name}")).exits(0);
    }
    assert_eq!(std::fs::read_to_string(dir.path("out.csv")).expect("a file").trim_end(), csv.trim_end());
    let document: Value = serde_json::from_slice(&std::fs::read(dir.path("out.json")).expect("a file")).expect("JSON");
    assert_eq!(document["readings"], report["readings"]);
    assert_eq!(&std::fs::read(dir.path("out.parquet")).expect("a file")[..4], b"PAR1");
    dir.run(&format!("{line} -o out.html")).exits(0);
    let page = std::fs::read_to_string(dir.path("out.html")).expect("a file");
    assert_eq!(page.matches("<svg").count(), 1, "a map of the grid");
    assert!(
        page.contains("Map of plane") && page.contains("bulb/lamp") && !page.contains("http://www.w3.org/1999/xlink")
    );
    let summaries = report["summaries"].as_array().expect("summaries");
    let parts: Vec<&str> =
        summaries.iter().filter(|row| row["lamp"].is_null()).filter_map(|row| row["part"].as_str()).collect();
    assert_eq!(parts, ["plane", "floor"]);
    assert!((value(&summaries[2], "area") / 16.0 - 1.0).abs() < 1e-6, "{}", summaries[2]);
}

/// The flux of a ball that arrives at the floor directly: its share of the solid angle.
#[test]
fn direct_light_on_a_floor_has_the_share_of_its_solid_angle() {
    let dir = folder();
    let report = dir.run("measure room.mgf points.toml --error 0.005 --max-depth 1 --json").exits(0).json();
    let floor =
        report["summaries"].as_array().expect("summaries").iter().find(|row| row["part"] == "floor").expect("a floor");
    let corner = |x: f64, y: f64, z: f64| (x * y / (z * (x * x + y * y + z * z).sqrt())).atan();
    let flux = 1000.0 * 4.0 * std::f64::consts::PI * 0.15f64.powi(2);
    let expected = flux * 4.0 * corner(2.0, 2.0, 2.1) / (4.0 * std::f64::consts::PI) / 16.0;
    let (mean, width) = (value(floor, "mean"), value(floor, "mean_half_width"));
    assert!((mean - expected).abs() < 2.0 * width, "{mean} +- {width} for {expected}");
}

#[test]
fn a_work_plane_needs_no_file_and_set_changes_the_scene() {
    let dir = folder();
    let mean = |more: &str| {
        let line = format!("measure room.mgf --where height=0.8,border=1,spacing=1 --error 0.01 --json {more}");
        let report = dir.run(&line).exits(0).json();
        assert_eq!(report["readings"].as_array().map(Vec::len), Some(4), "{report}");
        value(&report["summaries"][0], "mean")
    };
    let ratio = mean("--set material.lamp.ed=500") / mean("");
    assert!((ratio - 0.5).abs() < 0.02, "{ratio}");
    let said = dir.run("measure room.mgf --where height=0.8,border=1,spacing=1 --error 0.05").exits(0).stdout();
    assert!(said.starts_with("part ") && said.contains("work plane") && said.contains("uniformity"), "{said}");
}

#[test]
fn bad_input_says_what_is_wrong_and_where() {
    let dir = folder();
    let refused = |points: &str, said: &str| {
        std::fs::write(dir.path("bad.toml"), points).expect("written");
        let ran = dir.run("measure room.mgf bad.toml").exits(2);
        assert!(ran.stderr().contains(said), "{points}: {}", ran.stderr());
        assert_eq!(ran.stdout(), "");
    };
    refused("[[points]]\nname = \"p\"\nat = [[0, 0]]\n", "bad.toml:3:");
    refused("[[points]]\nname = \"p\"\nat = [[0, 0, 1]]\nnormal = [0, 0, 1]\n", "bad.toml:4:1: unknown field `normal`");
    refused("[[points]]\nname = \"p\"\nquantity = \"lux\"\nat = [[0, 0, 1]]\n", "bad.toml:3:12:");
    refused("", "bad.toml: no [[points]], [[grid]] or [[area]]");
    refused(
        "[[area]]\nname = \"a\"\nobject = \"rom\"\n",
        "`a`: no visible object `rom`; the objects are bulb, room, room.floor",
    );
    for (line, said) in [
        ("measure room.mgf", "POINTS.toml"),
        ("measure room.mgf none.toml", "none.toml"),
        ("measure room.mgf points.toml --where height=1", "cannot be used with"),
        ("measure room.mgf points.toml --error 0", "--error"),
        ("measure room.mgf points.toml -o readings.xlsx", ".csv, .parquet, .json or .html"),
        ("measure room.mgf --where border=9", "leaves nothing of 4.00 m x 4.00 m"),
        ("measure room.mgf --where spacing=0.0001", "at most 1048576"),
        ("measure room.mgf points.toml --frame 7", "--frame"),
    ] {
        let ran = dir.run(line).exits(2);
        assert!(ran.stderr().contains(said), "{line}: {}", ran.stderr());
    }
}
