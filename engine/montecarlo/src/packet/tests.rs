//! A packet computes the same bits as the scalar loop for each sample.

use super::*;
use crate::test_scene::prepare_with_camera;
use crate::tracer::PathSettings;
use femc_prepared::Prepared;
use femc_simd::Level;

/// Tent filter of a pixel.
#[derive(Clone, Copy)]
struct Tent;

impl PixelFilter for Tent {
    fn sample(self, u: [f32; 2]) -> [f32; 2] {
        u.map(|u| 2.0 * u - 1.0)
    }
    fn density(self, _: [f32; 2]) -> f32 {
        0.25
    }
}

/// A room with a ball and a tilted sheet.
const ROOM: &str = "\
m shade =
 sides 1
 c
 rd .6
m wall
v a =
 p -2 -2 0
v b =
 p 2 -2 0
v c =
 p 2 2 0
v d =
 p -2 2 0
v e =
 p -2 -2 3
v f =
 p 2 -2 3
v g =
 p 2 2 3
v h =
 p -2 2 3
f a b c d
f e h g f
f d c g h
f a d h e
f b f g c
v o =
 p .6 .4 .5
sph o .5
m shade
v i =
 p -1 0 .2
 n .6 0 .8
v j =
 p -.2 0 .9
 n -.6 0 .8
v k =
 p -.6 1 .3
 n 0 .6 .8
f i j k
";

const LAMPS: [(&str, &str); 5] = [
    ("far rectangle", "f p1 p2 p3 p4\n"),
    ("near rectangle", "xf -s 6 -t 0 0 -15.5\nf p1 p2 p3 p4\nxf\n"),
    ("ball", "sph p1 .2\n"),
    ("triangle", "f p1 p2 p3\n"),
    ("three lamps", "f p1 p2 p3 p4\nsph p5 .1\nf p5 p6 p7\n"),
];

const WALLS: [(&str, &str); 6] = [
    ("matte", " c\n rd .7\n"),
    ("rough", " c\n rd .3\n rs .4 .2\n"),
    ("metal", " c\n rs .8 .3\n"),
    ("plastic", " ir 1.5 0\n c\n rd .3\n rs .9 .2\n"),
    ("silver", " ir .15 3.6\n c\n rs .8 .3\n"),
    ("mirror", " c\n rd .3\n rs .4 0\n"),
];

fn scene(lamp: &str, wall: &str) -> Prepared {
    let points = "v p1 =\n p -.3 -.3 2.9\nv p2 =\n p -.3 .3 2.9\nv p3 =\n p .3 .3 2.9\nv p4 =\n p .3 -.3 2.9\n\
        v p5 =\n p 1.5 1.2 .4\nv p6 =\n p 1.5 1.4 .4\nv p7 =\n p 1.5 1.2 .8\n";
    let camera = "camera main =\n origin -1.7 -1.8 1.4\n target 1 1 1\n up 0 0 1\n fov 80\n film 60 40\n";
    let text = format!("m glow =\n sides 1\n c\n ed 300\nm glow\n{points}{lamp}m wall =\n sides 2\n{wall}{ROOM}");
    prepare_with_camera(camera, &text)
}

/// Compares samples of pixels all over the film.
/// - `directions`: number of directions at first surfaces.
fn compare(name: &str, scene: &Prepared, settings: PathSettings, directions: u32, level: Level) {
    const PIXELS: u32 = 600;
    let [width, height] = scene.camera.film;
    let pixel = |number: u32| (number * (width * height / PIXELS), number % 7);
    let tracer = || Tracer::new(scene, settings).with_first_branches(directions);
    let mut packet = Packet::new(tracer);
    assert!(packet.scene.is_some(), "{name}: no lanes");
    packet.set_level(level);
    let mut found = vec![None; PIXELS as usize];
    packet.trace((0..PIXELS).map(pixel), Tent, |number, sample| {
        let index = (0..PIXELS).find(|at| pixel(*at) == number).expect("a sample");
        assert!(found[index as usize].replace(sample).is_none(), "{name}: twice");
    });
    let mut scalar = tracer();
    let mut lit = 0;
    for (number, found) in (0..PIXELS).map(pixel).zip(found) {
        let expected = scalar.sample(number.0, number.1, Tent);
        let found = found.expect("a sample");
        let bits = |sample: &PathSample| (sample.color.to_array(), sample.albedo.to_array(), sample.depth);
        assert_eq!(bits(&found), bits(&expected), "{name}: sample {number:?}");
        lit += u32::from(expected.color != Rgb::ZERO);
    }
    assert_eq!(packet.counters(), scalar.counters, "{name}");
    assert!(lit > PIXELS / 2, "{name}: {lit} samples with light");
}

#[test]
fn packets_have_the_bits_of_the_scalar_loop() {
    for ((lamp_name, lamp), (wall_name, wall)) in LAMPS.into_iter().flat_map(|lamp| WALLS.map(|wall| (lamp, wall))) {
        let scene = scene(lamp, wall);
        let name = format!("{lamp_name}, {wall_name}");
        for (max_depth, directions) in [(0, 1), (3, 1), (0, 4), (2, 3)] {
            let settings = PathSettings { seed: 5, max_depth, single_technique: None };
            for level in [Level::detect(), Level::PORTABLE] {
                compare(&name, &scene, settings, directions, level);
            }
        }
    }
}
