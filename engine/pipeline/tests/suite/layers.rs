//! Tests of layers of rendered tiles.

use femc_film::tile::NONE_HELD;
use femc_film::{FilmError, Frame, FrameImage, LayerImage, LayerPiece, Rect, Tiling};
use femc_import::{Bundle, load_scene};
use femc_pipeline::replay::Replay;
use femc_pipeline::{
    Layer, LayerPlan, Method, Outputs, Prepared, Preset, RenderTask, SceneSource, Settings, StatisticsPlan,
    StopCondition, lamp_labels, plan_job, prepare_frame,
};
use femc_scene::Scene;
use std::collections::BTreeMap;
use std::sync::Arc;

/// A floor that is matte and glossy, a mirror ball, a plate of colored glass, a sheet that transmits diffusely, two lamps, thin
/// fog.
const ROOM: &str = "\
camera main =
	origin 0 -3 1
	target 0 0 .8
	fov 60
	film 24 16
m floor =
	c
	cxy .4 .4
	rd .5
	c
	rs .3 .2
m paper =
	c
	rd .3
	td .4
m mirror =
	rs .9 0
m glass =
	rs .05 0
	ts .8 0
m red =
	sides 1
	ed 500
m blue =
	sides 1
	ed 300
v a =
	p -4 -4 0
v b =
	p 4 -4 0
v c =
	p 4 4 0
v d =
	p -4 4 0
m floor
o ground
f a b c d
o
v o =
	p .6 0 .5
m mirror
o ball
sph o .5
o
v e =
	p -.9 -.3 .2
v f =
	p -.3 -.3 .2
v g =
	p -.3 -.3 1.2
v h =
	p -.9 -.3 1.2
m glass
o pane
f e f g h
o
v i =
	p -.9 .6 .2
v j =
	p .1 .6 .2
v k =
	p .1 .6 1.2
v n =
	p -.9 .6 1.2
m paper
o screen
f i j k n
o
o lamps
v l =
	p -.4 0 2
m red
o left
sph l .2
o
v r =
	p .4 1 1.6
m blue
o right
sph r .1
o
o
";
const FOG: &str = "medium haze =\n\tsigma_s .1\nmglobal haze\n";

fn settings(layers: Vec<Layer>, method: Method) -> Settings {
    Settings { stop: StopCondition::Spp(8), method, layers, ..Settings::default() }
}

pub fn scene(text: &str) -> Scene {
    let files = BTreeMap::from([("room.mgf".to_owned(), text.as_bytes().to_vec())]);
    load_scene(&Bundle(files), "room.mgf").unwrap_or_else(|e| panic!("{e}")).scene
}

fn world(text: &str, settings: &Settings) -> Prepared {
    let source = SceneSource::new(Arc::new(scene(text)));
    plan_job(source.scene(), settings, None).unwrap_or_else(|e| panic!("{e}"));
    prepare_frame(&source, settings, 1, None).unwrap()
}

/// Returns, for each layer of a frame of a scene, whether it has light.
pub fn layers_with_light(text: &str, settings: &Settings, frame: u32) -> Vec<bool> {
    let source = SceneSource::new(Arc::new(scene(text)));
    let prepared = prepare_frame(&source, settings, frame, None).unwrap();
    let [width, height] = prepared.camera.film;
    let (tiling, rect) = (Tiling::new(width, height, 64).unwrap(), Rect { x: 0, y: 0, width, height });
    let plan = LayerPlan::new(&prepared, settings).unwrap();
    let StopCondition::Spp(samples) = settings.stop else { panic!("a number of samples") };
    let task = RenderTask::new(&prepared, settings, rect, 0..samples);
    let layers = task.render(Outputs { layers: Some(&plan), ..Outputs::default() }).unwrap().aovs.light.unwrap();
    let mut piece = LayerPiece::new(tiling, 0);
    piece.put(&layers, NONE_HELD).unwrap();
    let mut images = LayerImage::black(settings.layers.iter().map(|layer| layer.name.clone()), width, height);
    LayerImage::put(&mut images, &piece).unwrap();
    images.iter().map(|image| image.color.iter().any(|color| *color != [0.0; 3])).collect()
}

fn lamps(prepared: &Prepared) -> Vec<String> {
    lamp_labels(&prepared.scene)
}

