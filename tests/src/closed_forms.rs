//! Scenes whose light is known in closed form, and the solutions of the first pass for them.

use femc_field::{Harmonics, Leaf, SurfaceSpot};
use femc_geometry::Hit;
use femc_math::Rgb;
use femc_math::color::luminance;
use femc_math::glam::DVec3;
use femc_pipeline::radiosity::{Solution, SolveOptions, SolveReport, solve};
use femc_pipeline::{Field, Form, Prepared, SceneSource, Settings, Side, prepare_frame};
use std::f64::consts::PI;
use std::fmt::Write as _;
use std::sync::atomic::AtomicBool;

/// Text of a camera, because every scene needs one.
pub const CAMERA: &str = "camera main =\n  origin .31 .42 .23\n  target .8 .6 .7\n  fov 90\n  film 24 24\n";
/// Reflectance of surfaces that only receive light.
pub const DARK_REFLECTANCE: f64 = 1e-6;
/// Points of a surface per axis.
const POINTS_PER_AXIS: u32 = 32;

/// A scene with its solution.
pub struct SolvedScene {
    /// The prepared frame.
    pub prepared: Prepared,
    /// Light field without direct light of lamps.
    pub field: Field,
    /// Direct light of lamps on the same leaves.
    pub direct: Field,
    /// Report of the solver.
    pub report: SolveReport,
}

impl SolvedScene {
    /// Solves a scene.
    ///
    /// # Panics
    /// If the text is not a scene; this is for tests only.
    pub fn new(text: &str, options: &SolveOptions) -> Self {
        let source = SceneSource::new(crate::parse_scene(text));
        let prepared = prepare_frame(&source, &Settings::default(), 1, None).unwrap_or_else(|e| panic!("{e}"));
        let solution = solve(&prepared, options, &AtomicBool::new(false)).unwrap_or_else(|e| panic!("{e:?}"));
        let Solution { field, report } = solution;
        let direct = Field { leaves: field.direct.clone(), ..field.clone() };
        Self { prepared, field, direct, report }
    }

    /// Returns a point of a surface, m in the scene's frame, and the irradiance there, lx: from elements, and directly from lamps.
    /// - `uv`: parameters of the point.
    pub fn irradiance_at(&self, surface: usize, uv: [f32; 2]) -> (DVec3, [f64; 2]) {
        let surface = &self.field.surfaces[surface];
        let SurfaceSpot { position, normal, .. } = surface.point_at(uv.into());
        let second = surface.primitives[0] != surface.primitives[1] && uv[0] + uv[1] > 1.0;
        let v = match surface.form {
            Form::Curved { shape, .. } => shape.parameter_at_share(f64::from(uv[1])) as f32,
            _ => uv[1],
        };
        let primitive = surface.primitives[usize::from(second)];
        let hit = Hit { t: 1.0, instance: surface.instance, primitive, u: uv[0], v };
        let values = [&self.field, &self.direct]
            .map(|field| f64::from(luminance(field.irradiance(&hit, surface.side, position, normal))));
        (self.prepared.origin + position.as_dvec3(), values)
    }

    /// Returns points spread evenly over a surface, with the values of [`SolvedScene::irradiance_at`].
    pub fn irradiance_over(&self, surface: usize) -> Vec<(DVec3, [f64; 2])> {
        let is_triangle = matches!(self.field.surfaces[surface].form, Form::Triangle(_));
        let place = |k: u32| {
            let place = [k % POINTS_PER_AXIS, k / POINTS_PER_AXIS].map(|k| (k as f32 + 0.5) / POINTS_PER_AXIS as f32);
            if is_triangle && place[0] + place[1] > 1.0 { place.map(|x| 1.0 - x) } else { place }
        };
        (0..POINTS_PER_AXIS * POINTS_PER_AXIS).map(|k| self.irradiance_at(surface, place(k))).collect()
    }

