//! Tests that each EXR attribute that affects the values is used or named by a remark.

use super::*;
use exr_prelude::{
    AnyChannel, AnyChannels, Encoding, FlatSamples, ImageAttributes, IntegerBounds, Layer, LayerAttributes, SmallVec,
    Text, Vec2, WritableImage,
};

const SIZE: (usize, usize) = (3, 2);

type AnyLayer = Layer<AnyChannels<FlatSamples>>;

/// Returns a layer of 3 x 2 pixels whose channels have these values everywhere, and 10 times as much in the last pixel.
fn layer(channels: &[(&str, f32)], attributes: LayerAttributes) -> AnyLayer {
    let list: SmallVec<[AnyChannel<FlatSamples>; 4]> = channels
        .iter()
        .map(|&(name, value)| {
            let mut values = vec![value; SIZE.0 * SIZE.1];
            values[5] *= 10.0;
            AnyChannel::new(name, FlatSamples::F32(values))
        })
        .collect();
    Layer::new(SIZE, attributes, Encoding::UNCOMPRESSED, AnyChannels::sort(list))
}

fn file(layers: Vec<AnyLayer>, attributes: ImageAttributes) -> Vec<u8> {
    let mut bytes = Cursor::new(Vec::new());
    let image = exr_prelude::Image::from_layers(attributes, SmallVec::from_vec(layers));
    image.write().non_parallel().to_buffered(&mut bytes).unwrap();
    bytes.into_inner()
}

fn display() -> ImageAttributes {
    ImageAttributes::new(IntegerBounds::from_dimensions(SIZE))
}

/// Returns a file of one part with these channels.
fn plain(channels: &[(&str, f32)]) -> Vec<u8> {
    file(vec![layer(channels, LayerAttributes::default())], display())
}

/// Returns the first pixel and the remarks, or the error.
fn read(bytes: &[u8], role: Role) -> Result<([f32; 3], Vec<String>), String> {
    let decoded = decode("t.exr", bytes, role, 0).map_err(|fault| fault.to_string())?;
    Ok((decoded.image.pixels[0], decoded.remarks))
}