/// Renders the picture of a world and its layers.
fn rendered(prepared: &Prepared, settings: &Settings) -> Result<(FrameImage, Vec<LayerImage>), FilmError> {
    let [width, height] = prepared.camera.film;
    let (tiling, rect) = (Tiling::new(width, height, 64)?, Rect { x: 0, y: 0, width, height });
    let plan = LayerPlan::new(prepared, settings).unwrap();
    let task = RenderTask::new(prepared, settings, rect, 0..8);
    let layered = task.render(Outputs { layers: Some(&plan), ..Outputs::default() }).unwrap();
    let plain = task.render(Outputs::default()).unwrap();
    assert!(layered.tile == plain.tile && layered.statistics.is_none(), "layers change no sample");
    let statistics = StatisticsPlan::new(prepared, settings, 64);
    let statistics = Outputs { statistics: Some(&statistics), ..Outputs::default() };
    let all = task.render(Outputs { layers: Some(&plan), ..statistics }).unwrap();
    let alone = task.render(statistics).unwrap();
    assert!(
        all.aovs == layered.aovs && all.statistics == alone.statistics && alone.statistics.is_some(),
        "layers and statistics are independent"
    );
    let layers = layered.aovs.light.unwrap();
    let mut frame = Frame::new(tiling);
    frame.insert(layered.tile)?;
    let mut piece = LayerPiece::new(tiling, 0);
    piece.put(&layers, NONE_HELD)?;
    let mut images = LayerImage::black(settings.layers.iter().map(|layer| layer.name.clone()), width, height);
    LayerImage::put(&mut images, &piece)?;
    Ok((frame.resolve(), images))
}

fn sum(image: &LayerImage) -> f64 {
    image.color.as_flattened().iter().map(|value| f64::from(*value)).sum()
}

/// Maximum relative error of sums of floats: a path in the fog here finds light some 400 times, and its sum is off by 2e-6 (each
/// addition by 6e-8 at most).
const ROUNDING: f64 = 4e-6;

/// Checks that the layers `names` sum up to the picture, pixel by pixel, and that all of them have light.
fn assert_partition(image: &FrameImage, layers: &[LayerImage], names: &[&str]) {
    let parts: Vec<&LayerImage> = layers.iter().filter(|layer| names.contains(&layer.name.as_str())).collect();
    assert_eq!(parts.len(), names.len());
    assert!(parts.iter().all(|layer| sum(layer) > 0.0), "{names:?}");
    for (at, color) in image.color.pixels.iter().enumerate() {
        for (channel, wanted) in color.iter().enumerate() {
            let sum: f64 = parts.iter().map(|layer| f64::from(layer.color[at][channel])).sum();
            let wanted = f64::from(*wanted);
            assert!((sum - wanted).abs() <= ROUNDING * wanted, "{names:?}, pixel {at}: {sum}, not {wanted}");
        }
    }
}

#[test]
fn partitioning_layers_sum_to_the_image_with_unchanged_samples() {
    for text in [ROOM.to_owned(), format!("{ROOM}{FOG}")] {
        for method in [Method::Pt, Method::Femc] {
            let is_foggy = text.len() > ROOM.len();
            let labels = lamps(&world(&text, &settings(Vec::new(), method)));
            let labels: Vec<&str> = labels.iter().map(String::as_str).collect();
            assert_eq!(labels, ["lamps.left/red", "lamps.right/blue"]);
            let presets = [Preset::Direct, Preset::Indirect, Preset::Lamps, Preset::Guides];
            let mut layers: Vec<Layer> =
                presets.iter().flat_map(|preset| preset.layers(labels.iter().copied()).unwrap()).collect();
            // Layers by the first event: the lamp itself, a lobe of a surface, the fog.
            let first = [
                ("seen", "CL"),
                ("diffuse", "C<RD>.*"),
                ("glossy", "C<RG>.*"),
                ("mirrored", "C<RS>.*"),
                ("through", "CT.*"),
                ("fog", "CV.*"),
            ];
            layers.extend(first.map(|(name, expression)| Layer::new(name, expression)));
            layers.push(Layer::new("on_ground", "C<..'ground'>.*"));
            layers.push(Layer::new("elsewhere", "C<..[^'ground']>.*"));
            let settings = settings(layers, method);
            let prepared = world(&text, &settings);
            let (image, layers) = rendered(&prepared, &settings).unwrap();
            assert_partition(&image, &layers, &["direct", "indirect"]);
            assert_partition(&image, &layers, &["lamp_lamps_left_red", "lamp_lamps_right_blue"]);
            assert_partition(&image, &layers, &["full"]);
            assert_partition(&image, &layers, &["on_ground", "elsewhere"]);
            let mut first: Vec<&str> = first.iter().map(|it| it.0).collect();
            if !is_foggy {
                assert_eq!(first.pop(), Some("fog"));
                assert!(layers.iter().any(|layer| layer.name == "fog" && sum(layer) == 0.0));
            }
            assert_partition(&image, &layers, &first);
        }
    }
}

