//! Recording of samples during rendering, which adds their light to the layers that accept it.
//!
//! While a path is traced, the recorder only notes its events and its light. When the film has accepted the sample, the automaton
//! processes the notes. So the path loop makes no calls, and samples that the film rejects count in no layer.
//!
//! Light is summed by the set of layers that accept it together ([`LayerSetIndex`]). The expressions of a frame have few such sets,
//! so a sample in many layers costs hardly more than one in few.

use super::LayerPlan;
use femc_film::tile::{HALVES, half_of};
use femc_film::{LightBuffer, LightSums};
use femc_geometry::Ray;
use femc_layers::{DEAD_STATE, EventKind, LabelOffset, LayerSetIndex, NO_LAYERS, State, Symbol};
use femc_math::Rgb;
use femc_math::sampler::replicate_of;
use femc_montecarlo::record::{
    Continuation, Contribution, LightTechnique, LobeShares, LobeSplit, RecordLevel, Recorder, Scatterer, Termination,
    Transmitted, Vertex, VertexLocation,
};
use femc_prepared::Prepared;

/// Recorder that sums the layers of the pixels that a tracer renders one after the other.
pub(crate) struct LayerRecorder<'a> {
    plan: &'a LayerPlan,
    prepared: &'a Prepared,
    finished: FinishedPixels,
    /// Current pixel: its light by [`LayerSetIndex`] and half, and its samples.
    current_pixel: Option<u32>,
    pixel: PixelLight,
    count: [u32; HALVES],
    // State of the current sample:
    half: usize,
    /// Labels of the latest vertex, and its kind of scattering.
    labels: LabelOffset,
    split: LobeSplit,
    notes: PathNotes,
    states: PathStates,
}

/// Finished pixels, one after the other.
pub(super) struct FinishedPixels {
    /// Number of valid samples.
    pub(super) count: Vec<[u32; HALVES]>,
    /// Light by [`LayerSetIndex`]. Missing entries at the end have no light.
    pub(super) light: Vec<Vec<LightSums>>,
}

/// Light of the samples of one pixel by [`LayerSetIndex`], and those that have light.
struct PixelLight {
    light: Vec<LightBuffer>,
    lit: Vec<LayerSetIndex>,
    is_lit: Vec<bool>,
}

/// Notes of a path.
#[derive(Default)]
struct PathNotes {
    /// Events of the path. For a surface with both kinds of scattering, the event is the diffuse one.
    events: Vec<Symbol>,
    splits: Vec<NotedSplit>,
    lights: Vec<NotedLight>,
}

/// A surface that scattered a path both diffusely and around a direction.
struct NotedSplit {
    /// Number of the event.
    event_index: u32,
    glossy: Symbol,
    /// Diffuse share by channel.
    share: Rgb,
}

/// Light that a path has found.
struct NotedLight {
    color: Rgb,
    /// Number of events of the path up to then.
    event_count: u32,
    /// Event of the scatterer between the light and the path.
    scattered: Symbol,
    source: Symbol,
}

/// States of a path that was split, with the share of its light in each, by channel. Dead states are omitted.
#[derive(Default)]
struct PathStates {
    current: Vec<(State, Rgb)>,
    previous: Vec<(State, Rgb)>,
}

impl<'a> LayerRecorder<'a> {
    pub(crate) fn new(plan: &'a LayerPlan, prepared: &'a Prepared) -> Self {
        let sets = plan.automaton.layer_sets().len();
        Self {
            plan,
            prepared,
            finished: FinishedPixels { count: Vec::new(), light: vec![Vec::new(); sets] },
            current_pixel: None,
            pixel: PixelLight { light: vec![LightBuffer::default(); sets], lit: Vec::new(), is_lit: vec![false; sets] },
            count: [0; HALVES],
            half: 0,
            labels: plan.plain,
            split: LobeSplit { transmitted: Transmitted::No, lobes: LobeShares::Glossy },
            notes: PathNotes::default(),
            states: PathStates::default(),
        }
    }

    pub(super) fn finish(mut self) -> FinishedPixels {
        self.end_pixel();
        self.finished
    }

    #[cold]
    fn begin_pixel(&mut self, pixel: u32) {
        self.end_pixel();
        self.current_pixel = Some(pixel);
    }

