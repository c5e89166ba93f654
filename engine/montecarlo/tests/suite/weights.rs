//! Techniques and guides that change the variance of an image but not its mean.
//!
//! The reference is the mean of paths that sample lamps alone: these use no weight at all. Fields are made for the tests: their
//! guides sample nearly all directions toward a lamp, or toward nothing, and their light splits paths at each wall. So a weight that
//! ignores them is wrong by much more than the errors of the means.

use crate::analytic::{CENTER, prepare, root_of_squares};
use femc_field::{
    Ball, Cell, Field, Form, Leaf, Outline, Parallelogram, RegionTargets, Side, Split, Surface, TargetGuide, TargetPack,
};
use femc_geometry::Ray;
use femc_math::Rgb;
use femc_math::color::luminance;
use femc_math::glam::Vec3A;
use femc_montecarlo::{Guidance, MisTechnique, PathSettings, Tracer, WeightWindow};
use femc_prepared::Prepared;
use femc_stats::testing::{Moments, sidak, z_test};

/// Probability of a false alarm over all tests here, and the number of comparisons.
const LEVEL: f64 = 1e-4;
const TESTS: usize = 160;

/// Camera that looks at the floor.
const CAMERA: &str = "camera main =\n origin 0 -1.9 1\n target 0 0 0\n fov 2\n film 1 1\n";

/// Lamps: the ball and the ring are strong, the panel is weak and near.
const LAMPS: &str = "\
m strong =
 sides 2
 c
 ed 300
m weak =
 sides 1
 c
 crgb .3 1 .5
 ed 40
m strong
v s =
 p .6 .3 1.2
sph s .25
m weak
v a =
 p -.9 -.5 .8
v b =
 p -.9 .5 .8
v c =
 p -.4 .5 1.4
v d =
 p -.4 -.5 1.4
f a b c d
m strong
v r =
 p .2 -.9 1
 n 0 .6 -.8
ring r .05 .2
";

/// A floor and a wall behind it.
const ROOM: &str = "\
v e =
 p -2 -2 0
v f =
 p 2 -2 0
v g =
 p 2 1 0
v h =
 p -2 1 0
m floor
f e f g h
v k =
 p -2 1 2
v l =
 p 2 1 2
m wall
f h g l k
";

fn room(media: &str, floor: &str) -> Prepared {
    let wall = "m wall =\n sides 2\n c\n rd .8\n";
    prepare(&format!("{CAMERA}{media}{LAMPS}{wall}m floor =\n sides 2\n{floor}{ROOM}"), "main")
}

/// Returns a field and a guide with equal targets for all surfaces. Half of their directions go toward the ball, the others beside the
/// lamps. The wall is forty times as bright as the rest, so that paths split there.
fn guide(scene: &Prepared) -> (Field, TargetGuide) {
    let shift = scene.origin.as_vec3a();
    let form = Form::Parallelogram([Vec3A::ZERO, Vec3A::X, Vec3A::Y]);
    let surface = Surface { instance: 0, primitives: [0; 2], material: 0, side: Side::Front, form };
    let cells: Vec<Cell> = (0..2).map(|next| Cell { outline: Outline::WHOLE, split: Split::None, next }).collect();
    let leaves = [1.0, 40.0].map(|light| Leaf::Rectangle([Rgb::splat(light); 4])).to_vec();
    let mut sides = vec![vec![[0; 2]; 64]; 4];
    for x in [-1.8, 1.8] {
        let origin = Vec3A::new(x, -1.8, 1.0) - shift;
        let ray = Ray { origin, dir: Vec3A::Y, t_max: f32::INFINITY, time: 0.5 };
        let hit = scene.world.intersect(&ray).expect("the wall");
        sides[hit.instance as usize][hit.primitive as usize] = [1; 2];
    }
    let field = Field { surfaces: vec![surface; 2], roots: vec![0, 1], cells, leaves, sides, ..Field::default() };
    let ball = Ball { center: Vec3A::new(0.6, 0.3, 1.2) - shift, radius: 0.35 };
    let corner = Vec3A::new(-1.8, 0.3, 0.4) - shift;
    let beside = Parallelogram { corner, edges: [Vec3A::Y * 0.6, Vec3A::new(0.5, 0.0, 0.8)] };
    let region = RegionTargets { shares: [0.5, 0.35, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0], ..Default::default() };
    let targets = TargetGuide::new(&field, vec![TargetPack::new(&[ball.into(), beside.into()])], vec![region], &[0, 0]);
    (field, targets)
}

/// Guidance or branches of one run.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Guided {
    No,
    /// No guidance, but several branches at first vertices.
    Branches,
    Directions,
    Window,
    Both,
}

struct Run<'a> {
    scene: &'a Prepared,
    field: &'a Field,
    targets: &'a TargetGuide,
    max_depth: u32,
    samples: u64,
}

