//! Tests of `[sweep]`, `[regions]` and `[contrasts]`: their meaning, and refused input.

use super::*;

fn parse(text: &str) -> Result<JobFile, String> {
    JobFile::parse(Path::new("j.toml"), &format!("scene = \"a.mgf\"\n{text}")).map_err(|e| e.to_string())
}

fn names(text: &str) -> Vec<String> {
    let job = parse(text).unwrap_or_else(|e| panic!("{e}"));
    job.sweep.expect("a sweep").variants().into_iter().map(|variant| variant.name).collect()
}

#[test]
fn the_contract_s_sweep_is_a_grid_in_the_order_of_the_file() {
    let names = names(
        "[sweep]\n\"medium.fog.sigma_s\" = [0.01, 0.02, 0.05]\n\
         \"material.lamp.ed\" = { from = 1e4, to = 1e5, steps = 4, scale = \"log\" }\n",
    );
    assert_eq!(names.len(), 12);
    assert_eq!(names[0], "sigma_s=0.01,ed=10000");
    assert_eq!(names[1], "sigma_s=0.01,ed=21544.3469003");
    assert_eq!(names[11], "sigma_s=0.05,ed=100000");
}

#[test]
fn a_zip_pairs_values() {
    let names = names("[sweep]\nmode = \"zip\"\nseed = [1, 2]\n\"camera.main.fov\" = [40, 50.5]\n");
    assert_eq!(names, ["seed=1,fov=40", "seed=2,fov=50.5"]);
}

#[test]
fn axes_are_told_apart_by_as_little_of_their_names_as_needed() {
    let names = names("[sweep]\n\"material.a.ed\" = [1]\n\"material.b.ed\" = [2]\ncamera = [\"main\"]\n");
    assert_eq!(names, ["a.ed=1,b.ed=2,camera=main"]);
}

#[test]
fn more_values_change_no_name_of_those_before() {
    let before = names("[sweep]\nseed = [1, 2]\n\"camera.main.fov\" = [40]\n");
    let after = names("[sweep]\nseed = [3, 1, 2]\n\"camera.main.fov\" = [50, 40]\n");
    assert!(before.iter().all(|name| after.contains(name)), "{before:?} {after:?}");
}

#[test]
fn every_setting_of_an_image_can_be_an_axis() {
    let job = parse(
        "[sweep]\nmode = \"zip\"\ncamera = [\"a\"]\nsize = [\"4x2\"]\nframes = [\"1..3\"]\ntime = [\"2m\"]\n\
         method = [\"pt\"]\nmax_depth = [3]\nfilter = [\"box\"]\nseed = [7]\n",
    )
    .expect("a job");
    let sweep = job.sweep.expect("a sweep");
    let settings = sweep.variants()[0].apply(&SettingsArgs { spp: Some(4), ..SettingsArgs::default() });
    assert_eq!((settings.spp, settings.time), (None, Some(DurationArg { seconds: 120.0 })), "the axis' stop wins");
    assert_eq!((settings.camera.as_deref(), settings.max_depth, settings.seed), (Some("a"), Some(3), Some(7)));
}

#[test]
fn regions_and_contrasts_are_read_in_order() {
    let job = parse("[regions]\nsign = [1, 2, 3, 4]\nroad = [0, 0, 9, 9]\n[contrasts]\nseen = [\"sign\", \"road\"]\n");
    let measures = job.expect("a job").measures;
    assert_eq!(measures.regions.iter().map(|r| r.name.as_str()).collect::<Vec<_>>(), ["sign", "road"]);
    assert_eq!(measures.contrasts[0].background, "road");
}

#[test]
fn what_is_wrong_is_told_with_its_line_and_column() {
    for (text, place, what) in [
        ("[sweep]\n", "2:1", "no axis"),
        ("sweep = 3\n", "2:9", "a table"),
        ("[sweep]\nseed = []\n", "3:8", "no values"),
        ("[sweep]\nseed = 3\n", "3:8", "a list of values"),
        ("[sweep]\nseed = [1, 1]\n", "3:12", "twice"),
        ("[sweep]\nseed = [1, \"x\"]\n", "3:12", "`seed`"),
        ("[sweep]\nspp = [1, 0]\n", "3:11", "at least 1"),
        ("[sweep]\nerror = [0.1, -1]\n", "3:15", "> 0"),
        ("[sweep]\nspp = [1]\nerror = [0.1]\n", "4:1", "exclude"),
        ("[sweep]\nthreads = [1]\n", "3:1", "cannot be varied"),
        ("[sweep]\nmode = \"both\"\nseed = [1]\n", "3:8", "\"grid\""),
        ("[sweep]\nmode = \"zip\"\nseed = [1, 2]\nspp = [1]\n", "5:1", "same number"),
        ("[sweep]\nmode = \"zip\"\nseed = [1, 1]\nspp = [1, 1]\n", "4:12", "twice"),
        ("[sweep]\nmedium.fog.sigma_s = [0.1]\n", "3:8", "needs quotes"),
        ("[sweep]\n\"a.b.c\" = [nan]\n", "3:12", "a finite number"),
        ("[sweep]\n\"a.b.c\" = [true]\n", "3:12", "`a.b.c`"),
        ("[sweep]\n\"a.b.c\" = { from = 1, to = 2 }\n", "3:11", "`steps` is missing"),
        ("[sweep]\n\"a.b.c\" = { from = 1, to = 2, steps = 0 }\n", "3:39", "from 1"),
        ("[sweep]\n\"a.b.c\" = { from = 0, to = 2, steps = 2, scale = \"log\" }\n", "3:11", "greater than 0"),
        ("[sweep]\n\"a.b.c\" = { from = 0, to = 2, steps = 2, scale = \"ln\" }\n", "3:50", "scale must be"),
        ("[sweep]\n\"a.b.c\" = { from = 0, to = 2, steps = 2, by = 1 }\n", "3:42", "no `by`"),
        ("[sweep]\nspp = { from = 1, to = 2, steps = 3 }\n", "3:7", "cannot be 1.5"),
        (
            "[sweep]\n\"a.b.c\" = { from = 0, to = 1, steps = 65 }\nseed = { from = 1, to = 64, steps = 64 }\n",
            "2:1",
            "4160 variants",
        ),
        ("[regions]\na = [1, 2, 3]\n", "3:5", "x0, y0, x1, y1"),
        ("[regions]\na = [1, 2, 1, 4]\n", "3:5", "no pixel"),
        ("[regions]\na = [0, 0, 1, 1]\n[contrasts]\nc = [\"a\", \"b\"]\n", "5:5", "`b`"),
    ] {
        let error = parse(text).map(|_| ()).expect_err(text);
        assert!(error.starts_with(&format!("j.toml:{place}: ")) && error.contains(what), "{text}: {error}");
    }
}
