//! Tests of contexts, colors, materials, media, cameras and time.

use crate::common;
use crate::common::{SQUARE, scene, try_files, try_scene};
use femc_math::glam::DVec3;
use femc_scene::*;

fn luminance(c: [f64; 3]) -> f64 {
    0.212_639 * c[0] + 0.715_168_7 * c[1] + 0.072_192_32 * c[2]
}

fn is_close(a: [f64; 3], b: [f64; 3]) -> bool {
    a.iter().zip(b).all(|(a, b)| (a - b).abs() < 1e-6)
}

fn material<'s>(scene: &'s Scene, name: &str) -> &'s Material {
    scene.materials.iter().find(|m| m.name == name).expect("material")
}

#[test]
fn default_color_is_white_and_materials_capture_the_current_one() {
    let scene = scene("m a =\nrd .4\nc\ncrgb 1 0 0\nrs .3 .1\nc\ncrgb 0 1 0\nm b = a\ntd .2");
    let (a, b) = (material(&scene, "a"), material(&scene, "b"));
    assert_eq!(a.rd, TintedScalar { amount: 0.4, color: [1.0; 3] });
    assert_eq!((a.rs, a.rs_alpha), (TintedScalar { amount: 0.3, color: [1.0, 0.0, 0.0] }, 0.1));
    assert_eq!((b.rd, b.rs), (a.rd, a.rs), "the template's values");
    assert_eq!(b.td.color, [0.0, 1.0, 0.0]);
    assert_eq!(a.td, TintedScalar::default(), "a template is not changed by its copies");
}

#[test]
fn context_lines_follow_the_template_rule() {
    let scene = scene(
        "c red =\ncrgb 1 0 0\nc dark = red\ncrgb .1 0 0\nc red\nm one =\nrd 1\nc dark\nm two =\nrd 1\nc\nm three =\nrd 1\n\
        m\nrd .5\nv a =\nsph a 1\nm\nsph a 1",
    );
    let colors: Vec<_> = scene.materials.iter().take(3).map(|m| m.rd.color).collect();
    assert_eq!(colors, [[1.0, 0.0, 0.0], [0.1, 0.0, 0.0], [1.0; 3]]);
    let unnamed: Vec<_> = scene.materials[3..].iter().map(|m| (m.name.as_str(), m.rd.amount)).collect();
    assert_eq!(unnamed, [("", 0.5), ("", 0.0)], "`m` alone starts from black again");
}

#[test]
fn chromaticities_have_luminance_one_and_raw_colours_stay_raw() {
    let text = "c a =\ncxy .4 .35\nc b =\ncct 2700\nc d =\ncspec 400 700 .1 .2 .3 .9 .8 .7\nc e =\ncmix 1 a 3 b\n\
        c f =\ncrgb .2 .3 .4\nc g =\ncxy .333333333333 .333333333333\nc h =\ncmix 1 a\n";
    let uses: String = "abdefgh".chars().map(|c| format!("c {c}\nm {c} =\ned 1\n")).collect();
    let scene = scene(&(text.to_owned() + &uses));
    let color = |name| material(&scene, name).ed.color;
    for name in ["a", "b", "d", "e", "g"] {
        assert!((luminance(color(name)) - 1.0).abs() < 1e-6, "{name}: {:?}", color(name));
    }
    assert_eq!(color("f"), [0.2, 0.3, 0.4]);
    assert!(is_close(color("g"), [1.0; 3]), "equal energy is white");
    assert!(is_close(color("h"), color("a")));
    let mixed: [f64; 3] = std::array::from_fn(|k| 0.25 * color("a")[k] + 0.75 * color("b")[k]);
    assert!(is_close(color("e"), mixed), "weights are luminances");
    assert!(color("b")[0] > color("b")[2], "a lamp of 2700 K is reddish");
}

#[test]
fn changed_material_is_a_new_entry_and_an_equal_one_is_not() {
    let text = format!("{SQUARE}m x =\nrd .2\nf a b c\nrd .6\nf a c d\nm x\nf a b c\nm x =\nrd .2\nf a b c\n");
    let scene = scene(&text);
    let rd: Vec<f64> = scene.materials.iter().map(|m| m.rd.amount).collect();
    assert_eq!(rd, [0.2, 0.6]);
    let used: Vec<u32> = scene.groups[0].faces.iter().map(|f| f.material.0).collect();
    assert_eq!(used, [0, 1, 1, 0]);
}