    /// Returns the mean irradiance of a surface, with the two parts of [`SolvedScene::irradiance_at`].
    pub fn mean_irradiance(&self, surface: usize) -> [f64; 2] {
        let over = self.irradiance_over(surface);
        [0, 1].map(|kind| over.iter().map(|(_, values)| values[kind]).sum::<f64>() / over.len() as f64)
    }

    /// Returns the surfaces on this side.
    pub fn surfaces_on_side(&self, side: Side) -> Vec<usize> {
        (0..self.field.surfaces.len()).filter(|&k| self.field.surfaces[k].side == side).collect()
    }

    /// Returns the mean radiance over all directions at a point in fog, without direct light of lamps, cd/m2.
    /// - `point`: m in the scene's frame.
    pub fn fog_mean_radiance(&self, point: DVec3) -> f64 {
        f64::from(luminance(self.field.fog.mean_radiance((point - self.prepared.origin).as_vec3a())))
    }
}

/// Pairs of a value of the first pass and the true value.
pub type Pairs = Vec<[f64; 2]>;

/// A scene with known light.
pub struct Case {
    /// Name of the case.
    pub name: String,
    /// Text of the scene.
    pub text: String,
    /// Function that pairs values of a solution with the known ones.
    read: Box<dyn Fn(&SolvedScene) -> Pairs>,
}

impl Case {
    fn new(name: String, text: String, read: impl Fn(&SolvedScene) -> Pairs + 'static) -> Self {
        Self { name, text, read: Box::new(read) }
    }

    /// Solves the scene with links of this error.
    pub fn solve(&self, error: f32) -> (SolvedScene, Pairs) {
        let solved = SolvedScene::new(&self.text, &SolveOptions { error, ..SolveOptions::default() });
        let pairs = (self.read)(&solved);
        (solved, pairs)
    }

    /// Returns the errors that a solution states at the points of [`Case::solve`], in the unit of its pairs.
    pub fn stated_errors(&self, solved: SolvedScene) -> Vec<f64> {
        let SolvedScene { prepared, field, direct, report } = solved;
        let constant = |(leaf, &error): (&Leaf, &f32)| {
            let error = Rgb::splat(error);
            match leaf {
                Leaf::Triangle(_) => Leaf::Triangle([error; 3]),
                Leaf::Rectangle(_) => Leaf::Rectangle([error; 4]),
                Leaf::Curved(_) => Leaf::Curved(Harmonics::from_irradiance(error)),
            }
        };
        let leaves = field.leaves.iter().zip(&field.errors).map(constant).collect();
        let errors = SolvedScene { prepared, field: Field { leaves, ..field }, direct, report };
        (self.read)(&errors).into_iter().map(|[error, _]| error).collect()
    }
}

/// Errors of a solution's light, relative to the mean of the true light.
#[derive(Clone, Copy, Debug)]
pub struct Errors {
    /// Signed error of the mean.
    pub mean: f64,
    /// Root mean square error.
    pub rms: f64,
    /// Greatest absolute error.
    pub max_abs: f64,
}

/// Computes the errors of pairs.
pub fn relative_errors(pairs: &[[f64; 2]]) -> Errors {
    let n = pairs.len() as f64;
    let [have, want] = [0, 1].map(|k| pairs.iter().map(|pair| pair[k]).sum::<f64>() / n);
    let squares = pairs.iter().map(|[have, want]| (have - want).powi(2)).sum::<f64>() / n;
    let most = pairs.iter().map(|[have, want]| (have - want).abs()).fold(0.0, f64::max);
    Errors { mean: have / want - 1.0, rms: squares.sqrt() / want, max_abs: most / want }
}

/// Appends quadrilateral faces with the current material.
fn push_faces(text: &mut String, name: &str, corners: &[[f64; 3]], faces: &[&[usize]]) {
    for (k, [x, y, z]) in corners.iter().enumerate() {
        let _ = writeln!(text, "v {name}{k} =\n  p {x} {y} {z}");
    }
    for face in faces {
        let names: Vec<String> = face.iter().map(|k| format!("{name}{k}")).collect();
        let _ = writeln!(text, "f {}", names.join(" "));
    }
}

