//! Recording of paths, to analyze where their light comes from.
//!
//! A sample is a function of seed, frame, pixel and number. It can be traced again at any time, this time with a recorder. The
//! recorder `()` of ordinary rendering ignores everything. Events are passed as closures which it does not call, so computing them
//! costs nothing.
//!
//! `femc-paths` defines the kinds of events, so that recorders and recorded paths share them.

use femc_geometry::Ray;
use femc_math::glam::Vec3A;
use femc_math::{Rgb, SampleStream};
pub use femc_paths::{InteractionKind, LightTechnique, PathEnd};
use femc_prepared::camera::View;
use femc_scattering::Bsdf;
pub use femc_scattering::Transmitted;

/// Calls a recorder with an event of the path, if it receives all events of this sample ([`RecordLevel::All`]).
macro_rules! record {
    ($object:ident $(.$member:ident)+ ($($arguments:tt)*)) => {
        if RECORD_ALL {
            $object $(.$member)+ ($($arguments)*);
        }
    };
}

/// Events of a sample that a recorder receives.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RecordLevel {
    /// Only the end: the reason why the path stops, and the sample's radiance.
    End,
    /// The end, and all vertices and contributions before it.
    All,
}

/// Decision of a path for which random numbers are drawn, in the order in which a ray makes them.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Decision {
    /// Position in the pixel and on the lens, and time.
    Camera,
    /// Small emitter that the camera sees, and points on it.
    CameraEmitter,
    /// Point of a glowing medium.
    Glow,
    /// Lamp whose light the media of a ray scatter.
    AirlightLamp,
    /// Distance at which the media scatter it.
    AirlightDistance,
    /// Point on that lamp.
    AirlightPoint,
    /// Distance of the next collision in the media.
    Distance,
    /// Lamp for the direct light at a surface.
    Lamp,
    /// Point on that lamp.
    LampPoint,
    /// Russian roulette of the weight window.
    Window,
    /// Direction in which the path continues, and its lobe.
    Direction,
    /// Russian roulette by weight, and that of long paths.
    Roulette,
}

impl Decision {
    /// Returns the word for it in tables.
    pub fn word(self) -> &'static str {
        match self {
            Self::Camera => "camera",
            Self::CameraEmitter => "camera emitter",
            Self::Glow => "glow",
            Self::AirlightLamp => "airlight lamp",
            Self::AirlightDistance => "airlight distance",
            Self::AirlightPoint => "airlight point",
            Self::Distance => "distance",
            Self::Lamp => "lamp",
            Self::LampPoint => "point on lamp",
            Self::Window => "window",
            Self::Direction => "direction",
            Self::Roulette => "roulette",
        }
    }
}

/// Event of a branch: a copy of a path that is split at a vertex.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum BranchEvent {
    /// A copy is split off at the latest vertex. The next events are those of the copy, up to `Suspend` or `Discard`.
    Begin,
    /// The copy has left the vertex and waits. The next events are those of the original path.
    Suspend,
    /// The copy has ended at the vertex. The next events are those of the original path.
    Discard,
    /// The current path has ended. The next events are those of the copy that began to wait last.
    Resume,
}

/// Recorder that the tracer calls for each vertex of a path, for each contribution to a sample, and at the path's end.
pub trait Recorder {
    /// Whether the recorder wants the occluders of light ([`Self::occluded`]), which takes work to find.
    const WANTS_OCCLUDERS: bool = true;
    /// Whether the recorder wants sampled light that contributes nothing because it is occluded or on a side that does not scatter.
    const WANTS_ZERO_LIGHT: bool = true;
    /// Whether the recorder wants camera rays ([`Self::camera_ray`]).
    const WANTS_CAMERA_RAYS: bool = false;
    /// Whether the recorder ignores everything. Then samples need not be traced one after the other.
    const IGNORES_ALL: bool = false;

