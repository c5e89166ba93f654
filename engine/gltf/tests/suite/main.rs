//! Tests of the surfaces of frames as glTF, one module per topic.
#![allow(clippy::disallowed_methods, reason = "tests compute expected values independently of the engine")]

mod copies;
mod document;
mod limits;
mod parse;
mod rays;
mod tessellation;

use femc_import::{Bundle, load_scene, load_scene_file};
use femc_math::glam::DVec3;
use femc_prepared::{FrameSpec, Prepared, SceneSource, prepare_frame};
use std::collections::BTreeMap;
use std::path::Path;

/// Prepares a frame of a scene of the repository.
fn prepare_file(name: &str, frame: u32) -> Prepared {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../scenes").join(name);
    let scene = load_scene_file(&path).unwrap_or_else(|error| panic!("{error}")).scene;
    prepare_scene(&SceneSource::new(scene.into()), frame)
}

/// Prepares a scene of the scene format; a camera is added.
fn prepare_text(text: &str) -> Prepared {
    let text = format!("camera main =\n  origin 0 -8 1\n  target 0 0 0\n  film 8 8\n{text}");
    let bundle = Bundle(BTreeMap::from([("a.mgf".to_owned(), text.into_bytes())]));
    let scene = load_scene(&bundle, "a.mgf").unwrap_or_else(|error| panic!("{error}")).scene;
    prepare_scene(&SceneSource::new(scene.into()), 1)
}

fn prepare_scene(source: &SceneSource, frame: u32) -> Prepared {
    let spec = FrameSpec { camera: None, size: None, frame, filter_radius: 0.5 };
    prepare_frame(source, &spec, None).unwrap()
}

/// Numbers in [0, 1) with little structure: the additive recurrence of the golden ratio's relatives.
fn spread(k: u32) -> [f64; 4] {
    let steps = [0.856_674_883_854_502_9, 0.733_891_856_627_126, 0.628_706_721_040_458, 0.538_597_257_223_610];
    steps.map(|step| (0.5 + step * f64::from(k)).fract())
}

/// Returns the point of a triangle closest to `p`.
fn closest_point([a, b, c]: [DVec3; 3], p: DVec3) -> DVec3 {
    let (ab, ac, n) = (b - a, c - a, (b - a).cross(c - a));
    let q = p - a;
    // Barycentric coordinates of the projection.
    let v = q.cross(ac).dot(n) / n.length_squared();
    let w = ab.cross(q).dot(n) / n.length_squared();
    if v >= 0.0 && w >= 0.0 && v + w <= 1.0 {
        return a + ab * v + ac * w;
    }
    let on_edge = |from: DVec3, to: DVec3| {
        let t = (p - from).dot(to - from) / (to - from).length_squared();
        from.lerp(to, t.clamp(0.0, 1.0))
    };
    let edges = [on_edge(a, b), on_edge(b, c), on_edge(c, a)];
    edges.into_iter().min_by(|x, y| x.distance(p).total_cmp(&y.distance(p))).unwrap()
}
