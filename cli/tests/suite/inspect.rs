//! Tests of `femc plan`, `femc check` and `femc compare`.

use crate::common;
use crate::common::{TestFolder, start_coordinator, submit};
use femc_model::{Graph, JobId, check_graph};
use femc_proto::Client;

#[test]
fn plan_counts_its_tasks_and_gives_reasons_for_omissions() {
    let dir = TestFolder::new();
    let plan = dir.run("plan fog.mgf --spp 16 --frames 1..3 --no-trial --json").exits(0).json();
    let tiles = plan["tiles"].as_u64().expect("a number");
    assert_eq!(plan["tasks"], 3 * (tiles + 1));
    assert!(plan["graph"]["stages"].as_array().is_some_and(|stages| stages.len() == 2), "{plan}");
    assert_eq!(plan["samples_most"], 3 * 16 * 32 * 32);
    assert_eq!(plan["frames"], serde_json::json!([1, 2, 3]));
    assert_eq!(plan["worlds"], 3, "the fog varies: {plan}");
    assert!(plan["cost"].is_null());
    let left_out = plan["left_out"].as_array().expect("a list");
    assert!(!left_out.is_empty());
    assert!(left_out.iter().all(|left| left["reason"].as_str().is_some_and(|reason| !reason.is_empty())));
}

#[test]
fn the_plan_is_the_graph_that_is_submitted() {
    let dir = TestFolder::new();
    let (_farm, url) = start_coordinator(&dir, 0);
    let runtime = tokio::runtime::Runtime::new().expect("a runtime");
    for (settings, stages) in [("--spp 16", 2), ("--error 0.1", 4), ("--time 1m --size 640x512", 4)] {
        let plan = dir.run(&format!("plan fog.mgf {settings} --no-trial --json")).exits(0).json();
        let planned: Graph = serde_json::from_value(plan["graph"].clone()).expect("a graph");
        assert_eq!((check_graph(&planned), planned.stages.len()), (Ok(()), stages), "{settings}");
        let job = JobId(submit(&dir, &url, settings).parse().expect("a number"));
        let submitted = runtime.block_on(async {
            let client = Client::connect(&url).await.expect("the farm");
            client.attempts(job).await.expect("the job").0.spec
        });
        assert_eq!(submitted.graph, planned, "{settings}");
        let shown = dir.run(&format!("plan fog.mgf {settings} --no-trial")).exits(0).stdout();
        let numbers = |line: &str| line.split_whitespace().next().is_some_and(|word| word.parse::<u16>().is_ok());
        assert!(shown.lines().filter(|line| numbers(line)).count() >= stages, "{shown}");
    }
}

#[test]
fn a_trial_estimates_the_cost_and_leaves_nothing_behind() {
    let dir = TestFolder::new();
    let plan = dir.run("plan fog.mgf --spp 16 --json").exits(0).json();
    assert!(plan["cost"]["seconds_most"].as_f64().is_some_and(|seconds| seconds > 0.0), "{plan}");
    let said = dir.run("plan fog.mgf --spp 16").exits(0).stdout();
    assert!(said.contains("estimated cost") && said.contains("left out"), "{said}");
    // If an error goal ends a frame, a pilot estimates the likely cost, between the first round and the last.
    let plan = dir.run("plan fog.mgf --error 0.1 --json").exits(0).json();
    let [least, likely, most] =
        [&plan["samples_least"], &plan["cost"]["likely"]["samples_a_pixel"], &plan["samples_most"]]
            .map(|number| number.as_f64().unwrap_or(f64::NAN));
    let edges = plan["film"].as_array().expect("a film").iter().filter_map(|edge| edge.as_f64());
    let frames = plan["frames"].as_array().map_or(0, Vec::len);
    let likely = likely * edges.product::<f64>() * frames as f64;
    assert!(least <= likely * 1.001 && likely <= most, "{plan}");
    let said = dir.run("plan fog.mgf --error 0.1").exits(0).stdout();
    assert!(said.contains("estimated cost: likely "), "{said}");
    assert_eq!(common::file_names(&dir.path(".")), ["fog.mgf"]);
}

#[test]
fn sound_scene_passes_check_and_faults_are_named_by_line() {
    let dir = TestFolder::new();
    dir.run("check fog.mgf").exits(0);
    dir.write("odd.mgf", &common::FOG.replace("m lamp =", "m spare =\n\trd .5\nm lamp ="));
    let report = dir.run("check odd.mgf --json").exits(0).json();
    let spare = report["faults"].as_array().and_then(|faults| {
        faults.iter().find(|fault| fault["message"].as_str().is_some_and(|message| message.contains("spare")))
    });
    assert_eq!(spare.map(|fault| (fault["line"].as_u64(), fault["severity"].as_str())), Some((Some(15), Some("note"))));
}

#[test]
fn a_scene_with_an_error_fails_its_check() {
    let dir = TestFolder::new();
    dir.write("lost.mgf", &common::FOG.replace("vary medium.fog", "vary medium.frog"));
    let ran = dir.run("check lost.mgf").exits(1);
    assert!(ran.stdout().contains("lost.mgf:2: error") && ran.stdout().contains("1 error"), "{}", ran.stdout());
    assert_eq!(dir.run("check lost.mgf --json").exits(1).json()["errors"], 1);
}

#[test]
fn a_fault_of_the_import_is_in_the_json_too() {
    let dir = TestFolder::new();
    dir.write("broken.mgf", "m wall =\n\trd 1.5\n");
    let report = dir.run("check broken.mgf --json").exits(1).json();
    assert_eq!((report["errors"].as_u64(), report["faults"][0]["line"].as_u64()), (Some(1), Some(2)));
}

#[test]
fn a_comparison_has_the_promised_keys() {
    let dir = TestFolder::new();
    dir.run("render fog.mgf -o a.exr --spp 2 --frames 1").exits(0);
    dir.run("render fog.mgf -o b.exr --spp 2 --frames 1 --seed 2").exits(0);
    let report = dir.run("compare a.exr b.exr --json").exits(0).json();
    for key in ["mse", "relmse", "psnr", "ssim", "flip", "mean_ratio"] {
        assert!(report[key].is_f64(), "{key}: {report}");
    }
    assert!(report["worst_pixel"]["x"].is_u64() && report["worst_pixel"]["y"].is_u64());
    assert_eq!(report["same_pixels"], false);
    let same = dir.run("compare a.exr a.exr --json").exits(0).json();
    assert_eq!((same["mse"].as_f64(), same["same_pixels"].as_bool()), (Some(0.0), Some(true)));
}

#[test]
fn images_that_cannot_be_compared_say_why() {
    let dir = TestFolder::new();
    dir.run("render fog.mgf -o a.exr --spp 1 --frames 1 --size 8x8").exits(0);
    dir.run("render fog.mgf -o b.exr --spp 1 --frames 1 --size 8x4").exits(0);
    let ran = dir.run("compare a.exr b.exr").exits(1);
    assert!(ran.stderr().contains("8x4") || ran.stderr().contains("8 x 4"), "{}", ran.stderr());
    dir.run("compare a.exr nothing.exr").exits(2);
    dir.run("compare a.exr fog.mgf").exits(1);
}
