//! Tests of light statistics: `--stats` and `femc paths`.

use crate::common::{TestFolder, TestProcess, pixels, samples_done, start_coordinator, status, submit};
use femc_pipeline::paths::histogram::{Histograms, Table};
use femc_pipeline::paths::{InteractionKind, LightPath, LightStatistics, Name, NameKind, PortionKey};

fn statistics(dir: &TestFolder, name: &str) -> LightStatistics {
    let bytes = std::fs::read(dir.path(name)).unwrap_or_else(|e| panic!("{name}: {e}"));
    LightStatistics::decode(&bytes).unwrap_or_else(|e| panic!("{name}: {e}"))
}

fn bytes(dir: &TestFolder, name: &str) -> Vec<u8> {
    std::fs::read(dir.path(name)).unwrap_or_else(|e| panic!("{name}: {e}"))
}

fn worker(dir: &TestFolder, url: &str) -> TestProcess {
    dir.start(&format!("worker --join {url} --threads 1"))
}

/// Writes the foggy box with named objects.
fn write_named_scene(dir: &TestFolder) {
    let text = crate::common::FOG.replace("m wall\nf a b c d\n", "m wall\no floor\nf a b c d\no\n");
    let text = text.replace("m lamp\nv i", "m lamp\no ceiling\no lamp\nv i") + "o\no\n";
    dir.write("box.mgf", &text);
}

#[test]
fn statistics_are_the_same_for_any_workers_and_change_no_pixel() {
    let dir = TestFolder::new();
    for (settings, rounds) in [("--spp 6", 1), ("--error 0.03 --seed 3", 2)] {
        let line = |out: &str, rest: &str| format!("render fog.mgf --frames 5 --size 48x40 {settings} -o {out} {rest}");
        dir.run(&line("without.exr", "")).exits(0);
        dir.run(&line("one.exr", "--stats --workers 1 --threads 1")).exits(0);
        dir.run(&line("three.exr", "--stats --workers 3 --threads 2")).exits(0);
        assert_eq!(pixels(&dir.path("one.exr")), pixels(&dir.path("without.exr")), "{settings}");
        assert!(bytes(&dir, "one.paths") == bytes(&dir, "three.paths"), "{settings}");
        let all = statistics(&dir, "one.paths");
        assert_eq!((all.scope.film, all.scope.frame), ([48, 40], 5));
        if rounds == 1 {
            assert_eq!(all.samples(), 48 * 40 * 6);
        } else {
            let ends: Vec<u32> = all.portions.keys().map(|portion| portion.end).collect();
            assert!(ends.iter().any(|end| *end != ends[0]), "halves and tiles end apart: {ends:?}");
        }
        let recorded = Histograms::from_statistics(&all, Table::Paths);
        assert!(recorded.attributes.iter().all(|it| it.samples.iter().sum::<u64>() == all.paths.len() as u64));
        let expected = all.samples() as f64 * all.share();
        assert!((all.paths.len() as f64 - expected).abs() < 6.0 * expected.sqrt() + 1.0, "{expected}");
        for name in ["without.exr", "one.exr", "three.exr", "one.paths", "three.paths"] {
            std::fs::remove_file(dir.path(name)).expect("a file");
        }
    }
}

#[test]
fn paths_of_many_tiles_are_united_by_groups() {
    let dir = TestFolder::new();
    // 17 x 16 tiles, which are two groups.
    let line =
        |out: &str, rest: &str| format!("render fog.mgf --frames 5 --size 272x256 --error 3 --stats -o {out} {rest}");
    dir.run(&line("one.exr", "--workers 1")).exits(0);
    dir.run(&line("three.exr", "--workers 3 --threads 1")).exits(0);
    assert!(bytes(&dir, "one.paths") == bytes(&dir, "three.paths"));
    assert_eq!(statistics(&dir, "one.paths").samples(), 272 * 256 * 8);
}

