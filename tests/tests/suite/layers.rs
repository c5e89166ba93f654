//! Compares layers of small rooms with path classes of another path tracer ([`femc_tests::brute`]).

use femc_film::tile::NONE_HELD;
use femc_film::{FrameImage, Image, LayerImage, LayerPiece, Rect, Tiling};
use femc_math::color::LUMINANCE_WEIGHTS;
use femc_pipeline::{
    Layer, LayerPlan, Method, Outputs, Preset, RenderTask, SceneSource, Settings, StopCondition, prepare_frame,
};
use femc_tests::brute::{BruteForceTracer, Scatterer};
use femc_tests::reference::{Comparison, Reference, rooms_folder};
use std::sync::Arc;

/// Probability of a false alarm in one comparison.
const LEVEL: f64 = 1e-4;
/// Side length of a block in pixels. A block is a quarter of the film.
const BLOCK: usize = 16;
/// Samples per pixel of each half of the reference.
const BRUTE_SPP: u32 = 2048;
const SPP: u32 = 128;

/// Returns the compared layers, in the order of [`render_classes`].
fn layers() -> Vec<Layer> {
    let mut layers = Preset::Guides.layers([]).unwrap();
    layers.extend(Preset::Fog.layers([]).unwrap());
    layers.push(Layer::new("glossy_first", "C<RG>.*"));
    layers
}

/// Returns for each layer whether it contains this path.
fn classes(path: &[Scatterer]) -> [bool; 7] {
    use Scatterer::{Diffuse, Fog, Glossy};
    [
        true,
        *path == [Diffuse],
        *path == [Glossy],
        *path == [Diffuse] || *path == [Diffuse, Diffuse],
        path.starts_with(&[Diffuse, Diffuse]),
        path.contains(&Fog),
        path.first() == Some(&Glossy),
    ]
}

/// Converts a layer to an image. Its luminance variance is an upper bound: it assumes fully correlated channels.
fn image(layer: LayerImage, [width, height]: [u32; 2]) -> FrameImage {
    let weights = LUMINANCE_WEIGHTS.to_array();
    let luminance = |v: &[f32; 3]| v.iter().zip(weights).map(|(v, w)| w * v.sqrt()).sum::<f32>().powi(2);
    let count = layer.color.len();
    FrameImage {
        luminance_variance: layer.variance.iter().map(luminance).collect(),
        color: Image { width, height, pixels: layer.color },
        variance: layer.variance,
        albedo: vec![[0.0; 3]; count],
        depth: vec![0.0; count],
        samples: vec![SPP; count],
    }
}

/// Returns the mean luminance, cd/m2.
fn mean(image: &FrameImage) -> f32 {
    let count = image.samples.len();
    (0..count).map(|at| image.color.luminance(at)).sum::<f32>() / count as f32
}

fn render_layers(name: &str, method: Method) -> Vec<FrameImage> {
    let scene = femc_import::load_scene_file(&rooms_folder().join(format!("{name}.mgf")))
        .unwrap_or_else(|e| panic!("{e}"))
        .scene;
    let settings =
        Settings { stop: StopCondition::Spp(SPP), seed: 12, method, layers: layers(), ..Settings::default() };
    let prepared = prepare_frame(&SceneSource::new(Arc::new(scene)), &settings, 1, None).unwrap();
    let film @ [width, height] = prepared.camera.film;
    let plan = LayerPlan::new(&prepared, &settings).unwrap();
    let rect = Rect { x: 0, y: 0, width, height };
    let task = RenderTask::new(&prepared, &settings, rect, 0..SPP);
    let rendered = task.render(Outputs { layers: Some(&plan), ..Outputs::default() }).unwrap();
    let tile = rendered.aovs.light.unwrap();
    let mut piece = LayerPiece::new(Tiling::new(width, height, 64).unwrap(), 0);
    piece.put(&tile, NONE_HELD).unwrap();
    let mut images = LayerImage::black(settings.layers.iter().map(|layer| layer.name.clone()), width, height);
    LayerImage::put(&mut images, &piece).unwrap();
    images.into_iter().map(|layer| image(layer, film)).collect()
}

/// Renders the references of a room, one per class.
fn references(name: &str) -> Vec<Reference> {
    let scene = femc_import::load_scene_file(&rooms_folder().join(format!("{name}.mgf")))
        .unwrap_or_else(|e| panic!("{e}"))
        .scene;
    let brute = BruteForceTracer::new(&scene);
    let [a, b] = [5, 6].map(|seed| brute.render_classes(seed, BRUTE_SPP, classes));
    a.into_iter().zip(b).map(|(a, b)| Reference::new([a, b])).collect()
}

/// Checks that every layer agrees with the class of its expression, and with no other class.
fn check(name: &str, dark: &[&str]) {
    let (names, references) = (layers(), references(name));
    for method in [Method::Pt, Method::Femc] {
        let images = render_layers(name, method);
        for (number, (layer, image)) in names.iter().zip(&images).enumerate() {
            let compared: Comparison = references[number].compare(image, BLOCK);
            println!("{name} {method:?} {}: {compared:?}", layer.name);
            if dark.contains(&layer.name.as_str()) {
                assert_eq!(mean(image), 0.0, "{name}: {} has light", layer.name);
                continue;
            }
            assert!(mean(image) > 0.0, "{name}: {} has no light", layer.name);
            assert!(compared.agrees(LEVEL), "{name} {method:?}: {} is not what brute force says", layer.name);
            let others = (0..images.len()).filter(|other| *other != number);
            for other in others.filter(|other| !dark.contains(&names[*other].name.as_str())) {
                let is_other = references[other].compare(image, BLOCK).agrees(LEVEL);
                assert!(!is_other, "{name}: nobody tells {} from {}", layer.name, names[other].name);
            }
        }
    }
}

#[test]
fn layers_of_rough_mirror_room_are_brute_force_path_classes() {
    check("glossy", &["fog"]);
}

#[test]
fn layers_of_fog_room_are_brute_force_path_classes() {
    check("fog", &["direct_specular", "glossy_first"]);
}
