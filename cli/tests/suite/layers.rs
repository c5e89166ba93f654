//! Tests of layers: their file lies beside the frame, a farm makes the same bytes as one process, and the layers sum up to the
//! picture.

use crate::common::{TestFolder, TestProcess, start_coordinator, status, submit};
use femc_film::exr::{read, read_channels};

fn bytes(dir: &TestFolder, name: &str) -> Vec<u8> {
    std::fs::read(dir.path(name)).unwrap_or_else(|error| panic!("{name}: {error}"))
}

fn worker(dir: &TestFolder, url: &str) -> TestProcess {
    dir.start(&format!("worker --join {url} --threads 1"))
}

/// Checks that the layers `names` of a frame sum up to its picture.
fn assert_layers_sum_up(dir: &TestFolder, frame: &str, names: &[&str]) {
    let picture = read(&dir.path(&format!("{frame}.exr"))).expect("a picture").image;
    let file = dir.path(&format!("{frame}.layers.exr"));
    assert_eq!(read(&file).expect("layers").image, picture, "the file of layers has the picture's colors");
    for (channel, letter) in ["R", "G", "B"].into_iter().enumerate() {
        let mut sums = vec![0.0; picture.pixels.len()];
        for name in names {
            let channels = [&*format!("{name}.{letter}"), &*format!("{name}.variance.{letter}")];
            let (_, _, [colors, variances]) = read_channels(&file, channels).expect("channels");
            sums.iter_mut().zip(&colors).for_each(|(sum, color)| *sum += f64::from(*color));
            assert!(variances.iter().any(|variance| *variance > 0.0), "{name}.{letter} has no noise");
        }
        for (sum, pixel) in sums.iter().zip(&picture.pixels) {
            let wanted = f64::from(pixel[channel]);
            assert!((sum - wanted).abs() <= 1e-6 * wanted, "{frame} {names:?}: {sum}, not {wanted}");
        }
    }
}

#[test]
fn farm_layers_with_a_killed_worker_equal_one_process() {
    const FRAMES: u32 = 12;
    const SETTINGS: &str = "--size 40x24 --error 0.2 --layers direct,indirect,fog,surfaces,lamps,guides";
    let dir = TestFolder::new();
    dir.write("fog.mgf", &crate::common::FOG.replace("time 0 0.75 10", "time 0 1.1 10"));
    let (mut farm, url) = start_coordinator(&dir, 0);
    let (mut victim, _second, _third) = (worker(&dir, &url), worker(&dir, &url), worker(&dir, &url));
    let job = submit(&dir, &url, SETTINGS);
    let done = || status(&dir, &url, &job)["frames_done"].as_u64().expect("a number");
    farm.wait_until("a finished frame", || done() >= 1);
    assert!(done() < u64::from(FRAMES), "it is not over yet");
    assert!(victim.kill(), "the victim was alive");
    dir.run(&format!("watch {job} --server {url}")).exits(0);
    dir.run(&format!("fetch {job} -o out --server {url}")).exits(0);
    dir.run(&format!("render fog.mgf {SETTINGS} -o alone --workers 1 --threads 1")).exits(0);
    for frame in 1..=FRAMES {
        let name = |folder: &str| format!("{folder}/fog.{frame:04}.layers.exr");
        assert!(bytes(&dir, &name("out")) == bytes(&dir, &name("alone")), "frame {frame}");
        for parts in [["direct", "indirect"], ["fog", "surfaces"]] {
            assert_layers_sum_up(&dir, &format!("out/fog.{frame:04}"), &parts);
        }
        assert_layers_sum_up(&dir, &format!("out/fog.{frame:04}"), &["full"]);
    }
}

#[test]
fn layers_of_a_timed_frame_have_only_the_counted_samples() {
    let dir = TestFolder::new();
    dir.run("render fog.mgf --frames 5 --time 2s -o timed.exr --layers direct,indirect").exits(0);
    assert_layers_sum_up(&dir, "timed", &["direct", "indirect"]);
}

#[test]
fn a_job_file_names_layers_and_pictures_have_one_png_each() {
    let dir = TestFolder::new();
    let text = "scene = \"fog.mgf\"\nsize = \"24x16\"\nspp = 4\nframes = 1\nlayers = [\"direct\", \"indirect\"]\n\
                [layer]\nseen = \"CL\"\n";
    dir.write("job.toml", text);
    dir.run("render job.toml -o out.exr").exits(0);
    assert_layers_sum_up(&dir, "out", &["direct", "indirect"]);
    // A frame without its layers counts as missing.
    std::fs::remove_file(dir.path("out.layers.exr")).expect("layers");
    let report = dir.run("render job.toml -o out.exr --json").exits(0).json();
    assert_eq!((&report["rendered"], &report["layers"][0]), (&1.into(), &"out.layers.exr".into()));
    let report = dir.run("render job.toml -o out.png --json").exits(0).json();
    assert_eq!(report["previews"], serde_json::json!(["out.direct.png", "out.indirect.png", "out.seen.png"]));
    for preview in ["out.direct.png", "out.indirect.png", "out.seen.png"] {
        assert!(bytes(&dir, preview).starts_with(b"\x89PNG"));
    }
    dir.write("bad.toml", &text.replace("\"CL\"", "\"C<LD>\""));
    let ran = dir.run("render job.toml -o out.exr --layer direct=CL").exits(2);
    assert!(ran.stderr().contains("two layers have the name `direct`"), "{}", ran.stderr());
    let ran = dir.run("render bad.toml -o out.exr").exits(2);
    assert!(ran.stderr().contains("bad.toml:6:2: layer `seen`: found `D` at character 4"), "{}", ran.stderr());
    assert!(ran.stderr().contains("    C<LD>\n       ^"), "{}", ran.stderr());
}

#[test]
fn variants_of_a_sweep_have_their_layers() {
    let dir = TestFolder::new();
    let text = "scene = \"fog.mgf\"\nsize = \"16x16\"\nspp = 4\nframes = 1\nlayers = [\"direct\", \"indirect\"]\n\
                [sweep]\nseed = [1, 2]\n";
    dir.write("job.toml", text);
    dir.run("sweep job.toml -o out --local").exits(0);
    let manifest: serde_json::Value = serde_json::from_str(&dir.read("out/sweep.json")).expect("JSON");
    let pictures: Vec<&String> = manifest["files"].as_object().expect("files").keys().collect();
    assert_eq!(pictures.len(), 2, "{pictures:?}");
    for picture in pictures {
        assert_layers_sum_up(&dir, &format!("out/{}", picture.trim_end_matches(".exr")), &["direct", "indirect"]);
    }
}