#[test]
fn a_frame_with_a_time_counts_what_its_image_counts() {
    let dir = TestFolder::new();
    dir.run("render fog.mgf --frames 5 --time 2s -o timed.exr --stats").exits(0);
    let all = statistics(&dir, "timed.paths");
    // The file states how its samples were divided. They may exclude a pilot.
    let said = femc_film::exr::read_attributes(&dir.path("timed.exr")).expect("attributes");
    let said: serde_json::Value = serde_json::from_str(&said["femc:allocation"]).expect("an allocation");
    let begin = said["begin"].as_u64().expect("a number") as u32;
    let ends = said["ends"].as_array().expect("numbers").iter().map(|end| end.as_u64().expect("a number") as u32);
    let portion = |(tile, end): (u32, u32)| [0, 1].map(|half| PortionKey { tile, half, begin, end });
    assert!((0..).zip(ends).flat_map(portion).eq(all.portions.keys().copied()), "{said}");
    assert!(all.paths.values().all(|path| path.key.sample >= begin));
}

/// Returns the seconds of the tasks that render and of the others, and the bytes sent, of a job's results.
fn task_seconds(dir: &TestFolder, url: &str, job: &str) -> ([f64; 2], u64) {
    let rows = dir.run(&format!("stats {job} --by task --json --server {url}")).exits(0).json();
    let (mut seconds, mut bytes) = ([0.0; 2], 0);
    for row in rows.as_array().expect("rows") {
        seconds[usize::from(row["stage"] != "render")] += row["wall_seconds"].as_f64().expect("a number");
        bytes += row["sent_bytes"].as_u64().expect("a number");
    }
    (seconds, bytes)
}

#[test]
fn farm_statistics_with_a_killed_worker_equal_one_process() {
    const FRAMES: u32 = 24;
    const SETTINGS: &str = "--size 40x24 --spp 6";
    let dir = TestFolder::new();
    dir.write("fog.mgf", &crate::common::FOG.replace("time 0 0.75 10", "time 0 2.3 10"));
    let (mut farm, url) = start_coordinator(&dir, 0);
    let (mut victim, _second, _third) = (worker(&dir, &url), worker(&dir, &url), worker(&dir, &url));
    let job = submit(&dir, &url, &format!("{SETTINGS} --stats"));
    let done = || status(&dir, &url, &job)["frames_done"].as_u64().expect("a number");
    farm.wait_until("a finished frame", || done() >= 1);
    assert!(done() < u64::from(FRAMES), "it is not over yet");
    assert!(victim.kill(), "the victim was alive");
    dir.run(&format!("watch {job} --server {url}")).exits(0);
    dir.run(&format!("fetch {job} -o out --server {url}")).exits(0);
    dir.run(&format!("render fog.mgf {SETTINGS} --stats -o alone --workers 1 --threads 1")).exits(0);
    let mut kept = 0;
    for frame in 1..=FRAMES {
        let name = |folder: &str| format!("{folder}/fog.{frame:04}.paths");
        assert!(bytes(&dir, &name("out")) == bytes(&dir, &name("alone")), "frame {frame}");
        assert_eq!(statistics(&dir, &name("out")).samples(), 40 * 24 * 6);
        kept += bytes(&dir, &name("out")).len();
    }
    // Compare with the same frames without statistics; with one worker less both take longer.
    let without = submit(&dir, &url, SETTINGS);
    dir.run(&format!("watch {without} --server {url}")).exits(0);
    let ([render, rest], sent) = task_seconds(&dir, &url, &job);
    let ([_, rest_without], sent_without) = task_seconds(&dir, &url, &without);
    println!(
        "24 frames: {render:.2} s rendering; images and merging {rest:.2} s, without statistics {rest_without:.2} s; \
         {sent} bytes sent, without {sent_without}; {kept} bytes of statistics kept"
    );
    let moved = (sent - sent_without) / u64::from(FRAMES);
    assert!(moved > 1 << 10 && moved < 64 << 20, "{moved} bytes a frame");
}

