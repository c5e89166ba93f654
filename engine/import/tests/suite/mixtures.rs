//! Tests of color mixtures: they are mixed by luminance, before any clipping to Rec.709.

use crate::common::try_scene;
use femc_import::{LoadedScene, WarningKind};
use proptest::prelude::*;

/// Returns the color of `rd` with the last color of `text`, and the lines of the warnings.
fn used_color(text: &str) -> ([f64; 3], Vec<u32>) {
    let LoadedScene { scene, warnings, .. } = try_scene(&format!("{text}m a =\nrd .01\nv a =\nsph a 1\n")).unwrap();
    assert!(warnings.iter().all(|warning| warning.kind == WarningKind::OutOfGamut), "{warnings:?}");
    (scene.materials[0].rd.color, warnings.iter().map(|warning| warning.at.line).collect())
}

/// Cone responses of Bradford's transform from XYZ, and back (Lindbloom's digits).
const BRADFORD: [[f64; 3]; 3] = [[0.8951, 0.2664, -0.1614], [-0.7502, 1.7135, 0.0367], [0.0389, -0.0685, 1.0296]];
const BRADFORD_INVERSE: [[f64; 3]; 3] =
    [[0.9869929, -0.1470543, 0.1599627], [0.4323053, 0.5183603, 0.0492912], [-0.0085287, 0.0400428, 0.9684867]];

fn times(matrix: [[f64; 3]; 3], v: [f64; 3]) -> [f64; 3] {
    matrix.map(|row| row[0] * v[0] + row[1] * v[1] + row[2] * v[2])
}

/// Returns the chromaticity of a mixture by luminances in the color space of the scene. The white of the format (equal energy) is
/// adapted to the scene's white (D65).
fn mix_chromaticities(parts: &[(f64, [f64; 2])]) -> [f64; 2] {
    let xyz = |[x, y]: [f64; 2]| [x / y, 1.0, (1.0 - x - y) / y];
    let (from, to) = (times(BRADFORD, [1.0; 3]), times(BRADFORD, xyz([0.3127, 0.3290])));
    let gain = [0, 1, 2].map(|k| to[k] / from[k]);
    let mut cones = [0.0; 3];
    for &(luminance, xy) in parts {
        let response = times(BRADFORD, xyz(xy));
        let adapted = [0, 1, 2].map(|k| response[k] * gain[k]);
        let [_, y, _] = times(BRADFORD_INVERSE, adapted);
        cones.iter_mut().zip(adapted).for_each(|(sum, value)| *sum += luminance / y * value);
    }
    let [x, y, z] = times(BRADFORD_INVERSE, [0, 1, 2].map(|k| cones[k] / gain[k]));
    [x / (x + y + z), y / (x + y + z)]
}

fn close(a: [f64; 3], b: [f64; 3], tolerance: f64) -> bool {
    a.iter().zip(b).all(|(a, b)| (a - b).abs() <= tolerance * b.abs().max(1.0))
}

#[test]
fn outside_colors_mix_inside_rec_709_without_loss_or_warning() {
    // Spectral colors of 500 nm and 600 nm, and a violet on the line of purples.
    let (green, orange, violet) = ([0.0082, 0.5384], [0.6270, 0.3725], [0.25, 0.05]);
    let [x, y] = mix_chromaticities(&[(3.0, green), (4.0, orange), (0.8, violet)]);
    let define = |name: &str, [x, y]: [f64; 2]| format!("c {name} =\ncxy {x} {y}\n");
    let parts = [define("green", green), define("orange", orange), define("violet", violet)].concat();
    let (direct, no_warning) = used_color(&format!("c\ncxy {x} {y}\n"));
    assert!(no_warning.is_empty() && direct.iter().all(|&c| c > 0.05), "inside Rec.709: {direct:?}");
    let (color, warnings) = used_color(&format!("{parts}c\ncmix 3 green 4 orange .8 violet\n"));
    assert!(close(color, direct, 1e-4) && warnings.is_empty(), "{color:?}, {direct:?}, {warnings:?}");
    // Nested, and through a template.
    let nested = format!("{parts}c two =\ncmix 3 green 4 orange\nc all = two\ncmix 7 two .8 violet\nc last = all\n");
    let (color, warnings) = used_color(&nested);
    assert!(close(color, direct, 1e-4) && warnings.is_empty(), "{color:?}, {direct:?}, {warnings:?}");
}

