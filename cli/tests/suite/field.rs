//! Tests of `femc field`: a strict reader parses the file, and its values are compared with the solution.

use crate::common::TestFolder;
use femc_pipeline::radiosity::{SolutionView, SolveOptions, solve};
use femc_pipeline::{SceneSource, Settings, Side};
use serde_json::Value;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

/// A ball above a floor under a lamp, with its middle far from the origin, and a sheet that transmits light. The camera looks at
/// the middle of the floor, which is `GRAY`.
const BALL: &str = "\
camera main =
\torigin 1000 2000 0.5
\ttarget 1000 2000 0
\tup 0 1 0
\tfov 4
\tfilm 8 8
m floor =
\tsides 1
\trd 0.5
m ball =
\tsides 1
\tc
\tcrgb 0.6 0.4 0.2
\trd 0.8
m sheet =
\tsides 2
\tc
\trd 0.3
\ttd 0.4
m bulb =
\tsides 1
\ted 1e4
xf -t 1000 2000 0
v a =
\tp -1 -1 0
v b =
\tp 1 -1 0
v c =
\tp 1 1 0
v d =
\tp -1 1 0
o ground
m floor
f a b c d
o
v e =
\tp -0.6 0 0.4
o ball
m ball
sph e 0.3
o
v f =
\tp 0.7 -0.5 0.1
v g =
\tp 0.7 0.5 0.1
v h =
\tp 0.7 0.5 0.9
v i =
\tp 0.7 -0.5 0.9
o curtain
m sheet
f f g h i
o
v j =
\tp -0.1 -0.1 2
v k =
\tp -0.1 0.1 2
v l =
\tp 0.1 0.1 2
v m =
\tp 0.1 -0.1 2
o lamp
m bulb
f j k l m
o
xf
";
const GRAY: f32 = 0.5;

/// A binary glTF file that has passed the checks of the format.
struct Gltf {
    document: Value,
    buffer: Vec<u8>,
}

fn read_u32(bytes: &[u8], at: usize) -> usize {
    let word = bytes.get(at..at + 4).unwrap_or_else(|| panic!("no word at {at}"));
    u32::from_le_bytes(word.try_into().expect("four bytes")) as usize
}

fn number(value: &Value, key: &str) -> usize {
    to_usize(&value[key])
}

fn to_usize(value: &Value) -> usize {
    value.as_u64().unwrap_or_else(|| panic!("{value} is no whole number")) as usize
}

fn list<'a>(value: &'a Value, key: &str) -> &'a [Value] {
    let list = value[key].as_array().unwrap_or_else(|| panic!("no list {key} in {value}"));
    assert!(!list.is_empty(), "{key}: lists without an item are not allowed");
    list
}

impl Gltf {
    fn read(path: &Path) -> Self {
        let bytes = std::fs::read(path).expect("the file");
        assert_eq!(&bytes[..4], b"glTF");
        assert_eq!((read_u32(&bytes, 4), read_u32(&bytes, 8)), (2, bytes.len()), "version and length");
        let text = read_u32(&bytes, 12);
        assert_eq!((&bytes[16..20], text % 4), (&b"JSON"[..], 0));
        let document: Value = serde_json::from_slice(&bytes[20..20 + text]).expect("JSON");
        let second = 20 + text;
        assert_eq!((&bytes[second + 4..second + 8], read_u32(&bytes, second) % 4), (&b"BIN\0"[..], 0));
        assert_eq!(second + 8 + read_u32(&bytes, second), bytes.len(), "two chunks and no more");
        let gltf = Self { document, buffer: bytes[second + 8..].to_vec() };
        gltf.check();
        gltf
    }