/// Guided paths are split where light comes through the door. A farm of three workers, one of which is killed, gives the bytes of one
/// process: pixels, records and layers.
#[test]
fn split_paths_with_a_killed_worker_equal_one_process() {
    const SETTINGS: &str = "--size 48x36 --spp 256 --method femc --stats --layers direct,indirect";
    let dir = TestFolder::new();
    let door = std::fs::read_to_string(concat!(env!("CARGO_MANIFEST_DIR"), "/../scenes/door-ajar.mgf"));
    dir.write("door.mgf", &door.expect("a scene"));
    let (_farm, url) = start_coordinator(&dir, 0);
    let (mut victim, _second, _third) = (worker(&dir, &url), worker(&dir, &url), worker(&dir, &url));
    let job = dir.run(&format!("submit door.mgf --server {url} {SETTINGS}")).exits(0).stdout().trim().to_owned();
    victim.wait_until("samples", || samples_done(&dir, &url, &job) > 0.0);
    assert!(victim.kill(), "the victim was alive");
    dir.run(&format!("watch {job} --server {url}")).exits(0);
    dir.run(&format!("fetch {job} -o out --server {url}")).exits(0);
    dir.run(&format!("render door.mgf {SETTINGS} -o alone --workers 1 --threads 1")).exits(0);
    let name = |folder: &str, kind: &str| format!("{folder}/door.0001.{kind}");
    assert!(pixels(&dir.path(&name("out", "exr"))) == pixels(&dir.path(&name("alone", "exr"))));
    for kind in ["paths", "layers.exr"] {
        assert!(bytes(&dir, &name("out", kind)) == bytes(&dir, &name("alone", kind)), "{kind}");
    }
    let recorded = statistics(&dir, "out/door.0001.paths");
    let is_split = |path: &&LightPath| (0..).zip(&path.intersections).any(|(before, it)| it.parent != before);
    assert!(recorded.paths.values().filter(is_split).count() > 100);
    let rows = dir.run("paths out/door.0001.paths --table intersections --csv").exits(0).stdout();
    assert!(rows.lines().next().is_some_and(|header| header.contains("parent")), "{rows}");
}

#[test]
fn a_frame_whose_statistics_are_gone_is_rendered_again() {
    let dir = TestFolder::new();
    let render = || dir.run("render fog.mgf --frames 2 --spp 2 --stats -o a.exr --json").exits(0).json();
    render();
    let before = bytes(&dir, "a.paths");
    std::fs::remove_file(dir.path("a.paths")).expect("a file");
    render();
    assert!(bytes(&dir, "a.paths") == before);
}

