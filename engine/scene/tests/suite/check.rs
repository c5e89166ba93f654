//! Tests that `check_scene` finds each fault at its line, and nothing in a correct scene.

use crate::common::*;
use femc_math::{Transform, glam::DVec3};
use femc_scene::*;
use femc_scene::{FaultKind as K, Severity as S};

fn fault_lines(scene: &Scene) -> Vec<(K, S, u32)> {
    check_scene(scene).into_iter().map(|fault| (fault.kind, fault.severity, fault.location.line)).collect()
}

fn fill_with_medium(scene: &mut Scene, fog: Medium) {
    scene.media = vec![fog];
    scene.regions = vec![MediumRegion { medium: MediumId(0), bounds: RegionBounds::Everywhere, location: line(5) }];
}

fn vary(selector: &str, keys: &[(f64, f64)]) -> Vary {
    Vary { selector: selector.into(), location: line(30), keys: keys.to_vec() }
}

const CLIP: Clip = Clip { start: 0.0, end: 1.0, fps: 10.0 };

fn glass(at: u32) -> Material {
    Material {
        sides: Sides::One,
        rd: tinted(0.0),
        ts: tinted(1.0),
        ior: Some(Ior { re: 1.5, im: 0.0 }),
        ..material("glass", at)
    }
}

fn add_quadric(scene: &mut Scene, shape: Shape, material: u32, at: u32) {
    scene.groups[0].quadrics.push(Quadric { shape, material: MaterialId(material), object: None, location: line(at) });
}

#[test]
fn a_sound_scene_has_no_fault() {
    assert_eq!(check_scene(&lit_floor()), []);
}

/// Each case breaks one thing in the correct scene; exactly this fault must be found.
/// A change of a sound scene that makes it faulty.
type Change = fn(&mut Scene);

/// Kinds, severities and lines of the faults that a change makes.
type ExpectedFaults = &'static [(K, S, u32)];

