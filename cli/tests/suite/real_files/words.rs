//! Tests of messages that could mislead users.

use super::{all_output, test_folder};
use crate::common::{CommandOutput, TestFolder};

/// Runs `femc` with these arguments in the folder.
fn run(dir: &TestFolder, line: &str, more: &[&str]) -> CommandOutput {
    let mut command = dir.command(line);
    let output = command.args(more).output().expect("femc starts");
    CommandOutput::new(&format!("{line} {more:?}"), output)
}

#[test]
fn the_prefix_of_other_renderers_is_taken_off() {
    let dir = test_folder();
    for (name, expression) in [("a", "lpe:C<RD><L.>"), ("b", "C<RD><L.>")] {
        let out = format!("render rough-only.mgf -o {name}.exr --spp 16 --threads 1 --layer");
        run(&dir, &out, &[&format!("t={expression}")]).exits(0);
    }
    let [a, b] = ["a", "b"].map(|name| {
        femc_film::exr::read_channels(&dir.path(&format!("{name}.layers.exr")), ["t.R"]).expect("a layer").2
    });
    assert!(a == b && a[0].iter().any(|value| *value > 0.0));
    let ran = run(&dir, "plan rough-only.mgf --no-trial --layer", &["t=unoccluded;lpe:C<RD><L.>"]).exits(2);
    assert!(ran.stderr().contains("leave it out"), "{}", ran.stderr());
}

#[test]
fn layer_that_stays_black_is_warned_about_with_a_hint() {
    let dir = test_folder();
    let ran = run(&dir, "render rough-only.mgf -o x.exr --spp 16 --threads 1 --layer", &["t=CS[DS]*L"]).exits(0);
    let warning = "femc: warning: layer `t` stays black: no surface of the scene makes the event `S`";
    assert!(ran.stderr().contains(warning) && ran.stderr().contains("write `G` instead of `S`"), "{}", ran.stderr());
    let channels = femc_film::exr::read_channels(&dir.path("x.layers.exr"), ["t.R", "t.G", "t.B"]).expect("layers");
    assert!(channels.2.iter().flatten().all(|value| *value == 0.0));
    for (layer, is_black) in [("t=CS[DS]*L", true), ("t=CG[DG]*L", false), ("t=CV.*", true), ("t=CTL", true)] {
        let ran = run(&dir, "plan rough-only.mgf --no-trial --layer", &[layer]).exits(0);
        assert_eq!(ran.stderr().contains("stays black"), is_black, "{layer}: {}", ran.stderr());
    }
    // Black layers of a set have no warning; a black layer that is requested by name has one.
    let ran = dir.run("plan rough-only.mgf --no-trial --layers guides,lamps").exits(0);
    assert!(!ran.stderr().contains("black"), "{}", ran.stderr());
    let ran = dir.run("plan rough-only.mgf --no-trial --layers fog").exits(0);
    assert!(ran.stderr().contains("layer `fog` stays black: no medium of the scene"), "{}", ran.stderr());
}

#[test]
fn frames_that_begin_with_a_minus_are_refused_as_frames() {
    let dir = test_folder();
    for command in ["plan", "render", "submit"] {
        let ran = dir.run(&format!("{command} clip.mgf --frames -5..5")).exits(2);
        let text = ran.stderr();
        assert!(text.contains("`-5..5` is not a list of frames; write K, A..B"), "{command}: {text}");
        assert!(!text.contains("tip") && !text.contains("unexpected"), "{command}: {text}");
    }
}