    fn end_pixel(&mut self) {
        if self.current_pixel.take().is_none() {
            return;
        }
        let before = self.finished.count.len();
        self.finished.count.push(std::mem::take(&mut self.count));
        for layer_set in self.pixel.lit.drain(..).map(usize::from) {
            self.pixel.is_lit[layer_set] = false;
            if let Some(sums) = self.pixel.light[layer_set].take() {
                let done = &mut self.finished.light[layer_set];
                done.resize(before, LightSums::default());
                done.push(sums);
            }
        }
    }

    /// Notes light that arrives at the path's latest surface from a lamp.
    #[inline(always)]
    fn note_scattered_light(&mut self, color: Rgb, source: Symbol) {
        let [diffuse, glossy] = lobes(self.labels, self.split.transmitted);
        match self.split.lobes {
            LobeShares::Diffuse => self.notes.note_light(color, diffuse, source),
            LobeShares::Glossy => self.notes.note_light(color, glossy, source),
            LobeShares::Both(share) => self.notes.note_light_of_both_lobes(color, share, [diffuse, glossy], source),
        }
    }

    /// Adds the light of a path with one state at a time.
    fn add_path(&mut self) {
        let (automaton, half) = (&self.plan.automaton, self.half);
        let (mut state, mut at) = (automaton.start(), 0);
        // Light for the same layers in succession.
        let (mut layer_set, mut light) = (NO_LAYERS, Rgb::ZERO);
        for find in &self.notes.lights {
            for event in self.notes.events.get(at..find.event_count as usize).unwrap_or_default() {
                state = automaton.next(state, *event);
            }
            at = find.event_count as usize;
            let accepting = automaton.accepting_layers(automaton.next(state, find.scattered), find.source);
            if accepting != layer_set {
                add(&mut self.pixel, layer_set, half, light);
                (layer_set, light) = (accepting, Rgb::ZERO);
            }
            light += find.color;
        }
        add(&mut self.pixel, layer_set, half, light);
    }

    /// Adds the light of a path that was split.
    #[inline(never)]
    fn add_split_path(&mut self) {
        let automaton = &self.plan.automaton;
        let mut splits = self.notes.splits.iter().peekable();
        let mut finds = self.notes.lights.iter().peekable();
        self.states.reset(automaton.start());
        for at in 0..=self.notes.events.len() {
            while let Some(find) = finds.next_if(|find| find.event_count as usize == at) {
                for &(state, share) in &self.states.current {
                    let layer_set = automaton.accepting_layers(automaton.next(state, find.scattered), find.source);
                    add(&mut self.pixel, layer_set, self.half, find.color * share);
                }
            }
            let Some(&event) = self.notes.events.get(at) else { break };
            match splits.next_if(|split| split.event_index as usize == at) {
                None => self.states.step(&[(event, Rgb::ONE)], |state, event| automaton.next(state, event)),
                Some(NotedSplit { glossy, share, .. }) => {
                    let events = [(event, *share), (*glossy, Rgb::ONE - *share)];
                    self.states.step(&events, |state, event| automaton.next(state, event));
                }
            }
        }
    }
}

/// Adds light of a sample to the layers that accept it together.
#[inline(always)]
fn add(pixel: &mut PixelLight, layer_set: LayerSetIndex, half: usize, light: Rgb) {
    if layer_set == NO_LAYERS {
        return;
    }
    if !pixel.is_lit[usize::from(layer_set)] {
        pixel.is_lit[usize::from(layer_set)] = true;
        pixel.lit.push(layer_set);
    }
    pixel.light[usize::from(layer_set)].add(half, light);
}

/// Returns the events of a surface's lobes: diffuse, glossy.
#[inline]
fn lobes(labels: LabelOffset, transmitted: Transmitted) -> [Symbol; 2] {
    let kinds = match transmitted {
        Transmitted::No => [EventKind::ReflectedDiffuse, EventKind::ReflectedGlossy],
        Transmitted::Yes => [EventKind::TransmittedDiffuse, EventKind::TransmittedGlossy],
    };
    kinds.map(|kind| labels.symbol(kind))
}

impl PathNotes {
    #[inline]
    fn clear(&mut self) {
        self.events.clear();
        self.splits.clear();
        self.lights.clear();
    }

    #[inline(never)]
    fn note_split(&mut self, glossy: Symbol, share: Rgb) {
        self.splits.push(NotedSplit { event_index: self.events.len() as u32, glossy, share });
    }

    #[inline(never)]
    fn note_light_of_both_lobes(&mut self, color: Rgb, share: Rgb, [diffuse, glossy]: [Symbol; 2], source: Symbol) {
        self.note_light(color * share, diffuse, source);
        self.note_light(color * (Rgb::ONE - share), glossy, source);
    }

