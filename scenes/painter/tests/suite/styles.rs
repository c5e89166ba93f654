//! Checks that this program makes the committed pictures from the committed guides, byte for byte.

use femc_painter::guides::LAYERS;
use femc_painter::{Guides, PainterError, RenderView, STYLES};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

fn shipped_path(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../styles").join(name)
}

fn painter(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_femc-painter")).args(arguments).output().expect("femc-painter runs")
}

/// Returns a gray ball-like slope of light of 24 x 16 pixels on a floor of another color.
fn small_guides() -> Guides {
    let (width, height) = (24u32, 16u32);
    let column = |at: u32| (at % width) as f32;
    let upper = |at: u32| at / width < 10;
    let plane = |value: &dyn Fn(u32) -> [f32; 3]| (0..width * height).map(value).collect::<Vec<_>>();
    let light = plane(&|at| [10.0 * column(at); 3]);
    let none = plane(&|_| [0.0; 3]);
    Guides {
        width,
        height,
        layers: [light.clone(), light.clone(), none.clone(), light, none],
        albedo: plane(&|at| if upper(at) { [0.5; 3] } else { [0.6, 0.3, 0.2] }),
        depth: (0..width * height).map(|at| if upper(at) { 4.0 } else { 3.0 }).collect(),
    }
}

#[test]
fn shipped_pictures_equal_paintings_of_shipped_guides_exactly() {
    let folder = tempfile::tempdir().expect("a folder");
    let out = painter(&["paint", shipped_path("ball.layers.exr").to_str().unwrap(), folder.path().to_str().unwrap()]);
    assert!(out.status.success(), "{}", String::from_utf8_lossy(&out.stderr));
    for style in STYLES {
        let name = format!("{}.png", style.name);
        let (painted, kept) = (std::fs::read(folder.path().join(&name)), std::fs::read(shipped_path(&name)));
        let same = painted.expect("painted") == kept.expect("shipped");
        assert!(same, "scenes/styles/{name} is not what the painter makes: paint it again, look at it and commit it");
    }
}

#[test]
fn each_style_paints_small_render_at_its_size_and_differently() {
    let view = RenderView::from_guides(&small_guides()).unwrap();
    let pictures = STYLES.map(|style| (style.paint)(&view));
    for (style, picture) in STYLES.iter().zip(&pictures) {
        assert_eq!((picture.width, picture.height), (24, 16), "{}", style.name);
        let [dark, light] = [0..6, 18..24].map(|columns: std::ops::Range<usize>| {
            let lumas = (0..16).flat_map(|row| columns.clone().map(move |column| row * 24 + column));
            lumas.map(|at| picture.pixels[at].iter().map(|&c| u32::from(c)).sum::<u32>()).sum::<u32>()
        });
        assert!(dark < light, "{}: what is dark is painted darker, {dark} and {light}", style.name);
    }
    for (a, one) in pictures.iter().enumerate() {
        assert!(pictures[..a].iter().all(|other| other != one), "{}", STYLES[a].name);
    }
}

#[test]
fn any_size_and_any_values_are_painted_without_a_panic() {
    let odd = [f32::NAN, f32::INFINITY, -1.0, 0.0, 1e30, 5.0];
    for (width, height) in [(1, 1), (1, 40), (37, 2), (9, 9)] {
        let color = |at: usize| [0, 1, 2].map(|i| odd[(at * 7 + i * at) % odd.len()]);
        let plane = || (0..width * height).map(color).collect::<Vec<_>>();
        let mut guides = Guides {
            width: width as u32,
            height: height as u32,
            layers: [plane(), plane(), plane(), plane(), plane()],
            albedo: plane(),
            depth: (0..width * height).map(|at| odd[at % odd.len()]).collect(),
        };
        guides.layers[1][0] = [8.0; 3];
        guides.albedo[0] = [0.5; 3];
        // The analysis may succeed or find no light.
        let Ok(view) = RenderView::from_guides(&guides) else { continue };
        for style in STYLES {
            let picture = (style.paint)(&view);
            assert_eq!((picture.pixels.len(), picture.width), (width * height, width as u32), "{}", style.name);
        }
    }
}

#[test]
fn guides_survive_their_file_within_half_precision() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("small.exr");
    std::fs::write(&path, small_guides().encode(&BTreeMap::new()).unwrap()).unwrap();
    let read = Guides::read(&path).unwrap();
    assert_eq!(read.depth, small_guides().depth);
    for ((name, a), b) in LAYERS.iter().zip(&read.layers).zip(&small_guides().layers) {
        let close = a.as_flattened().iter().zip(b.as_flattened()).all(|(a, b)| (a - b).abs() <= b.abs() / 2048.0);
        assert!(close, "{name}");
    }
}

#[test]
fn render_without_light_or_layers_is_refused() {
    let mut dark = small_guides();
    dark.layers[1].fill([0.0; 3]);
    assert!(matches!(RenderView::from_guides(&dark), Err(PainterError::Dark)));

    let folder = tempfile::tempdir().unwrap();
    let [plain, missing] = ["plain.exr", "missing.exr"].map(|name| folder.path().join(name).display().to_string());
    let image = femc_film::Image::filled(2, 2, [1.0; 3]);
    let channel = |i: usize| image.pixels.iter().map(|pixel| pixel[i]).collect::<Vec<f32>>();
    let values = [0, 1, 2].map(channel);
    let named = ["R", "G", "B"].into_iter().zip(&values).map(|(name, values)| femc_film::exr::NamedChannel {
        name,
        values,
        precision: femc_film::exr::Precision::Half,
    });
    let named: Vec<_> = named.collect();
    std::fs::write(&plain, femc_film::exr::encode_named_channels([2, 2], &named, &BTreeMap::new()).unwrap()).unwrap();
    let said = |arguments: &[&str]| {
        let out = painter(arguments);
        (out.status.code(), String::from_utf8_lossy(&out.stderr).into_owned())
    };
    let (code, message) = said(&["paint", &plain, &missing]);
    assert!(code == Some(1) && message.contains("plain.exr") && message.contains("full.R"), "{code:?} {message}");
    let (code, message) = said(&["guides", &missing, &plain]);
    assert!(code == Some(1) && message.contains("missing.layers.exr"), "{code:?} {message}");
    assert_eq!(said(&["draw"]).0, Some(2));
}
