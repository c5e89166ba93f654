//! Elements: splitting conserves area and volume, every point has one leaf, bounds contain their parts.

use super::{GRAY, face, full_arena, leaves_of, outward_box, prepare, split};
use crate::element::{Element, FOG_NODES, PatchForm, Shape};
use crate::scene::Scene;
use femc_field::{Form, NONE, Side};
use femc_math::cross;
use femc_math::glam::{Vec2, Vec3A};
use std::f64::consts::PI;

/// A triangle, a parallelogram, a sphere, a cylinder, a cone, a ring and a torus apart from each other, in fog; and their areas.
fn shapes() -> (String, [f64; 7]) {
    let text = format!(
        "medium haze =\n  sigma_s 0.1\nmbox haze -2 -3 -1 3 1 2\n{GRAY}{}{}\
         v s =\n  p 6 0 0\nsph s 0.5\n\
         v a =\n  p 8 0 0\nv b =\n  p 8 0 2\ncyl a 0.3 b\n\
         v c =\n  p 10 0 0\nv d =\n  p 10 1.5 2\ncone c 0.2 d 0.7\n\
         v e =\n  p 12 0 0\n  n 0 1 1\nring e 0.25 1\n\
         v g =\n  p 15 0 0\n  n 0 0 1\ntorus g 0.4 1\n",
        face(&[[0.0, 0.0, 0.0], [3.0, 0.0, 0.0], [0.0, 0.0, 1.0]]),
        face(&[[0.0, 3.0, 0.0], [2.0, 3.0, 0.0], [2.5, 3.0, 1.0], [0.5, 3.0, 1.0]]),
    );
    let slant = (2.5f64 * 2.5 + 0.5 * 0.5).sqrt();
    let areas = [1.5, 2.0, PI, 2.0 * PI * 0.3 * 2.0, PI * 0.9 * slant, PI * (1.0 - 0.0625), 4.0 * PI * PI * 0.7 * 0.3];
    (text, areas)
}

/// Returns points of a part of a surface, on a grid over its outline.
fn points(scene: &Scene<'_>, element: &Element) -> Vec<Vec3A> {
    let part = element.surface_part().expect("part of a surface");
    let triangle = element.patch().is_some_and(|patch| patch.form == PatchForm::Triangle);
    let at = |k: u32| Vec2::new((k % 9) as f32, (k / 9) as f32) / 8.0;
    let inside = |local: &Vec2| !triangle || local.x + local.y <= 1.0;
    (0..81).map(at).filter(inside).map(|local| part.point_at(scene, local).position).collect()
}

#[test]
fn splits_conserve_area_and_volume() {
    let (text, areas) = shapes();
    let prepared = prepare(&text);
    let scene = Scene::new(&prepared);
    let mut arena = full_arena(&scene);
    assert_eq!(scene.surfaces.len(), areas.len());
    let roots = arena.roots.clone();
    roots.iter().chain([&arena.fog.clone()]).for_each(|&root| split(&mut arena, &scene, root, 6));
    for (&root, area) in roots.iter().zip(areas) {
        let sum: f64 =
            leaves_of(&arena, root).iter().map(|&leaf| f64::from(arena.elements[leaf as usize].size())).sum();
        assert!((sum / area - 1.0).abs() < 1e-5, "surface {root}: {sum}, not {area}");
    }
    let sum: f64 =
        leaves_of(&arena, arena.fog).iter().map(|&leaf| f64::from(arena.elements[leaf as usize].size())).sum();
    assert!((sum / 60.0 - 1.0).abs() < 1e-5, "fog: {sum}");
    for element in arena.elements.iter().filter(|element| !element.is_leaf() && element.radius.is_finite()) {
        let [a, b] = element.children.map(|child| arena.elements[child as usize].size());
        assert!(((a + b) / element.size() - 1.0).abs() < 1e-5, "{element:?}");
        assert!(element.is_cluster() || (a / b - 1.0).abs() < 1e-3, "parts differ: {a} {b}");
    }
}

