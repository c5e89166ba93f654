//! Tests of `femc bench`.

use crate::common;
use crate::common::{TestFolder, file_names};
use serde_json::Value;

/// Creates a folder with `ref_A.exr` and `ref_B.exr`, independent halves of a reference of 24 x 16 pixels.
fn with_reference() -> TestFolder {
    let dir = TestFolder::new();
    for (half, seed) in [("A", 101), ("B", 102)] {
        dir.run(&format!("render fog.mgf -o ref_{half}.exr --frames 1 --size 24x16 --spp 256 --seed {seed}")).exits(0);
    }
    dir
}

const BENCH: &str = "bench fog.mgf --reference ref.exr --size 24x16 --spp 1,4 --error 0.8 --seeds 3";

fn runs(document: &Value) -> &Vec<Value> {
    document["runs"].as_array().expect("runs")
}

fn number(value: &Value) -> f64 {
    value.as_f64().unwrap_or_else(|| panic!("{value} is no number"))
}

/// Checks that a first pass is solved once per method, that its time is part of the frames' times, and that its light is in the
/// pixels.
#[test]
fn first_pass_light_and_seconds_count_in_the_measured_method() {
    let dir = with_reference();
    let line = "bench fog.mgf --reference ref.exr --size 24x16 --methods pt,fem,femc --spp 4,16 --seeds 1 --json";
    let document = dir.run(line).exits(0).json();
    let of = |method: &str| runs(&document).iter().filter(|run| run["method"] == method).collect::<Vec<_>>();
    for method in ["fem", "femc"] {
        let first: Vec<f64> = of(method).iter().map(|run| number(&run["first_pass_seconds"])).collect();
        assert!(first.len() == 2 && first[0] > 0.0 && first[0].total_cmp(&first[1]).is_eq(), "{method}: {first:?}");
        for (run, paths) in of(method).iter().zip(of("pt")) {
            assert!(number(&run["seconds"]) > first[0], "{run}");
            assert_ne!(run["mse"], paths["mse"], "the same samples as path tracing: {run}");
            assert_eq!(number(&paths["first_pass_seconds"]), 0.0);
        }
        // `femc bench` renders the same pixels as `femc render`.
        dir.run(&format!("render fog.mgf -o {method}.exr --frames 1 --size 24x16 --spp 4 --method {method}")).exits(0);
        let line =
            format!("bench fog.mgf --reference {method}.exr --size 24x16 --methods {method} --spp 4 --seeds 1 --json");
        let same = dir.run(&line).exits(0).json();
        assert_eq!(number(&runs(&same)[0]["mse"]), 0.0, "{same}");
    }
}

#[test]
fn errors_fall_with_budget_and_report_names_machine_and_seeds() {
    let dir = with_reference();
    let ran = dir.run(&format!("{BENCH} --report page.html")).exits(0);
    for said in ["machine: ", "threads: ", "build: femc ", "seeds: 1 to 3", "4 spp", "error 0.8", "geometric means"] {
        assert!(ran.stdout().contains(said), "{said}: {}", ran.stdout());
    }
    assert!(ran.stderr().contains("9/9") || ran.stderr().is_empty(), "progress alone: {}", ran.stderr());

    let document = dir.run(&format!("{BENCH} --json --threads 1")).exits(0).json();
    assert_eq!(runs(&document).len(), 9, "3 budgets, 3 seeds");
    assert_eq!(
        (&document["setup"]["threads"], &document["summary"]["seeds"]),
        (&1.into(), &serde_json::json!([1, 2, 3]))
    );
    for run in runs(&document) {
        let pixels = 24.0 * 16.0;
        assert!(number(&run["samples"]) == number(&run["spp"]) * pixels && number(&run["rays"]) > pixels, "{run}");
        assert!(number(&run["seconds"]) > 0.0 && number(&run["cpu_seconds"]) > 0.0, "{run}");
    }
    let scene = &document["summary"]["scenes"][0];
    let noise = number(&scene["reference_noise"]["relmse"]);
    let points = scene["points"].as_array().expect("points");
    let relmse = |place: usize| number(&points[place]["relmse"]["mean"]);
    assert!(noise > 0.0 && noise < 0.2 * relmse(1), "{noise} of {}", relmse(1));
    // Four times the samples give about a quarter of the error.
    assert!((2.0..8.0).contains(&(relmse(0) / relmse(1))), "{} and {}", relmse(0), relmse(1));
    let measured: Vec<f64> = (runs(&document).iter())
        .filter(|run| run["method"] == "pt" && run["budget"] == 4.0)
        .map(|run| number(&run["relmse"]))
        .collect();
    let mean = measured.iter().sum::<f64>() / 3.0 - noise;
    assert!((mean / relmse(1) - 1.0).abs() < 1e-9, "the reference's noise is taken off: {mean}, {}", relmse(1));
    assert_eq!(document["summary"]["methods"][1]["method"], "adaptive");

    let page = dir.read("page.html");
    assert!(
        page.matches("<svg").count() == 2 && page.matches("<circle").count() >= 9,
        "a large plot and three small ones"
    );
    assert!(page.contains("<title>pt, 4 spp: ") && page.contains("Seeds") && page.contains("Threads"));
    let asks = page.replace("xmlns=\"http://www.w3.org/2000/svg\"", "");
    for word in ["http", "src=", "href=", "url(", "@import", "<script"] {
        assert!(!asks.contains(word), "a page that opens without a network has no {word}");
    }
}