    /// Begins a camera sample and returns the events to report for it.
    /// - `pixel`: row-major index in the whole film;
    /// - `sample`: number of the sample.
    fn begin_sample(&mut self, pixel: u32, sample: u32) -> RecordLevel;
    /// Records the camera ray of the sample, independent of the other events to report.
    /// - `view`: the view of the point `lens` of the lens, in [0, 1)^2, at the ray's time.
    fn camera_ray(&mut self, _view: &View, _lens: [f32; 2], _ray: &Ray) {}
    /// Records that random numbers are drawn next for a decision.
    /// - `bounce`: index of the segment, 0: the camera's;
    /// - `stream`: their source. A recorder may replace it by a branch, so that this decision and all later ones are new.
    fn decide(&mut self, _decision: Decision, _bounce: u32, _stream: &mut SampleStream) {}
    /// Records that the path reached a surface that may scatter, or a collision in a medium.
    fn vertex(&mut self, vertex: impl FnOnce() -> Vertex);
    /// Records that the path leaves its latest vertex.
    fn leave(&mut self, continuation: Continuation);
    /// Records that a surface occludes the light sampled for the latest vertex, or for a point in fog. Its contribution, which is
    /// reported next, is 0.
    fn occluded(&mut self, shadow: impl FnOnce() -> Ray);
    /// Records the scattering lobes of the latest vertex's surface for the direction that is reported next: the direction in which
    /// the path continues, or that of the sampled light, unless it is occluded. It is not called for mirrors and clear surfaces.
    fn lobe_split(&mut self, _lobe_split: impl FnOnce() -> LobeSplit) {}
    /// Records the light that a field expects at the latest vertex, if it has data there and the frame has targets.
    fn expectation(&mut self, _expectation: impl FnOnce() -> Expectation) {}
    /// Records the sampled direction in which the path leaves its latest vertex, if [`Self::expectation`] was called there.
    fn direction(&mut self, _direction: impl FnOnce() -> Direction) {}
    /// Records a light contribution.
    fn contribution(&mut self, contribution: impl FnOnce() -> Contribution);
    /// Records that a path is split, or that one of its branches is traced.
    fn branch(&mut self, event: BranchEvent);
    /// Records that the path ends, or a branch of it.
    fn terminate(&mut self, termination: Termination);
    /// Ends the sample.
    /// - `color`: radiance of the sample, cd/m2 by channel; `None`: the film rejects it.
    fn end_sample(&mut self, color: Option<Rgb>);
}

impl Recorder for () {
    const IGNORES_ALL: bool = true;

    #[inline(always)]
    fn begin_sample(&mut self, _: u32, _: u32) -> RecordLevel {
        RecordLevel::End
    }
    #[inline(always)]
    fn vertex(&mut self, _: impl FnOnce() -> Vertex) {}
    #[inline(always)]
    fn leave(&mut self, _: Continuation) {}
    #[inline(always)]
    fn occluded(&mut self, _: impl FnOnce() -> Ray) {}
    #[inline(always)]
    fn contribution(&mut self, _: impl FnOnce() -> Contribution) {}
    #[inline(always)]
    fn branch(&mut self, _: BranchEvent) {}
    #[inline(always)]
    fn terminate(&mut self, _: Termination) {}
    #[inline(always)]
    fn end_sample(&mut self, _: Option<Rgb>) {}
}

/// End of a path.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Termination {
    /// Reason of the end.
    pub end: PathEnd,
    /// Number of vertices of the path.
    pub vertices: u32,
    /// Throughput of the path; 0 if it ends because nothing is left.
    pub throughput: Rgb,
}

/// Object or medium at a vertex.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum VertexLocation {
    /// A surface of `Prepared::instances`.
    Surface {
        /// Index of the instance.
        instance: u32,
        /// Index of the primitive in it.
        primitive: u32,
        /// Index of the material.
        material: u32,
    },
    /// A medium, by index.
    Medium(u16),
}

/// A vertex of a path.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Vertex {
    /// Surface or medium there.
    pub location: VertexLocation,
    /// Position, prepared frame, m.
    pub position: Vec3A,
    /// Index of the segment that ends there; 0: the camera's.
    pub bounce: u32,
    /// Throughput of the path on arrival.
    pub throughput: Rgb,
}

/// Way in which a path leaves a vertex.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Continuation {
    /// Interaction there. The path stays on its segment only if it goes straight through a clear surface.
    pub interaction: InteractionKind,
    /// Whether the direction was sampled from the guide of a first pass.
    pub is_guide_sample: bool,
}

impl Continuation {
    /// Creates a continuation whose direction was not sampled from a guide.
    pub(crate) fn unguided(interaction: InteractionKind) -> Self {
        Self { interaction, is_guide_sample: false }
    }
}

