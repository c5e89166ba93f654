//! Tests of `femc stylize`.

use crate::common::{TestFolder, file_names};
use femc_film::{FrameImage, Image, LayerImage, Picture, Provenance, exr};
use std::collections::BTreeMap;

const SIZE: [u32; 2] = [24, 18];

/// Returns a frame with these colors.
fn frame([width, height]: [u32; 2], color: impl Fn(u32, u32) -> [f32; 3]) -> FrameImage {
    let pixels: Vec<[f32; 3]> =
        (0..height).flat_map(|y| (0..width).map(move |x| (x, y))).map(|(x, y)| color(x, y)).collect();
    let n = pixels.len();
    FrameImage {
        color: Image { width, height, pixels },
        variance: vec![[0.0; 3]; n],
        luminance_variance: vec![0.0; n],
        albedo: vec![[0.0; 3]; n],
        depth: vec![0.0; n],
        samples: vec![1; n],
    }
}

/// Writes a frame with these colors to a file.
fn write(dir: &TestFolder, name: &str, size: [u32; 2], color: impl Fn(u32, u32) -> [f32; 3]) {
    exr::write(&dir.path(name), &frame(size, color), &Provenance::default()).expect("an image");
}

/// Returns light that falls off with the distance from a pixel.
fn glow([u, v]: [u32; 2]) -> impl Fn(u32, u32) -> [f32; 3] {
    move |x, y| [40.0 / (1.0 + x.abs_diff(u) as f32 + 0.7 * y.abs_diff(v) as f32); 3]
}

/// Writes the file of a frame's layers. Each layer is the same light times a factor.
fn write_layers(
    dir: &TestFolder,
    name: &str,
    size: [u32; 2],
    color: impl Fn(u32, u32) -> [f32; 3],
    names: &[(&str, f32)],
) {
    let frame = frame(size, color);
    let mut layers = LayerImage::black(names.iter().map(|layer| layer.0.to_owned()), size[0], size[1]);
    for (layer, (_, factor)) in layers.iter_mut().zip(names) {
        layer.color = frame.color.pixels.iter().map(|light| light.map(|value| factor * value)).collect();
    }
    let bytes = exr::encode_layers(&frame, &layers, &[], &[], &Provenance::default()).expect("an image");
    std::fs::write(dir.path(name), bytes).expect("written");
}

/// Creates a folder with source and target, both also with layers, and a painting.
fn test_folder() -> TestFolder {
    let dir = TestFolder::new();
    write(&dir, "a.exr", SIZE, glow([8, 8]));
    write(&dir, "b.exr", [30, 20], glow([20, 12]));
    write_layers(&dir, "a.layers.exr", SIZE, glow([8, 8]), &[("full", 1.0), ("direct", 0.5), ("lamp", 0.2)]);
    write_layers(&dir, "b.layers.exr", [30, 20], glow([20, 12]), &[("direct", 0.5), ("fog", 0.1), ("full", 1.0)]);
    painting(&dir, "p.png", SIZE);
    dir
}

fn painting(dir: &TestFolder, name: &str, [width, height]: [u32; 2]) {
    let pixels = (0..width * height).map(|at| [(at * 37 % 251) as u8, (at % width * 9) as u8, (at / width * 11) as u8]);
    let picture = Picture { width, height, pixels: pixels.collect() };
    std::fs::write(dir.path(name), picture.to_png().expect("a PNG")).expect("written");
}

fn picture(dir: &TestFolder, name: &str) -> Picture {
    Picture::from_png(&std::fs::read(dir.path(name)).expect("a file")).expect("a PNG")
}

#[test]
fn a_target_is_painted_whole_and_threads_change_no_bit() {
    let dir = test_folder();
    let line = "stylize --style p.png --source a.layers.exr --target b.layers.exr";
    let report = dir.run(&format!("{line} -o one.png --threads 1 --json")).exits(0).json();
    let other = dir.run(&format!("{line} -o two.png --threads 2 --json")).exits(0).json();
    let painted = picture(&dir, "one.png");
    assert_eq!((painted.width, painted.height), (30, 20));
    assert!(painted == picture(&dir, "two.png"), "threads change no bit");
    assert_eq!(report["guides"], serde_json::json!(["direct", "full"]), "layers that both have");
    let [frame, other] = [&report, &other].map(|report| &report["frames"][0]);
    assert_eq!(frame["target_patches"], 26 * 16);
    for figure in ["guide_error", "usage_entropy", "unused", "unused_pixels", "sharpness"] {
        assert!(frame[figure].as_f64().is_some_and(|value| value >= 0.0), "{figure}: {report}");
        assert_eq!(frame[figure], other[figure], "{figure}");
    }
    let entropy = |key: &str| frame[key].as_f64().expect("a number");
    assert!(entropy("usage_entropy") <= entropy("usage_entropy_most") + 1e-9, "{report}");
    let said = dir.run(&format!("{line} -o one.png --guides full --method em --mu 4 --patch 3 --levels 1")).exits(0);
    assert!(said.stdout().contains("entropy") && said.stderr().contains("wrote one.png"), "{}", said.stdout());
}

