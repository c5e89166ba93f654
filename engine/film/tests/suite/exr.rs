//! Tests of OpenEXR files: the written content matches the command line's documentation, and bad files give errors.

use exr::prelude::*;
use femc_film::{
    BadKind, BadSample, BadSamples, BlockError, FilmError, FrameError, FrameImage, Image, Provenance, Rect,
    exr as film_exr, pixel_digest,
};
use std::io::Cursor;

fn frame(width: u32, height: u32) -> FrameImage {
    let count = (width * height) as usize;
    let ramp = |k: f32| (0..count).map(|i| [i as f32 * k, 0.5, 1.0 / (1.0 + i as f32)]).collect::<Vec<_>>();
    FrameImage {
        color: Image { width, height, pixels: ramp(3.7) },
        variance: ramp(0.01),
        luminance_variance: (0..count).map(|i| i as f32 * 0.5).collect(),
        albedo: ramp(0.001),
        depth: (0..count).map(|i| i as f32 + 0.25).collect(),
        samples: (0..count).map(|i| 16 + i as u32).collect(),
    }
}

fn provenance() -> Provenance {
    Provenance {
        allocation: Some(r#"{"begin":4,"ends":[9]}"#.into()),
        version: "0.1.0".into(),
        engine: "0.1.0-7".into(),
        settings: r#"{"spp":16}"#.into(),
        bias: Some("fem".into()),
        scene: "00ff".into(),
        frame: 7,
        seconds: 1.25,
        spp: 16.5,
        error: FrameError {
            worst: 0.03125,
            mean: 0.015625,
            unlit: 1,
            floor: 0.25,
            blocks: vec![
                BlockError { rect: Rect { x: 0, y: 0, width: 4, height: 16 }, relative: Some(0.03125) },
                BlockError { rect: Rect { x: 4, y: 0, width: 1, height: 16 }, relative: None },
            ],
        },
        bad: BadSamples {
            counts: [2, 0, 1, 0],
            first: Some(BadSample { y: 4, x: 3, sample: 9, kind: BadKind::NotANumber }),
        },
    }
}

#[test]
fn colors_and_attributes_survive_the_file() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.exr");
    let image = frame(33, 21);
    film_exr::write(&path, &image, &provenance()).unwrap();
    let back = film_exr::read(&path).unwrap();
    assert_eq!(back.image, image.color);
    assert_eq!(pixel_digest(&back.image), pixel_digest(&image.color));
    let expected = [
        ("femc:bad_samples", "nan=2 infinite=0 negative=1 out-of-range=0 first=3,4,9"),
        ("femc:frame", "7"),
        ("femc:relative_error", "0.03125"),
        ("femc:relative_error_mean", "0.015625"),
        ("femc:relative_error_floor", "0.25"),
        ("femc:unlit_blocks", "1"),
        ("femc:scene", "00ff"),
        ("femc:seconds", "1.25"),
        ("femc:settings", r#"{"spp":16}"#),
        ("femc:spp", "16.5"),
        ("femc:version", "0.1.0"),
        ("femc:engine", "0.1.0-7"),
    ];
    for (name, value) in expected {
        assert_eq!(back.attributes[name], value);
    }
    assert_eq!(film_exr::read_attributes(&path).unwrap(), back.attributes);
}

#[test]
fn the_file_has_the_promised_form() {
    let image = frame(5, 40);
    let bytes = film_exr::encode(&image, &provenance()).unwrap();
    let file = read().no_deep_data().largest_resolution_level().all_channels().all_layers().all_attributes();
    let file = file.from_buffered(Cursor::new(&bytes)).unwrap();
    assert_eq!(file.layer_data.len(), 1);
    let layer = &file.layer_data[0];
    assert_eq!((layer.encoding.compression, layer.encoding.blocks), (Compression::ZIP16, Blocks::ScanLines));
    assert_eq!(layer.attributes.white_luminance, Some(1.0));
    assert_eq!(file.attributes.chromaticities.unwrap().white, Vec2(0.3127, 0.3290));
    let names: Vec<String> = layer.channel_data.list.iter().map(|c| c.name.to_string()).collect();
    let promised = "B G R albedo.B albedo.G albedo.R depth.Z relative_error.Y samples.Y variance.B variance.G variance.R variance.Y";
    assert_eq!(names.join(" "), promised);
    let channel = |name: &str| layer.channel_data.list.iter().find(|c| c.name.eq(name)).unwrap().sample_data.clone();
    assert_eq!(channel("samples.Y"), FlatSamples::U32(image.samples.clone()));
    assert_eq!(channel("depth.Z"), FlatSamples::F32(image.depth.clone()));
    assert_eq!(channel("variance.G"), FlatSamples::F32(image.variance.iter().map(|p| p[1]).collect()));
    assert_eq!(channel("variance.Y"), FlatSamples::F32(image.luminance_variance.clone()));
    let FlatSamples::F32(errors) = channel("relative_error.Y") else { panic!("floats") };
    assert_eq!((&errors[..5], errors[16 * 5 + 1]), (&[0.03125, 0.03125, 0.03125, 0.03125, film_exr::UNLIT][..], -1.0));
    assert_eq!(channel("albedo.R"), FlatSamples::F32(image.albedo.iter().map(|p| p[0]).collect()));
}

#[test]
fn the_same_image_gives_the_same_bytes() {
    let image = frame(64, 64);
    let first = film_exr::encode(&image, &provenance()).unwrap();
    for _ in 0..8 {
        assert!(film_exr::encode(&image, &provenance()).unwrap() == first);
    }
}

#[test]
fn a_large_image_has_the_same_bytes_for_any_number_of_threads() {
    let image = frame(512, 512);
    let [one, two] = [1, 2].map(|threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| film_exr::encode(&image, &provenance()).unwrap())
    });
    assert!(one == two);
    assert!(film_exr::decode(Cursor::new(one)).unwrap().image == image.color);
}

