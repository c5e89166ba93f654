//! Tests of surfaces and transforms.

use crate::common::{SQUARE, close, scene, try_scene, world_spheres, world_triangles};
use femc_math::glam::DVec3;
use femc_scene::{Facing, MotionStep, Scene, Shape};

fn normal([a, b, c]: [DVec3; 3]) -> DVec3 {
    (b - a).cross(c - a).normalize()
}

fn area(scene: &Scene) -> f64 {
    world_triangles(scene).iter().map(|[a, b, c]| 0.5 * (*b - *a).cross(*c - *a).length()).sum()
}

#[test]
fn a_face_looks_along_its_right_hand_normal() {
    let up = scene(&format!("{SQUARE}f a b c d"));
    assert!(world_triangles(&up).into_iter().all(|t| normal(t) == DVec3::Z));
    let down = scene(&format!("{SQUARE}f d c b a"));
    assert!(world_triangles(&down).into_iter().all(|t| normal(t) == DVec3::NEG_Z));
}

#[test]
fn the_seam_of_the_specification_leaves_a_hole() {
    let text = "v v1 =\np 0 0 0\nv v2 =\np 4 0 0\nv v3 =\np 4 4 0\nv v4 =\np 0 4 0\n\
        v v5 =\np 1 3 0\nv v6 =\np 3 3 0\nv v7 =\np 3 1 0\nv v8 =\np 1 1 0\n";
    let seam = scene(&format!("{text}f v1 v2 v3 v4 v5 v6 v7 v8 v5 v4"));
    let hole = scene(&format!("{text}fh v1 v2 v3 v4 - v5 v6 v7 v8"));
    for scene in [seam, hole] {
        assert!((area(&scene) - 12.0).abs() < 1e-9);
        assert!(world_triangles(&scene).into_iter().all(|t| normal(t) == DVec3::Z));
        let over_hole = |[a, b, c]: [DVec3; 3]| close((a + b + c) / 3.0, [2.0, 2.0, 0.0]);
        assert!(!world_triangles(&scene).into_iter().any(over_hole));
        assert_eq!(scene.groups[0].vertices.len(), 8, "repeated vertices are shared");
        assert_eq!(scene.groups[0].faces[0].triangle_count, 8);
    }
}

#[test]
fn neighbouring_faces_share_their_vertices_until_these_change() {
    let shared = scene(&format!("{SQUARE}f a b c\nf a c d"));
    assert_eq!(shared.groups[0].vertices.len(), 4);
    let moved = scene(&format!("{SQUARE}f a b c\nv a\np 0 0 1\nf a c d"));
    assert_eq!(moved.groups[0].vertices.len(), 5);
    let transformed = scene(&format!("{SQUARE}f a b c\nxf -t 0 0 1\nf a b c\nxf"));
    assert_eq!(transformed.groups[0].vertices.len(), 6);
}

#[test]
fn the_transform_in_force_at_the_use_of_a_vertex_applies() {
    let text = "xf -t 100 0 0\nv a =\np 1 2 3\nxf\nxf -t 0 0 5\nxf -s 2\nsph a 1\nxf\nxf";
    let scene = scene(text);
    let Shape::Sphere { center, radius, .. } = scene.groups[0].quadrics[0].shape else { panic!() };
    assert_eq!((center.to_array(), radius), ([2.0, 4.0, 11.0], 2.0), "the inner transform is applied first");
}

#[test]
fn an_array_shares_its_geometry_and_places_each_copy() {
    let text = format!("{SQUARE}xf -t 0 0 1\nxf -rz 90 -a 3 -t 2 0 0\nf a b c d\nsph c .1\nxf\nxf\n");
    let scene = scene(&text);
    assert_eq!(scene.groups.len(), 2);
    assert!(scene.groups[0].triangles.is_empty());
    assert_eq!((scene.groups[1].triangles.len(), scene.groups[0].instances.len()), (2, 3));
    let mut centers = world_spheres(&scene);
    centers.sort_by(|a, b| a.x.total_cmp(&b.x));
    assert!(centers.iter().zip([-1.0, 1.0, 3.0]).all(|(c, x)| close(*c, [x, 1.0, 1.0])), "{centers:?}");
}

#[test]
fn nested_arrays_multiply_like_the_arguments_of_one() {
    let one = scene("v a =\np 0 0 0\nxf -a 3 -t 1 0 0 -a 2 -t 0 1 0 -a 2 -t 0 0 1\nsph a .1\nxf");
    let nested = scene("v a =\np 0 0 0\nxf -a 2 -t 0 0 1\nxf -a 2 -t 0 1 0\nxf -a 3 -t 1 0 0\nsph a .1\nxf\nxf\nxf");
    for scene in [one, nested] {
        let mut centers: Vec<_> = world_spheres(&scene).iter().map(|c| c.to_array().map(|x| x as i64)).collect();
        centers.sort();
        centers.dedup();
        assert_eq!(centers.len(), 12);
        let stored: usize = scene.groups.iter().map(|g| g.quadrics.len() + g.instances.len()).sum();
        assert_eq!(stored, 1 + 3 + 2 + 2);
    }
}

