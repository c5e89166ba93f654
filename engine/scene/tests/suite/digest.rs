//! Tests that the content hash covers everything that can affect a pixel, and nothing else.

use crate::common::*;
use femc_math::{Transform, glam::DVec3};
use femc_scene::*;

fn full_scene() -> Scene {
    let mut scene = lit_floor();
    scene.objects = vec![object("car", None)];
    scene.media = vec![medium("fog", 4)];
    scene.regions = vec![MediumRegion { medium: MediumId(0), bounds: RegionBounds::Everywhere, location: line(5) }];
    scene.photometry = vec![Photometry {
        path: "a.ies".into(),
        kind: PhotometryType::C,
        vertical: vec![0.0, 90.0],
        horizontal: vec![0.0],
        candela: vec![100.0, 0.0],
        opening: Opening::Point,
        location: line(9),
    }];
    scene.images = vec![Image { path: "a.png".into(), width: 1, height: 1, pixels: vec![[0.5; 3]] }];
    scene.clip = Some(Clip { start: 0.0, end: 1.0, fps: 10.0 });
    scene.paths = vec![path("p", 6, Interpolation::Linear, &[(0.0, pose(0.0, 1.0, 0.0, 0.0))])];
    scene.varies =
        vec![Vary { selector: "medium.fog.sigma_s".into(), location: line(7), keys: vec![(0.0, 0.0), (1.0, 1.0)] }];
    scene.groups.push(Group::default());
    scene.groups[0].instances = vec![Instance { group: GroupId(1), motion: Motion::default() }];
    let shape = Shape::Sphere { center: DVec3::ZERO, radius: 1.0, facing: Facing::Outward };
    scene.groups[0].quadrics = vec![Quadric { shape, material: MaterialId(0), object: None, location: line(8) }];
    scene.groups[0].luminaires = vec![Luminaire {
        photometry: PhotometryId(0),
        to_group: Transform::IDENTITY,
        multiplier: 1.0,
        color: [1.0; 3],
        object: None,
        location: line(9),
    }];
    scene
}

#[test]
fn names_of_files_and_places_in_them_do_not_count() {
    let mut moved = full_scene();
    let elsewhere = Location { file: 3, line: 99, column: 7 };
    moved.name = "copy".into();
    moved.files = vec!["x.mgf".into(); 4];
    moved.materials.iter_mut().for_each(|m| m.location = elsewhere);
    moved.media[0].location = elsewhere;
    moved.regions[0].location = elsewhere;
    moved.photometry[0].location = elsewhere;
    moved.photometry[0].path = "copy.ies".into();
    moved.images[0].path = "copy.png".into();
    moved.cameras[0].location = elsewhere;
    moved.paths[0].location = elsewhere;
    moved.varies[0].location = elsewhere;
    moved.groups[0].faces.iter_mut().for_each(|f| f.location = elsewhere);
    moved.groups[0].quadrics[0].location = elsewhere;
    moved.groups[0].luminaires[0].location = elsewhere;
    assert_eq!(moved.digest(), full_scene().digest());
}

#[test]
fn every_part_of_the_scene_counts() {
    let changes: [fn(&mut Scene); 21] = [
        |s| s.materials[0].rd.amount = 0.25,
        |s| s.materials[0].name.push('x'),
        |s| s.materials[1].inside = Some(MediumId(0)),
        |s| s.objects[0].hidden = true,
        |s| s.media[0].sigma_a = 1e-300,
        |s| s.regions.clear(),
        |s| s.photometry[0].candela[1] = 1.0,
        |s| s.photometry[0].opening = Opening::Sphere { diameter: 0.1 },
        |s| s.images[0].pixels[0][2] = 0.75,
        |s| s.cameras[0].fov = 41.0,
        |s| s.clip = None,
        |s| s.paths[0].keys[0].time = 1.0,
        |s| s.paths[0].interpolation = Interpolation::Spline,
        |s| s.varies[0].keys[0].1 = 0.5,
        |s| s.groups[0].vertices[0].position.x = -2.5,
        |s| s.groups[0].vertices[0].uv = Some([0.0, 0.0].into()),
        |s| s.groups[0].triangles[0].swap(0, 1),
        |s| s.groups[0].faces[0].material = MaterialId(1),
        |s| s.groups[0].quadrics.clear(),
        |s| s.groups[0].luminaires[0].multiplier = 2.0,
        |s| s.groups[0].instances[0].motion = Motion::fixed(pose(0.0, 1.0, 0.0, 0.0)),
    ];
    let mut seen = std::collections::BTreeSet::from([full_scene().digest()]);
    for (index, change) in changes.iter().enumerate() {
        let mut scene = full_scene();
        change(&mut scene);
        assert!(seen.insert(scene.digest()), "change {index} is seen");
    }
}

#[test]
fn digest_round_trips_as_text_and_is_machine_independent() {
    let digest = full_scene().digest();
    assert_eq!(digest.to_string().parse(), Ok(digest));
    assert_eq!("no digest".parse::<SceneDigest>(), Err(DigestError));
    // This value changes only with the canonical form. If it changes, raise the version. Materials have a value of their own beside
    // their description.
    let without_materials = Scene { materials: Vec::new(), ..full_scene() };
    let expected = "edad2ff4ef4e031b774a2568c1cc28c320764448554251d7e2329e011b20a09b";
    assert_eq!(without_materials.digest().to_string(), expected);
}
