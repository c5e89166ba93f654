//! The quick part of the stress suite ([`femc_tests::stress`]). To run all of it:
//! `cargo run --release -p femc-tests --example stress`.

use femc_tests::stress::{Effort, GROUPS, Verdict};

/// Measures a group within seconds.
fn check(name: &str) {
    let group = GROUPS.iter().find(|group| group.name == name).expect("a group");
    let mut failed = Vec::new();
    group.run(&Effort::QUICK, |line| {
        println!("{}: {} +- {}, true {}: {:?}", line.name, line.value, line.error, line.truth, line.verdict);
        if let Verdict::Fails(why) = &line.verdict {
            failed.push(format!("{}: {why}", line.name));
        }
    });
    assert!(failed.is_empty(), "{failed:#?}");
}

macro_rules! groups {
    ($($test:ident: $name:literal,)*) => {
        $(#[test]
        fn $test() {
            check($name);
        })*

        #[test]
        fn every_group_is_tested() {
            let names: Vec<_> = GROUPS.iter().map(|group| group.name).collect();
            assert_eq!(names, [$($name),*]);
        }
    };
}

groups! {
    peaks_of_phase_functions_are_as_narrow_as_they_are_told: "peaks",
    closed_rooms_of_one_radiance_are_of_that_radiance: "furnace",
    what_gives_as_much_as_it_takes_is_invisible: "media",
    rough_mirrors_lose_what_their_microfacets_hide: "gloss",
    needles_and_faces_without_area_or_twice_are_harmless: "faces",
    lamps_of_any_size_and_brightness_light_by_their_form_factors: "lamps",
    many_lamps_add_up: "lights",
    integrating_spheres_and_spheres_of_gas_are_as_they_are_calculated: "spheres",
    point_sources_in_endless_media_are_as_they_are_calculated: "sources",
    half_spaces_and_slabs_are_as_they_are_tabulated: "slabs",
    a_scene_in_other_words_is_the_same_image: "same",
    closed_meshes_let_no_ray_out: "tight",
}