    fn check(&self) {
        let document = &self.document;
        assert_eq!(document["asset"]["version"], "2.0");
        assert!(document["asset"]["generator"].as_str().is_some_and(|it| it.starts_with("femc ")));
        assert_eq!(document["extensionsUsed"], serde_json::json!(["KHR_materials_unlit"]));
        assert_eq!(number(&list(document, "buffers")[0], "byteLength"), self.buffer.len());
        let mut end = 0;
        for view in list(document, "bufferViews") {
            assert_eq!(
                (number(view, "buffer"), number(view, "byteOffset")),
                (0, end),
                "views lie one behind the other"
            );
            assert_eq!(number(view, "byteOffset") % 4, 0);
            end += number(view, "byteLength");
        }
        assert_eq!(end, self.buffer.len());
        for (index, accessor) in list(document, "accessors").iter().enumerate() {
            let width = Self::width(accessor);
            let view = &document["bufferViews"][number(accessor, "bufferView")];
            assert_eq!(number(view, "byteLength"), 4 * width * number(accessor, "count"));
            let values = self.values(index);
            assert!(!values.is_empty() && values.iter().all(|value| value.is_finite()), "accessor {index}");
            for component in 0..width {
                let of = || values.iter().skip(component).step_by(width);
                let (least, most) = (of().fold(f64::MAX, |a, &b| a.min(b)), of().fold(f64::MIN, |a, &b| a.max(b)));
                let stated = ["min", "max"].map(|key| accessor[key][component].as_f64().map(|bound| bound as f32));
                assert_eq!(stated, [Some(least as f32), Some(most as f32)], "bounds of accessor {index}");
            }
        }
        let (nodes, scenes) = (list(document, "nodes"), list(document, "scenes"));
        let root = &nodes[to_usize(&list(&scenes[number(document, "scene")], "nodes")[0])];
        let turn: f64 = list(root, "rotation").iter().map(|q| q.as_f64().expect("a number").powi(2)).sum();
        assert!((turn - 1.0).abs() < 1e-12);
        let children: Vec<_> = list(root, "children").iter().map(to_usize).collect();
        let meshes: Vec<_> = children.iter().map(|&child| number(&nodes[child], "mesh")).collect();
        assert_eq!(meshes, (0..list(document, "meshes").len()).collect::<Vec<_>>(), "each mesh is shown once");
        for primitive in self.primitives() {
            let material = &document["materials"][number(primitive, "material")];
            assert_eq!(material["doubleSided"], false);
            assert!(material["extensions"]["KHR_materials_unlit"].is_object());
            let counts = primitive["attributes"].as_object().expect("attributes");
            let counts = counts.values().map(|at| self.values(to_usize(at)).len() / self.width_of(at));
            let counts: std::collections::BTreeSet<usize> = counts.collect();
            let indices = self.values(number(primitive, "indices"));
            assert_eq!(counts.len(), 1, "attributes of as many vertices");
            assert!(indices.iter().all(|&index| counts.iter().all(|&count| index < count as f64)));
            let corners = if primitive["mode"] == 4 { 3 } else { 2 };
            assert_eq!(indices.len() % corners, 0);
        }
    }

    fn width(accessor: &Value) -> usize {
        if accessor["type"] == "VEC3" { 3 } else { 1 }
    }

    fn width_of(&self, accessor: &Value) -> usize {
        Self::width(&self.document["accessors"][to_usize(accessor)])
    }

    fn values(&self, accessor: usize) -> Vec<f64> {
        let accessor = &self.document["accessors"][accessor];
        let view = &self.document["bufferViews"][number(accessor, "bufferView")];
        let start = number(view, "byteOffset");
        let words = self.buffer[start..start + number(view, "byteLength")].chunks_exact(4);
        let words = words.map(|word| word.try_into().expect("four bytes"));
        match number(accessor, "componentType") {
            5125 => words.map(|word| f64::from(u32::from_le_bytes(word))).collect(),
            5126 => words.map(|word| f64::from(f32::from_le_bytes(word))).collect(),
            other => panic!("component type {other}"),
        }
    }

    fn primitives(&self) -> impl Iterator<Item = &Value> {
        list(&self.document, "meshes").iter().flat_map(|mesh| list(mesh, "primitives"))
    }

    /// Returns the triangles of a mesh.
    fn mesh(&self, name: &str) -> &Value {
        let mesh = list(&self.document, "meshes").iter().find(|mesh| mesh["name"] == name);
        &mesh.unwrap_or_else(|| panic!("no mesh {name}"))["primitives"][0]
    }

    fn attribute(&self, primitive: &Value, name: &str) -> Vec<f64> {
        self.values(to_usize(&primitive["attributes"][name]))
    }

    fn vectors(&self, primitive: &Value, name: &str) -> Vec<[f64; 3]> {
        self.attribute(primitive, name).chunks_exact(3).map(|c| [c[0], c[1], c[2]]).collect()
    }