#[test]
fn a_long_array_is_placed_in_rows_and_no_copy_is_lost() {
    let scene = scene("v a =\np 0 0 0\nxf -t 0 3 0 -a 10007 -t 1 0 0 -i 1 -s 2\nsph a .1\nxf");
    let stored: usize = scene.groups.iter().map(|g| g.instances.len()).sum();
    assert!(stored < 400, "{stored} instances");
    let mut x: Vec<i64> = world_spheres(&scene).iter().map(|c| (c.x / 2.0).round() as i64).collect();
    x.sort_unstable();
    assert_eq!(x, (0..10_007).collect::<Vec<i64>>());
    assert!(world_spheres(&scene).iter().all(|c| (c.y - 6.0).abs() < 1e-9));
}

#[test]
fn an_empty_array_leaves_nothing_behind() {
    let scene = scene("xf -a 90000000 -t 1 0 0\nxf");
    assert_eq!((scene.groups.len(), scene.groups[0].instances.len()), (1, 0));
}

#[test]
fn products_of_arrays_are_refused_before_they_are_made() {
    let text = format!("{SQUARE}xf -a 10000 -t 1 0 0\nxf -a 5001 -t 0 1 0\nf a b c d\nxf\nxf");
    let error = try_scene(&text).unwrap_err();
    assert_eq!(error.at.line, 9, "{error}");
    assert!(error.to_string().contains("100020000 primitives"), "{error}");
    let error = try_scene("v a =\nxf -a 100000000 -t 0 0 1\nxf -a 100000000 -t 0 0 1\nsph a 1\nxf\nxf").unwrap_err();
    assert_eq!(error.at.line, 3, "{error}");
}

#[test]
fn mirrored_solids_keep_their_front_sides_out() {
    let prism = "v a =\np 1 0 0\nv b =\np 2 0 0\nv c =\np 1 1 0\n";
    for (open, center) in [("xf -mx", -4.0f64 / 3.0), ("xf -rz 0", 4.0 / 3.0), ("xf -s -1", -4.0 / 3.0)] {
        let scene = scene(&format!("{prism}{open}\nprism a b c 1\nsph a .5\nxf"));
        let triangles = world_triangles(&scene);
        assert_eq!(triangles.len(), 8);
        let middle = triangles.iter().flatten().copied().sum::<DVec3>() / 24.0;
        for t in triangles {
            assert!(normal(t).dot(t[0] - middle) > 0.0, "{open}: {t:?} faces inward");
        }
        let Shape::Sphere { facing, .. } = scene.groups[0].quadrics[0].shape else { panic!() };
        assert_eq!(facing, Facing::Outward);
        assert!(middle.x.signum() == center.signum());
    }
}

#[test]
fn mirrored_copies_of_an_array_are_not_turned_over() {
    let text = format!("{SQUARE}v o =\np 3 0 0\nn 1 0 0\nxf -t 1 0 0 -a 2 -mx\nf a b c d\nring o .1 .2\nxf");
    let scene = scene(&text);
    let triangles = world_triangles(&scene);
    assert_eq!(triangles.len(), 4);
    assert!(triangles.iter().all(|t| normal(*t).z > 0.999));
    let x: Vec<f64> = triangles.iter().flatten().map(|p| p.x).collect();
    assert!(x.contains(&-2.0) && x.contains(&2.0) && !x.contains(&0.0));
    for instance in &scene.groups[0].instances {
        let t = instance.motion.as_static().unwrap();
        assert!(t.matrix3.determinant() > 0.0, "no instance mirrors");
        let Shape::Ring { center, normal, .. } = scene.groups[instance.group.index()].quadrics[0].shape else {
            panic!()
        };
        let outward = t.transform_vector3(normal).x * t.transform_point3(center).x;
        assert!(outward > 0.0, "the mirrored ring looks away from the mirror, too");
    }
}

#[test]
fn mirrors_above_nested_groups_reach_all_of_them() {
    let text = format!("{SQUARE}xf -a 2 -t 0 0 1\nxf -t 1 0 0 -a 2 -t 5 0 0\nf a b c d\nxf\nxf\n");
    let plain = scene(&text);
    let mirrored = scene(&text.replacen("-a 2 -t 0 0 1", "-a 2 -t 0 0 1 -i 1 -mx", 1));
    let mut expected: Vec<_> =
        world_triangles(&plain).iter().map(|t| t.map(|p| p * DVec3::new(-1.0, 1.0, 1.0))).collect();
    let mut found = world_triangles(&mirrored);
    assert!(found.iter().all(|t| normal(*t).z > 0.999));
    let key = |t: &[DVec3; 3]| {
        let c = (t[0] + t[1] + t[2]) * 1000.0;
        [c.z.round() as i64, c.x.round() as i64, c.y.round() as i64]
    };
    expected.sort_by_key(key);
    found.sort_by_key(key);
    assert_eq!(expected.iter().map(key).collect::<Vec<_>>(), found.iter().map(key).collect::<Vec<_>>());
}