fn box_corners([x, y, z]: [f64; 3]) -> [[f64; 3]; 8] {
    [[0., 0., 0.], [x, 0., 0.], [x, y, 0.], [0., y, 0.], [0., 0., z], [x, 0., z], [x, y, z], [0., y, z]]
}

/// Corner indices of a box's inward faces: floor, ceiling, sides along x, y, x, y.
const INWARD: [&[usize]; 6] =
    [&[0, 1, 2, 3], &[7, 6, 5, 4], &[0, 4, 5, 1], &[1, 5, 6, 2], &[2, 6, 7, 3], &[3, 7, 4, 0]];

/// Computes the form factor from a point to a polygon above its horizon, with Lambert's formula.
/// - `corners`: clockwise as seen from the point.
fn form_factor(point: DVec3, normal: DVec3, corners: &[DVec3]) -> f64 {
    let edge = |k: usize| {
        let [a, b] = [corners[k], corners[(k + 1) % corners.len()]].map(|corner| corner - point);
        let across = a.cross(b);
        let sine = across.length();
        if sine > 0.0 { sine.atan2(a.dot(b)) * normal.dot(across) / sine } else { 0.0 }
    };
    ((0..corners.len()).map(edge).sum::<f64>() / (2.0 * PI)).abs()
}

/// A receiver of the floor's light in [`reflecting_floor_of`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FloorReceiver {
    /// The ceiling, parallel to the floor.
    Ceiling,
    /// The side at y = 0, which has an edge in common with the floor.
    Side,
}

/// A unit cube whose walls emit evenly and whose floor is the only reflector; see [`reflecting_floor_of`].
pub fn reflecting_floor() -> Case {
    reflecting_floor_of([1.0; 3], &[FloorReceiver::Ceiling, FloorReceiver::Side])
}

/// A box whose walls emit evenly and whose floor is the only reflector. The other walls receive its light according to their form
/// factors (Lambert's formula at each point).
/// - `size`: along x, y and z, m.
pub fn reflecting_floor_of(size: [f64; 3], receivers: &[FloorReceiver]) -> Case {
    let mut text = String::from(CAMERA);
    let at = box_corners(size);
    for (k, face) in INWARD.into_iter().enumerate() {
        let reflectance = if k == 0 { 0.5 } else { DARK_REFLECTANCE };
        let _ = writeln!(text, "m m{k} =\n  sides 1\n  rd {reflectance}\n  ed {PI}");
        push_faces(&mut text, &format!("p{k}_"), &at, &[face]);
    }
    let [x, y, z] = size;
    let floor = [[0., 0.], [x, 0.], [x, y], [0., y]].map(|[x, y]| DVec3::new(x, y, 0.0));
    let receivers = receivers.to_vec();
    let name = if size == [1.0; 3] { "a cube".to_owned() } else { format!("a box of {x} x {y} x {z}") };
    Case::new(format!("the floor of {name}, from {receivers:?}"), text, move |solved| {
        let of = |receiver: &FloorReceiver| {
            let (surface, normal) = match receiver {
                FloorReceiver::Ceiling => (1, DVec3::NEG_Z),
                FloorReceiver::Side => (2, DVec3::Y),
            };
            let pair =
                move |(point, [have, _]): (DVec3, [f64; 2])| [have / (0.5 * PI), form_factor(point, normal, &floor)];
            solved.irradiance_over(surface).into_iter().map(pair)
        };
        receivers.iter().flat_map(of).collect()
    })
}