#[test]
fn transparency_of_a_painting_is_named() {
    let dir = test_folder();
    dir.run("render rough-only.mgf -o s.exr --spp 8 --layers guides --threads 1").exits(0);
    let line =
        "stylize --style painting-with-hole.png --source s.layers.exr --target s.layers.exr -o p.png --threads 1";
    let ran = dir.run(line).exits(0);
    let text = ran.stderr();
    assert_eq!(text.matches("count as white paint").count(), 1, "{text}");
    assert!(text.contains("femc: warning: --style painting-with-hole.png: the painting is transparent in"), "{text}");
    let ran = dir.run(&line.replace("painting-with-hole.png", "p.png").replace("-o p.png", "-o q.png")).exits(0);
    assert!(!ran.stderr().contains("transparent"), "{}", ran.stderr());
}

/// Returns two triangles of a material, in the given objects.
fn two_triangles(first: &str, second: &str) -> String {
    let surface = "v a =\n\tp 0 0 0\nv b =\n\tp 1 0 0\nv c =\n\tp 0 1 0\n";
    let camera = "camera main =\n\torigin 0 0 3\n\ttarget .3 .3 0\n\tup 0 1 0\n\tfilm 8 8\n";
    let one = |lines: &str| lines.replace('F', "f a b c").replace(';', "\n");
    format!("{camera}{surface}m lamp =\n\ted 100\n{}\nxf -t 0 0 .5\n{}\nxf\n", one(first), one(second))
}

#[test]
fn objects_of_one_name_do_not_merge_without_a_word() {
    let dir = test_folder();
    for (first, second, merged) in [
        ("o car;F;o", "o car;F;o", Some("car")),
        ("o car;o wheel;F;o;o", "o car.wheel;F;o", Some("car.wheel")),
        ("o car;o wheel;F;o;o", "o car;o wheel;F;o;o", Some("car")),
        ("o car;F;o", "o bus;F;o", None),
        ("o a;o wheel;F;o;o", "o b;o wheel;F;o;o", None),
    ] {
        dir.write("two.mgf", &two_triangles(first, second));
        let check = dir.run("check two.mgf --all").exits(0).stdout();
        let render = dir.run("plan two.mgf --no-trial").exits(0).stderr();
        for text in [check, render] {
            match merged {
                Some(name) => assert!(
                    text.contains(&format!("object `{name}` is opened again, first at two.mgf:")),
                    "{first} {second}: {text}"
                ),
                None => assert!(!text.contains("opened again"), "{first} {second}: {text}"),
            }
        }
    }
    // There is one warning per name, and copies in one place are one object.
    dir.write("two.mgf", &two_triangles("o car;F;o;o car;F;o", "o car;F;o"));
    let check = dir.run("check two.mgf --all").exits(0).stdout();
    assert_eq!(check.matches("opened again").count(), 1, "{check}");
    dir.write("two.mgf", &two_triangles("xf -a 3 -t 2 0 0;o car;F;o;xf", "o bus;F;o"));
    let check = dir.run("check two.mgf --all").exits(0).stdout();
    assert!(!check.contains("opened again"), "{check}");
}

#[test]
fn object_named_default_gets_a_warning_about_its_cryptomatte_id() {
    let dir = test_folder();
    dir.write("two.mgf", &two_triangles("o default;F;o", "F"));
    let check = dir.run("check two.mgf").exits(0).stdout();
    assert!(check.contains("object `default` has the same Cryptomatte id as surfaces outside of objects"), "{check}");
    let plan = dir.run("plan two.mgf --no-trial --layers object").exits(0).stderr();
    assert!(plan.contains("the object called `default` has the same Cryptomatte id"), "{plan}");
    let plan = dir.run("plan two.mgf --no-trial --layers depth").exits(0).stderr();
    assert!(!plan.contains("Cryptomatte"), "{plan}");
    for (first, second) in [("o default;F;o", "o other;F;o"), ("F", "o other;F;o")] {
        dir.write("two.mgf", &two_triangles(first, second));
        let check = dir.run("check two.mgf").exits(0).stdout();
        let plan = dir.run("plan two.mgf --no-trial --layers object,material").exits(0).stderr();
        assert!(!check.contains("Cryptomatte") && !plan.contains("Cryptomatte"), "{check}{plan}");
    }
}