#[test]
fn prisms_are_closed_and_sign_of_length_sets_their_facing() {
    for (length, sign) in [(2.0, 1.0), (-2.0, -1.0)] {
        let scene = scene(&format!("{SQUARE}prism a b c d {length}"));
        let triangles = world_triangles(&scene);
        assert_eq!((scene.groups[0].faces.len(), triangles.len()), (6, 12));
        assert_eq!(scene.groups[0].vertices.len(), 8);
        let middle = DVec3::new(0.5, 0.5, -length / 2.0);
        assert!(triangles.iter().all(|t| sign * normal(*t).dot(t[0] - middle) > 0.0), "length {length}");
        assert!((area(&scene) - 10.0).abs() < 1e-9);
    }
}

#[test]
fn normals_of_a_prism_smooth_its_sides_only() {
    let scene = scene("v a =\np 0 0 0\nn -1 -1 0\nv b =\np 1 0 0\nn 1 -1 0\nv c =\np 0 1 0\nn -1 1 0\nprism a b c 1");
    let group = &scene.groups[0];
    let smooth = |face: usize| {
        let face = group.faces[face];
        let first = face.first_triangle as usize;
        group.triangles[first..first + face.triangle_count as usize]
            .iter()
            .flatten()
            .all(|&i| group.vertices[i as usize].normal.is_some())
    };
    assert_eq!((0..5).map(smooth).collect::<Vec<_>>(), [false, true, true, true, false]);
    let n = group.vertices.iter().find_map(|v| v.normal).unwrap();
    assert!((n.length() - 1.0).abs() < 1e-12);
}

#[test]
fn round_shapes_keep_measures_and_negative_radii_face_inward() {
    let scene = scene(
        "v a =\np 0 0 0\nn 0 0 3\nv b =\np 0 0 2\nxf -s 2\nsph a -1\ncyl a 1 b\ncyl a -1 b\ncone a 1 b 0\ncone a 0 b -1\n\
        ring a 0 1\ntorus a 1 3\ntorus a -1 -3\ntorus a 0 -2\nxf",
    );
    let shapes: Vec<Shape> = scene.groups[0].quadrics.iter().map(|q| q.shape).collect();
    let cone = |start_radius, end_radius, facing| Shape::Cone {
        start: DVec3::ZERO,
        end: DVec3::Z * 4.0,
        start_radius,
        end_radius,
        facing,
    };
    let torus = |major, minor, facing| Shape::Torus { center: DVec3::ZERO, axis: DVec3::Z, major, minor, facing };
    assert_eq!(
        shapes,
        [
            Shape::Sphere { center: DVec3::ZERO, radius: 2.0, facing: Facing::Inward },
            cone(2.0, 2.0, Facing::Outward),
            cone(2.0, 2.0, Facing::Inward),
            cone(2.0, 0.0, Facing::Outward),
            cone(0.0, 2.0, Facing::Inward),
            Shape::Ring { center: DVec3::ZERO, normal: DVec3::Z, inner: 0.0, outer: 2.0 },
            torus(4.0, 2.0, Facing::Outward),
            torus(4.0, 2.0, Facing::Inward),
            torus(2.0, 2.0, Facing::Inward),
        ]
    );
}

#[test]
fn a_path_makes_a_group_whose_steps_keep_their_order() {
    let scene = scene(&format!(
        "path drive = linear\nkey 0\nkey 1 -t 5 0 0\n{SQUARE}xf -t 0 0 9\nxf -s 2 -path drive -rz 90\nf a b c d\nxf\nxf"
    ));
    assert_eq!(scene.groups[1].vertices[1].position, DVec3::X * 2.0, "what is before the path is baked");
    let [instance] = &scene.groups[0].instances[..] else { panic!("one instance") };
    let [MotionStep::Along(path), MotionStep::Static(after)] = instance.motion.steps[..] else { panic!("two steps") };
    assert_eq!(path.index(), 0);
    assert!(close(after.transform_point3(DVec3::X), [0.0, 1.0, 9.0]), "the outer transform comes last");
}

#[test]
fn a_face_without_area_is_kept_without_triangles_and_said() {
    let loaded = try_scene(&format!("{SQUARE}f a b a b")).unwrap();
    assert_eq!(loaded.scene.groups[0].faces[0].triangle_count, 0);
    assert_eq!(loaded.warnings.len(), 1);
    assert_eq!(loaded.warnings[0].to_string(), "t.mgf:9:1: face without area");
}

#[test]
fn left_open_blocks_are_closed_with_a_warning_and_still_placed() {
    let loaded = try_scene("v a =\nxf -a 3 -t 1 0 0\no lamp\nsph a .1\n").unwrap();
    assert_eq!(world_spheres(&loaded.scene).len(), 3);
    assert_eq!(loaded.warnings.iter().map(|w| w.at.line).collect::<Vec<_>>(), [2, 3]);
}
