//! Tests of the example client in Python with real coordinators and workers; run by `tests/python`.

use crate::common;
use crate::common::{CommandOutput, TestFolder, TestProcess, file_names, pixels, start_coordinator};
use femc_require::Prerequisite;
use std::path::{Path, PathBuf};
use std::process::Command;

/// Returns the folder of the Python interpreter with the packages that the example needs.
fn programs() -> Option<PathBuf> {
    Prerequisite::Python.variable_or_skip("FEMC_TEST_PYTHON_BIN").map(PathBuf::from)
}

/// Runs `render.py` with the words of `line` in `dir`, and prints its output.
fn render(programs: &Path, dir: &TestFolder, line: &str) -> CommandOutput {
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("../examples/python/render.py");
    let mut command = Command::new(programs.join("python"));
    command.arg(script).args(line.split_whitespace()).current_dir(dir.path(""));
    command.env_remove("FEMC_SERVER").env_remove("FEMC_IDENTITY").env("PYTHONDONTWRITEBYTECODE", "1");
    let ran = TestProcess::spawn(&mut command).end();
    print!("$ render.py {line}\n{}{}", ran.stderr(), ran.stdout());
    ran
}

/// Returns the mean Rec. 709 luminance of all pixels.
fn mean_luminance(path: &Path) -> f64 {
    let rgb = common::film(path).rgb;
    let pixels =
        rgb.chunks_exact(3).map(|p| 0.2126 * f64::from(p[0]) + 0.7152 * f64::from(p[1]) + 0.0722 * f64::from(p[2]));
    pixels.sum::<f64>() / (rgb.len() / 3) as f64
}

#[test]
fn it_submits_watches_and_fetches_the_pixels_of_one_process() {
    let Some(programs) = programs() else { return };
    let dir = TestFolder::new();
    let (_farm, url) = start_coordinator(&dir, 0);
    let _worker = dir.start(&format!("worker --join {url} --threads 1"));
    let settings = "--frames 2..3 --size 40x24 --spp 8 --seed 5 --set medium.fog.sigma_s=0.2";
    let ran = render(&programs, &dir, &format!("fog.mgf -o out {settings} --server {url}")).exits(0);
    assert!(ran.stderr().contains("done, 2 of 2 frames, 100 %"), "{}", ran.stderr());
    dir.run(&format!("render fog.mgf -o alone {settings}")).exits(0);
    assert_eq!(file_names(&dir.path("out")), file_names(&dir.path("alone")));
    for name in file_names(&dir.path("out")) {
        let [out, alone] = ["out", "alone"].map(|folder| dir.path(folder).join(&name));
        assert_eq!(pixels(&out), pixels(&alone), "{name}");
        let attributes = |path: &Path| femc_film::exr::read_attributes(path).expect("attributes");
        let [of_farm, of_one] = [attributes(&out), attributes(&alone)];
        for key in ["femc:settings", "femc:scene", "femc:spp"] {
            assert_eq!(of_farm.get(key), of_one.get(key), "{name}: {key}");
            assert!(of_one.contains_key(key), "{key}");
        }
        let line = ran.stdout().lines().find(|line| line.contains(&name)).expect("a line").to_owned();
        let printed: f64 = line.split_whitespace().nth(3).and_then(|word| word.parse().ok()).expect("a number");
        let mean = mean_luminance(&alone);
        assert!((printed - mean).abs() <= 1e-4 * mean && mean > 0.0, "{line}, and it is {mean}");
    }
}

