//! Tests that selectors reach every scalar, reject invalid values and suggest corrections.

use crate::common::*;
use femc_math::Transform;
use femc_scene::*;

fn scene() -> Scene {
    let mut scene = lit_floor();
    scene.media = vec![Medium { density: Density::Height { z0: 1.0, scale: 8.0 }, ..medium("fog", 4) }];
    scene.objects = vec![object("car", None), object("car.wheel", Some(0)), object("tree", None)];
    scene.photometry = vec![Photometry {
        path: "lamps/a.ies".into(),
        kind: PhotometryType::C,
        vertical: vec![0.0, 90.0],
        horizontal: vec![0.0],
        candela: vec![100.0, 0.0],
        opening: Opening::Point,
        location: line(9),
    }];
    let luminaire = Luminaire {
        photometry: PhotometryId(0),
        to_group: Transform::IDENTITY,
        multiplier: 1.0,
        color: [1.0; 3],
        object: Some(ObjectId(1)),
        location: line(9),
    };
    scene.groups[0].luminaires = vec![luminaire, Luminaire { object: None, ..luminaire }];
    scene.paths = vec![path("drive", 7, Interpolation::Linear, &[(0.0, pose(0.0, 1.0, 2.0, 3.0))])];
    scene.clip = Some(Clip { start: 0.0, end: 2.0, fps: 25.0 });
    scene
}

#[test]
fn every_listed_name_is_read_and_written_back() {
    let mut scene = scene();
    let names = scene.selectors();
    for expected in [
        "medium.fog.sigma_s",
        "material.lamp.ed",
        "camera.main.fov",
        "object.car.hidden",
        "object.car.wheel.hidden",
        "object.car.multiplier",
        "ies.lamps/a.ies.multiplier",
        "path.drive.1.x",
        "medium.fog.density.h",
        "time.fps",
    ] {
        assert!(names.iter().any(|name| name == expected), "{expected} is listed");
    }
    for name in &names {
        let before = scene.get(name).unwrap();
        scene.set(name, before).unwrap();
        assert_eq!(scene.get(name).unwrap(), before, "{name}");
    }
    assert_eq!(names.len(), names.iter().collect::<std::collections::BTreeSet<_>>().len(), "each once");
    assert!(!names.iter().any(|name| name.contains("tree.multiplier")), "a tree has no luminaires");
    assert!(!names.iter().any(|name| name.contains("phase.k") || name.ends_with(".ir")), "only what is there");
}

#[test]
fn set_changes_the_scalar_that_it_names_and_no_other() {
    let mut scene = scene();
    let others: Vec<(String, f64)> = scene
        .selectors()
        .into_iter()
        .filter(|name| name != "medium.fog.sigma_s")
        .map(|name| (name.clone(), scene.get(&name).unwrap()))
        .collect();
    scene.set("medium.fog.sigma_s", 0.25).unwrap();
    assert_eq!(scene.media[0].sigma_s, 0.25);
    for (name, value) in others {
        assert_eq!(scene.get(&name).unwrap(), value, "{name}");
    }
    scene.set("object.car.wheel.hidden", 1.0).unwrap();
    assert_eq!(scene.objects.iter().map(|o| o.hidden).collect::<Vec<_>>(), [false, true, false]);
    scene.set("object.car.multiplier", 3.0).unwrap();
    let multipliers: Vec<f64> = scene.groups[0].luminaires.iter().map(|l| l.multiplier).collect();
    assert_eq!(multipliers, [3.0, 1.0], "the luminaire of the wheel is in the car, the other is not");
    scene.set("ies.lamps/a.ies.multiplier", 5.0).unwrap();
    assert!(scene.groups[0].luminaires.iter().all(|l| l.multiplier == 5.0));
    scene.set("camera.main.origin.z", 9.0).unwrap();
    assert_eq!(scene.cameras[0].origin.z, 9.0);
}

#[test]
fn all_entries_of_a_redefined_material_are_set() {
    let mut scene = scene();
    scene.materials.push(Material { rs: tinted(0.1), ..material("floor", 20) });
    scene.set("material.floor.rd", 0.25).unwrap();
    let amounts: Vec<f64> = scene.materials.iter().map(|m| m.rd.amount).collect();
    assert_eq!(amounts, [0.25, 0.0, 0.25]);
}

#[test]
fn a_name_that_matches_nothing_lists_the_three_nearest() {
    let mut scene = scene();
    let Err(SelectorError::Unknown { selector, nearest }) = scene.set("material.lmap.ed", 1.0) else {
        panic!("an unknown name is an error")
    };
    assert_eq!((selector.as_str(), nearest.len()), ("material.lmap.ed", 3));
    assert_eq!(nearest[0], "material.lamp.ed");
    let shown = scene.get("camera.main.fow").unwrap_err().to_string();
    assert!(shown.contains("`camera.main.fow`") && shown.contains("nearest: `camera.main.fov`, `"), "{shown}");
    for name in
        ["", ".", "material", "material.", "material..rd", "medium.fog.phase.k", "path.drive.0.x", "path.drive.2.x"]
    {
        assert!(matches!(scene.get(name), Err(SelectorError::Unknown { .. })), "{name}");
    }
    assert!(Scene::default().get("time.fps").unwrap_err().to_string().contains("the scene has no scalars"));
}