/// Light that a field expects at a surface that a path reached.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Expectation {
    /// Region of the targets.
    pub region: u32,
    /// Luminance that the path still adds to the sample, without direct light from sources at this surface, cd/m2.
    pub light: f32,
}

/// Sampled direction in which a path leaves a surface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Direction {
    /// Position of the surface, prepared frame, m.
    pub position: Vec3A,
    /// Unit direction.
    pub dir: Vec3A,
    /// Index of the segment that ends at the surface; 0: the camera's.
    pub bounce: u32,
    /// Light that the field expects along all directions, after Russian roulette.
    pub expectation: Expectation,
    /// Share of the directions at the surface that a guide samples, in 0..1.
    pub guide_share: f32,
    /// Ratio of the density of directions, of the BSDF and the guide together, to that of the BSDF.
    pub pdf_ratio: f32,
}

/// Lobes that scatter light from one direction into another at a surface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LobeSplit {
    /// Whether the directions lie on different sides.
    pub transmitted: Transmitted,
    /// Lobes with a contribution.
    pub lobes: LobeShares,
}

/// Lobes of a surface between two directions.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum LobeShares {
    /// Only diffuse scattering.
    Diffuse,
    /// Only glossy scattering.
    Glossy,
    /// Both kinds, with the diffuse share by channel, in 0..1.
    Both(Rgb),
}

impl LobeSplit {
    /// Returns the split for light from `wi` to `wo`, unit, local frame, of which a part is scattered. It depends on the side from
    /// which the light comes and on the lobes' shares of the BSDF's value there, not on the sampler of the direction.
    #[inline]
    pub(crate) fn new(bsdf: &Bsdf, wo: Vec3A, wi: Vec3A) -> Self {
        // By far the most frequent BSDF. It scatters to only one side.
        if matches!(bsdf, Bsdf::Diffuse(_)) {
            return Self { transmitted: Transmitted::No, lobes: LobeShares::Diffuse };
        }
        let transmitted = if wo.z * wi.z < 0.0 { Transmitted::Yes } else { Transmitted::No };
        Self { transmitted, lobes: LobeShares::new(bsdf, wo, wi) }
    }
}

impl LobeShares {
    #[inline(never)]
    fn new(bsdf: &Bsdf, wo: Vec3A, wi: Vec3A) -> Self {
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

/// Light contribution to a sample.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Contribution {
    /// Contribution to the sample, cd/m2, including throughput and weight.
    pub color: Rgb,
    /// Throughput of the path up to the segment, or to the vertex; already a factor of `color`.
    pub throughput: Rgb,
    /// Index of the segment that found the light, on it or at its end; 0: the camera's.
    pub bounce: u32,
    /// Technique that found the light.
    pub technique: LightTechnique,
    /// Index of the medium that scattered the light of a lamp into the segment, or that emits.
    pub medium: Option<u16>,
    /// Index of the light. `None`: an emitting medium, a field, or no light could be chosen.
    pub light: Option<u32>,
    /// Point on the lamp, if it was hit or sampled from the camera. The segment's start, if a medium emits. Else the point that the
    /// light illuminates. Prepared frame, m.
    pub position: Vec3A,
}

impl Contribution {
    /// Creates the contribution of a field at a path's latest vertex.
    pub(crate) fn from_field(color: Rgb, throughput: Rgb, bounce: u32, position: Vec3A) -> Self {
        Self { color, throughput, bounce, technique: LightTechnique::Field, medium: None, light: None, position }
    }
}

/// A vertex, and the way in which the path left it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Step {
    /// Vertex of the path.
    pub vertex: Vertex,
    /// Way in which the path left. `None`: the path ended there.
    pub continuation: Option<Continuation>,
}

impl Step {
    /// Returns the interaction with which the path continued.
    pub fn interaction(&self) -> InteractionKind {
        self.continuation.map_or(InteractionKind::Absorbed, |continuation| continuation.interaction)
    }
}

/// Vertices of a path and of its branches. A vertex has a number from 1; 0 is the camera.
#[derive(Clone, Debug, Default)]
pub struct StepTree {
    nodes: Vec<StepNode>,
    /// Number of the latest vertex of the current branch.
    latest: u32,
    /// Way in which the copy leaves that is being split off. The outer `None`: no copy is being split off.
    leaving: Option<Option<Continuation>>,
    /// Copies that wait: the number of their vertex, and the way in which they left it.
    waiting: Vec<(u32, Option<Continuation>)>,
}