#[test]
fn frames_of_a_job_are_united_in_any_order_and_count_once() {
    let dir = TestFolder::new();
    dir.run("render fog.mgf --frames 2..3 --size 40x24 --spp 6 --stats -o clip").exits(0);
    let [a, b] = ["clip/fog.0002.paths", "clip/fog.0003.paths"];
    dir.run(&format!("paths {b} {a} {b} --out twice.paths")).exits(0);
    dir.run("paths clip --out all.paths").exits(0);
    dir.run(&format!("paths all.paths {a} --out again.paths")).exits(0);
    let expected = bytes(&dir, "all.paths");
    assert!(bytes(&dir, "twice.paths") == expected && bytes(&dir, "again.paths") == expected);
    let rows = |line: &str| -> Vec<serde_json::Value> {
        let rows = dir.run(&format!("paths {line} --json")).exits(0).json();
        rows.as_array().expect("rows").clone()
    };
    let paths: usize = [a, b].map(|name| statistics(&dir, name).paths.len()).iter().sum();
    let all = rows("all.paths");
    assert_eq!(all.len(), paths, "small frames keep all");
    let numbers: std::collections::BTreeSet<u64> = all.iter().filter_map(|row| row["path"].as_u64()).collect();
    assert_eq!(numbers.len(), paths, "a path has a number of its own");
    assert!([2, 3].iter().all(|frame| all.iter().any(|row| row["frame"] == *frame)));
    // The union is one file: its histograms cover both frames, and it has one set of representatives.
    let samples = |line: &str| -> u64 { rows(line).iter().map(|row| row["samples"].as_u64().expect("a number")).sum() };
    let [first, second] = [a, b].map(|name| samples(&format!("{name} --table histograms")));
    assert_eq!(samples("clip --union --table histograms"), first + second);
    assert_eq!(rows("all.paths --few 100").len(), 100);
    assert_eq!(rows(&format!("{a} {b} --few 100")).len(), 200);
    let found = dir.run("bottlenecks all.paths --json").exits(0).json();
    assert_eq!(found["samples"], 2 * 40 * 24 * 6);
    // The same frame of another scene does not belong to that job.
    dir.run("render fog.mgf --frames 2 --size 40x24 --spp 6 --stats -o other.exr --set medium.fog.sigma_a=0.9")
        .exits(0);
    let refused = dir.run("paths all.paths other.paths --union").exits(2);
    assert!(refused.stderr().contains("other.paths") && refused.stderr().contains("one job"), "{}", refused.stderr());
    dir.run("paths all.paths --out again.paths --csv").exits(2);
}

#[test]
fn paths_are_found_by_what_they_met() {
    let dir = TestFolder::new();
    write_named_scene(&dir);
    dir.run("render box.mgf --frames 8 --spp 8 --stats -o box.exr").exits(0);
    let all = statistics(&dir, "box.paths");
    let rows = |rest: &str| -> Vec<serde_json::Value> {
        let rows = dir.run(&format!("paths box.paths --json {rest}")).exits(0).json();
        rows.as_array().expect("rows").clone()
    };
    assert_eq!(rows("").len(), all.paths.len());
    let floor = Name::new(NameKind::Object, "floor");
    let is_low = |it: &&femc_pipeline::paths::Intersection| it.object == floor && it.bounce >= 1;
    let expected = all.paths.values().flat_map(|path| &path.intersections).filter(is_low).count();
    let ran = dir.command("paths box.paths --json --table intersections");
    let found = {
        let mut command = ran;
        command.args(["--where", "bounce >= 1 and object == floor"]);
        let output = command.output().expect("femc");
        serde_json::from_slice::<Vec<serde_json::Value>>(&output.stdout).expect("rows")
    };
    assert!(expected > 10 && found.len() == expected, "{} and {expected}", found.len());
    assert!(found.iter().all(|row| row["object"] == "floor" && row["z"].as_f64().is_some_and(|z| z.abs() < 1e-4)));
    let then = rows("--object floor --then ceiling");
    assert!(!then.is_empty() && then.len() < all.paths.len());
    let lights = rows("--table lights");
    assert!(lights.iter().any(|row| row["light"] == "ceiling.lamp/lamp" && row["found"] == "airlight"));
    let in_fog = |it: &femc_pipeline::paths::Intersection| it.interaction == InteractionKind::Volume;
    assert!(all.paths.values().any(|path| path.intersections.iter().any(in_fog)));
    let bins = rows("--table histograms");
    let depth = bins.iter().filter(|row| row["table"] == "paths" && row["attribute"] == "depth");
    let sum: u64 = depth.map(|row| row["samples"].as_u64().expect("a number")).sum();
    assert_eq!(sum, all.paths.len() as u64);
    let map = rows("--table pixels");
    let (width, height, [r, g, b, _]) =
        femc_film::exr::read_channels(&dir.path("box.exr"), ["R", "G", "B", "depth.Z"]).expect("a frame");
    assert_eq!(map.len(), (width * height) as usize);
    let number = |row: &serde_json::Value, key: &str| row[key].as_f64().expect("a number");
    for (row, ((r, g), b)) in map.iter().zip(r.iter().zip(&g).zip(&b)) {
        let luminance = f64::from(0.2126 * r + 0.7152 * g + 0.0722 * b);
        assert!((number(row, "luminance") - luminance).abs() < 1e-3 * luminance + 1e-4, "{row}: {luminance}");
        assert_eq!(row["samples"], 8);
        assert!(number(row, "variance") >= 0.0 && number(row, "depth") >= 0.0);
    }
    let depths: f64 = map.iter().map(|row| 8.0 * number(row, "depth")).sum();
    let expected: u64 = (0..).zip(all.totals().depth).map(|(depth, samples): (u64, u64)| depth * samples).sum();
    assert!((depths - expected as f64).abs() < 1e-6 * depths, "{depths} {expected}");
    assert!(!rows("--table voxels --in -1,-1,0,1,1,0.5").is_empty());
    assert!(!rows("--brightest").is_empty() && rows("--few 100").len() == 100);
}