#[test]
fn unused_materials_exist_and_stand_in_order_of_definition() {
    let scene = scene("m z =\nrd .1\nm a =\nrd .2\nm last =\nrd .3");
    assert_eq!(scene.materials.iter().map(|m| m.name.as_str()).collect::<Vec<_>>(), ["z", "a", "last"]);
}

#[test]
fn all_fields_of_a_material_arrive() {
    let scene = scene(
        "medium juice =\nsigma_a 3\nm full =\nsides 1\nrd .1\ntd .2\nrs .3 .05\nts .4 .06\nir 1.5 0.25\ned 100\nlobe 20\ninside juice",
    );
    let m = material(&scene, "full");
    assert_eq!(m.sides, Sides::One);
    assert_eq!([m.rd, m.td, m.rs, m.ts, m.ed].map(|t| t.amount), [0.1, 0.2, 0.3, 0.4, 100.0]);
    assert_eq!((m.rs_alpha, m.ts_alpha, m.ior), (0.05, 0.06, Some(Ior { re: 1.5, im: 0.25 })));
    assert_eq!((m.lobe, m.inside), (Some(20.0), Some(MediumId(0))));
    assert_eq!(m.location, Location { file: 0, line: 3, column: 1 });
}

#[test]
fn a_sum_above_one_is_scaled_to_one_whatever_it_is() {
    for (rs, sum) in [(0.2, 1.1), (0.9, 1.8)] {
        let loaded = try_scene(&format!("m bright =\nrd .9\nrs {rs} 0")).unwrap();
        let material = &loaded.scene.materials[0];
        assert!((material.rd.amount - 0.9 / sum).abs() < 1e-12 && (material.rs.amount - rs / sum).abs() < 1e-12);
        assert!(loaded.warnings[0].to_string().starts_with("t.mgf:3:1: material `bright`"), "{}", loaded.warnings[0]);
    }
    let raw = scene("c\ncrgb .5 .05 .04\nm paint =\nrd 1\nc\ncrgb 1 1 1\nrs .05 .1");
    assert_eq!(raw.materials[0].rd.amount, 1.0, "a raw color counts by its luminance");
    let raw = try_scene("c\ncrgb 2 2 2\nm a =\nrd .9").unwrap();
    assert!((raw.scene.materials[0].rd.photometric_amount() - 1.0).abs() < 1e-6 && raw.warnings.len() == 1);
    scene("m ok =\nrd .8\nrs .5 0\nrd .5");
}

#[test]
fn negative_spectrum_values_become_zero_with_one_warning() {
    let loaded = try_scene("\ncspec 400 700 1 -1 .5 -2\nm a =\ned 1\nc\ncspec 400 700 1 0 .5 0\nm b =\ned 1").unwrap();
    assert_eq!(loaded.scene.materials[0].ed, loaded.scene.materials[1].ed);
    let said: Vec<_> = loaded.warnings.iter().map(|w| w.to_string()).filter(|w| w.contains("negative")).collect();
    assert_eq!(said, ["t.mgf:2:1: spectrum has 2 negative values: treated as 0"]);
}

#[test]
fn zero_luminance_chromaticity_maps_to_nearest_with_warning() {
    let loaded = try_scene("c\ncxy .4 0\nm a =\ned 1\nc\ncxy 0 0\ncxy 1 0").unwrap();
    let color = loaded.scene.materials[0].ed.color;
    assert!((luminance(color) - 1.0).abs() < 1e-6 && color[1] < color[0] && color[1] < color[2], "purple: {color:?}");
    assert_eq!(loaded.warnings.len(), 3, "{:?}", loaded.warnings);
    assert!(loaded.warnings[0].to_string().starts_with("t.mgf:2:1: chromaticity (0.4, 0) has no luminance"));
}

