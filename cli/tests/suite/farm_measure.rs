//! Tests of measurements on a farm: `--measure`, `--measure-only`, `femc measure --server`.
#![cfg(unix)]

use crate::common::http::{Answer, send_request};
use crate::common::{FOG, TestFolder, TestProcess, file_names, start_coordinator, status};
use serde_json::Value;

const POINTS: &str = "\
spp = 2048
by-lamp = true

[[points]]
name = \"seen\"
quantity = \"luminance\"
at = [[0, 0.2, 0.5], [0.1, 0.2, 0.7]]
observer = [0.123456789012345, -3.4, 1]

[[grid]]
name = \"plane\"
corner = [-0.9, -0.9, 0.3]
along = [1.8, 0, 0]
across = [0, 1.8, 0]
count = [9, 8]

[[area]]
name = \"walls\"
object = \"room\"
cells = 24
";

/// Returns a folder with the foggy box, whose walls are the object `room`, and the points.
fn folder() -> TestFolder {
    let dir = TestFolder::new();
    let named = FOG.replace("m wall\nf a b c d", "o room\nm wall\nf a b c d").replace("f c b f g\n", "f c b f g\no\n");
    dir.write("room.mgf", &named);
    dir.write("points.toml", POINTS);
    dir
}

fn start_worker(dir: &TestFolder, url: &str) -> TestProcess {
    dir.start(&format!("worker --join {url} --threads 1"))
}

fn submit(dir: &TestFolder, url: &str, line: &str) -> String {
    let ran = dir.run(&format!("submit {line} --server {url}")).exits(0);
    ran.stdout().lines().last().expect("a job number").to_owned()
}

fn get(url: &str, path: &str) -> Answer {
    send_request(url.trim_start_matches("http://"), &format!("GET /api/v1/{path}"), &[], "")
}

/// Returns the documents of the first three frames of a finished job.
fn documents(url: &str, job: &str) -> [Vec<u8>; 3] {
    [1, 2, 3].map(|frame| {
        let answer = get(url, &format!("jobs/{job}/frames/{frame}/readings.json"));
        assert_eq!((answer.status, answer.header("content-type")), (200, "application/json"));
        let name = format!("attachment; filename=\"room.000{frame}.readings.json\"");
        assert_eq!(answer.header("content-disposition"), name);
        answer.body
    })
}

/// Returns the kinds of a job's stages, with their numbers of tasks.
fn stages(url: &str, job: &str) -> Vec<(String, u64)> {
    let stages = get(url, &format!("jobs/{job}")).json()["spec"]["stages"].clone();
    let stage = |stage: &Value| {
        (stage["kind"].as_str().expect("a kind").to_owned(), stage["tasks"].as_u64().expect("a number"))
    };
    stages.as_array().expect("stages").iter().map(stage).collect()
}