/// Channels with their values; the expected pixel or error; the expected remark.
type Row<'r> = (&'r [(&'r str, f32)], Result<[f32; 3], &'r str>, &'r str);

#[test]
fn channels_are_found_by_their_names_or_the_error_lists_them() {
    let rgb = [0.25, 0.5, 0.75];
    let rows: &[Row<'_>] = &[
        (&[("R", 0.25), ("G", 0.5), ("B", 0.75)], Ok(rgb), ""),
        (&[(".R", 0.25), (".G", 0.5), (".B", 0.75)], Ok(rgb), ""),
        (&[("r", 0.25), ("g", 0.5), ("b", 0.75)], Ok(rgb), ""),
        (&[("Y", 0.25)], Ok([0.25; 3]), ""),
        (&[(".Y", 0.25)], Ok([0.25; 3]), ""),
        (&[("Y", 0.25), ("A", 1.0)], Err("no last pixel"), ""),
        (&[("Y", 0.25), ("Z", 3.0)], Ok([0.25; 3]), "channels that are not used: `Z`"),
        (&[("diffuse.R", 0.25), ("diffuse.G", 0.5), ("diffuse.B", 0.75)], Ok(rgb), "read: `diffuse`"),
        (&[("a.b.R", 0.25), ("a.b.G", 0.5), ("a.b.B", 0.75)], Ok(rgb), "read: `a.b`"),
        (
            &[("R", 0.25), ("G", 0.5), ("B", 0.75), ("n.R", 9.0), ("n.G", 9.0), ("n.B", 9.0)],
            Ok(rgb),
            "not used: `n.B`, `n.G`, `n.R`",
        ),
        (
            &[("a.R", 1.0), ("a.G", 1.0), ("a.B", 1.0), ("b.R", 2.0), ("b.G", 2.0), ("b.B", 2.0)],
            Err("channels `a.B`, `a.G`, `a.R`, `b.B`, `b.G`, `b.R`; expected R G B"),
            "",
        ),
        (&[("R", 1.0), ("G", 1.0)], Err("channels `G`, `R`; expected R G B, or Y for gray"), ""),
        (&[("X", 1.0), ("Y", 1.0), ("Z", 1.0)], Err("channels `X`, `Y`, `Z`; expected"), ""),
        (&[("BY", 1.0), ("RY", 1.0), ("Y", 1.0)], Err("channels `BY`, `RY`, `Y`; expected"), ""),
        (&[("Z", 1.0)], Err("channels `Z`; expected"), ""),
    ];
    for (channels, wanted, remark) in rows {
        match (read(&plain(channels), Role::Color), wanted) {
            (Ok((pixel, remarks)), Ok(wanted)) => {
                assert_eq!(pixel, *wanted, "{channels:?}");
                match *remark {
                    "" => assert!(remarks.is_empty(), "{channels:?}: {remarks:?}"),
                    remark => assert!(remarks.len() == 1 && remarks[0].contains(remark), "{channels:?}: {remarks:?}"),
                }
            }
            // The last pixel of `A` is 10.
            (Ok((pixel, remarks)), Err("no last pixel")) => {
                assert!(pixel == [0.25; 3] && remarks[0].contains("alpha is not used"), "{remarks:?}");
            }
            (Err(error), Err(wanted)) => assert!(error.contains(wanted), "{channels:?}: {error}"),
            (got, _) => panic!("{channels:?}: {got:?}"),
        }
    }
    let error = read(&plain(&[("Y", 1.0)]), Role::Normals).unwrap_err();
    assert!(error.contains("channels `Y`; expected R G B, without"), "{error}");
}

#[test]
fn the_picture_is_the_display_window() {
    let at = |x: i32, y: i32| LayerAttributes::default().with_position(Vec2(x, y));
    let shown = |position: (i32, i32), start: (i32, i32), size: (usize, usize)| {
        let attributes = ImageAttributes::new(IntegerBounds::new(start, size));
        let channels = [("R", 1.0), ("G", 1.0), ("B", 1.0)];
        let bytes = file(vec![layer(&channels, at(position.0, position.1))], attributes);
        let decoded = decode("t.exr", &bytes, Role::Color, 0).unwrap();
        let values: Vec<f32> = decoded.image.pixels.iter().map(|pixel| pixel[0]).collect();
        ((decoded.image.width, decoded.image.height), values, decoded.remarks)
    };
    // Equal windows that do not start at 0.
    let (size, values, remarks) = shown((5, -7), (5, -7), SIZE);
    assert_eq!((size, values, remarks.len()), ((3, 2), vec![1.0, 1.0, 1.0, 1.0, 1.0, 10.0], 0));
    // Cropped: the rest of the picture is black.
    let (size, values, remarks) = shown((1, 1), (0, 0), (5, 3));
    let black = vec![0.0; 5];
    let wanted = [black, vec![0.0, 1.0, 1.0, 1.0, 0.0], vec![0.0, 1.0, 1.0, 10.0, 0.0]].concat();
    assert_eq!((size, values, remarks.len()), ((5, 3), wanted, 0));
    // Overscan: data outside the picture is cut off.
    let (size, values, _) = shown((-1, -1), (0, 0), (2, 1));
    assert_eq!((size, values), ((2, 1), vec![1.0, 10.0]));
    // Disjoint windows.
    let (_, values, remarks) = shown((100, 0), (0, 0), (2, 2));
    assert!(values == [0.0; 4] && remarks[0].contains("outside the display window"), "{remarks:?}");
    let attributes = ImageAttributes::new(IntegerBounds::new((0, 0), (40_000, 2)));
    let bytes = file(vec![layer(&[("Y", 1.0)], LayerAttributes::default())], attributes);
    assert!(read(&bytes, Role::Color).unwrap_err().contains("40000 x 2"));
    let attributes = ImageAttributes::new(IntegerBounds::new((0, 0), (32_768, 32_768)));
    let bytes = file(vec![layer(&[("Y", 1.0)], LayerAttributes::default())], attributes);
    assert!(read(&bytes, Role::Color).unwrap_err().contains("has data in less than 1/64 of its area"));
}

#[test]
fn attributes_that_are_not_used_are_named() {
    let rgb = [("R", 0.5), ("G", 0.5), ("B", 0.5)];
    let said = |own: LayerAttributes, shared: ImageAttributes, role| {
        read(&file(vec![layer(&rgb, own)], shared), role).unwrap().1
    };
    let own = LayerAttributes::default;
    let clamp = Some(Text::from("clamp"));
    for (own, remark) in [
        (LayerAttributes { white_luminance: Some(80.0), ..own() }, "whiteLuminance 80 is not used"),
        (LayerAttributes { wrap_mode_name: clamp, ..own() }, "wrap mode `clamp` is not used"),
        (LayerAttributes { view_name: Some(Text::from("left")), ..own() }, "several views"),
        (LayerAttributes { white_luminance: Some(1.0), ..own() }, ""),
        (LayerAttributes { wrap_mode_name: Some(Text::from("periodic")), ..own() }, ""),
        (LayerAttributes { software_name: Some(Text::from("x")), ..own() }, ""),
    ] {
        let remarks = said(own, display(), Role::Color);
        match remark {
            "" => assert!(remarks.is_empty(), "{remarks:?}"),
            remark => assert!(remarks.len() == 1 && remarks[0].contains(remark), "{remarks:?}"),
        }
    }
    let wide = ImageAttributes { pixel_aspect: 2.0, ..display() };
    assert!(said(own(), wide, Role::Color)[0].contains("pixelAspectRatio 2 is not used"));
}

#[test]
fn chromaticities_are_converted_to_rec_709() {
    use ::exr::meta::attribute::Chromaticities;
    let with_primaries = |[r, g, b, white]: [(f32, f32); 4]| {
        let at = |(x, y)| Vec2(x, y);
        let chromaticities = Chromaticities { red: at(r), green: at(g), blue: at(b), white: at(white) };
        ImageAttributes { chromaticities: Some(chromaticities), ..display() }
    };
    let rec709 = [(0.64, 0.33), (0.30, 0.60), (0.15, 0.06), (0.3127, 0.3290)];
    let rec2020 = [(0.708, 0.292), (0.170, 0.797), (0.131, 0.046), (0.3127, 0.3290)];
    let rgb = [("R", 0.25), ("G", 0.5), ("B", 0.5)];
    let bytes = |shared| file(vec![layer(&rgb, LayerAttributes::default())], shared);
    assert_eq!(read(&bytes(with_primaries(rec709)), Role::Color), Ok(([0.25, 0.5, 0.5], vec![])));
    let (converted, remarks) = read(&bytes(with_primaries(rec2020)), Role::Color).unwrap();
    let matrix = [[1.6605, -0.5876, -0.0728], [-0.1246, 1.1329, -0.0083], [-0.0182, -0.1006, 1.1187]];
    for (value, row) in converted.iter().zip(matrix) {
        let wanted: f64 = row[0] * 0.25 + row[1] * 0.5 + row[2] * 0.5;
        assert!((f64::from(*value) - wanted.max(0.0)).abs() < 1e-3, "{converted:?}");
    }
    assert!(remarks.is_empty(), "{remarks:?}");
    // Normal maps have no primaries, and collinear primaries span no color space.
    assert_eq!(read(&bytes(with_primaries(rec2020)), Role::Normals), Ok(([-0.5, 0.0, 0.0], vec![])));
    let (same, remarks) = read(&bytes(with_primaries([(0.3, 0.3); 4])), Role::Color).unwrap();
    assert!(same == [0.25, 0.5, 0.5] && remarks[0].contains("are degenerate"), "{remarks:?}");
}

#[test]
fn of_several_parts_the_one_that_is_read_is_named() {
    let part = |name: &str, channels: &[(&str, f32)]| layer(channels, LayerAttributes::named(name));
    let rgb = [("R", 0.25), ("G", 0.5), ("B", 0.75)];
    let parts = vec![part("depth", &[("Z", 1.0)]), part("beauty", &rgb), part("left", &rgb)];
    let (pixel, remarks) = read(&file(parts, display()), Role::Color).unwrap();
    assert_eq!(pixel, [0.25, 0.5, 0.75]);
    assert_eq!(remarks, ["the file has 3 parts: only one is read, `beauty`"]);
}

#[test]
fn deep_data_and_subsampled_channels_are_refused_by_their_names() {
    let mut deep = plain(&[("Y", 1.0)]);
    deep[5] |= 0x08;
    assert!(read(&deep, Role::Color).unwrap_err().contains("deep data"));
    // RY has one value per 2 x 2 pixels.
    let mut chroma = plain(&[("BY", 1.0), ("RY", 1.0), ("Y", 1.0)]);
    let start = chroma.windows(3).position(|three| three == b"RY\0").unwrap() + 3 + 8;
    chroma[start..start + 8].copy_from_slice(&[2, 0, 0, 0, 2, 0, 0, 0]);
    let error = read(&chroma, Role::Color).unwrap_err();
    assert!(error.contains("channels `BY`, `RY`, `Y` are subsampled"), "{error}");
}