#[test]
fn full_statistics_count_all_samples_for_any_workers() {
    let dir = TestFolder::new();
    let line = |out: &str, rest: &str| format!("render fog.mgf --frames 5 --size 96x80 --spp 6 -o {out} {rest}");
    dir.run(&line("some.exr", "--stats")).exits(0);
    dir.run(&line("one.exr", "--stats=full --workers 1")).exits(0);
    dir.run(&line("three.exr", "--stats=full --workers 3 --threads 2")).exits(0);
    assert!(bytes(&dir, "one.paths") == bytes(&dir, "three.paths"));
    assert_eq!(pixels(&dir.path("one.exr")), pixels(&dir.path("some.exr")));
    let (some, full) = (statistics(&dir, "some.paths"), statistics(&dir, "one.paths"));
    assert!(full.paths == some.paths && full.share() < 0.5, "the same paths are recorded");
    let samples = |name: &str, table: &str| {
        let rows = dir.run(&format!("paths {name} --table histograms --json")).exits(0).json();
        let mut sums = std::collections::BTreeMap::<String, u64>::new();
        for row in rows.as_array().expect("rows").iter().filter(|row| row["table"] == table) {
            let attribute = row["attribute"].as_str().expect("a name").to_owned();
            *sums.entry(attribute).or_default() += row["samples"].as_u64().expect("a number");
        }
        sums
    };
    let of = |name: &str| samples(name, "paths").into_values().collect::<std::collections::BTreeSet<u64>>();
    assert_eq!(of("one.paths"), [96 * 80 * 6].into());
    assert_eq!(of("some.paths"), [some.paths.len() as u64].into());
    let depths: u64 = (0..).zip(full.totals().depth).map(|(depth, samples): (u64, u64)| depth * samples).sum();
    assert!(samples("one.paths", "intersections").values().all(|sum| *sum == depths), "{depths}");
    // A later run with less statistics has other settings.
    dir.write("full.toml", "scene = \"fog.mgf\"\nframes = \"5\"\nspp = 2\nstats = \"full\"\n");
    dir.run("render full.toml -o job.exr").exits(0);
    assert!(statistics(&dir, "job.paths").scope.has_full_histograms);
    dir.write("half.toml", "scene = \"fog.mgf\"\nstats = \"half\"\n");
    assert!(dir.run("render half.toml -o half.exr").exits(2).stderr().contains("half.toml:2"));
}

