//! Tests of lamps whose light no method finds, and of frames that met no light.

use super::{all_output, test_folder};
use crate::common::TestFolder;
use femc_film::exr;
use serde_json::Value;

/// A floor and a camera that looks at it from below the lamp, whose center is at 0 0 1.
const FLOOR: &str = "camera main =\n\torigin 0 0 .7\n\ttarget 0 0 0\n\tup 0 1 0\n\tfov 70\n\tfilm 16 16\n\
    m floor =\n\tsides 2\n\trd .5\nv f0 =\n\tp -2 -2 0\nv f1 =\n\tp 2 -2 0\nv f2 =\n\tp 2 2 0\nv f3 =\n\tp -2 2 0\nm floor\nf f0 f1 f2 f3\n\
    v middle =\n\tp 0 0 1\nv top =\n\tp 0 0 1.15\nv bottom =\n\tp 0 0 .85\n";

/// Lamps of at most 5 cm around the center.
const LAMPS: [(&str, &str); 5] = [
    ("point", "ies lamp-point.ies -t 0 0 1\n"),
    ("sized luminaire", "ies lamp-box.ies -t 0 0 1\n"),
    ("bulb", "m bulb =\n\tsides 1\n\ted 40000\nm bulb\nsph middle .05\n"),
    (
        "face",
        "m panel =\n\tsides 1\n\ted 40000\nv p0 =\n\tp -.05 -.05 1\nv p1 =\n\tp -.05 .05 1\nv p2 =\n\tp .05 .05 1\nv p3 =\n\tp .05 -.05 1\n\
         m panel\nf p0 p1 p2 p3\n",
    ),
    (
        "sheet",
        "m panel =\n\tsides 2\n\ted 40000\nv p0 =\n\tp -.05 -.05 1\nv p1 =\n\tp -.05 .05 1\nv p2 =\n\tp .05 .05 1\nv p3 =\n\tp .05 -.05 1\n\
         m panel\nf p0 p1 p2 p3\n",
    ),
];

const BALL: &str = "sph middle .15\n";
const TUBE: &str = "cyl bottom .15 top\n";
const BOX: &str = "v b0 =\n\tp -.15 -.15 1.15\nv b1 =\n\tp .15 -.15 1.15\nv b2 =\n\tp .15 .15 1.15\nv b3 =\n\tp -.15 .15 1.15\n\
    prism b0 b1 b2 b3 .3\n";
/// A closed tube with a hole of 4 cm in its bottom.
const CAN: &str = "cyl bottom .15 top\nv top =\n\tp 0 0 1.15\n\tn 0 0 1\nring top 0 .15\nv bottom =\n\tp 0 0 .85\n\tn 0 0 -1\n\
    ring bottom .02 .15\n";

/// Enclosures of the lamps: material and surfaces.
const ENCLOSURES: [(&str, &str, &str); 16] = [
    ("nothing", "", ""),
    ("ball of glass", "sides 1\n\tir 1.5 0\n\tts 1 0", BALL),
    ("block of glass", "sides 1\n\tir 1.5 0\n\tts 1 0", BOX),
    ("ball without a bend", "sides 1\n\tir 1 0\n\tts 1 0", BALL),
    ("thin ball", "sides 2\n\trs .1 0\n\tts .8 0", BALL),
    ("rough glass", "sides 1\n\tir 1.5 0\n\tts 1 .3", BALL),
    ("glass with a haze", "sides 1\n\tir 1.5 0\n\tts .8 0\n\ttd .1", BALL),
    ("paper", "sides 2\n\trd .3\n\ttd .4", BALL),
    ("white ball", "sides 2\n\trd .5", BALL),
    ("solid ball", "sides 1\n\trd .5", BALL),
    ("ball of plastic", "sides 1\n\tir 1.5 0\n\trd .5\n\trs .04 0", BALL),
    ("mirror ball", "sides 2\n\trs .9 0", BALL),
    ("ball open from outside", "sides 1\n\trd .5", "sph middle -.15\n"),
    ("white shade", "sides 2\n\trd .5", TUBE),
    ("mirror shade", "sides 2\n\trs .9 0", TUBE),
    ("can with a hole", "sides 2\n\trd .5", CAN),
];

/// Returns the lines of `check` about lamps that light nothing.
fn hidden_lamps(dir: &TestFolder, file: &str) -> Vec<String> {
    let json = dir.run(&format!("check {file} --json")).exits(0).json();
    let faults = json["faults"].as_array().expect("faults").clone();
    let is_hidden = |fault: &&Value| fault["kind"] == "lights-nothing";
    faults.iter().filter(is_hidden).map(|fault| fault["message"].as_str().expect("a message").to_owned()).collect()
}

fn mean(dir: &TestFolder, file: &str) -> f64 {
    let image = exr::read(&dir.path(file)).expect("a picture").image;
    let sum: f64 = image.pixels.iter().map(|pixel| f64::from(pixel[1])).sum();
    sum / image.pixels.len() as f64
}

