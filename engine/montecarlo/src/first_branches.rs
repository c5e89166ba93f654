//! Splitting of paths at their first vertices.

use crate::path_state::PathState;
use crate::record::Recorder;
use crate::tracer::Tracer;

/// Maximum number of branches of a path at its first vertex.
pub const MAX_FIRST_BRANCHES: u32 = 8;

impl<R: Recorder> Tracer<'_, R> {
    /// Returns the number of branches in which a path continues from its latest vertex. It is 1 after the camera's segment, behind a
    /// pane at which the sample was split, and for guided paths.
    #[inline(always)]
    pub(crate) fn first_branches(&self, path: &PathState) -> u32 {
        let is_first = path.bounce == 0 && self.branches == 1;
        if is_first && self.guidance.is_none() && self.field.is_none() { self.first_branches } else { 1 }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::record::Recording;
    use crate::test_scene::prepare_with_camera;
    use crate::tracer::{PathSettings, PixelFilter};
    use femc_math::Rgb;

    #[derive(Clone, Copy)]
    struct Center;

    impl PixelFilter for Center {
        fn sample(self, _: [f32; 2]) -> [f32; 2] {
            [0.0; 2]
        }
        fn density(self, _: [f32; 2]) -> f32 {
            1.0
        }
    }

    /// A foggy room whose lamp is in the view, a mirror, and a dirty pane in front of a part of it.
    const SCENE: &str = "\
medium haze =
 sigma_s .2
 sigma_a .02
 phase hg .4
mbox haze -2 -2 0 2 2 3
m pane =
 sides 2
 c
 rd .1
 ts .8 0
m lamp =
 sides 1
 c
 ed 100
m wall =
 sides 2
 c
 rd .6
 rs .2 .3
m mirror =
 sides 2
 c
 rs .9 0
v a =
 p -2 -2 0
v b =
 p 2 -2 0
v c =
 p 2 2 0
v d =
 p -2 2 0
v e =
 p -2 -2 3
v f =
 p 2 -2 3
v g =
 p 2 2 3
v h =
 p -2 2 3
m wall
f a b c d
f e h g f
f a d h e
f b f g c
m mirror
f d c g h
v l1 =
 p -.3 .8 2.9
v l2 =
 p -.3 1.4 2.9
v l3 =
 p .3 1.4 2.9
v l4 =
 p .3 .8 2.9
m lamp
f l1 l2 l3 l4
v p1 =
 p -1 -.5 .5
v p2 =
 p 0 -.5 .5
v p3 =
 p 0 -.5 1.5
v p4 =
 p -1 -.5 1.5
m pane
f p1 p2 p3 p4
";

    /// At surfaces and at collisions: a recorder changes no bit, the recorded light adds up to the sample, and each branch has its own
    /// path. Mirrors do not split, and no sample is split twice.
    #[test]
    fn recorded_branches_add_up_to_the_sample() {
        let camera = "camera main =\n origin 0 -1.9 1.5\n target 0 2 1.5\n up 0 0 1\n fov 90\n film 20 20\n";
        let scene = prepare_with_camera(camera, SCENE);
        let settings = PathSettings { seed: 3, max_depth: 0, single_technique: None };
        let mut plain = Tracer::new(&scene, settings).with_first_branches(4);
        let mut recorded = Tracer::with_recorder(&scene, settings, Recording::default()).with_first_branches(4);
        let (mut split, mut whole) = (0, 0);
        for pixel in 0..400 {
            let expected = plain.sample(pixel, 1, Center).color;
            let color = recorded.sample(pixel, 1, Center).color;
            assert_eq!(color.to_array(), expected.to_array(), "pixel {pixel}");
            let recording = &recorded.recorder;
            let sum: Rgb = recording.contributions.iter().map(|(contribution, _)| contribution.color).sum();
            assert!(
                (sum - color).abs().max_element() <= 1e-4 * color.max_element(),
                "pixel {pixel}: {sum} for {color}"
            );
            match recorded.branches {
                1 => whole += 1,
                4 => split += 1,
                other => panic!("pixel {pixel}: {other} branches"),
            }
        }
        assert_eq!(recorded.counters, plain.counters);
        assert!(split > 200 && whole > 10, "{split} split, {whole} whole");
    }
}
