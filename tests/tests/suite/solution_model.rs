//! Tests of finite-element solutions as files for viewers, against measurements by path tracing.

use femc_math::glam::DVec3;
use femc_pipeline::gltf::{SolutionOptions, solution_model};
use femc_pipeline::measure::{
    Area, MeasureRequest, MeasureSettings, Measured, Place, SurfaceSide, measure, resolve_places, summarize,
};
use femc_pipeline::radiosity::SolveOptions;
use femc_pipeline::{Field, Prepared, StopCondition};
use femc_tests::closed_forms::SolvedScene;
use serde_json::Value;
use std::sync::atomic::{AtomicBool, AtomicU64};

/// A gray room of 3 m x 2 m x 2 m, far from the world's origin, with a lamp below the ceiling and a ball.
const ROOM: &str = "camera main =\n origin 1001.5 998 1\n target 1001.5 1001 1\n film 4 4\n\
     m gray =\n sides 1\n rd .6\nm lamp =\n sides 1\n ed 400\nm white =\n sides 1\n rd .8\n\
     v a =\n p 1000 1000 0\nv b =\n p 1003 1000 0\nv c =\n p 1003 1002 0\nv d =\n p 1000 1002 0\n\
     v e =\n p 1000 1000 2\nv f =\n p 1003 1000 2\nv g =\n p 1003 1002 2\nv h =\n p 1000 1002 2\n\
     v i =\n p 1001 1000.7 1.8\nv j =\n p 1002 1000.7 1.8\nv k =\n p 1002 1001.3 1.8\nv l =\n p 1001 1001.3 1.8\n\
     v s =\n p 1000.8 1001 .6\n\
     o room\nm gray\no floor\nf a b c d\no\no ceiling\nf h g f e\no\no walls\nf e f b a\nf f g c b\nf g h d c\nf h e a d\no\no\n\
     o panel\nm lamp\nf l k j i\no\no ball\nm white\nsph s .4\no\n";

fn solved() -> SolvedScene {
    SolvedScene::new(ROOM, &SolveOptions { error: 0.1, ..SolveOptions::default() })
}

fn model(prepared: &Prepared, field: &Field, options: &SolutionOptions) -> Model {
    Model::new(&solution_model(prepared, field, options).expect("a file"))
}

/// A file, parsed independently of its writer.
struct Model {
    json: Value,
    binary: Vec<u8>,
}

/// A triangle: its corners in the scene's frame, m, and at each corner illuminance, direct illuminance (lx) and luminance (cd/m2).
struct Triangle {
    corners: [DVec3; 3],
    values: [[f64; 3]; 3],
}

impl Triangle {
    fn area(&self) -> f64 {
        let [a, b, c] = self.corners;
        let (u, v) = (b - a, c - a);
        0.5 * DVec3::new(u.y * v.z - u.z * v.y, u.z * v.x - u.x * v.z, u.x * v.y - u.y * v.x).length()
    }

    /// Returns the integral of one of the values over the triangle.
    fn integral(&self, value: usize) -> f64 {
        self.area() * self.values.iter().map(|values| values[value]).sum::<f64>() / 3.0
    }
}

impl Model {
    fn new(bytes: &[u8]) -> Self {
        let number = |at: usize| u32::from_le_bytes(bytes[at..at + 4].try_into().expect("four bytes")) as usize;
        let text = number(12);
        let json = serde_json::from_slice(&bytes[20..20 + text]).expect("JSON");
        Self { json, binary: bytes.get(28 + text..).unwrap_or_default().to_vec() }
    }

    fn extras(&self) -> &Value {
        &self.json["scenes"][0]["extras"]
    }

    /// Returns the words of an accessor as 32-bit patterns.
    fn words(&self, accessor: &Value) -> Vec<u32> {
        let at = |value: &Value| value.as_u64().expect("a number") as usize;
        let view = &self.json["bufferViews"][at(&self.json["accessors"][at(accessor)]["bufferView"])];
        let start = at(&view["byteOffset"]);
        let bytes = &self.binary[start..start + at(&view["byteLength"])];
        bytes.chunks_exact(4).map(|word| u32::from_le_bytes(word.try_into().expect("four bytes"))).collect()
    }

    /// Returns the triangles of a material.
    fn triangles(&self, material: &str) -> Vec<Triangle> {
        let origin: [f64; 3] = serde_json::from_value(self.extras()["origin"].clone()).expect("an origin");
        let meshes = self.json["meshes"].as_array().expect("meshes").iter().filter(|mesh| mesh["name"] == material);
        let mut all = Vec::new();
        for primitive in meshes.flat_map(|mesh| mesh["primitives"].as_array().expect("primitives")) {
            let floats = |name: &str| -> Vec<f64> {
                let words = self.words(&primitive["attributes"][name]);
                words.into_iter().map(|word| f64::from(f32::from_bits(word))).collect()
            };
            let [position, radiance] = ["POSITION", "_RADIANCE"].map(floats);
            let [total, direct] = ["_ILLUMINANCE", "_DIRECT"].map(floats);
            for triangle in self.words(&primitive["indices"]).chunks_exact(3) {
                let vertices = [0, 1, 2].map(|corner| triangle[corner] as usize);
                all.push(Triangle {
                    corners: vertices
                        .map(|v| DVec3::from_slice(&position[3 * v..3 * v + 3]) + DVec3::from_array(origin)),
                    values: vertices.map(|v| {
                        let [r, g, b] = [0, 1, 2].map(|channel| radiance[3 * v + channel]);
                        [total[v], direct[v], 0.2126 * r + 0.7152 * g + 0.0722 * b]
                    }),
                });
            }
        }
        all
    }
}