/// A disc of radius `r2` transmits light of a room of luminance 1. A coaxial disc of radius `r1` at distance `h` receives it
/// (\[howell2010\]).
pub fn coaxial_discs(r1: f64, r2: f64, h: f64) -> Case {
    let mut text = format!("{CAMERA}m room =\n  sides 1\n  ed {PI}\n");
    let at = box_corners([20.0, 20.0, 10.0]).map(|[x, y, z]| [x - 10.0, y - 10.0, z - 10.0]);
    push_faces(&mut text, "p", &at, &[INWARD[0], INWARD[2], INWARD[3], INWARD[4], INWARD[5]]);
    let _ = write!(
        text,
        "m paper =\n  td .5\nv low =\n  p 0 0 0\n  n 0 0 1\nring low 0 {r2}\n\
         m plate =\n  sides 1\n  rd {DARK_REFLECTANCE}\nv high =\n  p 0 0 {h}\n  n 0 0 -1\nring high 0 {r1}\n"
    );
    Case::new(format!("discs of {r1}, {r2} at {h}"), text, move |solved| {
        // Sides are in scene order: front and back of the paper, then the plate.
        let pair = |(point, [have, _]): (DVec3, [f64; 2])| {
            let a2 = point.x * point.x + point.y * point.y;
            let z = h * h + a2 + r2 * r2;
            [have / (0.5 * PI), 0.5 * (1.0 - (h * h + a2 - r2 * r2) / (z * z - 4.0 * a2 * r2 * r2).sqrt())]
        };
        solved.irradiance_over(2).into_iter().map(pair).collect()
    })
}

/// Form factor of two coaxial discs, from the first to the second (\[howell2010\], C-41).
pub fn disc_form_factor(r1: f64, r2: f64, h: f64) -> f64 {
    let s = 1.0 + (h * h + r2 * r2) / (r1 * r1);
    0.5 * (s - (s * s - 4.0 * (r2 / r1).powi(2)).sqrt())
}

/// A ball of radius 0.5 of evenly bright paper over a plate 1 m below its center: (R / d)^2 times the cosine.
pub fn ball_over_plate() -> Case {
    let mut text = format!("{CAMERA}m plate =\n  sides 1\n  rd {DARK_REFLECTANCE}\n");
    push_faces(&mut text, "p", &[[-2., -2., 0.], [2., -2., 0.], [2., 2., 0.], [-2., 2., 0.]], &[&[0, 1, 2, 3]]);
    text.push_str("m paper =\n  td .5\nv c =\n  p 0 0 1\nsph c .5\nm lamp =\n  sides 1\n  ed 1e4\nsph c .005\n");
    Case::new("a ball over a plate".into(), text, |solved| {
        let radiosity = 0.5 * 1e4 * (0.005f64 / 0.5).powi(2);
        let pair = |(point, [have, _]): (DVec3, [f64; 2])| {
            let d2 = point.x * point.x + point.y * point.y + 1.0;
            [have / radiosity, 0.25 / d2 / d2.sqrt()]
        };
        solved.irradiance_over(0).into_iter().map(pair).collect()
    })
}

/// A closed unit cube that emits evenly, clear or with fog that does not absorb. All points receive the same light. The part that
/// comes directly from the walls is an integral.
/// - `scattering`: 1/m.
pub fn furnace(reflectance: f64, scattering: f64) -> Case {
    let fog = format!("medium air =\n  sigma_s {scattering}\nmbox air 0 0 0 1 1 1\n");
    let fog = if scattering > 0.0 { fog } else { String::new() };
    let mut text = format!("{CAMERA}{fog}m wall =\n  sides 1\n  rd {reflectance}\n  ed {PI}\n");
    push_faces(&mut text, "p", &box_corners([1.0; 3]), &INWARD);
    let name = format!("a furnace of {reflectance}, scattering {scattering}");
    Case::new(name, text, move |solved| {
        let want = 1.0 / (1.0 - reflectance);
        (0..6)
            .flat_map(|surface| solved.irradiance_over(surface).into_iter().step_by(17))
            .map(|(point, [have, _])| {
                let normal = inward_normal(point);
                [have, PI * want - direct_irradiance(point, Some(normal), scattering)]
            })
            .collect()
    })
}