#[test]
fn a_long_layer_name_sets_the_flag_of_long_names() {
    let dir = test_folder();
    for (name, is_long) in [("short", false), ("a_layer_with_a_name_of_more_than_thirty_one_letters", true)] {
        run(&dir, "render clip.mgf -o x.exr --frames 1 --spp 1 --threads 1 --fresh --layer", &[&format!("{name}=CL")])
            .exits(0);
        let bytes = std::fs::read(dir.path("x.layers.exr")).expect("layers");
        assert_eq!(u32::from_le_bytes(bytes[4..8].try_into().expect("a word")) & 0x400 != 0, is_long, "{name}");
    }
}

#[test]
fn warnings_are_grouped_in_front_of_a_render_as_in_check() {
    let dir = test_folder();
    let odd = "c\ncspec 380 780 1 1 1 1 1 1 1 -1\n".repeat(40);
    dir.write("odd.mgf", &(odd + crate::common::FOG));
    let check = dir.run("check odd.mgf").exits(0).stdout();
    for command in ["render odd.mgf -o x.exr --frames 1 --spp 1 --threads 1", "plan odd.mgf --spp 1 --no-trial"] {
        let text = dir.run(command).exits(0).stderr();
        let lines: Vec<&str> = text.lines().filter(|line| line.contains("negative value")).collect();
        let [line] = lines[..] else { panic!("{text}") };
        assert!(line.starts_with("warning: odd.mgf:2: 40 (negative-spectrum), the first: "), "{line}");
        assert!(line.contains("and 36 more places; `femc check odd.mgf --all` lists them"), "{line}");
        // Both commands print the same text.
        let words = line.trim_start_matches("warning: odd.mgf:2: ").split(" (also at").next().expect("words");
        assert!(check.contains(words), "{check}");
    }
}

/// Returns every control character that can occur in a name: all but blanks and line ends, which separate fields.
fn control_characters() -> String {
    let all = (1..0xa0u32).filter(|code| !(0x20..0x7f).contains(code)).filter_map(char::from_u32);
    let inside = all.filter(|c| !c.is_whitespace());
    inside.chain(['\u{202e}', '\u{2066}', '\u{61c}', '\u{200f}']).collect()
}

#[test]
fn no_control_character_of_a_scene_reaches_the_terminal() {
    let dir = test_folder();
    let name = format!("n{}m", control_characters());
    let scene = two_triangles("o NAME;F;o;nonsense NAME;m NAME =;\tc;\trd .5;F", "o NAME;F;o;").replace("NAME", &name);
    let camera = format!("camera {name} =\n\torigin 0 0 5\n\ttarget 0 0 0\n\tup 0 1 0\n\tfilm 8 8\n");
    dir.write("steer.mgf", &(scene + &camera));
    dir.write("broken.mgf", &format!("m {name} =\n\trd {name}\n"));
    dir.write("missing.mgf", &format!("i {name}.mgf\n"));
    dir.write("unknown.mgf", &format!("m {name}\nf {name} {name} {name}\n"));
    for line in [
        "check steer.mgf",
        "check steer.mgf --all",
        "check steer.mgf --json",
        "check steer.mgf --color always",
        "plan steer.mgf --no-trial",
        "plan steer.mgf --no-trial --json --layers object",
        "plan steer.mgf --no-trial --camera other",
        "plan steer.mgf --no-trial --set material.other.rd=1",
        "render steer.mgf -o x.exr --spp 1 --threads 1",
        "render steer.mgf -o x.exr --spp 1 --threads 1 --json --fresh",
        "field steer.mgf -o x.glb",
        "submit steer.mgf --server http://127.0.0.1:9",
        "check broken.mgf",
        "check broken.mgf --json",
        "render broken.mgf",
        "check missing.mgf",
        "check unknown.mgf",
        "plan unknown.mgf",
    ] {
        let ran = dir.run(line);
        let text = all_output(&ran);
        let steers = |c: &char| {
            (c.is_control() && *c != '\n')
                || matches!(*c, '\u{202a}'..='\u{202e}' | '\u{2066}'..='\u{2069}' | '\u{61c}' | '\u{200f}')
        };
        let own =
            text.replace("\x1b[1;31m", "").replace("\x1b[1;33m", "").replace("\x1b[1m", "").replace("\x1b[0m", "");
        let text = if line.contains("always") { own } else { text };
        let found: Vec<char> = text.chars().filter(steers).collect();
        assert!(found.is_empty(), "{line}: {found:?} in {text:?}");
        if line.ends_with("--json") && ran.code() == Some(0) {
            ran.json();
        }
    }
}