/// Layers of split paths add up to the picture. Each has the light that the replayed samples found after as many events.
#[test]
fn layers_of_split_paths_have_the_events_of_their_branches() {
    const SPP: u32 = 8;
    let text = include_str!("../../../../scenes/door-ajar.mgf");
    let layers = [
        ("once", "C[RTV]?L"),
        ("twice", "C[RTV][RTV]L"),
        ("thrice", "C[RTV][RTV][RTV]L"),
        ("more", "C[RTV][RTV][RTV][RTV]+L"),
        ("glossy", "C.*<RG>.*L"),
        ("matte", "C<RD>*L"),
    ];
    let layers = layers.map(|(name, expression)| Layer::new(name, expression)).into();
    let settings = Settings { size: Some([16, 12]), ..settings(layers, Method::Femc) };
    let prepared = world(text, &settings);
    let (image, layers) = rendered(&prepared, &settings).unwrap();
    assert_partition(&image, &layers, &["glossy", "matte"]);
    let mut replay = Replay::new(&prepared, &settings);
    let mut branches = 0;
    for pixel in 0..16 * 12 {
        let mut expected = [0.0; 4];
        for sample in 0..SPP {
            let (_, recording) = replay.sample((pixel % 16, pixel / 16), sample);
            for (found, vertex) in &recording.contributions {
                let events = recording.steps.branch(*vertex).count();
                expected[events.clamp(1, 4) - 1] += f64::from(found.color.y) / f64::from(SPP);
            }
            branches += recording.steps.nodes().iter().filter(|node| node.repeats > 0).count();
        }
        for (layer, expected) in layers.iter().zip(expected) {
            let light = f64::from(layer.color[pixel as usize][1]);
            assert!((light - expected).abs() <= 1e-4 * expected + 1e-7, "{} {pixel}: {light} {expected}", layer.name);
        }
    }
    assert!(branches > 100, "{branches} branches");
}

#[test]
fn unknown_labels_are_refused_before_rendering() {
    let scene = scene(ROOM);
    let outcome = |label: &str| {
        let layers = vec![Layer::new("one", format!("C.*<L.'{label}'>"))];
        plan_job(&scene, &settings(layers, Method::Pt), None).map(drop).map_err(|e| e.to_string())
    };
    for known in ["lamps", "lamps.left", "red", "lamps.left/red", "mirror", "ball"] {
        assert_eq!(outcome(known), Ok(()), "{known}");
    }
    for unknown in ["lamp", "lamps.", "left", "lamps.left/green", "lamps/red/", "haze"] {
        let error = outcome(unknown).unwrap_err();
        assert!(error.starts_with(&format!("layer `one`: unknown label `{unknown}`")), "{error}");
    }
    let layers = vec![Layer::new("one", "CL")];
    assert!(plan_job(&scene, &settings(layers, Method::Fem), None).is_err_and(|e| e.to_string().contains("`femc`")));
}

/// A box of gas that emits light, a wall behind it, and a lamp that the camera does not see.
const GAS: &str = "\
camera main =
	origin .5 -9 .5
	target .5 0 .5
	fov 1
	film 4 4
medium gas =
	sigma_a 2
	glow 40
mbox gas 0 0 0 1 1 1
m wall =
	c
	rd .5
v a =
	p -4 2 -4
v b =
	p 4 2 -4
v c =
	p 4 2 4
v d =
	p -4 2 4
m wall
f a b c d
m lamp =
	sides 1
	ed 50
v l =
	p .5 0 4
m lamp
o lamp
sph l .3
o
";

#[test]
fn light_of_a_medium_that_glows_is_that_of_an_object() {
    let own = [
        ("glow", "C.*O"),
        ("lamps", "C.*L"),
        ("seen", "CO"),
        ("named", "C<O.'gas'>"),
        ("others", "C<O.[^'gas']>"),
        ("lit_by_gas", "C<RD>O"),
        ("lit_by_lamp", "C<RD>L"),
    ];
    let mut layers: Vec<Layer> = own.map(|(name, expression)| Layer::new(name, expression)).to_vec();
    let labels = lamps(&world(GAS, &settings(Vec::new(), Method::Pt)));
    assert_eq!(labels, ["gas", "lamp/lamp"]);
    layers.extend(Preset::Lamps.layers(labels.iter().map(String::as_str)).unwrap());
    let settings = settings(layers, Method::Pt);
    let (image, layers) = rendered(&world(GAS, &settings), &settings).unwrap();
    let layer = |name: &str| layers.iter().find(|layer| layer.name == name).unwrap();
    // Light emitted and not absorbed by a meter of gas: emission over extinction, times 1 - exp(-optical thickness).
    let seen = 40.0 / (4.0 * std::f32::consts::PI * 2.0) * (1.0 - femc_math::elementary::exp(-2.0));
    for color in layer("seen").color.as_flattened() {
        assert!((color / seen - 1.0).abs() < 1e-3, "{color}, not {seen}");
    }
    assert_eq!(layer("named").color, layer("seen").color);
    assert_eq!(sum(layer("others")), 0.0);
    // Both light the wall through the gas.
    assert_partition(&image, &layers, &["glow", "lamps"]);
    assert_partition(&image, &layers, &["seen", "lit_by_gas", "lit_by_lamp"]);
    assert_partition(&image, &layers, &["lamp_gas", "lamp_lamp_lamp"]);
}