/// Like [`furnace`], but compares the mean radiance over all directions in the fog.
pub fn furnace_fog(reflectance: f64, scattering: f64) -> Case {
    let walls = furnace(reflectance, scattering);
    Case::new(format!("{}, in it", walls.name), walls.text, move |solved| {
        let want = 1.0 / (1.0 - reflectance);
        let point = |k: u32| DVec3::from([0, 1, 2].map(|axis| (f64::from(k / 5u32.pow(axis) % 5) + 0.5) / 5.0));
        let pair = |point: DVec3| {
            [solved.fog_mean_radiance(point), want - direct_irradiance(point, None, scattering) / (4.0 * PI)]
        };
        (0..125).map(point).map(pair).collect()
    })
}

/// Returns the inward normal of the unit cube's wall that contains a point.
fn inward_normal(point: DVec3) -> DVec3 {
    let from_middle = point - 0.5;
    let axis = (1..3).fold(0, |best, axis| if from_middle[axis].abs() > from_middle[best].abs() { axis } else { best });
    let mut normal = DVec3::ZERO;
    normal[axis] = -from_middle[axis].signum();
    normal
}

/// Computes the light that arrives at a point through fog directly from the unit cube's walls of luminance 1. With a normal, it is
/// weighted by the cosine.
fn direct_irradiance(point: DVec3, normal: Option<DVec3>, extinction: f64) -> f64 {
    let distance = |dir: DVec3| {
        let along = |axis: usize| match dir[axis] {
            d if d > 0.0 => (1.0 - point[axis]) / d,
            d if d < 0.0 => point[axis] / -d,
            _ => f64::INFINITY,
        };
        along(0).min(along(1)).min(along(2))
    };
    // Samples are centers of cells of equal solid angle, or of equal cosine-weighted solid angle.
    const N: u32 = 96;
    let mut sum = 0.0;
    for k in 0..N * N {
        let [u, v] = [k % N, k / N].map(|k| (f64::from(k) + 0.5) / f64::from(N));
        let (sin, cos) = (2.0 * PI * v).sin_cos();
        let z = 1.0 - 2.0 * u;
        let sphere = DVec3::new((1.0 - z * z).sqrt() * cos, (1.0 - z * z).sqrt() * sin, z);
        let dir = normal.map_or(sphere, |normal| (sphere + normal).normalize());
        sum += (-extinction * distance(dir)).exp();
    }
    sum / f64::from(N * N) * if normal.is_some() { PI } else { 4.0 * PI }
}

/// A sphere of radius 1 with a small lamp at its center.
/// - `port`: fraction of the sphere's area that is open, which lies behind a black disc.
/// - `absorption`: of the gas in the sphere, 1/m.
pub fn sphere(reflectance: f64, port: f64, absorption: f64) -> Case {
    let mut text = format!(
        "{CAMERA}m wall =\n  sides 1\n  rd {reflectance}\nv c =\n  p 0 0 0\nsph c -1\n\
         m lamp =\n  sides 1\n  ed 1e5\nsph c .005\n"
    );
    if absorption > 0.0 {
        let _ = write!(text, "medium gas =\n  sigma_a {absorption}\nmbox gas -1.1 -1.1 -1.1 1.1 1.1 1.1\n");
    }
    let cut = 1.0 - 2.0 * port;
    if port > 0.0 {
        let radius = (1.0 - cut * cut).sqrt();
        let _ = write!(text, "m black =\n  rd 0\nv d =\n  p 0 0 {cut}\n  n 0 0 -1\nring d 0 {radius}\n");
    }
    let name = format!("a sphere of {reflectance}, port {port}, absorption {absorption}");
    Case::new(name, text, move |solved| {
        let x = absorption;
        let kept = if x > 0.0 { (1.0 - (1.0 + 2.0 * x) * (-2.0 * x).exp()) / (2.0 * x * x) } else { 1.0 - port };
        let first = 1e5 * 0.005f64.powi(2) * (-x).exp();
        let want = first * reflectance * kept / (1.0 - reflectance * kept);
        let is_open = |point: &DVec3| point.z < cut - 0.02 || port == 0.0;
        let points = solved.irradiance_over(0).into_iter().filter(|(point, _)| is_open(point));
        points.map(|(_, [have, _])| [have, want]).collect()
    })
}