#[test]
fn what_submit_refuses_or_warns_about_is_in_the_list_of_check() {
    let dir = test_folder();
    let good = two_triangles("F", "o b;F;o");
    let big = good.replace("film 8 8", "film 10000 10000");
    let blind = good.replace("target .3 .3 0", "target 0 0 3");
    let upward = good.replace("up 0 1 0", "up .3 .3 -3");
    let turned = good.replace("\tup 0 1 0\n", "\tup 0 1 0\n\talong way\n")
        + "path way = linear\nkey 0 -t 0 0 0\nkey 1 -t 0 0 1\ntime 0 1 4\n";
    for (title, scene) in [
        ("no light", good.replace("\ted 100\n", "\trd .5\n")),
        ("nothing", "camera main =\n\torigin 0 0 3\n\ttarget 0 0 0\n\tup 0 1 0\n\tfilm 8 8\n".to_owned()),
        ("empty", "# nothing\n".to_owned()),
        ("a film too large", big),
        ("a blind camera", blind),
        ("a camera that looks along up", upward),
        ("a path", turned),
        ("no camera", good.split("v a =").nth(1).map_or(String::new(), |rest| format!("v a ={rest}"))),
        ("a vary of nothing", format!("{good}time 0 1 4\nvary material.none.rd = 0 0 1 1\n")),
        ("a vary beyond its domain", format!("{good}time 0 1 4\nvary material.lamp.rd = 0 0 1 7\n")),
        ("a clip of no frame", format!("{good}time 1 0 4\n")),
        ("undefined", "m none\n".to_owned()),
        ("good", good),
    ] {
        dir.write("s.mgf", &scene);
        let check = dir.run("check s.mgf --json");
        let faults = check.json()["faults"].as_array().expect("faults").clone();
        let of = |severity: &str| faults.iter().filter(|it| it["severity"] == severity).count();
        let render = dir.run("render s.mgf -o s.exr --frames 1 --spp 1 --threads 1 --fresh");
        let plan = dir.run("plan s.mgf --no-trial");
        // No server listens on that port: exit code 4 means that the scene itself was accepted.
        let submit = dir.run("submit s.mgf --server http://127.0.0.1:9 --method pt");
        let refused = [&render, &plan, &submit].into_iter().any(|ran| !matches!(ran.code(), Some(0 | 4)));
        if refused {
            assert!(of("error") > 0, "{title}: {}{}\n{faults:?}", render.stderr(), submit.stderr());
            assert_eq!(check.code(), Some(1), "{title}");
        }
        let warned = |ran: &CommandOutput| ran.stderr().lines().filter(|line| line.contains("warning: ")).count();
        for ran in [&render, &plan, &submit] {
            assert!(warned(ran) <= of("warning") + of("error"), "{title}: {}\n{faults:?}", ran.stderr());
        }
        if title.starts_with("no light") {
            for ran in [&render, &plan, &submit] {
                assert!(ran.stderr().contains("nothing in the scene emits light"), "{title}: {}", ran.stderr());
            }
        }
        if title == "good" {
            assert!(!refused && of("error") == 0, "{}{faults:?}", render.stderr());
        }
    }
}