    fn triangles(&self, primitive: &Value) -> Vec<[usize; 3]> {
        let indices = self.values(number(primitive, "indices"));
        indices.chunks_exact(3).map(|c| [c[0] as usize, c[1] as usize, c[2] as usize]).collect()
    }

    /// Returns the area vector of all triangles, and their area.
    fn areas(&self, name: &str) -> ([f64; 3], f64) {
        let primitive = self.mesh(name);
        let positions = self.vectors(primitive, "POSITION");
        self.triangles(primitive).iter().fold(([0.0; 3], 0.0), |(sum, area), corners| {
            let [a, b, c] = corners.map(|corner| positions[corner]);
            let (e, f) = ([0, 1, 2].map(|k| b[k] - a[k]), [0, 1, 2].map(|k| c[k] - a[k]));
            let cross = [0, 1, 2].map(|k| 0.5 * (e[(k + 1) % 3] * f[(k + 2) % 3] - e[(k + 2) % 3] * f[(k + 1) % 3]));
            ([0, 1, 2].map(|k| sum[k] + cross[k]), area + cross.iter().map(|c| c * c).sum::<f64>().sqrt())
        })
    }

    fn scale(&self) -> f64 {
        self.document["scenes"][0]["extras"]["scale"].as_f64().expect("a scale")
    }

    /// Returns the vertices of a mesh at a position in the scene's own coordinates, m.
    fn vertices_at(&self, primitive: &Value, position: [f64; 3]) -> Vec<usize> {
        let origin = &self.document["scenes"][0]["extras"]["origin"];
        let want = [0, 1, 2].map(|k| position[k] - origin[k].as_f64().expect("a number"));
        let positions = self.vectors(primitive, "POSITION");
        let near = |p: &[f64; 3]| p.iter().zip(want).all(|(a, b)| (a - b).abs() < 1e-5);
        (0..positions.len()).filter(|&vertex| near(&positions[vertex])).collect()
    }
}

fn luminance([r, g, b]: [f64; 3]) -> f64 {
    0.2126 * r + 0.7152 * g + 0.0722 * b
}

fn cornell() -> String {
    let scene = Path::new(env!("CARGO_MANIFEST_DIR")).join("../scenes/cornell.mgf");
    std::fs::read_to_string(scene).expect("the scene")
}