#[test]
fn several_targets_go_to_a_folder_under_one_exposure() {
    let dir = test_folder();
    write(&dir, "c-1.exr", SIZE, glow([4, 4]));
    write(&dir, "c-2.exr", SIZE, |x, y| glow([4, 4])(x, y).map(|light| 0.1 * light));
    let line = "stylize --style p.png --source a.exr";
    let ran = dir.run(&format!("{line} --target c-*.exr -o clip/ --json")).exits(0);
    assert!(ran.stderr().contains("no layer `motion`"), "{}", ran.stderr());
    assert_eq!(file_names(&dir.path("clip")), ["c-1.png", "c-2.png"]);
    assert_eq!(ran.json()["frames"][1]["flicker"], serde_json::Value::Null, "the files have no layer `motion`");
    // By itself, the second frame is shown brighter than together with the first one.
    dir.run(&format!("{line} --target c-2.exr -o alone.png")).exits(0);
    assert!(picture(&dir, "clip/c-2.png") != picture(&dir, "alone.png"), "both are as bright");
    // With a fixed exposure, other frames have no influence.
    dir.run(&format!("{line} --target c-1.exr c-2.exr -o clip/ --exposure 5")).exits(0);
    dir.run(&format!("{line} --target c-2.exr -o alone.png --exposure 5")).exits(0);
    assert!(picture(&dir, "clip/c-2.png") == picture(&dir, "alone.png"), "they differ");
}

#[test]
fn styles_come_with_the_program() {
    let dir = test_folder();
    for style in ["hatching", "watercolor", "oil", "cel"] {
        dir.run(&format!("stylize --style {style} --target b.layers.exr -o {style}.png --iterations 1")).exits(0);
        let painted = picture(&dir, &format!("{style}.png"));
        assert_eq!((painted.width, painted.height), (30, 20), "{style}");
    }
    assert!(picture(&dir, "oil.png") != picture(&dir, "cel.png"), "they are one style");
    let ran = dir.run("stylize --style aquatint --target b.layers.exr -o out.png").exits(2);
    assert!(ran.stderr().contains("hatching, watercolor, oil, cel"), "{}", ran.stderr());
}

#[test]
fn painted_clip_frames_follow_motion() {
    let dir = test_folder();
    let size = [40u32, 30];
    let pixels = (size[0] * size[1]) as usize;
    // Light that moves right by 3 pixels per frame.
    for frame in 0..3u32 {
        let light: Vec<f32> = (0..size[1])
            .flat_map(|y| (0..size[0]).map(move |x| (x, y)))
            .map(|(x, y)| glow([10 + 3 * frame, 12])(x, y)[0] + 0.01 * ((x * 7 + y * 13 + frame * 5) % 11) as f32)
            .collect();
        let (dx, dy, z) = (vec![3.0; pixels], vec![0.0; pixels], vec![2.0; pixels]);
        let named =
            [("R", &light), ("G", &light), ("B", &light), ("motion.X", &dx), ("motion.Y", &dy), ("depth.Z", &z)];
        let channels = named.map(|(name, values)| exr::NamedChannel { name, values, precision: exr::Precision::Float });
        let bytes = exr::encode_named_channels(size, &channels, &BTreeMap::new()).expect("an image");
        std::fs::write(dir.path(&format!("m-{frame}.exr")), bytes).expect("written");
    }
    let flicker = |boil: &str| {
        let line = format!("stylize --style p.png --source a.exr --target m-*.exr -o clip/ --boil {boil} --json");
        let report = dir.run(&line).exits(0).json();
        assert_eq!(report["frames"][0]["flicker"], serde_json::Value::Null);
        (1..3).map(|at| report["frames"][at]["flicker"].as_f64().expect("it is known")).sum::<f64>() / 2.0
    };
    let [held, anew] = ["0", "1"].map(flicker);
    eprintln!("flicker {held:.2} held, {anew:.2} anew");
    assert!(held < 0.5 * anew, "{held} {anew}");
}

