//! Transport of light down and up the tree.

use super::{GRAY, face, full_arena, leaves_of, outward_box, prepare, split};
use crate::element::{Element, Shape};
use crate::gather::{ElementLights, FROM_ELEMENTS, FROM_LAMPS, IterationFlux};
use crate::link::Link;
use crate::scene::Scene;
use femc_math::Rgb;
use femc_math::color::luminance;
use femc_math::glam::Vec3A;
use std::f64::consts::PI;

/// A linear function of the position.
fn linear(position: Vec3A) -> Rgb {
    Rgb::new(3.0, 7.0, 5.0) + Rgb::splat(0.7 * position.x - 0.4 * position.y + 0.3 * position.z)
}

/// Light that a parent receives at its nodes reaches all leaves, with equal flux.
#[test]
fn pushing_keeps_linear_light_and_its_flux() {
    let text = format!(
        "medium haze =\n  sigma_s 0.1\nmbox haze -2 -3 -1 3 1 2\n{GRAY}{}{}",
        face(&[[0.0, 0.0, 0.0], [3.0, 0.0, 0.0], [0.0, 0.0, 1.0]]),
        face(&[[0.0, 3.0, 0.0], [2.0, 3.0, 0.0], [2.5, 3.0, 1.0], [0.5, 3.0, 1.0]]),
    );
    let prepared = prepare(&text);
    let scene = Scene::new(&prepared);
    let mut arena = full_arena(&scene);
    let roots = [arena.roots[0], arena.roots[1], arena.fog];
    for root in roots {
        split(&mut arena, &scene, root, 2);
        let first = leaves_of(&arena, root)[1];
        split(&mut arena, &scene, first, 3);
    }
    let mut lights = ElementLights::new(&arena);
    for kind in [FROM_LAMPS, FROM_ELEMENTS] {
        for root in roots {
            let values = lights.elements[root as usize].total[kind].iter_mut();
            values.zip(arena.elements[root as usize].nodes()).for_each(|(value, node)| *value = linear(node.position));
        }
    }
    [FROM_LAMPS, FROM_ELEMENTS].into_iter().for_each(|kind| lights.push(&arena, kind));
    for root in roots {
        let whole = &arena.elements[root as usize];
        let mut flux = 0.0;
        for leaf in leaves_of(&arena, root) {
            let element = &arena.elements[leaf as usize];
            for (node, value) in element.nodes().zip(lights.elements[leaf as usize].total[FROM_ELEMENTS]) {
                assert!((value - linear(node.position)).abs().max_element() < 1e-4, "{value} at {}", node.position);
                flux += f64::from(value.y) * f64::from(element.size()) / element.node_count() as f64;
            }
            assert_eq!(
                lights.elements[leaf as usize].total[FROM_LAMPS],
                lights.elements[leaf as usize].total[FROM_ELEMENTS]
            );
        }
        let mean =
            whole.nodes().map(|node| f64::from(linear(node.position).y)).sum::<f64>() / whole.node_count() as f64;
        let want = mean * f64::from(whole.size());
        assert!((flux / want - 1.0).abs() < 1e-5, "{flux}, not {want}");
    }
}