/// Returns the mean illuminance of an object by path tracing, lx.
fn measured(prepared: &Prepared, object: &str, max_depth: u32) -> f64 {
    let area = Area { name: "a".into(), object: object.into(), side: SurfaceSide::Front, cells: 24 };
    let places = resolve_places(prepared, &MeasureRequest { area: vec![area], ..MeasureRequest::default() });
    let places = places.expect("cells");
    let settings = MeasureSettings { stop: StopCondition::Error(0.02), max_depth, seed: 1, by_lamp: false };
    let (cancel, progress) = (AtomicBool::new(false), AtomicU64::new(0));
    let read = |(number, place): (u32, &Place)| {
        let reading = measure(prepared, number, place, &settings, &cancel, &progress).expect("not cancelled");
        Measured { place: place.info.clone(), reading }
    };
    let measured: Vec<Measured> = (0..).zip(&places).map(read).collect();
    summarize(&measured)[0].mean.value
}

/// The elements are an approximation: 4 % is more than twice the deviation that this room has at this link error.
#[test]
fn illuminance_of_a_solution_is_that_of_measurements() {
    let SolvedScene { prepared, field, .. } = solved();
    let model = model(&prepared, &field, &SolutionOptions::default());
    let gray = model.triangles("gray");
    let is_floor = |it: &&Triangle| it.corners.iter().all(|corner| corner.z.abs() < 1e-4);
    let is_ceiling = |it: &&Triangle| it.corners.iter().all(|corner| (corner.z - 2.0).abs() < 1e-4);
    let ball = model.triangles("white");
    let parts: [(&str, Vec<&Triangle>, f64); 3] = [
        ("room.floor", gray.iter().filter(is_floor).collect(), 6.0),
        ("room.ceiling", gray.iter().filter(is_ceiling).collect(), 6.0),
        ("ball", ball.iter().collect(), 4.0 * std::f64::consts::PI * 0.16),
    ];
    for (object, triangles, expected_area) in parts {
        let area: f64 = triangles.iter().map(|triangle| triangle.area()).sum();
        assert!((area / expected_area - 1.0).abs() < 0.01, "{object}: {area} m2, not {expected_area}");
        let mean = |value| triangles.iter().map(|triangle| triangle.integral(value)).sum::<f64>() / area;
        for (value, max_depth) in [(0, 0), (1, 1)] {
            let (found, wanted) = (mean(value), measured(&prepared, object, max_depth));
            let is_near = (found - wanted).abs() <= 0.04 * wanted.max(1.0);
            assert!(is_near, "{object}, depth {max_depth}: {found} lx in the elements, {wanted} lx by paths");
        }
        let reflected = mean(0) * if object == "ball" { 0.8 } else { 0.6 } / std::f64::consts::PI;
        assert!((mean(2) / reflected - 1.0).abs() < 1e-4, "{object}: {} cd/m2, not {reflected}", mean(2));
    }
    let lamp = model.triangles("lamp");
    let luminance = 400.0 / std::f64::consts::PI;
    assert!(lamp.iter().flat_map(|it| it.values).all(|values| (values[2] / luminance - 1.0).abs() < 1e-4));
}

#[test]
fn light_of_a_model_follows_the_brightness_of_the_lamps() {
    let SolvedScene { prepared, field, .. } = solved();
    let triangles = |field: &Field| model(&prepared, field, &SolutionOptions::default()).triangles("gray");
    let (once, twice) = (triangles(&field), triangles(&field.clone().scaled(2.0)));
    assert_eq!(once.len(), twice.len());
    for (a, b) in once.iter().zip(&twice) {
        let values = a.values.iter().flatten().zip(b.values.iter().flatten());
        assert!(values.clone().all(|(x, y)| (2.0 * x - y).abs() <= 1e-5 * y), "{:?} {:?}", a.values, b.values);
    }
}

#[test]
fn a_solution_beyond_the_limit_is_left_out_and_says_so() {
    let SolvedScene { prepared, field, .. } = solved();
    let full = model(&prepared, &field, &SolutionOptions::default());
    let triangles = full.extras()["triangles"].as_u64().expect("a number");
    let limited =
        |max_triangles: u64| model(&prepared, &field, &SolutionOptions { max_triangles: max_triangles as usize });
    assert_eq!(limited(triangles).extras()["triangles"], triangles);
    let none = limited(triangles - 1);
    assert_eq!((&none.extras()["triangles"], &none.extras()["full_triangles"]), (&0.into(), &triangles.into()));
    assert!(none.json.get("meshes").is_none() && none.binary.is_empty());
}