#[test]
fn a_clip_that_was_cut_off_goes_on_to_the_same_bytes() {
    let dir = test_folder();
    let line = "stylize --style oil --target";
    for frame in 0..4u32 {
        let light = glow([40 + 9 * frame, 50]);
        write_layers(&dir, &format!("k-{frame}.exr"), [160, 120], light, &[("full", 1.0)]);
    }
    dir.run(&format!("{line} k-*.exr -o whole/")).exits(0);
    let mut running = dir.start_as("paint", &format!("{line} k-*.exr -o cut/"));
    running.wait_until("two frames are painted", || dir.path("cut/k-1.png").exists());
    running.kill();
    assert!(dir.path("cut.part").exists(), "what is done is kept");
    // A checkpoint of another style is not used.
    std::fs::copy(dir.path("cut.part"), dir.path("other.part")).expect("a copy");
    dir.run("stylize --style cel --target k-*.exr -o other/").exits(0);
    let ran = dir.run(&format!("{line} k-*.exr -o cut/")).exits(0);
    assert!(ran.stderr().contains("resuming, "), "{}", ran.stderr());
    assert!(!dir.path("cut.part").exists() && !dir.path("other.part").exists());
    for frame in 0..4 {
        let [whole, cut, other] = ["whole", "cut", "other"].map(|run| picture(&dir, &format!("{run}/k-{frame}.png")));
        assert!(whole == cut, "frame {frame} differs");
        assert!(whole != other, "frame {frame} is of another style");
    }
}

/// Each checkpoint that a run wrote leads to the same bytes: at the beginning of a frame, and between its levels.
#[test]
fn a_clip_goes_on_from_each_checkpoint_to_the_same_bytes() {
    let dir = test_folder();
    for frame in 0..3u32 {
        write_layers(&dir, &format!("k-{frame}.exr"), [160, 120], glow([40 + 30 * frame, 50]), &[("full", 1.0)]);
    }
    let line = "stylize --style oil --target k-*.exr";
    let mut running = dir.start_as("paint", &format!("{line} -o whole/"));
    let mut states: Vec<(Vec<u8>, usize)> = Vec::new();
    running.wait_until("the last frame is painted", || {
        let done = (0..3).take_while(|frame| dir.path(&format!("whole/k-{frame}.png")).exists()).count();
        if let Ok(state) = std::fs::read(dir.path("whole.part"))
            && states.last().is_none_or(|(last, _)| *last != state)
        {
            states.push((state, done));
        }
        done == 3
    });
    running.end();
    let chosen: Vec<usize> = (0..5).map(|part| part * (states.len() - 1) / 4).collect();
    let mut first_left = std::collections::BTreeSet::new();
    for (run, &at) in chosen.iter().enumerate() {
        let (state, done) = &states[at];
        std::fs::create_dir(dir.path(&format!("run{run}"))).expect("a folder");
        for frame in 0..*done {
            let name = format!("k-{frame}.png");
            std::fs::copy(dir.path(&format!("whole/{name}")), dir.path(&format!("run{run}/{name}"))).expect("a copy");
        }
        std::fs::write(dir.path(&format!("run{run}.part")), state).expect("written");
        let ran = dir.run(&format!("{line} -o run{run}/")).exits(0);
        let said = ran.stderr();
        let (_, rest) = said.split_once("resuming, ").unwrap_or_else(|| panic!("{said}"));
        first_left.insert(rest[..1].to_owned());
        for frame in 0..3 {
            let [whole, again] =
                ["whole".to_owned(), format!("run{run}")].map(|run| picture(&dir, &format!("{run}/k-{frame}.png")));
            assert!(whole == again, "frame {frame} differs after checkpoint {at} of {}", states.len());
        }
    }
    assert!(first_left.len() > 1, "checkpoints of several frames: {first_left:?} of {}", states.len());
}

#[test]
fn frames_are_painted_when_they_are_rendered() {
    let dir = test_folder();
    let line = "render fog.mgf -o clip --frames 1..2 --size 24x16 --spp 4";
    let report = dir.run(&format!("{line} --style hatching --boil 0.9 --json")).exits(0).json();
    let painted = report["painted"].as_array().expect("a list").clone();
    assert_eq!(painted.len(), 2, "{report}");
    let files: Vec<&str> = painted.iter().map(|file| file.as_str().expect("a name")).collect();
    assert!(files.iter().all(|file| file.ends_with(".painted.png") && picture(&dir, file).width == 24), "{files:?}");
    // The same result with `femc stylize`: each frame follows the previous one, with one exposure.
    let targets: Vec<String> = files.iter().map(|file| file.replace(".painted.png", ".layers.exr")).collect();
    let targets = targets.join(" ");
    dir.run(&format!("stylize --style hatching --boil 0.9 --target {targets} -o again/")).exits(0);
    for (file, name) in files.iter().zip(file_names(&dir.path("again"))) {
        assert!(picture(&dir, file) == picture(&dir, &format!("again/{name}")), "{file} and {name} differ");
    }
    dir.run(&format!("stylize --style hatching --boil 0 --target {targets} -o calm/")).exits(0);
    let name = &file_names(&dir.path("calm"))[1];
    assert!(picture(&dir, files[1]) != picture(&dir, &format!("calm/{name}")), "boil changes the second frame");
    let ran = dir.run(&format!("{line} --style aquatint")).exits(2);
    assert!(ran.stderr().contains("--style aquatint"), "{}", ran.stderr());
    dir.run(&format!("{line} --boil 0.5")).exits(2);
    dir.run(&format!("{line} --style oil --boil 1.5")).exits(2);
}