#[test]
fn clipped_color_warns_once_and_only_if_used() {
    let spectral = "c green =\ncxy .0082 .5384\nc paint = green\n";
    let text = format!("{spectral}m a =\nrd .1\nrs .1 0\nm b =\nc green\ned 5\nc\nm b =\nrd .2\nv a =\nsph a 1\n");
    let warnings = try_scene(&text).unwrap().warnings;
    assert_eq!(warnings.iter().map(|warning| warning.at.line).collect::<Vec<_>>(), [2]);
    assert!(try_scene(spectral).unwrap().warnings.is_empty());
    // A mixture that is itself outside Rec.709 warns at its own line.
    let (_, lines) = used_color("c green =\ncxy .0082 .5384\nc mix =\ncmix 1 green 1 green\n");
    assert_eq!(lines, [4]);
}

#[test]
fn colors_within_rec_709_mix_to_the_bits_of_clipped_values() {
    let unit = |rgb: [f64; 3]| {
        let weights = femc_math::color::LUMINANCE_WEIGHTS.to_array().map(f64::from);
        let luminance =
            (rgb[0] * weights[0] + rgb[1] * weights[1] + rgb[2] * weights[2]) / (weights[0] + weights[1] + weights[2]);
        rgb.map(|x| x / luminance)
    };
    let (a, _) = used_color("c a =\ncct 2700\n");
    let (b, _) = used_color("c b =\ncxy .3 .4\n");
    let (a, b) = (unit(a), unit(b));
    let (mix, _) = used_color("c a =\ncct 2700\nc b =\ncxy .3 .4\nc\ncmix .3 a .7 b\n");
    let wanted = unit([0, 1, 2].map(|k| 0.0 + 0.3 * a[k] + 0.7 * b[k]));
    assert_eq!(mix.map(f64::to_bits), wanted.map(f64::to_bits));
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 60, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn mixing_is_associative_and_is_that_of_light(
        parts in prop::array::uniform3((0.01f64..9.0, 0.05f64..0.6, 0.1f64..0.9)),
    ) {
        let parts = parts.map(|(weight, x, y)| (weight, [x, (y * (1.0 - x)).max(0.08)]));
        let [(wa, a), (wb, b), (wc, c)] = parts;
        let define: String = [("a", a), ("b", b), ("c", c)].map(|(name, [x, y])| format!("c {name} =\ncxy {x} {y}\n")).concat();
        let [x, y] = mix_chromaticities(&parts);
        let (direct, outside) = used_color(&format!("c\ncxy {x} {y}\n"));
        let all = used_color(&format!("{define}c\ncmix {wa} a {wb} b {wc} c\n"));
        let left = used_color(&format!("{define}c ab =\ncmix {wa} a {wb} b\nc\ncmix {} ab {wc} c\n", wa + wb));
        let right = used_color(&format!("{define}c bc =\ncmix {wb} b {wc} c\nc\ncmix {wa} a {} bc\n", wb + wc));
        for (color, warnings) in [all.clone(), left, right] {
            prop_assert!(close(color, direct, 1e-3), "{:?} is not {:?}", color, direct);
            prop_assert!(close(color, all.0, 1e-9), "{:?} is not {:?}", color, all.0);
            // A color on the border may fall on either side of it.
            let border = direct.iter().any(|&c| c < 1e-2);
            prop_assert!(border || warnings.len() == outside.len());
        }
    }
}