#[test]
fn a_point_in_solid_glass_is_named_and_a_bulb_is_found() {
    let dir = test_folder();
    let named = hidden_lamps(&dir, "glass-globe.mgf");
    assert!(named.len() == 1 && named[0].contains("cannot get through the solid glass"), "{named:?}");
    assert_eq!(hidden_lamps(&dir, "glass-globe-bulb.mgf"), [""; 0]);
    for method in ["femc", "pt", "fem"] {
        let ran = dir.run(&format!("render glass-globe.mgf -o x.exr --spp 16 --method {method} --fresh")).exits(0);
        let said = all_output(&ran);
        assert!(said.contains("glass-globe.mgf:30: the light of this lamp cannot get through"), "{said}");
        assert!(said.contains("thin sheet (`sides 2`, no `ir`)"), "{said}");
        if method == "fem" {
            // Particles from the lamp bring its light through the glass.
            assert!(mean(&dir, "x.exr") > 0.0, "{said}");
            continue;
        }
        assert!(said.contains("no sample met light in any of the 4 blocks") && !said.contains("0.00 %"), "{said}");
        assert!(said.contains("no sample of frame 1 met light"), "{said}");
    }
    // No server listens on that port. The warning is printed before the connection fails.
    let ran = dir.run("submit glass-globe.mgf --spp 16 --method pt --server http://127.0.0.1:9").exits(4);
    assert!(all_output(&ran).contains("the light of this lamp cannot get through"), "{}", all_output(&ran));
    let ran = dir.run("render glass-globe-bulb.mgf -o bulb.exr --spp 128 --method femc").exits(0);
    assert!(!all_output(&ran).contains("warning"), "{}", all_output(&ran));
    let found = mean(&dir, "bulb.exr");
    assert!((found / 12.4 - 1.0).abs() < 0.05, "{found}");
}

