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
    BranchEvent, Continuation, Contribution, InteractionKind, LightTechnique, LobeShares, LobeSplit, RecordLevel,
    Recorder, Termination, Transmitted, Vertex, VertexLocation,
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

/// Notes of a path and of its branches, one after the other. Each branch repeats the events of the path before it.
#[derive(Default)]
struct PathNotes {
    /// Events of the path. For a surface with both kinds of scattering, the event is the diffuse one.
    events: Vec<Symbol>,
    splits: Vec<NotedSplit>,
    lights: Vec<NotedLight>,
    /// First notes of the current branch.
    begin: NotesPlace,
    /// Finished branches, by their last notes.
    ends: Vec<NotesPlace>,
    /// Place at which a copy is being split off.
    copied: Option<NotesPlace>,
    /// Branches that wait.
    waiting: Vec<WaitingNotes>,
}

/// Numbers of notes up to a place.
#[derive(Clone, Copy, Default)]
struct NotesPlace {
    events: usize,
    splits: usize,
    lights: usize,
}

/// Events of a branch that waits: the range of the events before the split, and the event of the vertex at the split.
struct WaitingNotes {
    begin: NotesPlace,
    end: NotesPlace,
    event: Option<Symbol>,
    split: Option<NotedSplit>,
}

/// A surface that scattered a path both diffusely and around a direction.
#[derive(Clone, Copy)]
struct NotedSplit {
    /// Number of the event on its branch.
    event_index: u32,
    glossy: Symbol,
    /// Diffuse share by channel.
    share: Rgb,
}

/// Light that a path has found.
struct NotedLight {
    color: Rgb,
    /// Number of events of the branch up to then.
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

    /// Adds the light of the sample.
    fn add_sample(&mut self) {
        self.notes.ends.push(self.notes.place());
        let mut begin = NotesPlace::default();
        for index in 0..self.notes.ends.len() {
            let end = self.notes.ends[index];
            if begin.splits == end.splits {
                self.add_branch(begin, end);
            } else {
                self.add_split_branch(begin, end);
            }
            begin = end;
        }
    }