#[test]
fn every_point_of_a_surface_is_in_exactly_one_leaf() {
    let (text, _) = shapes();
    let prepared = prepare(&text);
    let scene = Scene::new(&prepared);
    let mut arena = full_arena(&scene);
    for (surface, root) in arena.roots.clone().into_iter().enumerate() {
        split(&mut arena, &scene, root, 3);
        let first = leaves_of(&arena, root)[3];
        split(&mut arena, &scene, first, 4);
        let leaves = leaves_of(&arena, root);
        let triangle = matches!(scene.surfaces[surface].form, Form::Triangle(_));
        for k in 0..37 * 37 {
            let place = Vec2::new((k % 37) as f32 + 0.51, (k / 37) as f32 + 0.52) / 37.0;
            if triangle && place.x + place.y > 1.0 {
                continue;
            }
            // Coordinates in a leaf, by Cramer's rule.
            let local = |leaf: u32| {
                let outline = &arena.elements[leaf as usize].surface_part().unwrap().outline;
                let [a, b] = outline.edges;
                let way = place - outline.corner;
                let area = a.x * b.y - a.y * b.x;
                Vec2::new(way.x * b.y - way.y * b.x, a.x * way.y - a.y * way.x) / area
            };
            let contains = |leaf: &&u32| {
                let at = local(**leaf);
                at.min_element() >= 0.0 && if triangle { at.x + at.y <= 1.0 } else { at.max_element() <= 1.0 }
            };
            let around: Vec<u32> = leaves.iter().filter(contains).copied().collect();
            let (found, at) = arena.element_at(root, place, 0.0);
            assert_eq!(around, [found], "surface {surface}, {place}");
            assert!(at.distance(local(found)) < 1e-4, "{at} {}", local(found));
        }
    }
}

#[test]
fn bounds_contain_all_parts() {
    let (text, _) = shapes();
    let prepared = prepare(&text);
    let scene = Scene::new(&prepared);
    let mut arena = full_arena(&scene);
    arena.roots.clone().into_iter().for_each(|root| split(&mut arena, &scene, root, 4));
    let fog = arena.fog;
    split(&mut arena, &scene, fog, 4);
    let mut clusters = 0;
    for (index, element) in arena.elements.iter().enumerate().filter(|(_, element)| element.radius.is_finite()) {
        clusters += usize::from(element.is_cluster());
        let inside: Vec<Vec3A> = leaves_of(&arena, index as u32)
            .iter()
            .flat_map(|&leaf| {
                let part = &arena.elements[leaf as usize];
                match part.shape {
                    Shape::Volume(_) => [-1.0, 1.0].map(|side| part.box_center + part.half_extent * side).to_vec(),
                    _ => points(&scene, part),
                }
            })
            .collect();
        for point in inside {
            let slack = 1e-5 * (1.0 + point.length());
            // A whole ring has its center between its edges.
            let bent = element.patch().is_some_and(|patch| patch.form == PatchForm::Bent);
            let radius = if bent { 1.12 * element.radius } else { element.radius };
            assert!(point.distance(element.center) <= radius + slack, "{point} outside of {element:?}");
            let off = (point - element.box_center).abs() - element.half_extent;
            assert!(off.max_element() <= slack, "{point} outside of the box of {element:?}");
        }
        // Bounds that are far too large would contain everything.
        assert!(element.half_extent.length() <= 1.2 * element.radius + 1e-4, "{element:?}");
    }
    assert_eq!(clusters, 6);
}

/// The extreme points of a tilted ring are between the points of its grid.
#[test]
fn boxes_contain_tilted_rings() {
    let prepared = prepare(&format!("{GRAY}v a =\n  p 0 0 0\n  n 1 1 0\nring a 0.5 1\n"));
    let scene = Scene::new(&prepared);
    let arena = full_arena(&scene);
    let ring = &arena.elements[arena.roots[0] as usize];
    let inside = |point: Vec3A| ((point - ring.box_center).abs() - ring.half_extent).max_element() <= 1e-6;
    assert!(points(&scene, ring).into_iter().all(inside), "{ring:?}");
    // The ring is 2 m high and sqrt(2) m wide.
    assert!((ring.half_extent - Vec3A::new(0.5f32.sqrt(), 0.5f32.sqrt(), 1.0)).abs().max_element() < 0.1, "{ring:?}");
}

#[test]
fn corners_are_counterclockwise_around_the_normal_on_both_sides() {
    let text = GRAY.replace("sides 1", "sides 2")
        + &face(&[[0.0, 0.0, 0.0], [3.0, 0.0, 0.0], [0.0, 2.0, 1.0]])
        + &face(&[[0.0, 3.0, 0.0], [2.0, 3.0, 0.0], [2.0, 3.0, 1.0], [0.0, 3.0, 1.0]]);
    let prepared = prepare(&text);
    let scene = Scene::new(&prepared);
    let mut arena = full_arena(&scene);
    let mut backs = 0;
    for (surface, root) in arena.roots.clone().into_iter().enumerate() {
        split(&mut arena, &scene, root, 3);
        backs += usize::from(scene.surfaces[surface].side == Side::Back);
        for leaf in leaves_of(&arena, root) {
            let patch = arena.elements[leaf as usize].patch().expect("a patch");
            let corners = patch.polygon();
            let turn: Vec3A =
                (2..corners.len()).map(|k| cross(corners[k - 1] - corners[0], corners[k] - corners[0])).sum();
            assert!((0.5 * turn.dot(patch.normal) / patch.part.area - 1.0).abs() < 1e-5, "{patch:?}");
            assert!(patch.nodes().iter().all(|node| node.normal == patch.normal));
            let center: Vec3A = patch.nodes().iter().map(|node| node.position).sum();
            let middle: Vec3A = corners.iter().sum();
            let mean = center / corners.len() as f32 - middle / corners.len() as f32;
            assert!(mean.length() < 1e-6, "nodes lie around the center of the corners");
        }
    }
    assert_eq!((backs, scene.surfaces.len()), (2, 4));
}