/// The leaves of each surface reflect half of what they receive. All levels above have the sum.
#[test]
fn pulling_keeps_the_flux_and_the_bounds_of_brightness() {
    let prepared = prepare(&format!("{GRAY}{}", outward_box([0.0; 3], [1.0, 2.0, 3.0])));
    let scene = Scene::new(&prepared);
    let mut arena = full_arena(&scene);
    for (k, root) in arena.roots.clone().into_iter().enumerate() {
        split(&mut arena, &scene, root, k as u32);
    }
    let mut lights = ElementLights::new(&arena);
    let mut sent = 0.0;
    for (index, element) in arena.elements.iter().enumerate().filter(|(_, element)| element.is_leaf()) {
        for (k, (value, node)) in lights.elements[index].total[FROM_LAMPS].iter_mut().zip(element.nodes()).enumerate() {
            *value = Rgb::splat(10.0 + (k + index % 7) as f32 + node.position.z);
            sent += 0.5 * f64::from(value.y) * f64::from(element.size()) / 4.0;
        }
    }
    let IterationFlux { change, sent: whole, first } = lights.reflect_all(&scene, &arena);
    assert!((first / sent - 1.0).abs() < 1e-5, "all light is direct: {first}");
    assert!((change / sent - 1.0).abs() < 1e-5 && (whole / sent - 1.0).abs() < 1e-5, "{change} {whole} {sent}");
    let again = lights.reflect_all(&scene, &arena).change;
    assert!(again < 1e-6 * sent, "equal light is no change: {again}");
    let root = arena.root as usize;
    let flux = f64::from(lights.elements[root].radiosity.y) * f64::from(arena.elements[root].size());
    assert!((flux / sent - 1.0).abs() < 1e-5, "{flux}, not {sent}");
    for (index, element) in arena.elements.iter().enumerate() {
        let light = &lights.elements[index];
        let leaves = leaves_of(&arena, index as u32);
        let of = |get: fn(&crate::gather::ElementLight) -> f32| {
            leaves.iter().map(move |&leaf| (leaf, get)).map(|(leaf, get)| get(&lights.elements[leaf as usize]))
        };
        let least = of(|light| light.darkest).fold(f32::INFINITY, f32::min);
        let most = of(|light| light.brightest).fold(0.0, f32::max);
        assert_eq!((light.darkest, light.brightest), (least, most), "{element:?}");
        assert_eq!(light.min_mean, of(|light| light.mean).fold(f32::INFINITY, f32::min));
        assert!(light.darkest <= luminance(light.radiosity) && luminance(light.radiosity) <= light.brightest);
    }
}

/// A box whose faces have radiosity 1 sends, in each direction, its projected area over pi.
#[test]
fn the_intensity_of_a_cluster_is_that_of_its_projected_area() {
    let [a, b, c] = [1.0, 2.0, 3.0];
    let prepared = prepare(&format!("{GRAY}{}", outward_box([0.0; 3], [a, b, c])));
    let scene = Scene::new(&prepared);
    let mut arena = full_arena(&scene);
    for root in arena.roots.clone() {
        split(&mut arena, &scene, root, 2);
    }
    let mut lights = ElementLights::new(&arena);
    for (index, _) in arena.elements.iter().enumerate().filter(|(_, element)| element.is_leaf()) {
        lights.elements[index].total[FROM_LAMPS] = [Rgb::splat(2.0); 4];
    }
    lights.reflect_all(&scene, &arena);
    let intensity = &lights.intensity[arena.elements[arena.root as usize].directional().expect("a cluster")];
    for dir in [[1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.6, 0.0, 0.8], [0.48, -0.6, 0.64], [-0.36, 0.48, 0.8]] {
        let faces = [(b * c, dir[0]), (a * c, dir[1]), (a * b, dir[2])];
        let projected = |kernel: fn(f64) -> f64| -> f64 {
            faces.iter().map(|(area, cosine)| area * (kernel(*cosine) + kernel(-cosine)) / PI).sum()
        };
        let found = f64::from(intensity.cosine_integral(Vec3A::from_array(dir.map(|x| x as f32))).y);
        // Nine harmonics represent the clamped cosine by a quadratic function \[ramamoorthi2001\]; it is exact to 0.1.
        let quadratic = projected(|cosine| 0.25 + 0.5 * cosine + 5.0 / 32.0 * (3.0 * cosine * cosine - 1.0));
        assert!((found / quadratic - 1.0).abs() < 1e-4, "{dir:?}: {found}, not {quadratic}");
        assert!((found - projected(|cosine| cosine.max(0.0))).abs() < 0.1 * 22.0 / PI, "{dir:?}: {found}");
    }
    // Over all directions the intensity is the flux of 22 m2, a quarter of whose area is seen in the mean.
    assert!((f64::from(intensity.total().y) * PI - 22.0).abs() < 1e-3, "{}", intensity.total());
}