/// A color given after `sigma_s` tints absorption; one given before `sigma_s` tints only scattering; chromaticities tint neither.
#[test]
fn absorption_is_tinted_by_a_raw_color_of_its_own() {
    let media = [
        ("c\ncrgb 1 2 .5\nsigma_a .5", [1.0, 2.0, 0.5]),
        ("c\ncrgb 1 2 .5\nsigma_s 1\nsigma_a .5", [1.0; 3]),
        ("sigma_s 1\nc\ncrgb 1 2 .5\nsigma_a .5", [1.0, 2.0, 0.5]),
        ("c\ncct 3000\nsigma_a .5", [1.0; 3]),
        ("sigma_a .5", [1.0; 3]),
    ];
    for (text, wanted) in media {
        let medium = &scene(&format!("c\ncrgb .9 .1 .1\nmedium ink =\n{text}")).media[0];
        assert_eq!((medium.sigma_a, medium.absorption_color), (0.5, wanted), "{text}");
    }
    let medium = &scene("medium ink =\nc red =\ncrgb 2 0 0\nsigma_s 1\nsigma_a .5").media[0];
    assert_eq!(medium.extinction(), [2.5, 0.5, 0.5]);
}

#[test]
fn objects_nest_with_dotted_names_and_reopen_as_themselves() {
    let text = "v a =\no car\nsph a 1\no wheel\nsph a 1\no\nsph a 1\no\nsph a 1\no car\no wheel\nsph a 1\no\no\n";
    let loaded = try_scene(text).unwrap();
    let said: Vec<String> = loaded.warnings.iter().map(ToString::to_string).collect();
    assert!(matches!(&said[..], [car, wheel] if car.starts_with("t.mgf:10:1: ") && wheel.starts_with("t.mgf:11:1: ")));
    let scene = loaded.scene;
    let names: Vec<_> = scene.objects.iter().map(|o| (o.name.as_str(), o.parent)).collect();
    assert_eq!(names, [("car", None), ("car.wheel", Some(ObjectId(0)))]);
    let held: Vec<_> = scene.groups[0].quadrics.iter().map(|q| q.object.map(|o| o.0)).collect();
    assert_eq!(held, [Some(0), Some(1), Some(0), None, Some(1)]);
}

#[test]
fn a_camera_takes_its_fields_and_its_template() {
    let scene = scene(
        "path fly = spline\nkey 0\ncamera main =\norigin 1 2 3\ntarget 4 5 6\nup 0 1 0\nfov 30\nfilm 64 48\nlens .05 7\n\
        shutter .1 .6\nalong fly\ncamera wide = main\nfov 90\n",
    );
    assert_eq!(
        scene.cameras.iter().map(|c| (c.name.as_str(), c.fov)).collect::<Vec<_>>(),
        [("main", 30.0), ("wide", 90.0)]
    );
    let c = &scene.cameras[1];
    assert_eq!((c.origin, c.target, c.up), (DVec3::new(1.0, 2.0, 3.0), DVec3::new(4.0, 5.0, 6.0), DVec3::Y));
    assert_eq!((c.film, c.lens_radius, c.focus), ([64, 48], 0.05, 7.0));
    assert_eq!((c.shutter_open, c.shutter_close, c.along), (0.1, 0.6, Some(PathId(0))));
}

#[test]
fn an_unfinished_camera_has_the_defaults_of_the_format() {
    let scene = scene("camera c =\ntarget 1 0 0");
    let c = &scene.cameras[0];
    assert_eq!((c.up, c.lens_radius, c.shutter_open, c.shutter_close), (DVec3::Z, 0.0, 0.0, 0.0));
}

#[test]
fn media_use_only_their_own_colors_and_fill_boxes_or_all_space() {
    let scene = scene(
        "c\ncrgb .9 .1 .1\nmedium fog =\nsigma_s .5\nsigma_a .1\nphase hg .7\nc\ncct 3000\nglow 2\ndensity height 1 4\n\
        medium smoke = fog\nc\ncrgb 1 .5 .2\nsigma_s 2\nphase schlick -.3\nmglobal fog\n\
        xf -s 2 -t 0 0 1\nmbox smoke 1 1 1 0 0 0\nxf\nmedium air =\nphase rayleigh",
    );
    let [fog, smoke, air] = &scene.media[..] else { panic!("three media") };
    assert_eq!((fog.sigma_s, fog.sigma_a, fog.color), (0.5, 0.1, [1.0; 3]));
    assert_eq!(
        (fog.phase, &fog.density),
        (Phase::HenyeyGreenstein { g: 0.7 }, &Density::Height { z0: 1.0, scale: 4.0 })
    );
    assert!(fog.glow == 2.0 && (luminance(fog.glow_color) - 1.0).abs() < 1e-6 && fog.glow_color[0] > 1.0);
    assert_eq!((smoke.sigma_s, smoke.color, smoke.phase), (2.0, [1.0, 0.5, 0.2], Phase::Schlick { k: -0.3 }));
    assert_eq!((smoke.sigma_a, air.phase), (0.1, Phase::Rayleigh));
    assert_eq!(scene.regions[0].bounds, RegionBounds::Everywhere);
    let RegionBounds::Box { min, max, to_world } = scene.regions[1].bounds else { panic!("a box") };
    assert_eq!((min, max), (DVec3::ZERO, DVec3::ONE));
    assert_eq!(to_world.transform_point3(DVec3::ONE), DVec3::new(2.0, 2.0, 3.0));
}