/// One fault of each kind.
const CASES: [(&str, Change, ExpectedFaults); 36] = [
    (
        "a face without area",
        |s| add_face(&mut s.groups[0], &[[0.0, 0.0, 1.0], [1.0, 0.0, 1.0], [0.5, 0.0, 1.0]], 0, 20),
        &[(K::DegenerateSurface, S::Warning, 20)],
    ),
    (
        "a face without triangles",
        |s| add_face(&mut s.groups[0], &[[0.0; 3], [1.0; 3]], 0, 20),
        &[(K::DegenerateSurface, S::Warning, 20)],
    ),
    (
        "a ring without width",
        |s| add_quadric(s, Shape::Ring { center: DVec3::Z, normal: DVec3::Z, inner: 1.0, outer: 1.0 }, 0, 20),
        &[(K::DegenerateSurface, S::Warning, 20)],
    ),
    (
        "a bent face",
        |s| {
            add_face(&mut s.groups[0], &[[0.0, 0.0, 1.0], [1.0, 0.0, 1.0], [1.0, 1.0, 1.2], [0.0, 1.0, 1.0]], 0, 20);
        },
        &[(K::NonPlanarFace, S::Warning, 20)],
    ),
    (
        "a rug in the floor",
        |s| add_face(&mut s.groups[0], &[[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0]], 0, 20),
        &[(K::OverlappingFaces, S::Warning, 20)],
    ),
    (
        "a box on the floor",
        |s| add_box(&mut s.groups[0], [0.0; 3], [1.0; 3], 0, 20),
        &[(K::OverlappingFaces, S::Note, 20)],
    ),
    (
        "a copy in the same place",
        |s| {
            s.groups.push(Group::default());
            add_face(&mut s.groups[1], &[[0.0, 0.0, 1.0], [1.0, 0.0, 1.0], [1.0, 1.0, 1.0]], 0, 20);
            let place = Instance { group: GroupId(1), motion: Motion::default() };
            s.groups[0].instances = vec![place.clone(), place];
        },
        &[(K::OverlappingFaces, S::Warning, 20)],
    ),
    (
        "a sphere in a sphere's place",
        |s| {
            let shape = Shape::Sphere { center: DVec3::Z, radius: 0.2, facing: Facing::Outward };
            add_quadric(s, shape, 0, 20);
            add_quadric(s, shape, 1, 21);
            add_quadric(s, Shape::Sphere { center: DVec3::Z, radius: 0.1, facing: Facing::Outward }, 0, 22);
        },
        &[(K::OverlappingFaces, S::Warning, 21)],
    ),
    ("an unused material", |s| s.materials.push(material("wood", 20)), &[(K::UnusedName, S::Note, 20)]),
    (
        "an unused path",
        |s| s.paths = vec![path("p", 20, Interpolation::Linear, &[(0.0, pose(0.0, 0.0, 0.0, 0.0))])],
        &[(K::UnusedName, S::Note, 20)],
    ),
    ("two cameras of one name", |s| s.cameras.push(camera("main", 20)), &[(K::DuplicateName, S::Warning, 20)]),
    (
        "a selector of nothing",
        |s| {
            s.clip = Some(CLIP);
            s.varies = vec![vary("material.flor.rd", &[(0.0, 0.5)])];
        },
        &[(K::BadSelector, S::Error, 30)],
    ),
    (
        "a vary out of range",
        |s| {
            s.clip = Some(CLIP);
            s.varies = vec![vary("material.floor.rd", &[(0.0, 0.5), (1.0, 1.5)])];
        },
        &[(K::BadSelector, S::Error, 30)],
    ),
    (
        "a vary of the clip",
        |s| {
            s.clip = Some(CLIP);
            s.varies = vec![vary("time.fps", &[(0.0, 10.0)])];
        },
        &[(K::BadSelector, S::Error, 30)],
    ),
    (
        "a vary without a clip",
        |s| s.varies = vec![vary("material.floor.rd", &[(0.0, 0.5), (1.0, 0.6)])],
        &[(K::Animation, S::Warning, 30)],
    ),
    ("more than all light", |s| s.materials[0].rs = tinted(0.6), &[(K::EnergyGain, S::Error, 1)]),
    ("more than all blue light", |s| s.materials[0].rd.color = [0.5, 0.8, 3.0], &[(K::EnergyGain, S::Warning, 1)]),
    ("a color out of gamut", |s| s.materials[1].ed.color = [2.0, 0.9, -0.1], &[(K::OutOfGamut, S::Note, 2)]),
    ("a lamp like no other", |s| s.materials[1].ed.amount = 1e12, &[(K::Scale, S::Warning, 2)]),
    ("a medium without bounds", |s| s.media = vec![medium("fog", 20)], &[(K::MediumWithoutBounds, S::Warning, 20)]),
    (
        "a box without volume",
        |s| {
            fill_with_medium(s, medium("fog", 4));
            s.regions[0].bounds =
                RegionBounds::Box { min: DVec3::ZERO, max: DVec3::new(1.0, -1.0, 1.0), to_world: Transform::IDENTITY };
        },
        &[(K::MediumWithoutBounds, S::Warning, 5)],
    ),
    (
        "a wall of fog",
        |s| fill_with_medium(s, Medium { sigma_s: 100.0, ..medium("fog", 4) }),
        &[(K::OpticalDepth, S::Warning, 3)],
    ),
    (
        "no fog to speak of",
        |s| fill_with_medium(s, Medium { sigma_s: 1e-12, ..medium("fog", 4) }),
        &[(K::OpticalDepth, S::Note, 4)],
    ),
    (
        "a medium inside two sides",
        |s| {
            fill_with_medium(s, medium("fog", 4));
            s.materials[0].inside = Some(MediumId(0));
        },
        &[(K::OpenBoundary, S::Warning, 1)],
    ),
    (
        "a pane of solid glass",
        |s| {
            s.materials.push(glass(8));
            add_face(&mut s.groups[0], &[[0.0, 0.0, 1.0], [1.0, 0.0, 1.0], [1.0, 1.0, 1.0]], 2, 20);
        },
        &[(K::OpenBoundary, S::Warning, 20)],
    ),
    (
        "an open glass pipe",
        |s| {
            s.materials.push(glass(8));
            add_quadric(
                s,
                Shape::Cone {
                    start: DVec3::Z,
                    end: DVec3::Z * 1.5,
                    start_radius: 0.2,
                    end_radius: 0.2,
                    facing: Facing::Outward,
                },
                2,
                20,
            );
        },
        &[(K::OpenBoundary, S::Warning, 20)],
    ),
    (
        "a camera in a glass ball",
        |s| {
            s.materials.push(glass(8));
            add_quadric(
                s,
                Shape::Sphere { center: DVec3::new(0.0, -5.0, 1.0), radius: 0.5, facing: Facing::Outward },
                2,
                20,
            );
        },
        &[(K::Camera, S::Note, 3)],
    ),
    (
        "a black lamp",
        |s| s.materials[1].ed.color = [0.0; 3],
        &[(K::LightsNothing, S::Warning, 1), (K::LightsNothing, S::Warning, 2)],
    ),
    ("no lamp", |s| s.materials[1].ed.amount = 0.0, &[(K::LightsNothing, S::Warning, 1)]),
    ("a lobe of nothing", |s| s.materials[0].lobe = Some(3.0), &[(K::LightsNothing, S::Note, 1)]),
    (
        "a lamp against a ceiling",
        |s| {
            add_face(
                &mut s.groups[0],
                &[[-1.0, -1.0, 1.9999], [1.0, -1.0, 1.9999], [1.0, 1.0, 1.9999], [-1.0, 1.0, 1.9999]],
                0,
                20,
            );
        },
        &[(K::LightsNothing, S::Warning, 11)],
    ),
    (
        "a scene in light years",
        |s| {
            s.groups[0].vertices.iter_mut().for_each(|v| v.position *= 1e16);
            s.cameras[0].origin *= 1e16;
        },
        &[(K::Scale, S::Warning, 1)],
    ),
    ("a camera on the moon", |s| s.cameras[0].origin.z = 3.8e8, &[(K::Scale, S::Warning, 3)]),
    ("no camera", |s| s.cameras.clear(), &[(K::Camera, S::Warning, 1)]),
    (
        "a camera upside on",
        |s| s.cameras[0].up = s.cameras[0].target - s.cameras[0].origin,
        &[(K::Camera, S::Error, 3)],
    ),
    ("a shutter of a still", |s| s.cameras[0].shutter_close = 0.5, &[(K::Camera, S::Warning, 3)]),
];

