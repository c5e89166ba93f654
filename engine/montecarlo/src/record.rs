//! What a path tells of itself, for those who ask where its light came from.
//!
//! A sample is a function of seed, frame, pixel and number: it can be traced again at any time, and this time with a recorder.
//! The recorder `()` of ordinary rendering hears nothing. All that is told is told by closures which it does not call, so that
//! what they would have to find out costs nothing.

use femc_geometry::Ray;
use femc_math::Rgb;
use femc_math::glam::Vec3A;
use femc_prepared::camera::View;
use femc_scattering::Bsdf;
pub use femc_scattering::Transmitted;

/// Events of a sample that a recorder is told.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Hears {
    /// The end: why the path stops, and the sample's radiance.
    End,
    /// The end, and every vertex and contribution before it.
    All,
}

/// What the tracer calls for each vertex of a path, for each contribution to a sample, and at the path's end.
pub trait Recorder {
    /// Whether it wants to hear what hides light ([`Self::hidden`]): to find that out takes work.
    const HIDDEN: bool = true;
    /// Whether it wants to hear of light that was drawn and adds nothing: it is hidden, or on a side that scatters none.
    const DARK: bool = true;
    /// Whether it wants to hear of camera rays ([`Self::camera`]).
    const CAMERA: bool = false;

    /// A camera sample begins: its pixel, a row-major index in the whole film, and its number. Says what is to be heard of it.
    fn begin(&mut self, pixel: u32, sample: u32) -> Hears;
    /// The sample's ray leaves the camera, whatever else is to be heard of the sample.
    /// - `view`: what the point `lens` of the lens, in [0, 1)^2, sees at the ray's time.
    fn camera(&mut self, _view: &View, _lens: [f32; 2], _ray: &Ray) {}
    /// The path has come to a surface that may scatter, or to a collision in a medium.
    fn vertex(&mut self, vertex: impl FnOnce() -> Vertex);
    /// The path goes on from its latest vertex.
    fn leave(&mut self, way: Leaving);
    /// The light that was drawn for the latest vertex, or for a point in fog, is hidden by a surface: its contribution, which is told next, is 0.
    fn hidden(&mut self, shadow: impl FnOnce() -> Ray);
    /// What the surface of the latest vertex is to the direction that is told next: the one that the path goes on in, or that of the light
    /// that was drawn, unless it is hidden. Of a mirror and of clear surfaces nothing is told.
    fn split(&mut self, _split: impl FnOnce() -> Split) {}
    /// Light was found.
    fn light(&mut self, contribution: impl FnOnce() -> Contribution);
    /// The path goes no further.
    /// - `vertices`: number of vertices of the path;
    /// - `throughput`: of the path; 0 if it stops because nothing is left.
    fn stop(&mut self, vertices: u32, why: Stop, throughput: Rgb);
    /// The sample is done.
    /// - `color`: its radiance, cd/m2 by channel; `None`: the film refuses it.
    fn end(&mut self, color: Option<Rgb>);
}

impl Recorder for () {
    #[inline(always)]
    fn begin(&mut self, _: u32, _: u32) -> Hears {
        Hears::End
    }
    #[inline(always)]
    fn vertex(&mut self, _: impl FnOnce() -> Vertex) {}
    #[inline(always)]
    fn leave(&mut self, _: Leaving) {}
    #[inline(always)]
    fn hidden(&mut self, _: impl FnOnce() -> Ray) {}
    #[inline(always)]
    fn light(&mut self, _: impl FnOnce() -> Contribution) {}
    #[inline(always)]
    fn stop(&mut self, _: u32, _: Stop, _: Rgb) {}
    #[inline(always)]
    fn end(&mut self, _: Option<Rgb>) {}
}

/// Why a path goes no further.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Stop {
    /// It has left the scene.
    Escaped,
    /// Nothing was scattered, or what was had no way to go.
    Absorbed,
    /// Russian roulette.
    Roulette,
    /// It has as many segments as it may.
    Depth,
    /// It ended with the light of a field.
    Field,
}

impl Stop {
    /// Of a path that roulette, or having lost everything, has ended.
    #[inline]
    pub(crate) fn of_lost(throughput: Rgb) -> Self {
        if throughput.max_element() > 0.0 { Self::Roulette } else { Self::Absorbed }
    }
}