#[test]
fn rare_and_representative_paths_and_those_in_a_box_are_listed() {
    let dir = TestFolder::new();
    write_named_scene(&dir);
    dir.run("render box.mgf --frames 8 --spp 8 --stats -o box.exr").exits(0);
    let rows = |rest: &str| -> Vec<serde_json::Value> {
        dir.run(&format!("paths box.paths --json {rest}")).exits(0).json().as_array().expect("rows").clone()
    };
    let few = rows("--few 200");
    let weights: f64 = few.iter().map(|row| row["weight"].as_f64().expect("a weight")).sum();
    assert!(few.len() == 200 && (weights - 200.0).abs() < 1e-6, "{weights}");
    let rare = rows("--rarest 20");
    assert_eq!(rare.len(), 20);
    assert!(rare.iter().all(|row| row["weight"].is_null()));
    // The rarest path is the only one in a bin of some attribute.
    let bins = rows("--table histograms");
    assert!(bins.iter().any(|row| row["table"] == "paths" && row["samples"] == 1));
    let on_floor = rows("--in floor --table intersections");
    let floor = rows("--where object==floor --table intersections");
    assert!(floor.len() > 100 && on_floor.len() >= floor.len());
    assert!(on_floor.iter().all(|row| row["z"].as_f64().is_some_and(|z| z.abs() < 1e-4)));
    let refused = |rest: &str, why: &str| {
        let said = dir.run(&format!("paths box.paths {rest}")).exits(2).stderr();
        assert!(said.contains(why), "{rest}: {said}");
    };
    refused("--in flor", "known objects");
    refused("--in 1,2,3", "six numbers");
    refused("--rarest 3 --few 4", "--few");
    refused("--minus box.paths", "--table voxels");
}

#[test]
fn variants_of_a_sweep_share_voxels_and_differ_where_light_does() {
    let dir = TestFolder::new();
    dir.write(
        "fog.toml",
        "scene = \"fog.mgf\"\nframes = \"3\"\nspp = 4\nstats = true\n[sweep]\n\"material.lamp.ed\" = [300, 900]\n",
    );
    dir.run("sweep fog.toml -o fog --local").exits(0);
    let mut files = Vec::new();
    for entry in std::fs::read_dir(dir.path("fog")).expect("a folder") {
        let path = entry.expect("an entry").path();
        let within = if path.is_dir() { crate::common::file_names(&path) } else { Vec::new() };
        files.extend(within.iter().filter(|name| name.ends_with(".paths")).map(|name| path.join(name)));
    }
    files.sort();
    let [dim, bright] = &files[..] else { panic!("a file for each variant: {files:?}") };
    let [dim, bright] = [dim, bright].map(|path| path.display().to_string());
    let rows = |rest: &str| dir.run(&format!("paths {rest} --json")).exits(0).json();
    let both = rows(&format!("{dim} {bright} --table voxels"));
    let of = |file: &str| -> Vec<[String; 4]> {
        let own = both.as_array().expect("rows").iter().filter(|row| row["file"] == file);
        own.map(|row| ["x", "y", "z", "bounce"].map(|key| row[key].to_string())).collect()
    };
    assert!(of(&dim).len() > 100 && of(&dim) == of(&bright), "the same paths are in the same voxels");
    let differences = rows(&format!("{bright} --table voxels --minus {dim}"));
    for row in differences.as_array().expect("rows") {
        let number = |key: &str| row[key].as_f64().expect("a number");
        assert_eq!(row["intersections"], row["intersections_there"]);
        assert!((number("energy") - 3.0 * number("energy_there")).abs() <= 1e-4 * number("energy"), "{row}");
        let difference = number("energy") - number("energy_there");
        assert!((number("difference") - difference).abs() <= 1e-9 * number("energy"), "{row}");
    }
    // Only frames whose statistics are missing are rendered again.
    std::fs::remove_file(&bright).expect("a file");
    dir.run("sweep fog.toml -o fog --local").exits(0);
    assert!(std::path::Path::new(&bright).is_file());
    dir.run(&format!("bottlenecks {dim} {bright}")).exits(0);
}

/// Returns rows of JSON as the command prints them.
fn json_rows(dir: &TestFolder, line: &str) -> Vec<serde_json::Value> {
    dir.run(&format!("{line} --json")).exits(0).json().as_array().expect("rows").clone()
}

