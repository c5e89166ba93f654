//! Tests of `femc fireflies`.

use crate::common::TestFolder;

/// A chrome plate reflects the light of a small bright lamp down to the floor. The lamp is turned away from everything else, so
/// paths only hit it by chance.
const CAUSTIC: &str = "\
camera main =
\torigin 0 -3 1.5
\ttarget 0 0 0.2
\tfov 40
\tfilm 32 32
m floor =
\tsides 2
\trd 0.5
m chrome =
\tsides 2
\trs 0.9 0
m bulb =
\ted 1e4
v a =
\tp -1 -1 0
v b =
\tp 1 -1 0
v c =
\tp 1 1 0
v d =
\tp -1 1 0
o ground
m floor
f a b c d
o
v e =
\tp -1 -1 2
v f =
\tp 1 -1 2
v g =
\tp 1 1 2
v h =
\tp -1 1 2
o plate
m chrome
f e f g h
o
v i =
\tp -0.1 -0.1 1
v j =
\tp 0.1 -0.1 1
v k =
\tp 0.1 0.1 1
v l =
\tp -0.1 0.1 1
o upward
m bulb
f i j k l
o
";

fn sum(list: &serde_json::Value, key: &str) -> f64 {
    list.as_array().expect("a list").iter().map(|origin| origin[key].as_f64().expect("a number")).sum()
}

#[test]
fn the_account_names_what_was_planted() {
    let dir = TestFolder::new();
    dir.write("caustic.mgf", CAUSTIC);
    dir.run("render caustic.mgf -o a.exr --spp 16").exits(0);
    let report = dir.run("fireflies a.exr caustic.mgf --blocks 2 --json").exits(0).json();
    let first = &report["origins"][0];
    assert!(first["share"].as_f64().is_some_and(|share| share > 0.8), "{first}");
    assert_eq!(first["how"], "lamp met behind a mirror or glass");
    assert_eq!((first["on"]["object"].as_str(), first["on"]["material"].as_str()), (Some("plate"), Some("chrome")));
    assert_eq!((first["lamp"]["name"].as_str(), first["lamp"]["object"].as_str()), (Some("bulb"), Some("upward")));
    let path = first["brightest"]["path"].as_array().expect("a path");
    assert_eq!(path.len(), 3, "floor, plate, lamp: {first}");
    assert_eq!((&path[0]["object"], &path[1]["object"]), (&"ground".into(), &"plate".into()));
    assert_eq!(report["decisions"], serde_json::Value::Null);
    let decisions =
        &dir.run("fireflies a.exr caustic.mgf --blocks 1 --decisions=4 --json").exits(0).json()["decisions"];
    assert!((sum(&decisions["parts"], "share") - 1.0).abs() < 1e-9, "{decisions}");
    assert_eq!(decisions["samples"], 4 * 256);
    // Light that arrives by way of the mirror is found by directions alone.
    assert_eq!(decisions["parts"][0]["decision"], "direction", "{decisions}");
    let table = dir.run("fireflies a.exr caustic.mgf --blocks 1 --decisions=4").exits(0).stdout();
    assert!(table.contains("by the spread of the samples"), "{table}");
    let said = dir.run("fireflies a.exr caustic.mgf").exits(0).stdout();
    assert!(said.contains("chrome of plate") && said.contains("bulb of upward, caustic.mgf:"), "{said}");
}

#[test]
fn firefly_shares_sum_to_all_variance_and_all_light() {
    let dir = TestFolder::new();
    for (name, settings) in [("s.exr", "--spp 7"), ("e.exr", "--error 0.12"), ("t.exr", "--time 1s")] {
        dir.run(&format!("render fog.mgf -o {name} --frames 2 {settings}")).exits(0);
        let report = dir.run(&format!("fireflies {name} fog.mgf --json")).exits(0).json();
        assert_eq!((&report["unlike"], &report["pixels"]), (&0.into(), &1024.into()), "{settings}");
        assert_eq!(report["blocks"].as_array().map(Vec::len), Some(4), "{settings}");
        let origins = &report["origins"];
        assert!((sum(origins, "share") - 1.0).abs() < 1e-6, "{settings}: {origins}");
        assert!((sum(origins, "light") - 1.0).abs() < 1e-6, "{settings}: {origins}");
    }
}

/// Checks that guided sampling is a technique of its own in a guided frame, and in no other.
#[test]
fn light_that_came_by_a_guided_direction_is_named() {
    let dir = TestFolder::new();
    let door = std::fs::read_to_string(concat!(env!("CARGO_MANIFEST_DIR"), "/../scenes/door-ajar.mgf"));
    dir.write("door.mgf", &door.expect("a scene"));
    for (method, is_guided) in [("femc", true), ("pt", false)] {
        dir.run(&format!("render door.mgf -o {method}.exr --size 32x32 --spp 8 --method {method}")).exits(0);
        let report = dir.run(&format!("fireflies {method}.exr door.mgf --json")).exits(0).json();
        assert_eq!(report["unlike"], 0, "{method}");
        let origins = report["origins"].as_array().expect("a list");
        let guided: Vec<_> = origins.iter().filter(|origin| origin["guided"] == true).collect();
        assert_eq!(!guided.is_empty(), is_guided, "{method}: {origins:?}");
        assert!(guided.iter().all(|origin| origin["bounce"].as_u64() >= Some(1)), "{guided:?}");
        assert!((sum(&report["origins"], "share") - 1.0).abs() < 1e-6, "{method}");
        let said = dir.run(&format!("fireflies {method}.exr door.mgf")).exits(0).stdout();
        assert_eq!(said.contains(", guided"), is_guided, "{said}");
    }
}

#[test]
fn a_frame_that_cannot_be_traced_again_says_why() {
    let dir = TestFolder::new();
    dir.run("render fog.mgf -o a.exr --frames 1 --spp 1").exits(0);
    let refused = |line: &str, code: i32, says: &str| {
        let ran = dir.run(line).exits(code);
        assert!(ran.stderr().contains(says), "{line}: {}", ran.stderr());
    };
    refused("fireflies nothing.exr fog.mgf", 2, "no such file");
    refused("fireflies fog.mgf fog.mgf", 1, "fog.mgf");
    dir.write("caustic.mgf", CAUSTIC);
    refused("fireflies a.exr caustic.mgf", 2, "another scene");
    refused("fireflies a.exr fog.mgf --blocks 0", 2, "--blocks");
}