/// Light from one direction reaches the surfaces of a cluster by the cosine at their normals, and the fog in equal parts.
#[test]
fn light_of_a_cluster_is_pushed_by_the_cosine_of_each_surface() {
    let text = format!(
        "medium haze =\n  sigma_s 0.1\nmbox haze -2 -3 -1 3 1 2\n{GRAY}{}",
        outward_box([0.0; 3], [1.0, 2.0, 3.0])
    );
    let prepared = prepare(&text);
    let scene = Scene::new(&prepared);
    let arena = full_arena(&scene);
    let mut lights = ElementLights::new(&arena);
    let dir = Vec3A::new(0.48, -0.6, 0.64);
    let root = arena.elements[arena.root as usize].directional().expect("a cluster");
    lights.incident[root].total[FROM_ELEMENTS] = femc_field::Harmonics::from_direction(dir, Rgb::splat(8.0));
    lights.push(&arena, FROM_ELEMENTS);
    let mut seen = 0;
    for (index, element) in arena.elements.iter().enumerate().filter(|(_, element)| element.is_leaf()) {
        let found = lights.elements[index].total[FROM_ELEMENTS][0].y;
        match &element.shape {
            Shape::Volume(_) => assert!((found - 2.0).abs() < 1e-4, "a quarter: {found}"),
            _ => {
                let want = 8.0 * element.normal().dot(dir).max(0.0);
                assert!((found - want).abs() < 0.07 * 8.0, "{}: {found}, not {want}", element.normal());
            }
        }
        seen += 1;
    }
    assert_eq!(seen, 7);
}

/// Two links to one receiver add up, each node by its own factor.
#[test]
fn gathered_light_is_the_sum_of_radiosity_times_factor() {
    let square = |z: f64| face(&[[0.0, 0.0, z], [1.0, 0.0, z], [1.0, 1.0, z], [0.0, 1.0, z]]);
    let prepared = prepare(&format!("{GRAY}{}{}{}", square(0.0), square(1.0), square(2.5)));
    let scene = Scene::new(&prepared);
    let arena = full_arena(&scene);
    let mut lights = ElementLights::new(&arena);
    let [a, b, c] = [0, 1, 2].map(|surface| arena.roots[surface]);
    lights.elements[b as usize].radiosity = Rgb::new(1.0, 2.0, 3.0);
    lights.elements[c as usize].radiosity = Rgb::splat(10.0);
    let mut links = vec![
        Link { receiver: a, source: b, factors: [0.1, 0.2, 0.3, 0.4] },
        Link { receiver: a, source: c, factors: [0.01, 0.0, 0.0, 0.02] },
        Link { receiver: b, source: c, factors: [0.5; 4] },
    ];
    links.sort_by_key(|link| (link.receiver, link.source));
    lights.gather(&arena, &links);
    let found = lights.elements[a as usize].total[FROM_ELEMENTS];
    let want = [[0.2, 0.3, 0.4], [0.2, 0.4, 0.6], [0.3, 0.6, 0.9], [0.6, 1.0, 1.4]].map(Rgb::from_array);
    assert!(found.iter().zip(want).all(|(found, want)| (*found - want).abs().max_element() < 1e-6), "{found:?}");
    assert_eq!(lights.elements[b as usize].total[FROM_ELEMENTS], [Rgb::splat(5.0); 4]);
    lights.gather(&arena, &links[..0]);
    assert_eq!(lights.elements[a as usize].total[FROM_ELEMENTS], [Rgb::ZERO; 4], "links are gone");
}

/// A thin sheet reflects from its front and transmits from its back.
#[test]
fn a_translucent_sheet_sends_what_its_other_side_receives() {
    let text = format!(
        "m sheet =\n  sides 2\n  c\n  rd 0.5\n  td 0.25\nm sheet\n{}",
        face(&[[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [0.0, 1.0, 0.0]])
    );
    let prepared = prepare(&text);
    let scene = Scene::new(&prepared);
    let mut arena = full_arena(&scene);
    let [front, back] = [0, 1].map(|side| arena.roots[side]);
    split(&mut arena, &scene, front, 2);
    let mut lights = ElementLights::new(&arena);
    lights.elements[front as usize].total[FROM_LAMPS] = [Rgb::splat(8.0); 4];
    lights.elements[back as usize].total[FROM_ELEMENTS] = [Rgb::splat(100.0); 4];
    [FROM_LAMPS, FROM_ELEMENTS].into_iter().for_each(|kind| lights.push(&arena, kind));
    lights.reflect_all(&scene, &arena);
    let of = |element: &Element| {
        lights.elements.iter().zip(&arena.elements).find(|(_, it)| it.key == element.key).unwrap().0.radiosity.y
    };
    let [front, back] = [front, back].map(|side| of(&arena.elements[side as usize]));
    assert!((front - (4.0 + 25.0)).abs() < 1e-4 && (back - (50.0 + 2.0)).abs() < 1e-4, "{front} {back}");
}