#[test]
fn each_fault_is_found_once_at_its_line() {
    for (what, change, expected) in CASES {
        let mut scene = lit_floor();
        change(&mut scene);
        assert_eq!(fault_lines(&scene), expected, "{what}: {:#?}", check_scene(&scene));
    }
}

#[test]
fn a_path_that_turns_inside_out_is_an_error() {
    let mut scene = lit_floor();
    let mirrored = Transform::from_scale(DVec3::new(-1.0, 1.0, 1.0));
    scene.clip = Some(CLIP);
    scene.paths = vec![path("p", 20, Interpolation::Linear, &[(0.0, Transform::IDENTITY), (1.0, mirrored)])];
    scene.cameras[0].along = Some(PathId(0));
    // Halfway along the path, the camera's view collapses to a line.
    assert_eq!(fault_lines(&scene), [(K::Camera, S::Error, 3), (K::Animation, S::Error, 20)]);
    scene.paths[0].keys[0].pose = mirrored;
    assert_eq!(fault_lines(&scene), [], "mirrored at all keys is sound");
    scene.paths[0].keys[1].pose = pose(1.0, 0.0, 0.0, 0.0) * mirrored;
    scene.clip = None;
    assert_eq!(fault_lines(&scene), [(K::Animation, S::Warning, 20)], "it moves, but there is no clip");
}