    #[inline]
    fn note_light(&mut self, color: Rgb, scattered: Symbol, source: Symbol) {
        self.lights.push(NotedLight { color, event_count: self.events.len() as u32, scattered, source });
    }
}

impl PathStates {
    fn reset(&mut self, state: State) {
        self.current.clear();
        if state != DEAD_STATE {
            self.current.push((state, Rgb::ONE));
        }
    }

    /// Advances all states by these events, each with its share.
    fn step(&mut self, events: &[(Symbol, Rgb)], next: impl Fn(State, Symbol) -> State) {
        std::mem::swap(&mut self.current, &mut self.previous);
        self.current.clear();
        for &(event, part) in events {
            for &(state, share) in &self.previous {
                let (state, share) = (next(state, event), share * part);
                if state == DEAD_STATE {
                    continue;
                }
                match self.current.iter_mut().find(|known| known.0 == state) {
                    Some((_, all)) => *all += share,
                    None => self.current.push((state, share)),
                }
            }
        }
    }
}

impl Recorder for LayerRecorder<'_> {
    const WANTS_OCCLUDERS: bool = false;
    const WANTS_ZERO_LIGHT: bool = false;

    #[inline]
    fn begin_sample(&mut self, pixel: u32, sample: u32) -> RecordLevel {
        if self.current_pixel != Some(pixel) {
            self.begin_pixel(pixel);
        }
        self.half = half_of(replicate_of(sample));
        self.notes.clear();
        RecordLevel::All
    }

    #[inline]
    fn vertex(&mut self, vertex: impl FnOnce() -> Vertex) {
        if !self.plan.is_unlabeled {
            self.labels = match vertex().location {
                VertexLocation::Surface { instance, primitive, material } => {
                    self.plan.surface(self.prepared.object_of(instance, primitive), material)
                }
                VertexLocation::Medium(medium) => self.plan.medium(medium),
            };
        }
    }

    #[inline]
    fn lobe_split(&mut self, split: impl FnOnce() -> LobeSplit) {
        self.split = split();
    }

    #[inline]
    fn leave(&mut self, continuation: Continuation) {
        let event = match continuation {
            Continuation::Straight => return,
            Continuation::Delta(Transmitted::No) => self.labels.symbol(EventKind::ReflectedSpecular),
            Continuation::Delta(Transmitted::Yes) => self.labels.symbol(EventKind::TransmittedSpecular),
            Continuation::Scattered { scatterer: Scatterer::Phase, .. } => self.labels.symbol(EventKind::Volume),
            Continuation::Scattered { scatterer: Scatterer::Diffuse | Scatterer::Glossy, .. } => {
                let [diffuse, glossy] = lobes(self.labels, self.split.transmitted);
                match self.split.lobes {
                    LobeShares::Diffuse => diffuse,
                    LobeShares::Glossy => glossy,
                    LobeShares::Both(share) => {
                        self.notes.note_split(glossy, share);
                        diffuse
                    }
                }
            }
        };
        self.notes.events.push(event);
    }

    fn occluded(&mut self, _: impl FnOnce() -> Ray) {}

    #[inline]
    fn contribution(&mut self, contribution: impl FnOnce() -> Contribution) {
        let Contribution { color, technique: found, light, .. } = contribution();
        if color == Rgb::ZERO {
            return;
        }
        let lamp = self.plan.lamp(light).symbol(EventKind::Light);
        match found {
            // The field ends paths only with the method `fem`, which has no layers.
            LightTechnique::CameraNextEvent | LightTechnique::EmitterHit | LightTechnique::Field => {
                self.notes.note_light(color, Symbol::NONE, lamp);
            }
            LightTechnique::NextEvent => self.note_scattered_light(color, lamp),
            LightTechnique::Airlight(medium) => {
                self.notes.note_light(color, self.plan.medium(medium).symbol(EventKind::Volume), lamp);
            }
            LightTechnique::Glow(medium) => {
                self.notes.note_light(color, Symbol::NONE, self.plan.medium(medium).symbol(EventKind::Object));
            }
        }
    }

    fn terminate(&mut self, _: u32, _: Termination, _: Rgb) {}

    #[inline]
    fn end_sample(&mut self, color: Option<Rgb>) {
        // Samples that the film rejects do not count in any layer either.
        if color.is_none() {
            return;
        }
        let count = &mut self.count[self.half];
        *count = count.saturating_add(1);
        if self.notes.splits.is_empty() {
            self.add_path();
        } else {
            self.add_split_path();
        }
    }
}
