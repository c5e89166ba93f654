//! Tests of import and export: which templates become which sweeps, the messages for all others, and that an exported template can
//! be imported again.

use super::export::{FrameChunks, export};
use super::import::import;
use super::template::Template;
use crate::request::JobFile;
use std::num::NonZeroUsize;
use std::path::Path;

/// Returns a template of one step with this space and these arguments of `femc`, line by line, in `/t/fog.yaml`.
fn template(space: &str, args: &[&str]) -> String {
    let args: String = args.iter().map(|arg| format!("          - \"{arg}\"\n")).collect();
    format!(
        "specificationVersion: jobtemplate-2023-09\nname: Fog study\nparameterDefinitions:\n  - name: Scene\n    type: PATH\n    \
         default: scenes/fog.mgf\n  - name: Spp\n    type: INT\n    default: 8\nsteps:\n  - name: Render\n{space}    script:\n      \
         actions:\n        onRun:\n          command: femc\n          args:\n          - render\n          - \"{{{{Param.Scene}}}}\"\n{args}"
    )
}

/// Returns a space of these parameters, one per line, and their combination.
fn space(parameters: &[&str], combination: &str) -> String {
    let lines: String = parameters.iter().map(|line| format!("        - {{ {line} }}\n")).collect();
    let joined = if combination.is_empty() { String::new() } else { format!("      combination: \"{combination}\"\n") };
    format!("    parameterSpace:\n      taskParameterDefinitions:\n{lines}{joined}")
}

const FRAME: &str = "name: Frame, type: INT, range: \"1-6\"";
const FOG: &str = "name: Fog, type: FLOAT, range: [0.01, 0.05]";
const SEED: &str = "name: Seed, type: INT, range: [3, 4]";
const CAMERA: &str = "name: Camera, type: STRING, range: [left, right, top]";

/// Returns the job file without its comments, and the parts that were left out.
fn imported(text: &str) -> Result<(String, Vec<String>), String> {
    let template = Template::parse(Path::new("/t/fog.yaml"), text, &[]).map_err(|error| error.to_string())?;
    let imported = import(&template, Path::new("/t/job.toml")).map_err(|error| error.to_string())?;
    let is_line = |line: &&str| !line.starts_with('#') && *line != "scene = \"scenes/fog.mgf\"";
    Ok((imported.text.lines().filter(is_line).collect::<Vec<_>>().join("; "), imported.left_out))
}