#[test]
fn long_settings_in_any_script_survive() {
    let settings = format!(r#"{{"camera":"Kreisel-Süd 環状", "set":"{}"}}"#, "x".repeat(5000));
    let bytes = film_exr::encode(&frame(2, 2), &Provenance { settings: settings.clone(), ..provenance() }).unwrap();
    assert_eq!(film_exr::decode(Cursor::new(bytes)).unwrap().attributes["femc:settings"], settings);
}

#[test]
fn half_floats_and_every_lossless_compression_are_read() {
    let (width, height) = (37, 29);
    let value = |at: Vec2<usize>| (at.x() as f32 * 0.25, at.y() as f32, 2.0f32);
    for compression in
        [Compression::Uncompressed, Compression::RLE, Compression::ZIP1, Compression::ZIP16, Compression::PIZ]
    {
        for blocks in [Blocks::ScanLines, Blocks::Tiles(Vec2(16, 16))] {
            let channels = SpecificChannels::rgb(move |at: Vec2<usize>| {
                let (r, g, b) = value(at);
                (f16::from_f32(r), f16::from_f32(g), b)
            });
            let encoding = Encoding { compression, blocks, line_order: LineOrder::Increasing };
            let layer = Layer::new((width, height), LayerAttributes::default(), encoding, channels);
            let mut bytes = Cursor::new(Vec::new());
            exr::prelude::Image::from_layer(layer).write().to_buffered(&mut bytes).unwrap();
            let image = film_exr::decode(bytes).unwrap().image;
            assert_eq!((image.width, image.height), (width as u32, height as u32));
            for (i, pixel) in image.pixels.iter().enumerate() {
                let (r, g, b) = value(Vec2(i % width, i / width));
                assert_eq!(*pixel, [r, g, b], "{compression:?} {blocks:?} pixel {i}");
            }
        }
    }
}

#[test]
fn a_file_without_colors_names_its_channels() {
    let channels = AnyChannels::sort([AnyChannel::new("Y", FlatSamples::F32(vec![0.0; 4]))].into_iter().collect());
    let mut bytes = Cursor::new(Vec::new());
    exr::prelude::Image::from_channels((2, 2), channels).write().to_buffered(&mut bytes).unwrap();
    match film_exr::decode(bytes) {
        Err(FilmError::NoColors { found }) => assert_eq!(found, "Y"),
        other => panic!("{other:?}"),
    }
}

#[test]
fn absurd_sizes_are_refused_from_the_header() {
    let bytes = film_exr::encode(&frame(4, 4), &provenance()).unwrap();
    // The data window is four integers after its name, type and size; give it 2^30 columns and rows.
    let name = b"dataWindow\0box2i\0";
    let at = bytes.windows(name.len()).position(|w| w == name).unwrap() + name.len() + 4;
    let mut forged = bytes.clone();
    for offset in [8, 12] {
        forged[at + offset..at + offset + 4].copy_from_slice(&(1i32 << 30).to_le_bytes());
    }
    let error = film_exr::decode(Cursor::new(forged)).unwrap_err();
    assert!(matches!(error, FilmError::Size { .. } | FilmError::Format { .. }), "{error}");
}

#[test]
fn cut_and_damaged_files_give_errors_or_pixels_but_never_panic() {
    let bytes = film_exr::encode(&frame(9, 20), &provenance()).unwrap();
    for cut in (0..bytes.len()).step_by(7) {
        assert!(film_exr::decode(Cursor::new(bytes[..cut].to_vec())).is_err(), "cut at {cut}");
    }
    for at in 0..bytes.len() {
        let mut damaged = bytes.clone();
        damaged[at] ^= 0x55;
        if let Ok(file) = film_exr::decode(Cursor::new(damaged)) {
            assert_eq!(file.image.pixels.len(), file.image.width as usize * file.image.height as usize);
        }
    }
}

#[test]
fn a_missing_file_is_named() {
    let error = film_exr::read(std::path::Path::new("no/such.exr")).unwrap_err();
    assert!(error.to_string().starts_with("no/such.exr: "), "{error}");
}

/// Checks whether a file declares names of more than 31 bytes: bit 10 of the second word.
fn declares_long_names(file: &[u8]) -> bool {
    u32::from_le_bytes(file[4..8].try_into().unwrap()) & 0x400 != 0
}

#[test]
fn long_name_flag_is_set_exactly_when_a_channel_name_is_long() {
    let values = [1.0, 2.0];
    let file = |name: &str| {
        let channel = film_exr::NamedChannel { name, values: &values, precision: film_exr::Precision::Float };
        film_exr::encode_named_channels([2, 1], &[channel], &std::collections::BTreeMap::new())
    };
    for length in 1..=255 {
        let name = "n".repeat(length);
        let bytes = file(&name).unwrap();
        assert_eq!(declares_long_names(&bytes), length > 31, "{length} bytes");
        assert_eq!(bytes[4], 2, "the version");
        let (_, _, [back]) = film_exr::decode_channels(Cursor::new(&bytes), [name.as_str()]).unwrap();
        assert_eq!(back, values, "{length} bytes");
    }
    let error = file(&"n".repeat(256)).unwrap_err().to_string();
    assert!(error.contains("has 256 bytes") && error.contains("255"), "{error}");
    // The longest layer name is 64 bytes, and its variance has 11 more.
    for (name, is_long) in [("a".repeat(20), false), ("a".repeat(21), true), ("a".repeat(64), true)] {
        let image = frame(4, 4);
        let layer = femc_film::LayerImage { name, color: image.albedo.clone(), variance: image.variance.clone() };
        let bytes = film_exr::encode_layers(&image, &[layer], &[], &[], &provenance()).unwrap();
        assert_eq!(declares_long_names(&bytes), is_long);
    }
}