fn number(row: &serde_json::Value, column: &str) -> f64 {
    row[column].as_f64().unwrap_or_else(|| panic!("no number {column} in {row}"))
}

#[test]
fn light_in_numbers_is_the_sum_over_the_tables() {
    let dir = TestFolder::new();
    write_named_scene(&dir);
    let mut dim = dir.read("box.mgf");
    dim = dim.replace("ed 300", "ed 150");
    dir.write("dim.mgf", &dim);
    for name in ["box", "dim"] {
        dir.run(&format!("render {name}.mgf -o {name}.exr --size 32x24 --spp 64 --frames 5 --stats")).exits(0);
    }
    let luminance = |row: &serde_json::Value| {
        0.212_639 * number(row, "radiance_r")
            + 0.715_169 * number(row, "radiance_g")
            + 0.072_192 * number(row, "radiance_b")
    };
    let pixels: f64 = json_rows(&dir, "paths box.paths").iter().map(|row| number(row, "pixels")).sum();
    for condition in ["", "--where depth>=2", "--where bounce==0 --object floor"] {
        let rows = json_rows(&dir, &format!("paths box.paths {condition} --by object,bounce,lamp"));
        let paths = json_rows(&dir, &format!("paths box.paths {condition}"));
        let all: f64 = paths.iter().map(|row| luminance(row) * number(row, "pixels")).sum::<f64>() / pixels;
        let is_near = |a: f64, b: f64| (a - b).abs() <= 1e-5 * b;
        assert!(is_near(number(&rows[0], "light"), all), "{condition}: {}, not {all}", rows[0]);
        assert_eq!(rows[0]["paths"], paths.len(), "{condition}");
        let lights = json_rows(&dir, &format!("paths box.paths {condition} --table lights"));
        for lamp in rows.iter().filter(|row| row["by"] == "lamp") {
            let own = lights.iter().filter(|row| row["light"] == lamp["name"]);
            let sum: f64 = own.clone().map(|row| luminance(row) * number(row, "pixels")).sum::<f64>() / pixels;
            assert!(is_near(number(lamp, "light"), sum), "{condition}: {lamp}, not {sum}");
            assert_eq!(lamp["records"], own.count(), "{condition}: {lamp}");
        }
        let hits = json_rows(&dir, &format!("paths box.paths {condition} --table intersections"));
        for object in rows.iter().filter(|row| row["by"] == "object" && !row["name"].to_string().contains('(')) {
            let own = hits.iter().filter(|row| {
                let text = row["object"].as_str().unwrap_or_default();
                let name = object["name"].as_str().unwrap();
                text.strip_prefix(name).is_some_and(|rest| rest.is_empty() || rest.starts_with('.'))
            });
            let energy = |row: &serde_json::Value| {
                (number(row, "radiance_r") + number(row, "radiance_g") + number(row, "radiance_b")) / 3.0
            };
            let mean = own.clone().map(energy).sum::<f64>() / own.clone().count() as f64;
            assert_eq!(object["records"], own.count(), "{condition}: {object}");
            assert!((number(object, "energy") - mean).abs() <= 1e-5 * mean, "{condition}: {object}, not {mean}");
        }
    }
    // The dim box has half of the light, by each lamp and at each bounce.
    let rows = json_rows(&dir, "paths box.paths --by object,bounce,lamp --minus dim.paths");
    for row in &rows {
        let (a, b) = (number(row, "light"), number(row, "light_there"));
        assert!((number(row, "difference") - (a - b)).abs() <= 1e-9 * a, "{row}");
    }
    let ratio = number(&rows[0], "ratio");
    assert!(number(&rows[0], "ratio_low") < 2.0 && 2.0 < number(&rows[0], "ratio_high"), "{}", rows[0]);
    assert!((ratio - 2.0).abs() < 0.4 && rows[0]["differs"] == "yes", "{}", rows[0]);
    let same = json_rows(&dir, "paths box.paths --by lamp --minus box.paths");
    assert!(same.iter().all(|row| number(row, "difference") == 0.0 && row["differs"] != "yes"), "{same:?}");
}