/// Checks that every lamp in every enclosure has a warning if and only if its picture is black.
#[test]
fn a_lamp_is_named_just_where_no_sample_meets_its_light() {
    let dir = test_folder();
    let table = "IESNA:LM-63-2002\n[TEST] a cube\nTILT=NONE\n1 -1 1 2 1 1 2 .05 .05 .05\n1 1 20\n0 180\n0\n100 100\n";
    dir.write("lamp-box.ies", table);
    let (mut wrong, mut black) = (Vec::new(), 0);
    for (around, material, surfaces) in ENCLOSURES {
        for (lamp, text) in LAMPS {
            let shade = if surfaces.is_empty() {
                String::new()
            } else {
                format!("m shade =\n\t{material}\nm shade\n{surfaces}")
            };
            dir.write("t.mgf", &format!("{FLOOR}{text}{shade}"));
            let ran = dir.run("render t.mgf -o t.exr --spp 64 --method pt --fresh --json").exits(0);
            let report = ran.json();
            let is_black = report["unlit_blocks"] == 1;
            assert_eq!(report["relative_error"].is_null(), is_black, "{report}");
            black += u32::from(is_black);
            let named = hidden_lamps(&dir, "t.mgf");
            if named.len() != usize::from(is_black) {
                wrong.push(format!("{lamp} in {around}: {named:?}, black: {is_black}"));
            }
            assert_eq!(
                named.is_empty(),
                !ran.stderr().contains("of this lamp"),
                "{lamp} in {around}: {}",
                ran.stderr()
            );
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
    assert!((20..40).contains(&black), "{black} of 80 are black");
}

/// Returns a room of 4 m with a ceiling at 3 m.
fn room(lamp: &str) -> String {
    let plate = |name: &str, z: f64| {
        format!(
            "v {name}0 =\n\tp -2 -2 {z}\nv {name}1 =\n\tp 2 -2 {z}\nv {name}2 =\n\tp 2 2 {z}\nv {name}3 =\n\tp -2 2 {z}\n\
             f {name}0 {name}1 {name}2 {name}3\n"
        )
    };
    let wall = |name: &str, [a, b]: [&str; 2]| format!("f {name}{a} {name}{b} c{b} c{a}\n");
    let walls = [["0", "1"], ["1", "2"], ["2", "3"], ["3", "0"]].map(|ends| wall("f", ends)).concat();
    format!(
        "camera main =\n\torigin 0 -1.5 1.5\n\ttarget 0 1 1\n\tfov 60\n\tfilm 16 16\nm wall =\n\tsides 2\n\trd .5\n{}{}{walls}{lamp}",
        plate("f", 0.0),
        plate("c", 3.0)
    )
}

#[test]
fn a_luminaire_above_the_ceiling_or_in_a_wall_is_named() {
    let dir = test_folder();
    let down = "IESNA:LM-63-2002\n[TEST] down\nTILT=NONE\n1 -1 1 2 1 1 2 0 0 0\n1 1 20\n0 60\n0\n100 100\n";
    dir.write("down.ies", down);
    let in_room = |lamp: &str| {
        dir.write("room.mgf", &room(lamp));
        hidden_lamps(&dir, "room.mgf")
    };
    // A second lamp lights the room, so that the camera sees light.
    let lit = "ies down.ies -t 0 0 2.5\n";
    let named = |lamp: &str, words: &str| {
        let found = in_room(&format!("{lit}{lamp}"));
        assert!(found.len() == 1 && found[0].contains(words), "{lamp}: {found:?}");
    };
    assert_eq!(in_room(lit), [""; 0]);
    assert_eq!(in_room("ies lamp-point.ies -t 0 0 3\n"), [""; 0], "in the plane of the ceiling");
    named("ies down.ies -t 0 0 3.02\n", "does not reach any place that a camera sees");
    named("ies lamp-point.ies -t 0 0 3.5\n", "does not reach any place that a camera sees");
    let block = "m block =\n\tsides 1\n\trd .5\nv k0 =\n\tp -.5 1 1\nv k1 =\n\tp .5 1 1\nv k2 =\n\tp .5 1.4 1\nv k3 =\n\tp -.5 1.4 1\n\
        m block\nprism k0 k1 k2 k3 .8\n";
    named(&format!("{block}ies lamp-point.ies -t 0 1.2 .6\n"), "inside a solid, or behind a one-sided surface");
    // Without walls the light of the lamp and the view both leave the scene.
    let pavilion = room(&format!("{lit}ies down.ies -t 0 0 3.02\n")).replace("f f0 f1 c1 c0\n", "");
    dir.write("pavilion.mgf", &pavilion);
    let found = hidden_lamps(&dir, "pavilion.mgf");
    assert!(found.len() == 1 && found[0].contains("only surfaces within"), "{found:?}");
    // Light that enters through an opening is not excluded.
    let through =
        room("m lamp =\n\tsides 1\n\ted 1000\nv o =\n\tp 0 -5 2\nm lamp\nsph o .2\n").replace("f f0 f1 c1 c0\n", "");
    dir.write("open.mgf", &through);
    assert_eq!(hidden_lamps(&dir, "open.mgf"), [""; 0]);
}

/// Renders a floor that reflects on one side only: one block meets no light.
#[test]
fn blocks_without_light_are_counted_on_the_terminal_and_in_json() {
    let dir = test_folder();
    let floor = FLOOR.replace("p 2 -2 0", "p 0 -2 0").replace("p 2 2 0", "p 0 2 0").replace("film 16 16", "film 32 16");
    dir.write("half.mgf", &format!("{floor}ies lamp-point.ies -t 0 0 1\n"));
    let ran = dir.run("render half.mgf -o half.exr --spp 16 --method pt").exits(0);
    assert!(all_output(&ran).contains(", 1 of 2 blocks met no light"), "{}", all_output(&ran));
    let again = dir.run("render half.mgf -o half.exr --spp 16 --method pt --json").exits(0).json();
    assert_eq!([&again["blocks"], &again["unlit_blocks"]], [2, 1], "{again}");
    assert_eq!([&again["frames"][0]["blocks"], &again["frames"][0]["unlit_blocks"]], [2, 1]);
    assert!(again["relative_error"].as_f64().is_some_and(|error| error > 0.0), "{again}");
    // An existing frame is recognized by its file.
    dir.run("render glass-globe.mgf -o dark.exr --spp 2 --method pt").exits(0);
    let again = dir.run("render glass-globe.mgf -o dark.exr --spp 2 --method pt --json").exits(0).json();
    assert_eq!(
        (&again["rendered"], &again["unlit_blocks"], &again["relative_error"]),
        (&0.into(), &4.into(), &Value::Null)
    );
    // The error never converges without light.
    let ran = dir.run("render glass-globe.mgf -o goal.exr --error .1 --method pt").exits(0);
    assert!(
        all_output(&ran).contains("no sample met light in any") && !all_output(&ran).contains("relative error"),
        "{}",
        all_output(&ran)
    );
}

#[test]
fn first_pass_names_the_share_of_light_through_solids() {
    let dir = test_folder();
    let ran = dir.run("render glass-globe-bulb.mgf -o fem.exr --spp 4 --method fem").exits(0);
    assert!(
        ran.stderr().contains("100 % of the lamps' light (1257 lm) first passes through clear solids"),
        "{}",
        ran.stderr()
    );
    let ran = dir.run("field glass-globe-bulb.mgf -o fem.glb --error 2").exits(0);
    assert!(ran.stderr().contains("100 % of the lamps' light (1257 lm)"), "{}", ran.stderr());
    // A second bulb in the open has half of the light; path tracing finds all of that half.
    let two = dir.read("glass-globe-bulb.mgf") + "v side =\n\tp 1 0 1\nm bulb\nsph side .01\n";
    dir.write("two.mgf", &two);
    let ran = dir.run("render two.mgf -o two.exr --spp 4 --method fem").exits(0);
    assert!(ran.stderr().contains("% of the lamps' light"), "{}", ran.stderr());
    let ran = dir.run("render two.mgf -o two.exr --spp 4 --method pt --fresh").exits(0);
    assert!(!ran.stderr().contains("of the lamps' light"), "{}", ran.stderr());
}