impl Run<'_> {
    /// Returns the moments of each channel, and of the luminance.
    fn moments(&self, guided: Guided, technique: Option<MisTechnique>, first_seed: u64) -> [Moments; 4] {
        let mut moments = [Moments::default(); 4];
        let mut branches = 0;
        for seed in first_seed..first_seed + self.samples {
            let settings = PathSettings { seed, max_depth: self.max_depth, single_technique: technique };
            let mut tracer = Tracer::new(self.scene, settings);
            if guided == Guided::Branches {
                tracer = tracer.with_first_branches(4);
            } else if guided != Guided::No {
                let window = match guided {
                    Guided::Directions => WeightWindow { lower: 0.0, upper: f32::INFINITY },
                    _ => WeightWindow::default(),
                };
                let samples_directions = guided != Guided::Window;
                let (field, targets) = (self.field, Some(self.targets));
                let guidance = Guidance { field, targets, samples_directions, window, frame_light: 0.1 };
                tracer = tracer.with_guidance(guidance);
            }
            let color = tracer.sample(0, 0, CENTER).color;
            branches += u64::from(tracer.counters.segments > u64::from(self.max_depth));
            let values = color.to_array().into_iter().chain([luminance(color)]);
            moments.iter_mut().zip(values).for_each(|(moments, value)| moments.add(value.into()));
        }
        let splits = matches!(guided, Guided::Window | Guided::Both) && self.max_depth > 2;
        assert!(!splits || branches > self.samples / 20, "no path was split: {branches}");
        moments
    }

    /// Compares all techniques and guides with lamps sampled alone, without guides.
    fn assert_equal_means(&self, name: &str, most_error: f64) {
        use MisTechnique::{Light, Scatter};
        let reference = self.moments(Guided::No, Some(Light), 1 << 40);
        let runs = [
            (Guided::No, None),
            (Guided::Branches, None),
            (Guided::Branches, Some(Scatter)),
            (Guided::Directions, None),
            (Guided::Directions, Some(Scatter)),
            (Guided::Window, None),
            (Guided::Both, None),
            (Guided::Both, Some(Light)),
        ];
        for (at, (guided, technique)) in (0..).zip(runs) {
            let got = self.moments(guided, technique, at << 32);
            for (channel, (got, reference)) in got.iter().zip(&reference).enumerate() {
                let error = root_of_squares([got, reference].map(|it| it.standard_error()));
                let ratio = got.mean / reference.mean;
                let p = z_test(got.mean, error, reference.mean);
                let relative = error / reference.mean;
                if channel == 3 {
                    println!("{name}, {guided:?}, {technique:?}: {ratio:.4} +- {relative:.4}");
                }
                let what = format!("{name}, {guided:?}, {technique:?}, channel {channel}: {ratio} +- {relative}: {p}");
                assert!(p >= sidak(LEVEL, TESTS), "{what}");
                let is_noisy = technique == Some(Scatter);
                assert!(relative < if is_noisy { 10.0 * most_error } else { most_error }, "too noisy: {what}");
            }
        }
    }
}

#[test]
fn guides_and_windows_change_no_mean_on_matte_floors() {
    let scene = &room("", " c\n rd .7\n");
    let (field, targets) = &guide(scene);
    Run { scene, field, targets, max_depth: 4, samples: 100_000 }.assert_equal_means("matte floors", 0.008);
}

#[test]
fn guides_and_windows_change_no_mean_on_rough_floors() {
    let scene = &room("", " c\n rd .3\n rs .5 .2\n");
    let (field, targets) = &guide(scene);
    Run { scene, field, targets, max_depth: 3, samples: 100_000 }.assert_equal_means("rough floors", 0.008);
}

#[test]
fn guides_and_windows_change_no_mean_on_coated_floors() {
    let scene = &room("", " c\n crgb .6 .3 .1\n rd .5\n c\n rs .3 .1\n");
    let (field, targets) = &guide(scene);
    Run { scene, field, targets, max_depth: 3, samples: 100_000 }.assert_equal_means("coated floors", 0.008);
}

#[test]
fn guides_and_windows_change_no_mean_on_polished_floors() {
    let scene = &room("", " c\n rd .4\n rs .4 0\n");
    let (field, targets) = &guide(scene);
    Run { scene, field, targets, max_depth: 3, samples: 100_000 }.assert_equal_means("polished floors", 0.008);
}

#[test]
fn guides_and_windows_change_no_mean_in_fog() {
    let scene = &room("medium haze =\n c\n cxy .4 .45\n sigma_s .15\n phase hg .4\nmglobal haze\n", " c\n rd .7\n");
    let (field, targets) = &guide(scene);
    Run { scene, field, targets, max_depth: 4, samples: 80_000 }.assert_equal_means("fog", 0.01);
}