/// A vertex of a [`StepTree`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StepNode {
    /// Vertex, and the way in which this branch left it.
    pub step: Step,
    /// Number of the vertex before it on its branch; 0: the camera.
    pub parent: u32,
    /// Number of the vertex that this one repeats, because another copy of the path left it. 0: it is the first.
    pub repeats: u32,
}

impl StepTree {
    /// Removes all vertices.
    pub fn clear(&mut self) {
        self.nodes.clear();
        self.waiting.clear();
        (self.latest, self.leaving) = (0, None);
    }

    /// Returns all vertices in the order of their numbers, from 1.
    pub fn nodes(&self) -> &[StepNode] {
        &self.nodes
    }

    /// Returns the number of the latest vertex of the current branch.
    pub fn latest(&self) -> u32 {
        self.latest
    }

    /// Returns the steps of the branch that ends at a vertex, the last one first.
    pub fn branch(&self, vertex: u32) -> impl Iterator<Item = &Step> + Clone {
        let node = |number: u32| Some(number).zip(self.nodes.get(number.checked_sub(1)? as usize));
        std::iter::successors(node(vertex), move |(_, before)| node(before.parent)).map(|(_, node)| &node.step)
    }

    /// Adds a vertex to the current branch.
    pub fn vertex(&mut self, vertex: Vertex) {
        let step = Step { vertex, continuation: None };
        self.nodes.push(StepNode { step, parent: self.latest, repeats: 0 });
        self.latest = self.nodes.len() as u32;
    }

    /// Records how the current branch leaves its latest vertex ([`Recorder::leave`]).
    pub fn leave(&mut self, continuation: Continuation) {
        if let Some(leaving) = &mut self.leaving {
            *leaving = Some(continuation);
        } else if let Some(last) = (self.latest as usize).checked_sub(1).and_then(|index| self.nodes.get_mut(index)) {
            last.step.continuation = Some(continuation);
        }
    }

    /// Processes an event of a branch. A branch that is resumed begins with a repetition of the vertex that it left.
    pub fn on_branch(&mut self, event: BranchEvent) {
        match event {
            BranchEvent::Begin => self.leaving = Some(None),
            BranchEvent::Suspend => self.waiting.push((self.latest, self.leaving.take().flatten())),
            BranchEvent::Discard => self.leaving = None,
            BranchEvent::Resume => self.resume(),
        }
    }

    fn resume(&mut self) {
        let Some((number, continuation)) = self.waiting.pop() else { return };
        let Some(index) = (number as usize).checked_sub(1) else { return };
        let StepNode { step, parent, repeats } = self.nodes[index];
        let step = Step { continuation, ..step };
        self.nodes.push(StepNode { step, parent, repeats: if repeats == 0 { number } else { repeats } });
        self.latest = self.nodes.len() as u32;
    }
}

/// Recorder that keeps all events of one sample until the next sample begins.
#[derive(Clone, Debug, Default)]
pub struct Recording {
    /// Vertices.
    pub steps: StepTree,
    /// Contributions in order, each with the number of the latest vertex of its branch.
    pub contributions: Vec<(Contribution, u32)>,
}

impl Recorder for Recording {
    fn begin_sample(&mut self, _: u32, _: u32) -> RecordLevel {
        self.steps.clear();
        self.contributions.clear();
        RecordLevel::All
    }

    fn vertex(&mut self, vertex: impl FnOnce() -> Vertex) {
        self.steps.vertex(vertex());
    }

    fn leave(&mut self, continuation: Continuation) {
        self.steps.leave(continuation);
    }

    fn contribution(&mut self, contribution: impl FnOnce() -> Contribution) {
        let contribution = contribution();
        if contribution.color != Rgb::ZERO {
            self.contributions.push((contribution, self.steps.latest()));
        }
    }

    fn occluded(&mut self, _: impl FnOnce() -> Ray) {}

    fn branch(&mut self, event: BranchEvent) {
        self.steps.on_branch(event);
    }

    fn terminate(&mut self, _: Termination) {}

    fn end_sample(&mut self, _: Option<Rgb>) {}
}