#[test]
fn a_scene_of_many_files_is_sent_once_and_rendered_whole() {
    let Some(programs) = programs() else { return };
    let dir = TestFolder::new();
    let (_farm, url) = start_coordinator(&dir, 0);
    let _worker = dir.start(&format!("worker --join {url} --threads 1"));
    // Small files share a piece; a large file has its own.
    std::fs::create_dir_all(dir.path("parts/lamps")).expect("folders");
    dir.write("parts/fog.mgf", &format!("{}{}", common::FOG, "# a long comment\n".repeat(20_000)));
    dir.write("parts/lamps/none.mgf", "# no lamp\n");
    dir.write("whole.mgf", "i parts/fog.mgf\ni parts/lamps/none.mgf\n");
    let line = format!("whole.mgf --with parts -o out --frames 1 --size 32x32 --spp 4 --server {url}");
    let sent = |ran: &CommandOutput| -> u64 {
        let words = ran.stderr();
        let bytes = words.split_whitespace().skip_while(|word| *word != "whole.mgf,").nth(1);
        bytes.and_then(|word| word.parse().ok()).unwrap_or_else(|| panic!("{words}"))
    };
    assert!(sent(&render(&programs, &dir, &line).exits(0)) > 0);
    let again = render(&programs, &dir, &line).exits(0);
    assert_eq!(sent(&again), 0, "it is there");
    assert!(again.stderr().contains("job 2:"), "a job of its own: {}", again.stderr());
    dir.run("render whole.mgf -o alone.exr --frames 1 --size 32x32 --spp 4").exits(0);
    assert_eq!(pixels(&dir.path("out/whole.0001.exr")), pixels(&dir.path("alone.exr")));
}

#[test]
fn on_an_encrypted_farm_it_shows_who_it_is() {
    let Some(programs) = programs() else { return };
    let dir = TestFolder::new();
    dir.run("ca init").exits(0);
    for holder in ["coordinator farm", "worker w1", "user ann --role submitter", "user eve --role viewer"] {
        dir.run(&format!("ca issue {holder}")).exits(0);
    }
    let mut farm =
        dir.start("coordinator --listen 127.0.0.1:0 --store sqlite:farm.db --artifacts artifacts --identity farm.pem");
    let line = farm.first_line();
    let url = line.split_whitespace().find(|word| word.starts_with("https://")).expect("the address").to_owned();
    let _worker = dir.start(&format!("worker --join {url} --threads 1 --identity w1.pem"));
    let settings = format!("fog.mgf --frames 1 --size 32x32 --spp 2 --server {url}");
    render(&programs, &dir, &format!("{settings} -o one --identity ann.pem")).exits(0);
    // The same identity as three files.
    let identity = dir.read("ann.pem");
    let sections: Vec<&str> = identity.split_inclusive("-----\n").collect();
    let section = |n: usize| sections[2 * n..2 * n + 2].concat();
    let [cert, key, ca] = [section(0), section(1), section(2)];
    for (name, text) in [("cert", cert), ("key", key), ("ca", ca)] {
        dir.write(&format!("{name}.pem"), &text);
    }
    render(&programs, &dir, &format!("{settings} -o two --cert cert.pem --key key.pem --ca ca.pem")).exits(0);
    dir.run("render fog.mgf -o alone.exr --frames 1 --size 32x32 --spp 2").exits(0);
    for out in ["one", "two"] {
        assert_eq!(pixels(&dir.path(out).join("fog.0001.exr")), pixels(&dir.path("alone.exr")), "{out}");
    }
    let refused = render(&programs, &dir, &format!("{settings} --identity eve.pem")).exits(1).stderr();
    assert!(refused.contains("forbidden") && refused.contains("viewer eve"), "{refused}");
    let error = render(&programs, &dir, &settings).exits(2).stderr();
    assert!(error.contains("takes an identity"), "{error}");
}

#[test]
fn what_goes_wrong_is_said_with_its_kind() {
    let Some(programs) = programs() else { return };
    let dir = TestFolder::new();
    let (_farm, url) = start_coordinator(&dir, 0);
    let _worker = dir.start(&format!("worker --join {url} --threads 1"));
    dir.write("broken.mgf", "m wall =\n\trd bright\n");
    let error = render(&programs, &dir, &format!("broken.mgf --server {url}")).exits(1).stderr();
    assert!(error.contains("job 1 is not done") && error.contains("scene: broken.mgf:2"), "{error}");
    let error = render(&programs, &dir, &format!("fog.mgf --spp 0 --server {url}")).exits(1).stderr();
    assert!(error.contains("invalid") && error.contains("steps of stage 0"), "{error}");
    let error = render(&programs, &dir, "fog.mgf --server http://127.0.0.1:9").exits(4).stderr();
    assert!(error.contains("http://127.0.0.1:9 cannot be reached"), "{error}");
    let error = render(&programs, &dir, &format!("nothing.mgf --server {url}")).exits(2).stderr();
    assert!(error.contains("nothing.mgf"), "{error}");
}
