//! Recording of samples during rendering, which adds their light to the layers that accept it.
//!
//! While a path is traced, the recorder only notes its events and its light. When the film has accepted the sample, the automaton
//! processes the notes. So the path loop makes no calls, and samples that the film rejects count in no layer.
//!
//! Light is summed by the set of layers that accept it together ([`Takers`]). The expressions of a frame have few such sets, so a
//! sample in many layers costs hardly more than one in few.

use super::LayerPlan;
use femc_film::tile::{HALVES, half_of};
use femc_film::{LightBuffer, LightSums};
use femc_geometry::Ray;
use femc_layers::{DEAD, Kind, Labels, NO_LAYERS, State, Symbol, Takers};
use femc_math::Rgb;
use femc_math::sampler::replicate_of;
use femc_montecarlo::record::{
    Contribution, Found, Hears, Leaving, Lobes, Place, Recorder, Scatterer, Split, Stop, Transmitted, Vertex,
};
use femc_prepared::Prepared;

/// Recorder that sums the layers of the pixels that a tracer renders one after the other.
pub(super) struct LayerRecorder<'a> {
    plan: &'a LayerPlan,
    prepared: &'a Prepared,
    done: Pixels,
    /// Current pixel: its light by [`Takers`] and half, and its samples.
    latest: Option<u32>,
    pixel: PixelLight,
    count: [u32; HALVES],
    // State of the current sample:
    half: usize,
    /// Labels of the latest vertex, and its kind of scattering.
    labels: Labels,
    split: Split,
    notes: Notes,
    ways: Ways,
}

/// Finished pixels, one after the other.
pub(super) struct Pixels {
    /// Number of valid samples.
    pub(super) count: Vec<[u32; HALVES]>,
    /// Light by [`Takers`]. Missing entries at the end have no light.
    pub(super) light: Vec<Vec<LightSums>>,
}

/// Light of the samples of one pixel by [`Takers`], and those that have light.
struct PixelLight {
    light: Vec<LightBuffer>,
    lit: Vec<Takers>,
    is_lit: Vec<bool>,
}

/// Notes of a path.
#[derive(Default)]
struct Notes {
    /// Events of the path. For a surface with both kinds of scattering, the event is the diffuse one.
    events: Vec<Symbol>,
    splits: Vec<Fork>,
    finds: Vec<Find>,
}

/// A surface that scattered a path both diffusely and around a direction.
struct Fork {
    /// Number of the event.
    at: u32,
    glossy: Symbol,
    /// Diffuse share by channel.
    share: Rgb,
}

/// Light that a path has found.
struct Find {
    color: Rgb,
    /// Number of events of the path up to then.
    at: u32,
    /// Event of the scatterer between the light and the path.
    scattered: Symbol,
    source: Symbol,
}

/// States of a path that was split, with the share of its light in each, by channel. Dead states are omitted.
#[derive(Default)]
struct Ways {
    now: Vec<(State, Rgb)>,
    before: Vec<(State, Rgb)>,
}

impl<'a> LayerRecorder<'a> {
    pub(super) fn new(plan: &'a LayerPlan, prepared: &'a Prepared) -> Self {
        let sets = plan.automaton.layers().len();
        Self {
            plan,
            prepared,
            done: Pixels { count: Vec::new(), light: vec![Vec::new(); sets] },
            latest: None,
            pixel: PixelLight { light: vec![LightBuffer::default(); sets], lit: Vec::new(), is_lit: vec![false; sets] },
            count: [0; HALVES],
            half: 0,
            labels: plan.plain,
            split: Split { transmitted: Transmitted::No, lobes: Lobes::Glossy },
            notes: Notes::default(),
            ways: Ways::default(),
        }
    }

    pub(super) fn finish(mut self) -> Pixels {
        self.end_pixel();
        self.done
    }

    #[cold]
    fn begin_pixel(&mut self, pixel: u32) {
        self.end_pixel();
        self.latest = Some(pixel);
    }