#[test]
fn closed_glass_is_sound_however_it_is_built() {
    let mut scene = lit_floor();
    scene.materials.push(glass(8));
    add_box(&mut scene.groups[0], [0.0, 0.0, 0.5], [1.0, 1.0, 1.5], 2, 20);
    let (start, end) = (DVec3::new(-1.0, 0.0, 0.5), DVec3::new(-1.0, 0.0, 1.0));
    add_quadric(
        &mut scene,
        Shape::Cone { start, end, start_radius: 0.2, end_radius: 0.1, facing: Facing::Outward },
        2,
        30,
    );
    // The faces belong to no object; the cup, made of a cone and rings, is an object.
    scene.objects = vec![object("cup", None)];
    add_quadric(&mut scene, Shape::Ring { center: start, normal: -DVec3::Z, inner: 0.0, outer: 0.2 }, 2, 31);
    add_quadric(&mut scene, Shape::Ring { center: end, normal: DVec3::Z, inner: 0.0, outer: 0.1 }, 2, 32);
    scene.groups[0].quadrics.iter_mut().for_each(|quadric| quadric.object = Some(ObjectId(0)));
    add_quadric(
        &mut scene,
        Shape::Sphere { center: DVec3::new(0.0, -1.0, 1.0), radius: 0.2, facing: Facing::Outward },
        2,
        33,
    );
    assert_eq!(fault_lines(&scene), []);
    scene.groups[0].quadrics.remove(2);
    assert_eq!(fault_lines(&scene), [(K::OpenBoundary, S::Warning, 30)], "one lid gone");
    // A camera in the box is reported; a camera beside it is not.
    scene.groups[0].quadrics.clear();
    scene.cameras[0].origin = DVec3::new(0.5, 0.4, 1.0);
    assert_eq!(fault_lines(&scene), [(K::Camera, S::Note, 3)]);
    scene.cameras[0].origin = DVec3::new(1.5, 0.4, 1.0);
    assert_eq!(fault_lines(&scene), []);
}

#[test]
fn hidden_surfaces_overlap_nothing_unless_they_are_shown_later() {
    let mut scene = lit_floor();
    scene.objects = vec![Object { hidden: true, ..object("rug", None) }];
    add_face(&mut scene.groups[0], &[[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0]], 0, 20);
    scene.groups[0].faces[2].object = Some(ObjectId(0));
    assert_eq!(fault_lines(&scene), []);
    scene.clip = Some(CLIP);
    scene.varies = vec![vary("object.rug.hidden", &[(0.0, 1.0), (1.0, 0.0)])];
    assert_eq!(fault_lines(&scene), [(K::OverlappingFaces, S::Warning, 20)]);
}

#[test]
fn faces_that_share_edges_or_cross_or_lie_close_do_not_overlap() {
    let mut scene = lit_floor();
    let world = &mut scene.groups[0];
    add_face(world, &[[2.0, -2.0, 0.0], [4.0, -2.0, 0.0], [4.0, 2.0, 0.0], [2.0, 2.0, 0.0]], 0, 20); // beside
    add_face(world, &[[0.0, 0.0, -1.0], [1.0, 0.0, -1.0], [1.0, 0.0, 1.0], [0.0, 0.0, 1.0]], 0, 21); // across
    add_face(world, &[[0.0, 0.0, 0.001], [1.0, 0.0, 0.001], [1.0, 1.0, 0.001]], 0, 22); // 1 mm above
    assert_eq!(fault_lines(&scene), []);
}