#[test]
fn exported_room_is_valid_gltf_and_complete() {
    let dir = TestFolder::new();
    dir.write("cornell.mgf", &cornell());
    let report = dir.run("field cornell.mgf -o room.glb --json").exits(0).json();
    assert_eq!(
        Some(&report),
        serde_json::from_str(&dir.read("room.json")).ok().as_ref(),
        "the file is what was printed"
    );
    let gltf = Gltf::read(&dir.path("room.glb"));
    for (name, area) in [("rust", 16.0), ("teal", 16.0), ("panel, lamp", 0.7), ("tray", 0.7), ("rust, back", 16.0)] {
        assert!((gltf.areas(name).1 / area - 1.0).abs() < 1e-4, "{name}: {:?}", gltf.areas(name));
    }
    // Floor, ceiling and back wall; the block's faces; the ball.
    let white = 48.0 + 2.0 * 1.1 * 1.1 + 4.0 * 1.1 * 2.3 + 4.0 * std::f64::consts::PI * 0.49;
    assert!((gltf.areas("white").1 / white - 1.0).abs() < 5e-3, "{:?}, not {white}", gltf.areas("white"));
    let (down, _) = gltf.areas("panel, lamp");
    assert!((down[2] + 0.7).abs() < 1e-4, "the lamp is seen from below: {down:?}");
    let lamp = gltf.vectors(gltf.mesh("panel, lamp"), "_RADIANCE");
    let want = 4600.0 / std::f64::consts::PI;
    assert!(lamp.iter().all(|&color| (luminance(color) / want - 1.0).abs() < 1e-3), "{lamp:?}, not {want}");

    // The statistics agree with each other and with the file.
    let count =
        |pointer: &str| report.pointer(pointer).and_then(Value::as_f64).unwrap_or_else(|| panic!("no {pointer}"));
    for of in ["/elements", "/links/by_receiver", "/links/by_sender"] {
        let sum: f64 = ["clusters", "patches", "curved", "fog"].iter().map(|kind| count(&format!("{of}/{kind}"))).sum();
        assert!((sum - count(&format!("{of}/all"))).abs() < 0.5, "{of}: {report}");
    }
    assert_eq!(count("/links/by_receiver/all"), count("/links/elements"));
    let mut elements = std::collections::BTreeSet::new();
    let (mut vertices, mut triangles) = (0, 0);
    for primitive in gltf.primitives() {
        let numbers = gltf.attribute(primitive, "_ELEMENT");
        vertices += numbers.len();
        triangles += gltf.triangles(primitive).len();
        elements.extend(numbers.iter().filter(|&&number| number >= 0.0).map(|&number| number as u64));
    }
    assert_eq!(
        (elements.len() as f64, elements.last().copied()),
        (count("/leaves/all"), Some(elements.len() as u64 - 1))
    );
    assert_eq!((vertices as f64, triangles as f64), (count("/vertices"), count("/triangles")));
    assert!((count("/energy/emitted") / 3220.0 - 1.0).abs() < 1e-3, "{report}");
    assert!(count("/energy/absorbed") < count("/energy/emitted") && count("/energy/absorbed") > 1500.0, "{report}");
    assert!(count("/energy/absorbed") < count("/energy/received"), "{report}");
    assert!(count("/irradiance/least") < count("/irradiance/median"), "{report}");
    assert!(count("/irradiance/median") < count("/irradiance/most"), "{report}");
    assert!(count("/residual") <= 1e-4 && count("/seconds") > 0.0 && count("/bytes") > 0.0, "{report}");
    let said = dir.run("field cornell.mgf -o room.glb").exits(0);
    assert!(
        said.stdout().contains("links") && said.stderr().contains("solving"),
        "{} {}",
        said.stdout(),
        said.stderr()
    );
}