/// What a path meets.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Place {
    /// A surface of `Prepared::instances`.
    Surface {
        /// Index of the instance.
        instance: u32,
        /// Index of the primitive in it.
        primitive: u32,
        /// Index of the material.
        material: u32,
    },
    /// A medium, by its index.
    Medium(u16),
}

/// A vertex of a path.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Vertex {
    /// What is there.
    pub place: Place,
    /// Where it is, prepared frame, m.
    pub position: Vec3A,
    /// The segment that ends there; 0: the camera's.
    pub bounce: u32,
    /// Factor of the path on arrival.
    pub throughput: Rgb,
}

/// How a path goes on from a vertex.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Leaving {
    /// Straight through a clear surface: the path stays on its segment.
    Straight,
    /// In the only direction of a mirror, or of glass that bends.
    Delta(Transmitted),
    /// In one of many directions.
    Scattered {
        /// Density of the direction, 1/sr.
        pdf: f32,
        /// What scatters so.
        by: Scatterer,
        /// Whether the direction was drawn by what a first pass knows of the light there.
        by_guide: bool,
    },
}

/// Parts of what a surface scatters from one direction into another.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Split {
    /// Whether the directions lie on different sides.
    pub transmitted: Transmitted,
    /// What scatters.
    pub lobes: Lobes,
}

/// Lobes of a surface between two directions.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Lobes {
    /// All is scattered diffusely.
    Diffuse,
    /// All is scattered about a direction.
    Glossy,
    /// Both: the share by channel that is scattered diffusely, in 0..1.
    Both(Rgb),
}

impl Split {
    /// Of light from `wi` to `wo`, unit, local frame, some of which is scattered: by the side that it comes from and by the lobes' shares of the
    /// BSDF's value there, whatever drew the direction.
    #[inline]
    pub(crate) fn of(bsdf: &Bsdf, wo: Vec3A, wi: Vec3A) -> Self {
        // The most frequent by far: it scatters to one side alone.
        if matches!(bsdf, Bsdf::Diffuse(_)) {
            return Self { transmitted: Transmitted::No, lobes: Lobes::Diffuse };
        }
        let transmitted = if wo.z * wi.z < 0.0 { Transmitted::Yes } else { Transmitted::No };
        Self { transmitted, lobes: Lobes::of(bsdf, wo, wi) }
    }
}

impl Lobes {
    #[inline(never)]
    fn of(bsdf: &Bsdf, wo: Vec3A, wi: Vec3A) -> Self {
        let share = bsdf.diffuse_share(wo, wi);
        if share == Rgb::ONE {
            Self::Diffuse
        } else if share == Rgb::ZERO {
            Self::Glossy
        } else {
            Self::Both(share)
        }
    }
}

/// What scatters in many directions.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Scatterer {
    /// A Lambertian lobe, reflected or transmitted.
    Diffuse,
    /// A lobe about a direction.
    Glossy,
    /// A phase function.
    Phase,
}

/// How light was found.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Found {
    /// A point on a lamp was drawn from the camera.
    Sight,
    /// The path has met a lamp.
    Met,
    /// A point on a lamp was drawn from a surface, the latest vertex.
    Surface,
    /// A lamp was chosen for the segment, and a distance by what this medium scatters of its light.
    Airlight(u16),
    /// The segment goes through this medium, which glows.
    Glow(u16),
    /// The path ended at its latest vertex with the light of a field.
    Field,
}

/// A part of a sample.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Contribution {
    /// What it adds to the sample, cd/m2: after throughput and weight.
    pub color: Rgb,
    /// Factor of the path up to the segment, or to the vertex; a part of `color`.
    pub throughput: Rgb,
    /// The segment that it was found on or at the end of; 0: the camera's.
    pub bounce: u32,
    /// How it was found.
    pub found: Found,
    /// Index of the light; `None`: a medium that glows, a field, or no light could be chosen.
    pub light: Option<u32>,
    /// Of a lamp met or drawn from the camera the point on it, else the point that it lights; where a medium glows the segment's start.
    /// Prepared frame, m.
    pub position: Vec3A,
}

/// A vertex, and how the path has left it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Step {
    /// The vertex.
    pub vertex: Vertex,
    /// `None`: the path ended there.
    pub leaving: Option<Leaving>,
}