#[test]
fn impossible_values_are_refused_with_reason_and_change_nothing() {
    let mut scene = scene();
    scene.materials[0].rs = tinted(0.4);
    for (selector, value, constraint) in [
        ("medium.fog.sigma_s", -1.0, Constraint::NotNegative),
        ("medium.fog.sigma_s", f64::NAN, Constraint::Finite),
        ("medium.fog.phase.g", 1.0, Constraint::Between(-1.0, 1.0)),
        ("medium.fog.density.h", 0.0, Constraint::Positive),
        ("material.floor.rd", 1.5, Constraint::Within(0.0, 1.0)),
        ("material.floor.rd", 0.75, Constraint::Energy(1.15)),
        ("material.floor.sides", 1.5, Constraint::Either(1, 2)),
        ("camera.main.fov", 180.0, Constraint::Between(0.0, 180.0)),
        ("camera.main.film.w", 0.5, Constraint::Count(32768)),
        ("camera.main.shutter.open", 0.5, Constraint::Shutter),
        ("object.car.hidden", 2.0, Constraint::Either(0, 1)),
        ("time.fps", 0.0, Constraint::Positive),
        ("time.t1", -1.0, Constraint::ClipOrder),
    ] {
        let before = scene.get(selector).unwrap();
        let error = scene.set(selector, value).unwrap_err();
        let SelectorError::Refused { constraint: found, .. } = error else { panic!("{selector}: {error}") };
        match (found, constraint) {
            (Constraint::Energy(a), Constraint::Energy(b)) => assert!((a - b).abs() < 1e-12),
            _ => assert_eq!(found, constraint, "{selector} = {value}"),
        }
        assert_eq!(scene.get(selector).unwrap(), before, "{selector} is as before");
    }
    scene.cameras[0].origin = [0.0, 0.0, 3.0].into();
    assert!(scene.set("camera.main.up.y", 0.0).is_err(), "up along the view");
}

#[test]
fn a_dark_raw_color_leaves_room_for_the_specular_part() {
    let mut scene = scene();
    scene.materials[0].rd.color = [0.5, 0.05, 0.04];
    scene.set_all(&[("material.floor.rd", 1.0), ("material.floor.rs", 0.05)]).unwrap();
    let error = scene.set("material.floor.rd.g", 1.5).unwrap_err();
    assert!(matches!(error, SelectorError::Refused { constraint: Constraint::Energy(_), .. }), "{error}");
}

#[test]
fn interdependent_values_may_be_set_in_either_order() {
    for order in [
        [("material.floor.rd", 0.1), ("material.floor.rs", 0.9)],
        [("material.floor.rs", 0.9), ("material.floor.rd", 0.1)],
    ] {
        let mut scene = scene();
        scene.set_all(&order).unwrap();
        assert_eq!((scene.materials[0].rd.amount, scene.materials[0].rs.amount), (0.1, 0.9));
    }
    let mut scene = scene();
    let error = scene.set_all(&[("material.lamp.ed", 5.0), ("material.floor.rs", 0.9)]).unwrap_err();
    assert!(error.to_string().contains("`material.floor.rs` cannot be 0.9"), "{error}");
    assert_eq!(scene.materials[1].ed.amount, 1000.0, "nothing of a refused set stays");
}

#[test]
fn an_override_wins_over_a_vary_of_the_same_scalar() {
    let mut scene = scene();
    let vary =
        |selector: &str| Vary { selector: selector.into(), location: line(30), keys: vec![(0.0, 0.0), (2.0, 1.0)] };
    scene.varies = vec![vary("medium.fog.sigma_s"), vary("medium.fog.sigma_a")];
    assert_eq!(scene.scalars_at(1.0).unwrap().media[0].sigma_s, 0.5);
    scene.set("medium.fog.sigma_s", 0.125).unwrap();
    let scalars = scene.scalars_at(1.0).unwrap();
    assert_eq!((scalars.media[0].sigma_s, scalars.media[0].sigma_a), (0.125, 0.5));
}

#[test]
fn scalars_vary_without_touching_the_scene() {
    let mut scene = scene();
    scene.varies = vec![
        Vary {
            selector: "object.car.hidden".into(),
            location: line(30),
            keys: vec![(0.0, 0.0), (1.0, 0.0), (1.5, 1.0)],
        },
        Vary { selector: "ies.lamps/a.ies.multiplier".into(), location: line(31), keys: vec![(0.0, 2.0), (2.0, 4.0)] },
    ];
    assert!(!scene.scalars_at(1.24).unwrap().objects[0].hidden, "it switches half way between keys");
    let scalars = scene.scalars_at(1.25).unwrap();
    assert!(scalars.objects[0].hidden && !scene.objects[0].hidden);
    assert_eq!(scalars.luminaires[0][0].multiplier, 3.25);
    assert_eq!(scene.groups[0].luminaires[0].multiplier, 1.0);
    scene.varies[0].selector = "time.fps".into();
    assert_eq!(scene.scalars_at(0.0), Err(SelectorError::Timeless { selector: "time.fps".into() }));
}