#[test]
fn a_box_of_medium_in_arrays_is_one_region_a_copy() {
    let scene = scene("medium fog =\nxf -t 0 0 9\nxf -a 2 -t 5 0 0 -a 3 -t 0 5 0\nmbox fog 0 0 0 1 1 1\nxf\nxf");
    let mut corners: Vec<_> = scene
        .regions
        .iter()
        .map(|region| match region.bounds {
            RegionBounds::Box { to_world, .. } => to_world.translation.to_array().map(|x| x as i64),
            RegionBounds::Everywhere => panic!("a box"),
        })
        .collect();
    corners.sort_unstable();
    assert_eq!(corners, [[0, 0, 9], [0, 5, 9], [0, 10, 9], [5, 0, 9], [5, 5, 9], [5, 10, 9]]);
}

#[test]
fn time_paths_and_varying_scalars_arrive() {
    let scene = scene(
        "time 0 5 24\npath drive = spline\nkey 0 -t 0 0 0\nkey 2.5 -rz 90 -t 1 0 0\npath other = linear\nkey -1\npath drive\n\
        key 5 -t 9 0 0\nvary medium.fog.sigma_s = 0 .1 2 .3\nvary medium.fog.sigma_s = 4 .2\nvary a.b.c = 1 1",
    );
    assert_eq!(scene.clip, Some(Clip { start: 0.0, end: 5.0, fps: 24.0 }));
    let [drive, other] = &scene.paths[..] else { panic!("two paths") };
    assert_eq!((drive.interpolation, other.interpolation), (Interpolation::Spline, Interpolation::Linear));
    assert_eq!(drive.keys.iter().map(|k| k.time).collect::<Vec<_>>(), [0.0, 2.5, 5.0]);
    assert_eq!(drive.keys[1].pose.transform_point3(DVec3::X), DVec3::new(1.0, 1.0, 0.0));
    assert_eq!(scene.varies[0].keys, [(0.0, 0.1), (2.0, 0.3), (4.0, 0.2)]);
    assert_eq!((scene.varies.len(), scene.varies[1].selector.as_str()), (2, "a.b.c"));
}

#[test]
fn an_unknown_entity_is_said_once_a_name() {
    let loaded = try_scene("glorp 1 2\nglorp\nfnord\nc\n").unwrap();
    let said: Vec<_> = loaded.warnings.iter().map(|w| w.to_string()).collect();
    assert_eq!(said.len(), 2);
    assert!(said[0].starts_with("t.mgf:1:1:") && said[0].contains("glorp"));
    assert!(said[1].starts_with("t.mgf:3:1:"));
}

#[test]
fn names_that_are_no_utf8_text_are_names() {
    let bundle = femc_import::Bundle([("t.mgf".to_owned(), b"m \xff\xfe =\nrd .5\nm \xff\xfe\n".to_vec())].into());
    assert_eq!(femc_import::load_scene(&bundle, "t.mgf").unwrap().scene.materials.len(), 1);
}

#[test]
fn includes_are_relative_share_contexts_and_take_transforms() {
    let loaded = try_files(&[
        ("main.mgf", "i parts/lamp.mgf -t 5 0 0 -a 2 -t 0 1 0\nm glass\nsph origin 1\ni parts/lamp.mgf\n"),
        ("parts/lamp.mgf", "i ../lib/m.mgf\nv origin =\nm glass\nsph origin .5\n"),
        ("lib/m.mgf", "m glass =\nsides 1\n"),
    ])
    .unwrap();
    assert_eq!(loaded.files, ["main.mgf", "parts/lamp.mgf", "lib/m.mgf"]);
    assert_eq!(loaded.scene.files, loaded.files);
    assert_eq!((loaded.scene.groups[0].quadrics.len(), loaded.scene.groups[1].quadrics.len()), (2, 1));
    assert_eq!(loaded.scene.groups[0].instances.len(), 2);
    assert_eq!(loaded.scene.groups[0].quadrics[0].location, Location { file: 0, line: 3, column: 1 });
    assert_eq!(loaded.scene.name, "main");
    assert!(loaded.warnings.is_empty());
}