#[test]
fn readings_of_a_farm_are_those_of_one_process_despite_a_kill() {
    let alone = folder();
    let (_coordinator, url) = start_coordinator(&alone, 0);
    let _worker = start_worker(&alone, &url);
    // The camera and the film of the images do not change the readings.
    let job = submit(&alone, &url, "room.mgf --frames 1..3 --size 16x8 --spp 2 --measure points.toml");
    alone.run(&format!("watch {job} --server {url}")).exits(0);
    let fetched = alone.run(&format!("fetch {job} -o out --server {url} --json")).exits(0).json();
    let first = documents(&url, &job);
    let sent = fetched["readings"].as_array().expect("tables");
    for frame in 1..=3 {
        let line = format!("measure room.mgf points.toml --frame {frame} --csv");
        let csv = alone.run(&line).exits(0).stdout();
        assert_eq!(sent[frame - 1], format!("out/room.000{frame}.readings.csv"));
        assert_eq!(alone.read(&format!("out/room.000{frame}.readings.csv")), csv, "frame {frame}");
        let document = std::fs::read(alone.path(&format!("out/room.000{frame}.readings.json"))).expect("a document");
        assert!(document == first[frame - 1]);
    }
    assert!(file_names(&alone.path("out")).contains(&"room.0002.exr".to_owned()));
    assert!(first[0] != first[2], "the fog thickens");

    // A job that only measures, on three workers. One of them is killed.
    let farm = folder();
    let (_other_coordinator, url) = start_coordinator(&farm, 0);
    let mut workers: Vec<TestProcess> = (0..3).map(|_| start_worker(&farm, &url)).collect();
    let job = submit(&farm, &url, "room.mgf --frames 1..3 --measure points.toml --measure-only");
    assert_eq!(stages(&url, &job), [("measure".to_owned(), 1), ("join-readings".to_owned(), 1)]);
    let mut doomed = workers.pop().expect("three");
    doomed.wait_until("a frame is done", || status(&farm, &url, &job)["frames_done"].as_u64() > Some(0));
    doomed.kill();
    farm.run(&format!("watch {job} --server {url}")).exits(0);
    assert!(documents(&url, &job) == first, "equal bytes");
    let ran = farm.run(&format!("fetch {job} -o out --server {url}")).exits(0);
    assert!(ran.stdout().starts_with("3 frames in out"), "{}", ran.stdout());
    assert_eq!(file_names(&farm.path("out")).len(), 6, "a document and a table for each frame");
}

#[test]
fn femc_measure_uses_a_farm_and_finds_its_job_again() {
    let dir = folder();
    let (_coordinator, url) = start_coordinator(&dir, 0);
    let mut workers: Vec<TestProcess> = (0..3).map(|_| start_worker(&dir, &url)).collect();
    let line = "measure room.mgf points.toml --spp 16384 --seed 5 --max-depth 3 --set material.wall.rd=0.5 --csv";
    let mut remote = dir.start(&format!("{line} --server {url}"));
    let begun = || {
        let jobs = dir.run(&format!("jobs --json --server {url}")).exits(0).json();
        jobs[0]["workers"].as_u64() == Some(3)
    };
    remote.wait_until("three workers measure", begun);
    assert!(workers.pop().expect("three").kill(), "it was running");
    let remote = remote.end();
    assert_eq!(remote.code(), Some(0), "{}", remote.stderr());
    assert_eq!(remote.stdout(), dir.run(line).exits(0).stdout());
    let again = dir.run(&format!("{line} --server {url}")).exits(0);
    assert_eq!(again.stdout(), remote.stdout());
    let jobs = dir.run(&format!("jobs --json --server {url}")).exits(0).json();
    assert_eq!(jobs.as_array().map(Vec::len), Some(1), "{jobs}");
    let tasks = stages(&url, &jobs[0]["job"].to_string())[0].1;
    assert_eq!(tasks, 7, "98 readings, 16 for each task");
}

#[test]
fn a_job_file_measures_points_beside_it() {
    let dir = folder();
    let (_coordinator, url) = start_coordinator(&dir, 0);
    let _worker = start_worker(&dir, &url);
    std::fs::create_dir(dir.path("jobs")).expect("a folder");
    dir.write("jobs/points.toml", &POINTS.replace("spp = 2048", "error = 0.1"));
    dir.write(
        "jobs/night.toml",
        "scene = \"../room.mgf\"\nframes = 2\nmeasure = \"points.toml\"\nmeasure-only = true\n",
    );
    let job = submit(&dir, &url, "jobs/night.toml");
    dir.run(&format!("watch {job} --server {url}")).exits(0);
    dir.run(&format!("fetch {job} -o out --server {url}")).exits(0);
    let expected = dir.run("measure room.mgf jobs/points.toml --frame 2 --csv").exits(0).stdout();
    assert_eq!(dir.read("out/room.0002.readings.csv"), expected);
}