#[test]
fn the_source_itself_is_painted_as_the_painting_is() {
    let dir = test_folder();
    dir.run("stylize --style p.png --source a.exr --target a.exr -o same.png").exits(0);
    let (painted, painting) = (picture(&dir, "same.png"), picture(&dir, "p.png"));
    let pairs = painted.pixels.as_flattened().iter().zip(painting.pixels.as_flattened());
    let mean = pairs.map(|(a, b)| f64::from(a.abs_diff(*b))).sum::<f64>() / (3 * painting.pixels.len()) as f64;
    assert!(mean < 4.0, "{mean} levels off");
}

#[test]
fn bad_input_says_what_is_wrong_and_where_and_paints_nothing() {
    let dir = test_folder();
    write(&dir, "nan.exr", SIZE, |x, y| if (x, y) == (5, 7) { [1.0, f32::NAN, 1.0] } else { [1.0; 3] });
    write(&dir, "tiny.exr", [4, 30], |_, _| [1.0; 3]);
    painting(&dir, "large.png", [25, 18]);
    for name in ["lamp", "fog"] {
        write_layers(&dir, &format!("{name}.layers.exr"), SIZE, glow([3, 3]), &[(name, 1.0)]);
    }
    let before = file_names(&dir.path("."));
    for (arguments, code, said) in [
        ("--style large.png --source a.exr --target b.exr", 1, "large.png has 25x18 pixels, the source a.exr 24x18"),
        ("--style p.png --source a.exr --target a.exr b.exr", 2, "2 targets, but this is one picture; give a folder"),
        ("--style p.png --source a.exr --target z*.exr", 2, "--target z*.exr: no such file"),
        ("--style p.png --source a.layers.exr --target b.layers.exr --guides glow", 1, "no layer `glow`"),
        ("--style p.png --source lamp.layers.exr --target fog.layers.exr", 1, "no layer in common"),
        ("--style p.png --source fog.mgf --target b.exr", 1, "--source: fog.mgf"),
        ("--style p.png --source a.exr --target p.png", 1, "--target: p.png"),
        ("--style p.png --source a.exr --target none.exr", 2, "--target none.exr: no such file"),
        ("--style p.png --source a.exr --target nan.exr", 1, "nan.exr: pixel 5,7 is not finite"),
        ("--style none.png --source a.exr --target b.exr", 2, "--style none.png: no such file"),
        ("--style a.exr --source a.exr --target b.exr", 1, "--style a.exr"),
        ("--style p.png --source a.exr --target tiny.exr", 2, "fewer than 5 rows or columns"),
        ("--style p.png --source a.exr --target b.exr --levels 9", 2, "allow 1 to 1"),
        ("--style p.png --source a.exr --target b.exr --patch 4", 2, "--patch 4"),
        ("--style p.png --source a.exr --target b.exr --mu=-1", 2, "--mu -1"),
        ("--style p.png --source a.exr --target b.exr --mu nan", 2, "--mu"),
        ("--style p.png --source a.exr --target b.exr --balance=-1", 2, "--balance -1"),
        ("--style p.png --source a.exr --target b.exr --boil 2", 2, "--boil 2"),
        ("--style p.png --source a.exr --target b.exr --method magic", 2, "--method"),
    ] {
        let ran = dir.run(&format!("stylize {arguments} -o out.png")).exits(code);
        assert!(ran.stderr().contains(said), "{arguments}: {}", ran.stderr());
        assert_eq!(ran.stdout(), "", "{arguments}");
    }
    let ran = dir.run("stylize --style p.png --source a.exr --target b.exr -o out.exr").exits(2);
    assert!(ran.stderr().contains("give FILE.png, or a folder"), "{}", ran.stderr());
    assert_eq!(file_names(&dir.path(".")), before);
}