#[test]
fn what_an_included_file_leaves_open_ends_with_it() {
    let loaded = try_files(&[("a.mgf", "v o =\ni b.mgf\nsph o 1\n"), ("b.mgf", "xf -t 1 0 0\no part\n")]).unwrap();
    assert_eq!(loaded.warnings.len(), 2);
    let Shape::Sphere { center, .. } = loaded.scene.groups[0].quadrics[0].shape else { panic!() };
    assert_eq!((center, loaded.scene.groups[0].quadrics[0].object), (DVec3::ZERO, None));
}

const LAMP: &str = "IESNA91\nTILT=NONE\n1 1000 1 2 1 1 2 0 0 0 1 1 100\n0 90 0 100 50\n";

#[test]
fn luminaire_has_its_transform_and_shares_its_photometry() {
    let loaded = try_files(&[
        ("t.mgf", "c\ncrgb 2 2 2\no lamp\nies l/a.ies -m .5 -t 0 0 3\nies l/a.ies\no\nies l/a.ies -a 2 -t 1 0 0\n"),
        ("l/a.ies", LAMP),
    ])
    .unwrap();
    let scene = loaded.scene;
    assert_eq!((scene.photometry.len(), loaded.files.len()), (1, 2));
    assert_eq!(scene.photometry[0].location, Location { file: 0, line: 4, column: 1 });
    let [first, second] = &scene.groups[0].luminaires[..] else { panic!("two luminaires") };
    assert_eq!((first.multiplier, first.to_group.translation), (0.5, DVec3::Z * 3.0));
    assert!(is_close(first.color, [1.0; 3]), "the color has luminance 1");
    assert_eq!((second.multiplier, second.object), (1.0, Some(ObjectId(0))));
    assert_eq!((scene.groups[0].instances.len(), scene.groups[1].luminaires.len()), (2, 1));
}

#[test]
fn a_tilted_lamp_gets_its_tilt_factor() {
    let tilting = LAMP.replace("NONE", "INCLUDE\n1 2 0 90 1 .5");
    let load = |line: &str| try_files(&[("t.mgf", line), ("a.ies", &tilting)]).unwrap();
    let factor = |line: &str| load(line).scene.groups[0].luminaires[0].multiplier;
    assert!((factor("ies a.ies") - 1.0).abs() < 1e-12);
    assert!((factor("ies a.ies -rx 90") - 0.5).abs() < 1e-12);
    assert!((factor("xf -ry 45\nies a.ies -m 2 -rz 30\nxf") - 1.5).abs() < 1e-9);
    assert_eq!(load("ies a.ies -a 2 -rx 90").warnings.len(), 1);
}

#[test]
fn texture_coordinates_and_maps_arrive() {
    let mut bundle = common::bundle(&[(
        "t.mgf",
        "m a =\nmap_rd p.png\nmap_ed p.png\nmap_n p.png\nv x =\nuv .25 .75\nn 0 0 2\nsph x 1\nv y =\np 1 0 0\nv z =\np 0 1 0\nf x y z",
    )]);
    let mut white = Vec::new();
    png::Encoder::new(&mut white, 1, 1).write_header().and_then(|mut w| w.write_image_data(&[255])).unwrap();
    bundle.0.insert("p.png".into(), white);
    let loaded = femc_import::load_scene(&bundle, "t.mgf").unwrap();
    let m = &loaded.scene.materials[0];
    assert_eq!((m.map_rd, m.map_ed, m.map_n), (Some(ImageId(0)), Some(ImageId(0)), Some(ImageId(1))));
    assert_eq!(loaded.scene.images[0].pixels, [[1.0; 3]]);
    let vertex = loaded.scene.groups[0].vertices[0];
    assert_eq!(vertex.uv.map(|uv| uv.to_array()), Some([0.25, 0.75]));
    assert_eq!(vertex.normal, Some(DVec3::Z));
    assert_eq!(loaded.files, ["t.mgf", "p.png"]);
    assert_eq!(loaded.warnings.len(), 1, "the sphere has no coordinates: said once");
}
