//! Work that a pilot expects of a job, against the work that the job really has, counted by hand. The frames of short jobs are
//! solved one by one, too, and solutions that are equal to the bit are one.

use crate::layers::scene;
use femc_pipeline::method_choice::choose_method;
use femc_pipeline::{
    Method, SceneSource, Settings, StopCondition, encode_solution, first_pass_world, plan_job, solve_first_pass,
};
use std::collections::BTreeSet;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

/// A clip of six frames, 0.1 s apart: a floor, a wall, a block and two lamps, in fog.
/// - `lamp`, `block`: lines before the lamp and before the block, for transforms;
/// - `more`: lines at the end.
fn text(camera: &str, lamp: &str, block: &str, more: &str) -> String {
    let end = |transform: &str| if transform.is_empty() { "" } else { "xf\n" };
    let (lamp_end, block_end) = (end(lamp), end(block));
    format!(
        "time 0 .5 10\npath way = linear\n\tkey 0 -t 0 0 0\n\tkey .5 -t .5 .2 0\npath halt = linear\n\tkey 0 -t 0 0 0\n\tkey .2 -t .4 0 0\n\
         \tkey .5 -t .4 0 0\ncamera main =\n\torigin 0 -3 2\n\ttarget 0 0 0\n\tfov 40\n\tfilm 64 64\n{camera}medium haze =\n\tsigma_s .05\n\
         mbox haze 1 1 0 2 2 1\nm white =\n\tsides 2\n\tc\n\trd .6\nm lamp =\n\tsides 1\n\tc\n\ted 400\nm bulb =\n\tsides 1\n\tc\n\ted 150\n\
         v a =\n\tp -2 -2 0\nv b =\n\tp 2 -2 0\nv c =\n\tp 2 2 0\nv d =\n\tp -2 2 0\nv e =\n\tp 2 2 2\nv f =\n\tp -2 2 2\nm white\nf a b c d\n\
         f d c e f\n{block}o block\nv g =\n\tp -.5 .5 .3\nsph g .3\no\n{block_end}m lamp\n{lamp}v h =\n\tp 0 0 1.5\nsph h .1\n{lamp_end}m bulb\n\
         v i =\n\tp 1 1 1\nsph i .05\n{more}"
    )
}

struct Job {
    name: &'static str,
    text: String,
    frames: &'static [u32],
    /// Number of different worlds, counted by hand.
    worlds: usize,
}

const ALL: &[u32] = &[1, 2, 3, 4, 5, 6];

fn jobs() -> Vec<Job> {
    let job = |name, text, frames, worlds| Job { name, text, frames, worlds };
    let vary = |line: &str| text("", "", "", &format!("vary {line}\n"));
    let lamp = |path: &str| text("", &format!("xf -path {path}\n"), "", "");
    vec![
        job("nothing moves", text("", "", "", ""), ALL, 1),
        job("the camera moves", text("\talong way\n", "", "", ""), ALL, 1),
        job("the lamp moves", lamp("way"), ALL, 6),
        job("some frames of a lamp that moves", lamp("way"), &[2, 5], 2),
        job("a lamp that stops", lamp("halt"), ALL, 3),
        job("frames after the stop", lamp("halt"), &[3, 4, 6], 1),
        job("the block moves", text("", "", "xf -path way\n", ""), ALL, 6),
        job("both stop", text("", "xf -path halt\n", "xf -path halt\n", ""), ALL, 3),
        job("the block vanishes", vary("object.block.hidden = 0 0 .25 0 .26 1 .5 1"), ALL, 2),
        job("one lamp dims", vary("material.lamp.ed = 0 400 .5 100"), ALL, 6),
        job("both lamps dim", vary("material.lamp.ed = 0 400 .5 100\nvary material.bulb.ed = 0 150 .5 37.5"), ALL, 1),
        job("the walls darken", vary("material.white.rd = 0 .6 .5 .2"), ALL, 6),
        job("the fog thickens", vary("medium.haze.sigma_s = 0 .05 .5 .5"), ALL, 6),
    ]
}

/// Returns the number of different solutions of a job's frames.
fn solved_worlds(source: &SceneSource, settings: &Settings, frames: &[u32]) -> usize {
    let solved = |frame: &u32| {
        let world = first_pass_world(source, settings, *frame, None).expect("a world");
        encode_solution(&solve_first_pass(&world, Method::Femc, &AtomicBool::new(false)).expect("a solution"))
    };
    frames.iter().map(solved).collect::<BTreeSet<_>>().len()
}

#[test]
fn a_pilot_counts_the_first_passes_that_its_job_solves() {
    const SPP: u32 = 512;
    let settings = Settings { stop: StopCondition::Spp(SPP), ..Settings::default() };
    for Job { name, text, frames, worlds } in jobs() {
        let source = SceneSource::new(Arc::new(scene(&text)));
        let pilot_of = |frames: &[u32]| {
            let plan = plan_job(source.scene(), &settings, Some(frames)).expect("a plan");
            assert_eq!(plan.frames, frames, "{name}");
            choose_method(&source, &settings, &plan).expect("a choice").0.pilot.expect("a pilot")
        };
        let (one, all) = (pilot_of(&frames[..1]), pilot_of(frames));
        if frames.len() <= 3 {
            assert_eq!(solved_worlds(&source, &settings, frames), worlds, "{name}: different solutions");
        }
        assert_eq!(all.first_pass_rays, one.first_pass_rays * worlds as f64, "{name}: work of the first passes");
        let ratio = all.learning_rays / one.learning_rays / frames.len() as f64;
        assert!((ratio - 1.0).abs() < 0.1, "{name}: each frame learns its targets: {ratio}");
        assert!(one.first_pass_rays > 0.0 && one.learning_rays > 0.0);
        let samples = 64.0 * 64.0 * f64::from(SPP) * frames.len() as f64;
        assert_eq!(all.samples_a_pixel, f64::from(SPP), "{name}");
        assert!((all.rays / (all.rays_a_sample * samples) - 1.0).abs() < 1e-12, "{name}: {}", all.rays);
        assert!((1.0..50.0).contains(&all.rays_a_sample), "{name}: {}", all.rays_a_sample);
    }
}

/// The work of a first pass grows with the surfaces, each counted as often as it is placed.
#[test]
fn a_pilot_counts_each_copy_of_a_surface() {
    let settings = Settings { stop: StopCondition::Spp(512), ..Settings::default() };
    let rays = |block: &str| {
        let source = SceneSource::new(Arc::new(scene(&text("", "", block, ""))));
        let plan = plan_job(source.scene(), &settings, Some(&[1])).expect("a plan");
        choose_method(&source, &settings, &plan).expect("a choice").0.pilot.expect("a pilot").first_pass_rays
    };
    let one = rays("");
    let [five, nine] = ["xf -a 5 -t .2 0 0\n", "xf -a 3 -t .2 0 0 -a 3 -t 0 .2 0\n"].map(rays);
    assert!(five > one && ((nine - one) / (five - one) - 2.0).abs() < 1e-9, "{one} {five} {nine}");
}