/// A broad slab of fog, 1 m thick, under a lamp of luminance 1. Compares reflected and transmitted light at its center with the
/// incident light.
#[derive(Clone, Copy, Debug)]
pub struct Slab {
    /// Optical thickness.
    pub thickness: f64,
    /// Single scattering albedo.
    pub albedo: f64,
    /// Half of its width, m.
    pub half_width: f64,
    /// Lamps per axis.
    pub lamps: u32,
}

impl Slab {
    /// Returns the scene: one plate faces the slab from above and one from below. They are so small that they shade nothing.
    pub fn text(&self) -> String {
        let Self { thickness, albedo, half_width: reach, lamps } = *self;
        let fog = format!("  sigma_s {}\n  sigma_a {}\n", thickness * albedo, thickness * (1.0 - albedo));
        let mut text = format!("{CAMERA}medium air =\n{fog}mbox air {0} {0} 0 {reach} {reach} 1\n", -reach);
        let _ = writeln!(text, "m lamp =\n  sides 1\n  ed {PI}");
        let step = 2.0 * reach / f64::from(lamps);
        for k in 0..lamps * lamps {
            let [x, y] = [k % lamps, k / lamps].map(|k| -reach + step * f64::from(k));
            let at = [[x, y, 1.01], [x, y + step, 1.01], [x + step, y + step, 1.01], [x + step, y, 1.01]];
            push_faces(&mut text, &format!("l{k}_"), &at, &[&[0, 1, 2, 3]]);
        }
        let _ = writeln!(text, "m plate =\n  sides 1\n  rd {DARK_REFLECTANCE}");
        let square = |z: f64| [[-0.005, -0.005, z], [0.005, -0.005, z], [0.005, 0.005, z], [-0.005, 0.005, z]];
        push_faces(&mut text, "a", &square(1.0), &[&[3, 2, 1, 0]]);
        push_faces(&mut text, "b", &square(0.0), &[&[0, 1, 2, 3]]);
        text
    }

    /// Returns the reflected light, the transmitted light, and the directly transmitted part.
    pub fn reflected_and_transmitted(solved: &SolvedScene) -> [f64; 3] {
        let ([up, _], [down, straight]) = (solved.mean_irradiance(0), solved.mean_irradiance(1));
        [up, down + straight, straight].map(|value| value / PI)
    }

    /// Turns the slab into a case of the directly transmitted part, twice the third exponential integral.
    pub fn unscattered_case(self) -> Case {
        let name = format!("unscattered light of a slab of {} and albedo {}", self.thickness, self.albedo);
        let want = 2.0 * third_exponential_integral(self.thickness);
        Case::new(name, self.text(), move |solved| vec![[Self::reflected_and_transmitted(solved)[2], want]])
    }

    /// Turns the slab into a case with known reflected and transmitted light. Compares the scattered parts.
    pub fn case(self, reflected: f64, transmitted: f64) -> Case {
        let straight = 2.0 * third_exponential_integral(self.thickness);
        let name = format!("a slab of {} and albedo {}", self.thickness, self.albedo);
        Case::new(name, self.text(), move |solved| {
            let [up, down, through] = Self::reflected_and_transmitted(solved);
            vec![[up, reflected], [down - through, transmitted - straight]]
        })
    }
}

/// Computes E3(x), the integral of exp(-x / m) m over m from 0 to 1.
pub fn third_exponential_integral(x: f64) -> f64 {
    const N: u32 = 100_000;
    (0..N).map(|k| (f64::from(k) + 0.5) / f64::from(N)).map(|m| (-x / m).exp() * m).sum::<f64>() / f64::from(N)
}