#[test]
fn tables_are_files_that_other_programs_read() {
    let dir = TestFolder::new();
    dir.run("render fog.mgf --frames 3 --spp 4 --stats -o a.exr").exits(0);
    let all = statistics(&dir, "a.paths");
    for table in ["paths", "intersections", "lights", "histograms", "pairs", "voxels"] {
        dir.run(&format!("paths a.paths --table {table} --parquet {table}.parquet")).exits(0);
        let csv = dir.run(&format!("paths a.paths --table {table} --csv")).exits(0).stdout();
        let file = std::fs::read(dir.path(&format!("{table}.parquet"))).expect("a file");
        assert!(file.starts_with(b"PAR1") && file.ends_with(b"PAR1"), "{table}");
        assert!(csv.lines().count() > 10, "{table}");
        if table == "paths" {
            assert_eq!(csv.lines().count(), all.paths.len() + 1);
        }
    }
}

#[test]
fn report_page_shows_maps_and_histograms_without_any_request() {
    let dir = TestFolder::new();
    write_named_scene(&dir);
    dir.run("render box.mgf --frames 1..2 --spp 4 --stats -o out").exits(0);
    assert!(dir.run("report out/box.0001.paths").exits(0).stdout().contains("box.0001.html"));
    let page = dir.read("out/box.0001.html");
    assert_eq!(page.matches("<svg").count(), 3, "histograms of paths, intersections and lights");
    for (title, pictures) in [("Luminance, cd/m2", 1), ("Standard deviation", 1), ("Intersections of a path", 1)] {
        assert_eq!(page.matches(&format!("<figcaption>{title}")).count(), pictures, "{title}");
    }
    for outside in ["src=\"http", "href=", "@import", "url("] {
        assert!(!page.contains(outside), "{outside} asks for something");
    }
    // The pictures have the pixels of the film.
    let (_, rest) = page.split_once("src=\"data:image/png;base64,").expect("a picture");
    assert!(rest.starts_with("iVBORw0KGgo"), "a PNG: {}", &rest[..20]);
    assert!(page.contains("ceiling") && page.contains("most work:"), "what stands out, and where");
    dir.run("report out/box.0001.paths out/box.0002.paths -o two.html").exits(0);
    assert_eq!(dir.read("two.html").matches("<img").count(), 8);
    assert!(dir.run("report out/box.0001.paths 7").exits(2).stderr().contains("shows either"));
    dir.run("report out/box.0003.paths").exits(2);
}

#[test]
fn what_cannot_be_asked_is_refused_with_the_place() {
    let dir = TestFolder::new();
    write_named_scene(&dir);
    dir.run("render box.mgf --frames 1 --spp 1 --stats -o box.exr").exits(0);
    let refused = |rest: &str, code: i32, why: &str| {
        let said = dir.run(&format!("paths {rest}")).exits(code).stderr();
        assert!(said.contains(why), "{rest}: {said}");
    };
    refused("box.paths --where depth", 2, "--where: column 6");
    refused("box.paths --where colour==2", 2, "column 1: unknown name \"colour\"");
    refused("box.paths --object flor", 2, "known objects");
    refused("box.paths --then floor", 2, "--object");
    refused("box.paths --in 1,1,1,0,0,0", 2, "lower corner");
    refused("box.paths --by colour", 2, "possible values: object, bounce, lamp");
    refused("box.paths --by lamp --table lights", 2, "--table");
    refused("box.paths --by lamp --brightest", 2, "--brightest");
    refused("box.paths box.paths --by lamp --minus box.paths", 2, "--minus");
    refused("box.paths --minus box.paths", 2, "--by");
    refused("nothing.paths", 2, "nothing.paths");
    refused("box.exr", 1, "invalid light statistics: wrong magic number");
}