impl Recording {
    /// Returns the vertex from which the branch that ends at a vertex reached a lamp: the last one that it did not go straight
    /// through. `None`: it came from the camera.
    pub fn last_scattering(&self, vertex: u32) -> Option<&Step> {
        self.steps.branch(vertex).find(|step| step.interaction() != InteractionKind::Straight)
    }
}

/// Pair of recorders of the same paths.
#[derive(Clone, Copy, Debug, Default)]
pub struct RecorderPair<A, B> {
    /// First recorder.
    pub first: A,
    /// Second recorder.
    pub second: B,
    record_all: [bool; 2],
}

impl<A, B> RecorderPair<A, B> {
    /// Combines two recorders.
    pub fn new(first: A, second: B) -> Self {
        Self { first, second, record_all: [false; 2] }
    }
}

impl<A: Recorder, B: Recorder> Recorder for RecorderPair<A, B> {
    const WANTS_OCCLUDERS: bool = A::WANTS_OCCLUDERS || B::WANTS_OCCLUDERS;
    const WANTS_ZERO_LIGHT: bool = A::WANTS_ZERO_LIGHT || B::WANTS_ZERO_LIGHT;
    const WANTS_CAMERA_RAYS: bool = A::WANTS_CAMERA_RAYS || B::WANTS_CAMERA_RAYS;

    fn begin_sample(&mut self, pixel: u32, sample: u32) -> RecordLevel {
        self.record_all = [self.first.begin_sample(pixel, sample), self.second.begin_sample(pixel, sample)]
            .map(|it| it == RecordLevel::All);
        if self.record_all == [false; 2] { RecordLevel::End } else { RecordLevel::All }
    }

    fn decide(&mut self, decision: Decision, bounce: u32, stream: &mut SampleStream) {
        self.first.decide(decision, bounce, stream);
        self.second.decide(decision, bounce, stream);
    }

    fn camera_ray(&mut self, view: &View, lens: [f32; 2], ray: &Ray) {
        self.first.camera_ray(view, lens, ray);
        self.second.camera_ray(view, lens, ray);
    }

    fn vertex(&mut self, vertex: impl FnOnce() -> Vertex) {
        record_both(self, vertex, |it, vertex| it.vertex(|| vertex), |it, vertex| it.vertex(|| vertex));
    }

    fn leave(&mut self, continuation: Continuation) {
        record_both(self, || continuation, |it, way| it.leave(way), |it, way| it.leave(way));
    }

    fn occluded(&mut self, shadow: impl FnOnce() -> Ray) {
        record_both(self, shadow, |it, shadow| it.occluded(|| shadow), |it, shadow| it.occluded(|| shadow));
    }

    fn lobe_split(&mut self, split: impl FnOnce() -> LobeSplit) {
        record_both(self, split, |it, split| it.lobe_split(|| split), |it, split| it.lobe_split(|| split));
    }

    fn expectation(&mut self, expectation: impl FnOnce() -> Expectation) {
        record_both(self, expectation, |it, light| it.expectation(|| light), |it, light| it.expectation(|| light));
    }

    fn direction(&mut self, direction: impl FnOnce() -> Direction) {
        record_both(self, direction, |it, dir| it.direction(|| dir), |it, dir| it.direction(|| dir));
    }

    fn contribution(&mut self, contribution: impl FnOnce() -> Contribution) {
        record_both(self, contribution, |it, found| it.contribution(|| found), |it, found| it.contribution(|| found));
    }

    fn branch(&mut self, event: BranchEvent) {
        record_both(self, || event, |it, event| it.branch(event), |it, event| it.branch(event));
    }

    fn terminate(&mut self, termination: Termination) {
        self.first.terminate(termination);
        self.second.terminate(termination);
    }

    fn end_sample(&mut self, color: Option<Rgb>) {
        self.first.end_sample(color);
        self.second.end_sample(color);
    }
}

/// Calls those of two recorders that receive events of the sample.
fn record_both<A, B, T: Copy>(
    RecorderPair { first, second, record_all }: &mut RecorderPair<A, B>,
    event: impl FnOnce() -> T,
    to_first: impl FnOnce(&mut A, T),
    to_second: impl FnOnce(&mut B, T),
) {
    let event = event();
    if record_all[0] {
        to_first(first, event);
    }
    if record_all[1] {
        to_second(second, event);
    }
}
