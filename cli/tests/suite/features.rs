//! Tests of features (first-hit AOVs) of frames, beside or without layers of the light.

use crate::common::{TestFolder, TestProcess, start_coordinator, submit};
use femc_film::exr::{read, read_channels};
use femc_pipeline::cryptomatte;
use std::collections::BTreeMap;

const ALL: &str = "normal,position,depth,albedo,motion,object,material";

fn bytes(dir: &TestFolder, name: &str) -> Vec<u8> {
    std::fs::read(dir.path(name)).unwrap_or_else(|error| panic!("{name}: {error}"))
}

fn worker(dir: &TestFolder, url: &str) -> TestProcess {
    dir.start(&format!("worker --join {url} --threads 1"))
}

#[test]
fn farm_features_equal_one_process_with_and_without_layers() {
    let dir = TestFolder::new();
    dir.write("fog.mgf", crate::common::FOG);
    let (_farm, url) = start_coordinator(&dir, 0);
    let _workers = [0; 3].map(|_| worker(&dir, &url));
    for (names, out) in [(format!("{ALL},direct"), "both"), (ALL.to_owned(), "alone")] {
        let settings = format!("--size 40x24 --error 0.3 --frames 1..2 --layers {names}");
        let job = submit(&dir, &url, &settings);
        dir.run(&format!("watch {job} --server {url}")).exits(0);
        dir.run(&format!("fetch {job} -o {out} --server {url}")).exits(0);
        dir.run(&format!("render fog.mgf {settings} -o {out}-here --workers 1 --threads 2")).exits(0);
        for frame in 1..=2 {
            let name = |folder: &str| format!("{folder}/fog.{frame:04}.layers.exr");
            assert!(bytes(&dir, &name(out)) == bytes(&dir, &name(&format!("{out}-here"))), "{out}, frame {frame}");
        }
    }
    let [both, alone] = ["both", "alone"].map(|out| dir.path(&format!("{out}/fog.0002.layers.exr")));
    let picture = read(&dir.path("alone/fog.0002.exr")).expect("a picture").image;
    assert_eq!(read(&alone).expect("features").image, picture, "the file has the picture's colors");
    for channel in ["normal.X", "position.Z", "depth.Z", "albedo.G", "coverage.A", "crypto_material00.B"] {
        let read = |file| read_channels(file, [channel]).expect(channel).2;
        let values = read(&alone);
        assert!(values == read(&both), "{channel}");
        assert!(values[0].iter().any(|value| *value != 0.0), "{channel}");
    }
    assert!(read_channels(&alone, ["direct.R"]).is_err());
    let attributes = read(&alone).expect("features").attributes;
    let text = |layer: &str, what: &str| attributes[&cryptomatte::metadata_key(layer, what)].as_str();
    assert_eq!(text("crypto_material", "name"), "crypto_material");
    assert_eq!(text("crypto_material", "hash"), "MurmurHash3_32");
    assert_eq!(text("crypto_material", "conversion"), "uint32_to_float32");
    let id = |name: &str| format!("{:08x}", cryptomatte::id(name));
    let manifest: BTreeMap<String, String> = serde_json::from_str(text("crypto_material", "manifest")).expect("JSON");
    assert_eq!(manifest, ["lamp", "wall"].map(|name| (name.to_owned(), id(name))).into());
    // No surface belongs to an object there.
    assert_eq!(text("crypto_object", "manifest"), r#"{"default":"42c9679f"}"#);
}

#[test]
fn job_file_names_features_and_feature_names_are_not_layers() {
    let dir = TestFolder::new();
    let text = "scene = \"fog.mgf\"\nsize = \"24x16\"\nspp = 4\nframes = 1\nmethod = \"fem\"\nlayers = [\"depth\"]\n";
    dir.write("job.toml", text);
    let report = dir.run("render job.toml -o out.exr --json").exits(0).json();
    assert_eq!(report["layers"], serde_json::json!(["out.layers.exr"]));
    let report = dir.run("render job.toml -o out.exr --json").exits(0).json();
    assert_eq!(report["rendered"], 0, "it is there");
    assert!(read_channels(&dir.path("out.layers.exr"), ["depth.Z"]).is_ok());
    // A different feature makes it a different frame.
    let report = dir.run("render job.toml -o out.exr --layers normal --json").exits(0).json();
    assert_eq!(report["rendered"], 1);
    assert!(read_channels(&dir.path("out.layers.exr"), ["depth.Z", "normal.Z"]).is_ok());
    let ran = dir.run("render fog.mgf -o out.exr --layers normals").exits(2);
    assert!(ran.stderr().contains("unknown layers `normals`") && ran.stderr().contains("surfaces, normal, "));
    let ran = dir.run("render fog.mgf -o out.exr --layer depth=CL").exits(2);
    assert!(ran.stderr().contains("`depth`: the file already has channels with this name"), "{}", ran.stderr());
}

/// The solution of the first pass states its error. Path tracing has no such error.
#[test]
fn frames_of_the_first_pass_have_its_stated_error_as_a_layer() {
    let dir = TestFolder::new();
    dir.write("fog.mgf", crate::common::FOG);
    let channel = |method: &str, out: &str| {
        let settings = format!("--size 24x16 --spp 4 --frames 1 --method {method} --layers first_pass_error");
        dir.run(&format!("render fog.mgf -o {out}.exr {settings}")).exits(0);
        read_channels(&dir.path(&format!("{out}.layers.exr")), ["first_pass_error.Y"]).expect("a layer").2
    };
    let [[fem], [pt]] = [("fem", "solution"), ("pt", "paths")].map(|(method, out)| channel(method, out));
    let picture = read(&dir.path("solution.exr")).expect("a picture").image;
    let light: f32 = (0..fem.len()).map(|pixel| picture.luminance(pixel)).sum();
    let share = fem.iter().sum::<f32>() / light;
    assert!(fem.iter().all(|error| error.is_finite() && *error >= 0.0), "{fem:?}");
    assert!((1e-3..0.5).contains(&share), "{share}");
    assert!(pt.iter().all(|error| *error == 0.0), "{pt:?}");
}