#[test]
fn what_tasks_do_becomes_a_job() {
    let (frame, fog) = ("--frames={{Task.Param.Frame}}", "--set=medium.fog.sigma_s={{Task.Param.Fog}}");
    let (seed, camera) = ("--seed={{Task.Param.Seed}}", "--camera={{Task.Param.Camera}}");
    for (parameters, combination, args, job) in [
        (&[][..], "", &["--spp={{Param.Spp}}"][..], "spp = 8"),
        (&[FRAME], "", &[frame, "--spp", "4"], "frames = \"1..6\"; spp = 4"),
        (&["name: Frame, type: INT, range: \"2-8:3\""], "", &[frame], "frames = \"2..8+3\""),
        (&["name: Frame, type: INT, range: [5]"], "", &[frame], "frames = \"5\""),
        (&["name: Frame, type: INT, range: \"1,2,4\""], "", &[frame], "[sweep]; frames = [\"1\", \"2\", \"4\"]"),
        (
            &["name: Some, type: STRING, range: [\"1..4\", \"5..8\"]"],
            "",
            &["--frames={{Task.Param.Some}}"],
            "frames = \"1..8\"",
        ),
        (&[FOG], "", &[fog, "--size=8x4"], "size = \"8x4\"; [sweep]; \"medium.fog.sigma_s\" = [0.01, 0.05]"),
        (
            &[FOG, CAMERA, FRAME],
            "",
            &[fog, camera, frame, "--time=90s"],
            "frames = \"1..6\"; time = \"90s\"; [sweep]; \"medium.fog.sigma_s\" = [0.01, 0.05]; camera = [\"left\", \"right\", \"top\"]",
        ),
        (
            &[FOG, SEED],
            "(Fog, Seed)",
            &[fog, seed, "--set=a.b.c=2"],
            "[set]; \"a.b.c\" = 2; [sweep]; mode = \"zip\"; \"medium.fog.sigma_s\" = [0.01, 0.05]; seed = [3, 4]",
        ),
        (
            &[FOG, SEED, FRAME],
            "Frame * (Fog, Seed)",
            &[fog, seed, frame],
            "frames = \"1..6\"; [sweep]; mode = \"zip\"; \"medium.fog.sigma_s\" = [0.01, 0.05]; seed = [3, 4]",
        ),
        (
            &[FOG, SEED, CAMERA],
            "(Fog, Seed) * Camera",
            &[fog, seed, camera],
            "[sweep]; mode = \"zip\"; \"medium.fog.sigma_s\" = [0.01, 0.01, 0.01, 0.05, 0.05, 0.05]; seed = [3, 3, 3, 4, 4, 4]; \
             camera = [\"left\", \"right\", \"top\", \"left\", \"right\", \"top\"]",
        ),
        (
            &["name: Last, type: INT, range: [2, 4]"],
            "",
            &["--frames=1..{{Task.Param.Last}}", "--seed={{Task.Param.Last}}"],
            "[sweep]; mode = \"zip\"; frames = [\"1..2\", \"1..4\"]; seed = [2, 4]",
        ),
    ] {
        let space = if parameters.is_empty() { String::new() } else { space(parameters, combination) };
        let found = imported(&template(&space, args));
        assert_eq!(found, Ok((job.to_owned(), Vec::new())), "{parameters:?} {combination}");
    }
}

#[test]
fn expressions_and_chunks_of_the_extensions_are_understood() {
    let chunked = template(
        &space(
            &[
                "name: Frame, type: \"CHUNK[INT]\", range: \"1-10\", chunks: { defaultTaskCount: 4, rangeConstraint: CONTIGUOUS }",
            ],
            "",
        ),
        &["--frames={{Task.Param.Frame}}"],
    );
    let chunked = chunked.replacen("name: Fog", "extensions: [TASK_CHUNKING]\nname: Fog", 1);
    assert_eq!(imported(&chunked), Ok(("frames = \"1..10\"".to_owned(), Vec::new())));
    let computed = template(&space(&[SEED], ""), &["--seed={{Task.Param.Seed * 10 + Param.Spp}}"]);
    let computed = computed.replacen("name: Fog", "extensions: [EXPR]\nname: Fog", 1);
    assert_eq!(imported(&computed), Ok(("[sweep]; seed = [38, 48]".to_owned(), Vec::new())));
}

#[test]
fn what_has_no_place_in_a_job_is_left_out_and_told() {
    let hosts = "    hostRequirements:\n      attributes:\n        - name: attr.femc.tags\n          allOf: [lab, fast]\n        \
                 - name: attr.worker.os.family\n          anyOf: [linux]\n      amounts:\n        - name: amount.worker.vcpu\n          \
                 min: 4\n    stepEnvironments:\n      - name: Licence\n        variables:\n          A: b\n";
    let text = template(hosts, &["-o", "/out", "--preview", "--seed=2", "--threads=3"]);
    let text = text.replace("command: femc\n", "command: femc\n          timeout: 60\n");
    let (job, left_out) = imported(&text).expect("a job");
    assert_eq!(job, "tags = [\"lab\", \"fast\"]; threads = 3; seed = 2");
    let reports = |part: &str| left_out.iter().any(|line| line.starts_with("/t/fog.yaml:") && line.contains(part));
    for part in ["attributes[1]", "amounts[0]", "stepEnvironments", "onRun.timeout", "`--out`", "`--preview`"] {
        assert!(reports(part), "{part}: {left_out:#?}");
    }
    assert_eq!(left_out.len(), 6, "{left_out:#?}");
}