#[test]
fn bad_points_are_refused_at_the_submission() {
    let dir = folder();
    dir.write("bad.toml", "[[points]]\nname = \"p\"\nat = [[0, 0]]\n");
    dir.write("unknown.toml", "[[area]]\nname = \"a\"\nobject = \"rom\"\n");
    dir.write("two.toml", &format!("error = 0.1\n{POINTS}"));
    dir.write("error.toml", &POINTS.replace("spp = 2048", "error = 2"));
    dir.write("job.toml", "scene = \"room.mgf\"\nmeasure = \"none.toml\"\n");
    let many: Vec<String> = (0..60_000).map(|at| format!("[{at}.125, 0, 1]")).collect();
    dir.write("many.toml", &format!("[[points]]\nname = \"p\"\nat = [{}]\n", many.join(",")));
    // No coordinator is asked.
    for (line, said) in [
        ("submit room.mgf --measure bad.toml", "bad.toml:3:"),
        ("submit room.mgf --measure unknown.toml", "unknown.toml: `a`: no visible object `rom`; the objects are room"),
        ("submit room.mgf --measure none.toml", "none.toml: "),
        ("submit job.toml", "none.toml: "),
        ("submit room.mgf --measure two.toml", "two.toml: `error` and `spp` exclude each other"),
        ("submit room.mgf --measure error.toml", "error.toml: `error` is 2; it must be above 0 and at most 1"),
        ("submit room.mgf --measure-only", "--measure-only: `measure-only` needs a measurement"),
        ("render room.mgf --measure points.toml --measure-only", "`femc render` makes images"),
        ("measure room.mgf unknown.toml --server http://127.0.0.1:1", "unknown.toml: `a`: no visible object `rom`"),
    ] {
        let ran = dir.run(line).exits(2);
        assert!(ran.stderr().contains(said), "{line}: {}", ran.stderr());
    }
    let (_coordinator, url) = start_coordinator(&dir, 0);
    let ran = dir.run(&format!("submit room.mgf --method pt --measure many.toml --server {url}")).exits(2);
    assert!(ran.stderr().contains("at most 1024 are possible in a job"), "{}", ran.stderr());
}

#[test]
fn an_object_that_turns_out_invisible_fails_the_job() {
    let dir = folder();
    let (_coordinator, url) = start_coordinator(&dir, 0);
    let _worker = start_worker(&dir, &url);
    let hidden = "room.mgf --frames 1 --measure points.toml --measure-only --set object.room.hidden=1";
    let job = submit(&dir, &url, hidden);
    let ran = dir.run(&format!("watch {job} --server {url}")).exits(1);
    let said = format!("{}{}", ran.stdout(), ran.stderr());
    assert!(said.contains("`walls`: no visible object `room`; the objects are room"), "{said}");
    let fetched = dir.run(&format!("fetch {job} -o out --server {url}")).exits(1);
    assert!(fetched.stderr().contains("0 of 1 frames are finished"), "{}", fetched.stderr());
}

/// Returns the columns of a CSV table by name.
fn column(csv: &str, name: &str) -> Vec<String> {
    let place = csv.lines().next().expect("a header").split(',').position(|column| column == name);
    let place = place.unwrap_or_else(|| panic!("{name}: {csv}"));
    csv.lines().skip(1).map(|line| line.split(',').nth(place).expect("a cell").to_owned()).collect()
}