/// A small lamp in unbounded fog of extinction 1/m. Compares the scattered light at 1, 2 and 3 m.
/// - `walled`: whether there is a surface far away.
pub fn lamp_in_fog(albedo: f64, reach: f64, walled: bool) -> Case {
    // Fluence by albedo (brief T8: the integral for an isotropic point of 1 W). The direct part is subtracted below.
    let fluence =
        if albedo < 0.7 { [0.058_695_1, 0.007_927_62, 0.001_722_20] } else { [0.143_284, 0.037_126_4, 0.014_140_0] };
    let radius = 0.01f64;
    let flux = 1e4 * 4.0 * PI * radius * radius;
    let mut text = format!(
        "{CAMERA}medium air =\n  sigma_s {albedo}\n  sigma_a {}\nmbox air {1} {1} {1} {reach} {reach} {reach}\n\
         m lamp =\n  sides 1\n  ed 1e4\nv c =\n  p 0 0 0\nsph c {radius}\n",
        1.0 - albedo,
        -reach
    );
    if walled {
        let _ = write!(text, "m far =\n  rd {DARK_REFLECTANCE}\nv f =\n  p {reach} {reach} {reach}\nsph f .1\n");
    }
    Case::new(format!("a lamp in fog of albedo {albedo}"), text, move |solved| {
        let mut pairs = Vec::new();
        for (k, fluence) in fluence.into_iter().enumerate() {
            let r = k as f64 + 1.0;
            let want = fluence - (-r).exp() / (4.0 * PI * r * r);
            for dir in
                [DVec3::X, DVec3::Y, DVec3::Z, DVec3::NEG_X, DVec3::ONE, DVec3::new(1.0, -1.0, 1.0), DVec3::NEG_ONE]
            {
                let have = solved.fog_mean_radiance(dir.normalize() * r) * 4.0 * PI / flux;
                // All distances have equal weight.
                pairs.push([have / want, 1.0]);
            }
        }
        pairs
    })
}

/// Slabs of fog: optical thickness, albedo, reflected and transmitted fraction of diffuse light (brief T12).
pub const SLABS: [(f64, f64, f64, f64); 7] = [
    (0.1, 1.0, 0.084_30, 0.915_70),
    (0.5, 1.0, 0.295_83, 0.704_17),
    (1.0, 1.0, 0.446_59, 0.553_41),
    (1.0, 0.9, 0.352_71, 0.474_75),
    (2.0, 0.9, 0.437_14, 0.265_58),
    (2.0, 0.5, 0.145_08, 0.107_06),
    (5.0, 0.9, 0.476_32, 0.053_43),
];

/// Returns all cases.
pub fn all_cases() -> Vec<Case> {
    let mut cases = vec![reflecting_floor()];
    cases.extend([(1.0, 1.0, 1.0), (1.0, 2.0, 1.0), (0.5, 1.0, 2.0)].map(|(r1, r2, h)| coaxial_discs(r1, r2, h)));
    cases.push(ball_over_plate());
    cases.extend([0.2, 0.5, 0.9].map(|reflectance| furnace(reflectance, 0.0)));
    for scattering in [0.3, 1.0, 3.0] {
        cases.extend([furnace(0.5, scattering), furnace_fog(0.5, scattering)]);
    }
    cases.extend([(0.5, 0.0, 0.0), (0.9, 0.0, 0.0), (0.9, 0.1, 0.0), (0.9, 0.0, 1.0)].map(|(a, b, c)| sphere(a, b, c)));
    for (thickness, albedo, reflected, transmitted) in SLABS {
        cases.push(Slab { thickness, albedo, half_width: 6.0, lamps: 3 }.case(reflected, transmitted));
    }
    cases.extend([(0.5, 6.0), (0.9, 10.0)].map(|(albedo, reach)| lamp_in_fog(albedo, reach, true)));
    cases
}