#[test]
fn colors_over_the_scale_are_the_solution_s_light() {
    let dir = TestFolder::new();
    dir.write("ball.mgf", BALL);
    dir.run("field ball.mgf -o ball.glb --exposure 9").exits(0);
    let gltf = Gltf::read(&dir.path("ball.glb"));
    assert!((gltf.scale() / (0.18 / 64.0) - 1.0).abs() < 1e-6, "EV 9 is for 64 cd/m2: {}", gltf.scale());
    let floor = gltf.mesh("floor");
    let middle = gltf.vertices_at(floor, [1000.0, 2000.0, 0.0]);
    assert!(!middle.is_empty(), "the middle of the floor is a corner of elements");

    let scene = femc_import::load_scene_file(&dir.path("ball.mgf")).expect("the scene").scene;
    let prepared = femc_pipeline::prepare_frame(&SceneSource::new(Arc::new(scene)), &Settings::default(), 1, None)
        .expect("a frame");
    let solution = solve(&prepared, &SolveOptions::default(), &AtomicBool::new(false)).expect("a solution");
    let look = SolutionView::new(&prepared, &solution.field);
    let [numbers, surfaces] = ["_ELEMENT", "_SURFACE"].map(|name| gltf.attribute(floor, name));
    let [colors, radiance, irradiance, direct] =
        ["COLOR_0", "_RADIANCE", "_IRRADIANCE", "_DIRECT"].map(|name| gltf.vectors(floor, name));
    let up = [0.0, 0.0, 1.0].into();
    for &vertex in &middle {
        let (leaf, surface) = (numbers[vertex] as u32, surfaces[vertex] as u32);
        let leaves = solution.field.leaves_of(surface);
        let (_, outline) = leaves.iter().find(|(it, _)| *it == leaf).expect("a leaf of the surface");
        let local = outline.local([0.5, 0.5].into());
        let field = solution.field.leaves[leaf as usize].irradiance(local, up);
        let light = look.irradiance(leaf, local, up);
        assert_eq!(light.indirect, field);
        for channel in 0..3 {
            let [all, straight] = [irradiance[vertex][channel], direct[vertex][channel]];
            let near = |a: f64, b: f32| (a - f64::from(b)).abs() <= 1e-5 * a.abs().max(1.0);
            assert!(
                near(straight, light.direct[channel]) && near(all - straight, field[channel]),
                "{all} {straight}: {light:?}"
            );
            let luminance = f64::from(GRAY) * all / std::f64::consts::PI;
            assert!((radiance[vertex][channel] / luminance - 1.0).abs() < 1e-5);
            assert!((colors[vertex][channel] / gltf.scale() / luminance - 1.0).abs() < 1e-5, "{:?}", colors[vertex]);
        }
    }
    assert!(solution.field.surfaces.iter().any(|surface| surface.side == Side::Back), "the sheet has a back");

    // Render the same point with the same method. Its direct light is computed with shadow rays.
    dir.run("render ball.mgf -o ball.exr --method fem --spp 256").exits(0);
    let image = femc_film::exr::read(&dir.path("ball.exr")).expect("an image").image;
    let pixels = image.pixels.iter().map(|pixel| luminance(pixel.map(f64::from)));
    let seen = pixels.sum::<f64>() / image.pixels.len() as f64;
    let shown = middle.iter().map(|&vertex| luminance(radiance[vertex])).sum::<f64>() / middle.len() as f64;
    assert!((shown / seen - 1.0).abs() < 0.05, "{shown} in the file, {seen} in the image");

    // The ball, and the sheet, whose sides both send light.
    let (closed, area) = gltf.areas("ball");
    assert!((area / (4.0 * std::f64::consts::PI * 0.09) - 1.0).abs() < 0.01, "{area}");
    // Where leaves are finer than the file's grid, gaps are narrower than the distance of its chords from the ball: 2e-5 of the
    // scene's extent.
    assert!(closed.iter().all(|sum| sum.abs() < 1e-3 * area), "a closed surface: {closed:?}");
    let [(front, _), (back, _)] = ["sheet", "sheet, back"].map(|name| gltf.areas(name));
    assert!((front[0] + back[0]).abs() < 1e-6 && front[0].abs() > 0.79, "{front:?} {back:?}");
    let most = |name: &str, attribute: &str| {
        let values = gltf.vectors(gltf.mesh(name), attribute);
        values.into_iter().map(luminance).fold(0.0, f64::max)
    };
    let [through, reflected] =
        [0.4, 0.3].map(|share| share * most("sheet, back", "_IRRADIANCE") / std::f64::consts::PI);
    let [shadow, lit] = ["sheet", "sheet, back"].map(|name| most(name, "_RADIANCE"));
    assert!(
        (1.0..1.1).contains(&(shadow / through)),
        "the shadow side has the light that comes through: {shadow} {through}"
    );
    assert!((1.0..1.1).contains(&(lit / reflected)), "the lit side has what it reflects: {lit} {reflected}");
    // The root node turns y up and adds the origin back.
    let nodes = list(&gltf.document, "nodes");
    let root = nodes.last().expect("a root");
    let origin: Vec<f64> = list(root, "translation").iter().filter_map(Value::as_f64).collect();
    let stated: Vec<f64> =
        list(&gltf.document["scenes"][0]["extras"], "origin").iter().filter_map(Value::as_f64).collect();
    assert_eq!(origin, [stated[0], stated[2], -stated[1]]);
    assert!(stated[0] > 900.0, "positions are relative to an origin near the scene's middle: {stated:?}");
}

#[test]
fn threads_change_no_byte_and_edges_add_lines() {
    let dir = TestFolder::new();
    dir.write("ball.mgf", BALL);
    for (name, threads) in [("one", 1), ("two", 2)] {
        dir.run(&format!("field ball.mgf -o {name}.glb --threads {threads}")).exits(0);
    }
    let [one, two] = ["one.glb", "two.glb"].map(|name| std::fs::read(dir.path(name)).expect("a file"));
    assert!(one == two);
    dir.run("field ball.mgf -o wire.glb --wire").exits(0);
    let gltf = Gltf::read(&dir.path("wire.glb"));
    let lines = gltf.primitives().filter(|primitive| primitive["mode"] == 1).count();
    assert!(lines >= 4, "floor, ball, and both sides of the sheet: {lines}");
    let leaves = |args: &str| {
        let report = dir.run(&format!("field ball.mgf -o more.glb --json {args}")).exits(0).json();
        (report["leaves"]["all"].as_u64(), report["refused"].as_u64())
    };
    let (usual, fine, starved) = (leaves(""), leaves("--error 0.03"), leaves("--memory 1"));
    assert!(fine.0 > usual.0 && starved.0 < usual.0 && starved.1 > Some(0), "{usual:?} {fine:?} {starved:?}");
}