#[test]
fn a_sweep_makes_one_table_over_its_variants() {
    let dir = folder();
    dir.write(
        "lamps.toml",
        "scene = \"room.mgf\"\nframes = \"2,3\"\nmeasure = \"sweep.toml\"\nmeasure-only = true\n\
         [sweep]\n\"material.lamp.ed\" = [300, 600]\n",
    );
    let points = "[[points]]\nname = \"middle\"\nat = [[0, 0, 0.5]]\n";
    let grid = "[[grid]]\nname = \"plane\"\ncorner = [-0.5, -0.5, 0.3]\nalong = [1, 0, 0]\nacross = [0, 1, 0]\ncount = [2, 2]\n";
    dir.write("sweep.toml", &format!("spp = 512\n{points}{grid}"));
    let report = dir.run("sweep lamps.toml -o lamps --local --json").exits(0).json();
    let csv = dir.read("lamps/readings.csv");
    assert_eq!(column(&csv, "frame"), ["2", "2", "3", "3"].repeat(2));
    assert_eq!(column(&csv, "part"), ["middle", "plane"].repeat(4));
    assert_eq!(column(&csv, "readings"), ["1", "4"].repeat(4));
    let lamps = column(&csv, "material.lamp.ed");
    assert_eq!(lamps, [["300"; 4], ["600"; 4]].concat());
    let means: Vec<f64> = column(&csv, "mean").iter().map(|mean| mean.parse().expect("a number")).collect();
    for (one, two) in means[..4].iter().zip(&means[4..8]) {
        assert!((two / one - 2.0).abs() < 1e-5, "the lamp of the second variant is twice as bright: {means:?}");
    }
    assert!(dir.path("lamps/readings.parquet").is_file() && !dir.path("lamps/contact.png").exists());
    let rows = report["readings"].as_array().expect("rows");
    assert_eq!(rows.len(), 8);
    assert_eq!((&rows[1]["part"], rows[1]["mean"].as_f64()), (&Value::from("plane"), Some(means[1])));
    // `femc measure` gives the same readings for a variant.
    let variant = report["variants"][1].as_str().expect("a name");
    let alone = "measure room.mgf sweep.toml --frame 3 --set material.lamp.ed=600 --csv";
    assert_eq!(dir.read(&format!("lamps/{variant}/room.0003.readings.csv")), dir.run(alone).exits(0).stdout());
    let again = dir.run("sweep lamps.toml -o lamps --local").exits(0).stdout();
    assert!(again.contains("4 already finished") && again.contains("uniformity"), "{again}");
    // Another request is another measurement.
    dir.write("sweep.toml", &format!("spp = 1024\n{points}{grid}"));
    let other = dir.run("sweep lamps.toml -o lamps --local --json").exits(0).json();
    assert_eq!(other["rendered"], 4, "{other}");
    assert_ne!(dir.read("lamps/readings.csv"), csv);
}

#[test]
fn render_writes_readings_beside_images_and_takes_missing_ones() {
    let dir = folder();
    dir.write("points.toml", &POINTS.replace("spp = 2048", "spp = 256"));
    let line = "render room.mgf -o out.exr --frames 2 --size 8x8 --spp 1";
    dir.run(line).exits(0);
    let image = std::fs::read(dir.path("out.exr")).expect("an image");
    let report = dir.run(&format!("{line} --measure points.toml --json")).exits(0).json();
    assert_eq!((&report["readings"][0], &report["rendered"]), (&Value::from("out.readings.json"), &Value::from(1)));
    let pixels = |bytes: &[u8]| {
        femc_film::pixel_digest(&femc_film::exr::decode(std::io::Cursor::new(bytes)).expect("an image").image)
            .to_string()
    };
    let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).contains("plane");
    let measured = std::fs::read(dir.path("out.exr")).expect("an image");
    assert!(pixels(&image) == pixels(&measured) && !text(&measured), "the image does not name the points");
    let csv = || dir.run("measure room.mgf points.toml --frame 2 --csv").exits(0).stdout();
    assert_eq!(dir.read("out.readings.csv"), csv());
    let again = |rendered: u64| {
        let report = dir.run(&format!("{line} --measure points.toml --json")).exits(0).json();
        assert_eq!(report["rendered"], rendered, "{report}");
    };
    again(0);
    std::fs::remove_file(dir.path("out.readings.csv")).expect("removed");
    again(1);
    dir.write("out.readings.json", &dir.read("out.readings.json").replace("\"version\":1", "\"version\":7"));
    again(1);
    dir.write("points.toml", &POINTS.replace("spp = 2048", "spp = 288"));
    again(1);
    assert_eq!(dir.read("out.readings.csv"), csv());
}
