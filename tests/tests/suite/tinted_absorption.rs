//! A clear, colored absorber: each channel of a wall behind it is attenuated by its own coefficient.

use femc_pipeline::{Settings, StopCondition};
use femc_tests::{parse_scene, render_frame};

#[test]
fn each_channel_is_attenuated_by_its_own_coefficient() {
    let text = "camera main =\n origin 0 0 0\n target 1 0 0\n fov 1\n film 2 2\n\
                m wall =\n sides 2\n c\n ed 3.14159265358979\n\
                v a =\n p 5 -9 -9\nv b =\n p 5 9 -9\nv c =\n p 5 9 9\nv d =\n p 5 -9 9\nm wall\nf a b c d\n\
                medium ink =\n c\n crgb 1 2 .5\n sigma_a .5\nmbox ink 1 -9 -9 2 9 9\n";
    let image = render_frame(&parse_scene(text), &Settings { stop: StopCondition::Spp(4), ..Settings::default() }, 1);
    for pixel in &image.color.pixels {
        for (value, depth) in pixel.iter().zip([0.5f64, 1.0, 0.25]) {
            assert!((f64::from(*value) / (-depth).exp() - 1.0).abs() < 1e-4, "{pixel:?}");
        }
    }
}