    fn end_pixel(&mut self) {
        if self.latest.take().is_none() {
            return;
        }
        let before = self.done.count.len();
        self.done.count.push(std::mem::take(&mut self.count));
        for takers in self.pixel.lit.drain(..).map(usize::from) {
            self.pixel.is_lit[takers] = false;
            if let Some(sums) = self.pixel.light[takers].take() {
                let done = &mut self.done.light[takers];
                done.resize(before, LightSums::default());
                done.push(sums);
            }
        }
    }

    /// Notes light that arrives at the path's latest surface from a lamp.
    #[inline(always)]
    fn scattered(&mut self, color: Rgb, source: Symbol) {
        let [diffuse, glossy] = lobes(self.labels, self.split.transmitted);
        match self.split.lobes {
            Lobes::Diffuse => self.notes.find(color, diffuse, source),
            Lobes::Glossy => self.notes.find(color, glossy, source),
            Lobes::Both(share) => self.notes.find_both(color, share, [diffuse, glossy], source),
        }
    }

    /// Adds the light of a path with one state at a time.
    fn add_all(&mut self) {
        let (automaton, half) = (&self.plan.automaton, self.half);
        let (mut state, mut at) = (automaton.start(), 0);
        // Light for the same layers in succession.
        let (mut takers, mut light) = (NO_LAYERS, Rgb::ZERO);
        for find in &self.notes.finds {
            for event in self.notes.events.get(at..find.at as usize).unwrap_or_default() {
                state = automaton.next(state, *event);
            }
            at = find.at as usize;
            let here = automaton.takers(automaton.next(state, find.scattered), find.source);
            if here != takers {
                add(&mut self.pixel, takers, half, light);
                (takers, light) = (here, Rgb::ZERO);
            }
            light += find.color;
        }
        add(&mut self.pixel, takers, half, light);
    }

    /// Adds the light of a path that was split.
    #[inline(never)]
    fn add_all_of_ways(&mut self) {
        let automaton = &self.plan.automaton;
        let mut splits = self.notes.splits.iter().peekable();
        let mut finds = self.notes.finds.iter().peekable();
        self.ways.begin(automaton.start());
        for at in 0..=self.notes.events.len() {
            while let Some(find) = finds.next_if(|find| find.at as usize == at) {
                for &(state, share) in &self.ways.now {
                    let takers = automaton.takers(automaton.next(state, find.scattered), find.source);
                    add(&mut self.pixel, takers, self.half, find.color * share);
                }
            }
            let Some(&event) = self.notes.events.get(at) else { break };
            match splits.next_if(|split| split.at as usize == at) {
                None => self.ways.step(&[(event, Rgb::ONE)], |state, event| automaton.next(state, event)),
                Some(Fork { glossy, share, .. }) => {
                    let events = [(event, *share), (*glossy, Rgb::ONE - *share)];
                    self.ways.step(&events, |state, event| automaton.next(state, event));
                }
            }
        }
    }
}

/// Adds light of a sample to the layers that accept it together.
#[inline(always)]
fn add(pixel: &mut PixelLight, takers: Takers, half: usize, light: Rgb) {
    if takers == NO_LAYERS {
        return;
    }
    if !pixel.is_lit[usize::from(takers)] {
        pixel.is_lit[usize::from(takers)] = true;
        pixel.lit.push(takers);
    }
    pixel.light[usize::from(takers)].add(half, light);
}

/// Returns the events of a surface's lobes: diffuse, glossy.
#[inline]
fn lobes(labels: Labels, transmitted: Transmitted) -> [Symbol; 2] {
    let kinds = match transmitted {
        Transmitted::No => [Kind::ReflectedDiffuse, Kind::ReflectedGlossy],
        Transmitted::Yes => [Kind::TransmittedDiffuse, Kind::TransmittedGlossy],
    };
    kinds.map(|kind| labels.event(kind))
}

impl Notes {
    #[inline]
    fn begin(&mut self) {
        self.events.clear();
        self.splits.clear();
        self.finds.clear();
    }

    #[inline(never)]
    fn fork(&mut self, glossy: Symbol, share: Rgb) {
        self.splits.push(Fork { at: self.events.len() as u32, glossy, share });
    }

    #[inline(never)]
    fn find_both(&mut self, color: Rgb, share: Rgb, [diffuse, glossy]: [Symbol; 2], source: Symbol) {
        self.find(color * share, diffuse, source);
        self.find(color * (Rgb::ONE - share), glossy, source);
    }