#[test]
fn what_is_no_sweep_is_refused_with_its_line_and_column() {
    let plain = || template("", &[]);
    let mut wrong = Vec::new();
    let seeds = |args: &[&str]| template(&space(&[SEED, FRAME], ""), args);
    for (text, place, what) in [
        ("name: [".to_owned(), "", "YAML"),
        ("a: 1".to_owned(), "1:1", "specificationVersion"),
        (plain().replace("name: Fog study\n", "name: Fog study\ncolor: red\n"), "", "unknown field `color`"),
        (plain().replace("2023-09", "2019-01"), "", "jobtemplate-2019-01"),
        (plain().replace("default: 8", "default: many"), "", "many"),
        (plain().replace("    default: 8\n", ""), "", "Spp"),
        (plain().replace("{{Param.Scene}}", "{{Param.Scent}}"), "18:13", "Param.Scent"),
        (template(&space(&[SEED], "Seed * Frame"), &[]), "15:20", "Frame"),
        (template(&space(&[FOG, CAMERA], "(Fog, Camera)"), &[]), "", "same number of values"),
        (plain().replace("command: femc", "command: blender"), "15:20", "only `femc render`"),
        (plain().replace("- render", "- submit"), "17:13", "another command"),
        (template("", &["--spp=0"]), "17:13", "--spp"),
        (template("", &["--fast"]), "17:13", "--fast"),
        (seeds(&["--spp={{Task.Param.Seed}}", "--threads={{Task.Param.Frame}}"]), "21:13", "cannot differ"),
        (
            format!("{}  - name: Second\n    script: {{ actions: {{ onRun: {{ command: femc }} }} }}\n", plain()),
            "19:5",
            "one step",
        ),
        (
            plain()
                .replace("    script:", "    script:\n      embeddedFiles: [{ name: F, type: TEXT, data: x }]")
                .replace("{{Param.Scene}}", "{{Task.File.F}}"),
            "",
            "Task.File.F",
        ),
        (
            template(&space(&["name: N, type: INT, range: \"1-4100\""], ""), &["--seed={{Task.Param.N}}"]),
            "13:7",
            "4096",
        ),
    ] {
        let error = imported(&text).map(|_| ()).expect_err(what);
        println!("{error}");
        let begin = if place.is_empty() { "/t/fog.yaml".to_owned() } else { format!("/t/fog.yaml:{place}: ") };
        if !(error.starts_with(&begin) && error.contains(what)) {
            wrong.push(format!("{begin}{what}, not {error}"));
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

fn job(text: &str) -> JobFile {
    JobFile::parse(Path::new("/t/job.toml"), &format!("scene = \"scenes/fog.mgf\"\n{text}")).expect("a job")
}

/// Returns one line for every variant with its values and frames; sorted, because axes may come back in another order.
fn variants(job: &JobFile, all: &[u32]) -> Vec<String> {
    let line = |settings: &crate::args::SettingsArgs| {
        let frames = settings.frames.as_ref().map_or(all.to_vec(), |frames| frames.resolve(u32::MAX).expect("frames"));
        let changes = crate::request::Change::from_settings(settings);
        let values: Vec<String> =
            changes.iter().filter(|change| change.name() != "frames").map(|c| format!("{c:?}")).collect();
        format!("{frames:?} {values:?} {:?} {:?} {:?}", settings.workers, settings.threads, settings.stats)
    };
    let mut lines: Vec<String> = match &job.sweep {
        None => vec![line(&job.settings)],
        Some(sweep) => sweep.variants().iter().map(|variant| line(&variant.apply(&job.settings))).collect(),
    };
    lines.sort();
    lines
}

#[test]
fn an_exported_job_comes_back_as_the_same_variants() {
    let all: Vec<u32> = (1..=7).collect();
    for text in [
        "spp = 4",
        "spp = 4\nworkers = 2\nthreads = 3\nstats = true\ntags = [\"lab\"]\nfilter = \"gaussian\"\nmethod = \"pt\"",
        "spp = 4\nstats = \"full\"",
        "frames = \"2..6+2\"\n[set]\n\"medium.fog.sigma_s\" = 1e-9",
        "[sweep]\n\"medium.fog.sigma_s\" = [0.01, 0.02]\n\"material.lamp.ed\" = { from = 1e4, to = 1e5, steps = 4, scale = \"log\" }\ncamera = [\"driver\", \"over view\"]",
        "error = 0.1\n[sweep]\nmode = \"zip\"\nspp = [4, 8]\nseed = [1, 18446744073709551]\n\"a.b.c\" = [-1, 2.5]",
        "[sweep]\nframes = [\"1..3\", \"2..6+2\"]\ntime = [\"2s\", \"90s\"]",
        "[sweep]\nmode = \"zip\"\nmax-depth = [3, 4]\nsize = [\"8x8\", \"16x4\"]\nfilter = [\"box\", \"blackman-harris\"]",
        "[sweep]\n\"a.frame.x\" = [1, 2]\n\"b.frame.x\" = [1, 2]\n\"light.9.5\" = [0, 1]",
    ] {
        let before = job(text);
        let frames: Vec<u32> =
            before.settings.frames.as_ref().map_or(all.clone(), |frames| frames.resolve(7).expect("frames"));
        for (chunk, name) in [(1, "/t/out/job.yaml"), (3, "/t/out/job.json")] {
            let chunk = NonZeroUsize::new(chunk).expect("not 0");
            let exported = export(&before, FrameChunks { all: &frames, chunk }, Path::new(name)).expect(text);
            assert_eq!(exported.left_out, Vec::<String>::new(), "{text}");
            let template = Template::parse(Path::new(name), &exported.text, &[]).expect(text);
            let imported = import(&template, Path::new("/t/again.toml")).expect(text);
            let after = JobFile::parse(Path::new("/t/again.toml"), &imported.text).expect(text);
            assert_eq!(
                variants(&after, &all),
                variants(&before, &frames),
                "{text}\n{}\n{}",
                exported.text,
                imported.text
            );
            assert_eq!((&after.scene, &after.tags), (&before.scene, &before.tags), "{text}");
            let others: Vec<&String> = imported.left_out.iter().filter(|line| !line.contains("`--out`")).collect();
            assert!(others.is_empty(), "{others:?}");
        }
    }
}

#[test]
fn what_a_template_has_no_place_for_is_told() {
    let text = "priority = 70\ntags = [\"lab\", \"2 GPUs\"]\n[sweep]\nseed = [1, 2]\n[regions]\nsign = [0, 0, 4, 4]\n";
    let frames = FrameChunks { all: &[1], chunk: NonZeroUsize::MIN };
    let exported = export(&job(text), frames, Path::new("/t/job.yaml")).expect("a template");
    for (place, what) in [("2:1", "priority"), ("3:1", "`2 GPUs`"), ("6:2", "regions")] {
        let begin = format!("/t/job.toml:{place}: ");
        assert!(
            exported.left_out.iter().any(|line| line.starts_with(&begin) && line.contains(what)),
            "{:#?}",
            exported.left_out
        );
    }
    assert_eq!(exported.left_out.len(), 3);
}

#[test]
fn a_job_of_more_values_than_a_template_may_have_is_refused() {
    let values = (0..1100).map(|n| format!("{n}.5")).collect::<Vec<_>>().join(", ");
    let frames = FrameChunks { all: &[1], chunk: NonZeroUsize::MIN };
    let refused = export(&job(&format!("[sweep]\n\"a.b.c\" = [{values}]")), frames, Path::new("/t/job.yaml"));
    let error = refused.expect_err("too many").to_string();
    assert!(error.contains("1024"), "{error}");
}