#[test]
fn a_large_mesh_is_checked_and_its_one_doubled_face_is_found() {
    let mut scene = lit_floor();
    let height = |x: u32, y: u32| 0.5 + 0.1 * f64::from((x * 7 + y * 13) % 5);
    let at = |x: u32, y: u32| [f64::from(x) * 0.01, f64::from(y) * 0.01, height(x, y)];
    let world = &mut scene.groups[0];
    for y in 0..224 {
        for x in 0..224 {
            add_face(world, &[at(x, y), at(x + 1, y), at(x, y + 1)], 0, 100);
            add_face(world, &[at(x + 1, y), at(x + 1, y + 1), at(x, y + 1)], 0, 101);
        }
    }
    assert_eq!(world.faces.len(), 100_354);
    assert_eq!(fault_lines(&scene), []);
    add_face(&mut scene.groups[0], &[at(50, 60), at(51, 60), at(50, 61)], 0, 200);
    assert_eq!(fault_lines(&scene), [(K::OverlappingFaces, S::Warning, 200)]);
}

#[test]
fn too_many_overlaps_end_the_search_with_a_note() {
    let mut scene = lit_floor();
    for at in 0..200 {
        add_face(&mut scene.groups[0], &[[0.0, 0.0, 1.0], [1.0, 0.0, 1.0], [1.0, 1.0, 1.0]], 0, 20 + at);
    }
    let faults = check_scene(&scene);
    assert!(faults.iter().any(|fault| fault.kind == K::Incomplete && fault.severity == S::Note));
    assert!(faults.len() > 1000 && faults.len() < 20_000);
}

#[test]
fn a_fault_reads_as_one_line_with_its_place_and_what_to_do() {
    let mut scene = lit_floor();
    scene.media = vec![medium("fog", 20)];
    let shown: Vec<String> = check_scene(&scene).iter().map(|fault| fault.display(&scene).to_string()).collect();
    assert_eq!(
        shown,
        ["test.mgf:20: warning: medium `fog` has no bounds: it fills nothing; \
          place it with `mbox`, `mglobal` or `inside` of a material in use"]
    );
}

#[test]
fn the_list_is_in_the_order_of_the_files() {
    let mut scene = lit_floor();
    scene.files.push("part.mgf".into());
    scene.media = vec![medium("b", 9), medium("a", 40)];
    let mut elsewhere = medium("c", 1);
    elsewhere.location.file = 1;
    scene.media.insert(0, elsewhere);
    scene.materials.push(material("wood", 20));
    let places: Vec<(u32, u32)> = check_scene(&scene).iter().map(|f| (f.location.file, f.location.line)).collect();
    assert_eq!(places, [(0, 9), (0, 20), (0, 40), (1, 1)]);
}

#[test]
fn media_nested_beyond_the_limit_are_reported_and_at_it_are_not() {
    for (solids, found) in [(Medium::MAX_NESTED, 0), (Medium::MAX_NESTED + 1, 1)] {
        let mut scene = lit_floor();
        for k in 0..solids as u32 {
            scene.media.push(medium(&format!("ink {k}"), 40));
            let inside = Some(MediumId(k));
            scene.materials.push(Material { name: format!("glass {k}"), inside, ..glass(41) });
            let radius = 1.0 - 0.05 * f64::from(k);
            let shape = Shape::Sphere { center: DVec3::Z * 2.0, radius, facing: Facing::Outward };
            let material = scene.materials.len() as u32 - 1;
            add_quadric(&mut scene, shape, material, 50 + k);
        }
        let nested: Vec<_> = check_scene(&scene).into_iter().filter(|fault| fault.kind == K::NestedMedia).collect();
        assert_eq!(nested.len(), found, "{nested:?}");
        let lines: Vec<u32> = nested.iter().map(|fault| fault.location.line).collect();
        assert_eq!(lines, vec![50 + Medium::MAX_NESTED as u32; found], "the innermost solid");
    }
}