    #[inline]
    fn find(&mut self, color: Rgb, scattered: Symbol, source: Symbol) {
        self.finds.push(Find { color, at: self.events.len() as u32, scattered, source });
    }
}

impl Ways {
    fn begin(&mut self, state: State) {
        self.now.clear();
        if state != DEAD {
            self.now.push((state, Rgb::ONE));
        }
    }

    /// Advances all states by these events, each with its share.
    fn step(&mut self, events: &[(Symbol, Rgb)], next: impl Fn(State, Symbol) -> State) {
        std::mem::swap(&mut self.now, &mut self.before);
        self.now.clear();
        for &(event, part) in events {
            for &(state, share) in &self.before {
                let (state, share) = (next(state, event), share * part);
                if state == DEAD {
                    continue;
                }
                match self.now.iter_mut().find(|known| known.0 == state) {
                    Some((_, all)) => *all += share,
                    None => self.now.push((state, share)),
                }
            }
        }
    }
}

impl Recorder for LayerRecorder<'_> {
    const HIDDEN: bool = false;
    const DARK: bool = false;

    #[inline]
    fn begin(&mut self, pixel: u32, sample: u32) -> Hears {
        if self.latest != Some(pixel) {
            self.begin_pixel(pixel);
        }
        self.half = half_of(replicate_of(sample));
        self.notes.begin();
        Hears::All
    }

    #[inline]
    fn vertex(&mut self, vertex: impl FnOnce() -> Vertex) {
        if !self.plan.are_alike {
            self.labels = match vertex().place {
                Place::Surface { instance, primitive, material } => {
                    self.plan.surface(self.prepared.object_of(instance, primitive), material)
                }
                Place::Medium(medium) => self.plan.medium(medium),
            };
        }
    }

    #[inline]
    fn split(&mut self, split: impl FnOnce() -> Split) {
        self.split = split();
    }

    #[inline]
    fn leave(&mut self, way: Leaving) {
        let event = match way {
            Leaving::Straight => return,
            Leaving::Delta(Transmitted::No) => self.labels.event(Kind::ReflectedSpecular),
            Leaving::Delta(Transmitted::Yes) => self.labels.event(Kind::TransmittedSpecular),
            Leaving::Scattered { by: Scatterer::Phase, .. } => self.labels.event(Kind::Volume),
            Leaving::Scattered { by: Scatterer::Diffuse | Scatterer::Glossy, .. } => {
                let [diffuse, glossy] = lobes(self.labels, self.split.transmitted);
                match self.split.lobes {
                    Lobes::Diffuse => diffuse,
                    Lobes::Glossy => glossy,
                    Lobes::Both(share) => {
                        self.notes.fork(glossy, share);
                        diffuse
                    }
                }
            }
        };
        self.notes.events.push(event);
    }

    fn hidden(&mut self, _: impl FnOnce() -> Ray) {}

    #[inline]
    fn light(&mut self, contribution: impl FnOnce() -> Contribution) {
        let Contribution { color, found, light, .. } = contribution();
        if color == Rgb::ZERO {
            return;
        }
        let lamp = self.plan.lamp(light).event(Kind::Light);
        match found {
            // The field ends paths only with the method `fem`, which has no layers.
            Found::Sight | Found::Met | Found::Field => self.notes.find(color, Symbol::NONE, lamp),
            Found::Surface => self.scattered(color, lamp),
            Found::Airlight(medium) => {
                self.notes.find(color, self.plan.medium(medium).event(Kind::Volume), lamp);
            }
            Found::Glow(medium) => {
                self.notes.find(color, Symbol::NONE, self.plan.medium(medium).event(Kind::Object));
            }
        }
    }

    fn stop(&mut self, _: u32, _: Stop, _: Rgb) {}

    #[inline]
    fn end(&mut self, color: Option<Rgb>) {
        // Samples that the film rejects do not count in any layer either.
        if color.is_none() {
            return;
        }
        let count = &mut self.count[self.half];
        *count = count.saturating_add(1);
        if self.notes.splits.is_empty() {
            self.add_all();
        } else {
            self.add_all_of_ways();
        }
    }
}