#[test]
fn the_frames_that_are_timed_are_those_of_render() {
    let dir = TestFolder::new();
    for (method, stop) in [("pt", "--spp 4"), ("adaptive", "--error 0.6")] {
        dir.run(&format!("render fog.mgf -o {method}.exr --frames 1 {stop} --seed 7")).exits(0);
        let line =
            format!("bench fog.mgf --reference {method}.exr --methods {method} {stop} --seed 7 --seeds 1 --json");
        let ran = dir.run(&line).exits(0);
        assert_eq!(number(&runs(&ran.json())[0]["mse"]), 0.0, "{method}");
        assert!(ran.stderr().contains("the noise of the reference is unknown"), "{}", ran.stderr());
    }
}

#[test]
fn what_is_measured_is_kept_and_not_measured_again() {
    let dir = with_reference();
    dir.run(&format!("{BENCH} -o bench.json")).exits(0);
    let first: Value = serde_json::from_str(&dir.read("bench.json")).expect("JSON");
    let again = dir.run(&format!("{BENCH} -o bench.json --json")).exits(0).json();
    // The times differ between runs and are not compared.
    assert_eq!(runs(&first), runs(&again));
    let more = dir.run(&format!("{} -o bench.json --json", BENCH.replace("--seeds 3", "--seeds 4"))).exits(0).json();
    assert_eq!(&runs(&more)[..9], &runs(&first)[..]);
    assert_eq!(runs(&more).len(), 12);
    let fewer =
        dir.run("bench fog.mgf --reference ref.exr --size 24x16 --methods pt --spp 4 -o bench.json --seeds 2 --json");
    let fewer = fewer.exits(0).json();
    assert_eq!(fewer["summary"]["scenes"][0]["points"].as_array().expect("points").len(), 1);
    assert_eq!(runs(&fewer).len(), 12, "what is not asked for stays");
    assert_eq!(file_names(&dir.path(".")), ["bench.json", "fog.mgf", "ref_A.exr", "ref_B.exr"]);
}

#[test]
fn results_of_another_setup_are_refused_with_the_differences() {
    let dir = with_reference();
    let line = "bench fog.mgf --reference ref.exr --size 24x16 --methods pt --spp 1 --seeds 1 -o bench.json";
    dir.run(&format!("{line} --threads 1")).exits(0);
    let before = dir.read("bench.json");
    for (flags, said) in [
        ("--threads 2", "threads: 1 in the file, 2 now"),
        ("--threads 1 --set medium.fog.sigma_s=0.5", "fog: scene's content: "),
        ("--threads 1 --max-depth 3", "fog: settings: "),
    ] {
        let ran = dir.run(&format!("{line} {flags}")).exits(2);
        assert!(ran.stderr().contains(said) && ran.stderr().contains("bench.json"), "{flags}: {}", ran.stderr());
    }
    dir.run("render fog.mgf -o ref.exr --frames 1 --size 24x16 --spp 1").exits(0);
    let ran = dir.run(&format!("{line} --threads 1")).exits(2);
    assert!(ran.stderr().contains("beside it are not its halves"), "{}", ran.stderr());
    let ran = dir.run(&format!("{} --threads 1", line.replace("ref.exr", "ref_A.exr,ref.exr"))).exits(2);
    assert!(ran.stderr().contains("reference's pixels"), "{}", ran.stderr());
    assert_eq!(dir.read("bench.json"), before, "what was refused changes nothing");
    dir.write("bench.json", "{}");
    let ran = dir.run(&line.replace("ref.exr", "ref_A.exr,ref_B.exr")).exits(1);
    assert!(ran.stderr().contains("not measurements of `femc bench`"), "{}", ran.stderr());
}

#[test]
fn wrong_usage_names_what_there_is() {
    let dir = with_reference();
    dir.write("b.mgf", common::FOG);
    for (line, said) in [
        ("bench fog.mgf", "--reference"),
        ("bench fog.mgf --reference ref.exr --methods pt,magic", "methods: pt, adaptive"),
        ("bench fog.mgf --reference ref.exr --spp 1,0", "--spp"),
        ("bench fog.mgf --reference ref.exr --error 20", "--error"),
        ("bench fog.mgf --reference ref.exr --seeds 0", "--seeds"),
        ("bench fog.mgf b.mgf --reference ref.exr", "1 reference for 2 scenes"),
        ("bench fog.mgf --reference ref.exr ref.exr", "2 references for 1 scene"),
        (
            "bench fog.mgf --reference ref.exr",
            "the film has 32x32 pixels, the reference ref.exr 24x16; give --size 24x16",
        ),
        ("bench fog.mgf --reference lost.exr", "lost.exr: no such file"),
        ("bench fog.mgf --reference a,b,c", "A.exr,B.exr"),
        ("bench fog.mgf --reference ref.exr --frames 1..2 --size 24x16", "--frames"),
        ("bench fog.mgf fog.mgf --reference ref.exr ref.exr --size 24x16", "two scenes are named fog"),
    ] {
        let ran = dir.run(line).exits(2);
        assert!(ran.stderr().contains(said), "{line}: {}", ran.stderr());
        assert_eq!(ran.stdout(), "", "{line}: errors go to stderr");
    }
}