#[test]
fn in_a_closed_box_that_shines_all_that_is_sent_is_kept() {
    let dir = TestFolder::new();
    let mut scene = "camera main =\n\torigin .3 .4 .2\n\ttarget .8 .6 .7\n\tfov 90\n\tfilm 8 8\n".to_owned();
    scene += &format!("m wall =\n\tsides 1\n\trd 0.5\n\ted {}\n", std::f64::consts::PI);
    for k in 0..8 {
        scene += &format!("v p{k} =\n\tp {} {} {}\n", k & 1, k >> 1 & 1, k >> 2);
    }
    for face in ["p0 p1 p3 p2", "p4 p6 p7 p5", "p0 p4 p5 p1", "p2 p3 p7 p6", "p0 p2 p6 p4", "p1 p5 p7 p3"] {
        scene += &format!("f {face}\n");
    }
    dir.write("box.mgf", &scene);
    let report = dir.run("field box.mgf -o box.glb --json").exits(0).json();
    let flux = |key: &str| report["energy"][key].as_f64().expect("a number") / std::f64::consts::PI;
    assert!((flux("emitted") / 6.0 - 1.0).abs() < 1e-3, "{report}");
    assert!((flux("received") / 12.0 - 1.0).abs() < 5e-3 && (flux("absorbed") / 6.0 - 1.0).abs() < 5e-3, "{report}");
    let gltf = Gltf::read(&dir.path("box.glb"));
    let (sum, area) = gltf.areas("wall");
    assert!((area - 6.0).abs() < 1e-4 && sum.iter().all(|sum| sum.abs() < 1e-4), "{sum:?} {area}");
    // Emitted luminance 1, plus half of the arriving light.
    for light in gltf.vectors(gltf.mesh("wall"), "_RADIANCE") {
        assert!((luminance(light) - 2.0).abs() < 0.02, "{light:?}");
    }
}

#[test]
fn a_scene_without_light_is_a_file_without_meshes_and_a_warning() {
    let dir = TestFolder::new();
    dir.write("dark.mgf", "camera main =\n\torigin 0 0 1\n\ttarget 0 1 1\n\tfov 40\n\tfilm 8 8\n");
    let said = dir.run("field dark.mgf").exits(0).stderr();
    assert!(said.contains("the file has no meshes"), "{said}");
    let bytes = std::fs::read(dir.path("dark.glb")).expect("the file by the scene's name");
    assert_eq!(read_u32(&bytes, 8), bytes.len());
    let document: Value = serde_json::from_slice(&bytes[20..]).expect("one chunk");
    assert!(document.get("meshes").is_none() && document.get("buffers").is_none(), "{document}");
}

#[test]
fn what_cannot_be_done_is_refused_before_anything_is_solved() {
    let dir = TestFolder::new();
    std::fs::create_dir(dir.path("folder.glb")).expect("a folder");
    for (args, code, part) in [
        ("field fog.mgf -o out.obj", 2, ".glb"),
        ("field fog.mgf -o out", 2, ".glb"),
        ("field fog.mgf -o nowhere/out.glb", 2, "no folder nowhere"),
        ("field fog.mgf -o folder.glb", 2, "is a folder"),
        ("field fog.mgf --error 0", 2, "--error"),
        ("field fog.mgf --error nan", 2, "--error"),
        ("field fog.mgf --frame 70000", 2, "--frame: frame 70000 is beyond the clip"),
        ("field fog.mgf --memory much", 2, "--memory"),
        ("field fog.mgf --exposure bright", 2, "--exposure"),
        ("field fog.mgf --set nothing.at.all=1", 2, "--set"),
        ("field none.mgf -o out.glb", 2, "none.mgf"),
    ] {
        let ran = dir.run(args);
        assert!(ran.code() == Some(code) && ran.stderr().contains(part), "{args}: {:?} {}", ran.code(), ran.stderr());
        assert!(!dir.path("out.glb").exists() && !dir.path("fog.glb").exists(), "{args}");
    }
}