    /// Adds the light of a branch with one state at a time. Its notes are those from `begin` to `end`.
    fn add_branch(&mut self, begin: NotesPlace, end: NotesPlace) {
        let (automaton, half) = (&self.plan.automaton, self.half);
        let events = &self.notes.events[begin.events..end.events];
        let (mut state, mut at) = (automaton.start(), 0);
        // Light for the same layers in succession.
        let (mut layer_set, mut light) = (NO_LAYERS, Rgb::ZERO);
        for find in &self.notes.lights[begin.lights..end.lights] {
            for event in events.get(at..find.event_count as usize).unwrap_or_default() {
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

    /// Adds the light of a branch that surfaces scattered in two ways at once. Its notes are those from `begin` to `end`.
    #[inline(never)]
    fn add_split_branch(&mut self, begin: NotesPlace, end: NotesPlace) {
        let automaton = &self.plan.automaton;
        let events = &self.notes.events[begin.events..end.events];
        let mut splits = self.notes.splits[begin.splits..end.splits].iter().peekable();
        let mut finds = self.notes.lights[begin.lights..end.lights].iter().peekable();
        self.states.reset(automaton.start());
        for at in 0..=events.len() {
            while let Some(find) = finds.next_if(|find| find.event_count as usize == at) {
                for &(state, share) in &self.states.current {
                    let layer_set = automaton.accepting_layers(automaton.next(state, find.scattered), find.source);
                    add(&mut self.pixel, layer_set, self.half, find.color * share);
                }
            }
            let Some(&event) = events.get(at) else { break };
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
        self.ends.clear();
        self.waiting.clear();
        self.begin = NotesPlace::default();
        self.copied = None;
    }

    /// Returns the place after all notes.
    fn place(&self) -> NotesPlace {
        NotesPlace { events: self.events.len(), splits: self.splits.len(), lights: self.lights.len() }
    }

    /// Returns the number of events of the current branch.
    #[inline]
    fn event_count(&self) -> u32 {
        (self.events.len() - self.begin.events) as u32
    }

    fn suspend_branch(&mut self) {
        let Some(end) = self.copied else { return };
        let (event, split) = (self.events.get(end.events).copied(), self.splits.get(end.splits).copied());
        self.waiting.push(WaitingNotes { begin: self.begin, end, event, split });
        self.discard_branch();
    }

    fn discard_branch(&mut self) {
        let Some(end) = self.copied.take() else { return };
        self.events.truncate(end.events);
        self.splits.truncate(end.splits);
    }

    fn resume_branch(&mut self) {
        let Some(WaitingNotes { begin, end, event, split }) = self.waiting.pop() else { return };
        self.ends.push(self.place());
        self.begin = self.place();
        self.events.extend_from_within(begin.events..end.events);
        self.events.extend(event);
        self.splits.extend_from_within(begin.splits..end.splits);
        self.splits.extend(split);
    }

    #[inline(never)]
    fn note_split(&mut self, glossy: Symbol, share: Rgb) {
        self.splits.push(NotedSplit { event_index: self.event_count(), glossy, share });
    }

    #[inline(never)]
    fn note_light_of_both_lobes(&mut self, color: Rgb, share: Rgb, [diffuse, glossy]: [Symbol; 2], source: Symbol) {
        self.note_light(color * share, diffuse, source);
        self.note_light(color * (Rgb::ONE - share), glossy, source);
    }

    #[inline]
    fn note_light(&mut self, color: Rgb, scattered: Symbol, source: Symbol) {
        self.lights.push(NotedLight { color, event_count: self.event_count(), scattered, source });
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
        let event = match continuation.interaction {
            // A path continues neither after absorption nor at an emitter.
            InteractionKind::Straight | InteractionKind::Absorbed | InteractionKind::Emission => return,
            InteractionKind::Reflection => self.labels.symbol(EventKind::ReflectedSpecular),
            InteractionKind::Refraction => self.labels.symbol(EventKind::TransmittedSpecular),
            InteractionKind::Volume => self.labels.symbol(EventKind::Volume),
            InteractionKind::Diffuse | InteractionKind::Glossy => {
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
        let Contribution { color, technique, medium, light, .. } = contribution();
        if color == Rgb::ZERO {
            return;
        }
        let lamp = self.plan.lamp(light).symbol(EventKind::Light);
        let medium = medium.map_or(self.plan.plain, |medium| self.plan.medium(medium));
        match technique {
            // The field ends paths only with the method `fem`, which has no layers.
            LightTechnique::CameraNextEvent | LightTechnique::EmitterHit | LightTechnique::Field => {
                self.notes.note_light(color, Symbol::NONE, lamp);
            }
            LightTechnique::NextEvent => self.note_scattered_light(color, lamp),
            LightTechnique::Airlight => self.notes.note_light(color, medium.symbol(EventKind::Volume), lamp),
            LightTechnique::Glow => self.notes.note_light(color, Symbol::NONE, medium.symbol(EventKind::Object)),
        }
    }

    fn branch(&mut self, event: BranchEvent) {
        match event {
            BranchEvent::Begin => self.notes.copied = Some(self.notes.place()),
            BranchEvent::Suspend => self.notes.suspend_branch(),
            BranchEvent::Discard => self.notes.discard_branch(),
            BranchEvent::Resume => self.notes.resume_branch(),
        }
    }

    fn terminate(&mut self, _: Termination) {}

    #[inline]
    fn end_sample(&mut self, color: Option<Rgb>) {
        // Samples that the film rejects do not count in any layer either.
        if color.is_none() {
            return;
        }
        let count = &mut self.count[self.half];
        *count = count.saturating_add(1);
        self.add_sample();
    }
}