/// A parallelogram, a slightly bent part of a sphere, and a whole sphere.
#[test]
fn shapes_follow_the_curvature_of_surfaces() {
    let (text, _) = shapes();
    let prepared = prepare(&text);
    let scene = Scene::new(&prepared);
    let mut arena = full_arena(&scene);
    let roots = arena.roots.clone();
    assert!(matches!(&arena.elements[roots[0] as usize].shape, Shape::Patch(it) if it.form == PatchForm::Triangle));
    assert!(
        matches!(&arena.elements[roots[1] as usize].shape, Shape::Patch(it) if it.form == PatchForm::Parallelogram)
    );
    assert!(matches!(&arena.elements[roots[5] as usize].shape, Shape::Patch(it) if it.form == PatchForm::Bent), "ring");
    for round in [2, 3, 4, 6] {
        let sphere = &arena.elements[roots[round] as usize];
        assert!(
            matches!(sphere.shape, Shape::Curved(_)) && sphere.normal() == Vec3A::ZERO && sphere.node_count() == 1,
            "{sphere:?}"
        );
    }
    split(&mut arena, &scene, roots[2], 8);
    let leaves = leaves_of(&arena, roots[2]);
    let bent = |leaf: &&u32| arena.elements[**leaf as usize].patch().is_some_and(|it| it.form == PatchForm::Bent);
    assert_eq!(leaves.iter().filter(bent).count(), leaves.len());
    let ids: Vec<usize> = arena.elements.iter().filter_map(Element::directional).collect();
    assert_eq!(ids, (0..arena.directional_count).collect::<Vec<_>>(), "light by direction is numbered in order");
}

#[test]
fn boxes_of_fog_are_found_and_their_nodes_integrate_quadratics() {
    let prepared = prepare(&format!("medium haze =\n  sigma_s 0.1\nmbox haze -2 -3 -1 3 1 2\n{GRAY}"));
    let scene = Scene::new(&prepared);
    let mut arena = full_arena(&scene);
    let fog = arena.fog;
    split(&mut arena, &scene, fog, 7);
    let root = &arena.elements[arena.fog as usize];
    for k in 0..1000 {
        let place = Vec3A::new((k % 10) as f32, (k / 10 % 10) as f32, (k / 100) as f32) * 0.2 - 0.91;
        let point = root.center + root.half_extent * place;
        let found = &arena.elements[arena.fog_at(point).expect("inside") as usize];
        assert!(found.is_leaf() && ((point - found.center).abs() - found.half_extent).max_element() <= 1e-6);
        let sixth: Vec<f64> = found.nodes().map(|node| f64::from(node.position.x).powi(2)).collect();
        let (x, h) = (f64::from(found.center.x), f64::from(found.half_extent.x));
        assert!((sixth.iter().sum::<f64>() / 4.0 - (x * x + h * h / 3.0)).abs() < 1e-5, "mean of x^2 over the box");
    }
    assert_eq!(arena.fog_at(root.center + root.half_extent * Vec3A::new(1.1, 0.0, 0.0)), None);
    assert_eq!(FOG_NODES.iter().sum::<Vec3A>(), Vec3A::ZERO);
}

#[test]
fn coplanar_clusters_have_a_normal_and_others_have_none() {
    let prepared = prepare(&format!("{GRAY}{}", outward_box([0.0; 3], [1.0, 2.0, 3.0])));
    let scene = Scene::new(&prepared);
    let arena = full_arena(&scene);
    let root = &arena.elements[arena.root as usize];
    assert!((root.size() - 22.0).abs() < 1e-4 && root.normal() == Vec3A::ZERO && root.parent == NONE, "{root:?}");
    let floor = |x: f64| face(&[[x, 0.0, 0.0], [x + 1.0, 0.0, 0.0], [x + 1.0, 1.0, 0.0], [x, 1.0, 0.0]]);
    let prepared = prepare(&format!("{GRAY}{}{}{}", floor(0.0), floor(1.0), floor(2.5)));
    let scene = Scene::new(&prepared);
    let arena = full_arena(&scene);
    let root = &arena.elements[arena.root as usize];
    assert!(root.is_cluster() && root.normal() == Vec3A::Z && (root.size() - 3.0).abs() < 1e-5, "{root:?}");
}

/// The budget of memory counts elements by their size.
#[test]
fn elements_keep_their_size_in_memory() {
    assert_eq!(size_of::<Element>(), 464);
}