/// All about one sample: a recorder that keeps everything until the next sample begins.
#[derive(Clone, Debug, Default)]
pub struct Recording {
    /// The vertices in order.
    pub steps: Vec<Step>,
    /// The contributions in order, each with the number of vertices that the path had until then.
    pub contributions: Vec<(Contribution, usize)>,
}

impl Recorder for Recording {
    fn begin(&mut self, _: u32, _: u32) -> Hears {
        self.steps.clear();
        self.contributions.clear();
        Hears::All
    }

    fn vertex(&mut self, vertex: impl FnOnce() -> Vertex) {
        self.steps.push(Step { vertex: vertex(), leaving: None });
    }

    fn leave(&mut self, way: Leaving) {
        if let Some(step) = self.steps.last_mut() {
            step.leaving = Some(way);
        }
    }

    fn light(&mut self, contribution: impl FnOnce() -> Contribution) {
        let contribution = contribution();
        if contribution.color != Rgb::ZERO {
            self.contributions.push((contribution, self.steps.len()));
        }
    }

    fn hidden(&mut self, _: impl FnOnce() -> Ray) {}

    fn stop(&mut self, _: u32, _: Stop, _: Rgb) {}

    fn end(&mut self, _: Option<Rgb>) {}
}

impl Recording {
    /// The vertex that a path with so many vertices came to a lamp from: the latest that it has not gone straight through;
    /// `None`: it came from the camera.
    pub fn source(&self, vertices: usize) -> Option<&Step> {
        self.steps[..vertices].iter().rev().find(|step| step.leaving != Some(Leaving::Straight))
    }
}

/// Two recorders of the same paths.
#[derive(Clone, Copy, Debug, Default)]
pub struct Both<A, B> {
    /// The first.
    pub first: A,
    /// The second.
    pub second: B,
    hears: [bool; 2],
}

impl<A, B> Both<A, B> {
    /// Both of them.
    pub fn new(first: A, second: B) -> Self {
        Self { first, second, hears: [false; 2] }
    }
}

impl<A: Recorder, B: Recorder> Recorder for Both<A, B> {
    const HIDDEN: bool = A::HIDDEN || B::HIDDEN;
    const DARK: bool = A::DARK || B::DARK;
    const CAMERA: bool = A::CAMERA || B::CAMERA;

    fn begin(&mut self, pixel: u32, sample: u32) -> Hears {
        self.hears = [self.first.begin(pixel, sample), self.second.begin(pixel, sample)].map(|it| it == Hears::All);
        if self.hears == [false; 2] { Hears::End } else { Hears::All }
    }

    fn camera(&mut self, view: &View, lens: [f32; 2], ray: &Ray) {
        self.first.camera(view, lens, ray);
        self.second.camera(view, lens, ray);
    }

    fn vertex(&mut self, vertex: impl FnOnce() -> Vertex) {
        both(self, vertex, |it, vertex| it.vertex(|| vertex), |it, vertex| it.vertex(|| vertex));
    }

    fn leave(&mut self, way: Leaving) {
        both(self, || way, |it, way| it.leave(way), |it, way| it.leave(way));
    }

    fn hidden(&mut self, shadow: impl FnOnce() -> Ray) {
        both(self, shadow, |it, shadow| it.hidden(|| shadow), |it, shadow| it.hidden(|| shadow));
    }

    fn split(&mut self, split: impl FnOnce() -> Split) {
        both(self, split, |it, split| it.split(|| split), |it, split| it.split(|| split));
    }

    fn light(&mut self, contribution: impl FnOnce() -> Contribution) {
        both(self, contribution, |it, found| it.light(|| found), |it, found| it.light(|| found));
    }

    fn stop(&mut self, vertices: u32, why: Stop, throughput: Rgb) {
        self.first.stop(vertices, why, throughput);
        self.second.stop(vertices, why, throughput);
    }

    fn end(&mut self, color: Option<Rgb>) {
        self.first.end(color);
        self.second.end(color);
    }
}

/// Tells those of two recorders that hear of the sample.
fn both<A, B, T: Copy>(
    Both { first, second, hears }: &mut Both<A, B>,
    what: impl FnOnce() -> T,
    to_first: impl FnOnce(&mut A, T),
    to_second: impl FnOnce(&mut B, T),
) {
    let what = what();
    if hears[0] {
        to_first(first, what);
    }
    if hears[1] {
        to_second(second, what);
    }
}
